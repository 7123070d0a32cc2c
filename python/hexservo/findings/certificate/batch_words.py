"""The assumption over a batch as a sentence and tables (docs/certificate/batch.md)."""

from __future__ import annotations

import numpy as np

from hexservo.findings.analysis.words import finite
from hexservo.findings.certificate.batch import BatchCertificate
from hexservo.findings.certificate.uncertainty import AXES, UNITS
from hexservo.findings.evidence import Column, Section, Table, picked

PAGE = "docs/certificate/batch.md"


def section(found: BatchCertificate) -> Section:
    """Return sentences, the table of both shares, and the axes on which the assumption fails."""
    counts, done = found.counts, int(np.count_nonzero(found.finished))
    held, failed, unknown = (int(row.sum()) for row in counts)
    if done == 0:
        sentences = ["No run was finished: there is nothing to count."]
    else:
        up_to = (f" to {held + unknown}", f" to {(held + unknown) / done:.1%}") if unknown else ("", "")
        groups = [f"{counts[0, 0]} of those where it held", f"{counts[1, 0]} of the {failed} where it did not"]
        if unknown:
            groups.append(f"{counts[2, 0]} of the {unknown} where it is undecided")
        sentences = [
            f"The assumption held in {held}{up_to[0]} of {done} runs ({held / done:.1%}{up_to[1]}), "
            f"and {counts[:, 0].sum()} settled ({counts[:, 0].sum() / done:.1%}): {', '.join(groups[:-1])}, "
            f"and {groups[-1]}."
        ]
    if unknown:
        sentences.append(
            f"{unknown} of {done} runs are undecided: the linear program for the best weights was not solved to its "
            "end, and k_v is between the bounds of eta_Delta; or eta_Delta could not be computed."
        )
    if done < len(found):
        sentences.append(f"{len(found) - done} of {len(found)} variations were not run and are not counted.")
    sentences.append(
        "With sign, and weights without dead zone and leakage, the assumption is sufficient for a V that does not "
        "grow, at the samples it was checked at; it is neither sufficient nor necessary for settling."
    )
    both = Table(
        "Runs by assumption and settling",
        (Column("assumption"), Column("settled"), Column("not settled"), Column("share settled", "%")),
        [
            (name, int(row[0]), int(row[1]), 100.0 * float(row[0] / row.sum()) if row.sum() else None)
            for name, row in zip(("held", "did not hold", "undecided"), counts, strict=True)
            if name != "undecided" or unknown
        ],
        page=PAGE,
    )
    by_axis = [mask[found.finished] for mask in (found.held_by_axis, ~found.decided_by_axis)]
    margin = np.nan_to_num(found.margin, nan=np.inf)
    axes = Table.of(
        "Assumption by axis",
        range(6) if done else (),
        [
            (Column("axis"), lambda j: AXES[j]),
            (Column("runs where it held"), lambda j: int(np.count_nonzero(by_axis[0][:, j]))),
            *([(Column("undecided"), lambda j: int(np.count_nonzero(by_axis[1][:, j])))] if unknown else []),
            (Column("smallest margin"), lambda j: finite(float(margin[:, j].min()))),
            (Column("unit"), lambda j: UNITS[j]),
        ],
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
            "not_run": len(found) - done,
            "held_and_settled": int(counts[0, 0]),
            "held_and_not_settled": int(counts[0, 1]),
            "not_held_and_settled": int(counts[1, 0]),
            "not_held_and_not_settled": int(counts[1, 1]),
            "undecided_and_settled": int(counts[2, 0]),
            "undecided_and_not_settled": int(counts[2, 1]),
            "outcome": list(map(str, found.outcome)),
            **picked(found, "settling_time eta margin held_by_axis decided_by_axis"),
        },
    )
