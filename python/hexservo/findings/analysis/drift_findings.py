"""Findings of the drift analysis as sentences, tables and curves (docs/analysis/drift.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.analysis.words import direction_words, open_section
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Cell, Column, Curves, Item, Line, Section, Table
from hexservo.scenario.arrays import Array

__all__ = ["GRID", "LARGEST", "SIZES", "Drift", "Pattern", "Size"]

PAGE = "docs/analysis/drift.md"
SIZES = (0.05, 0.3)  # of depth errors, beside the scenario's own
LARGEST = 0.95  # that is searched; at 1 an assumed depth is zero
GRID = 20  # sizes up to it before the bisection, so that a border that is not the only one is found


@dataclass(frozen=True, eq=False)
class Pattern:
    """Depth errors of one size with one sign per point."""

    signs: str  # such as (+,-,-,+)
    errors: Array  # (4,) delta_Z
    start: float  # smallest real part of an eigenvalue of the loop matrix at the start [1]
    goal: float  # the same at the goal; NaN where there is no goal pose
    direction: Array  # (6,) [m; rad], in B: the one that belongs to `start`
    rate: float  # [1/s], smallest real part of the drift's rates, at the start
    end: Array | None  # (6,) from home [m; rad], where the pose error is zero; None where none attracts
    end_rate: float  # [1/s], as `rate`, there
    end_error: float  # [px], largest |xi_d - xi| there
    end_travel: float  # [m], largest leg travel there

    @property
    def time_constant(self) -> float:
        """1/rate [s]: of the slowest part of the way where positive, of its growth where negative."""
        return 1.0 / self.rate if self.rate != 0.0 else np.inf

    @property
    def end_time_constant(self) -> float:
        """1/end_rate [s]; NaN without an end."""
        return 1.0 / self.end_rate


@dataclass(frozen=True, eq=False)
class Size:
    """All sixteen sign patterns of one size."""

    size: float  # |delta_Z|
    patterns: tuple[Pattern, ...]
    negative: tuple[int, int]  # at start and goal, of the 14 patterns that differ: how many have a negative eigenvalue
    negative_inverse_only: tuple[int, int]  # the same with the prior in the inverse alone
    negative_image_only: tuple[int, int]  # the same without a prior, M = 0

    @property
    def worst(self) -> Pattern:
        """The pattern with the smallest eigenvalue at start or goal."""
        return min(self.patterns, key=_order)


@dataclass(frozen=True, eq=False, repr=False)
class Drift(Findings):
    """Eigenvalues that decide the drift, or why there are none."""

    law: str
    open_because: str  # empty where the analysis applies
    driven_by: str = ""  # what takes the pose error to a velocity
    depth: float = 0.0  # [m], mean, from home
    stroke: float = 0.0  # [m]
    own: Pattern | None = None  # the scenario's own depth errors
    sizes: tuple[Size, ...] = ()  # by size; the scenario's own among them
    limit_start: float | None = (
        None  # |delta_Z| up to which all patterns are positive; None: up to the largest searched
    )
    limit_goal: float | None = None
    has_goal: bool = True
    has_prior: bool = True  # one that is expected, not only in the inverse
    leaks: bool = False  # the weights that integrate
    grid: Array | None = None  # (n,) sizes
    curves: dict[str, Array] | None = None  # (n,) smallest eigenvalue over all patterns, by place and prior

    def section(self) -> Section:
        """Words, the sixteen patterns, the sizes, and the smallest eigenvalue over the size."""
        title = "Slow drift under unequal depth errors"
        if self.open_because:
            return open_section("drift", title, self.open_because)
        return Section("drift", title, self._sentences(), self._items(), self._verdict(), self._data())

    @property
    def _chosen(self) -> Size:
        """The size of the scenario, or 30 % where it has no depth error."""
        assert self.own is not None
        size = float(np.abs(self.own.errors).max()) or SIZES[-1]
        return next(s for s in self.sizes if s.size == size)

    def _verdict(self) -> Any:
        assert self.own is not None
        if _smallest(self.own) <= 0.0:
            return "bad"
        return "warning" if _smallest(self._chosen.worst) <= 0.0 or self._beyond(self.own) else "good"

    def _beyond(self, pattern: Pattern) -> bool:
        return pattern.end is None or pattern.end_travel > self.stroke

    def _sentences(self) -> list[str]:
        assert self.own is not None
        chosen, worst = self._chosen, self._chosen.worst
        places = "start and goal" if self.has_goal else "the start (the goal image belongs to no pose)"
        words = [
            f"Of all sixteen signs of depth errors of {100 * chosen.size:.3g} % the worst is {worst.signs}: the "
            f"smallest eigenvalue of the loop matrix is {worst.start:.3g} at the start"
            + (f" and {worst.goal:.3g} at the goal" if self.has_goal else "")
            + f", along {direction_words(worst.direction, self.depth)}."
        ]
        if worst.rate > 0.0:
            words.append(
                f"There {self.law} creeps with a time constant of {worst.time_constant:.3g} s at the start "
                f"({self.driven_by})" + self._end_words(worst) + "."
            )
        else:
            words.append(
                f"There {self.law} drifts away: the pose error grows e-fold in {-worst.time_constant:.3g} s "
                f"({self.driven_by}) until another effect stops it."
            )
        own = self.own
        if np.ptp(own.errors) > 0.0:
            words.append(
                f"With the scenario's own depth errors the smallest eigenvalue is {_smallest(own):.3g}, and the time "
                f"constant at the start {own.time_constant:.3g} s" + self._end_words(own) + "."
            )
        else:
            words.append(
                f"The scenario's own depth errors are equal ({own.errors[0]:+.3g}): the smallest eigenvalue is "
                f"{_smallest(own):.3g}, and the slowest mode has a time constant of {own.time_constant:.3g} s."
            )
        without = "; ".join(
            f"{s.negative_image_only[0]} of 14 at the start"
            + (f" and {s.negative_image_only[1]} at the goal" if self.has_goal else "")
            + f" at {100 * s.size:.3g} %"
            for s in self.sizes
        )
        if self.has_prior:
            words.append(f"Without the prior some of the 14 unequal patterns have a negative eigenvalue: {without}.")
        if self.leaks:
            words.append("The leakage of the weights is neglected: it limits the drift and leaves an error instead.")
        limits = [limit for limit in (self.limit_start, self.limit_goal) if limit is not None]
        if limits:
            words.append(
                f"All patterns stay positive at {places} up to depth errors of {100 * min(limits):.3g} % (searched on "
                f"a grid of {GRID} sizes up to {100 * LARGEST:.3g} % and by bisection)."
            )
        else:
            words.append(f"All patterns stay positive at {places} up to {100 * LARGEST:.3g} %, the largest searched.")
        return words

    def _end_words(self, pattern: Pattern) -> str:
        if pattern.end is None:
            return ""
        away = 1e3 * np.linalg.norm(pattern.end[:3])
        text = (
            f" and {pattern.end_time_constant:.3g} s at its end, {away:.3g} mm from home, with "
            f"{pattern.end_error:.3g} px and {1e3 * pattern.end_travel:.3g} mm of leg travel"
        )
        return text + (f", beyond the stroke of {1e3 * self.stroke:.3g} mm" if self._beyond(pattern) else "")

    def _items(self) -> list[Item]:
        chosen = self._chosen
        rows: list[list[Cell]] = [
            [
                p.signs,
                p.start,
                _number(p.goal),
                _number(p.time_constant),
                _number(p.end_time_constant),
                None if p.end is None else 1e3 * float(np.linalg.norm(p.end[:3])),
                _number(p.end_error),
                _number(1e3 * p.end_travel),
                direction_words(p.direction, self.depth),
            ]
            for p in sorted(chosen.patterns, key=_order)
        ]
        columns = [
            Column("signs"),
            Column("smallest eigenvalue, start", "1", ".3g"),
            Column("smallest eigenvalue, goal", "1", ".3g"),
            Column("time constant, start", "s", ".3g"),
            Column("time constant, end", "s", ".3g"),
            Column("end of the drift, from home", "mm", ".3g"),
            Column("image error there", "px", ".2g"),
            Column("leg travel there", "mm", ".3g"),
            Column("direction"),
        ]
        sizes: list[list[Cell]] = [
            [
                100 * s.size,
                s.worst.signs,
                _smallest(s.worst),
                s.negative[0],
                _count(s.negative[1], self.has_goal),
                s.negative_inverse_only[0],
                _count(s.negative_inverse_only[1], self.has_goal),
                s.negative_image_only[0],
                _count(s.negative_image_only[1], self.has_goal),
            ]
            for s in self.sizes
        ]
        size_columns = [
            Column("depth errors", "%", ".3g"),
            Column("worst signs"),
            Column("its smallest eigenvalue", "1", ".3g"),
            Column("negative, start", "of 14", "d"),
            Column("negative, goal", "of 14", "d"),
            Column("prior in the inverse only, start", "of 14", "d"),
            Column("prior in the inverse only, goal", "of 14", "d"),
            Column("no prior, start", "of 14", "d"),
            Column("no prior, goal", "of 14", "d"),
        ]
        items: list[Item] = [
            Table(
                f"Sign patterns of depth errors of {100 * chosen.size:.3g} %",
                columns,
                rows,
                "A negative time constant is that of growth. The end is where the pose error is zero, by Newton's "
                "method on the core's law, without a gravity error.",
                PAGE,
            ),
            Table("Sizes of depth errors", size_columns, sizes, "Unequal signs only: 14 of the 16 patterns.", PAGE),
        ]
        if self.grid is not None and self.curves:
            lines = [
                Line(name, 100 * self.grid, values, "dashed" if "no prior" in name else "line")
                for name, values in self.curves.items()
            ]
            items.append(
                Curves(
                    "Smallest eigenvalue over all sign patterns",
                    "depth error [%]",
                    "smallest real part [1]",
                    lines,
                    note="Below zero the pose error grows in some direction.",
                    page=PAGE,
                )
            )
        return items

    def _data(self) -> dict[str, Any]:
        assert self.own is not None

        def numbers(p: Pattern) -> dict[str, Any]:
            return {
                "signs": p.signs,
                "depth_errors": p.errors,
                "smallest_eigenvalue_start": p.start,
                "smallest_eigenvalue_goal": p.goal,
                "direction": p.direction,
                "rate": p.rate,
                "time_constant": p.time_constant,
                "end_displacement": p.end,
                "end_rate": p.end_rate,
                "end_error": p.end_error,
                "end_leg_travel": p.end_travel,
            }

        return {
            "applies": True,
            "law": self.law,
            "own": numbers(self.own),
            "sizes": [
                {
                    "size": s.size,
                    "worst": s.worst.signs,
                    "negative": s.negative,
                    "negative_prior_in_inverse_only": s.negative_inverse_only,
                    "negative_without_prior": s.negative_image_only,
                    "patterns": [numbers(p) for p in s.patterns],
                }
                for s in self.sizes
            ],
            "limit_start": self.limit_start,
            "limit_goal": self.limit_goal,
            "largest_searched": LARGEST,
        }


def _smallest(pattern: Pattern) -> float:
    return float(np.nanmin([pattern.start, pattern.goal]))


def _order(pattern: Pattern) -> float:
    return round(_smallest(pattern), 9)  # of two that symmetry makes equal the first is taken, not what rounding says


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _count(value: int, known: bool) -> int | None:
    return value if known else None
