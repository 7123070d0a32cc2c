"""One drive for all six legs, as a scenario has it, from the drives of the legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexservo.findings.identification.drives import Drives
from hexservo.findings.identification.interval import Interval

__all__ = ["Response", "mean_of", "response_of"]

_MAJORITY = 4  # legs of which a value is known, for the scenario to have it


@dataclass(frozen=True)
class Response:
    """Bandwidth and damping for all legs: one without the other is another response."""

    bandwidth: float  # [Hz]
    damping: float  # [1]
    lag: float | None  # 2 zeta/omega [s] that they stand for where the log determines no more; else None


def response_of(drives: Drives) -> Response | None:
    """Return the pair of the legs whose pair is known, or else one with the lag of the legs whose lag is known.

    None where neither is known of four legs, or of all that moved.
    """
    moved, known = drives.moved, [fit for fit in drives.moved if fit.response_is_known]
    if _are_enough(len(known), len(moved)):
        bandwidth, damping = mean_of([fit.bandwidth for fit in known]), mean_of([fit.damping for fit in known])
        return None if bandwidth is None or damping is None else Response(bandwidth, damping, None)
    if (lag := mean_of([fit.lag for fit in moved])) is None:
        return None
    alike = [fit.bandwidth.value for fit in moved if fit.bandwidth and fit.lag is not None and fit.lag.is_bounded]
    middle = float(np.exp(np.mean(np.log(alike))))
    return Response(middle, np.pi * middle * lag, lag)


def mean_of(found: Sequence[Interval | None]) -> float | None:
    """Return one value for all legs: the mean of the logarithms, each counted by how well it is known.

    Parameters
    ----------
    found
        Of the legs that moved.

    Returns
    -------
    float or None
        None where it is known of fewer than four legs, and not of all that moved.
    """
    known = [one for one in found if one is not None and one.is_bounded]
    if not _are_enough(len(known), len(found)):
        return None
    values = np.log([one.value for one in known])
    sigma = np.maximum(np.log([one.high for one in known]) - values, 1e-9)
    return float(np.exp((values / sigma**2).sum() / (1.0 / sigma**2).sum()))


def _are_enough(known: int, moved: int) -> bool:
    return known > 0 and (known == moved or known >= _MAJORITY)
