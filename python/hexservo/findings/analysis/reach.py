"""Whether the legs reach the start and the goal of a scenario, without a run (docs/analysis/workspace.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import quantity

LegLimitKind: TypeAlias = Literal["stroke", "base_joint", "platform_joint"]
LEG_LIMITS: tuple[LegLimitKind, ...] = ("stroke", "base_joint", "platform_joint")  # rows of `Scene.limits_used`


@dataclass(frozen=True)
class LegMargin:
    """The leg that is nearest to one of its limits at a pose, or farthest beyond it."""

    leg: int  # 1 to 6
    travel: float  # of that leg from the middle of its travel [m], positive where it is longer; of a crank [rad]
    margin: float  # limit - |value| [m], of a joint or a crank [rad]; negative: beyond the limit
    limit: LegLimitKind = "stroke"
    unit: str = "m"  # of travel

    @property
    def within(self) -> bool:
        """Whether all legs are within their limits."""
        return self.margin >= 0.0

    @property
    def beyond(self) -> str:
        """What is wrong where it is not within, as a clause."""
        if self.limit == "stroke":
            if np.isinf(self.margin):
                return f"leg {self.leg} does not reach it"
            return f"leg {self.leg} would be {quantity(-self.margin, self.unit)} beyond its stroke"
        side = self.limit.removesuffix("_joint")
        return f"the {side} joint of leg {self.leg} would be {quantity(-self.margin, 'rad')} beyond its limit"


@dataclass(frozen=True)
class StartAndGoal:
    """Margins of the legs at the start and at the goal of a scenario."""

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


def leg_margin(travel: Array, stroke: float, unit: str = "m") -> LegMargin:
    """Return the leg nearest to its limit, of travels (6,) as of `Scene.leg_travel`, in `unit`."""
    leg = int(np.abs(travel).argmax())
    return LegMargin(leg + 1, float(travel[leg]), float(stroke - abs(travel[leg])), unit=unit)


def nearest_limit(scene: Scene, pose: Poses) -> LegMargin:
    """Return the limit of which a leg uses the largest share at one pose, with what is left of it."""
    used = scene.limits_used(pose)
    row, leg = np.unravel_index(int(used.argmax()), used.shape)
    travel = scene.leg_travel(pose)
    if row == 0 or scene.joint_limit is None:
        return leg_margin(travel, scene.stroke, scene.units.coordinate)
    limit = float(scene.joint_limit[row - 1])
    return LegMargin(int(leg) + 1, float(travel[leg]), float(limit * (1.0 - used[row, leg])), LEG_LIMITS[row])


def reach_of_start_and_goal(scenario: Scenario) -> StartAndGoal:
    """Compare the legs at the start and at the goal of a scenario with their stroke and joint limits.

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
        return nearest_limit(scene, pose)

    goals = find_goals(scene)
    if goals is None:
        return StartAndGoal(at(scene.start), None, None, float("nan"))
    goal = at(goals.best.view.pose)
    nearest = goal if goal.within else at(goals.nearest.view.pose)
    return StartAndGoal(at(scene.start), goal, nearest, goals.best.largest_residual)
