"""The equilibria of a transpose law as sentences, tables and curves (docs/analysis/equilibria.md)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo.findings.analysis.equilibria import SEED, Equilibria, Equilibrium
from hexservo.findings.analysis.goal import SHOWN
from hexservo.findings.analysis.scene import WIDER
from hexservo.findings.analysis.words import (
    along,
    direction_words,
    displacement_parts,
    displacement_words,
    number,
    open_section,
)
from hexservo.findings.evidence import Column, Curves, Item, Line, Section, Table, Verdict, picked
from hexservo.scenario.laws import laws_with

PAGE = "docs/analysis/equilibria.md"


def section(result: Equilibria) -> Section:
    """Return sentences, the table of equilibria, and the image error between a false one and the goal."""
    title = "Equilibria of the transpose law"
    if result.open_because:
        return open_section("equilibria", title, result.open_because)
    return Section("equilibria", title, _sentences(result), _items(result), _verdict(result), _data(result))


def _verdict(result: Equilibria) -> Verdict:
    if result.traps or not result.goals:
        return "bad"
    if result.goals[0].stability == "undecided":
        return "open"
    if result.goals[0].stability != "attracting":
        return "bad"
    away = any(e.kind == "false" and e.stability == "attracting" for e in result.found)
    if result.goals[0].residual > result.band:
        return "bad"
    return "warning" if away or not result.goals[0].reachable else "good"


def _sentences(result: Equilibria) -> list[str]:
    words = []
    goal = result.goals[0] if result.goals else None
    searched = (
        f"{result.starts_within} starts within the stroke of {1e3 * result.stroke:.3g} {result.leg_unit} and "
        f"{result.starts_wider} in a wider region ({1e3 * WIDER[0] * result.depth:.3g} mm either way, 180 deg about z, "
        f"{WIDER[3]:g} rad about x and y)"
    )
    if goal is not None and goal.stability == "oscillating":
        words.append(
            "The goal does not attract: the stiffness is restoring in every direction, but not symmetric, and the "
            f"damping of {result.law} is too small for the oscillation that it feeds, which grows by "
            f"{goal.growth:.3g} 1/s."
        )
    if goal is not None and goal.kind == "displaced goal" and not result.traps:
        words.append(_gravity_words(result, goal))
    if result.traps:
        trap = max(result.traps, key=lambda e: e.starts)
        text = (
            "A false equilibrium attracts within the stroke: at "
            f"{displacement_words(trap.displacement, result.depth)} from home the image part of {result.law} is zero "
            f"with {trap.residual:.3g} px of error"
        )
        if goal is not None:
            away = 1e3 * np.linalg.norm(trap.position - goal.position)
            text += f", {away:.3g} mm from the goal"
        words.append(text + ".")
    elif goal is None:
        words.append(
            _gravity_words(result, goal)
            if result.gravity_direction is not None
            else f"No equilibrium with the goal image was found from {searched}."
        )
    elif goal.stability == "undecided":
        words.append(
            f"Whether the goal attracts is not decided: along {_weakest_words(result, goal)} its "
            f"eigenvalue, {number(goal.eigenvalues[0].real)} 1/s^2, is zero to rounding beside the largest, "
            f"{number(goal.eigenvalues[-1].real)}."
        )
    elif goal.stability not in ("attracting", "oscillating"):
        words.append(
            f"The goal itself does not attract: it is {'a saddle' if goal.stability == 'saddle' else goal.stability}, "
            "and the image part drives the platform away along "
            f"{_weakest_words(result, goal)}, where its eigenvalue is "
            f"{number(goal.eigenvalues[0].real)} 1/s^2 (the largest is {number(goal.eigenvalues[-1].real)})."
        )
    elif goal.kind != "displaced goal":
        words.append(f"No false equilibrium that attracts within the stroke was found beside the goal, {searched}.")
    if goal is not None and goal.stability == "attracting":
        words.append(_softness(result, goal))
    if goal is not None and goal.kind == "goal" and goal.residual >= SHOWN:
        words.append(f"No pose has exactly the goal image: at the goal an error of {number(goal.residual)} px is left.")
    if result.gravity_direction is not None and result.traps:
        words.append(_gravity_words(result, goal))
    others = [e for e in result.found if e.kind == "false" and e not in result.traps]
    if others:
        attracting = sum(e.stability == "attracting" for e in others)
        words.append(
            f"{'Beside these the' if result.found[0] not in others else 'The'} search found {attracting} false "
            f"equilibria that attract outside the stroke or beyond a singular pose, and {len(others) - attracting} "
            "that do not attract."
        )
    if result.law in laws_with("switching"):
        words.append(
            "K_v holds the platform wherever the image part is below it, about each of these poses (see stiction); "
            "the fuzzy systems are neglected."
        )
    words.append("This is a search by multistart, not a proof: an equilibrium may have been missed.")
    return words


def _weakest_words(result: Equilibria, goal: Equilibrium) -> str:
    return direction_words(goal.weakest, result.depth, result.small_shift)


def _softness(result: Equilibria, goal: Equilibrium) -> str:
    text = (
        f"At the goal the softest direction is {_weakest_words(result, goal)}: its eigenvalue is "
        f"{number(goal.eigenvalues[0].real)} 1/s^2 where the stiffest has {number(goal.eigenvalues[-1].real)}"
    )
    if goal.growth is not None and goal.growth < 0:
        text += f"; with the damping of {result.law} it needs {number(-1 / goal.growth)} s to fall to 37 %"
    return text + "."


def _gravity_words(result: Equilibria, goal: Equilibrium | None) -> str:
    assert result.gravity_direction is not None
    text = (
        f"The gravity error leaves {result.gravity_force:+.3g} N along {along(result.gravity_direction, signed=True)} "
        "(down is positive)"
    )
    if result.gravity_stiffness is not None:
        text += f" against a stiffness of {number(result.gravity_stiffness)} N/m"
    if goal is not None and goal.kind == "displaced goal":
        place = displacement_words(goal.displacement, result.depth)
        return f"{text}: the goal moves to {place} from home and keeps {goal.residual:.3g} px of error."
    return f"{text}: the goal's equilibrium vanishes before this error is reached, or leaves the region searched."


def _items(result: Equilibria) -> list[Item]:
    table = Table.of(
        "Equilibria found",
        result.found,
        [
            (Column("equilibrium"), lambda e: e.kind),
            (Column("stability"), lambda e: e.stability),
            (Column("image error", "px", ".3g"), lambda e: e.residual),
            (Column("position from home", "mm"), lambda e: displacement_parts(e.displacement, result.depth)[0]),
            (
                Column("rotation vector from home", "mrad"),
                lambda e: displacement_parts(e.displacement, result.depth)[1],
            ),
            (Column("largest leg travel", result.leg_unit, ".3g"), lambda e: 1e3 * float(np.abs(e.leg_travel).max())),
            (Column("reachable"), lambda e: e.reachable),
            (Column("smallest eigenvalue", "1/s^2", ".3g"), lambda e: float(e.eigenvalues[0].real)),
            (Column("slowest mode", "1/s", ".3g"), lambda e: e.growth),
            (Column("searches that ended here", "", "d"), lambda e: e.starts),
        ],
        note="Eigenvalues of the stiffness over the inertia: attracting where all real parts are positive and, with "
        "viscous damping, all modes decay. The slowest mode is that of the loop with this damping; negative decays.",
        page=PAGE,
    )
    items: list[Item] = [table]
    if result.barrier is not None:
        items.append(
            Curves(
                "Image error on the way from the false equilibrium to the goal",
                "part of the way [1]",
                "root of the weighted mean square error [px]",
                [Line("straight path in pose", *result.barrier)],
                note="With exact depths and weight the energy of this error and of motion only falls: a platform that "
                "rests below a maximum of this path does not pass it along the path.",
                page=PAGE,
            )
        )
    return items


def _data(result: Equilibria) -> dict[str, Any]:
    return {
        "applies": True,
        **picked(result, "law starts_within starts_wider"),
        "seed": SEED,
        **picked(result, "stroke depth"),
        "false_attracting_reachable": len(result.traps),
        **picked(result, "gravity_force gravity_direction gravity_stiffness"),
        "equilibria": [
            {
                **picked(e, "kind stability residual position quaternion displacement"),
                "eigenvalues_real": e.eigenvalues.real,
                "eigenvalues_imaginary": e.eigenvalues.imag,
                "weakest_direction": e.weakest,
                **picked(e, "growth leg_travel reachable starts"),
            }
            for e in result.found
        ],
    }
