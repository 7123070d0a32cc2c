"""The plant alone in MuJoCo: a free body on six spatial tendons, each with a motor of gear 1 that pushes.

Gravity acts along +z, which points down in B. Everything that the model does not have (contacts, limits, equality
constraints, friction) is switched off, so that MuJoCo does not look for it.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from hexservo import _core
from problem import Array


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


def plant_model(robot: _core.RobotParameters, step: float) -> Any:
    """Give the hexapod as a MuJoCo model, integrated by RK4 with that step [s]."""
    hexapod = _core.Hexapod(robot)
    base = "".join(f'<site name="b{leg}" pos="{_text(p)}"/>' for leg, p in enumerate(hexapod.base_joints))
    platform = "".join(f'<site name="p{leg}" pos="{_text(p)}"/>' for leg, p in enumerate(hexapod.platform_joints))
    legs = "".join(f'<spatial name="{leg}"><site site="b{leg}"/><site site="p{leg}"/></spatial>' for leg in range(6))
    motors = "".join(f'<motor tendon="{leg}" gear="1"/>' for leg in range(6))
    return mujoco.MjModel.from_xml_string(
        f"""
        <mujoco>
          <option timestep="{step!r}" integrator="RK4" gravity="0 0 9.8">
            <flag constraint="disable" contact="disable"/>
          </option>
          <worldbody>
            {base}
            <body pos="{_text(robot.home_position)}">
              <freejoint/>
              <inertial pos="0 0 0" mass="{robot.mass!r}" diaginertia="{_text(np.diag(robot.inertia))}"/>
              {platform}
            </body>
          </worldbody>
          <tendon>{legs}</tendon>
          <actuator>{motors}</actuator>
        </mujoco>
        """
    )


class MujocoPlant:
    """The platform from home, at rest, under constant leg forces."""

    def __init__(self, robot: _core.RobotParameters, leg_forces: Array, step: float, steps: int) -> None:
        self._model = plant_model(robot, step)
        self._data = mujoco.MjData(self._model)
        self._forces = leg_forces
        self._steps = steps

    def run(self) -> Array:
        """Pose (7,) at the end, with the sign of the quaternion that makes w positive; one call for all steps."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.ctrl[:] = self._forces
        mujoco.mj_step(self._model, self._data, self._steps)
        pose = np.array(self._data.qpos)
        return np.concatenate([pose[:3], pose[3:] * np.sign(pose[3])])


class CorePlant:
    """The same in the core."""

    def __init__(self, robot: _core.RobotParameters, leg_forces: Array, step: float, steps: int) -> None:
        self._hexapod = _core.Hexapod(robot)
        self._body = _core.RigidBody()
        self._body.mass, self._body.inertia = robot.mass, robot.inertia
        self._forces = leg_forces
        self._step = step
        self._steps = steps

    def run(self) -> Array:
        """Pose (7,) at the end."""
        position, quaternion, _ = _core.drive_legs(
            self._hexapod,
            self._body,
            _core.DynamicsError(),
            self._hexapod.home_position,
            [1.0, 0.0, 0.0, 0.0],
            np.zeros(6),
            self._forces,
            self._step,
            self._steps,
        )
        return np.concatenate([position, quaternion * np.sign(quaternion[0])])
