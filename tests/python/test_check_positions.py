"""`hexservo check` and `diagnose` on the limits of legs that take positions, against runs and closed forms."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy import optimize

import hexservo as hs
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_sag import sag_of
from hexservo.findings.check_way import way_of
from without_runs import unlikely_without_runs


@pytest.fixture(scope="module")
def machine() -> hs.Scenario:
    return hs.load_scenario("pi-h824-positions")


def sentences(scenario: hs.Scenario, key: str) -> list[str]:
    """Return the warnings that begin with a key."""
    return [sentence for sentence in unlikely_without_runs(scenario) if sentence.startswith(f"{key}: ")]


# ---- The limit of a leg's speed -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [0.02, None])
def test_a_speed_limit_that_no_command_keeps_to_is_named(machine: hs.Scenario, kept: float | None) -> None:
    """And what the sentence advises makes the run complete, slower."""
    limit, key = 0.004, "actuators.position.speed_limit"
    stopped = machine.updated({"robot.speed_limit": limit, "robot.on_limit": "stop", key: kept})
    assert hs.simulate(stopped).outcome == "leg_limit"
    (sentence,) = sentences(stopped, "robot.speed_limit")
    assert sentence.startswith("robot.speed_limit: 4 mm/s is ")
    assert ("is null" if kept is None else "up to 20 mm/s") in sentence
    assert sentence.endswith("set both to 4 mm/s")
    advised = stopped.updated({key: limit})
    assert sentences(advised, "robot.speed_limit") == []
    found = hs.metrics(hs.simulate(advised))
    assert math.isfinite(found["settling_time"])
    assert 0.9 * limit < found["peak_leg_speed"] <= limit


def test_limits_that_act_are_not_named(machine: hs.Scenario) -> None:
    assert sentences(machine.updated({"robot.speed_limit": 0.03}), "robot.speed_limit") == []
    forces = hs.load_scenario("paper").updated({"robot.speed_limit": 1.0})  # whose legs take no positions
    assert sentences(forces, "robot.speed_limit") == []


def test_legs_that_exceed_their_speed_are_commanded_more_slowly(machine: hs.Scenario) -> None:
    """In place of faster legs; legs of forces have no such command."""
    stopped = machine.updated({"robot.speed_limit": 0.004, "robot.on_limit": "stop"})
    cause = hs.diagnose(hs.simulate(stopped)).causes[0]
    assert cause.cause == "leg_limits"
    assert cause.remedy is not None
    assert cause.remedy.works
    assert cause.remedy.changes == {"actuators.position.speed_limit": 0.004}
    assert cause.remedy.words == "commands of at most 4 mm/s"


# ---- Time for the way to the goal -----------------------------------------------------------------------------------


RESPONSE = "actuators.position"


def travel(scenario: hs.Scenario) -> float:
    """Return how far the leg goes that goes farthest from home to the goal [m]."""
    scene = scene_of(scenario)
    goals = find_goals(scene)
    assert goals is not None
    return float(np.abs(scene.leg_travel(goals.best.view.pose) - scene.leg_travel(scene.home)).max())


def of_length(scenario: hs.Scenario, duration: float) -> hs.Scenario:
    step = scenario.simulation.step
    return scenario.updated({"simulation.duration": step * round(duration / step)})


@pytest.mark.parametrize("name", ["pi-h824-positions", "rubin-camera-positions"])
@pytest.mark.parametrize("key", [f"{RESPONSE}.speed_limit", "controller.tracking.bandwidth"])
def test_a_run_too_short_for_the_way_is_named_with_one_that_settles(name: str, key: str) -> None:
    """A limit for which the way takes 1.3 times the run; with the advised duration it settles, as late as stated."""
    base = hs.load_scenario(name)
    duration = base.simulation.duration
    way = way_of(scene_of(base))
    assert way is not None
    assert 0.8 * travel(base) < way.travel < travel(base)
    # of a double pole: (1 + x) exp(-x) is left at x
    x = optimize.brentq(lambda x: (1.0 + x) * math.exp(-x) - way.share, 0.0, 50.0)
    slow = way.travel / (1.3 * duration) if "limit" in key else x / (2.0 * math.pi * 1.3 * duration)
    scenario = base.updated({key: slow})
    assert math.isnan(hs.metrics(hs.simulate(scenario))["settling_time"])
    (sentence,) = sentences(scenario, "simulation.duration")
    assert key in sentence
    advised = re.search(r"take about ([\d.]+) s, or a larger ", sentence)
    assert advised is not None
    settling = hs.metrics(hs.simulate(of_length(scenario, float(advised.group(1)))))["settling_time"]
    assert settling == pytest.approx(1.3 * duration, rel=0.1)
    assert sentences(of_length(scenario, float(advised.group(1))), "simulation.duration") == []
    assert sentences(base, "simulation.duration") == []


def test_no_run_that_settles_is_too_short(machine: hs.Scenario) -> None:
    """Limits from far too low to harmless: each run with a warning does not settle, and some without do."""
    found = []
    for key, usual in ((f"{RESPONSE}.speed_limit", 0.02), (f"{RESPONSE}.acceleration_limit", 0.05)):
        for factor in np.logspace(-4, 0, 9):
            scenario = machine.updated({key: usual * factor})
            settles = math.isfinite(hs.metrics(hs.simulate(scenario))["settling_time"])
            found.append((bool(sentences(scenario, "simulation.duration")), settles))
    assert (True, True) not in found
    assert found.count((True, False)) >= 4
    assert found.count((False, True)) >= 4


def test_tasks_without_a_way_to_a_goal_at_rest_have_no_least_duration(machine: hs.Scenario) -> None:
    slow = machine.updated({f"{RESPONSE}.speed_limit": 1e-6})
    assert sentences(slow, "simulation.duration")
    for changes in (
        {"controller.tracking.follow": "direction"},
        {"target.motion": {"kind": "velocity", "velocity": [1e-4, 0.0, 0.0]}},
        {"simulation.duration": 1e6 * machine.simulation.step, "metrics.band": 500.0},
    ):
        assert sentences(slow.updated(changes), "simulation.duration") == []


def test_legs_that_need_a_longer_run_are_given_one(machine: hs.Scenario) -> None:
    """The remedy against limits of the legs is the time that they need, not legs without limits."""
    way = way_of(scene_of(machine))
    assert way is not None
    slow = machine.updated({f"{RESPONSE}.speed_limit": way.travel / (1.3 * machine.simulation.duration)})
    cause = hs.diagnose(hs.simulate(slow)).causes[0]
    assert cause.cause == "leg_rates"
    assert cause.remedy is not None
    assert cause.remedy.works
    assert set(cause.remedy.changes) == {"simulation.duration"}


# ---- Motors that yield to the weight --------------------------------------------------------------------------------


def test_an_offset_of_soft_motors_is_named_with_what_corrects_it(machine: hs.Scenario) -> None:
    """To first order it is that of the run, stiff motors have none, and an integral with a small band settles it."""
    exact = {"camera.noise": 0.0, "sensors.resolution": 0.0, "simulation.substeps": 40}
    motor = {"damping": 100.0, "friction": 0.0, "armature": 0.5}
    soft = machine.updated(
        {
            **exact,
            "actuators.kind": "position_torque",
            **{f"actuators.motor.{name}": value for name, value in motor.items()},
            "actuators.motor.kp": 2100.0,
            "actuators.motor.kv": 21.0,
        }
    )
    sag = sag_of(scene_of(soft))
    assert sag is not None
    found = hs.metrics(hs.simulate(soft))
    assert math.isnan(found["settling_time"])
    assert sag.pixels == pytest.approx(found["final_error"], rel=0.15)
    (sentence,) = sentences(soft, "actuators.motor.kp")
    assert f"rests about {sag.pixels:.2g} px from the goal" in sentence
    band = float(np.abs(sag.legs).max()) / 4.0
    turn = band / scene_of(soft).platform_radius
    law = {"controller.tracking.integral": 2.0, "controller.tracking.band": [band] * 3 + [turn] * 3}
    assert sentences(soft.updated(law), "actuators.motor.kp") == []
    assert math.isfinite(hs.metrics(hs.simulate(soft.updated(law)))["settling_time"])
    stiff = soft.updated({"actuators.motor.kp": 1e5, "actuators.motor.kv": 1e3})
    assert sentences(stiff, "actuators.motor.kp") == []
    assert math.isfinite(hs.metrics(hs.simulate(stiff))["settling_time"])
