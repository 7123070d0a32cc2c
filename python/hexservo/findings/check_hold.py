"""Laws without viscous damping that do not keep the image at its goal, by runs: no linear loop describes them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_following import left_behind
from hexservo.findings.check_target import leaves_reach
from hexservo.findings.target_path import moving_keys
from hexservo.run.batch import simulate_batch, whole
from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

_RUNS = 4  # with different noise
_MOVED = 1.2  # times the error before a target at rest, above which that of a run is of the motion


@dataclass(frozen=True)
class _Late:
    """What runs leave in their second half."""

    error: float  # largest of a coordinate of the features [px], the median of the runs; inf where most end early
    outcome: str  # of a run that ended early, or completed


def of_hold(scene: Scene) -> Iterator[str]:
    """Yield a sentence, in sampled mode, for a law without viscous damping of which runs from the goal leave it.

    Before a target at rest, and, where that is within the band, before one that moves.
    """
    scenario = scene.scenario
    traits = scenario.controller.traits
    if scenario.simulation.mode != SAMPLED_MODE or traits.viscous or traits.output != "wrench" or not scene.has_points:
        return
    goals = find_goals(scene)
    if goals is None or not goals.reachable:
        return
    begin = goals.best.view.pose.displacement_from(scene.home).tolist()
    moving = scenario.updated({"simulation.start.pose": begin, "simulation.start.twist": [0.0] * 6})
    keys = moving_keys(scenario)
    at_rest = moving.updated({"target.motion": {"kind": "none"}, "target.frame": "base"}) if keys else moving
    resting = _late(at_rest)
    if resting.error > scene.band:
        yield _of_rest(scene, resting)
    elif keys and leaves_reach(scene) is None:
        followed = _late(moving).error
        if max(scene.band, _MOVED * resting.error) < followed < math.inf:
            yield left_behind(scene, followed, "in runs that begin at the goal", faster=True)


def _of_rest(scene: Scene, late: _Late) -> str:
    law = scene.scenario.controller.law
    found = (
        f"are up to {number(late.error, 2)} px from it in their second half (metrics.band is {number(scene.band)} px)"
        if math.isfinite(late.error)
        else f"end early ({late.outcome})"
    )
    return (
        f"controller.law: runs that begin at the goal before a target at rest {found}; {law} has Coulomb damping "
        "only, so that no linear loop shows what causes it: hexservo diagnose names it"
    )


def _late(scenario: Scenario) -> _Late:
    seeds = np.asarray(scenario.seed + np.arange(_RUNS))
    batch = whole(simulate_batch(scenario, {"seed": seeds}, log="trajectory", metrics=()))
    late = batch.samples["feature_error"][:, batch.samples["feature_error"].shape[1] // 2 :]
    outcomes = [str(outcome) for outcome in batch.outcome]
    ended = np.asarray([outcome != "completed" for outcome in outcomes])
    errors = np.where(ended, np.inf, np.abs(np.nan_to_num(late, nan=np.inf)).max(axis=(1, 2)))
    return _Late(float(np.median(errors)), next((o for o in outcomes if o != "completed"), "completed"))
