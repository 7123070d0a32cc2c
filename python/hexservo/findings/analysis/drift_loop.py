"""The linear sampled loop under unequal depth errors, where legs take forces (docs/analysis/drift.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.camera_margins import Margins, loop_margins
from hexservo.findings.analysis.camera_rate import clock_of_loop
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, loop_at_rest
from hexservo.findings.analysis.scene import scene_of
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

LEAST = 1e-6
"""Smallest |delta_Z| at which a loop that is stable with exact depths is examined."""

_STEP = 4.0  # from one size to the next smaller one, until it is stable
_ROUNDS = 10  # of bisection between the last two of these, in the logarithm: to 0.14 % of the size


@dataclass(frozen=True)
class LoopUnderErrors:
    """What the loop with inertia, sensors and actuators does where the rates of a drift are positive."""

    own: Margins  # with the scenario's own depth errors
    stable_if_exact: bool  # with exact depths
    # |delta_Z| up to which it is stable with all signs; None: up to the drift's limit; 0: below `LEAST`, or unstable
    # with exact depths too
    limit: float | None
    signs: Array  # (p,) +1 or -1, with which it grows first; of no meaning without a limit, or if unstable if exact

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
        Of the depth errors that are searched, (n, p). One with which the loop rests nowhere near its goal is left out.
    largest
        Their largest size |delta_Z|.
    """

    def margins(errors: Array) -> Margins:
        at_rest = loop_at_rest(scenario.updated({"uncertainty.depth": errors.tolist()}))
        radius = scene_of(at_rest.scenario).platform_radius
        return loop_margins(at_rest.free, clock_of_loop(at_rest), radius, borders=False)

    def growing(size: float, candidates: Sequence[Array]) -> dict[int, float]:
        """Return the growth [1/s] with each candidate, by its number, that makes the loop unstable at a size."""
        found = {}
        for number, candidate in enumerate(candidates):
            try:
                at_size = margins(size * candidate)
            except NotApplicableError:
                continue
            if not at_size.stable:
                found[number] = at_size.rate
        return found

    def fastest(grows: dict[int, float], candidates: Sequence[Array]) -> Array:
        return candidates[max(grows, key=lambda number: grows[number])]

    try:
        at_own, exact = margins(own), margins(np.zeros_like(own))
    except NotApplicableError:
        return None
    candidates = list(signs)
    if not exact.stable:
        return LoopUnderErrors(at_own, False, 0.0, candidates[0])
    grows = growing(largest, candidates)
    if not grows:
        return LoopUnderErrors(at_own, True, None, candidates[0])
    low, high, worst = 0.0, largest, fastest(grows, candidates)
    candidates = [candidates[number] for number in grows]
    rounds = 0
    while rounds < _ROUNDS and high > LEAST:
        size = math.sqrt(low * high) if low > 0.0 else max(high / _STEP, LEAST)
        rounds += low > 0.0
        grows = growing(size, candidates)
        if grows:
            high, worst = size, fastest(grows, candidates)
            candidates = [candidates[number] for number in grows]
        else:
            low = size
    return LoopUnderErrors(at_own, True, low, worst)
