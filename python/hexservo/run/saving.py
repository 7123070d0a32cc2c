"""Writes results as netCDF files; `hexservo.run.saved` reads them back bit for bit."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo.run.files import check_file, write_file
from hexservo.run.metrics import metrics
from hexservo.run.sealed import FORMAT, is_sealed, sealed_bytes
from hexservo.scenario.arrays import Array

if TYPE_CHECKING:
    from hexservo.run.result import LimitEvent, Result

HISTORY = "weight_history"  # the only array that a result may lack
EVENT_HEAD = "kind leg time peak limit"  # of the table of events; seconds, and the unit of the kind


def saved_attributes(result: Result) -> dict[str, Any]:
    """Return what a file needs beside the arrays, so that `load_result` returns the same result."""
    texts = {
        "controller": result.controller,
        "outcome": result.outcome,
        "detail": result.detail,
        "scenario": result.scenario.to_yaml(),
        "hexservo_version": result.version,
        "event_table": _event_table(result.events),
    }
    return {"format": FORMAT, **texts, "end_time": result.end_time, **_prefixed(metrics(result))}


def result_bytes(result: Result) -> memoryview:
    """Return a file's content, made in memory: on a full disk HDF5 itself does not fail but crashes the process.

    Raises
    ------
    ValueError
        For arrays that no run has, which `load_result` refuses.
    """
    require_arrays(result)
    return sealed_bytes(result.to_xarray())


def require_arrays(result: Result) -> None:
    """Refuse a result in whose arrays someone wrote what no run has.

    Raises
    ------
    ValueError
        "result: expected the arrays of a run, got twist, which has numbers that are not finite; ...".
    """
    arrays = {name: value for name, value in vars(result).items() if isinstance(value, np.ndarray)}
    if problem := problem_of_values(arrays):
        raise ValueError(f"result: expected the arrays of a run, got {problem}; use what hs.simulate returned")


def problem_of_values(arrays: Mapping[Any, Array]) -> str | None:
    """Describe what no run has in its arrays: numbers that are not finite, decreasing times and the like."""
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            return f"{name}, which has numbers that are not finite"
    time = arrays["time"]
    if time[0] != 0 or not (np.diff(time) > 0).all():
        return "time, which does not increase from 0"
    if not np.allclose(np.linalg.norm(arrays["quaternion"], axis=1), 1.0, rtol=0, atol=1e-9):
        return "quaternion, which is not of length 1"
    if not (arrays["depth"] < 0).all():
        return "depth, which is not negative"
    return None


def save_result(result: Result, path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write a result into one file that `load_result` reads back bit for bit, and every reader of netCDF opens.

    Parameters
    ----------
    result
        The run; its outcome does not matter.
    path
        A name in a folder that exists, as ``result.nc``. The file appears whole or not at all.
    force
        Replace a saved result that is as hexservo wrote it; no other file is ever replaced.

    Raises
    ------
    OutputError
        The file exists, is no saved result or was changed, or cannot be written.
    ValueError
        For arrays that no run has, as `result_bytes`.
    """
    check_saved(path, force=force)  # before the work
    write_file(result_bytes(result), path, is_sealed, "hexservo", force=force)


def check_saved(path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Refuse a place that `save_result` would refuse.

    Raises
    ------
    OutputError
        As `save_result`, as far as it can be checked without writing.
    """
    check_file(path, is_sealed, "hexservo", force=force)


def _event_table(events: tuple[LimitEvent, ...]) -> str:
    rows = [f"{event.kind} {event.leg} {event.time!r} {event.peak!r} {event.limit!r}" for event in events]
    return "\n".join([EVENT_HEAD, *rows])


def _prefixed(metrics: Mapping[str, float]) -> dict[str, float]:
    return {f"metric_{name}": value for name, value in metrics.items()}
