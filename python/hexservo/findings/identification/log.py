"""Logs of machines: times, commanded and measured legs, and what the camera saw, from CSV or MCAP."""

from __future__ import annotations

import csv
import math
import os
import stat
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import numpy as np

from hexservo.findings.identification.mcap_log import read_mcap
from hexservo.scenario.arrays import Array, real_numbers
from hexservo.scenario.fields import described
from hexservo.scenario.reading import path_text
from hexservo.scenario.wording import wrong_type
from hexservo.scenario.yaml import ScenarioError

MAX_ROWS = 1_000_000
MAX_BYTES = 500_000_000
FITTED = 0.7
"""Share of a log that models are fitted to; the rest shows how well they predict."""
LEAST_EXPLAINED = 0.5
"""Share of the motion in that rest that a model has to predict: one that predicts less is of something else."""
_STILL = 5.0  # standard deviations of the noise that a leg has to move by
_FEWEST = 50  # rows: with fewer there is nothing to fit
_LONGEST = 0.5  # [s]: no machine is commanded more seldom
_UNEVEN = 0.05  # of the period: most that a tick may be off its place
_TIME, _EXPOSURE, _ARRIVAL = "time", "exposure", "arrival"
_LEGS = tuple(range(1, 7))
_REQUIRED = (_TIME, *(f"{name}_{leg}" for name in ("command", "joint") for leg in _LEGS))  # columns


@described
@dataclass(frozen=True, eq=False)
class Frames:
    """Images that arrived, m of them."""

    features: Array  # (m, 2p) pixels as the camera counts them, x1, y1, x2, ... [px]
    arrival: Array  # (m,) when the program had them [s]
    exposure: Array | None  # (m,) when they were taken [s]; None where the log has no such times

    def __post_init__(self) -> None:
        """Make arrays of lists, and refuse what is not numbers."""
        _make_arrays(self, ("features", "arrival") if self.exposure is None else ("features", "arrival", "exposure"))


@described
@dataclass(frozen=True, eq=False)
class Log:
    """Record of a machine that takes positions: n ticks, evenly spaced.

    At a tick the joints are read and then a command is given, which is q* from then on.
    """

    time: Array  # (n,) [s]
    period: float  # of the ticks [s]
    commands: Array  # (n, 6) commanded leg coordinates: lengths [m], or angles of cranks [rad]
    joints: Array  # (n, 6) the same as measured
    frames: Frames | None  # None where the log has no image

    def __post_init__(self) -> None:
        """Make arrays of lists, and refuse those that do not fit each other.

        Raises
        ------
        TypeError
            For a period that is no number, and for frames of another type.
        ValueError
            For what is not numbers, other shapes, numbers that are not finite, and times that are not evenly spaced.
        """
        _make_arrays(self, ("time", "commands", "joints"))
        period: object = self.period
        frames: object = self.frames
        if not isinstance(period, Real):
            raise wrong_type("period", "a number of seconds", period)
        if not isinstance(frames, Frames | None):
            raise wrong_type("frames", "Frames or None", frames)
        if self.time.ndim != 1:
            raise ValueError(f"time: expected (n,) finite numbers, got shape {self.time.shape}")
        count = len(self.time)
        for name in ("commands", "joints"):
            values = getattr(self, name)
            if values.shape != (count, 6):
                raise ValueError(f"{name}: expected ({count}, 6) finite numbers, got shape {values.shape}")
            if not np.isfinite(values).all():
                tick, leg = np.argwhere(~np.isfinite(values))[0]
                raise ValueError(
                    f"{name}: expected finite numbers, got {values[tick, leg]} of leg {leg + 1} at tick {tick}"
                )
        if count < _FEWEST:
            raise ValueError(f"time: expected at least {_FEWEST} ticks, got {count}")
        if not np.isfinite(self.time).all():
            raise ValueError("time: expected finite numbers, got others")
        if self.period > _LONGEST:
            raise ValueError(
                f"time: expected seconds, with ticks of at most {_LONGEST} s, got one every {self.period:.6g}: are "
                "they in ms? Divide the times by 1000, arrival and exposure too"
            )
        places = self.time[0] + self.period * np.arange(count)
        off = np.abs(self.time - places)
        if not self.period > 0.0 or not (off <= _UNEVEN * self.period).all():
            worst = int(np.argmax(off))
            raise ValueError(
                f"time: expected a tick every {self.period:.6g} s, got one at {self.time[worst]:.6g} s, "
                f"{off[worst]:.3g} s off its place; resample the log to even ticks"
            )
        if self.frames is not None:
            _check_frames(self.frames)


def leg_moves(commands: Array, joints: Array, part: slice) -> bool:
    """Return whether a leg was commanded to move by more than its noise in a part of a log, and moved at all.

    Parameters
    ----------
    commands, joints
        (n,) of the leg in the whole log [m; rad].
    part
        Ticks that count.
    """
    noise = float(np.std(np.diff(joints))) / float(np.sqrt(2.0))
    way = float(np.ptp(commands[part]))
    return way > 0.0 and way > _STILL * noise and float(np.ptp(joints[part])) > 0.0


def _make_arrays(record: Frames | Log, names: Sequence[str]) -> None:
    for name in names:
        given = getattr(record, name)
        numbers = real_numbers(given)
        if numbers is None:
            raise ValueError(f"{name}: expected real numbers, got {given!r:.60}")
        object.__setattr__(record, name, numbers)


def _check_frames(frames: Frames) -> None:
    count = len(frames.arrival)
    if frames.features.ndim != 2 or len(frames.features) != count or not np.isfinite(frames.features).all():
        raise ValueError(f"features: expected ({count}, 2p) finite numbers, got shape {frames.features.shape}")
    if (np.diff(frames.arrival) < 0.0).any():
        raise ValueError("arrival: expected times that do not decrease, got an earlier one after a later one")
    if frames.exposure is not None and not (frames.exposure <= frames.arrival).all():
        raise ValueError("exposure: expected times before the arrival of the frame, got a later one")


def read_log(path: str | os.PathLike[str]) -> Log:
    """Read the log of a machine from a CSV file, or from an MCAP file (extra ``mcap``) if its name ends in ``.mcap``.

    docs/identification.md has the topics and messages of MCAP. In CSV, the first line names the columns, in any order:

    ===============================  ==================================================================
    ``time``                         of a tick [s], evenly spaced
    ``command_1`` ... ``command_6``  coordinates that the legs are sent to at the tick: [m], of cranks [rad]
    ``joint_1`` ... ``joint_6``      the same as measured at the tick, before the command
    ``x_1, y_1, x_2, ...``           pixels of a frame that arrived since the tick before; empty without one
    ``arrival``                      when it arrived [s]; without this column at the tick of its line
    ``exposure``                     when it was taken [s], if the machine has it
    ===============================  ==================================================================

    The columns of the image may be missing, all of them. Lines that start with ``#`` do not count.

    Raises
    ------
    ScenarioError
        A file that cannot be read, or the first thing that is wrong with it, with its line or message; an MCAP file
        where the package `mcap` is missing.
    """
    source = path_text("path", path)
    try:
        if not stat.S_ISREG(Path(source).stat().st_mode) or Path(source).stat().st_size > MAX_BYTES:
            raise ScenarioError(f"cannot be read: expected a regular file of at most {MAX_BYTES} bytes", source)
        if source.lower().endswith(".mcap"):
            return _of_mcap(source)
        with Path(source).open(newline="", encoding="utf-8-sig") as file:
            return _parsed(file, source)
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror or error}", source) from None
    except UnicodeDecodeError as error:
        raise ScenarioError(f"expected UTF-8 text, got a byte that is none at {error.start}", source) from None
    except (csv.Error, ValueError) as error:
        if isinstance(error, ScenarioError):
            raise
        raise ScenarioError(str(error), source) from None


def _of_mcap(source: str) -> Log:
    found = read_mcap(Path(source), source, most_bytes=MAX_BYTES, most_rows=MAX_ROWS)
    frames = None if found.features is None else Frames(found.features, found.arrival, found.exposure)
    return Log(found.time, found.period, found.commands, found.joints, frames)


def _parsed(lines: Iterable[str], source: str) -> Log:
    columns: Mapping[str, int] | None = None
    points = 0
    rows: list[list[float]] = []
    reader = csv.reader("\n" if line.lstrip().startswith("#") else line for line in lines)  # each line counts
    for cells in reader:
        if not cells:
            continue
        if columns is None:
            columns, points = _columns(cells, source)
            continue
        if len(cells) != len(columns):
            raise ScenarioError(f"line {reader.line_num}: expected {len(columns)} fields, got {len(cells)}", source)
        if len(rows) == MAX_ROWS:
            raise ScenarioError(f"line {reader.line_num}: expected at most {MAX_ROWS} ticks, got more", source)
        row = [_number(cell, name, reader.line_num, source) for cell, name in zip(cells, columns, strict=True)]
        for name in _REQUIRED:
            if math.isnan(row[columns[name]]):
                raise ScenarioError(f"line {reader.line_num}, {name}: expected a finite number, got none", source)
        rows.append(row)
    if columns is None or not rows:
        raise ScenarioError("expected a line of column names and lines of numbers, got none", source)
    table = dict(zip(columns, np.array(rows).T, strict=True))
    time = table[_TIME]
    period = float(time[-1] - time[0]) / max(1, len(time) - 1)
    commands, joints = (np.stack([table[f"{name}_{leg}"] for leg in _LEGS], axis=1) for name in ("command", "joint"))
    frames = _frames(table, points, source) if points else None
    return Log(time, period, commands, joints, frames)


def _columns(cells: Sequence[str], source: str) -> tuple[Mapping[str, int], int]:
    """Return the place of each column and the number of points; the file may be the wrong one, so none is quoted."""
    names = [cell.strip() for cell in cells]
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        raise ScenarioError(f"expected the columns {', '.join(_REQUIRED)}, got none of {', '.join(missing)}", source)
    points = sum(f"x_{point}" in names for point in range(1, len(names)))
    image = [f"{axis}_{point}" for point in range(1, points + 1) for axis in "xy"]
    known = {*_REQUIRED, *image, *([_EXPOSURE, _ARRIVAL] if points else [])}
    unknown = len(set(names) - known)
    if unknown or len(names) != len(set(names)) or not set(image) <= set(names):
        raise ScenarioError(
            f"expected each of {', '.join(_REQUIRED)} once, and of an image x_1, y_1, x_2, ..., exposure and arrival, "
            f"got {unknown or 'repeated or unpaired'} other columns",
            source,
        )
    return {name: place for place, name in enumerate(names)}, points


def _number(cell: str, column: str, line: int, source: str) -> float:
    if not cell.strip():
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise ScenarioError(
            f"line {line}, {column}: expected a finite number, got other text ({len(cell)} characters)", source
        )
    return value


def _frames(table: Mapping[str, Array], points: int, source: str) -> Frames | None:
    features = np.stack([table[f"{axis}_{point}"] for point in range(1, points + 1) for axis in "xy"], axis=1)
    came = np.isfinite(features).all(axis=1)  # frames with lost points are left out
    if not came.any():
        return None
    arrival = table.get(_ARRIVAL, table[_TIME])[came]
    exposure = table[_EXPOSURE][came] if _EXPOSURE in table else None
    if not np.isfinite(arrival).all() or not (exposure is None or np.isfinite(exposure).all()):
        raise ScenarioError("expected arrival and exposure of every frame, got lines with an image without", source)
    return Frames(features[came], arrival, exposure)
