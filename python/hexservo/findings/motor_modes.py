"""Natural motions of a platform that motors hold: second-order responses of the legs, which the platform couples."""

from __future__ import annotations

import math

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.caused import caused_by
from hexservo.scenario.arrays import Array


def motor_modes(scene: Scene) -> Array:
    """Return the responses of motors and platform to commands, at the start and at the goal, where there is one.

    To first order, without dry friction, torque limit and the weight's change with the pose: about a pose at rest
    ``M q-ddot + (kv + damping) q-dot + kp (q - q*) = 0`` of all legs, M = (H^T D^-1 H)^-1 + I_a the inertia that the
    legs move, with the payload. Its eigenvectors are motions of six legs without coupling, since kp, kv and damping are
    those of every leg, and so are feedback and integral of the law `tracking`.

    Parameters
    ----------
    scene
        Of a scenario with `actuators.kind` `position_torque`.

    Returns
    -------
    Array
        (6, 2) or (12, 2): bandwidth ``w/2 pi`` [Hz] and damping ratio [1] of each motion, as of `actuators.position`.
    """
    goals = find_goals(scene)
    poses = [scene.start, *([] if goals is None or not goals.reachable else [goals.best.view.pose])]
    motor = scene.scenario.actuators.motor
    inertia = np.concatenate([_leg_inertia(scene, pose) for pose in poses]) + motor.armature
    damping = (motor.kv + motor.damping) / (2.0 * np.sqrt(motor.kp * inertia))
    return np.column_stack([np.sqrt(motor.kp / inertia) / (2.0 * math.pi), damping])


def _leg_inertia(scene: Scene, pose: Poses) -> Array:
    """Return the platform's principal inertias in the space of the legs, (6,) [kg], of cranks [kg m^2]."""
    wrenches = scene.wrench_maps(pose)
    at = pose.repeated(1)
    mobility = wrenches.T @ caused_by(scene.probe, at.position, at.quaternion, wrenches)[0]  # of legs, by their forces
    return np.asarray(1.0 / np.linalg.eigvalsh(0.5 * (mobility + mobility.T)))
