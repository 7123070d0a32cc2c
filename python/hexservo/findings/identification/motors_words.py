"""Motors that a log gives as sentences, a table and curves (docs/identification.md)."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from hexservo.findings.evidence import Column, Curves, Line, Section, Table
from hexservo.findings.identification.drives_words import with_interval
from hexservo.findings.identification.motors import MotorFit
from hexservo.scenario.wording import number

__all__ = ["section"]

PAGE = "docs/identification.md"

_KEPT = ("kp", "damping", "armature", "friction", "delay", "limit", "noise", "error", "error_of_drives")


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
            ["delay", str(found.delay), "ticks"],
        ],
        note="Damping is `kv` and `damping` together, which act alike below the limit of the effort.",
        page=PAGE,
    )
    words = [
        f"Six motors with the platform predict the part kept apart to {number(1e3 * found.error)} {unit} (RMS), six "
        f"responses without coupling to {number(1e3 * found.error_of_drives)} {unit}.",
        f"Mass and inertia of the platform, and the limit of {number(found.limit)} {found.units.effort}, are those of "
        "the machine that was given.",
    ]
    if found.correlated > 5.0:
        words.append(
            f"What the fit leaves is correlated over {number(found.correlated)} ticks: something acts that these "
            "motors lack; the intervals are widened for it."
        )
    leg = int(np.argmax(((found.predicted - found.measured) ** 2).mean(axis=0)))
    curves = Curves(
        f"Leg {leg + 1} on motors in the part kept apart, the worst one",
        "time [s]",
        f"{found.units.name} [{unit}]",
        [
            Line("measured", found.time, 1e3 * found.measured[:, leg]),
            Line("predicted", found.time, 1e3 * found.predicted[:, leg], "dashed"),
        ],
        page=PAGE,
    )
    return Section(
        name="motors",
        title="Motors of the legs",
        sentences=words,
        items=(table, curves),
        verdict="good" if found.error <= found.error_of_drives else "warning",
        data={key: value for key, value in asdict(found).items() if key in _KEPT},
    )
