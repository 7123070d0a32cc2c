"""Directions in words, for the sentences of the analyses."""

from __future__ import annotations

import numpy as np

from hexservo._analysis._scene import Array

__all__ = ["along", "motion_in_words", "number", "numbers"]

_AXES = "xyz"


def number(value: float) -> str:
    """Write a number with three digits, and without an exponent below a million: "0.0123", "1.23", "28800"."""
    return f"{float(f'{value:.3g}') + 0.0:g}"


def numbers(values: Array) -> str:
    """Write numbers one after another: "1.2, 3.4 and 5.6"."""
    texts = [number(value) for value in values]
    return ", ".join(texts[:-1]) + " and " + texts[-1] if len(texts) > 1 else texts[0]


def along(vector: Array) -> str:
    """Name the axis that a vector (3,) is along, or give its direction: "x", "(0.71, 0.70, 0.00)"."""
    unit = vector / np.linalg.norm(vector)
    largest = int(np.abs(unit).argmax())
    if abs(unit[largest]) > 0.98:
        return _AXES[largest]
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in np.where(np.abs(unit) < 0.005, 0.0, unit)) + ")"


def motion_in_words(jacobian: Array, motion: Array) -> str:
    """Say what a small motion is, by what its parts do to the image.

    Parameters
    ----------
    jacobian
        (8, 6), of the image [px/m; px/rad].
    motion
        (6,), shift [m] and rotation vector [rad], both in B.
    """
    shift, turn = motion[:3], motion[3:]
    by_shift = float(np.linalg.norm(jacobian[:, :3] @ shift))
    by_turn = float(np.linalg.norm(jacobian[:, 3:] @ turn))
    left = float(np.linalg.norm(jacobian @ motion))
    if by_turn <= 0.2 * by_shift:
        return f"a shift along {along(shift)}"
    if by_shift <= 0.2 * by_turn:
        return f"a turn about {along(turn)}"
    together = "that a turn about {} undoes" if left < 0.5 * max(by_shift, by_turn) else "with a turn about {}"
    return f"a shift along {along(shift)} " + together.format(along(turn))
