"""Logs of machines: times, commanded and measured legs, and what the camera saw, from CSV or MCAP."""

from __future__ import annotations

import csv
import math
import os
import re
import stat
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path

import numpy as np
from scipy.special import comb

from hexservo.findings.identification.interval import NORMAL
from hexservo.findings.identification.mcap_log import period_of, read_mcap
from hexservo.scenario.arrays import Array, Mask, real_numbers
from hexservo.scenario.fields import described
from hexservo.scenario.reading import EMPTY_PATH, path_text
from hexservo.scenario.wording import wrong_type
from hexservo.scenario.yaml import ScenarioError, decimal

MAX_ROWS = 1_000_000
MAX_BYTES = 500_000_000
FITTED = 0.7
"""Share of a log that models are fitted to; the rest shows how well they predict."""
LEAST_EXPLAINED = 0.5
"""Share of the motion in that rest that a model has to predict: one that predicts less is of something else."""
JUDGED = 5.0
"""Standard deviations of the noise, of those of a leg's readings that a prediction is judged by: noise is 4 % of it."""
FEWEST = 50
"""Ticks: with fewer there is nothing to fit."""
RESOLVED = 12
"""Decimals of readings [m; rad], beyond which two differ by the arithmetic of a driver alone."""
_STILL = 5.0  # standard deviations of the noise that a leg has to move by
_MOTION = 1.4  # of readings over that of their noise, where the leg moves: half of the variance
_DIFFERENCES = 6  # of readings one after the other: they have little of a motion, and much of white noise
_LONGEST = 0.5  # [s]: no machine is commanded more seldom
_UNEVEN = 0.05  # of the period: most that a tick may be off its place
_LATE = 0.5  # of the period: most that a few ticks may be, as where the computer was late
_PAUSE = 1.75  # of the usual time between two ticks: from which on ticks are missing, if the next one is not early
_FEW = 0.02  # share of the ticks: with so many the lag of drives of 6 Hz is found to 1 % at 50 ticks a second
_BEYOND = 0.5  # [s]: most that a frame may be before the first tick or after the last
_LEAST_ADVANCE = 0.1  # of the time between the first and the last arrival: least between their exposures
_TIME, _EXPOSURE, _ARRIVAL = "time", "exposure", "arrival"
_LEGS = tuple(range(1, 7))
_SEPARATORS = {";": "semicolons", "\t": "tabs"}  # that other programs write between columns
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # byte-order marks
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+(?:[eE][-+]?[0-9]+)?")
_REQUIRED = (_TIME, *(f"{name}_{leg}" for name in ("command", "joint") for leg in _LEGS))  # columns


@described
@dataclass(frozen=True, eq=False)
class Frames:
    """Images that arrived, m of them."""

    features: Array  # (m, 2p) pixels as the camera counts them, x1, y1, x2, ... [px]; NaN of points that are lost
    arrival: Array  # (m,) when the program had them [s]
    exposure: Array | None  # (m,) when they were taken [s]; None where the log has no such times

    def __post_init__(self) -> None:
        """Make arrays of lists, and refuse what is not numbers."""
        _make_arrays(self, ("features", "arrival") if self.exposure is None else ("features", "arrival", "exposure"))
        if _has_pairs(self.features):  # others are refused by the log
            self.features[np.repeat(~self.seen, 2, axis=1)] = np.nan

    @property
    def seen(self) -> Mask:
        """Which points the frames have, (m, p)."""
        return np.asarray(~np.isnan(self.features.reshape(len(self.features), -1, 2)).any(axis=2))

    def only(self, frames: Mask) -> Frames:
        """Return some of the frames, (m,)."""
        exposure = None if self.exposure is None else self.exposure[frames]
        return Frames(self.features[frames], self.arrival[frames], exposure)


@described
@dataclass(frozen=True, eq=False)
class Log:
    """Record of a machine that takes positions: n ticks, evenly spaced, of which 2 % may be late by half a period.

    At a tick the joints are read and then a command is given, which is q* from then on. Times may be given by any clock
    that is the same for all of them, as seconds since 1970; the record has them from its first tick on.
    """

    time: Array  # (n,) after the first tick [s]
    period: float  # of the ticks [s], to the decimals that the given times determine
    commands: Array  # (n, 6) commanded leg coordinates: lengths [m], or angles of cranks [rad]
    joints: Array  # (n, 6) the same as measured
    frames: Frames | None  # None where the log has no image

    @property
    def step(self) -> float:
        """The period as a scenario has it, with nine digits [s]."""
        return float(f"{self.period:.9g}")

    def step_near(self, given: float) -> float:
        """Return a scenario's step [s] where it is the period as far as the times of the ticks tell, else `step`.

        They tell the period to nine digits at best, and no better than they are even: 1/60 s is no decimal number.
        """
        uneven = float(np.abs(self.time - self.period * np.arange(len(self.time))).max())
        alike = abs(given - self.period) <= 2.0 * uneven / (len(self.time) - 1)
        return given if alike or float(f"{given:.9g}") == self.step else self.step

    def __post_init__(self) -> None:
        """Make arrays of lists, count times from the first tick, and refuse those that do not fit each other.

        Raises
        ------
        TypeError
            For a period that is no number, and for frames of another type.
        ValueError
            For what is not numbers, other shapes, numbers that are not finite, times that are not evenly spaced, and
            frames whose times are not on the clock of the ticks.
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
        if count < FEWEST:
            raise ValueError(f"time: expected at least {FEWEST} ticks, got {count}")
        if not np.isfinite(self.time).all():
            raise ValueError("time: expected finite numbers, got others")
        if fault := _fault_of_order(self.time, "ticks"):
            tick, words = fault
            raise ValueError(f"tick {tick}, time: {words}")
        if self.period > _LONGEST:
            raise ValueError(
                f"time: expected seconds, with ticks of at most {_LONGEST} s, got one every {self.period:.6g}: are "
                "they in ms? Divide the times by 1000, arrival and exposure too. A count of ticks is none of seconds: "
                "multiply it by the period"
            )
        passed = self.time - self.time[0]
        off = passed - self.period * np.arange(count)
        off = np.abs(off - np.median(off))  # the first tick may be a late one
        few = float((off > _UNEVEN * self.period).mean()) <= _FEW
        if not self.period > 0.0 or not (off <= (_LATE if few else _UNEVEN) * self.period).all():
            worst = int(np.argmax(off))
            if pause := _fault_of_pause(passed):
                raise ValueError(pause)
            raise ValueError(
                f"time: expected a tick every {self.period:.6g} s, got one {passed[worst]:.6g} s after the first, "
                f"{off[worst]:.3g} s off its place; resample the log to even ticks"
            )
        if self.frames is not None:
            _check_frames(self.frames, self.time)
        self._count_from_first_tick()

    def _count_from_first_tick(self) -> None:
        """Count all times from the first tick: a fit shifts them by less than seconds since 1970 resolve."""
        first = self.time[0]
        resolution = float(np.spacing(np.abs(self.time).max())) / (len(self.time) - 1)
        object.__setattr__(self, "period", round(float(self.period), math.floor(-math.log10(resolution))))
        object.__setattr__(self, "time", self.time - first)
        if self.frames is not None:
            exposure = None if self.frames.exposure is None else self.frames.exposure - first
            object.__setattr__(
                self, "frames", replace(self.frames, arrival=self.frames.arrival - first, exposure=exposure)
            )


def scatter(joints: Array) -> float:
    """Return what a coordinate (n,) changes by from tick to tick, as a standard deviation of white noise."""
    return float(np.std(np.diff(joints))) / float(np.sqrt(2.0))


def joint_deviations(readings: Array) -> Array:
    """Return the standard deviation of the white noise of each joint, (6,) [m; rad].

    It is too large where a tick is long for the motion (`is_motion`): then a spline is off by as much between two.

    Parameters
    ----------
    readings
        (n, 6) of the joints at the ticks, or what a model leaves of them [m; rad]; (n,) of one.
    """
    differences = np.abs(np.diff(readings, n=_DIFFERENCES, axis=0))
    return np.asarray(NORMAL * np.median(differences, axis=0) / np.sqrt(comb(2 * _DIFFERENCES, _DIFFERENCES)))


def reading_noise(joints: Array) -> float:
    """Return the standard deviation of a coordinate's (n,) noise, from readings one after the other, or its rounding.

    Rounding to steps of d has the variance d^2/12, of which a leg at rest shows nothing.
    """
    return max(float(joint_deviations(joints)), least_step([joints]) / float(np.sqrt(12.0)))


def least_step(legs: Iterable[Array]) -> float:
    """Return the smallest step between different readings of a leg, each (n,) [m; rad]; 0 where all are the same."""
    steps = np.concatenate([np.diff(np.unique(np.round(leg, RESOLVED))) for leg in legs])
    return float(steps.min()) if len(steps) else 0.0


def leg_moves(commands: Array, joints: Array, part: slice, least: float = _MOTION) -> bool:
    """Return whether a leg was commanded to move by more than its noise in a part of a log, and moved beyond it.

    Parameters
    ----------
    commands, joints
        (n,) of the leg in the whole log [m; rad].
    part
        Ticks that count.
    least
        Standard deviation of the readings there, in those of the noise.
    """
    way = float(np.ptp(commands[part]))
    if way == 0.0 or way <= _STILL * scatter(joints) or float(np.ptp(joints[part])) == 0.0:
        return False
    return float(np.std(joints[part])) > least * reading_noise(joints)


def predicted_share(commands: Array, joints: Array, predicted: Array, part: slice) -> float | None:
    """Return the share of a leg's motion (variance) in a part of a log that is predicted, 1: all.

    Parameters
    ----------
    commands, joints
        (n,) of the leg in the whole log [m; rad].
    predicted
        (k,) coordinates at the ticks of the part [m; rad].
    part
        Ticks that count.

    Returns
    -------
    float or None
        None where the readings vary by less than 5 times their noise: a leg that friction holds has nothing but noise,
        which no model predicts.
    """
    if not leg_moves(commands, joints, part, JUDGED):
        return None
    return 1.0 - float(np.mean((joints[part] - predicted) ** 2)) / float(np.var(joints[part]))


def _has_pairs(features: Array) -> bool:
    return features.ndim == 2 and features.shape[1] % 2 == 0


def _make_arrays(record: Frames | Log, names: Sequence[str]) -> None:
    for name in names:
        given = getattr(record, name)
        numbers = real_numbers(given)
        if numbers is None:
            raise ValueError(f"{name}: expected real numbers, got {given!r:.60}")
        object.__setattr__(record, name, numbers)


def _fault_of_pause(passed: Array) -> str:
    """Return where ticks (n,) [s] are missing, so that all later ones are off their places; "" where none are."""
    steps = np.diff(passed)
    usual, tick = float(np.median(steps)), int(np.argmax(steps))
    if steps[tick] < _PAUSE * usual or (tick + 1 < len(steps) and steps[tick + 1] < _LATE * usual):
        return ""
    return (
        f"time: expected a tick every {usual:.6g} s, got none for {steps[tick]:.6g} s from {passed[tick]:.6g} s after "
        "the first on; cut the log there, and give one of its parts"
    )


def _fault_of_order(time: Array, rows: str) -> tuple[int, str] | None:
    """Return the first tick that is not later than the one before it, counted from 0, and what is wrong with it.

    Parameters
    ----------
    time
        (n,) of the ticks [s].
    rows
        What each of them is, in the plural.
    """
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if not len(back):
        return None
    tick = int(back[0]) + 1
    repair = f"keep one of the two {rows}" if time[tick] == time[tick - 1] else f"sort the {rows} by their times"
    return tick, f"expected times that increase, got {time[tick]:.12g} after {time[tick - 1]:.12g}; {repair}"


def _check_frames(frames: Frames, time: Array) -> None:
    count = len(frames.arrival)
    if not _has_pairs(frames.features) or len(frames.features) != count or np.isinf(frames.features).any():
        raise ValueError(
            f"features: expected ({count}, 2p) finite numbers, NaN of lost points, got shape {frames.features.shape}"
        )
    if fault := _fault_of_times(frames, time):
        frame, words = fault
        raise ValueError(f"frame {frame + 1}, {words}")


def _fault_of_times(frames: Frames, time: Array) -> tuple[int, str] | None:
    """Return the first frame whose times are wrong, and what is wrong with them."""
    arrival, exposure = frames.arrival, frames.exposure
    ends = f"{time[0]:.12g} to {time[-1]:.12g} s"
    same_clock = "give it in seconds of the clock of time"
    outside = ~((arrival >= time[0] - _BEYOND) & (arrival <= time[-1] + _BEYOND))
    if outside.any():
        frame = int(np.argmax(outside))
        return frame, f"arrival: expected a time of the log, {ends}, got {arrival[frame]:.12g}; {same_clock}"
    back = np.diff(arrival, prepend=arrival[:1]) < 0.0
    if back.any():
        frame = int(np.argmax(back))
        before = f"got {arrival[frame]:.12g} after {arrival[frame - 1]:.12g}"
        return frame, f"arrival: expected times that do not decrease, {before}; sort the frames"
    if exposure is None or not len(arrival):
        return None
    late = ~(exposure <= arrival)
    if late.any():
        frame = int(np.argmax(late))
        times = f"{arrival[frame]:.12g}, got the later {exposure[frame]:.12g}"
        return frame, f"exposure: expected a time before the arrival of the frame at {times}; {same_clock}"
    last = len(arrival) - 1
    if np.ptp(exposure) < _LEAST_ADVANCE * np.ptp(arrival):
        return last, (
            f"exposure: expected times that advance from frame to frame as arrivals do, by {np.ptp(arrival):.6g} s in "
            f"the log, got {np.ptp(exposure):.6g} s; leave the column out where the machine has no such times"
        )
    if exposure[last] < time[0] - _BEYOND:
        return last, f"exposure: expected a time of the log, {ends}, got {exposure[last]:.12g}; {same_clock}"
    return None


def read_log(path: str | os.PathLike[str]) -> Log:
    """Read the log of a machine from a CSV file, or from an MCAP file (extra ``mcap``) if its name ends in ``.mcap``.

    docs/identification.md has the topics and messages of MCAP. In CSV, the first line names the columns, in any order:

    ===============================  ==================================================================
    ``time``                         of a tick [s] by any clock, evenly spaced
    ``command_1`` ... ``command_6``  coordinates that the legs are sent to at the tick: [m], of cranks [rad]
    ``joint_1`` ... ``joint_6``      the same as measured at the tick, before the command
    ``x_1, y_1, x_2, ...``           pixels of a frame that arrived since the tick before; empty without one, and
                                     where a point is lost
    ``arrival``                      when it arrived [s], else empty; without this column at the tick of its line
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
        if not source:
            raise ValueError(EMPTY_PATH)
        if not stat.S_ISREG(Path(source).stat().st_mode) or Path(source).stat().st_size > MAX_BYTES:
            raise ScenarioError(f"cannot be read: expected a regular file of at most {MAX_BYTES} bytes", source)
        if source.lower().endswith(".mcap"):
            return _of_mcap(source)
        with Path(source).open(newline="", encoding="utf-8-sig") as file:
            return _parsed(file, source)
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror or error}", source) from None
    except UnicodeDecodeError as error:
        got = "UTF-16" if error.object[:2] in _UTF_16 else f"a byte that is none at {error.start}"
        raise ScenarioError(f"expected UTF-8 text, got {got}; save the file as UTF-8", source) from None
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
    numbered: list[int] = []  # lines of the file, of the rows
    reader = csv.reader("\n" if line.lstrip().startswith("#") else line for line in lines)  # each line counts
    for cells in reader:
        if not cells:
            continue
        if columns is None:
            columns, points = _columns(cells, source)
            continue
        if len(cells) != len(columns):
            hint = "; a comma separates fields: decimals need a point" if len(cells) > len(columns) else ""
            raise ScenarioError(
                f"line {reader.line_num}: expected {len(columns)} fields, got {len(cells)}{hint}", source
            )
        if len(rows) == MAX_ROWS:
            raise ScenarioError(f"line {reader.line_num}: expected at most {MAX_ROWS} ticks, got more", source)
        row = [_number(cell, name, reader.line_num, source) for cell, name in zip(cells, columns, strict=True)]
        for name in _REQUIRED:
            if math.isnan(row[columns[name]]):
                raise ScenarioError(f"line {reader.line_num}, {name}: expected a finite number, got none", source)
        rows.append(row)
        numbered.append(reader.line_num)
    if columns is None or not rows:
        raise ScenarioError("expected a line of column names and lines of numbers, got none", source)
    table = dict(zip(columns, np.array(rows).T, strict=True))
    time = table[_TIME]
    if fault := _fault_of_order(time, "lines"):
        tick, words = fault
        raise ScenarioError(f"line {numbered[tick]}, time: {words}", source)
    period = period_of(time)
    commands, joints = (np.stack([table[f"{name}_{leg}"] for leg in _LEGS], axis=1) for name in ("command", "joint"))
    frames = _frames(table, points, numbered, source) if points else None
    return Log(time, period, commands, joints, frames)


def _columns(cells: Sequence[str], source: str) -> tuple[Mapping[str, int], int]:
    """Return the place of each column and the number of points; the file may be the wrong one, so none is quoted."""
    names = [cell.strip() for cell in cells]
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        some = len(missing) < len(_REQUIRED)
        got = _kind_of_names(names) or (
            f"all but {', '.join(missing)}" if some else f"a line of {len(names)} other names"
        )
        raise ScenarioError(f"expected the columns {', '.join(_REQUIRED)}, got {got}", source)
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


def _kind_of_names(names: Sequence[str]) -> str:
    """Return in what other form the names of columns are that of a log, and what to do; "" where they are none."""
    line = ",".join(names)
    if "\0" in line:
        return "UTF-16; save the file as UTF-8"
    for separator, called in _SEPARATORS.items():
        if set(_REQUIRED) <= {name.strip(' "').lower() for name in line.split(separator)}:
            return f"them with {called} between; write commas between fields, and decimals with a point"
    lower = {name.lower(): name for name in names}
    capitals = [lower[name] for name in _REQUIRED if lower.get(name, name) != name]
    if capitals and set(_REQUIRED) <= lower.keys():
        return f"{', '.join(capitals)}; write the names in lower case"
    return ""


def _number(cell: str, column: str, line: int, source: str) -> float:
    text = cell.strip()
    if not text or text.lower() == "nan":  # as other programs write that there is none
        return math.nan
    value = decimal(text)
    if value is None and _DECIMAL_COMMA.fullmatch(text):
        raise ScenarioError(f"line {line}, {column}: expected a finite number, got one with a decimal comma", source)
    if value is None or math.isinf(value):
        raise ScenarioError(
            f"line {line}, {column}: expected a finite number, got other text ({len(cell)} characters)", source
        )
    return value


def _frames(table: Mapping[str, Array], points: int, numbered: Sequence[int], source: str) -> Frames | None:
    features = np.stack([table[f"{axis}_{point}"] for point in range(1, points + 1) for axis in "xy"], axis=1)
    came = np.isfinite(features).any(axis=1)
    if not came.any():
        return None
    every = table.get(_ARRIVAL, table[_TIME])
    # A frame of which all points are lost has a new arrival; the time of a line is none in a log that has it in each.
    new = every > np.fmax.accumulate(np.concatenate([[-np.inf], every[:-1]]))
    new &= (every != table[_TIME]) | np.isnan(every).any()
    came |= new & np.isfinite(table.get(_EXPOSURE, every))
    arrival, exposure = every[came], table[_EXPOSURE][came] if _EXPOSURE in table else None
    if not np.isfinite(arrival).all() or not (exposure is None or np.isfinite(exposure).all()):
        raise ScenarioError("expected arrival and exposure of every frame, got lines with an image without", source)
    frames = Frames(features[came], arrival, exposure)
    if fault := _fault_of_times(frames, table[_TIME]):
        frame, words = fault
        raise ScenarioError(f"line {np.array(numbered)[came][frame]}, {words}", source)
    return frames
