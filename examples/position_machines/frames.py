"""Images over a link, as JSON: features, depths, and the age of the image in place of its time.

Two computers seldom have one clock, and two programs may have different ones. An age needs none; it is wrong by the
time of the exchange at most.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from position_machines.clock import Clock
from position_machines.lines import Line, LinkError, Server, answering
from position_machines.servo import Frame

__all__ = ["Camera", "camera_server", "frame_of", "numbers", "object_of", "report_of"]

Array: TypeAlias = NDArray[np.float64]
_OLDEST = 3600.0  # [s]
_LARGEST = 1e9  # of any number, which leaves out infinity and what is no number


def object_of(line: bytes) -> dict[str, object]:
    """Return the JSON object of a line.

    Raises
    ------
    LinkError
        For anything else.
    """
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise LinkError(f"expected a line with a JSON object, got something else ({len(line)} bytes)")
    return content


def numbers(values: object, count: int, what: str) -> Array:
    """Return a list of so many finite numbers as an array.

    Raises
    ------
    LinkError
        For anything else.
    """
    if isinstance(values, list) and len(values) == count:
        fits = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
        if fits and all(abs(value) < _LARGEST for value in values):
            return np.array(values, dtype=float)
    raise LinkError(f"{what}: expected {count} finite numbers, got something else")


def frame_of(content: object, points: int, now: float) -> Frame | None:
    """Return an image that a device reports, or None where it has none yet.

    Parameters
    ----------
    content
        ``{"features": [...], "depth": [...], "age": ...}`` or null. Both coordinates of a point that the image does not
        show are null, and NaN in the frame.
    points
        Number of points of the target.
    now
        Time of the report by the program's clock [s].

    Raises
    ------
    LinkError
        For anything else.
    """
    if content is None:
        return None
    if not isinstance(content, dict):
        raise LinkError("frame: expected an object or null, got something else")
    age = float(numbers([content.get("age")], 1, "age")[0])
    if not 0.0 <= age <= _OLDEST:
        raise LinkError(f"age: expected 0 to {_OLDEST} s, got {age:.4g}")
    features = _features(content.get("features"), points)
    return Frame(features, numbers(content.get("depth"), points, "depth"), now - age)


def _features(values: object, points: int) -> Array:
    """Return the pixels of an image, (2p,), NaN for lost points."""
    if isinstance(values, list):
        lost = [value is None for value in values]
        if lost[::2] == lost[1::2]:  # a point is lost with both coordinates
            known = numbers([0.0 if value is None else value for value in values], 2 * points, "features")
            return np.where(lost, np.nan, known)
    raise LinkError(
        f"features: expected x and y of {points} points, both null for a point that is lost, got something else"
    )


def report_of(found: tuple[Frame, float] | None) -> dict[str, object] | None:
    """Return what a device reports of its newest image and its age; JSON has no NaN."""
    if found is None:
        return None
    frame, age = found
    features = [None if np.isnan(pixel) else pixel for pixel in frame.features.tolist()]
    return {"features": features, "depth": frame.depth.tolist(), "age": age}


class Camera:
    """A camera whose program answers ``{"read": true}`` with the newest image."""

    def __init__(self, line: Line, points: int, clock: Clock) -> None:
        self._line, self._points, self._clock = line, points, clock

    def read(self) -> Frame | None:
        """Return the newest image, or None before the first one.

        Raises
        ------
        LinkError
            For a lost link and for anything that is no image.
        """
        self._line.send(b'{"read": true}\n')
        content = object_of(self._line.receive())
        return frame_of(content.get("frame"), self._points, self._clock.now())


def camera_server(newest: Callable[[], tuple[Frame, float] | None], port: int = 0) -> Server:
    """Return a server on the loopback interface with the newest image and its age."""
    return Server(lambda: answering(lambda _: json.dumps({"frame": report_of(newest())}).encode() + b"\n"), port)
