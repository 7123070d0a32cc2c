"""Sensitivity: what share of the variance of margins and metrics each varied number causes (docs/campaigns.md)."""

from __future__ import annotations

import contextlib
import inspect
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hexservo.campaigns.distributions import between_ends
from hexservo.campaigns.judging import Judge
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.requirements import COMPLETED
from hexservo.campaigns.words import of_common_noise
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Bars, Column, Item, Section, Share, Table
from hexservo.run.metrics import METRICS
from hexservo.scenario.arrays import Array
from hexservo.scenario.fields import described
from hexservo.scenario.wording import whole_number

_SHOWN = 10  # inputs of a table
_RESAMPLES = 200  # of the bootstrap
_MOST, _FEW = 0.9, 30  # runs that carry this share of the variance: as many are needed, or else
_ORDINARY = 0.2  # this share of the runs (of normal numbers 45 % carry so much, of uniform ones 66 %)
_BEYOND = 0.05  # by which an interval may miss 0 to 100 %: of many inputs without effect some do, by little


@dataclass(frozen=True, eq=False)
class Indices:
    """Sobol indices of one quantity, with the ends of their bootstrap intervals at 95 %."""

    first: Array  # (d,) share of the variance that an input causes by itself
    first_interval: Array  # (d, 2)
    total: Array  # (d,) share that is left out where the input is fixed, interactions included
    total_interval: Array  # (d, 2)


@described
@dataclass(frozen=True, repr=False, eq=False)
class Sensitivity(Findings):
    """Sobol indices of the margin, and of the metrics that all runs have at their full duration.

    They bound no probability.
    """

    plan: CampaignPlan  # whose inputs vary
    inputs: tuple[str, ...]  # d numbers that vary: ``target.rotation[0]``; ``seed`` stands for all noise
    indices: Mapping[str, Indices]  # "margin" or a metric of `hs.METRICS` -> indices
    without: Mapping[str, str]  # that which has none -> why, as a clause
    runs: int  # that were simulated
    early: int  # of these, ended before their duration
    seed: int  # of the draws

    def headline(self) -> str:
        """Return a line that names the scenario."""
        return f'Sensitivity of "{self.plan.scenario.name}"'

    def ranking(self, quantity: str = "margin") -> list[tuple[str, float]]:
        """Return the inputs with their total indices, the most influential first.

        Raises
        ------
        ValueError
            There are no indices of this quantity; `without` has the reason.
        """
        if quantity not in self.indices:
            raise ValueError(f"quantity: expected one of {', '.join(self.indices) or 'none'}, got {quantity!r}")
        total = self.indices[quantity].total
        return [(self.inputs[place], float(total[place])) for place in np.argsort(-total, kind="stable")]

    def section(self) -> Section:
        """Return the most influential inputs of the margin and of each required metric, with a table for the margin."""
        sentences = []
        required = {one.name for one in self.plan.require}
        asked = [name for name in ("margin", *METRICS) if name == "margin" or name in required]
        for quantity in asked:
            if quantity not in self.indices:
                sentences.append(f"{quantity}: no indices, since {self.without[quantity]}.")
                continue
            (one, share), *others = self.ranking(quantity)
            second = f", then {others[0][0]} ({others[0][1]:.0%})" if others else ""
            low, high = self.indices[quantity].total_interval[self.inputs.index(one)]
            interval = f"bootstrap interval at 95 %: {low:.0%} to {high:.0%}"
            sentences.append(f"{quantity}: {one} has the largest total index ({share:.0%}, {interval}){second}.")
        if self.early:
            ended = f"{self.early} of {self.runs} runs ended early"
            sentences.append(f"{ended}: the margin alone compares them with the others, and no metric has indices.")
        if any((self.indices[name].total > 1.0).any() for name in asked if name in self.indices):
            sentences.append(
                "Estimates of indices may exceed 100 %, which no index does; more samples narrow their intervals."
            )
        if (common := self.plan.common_noise) is not None:
            sentences.append(of_common_noise("the indices hold", common))
        items: list[Item] = []
        if "margin" in self.indices:
            found = self.indices["margin"]
            places = np.argsort(-found.total, kind="stable")[:_SHOWN]
            shares = np.column_stack([found.first, found.first_interval, found.total, found.total_interval])
            rows = [(self.inputs[place], *shares[place].tolist()) for place in places]
            heads = ("first order", "from", "to", "total", "from", "to")
            columns = (Column("input"), *(Column(head, format=".2f") for head in heads))
            note = f"Sobol indices of the margin with bootstrap intervals at 95 %, {self.runs} runs, seed {self.seed}."
            items += [
                self._bars("margin", places),
                Table("Sensitivity of the margin", columns, rows, note, "docs/campaigns.md"),
            ]
        data = {name: {"first": each.first, "total": each.total} for name, each in self.indices.items()}
        return Section("sensitivity", "Sensitivity", sentences, items, "open", {"inputs": self.inputs, **data})

    def _bars(self, quantity: str, places: NDArray[np.intp]) -> Bars:
        found = self.indices[quantity]
        return Bars(
            f"Sobol indices of the {quantity}",
            "share of the variance",
            [self.inputs[place] for place in places],
            [
                Share("first order", found.first[places], found.first_interval[places]),
                Share("total", found.total[places], found.total_interval[places]),
            ],
            f"Bootstrap intervals at 95 %; {self.runs} runs. Total: with all interactions.",
            "docs/campaigns.md",
        )


def sensitivity(
    source: str | os.PathLike[str] | Mapping[str, Any] | CampaignPlan,
    *,
    samples: int = 256,
    seed: int = 0,
    threads: int | None = None,
) -> Sensitivity:
    """Compute the Sobol indices of a campaign's margin and metrics (docs/campaigns.md, section 8).

    Parameters
    ----------
    source
        As for `campaign`; its runs, chunks and confidence do not matter.
    samples
        A power of 2, at least 4: samples (d + 2) runs are simulated for d numbers that vary, seeds counting as one.
    seed
        Of the quasi-random points and the bootstrap: the same one gives the same indices.
    threads
        As for `simulate_batch`.

    Raises
    ------
    TypeError
        For arguments of other types.
    ValueError
        For another number of samples, or a negative seed.
    ScenarioError
        As `campaign`, and for a draw that is no valid scenario, with its numbers.
    KeyboardInterrupt
        Ctrl-C.
    """
    plan = load_plan(source)
    judge = Judge(plan, threads, METRICS)
    drawing = judge.drawing
    inputs = (*drawing.names, *(["seed"] if drawing.has_seed else []))
    quantities: list[str] = []
    tried: list[Array] = []
    early = 0

    def outputs(uniform: Array) -> Array:
        points = between_ends(uniform.T)
        seeds = (points[:, -1] * 2.0**64).astype(np.uint64)
        numbers = drawing.numbers_of(points[:, : drawing.dimension], seeds)
        nonlocal early
        margins, batch = judge.judged(numbers)
        completed = batch.outcome == COMPLETED  # what a metric has reached when a run ends is none of a whole run
        early += int((~completed).sum())
        quantities[:] = ["margin", *batch.metrics]
        metrics = [np.where(completed, values, np.nan) for values in batch.metrics.values()]
        tried.append(np.stack([margins.min(axis=1), *metrics]))
        return tried[-1]

    found = sobol_indices(outputs, len(inputs), samples, seed)
    indices = {name: each for name, each in zip(quantities, found, strict=True) if isinstance(each, Indices)}
    values = dict(zip(quantities, np.concatenate(tried, axis=1), strict=True))
    without = {
        name: _without_value(values[name], early) or each
        for name, each in zip(quantities, found, strict=True)
        if isinstance(each, str)
    }
    return Sensitivity(plan, inputs, indices, without, judge.runs, early, seed)


# ---- Why there are none ---------------------------------------------------------------------------------------------


def _without_value(values: Array, early: int) -> str:
    """Return how many of these values, (n,), are none, of which `early` runs ended early; "" where all are."""
    missing = int((~np.isfinite(values)).sum())
    if not missing:
        return ""
    reasons = [f"{early} of {len(values)} runs ended early"] if early else []
    if missing > early:
        reasons.append(f"it has no value in {missing - early} {'others' if early else f'of {len(values)} runs'}")
    return " and ".join(reasons)


def _without_variance(values: Array, drawn: Array) -> str:
    """Return why the variance of an output is not determined, as a clause; "" where it is.

    Parameters
    ----------
    values
        All values of the output, of which the first, `drawn`, have the variance.
    """
    if missing := _without_value(values, 0):
        return missing
    if np.ptp(drawn) == 0:
        return "it is the same in all runs" if np.ptp(values) == 0 else "it varies in too few of the samples"
    distances = np.abs(drawn - drawn.mean())
    parts = np.sort((distances / distances.max()) ** 2)[::-1]  # squares of the distances themselves may overflow
    shares = np.cumsum(parts) / parts.sum()
    carriers = int(np.searchsorted(shares, _MOST)) + 1
    if carriers >= min(_FEW, _ORDINARY * len(drawn)):
        return ""
    return (
        f"{carriers} of {len(drawn)} runs carry {_MOST:.0%} of its variance, too few to estimate shares of it; more "
        "samples help where more runs then carry it, else narrower distributions"
    )


def _without_meaning(found: Indices) -> str:
    """Return why estimates are none of indices, as a clause; "" where they may be."""
    intervals = (found.first_interval, found.total_interval)
    if not all(np.isfinite(ends).all() for ends in intervals):
        return "some bootstrap interval is not finite; take more samples"
    for ends in intervals:
        for low, high in ends:
            if low > 1.0 + _BEYOND or high < -_BEYOND:
                return (
                    f"a bootstrap interval is {low:.0%} to {high:.0%}, where an index is from 0% to 100%; take more "
                    "samples or narrower distributions"
                )
    # First-order indices add up to 100 % at most, and total ones to at least as much.
    first, total = found.first_interval[:, 0].sum(), found.total_interval[:, 1].sum()
    if first > 1.0 + _BEYOND or total < 1.0 - _BEYOND:
        return "the indices do not add up to the variance; take more samples or narrower distributions"
    return ""


@contextlib.contextmanager
def _global_generator(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, from which SciPy's bootstrap of the indices draws, and put it back."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed % 2**32)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def sobol_indices(function: Callable[[Array], Array], dimension: int, samples: int, seed: int) -> list[Indices | str]:
    """Return the Sobol indices of the outputs of a function of independent uniform inputs.

    Estimators: Saltelli et al. 2010 for the first order, Jansen 1999 for the total one (`scipy.stats.sobol_indices`).

    Parameters
    ----------
    function
        Takes inputs (d, n), from 0 to 1, and returns outputs (m, n).
    dimension
        d.
    samples
        A power of 2, at least 4: the function is called for samples (d + 2) inputs in all.
    seed
        Of the quasi-random points and of the bootstrap.

    Returns
    -------
    list
        Indices of each of the m outputs, or as a clause why it has none: it is not finite everywhere, does not vary,
        few runs carry its variance, or the intervals are none of indices.

    Raises
    ------
    TypeError
        For samples or a seed that is no integer.
    ValueError
        For another number of samples, or a negative seed.
    """
    samples, seed = whole_number("samples", samples, 4), whole_number("seed", seed, 0)
    if samples & (samples - 1):
        raise ValueError(f"samples: expected a power of 2, at least 4, got {samples}")
    calls: list[Array] = []

    def watched(inputs: Array) -> Array:
        values = function(np.asarray(inputs, dtype=float))
        calls.append(values)
        return np.where(np.isfinite(values), values, 0.0)

    random = np.random.default_rng(seed)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of outputs that do not vary, which are left out below
        name = "rng" if "rng" in inspect.signature(stats.sobol_indices).parameters else "random_state"  # SciPy 1.15
        uniform = [stats.uniform()] * dimension
        found = stats.sobol_indices(func=watched, n=samples, dists=uniform, **{name: random})
        with _global_generator(seed):
            spread = found.bootstrap(confidence_level=0.95, n_resamples=_RESAMPLES)
    everything = np.concatenate([values.reshape(len(values), -1) for values in calls], axis=1)
    drawn = np.concatenate([values.reshape(len(values), -1) for values in calls[:2]], axis=1)  # whose variance it is
    shape = (len(drawn), dimension)  # SciPy drops axes of length one
    first, total = (np.reshape(part, shape) for part in (found.first_order, found.total_order))
    ends = [
        np.stack([np.reshape(end, shape) for end in (part.confidence_interval.low, part.confidence_interval.high)], -1)
        for part in (spread.first_order, spread.total_order)
    ]
    for each in ends:  # without any effect every resample gives 0, of which the bootstrap makes 0/0
        each[total == 0.0] = 0.0
    outputs: list[Indices | str] = []
    for row in range(len(drawn)):
        found_indices = Indices(first[row], ends[0][row], total[row], ends[1][row])
        reason = _without_variance(everything[row], drawn[row]) or _without_meaning(found_indices)
        outputs.append(reason or found_indices)
    return outputs
