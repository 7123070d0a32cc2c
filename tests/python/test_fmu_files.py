"""The files of Functional Mock-up Units: versions that are refused, and what `hexservo export --force` leaves alone."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hexservo as hs
from hexservo.bridges.fmi import is_unit
from hexservo.run.files import write_file
from hexservo.run.publish import OutputError


@pytest.mark.parametrize("version", [1, 2.0, 3.0, True, "2"])
def test_a_version_is_a_whole_number(version: Any) -> None:
    """2.0 equals a version, but a unit would have the version 2.0.0 of FMI."""
    with pytest.raises(ValueError, match=rf"^fmi: expected 2 or 3, got {version!r}$"):
        hs.bridges.fmu(hs.load_scenario("paper"), fmi=version)


def _archive(content: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytearray:
    """An archive with the file by which a unit is recognised."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        archive.writestr("resources/model.txt", content)
    return bytearray(packed.getvalue())


def _damaged(start: int, method: int = zipfile.ZIP_DEFLATED) -> bytearray:
    archive = _archive(bytes(range(256)) * 4, method)
    first = 30 + len("resources/model.txt") + start  # a local header, the name, the content
    archive[first : first + 40] = bytes(byte ^ 0x55 for byte in archive[first : first + 40])
    return archive


def _with_header(local: int, central: int, value: int) -> bytearray:
    archive = _archive(b"x")
    archive[local] = archive[archive.index(b"PK\x01\x02") + central] = value
    return archive


def _of_no_text() -> bytearray:
    """One whose name should be UTF-8, by its flags, and is not."""
    return _with_header(7, 9, 8).replace(b"model", b"\x87odel")


FOREIGN: dict[str, Callable[[], bytearray]] = {
    "no archive": lambda: bytearray(b"notes"),
    "another's": lambda: _archive(b"another"),
    "damaged": lambda: _damaged(0),
    "damaged LZMA": lambda: _damaged(4, zipfile.ZIP_LZMA),
    "cut off": lambda: _with_header(18, 20, 200),
    "a name that is no text": _of_no_text,
    "encrypted": lambda: _with_header(6, 8, 1),
    "packed by no known method": lambda: _with_header(8, 10, 97),
}


@pytest.mark.parametrize("what", FOREIGN)
def test_force_leaves_what_is_no_unit_of_ours(tmp_path: Path, what: str) -> None:
    file, content = tmp_path / "kept.fmu", bytes(FOREIGN[what]())
    file.write_bytes(content)
    with pytest.raises(OutputError, match=r"kept\.fmu"):
        write_file(b"unit", file, is_unit, "hexservo export", force=True)
    assert file.read_bytes() == content
