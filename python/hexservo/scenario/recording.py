"""Recorded motions of a base or a target, from CSV, in SI units and radians."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array
from hexservo.scenario.reading import path_text
from hexservo.scenario.rotations import quaternion_of, quaternion_product
from hexservo.scenario.yaml import ScenarioError, decimal, read_text

MAX_SAMPLES = 10_000
"""Most samples of a recording: a scenario holds them itself, whose file can still be read (`yaml.MAX_BYTES`)."""

_TIME = "t"
_ACCELERATION = ("ax", "ay", "az")
_PLACE = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
_ROTATION = ("rx", "ry", "rz")
_RATE = ("wx", "wy", "wz")
_ATTITUDES = (_QUATERNION, _ROTATION, _RATE)
_UNEVEN = 0.01  # most that a time may be off its place, in sample periods: times are written with few digits
_MOST_TURN = math.pi  # [rad], of the rate times the sample period


@dataclass(frozen=True)
class Recording:
    """Evenly spaced samples; the first is at t = 0."""

    period: float  # [s]
    samples: list[list[float]]  # (n, 3) accelerations [m/s^2] of a base, or displacements [m] of a target
    attitudes: list[list[float]] | None  # (n, 4) quaternions (w, x, y, z) of B in W


def read_base_motion(path: str | os.PathLike[str]) -> Recording:
    """Read the motion of a base from a CSV file.

    The first line names the columns, in any order: ``t`` [s], ``ax, ay, az`` [m/s^2], and of a base that turns one of
    ``qw, qx, qy, qz`` (quaternion of B in W), ``rx, ry, rz`` (rotation vector of B in W [rad]) or ``wx, wy, wz``
    (angular rate in B [rad/s], which is integrated from the attitude of W). Times start at 0 and are evenly spaced.
    Empty lines and lines that start with ``#`` do not count.

    Raises
    ------
    ScenarioError
        A file that cannot be read, or the first thing that is wrong with it, with its line.
    """
    table = _read(path, _ACCELERATION, _ATTITUDES)
    attitudes = None
    if table.extra is _QUATERNION:
        attitudes = table.rows[:, 3:].tolist()
    elif table.extra is _ROTATION:
        attitudes = quaternion_of(table.rows[:, 3:]).tolist()
    elif table.extra is _RATE:
        attitudes = _integrated(table.rows[:, 3:], table.period).tolist()
    return Recording(table.period, table.rows[:, :3].tolist(), attitudes)


def read_target_motion(path: str | os.PathLike[str]) -> Recording:
    """Read the displacements ``x, y, z`` [m] of a target over ``t`` [s], as `read_base_motion` a base's motion."""
    table = _read(path, _PLACE, ())
    return Recording(table.period, table.rows.tolist(), None)


def kinematic(
    samples: Sequence[Sequence[float]], attitudes: Sequence[Sequence[float]] | None, gravity: Sequence[float]
) -> list[list[float]]:
    """Return accelerations along the axes of W of a base whose accelerometer reads these, a = R_WB f + g.

    Parameters
    ----------
    samples
        (n, 3) specific force along the axes of B [m/s^2].
    attitudes
        (n, 4) quaternions of B in W, of any length above 0; None: B does not turn.
    gravity
        (3,) in W [m/s^2].
    """
    force = np.asarray(samples, dtype=float)
    if attitudes is not None:
        q = np.asarray(attitudes, dtype=float)
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        v, w = q[:, 1:], q[:, :1]
        force = force + 2.0 * np.cross(v, np.cross(v, force) + w * force)
    return (force + np.asarray(gravity, dtype=float)).tolist()  # type: ignore[no-any-return]


def _integrated(rates: Array, period: float) -> Array:
    """Return quaternions (n, 4) of B in W from rates in B (n, 3) [rad/s]: the product of the turns between samples.

    A turn is the integral of the rate to fourth order, and the first term of Magnus' series for its change of axis.
    """
    change = np.gradient(rates, period, axis=0, edge_order=2) if len(rates) > 2 else np.zeros_like(rates)
    first, last = rates[:-1], rates[1:]
    turns = (
        period / 2 * (first + last)
        - period**2 / 12 * (change[1:] - change[:-1])
        + period**2 / 12 * np.cross(first, last)
    )
    attitudes = [np.array([1.0, 0.0, 0.0, 0.0])]
    for turn in quaternion_of(turns):
        now = quaternion_product(attitudes[-1], turn)
        attitudes.append(now / np.linalg.norm(now))
    return np.array(attitudes)


class _LineError(Exception):
    """What is wrong, with its line."""

    def __init__(self, line: int, sentence: str) -> None:
        super().__init__(f"line {line}: {sentence}")


@dataclass(frozen=True)
class _Table:
    period: float  # [s]
    rows: Array  # (n, columns) without the times
    extra: tuple[str, ...]  # which columns follow the required ones


def _read(path: str | os.PathLike[str], required: tuple[str, ...], extras: tuple[tuple[str, ...], ...]) -> _Table:
    source = path_text("path", path)
    try:
        return _parsed(read_text(path, "CSV"), required, extras)
    except _LineError as error:
        raise ScenarioError(str(error), source) from None


def _parsed(text: str, required: tuple[str, ...], extras: tuple[tuple[str, ...], ...]) -> _Table:
    columns: tuple[str, ...] = ()
    order: list[int] = []
    lines: list[int] = []
    rows: list[list[float]] = []
    for line, text_line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        if not text_line.strip() or text_line.lstrip().startswith("#"):
            continue
        try:
            cells = [cell.strip() for cell in next(csv.reader([text_line]))]
        except csv.Error as error:  # a field that is too long for it
            raise _LineError(line, f"expected numbers with commas between, got something else ({error})") from None
        if not columns:
            columns = _columns(line, cells, (_TIME, *required), extras)
            order = [cells.index(name) for name in columns]
            continue
        if len(cells) != len(columns):
            raise _LineError(line, f"expected {len(columns)} numbers, got {len(cells)}")
        rows.append([_number(line, columns[index], cells[place]) for index, place in enumerate(order)])
        lines.append(line)
        if len(rows) > MAX_SAMPLES:
            raise _LineError(line, f"expected at most {MAX_SAMPLES} samples, got more")
    if len(rows) < 2:
        raise _LineError(len(text.splitlines()) + 1, f"expected at least 2 samples, got {len(rows)}")
    period = _period(lines, [row[0] for row in rows])
    table = _Table(period, np.array(rows)[:, 1:], columns[1 + len(required) :])
    _require_turns(lines, table)
    extra = next((extra for extra in extras if extra == table.extra), ())
    return _Table(period, table.rows, extra)


def _period(lines: Sequence[int], times: Sequence[float]) -> float:
    """Return the sample period; times that are not even are refused."""
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
    return period


def _require_turns(lines: Sequence[int], table: _Table) -> None:
    """Refuse quaternions that are zero, and rates that are probably degrees."""
    for line, row in zip(lines, table.rows, strict=True):
        size = float(np.linalg.norm(row[3:]))
        if table.extra == _QUATERNION and not size > 0.0:
            raise _LineError(line, "expected a quaternion of unit length, got zero")
        if table.extra == _RATE and not size * table.period <= _MOST_TURN:
            raise _LineError(line, f"expected an angular rate of at most pi in a sample period, got {size:.9g} rad/s")
        if table.extra == _ROTATION and not size <= _core.FULL_TURN:
            raise _LineError(line, f"expected a rotation vector of at most 2 pi (radians), got one of {size:.9g}")


def _columns(
    line: int, names: Sequence[str], required: tuple[str, ...], extras: tuple[tuple[str, ...], ...]
) -> tuple[str, ...]:
    """Find the file's columns. The file may be the wrong one, so the message does not quote it."""
    for extra in ((), *extras):
        if sorted(names) == sorted((*required, *extra)):
            return (*required, *extra)
    got = "1 other field" if len(names) == 1 else f"{len(names)} fields"
    missing = ", ".join(name for name in required if name not in names)
    without = f" without {missing}" if missing and set(names) & set(required) else ""
    more = f" (and, if it turns, {' or '.join(', '.join(extra) for extra in extras)})" if extras and not missing else ""
    wanted = f"{', '.join(required)}{more}"
    raise _LineError(line, f"expected the names of the columns {wanted}, got {got}{without}")


def _number(line: int, column: str, cell: str) -> float:
    value = decimal(cell)
    if value is None or not math.isfinite(value):
        raise _LineError(line, f"{column}: expected a finite number, got other text ({len(cell)} characters)")
    return value
