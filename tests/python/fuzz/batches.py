"""Single runs against batches: whether a difference is rounding that the loop amplifies (docs/batch.md)."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

import hexservo as hs
from fuzz.scenarios import draw
from hexservo.run import variant as kernels
from hexservo.scenario.keys import value_at

__all__ = ["Ending", "batch_and_single_run", "endings", "spread"]

KEY = "uncertainty.depth"  # varied in every batch, since every law's scenario has it
_NUDGES = 12
_ROUNDING = 1e-9  # of what is compared, relative to its size: more than this is amplified, or a defect
_COMPARED = {"feature_error": 1.0, "position": 1e-3, "twist": 1e-3}  # with what is small of it: px, m, m/s and rad/s


@dataclass(frozen=True)
class Ending:
    """How a run ended."""

    outcome: str
    end_time: float
    settling: float
    state: np.ndarray  # what is compared, each in units of what is small of it


@contextlib.contextmanager
def variant(name: str) -> Iterator[None]:
    """Have runs made by one of the compiled variants."""
    before = kernels._CHOSEN
    kernels._CHOSEN = kernels.load_kernel(name)
    try:
        yield
    finally:
        kernels._CHOSEN = before


def single(scenario: hs.Scenario) -> Ending:
    """Run a scenario alone."""
    result = hs.simulate(scenario)
    state = np.concatenate([getattr(result, name)[-1] / unit for name, unit in _COMPARED.items()])
    return Ending(result.outcome, result.end_time, hs.metrics(result)["settling_time"], state)


def in_a_batch(scenario: hs.Scenario) -> Ending:
    """Run a scenario in a lane, beside two others that have a different depth error."""
    own = np.broadcast_to(scenario.uncertainty.depth, scenario.target.count)
    errors = np.array([own, 0.5 * own, -0.5 * own])
    batch = hs.simulate_batch(scenario, {KEY: errors}, threads=1)
    state = np.concatenate([batch.samples[name][0] / unit for name, unit in _COMPARED.items()])
    return Ending(str(batch.outcome[0]), float(batch.end_time[0]), float(batch.metrics["settling_time"][0]), state)


def nudged(scenario: hs.Scenario, seed: int) -> hs.Scenario:
    """Move the scenario's numbers by up to two units in the last place, at random: no symmetry survives."""
    random = np.random.default_rng(seed)
    changes: dict[str, Any] = {}
    for key in ("camera.focal_length", "target.desired_features", "target.initial_features", "target.points",
                "robot.mass", "robot.home_position", "robot.platform_angles", "robot.base_angles"):  # fmt: skip
        value = value_at(scenario, key)
        if value is not None:
            values = np.array(value, dtype=float)
            changes[key] = (values + random.integers(-2, 3, size=values.shape) * np.spacing(values)).tolist()
    return scenario.updated(changes)


def endings(scenario: hs.Scenario) -> dict[str, Ending]:
    """Run a scenario in every way that differs from the others by rounding alone."""
    found = {}
    for name in kernels.available_variants():
        with variant(name):
            found[f"single run, {name}"] = single(scenario)
            found[f"batch, {name}"] = in_a_batch(scenario)
    for seed in range(_NUDGES):
        with contextlib.suppress(hs.ScenarioError):
            found[f"single run, moved by 2 ulp at most ({seed})"] = single(nudged(scenario, seed))
    return found


def differ(one: Ending, other: Ending) -> bool:
    """Tell whether two endings differ by more than a rounding could, unamplified."""
    if (one.outcome, one.end_time) != (other.outcome, other.end_time):
        return True
    if math.isnan(one.settling) != math.isnan(other.settling):
        return True
    return bool(np.any(np.abs(one.state - other.state) > _ROUNDING * np.maximum(1.0, np.abs(one.state))))


def spread(ending: Ending, others: list[Ending]) -> float:
    """Give the largest distance to others; infinite where one of them ends in another way."""
    if any((other.outcome, other.end_time) != (ending.outcome, ending.end_time) for other in others):
        return math.inf
    return max((float(np.abs(other.state - ending.state).max()) for other in others), default=0.0)


def batch_and_single_run(random: Generator, folder: Path) -> str:
    """Compare a single run with a lane; where they differ, the other roundings of the same run must spread as far.

    "As far" is a tenth of the difference: both are single draws from what the loop makes of rounding.
    """
    scenario = draw(random, steps=6000, budget=6000, million=False).scenario
    if scenario is None:
        return "refused"
    alone, lane = single(scenario), in_a_batch(scenario)
    if not differ(alone, lane):
        return "agree"
    found = endings(scenario)
    others = [ending for name, ending in found.items() if name.startswith("single run")]
    difference, natural = spread(alone, [lane]), spread(alone, others)
    settles = {math.isnan(ending.settling) for ending in others}
    verdicts_differ = math.isnan(alone.settling) != math.isnan(lane.settling)
    assert natural >= 0.1 * difference, (difference, natural, scenario.to_yaml())
    if difference == math.inf:
        return "amplified: other outcome or end"
    if verdicts_differ:
        return "amplified: settles or not" + ("" if len(settles) > 1 else ", in the batch alone")
    return f"amplified: 1e{math.floor(math.log10(difference)):+d}"
