"""Least-squares fits of one leg's drive: its response to the commands of a log, with some of its values free.

A delay is any number of ticks. The drive does not change with time: with a delay of n + f ticks it moves as with n
ticks, f ticks later, and that motion is smooth within a tick of its commands.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from hexservo import _core
from hexservo.findings.identification.interval import Interval, correlated, deviations, half_width
from hexservo.findings.identification.log import leg_moves, predicted_share
from hexservo.findings.identification.rests import Rests
from hexservo.scenario.arrays import Array, Mask

MOST_DELAY = _core.MAX_ACTUATOR_DELAY  # [ticks]
"""Most ticks of delay, as `actuators.delay` has it."""
FINER = 8
"""Parts of a tick, each in the core's steps: of fits whose delay is no whole number, and of those with limits."""

BANDWIDTH, DAMPING, SPEED, ACCELERATION, _PLACE, _RATE, _BEFORE, OFFSET, DELAY = range(9)  # of the values of a response

_BANDWIDTHS = 9  # of a coarse grid, from 1/400 of the fastest that ticks show
_DAMPINGS = (0.35, 0.8, 1.6)
_SLOWEST, _FASTEST = 0.05, 0.6  # bandwidths that are searched: times the record, and times a tick
_LEAST_DAMPED, _MOST_DAMPED = 0.01, 50.0
_EDGE = 1.001  # ratio to an end of what is searched that is no different from it
_WORTH = 10.0  # of the criterion by Bayes: what a limit must gain to count
_NODES = 6  # of the polynomial between parts of a tick
_DECIMALS = 4  # of a delay [ticks]
_AT_END = 1e-3  # of a tick from `MOST_DELAY`: no different from it


@dataclass(frozen=True, eq=False)
class LegRecord:
    """One leg in a log."""

    commands: Array  # (n,), with what friction makes of them
    joints: Array  # (n,)
    period: float
    fitted: int  # ticks that are fitted
    fresh: Mask  # (n,) at which the joint was read: other readings are repeated, and do not count
    rests: Rests | None = None
    shifted: float = 0.0  # what is taken out of the commands before: the fit's offset is from these [m; rad]

    @property
    def moves(self) -> bool:
        """Whether the leg moves in what is fitted."""
        return leg_moves(self.commands[self.fresh], self.joints[self.fresh], slice(len(self.measured)))

    @property
    def measured(self) -> Array:
        """The readings that are fitted, (m,) [m; rad]."""
        return self.read(self.joints[: self.fitted])

    def read(self, coordinates: Array) -> Array:
        """Return those of coordinates at the first ticks, (k,), that belong to readings that count."""
        return coordinates[self.fresh[: len(coordinates)]]

    def explained(self, predicted: Array) -> float | None:
        """Return the share of the motion that is predicted (n,) where nothing is fitted; None without motion there."""
        apart, fresh = slice(len(self.measured), None), self.fresh
        return predicted_share(self.commands[fresh], self.joints[fresh], predicted[fresh][apart], apart)

    def response(self, values: Array, base: int | None = None, ticks: int | None = None, finer: int = 1) -> Array:
        """Return the reading at each tick, (n,), or at the first ones alone, or at `finer` equal steps in each tick.

        Parameters
        ----------
        values
            (9,): bandwidth [Hz], damping, speed and acceleration limit; place and rate at the start; the command that
            was given before the log; what the reading is beyond the coordinate; delay [ticks].
        base
            Whole delay, from which the delay is one tick at most: the start is then 1 - (delay - base) ticks before the
            first one. None: the delay is whole, and the start is the first tick.
        ticks
            How many.
        finer
            Steps.
        """
        count = len(self.commands) if ticks is None else ticks
        if base is None:
            delay = int(values[DELAY])
            commands = np.concatenate([np.full(delay, values[_BEFORE]), self.commands[: max(0, count - delay)]])[:count]
            return np.asarray(self._driven(values, commands, finer) + values[OFFSET])
        commands = np.concatenate([np.full(base + 1, values[_BEFORE]), self.commands])
        commands = np.pad(commands, (0, 3), mode="edge")[: count + 3]
        driven, found = self._driven(values, commands, FINER), np.empty(count * finer)
        for step in range(finer):
            tick, part = divmod(1.0 - (values[DELAY] - base) + step / finer, 1.0)
            first, weights = _between(FINER * part)
            first += FINER * int(tick)
            parts = [driven[first + node :: FINER][:count] for node in range(_NODES)]
            found[step::finer] = weights @ np.stack(parts)
        return np.asarray(found + values[OFFSET])

    def _driven(self, values: Array, commands: Array, finer: int) -> Array:
        bandwidth, damping, speed, acceleration, place, rate = values[: _RATE + 1]
        return _core.drive_response(
            np.repeat(commands, finer), place, rate, self.period / finer, bandwidth, damping, speed, acceleration
        )


def _between(place: float) -> tuple[int, Array]:
    """Return the first of the nodes 0 to `FINER` that a polynomial to a place between them takes, and their weights."""
    first = int(np.clip(np.floor(place) - _NODES // 2 + 1, 0, FINER + 1 - _NODES))
    nodes, x = np.arange(_NODES), place - first
    weights = [np.prod([(x - other) / (node - other) for other in nodes if other != node]) for node in nodes]
    return first, np.array(weights)


@dataclass(frozen=True, eq=False)
class Model:
    """A least-squares fit with limits that may act, and with a given delay or one about it."""

    base: int | None  # whole delay that the fitted one is about [ticks]; None of a delay that was given
    limits: tuple[bool, bool]  # of speed and acceleration
    values: Array  # (9,) see `LegRecord.response`
    free: Mask  # (9,) which of them were fitted
    sigma: Array  # (f,) standard deviations of those: of the logarithms of the first four
    sigma_of_lag: float  # of the logarithm of 2 zeta/omega
    squares: float  # sum of the residuals' squares
    count: int  # residuals
    correlated: float
    motion: float  # standard deviation of what was measured
    searched: Array  # (4, 2) least and largest of the first four values that were searched

    @property
    def whole(self) -> int:
        """The delay in whole ticks."""
        return round(float(self.values[DELAY]))

    @property
    def delay(self) -> Interval:
        """The confidence interval of the delay [ticks], none below 0; no upper end at `MOST_DELAY`."""
        value, sigma = float(self.values[DELAY]), self._sigma(DELAY)
        low, high = value - half_width(sigma), value + half_width(sigma)
        if value > MOST_DELAY - _AT_END:
            return Interval(float(MOST_DELAY), round(max(min(low, MOST_DELAY), 0.0), _DECIMALS), np.inf)
        value, low, high = (round(max(one, 0.0), _DECIMALS) for one in (value, low, high))
        return Interval(value, low, np.inf if high >= MOST_DELAY else high)

    @property
    def offset(self) -> Interval:
        """The confidence interval of what the reading is beyond the coordinate [m; rad]."""
        return Interval.around(float(self.values[OFFSET]), self._sigma(OFFSET))

    def _sigma(self, index: int) -> float:
        """Return the standard deviation of a value, 0 of one that was given."""
        return float(self.sigma[int(self.free[:index].sum())]) if self.free[index] else 0.0

    @property
    def noise(self) -> float:
        """Standard deviation of what the fit leaves [m; rad]."""
        return float(np.sqrt(self.squares / (self.count - self.free.sum())))

    @property
    def clarity(self) -> float:
        """How much larger the motion is than what the fit leaves."""
        return self.motion / self.noise

    @property
    def effective(self) -> float:
        """How many independent residuals there are."""
        return self.count / self.correlated

    def criterion(self, effective: float) -> float:
        """Return Bayes' information criterion for so many independent residuals, and what a limit must gain."""
        price = np.log(effective) * self.free.sum() + _WORTH * sum(self.limits)
        return float(effective * np.log(self.squares / self.count) + price)

    def interval(self, index: int) -> Interval:
        """Return the confidence interval of one of the first four values."""
        found = Interval.of_logarithm(float(self.values[index]), self._sigma(index))
        return found.opened(*self._within(index))

    @property
    def lag(self) -> Interval:
        """The confidence interval of 2 zeta/omega [s].

        At an edge of what is searched nothing is known of it, but of a leg with a slow pole: there any bandwidth from
        some on, with the damping that keeps the lag, is the same response.
        """
        bandwidth, damping = (float(value) for value in self.values[:2])
        found = Interval.of_logarithm(damping / (np.pi * bandwidth), self.sigma_of_lag)
        return Interval(found.value, -np.inf, np.inf) if self.at_edge else found

    @property
    def at_edge(self) -> bool:
        """Whether bandwidth or damping is at an end of what is searched, without a slow pole."""
        inside = all(low < self.values[index] < high for index in (0, 1) for low, high in [self._within(index)])
        return not inside and float(self.values[1]) <= 1.0

    def _within(self, index: int) -> tuple[float, float]:
        """Return the ends of what is searched, but for rounding."""
        lowest, highest = self.searched[index]
        return _EDGE * lowest, highest / _EDGE


def fit_model(
    record: LegRecord,
    start: Array,
    limits: tuple[bool, bool],
    delays: tuple[int, int] | None = None,
    finer: int = 1,
) -> Model:
    """Fit the values of a leg's response.

    Parameters
    ----------
    record
        The leg.
    start
        (9,) values that the fit begins with.
    limits
        Of speed and acceleration: which act.
    delays
        Ends of the delays that are searched [ticks], at most one tick from that of the start; None: it is given.
    finer
        Parts of a tick, each in the core's steps, with a delay that is given.
    """
    measured = record.measured
    base = None if delays is None else round(float(start[DELAY]))
    searching = delays is not None
    free = np.array([True, True, *limits, True, True, searching or start[DELAY] > 0, True, searching])
    values = start.copy()
    values[2:4] = np.where(limits, values[2:4], np.inf)
    scale = max(float(np.ptp(measured)), np.finfo(float).tiny)

    slow, fast = _SLOWEST / (record.fitted * record.period), _FASTEST / record.period
    searched = np.array([[slow, fast], [_LEAST_DAMPED, _MOST_DAMPED], [1e-12, 1e12], [1e-12, 1e12]])
    lowest, highest = np.log(searched).T

    units = np.array([scale, scale / record.period, scale, scale, 1.0])

    def unpacked(x: Array) -> Array:
        found = values.copy()
        found[free] = x
        found[:4] = np.where(free[:4], np.exp(np.where(free[:4], found[:4], 0.0)), values[:4])
        found[4:] = np.where(free[4:], found[4:] * units, values[4:])
        return found

    def residuals(x: Array) -> Array:
        response = record.response(unpacked(x), base, record.fitted, finer if base is None else 1)
        left = record.read(response[:: finer if base is None else 1]) - measured
        return np.where(np.isfinite(left), left, 1e3 * scale) / scale

    logs = np.clip(np.log(np.maximum(values[:4][free[:4]], 1e-12)), lowest[free[:4]], highest[free[:4]])
    first = np.concatenate([logs, (values[4:] / units)[free[4:]]])
    edges = np.full((2, 5), np.inf)
    if base is not None and delays is not None:
        edges[:, -1] = -max(base - 1, delays[0]), min(base + 1, delays[1])
    bounds = [np.r_[lowest[free[:4]], -edges[0, free[4:]]], np.r_[highest[free[:4]], edges[1, free[4:]]]]
    fit = least_squares(residuals, first, bounds=bounds, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=60)
    left = fit.fun * scale
    largest = max(float(np.abs(measured).max()), float(np.abs(record.commands).max()))
    floor = len(left) * (8 * np.finfo(float).eps * largest) ** 2  # of rounding
    together = correlated(left)
    independent = len(left) / together
    by_lag = fit.jac.copy()
    by_lag[:, 0] += by_lag[:, 1]  # by the bandwidth with the lag held: the next column is then by the lag
    return Model(
        base,
        limits,
        unpacked(fit.x),
        free,
        deviations(fit.jac, fit.fun, independent) * np.r_[np.ones(4), units][free],
        float(deviations(by_lag, fit.fun, independent)[1]),
        float(left @ left) + floor,
        len(left),
        together,
        float(np.std(measured)),
        searched,
    )


def starts(record: LegRecord, delay: int, limits: tuple[float, float]) -> list[Array]:
    """Return the values of a coarse grid with a delay and limits, those first that explain the record best."""
    measured = record.measured
    fastest = 0.4 / record.period
    tried = []
    for bandwidth, damping in product(np.geomspace(fastest / 400.0, fastest, _BANDWIDTHS), _DAMPINGS):
        values = np.array([bandwidth, damping, *limits, measured[0], 0.0, record.commands[0], 0.0, delay])
        left = record.read(record.response(values, ticks=record.fitted)) - measured
        values[OFFSET] = -left.mean()
        values[_PLACE] -= values[OFFSET]
        left -= left.mean()
        tried.append((float(left @ left), values))
    return [values for _, values in sorted(tried, key=lambda one: one[0])]
