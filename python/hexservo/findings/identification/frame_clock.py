"""The clock of a camera: its period, and the share of its frames that did not arrive, from the times of the others.

Frames are 1/f apart, up to jitter, with gaps where some are lost: their phases f t are then alike, however many are
lost. The lowest frequency at which they are is that of the camera, since twice it is one as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import binomtest

from hexservo.findings.identification.interval import LEVEL, Interval, correlated
from hexservo.findings.identification.rounding import grid_of
from hexservo.scenario.arrays import Array

_MOST_LOST = 0.9  # share of the frames
_BAND = 1.2  # ratio of the ends of the bands of frequencies that are searched one after the other
_MARGIN = 0.95  # of the frequency of frames of which none is lost: jitter of the first and of the last
_PER_LOBE = 4  # frequencies that are tried in 1/duration
_FIRST = 500  # frames from which the period is found at first; with it the others are numbered
_ROUNDS = 20  # of numbering the frames by a line
_CHANCE = 0.01  # that phases without any order pass for alike at any of the frequencies
_MOST_SCATTER = 0.25  # of a period, RMS about the line; phases without any order have 1/sqrt(12)

_MOST_OF_TICK = 0.75  # of a period, that a tick is: frames that are exactly one period apart are not rounded
_DITHERED = 1.5  # ticks of spread, beyond which jitter makes rounding random
_SAME = 1e-6  # of a tick
_RESOLVED = 1e-6  # of the periods that are searched


def clock(times: Array, ticks: Array | None = None, below: float = np.inf) -> tuple[Interval, Interval] | None:
    """Return the period of frames [s] and the share of them that is missing, both with 95 % intervals.

    The line through the times of numbered frames gives the period, and the gaps in the numbers the missing frames, with
    the interval of Clopper and Pearson.

    Parameters
    ----------
    times
        (m,) of exposure or arrival [s], in any order.
    ticks
        (n,) times of the log's ticks [s]. Frames that all have times of ticks are known no better than to a tick: if
        their period is a whole number of them, the times alone do not show that they are rounded.
    below
        Periods that are longer are not searched [s].

    Returns
    -------
    tuple of Interval, or None
        None where the frames have no common period: by jitter that is as long as the period, or by a rate that changes.
    """
    distinct = np.unique(times)  # frames that a program had at once are one moment, and no order of their phases
    if len(distinct) < 3:
        return None
    span = float(distinct[-1] - distinct[0])
    lowest = _MARGIN * (len(distinct) - 1) / span
    low, highest = max(lowest, 1.0 / below), (len(distinct) - 1) / span / (1.0 - _MOST_LOST)
    while low < highest:
        period = _period_between(distinct, low, _BAND * low)
        if period is not None:
            return (
                None
                if _is_harmonic(distinct, period, max(lowest, 1.0 / below))
                else _line(np.sort(times), period, _tick_of(times, ticks))
            )
        low *= _BAND
    return None


def _is_harmonic(times: Array, period: float, lowest: float) -> bool:
    """Return whether a multiple of the period is one as well, which was not found because of its jitter."""
    multiples = range(2, int(1.0 / (period * lowest)) + 1)
    return any(len(times) * order_of(times, many * period) ** 2 > -np.log(_CHANCE) for many in multiples)


def _period_between(times: Array, low: float, high: float) -> float | None:
    """Return the period of the frames with a frequency near to a band [Hz]; None where their phases are not alike."""
    count = min(_FIRST, len(times))
    some = times[:count] - times[0]
    lobe = 1.0 / some[-1]  # beyond the band: one that peaks there is not taken for its slope within
    tried = np.arange(low, high + 3 * lobe, lobe / _PER_LOBE)
    order = np.array([order_of(some, 1.0 / frequency) for frequency in tried])
    period = 1.0 / float(tried[int(np.argmax(order))])
    while True:  # by_chance: Rayleigh's test, for as many frequencies as all bands have
        period = _refined(times[:count], period)
        scatter = scatter_about(times[:count], period)
        by_chance = _PER_LOBE * count / (1.0 - _MOST_LOST) * np.exp(-count * order_of(times[:count], period) ** 2)
        if scatter > _MOST_SCATTER * period or by_chance > _CHANCE:
            return None
        if count == len(times):
            return period
        count = min(2 * count, len(times))


def order_of(times: Array, period: float) -> float:
    """Return how alike the phases are: 1 if all are the same, about 1/sqrt(m) if they have no order."""
    return float(abs(np.exp(2j * np.pi * times / period).mean()))


def frame_numbers(times: Array, period: float) -> Array:
    """Return the number of each frame of a period: the middle of their phases belongs to a whole number."""
    phase = float(np.angle(np.exp(2j * np.pi * (times - times[0]) / period).mean())) / (2 * np.pi)
    return np.asarray(np.rint((times - times[0]) / period - phase))


def _refined(times: Array, period: float) -> float:
    """Return the period of the line through the frames, numbered by it."""
    numbers = frame_numbers(times, period)
    for _ in range(_ROUNDS):
        if numbers[-1] == numbers[0]:
            break
        period = float(np.polyfit(numbers, times - times[0], 1)[0])
        before, numbers = numbers, frame_numbers(times, period)
        if (numbers == before).all():
            break
    return period


def scatter_about(times: Array, period: float) -> float:
    """Return the RMS distance [s] of frames from the line that numbers them."""
    left = times - times[0] - period * frame_numbers(times, period)
    return float(np.std(left))


def _line(times: Array, period: float, tick: float) -> tuple[Interval, Interval]:
    numbers = frame_numbers(times, period)
    slope, start = np.polyfit(numbers, times - times[0], 1)
    left = times - times[0] - slope * numbers - start
    variance = correlated(left) * float(left @ left) / (len(times) - 2)
    found = Interval.around(float(slope), float(np.sqrt(variance / ((numbers - numbers.mean()) ** 2).sum())))
    rounded = _of_rounding(numbers, times - times[0], found.value, tick)
    found = replace(found, low=min(found.low, rounded[0]), high=max(found.high, rounded[1]))
    taken = max(int(numbers[-1] - numbers[0]) + 1, len(times))
    return found, share_of(taken - len(times), taken)


def share_of(lost: int, taken: int) -> Interval:
    """Return a share of frames with the interval of Clopper and Pearson."""
    ends = binomtest(lost, taken).proportion_ci(LEVEL, method="exact")
    return Interval(lost / taken, float(ends.low), float(ends.high))


def _tick_of(times: Array, ticks: Array | None) -> float:
    """Return the time between the ticks of a log if all frames have times of these; else 0."""
    if ticks is None:
        return 0.0
    tick = float(ticks[-1] - ticks[0]) / (len(ticks) - 1)
    nearest = ticks[np.clip(np.rint((times - ticks[0]) / tick).astype(int), 0, len(ticks) - 1)]
    return tick if float(np.abs(times - nearest).max()) < _SAME * tick else 0.0


def _of_rounding(numbers: Array, times: Array, period: float, tick: float) -> tuple[float, float]:
    """Return the periods [s] between which numbered frames fit times that are rounded to ticks; else that of the line.

    A tick of 0 is not known: it is then the step of the times, if they have one that is shorter than the period.

    Where ticks and frames beat slowly, rounding has an order that is not seen as a correlation of successive frames.
    But it stays within one tick, and so does the spread of the times about the right line. With a jitter of less than
    half a tick, this is within one and a half; a longer one makes rounding random.
    """
    if tick == 0.0:
        tick = grid_of(times)
        if not 0.0 < tick < _MOST_OF_TICK * period:
            return period, period

    def spread(tried: float) -> float:
        return float(np.ptp(times - tried * numbers))

    widest = 2.0 * _DITHERED * tick / float(np.ptp(numbers))
    ends, resolved = (period - widest, period + widest), _RESOLVED * widest
    best = float(minimize_scalar(spread, bounds=ends, method="bounded", options={"xatol": resolved}).x)
    if spread(best) > _DITHERED * tick:
        return period, period
    most = tick * (1.0 + _SAME) if spread(best) <= tick else _DITHERED * tick
    low, high = (float(brentq(lambda tried: spread(tried) - most, best, end, xtol=resolved)) for end in ends)
    return low, high
