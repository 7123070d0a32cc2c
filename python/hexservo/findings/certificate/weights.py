"""Best weights of a fuzzy system: the solution of smallest norm of a linear program.

docs/certificate/weights.md. The system's output is ``basis @ weights``, one row of the basis per sample. The best
weights come as close to a target as one set of weights can over all samples, in the maximum norm.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.scenario.arrays import Array, Mask

LIMIT = 1e3
"""Largest weight that is tried, in units of the largest target."""
TIE = 1e-6
"""Weights count as tied whose error is larger than the smallest one by no more than this part of it."""

_FLOOR = 1e-9  # errors below this part of the largest target count as zero
_AGREE, _NOTHING = 1e-5, 1e-7  # parts of the error, and of the largest target, within which error and bound agree
# How the linear programs are solved: presolve, method, feasibility. The first is the fastest; where columns of the
# basis are nearly dependent it may fail. `_Problem.bound_of` bounds the error of any solution.
_ATTEMPTS = (
    (False, "highs-ds", 1e-10),
    (True, "highs-ds", 1e-10),
    (False, "highs-ds", 1e-8),
    (True, "highs-ds", 1e-7),
    (True, "highs-ipm", 1e-8),
)
_FIRST = 120  # samples that the first program sees
_MORE = 40  # at most that many join before the next one
_APART = 1e-20  # squared sine of the angle from which a constraint counts as independent of others
_FEW = 10  # rounds of the linear program; a handful is usual. From then on twice as many join each time: all at last
_STEPS = 2000  # of the second program; one or two hundred are usual


@dataclass(frozen=True, eq=False)
class BestWeights:
    """Weights of smallest norm that minimise the largest error, with a lower bound of the smallest error."""

    weights: Array  # (p,), in units of the target
    error: float  # largest |target - basis @ weights| over all samples
    lower_bound: float  # no weights within the limit do better: from the dual of the linear program
    limit: float  # that the weights had to keep
    limited: bool  # the limit keeps the error from being smaller
    solved: bool  # error and lower bound agree; otherwise the solver gave up, and the smallest error is between them


def best_weights(basis: Array, target: Array, limit: float | None = None, *, smallest: bool = True) -> BestWeights:
    """Minimise ``max |target - basis @ weights|``, and among ties the Euclidean norm of the weights.

    Both programs begin with a subset of the samples and take in those that their solution violates most, until there
    are none: what is returned is a solution for all samples.

    Parameters
    ----------
    basis
        (n, p), one row per sample [1].
    target
        (n,).
    limit
        Largest absolute weight, in units of the target; None, or a larger number: `LIMIT` times the largest absolute
        target. Without one the program has no solution in floating-point numbers where columns of the basis are nearly
        dependent.
    smallest
        False leaves out the second program: any weights of smallest error will do.

    Raises
    ------
    ValueError
        For arrays of other shapes, numbers that are not finite, and a limit that is not positive.
    """
    if basis.ndim != 2 or target.shape != basis.shape[:1] or len(target) == 0:
        raise ValueError(f"basis: expected (n, p) with a target of (n,), n > 0, got {basis.shape} and {target.shape}")
    if not (np.isfinite(basis).all() and np.isfinite(target).all()):
        raise ValueError("basis: expected finite numbers, and so of the target, got others")
    scale = float(np.abs(target).max())
    if limit is not None and not limit > 0:
        raise ValueError(f"limit: expected a number > 0, got {limit!r}")
    relative = LIMIT if limit is None or limit > LIMIT * scale else float(limit) / scale if scale > 0.0 else 0.0
    largest = relative * scale
    if scale == 0.0:  # nothing to approximate
        return BestWeights(np.zeros(basis.shape[1]), 0.0, 0.0, largest, limited=False, solved=True)
    problem = _Problem(np.ascontiguousarray(basis), target / scale, relative)
    weights, dual = problem.closest()
    if smallest:
        weights = problem.smallest(weights)
    lower_bound, price = problem.bound_of(dual)
    lower_bound = max(0.0, lower_bound)
    error = float(np.abs(problem.target - problem.basis @ weights).max())
    return BestWeights(
        weights=weights * scale,
        error=error * scale,
        lower_bound=lower_bound * scale,
        limit=largest,
        limited=price > 1e-5 * max(lower_bound, _FLOOR),
        solved=error - lower_bound <= _AGREE * error + _NOTHING,
    )


def _joining() -> Iterator[int]:
    """Return how many samples join after each round of the linear program."""
    yield from itertools.repeat(_MORE, _FEW)
    yield from (_MORE << doubled for doubled in itertools.count(1))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The linear program, in units in which the largest target is 1."""

    basis: Array  # (n, p)
    target: Array  # (n,)
    limit: float

    def closest(self) -> tuple[Array, Array]:
        """Solve the linear program; give weights, and (n,) multipliers: positive where the target is above.

        Where the solver gives up: the weights of smallest error over all samples, and the multipliers of largest lower
        bound, of those that it found before. They enclose the smallest error.
        """
        chosen = np.zeros(len(self.target), dtype=bool)
        chosen[self._spread(_FIRST)] = True
        best, smallest = np.zeros(self.basis.shape[1]), 1.0
        dual, bound = np.zeros(len(self.target)), 0.0
        for more in _joining():
            try:
                weights, multipliers, error = self._program(self.basis[chosen], self.target[chosen])
            except ArithmeticError:
                break
            beyond = np.abs(self.target - self.basis @ weights)
            latest = np.zeros(len(self.target))
            latest[chosen] = multipliers
            if beyond.max() < smallest and np.abs(weights).max() <= self.limit * (1 + _FLOOR):
                best, smallest = weights, float(beyond.max())
            if (value := self.bound_of(latest)[0]) >= bound:
                dual, bound = latest, value
            new = self._joining_next(beyond, error * (1 + TIE / 10) + _FLOOR / 10, chosen, more)
            if len(new) == 0:
                return weights, dual
            chosen[new] = True
        return best, dual

    def _program(self, basis: Array, target: Array) -> tuple[Array, Array, float]:
        """Solve the program of some samples through its dual, which has a row per weight and not per sample.

        With u, v >= 0 for the samples' two sides and a, b >= 0 for those of the limit L:
        maximise target.(u - v) - L sum(a + b) subject to basis^T (u - v) + a - b = 0, sum(u + v) = 1.
        """
        from scipy.optimize import linprog  # takes a quarter of a second, where it is needed alone

        samples, count = basis.shape
        unit = np.eye(count)
        rows = np.empty((count + 1, 2 * (samples + count)))
        rows[:count] = np.hstack([basis.T, -basis.T, unit, -unit])
        rows[count] = np.r_[np.ones(2 * samples), np.zeros(2 * count)]
        cost = np.r_[-target, target, np.full(2 * count, self.limit)]
        right = np.r_[np.zeros(count), 1.0]
        for presolve, method, accuracy in _ATTEMPTS:
            options = {
                "presolve": presolve,
                "primal_feasibility_tolerance": accuracy,
                "dual_feasibility_tolerance": accuracy,
            }
            solution: Any = linprog(cost, A_eq=rows, b_eq=right, bounds=(0, None), method=method, options=options)
            if solution.status == 0:
                both = solution.x
                return -solution.eqlin.marginals[:count], both[:samples] - both[samples : 2 * samples], -solution.fun
        raise ArithmeticError(f"the linear program for the best weights has no solution: {solution.message}")

    def bound_of(self, dual: Array) -> tuple[float, float]:
        """Return a lower bound of the error, and the part of it that is due to the limit.

        For every d with sum |d| = 1 and weights within the limit L:
        max |target - basis w| >= d.(target - basis w) >= d.target - L |basis^T d|_1.
        """
        length = float(np.abs(dual).sum())
        if length < _FLOOR:  # both sides of the same samples hold: no error is left
            return 0.0, 0.0
        direction = dual / length
        price = self.limit * float(np.abs(self.basis.T @ direction).sum())
        return float(direction @ self.target) - price, price

    def smallest(self, start: Array) -> Array:
        """Return the weights of smallest norm among those with the error of `start`.

        min |w|^2 subject to |target - basis w| <= e and |w| <= L, by the dual method of D. Goldfarb and A. Idnani ("A
        numerically stable dual method for solving strictly convex quadratic programs", Mathematical Programming 27,
        1983): from w = 0 it takes in the constraint that is violated most, and drops those that no longer hold w back.
        """
        error = float(np.abs(self.target - self.basis @ start).max()) * (1 + TIE) + _FLOOR
        size = np.r_[np.linalg.norm(self.basis, axis=1), np.ones(len(start))]
        size[size == 0.0] = np.inf  # a row that no weights can help
        allowed = np.r_[np.full(len(self.target), error), np.full(len(start), self.limit)]
        weights = np.zeros_like(start)
        normals = np.empty((len(start), 0))  # of the constraints that hold w, one per column
        forces = np.empty(0)  # their multipliers, >= 0
        for _ in range(_STEPS):
            rest = np.concatenate([self.target - self.basis @ weights, -weights])
            excess = (np.abs(rest) - allowed) / size
            worst = int(np.argmax(excess))
            if excess[worst] <= _FLOOR * error + 1e-13:
                return weights
            row = self.basis[worst] if worst < len(self.target) else np.eye(len(start))[worst - len(self.target)]
            normal = row * (np.sign(rest[worst]) / size[worst])
            lacking, force = float(excess[worst]), 0.0
            while True:  # until the constraint holds
                share = np.empty(0)
                free = normal
                if len(forces):
                    base, triangle = np.linalg.qr(normals)
                    along = base.T @ normal
                    free = normal - base @ along
                    free -= base @ (base.T @ free)  # repeated: the remainder may be small
                    share = np.linalg.solve(triangle, along)
                reach = float(free @ normal)
                full = lacking / reach if reach > _APART else np.inf
                pushed = share > 0.0
                partial = float((forces[pushed] / share[pushed]).min(initial=np.inf))
                length = min(full, partial)
                if not np.isfinite(length):
                    return start  # rounding has closed the set of solutions: as good, if larger
                forces = forces - length * share
                force += length
                if np.isfinite(full):
                    weights = weights + length * free
                    lacking -= length * reach
                if length == full:
                    normals, forces = np.column_stack([normals, normal]), np.r_[forces, force]
                    break
                dropped = np.flatnonzero(pushed)[np.argmin(forces[pushed])]
                normals, forces = np.delete(normals, dropped, axis=1), np.delete(forces, dropped)
        return start

    def _joining_next(self, beyond: Array, error: float, chosen: Mask, most: int) -> NDArray[np.intp]:
        """Return the samples that join: none where no error is beyond a value, else those of the largest errors.

        First the largest of each group of neighbours, then the others, whose constraints are nearly those of the first.
        """
        wrong = (beyond > error * (1 + _FLOOR) + 1e-13) & ~chosen
        if not wrong.any():
            return np.empty(0, dtype=np.intp)
        padded = np.r_[-np.inf, beyond, -np.inf]
        peak = wrong & (beyond >= padded[:-2]) & (beyond >= padded[2:])
        new = np.flatnonzero(~chosen)
        return np.asarray(new[np.lexsort((-beyond[new], ~peak[new]))][:most])

    def _spread(self, count: int) -> NDArray[np.intp]:
        """Select samples evenly along the path of basis and target, most of which a run covers in a short time."""
        steps = np.abs(np.diff(self.basis, axis=0)).sum(axis=1) + np.abs(np.diff(self.target))
        way = np.r_[0.0, np.cumsum(steps)]
        return np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], count)).clip(0, len(way) - 1))
