"""The clock of the frames of a log, some of which may be overwritten: a line has the newest of those that arrived."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.identification.frame_clock import clock, frame_numbers, order_of, scatter_about, share_of
from hexservo.findings.identification.interval import Interval
from hexservo.findings.identification.log import Frames
from hexservo.scenario.arrays import Array

_SHORTER = 0.98  # of a tick, most that the period of a camera is whose frames pass for one in each line, with jitter
_ONE_EACH = 0.99  # share of the frames that have a separate line, in a log that has one frame in each
_POLLED = 0.9  # order of phases at ticks from which on frames are asked for at ticks, whatever the camera does
_SPREAD = 0.1  # of a period, RMS, that frames are off its line by at least if they are of a shorter one
_CLOSER = 0.5  # of that distance, most that they are off the line of the shorter one
_RARE = 0.005  # share of the frames at either end of their arrivals about a line
_KEPT = 0.5  # share of the frames that no other replaces, which are in the log if its clock is theirs


@dataclass(frozen=True)
class FrameClock:
    """When a camera takes frames, and how many of them a log lacks."""

    period: Interval  # [s]
    dropout: Interval  # share of the frames that did not arrive
    overwritten: int = 0  # frames that arrived after a line of the log, and before another frame of the next line


def clock_of_overwritten(frames: Frames, ticks: Array) -> FrameClock | None:
    """Return the clock of the frames of a log, or None where they have no common period.

    A camera that is faster than the lines of a log has frames that no line has, since each has the newest. They are
    missing by a pattern, as every sixth one of 60 Hz at 50 lines a second, and the others pass for frames of one period
    a line with jitter. A shorter period counts where they are at most half as far from its line, and where the frames
    are there that are the newest of a line by it.

    Parameters
    ----------
    frames
        That arrived.
    ticks
        (n,) times of the log's lines [s].
    """
    times = frames.arrival if frames.exposure is None else frames.exposure
    found = clock(times, ticks)
    usual = None if found is None else FrameClock(*found)
    tick = float(ticks[-1] - ticks[0]) / (len(ticks) - 1)
    lines = np.searchsorted(ticks, frames.arrival)
    one_each = len(np.unique(lines)) >= _ONE_EACH * len(lines)
    if not one_each or len(np.unique(times)) < len(times) or order_of(times - ticks[0], tick) > _POLLED:
        return usual
    order = np.argsort(times)
    times, arrival = times[order], frames.arrival[order]
    off = np.inf if found is None else scatter_about(times, found[0].value)
    if found is not None and (found[0].value < _SHORTER * tick or off < _SPREAD * found[0].value):
        return _without_overwritten(found[0], times, arrival, ticks) or usual
    below = _SHORTER * tick
    while (shorter := clock(times, ticks, below)) is not None:
        known = _without_overwritten(shorter[0], times, arrival, ticks)
        closer = scatter_about(times, shorter[0].value) <= _CLOSER * off
        if closer and known is not None and known.dropout.value < 1.0 - _KEPT:
            return known
        below = _SHORTER * shorter[0].value  # a multiple of the period has an order of the frames, too
    return usual


def _without_overwritten(period: Interval, times: Array, arrival: Array, ticks: Array) -> FrameClock | None:
    """Return the clock of a period; its dropout is that of frames which are the newest of a line, however they jitter.

    None where jitter leaves none of these.

    Parameters
    ----------
    period
        Of the camera [s].
    times, arrival
        (m,) of the frames, in the order of the former [s].
    ticks
        (n,) times of the log's lines [s].
    """
    numbers = frame_numbers(times, period.value)
    every = np.arange(numbers[0], numbers[-1])
    slope, start = np.polyfit(numbers, arrival - arrival[0], 1)
    early, late = np.quantile(arrival - arrival[0] - slope * numbers - start, [_RARE, 1.0 - _RARE])
    expected = arrival[0] + start + slope * every
    newest = np.searchsorted(ticks, expected + late) < np.searchsorted(ticks, expected + slope + early)
    if not newest.any():
        return None
    lost = newest & ~np.isin(every, numbers)
    dropout = share_of(int(lost.sum()), int(newest.sum()))
    came = round((1.0 - dropout.value) * (len(every) + 1))
    return FrameClock(period, dropout, max(came - len(times), 0))
