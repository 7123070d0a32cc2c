"""One drive for all six legs, as a scenario has it, from the drives of the legs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from hexservo.findings.identification.drives import MAJORITY, DriveFit, Drives, are_enough
from hexservo.findings.identification.interval import Interval

__all__ = ["Limit", "Response", "limit_of", "mean_of", "response_of"]

LimitName: TypeAlias = Literal["speed_limit", "acceleration_limit"]
LIMITS: tuple[LimitName, ...] = ("speed_limit", "acceleration_limit")

AGREEMENT = 1.5
"""Ratio of the lags of legs that agree."""

_BEYOND = 1.1  # times a limit, from which on a leg is beyond it: below, it would act for so short that it is not seen


@dataclass(frozen=True)
class Response:
    """Bandwidth and damping for all legs: one without the other is another response."""

    bandwidth: float  # [Hz]
    damping: float  # [1]
    lag: float | None  # 2 zeta/omega [s] that they stand for where the log determines no more; else None
    by_agreement: bool = False  # the legs' logs determine not even that one by one, but their best fits agree


def response_of(drives: Drives) -> Response | None:
    """Return the pair of the legs whose pair is known, or else one with the lag of the legs whose lag is known.

    Enough are four legs, or all that keys are taken from (`Drives.taken`). Where neither is known of enough legs one by
    one, it is the mean of their best fits if these agree, and None if they do not.
    """
    moved, known = drives.taken, [fit for fit in drives.taken if fit.response_is_known]
    if are_enough(len(known), len(moved)):
        bandwidth, damping = mean_of([fit.bandwidth for fit in known]), mean_of([fit.damping for fit in known])
        return None if bandwidth is None or damping is None else Response(bandwidth, damping, None)
    if (lag := mean_of([fit.lag for fit in moved])) is not None:
        return _with_lag(lag, [fit for fit in moved if fit.lag is not None and fit.lag.is_bounded])
    best = [fit for fit in moved if not fit.at_edge]
    lags = [fit.lag.value for fit in best if fit.lag is not None]
    if len(lags) < MAJORITY or max(lags) > AGREEMENT * min(lags):
        return None
    return replace(_with_lag(float(np.exp(np.mean(np.log(lags)))), best), by_agreement=True)


@dataclass(frozen=True)
class Limit:
    """A limit of the drives that keys are taken from: of the speed, or of the acceleration."""

    value: float | None  # for all legs [m/s; m/s^2], or [rad/s; rad/s^2]; None where it is not known
    seen: Sequence[DriveFit]  # legs that the log shows it of
    reached: Mapping[int, float]  # by leg, of the others: the largest speed or acceleration, in which there is no limit

    def exceeded(self, limit: float) -> list[int]:
        """Return the legs that were clearly beyond a limit without one."""
        return [leg for leg, most in self.reached.items() if most > _BEYOND * limit]

    def is_none(self, given: float | None) -> bool:
        """Whether the legs have no limit as the given one: enough of those that show anything went beyond it."""
        beyond = [] if given is None or self.value is not None else self.exceeded(given)
        return are_enough(len(beyond), len(beyond) + len(self.seen))


def limit_of(drives: Drives, name: LimitName) -> Limit:
    """Return what a log shows of `speed_limit` or `acceleration_limit`."""
    reached = "fastest" if name == "speed_limit" else "hardest"
    return Limit(
        mean_of([getattr(fit, name) for fit in drives.taken]),
        [fit for fit in drives.taken if getattr(fit, name) is not None],
        {fit.leg: getattr(fit, reached) for fit in drives.taken if getattr(fit, name) is None},
    )


def _with_lag(lag: float, fits: Sequence[DriveFit]) -> Response:
    """Return the pair with a lag [s] at the middle of the legs' bandwidths."""
    middle = float(np.exp(np.mean([np.log(fit.bandwidth.value) for fit in fits if fit.bandwidth is not None])))
    return Response(middle, np.pi * middle * lag, lag)


def mean_of(found: Sequence[Interval | None]) -> float | None:
    """Return one value for all legs: the mean of the logarithms, each counted by how well it is known.

    Parameters
    ----------
    found
        Of the legs that keys are taken from.

    Returns
    -------
    float or None
        None where it is known of fewer than four legs, and not of all.
    """
    known = [one for one in found if one is not None and one.is_bounded]
    if not are_enough(len(known), len(found)):
        return None
    values = np.log([one.value for one in known])
    sigma = np.maximum(np.log([one.high for one in known]) - values, 1e-9)
    return float(np.exp((values / sigma**2).sum() / (1.0 / sigma**2).sum()))
