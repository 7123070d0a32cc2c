"""Points of a target in one plane: on which side of it a camera is, by its image."""

from __future__ import annotations

from itertools import combinations
from typing import Any, TypeAlias

import numpy as np

from hexservo.scenario.arrays import Array

_FLAT = 1e-6  # of the target's size, most that a point of a plane is off it, and least that three are off a line

Triangle: TypeAlias = tuple[int, int, int]
"""Points of a target, counted from 0."""


def triangle_of_plane(points: Array) -> Triangle | None:
    """Return the three points of the largest triangle of a target in one plane; None for others.

    Parameters
    ----------
    points
        (p, 3) [m], in any frame.
    """
    centred = points - points.mean(axis=0)
    sizes = np.linalg.svd(centred, compute_uv=False)
    if len(points) < 3 or sizes[2] > _FLAT * sizes[0] or sizes[1] <= _FLAT * sizes[0]:
        return None

    def area(corners: Triangle) -> float:
        first, second, third = points[list(corners)]
        return float(np.linalg.norm(np.cross(second - first, third - first)))

    return max(combinations(range(len(points)), 3), key=area)


def side_of_plane(features: Any, triangle: Triangle) -> Array:
    """Return on which side of the plane of a triangle the camera is: 1 or -1, 0 in it, NaN where a point is not seen.

    It is the sense of rotation of the three corners in the image: where all of them are before the camera, it changes
    where the camera passes through their plane, and nowhere else.

    Parameters
    ----------
    features
        (..., 2p) [px] of points that are before the camera.
    triangle
        As `triangle_of_plane`.
    """
    numbers = np.asarray(features, dtype=float)
    places = numbers.reshape(*numbers.shape[:-1], -1, 2)
    first, second, third = (places[..., corner, :] for corner in triangle)
    one, other = second - first, third - first
    return np.asarray(np.sign(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]))
