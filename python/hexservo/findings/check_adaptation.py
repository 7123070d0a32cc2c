"""An adaptation, and its drive, with which the linear loop oscillates, and the largest that it bears."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, clock_of, loop_at_home
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.bisection import last_that_holds
from hexservo.findings.check_lag import is_late
from hexservo.findings.home_loop import oscillates
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

    def unstable(drive: float, adaptation: float = 1.0) -> bool:
        proportional = {
            name: drive * adaptation * getattr(loop, name) for name in ("drive_frame", "drive_pose")
        }  # to the pose error
        changed = replace(loop, **proportional, drive_twist=adaptation * loop.drive_twist)
        return oscillates(changed, None if continuous else clock)

    if not unstable(1.0) or unstable(_LEAST, _LEAST) or (not continuous and is_late(loop, clock)):
        return
    key = f"controller.{law}"
    without = "where kv does not hold it" if np.any(scenario.controller.gains.kv) else "about rest"
    fits = f"{key}.auto.bandwidth fits one"
    if not unstable(_LEAST):
        factor = last_that_holds(lambda drive: not unstable(drive), _LEAST, 1.0, _HALVINGS, logarithmic=True)
        drive = np.unique(factor * np.asarray(value_at(scenario, f"{key}.drive"), dtype=float))
        value = f", {below(float(drive[0]))} 1/s" if len(drive) == 1 else ""
        own = f"{number(float(np.max(value_at(scenario, f'{key}.drive'))))} 1/s"
        yield (
            f"{key}.drive: with {'up to ' if not value else ''}{own} the linear loop oscillates {without}, since the "
            f"fuzzy systems integrate too fast; it is stable with up to {below(factor)} times this drive{value}; {fits}"
        )
        return
    factor = last_that_holds(lambda adaptation: not unstable(1.0, adaptation), _LEAST, 1.0, _HALVINGS, logarithmic=True)
    yield (
        f"{key}.fuzzy.adaptation: with this adaptation the linear loop oscillates {without}, since the fuzzy systems "
        f"learn too fast; it is stable from {number(1.0 / factor)} times these values on, with which they learn more "
        f"slowly; {fits}"
    )
