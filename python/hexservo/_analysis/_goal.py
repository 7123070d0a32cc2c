"""The pose, or the poses, that show the goal image: least squares on the core's projection."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hexservo._analysis._scene import Array, Scene, View, moved

__all__ = ["TOLERANCE", "Goal", "Goals", "find_goals"]

TOLERANCE = 0.1  # [px], how far the nearest pose may leave a feature from what the best pose reaches
_UNSEEN = 1e5  # [px], stands for the image of a pose that has a point behind the camera


@dataclass(frozen=True, eq=False)
class Goal:
    """A pose that shows the goal image, or is as close to it as any near it."""

    view: View
    displacement: Array  # (6,) from home [m; rad]: difference of the positions, rotation vector, both in B
    residual: Array  # (8,) [px], desired minus seen

    @property
    def largest_residual(self) -> float:
        """Largest entry of the residual [px]."""
        return float(np.abs(self.residual).max())


@dataclass(frozen=True, eq=False)
class Goals:
    """The pose of least image error, and the one nearest to home whose image error is hardly larger."""

    best: Goal
    nearest: Goal

    @property
    def reachable(self) -> bool:
        """Whether some pose shows the goal image, to 1e-6 px."""
        return self.best.largest_residual < 1e-6


@lru_cache(maxsize=8)  # several parts of an analysis ask
def find_goals(scene: Scene) -> Goals | None:
    """Find where the camera sees the goal image (docs/analysis/conditioning.md).

    `best` has the least sum of squared image errors, searched from home, and, where that leaves more than
    `TOLERANCE`, from home turned about the optical axis in eighths as well. `nearest` has the least
    sqrt(|shift|^2 + (r_p |turn|)^2), with r_p the platform's radius, among poses near the way from home to `best`
    that leave no coordinate of a feature more than `TOLERANCE` further from its goal than `best` leaves one. A local
    search: it may miss poses, and proves nothing of those it does not find.

    Returns
    -------
        None for a camera as printed, which has no points and so no pose that shows an image.
    """
    if not scene.has_points:
        return None
    best = _least_squares(scene, np.zeros(6))
    if best.largest_residual > TOLERANCE:
        for eighths in (1, -1, 2, -2, 3, -3, 4):
            start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, eighths * np.pi / 4])
            other = _least_squares(scene, start)
            if other.residual @ other.residual < best.residual @ best.residual:
                best = other
            if best.largest_residual <= TOLERANCE:
                break
    return Goals(best, _nearest(scene, best))


def _nearest(scene: Scene, best: Goal) -> Goal:
    """Minimise the way from home under the tolerance: sequential quadratic programs from `best`."""
    from scipy.optimize import minimize

    allowed = best.largest_residual + TOLERANCE
    metric = np.repeat([1.0, scene.platform_radius], 3)  # [m; m/rad]
    unit = float(np.linalg.norm(metric * best.displacement))  # [m]
    if unit == 0.0:  # home shows the goal image
        return best

    def room(x: Array) -> Array:  # (16,), in units of what is allowed
        error = _error(scene, unit * x / metric)
        return 1.0 - np.concatenate([error, -error]) / allowed

    def room_slope(x: Array) -> Array:
        rows = _slope(scene, unit * x / metric) * (unit / metric)
        return -np.vstack([rows, -rows]) / allowed

    found = minimize(
        lambda x: x @ x,
        metric * best.displacement / unit,
        jac=lambda x: 2 * x,
        method="SLSQP",
        constraints={"type": "ineq", "fun": room, "jac": room_slope},
        options={"ftol": 1e-10, "maxiter": 100},
    )
    nearest = _at(scene, unit * found.x / metric)
    kept = nearest.largest_residual <= allowed * (1 + 1e-6) and found.x @ found.x <= 1.0
    return nearest if kept and (nearest.view.depth < 0).all() else best


def _least_squares(scene: Scene, start: Array) -> Goal:
    """Minimise |image error|^2 [px^2] over displacements from home."""
    from scipy.optimize import least_squares

    depth = scene.view(scene.home).mean_depth
    found = least_squares(
        lambda d: _error(scene, d),
        start,
        lambda d: _slope(scene, d),
        x_scale=np.repeat([depth, 1.0], 3),
        method="lm",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
        max_nfev=100,
    )
    return _at(scene, found.x)


def _at(scene: Scene, displacement: Array) -> Goal:
    view = scene.view(moved(scene.home, displacement))
    return Goal(view, displacement, scene.desired - view.features)


def _error(scene: Scene, displacement: Array) -> Array:
    """Give the image error, (8,) [px]; a large one where a point is behind the camera, which no search steps to."""
    view = scene.view(moved(scene.home, displacement))
    return scene.desired - view.features if (view.depth < 0).all() else np.full(8, _UNSEEN)


def _slope(scene: Scene, displacement: Array) -> Array:
    """Give the derivative of the image error by the displacement, (8, 6)."""
    rows = -scene.view(moved(scene.home, displacement)).jacobian
    rows[:, 3:] = rows[:, 3:] @ _turn_rate(displacement[3:])
    return rows


def _turn_rate(turn: Array) -> Array:
    """Give the matrix that takes the rate of a rotation vector to the angular velocity, both in B, (3, 3).

    I + (1 - cos a)/a^2 S + (a - sin a)/a^3 S^2, with a = |turn| and S the matrix of turn x.
    """
    angle = float(np.linalg.norm(turn))
    cross = np.cross(np.eye(3), turn)  # row i is e_i x turn, hence turn x as a matrix
    if angle < 1e-4:  # the series: what it leaves out is below rounding
        return np.eye(3) + 0.5 * cross + cross @ cross / 6.0
    one, two = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + one * cross + two * cross @ cross)
