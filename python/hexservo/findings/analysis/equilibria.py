"""Equilibria of a transpose law: the goal and false equilibria (docs/analysis/equilibria.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hexservo import _core
from hexservo.findings.analysis.goal import SHOWN, find_goals, nearest_images
from hexservo.findings.analysis.poses import Poses, without_sign
from hexservo.findings.analysis.rest import Rest, not_analysed
from hexservo.findings.analysis.scene import WIDER, scene_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.scenario import Scenario

SEED = 20  # of the starts; the same in every analysis
_WITHIN, _WIDER = 64, 64  # starts inside the stroke, and in the wider region
_SAME = 1e-4  # [mean depth; rad], equilibria closer than this are one
_ZERO = 1e-11  # of the largest eigenvalue, below which the sign of another one is rounding
_FARTHEST = 3.0  # [mean depth], from home: a zero beyond is the one at infinity
_GRAVITY_STEPS = 24  # in which the gravity error is switched on
_IMAGE_STEPS = 4  # in which the image of the goal pose becomes a goal image that is not quite that


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A pose at which the law leaves the platform at rest."""

    kind: str  # goal | displaced goal (by the gravity error) | false
    position: Array  # (3,) [m], in B
    quaternion: Array  # (4,) w x y z
    displacement: Array  # (6,) from home [m; rad], in B
    residual: float  # [px], largest |xi_d - xi|
    eigenvalues: Array  # (6,) complex [1/s^2], of the stiffness over the actual inertia, by their real parts
    weakest: Array  # (6,) [m; rad], in B, the direction of the first of them
    # attracting | oscillating (stiff, but damped too little) | saddle | repelling | undecided (an eigenvalue is zero to
    # rounding)
    stability: str
    growth: float | None  # [1/s], largest real part of the loop linearised with its viscous damping; None without any
    leg_travel: Array  # (6,) [m], from the middle of the travel
    reachable: bool  # within the stroke, and on home's side of the singular poses
    starts: int  # how many of the searches ended here


@dataclass(frozen=True, eq=False, repr=False)
class Equilibria(Part):
    """Equilibria found by a search, or why it does not apply."""

    law: str
    open_because: str  # empty where the analysis applies
    found: tuple[Equilibrium, ...] = ()  # the goal first, then by distance from home
    starts_within: int = 0
    starts_wider: int = 0
    stroke: float = 0.0  # [m]
    depth: float = 0.0  # [m], mean, from home
    gravity_force: float = 0.0  # [N], what the gravity error leaves along `gravity_direction`; negative: upwards
    gravity_direction: Array | None = None  # (3,) in B, that of the error's force, downwards; None without an error
    gravity_stiffness: float | None = None  # [N/m], of the image part along it at the goal without that error
    band: float = 0.0  # [px], of settling
    barrier: tuple[Array, Array] | None = None  # the way from a false one to the goal [1], image error on it [px]
    leg_unit: str = "mm"  # a thousandth of the unit of leg travel
    small_shift: float = 0.0  # [m], of motions shown as examples

    @property
    def goals(self) -> tuple[Equilibrium, ...]:
        """Equilibria with the goal image, or displaced from it by the gravity error only."""
        return tuple(e for e in self.found if e.kind != "false")

    @property
    def traps(self) -> tuple[Equilibrium, ...]:
        """False equilibria that attract and that the legs reach."""
        return tuple(e for e in self.found if e.kind == "false" and e.stability == "attracting" and e.reachable)


def analyse(scenario: Scenario) -> Equilibria:
    """Search for the poses at which the image part of a transpose law is zero (docs/analysis/equilibria.md).

    Where the legs take positions they are those of the virtual platform, without errors of the dynamics.

    The laws are `kelly`, and `hybrid` without its fuzzy systems and without K_v. What is zero is the acceleration of
    the actual plant at rest: the image part J-hat^T K_p xi-tilde and what the gravity error leaves.

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    law = scenario.controller.law
    if reason := not_analysed(scenario, _not_for(scenario.controller.traits)):
        return Equilibria(law, reason)
    bare = _bare(_as_acting(scenario))
    rest, level = Rest(bare), Rest(bare, gravity=0.0)
    within, wider = _starts_within(level), level.spread(_WIDER, seed=SEED)
    starts = Poses.joined(level.home, within, wider)
    if not np.any(level.gains.kp):
        return Equilibria(law, "K_p is zero: there is no image part, and every pose is an equilibrium of it.")
    poses, converged, origin = _search(level, starts, np.array(level.gains.kp))
    goal, followed = _at_goal_pose(level, scenario)
    groups = _groups(level, Poses.joined(poses, goal), np.concatenate([converged, followed]))
    poses = Poses.joined(poses, goal)[np.array([group[0] for group in groups], dtype=int)]
    shown = level.residual(poses) < SHOWN
    kinds = [
        "goal" if exact or group[-1] >= len(converged) else "false" for exact, group in zip(shown, groups, strict=True)
    ]
    counts = [len({int(origin[i]) for i in group if i < len(origin)}) for group in groups]
    goal_stiffness, gravity = None, rest.gravity_error
    force, down = float(np.linalg.norm(gravity[:3])), None
    if force > 0.0:
        upwards = float(gravity[:3] @ rest.settings["robot.gravity"]) < 0.0
        force = -force if upwards else force
        down = gravity[:3] / force
        if "goal" in kinds:
            goal_stiffness = _stiffness_along(down, level, poses[[kinds.index("goal")]])
        poses, kinds, counts = _with_gravity(bare, rest, starts, poses, kinds, counts)
    found = [_described(rest, poses[[i]], kind, counts[i]) for i, kind in enumerate(kinds)]
    found.sort(key=lambda e: (e.kind == "false", float(np.linalg.norm(e.displacement / rest.unit))))
    result = Equilibria(
        law,
        "",
        tuple(found),
        len(within),
        len(wider),
        rest.stroke,
        rest.depth,
        force,
        down,
        goal_stiffness,
        rest.band,
        leg_unit=rest.units.small,
        small_shift=rest.small_shift,
    )
    return replace(result, barrier=_barrier(level, result))


def _not_for(law: _core.LawTraits) -> str:
    """Return why a law is not analysed; empty for a transpose law, of an image spring and no pose error."""
    if law.output == "pose":
        return "it sends the legs to a pose that it filters, not by the transpose of the image Jacobian"
    if law.inverse and law.prior:
        return "it regulates a pose error with a prior (see drift)"
    if law.inverse:
        return "it follows the pseudo-inverse of the image Jacobian, not its transpose"
    return "it regulates an estimated pose, not the image" if law.pose_error else ""


def _as_acting(scenario: Scenario) -> Scenario:
    """Return the scenario without errors of a platform that only the legs' efforts meet, where these take positions."""
    if not scenario.actuators.takes_positions:
        return scenario
    return scenario.updated({f"uncertainty.{of}": 0.0 for of in ("inertia", "coriolis", "gravity")})


def _bare(scenario: Scenario) -> Scenario:
    """Return the scenario with a law that has neither fuzzy systems nor friction."""
    law = scenario.controller.traits
    changes: dict[str, float] = {}
    if law.memory:
        changes[f"controller.{law.name}.fuzzy.enabled"] = False
    if law.switching:
        changes[f"controller.{law.name}.kv"] = 0.0
    return scenario.updated(changes)


def _starts_within(rest: Rest) -> Poses:
    """Draw poses whose leg lengths are spread evenly over the stroke, in the linearised kinematics of home."""
    leg_map = np.asarray(rest.hexapod.wrench_map(rest.home.position, rest.home.quaternion)).T  # twist to rates
    lengths = np.random.default_rng(SEED).uniform(-1.0, 1.0, (8 * _WITHIN, 6)) * rest.stroke
    moves: Array = np.linalg.solve(leg_map, lengths.T).T.astype(np.float64)
    # not farther than the wider region, where the stroke of a large robot goes beyond it
    moves /= np.maximum((np.abs(moves) / (WIDER * rest.unit)).max(axis=1, keepdims=True), 1.0)
    poses = rest.home.moved(moves)
    usable = rest.reachable(poses) & np.isfinite(rest.image(poses)[0]).all(axis=1)
    return poses[np.flatnonzero(usable)[:_WITHIN]]


def _search(rest: Rest, starts: Poses, weights: Array) -> tuple[Poses, Mask, NDArray[np.int_]]:
    """Search by descent of the image error and then Newton's method, and by Newton's method alone, which finds saddles.

    Gives the poses, whether each converged, and the start that each came from.
    """
    low, low_found = rest.settled(nearest_images(rest, starts, weights), rounds=8)
    raw, raw_found = rest.settled(starts, rounds=16)
    number = np.arange(len(starts))
    return Poses.joined(low, raw), np.concatenate([low_found, raw_found]), np.concatenate([number, number])


def _at_goal_pose(level: Rest, scenario: Scenario) -> tuple[Poses, Mask]:
    """Follow the equilibrium at the goal pose, (1,), from that pose's own image to the goal image.

    Gives the pose it ends at and whether it was found; (0,) of both where no pose has the goal image.
    """
    goals = find_goals(scene_of(scenario))
    if goals is None or not goals.reachable:
        return level.home.rows[:0], np.zeros(0, dtype=bool)
    pose, found = goals.best.view.pose.rows, np.ones(1, dtype=bool)
    steps = 1 if goals.best.largest_residual < SHOWN else _IMAGE_STEPS
    for left in np.linspace(1.0, 0.0, steps + 1)[1:]:
        pose, found = level.aimed_at(level.desired - left * goals.best.residual).settled(pose, rounds=8)
    return pose, found


def _stiffness_along(direction: Array, rest: Rest, pose: Poses) -> float:
    """Return the force per shift along a direction (3,) of B, the other five directions held [N/m]."""
    acceleration = rest.unit * (rest.stiffness(pose)[0, :, :3] @ direction) / rest.depth  # [m/s^2; rad/s^2] per m
    inertia = rest.probe.inertia(pose.quaternion)[0] * (1.0 - rest.settings["uncertainty.inertia"])
    return float(direction @ (inertia @ acceleration)[:3])


def _with_gravity(
    scenario: Scenario, rest: Rest, starts: Poses, level: Poses, kinds: list[str], counts: list[int]
) -> tuple[Poses, list[str], list[int]]:
    """Continue equilibria while the gravity error is increased in steps, and search again with the full error.

    One that is lost on the way is dropped.
    """
    poses, kept = level, np.arange(len(level))
    for part in np.linspace(0.0, 1.0, _GRAVITY_STEPS + 1)[1:]:
        if not len(kept):
            break
        poses, found = Rest(scenario, gravity=float(part)).settled(poses, rounds=6)
        poses, kept = poses[found], kept[found]
    raw, converged = rest.settled(starts, rounds=16)
    every = Poses.joined(poses, raw)
    groups = _groups(rest, every, np.concatenate([np.full(len(kept), True), converged]))
    names, numbers = [], []
    for group in groups:
        followed = [int(kept[i]) for i in group if i < len(kept)]
        names.append("displaced goal" if any(kinds[i] == "goal" for i in followed) else "false")
        numbers.append(max([counts[i] for i in followed], default=0) or len(group))
    return every[np.array([group[0] for group in groups], dtype=int)], names, numbers


def _groups(rest: Rest, poses: Poses, converged: Mask) -> list[list[int]]:
    """Group searches that ended at one pose, by their rows; those that did not converge are left out."""
    away = poses.displacement_from(rest.home) / rest.unit
    usable = converged & (np.abs(away[:, :3]).max(axis=1) < _FARTHEST)
    usable &= np.isfinite(rest.image(poses)[0]).all(axis=1)
    groups: list[list[int]] = []
    left = np.flatnonzero(usable)
    while len(left):
        apart = poses[left].displacement_from(poses[left[:1]]) / rest.unit
        near = np.abs(apart).max(axis=1) < _SAME
        groups.append(left[near].tolist())
        left = left[~near]
    return groups


def _described(rest: Rest, pose: Poses, kind: str, starts: int) -> Equilibrium:
    slope = rest.stiffness(pose)[0]
    values, vectors = np.linalg.eig(slope)
    order = np.argsort(values.real)
    growth = _growth(rest, pose, slope)
    values, weakest = values[order], without_sign(vectors[:, order[0]].real)
    return Equilibrium(
        kind,
        pose.position[0],
        pose.quaternion[0],
        pose.displacement_from(rest.home)[0],
        float(rest.residual(pose)[0]),
        values,
        weakest * rest.unit / np.linalg.norm(weakest),
        _stability(values.real, growth),
        growth,
        rest.leg_travel(pose)[0],
        bool(rest.reachable(pose)[0]),
        starts,
    )


def _stability(real: Array, growth: float | None) -> str:
    """Name an equilibrium by the real parts of the stiffness [1/s^2] and, with damping, the growth of its modes [1/s].

    A stiffness that is not symmetric (unequal depth errors) may have complex eigenvalues: it then feeds an oscillation,
    which too little damping does not take out, although every real part is positive.
    """
    if np.abs(real).min() <= _ZERO * np.abs(real).max():
        return "undecided"
    if (real > 0).all():
        fed = growth is not None and growth > 1e-9 * np.sqrt(real.max())
        return "oscillating" if fed else "attracting"
    return "repelling" if (real < 0).all() else "saddle"


def _growth(rest: Rest, pose: Poses, slope: Array) -> float | None:
    """Return the largest real part of the modes with viscous damping [1/s]; None for a law that has none."""
    step = 1e-3 * np.vstack([np.eye(6), -np.eye(6)]) * rest.unit  # m/s, rad/s: damping is linear, (15) has none
    around = rest.acceleration(pose.repeated(12), step) / rest.unit
    damping = -(around[:6] - around[6:]).T / 2e-3
    scenario = rest.scenario
    if scenario.actuators.takes_positions:
        added = np.diag(np.broadcast_to(scenario.controller.virtual_platform.damping, 6))  # of the virtual platform
        damping += np.linalg.solve(rest.probe.inertia(pose.quaternion)[0], added) * rest.unit / rest.unit[:, None]
    if not np.abs(damping).max() > 1e-9 * np.abs(slope).max() ** 0.5:
        return None
    modes = np.linalg.eigvals(np.block([[np.zeros((6, 6)), np.eye(6)], [-slope, -damping]]))
    return float(modes.real.max())


def _barrier(rest: Rest, result: Equilibria) -> tuple[Array, Array] | None:
    """Return the image error along the straight path in pose from an attracting false equilibrium to the goal."""
    if not result.traps or not result.goals:
        return None
    trap, goal = (Poses(e.position, e.quaternion) for e in (result.traps[0], result.goals[0]))
    part = np.linspace(0.0, 1.0, 101)
    way = trap.moved(part[:, None] * goal.displacement_from(trap))
    weights = np.array(rest.gains.kp)
    error = rest.desired - rest.image(way)[0]
    return part, np.sqrt((weights * error**2).sum(axis=1) / weights.sum())
