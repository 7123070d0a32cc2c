"""Dotted keys of a scenario: all of them, the numeric ones, and those that act in sampled mode only."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from hexservo.scenario.arrays import Mask
from hexservo.scenario.block import SAMPLED, SAMPLED_MODE
from hexservo.scenario.blocks import Blocks
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.pose_rules import PoseRule
from hexservo.scenario.rules import ArrayRule, Inertia, Integer, Number, PointsRule, Rule, TableRule

__all__ = [
    "NumericKey",
    "acting_keys",
    "default_of",
    "keys_below",
    "numeric_keys",
    "sampled_keys",
    "value_at",
    "without_effect",
]

MAX_WHOLE_FLOAT = 2**53  # largest integer up to which a float represents every integer


@dataclass(frozen=True)
class NumericKey:
    """Values that a numeric key accepts: the form of its variations in a batch."""

    shapes: tuple[tuple[int, ...], ...]  # the key's own shape, in each form it may have; () is a number
    element: Number
    whole: bool = False  # only integers
    symmetric: bool = False  # where it is a matrix
    pose: bool = False  # the last three of six are a rotation vector

    @property
    def expected(self) -> str:
        """Expected value of each number, as text."""
        if not self.whole:
            return self.element.expected
        least, most = self.element.at_least, self.element.at_most
        return f"an integer {self.element.bounds}" if most is None else f"an integer from {least} to {most}"

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type that represents every number of the key: float64, unless it has larger integers."""
        most = self.element.at_most
        return np.dtype(np.uint64 if self.whole and most is not None and most > MAX_WHOLE_FLOAT else np.float64)

    def within(self, numbers: NDArray[Any]) -> Mask:
        """Return which numbers are allowed: not NaN, nor, for an integer key, floats that may have been rounded."""
        allowed = numbers == numbers
        if self.whole and numbers.dtype.kind == "f":
            allowed = (numbers == np.floor(numbers)) & (np.abs(numbers) <= MAX_WHOLE_FLOAT)
        for limit, holds in (
            (self.element.above, np.greater),
            (self.element.at_least, np.greater_equal),
            (self.element.below, np.less),
            (self.element.at_most, np.less_equal),
        ):
            if limit is not None:
                allowed = allowed & holds(numbers, limit)
        return np.asarray(allowed & np.isfinite(numbers))


@cache
def numeric_keys(law: str, points: int = 4) -> dict[str, NumericKey]:
    """Return the numeric dotted keys, in the order of a scenario file (do not modify).

    The gains of other laws than `law` have no effect and are not among them. The shapes are those of a target of so
    many points.
    """
    keys = {}
    others = tuple(f"controller.{name}." for name in ALL_LAWS if name != law)
    for path, rule in rules(Blocks):
        if path.startswith(others):
            continue
        if isinstance(rule, Number):
            keys[path] = NumericKey(((),), rule)
        elif isinstance(rule, Integer):
            keys[path] = NumericKey(((),), Number(at_least=rule.at_least, at_most=rule.at_most), whole=True)
        elif isinstance(rule, PointsRule):
            shape = rule.shape_for(points)
            keys[path] = NumericKey(((), shape) if rule.or_number else (shape,), rule.element)
        elif isinstance(rule, ArrayRule):
            shapes = ((), rule.shape) if rule.or_number else (rule.shape,)
            keys[path] = NumericKey(shapes, rule.element, pose=isinstance(rule, PoseRule))
        elif isinstance(rule, Inertia):
            keys[path] = NumericKey(((3,), (3, 3)), rule.element, symmetric=True)
        elif isinstance(rule, TableRule):
            keys[path] = NumericKey(((7, 7),), Number())
    return keys


def rules(block: type[BaseModel]) -> Iterator[tuple[str, Rule]]:
    for path, field, _ in leaves(block):
        yield from ((path, rule) for rule in field.metadata if isinstance(rule, Rule))


@cache
def sampled_keys() -> dict[str, Any]:
    """Return the dotted keys that act in sampled mode only, with their defaults (do not modify).

    A scenario in continuous mode has these values; `updated` with them, before the mode is changed, resets the keys.
    """
    return {path: default_of_field(field) for path, field, sampled in leaves(Blocks) if sampled}


@cache
def acting_keys(law: str, mode: str, points: int = 4) -> dict[str, NumericKey]:
    """Return the `numeric_keys` that act in a mode, which a batch of such scenarios may vary."""
    keys = numeric_keys(law, points)
    return keys if mode == SAMPLED_MODE else {key: rule for key, rule in keys.items() if key not in sampled_keys()}


def without_effect(keys: Sequence[str]) -> str:
    """Return why these of the `sampled_keys` are refused in continuous mode."""
    has, them = ("has", "the key") if len(keys) == 1 else ("have", "these keys")
    return f"{', '.join(keys)}: {has} no effect in continuous mode; set simulation.mode: sampled, or drop {them}"


def leaves(block: type[BaseModel], head: str = "", sampled: bool = False) -> Iterator[tuple[str, FieldInfo, bool]]:
    """Yield all keys that are not blocks: dotted key, field, whether it acts in sampled mode only."""
    for key, field in block.model_fields.items():
        marked = sampled or SAMPLED in field.metadata
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from leaves(field.annotation, f"{head}{key}.", marked)
        else:
            yield head + key, field, marked


@cache
def _fields() -> dict[str, FieldInfo]:
    """Return the field of each dotted key of a scenario (do not modify)."""
    return {path: field for path, field, _ in leaves(Blocks)}


def default_of_field(field: FieldInfo) -> Any:
    return field.get_default(call_default_factory=True)


@cache
def keys_below(name: str) -> tuple[str, ...]:
    """Return the dotted keys that a block holds, or the key itself."""
    return tuple(path for path in _fields() if path == name or path.startswith(f"{name}."))


@cache
def default_of(key: str) -> Any:
    """Return the default of a dotted key that has one, or whose blocks have."""
    block, _, inner = key.partition(".")
    if Blocks.model_fields[block].is_required():
        return default_of_field(_fields()[key])
    value = default_of_field(Blocks.model_fields[block])
    return attrgetter(inner)(value) if inner else value


def value_at(scenario: Blocks, key: str) -> Any:
    """Return the value of a dotted key."""
    return attrgetter(key)(scenario)


def all_paths(block: type[BaseModel], head: str = "") -> Iterator[str]:
    for key, field in block.model_fields.items():
        yield head + key
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from all_paths(field.annotation, f"{head}{key}.")
