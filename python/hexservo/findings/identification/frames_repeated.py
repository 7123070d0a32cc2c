"""Frames that a driver repeats when it is asked more often than the camera takes them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hexservo.findings.identification.log import Frames, Log, joint_deviations
from hexservo.scenario.arrays import Array, Mask

_BY_ITSELF = 0.05  # of the frames that are equal to the one before: more are equal since the image is rounded, or rests
_CLEAR = 5.0  # resolutions of the image, or deviations of the joints' noise, from which on there is motion


def repeats(log: Log, frames: Frames) -> Mask:
    """Return which frames (m,) repeat the one before, as of a driver that is asked more often than the camera.

    Noise changes every coordinate: a frame that is equal in all of them is no new one. An image that is rounded or has
    no noise may be equal by itself. A run of equal frames shows a repeating driver where the joints move in both halves
    of it, beyond their noise, and the image changes by well over its resolution before and after. None is a repetition
    without such a run, nor where the image is often equal by itself: in single coordinates, or in runs that are far
    longer, as at rest.
    """
    steps, seen = np.abs(np.diff(frames.features, axis=0)), np.isfinite(frames.features)
    steps = np.where(seen[1:] & seen[:-1], steps, 0.0)
    alike = (seen[1:] == seen[:-1]).all(axis=1) & seen[1:].any(axis=1)  # a repeated frame lacks the same points
    largest, whole = steps.max(axis=1), alike & ~steps.any(axis=1)
    single = ((steps == 0.0) & seen[1:] & seen[:-1]).any(axis=1)
    runs = np.flatnonzero(np.diff(np.concatenate([[False], whole, [False]]).astype(int))).reshape(-1, 2)
    if not len(runs) or whole.all():
        return np.zeros(len(frames.arrival), dtype=bool)
    clear: Mask = largest > _CLEAR * steps[steps > 0.0].min(initial=np.inf)
    moves = _movement(log, frames.arrival)
    shows = [
        bool(first > 0 and end < len(clear) and clear[first - 1] and clear[end] and moves(first, end))
        for first, end in runs
    ]
    lengths = np.diff(runs, axis=1).ravel()
    far_longer = lengths[lengths > 2 * lengths[shows].max(initial=0)].sum()
    by_itself = max((single & ~whole).sum(), far_longer) > _BY_ITSELF * whole.sum()
    repeating = any(shows) and not by_itself
    return np.concatenate([[False], whole & repeating])


def _movement(log: Log, arrival: Array) -> Callable[[int, int], bool]:
    """Return whether a joint moves beyond its noise from one frame to a later one, in both halves of that time."""
    ticks = np.clip(np.searchsorted(log.time, arrival, side="right") - 1, 0, None)
    joints = log.joints[ticks]
    noise = np.sqrt(2.0) * joint_deviations(log.joints)  # of the difference of two readings

    def moves(first: int, end: int) -> bool:
        middle = (first + end + 1) // 2
        halves = [(first, middle), (middle, end)] if middle < end else [(first, end)]
        return all(bool((np.abs(joints[b] - joints[a]) > _CLEAR * noise).any()) for a, b in halves)

    return moves
