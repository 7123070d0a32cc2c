"""Questions of ``hexservo new`` about cranks and rods."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import hexservo as hs
from hexservo.cli.dialogue import Dialogue, one_number
from hexservo.cli.units import LEAST_LENGTH, rounded
from hexservo.scenario.wording import above, below, number


def ask_cranks(dialogue: Dialogue, robot: dict[str, Any]) -> dict[str, Any]:
    """Return the cranks, with those branches for which they stand nearest to their direction at angle 0 at home."""
    from scipy.spatial.transform import Rotation

    platform, base = (joints_of(robot, side) for side in ("platform", "base"))
    length = 1e-3 * dialogue.number("Length of a crank, from its axis to the rod [mm]", 50.0, LEAST_LENGTH)
    dialogue.say("The base joints are the centres of the cranks.")
    form = dialogue.choice("Axes of the cranks: away from the base's middle, or given one by one", ("radial", "given"))
    if form == "radial":
        axes = base * [1.0, 1.0, 0.0]
        if not np.linalg.norm(axes, axis=1).all():
            raise hs.ScenarioError(["axes of the cranks: expected joints beside the base's z axis for radial ones"])
        # at angle 0 level, away from the other joint of the pair
        zero = np.cross([0.0, 0.0, 1.0], axes) * np.tile([-1.0, 1.0], 3)[:, None]
        dialogue.say("At angle 0 a crank is level and points away from the other one of its pair.")
    else:
        ways = [
            [
                dialogue.numbers(f"{what} of crank {leg}: x y z", default, 3, _direction)
                for what, default in (("Axis", "1 0 0"), ("Direction at angle 0", "0 1 0"))
            ]
            for leg in range(1, 7)
        ]
        axes, zero = np.array(ways).swapaxes(0, 1)
    axes = axes / np.linalg.norm(axes, axis=1)[:, None]
    zero = zero - (zero * axes).sum(axis=1)[:, None] * axes
    if (np.linalg.norm(zero, axis=1) < 1e-3).any():
        raise hs.ScenarioError(["direction at angle 0: expected one at a right angle to the axis, got one along it"])
    zero = zero / np.linalg.norm(zero, axis=1)[:, None]
    turned = Rotation.from_rotvec(robot.get("home_attitude", [0.0] * 3)).apply(platform)
    u = np.asarray(robot["home_position"]) + turned - base
    closed = float(np.linalg.norm(u - length * zero, axis=1).mean())
    across, along = (u * zero).sum(axis=1), (u * np.cross(axes, zero)).sum(axis=1)
    square, radius = (u * u).sum(axis=1) + length**2, 2.0 * length * np.hypot(across, along)
    rod = _rod(dialogue, closed, float((square - radius).max()), float((square + radius).min()))
    share = (square - rod**2) / radius
    both = np.arctan2(along, across) + np.outer([1.0, -1.0], np.arccos(np.clip(share, -1.0, 1.0)))  # but for rounding
    angles = np.remainder(both + np.pi, 2.0 * np.pi) - np.pi
    branch = np.where(np.abs(angles[0]) <= np.abs(angles[1]), 1, -1)
    at_home = np.rad2deg(np.where(branch > 0, angles[0], angles[1]))
    dialogue.say(f"At home the cranks are at {', '.join(f'{angle:.4g}' for angle in at_home)} deg.")
    return {
        "length": length,
        "rod": rod,
        "axes": [[rounded(value) for value in row] for row in axes.tolist()],
        "zero": [[rounded(value) for value in row] for row in zero.tolist()],
        "branch": branch.tolist(),
    }


def _rod(dialogue: Dialogue, default: float, least: float, most: float) -> float:
    """Return the length of a rod [m], with which all cranks close at home.

    `least` and `most` are the squares of the lengths between which they do [m^2]. The `default` is for lengths that do.
    """
    shortest, longest = (1e3 * math.sqrt(max(square, 0.0)) for square in (least, most))  # [mm]
    if not shortest < longest:
        raise hs.ScenarioError(
            [
                "joints, home and cranks: expected ones that rods of one length close at home, got legs that need rods "
                f"of at least {number(shortest, 4)} mm and of at most {number(longest, 4)} mm"
            ]
        )
    shortest = max(shortest, LEAST_LENGTH)

    def closes(rod: float) -> str | None:
        if shortest < rod < longest:
            return None
        within = f"{above(shortest, 4)} to {below(longest, 4)} mm"
        return f"expected a length from {within}, with which cranks and rods close at home"

    offered = float(f"{1e3 * default:.4g}")
    if closes(offered):
        offered = float(f"{(shortest + longest) / 2.0:.4g}")
    return 1e-3 * float(dialogue.ask("Length of a rod [mm]", f"{offered:g}", one_number, closes))


def joints_of(robot: dict[str, Any], side: str) -> np.ndarray:
    """Return the joints (6, 3) of one side [m], in its frame."""
    if f"{side}_joints" in robot:
        return np.asarray(robot[f"{side}_joints"], dtype=float)
    angles = np.asarray(robot[f"{side}_angles"])
    return np.asarray(robot[f"{side}_radius"] * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)]))


def _direction(values: list[float]) -> str | None:
    return None if any(values) else "expected a direction, not three zeros"
