"""How far behind a target that swings the law `tracking` is: the gains that `check` uses, against runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_tracking import of_tracking, steady_filter, swing_of
from hexservo.findings.target_swing import alpha_beta_gains
from hexservo.scenario.laws import Tracking

CERTAINTY = "controller.tracking.certainty"


def swinging(amplitude: float, frequency: float, changes: dict[str, Any] | None = None) -> hs.Scenario:
    """Return a hexapod whose target swings along x [m; Hz]."""
    return hs.load_scenario("pi-h824-positions").updated(
        {
            "target.motion": {"kind": "sinusoid", "amplitude": [amplitude, 0.0, 0.0], "frequency": frequency},
            "simulation.duration": 12.0,
            **(changes or {}),
        }
    )


def largest_error(scenario: hs.Scenario) -> float:
    """Return the largest feature error of the second half of a run [px]."""
    error = np.abs(hs.simulate(scenario).feature_error).max(axis=1)
    return float(error[len(error) // 2 :].max())


def gains_of(scenario: hs.Scenario) -> Tracking:
    gains = scenario.controller.gains
    assert isinstance(gains, Tracking)
    return gains


def test_the_gains_of_the_filter_are_those_of_its_recursion() -> None:
    scenario = swinging(0.004, 1.0)
    filtered = steady_filter(scene_of(scenario), gains_of(scenario))
    period, angle = 0.02, 0.3
    alpha = (filtered.place / filtered.reading) ** 2
    beta = 2.0 * (2.0 - alpha) - 4.0 * np.sqrt(1.0 - alpha)
    x, v = np.zeros(6, dtype=complex), np.zeros(6, dtype=complex)
    for frame in range(4000):
        z = np.exp(1j * angle * frame)
        expected = x + period * v
        x, v = expected + alpha * (z - expected), v + beta / period * (z - expected)
    place, velocity = alpha_beta_gains(filtered, angle, period)
    np.testing.assert_allclose(x / z, place, rtol=1e-6)
    np.testing.assert_allclose(v / z, velocity, rtol=1e-6)


SWINGS: list[tuple[float, float, dict[str, Any]]] = [
    (0.004, 0.5, {}),
    (0.004, 1.0, {}),
    (0.002, 2.0, {}),
    (0.004, 1.0, {"controller.tracking.bandwidth": 1.0, "controller.tracking.auto": None}),
    (0.004, 1.0, {"controller.tracking.lead": 0.0}),
    (0.004, 1.0, {"camera.latency": 0.1}),
    (0.004, 0.5, {"camera.period": 0.2}),
    (0.002, 2.0, {"camera.period": 0.1}),
]


@pytest.mark.parametrize(("amplitude", "frequency", "changes"), SWINGS)
def test_what_is_left_of_a_swing_with_every_velocity_is_that_of_runs(
    amplitude: float, frequency: float, changes: dict[str, Any]
) -> None:
    """Within a fifth of runs without noise: what the platform's own motion leaves in the filter is a mean."""
    free = {"actuators.position.speed_limit": None, "camera.noise": 0.0, "sensors.resolution": 0.0}
    scenario = swinging(amplitude, frequency, {**free, CERTAINTY: 0.0, **changes})
    left = swing_of(scene_of(scenario), gains_of(scenario)).behind()
    run = largest_error(scenario)
    print(f"{left:.2f} px, run {run:.2f} px")
    assert left == pytest.approx(run, rel=0.2)


def test_a_certainty_of_0_is_named_where_it_helps() -> None:
    scenario = swinging(0.004, 0.5, {"controller.tracking.noise": 2.0})
    (sentence,) = of_tracking(scene_of(scenario))
    print(sentence)
    assert sentence.startswith(CERTAINTY)
    assert largest_error(scenario.updated({CERTAINTY: 0.0})) < 0.8 * largest_error(scenario)


@pytest.mark.parametrize("certainty", [2.5, 0.0])
def test_a_swing_faster_than_the_law_is_named_whatever_counts(certainty: float) -> None:
    """The platform is farther from the goal than one that stands still, and a certainty of 0 is no remedy."""
    changes = {
        "camera.latency": 0.2,
        CERTAINTY: certainty,
        "controller.tracking.bandwidth": 1.0,
        "controller.tracking.auto": None,
    }
    scenario = swinging(0.002, 2.0, changes)
    (sentence,) = of_tracking(scene_of(scenario))
    print(sentence)
    assert sentence.startswith("target.motion.frequency")
    assert "a platform that stands still would have" in sentence
    assert CERTAINTY not in sentence
    still = swing_of(scene_of(scenario), gains_of(scenario)).of_target
    assert largest_error(scenario) > still
