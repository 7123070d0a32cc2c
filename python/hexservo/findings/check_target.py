"""Where a target goes during a run: beyond reach, out of the image, and faster than frames show."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.reach import nearest_limit, reach_of_start_and_goal
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.motion import displacements_of
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import points_outside
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number, quantity

_INSTANTS = 200  # of a run, or of a period of a sinusoid, that are looked at
_ROUNDS = 20  # in which a ray is pointed: each leaves the square of what the one before left
_SHOWN = 0.5  # of the amplitude, least that frames show of a sinusoid that they resolve
_MOST_FRAMES = 100_000  # that are looked at
_ROUNDING = 1e-9


def of_target(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each: a goal that pointing does not meet, one that leaves the reach, and aliasing.

    The target's own motion is followed, not that of a base, and by the platform without a lag.
    """
    if not scene.has_points:
        return
    pointing = isinstance(gains := scene.scenario.controller.gains, Tracking) and gains.follow == "direction"
    yield from _of_pointing(scene) if pointing else ()
    if scene.scenario.target.motion.kind != "none":
        yield from _of_way(scene, pointing)
        yield from _of_frames(scene.scenario)


def _of_pointing(scene: Scene) -> Iterator[str]:
    left = float(scene.residual(_pointed(scene, np.zeros((1, 3))))[0])
    if left > scene.band:
        yield (
            f"controller.tracking.follow: direction leaves {number(left)} px at the goal, more than metrics.band "
            f"({number(scene.band)} px), since the camera is pointed at the middle of the target from home's position; "
            "follow the pose, or take a goal that is seen so"
        )


@dataclass(frozen=True, eq=False)
class _Way:
    """Where a target is in a run, and where the platform has to be for it."""

    time: Array  # (n,) [s]
    shift: Array  # (n, 3) d(t) [m]
    poses: Poses  # n


def _of_way(scene: Scene, pointing: bool) -> Iterator[str]:
    """Find the time from which on the legs do not reach the pose that the target's motion asks for."""
    way = _way(scene, pointing)
    if way is None:
        return
    beyond = ~scene.reachable(way.poses)
    by_pose = scene.scenario.controller.traits.output == "pose"  # which goes to that pose, whatever else shows the goal
    if beyond[0] or not beyond.any() or not (by_pose or _beyond_for_good(scene, way)):
        return
    first = int(beyond.argmax())
    limit = nearest_limit(scene, way.poses[first])
    why = "a singular pose lies on the way" if limit.within else limit.beyond
    yield (
        f"target.motion: the goal is out of reach from {quantity(float(way.time[first]), 's')} on, first where {why}"
        f"{_of_border(scene, way, first)}; bound the motion, or shorten simulation.duration"
    )


def _beyond_for_good(scene: Scene, way: _Way) -> bool:
    """Return whether no other pose with nearly the goal image is within reach where the legs have to go farthest."""
    left = np.nan_to_num(scene.limits_left(way.poses), nan=-np.inf)
    points = (scene.points + way.shift[int(left.argmin())]).tolist()
    away = {"target.initial_features": None, "target.depth": None, "target.points": points}
    try:
        moved = scene.scenario.updated({"target.motion.kind": "none", **away})
    except ValueError:  # a point is no longer before the camera of home
        return True
    return reach_of_start_and_goal(moved).goal_within is not True


def _of_border(scene: Scene, way: _Way, first: int) -> str:
    """Return from when on the camera of a platform that stays at its last pose within reach does not see all points."""
    stay = way.poses[first - 1]
    seen = seen_alike(stay, way.shift[first:])
    outside = np.asarray(points_outside(scene.scenario, scene.image(seen)[0]).any(axis=1))  # NaN is outside
    if not outside.any():
        return ""
    since = quantity(float(way.time[first:][outside][0]), "s")
    return f", and outside the image of a platform that stays there from {since} on"


def seen_alike(poses: Poses, shift: Array) -> Poses:
    """Return from where the target at rest has the image that it has from poses while displaced by (n, 3) [m]."""
    return Poses(poses.position - shift, np.broadcast_to(poses.quaternion, (len(shift), 4)))


def _way(scene: Scene, pointing: bool) -> _Way | None:
    """Return the way of a target; None where no pose has the goal image to `metrics.band`."""
    time, shift = _instants(scene.scenario)
    if pointing:
        return _Way(time, shift, _pointed(scene, shift))
    goals = find_goals(scene)
    if goals is None or goals.best.largest_residual > scene.band:
        return None
    best = goals.best if scene.reachable(goals.best.view.pose.rows)[0] else goals.nearest
    goal = best.view.pose  # the image depends on the place relative to the target: both are shifted alike
    return _Way(time, shift, Poses(goal.position + shift, np.tile(goal.quaternion, (len(time), 1))))


def _instants(scenario: Scenario) -> tuple[Array, Array]:
    """Return instants of a run, with its ends and the extremes of d(t) among them, (n,) [s], and d(t) there, (n, 3)."""
    motion, duration = scenario.target.motion, scenario.simulation.duration
    span = duration
    extremes = np.zeros(0)
    if motion.kind == "sinusoid" and motion.frequency > 0.0:
        span = min(duration, 1.0 / motion.frequency)
        extremes = (np.array([0.25, 0.75, 1.25]) - motion.phase / (2.0 * math.pi)) % 1.0 / motion.frequency
    elif motion.kind == "recorded" and motion.samples is not None and motion.sample_period is not None:
        samples = np.asarray(motion.samples, dtype=float)
        extremes = motion.sample_period * np.concatenate([samples.argmin(axis=0), samples.argmax(axis=0)])
    time = np.unique(np.concatenate([np.linspace(0.0, span, _INSTANTS + 1), extremes[extremes <= span]]))
    return time, displacements_of(motion, time)


def _pointed(scene: Scene, shift: Array) -> Poses:
    """Return the poses (n) that point the camera at a target that is displaced by (n, 3) [m], as `follow: direction`.

    Of the rotations at home's position that bring the weighted middle of the points to that of the goal it is the
    shortest one, as of docs/model.md, section 5: by Newton's method for the least rotation under that condition.
    """
    weights = np.asarray(scene.settings["target.weights"], dtype=float)
    shares = weights / weights.sum()
    wanted = shares @ scene.desired.reshape(-1, 2)
    turns = np.zeros_like(shift)
    home = Poses(*(np.tile(numbers, (len(shift), 1)) for numbers in (scene.home.position, scene.home.quaternion)))
    poses = home
    for _ in range(_ROUNDS):
        at = seen_alike(poses, shift)
        features, depth = scene.image(at)
        if not np.isfinite(features).all():
            features, depth = np.nan_to_num(features), np.nan_to_num(depth, nan=-scene.depth)  # no pose of use
        error = wanted - np.einsum("p,npk->nk", shares, features.reshape(len(shift), -1, 2))
        slopes = scene.jacobian(features, depth, at)[..., 3:].reshape(len(shift), -1, 2, 3)
        slope = np.einsum("p,npkj->nkj", shares, slopes)
        turns = np.einsum("njk,nk->nj", np.linalg.pinv(slope), error + np.einsum("nkj,nj->nk", slope, turns))
        poses = home.moved(np.concatenate([np.zeros_like(turns), turns], axis=1))
    return poses


def _of_frames(scenario: Scenario) -> Iterator[str]:
    """Find a sinusoid that frames show as another motion, or as none."""
    motion, period = scenario.target.motion, frame_period(scenario)
    turns = motion.frequency * period  # from frame to frame
    if motion.kind != "sinusoid" or not any(motion.amplitude) or turns < 0.5 * _SHOWN:
        return
    frames = np.arange(min(math.floor(scenario.simulation.duration / period * (1.0 + _ROUNDING)) + 1, _MOST_FRAMES))
    seen = np.sin(2.0 * math.pi * (frames * turns % 1.0) + motion.phase)
    shown = float(np.ptp(seen)) / 2.0
    head = f"target.motion.frequency: of {number(motion.frequency)} Hz a frame every {quantity(period, 's')} shows"
    if shown < _SHOWN:
        yield (
            f"{head} {number(shown) if shown > _ROUNDING else '0'} of the amplitude, since it is near a multiple of "
            f"half the frame rate, {number(0.5 / period)} Hz; the law does not see the motion"
        )
    elif turns > 0.5 * (1.0 + _ROUNDING):
        apparent = abs(turns - round(turns)) / period
        yield f"{head} a motion of {number(apparent)} Hz: above half the frame rate it is aliased"
