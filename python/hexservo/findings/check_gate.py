"""Gates of the camera that are legal and probably unintended: those that lose a right point for good."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.motion import TargetMotion
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.wording import number


def of_gate(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a gate without timeout, and for one that the target's motion exceeds between two frames."""
    camera = scene.scenario.camera
    if camera.gate is None or (camera.prediction != "encoder" and camera.on_lost != "predict"):
        return
    if camera.timeout is None:
        yield (
            "camera.gate: a point that has gone elsewhere is never found again without camera.timeout; set that to "
            "some frame periods beyond the latency"
        )
    by_metre = np.linalg.norm(scene.view(scene.home).jacobian[:, :3].reshape(-1, 2, 3), ord=2, axis=(1, 2)).max()
    moved = float(by_metre) * _speed(scene.scenario.target.motion) * frame_period(scene.scenario)
    if moved > camera.gate:
        yield (
            f"camera.gate: {number(camera.gate)} px is less than the {number(moved)} px that target.motion moves the "
            "image from frame to frame, so that right points count as lost; widen the gate"
        )


def _speed(motion: TargetMotion) -> float:
    """Return the largest speed of a target [m/s]."""
    if motion.kind == "velocity":
        return float(np.linalg.norm(motion.velocity))
    if motion.kind == "sinusoid":
        return 2.0 * math.pi * motion.frequency * float(np.linalg.norm(motion.amplitude))
    if motion.kind == "recorded" and motion.samples is not None and motion.sample_period is not None:
        steps = np.diff(np.asarray(motion.samples, dtype=float), axis=0)
        return float(np.linalg.norm(steps, axis=1).max(initial=0.0)) / motion.sample_period
    return 0.0
