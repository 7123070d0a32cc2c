"""Recorded motions of base and target that are legal and probably hold something else, and a base that is unseen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array
from hexservo.scenario.motion import BaseMotion, TargetMotion, moves
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number, quantity, vector

# [m/s^2], of a base's recording: a vehicle that is at rest before and after has a mean of zero, and gravity is 9.8
_MEAN_ACCELERATION = 2.0
_FEWEST_PERIODS = 10  # of samples in a run: fewer are no motion, or times in other units
_ROUGH = 2.0  # factor by which an angular acceleration may grow from samples twice as far apart to all of them
_FEWEST_ROUGH = 10  # attitudes from which that can be judged
_LEAST_ROUGH = 0.1  # [rad/s^2], RMS, of an angular acceleration that matters


def of_motion(scenario: Scenario) -> Iterator[str]:
    """Yield a sentence for each problem of the recorded motions of a scenario, and for a base whose motion is unseen.

    Compares recordings with the duration of the run, the mean of recorded accelerations with gravity, and the angular
    acceleration of recorded attitudes with that of every second sample.
    """
    base = scenario.base_motion
    yield from _of_times(scenario, "base_motion", base, "rests")
    yield from _of_times(scenario, "target.motion", scenario.target.motion, "stays where it is")
    yield from _of_gravity(scenario)
    if base.kind == "recorded" and base.attitudes is not None and base.sample_period is not None:
        yield from _of_turns(scenario, np.asarray(base.attitudes, dtype=float), base.sample_period)
    yield from _of_positions(scenario)


def _of_times(scenario: Scenario, block: str, motion: BaseMotion | TargetMotion, afterwards: str) -> Iterator[str]:
    if motion.kind != "recorded" or motion.samples is None or motion.sample_period is None:
        return
    duration, period = scenario.simulation.duration, motion.sample_period
    length = (len(motion.samples) - 1) * period
    if length + period < duration * (1.0 - 1e-9):  # samples of the whole run often leave out its end
        yield (
            f"{block}.samples: the recording lasts {quantity(length, 's')}, and simulation.duration is "
            f"{quantity(duration, 's')}: the {block.partition('_')[0].partition('.')[0]} {afterwards} in the rest of "
            "the run; record as long as the run, and check that times are in seconds"
        )
    if period * _FEWEST_PERIODS > duration * (1.0 + 1e-9):
        yield (
            f"{block}.sample_period: {quantity(period, 's')} is more than a tenth of simulation.duration, "
            f"{quantity(duration, 's')}; check that times in the file are in seconds"
        )


def _of_gravity(scenario: Scenario) -> Iterator[str]:
    """Find gravity in recorded accelerations, by the speed that they would give to the base."""
    motion = scenario.base_motion
    if motion.kind != "recorded" or motion.samples is None or motion.sample_period is None:
        return
    samples = np.asarray(motion.samples, dtype=float)
    between = (samples[1:] + samples[:-1]) / 2.0  # means of the straight lines from sample to sample
    mean = between.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size <= _MEAN_ACCELERATION:
        return
    duration = len(between) * motion.sample_period
    yield (
        f"base_motion.samples: their mean acceleration is {vector(mean)} m/s^2, by which the base gains "
        f"{number(size * duration)} m/s in {quantity(duration, 's')}; check the signs and "
        "base_motion.frame_of_acceleration: at rest and level, specific_force has "
        f"{vector(-np.asarray(scenario.robot.gravity))} m/s^2 in the file, and kinematic has zero; forces that were "
        "read before robot.gravity was changed hold the difference"
    )


def _of_turns(scenario: Scenario, attitudes: Array, period: float) -> Iterator[str]:
    """Find attitudes with so few digits that their second derivative is rounding."""
    if len(attitudes) < _FEWEST_ROUGH:
        return
    change = _core.Probe(core_parameters(scenario)).base_motion(period * np.arange(len(attitudes)))[3]
    whole, coarse = _rms(change), _rms(_coarse_acceleration(attitudes, period))
    if whole > max(_LEAST_ROUGH, _ROUGH * coarse):
        yield (
            f"base_motion.attitudes: their angular acceleration is {number(whole)} rad/s^2 (RMS), and "
            f"{number(coarse)} rad/s^2 from every second sample: most of it is rounding, noise, or motion faster "
            "than a fifth of the sampling rate, and all of it acts on the platform; smooth what is noise, record more "
            f"digits (rounding a quaternion to q leaves 3.5 q/h^2 about each axis, h = {quantity(period, 's')}), or "
            "sample faster what is motion"
        )


def _coarse_acceleration(attitudes: Array, period: float) -> Array:
    """Return the angular accelerations (n, 3) [rad/s^2] of quaternions, from second differences over two periods.

    The part of 2 q'' along the sphere of unit quaternions is as long as the angular acceleration.
    """
    q = attitudes / np.linalg.norm(attitudes, axis=1, keepdims=True)
    q[1:] *= np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))[:, None]
    middle = q[2:-2]
    second = (q[4:] - 2.0 * middle + q[:-4]) / (2.0 * period) ** 2
    return np.asarray(2.0 * (second - np.sum(second * middle, axis=1, keepdims=True) * middle))


def _rms(vectors: Array) -> float:
    """Return the RMS length of vectors."""
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=1))))


def _of_positions(scenario: Scenario) -> Iterator[str]:
    """Find a base whose motion cannot be seen: legs that follow whatever it takes, and a target that rides along."""
    if scenario.actuators.kind == "position" and moves(scenario.base_motion) and scenario.target.frame == "base":
        in_world = " and target.frame: world for a target that does not ride on the base"
        yield (
            "base_motion: has no effect on pose and image here, only on the efforts of the legs, which follow "
            "whatever it takes; use actuators.kind: position_torque for motors that yield"
            f"{in_world if scenario.camera.mount.on == 'platform' else ''}"
        )
