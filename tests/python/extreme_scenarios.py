"""Random legal scenarios far from the ordinary: numbers scaled by up to 300 decades, zeros and random signs."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

import hexservo as hs
from hexservo.scenario.keys import numeric_keys
from hexservo.scenario.laws import LAWS

__all__ = ["extreme_scenario"]

_DECADES = (1.0, 6.0, 30.0, 300.0)  # of the factors, and how often each of these ranges is drawn
_SHARES = (0.2, 0.4, 0.2, 0.2)
_STEPS = 300  # of a run at most: the number of steps is no question of range
_KEPT = ("seed", "simulation.step", "simulation.duration", "simulation.substeps", "simulation.log_every")


def extreme_scenario(seed: int, number: int) -> tuple[hs.Scenario, dict[str, Any]]:
    """Draw a packaged scenario with any law, and change one to five of its numeric keys as far as it accepts them.

    Parameters
    ----------
    seed, number
        Of the random stream: each pair is one scenario.

    Returns
    -------
        The scenario, and the keys that were changed, with their values.
    """
    random = np.random.default_rng([seed, number])
    scenario = hs.load_scenario(str(random.choice(hs.scenario_names())))
    scenario = scenario.updated({"simulation.duration": scenario.simulation.step * int(random.integers(1, _STEPS))})
    with suppress(hs.ScenarioError):  # a law may refuse a goal
        scenario = scenario.updated({"controller.law": str(random.choice(LAWS))})
    keys = numeric_keys(scenario.controller.law)
    wanted = int(random.integers(1, 6))
    changed: dict[str, Any] = {}
    for key in random.permutation([key for key in keys if key not in _KEPT]).tolist():
        if len(changed) == wanted:
            break
        value = _drawn(scenario, key, random)
        if value is None or not np.isfinite(value).all():
            continue
        if keys[key].symmetric and value.ndim == 2:
            value = np.diag(np.abs(np.diag(value)))
        if key.startswith("uncertainty."):  # relative errors, within +-1
            value = np.tanh(value) * (1.0 - 1e-12)
        try:
            scenario = scenario.updated({key: value.tolist()})
        except hs.ScenarioError:
            continue
        changed[key] = value.tolist()
    return scenario, changed


def _drawn(scenario: hs.Scenario, key: str, random: np.random.Generator) -> np.ndarray[Any, Any] | None:
    """Return a key's numbers, scaled, redrawn or zero; None for a key that is not numeric."""
    value: Any = scenario
    for part in key.split("."):
        value = getattr(value, part)
    if value is None or isinstance(value, str):
        return None
    now = np.asarray(value, dtype=float)
    decades = float(random.choice(_DECADES, p=_SHARES))
    factor = 10.0 ** random.uniform(-decades, decades)
    kind = random.uniform()
    if kind < 0.1:
        return 0.0 * now
    if kind < 0.2 or not now.any():
        return np.asarray((random.normal(size=now.shape) + now) * factor)
    return np.asarray(now * factor)
