"""Numbers of the linear loop that a search for gains may require, beside metrics of runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from hexservo.scenario.scenario import Scenario

if TYPE_CHECKING:
    from hexservo.findings.analysis.camera_rate import CameraRate


def decay_rate(scenario: Scenario) -> float:
    """Return the rate at which the slowest mode of the linear loop decays [1/s]; negative if a mode grows.

    NaN where the analysis does not apply (docs/analysis/camera_rate.md).
    """
    rate = _camera_rate(scenario, borders=False)
    return math.nan if rate is None or rate.acting is None else -rate.acting.rate


def delay_margin(scenario: Scenario) -> float:
    """Return by how much the camera's latency may grow until the linear loop is unstable [s].

    Negative for a loop that is stable with a smaller latency only, or with a larger one only; NaN where it is not
    stable with any, or where the analysis does not apply (docs/analysis/camera_rate.md). A loop that no latency makes
    unstable has the largest one that is looked at.
    """
    rate = _camera_rate(scenario, borders=True)
    if rate is None or rate.acting is None or rate.clock is None or rate.acting.latency.stable is None:
        return math.nan
    border, own = rate.acting.latency, rate.clock.latency
    ticks = rate.acting.latency.stable - own
    if border.least is not None and own < border.least:
        ticks = own - border.least
    return ticks * rate.scenario.simulation.step


def _camera_rate(scenario: Scenario, *, borders: bool) -> CameraRate | None:
    """Return the analysis of the camera's rate without its runs; None where it does not apply."""
    from hexservo.findings.analysis.camera_margins import loop_margins, most_frames
    from hexservo.findings.analysis.camera_rate import CameraRate
    from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, clock_of, loop_at_rest

    try:
        at_rest = loop_at_rest(scenario)
        clock = clock_of(at_rest.scenario)
        if clock.latency > most_frames(at_rest.free) * clock.period:
            return None
        free = loop_margins(at_rest.free, clock, borders=borders)
        smooth = None if at_rest.smooth is None else loop_margins(at_rest.smooth, clock, borders=borders)
    except NotApplicableError:
        return None
    return CameraRate(at_rest.scenario, None, at_rest, clock, free, smooth)


LOOP_NUMBERS: Mapping[str, tuple[str, Callable[[Scenario], float]]] = {
    "decay_rate": ("1/s", decay_rate),
    "delay_margin": ("s", delay_margin),
}
"""Name -> (unit, function of the scenario)."""
