"""Result of a diagnosis: causes with their evidence, and the runs behind them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hexservo.findings.diagnosis.criterion import DRIFT_TIME, Judgement, Record
from hexservo.findings.diagnosis.goal import Obstacle
from hexservo.findings.evidence import Section, as_data, picked
from hexservo.findings.part import Part
from hexservo.run.result import Result
from hexservo.scenario.fields import described

_STAYS = 0.5  # of the original run, for which a longer one that is settled has to stay so


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
    settling_time: float  # of that run [s]; NaN where it does not settle
    # [s], in which a pose error grows e-fold by unequal depth errors where the run passes, as in a longer one
    # (`growth_time`); NaN: it does not
    grows_in: float


@dataclass(frozen=True, eq=False)
class Finding:
    """A cause and its evidence."""

    cause: str  # its key, such as "late_camera"; its page: docs/diagnosis/
    title: str
    named: bool  # whether it is the cause, by the rules of docs/diagnosis/ranking.md
    score: float  # 0 to 1: share of the failure that its removal cures, reduced if it makes no run fail alone
    cure: float | None  # share of the severity that its removal cures; None: no removal could be run
    # whether it makes a scenario without other faults fail; None: not tried, since the run fails without it too, or not
    # known, since that scenario fails without it too
    alone: bool | None
    look: float | None  # signature: how well the recorded signals fit it, 0 to 1; None: it has no signature
    evidence: tuple[str, ...]  # sentences with numbers
    without: Remedy | None  # the run without this cause, even if no machine can be without it
    remedy: Remedy | None  # None for causes of low score


@described
@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Part):
    """Whether a run failed, and why: causes with evidence and remedy, the most likely one first."""

    result: Result  # the run that was diagnosed
    failed: bool | None  # None: the run was interrupted
    criteria: tuple[str, ...]  # a clause for each criterion, with its value and its limit
    causes: tuple[Finding, ...] = ()  # ranked: those that are named first
    together: tuple[str, ...] = ()  # keys of two causes that make the run fail only together
    controls: tuple[bool, ...] = ()  # whether the run passes with other seeds and with small random changes
    warnings: tuple[str, ...] = ()  # sentences on what limits the diagnosis
    absent: tuple[str, ...] = ()  # titles of causes that are not present in the scenario, or that could not be tried
    obstacle: Obstacle | None = None  # why no law can reach the goal
    record: Record | None = None  # what the causes are judged by
    judgement: Judgement | None = None  # by the criteria
    cured: Record | None = None  # the run without the first cause
    # whether the run passes with devices without faults and default gains, all at once; None: not tried, as a cause or
    # a pair explains the failure, or refused
    faultless: bool | None = None

    @property
    def named(self) -> tuple[Finding, ...]:
        """Causes that explain the failure; empty where none does."""
        return tuple(finding for finding in self.causes if finding.named)

    @property
    def pair(self) -> tuple[Finding, ...]:
        """The two causes that make the run fail only together; empty where one alone explains it, or none does."""
        return () if self.named else tuple(finding for finding in self.causes if finding.cause in self.together)

    @property
    def passes_without_either(self) -> bool:
        """Whether the run passes without one of the `pair`, whichever it is."""
        return all(finding.without is not None and finding.without.works for finding in self.pair)

    @property
    def cures(self) -> tuple[dict[str, Any], ...]:
        """Changes of the scenario, by dotted key, with each of which the first sentence states that the run passes."""
        if self.obstacle is not None or not self.causes:
            return ()
        if not self.named and self.too_short is not None:
            return ({"simulation.duration": self.too_short},)
        without = [one.without for one in self.pair or self.causes[:1] if one.without is not None]
        if self.pair and not self.passes_without_either:
            return ({key: value for one in without for key, value in one.changes.items()},)
        return tuple(one.changes for one in without if one.works)

    @property
    def too_short(self) -> float | None:
        """A duration with which the run passes and stays settled, with no other change [s]; None where there is none.

        None too where another cause or a pair is named, which makes the run slow (`settles_later`), and where the run
        passes with a shorter dwell time, not with a longer run.
        """
        later = self.settles_later
        if later is None or self.together or (self.named and self.named[0].cause != "duration"):
            return None
        return float(later.changes["simulation.duration"])

    @property
    def settles_later(self) -> Remedy | None:
        """The longer run, if it passes with no other change and stays settled for as long as half of the original run.

        None for one that settles for less, which may be by chance. If `duration` is named, any longer run counts.
        """
        for finding in self.causes:
            run = finding.without
            if finding.cause == "duration" and run is not None and run.works:
                if "simulation.duration" not in run.changes or self.obstacle is not None:
                    return None
                stays = run.changes["simulation.duration"] - run.settling_time
                least = _STAYS * self.result.scenario.simulation.duration
                return run if finding.named or stays >= least else None
        return None

    def sections(self) -> tuple[Section, ...]:
        """Return the only section."""
        return (self.section(),)

    def to_dict(self) -> dict[str, Any]:
        """Return verdict, sentences and all numbers for strict JSON, in SI units and pixels."""
        return self.section().to_dict()

    def numbers(self) -> dict[str, Any]:
        """Return all numbers, in SI units and pixels."""
        record, judgement = self.record, self.judgement
        if record is None or judgement is None:
            return {"failed": None, "outcome": self.result.outcome, "causes": []}
        robot = self.result.scenario.robot
        found: dict[str, Any] = as_data(
            {
                "failed": self.failed,
                "outcome": record.outcome,
                "end_time": record.end_time,
                "stop_time": record.stop_time,
                "settled": judgement.settled,
                "error": judgement.error * self.band,
                "error_allowed": self.band,
                "leg_travel": judgement.stroke * robot.stroke,
                "stroke": robot.stroke,
                "limits_used": dict(judgement.limits),
                "drift": record.drift,
                "drift_allowed": robot.stroke / DRIFT_TIME,
                "severity": judgement.severity,
                "causes": [_finding_data(finding) for finding in self.causes],
                "together": list(self.together),
                "too_short": self.too_short,
                "faultless": self.faultless,
                "controls": list(self.controls),
                "warnings": list(self.warnings),
                "absent": list(self.absent),
            }
        )
        return found

    @property
    def band(self) -> float:
        """Settling band of the run [px]."""
        return self.result.scenario.metrics.band

    @property
    def leg_travel(self) -> float:
        """Largest travel of a leg in the run [m]."""
        assert self.record is not None
        return self.record.metrics["peak_leg_excursion"]


def _finding_data(finding: Finding) -> dict[str, Any]:
    return {
        **picked(finding, "cause title named score cure alone look"),
        "evidence": list(finding.evidence),
        "without": None if finding.without is None else vars(finding.without),
        "remedy": None if finding.remedy is None else vars(finding.remedy),
    }
