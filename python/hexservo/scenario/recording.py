"""Recorded accelerations of a base, from CSV: the columns t, ax, ay and az, in seconds and m/s^2."""

from __future__ import annotations

import csv
import math
import os

from hexservo.scenario.yaml import ScenarioError, read_text

__all__ = ["MAX_SAMPLES", "read_recording"]

MAX_SAMPLES = 10_000
"""Most samples of a recording: a scenario holds them itself, and is still a small file."""

_COLUMNS = ("t", "ax", "ay", "az")
_UNEVEN = 0.01  # most that a time may be off its place, in sample periods: times are written with few digits


def read_recording(path: str | os.PathLike[str]) -> tuple[float, list[list[float]]]:
    """Return the sample period [s] and the accelerations ``[[ax, ay, az], ...]`` [m/s^2], in B, of a CSV file.

    The first line names the columns ``t, ax, ay, az``, in any order; times start at 0 and are evenly spaced. Empty
    lines and lines that start with ``#`` do not count.

    Raises
    ------
    ScenarioError
        A file that cannot be read, or the first thing that is wrong with it, with its line.
    """
    source = os.fsdecode(path)
    try:
        return _parsed(read_text(path, "CSV"))
    except _LineError as error:
        raise ScenarioError(str(error), source) from None


class _LineError(Exception):
    """What is wrong, with its line."""

    def __init__(self, line: int, sentence: str) -> None:
        super().__init__(f"line {line}: {sentence}")


def _parsed(text: str) -> tuple[float, list[list[float]]]:
    order: list[int] | None = None
    lines: list[int] = []
    times: list[float] = []
    samples: list[list[float]] = []
    for line, text_line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        if not text_line.strip() or text_line.lstrip().startswith("#"):
            continue
        try:
            cells = [cell.strip() for cell in next(csv.reader([text_line]))]
        except csv.Error as error:  # a field that is too long for it
            raise _LineError(line, f"expected numbers with commas between, got something else ({error})") from None
        if order is None:
            order = _order(line, cells)
            continue
        if len(cells) != len(_COLUMNS):
            raise _LineError(line, f"expected {len(_COLUMNS)} numbers, got {len(cells)}")
        time, *sample = (_number(line, _COLUMNS[index], cells[place]) for index, place in enumerate(order))
        lines.append(line)
        times.append(time)
        samples.append(sample)
        if len(samples) > MAX_SAMPLES:
            raise _LineError(line, f"expected at most {MAX_SAMPLES} samples, got more")
    if len(samples) < 2:
        raise _LineError(len(text.splitlines()) + 1, f"expected at least 2 samples, got {len(samples)}")
    if times[0] != 0.0:
        raise _LineError(lines[0], f"expected t = 0 for the first sample, got {times[0]!r}")
    period = times[-1] / (len(times) - 1)
    for index, (line, time) in enumerate(zip(lines, times, strict=True)):
        if index > 0 and not time > times[index - 1]:
            raise _LineError(line, f"expected times that increase, got t = {time!r} after {times[index - 1]!r}")
    for index, (line, time) in enumerate(zip(lines, times, strict=True)):
        if abs(time - index * period) > _UNEVEN * period:
            even = f"t = {index * period:.9g} (samples every {period:.9g} s, as the first and the last one have)"
            raise _LineError(line, f"expected {even}, got {time!r}")
    return period, samples


def _order(line: int, names: list[str]) -> list[int]:
    """Find the position of each column. The file may be the wrong one, so the message does not quote it."""
    if sorted(names) != sorted(_COLUMNS):
        got = "1 other field" if len(names) == 1 else f"{len(names)} fields"
        missing = ", ".join(name for name in _COLUMNS if name not in names)
        without = f" without {missing}" if 0 < len(set(names) & set(_COLUMNS)) < 4 else ""
        raise _LineError(line, f"expected the names of the columns {', '.join(_COLUMNS)}, got {got}{without}")
    return [names.index(name) for name in _COLUMNS]


def _number(line: int, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _LineError(line, f"{column}: expected a finite number, got other text ({len(cell)} characters)")
    return value
