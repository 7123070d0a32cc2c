"""Fitted gains are for the axes one by one: what an inertia that couples the axes makes of the time to settle."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import SHOWN
from hexservo.findings.analysis.rest import Rest
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import UPTAKE, auto_of

SHARE = 0.05  # of the largest image error at the start
_STEPS = 200  # in a period of the bandwidth
_PERIODS = 3.0  # in which an error has to settle, with a damping of 1


class Settling(NamedTuple):
    """What products of the inertia make of the time to settle."""

    ratio: float  # time to settle over that without them; NaN: not known
    band: float  # in which the image error settles [px]; NaN where none is compared
    is_share: bool = False  # whether the band is `SHARE` of the error at the start, not `metrics.band`


def settling(scene: Scene) -> Settling:
    """Return how long the image error takes to settle, over the same without products of the inertia.

    To 5 % of the error at the start, or to `metrics.band`: that of the two ratios which is farther from 1. A narrow
    band shows what a wide one hides, such as a swing that ends within 5 % and not within 1 %. A band that the law is
    outside of at rest is left out.

    Of the fitted gains of a law with viscous damping, from the scenario's start at rest, to first order about the goal:
    with S its spring and, of `composite` with fuzzy systems, the adaptation A as springs with an integral
    (docs/gains.md), D-bar e'' + K_d e' + S e + p = 0 with p' = A (e' + Lambda e). Of the points that count.

    The ratio is 1 where the law has no such damping, the inertia no products, or the start is the goal; infinite where
    the error does not settle within three periods times the damping, at least 1. NaN where it does not without
    products, where the law rests outside both bands, and where no pose shows the goal image.
    """
    scenario = scene.scenario
    law, damping, machine = scenario.controller.law, auto_of(scenario).damping, scene.machine
    parts = _core.LAW_TRAITS[law].parts
    diagonal = np.diag(machine.inertia)
    if "damping" not in parts or "coriolis_feedforward" in parts or np.array_equal(machine.mass, diagonal):
        return Settling(1.0, math.nan)
    if not np.isfinite(machine.displacement).all():
        return Settling(math.nan, math.nan)
    displacement = scene.home.moved(machine.displacement).displacement_from(scene.start)
    if np.abs(machine.jacobian @ displacement).max() <= SHOWN:
        return Settling(1.0, math.nan)
    has_fuzzy = "fuzzy" in parts
    adapts = has_fuzzy and scenario.controller.gains.fuzzy.enabled
    spring = diagonal
    if not _core.LAW_TRAITS[law].pose_error:  # J^T W K_p J
        stiffness = machine.weights * np.tile(1.0 / machine.pointing, len(machine.weights) // 2)
        spring = machine.jacobian.T @ (stiffness[:, None] * machine.jacobian)
    scale = np.sqrt(np.tile(machine.inertia, (6, 1)) * machine.inertia[:, None])  # of one unit for all axes
    root = np.sqrt(machine.inertia)
    seen = machine.jacobian[machine.weights > 0.0] / root
    coupled, alone = (
        _errors(
            mass / scale,
            spring / scale,
            2.0 * damping + (UPTAKE if has_fuzzy else 0.0),  # fitted whether or not the fuzzy systems are on
            2.0 * damping * UPTAKE if adapts else 0.0,
            damping,
            seen,
            root * displacement,
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


def _errors(
    mass: Array, spring: Array, friction: float, adaptation: float, damping: float, seen: Array, start: Array
) -> Array:
    """Return the largest component of `seen @ e` from step to step, (n,) [px].

    In units in which the diagonal of the inertia is 1: `friction` is K_d, `adaptation` A.
    """
    from scipy.linalg import expm  # here, since commands that only check wait for the import longer than for the rest

    size = len(mass)
    zero, one = np.zeros_like(mass), np.eye(size)
    rate = 1.0 / (2.0 * damping)  # Lambda
    motion = np.block(
        [
            [zero, one, zero],
            np.split(-np.linalg.solve(mass, np.hstack([spring, friction * one, one])), 3, axis=1),
            [adaptation * rate * one, adaptation * one, zero],
        ]
    )
    step = 2.0 * math.pi / _STEPS * max(damping, 1.0)
    onwards = expm(step * motion)
    state = np.concatenate([start, np.zeros(2 * size)])
    errors = []
    for _ in range(int(_PERIODS * _STEPS)):
        errors.append(float(np.abs(seen @ state[:size]).max()))
        state = onwards @ state
    return np.array(errors)


def _settled_at(errors: Array, band: float) -> float:
    """Return the step from which on the errors stay within a band that they begin outside; infinite without one."""
    last = int(np.flatnonzero(errors > band)[-1])
    return float(last + 1) if last + 1 < len(errors) else math.inf
