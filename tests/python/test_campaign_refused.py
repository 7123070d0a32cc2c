"""Draws that are no valid scenario: left out of searches in the box, and refused with their numbers elsewhere."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.campaigns.candidates import Candidates
from hexservo.campaigns.judging import Judge
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.search_steps import SearchSteps
from hexservo.campaigns.unfit import ON_GRID
from hexservo.campaigns.worst_case import REFUSED
from hexservo.scenario.keys import numeric_keys

SHORT = hs.load_scenario("paper-composite").updated(
    {
        "simulation.duration": 0.05,
        "metrics.dwell": 0.01,
        "metrics.rms_start": 0.0,
        "robot.inertia": [2e-4, 2e-4, 3e-4],
    }
)
INERTIA = {"robot.inertia": {"uniform": [-1e-4, 1e-4], "add": True, "each": True}}
REQUIRE = ["outcome == completed", "peak_leg_excursion <= 0.1"]
REMEDY = "; narrow or clip what varies"


def file_of(**keys: Any) -> dict[str, Any]:
    return {"scenario": SHORT, "vary": INERTIA, "require": REQUIRE, "runs": 1, **keys}


def with_valid_runs(count: int, **keys: Any) -> CampaignPlan:
    """A plan whose first runs are valid, by its stream."""
    for stream in range(50):
        plan = load_plan(file_of(runs=count, **keys) | {"stream": stream}) if is_valid(stream, keys, 1) else None
        if plan is not None and is_valid(stream, keys, count):
            return plan
    raise AssertionError("no stream has valid runs")


def is_valid(stream: int, keys: dict[str, Any], count: int) -> bool:
    try:
        plan = load_plan(file_of(**keys) | {"stream": stream})
        return len(Judge(plan, 1).judged(plan.drawing().numbers(0, count))[1]) == count
    except hs.ScenarioError:
        return False


def is_a_body(numbers: dict[str, Any]) -> Any:
    """Whether no principal moment exceeds the sum of the others, by row."""
    moments = numbers["robot.inertia"]
    return 2 * moments.max(axis=1) <= moments.sum(axis=1)


def test_a_batch_leaves_out_what_is_no_valid_scenario() -> None:
    plan = with_valid_runs(1)
    judge = Judge(plan, 1)
    numbers = judge.drawing.numbers_at(np.random.default_rng(1).random((40, 3)), 0)
    body = is_a_body(numbers)
    kept, margins, batch = judge.judged_where_valid(numbers)
    assert 0 < len(kept) < 40
    np.testing.assert_array_equal(kept, np.flatnonzero(body))
    assert batch is not None
    assert (len(batch), judge.runs, judge.refused) == (len(kept), len(kept), 40 - len(kept))
    assert judge.refusal.startswith("robot.inertia: expected principal moments")
    alone, _ = judge.judged({key: values[kept] for key, values in numbers.items()})
    np.testing.assert_array_equal(margins, alone)
    refused = {key: values[~body] for key, values in numbers.items()}
    kept, margins, batch = judge.judged_where_valid(refused)
    assert (len(kept), margins.shape, batch) == (0, (0, 2), None)


def test_runs_of_a_search_end_at_singular_poses_whatever_is_required() -> None:
    """As those of `simulate` do, though the settling time needs no legs."""
    vary = {"uncertainty.gravity": {"choice": [0.5]}}
    plan = load_plan({"scenario": "paper-gravity", "runs": 1, "vary": vary, "require": ["final_error <= 1"]})
    batch = Judge(plan, 1).judged(plan.drawing().numbers(0, 1))[1]
    alone = hs.simulate(plan.scenario.updated({"uncertainty.gravity": 0.5}))
    assert batch.outcome.tolist() == [alone.outcome] == ["singular"]


def test_the_worst_case_leaves_out_what_is_no_valid_scenario(tmp_path: Path) -> None:
    result = hs.campaign(with_valid_runs(2), tmp_path / "out", threads=1)
    case = hs.worst_case(result, runs=30, restarts=1, threads=1)
    assert case.refused > 0
    assert abs(case.margin) < REFUSED
    assert case.scenario == hs.load_scenario(str(case.path))
    sentence = f"{case.refused} points of the box are no valid scenario, as no run of the campaign is, and were left"
    found = [each for each in case.section().sentences if each.startswith(sentence)]
    assert len(found) == 1
    assert "Of the first: robot.inertia: expected principal moments" in found[0]


TUNE: dict[str, Any] = {"variables": {"controller.composite.kt": {"log": [0.01, 100]}}, "minimise": "rms_error"}


def searched(folder: Path, plan: CampaignPlan) -> tuple[Any, int, int]:
    """The worse cases of a candidate, and how many points were simulated and left out."""
    steps = SearchSteps(folder, plan, 0, 1, print)
    assert plan.tune is not None
    with steps.opened():
        candidates = Candidates(plan, plan.tune, steps, 0, 1)
        return candidates.worse_cases(np.array([0.5])), candidates.runs, candidates.refused


def test_a_search_for_gains_leaves_out_what_is_no_valid_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexservo.campaigns.candidates._WORST_RUNS", 40)
    plan = with_valid_runs(2, tune={**TUNE, "over": 2})
    (joining, margin), runs, refused = searched(tmp_path / "out", plan)
    assert refused > 0
    assert abs(margin) < REFUSED
    for numbers in joining:
        assert is_a_body(numbers).all()
    (again, same), *counts = searched(tmp_path / "out", plan)  # of the steps that are kept
    assert (same, *counts) == (margin, runs, refused)
    assert len(again) == len(joining)


def test_corners_that_are_no_valid_scenario_are_left_out(tmp_path: Path) -> None:
    """In parts of 1e-4 kg m^2: 1.1 or 2.95, 1.1 or 2.95, 2.1 or 3.95, of which (1.1, 1.1, 3.95) is no body."""
    vary = {"robot.inertia": {"uniform": [-0.9e-4, 0.95e-4], "add": True, "each": True}}
    plan = with_valid_runs(1, vary=vary, tune={**TUNE, "over": "corners"})
    assert plan.tune is not None
    steps = SearchSteps(tmp_path / "out", plan, 0, 1, print)
    candidates = Candidates(plan, plan.tune, steps, 0, 1)
    assert (candidates.count, candidates.refused) == (7, 1)
    assert is_a_body(candidates.numbers).all()


@pytest.mark.parametrize("estimate", ["sensitivity", "estimate_rare_failures"])
def test_an_estimate_refuses_a_draw_with_its_numbers(estimate: str) -> None:
    plan = with_valid_runs(1)
    samples = 16 if estimate == "sensitivity" else 100
    with pytest.raises(hs.ScenarioError, match=r"^the draw of robot.inertia\[0\] [\d.e-]+, robot.inertia\[1\] ") as one:
        getattr(hs, estimate)(plan, samples=samples, threads=1)
    assert str(one.value).endswith(REMEDY)
    drawn = re.findall(r"robot.inertia\[\d\] ([\d.e-]+)[,:]", str(one.value))
    assert not is_a_body({"robot.inertia": np.array([drawn], dtype=float)}).any()


def test_distributions_of_which_most_draws_are_no_valid_scenario_are_refused() -> None:
    most = {"robot.inertia": {"uniform": [-1.9e-4, 1e-3], "add": True, "each": True}}
    numbers = [load_plan(file_of()).changed(stream=stream).drawing().numbers(0, 1) for stream in range(9)]
    assert not all(is_a_body(one).all() for one in numbers), "run 0 of some is none"
    refused = next(stream for stream in range(50) if not is_valid(stream, {"vary": most}, 1))
    with pytest.raises(hs.ScenarioError, match=r"^vary: run 0: robot.inertia: expected principal moments") as one:
        load_plan(file_of(vary=most, stream=refused))
    assert str(one.value).endswith(REMEDY)


EACH: dict[str, Any] = {"uniform": [-0.3, 0.3], "each": True}
DISPLACED: dict[str, Any] = {
    "target.translation": {"uniform": [-0.005, 0.005], "each": True},
    "target.rotation": {"uniform": [-0.02, 0.02], "each": True},
}


def displaced(**vary: Any) -> dict[str, Any]:
    """A campaign of a law that needs the goal pose, with displaced targets."""
    short = {"simulation.duration": 0.05, "metrics.dwell": 0.01, "metrics.rms_start": 0.0}
    scenario = hs.load_scenario("reachy-mini-head").updated(short)
    return {"scenario": scenario, "vary": vary | DISPLACED, "require": REQUIRE[:1], "runs": 60}


DEFORMED = r"depth errors of each point deform a target .*: use one depth error of all points .*, or narrow them$"


def test_depth_errors_of_each_point_of_a_displaced_target_are_named(tmp_path: Path) -> None:
    file = displaced(**{"uncertainty.depth": EACH}) | {"stream": 1}  # whose first run is valid
    result = hs.campaign(file, tmp_path / "out", threads=1)
    message = result.summary["refusal"]
    assert re.match(r"run \d+ \(.*\): target.desired_features: .*" + DEFORMED, message)
    run = int(re.findall(r"^run (\d+)", message)[0])
    for key, values in load_plan(file).drawing().numbers(run, run + 1).items():
        shown = [float(number) for number in re.findall(rf"{re.escape(key)}\[\d\] ([\d.e-]+)[,)]", message)]
        np.testing.assert_allclose(shown, values[0], rtol=1e-3)
    with pytest.raises(hs.ScenarioError, match=r"^the draw of uncertainty.depth\[0\] .*" + DEFORMED) as one:
        hs.sensitivity(load_plan(file), samples=64, threads=1)
    assert str(one.value).count("uncertainty.depth[0]") == 1


def test_a_campaign_leaves_out_what_is_no_valid_scenario(tmp_path: Path) -> None:
    """By the index of each draw, at any division into chunks; the interval is that of the valid ones."""
    plan = with_valid_runs(1).changed(runs=40)
    body = is_a_body({"robot.inertia": plan.drawing().numbers(0, 40)["robot.inertia"]})
    assert 20 < body.sum() < 40
    found = []
    for size in (3, 40):
        result = hs.campaign(plan.changed(chunk_size=size), tmp_path / str(size), threads=1)
        assert result.complete
        assert result.to_dataframe()["index"].tolist() == np.flatnonzero(body).tolist()
        assert (len(result), result.summary["refused"]) == (body.sum(), 40 - body.sum())
        assert result.interval == plan.interval(0, int(body.sum()))
        assert result.summary["refusal"].startswith(f"run {int(np.argmin(body))}: robot.inertia: expected principal")
        assert result.section().verdict == "warning"
        sentence = f"{40 - body.sum()} of 40 draws are no valid scenario and were left out"
        assert any(one.startswith(sentence) for one in result.section().sentences)
        (result.folder / "summary.json").unlink()  # counted again, of the chunks
        assert hs.load_campaign(result.folder).summary == result.summary
        found.append(result.to_dataframe())
    assert found[0].equals(found[1])


# 42 % of these are no body: those with one large moment, 3 (1/4) (3/4)^2 of them.
OFTEN = {"robot.inertia": {"choice": [1e-4, 1e-4, 1e-4, 4e-4], "each": True}}


@pytest.mark.parametrize("size", [1, 7, 25, 400])
def test_a_campaign_of_which_most_draws_are_refused_ends_at_the_same_draw(tmp_path: Path, size: int) -> None:
    """At the first of at least 20 draws of which more than half are refused, by the closed form of a body."""
    for stream in range(50):
        plan = load_plan(file_of(vary=OFTEN, runs=400)).changed(stream=stream, chunk_size=size)
        body = is_a_body(plan.drawing().numbers(0, 400))
        refused = np.cumsum(~body)
        most = 2 * refused > np.arange(1, 401)
        if body[0] and not most[19] and most[19:].any():
            break
    drawn = 20 + int(np.argmax(most[19:]))
    message = (
        rf"^vary: expected distributions of which most draws are valid scenarios, got {refused[drawn - 1]} of the "
        rf"first {drawn} that are none; the first of these: run {int(np.argmin(body))}: robot.inertia: expected "
        rf".*{REMEDY}$"
    )
    for _ in range(2):  # of the chunks that are kept, too
        with pytest.raises(hs.ScenarioError, match=message):
            hs.campaign(plan, tmp_path / "out", threads=1)


def test_more_runs_are_added_where_draws_are_refused(tmp_path: Path) -> None:
    """The last chunk becomes longer; the table is that of a campaign that began with as many."""
    plan = with_valid_runs(1)
    for runs in (10, 40):
        result = hs.campaign(plan.changed(runs=runs, chunk_size=8), tmp_path / "more", threads=1)
    whole = hs.campaign(plan.changed(runs=40, chunk_size=8), tmp_path / "whole", threads=2)
    assert result.to_dataframe().equals(whole.to_dataframe())
    assert result.summary["refused"] == whole.summary["refused"] > 0
    refused = int(np.setdiff1d(np.arange(40), whole.to_dataframe()["index"])[0])
    with pytest.raises(hs.ScenarioError, match=r"^robot.inertia: expected principal"):
        whole.scenario(refused)
    index = int(whole.to_dataframe()["index"].iloc[-1])
    assert index >= len(whole) > refused
    whole.scenario(index)  # by the index of its draw


@pytest.mark.parametrize("remedy", ["one depth", "no displacement", "narrow"])
def test_the_remedies_for_depth_errors_of_displaced_targets_help(tmp_path: Path, remedy: str) -> None:
    depth = {
        "one depth": {"uniform": [-0.3, 0.3]},
        "no displacement": EACH,
        "narrow": {"uniform": [-0.03, 0.03], "each": True},
    }
    file = displaced(**{"uncertainty.depth": depth[remedy]})
    if remedy == "no displacement":
        file["vary"] = {"uncertainty.depth": EACH}
    assert hs.campaign(file, tmp_path / "out", threads=1).summary["runs"] == 60


@pytest.mark.parametrize("name", ["composite-30hz", "pi-h824-positions"])
def test_a_key_of_a_grid_takes_listed_numbers(name: str) -> None:
    """These are the keys that refuse a number which is none of their grid."""
    scenario = hs.load_scenario(name)
    for key in numeric_keys(scenario.controller.law, scenario.target.count):
        try:
            scenario.updated({key: 0.0123457})
            off_grid = False
        except hs.ScenarioError as error:
            off_grid = "; nearest: " in str(error)
        assert off_grid == (key in ON_GRID), key
        if off_grid:
            vary = {key: {"uniform": [0.01, 0.02]}}
            file = {"scenario": scenario, "vary": vary, "require": ["outcome == completed"], "runs": 3}
            message = rf"^vary.{key}: expected {{choice: \[...\]}} of {re.escape(ON_GRID[key])}, got uniform$"
            with pytest.raises(hs.ScenarioError, match=message):
                load_plan(file)
