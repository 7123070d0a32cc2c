"""Reach, singularities and loads of the legs, at the start and around the goal (docs/analysis/workspace.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import Goals, find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

__all__ = ["RANDOM", "WAY", "Reach", "Workspace", "WorkspacePose", "analyse", "reach"]

RANDOM = 100  # directions of the random reach, and poses of a neighbourhood
_ROUNDS = 2000  # of the march to a limit, at most
_CRANK_STEPS, _CRANK_ROUNDS = 200, 20000  # of the same with cranks: steps in a stroke, and at most
_TOLERANCE = 1e-9  # of the stroke: where the march ends
WAY = 51  # poses on the straight way to the goal
_GRID = 41  # of the map, each way


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
    travel: Array  # (6,) [m], longer than at home; of rotary legs angles [rad], as all travel here
    singularity: float  # smallest singular value of H, moments divided by r_p
    lever_arm: float  # smallest |w|/r of rotary legs, 0 where crank and rod are in line; 1 of prismatic ones
    forces: Array  # (6,) [N], that hold the estimated weight; infinite at a singular pose
    actual_forces: Array  # (6,) [N], that hold the actual weight


@dataclass(frozen=True, eq=False, repr=False)
class Workspace(Part):
    """Reach, singularities and loads of the legs."""

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
    neighbourhood_lever_arm: float  # the same
    neighbourhood_force: float  # [N], largest leg force that holds the actual weight there
    map_x: Array  # (41,) [m], from home
    map_y: Array  # (41,)
    map_margin: (
        Array  # (41, 41) [m], row by y: stroke that is left, negative beyond it, attitude and height of the goal
    )

    @property
    def stroke(self) -> float:
        """Travel of a leg each way [m], of rotary legs [rad]."""
        return self.scene.stroke

    @property
    def force_limit(self) -> float:
        """Largest leg force [N], of rotary legs torque [N m]."""
        return float(self.scene.settings["robot.force_limit"])


def analyse(scenario: Scenario) -> Workspace:
    """Compute reach, distance to singularity, holding forces and margins of stroke, by the core's legs."""
    scene = scene_of(scenario)
    goals = find_goals(scene)
    random = np.random.default_rng(0)
    units = [sign * row for row in np.eye(6) for sign in (1.0, -1.0)]
    sideways = random.normal(size=(RANDOM, 3))
    sideways /= np.linalg.norm(sideways, axis=1)[:, None]
    none = np.zeros((RANDOM, 3))
    ends = _reaches(scene, np.vstack([units, np.hstack([sideways, none]), np.hstack([none, sideways])]))
    shifts, turns = ends[len(units) : -RANDOM], ends[-RANDOM:]
    start = _place(scene, "start", scene.start)
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
        way_margin=np.empty(0) if goals is None else _way_margin(scene, goals.best.view.pose),
        neighbourhood_singularity=min([place.singularity for place in near], default=centre.singularity),
        neighbourhood_lever_arm=min([place.lever_arm for place in near], default=centre.lever_arm),
        neighbourhood_force=max(float(np.abs(place.actual_forces).max()) for place in [*near, centre]),
        map_x=x,
        map_y=y,
        map_margin=margin,
    )


def reach(scene: Scene, direction: Array) -> Reach:
    """Move from home along a direction until a leg is at the end of its stroke.

    A leg changes its length by no more than the platform joints move, so that the remaining stroke bounds how far
    the next step may go without passing a limit: the march never steps over one. The angle of a crank has no such bound
    near its reach: there the march takes steps of 1/200 of the stroke, and halves the one that passed a limit.

    Parameters
    ----------
    scene
        Whose legs and home.
    direction
        (6,): shift [m] and rotation vector [rad] per unit of distance, in B.
    """
    return _reaches(scene, direction[None])[0]


def _reaches(scene: Scene, directions: Array) -> list[Reach]:
    """Return `reach` of all directions (n, 6), which march side by side."""
    turning = np.linalg.norm(directions[:, 3:], axis=1)
    speed = np.linalg.norm(directions[:, :3], axis=1) + scene.platform_radius * turning
    if scene.hexapod.rotary:
        return [_crank_reach(scene, *pair) for pair in zip(directions, turning, speed, strict=True)]
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


def _crank_reach(scene: Scene, direction: Array, turning: float, speed: float) -> Reach:
    """Return `reach` of rotary legs along one direction (6,); the last step is halved until rounding ends it."""
    step = scene.stroke_length / _CRANK_STEPS / speed
    most = min(np.pi / turning if turning else np.inf, _CRANK_ROUNDS * step)

    def travel(distance: Array) -> Array:
        return np.abs(scene.leg_travel(scene.home.moved(distance[:, None] * direction)))

    for first in np.arange(0.0, most, _CRANK_STEPS * step):
        distances = first + step * np.arange(1, _CRANK_STEPS + 1)
        beyond = (travel(distances) > scene.stroke).any(axis=1)
        if not beyond.any():
            continue
        high = float(distances[np.argmax(beyond)])
        low = high - step
        while high - low > _TOLERANCE * scene.stroke_length / speed:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if (travel(np.array([middle])) > scene.stroke).any() else (middle, high)
        return Reach(direction, low, int(travel(np.array([high]))[0].argmax()) + 1)
    return Reach(direction, np.inf, 0)


def _place(scene: Scene, name: str, pose: Poses) -> WorkspacePose:
    weight = np.array(scene.body.weight(pose.quaternion))
    actual = (1.0 - scene.settings["uncertainty.gravity"]) * scene.settings.plant_body.weight(pose.quaternion)
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
        lever_arm=float(scene.lever_arms(pose).min()),
        forces=forces(weight),
        actual_forces=forces(actual),
    )


def _neighbourhood(scene: Scene, centre: Poses, random: np.random.Generator) -> Poses:
    """Draw poses around one and keep those within the stroke.

    They are shifted by up to half a stroke and turned by as much at the platform joints; no more than a quarter of r_p.
    """
    size = min(0.5 * scene.stroke_length, 0.25 * scene.platform_radius)
    ways = np.empty((RANDOM, 6))
    for way in ways:
        way[:] = random.normal(size=6)
        way[:3] *= size * random.uniform() / np.linalg.norm(way[:3])
        way[3:] *= size * random.uniform() / np.linalg.norm(way[3:]) / scene.platform_radius
    poses = centre.moved(ways)
    return poses[scene.stroke_left(poses) >= 0]


def _way_margin(scene: Scene, goal: Poses) -> Array:
    displacement = goal.displacement_from(scene.start)
    return scene.stroke_left(scene.start.moved(np.linspace(0.0, 1.0, WAY)[:, None] * displacement))


def _margin_map(scene: Scene, centre: Poses) -> tuple[Array, Array, Array]:
    """Return x and y from home [m] and the remaining stroke [m], over the reach of the stroke and the goal."""
    home = scene.home.position
    half = max(2.0 * scene.stroke_length, 1.2 * float(np.abs((centre.position - home)[:2]).max()))
    ticks = np.linspace(-half, half, _GRID)
    x, y = np.meshgrid(home[0] + ticks, home[1] + ticks)
    places = np.stack([x, y, np.full(x.shape, centre.position[2])], axis=-1)
    return ticks, ticks, scene.stroke_left(Poses(places, np.broadcast_to(centre.quaternion, (*x.shape, 4))))
