"""Where motors that hold positions come to rest: under the weight, dry friction and the feedback of their law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array

BEGINS = 2.0
"""Times `tracking.band`: pose errors beyond it make the integral begin (docs/model.md, section 5)."""


@dataclass(frozen=True, eq=False)
class MotorRest:
    """Legs at rest beside those of the goal, without an integral: |q - q_goal + sag| <= held.

    A motor at rest gives kp (q* - q) within its friction of the weight, and q* is the goal and `feedback` times what
    the leg is behind it. So both are less by 1 + feedback.
    """

    forces: Array  # (6,), which hold the weight [N], of rotary legs [N m]
    friction: float  # [N; N m]
    stiffness: float  # kp (1 + feedback) [N/m], of rotary legs [N m/rad]

    @property
    def sag(self) -> Array:
        """Return how far the weight pulls each leg off, (6,) [m], of rotary legs [rad]."""
        return self.forces / self.stiffness

    @property
    def certain(self) -> Array:
        """Return the part of `sag` that friction does not hold, (6,)."""
        beyond = np.maximum(np.abs(self.forces) - self.friction, 0.0)
        return np.asarray(np.sign(self.forces) * beyond / self.stiffness)

    @property
    def held(self) -> float:
        """Return how far the friction holds each leg off beside that, in the same unit."""
        return self.friction / self.stiffness


def motor_rest(scene: Scene, goal: Poses) -> MotorRest:
    """Return where motors rest at a goal pose. Laws other than `tracking` have no feedback of the legs."""
    motor = scene.scenario.actuators.motor
    feedback = float(getattr(scene.scenario.controller.gains, "feedback", 0.0))
    return MotorRest(scene.resting_forces(goal), motor.friction, motor.kp * (1.0 + feedback))
