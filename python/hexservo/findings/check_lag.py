"""Drives of forces whose delay and lag make the linear loop oscillate, and those with which it does not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hexservo.findings.analysis.linear_loop import Clock, SampledLoop
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, clock_of, lag, loop_at_home
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.bisection import last_that_holds
from hexservo.findings.home_loop import oscillates
from hexservo.scenario.wording import above, quantity

_FASTEST = 100.0  # of bandwidths that are looked at, in units of the servo rate: the lag is 1/600 of a period
_HALVINGS = 30  # of the logarithm of a bandwidth


def prompt(loop: SampledLoop) -> SampledLoop:
    """Return a loop whose drives have neither delay nor lag."""
    return replace(loop, actuation=replace(loop.actuation, delay=0, left=0.0, left_on_average=0.0))


def is_late(loop: SampledLoop, clock: Clock) -> bool:
    """Return whether a loop oscillates by delay and lag of its drives alone."""
    acts = loop.actuation.delay > 0 or loop.actuation.left_on_average > 0.0
    return acts and oscillates(loop, clock) and not oscillates(prompt(loop), clock)


def of_lag(scene: Scene) -> Iterator[str]:
    """Yield a sentence where delay and lag of the drives make a linear loop oscillate that is stable without them.

    The loop with K_v = 0, as `loop_at_home` has it, in sampled mode.
    """
    scenario = scene.scenario
    if not scenario.sampled:
        return
    try:
        loop, clock = loop_at_home(scenario), clock_of(scenario)
    except NotApplicableError:
        return
    if clock.latency // clock.period > loop.few or not is_late(loop, clock):
        return
    actuators, tick = scenario.actuators, scenario.simulation.step

    def fails(bandwidth: float | None, delay: int) -> bool:
        left, average = lag(bandwidth, tick)
        with_drives = replace(loop.actuation, delay=delay, left=left, left_on_average=average)
        return oscillates(replace(loop, actuation=with_drives), clock)

    has, ticks = actuators.bandwidth, loop.actuation.delay
    fastest = _FASTEST / tick
    keys, values, remedy = ["actuators.bandwidth", "actuators.delay"], [], "with neither"
    if has is not None:
        values.append(f"a bandwidth of {quantity(has, 'Hz')}")
    if ticks:
        values.append(f"a delay of {quantity(actuators.delay, 's')}")
    if has is not None and has < fastest and not fails(fastest, ticks):
        least = last_that_holds(
            lambda bandwidth: not fails(bandwidth, ticks), fastest, has, _HALVINGS, logarithmic=True
        )
        keys, remedy = keys[:1], f"from {above(least, 2)} Hz on"
    elif ticks and not fails(has, 0):
        most = next(delay for delay in range(ticks - 1, -1, -1) if not fails(has, delay))
        keys, remedy = keys[1:], f"with up to {quantity(most * tick, 's')}" if most else "without it"
    without = "where kv does not hold it" if np.any(getattr(scenario.controller.gains, "kv", 0.0)) else "about rest"
    yield (
        f"{', '.join(keys)}: with {' and '.join(values)} the linear loop oscillates {without}, since the forces of "
        f"the drives come late; it is stable {remedy}, or with slower gains"
    )
