"""Where a target goes during a run: beyond reach, out of the image, and faster than frames show."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.reach import nearest_limit, reach_of_start_and_goal
from hexservo.findings.analysis.scene import AT_REST, Scene
from hexservo.findings.target_path import TargetPath, at_rest, follows_direction, moving_keys, path_of, sinusoid_in_base
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import points_outside
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number, quantity

_ROUNDS = 20  # in which a ray is pointed: each leaves the square of what the one before left
_SHOWN = 0.5  # of the amplitude, least that frames show of a sinusoid that they resolve
_MOST_FRAMES = 100_000  # that are looked at
_ROUNDING = 1e-9


def of_target(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each: a goal that pointing does not meet, one that leaves the reach, and aliasing.

    The target is followed where it goes in B, by its own motion and by a base that moves before a target in the world,
    and by the platform without a lag.
    """
    if not scene.has_points:
        return
    yield from _of_pointing(scene) if follows_direction(scene.scenario) else ()
    if moving_keys(scene.scenario):
        yield from _of_way(scene)
        yield from _of_frames(scene.scenario)


def _of_pointing(scene: Scene) -> Iterator[str]:
    left = float(scene.residual(_pointed(scene, at_rest()))[0])
    if left > scene.band:
        yield (
            f"controller.tracking.follow: direction leaves {number(left)} px at the goal, more than metrics.band "
            f"({number(scene.band)} px), since the camera is pointed at the middle of the target from home's position; "
            "follow the pose, or take a goal that is seen so"
        )


def _of_way(scene: Scene) -> Iterator[str]:
    """Find the time from which on the legs do not reach the pose that the target's motion asks for."""
    leaves = leaves_reach(scene)
    if leaves is None:
        return
    first, path, poses = leaves.first, leaves.path, leaves.poses
    limit = nearest_limit(scene, poses[first])
    why = "a singular pose lies on the way" if limit.within else limit.beyond
    keys = moving_keys(scene.scenario)
    stay = poses[first - 1] if first else scene.start
    rides = ", or set target.frame: base for a target that rides on the base" if "base_motion" in keys else ""
    yield (
        f"{' and '.join(keys)}: the goal is out of reach from {quantity(float(path.time[first]), 's')} on, first where "
        f"{why}{_of_border(scene, path[first:], stay)}; bound the motion, or shorten simulation.duration{rides}"
    )


@dataclass(frozen=True, eq=False)
class Leaving:
    """A target that leaves the reach of the legs."""

    first: int  # instant of the path at which the goal is out of reach
    path: TargetPath  # n
    poses: Poses  # n, where the platform has to be for it


@lru_cache(maxsize=8)  # several checks ask
def leaves_reach(scene: Scene) -> Leaving | None:
    """Return how a target leaves the reach; None where it does not, or where the goal at rest is beyond already."""
    path, pointing = path_of(scene), follows_direction(scene.scenario)
    poses, resting = (_way(scene, each, pointing) for each in (path, at_rest()))
    if poses is None or resting is None or not scene.reachable(resting)[0]:  # `check` names a goal out of reach at rest
        return None
    beyond = ~scene.reachable(poses)
    by_pose = scene.scenario.controller.traits.output == "pose"  # which goes to that pose, whatever else shows the goal
    if not beyond.any() or not (by_pose or _beyond_for_good(scene, path, poses)):
        return None
    return Leaving(int(beyond.argmax()), path, poses)


def _beyond_for_good(scene: Scene, path: TargetPath, poses: Poses) -> bool:
    """Return whether no other pose with nearly the goal image is within reach where the legs have to go farthest."""
    left = np.nan_to_num(scene.limits_left(poses), nan=-np.inf)
    points = path.points(int(left.argmin()), scene.points).tolist()
    away = {"target.initial_features": None, "target.depth": None, "target.points": points}
    try:
        moved = scene.scenario.updated({**AT_REST, "target.frame": "base", **away})
    except ValueError:  # a point is no longer before the camera of home
        return True
    return reach_of_start_and_goal(moved).goal_within is not True


def _of_border(scene: Scene, path: TargetPath, stay: Poses) -> str:
    """Return from when on the camera of a platform that stays at its last pose within reach does not see all points."""
    seen = path.seen_alike(stay)
    outside = np.asarray(points_outside(scene.scenario, scene.image(seen)[0]).any(axis=1))  # NaN is outside
    if not outside.any():
        return ""
    since = quantity(float(path.time[outside][0]), "s")
    return f", and outside the image of a platform that stays there from {since} on"


def _way(scene: Scene, path: TargetPath, pointing: bool) -> Poses | None:
    """Return where the platform has to be for a target; None where no pose has the goal image to `metrics.band`."""
    if pointing:
        return _pointed(scene, path)
    goals = find_goals(scene)
    if goals is None or goals.best.largest_residual > scene.band:
        return None
    best = goals.best if scene.reachable(goals.best.view.pose.rows)[0] else goals.nearest
    return path.carried(best.view.pose)  # the image depends on the place relative to the target: both are moved alike


def _pointed(scene: Scene, path: TargetPath) -> Poses:
    """Return the poses (n) that point the camera at a target that moves, as `follow: direction` does.

    Of the rotations at home's position that bring the weighted middle of the points to that of the goal it is the
    shortest one, as of docs/model.md, section 5: by Newton's method for the least rotation under that condition.
    """
    shares = scene.shares
    wanted = shares @ scene.desired.reshape(-1, 2)
    turns = np.zeros_like(path.shift)
    home = scene.home.repeated(len(path))
    poses = home
    for _ in range(_ROUNDS):
        at = path.seen_alike(poses)
        features, depth = scene.image(at)
        if not np.isfinite(features).all():
            features, depth = np.nan_to_num(features), np.nan_to_num(depth, nan=-scene.depth)  # no pose of use
        error = wanted - np.einsum("p,npk->nk", shares, features.reshape(len(path), -1, 2))
        slopes = scene.jacobian(features, depth, at)[..., 3:].reshape(len(path), -1, 2, 3) @ path.attitude[:, None]
        slope = np.einsum("p,npkj->nkj", shares, slopes)
        turns = np.einsum("njk,nk->nj", np.linalg.pinv(slope), error + np.einsum("nkj,nj->nk", slope, turns))
        poses = home.moved(np.concatenate([np.zeros_like(turns), turns], axis=1))
    return poses


def _of_frames(scenario: Scenario) -> Iterator[str]:
    """Find a sinusoid that frames show as another motion, or as none."""
    motion, period = sinusoid_in_base(scenario), frame_period(scenario)
    turns = motion.frequency * period  # from frame to frame
    if motion.kind != "sinusoid" or not any(motion.amplitude) or turns < 0.5 * _SHOWN:
        return
    frames = np.arange(min(math.floor(scenario.simulation.duration / period * (1.0 + _ROUNDING)) + 1, _MOST_FRAMES))
    seen = np.sin(2.0 * math.pi * (frames * turns % 1.0) + motion.phase)
    shown = float(np.ptp(seen)) / 2.0
    key = "base_motion" if scenario.target.motion.kind == "none" else "target.motion"
    head = f"{key}.frequency: of {number(motion.frequency)} Hz a frame every {quantity(period, 's')} shows"
    if shown < _SHOWN:
        yield (
            f"{head} {number(shown) if shown > _ROUNDING else '0'} of the amplitude, since it is near a multiple of "
            f"half the frame rate, {number(0.5 / period)} Hz; the law does not see the motion"
        )
    elif turns > 0.5 * (1.0 + _ROUNDING):
        apparent = abs(turns - round(turns)) / period
        yield f"{head} a motion of {number(apparent)} Hz: above half the frame rate it is aliased"
