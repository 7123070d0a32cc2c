"""Result of a diagnosis: causes with their evidence, and its text, table and curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.diagnosis.causes import CAUSES
from hexservo.findings.diagnosis.criterion import DRIFT_TIME, Judgement, Record
from hexservo.findings.diagnosis.goal import Obstacle
from hexservo.findings.diagnosis.words import ends, how, joined, remedy_sentence, spelt
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Column, Curves, Line, Section, Table, as_data
from hexservo.run.result import Result
from hexservo.scenario.wording import number

__all__ = ["Diagnosis", "Finding", "Remedy"]

_PAGE = "docs/diagnosis/ranking.md"
_TITLES = {cause.key: cause.title for cause in CAUSES}
_FLOOR = 1e-3  # [px], of the curves
_HELPERS = 3  # most removals that are named which help and are not the cause


@dataclass(frozen=True, eq=False)
class Remedy:
    """A remedy against a cause; it was simulated."""

    words: str  # what is changed, as it follows "with"
    changes: dict[str, Any]  # by dotted key, as `Scenario.updated` takes them
    works: bool  # whether the run passes with it
    outcome: str  # of that run
    error: float  # of that run: the largest one within the dwell time before its end [px]
    leg_travel: float  # of that run: largest travel of a leg [m]
    drift: float  # of that run: of the leg that moves fastest at its end [m/s]


@dataclass(frozen=True, eq=False)
class Finding:
    """A cause and its evidence."""

    cause: str  # its key, such as "late_camera"; its page: docs/diagnosis/
    title: str
    named: bool  # whether it is the cause, by the rules of docs/diagnosis/ranking.md
    score: float  # 0 to 1: share of the failure that its removal cures, reduced if it makes no run fail alone
    cure: float | None  # share of the severity that its removal cures; None: no removal could be run
    alone: bool | None  # whether it makes a scenario without other faults fail; None: not tried
    look: float | None  # signature: how well the recorded signals fit it, 0 to 1; None: it has no signature
    evidence: tuple[str, ...]  # sentences with numbers
    without: Remedy | None  # the run without this cause, even if no machine can be without it
    remedy: Remedy | None  # None for causes of low score


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Findings):
    """Whether a run failed, and why: causes with evidence and remedy, the most likely one first."""

    result: Result
    failed: bool | None  # None: the run was interrupted
    criteria: tuple[str, ...]  # a clause for each criterion, with its value and its limit
    causes: tuple[Finding, ...] = ()  # ranked: those that are named first
    together: tuple[str, ...] = ()  # keys of two causes that make the run fail only together
    controls: tuple[bool, ...] = ()  # whether the run passes with other seeds and with small random changes
    warnings: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()  # titles of causes that are not present in the scenario, or that could not be tried
    obstacle: Obstacle | None = None  # why no law can reach the goal
    _record: Record | None = None
    _judgement: Judgement | None = None
    _cured: Record | None = None  # the run without the first cause

    @property
    def named(self) -> tuple[Finding, ...]:
        """Causes that explain the failure; empty where none does."""
        return tuple(finding for finding in self.causes if finding.named)

    @property
    def too_short(self) -> float | None:
        """A duration with which the run passes, if the cause is that the run is too short [s]; else None."""
        first = self.causes[0] if self.causes else None
        if first is None or not first.named or first.cause != "duration" or first.without is None:
            return None
        return float(first.without.changes["simulation.duration"])

    def section(self) -> Section:
        """Return sentences, a table of the causes, and the error over time with and without the first cause."""
        if self._record is None or self._judgement is None:
            return Section("diagnosis", "Diagnosis", ["The run was interrupted: there is no diagnosis."])
        data = self.to_dict()
        if not self.failed:
            if not self.warnings:
                words = [f"Nothing to diagnose: {joined(self.criteria)}."]
                return Section("diagnosis", "Diagnosis", words, (), "good", data)
            words = [f"The run passes. {self.warnings[0]}", *self.warnings[1:], f"Criteria: {joined(self.criteria)}."]
            return Section("diagnosis", "Diagnosis", words, (), "warning", data)
        sentences = [self._verdict(), f"What failed: {joined(self.criteria)}."]
        if self.named:
            sentences += self.named[0].evidence[1:]
        sentences += self._sureness()
        sentences += [remedy_sentence(finding) for finding in self.causes if finding.remedy is not None]
        return Section(
            "diagnosis", "Diagnosis", [*sentences, *self.warnings], (self._table(), *self._curves()), "bad", data
        )

    def sections(self) -> tuple[Section, ...]:
        """Return the only section."""
        return (self.section(),)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers for strict JSON, in SI units and pixels."""
        record, judgement = self._record, self._judgement
        if record is None or judgement is None:
            return {"failed": None, "outcome": self.result.outcome, "causes": []}
        robot = self.result.scenario.robot
        found: dict[str, Any] = as_data(
            {
                "failed": self.failed,
                "outcome": record.outcome,
                "end_time": record.end_time,
                "settled": judgement.settled,
                "error": judgement.error * self._band,
                "error_allowed": self._band,
                "leg_travel": judgement.stroke * robot.stroke,
                "stroke": robot.stroke,
                "drift": record.drift,
                "drift_allowed": robot.stroke / DRIFT_TIME,
                "severity": judgement.severity,
                "causes": [_finding_data(finding) for finding in self.causes],
                "together": list(self.together),
                "too_short": self.too_short,
                "controls": list(self.controls),
                "warnings": list(self.warnings),
                "absent": list(self.absent),
            }
        )
        return found

    def _verdict(self) -> str:
        assert self._judgement is not None
        assert self._record is not None
        was = ends(self._record.outcome, self._judgement.error * self._band, self._leg_travel, self._record.drift)
        first = self.causes[0] if self.causes else None
        if self.obstacle is not None:
            return self._of_obstacle(self.obstacle)
        if first is not None and first.named and first.without is not None:
            if self.too_short:
                return f"The run is too short: with simulation.duration={self.too_short:g} it passes."
            return (
                f"The most likely cause is {first.title}: with {first.without.words} the run {how(first.without)}; the "
                f"original run {was}."
            )
        if first is not None and first.without is None:
            return (
                f"From the recorded signals alone the most likely cause is {first.title}: a custom controller is not "
                "run again."
            )
        if self.together:
            together = joined([_TITLES[key] for key in self.together])
            return (
                f"Not explained by one cause: two make it fail together, {together}; the original run {was}. Without "
                "other faults both together fail as well, and neither does alone."
            )
        words = f"Not explained: it {was}, and none of the {len(self.causes)} causes that were tried explains it."
        if first is not None and first.without is not None and first.cure:
            words += f" The most effective change was {first.without.words}: the run then {how(first.without)}."
        return words

    def _of_obstacle(self, obstacle: Obstacle) -> str:
        robot = self.result.scenario.robot
        if obstacle.kind == "image":
            return (
                f"The goal cannot be reached: no pose was found whose image is the goal; the best one leaves "
                f"{number(obstacle.residual)} px."
            )
        beyond = (obstacle.leg_travel - robot.stroke) * 1e3
        return (
            f"The goal cannot be reached: at the nearest pose with that image a leg is {number(beyond)} mm beyond its "
            f"stroke of {number(robot.stroke * 1e3)} mm; nothing else matters until that is changed."
        )

    def _sureness(self) -> list[str]:
        """Return the evidence against the verdict: other changes that cure the run as well."""
        found = []
        passing = sum(self.controls)
        if passing:
            found.append(
                f"Near the limit: with other seeds, or numbers changed randomly by 5 %, the run passes {passing} of "
                f"{len(self.controls)} times, so the cause is less certain."
            )
        others = [
            finding.without.words
            for finding in self.causes
            if not finding.named and finding.without is not None and finding.without.works
        ]
        if others and self.obstacle is None:
            more = f", and {len(others) - _HELPERS} others" if len(others) > _HELPERS else ""
            found.append(
                f"The run also passes with {'; with '.join(others[:_HELPERS])}{more}: that helps, but alone it "
                "makes no scenario without other faults fail, so it is not the cause."
            )
        also = [finding.title for finding in self.named[1:]]
        if also:
            found.append(f"Equally likely: {joined(also)}; each was removed alone.")
        return found

    @property
    def _band(self) -> float:
        return self.result.scenario.metrics.band

    @property
    def _leg_travel(self) -> float:
        assert self._record is not None
        return self._record.metrics["peak_leg_excursion"]

    def _table(self) -> Table:
        assert self._record is not None
        assert self._judgement is not None
        columns = (
            Column("cause"),
            Column("score", format=".2f"),
            Column("what was changed"),
            Column("outcome"),
            Column("remaining error", "px"),
            Column("leg travel", "mm", ".3g"),
            Column("fails alone"),
        )
        rows: list[tuple[str | float | None, ...]] = [
            (
                "original run",
                None,
                "",
                spelt(self._record.outcome),
                self._judgement.error * self._band,
                1e3 * self._leg_travel,
                "",
            )
        ]
        for finding in self.causes:
            run = finding.without
            after: tuple[str, str, float | None, float | None] = ("", "", None, None)
            alone = {True: "yes", False: "no", None: ""}[finding.alone]
            if run is not None:
                after = (run.words, spelt(run.outcome), run.error, 1e3 * run.leg_travel)
            rows.append((finding.title, finding.score, *after, alone))
        note = f"Not present in this scenario: {', '.join(self.absent)}." if self.absent else ""
        return Table("Causes, each removed alone", columns, rows, note, _PAGE)

    def _curves(self) -> tuple[Curves, ...]:
        assert self._record is not None
        lines = [Line("original run", self._record.time, np.maximum(self._record.error, _FLOOR))]
        if self._cured is not None:
            name = f"without: {self.causes[0].title}"
            lines.append(Line(name, self._cured.time, np.maximum(self._cured.error, _FLOOR), "dashed"))
        title = "Largest feature error, with and without the most likely cause"
        at_floor = any((line.y <= _FLOOR).any() for line in lines)
        note = f"Errors below {_FLOOR:g} px are drawn there." if at_floor else ""
        return (Curves(title, "time [s]", "error [px]", lines, y_log=True, note=note, page=_PAGE),)


def _finding_data(finding: Finding) -> dict[str, Any]:
    return {
        "cause": finding.cause,
        "title": finding.title,
        "named": finding.named,
        "score": finding.score,
        "cure": finding.cure,
        "alone": finding.alone,
        "look": finding.look,
        "evidence": list(finding.evidence),
        "without": None if finding.without is None else vars(finding.without),
        "remedy": None if finding.remedy is None else vars(finding.remedy),
    }
