"""The last step from a number to a sentence: sentences have the numbers of analyses, in their unit."""

from __future__ import annotations

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.findings.analysis import drift
from hexservo.scenario.parameters import core_parameters
from without_runs import unlikely_without_runs


@pytest.mark.parametrize(
    ("along_z", "period", "mean"),
    [
        ([9.8] * 11, 0.5, "9.8"),
        ([9.8, 9.8], 5.0, "9.8"),
        ([0.0, 0.0, 12.0, 0.0], 1.0, "4"),  # a triangle
        ([12.0, 0.0, 0.0, 12.0], 1.0, "4"),  # and its halves
    ],
)
def test_a_base_gains_the_integral_of_its_recorded_acceleration(
    paper: hs.Scenario, along_z: list[float], period: float, mean: str
) -> None:
    """Of straight lines between the samples, of which there is one less; after the last one there is nothing."""
    motion = {"kind": "recorded", "samples": [[0.0, 0.0, each] for each in along_z], "sample_period": period}
    scenario = paper.updated({"simulation.mode": "sampled", "simulation.duration": 10.0, "base_motion": motion})
    cell = 0.005  # [s]; the middle of a cell has the mean of a straight line
    middles = cell * (np.arange(2000) + 0.5)
    speed = cell * _core.Probe(core_parameters(scenario)).base_acceleration(middles)[:, 2].sum()
    lasts = period * (len(along_z) - 1)
    assert speed == pytest.approx(float(mean) * lasts)
    (line,) = (line for line in unlikely_without_runs(scenario) if "mean acceleration" in line)
    assert f"their mean acceleration is (0, 0, {mean}) m/s^2" in line
    assert f"by which the base gains {speed:.3g} m/s in {lasts:.3g} s;" in line


def test_a_load_that_is_not_known_counts_with_motors_that_take_positions() -> None:
    """They yield to it, as legs that follow whatever it takes do not."""
    head = hs.load_scenario("reachy-mini-motors")
    assert head.actuators.kind == "position_torque"
    found = unlikely_without_runs(head.updated({"robot.payload": {"mass": 0.1, "known": False}}))
    (line,) = (line for line in found if line.startswith("robot.payload"))
    share = 100.0 * 0.1 / head.robot.mass
    assert f"a load of 0.1 kg, {share:.0f}% of the {head.robot.mass:.3g} kg that the controller assumes" in line


def test_a_drift_has_the_numbers_of_its_patterns() -> None:
    """Of `paper-composite`: the smaller of both limits, the place of the end, patterns at start and goal."""
    scenario = hs.load_scenario("paper-composite").updated({"uncertainty.depth": [0.3, -0.3, -0.3, 0.3]})
    found = drift.analyse(scenario)
    words = " ".join(found.section().sentences)
    assert found.limit_start is not None
    assert found.limit_goal is not None
    assert found.limit_goal < found.limit_start - 0.005
    assert f"No pattern drifts away at start and goal up to depth errors of {100 * found.limit_goal:.3g} %" in words
    assert found.own is not None
    assert found.own.end is not None
    shift, turn = (1e3 * float(np.linalg.norm(part)) for part in (found.own.end[:3], found.own.end[3:]))
    assert f"{shift:.3g}" != f"{turn:.3g}"
    assert words.count(f"s at its end, {shift:.3g} mm from home, with") == 2  # the worst pattern is the scenario's own
    for size in found.sizes:
        start, goal = size.negative_image_only
        assert start != goal
        assert f"{start} of 14 at the start and {goal} at the goal at {100 * size.size:.3g} %" in words
