"""Defaults of the core, which the blocks of a scenario take instead of repeating them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from pydantic import Field

from hexservo import _core
from hexservo.scenario.rules import collapsed


@cache
def core_default(key: str) -> Any:
    """Return the default of a dotted key in a scenario's form: one number for an array of equal ones."""
    block, *inner = key.split(".")
    laws = tuple(_core.LAW_TRAITS)
    law = inner[0] if block == "controller" and inner[0] in laws else laws[0]
    value = _core.Settings(law)[key]
    return collapsed(value) if isinstance(value, np.ndarray) else value


def from_core(key: str) -> Any:
    """Make a field whose default is the core's; asked for when a block is made, not when it is declared."""
    return Field(default_factory=lambda: core_default(key))
