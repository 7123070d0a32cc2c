"""The loop of a program for a machine that takes positions: read, decide, check, command, wait; and how it ends.

It ends safely: whatever happens, the machine is commanded to stop, and the reason is returned. Reasons are a lost link,
a frame that is stale, a leg out of its range or far from its command, ticks that come late, and Ctrl-C.
"""

from __future__ import annotations

import csv
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

import hexservo as hs
from hexservo.scenario.parameters import frame_period
from position_machines.clock import Clock
from position_machines.kinematics import Kinematics
from position_machines.lines import LinkError

__all__ = [
    "Decision",
    "Ending",
    "Frame",
    "Limits",
    "LogFile",
    "Machine",
    "Reading",
    "Stop",
    "excitation",
    "run",
    "tracking",
]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Frame:
    """An image."""

    features: Array  # (2p,) pixels as the scenario's camera counts them, NaN for points that are lost [px]
    depth: Array  # (p,) z in the camera's frame, negative in front of it [m]
    exposure: float  # [s]


@dataclass(frozen=True)
class Reading:
    """What the machine reports at a tick."""

    legs: Array  # (6,) measured coordinates [m; rad]
    frame: Frame | None  # the newest image, with its exposure by the program's clock [s]; None before the first one


class Machine(Protocol):
    """A machine behind a link; all three may raise `LinkError`."""

    def read(self) -> Reading:
        """Return what the machine measures now."""

    def command(self, legs: Array) -> None:
        """Send the legs there, (6,) [m; rad]."""

    def stop(self) -> None:
        """Stop the legs where they are."""


class Stop(Exception):  # noqa: N818  an ending, not an error
    """Why the loop ends before its time."""


Decision: TypeAlias = Callable[[float, Reading], Array]
"""From the time since the first tick [s] and what is measured to where the legs are sent, (6,) [m; rad]."""


@dataclass(frozen=True)
class Limits:
    """What ends the loop."""

    lowest: Array  # (6,) of the legs [m; rad]
    highest: Array  # (6,)
    lag: float  # most that a leg may be away from its command [m; rad]
    frame_age: float = 0.4  # of the newest image [s]
    late: float = 0.25  # most that a tick may begin or end behind its time [s]
    invalid: float = 0.3  # longest that the law may be unable to act [s]

    @classmethod
    def of(cls, kinematics: Kinematics, **others: float) -> Limits:
        """Return limits at the ends of the legs' travel; `lag` is a third of all of it unless it is given."""
        others.setdefault("lag", float((kinematics.highest - kinematics.lowest).max()) / 3)
        return cls(kinematics.lowest, kinematics.highest, **others)

    def check(self, legs: Array, what: str) -> None:
        """Refuse legs beyond their range, and what is no number.

        Raises
        ------
        Stop
            With the first such leg.
        """
        outside = ~((self.lowest <= legs) & (legs <= self.highest))
        if outside.any():
            leg = int(np.argmax(outside))
            raise Stop(
                f"leg {leg + 1} {what} at {legs[leg]:.4g}, expected {self.lowest[leg]:.4g} to {self.highest[leg]:.4g}"
            )

    def check_lag(self, command: Array, legs: Array) -> None:
        """Refuse a command that is far from where the legs are.

        Raises
        ------
        Stop
            With the leg that is farthest away.
        """
        away = np.abs(command - legs)
        leg = int(np.argmax(away))
        if away[leg] > self.lag:
            raise Stop(f"leg {leg + 1} is {away[leg]:.4g} away from its command, expected at most {self.lag:.4g}")

    def check_time(self, behind: float) -> None:
        """Refuse a tick that is so far behind its time [s].

        Raises
        ------
        Stop
            With the time.
        """
        if behind > self.late:
            raise Stop(f"a tick came {behind:.3f} s late, expected at most {self.late} s")


@dataclass
class Ending:
    """How the loop ended."""

    reason: str  # empty at its end
    stopped: bool  # the machine confirmed that it stops
    ticks: int
    interrupted: bool = False
    details: list[str] = field(default_factory=list)


def is_new(frame: Frame, before: Frame | None, period: float) -> bool:
    """Whether an image is neither the one that was read before nor an older one.

    Its age is measured again at each reading, and so its exposure is never quite the same: within half a period of the
    camera, two images differ by their content.
    """
    later = np.inf if before is None else frame.exposure - before.exposure
    if before is None or abs(later) > 0.5 * period:
        return bool(later > 0.0)
    return not (
        np.array_equal(frame.features, before.features, equal_nan=True) and np.array_equal(frame.depth, before.depth)
    )


class LogFile:
    """A log for `hexservo identify` (docs/identification.md), in a new file."""

    def __init__(self, path: str, points: int, period: float) -> None:
        self._path = Path(path)
        self._empty = True
        names = ["time", *(f"{kind}_{leg}" for kind in ("command", "joint") for leg in range(1, 7))]
        image = [f"{axis}_{point}" for point in range(1, points + 1) for axis in "xy"]
        self._blank = [""] * (len(image) + 1)
        self._period = period  # of the camera [s]
        self._seen: Frame | None = None
        self._file = self._path.open("x", newline="", encoding="utf-8")  # closed by `close`
        self._writer = csv.writer(self._file)
        self._writer.writerow([*names, *image, "arrival"])

    def write(self, now: float, command: Array, reading: Reading) -> None:
        """Write a tick; an image only where it is new. Its time of exposure is left for `identify` to find."""
        self._empty = False
        image: list[str] = self._blank
        if reading.frame is not None and is_new(reading.frame, self._seen, self._period):
            self._seen = reading.frame
            pixels = ("" if np.isnan(pixel) else f"{pixel:.6g}" for pixel in reading.frame.features)
            image = [*pixels, f"{now:.9g}"]
        self._writer.writerow([f"{now:.9g}", *(f"{number:.9g}" for number in (*command, *reading.legs)), *image])

    def close(self) -> None:
        """Finish the file; one without a tick is removed, so that the next attempt may have its name."""
        self._file.close()
        if self._empty:
            self._path.unlink(missing_ok=True)


def run(
    machine: Machine,
    decide: Decision,
    limits: Limits,
    period: float,
    seconds: float,
    clock: Clock,
    interrupted: threading.Event,
    log: LogFile | None = None,
) -> Ending:
    """Command the machine every period, until the time is over or something is wrong, and then stop it.

    A command is a step of what the legs do in a period. So periods that pass during a tick are dropped, and the next
    tick begins a period after its end: commands that made up for them in a burst would be faster than the legs may be.

    Parameters
    ----------
    decide
        Where the legs are sent.
    limits
        What ends the loop; commands beyond the range of the legs, or far from where they are, are not sent.
    period, seconds
        Of a tick, and of the whole [s].
    interrupted
        Ends the loop when it is set.
    log
        Where each tick is written.
    """
    start = clock.now()
    dropped = 0.0  # time of the periods that were [s]
    ending = Ending("", False, 0)
    try:
        while dropped + ending.ticks * period < seconds:
            due = start + dropped + ending.ticks * period
            clock.wait_until(due, interrupted)
            if interrupted.is_set():
                ending.interrupted = True
                raise Stop("interrupted")
            now = clock.now()
            limits.check_time(now - due)
            reading = machine.read()
            limits.check(reading.legs, "is")
            command = decide(now - start, _since(reading, start))
            limits.check(command, "was to be sent")
            limits.check_lag(command, reading.legs)
            machine.command(command)
            if log is not None:
                log.write(now - start, command, reading)
            ending.ticks += 1
            behind = clock.now() - (due + period)
            limits.check_time(behind)
            if behind >= 0.0:
                dropped += behind + period
    except (Stop, LinkError, OSError) as error:
        ending.reason = str(error)
    finally:
        try:
            machine.stop()
            ending.stopped = True
        except LinkError as error:
            ending.details.append(f"the machine did not confirm that it stops: {error}")
    if dropped > 0.0:
        ending.details.append(f"the computer was late: {dropped:.3f} s passed without commands, ticks are uneven")
    return ending


def _since(reading: Reading, start: float) -> Reading:
    """Return a reading whose image has its time since the first tick."""
    frame = reading.frame
    if frame is None:
        return reading
    return Reading(reading.legs, Frame(frame.features, frame.depth, frame.exposure - start))


def tracking(controller: hs.Controller, limits: Limits) -> Decision:
    """Return the decision of a law: where its controller sends the legs.

    Where it cannot act, the controller brakes; the loop goes on for `limits.invalid`, as it does while the law refuses
    the images, and for `limits.frame_age` without an image that shows a point. With `camera.latency_known: false` the
    law has no time of exposure, and finds the latency itself.
    """
    used: Frame | None = None  # that the controller was given
    refused = ""  # the status with which it refused that one
    valid = 0.0
    exposed = 0.0  # when the newest image was taken that shows a point
    stamped = controller.scenario.camera.latency_known
    period = frame_period(controller.scenario)

    def decide(now: float, reading: Reading) -> Array:
        nonlocal used, refused, valid, exposed
        frame = reading.frame
        if frame is not None and np.isfinite(frame.features).any():
            exposed = frame.exposure
        age = now - exposed
        if age > limits.frame_age:
            raise Stop(f"the newest image is {age:.3f} s old, expected at most {limits.frame_age} s")
        image: dict[str, object] = {}
        if frame is not None and is_new(frame, used, period):
            used = frame
            exposure = min(frame.exposure, now) if stamped else now
            image = {"features": frame.features, "depth": frame.depth, "exposure": exposure}
        output = controller.step(**image, leg_lengths=reading.legs, now=now)  # type: ignore[arg-type]
        status = output.status if output.invalid_input else ""
        if image:
            refused = status
        if not (status or refused):
            valid = now
        elif now - valid > limits.invalid:
            raise Stop(f"the law cannot act since {now - valid:.3f} s: {status or refused}")
        return output.leg_positions

    return decide


def excitation(middle: Array, size: float, hold: float, speed: float, seed: int = 0) -> Decision:
    """Return a decision for a log: a slow way to a middle, from wherever the legs are, then jumps of all legs about it.

    Parameters
    ----------
    middle
        (6,) [m; rad].
    size
        Largest distance of a leg from the middle [m; rad]; a jump is up to twice as long.
    hold
        Mean time between jumps [s]. Jumps come at random times, so that they excite a band of frequencies.
    speed
        Of the leg that is farthest away, on the way to the middle [m/s; rad/s].
    seed
        Of the jumps.
    """
    random = np.random.default_rng(seed)
    start: Array | None = None
    target, arrival, next_jump = middle, 0.0, 0.5

    def decide(now: float, reading: Reading) -> Array:
        nonlocal start, target, arrival, next_jump
        if start is None:
            start = reading.legs
            arrival = float(np.abs(middle - start).max()) / speed
            next_jump = max(next_jump, arrival)
        if now < arrival:
            return start + now / arrival * (middle - start)
        if now >= next_jump:
            target = middle + random.uniform(-size, size, 6)
            next_jump = now + random.uniform(0.2, 1.8) * hold
        return target

    return decide
