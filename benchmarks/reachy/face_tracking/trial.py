"""One trial: a face, a head, a law; and what is measured of it."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from face_tracking.machine import TICK, Head
from face_tracking.published import Frame
from face_tracking.scene import Array, Camera, Case, Face

__all__ = ["Figures", "Law", "Record", "figures", "run"]

WITHIN = 1.0  # [deg]
LATENCY = (0.05, 0.2)  # [s], from which unknown latencies are drawn


class Law(Protocol):
    """What commands the head."""

    def tick(self, now: float, reading: Array, frame: Frame | None) -> Array:
        """Return crank angles (6,) [rad]."""
        ...


@dataclass(frozen=True)
class Record:
    """A trial, at every step of the simulation; commands at every tick."""

    times: Array
    errors: Array
    """How far the face is right of and below the camera's axis (n, 2) [deg]."""
    aims: Array
    """Directions of the face, yaw and pitch (n, 2) [deg]."""
    torques: Array
    """Largest motor torque, as a share of the limit."""
    commands: Array
    """(ticks, 6) [rad]."""
    seen: tuple[int, int]
    """Frames with the whole face, and all."""


def run(head: Head, law: Law, case: Case, camera: Camera, rate: float, latency: str, seed: int) -> Record:
    """Run a trial.

    Parameters
    ----------
    head
        At rest and upright; it is moved.
    law
        What commands it, one tick late.
    case
        What the face does.
    camera
        The true one.
    rate
        Of the frames [Hz]; they begin at a random time within the first period.
    latency
        A number of ms, or ``scattered``: of each frame from 50 to 200 ms, or ``drawn``: a constant one from 50 to
        200 ms, all with stamped frames; or ``unknown``: as ``drawn``, and no stamps.
    seed
        Of distance (0.9 to 1.1 m), latency, begin and noise of the frames.
    """
    random = np.random.default_rng([seed, 20261122])
    face = Face(case, random.uniform(0.9, 1.1))
    phase, constant = random.uniform(0.0, 1.0 / rate), random.uniform(*LATENCY)
    ticks, step = round(case.duration / TICK), float(head.model.opt.timestep)
    n = ticks * head.steps
    times = step * np.arange(n)
    position, axes, torques = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n)
    commands = np.empty((ticks, 6))
    waiting: deque[Frame] = deque()
    exposures, shown, pending = 0, 0, None
    for tick in range(ticks):
        now = tick * TICK
        arrived = [frame for frame in waiting if frame.arrival <= now + 1e-9]
        waiting = deque(frame for frame in waiting if frame.arrival > now + 1e-9)
        newest = max(arrived, key=lambda frame: frame.exposure, default=None)
        commands[tick] = law.tick(now, head.reading, newest)
        if pending is not None:
            head.command(pending)
        pending = commands[tick]
        for k in range(tick * head.steps, (tick + 1) * head.steps):
            position[k], axes[k], torques[k] = head.step()
            if times[k] >= phase + exposures / rate - 1e-9:
                exposures += 1
                pixels = camera.image(face.points(times[k]), position[k], axes[k], random)
                late = random.uniform(*LATENCY)
                late = (
                    constant
                    if latency in ("drawn", "unknown")
                    else late
                    if latency == "scattered"
                    else float(latency) / 1e3
                )
                if pixels is not None:
                    shown += 1
                    waiting.append(Frame(pixels, times[k], times[k] + late, latency != "unknown"))
    seen = np.einsum("nij,ni->nj", axes, face.aims(times) - position)
    errors = np.rad2deg(np.arctan2(seen[:, :2], seen[:, 2:]))
    return Record(times, errors, np.rad2deg(face.angles(times)), torques / head.limit, commands, (shown, exposures))


@dataclass(frozen=True)
class Figures:
    """What a trial is judged by; a number that the case does not have is NaN."""

    overshoot: float
    """Farthest beyond the face, along the way to it [deg]."""
    settled: float
    """When the error is within 1 deg for good, from the face's appearance, jump or stop [s]; inf: never."""
    final: float
    """Mean error of the last second, as a vector [deg]."""
    lag: float
    """Mean error while the face moves, from half a second on [deg]."""
    variation: float
    """Mean magnitude of the commands' rates [rad/s]."""
    rest: float
    """The same in the last second."""
    at_limit: float
    """Longest time that a motor is at its torque limit [s]."""
    lost: float
    """Share of the frames without the whole face."""

    def mapping(self) -> dict[str, float]:
        """Return the numbers by name."""
        return asdict(self)


def figures(record: Record, case: Case) -> Figures:
    """Return what is measured of a trial."""
    times, errors = record.times, record.errors
    start = int(np.searchsorted(times, case.since - 1e-9))
    along = errors[start] if not case.moves else _image_way(record.aims[-1] - record.aims[start])
    along = along / np.linalg.norm(along)
    judged = int(np.searchsorted(times, case.times[-1] - 1e-9)) if case.moves else start
    size = np.linalg.norm(errors, axis=1)
    outside = np.flatnonzero(size[judged:] > WITHIN)
    settled = 0.0 if not len(outside) else times[judged + outside[-1]] + times[1] - times[judged]
    if len(outside) and judged + outside[-1] >= len(times) - round(0.5 / times[1]):
        settled = np.inf
    rates = np.abs(np.diff(record.commands, axis=0)).mean(axis=1) / TICK
    last = round(1.0 / TICK)
    lag = np.nan
    if case.moves:
        moving = slice(start + round(0.5 / times[1]), judged)
        lag = float((errors[moving] @ along).mean())
    return Figures(
        overshoot=float(max(0.0, (-errors[judged:] @ along).max())),
        settled=float(settled),
        final=float(np.linalg.norm(errors[-round(1.0 / times[1]) :].mean(axis=0))),
        lag=lag,
        variation=float(rates[round(case.since / TICK) :].mean()),
        rest=float(rates[-last:].mean()),
        at_limit=_longest(record.torques >= 0.999) * float(times[1]),
        lost=1.0 - record.seen[0] / max(record.seen[1], 1),
    )


def _image_way(angles: Array) -> Array:
    """Return the way in the image (right, down) of a face that turns by yaw to the left and pitch downwards."""
    return np.asarray(angles * np.array([-1.0, 1.0]))


def _longest(flags: NDArray[np.bool_]) -> int:
    longest = count = 0
    for flag in flags:
        count = count + 1 if flag else 0
        longest = max(longest, count)
    return longest
