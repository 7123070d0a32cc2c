"""What is read into other keys: a tag, a grid, a goal pose, and what an accelerometer on the base recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array
from hexservo.scenario.blocks import Blocks, Target
from hexservo.scenario.motion import BaseMotion
from hexservo.scenario.parameters import core_settings
from hexservo.scenario.plain import plain, put
from hexservo.scenario.recording import kinematic
from hexservo.scenario.rules import Vector
from hexservo.scenario.tag import corners, nodes, normal, rotation_matrix
from hexservo.scenario.unit_slips import BEHIND
from hexservo.scenario.wording import number, quantity, vector

_BESIDE = math.tan(math.radians(80.0))  # of a point to the optical axis, over its depth: few lenses show more


def read_target(scenario: Blocks) -> None:
    """Replace tag, grid and desired pose of a scenario that is being made by points and desired features.

    Raises
    ------
    ValueError
        For a tag or a grid seen from behind, for a target that is too large to be seen from its desired pose, and for
        what the core refuses of robot, camera and target.
    """
    target = scenario.target
    written = target
    if target.tag is not None:
        _require_front(scenario, "tag", target.tag[1])
        target = _replace(scenario, {"tag": None, "points": corners(target.tag)})
    if target.grid is not None:
        _require_front(scenario, "grid", target.grid[3])
        target = _replace(scenario, {"grid": None, "points": nodes(target.grid)})
    if target.desired_pose is not None:
        settings = core_settings(scenario)
        settings["target.desired_features"] = np.zeros(2 * target.count)  # as many as there will be
        try:
            features = _core.project_target(settings, target.desired_pose)
        except ValueError as error:
            raise ValueError(_problem_of_size(scenario, written) or str(error)) from None
        _replace(scenario, {"desired_pose": None, "desired_features": features})


def read_motion(scenario: Blocks) -> None:
    """Replace the specific forces that a scenario's base recorded by the accelerations of its origin in W.

    Raises
    ------
    ValueError
        Where the base turns, and the recording has no attitudes.
    """
    motion = scenario.base_motion
    if motion.frame_of_acceleration == "kinematic" or motion.samples is None:
        return
    if motion.attitudes is None and motion.rotation.kind != "none":
        raise ValueError(
            "base_motion.frame_of_acceleration: expected kinematic for a recording without attitudes of a base that "
            "turns by base_motion.rotation, got specific_force, of which the weight cannot be taken out"
        )
    samples = kinematic(motion.samples, motion.attitudes, scenario.robot.gravity)
    changes = {"frame_of_acceleration": "kinematic", "samples": samples}
    # blocks are frozen for everyone else
    scenario.__dict__["base_motion"] = BaseMotion.model_validate(plain({**dict(motion), **changes}))


def problem_of_recording(held: Any, changes: Mapping[str, Any]) -> str | None:
    """Return what is wrong with changes to a base's recording that was read; None where nothing is.

    Accelerations that were read are kinematic, and whether gravity was ever in them is not known any more.

    Parameters
    ----------
    held
        Block `base_motion` as it is, as plain data.
    changes
        Of the scenario, by dotted key.
    """
    if not isinstance(held, dict) or held.get("samples") is None:
        return None
    if held.get("frame_of_acceleration", "kinematic") != "kinematic":  # not read yet
        return None
    blocks: dict[str, Any] = {}
    for path, value in plain(changes).items():
        put(blocks, path, value)
    given = blocks.get("base_motion")
    if not isinstance(given, dict):
        return None
    new = next((key for key in ("file", "samples") if given.get(key) is not None), None)
    frame = given.get("frame_of_acceleration")
    if new is not None and frame is None:
        return (
            f"base_motion.frame_of_acceleration: expected it beside base_motion.{new}, since the recording before it "
            "has become a kinematic one, whatever it was, got none; give kinematic, or specific_force for readings "
            "of an accelerometer"
        )
    if new is None and frame == "specific_force":
        return (
            "base_motion.frame_of_acceleration: expected kinematic for a recording that was read, got specific_force, "
            "by which gravity would be taken out twice; give base_motion.file or base_motion.samples beside it"
        )
    return None


def _require_front(scenario: Blocks, kind: str, pose: Vector) -> None:
    """Refuse a tag or a grid whose back the camera has before it, at home, at the start or at the desired pose."""
    poses = {
        "simulation.start.pose": scenario.simulation.start.pose,
        "target.desired_pose": scenario.target.desired_pose,
    }
    places = {"home": (np.zeros(3), np.eye(3))} | {
        name: (np.array(pose[:3]), rotation_matrix(pose[3:])) for name, pose in poses.items() if pose is not None
    }
    for name, (shift, turn) in places.items():
        camera, looks = _camera_at(scenario, shift, turn)
        ahead = -looks[:, 2]
        depth = float((np.array(pose[:3]) - camera) @ ahead)
        if depth <= 0.0:  # behind it, where no side is seen
            if name == "home":
                raise ValueError(_behind(scenario, kind, pose, depth, camera, ahead))
            continue  # the core refuses the pose
        if not float(np.array(normal(pose)) @ (camera - np.array(pose[:3]))) > 0.0:
            raise ValueError(
                f"target.{kind}.pose: expected a {kind} whose front, where its z axis points, is before the camera at "
                f"{name}, got one with its back to it"
            )


def _behind(scenario: Blocks, kind: str, pose: Vector, depth: float, camera: Array, ahead: Array) -> str:
    """Return that the camera, at a place (3,) [m] and looking along a direction (3,), has a tag behind it at home."""
    robot, on_base = scenario.robot, scenario.camera.mount.on == "base"
    frame = "platform's frame, in which the pose is" if on_base else "base frame"
    down = ""
    if not on_base and robot.gravity[2] > 0.0 and pose[2] > 0.0 > robot.home_position[2]:
        down = "; z of the base frame points down (robot.gravity): what is above the base has a negative z"
    return (
        f"target.{kind}.pose: expected a {kind} in front of the camera, which at home is at {vector(camera)} m and "
        f"looks along {vector(np.round(ahead, 6))} of the {frame} (robot.home_position, camera.mount, camera.axes), "
        f"got one {quantity(-depth, 'm')}{BEHIND}{down}"
    )


def _camera_at(scenario: Blocks, shift: Array, turn: Array) -> tuple[Array, Array]:
    """Return the camera's place (3,) [m] and attitude (3, 3) where the target's points are: in B, or in E.

    Of a platform that is displaced from home by a shift (3,) [m] and a rotation (3, 3). The attitude is that of the
    paper's axes, whose z points against the view.
    """
    robot, mount = scenario.robot, scenario.camera.mount
    position, attitude = np.array(robot.home_position) + shift, turn @ rotation_matrix(robot.home_attitude)
    place, looks = np.array(mount.position), rotation_matrix(mount.rotation)
    if scenario.camera.axes == "opencv":
        looks = looks * [1.0, -1.0, -1.0]
    if mount.on == "base":  # in E, as the tag
        return attitude.T @ (place - position), attitude.T @ looks
    return position + attitude @ place, attitude @ looks


def _problem_of_size(scenario: Blocks, written: Target) -> str | None:
    """Return that points which the camera has before it at home are nearly beside it: the target is too large.

    None where they are not, so that it is the desired pose that turns the camera away from them.

    Parameters
    ----------
    scenario
        With the points of its target, if it has any.
    written
        The target of the file, by its tag, its grid or its points.
    """
    points = scenario.target.points
    if points is None:
        return None
    place, looks = _camera_at(scenario, np.zeros(3), np.eye(3))
    x, y, z = ((np.array(points) - place) @ looks).T  # a camera looks along -z
    if not (z < 0.0).all():
        return None
    beside = np.hypot(x, y) / -z
    point = int(beside.argmax())
    if beside[point] < _BESIDE:
        return None
    if written.tag is not None:
        key, got = "tag.size", f"{number(written.tag[0])} m"
    elif written.grid is not None:
        key, got = "grid.spacing", f"{number(written.grid[2])} m"
    else:
        key, got = "points", f"point {point + 1} {quantity(float(np.hypot(x, y)[point]), 'm')} off the optical axis"
    return (
        f"target.{key}: expected a target (lengths in m) that is before a camera "
        f"{quantity(float(-z[point]), 'm')} away at home and at target.desired_pose, got {got}: point {point + 1} is "
        f"seen {math.degrees(math.atan(beside[point])):.1f} deg off the optical axis at home, and from "
        "target.desired_pose it is behind the camera"
    )


def _replace(scenario: Blocks, changes: dict[str, Any]) -> Target:
    target = Target.model_validate(plain({**dict(scenario.target), **changes}))
    scenario.__dict__["target"] = target  # blocks are frozen for everyone else
    return target
