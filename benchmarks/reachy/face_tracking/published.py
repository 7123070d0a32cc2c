"""The head tracking that the package ships and the fix that is proposed for it, written from their description.

Shipped (1.13.0, `vision/face_tracking.py`, `vision/look_at.py`, `daemon/backend/abstract.py`). Of every frame the
nose counts, as coordinates from -1 to 1. They are smoothed in the image: 0.3 of the way to the new ones, 0.6 where
the nose moved by more than 0.15 since the frame before, nothing within 0.02. The smoothed point becomes a ray through
the camera as the head is now, though the frame is older; the head shall look along it from its upright place. Of the
way from the commanded pose to that goal each tick takes 0.15. Added to the pitch are 15 deg.

The fix (pull request 1396 of pollen-robotics/reachy_mini, open) takes the pose of the head at the frame's time. Here it
has the true time of exposure even where the other laws have none.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from face_tracking.machine import kinematics
from face_tracking.scene import NOSE, Array, Camera

__all__ = ["Frame", "PublishedLaw"]

_TURN = np.array([1.0, -1.0, -1.0])  # between B and W
_SLOW, _FAST, _QUICK, _DEAD, _EASE = 0.3, 0.6, 0.15, 0.02, 0.15


@dataclass(frozen=True)
class Frame:
    """What arrives of a frame."""

    pixels: Array  # (5, 2)
    exposure: float  # [s]
    arrival: float  # [s]
    stamped: bool  # whether a controller has the exposure


class ImageFilter:
    """Smoothing of image coordinates."""

    def __init__(self) -> None:
        self._value: Array | None = None
        self._before = np.zeros(2)

    def update(self, raw: Array) -> Array:
        """Return the smoothed coordinates (2,) after raw ones."""
        if self._value is None:
            self._value = raw
        moved, way = np.linalg.norm(raw - self._before), raw - self._value
        first, self._before = self._value is raw, raw
        if not first and np.linalg.norm(way) >= _DEAD:
            self._value = self._value + (_FAST if moved > _QUICK else _SLOW) * way
        return self._value


@dataclass
class PublishedLaw:
    """Crank angles at each tick, by the shipped law, or by the fix."""

    camera: Camera
    at_exposure: bool = False
    """The fix."""
    trim: float = 0.0
    """Added to the pitch of its aim [rad]; the package has 15 deg."""
    _filter: ImageFilter = field(default_factory=ImageFilter)

    def __post_init__(self) -> None:
        """Start upright."""
        self._pose = np.asarray(kinematics().home_position), np.asarray(kinematics().home_quaternion)
        self._history: list[tuple[float, Rotation]] = []
        self._aim: Rotation | None = None
        self._goal: Rotation | None = None
        self._shift = np.zeros(3)  # of the commanded head from its upright place

    def tick(self, now: float, reading: Array, frame: Frame | None) -> Array:
        """Return the commanded angles (6,) [rad]."""
        found = kinematics().forward_kinematics(reading, *self._pose)
        self._pose = np.asarray(found.position), np.asarray(found.quaternion)
        head = _in_world(self._pose[1])
        self._history = [*self._history[-50:], (now, head)]
        if frame is not None:
            self._goal = self._look(frame, self._head_at(frame.exposure) if self.at_exposure else head)
        if self._goal is None:
            return np.asarray(kinematics().home_lengths)
        if self._aim is None:
            self._aim, self._shift = head, self._pose[0] - kinematics().home_position
        self._aim = self._aim * Rotation.from_rotvec(_EASE * (self._aim.inv() * self._goal).as_rotvec())
        self._shift = (1.0 - _EASE) * self._shift
        quaternion = np.roll(self._aim.as_quat(), 1) * np.array([1.0, *_TURN])
        return np.asarray(kinematics().leg_lengths(kinematics().home_position + self._shift, quaternion))

    def _head_at(self, time: float) -> Rotation:
        times = np.array([at for at, _ in self._history])
        after = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
        if len(times) < 2 or time <= times[0]:
            return self._history[0][1]
        (before, start), (until, end) = self._history[after - 1], self._history[after]
        share = min((time - before) / (until - before), 1.0)
        return start * Rotation.from_rotvec(share * (start.inv() * end).as_rotvec())

    def _look(self, frame: Frame, head: Rotation) -> Rotation:
        last = np.array(self.camera.size) - 1.0
        u, v = (self._filter.update(2.0 * frame.pixels[NOSE] / last - 1.0) + 1.0) / 2.0 * last
        x, y = (u - self.camera.centre[0]) / self.camera.focal[0], (v - self.camera.centre[1]) / self.camera.focal[1]
        ray = head.apply([1.0, -x, -y])
        axis = np.cross([1.0, 0.0, 0.0], ray)
        size = np.linalg.norm(axis)
        angle = np.arctan2(size, ray[0])
        look = Rotation.from_rotvec(angle / max(size, 1e-12) * axis)
        roll, pitch, yaw = look.as_euler("xyz")
        return Rotation.from_euler("xyz", [roll, pitch + self.trim, yaw])


def _in_world(quaternion: Array) -> Rotation:
    """Return the attitude of the head in W from the one of E in B, whose axes are those of head and W, turned."""
    return Rotation.from_quat(np.roll(quaternion * np.array([1.0, *_TURN]), -1))
