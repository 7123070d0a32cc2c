"""Why a variation does not fit the key that it is of, as a plan of a campaign or of a search for gains states it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hexservo.campaigns.distributions import SEED, Variation
from hexservo.campaigns.drawing import PLACED
from hexservo.campaigns.tune_keys import Variable
from hexservo.run.variations import known_key
from hexservo.scenario.keys import value_at
from hexservo.scenario.pose_rules import problem_of_turns
from hexservo.scenario.rules import shown_value
from hexservo.scenario.scenario import Scenario

_PERIODS = "times that are whole numbers of servo periods (simulation.step)"
ON_GRID = {
    **dict.fromkeys(
        (
            "camera.period",
            "camera.latency",
            "camera.latency_jitter",
            "sensors.period",
            "actuators.delay",
            "uncertainty.latency",
            "simulation.duration",
        ),
        _PERIODS,
    ),
    "simulation.step": "steps that divide simulation.duration",
}
"""Keys that accept listed numbers alone, since hardly any between two ends is one of the grid -> that grid."""

_CHOSEN = "controller"  # the block whose keys a search for gains may choose


def unfit(scenario: Scenario, key: str, variation: Variation) -> str:
    """Return why a variation does not fit a key of the scenario; empty if it does."""
    if key in PLACED:
        return _unfit_place(scenario, key, variation)
    try:
        rule = known_key(key, scenario.controller.law, scenario.target.count, run="campaign")
    except ValueError as error:
        return str(error).partition(": ")[2]
    if variation.kind == SEED:
        return ""
    if rule.whole and variation.kind != "choice":
        return f"expected {{choice: [...]}} of integers, got {variation.kind}"
    if key in ON_GRID and variation.kind != "choice":
        return f"expected {{choice: [...]}} of {ON_GRID[key]}, got {variation.kind}"
    present = value_at(scenario, key)
    if variation.add and (present is None or isinstance(present, str)):
        return f"add: expected a scenario whose value is a number, got {shown_value(present)}"
    if variation.each and rule.shapes == ((),):
        return "each: expected a key that holds an array, got one that holds a number"
    if variation.symmetric and not any(len(shape) == 2 and shape[0] == shape[1] for shape in rule.shapes):
        return "symmetric: expected a key that holds a square matrix, got one that does not"
    base = np.asarray(present, dtype=float) if variation.add else np.zeros(1)
    if variation.kind == "choice" and not rule.within(np.add.outer(variation.parameters, base)).all():
        return f"choice: expected {rule.expected}, got {list(variation.parameters)}"
    low, high = variation.reach
    reached = np.array([low + base.min(), high + base.max()])
    if not (rule.whole or rule.within(reached).all()):
        return f"expected {rule.expected}, but it reaches {reached[0]:.4g} ... {reached[1]:.4g}; clip it or narrow it"
    if rule.pose and (problem := problem_of_turns(np.full(6, np.abs(reached).max()))) is not None:
        return f"{problem}, which it reaches; clip it or narrow it"
    return ""


def unfit_variable(scenario: Scenario, key: str, variable: Variable, vary: Mapping[str, Variation]) -> str:
    """Return why a variable does not fit a key of the scenario; empty if it does."""
    if key in vary:
        return "expected a key that vary does not have, got one that it has"
    if problem := unfit(scenario, key, variable.variation):
        return problem
    if not key.startswith(f"{_CHOSEN}."):
        return f"expected a gain, that is a key of {_CHOSEN}, got a key of {key.partition('.')[0]}"
    shapes = known_key(key, scenario.controller.law, scenario.target.count).shapes
    if variable.groups == (0,):
        return "" if () in shapes else "expected groups: the key takes an array alone"
    entries = max(shapes, key=len)
    if len(entries) != 1 or sum(variable.groups) != entries[0]:
        size = f"{entries[0]} entries" if len(entries) == 1 else "no list"
        return f"groups: expected sizes that add up to those of the key ({size}), got {list(variable.groups)}"
    return ""


def _unfit_place(scenario: Scenario, key: str, variation: Variation) -> str:
    """Return why a variation cannot displace the target of a scenario; empty if it can."""
    if scenario.camera.convention != "eye_in_hand":
        return "expected a scenario with camera.convention eye_in_hand, whose target has points in space"
    if variation.add or variation.symmetric:
        return "expected neither add nor symmetric for a displacement"
    farthest = np.full(6, np.abs(variation.reach).max())
    if key == PLACED[1] and (problem := problem_of_turns(farthest)) is not None:
        return f"{problem}, which it reaches; clip it or narrow it"
    return ""
