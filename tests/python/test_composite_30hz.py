"""The scenario composite-30hz does what was asked of it, in all corners; the script that found its gains works."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import corners
import hexservo as hs
import tune_composite
from corners import Array
from evolution import evolve

# In SI units and pixels, and not taken over from the script that searched for them.
LIMITS = {
    "settling": 0.20,
    "noisy_settling": 0.20,
    "rms": 0.12,
    "force": 0.6,
    "stroke": 0.017,
    "long_stroke": 0.017,
}


@pytest.fixture(scope="module")
def scenario() -> hs.Scenario:
    return hs.load_scenario("composite-30hz")


@pytest.fixture(scope="module")
def report(scenario: hs.Scenario) -> corners.Report:
    """Measure all 64 corners: 20 noisy runs of each, and one of 300 s."""
    return corners.check(scenario)


def test_it_is_the_loop_that_was_asked_for(scenario: hs.Scenario) -> None:
    camera, simulation = scenario.camera, scenario.simulation
    assert (camera.period, camera.latency, camera.noise, camera.prediction) == (0.033, 0.033, 0.2, "encoder")
    assert (simulation.mode, simulation.step, simulation.substeps) == ("sampled", 1e-3, 1)
    assert (scenario.controller.law, scenario.controller.switching.kind) == ("composite", "implicit")
    assert scenario.robot == hs.load_scenario("paper").robot
    assert scenario.target == hs.load_scenario("paper").target


@pytest.mark.parametrize("name", LIMITS)
def test_every_corner_is_within_the_limits(name: str, report: corners.Report) -> None:
    assert report.corners[name].shape == (64,)
    assert report.worst[name] == report.corners[name].max()
    assert 0 < report.worst[name] <= LIMITS[name]


def test_no_pattern_drifts(report: corners.Report) -> None:
    assert report.worst["eigenvalue"] >= 0.05


def test_the_check_knows_the_same_limits(report: corners.Report) -> None:
    assert {name: rule.limit / rule.scale for name, rule in corners.REQUIREMENTS.items()} == pytest.approx(
        {**LIMITS, "eigenvalue": 0.05}, rel=1e-12
    )
    assert report.unmet == []
    assert "NOT MET" not in corners.table(report)
    late = replace(report, worst={**report.worst, "settling": math.nan, "eigenvalue": -0.1})
    assert late.unmet == ["settling", "eigenvalue"]
    assert corners.table(late).count("NOT MET") == 2


def test_a_single_run_agrees(scenario: hs.Scenario, report: corners.Report) -> None:
    """The scenario as it is packaged is one of the corners: same inertia, same gravity, depth +-++."""
    row = int(np.flatnonzero((corners.CORNERS == [1, 1, 1, -1, 1, 1]).all(axis=1))[0])
    quiet = hs.metrics(hs.simulate(scenario.updated({"camera.noise": 0.0})))
    assert quiet["settling_time"] == report.corners["settling"][row]
    noisy = [hs.metrics(hs.simulate(scenario.updated({"seed": seed}))) for seed in corners.SEEDS]
    assert np.median([run["rms_error"] for run in noisy]) == pytest.approx(report.corners["rms"][row], rel=1e-3)
    assert max(run["peak_leg_force"] for run in noisy) <= report.corners["force"][row] * (1 + 1e-6)


def test_the_eigenvalue_is_the_known_one() -> None:
    """The defaults of the law have 0.0055 at home at 30 %, and a negative one without the prior."""
    defaults = hs.load_scenario("paper-composite")
    home = [(np.array(defaults.robot.home_position), np.array([1.0, 0.0, 0.0, 0.0]))]
    drift = corners.Drift(defaults, home, 0.3)
    prior = np.array(defaults.controller.composite.prior)
    assert drift.smallest(prior) == pytest.approx(0.0055, abs=5e-5)
    assert drift.smallest(1e-9 * prior) < -0.01
    sized = drift.sized(prior, 0.2)
    assert drift.smallest(sized) == pytest.approx(0.2, rel=2e-3)
    np.testing.assert_allclose(sized / sized[0], prior / prior[0], rtol=1e-12)


def test_the_motion_ends_at_the_goal(scenario: hs.Scenario) -> None:
    """The last translation is 1.4 times the one of docs/model.md, section 4, as is the last rotation."""
    poses = corners.poses_of_the_motion(scenario)
    home = np.array(scenario.robot.home_position)
    np.testing.assert_allclose((poses[-1][0] - home) / 1.4, [17.188e-3, 6.875e-3, 0.0], atol=1e-6)
    np.testing.assert_allclose(2 * poses[-5][1][1:] / 1.4, [13.8e-3, -34.2e-3, 0.2e-3], atol=1e-4)
    np.testing.assert_allclose(poses[-5][0], home, atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"controller.law": "hybrid"}, "controller.law"),
        (
            {
                "simulation.mode": "continuous",
                "controller.switching.kind": "sign",
                "camera.period": None,
                "camera.latency": 0.0,
                "camera.noise": 0.0,
                "camera.prediction": "none",
            },
            "simulation.mode",
        ),
        ({"simulation.duration": 1.0}, "simulation.duration"),
    ],
)
def test_another_task_is_not_checked(changes: dict[str, object], key: str, scenario: hs.Scenario) -> None:
    with pytest.raises(ValueError, match=f"^{key}: expected .*, got "):
        corners.check(scenario.updated(changes))


# ---- The search -----------------------------------------------------------------------------------------------------


def test_the_strategy_finds_a_minimum() -> None:
    """A turned ellipsoid with axes of 1 : 1000, its minimum inside the cube or, in one direction, on its side."""
    random = np.random.default_rng(5)
    turn = np.linalg.qr(random.standard_normal((6, 6)))[0]
    goal = np.array([0.2, 0.4, 0.5, 0.6, 0.8, 0.5])
    scales = np.logspace(0, 3, 6)

    def cost(points: Array) -> Array:
        return np.asarray((((points - goal) @ turn * scales) ** 2).sum(axis=1))

    costs: list[float] = []

    def after(generation: int, lowest: float, best: Array) -> bool:
        costs.append(lowest)
        return False

    best = evolve(cost, np.full(6, 0.5), 0.2, 250, random, after)
    np.testing.assert_allclose(best, goal, atol=1e-4)
    assert costs == sorted(costs, reverse=True)
    assert len(costs) == 250


def test_a_search_is_repeatable_and_keeps_its_promises(scenario: hs.Scenario) -> None:
    once, again = (tune_composite.search(scenario, 0.15, 7, 1, None) for _ in range(2))
    assert once.keys() == again.keys() == {*tune_composite.FOUND}
    for key, values in once.items():
        np.testing.assert_array_equal(values, again[key])
    drift = corners.Drift(scenario, corners.poses_of_the_motion(scenario), 0.35)
    assert drift.smallest(once["prior"]) == pytest.approx(0.15, rel=0.01)  # rounded to three digits


def packaged_gains(scenario: hs.Scenario) -> dict[str, Array]:
    law = scenario.controller.composite.model_dump()
    flat = {**law, **{f"fuzzy.{key}": value for key, value in law["fuzzy"].items()}}
    return {key: np.array(flat[key], dtype=float) for key in tune_composite.FOUND}


def test_the_packaged_file_is_what_the_script_writes(scenario: hs.Scenario) -> None:
    text = (resources.files("hexservo") / "scenarios" / "composite-30hz.yaml").read_text("utf-8")
    assert tune_composite.scenario_text(packaged_gains(scenario)) == text
    assert tune_composite.loaded(text) == scenario


def test_the_file_is_written_whole_or_not_at_all(
    scenario: hs.Scenario,
    report: corners.Report,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "deep" / "found.yaml"
    arguments = ["--output", str(file)]
    monkeypatch.setattr(tune_composite, "search", lambda *_: packaged_gains(scenario))

    bad = replace(report, worst={**report.worst, "rms": 0.13})
    monkeypatch.setattr(tune_composite, "check", lambda *_: bad)
    assert tune_composite.main(arguments) == 1
    assert "rms not met" in capsys.readouterr().err
    assert not file.parent.exists()

    def interrupted(*_: object) -> corners.Report:
        raise KeyboardInterrupt

    monkeypatch.setattr(tune_composite, "check", interrupted)
    assert tune_composite.main(arguments) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert not file.parent.exists()

    monkeypatch.setattr(tune_composite, "check", lambda *_: report)
    assert tune_composite.main(arguments) == 0
    assert hs.load_scenario(file) == scenario
    assert list(file.parent.iterdir()) == [file]

    with pytest.raises(SystemExit) as refused:
        tune_composite.main(arguments)
    assert refused.value.code == 2
    assert "--force replaces it" in capsys.readouterr().err


def test_ctrl_c_ends_a_search(scenario: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch keeps Ctrl-C to itself and reports interrupted runs; the script must not take them for results."""
    whole = hs.simulate_batch

    def broken(*arguments: object, **options: object) -> hs.BatchResult:
        batch = whole(*arguments, **options)  # type: ignore[arg-type]
        outcome = batch.outcome.copy()
        outcome[-1] = "interrupted"
        return replace(batch, outcome=outcome)

    monkeypatch.setattr(hs, "simulate_batch", broken)
    with pytest.raises(KeyboardInterrupt):
        corners.run(scenario, corners.CORNERS[:2], (0,), None)


@pytest.mark.parametrize(
    "arguments",
    [["--seed", "-1"], ["--generations", "0"], ["--eigenvalue", "0.01"], ["--eigenvalue", "nan"], ["--threads", "0"]],
)
def test_bad_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        tune_composite.main(arguments)
    assert refused.value.code == 2
    assert f"{arguments[0]}: expected" in capsys.readouterr().err
