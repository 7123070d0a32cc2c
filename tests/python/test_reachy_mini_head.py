"""The packaged head on cranks: its geometry is that of its source, its ranges hold, and what a run gives.

Known results are of the plain kernel; tolerances leave room for the roundings of the others.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.scenario.parameters import core_parameters

HOME = np.array([0.0, 0.0, -0.10037])
# [deg] what the model of the source allows each crank, as its file `hardware_config.yaml` and its MuJoCo model have it
RANGES = np.array([[-48, 80], [-80, 70], [-48, 80], [-80, 48], [-70, 80], [-80, 48]])


@pytest.fixture(scope="module")
def head() -> hs.Scenario:
    return hs.load_scenario("reachy-mini-head")


@pytest.fixture(scope="module")
def result(head: hs.Scenario) -> hs.Result:
    return hs.simulate(head)


def test_the_geometry_is_that_of_the_source(head: hs.Scenario) -> None:
    cranks = head.robot.cranks
    np.testing.assert_allclose(np.array(head.robot.platform_joints), rotary_machine.JOINTS, atol=1e-12)
    np.testing.assert_allclose(np.array(head.robot.base_joints), rotary_machine.CENTRES, atol=1e-12)
    np.testing.assert_allclose(np.array(cranks.axes), rotary_machine.AXES, atol=1e-7)
    np.testing.assert_allclose(np.array(cranks.zero), rotary_machine.ZERO, atol=1e-7)
    np.testing.assert_array_equal(cranks.branch, rotary_machine.BRANCH)
    assert (cranks.length, cranks.rod) == (rotary_machine.CRANK, rotary_machine.ROD)
    hexapod = _core.Hexapod(core_parameters(head).robot)
    np.testing.assert_allclose(hexapod.home_lengths, rotary_machine.UPRIGHT, atol=1e-4)  # printed to 0.01 deg
    np.testing.assert_allclose(
        hexapod.home_lengths, rotary_machine.angles(HOME, Rotation.identity()), rtol=0, atol=1e-7
    )


def test_the_stroke_is_within_all_ranges(head: hs.Scenario) -> None:
    home = np.rad2deg(rotary_machine.UPRIGHT)
    margin = np.minimum(home - RANGES[:, 0], RANGES[:, 1] - home)
    assert np.rad2deg(head.robot.stroke) == pytest.approx(margin.min(), abs=0.01)


def test_the_inertia_is_that_about_the_middle_of_the_joints(head: hs.Scenario) -> None:
    """Steiner, from the one about the centre of mass in the source's frame with z up."""
    turn, c = np.diag([1.0, -1.0, -1.0]), np.array([0.0, -0.9e-3, 55.8e-3])
    about = np.diag([8.08e-4, 5.64e-4, 7.63e-4])
    about[0, 2] = about[2, 0] = 0.5e-4
    moved = about + head.robot.mass * (c @ c * np.eye(3) - np.outer(c, c))
    np.testing.assert_allclose(core_parameters(head).robot.inertia, turn @ moved @ turn.T, atol=2e-7)
    np.testing.assert_allclose(head.robot.centre_of_mass, turn @ c, atol=1e-12)


def test_the_camera_looks_forwards_at_an_upright_tag(head: hs.Scenario) -> None:
    """From home, by the pinhole equation alone: the tag is in the middle but for the principal point, its top above."""
    half, distance = 0.075, 0.6
    focal, centre = np.array(head.camera.focal_pixels), np.array(head.camera.principal_point)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # u right, v down
    seen = np.asarray(hs.project(head, np.zeros(6))).reshape(4, 2)
    np.testing.assert_allclose(seen, centre + corners * half / distance * focal, atol=2e-2)


def test_known_results(result: hs.Result) -> None:
    found = hs.metrics(result)
    assert result.outcome == "completed"
    # It gets to the pose, though a shift of 35 mm would look like half of the rotation.
    shift = result.position[-1] - result.position[0]
    turn = Rotation.from_quat(np.roll(result.quaternion[-1], -1)).as_rotvec()
    np.testing.assert_allclose(shift, [0.002, -0.003, -0.004], atol=1.5e-3)
    np.testing.assert_allclose(turn, [0.03, 0.06, 0.12], atol=6e-3)
    print({name: float(f"{value:.5g}") for name, value in found.items()})
    assert found["peak_error"] == pytest.approx(264.0, abs=0.5)  # [px]
    assert found["settling_time"] == pytest.approx(0.98, abs=0.07)  # [s], two frames
    assert found["rms_error"] == pytest.approx(0.97, abs=0.15)
    assert found["peak_rotation"] == pytest.approx(0.1385, abs=0.001)  # [rad], 0.1375 at the goal
    assert found["peak_leg_excursion"] == pytest.approx(0.167, abs=0.002)  # [rad]
    assert found["peak_leg_force"] == pytest.approx(0.070, abs=0.01)  # [N m] of 0.52


def test_it_topples_without_a_controller(head: hs.Scenario) -> None:
    """The centre of mass is above the joints: under the torques of home the head leaves it, faster and faster."""
    settings = core_parameters(head)
    hexapod, body = _core.Hexapod(settings.robot), settings.plant_body
    hold = hexapod.leg_forces(hexapod.home_position, hexapod.home_quaternion, body.weight(hexapod.home_quaternion))
    push = np.array([0.0, 0.0, 0.0, 1e-6, 0.0, 0.0])  # [rad/s]

    def away(duration: float) -> float:
        _, quaternion, _ = _core.drive_legs(
            hexapod,
            body,
            _core.DynamicsError(),
            hexapod.home_position,
            hexapod.home_quaternion,
            push,
            hold,
            1e-3,
            round(duration / 1e-3),
        )
        return 2.0 * float(np.linalg.norm(quaternion[1:]))

    assert away(0.4) > 3.0 * away(0.2) > 9.0 * away(0.1)
