"""Opens files to read them, and only regular ones."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from hexservo.scenario.wording import wrong_type

HDF5 = b"\x89HDF\r\n\x1a\n"
"""What netCDF and HDF5 files begin with, such as a saved result."""

_FILES_OF_RUN = ("scenario.yaml", "result.nc")  # in a folder of ``hexservo run --out``


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
def open_regular(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a regular file to read its bytes, and never wait, as for the other end of a pipe.

    Raises
    ------
    TypeError
        For anything but a path.
    OSError
        As `open`.
    ValueError
        The path stands for a folder, a pipe, a device or a socket, or holds a null character.
    """
    place = path_text("path", path)
    _refuse_special(Path(place).stat().st_mode, place)  # before it is opened, which some devices take for a command
    with os.fdopen(os.open(place, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY), "rb") as file:
        _refuse_special(os.fstat(file.fileno()).st_mode, place)
        yield file


def _refuse_special(mode: int, place: str) -> None:
    """Refuse what is no regular file; of the folder of a run, the files to read are named."""
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    if not stat.S_ISREG(mode):
        of_run = [str(file) for name in _FILES_OF_RUN if (file := Path(place) / name).is_file()]
        hint = f"; name a file in it: {' or '.join(of_run)}" if of_run else ""
        raise ValueError(f"expected a regular file, got {kinds.get(stat.S_IFMT(mode), 'a device')}{hint}")
