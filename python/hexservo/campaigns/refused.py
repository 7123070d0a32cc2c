"""Draws that are no valid scenario: what is stated of them, and what to do."""

from __future__ import annotations

import re
from collections.abc import Callable

from hexservo.scenario.yaml import ScenarioError

_PLACE = re.compile(r"^scenario (?P<index>[0-9]+): ", re.MULTILINE)
REMEDY = "narrow or clip what varies"


def refused_scenario(error: ValueError) -> int | None:
    """Return which scenario of a batch an error of `simulate_batch` is about; None for another error."""
    place = _PLACE.search(str(error))
    return None if place is None else int(place["index"])


def refused_draw(error: ValueError, named: Callable[[int], str], remedy: str = REMEDY) -> ScenarioError:
    """Return an error of a batch of draws with the remedy, and the draw in place of its place in the batch.

    Parameters
    ----------
    error
        Of `simulate_batch`, about one of its scenarios.
    named
        Takes the place of a scenario in the batch, and returns what its draw is called: ``run 17``.
    remedy
        As a clause.
    """
    lines = [_PLACE.sub(lambda place: f"{named(int(place['index']))}: ", line) for line in str(error).splitlines()]
    return ScenarioError([f"{line}; {remedy}" for line in lines])
