"""Depth errors of one sign pattern and of one size, and their drift (docs/analysis/drift.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.scenario.arrays import Array


def signs_of(errors: Array) -> str:
    """Return the signs of depth errors (p,), such as (+,-,-,+)."""
    return "(" + ",".join("+" if part >= 0 else "-" for part in errors) + ")"


@dataclass(frozen=True, eq=False)
class Pattern:
    """Depth errors of one size with one sign per point."""

    signs: str  # such as (+,-,-,+)
    errors: Array  # (p,) delta_Z
    start: float  # smallest real part of an eigenvalue of the loop matrix at the start [1]
    goal: float  # the same at the goal; NaN where there is no goal pose
    direction: Array  # (6,) [m; rad], in B: the one that belongs to `start`
    rate: float  # [1/s], smallest real part of the drift's rates, at the start
    goal_rate: float  # [1/s], the same at the goal; NaN where there is no goal pose
    frequency: float  # [Hz], at which the pose error oscillates where it grows, the faster of both poses; 0: it decays
    late_alone: bool  # an eigenvalue of the loop matrix is large, and the pose error grows, but not with a fresh image
    end: Array | None  # (6,) from home [m; rad], where it comes to rest (`ends`); None: none attracts, or is searched
    end_rate: float  # [1/s], as `rate`, there
    end_error: float  # [px], largest |xi_d - xi| there
    end_travel: float  # [m], largest leg travel there
    end_left: float  # share of its limits that the leg nearest to one has left there; negative: out of reach

    @property
    def slowest(self) -> float:
        """Smallest real part of the drift's rates at start and goal [1/s]; not positive: the pose error grows there."""
        return float(np.nanmin([self.rate, self.goal_rate]))

    @property
    def rank(self) -> float:
        """`slowest`, rounded: two patterns that symmetry makes equal are not ordered by their rounding errors."""
        return round(self.slowest, 9)

    @property
    def time_constant(self) -> float:
        """1/rate [s]: time constant of the creep if positive, of the growth if negative."""
        return _time_constant(self.rate)

    @property
    def goal_time_constant(self) -> float:
        """1/goal_rate [s]; NaN without a goal pose."""
        return _time_constant(self.goal_rate)

    @property
    def end_time_constant(self) -> float:
        """1/end_rate [s]; NaN without an end."""
        return 1.0 / self.end_rate


@dataclass(frozen=True, eq=False)
class Size:
    """All sixteen sign patterns of one size."""

    size: float  # |delta_Z|
    patterns: tuple[Pattern, ...]
    negative: tuple[int, int]  # at start and goal, of the 14 patterns that differ: how many have a negative rate
    negative_inverse_only: tuple[int, int]  # the same with the prior in the inverse alone
    negative_image_only: tuple[int, int]  # the same without a prior, M = 0

    @property
    def worst(self) -> Pattern:
        """The pattern with the smallest rate at start or goal."""
        return min(self.patterns, key=lambda pattern: pattern.rank)


def _time_constant(rate: float) -> float:
    return 1.0 / rate if rate != 0.0 else np.inf
