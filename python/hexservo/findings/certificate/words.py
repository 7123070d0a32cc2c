"""Parts of the sections of a certificate."""

from __future__ import annotations

import numpy as np

from hexservo.findings.evidence import Line
from hexservo.run.samples import extreme_samples
from hexservo.scenario.arrays import Array

_SHOWN = 1500  # points of a line of markers, at most


def markers(name: str, time: Array, values: Array) -> Line:
    """Return samples (n,) as markers, at most 1500, which keep the extremes; NaN has none.

    Lines need no such choice: a chart draws what its width resolves, with all peaks.
    """
    known = np.flatnonzero(np.isfinite(values))
    kept = known[extreme_samples(values[known], _SHOWN)]
    return Line(name, time[kept], values[kept], "points")
