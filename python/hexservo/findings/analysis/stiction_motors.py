"""What the dry friction of motors that hold positions leaves of the image error (docs/analysis/stiction.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.motor_rest import BEGINS, motor_rest
from hexservo.findings.analysis.scene import Scene, View
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import gains_of
from hexservo.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class HeldLegs:
    """Legs at rest beside those of the goal."""

    held: float  # F/(K (1 + feedback)), how far the friction holds each leg off [m]; of rotary legs [rad]
    sag: Array  # (6,), how far the weight pulls each leg off, in the same unit
    largest: float  # [px], largest image error of a coordinate over all signs of the friction, linear
    # [px], largest image error within which an integral of the law stops; None for a law without
    integrated: float | None


def rubs(scenario: Scenario) -> bool:
    """Return whether motors with dry friction hold the legs."""
    return scenario.actuators.kind == "position_torque" and scenario.actuators.motor.friction > 0.0


def held_legs(scene: Scene, goal: View) -> HeldLegs:
    """Compute how far from the goal image legs come to rest: |q - q_goal + sag| <= held.

    The law brings the image as seen from the pose that it commands, without its feedback, to the goal. That is the
    image error less J-hat H^-T (q - q_goal), with the estimated depths.
    """
    scenario = scene.scenario
    rest = motor_rest(scene, goal.pose)
    maps = scene.wrench_maps(goal.pose)
    seen = scene.jacobian(goal.features, goal.depth * (1.0 + np.asarray(scenario.uncertainty.depth)), goal.pose)
    by_leg = seen @ np.linalg.inv(maps.T)  # (2p, 6) [px/m; px/rad]
    largest = np.abs(by_leg @ rest.sag) + rest.held * np.abs(by_leg).sum(axis=1)
    gains = gains_of(scene.settings)
    integrated = None
    if getattr(gains, "integral", 0.0) > 0.0:
        integrated = float((np.abs(seen) @ (BEGINS * np.asarray(gains.band))).max())
    return HeldLegs(rest.held, rest.sag, float(largest.max()), integrated)
