"""Checks of the legs and of the camera alone by the core, for a machine that is not known as a whole."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo.scenario.arrays import Array
from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.blocks import Blocks, Camera, Robot
from hexservo.scenario.leg_travel import home_lengths
from hexservo.scenario.parameters import Settings, core_settings
from hexservo.scenario.yaml import ScenarioError

_UNASKED = {"mass": 1.0, "inertia": [1.0, 1.0, 1.0], "stroke": 1.0, "force_limit": 1.0}  # keys that a robot must have
_CORNERS = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])


def require_hold(robot: dict[str, Any]) -> Array:
    """Refuse joints and a home where the legs do not hold the platform, by the robot's keys as far as they are known.

    Returns
    -------
    (6,) array
        Leg lengths at home [m], of cranks angles [rad].

    Raises
    ------
    ScenarioError
        With what the core expects of joints and home.
    """
    try:
        return home_lengths(Robot(**{**_UNASKED, **robot}))
    except ValueError as error:  # "robot.home_position: expected ..., got ..."
        raise ScenarioError([f"joints and home: {str(error).partition(': ')[2]}"]) from None


def problem_of_image(camera: dict[str, Any]) -> str | None:
    """Return what the core expects of a camera's image and lens, "camera.distortion: expected ..."; None: they fit.

    The camera has an `image_size`.
    """
    middle = camera.get("principal_point") or [0.0, 0.0]
    square = (_CORNERS + middle).ravel().tolist()  # within the image, if the principal point is
    target = {"initial_features": square, "desired_features": square}
    try:
        _settings(camera=Camera(**camera), target=target, simulation={"mode": SAMPLED_MODE}).validate()
    except ValueError as error:
        return str(error).partition(", got ")[0]
    return None


def _settings(**blocks: Any) -> Settings:
    """Return the core's settings of some blocks, not checked; the target is any where none is given."""
    square = _CORNERS.ravel().tolist()
    target = {"initial_features": square, "desired_features": square}
    return core_settings(Blocks.model_validate({"name": "parts", "target": target, **blocks}))
