"""Runs of a scenario with other seeds: whether what one run with noise comes to is by chance."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.tracking_runs import seeds_of_runs
from hexservo.run.batch import BatchResult, metrics_of, simulate_batch, whole
from hexservo.run.leg_limits import exceeded_limits
from hexservo.run.metrics import is_settled, unsettled
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.noise import is_random
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import above, below, percent_below

MOST_RUNS = 58
"""Runs with other seeds: beside the scenario's own, of a share of 5 % that fails one is seen in 95 % of all checks."""

NAMED = "hexservo diagnose names the cause"
"""What to do about a run that does not settle."""

_MOST_STEPS = 3_000_000  # of all of them: fewer runs where one has more than 50 000
_SURE = 0.95  # that the stated share of runs settles


@dataclass(frozen=True, eq=False)
class OtherSeeds:
    """Runs of a scenario, each with a different seed in place of the scenario's."""

    batch: BatchResult  # log "metrics"

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return the seeds, (n,)."""
        return tuple(int(seed) for seed in self.batch.variations["seed"])

    @property
    def settled(self) -> Mask:
        """Return which of the runs are settled, (n,)."""
        return is_settled(self.batch.outcome, self.settling_times)

    @property
    def settling_times(self) -> Array:
        """Return the settling times, (n,) [s]; NaN: not within the band at the end."""
        return self.batch.metrics["settling_time"]

    @property
    def words(self) -> str:
        """How soon and how surely they settle beside the scenario's own run, where all do; empty otherwise.

        Where a share s of all seeds settles, n of n do with the probability s^n: 5 % at the share that is stated.
        """
        count = len(self.batch)
        if not self.settled.all():
            return ""
        first, last = below(float(self.settling_times.min())), above(float(self.settling_times.max()))
        times = last if first == last else f"{first} to {last}"
        seeds = "seed" if count == 1 else "seeds"
        share = percent_below((1.0 - _SURE) ** (1.0 / (count + 1)))
        sure = f"at least {share} of all seeds settle, at {_SURE:.0%} confidence"
        return f"with {count} other {seeds} after {times} s ({sure})"

    @property
    def settle_instead(self) -> str:
        """How many settle, as a clause about a run of the scenario that does not; empty where none does."""
        count = int(self.settled.sum())
        return f" (with {count} of {len(self.batch)} other seeds it does)" if count else ""

    def to_dict(self) -> dict[str, Any]:
        """Return seeds, outcomes and settling times [s] (null: not settled) of the runs as data."""
        times = [
            float(time) if settled else None for time, settled in zip(self.settling_times, self.settled, strict=True)
        ]
        return {"seeds": list(self.seeds), "outcomes": self.batch.outcome.tolist(), "settling_times": times}

    def doubts(self, kinds: Collection[str]) -> Iterator[str]:
        """Yield a sentence for runs that do not settle, and one for each other kind of limit that settled ones exceed.

        Parameters
        ----------
        kinds
            Kinds of the limits that the scenario's own run exceeds, which settles.
        """
        scenario, count = self.batch.scenario, len(self.batch)
        failed = np.flatnonzero(~self.settled)
        if len(failed):
            yield (
                f"simulation: the run settles, but with {len(failed)} of {count} other seeds it does not, "
                f"{self._why(int(failed[0]))}; {NAMED}"
            )
        beyond: dict[str, list[int]] = {}
        for row in np.flatnonzero(self.settled):
            for limit in exceeded_limits(scenario, metrics_of(self.batch, int(row))):
                if limit.kind not in kinds:
                    beyond.setdefault(f"{limit.exceeded} of {limit.text}", []).append(self.seeds[row])
        for words, seeds in beyond.items():
            yield f"simulation: with {len(seeds)} of {count} other seeds {words}, as with seed: {seeds[0]}"

    def _why(self, row: int) -> str:
        seed, outcome = f"as with seed: {self.seeds[row]}", str(self.batch.outcome[row])
        if outcome != "completed":
            return f"{seed}, where it ends early ({outcome.replace('_', ' ')})"
        return f"{seed} ({unsettled(metrics_of(self.batch, row), self.batch.scenario.metrics)})"


def with_other_seeds(scenario: Scenario) -> OtherSeeds | None:
    """Run a scenario with other seeds; None where nothing is random in it, or its runs are too long.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    """
    steps = scenario.simulation.duration / scenario.simulation.step
    count = min(MOST_RUNS, int(_MOST_STEPS / steps))
    if count < 1 or not is_random(scenario):
        return None
    seeds = {"seed": seeds_of_runs(scenario, count + 1)[1:]}
    return OtherSeeds(whole(simulate_batch(scenario, seeds, log="metrics")))
