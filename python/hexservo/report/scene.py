"""The machine in space: legs, platform, camera, image and target at a number of instants of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexservo import _core
from hexservo.report.charts import encoded
from hexservo.run.leg_motion import leg_motions
from hexservo.run.samples import along_z, parts, turns_from_home
from hexservo.scenario.arrays import Array
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.pixels import IMAGE_CORNERS, desired_features, image_border

if TYPE_CHECKING:
    from hexservo.run.result import Result

_FRAMES = (150, 60)  # most instants of the transient, and of the rest
_IMAGE_DISTANCE = 0.4  # of the drawn image plane from the camera, in parts of the targets' depth
_MARGIN = 1.2  # of the drawn plane round the features, where the image has no size
_WIDEST = 1.0  # half width of the drawn image, in parts of its distance: features farther out are not drawn


@dataclass(frozen=True, eq=False)
class SpaceView:
    """Positions in B [m], but for those of the image plane, in C, the camera's frame, and what is stated to be in E."""

    time: Array  # (k,) [s]
    position: Array  # (k, 3), of E's origin
    rotation: Array  # (k, 3, 3), transforms E-coordinates into B-coordinates
    joints: Array  # (k, 6, 3), of the platform
    base: Array  # (6, 3), joints of the base
    feet: Array | None  # (k, 6, 3), ends of the cranks, where the rods begin; None: prismatic legs
    used: Array  # (k, 6), largest share that each leg uses of one of its limits; above 1 beyond it
    limit: NDArray[np.intp]  # (k, 6), which one, of `limits`
    limits: tuple[str, ...]  # what is limited, as it follows "of its"
    on_base: bool  # the camera is fixed in B, and the targets in E
    camera: Array  # (3,), of C's origin in E, or in B [m]
    axes: Array  # (3, 3), transforms C-coordinates into those of the same frame
    targets: Array | None  # (k, p, 3), or (1, p, 3) at rest, in B, or in E; None where the plant has no points
    border: Array  # (n, 3) in C, of the image, or a square with all features: a closed line, a corner each n / 4 rows
    size: tuple[float, ...] | None  # of the image, width and height [px]; None: it has none
    image: Array  # (k, p, 3) in C, features on the image plane; NaN beyond its widest
    goals: Array  # (p, 3) in C
    displacement: Array  # (k, 3) [m], from home
    turn: Array  # (k, 3) [rad], rotation vector
    error: Array  # (k,) [px], largest feature error
    pixels_per_metre: float  # of features on the image plane
    z_down: bool  # z of B is drawn downwards: gravity is not against it
    upright: bool  # gravity is along z of B, or against it: what is drawn downwards is down
    finer: bool  # instants are closer to one another until the run has settled

    @property
    def corners(self) -> Array:
        """Corners of the drawn image in C, (4, 3), in cyclic order."""
        return self.border[:: len(self.border) // 4]

    def placed(self, frame: int, points: Array) -> Array:
        """Return points of C, (..., 3), in B at an instant."""
        mounted = self.camera + points @ self.axes.T
        return mounted if self.on_base else self.carried(frame, mounted)

    def carried(self, frame: int, points: Array) -> Array:
        """Return points of E, (..., 3), in B at an instant."""
        return np.asarray(self.position[frame] + points @ self.rotation[frame].T)

    def target(self, frame: int) -> Array | None:
        """Return the points of the target in B at an instant, (p, 3)."""
        if self.targets is None:
            return None
        points = self.targets[min(frame, len(self.targets) - 1)]
        return self.carried(frame, points) if self.on_base else points

    def box(self) -> tuple[Array, Array]:
        """Return the smallest and the largest coordinates of all drawn points, (3,) each."""
        image = np.vstack([self.border, np.zeros(3)])  # with the camera, from which lines lead to the corners
        plane = np.concatenate([self.placed(frame, image) for frame in range(len(self.time))])
        everything = [self.base, self.joints.reshape(-1, 3), self.position, plane]
        targets = [self.target(frame) for frame in range(len(self.time))]
        everything += [place[np.isfinite(place).all(axis=1)] for place in targets if place is not None]
        everything += [] if self.feet is None else [self.feet.reshape(-1, 3)]
        places = np.concatenate(everything)
        return places.min(axis=0), places.max(axis=0)

    def to_plain(self) -> dict[str, Any]:
        """Return the data for the page's script."""
        low, high = self.box()
        middle, half = (low + high) / 2, 0.54 * (high - low) + 0.005
        return {
            "time": encoded(self.time),
            "position": encoded(self.position.ravel()),
            "rotation": encoded(self.rotation.ravel()),
            "joints": encoded(self.joints.ravel()),
            "image": encoded(self.image.ravel()),
            "displacement": encoded(1e3 * self.displacement.ravel()),
            "turn": encoded(1e3 * self.turn.ravel()),
            "error": encoded(self.error),
            "used": encoded(self.used.ravel()),
            "limit": encoded(self.limit.ravel().astype(float)),
            "limits": list(self.limits),
            "base": self.base.tolist(),
            "feet": None if self.feet is None else encoded(self.feet.ravel()),
            "onBase": self.on_base,
            "camera": self.camera.tolist(),
            "axes": self.axes.tolist(),
            "targets": None if self.targets is None else encoded(self.targets.ravel()),
            "corners": self.corners.tolist(),
            "border": self.border.tolist(),
            "zDown": self.z_down,
            "goals": self.goals.tolist(),
            "low": (middle - half).tolist(),
            "high": (middle + half).tolist(),
        }


def scene(result: Result) -> SpaceView:
    """Select the instants of a run for the view, more of them during the transient, and compute all positions."""
    settings = core_parameters(result.scenario)
    hexapod = _core.Hexapod(settings.robot)
    chosen, finer = _instants(result)
    position, quaternion = result.position[chosen], result.quaternion[chosen]
    rotation = _rotations(quaternion)
    joints = position[:, None, :] + hexapod.platform_joints @ np.swapaxes(rotation, 1, 2)
    feet = [hexapod.leg_feet(*pose) for pose in zip(position, quaternion, strict=True)] if hexapod.rotary else None
    features = result.features[chosen].reshape(len(chosen), -1, 2)
    goals = desired_features(result.scenario).reshape(-1, 2)
    distance = _IMAGE_DISTANCE * float(np.abs(result.depth[0]).mean())
    pixel = distance / settings.camera.focal_pixels  # [m], as it appears on the plane
    border = image_border(result.scenario)
    outline = (_around(features, goals) if border is None else border) * pixel
    outline = np.clip(outline, -_WIDEST * distance, _WIDEST * distance)
    image = _on_plane(features * pixel, distance)
    image[np.abs(image[..., :2]).max(axis=-1) > _WIDEST * distance] = np.nan
    has_points = settings["camera.convention"] == "eye_in_hand"
    camera, *axes = settings.camera.in_mount(np.vstack([np.zeros(3), np.eye(3)]))
    used, limit, limits = _limits_used(result, chosen)
    return SpaceView(
        time=result.time[chosen],
        position=position,
        rotation=rotation,
        joints=joints,
        base=np.asarray(hexapod.base_joints),
        feet=None if feet is None else np.array(feet),
        used=used,
        limit=limit,
        limits=limits,
        on_base=result.scenario.camera.mount.on == "base",
        camera=camera,
        axes=np.column_stack(axes) - camera[:, None],
        targets=_targets(result, settings.camera, chosen) if has_points else None,
        border=_on_plane(outline, distance),
        size=result.scenario.camera.image_size,
        image=image,
        goals=_on_plane(goals * pixel, distance),
        displacement=position - np.asarray(result.scenario.robot.home_position),
        turn=turns_from_home(result, quaternion),
        error=np.abs(result.feature_error[chosen]).max(axis=1),
        pixels_per_metre=1 / pixel,
        z_down=result.scenario.robot.gravity[2] >= 0,
        upright=along_z(np.array(result.scenario.robot.gravity)),
        finer=finer,
    )


def _targets(result: Result, camera: _core.Camera, chosen: NDArray[np.intp]) -> Array:
    """Return the points of the target at some samples, (k, p, 3), or (1, p, 3) where they rest, in B, or in E [m].

    They are lifted from the image and the depth of each sample.
    """
    scenario = result.scenario
    samples = (result.position, result.quaternion, result.features, result.depth)
    return np.array(
        [_core.lift(camera, *(of[i] for of in samples)) for i in (chosen if scenario.target_moves else chosen[:1])]
    )


def _limits_used(result: Result, chosen: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp], tuple[str, ...]]:
    """Return which share of its limits each leg uses at some samples, (k, 6), of which one, (k, 6), and their names."""
    names = {"stroke": "stroke", "speed": "speed limit", "base_joint": "joint limit at the base"}
    motions = leg_motions(result, chosen)
    shares = [np.abs(motion.values) / motion.levels[-1] for motion in motions]
    shares.append(np.abs(result.leg_forces[chosen]) / result.scenario.robot.force_limit)
    words = [names.get(motion.limit.kind, "joint limit at the platform") for motion in motions]
    effort = leg_units(result.scenario.robot).effort_name
    all_shares = np.array(shares)
    return all_shares.max(axis=0), all_shares.argmax(axis=0), (*words, f"{effort} limit")


def _instants(result: Result) -> tuple[NDArray[np.intp], bool]:
    """Select samples uniformly within the transient and, more sparsely, within the rest.

    Also return whether the rest has them more sparsely: it has not where there is no rest, or where all samples are
    selected.
    """
    chosen = [
        np.linspace(part.start, part.stop - 1, min(count, part.stop - part.start))
        for part, count in zip(parts(result), _FRAMES, strict=False)
    ]
    steps = [np.ptp(places) / max(len(places) - 1, 1) for places in chosen]
    return np.unique(np.concatenate(chosen).round().astype(np.intp)), bool(steps[0] < steps[-1])


def _rotations(quaternion: Array) -> Array:
    """Return the rotation matrices (k, 3, 3) of attitudes (k, 4), w x y z."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=1,
    )


def _on_plane(points: Array, distance: float) -> Array:
    """Place points (..., 2) [m] on the image plane, drawn in front of the camera, which looks along -z of C."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), -distance)], axis=-1)


def _around(features: Array, goals: Array) -> Array:
    """Return the corners of a square about the image centre that contains all features, (4, 2) [px]."""
    half = _MARGIN * max(float(np.abs(features).max()), float(np.abs(goals).max()))
    return half * IMAGE_CORNERS
