"""Candidates of a search for gains: their gains, and their worst runs over the variations of the search."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.judging import Judge
from hexservo.campaigns.loop_numbers import LOOP_NUMBERS
from hexservo.campaigns.plan import CampaignPlan
from hexservo.campaigns.refused import REMEDY
from hexservo.campaigns.requirements import COMPLETED, margin_of, run_distances
from hexservo.campaigns.search_steps import SearchSteps
from hexservo.campaigns.tune_keys import TunePlan, Variable
from hexservo.campaigns.tune_result import LARGER
from hexservo.campaigns.worst_case import REFUSED, smallest_in_box
from hexservo.run.batch import BatchResult
from hexservo.run.variations import changes_of_run
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import value_at
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.yaml import ScenarioError

_WORST_RUNS = 400  # of a search for the worst case of a candidate
_WORSE = 1e-3  # a case joins if it is the first to fail, or its margin is smaller by more than this, or a metric LARGER
_ROUNDING = 1e-12  # relative one of gains, and of a range's ends
_NONE = 1e9  # stands for a metric without a value, in the search for its largest one


class Judged:
    """The worst of every candidate over the variations: margins (n, r), minimised metrics (n, m).

    `distances` (n, r) are those from the bounds, NaN where one of the runs has none; `violations` (n, r) the means of
    `violation_of` over the variations, and `early` (n,) counts the runs that ended early.
    """

    def __init__(
        self,
        margins: Array,
        values: Array,
        distances: Array,
        violations: Array,
        early: NDArray[np.int64] | None = None,
    ) -> None:
        self.margins = margins
        self.values = values
        self.distances = distances
        self.violations = violations
        self.early = np.zeros(len(margins), dtype=np.int64) if early is None else early
        self.smallest: Array = margins.min(axis=1)

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Which candidates keep all requirements in all variations, and have a value of each metric, (n,)."""
        return np.asarray((self.smallest >= 0) & np.isfinite(self.values).all(axis=1))

    def order(self, metric: int = 0) -> NDArray[np.intp]:
        """Return the candidates, the best first, by one of the minimised metrics; without any by their margins."""
        none = self.values.shape[1] == 0
        return ranking(self.violations, -self.smallest if none else self.values[:, metric])

    def beats(self, other: Judged) -> bool:
        """Return whether the one candidate here comes before the one of `other`, by each of the minimised metrics."""
        pairs = [
            (getattr(other, name), getattr(self, name)) for name in ("margins", "values", "distances", "violations")
        ]
        both = Judged(*map(np.concatenate, pairs))
        return all(both.order(metric)[0] == 1 for metric in range(max(self.values.shape[1], 1)))


def violation_of(margins: Array) -> Array:
    """Return how far margins are below zero, at most 2; 0 where a requirement holds.

    As a margin is bounded, a run that diverges does not hide what happens in the others.
    """
    return np.maximum(-margins, 0.0)


def ranking(violations: Array, values: Array) -> NDArray[np.intp]:
    """Return candidates, the best first: feasible ones by their values, then the others by their violations.

    Parameters
    ----------
    violations, values
        (n, r), which are summed, and (n,); a value of NaN comes after all others.
    """
    violation = violations.sum(axis=1)
    violated = violation != 0.0
    return np.lexsort((np.where(violated, violation, np.nan_to_num(values, nan=np.inf)), violated))


def largest_of(values: Array) -> Array:
    """Return the largest value of each metric, (m,) of runs (n, m); NaN where a run has none, or without runs."""
    return np.asarray(values.max(axis=0) if len(values) else np.full(values.shape[1], math.nan))


class Candidates:
    """Judges candidates, which are places in the unit box of the variables, over variations, which are rows of numbers.

    Everything it simulates is a step of the search, and kept.
    """

    def __init__(self, plan: CampaignPlan, asked: TunePlan, steps: SearchSteps, seed: int, threads: int | None) -> None:
        self.plan, self.asked, self.steps, self.seed = plan, asked, steps, seed
        self.judge = Judge(plan, threads, self.asked.minimise)
        self.drawing = self.judge.drawing
        self.random = np.random.default_rng(seed)
        self.runs = 0  # of all steps, those that were kept included
        self.refused = 0  # points of the box that are no valid scenario, and were left out
        self.numbers = self._variations()
        self.joined = 0  # worst cases among the variations
        self.required = (*plan.require, *asked.subject_to)
        # largest margin of a requirement, as a distance from its bound, where all others hold; for these variations
        self.nearest = np.full(len(self.required), -math.inf)
        self.nearest_places = np.zeros((len(self.required), self.dimension))  # of the candidates that have it
        self.renew()

    def _variations(self) -> dict[str, NDArray[Any]]:
        parts = []
        if self.asked.corners:
            parts.append(self._corners())
        if self.asked.over:
            parts.append(self.drawing.numbers(0, self.asked.over))
        return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}

    def _corners(self) -> dict[str, NDArray[Any]]:
        """Return the corners of what varies that are valid scenarios, as `numbers` of the drawing.

        Raises
        ------
        ScenarioError
            If none of them is valid.
        """
        ends = np.array(list(itertools.product((0.0, 1.0), repeat=self.drawing.dimension)))
        numbers = self.drawing.numbers_at(ends, 0)
        varied, law = self.drawing.variations(numbers), self.plan.scenario.controller.law
        kept = []
        for row in range(len(ends)):
            with contextlib.suppress(ValueError):
                self.judge.base.updated(changes_of_run(varied, law, row))
                kept.append(row)
        self.refused += len(ends) - len(kept)
        if not kept:
            raise ScenarioError(f"tune.over: corners: none of the {len(ends)} corners is a valid scenario; {REMEDY}")
        return {key: values[kept] for key, values in numbers.items()}

    @property
    def count(self) -> int:
        """Number of variations."""
        return len(next(iter(self.numbers.values())))

    @property
    def dimension(self) -> int:
        """Number of numbers that a candidate has."""
        return sum(len(variable.groups) for variable in self.asked.variables.values())

    def renew(self) -> None:
        """Draw other noise, the same for all candidates."""
        if "seed" in self.numbers:
            self.numbers["seed"] = self.random.integers(0, 2**64, self.count, dtype=np.uint64)

    def join(self, numbers: Mapping[str, NDArray[Any]]) -> None:
        """Add a variation to those of the search."""
        self.numbers = {key: np.concatenate([values, numbers[key]]) for key, values in self.numbers.items()}
        self.joined += 1
        self.nearest[:] = -math.inf

    # ---- Gains ------------------------------------------------------------------------------------------------------

    def gains_of(self, places: Array) -> dict[str, Array]:
        """Return the gains of candidates, (n, ...) by key."""
        found = {}
        for key, variable, shares in self.split(places):
            parts = variable.variation.in_box(shares)
            found[key] = parts[:, 0] if variable.groups == (0,) else np.repeat(parts, variable.groups, axis=1)
        return found

    def split(self, places: Array) -> Iterator[tuple[str, Variable, Array]]:
        """Yield each variable with its key and its part of places, (..., dimension)."""
        start = 0
        for key, variable in self.asked.variables.items():
            yield key, variable, places[..., start : start + len(variable.groups)]
            start += len(variable.groups)

    def gains(self, place: Array) -> dict[str, Any]:
        """Return the gains of one candidate, for `Scenario.updated`: the scenario's where they agree to rounding."""
        scenario, differing = self.plan.scenario, self.differing(place)
        found = self.gains_of(place[None])
        for key in found.keys() - differing:
            found[key] = np.broadcast_to(np.asarray(value_at(scenario, key), dtype=float), found[key].shape)
        return changes_of_run(found, scenario.controller.law)

    def place_of(self, scenario: Scenario) -> Array:
        """Return the place of a scenario's gains, moved into the ranges; of a group the mean."""
        parts = []
        for key, variable in self.asked.variables.items():
            values = np.asarray(value_at(scenario, key), dtype=float)
            split = [values]
            if variable.groups != (0,):
                split = np.split(np.broadcast_to(values, sum(variable.groups)), np.cumsum(variable.groups)[:-1])
            means = [float(part.mean()) for part in split]
            parts.append(variable.variation.share_of(np.array(means)))
        return np.concatenate(parts)

    def differing(self, place: Array) -> tuple[str, ...]:
        """Return the keys whose gains of a candidate differ from those of the scenario by more than rounding.

        A range's scale rounds: the end of `log` is met to some digits only.
        """
        gains = self.gains_of(place[None])
        found = []
        for key, variable in self.asked.variables.items():
            own = np.asarray(value_at(self.plan.scenario, key), dtype=float)
            absolute = _ROUNDING * max(map(abs, variable.variation.box))
            if not np.allclose(gains[key][0], own, rtol=_ROUNDING, atol=absolute):
                found.append(key)
        return tuple(found)

    def excluded(self) -> tuple[str, ...]:
        """Return the keys whose gains in the scenario no candidate has: beyond their range, or unequal in a group."""
        return self.differing(self.place_of(self.plan.scenario))

    # ---- Runs -------------------------------------------------------------------------------------------------------

    def judged(self, places: Array) -> Judged:
        """Return the worst of candidates, (n, dimension), over the variations."""
        found = self._worst_of(self.gains_of(places), len(places))
        for column in range(found.margins.shape[1]):
            others = np.delete(found.margins, column, axis=1)
            kept = (others >= 0).all(axis=1) & np.isfinite(found.distances[:, column])
            distances = np.where(kept, found.distances[:, column], -math.inf)
            first = int(np.argmax(distances))
            if distances[first] > self.nearest[column]:
                self.nearest[column], self.nearest_places[column] = distances[first], places[first]
        return found

    def original(self) -> Judged:
        """Return the worst of the scenario's own gains over the variations, as one candidate.

        They need not be a place in the ranges: `excluded`.
        """
        return self._worst_of({}, 1)

    def loop_numbers(self, scenario: Scenario) -> list[float]:
        """Return the numbers of a scenario's loop that are required."""
        return [LOOP_NUMBERS[one.name][1](scenario) for one in self.asked.subject_to]

    def _worst_of(self, gains: dict[str, Array], count: int) -> Judged:
        """Return the worst of candidates with gains, (count, ...) by key; those of no key are the scenario's own."""
        return (self._with_loop if self.asked.subject_to else self._simulated)(gains, count)

    def _with_loop(self, gains: dict[str, Array], count: int) -> Judged:
        """Run candidates, and compute the numbers of their loops while the batch leaves the interpreter to that."""
        with ThreadPoolExecutor(1, "loop") as beside:
            begun: list[Future[Array]] = []
            found = self._simulated(gains, count, lambda: begun.append(beside.submit(self._loop_values, gains, count)))
            distances = self._loop_distances(gains, count, begun)
        margins = margin_of(distances)
        return Judged(
            np.concatenate([found.margins, margins], axis=1),
            found.values,
            np.concatenate([found.distances, distances], axis=1),
            np.concatenate([found.violations, violation_of(margins)], axis=1),
            found.early,
        )

    def _loop_values(self, gains: dict[str, Array], count: int) -> Array:
        law = self.plan.scenario.controller.law
        rows = [changes_of_run(gains, law, row) for row in range(count)]
        return np.array([self.loop_numbers(self.plan.scenario.updated(row)) for row in rows])

    def _loop_distances(self, gains: dict[str, Array], count: int, begun: Sequence[Future[Array]]) -> Array:
        """Return the distances from what is required of the loop, (n, s); NaN for a number that has no value."""

        def compute() -> dict[str, Array]:
            return {"values": begun[0].result() if begun else self._loop_values(gains, count)}

        values = self.steps.take(gains, compute)["values"]
        found = [one.distance(column) for one, column in zip(self.asked.subject_to, values.T, strict=True)]
        return np.stack(found, axis=1)

    def _simulated(
        self, gains: dict[str, Array], count: int, simulating: Callable[[], object] = lambda: None
    ) -> Judged:
        """Run every candidate on every variation, in one batch."""
        numbers = self.numbers
        size = len(next(iter(numbers.values())))
        drawn = {key: np.tile(values, (count, *[1] * (values.ndim - 1))) for key, values in numbers.items()}
        repeated = {key: np.repeat(values, size, axis=0) for key, values in gains.items()}
        return self._step(drawn, repeated, (count, size), simulating)

    def _step(
        self,
        numbers: Mapping[str, NDArray[Any]],
        gains: Mapping[str, Array],
        shape: tuple[int, int],
        simulating: Callable[[], object] = lambda: None,
    ) -> Judged:
        """Run a batch of (candidates, variations), or take it from what is kept.

        `simulating` is called before it runs, and not where it is kept.
        """

        def compute() -> dict[str, NDArray[Any]]:
            simulating()
            return self._worst_by_candidate(*self.judge.judged(numbers, gains), shape)

        found = self.steps.take({**numbers, **gains, "shape": np.array(shape)}, compute)
        self.runs += shape[0] * shape[1]
        return Judged(**found)

    def _case_step(self, numbers: Mapping[str, NDArray[Any]], gains: Mapping[str, Array], count: int) -> Judged:
        """Run cases of one candidate, each as if it were a candidate, as a step; those of no valid scenario are best.

        Their margin is REFUSED, and so below zero their metrics.
        """

        def compute() -> dict[str, NDArray[Any]]:
            kept, margins, batch = self.judge.judged_where_valid(numbers, gains)
            sizes = {"margins": len(self.plan.require), "distances": len(self.plan.require)}
            sizes |= {"values": len(self.asked.minimise), "violations": len(self.plan.require)}
            fill = {"margins": REFUSED, "distances": REFUSED, "values": -REFUSED, "violations": 0.0}
            found: dict[str, NDArray[Any]] = {name: np.full((count, size), fill[name]) for name, size in sizes.items()}
            found["early"] = np.zeros(count, dtype=np.int64)
            if batch is not None:
                for name, values in self._worst_by_candidate(margins, batch, (len(kept), 1)).items():
                    found[name][kept] = values
            return found

        found = self.steps.take({**numbers, **gains, "shape": np.array((count, 1))}, compute)
        refused = int((found["margins"] == REFUSED).all(axis=1).sum())
        self.refused += refused
        self.runs += count - refused
        return Judged(**found)

    def _worst_by_candidate(
        self, margins: Array, batch: BatchResult, shape: tuple[int, int]
    ) -> dict[str, NDArray[Any]]:
        """Return the worst of the runs of each candidate by the names of `Judged`, for a batch of that shape."""
        metrics = [batch.metrics[name].reshape(shape).max(axis=1) for name in self.asked.minimise]  # NaN stays NaN
        values = np.stack(metrics, axis=1) if metrics else np.empty((shape[0], 0))
        distances = run_distances(self.plan.require, batch.outcome, batch.metrics)
        worst = {"margins": margins, "distances": distances}
        found = {name: each.reshape(*shape, -1).min(axis=1) for name, each in worst.items()}
        violations = violation_of(margins).reshape(*shape, -1).mean(axis=1)
        early = (batch.outcome != COMPLETED).reshape(shape).sum(axis=1)
        return found | {"values": values, "violations": violations, "early": early}

    def worse_cases(self, place: Array) -> tuple[list[dict[str, NDArray[Any]]], float]:
        """Return variations that are worse for a candidate than those of the search, and the smallest margin found.

        Points of the box that are no valid scenario are left out, and counted in `refused`.

        The smallest margin in the box is searched, and, where it is not negative, the largest value of each metric.
        """
        before = self.judged(place[None])
        kept = float(before.margins[0, : len(self.plan.require)].min())  # what variations change
        if not self.drawing.dimension:
            return [], kept
        gains = self.gains_of(place[None])
        seeds = np.array([self.random.integers(0, 2**64, dtype=np.uint64)])

        def runs(shares: Array) -> Judged:
            repeated = {key: np.repeat(values, len(shares), axis=0) for key, values in gains.items()}
            return self._case_step(self._at(shares, seeds), repeated, len(shares))

        start = np.full(self.drawing.dimension, 0.5)
        found, margin = smallest_in_box(lambda shares: runs(shares).smallest, start, _WORST_RUNS, self.seed + 1)
        if margin == REFUSED:  # no point that was tried is a valid scenario
            return [], kept
        fails_first = margin < 0 <= kept  # by however little: the requirements do not hold in the box
        worse = fails_first or (margin < kept - _WORSE and (margin < 0 or not self.asked.minimise))
        if worse or margin < 0:
            return ([self._at(found[None], seeds)] if worse else []), margin
        joining = []
        for metric in range(len(self.asked.minimise)):
            place_of_largest, smallest = smallest_in_box(
                lambda shares, metric=metric: -np.nan_to_num(runs(shares).values[:, metric], nan=_NONE),  # type: ignore[misc]
                start,
                _WORST_RUNS,
                self.seed + 2 + metric,
            )
            if -smallest > LARGER * before.values[0, metric]:
                joining.append(self._at(place_of_largest[None], seeds))
        return joining, margin

    def _at(self, shares: Array, seeds: NDArray[np.uint64]) -> dict[str, NDArray[Any]]:
        numbers = self.drawing.numbers_at(shares, 0)
        return numbers | ({"seed": np.repeat(seeds, len(shares))} if "seed" in numbers else {})

    def on_runs(self, places: Array, plan: CampaignPlan, runs: int) -> list[tuple[int, int, Array]]:
        """Return of each candidate how it does in the first runs of another plan.

        That is how many runs fail, how many of these end early, and the largest value of each metric in the others,
        (m,), NaN where one of these has none, or all end early: what is reached until then is none of a whole run.
        """
        found = [self.other_runs(place, plan, runs) for place in places]  # a candidate at a time: a step is small
        return [
            (
                int((each.smallest < 0).sum()),
                int(each.early.sum()),
                largest_of(each.values[each.early == 0]),
            )
            for each in found
        ]

    def other_runs(self, place: Array, plan: CampaignPlan, runs: int) -> Judged:
        """Return the first runs of another plan with the gains of a candidate, each run as if it were a candidate."""
        repeated = {key: np.repeat(each, runs, axis=0) for key, each in self.gains_of(place[None]).items()}
        return self._step(plan.drawing().numbers(0, runs), repeated, (runs, 1))
