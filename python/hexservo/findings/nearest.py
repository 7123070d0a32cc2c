"""The nearest pose that the legs reach, by sequential quadratic programming: for ``hs.reachable``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.rotations import conjugate

_ON_THE_EDGE = 1e-9  # of the stroke: a nearest pose may be so far beyond it
_LEVER = 1e-5  # least lever arm over crank: where rods are too long or short by its square a crank no longer closes
_INDEPENDENCE = 1e-9  # least determinant of the rods over that at home, whose sign counts
_STEP = 1e-6  # of differences, in units of the stroke
_MOST_STEPS = 200  # of a search on legs of variable length
_CRANK_STEPS, _CRANK_ROUNDS = 20, 5  # on cranks, where about 10 are enough: what has not come to rest begins afresh

# What is searched, (..., k) numbers of order 1 whose first six are the displacement from home
_Function: TypeAlias = Callable[[Array], Array]


def distance(scene: Scene, one: Array, other: Array) -> float:
    """Return the distance between displacements of home [m]: that of the poses, not of the numbers."""
    between = scene.home.moved(one).displacement_from(scene.home.moved(other))
    return float(np.linalg.norm(between * scene.levers))


def nearest_within(scene: Scene, wanted: Array) -> Array:
    """Return the displacement of home within reach that is nearest to one that is not, as far as it is found, (6,).

    Searches begin at the last pose within reach on the straight way from home and, with cranks, at home too. Of their
    ends and the first of these poses the nearest one that is within reach counts, whether its search came to rest or
    not.
    """
    shares = np.linspace(0.0, 1.0, 201)
    good = scene.reachable(scene.home.moved(shares[:, None] * wanted))
    best = np.asarray(shares[max(0, int(np.argmin(good)) - 1)] * wanted)
    rotary = scene.hexapod.rotary
    search = _by_cranks if rotary else _by_legs
    for start in (best, np.zeros(6)) if rotary else (best,):
        end = _within(scene, search(scene, wanted, start))
        if end is not None and distance(scene, wanted, end) < distance(scene, wanted, best):
            best = end
    return best


def _within(scene: Scene, found: Array) -> Array | None:
    """Return the end of a search, which is beyond the border by its tolerance: back towards home until it is within."""
    for share in (1.0, *(1.0 - np.geomspace(_ON_THE_EDGE, 0.5, 40))):
        if scene.reachable(scene.home.moved(share * found).rows)[0]:
            return np.asarray(share * found)
    return None


def _unit(scene: Scene) -> Array:
    """Return the displacements that move a platform joint by about the stroke, (6,) [m; rad]."""
    return np.asarray(scene.stroke_length / scene.levers)


def _away(scene: Scene, wanted: Array) -> _Function:
    """Return the function to be minimised: the squared distance in units of the stroke."""
    target, unit = scene.home.moved(wanted), _unit(scene)
    return lambda x: ((target.displacement_from(scene.home.moved(x[..., :6] * unit)) / unit) ** 2).sum(axis=-1)


def _minimised(
    function: _Function, start: Array, steps: int, constraints: Sequence[dict[str, Any]], **more: Any
) -> tuple[Array, bool]:
    """Return where a search ends, and whether it came to rest there."""
    from scipy.optimize import minimize

    options = {"maxiter": steps, "ftol": 1e-12}
    found = minimize(function, start, method="SLSQP", constraints=constraints, options=options, **more)
    return np.asarray(found.x), bool(found.success)


# ---- Legs of variable length ----------------------------------------------------------------------------------------


def _by_legs(scene: Scene, wanted: Array, start: Array) -> Array:
    """Search over poses."""
    unit = _unit(scene)

    def room(x: Array) -> Array:  # (12,), in units of the stroke; tilts, if limited, in squares, which are smooth
        pose = scene.home.moved(x * unit)
        travel = scene.leg_travel(pose) / scene.stroke
        tilts = np.empty(0) if scene.joint_limit is None else scene.limits_used(pose)[1:].ravel() ** 2
        return np.concatenate([1.0 - travel, 1.0 + travel, 1.0 - tilts])

    constraint = {"type": "ineq", "fun": room}
    return _minimised(_away(scene, wanted), start / unit, _MOST_STEPS, [constraint])[0] * unit


# ---- Cranks ---------------------------------------------------------------------------------------------------------


def _by_cranks(scene: Scene, wanted: Array, start: Array) -> Array:
    """Search over poses and angles of the cranks, with rods as long as they are.

    The angle of a pose has no value where the crank does not close, and no slope where crank and rod are in line. In
    poses and angles at once all is smooth: lengths of rods, lever arms, tilts, and whether rods are independent.
    """
    linkage = _Linkage(scene)
    unit = np.concatenate([_unit(scene), np.full(6, scene.stroke)])
    away = _away(scene, wanted)
    constraints = [
        {"type": kind, "fun": function, "jac": _slope(function)}
        for kind, function in (
            ("eq", lambda x: linkage.excess(x * unit)),
            ("ineq", lambda x: linkage.room(x * unit)),
        )
    ]
    ends = np.concatenate([np.full(3, linkage.span), np.full(3, 2.0 * np.pi), np.full(6, scene.stroke)]) / unit
    bounds = [(-end, end) for end in ends]
    found = np.concatenate([start, scene.leg_travel(scene.home.moved(start))]) / unit
    for _ in range(_CRANK_ROUNDS):
        found, at_rest = _minimised(away, found, _CRANK_STEPS, constraints, jac=_slope(away), bounds=bounds)
        if at_rest:
            break
    return np.asarray((found * unit)[:6])


def _slope(function: _Function) -> _Function:
    """Return the derivative of a function of many rows, (k,) of a number or (m, k), by central differences."""

    def slope(x: Array) -> Array:
        steps = _STEP * np.eye(len(x))
        after, before = np.split(function(x + np.concatenate([steps, -steps])), 2)
        return np.asarray(((after - before) / (2.0 * _STEP)).T)

    return slope


class _Linkage:
    """Cranks and rods at displacements of home and angles of the cranks, whether the rods fit between or not.

    Both are rows (..., 12): displacement [m; rad], and the angles from the middle of the travel [rad].
    """

    def __init__(self, scene: Scene) -> None:
        hexapod, home = scene.hexapod, scene.home
        self._scene = scene
        self._centres, self._joints = np.asarray(hexapod.base_joints), np.asarray(hexapod.platform_joints)
        self._axes = _directions(np.asarray(scene.scenario.robot.cranks.axes))
        self._cranks = np.asarray(hexapod.leg_feet(home.position, home.quaternion)) - self._centres
        self._home_travel = np.asarray(hexapod.home_lengths) - np.asarray(hexapod.mid_lengths)
        self._asked: Array = np.empty(0)
        at_home = np.concatenate([np.zeros(6), self._home_travel])
        arms, rods, levers = self._at(at_home)
        self._length = np.linalg.norm(rods, axis=-1)
        self._levers = np.sign(levers) * self._length * np.linalg.norm(self._cranks, axis=-1)
        self._independence = self._independent(arms, rods)
        self._directions = _directions(rods)
        turned_back = Poses(np.zeros(3), conjugate(home.quaternion))
        self._directions_in_platform = turned_back.carried(self._directions)

    @property
    def span(self) -> float:
        """A distance from home beyond which no pose is within reach [m]."""
        reach = self._length + np.linalg.norm(self._cranks, axis=-1)  # of a platform joint from the crank's axis
        return float(2.0 * (reach + np.linalg.norm(self._joints, axis=-1)).max())

    def excess(self, x: Array) -> Array:
        """Return by how much the distances that the rods span are too long, (..., 6), in units of the stroke."""
        _, rods, _ = self._at(x)
        longer = (rods * rods).sum(axis=-1) - self._length**2
        return np.asarray(longer / (2.0 * self._length * self._scene.stroke_length))

    def room(self, x: Array) -> Array:
        """Return what is negative beyond a limit: lever arms, the rods' independence and tilts, (..., k), of order 1.

        Lever arms and independence change their sign where home's side of the singular poses ends.
        """
        arms, rods, levers = self._at(x)
        independence = self._independent(arms, rods)[..., None] / self._independence - _INDEPENDENCE
        found = np.concatenate([levers / self._levers - _LEVER, independence], axis=-1)
        if self._scene.joint_limit is None:
            return np.asarray(found)
        homes = (self._with_cranks(x, self._directions), self._with_platform(x, self._directions_in_platform))
        cosines = [(_directions(rods) * home).sum(axis=-1) for home in homes]
        limits = 1.0 - np.cos(self._scene.joint_limit)
        tilts = [1.0 - (1.0 - cosine) / limit for cosine, limit in zip(cosines, limits, strict=True)]
        return np.concatenate([found, *tilts], axis=-1)

    def _at(self, x: Array) -> tuple[Array, Array, Array]:
        """Return platform joints from E's origin, rods (..., 6, 3) [m], and their lever arms times length, (..., 6).

        The last answer is kept: a search asks for `excess` and `room` of the same rows.
        """
        if not np.array_equal(x, self._asked):
            self._asked, self._answer = x.copy(), self._place(x)
        return self._answer

    def _place(self, x: Array) -> tuple[Array, Array, Array]:
        arms, cranks = self._with_platform(x, self._joints), self._with_cranks(x, self._cranks)
        position = self._scene.home.position + x[..., :3]
        rods = position[..., None, :] + arms - self._centres - cranks
        return arms, rods, (rods * np.cross(self._axes, cranks)).sum(axis=-1)

    def _with_cranks(self, x: Array, vectors: Array) -> Array:
        """Return vectors (6, 3) in B at home, each of which turns with a crank, (..., 6, 3)."""
        angles = (x[..., 6:] - self._home_travel)[..., None]
        along = (self._axes * vectors).sum(axis=-1, keepdims=True) * self._axes
        across = np.cross(self._axes, vectors)
        return np.asarray(along + np.cos(angles) * (vectors - along) + np.sin(angles) * across)

    def _with_platform(self, x: Array, vectors: Array) -> Array:
        """Return vectors (6, 3) in E, which turn with the platform, in B, (..., 6, 3)."""
        poses = self._scene.home.moved(x[..., :6])
        return Poses(np.zeros_like(poses.position), poses.quaternion).carried(vectors)

    def _independent(self, arms: Array, rods: Array) -> Array:
        """Return the determinant of the six lines of the rods, (...): 0 where forces along them leave a motion free."""
        along = _directions(rods)
        lines = np.concatenate([along, np.cross(arms, along) / self._scene.platform_radius], axis=-1)
        return np.asarray(np.linalg.det(lines))


def _directions(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
