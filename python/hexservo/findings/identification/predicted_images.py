"""The image of a target that joints predict, at any time of a log: what frames differ from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.frames_noise import image_of_noise
from hexservo.findings.identification.joint_motion import JointMotion
from hexservo.findings.identification.log import Frames, Log
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.pixels import to_features

MOST_LATENCY = 0.25
"""Largest latency that is looked for [s]."""

_BETWEEN = 0.5  # share of what an image by every second tick is off by that one by all ticks may be, at most


@dataclass(frozen=True, eq=False)
class PredictedImages:
    """The image at any time of a log, for any place of the target."""

    scene: Scene
    joints: JointMotion
    features: Array  # (m, 2p) of the pinhole [px]; NaN of lost points, of which all that is computed is 0
    times: Array  # (m,) exposures where they are known, else arrivals [s]
    latest: float  # a shift of `times` stays below this [s]
    centre: Array  # (3,) of the target [m]

    @classmethod
    def of(cls, log: Log, frames: Frames, scene: Scene, joints: JointMotion) -> PredictedImages:
        """Return the frames of which the joints are known at all times that are searched."""
        stamped = frames.exposure is not None
        times = frames.arrival if frames.exposure is None else frames.exposure
        margin = MOST_LATENCY if not stamped else MOST_LATENCY / 2
        inside = (times - margin >= log.time[0]) & (times + (margin if stamped else 0.0) <= log.time[-1])
        features = to_features(scene.scenario, frames.features[inside])
        found = cls(scene, joints, features, times[inside], margin, scene.points.mean(axis=0))
        return found.only(np.asarray(found.seen.any(axis=1)))

    @property
    def seen(self) -> Mask:
        """Which coordinates the frames have, (m, 2p): a lens shows no point at some pixels."""
        return np.asarray(np.isfinite(self.features))

    @property
    def motion(self) -> Array:
        """The images about their mean, (m, 2p) [px]."""
        seen = self.seen
        mean = np.where(seen, self.features, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        return np.where(seen, self.features - mean, 0.0)

    def only(self, frames: Mask | slice) -> PredictedImages:
        """Return the same of some of the frames."""
        return replace(self, features=self.features[frames], times=self.times[frames])

    def poses(self, late: float) -> Poses | None:
        """Return where the platform was `late` [s] before the frames' times; None where legs do not fit together."""
        position, quaternion = self.scene.home.position, self.scene.home.quaternion
        found = []
        for lengths in self.joints(self.times - late):
            legs = self.scene.hexapod.forward_kinematics(lengths, position, quaternion)
            if legs.status != _core.KinematicsStatus.converged:
                return None
            position, quaternion = legs.position, legs.quaternion
            found.append((position, quaternion))
        return Poses(np.array([one for one, _ in found]), np.array([one for _, one in found]))

    def by_noise(self, deviations: Array, late: float) -> Array:
        """Return what these deviations of the joints (6,) move the image by, (m, 2p, 6) [px]; 0 without poses."""
        poses = self.poses(late)
        none = np.zeros((*self.features.shape, 6))
        return none if poses is None else self.seen[:, :, None] * image_of_noise(self.scene, poses, deviations)

    def left(self, late: float, displacement: Array, poses: Poses | None = None) -> Array | None:
        """Return what the image differs by from the frames, (m, 2p) [px], with the target displaced in B [m; rad]."""
        poses = self.poses(late) if poses is None else poses
        if poses is None:
            return None
        back = Poses(self.centre, np.array([1.0, 0.0, 0.0, 0.0])).moved(
            np.concatenate([np.zeros(3), -displacement[3:]])
        )
        position = back.carried(poses.position - self.centre - displacement[:3])
        turned = poses.moved(np.concatenate([np.zeros(3), -displacement[3:]])).quaternion
        features, depth = self.scene.probe.image(position, turned)
        return np.where(self.seen, features - self.features, 0.0) if (depth < 0.0).all() else None

    def speed(self, late: float, displacement: Array, width: float) -> Array:
        """Return the image's mean speed by `late` over a width [s] about it, (m, 2p) [px/s]; 0 without poses."""
        ends = min(late + width / 2, self.latest), late - width / 2
        earlier, later = (self.left(end, displacement) for end in ends)
        if earlier is None or later is None:
            return np.zeros_like(self.features)
        return (earlier - later) / (ends[0] - ends[1])

    def between_ticks(self, late: float, displacement: Array) -> Array:
        """Return what the image may be off by since the motion between ticks is not known, (2, m, 2p) [px].

        It is estimated by images from every second tick, and 0 without poses of these.
        """
        usual = self.left(late, displacement)
        found = [replace(self, joints=joints).left(late, displacement) for joints in self.joints.halved()]
        differences = [np.zeros_like(self.features) if usual is None or one is None else one - usual for one in found]
        return _BETWEEN * np.array(differences)
