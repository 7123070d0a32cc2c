"""Warnings about where a target goes: its reach, its image, pointing at it, and frames that do not show its motion."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import unlikely
from hexservo.findings.check_target import _pointed
from hexservo.findings.target_path import path_at, path_of
from hexservo.scenario.pixels import points_outside

GOAL = np.array([0.004, -0.003, 0.002, -0.01, -0.015, 0.02])  # of pi-h824-positions
QUIET: dict[str, Any] = {"camera.noise": 0.0, "sensors.resolution": 0.0}


@pytest.fixture(scope="module")
def machine() -> hs.Scenario:
    return hs.load_scenario("pi-h824-positions")


def about_target(scenario: hs.Scenario, head: str = "target.motion:") -> list[str]:
    return [line for line in unlikely(scenario) if line.startswith(head)]


def out_from(scenario: hs.Scenario) -> float:
    """Return from when on the goal is out of reach, as the one warning states it [s]."""
    (line,) = about_target(scenario)
    ((time, unit),) = re.findall(r"the goal is out of reach from ([\d.]+) (m?s) on, first where leg \d would be ", line)
    return float(time) * {"s": 1.0, "ms": 1e-3}[unit]


def shifted(along: list[float], size: float) -> np.ndarray:
    return GOAL + np.append(size * np.array(along), np.zeros(3))


@pytest.mark.parametrize("velocity", [[0.02, 0.0, 0.0], [0.0, 0.0, 0.02]])
def test_a_target_that_leaves_the_reach(machine: hs.Scenario, velocity: list[float]) -> None:
    """The goal pose is shifted as the target is; a run of 20 s is looked at every 0.1 s."""
    motion = {"kind": "velocity", "velocity": velocity}
    time = out_from(machine.updated({"target.motion": motion, "simulation.duration": 20.0}))
    assert not hs.reachable(machine, shifted(velocity, time)).within
    assert hs.reachable(machine, shifted(velocity, time - 0.1)).within
    short = {"target.motion": motion, "simulation.duration": 0.02 * math.floor(50.0 * (time - 0.1))}
    assert about_target(machine.updated(short)) == []


def test_the_image_of_a_platform_that_stays(machine: hs.Scenario) -> None:
    motion = {"kind": "velocity", "velocity": [0.02, 0.0, 0.0]}
    scenario = machine.updated({"target.motion": motion, "simulation.duration": 20.0})
    (line,) = about_target(scenario)
    (since,) = re.findall(r"outside the image of a platform that stays there from ([\d.]+) s on", line)
    stays = out_from(scenario) - 0.1
    for time, outside in ((float(since), True), (float(since) - 0.1, False)):
        seen = hs.project(
            machine, shifted([0.02, 0.0, 0.0], stays - time)
        )  # the target shifted is the camera shifted back
        assert points_outside(machine, seen).any() == outside
    assert "outside the image" not in about_target(scenario.updated({"camera.image_size": None}))[0]


def test_the_extremes_of_a_sinusoid_and_of_a_recording_count(machine: hs.Scenario) -> None:
    """The end of the reach along x is 21 mm away."""
    assert hs.reachable(machine, shifted([1.0, 0.0, 0.0], 0.0205)).within
    assert not hs.reachable(machine, shifted([1.0, 0.0, 0.0], 0.0220)).within
    for size, warned in ((0.0205, False), (0.0220, True)):
        peak = [[0.0] * 3, [0.0] * 3, [size, 0.0, 0.0], *[[0.0] * 3] * 98]
        for motion in (
            {"kind": "sinusoid", "amplitude": [size, 0.0, 0.0], "frequency": 0.37, "phase": 0.1},
            {"kind": "recorded", "samples": peak, "sample_period": 0.07},
        ):
            assert bool(about_target(machine.updated({"target.motion": motion}))) == warned, motion["kind"]


@pytest.mark.parametrize("weights", [[1.0] * 4, [8.0, 1.0, 1.0, 1.0]])
def test_a_goal_that_pointing_does_not_meet(machine: hs.Scenario, weights: list[float]) -> None:
    """Against a run, within the goal's tilt of 18 mrad: the law aims at a point of the mean depth."""
    scenario = machine.updated({"controller.tracking.follow": "direction", "target.weights": weights, **QUIET})
    (line,) = about_target(scenario, "controller.tracking.follow: direction leaves")
    (left,) = re.findall(r"leaves ([\d.]+) px at the goal, more than metrics\.band \(2 px\)", line)
    rests = float(np.abs(hs.simulate(scenario).feature_error[-1]).max())
    assert float(left) == pytest.approx(rests, rel=0.018)
    turned = {"target.desired_features": hs.project(machine, [0.0, 0.0, 0.0, 0.01, 0.015, 0.0]).tolist()}
    assert about_target(scenario.updated(turned), "controller.tracking.follow") == []


def test_pointing_reaches_where_no_shift_is_needed(machine: hs.Scenario) -> None:
    """A target that goes away along the axis is pointed at from home, and its pose is followed to the stroke's end."""
    motion = {"kind": "velocity", "velocity": [0.0, 0.0, -0.02]}
    scenario = machine.updated({"target.motion": motion})
    assert about_target(scenario)
    assert about_target(scenario.updated({"controller.tracking.follow": "direction"})) == []


def test_a_law_of_the_image_may_take_any_pose_with_the_goal_image() -> None:
    """Along x the target of `paper` constrains the pose to centimetres: a shift by a rotation has nearly its image."""
    paper = hs.load_scenario("paper").updated({"simulation.mode": "sampled", "simulation.duration": 2.0})
    near, far = ({"kind": "velocity", "velocity": [speed, 0.0, 0.0]} for speed in (0.005, 0.2))
    assert about_target(paper.updated({"target.motion": near})) == []
    assert about_target(paper.updated({"target.motion": far}))


@pytest.mark.parametrize(
    ("frequency", "phase", "words"),
    [
        (
            12.5,
            0.0,
            "of 12.5 Hz a frame every 80 ms shows 0 of the amplitude, since it is near a multiple of half the frame "
            "rate, 6.25 Hz;",
        ),
        (6.25, 0.0, "of 6.25 Hz a frame every 80 ms shows 0 of the amplitude"),
        (6.25, 0.2, "shows 0.199 of the amplitude"),  # sin(0.2)
        (6.25, 1.5, ""),
        (10.0, 0.0, "shows a motion of 2.5 Hz: above half the frame rate it is aliased"),
        (5.0, 0.0, ""),
        (0.01, 0.0, ""),  # little of it in the run, and shown
    ],
)
def test_sinusoids_that_frames_show_as_something_else(
    machine: hs.Scenario, frequency: float, phase: float, words: str
) -> None:
    motion = {"kind": "sinusoid", "amplitude": [1e-3, 0.0, 0.0], "frequency": frequency, "phase": phase}
    lines = about_target(machine.updated({"camera.period": 0.08, "target.motion": motion}), "target.motion.frequency")
    assert len(lines) == bool(words)
    assert all(words in line for line in lines)


def test_a_motion_that_frames_do_not_show_moves_nothing(machine: hs.Scenario) -> None:
    at_rest = machine.updated({"camera.period": 0.08, "simulation.duration": 2.0, **QUIET})
    motion = {"kind": "sinusoid", "amplitude": [1e-3, 0.0, 0.0], "frequency": 12.5}
    one, other = hs.simulate(at_rest), hs.simulate(at_rest.updated({"target.motion": motion}))
    np.testing.assert_allclose(one.position, other.position, rtol=0, atol=1e-9)


IN_WORLD: dict[str, Any] = {"target.frame": "world", "base_motion.kind": "sinusoid", "base_motion.frequency": 0.2}


def test_a_base_that_moves_before_a_target_in_the_world(machine: hs.Scenario) -> None:
    """The base is displaced by -a/w^2 sin(wt), and the target in B by the opposite: the same warning for both."""
    w = 2.0 * np.pi * 0.2
    moving = machine.updated({**IN_WORLD, "base_motion.amplitude": [1.0, 0.0, 0.0]})
    (line,) = about_target(moving, "base_motion:")
    (time,) = re.findall(r"the goal is out of reach from ([\d.]+) ms on, first where leg \d would be ", line)
    step = moving.simulation.duration / 1000.0
    for at, within in ((1e-3 * float(time), False), (1e-3 * float(time) - 2.0 * step, True)):
        assert hs.reachable(machine, shifted([1.0, 0.0, 0.0], np.sin(w * at) / w**2)).within is within
    assert "outside the image of a platform that stays there" in line
    assert about_target(moving.updated({"target.frame": "base"}), "base_motion: the goal") == []
    small = moving.updated({"base_motion.amplitude": [0.01, 0.0, 0.0]})  # 6 mm
    assert about_target(small, "base_motion:") == []


def test_a_goal_that_is_out_of_reach_where_the_base_begins(machine: hs.Scenario) -> None:
    keys = {"base_motion.amplitude": [1.0, 0.0, 0.0], "base_motion.phase": math.pi / 2.0}
    (line,) = about_target(machine.updated({**IN_WORLD, "base_motion.frequency": 0.4, **keys}), "base_motion:")
    assert "out of reach from 0 s on" in line


def test_a_rough_road_before_a_target_in_the_world() -> None:
    """The run leaves the stroke; before a target that rides along it does not."""
    road = hs.load_scenario("rough-road")
    for frame, leaves in (("world", True), ("base", False)):
        scenario = road.updated({"target.frame": frame})
        assert bool(about_target(scenario, "base_motion:")) is leaves
        run, scene = hs.simulate(scenario), scene_of(scenario)
        travel = np.abs(run.leg_lengths - scene.hexapod.mid_lengths).max()
        assert bool(travel > scene.stroke) is leaves


def test_the_path_of_a_target_has_the_images_of_a_run() -> None:
    """Of a base that moves and turns, with a target that moves too."""
    keys = {
        "target.frame": "world",
        "target.motion": {"kind": "sinusoid", "amplitude": [2e-3, -1e-3, 3e-3], "frequency": 0.7},
        "base_motion": {
            "kind": "sinusoid",
            "amplitude": [0.1, 0.2, -0.1],
            "frequency": 1.1,
            "rotation": {"kind": "sinusoid", "amplitude": [0.02, -0.03, 0.05], "frequency": 0.9},
        },
        "simulation.duration": 1.0,
    }
    scenario = hs.load_scenario("slow-camera").updated(keys)
    scene, run = scene_of(scenario), hs.simulate(scenario)
    path, poses = path_at(scene, run.time), Poses(run.position, run.quaternion)
    expected = scene.desired - run.feature_error
    np.testing.assert_allclose(scene.image(path.seen_alike(poses))[0], expected, rtol=0, atol=1e-7)
    one = poses[5]
    back = path.seen_alike(path.carried(one))
    np.testing.assert_allclose(back.displacement_from(one.repeated(len(path))), 0.0, rtol=0, atol=1e-12)
    for k in (0, 100, len(path) - 1):
        moved = scenario.updated({"target.initial_features": None, "target.depth": None, "target.frame": "base",
            "target.motion.kind": "none", "target.points": path.points(k, scene.points).tolist(),
            "base_motion.kind": "none", "base_motion.rotation.kind": "none"})  # fmt: skip
        found = scene_of(moved).image(Poses(run.position[k], run.quaternion[k]))[0]
        np.testing.assert_allclose(found, expected[k], rtol=0, atol=1e-7)


def test_pointing_on_a_base_that_turns(machine: hs.Scenario) -> None:
    """The camera that points at a target in the world has the middle of the target where the goal has it."""
    keys = {"controller.tracking.follow": "direction", "base_motion.amplitude": [0.01, 0.0, 0.0]}
    turning = {"base_motion.rotation": {"kind": "sinusoid", "amplitude": [0.05, -0.05, 1.2], "frequency": 0.3}}
    scene = scene_of(machine.updated({**IN_WORLD, **keys, **turning}))
    path = path_of(scene)
    image = scene.image(path.seen_alike(_pointed(scene, path)))[0]
    middle = image.reshape(len(path), -1, 2).mean(axis=1)
    np.testing.assert_allclose(middle - scene.desired.reshape(-1, 2).mean(axis=0), 0.0, rtol=0, atol=1e-6)


def test_a_base_that_frames_show_as_something_else(machine: hs.Scenario) -> None:
    keys = {"camera.period": 0.1, "base_motion.amplitude": [0.1, 0.0, 0.0], "base_motion.frequency": 10.0}
    swinging = machine.updated({**IN_WORLD, **keys})
    (line,) = about_target(swinging, "base_motion.frequency")
    assert "the law does not see the motion" in line
    assert about_target(swinging.updated({"target.frame": "base"}), "base_motion.frequency") == []
