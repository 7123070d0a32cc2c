"""Points that leave the image on the way to the goal, and a plane of points that the camera passes edge-on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.misread import readings_of_goal
from hexservo.findings.target_path import follows_direction, moving_keys
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import points_outside
from hexservo.scenario.plane import Triangle, side_of_plane, triangle_of_plane

_CONSEQUENCE = {
    "hold": "the law acts on the last image of a point (camera.on_lost: hold)",
    "predict": "the law acts on the last image of a point, carried along (camera.on_lost: predict)",
    "stop": "that ends the run (camera.on_lost: stop)",
}
_PARTS = 200  # of the way, in which it is looked at


def of_plane(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a start and a goal on different sides of the plane of a target at rest.

    Any way from one to the other passes through the plane. A goal image that is probably misread has its own sentence.
    """
    triangle = triangle_of_plane(scene.points) if _goal(scene) is not None else None
    if triangle is not None and _sides(scene, triangle) < 0.0 and not readings_of_goal(scene):
        yield (
            "simulation.start.pose: the start and the goal are on different sides of the plane of the target's points: "
            "on any way the camera passes through it, where it sees them edge-on, and before that it sees a tag or a "
            "printed grid from behind; start on the goal's side"
        )


def of_straight_way(scene: Scene) -> Iterator[str]:
    """Yield a sentence for points that leave the image on the straight way in the pose, of a law that takes it.

    Those are the laws without an image Jacobian. Of a target at rest; another start than `of_plane` asks for is left
    out.
    """
    scenario = scene.scenario
    straight = not scenario.controller.traits.depth and not follows_direction(scenario)
    goal = _goal(scene) if scenario.camera.image_size is not None and straight else None
    if goal is None:
        return
    triangle = triangle_of_plane(scene.points)
    if triangle is None or not _sides(scene, triangle) < 0.0:
        yield from _of_way(scene, goal)


def _goal(scene: Scene) -> Array | None:
    """Return the displacement (6,) [m; rad] of the goal from home; None for a target that moves, or without a goal."""
    goals = None if moving_keys(scene.scenario) else find_goals(scene)
    return goals.best.displacement if goals is not None and goals.reachable else None


def _sides(scene: Scene, triangle: Triangle) -> float:
    """Return the product of the sides on which start and goal are; NaN where a point is not seen from the start."""
    start = scene.view(scene.start).features
    return float(side_of_plane(start, triangle) * side_of_plane(scene.desired, triangle))


def _of_way(scene: Scene, goal: Array) -> Iterator[str]:
    start = np.asarray(scene.scenario.simulation.start.pose, dtype=float)
    poses = scene.home.moved(start + np.linspace(0.0, 1.0, _PARTS + 1)[:, None] * (goal - start))
    features, depth = scene.probe.image(poses.position, poses.quaternion)  # NaN of the points alone that are behind
    outside = points_outside(scene.scenario, features)
    leaves = outside.any(axis=0) & ~outside[0] & ~outside[-1]  # `check` names a start and a goal that are outside
    if not leaves.any():
        return
    points = np.flatnonzero(leaves) + 1
    first, last = (np.flatnonzero(outside[:, leaves].any(axis=1))[end] / _PARTS for end in (0, -1))
    many = len(points) > 1
    passed = (depth[:, leaves] >= 0.0).any()  # Z is negative before the camera
    behind = f" or go{'' if many else 'es'} behind the camera" if passed else ""
    camera = scene.scenario.camera
    assert camera.image_size is not None
    width, height = camera.image_size
    yield (
        f"camera.image_size: on the straight way from start to goal, which {scene.scenario.controller.law} takes, "
        f"point{'s' if many else ''} {', '.join(map(str, points))} leave{'' if many else 's'} the image of "
        f"{width:.0f} x {height:.0f} px{behind} between {first:.0%} and {last:.0%} of it; "
        f"{_CONSEQUENCE[camera.on_lost]}"
    )
