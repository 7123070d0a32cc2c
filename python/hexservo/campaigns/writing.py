"""Writes files of campaigns and searches: whole or not at all, by one process, never in place of a user's changes."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import itertools
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from hexservo.run.publish import OutputError, named, synchronize
from hexservo.scenario.wording import first_of, quoted

_HEAD = "# Written by hexservo, which replaces it while it is unchanged; SHA-256 of the rest: "  # of scenarios

_DRAFT = ".hexservo-{name}-{token}.part"  # no file of a user has such a name
_DRAFTS = re.compile(_DRAFT.replace(".", r"\.").format(name=".+", token="[0-9a-f]{12}"))


_NAMED = 3  # files in a message
_PASSING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # errors of a disk or its limits


class KeptFileError(OutputError):
    """A file that hexservo did not write, or that was changed since, has the name of one to be written."""


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make a folder if it is not there, and be its only writer.

    Raises
    ------
    OutputError
        It is a file, or a link that leads nowhere; a process writes there now; it cannot be made.
    """
    with refusing(folder):
        if folder.is_symlink() and not folder.exists():
            raise OutputError(
                f"{named(folder)}: expected a folder, got a symbolic link to {named(folder.readlink())}, which does "
                "not exist; make that folder, or name another one"
            )
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{named(folder)}: expected a folder, got a file; name another place")
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise OutputError(
                    f"{named(folder)}: expected a folder in which no other process writes; wait for it"
                ) from None
            # a file system without locks: the user is the only guard
        yield
    finally:
        os.close(descriptor)


def require_empty(folder: Path, owner: str) -> None:
    """Refuse a folder with anything, hidden or not, but what killed processes left.

    Raises
    ------
    OutputError
        What is there is kept.
    """
    others = sorted(path.name for path in folder.iterdir() if not _is_draft(path))
    if others:
        names = first_of([quoted(name) for name in others], _NAMED)
        raise OutputError(
            f"{named(folder)}: expected a new folder or that of {owner}, got one with other files: {names}; "
            "name a new folder"
        )


def refuse_file(path: Path) -> None:
    """Refuse a file in the place of a folder.

    Raises
    ------
    OutputError
        It is kept.
    """
    if os.path.lexists(path) and not path.is_dir():
        raise OutputError(f"{named(path)}: expected a folder, got a file, which is kept; move it away")


def make_folder(path: Path) -> None:
    """Make a folder within that of a campaign or a search, if it is not there.

    Raises
    ------
    OutputError
        A file has its name, or it cannot be made.
    """
    with refusing(path):
        refuse_file(path)
        path.mkdir(exist_ok=True)


def remove_drafts(folder: Path) -> None:
    """Remove what killed processes left in a folder.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    with refusing(folder):
        for entry in folder.iterdir():
            if _is_draft(entry):
                entry.unlink()


def _is_draft(path: Path) -> bool:
    """Return whether a path is a file that `write_bytes` had begun when its process was killed."""
    return _DRAFTS.fullmatch(path.name) is not None and stat.S_ISREG(path.lstat().st_mode)


def free_place(path: Path) -> Path:
    """Return a path, or where something has it the first one with a number after its stem that is free."""
    return next(place for place in _places(path) if not os.path.lexists(place))


def _places(path: Path) -> Iterator[Path]:
    """Yield a path, then the same with the numbers 1, 2, ... after its stem."""
    yield path
    for number in itertools.count(1):
        yield path.with_name(f"{path.stem}-{number}{path.suffix}")


def require_own(path: Path, is_ours: Callable[[bytes], bool]) -> None:
    """Refuse a path with anything but a file that `is_ours` recognises by its content; none is accepted.

    Raises
    ------
    KeptFileError
        What is there is kept.
    """
    try:
        is_file = stat.S_ISREG(path.lstat().st_mode)
        if is_file and is_ours(path.read_bytes()):
            return
    except FileNotFoundError:
        return
    except OSError as error:
        raise OutputError(f"{named(path)}: cannot be read: {error.strerror}") from None
    raise KeptFileError(
        f"{named(path)}: expected a file as hexservo wrote it, got a different one, which is kept; move it away"
    )


def require_own_scenario(path: Path, text: str = "") -> None:
    """Refuse a path with a file that `write_scenario` would not replace by a text; errors as for `require_own`."""
    require_own(path, lambda content: content == text.encode() or _has_seal(content))


def write_scenario(path: Path, text: str) -> None:
    """Write a scenario into a campaign's folder, in place of one that was not changed since, which its head shows.

    Raises
    ------
    KeptFileError
        There is a file that hexservo did not write, or that was changed since; it stays.
    OutputError
        It cannot be written.
    """
    require_own_scenario(path, text)
    write_text(path, f"{_HEAD}{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


def write_beside_kept(path: Path, text: str) -> Path:
    """Write a scenario as `write_scenario`, under the first number where its path is kept; return where it is.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    for place in _places(path):
        with contextlib.suppress(KeptFileError):
            write_scenario(place, text)
            return place
    raise AssertionError  # the numbers do not end


def _has_seal(content: bytes) -> bool:
    """Return whether the head of a scenario has the digest of the rest."""
    head, _, rest = content.partition(b"\n")
    return head == f"{_HEAD}{hashlib.sha256(rest).hexdigest()}".encode()


def write_text(path: Path, text: str) -> None:
    """Write a file of a campaign's folder, in place of an earlier one.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    write_bytes(path, text.encode())


def write_beside(path: Path, text: str) -> None:
    """Write a file of a campaign's folder; one of a different text gets a number, since it may have a user's changes.

    Raises
    ------
    OutputError
        It cannot be written, or the other one not be renamed.
    """
    content = text.encode()
    with refusing(path):
        if os.path.lexists(path) and not (path.is_file() and path.read_bytes() == content):
            path.rename(free_place(path))
    write_bytes(path, content)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file beside its place, have it on the disk, and give it its name; its folder is made.

    A file that has the same content stays: what is complete can be used again in a folder that cannot be written.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    with contextlib.suppress(OSError):
        if path.stat().st_size == len(content) and path.read_bytes() == content:
            return
    draft = path.with_name(_DRAFT.format(name=path.name, token=secrets.token_hex(6)))
    with refusing(path):
        path.parent.mkdir(exist_ok=True)
        try:
            with draft.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
        synchronize(path.parent)


@contextlib.contextmanager
def refusing(path: Path) -> Iterator[None]:
    """Convert errors of the system to a sentence: where nothing but space lacks, the same command goes on."""
    try:
        yield
    except OSError as error:
        if error.errno in _PASSING:
            sentence = f"cannot be written: {error.strerror}; what is whole stays; the same command goes on"
        else:
            sentence = (
                f"expected a place that can be written, got: {error.strerror}; permit writing there, or name another "
                "folder"
            )
        raise OutputError(f"{named(path)}: {sentence}") from error
