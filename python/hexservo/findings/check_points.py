"""Targets that are legal and whose points determine the pose poorly: too few of them, or too little spread."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.conditioning import noise_of, sight
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.wording import number, quantity

_FEWEST = 3  # points that a law can regulate


def of_points(scene: Scene) -> Iterator[str]:
    """Yield a sentence for three points, and for points whose image hardly constrains the position."""
    counted = int((scene.settings["target.weights"] > 0.0).sum())
    if counted == _FEWEST:
        word = "points" if counted == scene.scenario.target.count else "points that count"
        yield (
            f"target: {counted} {word} look alike from up to four poses: the law may settle at a pose that is not "
            "the goal, with the same image"
        )
    view = scene.view(scene.start)
    if not np.isfinite(view.features).all():
        return
    start, noise = sight("start", view, view.mean_depth, scene), noise_of(scene.scenario)
    if start.unobservable(noise):
        shifts = noise * start.pose_sigma[:3]
        axis = int(shifts.argmax())
        yield (
            f"target: at the start {number(noise)} px of noise in one image makes the platform uncertain by "
            f"{quantity(float(shifts[axis]), 'm')} along {'xyz'[axis]}, with the points {quantity(start.length, 'm')} "
            "away: runs may settle far from the goal pose with nearly the goal image; spread the points over the "
            "image, or in depth (`hexservo analyse` compares placements)"
        )
