"""Motors that a log gives as sentences, a table and curves (docs/identification.md)."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from hexservo.findings.evidence import Column, Curves, Line, Section, Table, Verdict
from hexservo.findings.identification.drives import MOST_DELAY
from hexservo.findings.identification.drives_words import with_interval
from hexservo.findings.identification.motors import MotorFit
from hexservo.scenario.wording import number

PAGE = "docs/identification.md"

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
        page=PAGE,
    )
    words = [
        f"Six motors with the platform predict the part kept apart to {number(1e3 * found.error)} {unit} (RMS), six "
        f"responses without coupling to {number(1e3 * found.error_of_drives)} {unit}.",
        f"Mass and inertia of the platform, and the limit of {number(found.limit)} {found.units.effort}, are those of "
        "the machine that was given.",
    ]
    if not found.explains and found.explained is not None:
        share = f"no more than {number(100 * found.explained)} %" if found.explained > 0.0 else "nothing"
        words.append(
            f"That is {share} of the motion of a leg: the machine does not move as this model, and none of its keys is "
            "taken over."
        )
    if found.delay == MOST_DELAY:
        words.append(
            f"The delay is at least {MOST_DELAY} ticks, the most that is tried and that a scenario has: the key "
            "`actuators.delay` is left as it is."
        )
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
        verdict=_verdict(found),
        data={key: value for key, value in asdict(found).items() if key in _KEPT},
    )


def _verdict(found: MotorFit) -> Verdict:
    if not found.explains:
        return "bad"
    return "good" if found.error <= found.error_of_drives and found.delay < MOST_DELAY else "warning"
