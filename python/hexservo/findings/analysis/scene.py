"""Image and leg lengths of a scenario at poses, computed by the core."""

from __future__ import annotations

import copyreg
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.image_estimate import rows_of_estimate
from hexservo.findings.analysis.poses import Poses
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.fitted import Machine, machine_of
from hexservo.scenario.leg_units import leg_units, stroke_length
from hexservo.scenario.motion import moves
from hexservo.scenario.parameters import Settings, core_parameters
from hexservo.scenario.pixels import desired_features, feature_noise, has_pixels, pixel_slopes, to_features, to_pixels
from hexservo.scenario.scenario import Scenario

# Half widths of the region about home that is searched beside the workspace [mean depth; rad].
WIDER = np.array([0.7, 0.7, 0.7, 0.6, 0.6, np.pi])

# Direction of a small start that moves all six axes, in `Scene.unit`.
ALL_AXES = np.array([1.0, -0.8, 0.6, 0.9, 0.7, -1.0])

# Changes of a scenario whose run starts at home, at rest, whatever start it has.
AT_HOME = {"simulation.start.pose": [0.0] * 6, "simulation.start.twist": [0.0] * 6}
AT_REST = dict.fromkeys(("base_motion.kind", "base_motion.rotation.kind", "target.motion.kind"), "none")

_ROUNDING = 1e-9  # of the stroke: a leg at its very end is within
_SMALL = 0.01  # of the mean depth: a motion that is shown as an example
_NEAR = 0.02  # of the depth of home's nearest point: no search takes a point closer to the camera than this


@dataclass(frozen=True, eq=False)
class View:
    """Image from a pose, with the true image Jacobian there; NaN where not all points are in view."""

    pose: Poses
    features: Array  # (2p,) of p points [px]
    depth: Array  # (p,) [m], negative in front of the camera
    jacobian: Array  # (2p, 6), twist in B to feature rates [px/s per m/s; px/s per rad/s]

    @property
    def mean_depth(self) -> float:
        """Mean distance of the points along the optical axis [m]."""
        return float(np.abs(self.depth).mean())

    def after(self, way: Array, offset: float) -> Array:
        """Return the features (2p,) [px] after a small move along a direction (6,), the farthest by an offset [px]."""
        shift = self.jacobian @ way
        return np.asarray(self.features + shift * offset / np.abs(shift).max())


class Scene:
    """A scenario in the core's terms: robot, camera, target and goal. Poses may be one or many (`Poses`).

    Raises
    ------
    ValueError
        For a scenario that the core refuses (`core_parameters`).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.settings: Settings = core_parameters(scenario)
        self.probe = _core.Probe(self.settings)
        self.camera = self.settings.camera
        self.hexapod = _core.Hexapod(self.settings.robot)
        self.home = Poses(np.array(self.hexapod.home_position), np.array(self.hexapod.home_quaternion))
        # where a run starts: home, unless the scenario has another start
        self.start = self.home.moved(np.array(self.settings["simulation.start.pose"]))
        self.desired: Array = desired_features(scenario)  # (2p,) [px]
        self.platform_radius: float = self.hexapod.platform_radius  # [m]
        self.stroke: float = self.settings["robot.stroke"]  # [m], of rotary legs [rad]
        self.stroke_length = stroke_length(scenario.robot)  # [m], about how far the stroke moves a platform joint
        self.units = leg_units(scenario.robot)
        self.joint_limit: Array | None = self.settings["robot.joint_limit"]  # (2,) [rad], at base and platform
        self.band: float = self.settings["metrics.band"]  # [px], of settling
        from_home = np.abs(self._image_of_home()[1])
        self.depth = float(from_home.mean())  # [m], of home
        self._nearest = _NEAR * float(from_home.min())
        self.unit: Array = np.repeat([self.depth, 1.0], 3)  # [m; rad]: moves the image alike in all six directions

    @cached_property
    def machine(self) -> Machine:
        """What gains of the scenario depend on."""
        return machine_of(self.scenario)

    @cached_property
    def unusual_body(self) -> str:
        """Why what is analysed at rest does not hold for the platform's mass; empty where it does."""
        body, plant = self.body, self.settings.plant_body
        level = (np.array(body.gravity_wrench), np.array(plant.gravity_wrench))
        if np.any(body.centre_of_mass) or np.any(plant.centre_of_mass):
            keys = " and ".join(keys_of_centre(self.scenario))
            return (
                f"The centre of mass is not in the platform's origin ({keys}), and the moment of its weight is not "
                "analysed."
            )
        if not np.array_equal(*level) or not np.array_equal(body.inertia, plant.inertia):
            return "The platform has a payload that the controller does not know, which is not analysed."
        return ""

    @cached_property
    def settled_start(self) -> float | None:
        """Largest |xi(0) - xi_d| [px] where it is in the settling band before anything moves; None where it is not.

        None too where staying there is a result (`has_to_hold`).
        """
        if has_to_hold(self.scenario):
            return None
        error = float(np.abs(self.view(self.start).features - self.desired).max())
        return error if error <= self.band else None

    @cached_property
    def moving_target(self) -> str:
        """Why what takes the target for fixed in B does not hold; empty where it does."""
        base, target = self.scenario.base_motion, self.scenario.target
        if target.motion.kind != "none":
            return "The target moves, so that no energy belongs to the error of its image."
        if target.frame == "world" and moves(base):
            return "The target rests while the base moves, so that no energy belongs to the error of its image."
        return ""

    @property
    def levers(self) -> Array:
        """How far a platform joint moves by a displacement, axis by axis, at most, (6,) [1; m/rad]."""
        return np.repeat([1.0, self.platform_radius], 3)

    @property
    def small_shift(self) -> float:
        """A shift [m] of the size in which motions are shown.

        The power of ten nearest to 1 % of the depth, or the largest one within the stroke where that is less.
        """
        by_depth, by_stroke = np.log10([_SMALL * self.depth, self.stroke_length])
        return float(10.0 ** min(np.round(by_depth), np.floor(by_stroke)))

    @property
    def has_points(self) -> bool:
        """Whether there are points in space; a camera as printed integrates features and depths instead."""
        return bool(self.settings["camera.convention"] == "eye_in_hand")

    @cached_property
    def points(self) -> Array:
        """The target's points in B, or in E where the camera is on the base, (p, 3) [m]."""
        points: Array | None = self.settings["target.points"]
        if points is not None:
            return points
        return self.points_seen_as(self._initial, -self.settings["target.depth"])

    @property
    def _initial(self) -> Array:
        """The features of the target from home where the scenario has them, (2p,) [px]."""
        return to_features(self.scenario, self.settings["target.initial_features"])

    @cached_property
    def body(self) -> _core.RigidBody:
        """The platform's estimated mass properties."""
        return self.settings.body

    def points_seen_as(self, features: Array, depth: Array) -> Array:
        """Return `points`, (p, 3) [m], with this image from home: features (2p,) [px], depth (p,) [m], negative."""
        return _core.lift(self.camera, self.home.position, self.home.quaternion, features, depth)

    def _image_of_home(self) -> tuple[Array, Array]:
        """Return the true features (2p,) [px] and Z (p,) [m] at the start."""
        if self.has_points:
            features, depth = self.probe.image(self.home.rows.position, self.home.rows.quaternion)
            return features[0], depth[0]
        return self._initial, -self.settings["target.depth"]

    def image(self, poses: Poses) -> tuple[Array, Array]:
        """Return the true features (..., 2p) [px] and Z (..., p) [m]; NaN where a point is not well in front.

        Raises
        ------
        ValueError
            For a camera as printed, which has no points.
        """
        rows = poses.rows
        features, depth = self.probe.image(rows.position, rows.quaternion)
        seen = np.asarray((depth < -self._nearest).all(axis=1) & np.isfinite(features).all(axis=1))
        features, depth = np.where(seen[:, None], features, np.nan), np.where(seen[:, None], depth, np.nan)
        return features.reshape(*poses.shape, features.shape[-1]), depth.reshape(*poses.shape, depth.shape[-1])

    def pixels(self, poses: Poses) -> Array:
        """Return the image as pixels of the scenario's camera, (..., 2p) [px], as goals are written; NaN as `image`.

        NaN as well where the lens does not show a point.
        """
        return to_pixels(self.scenario, self.image(poses)[0])

    def view(self, pose: Poses) -> View:
        """Return the view from one pose; the camera has points, or the pose is home."""
        features, depth = self.image(pose) if self.has_points else self._image_of_home()
        seen = np.isfinite(features).all()
        jacobian = self.jacobian(features, depth, pose) if seen else np.full((*features.shape, 6), np.nan)
        return View(pose, features, depth, jacobian)

    def jacobian(self, features: Array, depth: Array, poses: Poses, *, assumed: bool = False) -> Array:
        """Return the true image Jacobian (..., 2p, 6), with the plant's sign, of images in view; depths as given.

        With `assumed` it is J-hat, which the controller forms with its own camera, mount and sign.
        """
        at = poses.rows
        found = self.probe.image_jacobian(
            features.reshape(-1, features.shape[-1]),
            depth.reshape(-1, depth.shape[-1]),
            at.quaternion,
            assumed,
            at.position,
        )
        return found.reshape(*features.shape, 6)

    def residual(self, poses: Poses) -> Array:
        """Return the largest |xi_d - xi|, (...) [px]; NaN where a point is not seen."""
        return np.asarray(np.abs(self.desired - self.image(poses)[0]).max(axis=-1))

    def optical_axis(self, pose: Poses) -> Array:
        """Return the camera's z axis at one pose of the platform, (3,) in B; that of a camera on the base stays."""
        ends = self.camera.in_mount(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
        if self.scenario.camera.mount.on == "platform":
            ends = pose.carried(ends)
        return np.asarray(ends[1] - ends[0])

    def leg_travel(self, poses: Poses) -> Array:
        """Return how much longer each leg is than in the middle of its travel, (..., 6) [m]; that is home as a rule.

        Of rotary legs angles [rad], infinite where a crank does not close.
        """
        found = _at_each(self.hexapod.leg_travel, poses, 6)
        return np.where(np.isnan(found), np.inf, found)

    def lever_arms(self, poses: Poses) -> Array:
        """Return how far rotary legs are from having crank and rod in line, (..., 6): |w_i|/r, 0 where they are."""
        found = np.abs(_at_each(self.hexapod.lever_arms, poses, 6)) / (self.scenario.robot.cranks.length or 1.0)
        return np.nan_to_num(found)

    @property
    def shares(self) -> Array:
        """Share of each point in the weighted mean of all, (p,) [1], which `follow: direction` follows."""
        weights = np.asarray(self.settings["target.weights"], dtype=float)
        return np.asarray(weights / weights.sum())

    @property
    def root_weights(self) -> Array:
        """(2p, 1), root of what each coordinate counts in the controller's sums."""
        return np.asarray(np.sqrt(np.repeat(self.settings["target.weights"], 2))[:, None])

    def of_pixels(self, features: Array, jacobian: Array) -> Array:
        """Return a Jacobian (2p, 6) of features (2p,) as that of the camera's pixels, which have the noise.

        Lens and second focal length make them others than features. A point that the lens does not show gives nothing.
        """
        if not has_pixels(self.scenario.camera):
            return jacobian
        slopes = pixel_slopes(self.scenario, features)
        return np.nan_to_num((slopes @ jacobian.reshape(-1, 2, 6)).reshape(jacobian.shape), nan=0.0)

    def of_noise(self, features: Array, jacobian: Array) -> Array:
        """Return rows (k, 6) of which plain least squares has the noise of the pose estimated from an image.

        Of the weighted least squares of the pixels (`rows_of_estimate`), for a Jacobian (2p, 6) of features (2p,).
        """
        return rows_of_estimate(self.of_pixels(features, jacobian), np.square(self.root_weights[:, 0]))

    @property
    def image_noise(self) -> float:
        """Return the deviation of a coordinate at the start, of the camera and of what encoders read [px]."""
        return math.hypot(feature_noise(self.scenario.camera), self.joint_noise)

    @property
    def joint_noise(self) -> float:
        """Return the deviation of a coordinate at the start by what encoders read [px]; 0 where poses are exact."""
        by_joint = self.view(self.start).jacobian @ self.pose_noise
        return float(np.linalg.norm(by_joint)) / math.sqrt(len(by_joint))

    @property
    def joint_rounding(self) -> float:
        """Return the part of `joint_noise` that is the rounding of readings [px]."""
        sensors = self.scenario.sensors
        rounding = sensors.resolution / math.sqrt(12.0)
        return self.joint_noise * rounding / math.hypot(sensors.noise, rounding) if rounding > 0.0 else 0.0

    @property
    def pose_noise(self) -> Array:
        """Return a root R of the covariance R R^T of the pose at the start that encoders read, (6, 6) [m; rad]."""
        sensors = self.scenario.sensors
        of_joint = math.hypot(sensors.noise, sensors.resolution / math.sqrt(12.0))
        if sensors.pose != "encoders" or of_joint == 0.0:
            return np.zeros((6, 6))
        return np.asarray(np.linalg.inv(self.wrench_maps(self.start).T) * of_joint)

    def limits_left(self, poses: Poses) -> Array:
        """Return which share of its limits the leg nearest to one has left, (...); negative beyond it."""
        return np.asarray(1.0 - self.limits_used(poses).max(axis=(-2, -1)))

    def wrench_maps(self, poses: Poses) -> Array:
        """Return H at poses, (..., 6, 6): leg forces to the wrench in B."""
        return _at_each(self.hexapod.wrench_map, poses, 6, 6)

    def true_weight(self, pose: Poses) -> Array:
        """Return the wrench (6,) in B [N; N m] that holds the platform as it is against its weight, at one pose."""
        share = 1.0 - np.array(self.settings["uncertainty.gravity"])
        return np.asarray(share * self.settings.plant_body.weight(pose.quaternion))

    def resting_forces(self, pose: Poses) -> Array:
        """Return what the legs carry that weight with at one pose, (6,) [N], or [N m] of cranks."""
        return np.asarray(self.hexapod.leg_forces(pose.position, pose.quaternion, self.true_weight(pose)))

    def leg_rates(self, pose: Poses, twist: Array) -> Array:
        """Return the rates of the legs (6,) [m/s] at one pose, for a twist (6,) in B; of rotary legs [rad/s]."""
        return np.asarray(self.hexapod.wrench_map(pose.position, pose.quaternion)).T @ twist

    def leg_tilts(self, poses: Poses) -> Array:
        """Return the angles of the legs from their directions at home, (..., 2, 6) [rad], in B and in E."""
        found = _at_each(self.hexapod.leg_tilts, poses, 2, 6)
        return np.where(np.isnan(found), np.inf, found)  # a crank that does not close

    def limits_used(self, poses: Poses) -> Array:
        """Return which share of its limits each leg uses, (..., k, 6): of the stroke, and of the tilt at both joints.

        Three rows where the robot has joint limits, otherwise one; above 1 is out of reach.
        """
        travel = np.abs(self.leg_travel(poses))[..., None, :] / self.stroke
        if self.joint_limit is None:
            return np.asarray(travel)
        return np.concatenate([travel, self.leg_tilts(poses) / self.joint_limit[:, None]], axis=-2)

    def reachable(self, poses: Poses) -> Mask:
        """Return which poses (n,) the legs reach.

        They are within the stroke and the joint limits, and on home's side of the singular ones (the sign of det H).
        """
        return np.asarray((self.limits_left(poses) >= -_ROUNDING) & self.same_side(poses))

    def same_side(self, poses: Poses) -> Mask:
        """Return which poses (n,) are on home's side of the singular ones, by the sign of det H."""

        def side(of: Poses) -> Array:
            return np.asarray(np.sign(np.linalg.det(np.nan_to_num(self.wrench_maps(of)))))

        return np.asarray(side(poses) == side(self.home.rows))

    def spread(self, count: int, seed: int) -> Poses:
        """Draw poses, at most `count`, that see all points, even over `WIDER` about home, within the stroke or not."""
        moves = np.random.default_rng(seed).uniform(-1.0, 1.0, (8 * count, 6)) * WIDER * self.unit
        poses = self.home.moved(moves)
        return poses[np.flatnonzero(np.isfinite(self.image(poses)[0]).all(axis=1))[:count]]


def _at_each(of: Callable[[Array, Array], Array], poses: Poses, *shape: int) -> Array:
    """Return what the core gives at one position and quaternion for each pose, (..., *shape)."""
    pairs = zip(poses.rows.position, poses.rows.quaternion, strict=True)
    return np.asarray([of(*pose) for pose in pairs]).reshape(*poses.shape, *shape)


def has_to_hold(scenario: Scenario) -> bool:
    """Return whether staying at the start is a result: something moves, or the controller has the weight wrong."""
    return (
        moves(scenario.base_motion)
        or scenario.target.motion.kind != "none"
        or bool(np.any(scenario.uncertainty.gravity))
        or scenario.has_unknown_payload
        or bool(np.any(scenario.simulation.start.twist))
    )


def keys_of_centre(scenario: Scenario, *, known: bool = False) -> list[str]:
    """Return the keys that place the centre of mass beside the platform's origin; `known`: in the controller's body."""
    robot = scenario.robot
    has_payload = robot.payload.mass > 0.0 and (robot.payload.known or not known)
    placed = {
        "robot.centre_of_mass": np.any(robot.centre_of_mass),
        "robot.payload.position": has_payload and np.any(robot.payload.position),
    }
    return [key for key, off in placed.items() if off]


@lru_cache(maxsize=8)  # several parts of an analysis ask
def scene_of(scenario: Scenario) -> Scene:
    """Return the scene of a scenario."""
    return Scene(scenario)


# Objects of the core cannot be pickled; those of a scene follow from its scenario. Not for classes derived from it.
copyreg.pickle(Scene, lambda scene: (scene_of, (scene.scenario,)))
