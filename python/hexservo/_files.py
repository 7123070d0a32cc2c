"""Puts files and folders on the disk: whole or not at all, and never over something that a user made."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

__all__ = ["MARKER", "OutputError", "check_file", "check_folder", "write_file", "write_folder"]

MARKER = ".hexservo-output"
"""Name of the file that tells a folder of results from any other; it lists the other files with their SHA-256."""

_TITLE = "# hexservo output, format 1"
_LISTED = re.compile(r"(?P<digest>[0-9a-f]{64})  (?P<name>[^/]+)")  # as sha256sum writes and reads it
_MAX_MARKER_BYTES = 100_000


class OutputError(ValueError):
    """Results cannot be written where they should go; the text says why and what to do."""


def check_folder(folder: str | os.PathLike[str], *, force: bool = False) -> None:
    """Refuse a folder that `write_folder` would refuse, before a long run rather than after it.

    Raises
    ------
    OutputError
        As `write_folder`, as far as it can be told without writing anything.
    """
    _check(_located(folder), force)


def write_folder(
    folder: str | os.PathLike[str], fill: Callable[[Path], None], contents: str, *, force: bool = False
) -> Path:
    """Have files written into a folder, and `MARKER` beside them.

    The files are written into a new folder beside the final one, which is then renamed: the results appear whole or,
    after an error or Ctrl-C, not at all. Missing parents are made.

    Parameters
    ----------
    folder
        A folder that does not exist or is empty; it keeps its permissions. Not a symbolic link, not the current folder.
    fill
        Writes files, and no folders, into the folder that it is given.
    contents
        What the files are, for the marker.
    force
        Replace earlier results. Only a folder that carries `MARKER` and holds nothing but the files listed there,
        unchanged, is ever replaced; until the new results are in place the old ones are kept.

    Returns
    -------
    Path
        The folder, as given.

    Raises
    ------
    OutputError
        The folder holds something, or something other than our results with `force`; it is a file, a link or the
        current folder; it cannot be made or written.
    """
    path = _located(folder)
    _check(path, force)
    temporary = _beside(path, "writing")
    missing = [parent for parent in path.parents if not os.path.exists(parent)]  # noqa: PTH110 (never raises)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.mkdir()
        fill(temporary)
        _write_marker(contents, temporary)
        for file in temporary.iterdir():
            _synchronize(file)
        _synchronize(temporary)
        _put_in_place(temporary, path, force)
    except BaseException as error:
        shutil.rmtree(temporary, ignore_errors=True)
        for parent in missing:
            with contextlib.suppress(OSError):  # never made, or in use by now
                parent.rmdir()
        if isinstance(error, OSError):
            _refuse_unwritable(path, error)
        raise
    return Path(folder)


# ---- What a folder may be -------------------------------------------------------------------------------------------


def _located(folder: str | os.PathLike[str]) -> Path:
    """Return an absolute path with every link resolved but the last part, which is what gets renamed."""
    path = Path(folder)
    try:
        parent = os.path.realpath(path if path.name in ("", "..") else path.parent)
    except (OSError, ValueError) as error:  # a NUL in it
        _refuse_unwritable(path, error)
    return Path(parent) if path.name in ("", "..") else Path(parent, path.name)


def _check(path: Path, force: bool) -> None:
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        _check_parents(path)
        return
    except (OSError, ValueError) as error:
        _refuse_unwritable(path, error)
    if stat.S_ISLNK(mode):
        raise OutputError(
            f"{_shown(path)}: expected a folder, got a symbolic link to {_shown(path.readlink())}; "
            "name that folder itself"
        )
    if not stat.S_ISDIR(mode):
        raise OutputError(f"{_shown(path)}: expected a folder, got a file; name another place")
    try:
        is_empty = not any(path.iterdir())
        is_current = path.samefile(os.curdir)
    except OSError as error:
        _refuse_unwritable(path, error)
    if is_current:
        raise OutputError(f"{_shown(path)}: expected a folder other than the current one; name a new one inside it")
    if not is_empty:
        _check_replaceable(path, force)


def _check_parents(path: Path) -> None:
    parent = next(parent for parent in path.parents if os.path.lexists(parent))
    if not parent.is_dir():
        raise OutputError(f"{_shown(path)}: expected a folder to make it in, got the file {_shown(parent)}")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            f"{_shown(path)}: expected a place that can be written, but writing into {_shown(parent)} is not permitted"
        )


def _check_replaceable(path: Path, force: bool, aside: Path | None = None) -> None:
    """Refuse a folder (put aside or not) that holds more than our results as we left them, or them without `force`."""
    try:
        strangers = _strangers(aside or path)
    except OSError as error:
        _refuse_unwritable(path, error)
    if strangers is None:
        raise OutputError(
            f"{_shown(path)}: the folder holds files that are not results of hexservo "
            f"(it has no valid {MARKER}), so it is kept; name another folder"
        )
    if strangers:
        raise OutputError(
            f"{_shown(path)}: the folder holds files that hexservo did not write, so it is kept: "
            f"{_listing(strangers)}; move them away or name another folder"
        )
    if not force:
        raise OutputError(
            f"{_shown(path)}: the folder holds results already; replace them with --force (force=True in Python), "
            "or name another folder"
        )


def _strangers(folder: Path) -> list[str] | None:
    """List what a folder of results holds besides our files as we wrote them; None if it is no such folder."""
    written = _read_marker(folder)
    if written is None:
        return None
    strangers = []
    for entry in sorted(folder.iterdir()):
        is_file = stat.S_ISREG(entry.lstat().st_mode)
        if entry.name not in written or not is_file:
            strangers.append(entry.name if is_file else f"{entry.name} (not a file)")
        elif entry.name != MARKER and _digest(entry) != written[entry.name]:
            strangers.append(f"{entry.name} (changed since)")
    return strangers


def _listing(names: list[str]) -> str:
    shown = [name if name.isprintable() else ascii(name) for name in names[:8]]
    return ", ".join(shown) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _shown(path: Path) -> str:
    """Quote a path so that it stays on its line, whatever characters it has; near ones relative, as they were typed."""
    try:
        text = str(path.relative_to(Path.cwd()))
    except (OSError, ValueError):
        text = str(path)
    text = text if len(text) <= 200 else f"{text[:100]}...{text[-90:]}"
    return f'"{text}"' if text.isprintable() else ascii(text)


def _refuse_unwritable(path: Path, error: OSError | ValueError, place: str = "folder") -> NoReturn:
    reason = (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())
    raise OutputError(
        f"{_shown(path)}: expected a {place} that can be written, got: {reason}; "
        "nothing was written, name another place"
    ) from error


# ---- The marker -----------------------------------------------------------------------------------------------------


def _write_marker(contents: str, folder: Path) -> None:
    from hexservo import __version__

    lines = [
        _TITLE,
        f"# The files of {contents}, written by hexservo {__version__}.",
        "# hexservo with --force may replace this folder while it holds only these files, unchanged.",
        *(f"{_digest(path)}  {path.name}" for path in sorted(folder.iterdir())),
    ]
    (folder / MARKER).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read_marker(folder: Path) -> dict[str, str] | None:
    """Return the digests of our files by name, the marker's empty; None without a valid marker."""
    marker = folder / MARKER
    try:
        status = marker.lstat()
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(status.st_mode) or status.st_size > _MAX_MARKER_BYTES:
        return None
    title, *lines = marker.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
    listed = [_LISTED.fullmatch(line) for line in lines if not line.startswith("#")]
    files = {match["name"]: match["digest"] for match in listed if match is not None}
    if title != _TITLE or len(files) != len(listed):
        return None
    return {MARKER: "", **files}


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


# ---- One file -------------------------------------------------------------------------------------------------------


def write_file(text: str, file: str | os.PathLike[str], title: str, author: str, *, force: bool = False) -> None:
    """Write a text file whole, or not at all.

    Parameters
    ----------
    text
        The whole file; its first line is `title`.
    file
        A name in a folder that exists. A file of that name is kept.
    title
        First line of every such file that we write: what tells it from a file of somebody else.
    author
        What writes such files, for the refusal of others.
    force
        Replace a file that starts with `title`; no other file is ever replaced.

    Raises
    ------
    OutputError
        The file exists, is not ours, or cannot be written.
    """
    path = Path(file)
    try:
        _check_file(path, title, author, force)
        temporary = _beside(path, "writing")
        try:
            with temporary.open("x", encoding="utf-8") as opened:
                opened.write(text)
            _synchronize(temporary)
            with _locked(path.parent):
                _check_file(path, title, author, force)  # what stands there may have changed
                if path.exists():
                    temporary.chmod(stat.S_IMODE(path.stat().st_mode))
                temporary.rename(path)
        finally:
            temporary.unlink(missing_ok=True)  # gone, if all went well
    except (OSError, ValueError) as error:
        if isinstance(error, OutputError):
            raise
        _refuse_unwritable(path, error, "place")


def check_file(file: str | os.PathLike[str], title: str, author: str, *, force: bool = False) -> None:
    """Refuse a file that `write_file` would refuse, before long work rather than after it.

    Raises
    ------
    OutputError
        As `write_file`, as far as it can be told without writing anything.
    """
    path = Path(file)
    try:
        _check_file(path, title, author, force)
    except (OSError, ValueError) as error:
        if isinstance(error, OutputError):
            raise
        _refuse_unwritable(path, error, "place")


def _check_file(path: Path, title: str, author: str, force: bool) -> None:
    if path.name in ("", ".."):
        raise OutputError(f"{_shown(path)}: expected the name of a file, got a folder; name a file in it")
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        if not path.parent.is_dir():
            raise OutputError(
                f"{_shown(path)}: expected a folder that exists, got {_shown(path.parent)}; make it first"
            ) from None
        return
    if not stat.S_ISREG(mode):
        kind = "a symbolic link" if stat.S_ISLNK(mode) else "a folder" if stat.S_ISDIR(mode) else "something else"
        raise OutputError(f"{_shown(path)}: expected a file or a new name, got {kind}; name another place")
    with path.open("rb") as opened:
        ours = opened.readline(len(title.encode()) + 2).rstrip(b"\r\n") == title.encode()
    if not ours:
        raise OutputError(f"{_shown(path)}: the file was not written by {author}, so it is kept; name another")
    if not force:
        raise OutputError(f"{_shown(path)}: the file exists; replace it with --force, or name another")


# ---- How it gets there ----------------------------------------------------------------------------------------------


def _beside(path: Path, purpose: str) -> Path:
    """Return a new name in the same folder, hence on the same file system, short enough for any of them."""
    return path.with_name(f".hexservo-{purpose}-{path.name[:40]}-{secrets.token_hex(6)}")


def _put_in_place(temporary: Path, path: Path, force: bool) -> None:
    """Rename the written folder to its final name, after a second check: what stands there may have changed."""
    with _locked(path.parent):
        _check(path, force)
        try:
            permissions = stat.S_IMODE(path.lstat().st_mode)
        except FileNotFoundError:
            temporary.rename(path)
        else:
            temporary.chmod(permissions)
            if any(path.iterdir()):
                _replace(temporary, path)
            else:
                temporary.rename(path)  # onto an empty folder; the system refuses any other
        _synchronize(path.parent)


def _replace(temporary: Path, path: Path) -> None:
    """Put the old results aside, the new ones in, and remove the old; or put the old ones back."""
    aside = _beside(path, "replaced")
    try:
        path.rename(aside)
        _check_replaceable(path, force=True, aside=aside)  # a file may have been put there since the last check
        temporary.rename(path)
    finally:
        if os.path.lexists(aside):
            if os.path.lexists(temporary):
                _put_back(aside, path)
            else:
                _remove(aside, path)


def _put_back(aside: Path, path: Path) -> None:
    try:
        aside.rename(path)
    except OSError as error:
        raise OutputError(
            f"{_shown(path)}: the new results could not be put there, and the old ones not back ({error.strerror}); "
            f"they are in {_shown(aside)}"
        ) from error


def _remove(aside: Path, path: Path) -> None:
    """Remove the files we wrote and the folder; any other file keeps it from being removed."""
    try:
        for name in _read_marker(aside) or ():
            if name != MARKER:
                (aside / name).unlink(missing_ok=True)
        (aside / MARKER).unlink()  # last, so that a folder half removed still says what it is
        aside.rmdir()
    except OSError as error:
        raise OutputError(
            f"{_shown(path)}: the new results are there, but the old ones could not be removed ({error.strerror}); "
            f"what is left of them is in {_shown(aside)}"
        ) from error


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let no other hexservo rename in this folder meanwhile; where locks are missing, renames alone keep it whole."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _synchronize(path: Path) -> None:
    """Have a file or a folder on the disk before going on; some file systems cannot do it for folders."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise
    finally:
        os.close(descriptor)
