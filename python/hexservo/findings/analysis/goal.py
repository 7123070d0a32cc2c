"""The pose or poses with the goal image: least squares on the core's projection."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene, View
from hexservo.run.goal_distance import inexact
from hexservo.scenario.arrays import Array

SHOWN = 1e-6  # [px], an image this close to the goal is the goal but for rounding
TOLERANCE = 0.1  # [px], how far the nearest pose may leave a feature from what the best pose reaches

_STEP = 0.3  # longest step of a search, in mean depths and radians: keeps it where the image is nearly what it was
_UNSEEN = 1e5  # [px], stands for the image of a pose that has a point behind the camera


@dataclass(frozen=True, eq=False)
class GoalPose:
    """A pose with the goal image, or a local minimum of the image error."""

    view: View
    displacement: Array  # (6,) from home [m; rad]: difference of the positions, rotation vector, both in B
    residual: Array  # (2p,) [px], desired minus seen

    @property
    def largest_residual(self) -> float:
        """Largest entry of the residual [px]."""
        return float(np.abs(self.residual).max())


@dataclass(frozen=True, eq=False)
class Goals:
    """The pose of least image error, and the one nearest to home whose image error is hardly larger."""

    scene: Scene
    best: GoalPose

    @cached_property
    def nearest(self) -> GoalPose:
        """The pose nearest to home that leaves no feature more than `TOLERANCE` further off than `best` leaves one."""
        return _nearest(self.scene, self.best)

    @property
    def reachable(self) -> bool:
        """Whether a pose with the goal image was found, within `inexact`."""
        return self.best.largest_residual <= inexact(self.scene.band)

    @property
    def shown_at(self) -> Poses | None:
        """The pose with the goal image, within `inexact`; None if none was found."""
        return self.best.view.pose if self.reachable else None


@lru_cache(maxsize=8)  # several parts of an analysis ask
def find_goals(scene: Scene) -> Goals | None:
    """Find the pose with the goal image (docs/analysis/conditioning.md).

    `best` is searched by the core (`_core.Probe.goal_minima`) and, where that leaves a coordinate of a feature more
    than `TOLERANCE` off, from 64 poses of `Scene.spread`. Of poses that show the goal image to `SHOWN` it
    is the one nearest to home, otherwise the one with the least sum of squared image errors. `nearest` has the least
    sqrt(|shift|^2 + (r_p |turn|)^2), with r_p the platform's radius, among poses near the way from home to `best` that
    leave no coordinate more than `TOLERANCE` further from its goal than `best` leaves one. A local search: it may miss
    poses, and proves nothing of those it does not find.

    Returns
    -------
        None for a camera as printed, which has no points and so no pose that shows an image.
    """
    if not scene.has_points:
        return None
    found = Poses(*scene.probe.goal_minima())
    if not (scene.residual(found) <= TOLERANCE).any():
        found = Poses.joined(found, nearest_images(scene, scene.spread(64, seed=0), rounds=60))
    if not np.isfinite(scene.residual(found)).any():
        found = scene.home.rows  # where the points are seen, as a scenario requires
    largest = scene.residual(found)
    if (largest < SHOWN).any():
        away = np.linalg.norm(found.displacement_from(scene.home) / scene.unit, axis=1)
        best = int(np.argmin(np.where(largest < SHOWN, away, np.inf)))
    else:
        best = int(np.nanargmin(((scene.desired - scene.image(found)[0]) ** 2).sum(axis=1)))
    return Goals(scene, _goal(scene, found[best]))


def nearest_images(scene: Scene, starts: Poses, weights: Array | None = None, rounds: int = 30) -> Poses:
    """Find nearby minima of the weighted image error: Levenberg-Marquardt, from all starts (n,) at once.

    Minimises sum_k w_k (xi_d - xi)_k^2 [px^2]. A step that would raise it, or take a point behind the camera, is
    refused and shortened. What a start reaches is a local minimum, or where the rounds end.
    """
    root = np.ones(len(scene.desired)) if weights is None else np.sqrt(weights / weights.max())
    poses, damping = starts, np.full(len(starts), 1e-2)
    features, depth = scene.image(poses)
    error = root * (scene.desired - features)
    cost = np.nan_to_num((error**2).sum(axis=1), nan=np.inf)
    for _ in range(rounds):
        seen = np.isfinite(cost)
        if not seen.any():
            break
        slope = np.zeros((*features.shape, 6))
        slope[seen] = scene.jacobian(features[seen], depth[seen], poses[seen]) * root[:, None] * scene.unit
        normal = slope.transpose(0, 2, 1) @ slope
        largest = np.maximum(np.einsum("nii->ni", normal).max(axis=1), 1e-300)
        normal += (damping * largest)[:, None, None] * np.eye(6)
        pull = np.einsum("nkj,nk->nj", slope, np.where(seen[:, None], error, 0.0))
        step = np.linalg.solve(normal, pull[..., None])[..., 0]
        tried = poses.moved(limited(step) * scene.unit)
        tried_features, tried_depth = scene.image(tried)
        tried_error = root * (scene.desired - tried_features)
        tried_cost = np.nan_to_num((tried_error**2).sum(axis=1), nan=np.inf)
        better = tried_cost < cost
        poses, cost = poses.chosen(better, tried), np.where(better, tried_cost, cost)
        rows = better[:, None]
        features, depth = np.where(rows, tried_features, features), np.where(rows, tried_depth, depth)
        error = np.where(rows, tried_error, error)
        damping = np.where(better, np.maximum(damping / 10, 1e-15), np.minimum(damping * 5, 1e3))
    return poses


def limited(step: Array) -> Array:
    """Shorten the steps of a search, (n, 6) in units of `Scene.unit`, so that the image changes little."""
    longest = np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300)
    return np.asarray(step * np.minimum(1.0, _STEP / longest))


def _nearest(scene: Scene, best: GoalPose) -> GoalPose:
    """Minimise the distance from home within the tolerance: sequential quadratic programming from `best`."""
    from scipy.optimize import minimize

    allowed = best.largest_residual + TOLERANCE
    metric = scene.levers
    unit = float(np.linalg.norm(metric * best.displacement))  # [m]
    if unit <= 1e-12 * scene.depth:  # home shows the goal image
        return best

    def room(x: Array) -> Array:  # (4p,), in units of what is allowed
        features, _ = scene.image(scene.home.moved(unit * x / metric))
        # a large one where a point is behind the camera, which no search steps to
        error = scene.desired - features if np.isfinite(features).all() else np.full(len(scene.desired), _UNSEEN)
        return 1.0 - np.concatenate([error, -error]) / allowed

    def room_slope(x: Array) -> Array:
        displacement = unit * x / metric
        rows = -scene.view(scene.home.moved(displacement)).jacobian
        rows[:, 3:] = rows[:, 3:] @ _turn_rate(displacement[3:])
        rows *= unit / metric
        return -np.vstack([rows, -rows]) / allowed

    found = minimize(
        lambda x: x @ x,
        metric * best.displacement / unit,
        jac=lambda x: 2 * x,
        method="SLSQP",
        constraints={"type": "ineq", "fun": room, "jac": room_slope},
        options={"ftol": 1e-10, "maxiter": 100},
    )
    nearest = _goal(scene, scene.home.moved(unit * found.x / metric))
    # NaN, where a point is not seen, compares as false
    kept = nearest.largest_residual <= allowed * (1 + 1e-6) and found.x @ found.x <= 1.0
    return nearest if kept else best


def _goal(scene: Scene, pose: Poses) -> GoalPose:
    view = scene.view(pose)
    return GoalPose(view, pose.displacement_from(scene.home), scene.desired - view.features)


def _turn_rate(turn: Array) -> Array:
    """Return the matrix from the rate of a rotation vector to the angular velocity, both in B, (3, 3).

    I + (1 - cos a)/a^2 S + (a - sin a)/a^3 S^2, with a = |turn| and S the matrix of turn x.
    """
    angle = float(np.linalg.norm(turn))
    cross = np.cross(np.eye(3), turn)  # row i is e_i x turn, hence turn x as a matrix
    if angle < 1e-4:  # the series: what it leaves out is below rounding
        return np.eye(3) + 0.5 * cross + cross @ cross / 6.0
    one, two = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + one * cross + two * cross @ cross)
