"""Findings as HTML: sections with their sentences, tables, curves and maps."""

from __future__ import annotations

from collections.abc import Sequence

from hexservo.findings.evidence import Bars, Cell, Column, Curves, HeatMap, Item, Section, Table
from hexservo.findings.wording import VERDICTS, cell_text, numeric_columns, verdict_text
from hexservo.report.charts import bars, curves, explained, heat_map
from hexservo.report.html import Html, element, paragraphs

_SHORT = 22  # characters of a cell that is not broken into lines
_LONG = 60  # characters from which on a cell's column is made wide
_PHONE = 44  # characters of a row that fit a phone: a wider table becomes a list of its cells there


def badge(verdict: str) -> Html:
    """Return a verdict as text on its colour."""
    return element("span", VERDICTS[verdict], class_=f"badge {verdict}")


def badges(section: Section) -> list[Html]:
    """Return the verdict of a section; none for results that nothing judges."""
    return [badge(section.verdict)] if verdict_text(section) else []


def section_html(section: Section, anchor: str) -> Html:
    """Return a section: its title with the verdict, the findings as sentences, then tables and charts."""
    return element(
        "section",
        element("h3", section.title, " ", *badges(section)),
        paragraphs(*section.sentences),
        *[item_html(item) for item in section.items],
        id=anchor,
    )


def table_html(table: Table) -> Html:
    """Return a table in a box that scrolls separately on a narrow page."""
    numeric = numeric_columns(table)
    heads = [
        element("th", column.title, *_unit(column), scope="col", class_="number" if is_number else "text")
        for column, is_number in zip(table.columns, numeric, strict=True)
    ]
    rows = [element("tr", *_cells(row, table.columns, numeric)) for row in table.rows]
    return element(
        "figure",
        element("figcaption", table.title),
        element(
            "div",
            element("table", element("thead", element("tr", *heads)), element("tbody", *rows)),
            class_="scroll stacked" if _least_width(table) > _PHONE else "scroll",
            tabindex="0",
            role="region",
            aria_label=table.title,
        ),
        paragraphs(table.note),
        explained(table.page),
        class_="table",
    )


def item_html(item: Item) -> Html:
    """Return a table or a chart."""
    match item:
        case Table():
            return table_html(item)
        case Curves():
            return curves(item)
        case HeatMap():
            return heat_map(item)
        case Bars():
            return bars(item)


def _cells(row: Sequence[Cell], columns: Sequence[Column], numeric: Sequence[bool]) -> list[Html]:
    return [
        element(
            "td",
            text,
            class_=_kind(text, is_number) + (" empty" if text in ("", "–") else ""),
            data_head=f"{column.title} [{column.unit}]" if column.unit else column.title,
        )
        for cell, column, is_number in zip(row, columns, numeric, strict=True)
        for text in [page_text(cell, column)]
    ]


def page_text(cell: Cell, column: Column) -> str:
    """Return the text of a cell, with characters that a terminal may lack."""
    text = cell_text(cell, column)
    if isinstance(cell, str):
        return text
    return {"-": "–", "inf": "∞", "-inf": "−∞"}.get(text, text.replace("-", "−"))


def _kind(text: str, is_number: bool) -> str:
    if is_number:
        return "number"
    return "short" if len(text) <= _SHORT else "text long" if len(text) >= _LONG else "text"


def _least_width(table: Table) -> int:
    """Return the sum of the widest words of all columns in characters, a long text counted as one."""
    widths = []
    for place, column in enumerate(table.columns):
        texts = [cell_text(row[place], column) for row in table.rows]
        words = f"{column.title} [{column.unit}]".split() if column.unit else column.title.split()
        longest = max((min(len(text), _SHORT) for text in texts), default=0)
        widths.append(2 + max(longest, *map(len, words), 1))
    return sum(widths)


def _unit(column: Column) -> list[str]:
    return [Html("<br>"), element("span", f"[{column.unit}]", class_="unit")] if column.unit else []
