"""How wide a gate of the camera has to be for the noise of its image and for the motion of its target."""

from __future__ import annotations

import math

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.target_path import sinusoid_in_base
from hexservo.scenario.arrays import Array
from hexservo.scenario.motion import TargetMotion, displacements_of
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number, percent_used

REJECTED = 0.001
"""Share of right points that a gate may reject."""
_FEW = 0.01  # share of points below which whole percents are too coarse
_IN_NOISE = math.sqrt(-4.0 * math.log(REJECTED))  # sqrt(2 chi2), the quantile -2 log(REJECTED) for 2 numbers


def predicts(scenario: Scenario) -> bool:
    """Return whether points of the image are carried along by the joint sensors, without which no gate acts."""
    return scenario.camera.prediction == "encoder" or scenario.camera.on_lost == "predict"


def noise_at_gate(scenario: Scenario) -> float:
    """Return the standard deviation of the image coordinates that a gate compares [px]: noise and rounding, smoothed.

    A filter that keeps k of a coordinate from frame to frame leaves sqrt((1 - k)/(1 + k)) of their deviation.
    """
    camera = scenario.camera
    kept = math.exp(-frame_period(scenario) / camera.smoothing) if camera.smoothing > 0.0 else 0.0
    return feature_noise(camera) * math.sqrt((1.0 - kept) / (1.0 + kept))


def rejected_share(gate: float, noise: float) -> float:
    """Return the share of right points that a gate [px] rejects, by the standard deviation of their coordinates [px].

    Two images of a point differ by sqrt(2) of it in each coordinate. What the gate rejects leaves the distribution of
    the images that it compares with as it is: a point passes from one image to another as easily as back.
    """
    return math.exp(-((gate / noise) ** 2) / 4.0) if noise > 0.0 else 0.0


def rejects(gate: float, noise: float) -> str:
    """Return which share of the right points a gate rejects, as it follows the gate; both in px."""
    share = rejected_share(gate, noise)
    percent = percent_used(share) if share >= _FEW else f"{number(100.0 * share, 2)}%"
    return f"rejects {percent} of the right points, whose coordinates have {number(noise)} px of noise and rounding"


def least_for_noise(noise: float) -> float:
    """Return the gate [px] that rejects `REJECTED` of the right points with coordinates of some noise [px]."""
    return _IN_NOISE * noise


def moved_in_image(scene: Scene) -> float:
    """Return how far the target's motion moves a point of the image from frame to frame at most, at home [px]."""
    motion = moved_between_frames(sinusoid_in_base(scene.scenario), frame_period(scene.scenario))
    by_metre = scene.view(scene.home).jacobian[:, :3].reshape(-1, 2, 3)
    return float(np.linalg.norm(by_metre @ motion.T, axis=1).max(initial=0.0))


def least_gate(scene: Scene) -> float:
    """Return a gate [px] that rejects at most `REJECTED` of the right points, for noise and the target's motion."""
    return least_for_noise(noise_at_gate(scene.scenario)) + moved_in_image(scene)


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
