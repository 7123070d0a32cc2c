"""The theorem's assumption over variations of a scenario, against whether they settle (docs/certificate/batch.md)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo.findings.certificate.replay import Plant, every_step, replay_of
from hexservo.findings.certificate.uncertainty import AXES, assumption_of, uncertainty_of
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Column, Section, Table, as_data
from hexservo.run.metrics import metrics
from hexservo.run.progress import reporting
from hexservo.run.variations import checked_variations, known_key, plain_row
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import wrong_type

__all__ = ["BatchCertificate", "certify_batch"]


PAGE = "docs/certificate/batch.md"


@dataclass(frozen=True, eq=False, repr=False)
class BatchCertificate(Findings):
    """Whether k_v >= eta_Delta held in n runs, and whether they settled, in the order of their variations."""

    scenario: Scenario
    variations: Mapping[str, Array] = field(repr=False)  # as given, each (n or 1, ...)
    outcome: NDArray[np.str_] = field(repr=False)  # (n,) as Result.outcome; "interrupted" where Ctrl-C came before
    settling_time: Array = field(repr=False)  # (n,) [s]; NaN where a run does not settle or was not run
    eta: Array = field(repr=False)  # (n, 6), eta_Delta [N; N m]; NaN where it is not known
    margin: Array = field(repr=False)  # (n, 6), k_v - eta_Delta [N; N m]; likewise

    def __len__(self) -> int:
        """Return the number of scenarios."""
        return len(self.outcome)

    @property
    def finished(self) -> Mask:
        """(n,), runs that were run to their end and whose best weights were found."""
        return np.asarray(np.isfinite(self.eta).all(axis=1))

    @property
    def held(self) -> Mask:
        """(n,), whether the assumption held on all six axes; false where it is not known."""
        return np.asarray((self.margin >= 0.0).all(axis=1))

    @property
    def settled(self) -> Mask:
        """(n,), whether the run completed and has a settling time (docs/model.md, section 8)."""
        return np.asarray((self.outcome == "completed") & np.isfinite(self.settling_time))

    @property
    def counts(self) -> NDArray[np.intp]:
        """(2, 2), finished runs: row 0 where the assumption held, row 1 where not; column 0 settled, column 1 not."""
        done = self.finished
        return np.array(
            [
                [np.count_nonzero(done & (self.held == held) & (self.settled == settled)) for settled in (True, False)]
                for held in (True, False)
            ]
        )

    def section(self) -> Section:
        """Words, the table of both shares, and the axes on which the assumption fails."""
        counts, done = self.counts, int(np.count_nonzero(self.finished))
        if done == 0:
            sentences = ["No run was finished: there is nothing to count."]
        else:
            sentences = [
                f"The assumption held in {counts[0].sum()} of {done} runs ({counts[0].sum() / done:.1%}), "
                f"and {counts[:, 0].sum()} settled ({counts[:, 0].sum() / done:.1%}): {counts[0, 0]} of those where it "
                f"held, and {counts[1, 0]} of the {counts[1].sum()} where it did not."
            ]
        if done < len(self):
            sentences.append(
                f"{len(self) - done} of {len(self)} runs have no verdict: not run, or without best weights."
            )
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
        known = self.margin[self.finished]
        axes = Table(
            "Assumption by axis",
            (Column("axis"), Column("runs where it held"), Column("smallest margin"), Column("unit")),
            [
                (name, int(np.count_nonzero(known[:, j] >= 0.0)), float(known[:, j].min()), "N" if j < 3 else "N m")
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
                "runs": len(self),
                "finished": done,
                "held_and_settled": int(counts[0, 0]),
                "held_and_not_settled": int(counts[0, 1]),
                "not_held_and_settled": int(counts[1, 0]),
                "not_held_and_not_settled": int(counts[1, 1]),
                "outcome": list(map(str, self.outcome)),
                "settling_time": self.settling_time,
                "eta": self.eta,
                "margin": self.margin,
            },
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers for strict JSON, in SI units and pixels."""
        section = self.section()
        return {section.name: as_data(section.data)}


def certify_batch(
    scenario: Scenario,
    variations: Mapping[str, ArrayLike],
    progress: bool | Callable[[int, int], object] | None = None,
) -> BatchCertificate:
    """Check the theorem's assumption in many variations of a scenario of the law `hybrid` in continuous mode.

    One run after another, each with the assumption of `certify` and nothing else of it: a few tenths of a second each.

    Parameters
    ----------
    scenario
        What the variations vary.
    variations
        As of `simulate_batch`.
    progress
        True draws a bar on standard error; a function is called with (scenarios done, scenarios in all) after each.

    Returns
    -------
    BatchCertificate
        Ctrl-C ends the batch and keeps what is finished; the others are ``interrupted``, with NaN for numbers.

    Raises
    ------
    TypeError
        For anything but a `Scenario`, a mapping and the types above.
    ValueError
        For another law or mode, of which the theorem does not speak, and as `simulate_batch` for the variations.
    """
    if not isinstance(scenario, Scenario):
        raise wrong_type("scenario", "a Scenario (see hs.load_scenario)", scenario)
    if scenario.controller.law != "hybrid":
        raise ValueError(f"controller.law: expected hybrid, of which the theorem is, got {scenario.controller.law}")
    if scenario.simulation.mode != "continuous":
        raise ValueError("simulation.mode: expected continuous, of which the theorem is, got sampled")
    arrays = checked_variations(scenario, variations)
    count = max(len(values) for values in arrays.values())
    scenarios = [scenario.updated(_row(scenario, arrays, index)) for index in range(count)]
    outcome = np.full(count, "interrupted", dtype="<U16")
    settling_time, eta, margin = np.full(count, np.nan), np.full((count, 6), np.nan), np.full((count, 6), np.nan)
    with contextlib.suppress(KeyboardInterrupt), reporting(progress, "runs certified") as report:
        for index, varied in enumerate(scenarios):
            result = every_step(varied)
            run = replay_of(result, varied, result.end_time)
            with contextlib.suppress(ArithmeticError):  # no best weights: the run has no verdict
                assumption = assumption_of(run, uncertainty_of(run, Plant.of(run.probe)), smallest=False)
                eta[index], margin[index] = assumption.eta, assumption.margin
            outcome[index], settling_time[index] = result.outcome, metrics(result)["settling_time"]
            report(index + 1, count)
    return BatchCertificate(scenario, arrays, outcome, settling_time, eta, margin)


def _row(scenario: Scenario, arrays: Mapping[str, Array], index: int) -> dict[str, Any]:
    law = scenario.controller.law
    return {
        key: plain_row(known_key(key, law), values[index if len(values) > 1 else 0]) for key, values in arrays.items()
    }
