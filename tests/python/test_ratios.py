"""`make bench-ratios`: the bare loop gives the core's answer, ratios are formed as stated, and those reached hold."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import hexservo as hs
from hexservo.run.bench import BenchmarkError
from hexservo.run.variant import load_kernel

ROOT = Path(__file__).resolve().parents[2]

SLACK = 1.25  # for other machines, and for neighbours


@pytest.fixture
def ratios(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("ratios")


def test_a_bare_loop_with_another_answer_is_not_timed(
    ratios: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = load_kernel("baseline")  # every machine has it
    bare = ratios.BareLoop(kernel, tmp_path)
    ratios.check_answer(bare, kernel, 0.1)
    numbers = ratios._numbers

    def heavier(problem: Any) -> Any:
        changed = numbers(problem)
        changed[-4] *= 1.0 - 1e-6  # 1/mass
        return changed

    monkeypatch.setattr(ratios, "_numbers", heavier)
    with pytest.raises(BenchmarkError, match=r"bare loop \(baseline, tanh\): expected the core's image to 1e-09 px"):
        ratios.check_answer(bare, kernel, 0.1)


def test_a_bare_loop_that_does_not_compile_is_an_error(
    ratios: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "broken.cpp"
    broken.write_text("int main( {", encoding="utf-8")
    monkeypatch.setattr(ratios, "BARE_LOOP", broken)
    with pytest.raises(BenchmarkError, match=r"was not compiled: .*broken\.cpp"):
        ratios.BareLoop(load_kernel("baseline"), tmp_path)


def test_a_run_that_stops_is_not_timed(ratios: ModuleType, paper: hs.Scenario) -> None:
    diverging = paper.updated({"controller.jacobian": "printed"})
    with pytest.raises(BenchmarkError, match="expected completed runs"):
        ratios.single(diverging, load_kernel("baseline"))()


def test_a_ratio_is_the_median_of_the_rounds_own(ratios: ModuleType) -> None:
    names = {name for wanted in ratios.WANTED for name in (wanted.work, wanted.to)} | {ratios.THREADS}
    times = {name: [(1.0, 2.0), (2.0, 4.0), (4.0, 8.0)] for name in names}
    times[ratios.FINAL] = [(3.0, 0.0), (2.0, 0.0), (6.0, 0.0)]  # to the bare loop 3, 1 and 1.5
    times[ratios.THREADS] = [(1.0, 1.0), (2.0, 2.0), (4.0, 4.0)]  # wall-clock times half as long
    found = {ratio.name: ratio for ratio in ratios.ratios_of("avx2", times)}
    final = found['batch, log="final" without metrics, to the bare loop']
    assert (final.value, final.quartiles, final.work, final.to) == (1.5, (1.25, 2.25), 3.0, 2.0)
    assert (final.clock, final.wanted, final.reached) == ("processor", 1.25, False)
    threads = found["one thread to two"]
    assert (threads.clock, threads.value, threads.at_least, threads.reached) == ("wall", 2.0, True, True)
    assert all(ratio.value == 1.0 for name, ratio in found.items() if ratio not in (final, threads))
    lines = ratios.lines_of([final, threads])
    assert lines[2].endswith("| 3 s / 2 s | **1.50** | 1.25 to 2.25 | ≤ 1.25 | no |")
    assert lines[3].endswith("| ≥ 1.9 | yes |")
    del times[ratios.THREADS]  # on one processor
    assert len(list(ratios.ratios_of("avx2", times))) == len(ratios.WANTED)


def test_every_work_is_timed_in_every_round_but_the_first(ratios: ModuleType) -> None:
    calls: list[str] = []
    works = {name: ratios.Work(lambda name=name: calls.append(name), 10) for name in "abc"}
    times = ratios.time_rounds(works, 2)
    assert "".join(calls) == "cbaabccba"
    assert {name: len(of) for name, of in times.items()} == {"a": 2, "b": 2, "c": 2}


def test_the_page_has_its_markers() -> None:
    text = (ROOT / "BENCHMARKS.md").read_text(encoding="utf-8")
    assert text.count("<!-- ratios:begin -->") == text.count("<!-- ratios:end -->") == 1


def test_the_command_writes_all_numbers(
    ratios: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(ratios, "QUICK", ratios.Plan(rounds=1, duration=0.05, scenarios=8))
    monkeypatch.setattr("sys.argv", ["ratios.py", "--quick", "--json", str(tmp_path / "ratios.json")])
    before = (ROOT / "BENCHMARKS.md").read_bytes()
    assert ratios.main() == 0
    assert (ROOT / "BENCHMARKS.md").read_bytes() == before
    content = json.loads((tmp_path / "ratios.json").read_text(encoding="utf-8"))
    assert content["machine"]["cpu"] in capsys.readouterr().out
    assert {ratio["variant"] for ratio in content["ratios"]} == set(ratios.measured_variants())
    assert all(ratio["value"] > 0.0 for ratio in content["ratios"])


@pytest.mark.slow
def test_ratios_of_processor_time_hold(ratios: ModuleType) -> None:
    variants = ratios.measured_variants()
    if variants == ("baseline",):
        pytest.skip("no variant of AVX on this machine")
    best: dict[tuple[str, str], float] = {}
    allowed: dict[tuple[str, str], float] = {}
    for _ in range(3):  # a neighbour on the machine may spoil one measurement, and hardly three
        for ratio in ratios.measure(ratios.QUICK, variants):
            if ratio.clock == "processor":
                key = (ratio.variant, ratio.name)
                best[key] = min(best.get(key, ratio.value), ratio.value)
                allowed[key] = SLACK * ratio.wanted
        if all(value <= allowed[key] for key, value in best.items()):
            break
    for key, value in best.items():
        assert value <= allowed[key], f"{key}: expected at most {allowed[key]:.2f}, got {value:.2f}"
