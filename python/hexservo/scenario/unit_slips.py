"""Units that a machine was probably not given in, for what the core refuses because of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hexservo.scenario.parameters import core_settings
from hexservo.scenario.wording import number, quantity

if TYPE_CHECKING:
    from hexservo.scenario.blocks import Blocks, Robot

_FAR = 20.0  # times the larger radius of the joints, a distance of home that legs between them do not have
_OF_MASS = "robot.inertia: expected an inertia about the platform's origin"
BEHIND = " behind it"
"""In what is refused because the camera has it behind it at home."""


def with_slip(problem: str, scenario: Blocks) -> str:
    """Return what is refused of a scenario with the number that is probably in another unit, if one explains it."""
    if problem.startswith(_OF_MASS):
        return problem + _of_mass(scenario)
    far = far_home(scenario.robot) if BEHIND in problem else None
    return problem if far is None else f"{problem}; robot.home_position: {far}"


def joint_radius(robot: Robot) -> float:
    """Return the largest distance of a joint from the origin of its body, of base and platform [m]."""
    return max(
        float(np.linalg.norm(np.asarray(joints), axis=1).max()) if joints is not None else radius or 0.0
        for joints, radius in (
            (robot.base_joints, robot.base_radius),
            (robot.platform_joints, robot.platform_radius),
        )
    )


def far_home(robot: Robot) -> str | None:
    """Return that home is too far from the base for the joints, as a length in millimetres is; None where it is not."""
    height, joints = float(np.linalg.norm(robot.home_position)), joint_radius(robot)
    if not height > _FAR * joints:
        return None
    return (
        f"{quantity(height, 'm')} from the base is more than {_FAR:.0f} times the {quantity(joints, 'm')} from the "
        f"middle to the joints; lengths are in metres: in mm it would be {quantity(1e-3 * height, 'm')}"
    )


def _of_mass(scenario: Blocks) -> str:
    """Return what mass and centre of mass need of an inertia that is too small for them, with the one in g or mm."""
    robot = scenario.robot
    distance = float(np.linalg.norm(robot.centre_of_mass))
    needed = (
        f"; robot.mass, {number(robot.mass)} kg, {quantity(distance, 'm')} from the origin (robot.centre_of_mass) "
        f"takes {number(robot.mass * distance**2)} kg m^2"
    )
    if distance > joint_radius(robot):
        key, slip = "robot.centre_of_mass", f"lengths are in metres: in mm it would be {quantity(1e-3 * distance, 'm')}"
    else:
        key, slip = "robot.mass", f"masses are in kg: in g it would be {number(1e-3 * robot.mass)} kg"
    settings = core_settings(scenario)
    settings[key] = 1e-3 * np.asarray(settings[key])
    try:
        settings.validate()
    except ValueError as error:
        if str(error).startswith("robot.inertia"):
            return needed
    return f"{needed}; {slip}"
