"""The displacements that K_v holds, as a polytope, and the farthest of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.rest import RestLaw
from hexservo.findings.analysis.scene import Scene, View
from hexservo.scenario.arrays import Array

SPAN = 0.2  # of the points' mean depth, and in rad: farther than this no image is called linear
_HALVES = 20  # of a step, at most, until all cranks close
_ROUNDING = 1e-12  # of the stroke: what a leg at its limit stays within it, whatever its length is rounded to


@dataclass(frozen=True, eq=False)
class RestSet:
    """Displacements d from a pose that K_v holds, linearised there: a polytope.

        low <= w - A d <= high          w: rest wrench at the pose, A: stiffness
        -stroke <= t + H^T d <= stroke  t: leg travel at the pose
        -span <= d <= span              where the linearisation ends at the latest

    The image error at d is error - J d.
    """

    view: View
    error: Array  # (2p,) [px], desired minus seen, at the pose
    wrench: Array  # w, (6,) [N; N m]
    stiffness: Array  # A, (6, 6) [N/m ... N m/rad]
    low: Array  # (6,) [N; N m]
    high: Array  # (6,)
    leg_rates: Array  # H^T, (6, 6): twist to leg rates
    travel: Array  # t, (6,) [m]
    stroke: float  # [m]
    radius: float  # r_p [m]: makes turns comparable with shifts
    span: Array  # (6,) [m; rad]
    axis: Array  # (3,) in B, of the camera, at the pose

    @classmethod
    def at(cls, scene: Scene, law: RestLaw, view: View, low: Array, high: Array) -> RestSet:
        """Linearise at a view."""
        pose = view.pose
        return cls(
            view=view,
            error=law.desired - view.features,
            wrench=law.wrench(pose),
            stiffness=law.stiffness(pose),
            low=low,
            high=high,
            leg_rates=scene.hexapod.wrench_map(pose.position, pose.quaternion).T,
            travel=scene.leg_travel(pose),
            stroke=scene.stroke,
            radius=scene.platform_radius,
            span=SPAN * np.repeat([view.mean_depth, 1.0], 3),
            axis=scene.optical_axis(pose),
        )

    def farthest(self, directions: Array, within: float | None = None) -> Array | None:
        """Return the displacements of the set with the largest direction . d: one linear program for each direction.

        They are solved as one program in blocks, which share nothing.

        Parameters
        ----------
        directions
            (k, 6), any scale.
        within
            Most that an entry of d may be, a share of the stroke (turns: times r_p) or of the span; None: any.

        Returns
        -------
            (k, 6) [m; rad]; None where no displacement satisfies all inequalities.

        Raises
        ------
        ArithmeticError
            Where the solver gives up.
        """
        from scipy.optimize import linprog
        from scipy.sparse import block_diag

        rows, limits, units = self._inequalities
        costs = -directions * units
        costs = costs / np.maximum(np.abs(costs).max(axis=1, keepdims=True), 1e-300)
        found = linprog(
            costs.ravel(),
            block_diag([rows] * len(costs), format="csc"),
            np.tile(limits, len(costs)),
            bounds=(None, None) if within is None else (-within, within),
        )
        if found.status == 0:
            return np.asarray(found.x.reshape(-1, 6) * units)
        # By how much must all inequalities give way? The answer always exists.
        widened = linprog(
            np.eye(7)[6],
            np.column_stack([rows, -np.ones(len(rows))]),
            limits,
            bounds=[((None, None) if within is None else (-within, within))] * 6 + [(0, None)],
        )
        if widened.status != 0 or widened.fun < 1e-7:
            raise ArithmeticError(f"stiction set: expected an answer of the linear program, got: {found.message}")
        return None

    @cached_property
    def _inequalities(self) -> tuple[Array, Array, Array]:
        """Return rows (36, 6), limits (36,) and units (6,), such that rows (d/units) <= limits, all near one."""
        units = np.minimum(self.span, self.stroke / np.repeat([1.0, self.radius], 3))
        pull = self.stiffness * units
        size = np.maximum(np.maximum(np.abs(self.low), np.abs(self.high)), 1e-6 * np.abs(pull).max(axis=1))
        legs = self.leg_rates * units / self.stroke
        near = np.diag(units / self.span)
        rows = np.vstack([pull / size[:, None], -pull / size[:, None], legs, -legs, near, -near])
        limits = np.concatenate(
            [
                (self.wrench - self.low) / size,
                (self.high - self.wrench) / size,
                1.0 - self.travel / self.stroke,
                1.0 + self.travel / self.stroke,
                np.ones(12),
            ]
        )
        return rows, limits, units

    def limits_at(self, displacement: Array) -> tuple[Array, Array, Array]:
        """Return which axes of K_v, which legs and which axes of the span bound the set there, (6,) of bool each."""
        rows, limits, units = self._inequalities
        tight = (limits - rows @ (displacement / units) < 1e-6).reshape(6, 6)
        return tight[0] | tight[1], tight[2] | tight[3], tight[4] | tight[5]

    def image_error(self, displacement: Array) -> Array:
        """Return the linearised image error at a displacement, (2p,) [px]."""
        return np.asarray(self.error - self.view.jacobian @ displacement)


@dataclass(frozen=True, eq=False)
class Extremes:
    """How far off the points of a `RestSet` are."""

    largest: float  # [px], of any coordinate of the image error: linear programs, exact for the linearised set
    rms: float  # [px], over all coordinates of the points: best of local searches, a lower bound of the largest
    turn: float  # [rad], of the camera's optical axis against the target, from the linearisation pose: the same
    displacements: Array  # (k, 6) [m; rad] of the vertices found, largest image error first
    pose: Array  # (6,) [m; rad], largest displacement along each axis from the linearisation pose


def extremes(rest: RestSet) -> Extremes | None:
    """Find the largest image error and the largest turn of the optical axis in the set.

    Linear programs give the largest and the least value of each coordinate; what is convex (RMS, turn) has its largest
    value at a vertex, and is climbed from the best one so far by the linear program of its gradient.

    Returns
    -------
        None for a set without points.
    """
    jacobian = rest.view.jacobian
    across = np.zeros((6, 6))  # a rotation about the optical axis does not move it
    across[3:, 3:] = np.eye(3) - np.outer(rest.axis, rest.axis)
    sideways = np.linalg.svd(across)[2][:2]
    ways = np.vstack([jacobian, np.eye(6), sideways, sideways.sum(axis=0)])
    ends = _only(rest, 2 * len(ways)) if (rest.low == rest.high).all() else rest.farthest(np.vstack([ways, -ways]))
    if ends is None:
        return None
    errors = rest.error - ends @ jacobian.T
    of_features = np.concatenate([ends[: len(jacobian)], ends[len(ways) : len(ways) + len(jacobian)]])
    largest = np.abs(rest.error - of_features @ jacobian.T).max(axis=1)
    rms = _climb(rest, ends[np.square(errors).sum(axis=1).argmax()], -jacobian, rest.error)
    turn = _climb(rest, ends[np.square(ends @ across).sum(axis=1).argmax()], across, np.zeros(6))
    return Extremes(
        largest=float(largest.max()),
        rms=float(np.sqrt(np.square(rest.image_error(rms)).mean())),
        turn=float(np.linalg.norm(across @ turn)),
        displacements=of_features[np.argsort(-largest, kind="stable")],
        pose=np.abs(ends).max(axis=0),
    )


def confirmed(scene: Scene, law: RestLaw, rest: RestSet, displacement: Array) -> tuple[Poses, float] | None:
    """Follow an extreme of the linearised set to a pose that K_v holds indeed, by the core's law and projection.

    The set is linearised again where the last linear program ended, with steps that become shorter. A step to where a
    crank does not close, which the linearisation does not have, goes as far as all of them close.

    Parameters
    ----------
    scene, law, rest
        The set, and what it was linearised from.
    displacement
        Of `Extremes.displacements`, whose largest image error is followed.

    Returns
    -------
        The pose and its largest image error [px]; None where none was found.
    """
    error = rest.image_error(displacement)
    coordinate = int(np.abs(error).argmax())
    sign = float(np.sign(error[coordinate]))
    margin = 1 - 1e-6
    found = None
    pose = _as_far_as_closed(scene, rest.view.pose, displacement)
    for within in (0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.007):
        view = scene.view(pose)
        if not (view.depth < 0).all():
            return found
        here = RestSet.at(scene, law, view, margin * rest.low, margin * rest.high)
        here = replace(here, stroke=(1 - _ROUNDING) * rest.stroke)
        inside = (here.wrench >= rest.low).all() and (here.wrench <= rest.high).all()
        if inside and (np.abs(here.travel) <= rest.stroke).all():
            reached = float(np.abs(here.error).max())
            if found is None or reached > found[1]:
                found = pose, reached
        direction = -sign * view.jacobian[coordinate : coordinate + 1]
        step = here.farthest(direction, within)
        if step is None:
            step = here.farthest(direction)
        if step is None:
            return found
        pose = _as_far_as_closed(scene, pose, step[0])
    return found


def _as_far_as_closed(scene: Scene, pose: Poses, step: Array) -> Poses:
    """Return the pose after a step, or after the longest half, quarter or less of it, at which each leg has a place."""
    for _ in range(_HALVES):
        moved = pose.moved(step)
        if np.isfinite(scene.leg_travel(moved)).all():
            return moved
        step = 0.5 * step
    return pose


def _only(rest: RestSet, copies: int) -> Array | None:
    """Return the one point of a set without width, (copies, 6); None where it is beyond stroke or span."""
    point = np.linalg.solve(rest.stiffness, rest.wrench - rest.low)
    legs = (np.abs(rest.travel + rest.leg_rates @ point) <= rest.stroke).all()
    return np.tile(point, (copies, 1)) if legs and (np.abs(point) <= rest.span).all() else None


def _climb(rest: RestSet, start: Array, matrix: Array, offset: Array) -> Array:
    """Climb |matrix d + offset|^2 over the set's vertices until no linear program leads higher."""
    best = start
    for _ in range(0 if (rest.low == rest.high).all() else 20):
        value = matrix @ best + offset
        found = rest.farthest((matrix.T @ value)[None])
        if found is None:
            return best
        higher = matrix @ found[0] + offset
        if higher @ higher <= value @ value * (1 + 1e-9):
            return best
        best = found[0]
    return best
