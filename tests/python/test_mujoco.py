"""The plant against MuJoCo, an independent dynamics engine.

The same hexapod is built there from its joints: a free body on six spatial tendons, each with a motor of gear 1, whose
positive force acts towards a longer tendon, so it pushes. Gravity acts along +z, which points down in B; on the robot
"uneven" it is tilted, no joint lies on a circle, and home is turned.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo  # noqa: F401  raises a helpful error where the compiled module is missing
from hexservo import _core

Array = NDArray[np.float64]

DURATION = 0.3  # [s]
UNEQUAL = 1e-3 * np.array([20.0, 9.0, 19.0, 12.0, 20.0, 4.0])  # [N], beyond the share of the weight


def uneven() -> _core.RobotParameters:
    robot = _core.robot_preset("micro")
    hexapod, random = _core.Hexapod(robot), np.random.default_rng(5)
    robot.platform_joints = hexapod.platform_joints + random.uniform(-0.02, 0.02, (6, 3))
    robot.base_joints = hexapod.base_joints + random.uniform(-0.04, 0.04, (6, 3))
    robot.home_attitude = np.array([0.1, -0.15, 0.2])
    robot.gravity = np.array([1.5, -2.0, 9.0])
    return robot


def off_centre() -> _core.RobotParameters:
    robot = uneven()
    robot.centre_of_mass = np.array([0.012, -0.02, 0.03])
    c = robot.centre_of_mass
    robot.inertia = robot.inertia + robot.mass * (c @ c * np.eye(3) - np.outer(c, c))
    return robot


@pytest.fixture(params=["micro", "cubic", "uneven", "off centre"])
def robot(request: pytest.FixtureRequest) -> _core.RobotParameters:
    own = {"uneven": uneven, "off centre": off_centre}
    return own[request.param]() if request.param in own else _core.robot_preset(request.param)


def body_of(robot: _core.RobotParameters) -> _core.RigidBody:
    body = _core.RigidBody()
    body.mass, body.inertia, body.gravity = robot.mass, robot.inertia, robot.gravity
    body.centre_of_mass = robot.centre_of_mass
    return body


def text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


def mujoco_model(robot: _core.RobotParameters, step: float) -> Any:
    hexapod, c = _core.Hexapod(robot), np.array(robot.centre_of_mass)
    central = robot.inertia - robot.mass * (c @ c * np.eye(3) - np.outer(c, c))
    six = central[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    base = "".join(f'<site name="b{leg}" pos="{text(p)}"/>' for leg, p in enumerate(hexapod.base_joints))
    platform = "".join(f'<site name="p{leg}" pos="{text(p)}"/>' for leg, p in enumerate(hexapod.platform_joints))
    legs = "".join(f'<spatial name="{leg}"><site site="b{leg}"/><site site="p{leg}"/></spatial>' for leg in range(6))
    motors = "".join(f'<motor tendon="{leg}" gear="1"/>' for leg in range(6))
    return mujoco.MjModel.from_xml_string(
        f"""
        <mujoco>
          <option timestep="{step!r}" integrator="RK4" gravity="{text(robot.gravity)}"/>
          <worldbody>
            {base}
            <body pos="{text(robot.home_position)}" quat="{text(hexapod.home_quaternion)}">
              <freejoint/>
              <inertial pos="{text(c)}" mass="{robot.mass!r}" fullinertia="{text(six)}"/>
              {platform}
            </body>
          </worldbody>
          <tendon>{legs}</tendon>
          <actuator>{motors}</actuator>
        </mujoco>
        """
    )


def constant_forces(robot: _core.RobotParameters) -> Array:
    """Leg forces that hold the platform at home, and unequal ones on top."""
    hexapod = _core.Hexapod(robot)
    force = -robot.mass * np.array(robot.gravity)
    R_BE = np.empty(9)  # noqa: N806
    mujoco.mju_quat2Mat(R_BE, hexapod.home_quaternion)
    weight = np.concatenate([force, np.cross(R_BE.reshape(3, 3) @ robot.centre_of_mass, force)])
    return hexapod.leg_forces(hexapod.home_position, hexapod.home_quaternion, weight) + UNEQUAL


def mujoco_pose(robot: _core.RobotParameters, step: float) -> Array:
    """Position and quaternion (the sign with a positive w) after DURATION."""
    model = mujoco_model(robot, step)
    data = mujoco.MjData(model)
    data.ctrl[:] = constant_forces(robot)
    mujoco.mj_step(model, data, round(DURATION / step))
    assert data.time == pytest.approx(DURATION, rel=1e-9)
    pose = np.array(data.qpos)
    return np.concatenate([pose[:3], pose[3:] * np.sign(pose[3])])


def core_pose(robot: _core.RobotParameters, step: float) -> Array:
    hexapod = _core.Hexapod(robot)
    position, quaternion, _ = _core.drive_legs(
        hexapod,
        body_of(robot),
        _core.DynamicsError(),
        hexapod.home_position,
        hexapod.home_quaternion,
        np.zeros(6),
        constant_forces(robot),
        step,
        round(DURATION / step),
    )
    return np.concatenate([position, quaternion * np.sign(quaternion[0])])


@pytest.mark.parametrize("robot", ["micro"], indirect=True)
def test_home_share_of_the_weight(robot: _core.RobotParameters) -> None:
    np.testing.assert_allclose(constant_forces(robot) - UNEQUAL, 0.1337, rtol=0, atol=0.5e-4)  # printed digits


def test_pose_after_constant_leg_forces(robot: _core.RobotParameters) -> None:
    core, reference = core_pose(robot, 1e-4), mujoco_pose(robot, 1e-4)
    # The motion is large enough to mean something.
    home = _core.Hexapod(robot).home_quaternion
    assert np.linalg.norm(core[:3] - robot.home_position) > 0.030
    assert 2 * np.arccos(abs(core[3:] @ home)) > 0.15
    # Both have converged far below the tolerance: at twice the step they are where they were.
    assert np.abs(core - core_pose(robot, 2e-4)).max() < 1e-10
    assert np.abs(reference - mujoco_pose(robot, 2e-4)).max() < 1e-10
    np.testing.assert_allclose(core, reference, rtol=0, atol=1e-8)  # [m] and quaternion


def test_the_difference_is_that_of_the_time_steps(robot: _core.RobotParameters) -> None:
    """Both integrate with fourth order towards the same motion: the difference falls by 16 per halving."""
    exact = mujoco_pose(robot, 5e-5)
    steps = [4e-3, 2e-3, 1e-3]
    differences = [np.abs(core_pose(robot, step) - exact).max() for step in steps]
    ratios = np.divide(differences[:-1], differences[1:])
    assert np.all((ratios > 12) & (ratios < 20)), (differences, ratios)


@pytest.mark.parametrize("seed", range(5))
def test_lengths_and_wrench_map_at_random_poses(robot: _core.RobotParameters, seed: int) -> None:
    hexapod = _core.Hexapod(robot)
    random = np.random.default_rng(seed)
    model = mujoco_model(robot, 1e-3)
    data = mujoco.MjData(model)
    position = robot.home_position + random.uniform(-0.03, 0.03, 3)
    quaternion = hexapod.home_quaternion + random.uniform(-0.2, 0.2, 4)
    quaternion /= np.linalg.norm(quaternion)
    data.qpos[:] = np.concatenate([position, quaternion])
    mujoco.mj_forward(model, data)
    rounding = 32 * 2.0**-53  # a dozen operations on numbers below 1
    np.testing.assert_allclose(hexapod.leg_lengths(position, quaternion), data.ten_length, rtol=0, atol=rounding)

    # Tendon velocities for unit twists: MuJoCo's angular velocity is in the body's frame, ours in B.
    R_BE = np.empty(9)  # noqa: N806
    mujoco.mju_quat2Mat(R_BE, quaternion)
    rates = np.empty((6, 6))
    for axis, twist in enumerate(np.eye(6)):
        data.qvel[:] = np.concatenate([twist[:3], R_BE.reshape(3, 3).T @ twist[3:]])
        mujoco.mj_forward(model, data)
        rates[:, axis] = data.ten_velocity
    np.testing.assert_allclose(hexapod.wrench_map(position, quaternion), rates.T, rtol=0, atol=rounding)


def test_a_positive_leg_force_acts_as_its_column_of_h(robot: _core.RobotParameters) -> None:
    """The sign that all of the above relies on: one unit of actuator force accelerates as one column of H."""
    hexapod = _core.Hexapod(robot)
    model = mujoco_model(robot, 1e-3)
    data = mujoco.MjData(model)
    R_BE = np.empty(9)  # noqa: N806
    mujoco.mju_quat2Mat(R_BE, hexapod.home_quaternion)
    for leg, column in enumerate(hexapod.wrench_map(hexapod.home_position, hexapod.home_quaternion).T):
        data.ctrl[:] = np.eye(6)[leg]
        mujoco.mj_forward(model, data)
        moment = R_BE.reshape(3, 3).T @ column[3:]  # MuJoCo's is in the body's frame
        np.testing.assert_allclose(data.qfrc_actuator, [*column[:3], *moment], rtol=0, atol=32 * 2.0**-53)
