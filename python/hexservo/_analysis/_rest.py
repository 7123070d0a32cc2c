"""A platform at rest at many poses at once: what camera, law and plant of a scenario give there, asked of the core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexservo import _core
from hexservo._parameters import Settings, core_parameters
from hexservo._scenario import Scenario

__all__ = ["SHOWN", "WIDER", "Array", "Mask", "Poses", "Rest", "direction_words"]

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]

SHOWN = 1e-6  # [px], an image this close to the goal is the goal
# Half widths of the region about home that is searched beside the workspace [mean depth; rad].
WIDER = np.array([0.7, 0.7, 0.7, 0.6, 0.6, np.pi])

_STEP = 0.3  # longest step of a search, in mean depths and radians: keeps it where the image is nearly what it was
_NEAR = 0.02  # of the mean depth: a search does not take a point closer to the camera than this


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of E in B, one per row."""

    position: Array  # (n, 3) [m]
    quaternion: Array  # (n, 4) w x y z, of unit length

    def __len__(self) -> int:
        """Give the number of poses."""
        return len(self.position)

    def __getitem__(self, rows: slice | Mask | NDArray[np.int_] | list[int]) -> Poses:
        """Give some of them."""
        return Poses(self.position[rows], self.quaternion[rows])

    def moved(self, displacement: Array) -> Poses:
        """Shift by the first three columns [m], turn about E's origin by the rotation vectors [rad]; both in B."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_rotvec(displacement[:, 3:]) * Rotation.from_quat(np.roll(self.quaternion, -1, axis=1))
        return Poses(self.position + displacement[:, :3], np.roll(turned.as_quat(), 1, axis=1))

    def displacement_from(self, other: Poses) -> Array:
        """Give what `moved` takes from `other` (n or 1 poses) to these, (n, 6) [m; rad]."""
        from scipy.spatial.transform import Rotation

        own, start = (Rotation.from_quat(np.roll(poses.quaternion, -1, axis=1)) for poses in (self, other))
        return np.hstack([self.position - other.position, (own * start.inv()).as_rotvec()])

    def repeated(self, count: int) -> Poses:
        """Give one pose several times."""
        return Poses(np.repeat(self.position, count, axis=0), np.repeat(self.quaternion, count, axis=0))

    def chosen(self, rows: Mask, others: Poses) -> Poses:
        """Give the other's pose in the rows that are True, one's own elsewhere."""
        return Poses(
            np.where(rows[:, None], others.position, self.position),
            np.where(rows[:, None], others.quaternion, self.quaternion),
        )

    @staticmethod
    def joined(*parts: Poses) -> Poses:
        """Put poses one after the other."""
        return Poses(np.vstack([p.position for p in parts]), np.vstack([p.quaternion for p in parts]))


class Rest:
    """Camera, law and plant of a scenario, at poses where nothing moves.

    Parameters
    ----------
    scenario
        Whose law acts with the weights that it starts with.
    gravity
        Part of the gravity error that acts [1].

    Raises
    ------
    ValueError
        For a scenario that the core refuses (`core_parameters`), and for a camera `as_printed`, which has no points.
    """

    def __init__(self, scenario: Scenario, gravity: float = 1.0) -> None:
        self.settings: Settings = core_parameters(scenario)
        if self.settings.convention != _core.CameraConvention.eye_in_hand:
            raise ValueError('camera.convention: expected "eye_in_hand", got "as_printed"')
        dynamics = self.settings.uncertainty.dynamics
        dynamics.gravity = gravity * dynamics.gravity
        self.probe = _core.Probe(self.settings)
        self.hexapod = _core.Hexapod(self.settings.robot)
        self.desired: Array = np.array(self.settings.target.desired_features)  # (8,) [px]
        self.home = Poses(np.array(self.hexapod.home_position)[None], np.array([[1.0, 0.0, 0.0, 0.0]]))
        self.depth = float(np.abs(self.probe.image(self.home.position, self.home.quaternion)[1]).mean())  # [m], of home
        self.gains: Any = _gains(self.settings)  # of the scenario's law
        self.unit: Array = np.repeat([self.depth, 1.0], 3)  # [m; rad]: moves the image alike in all six directions

    def image(self, poses: Poses) -> tuple[Array, Array]:
        """Give the true features (n, 8) [px] and Z (n, 4) [m]; NaN where a point is not well in front of the camera."""
        features, depth = self.probe.image(poses.position, poses.quaternion)
        seen = np.asarray((depth < -_NEAR * self.depth).all(axis=1) & np.isfinite(features).all(axis=1))
        return np.where(seen[:, None], features, np.nan), np.where(seen[:, None], depth, np.nan)

    def jacobian(self, features: Array, depth: Array, poses: Poses) -> Array:
        """Give J, (n, 8, 6), twist in B to feature rates, of images that are seen; depths as given."""
        return self.probe.image_jacobian(features, depth, poses.quaternion)

    def acceleration(self, poses: Poses, twist: Array | None = None) -> Array:
        """Give chi-ddot of the plant under the law, (n, 6) [m/s^2; rad/s^2], at rest or at twists (n, 6) in B.

        NaN where the camera does not see all points. Zero at rest: an equilibrium.
        """
        features, depth = self.image(poses)
        seen = np.asarray(np.isfinite(features).all(axis=1))
        result = np.full((len(poses), 6), np.nan)
        if seen.any():
            there = poses[seen]
            speed = np.zeros((len(there), 6)) if twist is None else twist[seen]
            believed = self.probe.measured_depth(depth[seen])
            wrench = self.probe.law(features[seen], believed, there.position, there.quaternion, speed).wrench
            result[seen] = self.probe.acceleration(there.position, there.quaternion, speed, wrench)
        return result

    def stiffness(self, poses: Poses, step: float = 1e-6) -> Array:
        """Give minus the derivative of `acceleration` by a displacement, (n, 6, 6) [1/s^2], in `unit` on both sides.

        Central differences: with steps near 1e-6 truncation and rounding leave about 1e-12 of the largest entry.
        """
        count = len(poses)
        moves = step * np.vstack([np.eye(6), -np.eye(6)]) * self.unit
        # all twelve neighbours of every pose in one call
        around = Poses(np.repeat(poses.position, 12, axis=0), np.repeat(poses.quaternion, 12, axis=0))
        found = self.acceleration(around.moved(np.tile(moves, (count, 1)))).reshape(count, 12, 6) / self.unit
        return np.asarray(-(found[:, :6] - found[:, 6:]).transpose(0, 2, 1) / (2 * step))

    def leg_travel(self, poses: Poses) -> Array:
        """Give how much longer each leg is than at home, (n, 6) [m]."""
        pairs = zip(poses.position, poses.quaternion, strict=True)
        return np.asarray([self.hexapod.leg_lengths(*pose) for pose in pairs] - self.hexapod.home_lengths)

    def reachable(self, poses: Poses) -> Mask:
        """Tell which poses are within the stroke and on home's side of the singular poses (the sign of det H)."""

        def side(of: Poses) -> Array:
            pairs = zip(of.position, of.quaternion, strict=True)
            return np.asarray(np.sign(np.linalg.det([self.hexapod.wrench_map(*pose) for pose in pairs])))

        within = np.abs(self.leg_travel(poses)).max(axis=1) <= self.settings.robot.stroke
        return np.asarray(within & (side(poses) == side(self.home)))

    def nearest_images(self, starts: Poses, weights: Array | None = None, rounds: int = 30) -> Poses:
        """Go down to the nearest poses of least weighted image error: Levenberg-Marquardt, all starts at once.

        Minimises sum_k w_k (xi_d - xi)_k^2 [px^2]. A step that would raise it, or take a point behind the camera, is
        refused and shortened. What a start reaches is a local minimum, or where the rounds end.
        """
        root = np.ones(8) if weights is None else np.sqrt(weights / weights.max())
        poses, damping = starts, np.full(len(starts), 1e-2)
        features, depth = self.image(poses)
        error = root * (self.desired - features)
        cost = np.nan_to_num((error**2).sum(axis=1), nan=np.inf)
        for _ in range(rounds):
            seen = np.isfinite(cost)
            if not seen.any():
                break
            slope = np.zeros((len(poses), 8, 6))
            slope[seen] = self.jacobian(features[seen], depth[seen], poses[seen]) * root[:, None] * self.unit
            normal = slope.transpose(0, 2, 1) @ slope
            largest = np.maximum(np.einsum("nii->ni", normal).max(axis=1), 1e-300)
            normal += (damping * largest)[:, None, None] * np.eye(6)
            pull = np.einsum("nkj,nk->nj", slope, np.where(seen[:, None], error, 0.0))
            step = np.linalg.solve(normal, pull[..., None])[..., 0]
            tried = poses.moved(_limited(step) * self.unit)
            tried_features, tried_depth = self.image(tried)
            tried_error = root * (self.desired - tried_features)
            tried_cost = np.nan_to_num((tried_error**2).sum(axis=1), nan=np.inf)
            better = tried_cost < cost
            poses, cost = poses.chosen(better, tried), np.where(better, tried_cost, cost)
            rows = better[:, None]
            features, depth = np.where(rows, tried_features, features), np.where(rows, tried_depth, depth)
            error = np.where(rows, tried_error, error)
            damping = np.where(better, np.maximum(damping / 10, 1e-15), np.minimum(damping * 5, 1e3))
        return poses

    def settled(self, starts: Poses, rounds: int = 10) -> tuple[Poses, Mask]:
        """Look for equilibria by Newton's method from each start, and tell which converged (last step below 1e-8)."""
        poses, last = starts, np.full(len(starts), np.inf)
        for _ in range(rounds):
            slope, value = self.stiffness(poses), self.acceleration(poses) / self.unit
            usable = np.isfinite(slope).all(axis=(1, 2)) & np.isfinite(value).all(axis=1)
            slope[~usable], value[~usable] = np.eye(6), 0.0
            usable &= np.linalg.cond(slope) < 1e14  # beyond, a step is rounding
            slope[~usable] = np.eye(6)
            step = np.where(usable[:, None], np.linalg.solve(slope, value[..., None])[..., 0], 0.0)
            last = np.where(usable, np.abs(step).max(axis=1), np.inf)
            poses = poses.moved(_limited(step) * self.unit)
        return poses, last < 1e-8

    def spread(self, count: int, seed: int) -> Poses:
        """Draw poses, at most `count`, that see all points, even over `WIDER` about home, within the stroke or not."""
        moves = np.random.default_rng(seed).uniform(-1.0, 1.0, (8 * count, 6)) * WIDER * self.unit
        poses = self.home.repeated(len(moves)).moved(moves)
        return poses[np.flatnonzero(np.isfinite(self.image(poses)[0]).all(axis=1))[:count]]

    def goal(self) -> Poses | None:
        """Give the pose, one row, that shows the goal image to 1e-6 px; None where the search finds none.

        Searched from home, from home turned about the optical axis in eighths, and, where these do not show it, from 64
        poses of `spread`; of several the one nearest to home.
        """
        turns = np.zeros((8, 6))
        turns[:, 5] = np.pi / 4 * np.array([0, 1, -1, 2, -2, 3, -3, 4])
        for starts in (self.home.repeated(8).moved(turns), self.spread(64, seed=0)):
            found = self.nearest_images(starts, rounds=60)
            shown = np.flatnonzero(self.residual(found) < SHOWN)
            if len(shown):
                away = np.linalg.norm(found[shown].displacement_from(self.home) / self.unit, axis=1)
                return found[shown[[int(np.argmin(away))]]]
        return None

    def residual(self, poses: Poses) -> Array:
        """Give the largest |xi_d - xi|, (n,) [px]; NaN where a point is not seen."""
        return np.asarray(np.abs(self.desired - self.image(poses)[0]).max(axis=1))


def _gains(settings: Settings) -> Any:
    return settings.gains


def _limited(step: Array) -> Array:
    """Shorten steps (n, 6), in units of `Rest.unit`, to `_STEP`."""
    longest = np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300)
    return np.asarray(step * np.minimum(1.0, _STEP / longest))


def direction_words(displacement: Array, depth: float) -> str:
    """Say in words a direction (6,) [m; rad] in B, of any length and sign, for a target at a depth [m].

    A part that moves the image less than 3 % of the other one is left out.
    """
    shift, turn = np.linalg.norm(displacement[:3]), np.linalg.norm(displacement[3:])
    if turn * depth < 0.03 * shift:
        return f"a shift along {_axis_words(displacement[:3] / shift)}"
    if shift < 0.03 * turn * depth:
        return f"a turn about {_axis_words(displacement[3:] / turn)}"
    return (
        f"10 mm along {_axis_words(displacement[:3] / shift)} with "
        f"{10 * turn / shift:.3g} mrad about {_axis_words(displacement[3:] / turn)}"
    )


def _axis_words(axis: Array) -> str:
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > 0.995:
        return ("-" if axis[largest] < 0 else "") + "xyz"[largest]
    return "(" + ", ".join(f"{part:+.2f}" for part in axis) + ")"
