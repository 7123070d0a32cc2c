"""How much older lost frames make the image, and what states it: against runs and sums over the frames."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import camera_rate, drift
from hexservo.scenario.parameters import image_age, oldest_image, timeout_room
from without_runs import unlikely_without_runs


def with_camera(name: str, **camera: Any) -> hs.Scenario:
    return hs.load_scenario(name).updated({f"camera.{key}": value for key, value in camera.items()})


def measured_age(scenario: hs.Scenario, seeds: range) -> float:
    """Return the mean age of the newest image over the ticks of runs [s], of those that are not too old."""
    ages = []

    def record(observed: hs.Observation) -> np.ndarray[Any, np.dtype[np.float64]]:
        ages.append(observed.time - observed.exposure)
        return np.zeros(6)

    for seed in seeds:
        hs.simulate(scenario.updated({"seed": seed}), controller=record)
    found = np.array(ages)
    oldest = np.inf if scenario.camera.timeout is None else scenario.camera.timeout + 1e-9
    return float(found[found <= oldest].mean())


@pytest.mark.parametrize("changes", [{"dropout": 0.5}, {"dropout": 0.9, "timeout": 0.6}])
def test_the_mean_age_of_an_image_is_that_of_runs(changes: dict[str, Any]) -> None:
    """Over 120 s, in which the mean of so few frames has a deviation of 3 %."""
    scenario = with_camera("slow-camera", prediction="none", **changes).updated(
        {"simulation.duration": 30.0, "simulation.step": 0.003, "robot.stroke": 1e3}
    )
    assert image_age(scenario) == pytest.approx(measured_age(scenario, range(4)), rel=0.09)


@pytest.mark.parametrize("dropout", [1e-3, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("timeout", [None, 0.3, 1.0])
def test_the_mean_age_is_the_sum_over_the_frames_that_may_be_lost(dropout: float, timeout: float | None) -> None:
    scenario = with_camera("slow-camera", dropout=dropout, timeout=timeout)
    step, period, latency = 0.001, 66, 66
    frames = np.ceil(30.0 / -np.log(dropout))  # exp(-30) of the images are older
    ages = np.arange(latency, latency + period * frames)  # [ticks], of the newest image
    share = dropout ** ((ages - latency) // period)
    used = ages * step <= (np.inf if timeout is None else timeout + 1e-9)
    mean = step * np.average(ages[used], weights=share[used])
    assert image_age(scenario) == pytest.approx(mean, rel=0.02)  # a part of a frame at the timeout is not exact
    if timeout is None:
        assert image_age(scenario) == pytest.approx(mean, rel=1e-9)


@pytest.mark.parametrize("frames", [2, 4])
def test_the_mean_age_is_exact_where_the_timeout_is_a_whole_number_of_frames(frames: int) -> None:
    """An image is used at its last tick, whose age is the timeout: of f frames of 66 ticks, 65 after its arrival."""
    ticks = 66 + 66 * frames - 1
    scenario = with_camera("slow-camera", dropout=0.5, timeout=round(0.001 * ticks, 9))
    ages = np.arange(66, ticks + 1)  # [ticks], of the newest image
    mean = 0.001 * np.average(ages, weights=0.5 ** ((ages - 66) // 66))
    assert image_age(scenario) == pytest.approx(mean, rel=1e-9)


@pytest.mark.parametrize("late", [-0.02, 0.0, 0.02])
@pytest.mark.parametrize("name", ["slow-camera", "pi-h824-positions"])
def test_the_oldest_image_is_that_of_the_shortest_timeout(name: str, late: float) -> None:
    """Which the core takes; exposure times that are late or early, and readings of the joints, are a part of it."""
    scenario = hs.load_scenario(name).updated({"camera.timeout": None, "uncertainty.latency": late})
    shortest, step = oldest_image(scenario), scenario.simulation.step
    assert timeout_room(scenario.updated({"camera.timeout": round(shortest * step, 9)})) == 0
    with pytest.raises(hs.ScenarioError, match=r"camera\.timeout: expected at least"):
        scenario.updated({"camera.timeout": round((shortest - 1) * step, 9)})


def test_the_age_has_no_wait_where_no_frame_or_every_frame_is_lost() -> None:
    assert image_age(with_camera("slow-camera", dropout=1.0)) == image_age(with_camera("slow-camera"))
    assert image_age(with_camera("slow-camera", dropout=0.9, timeout=0.14)) == pytest.approx(0.1, rel=0.05)


def test_check_names_lost_frames_that_take_damping_away() -> None:
    """With 95 % lost most runs leave the stroke; as old an image without losses is warned of as well."""
    late = with_camera("pi-h824", prediction="none", dropout=0.95)
    (sentence,) = (each for each in unlikely_without_runs(late) if "half of the damping" in each)
    assert "an image that takes effect 328 ms late" in sentence
    ends = [hs.metrics(hs.simulate(late.updated({"seed": seed})))["peak_leg_excursion"] for seed in range(6)]
    assert np.median(ends) > late.robot.stroke
    assert not any("damping" in each for each in unlikely_without_runs(late.updated({"camera.dropout": 0.0})))


def test_a_drift_with_prediction_has_the_age_of_lost_frames() -> None:
    for dropout, age in ((0.0, "98.5 ms"), (0.9, "693 ms")):
        (section,) = hs.analyse(with_camera("slow-camera", dropout=dropout), ["drift"]).sections()
        assert any(f"carried on over {age}, its mean age" in each for each in section.sentences)


def test_a_run_with_lost_frames_creeps_with_the_longer_time_constant() -> None:
    """With 85 % lost, half the rate of a camera that loses none; six seeds have a deviation of 1.5 %."""
    camera = {"period": 0.066, "latency": 0.066, "prediction": "encoder", "dropout": 0.85}
    scenario = hs.load_scenario("paper-composite").updated(
        {
            "simulation": {"mode": "sampled", "step": 0.002, "duration": 100.0, "log_every": 500},
            "camera": camera,
            "controller.switching.kind": "implicit",
            "controller.composite.kv": 0.0,
            "uncertainty.depth": [0.3, -0.3, -0.3, 0.3],
        }
    )
    own = drift.analyse(scenario).own
    assert own is not None
    assert own.end is not None
    rates = []
    for seed in range(6):
        run = hs.simulate(scenario.updated({"seed": seed}))
        gap = np.linalg.norm(run.position - run.position[0] - own.end[:3], axis=1)
        rates.append(np.log(gap[30] / gap[90]) / 60.0)
    assert own.end_rate == pytest.approx(float(np.mean(rates)), rel=0.05)
    without_losses = drift.analyse(scenario.updated({"camera.dropout": 0.0})).own
    assert without_losses is not None
    assert own.end_rate < 0.55 * without_losses.end_rate


def test_the_camera_is_judged_with_the_wait_for_lost_frames() -> None:
    found = camera_rate.analyse(with_camera("pi-h824", prediction="none"))
    assert found.section().verdict == "good"
    words = {}
    for dropout, verdict, late, side in ((0.9, "good", "160 ms", "inside"), (0.95, "warning", "320 ms", "beyond")):
        lost = dataclasses.replace(found, scenario=found.scenario.updated({"camera.dropout": dropout}))
        section = lost.section()
        assert section.verdict == verdict
        words[dropout] = " ".join(section.sentences)
        assert f"a latency that is longer by that, {late}, is {side} the limit" in words[dropout]
    assert "on average they make the image 304 ms older (camera.dropout)" in words[0.95]
