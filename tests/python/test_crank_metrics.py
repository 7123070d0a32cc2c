"""Names, meanings and units of the metrics of cranks, wherever people read them; keys stay those of all machines."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli.commands import app
from hexservo.cli.output import write_results
from hexservo.report.notebook import html_of
from hexservo.report.page import _metrics
from hexservo.run.metrics import METRICS, metric_label, metric_meaning, metric_name
from rotary_machine import machine

OF_LEGS = ("peak_leg_force", "peak_leg_excursion", "peak_leg_speed", "peak_base_joint", "peak_platform_joint")
LIMITS = {"robot.speed_limit": 5.0, "robot.joint_limit": [1.0, 1.0]}
PRISMATIC = re.compile(r"leg force|leg travel|largest speed of a leg|length")


@pytest.fixture(scope="module")
def head() -> hs.Scenario:
    return machine().updated({**LIMITS, "simulation.duration": 0.05})


@pytest.fixture(scope="module")
def result(head: hs.Scenario) -> hs.Result:
    return hs.simulate(head)


def test_metrics_of_cranks_are_torques_and_angles(head: hs.Scenario) -> None:
    robot, other = head.robot, hs.load_scenario("paper").robot
    assert metric_name("peak_leg_force", robot) == "peak crank torque"
    assert metric_label("peak_leg_force", robot) == "peak crank torque [N m]"
    assert metric_label("peak_leg_excursion", robot) == "peak crank excursion [rad]"
    assert metric_meaning("peak_leg_speed", robot).startswith("largest angular speed of a crank")
    for name, (_, meaning) in METRICS.items():
        assert metric_meaning(name, other) == meaning
        assert metric_name(name, other) == name.replace("_", " ")
        assert (metric_meaning(name, robot) != meaning) == (name in OF_LEGS)
        assert not PRISMATIC.search(metric_meaning(name, robot)), name


def test_the_command_and_its_files_name_cranks(head: hs.Scenario, result: hs.Result, tmp_path: Path) -> None:
    file = tmp_path / "head.yaml"
    file.write_text(head.to_yaml(), encoding="utf-8")
    told = CliRunner().invoke(app, ["run", str(file)], env={"COLUMNS": "200"}).stdout
    assert re.search(r"peak crank torque +[\d.]+ +mN m +largest torque of a crank\n", told)
    assert re.search(r"peak crank excursion +[\d.]+ +[mu]rad +largest angle of a crank", told)
    assert not PRISMATIC.search(told)
    written = json.loads((write_results(result, tmp_path / "out") / "metrics.json").read_text(encoding="utf-8"))
    assert set(written["metrics"]) == set(METRICS)
    assert written["metrics"]["peak_leg_force"]["meaning"] == "largest torque of a crank"
    assert not any(PRISMATIC.search(each["meaning"]) for each in written["metrics"].values())


def test_reports_and_datasets_name_cranks(head: hs.Scenario, result: hs.Result) -> None:
    assert "largest torque of a crank" in html_of(result)
    page = _metrics(result)
    assert "peak crank torque" in page
    assert "largest leg force" not in page
    batch = hs.simulate_batch(head, {"robot.mass": [head.robot.mass]}, log="metrics")
    attributes = batch.to_xarray()["metric_peak_leg_force"].attrs
    assert attributes == {"units": "N m", "long_name": "largest torque of a crank"}


def test_heads_of_a_comparison_are_those_of_its_legs(head: hs.Scenario) -> None:
    head = head.updated({"name": "head"})
    paper = hs.load_scenario("paper").updated({"simulation.duration": 0.05})
    first = [
        hs.compare(found, ["composite"]).to_markdown().split("\n")[0] for found in ([head], [paper], [head, paper])
    ]
    assert re.search(r"\| crank torque \[m?N m\] \|", first[0])
    assert re.search(r"\| leg force \[m?N\] \|", first[1])
    assert "| leg force, crank torque |" in first[2]
