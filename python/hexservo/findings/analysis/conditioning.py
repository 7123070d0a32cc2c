"""Pose observability from one image, at the start and at the goal, in mm and mrad (docs/analysis/conditioning.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import Goals, find_goals
from hexservo.findings.analysis.placement import Placement, observability, placements
from hexservo.findings.analysis.poses import without_sign
from hexservo.findings.analysis.scene import Scene, View, scene_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

NOISE = 0.1  # [px], for the sentences; half of what the prior of `composite` takes a camera to have
GRIP = 0.1  # of the stroke: a pose that is less certain than this, at the camera's noise, is worth a warning
_OF_DEPTH = 0.5  # uncertainty beyond which a position is not observable
_TURN = 0.2  # [rad], rotation of the displayed least observable motion, at most


@dataclass(frozen=True, eq=False)
class Sight:
    """Singular value decomposition of the Jacobian of pixels at one pose. Directions and errors are in B."""

    place: str
    view: View
    length: float  # L [m], the points' mean depth: of what turns are multiplied by where metres and radians are mixed
    values: Array  # (6,) singular values of J as it stands [px/m and px/rad], falling
    scaled_values: Array  # (6,) of J diag(1, 1/L) [px/m], falling
    directions: Array  # (6, 6), row k of scaled_values[k]: shift [m] and rotation vector [rad], unit of length 1 m
    pose_sigma: Array  # (6,) [m; rad] per px: least squares, 1 px of noise in each coordinate
    small_shift: float  # [m], of the displayed least observable motion

    @property
    def condition(self) -> float:
        """Condition number of J in metres and radians."""
        return _ratio(self.values)

    @property
    def scaled_condition(self) -> float:
        """Condition number with rotations scaled by `length`."""
        return _ratio(self.scaled_values)

    @property
    def worst(self) -> float:
        """Pose error due to 1 px of noise in the worst direction, with rotations scaled by `length` [m/px]."""
        return float(1.0 / self.scaled_values[-1]) if self.scaled_values[-1] > 0 else np.inf

    def unobservable(self, noise: float) -> bool:
        """Return whether a noise [px] makes the position uncertain by more than half of the depth, along any axis."""
        return bool((noise * self.pose_sigma[:3] > _OF_DEPTH * self.length).any())

    @property
    def hidden(self) -> Array:
        """The least observable motion, (6,) [m; rad], with a translation of `small_shift`.

        With little translation it has this length with rotations scaled by `length`. It rotates by at most 0.2 rad.
        """
        motion = self.directions[-1]
        shift, turn = (float(np.linalg.norm(part)) for part in (motion[:3], motion[3:]))
        size = self.small_shift / (shift if shift > 0.2 else 1.0)
        return np.asarray(motion * (size if turn * size <= _TURN else _TURN / turn))


@dataclass(frozen=True, eq=False, repr=False)
class Conditioning(Part):
    """Pose observability from the image of the points, and placements with better observability."""

    scene: Scene
    start: Sight
    goal: Sight | None  # where the image error is least; None for a camera without points
    nearest: Sight | None  # the pose nearest to home within 0.1 px of that
    goals: Goals | None
    placements: tuple[Placement, ...]  # the scenario's own first, the best one found last

    @property
    def noise(self) -> float:
        """Noise in the sentences [px]."""
        return noise_of(self.scene.scenario)


def analyse(scenario: Scenario) -> Conditioning:
    """Decompose the image Jacobian at the start and at the goal, and search for better places of the points."""
    scene = scene_of(scenario)
    goals = find_goals(scene)
    start = scene.view(scene.start)
    return Conditioning(
        scene=scene,
        start=sight("start", start, start.mean_depth, scene),
        goal=None if goals is None else sight("goal", goals.best.view, start.mean_depth, scene),
        nearest=None if goals is None else sight("nearest goal", goals.nearest.view, start.mean_depth, scene),
        goals=goals,
        placements=placements(scene),
    )


def noise_of(scenario: Scenario) -> float:
    """Return the noise [px] by which a target is judged: that of the camera's frames, otherwise 0.1 px."""
    return frames_noise(scenario) or NOISE


def frames_noise(scenario: Scenario) -> float:
    """Return the noise and rounding of the camera's frames [px]; 0 where the image is exact."""
    return feature_noise(scenario.camera) if scenario.sampled else 0.0


def noise_in_words(scenario: Scenario) -> str:
    """Return `noise_of`, and what it is of."""
    rounded = scenario.camera.quantisation > 0.0
    kinds = ["noise"] * (scenario.camera.noise > 0.0 or not rounded) + ["rounding"] * rounded
    return f"{number(noise_of(scenario))} px of {' and '.join(kinds)}"


def sight(place: str, view: View, length: float, scene: Scene) -> Sight:
    """Decompose the image Jacobian of a view by singular values.

    Parameters
    ----------
    place
        As a sentence.
    view
        With the true Jacobian.
    length
        L, of what turns are multiplied by [m].
    scene
        Whose camera has the noise, 1 px of it in each coordinate, and whose points count by their weights.
    """
    jacobian = scene.of_noise(view.features, view.jacobian)
    units = np.repeat([1.0, length], 3)
    scaled_values, directions, sigma = observability(jacobian / units, length)
    return Sight(
        place=place,
        view=view,
        length=length,
        values=np.asarray(np.linalg.svd(jacobian, compute_uv=False), dtype=float),
        scaled_values=scaled_values,
        directions=without_sign(directions) / units,
        pose_sigma=sigma,
        small_shift=scene.small_shift,
    )


def _ratio(values: Array) -> float:
    return float(values[0] / values[-1]) if values[-1] > 0 else np.inf
