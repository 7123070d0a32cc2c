"""Law and plant in continuous time, linear at home: the poles of a loop, and how the image comes to its goal."""

from __future__ import annotations

import contextlib
import math

import numpy as np

from hexservo.findings.analysis.drift_rates import exponential
from hexservo.findings.analysis.linear_law import LinearLaw, NotFiniteError, linear_law, linear_plant
from hexservo.findings.analysis.linear_loop import BORDER, Clock, SampledLoop
from hexservo.findings.analysis.loop_of_scenario import quiet, rates_without_mass
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.check_keys import has_slope
from hexservo.scenario.arrays import Array, Complex
from hexservo.scenario.pixels import on_pinhole

_SAMPLES = 200  # of the image error in a run
_SETTLED = 10.0  # time constants in which a motion is over


def poles_at_home(scene: Scene) -> Complex:
    """Return the poles of law and plant [1/s], in continuous time, linear at home.

    The law is that of the servo tick with a fresh image (`linear_law`), the plant the actual one (`linear_plant`); the
    weights of the fuzzy systems are constant. `tanh` and `saturation` have their slope at rest; otherwise
    K_v = 0, since dry friction has no pole. Where drives take positions, a law of a platform without mass moves it
    at a twist, and a law whose output is a pose has the double pole of its reference.

    Raises
    ------
    NoRestError
        The law cannot be evaluated at home.
    NotFiniteError
        A `NoRestError`: the gains are so large that the law or the loop overflows.
    """
    controller = scene.scenario.controller
    if controller.traits.output == "pose":
        return np.full(2, -2.0 * math.pi * float(controller.gains.bandwidth), dtype=complex)
    with np.errstate(over="ignore", invalid="ignore"), contextlib.suppress(np.linalg.LinAlgError):  # refused below
        poles = np.linalg.eigvals(_matrix(scene, smooth=has_slope(scene.scenario), adapts=False)).astype(complex)
        if np.isfinite(poles).all():
            return poles
    raise NotFiniteError("controller: expected gains that give finite poles, got poles that are not finite")


def image_errors(scene: Scene) -> list[float]:
    """Return the least image errors in a run, as shares of that at the start, by the linear loop at home.

    Without the adaptation of the fuzzy systems, and with it where there is one. An error is the largest coordinate of
    the points that count, by home's Jacobian, from the start to the goal. The switching term, which can only hold the
    platform, is left out. 1 where nothing pulls to the goal. NaN for a start at the goal, and where the error doubles:
    the loop is unstable.

    Raises
    ------
    NoRestError
        The law cannot be evaluated at home.
    """
    state_matrix, state = _matrix(scene, smooth=False, adapts=True), start_at_home(scene)
    jacobian = np.asarray(scene.view(scene.home).jacobian)[scene.machine.weights > 0.0]
    if scene.scenario.moves_without_mass:
        state = state[:6]
    state = np.append(state, np.zeros(len(state_matrix) - len(state)))
    sizes = sorted({min(len(state), 12), len(state)})
    duration = scene.scenario.simulation.duration
    return [_least_share(state_matrix[:n, :n], state[:n], jacobian, duration) for n in sizes]


def start_at_home(scene: Scene) -> Array:
    """Return displacement from the goal and twist at the start, (12,) [m; rad; m/s; rad/s]."""
    start: Array = scene.start.displacement_from(scene.home) - scene.machine.displacement
    if not np.isfinite(start).all():  # no pose shows the goal image
        counted = scene.machine.weights > 0.0
        seen = (scene.view(scene.start).features - scene.desired)[counted]
        start = np.asarray(np.linalg.lstsq(np.asarray(scene.view(scene.home).jacobian)[counted], seen, rcond=None)[0])
    return np.append(start, scene.settings["simulation.start.twist"])


def largest_motion(scene: Scene) -> Array:
    """Return the largest displacements from the goal, and rates, of the loop without adaptation, (12,).

    In ten of its longest time constants. Of a platform with mass.

    Raises
    ------
    NoRestError
        The law cannot be evaluated at home.
    """
    state_matrix, state = _matrix(scene, smooth=False, adapts=False), start_at_home(scene)
    slowest = float(np.abs(np.linalg.eigvals(state_matrix).real).min())
    step = exponential(_SETTLED / (_SAMPLES * max(slowest, 1e-12)) * state_matrix)
    largest = np.abs(state)
    for _ in range(_SAMPLES):
        state = step @ state
        largest = np.maximum(largest, np.abs(state))
    return largest


def _least_share(state_matrix: Array, state: Array, jacobian: Array, duration: float) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        generator = duration / _SAMPLES * state_matrix
        if not np.isfinite(np.abs(generator).sum(axis=1)).all():
            return math.nan
        step = exponential(generator)
    errors = [float(np.abs(jacobian @ state[:6]).max())]
    with np.errstate(over="ignore", invalid="ignore"):  # of loops that grow
        for _ in range(_SAMPLES):
            state = step @ state
            errors.append(float(np.abs(jacobian @ state[:6]).max()))
    return min(errors) / errors[0] if 0.0 < max(errors) < 2.0 * errors[0] else math.nan


def _matrix(scene: Scene, *, smooth: bool, adapts: bool) -> Array:
    """Return the state matrix over displacement and twist, and the outputs of the fuzzy systems that adapt [1/s].

    Over the displacement alone for a platform without mass.
    """
    if scene.scenario.moves_without_mass:
        return rates_without_mass(scene.scenario, scene.home)
    calm = on_pinhole(quiet(scene.scenario))  # the linear law is of features
    law = linear_law(calm, scene_of(calm), scene.home, smooth=smooth)
    whole = adapting_matrix(law, linear_plant(calm, scene.home).acceleration, calm.simulation.step)
    return whole if adapts else whole[:12, :12]


def adapting_matrix(law: LinearLaw | SampledLoop, push: Array, tick: float) -> Array:
    """Return the state matrix of law and plant in continuous time, with true images and sensors [1/s].

    Over displacement, twist and the outputs of the fuzzy systems that adapt.

    Parameters
    ----------
    law
        Linear, of a platform with six degrees of freedom.
    push
        Acceleration by a wrench, (6, 6).
    tick
        Servo period [s], in which the law's weights move by its `drive_frame`, `drive_pose` and `drive_twist`.
    """
    by_pose, by_twist = push @ (law.frame[:, :6] + law.pose), push @ law.twist
    motion = np.block([[np.zeros((6, 6)), np.eye(6)], [by_pose, by_twist]])
    axes = list(law.axes)
    outputs = np.vstack([np.zeros((6, len(axes))), -push[:, axes]])
    driven = np.hstack([law.drive_frame[:, :6] + law.drive_pose, law.drive_twist]) / tick
    return np.block([[motion, outputs], [driven, np.diag((law.decay - 1.0) / tick)]])


def oscillates(loop: SampledLoop, clock: Clock | None) -> bool:
    """Return whether a mode of a loop grows that is no drift (real, and positive); without a clock, in no ticks."""
    with np.errstate(over="ignore", invalid="ignore"):
        if clock is None:
            exponents = np.linalg.eigvals(adapting_matrix(loop, loop.acceleration, loop.tick))
            return bool(((exponents.real > (BORDER - 1.0) / loop.tick) & (np.abs(exponents.imag) > 0.0)).any())
        try:
            values = loop.multipliers(clock)
        except np.linalg.LinAlgError:  # numbers overflow
            return True
    return bool(((np.abs(values) > BORDER) & ((np.abs(values.imag) > 1e-9) | (values.real < 0.0))).any())
