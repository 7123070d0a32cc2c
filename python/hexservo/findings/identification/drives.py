"""What the drives of a machine that takes positions do: bandwidth, damping, delay and limits of each leg from a log.

Output error: the response of docs/model.md, section 7, by the core, is fitted to the measured coordinates from the
commands alone, by least squares on the first part of the record. The rest is predicted, without a new start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from hexservo import _core
from hexservo.findings.identification.interval import LEVEL, Interval, correlated, deviations
from hexservo.findings.identification.log import FITTED, LEAST_EXPLAINED, Log, leg_moves, scatter
from hexservo.findings.identification.rests import Rests, find_rests, with_friction
from hexservo.findings.part import Part
from hexservo.run.progress import ProgressCallback
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.leg_units import LegUnits

MOST_DELAY = _core.MAX_ACTUATOR_DELAY  # [ticks]
"""Most ticks of delay, as `actuators.delay` has it."""

MAJORITY = 4
"""Legs of which a value is known, for a scenario to have it."""

GOOD = 0.95
"""Share of the part kept apart that a model should predict."""

_BANDWIDTHS = 9  # of a coarse grid, from 1/400 of the fastest that ticks show
_DAMPINGS = (0.35, 0.8, 1.6)
_LIMITS = ((False, False), (True, False), (False, True), (True, True))  # of speed and acceleration: which act
_NONE = (np.inf, np.inf)
_SLOWEST, _FASTEST = 0.05, 0.6  # bandwidths that are searched: times the record, and times a tick
_LEAST_DAMPED, _MOST_DAMPED = 0.01, 50.0
_EDGE = 1.001  # ratio to an end of what is searched that is no different from it
_TRIED = 3  # delays that are fitted of those that start best
_WHITE = 1.3  # ticks over which residuals of a fit that found the true drive are correlated, at most
_STARTS = 4  # from which a fit is tried again whose residuals are correlated further
_WORTH = 10.0  # of the criterion by Bayes: what a limit must gain to count
_LESS = 0.25  # of what a fit leaves in the part kept apart: with less, commands and joints are exchanged
_FINER = 8  # parts of a tick, each in the core's steps: of fits with limits in the end, and of a log that is not long
_MOST_STEPS = 400_000  # of these


@dataclass(frozen=True)
class DriveFit:
    """Response of one leg's drive."""

    leg: int  # 1 to 6
    bandwidth: Interval | None  # [Hz]; None of a leg that hardly moved, as all that follows
    damping: Interval | None  # [1]
    delay: Interval | None  # [ticks]; no upper end where `MOST_DELAY` is as likely as the value
    speed_limit: Interval | None  # [m/s], or [rad/s]; None where no limit is seen: `fastest` was
    acceleration_limit: Interval | None  # [m/s^2], or [rad/s^2]; likewise, `hardest` was
    fastest: float  # [m/s], or [rad/s], of the response that was fitted
    hardest: float  # [m/s^2], or [rad/s^2]: acceleration of it, means over ticks
    noise: float  # standard deviation of what the fit leaves [m], or [rad]
    correlated: float  # ticks over which what it leaves is correlated, 1 of white noise
    explained: float | None  # share of the variance of the part kept apart that is predicted, 1: all; None: rests there
    rests: Rests | None = None  # how far from its command friction leaves it; None where the log has too few rests
    lag: Interval | None = None  # 2 zeta/omega [s], of a leg with a slow pole all that a log determines; None as above
    at_edge: bool = False  # the best fit is at an edge of what is searched: its lag is no estimate

    @property
    def response_is_known(self) -> bool:
        """Whether the log determines bandwidth and damping, which are one pair."""
        return all(one is not None and one.is_bounded for one in (self.bandwidth, self.damping))


@dataclass(frozen=True, eq=False, repr=False)
class Drives(Part):
    """Responses of the six drives, and those that are nearest to all."""

    fits: tuple[DriveFit, ...]
    period: float  # of the ticks [s]
    fitted: float  # [s] of the record that were fitted
    apart: float  # [s] of it that were kept apart
    units: LegUnits = field(repr=False)
    time: Array = field(repr=False)  # (k,) of the part kept apart, thinned [s]
    measured: Array = field(repr=False)  # (k, 6)
    predicted: Array = field(repr=False)  # (k, 6)
    finely: Array = field(repr=False)  # (n f, 6) predicted from the first tick on, at f equal steps in each tick
    if_exchanged: float | None = None  # share of the motion of the worst leg that is predicted with its commands and
    # joints exchanged, where that is clearly more; else None

    @property
    def moved(self) -> list[DriveFit]:
        """The drives of which something is known."""
        return [fit for fit in self.fits if fit.bandwidth is not None]

    @property
    def worst(self) -> DriveFit | None:
        """The leg of whose motion in the part kept apart least is predicted; None where none moves there."""
        judged = [(fit.explained, fit.leg) for fit in self.fits if fit.explained is not None]
        return self.fits[min(judged)[1] - 1] if judged else None

    @property
    def taken(self) -> list[DriveFit]:
        """The drives that keys are taken from: those of which the model predicts half of the motion."""
        return [fit for fit in self.moved if fit.explained is None or fit.explained >= LEAST_EXPLAINED]

    @property
    def explains(self) -> bool:
        """Whether the model is of these legs at all, as far as the part kept apart shows it.

        It predicts half of the motion of enough legs, and something of each: where it predicts nothing of a leg, that
        one does not do what it is commanded. Nor is it where the commands follow the joints.
        """
        worst = self.worst
        if self.if_exchanged is not None:
            return False
        if worst is None or worst.explained is None:
            return True
        return worst.explained > 0.0 and are_enough(len(self.taken), len(self.moved))


def are_enough(known: int, moved: int) -> bool:
    """Whether a scenario, which has one drive for all legs, may have what is known of some that moved."""
    return known > 0 and (known == moved or known >= MAJORITY)


@dataclass(frozen=True, eq=False)
class _Record:
    """One leg in a log."""

    commands: Array  # (n,), with what friction makes of them
    joints: Array  # (n,)
    period: float
    fitted: int  # ticks that are fitted
    rests: Rests | None = None

    @property
    def moves(self) -> bool:
        """Whether the leg moves in what is fitted."""
        return leg_moves(self.commands, self.joints, slice(self.fitted))

    def explained(self, predicted: Array) -> float | None:
        """Return the share of the motion that is predicted (n,) where nothing is fitted; None without motion there."""
        apart = slice(self.fitted, None)
        if not leg_moves(self.commands, self.joints, apart):
            return None
        left = self.joints[apart] - predicted[apart]
        return 1.0 - float(np.mean(left**2)) / float(np.var(self.joints[apart]))

    def response(self, delay: int, values: Array, ticks: int | None = None, finer: int = 1) -> Array:
        """Return the coordinate at each tick, (n,), or at the first ones alone, or at `finer` steps in each tick.

        The values are bandwidth, damping, speed and acceleration limit; place and rate at the first tick; the command
        that was given before it.
        """
        bandwidth, damping, speed, acceleration, place, rate, before = values
        count = len(self.commands) if ticks is None else ticks
        commands = np.concatenate([np.full(delay, before), self.commands[: max(0, count - delay)]])[:count]
        return _core.drive_response(
            np.repeat(commands, finer), place, rate, self.period / finer, bandwidth, damping, speed, acceleration
        )


def fit_drives(
    log: Log, units: LegUnits, report: ProgressCallback | None = None, delays: Sequence[int] = range(MOST_DELAY + 1)
) -> Drives:
    """Fit the response of each leg's drive to a log.

    Parameters
    ----------
    log
        In which the legs were commanded to move.
    units
        Of a leg's coordinate.
    report
        Is called with the legs done, and 6.
    delays
        Those that are tried [ticks].
    """
    fitted = int(FITTED * len(log.time))
    records = [_record(log, leg, fitted) for leg in range(6)]
    found: list[list[_Model]] = []
    for leg, record in enumerate(records):
        found.append(_search(record, delays) if record.moves else [])
        if report is not None:
            report(leg + 1, 6)
    _compare_legs(records, found)
    described = [_described(record, leg + 1, found[leg]) for leg, record in enumerate(records)]
    finely = np.stack([prediction for _, prediction in described], axis=1)
    predicted = finely[:: len(finely) // len(log.time)]
    shown = slice(fitted, None, max(1, (len(log.time) - fitted) // 500))
    drives = Drives(
        fits=tuple(fit for fit, _ in described),
        period=log.period,
        fitted=fitted * log.period,
        apart=(len(log.time) - fitted) * log.period,
        units=units,
        time=log.time[shown],
        measured=log.joints[shown],
        predicted=predicted[shown],
        finely=finely,
    )
    return replace(drives, if_exchanged=_if_exchanged(log, drives, fitted, delays))


def _if_exchanged(log: Log, drives: Drives, fitted: int, delays: Sequence[int]) -> float | None:
    """Return what is predicted of the motion of the worst leg if the commands are its joints, if it is clearly more."""
    worst = drives.worst
    if worst is None or worst.explained is None or (worst.explained >= GOOD and worst.response_is_known):
        return None
    record = _record(replace(log, commands=log.joints, joints=log.commands), worst.leg - 1, fitted)
    best = _best(_search(record, delays))
    explained = record.explained(record.response(best.delay, best.values))
    clearly = explained is not None and explained >= GOOD and 1.0 - explained < _LESS * (1.0 - worst.explained)
    return explained if clearly else None


def _record(log: Log, leg: int, fitted: int) -> _Record:
    commands, joints = log.commands[:, leg], log.joints[:, leg]
    rests = find_rests(commands, joints)
    return _Record(with_friction(commands, joints, rests), joints, log.period, fitted, rests)


def _search(record: _Record, delays: Sequence[int]) -> list[_Model]:
    """Fit the delays, and those that are likely with each limit that may act."""
    speed, acceleration = _extremes(record)
    free, bound = (
        {delay: _start(record, delay, limits) for delay in delays} for limits in (_NONE, (speed, acceleration))
    )
    models = [_model(record, delay, free[delay], _LIMITS[0]) for delay in delays]
    models += [_model(record, delay, bound[delay], _LIMITS[-1]) for delay in delays]
    likely = list(dict.fromkeys(model.delay for model in _ordered(models)))[:_TRIED]
    models += [_model(record, delay, bound[delay], limits) for delay in likely for limits in _LIMITS[1:-1]]
    best = _best(models)
    if best.correlated <= _WHITE:
        return models
    # Limits make several minima: this may be none of the true drive, or the drive none of this kind.
    near = [delay for delay in delays if abs(delay - best.delay) <= 1]
    return models + [
        _model(record, delay, start, limits)
        for delay in near
        for limits, extremes in ((_LIMITS[1], (speed, np.inf)), (_LIMITS[-1], (speed, acceleration)))
        for start in _starts(record, delay, extremes)[:_STARTS]
    ]


def _ordered(models: Sequence[_Model]) -> list[_Model]:
    """Return the best one first; how many residuals are independent follows from the one that leaves least."""
    effective = min(models, key=lambda model: model.squares).effective
    return sorted(models, key=lambda model: model.criterion(effective))


def _best(models: Sequence[_Model]) -> _Model:
    return _ordered(models)[0]


def _compare_legs(records: Sequence[_Record], found: Sequence[list[_Model]]) -> None:
    """Try with each leg what is best for the leg that moved most clearly: the drives of a machine are alike."""
    clear = [_best(models) for models in found if models]
    if not clear:
        return
    guide = max(clear, key=lambda model: model.clarity)
    for record, models in zip(records, found, strict=True):
        if models:
            own = _best(models).values
            start = np.concatenate([guide.values[:4], own[4:]])
            models.append(_model(record, guide.delay, start, guide.limits))


def _refined(record: _Record, models: Sequence[_Model]) -> list[_Model]:
    """Fit those with limits again, in finer steps, that the record does not tell from the best one.

    The steps in which a limit begins or ends to act are of second order: with the core's own, of a leg of 11 Hz and
    ticks of 20 ms, they are off by ten micrometres, and bias bandwidth and damping by several per cent.
    """
    near = _alike(_best(models), models)
    return [
        _model(record, one.delay, one.values, one.limits, _FINER) if any(one.limits) and one in near else one
        for one in models
    ]


def _described(record: _Record, leg: int, models: Sequence[_Model]) -> tuple[DriveFit, Array]:
    """Return what the best model states, and what it predicts at equal steps in all ticks."""
    finer = int(np.clip(_MOST_STEPS // len(record.joints), 1, _FINER))
    if not models:
        still = np.full(finer * len(record.joints), record.joints[: record.fitted].mean())
        return DriveFit(leg, None, None, None, None, None, 0.0, 0.0, scatter(record.joints), 1.0, None), still
    models = _refined(record, models)
    best = _best(models)
    alike = _alike(best, models)
    delays = [model.delay for model in alike]
    predicted = record.response(best.delay, best.values, finer=_FINER)[::_FINER]
    return (
        DriveFit(
            leg=leg,
            bandwidth=_hull(best, alike, 0),
            damping=_hull(best, alike, 1),
            # A limit that hardly acts may make a fit singular, and leaves the lag as it is.
            lag=_over(best.lag.value, [one.lag for one in alike if one is best or np.isfinite(one.sigma_of_lag)]),
            delay=Interval(
                float(best.delay), float(min(delays)), np.inf if max(delays) == MOST_DELAY else float(max(delays))
            ),
            speed_limit=_hull(best, alike, 2) if best.limits[0] else None,
            acceleration_limit=_hull(best, alike, 3) if best.limits[1] else None,
            fastest=float(np.abs(np.diff(predicted[: record.fitted])).max() / record.period),
            hardest=float(np.abs(np.diff(predicted[: record.fitted], n=2)).max() / record.period**2),
            noise=best.noise,
            correlated=best.correlated,
            explained=record.explained(predicted),
            rests=record.rests,
            at_edge=best.at_edge,
        ),
        record.response(best.delay, best.values, finer=finer),
    )


@dataclass(frozen=True, eq=False)
class _Model:
    """A least-squares fit with a given delay and limits that may act."""

    delay: int
    limits: tuple[bool, bool]  # of speed and acceleration
    values: Array  # (7,) see `_Record.response`
    free: Mask  # (7,) which of them were fitted
    sigma: Array  # (f,) of those: of the logarithms, but for the last three
    sigma_of_lag: float  # of the logarithm of 2 zeta/omega
    squares: float  # sum of the residuals' squares
    count: int  # residuals
    correlated: float
    motion: float  # standard deviation of what was measured
    searched: Array  # (4, 2) least and largest of the first four values that were searched

    @property
    def noise(self) -> float:
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
        place = int(self.free[:index].sum())
        found = Interval.of_logarithm(float(self.values[index]), float(self.sigma[place]))
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
        inside = all(low < self.values[index] < high for index in (0, 1) for low, high in [self._within(index)])
        return not inside and float(self.values[1]) <= 1.0

    def _within(self, index: int) -> tuple[float, float]:
        """Return the ends of what is searched, but for rounding."""
        lowest, highest = self.searched[index]
        return _EDGE * lowest, highest / _EDGE


def _model(record: _Record, delay: int, start: Array, limits: tuple[bool, bool], finer: int = 1) -> _Model:
    measured = record.joints[: record.fitted]
    free = np.array([True, True, *limits, True, True, delay > 0])
    values = start.copy()
    values[2:4] = np.where(limits, values[2:4], np.inf)
    scale = max(float(np.ptp(measured)), np.finfo(float).tiny)

    slow, fast = _SLOWEST / (record.fitted * record.period), _FASTEST / record.period
    searched = np.array([[slow, fast], [_LEAST_DAMPED, _MOST_DAMPED], [1e-12, 1e12], [1e-12, 1e12]])
    lowest, highest = np.log(searched).T

    units = np.array([scale, scale / record.period, scale])

    def unpacked(x: Array) -> Array:
        found = values.copy()
        found[free] = x
        found[:4] = np.where(free[:4], np.exp(np.where(free[:4], found[:4], 0.0)), values[:4])
        found[4:] = np.where(free[4:], found[4:] * units, values[4:])
        return found

    def residuals(x: Array) -> Array:
        left = record.response(delay, unpacked(x), record.fitted, finer)[::finer] - measured
        return np.where(np.isfinite(left), left, 1e3 * scale) / scale

    logs = np.clip(np.log(np.maximum(values[:4][free[:4]], 1e-12)), lowest[free[:4]], highest[free[:4]])
    first = np.concatenate([logs, (values[4:] / units)[free[4:]]])
    edge = np.full(int(free[4:].sum()), np.inf)
    bounds = [np.r_[lowest[free[:4]], -edge], np.r_[highest[free[:4]], edge]]
    fit = least_squares(residuals, first, bounds=bounds, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=60)
    left = fit.fun * scale
    largest = max(float(np.abs(measured).max()), float(np.abs(record.commands).max()))
    floor = len(left) * (8 * np.finfo(float).eps * largest) ** 2  # of rounding
    together = correlated(left)
    independent = len(left) / together
    by_lag = fit.jac.copy()
    by_lag[:, 0] += by_lag[:, 1]  # by the bandwidth with the lag held: the next column is then by the lag
    return _Model(
        delay,
        limits,
        unpacked(fit.x),
        free,
        deviations(fit.jac, fit.fun, independent),
        float(deviations(by_lag, fit.fun, independent)[1]),
        float(left @ left) + floor,
        len(left),
        together,
        float(np.std(measured)),
        searched,
    )


def _start(record: _Record, delay: int, limits: tuple[float, float]) -> Array:
    """Return the values of a coarse grid that explain the record best with a delay and limits."""
    return _starts(record, delay, limits)[0]


def _starts(record: _Record, delay: int, limits: tuple[float, float]) -> list[Array]:
    """Return all values of that grid, the best ones first."""
    measured = record.joints[: record.fitted]
    fastest = 0.4 / record.period
    tried = []
    for bandwidth, damping in product(np.geomspace(fastest / 400.0, fastest, _BANDWIDTHS), _DAMPINGS):
        values = np.array([bandwidth, damping, *limits, measured[0], 0.0, record.commands[0]])
        left = record.response(delay, values, record.fitted) - measured
        tried.append((float(left @ left), values))
    return [values for _, values in sorted(tried, key=lambda one: one[0])]


def _extremes(record: _Record) -> tuple[float, float]:
    """Return the largest speed and acceleration of the measured leg, but for their noise, over a few ticks."""
    width = max(2, round(0.02 / record.period))
    steps = (record.joints[width:] - record.joints[:-width]) / (width * record.period)
    changes = (steps[width:] - steps[:-width]) / (width * record.period)
    return float(np.quantile(np.abs(steps), 0.99)), float(np.quantile(np.abs(changes), 0.99))


def _alike(best: _Model, models: Sequence[_Model]) -> list[_Model]:
    """Return the models that the likelihood does not distinguish from the best one, which is one of them."""
    bound = float(chi2.ppf(LEVEL, 1))
    return [one for one in models if best.effective * np.log(one.squares / best.squares) <= bound]


def _hull(best: _Model, alike: Sequence[_Model], index: int) -> Interval:
    """Return the interval of one of the first four values over all models that may be the true one and have it."""
    return _over(float(best.values[index]), [model.interval(index) for model in alike if model.free[index]])


def _over(value: float, found: Sequence[Interval]) -> Interval:
    return Interval(value, min(one.low for one in found), max(one.high for one in found)).determined()
