"""The assumption of the theorem as sentences, a table and curves (docs/certificate/assumption.md)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo.findings.certificate.uncertainty import AXES, UNITS, Assumption
from hexservo.findings.evidence import Column, Curves, Line, Section, Table, Verdict, picked
from hexservo.scenario.wording import number

PAGE = "docs/certificate/assumption.md"


def section(found: Assumption) -> Section:
    """Return sentences, a table by axis, and gamma over time."""
    title = "Assumption of the stability theorem"
    return Section("assumption", title, _sentences(found), _items(found), _verdict(found), _data(found))


def _sentences(found: Assumption) -> list[str]:
    failed, unknown = np.flatnonzero(found.decided & ~found.held), np.flatnonzero(~found.decided)
    if len(failed):
        axis = int(failed[np.argmax(found.eta[failed] / np.maximum(found.kv[failed], np.finfo(float).tiny))])
        sentences = [
            f"The theorem's assumption k_v >= eta_Delta did not hold on {len(failed)} of 6 axes "
            f"({', '.join(AXES[j] for j in failed)}); worst on {AXES[axis]}, where an error of "
            f"{found.eta[axis]:.3g} {UNITS[axis]} at t = {found.instants[axis]:.4g} s is compared with "
            f"k_v = {found.kv[axis]:.3g} {UNITS[axis]}."
        ]
    elif len(unknown):
        sentences = [
            f"The theorem's assumption k_v >= eta_Delta held on {6 - len(unknown)} of 6 axes at the samples of this "
            f"run, and is undecided on {', '.join(AXES[j] for j in unknown)}."
        ]
    else:
        axis = int(np.argmin(found.margin / np.where(found.kv > 0, found.kv, 1.0)))
        sentences = [
            f"The theorem's assumption k_v >= eta_Delta held on all six axes at the samples of this run; it was "
            f"closest on {AXES[axis]}, where an error of {found.eta[axis]:.3g} {UNITS[axis]} is compared with "
            f"k_v = {found.kv[axis]:.3g} {UNITS[axis]}."
        ]
    sentences += _unsolved(found) + _few_samples(found)
    if found.weights is None:
        sentences.append("No fuzzy systems act: gamma is Delta-tau itself.")
    else:
        sentences.append(
            "eta_Delta is that of the best weights for this run, found afterwards; they differ from the weights "
            "of the law."
        )
        limited = [j for j in failed if found.weights[j].limited]
        if limited:
            sentences.append(
                f"Weights were limited to {number(found.weights[limited[0]].limit)} {UNITS[limited[0]]} on "
                f"{AXES[limited[0]]}; larger ones could have a smaller error there."
            )
    return [*sentences, "This holds at the samples of this trajectory only."]


def _items(found: Assumption) -> tuple[Table | Curves, ...]:
    norms = [None] * 6 if found.weights is None else [float(np.linalg.norm(best.weights)) for best in found.weights]
    table = Table.of(
        "Assumption of the theorem, axis by axis",
        range(6),
        [
            (Column("axis"), lambda j: AXES[j]),
            (Column("unit"), lambda j: UNITS[j]),
            (Column("k_v"), lambda j: float(found.kv[j])),
            (Column("largest |Delta-tau|"), lambda j: float(found.largest[j])),
            (Column("eta_Delta"), lambda j: float(found.eta[j])),
            (Column("margin"), lambda j: float(found.margin[j])),
            (Column("held"), lambda j: ("yes" if found.held[j] else "no") if found.decided[j] else "undecided"),
            (Column("largest at", "s"), lambda j: float(found.instants[j])),
            (Column("norm of w*"), lambda j: norms[j]),
        ],
        note="Margin: k_v - eta_Delta.",
        page=PAGE,
    )
    curves = Curves(
        "Error that the best weights leave, as a part of k_v",
        "time [s]",
        "gamma_j / k_v,j [1]",
        [Line(AXES[j], found.time, found.gamma[:, j] / found.kv[j]) for j in range(6) if found.kv[j] > 0.0],
        note="The assumption holds where all are within -1 and 1.",
        page=PAGE,
    )
    return (table, curves) if curves.lines else (table,)


def _data(found: Assumption) -> dict[str, Any]:
    return {
        **picked(found, "kv eta lower_bound margin held decided"),
        "held_on_all_axes": bool(found.held.all()),
        "largest_uncertainty": found.largest,
        "time_of_largest_error": found.instants,
        "weight_limit": None if found.weights is None else [best.limit for best in found.weights],
        "rank": found.rank,
        "few_samples": found.few_samples,
        "limited": None if found.weights is None else [best.limited for best in found.weights],
        "best_weights": found.ideal,
    }


def _verdict(found: Assumption) -> Verdict:
    if bool(found.held.all()):
        return "good"
    return "open" if bool((found.held | found.few_samples).all()) else "warning"


def _few_samples(found: Assumption) -> list[str]:
    """Return why the axes are undecided whose weights few samples do not determine."""
    few = np.flatnonzero(found.few_samples)
    if not len(few):
        return []
    axes = ", ".join(f"{AXES[j]} ({found.rank[j]})" for j in few)
    return [
        f"The run has {len(found.time)} samples, fewer than two for each of the independent weights that are fitted to "
        f"them: {axes}. So few are brought within k_v for most Delta-tau, which is no evidence: certify a longer run."
    ]


def _unsolved(found: Assumption) -> list[str]:
    """Return what is known of each axis whose best weights the solver did not find."""
    return [
        f"The linear program for the best weights on {AXES[j]} was not solved to its end: eta_Delta is between "
        f"{found.lower_bound[j]:.3g} and {found.eta[j]:.3g} {UNITS[j]}, where k_v = {found.kv[j]:.3g} {UNITS[j]} "
        f"{'is outside, which decides' if found.decided[j] else 'is inside, which leaves it open'}; "
        "gamma and V are those of the best weights that were found."
        for j, best in enumerate(found.weights or ())
        if not best.solved
    ]
