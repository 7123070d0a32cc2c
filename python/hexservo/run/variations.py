"""Values that a batch varies, checked and converted to arrays; messages name the key and the run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo.run.progress import reporting
from hexservo.scenario.arrays import Array, holds_no_number
from hexservo.scenario.blocks import SIDES, Blocks, circle_keys
from hexservo.scenario.fitted import (
    acts_on_gains,
    auto_of,
    chosen_keys,
    fitted_gains,
    fitted_keys,
    idle_gains,
    machine_of,
    machine_with,
)
from hexservo.scenario.keys import MAX_WHOLE_FLOAT, NumericKey, all_paths, numeric_keys, sampled_keys, without_effect
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.leg_units import unit_of, unit_of_entry
from hexservo.scenario.parameters import units_of_keys
from hexservo.scenario.pose_rules import problem_of_turns, turns_of
from hexservo.scenario.rules import did_you_mean
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import wrong_type
from hexservo.scenario.yaml import ScenarioError

__all__ = []

_REPORTED = 50  # gains are computed between two updates of a bar
_AUTO_UNITS = {"auto.bandwidth": "Hz", "auto.damping": "1"}  # within the block of a law; the core has no such keys


def checked_variations(scenario: Scenario, variations: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
    """Return the variations as arrays of allowed shapes, lengths and values."""
    if not isinstance(variations, Mapping):
        raise wrong_type("variations", "a mapping of keys to arrays", variations)
    if not variations:
        raise ValueError("variations: expected at least one key, got none")
    law = scenario.controller.law
    points = scenario.target.count
    arrays = {key: _array(key, known_key(key, law, points), values) for key, values in variations.items()}
    idle = [key for key in arrays if key in sampled_keys()] if not scenario.sampled else []
    if idle:
        raise ScenarioError(without_effect(idle))
    lengths = {key: len(values) for key, values in arrays.items()}
    count = max(lengths.values())
    for key, length in lengths.items():
        if length not in (1, count):
            longest = max(lengths, key=lambda name: lengths[name])
            raise ValueError(f"{key}: expected 1 or {count} scenarios, as {longest} has, got {length}")
    for side in SIDES:  # the core takes joints where there are both
        for key in (f"robot.{key}" for key in circle_keys(side)):
            if key in arrays and getattr(scenario.robot, f"{side}_joints") is not None:
                raise ValueError(
                    f"{key}: expected a robot whose {side} joints are on a circle, got one with robot.{side}_joints: "
                    "give it both keys by Scenario.updated first"
                )
    # The first scenario, checked as a whole: what the other keys of its block allow. Of gains, which may be refused for
    # their value alone, each that differs from the first.
    gains = [values for key, values in arrays.items() if key.rpartition(".")[2] in idle_gains(scenario)]
    others = {int(np.argmax(np.any(values != values[:1], axis=tuple(range(1, values.ndim))))) for values in gains}
    for index in sorted({0} | others):
        _require_valid(scenario, changes_of_run(arrays, law, index), index)
    return arrays


def _require_valid(scenario: Scenario, changes: Mapping[str, Any], index: int) -> None:
    try:
        scenario.updated(changes)
    except ScenarioError as error:
        raise ScenarioError([f"scenario {index}: {problem}" for problem in error.problems]) from None


def fitted_variations(
    scenario: Scenario, arrays: Mapping[str, NDArray[Any]], *, bar: bool = False
) -> dict[str, NDArray[Any]]:
    """Return variations for the core: the gains that fit each run (docs/gains.md) in place of the keys of `auto`.

    Each run gets the gains that `Scenario.updated` would fill in. Where machine, camera or target vary, they are
    computed run by run, 1 to 2 ms each, below a bar where one is asked for.

    Raises
    ------
    ValueError
        Where only a damping varies, and no bandwidth is given; for a run that the core refuses.
    """
    law = scenario.controller.law
    head = f"controller.{law}."
    keys = {name: f"{head}auto.{name}" for name in ("bandwidth", "damping")}
    others = {key: values for key, values in arrays.items() if key not in keys.values()}
    auto = auto_of(scenario)
    bandwidth, damping = (arrays.get(key, getattr(auto, name)) for name, key in keys.items())
    if bandwidth is None:
        if keys["damping"] in arrays:
            raise ValueError(f"{keys['damping']}: expected {keys['bandwidth']} beside it, got null")
        return others
    given = {key for key in fitted_keys(law) if head + key in others} | set(chosen_keys(scenario))
    left = [key for key in fitted_keys(law) if key not in given]
    machines = [key for key in others if acts_on_gains(key)]
    if not left or (len(others) == len(arrays) and not machines):
        return others
    if machines:
        count = max(len(values) for values in arrays.values())
        bandwidths, dampings = (np.broadcast_to(values, count) for values in (bandwidth, damping))
        rows = []
        with reporting(bar, "scenarios have their gains") as report:
            for index in range(count):
                row = changes_of_run({key: others[key] for key in machines}, law, index)
                try:
                    rows.append(fitted_gains(law, machine_with(scenario, row), bandwidths[index], dampings[index]))
                except ValueError as error:
                    raise ValueError(f"scenario {index}: {error}") from None
                if len(rows) % _REPORTED == 0 or len(rows) == count:
                    report(len(rows), count)
        found = {key: np.stack([row[key] for row in rows]) for key in left}
    else:
        found = fitted_gains(law, machine_of(scenario), np.atleast_1d(bandwidth), damping)
    return {**others, **{head + key: found[key] for key in left}}


def known_key(key: object, law: str, points: int = 4, *, run: str = "batch") -> NumericKey:
    """Return the rule of a key that may vary within a run of many scenarios, a batch or a campaign.

    Raises
    ------
    ValueError
        "key: unknown key; ...", or "key: expected a numeric key, got ..." for a key that is not numeric, a block, or a
        key of another law.
    """
    known = numeric_keys(law, points)
    if isinstance(key, str) and key in known:
        return known[key]
    below = [name for name in known if name.startswith(f"{key}.")]
    others = {name for other in ALL_LAWS for name in numeric_keys(other)}
    if not below and any(f"{name}.".startswith(f"{key}.") for name in others):
        raise ValueError(f"{key}: expected a key of the scenario's law, {law}, got a key of a different law")
    if below:
        raise ValueError(f"{key}: expected a numeric key, got a block; name a key below it, such as {below[0]}")
    if not isinstance(key, str) or key not in all_paths(Blocks):
        hint = did_you_mean(key, known) or "; `hexservo schema` lists the keys of a scenario"
        raise ValueError(f"{key}: unknown key{hint}")
    hint = f"; run one {run} for each value" + (", or hs.compare with the laws" if key == "controller.law" else "")
    raise ValueError(f"{key}: expected a numeric key, got one that is not numeric and cannot vary within a {run}{hint}")


def _array(key: str, rule: NumericKey, given: ArrayLike) -> NDArray[Any]:
    """Check shape and values against the scenario's own rules for the key."""
    if np.ma.is_masked(given):
        scenario, entry = _named(tuple(np.argwhere(np.ma.getmaskarray(np.ma.asarray(given)))[0]))
        raise ValueError(f"{scenario}{key}{entry}: expected {rule.expected}, got a masked value")
    unlisted = f"{key}: expected an array of numbers of shape {_shapes(rule)}, n scenarios, got {_kind(given)}"
    if holds_no_number(given):
        raise ValueError(unlisted)
    if rule.whole and not isinstance(given, np.ndarray):
        for index, item in enumerate(np.asarray(given, dtype=object).flat):
            if isinstance(item, int) and abs(item) >= 2**64:  # numpy has no number for it
                raise ValueError(f"scenario {index}: {key}: expected {rule.expected}, got {item}")
    try:
        values = np.asarray(given)
        if rule.whole and not isinstance(given, np.ndarray):
            values = _whole_numbers(given, values)
        if values.dtype.kind not in "iuf":
            raise ValueError
    except ValueError:  # ragged, or no numbers
        raise ValueError(unlisted) from None
    if values.ndim == 0 or values.shape[1:] not in rule.shapes or len(values) == 0:
        raise ValueError(f"{key}: expected shape {_shapes(rule)}, n scenarios, got {values.shape}")
    allowed = rule.within(values)
    if not allowed.all():
        place = tuple(int(index) for index in np.argwhere(~allowed)[0])
        scenario, entry = _named(place)
        rounded = rule.whole and values.dtype.kind == "f" and abs(values[place]) > MAX_WHOLE_FLOAT
        got = f"the float {float(values[place])!r}, which may have been rounded" if rounded else f"{values[place]:.12g}"
        raise ValueError(f"{scenario}{key}{entry}: expected {rule.expected}, got {got}")
    if rule.pose and (problem := problem_of_turns(values)) is not None:
        raise ValueError(f"scenario {int(np.argmax(turns_of(values)))}: {key}: {problem}")
    numbers = values.astype(rule.dtype)
    if rule.symmetric and numbers.ndim == 3:
        numbers = _symmetric(key, numbers)
    return numbers


def _named(place: tuple[int, ...]) -> tuple[str, str]:
    """Return the words before and after the key for a place in its array; of a single number none."""
    return (f"scenario {place[0]}: " if place else ""), "".join(f"[{index}]" for index in place[1:])


def _whole_numbers(given: ArrayLike, values: NDArray[Any]) -> NDArray[Any]:
    """Keep integers of up to 64 bits, of which numpy makes floats where some are above 2^63 and others are not."""
    if values.dtype.kind not in "fO":
        return values
    objects = np.asarray(given, dtype=object)
    integers = all(isinstance(item, int) and 0 <= item < 2**64 for item in objects.flat)
    return objects.astype(np.uint64) if integers else values


def _symmetric(key: str, matrices: Array) -> Array:
    """Make nearly symmetric matrices symmetric, as a scenario does."""
    turned = matrices.transpose(0, 2, 1)
    uneven = np.abs(matrices - turned).max(axis=(1, 2)) > 1e-9 * np.abs(matrices).max(axis=(1, 2))
    if uneven.any():
        raise ValueError(f"scenario {int(np.argmax(uneven))}: {key}: expected a symmetric matrix, got one that is not")
    return np.asarray(matrices / 2 + turned / 2)


def columns_of(key: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the variations of a key as columns of a table: entries of arrays as ``controller.hybrid.kv[0]``."""
    return {
        key + "".join(f"[{index}]" for index in place): values[(slice(None), *place)]
        for place in np.ndindex(values.shape[1:])
    }


def changes_of_run(arrays: Mapping[str, NDArray[Any]], law: str, index: int = 0) -> dict[str, Any]:
    """Return the changes of one run, by dotted key, from the rows of all; keys with one row have it for every run."""
    return {key: plain_row(known_key(key, law), values[index % len(values)]) for key, values in arrays.items()}


def unit_of_varied(scenario: Scenario, name: str) -> str:
    """Return the unit of a key that may vary, or of an entry of it as ``controller.hybrid.kv[0]``; "" without one."""
    key, _, entry = name.partition("[")
    law = scenario.controller.law
    unit = units_of_keys(law).get(key) or _AUTO_UNITS.get(key.removeprefix(f"controller.{law}."), "")
    if entry:
        unit = unit_of_entry(unit, int(entry.partition("]")[0]))
    return unit_of(scenario.robot, key, unit)


def label_of_varied(scenario: Scenario, name: str) -> str:
    """Return the label of an axis for a key that may vary, or for an entry of it, with its unit where it has one."""
    unit = unit_of_varied(scenario, name)
    return f"{name} [{unit}]" if unit else name


def plain_row(rule: NumericKey, row: NDArray[Any]) -> Any:
    return int(row) if rule.whole else row.tolist()


def _shapes(rule: NumericKey) -> str:
    """Return the shapes of an array for a key, as "(n,) or (n, 2)"."""
    return " or ".join(f"({', '.join(map(str, ('n', *shape)))}{',' if not shape else ''})" for shape in rule.shapes)


def _kind(value: object) -> str:
    dtype = getattr(value, "dtype", None)
    if dtype is not None:
        return f"an array of {dtype}"
    if isinstance(value, list | tuple):
        return "entries that are no numbers, or of different lengths"
    return f"something else ({type(value).__name__})"
