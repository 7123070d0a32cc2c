"""The same scenario of a machine of another size: each key is scaled by its unit, and the motion in pixels is the same.

Times and pixels stay as they are. A width of the switching term counts linear and angular velocities alike, so that no
number scales it: laws whose switching term has one are not rescaled.
"""

from __future__ import annotations

from functools import cache

import numpy as np

import hexservo as hs
from hexservo import _core
from hexservo.findings.diagnosis.size import MachineSize
from hexservo.scenario.fitted import idle_gains
from hexservo.scenario.keys import sampled_keys, value_at
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.leg_units import unit_of

_WIDTH = "controller.switching.width"
_ALIKE = {"(m/s^2)^2/Hz": "m^2"}  # a unit with more than one division -> one that scales as it does


@cache
def _units() -> dict[str, str]:
    return {key.name: key.unit for law in ALL_LAWS for key in _core.scenario_keys(law)}


def is_rescalable(scenario: hs.Scenario) -> bool:
    """Whether no velocity of the scenario is both linear and angular."""
    switching = scenario.controller.switching
    return switching.kind in ("implicit", "implicit_coupled", "sign") or not np.any(
        getattr(scenario.controller.gains, "kv", 0.0)
    )


def rescaled(scenario: hs.Scenario, length: float, mass: float) -> hs.Scenario:
    """Return the scenario with lengths and masses so many times as large; gains too, of all laws."""
    assert is_rescalable(scenario), "expected a switching term without a width, which no number rescales"
    size, law = MachineSize(mass, length), scenario.controller.law
    idle = {_WIDTH, *(f"controller.{law}.{name}" for name in idle_gains(scenario))}
    if scenario.simulation.mode == "continuous":
        idle.update(sampled_keys())
    no_motors = scenario.actuators.kind != "position_torque"
    unused = ["actuators.motor."] if no_motors else []
    unused += [
        f"{block}." for block in ("base_motion", "target.motion") if value_at(scenario, f"{block}.kind") == "none"
    ]
    changes = {}
    for key, unit in _units().items():
        if key in idle or key.startswith(tuple(unused)):
            continue
        value, scale = value_at(scenario, key), size.scale(unit_of(scenario.robot, key, _ALIKE.get(unit, unit)))
        if np.asarray(value).dtype.kind in "fi" and np.any(value) and (scale != 1.0).any():
            scaled = np.asarray(value, dtype=float) * scale
            changes[key] = scaled.item() if np.ndim(value) == 0 and scaled.size == 1 else scaled.tolist()
    return scenario.updated(changes)
