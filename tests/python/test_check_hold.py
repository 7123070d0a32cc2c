"""Warnings about goals that runs from there do not keep, before a target at rest and before one that moves."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import unlikely
from hexservo.findings.tracking_runs import RUNS, seeds_of_runs
from hexservo.run.batch import simulate_batch

HYBRID = {"controller.law": "hybrid"}
EXACT = {**HYBRID, "uncertainty.gravity": 0.0, "uncertainty.depth": 0.0}


def said(scenario: hs.Scenario) -> list[str]:
    return [line for line in unlikely(scenario) if re.search("that begin (at|within .* of) the goal", line)]


def sinusoid(amplitude: list[float], frequency: float) -> dict[str, Any]:
    return {"target.motion": {"kind": "sinusoid", "amplitude": amplitude, "frequency": frequency}}


def left_late(scenario: hs.Scenario) -> float:
    """Return the largest feature error in the second half of a run [px]."""
    run = hs.simulate(scenario)
    return float(np.abs(run.feature_error[run.time >= 0.5 * run.time[-1]]).max())


TIME = np.arange(0.0, 6.05, 0.05)[:, None]
RECORDED = np.hstack([0.008 * np.sin(4.0 * TIME), 0.004 * np.sin(7.0 * TIME), 0.0 * TIME]).tolist()
WORLD = {"target.frame": "world", "base_motion.kind": "sinusoid"}
STEADY = {"target.motion": {"kind": "velocity", "velocity": [0.008, 0.0, 0.0]}}
BY_PBVS = {"controller.law": "pbvs"}
MOTIONS: list[tuple[str, dict[str, Any]]] = [
    ("composite-30hz", sinusoid([0.005, 0.0, 0.0], 5.0)),
    ("composite-30hz", {**BY_PBVS, **sinusoid([0.004, 0.0, -0.003], 2.0)}),
    ("composite-30hz", {**BY_PBVS, "camera.prediction": "none", **sinusoid([0.004, 0.0, -0.003], 2.0)}),
    ("slow-camera", {"target.motion": {"kind": "recorded", "samples": RECORDED, "sample_period": 0.05}}),
    ("slow-camera", {**WORLD, "base_motion.amplitude": [0.0, 2.0, 0.0], "base_motion.frequency": 2.0}),
    ("real-machine", {"base_motion.kind": "none", **sinusoid([0.0, 0.004, 0.003], 2.0)}),
    ("pi-h824-positions", {**BY_PBVS, **sinusoid([0.002, 0.0, 0.001], 1.0)}),
    ("pi-h824-positions", {**BY_PBVS, "camera.latency": 0.12, **sinusoid([0.002, 0.0, 0.001], 0.5)}),
    ("pi-h824-positions", {"controller.law": "resolved_rate", **sinusoid([0.0, 0.002, 0.001], 0.5)}),
    ("pi-h824-positions", {**BY_PBVS, **STEADY, "simulation.duration": 2.4}),
    ("composite-30hz", {**EXACT, **sinusoid([0.015, 0.0, 0.0], 0.5)}),
    ("rubin-camera-hexapod", sinusoid([0.01, 0.0, 0.0], 0.1)),  # no linear loop: the centre of mass is not its middle
    ("pi-h824", {"uncertainty.focal_length": 0.001, **sinusoid([0.005, 0.0, 0.0], 0.5)}),  # nor with a wrong camera
    ("pi-h824", sinusoid([0.0008, 0.0, 0.0], 0.5)),  # more than a linear loop: K_v sticks
]


@pytest.mark.parametrize("seed", [2**63 - 2, 2**63 + 7, 2**64 - 2])
def test_any_seed_is_followed_by_others(seed: int) -> None:
    """A campaign draws all of 64 bits, and its worst run is a scenario to check."""
    scenario = hs.load_scenario("composite-30hz").updated({"seed": seed})
    assert seeds_of_runs(scenario).tolist() == [(seed + place) % 2**64 for place in range(RUNS)]
    assert said(scenario) == []
    assert len(said(scenario.updated({"camera.noise": 3.0}))) == 1


@pytest.mark.parametrize(("name", "changes"), MOTIONS)
def test_what_is_left_is_within_a_fifth_of_a_run(name: str, changes: dict[str, Any]) -> None:
    scenario = hs.load_scenario(name).updated({"simulation.duration": 6.0, **changes})
    (line,) = said(scenario)
    (found,) = re.findall(r"leaves up to about ([\d.]+) px of such a motion", line)
    assert float(found) == pytest.approx(left_late(scenario), rel=0.2)
    assert line.startswith("base_motion: " if "base_motion.amplitude" in changes else "target.motion: ")


@pytest.mark.parametrize(("name", "changes"), MOTIONS)
def test_smaller_motions_are_left_within_the_band(name: str, changes: dict[str, Any]) -> None:
    """A band that is a fourth wider than what is left in a run has no warning, and one a fourth narrower has one."""
    scenario = hs.load_scenario(name).updated({"simulation.duration": 6.0, **changes})
    left = left_late(scenario)
    assert said(scenario.updated({"metrics.band": 1.25 * left})) == []
    assert len(said(scenario.updated({"metrics.band": 0.75 * left}))) == 1


def test_a_loop_that_amplifies_the_motion() -> None:
    scenario = hs.load_scenario("slow-camera").updated(sinusoid([0.008, 0.0, 0.0], 2.0))
    (line,) = said(scenario)
    (left, still) = map(float, re.findall(r"about ([\d.]+) px of .* would have ([\d.]+) px: the loop", line)[0])
    assert left > still
    assert "higher bandwidth" not in line
    points = scene_of(scenario).view(scene_of(scenario).start).jacobian[:, 0]
    assert still == pytest.approx(0.008 * np.abs(points).max(), rel=0.2)  # the goal is nearly as far away


def test_what_does_not_move_is_not_said() -> None:
    scenario = hs.load_scenario("composite-30hz")
    shaken = {"base_motion.kind": "sinusoid", "base_motion.amplitude": [2.0, 0.0, 0.0]}
    for changes in ({}, shaken, {**shaken, "base_motion.rotation.kind": "sinusoid"}):
        assert said(scenario.updated(changes)) == []
    moving = scenario.updated(MOTIONS[0][1])
    assert [line for line in unlikely(moving, by_law=False) if "that begin" in line] == []
    assert said(hs.load_scenario("pi-h824-positions").updated(sinusoid([0.002, 0.0, 0.001], 1.0))) == []


LEAVE: list[tuple[str, dict[str, Any], str]] = [
    ("composite-30hz", HYBRID, "gravity"),
    ("slow-camera", HYBRID, "gravity"),
    ("pi-h824", {"camera.quantisation": 20.0}, "pixel_quantisation"),
    ("pi-h824", {"camera.outlier_probability": 0.05, "camera.outlier_size": 40.0}, "outliers"),
    ("paper-gravity", {}, "gravity"),  # in continuous mode
]


@pytest.mark.parametrize(("name", "changes", "cause"), LEAVE)
def test_a_goal_that_runs_do_not_keep(name: str, changes: dict[str, Any], cause: str) -> None:
    """The number is that of a run from the goal, and what the sentence names shows the cause."""
    scenario = hs.load_scenario(name).updated(changes)
    (line,) = said(scenario)
    begin = [float(value) for value in re.findall(r"simulation.start.pose: \[(.*)\]", line)[0].split(", ")]
    seeds: list[dict[str, Any]] = [{"seed": seed} for seed in range(1, 5)]
    if scenario.simulation.mode == "continuous":
        seeds = [{}]
    runs = [hs.simulate(scenario.updated({"simulation.start.pose": begin, **seed})) for seed in seeds]
    late = [float(np.abs(run.feature_error[run.time >= 0.5 * run.time[-1]]).max()) for run in runs]
    (found,) = re.findall(r"up to ([\d.]+) px from it in their second half", line)
    assert float(found) == pytest.approx(max(late), rel=0.5)  # of other noise
    assert any(hs.diagnose(run).causes[0].cause == cause for run in runs)


def test_an_unstable_goal_at_which_a_run_stays() -> None:
    """Nothing moves a loop without noise from its goal, whatever its gains: runs begin beside it."""
    late = hs.load_scenario("fails-late-camera")
    goal = find_goals(scene_of(late))
    assert goal is not None
    stays = hs.simulate(late.updated({"simulation.start.pose": goal.best.displacement.tolist()}))
    assert stays.outcome == "completed"
    assert np.abs(stays.feature_error).max() < 0.1
    (line,) = said(late)
    begin = [float(value) for value in re.findall(r"simulation.start.pose: \[(.*)\]", line)[0].split(", ")]
    run = hs.simulate(late.updated({"simulation.start.pose": begin}))
    assert run.outcome == "diverged"
    assert np.abs(run.feature_error[0]).max() == pytest.approx(4.0, rel=0.2)  # two bands
    assert "within 4 px of the goal before a target at rest end early (diverged)" in line


def test_a_band_that_is_left_again() -> None:
    """Outliers and lost frames move the platform: the end of a run may be within the band, and not all before it."""
    coarse = hs.load_scenario("dropouts")
    goal = find_goals(scene_of(coarse))
    assert goal is not None
    begin = {"simulation.start.pose": goal.best.displacement.tolist()}
    late = max(left_late(coarse.updated({**begin, "seed": seed})) for seed in range(coarse.seed, coarse.seed + 4))
    tight = coarse.updated({"metrics.band": 0.95 * late})
    (line,) = said(tight)
    assert line.startswith("metrics.band: runs of composite that begin at the goal before a target at rest leave")
    (found,) = re.findall(r"up to ([\d.]+) px in their second half", line)
    assert float(found) == pytest.approx(late, rel=0.05)
    assert said(coarse.updated({"metrics.band": 1.05 * late})) == []


def test_starts_beyond_the_legs_are_those_of_the_goal() -> None:
    """A stroke that ends 0.1 mm beyond home and goal leaves no start two bands away."""
    scenario = hs.load_scenario("hand-eye")
    goal = find_goals(scene_of(scenario))
    assert goal is not None
    travel = np.abs(scene_of(scenario).leg_travel(goal.best.view.pose)).max()
    narrow = scenario.updated({"robot.stroke": float(travel) + 1e-4, "robot.on_limit": "stop"})
    assert said(narrow) == []


def test_a_law_that_does_not_act_has_no_runs() -> None:
    coarse = hs.load_scenario("fails-coarse-step")
    assert len(said(coarse)) == 1
    assert said(coarse.updated({"camera.dropout": 1.0})) == []


def test_goals_that_packaged_scenarios_keep() -> None:
    """Those that settle keep it, but for legs that give 3 % more than the weight needs."""
    for name in ("hand-eye", "moog-6dof2000e", "real-machine", "rough-road"):
        assert said(hs.load_scenario(name)) == [], name
    (line,) = said(hs.load_scenario("saturation"))
    assert "before a target at rest end early (diverged)" in line


def test_runs_beside_the_goal_and_at_it_are_one_pack(monkeypatch: pytest.MonkeyPatch) -> None:
    """In sampled mode, with the seeds of each four runs alike; in continuous mode nothing differs at the goal."""
    packs: list[Any] = []

    def noted(scenario: hs.Scenario, variations: Any, **options: Any) -> Any:
        packs.append(variations)
        return simulate_batch(scenario, variations, **options)

    monkeypatch.setattr("hexservo.findings.check_hold.simulate_batch", noted)
    assert said(hs.load_scenario("real-machine")) == said(hs.load_scenario("paper")) == []
    of_sampled, of_continuous = packs
    assert len(of_continuous["simulation.start.pose"]) == RUNS
    beside, at = np.split(of_sampled["simulation.start.pose"], 2)
    assert (at == at[0]).all()
    assert (beside != at).any(axis=1).all()
    first, second = np.split(of_sampled["seed"], 2)
    assert first.tolist() == second.tolist() == sorted(set(first.tolist()))
