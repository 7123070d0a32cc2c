"""An adaptation, and its drive, with which the linear loop oscillates, and the largest that it bears."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hexservo.findings.analysis.linear_loop import BORDER, Clock, SampledLoop
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, clock_of, loop_at_home
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.bisection import last_that_holds
from hexservo.findings.home_loop import adapting_matrix
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import laws_with
from hexservo.scenario.wording import below, number

_LEAST = 1e-6  # factor down to which a smaller drive or adaptation is looked for
_HALVINGS = 30  # of the logarithm of that factor


def of_adaptation(scene: Scene) -> Iterator[str]:
    """Yield a sentence where the weights of the fuzzy systems make a linear loop oscillate that is stable without them.

    The loop with K_v = 0, as `loop_at_home` has it: the weights on each axis are one integrator. In continuous mode it
    has no clocks.
    """
    scenario = scene.scenario
    law = scenario.controller.law
    if law not in laws_with("memory", "pose_error") or not scenario.controller.gains.fuzzy.enabled:
        return
    try:
        loop, clock = loop_at_home(scenario), clock_of(scenario)
    except NotApplicableError:
        return
    continuous = not scenario.sampled
    if not loop.axes or (not continuous and clock.latency // clock.period > loop.few):
        return

    def oscillates(drive: float, adaptation: float = 1.0) -> bool:
        proportional = {
            name: drive * adaptation * getattr(loop, name) for name in ("drive_frame", "drive_pose")
        }  # to the pose error
        changed = replace(loop, **proportional, drive_twist=adaptation * loop.drive_twist)
        return _oscillates(changed, None if continuous else clock)

    if not oscillates(1.0) or oscillates(_LEAST, _LEAST):
        return
    key = f"controller.{law}"
    without = "where kv does not hold it" if np.any(scenario.controller.gains.kv) else "about rest"
    fits = f"{key}.auto.bandwidth fits one"
    if not oscillates(_LEAST):
        factor = last_that_holds(lambda drive: not oscillates(drive), _LEAST, 1.0, _HALVINGS, logarithmic=True)
        drive = np.unique(factor * np.asarray(value_at(scenario, f"{key}.drive"), dtype=float))
        value = f", {below(float(drive[0]))} 1/s" if len(drive) == 1 else ""
        own = f"{number(float(np.max(value_at(scenario, f'{key}.drive'))))} 1/s"
        yield (
            f"{key}.drive: with {'up to ' if not value else ''}{own} the linear loop oscillates {without}, since the "
            f"fuzzy systems integrate too fast; it is stable with up to {below(factor)} times this drive{value}; {fits}"
        )
        return
    factor = last_that_holds(
        lambda adaptation: not oscillates(1.0, adaptation), _LEAST, 1.0, _HALVINGS, logarithmic=True
    )
    yield (
        f"{key}.fuzzy.adaptation: with this adaptation the linear loop oscillates {without}, since the fuzzy systems "
        f"learn too fast; it is stable from {number(1.0 / factor)} times these values on, with which they learn more "
        f"slowly; {fits}"
    )


def _oscillates(loop: SampledLoop, clock: Clock | None) -> bool:
    """Return whether a mode of a loop grows that is no drift (real, and positive); without a clock, in no ticks."""
    with np.errstate(over="ignore", invalid="ignore"):
        if clock is None:
            exponents = np.linalg.eigvals(adapting_matrix(loop, loop.acceleration, loop.tick))
            return bool(((exponents.real > (BORDER - 1.0) / loop.tick) & (np.abs(exponents.imag) > 0.0)).any())
        try:
            values = loop.multipliers(clock)
        except np.linalg.LinAlgError:  # numbers overflow
            return True
    return bool(((np.abs(values) > BORDER) & ((np.abs(values.imag) > 1e-9) | (values.real < 0.0))).any())
