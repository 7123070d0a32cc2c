"""Answers of ``hexservo new`` in the units of a scenario file."""

from __future__ import annotations

import math

DEGREE = math.pi / 180.0  # [rad]
LEAST_LENGTH = 0.1  # [mm], of an answer


def metres(millimetres: list[float]) -> list[float]:
    """Return lengths [m] of such in mm, in the digits of the file."""
    return [rounded(1e-3 * value) for value in millimetres]


def radians(degrees: list[float]) -> list[float]:
    """Return angles [rad] of such in degrees, in the digits of the file."""
    return [rounded(DEGREE * value) for value in degrees]


def rounded(value: float) -> float:
    """Return a number with the nine digits that it has in the file."""
    return float(f"{value:.9g}")
