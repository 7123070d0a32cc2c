"""Runs a scenario in the core."""

from __future__ import annotations

from typing import cast

from hexservo import _core
from hexservo._metrics import METRICS
from hexservo._parameters import core_parameters
from hexservo._result import LimitEvent, LimitKind, Outcome, Result
from hexservo._scenario import Scenario
from hexservo._variant import chosen_kernel

__all__ = ["simulate"]


def simulate(scenario: Scenario) -> Result:
    """Run a scenario from home, at rest (docs/model.md, sections 3 to 8).

    The closed loop runs in the core, without the interpreter's lock. A run that diverges, loses its target or meets a
    singular pose is a result, with its outcome, its time and its last good sample. Ctrl-C ends the run with the
    outcome ``interrupted`` and keeps what was computed.

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        For a scenario that the core refuses; a `Scenario` is checked when it is made, so this is rare.
    VariantError
        Where the environment variable HEXSERVO_VARIANT asks for a compiled variant that is not there.
    """
    if not isinstance(scenario, Scenario):
        raise TypeError(f"scenario: expected a Scenario (see hs.load_scenario), got {type(scenario).__name__}")
    run = _core.simulate(core_parameters(scenario), chosen_kernel())
    return Result(
        scenario=scenario,
        outcome=cast("Outcome", run.outcome.name),
        end_time=run.end_time,
        detail=run.detail,
        events=tuple(_limit_event(event) for event in run.events),
        time=run.time,
        feature_error=run.feature_error,
        depth=run.depth,
        position=run.position,
        quaternion=run.quaternion,
        twist=run.twist,
        wrench=run.wrench,
        fuzzy_output=run.fuzzy_output,
        leg_lengths=run.leg_lengths,
        leg_forces=run.leg_forces,
        fuzzy_weights=run.fuzzy_weights,
        streamed_metrics={name: getattr(run.metrics, name) for name in METRICS},
    )


def _limit_event(event: _core.LimitEvent) -> LimitEvent:
    """Count legs from 1, as the paper does."""
    return LimitEvent(cast("LimitKind", event.kind.name), event.leg + 1, event.first_time, event.peak, event.limit)
