"""What a search for gains gave, in sentences, tables and curves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hexservo.campaigns.requirements import COMPLETED, Requirement, distance_of
from hexservo.campaigns.result import CampaignResult
from hexservo.campaigns.words import of_settled_starts
from hexservo.campaigns.worst_case import without_refused
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Cell, Column, Curves, Item, Line, Section, Table, Verdict, picked
from hexservo.run.metrics import metric_label, metric_name, metric_unit
from hexservo.scenario.fields import described
from hexservo.scenario.noise import is_random
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

_PAGE = "docs/tune.md"
LARGER = 1.01
"""Factor by which a minimised metric of a worse case is larger, at least."""


@dataclass(frozen=True)
class Generation:
    """The best candidate of a generation."""

    round: int
    runs: int  # that the search had simulated by then
    margin: float  # smallest one over the variations
    feasible: bool  # whether it keeps all requirements
    lowest: tuple[float, ...]  # of each minimised metric, the least among feasible candidates; NaN without any
    variations: int


@dataclass(frozen=True)
class Relaxation:
    """A requirement that was not found to hold with the others, and gains that keep the others and a nearer bound."""

    requirement: Requirement
    bound: float  # in the metric's unit, rounded outwards; its gains keep it in the search's runs and `runs` others
    share: float  # the change, in parts of the requirement's scale
    gains: Mapping[str, Any]  # by dotted key
    failures: int  # of the others, in which a different requirement fails, or no bound would help
    runs: int  # that the others are

    @property
    def text(self) -> str:
        """The relaxed requirement."""
        return f"{self.requirement.name} {self.requirement.comparison} {number(self.bound, 4)}"


@dataclass(frozen=True)
class Edge:
    """A gain that was chosen at an end of its range: beyond it may be a better one."""

    gain: str  # dotted key; of a group with its entries
    end: str  # lower, upper
    limit: float  # of the range there, in the unit of the key

    @property
    def text(self) -> str:
        """The gain with the end of its range."""
        return f"{self.gain} at the {self.end} end, {number(self.limit, 4)}"


@dataclass(frozen=True)
class FrontPoint:
    """Gains of which none of the others is better in both metrics."""

    gains: Mapping[str, Any]  # by dotted key
    values: tuple[float, ...]  # largest ones over the variations of the search, in the metrics' units
    held_out: tuple[float, ...]  # the same in runs that it never used and that complete; NaN where one has none
    failures: int  # of these runs
    ended_early: int  # of the failures: their metrics are none of whole runs, and do not count
    runs: int  # that it never used


@dataclass(frozen=True)
class HeldOut:
    """What the runs of a held-out campaign give of the minimised metrics."""

    runs: int
    completed: int
    largest: tuple[float, ...]  # of each metric in runs that complete; NaN where one has none, or none completes
    margin: float  # smallest one of all runs

    @staticmethod
    def of(result: CampaignResult, metrics: tuple[str, ...]) -> HeldOut:
        """Read the runs of a campaign, chunk by chunk."""
        completed, margin = 0, math.inf
        largest = np.full(len(metrics), -math.inf)
        for table in result.tables([*metrics, "outcome", "margin"]):
            whole = np.array(table.column("outcome").to_pylist()) == COMPLETED
            completed += int(whole.sum())
            margin = min(margin, float(table.column("margin").to_numpy().min()))
            if whole.any():
                values = [table.column(name).to_numpy()[whole].max() for name in metrics]  # NaN stays NaN
                largest = np.maximum(largest, values)
        found = tuple(map(float, largest)) if completed else (math.nan,) * len(metrics)
        return HeldOut(len(result), completed, found, margin)


@described
@dataclass(frozen=True, repr=False, eq=False)
class TuneResult(Findings):
    """The gains that a search found, and what a campaign on variations that it never used gives for them."""

    scenario: Scenario  # with the gains; of a front those nearest to the least of both metrics
    feasible: bool  # whether all requirements hold in all variations of the search
    margin: float  # smallest one over these
    worst: tuple[float, ...]  # largest value of each minimised metric over these, in its unit; NaN where a run has none
    before: tuple[float, ...]  # margin and metrics of the scenario's own gains, over the same variations and noise
    before_is_feasible: bool  # whether all requirements hold with these in all of them
    before_is_better: bool  # whether these come before the gains found, by each of the metrics
    excluded: tuple[str, ...]  # keys whose original gains no candidate has: beyond their range, or unequal in a group
    gains: Mapping[str, Any]  # by dotted key
    edges: tuple[Edge, ...]  # of these gains
    loop: Mapping[str, float]  # what is required of the loop -> its number with the gains; NaN: none
    held_out: CampaignResult | None  # a campaign with other draws; None for gains that are not feasible
    relaxations: tuple[Relaxation, ...]  # for gains that are not feasible, the smallest change first
    front: tuple[FrontPoint, ...]  # for two metrics, ordered by the first one
    settled: bool  # whether the last search for a worse case found none
    worst_margin: float  # smallest one that this search found with the gains
    end_margins: tuple[float, ...]  # the same with the first and the last gains of a front; empty without one
    history: tuple[Generation, ...]  # of the search, in order
    variations: int  # of the search at its end, worst cases included
    joined: int  # worst cases among them
    runs: int  # that the search simulated
    refused: int  # points of the box of what varies that are no valid scenario, and were left out
    seed: int  # of the draws and of the search
    minimise: tuple[str, ...]  # names of one or two metrics
    path: Path  # of the scenario file

    @property
    def advice(self) -> str:
        """The requirement that was not found to hold with the others and its smallest relaxation, or what has no value.

        Or that all requirements hold with the original gains. Empty for gains that are feasible.
        """
        if self.feasible:
            return ""
        if self.before_is_feasible:
            return f"All requirements hold with the original gains{self._remedy}"
        if self.margin >= 0.0:
            lost = [name for name, value in zip(self.minimise, self.worst, strict=True) if not math.isfinite(value)]
            return f"The requirements hold, but in some variation the run has no {' and no '.join(lost)}."
        if not self.relaxations:
            least = f"the smallest margin of the best gains is {number(self.margin)}"
            if self.margin > -1.0:  # else a run ended early, or a metric has no value
                change = number(-distance_of(self.margin))
                least = f"with every bound relaxed by {change} of its scale, the best gains keep all of them"
            return f"No requirement was found whose relaxation alone helps; {least}."
        first = self.relaxations[0]
        return (
            f"The requirement {first.requirement} was not found to hold together with the others in "
            f"{len(self.history)} generations; with {first.text}, the smallest change that was found, all hold in the "
            f"{self.variations} variations of the search, and in {first.runs - first.failures} of {first.runs} runs "
            "that it never used."
        )

    def headline(self) -> str:
        """Return a line that names the scenario."""
        return f'Tuning of "{self.scenario.name}"'

    def section(self) -> Section:
        """Return the result in sentences, with the gains."""
        rows: list[list[Cell]] = [[key, _text(value)] for key, value in self.gains.items()]
        items: list[Item] = [Table("Gains", (Column("key"), Column("value")), rows, "", _PAGE)]
        if self.loop:
            numbers: list[list[Cell]] = [[name, value] for name, value in self.loop.items()]
            items.append(Table("Numbers of the loop", (Column("required"), Column("is")), numbers, "", _PAGE))
        if self.relaxations:
            changed: list[list[Cell]] = [
                [str(one.requirement), one.text, one.share, f"{one.failures} of {one.runs}"] for one in self.relaxations
            ]
            names = ("requirement", "with which gains were found", "change, in parts of its scale", "other runs fail")
            columns = tuple(map(Column, names))
            items.append(Table("Relaxations", columns, changed, "Each alone, the others as they are.", _PAGE))
            nearest: list[list[Cell]] = [[key, _text(value)] for key, value in self.relaxations[0].gains.items()]
            title = f"Gains with {self.relaxations[0].text}"
            items.append(Table(title, (Column("key"), Column("value")), nearest, "", _PAGE))
        return Section("tuning", "Tuning", self._sentences(), items, self._verdict(), self._data())

    def _verdict(self) -> Verdict:
        """Return that of the runs which the search never used; bad for gains that are not feasible.

        It is not good where a failing case is known, or the original gains are better.
        """
        if not self.feasible:
            return "bad"
        verdict = "open" if self.held_out is None else self.held_out.section().verdict
        is_doubtful = self.worst_margin < 0 or self.before_is_better
        return "warning" if verdict == "good" and is_doubtful else verdict

    def sections(self) -> list[Section]:
        """Return the result, the course of the search and, for two metrics, the front."""
        found = [self.section()]
        if self.history:
            found.append(Section("tuning_history", "Course of the search", (), self._course()))
        if self.front:
            found.append(Section("tuning_front", "Front", self._front_sentences(), self._front()))
        return found

    def _sentences(self) -> list[str]:
        sentences = []
        names = [metric_name(name, self.scenario.robot) for name in self.minimise]
        units = [metric_unit(name, self.scenario.robot) for name in self.minimise]
        if self.feasible:
            largest = "; ".join(
                f"the largest {name} is {_shown(value, unit)}, with the original gains {_shown(before, unit)}"
                for name, unit, value, before in zip(names, units, self.worst, self.before[1:], strict=True)
            )
            largest = largest or (
                f"the smallest margin is {number(self.margin)}, with the original gains {number(self.before[0])}"
            )
            sentences.append(f"The requirements hold in all {self.variations} variations of the search; {largest}.")
        else:
            wanted = "the requirements hold" if self.margin < 0.0 else "every run has the metrics to minimise"
            if self.before_is_feasible:
                sentences.append(f"{self.advice} No candidate was found with which {wanted}.")
            else:
                sentences.append(f"No gains were found with which {wanted}. {self.advice}")
        if self.held_out is not None and self._held_out_runs is not None:
            sentences.append(
                "That is biased, since the search chose by it. In variations that it never used "
                f"{_held_out_values(self._held_out_runs, names, units)}, "
                f"and {self.held_out.section().sentences[0]}"
            )
            if self.held_out.summary.get("settled_at_start"):
                sentences.append(of_settled_starts(self.held_out.summary))
        if self.feasible or not self.before_is_feasible:  # the first sentence is about the original gains otherwise
            if self.before_is_better:
                sentences.append(f"The original gains are better over the variations of the search{self._remedy}")
            elif self.excluded:
                sentences.append(f"No candidate has the original {self._exclusion}.")
        if self.edges:
            where = "; ".join(edge.text for edge in self.edges)
            sentences.append(f"Gains at the edge of their range: {where}. A wider range may have better ones.")
        least = f"the smallest margin that it found is {number(self.worst_margin)}"
        if self.end_margins:
            least += f", at the ends of the front {' and '.join(map(number, self.end_margins))}"
        draw = ", with one draw of the noise," if is_random(self.scenario) else ""
        if not self.settled:
            worse = f"one, which did not join, since the rounds had ended; {least}"
        elif larger := self._larger_held_out():
            worse = f"none, but there are worse ones: the held-out runs have {larger}; {least}"
        else:
            fails = f"{least}; " if min((self.worst_margin, *self.end_margins)) < 0 else ""
            cases = "case is" if self.joined == 1 else "cases are"
            worse = f"none; {fails}{self.joined} worst {cases} among the variations"
        sentences.append(f"The last search for a worse case{draw} found {worse}.")
        if self.refused:
            sentences.append(without_refused(self.refused))
        sentences.append(f"The search simulated {self.runs} runs (seed {self.seed}).")
        return sentences

    def _larger_held_out(self) -> str:
        """Return by what held-out runs are worse than all of the search; empty where none is."""
        if self._held_out_runs is None:
            return ""
        found = [
            f"a {metric_name(name, self.scenario.robot)} of {_shown(held_out, metric_unit(name, self.scenario.robot))}"
            for name, held_out, own in zip(self.minimise, self._held_out_runs.largest, self.worst, strict=True)
            if held_out > LARGER * own
        ]
        smallest = self._held_out_runs.margin
        least = min(self.margin, self.worst_margin)
        if smallest < least and (smallest < 0 or not self.minimise):
            found.append(f"a margin of {number(smallest)}")
        return " and ".join(found)

    @cached_property
    def _held_out_runs(self) -> HeldOut | None:
        """What the held-out runs give, read once; None without these."""
        return None if self.held_out is None else HeldOut.of(self.held_out, self.minimise)

    @property
    def _exclusion(self) -> str:
        """The keys whose original gains no candidate has, with the reason."""
        exclude = "exclude it" if len(self.excluded) == 1 else "exclude them"
        return f"{' and '.join(self.excluded)}, since the ranges and groups of tune.variables {exclude}"

    @property
    def _remedy(self) -> str:
        """The end of the sentence that the original gains are better."""
        if self.excluded:
            return f"; no candidate has their {self._exclusion}. Widen these, or keep the original gains."
        return ". Keep them, or search with more generations."

    def _data(self) -> dict[str, Any]:
        return {
            "feasible": self.feasible,
            "margin": self.margin,
            "minimise": list(self.minimise),
            "worst": list(self.worst),
            "before": list(self.before),
            "before_is_feasible": self.before_is_feasible,
            "before_is_better": self.before_is_better,
            "excluded": list(self.excluded),
            "gains": dict(self.gains),
            "edges": {edge.gain: edge.end for edge in self.edges},
            "loop": dict(self.loop),
            "held_out": None if self.held_out is None else self.held_out.summary,
            "relaxations": {str(one.requirement): one.bound for one in self.relaxations},
            "relaxed_gains": {str(one.requirement): dict(one.gains) for one in self.relaxations},
            "relaxed_failures": {str(one.requirement): [one.failures, one.runs] for one in self.relaxations},
            "front": [[*point.values, *point.held_out, point.failures, point.ended_early] for point in self.front],
            **picked(self, "settled worst_margin end_margins variations joined runs refused seed"),
            "history": [
                [each.round, each.runs, each.margin, each.feasible, *each.lowest, each.variations]
                for each in self.history
            ],
        }

    def _course(self) -> list[Curves]:
        """Return the best candidate of each generation over the runs."""
        runs = np.array([each.runs for each in self.history], dtype=float)
        rounds = np.array([each.round for each in self.history])
        note = "Each generation has other noise, and each round more variations: a later value may be worse."
        margins = np.array([each.margin for each in self.history])
        items = [
            Curves(
                "Margin of the best candidate",
                "runs",
                "smallest margin",
                [
                    Line(name, runs[kind], margins[kind], "points")
                    for name, kind in (("requirements hold", margins >= 0), ("requirements do not hold", margins < 0))
                    if kind.any()
                ],
                note=note,
                page=_PAGE,
            )
        ]
        for place, name in enumerate(self.minimise):
            lowest = np.array([each.lowest[place] for each in self.history])
            lines = [
                Line(f"round {one}", runs[rounds == one], lowest[rounds == one])
                for one in np.unique(rounds)
                if np.isfinite(lowest[rounds == one]).any()
            ]
            if lines:
                title = f"Least {name.replace('_', ' ')} of feasible candidates"
                label = metric_label(name, self.scenario.robot)
                items.append(Curves(title, "runs", label, lines, note=note, page=_PAGE))
        return items

    def _front_sentences(self) -> list[str]:
        kept = sum(point.failures == 0 for point in self.front)
        sentences = [
            f"{len(self.front)} gains of which none is better than another in both metrics. Each was judged by "
            f"{self.front[0].runs} runs that the search never used; {kept} of them fail in none."
        ]
        if most := max(point.ended_early for point in self.front):
            early = sum(point.ended_early > 0 for point in self.front)
            sentences.append(
                f"With {early} of them runs end early, up to {most}; these do not count for the largest values."
            )
        return sentences

    def _front(self) -> list[Curves]:
        names = [metric_label(name, self.scenario.robot) for name in self.minimise]
        inside = np.array([point.values for point in self.front])
        outside = np.array([point.held_out for point in self.front])
        lines = [
            Line("variations of the search", inside[:, 0], inside[:, 1], "points"),
            Line("other variations", outside[:, 0], outside[:, 1], "points"),
        ]
        shown = [line for line in lines if np.isfinite(line.y).any() and np.isfinite(line.x).any()]
        return [Curves("Largest values of both metrics", names[0], names[1], shown, page=_PAGE)]


def _held_out_values(found: HeldOut, names: list[str], units: list[str]) -> str:
    """Return the largest value of each minimised metric in the runs that completed, or the smallest margin of all.

    What a metric has reached when a run ends early is none of a whole run.
    """
    if not names:
        return f"the smallest margin is {number(found.margin)}"
    if not found.completed:
        return "no run completes"
    parts = [
        f"the largest {name} is {_shown(value, unit)}"
        for name, unit, value in zip(names, units, found.largest, strict=True)
    ]
    among = "" if found.completed == found.runs else f" among the {found.completed} of {found.runs} runs that complete"
    return ", ".join(parts) + among


def _shown(value: float, unit: str) -> str:
    return f"{number(value)} {unit}" if math.isfinite(value) else "it has no value in some run"


def _text(value: Any) -> str:
    return "[" + ", ".join(map(_text, value)) + "]" if isinstance(value, list) else f"{value:.4g}"
