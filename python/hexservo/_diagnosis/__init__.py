"""Why a run failed: each suspected cause is removed from the scenario by itself, and the run repeated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo._diagnosis.causes import CAUSES, Case, Cause, Removal
from hexservo._diagnosis.criterion import DRIFT_TIME, THRESHOLD, Judgement, Record, judge
from hexservo._diagnosis.evidence import SIGNATURES
from hexservo._diagnosis.goal import goal_of, goal_run
from hexservo._diagnosis.ranking import Trial, judged, rank, try_removals
from hexservo._diagnosis.runs import Run, record_of, run_all
from hexservo._display import Findings
from hexservo._evidence import Column, Curves, Line, Section, Table, as_data
from hexservo._result import Result
from hexservo._wording import number

__all__ = ["Diagnosis", "Finding", "Remedy", "diagnose"]

_PAGE = "docs/diagnosis/ranking.md"
_LIKELY = 0.3  # score from which on a cause gets a remedy
_REMEDIES = 3  # causes that get one, at most
_NEAR = 0.7  # of what is allowed: a warning
_EARLIER, _FALLS = 0.8, 0.8  # where the error at the end is below this share of that of this share of the time,
_LONGER = 3  # the run is tried so many times as long
_OF_THE_LAW = frozenset({"wrong_sign", "stiction", "spring"})  # causes that a controller of one's own does not have
_OTHERWISE = 0.3  # difference in severity between a run and the same run repeated
_SHOWN_DRIFT = 1e-4  # [m/s]: a slower drift is not worth a word
_TITLES = {cause.key: cause.title for cause in CAUSES}
_FEW = 40  # samples, or steps
_ENOUGH = 2000  # steps that are tried in place of a few
_FLOOR = 1e-3  # [px], of the curves


@dataclass(frozen=True, eq=False)
class Remedy:
    """What helps against a cause; it was run."""

    words: str  # what is changed, as it follows "with"
    changes: dict[str, Any]  # by dotted key, as `Scenario.updated` takes them
    works: bool  # whether the run then passes
    outcome: str  # of that run
    error: float  # that then remains [px]: the larger one of the last error and its RMS over the last fifth
    leg_travel: float  # then, of the leg that goes farthest [m]
    drift: float  # then, of the leg that moves fastest at the end [m/s]


@dataclass(frozen=True, eq=False)
class Finding:
    """One cause, with what speaks for it."""

    cause: str  # its key, such as "late_camera"; its page: docs/diagnosis/
    title: str
    score: float  # 0 to 1: how much of the failure it explains, less where another cause explains it better
    cure: float | None  # share of the severity that is gone without it; None: nothing could be run
    look: float | None  # how much the run looks like it, 0 to 1; None: it leaves no trace of its own
    evidence: tuple[str, ...]  # sentences with numbers
    without: Remedy | None  # the run without this cause; it may be more than one can have
    remedy: Remedy | None  # what helps; None for causes of little score


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Findings):
    """Whether a run failed, and why: causes with evidence and remedy, the likeliest one first."""

    result: Result
    failed: bool | None  # None: the run was interrupted
    criteria: tuple[str, ...]  # a sentence for each criterion, with what was and what is allowed
    causes: tuple[Finding, ...]  # ranked
    together: tuple[str, ...]  # keys of causes that have to go together, where the first one alone is not enough
    too_short: float | None  # a duration with which the run passes, where its error still falls at the end [s]
    warnings: tuple[str, ...]
    absent: tuple[str, ...]  # titles of causes that the scenario has nothing of, or that could not be tried
    _record: Record | None
    _judgement: Judgement | None
    _cured: Record | None  # the run without the first cause

    def section(self) -> Section:
        """Words first, then a table of the causes and the error over the time, with and without the first one."""
        if self._record is None or self._judgement is None:
            return Section("diagnosis", "Diagnosis", ["The run was interrupted: there is nothing to judge."])
        data = self.to_dict()
        if not self.failed:
            if not self.warnings:
                words = [f"Nothing to diagnose: {_joined(self.criteria)}."]
                return Section("diagnosis", "Diagnosis", words, (), "good", data)
            words = [f"The run passes. {self.warnings[0]}", *self.warnings[1:], f"In all: {_joined(self.criteria)}."]
            return Section("diagnosis", "Diagnosis", words, (), "warning", data)
        sentences = [self._verdict(), f"What failed: {_joined(self.criteria)}."]
        if self.causes and self.causes[0].score >= _LIKELY:
            sentences += self.causes[0].evidence[1:]
        sentences += [_remedy_sentence(finding) for finding in self.causes if finding.remedy is not None]
        return Section(
            "diagnosis", "Diagnosis", [*sentences, *self.warnings], (self._table(), *self._curves()), "bad", data
        )

    def sections(self) -> tuple[Section, ...]:
        """Give the one section that there is."""
        return (self.section(),)

    def to_dict(self) -> dict[str, Any]:
        """Give everything as strict JSON has it; SI units and pixels."""
        record, judgement = self._record, self._judgement
        if record is None or judgement is None:
            return {"failed": None, "outcome": self.result.outcome, "causes": []}
        robot = self.result.scenario.robot
        found: dict[str, Any] = as_data(
            {
                "failed": self.failed,
                "outcome": record.outcome,
                "end_time": record.end_time,
                "error": judgement.error * THRESHOLD,
                "error_allowed": THRESHOLD,
                "leg_travel": judgement.stroke * robot.stroke,
                "stroke": robot.stroke,
                "drift": record.drift,
                "drift_allowed": robot.stroke / DRIFT_TIME,
                "severity": judgement.severity,
                "causes": [_finding_data(finding) for finding in self.causes],
                "together": list(self.together),
                "too_short": self.too_short,
                "warnings": list(self.warnings),
                "absent": list(self.absent),
            }
        )
        return found

    def _verdict(self) -> str:
        together = _joined([_TITLES[key] for key in self.together])
        if self.too_short:
            return f"The run is too short: with simulation.duration={self.too_short:g} it passes."
        if not self.causes or self.causes[0].score < _LIKELY:
            if self.together:
                return f"No listed cause explains the failure by itself; it passes without these together: {together}."
            return "None of the listed causes explains the failure by itself."
        first = self.causes[0]
        if first.without is None:
            return (
                f"By its looks alone the likeliest cause is {first.title}: a controller of one's own is not run again."
            )
        assert self._judgement is not None
        assert self._record is not None
        after = first.without
        named = (
            f"The likeliest cause is {first.title}"
            if after.works or together
            else f"Of the listed causes {first.title} comes first, and is not all of it"
        )
        sentence = (
            f"{named}: with {after.words} the run {_how(after)}; as it was it "
            f"{_ends(self._record.outcome, self._judgement.error * THRESHOLD, self._leg_travel, self._record.drift)}."
        )
        return sentence + (f" It passes without these together: {together}." if together else "")

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
            Column("error that remains", "px"),
            Column("leg travel", "mm", ".3g"),
            Column("looks like it", format=".2f"),
        )
        rows: list[tuple[str | float | None, ...]] = [
            (
                "as it was",
                None,
                "",
                _spelt(self._record.outcome),
                self._judgement.error * THRESHOLD,
                1e3 * self._leg_travel,
                None,
            )
        ]
        for finding in self.causes:
            run = finding.without
            after: tuple[str, str, float | None, float | None] = ("", "", None, None)
            if run is not None:
                after = (run.words, _spelt(run.outcome), run.error, 1e3 * run.leg_travel)
            rows.append((finding.title, finding.score, *after, finding.look))
        note = f"Not tried, since the scenario has nothing of it: {', '.join(self.absent)}." if self.absent else ""
        return Table("Causes, each removed by itself", columns, rows, note, _PAGE)

    def _curves(self) -> tuple[Curves, ...]:
        assert self._record is not None
        lines = [Line("as it was", self._record.time, np.maximum(self._record.error, _FLOOR))]
        if self._cured is not None:
            name = f"without: {self.causes[0].title}"
            lines.append(Line(name, self._cured.time, np.maximum(self._cured.error, _FLOOR), "dashed"))
        title = "Largest feature error, with and without the likeliest cause"
        at_floor = any((line.y <= _FLOOR).any() for line in lines)
        note = f"Errors below {_FLOOR:g} px are drawn there." if at_floor else ""
        return (Curves(title, "time [s]", "error [px]", lines, y_log=True, note=note, page=_PAGE),)


def diagnose(result: Result) -> Diagnosis:
    """Name the likeliest causes of a run that failed, with evidence and remedies (docs/diagnosis/).

    A run fails that does not complete, that ends with more than 2 px left, whose legs leave their stroke, or whose legs
    still drift. For each cause that the scenario may have, the scenario is run again without it: how much of the
    failure that takes away, and whether the run looks like the cause, gives the ranking. Nothing is proved: a cause is
    what a change of it alone cures. Takes about a fifth of a second for a run of 2000 steps, in proportion to them.

    Parameters
    ----------
    result
        Of `simulate`. Of a run with a controller of one's own only the looks are judged.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, also while something runs.
    TypeError
        For anything but a `Result`.
    """
    if not isinstance(result, Result):
        raise TypeError(f"result: expected a Result (see hs.simulate), got {type(result).__name__}")
    if result.outcome == "interrupted":
        return Diagnosis(result, None, (), (), (), None, (), (), None, None, None)
    record = record_of(result)
    before = judged(result.scenario, record)
    warnings = _warnings(result, before)
    if not before.failed:
        return Diagnosis(
            result, False, _margins(result, record, before), (), (), None, warnings, (), record, before, None
        )
    case = Case(result.scenario, goal_of(run_all([goal_run(result.scenario)])[0]))
    criteria = _misses(result, record, before)
    if result.controller != result.scenario.controller.law:
        findings, absent = _by_looks(case, record, before)
        return Diagnosis(result, True, criteria, findings, (), None, warnings, absent, record, before, None)
    tried = try_removals([case])[0]
    trials = rank(case, record, before, tried)
    if _ends_otherwise(case, before, tried):
        warnings += ("Repeated, the run ends otherwise: rounding decides, and the numbers may be off.",)
    remedies = _remedies(case, trials)
    findings = tuple(_finding(case, trial, remedies.get(trial.cause.key)) for trial in trials)
    present = {finding.cause for finding in findings}
    return Diagnosis(
        result,
        True,
        criteria,
        findings,
        _together(case, trials),
        _too_short(case, record, before),
        warnings,
        tuple(cause.title for cause in CAUSES if cause.key not in present),
        record,
        before,
        trials[0].record if trials and trials[0].score >= _LIKELY else None,
    )


# ---- Parts of it ----------------------------------------------------------------------------------------------------


def _ends_otherwise(case: Case, before: Judgement, tried: Sequence[tuple[Cause, Removal, Record]]) -> bool:
    """Whether the run, repeated as it was, fails by much more or less."""
    if case.scenario.robot.on_limit == "report":  # then the stroke does not act, and the run without it is the same
        repeated = next((record for cause, _, record in tried if cause.key == "leg_limits"), None)
    else:
        repeated = run_all([Run(case.scenario)])[0]
    return repeated is not None and abs(judged(case.scenario, repeated).severity - before.severity) > _OTHERWISE


def _remedies(case: Case, trials: list[Trial]) -> dict[str, Remedy]:
    """Run what may help against the likeliest causes, and keep for each the first that works, or the best."""
    likely = [trial for trial in trials if trial.score >= _LIKELY][:_REMEDIES]
    offered = [
        (trial, remedy) for trial in likely for remedy in trial.cause.remedies(case, trial.removal, trial.record)
    ]
    new = [remedy for trial, remedy in offered if remedy is not trial.removal]
    found = iter(run_all([Run(case.scenario, remedy.changes) for remedy in new]))
    best: dict[str, tuple[float, Remedy]] = {}
    for trial, remedy in offered:
        record = trial.record if remedy is trial.removal else next(found)
        if record is None:
            continue
        after = judged(case.scenario, record, remedy)
        severity = after.severity if after.failed else 0.0
        key = trial.cause.key
        if key not in best or severity < best[key][0]:
            best[key] = (severity, _as_remedy(remedy, record, after))
    return {key: remedy for key, (_, remedy) in best.items()}


def _as_remedy(removal: Removal, record: Record, after: Judgement) -> Remedy:
    return Remedy(
        removal.words,
        dict(removal.changes),
        not after.failed,
        record.outcome,
        after.error * THRESHOLD,
        record.metrics["peak_leg_excursion"],
        record.drift,
    )


def _finding(case: Case, trial: Trial, remedy: Remedy | None) -> Finding:
    without = _as_remedy(trial.removal, trial.record, trial.judgement)
    evidence = [f"With {without.words} the run {_how(without)}; {trial.cure:.0%} of the failure is gone."]
    if trial.signature.sentence:
        evidence.append(trial.signature.sentence)
    return Finding(
        trial.cause.key,
        trial.cause.title,
        trial.score,
        trial.cure,
        trial.signature.strength,
        tuple(evidence),
        without,
        remedy,
    )


def _by_looks(case: Case, record: Record, before: Judgement) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """Judge by looks alone: a controller of one's own is not run again, since it may keep a state."""
    findings, absent = [], []
    for cause in CAUSES:
        signature = SIGNATURES[cause.key](case, record, before)
        if cause.key in _OF_THE_LAW or not cause.removals(case) or signature.strength is None:
            absent.append(cause.title)
            continue
        evidence = (signature.sentence,) if signature.sentence else ()
        strength = signature.strength
        findings.append(Finding(cause.key, cause.title, strength, None, strength, evidence, None, None))
    return tuple(sorted(findings, key=lambda finding: -finding.score)), tuple(absent)


def _together(case: Case, trials: list[Trial]) -> tuple[str, ...]:
    """Remove two causes at once where no removal alone leads to a pass; () where no pair does."""
    if not all(trial.judgement.failed for trial in trials):
        return ()
    pairs = [
        (one, other)
        for number, one in enumerate(trials)
        for other in trials[number + 1 :]
        if not one.removal.changes.keys() & other.removal.changes.keys()
    ]
    joint = [
        Removal(
            "",
            {**one.removal.changes, **other.removal.changes},
            one.removal.stroke_counts and other.removal.stroke_counts,
        )
        for one, other in pairs
    ]
    records = run_all([Run(case.scenario, removal.changes) for removal in joint])
    passing = [
        (one.score + other.score, one.cause.key, other.cause.key)
        for (one, other), removal, record in zip(pairs, joint, records, strict=True)
        if record is not None and not judged(case.scenario, record, removal).failed
    ]
    return max(passing, key=lambda pair: pair[0])[1:] if passing else ()


def _too_short(case: Case, record: Record, before: Judgement) -> float | None:
    """Run longer where the error still falls at the end."""
    simulation = case.scenario.simulation
    earlier = record.error[record.time <= _EARLIER * record.end_time]
    brief = simulation.duration < _FEW * simulation.step  # too few steps to tell whether it falls
    if before.early or not (brief or (len(earlier) and record.error[-1] <= _FALLS * earlier[-1])):
        return None
    duration = _ENOUGH * simulation.step if brief else _LONGER * simulation.duration
    longer = run_all([Run(case.scenario, {"simulation.duration": duration})])[0]
    robot = case.scenario.robot
    return None if longer is None or judge(longer, robot.stroke, duration).failed else duration


# ---- Words ----------------------------------------------------------------------------------------------------------


def _how(run: Remedy) -> str:
    return f"{'passes' if run.works else 'still fails'}: it {_ends(run.outcome, run.error, run.leg_travel, run.drift)}"


def _spelt(outcome: str) -> str:
    return outcome.replace("_", " ")


def _ends(outcome: str, error: float, leg_travel: float, drift: float) -> str:
    if outcome != "completed":
        return f"ends early ({_spelt(outcome)})"
    words = f"ends with {number(error)} px left and {number(leg_travel * 1e3)} mm of leg travel"
    return words + (f", and still drifts at {number(drift * 1e3, 2)} mm/s" if drift > _SHOWN_DRIFT else "")


def _misses(result: Result, record: Record, judgement: Judgement) -> tuple[str, ...]:
    """Give a clause for each criterion that was missed."""
    if judgement.early:
        return (result.detail.rstrip("."),)
    stroke = result.scenario.robot.stroke
    allowed = stroke / DRIFT_TIME * 1e3
    clauses = {
        f"{number(judgement.error * THRESHOLD)} px are left at the end, above {THRESHOLD:g} px": judgement.error,
        f"a leg goes {number(judgement.stroke * stroke * 1e3)} mm, beyond its stroke of {number(stroke * 1e3)} mm": (
            judgement.stroke
        ),
        f"a leg still moves at {number(record.drift * 1e3, 2)} mm/s at the end, above {allowed:.2g} mm/s": (
            judgement.drift
        ),
    }
    return tuple(clause for clause, ratio in clauses.items() if ratio > 1.0)


def _margins(result: Result, record: Record, judgement: Judgement) -> tuple[str, ...]:
    stroke = result.scenario.robot.stroke
    allowed = stroke / DRIFT_TIME * 1e3
    return (
        f"{number(judgement.error * THRESHOLD)} px are left of the {THRESHOLD:g} px that are allowed",
        f"the legs use {judgement.stroke:.0%} of their stroke of {number(stroke * 1e3, 4)} mm",
        f"they drift at {number(record.drift * 1e3, 2)} mm/s of the {allowed:.2g} mm/s that are allowed",
    )


def _warnings(result: Result, judgement: Judgement) -> tuple[str, ...]:
    """Say what is near its limit, what the run passed without being stopped by it, and what its log cannot show."""
    found = []
    if len(result.time) < _FEW:
        found.append(f"The run logged {len(result.time)} samples: too few to tell a drift or a swing.")
    if not judgement.failed:
        for what, ratio in (
            ("the error that remains", judgement.error),
            ("the travel of the legs", judgement.stroke),
            ("the drift of the legs", judgement.drift),
        ):
            if ratio > _NEAR:
                found.append(f"Near failing: {what} is {ratio:.0%} of what is allowed.")
    for event in result.events:
        if event.kind == "force" and not judgement.failed:  # of a failed run it is a symptom
            found.append(
                f"At t = {event.time:.3g} s leg {event.leg} asks more than its force limit, which nothing enforces."
            )
            break
    return tuple(found)


def _remedy_sentence(finding: Finding) -> str:
    remedy = finding.remedy
    assert remedy is not None
    keys = ", ".join(f"{key}={_value(value)}" for key, value in remedy.changes.items())
    how = _how(remedy)
    if finding.without is not None and remedy.changes == finding.without.changes:
        return f"Against {finding.title}: {remedy.words} ({keys}); that run {how}."
    return f"Against {finding.title}: {remedy.words} ({keys}). Tried: the run {how}."


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else "null" if value is None else str(value)


def _joined(parts: Sequence[str]) -> str:
    return "; ".join(parts)


def _finding_data(finding: Finding) -> dict[str, Any]:
    return {
        "cause": finding.cause,
        "title": finding.title,
        "score": finding.score,
        "cure": finding.cure,
        "look": finding.look,
        "evidence": list(finding.evidence),
        "without": None if finding.without is None else vars(finding.without),
        "remedy": None if finding.remedy is None else vars(finding.remedy),
    }
