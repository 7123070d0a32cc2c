"""Ticks of a simulated run, given to a controller one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import hexservo as hs
from hexservo import _core
from hexservo.scenario.parameters import core_parameters

Array = NDArray[Any]


def ticks_of(scenario: hs.Scenario) -> dict[str, Array]:
    """What the controller of a run was given at each tick, and what it answered, by name; a row per tick."""
    return _core.recorded_ticks(core_parameters(scenario))


def step(controller: hs.Controller, ticks: dict[str, Array], k: int) -> hs.ControllerOutput:
    """Give a controller what that of the run was given at tick k."""
    frame = bool(np.isfinite(ticks["exposure"][k, 0]))
    return controller.step(
        ticks["features"][k] if frame else None,
        ticks["depth"][k] if frame else None,
        *(ticks[name][k] for name in ("position", "quaternion", "twist")),
        exposure=float(ticks["exposure"][k, 0]) if frame else None,
        leg_lengths=ticks["leg_lengths"][k],
        leg_rates=ticks["leg_rates"][k],
    )
