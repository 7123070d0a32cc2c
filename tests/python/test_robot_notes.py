"""What `hexservo export` notes of a controller, against runs with its period and its brake."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import notes
from hexservo.findings.check_export import robot_notes

SAMPLED = {"simulation.mode": "sampled"}
FORCE_LIMIT = "robot.force_limit is not in the controller"

# The continuous scenarios whose loop, with forces held over their own step, is no longer that of their runs.
HELD = {"paper-no-fuzzy", "fails-wrong-sign", "false-equilibrium"}
COARSE = {"false-equilibrium", "textbook-half-turn"}


def of_period(scenario: hs.Scenario, period: float | None = None) -> list[str]:
    return [note for note in robot_notes(scenario, period) if "servo period of" in note]


def of_brake(found: list[str]) -> list[str]:
    return [note for note in found if note.startswith("controller.safe: ")]


def proposed(note: str) -> dict[str, list[float]]:
    found = re.findall(r"(controller\.safe\.\w+)=\[([^\]]*)\]", note)
    return {key: [float(value) for value in values.split(",")] for key, values in found}


def peak_force(scenario: hs.Scenario) -> float:
    return float(hs.metrics(hs.simulate(scenario))["peak_leg_force"])


# ---- The period -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", [name for name in hs.scenario_names() if hs.load_scenario(name).simulation.mode == "continuous"]
)
def test_without_a_note_the_loop_works_with_the_period_of_a_continuous_scenario(name: str) -> None:
    """As well as with half of it; a note of a run is of one that ends."""
    scenario = hs.load_scenario(name)
    found = of_period(scenario)
    assert len(found) == (name in HELD) + (name in COARSE)
    held = [
        hs.simulate(scenario.updated({**SAMPLED, "simulation.step": factor * scenario.simulation.step}))
        for factor in (1.0, 0.5)
    ]
    assert (held[0].outcome == "completed") == (name not in HELD)
    if not found:
        errors = [float(hs.metrics(run)["final_error"]) for run in held]
        assert errors[0] == pytest.approx(errors[1], rel=0.1, abs=0.1)


@pytest.mark.parametrize(
    ("period", "noted", "ends"), [(0.001, False, False), (0.002, True, False), (0.005, True, True), (0.02, True, True)]
)
def test_a_period_that_a_continuous_run_does_not_have_is_judged(
    paper: hs.Scenario, period: float, noted: bool, ends: bool
) -> None:
    """Given as `--period` or as the step; the exported tick in the loop ends where the note states it."""
    for scenario, given in ((paper, period), (paper.updated({"simulation.step": period}), None)):
        found = of_period(scenario, given)
        assert [("coarser than a tenth" in note, "ends as" in note) for note in found] == [
            *([(True, False)] if noted else []),
            *([(False, True)] if ends else []),
        ]
        if noted:
            assert "a run in continuous mode has no servo period; run the scenario with simulation.mode=" in found[0]
            assert ("simulation.step=" in found[0]) == (given is not None)
    run = hs.simulate(paper.updated({**SAMPLED, "simulation.step": period}))
    assert (run.outcome != "completed") == ends


def test_a_period_of_a_sampled_scenario_is_judged_like_its_step() -> None:
    scenario = hs.load_scenario("moog-6dof2000e")
    assert of_period(scenario) == []
    (note,) = of_period(scenario, 0.034)
    assert note == (
        "the servo period of 34 ms is coarser than a fifth of the gains' shortest time constant, 28 ms; run the "
        "scenario with simulation.step=0.034 and simulation.duration=15.028 before a robot"
    )
    changed = scenario.updated({"simulation.step": 0.034, "simulation.duration": 15.028})
    (own,) = of_period(changed)  # what `hexservo check` warns of
    assert own == note.partition(";")[0]


# ---- The brake ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2])
def test_the_gains_that_are_proposed_for_the_brake_keep_the_legs_within_their_forces(seed: int) -> None:
    """With half of the frames lost, so that the brake acts again and again while the platform is fast."""
    changes: dict[str, Any] = {"camera.timeout": 0.1, "camera.dropout": 0.5, "seed": seed}
    scenario = hs.load_scenario("moog-6dof2000e").updated(changes)
    limit = scenario.robot.force_limit
    (note,) = of_brake(notes(scenario))
    assert of_brake(robot_notes(scenario)) == [note]
    mended = scenario.updated(proposed(note))
    assert of_brake(notes(mended)) == []
    assert peak_force(scenario) > limit > peak_force(mended)
    settled = [float(hs.metrics(hs.simulate(each))["settling_time"]) for each in (scenario, mended)]
    assert settled[1] < settled[0]


def test_the_brake_needs_what_it_does_by_hand(paper: hs.Scenario) -> None:
    """200 1/s times the inertia and the fastest twist, by H at home, with the weight: the limit that has no note."""
    scenario = paper.updated({**SAMPLED, "camera.timeout": 0.1})
    scene = scene_of(scenario)
    wrenches = 200.0 * np.asarray(hs.simulate(scenario).twist) @ scene.machine.mass
    weight = np.asarray(scene.body.gravity_wrench)
    needed = np.abs(np.linalg.solve(scene.wrench_maps(scene.home), (weight - wrenches).T)).max()
    for factor, noted in ((1.01, False), (0.99, True)):
        found = of_brake(notes(scenario.updated({"robot.force_limit": factor * float(needed)})))
        assert bool(found) == noted
    assert f"needs {1e3 * needed:.3g} mN of leg" in found[0]


def test_a_step_of_the_encoders_is_a_force_of_the_brake() -> None:
    """One that differs by a step from the reading before, in a tick at rest without an image."""
    scenario = hs.load_scenario("reachy-mini-head")
    assert of_brake(robot_notes(scenario)) == []
    coarse = scenario.updated({"sensors.resolution": 3.0 * scenario.sensors.resolution})
    (note,) = of_brake(robot_notes(coarse))
    assert "at rest for a sensors.resolution of 4.6 mrad" in note
    home = np.asarray(scene_of(coarse).hexapod.home_lengths)

    def largest(of: hs.Scenario) -> float:
        forces = []
        for leg in range(6):
            controller = hs.Controller(of)
            unseen = (np.full(2 * len(of.target.points or ()), np.nan), np.full(len(of.target.points or ()), np.nan))
            controller.step(*unseen, leg_lengths=home)
            forces.append(controller.step(*unseen, leg_lengths=home + coarse.sensors.resolution * np.eye(6)[leg]))
        return float(max(np.abs(output.leg_forces).max() for output in forces))

    assert largest(scenario) > coarse.robot.force_limit > largest(coarse.updated(proposed(note)))


def test_no_gains_are_proposed_with_which_the_legs_leave_their_stroke() -> None:
    """Legs that have next to nothing beside the weight."""
    scenario = hs.load_scenario("moog-6dof2000e")
    scene = scene_of(scenario)
    weight = float(np.abs(scene.resting_forces(scene.home)).max())
    (note,) = of_brake(robot_notes(scenario.updated({"robot.force_limit": 1.005 * weight})))
    assert "either way: take a slower law" in note
    assert proposed(note) == {}


def test_no_brake_is_noted_where_none_acts() -> None:
    """A run without a timeout, and drives that take positions."""
    scenario = hs.load_scenario("moog-6dof2000e")
    assert of_brake(notes(scenario)) == []
    assert len(of_brake(robot_notes(scenario))) == 1
    assert of_brake(robot_notes(hs.load_scenario("pi-h824-positions"))) == []


# ---- Limits, image and assumptions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("limits", [False, True])
def test_a_force_limit_that_the_controller_does_not_have_is_noted(limits: bool) -> None:
    """A leg needs more than the limit, and `saturated` states it where the controller has it."""
    changes = {"actuators.saturation": limits, "robot.force_limit": 0.1}
    scenario = hs.load_scenario("real-machine").updated(changes)
    assert any(note.startswith(FORCE_LIMIT) for note in robot_notes(scenario)) != limits
    home = np.asarray(scene_of(scenario).hexapod.home_lengths)
    output = hs.Controller(scenario).step(hs.project(scenario, np.zeros(6)), np.full(4, -0.5), leg_lengths=home)
    assert np.abs(output.leg_forces).max() > 0.1
    assert output.saturated == limits


def test_what_a_robot_should_not_have_is_noted(paper: hs.Scenario) -> None:
    """A camera without a timeout, in both modes, and errors that are the controller's own."""
    of_points = {"controller.law": "pbvs"}
    assert "camera.timeout" in robot_notes(paper.updated(of_points))[0]
    sampled = hs.load_scenario("real-machine").updated({**of_points, "uncertainty.latency": 0.002})
    forever, wrong = robot_notes(sampled)
    assert forever.endswith("set camera.timeout for a robot")
    assert "(uncertainty.depth, uncertainty.latency)" in wrong
    right = {"camera.timeout": 0.2, "uncertainty.depth": 0.0, "uncertainty.latency": 0.0}
    assert robot_notes(sampled.updated(right)) == []
