"""Checks of the legs and of the lens alone by the core, for a machine that is not known as a whole."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo import _core
from hexservo.scenario.blocks import Blocks, Camera, Robot
from hexservo.scenario.parameters import Settings, core_settings
from hexservo.scenario.yaml import ScenarioError

_UNASKED = {"mass": 1.0, "inertia": [1.0, 1.0, 1.0], "stroke": 1.0, "force_limit": 1.0}  # keys that a robot must have
_CORNERS = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])


def require_hold(robot: dict[str, Any]) -> None:
    """Refuse joints and a home where the legs do not hold the platform, by the robot's keys as far as they are known.

    Raises
    ------
    ScenarioError
        With what the core expects of joints and home.
    """
    try:
        _core.Hexapod(_settings(robot=Robot(**{**_UNASKED, **robot})).robot)
    except ValueError as error:  # "robot.home_position: expected ..., got ..."
        raise ScenarioError([f"joints and home: {str(error).partition(': ')[2]}"]) from None


def shows_middle(camera: dict[str, Any]) -> bool:
    """Return whether a camera's lens shows the middle of its image, half as wide and half as high."""
    corners = _CORNERS * camera["image_size"] / 4.0  # [px], from the image centre
    return bool(np.isfinite(_settings(camera=Camera(**camera)).camera.features(corners)).all())


def _settings(**blocks: Any) -> Settings:
    """Return the core's settings of some blocks, not checked; the target is any."""
    square = _CORNERS.ravel().tolist()
    target = {"initial_features": square, "desired_features": square}
    return core_settings(Blocks.model_validate({"name": "parts", "target": target, **blocks}))
