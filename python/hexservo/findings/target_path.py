"""Where a target is in B during a run: by `target.motion`, and by the base before a target in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.motion import TargetMotion, displacements_of, moves
from hexservo.scenario.rotations import conjugate, quaternion_product, quaternions_of_matrices
from hexservo.scenario.scenario import Scenario

_INSTANTS = 200  # of a run, or of a period of a sinusoid, that are looked at
_BASE_INSTANTS = 1000  # of a run on a base that moves, whose motion may have any frequencies


@dataclass(frozen=True, eq=False)
class TargetPath:
    """Rigid motions of a target from its place on a base at rest, P(t) = R_WB^T (P + shift) (docs/model.md)."""

    time: Array  # (n,) [s]
    shift: Array  # (n, 3) d - p_WB, in W [m]
    attitude: Array  # (n, 3, 3) R_WB

    def __len__(self) -> int:
        """Return the number of instants."""
        return len(self.time)

    def __getitem__(self, rows: slice) -> TargetPath:
        """Return the selected instants."""
        return TargetPath(self.time[rows], self.shift[rows], self.attitude[rows])

    def carried(self, pose: Poses) -> Poses:
        """Return the poses (n) from which the target has the image that it has from one pose at rest."""
        back = conjugate(quaternions_of_matrices(self.attitude))
        return Poses(
            self.places(pose.position), quaternion_product(back, np.broadcast_to(pose.quaternion, (len(self), 4)))
        )

    def places(self, point: Array) -> Array:
        """Return where a point (3,) of the target at rest is in B, (n, 3) [m]."""
        return np.asarray(np.einsum("nji,nj->ni", self.attitude, point + self.shift))

    def seen_alike(self, poses: Poses) -> Poses:
        """Return from where (n) the target at rest has the image that it has from one pose, or n of them."""
        place = np.einsum("nij,nj->ni", self.attitude, np.broadcast_to(poses.position, (len(self), 3)))
        turn = quaternion_product(
            quaternions_of_matrices(self.attitude), np.broadcast_to(poses.quaternion, (len(self), 4))
        )
        return Poses(place - self.shift, turn)

    def points(self, instant: int, points: Array) -> Array:
        """Return the target's points in B at an instant, from those at rest, both (p, 3) [m]."""
        return np.asarray((points + self.shift[instant]) @ self.attitude[instant])


def at_rest() -> TargetPath:
    """Return the path of a target that stays where it is, at one instant."""
    return TargetPath(np.zeros(1), np.zeros((1, 3)), np.eye(3)[None])


def base_moves_target(scenario: Scenario) -> bool:
    """Return whether a base moves before a target that does not ride on it."""
    return scenario.target.frame == "world" and moves(scenario.base_motion)


def follows_direction(scenario: Scenario) -> bool:
    """Return whether the law points the camera at its target, and goes to no place."""
    gains = scenario.controller.gains
    return isinstance(gains, Tracking) and gains.follow == "direction"


def moving_keys(scenario: Scenario) -> tuple[str, ...]:
    """Return the blocks of a scenario that move its target in B."""
    own = ("target.motion",) if scenario.target.motion.kind != "none" else ()
    return (*own, "base_motion") if base_moves_target(scenario) else own


def path_at(scene: Scene, time: Array) -> TargetPath:
    """Return where the target is at times (n,) [s]."""
    shift = displacements_of(scene.scenario.target.motion, time)
    attitude = np.broadcast_to(np.eye(3), (len(time), 3, 3))
    if base_moves_target(scene.scenario):
        place, attitude, _, _ = scene.probe.base_motion(time)
        shift = shift - place
    return TargetPath(time, shift, attitude)


def path_of(scene: Scene) -> TargetPath:
    """Return where the target is at instants of a run, its ends and the extremes of `target.motion` among them."""
    motion, duration = scene.scenario.target.motion, scene.scenario.simulation.duration
    span, count = duration, _INSTANTS
    extremes = np.zeros(0)
    if motion.kind == "sinusoid" and motion.frequency > 0.0:
        span = min(duration, 1.0 / motion.frequency)
        extremes = (np.array([0.25, 0.75, 1.25]) - motion.phase / (2.0 * math.pi)) % 1.0 / motion.frequency
    elif motion.kind == "recorded" and motion.samples is not None and motion.sample_period is not None:
        samples = np.asarray(motion.samples, dtype=float)
        extremes = motion.sample_period * np.concatenate([samples.argmin(axis=0), samples.argmax(axis=0)])
    if base_moves_target(scene.scenario):
        span, count = duration, _BASE_INSTANTS
    return path_at(scene, np.unique(np.concatenate([np.linspace(0.0, span, count + 1), extremes[extremes <= span]])))


def sinusoid_in_base(scenario: Scenario) -> TargetMotion:
    """Return the target's motion in B, with the sinusoid of a base that swings in translation alone as `target.motion`.

    A base with the acceleration a sin(wt + phase) is displaced by -a/w^2 sin(wt + phase), and a target in the world by
    the opposite. Where both move, or the base otherwise, it is `target.motion` as it is.
    """
    base, motion = scenario.base_motion, scenario.target.motion
    swings = base.kind == "sinusoid" and base.rotation.kind == "none" and base.frequency > 0.0
    if motion.kind != "none" or not swings or not base_moves_target(scenario):
        return motion
    amplitude = np.asarray(base.amplitude, dtype=float) / (2.0 * math.pi * base.frequency) ** 2
    keys = {"kind": "sinusoid", "amplitude": amplitude.tolist(), "frequency": base.frequency, "phase": base.phase}
    return TargetMotion.model_validate(keys)
