"""Fitted gains are for the axes one by one: what an inertia that couples the axes makes of the time to settle."""

from __future__ import annotations

import math

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import SHOWN
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import UPTAKE, auto_of

_BAND = 0.05  # of the largest image error at the start
_STEPS = 200  # in a period of the bandwidth
_PERIODS = 3.0  # in which an error has to settle, with a damping of 1


def settling_ratio(scene: Scene) -> float:
    """Return how long the image error takes to settle, over the same without products of the inertia.

    To 5 % of the error at the start, or to `metrics.band`: that of the two ratios which is farther from 1. A narrow
    band shows what a wide one hides, such as a swing that ends within 5 % and not within 1 %.

    Of the fitted gains of a law with viscous damping, from the scenario's start at rest, to first order about the goal:
    with S its spring and, of `composite` with fuzzy systems, the adaptation A as springs with an integral
    (docs/gains.md), D-bar e'' + K_d e' + S e + p = 0 with p' = A (e' + Lambda e). Of the points that count.

    1 where the law has no such damping, the inertia no products, or the start is the goal; infinite where the error
    does not settle within three periods times the damping, at least 1. NaN where it does not without products, and
    where no pose shows the goal image.
    """
    scenario = scene.scenario
    law, damping, machine = scenario.controller.law, auto_of(scenario).damping, scene.machine
    parts = _core.LAW_TRAITS[law].parts
    diagonal = np.diag(machine.inertia)
    if "damping" not in parts or "coriolis_feedforward" in parts or np.array_equal(machine.mass, diagonal):
        return 1.0
    if not np.isfinite(machine.displacement).all():
        return math.nan
    displacement = scene.home.moved(machine.displacement).displacement_from(scene.start)
    if np.abs(machine.jacobian @ displacement).max() <= SHOWN:
        return 1.0
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
    ratios = [
        _settled_at(coupled, band) / _settled_at(alone, band)
        for band in (_BAND * alone[0], scene.band)
        if band < alone[0] and math.isfinite(_settled_at(alone, band))
    ]
    return max(ratios, key=lambda ratio: abs(math.log(ratio)), default=math.nan)


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
