"""The last step from a number to a sentence: sentences have the numbers of analyses, in their unit."""

from __future__ import annotations

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.findings.check import unlikely
from hexservo.scenario.parameters import core_parameters


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
    (line,) = (line for line in unlikely(scenario) if "mean acceleration" in line)
    assert f"their mean acceleration is (0, 0, {mean}) m/s^2" in line
    assert f"by which the base gains {speed:.3g} m/s in {lasts:.3g} s;" in line
