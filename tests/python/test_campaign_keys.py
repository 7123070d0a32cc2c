"""Keys that a campaign or a search refuses since they act in none of its runs, and loops that a scenario lacks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.campaigns.loop_numbers import decay_rate, without_loop
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, loop_at_rest
from hexservo.scenario.keys import value_at

NOISE = {"camera.noise": {"uniform": [0.1, 0.6]}}
BANDWIDTH = "controller.tracking.auto.bandwidth"
WRITTEN = "controller.tracking.bandwidth"
LIMITS = {"robot.force_limit": 1e-3, "robot.stroke": 1e-5, "robot.speed_limit": 1e-9, "robot.joint_limit": 1e-9}


def plan_of(scenario: Any, vary: dict[str, Any], tune: dict[str, Any] | None = None) -> CampaignPlan:
    file = {"scenario": scenario, "vary": vary, "require": ["outcome == completed"], "runs": 4, "tune": tune}
    return load_plan(file)


# ---- Gains that follow a bandwidth ----------------------------------------------------------------------------------


def ranged(*keys: str) -> dict[str, Any]:
    return {key: {"uniform": [1.0, 2.0]} for key in keys}


@pytest.mark.parametrize("at_default", [False, True])
def test_a_bandwidth_is_refused_beside_the_gain_that_follows_it(at_default: bool) -> None:
    """Wherever that gain varies: its range may begin at the value that it has without a bandwidth."""
    scenario = hs.load_scenario("pi-h824-positions").updated({"simulation.duration": 0.4})
    low = value_at(scenario, WRITTEN) if at_default else 1.9
    gain = {WRITTEN: {"uniform": [low, 2.5]}}
    of_run = {WRITTEN: np.array([2.0, 2.0]), BANDWIDTH: np.array([0.5, 3.0])}
    same = hs.simulate_batch(scenario, of_run, log="metrics").metrics
    assert all(np.array_equal(values[0], values[1], equal_nan=True) for values in same.values())
    message = f"{BANDWIDTH}: has no effect here; it acts only where a gain that follows from it acts and is not given"
    with pytest.raises(hs.ScenarioError, match=f"^vary.{message}"):
        plan_of(scenario, gain | ranged(BANDWIDTH))
    plan_of(scenario, NOISE | ranged(BANDWIDTH))


def test_a_search_refuses_a_bandwidth_beside_the_gain_that_follows_it() -> None:
    scenario = "pi-h824-positions"
    message = f"^tune.variables.{BANDWIDTH}: has no effect here; it acts only where a gain that follows from it acts"
    with pytest.raises(hs.ScenarioError, match=message):
        plan_of(scenario, ranged(WRITTEN), {"variables": ranged(BANDWIDTH)})
    with pytest.raises(hs.ScenarioError, match=message):
        plan_of(scenario, NOISE, {"variables": ranged(BANDWIDTH, WRITTEN)})
    plan_of(scenario, NOISE, {"variables": ranged(BANDWIDTH)})


def test_a_bandwidth_acts_where_one_of_its_gains_is_left_to_it() -> None:
    block = "controller.pbvs"
    auto, damping = f"{block}.auto.bandwidth", f"{block}.auto.damping"
    plan_of("reachy-mini-head", ranged(auto, f"{block}.kp"))
    plan_of("reachy-mini-head", ranged(auto, damping, f"{block}.kp"))
    for key, others in ((auto, ("kp", "kd")), (damping, ("kd",))):
        with pytest.raises(hs.ScenarioError, match=f"^vary.{key}: has no effect here; it acts only where a gain"):
            plan_of("reachy-mini-head", ranged(key, *(f"{block}.{other}" for other in others)))


# ---- Keys that change no number of a run ----------------------------------------------------------------------------


def test_a_campaign_keeps_no_samples_that_could_vary() -> None:
    with pytest.raises(hs.ScenarioError, match=r"^vary.simulation.log_every: has no effect here; no metric of a run"):
        plan_of("pi-h824-positions", {"simulation.log_every": {"choice": [1, 2]}})


@pytest.mark.parametrize("key", LIMITS)
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("paper", {}),
        ("composite-30hz", {}),
        ("composite-30hz", {"robot.on_limit": "stop"}),
        ("saturation", {}),
        ("pi-h824-positions", {}),
        ("pi-h824-positions", {"robot.on_limit": "stop"}),
        ("reachy-mini-motors", {}),
    ],
)
def test_a_limit_varies_where_it_changes_a_run(name: str, changes: dict[str, Any], key: str) -> None:
    """A limit that every run exceeds, and one that none does: some number differs, or the campaign refuses the key."""
    large = {"robot.speed_limit": 100.0, "robot.joint_limit": [1.0, 1.0]}
    given = {"simulation.duration": 0.2, "metrics.rms_start": 0.0, "metrics.dwell": 0.1}
    scenario = hs.load_scenario(name).updated(given | large | changes)
    own = np.asarray(value_at(scenario, key))
    runs = hs.simulate_batch(scenario, {key: np.stack([np.full_like(own, LIMITS[key]), own])}, log="metrics")
    differ = any(not np.array_equal(each[0], each[1], equal_nan=True) for each in runs.metrics.values())
    vary = {key: {"uniform": [LIMITS[key], float(own.max())]}}
    if differ:
        plan_of(scenario, vary)
        return
    with pytest.raises(hs.ScenarioError, match=rf"^vary.{key}: has no effect here; .*; bound peak_\w+ .*in require"):
        plan_of(scenario, vary)


def test_a_limit_that_the_scenario_lacks_gives_its_metric_a_value() -> None:
    vary = {"robot.speed_limit": {"uniform": [0.1, 1.0]}}
    load_plan({"scenario": "composite-30hz", "vary": vary, "require": ["peak_leg_speed <= 1"], "runs": 3})


# ---- Requirements on the linear loop --------------------------------------------------------------------------------


@pytest.mark.parametrize("required", ["delay_margin >= 0.01", "decay_rate >= 0.5"])
@pytest.mark.parametrize(
    ("scenario", "gain", "reason"),
    [
        ("pi-h824-positions", BANDWIDTH, "the linear plant and loop are of a machine that takes forces, and the legs"),
        ("paper", "controller.hybrid.kp", "the law hybrid has Coulomb damping only"),
    ],
)
def test_a_number_of_a_loop_that_no_gains_have_is_refused(scenario: str, gain: str, reason: str, required: str) -> None:
    noise = NOISE if scenario != "paper" else {"uncertainty.gravity": {"uniform": [-0.1, 0.1]}}
    tune = {"variables": {gain: {"log": [0.3, 4]}}, "subject_to": [required]}
    message = "^tune.subject_to: expected a scenario with a linear loop, got one without: "
    with pytest.raises(hs.ScenarioError, match=message + reason):
        plan_of(scenario, noise, tune)


def test_a_loop_that_rests_nowhere_may_rest_with_other_gains() -> None:
    """A goal image that no pose shows: the law rests near it with a gain that is large enough."""
    scenario = hs.load_scenario("composite-30hz")
    goal = np.ravel(scenario.target.desired_features)
    goal[[0, 3]] += [50.0, -50.0]
    kp = value_at(scenario, "controller.composite.kp")
    weak, strong = (
        scenario.updated({"target.desired_features": goal.tolist(), "controller.composite.kp": kp * factor})
        for factor in (1.0, 1000.0)
    )
    with pytest.raises(NotApplicableError, match="no pose near the goal was found"):
        loop_at_rest(weak)
    loop_at_rest(strong)
    assert without_loop(weak) == without_loop(strong) == ""


@pytest.mark.parametrize(
    ("scenario", "changes", "reason"),
    [
        ("composite-30hz", {"camera.period": 0.001, "camera.latency": 2.0}, "frames are under way at once"),
        ("reachy-mini-head", {}, "The centre of mass is not in the platform's origin"),
    ],
)
def test_a_loop_that_is_not_analysed_has_a_reason(scenario: str, changes: dict[str, Any], reason: str) -> None:
    lacking = hs.load_scenario(scenario).updated(changes)
    assert reason in without_loop(lacking)
    assert math.isnan(decay_rate(lacking))
