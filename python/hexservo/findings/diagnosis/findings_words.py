"""A diagnosis as sentences, a table and curves (docs/diagnosis/ranking.md)."""

from __future__ import annotations

import numpy as np

from hexservo.findings.diagnosis.causes import CAUSES
from hexservo.findings.diagnosis.environment import faultless
from hexservo.findings.diagnosis.findings import Diagnosis
from hexservo.findings.diagnosis.goal import Obstacle
from hexservo.findings.diagnosis.words import ends, how, remedy_sentence, spelt
from hexservo.findings.evidence import Column, Curves, Line, Section, Table
from hexservo.scenario.blocks import Robot
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.wording import above, first_of, number

_PAGE = "docs/diagnosis/ranking.md"
_TITLES = {cause.key: cause.title for cause in CAUSES}
_FLOOR = 1e-3  # [px], of the curves
_WEAK = 0.3  # score up to which recorded signals speak for no cause
_AT_REST = 1e-3  # of the stroke, that legs move which do not act
_KEYS = 6  # most keys that are named which differ from a scenario without faults
_HELPERS = 3  # most removals that are named which help and are not the cause
_NOT_NAMED = {  # fails alone -> why a removal that helps is not named as the cause
    False: "that helps, but it is not the cause: it is ordinary, or alone it makes no scenario without other faults "
    "fail.",
    True: "alone it makes a scenario without other faults fail too, but it is not named: its settings are ordinary, "
    "small random changes cure the run as well, the law passes with other settings, or the run has not come to rest.",
    None: "that helps, but it could not be tested alone: the scenario without any fault, for a setting of the law "
    "with default gains, fails as well.",
}


def section(found: Diagnosis) -> Section:
    """Return sentences, a table of the causes, and the error over time with and without the first cause."""
    if found.record is None or found.judgement is None:
        return Section("diagnosis", "Diagnosis", ["The run was interrupted: there is no diagnosis."])
    data = found.numbers()
    if not found.failed:
        if not found.warnings:
            words = [f"Nothing to diagnose: {'; '.join(found.criteria)}."]
            return Section("diagnosis", "Diagnosis", words, (), "good", data)
        words = [f"The run passes. {found.warnings[0]}", *found.warnings[1:], f"Criteria: {'; '.join(found.criteria)}."]
        return Section("diagnosis", "Diagnosis", words, (), "warning", data)
    sentences = [_verdict(found), f"What failed: {'; '.join(found.criteria)}."]
    if found.named:
        sentences += found.named[0].evidence[1:]
    sentences += [*_sureness(found), *_left(found)]
    sentences += [
        remedy_sentence(finding, found.result.scenario) for finding in found.causes if finding.remedy is not None
    ]
    return Section(
        "diagnosis", "Diagnosis", [*sentences, *found.warnings], (_table(found), *_curves(found)), "bad", data
    )


def _verdict(found: Diagnosis) -> str:
    assert found.judgement is not None
    assert found.record is not None
    scenario, robot = found.result.scenario, _robot(found)
    was = ends(found.record.outcome, found.judgement.error * found.band, found.leg_travel, found.record.drift, scenario)
    first = found.causes[0] if found.causes else None
    if found.obstacle is not None:
        return _of_obstacle(found.obstacle)
    if first is not None and first.named and first.without is not None:
        if found.too_short:
            return f"The run is too short: with simulation.duration={found.too_short:g} it passes."
        return (
            f"The most likely cause is {first.title}: with {first.without.words} the run "
            f"{how(first.without, scenario)}; the original run {was}."
        )
    if not found.result.by_law:
        if first is None or first.score <= _WEAK:
            travel = float(np.ptp(found.record.samples["leg_lengths"], axis=0).max())
            still = travel <= _AT_REST * robot.stroke
            more = (
                f" Its legs move by {number(1e3 * travel)} {_unit(found)}: the platform stays where it starts."
                if still
                else ""
            )
            return (
                f"Not explained: it {was}, and the recorded signals fit no cause; a custom controller is not run again."
                f"{more}"
            )
        return (
            f"From the recorded signals alone the most likely cause is {first.title}: a custom controller is not "
            "run again."
        )
    if found.together:
        return _of_two(found, was)
    later = found.settles_later
    if later is not None:
        return (
            f"The run is too short: it {was}; with simulation.duration={found.too_short:g} and no other change it is "
            f"settled after t = {above(later.settling_time)} s. No other cause that was tried explains it."
        )
    words = f"Not explained: it {was}, and none of the {len(found.causes)} causes that were tried explains it."
    if first is not None and first.without is not None and first.cure:
        words += f" The most effective change was {first.without.words}: the run then {how(first.without, scenario)}."
    return words


def _of_two(found: Diagnosis, was: str) -> str:
    """Return the verdict on two causes: what is known of each alone depends on whether the run passes without it."""
    both = "; ".join(_TITLES[key] for key in found.together)
    words = f"Not explained by one cause: two make it fail together, {both}; the original run {was}. "
    if not found.passes_without_either:
        return f"{words}It passes only without both. Without other faults both together fail as well."
    alone = ", and neither does alone" if all(finding.alone is False for finding in found.pair) else ""
    return f"{words}It passes without either of them. Without other faults both together fail as well{alone}."


def _left(found: Diagnosis) -> list[str]:
    """Return what was looked at, and what is left, where nothing explains the failure."""
    if found.named or found.together or found.obstacle is not None or not found.result.by_law or found.too_short:
        return []
    tried = "; ".join([finding.title for finding in found.causes])
    words = [f"Removed one at a time, and in pairs of those whose settings are unusual: {tried}."]
    if found.faultless is None:
        return words
    if not found.faultless:
        return [
            *words,
            "With devices without faults and default gains, all at once, the run fails as well. What is left is the "
            "task (start, goal, metrics.band, simulation.duration and the legs), or gains that do not suit it: fit "
            "them by auto.bandwidth.",
        ]
    keys = sorted(faultless(found.result.scenario))
    return [
        *words,
        "With devices without faults and default gains, all at once, the run passes. What is left are causes of which "
        f"more than two act together: from that run change back one key at a time, of {first_of(keys, _KEYS)}.",
    ]


def _unit(found: Diagnosis) -> str:
    """Return the unit of leg travel in sentences: mm, or mrad of cranks."""
    return leg_units(_robot(found)).small


def _robot(found: Diagnosis) -> Robot:
    return found.result.scenario.robot


def _of_obstacle(obstacle: Obstacle) -> str:
    if obstacle.kind == "image":
        return (
            f"The goal cannot be reached: no pose was found whose image is the goal; the best one leaves "
            f"{number(obstacle.residual)} px."
        )
    if obstacle.kind == "start":
        return f"The start is out of reach: {obstacle.beyond}; nothing else matters until that is changed."
    return (
        f"The goal cannot be reached: at the nearest pose with that image {obstacle.beyond}; nothing else matters "
        "until that is changed."
    )


def _sureness(found: Diagnosis) -> list[str]:
    """Return the evidence against the verdict: other changes that cure the run as well."""
    words = []
    passing = sum(found.controls)
    if passing:
        words.append(
            f"Near the limit: with other seeds, or numbers changed randomly by 5 %, the run passes {passing} of "
            f"{len(found.controls)} times, so the cause is less certain."
        )
    if found.obstacle is None:
        others = [f for f in found.causes if not f.named and f.cause not in found.together]
        later = found.settles_later
        if later is not None:
            others = [f for f in others if f.cause != "duration"]
            if found.too_short is None:
                words.append(
                    f"It is also too short for that: with simulation.duration={later.changes['simulation.duration']:g} "
                    f"and no other change it is settled after t = {above(later.settling_time)} s."
                )
        helpers = [(f.alone, f.without.words) for f in others if f.without and f.without.works]
        for alone, meaning in _NOT_NAMED.items():
            removals = [removal for one, removal in helpers if one is alone]
            more = f", and {len(removals) - _HELPERS} others" if len(removals) > _HELPERS else ""
            if removals:
                words.append(f"The run also passes with {'; with '.join(removals[:_HELPERS])}{more}: {meaning}")
    also = [finding.title for finding in found.named[1:]]
    if also:
        words.append(f"Equally likely: {'; '.join(also)}; each was removed alone.")
    return words


def _table(found: Diagnosis) -> Table:
    assert found.record is not None
    assert found.judgement is not None
    columns = (
        Column("cause"),
        Column("score", format=".2f"),
        Column("what was changed"),
        Column("outcome"),
        Column(f"largest error in the last {number(found.result.scenario.metrics.dwell)} s", "px"),
        Column("leg travel", _unit(found), ".3g"),
        Column("fails alone"),
    )
    rows: list[tuple[str | float | None, ...]] = [
        (
            "original run",
            None,
            "",
            spelt(found.record.outcome),
            found.judgement.error * found.band,
            1e3 * found.leg_travel,
            "",
        )
    ]
    for finding in found.causes:
        run = finding.without
        after: tuple[str, str, float | None, float | None] = ("", "", None, None)
        alone = {True: "yes", False: "no", None: ""}[finding.alone]
        if run is not None:
            alone = "not known" if run.works and finding.alone is None else alone
            after = (run.words, spelt(run.outcome), run.error, 1e3 * run.leg_travel)
        rows.append((finding.title, finding.score, *after, alone))
    note = f"Not present in this scenario, or not tried: {', '.join(found.absent)}." if found.absent else ""
    return Table("Causes, each removed alone", columns, rows, note, _PAGE)


def _curves(found: Diagnosis) -> tuple[Curves, ...]:
    assert found.record is not None
    lines = [Line("original run", found.record.time, np.maximum(found.record.error, _FLOOR))]
    if found.cured is not None:
        name = f"without: {found.causes[0].title}"
        lines.append(Line(name, found.cured.time, np.maximum(found.cured.error, _FLOOR), "dashed"))
    title = "Largest feature error, with and without the most likely cause"
    at_floor = any((line.y <= _FLOOR).any() for line in lines)
    note = f"Errors below {_FLOOR:g} px are drawn there." if at_floor else ""
    return (Curves(title, "time [s]", "error [px]", lines, y_log=True, note=note, page=_PAGE),)
