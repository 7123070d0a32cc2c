"""Gates of the camera that are legal and probably unintended: those that lose a right point for good."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.target_path import moving_keys, sinusoid_in_base
from hexservo.scenario.arrays import Array
from hexservo.scenario.motion import TargetMotion, displacements_of
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number


def predicts(scenario: Scenario) -> bool:
    """Return whether points of the image are carried along by the joint sensors, without which no gate acts."""
    return scenario.camera.prediction == "encoder" or scenario.camera.on_lost == "predict"


def of_gate(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a gate without timeout, and for one that the target's motion exceeds between two frames."""
    camera = scene.scenario.camera
    if camera.gate is None or not predicts(scene.scenario):
        return
    if camera.timeout is None:
        yield (
            "camera.gate: a point that has gone elsewhere is never found again without camera.timeout; set that to "
            "some frame periods beyond the latency"
        )
    motion = moved_between_frames(sinusoid_in_base(scene.scenario), frame_period(scene.scenario))
    by_metre = scene.view(scene.home).jacobian[:, :3].reshape(-1, 2, 3)
    moved = float(np.linalg.norm(by_metre @ motion.T, axis=1).max(initial=0.0))
    if moved > camera.gate:
        yield (
            f"camera.gate: {number(camera.gate)} px is less than the {number(moved)} px that "
            f"{moving_keys(scene.scenario)[0]} moves the image from frame to frame, so that right points count as "
            "lost; widen the gate"
        )


def moved_between_frames(motion: TargetMotion, period: float) -> Array:
    """Return displacements of a target from one frame to the next, the largest ones among them, (n, 3) [m]."""
    if motion.kind == "velocity":
        return period * np.array([motion.velocity], dtype=float)
    if motion.kind == "sinusoid":  # sin(a + d) - sin(a) = 2 cos(a + d/2) sin(d/2)
        turn = 2.0 * math.pi * motion.frequency * period
        share = 2.0 * (abs(math.sin(turn / 2.0)) if turn < math.pi else 1.0)  # frames may begin anywhere in it
        return share * np.array([motion.amplitude], dtype=float)
    if motion.kind == "recorded" and motion.samples is not None and motion.sample_period is not None:
        samples = np.asarray(motion.samples, dtype=float)
        time: Array = motion.sample_period * np.arange(len(samples), dtype=float)
        time = np.concatenate([time, np.maximum(time - period, 0.0)])  # straight between: a frame is at a sample
        return np.asarray(displacements_of(motion, time + period) - displacements_of(motion, time))
    return np.zeros((0, 3))
