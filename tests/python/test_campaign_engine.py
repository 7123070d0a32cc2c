"""Campaigns on the disk: the table of runs is the same bit for bit, whatever happens while they are computed."""

from __future__ import annotations

import json
import re
import resource
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.campaigns.chunks import unsealed_chunk
from hexservo.campaigns.intervals import anytime_interval, clopper_pearson
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.store import plan_text, read_plan
from hexservo.run.publish import OutputError

RUNS = 1000
FILE: dict[str, Any] = {
    "scenario": hs.load_scenario("composite-30hz").updated({"simulation.duration": 0.2, "metrics.rms_start": 0.1}),
    "vary": {
        "uncertainty.gravity": {"normal": [0.0, 0.1], "clip": [-0.9, 0.9]},
        "target.translation": {"normal": [0.0, 0.003], "each": True},
        "target.rotation": {"normal": [0.0, 0.01], "each": True},
        "seed": "each",
    },
    "require": ["outcome == completed", "peak_leg_excursion <= 0.005", "final_error <= 1.5"],
    "runs": RUNS,
    "chunk_size": 100,
}


def digest_of(folder: Path) -> list[bytes]:
    """The bytes of every column of the final table."""
    table = hs.load_campaign(folder).to_arrow()
    columns = {name: table.column(name) for name in table.column_names}
    outcome = columns.pop("outcome").to_pylist()
    return [
        json.dumps([table.column_names, outcome]).encode(),
        *(column.to_numpy().tobytes() for column in columns.values()),
    ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The campaign, run once from its beginning to its end."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    assert hs.campaign(FILE, folder).complete
    return folder


@pytest.mark.parametrize(("threads", "chunk_size"), [(1, 100), (8, 100), (2, 10_000), (2, 37)])
def test_the_table_does_not_depend_on_threads_and_chunks(
    whole: Path, tmp_path: Path, threads: int, chunk_size: int
) -> None:
    hs.campaign(FILE, tmp_path / "out", threads=threads, chunk_size=chunk_size)
    assert digest_of(tmp_path / "out") == digest_of(whole)
    if chunk_size == 100:
        for chunk in (whole / "chunks").iterdir():
            assert chunk.read_bytes() == (tmp_path / "out" / "chunks" / chunk.name).read_bytes()


def test_the_table_is_that_of_a_batch(whole: Path) -> None:
    plan = load_plan(FILE)
    drawing = plan.drawing()
    drawn = drawing.numbers(0, RUNS)
    scenario = plan.scenario.updated(drawing.base)
    batch = hs.simulate_batch(scenario, drawing.variations(drawn), "metrics").to_dataframe()
    table = hs.load_campaign(whole).to_dataframe()
    places = [f"target.{what}[{axis}]" for what in ("translation", "rotation") for axis in range(3)]
    varied = ["uncertainty.gravity", *places, "seed"]
    assert table.columns.tolist() == ["index", *varied, "outcome", "end_time", *hs.METRICS, "margin"]
    assert (
        table[places].to_numpy().tobytes()
        == np.hstack([drawn["target.translation"], drawn["target.rotation"]]).tobytes()
    )
    assert table["index"].tolist() == list(range(RUNS))
    for name in table.columns.drop([*places, "index", "margin"]):
        assert (table[name].to_numpy() == batch[name].to_numpy())[table[name].notna()].all(), name
    passes = (batch.outcome == "completed") & (batch.peak_leg_excursion <= 0.005) & (batch.final_error <= 1.5)
    assert ((table.margin >= 0).to_numpy() == passes.to_numpy()).all()
    assert 50 < passes.sum() < RUNS - 50, "both kinds of runs are there"


def test_a_result_sums_its_runs_up(whole: Path) -> None:
    result = hs.load_campaign(whole)
    table = result.to_dataframe()
    assert len(result) == RUNS
    assert result.failures == (table.margin < 0).sum()
    assert result.interval == anytime_interval(result.failures, RUNS)
    assert result.summary["clopper_pearson"] == list(clopper_pearson(result.failures, RUNS))
    assert result.summary["outcomes"] == table.outcome.value_counts().sort_index().to_dict()
    failed = [requirement["failures"] for requirement in result.summary["requirements"]]
    early = table.outcome != "completed"
    assert failed == [
        early.sum(),
        (early | (table.peak_leg_excursion > 0.005)).sum(),
        (early | (table.final_error > 1.5)).sum(),
    ]
    assert result.summary["joint_confidence"] == pytest.approx(0.85)
    assert result.margin().tolist() == table.margin.tolist()
    assert result.to_dataframe(["index", "margin"]).columns.tolist() == ["index", "margin"]
    assert str(RUNS) in repr(result)


def test_runs_without_a_value_are_counted_with_the_reason(tmp_path: Path) -> None:
    short = hs.load_scenario("composite-30hz").updated({"metrics.dwell": 0.05, "metrics.rms_start": 0.2})
    file = {
        "scenario": short,
        "vary": {"simulation.duration": {"choice": [0.1, 0.4]}},
        "require": ["settling_time <= 0.3", "rms_error <= 100"],
        "runs": 20,
    }
    result = hs.campaign(file, tmp_path / "out", chunk_size=7)
    table = result.to_dataframe()
    missing = {name: int(table[name].isna().sum()) for name in ("rms_error", "settling_time")}
    assert (table.outcome == "completed").all()
    assert result.summary["without_value"] == missing
    assert [one for one in result.section().sentences if "without a value" in one] == [
        f"{missing['rms_error']} of 20 runs complete without a value of rms_error, since they end before "
        "metrics.rms_start; that counts as a failure.",
        f"{missing['settling_time']} of 20 runs complete without a value of settling_time, since they are not within "
        "metrics.band for metrics.dwell at their end; that counts as a failure.",
    ]


def test_runs_that_never_settle_are_ordered_by_what_else_they_miss(tmp_path: Path) -> None:
    file = {
        "scenario": hs.load_scenario(
            "paper-composite", {"simulation.duration": 0.1, "metrics.rms_start": 0.05, "metrics.dwell": 0.02}
        ),
        "vary": {"uncertainty.gravity": {"uniform": [-0.2, 0.2]}},
        "require": ["settling_time <= 0.05", "final_error <= 0.001"],
        "runs": 20,
    }
    result = hs.campaign(file, tmp_path / "out", chunk_size=7)
    table = result.to_dataframe()
    assert (table.margin == -1.0).all()
    farthest = table.final_error.sort_values(ascending=False).index
    assert [run.index for run in result.worst(10)] == farthest[:10].tolist()
    case = hs.worst_case(result, runs=30, restarts=1)
    assert case.margin == -1.0
    assert hs.metrics(hs.simulate(case.scenario))["final_error"] >= 0.999999 * table.final_error.max()  # to rounding


def test_the_worst_runs_come_as_scenarios(whole: Path) -> None:
    result = hs.load_campaign(whole)
    table = result.to_dataframe()
    worst = result.worst(3)
    assert [run.margin for run in worst] == sorted(table.margin)[:3]
    assert [run.margin for run in result.worst(1000)] == sorted(table.margin)[:10]
    for run in worst:
        row = table.loc[run.index]
        repeated = hs.simulate(run.scenario)
        assert repeated.outcome == row.outcome
        if row.outcome == "completed":  # a single run agrees with a lane to rounding (docs/batch.md)
            assert hs.metrics(repeated)["peak_leg_excursion"] == pytest.approx(row.peak_leg_excursion, rel=1e-6)
    assert hs.Scenario.from_yaml((whole / "worst-run.yaml").read_text(encoding="utf-8")) == worst[0].scenario
    with pytest.raises(IndexError, match="expected one from 0 to 999, got 1000"):
        result.scenario(RUNS)


def test_a_run_too_long_for_a_log_has_a_scenario_that_runs(tmp_path: Path) -> None:
    """With more steps per sample; the runs of the campaign end at once, since the law diverges."""
    diverging = hs.load_scenario("paper", {"controller.jacobian": "printed"})
    file = {
        "scenario": diverging,
        "vary": {"simulation.duration": {"choice": [0.5, 20000.0]}},
        "require": ["final_error <= 1"],
        "runs": 8,
        "stream": 1,
    }
    for stream in range(2, 12):  # of some, run 0 is the long one
        CampaignPlan(**{**file, "stream": stream})
    result = hs.campaign(file, tmp_path / "out")
    scenarios = [result.scenario(index) for index in range(len(result))]
    logs = {scenario.simulation.duration: scenario.simulation.log_every for scenario in scenarios}
    assert logs == {0.5: 1, 20000.0: 4}
    assert {one.scenario.simulation.duration for one in result.worst()} == {0.5, 20000.0}


def test_a_command_repeats_a_run_of_a_packaged_scenario(tmp_path: Path) -> None:
    vary = {
        "uncertainty.gravity": {"uniform": [-0.1, 0.1]},
        "uncertainty.depth": {"uniform": [-0.3, 0.3], "each": True},
    }
    file = {"scenario": "paper", "vary": vary, "require": ["outcome == completed"], "runs": 2}
    result = hs.campaign(file, tmp_path / "out")
    command = result.command(1)
    assert command.startswith("hexservo run paper --set 'uncertainty.gravity=")
    text = f"import shlex; print(shlex.split({command!r})[1:])"
    arguments = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True).stdout
    from hexservo.cli.terminal import load

    words = [word for word in eval(arguments) if word != "--set"]
    assert load(words[1], words[2:]) == result.scenario(1)
    changed = hs.campaign(file, tmp_path / "changed", changes={"simulation.duration": 1.0})
    assert changed.command(1) == "hexservo run run.yaml"


def test_settings_are_read_before_the_goal_pose(tmp_path: Path) -> None:
    """And a run whose camera varies, under the goal image of the other camera, is no change of the packaged file."""
    vary = {"camera.focal_pixels": {"uniform": [1600.0, 1700.0]}}
    file = {"scenario": "pi-h824", "vary": vary, "require": ["outcome == completed"], "runs": 2}
    changes = {"camera.focal_pixels": 900, "simulation.duration": 0.1}
    assert load_plan(file, changes).scenario == hs.load_scenario("pi-h824", changes)
    with pytest.raises(hs.ScenarioError, match=r"camera.focal_pixels: has no effect, since vary has the key too"):
        load_plan({**file, "scenario": hs.load_scenario("pi-h824")}, changes)  # whose goal image has been made
    result = hs.campaign(file, tmp_path / "out")
    assert result.command(1) == "hexservo run run.yaml"


# ---- Interruptions --------------------------------------------------------------------------------------------------

# A process that has computed nothing, so that it may fork, starts the campaign again and again and kills it.
KILLER = """
    import json, os, random, signal, sys, time
    from pathlib import Path
    import pyarrow.parquet
    import hexservo as hs
    from hexservo.campaigns.plan import load_plan
    file, out, seed, kills = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    random, killed, died = random.Random(seed), 0, 0
    plan = load_plan(file)
    hs.campaign, hs.simulate_batch

    def dies(count):  # in the child: at the count-th step of writing
        calls = [count]
        def step(function):
            def stepped(*arguments, **named):
                calls[0] -= 1
                if calls[0] == 0:
                    os.kill(os.getpid(), signal.SIGKILL)
                return function(*arguments, **named)
            return stepped
        os.fsync, os.rename, os.replace = step(os.fsync), step(os.rename), step(os.replace)
        Path.replace, Path.unlink, Path.mkdir = step(Path.replace), step(Path.unlink), step(Path.mkdir)

    while True:
        child = os.fork()
        if child == 0:
            if killed % 2:
                dies(1 + killed // 2)
            hs.campaign(plan, out)
            os._exit(0)
        if killed >= kills:
            _, status = os.waitpid(child, 0)
            break
        if killed % 2 == 0:
            time.sleep(random.uniform(0.0, 0.12))
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        killed += 1
        died += os.WIFSIGNALED(status)
    print(died, os.waitstatus_to_exitcode(status))
"""


@pytest.mark.parametrize("kills", [12, pytest.param(100, marks=pytest.mark.slow)])
def test_the_table_is_the_same_after_kills_at_random_moments(whole: Path, tmp_path: Path, kills: int) -> None:
    seed = 20261122
    file = tmp_path / "campaign.yaml"
    file.write_text(load_plan(FILE).to_yaml(), encoding="utf-8")
    arguments = [str(file), str(tmp_path / "out"), str(seed), str(kills)]
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(KILLER), *arguments], capture_output=True, text=True, check=False
    )
    died, code = map(int, run.stdout.split())
    print(f"seed {seed}: {died} of {kills} processes were killed before their end")
    assert code == 0, run.stderr
    assert died > kills / 4
    assert digest_of(tmp_path / "out") == digest_of(whole)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(path.name for path in whole.iterdir())
    assert len(list((tmp_path / "out" / "chunks").iterdir())) == RUNS // 100


def test_ctrl_c_loses_nothing(whole: Path, tmp_path: Path) -> None:
    def interrupt(done: int, count: int) -> None:
        assert count == RUNS
        if done >= 300:
            signal.raise_signal(signal.SIGINT)

    result = hs.campaign(FILE, tmp_path / "out", progress=interrupt)
    assert result.interrupted
    assert not result.complete
    assert 200 <= len(result) < RUNS, "what was kept, without the chunk that was being computed"
    assert result.section().sentences[-1] == f"The campaign is not complete: {len(result)} of {RUNS} runs are kept."
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "chunks").iterdir()}
    seen: list[int] = []
    again = hs.campaign(FILE, tmp_path / "out", progress=lambda done, count: seen.append(done))
    assert again.complete
    assert not again.interrupted
    assert min(seen) >= len(result), "what is there is not computed again"
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert digest_of(tmp_path / "out") == digest_of(whole)


def test_a_full_disk_keeps_what_is_whole(whole: Path, tmp_path: Path) -> None:
    hs.campaign(FILE, tmp_path / "out", runs=300)
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, most))  # a chunk has more bytes
    try:
        with pytest.raises(
            OutputError, match=r'000003.parquet": cannot be written: File too large; what is whole stays'
        ):
            hs.campaign(FILE, tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    assert len(hs.load_campaign(tmp_path / "out")) == 300
    assert [path.name for path in sorted((tmp_path / "out" / "chunks").iterdir())] == [
        f"00000{i}.parquet" for i in range(3)
    ]
    hs.campaign(FILE, tmp_path / "out")
    assert digest_of(tmp_path / "out") == digest_of(whole)


# ---- Damage ---------------------------------------------------------------------------------------------------------


def test_every_changed_byte_of_a_chunk_is_found(tmp_path: Path) -> None:
    hs.campaign(FILE, tmp_path / "out", runs=5)
    content = (tmp_path / "out" / "chunks" / "000000.parquet").read_bytes()
    unsealed_chunk(content)
    random = np.random.default_rng(3)
    for place in range(len(content)):
        changed = bytearray(content)
        changed[place] ^= 1 << int(random.integers(8))
        with pytest.raises(hs.ResultError):
            unsealed_chunk(bytes(changed))
    for length in random.integers(0, len(content), 200):
        with pytest.raises(hs.ResultError):
            unsealed_chunk(content[:length])


def test_damaged_chunks_are_computed_again(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    chunks = out / "chunks"
    content = (chunks / "000002.parquet").read_bytes()
    (chunks / "000002.parquet").write_bytes(content[:-100])
    (chunks / "000004.parquet").write_bytes(content)  # other runs than those of its name
    (chunks / "000007.parquet").write_bytes(b"")
    (chunks / "000008.parquet").unlink()
    (out / "summary.json").unlink()
    assert len(hs.load_campaign(out)) == 200, "up to the first gap"
    warnings: list[str] = []
    assert hs.campaign(FILE, out, warn=warnings.append).complete
    assert len(warnings) == 3
    assert '000002.parquet": expected a chunk as hexservo wrote it' in warnings[0]
    assert "expected the runs 400 to 499, got 200 to 299; it is now " in warnings[1]
    assert sorted(path.name for path in (out / "damaged").iterdir()) == [f"00000{i}.parquet" for i in (2, 4, 7)]
    (chunks / "000002.parquet").write_bytes(b"again")
    hs.campaign(FILE, out, warn=warnings.append)
    assert "000002-1.parquet" in warnings[3]
    assert (out / "damaged" / "000002.parquet").read_bytes() == content[:-100], "an earlier copy stays"
    assert (out / "damaged" / "000002-1.parquet").read_bytes() == b"again"
    assert digest_of(out) == digest_of(whole)


def test_a_chunk_of_a_different_campaign_is_refused(whole: Path, tmp_path: Path) -> None:
    hs.campaign(FILE | {"stream": 1}, tmp_path / "other", runs=100)
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    shutil.copy(tmp_path / "other" / "chunks" / "000000.parquet", out / "chunks" / "000003.parquet")
    with pytest.raises(
        OutputError, match=r'000003.parquet": expected a chunk of this campaign, got one of a different'
    ):
        hs.campaign(FILE, out)


def test_a_lost_summary_and_a_changed_one_are_not_needed(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    expected = hs.load_campaign(whole).summary
    written = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    without = {key: value for key, value in written.items() if key != "worst"}
    for text in ("", "{}", "[]", '{"campaign": 3}', json.dumps(written | {"failures": 0}), json.dumps(without), None):
        (out / "summary.json").unlink() if text is None else (out / "summary.json").write_text(text, encoding="utf-8")
        assert hs.load_campaign(out).summary == expected


# ---- How many runs --------------------------------------------------------------------------------------------------


def test_a_campaign_may_grow(whole: Path, tmp_path: Path) -> None:
    first = hs.campaign(FILE, tmp_path / "out", runs=250)
    assert (len(first), first.complete) == (250, True)
    assert first.summary["clopper_pearson"] is not None
    later = hs.campaign(FILE, tmp_path / "out")
    assert digest_of(tmp_path / "out") == digest_of(whole)
    assert later.summary["clopper_pearson"] is None, "its number of runs was not fixed beforehand"
    again = hs.campaign(FILE, tmp_path / "out")
    assert again.summary == later.summary


@pytest.mark.parametrize(
    ("until", "runs"),
    [
        ({"probability_below": 0.9}, None),
        ({"probability_below": 0.01}, None),
        ({"width_below": 0.2}, None),
        ({"width_below": 0.01}, 300),
    ],
)
def test_the_interval_ends_a_campaign(whole: Path, tmp_path: Path, until: dict[str, float], runs: int | None) -> None:
    """After the first chunk at whose end the interval decides, or after all runs, whatever was computed ahead."""
    file = {key: value for key, value in FILE.items() if key != "runs"} | {"until": until, "chunk_size": 20}
    fails = hs.load_campaign(whole).margin() < 0
    expected = next(
        n
        for n in range(20, RUNS + 1, 20)
        for low, high in [anytime_interval(int(fails[:n].sum()), n)]
        if n == runs
        or (
            high - low <= until["width_below"]
            if "width_below" in until
            else high <= until["probability_below"] or low > until["probability_below"]
        )
    )
    result = hs.campaign(file, tmp_path / "out", runs=runs)
    assert len(result) == expected
    assert result.complete
    assert result.summary["clopper_pearson"] is None
    assert len(list((tmp_path / "out" / "chunks").iterdir())) == expected // 20
    assert digest_of(tmp_path / "out")[1] == digest_of(whole)[1][: 8 * expected]
    assert hs.campaign(file, tmp_path / "out", runs=runs).summary == result.summary


def test_a_goal_that_is_reached_earlier_removes_no_runs(tmp_path: Path) -> None:
    first = hs.campaign(FILE, tmp_path / "out", runs=400)
    goal = hs.campaign({**FILE, "runs": None, "until": {"probability_below": 0.9}}, tmp_path / "out")
    assert len(goal) == 100
    assert hs.load_campaign(tmp_path / "out").summary == goal.summary
    (tmp_path / "out" / "summary.json").unlink()
    assert hs.load_campaign(tmp_path / "out").summary == goal.summary
    assert len(list((tmp_path / "out" / "chunks").iterdir())) == 4
    again = hs.campaign(FILE, tmp_path / "out", runs=400)
    assert again.failures == first.failures


def test_a_summary_of_fewer_runs_is_not_that_of_the_campaign(tmp_path: Path) -> None:
    """A campaign of 250 runs goes on to 1000, and its process ends before it writes anything."""
    folder = tmp_path / "out"
    hs.campaign(FILE, folder, runs=250)
    plan, record = read_plan(folder)
    (folder / "campaign.yaml").write_text(plan_text(plan.changed(runs=1000), record), encoding="utf-8")
    found = hs.load_campaign(folder)
    assert not found.complete
    assert len(found) == 200  # the last chunk had half of its runs
    assert len(found.to_dataframe()) == 200


def test_no_kept_run_is_overwritten_by_fewer(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    hs.campaign(FILE, folder, runs=400)
    hs.campaign({**FILE, "runs": None, "until": {"probability_below": 0.9}}, folder)
    kept = {path.name: path.read_bytes() for path in (folder / "chunks").iterdir()}
    with pytest.raises(OutputError, match="expected at least the 400 runs that it has, got 350; name a new folder"):
        hs.campaign(FILE, folder, runs=350)
    assert {path.name: path.read_bytes() for path in (folder / "chunks").iterdir()} == kept


def test_a_run_that_is_no_scenario_is_named(tmp_path: Path) -> None:
    file = {
        "scenario": "composite-30hz",
        "vary": {"camera.latency": {"choice": [0.01] * 30 + [0.0105]}},
        "require": ["outcome == completed"],
        "runs": 1000,
    }
    first = int(np.argmax(load_plan(file).drawing().numbers(0, 1000)["camera.latency"] == 0.0105))
    summary = hs.campaign(file, tmp_path / "out").summary
    assert re.fullmatch(rf"run {first}: camera.latency: .*; narrow or clip what varies", summary["refusal"])
    assert summary["refused"] == np.sum(load_plan(file).drawing().numbers(0, 1000)["camera.latency"] == 0.0105)


@pytest.mark.slow
def test_ctrl_c_at_any_moment_leaves_a_summary_of_what_is_kept(tmp_path: Path) -> None:
    """Each call of the progress function is a different moment."""
    for moment in range(1, 40, 4):
        calls = [0]

        def interrupt(done: int, count: int, calls: list[int] = calls, moment: int = moment) -> None:
            calls[0] += 1
            if calls[0] == moment:
                signal.raise_signal(signal.SIGINT)

        result = hs.campaign(FILE, tmp_path / str(moment), chunk_size=20, progress=interrupt)
        assert result.interrupted != result.complete
        assert hs.load_campaign(tmp_path / str(moment)).summary == result.summary
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
