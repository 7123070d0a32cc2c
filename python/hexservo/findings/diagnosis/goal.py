"""Goal pose of a scenario, and its image with a well-spread target."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.reach import nearest_limit, reach_of_start_and_goal
from hexservo.findings.analysis.scene import scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import desired_features, to_pixels
from hexservo.scenario.scenario import Scenario

_SPREAD = 0.2  # half the side of the square that stands in for a target, in parts of its distance
_SHOWN = 1.0  # [px]: it may be that no pose shows the goal exactly


@dataclass(frozen=True, eq=False)
class Goal:
    """The pose whose image is the goal."""

    position: Array  # (3,) [m], in B
    quaternion: Array  # (4,) w x y z
    leg_travel: float  # of the leg that has to go farthest from the middle of its travel [m]
    within: bool  # whether all legs are within stroke and joint limits there


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Why no law can reach the goal of a scenario, or start on its way."""

    kind: Literal["start", "legs", "image"]  # legs do not reach the start, or a pose that shows the goal; no pose does
    # what the legs would have to do at the start, or at the nearest pose with that image, as a clause; empty: they do
    beyond: str
    leg_travel: float  # of the leg that would have to go farthest [m]
    residual: float = math.nan  # largest error of a feature at the best pose [px]
    nearest_image: Array = field(default_factory=lambda: np.empty(0))  # (2p,) [px], what the best pose shows


def obstacle_of(scenario: Scenario, goal: Goal | None) -> Obstacle | None:
    """Check by the goal image, stroke and joint limits whether start and goal can be reached at all.

    None where they can; of a camera as printed, whose goal has no pose, the start alone is checked.
    """
    scene = scene_of(scenario)
    start = nearest_limit(scene, scene.start)
    if not start.within:
        return Obstacle("start", start.beyond, abs(start.travel))
    if scenario.camera.convention != "eye_in_hand" or (goal is not None and goal.within):
        return None
    found = reach_of_start_and_goal(scenario)
    if found.goal is None or found.nearest is None:
        return None
    travel = min(abs(found.goal.travel), abs(found.nearest.travel))
    goals = find_goals(scene)
    assert goals is not None  # as `found.goal` is not
    image = goals.best.view.features
    if found.goal_within and found.residual <= scenario.metrics.band:
        return None
    # A far pose may nearly show four features that belong to none: the legs are the cause for an image of a pose.
    beyond = "" if found.nearest.within else found.nearest.beyond
    return Obstacle("legs" if goals.reachable else "image", beyond, travel, found.residual, image)


def goal_of(scenario: Scenario) -> Goal | None:
    """Return the goal of a scenario; None if no pose was found that shows it to 1 px, or the camera is as printed."""
    scene = scene_of(scenario)
    goals = find_goals(scene)
    if goals is None or goals.best.largest_residual > _SHOWN:
        return None
    pose = goals.best.view.pose
    travel = float(np.abs(scene.leg_travel(pose)).max())
    return Goal(pose.position, pose.quaternion, travel, nearest_limit(scene, pose).within)


def pixels_per_metre(camera: _core.Camera, features: Array, depth: Array, position: Array) -> float:
    """Return the smallest singular value of the image Jacobian at a position and attitude zero [px/m].

    Rotations count as the distance by which they move the target's mean depth: 1 rad as |Z| metres.
    """
    jacobian = _core.image_jacobian(camera, features, depth, [1.0, 0.0, 0.0, 0.0], position=position)
    jacobian = jacobian / np.repeat([1.0, np.abs(depth).mean()], 3)
    return float(np.linalg.svd(jacobian, compute_uv=False)[-1])


def seen_from_home(scenario: Scenario) -> tuple[_core.Camera, Array, Array, Array]:
    """Return the camera, its features (2p,) [px] and depths (p,) [m] from home, and home's position (3,) [m]."""
    scene = scene_of(scenario)
    home = scene.view(scene.home)
    return scene.camera, home.features, home.depth, scene.home.position


def _on_square(count: int) -> Array:
    """Return points along the border of a square with a half side of 1, (2 count,): of four points its corners."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    side, share = np.divmod(np.arange(count) * (4.0 / count), 1.0)
    first = side.astype(int)
    return np.asarray(corners[first] + share[:, None] * (corners[first + 1] - corners[first])).ravel()


def spread_target(scenario: Scenario, goal: Goal) -> tuple[dict[str, Any], float]:
    """Replace the target by points on a square about the optical axis of home, with the goal at the same pose.

    The border of the image, where it has one, is as far out as before in parts of the target's farthest feature.

    Returns
    -------
    tuple
        The changes, and by what factor `pixels_per_metre` grows.
    """
    camera, features, depth, at = seen_from_home(scenario)
    distance = float(np.abs(depth).mean())
    home = scene_of(scenario).home
    start, start_depth = camera.focal_pixels * _SPREAD * _on_square(len(depth)), np.full(len(depth), -distance)
    points = _core.lift(camera, home.position, home.quaternion, start, start_depth)
    end, _ = _core.take_image(camera, goal.position, goal.quaternion, points)
    gain = pixels_per_metre(camera, start, start_depth, at) / pixels_per_metre(camera, features, depth, at)
    changes: dict[str, Any] = {}
    moved = np.zeros(2 * len(depth))  # of each pixel
    if scenario.camera.image_size is not None:  # features that leave the image do so as before
        before = np.abs(np.concatenate([features, desired_features(scenario)]).reshape(-1, 2)).max(0)
        after = np.abs(np.concatenate([start, end]).reshape(-1, 2)).max(0)
        changes, moved = resized_image(scenario, np.asarray(scenario.camera.image_size) * after / before)
    changes["target.desired_features"] = (to_pixels(scenario, end) + moved).tolist()
    if scenario.target.points is not None:
        changes["target.points"] = points.tolist()
    else:
        changes["target.initial_features"] = (to_pixels(scenario, start) + moved).tolist()
        changes["target.depth"] = distance
    return changes, gain


def resized_image(scenario: Scenario, size: Array) -> tuple[dict[str, Any], Array]:
    """Return the changes to an image of another size (2,) [px], whose centre stays where it is in the features.

    Returns
    -------
    tuple
        The changes, and by how much the pixels of features move, (2p,) [px]: by nothing where they count from the
        centre of the image.
    """
    camera, changes = scenario.camera, {"camera.image_size": size.tolist()}
    moved = np.zeros(2)
    if camera.principal_point is not None:
        moved = (size - np.asarray(camera.image_size)) / 2.0
        changes["camera.principal_point"] = (np.asarray(camera.principal_point) + moved).tolist()
    return changes, np.tile(moved, scenario.target.count)
