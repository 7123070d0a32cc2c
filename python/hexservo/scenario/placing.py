"""What is read into other keys: a tag, a grid, a goal pose, and what an accelerometer on the base recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.scenario.blocks import Blocks, Target
from hexservo.scenario.motion import BaseMotion
from hexservo.scenario.parameters import core_settings
from hexservo.scenario.plain import plain, put
from hexservo.scenario.recording import kinematic
from hexservo.scenario.rules import Vector
from hexservo.scenario.tag import corners, nodes, normal, rotation_matrix


def read_target(scenario: Blocks) -> None:
    """Replace tag, grid and desired pose of a scenario that is being made by points and desired features.

    Raises
    ------
    ValueError
        For a tag or a grid seen from behind, and for what the core refuses of robot, camera and target.
    """
    target = scenario.target
    if target.tag is not None:
        _require_front(scenario, "tag", target.tag[1])
        target = _replace(scenario, {"tag": None, "points": corners(target.tag)})
    if target.grid is not None:
        _require_front(scenario, "grid", target.grid[3])
        target = _replace(scenario, {"grid": None, "points": nodes(target.grid)})
    if target.desired_pose is not None:
        settings = core_settings(scenario)
        settings["target.desired_features"] = np.zeros(2 * target.count)  # as many as there will be
        features = _core.project_target(settings, target.desired_pose)
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
    """Refuse a tag or a grid whose back the camera has before it, at home or at the desired pose."""
    robot, mount = scenario.robot, scenario.camera.mount
    home = rotation_matrix(robot.home_attitude)
    places = {"home": (np.zeros(3), np.eye(3))}
    if (goal := scenario.target.desired_pose) is not None:
        places["target.desired_pose"] = (np.array(goal[:3]), rotation_matrix(goal[3:]))
    for name, (shift, turn) in places.items():
        position, attitude = np.array(robot.home_position) + shift, turn @ home
        camera = position + attitude @ np.array(mount.position)
        if mount.on == "base":  # in E, as the tag
            camera = attitude.T @ (np.array(mount.position) - position)
        if not float(np.array(normal(pose)) @ (camera - np.array(pose[:3]))) > 0.0:
            raise ValueError(
                f"target.{kind}.pose: expected a {kind} whose front, where its z axis points, is before the camera at "
                f"{name}, got one with its back to it"
            )


def _replace(scenario: Blocks, changes: dict[str, Any]) -> Target:
    target = Target.model_validate(plain({**dict(scenario.target), **changes}))
    scenario.__dict__["target"] = target  # blocks are frozen for everyone else
    return target
