"""A pose that one image leaves uncertain: a note with the number, and with a target that would do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.conditioning import GRIP, Sight, frames_noise, noise_in_words, sight
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene, View
from hexservo.findings.bisection import last_that_holds
from hexservo.findings.check_points import of_points
from hexservo.findings.prior import key_of_inverse, legs_of_noise
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import points_outside
from hexservo.scenario.tag import CORNERS
from hexservo.scenario.wording import number, quantity

_LARGEST = 10.0  # times as large, a target that is looked at
_HALVINGS = 20  # of a size
_SAME = 1e-6  # of the side: sides of a square that are equal


def of_observability(scene: Scene) -> Iterator[str]:
    """Yield a sentence where noise in one image makes the pose uncertain by a tenth of the stroke or more.

    That is the warning of the part conditioning of an analysis, for a camera with noise and a law that estimates the
    pose without a prior or a damping, which keep noise out. Where a warning of a check has it (`of_points`) there is
    none.
    """
    noise = frames_noise(scene.scenario)
    if noise == 0.0 or not scene.has_points or key_of_inverse(scene) or not legs_of_noise(scene).any():
        return
    sights, most = _sights(scene, scene.points), GRIP * scene.stroke_length / noise
    warned = any("uncertain" in sentence for sentence in of_points(scene))
    if warned or not max((each.worst for each in sights), default=0.0) > most:
        return
    at = max(sights, key=lambda each: each.worst)
    shift, turn = noise * at.pose_sigma[:3], noise * at.pose_sigma[3:]
    along, about = int(shift.argmax()), int(turn.argmax())
    yield (
        f"target: at the {at.place} {noise_in_words(scene.scenario)} in one image makes the pose uncertain by "
        f"{quantity(float(shift[along]), 'm')} along {'xyz'[along]} and {quantity(float(turn[about]), 'rad')} about "
        f"{'xyz'[about]} (1 sigma), in its worst direction by {noise * at.worst / scene.stroke_length:.0%} of the "
        f"stroke; {_remedy(scene, most)}"
    )


def _remedy(scene: Scene, most: float) -> str:
    """Return which target has a worst direction of at most so many m per px, as the present one but larger."""
    points = scene.points
    middle = points.mean(axis=0)

    def sights(size: float) -> list[Sight]:
        return _sights(scene, middle + size * (points - middle))

    largest = last_that_holds(lambda size: bool(sights(size)), 1.0, _LARGEST, _HALVINGS)
    # from the largest in the image down to where it is too small
    size = last_that_holds(lambda size: max(each.worst for each in sights(size)) <= most, largest, 1.0, _HALVINGS)
    if size == largest:
        return "a nearer target, points off its plane or less noise leave less"
    side = _side(points)
    if side is None:
        return f"a target {number(size)} times as large leaves 10%"
    return f"a square of {quantity(size * side, 'm')} leaves 10% (it has {quantity(side, 'm')})"


def _sights(scene: Scene, points: Array) -> list[Sight]:
    """Return what the image of points (p, 3) [m] determines at the start and at the goal; none where they leave it."""
    goals = find_goals(scene)
    poses = {"start": scene.start}
    if goals is not None and goals.reachable:
        poses["goal"] = goals.best.view.pose
    seen = [(place, view) for place, pose in poses.items() if (view := _view(scene, pose, points)) is not None]
    if len(seen) < len(poses):
        return []
    length = seen[0][1].mean_depth
    return [sight(place, view, length, scene) for place, view in seen]


def _view(scene: Scene, pose: Poses, points: Array) -> View | None:
    """Return the view of other points of the target (p, 3) [m] from one pose; None where the image has not all."""
    features, depth = _core.take_image(scene.camera, pose.position, pose.quaternion, points)
    if not (depth < 0.0).all() or points_outside(scene.scenario, features).any():
        return None
    return View(pose, features, depth, scene.jacobian(features, depth, pose))


def _side(points: Array) -> float | None:
    """Return the side of a square [m] whose corners the points (p, 3) are in the order of a tag's, None of others."""
    if len(points) != len(CORNERS):
        return None
    sides = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    diagonals = np.linalg.norm(points[2:] - points[:2], axis=1)
    lengths = np.concatenate([sides, diagonals / np.sqrt(2.0)])
    return float(sides[0]) if np.ptp(lengths) <= _SAME * sides[0] else None
