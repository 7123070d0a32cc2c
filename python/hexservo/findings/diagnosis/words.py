"""Sentences of a diagnosis."""

from __future__ import annotations

import math
from typing import Any

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.diagnosis.criterion import DRIFT_TIME, Judgement, Record
from hexservo.findings.diagnosis.findings import Finding, Remedy
from hexservo.findings.diagnosis.growth import growth_time
from hexservo.run.leg_limits import LimitUse, limits_of_motion
from hexservo.run.result import Result
from hexservo.run.summary import image_sentences
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import apart, number, percent_used

FEW = 40  # samples, or steps
_NEAR = 0.7  # share of a limit beyond which there is a warning
_SHOWN_DRIFT = 0.2  # of the drift that is allowed: a slower one is not reported


def how(run: Remedy, scenario: Scenario) -> str:
    """Return the outcome of a run as a clause."""
    ending = ends(run.outcome, run.error, run.leg_travel, run.drift, scenario)
    longer = "" if math.isnan(run.grows_in) else f"; in a longer one {_growth(run.grows_in)}"
    return f"{'passes' if run.works else 'still fails'}: it {ending}{longer}"


def _growth(time: float) -> str:
    cause = "by unequal depth errors (the part drift of hexservo analyse)"
    return f"the pose error grows e-fold in {number(time)} s {cause}"


def spelt(outcome: str) -> str:
    """Spell out an outcome."""
    return outcome.replace("_", " ")


def ends(outcome: str, error: float, leg_travel: float, drift: float, scenario: Scenario) -> str:
    """Return how a run ended; the error is the largest one within the dwell time before the end [px]."""
    if outcome != "completed":
        return f"ends early ({spelt(outcome)})"
    robot = scenario.robot
    unit, shown = leg_units(robot).small, _SHOWN_DRIFT * robot.stroke / DRIFT_TIME
    words = (
        f"has up to {number(error)} px in its last {number(scenario.metrics.dwell)} s "
        f"and {number(leg_travel * 1e3)} {unit} of leg travel"
    )
    return words + (f", and still drifts at {number(drift * 1e3, 2)} {unit}/s" if drift > shown else "")


def misses(result: Result, record: Record, judgement: Judgement) -> tuple[str, ...]:
    """Return a clause for each criterion that was not met."""
    if judgement.early:
        return (result.detail.rstrip("."),)
    stroke, unit = result.scenario.robot.stroke, leg_units(result.scenario.robot).small
    travel, most_travel = apart(judgement.stroke * stroke * 1e3, stroke * 1e3, 3)
    drift, most_drift = apart(record.drift * 1e3, stroke / DRIFT_TIME * 1e3, 2)
    clauses = {_not_settled(result, judgement): 0.0 if judgement.settled else judgement.error}
    clauses |= {
        f"a leg goes {travel} {unit}, beyond its stroke of {most_travel} {unit}": judgement.stroke,
        f"a leg still moves at {drift} {unit}/s at the end, above {most_drift} {unit}/s": judgement.drift,
    }
    clauses |= {use.excess: use.share for use in _uses(result, judgement)}
    return tuple(clause for clause, ratio in clauses.items() if ratio > 1.0)


def _uses(result: Result, judgement: Judgement) -> list[LimitUse]:
    """Return how much of the speed and joint limits a run uses."""
    limits = (limit for limit in limits_of_motion(result.scenario) if limit.metric in judgement.limits)
    return [LimitUse(limit, judgement.limits[limit.metric] * limit.value) for limit in limits]


def _not_settled(result: Result, judgement: Judgement) -> str:
    metrics = result.scenario.metrics
    if metrics.dwell > result.scenario.simulation.duration:
        run, dwell = apart(result.scenario.simulation.duration, metrics.dwell, 3)
        return f"not settled: the run of {run} s is shorter than the dwell time of {dwell} s"
    error, band = apart(judgement.error * metrics.band, metrics.band, 3)
    return f"not settled: {error} px in the last {number(metrics.dwell)} s, outside the band of {band} px"


def criteria_met(result: Result, record: Record, judgement: Judgement) -> tuple[str, ...]:
    """Return a clause per criterion of a run that passes, with its margin."""
    metrics, stroke = result.scenario.metrics, result.scenario.robot.stroke
    unit = leg_units(result.scenario.robot).small
    allowed = stroke / DRIFT_TIME * 1e3
    drift = f"they drift at {number(record.drift * 1e3, 2)} {unit}/s, where {allowed:.2g} {unit}/s are allowed"
    return (
        f"it is settled, with {number(judgement.error * metrics.band)} px of the band of {number(metrics.band)} px "
        f"in the last {number(metrics.dwell)} s",
        f"the legs use {percent_used(judgement.stroke)} of their stroke of {number(stroke * 1e3, 4)} {unit}",
        *([drift] if len(result.time) >= FEW else []),
        *(
            f"the largest {use.limit.of_leg} is {percent_used(use.share)} of its limit"
            for use in _uses(result, judgement)
        ),
    )


def warnings_of(result: Result, judgement: Judgement) -> tuple[str, ...]:
    """Return warnings: quantities near their limits, limits passed without a stop, and what a thin log hides."""
    found = []
    if len(result.time) < FEW:
        logged = f"{len(result.time)} samples" if len(result.time) > 1 else "1 sample"
        found.append(f"The run logged {logged}: too few to see a drift or an oscillation.")
    if not judgement.failed:
        error, band = scene_of(result.scenario).settled_start, result.scenario.metrics.band
        if error is not None:
            found.append(
                f"It starts within the settling band, {number(error)} px of {number(band)} px from the goal, and so "
                "passes without a motion: a narrower metrics.band shows whether the law gets there."
            )
        for what, ratio in (
            ("the error in the dwell time", judgement.error),
            ("the travel of the legs", judgement.stroke),
            ("the drift of the legs", judgement.drift),
            *((f"the {use.limit.of_leg}", use.share) for use in _uses(result, judgement)),
        ):
            if ratio > _NEAR:
                found.append(f"Near failing: {what} is {percent_used(ratio)} of what is allowed.")
        if result.by_law and not math.isnan(time := growth_time(result.scenario)):
            found.append(f"In a longer run {_growth(time)}.")
        found += image_sentences(result)
    for event in result.events:
        if event.kind == "force" and not judgement.failed:  # of a failed run it is a symptom
            found.append(
                f"At t = {event.time:.3g} s leg {event.leg} needs more than its force limit, which is not enforced."
            )
            break
    return tuple(found)


def remedy_sentence(finding: Finding, scenario: Scenario) -> str:
    """Return the remedy against a cause, and the outcome of the run with it."""
    remedy = finding.remedy
    assert remedy is not None
    keys = ", ".join(f"{key}={_value(value)}" for key, value in remedy.changes.items())
    outcome = how(remedy, scenario)
    if finding.without is not None and remedy.changes == finding.without.changes:
        return f"Against {finding.title}: {remedy.words} ({keys}); that run {outcome}."
    return f"Against {finding.title}: {remedy.words} ({keys}). Tried: the run {outcome}."


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else "null" if value is None else str(value)
