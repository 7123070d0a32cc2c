"""Rules for poses of six numbers: a shift, and a rotation vector in radians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from hexservo import _core
from hexservo.scenario.arrays import Array
from hexservo.scenario.rules import ArrayRule, Rule, Vector, refusal


def turns_of(poses: ArrayLike) -> Array:
    """Return the lengths (...) of the rotation vectors of poses (..., 6) [rad]."""
    with np.errstate(over="ignore"):  # too long, then
        return np.asarray(np.hypot.reduce(np.asarray(poses, dtype=float)[..., 3:], axis=-1))


def problem_of_turns(poses: ArrayLike) -> str | None:
    """Return what is wrong with the longest rotation vector of poses (..., 6) [m; rad], or None."""
    longest = float(np.max(turns_of(poses), initial=0.0))
    if longest <= _core.LONGEST_TURN:
        return None
    got = f"one of {longest:.6g} (degrees? multiply by pi/180)"
    return f"expected a rotation vector at most pi long (radians), got {got}"


@dataclass(frozen=True)
class PoseRule(ArrayRule):
    """A pose as six numbers."""

    shape: tuple[int, ...] = (6,)
    expected = "6 finite numbers (m x3, rad x3)"

    def accept(self, value: Any) -> Vector:
        """Return the numbers, or raise `refusal`."""
        pose = cast("Vector", super().accept(value))
        if (problem := problem_of_turns(pose)) is not None:
            raise refusal(((), problem))
        return pose


class DisplacementRule(Rule):
    """A pose as its displacement from another, or null; it is read into other keys, and so does not vary in a batch."""

    expected = f"{PoseRule.expected} or null"

    def accept(self, value: Any) -> Vector | None:
        """Return the numbers or None, or raise `refusal`."""
        if value is None:
            return None
        if not isinstance(value, list):
            self.refuse(value)
        return PoseRule().accept(value)
