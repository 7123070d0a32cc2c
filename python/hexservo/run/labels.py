"""Places for the numbers of points beside their marks and paths, in figures and reports."""

from __future__ import annotations

from itertools import combinations
from typing import Literal

import numpy as np

from hexservo.scenario.arrays import Array


def farther_apart(starts: Array, ends: Array, enough: float) -> Literal[0, -1]:
    """Find where labels of paths have more room: at the starts (0), if that is enough, or at the ends (-1)."""

    def nearest(places: Array) -> float:
        return min(float(np.hypot(*(a - b))) for a, b in combinations(places, 2))

    return 0 if nearest(starts) >= min(enough, nearest(ends)) else -1


def roomiest_place(candidates: Array, taken: Array, enough: float) -> int:
    """Return the first of some places (k, 2) that is far enough from all that are taken (n, 2), or else the farthest.

    All in one unit, as points of the figure.
    """
    room = np.array([np.nanmin(np.hypot(*(taken - place).T)) for place in candidates])
    free = np.flatnonzero(room >= enough)
    return int(free[0] if len(free) else room.argmax())
