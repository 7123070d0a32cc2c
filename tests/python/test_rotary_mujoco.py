"""Rotary legs against MuJoCo's closed chains: a free platform on cranks with hinges, and rods of constant length.

A rod is a spatial tendon between the end of a crank and a platform joint, whose length an equality keeps. Rods have no
mass, and cranks next to none: what theirs does to the motion is taken away by two runs, one with twice the inertia.
What the equalities give way falls with the square of the step: at this one it moves the platform by 3e-7 m.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hexservo import _core
from hexservo.scenario.parameters import core_parameters
from rotary_machine import AXES, CENTRES, CRANK, HOME, JOINTS, ROD, hexapod, machine, rods

Array = NDArray[np.float64]

DURATION = 0.3  # [s]
INERTIA = 1e-8  # of a crank about its axis [kg m^2]; that of the platform there is m r^2 = 4.5e-4
UNEQUAL = 1e-4 * np.array([3.0, -2.0, 4.0, -1.0, 3.0, -5.0])  # [N m], beyond the share of the weight


def text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


def model_of(robot: _core.RobotParameters, inertia: float, step: float) -> Any:
    ends, _, _ = rods(HOME, Rotation.identity())
    cranks = "".join(
        f"""
        <body pos="{text(CENTRES[leg])}">
          <joint name="hinge{leg}" type="hinge" axis="{text(AXES[leg])}" armature="{inertia!r}"/>
          <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-15 1e-15 1e-15"/>
          <site name="b{leg}" pos="{text(ends[leg] - CENTRES[leg])}"/>
        </body>
        """
        for leg in range(6)
    )
    sites = "".join(f'<site name="p{leg}" pos="{text(joint)}"/>' for leg, joint in enumerate(JOINTS))
    tendons = "".join(
        f'<spatial name="rod{leg}"><site site="b{leg}"/><site site="p{leg}"/></spatial>' for leg in range(6)
    )
    equalities = "".join(
        f'<tendon tendon1="rod{leg}" polycoef="0 0 0 0 0" solref="{2 * step!r} 1" solimp="0.9999 0.9999 0.001"/>'
        for leg in range(6)
    )
    motors = "".join(f'<motor joint="hinge{leg}" gear="1"/>' for leg in range(6))
    return mujoco.MjModel.from_xml_string(
        f"""
        <mujoco>
          <option timestep="{step!r}" integrator="RK4" gravity="{text(robot.gravity)}" tolerance="0" iterations="200"
                  solver="Newton"/>
          <worldbody>
            {cranks}
            <body pos="{text(HOME)}">
              <freejoint/>
              <inertial pos="0 0 0" mass="{robot.mass!r}" diaginertia="{text(np.diag(robot.inertia))}"/>
              {sites}
            </body>
          </worldbody>
          <tendon>{tendons}</tendon>
          <equality>{equalities}</equality>
          <actuator>{motors}</actuator>
        </mujoco>
        """
    )


@pytest.fixture(scope="module")
def robot() -> _core.RobotParameters:
    return core_parameters(machine()).robot


def torques(robot: _core.RobotParameters) -> Array:
    """Torques that hold the head at home, and unequal ones on top."""
    legs = hexapod()
    weight = np.concatenate([-robot.mass * np.array(robot.gravity), np.zeros(3)])
    return legs.leg_forces(legs.home_position, legs.home_quaternion, weight) + UNEQUAL


def mujoco_state(robot: _core.RobotParameters, inertia: float, step: float = 2.5e-5) -> tuple[Array, Array]:
    """Pose (position, quaternion with a positive w) and angles of the cranks beyond home after DURATION."""
    model = model_of(robot, inertia, step)
    data = mujoco.MjData(model)
    data.ctrl[:] = torques(robot)
    mujoco.mj_step(model, data, round(DURATION / step))
    np.testing.assert_allclose(data.ten_length, ROD, rtol=0, atol=5e-8)  # the loops stay closed
    pose = np.array(data.qpos[6:])
    return np.concatenate([pose[:3], pose[3:] * np.sign(pose[3])]), np.array(data.qpos[:6])


def test_the_motion_under_torques(robot: _core.RobotParameters) -> None:
    legs, body = hexapod(), _core.RigidBody()
    body.mass, body.inertia, body.gravity = robot.mass, robot.inertia, robot.gravity
    position, quaternion, _ = _core.drive_legs(
        legs,
        body,
        _core.DynamicsError(),
        legs.home_position,
        legs.home_quaternion,
        np.zeros(6),
        torques(robot),
        1e-4,
        round(DURATION / 1e-4),
    )
    ours = np.concatenate([position, quaternion * np.sign(quaternion[0])])
    (once, angles), (twice, more) = mujoco_state(robot, INERTIA), mujoco_state(robot, 2 * INERTIA)
    theirs = 2 * once - twice
    assert np.linalg.norm(position - HOME) > 10e-3  # the motion is large enough to mean something
    assert 2 * np.arccos(min(1.0, abs(quaternion[0]))) > 0.015
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)  # [m] and quaternion
    found = np.asarray(legs.leg_lengths(position, quaternion)) - legs.home_lengths
    np.testing.assert_allclose(found, 2 * angles - more, rtol=0, atol=1e-6 / CRANK)
