"""Whether the legs reach the start and the goal of a scenario, without a run (docs/analysis/workspace.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

__all__ = ["LegMargin", "StartAndGoal", "leg_margin", "reach_of_start_and_goal"]


@dataclass(frozen=True)
class LegMargin:
    """The leg that is nearest to the end of its stroke at a pose, or farthest beyond it."""

    leg: int  # 1 to 6
    travel: float  # of that leg from its length at home [m], positive where it is longer
    margin: float  # stroke - |travel| [m]; negative: beyond the stroke

    @property
    def within(self) -> bool:
        """Whether all legs are within their stroke."""
        return self.margin >= 0.0


@dataclass(frozen=True)
class StartAndGoal:
    """Margins of the legs' stroke at the start and at the goal of a scenario."""

    start: LegMargin
    goal: LegMargin | None  # at the pose of least image error; None: a camera as printed has no goal pose
    # At the pose nearest to home that leaves no feature more than 0.1 px farther off; None as above.
    nearest: LegMargin | None
    residual: float  # largest |xi_d - xi| at the pose of least image error [px]; NaN without a goal pose

    @property
    def goal_within(self) -> bool | None:
        """Whether the legs reach a pose of least image error; None without a goal pose."""
        if self.goal is None or self.nearest is None:
            return None
        return self.goal.within or self.nearest.within


def leg_margin(travel: Array, stroke: float) -> LegMargin:
    """Return the leg nearest to its limit, of travels (6,) from the lengths at home [m]."""
    leg = int(np.abs(travel).argmax())
    return LegMargin(leg + 1, float(travel[leg]), float(stroke - abs(travel[leg])))


def reach_of_start_and_goal(scenario: Scenario) -> StartAndGoal:
    """Compare the leg lengths at the start and at the goal of a scenario with the stroke.

    Nothing is run. Poses of the goal image are found by a local search (`find_goals`), so that a pose may be missed.

    Parameters
    ----------
    scenario
        In either mode, with any law; the law's gains do not enter.

    Returns
    -------
    StartAndGoal
        Margins in m, legs counted from 1. `nearest` is `goal` where the legs reach that one.

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    scene = scene_of(scenario)

    def at(pose: Poses) -> LegMargin:
        return leg_margin(scene.leg_travel(pose), scene.stroke)

    goals = find_goals(scene)
    if goals is None:
        return StartAndGoal(at(scene.start), None, None, float("nan"))
    goal = at(goals.best.view.pose)
    nearest = goal if goal.within else at(goals.nearest.view.pose)
    return StartAndGoal(at(scene.start), goal, nearest, goals.best.largest_residual)
