"""Stability limits of a linear sampled loop in camera period, camera latency and gain, for any plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hexservo.findings.analysis.linear_loop import BORDER, Clock, SampledLoop
from hexservo.scenario.arrays import Array, Complex

LONGEST = 0.5
"""Periods and latencies are looked at up to this, or ten times the loop's own [s]."""
LARGEST_FACTOR = 1e3
"""Factors on the gain are looked at up to this, and down to its inverse."""

MOST_DRIFTS = 2
"""Unequal depth errors turn one or two directions of the image around; more that grow are no drift but a wrong sign."""

_MOST_FRAMES = 60  # under way at once at a loop's own clocks; more make matrices too large

_MAP_POINTS = 16  # of each axis


@dataclass(frozen=True)
class Border:
    """First stability limit in a whole number of ticks, from the scenario's own value upwards.

    Of the stable range about that value, or of the nearest one that was found.
    """

    stable: int | None  # last one found stable [ticks]; None: not even the least is
    unstable: int | None  # its neighbour that is not, or the least searched [ticks]; None: stable up to `looked_at`
    looked_at: int  # [ticks]
    least: int | None = None  # first one that is stable, where a shorter one is not [ticks]; None: none is looked for


@dataclass(frozen=True)
class Margins:
    """Stability limits and margins of a loop, for one treatment of K_v.

    Period and latency without a search are the loop's own where it is stable, with `Border.unstable` None.
    """

    stable: bool  # with the scenario's camera nothing grows but at most `MOST_DRIFTS` drifts
    radius: float  # spectral radius over one camera period, all modes but the resting ones
    rate: float  # growth of the slowest of them [1/s]; negative: it decays
    frequency: float  # of it [Hz]
    others_rate: float  # as `rate`, of the modes that are no drifts [1/s]
    others_frequency: float  # of the slowest of these [Hz]
    drifts: int  # real modes that grow with any camera, however fast
    drift_rate: float  # growth of the fastest of them, with a frame at each tick and no latency [1/s]; NaN: none
    perfect: bool  # with that camera nothing grows but at most `MOST_DRIFTS` drifts
    resting: int  # modes that stay whatever the clocks are, taken out
    period: Border  # at the scenario's latency; lower ends (`Border.least`) only where not `perfect`
    latency: Border  # at the scenario's period
    gain: tuple[float | None, float | None]  # factors at which stability changes, below and above 1; None: none
    border_frequency: float  # of the mode that crosses first, by gain upwards, latency or period [Hz]; NaN: none
    motion: Array | None  # (6,) of that mode, linear, then angular times the platform's radius; largest is 1

    @property
    def slowest(self) -> float:
        """Time constant [s] of the slowest of them, which decays or grows; infinite where it does neither."""
        return 1.0 / abs(self.rate) if self.rate else np.inf

    @property
    def has_camera(self) -> bool:
        """Whether there is a camera with which nothing grows but drifts: a perfect one, or one that was found."""
        return self.perfect or self.period.stable is not None or self.latency.stable is not None


def _drifts(loop: SampledLoop) -> tuple[int, float, bool]:
    """Count real modes that grow with a frame at each tick; the fastest growth [1/s]; whether nothing else grows."""
    perfect = Clock(1, 0)
    values = loop.multipliers(perfect)
    growing = values[np.abs(values) > BORDER]
    real = (np.abs(growing.imag) < 1e-9) & (growing.real > 0.0)
    rate = float(np.log(growing.real[real].max()) / loop.seconds(perfect)) if real.any() else float("nan")
    return int(real.sum()), rate, bool(real.all()) and len(growing) <= MOST_DRIFTS


def _without_drifts(found: Complex, allowed: int) -> Complex:
    """Leave out as many real exponents that grow as are allowed, those that grow the least."""
    growing = np.flatnonzero((np.abs(found.imag) < 1e-9) & (found.real > 0.0))
    return np.delete(found, growing[len(growing) - min(allowed, len(growing)) :])


def _holds(loop: SampledLoop, clock: Clock, allowed: int) -> bool:
    """Return whether no more modes grow than are allowed."""
    try:
        with np.errstate(over="raise", invalid="raise"):
            return loop.growing(clock) <= allowed
    except FloatingPointError:  # a mode grows beyond all numbers in one pattern
        return False


def _change(stable: Callable[[int], bool], start: int, end: int, least_step: int) -> tuple[int, int | None]:
    """Step from one whole number towards another until stability changes, then halve the last step.

    Returns the last number with the stability of the first, and its neighbour without; None: all have it.
    """
    first, here = stable(start), start
    while here != end:
        step = max(1, (here + least_step) // 8)
        there = min(here + step, end) if end > start else max(here - step, end)
        if stable(there) != first:
            break
        here = there
    else:
        return here, None
    while abs(there - here) > 1:
        middle = (here + there) // 2
        if stable(middle) == first:
            here = middle
        else:
            there = middle
    return here, there


def _first_border(
    stable: Callable[[int], bool], now: int, least: int, most: int, least_step: int, *, both: bool
) -> Border:
    """Search the stable range at a whole number, or else the nearest one below it.

    With `both` ranges above it count as well, and the lower end of the range is searched.
    """
    beyond, inside, lowest = None, now, None
    if stable(now):
        inside, beyond = _change(stable, now, most, least_step)
    else:
        beyond, below = _change(stable, now, least, least_step)
        if below is not None:
            inside = below
        else:
            _, lowest = _change(stable, now, most, least_step) if both else (now, None)
            if lowest is None:
                return Border(None, least, most if both else least)
            inside, beyond = _change(stable, lowest, most, least_step)
    if both and lowest is None:
        last, shorter = _change(stable, min(inside, now), least, least_step)
        lowest = None if shorter is None else last
    return Border(inside, beyond, most, lowest)


def gain_border(stable: Callable[[float], bool], up: bool) -> float | None:
    """Step away from the factor 1 until stability changes, then halve the step; None where it never does."""
    now = stable(1.0)
    ratio = 1.15 if up else 1.0 / 1.15
    near = 1.0
    while True:
        far = near * ratio
        if not 1.0 / LARGEST_FACTOR <= far <= LARGEST_FACTOR:
            return None
        if stable(far) != now:
            break
        near = far
    for _ in range(12):  # to 1e-5 of it
        middle = float(np.sqrt(near * far))
        if stable(middle) == now:
            near = middle
        else:
            far = middle
    return float(np.sqrt(near * far))


def exponents(loop: SampledLoop, clock: Clock) -> Complex:
    """Return growth [1/s] and frequency [rad/s] of all modes, as complex numbers, the fastest growing first."""
    values, angles = loop.modes(clock)
    growth = np.log(np.maximum(np.abs(values), 1e-300))
    return np.asarray((growth + 1j * angles) / loop.seconds(clock), dtype=complex)


def motion_of(loop: SampledLoop, clock: Clock, exponent: complex) -> Complex:
    """Return the displacement (n,) of the mode with that exponent, of length 1."""
    return loop.motion(clock, complex(np.exp(exponent * loop.seconds(clock))))


def crossing(inside: tuple[SampledLoop, Clock], outside: tuple[SampledLoop, Clock]) -> tuple[complex, complex]:
    """Return the exponent of the mode that begins to grow between two neighbours: its value inside, and outside.

    Modes that grow on both sides are set aside, each with its nearest one. Of what grows outside alone the fastest is
    taken, and inside the slowest to decay of those that turn as fast, within a tenth.
    """
    before, after = exponents(*inside), exponents(*outside)
    least = np.log(BORDER)
    grew = before.real * inside[0].seconds(inside[1]) > least
    grows = list(after[after.real * outside[0].seconds(outside[1]) > least])
    for value in before[grew]:
        if grows:
            grows.pop(int(np.argmin(np.abs(np.asarray(grows) - value))))
    if not grows:
        raise ValueError("inside, outside: expected a mode that grows outside alone, got none")
    new = max(grows, key=lambda value: float(value.real))
    stays = before[~grew]
    # The one nearest to it, or one that turns as fast and decays more slowly: pairs of axes are often nearly alike.
    old = stays[int(np.argmin(np.minimum(np.abs(stays - new), np.abs(stays - np.conj(new)))))]
    alike = stays[np.abs(np.abs(stays.imag) - abs(new.imag)) <= 0.1 * abs(new.imag)]
    if abs(new.imag) > 1e-9 and len(alike):
        old = max(old, alike[int(np.argmax(alike.real))], key=lambda value: float(value.real))
    return complex(old), complex(new)


def _sides(
    loop: SampledLoop,
    clock: Clock,
    period: Border,
    latency: Border,
    gain: tuple[float | None, float | None],
    frames: int,
) -> tuple[tuple[SampledLoop, Clock], tuple[SampledLoop, Clock]] | None:
    """Return a loop just inside and outside of a border: the one in gain, upwards first, else latency or period.

    Of latency and period only with at most so many frames under way, whose eigenvalues are computed.
    """
    for factor in (gain[1], gain[0]):
        if factor is not None:
            sides = [(replace(loop, gain=loop.gain * factor * (1.0 + part)), clock) for part in (-1e-4, 1e-4)]
            sides.sort(key=lambda side: side[0].growing(clock))
            return sides[0], sides[1]
    if latency.stable is not None and latency.unstable is not None and latency.unstable <= frames * clock.period:
        return (loop, Clock(clock.period, latency.stable)), (loop, Clock(clock.period, latency.unstable))
    if period.stable is not None and period.unstable is not None and clock.latency <= frames * period.stable:
        return (loop, Clock(period.stable, clock.latency)), (loop, Clock(period.unstable, clock.latency))
    return None


def most_frames(loop: SampledLoop) -> int:
    """Return how many frames an analysis allows in transit at once: few where the joint sensors have a period."""
    return _MOST_FRAMES if loop.reading == 1 else loop.few


def loop_margins(
    loop: SampledLoop, clock: Clock, radius: float = 1.0, *, borders: bool = True, room: int | None = None
) -> Margins:
    """Find the stability limits of a linear loop in period, latency and gain, from its own values.

    Parameters
    ----------
    loop
        Of six axes.
    clock
        The camera's.
    radius
        Of the platform [m], to compare moves with turns.
    borders
        False leaves the borders out: period and latency of what is stable are the loop's own, unstable None.
    room
        By how many ticks period and latency may be longer than the clock's in the searches; None: as far as others.

    Raises
    ------
    ValueError
        With more than `most_frames` under way at the loop's own clocks.
    """
    if clock.latency > most_frames(loop) * clock.period:
        raise ValueError(f"clock: expected at most {most_frames(loop)} frames under way, got {clock}")
    drifts, drift_rate, perfect = _drifts(loop)
    wrong = drifts > MOST_DRIFTS  # a sign, which no camera mends
    allowed = 0 if wrong else drifts
    # Growing modes cannot be counted where sensors have a period, nor where they may grow fast: determinants are then
    # all rounding.
    loop = loop if perfect else replace(loop, by_eigenvalues=True)

    @cache
    def holds(period: int, latency: int) -> bool:
        return _holds(loop, Clock(period, latency), allowed)

    def holds_at(factor: float) -> bool:
        return _holds(replace(loop, gain=loop.gain * factor), clock, allowed)

    found = exponents(loop, clock)
    slowest, other = found[0], _without_drifts(found, allowed)[0]
    stable = holds(clock.period, clock.latency)
    most = round(LONGEST / loop.tick)
    most_period, most_latency, least_period = max(most, 10 * clock.period), max(most, 10 * clock.latency), 1
    frames = loop.few
    if loop.reading > 1 or not perfect:  # clocks whose eigenvalues are computed: more frames if the loop's own has them
        frames = frames if clock.latency <= frames * clock.period else most_frames(loop)
        most_latency, least_period = min(most_latency, frames * clock.period), max(1, -(-clock.latency // frames))
    if room is not None:
        most_period, most_latency = min(most_period, clock.period + room), min(most_latency, clock.latency + room)
    none: tuple[float | None, float | None] = (None, None)
    if not borders or (wrong and not stable):
        period = Border(clock.period if stable else None, None, clock.period)
        latency, gain = Border(clock.latency if stable else None, None, clock.latency), none
    else:
        both = not perfect  # then a camera may be too fast as well
        period = _first_border(
            lambda value: holds(value, clock.latency), clock.period, least_period, most_period, 0, both=both
        )
        latency = _first_border(
            lambda value: holds(clock.period, value), clock.latency, 0, most_latency, clock.period, both=both
        )
        gain = (gain_border(holds_at, up=False), gain_border(holds_at, up=True))

    frequency, motion = float("nan"), None
    sides = _sides(loop, clock, period, latency, gain, frames) if borders else None
    if sides is not None:
        _, new = crossing(*sides)
        frequency = abs(new.imag) / (2.0 * np.pi)
        sizes = np.abs(motion_of(*sides[1], new)) * np.repeat([1.0, radius], 3)
        motion = sizes / max(float(sizes.max()), 1e-300)
    return Margins(
        stable=stable,
        radius=float(np.exp(slowest.real * clock.period * loop.tick)),
        rate=float(slowest.real),
        frequency=float(abs(slowest.imag) / (2.0 * np.pi)),
        others_rate=float(other.real),
        others_frequency=float(abs(other.imag) / (2.0 * np.pi)),
        drifts=drifts,
        drift_rate=drift_rate,
        perfect=perfect,
        resting=loop.resting.shape[1],
        period=period,
        latency=latency,
        gain=gain,
        border_frequency=frequency,
        motion=motion,
    )


def radius_map(loop: SampledLoop, clock: Clock, found: Margins) -> tuple[Array, Array, Array]:
    """Return the spectral radius over periods (m,) and latencies (k,) [s] that include the stability limits, (k, m).

    NaN where more than `SampledLoop.few` frames are under way.
    """

    def up_to(border: Border, own: int) -> int:
        edge = border.unstable if border.unstable is not None else (border.stable or 0)
        if border.unstable is None:  # no border: four times what the scenario has
            edge = min(edge, 4 * max(own, clock.period))
        return max(round(1.5 * max(edge, own)), 8)

    most_period, most_latency = up_to(found.period, clock.period), up_to(found.latency, clock.latency)
    periods = np.linspace(most_period / _MAP_POINTS, most_period, _MAP_POINTS).round().astype(int)
    periods = np.unique(np.maximum(periods, 1))
    latencies = np.unique(np.linspace(0, most_latency, _MAP_POINTS).round().astype(int))
    radii = np.full((len(latencies), len(periods)), np.nan)
    for row, latency in enumerate(latencies):
        for column, period in enumerate(periods):
            if latency <= loop.few * period:
                at = Clock(int(period), int(latency))
                value = abs(loop.multipliers(at)[found.drifts])
                radii[row, column] = value ** (period * loop.tick / loop.seconds(at))
    return periods * loop.tick, latencies * loop.tick, radii
