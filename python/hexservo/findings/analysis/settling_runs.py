"""Runs of variations of a scenario: which of them settle, within the limits of the legs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hexservo.findings.analysis.scene import AT_HOME
from hexservo.findings.analysis.tried import bordering
from hexservo.run.batch import metrics_of, simulate_batch, whole
from hexservo.run.leg_limits import KIND_OF_CAUSE, LimitUse, most_used, overload
from hexservo.run.metrics import is_settled
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.noise import is_random
from hexservo.scenario.scenario import Scenario

SEEDS = 4
"""With which the smallest size and the first time that fail are repeated where runs are random."""

# Durations are those of the scenario, whose times may be those of any machine: in dwell times, a run and one where the
# task itself needs longer; the first is at least a share of the scenario's own.
_SHORT, _LONG, _SHARE = 10.0, 50.0, 1 / 30
_ENOUGH = 2.0  # times as long as the task needs where it needs longer still
_STEPS = 100_000  # of the longest run

Tried: TypeAlias = dict[float, bool]
"""Size or time -> whether it settled."""


def border(tried: Mapping[float, bool]) -> tuple[float, float | None]:
    """Return the largest size below the smallest that fails, and that one: (0, ...) for none, (..., None) for none."""
    good, failed = bordering(tried)
    return good or 0.0, failed


def first_overload(overloads: Mapping[float, LimitUse], settles_to: float) -> float | None:
    """Return the smallest size or time with forces beyond the legs' limit, up to the border; None where there is none.

    The runs do not limit forces unless `actuators.saturation` or motors (`position_torque`) do, so that such a run
    settles all the same.
    """
    return min((size for size in overloads if size <= settles_to), default=None)


@dataclass(frozen=True, eq=False)
class Ends:
    """Results of variations of a scenario, one row each."""

    settled: Mask  # in the image, with all legs within their limits all the way
    times: Array  # [s], settling time of the image error; NaN: none
    beyond: list[LimitUse | None]  # the limit that is exceeded most, where a run fails for the legs' limits alone
    overloads: list[LimitUse | None]  # the limit of the efforts, where a run settles with more
    ran: Mask  # False: refused by the core


class SettlingRuns:
    """Runs variations of a scenario for one duration, and counts them.

    Attributes
    ----------
    duration, longer
        [s], of a run, and of the smallest that fails, when it is repeated.
    durations
        How many runs there were of each duration [s].
    task_settles
        Whether the task itself settles, in a run of up to `task_duration` [s].
    whole_duration, whole_settling
        [s], of the longest run of the task itself, as long as the scenario's own if that is not too many steps, and its
        settling time; NaN: it does not settle.
    whole_beyond
        Limit of the legs for which alone it does not; None: for none.
    is_cut
        Whether it does not, and this is shorter than the scenario's own duration.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.durations: Counter[float] = Counter()
        own, step, dwell = scenario.simulation.duration, scenario.simulation.step, scenario.metrics.dwell
        self.scenario = scenario.updated(AT_HOME)
        # the short duration, unless the task itself needs a longer one
        self.duration = min(own, _whole(max(_SHORT * dwell, _SHARE * own), step))
        self.longer = max(self.duration, min(own, _whole(_LONG * dwell, step)))
        self.task_duration = max(self.longer, min(own, _STEPS * step))
        settling = np.nan
        for duration in sorted({self.duration, self.longer, self.task_duration}):
            settling = self._settling(duration)
            if np.isfinite(settling):
                self.duration = duration
                break
        # What acts later than the short duration, such as an outlier, may take the task out of the band again.
        self.whole_duration = max(duration, min(own, _STEPS * step))
        self.whole_settling, self.whole_beyond = settling, None
        if self.whole_duration > duration:
            whole_run = self._task(self.whole_duration)
            self.whole_settling, self.whole_beyond = _time_of(whole_run), whole_run.beyond[0]
        self.task_settles = bool(np.isfinite(settling))
        if self.duration > self.longer:
            enough = _whole(_ENOUGH * (settling + dwell), step)
            if enough < self.duration and np.isfinite(self._settling(enough)):  # with noise it may not
                self.duration = enough
            self.longer = self.duration
        self.is_cut = not self.task_settles and self.task_duration < own
        self.scenario = self.scenario.updated({"simulation.duration": self.duration})

    @property
    def runs(self) -> int:
        """Number of runs so far."""
        return self.durations.total()

    def longest(self) -> Scenario:
        """Return the scenario with the longer duration."""
        return self.scenario.updated({"simulation.duration": self.longer})

    def reseeded(self, variations: Mapping[str, Array], scenario: Scenario | None = None) -> list[tuple[bool, ...]]:
        """Return whether each variation settles with each of some other seeds; empty where runs are not random."""
        base = self.scenario if scenario is None else scenario
        count = max(len(values) for values in variations.values())
        if not is_random(base):
            return [()] * count
        seeds = [seed for seed in range(SEEDS + 1) if seed != base.seed][:SEEDS]
        repeated = {key: np.repeat(values, SEEDS, axis=0) for key, values in variations.items()}
        settled = self.ends({**repeated, "seed": np.tile(seeds, count)}, base).settled.reshape(count, SEEDS)
        return [tuple(bool(good) for good in row) for row in settled]

    def _settling(self, duration: float) -> float:
        """Run the task for a duration and return its settling time [s]; NaN: it does not settle within the limits."""
        return _time_of(self._task(duration))

    def _task(self, duration: float) -> Ends:
        task = self.scenario.updated({"simulation.duration": duration})
        return self.ends({"target.desired_features": np.array([task.target.desired_features])}, task)

    def ends(self, variations: Mapping[str, Array], scenario: Scenario | None = None) -> Ends:
        """Run each variation and return how it ends.

        What the core refuses, such as a goal that the search of `pbvs` does not find, is not run.
        """
        base = self.scenario if scenario is None else scenario
        count = max(len(values) for values in variations.values())
        settled, ran = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
        times = np.full(count, np.nan)
        beyond: list[LimitUse | None] = [None] * count
        overloads: list[LimitUse | None] = [None] * count
        while ran.any():
            rows = np.flatnonzero(ran)
            try:
                varied = {key: values[rows] for key, values in variations.items()}
                batch = whole(simulate_batch(base, varied, log="metrics"))
            except ValueError as error:
                refused = re.match(r"scenario (\d+): ", str(error))
                if refused is None:
                    raise
                ran[rows[int(refused[1])]] = False
                continue
            self.durations[base.simulation.duration] += len(rows)
            times[rows] = batch.metrics["settling_time"]
            in_image = is_settled(batch.outcome, times[rows])
            for k, row in enumerate(rows):
                found = metrics_of(batch, k)
                use = most_used(base, found, KIND_OF_CAUSE.get(batch.cause[k], ""))
                if batch.outcome[k] == "leg_limit" or (in_image[k] and use.share > 1.0):
                    beyond[row] = use
                else:
                    settled[row] = in_image[k]
                    overloads[row] = overload(base, found) if in_image[k] else None
            break
        return Ends(settled, times, beyond, overloads, ran)


def _time_of(ends: Ends) -> float:
    """Return the settling time of the first run [s]; NaN: it does not settle within the limits."""
    return float(ends.times[0]) if ends.settled[0] else np.nan


def _whole(duration: float, step: float) -> float:
    """Round a duration to a whole number of steps."""
    return max(round(duration / step), 1) * step
