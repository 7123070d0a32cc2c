"""Reach, singularities and loads of the legs as sentences, tables and a map (docs/analysis/workspace.md)."""

from __future__ import annotations

import math

import numpy as np

from hexservo.findings.analysis.goal import TOLERANCE
from hexservo.findings.analysis.reach import leg_margin
from hexservo.findings.analysis.words import AXES, finite, number
from hexservo.findings.analysis.workspace import RANDOM, WAY, Reach, Workspace, WorkspacePose
from hexservo.findings.evidence import Column, HeatMap, Line, Section, Table, Verdict, picked

PAGE = "docs/analysis/workspace.md"
_SLIM = 0.1  # of stroke, force limit or distance to singularity: less than this is worth a warning
_SIDES = ("base", "platform")
_ENDS = {
    "stroke": "stroke",
    "base_joint": "base joint",
    "platform_joint": "platform joint",
    "singularity": "singular pose",
}


def section(found: Workspace) -> Section:
    """Return the findings as sentences, tables and a map."""
    return Section(
        name="workspace",
        title="Reach and loads of the legs",
        sentences=_sentences(found),
        items=(_places_table(found), *_speed_table(found), _reach_table(found), _map(found)),
        verdict=_verdict(found),
        data=_data(found),
    )


def _verdict(found: Workspace) -> Verdict:
    reached = found.nearest or found.start
    if not reached.reachable or np.abs(reached.actual_forces).max() > found.force_limit:
        return "bad"
    slim = min([*(place.left for place in _places(found)), *found.way_left]) < _SLIM or not found.way_within.all()
    slim = slim or _largest_force(found) > (1 - _SLIM) * found.force_limit
    singular = found.neighbourhood_singularity < _SLIM * found.start.singularity
    return "warning" if slim or singular else "good"


def _sentences(found: Workspace) -> list[str]:
    words = [_of_goal(found)] if found.goal is not None and found.nearest is not None else []
    if found.goals is None:
        words.append("The goal pose is open: a camera as printed has no points in space.")
    words.append(
        f"From home the legs allow {_reach_words(found.axes[:6], 'mm', AXES[:3])} and "
        f"{_reach_words(found.axes[6:], 'mrad', AXES[3:])}; the shortest of {RANDOM} random translations and "
        f"rotations are {_distance(found.least_shift)} mm and {_distance(found.least_turn)} mrad."
    )
    places = _places(found)[:2]

    def distance_to(what: str, at_places: list[float], around: float) -> str:
        at = " and ".join(f"{number(one)} at the {place.name}" for one, place in zip(at_places, places, strict=True))
        return (
            f"The distance to {what} is {at}, and at least {number(around)} at random poses around the "
            f"{places[-1].name} within {_limits(found)}."
        )

    singular = "a singularity (smallest singular value of H, moments divided by r_p)"
    words.append(distance_to(singular, [at.singularity for at in places], found.neighbourhood_singularity))
    if found.scene.hexapod.rotary:
        in_line = "cranks in line with their rods (smallest lever arm of a rod, relative to the crank)"
        words.append(distance_to(in_line, [at.lever_arm for at in places], found.neighbourhood_lever_arm))
    effort = found.scene.units.effort
    heaviest = max(_places(found), key=lambda place: float(np.abs(place.actual_forces).max()))
    words.append(
        f"Holding the platform takes up to {number(float(np.abs(heaviest.actual_forces).max()))} {effort} in a leg at "
        f"the {heaviest.name}, and up to {number(found.neighbourhood_force)} {effort} around the {places[-1].name}"
        + (f" and {number(found.way_force)} {effort} on the straight path" if found.way_within.any() else "")
        + f", of {number(found.force_limit)} {effort} allowed; this is without motion."
    )
    if _overloaded(found):  # what decides the verdict comes first
        words.insert(0, words.pop())
    return words


def _overloaded(found: Workspace) -> bool:
    """Return whether forces are near the limit of the legs, or beyond, while start and goals are within reach."""
    reachable = all(place.reachable for place in _places(found))
    return reachable and _largest_force(found) > (1 - _SLIM) * found.force_limit


def _largest_force(found: Workspace) -> float:
    """Return the largest force of a leg that holds the actual weight at any of the poses [N], torque [N m]."""
    at_places = max(float(np.abs(place.actual_forces).max()) for place in _places(found))
    return max(at_places, found.neighbourhood_force, found.way_force)


def _of_goal(found: Workspace) -> str:
    assert found.goal is not None
    assert found.nearest is not None
    text = ""
    for place, name in (
        (found.goal, "At the goal"),
        (found.nearest, f"at the nearest pose with this image within {TOLERANCE} px"),
    ):
        text += f"{name} {_of_leg(found, place)}; "
    if found.way_within.all():
        least = float(found.way_left.min())
        of_stroke = f"{number(1e3 * least * found.stroke)} {found.scene.units.small}"
        left = f"{100 * least:.0f} % of the legs' limits" if _tilts_count(found) else of_stroke
        return text + f"on the straight path to the goal {left} are left everywhere."
    first = int(np.flatnonzero(~found.way_within)[0])
    what = f"leaves {_limits(found)}" if found.way_left[first] < 0 else "comes to a singular pose"
    return text + f"the straight path to the goal {what} after {100 * first / (WAY - 1):.0f} % of it."


def _of_leg(found: Workspace, place: WorkspacePose) -> str:
    """Return where the leg that is nearest to a limit is at a pose, and what is left of that limit."""
    leg, units = place.nearest_limit, found.scene.units
    if leg.limit != "stroke":
        joint = f"the {leg.limit.replace('_', ' ')} of leg {leg.leg}"
        left = (
            f"has {number(1e3 * leg.margin)} mrad left"
            if leg.within
            else f"is {number(-1e3 * leg.margin)} mrad beyond its limit"
        )
        return f"{joint} {left}"
    if not np.isfinite(leg.travel):
        return f"leg {leg.leg} does not reach"
    end = (
        f"with {number(1e3 * leg.margin)} {units.small} of stroke left"
        if leg.within
        else f"{number(-1e3 * leg.margin)} {units.small} beyond its stroke"
    )
    return f"leg {leg.leg} is {number(1e3 * abs(leg.travel))} {units.small} from the middle of its travel, {end}"


def _tilts_count(found: Workspace) -> bool:
    return found.scene.joint_limit is not None


def _limits(found: Workspace) -> str:
    return "the legs' limits" if _tilts_count(found) else "the stroke"


def _places_table(found: Workspace) -> Table:
    units = found.scene.units
    travel = f".{_decimals(1e3 * found.stroke)}f"
    return Table(
        title="The legs at the start and at the goal",
        columns=(
            Column("at"),
            *(Column(f"leg {leg}", units.small, travel) for leg in range(1, 7)),
            Column("stroke left", units.small, travel),
            *([Column(f"largest tilt at the {side}", "mrad", ".1f") for side in _SIDES] if _tilts_count(found) else []),
            Column("distance to singularity", format=".3f"),
            Column(f"largest leg {units.effort_name}", units.effort, ".3g"),
            Column(f"largest leg {units.effort_name}, actual weight", units.effort, ".3g"),
        ),
        rows=[
            (
                place.name,
                *(1e3 * place.travel),
                1e3 * _stroke_left(found, place),
                *([] if place.tilts is None else 1e3 * place.tilts.max(axis=1)),
                place.singularity,
                float(np.abs(place.forces).max()),
                float(np.abs(place.actual_forces).max()),
            )
            for place in _places(found)
        ],
        note=f"Travel of the legs from its middle; {number(1e3 * found.stroke)} {units.small} are allowed each way"
        f"{_tilts_allowed(found)}. {units.effort_name.capitalize()}s hold the weight, estimated and "
        "actual, without motion.",
        page=PAGE,
    )


def _decimals(stroke: float) -> int:
    """Return the decimals of leg travels, two at least: they show the first three digits of the stroke [mm, mrad]."""
    return max(2, 2 - math.floor(math.log10(stroke)))


def _tilts_allowed(found: Workspace) -> str:
    limit = found.scene.joint_limit
    if limit is None:
        return ""
    base, platform = (f"{number(1e3 * float(value))} mrad" for value in limit)
    return f", and tilts of {base} at the base and {platform} at the platform"


def _speed_table(found: Workspace) -> list[Table]:
    """Return how fast the platform moves with the legs at their speed limit, where they have one."""
    places = [(place, place.speeds) for place in _places(found)[:2] if place.speeds is not None]
    if not places:
        return []
    limit, units = found.scene.scenario.robot.speed_limit or 0.0, found.scene.units
    return [
        Table(
            title="Largest speeds of the platform at the speed limit of the legs",
            columns=(
                Column("at"),
                *(Column(axis, "mm/s" if k < 3 else "mrad/s", ".4g") for k, axis in enumerate(AXES)),
            ),
            rows=[(place.name, *(1e3 * speeds)) for place, speeds in places],
            note=f"One motion at a time, in the base frame, until the first leg is at {number(1e3 * limit)} "
            f"{units.small}/s.",
            page=PAGE,
        )
    ]


def _reach_table(found: Workspace) -> Table:
    ahead, back = found.axes[::2], found.axes[1::2]
    return Table.of(
        "Reach from home, by axis",
        range(6),
        [
            (Column("motion"), lambda axis: f"{'shift' if axis < 3 else 'turn'} {AXES[axis]}"),
            (Column("unit"), lambda axis: "mm" if axis < 3 else "mrad"),
            (Column("ahead", format=".4g"), lambda axis: finite(1e3 * ahead[axis].distance)),
            (Column("back", format=".4g"), lambda axis: finite(1e3 * back[axis].distance)),
            (Column("limit ahead"), lambda axis: _end(ahead[axis])),
            (Column("and back"), lambda axis: _end(back[axis])),
        ],
        note="Until the first leg is at a limit or the legs are singular; one motion at a time, in the base frame. "
        "Empty: no limit within 180 deg.",
        page=PAGE,
    )


def _map(found: Workspace) -> HeatMap:
    home = found.scene.home.position
    lines = []
    for place in (found.start, found.goal):
        if place is not None:
            x, y = 1e3 * (place.pose.position - home)[:2]
            lines.append(Line(place.name, np.array([x]), np.array([y]), "points"))
    where = "goal" if found.goal is not None else "start"
    if _tilts_count(found):
        what, label, scale = "Remaining share of stroke and joint limits", "left of the limit [%]", 100.0
    else:
        unit = found.scene.units.small
        what, label, scale = "Remaining stroke", f"stroke left [{unit}]", 1e3 * found.stroke
    return HeatMap(
        title=f"{what}, at the height and attitude of the {where}",
        x_label="translation along x from home [mm]",
        y_label="translation along y from home [mm]",
        z_label=label,
        x=1e3 * found.map_x,
        y=1e3 * found.map_y,
        z=scale * found.map_left,
        levels=(0.0,),
        lines=lines,
        note="For the leg nearest to its limit; beyond it the value is negative.",
        page=PAGE,
    )


def _data(found: Workspace) -> dict[str, object]:
    return {
        **picked(found, "stroke force_limit"),
        "speed_limit": found.scene.scenario.robot.speed_limit,
        "joint_limit": found.scene.joint_limit,
        **{
            place.name.replace(" ", "_"): {
                **picked(place.pose, "position quaternion"),
                "leg_travel": place.travel,
                "stroke_left": _stroke_left(found, place),
                "reachable": place.reachable,
                **({} if place.tilts is None else {"leg_tilts": place.tilts}),
                **({} if place.speeds is None else {"speeds": place.speeds}),
                "singularity": place.singularity,
                **({"lever_arm": place.lever_arm} if found.scene.hexapod.rotary else {}),
                "leg_forces": place.forces,
                "actual_leg_forces": place.actual_forces,
            }
            for place in _places(found)
        },
        "reach": [picked(end, "direction distance leg limit") for end in found.axes],
        "least_shift": picked(found.least_shift, "direction distance"),
        "least_turn": picked(found.least_turn, "direction distance"),
        "way_limits_left": found.way_left,
        **picked(found, "neighbourhood_singularity neighbourhood_force way_force"),
    }


def _places(found: Workspace) -> list[WorkspacePose]:
    return [place for place in (found.start, found.goal, found.nearest) if place is not None]


def _stroke_left(found: Workspace, place: WorkspacePose) -> float:
    return leg_margin(place.travel, found.stroke).margin


def _end(end: Reach) -> str | None:
    """Return what ends a motion, in a table."""
    if end.limit == "none":
        return None
    return _ENDS[end.limit] + (f" of leg {end.leg}" if end.leg else "")


def _distance(end: Reach) -> str:
    return number(1e3 * end.distance) if np.isfinite(end.distance) else "any number of"


def _reach_words(ends: tuple[Reach, ...], unit: str, axes: tuple[str, ...]) -> str:
    """Return how far three axes reach, ahead and back."""
    if not any(np.isfinite(end.distance) for end in ends):
        return f"180 deg {axes[0].removesuffix(' x')} every axis"
    pairs = zip(ends[::2], ends[1::2], axes, strict=True)
    return ", ".join(f"+{_distance(ahead)}/-{_distance(back)} {unit} {axis}" for ahead, back, axis in pairs)
