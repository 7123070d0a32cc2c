"""Image and reach of single poses: ``hs.project`` and ``hs.reachable``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from hexservo.findings.analysis.reach import nearest_limit
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.nearest import distance, nearest_within
from hexservo.scenario.arrays import Array, real_numbers
from hexservo.scenario.fields import described
from hexservo.scenario.pixels import to_pixels
from hexservo.scenario.pose_rules import problem_of_turns
from hexservo.scenario.scenario import Scenario, require_scenario

_LARGEST = 1e6  # [m; rad], of a displacement: squares of much larger ones have no value


@described
@dataclass(frozen=True, eq=False)
class Reachability:
    """Whether the legs take the platform to a pose, what limits them there, and the nearest pose that they reach."""

    within: bool  # whether the pose is within reach
    limit: Literal["stroke", "base_joint", "platform_joint", "singularity"]  # that binds, or is nearest
    leg: int  # nearest to its limit or farthest beyond it, 1 to 6
    # what is left of that leg's limit [m], of a joint or a crank [rad]; negative beyond it, -infinity where the crank
    # does not close; of a singularity: of the nearest limit
    margin: float
    singularity: float  # smallest singular value of H there, moments divided by r_p [1]
    lever_arm: float  # smallest |w_i|/r of rotary legs there, 0 where crank and rod are in line; 1 of prismatic legs
    pose: Array  # (6,) that was asked for, displacement from home in B [m; rad]
    nearest: Array  # (6,) nearest pose within reach that was found, likewise; `pose` where that is within
    distance: float  # sqrt(|shift|^2 + (r_p |turn|)^2) from `pose` to `nearest` [m]
    unit: str = "mm"  # of a leg's travel in the sentence: a thousandth of the margin's

    def __str__(self) -> str:
        """Return one sentence."""
        if self.within:
            left = (
                f"leg {self.leg} has {1e3 * self.margin:.3g} {self.unit} of its travel left"
                if self.limit == "stroke"
                else f"the {_joint(self.limit)} of leg {self.leg} has {1e3 * self.margin:.3g} mrad left"
            )
            return f"within reach: {left}"
        why = (
            "a singular pose lies between home and there"
            if self.limit == "singularity"
            else f"leg {self.leg} does not reach it"
            if np.isinf(self.margin)
            else f"leg {self.leg} would be {-1e3 * self.margin:.3g} {self.unit} beyond its stroke"
            if self.limit == "stroke"
            else f"the {_joint(self.limit)} of leg {self.leg} would be {-1e3 * self.margin:.3g} mrad beyond its limit"
        )
        return f"out of reach: {why}; the nearest pose within is {1e3 * self.distance:.3g} mm away"


def project(scenario: Scenario, pose: ArrayLike) -> Array:
    """Return the image of a scenario's target from a pose.

    Parameters
    ----------
    scenario
        Its camera and target; a camera that projects (`eye_in_hand`).
    pose
        (..., 6) displacement from home, in B: difference of the positions [m], rotation vector [rad].

    Returns
    -------
    Array
        (..., 2p) pixels of p points [px], as the camera counts them: by (4) of docs/model.md, through the lens if it
        has one; NaN where a point is not in front of the camera, or the lens does not show it.

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        For poses that are not six finite numbers within 1e6 each with a rotation vector at most pi long, and for a
        camera `as_printed`, which has no points.
    """
    require_scenario(scenario)
    moves = _displacements(pose, (...,))
    scene = scene_of(scenario)
    poses = scene.home.moved(moves)
    features, depth = scene.probe.image(poses.rows.position, poses.rows.quaternion)
    in_front = np.repeat(np.asarray(depth) < 0, 2, axis=1)  # of both coordinates
    pixels = to_pixels(scenario, np.where(in_front, features, np.nan))
    return np.asarray(pixels.reshape(*moves.shape[:-1], features.shape[-1]))


def reachable(scenario: Scenario, pose: ArrayLike) -> Reachability:
    """Return whether the legs of a scenario's robot reach a pose, and the nearest pose that they do.

    A pose is within reach where every leg is within its stroke and its joint limits and the wrench map has the
    orientation of home (the sign of its determinant). The nearest one is a local minimum of
    `sqrt(|shift|^2 + (r_p |turn|)^2)`, found by sequential quadratic programming from the last reachable pose on the
    straight way from home, of rotary legs also from home; it may miss a nearer one.

    Parameters
    ----------
    scenario
        Its robot.
    pose
        (6,) displacement from home, in B: difference of the positions [m], rotation vector [rad].

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        For a pose that is not six finite numbers within 1e6 with a rotation vector at most pi long.
    """
    require_scenario(scenario)
    wanted = _displacements(pose, ())
    scene = scene_of(scenario)
    there = scene.home.moved(wanted)
    nearest = nearest_limit(scene, there)
    within = bool(scene.reachable(there.rows)[0])
    found = wanted.copy() if within else nearest_within(scene, wanted)
    return Reachability(
        within=within,
        limit="singularity" if not within and nearest.within else nearest.limit,
        leg=nearest.leg,
        margin=nearest.margin,
        singularity=float(scene.hexapod.singular_values(there.position, there.quaternion)[-1]),
        lever_arm=float(scene.lever_arms(there).min()),
        unit=scene.units.small,
        pose=wanted,
        nearest=found,
        distance=distance(scene, wanted, found),
    )


def _joint(limit: str) -> str:
    return limit.replace("_", " ")


def _displacements(pose: ArrayLike, lead: tuple[object, ...]) -> Array:
    moves = real_numbers(pose)
    if moves is None:
        got = f"{pose!r:.60}"
    elif moves.shape[-1:] != (6,) or (not lead and moves.ndim != 1):
        got = f"shape {moves.shape}"
    elif not np.isfinite(moves).all():
        got = f"shape {moves.shape} with numbers that are not finite"
    elif moves.size and (largest := float(np.abs(moves).max())) > _LARGEST:
        got = f"{largest:.6g}"
    elif (problem := problem_of_turns(moves)) is not None:
        raise ValueError(f"pose: {problem}")
    else:
        return moves
    shape = "(..., 6)" if lead else "6"
    raise ValueError(f"pose: expected {shape} finite numbers within {_LARGEST:g} (m x3, rad x3), got {got}")
