"""Slow drift of the laws that regulate a pose error, under unequal depth errors (docs/analysis/drift.md)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.drift_loop import LoopUnderErrors, loop_under_errors
from hexservo.findings.analysis.drift_patterns import Pattern, Size, signs_of
from hexservo.findings.analysis.drift_rates import late_rates, lateness
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses, without_sign
from hexservo.findings.analysis.rest import Rest, not_analysed, springs_of
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.bisection import last_that_holds
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array, Complex, Mask
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import quantity

SIZES = (0.05, 0.3)  # of depth errors, beside the scenario's own
LARGEST = 0.95  # that is searched; at 1 an assumed depth is zero
GRID = 20  # sizes up to it before the bisection, so that a border that is not the only one is found
_ROUNDS = 20  # of bisection
_CREEP_ROUNDS = 30  # of the search for the end of the drift
_FAST = 1e-6  # [s], least time constant of the springs that damping leaves: far below a drift's
_LARGE = 2.0  # |E| beyond which |E - 1| may be above 1, as growth by a late image requires
_POINTS = 4  # whose patterns are analysed
_SIGNS = np.array(list(itertools.product((1.0, -1.0), repeat=_POINTS)))  # (16, 4)

_Seen: TypeAlias = tuple[Array, Array, Array]  # E, J-hat and J of a displacement


@dataclass(frozen=True, eq=False, repr=False)
class Drift(Part):
    """Rates of the drift, with the eigenvalues behind them, or why there are none."""

    law: str
    open_because: str  # empty where the analysis applies
    driven_by: str = ""  # what takes the pose error to a velocity
    depth: float = 0.0  # [m], mean, from home
    stroke: float = 0.0  # [m]
    own: Pattern | None = None  # the scenario's own depth errors
    sizes: tuple[Size, ...] = ()  # by size; the scenario's own among them
    # |delta_Z| up to which the rates of all patterns are positive; None: up to the largest searched
    limit_start: float | None = None
    limit_goal: float | None = None
    has_goal: bool = True
    has_prior: bool = True  # one that is expected, not only in the inverse
    leaks: bool = False  # the weights that integrate
    grid: Array | None = None  # (n,) sizes
    curves: dict[str, Array] | None = None  # (n,) smallest rate over all patterns [1/s], by place and prior
    late: float = 0.0  # [s], over which the law carries the image on (`Lateness`)
    springs: int = 0  # axes without a drive, where nothing drifts: the rates are those of the others
    leg_unit: str = "mm"  # a thousandth of the unit of leg travel
    small_shift: float = 0.0  # [m], of motions shown as examples
    takes_positions: bool = False
    loop: LoopUnderErrors | None = None  # with a late image and legs that take forces, where it applies

    @property
    def finds_oscillations(self) -> bool:
        """Whether oscillations by a late image are found: by the rates, or by the loop of legs that take forces."""
        return self.late > 0.0 and (self.takes_positions or self.loop is not None)


def analyse(scenario: Scenario) -> Drift:
    """Compute the rates of the drift of a law with a pose error (docs/analysis/drift.md).

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    if reason := _open_because(scenario):
        return Drift(scenario.controller.law, reason)
    return _Worker(scenario).drift()


def slowest_rate(scenario: Scenario) -> float:
    """Return the smallest real part at start and goal of the rates with the scenario's own depth errors [1/s].

    Where it is negative a pose error grows there. NaN where the analysis does not apply.
    """
    if _open_because(scenario):
        return np.nan
    worker, own = _Worker(scenario), np.broadcast_to(scenario.uncertainty.depth, (1, _POINTS))
    return np.nan if worker.springs == 6 else worker.patterns(own)[0].slowest


def _open_because(scenario: Scenario) -> str:
    """Return why a scenario is not analysed; empty if it is."""
    law = scenario.controller.law
    if reason := not_analysed(scenario, _not_for(scenario), any_body=True):
        return reason
    if getattr(scenario.controller.gains, "jacobian_at", "current") != "current":
        return f"{law} with a Jacobian of the goal: not analysed, since no depth of an image enters."
    if scenario.controller.jacobian == "printed":
        return "With the printed sign of the Jacobian every feature moves away from its goal: not analysed."
    return ""


def _not_for(scenario: Scenario) -> str:
    """Return why a scenario is not analysed; empty with a pose error by (J-hat^T W J-hat + M)^-1 of four points."""
    law = scenario.controller.traits
    if law.output == "pose":
        return "it sends the legs to a pose that it filters, whatever the depth errors"
    if scenario.target.count != _POINTS:
        return f"its patterns of depth errors are those of four points, and the target has {scenario.target.count}"
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
        self.late = lateness(scenario)
        self.drive, self.driven_by = self._drive()
        if self.late:
            self.driven_by += f", with an image carried on over {quantity(self.late.mean, 's')}, {self.late.of}"
        at_start = self.springs_over_damping(np.eye(6), self.true[0], self.true[0])
        scaled = (self.drive if self.integrates else at_start) * self.rest.unit / self.rest.unit[:, None]
        self.springs = 6 - int(np.linalg.matrix_rank(scaled))  # axes in which no error becomes a velocity
        self.learning = self._learning() if self.integrates else np.zeros(6)

    def _drive(self) -> tuple[Array, str]:
        """Return the matrix (6, 6) from a small pose error to a velocity [1/s], and what it is.

        Of fuzzy systems it is Lambda, which drives them.
        """
        gains = self.gains
        if self.traits.output == "twist":
            return float(gains.gain) * np.eye(6), "its gain times the eigenvalue"
        if self.integrates:
            return np.diag(gains.drive), "Lambda, less what the springs of the law and its damping take"
        spring = "kt" if hasattr(gains, "kt") else "kp"  # K_p of a law with an image spring is that of the image
        friction = ", K_v aside" if self.traits.switching else ""
        pulls, damps = np.diag(getattr(gains, spring)), np.diag(gains.kd)
        ratio = f"K_{spring[1]}/K_d"
        resists = self._virtual_damping
        if resists.any():
            if spring == "kp":  # accelerations
                inertia = self.rest.probe.inertia(self.rest.home.rows.quaternion)[0]
                pulls, damps = inertia @ pulls, inertia @ damps
            damps = damps + np.diag(resists)
            ratio = f"K_{spring[1]}/(K_d + D_v)"
        how = f"{ratio} times the eigenvalue"
        if self.image_spring:
            how = f"its springs K_t E + J^T K_p J over {ratio.removeprefix('K_t/')}"
        return np.linalg.solve(damps, pulls), how + friction

    @property
    def image_spring(self) -> bool:
        """Whether an image error moves the platform beside the pose error: without fuzzy systems, which balance it."""
        return hasattr(self.gains, "kt") and not self.integrates and bool(np.any(self.gains.kp))

    def of_image(self, known: Array, true: Array) -> Array:
        """Return J-hat^T K_p J (..., 6, 6), the stiffness of the image spring of a law that has K_t as well."""
        return np.asarray(np.swapaxes(known, -1, -2) @ (self.gains.kp[:, None] * true))

    def springs_over_damping(self, error: Array, known: Array, true: Array) -> Array:
        """Return the matrix (..., 6, 6) [1/s] of the rates without fuzzy systems, of E (..., 6, 6), J-hat and J."""
        rates = self.drive @ error
        if self.image_spring:
            rates = rates + self.of_image(known, true) / (self.gains.kd + self._virtual_damping)[:, None]
        return np.asarray(rates)

    @property
    def _virtual_damping(self) -> Array:
        """Damping (6,) of the virtual platform that moves where the legs take positions [N s/m; N m s/rad], else 0."""
        scenario = self.rest.scenario
        return np.broadcast_to(scenario.controller.virtual_platform.damping, 6) * scenario.actuators.takes_positions

    @property
    def _gain_keys(self) -> str:
        """Return the keys of what takes an error to a velocity."""
        block = f"controller.{self.traits.name}."
        if self.traits.output == "twist":
            return f"{block}gain"
        if self.integrates:
            return f"{block}drive"
        return f"{block}kt and {block}kp" if hasattr(self.gains, "kt") else f"{block}kp"

    def _learning(self) -> Array:
        """Return kappa = |phi-bar|^2/Psi (6,) [N/m; N m/rad]: output of the fuzzy systems per displacement, at rest."""
        settings = core_parameters(self.rest.scenario)
        settings[f"controller.{settings.law}.fuzzy.error_scale"] = np.zeros(6)  # the input is 0 at any pose
        home = self.rest.home.rows
        features, depth = self.rest.image(home)
        law = _core.Probe(settings).law(features, depth, home.position, home.quaternion, np.zeros((1, 6)))
        assert law.error_memberships is not None
        assert law.rate_memberships is not None
        fire = [np.sum(of[0] ** 2, axis=1) for of in (law.error_memberships, law.rate_memberships)]
        return np.asarray(fire[0] * fire[1] / self.gains.fuzzy.adaptation)

    @property
    def integrates(self) -> bool:
        """Whether fuzzy systems are driven by the pose error."""
        return self.traits.memory and bool(self.gains.fuzzy.enabled)

    def jacobian(self, poses: Poses, features: Array, depth: Array, errors: Array | None = None) -> Array:
        """Return J (..., 2p, 6), or with depth errors J-hat, the law's at (1 + delta) Z, (9)."""
        if errors is None:
            return self.rest.jacobian(features, depth, poses)
        return self.rest.jacobian(features, (1.0 + errors) * depth, poses, assumed=True)

    def known(self, place: int, errors: Array) -> Array:
        """Return J-hat (n, 2p, 6) at a place for depth errors (n, p)."""
        pose, features, depth = self.places[place]
        count = len(errors)
        return self.jacobian(pose.repeated(count), np.tile(features, (count, 1)), depth, errors)

    def matrix(self, known: Array, true: Array, inverse: Array | None = None, expected: Array | None = None) -> Array:
        """Return the loop matrix E (n, 6, 6) of J-hat (n, 2p, 6) and J, with the law's own prior or another."""
        inverse = self.inverse if inverse is None else inverse
        expected = self.expected if expected is None else expected
        return loop_matrix(self.root * known, self.root * true, inverse, expected)

    def slowest(
        self,
        known: Array,
        true: Array,
        inverse: Array | None = None,
        expected: Array | None = None,
        *,
        fresh: bool = False,
    ) -> Complex:
        """Return the drift's rate of the smallest real part [1/s; rad/s], (n,), of J-hat (n, 2p, 6) and J: `matrix`.

        With `fresh` as if the image were not late.
        """
        late = None if fresh else self.late
        now = (self.matrix(known, true, inverse, expected), known, true)
        # Per displacement since the image, which the law sees with J-hat in place of J: 1 - E where M_e is M.
        since = (self.matrix(known, known - true, inverse, np.zeros(6)), known, known - true) if late else None
        moved, held = self._learning_motion(now, since) if self.integrates else self._motion(now, since)
        values = np.linalg.eigvals(moved) if late is None else late_rates(moved, held, late)
        order = np.argsort(np.abs(values), axis=-1)[..., self.springs :]
        kept = np.take_along_axis(values, order, axis=-1)  # without those of axes that have no drive
        return np.asarray(np.take_along_axis(kept, kept.real.argmin(axis=-1)[..., None], axis=-1)[..., 0])

    def _motion(self, now: _Seen, since: _Seen | None) -> tuple[Array, Array]:
        """Return the matrices F and H of chi' = -(F chi + H u) without fuzzy systems, (n, 6, 6) each [1/s].

        u is chi where the law has the image from; of the displacement since, chi - u, `since` is what to give to
        `springs_over_damping` (None: u is chi, and H zero), and `now` what of chi.
        """
        pull = self.springs_over_damping(*now)
        late = np.zeros_like(pull) if since is None else self.springs_over_damping(*since)
        return pull + late, -late

    def _learning_motion(self, now: _Seen, since: _Seen | None) -> tuple[Array, Array]:
        """Return the matrices as `_motion` does for fuzzy systems, with their output in the state, (n, 12, 12 or 6)."""
        gains, learning = self.gains, np.diag(self.learning)
        damping = gains.kd + self._virtual_damping
        # An axis without damping has some: what is that fast does not count, but for its sign.
        damping = np.maximum(damping, _FAST * (self.learning + gains.kt))[:, None]

        def springs(error: Array, known: Array, true: Array) -> tuple[Array, Array]:
            stiffness = gains.kt[:, None] * error + self.of_image(known, true)
            return learning @ self.drive @ error / damping, stiffness / damping

        # K_d chi' = -(K_t E + J-hat^T K_p J) chi - tau_f and tau_f' = kappa (chi' + Lambda E chi); tau_f/K_d is state.
        pull, stiff = springs(*now)
        one, learns = np.broadcast_to(np.eye(6), pull.shape), np.broadcast_to(learning / damping, pull.shape)
        late, stiff_late = (np.zeros_like(pull), np.zeros_like(pull)) if since is None else springs(*since)
        every = stiff + stiff_late
        moved = np.block([[every, one], [learns @ every - pull - late, learns]])
        return moved, np.concatenate([-stiff_late, late - learns @ stiff_late], axis=-2)

    def slowest_at(self, place: int, errors: Array, *prior: Array) -> Complex:
        """Return `slowest` at a place for depth errors (n, p)."""
        return self.slowest(self.known(place, errors), self.true[place], *prior)

    def by_late_image_alone(self, errors: Array, rates: list[Complex]) -> Mask:
        """Return for which depth errors (n, p) e grows by a late image alone: E is large, a fresh image stops it.

        `rates` are those of `slowest_at`, (n,) for each place.
        """
        found = np.zeros(len(errors), dtype=bool)
        if self.late is None:
            return found
        for place, true in enumerate(self.true):
            known = self.known(place, errors)
            large = np.abs(np.linalg.eigvals(self.matrix(known, true))).max(axis=1) > _LARGE
            found |= large & (rates[place].real <= 0.0) & (self.slowest(known, true, fresh=True).real > 0.0)
        return found

    def patterns(self, errors: Array) -> tuple[Pattern, ...]:
        """Describe depth errors (n, p)."""
        unit = self.rest.unit
        values, vectors = np.linalg.eig(self.matrix(self.known(0, errors), self.true[0]) * unit / unit[:, None])
        rates = self.slowest_at(0, errors)
        ends, ended = self.ends(errors)
        end_rates = self.rates_at(ends, errors, ended)
        ended &= end_rates > 0.0  # an end that does not attract is none
        seen = self.rest.image(ends)[0]
        travel = np.abs(self.rest.leg_travel(ends)).max(axis=1)
        left = self.rest.limits_left(ends)
        moved = ends.displacement_from(self.rest.home)
        at_goal, goal_rates = np.full(len(errors), np.nan), np.full(len(errors), np.nan + 0j)
        if len(self.places) > 1:
            at_goal = np.linalg.eigvals(self.matrix(self.known(1, errors), self.true[1])).real.min(axis=1)
            goal_rates = self.slowest_at(1, errors)
        late_alone = self.by_late_image_alone(errors, [rates, goal_rates])
        found = []
        for i, error in enumerate(errors):
            least = int(np.argmin(values[i].real))
            direction = without_sign(vectors[i, :, least].real)
            grow = [rate for rate in (rates[i], goal_rates[i]) if rate.real <= 0.0]
            growing = min(grow, key=lambda rate: float(rate.real), default=0j)
            found.append(
                Pattern(
                    signs_of(error),
                    error,
                    float(values[i, least].real),
                    float(at_goal[i]),
                    direction * unit / np.linalg.norm(direction),
                    float(rates[i].real),
                    float(goal_rates[i].real),
                    abs(float(growing.imag)) / (2.0 * np.pi),
                    bool(late_alone[i]),
                    moved[i] if ended[i] else None,
                    float(end_rates[i]) if ended[i] else np.nan,
                    float(np.abs(self.rest.desired - seen[i]).max()) if ended[i] else np.nan,
                    float(travel[i]) if ended[i] else np.nan,
                    float(left[i]) if ended[i] else np.nan,
                )
            )
        return tuple(found)

    def ends(self, errors: Array) -> tuple[Poses, Mask]:
        """Search for the poses where a drift ends, from the start; return them and which converged.

        There the pose error is zero, or with an image spring the sum of the springs. None is searched without an
        expected prior, which bounds no drift, nor where an axis without a drive stays where it is.
        """
        count = len(errors)
        poses = self.rest.start.repeated(count)
        last = np.full(count, np.inf)
        for _ in range(_CREEP_ROUNDS if self.expected.any() and not self.springs else 0):
            features, depth = self.rest.image(poses)
            seen = np.asarray(np.isfinite(features).all(axis=1))
            if not seen.any():
                break
            there = poses[seen]
            at = (there.position, there.quaternion, np.zeros((len(there), 6)))
            law = self.rest.probe.law(features[seen], (1.0 + errors[seen]) * depth[seen], *at)
            image = (there, features[seen], depth[seen])
            known, true = self.jacobian(*image, errors[seen]), self.jacobian(*image)
            error, slope = law.pose_error, self.matrix(known, true)
            assert error is not None  # a law with a prior regulates one
            if self.image_spring:
                error, slope = springs_of(law), self.gains.kt[:, None] * slope + self.of_image(known, true)
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
            image = (there, *self.rest.image(there))
            result[rows] = self.slowest(self.jacobian(*image, errors[rows]), self.jacobian(*image)).real
        return result

    def size(self, size: float) -> Size:
        """Describe all patterns of a size, and count those with a negative rate."""
        errors = size * _SIGNS
        unequal = errors[1:-1]
        none = np.zeros(6)

        def negative(inverse: Array, expected: Array) -> tuple[int, int]:
            start, *goal = (
                int((self.slowest_at(k, unequal, inverse, expected).real < 0.0).sum()) for k in range(len(self.places))
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
        """Return the smallest rate over all patterns for each size, (n,) [1/s]."""
        errors = (sizes[:, None, None] * _SIGNS).reshape(-1, 4)
        return np.asarray(self.slowest_at(place, errors, inverse, expected).real.reshape(len(sizes), -1).min(axis=1))

    def limit(self, place: int, grid: Array, values: Array) -> float | None:
        """Return the size at which the first pattern loses its positive rate, between two sizes of the grid."""
        lost = np.flatnonzero(values <= 0.0)
        if not len(lost):
            return None
        high = float(grid[lost[0]])
        low = float(grid[lost[0] - 1]) if lost[0] else 0.0

        def positive(size: float) -> bool:
            return bool(self.over_sizes(place, np.array([size]), self.inverse, self.expected)[0] > 0.0)

        return last_that_holds(positive, low, high, _ROUNDS)

    def loop(self, own: Array, largest: float) -> LoopUnderErrors | None:
        """Return the linear loop with the scenario's own errors (p,), and up to a size of all patterns."""
        if self.late is None or self.rest.scenario.actuators.takes_positions:
            return None
        return loop_under_errors(self.rest.scenario, own, _SIGNS, largest)

    def drift(self) -> Drift:
        """Compute all results; open where no axis has a drive."""
        if self.springs == 6:
            return Drift(
                self.traits.name,
                f"{self._gain_keys}: expected a gain above 0 in some axis, got 0 in all: no error moves the platform, "
                "so that nothing drifts.",
            )
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
            late=0.0 if self.late is None else self.late.mean,
            springs=self.springs,
            leg_unit=self.rest.units.small,
            small_shift=self.rest.small_shift,
            takes_positions=self.rest.scenario.actuators.takes_positions,
            loop=self.loop(own, min((limit for limit in limits if limit is not None), default=LARGEST)),
        )
