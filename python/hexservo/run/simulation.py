"""Runs a scenario in the core."""

from __future__ import annotations

from typing import cast

import numpy as np

from hexservo import _core
from hexservo.run.custom_controller import OwnController, function_name, run_with
from hexservo.run.metrics import METRICS
from hexservo.run.quantities import Outcome, quantities
from hexservo.run.result import LimitEvent, LimitKind, Result
from hexservo.run.variant import chosen_kernel
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.wording import wrong_type


def simulate(scenario: Scenario, *, controller: OwnController | None = None, log_weights: bool = False) -> Result:
    """Run a scenario from ``simulation.start``, by default home, at rest (docs/model.md, sections 3 to 8).

    The closed loop runs in the core, without the interpreter's lock. A run that diverges, loses its target or meets a
    singular pose is a result, with its outcome, its time and its last good sample. Ctrl-C ends the run with the
    outcome ``interrupted`` and keeps what was computed.

    Parameters
    ----------
    scenario
        What is run.
    controller
        A function to be called at every servo tick in place of the scenario's law, in sampled mode alone. It takes an
        `Observation` and gives a wrench in B about E's origin, (6,) [N; N m], or `LegForces`; where the drives take
        positions, `LegPositions`. Until every point has been seen once, what acts is the wrench that holds the
        platform, whatever it gives; drives that take positions go where they are sent. `Controller.step` takes the
        observation's `pixels`, not its `features`. Python sets the pace: a few hundred thousand ticks a second at the
        very most.
    log_weights
        Whether `Result.weight_history` holds the weights of the fuzzy systems at every logged sample, (n, 6, 7, 7)
        [N, N m]: 2.4 kB each, within the limit that a log has. It stays None where no fuzzy systems act: for other
        laws, where they are switched off, and with a custom controller.

    Raises
    ------
    TypeError
        For anything but a `Scenario`, for a controller that cannot be called, and for ``log_weights`` that is no
        boolean.
    ValueError
        For a scenario that the core refuses (a `Scenario` is checked when it is made, so this is rare); where the log
        would not fit because of the weights; for a command that the drives do not take, of another shape or with
        numbers that are not finite, or leg forces whose wrench is not, with its tick. What the controller itself raises
        goes through as it is.
    ScenarioError
        For a controller in continuous mode.
    VariantError
        Where the environment variable HEXSERVO_VARIANT asks for a compiled variant that is not there.
    """
    require_scenario(scenario)
    if not isinstance(log_weights, bool | np.bool_):
        raise wrong_type("log_weights", "True or False", log_weights)
    if controller is None:
        run = _core.simulate(core_parameters(scenario), chosen_kernel(), bool(log_weights))
    elif callable(controller):
        run = run_with(scenario, controller)
    else:
        raise wrong_type("controller", "a function of an Observation", controller)
    arrays = ("time", *quantities(run.depth.shape[1]), "fuzzy_weights", "weight_history")
    return Result(
        scenario=scenario,
        controller=scenario.controller.law if controller is None else function_name(controller),
        outcome=cast("Outcome", run.outcome.name),
        end_time=run.end_time,
        detail=run.detail,
        events=tuple(_limit_event(event, scenario.robot.legs == "rotary") for event in run.events),
        streamed_metrics={name: getattr(run.metrics, name) for name in METRICS},
        **{name: getattr(run, name) for name in arrays},
    )


def uninterrupted(result: Result) -> Result:
    """Return a run for findings: it was not interrupted.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C ended it: what it has is incomplete.
    """
    if result.outcome == "interrupted":
        raise KeyboardInterrupt
    return result


def _limit_event(event: _core.LimitEvent, rotary: bool) -> LimitEvent:
    """Count legs from 1, as the paper does."""
    kind = cast("LimitKind", event.kind.name)
    return LimitEvent(kind, event.leg + 1, event.first_time, event.peak, event.limit, rotary)
