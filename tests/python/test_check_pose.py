"""Warnings about the pose that image and joints leave: a target too small for the stroke, a prior, coarse encoders."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli import commands as cli
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check import notes
from hexservo.run.goal_distance import goal_distance
from without_runs import unlikely_without_runs

POSITIONS, FORCES = "pi-h824-positions", "pi-h824"
UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}


def about(scenario: hs.Scenario, head: str) -> list[str]:
    return [line for line in unlikely_without_runs(scenario) if line.startswith(head)]


def sizes(text: str, unit: str = "m") -> list[float]:
    """Return the lengths in a sentence, in its order [m], or the angles [rad]."""
    return [float(size) * UNITS[prefix + "m"] for size, prefix in re.findall(rf"([\d.]+) (m|u|){unit}\b", text)]


def before(scenario: hs.Scenario, side: float, depth: float, **changes: Any) -> hs.Scenario:
    """Return the scenario with a tag that faces a camera at home at a depth, upright, with its middle on the axis."""
    height = scenario.robot.home_position[2]
    target = dict.fromkeys(("initial_features", "desired_features", "points", "grid"))
    tag = {"size": side, "pose": [0.0, 0.0, height - depth, 0.0, 0.0, 0.0]}
    mount = {"position": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0]}
    goal = [3e-3, -2e-3, 2e-3, -0.01, -0.01, 0.02]
    pinhole = {"camera.focal_pixels": 1500.0, "camera.focal_length": None, "camera.pixel_scale": None}
    lens = {"camera.distortion": {"brown_conrady": None}, "camera.image_size": None, "camera.principal_point": None}
    return scenario.updated(
        {"target": {**target, "tag": tag, "desired_pose": goal}, "camera.mount": mount, **pinhole, **lens, **changes}
    )


def small_tag(ratio: float, law: str = "tracking", machine: str = POSITIONS, **changes: Any) -> hs.Scenario:
    """Return a machine with a tag of 100 mm at 1.5 m, and noise that scatters a leg by a ratio of its stroke."""
    law_of = {"controller.law": law, f"controller.{law}.auto.bandwidth": 1.0}
    scenario = before(hs.load_scenario(machine), 0.1, 1.5, **law_of, **changes, **{"simulation.duration": 10.0})
    scene = Scene(scenario)
    noise = ratio * scene.stroke / legs_by_hand(scene, 0.1, 1.5).max()
    assumed = {"controller.tracking.noise": noise} if law == "tracking" else {}
    return scenario.updated({"camera.noise": noise, **assumed})


def legs_by_hand(scene: Scene, side: float, depth: float) -> np.ndarray:
    """Return the deviations of the legs (6,) [m/px], of the two directions that a tag hardly constrains.

    A rotation theta about an axis across the view, with the shift that keeps the mean feature in place, moves the
    corners at (+-a, +-a) by f theta a^2/z^2 across its own direction, with alternating signs: four coordinates, so that
    theta is uncertain by z^2/(2 f a^2) per px, and the shift by z times that.
    """
    a, focal = side / 2.0, 1500.0
    theta = depth**2 / (2.0 * focal * a**2)
    moved = []
    for axis in (0, 1):
        motion = np.zeros(6)
        motion[axis] = depth * (1.0 + (a / depth) ** 2)
        motion[4 - axis] = 1.0
        still = min((motion, motion * np.where(np.arange(6) < 3, -1.0, 1.0)), key=lambda way: image_motion(scene, way))
        step = 1e-5
        moved.append(theta * (scene.leg_travel(scene.home.moved(step * still)) - scene.leg_travel(scene.home)) / step)
    return np.hypot(*moved)


def image_motion(scene: Scene, way: np.ndarray) -> float:
    return float(np.abs(hs.project(scene.scenario, 1e-4 * way) - hs.project(scene.scenario, np.zeros(6))).max())


def test_a_target_is_uncertain_by_the_closed_form_of_a_square() -> None:
    scenario = before(hs.load_scenario(POSITIONS), 0.1, 3.0, **{"camera.noise": 0.2})
    (line,) = about(scenario, "target: at the start")
    uncertain, away, leg, stroke = sizes(line)
    assert uncertain == pytest.approx(0.2 * 3.0**3 / (2.0 * 1500.0 * 0.05**2), rel=0.01)
    assert away == 3.0
    scene = Scene(scenario)
    assert stroke == pytest.approx(scene.stroke)
    assert leg == pytest.approx(0.2 * legs_by_hand(scene, 0.1, 3.0).max(), rel=0.01)


@pytest.mark.parametrize(("law", "machine"), [("tracking", POSITIONS), ("resolved_rate", FORCES)])
def test_a_law_that_follows_the_noise_uses_its_stroke_where_that_is_warned_of(law: str, machine: str) -> None:
    """Of runs with four seeds: a deviation of the legs of half the stroke leaves room, three times it does not."""
    for ratio, warned in ((0.45, False), (3.0, True)):
        scenario = small_tag(ratio, law, machine)
        runs = [hs.metrics(hs.simulate(scenario.updated({"seed": seed}))) for seed in range(4)]
        used = max(run["peak_leg_excursion"] for run in runs) / Scene(scenario).stroke
        assert (used > 0.98) == warned
        found = about(scenario, "target: at the start")
        assert len(found) == warned
        assert all(f"and where {law} sends leg" in line for line in found)


@pytest.mark.parametrize(("law", "machine"), [("tracking", POSITIONS), ("resolved_rate", FORCES)])
def test_near_its_bound_a_target_is_one_with_which_legs_may_go_to_their_ends(law: str, machine: str) -> None:
    """Some of four runs stay within the stroke and settle as without noise; with five strokes none stays within."""
    calm = hs.metrics(hs.simulate(small_tag(0.1, law, machine)))["settling_time"]
    for ratio, words in ((1.3, "legs may go to the ends"), (5.0, "legs go to the ends")):
        scenario = small_tag(ratio, law, machine)
        (line,) = about(scenario, "target: at the start")
        assert f"{words} of their stroke or beyond, and runs may settle late or not at all; take" in line
        runs = [hs.metrics(hs.simulate(scenario.updated({"seed": seed}))) for seed in range(4)]
        used = [run["peak_leg_excursion"] / Scene(scenario).stroke for run in runs]
        if ratio < 3.0:
            assert any(run["settling_time"] < 1.1 * calm for run in runs)
            assert min(used) < 0.9
        else:
            assert min(used) > 0.98


@pytest.mark.parametrize(("ratio", "warned"), [(0.99, False), (1.01, True)])
def test_the_bound_is_a_stroke(ratio: float, warned: bool) -> None:
    assert bool(about(small_tag(ratio), "target: at the start")) == warned


def test_a_prior_keeps_noise_from_the_legs() -> None:
    """The law that the sentence names moves within half of the stroke with ten times the noise."""
    followed = small_tag(10.0)
    (line,) = about(followed, "target: at the start")
    assert "or a law whose prior keeps noise out" in line
    by_prior = small_tag(10.0, "pbvs")
    assert not about(by_prior, "target: at the start")
    assert hs.metrics(hs.simulate(by_prior))["peak_leg_excursion"] < 0.6 * Scene(by_prior).stroke
    by_image: dict[str, Any] = {"controller.pbvs.prior": 0.0}
    (line,) = about(small_tag(10.0, "pbvs", **by_image), "target: at the start")
    assert line.endswith("or a larger controller.pbvs.prior")


def test_an_image_without_noise_sends_no_leg_away() -> None:
    assert not about(small_tag(3.0).updated({"camera.noise": 0.0}), "target: at the start")


@pytest.mark.parametrize("law", ["composite", "computed_torque"])
def test_a_prior_leaves_what_is_noted(law: str) -> None:
    by_law = {"controller.law": law, f"controller.{law}.auto.bandwidth": 1.0, "camera.noise": 0.0}
    scenario = before(hs.load_scenario(FORCES), 0.08, 0.5, **by_law, **{"simulation.duration": 10.0})
    (note,) = (note for note in notes(scenario) if note.startswith(f"controller.{law}.prior"))
    shift, away = sizes(note)
    turn, turned = sizes(note, "rad")
    scene = Scene(scenario)
    run = hs.simulate(scenario)
    reached = Poses(run.position[-1], run.quaternion[-1]).displacement_from(scene.home)
    goal = np.array([3e-3, -2e-3, 2e-3, -0.01, -0.01, 0.02])
    np.testing.assert_allclose(np.linalg.norm(goal[:3]), away, rtol=5e-3)
    np.testing.assert_allclose(np.linalg.norm(goal[3:]), turned, rtol=5e-3)
    left = goal - reached
    np.testing.assert_allclose([np.linalg.norm(left[:3]), np.linalg.norm(left[3:])], [shift, turn], rtol=0.05)
    prior = np.array(scenario.controller.gains.prior)
    weaker = scenario.updated({f"controller.{law}.prior": (1e-3 * prior).tolist()})
    assert not [note for note in notes(weaker) if note.startswith(f"controller.{law}.prior")]


@pytest.mark.parametrize(
    ("name", "prior"),
    [("composite-30hz", None), ("paper-composite", None), ("textbook-general", [1200.0] * 3 + [7500.0] * 3)],
)
def test_runs_end_where_the_prior_and_the_image_are_noted_to_balance(name: str, prior: list[float] | None) -> None:
    """Of nearly all of the way, of a half of it, and of large motions, of which the first order is 20 % off."""
    exact = {"uncertainty.depth": 0.0, "camera.noise": 0.0, "controller.composite.kv": 0.0}
    scenario = hs.load_scenario(name).updated({**exact, "simulation.duration": 20.0})
    if prior is not None:
        scenario = scenario.updated({"controller.composite.prior": prior})
    (note,) = (note for note in notes(scenario) if note.startswith("controller.composite.prior"))
    (pixels,) = re.findall(r"([\d.]+) px of image error", note)
    run = hs.simulate(scenario)
    end = goal_distance(run)
    assert end is not None
    np.testing.assert_allclose([end.shift, end.angle], [sizes(note)[0], sizes(note, "rad")[0]], rtol=0.01)
    assert np.abs(run.feature_error[-1]).max() == pytest.approx(float(pixels), rel=0.05)  # of two digits


def test_check_and_new_state_what_a_prior_leaves(tmp_path: Path) -> None:
    file = str(tmp_path / "mine.yaml")
    made = CliRunner().invoke(cli.app, ["new", "--machine", file], input="\n" * 40)
    checked = CliRunner().invoke(cli.app, ["check", file])
    for done in (made, checked):
        assert done.exit_code == 0, done.output
        assert "Note: controller.composite.prior: its pull towards home and the image balance 1.34 mm" in done.stderr


def readings(name: str, times: float, key: str = "resolution", **changes: Any) -> hs.Scenario:
    """Return a machine whose readings have a deviation in the image that is a multiple of a third of metrics.band."""
    exact = {"sensors.pose": "encoders", "sensors.noise": 0.0, "sensors.resolution": 0.0}
    scenario = hs.load_scenario(name).updated({**exact, **changes})
    unit = Scene(scenario.updated({f"sensors.{key}": 1e-6})).joint_noise / 1e-6
    return scenario.updated({f"sensors.{key}": times * scenario.metrics.band / 3.0 / unit})


def moved_by_readings(scenario: hs.Scenario) -> float:
    """Return the largest standard deviation of a feature in the second half of a run [px]."""
    error = hs.simulate(scenario).feature_error
    return float(error[len(error) // 2 :].std(axis=0).max())


@pytest.mark.parametrize("name", [FORCES, "moog-6dof2000e"])
@pytest.mark.parametrize("key", ["resolution", "noise"])
def test_readings_move_the_image_as_is_warned_of(name: str, key: str) -> None:
    law: dict[str, Any] = {"controller.law": "pbvs", "controller.pbvs.auto.bandwidth": 1.0}
    for times, warned in ((0.9, False), (3.0, True)):
        scenario = readings(name, times, key, **law)
        found = about(scenario, f"sensors.{key} of ")
        assert len(found) == warned
        for line in found:
            (stated,) = re.findall(r"are ([\d.]+) px in the image", line)
            assert 0.2 < moved_by_readings(scenario) / float(stated) < 2.0
        if not warned:
            assert 3.0 * moved_by_readings(scenario) < 1.1 * scenario.metrics.band


def test_readings_whose_rates_move_the_weights() -> None:
    """Of `composite`, whose image moves by several times the readings there; by less without fuzzy systems."""
    coarse = readings(FORCES, 1.2)
    (line,) = about(coarse, "sensors.resolution of ")
    assert "the weights follow that noise" in line
    (stated,) = (float(text) for text in re.findall(r"are ([\d.]+) px in the image", line))
    off = coarse.updated({"controller.composite.fuzzy.enabled": False})
    assert 2.0 * stated < moved_by_readings(coarse) < 20.0 * stated
    assert moved_by_readings(off) < 1.2 * stated
    assert all("the weights follow" not in line for line in about(off, "sensors."))
    assert about(readings(FORCES, 0.3), "sensors.") == []
    assert hs.metrics(hs.simulate(readings(FORCES, 0.3)))["settling_time"] < 1.0


def test_rates_that_no_fuzzy_input_has_as_noise() -> None:
    """True rates have none, and readings that are farther apart less; deviation of a difference by hand."""
    (line,) = about(readings(FORCES, 1.2), "sensors.")
    (stated,) = (float(text) for text in re.findall(r"are ([\d.]+) in the second fuzzy input", line))
    scenario = readings(FORCES, 1.2)
    scene = Scene(scenario)
    rounding = scenario.sensors.resolution / math.sqrt(12.0)
    by_leg = np.linalg.inv(scene.wrench_maps(scene.home).T)
    rates = math.sqrt(2.0) * rounding / scenario.simulation.step * np.linalg.norm(by_leg, axis=1)
    assert stated == pytest.approx(
        float((scene.settings["controller.composite.fuzzy.rate_scale"] * rates).max()), rel=0.05
    )
    true = about(scenario.updated({"sensors.rate": True}), "sensors.")
    assert all("fuzzy" not in line for line in true)


def test_legs_that_take_positions_rest_within_the_rounding() -> None:
    law: dict[str, Any] = {"controller.law": "pbvs", "controller.pbvs.auto.bandwidth": 1.0}
    for times, warned in ((2.0, False), (9.0, True)):
        scenario = readings(POSITIONS, times, **law)
        assert bool(about(scenario, "sensors.resolution of ")) == warned
        assert math.isnan(hs.metrics(hs.simulate(scenario))["settling_time"]) == warned
    assert about(readings(POSITIONS, 9.0, "noise", **law), "sensors.") == []


@pytest.mark.parametrize(
    ("target", "named"),
    [
        ({"tag": {"size": 82.0, "pose": [0.0, 0.0, -0.66, 0.0, 0.0, 0.0]}}, "target.tag.size: .* got 82 m: point 1"),
        (
            {"grid": {"rows": 3, "columns": 4, "spacing": 40.0, "pose": [0.0, 0.0, -0.66, 0.0, 0.0, 0.0]}},
            "target.grid.spacing: .* got 40 m: point 1",
        ),
        (
            {"points": [[x, y, -0.66] for x, y in ((-41, 41), (41, 41), (41, -41), (-41, -41))]},
            "target.points: .* got point 1 58 m off the optical axis",
        ),
    ],
)
def test_a_target_that_is_far_too_large_is_named(target: dict[str, Any], named: str) -> None:
    with pytest.raises(hs.ScenarioError, match=named) as caught:
        typed(target, [3e-3, -2e-3, 2e-3, -0.01, -0.01, 0.02])
    assert "89.5 deg off" in str(caught.value) or "89.6 deg off" in str(caught.value)
    opencv = {"axes": "opencv", "mount": {"rotation": [math.pi, 0.0, 0.0]}}  # which look along z, as it does
    with pytest.raises(hs.ScenarioError) as also:
        typed(target, [3e-3, -2e-3, 2e-3, -0.01, -0.01, 0.02], opencv)
    assert str(also.value) == str(caught.value)


def test_a_pose_that_looks_away_is_named() -> None:
    tag = {"tag": {"size": 0.082, "pose": [0.0, 0.0, -0.66, 0.0, 0.0, 0.0]}}
    with pytest.raises(hs.ScenarioError, match=r"target\.desired_pose: expected a pose from which every point"):
        typed(tag, [0.0, 0.0, 0.0, 1.56, 0.0, 0.0])


def typed(target: dict[str, Any], goal: list[float], camera: dict[str, Any] | None = None) -> hs.Scenario:
    document = {
        "name": "typed",
        "description": "A machine and its target",
        "robot": {
            "platform_radius": 0.1,
            "platform_angles": [-0.87, 0.87, 1.22, 2.97, 3.32, 5.06],
            "base_radius": 0.15,
            "base_angles": [-0.17, 0.17, 1.92, 2.27, 4.01, 4.36],
            "home_position": [0.0, 0.0, -0.16],
            "stroke": 0.015,
            "mass": 5.0,
            "inertia": [0.0125, 0.0125, 0.025],
            "force_limit": 49.0,
        },
        "camera": camera or {},
        "target": {**target, "desired_pose": goal},
    }
    return hs.Scenario.from_mapping(document)
