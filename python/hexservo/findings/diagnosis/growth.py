"""A drift that a run is too short for: the pose error that grows by unequal depth errors."""

from __future__ import annotations

import math

import numpy as np

from hexservo.findings.analysis.drift import slowest_rate
from hexservo.scenario.scenario import Scenario

_DIGITS = 9  # of a rate [1/s]: what is left of a smaller one is rounding


def growth_time(scenario: Scenario) -> float:
    """Return the time in which a pose error grows e-fold by unequal depth errors, at start or goal [s].

    By the rates of the part `drift` of an analysis. NaN where it does not grow, and where that part does not apply.
    """
    if not np.ptp(scenario.uncertainty.depth):
        return math.nan
    try:
        rate = slowest_rate(scenario)
    except (ValueError, np.linalg.LinAlgError):  # extreme numbers
        return math.nan
    return -1.0 / rate if round(rate, _DIGITS) < 0.0 else math.nan
