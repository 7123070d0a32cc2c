"""The assumption over a batch as a sentence and tables (docs/certificate/batch.md)."""

from __future__ import annotations

import numpy as np

from hexservo.findings.certificate.batch import BatchCertificate
from hexservo.findings.certificate.uncertainty import AXES
from hexservo.findings.evidence import Column, Section, Table, picked

PAGE = "docs/certificate/batch.md"


def section(found: BatchCertificate) -> Section:
    """Return sentences, the table of both shares, and the axes on which the assumption fails."""
    counts, done = found.counts, int(np.count_nonzero(found.finished))
    if done == 0:
        sentences = ["No run was finished: there is nothing to count."]
    else:
        sentences = [
            f"The assumption held in {counts[0].sum()} of {done} runs ({counts[0].sum() / done:.1%}), "
            f"and {counts[:, 0].sum()} settled ({counts[:, 0].sum() / done:.1%}): {counts[0, 0]} of those where it "
            f"held, and {counts[1, 0]} of the {counts[1].sum()} where it did not."
        ]
    if done < len(found):
        sentences.append(f"{len(found) - done} of {len(found)} runs have no verdict: not run, or without best weights.")
    sentences.append(
        "With sign, and weights without dead zone and leakage, the assumption is sufficient for a V that does not "
        "grow, at the samples it was checked at; it is neither sufficient nor necessary for settling."
    )
    both = Table(
        "Runs by assumption and settling",
        (Column("assumption"), Column("settled"), Column("not settled"), Column("share settled", "%")),
        [
            (name, int(row[0]), int(row[1]), 100.0 * float(row[0] / row.sum()) if row.sum() else None)
            for name, row in (("held", counts[0]), ("did not hold", counts[1]))
        ],
        page=PAGE,
    )
    margin, held = found.margin[found.finished], found.held_by_axis[found.finished]
    axes = Table(
        "Assumption by axis",
        (Column("axis"), Column("runs where it held"), Column("smallest margin"), Column("unit")),
        [
            (name, int(np.count_nonzero(held[:, j])), float(margin[:, j].min()), "N" if j < 3 else "N m")
            for j, name in enumerate(AXES)
        ]
        if done
        else [],
        page=PAGE,
    )
    return Section(
        name="assumption_batch",
        title="Assumption of the stability theorem over a batch",
        sentences=sentences,
        items=(both, axes),
        verdict="open",
        data={
            "runs": len(found),
            "finished": done,
            "held_and_settled": int(counts[0, 0]),
            "held_and_not_settled": int(counts[0, 1]),
            "not_held_and_settled": int(counts[1, 0]),
            "not_held_and_not_settled": int(counts[1, 1]),
            "outcome": list(map(str, found.outcome)),
            **picked(found, "settling_time eta margin held_by_axis"),
        },
    )
