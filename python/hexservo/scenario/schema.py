"""The keys of a scenario as plain data: for editors, other programs, and the test that compares the blocks."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from hexservo import _core
from hexservo.scenario.blocks import Blocks
from hexservo.scenario.fields import meanings_of
from hexservo.scenario.flat import is_none
from hexservo.scenario.keys import default_of_field, leaves
from hexservo.scenario.parameters import choice_in_file
from hexservo.scenario.pose_rules import DisplacementRule
from hexservo.scenario.rules import ArrayRule, Choice, Number, Rule
from hexservo.scenario.tag import GridRule, TagRule


def all_keys() -> list[dict[str, Any]]:
    """Return every key of a scenario in the order of its blocks, as data for JSON: those of `schema` and of Python.

    Each entry has ``meaning``, one line, and choices are those of a file: true for the true value of something (of the
    core ``truth``, ``true_rates``). Keys that Python reads into others or keeps, such as names, files and presets,
    are of type number, array, choice, text or mapping, and have neither ``concern`` nor ``reach``.
    """
    of_core = {entry["key"]: entry for entry in schema()}
    meanings = dict(_meanings(Blocks))
    return [
        {
            **(_in_file(of_core[key]) if key in of_core else _own_entry(key, field, sampled, meanings[key])),
            "meaning": meanings[key],
        }
        for key, field, sampled in leaves(Blocks)
    ]


def bounds_of(entry: dict[str, Any]) -> str:
    """Return the bounds of an entry as they follow its type: ">= 0 and < 1", or "" without any."""
    exclusive = entry.get("exclusive", [])
    signs = (("minimum", ">"), ("maximum", "<"))
    return " and ".join(
        f"{sign}{'' if name in exclusive else '='} {entry[name]:.6g}"
        for name, sign in signs
        if entry.get(name) is not None
    )


def choices_of(entry: dict[str, Any]) -> list[str]:
    """Return the choices of an entry of `all_keys` as a file has them: true without quotes; none where it has none."""
    return [choice if isinstance(choice, str) else json.dumps(choice) for choice in entry.get("choices", ())]


def schema() -> list[dict[str, Any]]:
    """Return every key that the core takes, number, flag or choice, in the order of a file, as data for JSON.

    Each entry has ``key``, ``type`` (number, array, whole, flag, choice, samples, seed), ``unit`` ("linear; angular"
    where an array mixes both; "" without one), ``default`` (null: none), ``optional`` (whether null is allowed),
    ``mode`` (sampled: without effect in continuous mode), ``concern`` (controller, plant, run) and ``reach`` (what must
    agree where it varies in a batch: lane, pack, legs, batch); numbers have ``minimum``, ``maximum`` and
    ``exclusive``, the bounds that are not allowed themselves; arrays have ``shape`` and ``form`` (one_or_all: one
    number may stand for all; all; symmetric: the diagonal may stand for all); choices have ``choices``.
    """
    entries: dict[str, dict[str, Any]] = {}
    for law in _core.LAW_TRAITS:
        settings = _core.Settings(law)
        for key in _core.scenario_keys(law):
            entries.setdefault(key.name, _entry(key, settings[key.name]))
    laws = tuple(f"controller.{law}." for law in _core.LAW_TRAITS)
    names = list(entries)  # the gains of all laws stand where those of the first one do
    place = next(index for index, name in enumerate(names) if name.startswith(laws))
    gains = [name for name in names if name.startswith(laws)]
    rest = [name for name in names if not name.startswith(laws)]
    return [entries[name] for name in (*rest[:place], *gains, *rest[place:])]


def _entry(key: _core.ScenarioKey, default: Any) -> dict[str, Any]:
    entry: dict[str, Any] = {"key": key.name, "type": key.type, "unit": key.unit, "optional": key.optional}
    if key.type == "choice":
        entry["choices"] = list(key.choices)
    if key.type in ("number", "array", "whole", "samples"):
        entry |= {"minimum": key.least, "maximum": key.most}
        entry["exclusive"] = [name for name, out in (("minimum", key.above), ("maximum", key.below)) if out]
    if key.type in ("array", "samples"):
        entry |= {"shape": list(key.shape), "form": key.form}
    entry["default"] = _plain(key, default)
    entry |= {"mode": _mode(key.sampled), "concern": key.concern, "reach": key.reach}
    return entry


def _in_file(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry of `schema` with the choices that a scenario file takes."""
    if entry["type"] != "choice":
        return entry
    choices = [choice_in_file(choice) for choice in entry["choices"]]
    default = entry["default"]
    return {**entry, "choices": choices, "default": default if default is None else choice_in_file(default)}


def _meanings(block: type[BaseModel], head: str = "") -> Iterator[tuple[str, str]]:
    """Yield what each dotted key means; nothing is known of it in a package without its source."""
    try:
        texts = meanings_of(block)
    except OSError:
        texts = dict.fromkeys(block.model_fields, "")
    for key, field in block.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _meanings(field.annotation, f"{head}{key}.")
        else:
            yield f"{head}{key}", texts[key]


def _own_entry(key: str, field: FieldInfo, sampled: bool, meaning: str) -> dict[str, Any]:
    """Return the entry of a key that the core does not take, by its rule; the unit is that of its meaning."""
    rule = next(rule for rule in field.metadata if isinstance(rule, Rule))
    unit = re.search(r"\[([^\]]+)\]", meaning)
    entry: dict[str, Any] = {"key": key, "type": _own_type(rule), "unit": unit[1] if unit else ""}
    entry["optional"] = _takes_null(rule)
    element = rule.element if isinstance(rule, ArrayRule) else rule
    if isinstance(rule, Choice):
        entry["choices"] = list(rule.choices or get_args(field.annotation))
    if isinstance(element, Number):
        pairs = (("minimum", element.above, element.at_least), ("maximum", element.below, element.at_most))
        entry |= {name: within if beyond is None else beyond for name, beyond, within in pairs}
        entry["exclusive"] = [name for name, beyond, _ in pairs if beyond is not None]
    if isinstance(rule, ArrayRule):
        entry |= {"shape": list(rule.shape), "form": "one_or_all" if rule.or_number else "all"}
    elif isinstance(rule, DisplacementRule):
        entry |= {"shape": [6], "form": "all"}
    return {**entry, "default": None if field.is_required() else default_of_field(field), "mode": _mode(sampled)}


def _own_type(rule: Rule) -> str:
    if isinstance(rule, Choice):
        return "choice"
    if isinstance(rule, Number):
        return "number"
    if isinstance(rule, ArrayRule | DisplacementRule):
        return "array"
    return "mapping" if isinstance(rule, TagRule | GridRule) else "text"


def _takes_null(rule: Rule) -> bool:
    try:
        rule.accept(None)
    except ValidationError:
        return False
    return True


def _mode(sampled: bool) -> str:
    return "sampled" if sampled else "any"


def _plain(key: _core.ScenarioKey, value: Any) -> Any:
    """Return a default as a scenario has it: null for the number that stands for none, `ScenarioKey.none`."""
    if is_none(key, value):
        return None
    return value.tolist() if isinstance(value, np.ndarray) else value
