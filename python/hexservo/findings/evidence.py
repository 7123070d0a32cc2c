"""Findings of certificates, analyses and diagnoses: sentences, tables, curves and maps, without a renderer.

The command line prints these and the report draws them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from hexservo.scenario.arrays import Array

Cell: TypeAlias = str | float | int | bool | None
"""Cell of a table: a number is in the unit of its column; None if there is no value."""

Verdict: TypeAlias = Literal["good", "warning", "bad", "open"]
"""Verdict of a section; open: not applicable, or with items results that nothing judges."""

_Thing = TypeVar("_Thing")


@dataclass(frozen=True)
class Column:
    """Head of a table's column."""

    title: str
    unit: str = ""  # unit of its numbers, for display; empty for text and pure numbers
    format: str = ".4g"  # format of its numbers, for `format`


@dataclass(frozen=True)
class Table:
    """Rows of text and numbers."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    note: str = ""  # one or two sentences below it
    page: str = ""  # page that explains it, such as "docs/analysis/conditioning.md"

    @classmethod
    def of(
        cls,
        title: str,
        things: Iterable[_Thing],
        columns: Sequence[tuple[Column, Callable[[_Thing], Cell]]],
        *,
        note: str = "",
        page: str,
    ) -> Table:
        """Return a table with a row for each thing: beside its head, a column has the function that gives its cell."""
        rows = [[cell(thing) for _, cell in columns] for thing in things]
        return cls(title, [column for column, _ in columns], rows, note, page)

    def __post_init__(self) -> None:
        """Refuse rows of the wrong length.

        Raises
        ------
        ValueError
            For a row with more or fewer cells than there are columns.
        """
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.title!r}: expected rows of {len(self.columns)} cells, got {list(row)!r}")


@dataclass(frozen=True, eq=False)
class Line:
    """One curve, or markers of one kind."""

    name: str
    x: Array  # (n,)
    y: Array  # (n,)
    style: Literal["line", "dashed", "points"] = "line"
    look: int | None = None  # number of its colour and marker, the same in all charts; None: its place among the lines


@dataclass(frozen=True, eq=False)
class Curves:
    """Lines over one axis."""

    title: str
    x_label: str  # with its unit in brackets
    y_label: str
    lines: Sequence[Line]
    x_log: bool = False
    y_log: bool = False
    note: str = ""
    page: str = ""


@dataclass(frozen=True, eq=False)
class HeatMap:
    """A quantity over a rectangle, with contours of it."""

    title: str
    x_label: str
    y_label: str
    z_label: str
    x: Array  # (m,)
    y: Array  # (n,)
    z: Array  # (n, m): row by y, column by x; NaN where there is no value
    levels: Sequence[float] = ()  # contours to draw
    lines: Sequence[Line] = ()  # over it
    note: str = ""
    page: str = ""


@dataclass(frozen=True, eq=False)
class Share:
    """One number of each bar, with an interval."""

    name: str
    values: Array  # (n,)
    intervals: Array  # (n, 2), lower and upper ends


@dataclass(frozen=True, eq=False)
class Bars:
    """Numbers of named things, as horizontal bars with their intervals, the first thing at the top."""

    title: str
    x_label: str  # with its unit in brackets
    names: Sequence[str]  # n of them
    shares: Sequence[Share]
    note: str = ""
    page: str = ""


Item: TypeAlias = Table | Curves | HeatMap | Bars


@dataclass(frozen=True, eq=False)
class Section:
    """A theme: the findings as sentences, then their tables, curves and maps."""

    name: str  # a key, such as "conditioning"
    title: str
    sentences: Sequence[str]  # the findings in plain words, the most important one first
    items: Sequence[Item] = ()
    verdict: Verdict = "open"
    data: dict[str, Any] = field(default_factory=dict)  # the findings as numbers, in SI units and pixels, for programs

    def to_dict(self) -> dict[str, Any]:
        """Return verdict, sentences and numbers for strict JSON."""
        return {"verdict": self.verdict, "sentences": list(self.sentences), **as_data(self.data)}


def picked(thing: Any, names: str) -> dict[str, Any]:
    """Return attributes by their names, which blanks separate."""
    return {name: getattr(thing, name) for name in names.split()}


def as_data(value: Any) -> Any:
    """Return a value for strict JSON: arrays become lists, and numbers that are not finite null."""
    if isinstance(value, dict):
        return {str(key): as_data(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return as_data(value.tolist())
    if isinstance(value, (list, tuple)):
        return [as_data(item) for item in value]
    if isinstance(value, np.generic):
        return as_data(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
