"""Default gains on a machine that they are not of, and the bandwidth that takes their place (docs/gains.md)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import (
    Machine,
    auto_of,
    chosen_keys,
    fitted_gains,
    fitted_keys,
    gains_are_defaults,
    machine_of,
)
from hexservo.scenario.scenario import Scenario, load_scenario
from hexservo.scenario.wording import number

OF_DEFAULTS = "paper"
"""The packaged scenario of whose machine the default gains are."""

_FAR = {True: 3.0, False: 4.0}  # misfit from which on runs settle late or never, by whether damping is viscous
_AXES = 6  # more values of a gain are of features
_BANDWIDTHS = np.logspace(-8.0, 4.0, 1201)  # over that of the default gains


def taken_over(scenario: Scenario, law: str) -> dict[str, Any]:
    """Return the changes, by dotted key, that give a law the bandwidth and the damping that the scenario's own law has.

    Parameters
    ----------
    scenario
        With its own law.
    law
        One of `ALL_LAWS`.

    Returns
    -------
    dict
        Empty where the law is the scenario's own, where that has no ``auto.bandwidth``, and where the law has one too
        or has gains that are written.
    """
    own = auto_of(scenario)
    if law == scenario.controller.law or own.bandwidth is None or not gains_are_defaults(scenario, law):
        return {}
    key = f"controller.{law}.auto"
    return {f"{key}.bandwidth": own.bandwidth, f"{key}.damping": own.damping}


def misfit(scenario: Scenario) -> float:
    """Return by which factor default gains are away from those of any bandwidth on the scenario's machine, at least 1.

    Of the gains that set how the platform moves, the largest factor with the bandwidth for which it is least. On the
    machine of which the defaults are it is 1: the factor is that between the two machines. It is 1 too where such a
    gain is fitted or written, and for legs that do not take forces, whose platform moves as it is sent.
    """
    law, traits = scenario.controller.law, scenario.controller.traits
    keys = _of_motion(law, viscous=traits.viscous)
    if scenario.actuators.kind != "force" or traits.output == "pose" or auto_of(scenario).bandwidth is not None:
        return 1.0
    if not keys.isdisjoint(chosen_keys(scenario)):
        return 1.0
    here, there = _logarithms(law, machine_of(scenario), _BANDWIDTHS, keys), _of_defaults(law, keys)
    with np.errstate(invalid="ignore", over="ignore"):
        return float(np.exp(np.abs(here - there).max(axis=1).min()))


def is_far(scenario: Scenario) -> bool:
    """Return whether the law has default gains that are far from those of any bandwidth on the scenario's machine."""
    return misfit(scenario) > _FAR[scenario.controller.traits.viscous]


def platform_of_defaults() -> str:
    """Return the platform of which the default gains are, as a sentence names it."""
    return f"a platform of {number(1e3 * load_scenario(OF_DEFAULTS).robot.mass)} g"


def _of_motion(law: str, *, viscous: bool) -> frozenset[str]:
    """Return the gains that set how a platform moves: spring, damping and rate, or what damps in place of viscosity."""
    keys = fitted_keys(law)
    names = (
        ("kt" if "kt" in keys else "kp", "kd", "drive", "gain", "ki") if viscous else ("kp", "kv", "fuzzy.adaptation")
    )
    return frozenset(names).intersection(keys)


@lru_cache
def _of_defaults(law: str, keys: frozenset[str]) -> Array:
    return _logarithms(law, machine_of(load_scenario(OF_DEFAULTS)), np.ones(1), keys)


def _logarithms(law: str, machine: Machine, bandwidths: Array, keys: frozenset[str]) -> Array:
    """Return the logarithms of gains at bandwidths (m,), (m, n): of a stiffness of the image those of one feature."""
    gains = fitted_gains(law, machine, bandwidths, 1.0)
    rows = (gains[key].reshape(len(bandwidths), -1) for key in sorted(keys))
    with np.errstate(divide="ignore"):  # a gain of zero: no factor, and no misfit that is a number
        return np.concatenate([np.log(row[:, :2] if row.shape[1] > _AXES else row) for row in rows], axis=1)
