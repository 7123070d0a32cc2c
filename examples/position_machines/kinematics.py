"""From the coordinates of legs to the pose of the platform and back, by the core."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import hexservo as hs
from hexservo import _core  # for the kinematics of the legs, of which there is one copy
from hexservo.scenario.parameters import core_parameters

__all__ = ["Kinematics", "Pose"]

Array: TypeAlias = NDArray[np.float64]
Pose: TypeAlias = tuple[Array, Array]
"""Position of E's origin in B [m], and quaternion (w, x, y, z) of E in B."""


class Kinematics:
    """Legs of a scenario: lengths [m], or angles of cranks [rad]."""

    def __init__(self, scenario: hs.Scenario) -> None:
        self._hexapod = _core.Hexapod(core_parameters(scenario).robot)
        self.home: Pose = (np.array(self._hexapod.home_position), np.array(self._hexapod.home_quaternion))
        self.home_legs: Array = np.array(self._hexapod.home_lengths)  # (6,)
        middle = np.array(self._hexapod.mid_lengths)
        self.lowest: Array = middle - scenario.robot.stroke  # (6,)
        self.highest: Array = middle + scenario.robot.stroke  # (6,)
        self._last = self.home

    def pose(self, legs: Array) -> Pose:
        """Return the pose of the platform where the legs are there, (6,), from the one that was found before.

        Raises
        ------
        ValueError
            Where no pose near that one belongs to them.
        """
        found = self._hexapod.forward_kinematics(legs, *self._last)
        if found.status != _core.KinematicsStatus.converged:
            raise ValueError("no pose of the platform belongs to these legs")
        self._last = (np.array(found.position), np.array(found.quaternion))
        return self._last

    def legs(self, pose: Pose) -> Array:
        """Return the coordinates of the legs at a pose, (6,); NaN where they do not reach it."""
        return np.array(self._hexapod.leg_lengths(*pose))
