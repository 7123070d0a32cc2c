"""Reach, singularities and loads of the legs, at the start and around the goal (docs/analysis/workspace.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hexservo.findings.analysis.goal import TOLERANCE, Goals, find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.reach import LegMargin, leg_margin
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.analysis.words import number
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Column, HeatMap, Line, Section, Table
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

__all__ = ["Reach", "Workspace", "WorkspacePose", "analyse", "reach"]

PAGE = "docs/analysis/workspace.md"
_RANDOM = 100  # directions of the random reach, and poses of a neighbourhood
_ROUNDS = 2000  # of the march to a limit, at most
_TOLERANCE = 1e-9  # of the stroke: where the march ends
_WAY = 51  # poses on the straight way to the goal
_GRID = 41  # of the map, each way
_SLIM = 0.1  # of stroke, force limit or distance to singularity: less than this is worth a warning
_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Reach:
    """How far the platform moves in one direction until a leg is at the end of its stroke."""

    direction: Array  # (6,), unit shift or unit turn, or both; distance is measured along it [m; rad]
    distance: float  # in units of the direction; infinite where no limit was met within half a turn
    leg: int  # 1 to 6, the limiting one; 0: none


@dataclass(frozen=True, eq=False)
class WorkspacePose:
    """The legs at one pose."""

    name: str
    pose: Poses
    travel: Array  # (6,) [m], longer than at home
    singularity: float  # smallest singular value of H, moments divided by r_p
    forces: Array  # (6,) [N], that hold the estimated weight; infinite at a singular pose
    actual_forces: Array  # (6,) [N], that hold the actual weight


@dataclass(frozen=True, eq=False, repr=False)
class Workspace(Findings):
    """What the legs allow."""

    scene: Scene
    goals: Goals | None
    start: WorkspacePose
    goal: WorkspacePose | None  # where the image error is least
    nearest: WorkspacePose | None  # the pose nearest to home that shows the goal image within 0.1 px
    axes: tuple[Reach, ...]  # from home: +x, -x, +y, ..., -z as shifts, then as turns
    least_shift: Reach  # of random directions from home: the shortest
    least_turn: Reach
    way_margin: Array  # (51,) [m], stroke that is left on the straight way from home to `goal`; empty without one
    neighbourhood_singularity: float  # smallest of random poses around the goal, or home, within the stroke
    neighbourhood_force: float  # [N], largest leg force that holds the actual weight there
    map_x: Array  # (41,) [m], from home
    map_y: Array  # (41,)
    map_margin: (
        Array  # (41, 41) [m], row by y: stroke that is left, negative beyond it, attitude and height of the goal
    )

    @property
    def stroke(self) -> float:
        """Travel of a leg each way [m]."""
        return self.scene.stroke

    @property
    def force_limit(self) -> float:
        """Largest leg force [N]."""
        return float(self.scene.settings.robot.force_limit)

    def section(self) -> Section:
        """Return the findings as sentences, tables and a map."""
        return Section(
            name="workspace",
            title="Reach and loads of the legs",
            sentences=self._sentences(),
            items=(self._places_table(), self._reach_table(), self._map()),
            verdict=self._verdict(),
            data=self._data(),
        )

    @property
    def _places(self) -> list[WorkspacePose]:
        return [place for place in (self.start, self.goal, self.nearest) if place is not None]

    def _leg(self, place: WorkspacePose) -> LegMargin:
        return leg_margin(place.travel, self.stroke)

    def _margin(self, place: WorkspacePose) -> float:
        return self._leg(place).margin

    def _verdict(self) -> Literal["good", "warning", "bad"]:
        reached = self.nearest or self.start
        if self._margin(reached) < 0 or np.abs(reached.actual_forces).max() > self.force_limit:
            return "bad"
        force = max(float(np.abs(place.actual_forces).max()) for place in self._places)
        margins = [self._margin(place) for place in self._places]
        slim = min([*margins, *self.way_margin]) < _SLIM * self.stroke or force > (1 - _SLIM) * self.force_limit
        singular = self.neighbourhood_singularity < _SLIM * self.start.singularity
        return "warning" if slim or singular else "good"

    def _sentences(self) -> list[str]:
        words = [self._of_goal()] if self.goal is not None and self.nearest is not None else []
        if self.goals is None:
            words.append("The goal pose is open: a camera as printed has no points in space.")
        words.append(
            f"From home the legs allow {_reach_words(self.axes[:6], 'mm', 'along')} and "
            f"{_reach_words(self.axes[6:], 'mrad', 'about')}; the shortest of {_RANDOM} random translations and "
            f"rotations are {_distance(self.least_shift)} mm and {_distance(self.least_turn)} mrad."
        )
        places = self._places[:2]
        words.append(
            "The distance to a singularity (smallest singular value of H, moments divided by r_p) is "
            + " and ".join(f"{number(place.singularity)} at the {place.name}" for place in places)
            + f", and at least {number(self.neighbourhood_singularity)} at random poses around the {places[-1].name} "
            "within the stroke."
        )
        heaviest = max(self._places, key=lambda place: float(np.abs(place.actual_forces).max()))
        words.append(
            f"Holding the platform takes up to {number(float(np.abs(heaviest.actual_forces).max()))} N in a leg at the "
            f"{heaviest.name}, and up to {number(self.neighbourhood_force)} N around the {places[-1].name}, of "
            f"{number(self.force_limit)} N allowed; this is without motion."
        )
        if self._overloaded():  # what decides the verdict comes first
            words.insert(0, words.pop())
        return words

    def _overloaded(self) -> bool:
        """Whether holding the platform takes nearly all that the legs allow, or more, and their stroke is no worse."""
        force = max(float(np.abs(place.actual_forces).max()) for place in self._places)
        beyond = self._margin(self.nearest or self.start) < 0
        return not beyond and force > (1 - _SLIM) * self.force_limit

    def _of_goal(self) -> str:
        assert self.goal is not None
        assert self.nearest is not None
        text = ""
        for place, name in (
            (self.goal, "At the goal"),
            (self.nearest, f"at the nearest pose with this image within {TOLERANCE} px"),
        ):
            leg = self._leg(place)
            text += (
                f"{name} leg {leg.leg} is {number(1e3 * abs(leg.travel))} mm from its length at home, "
                + (
                    f"with {number(1e3 * leg.margin)} mm of stroke left"
                    if leg.within
                    else f"{number(-1e3 * leg.margin)} mm beyond its stroke"
                )
                + "; "
            )
        least = float(self.way_margin.min())
        if least >= 0:
            return text + f"on the straight path to the goal {number(1e3 * least)} mm are left everywhere."
        first = int(np.flatnonzero(self.way_margin < 0)[0])
        return text + f"the straight path to the goal leaves the stroke after {100 * first / (_WAY - 1):.0f} % of it."

    def _places_table(self) -> Table:
        return Table(
            title="The legs at the start and at the goal",
            columns=(
                Column("at"),
                *(Column(f"leg {leg}", "mm", ".2f") for leg in range(1, 7)),
                Column("stroke left", "mm", ".2f"),
                Column("distance to singularity", format=".3f"),
                Column("largest leg force", "N", ".3g"),
                Column("largest leg force, actual weight", "N", ".3g"),
            ),
            rows=[
                (
                    place.name,
                    *(1e3 * place.travel),
                    1e3 * self._margin(place),
                    place.singularity,
                    float(np.abs(place.forces).max()),
                    float(np.abs(place.actual_forces).max()),
                )
                for place in self._places
            ],
            note=f"Travel of the legs from their lengths at home; {number(1e3 * self.stroke)} mm are allowed each way. "
            "Forces hold the weight, estimated and actual, without motion.",
            page=PAGE,
        )

    def _reach_table(self) -> Table:
        rows = []
        for pair in range(6):
            ahead, back = self.axes[2 * pair], self.axes[2 * pair + 1]
            unit = "mm" if pair < 3 else "mrad"
            name = ("shift along " if pair < 3 else "turn about ") + _AXES[pair % 3]
            rows.append((name, unit, *(_cell(end) for end in (ahead, back)), ahead.leg or None, back.leg or None))
        return Table(
            title="Reach from home, by axis",
            columns=(
                Column("motion"),
                Column("unit"),
                Column("ahead", format=".4g"),
                Column("back", format=".4g"),
                Column("limiting leg ahead", format="d"),
                Column("and back", format="d"),
            ),
            rows=rows,
            note="Until the first leg is at the end of its stroke; one motion at a time, in the base frame. Empty: no "
            "limit within 180 deg.",
            page=PAGE,
        )

    def _map(self) -> HeatMap:
        centre = self.goal or self.start
        home = self.scene.home.position
        lines = [Line("start", np.zeros(1), np.zeros(1), "points")]
        if self.goal is not None:
            x, y = 1e3 * (centre.pose.position - home)[:2]
            lines.append(Line("goal", np.array([x]), np.array([y]), "points"))
        where = "goal" if self.goal is not None else "start"
        return HeatMap(
            title=f"Remaining stroke, at the height and attitude of the {where}",
            x_label="translation along x from home [mm]",
            y_label="translation along y from home [mm]",
            z_label="stroke left [mm]",
            x=1e3 * self.map_x,
            y=1e3 * self.map_y,
            z=1e3 * self.map_margin,
            levels=(0.0,),
            lines=lines,
            note="For the leg nearest to its limit; beyond the stroke it is negative.",
            page=PAGE,
        )

    def _data(self) -> dict[str, object]:
        return {
            "stroke": self.stroke,
            "force_limit": self.force_limit,
            **{
                place.name.replace(" ", "_"): {
                    "position": place.pose.position,
                    "quaternion": place.pose.quaternion,
                    "leg_travel": place.travel,
                    "stroke_left": self._margin(place),
                    "singularity": place.singularity,
                    "leg_forces": place.forces,
                    "actual_leg_forces": place.actual_forces,
                }
                for place in self._places
            },
            "reach": [{"direction": end.direction, "distance": end.distance, "leg": end.leg} for end in self.axes],
            "least_shift": {"direction": self.least_shift.direction, "distance": self.least_shift.distance},
            "least_turn": {"direction": self.least_turn.direction, "distance": self.least_turn.distance},
            "way_stroke_left": self.way_margin,
            "neighbourhood_singularity": self.neighbourhood_singularity,
            "neighbourhood_force": self.neighbourhood_force,
        }


def analyse(scenario: Scenario) -> Workspace:
    """Work out reach, distance to singularity, holding forces and margins of stroke, by the core's legs."""
    scene = scene_of(scenario)
    goals = find_goals(scene)
    random = np.random.default_rng(0)
    units = [sign * row for row in np.eye(6) for sign in (1.0, -1.0)]
    sideways = random.normal(size=(_RANDOM, 3))
    sideways /= np.linalg.norm(sideways, axis=1)[:, None]
    none = np.zeros((_RANDOM, 3))
    ends = _reaches(scene, np.vstack([units, np.hstack([sideways, none]), np.hstack([none, sideways])]))
    shifts, turns = ends[len(units) : -_RANDOM], ends[-_RANDOM:]
    start = _place(scene, "start", scene.home)
    goal = None if goals is None else _place(scene, "goal", goals.best.view.pose)
    centre = goal or start
    around = _neighbourhood(scene, centre.pose, random)
    near = [_place(scene, "", around[row]) for row in range(len(around))]
    x, y, margin = _margin_map(scene, centre.pose)
    return Workspace(
        scene=scene,
        goals=goals,
        start=start,
        goal=goal,
        nearest=None if goals is None else _place(scene, "nearest goal", goals.nearest.view.pose),
        axes=tuple(ends[: len(units)]),
        least_shift=min(shifts, key=lambda end: end.distance),
        least_turn=min(turns, key=lambda end: end.distance),
        way_margin=np.empty(0) if goals is None else _way_margin(scene, goals.best.displacement),
        neighbourhood_singularity=min([place.singularity for place in near], default=centre.singularity),
        neighbourhood_force=max(float(np.abs(place.actual_forces).max()) for place in [*near, centre]),
        map_x=x,
        map_y=y,
        map_margin=margin,
    )


def reach(scene: Scene, direction: Array) -> Reach:
    """Move from home along a direction until a leg is at the end of its stroke.

    A leg changes its length by no more than the platform joints move, so that the remaining stroke bounds how far
    the next step may go without passing a limit: the march never steps over one.

    Parameters
    ----------
    scene
        Whose legs and home.
    direction
        (6,): shift [m] and rotation vector [rad] per unit of distance, in B.
    """
    return _reaches(scene, direction[None])[0]


def _reaches(scene: Scene, directions: Array) -> list[Reach]:
    """Give `reach` of all directions (n, 6), which march side by side."""
    turning = np.linalg.norm(directions[:, 3:], axis=1)
    speed = np.linalg.norm(directions[:, :3], axis=1) + scene.platform_radius * turning
    distance, leg = np.zeros(len(directions)), np.zeros(len(directions), dtype=int)
    marching = np.arange(len(directions))
    # Below the rounding of a length the march does not come any nearer.
    end = max(_TOLERANCE * scene.stroke, 4.0 * np.finfo(float).eps * float(np.max(scene.hexapod.home_lengths)))
    for _ in range(_ROUNDS):
        travel = np.abs(scene.leg_travel(scene.home.moved(distance[marching, None] * directions[marching])))
        left = scene.stroke - travel.max(axis=1)
        ended = left <= end
        leg[marching[ended]] = travel[ended].argmax(axis=1) + 1
        on = ~ended & (turning[marching] * distance[marching] <= np.pi)
        marching, left = marching[on], left[on]
        if not len(marching):
            break
        distance[marching] += left / speed[marching]
    distance[leg == 0] = np.inf
    return [Reach(*end) for end in zip(directions, distance.tolist(), leg.tolist(), strict=True)]


def _place(scene: Scene, name: str, pose: Poses) -> WorkspacePose:
    weight = np.array(scene.body.gravity_wrench)
    actual = (1.0 - np.array(scene.settings.uncertainty.dynamics.gravity)) * weight
    legs, at = scene.hexapod, (pose.position, pose.quaternion)

    def forces(wrench: Array) -> Array:
        try:
            return legs.leg_forces(*at, wrench)
        except ValueError:  # a singular pose
            return np.full(6, np.inf)

    return WorkspacePose(
        name=name,
        pose=pose,
        travel=scene.leg_travel(pose),
        singularity=float(np.min(legs.singular_values(*at))),
        forces=forces(weight),
        actual_forces=forces(actual),
    )


def _neighbourhood(scene: Scene, centre: Poses, random: np.random.Generator) -> Poses:
    """Draw poses around one and keep those within the stroke.

    They are shifted by up to half a stroke and turned by as much at the platform joints; no more than a quarter of r_p.
    """
    size = min(0.5 * scene.stroke, 0.25 * scene.platform_radius)
    ways = np.empty((_RANDOM, 6))
    for way in ways:
        way[:] = random.normal(size=6)
        way[:3] *= size * random.uniform() / np.linalg.norm(way[:3])
        way[3:] *= size * random.uniform() / np.linalg.norm(way[3:]) / scene.platform_radius
    poses = centre.moved(ways)
    return poses[scene.stroke_left(poses) >= 0]


def _way_margin(scene: Scene, displacement: Array) -> Array:
    return scene.stroke_left(scene.home.moved(np.linspace(0.0, 1.0, _WAY)[:, None] * displacement))


def _margin_map(scene: Scene, centre: Poses) -> tuple[Array, Array, Array]:
    """Give x and y from home [m] and the stroke that is left [m], over what the stroke may reach and the goal."""
    home = scene.home.position
    half = max(2.0 * scene.stroke, 1.2 * float(np.abs((centre.position - home)[:2]).max()))
    ticks = np.linspace(-half, half, _GRID)
    x, y = np.meshgrid(home[0] + ticks, home[1] + ticks)
    places = np.stack([x, y, np.full(x.shape, centre.position[2])], axis=-1)
    return ticks, ticks, scene.stroke_left(Poses(places, np.broadcast_to(centre.quaternion, (*x.shape, 4))))


def _distance(end: Reach) -> str:
    return number(1e3 * end.distance) if np.isfinite(end.distance) else "any number of"


def _cell(end: Reach) -> float | None:
    return 1e3 * end.distance if np.isfinite(end.distance) else None


def _reach_words(ends: tuple[Reach, ...], unit: str, word: str) -> str:
    """Say how far the motions of three axes go, ahead and back."""
    if not any(np.isfinite(end.distance) for end in ends):
        return f"180 deg {word} every axis"
    pairs = [f"+{_distance(ends[2 * k])}/-{_distance(ends[2 * k + 1])} {unit} {word} {_AXES[k]}" for k in range(3)]
    return ", ".join(pairs)
