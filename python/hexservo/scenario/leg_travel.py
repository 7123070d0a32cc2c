"""The stroke of the legs as [shortest, longest] travel from home, and leg lengths that were given in its place."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import robot_settings
from hexservo.scenario.rules import is_number, refusal, shown_value
from hexservo.scenario.wording import number

if TYPE_CHECKING:
    from hexservo.scenario.blocks import Robot


def travel(stroke: Any, centre: Any, robot: Callable[[], Robot]) -> dict[str, float]:
    """Return stroke and its middle where the stroke is given as the shortest and the longest travel.

    Parameters
    ----------
    stroke, centre
        Of the robot, as they are written [m; rad].
    robot
        Makes the robot with any stroke, for the message: its errors are those of other keys.

    Raises
    ------
    ValidationError
        For travel that does not have home between its ends, and for a middle beside it.
    """
    if not isinstance(stroke, list) or len(stroke) != 2 or not all(map(is_number, stroke)):
        return {}  # refused at its own place, if it is no number
    shortest, longest = map(float, stroke)
    if not shortest <= 0.0 <= longest or shortest == longest:
        expected = "expected [shortest, longest] travel with home between them"
        raise refusal((("stroke",), f"{expected}, got {shown_value(stroke)}{_hint(shortest, longest, robot)}"))
    if centre:
        raise refusal((("stroke_centre",), f"expected null beside [shortest, longest], got {shown_value(centre)}"))
    return {"stroke": (longest - shortest) / 2, "stroke_centre": (longest + shortest) / 2}


def _hint(shortest: float, longest: float, robot: Callable[[], Robot]) -> str:
    """Return the travel that lengths of the legs are, "" where home is not between them."""
    try:
        whole = robot()
        home = np.zeros(6) if whole.legs == "rotary" else home_lengths(whole)
    except ValueError:  # of other keys, which have their own messages
        return ""
    return of_lengths(shortest, longest, home, "m") or of_lengths(1e-3 * shortest, 1e-3 * longest, home, "m")


def home_lengths(robot: Robot) -> Array:
    """Return the leg lengths of a robot at home, (6,) [m]; ValueError where its legs do not hold the platform."""
    return np.asarray(_core.Hexapod(robot_settings(robot).robot).home_lengths)


def of_lengths(shortest: float, longest: float, home: Array, unit: str) -> str:
    """Return what the travel is if these are lengths of the legs, for a message; "" where home is not between them.

    All in `unit`, as the lengths at home, (6,), less whose mean the travel is.
    """
    if not shortest <= float(home.min()) <= float(home.max()) <= longest or shortest == longest:
        return ""
    middle = float(home.mean())
    ends = ", ".join(number(end - middle) for end in (shortest, longest))
    return f"; of leg lengths less the {number(middle)} {unit} at home: [{ends}]"
