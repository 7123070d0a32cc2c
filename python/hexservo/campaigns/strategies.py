"""Strategies of a search for gains: the best candidate, the smallest relaxation of a requirement, a Pareto front."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.candidates import Candidates, Judged, ranking
from hexservo.campaigns.worst_case import evolution
from hexservo.scenario.arrays import Array

_SIGMA = 0.25  # first spread of the candidates, in parts of the ranges
_FINALISTS = 6  # candidates that are compared at the end of a round, with the same noise
_POPULATION = 48  # of a front
_SPREAD = 0.1  # of the first population of a front around what is known, in parts of the ranges
_SHOWN = 120  # points of a front, at most

Generation = Callable[[Judged, NDArray[np.intp]], object]
"""Called after each generation with its candidates and their order."""


def best_candidate(
    candidates: Candidates, known: Array, generations: int, after: Generation, metric: int = 0, seed: int = 0
) -> Array:
    """Return the best candidate that CMA-ES (Hansen 2016) finds from the last of known ones, by `Judged.order`.

    It is compared with the known ones, (k, dimension), over the variations of now: a search ends with nothing worse.
    """
    start = known[-1]
    finalists: list[Array] = []

    def ranks(places: Array) -> NDArray[np.intp]:
        found = candidates.judged(places)
        order = found.order(metric)
        after(found, order)
        finalists.append(places[order[0]])
        return order

    favourite = _evolve(candidates, start, generations, ranks, seed)
    last = np.stack([*known, favourite, *finalists[-_FINALISTS:]])
    candidates.renew()
    best: Array = last[candidates.judged(last).order(metric)[0]]
    return best


def relax(candidates: Candidates, start: Array, generations: int, column: int) -> None:
    """Search the largest margin of one requirement where all others hold; `Candidates.nearest` has what was found."""

    def order(places: Array) -> NDArray[np.intp]:
        found = candidates.judged(places)
        return ranking(np.delete(found.violations, column, axis=1), -found.margins[:, column])

    _evolve(candidates, start, generations, order, column + 1)


def _evolve(
    candidates: Candidates, start: Array, generations: int, order: Callable[[Array], NDArray[np.intp]], seed: int
) -> Array:
    """Return the favourite of CMA-ES, which sees the order of each generation alone; each has other noise."""
    strategy = evolution(
        start,
        _SIGMA,
        seed=candidates.seed + 1 + seed,
        maxiter=generations,
        tolfun=0,
        tolfunhist=0,
        tolflatfitness=generations + 1,
        tolstagnation=generations + 1,
    )
    while not strategy.stop():
        candidates.renew()
        asked = strategy.ask()
        found = order(np.array(asked)[:, : len(start)])
        ranks = np.empty(len(found))
        ranks[found] = np.arange(len(found))
        strategy.tell(asked, ranks.tolist())
    favourite: Array = np.clip(np.asarray(strategy.result.xfavorite)[: len(start)], 0.0, 1.0)
    return favourite


# ---- Fronts ---------------------------------------------------------------------------------------------------------


def front_of(candidates: Candidates, known: Array, generations: int, after: Generation) -> Array:
    """Return candidates of which none is worse than another in both metrics, ordered by the first metric.

    NSGA-II (Deb et al. 2002, of pymoo) from known candidates and others around them. All feasible candidates that none
    dominates are judged again at the end, with the same noise.

    Parameters
    ----------
    candidates
        With two minimised metrics.
    known
        (k, dimension), k >= 1: where the front is known, as the best candidate of each metric.
    generations
        Of 48 candidates each.
    after
        Called after each generation.

    Returns
    -------
    Array
        (n, dimension); n is 0 if no candidate is feasible.
    """
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.evaluator import Evaluator
    from pymoo.core.problem import Problem
    from pymoo.problems.static import StaticProblem

    size, dimension = _POPULATION, candidates.dimension
    random = np.random.default_rng(candidates.seed + 1)
    around = known[random.integers(0, len(known), size - len(known))]
    first = np.clip(around + _SPREAD * random.standard_normal(around.shape), 0.0, 1.0)
    first[::4] = random.random(first[::4].shape)
    problem = Problem(n_var=dimension, n_obj=2, n_ieq_constr=1, xl=np.zeros(dimension), xu=np.ones(dimension))
    strategy: Any = NSGA2(pop_size=size, sampling=np.concatenate([known, first]))
    strategy.setup(problem, termination=("n_gen", generations), seed=candidates.seed + 1, verbose=False)
    archive = np.empty((0, dimension))
    values = np.empty((0, 2))
    while strategy.has_next():
        candidates.renew()
        population = strategy.ask()
        places = np.clip(population.get("X"), 0.0, 1.0)
        found = candidates.judged(places)
        after(found, found.order())
        objectives = np.nan_to_num(found.values, nan=1e9, posinf=1e9)
        Evaluator().eval(StaticProblem(problem, F=objectives, G=found.violations.sum(axis=1)[:, None]), population)
        strategy.tell(infills=population)
        archive = np.concatenate([archive, places[found.feasible]])
        values = np.concatenate([values, found.values[found.feasible]])
        kept = not_dominated(values)
        archive, values = archive[kept], values[kept]
    last = np.unique(np.concatenate([archive, known]), axis=0)
    candidates.renew()
    again = candidates.judged(last)
    last, values = last[again.feasible], again.values[again.feasible]
    kept = not_dominated(values)
    last, values = last[kept], values[kept]
    order = np.argsort(values[:, 0], kind="stable")
    shown = np.linspace(0, max(len(order) - 1, 0), min(len(order), _SHOWN)).astype(np.intp)
    return np.asarray(last[order][shown])


def not_dominated(values: Array) -> NDArray[np.intp]:
    """Return the rows of which none is worse than another in both columns, (n, 2), of equal ones the first."""
    kept, lowest = [], math.inf
    for row in np.lexsort((values[:, 1], values[:, 0])):
        if values[row, 1] < lowest:
            lowest = values[row, 1]
            kept.append(row)
    return np.sort(np.array(kept, dtype=np.intp))
