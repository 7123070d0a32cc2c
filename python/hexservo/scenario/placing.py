"""A tag and a goal pose, read into the points and the features that follow from them."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo import _core
from hexservo.scenario.blocks import Blocks, Target
from hexservo.scenario.parameters import core_settings
from hexservo.scenario.plain import plain
from hexservo.scenario.tag import corners, normal

__all__ = ["read_target"]


def read_target(scenario: Blocks) -> None:
    """Replace tag and desired pose of a scenario that is being made by points and desired features.

    Raises
    ------
    ValueError
        For a tag seen from behind, and for what the core refuses of robot, camera and target.
    """
    target = scenario.target
    if target.tag is not None:
        centre, away = np.array(target.tag[1][:3]), np.array(normal(target.tag))
        if not float(away @ (np.array(scenario.robot.home_position) - centre)) > 0.0:
            raise ValueError(
                "target.tag.pose: expected a tag whose front, where its z axis points, is seen from home, "
                "got one that is seen from behind"
            )
        target = _replace(scenario, {"tag": None, "points": corners(target.tag)})
    if target.desired_pose is not None:
        features = _core.project_target(core_settings(scenario), target.desired_pose)
        _replace(scenario, {"desired_pose": None, "desired_features": features})


def _replace(scenario: Blocks, changes: dict[str, Any]) -> Target:
    target = Target.model_validate(plain({**dict(scenario.target), **changes}))
    scenario.__dict__["target"] = target  # blocks are frozen for everyone else
    return target
