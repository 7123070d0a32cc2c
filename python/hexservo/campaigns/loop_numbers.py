"""Numbers of the linear loop that a search for gains may require, beside metrics of runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from hexservo.scenario.scenario import Scenario

__all__ = ["LOOP_NUMBERS", "delay_margin"]


def delay_margin(scenario: Scenario) -> float:
    """Return by how much the camera's latency may grow until the linear loop is unstable [s].

    Negative for a loop that is stable with a smaller latency only; NaN where it is not stable with any, or where the
    analysis does not apply (docs/analysis/camera_rate.md). A loop that no latency makes unstable has the largest one
    that is looked at.
    """
    from hexservo.findings.analysis.camera_margins import loop_margins, most_frames
    from hexservo.findings.analysis.camera_rate import CameraRate
    from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, clock_of, loop_at_rest

    try:
        at_rest = loop_at_rest(scenario)
        clock = clock_of(at_rest.scenario)
        if clock.latency > most_frames(at_rest.free) * clock.period:
            return math.nan
        free = loop_margins(at_rest.free, clock)
        smooth = None if at_rest.smooth is None else loop_margins(at_rest.smooth, clock)
    except NotApplicableError:
        return math.nan
    acting = CameraRate(scenario, None, at_rest, clock, free, smooth).acting
    if acting is None or acting.latency.stable is None:
        return math.nan
    return float((acting.latency.stable - clock.latency) * at_rest.scenario.simulation.step)


LOOP_NUMBERS: Mapping[str, tuple[str, Callable[[Scenario], float]]] = {"delay_margin": ("s", delay_margin)}
"""Name -> (unit, function of the scenario)."""
