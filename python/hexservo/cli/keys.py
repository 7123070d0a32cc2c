"""The command ``hexservo schema``."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from hexservo.cli.terminal import errors_as_messages, show_parts, write


def schema(
    as_json: Annotated[bool, typer.Option("--json", help="All of it as JSON, for other programs.")] = False,
) -> None:
    """List all keys of a scenario.

    Each has its type with its bounds, its unit or choices, and its default; --json adds what it means.
    """
    with errors_as_messages():
        from hexservo.scenario.schema import all_keys, bounds_of, choices_of

        if as_json:
            write(json.dumps(all_keys(), indent=2) + "\n", encoding="utf-8")
            return
        from rich.table import Table

        table = Table.grid(padding=(0, 2))
        for entry in all_keys():
            kind = f"{entry['type']} {bounds_of(entry)}".strip()
            values = " | ".join(choices_of(entry)) or entry["unit"]
            table.add_row(entry["key"], kind, values, _shortened(json.dumps(entry["default"])))
        show_parts(table)


def _shortened(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."
