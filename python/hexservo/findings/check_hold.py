"""What runs that begin near the goal leave of it before a target at rest, and at the goal before one that moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.analysis.goal import GoalPose, find_goals
from hexservo.findings.analysis.loop_of_scenario import side_of_target
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_target import leaves_reach
from hexservo.findings.misread import readings_of_goal
from hexservo.findings.target_path import moving_keys, path_at
from hexservo.findings.tracking_runs import MOVED, RUNS, long_enough, seeds_of_runs
from hexservo.run.batch import simulate_batch, whole
from hexservo.run.metrics import is_settled
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.rotations import quaternions_of_matrices, unit_rotation_vectors
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number, quantity
from hexservo.scenario.yaml import ScenarioError

_MOST_STEPS = 100_000  # of a run
_AWAY = 2.0  # bands, by which runs begin beside the goal in the image, so that an equilibrium that is unstable shows
_AT_REST = {"target.motion": {"kind": "none"}, "base_motion": {"kind": "none"}, "target.frame": "base"}


@dataclass(frozen=True)
class _Late:
    """What some runs leave."""

    scenario: Scenario
    error: float  # [px], largest of a coordinate of the features in the second half, the median; inf where most end
    largest: float  # [px], likewise of all that do not end early
    unsettled: int  # of `RUNS`
    first: int  # of those that are not settled, or 0
    outcome: str  # of the first that ended early, or completed


def of_hold(scene: Scene) -> Iterator[str]:
    """Yield a sentence where runs that begin near the goal do not settle, leave it again, or lose one that moves.

    Before a target at rest from poses about the goal that show its image two bands off it, or from the goal where the
    legs do not reach these. In sampled mode, where they settle, from the goal too: noise and lost points take a run
    out of the band for a while, which need not be its end; and before a target that moves, where they keep that. At
    most 20 s and 100 000 steps of a run are looked at. The law `tracking` before a target in motion has
    `check_tracking`, a goal image that is probably misread `readings_of_goal`.
    """
    scenario = scene.scenario
    acts = scene.has_points and not (scenario.sampled and scenario.camera.dropout == 1.0)
    goals = find_goals(scene) if acts else None
    if goals is None or not goals.reachable or readings_of_goal(scene):
        return
    keys = moving_keys(scenario)
    begin = {"simulation.start.pose": goals.best.displacement.tolist(), "simulation.start.twist": [0.0] * 6}
    try:
        runs = _short(scenario.updated(begin))
        at_rest = runs.updated(_AT_REST) if keys else runs
        starts = _beside(scene, goals.best)
        at_goal = np.tile(goals.best.displacement, (RUNS, 1))
        near, *resting = _late(at_rest, starts, *([at_goal] if scenario.sampled else []))
        if near.unsettled:
            yield _of_rest(scene, starts[near.first], near)
        elif resting and resting[0].largest > scene.band:
            yield _of_band(scene, resting[0])
        elif resting and keys and not isinstance(scenario.controller.gains, Tracking) and leaves_reach(scene) is None:
            yield from _of_motion(scene, goals.best, resting[0], *_late(runs, at_goal))
    except ScenarioError:
        return  # the goal is no start: `check` names why


def _beside(scene: Scene, goal: GoalPose) -> Array:
    """Return displacements from home (`RUNS`, 6) [m; rad] of starts beside a goal; the goal's where none is reached.

    Directions are drawn with a fixed seed: translations and rotations move the image of the target alike.
    """
    moves = np.random.default_rng(0).normal(size=(RUNS, 6))
    moves[:, :3] *= goal.view.mean_depth
    moves *= _AWAY * scene.band / np.abs(moves @ goal.view.jacobian.T).max(axis=1, keepdims=True)
    poses = goal.view.pose.moved(moves)
    return np.where(scene.reachable(poses)[:, None], poses.displacement_from(scene.home), goal.displacement)


def _of_rest(scene: Scene, start: Array, late: _Late) -> str:
    found = (
        f"end early ({late.outcome.replace('_', ' ')})"
        if late.outcome != "completed"
        else f"are not settled within {quantity(late.scenario.simulation.duration, 's')}: up to "
        f"{number(late.largest, 2)} px from it in their second half, and metrics.band is {number(scene.band)} px"
    )
    count = "" if late.unsettled == RUNS else f"{late.unsettled} of {RUNS} "
    begin = ", ".join(number(float(f"{x:.6g}"), 6) for x in start)
    return (
        f"controller.law: {count}runs of {scene.scenario.controller.law} that begin within "
        f"{number(_AWAY * scene.band)} px of the goal before a target at rest {found}; hexservo diagnose names the "
        f"cause, with simulation.start.pose: [{begin}] for such a run"
    )


def _of_band(scene: Scene, late: _Late) -> str:
    return (
        f"metrics.band: runs of {scene.scenario.controller.law} that begin at the goal before a target at rest leave "
        f"the band of {number(scene.band)} px again: up to {number(late.largest, 2)} px in their second half, so that "
        "a settling time is by chance; take a wider band, or a camera with less noise, outliers and lost frames"
    )


def _of_motion(scene: Scene, goal: GoalPose, resting: _Late, moving: _Late) -> Iterator[str]:
    left = moving.error
    if not max(scene.band, MOVED * resting.error) < left:
        return
    keys, law = " and ".join(moving_keys(scene.scenario)), scene.scenario.controller.law
    if not math.isfinite(left):
        yield (
            f"{keys}: runs of {law} that begin at the goal end early with such a motion of the target "
            f"({moving.outcome}), and not before one at rest; hexservo diagnose names the cause"
        )
        return
    still = _still(scene, goal, moving.scenario)
    worse = (
        f", where a platform that stands still would have {number(still, 2)} px: the loop amplifies such a motion"
        if left > still
        else ""
    )
    faster = "" if worse else "a law of higher bandwidth, "
    yield (
        f"{keys}: {law} leaves up to about {number(left, 2)} px of such a motion of the target in runs that begin at "
        f"the goal ({number(resting.error, 2)} px before one at rest){worse}. metrics.band is {number(scene.band)} px: "
        f"{faster}a shorter camera.period or latency, or a slower motion leaves less"
    )


def _short(scenario: Scenario) -> Scenario:
    """Return a scenario that lasts as long as is looked at, in whole servo periods, every sample logged."""
    scenario = long_enough(scenario)
    step, most = scenario.simulation.step, _MOST_STEPS
    changes: dict[str, Any] = {"simulation.log_every": 1}
    if scenario.simulation.duration > most * step:
        changes["simulation.duration"] = most * step
    return scenario.updated(changes)


def _late(scenario: Scenario, *starts: Array) -> list[_Late]:
    """Return what runs leave from starts, each (`RUNS`, 6), with different noise, which only sampled mode has.

    All in one batch: a pack of eight lanes takes no longer than one of four.
    """
    variations = {"simulation.start.pose": np.concatenate(starts)}
    if scenario.sampled:
        variations["seed"] = np.tile(seeds_of_runs(scenario), len(starts))
    batch = whole(simulate_batch(scenario, variations, log="trajectory", metrics=("settling_time",)))
    features, settling = batch.samples["feature_error"], batch.metrics["settling_time"]
    parts = [slice(first, first + RUNS) for first in range(0, len(features), RUNS)]
    return [_left(scenario, batch.outcome[part], features[part], settling[part]) for part in parts]


def _left(scenario: Scenario, outcome: Any, features: Array, settling: Array) -> _Late:
    """Return what some runs leave: outcomes (n,), errors of features (n, samples, 2p) [px], settling times (n,) [s]."""
    ended, late = outcome != "completed", np.nan_to_num(features[:, features.shape[1] // 2 :], nan=np.inf)
    errors = np.where(ended, np.inf, np.abs(late).max(axis=(1, 2)))
    unsettled = ~is_settled(outcome, settling)
    first = int((ended if ended.any() else unsettled).argmax())
    return _Late(
        scenario=scenario,
        error=float(np.median(errors)),
        largest=float(errors[~ended].max(initial=0.0)),
        unsettled=int(unsettled.sum()),
        first=first,
        outcome=str(outcome[ended][0]) if ended.any() else "completed",
    )


def _still(scene: Scene, goal: GoalPose, scenario: Scenario) -> float:
    """Return the largest error of a platform that stays at the goal, in the second half of a run [px]; linear."""
    duration, step = scenario.simulation.duration, scenario.simulation.step
    path = path_at(scene, np.arange(duration / 2.0, duration, step))
    origin = goal.view.pose.position
    turn = unit_rotation_vectors(quaternions_of_matrices(path.attitude))
    moved = side_of_target(scene.scenario) * np.hstack([path.places(origin) - origin, -turn])
    return float(np.abs(moved @ goal.view.jacobian.T).max())
