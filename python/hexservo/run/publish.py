"""Gives names to complete files and folders, so that a name stands for something whole at every moment.

What is written is a draft beside its place, with a hidden name, until it is complete. Earlier results and new ones then
exchange their names in one system call (``renameat2`` with ``RENAME_EXCHANGE``: Linux and its usual file systems).
Where there is no such call a file is renamed over the earlier one, which is one call too, and a folder takes three
renames: its name is missing for microseconds.

A process that is killed may leave hidden names. The next one that checks or writes the same place puts earlier results
back if their name is missing, and removes the rest. All of that happens under a lock of the parent folder; on a file
system without locks (``flock``) left-overs stay.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import secrets
import shutil
import signal
import stat
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import FrameType

from hexservo.scenario.wording import quoted


class OutputError(ValueError):
    """Results cannot be written where they should go; the text has the reason and what to do."""


class Place(ABC):
    """Where something is written: what may be replaced there, and how what was replaced is removed."""

    path: Path

    @abstractmethod
    def check(self, found: Path | None = None) -> None:
        """Refuse what may not be replaced at the path, or what was found there before it got the name `found`."""

    @abstractmethod
    def make(self, draft: Path) -> None:
        """Begin a draft."""

    @abstractmethod
    def is_ours(self, found: Path) -> bool:
        """Return whether something is complete and was written by this class."""

    @abstractmethod
    def remove(self, replaced: Path) -> None:
        """Remove what was replaced."""

    def check_early(self) -> None:
        """Refuse what may not be replaced, after what a killed process left here was cleared away."""
        if _left_over(self.path):
            with contextlib.suppress(OSError), _locked(self.path.parent) as is_locked:
                if is_locked:
                    _clear_away(self)
        self.check()


# ---- How it gets there ----------------------------------------------------------------------------------------------

_DRAFT = "draft"  # being written, by a process that holds a lock on it
_READY = "ready"  # complete: new results before the exchange, old ones after it
_ASIDE = "aside"  # old results, where exchanging takes three renames


def _beside(path: Path, purpose: str) -> Path:
    """Return a new name in the same folder, hence on the same file system, short enough for any of them."""
    return path.with_name(f".hexservo-{purpose}-{_label(path)}-{secrets.token_hex(6)}")


def _label(path: Path) -> str:
    """Stand for a name among hidden ones: legible, and no other name has it."""
    return f"{path.name[:40]}-{hashlib.sha256(os.fsencode(path.name)).hexdigest()[:12]}"


@contextlib.contextmanager
def draft_beside(place: Place) -> Iterator[Path]:
    """Have a draft made beside a place, for as long as its own process lives; whatever is left of it is removed."""
    draft = _beside(place.path, _DRAFT)
    with contextlib.ExitStack() as held:
        held.callback(_discard, draft)
        with _locked(place.path.parent) as is_locked:
            if is_locked:
                _clear_away(place)
            place.make(draft)
            opened = _Opened(draft)
            held.callback(opened.close)
            opened.lock(fcntl.LOCK_EX | fcntl.LOCK_NB)  # until it is closed, or the process dies
        yield draft


def _discard(draft: Path) -> None:
    with contextlib.suppress(OSError):
        shutil.rmtree(draft) if draft.is_dir() else draft.unlink()


def publish(draft: Path, place: Place) -> None:
    """Rename a complete draft, after a second check: the place may have changed."""
    path = place.path
    with _locked(path.parent):
        place.check()
        try:
            status = path.lstat()
        except FileNotFoundError:
            if draft.is_dir() or not _renamed(draft, path, _NO_REPLACE):
                draft.rename(path)
        else:
            draft.chmod(stat.S_IMODE(status.st_mode))
            if stat.S_ISDIR(status.st_mode) and not any(path.iterdir()):
                draft.rename(path)  # onto an empty folder; the system refuses any other
            else:
                _replace(draft, place)
        synchronize(path.parent)


def _replace(draft: Path, place: Place) -> None:
    """Exchange old and new, check the old again, and remove it; or exchange them back."""
    path, ready = place.path, _beside(place.path, _READY)
    new = _identity(draft)
    try:
        draft.rename(ready)
        _exchange(ready, path)
        if os.path.lexists(ready):
            place.check(ready)  # something may have been put there since the last check
    except BaseException:
        if os.path.lexists(ready) and _identity(path) == new:
            _exchange(ready, path)
        raise
    finally:
        if os.path.lexists(ready):
            if _identity(ready) == new:
                ready.rename(draft)  # which its owner removes
            else:
                place.remove(ready)


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino


def _exchange(ready: Path, path: Path) -> None:
    """Exchange two names in one system call; where there is none, rename a file over the other one."""
    if _renamed(ready, path, _EXCHANGE):
        return
    if not ready.is_dir():
        ready.rename(path)
        return
    aside = _beside(path, _ASIDE)
    try:
        path.rename(aside)
        ready.rename(path)
        aside.rename(ready)
    except BaseException:
        if os.path.lexists(aside):
            _put_back(aside, ready if os.path.lexists(path) else path)
        raise


def _put_back(aside: Path, place: Path) -> None:
    try:
        aside.rename(place)
    except OSError as error:
        raise OutputError(
            f"{named(place)}: expected to put the earlier results back there, got: {error.strerror}; "
            f"they are in {named(aside)}"
        ) from error


_NO_REPLACE, _EXCHANGE = 1, 2  # of <linux/fs.h>


def _renamed(one: Path, other: Path, flags: int) -> bool:
    """Rename with flags of renameat2; False where the system, its C library or the file system does not know them."""
    import ctypes

    call = _renameat2()
    if call is None:
        return False
    at_current = -100  # AT_FDCWD, for paths that are not absolute
    if call(at_current, os.fsencode(one), at_current, os.fsencode(other), flags) == 0:
        return True
    number = ctypes.get_errno()
    if number in (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.EPERM):
        return False
    raise OSError(number, os.strerror(number), str(one), None, str(other))


@cache
def _renameat2() -> Callable[[int, bytes, int, bytes, int], int] | None:
    import ctypes

    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)  # glibc has it since 2.28
    if call is None:
        return None
    call.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint)
    call.restype = ctypes.c_int
    return call  # type: ignore[no-any-return]


# ---- What killed processes leave ------------------------------------------------------------------------------------


def _left_over(path: Path) -> list[tuple[str, Path]]:
    """List what a process that writes there now, or that was killed, has beside a place: purposes and names."""
    names = re.compile(rf"\.hexservo-({_DRAFT}|{_READY}|{_ASIDE})-{re.escape(_label(path))}-[0-9a-f]{{12}}")
    try:
        with os.scandir(path.parent) as entries:
            found = [
                (match[1], path.parent / entry.name) for entry in entries if (match := names.fullmatch(entry.name))
            ]
    except (OSError, ValueError):  # there is no such folder, or it may not be read
        return []
    return sorted(found)  # "aside" comes first


def _clear_away(place: Place) -> None:
    """Put back results whose name is missing, and remove what killed processes left; under the parent's lock.

    What is "ready" or "aside" while no process has the lock belongs to a process that has ended. It is removed only
    if it is ours and complete: if a foreign file is in it, the process was killed before it could report that.
    """
    for purpose, left in _left_over(place.path):
        with contextlib.suppress(OSError, OutputError):  # another process of ours will try again
            if purpose == _DRAFT:
                if _is_abandoned(left):
                    _discard(left)
            elif purpose == _ASIDE and not os.path.lexists(place.path):
                left.rename(place.path)
            elif place.is_ours(left):
                place.remove(left)


def _is_abandoned(draft: Path) -> bool:
    opened = _Opened(draft)
    try:
        return opened.lock(fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        opened.close()


class _SignalError(BaseException):
    """A signal that ends the process, once what was begun is removed."""


@contextlib.contextmanager
def signals_raised() -> Iterator[None]:
    """Have SIGTERM and SIGHUP end the process after cleaning up, where they would end it at once.

    Handlers of the program itself stay, and only the main thread may have any.
    """
    before = {}
    ended: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        if not ended:  # a second one does not disturb the cleaning
            ended.append(number)
            raise _SignalError

    try:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGHUP):
                if signal.getsignal(number) is signal.SIG_DFL:
                    before[number] = signal.signal(number, end)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if ended:
            signal.raise_signal(ended[0])


# ---- Locks, disks and words -----------------------------------------------------------------------------------------


class _Opened:
    """A file or folder that is open, and with it its lock."""

    def __init__(self, path: Path) -> None:
        self.descriptor = -1
        self.descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)

    def lock(self, flags: int) -> bool:
        try:
            fcntl.flock(self.descriptor, flags)
        except OSError:  # another process has it, or the file system has no locks
            return False
        return True

    def close(self) -> None:
        if self.descriptor >= 0:
            with contextlib.suppress(OSError):
                fcntl.flock(self.descriptor, fcntl.LOCK_UN)  # first: whatever interrupts the rest, no lock stays
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


class _Held(threading.local):
    """The lock that a thread has: one at most."""

    lock: _Opened | None = None


_HELD = _Held()


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Lock a folder against renaming by another hexservo; False where the file system has no locks."""
    if _HELD.lock is not None:  # a Ctrl-C came at the very moment of closing: this thread would wait for itself
        _HELD.lock.close()
    opened = _HELD.lock = _Opened(Path(os.path.realpath(folder)))
    try:
        yield opened.lock(fcntl.LOCK_EX)
    finally:
        opened.close()


def synchronize(path: Path) -> None:
    """Have a file or a folder on the disk before going on; some file systems cannot do it for folders."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise
    finally:
        os.close(descriptor)


def named(path: Path) -> str:
    """Quote a path so that it stays on its line, whatever characters it has; near ones relative, as typed."""
    try:
        text = str(path.relative_to(Path.cwd()))
    except (OSError, ValueError):
        text = str(path)
    return quoted(text)
