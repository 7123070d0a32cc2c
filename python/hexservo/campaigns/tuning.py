"""Tuning: gains whose worst run over many variations is the best that a search finds (docs/tune.md)."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.candidates import Candidates, Judged
from hexservo.campaigns.engine import campaign
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.result import CampaignResult
from hexservo.campaigns.search_steps import SearchSteps
from hexservo.campaigns.store import PLAN, read_plan
from hexservo.campaigns.strategies import best_candidate, front_of, relax
from hexservo.campaigns.tune_result import Edge, FrontPoint, Generation, Relaxation, TuneResult
from hexservo.campaigns.worst_case import MAX_SEED
from hexservo.campaigns.writing import (
    free_place,
    refuse_file,
    require_empty,
    require_own_scenario,
    write_beside,
    write_scenario,
)
from hexservo.findings.evidence import as_data
from hexservo.run.progress import ProgressCallback, reporting
from hexservo.run.publish import OutputError, named
from hexservo.run.variations import columns_of, known_key
from hexservo.scenario.arrays import Array
from hexservo.scenario.wording import whole_number

_HELD_OUT = "held-out"
_TUNED = "tuned.yaml"
_FRONT = "front.csv"
_SUMMARY = "tuning.json"
_EDGE = 0.02  # of a range, from its ends: a gain there might be a better one beyond
_OTHER_RUNS = 200  # of a point of a front or a relaxation, on variations that the search never used


def tune(
    source: str | os.PathLike[str] | Mapping[str, Any] | CampaignPlan,
    out: str | os.PathLike[str],
    *,
    generations: int = 40,
    rounds: int = 6,
    seed: int = 0,
    threads: int | None = None,
    progress: bool | ProgressCallback | None = None,
    warn: Callable[[str], object] | None = None,
) -> TuneResult:
    """Search the gains of a campaign file with a block ``tune``, or go on with it, and check them (docs/tune.md).

    CMA-ES (Hansen 2016) compares candidates over the same variations with the same noise, which is other noise in each
    generation, also where the file varies no ``seed``. Candidates that keep all requirements come first, by the largest
    value of the minimised metric; then those that do not, by their violations. After each round worse cases of the
    winner are searched and join the variations, until none is found. The winner is then judged by a campaign with
    another ``stream``.

    Every batch is kept in the folder when it is simulated. After an interruption the same call goes on, and ends with
    the same gains bit for bit.

    Parameters
    ----------
    source
        As for `campaign`; ``runs`` is the number of runs of the held-out campaign.
    out
        Folder: new, empty, or of the same search. It gets ``tuned.yaml``, the scenario with the gains, the campaign
        ``held-out``, ``tuning.json``, for two metrics ``front.csv``, and ``steps``, what was simulated.
    generations
        Of a round, at least 1.
    rounds
        At most, at least 1.
    seed
        Of the search: the same one finds the same gains.
    threads
        As for `simulate_batch`.
    progress
        True draws a bar on standard error; a function is called with (generations done, at most) in this thread.
    warn
        Called with a sentence for each damaged step, which is simulated again; None: nothing is called.

    Raises
    ------
    ScenarioError
        The file is not valid, or variations of the search or of the held-out campaign are no valid scenarios.
    ValueError
        It has no block ``tune``, or no number of runs; ``generations`` or ``rounds`` is below 1, or ``seed`` not from
        0 to 2^31 - 1.
    TypeError
        For arguments of other types.
    OutputError
        The folder holds something else, a different search or a changed ``tuned.yaml``, or cannot be written; pymoo,
        of the extra ``tune``, is not installed for two metrics.
    VariantError
        As `campaign`.
    KeyboardInterrupt
        Ctrl-C: what was simulated stays, and the same call goes on.
    """
    plan = load_plan(source).with_own_noise()  # gains that fit one noise would be judged by that noise
    if plan.tune is None or plan.runs is None:
        missing = "the block tune" if plan.tune is None else "runs"
        raise ValueError(f"source: expected a campaign file with {missing}, got one without")
    generations, rounds = whole_number("generations", generations, 1), whole_number("rounds", rounds, 1)
    seed = whole_number("seed", seed, 0, MAX_SEED)
    if len(plan.tune.minimise) > 1 and find_spec("pymoo") is None:
        raise OutputError('minimise: expected an installation with pymoo for two metrics: pip install "hexservo[tune]"')
    steps = SearchSteps(out, plan, seed, generations, warn or (lambda sentence: None))
    with steps.opened(), reporting(progress, "generations") as report:
        require_own_scenario(steps.folder / _TUNED)  # before the search
        _require_own_check(steps.folder / _HELD_OUT)
        candidates = Candidates(plan, plan.tune, steps, seed, threads)
        search = _Search(candidates, generations, rounds, report)
        search.run()
        return _finished(search, plan, steps.folder, threads)


class _Search:
    """The course of a search: rounds, worse cases that join, and what it ends with."""

    def __init__(
        self, candidates: Candidates, generations: int, rounds: int, report: Callable[[int, int], object]
    ) -> None:
        self.candidates = candidates
        self.generations = generations
        self.rounds = rounds
        self.report = report
        self.metrics = len(candidates.asked.minimise)
        self.start = candidates.place_of(candidates.plan.scenario)
        self.best = self.start
        self.known = [self.start]  # with the winner of each round
        self.front: Array = np.empty((0, candidates.dimension))
        self.history: list[Generation] = []
        self.round = 0
        self.worst_margin = math.nan  # of the winner, in the last search for a worse case
        self.end_margins: tuple[float, ...] = ()  # the same of the ends of a front
        self.settled = False  # whether the last search found none

    def run(self) -> None:
        """Search until no worse case is found, or the rounds end; then what cannot hold, if nothing is feasible."""
        while True:
            self.round += 1
            self._search()
            worse, (self.worst_margin, *ends) = self._worse_cases()
            self.end_margins = tuple(ends)
            self.settled = not worse
            if self.settled or self.round == self.rounds:
                break
            for numbers in worse:
                self.candidates.join(numbers)
        self.candidates.renew()
        judged = self.candidates.judged(self.best[None])
        if not judged.feasible[0]:
            for column, one in enumerate(self.candidates.required):
                if one.name != "outcome":
                    relax(self.candidates, self.best, max(self.generations // 2, 1), column)

    def _search(self) -> None:
        if self.metrics < 2:
            self.best = best_candidate(self.candidates, np.stack(self.known), self.generations, self._note)
            self.known.append(self.best)
            return
        known = self.front if len(self.front) else self.best[None]
        if self.round == 1:  # the ends of the front, each by itself
            known = np.stack(
                [
                    best_candidate(
                        self.candidates, self.best[None], max(self.generations // 2, 1), self._note, metric, metric
                    )
                    for metric in range(self.metrics)
                ]
            )
        known = np.concatenate([known[:: -(-len(known) // 24)], self.start[None]])
        self.front = front_of(self.candidates, known, self.generations, self._note)
        self.best = knee(self.candidates, self.front) if len(self.front) else known[0]

    def _worse_cases(self) -> tuple[list[dict[str, NDArray[Any]]], list[float]]:
        """Search worse cases of the winner, and of both ends of a front; return also the smallest margin of each."""
        places = [self.best, *(self.front[[0, -1]] if len(self.front) else [])]
        found = [self.candidates.worse_cases(place) for place in places]
        return [numbers for worse, _ in found for numbers in worse], [margin for _, margin in found]

    def _note(self, judged: Judged, order: NDArray[np.intp]) -> None:
        """Note a generation."""
        first = order[0]
        feasible = bool(judged.feasible[first])
        values = judged.values[judged.feasible]
        lowest = tuple(float(value) for value in values.min(axis=0)) if len(values) else (math.nan,) * self.metrics
        self.history.append(
            Generation(
                self.round,
                self.candidates.runs,
                float(judged.smallest[first]),
                feasible,
                lowest,
                self.candidates.count,
            )
        )
        of_round = self.generations * (1 if self.metrics < 2 else 2)
        self.report(len(self.history), self.rounds * of_round)


def knee(candidates: Candidates, front: Array) -> Array:
    """Return the candidate of a front that is nearest to its ideal point, each metric in parts of its range."""
    values = candidates.judged(front).values
    span = np.ptp(values, axis=0)
    distance = np.linalg.norm((values - values.min(axis=0)) / np.where(span > 0, span, 1.0), axis=1)
    found: Array = front[int(np.argmin(np.nan_to_num(distance, nan=np.inf)))]
    return found


# ---- What a search ends with ----------------------------------------------------------------------------------------


def _finished(search: _Search, plan: CampaignPlan, folder: Path, threads: int | None) -> TuneResult:
    """Check the gains on other variations, and write the folder."""
    candidates = search.candidates
    candidates.renew()
    winner, original = candidates.judged(search.best[None]), candidates.original()
    if not candidates.differing(search.best):  # a metric that differs by rounding would make them better
        winner = original
    feasible = bool(winner.feasible[0])
    scenario = plan.scenario.updated(candidates.gains(search.best))
    write_scenario(folder / _TUNED, scenario.to_yaml())
    held_out: CampaignResult | None = None
    front: tuple[FrontPoint, ...] = ()
    assert plan.tune is not None
    metrics = plan.metrics if plan.metrics == "all" else tuple(dict.fromkeys((*plan.metrics, *plan.tune.minimise)))
    other = plan.changed(scenario=scenario, stream=plan.stream + 1, until=None, metrics=metrics)
    if not feasible or not _goes_on(folder / _HELD_OUT, other):
        _set_aside(folder / _HELD_OUT)
    if not feasible:
        _set_aside(folder / _FRONT)
    else:
        front = _front_points(candidates, search.front, plan)
        held_out = campaign(other, folder / _HELD_OUT, threads=threads)
        if held_out.interrupted:
            raise KeyboardInterrupt
    if front:
        write_beside(folder / _FRONT, _front_csv(front, candidates))
    result = TuneResult(
        scenario=scenario,
        feasible=feasible,
        margin=float(winner.smallest[0]),
        worst=tuple(map(float, winner.values[0])),
        before=(float(original.smallest[0]), *map(float, original.values[0])),
        before_is_feasible=bool(original.feasible[0]),
        before_is_better=original.beats(winner),
        excluded=candidates.excluded(),
        gains=candidates.gains(search.best),
        edges=edges_of(candidates, search.best),
        loop={
            str(one): value
            for one, value in zip(candidates.asked.subject_to, candidates.loop_numbers(scenario), strict=True)
        },
        held_out=held_out,
        relaxations=() if feasible else _relaxations(candidates, plan),
        front=front,
        settled=search.settled,
        worst_margin=search.worst_margin,
        end_margins=search.end_margins,
        history=tuple(search.history),
        variations=candidates.count,
        joined=candidates.joined,
        runs=candidates.runs,
        refused=candidates.refused,
        seed=candidates.seed,
        minimise=plan.tune.minimise,
        path=folder / _TUNED,
    )
    text = json.dumps(as_data(result.section().data), indent=2, allow_nan=False) + "\n"
    write_beside(folder / _SUMMARY, text)
    return result


def _require_own_check(folder: Path) -> None:
    """Refuse a place of the held-out campaign with anything but one, or with one that cannot be read.

    Raises
    ------
    OutputError
        What is there is kept.
    ResultError
        Its file was changed, or is of a format that this version does not read.
    """
    if folder.is_dir():
        if (folder / PLAN).exists():
            read_plan(folder)
        else:
            require_empty(folder, "the held-out campaign")
    else:
        refuse_file(folder)


def _goes_on(folder: Path, plan: CampaignPlan) -> bool:
    """Whether a campaign is the one of a folder, or one of more runs, or the folder has none."""
    if not (folder / PLAN).exists():
        return True
    there = read_plan(folder)[0]
    ours, theirs = plan.to_mapping(), there.to_mapping()
    more = plan.runs is not None and there.runs is not None and plan.runs >= there.runs
    return more and ours | {"runs": None} == theirs | {"runs": None}


def _set_aside(path: Path) -> None:
    """Rename what belongs to the gains of an earlier search: fewer rounds, or a different check."""
    if not path.exists():
        return
    try:
        path.rename(free_place(path))
    except OSError as error:
        raise OutputError(f"{named(path)}: cannot be renamed: {error.strerror}") from None


def _relaxations(candidates: Candidates, plan: CampaignPlan) -> tuple[Relaxation, ...]:
    """Return the requirements that were not found to hold with the others, the smallest change first.

    The bound of each is kept by its gains over the variations of the search and in runs that the search never used:
    a search chooses gains by the former, whose largest value is therefore too small for others.
    """
    assert plan.runs is not None
    runs = min(plan.runs, _OTHER_RUNS)
    other = plan.changed(stream=plan.stream + 1)
    found = []
    for column, (one, nearest) in enumerate(zip(candidates.required, candidates.nearest, strict=True)):
        if one.name == "outcome" or not -math.inf < nearest < 0:
            continue
        place = candidates.nearest_places[column]
        judged = candidates.other_runs(place, other, runs)
        distance, kept = nearest, judged.margins >= 0
        if column < len(plan.require):  # else a number of the loop, which no run changes
            distances = judged.distances[:, column]
            distance = np.nanmin([nearest, *distances])
            kept[:, column] = np.isfinite(distances)
        failures = int((~kept.all(axis=1)).sum())
        bound = one.rounded_bound_at(float(distance))  # no run that keeps the exact one misses this
        share = -float(one.distance(np.array([bound]))[0])
        found.append(Relaxation(one, bound, share, candidates.gains(place), failures, runs))
    return tuple(sorted(found, key=lambda each: each.share))


def edges_of(candidates: Candidates, place: Array) -> tuple[Edge, ...]:
    """Return the gains of a candidate that are near an end of their range, in the scale of the range."""
    found = []
    for key, variable, shares in candidates.split(place):
        for share, size, last in zip(shares, variable.groups, np.cumsum(variable.groups), strict=True):
            gain = key
            if len(variable.groups) > 1:
                gain += f"[{last - 1}]" if size == 1 else f"[{last - size}] to [{last - 1}]"
            low, high = variable.variation.box
            if share <= _EDGE:
                found.append(Edge(gain, "lower", low))
            elif share >= 1.0 - _EDGE:
                found.append(Edge(gain, "upper", high))
    return tuple(found)


def _front_points(candidates: Candidates, front: Array, plan: CampaignPlan) -> tuple[FrontPoint, ...]:
    """Check a front on runs that the search never used."""
    if not len(front):
        return ()
    inside = candidates.judged(front)
    assert plan.runs is not None
    runs = min(plan.runs, _OTHER_RUNS)
    outside = candidates.on_runs(front, plan.changed(stream=plan.stream + 1), runs)
    return tuple(
        FrontPoint(
            candidates.gains(place), tuple(map(float, own)), tuple(map(float, largest)), failures, ended_early, runs
        )
        for place, own, (failures, ended_early, largest) in zip(front, inside.values, outside, strict=True)
    )


def _front_csv(front: tuple[FrontPoint, ...], candidates: Candidates) -> str:
    """Return a front as a table: metrics in the search and held out, failures, gains in their units."""
    law = candidates.plan.scenario.controller.law
    names = candidates.asked.minimise
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for place, point in enumerate(front):
        gains = {
            name: float(column[0])
            for key, value in point.gains.items()
            for name, column in columns_of(key, np.asarray(value, dtype=known_key(key, law).dtype)[None]).items()
        }
        if place == 0:
            counts = ("failures", "ended_early", "runs")
            writer.writerow([*names, *(f"{name}_held_out" for name in names), *counts, *gains])
        counted = (point.failures, point.ended_early, point.runs)
        writer.writerow([*point.values, *point.held_out, *counted, *gains.values()])
    return text.getvalue()
