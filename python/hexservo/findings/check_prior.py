"""A prior that keeps the platform off the goal pose, beside an image that is nearly that of the goal."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.prior import balance_of_prior, left_by_inverse
from hexservo.scenario.arrays import Array
from hexservo.scenario.wording import number, quantity

_LEFT = 0.05  # share of the way to the goal pose that a prior may leave without a sentence
_NO_PART = 1e-4  # of a displacement, which a shift or a rotation that is left out has at most


def of_prior(scene: Scene) -> Iterator[str]:
    """Yield a sentence on the pose where the image and a prior's pull towards home balance, off that of the goal.

    By the distance that the platform's joints move, from a twentieth of the way from home on.
    """
    law, traits = scene.scenario.controller.law, scene.scenario.controller.traits
    if not (traits.prior and traits.inverse and scene.has_points) or scene.moving_target:
        return
    machine = scene.machine
    if not np.isfinite(left_by_inverse(scene, machine)).all():  # no pose shows the goal image
        return
    left, pixels = balance_of_prior(scene, machine)
    if np.linalg.norm(scene.levers * left) <= _LEFT * np.linalg.norm(scene.levers * machine.displacement):
        return
    yield (
        f"controller.{law}.prior: its pull towards home and the image balance {_in_words(left, scene)} from the goal "
        f"pose, which is {_in_words(machine.displacement, scene)} from home, with {number(pixels, 2)} px of image "
        "error: there the platform rests, but for model errors; a larger or nearer target, or a smaller prior where "
        "noise allows it, leaves less"
    )


def _in_words(displacement: Array, scene: Scene) -> str:
    """Return the lengths of a shift and a rotation; one that does not move the platform's joints is left out."""
    shift, turn = (float(np.linalg.norm(part)) for part in np.split(displacement, 2))
    moved = math.hypot(shift, scene.platform_radius * turn)
    parts = [(quantity(shift, "m"), shift), (quantity(turn, "rad"), scene.platform_radius * turn)]
    return " and ".join(text for text, by in parts if by > _NO_PART * moved)
