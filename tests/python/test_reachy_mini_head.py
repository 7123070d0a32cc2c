"""The packaged heads on cranks: their geometry is that of its source, its ranges hold, and what a run gives.

Known results are of the plain kernel; tolerances leave room for the roundings of the others.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.scenario.arrays import Array
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


# ---- The head with motors that take angles --------------------------------------------------------------------------


def focal(scenario: hs.Scenario) -> Array:
    return np.asarray(scenario.camera.focal_pixels)


def centre(scenario: hs.Scenario) -> Array:
    return np.asarray(scenario.camera.principal_point)


@pytest.fixture(scope="module")
def tracker() -> hs.Scenario:
    return hs.load_scenario("reachy-mini")


def test_both_heads_are_one_robot_with_one_camera(head: hs.Scenario, tracker: hs.Scenario) -> None:
    """The detector's image has 320 columns of 3840 and 180 rows of 2592, and so the calibration."""
    assert tracker.robot == head.robot
    assert (tracker.camera.mount, tracker.camera.axes) == (head.camera.mount, head.camera.axes)
    scale = np.array([320 / 3840, 180 / 2592])
    assert tracker.camera.image_size == (320.0, 180.0)
    for of in (focal, centre):
        np.testing.assert_allclose(of(tracker), scale * of(head), atol=0.05)


def test_the_face_is_in_front_of_the_turned_head(tracker: hs.Scenario) -> None:
    """Landmarks at 1 m by hand, right and down of the camera's axis, seen after 25 deg to the left of W (-z of B)."""
    landmarks = 1e-3 * np.array([[-31.5, -33, 1000], [31.5, -33, 1000], [0, 0, 980], [-25, 34, 1000], [25, 34, 1000]])
    seen = landmarks[:, :2] / landmarks[:, 2:] * focal(tracker) + centre(tracker)
    turned = [0.0, 0.0, 0.0, 0.0, 0.0, -np.deg2rad(25.0)]
    np.testing.assert_allclose(np.asarray(hs.project(tracker, turned)).reshape(5, 2), seen, atol=5e-3)  # 0.01 mm at 1 m
    # From home it is left of the middle by 25 deg and the way of the camera, about 1 deg.
    first = np.asarray(hs.project(tracker, np.zeros(6))).reshape(5, 2)[2]
    angle = np.rad2deg(np.arctan((centre(tracker) - first) / focal(tracker))[0])
    assert 25.0 < angle < 27.0


def test_the_turn_to_the_face(tracker: hs.Scenario) -> None:
    result = hs.simulate(tracker)
    found = hs.metrics(result)
    print({name: float(f"{value:.5g}") for name, value in found.items()})
    assert result.outcome == "completed"
    turn = Rotation.from_quat(np.roll(result.quaternion[-1], -1)).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, [0.0, 0.0, -25.0], atol=0.15)
    # M leaves less than 1e-3 of a shift: the head turns where it is.
    assert np.abs(result.position - result.position[0]).max() < 1e-4
    assert found["settling_time"] == pytest.approx(0.76, abs=0.05)  # [s], of 1 deg: 0.1 s without a frame, ln(29)/5 s
    assert found["peak_leg_force"] < tracker.robot.force_limit


def test_frames_that_count_as_new_overshoot(tracker: hs.Scenario) -> None:
    """Without `camera.prediction` the controller takes an image 0.1 to 0.2 s old for a current one."""
    late = hs.metrics(hs.simulate(tracker.updated({"camera.prediction": "none"})))
    assert late["overshoot"] > 5.0 * hs.metrics(hs.simulate(tracker))["overshoot"]
