"""Results read back from their files: bit for bit, and nothing else."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import math
import os
import re
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray

import hexservo as hs
from hexservo.campaigns.plan import load_plan
from hexservo.run.publish import OutputError
from hexservo.run.quantities import quantities
from hexservo.run.saved import _parsed
from hexservo.run.saving import result_bytes, save_result
from hexservo.run.sealed import FORMAT, MAX_BYTES, sealed_bytes
from hexservo.scenario.calibration import camera_from_file
from hexservo.scenario.recording import MAX_SAMPLES


@pytest.fixture(scope="module")
def limited(paper: hs.Scenario) -> hs.Result:
    """A run that passes limits of both kinds."""
    return hs.simulate(paper.updated({"robot.stroke": 2e-3, "robot.force_limit": 0.2, "simulation.duration": 0.5}))


@pytest.fixture(scope="module")
def content(limited: hs.Result) -> bytes:
    return bytes(result_bytes(limited))


def saved(folder: Path, result: hs.Result) -> Path:
    path = folder / "result.nc"
    save_result(result, path)
    return path


def bits(value: Any) -> Any:
    """Something that is equal only for the same bits: NaN is itself, and 0 is not -0."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, float):
        return np.float64(value).tobytes()
    if isinstance(value, dict):
        return [(name, bits(item)) for name, item in value.items()]
    return value


def assert_same(one: hs.Result, other: hs.Result) -> None:
    for item in dataclasses.fields(hs.Result):
        assert bits(getattr(one, item.name)) == bits(getattr(other, item.name)), item.name


def edited(content: bytes, path: Path, change: Callable[[Any], None]) -> Path:
    """Write the file as another program that opens it would."""
    path.write_bytes(content)
    with h5netcdf.File(path, "a") as file:
        change(file)
    return path


def forged(result: hs.Result, path: Path, change: Callable[[xarray.Dataset], xarray.Dataset | None]) -> Path:
    """Write a file whose digest is right and whose content is another."""
    dataset = result.to_xarray().copy(deep=True)
    path.write_bytes(sealed_bytes(dataset if (other := change(dataset)) is None else other))
    return path


# ---- There and back -------------------------------------------------------------------------------------------------


def test_a_run_with_events_comes_back_bit_for_bit(limited: hs.Result, tmp_path: Path) -> None:
    assert {event.kind for event in limited.events} == {"stroke", "force"}
    loaded = hs.load_result(saved(tmp_path, limited))
    assert_same(loaded, limited)
    assert hs.metrics(loaded) == hs.metrics(limited) or any(map(math.isnan, hs.metrics(limited).values()))
    for name in ("time", "feature_error", "fuzzy_weights"):
        assert getattr(loaded, name).flags.c_contiguous
    assert loaded.to_xarray().identical(limited.to_xarray())


@pytest.mark.parametrize(
    "changes",
    [
        {"controller.jacobian": "printed"},  # diverges; no RMS error
        {"controller.law": "composite", "simulation.mode": "sampled", "camera.noise": 0.2, "simulation.duration": 0.1},
        {"camera.convention": "as_printed", "simulation.duration": 0.1},
        {"simulation.duration": 1e-3, "description": "ξ and 'quotes'"},
    ],
)
def test_other_runs_come_back_too(paper: hs.Scenario, tmp_path: Path, changes: dict[str, Any]) -> None:
    result = hs.simulate(paper.updated(changes))
    assert_same(hs.load_result(saved(tmp_path, result)), result)


def test_the_history_of_the_weights_comes_back(paper: hs.Scenario, tmp_path: Path) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.02}), log_weights=True)
    assert result.weight_history is not None
    assert_same(hs.load_result(saved(tmp_path, result)), result)

    def sample(dataset: xarray.Dataset) -> None:
        dataset["weight_history"][3, 0, 0, 0] = np.nan

    with pytest.raises(hs.ResultError, match=r"\(weight_history, which has numbers that are not finite\)"):
        hs.load_result(forged(result, tmp_path / "x.nc", sample))


def test_numbers_without_a_value_come_back(limited: hs.Result, tmp_path: Path) -> None:
    event = hs.LimitEvent("force", 6, 0.1, math.inf, 5e-324)
    odd = dataclasses.replace(
        limited,
        events=(event,),
        streamed_metrics={**hs.metrics(limited), "chatter": math.nan, "effort": math.inf, "overshoot": -0.0},
        version="0.0.1",
    )
    loaded = hs.load_result(saved(tmp_path, odd))
    assert_same(loaded, odd)
    assert loaded.version == "0.0.1"  # of the program that ran it, not of the one that reads it


def test_events_are_there_in_sentences_and_as_numbers(limited: hs.Result, content: bytes) -> None:
    with xarray.open_dataset(io.BytesIO(content), engine="h5netcdf") as dataset:
        sentences = dataset.attrs["events"].split("\n")
        head, *rows = dataset.attrs["event_table"].split("\n")
    assert sentences == [str(event) for event in limited.events]
    assert head == "kind leg time peak limit"
    for row, event in zip(rows, limited.events, strict=True):
        kind, leg, *numbers = row.split()
        assert (kind, int(leg)) == (event.kind, event.leg)
        assert tuple(map(float, numbers)) == (event.time, event.peak, event.limit)


def test_other_readers_open_the_file(limited: hs.Result, tmp_path: Path) -> None:
    """The two lines after its end do not disturb HDF5, and describe themselves (`tail -n 2`)."""
    path = saved(tmp_path, limited)
    for engine in (None, "h5netcdf"):
        with xarray.open_dataset(path, engine=engine) as dataset:
            assert dataset.load().identical(limited.to_xarray())
    with h5py.File(path, "r") as file:
        assert file["wrench"].shape == limited.wrench.shape
    *_, first, last = path.read_bytes().split(b"\n")[:-1]
    assert first == f"hexservo result, format {FORMAT}, hexservo {hs.__version__}".encode()
    content = path.read_bytes().removesuffix(last + b"\n")
    assert last == f"sha256 {hashlib.sha256(content).hexdigest()} of the {len(content)} bytes before".encode()


def test_saving_keeps_other_files_and_replaces_its_own(limited: hs.Result, tmp_path: Path) -> None:
    path = saved(tmp_path, limited)
    with pytest.raises(OutputError, match=r"the file exists; replace it with --force \(force=True in Python\)"):
        save_result(limited, path)
    other = dataclasses.replace(limited, detail="another")
    save_result(other, path, force=True)
    assert hs.load_result(path).detail == "another"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(OutputError, match="was not written by hexservo, so it is kept"):
        save_result(limited, path, force=True)
    assert [item.name for item in tmp_path.iterdir()] == ["result.nc"]


# ---- What is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("position", np.nan, "numbers that are not finite"),
        ("depth", 0.5, "not negative"),
        ("quaternion", 0.6, "not of length 1"),
        ("time", 0.0, "does not increase"),
    ],
)
def test_what_would_not_be_read_back_is_not_written(
    limited: hs.Result, tmp_path: Path, name: str, value: float, what: str
) -> None:
    array = np.full_like(getattr(limited, name), value)
    with pytest.raises(ValueError, match=f"^result: expected the data of a run, got {name}, which .*{what}"):
        dataclasses.replace(limited, **{name: array}).save(tmp_path / "run.nc")
    assert not list(tmp_path.iterdir())


def rows(result: hs.Result, kept: slice) -> dict[str, Any]:
    return {name: getattr(result, name)[kept] for name in ("time", *quantities(result.scenario.target.count))}


# what is changed in a result -> what is refused
ALTERED: dict[str, tuple[Callable[[hs.Result], dict[str, Any]], str]] = {
    "NaN": (lambda run: {"feature_error": np.full_like(run.feature_error, np.nan)}, "feature_error, which has numbers"),
    "trimmed": (lambda run: rows(run, slice(100)), "end_time, which is not the last time"),
    "empty": (lambda run: rows(run, slice(0)), "time, which has no sample"),
    "one array trimmed": (
        lambda run: {"position": run.position[:100]},
        r"position, of shape \(100, 3\) where \(501, 3\) is expected",
    ),
    "other points": (
        lambda run: {"depth": run.depth[:, :3]},
        r"depth, of shape \(501, 3\) where \(501, 4\) is expected",
    ),
    "one precision": (
        lambda run: {"wrench": run.wrench.astype(np.float32)},
        "wrench, which is not an array of float64",
    ),
    "a list": (lambda run: {"twist": run.twist.tolist()}, "twist, which is not an array of float64"),
    "another end": (lambda run: {"end_time": 5.0}, "end_time, which is not the last time"),
    "another outcome": (lambda run: {"outcome": "splendid"}, 'outcome "splendid", which is not known'),
    "no metrics": (lambda run: {"streamed_metrics": {}}, "streamed_metrics, which lacks settling_time"),
}


@pytest.mark.parametrize("change", ALTERED)
def test_a_result_that_is_no_run_is_refused_wherever_one_is_taken(
    limited: hs.Result, tmp_path: Path, change: str
) -> None:
    """And not written into a file that `load_result` would call damaged."""
    changes, words = ALTERED[change]
    altered = dataclasses.replace(limited, **changes(limited))
    uses: tuple[Callable[[hs.Result], object], ...] = (
        lambda result: result.save(tmp_path / "run.nc"),
        lambda result: hs.write_report(result, tmp_path / "report.html"),
        lambda result: hs.plots.paper_figures(result, tmp_path / "figures"),
        hs.diagnose,
        hs.plots.feature_errors,
        hs.plots.feature_paths,
        hs.plots.platform_motion,
        hs.plots.control_wrench,
        hs.plots.leg_limits,
    )
    for use in uses:
        with pytest.raises(
            ValueError, match=f"^result: expected the data of a run, got {words}.*; use what hs.simulate"
        ):
            use(altered)
    assert not list(tmp_path.iterdir())


def test_whole_numbers_among_metrics_are_saved(limited: hs.Result, tmp_path: Path) -> None:
    whole = dataclasses.replace(limited, streamed_metrics={**hs.metrics(limited), "effort": 2})
    assert hs.metrics(hs.load_result(saved(tmp_path, whole)))["effort"] == 2.0


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(hs.ResultError, match=r"none\.nc.*expected a file that can be read, got: No such file"):
        hs.load_result(tmp_path / "none.nc")
    with pytest.raises(hs.ResultError, match="null"):
        hs.load_result("a\0b")


def test_a_path_is_text_bytes_or_an_object_for_it(
    limited: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In every function that takes one; numbers would be descriptors of open files."""
    monkeypatch.setattr("hexservo.report.page.groups", lambda _: [])  # the report's findings take no path
    given: Any = os.fsencode(tmp_path / "run.nc")
    limited.save(given)
    assert_same(hs.load_result(given), limited)
    report: Any = os.fsencode(tmp_path / "run.html")
    hs.write_report(limited, report)
    scenario: Any = os.fsencode(tmp_path / "run.yaml")
    (tmp_path / "run.yaml").write_text(limited.scenario.to_yaml(), encoding="utf-8")
    assert hs.load_scenario(scenario) == limited.scenario
    packaged: Any = b"paper"
    assert hs.load_scenario(packaged) == hs.load_scenario("paper")
    number: Any = 3
    files: tuple[Callable[[], object], ...] = (
        lambda: limited.save(number),
        lambda: hs.load_result(number),
        lambda: hs.write_report(limited, number),
        lambda: hs.read_log(number),
        lambda: camera_from_file(number),
    )
    for call in files:
        with pytest.raises(TypeError, match=r"^path: expected a path, got int$"):
            call()
    folders: tuple[Callable[[], object], ...] = (
        lambda: hs.plots.paper_figures(limited, number),
        lambda: hs.load_campaign(number),
    )
    for call in folders:
        with pytest.raises(TypeError, match=r"^folder: expected a path, got int$"):
            call()


def test_an_empty_path_is_refused_as_such(limited: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`Path` takes it for the current folder, in which a campaign was written."""
    monkeypatch.chdir(tmp_path)
    vary = {"robot.mass": {"uniform": [0.05, 0.06]}}
    plan = {"scenario": limited.scenario, "vary": vary, "require": ["outcome == completed"], "runs": 1}
    doors: tuple[tuple[type[ValueError], Callable[[], object]], ...] = (
        (hs.OutputError, lambda: limited.save("")),
        (hs.OutputError, lambda: hs.write_report(limited, "")),
        (hs.OutputError, lambda: hs.plots.paper_figures(limited, "")),
        (hs.OutputError, lambda: hs.campaign(plan, "")),
        (hs.ResultError, lambda: hs.load_result("")),
        (hs.ResultError, lambda: hs.load_campaign("")),
        (hs.ScenarioError, lambda: hs.read_log("")),
        (hs.ScenarioError, lambda: camera_from_file("")),
    )
    for error, call in doors:
        with pytest.raises(error, match=r"expected a path, got an empty one$"):
            call()
    assert not list(tmp_path.iterdir())


def test_what_is_no_regular_file_is_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe would wait for its other end, and /dev/zero never ends."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
        for path, kind in [(".", "a folder"), ("pipe", "a pipe"), ("socket", "a socket"), ("/dev/zero", "a device")]:
            with pytest.raises(hs.ResultError, match=f"expected a regular file, got {kind}"):
                hs.load_result(path)
            with pytest.raises(hs.ScenarioError, match=f"expected a regular file, got {kind}"):
                hs.load_scenario(Path(path))


def test_files_without_an_end_and_beyond_any_memory(content: bytes, tmp_path: Path) -> None:
    """Sparse files, 20 GB long: the one that ends as a result does is refused for its size, unread."""
    path = tmp_path / "x.nc"
    path.write_bytes(content)
    os.truncate(path, 20 * 10**9)
    with pytest.raises(hs.ResultError, match=r"expected a file of at most 4 GiB, got 18\.6 GiB"):
        hs.load_result(path)
    os.truncate(path, MAX_BYTES)
    with pytest.raises(hs.ResultError, match="got a netCDF or HDF5 file without the digest at its end"):
        hs.load_result(path)
    os.truncate(path, 0)
    with pytest.raises(hs.ResultError, match="expected a result that hexservo saved, got another kind of file"):
        hs.load_result(path)


@pytest.mark.parametrize("other", [b"", b"name: paper\n", b"\x89HDF\r\n\x1a\n" + bytes(1000)])
def test_a_file_that_is_no_result(tmp_path: Path, other: bytes) -> None:
    (tmp_path / "x.nc").write_bytes(other)
    with pytest.raises(hs.ResultError, match=f"expected a result that hexservo saved(, format {FORMAT})?, got a"):
        hs.load_result(tmp_path / "x.nc")


def test_a_file_of_the_first_format_or_of_another_program(limited: hs.Result, tmp_path: Path) -> None:
    limited.to_xarray().to_netcdf(tmp_path / "x.nc", engine="h5netcdf")
    with pytest.raises(hs.ResultError, match=r"it is of format 1 \(hexservo 0\.1\), of another program"):
        hs.load_result(tmp_path / "x.nc")


def test_a_newer_format(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "newer.nc").write_bytes(content.replace(f"format {FORMAT}, ".encode(), b"format 77, "))
    match = f"expected a result of format {FORMAT}, got format 77, which hexservo {re.escape(hs.__version__)} wrote"
    with pytest.raises(hs.ResultError, match=match):
        hs.load_result(tmp_path / "newer.nc")


def test_whatever_another_program_changes_is_noticed(content: bytes, tmp_path: Path) -> None:
    def note(file: Any) -> None:
        file.attrs["note"] = "mine"

    def sample(file: Any) -> None:
        file.variables["wrench"][3, 2] = file.variables["wrench"][3, 2] * (1 + 2**-50)

    for change in (note, sample):
        with pytest.raises(hs.ResultError, match=r"cut off or changed since|SHA-256 of its bytes is another"):
            hs.load_result(edited(content, tmp_path / "x.nc", change))


FORGERIES: dict[str, tuple[Callable[[xarray.Dataset], Any], str]] = {
    "no attribute": (lambda data: data.attrs.pop("scenario"), "attribute scenario"),
    "text for a number": (lambda data: data.attrs.update(end_time="soon"), "attribute end_time"),
    "a number for text": (lambda data: data.attrs.update(detail=1.0), "attribute detail"),
    "another end": (lambda data: data.attrs.update(end_time=0.25), "end_time, which is not the last time"),
    "no outcome": (
        lambda data: data.attrs.update(outcome="splendid"),
        'outcome "splendid", which is not known',
    ),
    "no scenario": (lambda data: data.attrs.update(scenario="name: x"), "its scenario: ScenarioError: "),
    "no table": (lambda data: data.attrs.update(event_table="kind"), "attribute event_table"),
    "a seventh leg": (
        lambda data: data.attrs.update(event_table="kind leg time peak limit\nstroke 7 0.1 1.0 0.5"),
        "attribute event_table",
    ),
    "no variable": (lambda data: data.drop_vars("wrench"), "KeyError"),
    "no sample": (lambda data: data.isel(time=slice(0)), "time, which has no sample"),
    "NaN": (lambda data: data["twist"].data.__setitem__((2, 1), np.nan), "twist, which has numbers that are"),
    "infinity": (lambda data: data["depth"].data.__setitem__((2, 1), -np.inf), "depth, which has numbers"),
    "one precision": (lambda data: data.assign(wrench=data["wrench"].astype(np.float32)), "wrench, which is "),
    "text": (lambda data: data.assign(wrench=data["wrench"].astype(str)), "wrench, which is "),
    "five legs": (lambda data: data.isel(leg=slice(5)), r"leg_lengths, of shape \(501, 5\) where \(501, 6\) is"),
    "a transposed array": (lambda data: data.transpose(), "feature_error, of shape"),
    "time stands still": (
        lambda data: data.assign_coords(time=data.time * 0),
        "time, which does not increase",
    ),
    "time goes back": (lambda data: data.isel(time=slice(None, None, -1)), "end_time, which|time, which"),
    "no rotation": (lambda data: data.assign(quaternion=data.quaternion * 2), "quaternion, which is not of"),
    "behind the camera": (lambda data: data.assign(depth=-data.depth), "depth, which is not negative"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_right_digest_does_not_make_a_run(limited: hs.Result, tmp_path: Path, name: str) -> None:
    change, words = FORGERIES[name]

    def forge(dataset: xarray.Dataset) -> xarray.Dataset | None:
        other = change(dataset)
        return other if isinstance(other, xarray.Dataset) else None

    with pytest.raises(hs.ResultError, match=words) as caught:
        hs.load_result(forged(limited, tmp_path / "x.nc", forge))
    assert "\n" not in str(caught.value)


def test_an_array_that_only_seems_large(limited: hs.Result, tmp_path: Path) -> None:
    """A small file can hold an array of any size, of which nothing was written."""
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.create_dataset("time", shape=(10**12,), chunks=(1000,), dtype="<f8")
    with pytest.raises(hs.ResultError, match="time, which is larger than the file"):
        _parsed(content.getvalue(), "x.nc")


def test_the_damage_that_kept_hdf5_busy(content: bytes, tmp_path: Path) -> None:
    damaged = bytearray(content)
    damaged[3584 : 3584 + 512] = bytes(512)
    (tmp_path / "x.nc").write_bytes(damaged)
    with pytest.raises(hs.ResultError, match="changed or damaged"):
        hs.load_result(tmp_path / "x.nc")


@pytest.mark.slow
def test_the_largest_scenario_is_read_back(tmp_path: Path) -> None:
    """Two recordings of the most samples, in the longest numbers that are written."""
    long = -1.2345678901234567e-100
    recorded = {"kind": "recorded", "samples": [[long] * 3] * MAX_SAMPLES, "sample_period": 1e-3}
    attitudes = [[-0.9912345678901234, long, long, long]] * MAX_SAMPLES
    scenario = hs.load_scenario("real-machine").updated(
        {
            "base_motion": {**recorded, "attitudes": attitudes, "rotation": {"kind": "none"}},
            "target.motion": recorded,
            "target.frame": "world",
            "simulation.duration": 0.01,
        }
    )
    text = scenario.to_yaml()
    assert len(text) > 2_700_000
    assert hs.Scenario.from_yaml(text) == scenario
    file = tmp_path / "result.nc"
    hs.simulate(scenario).save(file)
    assert hs.load_result(file).scenario == scenario
    vary = {"robot.mass": {"uniform": [0.05, 0.06]}}
    plan = {"scenario": scenario, "vary": vary, "require": ["outcome == completed"], "runs": 1}
    (tmp_path / "plan.yaml").write_text(load_plan(plan).to_yaml(), encoding="utf-8")
    assert load_plan(tmp_path / "plan.yaml").scenario == scenario
