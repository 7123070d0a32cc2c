"""What the drives of a machine that takes positions do: bandwidth, damping, delay and limits of each leg from a log.

Output error: the response of docs/model.md, section 7, by the core, is fitted to the measured coordinates from the
commands alone, by least squares on the first part of the record. The rest is predicted, without a new start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from hexservo.findings.identification.drive_models import (
    ACCELERATION,
    BANDWIDTH,
    DAMPING,
    DELAY,
    FINER,
    MOST_DELAY,
    OFFSET,
    SPEED,
    LegRecord,
    Model,
    fit_model,
    starts,
)
from hexservo.findings.identification.interval import LEVEL, Interval
from hexservo.findings.identification.joints_repeated import fresh_readings
from hexservo.findings.identification.log import FEWEST, FITTED, LEAST_EXPLAINED, Log, scatter
from hexservo.findings.identification.rests import Rests, find_rests, with_friction
from hexservo.findings.part import Part
from hexservo.run.progress import ProgressCallback
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.leg_units import LegUnits

__all__ = ["MOST_DELAY", "DriveFit", "Drives", "are_enough", "fit_drives"]

MAJORITY = 4
"""Legs of which a value is known, for a scenario to have it."""

GOOD = 0.95
"""Share of the part kept apart that a model should predict."""

_LIMITS = ((False, False), (True, False), (False, True), (True, True))  # of speed and acceleration: which act
_NONE = (np.inf, np.inf)
_TRIED = 3  # delays that are fitted of those that start best
_WHITE = 1.3  # ticks over which residuals of a fit that found the true drive are correlated, at most
_STARTS = 4  # from which a fit is tried again whose residuals are correlated further
_LESS = 0.25  # of what a fit leaves in the part kept apart: with less, commands and joints are exchanged
_MOST_STEPS = 400_000  # parts of ticks, of a log that is not long


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
    offset: Interval | None = None  # of what is measured from what is commanded, at rest [m], or [rad]; None as above
    rounded: float = 0.0  # what `Drives.whole_delay` moves the response by (RMS) [m; rad]; 0 within the interval
    motion: float = 0.0  # standard deviation of the response [m], or [rad]

    @property
    def rounding_matters(self) -> bool:
        """Whether a delay in whole ticks moves the response by more than noise, and by a part of its motion."""
        return self.rounded > self.noise and self.rounded > (1.0 - GOOD) * self.motion

    @property
    def is_offset(self) -> bool:
        """Whether readings are beyond commands at rest, by more than the noise of one of them."""
        return self.offset is not None and abs(self.offset.value) > max(
            self.noise, self.offset.high - self.offset.value
        )

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
    repeated: int = 0  # readings of all joints that repeat those of the tick before: they do not count

    @property
    def moved(self) -> list[DriveFit]:
        """The drives of which something is known."""
        return [fit for fit in self.fits if fit.bandwidth is not None]

    @property
    def delay(self) -> float:
        """The median of the delays of the legs that keys are taken from [ticks]."""
        return float(np.median([fit.delay.value for fit in self.taken if fit.delay is not None]))

    @property
    def whole_delay(self) -> int:
        """The delay of a scenario, which has whole ticks."""
        return round(self.delay)

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
        Whole ticks that the search begins with; what is found is any number from the least to the largest of these. One
        alone is given, and not searched.
    """
    fitted = int(FITTED * len(log.time))
    fresh = fresh_readings(log.joints)
    if fresh.sum() < FEWEST:  # as where the joints are commands that were held
        fresh[:] = True
    records = [_record(log, leg, fitted, fresh) for leg in range(6)]
    found: list[list[Model]] = []
    for leg, record in enumerate(records):
        found.append(_search(record, delays) if record.moves else [])
        if report is not None:
            report(leg + 1, 6)
    _compare_legs(records, found, delays)
    described = [_described(record, leg + 1, found[leg]) for leg, record in enumerate(records)]
    finely = np.stack([prediction for _, prediction in described], axis=1)
    predicted = finely[:: len(finely) // len(log.time)]
    apart = np.flatnonzero(fresh)
    apart = apart[apart >= fitted]
    shown = apart[:: max(1, len(apart) // 500)]
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
        repeated=int((~fresh).sum()),
    )
    drives = replace(drives, fits=_rounded(drives, records, found))
    return replace(drives, if_exchanged=_if_exchanged(log, drives, records, delays))


def _rounded(drives: Drives, records: Sequence[LegRecord], found: Sequence[list[Model]]) -> tuple[DriveFit, ...]:
    """Return the drives with what the delay in whole ticks, which a scenario has, moves each by."""
    if not drives.taken:
        return drives.fits

    def rounded(fit: DriveFit, record: LegRecord, best: Model) -> DriveFit:
        whole = float(drives.whole_delay)
        if fit.delay is None or fit.delay.low <= whole <= fit.delay.high:
            return fit
        values = best.values.copy()
        values[DELAY] = whole
        own = record.response(best.values, best.base)
        off = record.response(values, finer=FINER)[::FINER] - own
        return replace(fit, rounded=float(np.sqrt((off**2).mean())), motion=float(own.std()))

    each = zip(drives.fits, records, found, strict=True)
    return tuple(rounded(fit, record, _best(models)) if models else fit for fit, record, models in each)


def _if_exchanged(log: Log, drives: Drives, records: Sequence[LegRecord], delays: Sequence[int]) -> float | None:
    """Return what is predicted of the motion of the worst leg if the commands are its joints, if it is clearly more."""
    worst = drives.worst
    if worst is None or worst.explained is None or (worst.explained >= GOOD and worst.response_is_known):
        return None
    exchanged, leg = replace(log, commands=log.joints, joints=log.commands), worst.leg - 1
    record = _record(exchanged, leg, records[leg].fitted, np.ones(len(log.time), dtype=bool))
    best = _best(_search(record, delays))
    explained = record.explained(record.response(best.values, best.base))
    clearly = explained is not None and explained >= GOOD and 1.0 - explained < _LESS * (1.0 - worst.explained)
    return explained if clearly else None


def _record(log: Log, leg: int, fitted: int, fresh: Mask) -> LegRecord:
    commands, joints = log.commands[:, leg], log.joints[:, leg]
    rests = find_rests(commands, joints)
    drawn = with_friction(commands, joints, rests)
    shifted = rests.same if rests is not None and drawn is not commands else 0.0
    return LegRecord(drawn, joints, log.period, fitted, fresh, rests, shifted)


def _search(record: LegRecord, delays: Sequence[int]) -> list[Model]:
    """Fit the delays in whole ticks, those that are likely with each limit that may act, and any number about these.

    A limit that a whole delay seems to need is none where another delay does without: those of whole ticks are only
    starts, where more than one is tried.
    """
    extremes = _extremes(record)
    free, bound = ({delay: starts(record, delay, limits)[0] for delay in delays} for limits in (_NONE, extremes))
    models = [fit_model(record, free[delay], _LIMITS[0]) for delay in delays]
    models += [fit_model(record, bound[delay], _LIMITS[-1]) for delay in delays]
    likely = list(dict.fromkeys(model.whole for model in _ordered(models)))[:_TRIED]
    models += [fit_model(record, bound[delay], limits) for delay in likely for limits in _LIMITS[1:-1]]
    found = _refined(record, models, delays)
    best = _best(found)
    if best.correlated <= _WHITE:
        return found
    # Limits make several minima: this may be none of the true drive, or the drive none of this kind.
    near = [delay for delay in delays if abs(delay - best.whole) <= 1]
    again = [
        fit_model(record, start, limits)
        for delay in near
        for limits, limited in ((_LIMITS[1], (extremes[0], np.inf)), (_LIMITS[-1], extremes))
        for start in starts(record, delay, limited)[:_STARTS]
    ]
    return found + _refined(record, again, delays)


def _ordered(models: Sequence[Model]) -> list[Model]:
    """Return the best one first; how many residuals are independent follows from the one that leaves least."""
    effective = min(models, key=lambda model: model.squares).effective
    return sorted(models, key=lambda model: model.criterion(effective))


def _best(models: Sequence[Model]) -> Model:
    return _ordered(models)[0]


def _compare_legs(records: Sequence[LegRecord], found: Sequence[list[Model]], delays: Sequence[int]) -> None:
    """Try with each leg what is best for the leg that moved most clearly: the drives of a machine are alike."""
    clear = [_best(models) for models in found if models]
    if not clear:
        return
    guide = max(clear, key=lambda model: model.clarity)
    for record, models in zip(records, found, strict=True):
        if models:
            start = np.concatenate([guide.values[:4], _best(models).values[4:DELAY], guide.values[DELAY:]])
            models.append(_finally(record, start, guide.limits, delays))


def _refined(record: LegRecord, models: Sequence[Model], delays: Sequence[int]) -> list[Model]:
    """Fit again, with delays of any number of ticks, and with limits in finer steps.

    The steps in which a limit begins or ends to act are of second order: with the core's own, of a leg of 11 Hz and
    ticks of 20 ms, they are off by ten micrometres, and bias bandwidth and damping by several per cent.
    """
    if len(delays) == 1:
        near = _alike(_best(models), models)
        return [
            _finally(record, one.values, one.limits, delays) if any(one.limits) and one in near else one
            for one in models
        ]
    best = [[one for one in _ordered(models) if one.limits == limits] for limits in _LIMITS]
    chosen = [one for some, count in zip(best, (_TRIED, 1, 1, 1), strict=True) for one in some[:count]]
    return [_finally(record, one.values, one.limits, delays) for one in chosen]


def _finally(record: LegRecord, start: Array, limits: tuple[bool, bool], delays: Sequence[int]) -> Model:
    if len(delays) > 1:
        return fit_model(record, start, limits, (min(delays), max(delays)))
    return fit_model(record, start, limits, finer=FINER)


def _described(record: LegRecord, leg: int, models: Sequence[Model]) -> tuple[DriveFit, Array]:
    """Return what the best model states, and what it predicts at equal steps in all ticks."""
    finer = int(np.clip(_MOST_STEPS // len(record.joints), 1, FINER))
    if not models:
        still = np.full(finer * len(record.joints), record.joints[: record.fitted].mean())
        return DriveFit(leg, None, None, None, None, None, 0.0, 0.0, scatter(record.joints), 1.0, None), still
    best = _best(models)
    alike = _alike(best, models)
    predicted = record.response(best.values, best.base, finer=FINER)[::FINER]
    return (
        DriveFit(
            leg=leg,
            bandwidth=_hull(best, alike, BANDWIDTH),
            damping=_hull(best, alike, DAMPING),
            # A limit that hardly acts may make a fit singular, and leaves the lag as it is.
            lag=_over(best.lag.value, [one.lag for one in alike if one is best or np.isfinite(one.sigma_of_lag)]),
            delay=_over(best.delay.value, [one.delay for one in alike], of_factors=False),
            speed_limit=_hull(best, alike, SPEED) if best.limits[0] else None,
            acceleration_limit=_hull(best, alike, ACCELERATION) if best.limits[1] else None,
            fastest=float(np.abs(np.diff(predicted[: record.fitted])).max() / record.period),
            hardest=float(np.abs(np.diff(predicted[: record.fitted], n=2)).max() / record.period**2),
            noise=best.noise,
            correlated=best.correlated,
            explained=record.explained(predicted),
            rests=record.rests,
            at_edge=best.at_edge,
            offset=_offset(record, best, alike),
        ),
        record.response(best.values, best.base, finer=finer),
    )


def _extremes(record: LegRecord) -> tuple[float, float]:
    """Return the largest speed and acceleration of the measured leg, but for their noise, over a few ticks."""
    width = max(2, round(0.02 / record.period))
    steps = (record.joints[width:] - record.joints[:-width]) / (width * record.period)
    changes = (steps[width:] - steps[:-width]) / (width * record.period)
    return float(np.quantile(np.abs(steps), 0.99)), float(np.quantile(np.abs(changes), 0.99))


def _alike(best: Model, models: Sequence[Model]) -> list[Model]:
    """Return the models that the likelihood does not distinguish from the best one, which is one of them."""
    bound = float(chi2.ppf(LEVEL, 1))
    return [one for one in models if best.effective * np.log(one.squares / best.squares) <= bound]


def _hull(best: Model, alike: Sequence[Model], index: int) -> Interval:
    """Return the interval of one of the first four values over all models that may be the true one and have it."""
    return _over(float(best.values[index]), [model.interval(index) for model in alike if model.free[index]])


def _offset(record: LegRecord, best: Model, alike: Sequence[Model]) -> Interval:
    found = _over(float(best.values[OFFSET]), [one.offset for one in alike], of_factors=False)
    return Interval(found.value - record.shifted, found.low - record.shifted, found.high - record.shifted)


def _over(value: float, found: Sequence[Interval], *, of_factors: bool = True) -> Interval:
    over = Interval(value, min(one.low for one in found), max(one.high for one in found))
    return over.determined() if of_factors else over
