"""Runs of drawn variations outside of a campaign's chunks, each with its margins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.chunks import batch_margins
from hexservo.campaigns.plan import CampaignPlan
from hexservo.campaigns.refused import REMEDY, refused_draw, refused_scenario, rows_of, shown_numbers
from hexservo.run.batch import BatchResult, simulate_batch, whole
from hexservo.scenario.arrays import Array

_NAMED = 12  # numbers of a draw, in a message


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
        self.refused = 0  # draws that were left out, since they are no valid scenario
        self.refusal = ""  # why the first of them is none

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
        ScenarioError
            A run draws a scenario that is not valid: the message has its numbers.
        KeyboardInterrupt
            Ctrl-C ended the batch.
        """
        varied = self._varied(numbers, gains)
        try:
            batch = self._batch(varied)
        except ValueError as error:
            if refused_scenario(error) is None:
                raise
            remedy = f"{REMEDY}, or the ranges of tune.variables" if gains else REMEDY
            drawn = {**numbers, **(gains or {})}
            raise refused_draw(error, self.base, drawn, lambda row: _draw(drawn, row), remedy) from None
        return batch_margins(batch, numbers, self.plan.require), batch

    def judged_where_valid(
        self, numbers: Mapping[str, NDArray[Any]], gains: Mapping[str, NDArray[Any]] | None = None
    ) -> tuple[NDArray[np.intp], Array, BatchResult | None]:
        """Return which of the runs are of valid scenarios, (m,), their margins, (m, r), and the runs; None for no run.

        The others are counted in `refused`, and left out. Arguments and KeyboardInterrupt as for `judged`.
        """
        varied = self._varied(numbers, gains)
        kept = np.arange(max(map(len, varied.values())))
        while len(kept):
            found = self._batch_or_refused(rows_of(varied, kept))
            if isinstance(found, BatchResult):
                return kept, batch_margins(found, rows_of(numbers, kept), self.plan.require), found
            kept = np.delete(kept, found)
        return kept, np.empty((0, len(self.plan.require))), None

    def _varied(
        self, numbers: Mapping[str, NDArray[Any]], gains: Mapping[str, NDArray[Any]] | None
    ) -> dict[str, NDArray[Any]]:
        return self.drawing.variations(numbers) | dict(gains or {})

    def _batch_or_refused(self, varied: Mapping[str, NDArray[Any]]) -> BatchResult | int:
        """Return a batch, or the first of its scenarios that is not valid, and note that one."""
        try:
            return self._batch(varied)
        except ValueError as error:
            place = refused_scenario(error)
            if place is None:
                raise
            self.refused += 1
            self.refusal = self.refusal or str(error).splitlines()[0].partition(": ")[2]
            return place

    def _batch(self, varied: Mapping[str, NDArray[Any]]) -> BatchResult:
        batch = whole(simulate_batch(self.base, varied, "metrics", self.threads, metrics=self.metrics))
        self.runs += len(batch)
        return batch

    def smallest_margins(self, numbers: Mapping[str, NDArray[Any]]) -> Array:
        """Return the smallest margin of each run, (n,); argument and errors as for `judged`."""
        smallest: Array = self.judged(numbers)[0].min(axis=1)
        return smallest


def _draw(numbers: Mapping[str, NDArray[Any]], row: int) -> str:
    """Return the numbers of one draw, as the beginning of a message."""
    shown = shown_numbers(numbers, row)
    more = [f"{len(shown) - _NAMED} more"] if len(shown) > _NAMED else []
    return f"the draw of {', '.join([*shown[:_NAMED], *more])}"
