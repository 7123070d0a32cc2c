"""A square tag as a target: its corners are four points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from hexservo.scenario.rules import DisplacementRule, Matrix, Number, Rule, Vector, refusal, shown_value

__all__ = ["Tag", "rotation_matrix"]

Tag: TypeAlias = tuple[float, Vector]
"""Side of the square [m]; its pose (6,): centre in B [m], rotation vector [rad]."""

_KEYS = ("size", "pose")
# Seen from the front, with x to the right and y up: the order of ArUco and of IPPE_SQUARE in OpenCV.
_CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


@dataclass(frozen=True)
class TagRule(Rule):
    """A mapping with the tag's size and pose, or null."""

    @property
    def expected(self) -> str:
        return "size (a number > 0, m) and pose (6 numbers, m and rad), or null"

    def accept(self, value: Any) -> Tag | None:
        if value is None:
            return None
        if not isinstance(value, dict) or set(value) != set(_KEYS):
            self.refuse(value)
        pose = DisplacementRule().accept(value["pose"])
        if pose is None:
            raise refusal((("pose",), f"expected 6 finite numbers (m x3, rad x3), got {shown_value(None)}"))
        return Number(above=0).accept(value["size"]), pose


def corners(tag: Tag) -> Matrix:
    """Return the tag's corners in B, (4, 3) [m]: top left, top right, bottom right, bottom left from the front."""
    size, pose = tag
    points = np.array(pose[:3]) + size * _CORNERS @ rotation_matrix(pose[3:]).T
    return tuple(tuple(map(float, point)) for point in points)


def normal(tag: Tag) -> Vector:
    """Return the tag's normal in B, (3,), which points to the viewer of its front."""
    return tuple(map(float, rotation_matrix(tag[1][3:])[:, 2]))


def rotation_matrix(vector: Vector) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the rotation matrix of a rotation vector [rad] (Rodrigues)."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = float(np.sinc(angle / np.pi))  # sin(angle)/angle
    second = 0.5 * float(np.sinc(0.5 * angle / np.pi)) ** 2  # (1 - cos(angle))/angle^2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
