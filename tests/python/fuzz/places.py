"""Writing that is stopped: killed at random moments, killed at each line, interrupted at each line.

What must hold: a name that stood for something whole still does, with old content or new content and no mixture; the
next process that looks at the place finds nothing else there. Processes are forked here, which takes one without other
threads: this module is a program too, ``python -m fuzz.places FOLDER SEED KILLS SECONDS``.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from hexservo.run import files, publish

TITLE = "# a file of the fuzzer"
AUTHOR = "the fuzzer"
FILES = ("a.txt", "b.bin", "c.txt")
_WATCHED = {files.__file__, publish.__file__}


@dataclass(frozen=True)
class Subject:
    """Something that is written again and again at one place, each time with another number in it."""

    name: str
    write: Callable[[Path, int], object]  # with force
    check: Callable[[Path], None]  # as a command does before its work
    numbers: Callable[[Path], set[int]]  # found in it; fails where it is not whole


def _fill(number: int) -> Callable[[Path], None]:
    def fill(folder: Path) -> None:
        for name in FILES:
            (folder / name).write_text(f"{number}\n" * 100, encoding="utf-8")

    return fill


def _folder_numbers(folder: Path) -> set[int]:
    digests = dict(
        line.split("  ")[::-1] for line in (folder / files.MARKER).read_text().splitlines() if not line.startswith("#")
    )
    assert set(digests) == set(FILES)
    assert {entry.name for entry in folder.iterdir()} == {files.MARKER, *FILES}
    contents = {name: (folder / name).read_bytes() for name in FILES}
    assert all(hashlib.sha256(content).hexdigest() == digests[name] for name, content in contents.items())
    return {int(line) for content in contents.values() for line in content.split()}


def _file_numbers(file: Path) -> set[int]:
    title, *lines = file.read_text(encoding="utf-8").splitlines()
    assert (title, len(lines)) == (TITLE, 1000)
    return {int(line) for line in lines}


SUBJECTS = (
    Subject(
        "folder",
        lambda path, number: files.write_folder(path, _fill(number), "the fuzzer", force=True),
        lambda path: files.check_folder(path, force=True),
        _folder_numbers,
    ),
    Subject(
        "file",
        lambda path, number: files.write_file(TITLE + f"\n{number}" * 1000 + "\n", path, TITLE, AUTHOR, force=True),
        lambda path: files.check_file(path, TITLE, AUTHOR, force=True),
        _file_numbers,
    ),
)


def names(place: Path) -> list[str]:
    """Give the names beside a place, its own among them."""
    return sorted(entry.name for entry in place.parent.iterdir())


def _lacking(one: Path, other: Path, flags: int) -> bool:
    return False


@contextlib.contextmanager
def without_exchange() -> Iterator[None]:
    """Have the system lack renameat2."""
    renamed, publish._renamed = publish._renamed, _lacking
    try:
        yield
    finally:
        publish._renamed = renamed


# ---- Faults at each line --------------------------------------------------------------------------------------------


@contextlib.contextmanager
def fault_at(line: int, fault: Callable[[], object]) -> Iterator[list[int]]:
    """Have a fault when the line with that number among those run of `files` and `publish` is about to run."""
    count = [0]

    def local(frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            count[0] += 1
            if count[0] == line:
                fault()
        return local

    def traced(frame: FrameType, event: str, argument: Any) -> Any:
        return local if frame.f_code.co_filename in _WATCHED else None

    before = sys.gettrace()
    sys.settrace(traced)
    try:
        yield count
    finally:
        sys.settrace(before)


def lines_of(subject: Subject, place: Path) -> int:
    """Count the lines that replacing runs."""
    subject.write(place, 0)
    with fault_at(0, lambda: None) as count:
        subject.write(place, 0)
    return count[0]


def interrupted_at(subject: Subject, place: Path, line: int) -> str:
    """Raise KeyboardInterrupt at a line of replacing, and return what was left."""

    def interrupt() -> None:
        raise KeyboardInterrupt

    subject.write(place, 0)
    try:
        with fault_at(line, interrupt):
            subject.write(place, 1)
        return "not reached"
    except KeyboardInterrupt:
        (number,) = subject.numbers(place)
        assert number in (0, 1), number
        subject.check(place)
        left = [name for name in names(place) if name != place.name]
        assert all(name.startswith(".hexservo-draft-") for name in left), left  # swept when this process has ended
        return ("old" if number == 0 else "new") + (" and left-overs" if left else "")


def killed_at(subject: Subject, place: Path, line: int, *, first: bool) -> str:
    """Kill a process at a line of its writing, and return what it left.

    Parameters
    ----------
    subject, place, line
        What it writes, where, and at which line.
    first
        Whether nothing stands there before.
    """
    if first:
        _remove(place)
    else:
        subject.write(place, 0)

    def write() -> None:
        with fault_at(line, lambda: os.kill(os.getpid(), signal.SIGKILL)):
            subject.write(place, 1)

    if _in_a_process(write):
        return "not reached"
    return _settled(subject, place, {1} if first else {0, 1})


def _settled(subject: Subject, place: Path, allowed: set[int] | None) -> str:
    """Return what a killed process left, after the checks of what must hold; None allows any number."""
    is_there = os.path.lexists(place)
    before = names(place)
    if is_there:
        assert len(subject.numbers(place)) == 1
    subject.check(place)  # restores and sweeps
    assert names(place) == ([place.name] if os.path.lexists(place) else []), names(place)
    if not os.path.lexists(place):
        assert allowed == {1}, "an earlier result was lost"
        return "nothing" if not before else "a draft"
    (number,) = subject.numbers(place)
    assert allowed is None or number in allowed, number
    if not is_there:
        assert publish._renamed is _lacking, "the name was missing"
        return "a missing name"
    return ("old" if number == 0 else "new") + (" and left-overs" if before != [place.name] else "")


def _remove(place: Path) -> None:
    if place.is_dir():
        for entry in place.iterdir():
            entry.unlink()
        place.rmdir()
    else:
        place.unlink(missing_ok=True)


def _in_a_process(act: Callable[[], object]) -> bool:
    """Tell whether a forked process came to its end; it may be killed, and nothing else."""
    child = os.fork()
    if child == 0:
        try:
            act()
            os._exit(0)
        except BaseException:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    assert status in (0, signal.SIGKILL), status
    return status == 0


# ---- Kills at random moments ----------------------------------------------------------------------------------------


def killed_at_random(subject: Subject, place: Path, random: np.random.Generator) -> str:
    """Kill a process that writes as fast as it can, and return what it left."""
    number = 0
    subject.write(place, number)
    started = time.perf_counter()
    subject.write(place, number)
    once = time.perf_counter() - started
    child = os.fork()
    if child == 0:
        while True:
            number += 1
            subject.write(place, number)
    time.sleep(random.uniform(0, 4 * once))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return _settled(subject, place, None)


def main() -> None:
    """Stop writing again and again, and print how often each end was seen; a failure ends with its own seed."""
    folder, seed, kills, seconds = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    os.fsync = lambda fd: None  # what is killed is a process, not the machine; and it takes most of the time
    seen: Counter[str] = Counter()
    until = time.monotonic() + seconds
    trial = 0
    lengths: dict[str, int] = {}
    while trial < kills and time.monotonic() < until:
        random = np.random.default_rng([seed, trial])
        subject = SUBJECTS[random.integers(len(SUBJECTS))]
        place = folder / str(trial) / "out"
        place.parent.mkdir()
        way = ("killed", "killed at first", "killed at random", "interrupted")[random.integers(4)]
        with without_exchange() if random.random() < 0.3 else contextlib.nullcontext():
            lines = lengths.setdefault(subject.name, lines_of(subject, place))
            line = int(random.integers(1, lines + 1))
            try:
                if way == "interrupted":
                    end = interrupted_at(subject, place, line)
                elif way == "killed at random":
                    end = killed_at_random(subject, place, random)
                else:
                    end = killed_at(subject, place, line, first=way == "killed at first")
            except AssertionError as error:
                raise AssertionError(f"seed {seed}, trial {trial}: {subject.name}, {way}, line {line}") from error
        seen[f"{way}: {end}"] += 1
        _remove(place)
        place.parent.rmdir()
        trial += 1
    print(json.dumps({"trials": trial, "seen": dict(sorted(seen.items()))}))


if __name__ == "__main__":
    main()
