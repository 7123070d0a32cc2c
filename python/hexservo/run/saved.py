"""Results as netCDF files: writes them, and reads them back bit for bit.

A file is a netCDF file (HDF5) with two lines of text after it: format and version of hexservo, and the SHA-256 of all
bytes before the last line. HDF5 records where it ends, so that readers of netCDF ignore the two lines. The HDF5 library
may loop for ever on damaged bytes; here it gets none whose digest is not right.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NoReturn, cast, get_args

import numpy as np
from numpy.typing import NDArray

from hexservo.run.files import check_file, open_regular, write_file
from hexservo.run.metrics import METRICS
from hexservo.run.result import _QUANTITIES, LimitEvent, LimitKind, Outcome, Result
from hexservo.scenario.yaml import ScenarioError

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["FORMAT", "ResultError", "check_saved", "load_result", "result_bytes", "save_result", "saved_attributes"]

FORMAT = 2
"""Of the files: raised with every change of what a file holds, metrics included. A larger number is not known here."""

MAX_BYTES = 4 << 30
"""Largest file that is read; the core logs at most 2 GiB."""

_HISTORY = "weight_history"  # the only array that a result may lack
_EVENT_HEAD = "kind leg time peak limit"  # of the table of events; seconds, and metres (stroke) or newtons (force)
_TEXTS = ("controller", "outcome", "detail", "scenario", "hexservo_version", "event_table")
_NUMBERS = ("end_time", *(f"metric_{name}" for name in METRICS))

_HDF5 = b"\x89HDF\r\n\x1a\n"
_END = re.compile(
    rb"\nhexservo result, format (?P<format>[0-9]{1,9}), hexservo (?P<version>[0-9A-Za-z.+-]{1,40})\n"
    rb"sha256 (?P<digest>[0-9a-f]{64}) of the (?P<size>[0-9]{1,12}) bytes before\n\Z"
)
_END_BYTES = 256  # more than the two lines ever take
_BLOCK = 1 << 20


class ResultError(ValueError):
    """A file is no saved result, is damaged or is of a format that is not known; the text says which."""


def saved_attributes(result: Result) -> dict[str, Any]:
    """Give what a file must hold beside the arrays, so that `load_result` can give the same result again."""
    from hexservo.run.metrics import metrics

    texts = {
        "controller": result.controller,
        "outcome": result.outcome,
        "detail": result.detail,
        "scenario": result.scenario.to_yaml(),
        "hexservo_version": result.version,
        "event_table": _event_table(result.events),
    }
    return {"format": FORMAT, **texts, "end_time": result.end_time, **_prefixed(metrics(result))}


# ---- Writing --------------------------------------------------------------------------------------------------------


def result_bytes(result: Result) -> memoryview:
    """Give a file's content, made in memory: on a full disk HDF5 itself does not fail but crashes the process."""
    return sealed_bytes(result.to_xarray())


def sealed_bytes(dataset: Dataset) -> memoryview:
    """Give a dataset as a netCDF file with the two lines of a result after it."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    from hexservo import __version__

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    content.seek(0, io.SEEK_END)
    content.write(f"\nhexservo result, format {FORMAT}, hexservo {__version__}\n".encode())
    digest = hashlib.sha256(content.getbuffer()).hexdigest()
    content.write(f"sha256 {digest} of the {content.tell()} bytes before\n".encode())
    return content.getbuffer()


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
    """
    check_saved(path, force=force)  # before the work
    write_file(result_bytes(result), path, _is_saved, "hexservo", force=force)


def check_saved(path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Refuse a place that `save_result` would refuse.

    Raises
    ------
    OutputError
        As `save_result`, as far as it can be told without writing anything.
    """
    check_file(path, _is_saved, "hexservo", force=force)


def _is_saved(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            for _ in _sealed_blocks(file, "", path.stat().st_size):
                pass
    except ResultError:
        return False
    return True


# ---- Reading --------------------------------------------------------------------------------------------------------


def load_result(path: str | os.PathLike[str]) -> Result:
    """Read a result from a file that ``hexservo run --out`` or `Result.save` wrote.

    The result is the same bit for bit: arrays, metrics, events and scenario. Every byte of the file counts: one that
    another program has changed is refused, even where only a note was added. Other programs open it as any netCDF file.

    Parameters
    ----------
    path
        The file, of at most 4 GiB.

    Raises
    ------
    ResultError
        A file that is not there or cannot be read, is none of ours, is damaged or was changed, or is of another format;
        also one whose digest is right, and whose content is not that of a run.
    """
    place = _shown(path)
    try:
        with open_regular(path) as file:
            content = b"".join(_sealed_blocks(file, place, os.fstat(file.fileno()).st_size))
    except ResultError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null character in the path, or no regular file
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ResultError(f"{place}: expected a file that can be read, got: {reason}") from None
    arrays, attributes = _parsed(content, place)
    return _result(arrays, attributes, place)


def _sealed_blocks(file: BinaryIO, place: str, size: int) -> Iterator[bytes]:
    """Give the bytes that the digest covers, and refuse the file at the end of them where it is another one."""
    if size > MAX_BYTES:
        raise ResultError(f"{place}: expected a file of at most {MAX_BYTES >> 30} GiB, got {size / (1 << 30):.3g} GiB")
    file.seek(max(size - _END_BYTES, 0))
    end = _END.search(file.read(_END_BYTES) or b"")  # None: a file of the system that has nothing now
    file.seek(0)
    if end is None:
        raise ResultError(f"{place}: {_unsealed(file.read(len(_HDF5)) == _HDF5)}")
    _check_format(int(end["format"]), end["version"].decode(), place)
    covered = size - len(end[0]) + end[0].index(b"sha256 ")
    digest = hashlib.sha256()
    left = covered
    while left > 0 and (block := file.read(min(left, _BLOCK))):
        left -= len(block)
        digest.update(block)
        yield block
    if covered != int(end["size"]) or digest.hexdigest().encode() != end["digest"]:
        _refuse_changed(place, "the SHA-256 of its bytes is another")


def _unsealed(is_hdf5: bool) -> str:
    """Say what a file is that does not end as a result does."""
    if not is_hdf5:
        return "expected a result that hexservo saved, got another kind of file"
    return (
        f"expected a result that hexservo saved, format {FORMAT}, got a netCDF or HDF5 file without the digest at its "
        "end: it is of format 1 (hexservo 0.1), of another program, or was cut off or changed since; run its scenario "
        "again, which a netCDF reader finds in the attribute scenario"
    )


def _check_format(found: int, writer: str, place: str) -> None:
    if found != FORMAT:
        raise ResultError(
            f"{place}: expected a result of format {FORMAT}, got format {found}, which hexservo {writer} wrote; "
            "use that version or a newer one"
        )


def _parsed(content: bytes, place: str) -> tuple[dict[str, NDArray[np.float64]], dict[str, Any]]:
    """Read arrays and attributes from bytes whose digest is right: what is wrong in them now was written so."""
    import h5py

    try:
        with h5py.File(io.BytesIO(content), "r") as file:  # netCDF's own library has trouble closing damaged files
            attributes = {name: _plain(file.attrs[name]) for name in (*_TEXTS, *_NUMBERS) if name in file.attrs}
            arrays = {}
            for name in _array_shapes(_HISTORY in file):
                data = file[name]
                if data.dtype != np.float64 or data.nbytes > len(content):  # more than was ever written
                    _refuse_changed(place, f"variable {name}")
                arrays[name] = np.ascontiguousarray(data[...])
    except ResultError:
        raise
    except Exception as error:  # whatever HDF5 and its wrappers raise
        _refuse_changed(place, _line(error))
    return arrays, attributes


def _refuse_changed(place: str, what: str) -> NoReturn:
    raise ResultError(f"{place}: expected a result as hexservo wrote it, got one that was changed or damaged ({what})")


# ---- From what was read to a result ---------------------------------------------------------------------------------


def _result(arrays: Mapping[str, NDArray[np.float64]], attributes: Mapping[str, Any], place: str) -> Result:
    from hexservo.scenario.scenario import Scenario

    for name in (*_TEXTS, *_NUMBERS):
        if not isinstance(attributes.get(name), float if name in _NUMBERS else str):
            _refuse_changed(place, f"attribute {name}")
    _check_arrays(arrays, place)
    texts, numbers = ({name: attributes[name] for name in names} for names in (_TEXTS, _NUMBERS))
    if numbers["end_time"] != arrays["time"][-1]:
        _refuse_changed(place, "attribute end_time, which is not the last time")
    if texts["outcome"] not in get_args(Outcome):
        raise ResultError(f"{place}: expected an outcome that hexservo knows, got {_quoted(texts['outcome'])}")
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
        events=_events(texts["event_table"], place),
        **arrays,
        streamed_metrics={name: numbers[f"metric_{name}"] for name in METRICS},
        version=texts["hexservo_version"],
    )


def _check_arrays(arrays: Mapping[str, NDArray[np.float64]], place: str) -> None:
    """Refuse arrays that no run gives: other shapes, no sample, numbers that are not finite, times that go back."""
    time = arrays["time"]
    count = len(time) if time.ndim else 0
    if count == 0:
        _refuse_changed(place, "variable time, which has no sample")
    for name, shape in _array_shapes(_HISTORY in arrays).items():
        expected = (count, *shape[1:]) if shape[0] < 0 else shape
        if arrays[name].shape != expected:
            _refuse_changed(place, f"variable {name}: shape {arrays[name].shape} where {expected} is expected")
        if not np.isfinite(arrays[name]).all():
            _refuse_changed(place, f"variable {name}, which has numbers that are not finite")
    if time[0] != 0 or not (np.diff(time) > 0).all():
        _refuse_changed(place, "variable time, which does not increase from 0")
    if not np.allclose(np.linalg.norm(arrays["quaternion"], axis=1), 1.0, rtol=0, atol=1e-9):
        _refuse_changed(place, "variable quaternion, which is not of length 1")
    if not (arrays["depth"] < 0).all():
        _refuse_changed(place, "variable depth, which is not negative")


# ---- Events, as a table in a text -----------------------------------------------------------------------------------


def _event_table(events: tuple[LimitEvent, ...]) -> str:
    rows = [f"{event.kind} {event.leg} {event.time!r} {event.peak!r} {event.limit!r}" for event in events]
    return "\n".join([_EVENT_HEAD, *rows])


def _events(table: str, place: str) -> tuple[LimitEvent, ...]:
    head, *rows = table.split("\n")
    try:
        if head != _EVENT_HEAD:
            raise ValueError(head)
        events = []
        for row in rows:
            kind, leg, time, peak, limit = row.split(" ")
            if kind not in get_args(LimitKind) or leg not in tuple("123456"):
                raise ValueError(row)
            events.append(LimitEvent(cast("LimitKind", kind), int(leg), float(time), float(peak), float(limit)))
    except ValueError:
        _refuse_changed(place, "attribute event_table")
    return tuple(events)


# ---- Parts ----------------------------------------------------------------------------------------------------------


def _array_shapes(with_history: bool) -> dict[str, tuple[int, ...]]:
    """Give the arrays of a result with their shapes; -1 stands for the number of samples."""
    widths = {name: (-1, len(labels)) for name, (_, labels, _, _) in _QUANTITIES.items()}
    history: dict[str, tuple[int, ...]] = {_HISTORY: (-1, 6, 7, 7)} if with_history else {}
    return {"time": (-1,), **widths, "fuzzy_weights": (6, 7, 7), **history}


def _prefixed(metrics: Mapping[str, float]) -> dict[str, float]:
    return {f"metric_{name}": value for name, value in metrics.items()}


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic | np.ndarray) and np.size(value) == 1 else value


def _line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _shown(path: str | os.PathLike[str]) -> str:
    return _quoted(os.fsdecode(path))


def _quoted(text: str) -> str:
    text = text if len(text) <= 200 else f"{text[:100]}...{text[-90:]}"
    return f'"{text}"' if text.isprintable() else ascii(text)
