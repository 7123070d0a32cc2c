"""What an inverse of the image Jacobian with a prior, or a damping, makes of the pose error.

What it leaves out of it, to first order and where the law rests, and what noise of the image it adds, to first order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.image_estimate import estimate_of_image
from hexservo.findings.analysis.rest import Rest
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.target_path import follows_direction
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import Machine
from hexservo.scenario.keys import value_at


def key_of_inverse(scene: Scene) -> str:
    """Return the key of M in the law's block; empty where its inverse has none, or it inverts nothing."""
    traits = scene.scenario.controller.traits
    return traits.inverse or ("prior" if traits.prior else "")


def weight_of_inverse(scene: Scene, key: str) -> Array:
    """Return M of (J^T W J + M)^-1 as a vector, (6,) [px^2/m^2; px^2/rad^2], from a key of the law's block."""
    return np.broadcast_to(value_at(scene.scenario, f"controller.{scene.scenario.controller.law}.{key}"), 6)


def left_by_inverse(scene: Scene, machine: Machine) -> Array:
    """Return (J^T W J + M)^-1 M x, x from home to the goal, (6,) [m; rad]: what the estimated pose error leaves out.

    To first order. With M a prior, J^T W xi-tilde = M (x - left) there, and e = 0: the image and the pull to home
    balance. With M a damping of the inverse, the law is slow from there on. Zero for a law without such an inverse;
    NaN where no pose shows the goal image, or no inverse exists.
    """
    key = _core.LAW_TRAITS[scene.scenario.controller.law].inverse
    if not key:
        return np.zeros(6)
    weight = np.diag(weight_of_inverse(scene, key))
    try:
        left = np.linalg.solve(machine.information + weight, weight @ machine.displacement)
    except np.linalg.LinAlgError:
        return np.full(6, np.nan)
    return np.asarray(left)


class Balance(NamedTuple):
    """Where the image and the pull of a prior towards home balance."""

    left: Array  # (6,) from the goal pose [m; rad]
    pixels: float  # [px], largest feature error there of a point that counts


def balance_of_prior(scene: Scene, machine: Machine) -> Balance:
    """Find where the law rests with exact depths and weight: between home and a goal that a pose shows.

    By Newton's method: where the pose error that drives fuzzy systems vanishes, or without these the sum of the
    springs. Where it finds no such pose, to first order (`left_by_inverse`).
    """
    controller, counted = scene.scenario.controller, machine.weights > 0.0
    rest = Rest(scene.scenario)
    adapts = controller.traits.memory and controller.gains.fuzzy.enabled
    of = rest.pose_error if adapts else rest.spring
    first = left_by_inverse(scene, machine)
    goal = scene.home.moved(machine.displacement)
    poses, settled = rest.settled(goal.moved(-first).rows, of=lambda poses: of(poses, exact_depth=True))
    if not settled.all():
        return Balance(first, float(np.abs(machine.jacobian @ first)[counted].max()))
    error = scene.desired - rest.image(poses)[0][0]
    return Balance(goal.displacement_from(poses[0]), float(np.abs(error)[counted].max()))


def share_of_prior(scene: Scene, machine: Machine) -> float:
    """Return the share of the largest feature error at the start with which the image and the pull to home balance.

    Of the points that count. Zero where no pose shows the goal image.
    """
    counted = machine.weights > 0.0
    left = machine.jacobian @ left_by_inverse(scene, machine)
    share = largest_share(left[counted], (scene.desired - scene.view(scene.start).features)[counted])
    return share if math.isfinite(share) else 0.0


def largest_share(part: Array, whole: Array) -> float:
    """Return the largest magnitude of a part over that of the whole."""
    return float(np.abs(part).max() / max(float(np.abs(whole).max()), 1e-300))


def legs_of_noise(scene: Scene) -> Array:
    """Return the standard deviation of the legs at the pose that the law estimates from one image, (6,) [m/px].

    Of 1 px of noise n in each coordinate at the start: the legs of (J^T W J + M)^-1 J^T W n, with all of M. Of rotary
    legs [rad/px]. Zero for a law that estimates no pose; NaN where the image gives none.
    """
    key = key_of_inverse(scene)
    inverts = key or scene.scenario.controller.traits.points
    if not inverts or follows_direction(scene.scenario):
        return np.zeros(6)
    view = scene.view(scene.start)
    units = np.repeat([1.0, view.mean_depth], 3)  # columns of one size
    jacobian = scene.of_pixels(view.features, view.jacobian) / units
    weight = weight_of_inverse(scene, key) / units**2 if key else None
    try:
        estimate = estimate_of_image(jacobian, np.square(scene.root_weights[:, 0]), weight)
    except np.linalg.LinAlgError:
        return np.full(6, np.nan)
    return np.asarray(np.linalg.norm((scene.wrench_maps(scene.start).T / units) @ estimate, axis=1))
