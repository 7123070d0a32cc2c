"""The theorem's assumption over variations of a scenario, compared with settling (docs/certificate/batch.md)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.certificate.replay import Plant, every_step, replay_of
from hexservo.findings.certificate.uncertainty import assumption_of, uncertainty_of
from hexservo.findings.part import Part
from hexservo.run.metrics import is_settled, metrics
from hexservo.run.progress import reporting
from hexservo.run.variations import changes_of_run, checked_variations
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.fields import described
from hexservo.scenario.laws import THEOREM_LAW
from hexservo.scenario.scenario import Scenario, require_scenario


@described
@dataclass(frozen=True, eq=False, repr=False)
class BatchCertificate(Part):
    """Whether k_v >= eta_Delta held in n runs, and whether they settled, in the order of their variations."""

    scenario: Scenario  # without the variations
    variations: Mapping[str, Array] = field(repr=False)  # as given, each (n or 1, ...)
    outcome: NDArray[np.str_] = field(repr=False)  # (n,) as Result.outcome; "interrupted" where Ctrl-C came before
    settling_time: Array = field(repr=False)  # (n,) [s]; NaN where a run does not settle or was not run
    eta: Array = field(repr=False)  # (n, 6), eta_Delta [N; N m]; NaN where it is not known
    margin: Array = field(repr=False)  # (n, 6), k_v - eta_Delta [N; N m]; likewise
    held_by_axis: Mask = field(repr=False)  # (n, 6), whether it held, but for rounding; false where it is not known
    decided_by_axis: Mask = field(repr=False)  # (n, 6), whether that is known

    def __len__(self) -> int:
        """Return the number of scenarios."""
        return len(self.outcome)

    @property
    def finished(self) -> Mask:
        """(n,), runs that were run before Ctrl-C."""
        return np.asarray(self.outcome != "interrupted")

    @property
    def held(self) -> Mask:
        """(n,), whether the assumption held on all six axes; false where it is not known."""
        return np.asarray(self.held_by_axis.all(axis=1))

    @property
    def decided(self) -> Mask:
        """(n,), whether that is known: it held on all six axes, or did not on one of them."""
        return np.asarray(self.held | (self.decided_by_axis & ~self.held_by_axis).any(axis=1))

    @property
    def settled(self) -> Mask:
        """(n,), whether the run completed and has a settling time (docs/model.md, section 8)."""
        return is_settled(self.outcome, self.settling_time)

    @property
    def counts(self) -> NDArray[np.intp]:
        """(3, 2), finished runs: rows held, not held, undecided; column 0 settled, column 1 not."""
        rows = (self.held, self.decided & ~self.held, ~self.decided)
        return np.array(
            [
                [np.count_nonzero(self.finished & row & (self.settled == settled)) for settled in (True, False)]
                for row in rows
            ]
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers for strict JSON, in SI units and pixels."""
        section = self.section()
        return {section.name: section.to_dict()}


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
        For another law or mode, of which the theorem does not speak, as `simulate_batch` for the variations, and for a
        varied scenario with a centre of mass off the platform's origin or an unknown payload, which has no certificate.
    """
    require_scenario(scenario)
    if scenario.controller.law != THEOREM_LAW:
        raise ValueError(
            f"controller.law: expected {THEOREM_LAW}, of which the theorem is, got {scenario.controller.law}"
        )
    if scenario.sampled:
        raise ValueError("simulation.mode: expected continuous, of which the theorem is, got sampled")
    arrays = checked_variations(scenario, variations)
    count = max(len(values) for values in arrays.values())
    scenarios = [scenario.updated(changes_of_run(arrays, scenario.controller.law, index)) for index in range(count)]
    for index, varied in enumerate(scenarios):
        if reason := scene_of(varied).unusual_body:
            raise ValueError(f"scenario {index}: robot: expected the body of the paper, got another: {reason}")
    outcome = np.full(count, "interrupted", dtype="<U16")
    settling_time, eta, margin = np.full(count, np.nan), np.full((count, 6), np.nan), np.full((count, 6), np.nan)
    held, decided = np.zeros((count, 6), dtype=bool), np.zeros((count, 6), dtype=bool)
    with contextlib.suppress(KeyboardInterrupt), reporting(progress, "runs certified") as report:
        for index, varied in enumerate(scenarios):
            result = every_step(varied)
            run = replay_of(result, varied, result.end_time)
            with contextlib.suppress(ArithmeticError):  # a weight too large for numbers: undecided
                assumption = assumption_of(run, uncertainty_of(run, Plant.of(run)), smallest=False)
                eta[index], margin[index] = assumption.eta, assumption.margin
                held[index], decided[index] = assumption.held, assumption.decided
            outcome[index], settling_time[index] = result.outcome, metrics(result)["settling_time"]
            report(index + 1, count)
    return BatchCertificate(scenario, arrays, outcome, settling_time, eta, margin, held, decided)
