"""Files of results: netCDF (HDF5) with two lines of text after it.

These are the format with the version of hexservo, and the SHA-256 of all bytes before the last line. HDF5 records where
it ends, so that readers of netCDF ignore the two lines. The HDF5 library may loop for ever on damaged bytes; here it
gets none whose digest is not right.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NoReturn

from hexservo.scenario.reading import HDF5, open_regular, path_text
from hexservo.scenario.version import VERSION
from hexservo.scenario.wording import quoted

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["FORMAT", "ResultError"]

FORMAT = 2
"""Of the files: raised with every change of what a file holds, metrics included. A larger number is not known here."""

MAX_BYTES = 4 << 30
"""Largest file that is read; the core logs at most 2 GiB."""

_END = re.compile(
    rb"\nhexservo result, format (?P<format>[0-9]{1,9}), hexservo (?P<version>[0-9A-Za-z.+-]{1,40})\n"
    rb"sha256 (?P<digest>[0-9a-f]{64}) of the (?P<size>[0-9]{1,12}) bytes before\n\Z"
)
_END_BYTES = 256  # more than the two lines ever take
_BLOCK = 1 << 20


class ResultError(ValueError):
    """A file is not a saved result, is damaged or has an unknown format; the text has the reason."""


def sealed_bytes(dataset: Dataset) -> memoryview:
    """Return a dataset as a netCDF file followed by the two lines of a result."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    content.seek(0, io.SEEK_END)
    content.write(f"\nhexservo result, format {FORMAT}, hexservo {VERSION}\n".encode())
    digest = hashlib.sha256(content.getbuffer()).hexdigest()
    content.write(f"sha256 {digest} of the {content.tell()} bytes before\n".encode())
    return content.getbuffer()


def is_sealed(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            for _ in sealed_blocks(file, "", path.stat().st_size):
                pass
    except ResultError:
        return False
    return True


def sealed_blocks(file: BinaryIO, place: str, size: int) -> Iterator[bytes]:
    """Yield the bytes that the digest covers; after the last one, refuse a file whose digest differs."""
    if size > MAX_BYTES:
        raise ResultError(f"{place}: expected a file of at most {MAX_BYTES >> 30} GiB, got {size / (1 << 30):.3g} GiB")
    file.seek(max(size - _END_BYTES, 0))
    end = _END.search(file.read(_END_BYTES) or b"")  # None: a file of the system that has nothing now
    file.seek(0)
    if end is None:
        raise ResultError(f"{place}: {_unsealed(file.read(len(HDF5)) == HDF5)}")
    _check_format(int(end["format"]), end["version"].decode(), place)
    covered = size - len(end[0]) + end[0].index(b"sha256 ")
    digest = hashlib.sha256()
    left = covered
    while left > 0 and (block := file.read(min(left, _BLOCK))):
        left -= len(block)
        digest.update(block)
        yield block
    if covered != int(end["size"]) or digest.hexdigest().encode() != end["digest"]:
        refuse_changed(place, "the SHA-256 of its bytes is another")


def _unsealed(is_hdf5: bool) -> str:
    """Return what a file is that does not end as a result does."""
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


def refuse_changed(place: str, what: str) -> NoReturn:
    raise ResultError(f"{place}: expected a result as hexservo wrote it, got one that was changed or damaged ({what})")


def line_of(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def shown_path(path: str | os.PathLike[str]) -> str:
    return quoted(path_text("path", path))
