"""From the runs with one cause removed to a ranking of the causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hexservo._diagnosis.causes import CAUSES, Case, Cause, Removal
from hexservo._diagnosis.criterion import Judgement, Record, judge
from hexservo._diagnosis.evidence import SIGNATURES, Signature
from hexservo._diagnosis.goal import goal_of, goal_run
from hexservo._diagnosis.runs import Run, run_all
from hexservo._scenario import Scenario

__all__ = ["Trial", "judged", "make_cases", "rank", "try_removals"]

_SIDE_EFFECT = (
    0.6  # share of the score that a removal loses where a cause that it cures by side effect explains as much
)
_EXPLAINED = 0.9  # of a cure, from which on another cause begins to explain it
_LOOK = 0.3  # share of the score that a removal loses where the run does not look like the cause at all
_AT_LIMIT = 0.99  # of the stroke: a run that stops at a limit ends before it
_NEAR = 3.0  # of the error that is allowed
_NEUTRAL = 0.5  # look of a cause without a signature


@dataclass(frozen=True, eq=False)
class Trial:
    """A cause with the removal that helped most."""

    cause: Cause
    removal: Removal
    record: Record
    judgement: Judgement
    cure: float  # share of the severity that the removal takes away, 0 to 1
    signature: Signature
    score: float  # 0 to 1


def make_cases(scenarios: Sequence[Scenario], threads: int = 1) -> list[Case]:
    """Find the goals of scenarios."""
    records = run_all([goal_run(scenario) for scenario in scenarios], threads)
    return [Case(scenario, goal_of(record)) for scenario, record in zip(scenarios, records, strict=True)]


def judged(
    scenario: Scenario, record: Record, removal: Removal | None = None, before: Judgement | None = None
) -> Judgement:
    """Judge a run of a scenario, perhaps with changes, perhaps to be compared to how it was before them."""
    free = removal is not None and not removal.stroke_counts
    stroke = scenario.robot.stroke if free or removal is None else removal.changes.get("robot.stroke")
    return judge(
        record,
        scenario.robot.stroke if stroke is None else float(stroke),
        scenario.simulation.duration,
        stroke_counts=not free,
        cured=None if before is None else before.cured,
    )


def try_removals(cases: Sequence[Case], threads: int = 1) -> list[list[tuple[Cause, Removal, Record]]]:
    """Run every removal of every cause, each by itself; those that are refused are left out."""
    places = [
        (number, cause, removal)
        for number, case in enumerate(cases)
        for cause in CAUSES
        for removal in cause.removals(case)
    ]
    records = run_all([Run(cases[number].scenario, removal.changes) for number, _, removal in places], threads)
    found: list[list[tuple[Cause, Removal, Record]]] = [[] for _ in cases]
    for (number, cause, removal), record in zip(places, records, strict=True):
        if record is not None:
            found[number].append((cause, removal, record))
    return found


def rank(case: Case, record: Record, before: Judgement, tried: Sequence[tuple[Cause, Removal, Record]]) -> list[Trial]:
    """Rank the causes of a run that failed, the likeliest one first.

    The score is the share of the severity that the removal takes away, less where another cause explains as much that
    this removal cures by side effect, and less where the run does not look like the cause.
    """
    best: dict[str, Trial] = {}
    for cause, removal, after_record in tried:
        after = judged(case.scenario, after_record, removal, before)
        cure = max(0.0, 1.0 - after.severity / before.severity)
        if cause.key not in best or cure > best[cause.key].cure:
            nothing = Signature(None, "")
            best[cause.key] = Trial(cause, removal, after_record, after, cure, nothing, 0.0)
    trials = []
    for key, trial in best.items():
        signature = SIGNATURES[key](case, record, before)
        rivals = [best[other].cure for other in trial.cause.also_cures if other in best]
        explained = max(rivals, default=0.0) / trial.cure if trial.cure else 0.0
        discount = _SIDE_EFFECT * min(1.0, max(0.0, (explained - _EXPLAINED) / (1.0 - _EXPLAINED)))
        look = _NEUTRAL if signature.strength is None else signature.strength
        score = trial.cure * (1.0 - discount) * (1.0 - _LOOK * (1.0 - look))
        if key == "leg_limits" and case.goal is not None:  # the legs may also go farther than the goal asks
            if (excursion := trial.record.metrics["peak_leg_excursion"]) > 0.0:  # of a single step it may be zero
                score *= min(1.0, case.goal.leg_travel / excursion)
        trials.append(replace(trial, signature=signature, score=score))
    if "leg_limits" in best:
        reach = _out_of_reach(case, before, best)
        trials = [
            replace(trial, score=max(trial.score, reach)) if trial.cause.key == "leg_limits" else trial
            for trial in trials
        ]
    return sorted(trials, key=lambda trial: -trial.score)  # stable: ties keep the order of CAUSES


def _out_of_reach(case: Case, before: Judgement, best: Mapping[str, Trial]) -> float:
    """Score the limits of the legs where the goal itself lies beyond them: nothing else can cure that.

    0 where the legs did not leave their stroke, where another removal leads to the goal within it, or where the image
    is far from its goal even without limits. Else from 0.5, the more the farther the goal is.
    """
    free = best["leg_limits"].judgement
    if (
        case.goal is None
        or before.stroke < _AT_LIMIT
        or free.early
        or free.error > _NEAR
        or not all(trial.judgement.failed for key, trial in best.items() if key != "leg_limits")
    ):
        return 0.0
    excess = case.goal.leg_travel / case.scenario.robot.stroke - 1.0
    return 0.5 + 0.5 * min(1.0, excess / 0.5) if excess > 0.0 else 0.0
