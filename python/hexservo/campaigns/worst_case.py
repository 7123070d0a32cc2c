"""The worst case: the smallest margin that a search finds within the box of what varies."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.distributions import SEED
from hexservo.campaigns.drawing import with_unit
from hexservo.campaigns.judging import Judge
from hexservo.campaigns.refused import REMEDY
from hexservo.campaigns.requirements import Requirement, ranks_of, run_margins
from hexservo.campaigns.result import CampaignResult, command_with_changes, scenario_and_changes
from hexservo.campaigns.store import WORST
from hexservo.campaigns.words import of_common_noise
from hexservo.campaigns.writing import require_own_scenario, write_scenario
from hexservo.findings.diagnosis import diagnose
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Column, Section, Table, Verdict, picked
from hexservo.run.result import Result
from hexservo.run.simulation import simulate, uninterrupted
from hexservo.run.variations import changes_of_run
from hexservo.scenario.arrays import Array
from hexservo.scenario.fields import described
from hexservo.scenario.noise import is_random
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import first_of, number, whole_number, wrong_type
from hexservo.scenario.yaml import ScenarioError

if TYPE_CHECKING:
    from hexservo.findings.diagnosis import Diagnosis

CASE = "worst-case.yaml"
_POPULATION = 12  # candidates of a generation, at least
_OTHER_SEEDS = 100  # with which a case is repeated where something is random
_NAMED = 3  # numbers of a run outside the box, in its sentence
_SIGMA = 0.3  # first spread of the candidates, in parts of the box
MAX_SEED = 2**31 - 1
"""Largest seed of a search: CMA-ES takes 32 bits, and what follows from a seed is larger than it."""

REFUSED = 1e100
"""Margin of a point that is no valid scenario, in a search for the smallest one: above all others."""

_STALLED = 1e-3  # a search ends when its candidates' margins differ by less


@described
@dataclass(frozen=True, repr=False, eq=False)
class WorstCase(Findings):
    """The worst case found: there may be a worse one."""

    scenario: Scenario  # of the run with the smallest margin: `hs.simulate` repeats it
    path: Path  # of its file, in the campaign's folder
    margin: float  # smallest one of its requirements; negative: it fails
    margins: tuple[tuple[str, float], ...]  # requirement, its smallest margin in any run of the search
    drawn_margin: float  # smallest one of the campaign's own runs
    outside: tuple[str, ...]  # numbers of that run which lie outside the box
    runs: int  # that were simulated
    seed: int  # of the search
    common_noise: int | None  # seed of the noise that all runs share; None where each has its own, or none is random
    command: str  # that runs the packaged scenario with what varies; "" where the campaign varies no packaged one
    diagnosis: Diagnosis | None = field(default=None)  # of the run, where it is about a requirement that the run misses
    refused: int = field(default=0)  # points of the box that are no valid scenario, and were left out
    refusal: str = field(default="")  # why the first of them is none
    box: tuple[tuple[str, float, float], ...] = field(default=())  # that was searched: key with unit, both ends
    other_seeds: int = field(default=0)  # runs of the case with other noise; 0 where none is random
    other_failures: int = field(default=0)  # how many of these fail

    def headline(self) -> str:
        """Return a line that names the scenario."""
        return f'Worst case of a campaign on "{self.scenario.name}"'

    def section(self) -> Section:
        """Return the margin in sentences, and the smallest one of each requirement."""
        found = "fails" if self.margin < 0 else "passes"
        drawn = ", which fails" if self.drawn_margin < 0 else ""
        noise = (
            "; with the noise of the campaign's worst runs" if self.other_seeds and self.common_noise is None else ""
        )
        sentences = [
            f"The worst case found {found}: its margin is {number(self.margin)}; the smallest one of the campaign's "
            f"own runs is {number(self.drawn_margin)}{drawn}.",
            f"It is the worst of {self.runs} runs of a search (seed {self.seed}{noise}), which proves no bound.",
        ]
        if self.other_seeds:
            sentences.insert(
                1,
                f"With other noise this case fails in {self.other_failures} of {self.other_seeds} runs (other seeds).",
            )
        if self.refused:
            sentences.append(f"{without_refused(self.refused)} Of the first: {self.refusal}.")
        if self.common_noise is not None:
            sentences.append(of_common_noise("it is the worst case", self.common_noise))
        if self.drawn_margin < self.margin and self.outside:
            sentences.append(
                f"{WORST} has the campaign's own worst run, which is worse: outside of the box that is searched lies "
                f"its {first_of(self.outside, _NAMED)}."
            )
        if self.diagnosis is not None:
            sentences.append(self.diagnosis.section().sentences[0])
        columns, rows = (Column("requirement"), Column("margin")), [("all together", self.margin), *self.margins]
        tables = [Table("Smallest margin found", columns, rows, "", "docs/campaigns.md")]
        if self.box:
            keys = (Column("key"), Column("from"), Column("to"))
            tables.append(Table("Box that was searched", keys, self.box, "", "docs/campaigns.md"))
        margins = {"margin": self.margin, "margins": dict(self.margins)}
        data = {**margins, **picked(self, "runs seed refused common_noise box other_seeds other_failures")}
        return Section("worst_case", "Worst case", sentences, tables, self._verdict(), data)

    def _verdict(self) -> Verdict:
        """Return bad for a case that fails; where something is random only if it does so with most of other seeds."""
        if min(self.margin, self.drawn_margin) < 0 and not self.other_seeds:
            return "bad"
        if self.other_failures > self.other_seeds / 2:
            return "bad"
        return "warning" if self.other_failures or min(self.margin, self.drawn_margin) < 0 else "open"


def require_own_case(folder: Path) -> None:
    """Refuse the folder of a campaign where a search for the worst case could not write its file at the end.

    Raises
    ------
    OutputError
        ``worst-case.yaml`` there was changed, or hexservo did not write it; it is kept.
    """
    if folder.is_dir():
        require_own_scenario(folder / CASE)


def worst_case(
    result: CampaignResult, *, runs: int = 4000, restarts: int = 3, seed: int = 0, threads: int | None = None
) -> WorstCase:
    """Search the box of a campaign's variations for its smallest margin (docs/campaigns.md, section 7).

    The case is written to ``worst-case.yaml`` in the campaign's folder, in place of an earlier one that is unchanged.

    CMA-ES (Hansen 2016) minimises the margin of all requirements together, and where several metrics are required that
    of each by itself, from the campaign's worst runs. The box is that of the distributions: their limits, and 3
    standard deviations from the mean at an end of a normal one that has no limit which draws reach. Its points that are
    no valid scenario are left out, and counted. Seeds are those of the run from which a search begins.
    Where something is random the case is repeated with 100 other seeds: one that fails may owe that to its noise alone.

    Parameters
    ----------
    result
        A campaign with runs.
    runs
        To simulate for each search, at least 1. One search is for all requirements together, and one for each metric
        where several are required.
    restarts
        Worst runs of the campaign from which each search begins, which share its `runs`; at least 1.
    seed
        Of the search, from 0 to 2^31 - 1: the same one finds the same case.
    threads
        As for `simulate_batch`.

    Raises
    ------
    TypeError
        For arguments of other types.
    ValueError
        The campaign has no runs, or nothing but seeds varies; a number is out of its range.
    ScenarioError
        No point that was tried is a valid scenario.
    OutputError
        ``worst-case.yaml`` in the campaign's folder was changed, and is kept, or cannot be written (a `ValueError`).
    KeyboardInterrupt
        Ctrl-C: nothing is written.
    """
    if not isinstance(result, CampaignResult):
        raise wrong_type("result", "a CampaignResult (see hs.campaign)", result)
    runs, restarts = whole_number("runs", runs, 1), whole_number("restarts", restarts, 1)
    seed = whole_number("seed", seed, 0, MAX_SEED)
    plan, starts = result.plan, [one["index"] for one in result.summary["worst"]][:restarts]
    require_own_case(result.folder)  # before the search
    judge = Judge(plan, threads)
    drawing = judge.drawing
    if not starts or not drawing.dimension:
        got = "no runs" if not starts else "one in which seed alone varies"
        raise ValueError(f"result: expected a campaign with runs, in which more than seed varies; got {got}")

    # over all searches: the worst run, with where it is, and the smallest margin of each requirement
    rank, place, start = (math.inf, math.inf), drawing.shares(starts[0]), starts[0]
    least = np.full(len(plan.require), math.inf)

    def search(columns: Sequence[int], begin: int) -> None:
        def smallest(shares: Array) -> Array:
            nonlocal rank, place, start, least
            kept, found, _ = judge.judged_where_valid(drawing.numbers_at(shares, begin))
            margins = np.full((len(shares), len(plan.require)), REFUSED)
            margins[kept] = found
            least = np.minimum(least, margins.min(axis=0))
            ranks = [(float(smallest), float(total)) for smallest, total in ranks_of(margins)]
            worst = min(range(len(ranks)), key=ranks.__getitem__)
            if ranks[worst] < rank:
                rank, place, start = ranks[worst], shares[worst], begin
            return np.asarray(margins[:, columns].min(axis=1))

        smallest_in_box(smallest, drawing.shares(begin), runs // len(starts), seed + 1 + begin)

    # A run that does not complete fails every requirement: one metric beside the outcome is searched with it.
    metrics = [column for column, one in enumerate(plan.require) if one.name != "outcome" and len(plan.require) > 1]
    alone = [[column] for column in metrics] if len(metrics) > 1 else []
    for columns in (range(len(plan.require)), *alone):
        for begin in starts:
            search(columns, begin)
    law, margin = judge.base.controller.law, rank[0]
    if margin == REFUSED:
        raise ScenarioError(f"vary: no point that the search tried is a valid scenario ({judge.refusal}); {REMEDY}")
    searched, numbers = judge.runs, drawing.numbers_at(place[None], start)
    drawn = drawing.variations(numbers)
    scenario, changes = scenario_and_changes(plan.scenario, drawing.base | changes_of_run(drawn, law))
    others = _with_other_noise(judge, numbers, seed) if is_random(scenario) else np.empty(0)
    write_scenario(result.folder / CASE, scenario.to_yaml())
    return WorstCase(
        scenario,
        result.folder / CASE,
        margin,
        tuple((str(plan.require[column]), float(least[column])) for column in metrics),
        float(result.summary["worst"][0]["margin"]),
        tuple(drawing.outside(starts[0])),
        searched,
        seed,
        plan.common_noise,
        command_with_changes(changes, scenario),
        _diagnosed(scenario, plan.require) if margin < 0 else None,
        judge.refused,
        judge.refusal,
        tuple(
            (with_unit(plan.scenario, key) + (" (added)" if variation.add else ""), *variation.box)
            for key, variation in plan.vary.items()
            if variation.kind != SEED
        ),
        len(others),
        int((others < 0).sum()),
    )


def _with_other_noise(judge: Judge, numbers: Mapping[str, NDArray[Any]], seed: int) -> Array:
    """Return the smallest margin of a run, whose numbers are (1, ...), with each of other seeds, (n,)."""
    seeds = np.random.default_rng(seed).integers(0, 2**64, _OTHER_SEEDS, dtype=np.uint64)
    repeated = {key: np.repeat(values, _OTHER_SEEDS, axis=0) for key, values in numbers.items()}
    return judge.smallest_margins(repeated | {"seed": seeds})


def without_refused(count: int) -> str:
    """Return that so many points of a box were left out of a search."""
    points, they, were = ("point", "is", "was") if count == 1 else ("points", "are", "were")
    return f"{count} {points} of the box {they} no valid scenario, as no run of the campaign is, and {were} left out."


def _diagnosed(scenario: Scenario, require: Sequence[Requirement]) -> Diagnosis | None:
    """Return the diagnosis of a run that fails; None where it is not about what the run misses of the requirements.

    The criteria of a diagnosis are that a run settles, and what its legs may do. One of them is to be a
    requirement that is missed, and where its changes make the run pass, that run is to keep all requirements.
    """
    run = uninterrupted(simulate(scenario))
    found = diagnose(run)
    if not found.failed or found.judgement is None:
        return None
    missed = {one.name for one, margin in zip(require, _margins(run, require), strict=True) if margin < 0}
    if not (found.judgement.early or missed.intersection(found.judgement.symptoms)):
        return None
    cured = (uninterrupted(simulate(scenario.updated(changes))) for changes in found.cures)
    return found if all(_margins(each, require).min() >= 0 for each in cured) else None


def _margins(run: Result, require: Sequence[Requirement]) -> Array:
    """Return the margin of a run for each requirement, (r,)."""
    metrics = {name: np.array([value]) for name, value in run.streamed_metrics.items()}
    duration = run.scenario.simulation.duration
    margins: Array = run_margins(require, np.array([run.outcome]), np.array([run.end_time]), duration, metrics)[0]
    return margins


def smallest_in_box(
    function: Callable[[Array], Array], start: Array, evaluations: int, seed: int
) -> tuple[Array, float]:
    """Return where a function is smallest within the unit box, and its value there: the best point that was tried.

    CMA-ES from `start`, then from random points with twice as many candidates each time (IPOP, Auger and Hansen 2005),
    as long as there are evaluations. After each search every entry of the best point is tried at 0 and 1, until none
    of these is better.

    Parameters
    ----------
    function
        Takes points (n, d), each entry from 0 to 1, and returns their values (n,).
    start
        (d,), where the first search begins.
    evaluations
        Points to try, at most.
    seed
        Of the search, at least 1.
    """
    random = np.random.default_rng(seed)
    best, smallest, left = start, math.inf, evaluations

    def tried(points: Array) -> Array:
        nonlocal best, smallest, left
        values = function(points)
        left -= len(points)
        place = int(np.argmin(values))
        if values[place] < smallest:
            best, smallest = points[place], float(values[place])
        return values

    tried(start[None])
    begin, population = start, min(max(_POPULATION, 4 + int(3 * math.log(len(start)))), max(evaluations // 4, 2))
    kept = min(6 * len(start), evaluations // 4)  # for the entries' ends
    while left >= population + kept:
        strategy = evolution(begin, _SIGMA, seed=seed, popsize=population, tolfun=_STALLED)
        while left >= population + kept and not strategy.stop():
            candidates = strategy.ask()
            strategy.tell(candidates, tried(np.array(candidates)[:, : len(start)]).tolist())
        ends = np.concatenate([np.zeros(len(start)), np.ones(len(start))])
        entries = np.tile(np.arange(len(start)), 2)
        improved = True
        while improved and left >= len(ends):  # each entry at its ends: a worst case often is a corner
            before, around = smallest, np.repeat(best[None], len(ends), axis=0)
            around[np.arange(len(ends)), entries] = ends
            tried(around)
            improved = smallest < before
        begin, seed, population = random.random(len(start)), seed + 1, min(2 * population, max(left // 4, 2))
    return best, smallest


def evolution(start: Array, spread: float, **options: Any) -> Any:
    """Return CMA-ES in the unit box; its points have one entry more than `start` has, where that is one alone.

    Parameters
    ----------
    start, spread
        (d,) of the first mean, and the first standard deviation.
    options
        Of the package `cma`.
    """
    import cma

    padded = np.append(start, 0.5) if len(start) == 1 else start  # the method takes no single entry
    return cma.CMAEvolutionStrategy(padded, spread, {"bounds": [0, 1], "verbose": -9, **options})
