"""The energy ledger as sentences, a table and curves (docs/certificate/energy.md)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo.findings.certificate.energy import EnergyLedger
from hexservo.findings.evidence import Column, Curves, Line, Section, Table, Verdict, picked
from hexservo.scenario.wording import joules, shown_unit

PAGE = "docs/certificate/energy.md"


def section(found: EnergyLedger) -> Section:
    """Return sentences, the table of works, and curves of the works so far."""
    verdict: Verdict = "good" if found.closes else "bad"
    return Section("energy", "Energy ledger", _sentences(found), _items(found), verdict, _data(found))


def _change(found: EnergyLedger) -> float:
    """Return the change of the kinetic energy in the run [J]."""
    return float(found.energy[-1] - found.energy[0])


def _sentences(found: EnergyLedger) -> list[str]:
    gap = (
        f"the change of kinetic energy and the works of {len(found.works)} terms differ by "
        f"{joules(abs(found.residual), 2)}, {_part(abs(found.residual), found.turnover)} of the "
        f"{joules(found.turnover)} that were turned over (tolerance {joules(found.tolerance, 2)})"
    )
    sentences = [
        f"The energy ledger closes: {gap}."
        if found.closes
        else f"The energy ledger does not close: {'; '.join(found.faults)}."
    ]
    if "held" in found.works:
        injected = found.work("held")
        sentences.append(
            f"Sampling, delay and devices {'put' if injected > 0 else 'took'} {joules(abs(injected))} "
            f"{'into' if injected > 0 else 'out of'} the platform, compared with the law at each instant's true "
            "state."
        )
    sentences += [
        f"{name} {'took out' if found.work(term) < 0 else 'put in'} {joules(abs(found.work(term)))}."
        for term, name in (("switching", "The switching term"), ("damping", "Viscous damping"))
        if term in found.works
    ]
    return [*sentences, *found.remarks, "This is the energy balance of this run only."]


def _items(found: EnergyLedger) -> tuple[Table, Curves]:
    largest = sorted(found.works, key=lambda term: -float(np.abs(found.works[term]).sum()))
    unit, scale = shown_unit(
        max([found.turnover, *(float(np.abs(parts).sum()) for parts in found.works.values())]), "J"
    )
    table = Table(
        "Work of each term",
        (
            Column("term"),
            Column("work", unit),
            Column("of translation", unit),
            Column("of rotation", unit),
            Column("turned over", unit),
        ),
        [
            (
                _NAMES[term],
                found.work(term) * scale,
                float(found.by_axis[term][:3].sum()) * scale,
                float(found.by_axis[term][3:].sum()) * scale,
                float(np.abs(found.works[term]).sum()) * scale,
            )
            for term in found.works
        ]
        + [
            ("sum of the works", sum(map(found.work, found.works)) * scale, None, None, found.turnover * scale),
            ("change of kinetic energy", _change(found) * scale, None, None, None),
            ("residual", found.residual * scale, None, None, None),
            ("tolerance of the residual", found.tolerance * scale, None, None, None),
        ],
        note=f"{found.crossings} steps contain a sign change of a twist component.",
        page=PAGE,
    )
    curves = Curves(
        "Work of each term so far",
        "time [s]",
        f"work [{unit}]",
        [Line(_NAMES[term], found.time, np.r_[0.0, np.cumsum(found.works[term])] * scale) for term in largest]
        + [Line("change of kinetic energy", found.time, (found.energy - found.energy[0]) * scale, "dashed")],
        page=PAGE,
    )
    return table, curves


def _data(found: EnergyLedger) -> dict[str, Any]:
    return {
        "works": {term: found.work(term) for term in found.works},
        "works_by_component": {term: found.by_axis[term] for term in found.works},
        "change_of_kinetic_energy": _change(found),
        **picked(found, "residual tolerance turnover mismatch pose_mismatch image_mismatch"),
        "sign_changes": found.crossings,
        "signs_by_rounding": found.tossed,
        "closes": found.closes,
        "faults": list(found.faults),
    }


_NAMES = {
    "image_spring": "image spring, J-hat^T K_p xi~",
    "pose_spring": "pose spring",
    "reference": "reference velocity, K_i v*",
    "damping": "viscous damping",
    "switching": "switching term, -K_v sw(chi-dot)",
    "fuzzy": "fuzzy systems, -tau_f",
    "coriolis_feedforward": "Coriolis feed-forward",
    "own": "custom controller, beyond the estimated weight",
    "acting": "the law, beyond the estimated weight",
    "gravity": "weight: fed forward minus actual",
    "coriolis": "Coriolis and inertia errors",
    "base": "motion of the base",
    "held": "injected by sampling, delay and devices",
}


def _part(value: float, whole: float) -> str:
    return f"{value / whole:.1g}" if whole > 0 else "none"
