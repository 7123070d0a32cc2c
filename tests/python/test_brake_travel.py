"""How far the legs go while the brake stops them with the gains that `check` proposes: closed form and runs."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_brake import of_brake
from test_check_brake import DAMPING, machine, pasted

METRES = {"um": 1e-6, "mm": 1e-3}
NEEDS_MUCH: dict[str, Any] = {DAMPING: [500.0] * 3 + [1.5, 1.5, 3.0], "simulation.start.twist": [0, 0, 0.05, 0, 0, 0]}


@pytest.mark.parametrize("limit", [11.0, 13.0])
def test_the_legs_stop_as_far_as_critically_damped_axes_do(limit: float) -> None:
    """From a speed v these go at most v/(e w), with damping 2 w m and hold w^2 m, after 3/2 periods.

    By so much the rates are late that differences of readings and the tick have.
    """
    scenario = machine({**NEEDS_MUCH, "robot.force_limit": limit})
    (note,) = of_brake(scene_of(scenario))
    stated = re.search(r"of a run, (\S+) mm/s; .*the legs stop within (\S+) (um|mm)$", note)
    assert stated is not None
    speed, way = 1e-3 * float(stated[1]), float(stated[2]) * METRES[stated[3]]
    damping, hold = pasted(note).values()
    late = 1.5 * scenario.simulation.step * speed
    np.testing.assert_allclose(way, speed / (math.e * 2.0 * hold / damping) + late, rtol=0.05)  # of two digits

    blind = scenario.updated(
        {
            **{key: gains.tolist() for key, gains in pasted(note).items()},
            "camera.dropout": 1.0,
            "sensors.resolution": 0.0,
            "simulation.duration": 0.5,
            "robot.force_limit": 100.0,
        }
    )
    run = hs.simulate(blind)
    travel = float(np.abs(run.leg_lengths - run.leg_lengths[0]).max())
    assert 0.95 * (way - late) < travel < 1.05 * way
