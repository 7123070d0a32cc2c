"""Findings of the search for equilibria as sentences, tables and curves (docs/analysis/equilibria.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.analysis.scene import WIDER
from hexservo.findings.analysis.words import direction_words, displacement_words, number, open_section, vector_words
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Cell, Column, Curves, Item, Line, Section, Table
from hexservo.scenario.arrays import Array

__all__ = ["SEED", "Equilibria", "Equilibrium"]

PAGE = "docs/analysis/equilibria.md"
SEED = 20  # of the starts; the same in every analysis


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
    leg_travel: Array  # (6,) [m], against home
    reachable: bool  # within the stroke, and on home's side of the singular poses
    starts: int  # how many of the searches ended here


@dataclass(frozen=True, eq=False, repr=False)
class Equilibria(Findings):
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
    band: float = 0.0  # [px], of settling
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
            return open_section("equilibria", title, self.open_because)
        return Section("equilibria", title, self._sentences(), self._items(), self._verdict(), self._data())

    def _verdict(self) -> Any:
        if self.traps or not self.goals or self.goals[0].stability != "attracting":
            return "bad"
        away = any(e.kind == "false" and e.stability == "attracting" for e in self.found)
        if self.goals[0].residual > self.band:
            return "bad"
        return "warning" if away or not self.goals[0].reachable else "good"

    def _sentences(self) -> list[str]:
        words = []
        goal = self.goals[0] if self.goals else None
        searched = (
            f"{self.starts_within} starts within the stroke of {1e3 * self.stroke:.3g} mm and {self.starts_wider} in "
            f"a wider region ({1e3 * WIDER[0] * self.depth:.3g} mm either way, 180 deg about z, {WIDER[3]:g} rad "
            "about x and y)"
        )
        if goal is not None and goal.stability == "oscillating":
            words.append(
                "The goal does not attract: the stiffness is restoring in every direction, but not symmetric, and the "
                f"damping of {self.law} is too small for the oscillation that it feeds, which grows by "
                f"{goal.growth:.3g} 1/s."
            )
        if self.traps:
            trap = max(self.traps, key=lambda e: e.starts)
            text = (
                f"A false equilibrium attracts within the stroke: at {displacement_words(trap.displacement)} from "
                f"home the image part of {self.law} is zero with {trap.residual:.3g} px of error"
            )
            if goal is not None:
                away = 1e3 * np.linalg.norm(trap.position - goal.position)
                text += f", {away:.3g} mm from the goal"
            words.append(text + ".")
        elif goal is None:
            words.append(
                self._gravity_words(goal)
                if self.gravity_force
                else f"No equilibrium with the goal image was found from {searched}."
            )
        elif goal.kind == "displaced goal":
            words.append(self._gravity_words(goal))
        elif goal.stability == "undecided":
            words.append(
                f"Whether the goal attracts is not decided: along {direction_words(goal.weakest, self.depth)} its "
                f"eigenvalue, {number(goal.eigenvalues[0].real)} 1/s^2, is zero to rounding beside the largest, "
                f"{number(goal.eigenvalues[-1].real)}."
            )
        elif goal.stability not in ("attracting", "oscillating"):
            words.append(
                f"The goal itself does not attract: it is {_article(goal.stability)}, and the image part drives the "
                f"platform away along {direction_words(goal.weakest, self.depth)}, where its eigenvalue is "
                f"{number(goal.eigenvalues[0].real)} 1/s^2 (the largest is {number(goal.eigenvalues[-1].real)})."
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
                f"{'Beside these the' if self.found[0] not in others else 'The'} search found {attracting} false "
                f"equilibria that attract outside the stroke or beyond a singular pose, and {len(others) - attracting} "
                "that do not attract."
            )
        if self.law == "hybrid":
            words.append(
                "K_v holds the platform wherever the image part is below it, about each of these poses (see stiction); "
                "the fuzzy systems are neglected."
            )
        words.append("This is a search by multistart, not a proof: an equilibrium may have been missed.")
        return words

    def _softness(self, goal: Equilibrium) -> str:
        text = (
            f"At the goal the softest direction is {direction_words(goal.weakest, self.depth)}: its eigenvalue is "
            f"{number(goal.eigenvalues[0].real)} 1/s^2 where the stiffest has {number(goal.eigenvalues[-1].real)}"
        )
        if goal.growth is not None and goal.growth < 0:
            text += f"; with the damping of {self.law} it needs {number(-1 / goal.growth)} s to fall to 37 %"
        return text + "."

    def _gravity_words(self, goal: Equilibrium | None) -> str:
        text = f"The gravity error leaves {self.gravity_force:+.3g} N along z (down is positive)"
        if self.gravity_stiffness is not None:
            text += f" against a stiffness of {number(self.gravity_stiffness)} N/m"
        if goal is not None and goal.kind == "displaced goal":
            place = displacement_words(goal.displacement)
            return f"{text}: the goal moves to {place} from home and keeps {goal.residual:.3g} px of error."
        return f"{text}: the goal's equilibrium vanishes before this error is reached, or leaves the region searched."

    def _items(self) -> list[Item]:
        rows: list[list[Cell]] = [
            [
                e.kind,
                e.stability,
                e.residual,
                vector_words(1e3 * e.displacement[:3]),
                vector_words(1e3 * e.displacement[3:]),
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
            "Eigenvalues of the stiffness over the inertia: attracting where all real parts are positive and, with "
            "viscous damping, all modes decay. The slowest mode is that of the loop with this damping; negative decays."
        )
        items: list[Item] = [Table("Equilibria found", columns, rows, note, PAGE)]
        if self.barrier is not None:
            items.append(
                Curves(
                    "Image error on the way from the false equilibrium to the goal",
                    "part of the way [1]",
                    "root of the weighted mean square error [px]",
                    [Line("straight path in pose", *self.barrier)],
                    note="The law only decreases this error, so the platform cannot pass the maximum.",
                    page=PAGE,
                )
            )
        return items

    def _data(self) -> dict[str, Any]:
        return {
            "applies": True,
            "law": self.law,
            "starts_within": self.starts_within,
            "starts_wider": self.starts_wider,
            "seed": SEED,
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


def _article(word: str) -> str:
    return {"saddle": "a saddle", "repelling": "repelling"}.get(word, word)
