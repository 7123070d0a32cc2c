"""Targets that are legal and whose points determine the pose poorly: too few of them, too small, or too far."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.conditioning import Sight, frames_noise, noise_in_words, noise_of, sight
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.prior import key_of_inverse, legs_of_noise
from hexservo.scenario.arrays import Array
from hexservo.scenario.wording import quantity

_FEWEST = 3  # points that a law can regulate
_SURELY = 3.0  # strokes by which noise scatters a leg that goes to the ends of its stroke


def of_points(scene: Scene) -> Iterator[str]:
    """Yield a sentence for three points, and for points whose image hardly constrains the position.

    Hardly is by half of the depth, or by more than the stroke of a leg with the law's own inverse of the image: a law
    that follows its noise then uses the whole stroke. In runs of five laws, with bandwidths of 0.3 to 3 Hz, legs had
    excursions of 0.5 to 1.5 times the stroke where that deviation is the stroke, and at most 0.8 at half of it; from
    three times the stroke on they went to its ends or beyond.
    """
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
    uncertain = _uncertain(start, noise, noise_in_words(scene.scenario))
    legs = frames_noise(scene.scenario) * legs_of_noise(scene)
    if legs.max() > scene.stroke:
        yield f"{uncertain}{_of_legs(scene, legs)}"
    elif start.unobservable(noise):
        yield (
            f"{uncertain}: runs may settle far from the goal pose with nearly the goal image; spread "
            "the points over the image, or in depth (`hexservo analyse` compares placements)"
        )


def _uncertain(start: Sight, noise: float, of_noise: str) -> str:
    shifts = noise * start.pose_sigma[:3]
    axis = int(shifts.argmax())
    return (
        f"target: at the start {of_noise} in one image makes the platform uncertain by "
        f"{quantity(float(shifts[axis]), 'm')} along {'xyz'[axis]}, with the points {quantity(start.length, 'm')} away"
    )


def _of_legs(scene: Scene, legs: Array) -> str:
    leg, unit, law = int(legs.argmax()), scene.units.coordinate, scene.scenario.controller.law
    key = key_of_inverse(scene)
    stroke = quantity(scene.stroke, unit)
    go = "go" if legs[leg] > _SURELY * scene.stroke else "may go"
    remedy = f"a larger controller.{law}.{key}" if key else "a law whose prior keeps noise out"
    return (
        f", and where {law} sends leg {leg + 1} by {quantity(float(legs[leg]), unit)}, which has {stroke} of stroke "
        f"either way: legs {go} to the ends of their stroke or beyond, and runs may settle late or not at all; take a "
        f"larger, nearer or better spread target, less noise, or {remedy}"
    )
