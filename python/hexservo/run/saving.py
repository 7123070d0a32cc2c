"""Writes results as netCDF files; `hexservo.run.saved` reads them back bit for bit."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from hexservo.run.files import check_file, write_file
from hexservo.run.metrics import METRICS, metrics
from hexservo.run.quantities import array_shapes, problem_of_run
from hexservo.run.sealed import FORMAT, is_sealed, sealed_bytes

if TYPE_CHECKING:
    from hexservo.run.result import LimitEvent, Result

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
    return {"format": FORMAT, **texts, **_numbers(result)}


def result_bytes(result: Result) -> memoryview:
    """Return a file's content, made in memory: on a full disk HDF5 itself does not fail but crashes the process.

    Raises
    ------
    ValueError
        As `require_data`.
    """
    require_data(result)
    return sealed_bytes(result.to_xarray())


def require_data(result: Result) -> None:
    """Refuse a result in which someone wrote what no run has: `load_result` would refuse its file.

    Raises
    ------
    ValueError
        "result: expected the data of a run, got twist, which has numbers that are not finite; ...".
    """
    points = result.scenario.target.count
    names = array_shapes(points, result.weight_history is not None)
    arrays = {name: getattr(result, name) for name in names}
    problem = problem_of_run(arrays, points, result.end_time, result.outcome)
    if problem is None and (missing := [name for name in METRICS if name not in metrics(result)]):
        problem = f"streamed_metrics, which lacks {missing[0]}"
    if problem:
        raise ValueError(f"result: expected the data of a run, got {problem}; use what hs.simulate returned")


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
        As `require_data`.
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


def _numbers(result: Result) -> dict[str, float]:
    found = {"end_time": result.end_time, **{f"metric_{name}": value for name, value in metrics(result).items()}}
    return {name: float(value) for name, value in found.items()}  # also of a whole number, which a file keeps as one
