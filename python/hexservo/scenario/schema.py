"""The keys that the core takes, as plain data: for editors, other programs, and the test that compares the blocks."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo import _core
from hexservo.scenario.flat import is_none


def schema() -> list[dict[str, Any]]:
    """Return every numeric key, flag and choice of a scenario in the order of its file, as data for JSON.

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
    entry |= {"mode": "sampled" if key.sampled else "any", "concern": key.concern, "reach": key.reach}
    return entry


def _plain(key: _core.ScenarioKey, value: Any) -> Any:
    """Return a default as a scenario has it: null for the number that stands for none, `ScenarioKey.none`."""
    if is_none(key, value):
        return None
    return value.tolist() if isinstance(value, np.ndarray) else value
