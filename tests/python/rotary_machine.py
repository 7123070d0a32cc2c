"""A head on six cranks, for tests: the geometry that the package `reachy-mini` 1.13.0 ships (Apache-2.0).

Its file ``assets/kinematics_data.json`` has the numbers in a frame with z up, [mm]; they are those of B and E after
180 deg about x. The camera of these tests is the default one, which looks along -z of E: up.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]

CRANK, ROD = 0.040, 0.085  # [m]
_TURN = np.array([1.0, -1.0, -1.0])  # from their frame to B
_S = np.sqrt(0.75)
# centre x, y; axis x, y; crank at angle 0 x, y; platform joint x, y [mm, 1, 1, mm]
_LEGS = np.array(
    [
        [26.99, 26.75, -0.5, -_S, _S, -0.5, 20.648, 21.764],
        [9.67, 36.75, -0.5, -_S, -_S, 0.5, 8.524, 28.764],
        [-36.66, 10.0, 1.0, 0.0, 0.0, 1.0, -29.172, 7.0],
        [-36.66, -10.0, 1.0, 0.0, 0.0, -1.0, -29.172, -7.0],
        [9.67, -36.75, -0.5, _S, -_S, -0.5, 8.524, -28.764],
        [26.99, -26.75, -0.5, _S, _S, 0.5, 20.648, -21.764],
    ]
)


def _in_base(columns: slice, scale: float) -> Array:
    return np.asarray(np.column_stack([scale * _LEGS[:, columns], np.zeros(6)]) * _TURN)


CENTRES, JOINTS = _in_base(slice(0, 2), 1e-3), _in_base(slice(6, 8), 1e-3)
AXES, ZERO = _in_base(slice(2, 4), 1.0), _in_base(slice(4, 6), 1.0)
BRANCH = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
HOME = np.array([0.0, 0.0, -(0.177 - 0.07663)])  # [m]
UPRIGHT = np.deg2rad(35.90) * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # [rad], as printed


def robot() -> dict[str, Any]:
    """The robot block of a scenario."""
    return {
        "preset": None,
        "platform_joints": JOINTS.tolist(),
        "base_joints": CENTRES.tolist(),
        "home_position": HOME.tolist(),
        "legs": "rotary",
        "cranks": {
            "length": CRANK,
            "rod": ROD,
            "axes": AXES.tolist(),
            "zero": ZERO.tolist(),
            "branch": BRANCH.tolist(),
        },
        "mass": 0.28,
        "inertia": [8.1e-4, 5.6e-4, 7.6e-4],
        "stroke": 0.6,
        "force_limit": 0.79,
    }


def machine(changes: dict[str, Any] | None = None) -> hs.Scenario:
    """The task of the paper for this head, with gains that fit it."""
    document = hs.load_scenario("paper").to_mapping()
    document |= {"name": "rotary-head", "robot": robot()}
    law = {"controller.law": "composite", "controller.composite.auto.bandwidth": 3.0, "simulation.duration": 2.0}
    return hs.Scenario.from_mapping(document).updated({**law, **(changes or {})})


def hexapod(scenario: hs.Scenario | None = None) -> _core.Hexapod:
    """The legs."""
    return _core.Hexapod(core_parameters(scenario or machine()).robot)


def angles(position: Array, rotation: Rotation) -> Array:
    """Angles of the cranks, (6,) [rad], by the law of cosines in each crank's plane: another way than the core's.

    A platform joint at `across` the axis and `along` it sees a crank and the rod's shadow as a triangle.
    """
    u = position + rotation.apply(JOINTS) - CENTRES
    side = np.cross(AXES, ZERO)
    x, y, along = (u * ZERO).sum(axis=1), (u * side).sum(axis=1), (u * AXES).sum(axis=1)
    distance, shadow = np.hypot(x, y), np.sqrt(ROD**2 - along**2)
    inner = np.arccos((distance**2 + CRANK**2 - shadow**2) / (2 * CRANK * distance))
    return np.asarray((np.arctan2(y, x) + BRANCH * inner + np.pi) % (2 * np.pi) - np.pi)


def rods(position: Array, rotation: Rotation) -> tuple[Array, Array, Array]:
    """Ends of the cranks in B, unit vectors of the rods, lever arms w [m]."""
    theta = angles(position, rotation)[:, None]
    crank = CRANK * (np.cos(theta) * ZERO + np.sin(theta) * np.cross(AXES, ZERO))
    rod = position + rotation.apply(JOINTS) - CENTRES - crank
    unit = rod / np.linalg.norm(rod, axis=1)[:, None]
    return CENTRES + crank, unit, (unit * np.cross(AXES, crank)).sum(axis=1)


def random_pose(random: np.random.Generator, size: float = 1.0) -> tuple[Array, Rotation]:
    """A pose about home, most of them within the stroke at size 1."""
    shift = size * random.uniform(-0.01, 0.01, 3)
    return HOME + shift, Rotation.from_rotvec(size * random.uniform(-0.2, 0.2, 3))


def quaternion(rotation: Rotation) -> Array:
    """(w, x, y, z)."""
    return np.roll(rotation.as_quat(), 1)
