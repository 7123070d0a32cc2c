"""Pose observability from one image as sentences, tables and curves (docs/analysis/conditioning.md)."""

from __future__ import annotations

import numpy as np

from hexservo.findings.analysis.conditioning import GRIP, Conditioning, Sight, noise_in_words
from hexservo.findings.analysis.goal import SHOWN, TOLERANCE
from hexservo.findings.analysis.placement import (
    DEPTH_SHARE,
    corner_angles,
    farthest,
    image_radius,
    in_circle,
    place,
    shape_name,
)
from hexservo.findings.analysis.words import displacement_words, motion_in_words, number, numbers
from hexservo.findings.evidence import Cell, Column, Curves, Line, Section, Table, Verdict, picked
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import to_pixels

PAGE = "docs/analysis/conditioning.md"

_PER_PIXEL = (
    *(Column(axis, "mm/px", ".3g") for axis in "xyz"),
    *(Column(f"about {axis}", "mrad/px", ".3g") for axis in "xyz"),
    Column("worst direction", "mm/px", ".3g"),
)


def section(found: Conditioning) -> Section:
    """Return the findings as sentences, tables and curves."""
    sights = [sight for sight in (found.start, found.goal, found.nearest) if sight is not None]
    return Section(
        name="conditioning",
        title="Pose observability from one image",
        sentences=_sentences(found, sights),
        items=(_sights_table(sights), _directions_table(sights), _placement_table(found), _curves(found)),
        verdict=_verdict(found, sights),
        data=_data(found, sights),
    )


def _verdict(found: Conditioning, sights: list[Sight]) -> Verdict:
    if found.goals is not None and found.goals.best.largest_residual > found.scene.band:
        return "bad"
    if any(sight.unobservable(found.noise) for sight in sights):
        return "bad"
    uncertain = found.noise * max(sight.worst for sight in sights) > GRIP * found.scene.stroke_length
    return "warning" if uncertain else "good"


def _sentences(found: Conditioning, sights: list[Sight]) -> list[str]:
    words = [
        f"At the {sight.place}, {noise_in_words(found.scene.scenario)} in each coordinate (1 sigma) makes the pose "
        f"uncertain by {numbers(1e3 * found.noise * sight.pose_sigma[:3])} mm along x, y and z and by "
        f"{numbers(1e3 * found.noise * sight.pose_sigma[3:])} mrad about them."
        for sight in sights[:2]
    ]
    seen = sights[:2][-1]
    motion = seen.hidden
    words.append(
        f"The least observable motion there is {motion_in_words(seen.view.jacobian, motion)}: "
        f"{number(1e3 * float(np.linalg.norm(motion[:3])))} mm with "
        f"{number(1e3 * float(np.linalg.norm(motion[3:])))} mrad change no image coordinate by more than "
        f"{number(_change(found, seen, motion))} px."
    )
    words.append(
        "The condition number of the image Jacobian is "
        + " and ".join(f"{sight.condition:.0f} at the {sight.place}" for sight in sights[:2])
        + " in metres and radians, "
        + " and ".join(f"{sight.scaled_condition:.0f}" for sight in sights[:2])
        + f" with rotations scaled by the depth of {found.start.length:.3g} m."
    )
    words.append(_goal_in_words(found))
    own, best = found.placements[0], found.placements[-1]
    cheap = found.placements[1]
    words.append(
        f"Within {image_radius(found.scene):.0f} px of the principal point and {DEPTH_SHARE:.0%} of the depth, other "
        f"placements of the points make the worst direction {_times(own.worst / best.worst)} "
        f"({number(1e3 * own.worst)} mm per px originally, {number(1e3 * best.worst)} mm with the best found); "
        + (
            f"one point off the plane alone makes it {_times(own.worst / cheap.worst)}."
            if cheap.worst < own.worst
            else "one point off the plane alone does not help."
        )
    )
    return words


def _change(found: Conditioning, seen: Sight, motion: Array) -> float:
    """Return the largest change of a coordinate that a motion from a pose makes [px].

    Linearised where there are no points in space, or the camera does not see all of them after the motion.
    """
    if found.scene.has_points:
        moved = float(np.abs(found.scene.view(seen.view.pose.moved(motion)).features - seen.view.features).max())
        if np.isfinite(moved):
            return moved
    return float(np.abs(seen.view.jacobian @ motion).max())


def _goal_in_words(found: Conditioning) -> str:
    if found.goals is None:
        return (
            "The goal pose is open: a camera as printed has no points in space, so no pose belongs to an image; "
            "all results are for the start."
        )
    best, nearest = found.goals.best, found.goals.nearest
    best_words = displacement_words(best.displacement, found.start.length)
    if not found.goals.reachable:
        return (
            f"No pose with the goal image was found: the best one leaves {best.largest_residual:.3g} px, "
            f"at {best_words} from home."
        )
    left = best.largest_residual
    off = "" if left < SHOWN else f" (its image is {number(left)} px from the goal image)"
    return (
        f"The goal pose is at {best_words} from home{off}; the nearest pose that leaves no coordinate more "
        f"than {TOLERANCE} px further off is at {displacement_words(nearest.displacement, found.start.length)}."
    )


def _curves(found: Conditioning) -> Curves:
    """Draw the worst direction over the size of a square, in a plane and with one corner off it."""
    placed = found.placements[0]
    length = float(np.abs(placed.depth).mean())
    own = farthest(placed.features)
    radii = np.geomspace(min(20.0, own), max(image_radius(found.scene), own), 30)
    count = len(placed.depth)
    plane = np.full(count, -length)
    near = plane.copy()
    near[0] *= 1 - DEPTH_SHARE
    corners = np.pi * np.array([1, 3, 5, 7]) / 4 if count == 4 else corner_angles(count)

    def worst(depth: Array) -> Array:
        return np.array([1e3 * place(found.scene, "", in_circle(r, corners), depth, length).worst for r in radii])

    best = found.placements[-1]
    return Curves(
        title="Worst direction for different placements of the points",
        x_label="largest distance of a feature from the principal point [px]",
        y_label="worst direction, rotations scaled by the depth [mm per px of noise]",
        lines=(
            Line(f"{shape_name(count)} in a plane", radii, worst(plane)),
            Line(f"one corner {DEPTH_SHARE:.0%} of the depth nearer", radii, worst(near), "dashed"),
            Line("as they are", np.array([own]), np.array([1e3 * placed.worst]), "points"),
            Line("best found", np.array([farthest(best.features)]), np.array([1e3 * best.worst]), "points"),
        ),
        x_log=True,
        y_log=True,
        note="At home, for the mean depth of the scenario's points.",
        page=PAGE,
    )


def _data(found: Conditioning, sights: list[Sight]) -> dict[str, object]:
    goals = found.goals
    return {
        "length": found.start.length,
        **{
            sight.place.replace(" ", "_"): {
                "singular_values": sight.values,
                "scaled_singular_values": sight.scaled_values,
                **picked(sight, "directions condition scaled_condition"),
                "pose_sigma_per_px": sight.pose_sigma,
                "worst_per_px": sight.worst,
                **picked(sight.view.pose, "position quaternion"),
            }
            for sight in sights
        },
        "goal_reachable": None if goals is None else goals.reachable,
        "goal_residual": None if goals is None else goals.best.largest_residual,
        "goal_displacement": None if goals is None else goals.best.displacement,
        "nearest_goal_displacement": None if goals is None else goals.nearest.displacement,
        "image_radius": image_radius(found.scene),
        "placements": [
            {
                **picked(placement, "name features depth"),
                "pixels": to_pixels(found.scene.scenario, placement.features),
                "pose_sigma_per_px": placement.pose_sigma,
                "worst_per_px": placement.worst,
            }
            for placement in found.placements
        ],
    }


def _times(factor: float) -> str:
    return f"{number(factor)} times better" if factor > 1.005 else "no better"


def _sights_table(sights: list[Sight]) -> Table:
    return Table(
        title="Pose error due to 1 px of noise in each coordinate",
        columns=(
            Column("at"),
            Column("condition number", format=".0f"),
            Column("with rotations scaled by depth", format=".0f"),
            *_PER_PIXEL,
        ),
        rows=[
            (sight.place, sight.condition, sight.scaled_condition, *(1e3 * sight.pose_sigma), 1e3 * sight.worst)
            for sight in sights
        ],
        note="Least squares from one image, 1 sigma of each axis in the base frame, linearised; a value larger than "
        "the depth or a radian only means unobservable. Worst direction: rotations are scaled by the depth.",
        page=PAGE,
    )


def _directions_table(sights: list[Sight]) -> Table:
    rows: list[list[Cell]] = [
        [
            sight.place,
            float(value),
            float(1e3 / value) if value > 0 else None,
            motion_in_words(sight.view.jacobian, direction),
        ]
        for sight in sights[:2]
        for value, direction in zip(sight.scaled_values, sight.directions, strict=True)
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


def _listed(values: Array) -> str:
    return f"[{', '.join(f'{value + 0.0:.4g}' for value in values)}]"


def _placement_table(found: Conditioning) -> Table:
    own, best = found.placements[0], found.placements[-1]
    pixels = to_pixels(found.scene.scenario, best.features)
    return Table(
        title="Other placements of the points, from home",
        columns=(
            Column("points"),
            *_PER_PIXEL,
            Column("better by", "times", ".3g"),
        ),
        rows=[
            (placement.name, *(1e3 * placement.pose_sigma), 1e3 * placement.worst, own.worst / placement.worst)
            for placement in found.placements
        ],
        note=f"The best found, as a scenario takes it, in pixels of its camera and metres: target.initial_features: "
        f"{_listed(np.round(pixels))}, target.depth: {_listed(-best.depth)}. Moved points need a new goal image.",
        page=PAGE,
    )
