"""Common parts of the scenarios of a batch, and the numbers in which they differ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import auto_of, fitted_keys
from hexservo.scenario.keys import NumericKey, acting_keys
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.scenario import Scenario

_ALWAYS = "uncertainty.gravity"  # varies in every batch, be it by nothing


def numbers_of(scenario: Scenario) -> dict[str, Any]:
    """Return the values that a batch may vary, by dotted key, in the widest shape of each; grids are shared.

    Gains are among them, so what they were fitted to is not.
    """
    keys = acting_keys(scenario.controller.law, scenario.simulation.mode, scenario.target.count)
    mapping = scenario.to_mapping()
    numbers = {}
    for key, rule in keys.items():
        value: Any = mapping
        for name in key.split("."):
            value = value[name]
        if key.startswith(("simulation.", _auto(scenario))) or value is None or isinstance(value, str):
            continue
        numbers[key] = widest(rule, value)
    return numbers


def widest(rule: NumericKey, value: Any) -> NDArray[Any]:
    """Return a value in the widest shape of its key: a number may stand for all entries, or a list for a diagonal."""
    array, shape = np.asarray(value, dtype=rule.dtype), max(rule.shapes, key=len)
    if array.shape == shape:
        return array
    return np.diag(array) if array.ndim else np.full(shape, array)


def shared_by(scenario: Scenario) -> dict[str, Any]:
    """Return what the scenarios of a batch have in common: everything but names, numbers, and gains of other laws."""
    mapping = scenario.to_mapping()
    shared = {key: value for key, value in mapping.items() if key not in ("name", "description")}
    controller = shared["controller"] = dict(shared["controller"])
    for law in ALL_LAWS:
        if law != scenario.controller.law:
            controller.pop(law, None)
    law = scenario.controller.law
    controller[law] = {key: value for key, value in controller[law].items() if key != "auto"}
    for key in numbers_of(scenario):
        *blocks, last = key.split(".")
        inner = shared
        for block in blocks:
            inner[block] = dict(inner[block])
            inner = inner[block]
        inner[last] = "varies"
    return shared


def variations_of(scenarios: Sequence[Scenario]) -> dict[str, Array]:
    """Return the numbers in which scenarios differ, for `simulate_batch`, which asks for one at least.

    Gains that `auto` fits are given for each, so that none is fitted again.
    """
    numbers = [numbers_of(scenario) for scenario in scenarios]
    variations = {key: np.stack([own[key] for own in numbers]) for key in numbers[0]}
    always = {_ALWAYS}
    if any(auto_of(scenario).bandwidth is not None for scenario in scenarios):
        law = scenarios[0].controller.law
        always |= {f"controller.{law}.{key}" for key in fitted_keys(law)}
    return {key: values for key, values in variations.items() if key in always or (values != values[0]).any()}


def _auto(scenario: Scenario) -> str:
    return f"controller.{scenario.controller.law}.auto."
