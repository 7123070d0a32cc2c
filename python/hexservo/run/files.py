"""Puts files and folders on the disk: whole or not at all, and never over something that a user made."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, TypeAlias

from hexservo.run.publish import OutputError, Place, draft_beside, named, publish, signals_raised, synchronize
from hexservo.scenario.reading import EMPTY_PATH, path_text
from hexservo.scenario.version import VERSION
from hexservo.scenario.wording import first_of

MARKER = ".hexservo-output"
"""Name of the file that identifies a folder of results; it lists the other files with their SHA-256."""

Recogniser: TypeAlias = "str | Callable[[Path], bool]"
"""Identification of files that hexservo wrote: their first line, or a function of the path."""

_TITLE = "# hexservo output, format 1"
_LISTED = re.compile(r"(?P<digest>[0-9a-f]{64})  (?P<name>[^/]+)")  # as sha256sum writes and reads it
_MAX_MARKER_BYTES = 100_000


# ---- Folders --------------------------------------------------------------------------------------------------------


def check_folder(folder: str | os.PathLike[str], *, force: bool = False) -> None:
    """Refuse a folder that `write_folder` would refuse, before a long run rather than after it.

    Raises
    ------
    OutputError
        As `write_folder`, as far as it can be checked without writing.
    """
    _Folder(_located(folder), force).check_early()


def has_results(folder: str | os.PathLike[str]) -> bool:
    """Return whether a folder holds earlier results, which `write_folder` with force would replace."""
    return os.path.lexists(output_path("folder", folder) / MARKER)


def write_folder(
    folder: str | os.PathLike[str], fill: Callable[[Path], None], contents: str, *, force: bool = False
) -> Path:
    """Have files written into a folder, and `MARKER` beside them.

    The files are written into a new folder beside the final one, which then gets its name: the results appear whole or,
    after an error, Ctrl-C, SIGTERM or SIGHUP, not at all. Missing parents are made.

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
        unchanged, is ever replaced; the name stands for the old results until it stands for the new ones.

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
    place = _Folder(path, force)
    place.check_early()
    missing = [parent for parent in path.parents if not os.path.exists(parent)]  # noqa: PTH110 (never raises)
    with signals_raised():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with draft_beside(place) as draft:
                fill(draft)
                mark_folder(contents, draft)
                for file in draft.iterdir():
                    synchronize(file)
                synchronize(draft)
                publish(draft, place)
        except BaseException as error:
            for parent in missing:
                with contextlib.suppress(OSError):  # never made, or in use by now
                    parent.rmdir()
            if isinstance(error, OSError):
                _refuse_unwritable(path, error)
            raise
    return output_path("folder", folder)


# ---- Names and words ------------------------------------------------------------------------------------------------


def output_path(name: str, given: object) -> Path:
    """Return a path that was given as an argument, where something is to be written.

    Raises
    ------
    TypeError
        As `path_text`.
    OutputError
        "name: expected a path, got an empty one".
    """
    text = path_text(name, given)
    if not text:
        raise OutputError(f"{name}: {EMPTY_PATH}")
    return Path(text)


def _located(folder: str | os.PathLike[str]) -> Path:
    """Return an absolute path with every link resolved but the last part, which is what gets renamed."""
    path = output_path("folder", folder)
    try:
        parent = os.path.realpath(path if path.name in ("", "..") else path.parent)
    except (OSError, ValueError) as error:  # a NUL in it
        _refuse_unwritable(path, error)
    return Path(parent) if path.name in ("", "..") else Path(parent, path.name)


def _check_parents(path: Path) -> None:
    parent = next(parent for parent in path.parents if os.path.lexists(parent))
    if not parent.is_dir():
        raise OutputError(f"{named(path)}: expected a folder to make it in, got the file {named(parent)}")
    _check_permission(path, parent)


def _check_permission(path: Path, parent: Path) -> None:
    """Refuse a path whose draft cannot be made in `parent`."""
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            f"{named(path)}: expected a place that can be written, but writing into {named(parent)} is not permitted"
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
    shown = [name if name.isprintable() else ascii(name) for name in names]
    return first_of(shown, 8)


def _refuse_unwritable(path: Path, error: OSError | ValueError, place: str = "folder") -> NoReturn:
    reason = (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())
    raise OutputError(
        f"{named(path)}: expected a {place} that can be written, got: {reason}; nothing was written, name another place"
    ) from error


# ---- The marker -----------------------------------------------------------------------------------------------------


def mark_folder(contents: str, folder: Path) -> None:
    """Write `MARKER` into a folder that holds results alone; `contents` is what they are."""
    files = sorted(path for path in folder.iterdir() if path.name != MARKER)
    lines = [
        _TITLE,
        f"# The files of {contents}, written by hexservo {VERSION}.",
        "# hexservo with --force may replace this folder while it holds only these files, unchanged.",
        *(f"{_digest(path)}  {path.name}" for path in files),
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


def check_file(file: str | os.PathLike[str], title: Recogniser, author: str, *, force: bool = False) -> None:
    """Refuse a file that `write_file` would refuse, before long work rather than after it.

    Raises
    ------
    OutputError
        As `write_file`, as far as it can be checked without writing.
    """
    path = output_path("path", file)
    with _refusing_in_words(path):
        _File(path, title, author, force).check_early()


def write_file(
    content: str | bytes | memoryview,
    file: str | os.PathLike[str],
    title: Recogniser,
    author: str,
    *,
    force: bool = False,
) -> None:
    """Write a file whole or, after an error, Ctrl-C, SIGTERM or SIGHUP, not at all.

    Parameters
    ----------
    content
        The whole file; text becomes UTF-8.
    file
        A name in a folder that exists. A file of that name is kept.
    title
        Identifies such files: their first line, or a function that recognises them.
    author
        What writes such files, for the refusal of others.
    force
        Replace a file that has the title; no other file is ever replaced. The name stands for the old file until it
        stands for the new one.

    Raises
    ------
    OutputError
        The file exists, is not ours, or cannot be written.
    """
    path = output_path("path", file)
    place = _File(path, title, author, force)
    with _refusing_in_words(path), signals_raised():
        place.check_early()
        with draft_beside(place) as draft:
            draft.write_bytes(content.encode() if isinstance(content, str) else content)
            synchronize(draft)
            publish(draft, place)


def _starts_with(title: str, path: Path) -> bool:
    with path.open("rb") as opened:
        return opened.readline(len(title.encode()) + 2).rstrip(b"\r\n") == title.encode()


@contextlib.contextmanager
def _refusing_in_words(path: Path) -> Iterator[None]:
    try:
        yield
    except OutputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        _refuse_unwritable(path, error, "place")


# ---- What may stand at a place, and what is written there -----------------------------------------------------------


@dataclass(frozen=True)
class _Folder(Place):
    path: Path
    force: bool

    def check(self, found: Path | None = None) -> None:
        found = found or self.path
        try:
            mode = found.lstat().st_mode
        except FileNotFoundError:
            _check_parents(self.path)
            return
        except (OSError, ValueError) as error:
            _refuse_unwritable(self.path, error)
        if stat.S_ISLNK(mode):
            raise OutputError(
                f"{named(self.path)}: expected a folder, got a symbolic link to {named(found.readlink())}; "
                "name that folder itself"
            )
        if not stat.S_ISDIR(mode):
            raise OutputError(f"{named(self.path)}: expected a folder, got a file; name another place")
        try:
            is_empty = not any(found.iterdir())
            is_current = found.samefile(os.curdir)
            strangers = None if is_empty or is_current else _strangers(found)
        except OSError as error:
            _refuse_unwritable(self.path, error)
        if is_current:
            raise OutputError(
                f"{named(self.path)}: expected a folder other than the current one; name a new one inside it"
            )
        if not is_empty:
            self._check_contents(strangers)
        if os.path.ismount(found):  # which cannot be renamed
            raise OutputError(f"{named(self.path)}: expected a folder, got a mount point; name a new folder inside it")
        _check_permission(self.path, self.path.parent)

    def _check_contents(self, strangers: list[str] | None) -> None:
        """Refuse a folder that holds more than our results as we left them, or them without `force`."""
        if strangers is None:
            raise OutputError(
                f"{named(self.path)}: the folder holds files that are not results of hexservo "
                f"(it has no valid {MARKER}), so it is kept; name another folder"
            )
        if strangers:
            raise OutputError(
                f"{named(self.path)}: the folder holds files that hexservo did not write, so it is kept: "
                f"{_listing(strangers)}; move them away or name another folder"
            )
        if not self.force:
            raise OutputError(
                f"{named(self.path)}: the folder holds results already; replace them with --force "
                "(force=True in Python), or name another folder"
            )

    def make(self, draft: Path) -> None:
        draft.mkdir()

    def is_ours(self, found: Path) -> bool:
        if not stat.S_ISDIR(found.lstat().st_mode):
            return False
        return not any(found.iterdir()) or _strangers(found) == []  # empty: the last moment of `remove`

    def remove(self, replaced: Path) -> None:
        """Remove the files we wrote and the folder; any other file keeps it from being removed."""
        try:
            for name in _read_marker(replaced) or ():
                if name != MARKER:
                    (replaced / name).unlink(missing_ok=True)
            (replaced / MARKER).unlink(missing_ok=True)  # last, so that a folder half removed is still recognised
            replaced.rmdir()
        except OSError as error:
            raise OutputError(
                f"{named(self.path)}: the new results are there, but the old ones could not be removed "
                f"({error.strerror}); what is left of them is in {named(replaced)}"
            ) from error


@dataclass(frozen=True)
class _File(Place):
    path: Path
    title: Recogniser
    author: str
    force: bool

    def check(self, found: Path | None = None) -> None:
        found = found or self.path
        if self.path.name in ("", ".."):
            raise OutputError(f"{named(self.path)}: expected the name of a file, got a folder; name a file in it")
        try:
            mode = found.lstat().st_mode
        except FileNotFoundError:
            if not self.path.parent.is_dir():
                raise OutputError(
                    f"{named(self.path)}: expected a folder that exists, got {named(self.path.parent)}; make it first"
                ) from None
            _check_permission(self.path, self.path.parent)
            return
        if not stat.S_ISREG(mode):
            kind = "a symbolic link" if stat.S_ISLNK(mode) else "a folder" if stat.S_ISDIR(mode) else "something else"
            raise OutputError(f"{named(self.path)}: expected a file or a new name, got {kind}; name another place")
        if not self.is_ours(found):
            raise OutputError(
                f"{named(self.path)}: the file was not written by {self.author}, so it is kept; name another"
            )
        if not self.force:
            raise OutputError(
                f"{named(self.path)}: the file exists; replace it with --force (force=True in Python), or name another"
            )
        _check_permission(self.path, self.path.parent)

    def make(self, draft: Path) -> None:
        draft.touch(exist_ok=False)

    def is_ours(self, found: Path) -> bool:
        if not stat.S_ISREG(found.lstat().st_mode):
            return False
        return _starts_with(self.title, found) if isinstance(self.title, str) else self.title(found)

    def remove(self, replaced: Path) -> None:
        replaced.unlink(missing_ok=True)
