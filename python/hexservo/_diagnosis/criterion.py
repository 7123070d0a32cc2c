"""When a run counts as failed, and by how much: one number that runs before and after a change can be compared by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexservo import _core

__all__ = ["DRIFT_TIME", "EARLY", "THRESHOLD", "Judgement", "Record", "judge", "make_record"]

Array = NDArray[np.float64]

THRESHOLD: float = _core.MetricsSettings().settling_threshold
"""[px], of the metric ``settling_time``: a larger error at the end of a run is a failure."""
DRIFT_TIME = 30.0
"""[s]: a leg that still moves so fast at the end that it would leave its stroke within this time is a failure."""
EARLY = 3.0
"""Severity of a run that completes, at most; one that ends early has more."""
_TAIL = 0.2  # the last part of a run, over which the error that remains is averaged
_DRIFT_WINDOWS = ((0.5, 0.75), (0.75, 1.0))  # parts of a run, over each of which the legs' drift is fitted


@dataclass(frozen=True, eq=False)
class Record:
    """What one run gave, as far as a diagnosis needs it."""

    outcome: str
    detail: str
    end_time: float  # of the last good sample [s]
    metrics: Mapping[str, float]
    time: Array  # (m,) [s], of the samples that there are
    error: Array  # (m,) [px], largest |feature error|
    tail_error: float  # RMS of `error` over the last fifth of the run [px]
    drift: float  # [m/s], of the fastest leg: what its last two quarters have in common
    samples: Mapping[str, Array]  # name of Result -> (m, k); empty where nobody asked for them


@dataclass(frozen=True)
class Judgement:
    """By which criteria a run failed, each as a ratio to what is allowed, and how badly in all."""

    early: bool  # it did not complete
    error: float  # error that remains, of `THRESHOLD`
    stroke: float  # largest leg travel, of the stroke
    drift: float  # of the speed that would take a leg out of its stroke within `DRIFT_TIME`
    severity: float  # 0: it did not fail

    @property
    def failed(self) -> bool:
        """Whether any criterion was missed."""
        return self.severity > 0.0


def make_record(
    outcome: str,
    detail: str,
    end_time: float,
    metrics: Mapping[str, float],
    time: Array,
    samples: Mapping[str, Array],
    *,
    keep: bool,
) -> Record:
    """Make a record of a run's samples; `keep` keeps them."""
    error = np.abs(samples["feature_error"]).max(axis=1)
    tail = error[time >= (1.0 - _TAIL) * end_time]
    return Record(
        outcome,
        detail,
        end_time,
        metrics,
        time,
        error,
        float(np.sqrt(np.mean(tail**2))) if len(tail) else float(error[-1]),
        _drift(time, samples["leg_lengths"], end_time),
        samples if keep else {},
    )


def _drift(time: Array, lengths: Array, end_time: float) -> float:
    """Return the speed of the fastest leg [m/s] that goes on: noise makes a leg wander, but seldom twice the same way.

    A straight line is laid through the leg lengths (m, 6) of each of two windows, in the least squares. Of slopes with
    the same sign the smaller one counts, of others none.
    """
    slopes = []
    for begin, end in _DRIFT_WINDOWS:
        window = (time >= begin * end_time) & (time <= end * end_time)
        if window.sum() < 4:
            return 0.0
        centred, travel = time[window] - time[window].mean(), lengths[window] - lengths[window].mean(axis=0)
        slopes.append(centred @ travel / (centred @ centred))
    first, second = slopes
    return float(np.where(first * second > 0.0, np.minimum(np.abs(first), np.abs(second)), 0.0).max())


def judge(record: Record, stroke: float, duration: float) -> Judgement:
    """Judge a run.

    The severity of a run that completes is the sum of the decades by which it exceeds what is allowed, at most
    `EARLY`; that of one that ends early is `EARLY` and the share of the time that it did not run.

    Parameters
    ----------
    record
        Of the run.
    stroke
        Of a leg, each way [m].
    duration
        That the run should have had [s].
    """
    early = record.outcome != "completed"
    remaining = max(record.metrics["final_error"], record.tail_error) / THRESHOLD
    travel = record.metrics["peak_leg_excursion"] / stroke
    drift = record.drift * DRIFT_TIME / stroke
    if early:
        severity = EARLY + 1.0 - record.end_time / duration
    else:
        severity = min(EARLY, sum(max(0.0, math.log10(max(ratio, 1e-300))) for ratio in (remaining, travel, drift)))
    return Judgement(early, remaining, travel, drift, severity)
