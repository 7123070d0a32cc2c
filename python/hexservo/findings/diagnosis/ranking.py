"""Ranking of the causes from runs without each cause, and with each cause alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexservo.findings.diagnosis.causes import CAUSES
from hexservo.findings.diagnosis.criterion import Allowed, Judgement, Record, judge
from hexservo.findings.diagnosis.environment import (
    IMAGE_ALONE,
    ORDINARY_DEPTH,
    ORDINARY_WEIGHT,
    alone_pairs,
    both_alone,
    ideal,
    known,
    ordinary_base,
    unusual,
)
from hexservo.findings.diagnosis.goal import goal_of, obstacle_of
from hexservo.findings.diagnosis.model import Case, Cause, Removal, in_scenario
from hexservo.findings.diagnosis.runs import Run, run_all
from hexservo.scenario.fitted import idle_gains
from hexservo.scenario.noise import is_random
from hexservo.scenario.scenario import Scenario

_NOT_ALONE = 0.25  # factor of the score for a cause that makes no run fail alone
_USUAL = 0.15  # the same if no setting of the cause is unusual
_ORDINARY = 0.1  # the same for a device that is no worse than ordinary
_CHANCE = 0.5  # share by which the score falls if every control passes
_SIZE = 0.05  # of the random change of a control, relative
_SEEDS = 2  # other seeds that are tried, and random changes
_PAIRED = 5  # causes that are removed two at a time
_OF_SPEED = ("gains_high", "gains_low", "coarse_step")  # settings of a law that change how fast it moves
_PAIRED_TASKS = frozenset({"band", "duration", "leg_limits"})  # what a task may require too much of, beside a fault


@dataclass(frozen=True, eq=False)
class Trial:
    """A cause with its most effective removal."""

    cause: Cause
    removal: Removal
    record: Record
    judgement: Judgement
    cure: float  # share of the severity that the removal cures, 0 to 1
    # whether it makes an otherwise ideal scenario fail; None: not tried, since its removal does not cure, or not known,
    # since that scenario fails without it too
    alone: bool | None
    score: float  # 0 to 1
    named: bool  # as the cause


@dataclass(frozen=True, eq=False)
class Study:
    """The runs for one case, evaluated."""

    case: Case
    before: Judgement
    best: Mapping[str, Trial]  # by the cause's key, without a score yet
    controls: tuple[bool, ...]  # whether the run passes with other seeds and with small random changes


def make_cases(scenarios: Sequence[Scenario]) -> list[Case]:
    """Find the goals of scenarios, and whether they can be reached."""
    goals = [goal_of(scenario) for scenario in scenarios]
    return [Case(scenario, goal, obstacle_of(scenario, goal)) for scenario, goal in zip(scenarios, goals, strict=True)]


def judged(
    scenario: Scenario, record: Record, removal: Removal | None = None, before: Judgement | None = None
) -> Judgement:
    """Evaluate a run of a scenario, with changes or without, compared with the run before them if there is one."""
    changes = {} if removal is None else removal.changes
    free = removal is not None and not removal.stroke_counts
    stroke = scenario.robot.stroke if free else changes.get("robot.stroke", scenario.robot.stroke)
    speed = changes.get("robot.speed_limit", scenario.robot.speed_limit)
    joints = changes.get("robot.joint_limit", scenario.robot.joint_limit) or (None, None)
    limits = dict(zip(("peak_leg_speed", "peak_base_joint", "peak_platform_joint"), (speed, *joints), strict=True))
    allowed = Allowed(
        float(changes.get("metrics.band", scenario.metrics.band)),
        float(changes.get("metrics.dwell", scenario.metrics.dwell)),
        float(stroke),
        float(changes.get("simulation.duration", scenario.simulation.duration)),
        stroke_counts=not free,
        limits={metric: float(limit) for metric, limit in limits.items() if limit is not None},
    )
    return judge(record, allowed, None if before is None else before.cured)


def study(cases: Sequence[Case], before: Sequence[Judgement], threads: int = 1) -> list[Study]:
    """Run every removal of every cause, the controls, and each cause that cures alone in a scenario without faults."""
    tried = [(cause, removal) for case in cases for cause in CAUSES for removal in cause.removals(case)]
    counts = [sum(len(cause.removals(case)) for cause in CAUSES) for case in cases]
    own_controls = [controls(case) for case in cases]
    runs = [
        Run(case.scenario, removal.changes)
        for case, own in zip(cases, _split(tried, counts), strict=True)
        for _, removal in own
    ]
    beside = [Run(case.scenario, changes) for case, own in zip(cases, own_controls, strict=True) for changes in own]
    records = run_all([*runs, *beside], threads)
    passed = iter(records[len(runs) :])
    studies = []
    rows = zip(cases, before, _split(tried, counts), _split(records[: len(runs)], counts), own_controls, strict=True)
    for case, judgement, removals, found, own in rows:
        best: dict[str, Trial] = {}
        for (cause, removal), record in zip(removals, found, strict=True):
            if record is None:
                continue
            after = judged(case.scenario, record, removal, judgement)
            cure = max(0.0, 1.0 - after.severity / judgement.severity)
            rival = best.get(cause.key)
            if rival is None or (not after.failed, cure) > (not rival.judgement.failed, rival.cure):
                best[cause.key] = Trial(cause, removal, record, after, cure, None, 0.0, False)
        outcomes = tuple(
            record is not None and not judged(case.scenario, record).failed for record in (next(passed) for _ in own)
        )
        studies.append(Study(case, judgement, best, outcomes))
    return _each_alone(studies, threads)


def _each_alone(studies: Sequence[Study], threads: int, *, cures: bool = True) -> list[Study]:
    """Check for each cause whose removal cures, or does not, whether it alone makes a run fail.

    A pair whose first scenario fails, or one of which is refused, proves nothing about the cause, unless the pair is
    there to show that it fails without it (`Alone.first_decides`). A cause no worse than ordinary is no fault.
    """
    places = []
    runs: dict[tuple[int, str, bool], Run] = {}
    for number, one in enumerate(studies):
        scenario = one.case.scenario
        for key, trial in one.best.items():
            if trial.judgement.failed is cures:
                continue
            for pair in alone_pairs(trial.cause, one.case, trial.removal):
                without = Removal("", pair.without, pair.stroke_counts)
                alone = Removal("", pair.alone)
                places.append((number, key, without, alone, pair))
                for removal in (without, alone):
                    runs[number, known(removal.changes), removal.stroke_counts] = Run(scenario, removal.changes)
    records = dict(zip(runs, run_all(list(runs.values()), threads), strict=True))

    def fails(number: int, removal: Removal) -> bool | None:
        record = records[number, known(removal.changes), removal.stroke_counts]
        return None if record is None else judged(studies[number].case.scenario, record, removal).failed

    verdicts: dict[tuple[int, str], bool] = {}
    for number, key, without, alone, pair in places:
        if pair.otherwise and (number, key) in verdicts:
            continue
        same = without.stroke_counts and known(without.changes) == known(alone.changes)
        passes = fails(number, without) is False
        outcome = fails(number, alone) if passes else False if same or pair.first_decides else None
        if outcome is not None:
            verdicts[number, key] = verdicts.get((number, key), True) and outcome
    return [
        replace(
            one,
            best={key: replace(trial, alone=verdicts.get((number, key))) for key, trial in one.best.items()},
        )
        for number, one in enumerate(studies)
    ]


def rank(one: Study, withheld: str = "") -> list[Trial]:
    """Rank the causes of a run that failed, the most likely one first; `withheld` is left out of the list.

    A cause is named if its removal cures the run, if it alone makes an otherwise ideal scenario fail, and if small
    random changes do not cure the run as well. A start or goal that cannot be reached is always the cause named.
    """
    obstacle = one.case.obstacle
    goal_cause = "" if obstacle is None else "impossible_goal" if obstacle.kind == "image" else "leg_limits"
    chance = float(np.mean(one.controls)) if one.controls else 0.0
    harmless, odd = _ordinary_devices(one.case), _unusual_causes(one.case)
    trials = []
    for key, trial in one.best.items():
        if key == withheld:
            continue
        is_one = bool(trial.alone) and key not in harmless
        if key == "false_equilibrium" and (_gets_there(one, withheld) or not _is_elsewhere(one)):
            is_one = False
        share = 1.0 if is_one else _ORDINARY if key in harmless else _NOT_ALONE if key in odd else _USUAL
        score = trial.cure * share * (1.0 - _CHANCE * chance)
        named = is_one and chance < 0.5
        if goal_cause in one.best and goal_cause != withheld:
            named = key == goal_cause
            score = 1.0 if named else _NOT_ALONE * trial.cure
        trials.append(replace(trial, score=score, named=named))
    return sorted(trials, key=lambda trial: (not trial.named, -trial.score))  # stable: ties keep the order of CAUSES


def pairs(one: Study, trials: Sequence[Trial], threads: int = 1) -> tuple[str, ...]:
    """Search for two causes that make the run fail together, where no single cause is named; () for none.

    The run passes without both, or without either of them, and both together, without other faults, make a scenario
    fail, with ordinary settings of the law and with its own. Where it passes only without both, a band, a duration or
    limits of the legs have to make a scenario without other faults fail by themselves: without them much else would
    pass. The most likely pair is returned.
    """
    if one.case.obstacle is not None or any(trial.named for trial in trials):
        return ()
    scenario, odd = one.case.scenario, _unusual_causes(one.case)
    faults = sorted(
        (trial for trial in trials if trial.cause.kind != "task" and trial.cause.key in odd),
        key=lambda trial: -trial.cure,
    )
    tasks = {trial.cause.key: trial for trial in trials if trial.cause.key in _PAIRED_TASKS}
    unmet = {key: trial for key, trial in tasks.items() if trial.judgement.failed}
    alone = _each_alone([replace(one, best=unmet)], threads, cures=False)[0].best.values()
    likely = [trial for trial in faults if trial.judgement.failed][:_PAIRED]
    likely += [trial for trial in alone if trial.alone]
    curing = [trial for trial in faults if not trial.judgement.failed][:_PAIRED]
    curing += [trial for key, trial in tasks.items() if key in odd and key not in unmet]
    joint = [
        (first, second)
        for group in (likely, curing)
        for number, first in enumerate(group)
        for second in group[number + 1 :]
        if not first.removal.changes.keys() & second.removal.changes.keys()
    ]
    runs: list[Removal] = []
    counts = []
    for first, second in joint:
        both = {**first.removal.changes, **second.removal.changes}
        counted = first.removal.stroke_counts and second.removal.stroke_counts
        without, *alone_together = both_alone(first.cause, second.cause, one.case, both)
        for trial in (first, second):
            without = {**without, **(trial.removal.changes if trial.cause.kind == "task" else {})}
        runs += [Removal("", both, counted), Removal("", without, counted)]
        runs += [Removal("", changes) for changes in alone_together]
        counts.append(2 + len(alone_together))
    records = run_all([Run(scenario, run.changes) for run in runs], threads)
    failed = [
        None if record is None else judged(scenario, record, run).failed
        for record, run in zip(records, runs, strict=True)
    ]
    passing = [
        (first.cure + second.cure, first.cause.key, second.cause.key)
        for (first, second), outcomes in zip(joint, _split(failed, counts), strict=True)
        if outcomes[:2] == [False, False] and all(outcomes[2:])
    ]
    return max(passing, key=lambda pair: pair[0])[1:] if passing else ()


def _ordinary_devices(case: Case) -> set[str]:
    """Return the keys of the causes in devices that are no worse than ordinary."""
    scenario, base = case.scenario, case.scenario.base_motion
    worse = ideal(scenario).keys()
    found = {cause.key for cause in CAUSES if cause.kind == "device" and cause.keys.isdisjoint(worse)}
    if abs(float(np.mean(scenario.uncertainty.depth))) <= ORDINARY_DEPTH:
        found.add("common_depth")
    weighed = np.abs(scenario.uncertainty.gravity).max() <= ORDINARY_WEIGHT and not scenario.has_unknown_payload
    if weighed and scenario.controller.law not in IMAGE_ALONE:
        found.add("gravity")
    shaken = base.kind == "sinusoid" and base.rotation.kind == "none"
    # what a small acceleration moves a base by may be large, and leaves a target in the world behind
    if shaken and scenario.target.frame == "base" and np.abs(base.amplitude).max() <= ordinary_base(scenario):
        found.add("base_motion")
    return found


def _unusual_causes(case: Case) -> set[str]:
    """Return the keys of the causes for which a scenario has settings that are not ordinary."""
    keys = unusual(case.scenario)
    return {cause.key for cause in CAUSES if not keys.isdisjoint(in_scenario(cause.keys, case.scenario))}


def _gets_there(one: Study, withheld: str) -> bool:
    """Return whether the law gets to the goal with other settings: none leads out of a false equilibrium.

    But for a faster loop, which swings past it.
    """
    others = (trial for key, trial in one.best.items() if key not in (withheld, *_OF_SPEED))
    return any(trial.cause.kind == "law" and not trial.judgement.failed for trial in others)


def _is_elsewhere(one: Study) -> bool:
    """Return whether the run ended for another reason, or still moves: a false equilibrium does not end a run early.

    An error within the ordinary band is not that of a false equilibrium, however narrow the band of the scenario is.
    """
    metrics, before = one.case.scenario.metrics, one.before
    far = before.error * metrics.band > max(type(metrics)().band, metrics.band)
    return not before.early and (far or before.legs > 1.0)


# ---- Parts of it ----------------------------------------------------------------------------------------------------


def controls(case: Case) -> list[dict[str, Any]]:
    """Return changes that remove no cause: other seeds where something is random, and small changes of the numbers."""
    scenario = case.scenario
    changes: list[dict[str, Any]] = []
    if is_random(scenario):
        changes += [{"seed": (scenario.seed + number) % 2**31} for number in range(1, 1 + _SEEDS)]
    random = np.random.default_rng(20)
    law = scenario.controller.law
    block = scenario.controller.gains
    numbers = {
        f"controller.{law}.{name}": getattr(block, name)
        for name in ("kp", "kt", "kd", "ki", "kv", "gain")
        if hasattr(block, name) and name not in idle_gains(scenario)
    }
    numbers |= {f"uncertainty.{name}": getattr(scenario.uncertainty, name) for name in ("gravity", "depth", "coriolis")}
    for _ in range(_SEEDS):
        changes.append(
            {
                key: (np.asarray(value, dtype=float) * (1.0 + random.uniform(-_SIZE, _SIZE))).tolist()
                for key, value in numbers.items()
            }
        )
    return changes


def _split(items: Sequence[Any], counts: Sequence[int]) -> list[Sequence[Any]]:
    """Cut a sequence into parts of given lengths."""
    ends = np.cumsum(counts).tolist()
    return [items[end - count : end] for end, count in zip(ends, counts, strict=True)]
