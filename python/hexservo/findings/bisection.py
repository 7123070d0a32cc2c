"""Where a condition ends between two numbers."""

from __future__ import annotations

import math
from collections.abc import Callable


def last_that_holds(
    holds: Callable[[float], bool], inside: float, outside: float, rounds: int, *, logarithmic: bool = False
) -> float:
    """Return a number for which a condition holds, as near to where it ends as halving an interval leads.

    Parameters
    ----------
    holds
        The condition.
    inside, outside
        Ends of the interval, for the first of which it holds and for the second it does not; they are not asked.
    rounds
        How often the interval is halved.
    logarithmic
        Halve the logarithm, of positive numbers.
    """
    for _ in range(rounds):
        middle = math.sqrt(inside * outside) if logarithmic else 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside
