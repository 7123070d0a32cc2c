"""Warnings about bases that move: tilt and rate of every kind, forces that their acceleration takes, and drift."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo.findings.check import notes, unlikely
from hexservo.scenario.rotations import quaternions_of_matrices


def about(scenario: hs.Scenario, head: str) -> list[str]:
    return [line for line in unlikely(scenario) if line.startswith(head)]


def swinging(kind: str, **keys: Any) -> hs.Scenario:
    rotation = {"kind": kind, **keys}
    return hs.load_scenario("composite-30hz").updated({"base_motion": {"kind": "none", "rotation": rotation}})


def test_a_rotation_in_degrees() -> None:
    (line,) = about(swinging("sinusoid", amplitude=[3.0, 0.0, 0.0], frequency=0.5), "base_motion.rotation")
    assert "base_motion.rotation.amplitude: the base tilts by 3 rad (172 deg); check that it is in radians" in line
    (line,) = about(swinging("sinusoid", amplitude=[0.0, 0.0, 3.0], frequency=0.5), "base_motion.rotation")
    assert "the base turns by up to 9.42 rad/s (540 deg/s)" in line  # 3 rad times 2 pi 0.5/s
    assert about(swinging("sinusoid", amplitude=[0.05, 0.0, 0.0], frequency=0.5), "base_motion") == []
    (line,) = about(swinging("noise", level=0.02), "base_motion.rotation.level")
    assert "check that it is in rad^2/Hz" in line


def test_a_road_that_tilts_its_vehicle() -> None:
    road = hs.load_scenario("rough-road")
    assert about(road, "base_motion") == []
    (line,) = about(road.updated({"base_motion.road.roughness": "H"}), "base_motion.road")
    assert "the base t" in line
    assert "check roughness, speed and dimensions of the vehicle" in line


@pytest.mark.parametrize("axis", range(3))
def test_legs_that_cannot_hold_the_platform_on_an_accelerating_base(axis: int) -> None:
    """Legs that take positions hold the platform in B: the largest force of a run that stays at home is the bound."""
    amplitude = np.zeros(3)
    amplitude[axis] = 30.0
    home = hs.load_scenario("pi-h824-positions").updated(
        {
            "target.desired_pose": None,
            "target.desired_features": hs.project(hs.load_scenario("pi-h824-positions"), [0.0] * 6).tolist(),
            "camera.noise": 0.0,
            "simulation.duration": 1.0,  # half a period: of the acceleration's two signs one
            "simulation.log_every": 1,
            "base_motion": {"kind": "sinusoid", "amplitude": amplitude.tolist(), "frequency": 0.5},
        }
    )
    largest = float(np.abs(hs.simulate(home).leg_forces).max())
    (line,) = about(home.updated({"robot.force_limit": 0.99 * largest}), "robot.force_limit")
    assert "needs to hold the platform at home on the base that moves" in line
    assert "accelerations of up to 30 m/s^2), at " in line
    assert about(home.updated({"robot.force_limit": 1.01 * largest}), "robot.force_limit") == []
    assert (
        about(home.updated({"robot.force_limit": 0.99 * largest, "target.frame": "world"}), "robot.force_limit") == []
    )


def recorded(moved: float, **keys: Any) -> hs.Scenario:
    """Return a base that moves along x from 1 s to 2 s of 6 s, and rests before and after."""
    time = 0.01 * np.arange(601)
    acceleration = np.where((time > 1) & (time < 2), 2.0 * np.pi * moved * np.sin(2.0 * np.pi * (time - 1.0)), 0.0)
    samples = np.column_stack([acceleration, 0.0 * time, 0.0 * time])
    motion = {"kind": "recorded", "samples": samples.tolist(), "sample_period": 0.01}
    return hs.load_scenario("pi-h824").updated(
        {"simulation.duration": 6.0, "base_motion": motion, "target.frame": "world", **keys}
    )


def test_the_velocity_that_ends_a_recording_where_it_began() -> None:
    """A base that ends 10 mm away in 6 s has -10/6 mm/s added: 10 mm of a target moves the image by f 10 mm/Z."""
    (line,) = (note for note in notes(recorded(0.010)) if note.startswith("base_motion.samples"))
    assert "their double integral ends (10, 0, 0) mm away" in line
    assert "(-1.67, 0, 0) mm/s is added to its velocity in the whole run" in line
    assert "by 42 px in 6 s" in line
    for scenario in (recorded(0.0), recorded(1e-4), recorded(0.010, **{"target.frame": "base"})):
        assert not any(note.startswith("base_motion.samples") for note in notes(scenario))


def test_quaternions_of_matrices() -> None:
    turns = Rotation.random(500, random_state=4)
    half = Rotation.from_rotvec(np.pi * np.eye(3))
    for each in (turns, half):
        found = Rotation.from_quat(np.roll(quaternions_of_matrices(each.as_matrix()), -1, axis=1))
        np.testing.assert_allclose((found * each.inv()).magnitude(), 0.0, rtol=0, atol=1e-14)
