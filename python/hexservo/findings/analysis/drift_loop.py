"""The linear sampled loop under unequal depth errors, where legs take forces (docs/analysis/drift.md)."""

from __future__ import annotations

from dataclasses import dataclass

from hexservo.findings.analysis.camera_margins import Margins, loop_margins
from hexservo.findings.analysis.camera_rate import clock_of_loop
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, loop_at_rest
from hexservo.findings.analysis.scene import scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

_ROUNDS = 6  # of bisection: to 1/64 of the drift's limit


@dataclass(frozen=True)
class LoopUnderErrors:
    """What the loop with inertia, sensors and actuators does where the rates of a drift are positive."""

    own: Margins  # with the scenario's own depth errors
    limit: float | None  # |delta_Z| up to which it is stable at `signs`; None: up to the drift's limit; 0: not even so
    signs: Array  # (p,) +1 or -1

    def grows_at(self, size: float) -> bool:
        """Return whether it grows for some pattern of a size |delta_Z|."""
        return self.limit is not None and size > self.limit


def loop_under_errors(scenario: Scenario, own: Array, signs: Array, largest: float) -> LoopUnderErrors | None:
    """Compute the stability of the linear loop with depth errors; None where it does not apply.

    Parameters
    ----------
    scenario
        Of legs that take forces.
    own
        Its own depth errors, (p,).
    signs
        Of the depth errors that are searched, (p,).
    largest
        Their largest size |delta_Z|.
    """

    def margins(errors: Array) -> Margins:
        at_rest = loop_at_rest(scenario.updated({"uncertainty.depth": errors.tolist()}))
        radius = scene_of(at_rest.scenario).platform_radius
        return loop_margins(at_rest.free, clock_of_loop(at_rest), radius, borders=False)

    try:
        at_own = margins(own)
        if margins(largest * signs).stable:
            return LoopUnderErrors(at_own, None, signs)
        low, high = 0.0, largest if margins(0.0 * signs).stable else 0.0
        for _ in range(_ROUNDS if high > 0.0 else 0):
            middle = (low + high) / 2
            low, high = (middle, high) if margins(middle * signs).stable else (low, middle)
    except NotApplicableError:
        return None
    return LoopUnderErrors(at_own, low, signs)
