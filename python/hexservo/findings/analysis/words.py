"""Text of numbers, directions and displacements, for the sentences of the analyses."""

from __future__ import annotations

import numpy as np

from hexservo.findings.evidence import Section
from hexservo.scenario.arrays import Array
from hexservo.scenario.wording import number

__all__ = [
    "AXES",
    "along",
    "direction_words",
    "displacement_parts",
    "displacement_words",
    "finite",
    "in_ms",
    "motion_in_words",
    "number",
    "numbers",
    "open_section",
]

AXES = ("along x", "along y", "along z", "about x", "about y", "about z")
"""Of shifts and turns, of forces and moments."""

_STRAIGHT = 0.98  # cosine from which a direction is called that of an axis
_LITTLE = 0.03  # of what the other part does to the image: a part that is left out
# An entry of a displacement is written as zero where it is less than both, or than what a search resolves.
_OF_DEPTH, _OF_LARGEST, _RESOLVED = 1e-5, 1e-3, 1e-7  # of the depth and rad; of the largest entry; as the first


def numbers(values: Array) -> str:
    """Write a list of numbers: "1.2, 3.4 and 5.6"."""
    texts = [number(value) for value in values]
    return ", ".join(texts[:-1]) + " and " + texts[-1] if len(texts) > 1 else texts[0]


def in_ms(seconds: float) -> str:
    """Write a time in milliseconds: "33 ms"."""
    return f"{1e3 * seconds:.4g} ms"


def along(vector: Array, *, signed: bool = False) -> str:
    """Name the axis that a vector (3,) is along, or its direction: "x", "(0.71, 0.70, 0.00)".

    Signed, the opposite direction is "-x".
    """
    unit = vector / np.linalg.norm(vector)
    largest = int(np.abs(unit).argmax())
    if abs(unit[largest]) > _STRAIGHT:
        return ("-" if signed and unit[largest] < 0 else "") + "xyz"[largest]
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in np.where(np.abs(unit) < 0.005, 0.0, unit)) + ")"


def direction_words(direction: Array, depth: float, size: float) -> str:
    """Describe a direction (6,) [m; rad] in B, of any length, for a target at a depth [m].

    A mixed one is shown by a motion with a shift of a size [m], `Scene.small_shift`. A part that moves the image
    less than 3 % of the other one is left out.
    """
    shift, turn = np.linalg.norm(direction[:3]), np.linalg.norm(direction[3:])
    if turn * depth < _LITTLE * shift:
        return f"a translation along {along(direction[:3], signed=True)}"
    if shift < _LITTLE * turn * depth:
        return f"a rotation about {along(direction[3:], signed=True)}"
    return (
        f"{number(1e3 * size)} mm along {along(direction[:3], signed=True)} with "
        f"{number(1e3 * size * float(turn / shift))} mrad about {along(direction[3:], signed=True)}"
    )


def motion_in_words(jacobian: Array, motion: Array) -> str:
    """Describe a small motion by the image motion of its parts.

    Parameters
    ----------
    jacobian
        (2p, 6), of the image [px/m; px/rad].
    motion
        (6,), shift [m] and rotation vector [rad], both in B.
    """
    shift, turn = motion[:3], motion[3:]
    by_shift = float(np.linalg.norm(jacobian[:, :3] @ shift))
    by_turn = float(np.linalg.norm(jacobian[:, 3:] @ turn))
    left = float(np.linalg.norm(jacobian @ motion))
    if by_turn <= 0.2 * by_shift:
        return f"a translation along {along(shift)}"
    if by_shift <= 0.2 * by_turn:
        return f"a rotation about {along(turn)}"
    together = (
        "barely distinguishable from a rotation about {}"
        if left < 0.5 * max(by_shift, by_turn)
        else "with a rotation about {}"
    )
    return f"a translation along {along(shift)} " + together.format(along(turn))


def displacement_words(displacement: Array, length: float) -> str:
    """Describe a displacement (6,) [m; rad]: "(1.5, 0, 20) mm and a rotation of (0, 31.2, 0) mrad".

    See `displacement_parts`.
    """
    shift, turn = displacement_parts(displacement, length)
    return f"{shift} mm and a rotation of {turn} mrad"


def displacement_parts(displacement: Array, length: float) -> tuple[str, str]:
    """Write the shift [mm] and the rotation vector [mrad] of a displacement (6,) [m; rad], with three digits.

    Entries that are small beside a length [m], the target's depth, and beside the largest one are written as zero;
    rotations are compared times this length.
    """
    sizes = np.abs(displacement) / np.repeat([length, 1.0], 3)
    least = max(min(_OF_DEPTH, _OF_LARGEST * float(sizes.max())), _RESOLVED)
    shown = np.where(sizes < least, 0.0, 1e3 * displacement)
    shift, turn = ("(" + ", ".join(number(value) for value in part) + ")" for part in np.split(shown, 2))
    return shift, turn


def finite(value: float) -> float | None:
    """Return a number for a table; None, which leaves its cell empty, where it is not finite."""
    return value if np.isfinite(value) else None


def open_section(name: str, title: str, reason: str) -> Section:
    """Return why an analysis does not apply."""
    return Section(name, title, [reason], data={"applies": False, "reason": reason})
