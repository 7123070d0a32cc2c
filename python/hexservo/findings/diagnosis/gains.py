"""Time scaling of a loop: gains of a law for the same motion, slower or faster."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.findings.diagnosis.size import size_of
from hexservo.scenario.fitted import auto_of, fitted_keys, idle_gains, machine_of, target_filter
from hexservo.scenario.keys import default_of, keys_below, value_at
from hexservo.scenario.scenario import Scenario

# How a gain scales with the rate of the loop: forces with its square, dampings and rates with itself.
_POWERS = {
    "kp": 2.0,
    "kt": 2.0,
    "kv": 2.0,
    "kd": 1.0,
    "ki": 1.0,
    "gain": 1.0,
    "gain_far": 1.0,
    "gain_slope": 1.0,
    "drive": 1.0,
    "bandwidth": 1.0,
}
_FUZZY_POWERS = {"adaptation": -2.0, "initial_scale": 2.0, "weight_limit": 2.0, "leakage": 1.0, "dead_zone": 1.0}
_ALIKE = 1e-9  # relative, of two gains that are the same but for rounding
_STIFFNESS, _DAMPING = ("kp", "kt", "gain", "gain_far", "bandwidth"), ("kd", "ki", "kv")
GAIN_KEYS = frozenset(f"LAW.{name}" for name in (*_POWERS, "adaptive") if name != "kv") | {
    "LAW.fuzzy.adaptation",
    "LAW.fuzzy.error_scale",
    "LAW.fuzzy.rate_scale",
}
"""What `slower` changes, but for the dry friction K_v, which is a separate cause."""


def slower(scenario: Scenario, factor: float) -> dict[str, Any]:
    """Return the changes that slow the loop down by `factor`: t becomes factor t, forces are divided by factor^2.

    Exact for a law whose plant has no weight error: m d2x/dt2 = F keeps its paths where F is divided by the square.
    """
    law = scenario.controller.law
    block = scenario.controller.gains
    rate = 1.0 / factor
    powers = {name: _POWERS[name] for name in _acting(scenario, _POWERS)}
    changes = _scaled(f"controller.{law}", block, powers, rate)
    if hasattr(block, "fuzzy") and block.fuzzy.enabled:
        powers = dict(_FUZZY_POWERS)
        # Inputs of the systems: a pose error and a velocity, or else forces and their rates.
        forces = {"error_scale": -2.0, "rate_scale": -3.0}
        powers |= {"rate_scale": -1.0} if scenario.controller.traits.pose_error else forces
        changes |= _scaled(f"controller.{law}.fuzzy", block.fuzzy, powers, rate)
    return changes


def by_bandwidth(scenario: Scenario, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the bandwidth that gains follow, in place of changes by `slower` that it makes as well."""
    head, auto = f"controller.{scenario.controller.law}", auto_of(scenario)
    scaled = next((name for name in _POWERS if np.any(changes.get(f"{head}.{name}", 0.0))), None)
    if auto.bandwidth is None or scaled is None:
        return dict(changes)
    own, wanted = (np.abs(of).max() for of in (value_at(scenario, f"{head}.{scaled}"), changes[f"{head}.{scaled}"]))
    if own == 0.0:
        return dict(changes)
    bandwidth = auto.bandwidth * float(wanted / own) ** (1.0 / _POWERS[scaled])
    one = {f"{head}.auto.bandwidth": float(f"{bandwidth:.12g}")}
    try:
        followed, written = scenario.updated(one), scenario.updated(changes)
    except ValueError:  # of gains that the scenario refuses
        return dict(changes)
    keys = {*changes, *(f"{head}.{path}" for path in fitted_keys(scenario.controller.law))}
    same = all(_alike(value_at(followed, key), value_at(written, key)) for key in keys)
    return one if same else dict(changes)


def _alike(one: Any, other: Any) -> bool:
    try:
        return bool(np.allclose(one, other, rtol=_ALIKE, atol=0.0))
    except (TypeError, ValueError):  # no numbers, or not as many
        return bool(one == other)


def damped(scenario: Scenario, factor: float) -> dict[str, Any]:
    """Return the changes that damp the loop more: by a factor, or to the law's defaults where nothing damps it."""
    law = scenario.controller.law
    powers = dict.fromkeys(_acting(scenario, _DAMPING), 1.0)
    more = _scaled(f"controller.{law}", scenario.controller.gains, powers, factor)
    return more or _raised(scenario, _DAMPING)


def not_below_default(scenario: Scenario) -> dict[str, Any]:
    """Return the changes that raise stiffness and damping to the law's defaults where they are lower."""
    return _raised(scenario, (*_STIFFNESS, *_DAMPING))


def _raised(scenario: Scenario, names: tuple[str, ...]) -> dict[str, Any]:
    usual, changes = default_gains(scenario), {}
    for key in (f"controller.{scenario.controller.law}.{name}" for name in names):
        if key in usual:
            own, wanted = np.asarray(value_at(scenario, key)), np.asarray(usual[key])
            if (own < wanted).any():
                changes[key] = np.maximum(own, wanted).tolist()
    return changes


def default_gains(scenario: Scenario) -> dict[str, Any]:
    """Return the settings of a law that suit the machine's size, by dotted key: its defaults, which are for `micro`.

    Each is scaled by its unit (`MachineSize.scale`); the motion that the filter of `tracking` takes a target to have is
    the one of fitted gains, in parts of the target's distance. Gains that the scenario refuses are left out.
    """
    law, size = scenario.controller.law, size_of(scenario)
    units = {key.name: key.unit for key in _core.scenario_keys(law)}
    found = {}
    for key in _acting(scenario, keys_below(f"controller.{law}")):
        value, scale = default_of(key), size.scale(units.get(key, ""))
        if np.asarray(value).dtype.kind in "fi" and np.any(value) and (scale != 1.0).any():
            with np.errstate(over="ignore", under="ignore"):  # as below
                scaled = np.asarray(value, dtype=float) * scale
            value = scaled.item() if np.ndim(value) == 0 and scaled.size == 1 else scaled.tolist()
        found[key] = list(value) if isinstance(value, tuple) else value
    if law == "tracking":
        with contextlib.suppress(ValueError):  # of a machine that the core refuses
            fitted = target_filter(machine_of(scenario))
            found |= {f"controller.{law}.{key}": value.tolist() for key, value in fitted.items()}
    return found


def _acting(scenario: Scenario, names: Iterable[str]) -> list[str]:
    """Return those of some names or dotted keys that have an effect."""
    return [name for name in names if name.rpartition(".")[2] not in idle_gains(scenario)]


def _scaled(path: str, block: Any, powers: dict[str, float], rate: float) -> dict[str, Any]:
    changes = {}
    for name, power in powers.items():
        value = getattr(block, name, None)
        if value is not None and np.any(value):
            with np.errstate(over="ignore", under="ignore"):  # what is not finite is refused, and then not tried
                changes[f"{path}.{name}"] = (np.asarray(value, dtype=float) * rate**power).tolist()
    return changes
