"""Results read back from their files: bit for bit, and nothing else."""

from __future__ import annotations

import dataclasses
import io
import math
import re
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest
import xarray

import hexservo as hs
from hexservo._saved import FORMAT, netcdf_bytes


@pytest.fixture(scope="module")
def limited(paper: hs.Scenario) -> hs.Result:
    """A run that passes limits of both kinds."""
    return hs.simulate(paper.updated({"robot.stroke": 2e-3, "robot.force_limit": 0.2, "simulation.duration": 0.5}))


@pytest.fixture(scope="module")
def content(limited: hs.Result) -> bytes:
    return bytes(netcdf_bytes(limited.to_xarray()))


def saved(folder: Path, result: hs.Result) -> Path:
    path = folder / "result.nc"
    path.write_bytes(netcdf_bytes(result.to_xarray()))
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


def changed(content: bytes, path: Path, change: Any) -> Path:
    path.write_bytes(content)
    with h5netcdf.File(path, "a") as file:
        change(file)
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

    def sample(file: Any) -> None:
        file.variables["weight_history"][3, 0, 0, 0] = 1.0

    with pytest.raises(hs.ResultError, match="its checksum is another"):
        hs.load_result(changed((tmp_path / "result.nc").read_bytes(), tmp_path / "x.nc", sample))


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


# ---- What is refused ------------------------------------------------------------------------------------------------


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(hs.ResultError, match=r"none\.nc.*expected a file that can be read, got: No such file"):
        hs.load_result(tmp_path / "none.nc")
    with pytest.raises(hs.ResultError, match="expected a file that can be read, got: Is a directory"):
        hs.load_result(tmp_path)
    with pytest.raises(hs.ResultError, match="null"):
        hs.load_result("a\0b")


@pytest.mark.parametrize("other", [b"", b"name: paper\n", b"\x89HDF\r\n\x1a\n" + bytes(1000)])
def test_a_file_that_is_no_netcdf(tmp_path: Path, other: bytes) -> None:
    (tmp_path / "x.nc").write_bytes(other)
    with pytest.raises(hs.ResultError, match=r"expected a result\.nc of `hexservo run --out`, got"):
        hs.load_result(tmp_path / "x.nc")


def test_a_netcdf_file_of_something_else(tmp_path: Path) -> None:
    xarray.Dataset({"time": ("time", [1.0, 2.0])}).to_netcdf(tmp_path / "x.nc", engine="h5netcdf")
    with pytest.raises(hs.ResultError, match="got a netCDF file of something else"):
        hs.load_result(tmp_path / "x.nc")


def test_another_format(content: bytes, tmp_path: Path) -> None:
    def newer(file: Any) -> None:
        file.attrs["format"] = FORMAT + 1

    def none(file: Any) -> None:
        del file.attrs["format"]

    with pytest.raises(hs.ResultError, match=f"expected a result of format {FORMAT}, got format {FORMAT + 1}, which"):
        hs.load_result(changed(content, tmp_path / "newer.nc", newer))
    with pytest.raises(hs.ResultError, match=f"expected a result of format {FORMAT}, got one without"):
        hs.load_result(changed(content, tmp_path / "older.nc", none))


def test_what_was_changed_is_noticed(content: bytes, tmp_path: Path) -> None:
    def sample(file: Any) -> None:
        file.variables["wrench"][3, 2] = file.variables["wrench"][3, 2] * (1 + 2**-50)

    def metric(file: Any) -> None:
        file.attrs["metric_final_error"] = 0.0

    def text(file: Any) -> None:
        file.attrs["event_table"] = file.attrs["event_table"].replace("\nstroke ", "\nforce ", 1)

    def kind(file: Any) -> None:
        file.attrs["end_time"] = "soon"

    def missing(file: Any) -> None:
        del file.attrs["scenario"]

    for change in (sample, metric, text, kind, missing):
        with pytest.raises(hs.ResultError, match=r"expected a result as hexservo wrote it, got one that was changed"):
            hs.load_result(changed(content, tmp_path / f"{change.__name__}.nc", change))


def test_what_does_not_matter_may_be_added(limited: hs.Result, content: bytes, tmp_path: Path) -> None:
    def note(file: Any) -> None:
        file.attrs["note"] = "mine"

    assert_same(hs.load_result(changed(content, tmp_path / "x.nc", note)), limited)


def test_a_damaged_file_is_refused_or_reads_the_same(limited: hs.Result, content: bytes, tmp_path: Path) -> None:
    """Truncated, and with flipped bytes at places drawn at random: never another result, never another error."""
    seed = 20261121
    generator = np.random.default_rng(seed)
    refused = 0
    for trial in range(40):
        damaged = bytearray(content)
        if trial % 4 == 0:
            damaged = damaged[: int(generator.integers(len(content)))]
        else:
            for place in generator.integers(len(content), size=20):
                damaged[place] ^= int(generator.integers(1, 256))
        (tmp_path / "x.nc").write_bytes(damaged)
        problem = ""
        try:
            loaded = hs.load_result(tmp_path / "x.nc")
        except hs.ResultError as error:
            problem = str(error)
        if problem:
            refused += 1
            told = re.fullmatch(r'".*x\.nc": (expected|its scenario).*', problem)
            assert told, f"seed {seed}, trial {trial}: {problem}"
        else:
            assert_same(loaded, limited)
    assert refused > 20
