"""Slips in a file that are named as such: leg lengths for travel, other units, a target behind, a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo.campaigns.names import campaign_names
from hexservo.campaigns.plan import load_plan
from hexservo.cli.commands import app
from hexservo.findings.analysis import conditioning
from hexservo.findings.analysis.conditioning import GRIP
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import notes
from without_runs import unlikely_without_runs

NAME = "pi-h824-positions"


def machine(**changes: Any) -> hs.Scenario:
    """The scenario of a file with changes of its robot, its tag and all that follows from it."""
    return hs.load_scenario(NAME, {key.replace("__", "."): value for key, value in changes.items()})


def refusal(**changes: Any) -> str:
    with pytest.raises(hs.ScenarioError) as caught:
        machine(**changes)
    (problem,) = caught.value.problems
    return problem


@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_leg_lengths_in_place_of_the_stroke_are_named(unit: float) -> None:
    """Legs of L at home that go from L - 10 mm to L + 10 mm."""
    home = float(np.mean(scene_of(machine()).hexapod.home_lengths))
    problem = refusal(robot__stroke=[unit * (home - 0.01), unit * (home + 0.01)])
    assert problem.startswith("robot.stroke: expected [shortest, longest] travel with home between them")
    assert problem.endswith(f"; of leg lengths less the {home:.3g} m at home: [-0.01, 0.01]")
    assert "of leg lengths" not in refusal(robot__stroke=[unit * (home + 0.01), unit * (home + 0.02)])


def test_a_mass_in_grams_is_named() -> None:
    """5 kg with 0.03 kg m^2, whose centre is 20 mm off: m d^2 is 0.002 kg m^2 in kg, and 2 kg m^2 in g."""
    off = {"robot__centre_of_mass": [0.0, 0.0, -0.02]}
    mass = machine().robot.mass
    machine(**off)
    problem = refusal(robot__mass=1e3 * mass, **off)
    assert f"20 mm from the origin (robot.centre_of_mass) takes {1e3 * mass * 0.02**2:g} kg m^2" in problem
    assert problem.endswith(f"in g it would be {mass:g} kg")
    assert refusal(robot__centre_of_mass=[0.0, 0.0, -20.0]).endswith("in mm it would be 20 mm")
    heavy = unlikely_without_runs(machine(robot__mass=1e3 * mass))
    (sentence,) = (each for each in heavy if each.startswith("robot.mass"))
    assert sentence.endswith(f"in g it would be {mass:g} kg")
    assert not [each for each in unlikely_without_runs(machine()) if each.startswith("robot.mass")]


@pytest.mark.parametrize("key", ["actuators.position.speed_limit", "robot.speed_limit"])
def test_a_speed_in_mm_per_s_is_named(key: str) -> None:
    """A travel t is crossed in t/v: less than 20 ms from v = 50 t/s on."""
    travel = 2.0 * machine().robot.stroke
    for factor, named in ((51.0, True), (49.0, False)):
        changed = machine(**{key: factor * travel})
        found = [each for each in unlikely_without_runs(changed) if each.startswith(f"{key}: with ")]
        assert bool(found) is named
    assert f"in mm/s it would be {0.051 * travel * 1e3:.3g} mm/s" in next(
        each for each in unlikely_without_runs(machine(**{key: 51.0 * travel})) if each.startswith(f"{key}: with ")
    )


def test_a_tag_behind_the_camera_is_not_one_with_its_back_to_it() -> None:
    scenario = machine()
    home_z = scenario.robot.home_position[2]
    camera_z = home_z + scenario.camera.mount.position[2]
    above = camera_z - 0.3
    pose = {"target__points": None, "target__tag": {"size": 0.05, "pose": [0.0, 0.0, above, 0.0, 0.0, 0.0]}}
    machine(**pose)
    assert "with its back to it" in refusal(
        **{**pose, "target__tag": {"size": 0.05, "pose": [0.0, 0.0, above, np.pi, 0.0, 0.0]}}
    )
    below = refusal(**{**pose, "target__tag": {"size": 0.05, "pose": [0.0, 0.0, -above, 0.0, 0.0, 0.0]}})
    assert f"got one {1e3 * (-above - camera_z):.3g} mm behind it" in below
    assert "has a negative z" in below
    in_mm = refusal(**pose, robot__home_position=[0.0, 0.0, 1e3 * home_z])
    assert "behind it; robot.home_position: " in in_mm
    assert in_mm.endswith(f"in mm it would be {-1e3 * home_z:.3g} mm")


def test_a_campaign_and_a_scenario_are_named_where_the_other_is_expected(tmp_path: Path) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text("scenario: paper\nvary: {seed: each}\nrequire: [outcome == completed]\nruns: 10\n")
    with pytest.raises(hs.ScenarioError, match="expected a scenario, got a campaign") as caught:
        hs.load_scenario(file)
    assert len(caught.value.problems) == 1
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(hs.load_scenario("paper").to_yaml())
    with pytest.raises(hs.ScenarioError, match=r"expected a campaign, .* got a scenario") as caught:
        load_plan(scenario)
    assert len(caught.value.problems) == 1
    with pytest.raises(hs.ScenarioError, match="which is that of a scenario"):
        load_plan("paper")


def test_the_help_lists_the_packaged_campaigns() -> None:
    shown = "".join(CliRunner().invoke(app, ["campaign", "--help"]).stdout.split())  # names break at hyphens
    assert f"({','.join(campaign_names())})" in shown
    assert len(campaign_names()) == 4


def test_a_note_names_a_tag_that_one_image_constrains() -> None:
    """The uncertainty of the scenario with the tag that is named is the tenth of the stroke which is the limit."""
    scenario = machine()
    (note,) = (each for each in notes(scenario) if "makes the pose uncertain" in each)
    assert scenario.target.points is not None
    points = np.asarray(scenario.target.points)
    side = float(np.linalg.norm(points[1] - points[0]))
    named = 1e-3 * float(note.partition("a square of ")[2].partition(" mm")[0])
    assert note.endswith(f"(it has {1e3 * side:g} mm)")
    assert named > side
    goal = scene_of(scenario)
    middle = points.mean(axis=0)
    larger = scenario.updated({"target.points": (middle + named / side * (points - middle)).tolist()})
    pose = conditioning.analyse(scenario).goals
    assert pose is not None
    goal_image = hs.project(larger, pose.best.displacement)
    found = conditioning.analyse(larger.updated({"target.desired_features": goal_image.tolist()}))
    assert found.goal is not None
    worst = found.noise * max(found.start.worst, found.goal.worst) / goal.stroke_length
    assert worst == pytest.approx(GRIP, rel=0.01)
