"""Searches for gains: they go on after any end, keep to their folder, and find planted fronts and relaxations."""

from __future__ import annotations

import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.campaigns import loop_numbers
from hexservo.campaigns.candidates import Judged, violation_of
from hexservo.campaigns.loop_numbers import decay_rate, delay_margin
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.search_steps import FORMAT, SearchSteps
from hexservo.campaigns.strategies import best_candidate, front_of, not_dominated, relax
from hexservo.findings.analysis import camera_rate
from hexservo.findings.analysis.camera_margins import Border
from hexservo.findings.analysis.linear_loop import Clock
from hexservo.run.publish import OutputError
from hexservo.scenario.arrays import Array
from test_campaign_tuning import FILE

SHORT: dict[str, Any] = FILE | {
    "scenario": FILE["scenario"].updated({"simulation.duration": 0.3, "metrics.rms_start": 0.2}),
    "tune": FILE["tune"] | {"over": 4},
    "runs": 20,
}
OPTIONS: dict[str, Any] = {"generations": 4, "rounds": 2, "seed": 3}
PROCESS = """
import json, sys
import hexservo as hs
print("begun", flush=True)
hs.tune(json.loads(sys.argv[1]), sys.argv[2], generations=4, rounds=2, seed=3, threads=1)
"""


def results_of(folder: Path) -> tuple[bytes, ...]:
    chunks = sorted((folder / "held-out" / "chunks").iterdir())
    return tuple(path.read_bytes() for path in (folder / "tuned.yaml", folder / "tuning.json", *chunks))


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("search") / "out"
    hs.tune(SHORT, folder, **OPTIONS)
    return folder


@pytest.mark.slow
def test_a_killed_search_goes_on_to_the_same_gains(uninterrupted: Path, tmp_path: Path) -> None:
    """kill -9 at random moments, until a process ends by itself."""
    choice = random.Random(20261122)
    file = json.dumps(SHORT | {"scenario": SHORT["scenario"].to_mapping()})
    out, killed, ended = tmp_path / "out", 0, False
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    while not ended:
        command = [sys.executable, "-c", PROCESS, file, str(out)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "begun\n"
            time.sleep(choice.uniform(0.02, 0.6) * (1 + killed))  # longer and longer, so that it ends
            process.send_signal(signal.SIGKILL)
            ended = process.wait() == 0
        killed += not ended
    print(f"{killed} kills")
    assert killed >= 2
    assert results_of(out) == results_of(uninterrupted)


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_simulated(uninterrupted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(done: int, count: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hs.tune(SHORT, tmp_path / "out", **OPTIONS, progress=interrupt)
    kept = sorted((tmp_path / "out" / "steps").iterdir())
    assert len(kept) == 3
    simulated = 0
    simulate_batch = hs.simulate_batch

    def watched(*arguments: Any, **rest: Any) -> hs.BatchResult:
        nonlocal simulated
        simulated += 1
        return simulate_batch(*arguments, **rest)

    monkeypatch.setattr("hexservo.campaigns.judging.simulate_batch", watched)
    hs.tune(SHORT, tmp_path / "out", **OPTIONS)
    assert simulated == len(list((uninterrupted / "steps").iterdir())) - 3
    assert results_of(tmp_path / "out") == results_of(uninterrupted)


def test_more_rounds_continue_a_search(tmp_path: Path) -> None:
    file = SHORT | {"tune": SHORT["tune"] | {"over": 1}}
    said: list[str] = []
    first = hs.tune(file, tmp_path / "out", **(OPTIONS | {"rounds": 1}))
    assert not first.settled
    kept = {path.name: path.read_bytes() for path in (tmp_path / "out" / "steps").iterdir()}
    more = hs.tune(file, tmp_path / "out", **(OPTIONS | {"rounds": 2}), warn=said.append)
    assert said == []
    whole = hs.tune(file, tmp_path / "whole", **(OPTIONS | {"rounds": 2}))
    assert more.joined >= 1
    assert results_of(tmp_path / "out") == results_of(tmp_path / "whole")
    assert (more.gains, more.runs) == (whole.gains, whole.runs)
    again = {path.name: path.read_bytes() for path in (tmp_path / "out" / "steps").iterdir()}
    same = [name for name in kept if again[name] == kept[name]]
    assert len(same) >= len(kept) - 3  # the comparisons at the end of the first search have no place in the longer one
    if first.feasible and first.gains != more.gains:
        assert (tmp_path / "out" / "held-out-1" / "campaign.yaml").exists()


def test_damage_is_found_and_computed_again(uninterrupted: Path, tmp_path: Path) -> None:
    before = results_of(uninterrupted)
    step = sorted((uninterrupted / "steps").iterdir())[2]
    content = step.read_bytes()
    other = sorted((uninterrupted / "steps").iterdir())[3].read_bytes()
    flipped = bytearray(content)
    flipped[content.index(b"margins.npy") + 140] ^= 1
    message = '000002.step": expected the results of this step, got different bytes; they are computed again'
    for damaged in (content[: len(content) // 2], bytes(flipped), other, b""):
        step.write_bytes(damaged)
        said: list[str] = []
        hs.tune(SHORT, uninterrupted, **OPTIONS, warn=said.append)
        assert [message in each for each in said] == ([] if damaged == other else [True])  # that one is of other inputs
        assert results_of(uninterrupted) == before
        assert step.read_bytes() == content


def test_a_folder_of_another_search_is_refused(uninterrupted: Path) -> None:
    for options, name in (
        ({"seed": 4}, r"seed \(3 there, 4 now\)"),
        ({"generations": 5}, r"generations \(4 there, 5 now\)"),
    ):
        with pytest.raises(
            OutputError, match=f"expected a folder of this search, got one that differs in {name}; name"
        ):
            hs.tune(SHORT, uninterrupted, **(OPTIONS | options))
    file = SHORT | {"tune": SHORT["tune"] | {"over": 5}}
    with pytest.raises(OutputError, match=r"got one that differs in tune: over \(4 there, 5 now\); name"):
        hs.tune(file, uninterrupted, **OPTIONS)
    more = hs.tune(SHORT | {"runs": 30}, uninterrupted, **OPTIONS)  # more held-out runs are no other search
    assert more.held_out is not None
    assert len(more.held_out) == 30
    fewer = hs.tune(SHORT | {"confidence": 0.9}, uninterrupted, **OPTIONS)  # a different check of the same gains
    assert fewer.held_out is not None
    assert len(fewer.held_out) == 20
    assert len(hs.load_campaign(uninterrupted / "held-out-1")) == 30


def test_a_search_of_a_different_format_is_refused(tmp_path: Path) -> None:
    """Before its file is read any further: it may have keys that this version does not know."""
    (tmp_path / "tune.yaml").write_text("steps: 3\nrecord: {format: 4}\n", encoding="utf-8")
    steps = SearchSteps(tmp_path, load_plan(SHORT), 0, 1, pytest.fail)
    message = f"expected a search of format {FORMAT}, got one of format 4; run it again in a new folder$"
    with pytest.raises(OutputError, match=message):
        steps.opened().__enter__()


def test_hidden_files_of_a_user_are_other_files(tmp_path: Path) -> None:
    steps = SearchSteps(tmp_path, load_plan(SHORT), 0, 1, pytest.fail)
    (tmp_path / ".git").mkdir()
    with pytest.raises(
        OutputError, match=r'expected a new folder or that of a search, got one with other files: "\.git"; name'
    ):
        steps.opened().__enter__()
    (tmp_path / ".git").rmdir()
    (tmp_path / ".hexservo-tune.yaml-0123456789ab.part").write_text("of a killed process", encoding="utf-8")
    with steps.opened():
        assert sorted(path.name for path in tmp_path.iterdir()) == ["steps", "tune.yaml"]


def test_a_changed_file_of_a_search_is_refused_and_kept(uninterrupted: Path, tmp_path: Path) -> None:
    text = (uninterrupted / "tune.yaml").read_text(encoding="utf-8")
    for before, after in (("peak_leg_force <= 0.6", "peak_leg_force <= 0.61"), ("seed: 3", "seed: 4")):
        assert text.count(before) == 1
        (tmp_path / "tune.yaml").write_text(text.replace(before, after), encoding="utf-8")
        with pytest.raises(OutputError, match="expected the file as hexservo wrote it, got one that was changed since"):
            SearchSteps(tmp_path, load_plan(SHORT), 3, 4, pytest.fail).opened().__enter__()
        assert (tmp_path / "tune.yaml").read_text(encoding="utf-8") == text.replace(before, after)
    (tmp_path / "tune.yaml").write_text(f"# by Ann\n{text}", encoding="utf-8")
    with SearchSteps(tmp_path, load_plan(SHORT), 3, 4, pytest.fail).opened():
        pass  # a comment changes nothing


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scenario: paper\n", "expected a search of format .*, got a file that names no format; run it again in a new"),
        ("- 1\n", "got a file that names no format"),
        ("record: 3\n", "got a file that names no format"),
        (
            f"record: {{format: {FORMAT}}}\n",
            "expected the file of a search, got a different one: missing keys: scenario",
        ),
    ],
)
def test_a_file_of_its_name_that_is_none_of_a_search(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "tune.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(OutputError, match=message):
        SearchSteps(tmp_path, load_plan(SHORT), 0, 1, pytest.fail).opened().__enter__()


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path: Path) -> None:
    with SearchSteps(tmp_path, load_plan(SHORT), 0, 1, pytest.fail).opened():
        pass
    (tmp_path / "steps").rmdir()
    (tmp_path / "steps").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r'steps": expected a folder, got a file, which is kept; move it away'):
        SearchSteps(tmp_path, load_plan(SHORT), 0, 1, pytest.fail).opened().__enter__()


@pytest.mark.parametrize("kind", ["file", "folder", "link", "changed"])
def test_what_is_no_held_out_campaign_is_refused_before_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    hs.tune(SHORT, tmp_path / "out", generations=1, rounds=1)
    place = tmp_path / "out" / "held-out"
    if kind == "changed":
        text = (place / "campaign.yaml").read_text(encoding="utf-8")
        (place / "campaign.yaml").write_text(text.replace("confidence: 0.95", "confidence: 0.5"), encoding="utf-8")
    else:
        place.rename(tmp_path / "held-out")
    if kind == "file":
        place.write_text("mine", encoding="utf-8")
    elif kind == "folder":
        place.mkdir()
        (place / "letter.txt").write_text("Dear", encoding="utf-8")
    elif kind == "link":
        place.symlink_to(tmp_path / "nowhere")
    message = {
        "file": "expected a folder, got a file, which is kept; move it away",
        "folder": 'expected a new folder or that of the held-out campaign, got one with other files: "letter.txt"',
        "link": "expected a folder, got a file, which is kept",
        "changed": "expected the file as hexservo wrote it, got one that was changed since",
    }[kind]

    def searched(*arguments: Any) -> None:
        raise AssertionError

    monkeypatch.setattr("hexservo.campaigns.tuning._Search.run", searched)
    with pytest.raises((OutputError, hs.ResultError), match=message):
        hs.tune(SHORT, tmp_path / "out", generations=1, rounds=1)


def test_what_an_earlier_search_found_is_set_aside_where_nothing_is_feasible(tmp_path: Path) -> None:
    file = SHORT | {"require": [*SHORT["require"], "peak_error <= 1"]}
    hs.tune(file, tmp_path / "out", generations=1, rounds=1)
    (tmp_path / "out" / "held-out").mkdir()
    (tmp_path / "out" / "front.csv").write_text("of other gains", encoding="utf-8")
    (tmp_path / "out" / "tuning.json").write_text("with notes", encoding="utf-8")
    assert not hs.tune(file, tmp_path / "out", generations=1, rounds=2).feasible
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.suffix != ".yaml") == [
        "front-1.csv",
        "held-out-1",
        "steps",
        "tuning-1.json",
        "tuning.json",
    ]
    assert (tmp_path / "out" / "tuning-1.json").read_text(encoding="utf-8") == "with notes"


# ---- Planted problems -----------------------------------------------------------------------------------------------


class Planted:
    """Candidates whose margins and metrics are functions of their places."""

    def __init__(self, margins: Any, values: Any, dimension: int, seed: int) -> None:
        self.functions = margins, values
        self.dimension, self.seed = dimension, seed
        self.nearest = np.full(len(margins), -math.inf)

    def renew(self) -> None:
        pass

    def judged(self, places: Array) -> Judged:
        margins, values = (np.stack([each(places) for each in group], axis=1) for group in self.functions)
        for column in range(len(self.nearest)):
            kept = (np.delete(margins, column, axis=1) >= 0).all(axis=1)
            self.nearest[column] = max([self.nearest[column], *margins[kept, column]])
        return Judged(margins, values, margins, violation_of(margins))


def nothing(judged: Judged, order: Any) -> None:
    pass


def test_a_planted_optimum_on_a_constraint_is_found() -> None:
    """The least of x0 + x1 within a disc around (1/2, 1/2) of radius 0.3 is 1 - 0.3 sqrt(2)."""
    for seed in range(10):
        planted: Any = Planted(
            [lambda p: 0.3 - np.hypot(p[:, 0] - 0.5, p[:, 1] - 0.5), lambda p: np.ones(len(p))],
            [lambda p: p[:, 0] + p[:, 1]],
            2,
            seed,
        )
        best = best_candidate(planted, np.array([[0.9, 0.9]]), 40, nothing)
        found = planted.judged(best[None])
        assert found.smallest[0] >= 0
        assert found.values[0, 0] == pytest.approx(1 - 0.3 * math.sqrt(2), abs=0.01), f"seed {seed}"


def test_a_candidate_that_was_known_is_not_lost() -> None:
    """Feasible places too few for a search of one generation to find: it ends with the known one among them, whichever
    of the known ones it begins at."""
    known = np.array([[0.3, 0.3], [0.9, 0.9]])
    planted: Any = Planted([lambda p: 1e-6 - np.hypot(p[:, 0] - 0.3, p[:, 1] - 0.3)], [lambda p: p[:, 0]], 2, 0)
    assert best_candidate(planted, known, 1, nothing) == pytest.approx(known[0], abs=0)


@pytest.mark.parametrize("seeds", [5, pytest.param(20, marks=pytest.mark.slow)])
def test_the_smallest_relaxation_is_found(seeds: int) -> None:
    """x0 >= 0.8 and x0 <= 0.5 - x1 exclude each other: either holds if the other gives way by 0.3.

    What is found is never less, and in the corner between two bounds a search may stop short: by 0.05 at most here.
    """
    for seed in range(seeds):
        planted: Any = Planted(
            [lambda p: p[:, 0] - 0.8, lambda p: 0.5 - p[:, 1] - p[:, 0]], [lambda p: p[:, 0]], 2, seed
        )
        for column in range(2):
            relax(planted, np.array([0.5, 0.5]), 40, column)
        assert planted.nearest == pytest.approx([-0.3, -0.3], abs=0.05), f"seed {seed}"
        assert (planted.nearest <= -0.3 + 1e-12).all()


@pytest.mark.parametrize("seed", [0, *(pytest.param(each, marks=pytest.mark.slow) for each in (1, 2))])
def test_a_planted_front_is_found(seed: int) -> None:
    """ZDT1 (Zitzler, Deb and Thiele 2000) in 4 numbers, whose front is f2 = 1 - sqrt(f1) at x1 = x2 = x3 = 0; of it
    f1 >= 0.04 is feasible."""

    def rest(p: Array) -> Array:
        return np.asarray(1 + 9 * p[:, 1:].mean(axis=1))

    planted: Any = Planted(
        [lambda p: p[:, 0] - 0.04],
        [lambda p: p[:, 0], lambda p: rest(p) * (1 - np.sqrt(p[:, 0] / rest(p)))],
        4,
        seed,
    )
    front = front_of(planted, np.array([[0.5, 0.5, 0.5, 0.5]]), 120, nothing)
    values = planted.judged(front).values
    away = values[:, 1] - (1 - np.sqrt(values[:, 0]))
    print(f"seed {seed}: {len(front)} points, at most {away.max():.3g} above the front")
    assert len(front) >= 30
    assert (away >= -1e-12).all()
    assert away.max() < 0.05
    assert values[0, 0] == pytest.approx(0.04, abs=0.02)
    assert values[-1, 0] > 0.9
    assert (np.diff(values[:, 0]) > 0).all()
    assert (np.diff(values[:, 1]) < 0).all()


def test_what_is_not_dominated() -> None:
    values = np.array([[2.0, 1.0], [1.0, 2.0], [2.0, 2.0], [1.0, 2.0], [3.0, 0.5], [2.5, 1.0]])
    assert not_dominated(values).tolist() == [0, 1, 4]
    assert not_dominated(np.empty((0, 2))).tolist() == []


# ---- On a loop ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_front_of_two_metrics(tmp_path: Path) -> None:
    tune = SHORT["tune"] | {"minimise": ["settling_time", "peak_leg_force"], "over": "corners"}
    vary = {"uncertainty.gravity": {"uniform": [-0.05, 0.05]}, "uncertainty.depth": {"uniform": [-0.3, 0.3]}}
    scenario = FILE["scenario"].updated({"simulation.duration": 0.5})
    file = SHORT | {"scenario": scenario, "tune": tune, "vary": vary}
    result = hs.tune(file, tmp_path / "out", generations=8, rounds=1, seed=2)
    assert result.feasible
    assert result.variations == 4  # corners of two numbers
    values = np.array([point.values for point in result.front])
    print(f"seed 2: {len(values)} points, {values[0]} to {values[-1]}")
    assert len(values) >= 10
    assert (np.diff(values[:, 0]) > 0).all()
    assert (np.diff(values[:, 1]) < 0).all()
    point = result.front[0]
    batch = hs.simulate_batch(
        scenario.updated(dict(point.gains)),
        {"uncertainty.gravity": np.array([-0.05, -0.05, 0.05, 0.05]), "uncertainty.depth": np.array([-0.3, 0.3] * 2)},
        "metrics",
    )
    largest = [batch.metrics[name].max() for name in ("settling_time", "peak_leg_force")]
    np.testing.assert_allclose(point.values, largest, rtol=1e-12)
    lines = (tmp_path / "out" / "front.csv").read_text().splitlines()
    assert lines[0].startswith("settling_time,peak_leg_force,settling_time_held_out,peak_leg_force_held_out,failures")
    assert len(lines) == 1 + len(values)
    assert [section.name for section in result.sections()] == ["tuning", "tuning_history", "tuning_front"]
    (tmp_path / "out" / "front.csv").write_text("with notes", encoding="utf-8")
    hs.tune(file, tmp_path / "out", generations=8, rounds=1, seed=2)
    assert (tmp_path / "out" / "front-1.csv").read_text(encoding="utf-8") == "with notes"
    assert (tmp_path / "out" / "front.csv").read_text(encoding="utf-8").splitlines() == lines
    assert sorted(path.name for path in (tmp_path / "out").glob("tuning*")) == ["tuning.json"], "the same content"


def test_without_a_metric_the_smallest_margin_grows(tmp_path: Path) -> None:
    tune = {key: value for key, value in SHORT["tune"].items() if key != "minimise"}
    result = hs.tune(SHORT | {"tune": tune}, tmp_path / "out", generations=8, rounds=1, seed=5)
    assert result.worst == ()
    assert result.margin > result.before[0]
    assert "the smallest margin is" in result.section().sentences[0]


def test_two_metrics_need_pymoo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexservo.campaigns.tuning.find_spec", lambda name: None)
    tune = SHORT["tune"] | {"minimise": ["settling_time", "rms_error"]}
    with pytest.raises(OutputError, match=r"expected an installation with pymoo for two metrics: pip install"):
        hs.tune(SHORT | {"tune": tune}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# ---- Numbers of the loop --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [pytest.param(0.3, marks=pytest.mark.slow), 1.0, 30.0])
def test_the_delay_margin_is_that_of_the_analysis(factor: float) -> None:
    scenario = hs.load_scenario("noisy-camera").updated({"camera.prediction": "none", "camera.noise": 0.0})
    kt = [factor * value for value in scenario.controller.composite.kt]  # type: ignore[union-attr]
    changed = scenario.updated({"controller.law": "composite", "controller.composite.kt": kt})
    part = camera_rate.analyse(changed)
    assert part.acting is not None
    assert part.clock is not None
    stable = part.acting.latency.stable
    expected = math.nan if stable is None else (stable - part.clock.latency) * changed.simulation.step
    print(f"{factor}: {expected} s")
    assert delay_margin(changed) == pytest.approx(expected, nan_ok=True, abs=1e-12)
    assert math.isnan(delay_margin(scenario.updated({"controller.law": "hybrid"})))


@pytest.mark.parametrize(("own", "margin"), [(10, -20), (30, 70), (40, 60), (120, -20)])
def test_the_delay_margin_is_negative_below_and_beyond_what_is_stable(
    monkeypatch: pytest.MonkeyPatch, own: int, margin: int
) -> None:
    """Of a loop that is stable with latencies from 30 to 100 ticks of 1 ms."""
    latency = Border(stable=100, unstable=101, looked_at=500, least=30)
    scenario = hs.load_scenario("noisy-camera")
    found = SimpleNamespace(acting=SimpleNamespace(latency=latency), clock=Clock(1, own), scenario=scenario)
    monkeypatch.setattr(loop_numbers, "_camera_rate", lambda scenario, borders: found)
    assert delay_margin(scenario) == pytest.approx(margin * scenario.simulation.step)


@pytest.mark.parametrize("latency", [pytest.param(each, marks=pytest.mark.slow) for each in (0.0, 0.3, 0.5)] + [0.1])
def test_the_decay_rate_is_that_of_the_characteristic_equation(latency: float) -> None:
    """Computed torque without model errors: each axis is s^2 + k_d s exp(-s hold) + k_p exp(-s delay) = 0, whose
    rightmost root is found by Newton's method. A wrench is held for half a tick on average, and a frame for half a
    period, which is exact but for |s period|^2/24 of k_p, below 1e-4 of it."""
    kp, kd, period, tick = 16.0, 4.0, 0.01, 0.001
    scenario = hs.load_scenario("paper").updated(
        {
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "gravity": 0.0, "depth": 0.0},
            "simulation": {"mode": "sampled", "step": tick},
            "camera": {"period": period, "latency": latency},
            "controller": {"law": "computed_torque", "computed_torque": {"kp": kp, "kd": kd, "prior": 0.0}},
        }
    )
    delay, hold = latency + period / 2, tick / 2

    def of(s: Any) -> Any:
        return s**2 + kd * s * np.exp(-s * hold) + kp * np.exp(-s * delay)

    s = np.add.outer(np.linspace(-10, 5, 31), 1j * np.linspace(0, 12, 25)).ravel()
    with np.errstate(all="ignore"):
        for _ in range(60):
            s = s - of(s) / (2 * s + kd * (1 - hold * s) * np.exp(-s * hold) - delay * kp * np.exp(-s * delay))
        roots = s[np.abs(of(s)) < 1e-9]
    print(f"latency {latency} s: {decay_rate(scenario)} 1/s, by hand {-roots.real.max()}")
    assert decay_rate(scenario) == pytest.approx(-roots.real.max(), abs=4e-4)
    assert math.isnan(decay_rate(scenario.updated({"controller.law": "hybrid"})))


def test_a_required_delay_margin_holds(tmp_path: Path) -> None:
    """Without the requirement the search ends at gains whose margin is smaller by 20 ms."""
    scenario = hs.load_scenario("noisy-camera").updated(
        {
            "camera.prediction": "none",
            "camera.noise": 0.0,
            "simulation.duration": 0.8,
            "metrics.rms_start": 0.4,
            "controller.law": "kelly",
        }
    )
    tune = {
        "variables": {
            "controller.kelly.kp": {"log": [1e-8, 1e-4]},
            "controller.kelly.kd": {"log": [1e-3, 10], "groups": [3, 3]},
        },
        "minimise": "rms_error",
        "over": 2,
    }
    file = SHORT | {
        "scenario": scenario,
        "vary": {"uncertainty.depth": {"uniform": [-0.1, 0.1]}},
        "require": ["peak_leg_force <= 0.9"],
        "tune": tune,
    }
    free = hs.tune(file, tmp_path / "free", generations=4, rounds=1, seed=1)
    before = delay_margin(free.scenario)
    required = f"delay_margin >= {before + 0.02:.3f}"
    bound = hs.tune(file | {"tune": tune | {"subject_to": [required]}}, tmp_path / "b", generations=4, rounds=1, seed=1)
    print(f"{before} s, then {bound.loop}")
    assert bound.feasible
    assert bound.loop[required] == delay_margin(bound.scenario) >= before + 0.019
