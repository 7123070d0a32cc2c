"""Folders of campaigns: what is refused, what is kept, and what a result reads from them."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import hexservo as hs
from hexservo.campaigns import store
from hexservo.campaigns.plan import CampaignPlan
from hexservo.campaigns.search_steps import SearchSteps
from hexservo.campaigns.store import plan_text, read_plan
from hexservo.run.publish import OutputError
from test_campaign_engine import FILE


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The campaign of the engine's tests, complete."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    assert hs.campaign(FILE, folder).complete
    return folder


# ---- Chunks that a campaign does not have ---------------------------------------------------------------------------


def test_chunks_of_more_runs_than_a_campaign_has_now_are_left_alone(tmp_path: Path) -> None:
    """Where `until` alone ended it, and a damaged chunk keeps it from being complete at once."""
    folder = tmp_path / "out"
    ended = hs.campaign({**FILE, "runs": None, "chunk_size": 20, "until": {"width_below": 0.3}}, folder)
    before = ended.margin()
    chunks = sorted((folder / "chunks").iterdir())
    assert len(chunks) > 2
    kept = chunks[-1].read_bytes()
    chunks[0].write_bytes(b"damaged")
    warnings: list[str] = []
    fewer = hs.campaign({**FILE, "chunk_size": 20}, folder, runs=40, warn=warnings.append)
    assert len(warnings) == 1
    assert "its runs are computed again" in warnings[0]
    assert len(fewer) == 40
    assert fewer.margin().tolist() == before[:40].tolist()
    assert chunks[-1].read_bytes() == kept


def test_a_file_with_another_number_of_digits_is_no_chunk(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shutil.copytree(whole, folder)
    shutil.copy(folder / "chunks" / "000001.parquet", folder / "chunks" / "0000001.parquet")
    (folder / "chunks" / "000001.parquet").unlink()
    again = hs.campaign(FILE, folder)
    assert again.complete
    assert again.margin().tolist() == hs.load_campaign(whole).margin().tolist()


# ---- Folders --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "differs"),
    [
        ({"stream": 1}, r"stream \(0 there, 1 now\);"),
        ({"require": ["final_error <= 3"]}, r'require \(\[.*\.\.\. there, \["final_error <= 3.0"\] now\);'),
        ({"confidence": 0.9}, r"confidence \(0.95 there, 0.9 now\);"),
        ({"chunk_size": 50}, r"chunk_size \(100 there, 50 now\);"),
        (
            {"vary": {"seed": "each"}},
            r"vary: uncertainty.gravity.normal \(\[0.0, 0.1\] there, none now\), .* and \d more;",
        ),
        (
            {"vary": FILE["vary"] | {"uncertainty.gravity": {"normal": [0.0, 0.2], "clip": [-0.9, 0.9]}}},
            r"vary: uncertainty.gravity.normal \(\[0.0, 0.1\] there, \[0.0, 0.2\] now\);",
        ),
        (
            {"scenario": FILE["scenario"].updated({"metrics.band": 3.0})},
            r"scenario: metrics.band \(2.0 there, 3.0 now\);",
        ),
        ({"vary": dict(reversed(FILE["vary"].items()))}, "the order of the keys of vary;"),
        (
            {"scenario": FILE["scenario"].updated({"target.motion.amplitude": [-0.0] * 3})},
            "the sign of a zero in scenario",
        ),
    ],
)
def test_a_folder_of_a_different_campaign_is_refused(whole: Path, change: dict[str, Any], differs: str) -> None:
    before = {path: path.read_bytes() for path in whole.rglob("*") if path.is_file()}
    with pytest.raises(OutputError, match=f"expected a folder of this campaign, got one that differs in .*{differs}"):
        hs.campaign(FILE | change, whole)
    assert {path: path.read_bytes() for path in whole.rglob("*") if path.is_file()} == before


def test_what_no_run_depends_on_may_change(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    chunks = {path: path.stat().st_mtime_ns for path in (out / "chunks").iterdir()}
    tune = {"variables": {"controller.composite.drive": {"log": [1.0, 40.0]}}}
    scenario = FILE["scenario"].updated({"name": "b", "description": "c"})
    old = (out / "summary.json").read_bytes()
    changed = hs.campaign(FILE | {"tune": tune, "scenario": scenario}, out)
    assert {path: path.stat().st_mtime_ns for path in (out / "chunks").iterdir()} == chunks
    assert changed.summary == hs.load_campaign(whole).summary | {"scenario": "b"}
    loaded = hs.load_campaign(out)
    assert (loaded.summary, loaded.plan.scenario, loaded.plan.tune) == (changed.summary, scenario, changed.plan.tune)
    assert changed.plan.tune is not None
    (out / "summary.json").write_bytes(old)  # of a process that was killed before it wrote
    assert hs.load_campaign(out).summary["scenario"] == "b"


def test_folders_that_are_refused(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "letter.txt").write_text("Dear")
    with pytest.raises(OutputError, match="expected a new folder or that of a campaign, got one with other files"):
        hs.campaign(FILE, tmp_path / "letters")
    with pytest.raises(OutputError, match=r'letter\.txt": expected a folder, got a file; name another place'):
        hs.campaign(FILE, tmp_path / "letters" / "letter.txt")
    with pytest.raises(hs.ResultError, match=r"expected the folder of a campaign, got one without campaign.yaml"):
        hs.load_campaign(tmp_path / "letters")
    with pytest.raises(OutputError, match="expected at least 1000 runs, got 999"):
        hs.campaign(FILE, whole, runs=999)
    shutil.copytree(whole, tmp_path / "old")
    record = (tmp_path / "old" / "campaign.yaml").read_text(encoding="utf-8")
    for old, found in (("format: 1", "one of format 1"), ("", "a file that names no format")):
        (tmp_path / "old" / "campaign.yaml").write_text(
            record.replace(f"format: {store.FORMAT}", old), encoding="utf-8"
        )
        message = f"expected a campaign of format {store.FORMAT}, got {found}; run it again in a new folder$"
        with pytest.raises(hs.ResultError, match=message):
            hs.load_campaign(tmp_path / "old")


def test_a_folder_of_a_different_version_or_variant_is_refused(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(whole, tmp_path / "old")
    plan, record = read_plan(whole)
    other = next(name for name in ("baseline", "avx2") if name != record["variant"])
    for changed, error, message in (
        ("VERSION", OutputError, rf"differs in hexservo \(\"9\" there, \"{re.escape(hs.__version__)}\" now\);"),
        ("variant", hs.VariantError, f"expected {other}, that of the campaign, got {record['variant']}"),
    ):
        with monkeypatch.context() as patch:
            if changed == "VERSION":
                patch.setattr(store, "VERSION", "9")
            else:
                patch.setattr(CampaignPlan, "required_variant", lambda plan: other)
            text = plan_text(plan, store.new_record(plan))
        (tmp_path / "old" / "campaign.yaml").write_text(text, encoding="utf-8")
        with pytest.raises(error, match=message):
            hs.campaign(FILE, tmp_path / "old")


@pytest.mark.parametrize(
    ("before", "after", "sealed"),
    [
        ("stream: 0", "stream: 1", False),
        ("final_error <= 1.5", "final_error <= 1.6", False),
        ("confidence: 0.95", "confidence: 0.5", True),
        ("fixed_runs: 1000", "fixed_runs: 500", True),
    ],
)
def test_a_changed_campaign_file_is_refused(whole: Path, tmp_path: Path, before: str, after: str, sealed: bool) -> None:
    text = (whole / "campaign.yaml").read_text(encoding="utf-8")
    assert text.count(before) == 1
    changed = [text.replace(before, after)]
    if not sealed:  # the hash of the campaign, which has it too, is in folders of earlier versions
        changed.append(re.sub(r"(?m)^ *sha256: .*\n", "", changed[0]))
        assert len(changed[0]) > len(changed[1])
    for one in changed:
        (tmp_path / "campaign.yaml").write_text(one, encoding="utf-8")
        for use in (hs.load_campaign, lambda folder: hs.campaign(FILE, folder)):
            with pytest.raises(hs.ResultError, match="expected the file as hexservo wrote it, got one"):
                use(tmp_path)
    (tmp_path / "campaign.yaml").write_text(f"# by Ann\n{text}", encoding="utf-8")
    assert len(hs.load_campaign(tmp_path)) == 0, "a comment changes nothing"


def test_only_drafts_of_a_campaign_are_removed(tmp_path: Path) -> None:
    """A user's hidden files stay, and a folder that holds them is no empty one."""
    out = tmp_path / "out"
    (out / ".hexservo-x-0123456789ab.part").mkdir(parents=True)
    names = [".notes.part", "letter.part", ".letter.txt-0123456789ab.part"]
    for name in names:
        (out / name).write_text("Dear")
    with pytest.raises(OutputError, match="expected a new folder or that of a campaign, got one with other files"):
        hs.campaign(FILE, out, runs=10)
    theirs = set(out.iterdir())
    shutil.copytree(out, tmp_path / "theirs")
    for path in theirs:
        path.rmdir() if path.is_dir() else path.unlink()
    (out / ".hexservo-campaign.yaml-0123456789ab.part").write_text("of a killed process")
    hs.campaign(FILE, out, runs=10)
    assert all(path.suffix != ".part" for path in out.iterdir())
    shutil.copytree(tmp_path / "theirs", out, dirs_exist_ok=True)
    hs.campaign(FILE, out, runs=10)
    assert theirs < set(out.iterdir())


def test_only_one_process_writes(tmp_path: Path) -> None:
    def second(done: int, count: int) -> None:
        with pytest.raises(OutputError, match="expected a folder in which no other process writes"):
            hs.campaign(FILE, tmp_path / "out")

    assert hs.campaign(FILE, tmp_path / "out", runs=100, progress=second).complete


def test_a_worst_run_that_a_user_changed_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    hs.campaign(FILE, out, runs=50)
    first = (out / "worst-run.yaml").read_text(encoding="utf-8")
    hs.campaign(FILE, out, runs=200)
    larger = (out / "worst-run.yaml").read_text(encoding="utf-8")
    assert larger != first, "an unchanged file is replaced"
    warnings: list[str] = []
    for theirs in ("My notes", larger.replace("name: ", "name: my-")):
        (out / "worst-run.yaml").write_text(theirs, encoding="utf-8")
        assert hs.campaign(FILE, out, runs=200, warn=warnings.append).complete
        assert (out / "worst-run.yaml").read_text(encoding="utf-8") == theirs
    assert len(warnings) == 2
    assert 'worst-run.yaml": expected a file as hexservo wrote it, got a different one, which is kept' in warnings[0]
    assert re.search(r'; the worst run is in ".*/worst-run-1\.yaml"$', warnings[0])
    assert (out / "worst-run-1.yaml").read_text(encoding="utf-8") == larger
    again = hs.campaign(FILE, out, runs=200)
    assert again.worst_file == out / "worst-run-1.yaml", "an unchanged one is replaced there too"
    assert not (out / "worst-run-2.yaml").exists()
    plain = larger.partition("\n")[2]  # as earlier versions wrote it
    (out / "worst-run.yaml").write_text(plain, encoding="utf-8")
    hs.campaign(FILE, out, runs=200)
    assert (out / "worst-run.yaml").read_text(encoding="utf-8") == larger


def test_a_complete_campaign_is_repeated_without_writing(whole: Path, tmp_path: Path) -> None:
    """As in a folder that may only be read."""
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    hs.campaign(FILE, out)
    before = {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in (out, *out.rglob("*"))}
    assert hs.campaign(FILE, out).complete
    assert {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in (out, *out.rglob("*"))} == before


def test_a_place_that_cannot_be_written_is_not_said_to_go_on(tmp_path: Path) -> None:
    with pytest.raises(OutputError) as refusal:
        hs.campaign(FILE, tmp_path / ("x" * 300), runs=10)  # a name too long for the file system
    reason = "got: File name too long; permit writing there, or name another folder"
    assert str(refusal.value).endswith(f'x": expected a place that can be written, {reason}')
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(
        OutputError, match=r'link": expected a folder, got a symbolic link to "nowhere", which does not'
    ):
        hs.campaign(FILE, tmp_path / "link", runs=10)


def test_a_chunk_that_cannot_be_read_stays(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    chunk = out / "chunks" / "000001.parquet"
    chunk.unlink()
    chunk.mkdir()  # the system refuses to read it, also for root
    (out / "summary.json").unlink()
    for use in (hs.load_campaign, lambda folder: hs.campaign(FILE, folder)):
        with pytest.raises(hs.ResultError, match=r'000001\.parquet": cannot be read: Is a directory; permit reading'):
            use(out)
    assert chunk.is_dir()
    assert not (out / "damaged").exists()


def test_a_step_of_a_search_that_cannot_be_read_stays(tmp_path: Path) -> None:
    (tmp_path / "steps" / "000000.step").mkdir(parents=True)
    warnings: list[str] = []
    steps: Any = SimpleNamespace(folder=tmp_path, count=0, record={"search": "a"}, warn=warnings.append)
    with pytest.raises(OutputError, match=r'000000\.step": cannot be read: Is a directory; permit reading it'):
        SearchSteps.take(steps, {}, dict)
    assert not warnings


def test_a_worst_case_that_a_user_changed_is_kept(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "out")
    result = hs.load_campaign(tmp_path / "out")
    case = tmp_path / "out" / "worst-case.yaml"
    case.write_text("My notes", encoding="utf-8")
    with pytest.raises(OutputError, match="expected a file as hexservo wrote it, got a different one, which is kept"):
        hs.worst_case(result, runs=10, restarts=1)
    assert case.read_text(encoding="utf-8") == "My notes"
    case.unlink()
    found = hs.worst_case(result, runs=10, restarts=1)
    assert hs.worst_case(result, runs=20, restarts=1).scenario == hs.load_scenario(found.path)


def test_a_page_and_pictures_of_a_user_are_kept(tmp_path: Path) -> None:
    result = hs.campaign(FILE, tmp_path / "out", runs=20)
    page, pictures = result.folder / "report.html", result.folder / "pictures"
    page.write_text("<!doctype html>My notes", encoding="utf-8")
    with pytest.raises(OutputError, match=r'report\.html": expected a file as hexservo wrote it, got a different one'):
        hs.write_campaign_report(result)
    assert page.read_text(encoding="utf-8") == "<!doctype html>My notes"
    page.unlink()
    pictures.mkdir()
    (pictures / "interval-failure-probability.svg").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match="the folder holds files that are not results of hexservo"):
        hs.write_campaign_report(result, pictures=True)
    assert [path.read_text(encoding="utf-8") for path in pictures.iterdir()] == ["mine"]
    shutil.rmtree(pictures)
    hs.write_campaign_report(result, pictures=True)
    (pictures / "interval-failure-probability.svg").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r"interval-failure-probability.svg \(changed since\); move them away"):
        hs.write_campaign_report(result, pictures=True)


def test_a_folder_whose_name_is_no_text_has_a_page(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"out-\xff")
    result = hs.campaign(FILE, folder, runs=10)
    page = hs.write_campaign_report(result).read_text(encoding="utf-8")
    assert r"out-\udcff" in page
    repr(hs.load_campaign(folder)).encode()


# ---- Results --------------------------------------------------------------------------------------------------------


campaign: Any = hs.campaign  # called with arguments of other types


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda result: result.to_dataframe(["nope"]), ValueError, 'columns: expected names of index, .*, got "nope"$'),
        (lambda result: result.to_arrow(["margn"]), ValueError, 'got "margn"; did you mean "margin"?'),
        (
            lambda result: result.to_dataframe("margin"),
            TypeError,
            "columns: expected names of columns, or None, got str",
        ),
        (lambda result: result.to_dataframe([1]), TypeError, "columns: expected names of columns, or None, got int"),
        (lambda result: result.worst(-1), ValueError, "count: expected an integer of at least 0, got -1"),
        (lambda result: result.worst("x"), TypeError, "count: expected an integer, got str"),
        (lambda result: result.scenario(1.5), TypeError, "index: expected an integer, got float"),
        (lambda result: result.scenario(-1), IndexError, "index: expected one from 0 to 999, got -1"),
        (lambda result: campaign(FILE, result.folder, engine=5), TypeError, "engine: expected one of local, .* int"),
        (
            lambda result: campaign(FILE, result.folder, warn=5),
            TypeError,
            "warn: expected a function .*, got int",
        ),
    ],
)
def test_arguments_that_are_refused(whole: Path, call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call(hs.load_campaign(whole))


def test_a_result_keeps_its_runs_when_its_folder_grows(tmp_path: Path) -> None:
    result = hs.campaign(FILE, tmp_path / "out", runs=50)
    margins = result.margin().tolist()
    assert hs.campaign(FILE, tmp_path / "out", runs=60).margin().tolist()[:50] == margins
    assert len(result.to_dataframe()) == len(result) == 50
    assert result.margin().tolist() == margins
    shutil.rmtree(tmp_path / "out")
    hs.campaign(FILE | {"stream": 1}, tmp_path / "out", runs=50)
    with pytest.raises(hs.ResultError, match="expected the campaign of this result, got a different one"):
        result.margin()
