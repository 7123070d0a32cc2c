"""A platform at rest: wrench and acceleration by law and plant of a scenario at poses, computed by the core."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import limited
from hexservo.findings.analysis.poses import Poses, by_displacement
from hexservo.findings.analysis.scene import Scene, scene_of
from hexservo.findings.caused import caused_by
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.parameters import gains_of
from hexservo.scenario.scenario import Scenario

_STEPS = np.repeat([1e-5, 1e-5], 3)  # [m; rad], of the central differences of a wrench


def springs_of(law: _core.LawProbe) -> Array:
    """Return the parts of a law's wrench that depend on the pose alone, (n, 6) in B [N; N m].

    Friction, fuzzy systems and weight are left out.
    """
    springs: Array = sum(
        (wrench for part, wrench in law.parts.items() if part not in ("switching", "fuzzy")),
        start=np.zeros_like(law.wrench),
    )
    return springs


class Rest(Scene):
    """A scene with its law and plant, for a platform at rest.

    Parameters
    ----------
    scenario
        Whose law acts with the weights that it starts with.
    gravity
        Part of the gravity error that acts [1].

    Raises
    ------
    ValueError
        For a scenario that the core refuses (`core_parameters`), and for a camera `as_printed`, which has no points.
    """

    def __init__(self, scenario: Scenario, gravity: float = 1.0) -> None:
        super().__init__(scenario)
        if not self.has_points:
            raise ValueError('camera.convention: expected "eye_in_hand", got "as_printed"')
        share = gravity * self.settings["uncertainty.gravity"]
        self.settings["uncertainty.gravity"] = share
        self.probe = _core.Probe(self.settings)  # that of the scene has all of the gravity error
        self.gains: Any = gains_of(self.settings)  # of the scenario's law
        self.weight: Array = np.array(self.body.gravity_wrench)  # G-bar, (6,) [N; N m]
        self.gravity_error: Array = np.asarray(share * self.weight)  # delta_G G-bar, (6,) [N; N m]

    def aimed_at(self, desired: Array) -> Rest:
        """Return a copy with another goal image, (2p,) [px]."""
        other = copy(self)
        self.settings["target.desired_features"] = desired
        other.probe = _core.Probe(self.settings)  # takes what it needs
        self.settings["target.desired_features"] = self.desired
        other.desired = desired
        return other

    def _of_law(
        self,
        wanted: Callable[[_core.LawProbe], Array],
        poses: Poses,
        twist: Array | None = None,
        *,
        exact_depth: bool = False,
    ) -> Array:
        """Return six numbers of what the law gives at poses, (..., 6), at rest or at twists (..., 6) in B.

        NaN where not all points are in view. With `exact_depth` the controller uses the true depths.
        """
        features, depth = self.image(poses)
        seen = np.asarray(np.isfinite(features).all(axis=-1)).ravel()
        result = np.full((len(seen), 6), np.nan)
        if seen.any():
            there = poses.rows[seen]
            speed = np.zeros((len(there), 6)) if twist is None else twist.reshape(-1, 6)[seen]
            believed = depth.reshape(-1, depth.shape[-1])[seen]
            if not exact_depth:
                believed = self.probe.measured_depth(believed)
            at = (there.position, there.quaternion, speed)
            result[seen] = wanted(self.probe.law(features.reshape(-1, features.shape[-1])[seen], believed, *at))
        return result.reshape(*poses.shape, 6)

    def wrench(self, poses: Poses, twist: Array | None = None) -> Array:
        """Return the law's wrench, (..., 6) in B [N; N m], at rest or at twists (..., 6) in B; weight included.

        NaN where not all points are in view.
        """
        return self._of_law(lambda law: law.wrench, poses, twist)

    def spring(self, poses: Poses, *, exact_depth: bool = False) -> Array:
        """Return `springs_of` the law at poses, (..., 6) in B [N; N m]; NaN where not all points are in view."""
        return self._of_law(springs_of, poses, exact_depth=exact_depth)

    def _left(self, poses: Poses) -> Array:
        """Return the wrench that is left of a platform at rest, (..., 6) in B [N; N m]; its zeros are equilibria."""
        return np.asarray(self.spring(poses) + self.gravity_error)

    def pose_error(self, poses: Poses, *, exact_depth: bool = False) -> Array:
        """Return the pose error that the law regulates, (..., 6) in B [m; rad]; NaN where not all points are in view.

        Of a law with `_core.LawTraits.pose_error`.
        """

        def error(law: _core.LawProbe) -> Array:
            assert law.pose_error is not None
            return law.pose_error

        return self._of_law(error, poses, exact_depth=exact_depth)

    def acceleration(self, poses: Poses, twist: Array | None = None) -> Array:
        """Return chi-ddot of the plant under the law, (..., 6) [m/s^2; rad/s^2], at rest or at twists (..., 6) in B.

        NaN where not all points are in view. Zero at rest: an equilibrium.
        """
        wrench = self.wrench(poses, twist).reshape(-1, 6)
        seen = np.asarray(np.isfinite(wrench).all(axis=1))
        if seen.any():
            there = poses.rows[seen]
            speed = np.zeros((len(there), 6)) if twist is None else twist.reshape(-1, 6)[seen]
            wrench[seen] = self.probe.acceleration(there.position, there.quaternion, speed, wrench[seen])
        return wrench.reshape(*poses.shape, 6)

    def stiffness(self, poses: Poses) -> Array:
        """Return minus the derivative of `acceleration` by displacement, (n, 6, 6) [1/s^2], in `unit` on both sides.

        Of equilibria (n,): it is that of the wrench left at rest, over the inertia. Central differences: with steps of
        1e-6 truncation and rounding leave about 1e-12 of the largest entry of the former.
        """
        force = 1.0 + float(np.abs(self.weight).max())  # beside a weight a smaller one would be lost in rounding
        per_wrench = caused_by(self.probe, poses.position, poses.quaternion, force * np.eye(6)) / force
        return np.asarray((per_wrench * self.unit / self.unit[:, None]) @ self._slope(self._left, poses))

    def _slope(self, of: Callable[[Poses], Array], poses: Poses) -> Array:
        return -by_displacement(of, poses, 1e-6 * self.unit) * self.unit / self.unit[:, None]

    def settled(
        self, starts: Poses, rounds: int = 10, of: Callable[[Poses], Array] | None = None
    ) -> tuple[Poses, Mask]:
        """Return zeros by Newton's method from each start, and which converged (last step below 1e-8).

        Of the wrench that is left at rest, `spring` and the gravity error, which are equilibria, or of another function
        from poses (n,) to (n, 6), linear and angular. The acceleration has the same zeros, but the rounding of a weight
        that the law balances: of 1e6 kg it is larger than what the spring does in a step of a derivative.
        """
        field = self._left if of is None else of
        poses, last = starts, np.full(len(starts), np.inf)
        for _ in range(rounds):
            slope, value = self._slope(field, poses), field(poses) / self.unit
            usable = np.isfinite(slope).all(axis=(1, 2)) & np.isfinite(value).all(axis=1)
            slope[~usable], value[~usable] = np.eye(6), 0.0
            # A step does not depend on the unit of an equation, but the condition number does.
            size = np.abs(slope).max(axis=2)
            size[size == 0.0] = 1.0
            slope, value = slope / size[:, :, None], value / size
            usable &= np.linalg.cond(slope) < 1e14  # beyond, a step is rounding
            slope[~usable] = np.eye(6)
            step = np.where(usable[:, None], np.linalg.solve(slope, value[..., None])[..., 0], 0.0)
            last = np.where(usable, np.abs(step).max(axis=1), np.inf)
            poses = poses.moved(limited(step) * self.unit)
        return poses, last < 1e-8


def not_analysed(scenario: Scenario, reason: str, *, any_body: bool = False) -> str:
    """Return why an analysis of poses and laws does not apply; empty if it does.

    Parameters
    ----------
    scenario
        Its law and its camera decide.
    reason
        Why its law is not analysed; empty if it is.
    any_body
        Whether the platform's mass does not enter.
    """
    if reason:
        return f"The law {scenario.controller.law} is not analysed here: {reason}."
    if scenario.camera.convention == "as_printed":
        return "A camera as_printed has no points in space, so no pose belongs to an image: not analysed."
    return "" if any_body else scene_of(scenario).unusual_body


class RestLaw:
    """The wrench that acts on a platform at rest, but for friction and fuzzy systems.

    It is the sum of the law's other parts and the gravity error delta_G G-bar.

    Parameters
    ----------
    scene
        With the law, its gains and its goal.
    exact_depth
        Whether the controller uses the true depths, that is, J in place of J-hat.
    """

    def __init__(self, scene: Scene, *, exact_depth: bool = False) -> None:
        self._rest = Rest(scene.scenario)
        self._exact_depth = exact_depth
        self.desired = self._rest.desired  # goal image, (2p,) [px]
        self.gravity_error = self._rest.gravity_error  # delta_G G-bar, (6,) [N; N m]

    def aimed_at(self, desired: Array) -> RestLaw:
        """Return a copy with another goal image, (2p,) [px]."""
        other = copy(self)
        other._rest, other.desired = self._rest.aimed_at(desired), desired
        return other

    def wrench(self, poses: Poses) -> Array:
        """Return the wrench at poses, (..., 6) in B [N; N m].

        Raises
        ------
        ValueError
            Where the law gives none: a point behind the camera, a singular pose.
        """
        wrench = self._rest.spring(poses, exact_depth=self._exact_depth)
        if not np.isfinite(wrench).all():
            raise ValueError("pose: expected one from which the law gives a wrench, got one behind a point or singular")
        return np.asarray(wrench + self.gravity_error)

    def stiffness(self, poses: Poses) -> Array:
        """Return minus the derivative of the wrench by the displacement, (..., 6, 6), by central differences."""
        return -by_displacement(self.wrench, poses, _STEPS)
