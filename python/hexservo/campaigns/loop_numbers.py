"""Numbers of the linear loop that a search for gains may require, beside metrics of runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from hexservo.scenario.scenario import Scenario

if TYPE_CHECKING:
    from hexservo.findings.analysis.camera_rate import CameraRate
    from hexservo.findings.analysis.linear_loop import Clock
    from hexservo.findings.analysis.loop_of_scenario import LoopAtRest


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


def without_loop(scenario: Scenario) -> str:
    """Return why a scenario has no linear loop whatever its gains are; "" where some gains may have one."""
    from hexservo.findings.analysis.linear_law import NoRestError
    from hexservo.findings.analysis.loop_of_scenario import NotApplicableError
    from hexservo.findings.analysis.scene import scene_of

    try:
        _loop_and_clock(scenario)
    except NotApplicableError as error:
        # where a loop rests depends on its gains, unless the body itself is not analysed
        may_rest = isinstance(error.__cause__, NoRestError) and not scene_of(scenario).unusual_body
        return "" if may_rest else str(error)
    return ""


def _camera_rate(scenario: Scenario, *, borders: bool) -> CameraRate | None:
    """Return the analysis of the camera's rate without its runs; None where it does not apply."""
    from hexservo.findings.analysis.camera_margins import loop_margins
    from hexservo.findings.analysis.camera_rate import CameraRate
    from hexservo.findings.analysis.loop_of_scenario import NotApplicableError

    try:
        at_rest, clock = _loop_and_clock(scenario)
    except NotApplicableError:
        return None
    free = loop_margins(at_rest.free, clock, borders=borders)
    smooth = None if at_rest.smooth is None else loop_margins(at_rest.smooth, clock, borders=borders)
    return CameraRate(at_rest.scenario, None, at_rest, clock, free, smooth)


def _loop_and_clock(scenario: Scenario) -> tuple[LoopAtRest, Clock]:
    """Return the linear loop of a scenario with its camera's times.

    Raises
    ------
    NotApplicableError
        It has none, or too many frames are under way at once.
    """
    from hexservo.findings.analysis.camera_rate import clock_of_loop
    from hexservo.findings.analysis.loop_of_scenario import loop_at_rest

    at_rest = loop_at_rest(scenario)
    return at_rest, clock_of_loop(at_rest)


LOOP_NUMBERS: Mapping[str, tuple[str, Callable[[Scenario], float]]] = {
    "decay_rate": ("1/s", decay_rate),
    "delay_margin": ("s", delay_margin),
}
"""Name -> (unit, function of the scenario)."""
