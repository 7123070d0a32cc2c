"""Text of findings: cells of tables and names of verdicts, for the terminal and the report."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from hexservo.findings.evidence import Cell, Column, Section, Table
from hexservo.scenario.wording import number

VERDICTS = {"good": "good", "warning": "warning", "bad": "bad", "open": "not applicable"}
"""Text of verdicts."""


def verdict_text(section: Section) -> str:
    """Return the text of a section's verdict, empty for results that nothing judges, such as indices of sensitivity."""
    return "" if section.verdict == "open" and section.items else VERDICTS[section.verdict]


def cell_text(cell: Cell, column: Column) -> str:
    """Return the text of a cell, without its unit; numbers are in ASCII."""
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str):
        return cell
    if not math.isfinite(cell):
        return "-" if math.isnan(cell) else "inf" if cell > 0 else "-inf"
    whole = isinstance(cell, int) and column.format == Column.format  # 123456 and not 1.235e+05
    digits = re.fullmatch(r"\.(\d+)g", column.format)
    shown = str(cell) if whole else number(cell, int(digits[1])) if digits else format(cell, column.format)
    return re.sub(r"^-(?=0(\.0*)?$)", "", shown)  # minus zero is zero


def numeric_columns(table: Table) -> Sequence[bool]:
    """Return which columns contain numbers and are right-aligned."""
    return [
        any(isinstance(row[place], int | float) and not isinstance(row[place], bool) for row in table.rows)
        for place in range(len(table.columns))
    ]
