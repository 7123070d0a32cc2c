"""The plant against MuJoCo, an independent dynamics engine.

The same hexapod is built there from its joints: a free body on six spatial tendons, each with a motor of gear 1, whose
positive force acts towards a longer tendon, so it pushes. Gravity acts along +z, which points down in B.
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
HOME_ATTITUDE = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(params=["micro", "cubic"])
def robot(request: pytest.FixtureRequest) -> _core.RobotParameters:
    return _core.robot_preset(request.param)


def text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


def mujoco_model(robot: _core.RobotParameters, step: float) -> Any:
    hexapod = _core.Hexapod(robot)
    base = "".join(f'<site name="b{leg}" pos="{text(p)}"/>' for leg, p in enumerate(hexapod.base_joints))
    platform = "".join(f'<site name="p{leg}" pos="{text(p)}"/>' for leg, p in enumerate(hexapod.platform_joints))
    legs = "".join(f'<spatial name="{leg}"><site site="b{leg}"/><site site="p{leg}"/></spatial>' for leg in range(6))
    motors = "".join(f'<motor tendon="{leg}" gear="1"/>' for leg in range(6))
    return mujoco.MjModel.from_xml_string(
        f"""
        <mujoco>
          <option timestep="{step!r}" integrator="RK4" gravity="0 0 9.8"/>
          <worldbody>
            {base}
            <body pos="{text(robot.home_position)}">
              <freejoint/>
              <inertial pos="0 0 0" mass="{robot.mass!r}" diaginertia="{text(np.diag(robot.inertia))}"/>
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
    weight = np.array([0.0, 0.0, -9.8 * robot.mass, 0.0, 0.0, 0.0])
    return hexapod.leg_forces(hexapod.home_position, HOME_ATTITUDE, weight) + UNEQUAL


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
    body = _core.RigidBody()
    body.mass, body.inertia = robot.mass, robot.inertia
    position, quaternion, _ = _core.drive_legs(
        hexapod,
        body,
        _core.DynamicsError(),
        hexapod.home_position,
        HOME_ATTITUDE,
        np.zeros(6),
        constant_forces(robot),
        step,
        round(DURATION / step),
    )
    return np.concatenate([position, quaternion * np.sign(quaternion[0])])


def rotation_angle(quaternion: Array) -> float:
    return float(2 * np.arctan2(np.linalg.norm(quaternion[1:]), abs(quaternion[0])))


@pytest.mark.parametrize("robot", ["micro"], indirect=True)
def test_home_share_of_the_weight(robot: _core.RobotParameters) -> None:
    np.testing.assert_allclose(constant_forces(robot) - UNEQUAL, 0.1337, rtol=0, atol=0.5e-4)  # printed digits


def test_pose_after_constant_leg_forces(robot: _core.RobotParameters) -> None:
    core, reference = core_pose(robot, 1e-4), mujoco_pose(robot, 1e-4)
    home = np.concatenate([robot.home_position, HOME_ATTITUDE])
    # The motion is large enough to mean something.
    assert np.linalg.norm(core[:3] - home[:3]) > 0.030
    assert rotation_angle(core[3:]) > 0.2
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
    quaternion = HOME_ATTITUDE + random.uniform(-0.2, 0.2, 4)
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
    for leg, column in enumerate(hexapod.wrench_map(hexapod.home_position, HOME_ATTITUDE).T):
        data.ctrl[:] = np.eye(6)[leg]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_actuator, column, rtol=0, atol=32 * 2.0**-53)
