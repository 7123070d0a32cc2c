"""Draws that are no valid scenario: what is stated of them, and what to do."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.campaigns.drawing import PLACED
from hexservo.run.batch import simulate_batch
from hexservo.run.variations import columns_of
from hexservo.scenario.fitted import auto_of
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number
from hexservo.scenario.yaml import ScenarioError

_PLACE = re.compile(r"^scenario (?P<index>[0-9]+): ", re.MULTILINE)
_FITTED_TOGETHER = 16  # scenarios with gains of `auto`: 10 ms each, and again with each of them that is refused
FEW_DRAWS = 20  # of which no share is known
MOST_REFUSED = 0.5  # share of draws that are no valid scenarios: above it the file is in error
REMEDY = "narrow or clip what varies"
_DEPTH, _UNREACHABLE = "uncertainty.depth", "target.desired_features: expected features that some pose gives"
_ONE_DEPTH = (
    f"depth errors of each point deform a target that {PLACED[0]} or {PLACED[1]} displaces, and no pose gives the goal "
    f"image of its assumed points: use one depth error of all points ({_DEPTH} without `each`), leave the displacement "
    "out, or narrow them"
)


def refused_scenario(error: ValueError) -> int | None:
    """Return which scenario of a batch an error of `simulate_batch` is about; None for another error."""
    place = _PLACE.search(str(error))
    return None if place is None else int(place["index"])


class _ValidError(Exception):
    """All scenarios of a batch are valid: its runs begin."""


def valid_rows(
    scenario: Scenario,
    varied: Mapping[str, NDArray[Any]],
    count: int,
    *,
    required: bool = False,
    look: Callable[[int, int], None] | None = None,
) -> NDArray[np.intp]:
    """Return which of the scenarios of a batch are valid, in order; few of them are simulated, until one ends.

    Parameters
    ----------
    scenario, varied
        As for `simulate_batch`, which names the first scenario that is not valid. Gains are checked before the rest:
        where they vary, one before it may not be valid either, which a second call finds.
    count
        Scenarios in the batch.
    required
        Whether one that is not valid is an error.
    look
        Called with 0 and `count` between checks of a few scenarios; what it raises ends them.

    Raises
    ------
    ValueError
        As `simulate_batch`, unless it is about one of the scenarios, and these are not required to be valid.
    """

    def begun(done: int, of: int) -> None:
        if done:  # none while scenarios are checked
            raise _ValidError

    refused: list[int] = []
    is_fitted = auto_of(scenario).bandwidth is not None or any(".auto." in key for key in varied)
    together = _FITTED_TOGETHER if is_fitted else count
    for begin in range(0, count, together):
        rows = np.arange(begin, min(begin + together, count))
        while len(rows):
            if look is not None:
                look(0, count)
            try:
                simulate_batch(scenario, rows_of(varied, rows), "metrics", progress=begun, metrics=())
                break
            except _ValidError:
                break
            except ValueError as error:
                place = refused_scenario(error)
                if place is None or required:
                    raise
                refused.append(int(rows[place]))
                rows = rows[place + 1 :]
    return np.delete(np.arange(count), refused)


def rows_of(varied: Mapping[str, NDArray[Any]], rows: NDArray[np.intp]) -> dict[str, NDArray[Any]]:
    """Return these scenarios of a batch; what all scenarios have in common stays."""
    return {key: values if len(values) == 1 else values[rows] for key, values in varied.items()}


def refused_draw(
    error: ValueError,
    scenario: Scenario,
    numbers: Mapping[str, NDArray[Any]],
    named: Callable[[int], str],
    remedy: str = REMEDY,
) -> ScenarioError:
    """Return an error of a batch of draws with the remedy, and the draw in place of its place in the batch.

    Parameters
    ----------
    error
        Of `simulate_batch`, about one of its scenarios.
    scenario
        That is varied.
    numbers
        That were drawn, as those of `Drawing.numbers`.
    named
        Takes the place of a scenario in the batch, and returns what its draw is called: ``run 17``.
    remedy
        As a clause.
    """
    lines = []
    for line in str(error).splitlines():
        found = _PLACE.match(line)
        if found is None:
            lines.append(f"{line}; {remedy}")
            continue
        row, problem = int(found["index"]), line[found.end() :]
        name, clause = named(row), remedy
        if problem.startswith(_UNREACHABLE) and _deformed(scenario, numbers, row):
            drawn = shown_numbers({key: numbers[key] for key in (_DEPTH, *PLACED) if key in numbers}, row)
            if not all(one in name for one in drawn):
                name = f"{name} ({', '.join(drawn)})"
            clause = _ONE_DEPTH
        lines.append(f"{name}: {problem}; {clause}")
    return ScenarioError(lines)


def _deformed(scenario: Scenario, numbers: Mapping[str, NDArray[Any]], row: int) -> bool:
    """Return whether a draw displaces the target, and has a depth error of each point."""
    depth = numbers.get(_DEPTH, np.array([scenario.uncertainty.depth]))
    return any(key in numbers for key in PLACED) and float(np.ptp(depth[0 if len(depth) == 1 else row])) > 0.0


def shown_numbers(numbers: Mapping[str, NDArray[Any]], row: int) -> list[str]:
    """Return the numbers of one draw, without a seed, each with its name."""
    return [
        f"{name} {number(float(column[0 if len(column) == 1 else row]), 4)}"
        for key, values in numbers.items()
        if key != "seed"
        for name, column in columns_of(key, values).items()
    ]
