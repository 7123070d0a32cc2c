"""What the head looks at: a face of five landmarks that appears, moves or jumps, and the camera that sees it.

World W: x ahead, y to the left, z up, origin at the robot's foot, as in the package's model. Angles of a face: yaw to
the left, pitch downwards, about the middle of the platform's joints with the head upright [rad].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = ["CASES", "EYE", "FRONT", "HEAD", "LANDMARKS", "NOSE", "Array", "Camera", "Case", "Face", "turns"]

Array: TypeAlias = NDArray[np.float64]

HEAD = np.array([0.0, 0.0, 0.177])
"""Middle of the platform's joints with the head upright [m], in W."""

EYE = np.array([0.0437, 0.0, 0.0512])
"""The camera from there [m]: `vision/look_at.py` of the package."""

FRONT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Right, down and away of a camera that looks along x, in W, as columns."""

LANDMARKS = 1e-3 * np.array([[-31.5, -33, 0], [31.5, -33, 0], [0, 0, -20], [-25, 34, 0], [25, 34, 0]])
"""Eyes, nose, corners of the mouth (5, 3) [m]: right, down and away in the frame of the camera, from the point that the
head shall look at, 20 mm behind the tip of the nose. Assumption: eyes 63 mm apart, as adults' are in the mean."""

NOSE = 2
"""Which landmark the published laws take."""


@dataclass(frozen=True)
class Case:
    """Where the face is; errors are judged from `since` on."""

    name: str
    times: tuple[float, ...]
    """[s], increasing; before the first and after the last the face rests."""
    angles: tuple[tuple[float, float], ...]
    """Yaw and pitch at each of the times [deg]; straight lines between them, a jump where a time stands twice."""
    since: float = 0.0
    """When the motion that is judged begins [s]; errors count along the way from where the face was."""
    duration: float = 7.0
    moves: bool = False
    """The face moves until the last time: its lag counts, and overshoot and settling from there."""


_RAMP = 2.5  # [s]
CASES = {
    case.name: case
    for case in (
        Case("yaw", (0.0,), ((25.0, 0.0),)),
        Case("pitch", (0.0,), ((0.0, 15.0),)),
        Case("both", (0.0,), ((25.0, 15.0),)),
        Case("moving", (1.0, 1.0 + _RAMP), ((0.0, 0.0), (25.0, 0.0)), 1.0, 8.0, moves=True),
        Case("jump", (3.0, 3.0), ((15.0, 0.0), (-10.0, 10.0)), 3.0, 10.0),
    )
}


class Face:
    """A face on its way, turned to the head, `distance` from the upright head's camera [m]."""

    def __init__(self, case: Case, distance: float = 1.0) -> None:
        self.case, self._distance = case, distance

    def angles(self, times: Array) -> Array:
        """Return yaw and pitch (..., 2) [rad] at these times [s]."""
        times = np.asarray(times, dtype=float)
        at, known = np.array(self.case.times), np.deg2rad(self.case.angles)
        if len(at) == 1:
            return np.broadcast_to(known[0], (*times.shape, 2)).copy()
        after = np.clip(np.searchsorted(at, times, side="right"), 1, len(at) - 1)
        way = at[after] - at[after - 1]
        share = np.where(way > 0, (times - at[after - 1]) / np.where(way > 0, way, 1.0), times >= at[after])
        share = np.clip(share, 0.0, 1.0)[..., None]
        return np.asarray((1 - share) * known[after - 1] + share * known[after])

    def points(self, time: float) -> Array:
        """Return the landmarks (5, 3) in W [m]."""
        nominal = EYE + np.array([self._distance, 0.0, 0.0]) + LANDMARKS @ FRONT.T
        return np.asarray(HEAD + turns(self.angles(np.array(time))).apply(nominal))

    def aims(self, times: Array) -> Array:
        """Return the points to look at (n, 3) in W [m]."""
        front = EYE + np.array([self._distance, 0.0, 0.0])
        return np.asarray(HEAD + turns(self.angles(times)).apply(front))


def turns(angles: Array) -> Rotation:
    """Return the rotation of a head that looks along yaw and pitch (..., 2) [rad]."""
    return Rotation.from_euler("ZY", angles)


@dataclass(frozen=True)
class Camera:
    """Image of the package's detector, 320 px wide: its calibration scaled to it, without distortion."""

    focal: tuple[float, float] = (166.8, 139.1)
    centre: tuple[float, float] = (158.8, 92.2)
    size: tuple[float, float] = (320.0, 180.0)
    noise: float = 0.5
    """Standard deviation of each coordinate of a landmark [px]. Assumption."""

    def image(self, points: Array, position: Array, axes: Array, random: np.random.Generator) -> Array | None:
        """Return the landmarks' pixels (5, 2), or None where one of them is not in the image.

        `axes` (3, 3) has right, down and away of the camera in W as columns.
        """
        seen = (points - position) @ axes
        if np.any(seen[:, 2] <= 0):
            return None
        pixels = np.array(self.focal) * seen[:, :2] / seen[:, 2:] + self.centre
        pixels += self.noise * random.standard_normal(pixels.shape)
        inside = np.all((pixels >= -0.5) & (pixels <= np.array(self.size) - 0.5))
        return np.asarray(pixels) if inside else None
