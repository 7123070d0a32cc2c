"""Scenarios as plain data: dicts, lists, text and numbers."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel

from hexservo.scenario.rules import shown_value
from hexservo.scenario.yaml import MAX_DEPTH, ScenarioError

_AS_IT_IS = frozenset({float, int, bool, type(None)})


def plain(value: Any, place: str = "", depth: int = 0) -> Any:
    """Copy into dicts, lists, text, numbers, booleans and None; anything else stays, for a rule to refuse it."""
    if type(value) in _AS_IT_IS:  # most of a scenario
        return value
    if depth > MAX_DEPTH:
        raise ScenarioError(f"{place[:60]}...: expected at most {MAX_DEPTH} levels of nesting, got more")
    if type(value) is str and value.isascii():  # as most of the rest, and lists: without the tests of other types
        return value
    if type(value) is list or type(value) is tuple:
        return _plain_list(value, place, depth)
    if isinstance(value, BaseModel):
        value = {key: getattr(value, key) for key in type(value).model_fields}
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str) or not _is_unicode(key):
                raise ScenarioError(f"{place or 'the scenario'}: expected keys that are text, got {shown_value(key)}")
        return {
            str(key): item if type(item) in _AS_IT_IS else plain(item, f"{place}.{key}".lstrip("."), depth + 1)
            for key, item in value.items()
        }
    value = _of_numpy(value, place)
    if isinstance(value, Sequence | deque) and not isinstance(value, str | bytes | bytearray):
        return _plain_list(value, place, depth)
    if isinstance(value, str) and not _is_unicode(value):
        raise ScenarioError(f"{place}: expected text of whole Unicode characters, got {shown_value(value)}")
    for kind in (bool, int, float, str):  # numpy's float64 is a float, an enumeration may be text
        if isinstance(value, kind):
            return kind(value)
    return value


def _plain_list(values: Iterable[Any], place: str, depth: int) -> list[Any]:
    return [item if type(item) in _AS_IT_IS else plain(item, place, depth + 1) for item in values]


# What a type of quantities has, as those of Pint and of Astropy: their numbers by themselves are in any unit.
_OF_UNITS = (("units", "magnitude"), ("unit", "to_value"))


def _of_numpy(value: Any, place: str) -> Any:
    """Return arrays, and what NumPy reads as an array of numbers, as lists or numbers of Python; the rest as it is."""
    if isinstance(value, memoryview) or (hasattr(value, "__array__") and not isinstance(value, type | np.generic)):
        if np.ma.is_masked(value):  # which a list would have as null
            raise ScenarioError(f"{place}: expected a value without a mask, got a masked one; fill it in")
        if any(all(hasattr(type(value), name) for name in names) for names in _OF_UNITS):
            raise ScenarioError(f"{place}: expected plain numbers, got a value that has a unit; convert it")
        if not isinstance(value, np.ndarray):
            try:
                numbers = np.asarray(value)
            except Exception:  # whatever the other library raises: it is refused as what it is
                return value
            value = numbers if numbers.dtype.kind in "biuf" else value
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return float(value) if isinstance(value, np.floating) else value  # a long double stays one


def _is_unicode(text: str) -> bool:
    """Return whether text has no lone surrogates, which can be neither written nor displayed."""
    return text.isascii() or not any("\ud800" <= character <= "\udfff" for character in text)


def dotted(changes: Mapping[str, Any], head: str = "") -> dict[str, Any]:
    """Return changes with those within blocks by their dotted keys too."""
    found: dict[str, Any] = {}
    for key, value in changes.items():
        found |= dotted(value, f"{head}{key}.") if isinstance(value, Mapping) else {f"{head}{key}": value}
    return found


def put(keys: dict[str, Any], path: str, value: Any) -> str | None:
    """Change one value by its dotted path, or report an error of the path. Unknown keys are found later."""
    *blocks, key = path.split(".")
    for index, name in enumerate(blocks):
        inner = keys.setdefault(name, {})
        if not isinstance(inner, dict):
            return f"{path}: unknown key; {'.'.join(blocks[: index + 1])} is a value and holds no keys"
        keys = inner
    if isinstance(value, dict) and isinstance(keys.get(key), dict):
        _merge(keys[key], value)
    else:
        keys[key] = value
    return None


def _merge(keys: dict[str, Any], changes: dict[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(keys.get(key), dict):
            _merge(keys[key], value)
        else:
            keys[key] = value
