"""What `check` and `export` note of the brake's own stability, against a closed form and runs without a frame."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from data_sheet_machines import data_sheet_machine
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.brake import Brake, BrakeLoop
from hexservo.findings.check import notes
from hexservo.findings.check_export import robot_notes

DAMPING, HOLD = "controller.safe.damping", "controller.safe.hold"
STRONG = [3000.0, 3000.0, 3000.0, 10.0, 10.0, 20.0]
BOTH: dict[str, Any] = {DAMPING: [1000.0] * 3 + [3.0, 3.0, 6.0], HOLD: [1e5] * 3 + [300.0, 300.0, 600.0]}


def of_brake(found: list[str]) -> list[str]:
    return [note for note in found if note.startswith("controller.safe: ")]


def machine(changes: dict[str, Any], *, cranks: bool = False) -> hs.Scenario:
    return data_sheet_machine(cranks=cranks).updated({"camera.timeout": 0.2, **changes})


def pasted(note: str) -> dict[str, np.ndarray[Any, Any]]:
    found = re.findall(r"(controller\.safe\.\w+)=\[([^\]]*)\]", note)
    return {key: np.array([float(value) for value in values.split(",")]) for key, values in found}


def growth(scenario: hs.Scenario) -> float:
    scene = scene_of(scenario)
    return BrakeLoop(scene, Brake(scene, scenario.simulation.step)).growth()


def speeds(scenario: hs.Scenario) -> tuple[float, float]:
    """Return the largest speed early and late in 600 ticks without a frame, from a small twist along each axis."""
    moved = {
        "camera.dropout": 1.0,
        "sensors.resolution": 0.0,
        "simulation.start.twist": [1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4],
        "simulation.duration": 600 * scenario.simulation.step,
    }
    run = hs.simulate(scenario.updated(moved))
    twist = np.abs(np.asarray(run.twist)).max(axis=1)
    return float(twist[:100].max()), float(twist[-100:].max())


@pytest.mark.parametrize("cranks", [False, True])
@pytest.mark.parametrize("factor", [0.5, 0.9, 1.1, 2.0])
def test_damping_alone_by_differences_is_stable_below_twice_the_mass_per_period(factor: float, cranks: bool) -> None:
    """z^2 - (1 - a/2) z + a/2 with a = K_s T/D: the rate is the mean over the last period, and stable are a < 2."""
    step = 1 / 150
    inertia = np.array([5.0, 5.0, 5.0, 0.0125, 0.0125, 0.025])
    scenario = machine({DAMPING: (factor * 2.0 * inertia / step).tolist(), HOLD: 0.0}, cranks=cranks)
    expected = float(np.abs(np.roots([1.0, -(1.0 - factor), factor])).max())
    assert growth(scenario) == pytest.approx(expected, rel=1e-6)
    assert len(of_brake(robot_notes(scenario))) >= (factor > 1.0)
    assert any("the brake is unstable" in note for note in of_brake(notes(scenario))) == (factor > 1.0)


def test_a_rate_of_its_own_and_drives_with_a_lag_have_other_borders() -> None:
    """True rates: 1 - a, stable for a < 2 as well; one delay more makes z^2 - z + a, stable for a < 1.

    Late leg forces of the weight are a weak spring.
    """
    step, mass = 1 / 150, np.array([5.0, 5.0, 5.0, 0.0125, 0.0125, 0.025])
    for a in (0.5, 0.9, 1.1):
        scenario = machine({DAMPING: (a * mass / step).tolist(), HOLD: 0.0, "sensors.rate": True})
        assert growth(scenario) == pytest.approx(abs(1.0 - a), rel=1e-6)
        late = growth(scenario.updated({"actuators.delay": step}))
        assert late == pytest.approx(float(np.abs(np.roots([1.0, -1.0, a])).max()), rel=1e-3)


@pytest.mark.parametrize("cranks", [False, True])
@pytest.mark.parametrize("changes", [{DAMPING: STRONG}, {DAMPING: STRONG, HOLD: 0.0}, BOTH, {HOLD: 1e5}])
def test_runs_without_frames_come_to_rest_up_to_the_gains_that_are_named(changes: dict[str, Any], cranks: bool) -> None:
    scenario = machine(changes, cranks=cranks)
    (note,) = of_brake(notes(scenario))
    assert "the brake is unstable: without an image a motion grows by" in note
    assert of_brake(robot_notes(scenario.updated({"camera.timeout": None}))) == [note]
    named = pasted(note)
    assert set(named) == set(changes)
    stable = scenario.updated({key: values.tolist() for key, values in named.items()})
    assert not any("unstable" in each for each in of_brake(notes(stable)))
    early, late = speeds(stable)
    assert late < early
    powers = {DAMPING: 1, HOLD: len(named)}
    unstable = stable.updated({key: (1.04 ** powers[key] * values).tolist() for key, values in named.items()})
    early, late = speeds(unstable)
    assert late > 2.0 * early


@pytest.mark.parametrize("cranks", [False, True])
@pytest.mark.parametrize(
    "devices",
    [
        {"actuators.delay": 2 / 150},
        {"actuators.bandwidth": 20.0},
        {"sensors.period": 2 / 150},
        {
            "sensors.period": 3 / 150,
            "actuators.delay": 1 / 150,
            "actuators.bandwidth": 30.0,
            "actuators.hold": "leg_forces",
        },
    ],
)
@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_runs_grow_as_the_loop_does_with_sensors_and_drives(
    devices: dict[str, Any], factor: float, cranks: bool
) -> None:
    """Near the border, over 550 ticks without a frame: other modes have decayed by then."""
    inertia = 150.0 * np.array([5.0, 5.0, 5.0, 0.0125, 0.0125, 0.025])

    def with_share(share: float) -> hs.Scenario:
        gains = {DAMPING: (5.0 * share * inertia).tolist(), HOLD: (300.0 * share**2 * inertia).tolist()}
        return machine({**devices, "camera.timeout": 0.5, **gains}, cranks=cranks)

    whole = with_share(1.0)
    scene = scene_of(whole)
    border = BrakeLoop(scene, Brake(scene, 1 / 150)).largest_share(1, 2)
    assert border is not None
    scenario = with_share(factor * border)
    expected = growth(scenario)
    assert (expected > 1.0) == (factor > 1.0)
    moved = {
        "camera.dropout": 1.0,
        "sensors.resolution": 0.0,
        "simulation.start.twist": [1e-5] * 3 + [1e-4] * 3,
        "simulation.duration": 900 / 150,
    }
    speed = np.abs(np.asarray(hs.simulate(scenario.updated(moved)).twist)).max(axis=1)
    assert (speed[-150:].max() / speed[200:350].max()) ** (1 / 550) == pytest.approx(expected, abs=5e-4)


def test_a_hold_without_damping_is_unstable_however_small_it_is() -> None:
    """A spring by the position a period ago: |z|^2 = 1 + K_h T^2/(2 D)."""
    (note,) = of_brake(notes(machine({DAMPING: 0.0, HOLD: 100.0})))
    assert "since a hold without damping is, with any share of these gains; null for controller.safe.damping" in note
    weak = machine({DAMPING: 0.0, HOLD: 1.0})
    assert growth(weak) == pytest.approx(np.sqrt(1.0 + 1.0 / (2.0 * 150**2 * 0.0125)), rel=1e-6)
    early, late = speeds(weak)
    assert late > early


def test_derived_gains_of_far_too_large_an_inertia_are_unstable() -> None:
    scenario = machine({"uncertainty.inertia": 0.95})
    (note,) = of_brake(notes(scenario))
    assert "of which uncertainty.inertia leaves too little" in note
    assert max(speeds(scenario)) > 100.0


@pytest.mark.parametrize("name", hs.scenario_names())
def test_the_brakes_of_packaged_scenarios_are_stable(name: str) -> None:
    assert not any("unstable" in note for note in of_brake(robot_notes(hs.load_scenario(name))))


def test_another_period_of_an_export_is_that_of_the_loop() -> None:
    scenario = machine({DAMPING: [1400.0] * 3 + [3.5, 3.5, 7.0], HOLD: 0.0})  # a = 1.87 in 1/150 s
    assert not any("unstable" in note for note in of_brake(robot_notes(scenario)))
    (note,) = (note for note in of_brake(robot_notes(scenario, 1 / 60)) if "unstable" in note)  # 4.7
    assert "16.7 ms" in note


def test_a_run_that_the_brake_ends_is_named() -> None:
    """Without gains the platform goes on until a leg leaves its stroke, which no comparison of forces shows."""
    changes = {
        "camera.dropout": 0.95,
        "robot.on_limit": "stop",
        "simulation.start.twist": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
    }
    scenario = machine({**changes, DAMPING: 0.0, HOLD: 0.0})
    assert hs.simulate(scenario).outcome != "completed"
    assert hs.simulate(machine(changes)).outcome == "completed"
    (note,) = of_brake(notes(scenario))
    assert note.startswith("controller.safe: with these gains of the brake a run ends as ")
    assert of_brake(notes(machine(changes))) == []
