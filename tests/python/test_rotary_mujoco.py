"""Rotary legs against MuJoCo's closed chains: a free platform on cranks with hinges, and rods of constant length.

A rod is a spatial tendon between the end of a crank and a platform joint, whose length an equality keeps. Rods have no
mass, and cranks next to none: what theirs does to the motion is taken away by two runs, one with twice the inertia.
What the equalities give way falls with the square of the step: at this one it moves the platform by 3e-7 m.
The exported model (`hexservo export --mjcf`) is compared as it is, with the runs of the core.
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.bridges.mujoco_model import mjcf
from hexservo.scenario.parameters import core_parameters
from rotary_machine import AXES, CENTRES, CRANK, HOME, JOINTS, ROD, hexapod, machine, rods

Array = NDArray[np.float64]
HANGING = {"robot.gravity": [0.0, 0.0, -9.81]}  # stable under given torques; upright a head falls away from its path

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


@pytest.mark.slow
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


def exact(changes: dict[str, Any]) -> hs.Scenario:
    """The head without model errors, in sampled mode, with torques that are constant over each tick."""
    settings = {
        "uncertainty": hs.load_scenario("paper-nominal").to_mapping()["uncertainty"],
        "simulation.mode": "sampled",
        "simulation.step": 1e-3,
        "simulation.substeps": 1,
        "simulation.log_every": 1,
        "actuators.hold": "leg_forces",
        "controller.switching.kind": "implicit",
        "simulation.start.pose": [0.006, -0.004, 0.003, 0.03, -0.04, 0.08],
    }
    return machine({**settings, **changes})


@pytest.mark.parametrize(("gravity", "duration"), [pytest.param(HANGING, 1.0, marks=pytest.mark.slow), ({}, 0.15)])
def test_the_exported_model_moves_as_ours(gravity: dict[str, Any], duration: float) -> None:
    """Torques of a controlled run, held over each tick, move MuJoCo's cranks, rods and platform as ours."""
    run = hs.simulate(exact({**gravity, "simulation.duration": duration}))
    assert run.outcome == "completed", run.detail
    model = mujoco.MjModel.from_xml_string(mjcf(run.scenario))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "start"))
    steps = round(1e-3 / model.opt.timestep)
    assert model.opt.timestep * steps == pytest.approx(1e-3, rel=1e-12)
    states, gap = np.empty((len(run.time), 13)), 0.0
    for row, torque in enumerate(run.leg_forces):
        states[row] = data.qpos
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, steps)
        gap = max(gap, float(np.abs(data.ten_length - ROD).max()))
    difference = np.abs(states[:, :3] - run.position).max()
    print(f"largest difference {difference:.2g} m, of rods {gap:.2g} m")
    assert np.linalg.norm(run.position - run.position[0], axis=1).max() > 5e-3
    assert difference < 1e-6  # [m]
    assert gap < 1e-5 * CRANK
    sign = np.sign(np.sum(states[:, 3:7] * run.quaternion, axis=1))[:, None]
    np.testing.assert_allclose(sign * states[:, 3:7], run.quaternion, rtol=0, atol=2e-5)
    np.testing.assert_allclose(states[:, 7:], run.leg_lengths, rtol=0, atol=1e-6 / CRANK)


def test_a_model_of_a_light_machine_with_short_cranks() -> None:
    """Cranks of 25 mm below 0.25 kg: MuJoCo refuses less than 1e-15 kg m^2; what counts is in the armature."""
    scale = 0.025 / CRANK
    lengths = ("base_joints", "platform_joints", "home_position", "cranks.length", "cranks.rod")
    robot = exact({}).robot
    small = {f"robot.{key}": (scale * np.asarray(attrgetter(key)(robot))).tolist() for key in lengths}
    light = exact({**small, "robot.mass": 0.25, "robot.inertia": [1e-4, 1e-4, 2e-4]})
    model = mujoco.MjModel.from_xml_string(mjcf(light))
    cranks = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"crank{leg}") for leg in range(1, 7)]
    assert (model.body_inertia[cranks] <= 1e-4 * model.dof_armature[6:, None]).all()


def test_the_keys_of_the_exported_model() -> None:
    moving = exact({"simulation.start.twist": [0.01, 0.02, -0.01, 0.1, -0.2, 0.3], "simulation.duration": 0.01})
    model, run = mujoco.MjModel.from_xml_string(mjcf(moving)), hs.simulate(moving)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 1)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.ten_length, ROD, rtol=0, atol=1e-15)
    np.testing.assert_allclose(data.ten_velocity, 0.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(data.qpos[7:], run.leg_lengths[0], rtol=0, atol=1e-15)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, round(0.02 / model.opt.timestep))
    np.testing.assert_allclose(data.qpos[:3], HOME, rtol=0, atol=1e-7)  # the torques hold the head there
