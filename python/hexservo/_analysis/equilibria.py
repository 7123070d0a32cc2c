"""Where a transpose law comes to rest: the goal, and false equilibria beside it (docs/analysis/equilibria.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo._analysis._rest import SHOWN, WIDER, Array, Mask, Poses, Rest, direction_words
from hexservo._evidence import Cell, Column, Curves, Item, Line, Section, Table
from hexservo._scenario import Scenario

__all__ = ["Equilibria", "Equilibrium", "analyse"]

_PAGE = "docs/analysis/equilibria.md"
_SEED = 20  # of the starts; the same in every analysis
_WITHIN, _WIDER = 64, 64  # starts inside the stroke, and in the wider region
_SETTLED = 2.0  # [px], beyond which a run does not count as settled (docs/model.md, section 8)
_SAME = 1e-4  # [mean depth; rad], equilibria closer than this are one
_ZERO = 1e-11  # of the largest eigenvalue, below which the sign of another one is rounding
_FARTHEST = 3.0  # [mean depth], from home: a zero beyond is the one at infinity
_GRAVITY_STEPS = 24  # in which the gravity error is switched on

_NOT_FOR = {
    "composite": "it regulates a pose error with a prior, which has no equilibrium beside e = 0 in its linear form "
    "(see drift)",
    "computed_torque": "it regulates a pose error with a prior (see drift)",
    "resolved_rate": "it follows the pseudo-inverse of the image Jacobian, not its transpose",
    "pbvs": "it regulates an estimated pose, not the image",
}


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
    stability: str  # attracting | saddle | repelling | undecided (an eigenvalue is zero to rounding)
    growth: float | None  # [1/s], largest real part of the loop linearised with its viscous damping; None without any
    leg_travel: Array  # (6,) [m], against home
    reachable: bool  # within the stroke, and on home's side of the singular poses
    starts: int  # how many of the searches ended here


@dataclass(frozen=True, eq=False)
class Equilibria:
    """Equilibria that a search found, or why there was none."""

    law: str
    open_because: str  # empty where the analysis applies
    found: tuple[Equilibrium, ...] = ()  # the goal first, then by distance from home
    starts_within: int = 0
    starts_wider: int = 0
    stroke: float = 0.0  # [m]
    depth: float = 0.0  # [m], mean, from home
    gravity_force: float = 0.0  # [N], what the gravity error leaves along z
    gravity_stiffness: float | None = None  # [N/m], of the image part along z at the goal without that error
    barrier: tuple[Array, Array] | None = None  # the way from a false one to the goal [1], image error on it [px]

    @property
    def goals(self) -> tuple[Equilibrium, ...]:
        """Where the image is the goal image, or is displaced from it by the gravity error alone."""
        return tuple(e for e in self.found if e.kind != "false")

    @property
    def traps(self) -> tuple[Equilibrium, ...]:
        """False equilibria that attract and that the legs reach."""
        return tuple(e for e in self.found if e.kind == "false" and e.stability == "attracting" and e.reachable)

    def section(self) -> Section:
        """Words, the table of equilibria, and the hill between a false one and the goal."""
        title = "Equilibria of the transpose law"
        if self.open_because:
            return Section(
                "equilibria", title, [self.open_because], data={"applies": False, "reason": self.open_because}
            )
        return Section("equilibria", title, self._sentences(), self._items(), self._verdict(), self._data())

    def _verdict(self) -> Any:
        if self.traps or not self.goals or self.goals[0].stability != "attracting":
            return "bad"
        away = any(e.kind == "false" and e.stability == "attracting" for e in self.found)
        if self.goals[0].residual > _SETTLED:
            return "bad"
        return "warning" if away or not self.goals[0].reachable else "good"

    def _sentences(self) -> list[str]:
        words = []
        goal = self.goals[0] if self.goals else None
        searched = (
            f"{self.starts_within} starts within the stroke of {1e3 * self.stroke:.3g} mm and {self.starts_wider} in "
            f"a wider region ({1e3 * WIDER[0] * self.depth:.3g} mm either way, half a turn about z, {WIDER[3]:g} rad "
            "about x and y)"
        )
        if self.traps:
            trap = max(self.traps, key=lambda e: e.starts)
            text = (
                f"A false equilibrium attracts within the stroke: at {_pose_words(trap)} from home the image part of "
                f"{self.law} is zero with {trap.residual:.3g} px of error"
            )
            if goal is not None:
                away = 1e3 * np.linalg.norm(trap.position - goal.position)
                text += f", {away:.3g} mm from the goal"
            words.append(text + ".")
        elif goal is None:
            words.append(
                self._gravity_words(goal)
                if self.gravity_force
                else f"No equilibrium that shows the goal was found from {searched}."
            )
        elif goal.kind == "displaced goal":
            words.append(self._gravity_words(goal))
        elif goal.stability == "undecided":
            words.append(
                f"Whether the goal attracts is not decided: along {direction_words(goal.weakest, self.depth)} its "
                f"eigenvalue, {goal.eigenvalues[0].real:.3g} 1/s^2, is zero to rounding beside the largest, "
                f"{goal.eigenvalues[-1].real:.3g}."
            )
        elif goal.stability != "attracting":
            words.append(
                f"The goal itself does not attract: it is {_article(goal.stability)}, and the image part drives the "
                f"platform away along {direction_words(goal.weakest, self.depth)}, where its eigenvalue is "
                f"{goal.eigenvalues[0].real:.3g} 1/s^2 (the largest is {goal.eigenvalues[-1].real:.3g})."
            )
        else:
            words.append(f"No false equilibrium that attracts within the stroke was found beside the goal, {searched}.")
        if goal is not None and goal.stability == "attracting":
            words.append(self._softness(goal))
        if self.gravity_force and self.traps:
            words.append(self._gravity_words(goal))
        others = [e for e in self.found if e.kind == "false" and e not in self.traps]
        if others:
            attracting = sum(e.stability == "attracting" for e in others)
            words.append(
                f"{len(others)} other false equilibri{'um was' if len(others) == 1 else 'a were'} found: {attracting} "
                f"that attract, outside the stroke or beyond a singular pose, and {len(others) - attracting} that do "
                "not attract."
            )
        if self.law == "hybrid":
            words.append(
                "K_v holds the platform wherever the image part is below it, about each of these poses (see stiction); "
                "the fuzzy systems are left out."
            )
        words.append("This is a search by multistart, not a proof: an equilibrium may have been missed.")
        return words

    def _softness(self, goal: Equilibrium) -> str:
        text = (
            f"At the goal the softest direction is {direction_words(goal.weakest, self.depth)}: its eigenvalue is "
            f"{goal.eigenvalues[0].real:.3g} 1/s^2 where the stiffest has {goal.eigenvalues[-1].real:.3g}"
        )
        if goal.growth is not None and goal.growth < 0:
            text += f"; with the damping of {self.law} it needs {-1 / goal.growth:.3g} s to fall to 37 %"
        elif goal.growth is not None:
            text += f"; with the damping of {self.law} the loop is unstable there ({goal.growth:.3g} 1/s)"
        return text + "."

    def _gravity_words(self, goal: Equilibrium | None) -> str:
        text = f"The gravity error leaves {self.gravity_force:+.3g} N along z (down is positive)"
        if self.gravity_stiffness is not None:
            text += f" against a stiffness of {self.gravity_stiffness:.3g} N/m"
        if goal is not None and goal.kind == "displaced goal":
            return f"{text}: the goal moves to {_pose_words(goal)} from home and keeps {goal.residual:.3g} px of error."
        return f"{text}: the goal's equilibrium is lost on the way to this error, or leaves the region searched."

    def _items(self) -> list[Item]:
        rows: list[list[Cell]] = [
            [
                e.kind,
                e.stability,
                e.residual,
                _numbers(1e3 * e.displacement[:3]),
                _numbers(1e3 * e.displacement[3:]),
                1e3 * float(np.abs(e.leg_travel).max()),
                "yes" if e.reachable else "no",
                float(e.eigenvalues[0].real),
                e.growth,
                e.starts,
            ]
            for e in self.found
        ]
        columns = [
            Column("equilibrium"),
            Column("stability"),
            Column("image error", "px", ".3g"),
            Column("position from home", "mm"),
            Column("rotation vector from home", "mrad"),
            Column("largest leg travel", "mm", ".3g"),
            Column("reachable"),
            Column("smallest eigenvalue", "1/s^2", ".3g"),
            Column("slowest mode", "1/s", ".3g"),
            Column("searches that ended here", "", "d"),
        ]
        note = (
            "Eigenvalues of the stiffness over the inertia: attracting where all real parts are positive. The slowest "
            "mode is that of the loop with the law's viscous damping; negative decays."
        )
        items: list[Item] = [Table("Equilibria found", columns, rows, note, _PAGE)]
        if self.barrier is not None:
            items.append(
                Curves(
                    "Image error on the way from the false equilibrium to the goal",
                    "part of the way [1]",
                    "root of the weighted mean square error [px]",
                    [Line("straight way in pose", *self.barrier)],
                    note="The platform would have to climb this hill; the law only goes down.",
                    page=_PAGE,
                )
            )
        return items

    def _data(self) -> dict[str, Any]:
        return {
            "applies": True,
            "law": self.law,
            "starts_within": self.starts_within,
            "starts_wider": self.starts_wider,
            "seed": _SEED,
            "stroke": self.stroke,
            "depth": self.depth,
            "false_attracting_reachable": len(self.traps),
            "gravity_force": self.gravity_force,
            "gravity_stiffness": self.gravity_stiffness,
            "equilibria": [
                {
                    "kind": e.kind,
                    "stability": e.stability,
                    "residual": e.residual,
                    "position": e.position,
                    "quaternion": e.quaternion,
                    "displacement": e.displacement,
                    "eigenvalues_real": e.eigenvalues.real,
                    "eigenvalues_imaginary": e.eigenvalues.imag,
                    "weakest_direction": e.weakest,
                    "growth": e.growth,
                    "leg_travel": e.leg_travel,
                    "reachable": e.reachable,
                    "starts": e.starts,
                }
                for e in self.found
            ],
        }


def analyse(scenario: Scenario) -> Equilibria:
    """Search for the poses at which the image part of a transpose law is zero (docs/analysis/equilibria.md).

    The laws are `kelly`, and `hybrid` without its fuzzy systems and without K_v. What is zero is the acceleration of
    the actual plant at rest: the image part J-hat^T K_p xi-tilde and what the gravity error leaves.

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    law = scenario.controller.law
    if law in _NOT_FOR:
        return Equilibria(law, f"The law {law} is not analysed here: {_NOT_FOR[law]}.")
    if scenario.camera.convention == "as_printed":
        return Equilibria(
            law, "A camera as_printed has no points in space, so no pose belongs to an image: not analysed."
        )
    bare = scenario.updated(_BARE[law])
    rest, level = Rest(bare), Rest(bare, gravity=0.0)
    within, wider = _starts_within(level), level.spread(_WIDER, seed=_SEED)
    starts = Poses.joined(level.home, within, wider)
    poses, converged, origin = _search(level, starts, np.array(level.gains.kp))
    groups = _groups(level, poses, converged)
    poses = poses[np.array([group[0] for group in groups], dtype=int)]
    kinds = ["goal" if shown else "false" for shown in level.residual(poses) < SHOWN]
    counts = [len(set(origin[group].tolist())) for group in groups]
    goal_stiffness, gravity = None, _gravity_force(rest)
    if gravity.any():
        if "goal" in kinds:
            goal_stiffness = _stiffness_along_z(level, poses[[kinds.index("goal")]])
        poses, kinds, counts = _with_gravity(bare, rest, starts, poses, kinds, counts)
    found = [_described(rest, poses[[i]], kind, counts[i]) for i, kind in enumerate(kinds)]
    found.sort(key=lambda e: (e.kind == "false", float(np.linalg.norm(e.displacement / rest.unit))))
    result = Equilibria(
        law,
        "",
        tuple(found),
        len(within),
        len(wider),
        float(rest.settings.robot.stroke),
        rest.depth,
        float(gravity[2]),
        goal_stiffness,
    )
    return Equilibria(**{**vars(result), "barrier": _barrier(level, result)})


_BARE: dict[str, dict[str, Any]] = {
    "hybrid": {"controller.hybrid.fuzzy.enabled": False, "controller.hybrid.kv": 0.0},
    "kelly": {},
}


def _starts_within(rest: Rest) -> Poses:
    """Draw poses whose leg lengths are spread evenly over the stroke, in the linearised kinematics of home."""
    leg_map = np.asarray(rest.hexapod.wrench_map(rest.home.position[0], rest.home.quaternion[0])).T  # twist to rates
    lengths = np.random.default_rng(_SEED).uniform(-1.0, 1.0, (8 * _WITHIN, 6)) * rest.settings.robot.stroke
    moves: Array = np.linalg.solve(leg_map, lengths.T).T.astype(np.float64)
    # not farther than the wider region, where the stroke of a large robot goes beyond it
    moves /= np.maximum((np.abs(moves) / (WIDER * rest.unit)).max(axis=1, keepdims=True), 1.0)
    poses = rest.home.repeated(len(moves)).moved(moves)
    usable = rest.reachable(poses) & np.isfinite(rest.image(poses)[0]).all(axis=1)
    return poses[np.flatnonzero(usable)[:_WITHIN]]


def _search(rest: Rest, starts: Poses, weights: Array) -> tuple[Poses, Mask, NDArray[np.int_]]:
    """Go down the image error and then to the zero by Newton, and by Newton alone, which also finds saddles.

    Gives the poses, whether each converged, and the start that each came from.
    """
    low, low_found = rest.settled(rest.nearest_images(starts, weights), rounds=8)
    raw, raw_found = rest.settled(starts, rounds=16)
    number = np.arange(len(starts))
    return Poses.joined(low, raw), np.concatenate([low_found, raw_found]), np.concatenate([number, number])


def _gravity_force(rest: Rest) -> Array:
    """Give what the actual platform feels, (6,) [N; N m], under the wrench that the estimate calls weight."""
    upright, still = rest.home.quaternion, np.zeros((1, 6))
    _, _, weight = rest.probe.estimated_wrenches(upright, still, still)
    return np.asarray(rest.settings.uncertainty.dynamics.gravity * weight)


def _stiffness_along_z(rest: Rest, pose: Poses) -> float:
    """Give the force per shift along z, the other five directions held [N/m]."""
    acceleration = np.zeros((1, 6))
    acceleration[0, 2] = rest.stiffness(pose)[0, 2, 2]
    still = np.zeros((1, 6))
    force, _, _ = rest.probe.estimated_wrenches(pose.quaternion, still, acceleration)
    return float(force[0, 2] * (1.0 - rest.settings.uncertainty.dynamics.inertia[2, 2]))


def _with_gravity(
    scenario: Scenario, rest: Rest, starts: Poses, level: Poses, kinds: list[str], counts: list[int]
) -> tuple[Poses, list[str], list[int]]:
    """Follow equilibria while the gravity error is switched on in steps, and search again with all of it.

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
    """Put searches that ended at one pose together, by their rows; those that ended nowhere are left out."""
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
    values, weakest = values[order], vectors[:, order[0]].real * rest.unit
    return Equilibrium(
        kind,
        pose.position[0],
        pose.quaternion[0],
        pose.displacement_from(rest.home)[0],
        float(rest.residual(pose)[0]),
        values,
        weakest / np.linalg.norm(weakest / rest.unit),
        _stability(values.real),
        _growth(rest, pose, slope),
        rest.leg_travel(pose)[0],
        bool(rest.reachable(pose)[0]),
        starts,
    )


def _stability(real: Array) -> str:
    if np.abs(real).min() <= _ZERO * np.abs(real).max():
        return "undecided"
    return "attracting" if (real > 0).all() else "repelling" if (real < 0).all() else "saddle"


def _growth(rest: Rest, pose: Poses, slope: Array) -> float | None:
    """Give the largest real part of the modes with viscous damping [1/s]; None for a law that has none."""
    step = 1e-3 * np.vstack([np.eye(6), -np.eye(6)]) * rest.unit  # m/s, rad/s: damping is linear, (15) has none
    around = rest.acceleration(pose.repeated(12), step) / rest.unit
    damping = -(around[:6] - around[6:]).T / 2e-3
    if not np.abs(damping).max() > 1e-9 * np.abs(slope).max() ** 0.5:
        return None
    modes = np.linalg.eigvals(np.block([[np.zeros((6, 6)), np.eye(6)], [-slope, -damping]]))
    return float(modes.real.max())


def _barrier(rest: Rest, result: Equilibria) -> tuple[Array, Array] | None:
    """Give the image error along the straight way in pose from a false equilibrium that attracts to the goal."""
    if not result.traps or not result.goals:
        return None
    trap, goal = (Poses(e.position[None], e.quaternion[None]) for e in (result.traps[0], result.goals[0]))
    part = np.linspace(0.0, 1.0, 101)
    way = trap.repeated(len(part)).moved(part[:, None] * goal.displacement_from(trap))
    weights = np.array(rest.gains.kp)
    error = rest.desired - rest.image(way)[0]
    return part, np.sqrt((weights * error**2).sum(axis=1) / weights.sum())


def _pose_words(e: Equilibrium) -> str:
    return f"{_numbers(1e3 * e.displacement[:3])} mm and a turn of {_numbers(1e3 * e.displacement[3:])} mrad"


def _numbers(values: Array) -> str:
    return "(" + ", ".join(f"{0.0 if abs(value) < 0.005 else value:.4g}" for value in values) + ")"


def _article(word: str) -> str:
    return {"saddle": "a saddle", "repelling": "repelling"}.get(word, word)
