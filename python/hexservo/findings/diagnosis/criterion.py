"""Criterion of failure, and its severity as one number, to compare runs before and after a change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hexservo.run.metrics import is_settled
from hexservo.scenario.arrays import Array

DRIFT_TIME = 30.0
"""[s]: a leg that still moves so fast at the end that it would leave its stroke within this time is a failure."""
_DECADES = 3.0  # of what is allowed, over which the severity of a kind of failure grows
_CURED = 0.5  # of the error that is allowed: below it nothing is left of a failure
_JUST_OUTSIDE = math.nextafter(1.0, 2.0)  # of the band: least error of a run that is not settled
_DRIFT_WINDOWS = ((0.5, 0.75), (0.75, 1.0))  # parts of a run, over each of which the legs' drift is fitted
_DRIFT_BLOCKS = 6  # parts of the last half: a leg that drifts goes the same way from each to the next


@dataclass(frozen=True, eq=False)
class Record:
    """Data of one run that a diagnosis needs."""

    outcome: str
    detail: str
    end_time: float  # of the last good sample [s]
    stop_time: float  # of the end [s], as Result.stop_time
    stopped_by: str  # kind of the leg's limit that ended it; "": none did
    metrics: Mapping[str, float]
    time: Array  # (m,) [s], of the samples that there are
    error: Array  # (m,) [px], largest |feature error|
    drift: float  # [m/s], of the fastest leg: what its last two quarters have in common; 0 behind a moving target
    samples: Mapping[str, Array]  # name of Result -> (m, k); empty where they were not asked for

    @property
    def settled(self) -> bool:
        """Whether the run completed and has a settling time: docs/model.md, section 8."""
        return bool(is_settled(self.outcome, self.metrics["settling_time"]))

    def remaining(self, dwell: float) -> float:
        """Return the largest error within the dwell time before the end [px]."""
        last = self.error[self.time > self.end_time - dwell * (1.0 - 1e-9)]
        return float(max(last.max(initial=0.0), self.metrics["final_error"]))


@dataclass(frozen=True)
class Allowed:
    """Limits within which a run passes."""

    band: float  # of the metrics [px]
    dwell: float  # of the metrics [s]
    stroke: float  # of a leg, each way [m]
    duration: float  # that the run should have [s]
    stroke_counts: bool = True  # False: a leg beyond the stroke or a limit is no failure; drift still is
    limits: Mapping[str, float] = field(default_factory=dict)  # of speed and joints [m/s; rad], by their metric


@dataclass(frozen=True)
class Judgement:
    """Criteria of a run, each relative to its limit, and their severity."""

    early: bool  # it did not complete
    settled: bool  # by the metrics
    error: float  # largest one within the dwell time before the end, of the band
    stroke: float  # largest leg travel, of the stroke
    drift: float  # of the speed that would take a leg out of its stroke within `DRIFT_TIME`
    limits: Mapping[str, float]  # speed and tilts of the legs, of their limits, by metric; empty without limits
    failed: bool
    severity: float  # 0: nothing is left of a failure
    cured: float  # share of the allowed error from which on it counts in the severity

    @property
    def symptoms(self) -> tuple[str, ...]:
        """Metrics that are beyond what is allowed; of a run that ended early none stands for itself."""
        errors = () if self.settled else ("settling_time", "final_error", "rms_error")
        travel = ("peak_leg_excursion",) if self.stroke > 1.0 else ()
        return (*errors, *travel, *(metric for metric, ratio in self.limits.items() if ratio > 1.0))

    @property
    def legs(self) -> float:
        """Largest of what the legs do, of what is allowed: travel, drift, speed and tilts."""
        return max(self.stroke, self.drift, *self.limits.values())


def make_record(
    outcome: str,
    detail: str,
    end_time: float,
    stop_time: float,
    stopped_by: str,
    metrics: Mapping[str, float],
    time: Array,
    samples: Mapping[str, Array],
    displacement: Array,
    *,
    keep: bool,
) -> Record:
    """Make a record of a run's samples; `keep` keeps them.

    Where the target goes on in one direction, by its displacement in B (m, 3) [m], legs that follow it do not drift.
    """
    error = np.abs(samples["feature_error"]).max(axis=1)
    follows = _drift(time, displacement, end_time) > 0.0
    return Record(
        outcome,
        detail,
        end_time,
        stop_time,
        stopped_by,
        metrics,
        time,
        error,
        0.0 if follows else _drift(time, samples["leg_lengths"], end_time),
        samples if keep else {},
    )


def _drift(time: Array, lengths: Array, end_time: float) -> float:
    """Return the largest persistent speed of lengths (m, k) [m/s]; noise makes a leg wander, but not steadily.

    A straight line is laid through the lengths of each of two windows, in the least squares. Of slopes with
    the same sign the smaller one counts, of others none; and only of legs whose mean lengths over the blocks of the
    last half of the run rise or fall throughout. A random walk does that once in 9 times, white noise once in 360.
    """
    half = time >= _DRIFT_WINDOWS[0][0] * end_time
    if half.sum() < 2 * _DRIFT_BLOCKS:
        return 0.0
    means = np.stack([block.mean(axis=0) for block in np.array_split(lengths[half], _DRIFT_BLOCKS)])
    one_way = (np.abs(np.sign(np.diff(means, axis=0)).sum(axis=0)) == _DRIFT_BLOCKS - 1).astype(float)
    slopes = []
    for begin, end in _DRIFT_WINDOWS:
        window = (time >= begin * end_time) & (time <= end * end_time)
        centred, travel = time[window] - time[window].mean(), lengths[window] - lengths[window].mean(axis=0)
        slopes.append(centred @ travel / (centred @ centred))
    first, second = slopes
    return float(np.where(first * second > 0.0, np.minimum(np.abs(first), np.abs(second)) * one_way, 0.0).max())


def judge(record: Record, allowed: Allowed, cured: float | None = None) -> Judgement:
    """Decide whether a run passes: it is settled, as the metrics define it, and its legs stay within their limits.

    The severity is at most 1 for legs that exceed their limits or drift and twice as much for a remaining error, each
    in decades, 2 in total; it is from 2 to 3 for a run that ends early, by the share of the time that it did not run.
    If the error failed, it counts from half of the band, so that a change that just passes is not a full cure.

    Parameters
    ----------
    record
        Of the run.
    allowed
        What it may do.
    cured
        From which share of the band on its error counts: `Judgement.cured` of the run that this one is compared to.
    """
    early = record.outcome != "completed"
    remaining = record.remaining(allowed.dwell) / allowed.band
    if not record.settled:  # the last sample outside may be one that is not kept
        remaining = max(remaining, _JUST_OUTSIDE)
    travel = record.metrics["peak_leg_excursion"] / allowed.stroke
    drift = record.drift * DRIFT_TIME / allowed.stroke
    if cured is None:
        cured = 1.0 if record.settled else _CURED
    limits = {metric: record.metrics[metric] / limit for metric, limit in allowed.limits.items()}
    legs = [travel, drift, *limits.values()] if allowed.stroke_counts else [drift]
    if early:
        severity = 3.0 - record.end_time / allowed.duration
    else:
        travelled = min(_DECADES, sum(map(_decades, legs)))
        severity = min(2.0, (2.0 * min(_DECADES, _decades(remaining / cured)) + travelled) / _DECADES)
    failed = not record.settled or max(legs) > 1.0
    return Judgement(early, record.settled, remaining, travel, drift, limits, failed, severity, cured)


def _decades(ratio: float) -> float:
    return max(0.0, math.log10(max(ratio, 1e-300)))
