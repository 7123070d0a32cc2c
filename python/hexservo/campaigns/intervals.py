"""Intervals for a failure probability: one that holds at every stop, and one for a number of runs fixed beforehand."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from scipy.special import betaincinv, betaln

from hexservo.scenario.wording import whole_number


@dataclass(frozen=True)
class Mixture:
    """The distribution Beta(a, b) over which the likelihood ratio is averaged."""

    a: float
    b: float


JEFFREYS = Mixture(0.5, 0.5)
RARE = Mixture(0.1, 1e4)
"""For failures that are expected once in 1e5 runs or less: narrower there, wider elsewhere."""

# From the share of failures to beyond an end of the interval, in logit.
_STEPS = tuple(2.0**power for power in range(64))


def anytime_interval(
    failures: int, runs: int, confidence: float = 0.95, mixture: Mixture = JEFFREYS
) -> tuple[float, float]:
    """Return the interval { p : M_n(p) < 1/(1 - confidence) } for the failure probability.

    M_n(p) = B(a + k, b + n - k)/B(a, b) / (p^k (1 - p)^(n - k)) is the mixture martingale: for independent runs that
    fail with the probability p it is a martingale of mean 1, so that it ever reaches 1/alpha with a probability of at
    most alpha (Ville 1939; Robbins 1970).

    With the probability `confidence` it holds the true one at all numbers of runs at once: also at the one where an
    observer of the results decides to stop (Howard, Ramdas, McAuliffe and Sekhon 2021).

    Parameters
    ----------
    failures, runs
        k of n independent runs failed.
    confidence
        Above 0 and below 1.
    mixture
        Fixed before the first run.

    Returns
    -------
    tuple of float
        Lower and upper end; (0, 1) without runs.

    Raises
    ------
    TypeError
        For counts that are no integers.
    ValueError
        Unless 0 <= failures <= runs.
    """
    _require_counts(failures, runs)
    if runs == 0:
        return 0.0, 1.0
    from scipy.optimize import brentq  # takes a third of a second, where it is needed alone

    most = -math.log1p(-confidence)

    def excess(logit: float) -> float:  # of log M over log(1/alpha), at p = 1/(1 + exp(-logit))
        log_p, log_q = -np.logaddexp(0.0, -logit), -np.logaddexp(0.0, logit)
        evidence = betaln(mixture.a + failures, mixture.b + runs - failures) - betaln(mixture.a, mixture.b)
        return float(evidence - failures * log_p - (runs - failures) * log_q - most)

    def end(direction: float) -> float:
        share = min(max(failures / runs, 1e-300), 1 - 1e-16)
        start = math.log(share) - math.log1p(-share)
        step = next(step for step in _STEPS if excess(start + direction * step) >= 0)
        found = brentq(excess, start, start + direction * step, xtol=1e-12, rtol=1e-14)
        return float(1.0 / (1.0 + math.exp(-found))) if found > -700 else 0.0

    return (0.0 if failures == 0 else end(-1.0)), (1.0 if failures == runs else end(1.0))


def clopper_pearson(failures: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval of Clopper and Pearson (1934) for the failure probability, (1 - confidence)/2 on each side.

    It holds for a number of runs that was fixed before the first one, and for no other.

    Raises
    ------
    TypeError
        For counts that are no integers.
    ValueError
        Unless 0 <= failures <= runs.
    """
    _require_counts(failures, runs)
    if runs == 0:
        return 0.0, 1.0
    tail = (1.0 - confidence) / 2
    low = 0.0 if failures == 0 else float(betaincinv(failures, runs - failures + 1, tail))
    high = 1.0 if failures == runs else float(betaincinv(failures + 1, runs - failures, 1 - tail))
    return low, high


def _require_counts(failures: int, runs: int) -> None:
    whole_number("failures", failures, 0, whole_number("runs", runs, 0))


def joint_confidence(confidence: float, intervals: int) -> float:
    """Return the confidence with which several intervals hold together, 1 - r (1 - confidence) of r, at least 0.

    It is computed in decimals, as the confidence is written: 0.99998 of two with 0.99999.
    """
    return max(0.0, float(1 - intervals * (1 - Decimal(repr(confidence)))))


def runs_for_bound(probability: float, failures: int, confidence: float, mixture: Mixture) -> int:
    """Return the least number of runs with so many failures whose interval lies below a probability."""
    least = high = max(failures, 1)

    def below(runs: int) -> bool:
        return anytime_interval(failures, runs, confidence, mixture)[1] <= probability

    while not below(high):
        high *= 2
    return bisect_left(range(high), True, lo=max(least, high // 2), key=below)
