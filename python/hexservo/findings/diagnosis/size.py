"""Size of a machine and of its images relative to `micro`, and how a quantity grows with them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import default_of
from hexservo.scenario.leg_units import stroke_length
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario

_MICRO_MASS: float = default_of("robot.mass")  # [kg]
_MICRO_STROKE: float = default_of("robot.stroke")  # [m]
_MICRO_FOCAL: float = default_of("camera.focal_length") * default_of("camera.pixel_scale")  # [px]
_POWERS = {"m": (0, 1, 0), "kg": (1, 0, 0), "N": (1, 1, 0), "px": (0, 0, 1)}  # of the three scales; any other unit: 0


@dataclass(frozen=True)
class MachineSize:
    """Mass and length of a machine, and pixels of its images, over those of `micro`; times are the same."""

    mass: float
    length: float
    pixels: float = 1.0

    def scale(self, unit: str) -> Array:
        """Return how many times as large a quantity of some unit is, (1,), or of "linear; angular" ones, (6,)."""
        with np.errstate(over="ignore", under="ignore"):  # what is not finite is refused, and then not tried
            scales = np.array([self.mass, self.length, self.pixels])
            parts = [np.prod(np.power(scales, _powers(one))) for one in unit.split("; ")]
        return np.repeat(parts, 3) if len(parts) > 1 else np.array(parts)


@cache
def _powers(unit: str) -> tuple[float, ...]:
    """Return the powers of mass, length and pixels in a unit as of `N m/px^2` or `s/(N m)`: one division at most."""
    above, _, below = unit.partition("/")
    total = np.zeros(3)
    for sign, side in ((1, above), (-1, below)):
        for name, power in re.findall(r"([A-Za-z]+)(?:\^(\d))?", side):
            total += sign * int(power or 1) * np.array(_POWERS.get(name, (0, 0, 0)))
    return tuple(total.tolist())


def size_of(scenario: Scenario) -> MachineSize:
    """Return the size of a scenario's machine: the platform's radius of gyration, and the focal length that is assumed.

    That radius makes of forces moments, as gains have to. It does not depend on the target, whose distance may be any
    for one machine, nor on where the joints are.
    """
    robot = scenario.robot
    mass = robot.mass / _MICRO_MASS
    length = math.sqrt(_trace(robot.inertia) / _trace(default_of("robot.inertia")) / mass)
    return MachineSize(mass, length, core_parameters(scenario).assumed_camera.focal_pixels / _MICRO_FOCAL)


def device_size(scenario: Scenario) -> MachineSize:
    """Return the size for what devices do to a machine: its length is that of the stroke where this is the shorter one.

    A platform with a short stroke makes small motions, whatever its own size. What a camera adds to its pixels, noise
    and rounding, is not more for a longer focal length.
    """
    size = size_of(scenario)
    return MachineSize(size.mass, min(size.length, stroke_length(scenario.robot) / _MICRO_STROKE))


def _trace(inertia: Any) -> float:
    """Return the sum of the principal moments of inertia, given them (3,) or a matrix (3, 3) [kg m^2]."""
    given = np.asarray(inertia, dtype=float)
    return float(given.sum() if given.ndim == 1 else given.trace())
