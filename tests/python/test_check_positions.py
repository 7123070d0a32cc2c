"""`hexservo check` and `diagnose` on the limits of legs that take positions, against runs and closed forms."""

from __future__ import annotations

import math

import pytest

import hexservo as hs
from hexservo.findings.check import unlikely


@pytest.fixture(scope="module")
def machine() -> hs.Scenario:
    return hs.load_scenario("pi-h824-positions")


def sentences(scenario: hs.Scenario, key: str) -> list[str]:
    """Return the warnings that begin with a key."""
    return [sentence for sentence in unlikely(scenario) if sentence.startswith(f"{key}: ")]


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
