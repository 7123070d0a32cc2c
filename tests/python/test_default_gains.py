"""Default gains on another machine: how far they are away, the sentence of `check`, and what `compare` does."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli.commands import app
from hexservo.scenario.default_gains import is_far, misfit, taken_over
from hexservo.scenario.laws import LAWS
from test_check_forces import machine
from without_runs import unlikely_without_runs

FORMULAS = {"pbvs": 1 / 3, "resolved_rate": 1 / 2, "composite": 1 / 2, "computed_torque": 0.0}


def heavier(scenario: hs.Scenario, factor: float, law: str, **changes: Any) -> hs.Scenario:
    robot = {"mass": factor * scenario.robot.mass, "inertia": (factor * np.array(scenario.robot.inertia)).tolist()}
    return scenario.updated({"controller.law": law, "robot": robot, **changes})


def of_defaults(scenario: hs.Scenario) -> list[str]:
    return [sentence for sentence in unlikely_without_runs(scenario) if "its gains are the defaults" in sentence]


@pytest.mark.parametrize("law", FORMULAS)
def test_the_misfit_of_a_heavier_platform(paper: hs.Scenario, law: str) -> None:
    """pbvs has x^2 and x times the mass, the others x and x times the mass: at best the cube and the square root."""
    for factor in (1.0, 1e-3, 30.0, 1e5):
        expected = max(factor, 1.0 / factor) ** FORMULAS[law]
        assert misfit(heavier(paper, factor, law)) == pytest.approx(expected, rel=0.03)  # bandwidths of 2.3 %


@pytest.mark.parametrize(
    ("law", "key", "value"),
    [("pbvs", "kp", 3.0), ("composite", "kt", 3.0), ("kelly", "kd", 3.0), ("resolved_rate", "gain", 3.0)],
)
def test_gains_that_are_fitted_or_written_are_no_defaults(paper: hs.Scenario, law: str, key: str, value: float) -> None:
    heavy = heavier(paper, 1e6, law)
    assert is_far(heavy)
    for changes in ({"auto.bandwidth": 1.0}, {key: value}):
        written = heavy.updated({f"controller.{law}.{name}": each for name, each in changes.items()})
        assert misfit(written) == 1.0
        assert not is_far(written)


def test_gains_of_hybrid_depend_on_where_the_camera_is(paper: hs.Scenario) -> None:
    """All of them have the mass as a factor, and the bandwidth; a camera on the base has another image Jacobian."""
    assert misfit(heavier(paper, 1e6, "hybrid")) == pytest.approx(1.0, abs=0.03)
    beside = hs.load_scenario("eye-to-hand").updated({"controller.law": "hybrid"})
    assert is_far(beside)
    assert not math.isfinite(hs.metrics(hs.simulate(beside))["settling_time"])


@pytest.mark.parametrize("law", ["pbvs", "resolved_rate", "composite"])
def test_default_gains_that_are_warned_of_settle_late(law: str) -> None:
    """At least three times as late as on the machine that they are of, or not at all; fitted ones settle as there."""
    alone = {"robot.gravity": 0.0, "robot.force_limit": 1e9, "simulation.duration": 10.0, "simulation.step": 2e-3}
    nominal = hs.load_scenario("paper-nominal").updated(alone)

    def time(factor: float, **changes: Any) -> float:
        named = {key.replace("__", "."): value for key, value in changes.items()}
        return hs.metrics(hs.simulate(heavier(nominal, factor, law, **named)))["settling_time"]

    factor = 1.1 * 3.0 ** (1.0 / FORMULAS[law])
    (sentence,) = of_defaults(heavier(nominal, factor, law))
    assert sentence.startswith(f"controller.{law}: its gains are the defaults, of a platform of 60 g: ")
    assert not of_defaults(heavier(nominal, 0.9 * 3.0 ** (1.0 / FORMULAS[law]), law))
    late = time(factor)
    assert math.isnan(late) or late > 3.0 * time(1.0)
    fitted = {f"controller__{law}__auto__bandwidth": 2.0}
    assert time(factor, **fitted) == pytest.approx(time(1.0, **fitted), rel=0.01)
    assert not of_defaults(heavier(nominal, factor, law, **{f"controller.{law}.auto.bandwidth": 2.0}))


def test_laws_take_over_the_bandwidth_of_a_comparison() -> None:
    """Their rows are the runs with that bandwidth; gains that are written stay."""
    scenario = machine("composite", 1.0, **{"controller.composite.auto.damping": 1.2, "simulation.duration": 3.0})
    scenario = scenario.updated({"controller.kelly.kd": 5.0, "controller.resolved_rate.auto.bandwidth": 2.0})
    compared = hs.compare([scenario], ["composite", "pbvs", "kelly", "resolved_rate"])
    auto = {"controller.law": "pbvs", "controller.pbvs.auto": {"bandwidth": 1.0, "damping": 1.2}}
    expected = hs.metrics(hs.simulate(scenario.updated(auto)))
    row = compared.row("pbvs", "five-kg")
    assert row.metrics["settling_time"] == expected["settling_time"]
    assert row.metrics["peak_leg_force"] == pytest.approx(expected["peak_leg_force"], rel=1e-6)
    assert row.settled
    with_defaults = hs.metrics(hs.simulate(scenario.updated({"controller.law": "pbvs"})))
    assert math.isnan(with_defaults["settling_time"])
    assert compared.row("kelly", "five-kg").scenario.controller.kelly.kd == 5.0
    assert compared.row("kelly", "five-kg").scenario.controller.kelly.auto.bandwidth is None
    assert compared.row("resolved_rate", "five-kg").scenario.controller.resolved_rate.auto.bandwidth == 2.0
    words = "five-kg: pbvs took over the bandwidth of controller.composite.auto, 1 Hz with a damping of 1.2, since"
    (remark,) = compared.remarks
    assert remark.startswith(words)


def test_packaged_scenarios_of_the_machine_of_the_defaults_keep_their_gains() -> None:
    for name in ("paper", "task-general", "textbook-tilt", "real-machine", "hand-eye"):
        scenario = hs.load_scenario(name)
        for law in LAWS:
            assert taken_over(scenario, law) == {}
    short = {"simulation.duration": 0.02}
    assert hs.compare(["paper", "task-tilt"], ["pbvs", "kelly"], short).remarks == ()


def test_laws_with_default_gains_on_another_machine_are_named() -> None:
    heavy = heavier(hs.load_scenario("paper"), 100.0, "computed_torque", **{"simulation.duration": 0.02})
    (remark,) = hs.compare([heavy], ["pbvs", "computed_torque"]).remarks
    assert remark.startswith("paper: pbvs had default gains, of a platform of 60 g, which do not fit this machine")


def test_the_command_and_its_folder_have_the_remarks(tmp_path: Path) -> None:
    path, out = tmp_path / "five-kg.yaml", tmp_path / "out"
    path.write_text(machine("composite", 1.0, **{"simulation.duration": 0.1}).to_yaml())
    text = path.read_text()
    run = CliRunner().invoke(app, ["compare", "--scenarios", str(path), "--laws", "pbvs,kelly", "--out", str(out)])
    assert run.exit_code == 0, run.output
    words = "five-kg: pbvs and kelly took over the bandwidth of controller.composite.auto, 1 Hz"
    assert words in " ".join(run.stdout.split()), text
    assert (out / "comparison.md").read_text(encoding="utf-8").splitlines()[-1].startswith(words)


def test_a_law_of_the_pose_is_proposed_with_the_bandwidth() -> None:
    """The proposal is followed: the default gains of the law would not settle, those of the bandwidth do."""
    far = {
        "target.points": None,
        "target.desired_features": None,
        "target.tag": {"size": 0.09, "pose": [0.0, 0.0, -1.81, 0.0, 0.0, 0.0]},
        "target.desired_pose": [-0.0008, 0.0057, 0.0048, 0.0344, -0.0108, -0.0007],
        "simulation.duration": 10.0,
    }
    scenario = machine("composite", 1.0, **far)
    (sentence,) = [sentence for sentence in unlikely_without_runs(scenario) if "a law of the pose" in sentence]
    assert "a law of the pose, pbvs with controller.pbvs.auto.bandwidth: 1, does not" in sentence
    followed = scenario.updated({"controller.law": "pbvs", "controller.pbvs.auto.bandwidth": 1.0})
    metrics = hs.metrics(hs.simulate(followed))
    assert math.isfinite(metrics["settling_time"])
    assert metrics["peak_leg_excursion"] < 0.015
