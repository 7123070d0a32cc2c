"""Custom controllers: their inputs, their valid outputs, and the treatment of their errors."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo._core import Hexapod, RigidBody, robot_preset


@pytest.fixture(scope="module")
def sampled(paper: hs.Scenario) -> hs.Scenario:
    return paper.updated(
        {
            "simulation.mode": "sampled",
            "simulation.duration": 0.2,
            "controller.switching.kind": "implicit",
            "camera.latency": 0.003,
            "uncertainty.depth": 0.0,
        }
    )


GRAVITY = RigidBody().gravity_wrench


def hold(seen: hs.Observation) -> np.ndarray[Any, Any]:
    return np.asarray(GRAVITY)


def test_it_sees_every_tick_and_what_the_sensors_give(sampled: hs.Scenario) -> None:
    seen: list[hs.Observation] = []

    def watch(observation: hs.Observation) -> np.ndarray[Any, Any]:
        seen.append(observation)
        return hold(observation)

    result = hs.simulate(sampled, controller=watch)
    assert result.outcome == "completed"
    assert result.controller.endswith("watch")
    assert [observation.tick for observation in seen] == list(range(201))
    np.testing.assert_allclose([observation.time for observation in seen], result.time, rtol=1e-15)
    for observation in seen[:3]:
        assert np.isnan(observation.exposure)
        assert np.isnan(observation.features).all()
        assert np.isnan(observation.depth).all()
    for k in range(3, 201):
        assert seen[k].exposure == pytest.approx(result.time[k - 3], abs=1e-15)
        np.testing.assert_allclose(seen[k].features, result.features[k - 3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(seen[k].depth, result.depth[k - 3], rtol=0, atol=1e-15)
        assert np.array_equal(seen[k].position, result.position[k])
        assert np.array_equal(seen[k].twist, result.twist[k])
    assert not result.fuzzy_output.any()
    assert not result.fuzzy_weights.any()


def as_function(scenario: hs.Scenario) -> Callable[[hs.Observation], np.ndarray[Any, Any]]:
    """The packaged controller as a custom one, of any sensors, as README has it."""
    tick = hs.Controller(scenario, period=scenario.simulation.step)

    def step(seen: hs.Observation) -> np.ndarray[Any, Any]:
        pose = (seen.position, seen.quaternion, seen.twist)
        return tick.step(seen.pixels, seen.depth, *pose, leg_lengths=seen.leg_lengths, leg_rates=seen.leg_rates).wrench

    return step


@pytest.mark.parametrize("wrong", [[0.0, 0.0], [3.0, -2.0]])
def test_the_packaged_controller_as_a_function_is_the_law_itself(sampled: hs.Scenario, wrong: list[float]) -> None:
    smooth = sampled.updated({"controller.switching": {"kind": "tanh", "width": 0.01}, "camera.latency": 0.0})
    smooth = smooth.updated({"uncertainty.principal_point": wrong})
    own, core = hs.simulate(smooth, controller=as_function(smooth)), hs.simulate(smooth)
    np.testing.assert_allclose(own.feature_error, core.feature_error, rtol=0, atol=1e-9)
    np.testing.assert_allclose(own.wrench, core.wrench, rtol=0, atol=1e-11)
    assert hs.metrics(own) == pytest.approx(hs.metrics(core), rel=1e-9, nan_ok=True)
    assert core.controller == "hybrid"


# ---- Encoders -------------------------------------------------------------------------------------------------------

REAL = {"simulation.duration": 0.6, "simulation.log_every": 1, "metrics.rms_start": 0.5}


@pytest.mark.parametrize("keys", [{}, {"sensors.period": 0.004}, {"sensors.rate": "true"}])
def test_the_packaged_controller_as_a_function_is_the_law_with_encoders_too(keys: dict[str, Any]) -> None:
    scenario = hs.load_scenario("real-machine").updated({**REAL, **keys})
    own, core = hs.simulate(scenario, controller=as_function(scenario)), hs.simulate(scenario)
    assert own.outcome == "completed"
    np.testing.assert_allclose(own.feature_error, core.feature_error, rtol=0, atol=1e-6)
    np.testing.assert_allclose(own.wrench, core.wrench, rtol=0, atol=1e-8)


def observed(scenario: hs.Scenario) -> tuple[hs.Result, np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """A run that holds the platform, and the lengths and rates of the legs as the controller sees them, (n, 6)."""
    seen: list[hs.Observation] = []

    def hold(observation: hs.Observation) -> np.ndarray[Any, Any]:
        seen.append(observation)
        return np.asarray(GRAVITY)

    result = hs.simulate(scenario, controller=hold)
    return result, np.array([one.leg_lengths for one in seen]), np.array([one.leg_rates for one in seen])


def test_it_sees_the_legs_as_encoders_read_them() -> None:
    """The true lengths within half a step of the encoders at every fourth tick, nothing between, and true rates."""
    changes = {"sensors": {"pose": "encoders", "period": 0.004, "resolution": 1e-5, "noise": 0.0, "rate": "true"}}
    scenario = hs.load_scenario("real-machine").updated({**REAL, **changes, "simulation.duration": 0.1})
    scenario = scenario.updated({"metrics.rms_start": 0.0})
    result, lengths, rates = observed(scenario)
    read = np.arange(len(lengths)) % 4 == 0
    assert np.isnan(lengths[~read]).all()
    assert np.isnan(rates[~read]).all()
    np.testing.assert_allclose(lengths[read], 1e-5 * np.round(lengths[read] / 1e-5), rtol=0, atol=1e-12)
    assert 1e-6 < np.abs(lengths[read] - result.leg_lengths[read]).max() <= 0.5e-5 + 1e-12
    step = scenario.simulation.step
    middle = np.arange(4, len(rates) - 1, 4)
    mean = (result.leg_lengths[middle + 1] - result.leg_lengths[middle - 1]) / (2 * step)
    jerk = np.abs(np.diff(result.leg_lengths, 3, axis=0)).max() / step  # of a central difference, times six
    np.testing.assert_allclose(rates[middle], mean, rtol=0, atol=jerk)
    assert np.abs(mean).max() > 100 * jerk


def test_without_encoders_there_are_no_readings_of_legs(sampled: hs.Scenario) -> None:
    _, lengths, rates = observed(sampled.updated({"simulation.duration": 0.01}))
    assert lengths.shape == rates.shape == (11, 6)
    assert np.isnan(lengths).all()
    assert np.isnan(rates).all()


def test_a_pose_in_place_of_readings_is_refused_with_encoders(sampled: hs.Scenario) -> None:
    """It would have no effect, and no law would ever act; without encoders it is what the tick needs."""
    pose = (np.zeros(3), [1.0, 0.0, 0.0, 0.0], np.zeros(6))
    tick = hs.Controller(hs.load_scenario("real-machine"))
    refusal = r"^leg_lengths: expected 6 lengths, since sensors\.pose is encoders .* got None, and "
    with pytest.raises(ValueError, match=f"{refusal}position, quaternion, twist in their place"):
        tick.step(None, None, *pose)
    with pytest.raises(ValueError, match=f"{refusal}twist in their place"):
        tick.step(twist=np.zeros(6))
    tick.step()  # a tick without a reading
    assert tick.step(None, None, *pose, leg_lengths=np.full(6, np.nan)).status == "unusable"
    assert hs.Controller(sampled).step(None, None, *pose).status == "missing_image"


def test_leg_forces_give_the_wrench_of_the_legs(sampled: hs.Scenario) -> None:
    hexapod = Hexapod(robot_preset("micro"))

    def legs(seen: hs.Observation) -> hs.LegForces:
        return hs.LegForces(hexapod.leg_forces(seen.position, seen.quaternion, wrench(seen)))

    def wrench(seen: hs.Observation) -> np.ndarray[Any, Any]:
        return np.asarray(np.add(hold(seen), [1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]))

    one, other = hs.simulate(sampled, controller=legs), hs.simulate(sampled, controller=wrench)
    np.testing.assert_allclose(one.position, other.position, rtol=0, atol=1e-12)
    # No image, no command: G acts for three ticks, then 1 mN pushes (1 - 0.075) m along x.
    t = one.time[-1] - 0.003
    assert one.position[-1, 0] == pytest.approx(0.5 * 1e-3 / (0.925 * 0.06) * t**2, rel=1e-3)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (np.zeros(5), "got an array of shape (5,)"),
        (np.zeros((6, 1)), "got an array of shape (6, 1)"),
        (None, "got None"),
        ("up", "got 'up'"),
        (np.full(6, np.nan), "got [nan nan"),
        (hs.LegForces(np.array([0, 0, 0, 0, 0, np.inf])), "inf]"),
        (np.ones(6) * (1 + 5j), "got array([1.+5.j"),
        (
            np.ma.masked_array(np.zeros(6), mask=[False] * 5 + [True]),
            "got masked_array(data=[0.0, 0.0, 0.0, 0.0, 0.0, --]",
        ),
        (["1"] * 6, "got ['1', '1'"),
        (hs.LegForces(["1"] * 6), "got ['1', '1'"),
        (hs.LegForces([1, 2, 3]), "leg forces of 6 finite numbers"),
    ],
)
def test_a_command_that_is_none_is_refused_with_its_tick(sampled: hs.Scenario, command: Any, words: str) -> None:
    with pytest.raises(ValueError, match=r"controller: expected .* at tick 7 \(t = 0\.007 s\), got ") as caught:
        hs.simulate(sampled, controller=lambda seen: command if seen.tick == 7 else hold(seen))
    assert words in str(caught.value)


def test_leg_forces_whose_wrench_overflows_are_refused_with_their_tick(sampled: hs.Scenario) -> None:
    largest = hs.LegForces(np.full(6, 1e308))
    words = r"^controller: expected leg forces with a finite wrench at tick 7 \(t = 0\.007 s\), got \[1\.e\+308 "
    with pytest.raises(ValueError, match=words):
        hs.simulate(sampled, controller=lambda seen: largest if seen.tick == 7 else hold(seen))


def test_its_own_errors_surface_as_they_are_with_the_tick(sampled: hs.Scenario) -> None:
    class MyError(Exception):
        pass

    def fails(seen: hs.Observation) -> np.ndarray[Any, Any]:
        if seen.tick == 12:
            raise MyError("the reason")
        return hold(seen)

    with pytest.raises(MyError, match="the reason") as caught:
        hs.simulate(sampled, controller=fails)
    if hasattr(caught.value, "__notes__"):
        assert caught.value.__notes__ == ["raised by the controller at tick 12 (t = 0.012 s)"]


def test_a_run_that_diverges_is_a_result(sampled: hs.Scenario) -> None:
    result = hs.simulate(sampled, controller=lambda seen: np.full(6, 1e6))
    assert result.outcome == "diverged"
    assert result.end_time < 0.1
    assert np.isfinite(result.twist).all()


def test_ctrl_c_keeps_what_was_computed(sampled: hs.Scenario) -> None:
    def presses(seen: hs.Observation) -> np.ndarray[Any, Any]:
        if seen.tick == 50:
            os.kill(os.getpid(), signal.SIGINT)
        return hold(seen)

    result = hs.simulate(sampled, controller=presses)
    assert result.outcome == "interrupted"
    assert 0.045 <= result.end_time <= 0.055


def test_a_run_without_the_command_of_its_last_tick_is_interrupted(sampled: hs.Scenario) -> None:
    last = round(sampled.simulation.duration / sampled.simulation.step)

    def presses(seen: hs.Observation) -> np.ndarray[Any, Any]:
        if seen.tick == last:
            os.kill(os.getpid(), signal.SIGINT)
        return hold(seen)

    result = hs.simulate(sampled, controller=presses)
    assert result.outcome == "interrupted"
    assert result.end_time < sampled.simulation.duration


def test_it_is_for_sampled_mode(sampled: hs.Scenario, paper: hs.Scenario) -> None:
    with pytest.raises(ValueError, match=r"simulation\.mode: expected sampled for a custom controller"):
        hs.simulate(paper, controller=hold)
    with pytest.raises(TypeError, match="controller: expected a function of an Observation, got int"):
        hs.simulate(sampled, controller=3)  # type: ignore[arg-type]


# ---- In batches and comparisons -------------------------------------------------------------------------------------


def damp(seen: hs.Observation) -> np.ndarray[Any, Any]:
    """Hold the platform with a weight that may be wrong, and push it a little: some runs reach a limit."""
    wrench: np.ndarray[Any, Any] = hold(seen) - 0.1 * seen.twist
    wrench[0] += 0.002
    return wrench


DEPTHS = np.array([0.0, 0.1, -0.1])


@pytest.fixture(scope="module")
def stopped(sampled: hs.Scenario) -> hs.Scenario:
    """Where some of the runs of `damp` end early."""
    return sampled.updated({"robot.on_limit": "stop", "robot.stroke": 2e-3, "simulation.log_every": 7})


@pytest.mark.parametrize("log", ["final", "metrics", "trajectory"])
def test_a_batch_is_its_single_runs_bit_for_bit(stopped: hs.Scenario, log: Any) -> None:
    variations = {"uncertainty.gravity": np.array([0.0, 0.05, -0.05]), "uncertainty.depth": DEPTHS[:1]}
    progress: list[tuple[int, int]] = []
    batch = hs.simulate_batch(stopped, variations, log=log, progress=lambda *at: progress.append(at), controller=damp)
    assert progress == [(1, 3), (2, 3), (3, 3)]
    assert batch.controller == "damp"
    for index, gravity in enumerate(variations["uncertainty.gravity"]):
        run = hs.simulate(stopped.updated({"uncertainty.gravity": gravity, "uncertainty.depth": 0.0}), controller=damp)
        assert (batch.outcome[index], batch.detail(index)) == (run.outcome, run.detail)
        assert batch.end_time[index] == run.end_time
        assert {name: values[index] for name, values in batch.metrics.items()} == pytest.approx(
            hs.metrics(run), rel=0, abs=0, nan_ok=True
        )
        if log == "final":
            np.testing.assert_array_equal(batch.samples["position"][index], run.position[-1])
        if log == "trajectory":
            assert batch.time is not None
            on_grid = np.isin(np.rint(run.time / 1e-3), np.rint(batch.time / 1e-3))
            count = np.count_nonzero(on_grid)
            np.testing.assert_array_equal(batch.samples["position"][index, :count], run.position[on_grid])
            assert np.isnan(batch.samples["position"][index, count:]).all()
    assert set(batch.outcome) == {"completed", "leg_limit"}
    assert (batch.limit_leg > 0).tolist() == (batch.outcome == "leg_limit").tolist()
    assert (batch.cause == "leg_limit").tolist() == (batch.outcome == "leg_limit").tolist()


def test_a_batch_has_the_grid_and_the_shapes_of_a_batch_of_a_law(sampled: hs.Scenario) -> None:
    scenario = sampled.updated({"simulation.log_every": 7})
    for log in ("final", "metrics", "trajectory"):
        own = hs.simulate_batch(scenario, {"uncertainty.depth": DEPTHS}, log=log, controller=hold)
        law = hs.simulate_batch(scenario, {"uncertainty.depth": DEPTHS}, log=log)
        assert {name: values.shape for name, values in own.samples.items()} == {
            name: values.shape for name, values in law.samples.items()
        }
        np.testing.assert_equal(own.time, law.time)
        assert list(own.metrics) == list(law.metrics)
        assert [getattr(own, name).dtype for name in ("outcome", "cause", "limit_leg", "end_time", "stop_time")] == [
            getattr(law, name).dtype for name in ("outcome", "cause", "limit_leg", "end_time", "stop_time")
        ]


def test_a_batch_runs_in_one_thread_and_says_so(sampled: hs.Scenario, paper: hs.Scenario) -> None:
    with pytest.raises(ValueError, match=r"threads: expected 1 or None.*one thread, got 4"):
        hs.simulate_batch(sampled, {"uncertainty.depth": DEPTHS}, threads=4, controller=hold)
    with pytest.raises(ValueError, match=r"simulation\.mode: expected sampled"):
        hs.simulate_batch(paper, {"uncertainty.depth": DEPTHS}, controller=hold)
    with pytest.raises(TypeError, match="controller: expected a function"):
        hs.simulate_batch(sampled, {"uncertainty.depth": DEPTHS}, controller=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at most 2 GiB"):
        hs.simulate_batch(
            sampled.updated({"simulation.duration": 100.0}), {"seed": np.arange(100.0)}, "trajectory", controller=hold
        )


def test_ctrl_c_keeps_the_runs_of_a_batch_that_are_finished(sampled: hs.Scenario) -> None:
    runs = 0

    def presses(seen: hs.Observation) -> np.ndarray[Any, Any]:
        nonlocal runs
        runs += seen.tick == 0
        if runs == 2 and seen.tick == 50:
            os.kill(os.getpid(), signal.SIGINT)
        return hold(seen)

    batch = hs.simulate_batch(sampled, {"uncertainty.depth": DEPTHS}, controller=presses)
    assert batch.outcome.tolist() == ["completed", "interrupted", "interrupted"]
    assert np.isnan(batch.end_time).tolist() == [False, True, True]
    assert np.isnan(batch.metrics["final_error"]).tolist() == [False, True, True]


def test_an_error_of_a_controller_names_the_run_of_the_batch(sampled: hs.Scenario) -> None:
    runs = 0

    def breaks(seen: hs.Observation) -> np.ndarray[Any, Any]:
        nonlocal runs
        runs += seen.tick == 0
        if runs == 2:
            raise ZeroDivisionError("mine")
        return hold(seen)

    with pytest.raises(ZeroDivisionError, match="mine") as caught:
        hs.simulate_batch(sampled, {"uncertainty.depth": DEPTHS}, controller=breaks)
    if hasattr(caught.value, "__notes__"):
        assert caught.value.__notes__[-1] == "in scenario 1 of the batch"


def test_it_is_compared_beside_laws(sampled: hs.Scenario, paper: hs.Scenario) -> None:
    scenarios = [sampled, paper.updated({"name": "continuous", "simulation.duration": 0.05})]
    done: list[tuple[int, int]] = []
    found = hs.compare(scenarios, ["kelly"], controllers={"held": hold}, progress=lambda *at: done.append(at))
    assert found.laws == ("kelly", "held")
    assert done[-1] == (4, 4)
    row, run = found.row("held", "paper"), hs.simulate(sampled, controller=hold)
    assert row.metrics == pytest.approx(hs.metrics(run), rel=0, abs=0, nan_ok=True)
    np.testing.assert_array_equal(row.error, np.abs(run.feature_error).max(axis=1))
    assert row.verdict == "not settled"
    refused = found.row("held", "continuous")
    assert refused.outcome == "refused"
    assert "expected sampled for a custom controller" in refused.why
    assert found.row("kelly", "continuous").outcome != "refused"
    assert "| held |" in found.to_markdown()
    assert len(found.figure().axes) == 5
    assert hs.compare(scenarios[:1], [], controllers={"held": hold}).laws == ("held",)
    with pytest.raises(ValueError, match="expected names that are text and not names of laws, got 'hybrid'"):
        hs.compare(scenarios[:1], controllers={"hybrid": hold})
    with pytest.raises(TypeError, match="controllers: held: expected a function, got int"):
        hs.compare(scenarios[:1], controllers={"held": 1})  # type: ignore[dict-item]


def test_one_that_fails_is_a_row_of_a_comparison(sampled: hs.Scenario) -> None:
    """The other rows are kept; the sentence has the message and the tick."""

    def raises(seen: hs.Observation) -> np.ndarray:
        if seen.tick == 3:
            raise LookupError("no map\nof this place")
        return hold(seen)

    def gives_nan(seen: hs.Observation) -> np.ndarray:
        return np.full(6, np.nan) if seen.tick == 2 else hold(seen)

    done: list[tuple[int, int]] = []
    functions = {"raises": raises, "gives nan": gives_nan, "held": hold}
    found = hs.compare([sampled], ["kelly"], controllers=functions, progress=lambda *at: done.append(at))
    assert done[-1] == (4, 4)
    assert [row.outcome for row in found.rows] == ["completed", "failed", "failed", "completed"]
    failed = [found.row(name, "paper") for name in ("raises", "gives nan")]
    if hasattr(Exception, "add_note"):
        assert failed[0].why == "LookupError: no map of this place; raised by the controller at tick 3 (t = 0.003 s)"
    assert failed[0].why.startswith("LookupError: no map of this place")
    assert failed[1].why.startswith("ValueError: controller: expected a wrench of 6 finite numbers at tick 2 (t = ")
    for row in failed:
        assert (row.verdict, row.settled, dict(row.metrics), len(row.time)) == ("failed", False, {}, 0)
    assert "| paper | raises | failed |" in found.to_markdown()
    assert "paper,gives nan,failed,no," in found.to_csv()
    assert len(found.figure().axes) == 4


@pytest.mark.parametrize(
    ("name", "kept"), [("a\0b", r"a\x00b"), ("a\ud800", r"a\ud800"), ("a\nb", r"a\nb"), ("Größe", "Größe")]
)
def test_a_name_that_no_file_holds_is_kept_escaped(name: str, kept: str, tmp_path: Path) -> None:
    def law(seen: hs.Observation) -> list[float]:
        return [0.0] * 6

    law.__qualname__ = name
    scenario = hs.load_scenario("composite-30hz").updated({"simulation.duration": 0.02})
    result = hs.simulate(scenario, controller=law)
    assert result.controller == kept
    result.save(tmp_path / "result.nc")
    assert hs.load_result(tmp_path / "result.nc").controller == kept
    repr(result).encode()
