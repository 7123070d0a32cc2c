"""Slow drift of the laws that regulate a pose error, under depth errors that differ (docs/analysis/drift.md)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo import _core
from hexservo._analysis._rest import Array, Mask, Poses, Rest, direction_words
from hexservo._evidence import Cell, Column, Curves, Item, Line, Section, Table
from hexservo._scenario import Scenario

__all__ = ["Drift", "Pattern", "Size", "analyse", "loop_matrix"]

_PAGE = "docs/analysis/drift.md"
_SIZES = (0.05, 0.3)  # beside the scenario's own
_LARGEST = 0.95  # depth errors that are searched; at 1 a believed depth is zero
_GRID = 20  # sizes up to it before the bisection, so that a border that is not the only one is found
_ROUNDS = 20  # of bisection
_CREEP_ROUNDS = 30  # of the search for the end of the drift
_SIGNS = np.array(list(itertools.product((1.0, -1.0), repeat=4)))  # (16, 4)

_NOT_FOR = {
    "hybrid": "it forms no pose error; what its image part does under unequal depth errors is in equilibria",
    "kelly": "it forms no pose error; what its image part does under unequal depth errors is in equilibria",
    "pbvs": "it estimates the pose by iteration from points that it believes to know",
}


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
        return min(self.patterns, key=lambda p: np.nanmin([p.start, p.goal]))


@dataclass(frozen=True, eq=False)
class Drift:
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
            return Section("drift", title, [self.open_because], data={"applies": False, "reason": self.open_because})
        return Section("drift", title, self._sentences(), self._items(), self._verdict(), self._data())

    @property
    def _chosen(self) -> Size:
        """The size of the scenario, or 30 % where it has no depth error."""
        assert self.own is not None
        size = float(np.abs(self.own.errors).max()) or _SIZES[-1]
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
        places = "start and goal" if self.has_goal else "the start (no pose shows the goal image)"
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
                f"({self.driven_by}) until something else stops it."
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
                f"{_smallest(own):.3g}, and what is slowest has a time constant of {own.time_constant:.3g} s."
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
            words.append("The leakage of the weights is left out: it holds the drift back and leaves an error instead.")
        limits = [limit for limit in (self.limit_start, self.limit_goal) if limit is not None]
        if limits:
            words.append(
                f"All patterns stay positive at {places} up to depth errors of {100 * min(limits):.3g} % (searched on "
                f"a grid of {_GRID} sizes up to {100 * _LARGEST:.3g} % and by bisection)."
            )
        else:
            words.append(f"All patterns stay positive at {places} up to {100 * _LARGEST:.3g} %, the largest searched.")
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
            for p in sorted(chosen.patterns, key=_smallest)
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
                _PAGE,
            ),
            Table("Sizes of depth errors", size_columns, sizes, "Unequal signs only: 14 of the 16 patterns.", _PAGE),
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
                    page=_PAGE,
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
            "largest_searched": _LARGEST,
        }


def analyse(scenario: Scenario) -> Drift:
    """Give the eigenvalues that decide the drift of a law with a pose error (docs/analysis/drift.md).

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    law = scenario.controller.law
    if law in _NOT_FOR:
        return Drift(law, f"The law {law} is not analysed here: {_NOT_FOR[law]}.")
    if law == "resolved_rate" and scenario.controller.resolved_rate.jacobian_at != "current":
        return Drift(law, "resolved_rate with a Jacobian of the goal: not analysed, since no depth of an image enters.")
    if scenario.camera.convention == "as_printed":
        return Drift(law, "A camera as_printed has no points in space: not analysed.")
    if scenario.controller.jacobian == "printed":
        return Drift(law, "With the printed sign of the Jacobian every feature runs away from its goal: not analysed.")
    return _Worker(scenario).drift()


def loop_matrix(known: Array, true: Array, inverse: Array, expected: Array) -> Array:
    """Give the matrix E of de = -E dchi, (..., 6, 6), dimensionless per pair of like units.

    E = (J-hat^T J-hat + M)^-1 (J-hat^T J + M_e), where M_e is the part of the prior M that is also expected: M for
    `composite` and `computed_torque`, 0 for a damping that is in the inverse alone.

    Parameters
    ----------
    known, true
        J-hat and J (..., 8, 6): twist in B (m/s; rad/s) to feature rates [px/s].
    inverse, expected
        Diagonals of M and M_e, (6,) [px^2/m^2; px^2/rad^2].

    Raises
    ------
    numpy.linalg.LinAlgError
        Where J-hat^T J-hat + M is singular.
    """
    turned = np.swapaxes(known, -1, -2)
    found: Array = np.linalg.solve(turned @ known + np.diag(inverse), turned @ true + np.diag(expected)).astype(float)
    return found


class _Worker:
    """What the places and patterns of one scenario share."""

    def __init__(self, scenario: Scenario) -> None:
        self.rest = Rest(scenario)
        self.law = scenario.controller.law
        self.gains = self.rest.gains
        self.goal = self.rest.goal()
        places = [self.rest.home] if self.goal is None else [self.rest.home, self.goal]
        self.places = [(pose, *self.rest.image(pose)) for pose in places]
        self.true = [self.rest.jacobian(features, depth, pose)[0] for pose, features, depth in self.places]
        if self.law == "resolved_rate":
            self.inverse, self.expected = np.array(self.gains.damping), np.zeros(6)
        else:
            self.inverse = self.expected = np.array(self.gains.prior)
        self.drive, self.driven_by = self._drive()

    def _drive(self) -> tuple[Array, str]:
        """Give the diagonal that takes a small pose error to a velocity [1/s], where the rest is faster."""
        if self.law == "resolved_rate":
            return np.full(6, float(self.gains.gain)), "its gain times the eigenvalue"
        if self.law == "computed_torque":
            return np.array(self.gains.kp) / np.array(self.gains.kd), "K_p/K_d times the eigenvalue"
        if self.gains.fuzzy.enabled:
            return np.array(self.gains.drive), "Lambda times the eigenvalue"
        return np.array(self.gains.kt) / np.array(self.gains.kd), "K_t/K_d times the eigenvalue, K_v aside"

    def known(self, place: int, errors: Array) -> Array:
        """Give J-hat (n, 8, 6) at a place for depth errors (n, 4): the core's J at Z-hat = (1 + delta) Z, (9)."""
        pose, features, depth = self.places[place]
        count = len(errors)
        return self.rest.jacobian(np.repeat(features, count, axis=0), (1.0 + errors) * depth, pose.repeated(count))

    def smallest(self, place: int, errors: Array, inverse: Array, expected: Array) -> Array:
        """Give the smallest real part of an eigenvalue of the loop matrix, (n,)."""
        matrix = loop_matrix(self.known(place, errors), self.true[place], inverse, expected)
        return np.asarray(np.linalg.eigvals(matrix).real.min(axis=1))

    def patterns(self, errors: Array) -> tuple[Pattern, ...]:
        """Describe depth errors (n, 4)."""
        matrix = loop_matrix(self.known(0, errors), self.true[0], self.inverse, self.expected)
        unit = self.rest.unit
        values, vectors = np.linalg.eig(matrix * unit / unit[:, None])
        rates = np.linalg.eigvals(matrix * self.drive).real.min(axis=1)
        ends, ended = self.ends(errors)
        end_rates = self.rates_at(ends, errors, ended)
        ended &= end_rates > 0.0  # an end that does not attract is none
        seen = self.rest.image(ends)[0]
        travel = np.abs(self.rest.leg_travel(ends)).max(axis=1)
        moved = ends.displacement_from(self.rest.home)
        if len(self.places) > 1:
            at_goal = self.smallest(1, errors, self.inverse, self.expected)
        else:
            at_goal = np.full(len(errors), np.nan)
        found = []
        for i, error in enumerate(errors):
            least = int(np.argmin(values[i].real))
            direction = vectors[i, :, least].real * unit
            found.append(
                Pattern(
                    "(" + ",".join("+" if part >= 0 else "-" for part in error) + ")",
                    error,
                    float(values[i, least].real),
                    float(at_goal[i]),
                    direction / np.linalg.norm(direction / unit),
                    float(rates[i]),
                    moved[i] if ended[i] else None,
                    float(end_rates[i]) if ended[i] else np.nan,
                    float(np.abs(self.rest.desired - seen[i]).max()) if ended[i] else np.nan,
                    float(travel[i]) if ended[i] else np.nan,
                )
            )
        return tuple(found)

    def ends(self, errors: Array) -> tuple[Poses, Mask]:
        """Look for poses where the pose error is zero, from the start, and tell which were found."""
        probe = _core.Probe(_only_pose_error(self.rest.settings, self.inverse))
        count = len(errors)
        home = self.rest.home
        poses = home.repeated(count)
        still = np.zeros((count, 6))
        _, _, weight = probe.estimated_wrenches(home.quaternion, still[:1], still[:1])
        last = np.full(count, np.inf)
        for _ in range(_CREEP_ROUNDS if self.expected.any() else 0):
            features, depth = self.rest.image(poses)
            seen = np.asarray(np.isfinite(features).all(axis=1))
            if not seen.any():
                break
            there, believed = poses[seen], (1.0 + errors[seen]) * depth[seen]
            law = probe.law(features[seen], believed, there.position, there.quaternion, still[seen])
            error = law.wrench - weight  # K_t is one and everything else zero: the wrench is e
            known = probe.image_jacobian(features[seen], believed, there.quaternion)
            true = probe.image_jacobian(features[seen], depth[seen], there.quaternion)
            slope = loop_matrix(known, true, self.inverse, self.expected)
            step = np.zeros((count, 6))
            step[seen] = np.linalg.solve(slope, error[..., None])[..., 0]
            scaled = np.abs(step / self.rest.unit).max(axis=1)
            last = np.where(seen, scaled, np.inf)
            poses = poses.moved(step * np.minimum(1.0, 0.1 / np.maximum(scaled, 1e-300))[:, None])
        return poses, last < 1e-9

    def rates_at(self, poses: Poses, errors: Array, rows: Mask) -> Array:
        """Give the smallest real part of the drift's rates at poses, (n,) [1/s]; NaN in rows that are not asked for."""
        result = np.full(len(poses), np.nan)
        if rows.any():
            there = poses[rows]
            features, depth = self.rest.image(there)
            known = self.rest.jacobian(features, (1.0 + errors[rows]) * depth, there)
            matrix = loop_matrix(known, self.rest.jacobian(features, depth, there), self.inverse, self.expected)
            result[rows] = np.linalg.eigvals(matrix * self.drive).real.min(axis=1)
        return result

    def size(self, size: float) -> Size:
        """Describe all patterns of a size, and count those with a negative eigenvalue."""
        errors = size * _SIGNS
        unequal = errors[1:-1]
        none = np.zeros(6)

        def negative(inverse: Array, expected: Array) -> tuple[int, int]:
            start, *goal = (
                int((self.smallest(k, unequal, inverse, expected) < 0.0).sum()) for k in range(len(self.places))
            )
            return start, goal[0] if goal else 0

        return Size(
            size,
            self.patterns(errors),
            negative(self.inverse, self.expected),
            negative(self.inverse, none),
            negative(none, none),
        )

    def over_sizes(self, place: int, sizes: Array, inverse: Array, expected: Array) -> Array:
        """Give the smallest eigenvalue over all patterns for each size, (n,)."""
        errors = (sizes[:, None, None] * _SIGNS).reshape(-1, 4)
        return np.asarray(self.smallest(place, errors, inverse, expected).reshape(len(sizes), -1).min(axis=1))

    def limit(self, place: int, grid: Array, values: Array) -> float | None:
        """Give the size at which the first pattern loses its positive eigenvalue, between two sizes of the grid."""
        lost = np.flatnonzero(values <= 0.0)
        if not len(lost):
            return None
        high = float(grid[lost[0]])
        low = float(grid[lost[0] - 1]) if lost[0] else 0.0
        for _ in range(_ROUNDS):
            middle = (low + high) / 2
            if self.over_sizes(place, np.array([middle]), self.inverse, self.expected)[0] > 0.0:
                low = middle
            else:
                high = middle
        return low

    def drift(self) -> Drift:
        """Put everything together."""
        own = np.array(self.rest.settings.uncertainty.depth, dtype=float)
        size = float(np.abs(own).max())
        sizes = sorted({*_SIZES, *([size] if size > 0.0 else [])})
        grid = np.linspace(0.0, _LARGEST, _GRID + 1)[1:]
        curves = {}
        limits: list[float | None] = []
        for place, name in enumerate(("start", "goal")[: len(self.places)]):
            curves[name] = self.over_sizes(place, grid, self.inverse, self.expected)
            curves[f"{name}, no prior"] = self.over_sizes(place, grid, np.zeros(6), np.zeros(6))
            limits.append(self.limit(place, grid, curves[name]))
        return Drift(
            self.law,
            "",
            self.driven_by,
            self.rest.depth,
            float(self.rest.settings.robot.stroke),
            self.patterns(own[None])[0],
            tuple(self.size(s) for s in sizes),
            limits[0],
            limits[1] if len(limits) > 1 else None,
            self.goal is not None,
            bool(self.expected.any()),
            self.law == "composite" and bool(self.gains.fuzzy.enabled and np.any(self.gains.fuzzy.leakage)),
            grid,
            curves,
        )


def _only_pose_error(like: Any, prior: Array) -> _core.CompositeSettings:
    """Give the law composite with a K_t of one and nothing else but the weight: its wrench is the pose error."""
    settings = _core.CompositeSettings()
    for key in ("robot", "camera", "convention", "jacobian", "target", "uncertainty", "simulation"):
        setattr(settings, key, getattr(like, key))
    gains = settings.gains
    gains.kp, gains.kv, gains.kd, gains.kt, gains.prior = np.zeros(8), np.zeros(6), np.zeros(6), np.ones(6), prior
    gains.fuzzy.enabled = False
    return settings


def _smallest(pattern: Pattern) -> float:
    return float(np.nanmin([pattern.start, pattern.goal]))


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _count(value: int, known: bool) -> int | None:
    return value if known else None
