"""The numbers that any implementation of docs/model.md has to reproduce: section 8, law hybrid, continuous time.

The runs with `sgn` chatter, so their residuals are those of one step size: a residual is checked to 0.02 px and a time
to 2 %, as far apart as runs of other step sizes are; smooth runs are checked to 1e-9 of each printed number.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import hexservo as hs

TIME = 0.02  # relative
RESIDUAL = 0.02  # [px]


def run(scenario: hs.Scenario) -> tuple[hs.Result, dict[str, float]]:
    result = hs.simulate(scenario)
    assert result.outcome == "completed"
    assert result.end_time == pytest.approx(scenario.simulation.duration, rel=1e-12)
    return result, hs.metrics(result)


def test_the_start_is_four_parallel_shifts_of_the_goal(paper: hs.Scenario) -> None:
    desired, initial = np.array(paper.target.desired_features), np.array(paper.target.initial_features, dtype=float)
    shifts = (desired - initial).reshape(4, 2)
    np.testing.assert_array_equal(shifts, np.tile([-20.0, -8.0], (4, 1)))
    result = hs.simulate(paper.updated({"simulation.duration": 1e-3}))
    # The points are lifted and projected again: a few roundings of numbers below 100 px.
    np.testing.assert_allclose(result.feature_error[0].reshape(4, 2), shifts, rtol=0, atol=100 * 8 * 2.0**-53)


def test_the_paper(paper: hs.Scenario) -> None:
    result, metrics = run(paper)
    assert metrics["settling_time"] == pytest.approx(0.353, rel=TIME)
    assert metrics["final_error"] == pytest.approx(0.080, abs=RESIDUAL)
    assert metrics["rms_error"] == pytest.approx(0.052, abs=RESIDUAL)
    assert not result.events  # within stroke and force


def test_without_fuzzy_compensation_it_settles_far_later() -> None:
    result, metrics = run(hs.load_scenario("paper-no-fuzzy"))
    assert metrics["settling_time"] == pytest.approx(5.059, rel=TIME)
    assert metrics["final_error"] == pytest.approx(0.062, abs=RESIDUAL)
    assert not result.fuzzy_output.any()
    assert not result.fuzzy_weights.any()


def test_a_gravity_error_is_not_held() -> None:
    result, metrics = run(hs.load_scenario("paper-gravity"))
    assert math.isnan(metrics["settling_time"])
    # z points down: over-supported, the platform rises. Half a printed digit, and 1e-3 for the chatter.
    rise = result.position[0, 2] - result.position[-1, 2]
    assert rise == pytest.approx(0.1975, rel=1e-3, abs=0.5e-4)
    assert metrics["final_error"] == pytest.approx(37.58, abs=RESIDUAL)


def test_a_gravity_error_of_the_other_sign_sinks(paper: hs.Scenario) -> None:
    result, metrics = run(paper.updated({"uncertainty.gravity": -0.075}))
    assert math.isnan(metrics["settling_time"])
    assert result.position[-1, 2] - result.position[0, 2] > paper.robot.stroke


def test_reversed_model_errors_settle_as_well() -> None:
    _, metrics = run(hs.load_scenario("paper-minus"))
    assert metrics["settling_time"] < 2 * 0.353
    assert metrics["final_error"] < 0.1


def test_smooth_check(paper: hs.Scenario) -> None:
    smooth = {"controller.switching": {"kind": "tanh", "width": 1e-3}, "simulation.duration": 1.0}
    result, _ = run(paper.updated(smooth))
    np.testing.assert_allclose(
        result.feature_error[-1, :3], [-0.040221283006, 0.048431262388, 0.011688870190], rtol=1e-9, atol=0
    )
    np.testing.assert_allclose(
        1e3 * result.position[-1], [0.291648903158, 0.049231853813, -149.998341214122], rtol=1e-9, atol=0
    )


def test_the_metrics_are_those_of_the_samples(paper: hs.Scenario) -> None:
    """Each metric again from what was logged, by its definition."""
    result, metrics = run(paper)
    error = np.abs(result.feature_error).max(axis=1)
    outside = result.time[error > 2.0]
    late = result.time >= 1.0 - 1e-9
    weight = np.array([0.0, 0.0, -9.8 * paper.robot.mass, 0.0, 0.0, 0.0])
    control = np.abs(result.wrench - weight)
    turns = 2 * np.arccos(np.clip(np.abs(result.quaternion @ result.quaternion[0]), 0, 1))
    expected = {
        "settling_time": outside[-1],
        "final_error": error[-1],
        "rms_error": math.sqrt(np.mean(result.feature_error[late] ** 2)),
        "peak_error": error.max(),
        "peak_displacement": np.linalg.norm(result.position - result.position[0], axis=1).max(),
        "peak_rotation": turns.max(),
        "final_linear_speed": np.linalg.norm(result.twist[-1, :3]),
        "final_angular_speed": np.linalg.norm(result.twist[-1, 3:]),
        "peak_control_force": control[:, :3].max(),
        "peak_control_moment": control[:, 3:].max(),
        "peak_leg_force": np.abs(result.leg_forces).max(),
        "peak_leg_excursion": np.abs(result.leg_lengths - result.leg_lengths[0]).max(),
    }
    assert set(metrics) == set(hs.METRICS) == set(expected)
    for name, value in expected.items():
        # arccos of 1 - x loses half of the digits: 1e-16 / (0.07 rad)^2 at the peak
        assert metrics[name] == pytest.approx(value, rel=1e-12 if name != "peak_rotation" else 1e-12 + 1e-15 / 0.07**2)
