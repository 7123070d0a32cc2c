"""The machines of docs/your-machine.md: their travel is their sheets', they settle, and their reports are written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.findings.check import unlikely
from hexservo.findings.check_keys import keys_without_effect
from hexservo.scenario import presets
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import auto_of
from hexservo.scenario.parameters import core_parameters
from without_runs import unlikely_without_runs

ROOT = Path(__file__).resolve().parents[2]
README, GUIDE = ROOT / "README.md", ROOT / "docs" / "your-machine.md"
DEGREE = np.pi / 180
# What the sources state, towards minus and plus [m; rad], each alone; and how well the machine reproduces it.
LIMITS = {
    "pi-h824": (0.02, np.outer([22.5e-3, 22.5e-3, 12.5e-3, 7.5 * DEGREE, 7.5 * DEGREE, 12.5 * DEGREE], [1, 1])),
    "moog-6dof2000e": (
        0.10,
        np.array([[0.241, 0.259], [0.259] * 2, [0.178] * 2, [21 * DEGREE] * 2, [22 * DEGREE] * 2, [22 * DEGREE] * 2]),
    ),
}
# Limits of the software, which are narrower than what the legs allow; there the joints themselves are known.
WITHIN = np.array([11.4e-3, 11.4e-3, 13.1e-3, 0.36 * DEGREE, 0.36 * DEGREE, 0.10 * DEGREE])
MACHINES = [*LIMITS, "rubin-camera-hexapod", "reachy-mini-head", "pi-h824-positions", "rubin-camera-positions"]


def travel(scenario: hs.Scenario, direction: Array) -> float:
    """How far the platform goes along a direction until a leg is at the end of its stroke."""

    def margin(amount: float) -> float:
        return hs.reachable(scenario, amount * direction).margin

    far = 1e-3
    while margin(far) > 0:
        far *= 1.3
    return float(brentq(margin, 0.0, far, xtol=1e-9))


@pytest.mark.parametrize("name", LIMITS)
def test_travel_is_that_of_the_sheet(name: str) -> None:
    scenario = hs.load_scenario(name)
    tolerance, stated = LIMITS[name]
    found = np.array([[travel(scenario, sign * axis) for sign in (-1, 1)] for axis in np.eye(6)])
    print(f"{name}: travel found over stated\n{found / stated}")
    for axis in range(6):  # a range that is stated even is the smaller of both ways
        if stated[axis, 0] == stated[axis, 1]:
            assert found[axis].min() == pytest.approx(stated[axis, 0], rel=tolerance)
            assert found[axis].max() < 1.255 * stated[axis, 1]  # "up to 25 % more" of docs/your-machine.md
        else:
            np.testing.assert_allclose(found[axis], stated[axis], rtol=tolerance)


def test_limits_of_the_telescope_are_within_the_travel_of_its_struts() -> None:
    scenario = hs.load_scenario("rubin-camera-hexapod")
    robot = scenario.robot
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    for axis, limit in enumerate(WITHIN):
        for sign in (-1.0, 1.0):
            pose = sign * limit * np.eye(6)[axis]
            found = hs.reachable(scenario, pose)
            print(f"{axis} {sign:+.0f}: {found}")
            assert found.within
            # Strut lengths as the source computes them: the moving ends turn about the pivot, then shift with it.
            ends = robot.home_position + pose[:3] + Rotation.from_rotvec(pose[3:]).apply(robot.platform_joints)
            lengths = np.linalg.norm(ends - np.asarray(robot.base_joints), axis=1)
            margin = robot.stroke - np.abs(lengths - np.asarray(hexapod.home_lengths)).max()
            assert found.margin == pytest.approx(margin, abs=1e-12)
    # All of them at once are out of reach: the limits are not those of the legs.
    assert not hs.reachable(scenario, WITHIN).within


@pytest.mark.parametrize("name", MACHINES)
def test_it_settles_without_a_warning_but_of_a_high_load(name: str) -> None:
    scenario = hs.load_scenario(name)
    coupled = [line for line in unlikely_without_runs(scenario) if "the inertia couples the axes" in line]
    assert unlikely(scenario) == coupled
    assert len(coupled) == (name == "moog-6dof2000e")  # docs/your-machine.md
    assert len(lines_with(README, "settle without a warning but one")) == 1
    assert keys_without_effect(scenario) == []
    result = hs.simulate(scenario)
    metrics = hs.metrics(result)
    assert (result.outcome, result.events) == ("completed", ())
    # docs/gains.md: 0.7 to 2.0 periods of the bandwidth until 5 % of the start; here until 2 px of some 20 px
    bandwidth = auto_of(scenario).bandwidth
    assert bandwidth is not None
    assert metrics["settling_time"] < 3.0 / bandwidth
    assert metrics["rms_error"] < 2.0 * scenario.camera.noise + 0.2
    assert np.abs(result.feature_error[0]).max() > 10 * scenario.metrics.band
    if not name.endswith("-positions"):
        stated = f"{metrics['settling_time']:.2f} s"
        assert [stated in line for line in lines_with(GUIDE, f"| `{name}` |.* Hz |")] == [True]
        assert [stated in line for line in lines_with(README, "Your machine from its data sheet: four")] == [True]


def test_the_law_that_is_proposed_for_a_high_load_stays_within_the_force_limit() -> None:
    """With its default gains, those of another machine, it settles with forces of 2.6 times the limit."""
    scenario = hs.load_scenario("moog-6dof2000e").updated({"simulation.duration": 2.0, "metrics.rms_start": 1.0})
    (sentence,) = (words for words in unlikely_without_runs(scenario) if words.startswith("controller.composite.auto"))
    key, bandwidth = re.findall(r"; computed_torque with (\S+): (\S+) takes the coupling out$", sentence)[0]
    law = scenario.updated({"controller.law": "computed_torque"})
    proposed = law.updated({key: float(bandwidth)})
    assert unlikely(proposed) == []
    found = hs.simulate(proposed)
    assert found.events == ()
    stated = f"after {hs.metrics(found)['settling_time']:.2f} s in place of 2.15 s"
    (line,) = lines_with(GUIDE, f"`{key}: {bandwidth}`.*")
    assert stated in line
    assert [sentence.split(" needs")[0] for sentence in unlikely(law)] == ["controller.computed_torque: the law"]
    assert {(event.leg, event.limit) for event in hs.simulate(law).events} == {(n, 8000.0) for n in (1, 3, 4)}


def lines_with(page: Path, words: str) -> list[str]:
    return [
        line for line in page.read_text(encoding="utf-8").splitlines() if re.search(words.replace("|", r"\|"), line)
    ]


@pytest.mark.parametrize("name", presets.MACHINES)
def test_every_number_of_a_preset_has_its_source_or_is_an_assumption(name: str) -> None:
    text = (Path(hs.__file__).parent / "machines" / f"{name}.yaml").read_text(encoding="utf-8")
    assert "# Sources: [" in text
    for key in ("mass", "inertia", "force_limit"):
        at = text.index(f"\n{key}:") + 1
        line = text[at : text.index("\n", at)]
        before = text[:at].rstrip("\n").rpartition("\n")[2]
        assert "[" in line.partition("#")[2] or "ssumption" in line + before, key


@pytest.mark.parametrize("name", presets.MACHINES)
def test_a_preset_is_the_machine_of_its_scenarios(name: str) -> None:
    paper = hs.load_scenario("paper")
    machines = [hs.load_scenario(scenario) for scenario in hs.scenario_names()]
    of_it = [scenario for scenario in machines if scenario.robot.preset == name]
    assert of_it
    preset = paper.updated({"robot.preset": name})
    for scenario in of_it:
        assert preset.robot == scenario.robot.model_validate({**scenario.to_mapping()["robot"], "payload": {}})
    assert preset.updated({"robot.preset": "micro"}) == paper
    stronger = preset.updated({"robot.force_limit": 2.0 * preset.robot.force_limit})
    assert hs.Scenario.from_yaml(stronger.to_yaml()) == stronger
    assert stronger.updated({"robot.preset": "micro"}).robot.force_limit == stronger.robot.force_limit  # it stays


def test_a_preset_gives_way_to_joints_of_a_different_form() -> None:
    paper = hs.load_scenario("paper")
    robot = paper.updated({"robot": {"preset": "reachy_mini", "cranks": {"rod": 0.09}}}).robot
    assert robot.cranks.rod == 0.09
    assert robot.cranks.length == 0.04  # the preset's
    x, y, _ = np.transpose(robot.platform_joints or ())
    circle = {"platform_radius": float(np.hypot(x, y).mean()), "platform_angles": np.arctan2(y, x).tolist()}
    robot = paper.updated({"robot": {"preset": "reachy_mini", **circle}}).robot
    assert robot.platform_joints is None
    assert robot.platform_radius == circle["platform_radius"]
    assert robot.base_joints is not None


@pytest.mark.parametrize(
    ("changes", "lacking"),
    [
        ({"robot.base_angles": [0.8, 2.3, 2.9, 4.4, 5.0, 6.1]}, "base_radius"),
        ({"robot.base_radius": 0.7}, "base_angles"),
    ],
)
def test_half_a_circle_does_not_take_the_place_of_joints(changes: dict[str, Any], lacking: str) -> None:
    """The core would take another machine's radius or angles."""
    rubin = hs.load_scenario("rubin-camera-hexapod")
    with pytest.raises(hs.ScenarioError, match=f"^robot.{lacking}: expected a value, since base_joints is null, got"):
        rubin.updated(changes)


def test_a_batch_does_not_leave_out_circles_of_a_machine_with_joints() -> None:
    rubin = hs.load_scenario("rubin-camera-hexapod")
    circle: dict[str, Any] = {"robot.base_radius": [0.7], "robot.base_angles": [[0.8, 2.3, 2.9, 4.4, 5.0, 6.1]]}
    with pytest.raises(ValueError, match=r"^robot\.base_radius: expected a robot whose base joints are on a circle"):
        hs.simulate_batch(rubin, circle)


def test_joints_may_vary_where_the_gains_fit_the_machine() -> None:
    """In place of a circle, as one by one."""
    scenario = hs.load_scenario("pi-h824").updated({"simulation.duration": 0.2})
    robot = scenario.robot
    angles = np.array(robot.platform_angles)
    joints = np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1) * robot.platform_radius
    rows = np.stack([joints, joints + np.array([0.0, 0.0, 1e-3])])
    batch = hs.simulate_batch(scenario, {"robot.platform_joints": rows}, "final")
    for index, row in enumerate(rows):
        run = hs.simulate(scenario.updated({"robot.platform_joints": row.tolist()}))
        np.testing.assert_allclose(batch.samples["position"][index], run.position[-1], atol=1e-9)


def test_a_report_of_joints_anywhere(tmp_path: Path) -> None:
    scenario = hs.load_scenario("rubin-camera-hexapod").updated({"simulation.duration": 0.5})
    file = tmp_path / "rubin.html"
    hs.write_report(hs.simulate(scenario), file)
    assert "The machine in space" in file.read_text(encoding="utf-8")
