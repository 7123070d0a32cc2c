"""Findings for the terminal: sentences and tables; curves and maps, which only the report draws, are named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hexservo.cli.terminal import GAP, plain_table, width
from hexservo.findings.evidence import Item, Section, Table
from hexservo.findings.wording import cell_text, numeric_columns, verdict_text

if TYPE_CHECKING:
    from rich.console import RenderableType

_STYLES = {"good": "green", "warning": "yellow", "bad": "bold red", "open": "dim"}


def printed(sections: Sequence[Section]) -> Iterator[RenderableType]:
    """Return sections as rich renderables, in their order."""
    from rich.text import Text

    for number, section in enumerate(sections):
        if number:
            yield Text("")
        heading = Text.assemble((section.title, "bold"))
        if verdict := verdict_text(section):
            heading.append(": ").append(verdict, _STYLES[section.verdict])
        yield heading
        for sentence in section.sentences:
            yield Text(sentence)
        for item in section.items:
            yield from _printed_item(item)


def _printed_item(item: Item) -> Iterator[RenderableType]:
    from rich.text import Text

    yield Text("")
    if isinstance(item, Table):
        yield Text(item.title, style="underline")
        yield _table(item) if _least_width(item) <= width() else _listed(item)
    else:
        yield Text(f"{item.title}: a figure, drawn in a notebook, and of a run by `hexservo report`", style="dim")
    if item.note:
        yield Text(item.note, style="dim")
    if item.page:  # in one line, as it can be copied
        yield Text(f"Explained in {installed_place(item.page)}", style="dim", no_wrap=True, overflow="ignore")


def installed_place(page: str) -> str:
    """Return where a page is installed, from the current folder if it is inside."""
    from hexservo.report.documentation import page_path

    path = page_path(page)
    if path is None:
        return page
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def _least_width(item: Table) -> int:
    """Return the width of a table with no word and no number broken."""
    least = [
        max(map(len, " ".join([column.title, f"[{column.unit}]", *texts]).split()))
        for column, *texts in zip(
            item.columns,
            *[[cell_text(cell, column) for cell, column in zip(row, item.columns, strict=True)] for row in item.rows],
            strict=True,
        )
    ]
    return sum(least) + GAP * (len(least) - 1)


def _listed(item: Table) -> RenderableType:
    """Return a table that is too wide as one list of its cells per row."""
    from rich.text import Text

    lines = []
    for row in item.rows:
        indent = ""
        for cell, column in zip(row, item.columns, strict=True):
            text = cell_text(cell, column)
            unit = f" {column.unit}" if column.unit and text != "-" else ""
            if text:
                lines.append(f"{indent}{column.title}: {text}{unit}")
            indent = "  "
    return Text("\n".join(lines))


def _table(item: Table) -> RenderableType:
    from rich.text import Text

    table = plain_table(header_style="bold")
    for column, is_numeric in zip(item.columns, numeric_columns(item), strict=True):
        head = f"{column.title}\n[{column.unit}]" if column.unit else column.title
        table.add_column(Text(head), justify="right" if is_numeric else "left", overflow="fold")
    for row in item.rows:
        table.add_row(*[Text(cell_text(cell, column)) for cell, column in zip(row, item.columns, strict=True)])
    return table
