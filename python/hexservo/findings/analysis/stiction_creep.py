"""Creep under a smooth switching term, with inertia: what is left of the set of K_v (docs/analysis/stiction.md)."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from hexservo.findings.analysis.linear_law import acceleration_by_wrench
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, smooth_loop_at
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.analysis.stiction_set import RestSet
from hexservo.scenario.arrays import Array, Complex
from hexservo.scenario.parameters import gains_of

_GROWTH = 1.0  # exponent by which a mode may grow in a run and still be followed linearly
_PHASES = 8  # of the half period after a run, with a linear program at each
_FINER = 32  # times as many instants, at which the vertices that these find are followed
_MODES = 12  # of displacement and twist; those of devices are faster
_LARGEST = 1000  # numbers of a sampled state whose eigenvalues are still computed


@dataclass(frozen=True, eq=False)
class Creep:
    """Motion under a smooth switching term: D d-dot-dot + (K_v/width + K_d) d-dot + A d = 0, linearised.

    In sampled mode it is the loop with camera, joint sensors and actuators.
    """

    times: Array  # (12,) [s], time constants of its modes, slowest first; infinite where an error does not decay
    frequency: float  # [Hz], of the slowest mode that oscillates with less than 0.71 of critical damping; 0: none
    decay: float  # [s], its time constant; infinite where it does not decay
    # [px], largest image error from the end of a run on, from rest anywhere in the set; None where it grows too far
    left: float | None


@dataclass(frozen=True, eq=False)
class _Motion:
    """A linear motion from rest at a displacement."""

    change: Array  # (m, m) of the state over a step; in continuous mode its generator [1/s]
    start: Array  # (m, 6), states of a platform at rest at a displacement, which they begin with
    step: float  # [s]; 0 in continuous mode

    def modes(self) -> Complex:
        """Return the eigenvalues of its generator [1/s], slowest first."""
        values = np.linalg.eigvals(self.change).astype(complex)
        if self.step > 0.0:
            size = np.maximum(np.abs(values), 1e-300)  # frames that have been used leave nothing
            values = (np.log(size) + 1j * np.angle(values)) / self.step
        return values[np.argsort(-values.real)]

    def displacements(self, start: float, span: float, count: int) -> list[Array]:
        """Return the maps (6, 6) of a displacement to that after a time, at equal instants within a span [s]."""
        from scipy.linalg import expm

        if self.step > 0.0:
            steps = ceil(start / self.step - 1e-6)  # to the end of a pattern
            state = np.linalg.matrix_power(self.change, steps) @ self.start
            each, count = self.change, round(span / self.step)
        else:
            state = expm(start * self.change) @ self.start
            each = expm(span / max(count, 1) * self.change)
        found = [state[:6]]
        for _ in range(count):
            state = each @ state
            found.append(state[:6])
        return found


def creep_of(scene: Scene, rest: RestSet, goal: Poses, at_goal: Array) -> Creep:
    """Follow all displacements that K_v would hold over the run's duration: a linear map, hence linear programs.

    Parameters
    ----------
    scene, rest
        The set, whose stiffness is that of what is left.
    goal, at_goal
        The goal's pose and the stiffness there, (6, 6), of which the modes are.

    Raises
    ------
    NotApplicableError
        In sampled mode, where there is no linear loop.
    """
    duration = scene.scenario.simulation.duration
    modes = _motion(scene, goal, at_goal).modes()
    swing = _slowest_swing(modes)
    left = None if (modes.real * duration > _GROWTH).any() else _left(scene, rest, duration)
    slowest = modes[:_MODES].real
    if swing is None:
        return Creep(_time_constants(slowest), 0.0, 0.0, left)
    decay = float(_time_constants(np.array([swing.real]))[0])
    return Creep(_time_constants(slowest), float(swing.imag / (2.0 * np.pi)), decay, left)


def _time_constants(rates: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(rates < 0, -1.0 / rates, np.inf))


def _motion(scene: Scene, pose: Poses, stiffness: Array) -> _Motion:
    """Return the motion about a pose with a stiffness (6, 6)."""
    scenario, gains = scene.scenario, gains_of(scene.settings)
    if scenario.sampled:
        loop, clock = smooth_loop_at(scenario, pose)
        start = loop.resting_at(clock)
        if len(start) > _LARGEST:
            raise NotApplicableError(f"the sampled loop has {len(start)} states, and {_LARGEST} are the most")
        return _Motion(loop.pattern(clock), start, loop.seconds(clock))
    damping = gains.kv / scenario.controller.switching.width
    if scenario.controller.traits.viscous:
        damping = damping + gains.kd
    acceleration = acceleration_by_wrench(scene.probe, pose)
    change = np.block([[np.zeros((6, 6)), np.eye(6)], [-acceleration @ stiffness, -acceleration * damping]])
    return _Motion(change, np.eye(12, 6), 0.0)


def _slowest_swing(modes: Complex) -> complex | None:
    """Return the slowest mode that oscillates with a damping ratio below 0.71; None without one."""
    swings = modes[modes.imag > np.abs(modes.real)]
    return None if len(swings) == 0 else complex(swings[swings.real.argmax()])


def _left(scene: Scene, rest: RestSet, duration: float) -> float | None:
    """Return the largest image error at the end of a run and in the half period after it [px].

    All displacements start at rest, so that an oscillation takes them through zero at about the same time: the error
    at the end alone may be that of this passage.
    """
    motion = _motion(scene, rest.view.pose, rest.stiffness)
    swing = _slowest_swing(motion.modes())
    span, count = (0.0, 0) if swing is None else (np.pi / swing.imag, _PHASES * _FINER)
    stays = motion.displacements(duration, span, count)
    chosen = np.unique(np.linspace(0, len(stays) - 1, _PHASES + 1).round().astype(int))
    rows = np.vstack([rest.view.jacobian @ stays[k] for k in chosen])
    ends = rest.farthest(np.vstack([rows, -rows]))
    if ends is None:
        return None
    centre = np.linalg.solve(rest.stiffness, rest.wrench)  # where the law's wrench is zero
    from_centre = (ends - centre).T
    at_centre = (rest.error - rest.view.jacobian @ centre)[:, None]
    return max(float(np.abs(at_centre - rest.view.jacobian @ (each @ from_centre)).max()) for each in stays)
