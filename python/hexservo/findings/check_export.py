"""What is to be known of an exported controller before a robot moves by it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import evaluated, known_rate
from hexservo.findings.check_brake import judged_run, of_brake
from hexservo.findings.check_period import of_period
from hexservo.run.controller import tick_keys
from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.keys import value_at
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import quantity

_ASSUMED = ("depth", "focal_length", "principal_point", "mount.position", "mount.rotation", "latency")
"""Keys of ``uncertainty`` that are errors of what the controller assumes."""

_ROUNDING = 1e-9  # of a ratio of times


def robot_notes(scenario: Scenario, period: float | None = None) -> list[str]:
    """Return what is to be known of an exported controller before a robot moves by it, one sentence each.

    A simulated camera is never unplugged, and its errors are wanted: on a robot a missing ``camera.timeout`` means that
    the last image is used for ever, and the errors of ``uncertainty`` that are the controller's spoil its estimates. An
    error that its law does not assume, as of depth where it does not use a model of the target's points, is none of
    them. A period that no run of the scenario has is judged by the poles (`of_period`) and by a run in sampled mode.

    Parameters
    ----------
    scenario
        Of the controller.
    period
        Time between two of its ticks [s], one that the controller takes; None: the scenario's ``simulation.step``.
    """
    period = scenario.simulation.step if period is None else period
    notes = [*_of_timeout(scenario), *_of_period(scenario, period)]
    notes += evaluated(lambda scene: of_brake(scene, period), scene_of(scenario))
    if scenario.actuators.kind == "force" and not scenario.actuators.saturation:
        notes.append(
            "robot.force_limit is not in the controller, so that saturated stays 0, and the weights do not wait, where "
            "a leg needs more: set actuators.saturation=true for a robot"
        )
    return notes + _of_assumptions(scenario)


def _of_timeout(scenario: Scenario) -> Iterator[str]:
    if not scenario.sampled:
        yield (
            "the last image is used for ever if no other comes, since a scenario in continuous mode has no timeout: "
            "set simulation.mode=sampled and camera.timeout for a robot"
        )
    elif scenario.camera.timeout is None:
        yield "the last image is used for ever if no other comes: set camera.timeout for a robot"


def _of_period(scenario: Scenario, period: float) -> Iterator[str]:
    """Find a servo period that the loop is too fast for: by its poles, and by a run where the scenario's has another.

    Poles do not show what holds a law with dry friction in place of damping (`hybrid`), which runs do.
    """
    continuous = not scenario.sampled
    changes: dict[str, Any] = {"simulation.mode": SAMPLED_MODE} if continuous else {}
    if not math.isclose(period, scenario.simulation.step, rel_tol=_ROUNDING):
        ticks = math.ceil(scenario.simulation.duration / period * (1.0 - _ROUNDING))
        changes["simulation.step"] = period
        if not math.isclose(ticks * period, scenario.simulation.duration, rel_tol=_ROUNDING):
            changes["simulation.duration"] = ticks * period
    remark = f"; run the scenario with {_pasted(changes)} before a robot" if changes else ""
    if continuous:
        remark = f", and a run in continuous mode has no servo period{remark}"
    coarse = list(of_period(scenario, known_rate(scenario), period))
    for sentence in coarse:
        yield sentence + remark
    run = judged_run(scenario.updated(changes)) if changes else None
    if run is not None and run.outcome != "completed":
        yield f"a run with the servo period of {quantity(period, 's')} ends as {run.outcome}: {run.detail}" + (
            "" if coarse else remark
        )


def _pasted(changes: dict[str, Any]) -> str:
    *first, last = (f"{key}={value if isinstance(value, str) else f'{value:.12g}'}" for key, value in changes.items())
    return f"{', '.join(first)} and {last}" if first else last


def _of_assumptions(scenario: Scenario) -> list[str]:
    settings = core_parameters(scenario)
    used = {key.name for key in tick_keys(settings)}
    if not settings.needs_goal:  # the depths are measured
        used.discard("uncertainty.depth")
    assumed = (key for key in (f"uncertainty.{name}" for name in _ASSUMED) if key in used)
    wrong = [key for key in assumed if np.any(np.asarray(value_at(scenario, key), float) != 0.0)]
    if not wrong:
        return []
    return [
        f"the controller assumes what the scenario has it assume wrongly ({', '.join(wrong)}): "
        "set that to 0 for a robot"
    ]
