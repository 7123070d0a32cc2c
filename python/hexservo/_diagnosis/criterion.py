"""When a run counts as failed, and by how much: one number that runs before and after a change can be compared by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexservo import _core

__all__ = ["DRIFT_TIME", "THRESHOLD", "Judgement", "Record", "judge", "make_record"]

Array = NDArray[np.float64]

THRESHOLD: float = _core.MetricsSettings().band
"""[px], of the metric ``settling_time``: a larger error at the end of a run is a failure."""
DRIFT_TIME = 30.0
"""[s]: a leg that still moves so fast at the end that it would leave its stroke within this time is a failure."""
_DECADES = 3.0  # of what is allowed, over which the severity of a kind of failure grows
_CURED = 0.5  # of the error that is allowed: below it nothing is left of a failure
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
    failed: bool
    severity: float  # 0: nothing is left of a failure
    cured: float  # share of the allowed error from which on it counts in the severity


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


def judge(
    record: Record, stroke: float, duration: float, *, stroke_counts: bool = True, cured: float | None = None
) -> Judgement:
    """Judge a run.

    The severity says how much of the task was missed: up to 1 for legs that leave their stroke or drift, and twice as
    much for an error that remains, each by decades, 2 in all; from 2 to 3 for a run that ends early, by the share of
    the time that it did not run. Where the error failed it counts from half of what is allowed, so that a change that
    just passes has not cured it.

    Parameters
    ----------
    record
        Of the run.
    stroke
        Of a leg, each way [m].
    duration
        That the run should have had [s].
    stroke_counts
        False: a leg beyond the stroke is no failure; drift still is.
    cured
        From which share of the allowed error on it counts: `Judgement.cured` of the run that this one is compared to.
    """
    early = record.outcome != "completed"
    remaining = max(record.metrics["final_error"], record.tail_error) / THRESHOLD
    travel = record.metrics["peak_leg_excursion"] / stroke
    drift = record.drift * DRIFT_TIME / stroke
    if cured is None:
        cured = _CURED if early or remaining > 1.0 else 1.0
    legs = [travel, drift] if stroke_counts else [drift]
    if early:
        severity = 3.0 - record.end_time / duration
    else:
        travelled = min(_DECADES, sum(map(_decades, legs)))
        severity = min(2.0, (2.0 * min(_DECADES, _decades(remaining / cured)) + travelled) / _DECADES)
    return Judgement(early, remaining, travel, drift, early or max(remaining, *legs) > 1.0, severity, cured)


def _decades(ratio: float) -> float:
    return max(0.0, math.log10(max(ratio, 1e-300)))
