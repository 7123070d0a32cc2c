"""Drives of forces whose delay and lag make the linear loop oscillate, and those with which it does not."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hexservo.findings.analysis.linear_loop import Clock, SampledLoop
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, clock_of, lag, loop_at_home, loop_at_rest
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.bisection import last_that_holds
from hexservo.findings.home_loop import oscillates
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import above, quantity

_FASTEST = 100.0  # of bandwidths that are looked at, in units of the servo rate: the lag is 1/600 of a period
_HALVINGS = 30  # of the logarithm of a bandwidth


def prompt(loop: SampledLoop) -> SampledLoop:
    """Return a loop whose drives have neither delay nor lag."""
    return replace(loop, actuation=replace(loop.actuation, delay=0, left=0.0, left_on_average=0.0))


def has_late_drives(loop: SampledLoop) -> bool:
    """Return whether the drives of a loop have delay or lag."""
    return loop.actuation.delay > 0 or loop.actuation.left_on_average > 0.0


def is_late(loop: SampledLoop, clock: Clock) -> bool:
    """Return whether a loop oscillates by delay and lag of its drives alone."""
    return has_late_drives(loop) and oscillates(loop, clock) and not oscillates(prompt(loop), clock)


def of_lag(scene: Scene) -> Iterator[str]:
    """Yield a sentence where delay and lag of the drives make a linear loop oscillate that is stable without them.

    The loop with K_v = 0 at home and where it rests, as `loop_at_home` and `loop_at_rest` have it, in sampled mode.
    """
    scenario = scene.scenario
    if not scenario.sampled:
        return
    clock, late = clock_of(scenario), _late_loops(scenario)
    if not late or not any(oscillates(loop, clock) for loop in late):
        return
    actuators, tick = scenario.actuators, scenario.simulation.step

    def fails(bandwidth: float | None, delay: int) -> bool:
        left, average = lag(bandwidth, tick)
        return any(
            oscillates(
                replace(loop, actuation=replace(loop.actuation, delay=delay, left=left, left_on_average=average)), clock
            )
            for loop in late
        )

    has, ticks = actuators.bandwidth, late[0].actuation.delay
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


def _late_loops(scenario: Scenario) -> list[SampledLoop]:
    """Return the loops, at home and at rest, whose drives have delay or lag, without which they do not oscillate."""
    clock, loops = clock_of(scenario), []
    for linearised in (loop_at_home, lambda of: loop_at_rest(of).free):
        with contextlib.suppress(NotApplicableError):
            loops.append(linearised(scenario))
    return [
        loop
        for loop in loops
        if clock.latency // clock.period <= loop.few and has_late_drives(loop) and not oscillates(prompt(loop), clock)
    ]
