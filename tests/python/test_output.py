"""Results on disk: complete, all or nothing, and never in place of something that a user made."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import resource
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import hexservo as hs
from fuzz.places import SUBJECTS, Subject, without_exchange
from hexservo.cli.output import write_results
from hexservo.run import publish
from hexservo.run.files import MARKER, _Folder, check_file, check_folder, write_file
from hexservo.run.publish import OutputError, draft_beside
from hexservo.run.saving import result_bytes

FIGURE = "fig3_feature_paths.svg"
FILES = {MARKER, "scenario.yaml", "metrics.json", "result.nc", FIGURE}


@pytest.fixture(scope="module")
def result() -> hs.Result:
    return hs.simulate(hs.load_scenario("paper").updated({"simulation.duration": 0.05}))


@pytest.fixture(autouse=True)
def quick_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write one small file in place of the figures; the command line's tests draw the real ones.

    The run is encoded once: the same run has the same bytes.
    """
    draw_with(monkeypatch, lambda: None)
    monkeypatch.setattr("hexservo.run.saving.result_bytes", encoded)


RUNS: list[tuple[hs.Result, bytes]] = []


def encoded(result: hs.Result) -> bytes:
    for run, content in RUNS:
        if run is result:
            return content
    RUNS.append((result, bytes(result_bytes(result))))
    return RUNS[-1][1]


def draw_with(monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]) -> None:
    def paper_images(result: hs.Result) -> dict[str, bytes]:
        act()
        return {FIGURE: f"drawn for {result.scenario.name}".encode()}

    monkeypatch.setattr("hexservo.draw.plots.paper_images", paper_images)


def contents(folder: Path) -> dict[str, str]:
    """Everything below a folder: digests of files, targets of links, permissions of folders."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            found[str(path.relative_to(folder))] = f"-> {path.readlink()}"
        elif path.is_dir():
            found[str(path.relative_to(folder))] = f"folder {path.stat().st_mode:o}"
        else:
            found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def assert_whole(folder: Path) -> None:
    """Exactly our files, each as the marker lists it."""
    assert {path.name for path in folder.iterdir()} == FILES
    listed = [line.split("  ") for line in (folder / MARKER).read_text().splitlines() if not line.startswith("#")]
    assert {name for _, name in listed} == FILES - {MARKER}
    for digest, name in listed:
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


@contextmanager
def refused_and_kept(place: Path, *words: str) -> Iterator[None]:
    """Expect a refusal with these words, and everything below a place unchanged, without leftovers."""
    before = contents(place)
    with pytest.raises(OutputError) as caught:
        yield
    assert contents(place) == before
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text


# ---- What is written ------------------------------------------------------------------------------------------------


def test_everything_is_there_and_reads_back(result: hs.Result, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert write_results(result, folder) == folder
    assert_whole(folder)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert hs.load_scenario(folder / "scenario.yaml") == result.scenario
    with xarray.open_dataset(folder / "result.nc", engine="h5netcdf") as dataset:
        assert dataset.load().identical(result.to_xarray())


def test_the_folder_as_text_and_relative(result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert write_results(result, "a/../out") == Path("a/../out")
    assert_whole(tmp_path / "out")


def strict(text: str) -> Any:
    """Parse JSON and nothing more: Python's NaN and Infinity are none."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_metrics_json(result: hs.Result, tmp_path: Path) -> None:
    content = strict((write_results(result, tmp_path / "out") / "metrics.json").read_text(encoding="utf-8"))
    assert content["hexservo"] == hs.__version__
    assert content["scenario"] == "paper"
    assert content["outcome"] == "completed"
    assert content["end_time"] == {"value": 0.05, "unit": "s"}
    assert content["detail"] == result.detail
    assert content["events"] == []
    metrics = hs.metrics(result)
    assert np.isnan(metrics["rms_error"])  # the run ends before 1 s
    assert content["metrics"]["rms_error"]["value"] is None
    assert list(content["metrics"]) == list(hs.METRICS)
    for name, (unit, meaning) in hs.METRICS.items():
        written = content["metrics"][name]
        assert (written["unit"], written["meaning"]) == (unit, meaning)
        if np.isfinite(metrics[name]):
            assert written["value"] == metrics[name]


def test_a_run_that_ended_early_is_written_with_its_events(tmp_path: Path) -> None:
    changes = {"uncertainty.gravity": 0.5, "simulation.log_every": 50}
    result = hs.simulate(hs.load_scenario("paper-gravity").updated(changes))
    assert result.outcome != "completed"
    assert {event.kind for event in result.events} == {"stroke", "force"}
    content = strict((write_results(result, tmp_path / "out") / "metrics.json").read_text(encoding="utf-8"))
    assert content["outcome"] == result.outcome
    assert content["end_time"]["value"] == result.end_time
    for written, event in zip(content["events"], result.events, strict=True):
        unit = {"stroke": "m", "force": "N"}[event.kind]
        assert written == {
            "kind": event.kind,
            "leg": event.leg,
            "time": {"value": event.time, "unit": "s"},
            "peak": {"value": event.peak, "unit": unit},
            "limit": {"value": event.limit, "unit": unit},
        }


def test_parents_are_made_and_permissions_are_the_usual_ones(result: hs.Result, tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        folder = write_results(result, tmp_path / "a" / "b" / "out")
    finally:
        os.umask(before)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o750
    assert stat.S_IMODE((folder / "result.nc").stat().st_mode) == 0o640
    assert_whole(folder)


def test_an_empty_folder_is_used_and_keeps_its_permissions(result: hs.Result, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    folder.chmod(0o710)
    write_results(result, folder)
    assert_whole(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o710


def test_the_longest_name_there_is(result: hs.Result, tmp_path: Path) -> None:
    assert_whole(write_results(result, tmp_path / ("é" * 127)))  # 254 bytes; 255 is the most


# ---- What is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_with_foreign_files_is_kept(result: hs.Result, tmp_path: Path, force: bool) -> None:
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter.tex").write_text("years of work")
    with refused_and_kept(tmp_path, '"', "thesis", "not results of hexservo", "name another folder"):
        write_results(result, folder, force=force)


def test_results_are_kept_without_force_and_replaced_with_it(result: hs.Result, tmp_path: Path) -> None:
    folder = write_results(result, tmp_path / "out")
    folder.chmod(0o750)
    with refused_and_kept(tmp_path, "holds results already", "--force"):
        write_results(result, folder)
    other = hs.simulate(result.scenario.updated({"name": "other"}))
    (folder / FIGURE).unlink()  # a file that the user removed is no obstacle
    assert write_results(other, folder, force=True) == folder
    assert_whole(folder)
    assert hs.load_scenario(folder / "scenario.yaml").name == "other"
    assert (folder / FIGURE).read_text() == "drawn for other"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o750
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def add_a_file(folder: Path) -> None:
    (folder / "notes.txt").write_text("mine")


def change_a_file(folder: Path) -> None:
    with (folder / "scenario.yaml").open("a") as file:
        file.write("# a comment\n")


def put_a_folder(folder: Path) -> None:
    (folder / FIGURE).unlink()
    (folder / FIGURE).mkdir()
    (folder / FIGURE / "notes.txt").write_text("mine")


def put_a_link(folder: Path) -> None:
    (folder / "result.nc").rename(folder.parent / "result.nc")
    (folder / "result.nc").symlink_to(folder.parent / "result.nc")


def break_a_line_of_the_marker(folder: Path) -> None:
    (folder / MARKER).write_text((folder / MARKER).read_text() + "scenario.yaml\n")


def empty_the_marker(folder: Path) -> None:
    (folder / MARKER).write_bytes(b"")


def fill_the_marker(folder: Path) -> None:
    (folder / MARKER).write_bytes(b"\xff" * 200_000)


def link_the_marker(folder: Path) -> None:
    (folder / MARKER).rename(folder.parent / "marker")
    (folder / MARKER).symlink_to(folder.parent / "marker")


def remove_the_marker(folder: Path) -> None:
    (folder / MARKER).unlink()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (add_a_file, "did not write, so it is kept: notes.txt;"),
        (change_a_file, "did not write, so it is kept: scenario.yaml (changed since);"),
        (put_a_folder, f"did not write, so it is kept: {FIGURE} (not a file);"),
        (put_a_link, "did not write, so it is kept: result.nc (not a file);"),
        (break_a_line_of_the_marker, f"no valid {MARKER}"),
        (empty_the_marker, f"no valid {MARKER}"),
        (fill_the_marker, f"no valid {MARKER}"),
        (link_the_marker, f"no valid {MARKER}"),
        (remove_the_marker, f"no valid {MARKER}"),
    ],
)
def test_force_keeps_what_a_user_made_among_the_results(
    result: hs.Result, tmp_path: Path, change: Callable[[Path], None], words: str
) -> None:
    folder = write_results(result, tmp_path / "out")
    change(folder)
    with refused_and_kept(tmp_path, words):
        write_results(result, folder, force=True)


def test_many_foreign_files_are_reported_in_one_line(result: hs.Result, tmp_path: Path) -> None:
    folder = write_results(result, tmp_path / "out")
    for number in range(12):
        (folder / f"\n{number:02}").touch()
    with refused_and_kept(tmp_path, r"'\n00'", "and 4 more"):
        write_results(result, folder, force=True)


def test_links_are_not_followed(result: hs.Result, tmp_path: Path) -> None:
    folder = write_results(result, tmp_path / "out")
    (tmp_path / "empty").mkdir()
    for number, target in enumerate([folder, tmp_path / "empty", tmp_path / "nowhere"]):
        link = tmp_path / f"link{number}"
        link.symlink_to(target)
        with refused_and_kept(tmp_path, "symbolic link to", target.name):
            write_results(result, link, force=True)


def test_a_link_among_the_parents_is_followed(result: hs.Result, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to("disk")
    assert write_results(result, tmp_path / "link" / "out") == tmp_path / "link" / "out"
    assert_whole(tmp_path / "disk" / "out")


def test_a_file_is_no_folder(result: hs.Result, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    for place, words in [(file, "got a file"), (file / "out", "Not a directory"), (file / "a" / "out", "Not a dir")]:
        with refused_and_kept(tmp_path, words):
            write_results(result, place, force=True)


@pytest.mark.parametrize("name", [".", "../here"])
def test_the_current_folder_is_not_replaced_under_the_user(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with refused_and_kept(tmp_path, "other than the current one"):
        write_results(result, name)


def test_an_empty_path_is_not_the_current_folder(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with refused_and_kept(tmp_path, "folder: expected a path, got an empty one"):
        write_results(result, "")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a\0b", "null"),
        ("x" * 300, "File name too long"),
        ("y" * 300 + "/out", "File name too long"),
        ("/".join(["z" * 200] * 30), "File name too long"),
    ],
)
def test_names_that_no_folder_can_have(result: hs.Result, tmp_path: Path, name: str, words: str) -> None:
    with refused_and_kept(tmp_path, words):
        write_results(result, tmp_path / name)


def test_the_root_and_a_file_system_that_holds_no_folders(result: hs.Result) -> None:
    with pytest.raises(OutputError, match="not results of hexservo"):
        write_results(result, "/", force=True)
    for place in ("/proc/hexservo", "/proc/a/b"):
        with pytest.raises(OutputError, match=r"expected a (folder|place) that can be written"):
            write_results(result, place)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_parent_without_permission(result: hs.Result, tmp_path: Path) -> None:
    parent = tmp_path / "parent"
    parent.mkdir()
    parent.chmod(0o500)
    try:
        with refused_and_kept(tmp_path, "not permitted"):
            write_results(result, parent / "a" / "out")
    finally:
        parent.chmod(0o700)


def test_permission_is_asked_of_the_nearest_parent_there_is(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    with refused_and_kept(tmp_path, "not permitted"):
        write_results(result, tmp_path / "a" / "out")


@pytest.mark.parametrize("there", [False, True])
def test_permission_is_asked_before_long_work(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    """Of a file, and of a folder, that is new or that is to be replaced."""
    if there:
        write_file("title\n", tmp_path / "file.txt", "title", "a test")
        write_results(result, tmp_path / "out")
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path and access(path, mode))
    with refused_and_kept(tmp_path, "not permitted"):
        check_file(tmp_path / "file.txt", "title", "a test", force=True)
    with refused_and_kept(tmp_path, "not permitted"):
        check_folder(tmp_path / "out", force=True)


def test_a_mount_point_is_refused_before_long_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is empty, but no other folder can get its name."""
    (tmp_path / "disk").mkdir()
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == tmp_path / "disk")
    with refused_and_kept(tmp_path, "got a mount point; name a new folder inside it"):
        check_folder(tmp_path / "disk")
    check_folder(tmp_path / "disk" / "out")


def test_checking_a_folder_writes_nothing_and_refuses_the_same(result: hs.Result, tmp_path: Path) -> None:
    check_folder(tmp_path / "a" / "out")
    assert contents(tmp_path) == {}
    folder = write_results(result, tmp_path / "out")
    check_folder(folder, force=True)
    with refused_and_kept(tmp_path, "--force"):
        check_folder(folder)
    add_a_file(folder)
    with refused_and_kept(tmp_path, "notes.txt"):
        check_folder(folder, force=True)


# ---- What goes wrong on the way -------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [100, 1_000, 10_000, 30_000])
def test_a_full_disk(result: hs.Result, tmp_path: Path, limit: int) -> None:
    """A limit on the size of files stops the writing for real, in the text files as in the data."""
    sizes = [path.stat().st_size for path in write_results(result, tmp_path / "out").iterdir()]
    assert max(sizes) > 30_000
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with refused_and_kept(tmp_path, "File too large", "nothing was written"):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))
        try:
            write_results(result, tmp_path / "a" / "b" / "out")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(1), MemoryError(), ValueError("a mistake of ours")])
@pytest.mark.parametrize("force", [False, True])
def test_nothing_is_left_of_writing_that_was_stopped(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, force: bool
) -> None:
    folder = write_results(result, tmp_path / "a" / "out")
    place = folder if force else tmp_path / "b" / "c" / "out"
    before = contents(tmp_path)

    def stop() -> None:
        assert contents(tmp_path) != before  # it had begun
        raise error

    draw_with(monkeypatch, stop)
    with pytest.raises(type(error)) as caught:
        write_results(result, place, force=force)
    assert caught.value is error
    assert contents(tmp_path) == before


@pytest.fixture(params=["exchange", "renames"])
def way(request: pytest.FixtureRequest) -> Iterator[str]:
    """Old and new change places in one system call, or in three where there is none."""
    with without_exchange() if request.param == "renames" else nullcontext():
        yield request.param


def around_exchange(
    monkeypatch: pytest.MonkeyPatch, before: Callable[[Path], object] | None, after: Callable[[Path], object] | None
) -> None:
    """Have something happen before and after the first exchange; it gets the folder of the old results."""
    exchange = publish._exchange
    calls = []

    def spied(ready: Path, path: Path) -> None:
        calls.append(path)
        if before is not None and len(calls) == 1:
            before(path)
        exchange(ready, path)
        if after is not None and len(calls) == 1:
            after(ready)

    monkeypatch.setattr(publish, "_exchange", spied)


def fail(_: Path) -> None:
    raise OSError(errno.EIO, os.strerror(errno.EIO))


def interrupt(_: Path) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
@pytest.mark.parametrize("when", ["before", "after"])
def test_the_old_results_stay_where_the_exchange_is_stopped(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str, when: str, error: type[BaseException]
) -> None:
    folder = write_results(result, tmp_path / "out")
    before = contents(tmp_path)
    act = fail if error is OSError else interrupt
    around_exchange(monkeypatch, act if when == "before" else None, act if when == "after" else None)
    with pytest.raises(
        OutputError if error is OSError else error, match="nothing was written" if act is fail else None
    ):
        write_results(result, folder, force=True)
    assert contents(tmp_path) == before


def renames_fail(monkeypatch: pytest.MonkeyPatch, *, back: bool) -> None:
    """Have the second of three renames fail, and those that put old results back."""
    rename = Path.rename

    def spied(source: Path, target: Path) -> Path:
        if source.name.startswith(".hexservo-ready-") and target.name == "out":
            fail(source)
        if source.name.startswith(".hexservo-aside-") and back:
            fail(source)
        return rename(source, target)

    monkeypatch.setattr(Path, "rename", spied)


def test_the_old_results_come_back_where_the_new_ones_cannot_go(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_results(result, tmp_path / "out")
    renames_fail(monkeypatch, back=False)
    with without_exchange(), refused_and_kept(tmp_path, os.strerror(errno.EIO), "nothing was written"):
        write_results(result, folder, force=True)


def test_the_old_results_are_where_the_error_says_if_they_cannot_come_back_and_return_with_the_next_check(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_results(result, tmp_path / "out")
    before = contents(folder)
    with monkeypatch.context() as patch, without_exchange():
        renames_fail(patch, back=True)
        with pytest.raises(OutputError, match="expected to put the earlier results back there") as caught:
            write_results(result, folder, force=True)
    (aside,) = tmp_path.iterdir()
    assert aside.name in str(caught.value)
    assert contents(aside) == before
    with pytest.raises(OutputError, match="holds results already"):
        check_folder(folder)
    assert contents(folder) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_file_that_appears_between_two_checks(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str, when: str
) -> None:
    folder = write_results(result, tmp_path / "out")
    around_exchange(monkeypatch, add_a_file if when == "before" else None, add_a_file if when == "after" else None)
    with pytest.raises(OutputError, match=r"kept: notes\.txt"):
        write_results(result, folder, force=True)
    assert (folder / "notes.txt").read_text() == "mine"
    (folder / "notes.txt").unlink()
    assert_whole(folder)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_file_that_appears_at_the_last_moment(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_results(result, tmp_path / "out")
    unlink = Path.unlink

    def spied(path: Path, missing_ok: bool = False) -> None:
        if path.name == MARKER:
            add_a_file(path.parent)
        unlink(path, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", spied)
    with pytest.raises(OutputError, match="the new results are there, but the old ones could not be removed") as caught:
        write_results(result, folder, force=True)
    assert_whole(folder)
    (aside,) = (path for path in tmp_path.iterdir() if path != folder)
    assert aside.name in str(caught.value)
    assert [path.name for path in aside.iterdir()] == ["notes.txt"]
    check_folder(folder, force=True)
    assert [path.name for path in aside.iterdir()] == ["notes.txt"]  # no sweep takes what is not ours


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_the_name_is_never_missing(tmp_path: Path, subject: Subject) -> None:
    """Another thread looks for the name all the time, while it comes to stand for fifty contents."""
    place = tmp_path / "out"
    subject.write(place, 0)
    looks = missing = 0
    done = threading.Event()

    def look() -> None:
        nonlocal looks, missing
        while not done.is_set():
            looks += 1
            missing += not os.path.lexists(place)

    looking = threading.Thread(target=look)
    looking.start()
    try:
        for number in range(50):
            subject.write(place, number)
    finally:
        done.set()
        looking.join()
    assert missing == 0
    assert looks > 100


def test_a_draft_of_a_living_process_is_left_alone(result: hs.Result, tmp_path: Path) -> None:
    """And one whose process has died is not."""
    with draft_beside(_Folder(tmp_path / "out", force=True)) as draft:
        (draft / "half").write_text("written")
        write_results(result, tmp_path / "out")
        assert (draft / "half").exists()
        dead = tmp_path / draft.name.replace(draft.name[-4:], "0000")
        dead.mkdir()
        (dead / "half").write_text("written")
        write_results(result, tmp_path / "out", force=True)
        assert draft.exists()
        assert not dead.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_a_signal_that_ends_the_process_leaves_nothing_behind(
    tmp_path: Path, subject: Subject, number: signal.Signals
) -> None:
    """The process ends by that signal, as its parent expects."""
    place = tmp_path / "out"
    subject.write(place, 0)
    program = f"""
import os
from pathlib import Path
from fuzz.places import SUBJECTS
import hexservo.run.files
hexservo.run.files.publish = lambda draft, place: os.kill(os.getpid(), {int(number)})
(subject,) = (subject for subject in SUBJECTS if subject.name == {subject.name!r})
subject.write(Path({str(place)!r}), 1)
print("not reached")
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (-number, "", "")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert subject.numbers(place) == {0}


def test_handlers_of_the_program_stay(result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: seen.append(number))
    try:
        draw_with(monkeypatch, lambda: os.kill(os.getpid(), signal.SIGTERM))
        write_results(result, tmp_path / "out")
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == [signal.SIGTERM]
    assert_whole(tmp_path / "out")


def test_a_folder_that_appears_while_we_write(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"

    def appear() -> None:
        folder.mkdir()
        add_a_file(folder)

    draw_with(monkeypatch, appear)
    with pytest.raises(OutputError, match="not results of hexservo"):
        write_results(result, folder, force=True)
    assert contents(tmp_path).keys() == {"out", "out/notes.txt"}


@pytest.mark.parametrize("force", [False, True])
def test_of_two_writers_the_first_wins_and_with_force_the_last(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: bool
) -> None:
    """Both have written their files when the first of them renames: one wins without force, the last one with it."""
    folder = tmp_path / "out"
    runs = [hs.simulate(result.scenario.updated({"name": name})) for name in ("one", "two")]
    if force:
        write_results(result, folder)
    meeting = threading.Barrier(2, timeout=60)
    draw_with(monkeypatch, meeting.wait)

    def write(run: hs.Result) -> str:
        try:
            write_results(run, folder, force=force)
        except OutputError as error:
            return str(error)
        return "written"

    with ThreadPoolExecutor(2) as threads:
        said = list(threads.map(write, runs))
    if force:
        assert said == ["written", "written"]
    else:
        assert sorted("holds results already" in text for text in said) == [False, True]
        assert "written" in said
    assert_whole(folder)
    name = hs.load_scenario(folder / "scenario.yaml").name
    assert (folder / FIGURE).read_text() == f"drawn for {name}"
    assert force or said[["one", "two"].index(name)] == "written"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("force", [False, True])
def test_one_writer_at_a_time_renames(
    result: hs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: bool
) -> None:
    folder = tmp_path / "out"
    if force:
        write_results(result, folder)
    before = contents(folder)
    drawn = threading.Event()
    held = threading.Event()

    def draw() -> None:
        drawn.set()
        assert held.wait(60)

    draw_with(monkeypatch, draw)
    writer = threading.Thread(target=write_results, args=(result, folder), kwargs={"force": force})
    other = os.open(tmp_path, os.O_RDONLY)
    try:
        writer.start()
        assert drawn.wait(60)
        fcntl.flock(other, fcntl.LOCK_EX)
        held.set()
        writer.join(0.5)
        assert writer.is_alive()  # it waits for the other
        assert contents(folder) == before
    finally:
        os.close(other)
        writer.join(60)
    assert_whole(folder)
