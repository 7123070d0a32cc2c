"""Logs of machines that take positions, without the core: drives by SciPy, and images at the true exposures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete

import hexservo as hs
from hexservo import _core
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.log import Frames, Log

Array = NDArray[np.float64]

FINE = 200  # steps in a tick of a drive with limits


def _clip(number: float, limit: float) -> float:
    """Limit one number; NumPy takes twenty times as long for it, and there are 1e8."""
    return max(-limit, min(number, limit))


@dataclass(frozen=True)
class Drive:
    """A second-order response with limits, and its delay in ticks."""

    bandwidth: float  # [Hz]
    damping: float
    delay: int = 0
    speed: float = np.inf  # [m/s]
    acceleration: float = np.inf  # [m/s^2]

    def follow(self, commands: Array, period: float) -> Array:
        """Return the coordinate at each tick, read before its command."""
        w = 2 * np.pi * self.bandwidth
        delayed = np.concatenate([np.full(self.delay, commands[0]), commands[: len(commands) - self.delay]])
        out = np.empty(len(commands))
        if np.isinf(self.speed) and np.isinf(self.acceleration):
            a, b = np.array([[0.0, 1.0], [-w * w, -2 * self.damping * w]]), np.array([[0.0], [w * w]])
            after, by, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), period)
            state = np.array([commands[0], 0.0])
            for tick, command in enumerate(delayed):
                out[tick] = state[0]
                state = after @ state + by[:, 0] * command
            return out
        h = period / FINE
        q, v = float(commands[0]), 0.0
        for tick, command in enumerate(delayed.tolist()):
            out[tick] = q
            for _ in range(FINE):  # explicit midpoints: errors of 1e-6 of a tick's motion
                rate = _clip(w * w * (command - q) - 2 * self.damping * w * v, self.acceleration)
                vm = _clip(v + h / 2 * rate, self.speed)
                rate = _clip(w * w * (command - q - h / 2 * v) - 2 * self.damping * w * vm, self.acceleration)
                q, v = q + h * vm, _clip(v + h * rate, self.speed)
        return out


def wandering(random: np.random.Generator, ticks: int, period: float, size: float, hold: float) -> Array:
    """Return commands (n, 6) that jump every `hold` s or so, by normal steps of `size` about zero."""
    count = max(1, round(hold / period))
    return np.repeat(random.normal(0.0, size, (ticks // count + 1, 6)), count, axis=0)[:ticks]


def record(commands: Array, period: float, drives: list[Drive], noise: float, random: np.random.Generator) -> Log:
    """Return the log of six drives whose coordinates are measured with white noise."""
    joints = np.stack([drive.follow(commands[:, leg], period) for leg, drive in enumerate(drives)], axis=1)
    joints += random.normal(0.0, noise, joints.shape)
    return Log(np.asarray(period * np.arange(len(commands))), period, commands, joints, None)


def poses_of(scenario: hs.Scenario, lengths: Array) -> Poses:
    """Return the poses of legs of these lengths (n, 6), each from the one before."""
    scene = Scene(scenario)
    position, quaternion = scene.home.position, scene.home.quaternion
    found = []
    for row in lengths:
        legs = scene.hexapod.forward_kinematics(row, position, quaternion)
        assert legs.status == _core.KinematicsStatus.converged
        position, quaternion = legs.position, legs.quaternion
        found.append((position, quaternion))
    return Poses(np.array([one for one, _ in found]), np.array([one for _, one in found]))


def see(
    scenario: hs.Scenario, lengths: Array, exposure: Array, arrival: Array, noise: float, random: np.random.Generator
) -> Frames:
    """Return images of the scenario's target from legs of these lengths (m, 6) at the exposures."""
    poses = poses_of(scenario, lengths)
    home = Scene(scenario).home
    pixels = hs.project(scenario, poses.displacement_from(home))
    return Frames(pixels + random.normal(0.0, noise, pixels.shape), arrival, exposure)
