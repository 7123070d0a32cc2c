"""Runs too short for the way to the goal, of legs that take positions: what limits and bandwidth take at least."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import GoalPose, find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.reach import reach_of_start_and_goal
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.bisection import last_that_holds
from hexservo.findings.target_path import follows_direction
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.motion import moves
from hexservo.scenario.wording import number, quantity

_PARTS = 200  # of the way, in which it is looked at
_SURE = 0.95  # of a time, below which noise does not end it
_LONGER = 1.25  # times what limits and law take one after the other, for a run that has time for both


@dataclass(frozen=True)
class Way:
    """The last part of the way from start to goal before the image is within the band."""

    travel: float  # [m], of the leg that goes farthest until then, of cranks [rad]
    share: float  # of the pose's way, straight to the goal, that is left then
    leg: int  # that goes farthest, 1 to 6


def of_way(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a run that ends before legs or law can be within the band for the dwell time."""
    scenario = scene.scenario
    way = way_of(scene)
    if way is None:
        return
    duration, dwell = scenario.simulation.duration, scenario.metrics.dwell
    late = scenario.camera.latency + scenario.actuators.delay
    times = least_times(scene, way)
    if not times:  # nothing limits the way
        return
    key, longest = max(times.items(), key=lambda item: item[1])
    if late + _SURE * longest + dwell <= duration:
        return
    name, unit = key.rpartition(".")[2], scene.units.coordinate
    takes, longer = quantity(longest, "s"), number(_LONGER * (late + sum(times.values()) + dwell), 2)
    takes, remedy = {
        "speed_limit": (
            f"leg {way.leg} travels {quantity(way.travel, unit)}, about {takes} at {key}",
            f"about {longer} s",
        ),
        # how long a law that brakes in time and settles takes does not follow from that
        "acceleration_limit": (
            f"leg {way.leg} travels {quantity(way.travel, unit)}, with {key} for {takes} without braking",
            "a longer run",
        ),
        "bandwidth": (f"the platform moves for about {takes} at {key}", f"about {longer} s"),
    }[name]
    yield (
        f"simulation.duration: {quantity(duration, 's')} is too short to settle: until the image is within "
        f"{number(scene.band)} px of the goal {takes}, and it has to stay there for {quantity(dwell, 's')} "
        f"(metrics.dwell); take {remedy}, or a larger {name}"
    )


def goal_of_way(scene: Scene) -> tuple[Array, Array, GoalPose] | None:
    """Return where the legs start, how far they go (6,) [m; of cranks rad], and the goal; None as `way_of`.

    None too for a goal that the legs do not reach, however long they take.
    """
    scenario = scene.scenario
    moving = scenario.target.motion.kind != "none" or moves(scenario.base_motion)
    if moving or np.any(scenario.simulation.start.twist) or scene.settled_start is not None:
        return None
    if follows_direction(scenario):
        return None
    goals = find_goals(scene)
    if goals is None or not goals.reachable or reach_of_start_and_goal(scenario).goal_within is False:
        return None
    goal = goals.best.view.pose
    ends = scene.leg_travel(
        Poses(
            np.stack([scene.start.position, goal.position]),
            np.stack([scene.start.quaternion, goal.quaternion]),
        )
    )
    legs = ends[1] - ends[0]
    return (ends[0], legs, goals.best) if np.isfinite(legs).all() else None


def way_of(scene: Scene) -> Way | None:
    """Return the way to a goal at rest, straight in the legs and in the pose; None for other tasks and machines."""
    ends = goal_of_way(scene)
    if ends is None:
        return None
    begin, legs, best = ends
    start = np.asarray(scene.scenario.simulation.start.pose, dtype=float)
    goal = best.displacement
    shares = np.arange(1, _PARTS + 1) / _PARTS
    straight = scene.residual(scene.home.moved(start + shares[:, None] * (goal - start)))
    farthest = float(np.abs(legs).max())
    pose, travel = scene.start, 0.0
    for share in shares:
        lengths = scene.hexapod.mid_lengths + begin + np.clip(legs, -share * farthest, share * farthest)
        found = scene.hexapod.forward_kinematics(lengths, pose.position, pose.quaternion)
        if found.status != _core.KinematicsStatus.converged:
            return None
        pose = Poses(found.position, found.quaternion)
        if scene.residual(Poses(pose.position[None], pose.quaternion[None]))[0] <= scene.band:
            break
        travel = float(share * farthest)
    within = np.flatnonzero(straight <= scene.band)
    left = 1.0 - float(within[0]) / _PARTS if len(within) else 0.0  # in the part before
    return Way(travel, left, int(np.abs(legs).argmax()) + 1)


def least_times(scene: Scene, way: Way) -> dict[str, float]:
    """Return what each setting takes for the way at least [s], by its dotted key.

    A speed v takes s/v for a way s, an acceleration a takes sqrt(2 s/a) without braking, and the double pole w of the
    reference t with (1 + w t) exp(-w t) = the share that is left.
    """
    scenario = scene.scenario
    response, gains = scenario.actuators.position, scenario.controller.gains
    times: dict[str, float] = {}
    if scenario.actuators.kind == "position":  # motors may be faster than the response that the law assumes
        if response.speed_limit is not None:
            times["actuators.position.speed_limit"] = way.travel / response.speed_limit
        if response.acceleration_limit is not None:
            times["actuators.position.acceleration_limit"] = math.sqrt(2.0 * way.travel / response.acceleration_limit)
    if isinstance(gains, Tracking) and way.share > 0.0:
        # by halves: a run's check does not wait for SciPy's Lambert W
        turned = last_that_holds(lambda turn: (1.0 + turn) * math.exp(-turn) > way.share, 0.0, 100.0, 60)
        times["controller.tracking.bandwidth"] = turned / (2.0 * math.pi * gains.bandwidth)
    return times
