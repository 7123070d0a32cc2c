"""Fitted gains are for the axes one by one: what an inertia that couples the axes makes of the time to settle."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import SHOWN
from hexservo.findings.analysis.image_estimate import estimate_of_image
from hexservo.findings.analysis.rest import Rest
from hexservo.findings.analysis.scene import Scene, keys_of_centre
from hexservo.findings.prior import key_of_inverse, left_by_inverse, weight_of_inverse
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import UPTAKE, Machine, auto_of
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.scenario import Scenario

SHARE = 0.05  # of the largest image error at the start
_ROUNDING = 1e-12  # of a product, over the root of its two axes' inertias
_STEPS = 200  # in a period of the bandwidth
_PERIODS = 3.0  # in which an error has to settle, with a damping of 1


class Settling(NamedTuple):
    """What products of the inertia make of the time to settle."""

    ratio: float  # time to settle over that without them; NaN: not known
    band: float  # in which the image error settles [px]; NaN where none is compared
    is_share: bool = False  # whether the band is `SHARE` of the error at the start, not `metrics.band`


class Noise(NamedTuple):
    """Largest standard deviation of a feature about rest that the camera's noise makes [px]; NaN: not known."""

    coupled: float  # with the products of the inertia
    alone: float  # without them


def has_products(machine: Machine) -> bool:
    """Return whether the inertia couples the axes, by more than rounding."""
    root = np.sqrt(machine.inertia)
    return bool(np.abs(machine.mass / (root * root[:, None]) - np.eye(6)).max() > _ROUNDING)


def causes_of_products(scenario: Scenario) -> str:
    """Return the keys by which the inertia couples the axes."""
    keys = keys_of_centre(scenario, known=True)
    bodies = {"robot": scenario.robot.inertia}
    if scenario.robot.payload.mass > 0.0 and scenario.robot.payload.known:
        bodies["robot.payload"] = scenario.robot.payload.inertia
    for key, inertia in bodies.items():
        if np.ndim(inertia) == 2 and np.count_nonzero(inertia - np.diag(np.diag(inertia))):
            keys.append(f"products in {key}.inertia")
    return " and ".join(keys) or f"unequal moments in {' and '.join(f'{key}.inertia' for key in bodies)}, rotated"


def settling(scene: Scene) -> Settling:
    """Return how long the image error takes to settle, over the same without products of the inertia.

    To 5 % of the error at the start, or to `metrics.band`: that of the two ratios which is farther from 1. A narrow
    band shows what a wide one hides, such as a swing that ends within 5 % and not within 1 %. A band that the law is
    outside of at rest is left out.

    Of the fitted gains of a law with viscous damping, from the scenario's start at rest, to first order about the goal:
    with S its spring and, of `composite` with fuzzy systems, the adaptation A as springs with an integral
    (docs/gains.md), D-bar e'' + K_d e' + S e + p = 0 with p' = A (e' + Lambda e). Of the points that count.
    What the law's inverse leaves out of its pose error (`left_by_inverse`) is no part of e, and stays in the image.

    The ratio is 1 where the law has no such damping, the inertia no products, or the start is the goal; infinite where
    the error does not settle within three periods times the damping, at least 1. NaN where it does not without
    products, where the law rests outside both bands, and where no pose shows the goal image.
    """
    scenario = scene.scenario
    law, damping, machine = scenario.controller.law, auto_of(scenario).damping, scene.machine
    parts = _core.LAW_TRAITS[law].parts
    diagonal = np.diag(machine.inertia)
    if "damping" not in parts or "coriolis_feedforward" in parts or not has_products(machine):
        return Settling(1.0, math.nan)
    if not np.isfinite(machine.displacement).all():
        return Settling(math.nan, math.nan)
    displacement = scene.home.moved(machine.displacement).displacement_from(scene.start)
    unmoved = left_by_inverse(scene, machine)
    if not np.isfinite(unmoved).all():
        return Settling(math.nan, math.nan)
    if np.abs(machine.jacobian @ displacement).max() <= SHOWN:
        return Settling(1.0, math.nan)
    spring = diagonal
    if not _core.LAW_TRAITS[law].pose_error:  # J^T W K_p J
        stiffness = machine.weights * np.tile(1.0 / machine.pointing, len(machine.weights) // 2)
        spring = machine.jacobian.T @ (stiffness[:, None] * machine.jacobian)
    root = np.sqrt(machine.inertia)
    scale = root * root[:, None]  # of one unit for all axes
    seen = machine.jacobian[machine.weights > 0.0] / root
    coupled, alone = (
        _errors(
            _motion(mass / scale, spring / scale, scenario),
            damping,
            seen,
            root * (displacement - unmoved),
            root * unmoved,
        )
        for mass in (machine.mass, diagonal)
    )
    left = _left_at_rest(scene)
    found = [
        Settling(_settled_at(coupled, band) / _settled_at(alone, band), band, is_share)
        for band, is_share in ((SHARE * float(alone[0]), True), (scene.band, False))
        if left < band < alone[0] and math.isfinite(_settled_at(alone, band))
    ]
    return max(found, key=lambda each: abs(math.log(each.ratio)), default=Settling(math.nan, math.nan))


def _left_at_rest(scene: Scene) -> float:
    """Return the largest image error of a point that counts where the law rests [px]; infinite where it is not found.

    Found by Newton's method from the goal pose: where the pose error that drives fuzzy systems vanishes, otherwise
    where springs and gravity error balance. K_v is left out.
    """
    rest, controller, machine = Rest(scene.scenario), scene.scenario.controller, scene.machine
    adapts = controller.traits.memory and controller.gains.fuzzy.enabled
    field = rest.pose_error if adapts else lambda poses: rest.spring(poses) + rest.gravity_error
    poses, settled = rest.settled(scene.home.moved(machine.displacement).rows, of=field)
    if not settled.all():
        return math.inf
    return float(np.abs(scene.desired - rest.image(poses)[0][0])[machine.weights > 0.0].max())


def noise_at_rest(scene: Scene) -> Noise:
    """Return how far the camera's noise moves the features about rest, to first order, with K_v = 0.

    Of the fitted gains of a law that regulates an estimated pose error e, by the equation of `settling` with e + w in
    place of e in spring and adaptation: w = (J^T W J + M)^-1 J^T W times white noise (`feature_noise`, held from frame
    to frame). The covariance from frame to frame solves the discrete Lyapunov equation. Zero in continuous mode and
    without noise; NaN for other laws, where no inverse exists, and where the motion is unstable from frame to frame.
    """
    from scipy.linalg import expm, solve_discrete_lyapunov  # here, as in `_errors`

    scenario, machine = scene.scenario, scene.machine
    traits, noise = _core.LAW_TRAITS[scenario.controller.law], feature_noise(scenario.camera)
    if not scenario.sampled or noise == 0.0:
        return Noise(0.0, 0.0)
    key = key_of_inverse(scene)
    if not (traits.pose_error and key and "damping" in traits.parts):
        return Noise(math.nan, math.nan)
    root = np.sqrt(machine.inertia)
    scale, seen = root * root[:, None], machine.jacobian[machine.weights > 0.0] / root
    try:
        estimate = estimate_of_image(machine.jacobian, machine.weights, weight_of_inverse(scene, key))
    except np.linalg.LinAlgError:
        return Noise(math.nan, math.nan)
    auto = auto_of(scenario)
    assert auto.bandwidth is not None
    frame = 2.0 * math.pi * auto.bandwidth * frame_period(scenario)
    found = []
    for mass in (machine.mass, np.diag(machine.inertia)):
        motion = _motion(mass / scale, np.eye(6), scenario)
        size = len(motion)
        driven = np.hstack([motion, motion[:, :6]])  # by w as by e
        held = expm(frame * np.vstack([driven, np.zeros((6, size + 6))]))[:size]
        onwards, moved = held[:, :size], held[:, size:] @ (root[:, None] * estimate)
        if np.abs(np.linalg.eigvals(onwards)).max() >= 1.0:
            return Noise(math.nan, math.nan)
        covariance = solve_discrete_lyapunov(onwards, moved @ moved.T, method="direct")[:6, :6]
        found.append(noise * math.sqrt(np.einsum("ij,jk,ik->i", seen, covariance, seen).max()))
    return Noise(*found)


def _motion(mass: Array, spring: Array, scenario: Scenario) -> Array:
    """Return the matrix of the linear equation of `settling` for (e, e', p), (18, 18); without adaptation (e, e').

    In units in which the diagonal of the inertia and omega are 1; K_d and the adaptation A are those of `fitted_gains`.
    """
    damping, has_fuzzy = auto_of(scenario).damping, "fuzzy" in _core.LAW_TRAITS[scenario.controller.law].parts
    friction = 2.0 * damping + (UPTAKE if has_fuzzy else 0.0)  # fitted whether or not the fuzzy systems are on
    zero, one = np.zeros((6, 6)), np.eye(6)
    pulled = np.split(-np.linalg.solve(mass, np.hstack([spring, friction * one, one])), 3, axis=1)
    if not (has_fuzzy and scenario.controller.gains.fuzzy.enabled):
        return np.block([[zero, one], pulled[:2]])
    adaptation, rate = 2.0 * damping * UPTAKE, 1.0 / (2.0 * damping)  # A, Lambda
    return np.block([[zero, one, zero], pulled, [adaptation * rate * one, adaptation * one, zero]])


def _errors(motion: Array, damping: float, seen: Array, start: Array, unmoved: Array) -> Array:
    """Return the largest component of `seen @ (e + unmoved)` from step to step of a motion from `start`, (n,) [px]."""
    from scipy.linalg import expm  # here, since commands that only check wait for the import longer than for the rest

    onwards = expm(2.0 * math.pi / _STEPS * max(damping, 1.0) * motion)
    state, size = np.concatenate([start, np.zeros(len(motion) - len(start))]), len(start)
    errors = []
    for _ in range(int(_PERIODS * _STEPS)):
        errors.append(float(np.abs(seen @ (state[:size] + unmoved)).max()))
        state = onwards @ state
    return np.array(errors)


def _settled_at(errors: Array, band: float) -> float:
    """Return the step from which on the errors stay within a band that they begin outside; infinite without one."""
    last = int(np.flatnonzero(errors > band)[-1])
    return float(last + 1) if last + 1 < len(errors) else math.inf
