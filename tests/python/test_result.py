"""What a run gives back: arrays, events, and the labelled dataset with its way to netCDF and back."""

from __future__ import annotations

import dataclasses
import gc
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import hexservo as hs
from hexservo import _core
from widths import WIDTHS

DIMENSIONS = {
    "feature_error": "feature",
    "depth": "point",
    "position": "axis",
    "quaternion": "quaternion_component",
    "twist": "twist_component",
    "wrench": "wrench_component",
    "fuzzy_output": "wrench_component",
    "leg_lengths": "leg",
    "leg_forces": "leg",
}
UNITS = {
    "time": "s",
    "feature_error": "px",
    "depth": "m",
    "position": "m",
    "quaternion": "1",
    "twist": "m/s; rad/s",
    "wrench": "N; N m",
    "fuzzy_output": "N; N m",
    "leg_lengths": "m",
    "leg_forces": "N",
    "fuzzy_weights": "N; N m",
}


@pytest.fixture(scope="module")
def result(paper: hs.Scenario) -> hs.Result:
    return hs.simulate(paper.updated({"simulation.duration": 0.5}))


@pytest.fixture(scope="module")
def limited(paper: hs.Scenario) -> hs.Result:
    """A run that passes limits of both kinds."""
    return hs.simulate(paper.updated({"robot.stroke": 2e-3, "robot.force_limit": 0.2, "simulation.duration": 0.5}))


# ---- Arrays ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["time", "fuzzy_weights", *WIDTHS])
def test_arrays_are_plain(result: hs.Result, name: str) -> None:
    array = getattr(result, name)
    shapes = {"time": (501,), "fuzzy_weights": (6, 7, 7)}
    assert array.shape == shapes.get(name, (501, WIDTHS.get(name)))
    assert array.dtype == np.float64
    assert array.flags.c_contiguous
    assert np.isfinite(array).all()


@pytest.mark.parametrize("log_weights", ["no", 1, None, np.array([1, 2])])
def test_whether_weights_are_logged_is_a_boolean(paper: hs.Scenario, log_weights: Any) -> None:
    with pytest.raises(TypeError, match=r"^log_weights: expected True or False, got"):
        hs.simulate(paper, log_weights=log_weights)


def test_the_grid(result: hs.Result, paper: hs.Scenario) -> None:
    np.testing.assert_allclose(result.time, np.arange(501) * 1e-3, rtol=1e-15, atol=0)
    assert result.end_time == result.time[-1] == 0.5
    assert result.scenario.simulation.duration == 0.5
    assert (result.outcome, result.detail) == ("completed", "ran to the end")
    np.testing.assert_array_equal(result.position[0], paper.robot.home_position)
    np.testing.assert_array_equal(result.quaternion[0], [1, 0, 0, 0])
    np.testing.assert_array_equal(result.twist[0], np.zeros(6))


@pytest.mark.parametrize(("every", "steps"), [(1, 20), (7, 20), (20, 20), (21, 20), (10**9, 20), (10, 25)])
def test_the_last_sample_is_always_logged(paper: hs.Scenario, every: int, steps: int) -> None:
    run = {"simulation.duration": steps * 1e-3}
    full = hs.simulate(paper.updated(run))
    thin = hs.simulate(paper.updated({**run, "simulation.log_every": every}))
    samples = sorted({*range(0, steps + 1, every), steps})
    for name in ["time", *WIDTHS]:
        np.testing.assert_array_equal(getattr(thin, name), getattr(full, name)[samples])


def test_features(result: hs.Result) -> None:
    assert result.features.shape == (501, 8)
    np.testing.assert_array_equal(
        result.features + result.feature_error, np.tile(result.scenario.target.desired_features, (501, 1))
    )
    scenario = result.scenario
    points = np.column_stack(
        [
            0.5 * np.array(scenario.target.initial_features, dtype=float).reshape(4, 2) / _core.Camera().focal_pixels,
            np.full(4, -0.65),
        ]
    )
    seen, depth = _core.take_image(_core.Camera(), result.position[-1], result.quaternion[-1], points)
    np.testing.assert_allclose(result.features[-1], seen, rtol=0, atol=1e-12)  # px
    np.testing.assert_allclose(result.depth[-1], depth, rtol=0, atol=1e-14)  # m


def test_legs_follow_from_the_pose_and_the_wrench(result: hs.Result) -> None:
    hexapod = _core.Hexapod(_core.robot_preset("micro"))
    for sample in range(0, 501, 50):
        pose = result.position[sample], result.quaternion[sample]
        np.testing.assert_allclose(result.leg_lengths[sample], hexapod.leg_lengths(*pose), rtol=0, atol=1e-15)
        supplied = hexapod.wrench_map(*pose) @ result.leg_forces[sample]
        np.testing.assert_allclose(supplied, result.wrench[sample], rtol=0, atol=1e-14)


def test_the_weights_at_the_end_give_the_output_at_the_end(paper: hs.Scenario) -> None:
    """Inputs that are clipped to +-1 under narrow bells fire one corner rule only, to 1e-16."""
    narrow = {"error_scale": 1e9, "rate_scale": 1e9, "bell_slope": 16, "bell_width": 0.1}
    result = hs.simulate(paper.updated({"controller.hybrid.fuzzy": narrow, "simulation.duration": 0.1}))
    depth = 1.3 * result.depth[-1]  # as the law measures it
    jacobian = _core.image_jacobian(_core.Camera(), result.features[-1], depth, result.quaternion[-1])
    g = jacobian.T @ (1e-6 * result.feature_error[-1])
    g_rate = -jacobian.T @ (1e-6 * (jacobian @ result.twist[-1]))
    for axis in range(6):
        corner = result.fuzzy_weights[axis, 6 if g[axis] > 0 else 0, 6 if g_rate[axis] > 0 else 0]
        assert result.fuzzy_output[-1, axis] == pytest.approx(corner, rel=1e-12)
    assert np.all(result.fuzzy_output[-1] != 0)


def test_arrays_outlive_the_run(paper: hs.Scenario) -> None:
    scenario = paper.updated({"simulation.duration": 0.2})
    result = hs.simulate(scenario)
    kept = {name: getattr(result, name) for name in ["time", "fuzzy_weights", *WIDTHS]}
    copies = {name: array.copy() for name, array in kept.items()}
    tails = {name: array[-3:] for name, array in kept.items()}
    del result, kept
    gc.collect()
    for _ in range(5):  # would reuse the memory
        hs.simulate(scenario.updated({"uncertainty.depth": -0.3}))
    gc.collect()
    for name, tail in tails.items():
        np.testing.assert_array_equal(tail, copies[name][-3:])


def test_a_result_is_frozen_and_compares_by_identity(result: hs.Result) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.outcome = "diverged"  # type: ignore[misc]
    assert result == result
    assert result != hs.simulate(result.scenario)
    assert "streamed_metrics" not in repr(result)


def test_simulate_takes_a_scenario_only(paper: hs.Scenario) -> None:
    for wrong in ("paper", paper.to_mapping(), None):
        with pytest.raises(TypeError, match=r"scenario: expected a Scenario .* got "):
            hs.simulate(wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "function",
    [
        lambda wrong: hs.project(wrong, np.zeros(6)),
        lambda wrong: hs.reachable(wrong, np.zeros(6)),
        hs.feedback_margin,
        hs.integral_margin,
        lambda wrong: hs.bridges.control(wrong, "plant"),
        hs.bridges.fmu,
        lambda wrong: hs.bridges.gymnasium(wrong, 2),
        hs.bridges.mjcf,
        hs.metrics,
    ],
)
def test_what_takes_a_scenario_or_a_result_takes_nothing_else(function: Callable[[Any], Any]) -> None:
    for wrong in ("paper", None):
        with pytest.raises(TypeError, match=r"^(scenario: expected a Scenario|result: expected a Result) .* got "):
            function(wrong)


# ---- Metrics and events ---------------------------------------------------------------------------------------------


def test_metrics_are_named_and_a_copy(result: hs.Result) -> None:
    metrics = hs.metrics(result)
    assert set(metrics) == set(hs.METRICS)
    assert all(isinstance(value, float) for value in metrics.values())
    assert math.isnan(metrics["rms_error"])  # the run ends before 1 s
    metrics["final_error"] = -1.0
    assert hs.metrics(result)["final_error"] >= 0.0


def test_limits_are_reported_with_time_and_peak(limited: hs.Result) -> None:
    assert limited.outcome == "completed"
    assert {event.kind for event in limited.events} == {"stroke", "force"}
    assert [event.time for event in limited.events] == sorted(event.time for event in limited.events)
    home = _core.Hexapod(_core.robot_preset("micro")).home_lengths
    values = {"stroke": np.abs(limited.leg_lengths - home), "force": np.abs(limited.leg_forces)}
    expected = {
        (kind, leg + 1): (limited.time[np.argmax(value[:, leg] > limit)], value[:, leg].max())
        for (kind, value), limit in zip(values.items(), (2e-3, 0.2), strict=True)
        for leg in range(6)
        if value[:, leg].max() > limit
    }
    assert {(event.kind, event.leg): (event.time, event.peak) for event in limited.events} == expected
    for event in limited.events:
        assert event.limit == {"stroke": 2e-3, "force": 0.2}[event.kind]


def test_events_read_as_sentences() -> None:
    stroke = hs.LimitEvent("stroke", 3, 0.25, 0.0183, 0.017)
    force = hs.LimitEvent("force", 6, 1.0, 1.25, 1.0)
    assert str(stroke) == "leg 3 exceeded its stroke of 17 mm at t = 0.25 s (peak 18.3 mm)"
    assert str(force) == "leg 6 exceeded its force limit of 1 N at t = 1 s (peak 1.25 N)"
    near = hs.LimitEvent("stroke", 3, 0.25, 0.017 * (1 + 1e-6), 0.017)
    assert str(near) == "leg 3 exceeded its stroke of 17 mm at t = 0.25 s (peak 17.00002 mm)"


# ---- The dataset ----------------------------------------------------------------------------------------------------


def test_dataset_is_labelled(result: hs.Result) -> None:
    dataset = result.to_xarray()
    assert set(dataset.data_vars) == {*WIDTHS, "fuzzy_weights"}
    for name, dimension in DIMENSIONS.items():
        assert dataset[name].dims == ("time", dimension)
        assert dataset.sizes[dimension] == WIDTHS[name]
        np.testing.assert_array_equal(dataset[name], getattr(result, name))
    assert dataset["fuzzy_weights"].dims == ("wrench_component", "error_term", "rate_term")
    np.testing.assert_array_equal(dataset["fuzzy_weights"], result.fuzzy_weights)
    for name, unit in UNITS.items():
        assert dataset[name].attrs["units"] == unit
        assert dataset[name].attrs["long_name"]
    np.testing.assert_array_equal(dataset["time"], result.time)
    assert dataset["position"].sel(axis="z")[0] == -0.15
    assert dataset["feature_error"].sel(feature="y3")[0] == result.feature_error[0, 5]
    assert list(dataset["leg"].values) == [1, 2, 3, 4, 5, 6]


def test_a_dataset_shares_no_memory_with_the_result(result: hs.Result) -> None:
    dataset = result.to_xarray()
    arrays = [result.time, result.fuzzy_weights, *(getattr(result, name) for name in DIMENSIONS)]
    for variable in dataset.variables.values():
        assert not any(np.shares_memory(variable.values, array) for array in arrays)
    before = result.position.copy()
    dataset["position"] *= 1000.0
    np.testing.assert_array_equal(result.position, before)


@pytest.mark.parametrize("name", ["result", "limited"])
def test_attributes_are_text_and_numbers(name: str, request: pytest.FixtureRequest) -> None:
    result: hs.Result = request.getfixturevalue(name)
    attributes = result.to_xarray().attrs
    assert all(isinstance(value, str | int | float) for value in attributes.values())
    assert attributes["outcome"] == "completed"
    assert attributes["end_time"] == 0.5
    assert attributes["detail"] == result.detail
    assert attributes["hexservo_version"] == hs.__version__
    assert attributes["events"].splitlines() == [str(event) for event in result.events]
    for metric, value in hs.metrics(result).items():
        assert attributes[f"metric_{metric}"] == pytest.approx(value, rel=0, abs=0, nan_ok=True)
    assert hs.Scenario.from_yaml(attributes["scenario"]) == result.scenario


@pytest.mark.parametrize("name", ["result", "limited"])
def test_netcdf_keeps_everything(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    result: hs.Result = request.getfixturevalue(name)
    dataset = result.to_xarray()
    dataset.to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as file:
        loaded = file.load()
    xarray.testing.assert_equal(loaded, dataset)  # bit for bit, labels included
    assert {key: kept(value) for key, value in loaded.attrs.items()} == {k: kept(v) for k, v in dataset.attrs.items()}
    for variable in UNITS:
        assert loaded[variable].attrs["units"] == UNITS[variable]
        assert loaded[variable].attrs["long_name"] == dataset[variable].attrs["long_name"]
    assert hs.Scenario.from_yaml(loaded.attrs["scenario"]) == result.scenario


def kept(value: Any) -> Any:
    """Make NaN equal to itself, and numpy's numbers plain."""
    return "nan" if isinstance(value, float) and math.isnan(value) else value


def test_an_unfinished_run_makes_a_dataset_too(paper: hs.Scenario, tmp_path: Path) -> None:
    result = hs.simulate(paper.updated({"controller.jacobian": "printed"}))
    assert result.outcome == "diverged"
    dataset = result.to_xarray()
    dataset.to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as file:
        assert file.attrs["outcome"] == "diverged"
        assert file.attrs["detail"] == result.detail
        assert file.sizes["time"] == len(result.time)
