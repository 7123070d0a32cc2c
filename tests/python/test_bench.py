"""The benchmarks run, their answers are checked, and ratios hold that no noise can break. No absolute times."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli.bench import spell
from hexservo.cli.commands import app
from hexservo.run import bench as module
from hexservo.run.variant import available_variants, load_kernel
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters

ROOT = Path(__file__).resolve().parents[2]
# Fewer and shorter runs than `--quick` alone has, and in a separate process, since --realtime is of a whole one.
COMMAND = """
from dataclasses import replace
from hexservo.cli.commands import main
from hexservo.run import bench
bench.QUICK = replace(bench.QUICK, rounds=2, duration=0.5, scenarios=16)
main()
"""
SHORT = ["--quick", "--ticks", "5000", "--seconds", "0.02"]
FILES = {"bench.json", "bench.png", "bench.svg", ".hexservo-output"}

# A batch on one thread is at least this many times faster than one run of the plain baseline loop, per scenario and in
# processor time. BENCHMARKS.md, "Ratios that are asserted", explains why it is not more with AVX-512.
# Measured: 2.6 to 3.3, 2.6 to 4.0 and 1.04 to 1.21. Points, axes and legs of the plain loop lie side by side in
# the same registers as the two lanes of a baseline pack, which therefore gains next to nothing.
BATCH_RATIOS = {"avx2": 2.0, "avx512": 2.0, "baseline": 0.87}


def bench(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["bench", *arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a short run writes."""
    parent = tmp_path_factory.mktemp("bench")
    command = [sys.executable, "-c", COMMAND, "bench", *SHORT, "--realtime", "--out", "out"]
    run = subprocess.run(command, cwd=parent, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "servo tick of hybrid: SCHED_FIFO" in run.stdout
    assert "servo tick of each law, free-running" in run.stdout
    assert all(re.search(rf"^{law} +{1000 if law != 'hybrid' else 5000} ", run.stdout, re.MULTILINE) for law in LAWS)
    assert "share of the peak by a count of 10000 operations a step" in run.stdout
    return parent / "out"


@pytest.fixture(scope="module")
def document(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "bench.json").read_text(encoding="utf-8"))
    return content


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    spec = importlib.util.spec_from_file_location("tables", ROOT / "benchmarks" / "tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# ---- The command ----------------------------------------------------------------------------------------------------


def test_it_writes_all_files_and_keeps_earlier_ones(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES
    assert all(path.stat().st_size > 0 for path in folder.iterdir())
    before = (folder / "bench.json").read_bytes()
    started = time.monotonic()
    again = bench("--out", str(folder))  # refused before anything is measured
    assert again.exit_code == 2
    assert "holds results already" in again.stderr
    assert time.monotonic() - started < 60.0
    assert (folder / "bench.json").read_bytes() == before


def test_the_json_says_what_was_measured_on_what(document: dict[str, Any]) -> None:
    machine = document["machine"]
    assert machine["cpu"]
    assert machine["core"]["compiler"] == _core.build_info()["compiler"]
    assert set(document["variants"]) == set(available_variants())
    assert all("-O3" in variant["flags"] for variant in document["variants"].values())
    paced = [("hybrid", rate) for rate in (1000.0, 2000.0, 4000.0, 10000.0)]
    others = [(law, None) for law in LAWS if law != "hybrid"]
    assert [(tick["law"], tick["rate"]) for tick in document["ticks"]] == [("hybrid", None), *paced, *others]
    for tick in document["ticks"]:
        for times in filter(None, (tick["latency"], tick["lateness"])):
            assert 0 < times["median"] <= times["percentile_99"] <= times["percentile_99_9"] <= times["maximum"]
            assert sum(times["counts"]) == tick["ticks"]
            assert len(times["edges"]) == len(times["counts"]) + 1
            assert times["edges"][0] <= times["median"]
        assert tick["ticks"] <= tick["periods"]
        assert tick["missed"] >= tick["periods"] - tick["ticks"]
    speeds = {(speed["work"], speed["variant"], speed["threads"]): speed for speed in document["speeds"]}
    processors = machine["processors"]
    assert set(speeds) == {
        (work, variant, threads)
        for variant in available_variants()
        for work, threads in (("single", 1), ("batch", 1), ("batch", processors))
    }
    for speed in speeds.values():
        assert 0.0 < speed["share"] < 1.0  # more than the peak would mean that a step is counted wrongly
        # 1 ms of simulated time; one thread cannot use more processor time than passes.
        assert speed["real_time"] == pytest.approx(1e-3 / speed["wall"])
        assert speed["processor"] <= 1.05 * speed["wall"] * speed["threads"]
    for variant in available_variants():  # of a step of one scenario, whatever a run and a batch have of them
        single, batch = (speeds[work, variant, 1]["processor"] for work in ("single", "batch"))
        assert 0.3 < single / batch < 100.0


def test_ctrl_c_ends_it_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = module._time_ticks

    def interrupted(*arguments: Any) -> module.TickTiming:
        threading.Timer(0.2, os.kill, [os.getpid(), signal.SIGINT]).start()
        return ticks(*arguments)

    monkeypatch.setattr(module, "_time_ticks", interrupted)
    ended = bench("--ticks", "100000000", "--out", str(tmp_path / "out"))
    assert ended.exit_code == 130, ended.stderr
    assert "Interrupted" in ended.stderr
    assert not any(tmp_path.iterdir())


def test_a_full_disk_leaves_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hexservo.run.bench.benchmark", lambda *_: None)
    monkeypatch.setattr("hexservo.cli.bench.report", lambda _: ["the table"])
    monkeypatch.setattr("hexservo.cli.bench.write_benchmark", write)
    found = CliRunner().invoke(app, ["bench", "--out", str(tmp_path / "out")])
    assert (found.exit_code, found.stdout) == (2, "the table\n")
    assert len(found.stderr.splitlines()) == 1
    assert "No space left on device" in found.stderr
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["--ticks", "10"], ["--seconds", "0"], ["--seconds", "nan"]])
def test_numbers_out_of_range_are_refused(arguments: list[str]) -> None:
    assert bench(*arguments).exit_code == 2


# ---- Ticks ----------------------------------------------------------------------------------------------------------


def test_ticks_repeat_the_run_that_they_replay(paper: hs.Scenario) -> None:
    short = module._parameters(paper.updated({"simulation.duration": 0.25}))
    times = _core.time_ticks(short, 2600)
    assert len(times.latency) == times.periods == 2600
    assert len(times.lateness) == 0
    assert times.missed == times.invalid == 0
    assert times.reproduced
    # Zero weights at the start make the first ticks alike; then forward Euler and Runge-Kutta differ, but by little.
    assert 0.0 < times.wrench_difference < 5e-4
    assert times.latency.min() > 0


def test_quantiles_of_times_are_times_that_were_measured() -> None:
    """Of 1 to 1000 ns: one that 10 of 1000 exceed, and one that one does."""
    found = module._distribution(np.random.default_rng(1).permutation(np.arange(1, 1001, dtype=np.uint32)))
    quantiles = (found.median, found.percentile_99, found.percentile_99_9, found.maximum)
    np.testing.assert_allclose(quantiles, 1e-9 * np.array([501.0, 991.0, 1000.0, 1000.0]))
    assert sum(found.counts) == 1000
    assert len(found.edges) == len(found.counts) + 1


@pytest.mark.parametrize("law", LAWS)
def test_every_law_repeats_its_run(paper: hs.Scenario, law: str) -> None:
    timing = module._time_ticks(module._replayed(paper, law), None, module.Plan(ticks=5000))  # wrong answers raise
    assert (timing.law, timing.rate, timing.lateness) == (law, None, None)
    assert timing.ticks == timing.periods == (5000 if law == "hybrid" else 1000)
    half = module._replayed(paper, law).updated({"simulation.step": 0.5e-3})
    finer = _core.time_ticks(core_parameters(half), 10).wrench_difference
    if law in ("hybrid", "composite"):  # forward Euler: of first order in the period
        assert timing.wrench_difference / finer == pytest.approx(2.0, rel=0.05)
    else:
        assert max(timing.wrench_difference, finer) < 1e-9


def test_a_tick_that_differs_from_its_run_is_not_timed(paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_tick_tolerance", lambda law: 1e-6)
    with pytest.raises(module.BenchmarkError, match="ticks of hybrid at 2000 Hz: expected the run's wrenches to 1e-06"):
        module._time_ticks(paper, 2000.0, module.Plan(seconds=0.01))


def test_a_clock_that_is_too_fast_is_missed(paper: hs.Scenario) -> None:
    times = _core.time_ticks(module._parameters(paper), 20_000, 1e6)
    assert len(times.latency) == len(times.lateness) <= times.periods == 20_000
    assert times.missed >= times.periods - len(times.latency)
    assert times.missed > 0


def test_a_pace_takes_the_time_that_it_should(paper: hs.Scenario) -> None:
    started = time.monotonic()
    times = _core.time_ticks(module._parameters(paper), 100, 500.0)
    assert time.monotonic() - started >= 99 / 500.0
    assert times.periods == 100


@pytest.mark.parametrize(
    ("periods", "rate", "expected"),
    [
        (0, 0.0, "ticks: expected a whole number from 1 to"),
        (10**9, 0.0, "ticks: expected a whole number from 1 to"),
        (1, -1.0, "rate: expected 0 or a rate of up to"),
        (1, float("nan"), "rate: expected 0 or a rate of up to"),
        (1, 1e7, "rate: expected 0 or a rate of up to"),
    ],
)
def test_ticks_out_of_range_are_refused(paper: hs.Scenario, periods: int, rate: float, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        _core.time_ticks(module._parameters(paper), periods, rate)


def test_a_run_that_stops_cannot_be_replayed(paper: hs.Scenario) -> None:
    diverging = module._parameters(paper.updated({"controller.jacobian": "printed"}))
    with pytest.raises(ValueError, match="scenario: expected a run that goes to its end"):
        _core.time_ticks(diverging, 10)


# ---- Answers --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", available_variants())
def test_a_wrong_answer_is_not_timed(paper: hs.Scenario, variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module._check_answers(paper, load_kernel(variant))
    with pytest.raises(module.BenchmarkError, match=r"_time of paper|_error of paper"):
        module._check_answers(paper.updated({"uncertainty.gravity": 0.01}), load_kernel(variant))
    monkeypatch.setattr(module, "_LANE_TOLERANCE", -1.0)
    with pytest.raises(module.BenchmarkError, match="of a batch"):
        module._check_answers(paper, load_kernel(variant))


def test_a_histogram_has_every_tick() -> None:
    times = np.array([1, 50, 99, 450, 450, 460, 10_000, 2**32 - 1], dtype=np.uint32)
    distribution = module._distribution(times)
    assert sum(distribution.counts) == len(times)
    assert distribution.maximum == pytest.approx((2**32 - 1) * 1e-9)
    assert distribution.median == pytest.approx(450e-9)


# ---- Ratios ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_batch_outruns_the_plain_loop(paper: hs.Scenario) -> None:
    kernels = {name: load_kernel(name) for name in available_variants()}
    plan = module.Plan(rounds=11, duration=0.5, scenarios=32)
    best = dict.fromkeys(kernels, 0.0)
    for _ in range(3):  # a neighbour on the machine may spoil one measurement, and hardly three
        _, ratios = module._time_runs(paper, kernels, plan, lambda text: None)
        found = {ratio.name: ratio.value for ratio in ratios}
        for name in kernels:
            best[name] = max(best[name], found[f"one run (baseline) to a batch on one thread ({name})"])
        if all(best[name] >= BATCH_RATIOS[name] for name in kernels):
            break
    for name, value in best.items():
        assert value >= BATCH_RATIOS[name], f"{name}: expected at least {BATCH_RATIOS[name]}, got {value:.2f}"


@pytest.mark.slow
def test_metrics_that_nobody_asked_for_take_no_time(paper: hs.Scenario) -> None:
    varied = {"uncertainty.depth": np.linspace(-0.3, 0.3, 64)}  # whole packs: seconds of the core, not of Python
    times: dict[bool, list[float]] = {True: [], False: []}
    ratio = np.inf
    for number in range(30):  # a neighbour on the machine may spoil many rounds, and hardly all
        for asked in times:
            begin = time.process_time()
            hs.simulate_batch(paper, varied, "metrics", threads=1, metrics="all" if asked else [])
            times[asked].append(time.process_time() - begin)
        ratio = min(times[False]) / min(times[True])
        if number >= 3 and ratio < 0.98:
            return
    pytest.fail(f"expected less than 0.98, got {ratio:.3f}")  # 0.87 measured with AVX-512 and with AVX2


@pytest.mark.slow
def test_one_run_outruns_numpy(tmp_path: Path) -> None:
    program = [sys.executable, str(ROOT / "benchmarks" / "peers" / "run.py"), "--quick"]
    run = subprocess.run(
        [*program, "--json", str(tmp_path / "peers.json")], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert run.returncode == 0, run.stdout + run.stderr  # it fails below 100 x
    (row,) = json.loads((tmp_path / "peers.json").read_text(encoding="utf-8"))["rows"]
    assert row["status"] == "measured"
    assert row["comparison"]["ratio"] >= 100.0


@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
def test_the_project_of_the_kernel_programs_configures(tmp_path: Path) -> None:
    """Beside the core, whose targets it must not repeat; the build of the C++ tests compiles its own program."""
    command = ["cmake", "-S", str(ROOT / "benchmarks" / "peers"), "-B", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_kernel_program_that_does_not_compile_is_a_failure(tmp_path: Path) -> None:
    """The other rows are measured nevertheless; a library that is not there is no failure."""
    program = """
import sys
import kernels, run
from rows import Row
from timing import Comparison
file, state = sys.argv[1:]
def build():
    if state == "broken":
        raise kernels.MissingError("cmake --build failed:\\nkernels.cpp:1: error")
kernels.build = build
row = Row("a run", "run", "NumPy", "", "", comparison=Comparison(1.0, 0.001, 1000.0, (999.0, 1001.0), None, None, 2))
run.single_rows, run.batch_rows, run.part_rows = (lambda rounds: [row]), (lambda rounds: []), (lambda rounds: [])
sys.argv = ["run.py", "--json", file]
sys.exit(run.main())
"""
    folder = str(ROOT / "benchmarks" / "peers")
    for state, code in (("whole", 0), ("broken", 1)):
        command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {folder!r})\n{program}"]
        found = subprocess.run(
            [*command, str(tmp_path / "peers.json"), state], capture_output=True, text=True, check=False
        )
        assert found.returncode == code, found.stderr
        last = "kernel programs: cmake --build failed: (see the start of the output)\n"
        assert found.stderr.endswith(last) == (state == "broken")
        assert ("kernels.cpp:1: error" in found.stderr) == (state == "broken")
        assert len(json.loads((tmp_path / "peers.json").read_text(encoding="utf-8"))["rows"]) == 1


def test_a_campaign_is_timed_if_every_metric_is_that_of_the_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    campaign = importlib.import_module("campaign")
    campaign.against_a_batch("campaign-paper", 8, 1)
    simulate = hs.simulate_batch

    def other(*arguments: Any, **options: Any) -> hs.BatchResult:
        batch = simulate(*arguments, **options)
        chatter = batch.metrics["chatter"].copy()
        chatter[5] = np.nextafter(chatter[5], np.inf)
        return dataclasses.replace(batch, metrics={**batch.metrics, "chatter": chatter})

    monkeypatch.setattr(hs, "simulate_batch", other)
    with pytest.raises(SystemExit, match="chatter: expected that of simulate_batch, bit for bit"):
        campaign.against_a_batch("campaign-paper", 8, 1)


def test_the_memory_of_a_campaign_is_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    monkeypatch.setattr(sys, "argv", ["campaign.py", "campaign-paper", "--runs", "64", "--memory"])
    importlib.import_module("campaign").main()
    printed = capsys.readouterr().out
    assert "campaign-paper, ten steps each: 64 runs in " in printed
    assert float(printed.split("at most ")[1].split(" MB")[0]) > 10.0


# ---- Tables ---------------------------------------------------------------------------------------------------------


def test_the_tables_hold_what_was_measured(tables: ModuleType, document: dict[str, Any], tmp_path: Path) -> None:
    kernels = {
        "benchmarks": [
            {
                "family_index": 2,
                "aggregate_name": "median",
                "run_name": "dynamics<double>",
                "name": "",
                "cpu_time": 40.0,
            },
            {
                "family_index": 1,
                "aggregate_name": "median",
                "run_name": "dynamics<Lanes<2>>",
                "name": "",
                "cpu_time": 60.0,
            },
            {"family_index": 0, "aggregate_name": "median", "run_name": "servo_tick", "name": "", "cpu_time": 400.0},
        ]
    }
    text = tables.benchmarks_block(document, kernels)
    assert "| dynamics | 40.0 ns | 30.0 ns |" in text
    assert "| servo tick | 400 ns | – |" in text
    for speed in document["speeds"]:
        assert f"| {speed['variant']} | {speed['threads']} | {spell(speed['wall'])} |" in text
    for tick in document["ticks"]:
        median = spell(tick["latency"]["median"])
        if tick["rate"] is None:
            assert f"| `{tick['law']}` | {tick['ticks']} | {median} |" in text
        else:
            assert f"| {tick['rate'] / 1e3:g} kHz | {tick['ticks']} | latency | {median} |" in text
    assert "not measured" in tables.benchmarks_block(document, None)
    assert spell(document["ticks"][0]["latency"]["median"]) in tables.readme_sentence(document)

    page = tmp_path / "page.md"
    page.write_text("a <!-- x:begin -->old<!-- x:end --> b", encoding="utf-8")
    tables.replace_block(page, "x", "new")
    assert page.read_text(encoding="utf-8") == "a <!-- x:begin -->new<!-- x:end --> b"
    with pytest.raises(ValueError, match="expected one <!-- y:begin -->"):
        tables.replace_block(page, "y", "new")


@pytest.mark.parametrize(
    ("page", "name"), [("BENCHMARKS.md", "bench"), ("BENCHMARKS.md", "step"), ("README.md", "speed")]
)
def test_the_pages_have_their_markers(page: str, name: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    assert text.count(f"<!-- {name}:begin -->") == text.count(f"<!-- {name}:end -->") == 1


def test_the_cost_of_a_step_goes_to_the_innermost_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    step_cost = importlib.import_module("step_cost")
    header = "x/cpp/include/hexservo"
    of = {
        "fuzzy systems": [
            f"operator*\n{header}/lanes.hpp",
            f"fire\n{header}/fuzzy.hpp",
            f"evaluate\n{header}/laws/hybrid.hpp",
        ],
        "weights, end of a step": [
            f"operator*\n{header}/lanes.hpp",
            f"hexservo::detail::advance_rows<0>()\n{header}/fuzzy.hpp",
        ],
        "legs": [f"solve\n{header}/cholesky.hpp", f"accept\n{header}/loop_record.hpp"],
        "law": [f"evaluate\n{header}/laws/kelly.hpp"],
        "other": [f"operator+\n{header}/lanes.hpp"],
    }
    for part, frames in of.items():
        assert step_cost._part(frames) == part

    module = tmp_path / "kernel.so"
    out = tmp_path / "callgrind.out"
    out.write_text(
        "events: Ir Dr Dw I1mr D1mr D1mw\n"
        f"ob=(1) {module}\nfn=(1) run\n0x10 5 4 3 1 0 2\n+4 * 7\n* * 1 1\n"
        "cob=(2) other.so\ncfn=(2) sqrt\ncalls=2 0x90\n+8 5 99 99 99\n"
        "ob=(2)\nfn=(2)\n0x90 1 50\n",
        encoding="utf-8",
    )
    counts = dict(step_cost._callgrind_lines(out, module))
    assert counts == {0x10: [4, 3, 1, 2], 0x14: [8, 1, 0, 0]}
    with pytest.raises(ValueError, match="expected counts of"):
        dict(step_cost._callgrind_lines(out, tmp_path / "another.so"))

    cost = step_cost.Cost(step_cost.Counter(arithmetic=3200, moves=800), 1600, 400, 0, 30)
    lines = step_cost.lines_of({"legs": cost}, 2)
    assert lines[-1] == "| **all** | 5 | 4 | 0 | 1 | 0 | 2 | 0 | 0 | 100% |"


def test_comparisons_are_arithmetic_of_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mnemonics as objdump prints them, all of them from the modules."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    step_cost = importlib.import_module("step_cost")
    expected = {
        "arithmetic": "vcmpltpd vcmpneqpd vcmpnltsd vcmpgt_oqpd vcomisd vucomisd vmaxpd vminsd vaddpd vsubsd vmulpd "
        "vhaddpd vfmadd231pd vfnmadd132sd vfmsub213pd vfnmsub231pd vfmaddsub132pd vfmsubadd132pd",
        "divisions": "vdivpd vdivsd vsqrtpd vsqrtsd",
        "moves": "vmovapd vmovsd mov movq vbroadcastsd vpermpd vperm2f128 vunpckhpd vinsertf128 vextractf128 vshufpd "
        "vblendvpd",
        "others": "vandpd vxorpd vpcmpeqq cmp cmpq cmove lea",
    }
    for kind, mnemonics in expected.items():
        for mnemonic in mnemonics.split():
            assert step_cost.kind_of(mnemonic) == kind, mnemonic


def test_times_are_spelled_with_their_unit() -> None:
    spelled = [spell(time) for time in (2e-8, 4.412e-7, 1.234e-6, 1.5e-5, 2.65e-3, 1.2)]
    assert spelled == ["20.0 ns", "441 ns", "1.23 µs", "15.0 µs", "2.65 ms", "1.2 s"]
