"""Reads results from the netCDF files that `hexservo.run.saving` writes."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from typing import Any, cast, get_args

import numpy as np

from hexservo.run.metrics import METRICS
from hexservo.run.quantities import HISTORY, Outcome, array_shapes, problem_of_run
from hexservo.run.result import LimitEvent, LimitKind, Result
from hexservo.run.saving import EVENT_HEAD
from hexservo.run.sealed import ResultError, line_of, refuse_changed, sealed_blocks, shown_path
from hexservo.scenario.arrays import Array
from hexservo.scenario.reading import RESULT_OF_RUN, open_regular
from hexservo.scenario.yaml import ScenarioError

_TEXTS = ("controller", "outcome", "detail", "scenario", "hexservo_version", "event_table")
_NUMBERS = ("end_time", *(f"metric_{name}" for name in METRICS))


# ---- Reading --------------------------------------------------------------------------------------------------------


def load_result(path: str | os.PathLike[str]) -> Result:
    """Read a result from a file that ``hexservo run --out`` or `Result.save` wrote.

    The result is the same bit for bit: arrays, metrics, events and scenario. A file that another program has changed is
    refused, even if only an attribute was added. Other programs open it as any netCDF file.

    Parameters
    ----------
    path
        The file, of at most 4 GiB.

    Raises
    ------
    ResultError
        For a file that does not exist or cannot be read, was not written by hexservo, is damaged or was changed, or has
        another format; also if its digest is correct and its content is not that of a run.
    """
    place = shown_path(path)
    try:
        with open_regular(path, [RESULT_OF_RUN]) as file:
            content = b"".join(sealed_blocks(file, place, os.fstat(file.fileno()).st_size))
    except ResultError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null character in the path, or no regular file
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ResultError(f"{place}: expected a file that can be read, got: {reason}") from None
    arrays, attributes = _parsed(content, place)
    return _result(arrays, attributes, place)


def _parsed(content: bytes, place: str) -> tuple[dict[str, Array], dict[str, Any]]:
    """Read arrays and attributes from bytes whose digest is correct: any error in them was already written."""
    import h5py

    try:
        with h5py.File(io.BytesIO(content), "r") as file:  # netCDF's own library has trouble closing damaged files
            attributes = {name: _plain(file.attrs[name]) for name in (*_TEXTS, *_NUMBERS) if name in file.attrs}
            arrays = {}
            for name in array_shapes(0, HISTORY in file):
                data = file[name]
                if data.nbytes > len(content):  # more than was written
                    refuse_changed(place, f"{name}, which is larger than the file")
                arrays[name] = np.ascontiguousarray(data[...])
    except ResultError:
        raise
    except Exception as error:  # whatever HDF5 and its wrappers raise
        refuse_changed(place, line_of(error))
    return arrays, attributes


# ---- From arrays to a result ----------------------------------------------------------------------------------------


def _result(arrays: Mapping[str, Array], attributes: Mapping[str, Any], place: str) -> Result:
    from hexservo.scenario.scenario import Scenario

    for name in (*_TEXTS, *_NUMBERS):
        if not isinstance(attributes.get(name), float if name in _NUMBERS else str):
            refuse_changed(place, f"attribute {name}")
    texts, numbers = ({name: attributes[name] for name in names} for names in (_TEXTS, _NUMBERS))
    try:
        scenario = Scenario.from_yaml(texts["scenario"])
    except ScenarioError as error:
        raise ResultError(f"{place}: its scenario: {line_of(error)}") from None
    if problem := problem_of_run(arrays, scenario.target.count, numbers["end_time"], texts["outcome"]):
        refuse_changed(place, problem)
    return Result(
        scenario=scenario,
        controller=texts["controller"],
        outcome=cast("Outcome", texts["outcome"]),
        end_time=numbers["end_time"],
        detail=texts["detail"],
        events=_events(texts["event_table"], place, scenario.robot.legs == "rotary"),
        **arrays,
        streamed_metrics={name: numbers[f"metric_{name}"] for name in METRICS},
        version=texts["hexservo_version"],
    )


def _events(table: str, place: str, rotary: bool) -> tuple[LimitEvent, ...]:
    head, *rows = table.split("\n")
    try:
        if head != EVENT_HEAD:
            raise ValueError(head)
        events = []
        for row in rows:
            kind, leg, time, peak, limit = row.split(" ")
            if kind not in get_args(LimitKind) or leg not in tuple("123456"):
                raise ValueError(row)
            numbers = float(time), float(peak), float(limit)
            events.append(LimitEvent(cast("LimitKind", kind), int(leg), *numbers, rotary))
    except ValueError:
        refuse_changed(place, "attribute event_table")
    return tuple(events)


# ---- Parts ----------------------------------------------------------------------------------------------------------


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic | np.ndarray) and np.size(value) == 1 else value
