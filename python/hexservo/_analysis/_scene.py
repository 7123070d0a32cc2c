"""What the camera of a scenario sees from a pose, asked of the core: shared by the analyses that need no run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexservo import _core
from hexservo._parameters import Settings, core_parameters
from hexservo._scenario import Scenario

__all__ = ["Array", "Pose", "Scene", "View", "moved", "scene_of"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """Place and attitude of E in B."""

    position: Array  # (3,) [m]
    quaternion: Array  # (4,) w x y z, of unit length


@dataclass(frozen=True, eq=False)
class View:
    """What the camera sees from a pose, with the true image Jacobian there."""

    pose: Pose
    features: Array  # (8,) [px]
    depth: Array  # (4,) [m], negative in front of the camera
    jacobian: Array  # (8, 6), twist in B to feature rates [px/s per m/s; px/s per rad/s]

    @property
    def mean_depth(self) -> float:
        """Mean distance of the points along the optical axis [m]."""
        return float(np.abs(self.depth).mean())


def moved(pose: Pose, displacement: Array) -> Pose:
    """Give the pose after a displacement: shifted by its first three entries [m], turned by the rotation vector [rad].

    Both are in B, and the platform turns about its own origin.
    """
    turn = displacement[3:]
    angle = float(np.sqrt(turn @ turn))
    x, y, z = (0.5 * float(np.sinc(angle / (2 * np.pi))) * turn).tolist()  # sin(angle/2)/angle, also at zero
    w = float(np.cos(angle / 2))
    a, b, c, d = pose.quaternion.tolist()
    quaternion = np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ]
    )
    return Pose(pose.position + displacement[:3], quaternion / np.sqrt(quaternion @ quaternion))


class Scene:
    """A scenario in the core's terms: robot, camera, target and goal.

    Raises
    ------
    ValueError
        For a scenario that the core refuses (`core_parameters`).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.settings: Settings = core_parameters(scenario)
        self.camera = self.settings.camera
        self.hexapod = _core.Hexapod(self.settings.robot)
        self.home = Pose(np.array(self.hexapod.home_position), np.array([1.0, 0.0, 0.0, 0.0]))
        self.desired: Array = np.array(self.settings.target.desired_features)  # (8,) [px]
        self.platform_radius = float(self.settings.robot.platform_radius)  # [m]

    @property
    def has_points(self) -> bool:
        """Whether there are points in space; a camera as printed integrates features and depths instead."""
        return self.settings.convention == _core.CameraConvention.eye_in_hand

    @cached_property
    def points(self) -> Array:
        """The target's points in B, (4, 3) [m].

        Where the scenario gives features and depths, the core's projection of points beside the optical axis tells how
        many pixels a metre is at each depth.
        """
        target = self.settings.target
        if target.points is not None:
            return np.array(target.points)
        return self.points_seen_as(np.array(target.initial_features), -np.array(target.depth))

    def points_seen_as(self, features: Array, depth: Array) -> Array:
        """Give the points in B, (4, 3) [m], that look so from home: features (8,) [px], depth (4,) [m], negative."""
        beside = np.column_stack([np.ones((4, 2)), depth])  # in E, one metre off the axis each way
        scale, _ = _core.take_image(self.camera, self.home.position, self.home.quaternion, self.home.position + beside)
        lateral = features.reshape(4, 2) / scale.reshape(4, 2)
        return self.home.position + np.column_stack([lateral, depth])

    def view(self, pose: Pose) -> View:
        """Look at the target from a pose; the camera has points, or the pose is home."""
        if self.has_points:
            features, depth = _core.take_image(self.camera, pose.position, pose.quaternion, self.points)
        else:
            target = self.settings.target
            features, depth = np.array(target.initial_features), -np.array(target.depth)
        return View(pose, features, depth, self.jacobian(features, depth, pose.quaternion))

    def jacobian(self, features: Array, depth: Array, quaternion: Array) -> Array:
        """Give the true image Jacobian, (8, 6), with the plant's sign."""
        return _core.image_jacobian(self.camera, features, depth, quaternion, self.settings.convention)

    def leg_travel(self, pose: Pose) -> Array:
        """Give how much longer each leg is than at home, (6,) [m]."""
        return self.hexapod.leg_lengths(pose.position, pose.quaternion) - self.hexapod.home_lengths


@lru_cache(maxsize=8)  # several parts of an analysis ask
def scene_of(scenario: Scenario) -> Scene:
    """Give a scenario in the core's terms."""
    return Scene(scenario)
