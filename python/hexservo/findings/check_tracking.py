"""Targets that the law `tracking` takes for resting although they move, or for slower than they are."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.conditioning import sight
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_gate import moved_between_frames
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.wording import number, quantity

_WHOLE = 2.0  # times the speed from which a velocity counts: 1 - 1/2^4 of it does


def of_tracking(scene: Scene) -> Iterator[str]:
    """Yield a sentence for a target whose velocity never counts, or never whole: the law follows behind it."""
    scenario = scene.scenario
    gains = scenario.controller.gains
    if not isinstance(gains, Tracking) or scenario.target.motion.kind == "none":
        return
    period = frame_period(scenario)
    moved = moved_between_frames(scenario.target.motion, period)
    fastest = float(np.linalg.norm(moved, axis=1).max(initial=0.0)) / period
    counts = speed_that_counts(scene, gains)
    if 0.0 < fastest < _WHOLE * counts:
        yield (
            f"controller.tracking.certainty: target.motion moves the target at up to {quantity(fastest, 'm/s')}, and "
            f"the law takes it for moving from about {quantity(counts, 'm/s')} on, where its velocity is certainty "
            f"({number(gains.certainty)}) times what noise of {number(gains.noise)} px leaves in it: until then the "
            "mean of earlier frames is followed, behind the target, and up to twice that speed a part of its velocity "
            "is missing; set controller.tracking.noise to that of the features, or certainty to 0, with which every "
            "velocity counts"
        )


def speed_that_counts(scene: Scene, gains: Tracking) -> float:
    """Return the speed from which the filter's velocity of a target counts, after many frames [m/s].

    The deviation of the velocity is that of the alpha-beta filter, (beta/T^2) (alpha - beta/2)/(1 - alpha) of the
    variance of a place, of each axis (docs/model.md, section 5; Kalata 1984).
    """
    period = frame_period(scene.scenario)
    place = gains.noise * _deviation_per_pixel(scene, gains)
    index = np.broadcast_to(np.asarray(gains.acceleration, dtype=float), 6)[:3] * period**2 / place
    left = (4.0 + index - np.sqrt(8.0 * index + index**2)) / 4.0
    alpha = 1.0 - left**2
    beta = 2.0 * (2.0 - alpha) - 4.0 * left
    variance = beta * (alpha - beta / 2.0) / left**2 * (place / period) ** 2
    return gains.certainty * math.sqrt(float(variance.sum()))


def _deviation_per_pixel(scene: Scene, gains: Tracking) -> Array:
    """Return the deviation of the place of the target from 1 px of noise, along x, y and z of B (3,) [m/px]."""
    view = scene.view(scene.start)
    if gains.follow == "pose":
        goals = find_goals(scene)
        return sight("goal", view if goals is None else goals.best.view, view.mean_depth, scene).pose_sigma[:3]
    weights = np.broadcast_to(np.asarray(scene.scenario.target.weights, dtype=float), len(view.features) // 2)
    share = float(np.linalg.norm(weights) / weights.sum())
    return np.full(3, share * view.mean_depth / scene.settings.camera.focal_pixels)
