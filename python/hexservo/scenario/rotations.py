"""Rotation vectors and quaternions (w, x, y, z), without SciPy: its import is half of the time of a first run."""

from __future__ import annotations

import math

import numpy as np

from hexservo.scenario.arrays import Array


def quaternion_of(vector: Array) -> Array:
    """Return the quaternion (4,) of a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(vector))
    return np.concatenate([[math.cos(angle / 2)], 0.5 * float(np.sinc(angle / 2 / math.pi)) * vector])


def unit_rotation_vectors(unit: Array) -> Array:
    """Return axis times angle of quaternions of length one, (..., 4), as (..., 3) [rad]; the angle is at most pi."""
    unit = np.where(unit[..., :1] < 0, -unit, unit)
    sine = np.sqrt((unit[..., 1:] ** 2).sum(axis=-1, keepdims=True))
    half = np.arctan2(sine, unit[..., :1])
    return np.asarray(2.0 * unit[..., 1:] / np.sinc(half / np.pi))
