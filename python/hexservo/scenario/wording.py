"""How findings read: cells of tables, and what a verdict is called; the same in the terminal and in the report."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from hexservo.findings.evidence import Cell, Column, Table

__all__ = ["VERDICTS", "cell_text", "joules", "number", "numeric_columns", "quantity"]

VERDICTS = {"good": "good", "warning": "warning", "bad": "bad", "open": "nothing to judge"}
"""Words for a section's verdict."""


def number(value: float, digits: int = 3) -> str:
    """Write a number with so many digits, and without an exponent below a million: "0.0123", "190", "28800"."""
    rounded = float(f"{value:.{digits}g}") + 0.0  # minus zero is zero
    return f"{rounded:.0f}" if 10.0**digits <= abs(rounded) < 1e6 else f"{rounded:.{digits}g}"


_PREFIXES = (("", 1.0), ("m", 1e3), ("u", 1e6), ("n", 1e9))


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a number with its SI unit, in thousandths, millionths or billionths where it is less than one.

    "17 mm", "4.87 m", "277 mrad": one to three digits stand before the point. What is less than a billionth has an
    exponent: "2.6e-22 J".
    """
    size = abs(float(f"{value:.{digits}g}"))
    prefix, scale = next((each for each in _PREFIXES if size * each[1] >= 1.0), _PREFIXES[0])
    return f"{number(value * scale, digits)} {prefix}{unit}"


def joules(value: float, digits: int = 4, unit: str = "J") -> str:
    """Write an energy [J], or a power with the unit W."""
    return quantity(value, unit, digits)


def cell_text(cell: Cell, column: Column) -> str:
    """Give a cell as people read it, without its unit, in ASCII where the cell is no text."""
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
    """Tell which columns hold numbers, and are flush right."""
    return [
        any(isinstance(row[place], int | float) and not isinstance(row[place], bool) for row in table.rows)
        for place in range(len(table.columns))
    ]
