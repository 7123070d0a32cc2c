"""Keys that a log gives as a table (docs/identification.md)."""

from __future__ import annotations

from typing import Any

from hexservo.findings.evidence import Column, Section, Table
from hexservo.findings.identification.changes import Changes

__all__ = ["section"]

PAGE = "docs/identification.md"


def section(found: Changes) -> Section:
    """Return what the scenario of the machine has now, and had before."""
    rows = [[key, _text(value), _text(found.given[key])] for key, value in found.identified.items()]
    table = Table("Keys of the scenario", (Column("key"), Column("identified"), Column("given")), rows, page=PAGE)
    return Section(
        "keys",
        "The scenario",
        ["The scenario with these keys moves and sees as the log does; law and gains are those that were given."],
        (table,),
        "good",
        {"changes": dict(found.identified)},
    )


def _text(value: Any) -> str:
    return "none" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
