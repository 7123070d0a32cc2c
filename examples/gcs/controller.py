"""A simulated hexapod controller with the text protocol of `client`, for tests and to try the program."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Sequence

import numpy as np

import hexservo as hs
from gcs.client import AXES, STOPPED, Array, from_pose, to_pose
from position_machines.clock import Clock
from position_machines.kinematics import Kinematics
from position_machines.lines import LONGEST, Server
from position_machines.servo import Frame
from position_machines.simulated import Drives, SimulatedMachine

__all__ = ["DRIVES", "Controller", "simulated_scenario"]

DRIVES = Drives(bandwidth=6.0, damping=0.8, delay=0.05, speed=0.03)
"""What the simulated legs do, for `hexservo identify` to find; not measured on a hexapod."""
_LIMITS = np.array([22.5, 22.5, 12.5, 7.5, 7.5, 12.5])  # [mm; deg], those of the scenario pi-h824's source
_SYNTAX, _UNKNOWN, _NOT_READY, _OUTSIDE, _AXIS, _RANGE = 1, 2, 5, 7, 15, 17
_MOST_VELOCITY = 25.0  # [mm/s]
_ON_TARGET = np.array([0.002] * 3 + [0.002] * 3)  # [mm; deg]
_STEP = 0.01  # [s] of the way to a target


def simulated_scenario() -> hs.Scenario:
    """Return the machine that is simulated: a camera of 20 Hz whose images are 100 ms late, on a compact hexapod."""
    camera = {"camera.period": 0.05, "camera.latency": 0.1, "camera.noise": 0.1}
    return hs.load_scenario("pi-h824").updated(camera)


class Controller:
    """A controller and the hexapod behind it; connections share it.

    The way to a target is straight in X to W, at the velocity of ``VLS`` of the coordinate that goes farthest [mm/s;
    deg/s]. A new target replaces the one before.
    """

    def __init__(self, clock: Clock, referenced: bool = True) -> None:
        self.machine = SimulatedMachine(simulated_scenario(), DRIVES, clock)
        self._clock, self._kinematics = clock, Kinematics(self.machine.scenario)
        self._lock = threading.Lock()
        self._referenced, self._servo = referenced, False
        self._error, self._velocity = 0, 1.0
        self._target: Array = np.zeros(6)
        self._way: Array = np.zeros(6)  # where on the way to the target the legs are sent
        self._time = clock.now()
        self.commands: list[str] = []  # all that came

    def server(self, port: int = 0) -> Server:
        """Return a server on the loopback interface."""
        return Server(self._handler, port)

    def frame(self) -> tuple[Frame, float] | None:
        """Return the newest image and its age [s]."""
        with self._lock:
            self._advance()
            return self.machine.frame()

    def position(self) -> Array:
        """Return where the platform is, (6,) [mm; deg]; not for several threads at a time."""
        return from_pose(self._kinematics.pose(self.machine.legs()), self._kinematics.home)

    def moving(self) -> bool:
        """Return whether a target is not reached."""
        self._advance()
        return bool((np.abs(self.position() - self._target) > _ON_TARGET).any())

    def _handler(self) -> Callable[[bytes], bytes | None]:
        received = b""

        def handle(data: bytes) -> bytes | None:
            nonlocal received
            replies = b""
            for byte in (data[i : i + 1] for i in range(len(data))):
                if byte == b"\x18":  # single characters act at once
                    with self._lock:
                        self._stop()
                elif byte == b"\x05":
                    with self._lock:
                        replies += b"3F\n" if self.moving() else b"0\n"
                elif byte == b"\n":
                    line, received = received.removesuffix(b"\r"), b""
                    with self._lock:
                        replies += self._answer(line.decode("ascii", errors="replace"))
                elif len(received) < LONGEST:
                    received += byte
                else:
                    return None
            return replies

        return handle

    def _answer(self, line: str) -> bytes:
        self.commands.append(line)
        self._advance()
        name, *rest = line.split() or [""]
        queries: dict[str, Callable[[], Sequence[float] | Array]] = {
            "POS?": self.position,
            "MOV?": lambda: self._target,
            "TMN?": lambda: -_LIMITS,
            "TMX?": lambda: _LIMITS,
            "FRF?": lambda: [int(self._referenced)] * 6,
            "SVO?": lambda: [int(self._servo)] * 6,
            "ONT?": lambda: (np.abs(self.position() - self._target) <= _ON_TARGET).astype(int).tolist(),
        }
        if name in queries and set(rest) <= set(AXES):
            numbers = dict(zip(AXES, queries[name](), strict=True))
            return " \n".join(f"{axis}={numbers[axis]:.6g}" for axis in rest or AXES).encode() + b"\n"
        texts: dict[str, Callable[[], str]] = {
            "ERR?": lambda: str(self._reset_error()),
            "*IDN?": lambda: "simulated hexapod controller",
            "VLS?": lambda: f"{self._velocity:.6g}",
        }
        if name in texts and not rest:
            return texts[name]().encode() + b"\n"
        commands = {"MOV": self._move, "SVO": self._switch, "VLS": self._limit, "FRF": self._refer, "STP": self._halt}
        if name in commands:
            commands[name](rest)
        elif name:
            self._error = _UNKNOWN  # an unknown query is not answered
        return b""

    def _reset_error(self) -> int:
        error, self._error = self._error, 0
        return error

    def _pairs(self, words: list[str]) -> dict[str, float] | None:
        """Return axes and numbers, or None with the error set."""
        pairs: dict[str, float] = {}
        for axis, number in zip(words[::2], words[1::2], strict=False):
            if axis not in AXES:
                self._error = _AXIS
                return None
            if not re.fullmatch(r"-?\d{1,9}(\.\d{0,9})?", number) or axis in pairs:
                self._error = _SYNTAX
                return None
            pairs[axis] = float(number)
        if len(words) % 2 or not words:
            self._error = _SYNTAX
            return None
        return pairs

    def _move(self, words: list[str]) -> None:
        pairs = self._pairs(words)
        if pairs is None:
            return
        if not (self._referenced and self._servo):
            self._error = _NOT_READY
            return
        target = np.array([pairs.get(axis, self._target[place]) for place, axis in enumerate(AXES)])
        legs = self._kinematics.legs(to_pose(target, self._kinematics.home))
        if (np.abs(target) > _LIMITS).any() or not (
            (self._kinematics.lowest <= legs) & (legs <= self._kinematics.highest)
        ).all():
            self._error = _OUTSIDE
            return
        self._target = target

    def _switch(self, words: list[str]) -> None:
        pairs = self._pairs(words)
        if pairs is not None and set(pairs.values()) <= {0.0, 1.0}:
            self._servo = all(pairs.values())
        elif pairs is not None:
            self._error = _RANGE

    def _limit(self, words: list[str]) -> None:
        if len(words) != 1 or not re.fullmatch(r"\d{1,9}(\.\d{0,9})?", words[0]):
            self._error = _SYNTAX
        elif not 0.0 < float(words[0]) <= _MOST_VELOCITY:
            self._error = _RANGE
        else:
            self._velocity = float(words[0])

    def _refer(self, _: list[str]) -> None:
        self._referenced = True

    def _halt(self, _: list[str]) -> None:
        self._stop()

    def _stop(self) -> None:
        self._advance()
        self.machine.hold()
        self._way = self._target = self.position()
        self._error = STOPPED

    def _advance(self) -> None:
        """Send the legs along the way, at the velocity."""
        steps = int((self._clock.now() - self._time) / _STEP + 1e-6)
        for _ in range(steps):
            self._time += _STEP
            left = self._target - self._way
            if not left.any():
                continue
            share = min(1.0, self._velocity * _STEP / float(np.abs(left).max()))
            self._way = self._way + share * left
            self.machine.command(self._kinematics.legs(to_pose(self._way, self._kinematics.home)), self._time)
