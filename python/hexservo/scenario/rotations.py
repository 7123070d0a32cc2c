"""Rotation vectors and quaternions (w, x, y, z), without SciPy: its import is half of the time of a first run."""

from __future__ import annotations

import numpy as np

from hexservo.scenario.arrays import Array


def quaternion_of(vectors: Array) -> Array:
    """Return the quaternions (..., 4) of rotation vectors (..., 3) [rad]."""
    half = 0.5 * vectors
    angle = np.sqrt((half * half).sum(axis=-1, keepdims=True))
    return np.concatenate([np.cos(angle), np.sinc(angle / np.pi) * half], axis=-1)  # sin(angle)/angle, also at zero


def quaternion_product(first: Array, second: Array) -> Array:
    """Multiply quaternions (..., 4): the rotation of the second, then that of the first, in the same frame."""
    a, b, c, d = (first[..., i] for i in range(4))
    w, x, y, z = (second[..., i] for i in range(4))
    found = np.empty(np.broadcast_shapes(first.shape, second.shape))
    found[..., 0] = a * w - b * x - c * y - d * z
    found[..., 1] = a * x + b * w + c * z - d * y
    found[..., 2] = a * y - b * z + c * w + d * x
    found[..., 3] = a * z + b * y - c * x + d * w
    return found


def conjugate(quaternion: Array) -> Array:
    """Return the conjugates of quaternions (..., 4): the rotation back, for those of length one."""
    return np.asarray(quaternion * np.array([1.0, -1.0, -1.0, -1.0]))


def unit_rotation_vectors(unit: Array) -> Array:
    """Return axis times angle of quaternions of length one, (..., 4), as (..., 3) [rad]; the angle is at most pi."""
    unit = np.where(unit[..., :1] < 0, -unit, unit)
    sine = np.sqrt((unit[..., 1:] ** 2).sum(axis=-1, keepdims=True))
    half = np.arctan2(sine, unit[..., :1])
    return np.asarray(2.0 * unit[..., 1:] / np.sinc(half / np.pi))


def quaternions_of_matrices(matrices: Array) -> Array:
    """Return the quaternions (..., 4) of rotation matrices (..., 3, 3).

    4 q q^T has sums and differences of the entries; its row with the largest diagonal is q but for a factor.
    """
    r = matrices
    x, y, z = (r[..., i, i] for i in range(3))
    turned = [r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]]
    xy, xz, yz = (r[..., i, j] + r[..., j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    rows = [
        [1.0 + x + y + z, *turned],
        [turned[0], 1.0 + x - y - z, xy, xz],
        [turned[1], xy, 1.0 - x + y - z, yz],
        [turned[2], xz, yz, 1.0 - x - y + z],
    ]
    outer = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.diagonal(outer, axis1=-2, axis2=-1).argmax(axis=-1)
    row = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(row / np.linalg.norm(row, axis=-1, keepdims=True))
