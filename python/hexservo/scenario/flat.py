"""A scenario as the lines that the C interface takes: one key and its value each."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo import _core
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario


def flat(scenario: Scenario) -> dict[str, str]:
    """Return every key of the core with its value as text, what Python derives from other keys included.

    Names are as they are, numbers have spaces between and read back bit for bit, arrays lie row by row, and what is
    null is "none". ``controller.law`` is first: `hexservo_scenario_set_text` of hexservo.h takes them in this order.

    Raises
    ------
    ValueError
        As `core_parameters`.
    """
    settings = core_parameters(scenario)
    keys = {key.name: _text(key, settings[key.name]) for key in _core.scenario_keys(settings.law)}
    return {"controller.law": settings.law, **keys}


def core_values(scenario: Scenario) -> dict[str, Any]:
    """Return the same keys as data for JSON: numbers, flat lists, null, and text for names and the seed."""
    settings = core_parameters(scenario)
    values = {key.name: plain_value(key, settings[key.name]) for key in _core.scenario_keys(settings.law)}
    return {"controller.law": settings.law, **values}


def plain_value(key: _core.ScenarioKey, value: Any) -> Any:
    """Return the value of a key as data for JSON."""
    if key.type == "seed":  # which no double holds
        return str(value)
    if is_none(key, value):
        return None
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    return int(value) if isinstance(value, bool) else value


def flat_text(scenario: Scenario) -> str:
    """Return the lines ``key value`` of `flat`."""
    return "".join(f"{key} {value}\n" for key, value in flat(scenario).items())


def is_none(key: _core.ScenarioKey, value: Any) -> bool:
    """Return whether a value stands for null: nothing, or the number that the core has for it."""
    return value is None or (key.none is not None and bool(np.all(value == key.none)))


def _text(key: _core.ScenarioKey, value: Any) -> str:
    if isinstance(value, str):
        return value
    if is_none(key, value):
        return "none"
    numbers = [float(number) for number in np.ravel(value)] if key.type in ("number", "array", "samples") else [value]
    return " ".join(repr(number if isinstance(number, float) else int(number)) for number in numbers)
