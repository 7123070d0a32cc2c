"""Runge-Kutta stages of a run, rebuilt from its samples: pose, twist and acting wrench."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo import _core
from hexservo.findings.certificate.replay import Replay
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.motion import moves
from hexservo.scenario.parameters import core_parameters

STAGE_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
"""Of the classic Runge-Kutta method, which are those of its quadrature too."""

_CHUNK = 2048  # steps at a time: what they need stays in the processor's cache, or near it

# of steps that the core repeats, under its names
_TAKEN = (
    *("features", "depth", "position", "quaternion", "twist", "wrench", "fuzzy_output", "acceleration"),
    *("next_position", "next_quaternion", "next_twist"),
)


@dataclass(frozen=True, eq=False)
class Stages:
    """The stages of m consecutive steps of the integration; a servo period may have several."""

    tick: NDArray[np.intp]  # (m,) sample at or before the start of each
    step: float  # [s]
    features: Array | None  # (m, 4, 2p) [px]; None for a camera that has no points in sampled mode
    depth: Array | None  # (m, 4, p) true ones [m]
    position: Array  # (m, 4, 3) [m]
    quaternion: Array  # (m, 4, 4), of any length
    twist: Array  # (m, 4, 6) [m/s; rad/s]
    wrench: Array  # (m, 4, 6) of the actuators [N; N m]
    fuzzy_output: Array | None  # (m, 4, 6) of the law inside the stages [N; N m]; None in sampled mode
    base: Array | None  # (m, 4, 6) inertial wrench of a base that moves [N; N m]
    acceleration: Array  # (m, 4, 6) [m/s^2; rad/s^2]
    start_quaternion: Array  # (m, 4)
    start_twist: Array  # (m, 6)
    next_position: Array  # (m, 3) after each step: the next sample, at the end of a period
    next_quaternion: Array  # (m, 4), likewise
    next_twist: Array  # (m, 6)
    to_sample: bool  # whether the steps end at samples

    def rows(self, name: str) -> Array:
        """Return a quantity with one row per stage, (4 m, k)."""
        value = getattr(self, name)
        return np.ascontiguousarray(value.reshape(-1, value.shape[-1]))

    def finite(self) -> Stages:
        """Return the steps whose numbers are all finite: of a run that diverges, longer steps may leave the floats."""
        arrays: dict[str, Any] = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        rows: Mask = np.ones(len(self.tick), dtype=bool)
        for value in arrays.values():
            rows &= np.isfinite(value).reshape(len(rows), -1).all(axis=1)
        return self if rows.all() else replace(self, **{name: value[rows] for name, value in arrays.items()})


def stages_of(run: Replay) -> Iterator[Stages]:
    """Return the stages of all steps between the run's samples, some at a time."""
    for first in range(0, len(run.time) - 1, _CHUNK):
        ticks = np.arange(first, min(first + _CHUNK, len(run.time) - 1))
        if run.continuous:
            yield _continuous(run, ticks, run.probe, run.step)
        else:
            yield from _sampled(run, ticks)


def doubled_stages_of(run: Replay) -> Iterator[Stages]:
    """Return the stages of steps twice as long, from every other sample of a run in continuous mode."""
    settings = core_parameters(run.scenario)
    settings["simulation.step"] = 2 * run.step
    settings["simulation.duration"] = 2 * run.step * len(run.time)  # any whole number of steps
    probe = _core.Probe(settings)
    starts = np.arange(0, len(run.time) - 2, 2)
    for first in range(0, len(starts), _CHUNK):
        yield _continuous(run, starts[first : first + _CHUNK], probe, 2 * run.step)


def _continuous(run: Replay, ticks: NDArray[np.intp], probe: _core.Probe, step: float) -> Stages:
    """Repeat the steps in the core, including the law."""
    weights = None if run.weights is None else run.weights[ticks]
    taken = probe.stages(
        run.features[ticks], run.depth[ticks], run.position[ticks], run.quaternion[ticks], run.twist[ticks], weights
    )
    return Stages(
        tick=ticks,
        step=step,
        **{name: getattr(taken, name) for name in _TAKEN},
        base=None,
        start_quaternion=run.quaternion[ticks],
        start_twist=run.twist[ticks],
        to_sample=step == run.step,
    )


def _sampled(run: Replay, ticks: NDArray[np.intp]) -> Iterator[Stages]:
    """Move the platform from every tick to the next one under the logged wrench or leg forces."""
    substeps = run.scenario.simulation.substeps
    step = run.step / substeps
    body = (run.position[ticks], run.quaternion[ticks], run.twist[ticks])
    legs = _core.Hexapod(run.settings.robot) if run.scenario.actuators.hold == "leg_forces" else None
    base_moves = moves(run.scenario.base_motion)
    for substep in range(substeps):
        stages: list[dict[str, Array]] = []
        start = ticks * run.step + substep * step  # [s]
        for scale in (0.0, step / 2, step / 2, step):
            place = body
            if stages:
                before = stages[-1]
                place = run.probe.moved(*body, before["quaternion"], before["twist"], before["acceleration"], scale)
            position, quaternion, twist = place
            wrench = (
                run.wrench[ticks] if legs is None else _leg_wrench(legs, position, quaternion, run.leg_forces[ticks])
            )
            inertial = np.zeros_like(twist)
            if base_moves:
                inertial = run.probe.base_wrench(start + scale, position, quaternion, twist)
            acceleration = run.probe.acceleration(position, quaternion, twist, wrench + inertial)
            stages.append(
                {
                    "position": position,
                    "quaternion": quaternion,
                    "twist": twist,
                    "wrench": wrench,
                    "base": inertial,
                    "acceleration": acceleration,
                }
            )
        joined = {name: np.stack([stage[name] for stage in stages], axis=1) for name in stages[0]}
        base = joined.pop("base")
        after = run.probe.after(*body, joined["quaternion"], joined["twist"], joined["acceleration"], step)
        features = depth = None
        if run.scenario.camera.convention == "eye_in_hand":
            seen = run.probe.image(joined["position"].reshape(-1, 3), joined["quaternion"].reshape(-1, 4))
            features, depth = (numbers.reshape(len(ticks), 4, -1) for numbers in seen)
        yield Stages(
            tick=ticks,
            step=step,
            features=features,
            depth=depth,
            **joined,
            fuzzy_output=None,
            base=base if base_moves else None,
            start_quaternion=body[1],
            start_twist=body[2],
            next_position=after[0],
            next_quaternion=after[1],
            next_twist=after[2],
            to_sample=substep == substeps - 1,
        )
        body = after


def _leg_wrench(legs: _core.Hexapod, position: Array, quaternion: Array, forces: Array) -> Array:
    """Wrench in B of constant leg forces while the legs rotate, (m, 6)."""
    return np.array(
        [
            legs.wrench_map(place, attitude) @ force
            for place, attitude, force in zip(position, quaternion, forces, strict=True)
        ]
    )
