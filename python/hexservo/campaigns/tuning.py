"""Tuning: gains whose worst run over many variations is the best that a search finds (docs/tune.md)."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.engine import campaign
from hexservo.campaigns.file_keys import TunePlan
from hexservo.campaigns.judging import Judge
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.result import CampaignResult
from hexservo.campaigns.store import write_text
from hexservo.campaigns.worst_case import smallest_in_box
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Cell, Column, Section, Table
from hexservo.run.metrics import METRICS
from hexservo.run.publish import OutputError, named
from hexservo.run.variations import known_key, plain_row
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import value_at
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

__all__ = ["TuneResult", "tune"]

_SIGMA = 0.25  # first spread of the candidates, in parts of the ranges
_FINALISTS = 6  # candidates that are compared at the end of a round, with the same noise
_WORST_RUNS = 400  # of the search for the worst case of a round's winner
_WORSE = 1e-3  # a worst case joins if its margin is smaller by more than this
_HELD_OUT = "held-out"
_TUNED = "tuned.yaml"


@dataclass(frozen=True, repr=False, eq=False)
class TuneResult(Findings):
    """The gains that a search found, and what a campaign on variations that it never used gives for them."""

    scenario: Scenario  # with the gains
    feasible: bool  # whether all requirements hold in all variations of the search
    margin: float  # smallest one over these
    worst: float  # largest value of the minimised metric over these, in its unit; NaN where a run has none
    before: tuple[float, float]  # margin and metric of the original gains, over the same variations and noise
    gains: Mapping[str, Any]  # by dotted key
    held_out: CampaignResult | None  # a campaign with other draws; None for gains that are not feasible
    advice: str  # for gains that are not feasible: the requirement that cannot hold with the others; else empty
    variations: int  # of the search at its end, worst cases included
    runs: int  # that the search simulated
    seed: int
    minimise: str
    path: Path  # of the scenario file

    def headline(self) -> str:
        """Return a line that names the scenario."""
        return f'Tuning of "{self.scenario.name}"'

    def section(self) -> Section:
        """Return the result in sentences, with the gains."""
        unit = METRICS[self.minimise][0]
        name = self.minimise.replace("_", " ")
        sentences = []
        if self.feasible:
            sentences.append(
                f"The requirements hold in all {self.variations} variations of the search; the largest {name} is "
                f"{number(self.worst)} {unit}, with the original gains {_shown(self.before[1], unit)}."
            )
        else:
            sentences.append(f"No gains were found with which the requirements hold. {self.advice}")
        if self.held_out is not None:
            largest = float(self.held_out.to_arrow([self.minimise]).column(0).to_numpy().max())
            sentences.append(
                f"That is biased, since the search chose by it. In variations that it never used the largest {name} is "
                f"{_shown(largest, unit)}, and {self.held_out.section().sentences[0]}"
            )
        sentences.append(f"The search simulated {self.runs} runs (seed {self.seed}).")
        rows: list[list[Cell]] = [[key, _text(value)] for key, value in self.gains.items()]
        table = Table("Gains", (Column("key"), Column("value")), rows, "", "docs/tune.md")
        held = self.held_out
        verdict = "bad" if not self.feasible else "warning" if held is not None and held.failures else "good"
        data = {"margin": self.margin, "worst": self.worst, "before": list(self.before), "gains": dict(self.gains)}
        return Section("tuning", "Tuning", sentences, [table], verdict, data)  # type: ignore[arg-type]


def _shown(value: float, unit: str) -> str:
    return f"{number(value)} {unit}" if math.isfinite(value) else "it has no value in some run"


def _text(value: Any) -> str:
    return "[" + ", ".join(map(_text, value)) + "]" if isinstance(value, list) else f"{value:.4g}"


def tune(
    source: str | os.PathLike[str] | Mapping[str, Any] | CampaignPlan,
    out: str | os.PathLike[str],
    *,
    generations: int = 40,
    rounds: int = 3,
    seed: int = 0,
    threads: int | None = None,
) -> TuneResult:
    """Search the gains of a campaign file with a block ``tune``, and check them on other variations (docs/tune.md).

    CMA-ES (Hansen 2016) compares candidates over the same variations with the same noise, which is other noise in each
    generation. Candidates that keep all requirements come first, by the largest value of the minimised metric; then
    those that do not, by their smallest margin. After each round the worst case of the winner joins the variations,
    until none is worse. The winner is then judged by a campaign with another ``stream``.

    Parameters
    ----------
    source
        As for `campaign`; ``runs`` is the number of runs of the held-out campaign.
    out
        A new or empty folder: ``tuned.yaml``, the scenario with the gains, and the campaign ``held-out``.
    generations
        Of a round, at least 1.
    rounds
        At most, at least 1.
    seed
        Of the search: the same one finds the same gains.
    threads
        As for `simulate_batch`.

    Raises
    ------
    ScenarioError
        The file is not valid.
    ValueError
        It has no block ``tune``, or no number of runs.
    OutputError
        The folder holds something, or cannot be written.
    KeyboardInterrupt
        Ctrl-C in the search: nothing is written.
    """
    plan = load_plan(source)
    if plan.tune is None or plan.runs is None:
        missing = "the block tune" if plan.tune is None else "runs"
        raise ValueError(f"source: expected a campaign file with {missing}, got one without")
    folder = Path(out)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(f"{named(folder)}: expected a new or empty folder, got one with files; name another")
    search = _Search(plan, plan.tune, seed, threads)
    best, tried = search.place_of(plan.scenario), 0
    while True:
        tried += 1
        best = search.round(best, generations)
        worst, margin = search.worst_case(best)
        if tried >= rounds or margin >= search.judged(best[None])[0][0].min() - _WORSE:
            break
        search.join(worst)
    both = search.judged(np.stack([best, search.place_of(plan.scenario)]))
    margins, values = both[0].min(axis=1), both[1]
    feasible = bool(margins[0] >= 0)
    gains = search.gains(best)
    scenario = plan.scenario.updated(gains)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / _TUNED
    write_text(path, scenario.to_yaml())
    held_out = None
    if feasible:
        other = plan.changed(scenario=scenario, stream=plan.stream + 1, until=None)
        held_out = campaign(other, folder / _HELD_OUT, threads=threads)
    return TuneResult(
        scenario=scenario,
        feasible=feasible,
        margin=float(margins[0]),
        worst=float(values[0]),
        before=(float(margins[1]), float(values[1])),
        gains=gains,
        held_out=held_out,
        advice="" if feasible else search.advice(),
        variations=search.count,
        runs=search.judge.runs,
        seed=seed,
        minimise=plan.tune.minimise,
        path=path,
    )


class _Search:
    """Candidates are places in the unit box of the variables; variations are rows of numbers."""

    def __init__(self, plan: CampaignPlan, asked: TunePlan, seed: int, threads: int | None) -> None:
        self.plan, self.asked, self.seed = plan, asked, seed
        self.judge = Judge(plan, threads)
        self.drawing = self.judge.drawing
        self.numbers = self.drawing.numbers(0, asked.over)
        self.random = np.random.default_rng(seed)
        self.nearest = np.full(len(plan.require), -math.inf)  # largest margin of a requirement where all others hold
        self._renew()

    @property
    def count(self) -> int:
        return len(next(iter(self.numbers.values())))

    def _renew(self) -> None:
        """Draw other noise, the same for all candidates."""
        if "seed" in self.numbers:
            self.numbers["seed"] = self.random.integers(0, 2**64, self.count, dtype=np.uint64)

    # ---- Gains ------------------------------------------------------------------------------------------------------

    def gains_of(self, places: Array) -> dict[str, Array]:
        """Return the gains of candidates, (n, ...) by key."""
        found, start = {}, 0
        for key, variable in self.asked.variables.items():
            parts = variable.variation.in_box(places[:, start : start + len(variable.groups)])
            start += len(variable.groups)
            found[key] = parts[:, 0] if variable.groups == (0,) else np.repeat(parts, variable.groups, axis=1)
        return found

    def gains(self, place: Array) -> dict[str, Any]:
        """Return the gains of one candidate, for `Scenario.updated`."""
        law = self.plan.scenario.controller.law
        return {key: plain_row(known_key(key, law), values[0]) for key, values in self.gains_of(place[None]).items()}

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

    # ---- Runs -------------------------------------------------------------------------------------------------------

    def judged(self, places: Array) -> tuple[Array, Array]:
        """Return the smallest margins of candidates, (n, r), and their largest metrics, (n,), over the variations."""
        margins, values = self._run(self.gains_of(places), self.numbers, len(places))
        for column in range(margins.shape[1]):
            others = np.delete(margins, column, axis=1)
            kept = margins[(others >= 0).all(axis=1), column]
            self.nearest[column] = max(self.nearest[column], *kept, -math.inf)
        return margins, values

    def _run(self, gains: Mapping[str, Array], numbers: Mapping[str, NDArray[Any]], count: int) -> tuple[Array, Array]:
        """Run every candidate on every variation, in one batch."""
        size = len(next(iter(numbers.values())))
        drawn = {key: np.tile(values, (count, *[1] * (values.ndim - 1))) for key, values in numbers.items()}
        repeated = {key: np.repeat(values, size, axis=0) for key, values in gains.items()}
        margins, batch = self.judge.judged(drawn, repeated)
        values = batch.metrics[self.asked.minimise].reshape(count, size).max(axis=1)  # NaN stays NaN
        return margins.reshape(count, size, -1).min(axis=1), values

    def round(self, start: Array, generations: int) -> Array:
        """Return the best candidate of a search from a place."""
        import cma

        single = len(start) == 1  # which the method does not take
        options = {"bounds": [0, 1], "seed": self.seed + 1, "verbose": -9, "maxiter": generations, "tolfun": 0}
        strategy = cma.CMAEvolutionStrategy(np.append(start, 0.5) if single else start, _SIGMA, options)
        finalists = [start]
        while not strategy.stop():
            self._renew()
            candidates = strategy.ask()
            places = np.array(candidates)[:, : len(start)]
            order = ranking(*self.judged(places))
            ranks = np.empty(len(order))
            ranks[order] = np.arange(len(order))
            strategy.tell(candidates, ranks.tolist())
            finalists.append(places[order[0]])
        mean = np.clip(np.asarray(strategy.result.xfavorite)[: len(start)], 0.0, 1.0)
        last = np.stack([start, mean, *finalists[-_FINALISTS:]])
        self._renew()
        best: Array = last[ranking(*self.judged(last))[0]]
        return best

    def worst_case(self, place: Array) -> tuple[dict[str, NDArray[Any]], float]:
        """Return the variation with the smallest margin that is found for a candidate."""
        gains = self.gains_of(place[None])
        seeds = np.array([self.random.integers(0, 2**64, dtype=np.uint64)])

        def margin(shares: Array) -> Array:
            every = {key: np.repeat(values, len(shares), axis=0) for key, values in gains.items()}
            return self.judge.smallest_margins(self._at(shares, seeds), every)

        if not self.drawing.dimension:
            return self._at(np.empty((1, 0)), seeds), math.inf
        start = np.full(self.drawing.dimension, 0.5)
        found, smallest = smallest_in_box(margin, start, _WORST_RUNS, self.seed + 1)
        return self._at(found[None], seeds), smallest

    def _at(self, shares: Array, seeds: NDArray[np.uint64]) -> dict[str, NDArray[Any]]:
        numbers = self.drawing.numbers_at(shares, 0)
        return numbers | ({"seed": np.repeat(seeds, len(shares))} if "seed" in numbers else {})

    def join(self, numbers: Mapping[str, NDArray[Any]]) -> None:
        """Add a variation to those of the search."""
        self.numbers = {key: np.concatenate([values, numbers[key]]) for key, values in self.numbers.items()}

    def advice(self) -> str:
        """Return which requirement cannot hold with the others, and the smallest relaxation with which it would."""
        relaxed: Sequence[tuple[float, int]] = sorted(
            (-margin, column) for column, margin in enumerate(self.nearest) if -math.inf < margin < 0
        )
        if not relaxed:
            return "No candidate keeps all requirements but one."
        share, column = relaxed[0]
        one = self.plan.require[column]
        if one.name == "outcome":
            return f"The requirement {one} does not hold together with the others."
        scale = abs(one.bound) if one.scale is None else one.scale
        bound = one.bound + (share if one.comparison in ("<=", "<") else -share) * scale
        return (
            f"The requirement {one} does not hold together with the others; with {one.name} {one.comparison} "
            f"{number(bound, 4)} it does, the smallest change that was found."
        )


def ranking(margins: Array, values: Array) -> NDArray[np.intp]:
    """Return candidates, the best first: feasible ones by their values, then the others by their smallest margins.

    Parameters
    ----------
    margins, values
        (n, r), (n,); a value of NaN comes after all others.
    """
    smallest = margins.min(axis=1)
    feasible = smallest >= 0
    return np.lexsort((np.where(feasible, np.nan_to_num(values, nan=np.inf), -smallest), ~feasible))
