"""Opens files to read them, and only regular ones."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from hexservo.scenario.wording import wrong_type

HDF5 = b"\x89HDF\r\n\x1a\n"
"""What netCDF and HDF5 files begin with, such as a saved result."""

SCENARIO_OF_RUN, RESULT_OF_RUN = "scenario.yaml", "result.nc"
"""Files in a folder of ``hexservo run --out`` that are read again."""


EMPTY_PATH = "expected a path, got an empty one"
"""Of an empty text in place of a path, which `Path` takes for the current folder."""


def path_text(name: str, path: object) -> str:
    """Return a path that was given as an argument as text; bytes are decoded as the system does.

    Raises
    ------
    TypeError
        "name: expected a path, got int".
    """
    if not isinstance(path, str | bytes | os.PathLike):
        raise wrong_type(name, "a path", path)
    return os.fsdecode(path)


@contextlib.contextmanager
def open_regular(path: str | os.PathLike[str], in_folder: Sequence[str] = ()) -> Iterator[BinaryIO]:
    """Open a regular file to read its bytes, and never wait, as for the other end of a pipe.

    Parameters
    ----------
    path
        The file.
    in_folder
        Names of files that can be read in place of a folder that has them, for the message.

    Raises
    ------
    TypeError
        For anything but a path.
    OSError
        As `open`.
    ValueError
        The path is empty, stands for a folder, a pipe, a device or a socket, or holds a null character.
    """
    place = path_text("path", path)
    if not place:
        raise ValueError(EMPTY_PATH)
    # before it is opened, which some devices take for a command
    _refuse_special(Path(place).stat().st_mode, place, in_folder)
    with os.fdopen(os.open(place, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY), "rb") as file:
        _refuse_special(os.fstat(file.fileno()).st_mode, place, in_folder)
        yield file


def _refuse_special(mode: int, place: str, in_folder: Sequence[str]) -> None:
    if stat.S_ISDIR(mode):
        raise ValueError(of_folder(place, in_folder))
    kinds = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    if not stat.S_ISREG(mode):
        raise ValueError(f"expected a regular file, got {kinds.get(stat.S_IFMT(mode), 'a device')}")


def of_folder(place: str, names: Sequence[str]) -> str:
    """Return why a folder is refused where a file is expected, with those of its files to read that have such names."""
    files = [Path(place) / name for name in names]
    # a `Path` raises an error in a folder that may not be searched
    found = [str(file) for file in files if os.path.isfile(file)]  # noqa: PTH113
    hint = f"; name a file in it: {' or '.join(found)}" if found else ""
    return f"expected a regular file, got a folder{hint}"
