"""Motors that a log gives as sentences, a table and curves (docs/identification.md)."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from hexservo.findings.evidence import Column, Section, Table, Verdict
from hexservo.findings.identification.drives import GOOD, MOST_DELAY
from hexservo.findings.identification.drives_words import (
    at_most,
    curves_of,
    of_correlation,
    of_still_legs,
    with_interval,
)
from hexservo.findings.identification.motors import MotorFit
from hexservo.scenario.wording import number

_WHITE = 2.0  # ticks over which what the motors leave is correlated, at most, for it to be noise
_NAMES = {"kp": "the stiffness", "damping": "the damping", "armature": "the armature", "friction": "dry friction"}
_KEPT = ("kp", "damping", "armature", "friction", "delay", "limit", "noise", "error", "error_of_drives", "explained")


def section(found: MotorFit) -> Section:
    """Return the findings as sentences, a table and curves."""
    unit = found.units.small
    rotary = found.units.effort == "N m"
    table = Table(
        "Motors, the same for all legs, with 95 % intervals",
        (Column("value"), Column("found"), Column("unit")),
        [
            ["stiffness kp", with_interval(found.kp), "N m/rad" if rotary else "N/m"],
            ["damping", with_interval(found.damping), "N m s/rad" if rotary else "N s/m"],
            ["armature", with_interval(found.armature), "kg m^2" if rotary else "kg"],
            ["dry friction", with_interval(found.friction), "N m" if rotary else "N"],
            ["delay", str(found.delay) if found.delay < MOST_DELAY else f"at least {MOST_DELAY}", "ticks"],
        ],
        note="Damping is `kv` and `damping` together, which act alike below the limit of the effort.",
        page="docs/identification.md",
    )
    words = [
        f"Six motors with the platform predict the part kept apart to {number(1e3 * found.error)} {unit} (RMS), six "
        f"responses without coupling to {number(1e3 * found.error_of_drives)} {unit}.",
        f"Mass and inertia of the platform, and the limit of {number(found.limit, 4)} {found.units.effort}, are those "
        "of the machine that was given.",
    ]
    words += of_still_legs(found.still)
    if not found.explains and found.explained is not None:
        words.append(
            f"That is {at_most(found.explained)} of the motion of a leg: the machine does not move as this model, and "
            "none of its keys is taken over."
        )
    elif found.explained is not None and found.explained < GOOD and found.correlated > _WHITE:
        words.append(
            f"That is {at_most(found.explained)} of the motion of a leg, and what is left is no noise: the scenario "
            "moves as the machine only in part."
        )
    if found.delay == MOST_DELAY:
        words.append(
            f"The delay is at least {MOST_DELAY} ticks, the most that is tried and that a scenario has: the key "
            "`actuators.delay` is left as it is."
        )
    words += _of_open(found)
    words += of_correlation("", found.correlated, "these motors lack")
    leg = 1 + int(np.argmax(((found.predicted - found.measured) ** 2).mean(axis=0)))
    return Section(
        name="motors",
        title="Motors of the legs",
        sentences=words,
        items=(table, curves_of(found, leg, f"Leg {leg} on motors")),
        verdict=_verdict(found),
        data={key: value for key, value in asdict(found).items() if key in _KEPT},
    )


def _of_open(found: MotorFit) -> list[str]:
    """Return what the log does not determine, and what becomes of its keys."""
    if not found.open or not found.explains:
        return []
    names = " and ".join(_NAMES[key] for key in found.open)
    keys = " and ".join(f"`actuators.motor.{key}`" for key in found.open)
    many = len(found.open) > 1
    words = f"The log does not determine {names}: "
    if found.kept:
        return [
            f"{words}the {'keys' if many else 'key'} {keys} {'are left as they are' if many else 'is left as it is'}."
        ]
    return [
        f"{words}{keys} {'have values' if many else 'has a value'} of which many move the legs alike; those of the "
        "machine that was given do not."
    ]


def _verdict(found: MotorFit) -> Verdict:
    if not found.explains:
        return "bad"
    known = not found.open and found.delay < MOST_DELAY
    by_noise = found.correlated <= _WHITE  # what is left of legs that move little
    predicts = found.error <= found.error_of_drives and (by_noise or (found.explained or 0.0) >= GOOD)
    return "good" if known and predicts else "warning"
