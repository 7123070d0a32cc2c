"""Results as netCDF files: writes them, and reads them back bit for bit."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from hexservo._metrics import METRICS
from hexservo._result import _QUANTITIES, LimitEvent, LimitKind, Outcome, Result
from hexservo._yaml import ScenarioError

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["FORMAT", "ResultError", "load_result", "netcdf_bytes", "saved_attributes"]

FORMAT = 1
"""Of the files: raised with every change of what a file holds, metrics included. A larger number is not known here."""

_DIGEST = "sha256"
_HISTORY = "weight_history"  # the only array that a result may lack
_EVENT_HEAD = "kind leg time peak limit"  # of the table of events; seconds, and metres (stroke) or newtons (force)
_TEXTS = ("controller", "outcome", "detail", "scenario", "hexservo_version", "event_table")
_NUMBERS = ("end_time", *(f"metric_{name}" for name in METRICS))


class ResultError(ValueError):
    """A file is no saved result, is damaged or is of a format that is not known; the text says which."""


def saved_attributes(result: Result) -> dict[str, Any]:
    """Give what a file must hold beside the arrays, so that `load_result` can give the same result again."""
    from hexservo._metrics import metrics

    texts = {
        "controller": result.controller,
        "outcome": result.outcome,
        "detail": result.detail,
        "scenario": result.scenario.to_yaml(),
        "hexservo_version": result.version,
        "event_table": _event_table(result.events),
    }
    numbers = {"end_time": result.end_time, **{f"metric_{name}": value for name, value in metrics(result).items()}}
    arrays = {name: getattr(result, name) for name in _array_shapes(result.weight_history is not None)}
    return {"format": FORMAT, **texts, **numbers, _DIGEST: _digest(arrays, texts, numbers)}


def netcdf_bytes(dataset: Dataset) -> memoryview:
    """Give a file's content, made in memory: on a full disk HDF5 itself does not fail but crashes the process."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    return content.getbuffer()


def load_result(path: str | os.PathLike[str]) -> Result:
    """Read a result from a file ``result.nc`` that ``hexservo run --out`` wrote.

    The result is the same bit for bit: arrays, metrics, events and scenario. The file's checksum covers all of them.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    ResultError
        A file that is not there or cannot be read, is none of ours, is damaged or was changed, or is of a newer format.
    """
    import h5py

    place = _shown(path)
    try:
        with Path(path).open("rb") as opened:
            content = opened.read()
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ResultError(f"{place}: expected a file that can be read, got: {reason}") from None
    try:
        with h5py.File(io.BytesIO(content), "r") as file:  # netCDF's own library has trouble closing damaged files
            names = ("format", *_TEXTS, *_NUMBERS, _DIGEST)
            attributes = {name: _plain(file.attrs[name]) for name in names if name in file.attrs}
            _check_format(attributes, place)
            shapes = _array_shapes(_HISTORY in file)
            arrays = {name: np.ascontiguousarray(file[name][...]) for name in shapes}
    except ResultError:
        raise
    except Exception as error:  # whatever HDF5 and its wrappers raise for bytes that nobody wrote so
        raise ResultError(
            f"{place}: expected a result.nc of `hexservo run --out`, got a damaged or another file ({_line(error)})"
        ) from None
    return _result(arrays, attributes, place)


def _check_format(attributes: Mapping[str, Any], place: str) -> None:
    if "hexservo_version" not in attributes:
        raise ResultError(f"{place}: expected a result.nc of `hexservo run --out`, got a netCDF file of something else")
    found, writer = attributes.get("format"), attributes["hexservo_version"]
    if not isinstance(found, int):
        raise ResultError(
            f"{place}: expected a result of format {FORMAT}, got one without (hexservo {writer} could not read its "
            "results back); run its scenario again: it is the text of the file's attribute scenario"
        )
    if found != FORMAT:
        raise ResultError(
            f"{place}: expected a result of format {FORMAT}, got format {found}, which hexservo {writer} wrote; "
            "use that version or a newer one"
        )


def _result(arrays: Mapping[str, NDArray[np.float64]], attributes: Mapping[str, Any], place: str) -> Result:
    from hexservo._scenario import Scenario

    damaged = f"{place}: expected a result as hexservo wrote it, got one that was changed or damaged"
    for name in (*_TEXTS, *_NUMBERS, _DIGEST):
        if not isinstance(attributes.get(name), float if name in _NUMBERS else str):
            raise ResultError(f"{damaged} (attribute {name})")
    count = len(arrays["time"]) if arrays["time"].ndim else 0
    for name, shape in _array_shapes(_HISTORY in arrays).items():
        if arrays[name].dtype != np.float64 or arrays[name].shape != ((count, *shape[1:]) if shape[0] < 0 else shape):
            raise ResultError(f"{damaged} (variable {name})")
    texts, numbers = ({name: attributes[name] for name in names} for names in (_TEXTS, _NUMBERS))
    if attributes[_DIGEST] != _digest(arrays, texts, numbers):
        raise ResultError(f"{damaged} (its checksum is another)")
    if texts["outcome"] not in get_args(Outcome):
        raise ResultError(f'{place}: expected an outcome that hexservo knows, got "{texts["outcome"]}"')
    try:
        scenario = Scenario.from_yaml(texts["scenario"])
    except ScenarioError as error:
        raise ResultError(f"{place}: its scenario: {_line(error)}") from None
    return Result(
        scenario=scenario,
        controller=texts["controller"],
        outcome=cast("Outcome", texts["outcome"]),
        end_time=numbers["end_time"],
        detail=texts["detail"],
        events=_events(texts["event_table"], damaged),
        **arrays,
        streamed_metrics={name: numbers[f"metric_{name}"] for name in METRICS},
        version=texts["hexservo_version"],
    )


# ---- Events, as a table in a text -----------------------------------------------------------------------------------


def _event_table(events: tuple[LimitEvent, ...]) -> str:
    rows = [f"{event.kind} {event.leg} {event.time!r} {event.peak!r} {event.limit!r}" for event in events]
    return "\n".join([_EVENT_HEAD, *rows])


def _events(table: str, damaged: str) -> tuple[LimitEvent, ...]:
    head, *rows = table.split("\n")
    try:
        if head != _EVENT_HEAD:
            raise ValueError(head)
        events = []
        for row in rows:
            kind, leg, time, peak, limit = row.split(" ")
            if kind not in get_args(LimitKind):
                raise ValueError(kind)
            events.append(LimitEvent(cast("LimitKind", kind), int(leg), float(time), float(peak), float(limit)))
    except ValueError:
        raise ResultError(f"{damaged} (attribute event_table)") from None
    return tuple(events)


# ---- Parts ----------------------------------------------------------------------------------------------------------


def _array_shapes(with_history: bool) -> dict[str, tuple[int, ...]]:
    """Give the arrays of a result with their shapes; -1 stands for the number of samples."""
    widths = {name: (-1, len(labels)) for name, (_, labels, _, _) in _QUANTITIES.items()}
    history: dict[str, tuple[int, ...]] = {_HISTORY: (-1, 6, 7, 7)} if with_history else {}
    return {"time": (-1,), **widths, "fuzzy_weights": (6, 7, 7), **history}


def _digest(arrays: Mapping[str, NDArray[np.float64]], texts: Mapping[str, str], numbers: Mapping[str, float]) -> str:
    """Give the SHA-256 of everything that makes a result, names and shapes included."""
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(f"{name} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array, dtype="<f8").data)
    for name in _TEXTS:
        digest.update(f"{name} {len(texts[name].encode())}\n{texts[name]}".encode())
    for name in _NUMBERS:
        digest.update(f"{name} {float(numbers[name]).hex()}\n".encode())
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic | np.ndarray) and np.size(value) == 1 else value


def _line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _shown(path: str | os.PathLike[str]) -> str:
    text = os.fsdecode(path)
    return f'"{text}"' if text.isprintable() else ascii(text)
