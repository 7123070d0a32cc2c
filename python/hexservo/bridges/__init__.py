"""Scenarios in other tools."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hexservo.bridges.environment import gymnasium
    from hexservo.bridges.fmi import fmu
    from hexservo.bridges.mujoco_model import mjcf
    from hexservo.bridges.state_space import control

__all__ = ["control", "fmu", "gymnasium", "mjcf"]

_PLACES = {"control": "state_space", "fmu": "fmi", "gymnasium": "environment", "mjcf": "mujoco_model"}


if not TYPE_CHECKING:  # as in hexservo itself

    def __getattr__(name: str) -> Any:
        """Import what a public name stands for when it is first used."""
        if name not in _PLACES:
            raise AttributeError(f"module 'hexservo.bridges' has no attribute {name!r}")
        value = globals()[name] = getattr(import_module(f"hexservo.bridges.{_PLACES[name]}"), name)
        return value
