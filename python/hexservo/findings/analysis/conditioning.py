"""Pose observability from one image, at the start and at the goal, in mm and mrad (docs/analysis/conditioning.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hexservo.findings.analysis.goal import TOLERANCE, Goals, find_goals
from hexservo.findings.analysis.placement import DEPTH_SHARE, Placement, image_radius, in_circle, place, placements
from hexservo.findings.analysis.poses import without_sign
from hexservo.findings.analysis.scene import Scene, View, scene_of
from hexservo.findings.analysis.words import displacement_words, motion_in_words, number, numbers
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Cell, Column, Curves, Line, Section, Table
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

__all__ = ["Conditioning", "Sight", "analyse", "sight"]

PAGE = "docs/analysis/conditioning.md"
NOISE = 0.1  # [px], for the sentences; half of what the prior of `composite` takes a camera to have
_SHIFT, _TURN = 0.01, 0.2  # [m], [rad], of the displayed least observable motion; the rotation at most
_GRIP = 0.1  # of the stroke: a pose that is less certain than this, at `NOISE`, is worth a warning


@dataclass(frozen=True, eq=False)
class Sight:
    """The image Jacobian at one pose, taken apart. Directions and errors are in B."""

    place: str
    view: View
    length: float  # L [m], the points' mean depth: of what turns are multiplied by where metres and radians are mixed
    values: Array  # (6,) singular values of J as it stands [px/m and px/rad], falling
    scaled_values: Array  # (6,) of J diag(1, 1/L) [px/m], falling
    directions: (
        Array  # (6, 6), row k belongs to scaled_values[k]: shift [m] and rotation vector [rad], unit of length 1 m
    )
    pose_sigma: Array  # (6,) [m; rad] per px: least squares, 1 px of noise in each coordinate

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

    @property
    def hidden(self) -> Array:
        """The least observable motion, (6,) [m; rad], with a translation of 10 mm.

        With little translation it has this length with rotations scaled by `length`. It rotates by at most 0.2 rad.
        """
        motion = self.directions[-1]
        shift, turn = (float(np.linalg.norm(part)) for part in (motion[:3], motion[3:]))
        size = _SHIFT / (shift if shift > 0.2 else 1.0)
        return np.asarray(motion * (size if turn * size <= _TURN else _TURN / turn))


@dataclass(frozen=True, eq=False, repr=False)
class Conditioning(Findings):
    """How well four features tell a pose, and where they would tell it better."""

    scene: Scene
    start: Sight
    goal: Sight | None  # where the image error is least; None for a camera without points
    nearest: Sight | None  # the pose nearest to home within 0.1 px of that
    goals: Goals | None
    placements: tuple[Placement, ...]  # the scenario's own first, the best one found last

    def section(self) -> Section:
        """Return the findings as sentences, tables and curves."""
        sights = [found for found in (self.start, self.goal, self.nearest) if found is not None]
        return Section(
            name="conditioning",
            title="Pose observability from one image",
            sentences=self._sentences(sights),
            items=(_sights_table(sights), _directions_table(sights), _placement_table(self.placements), self._curves()),
            verdict=self._verdict(sights),
            data=self._data(sights),
        )

    @property
    def noise(self) -> float:
        """Noise in the sentences [px]: that of the camera if it has any, otherwise 0.1 px."""
        scenario = self.scene.scenario
        noisy = scenario.simulation.mode == "sampled" and scenario.camera.noise > 0
        return scenario.camera.noise if noisy else NOISE

    def _verdict(self, sights: list[Sight]) -> Literal["good", "warning", "bad"]:
        if self.goals is not None and self.goals.best.largest_residual > self.scene.band:
            return "bad"
        uncertain = self.noise * max(found.worst for found in sights) > _GRIP * self.scene.stroke
        return "warning" if uncertain else "good"

    def _sentences(self, sights: list[Sight]) -> list[str]:
        words = [
            f"At the {found.place}, {number(self.noise)} px of noise in each coordinate (1 sigma) makes the pose "
            f"uncertain by {numbers(1e3 * self.noise * found.pose_sigma[:3])} mm along x, y and z and by "
            f"{numbers(1e3 * self.noise * found.pose_sigma[3:])} mrad about them."
            for found in sights[:2]
        ]
        seen = sights[:2][-1]
        motion = seen.hidden
        words.append(
            f"The least observable motion there is {motion_in_words(seen.view.jacobian, motion)}: "
            f"{number(1e3 * float(np.linalg.norm(motion[:3])))} mm with "
            f"{number(1e3 * float(np.linalg.norm(motion[3:])))} mrad change no image coordinate by more than "
            f"{number(self._change(seen, motion))} px."
        )
        words.append(
            "The condition number of the image Jacobian is "
            + " and ".join(f"{found.condition:.0f} at the {found.place}" for found in sights[:2])
            + " in metres and radians, "
            + " and ".join(f"{found.scaled_condition:.0f}" for found in sights[:2])
            + f" with rotations scaled by the depth of {self.start.length:.3g} m."
        )
        words.append(self._goal_in_words())
        own, best = self.placements[0], self.placements[-1]
        cheap = self.placements[1]
        words.append(
            f"Within {image_radius(self.scene):.0f} px of the image centre and {DEPTH_SHARE:.0%} of the depth, other "
            f"placements of the four points make the worst direction {_times(own.worst / best.worst)} "
            f"({number(1e3 * own.worst)} mm per px originally, {number(1e3 * best.worst)} mm with the best found); "
            + (
                f"one point off the plane alone makes it {_times(own.worst / cheap.worst)}."
                if cheap.worst < own.worst
                else "one point off the plane alone does not help."
            )
        )
        return words

    def _change(self, seen: Sight, motion: Array) -> float:
        """Give the largest change of a coordinate that a motion from a pose makes [px].

        Linearised where there are no points in space, or the camera does not see all of them after the motion.
        """
        if self.scene.has_points:
            moved = float(np.abs(self.scene.view(seen.view.pose.moved(motion)).features - seen.view.features).max())
            if np.isfinite(moved):
                return moved
        return float(np.abs(seen.view.jacobian @ motion).max())

    def _goal_in_words(self) -> str:
        if self.goals is None:
            return (
                "The goal pose is open: a camera as printed has no points in space, so no pose belongs to an image; "
                "all results are for the start."
            )
        best, nearest = self.goals.best, self.goals.nearest
        if not self.goals.reachable and best.largest_residual > TOLERANCE:
            return (
                f"No pose with the goal image was found: the best one leaves {best.largest_residual:.3g} px, "
                f"at {displacement_words(best.displacement)} from home."
            )
        return (
            f"The goal pose is at {displacement_words(best.displacement)} from home; the nearest pose that "
            f"leaves no coordinate more than {TOLERANCE} px further off is at "
            f"{displacement_words(nearest.displacement)}."
        )

    def _curves(self) -> Curves:
        """Draw the worst direction over the size of a square, in a plane and with one corner off it."""
        length = self.start.length
        own = float(np.hypot(*self.start.view.features.reshape(4, 2).T).max())
        radii = np.geomspace(min(20.0, own), max(image_radius(self.scene), own), 30)
        plane = np.full(4, -length)
        near = plane * np.array([1 - DEPTH_SHARE, 1, 1, 1])
        corners = np.pi * np.array([1, 3, 5, 7]) / 4

        def worst(depth: Array) -> Array:
            return np.array([1e3 * place(self.scene, "", in_circle(r, corners), depth, length).worst for r in radii])

        best = self.placements[-1]
        return Curves(
            title="Worst direction for different placements of the points",
            x_label="largest distance of a feature from the image centre [px]",
            y_label="worst direction, rotations scaled by the depth [mm per px of noise]",
            lines=(
                Line("a square in a plane", radii, worst(plane)),
                Line(f"one corner {DEPTH_SHARE:.0%} of the depth nearer", radii, worst(near), "dashed"),
                Line("as they are", np.array([own]), np.array([1e3 * self.placements[0].worst]), "points"),
                Line(
                    "best found",
                    np.array([float(np.hypot(*best.features.reshape(4, 2).T).max())]),
                    np.array([1e3 * best.worst]),
                    "points",
                ),
            ),
            x_log=True,
            y_log=True,
            note="At home, for the mean depth of the scenario's points.",
            page=PAGE,
        )

    def _data(self, sights: list[Sight]) -> dict[str, object]:
        goals = self.goals
        return {
            "length": self.start.length,
            **{
                found.place.replace(" ", "_"): {
                    "singular_values": found.values,
                    "scaled_singular_values": found.scaled_values,
                    "directions": found.directions,
                    "condition": found.condition,
                    "scaled_condition": found.scaled_condition,
                    "pose_sigma_per_px": found.pose_sigma,
                    "worst_per_px": found.worst,
                    "position": found.view.pose.position,
                    "quaternion": found.view.pose.quaternion,
                }
                for found in sights
            },
            "goal_reachable": None if goals is None else goals.reachable,
            "goal_residual": None if goals is None else goals.best.largest_residual,
            "goal_displacement": None if goals is None else goals.best.displacement,
            "nearest_goal_displacement": None if goals is None else goals.nearest.displacement,
            "image_radius": image_radius(self.scene),
            "placements": [
                {
                    "name": found.name,
                    "features": found.features,
                    "depth": found.depth,
                    "pose_sigma_per_px": found.pose_sigma,
                    "worst_per_px": found.worst,
                }
                for found in self.placements
            ],
        }


def analyse(scenario: Scenario) -> Conditioning:
    """Take the image Jacobian apart at the start and at the goal, and search for better places of the points."""
    scene = scene_of(scenario)
    goals = find_goals(scene)
    start = scene.view(scene.home)
    return Conditioning(
        scene=scene,
        start=sight("start", start, start.mean_depth),
        goal=None if goals is None else sight("goal", goals.best.view, start.mean_depth),
        nearest=None if goals is None else sight("nearest goal", goals.nearest.view, start.mean_depth),
        goals=goals,
        placements=placements(scene),
    )


def sight(place: str, view: View, length: float) -> Sight:
    """Take the image Jacobian of a view apart.

    Parameters
    ----------
    place
        As a sentence.
    view
        With the true Jacobian.
    length
        L, of what turns are multiplied by [m].
    """
    units = np.repeat([1.0, length], 3)
    _, scaled_values, rows = np.linalg.svd(view.jacobian / units, full_matrices=False)
    rows = without_sign(rows)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(((rows / scaled_values[:, None]) ** 2).sum(axis=0)) / units
    return Sight(
        place=place,
        view=view,
        length=length,
        values=np.asarray(np.linalg.svd(view.jacobian, compute_uv=False), dtype=float),
        scaled_values=scaled_values,
        directions=rows / units,
        pose_sigma=sigma,
    )


def _ratio(values: Array) -> float:
    return float(values[0] / values[-1]) if values[-1] > 0 else np.inf


def _times(factor: float) -> str:
    return f"{number(factor)} times better" if factor > 1.005 else "no better"


def _sights_table(sights: list[Sight]) -> Table:
    return Table(
        title="Pose error due to 1 px of noise in each coordinate",
        columns=(
            Column("at"),
            Column("condition number", format=".0f"),
            Column("with rotations scaled by depth", format=".0f"),
            *(Column(axis, "mm/px", ".3g") for axis in "xyz"),
            *(Column(f"about {axis}", "mrad/px", ".3g") for axis in "xyz"),
            Column("worst direction", "mm/px", ".3g"),
        ),
        rows=[
            (
                found.place,
                found.condition,
                found.scaled_condition,
                *(1e3 * found.pose_sigma),
                1e3 * found.worst,
            )
            for found in sights
        ],
        note="Least squares from one image, 1 sigma of each axis in the base frame, linearised; a value larger than "
        "the depth or a radian only means unobservable. Worst direction: rotations are scaled by the depth.",
        page=PAGE,
    )


def _directions_table(sights: list[Sight]) -> Table:
    rows: list[list[Cell]] = [
        [
            found.place,
            float(value),
            float(1e3 / value) if value > 0 else None,
            motion_in_words(found.view.jacobian, direction),
        ]
        for found in sights[:2]
        for value, direction in zip(found.scaled_values, found.directions, strict=True)
    ]
    return Table(
        title="Singular values of the image Jacobian, with rotations scaled by the depth",
        columns=(
            Column("at"),
            Column("singular value", "px/m", ".4g"),
            Column("1 px is", "mm", ".3g"),
            Column("of the direction"),
        ),
        rows=rows,
        note="Translations and rotations are of the platform, in the base frame. For two equal values any combination "
        "of the directions is equivalent.",
        page=PAGE,
    )


def _placement_table(placements: tuple[Placement, ...]) -> Table:
    own = placements[0]
    return Table(
        title="Other placements of the four points, from home",
        columns=(
            Column("points"),
            *(Column(axis, "mm/px", ".3g") for axis in "xyz"),
            *(Column(f"about {axis}", "mrad/px", ".3g") for axis in "xyz"),
            Column("worst direction", "mm/px", ".3g"),
            Column("better by", "times", ".3g"),
        ),
        rows=[
            (found.name, *(1e3 * found.pose_sigma), 1e3 * found.worst, own.worst / found.worst) for found in placements
        ],
        note="The best found: "
        + "; ".join(
            f"({x:.0f}, {y:.0f}) px at {-z:.4g} m"
            for (x, y), z in zip(placements[-1].features.reshape(4, 2) + 0.0, placements[-1].depth, strict=True)
        )
        + ". Moved points need a new goal image.",
        page=PAGE,
    )
