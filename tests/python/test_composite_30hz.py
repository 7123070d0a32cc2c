"""The scenario composite-30hz does what was asked of it, in all corners; the commands that check and search work."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import corners
import hexservo as hs
from hexservo.campaigns.plan import load_plan
from hexservo.scenario.keys import value_at
from test_docs import ROOT, tables_in

# In SI units and pixels, and not taken over from the script that checks them.
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


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
def test_every_corner_is_within_the_limits(name: str, report: corners.Report) -> None:
    assert report.corners[name].shape == (64,)
    assert report.worst[name] == report.corners[name].max()
    assert 0 < report.worst[name] <= LIMITS[name]


@pytest.mark.slow
def test_the_page_prints_what_the_check_measures(report: corners.Report) -> None:
    """docs/model.md, section 8: the worst corner, and its share of the limit."""
    page = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
    (rows,) = (rows for head, rows in tables_in(page) if head[1:] == ["required", "worst corner", "of the limit"])
    for row, (name, rule) in zip(rows, corners.REQUIREMENTS.items(), strict=True):
        shown = row[2].split()[0]
        decimals = len(shown.partition(".")[2])
        assert shown == f"{report.worst[name] * rule.scale:.{decimals}f}", row[0]
        assert row[3] == f"{100 * rule.share(report.worst[name]):.0f} %", row[0]


@pytest.mark.slow
def test_no_pattern_drifts(report: corners.Report) -> None:
    assert report.worst["eigenvalue"] >= 0.05


@pytest.mark.slow
def test_the_check_knows_the_same_limits(report: corners.Report) -> None:
    assert {name: rule.limit / rule.scale for name, rule in corners.REQUIREMENTS.items()} == pytest.approx(
        {**LIMITS, "eigenvalue": 0.05}, rel=1e-12
    )
    assert report.unmet == []
    assert "NOT MET" not in corners.table(report)
    late = replace(report, worst={**report.worst, "settling": math.nan, "eigenvalue": -0.1})
    assert late.unmet == ["settling", "eigenvalue"]
    assert corners.table(late).count("NOT MET") == 2


@pytest.mark.slow
def test_a_single_run_agrees(scenario: hs.Scenario, report: corners.Report) -> None:
    """The scenario as it is packaged is one of the corners: same inertia, same gravity, depth +-++."""
    row = int(np.flatnonzero((corners.CORNERS == [1, 1, 1, -1, 1, 1]).all(axis=1))[0])
    quiet = hs.metrics(hs.simulate(scenario.updated({"camera.noise": 0.0})))
    assert quiet["settling_time"] == report.corners["settling"][row]
    noisy = [hs.metrics(hs.simulate(scenario.updated({"seed": seed}))) for seed in corners.SEEDS]
    assert np.median([run["rms_error"] for run in noisy]) == pytest.approx(report.corners["rms"][row], rel=1e-3)
    assert max(run["peak_leg_force"] for run in noisy) <= report.corners["force"][row] * (1 + 1e-6)


def test_the_readme_has_the_worst_corners_of_the_model() -> None:
    page = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
    (rows,) = (rows for head, rows in tables_in(page) if head[1:] == ["required", "worst corner", "of the limit"])
    worst = {row[0]: row[2] for row in rows}
    keys = "settling time, without noise", "RMS error, t ≥ 1 s, median of 20 seeds", "largest leg stroke, all seeds"
    stated = "at most {}, RMS {}, {} of stroke".format(*(worst[key] for key in keys))
    assert stated in (ROOT / "README.md").read_text(encoding="utf-8")


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


# ---- The commands ---------------------------------------------------------------------------------------------------


def test_the_file_of_the_search_is_for_the_same_loop(scenario: hs.Scenario) -> None:
    plan = load_plan(ROOT / "examples" / "tune-composite-30hz.yaml")
    assert plan.tune is not None
    gains = {key: value_at(scenario, key) for key in plan.tune.variables}
    gains |= {"name": scenario.name}
    errors = ("inertia", "coriolis", "gravity", "depth")
    errors_of_both = {f"uncertainty.{key}": value_at(scenario, f"uncertainty.{key}") for key in errors}
    same = plan.scenario.updated({**gains, **errors_of_both, "description": scenario.description})
    assert same == scenario
    limits = [requirement.bound for requirement in plan.require[1:]]
    assert all(
        limit <= LIMITS[name] for limit, name in zip(limits, ("settling", "rms", "force", "stroke"), strict=True)
    )
    assert plan.tune.over
    bounds = np.array([plan.vary[f"uncertainty.{key}"].box for key in errors])
    magnitudes = np.array([corners.INERTIA, corners.CORIOLIS, corners.GRAVITY, corners.DEPTH])
    np.testing.assert_allclose(bounds, np.stack([-magnitudes, magnitudes], axis=1), rtol=1e-12)


@pytest.mark.slow
def test_the_command(
    scenario: hs.Scenario, report: corners.Report, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert corners.main(["composite-30hz", "--prior", "0.15"]) == 0
    printed = capsys.readouterr().out
    sized = np.array([float(text) for text in printed.removeprefix("prior: [").rstrip("]\n").split(", ")])
    drift = corners.Drift(scenario, corners.poses_of_the_motion(scenario), corners.DRIFT_DEPTH)
    assert drift.smallest(sized) == pytest.approx(0.15, rel=0.01)
    np.testing.assert_allclose(scenario.controller.composite.prior, sized, rtol=0.005)  # rounded to three digits

    monkeypatch.setattr(corners, "check", lambda *_: report)
    assert corners.main(["composite-30hz"]) == 0
    bad = replace(report, worst={**report.worst, "rms": 0.13})
    monkeypatch.setattr(corners, "check", lambda *_: bad)
    assert corners.main(["composite-30hz"]) == 1
    assert "NOT MET" in capsys.readouterr().out
    assert corners.main(["no-such-scenario"]) == 2
    assert "no-such-scenario" in capsys.readouterr().err

    def interrupted(*_: object) -> corners.Report:
        raise KeyboardInterrupt

    monkeypatch.setattr(corners, "check", interrupted)
    assert corners.main(["composite-30hz"]) == 130


def test_ctrl_c_ends_a_check(scenario: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch keeps Ctrl-C to itself and reports interrupted runs; the check must not take them for results."""
    whole = hs.simulate_batch

    def broken(*arguments: object, **options: object) -> hs.BatchResult:
        batch = whole(*arguments, **options)  # type: ignore[arg-type]
        outcome = batch.outcome.copy()
        outcome[-1] = "interrupted"
        return replace(batch, outcome=outcome)

    monkeypatch.setattr(hs, "simulate_batch", broken)
    with pytest.raises(KeyboardInterrupt):
        corners.run(scenario, corners.CORNERS[:2], (0,), None)


@pytest.mark.parametrize("arguments", [["--prior", "1"], ["--prior", "nan"], ["--threads", "0"]])
def test_bad_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        corners.main(["composite-30hz", *arguments])
    assert refused.value.code == 2
    assert f"{arguments[0]}: expected" in capsys.readouterr().err
