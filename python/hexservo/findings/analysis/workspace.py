"""Reach, singularities and loads of the legs, at the start and around the goal (docs/analysis/workspace.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.goal import Goals, find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.reach import LEG_LIMITS, LegMargin, nearest_limit
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.scenario import Scenario

RANDOM = 100  # directions of the random reach, and poses of a neighbourhood
_ROUNDS = 2000  # of the march to a limit, at most
_CRANK_STEPS, _CRANK_ROUNDS = 200, 20000  # of the same with cranks: steps in a stroke, and at most
_TOLERANCE = 1e-9  # of the stroke and of joint limits: where the march ends
_SINGULAR = 1e-6  # smallest singular value of H about the joints' mean, moments divided by r_p: the march ends there
_NEARER = 0.1  # of a leg's length, by which it changes at most in one step of the march
_FIRST = 1e-3  # of a leg's length: the first step of a leg that is at the end of its stroke and leaves it
WAY = 51  # poses on the straight way to the goal
_GRID = 41  # of the map, each way


@dataclass(frozen=True, eq=False)
class Reach:
    """How far the platform moves in one direction until a leg is at a limit, or the legs are singular."""

    direction: Array  # (6,), unit shift or unit turn, or both; distance is measured along it [m; rad]
    distance: float  # in units of the direction; infinite where no limit was met within half a turn
    leg: int  # 1 to 6, the limiting one; 0: none
    limit: str  # stroke | base_joint | platform_joint | singularity | none


@dataclass(frozen=True, eq=False)
class WorkspacePose:
    """The legs at one pose."""

    name: str
    pose: Poses
    # (6,) [m], longer than in the middle of their travel; of rotary legs angles [rad], as all travel here
    travel: Array
    tilts: Array | None  # (2, 6) [rad], of the legs from home, at base and platform; None: no joint limits
    nearest_limit: LegMargin  # of stroke and joint limits
    left: float  # share of that limit; negative beyond it
    reachable: bool  # as of `hs.reachable`
    speeds: Array | None  # (6,) [m/s; rad/s], along and about x, y and z at the legs' speed limit; None: there is none
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
    # (51,) share of the legs' limits left on the straight way from the start to `goal`; empty without one
    way_left: Array
    way_within: Mask  # (51,) whether the legs reach it there
    way_force: float  # [N], largest leg force that holds the actual weight there, within reach, not singular; 0: none
    neighbourhood_singularity: float  # smallest of random poses within reach around the goal, or the start
    neighbourhood_lever_arm: float  # the same
    neighbourhood_force: float  # [N], largest leg force that holds the actual weight there
    map_x: Array  # (41,) [m], from home
    map_y: Array  # (41,)
    # (41, 41), row by y: share of the legs' limits left, negative beyond, at the goal's attitude and height
    map_left: Array

    @property
    def stroke(self) -> float:
        """Travel of a leg each way [m], of rotary legs [rad]."""
        return self.scene.stroke

    @property
    def force_limit(self) -> float:
        """Largest leg force [N], of rotary legs torque [N m]."""
        return float(self.scene.settings["robot.force_limit"])


def analyse(scenario: Scenario) -> Workspace:
    """Compute reach, distance to singularity, holding forces and margins of the limits, by the core's legs.

    Within reach is what `hs.reachable` takes for it: by stroke and joint limits, on home's side of the singular poses.
    """
    scene = scene_of(scenario)
    goals = find_goals(scene)
    random = np.random.default_rng(0)
    units = [sign * row for row in np.eye(6) for sign in (1.0, -1.0)]
    sideways = random.normal(size=(RANDOM, 3))
    sideways /= np.linalg.norm(sideways, axis=1)[:, None]
    none = np.zeros((RANDOM, 3))
    ends = reaches(scene, np.vstack([units, np.hstack([sideways, none]), np.hstack([none, sideways])]))
    shifts, turns = ends[len(units) : -RANDOM], ends[-RANDOM:]
    start = _place(scene, "start", scene.start)
    goal = None if goals is None else _place(scene, "goal", goals.best.view.pose)
    centre = goal or start
    around = _neighbourhood(scene, centre.pose, random)
    near = [_place(scene, "", around[row]) for row in range(len(around))]
    x, y, left = _left_map(scene, centre.pose)
    way_left, way_within, way_force = _way(scene, None if goals is None else goals.best.view.pose)
    return Workspace(
        scene=scene,
        goals=goals,
        start=start,
        goal=goal,
        nearest=None if goals is None else _place(scene, "nearest goal", goals.nearest.view.pose),
        axes=tuple(ends[: len(units)]),
        least_shift=min(shifts, key=lambda end: end.distance),
        least_turn=min(turns, key=lambda end: end.distance),
        way_left=way_left,
        way_within=way_within,
        way_force=way_force,
        neighbourhood_singularity=min([place.singularity for place in near], default=centre.singularity),
        neighbourhood_lever_arm=min([place.lever_arm for place in near], default=centre.lever_arm),
        neighbourhood_force=max(float(np.abs(place.actual_forces).max()) for place in [*near, centre]),
        map_x=x,
        map_y=y,
        map_left=left,
    )


def reach(scene: Scene, direction: Array) -> Reach:
    """Move from home along a direction until a leg is at a limit, or the legs are singular.

    Lengths, tilts and singular values of the legs change no faster than bounds that follow from the motion of the
    platform joints, so that what is left bounds how far the next step may go without passing a limit: the march never
    steps over one. A leg that home has at the end of its stroke limits only the directions that take it farther. The
    angle of a crank has no such bound near its reach: there the march takes steps of 1/200 of the stroke, and halves
    the one that passed a limit.

    Parameters
    ----------
    scene
        Whose legs and home.
    direction
        (6,): shift [m] and rotation vector [rad] per unit of distance, in B.
    """
    return reaches(scene, direction[None])[0]


def reaches(scene: Scene, directions: Array) -> list[Reach]:
    """Return `reach` of all directions (n, 6), which march side by side."""
    turning = np.linalg.norm(directions[:, 3:], axis=1)
    joints = np.reshape(scene.hexapod.platform_joints, (6, 3))
    arm = float(np.linalg.norm(joints, axis=1).max())
    speed = np.linalg.norm(directions[:, :3], axis=1) + arm * turning  # of a platform joint, at most
    if scene.hexapod.rotary:
        return [_crank_reach(scene, *pair) for pair in zip(directions, turning, speed, strict=True)]
    distance, found = np.zeros(len(directions)), [(0, "none")] * len(directions)
    marching = np.arange(len(directions))
    # Below the rounding of a length the march does not come any nearer.
    end = max(_TOLERANCE, 4.0 * np.finfo(float).eps * float(np.max(scene.hexapod.home_lengths)) / scene.stroke)
    free = _leaving(scene, directions, speed, arm * turning**2, end)
    for last in np.arange(_ROUNDS) == _ROUNDS - 1:
        poses = scene.home.moved(distance[marching, None] * directions[marching])
        left = 1.0 - scene.limits_used(poses)  # (n, k, 6), shares
        leaving = distance[marching, None] < free[marching]
        left[:, 0][leaving] = 1.0
        singular = _distance_to_singular(scene, poses)
        at_limit = left.min(axis=(1, 2)) <= end
        ended = at_limit | (singular <= _SINGULAR) | last
        for row in np.flatnonzero(ended):
            found[marching[row]] = _limit(1.0 - left[row]) if at_limit[row] or last else (0, "singularity")
        on = ~ended & (turning[marching] * distance[marching] <= np.pi)
        lengths = (scene.leg_travel(poses) + scene.hexapod.mid_lengths).min(axis=1)
        steps = _steps(scene, left, singular, lengths, speed[marching], turning[marching])
        steps = np.minimum(steps, np.where(leaving, free[marching] - distance[marching, None], np.inf).min(axis=1))
        distance[marching[on]] += steps[on]
        marching = marching[on]
        if not len(marching):
            break
    distance[[leg == 0 and limit == "none" for leg, limit in found]] = np.inf
    ends = zip(directions, distance.tolist(), found, strict=True)
    return [Reach(direction, far, leg, limit) for direction, far, (leg, limit) in ends]


def _leaving(scene: Scene, directions: Array, speed: Array, bend: Array, end: float) -> Array:
    """Return up to which distances (n, 6) legs at the end of their stroke at home are within it; 0 for all others.

    A length changes at a rate `a` along a direction, and its second derivative is at most `c = speed^2/l + |p''|`: a
    leg that leaves its end at `a` is not back before `2 a/c`. Half of that is used, and no more than the stroke or a
    tenth of the leg. Where `a` is zero the curvature decides, by a small step.

    Parameters
    ----------
    scene, directions
        As in `reaches`.
    speed, bend
        (n,), largest first and second derivative of a platform joint's position by the distance [m; m].
    end
        Share of the stroke below which a leg is at its end.
    """
    travel = scene.leg_travel(scene.home)
    outwards = np.where(np.abs(1.0 - np.abs(travel) / scene.stroke) <= end, np.sign(travel), 0.0)
    if not outwards.any():
        return np.zeros((len(directions), 6))
    length = np.asarray(scene.hexapod.home_lengths)
    inwards = -outwards * np.array([scene.leg_rates(scene.home, direction) for direction in directions])
    curvature = speed[:, None] ** 2 / ((1.0 - _NEARER) * length) + bend[:, None]
    free = np.minimum(inwards / curvature, np.minimum(scene.stroke, _NEARER * length) / speed[:, None])
    first = _FIRST * float(length.min()) / speed
    probed = scene.leg_travel(scene.home.moved(first[:, None] * directions))
    curved = np.where(outwards * (probed - travel) < 0.0, first[:, None], 0.0)
    free = np.where(np.abs(inwards) > _TOLERANCE * speed[:, None], free, curved)
    return np.where(outwards != 0.0, np.maximum(free, 0.0), 0.0)


def _distance_to_singular(scene: Scene, poses: Poses) -> Array:
    """Return the smallest singular values (n,) of H about the mean of the platform joints, moments divided by r_p.

    The zeros do not depend on the point; about a far one all values are small.
    """
    mean = np.reshape(scene.hexapod.platform_joints, (6, 3)).mean(axis=0, keepdims=True)
    to_mean = poses.carried(mean) - poses.position[:, None]  # (n, 1, 3)
    force, moment = np.split(scene.wrench_maps(poses), 2, axis=1)
    moment = (moment - np.cross(to_mean.swapaxes(1, 2), force, axis=1)) / scene.platform_radius
    return np.asarray(np.linalg.svd(np.concatenate([force, moment], axis=1), compute_uv=False)[:, -1])


def _steps(scene: Scene, left: Array, singular: Array, length: Array, speed: Array, turning: Array) -> Array:
    """Return how far the march may go from each pose, (n,), in units of the directions.

    Within a step of a tenth of the shortest leg no leg is shorter than 0.9 l. So its direction changes by at most
    `speed/(0.9 l)`, in E by that and the rotation, and a column `(n; p x n/r_p)` of H, p from the joints' mean, by what
    follows from both. No singular value of H changes by more than the change of H in the Frobenius norm.
    """
    legs = speed / ((1.0 - _NEARER) * length)  # [rad] of a leg's direction in B, per unit of distance
    # sum |p|^2 = 6 r_p^2
    columns = np.sqrt(6.0) * np.hypot(legs, turning + legs)
    steps = [_NEARER * length / speed, left[:, 0].min(axis=1) * scene.stroke / speed, singular / columns]
    if scene.joint_limit is not None:
        tilts = left[:, 1:].min(axis=2) * scene.joint_limit  # [rad], (n, 2)
        steps += [tilts[:, 0] / legs, tilts[:, 1] / (legs + turning)]
    return np.asarray(np.min(steps, axis=0))


def _crank_reach(scene: Scene, direction: Array, turning: float, speed: float) -> Reach:
    """Return `reach` of rotary legs along one direction (6,); the last step is halved until rounding ends it."""
    step = scene.stroke_length / _CRANK_STEPS / speed
    most = min(np.pi / turning if turning else np.inf, _CRANK_ROUNDS * step)

    def beyond(distance: Array) -> Mask:
        return ~scene.reachable(scene.home.moved(distance[:, None] * direction))

    for first in np.arange(0.0, most, _CRANK_STEPS * step):
        distances = first + step * np.arange(1, _CRANK_STEPS + 1)
        passed = beyond(distances)
        if not passed.any():
            continue
        high = float(distances[np.argmax(passed)])
        low = high - step
        while high - low > _TOLERANCE * scene.stroke_length / speed:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if beyond(np.array([middle]))[0] else (middle, high)
        used = scene.limits_used(scene.home.moved(high * direction))
        return Reach(direction, low, *(_limit(used) if used.max() > 1.0 else (0, "singularity")))
    return Reach(direction, np.inf, 0, "none")


def _limit(used: Array) -> tuple[int, str]:
    """Return the leg, 1 to 6, and the limit of which the largest share (k, 6) is used."""
    row, leg = np.unravel_index(int(used.argmax()), used.shape)
    return int(leg) + 1, LEG_LIMITS[row]


def _place(scene: Scene, name: str, pose: Poses) -> WorkspacePose:
    legs, at = scene.hexapod, (pose.position, pose.quaternion)
    return WorkspacePose(
        name=name,
        pose=pose,
        travel=scene.leg_travel(pose),
        tilts=None if scene.joint_limit is None else scene.leg_tilts(pose),
        nearest_limit=nearest_limit(scene, pose),
        left=float(scene.limits_left(pose)),
        reachable=bool(scene.reachable(pose.rows)[0]),
        speeds=_speeds(scene, pose),
        singularity=float(np.min(legs.singular_values(*at))),
        lever_arm=float(scene.lever_arms(pose).min()),
        forces=_forces(scene, pose, np.array(scene.body.weight(pose.quaternion))),
        actual_forces=_forces(scene, pose, scene.true_weight(pose)),
    )


def _forces(scene: Scene, pose: Poses, wrench: Array) -> Array:
    """Return the leg forces (6,) [N] that give a wrench at one pose; infinite at a singular one."""
    try:
        return scene.hexapod.leg_forces(pose.position, pose.quaternion, wrench)
    except ValueError:
        return np.full(6, np.inf)


def _speeds(scene: Scene, pose: Poses) -> Array | None:
    """Return how fast the platform goes along and about each axis, (6,) [m/s; rad/s], at the legs' speed limit."""
    limit = scene.scenario.robot.speed_limit
    if limit is None or not np.isfinite(scene.limits_left(pose)):
        return None
    return np.array([limit / np.abs(scene.leg_rates(pose, unit)).max() for unit in np.eye(6)])


def _neighbourhood(scene: Scene, centre: Poses, random: np.random.Generator) -> Poses:
    """Draw poses around one and keep those within reach.

    They are shifted by up to half a stroke and turned by as much at the platform joints; no more than a quarter of r_p.
    """
    size = min(0.5 * scene.stroke_length, 0.25 * scene.platform_radius)
    ways = np.empty((RANDOM, 6))
    for way in ways:
        way[:] = random.normal(size=6)
        way[:3] *= size * random.uniform() / np.linalg.norm(way[:3])
        way[3:] *= size * random.uniform() / np.linalg.norm(way[3:]) / scene.platform_radius
    poses = centre.moved(ways)
    return poses[scene.reachable(poses)]


def _way(scene: Scene, goal: Poses | None) -> tuple[Array, Mask, float]:
    """Return which share of the limits is left on the way to the goal, whether the legs reach it, and `way_force`."""
    if goal is None:
        return np.empty(0), np.empty(0, dtype=bool), 0.0
    displacement = goal.displacement_from(scene.start)
    way = scene.start.moved(np.linspace(0.0, 1.0, WAY)[:, None] * displacement)
    within = scene.reachable(way)
    held = (way[row] for row in np.flatnonzero(within))
    forces = [float(np.abs(_forces(scene, at, scene.true_weight(at))).max()) for at in held]
    # A pose at the border of reach that is singular has no force: it is left out, and `within` ends there.
    return scene.limits_left(way), within, max((force for force in forces if np.isfinite(force)), default=0.0)


def _left_map(scene: Scene, centre: Poses) -> tuple[Array, Array, Array]:
    """Return x and y from home [m] and the share of the limits left, over the reach of the stroke and the goal."""
    home = scene.home.position
    half = max(2.0 * scene.stroke_length, 1.2 * float(np.abs((centre.position - home)[:2]).max()))
    ticks = np.linspace(-half, half, _GRID)
    x, y = np.meshgrid(home[0] + ticks, home[1] + ticks)
    places = np.stack([x, y, np.full(x.shape, centre.position[2])], axis=-1)
    return ticks, ticks, scene.limits_left(Poses(places, np.broadcast_to(centre.quaternion, (*x.shape, 4))))
