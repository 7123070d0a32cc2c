"""How far a run ends from a pose with the goal image, of which a small image error is no measure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hexservo.run.probe import probe
from hexservo.run.samples import rotation_vectors
from hexservo.scenario.pixels import desired_features
from hexservo.scenario.rotations import conjugate, quaternion_product

if TYPE_CHECKING:
    from hexservo.run.result import Result

_INEXACT = 0.5  # [px], as far as ordinary noise takes a goal image that was measured from the image of its pose
_FEWEST = 4  # points whose image belongs to one pose


@dataclass(frozen=True)
class GoalDistance:
    """From a pose with the goal image to where a run ends."""

    shift: float  # [m]
    angle: float  # [rad]
    misfit: float  # largest feature error of that pose [px]: of a measured goal image there is none without
    motion: float  # by which the shift alone, or the rotation alone, moves a feature [px]; the larger


def inexact(band: float) -> float:
    """Return how far a feature of a pose with the goal image may be from its goal, for a settling band [px].

    A measured or rounded goal image is the image of no pose exactly; and no run settles at a pose that leaves more than
    the band.
    """
    return min(band, _INEXACT)


def goal_distance(result: Result) -> GoalDistance | None:
    """Return how far the platform is at the end from a pose with the goal image.

    Of the minima that the core's search from home finds, and whose features are at most 0.5 px and `metrics.band` from
    their goals, the one with the least shift over the points' mean depth, and angle, is meant. A target whose points
    are near one another looks nearly alike after a shift and a rotation that cancel in its image.

    Returns
    -------
        None where no such pose is found or meant: a camera as printed, three points (of which up to four poses have one
        image), a goal that moves in B, a law that follows a direction, and a run that ended early.
    """
    scenario = result.scenario
    directed = result.by_law and getattr(scenario.controller.gains, "follow", "pose") == "direction"
    unknown = scenario.camera.convention != "eye_in_hand" or scenario.target.count < _FEWEST
    if result.outcome != "completed" or unknown or scenario.target_moves or directed:
        return None
    parts = probe(scenario)
    position, quaternion = parts.goal_minima()
    if not len(position):
        return None
    misfit = np.abs(parts.image(position, quaternion)[0] - desired_features(scenario)).max(axis=1)
    shown = misfit <= inexact(scenario.metrics.band)
    if not shown.any():
        return None
    position, quaternion, misfit = position[shown], quaternion[shown], misfit[shown]
    shift = np.linalg.norm(result.position[-1] - position, axis=1)
    turns = quaternion_product(result.quaternion[-1], conjugate(quaternion))
    angle = np.linalg.norm(rotation_vectors(turns), axis=1)
    one = int(np.argmin(np.hypot(shift / np.abs(result.depth[-1]).mean(), angle)))
    places = np.stack([position[one], result.position[-1]]), np.stack([result.quaternion[-1], quaternion[one]])
    motion = np.abs(parts.image(*places)[0] - result.features[-1]).max()  # NaN where a point is not in front then
    return GoalDistance(float(shift[one]), float(angle[one]), float(misfit[one]), float(motion))
