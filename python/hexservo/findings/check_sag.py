"""Motors that yield to the weight: where the law `tracking` rests beside its goal, and what integrates that away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.wording import number, quantity


@dataclass(frozen=True, eq=False)
class Sag:
    """Where motors rest under the weight at the goal, to first order, without friction."""

    legs: Array  # (6,) [m], by which the legs are off, of cranks [rad]
    pixels: float  # largest coordinate of the image error [px]
    certain: float  # the same where friction takes its part of the weight


def of_sag(scene: Scene) -> Iterator[str]:
    """Yield a sentence for motors that rest outside the settling band by the weight that they carry."""
    sag = sag_of(scene)
    if sag is None or sag.certain <= scene.band:
        return
    off = float(np.abs(sag.legs).max())
    yield (
        f"actuators.motor.kp: the weight at the goal moves a leg by {quantity(off, scene.units.coordinate)} (its force "
        f"over kp), so that the platform rests about {number(sag.pixels, 2)} px from the goal, outside of "
        f"{number(scene.band)} px, and no term of the law corrects that; take a larger kp, or "
        "controller.tracking.integral with a controller.tracking.band well below that offset"
    )


def sag_of(scene: Scene) -> Sag | None:
    """Return the offset of the law `tracking` without an integral under the weight; None for others.

    A motor at rest gives kp (q* - q), and q* is the goal and `feedback` times what the leg is behind.
    """
    scenario = scene.scenario
    gains, motor = scenario.controller.gains, scenario.actuators.motor
    of_law = isinstance(gains, Tracking) and gains.follow == "pose" and gains.integral == 0.0
    if scenario.actuators.kind != "position_torque" or not of_law or scenario.target.motion.kind != "none":
        return None
    goals = find_goals(scene)
    if goals is None or not goals.reachable:
        return None
    view = goals.best.view
    forces = scene.resting_forces(view.pose)
    held = np.sign(forces) * np.maximum(np.abs(forces) - motor.friction, 0.0)
    map_ = scene.wrench_maps(view.pose)
    stiffness = motor.kp * (1.0 + gains.feedback)
    shift, certain = (np.linalg.solve(map_.T, each / stiffness) for each in (forces, held))
    pixels = [float(np.abs(view.jacobian @ each).max()) for each in (shift, certain)]
    return Sag(forces / stiffness, pixels[0], pixels[1])
