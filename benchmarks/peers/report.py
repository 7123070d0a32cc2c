"""The results as JSON, and as the block of BENCHMARKS.md that the command writes."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rows import Row

BEGIN, END = "<!-- peers:begin -->", "<!-- peers:end -->"


def write_json(path: Path, machine: dict[str, Any], rows: Sequence[Row]) -> None:
    """Write everything that was measured; times in seconds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    document = _finite({"machine": machine, "rows": [asdict(row) for row in rows]})
    path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    """Give null for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    for factor, unit in ((1e9, "ns"), (1e6, "µs"), (1e3, "ms")):
        if seconds * factor < 999.5 or unit == "ms":
            value = seconds * factor
            digits = 2 if value < 9.995 else 1 if value < 99.95 else 0
            return f"{value:.{digits}f} {unit}"
    raise AssertionError


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 999.5 else f"{value:.0f}"


def sentence(row: Row) -> str:
    """Return the result in one line."""
    name = f"{row.work}: {row.version or row.peer}"
    if row.comparison is None:
        return f"{name}: {row.status}: {row.detail}"
    c = row.comparison
    differences = ", ".join(f"{d.largest:.1e} {d.unit}" for d in row.differences)
    if c.ratio is None or c.spread is None:
        return f"{name}: {_time(c.peer)} per {row.unit}; hexservo {row.hexservo}; answers differ by {differences}"
    return (
        f"{name}: {_time(c.peer)} per {row.unit}, hexservo {_time(c.hexservo)}: ratio {_number(c.ratio)} "
        f"({_number(c.spread[0])} to {_number(c.spread[1])}); answers differ by {differences}"
    )


def markdown(machine: dict[str, Any], rows: Sequence[Row]) -> str:
    """Give the table, what it was measured on, and what is missing."""
    core = machine["core"]
    lines = [
        f"{machine['date'][:10]}; {machine['cpu']}, {machine['processors']} processors, {machine['system']}; "
        f"load average at the start {machine['load_average']:.1f}.",
        f"hexservo {core['hexservo']}, variant {core['variant']}, {core['compiler']}, `{core['flags']}`; "
        f"the C++ functions of the rows with fuzzylite and ViSP: baseline; Python {machine['python']}.",
        "",
        "| work | per | peer | its form | peer | hexservo | ratio (quartiles) | answers differ by (allowed) |",
        "| --- | --- | --- | --- | ---: | ---: | ---: | --- |",
    ]
    for row in rows:
        c = row.comparison
        if c is None:
            continue
        ratio = "–"
        if c.ratio is not None and c.spread is not None:
            ratio = f"**{_number(c.ratio)}** ({_number(c.spread[0])} to {_number(c.spread[1])})"
        differences = "; ".join(f"{d.largest:.1e} ({d.allowed:.1g}) {d.unit}" for d in row.differences)
        peer = row.version.partition(";")[0]
        lines.append(
            f"| {row.work}; hexservo: {row.hexservo} | {row.unit} | {peer} | {row.form} | {_time(c.peer)} "
            f"| {_time(c.hexservo)} | {ratio} | {differences} |"
        )
    absent = [row for row in rows if row.comparison is None]
    if absent:
        lines += ["", "Not measured:", ""]
        lines += [f"- {row.work}, {row.peer}: {row.status}: {' '.join(row.detail.split())}" for row in absent]
    return "\n".join(lines)


def update_block(path: Path, text: str) -> None:
    """Replace what stands between the two markers of a file.

    Raises
    ------
    ValueError
        Where the file has not exactly one pair of markers.
    """
    old = path.read_text()
    if old.count(BEGIN) != 1 or old.count(END) != 1 or old.index(BEGIN) > old.index(END):
        raise ValueError(f"{path}: expected one {BEGIN} and after it one {END}")
    head, tail = old.split(BEGIN)[0], old.split(END)[1]
    path.write_text(f"{head}{BEGIN}\n{text}\n{END}{tail}")
