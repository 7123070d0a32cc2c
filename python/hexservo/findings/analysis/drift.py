"""Slow drift of the laws that regulate a pose error, under unequal depth errors (docs/analysis/drift.md)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses, without_sign
from hexservo.findings.analysis.rest import Rest, not_analysed
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.scenario import Scenario

SIZES = (0.05, 0.3)  # of depth errors, beside the scenario's own
LARGEST = 0.95  # that is searched; at 1 an assumed depth is zero
GRID = 20  # sizes up to it before the bisection, so that a border that is not the only one is found
_ROUNDS = 20  # of bisection
_CREEP_ROUNDS = 30  # of the search for the end of the drift
_POINTS = 4  # whose patterns are analysed
_SIGNS = np.array(list(itertools.product((1.0, -1.0), repeat=_POINTS)))  # (16, 4)


@dataclass(frozen=True, eq=False)
class Pattern:
    """Depth errors of one size with one sign per point."""

    signs: str  # such as (+,-,-,+)
    errors: Array  # (p,) delta_Z
    start: float  # smallest real part of an eigenvalue of the loop matrix at the start [1]
    goal: float  # the same at the goal; NaN where there is no goal pose
    direction: Array  # (6,) [m; rad], in B: the one that belongs to `start`
    rate: float  # [1/s], smallest real part of the drift's rates, at the start
    end: Array | None  # (6,) from home [m; rad], where the pose error is zero; None where none attracts
    end_rate: float  # [1/s], as `rate`, there
    end_error: float  # [px], largest |xi_d - xi| there
    end_travel: float  # [m], largest leg travel there
    end_left: float  # share of its limits that the leg nearest to one has left there; negative: out of reach

    @property
    def smallest(self) -> float:
        """Smallest real part of an eigenvalue at start and goal [1]."""
        return float(np.nanmin([self.start, self.goal]))

    @property
    def rank(self) -> float:
        """`smallest`, rounded: two patterns that symmetry makes equal are not ordered by their rounding errors."""
        return round(self.smallest, 9)

    @property
    def time_constant(self) -> float:
        """1/rate [s]: time constant of the creep if positive, of the growth if negative."""
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
        return min(self.patterns, key=lambda pattern: pattern.rank)


@dataclass(frozen=True, eq=False, repr=False)
class Drift(Part):
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
    leg_unit: str = "mm"  # a thousandth of the unit of leg travel


def analyse(scenario: Scenario) -> Drift:
    """Compute the eigenvalues that decide the drift of a law with a pose error (docs/analysis/drift.md).

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    law = scenario.controller.law
    if reason := not_analysed(scenario, _not_for(scenario)):
        return Drift(law, reason)
    if getattr(scenario.controller.gains, "jacobian_at", "current") != "current":
        return Drift(law, f"{law} with a Jacobian of the goal: not analysed, since no depth of an image enters.")
    if scenario.controller.jacobian == "printed":
        return Drift(law, "With the printed sign of the Jacobian every feature moves away from its goal: not analysed.")
    return _Worker(scenario).drift()


def _not_for(scenario: Scenario) -> str:
    """Return why a scenario is not analysed; empty with a pose error by (J-hat^T W J-hat + M)^-1 of four points."""
    law = scenario.controller.traits
    if scenario.target.count != _POINTS:
        return f"its patterns of depth errors are those of four points, and the target has {scenario.target.count}"
    if law.output == "pose":
        return "it sends the legs to a pose that it filters, whatever the depth errors"
    if not law.pose_error:
        return "it forms no pose error; for its image part under unequal depth errors see equilibria"
    return "" if law.inverse else "it estimates the pose by iteration from assumed target points"


def loop_matrix(known: Array, true: Array, inverse: Array, expected: Array) -> Array:
    """Return the matrix E of de = -E dchi, (..., 6, 6), dimensionless per pair of like units.

    E = (J-hat^T W J-hat + M)^-1 (J-hat^T W J + M_e), where M_e is the part of the prior M that is also expected: M for
    `composite` and `computed_torque`, 0 for a damping that is in the inverse alone.

    Parameters
    ----------
    known, true
        sqrt(W) J-hat and sqrt(W) J (..., 2p, 6): twist in B (m/s; rad/s) to feature rates [px/s].
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
    """Computations for one scenario, shared by all places and patterns."""

    def __init__(self, scenario: Scenario) -> None:
        self.rest = Rest(scenario)
        self.traits = scenario.controller.traits
        self.gains = self.rest.gains
        goals = find_goals(scene_of(scenario))
        self.goal = None if goals is None else goals.shown_at
        places = [self.rest.start] if self.goal is None else [self.rest.start, self.goal]
        self.places = [(pose, *self.rest.image(pose)) for pose in places]
        self.root = self.rest.root_weights
        self.true = [self.jacobian(*place) for place in self.places]
        self.inverse = np.array(getattr(self.gains, self.traits.inverse))
        self.expected = self.inverse if self.traits.prior else np.zeros(6)
        self.drive, self.driven_by = self._drive()

    def _drive(self) -> tuple[Array, str]:
        """Return the matrix (6, 6) from a small pose error to a velocity [1/s], where all else is faster."""
        gains = self.gains
        if self.traits.output == "twist":
            return float(gains.gain) * np.eye(6), "its gain times the eigenvalue"
        if self.integrates:
            return np.diag(gains.drive), "Lambda times the eigenvalue"
        spring = "kt" if hasattr(gains, "kt") else "kp"  # K_p of a law with an image spring is that of the image
        friction = ", K_v aside" if self.traits.switching else ""
        pulls, damps = np.diag(getattr(gains, spring)), np.diag(gains.kd)
        ratio = f"K_{spring[1]}/K_d"
        scenario = self.rest.scenario
        resists = np.broadcast_to(scenario.controller.virtual_platform.damping, 6)
        if scenario.actuators.takes_positions and resists.any():  # what moves is the virtual platform
            if spring == "kp":  # accelerations
                inertia = self.rest.probe.inertia(self.rest.home.rows.quaternion)[0]
                pulls, damps = inertia @ pulls, inertia @ damps
            damps = damps + np.diag(resists)
            ratio = f"K_{spring[1]}/(K_d + D_v)"
        return np.linalg.solve(damps, pulls), f"{ratio} times the eigenvalue{friction}"

    @property
    def integrates(self) -> bool:
        """Whether fuzzy systems are driven by the pose error."""
        return self.traits.memory and bool(self.gains.fuzzy.enabled)

    def jacobian(self, poses: Poses, features: Array, depth: Array, errors: Array | None = None) -> Array:
        """Return sqrt(W) J (..., 2p, 6), or with depth errors sqrt(W) J-hat, the law's at (1 + delta) Z, (9)."""
        if errors is None:
            return self.root * self.rest.jacobian(features, depth, poses)
        return self.root * self.rest.jacobian(features, (1.0 + errors) * depth, poses, assumed=True)

    def known(self, place: int, errors: Array) -> Array:
        """Return sqrt(W) J-hat (n, 2p, 6) at a place for depth errors (n, p)."""
        pose, features, depth = self.places[place]
        count = len(errors)
        return self.jacobian(pose.repeated(count), np.tile(features, (count, 1)), depth, errors)

    def matrix(self, poses: Poses, features: Array, depth: Array, errors: Array) -> Array:
        """Return the loop matrix at poses (n,) from which an image is seen, for depth errors (n, p)."""
        known, true = self.jacobian(poses, features, depth, errors), self.jacobian(poses, features, depth)
        return loop_matrix(known, true, self.inverse, self.expected)

    def smallest(self, place: int, errors: Array, inverse: Array, expected: Array) -> Array:
        """Return the smallest real part of an eigenvalue of the loop matrix, (n,)."""
        matrix = loop_matrix(self.known(place, errors), self.true[place], inverse, expected)
        return np.asarray(np.linalg.eigvals(matrix).real.min(axis=1))

    def patterns(self, errors: Array) -> tuple[Pattern, ...]:
        """Describe depth errors (n, p)."""
        matrix = loop_matrix(self.known(0, errors), self.true[0], self.inverse, self.expected)
        unit = self.rest.unit
        values, vectors = np.linalg.eig(matrix * unit / unit[:, None])
        rates = np.linalg.eigvals(matrix @ self.drive).real.min(axis=1)
        ends, ended = self.ends(errors)
        end_rates = self.rates_at(ends, errors, ended)
        ended &= end_rates > 0.0  # an end that does not attract is none
        seen = self.rest.image(ends)[0]
        travel = np.abs(self.rest.leg_travel(ends)).max(axis=1)
        left = self.rest.limits_left(ends)
        moved = ends.displacement_from(self.rest.home)
        if len(self.places) > 1:
            at_goal = self.smallest(1, errors, self.inverse, self.expected)
        else:
            at_goal = np.full(len(errors), np.nan)
        found = []
        for i, error in enumerate(errors):
            least = int(np.argmin(values[i].real))
            direction = without_sign(vectors[i, :, least].real)
            found.append(
                Pattern(
                    "(" + ",".join("+" if part >= 0 else "-" for part in error) + ")",
                    error,
                    float(values[i, least].real),
                    float(at_goal[i]),
                    direction * unit / np.linalg.norm(direction),
                    float(rates[i]),
                    moved[i] if ended[i] else None,
                    float(end_rates[i]) if ended[i] else np.nan,
                    float(np.abs(self.rest.desired - seen[i]).max()) if ended[i] else np.nan,
                    float(travel[i]) if ended[i] else np.nan,
                    float(left[i]) if ended[i] else np.nan,
                )
            )
        return tuple(found)

    def ends(self, errors: Array) -> tuple[Poses, Mask]:
        """Search for poses of zero pose error, from the start; return them and which converged."""
        count = len(errors)
        poses = self.rest.start.repeated(count)
        last = np.full(count, np.inf)
        for _ in range(_CREEP_ROUNDS if self.expected.any() else 0):
            features, depth = self.rest.image(poses)
            seen = np.asarray(np.isfinite(features).all(axis=1))
            if not seen.any():
                break
            there = poses[seen]
            at = (there.position, there.quaternion, np.zeros((len(there), 6)))
            error = self.rest.probe.law(features[seen], (1.0 + errors[seen]) * depth[seen], *at).pose_error
            assert error is not None  # a law with a prior regulates one
            slope = self.matrix(there, features[seen], depth[seen], errors[seen])
            step = np.zeros((count, 6))
            step[seen] = np.linalg.solve(slope, error[..., None])[..., 0]
            scaled = np.abs(step / self.rest.unit).max(axis=1)
            last = np.where(seen, scaled, np.inf)
            poses = poses.moved(step * np.minimum(1.0, 0.1 / np.maximum(scaled, 1e-300))[:, None])
        return poses, last < 1e-9

    def rates_at(self, poses: Poses, errors: Array, rows: Mask) -> Array:
        """Return the smallest real part of the drift's rates at poses, (n,) [1/s]; NaN in rows not selected."""
        result = np.full(len(poses), np.nan)
        if rows.any():
            there = poses[rows]
            matrix = self.matrix(there, *self.rest.image(there), errors[rows])
            result[rows] = np.linalg.eigvals(matrix @ self.drive).real.min(axis=1)
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
        """Return the smallest eigenvalue over all patterns for each size, (n,)."""
        errors = (sizes[:, None, None] * _SIGNS).reshape(-1, 4)
        return np.asarray(self.smallest(place, errors, inverse, expected).reshape(len(sizes), -1).min(axis=1))

    def limit(self, place: int, grid: Array, values: Array) -> float | None:
        """Return the size at which the first pattern loses its positive eigenvalue, between two sizes of the grid."""
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
        """Compute all results."""
        own = np.array(self.rest.settings["uncertainty.depth"], dtype=float)
        size = float(np.abs(own).max())
        sizes = sorted({*SIZES, *([size] if size > 0.0 else [])})
        grid = np.linspace(0.0, LARGEST, GRID + 1)[1:]
        curves = {}
        limits: list[float | None] = []
        for place, name in enumerate(("start", "goal")[: len(self.places)]):
            curves[name] = self.over_sizes(place, grid, self.inverse, self.expected)
            curves[f"{name}, no prior"] = self.over_sizes(place, grid, np.zeros(6), np.zeros(6))
            limits.append(self.limit(place, grid, curves[name]))
        return Drift(
            self.traits.name,
            "",
            self.driven_by,
            self.rest.depth,
            self.rest.stroke,
            self.patterns(own[None])[0],
            tuple(self.size(s) for s in sizes),
            limits[0],
            limits[1] if len(limits) > 1 else None,
            self.goal is not None,
            bool(self.expected.any()),
            self.integrates and bool(np.any(self.gains.fuzzy.leakage)),
            grid,
            curves,
            leg_unit=self.rest.units.small,
        )
