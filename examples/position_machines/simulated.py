"""A machine that takes positions, simulated in place of a real one: six drives, and a camera on the platform.

It has no part of the controller: drives are integrated here, and only kinematics and projection are the core's.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

import hexservo as hs
from hexservo import _core  # for the image of the target, of which there is one copy
from hexservo.scenario.parameters import core_parameters, frame_period
from position_machines.clock import Clock
from position_machines.kinematics import Kinematics
from position_machines.servo import Frame

__all__ = ["Drives", "SimulatedMachine"]

Array: TypeAlias = NDArray[np.float64]
_STEP = 1e-3  # [s] of the integration


@dataclass(frozen=True)
class Drives:
    """How each leg follows its command, q'' = w^2 (q* - q) - 2 zeta w q', within its limits."""

    bandwidth: float  # [Hz]
    damping: float
    delay: float  # [s]
    speed: float  # most [m/s; rad/s]


class SimulatedMachine:
    """Six legs that follow commands, and a camera with a period and a latency.

    Parameters
    ----------
    scenario
        Its legs, camera and target.
    drives
        How the legs follow.
    clock
        Whose time it is; the machine moves to the present whenever it is asked for something.
    watchdog
        Where no command comes for this long, the legs stop where they are [s]. None: they go to the last command.
    """

    def __init__(self, scenario: hs.Scenario, drives: Drives, clock: Clock, watchdog: float | None = None) -> None:
        settings = core_parameters(scenario)
        self.scenario, self._drives, self._clock, self._watchdog = scenario, drives, clock, watchdog
        self._kinematics, self._camera = Kinematics(scenario), settings.camera
        self._points = np.array(settings["target.points"])
        self._random = np.random.default_rng(scenario.seed)
        self._lock = threading.Lock()
        w = 2 * np.pi * drives.bandwidth
        self._transition = expm(_STEP * np.array([[0.0, 1.0], [-w * w, -2 * drives.damping * w]]))
        self._state: Array = np.stack([self._kinematics.home_legs, np.zeros(6)])  # q and its rate
        self._start = clock.now()
        self._steps = 0
        self._waiting: deque[tuple[int, Array]] = deque()  # commands and the step at which they begin to act
        self._command: Array = self._state[0].copy()
        self._heard = 0  # step of the last command
        self._exposed = -1
        self._arriving: deque[tuple[int, Frame]] = deque()
        self._newest: Frame | None = None
        self.holds = False  # the last command was to hold
        self.camera_works = True

    def legs(self) -> Array:
        """Return the coordinates of the legs now as encoders count them, (6,) [m; rad]."""
        resolution = self.scenario.sensors.resolution
        with self._lock:
            self._advance()
            legs: Array = self._state[0].copy()
        return np.asarray(np.round(legs / resolution) * resolution) if resolution > 0.0 else legs

    def command(self, legs: Array, at: float | None = None) -> None:
        """Send the legs there, (6,) [m; rad], now or at an earlier time [s] that has not been simulated yet."""
        with self._lock:
            self._advance(at)
            self._waiting.append((self._steps + round(self._drives.delay / _STEP), np.array(legs, dtype=float)))
            self._heard, self.holds = self._steps, False

    def hold(self) -> None:
        """Stop where the legs are."""
        with self._lock:
            self._advance()
            self._hold()

    def frame(self) -> tuple[Frame, float] | None:
        """Return the newest image that has arrived and its age [s], counted from the exposure."""
        with self._lock:
            self._advance()
            newest = self._newest
        return None if newest is None else (newest, self._start + _STEP * self._steps - newest.exposure)

    def error(self) -> float:
        """Return the largest distance of a coordinate of the true image from the goal [px]."""
        with self._lock:
            self._advance()
            return float(np.abs(self._image()[0] - np.array(self.scenario.target.desired_features)).max())

    def _hold(self) -> None:
        self._waiting.clear()
        self._command, self.holds = self._state[0].copy(), True
        self._state[1] = 0.0  # worm gears and screws stop within a millisecond

    def _advance(self, at: float | None = None) -> None:
        target = int(((self._clock.now() if at is None else at) - self._start) / _STEP + 1e-6)
        camera = self.scenario.camera
        period = round(frame_period(self.scenario) / _STEP)
        while self._steps < target:
            if self._steps // period > self._exposed:
                self._exposed = self._steps // period
                self._expose(self._steps + round(camera.latency / _STEP))
            while self._arriving and self._arriving[0][0] <= self._steps:
                self._newest = self._arriving.popleft()[1]
            while self._waiting and self._waiting[0][0] <= self._steps:
                self._command = self._waiting.popleft()[1]
            if self._watchdog is not None and not self.holds and _STEP * (self._steps - self._heard) > self._watchdog:
                self._hold()
            before = self._state
            after = self._transition @ (before - [[1.0], [0.0]] * self._command) + [[1.0], [0.0]] * self._command
            rate = np.clip(after[1], -self._drives.speed, self._drives.speed)
            limited = rate != after[1]
            after[0] = np.where(limited, before[0] + _STEP / 2 * (before[1] + rate), after[0])
            after[1] = rate
            self._state = after
            self._steps += 1
        while self._arriving and self._arriving[0][0] <= self._steps:
            self._newest = self._arriving.popleft()[1]

    def _expose(self, arrival: int) -> None:
        if not self.camera_works:
            return
        features, depth = self._image()
        features = features + self._random.normal(0.0, self.scenario.camera.noise, features.shape)
        self._arriving.append((arrival, Frame(features, depth, self._start + _STEP * self._steps)))

    def _image(self) -> tuple[Array, Array]:
        pose = self._kinematics.pose(self._state[0])
        features, depth = _core.take_image(self._camera, *pose, self._points)
        return np.array(self._camera.pixels(np.reshape(features, (-1, 2)))).ravel(), np.array(depth)
