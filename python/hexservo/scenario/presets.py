"""Presets of the robot block: two in the core, and machines of public sources in files, each with its sources."""

from __future__ import annotations

from importlib import resources
from typing import Any

from hexservo import _core
from hexservo.scenario.yaml import load_yaml

_FOLDER = resources.files("hexservo") / "machines"
MACHINES = tuple(sorted(item.name[:-5] for item in _FOLDER.iterdir() if item.name.endswith(".yaml")))
ROBOT_PRESETS = (*_core.ROBOT_PRESETS, *MACHINES)


def machine(name: str) -> dict[str, Any]:
    """Return the robot block of one of `MACHINES`, as its file has it."""
    keys = load_yaml((_FOLDER / f"{name}.yaml").read_text(encoding="utf-8"), name)
    assert isinstance(keys, dict)
    return keys
