"""Runs of drawn variations outside of a campaign's chunks, each with its margins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from numpy.typing import NDArray

from hexservo.campaigns.chunks import batch_margins
from hexservo.campaigns.plan import CampaignPlan
from hexservo.run.batch import BatchResult, simulate_batch, whole
from hexservo.scenario.arrays import Array


class Judge:
    """Runs what a campaign may draw, and judges each run against its requirements; counts the runs.

    Runs have the metrics of the requirements, and those of `metrics`. Their legs are looked at in any case, so that
    they end as those of `simulate` do.
    """

    def __init__(self, plan: CampaignPlan, threads: int | None, metrics: Iterable[str] = ()) -> None:
        self.plan = plan
        self.metrics = (*plan.required_metrics(), *metrics, "peak_leg_force")
        self.threads = threads
        self.drawing = plan.drawing()
        self.base = plan.scenario.updated(self.drawing.base)  # what a batch varies
        self.runs = 0  # that were simulated

    def judged(
        self, numbers: Mapping[str, NDArray[Any]], gains: Mapping[str, NDArray[Any]] | None = None
    ) -> tuple[Array, BatchResult]:
        """Return the margins of runs for every requirement, (n, r), and the runs.

        Parameters
        ----------
        numbers
            As those of `Drawing.numbers`, n runs.
        gains
            Further keys of the scenario to vary, each (n, ...) or (1, ...).

        Raises
        ------
        KeyboardInterrupt
            Ctrl-C ended the batch.
        """
        varied = self.drawing.variations(numbers) | dict(gains or {})
        batch = whole(simulate_batch(self.base, varied, "metrics", self.threads, metrics=self.metrics))
        self.runs += len(batch)
        return batch_margins(batch, numbers, self.plan.require), batch

    def smallest_margins(self, numbers: Mapping[str, NDArray[Any]]) -> Array:
        """Return the smallest margin of each run, (n,); argument and errors as for `judged`."""
        smallest: Array = self.judged(numbers)[0].min(axis=1)
        return smallest
