"""The servo tick of a scenario at its pose of rest, as matrices: derivatives by finite differences of the core.

No equation of camera, law or plant stands here: images, Jacobians, ticks and motions are the core's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene, View, scene_of
from hexservo.findings.caused import caused_by
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import quantity

_POSE_STEP = 1e-6  # of the finite differences [m; rad]: far below a membership's width, far above rounding
_TWIST_STEP = 1e-6  # [m/s; rad/s], and at most a thousandth of the switching width
_ROUNDS = 40  # of the searches for the pose of rest


class NoRestError(ValueError):
    """No pose was found at which the loop rests at its goal."""


class NotFiniteError(NoRestError):
    """The law's numbers, or those of the loop, overflow; the message names what does."""


def too_long_a_period(scenario: Scenario) -> str:
    """Return that no controller takes the servo period of a scenario, as a clause; empty where one does."""
    period = scenario.simulation.step
    if period <= _core.LONGEST_SERVO_PERIOD:
        return ""
    most, found = (quantity(time, "s") for time in (_core.LONGEST_SERVO_PERIOD, period))
    return f"the servo period of {found} is more than the {most} that a controller takes"


@dataclass(frozen=True, eq=False)
class RestPose:
    """Pose of rest of a scenario's loop, with the weight known, K_v = 0, and a current image."""

    view: View
    residual: float  # largest |xi_d - xi| there [px]: 0 where the goal can be reached and the law asks for nothing else


@dataclass(frozen=True, eq=False)
class LinearLaw:
    """A servo tick at rest, to first order; displacements are (6,) in B [m; rad], twists (6,) [m/s; rad/s].

    The law's output is ``wrench - G = frame @ f + pose @ x + twist @ v - s`` with f what is known of the frame in use,
    x the pose of the joint sensors, v their twist and s the scalar outputs of the fuzzy systems [N; N m]. Without
    prediction f is the displacement of the true pose at the exposure, (6,); with it the error of the sensors' pose at
    the exposure follows, (12,).
    A tick takes s to ``decay * s + drive_frame @ f + drive_pose @ x + drive_twist @ v``. Only the axes whose systems
    can change are states: ``axes``.
    """

    frame: Array  # (6, 6) or (6, 12)
    pose: Array  # (6, 6)
    twist: Array  # (6, 6)
    axes: tuple[int, ...]  # of the fuzzy systems that adapt
    decay: Array  # (m,) for m axes; 1 without leakage
    drive_frame: Array  # (m, 6) or (m, 12)
    drive_pose: Array  # (m, 6)
    drive_twist: Array  # (m, 6)


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """The plant about rest, to first order, with wrenches (6,) [N; N m] and leg forces as equivalent wrenches."""

    acceleration: Array  # (6, 6) of a wrench: inverse of the actual inertia
    stiffness: Array  # (6, 6) d(H f)/dx with f the leg forces at rest [N/m, ...]
    held_state: Array  # (12, 12) (x, v) over one tick with held leg forces
    held_force: Array  # (12, 6) what leg forces H f = w add to it over one tick


class _Tick:
    """Camera, prediction and servo tick of a scenario at poses near rest."""

    def __init__(self, scenario: Scenario, scene: Scene, *, smooth: bool, weights: Array | None = None) -> None:
        settings = core_parameters(scenario)
        self.scenario = scenario
        self.points = scene.points
        self.camera, self.assumed_camera = scene.camera, settings.assumed_camera
        self.depth_scale: Array = 1.0 + settings["uncertainty.depth"]
        self.predicts = scenario.camera.prediction == "encoder"
        self.weight = scene.body.gravity_wrench
        # The points that the controller assumes, with their errors of depth: the tick adds none to them.
        settings["target.points"] = self._believed(scene.home)
        settings["uncertainty.depth"] = 0.0
        for key in ("position", "rotation"):
            settings[f"camera.mount.{key}"] = getattr(self.assumed_camera.mount, key)
            settings[f"uncertainty.mount.{key}"] = np.zeros(3)
        if _core.LAW_TRAITS[settings.law].switching:
            if smooth:
                settings["controller.switching.kind"] = "tanh"
            else:
                settings[f"controller.{settings.law}.kv"] = 0.0
        mode = settings["simulation.mode"]
        settings["simulation.mode"] = "continuous"  # a frame and a pose at every tick: `image` delays them
        if reason := too_long_a_period(scenario):
            raise NoRestError(reason)
        try:
            self.core = _core.Controller(settings, scenario.simulation.step)
        except ValueError as error:  # all else that it refuses in a valid scenario is a wrench that overflows
            raise NotFiniteError(str(error)) from error
        settings["simulation.mode"] = mode
        self.weights = weights
        self.probe = _core.Probe(settings)

    def _believed(self, pose: Poses) -> Array:
        """Back-project the image of a pose with the controller's depths and camera: the assumed points, (p, 3)."""
        features, depth = _core.take_image(self.camera, pose.position, pose.quaternion, self.points)
        if not np.isfinite(features).all():
            raise NotFiniteError(
                "target: expected an image of numbers where the loop rests, got one that is not finite"
            )
        return _core.lift(self.assumed_camera, pose.position, pose.quaternion, features, depth * self.depth_scale)

    def image(self, frame: Array, pose: Poses) -> tuple[Array, Array]:
        """Features and depths for the law at a pose, from a frame of another pose.

        `frame` is (12,): the displacement of the exposure from rest, then the error of the sensors' pose there.
        """
        exposure = self.rest.moved(frame[:6])
        if not self.predicts:
            features, depth = _core.take_image(self.camera, exposure.position, exposure.quaternion, self.points)
            return features, depth * self.depth_scale
        # What counts is the move from the exposure on as the sensors tell it: their error there acts the other way.
        seen_from = pose.moved(-frame[6:])
        believed = self._believed(exposure)
        return _core.take_image(self.assumed_camera, seen_from.position, seen_from.quaternion, believed)

    def step(self, frame: Array, pose: Poses, twist: Array) -> tuple[Array, Array]:
        """Wrench and fuzzy output of a tick."""
        features, depth = self.image(frame, pose)
        wrench, _, fuzzy, status, *_ = self.core.step(features, depth, pose.position, pose.quaternion, twist)
        if status != _core.InputStatus.valid:
            raise NoRestError(f"the law cannot be evaluated near its goal ({status.name})")
        return wrench, fuzzy

    def wrench(self, frame: Array, pose: Poses, twist: Array) -> Array:
        """Wrench of the law with `weights`, (6,)."""
        features, depth = self.image(frame, pose)
        weights = None if self.weights is None else self.weights[None]
        at = (pose.position[None], pose.quaternion[None], twist[None])
        return np.asarray(self.probe.law(features[None], depth[None], *at, weights).wrench[0])

    def response(self, frame: Array, displacement: Array, twist: Array) -> Array:
        """Wrench of one tick away from rest, and the fuzzy outputs of the two ticks at rest that follow it, (18,).

        The adaptation of a tick does not depend on the weights: the outputs are those after the weights of the
        scenario, the wrench is that with `weights`.
        """
        self.core.reset()
        pose = self.rest.moved(displacement)
        wrench, _ = self.step(frame, pose, twist)
        if self.weights is not None:
            wrench = self.wrench(frame, pose, twist)
        following = [self.core.step(*self.resting)[2] for _ in range(2)]
        return np.concatenate([wrench, *following])

    def balance(self, displacement: Array) -> Array:
        """Wrench beyond the weight for a platform at rest near `rest`, and the adaptation of a tick there, (12,)."""
        frame = np.concatenate([displacement, np.zeros(6)])
        pose = self.rest.moved(displacement)
        self.core.reset()
        wrench, before = self.step(frame, pose, np.zeros(6))
        return np.concatenate([wrench - self.weight, self.step(frame, pose, np.zeros(6))[1] - before])

    def at(self, pose: Poses) -> None:
        """Set the pose of rest."""
        self.rest = pose
        self.resting = (*self.image(np.zeros(12), pose), pose.position, pose.quaternion, np.zeros(6))


def _differences(count: int, step: float, at: Callable[[Array], Array]) -> Array:
    """Central differences of a function of `count` numbers, a column each."""
    return np.asarray(np.column_stack([(at(step * e) - at(-step * e)) / (2.0 * step) for e in np.eye(count)]))


def _by_twist(tick: _Tick, step: float) -> tuple[Array, tuple[int, ...], Array]:
    """Return the response to a twist (18, 6), the axes whose fuzzy systems adapt, and the leakage of a tick."""
    zero = np.zeros(6)
    response = _differences(6, step, lambda v: tick.response(np.zeros(12), zero, v))
    # A twist drives the system of the same axis; with a dead zone, or without fuzzy systems, none.
    taught = np.diag(response[6:12])
    axes = tuple(int(j) for j in np.flatnonzero(taught))
    decay = np.array([response[12 + j, j] / response[6 + j, j] for j in axes])
    decay[np.abs(decay - 1.0) < 1e-9] = 1.0  # rounding, where nothing is forgotten
    return response, axes, decay


def _law_at(tick: _Tick, twist_step: float) -> LinearLaw:
    zero = np.zeros(6)
    wide = 12 if tick.predicts else 6
    frame = _differences(wide, _POSE_STEP, lambda d: tick.response(np.append(d, np.zeros(12 - wide)), zero, zero))
    pose = _differences(6, _POSE_STEP, lambda d: tick.response(np.zeros(12), d, zero))
    twist, axes, decay = _by_twist(tick, twist_step)
    rows = [6 + j for j in axes]
    return LinearLaw(frame[:6], pose[:6], twist[:6], axes, decay, frame[rows], pose[rows], twist[rows])


def rest_of(scenario: Scenario, scene: Scene) -> RestPose:
    """Find the pose of rest of a scenario's loop: no wrench beyond the weight, and no adaptation.

    Newton's method on the tick of the core, from the pose that shows the desired features. With an integrating law
    (fuzzy systems whose drive is the pose error) that is where its error vanishes; otherwise where its wrench does.
    A prior (`composite`, `computed_torque`) moves it from the goal's pose towards home.

    Raises
    ------
    NoRestError
        Where there is none to be found.
    """
    goals = find_goals(scene)
    if goals is None:
        raise NoRestError("a camera as_printed has no points, and so no pose at which the goal is seen")
    if scene.unusual_body:
        raise NoRestError(scene.unusual_body.removesuffix("."))  # a clause, as the others
    pose = goals.best.view.pose
    if scenario.controller.traits.memory and scenario.controller.gains.fuzzy.enabled:
        # Far from rest what fuzzy systems learn bends with their memberships; the law without them leads near it.
        plain = scenario.updated({f"controller.{scenario.controller.law}.fuzzy.enabled": False})
        pose, _ = _settled(_Tick(plain, scene, smooth=False), pose)
    pose, settled = _settled(_Tick(scenario, scene, smooth=False), pose)
    if not settled:
        raise NoRestError("no pose near the goal was found at which the law rests")
    view = scene.view(pose)
    return RestPose(view, float(np.max(np.abs(scene.desired - view.features))))


def _settled(tick: _Tick, pose: Poses) -> tuple[Poses, bool]:
    """Search for rest by Newton's method from a pose; return the last pose, and whether the search converged."""
    tick.at(pose)
    _, axes, decay = _by_twist(tick, _TWIST_STEP)
    forgets = np.ones(6)
    forgets[list(axes)] -= decay

    def away(displacement: Array) -> Array:
        """Residual, zero at rest: adaptation equals leakage; without adaptation, the wrench."""
        balance = tick.balance(displacement)
        return forgets * balance[:6] - balance[6:]

    for _ in range(_ROUNDS):
        slope = _differences(6, _POSE_STEP, away)
        scale = np.maximum(np.abs(slope).max(axis=1), 1e-300)
        step = -np.linalg.lstsq(slope / scale[:, None], away(np.zeros(6)) / scale, rcond=1e-12)[0]
        if not np.isfinite(step).all():
            return tick.rest, False
        size = float(np.max(np.abs(step)))
        tick.at(tick.rest.moved(step * min(1.0, 0.1 / max(size, 1e-300))))
        if size < 1e-9:
            return tick.rest, True
    return tick.rest, False


def linear_law(
    scenario: Scenario, scene: Scene, pose: Poses, *, smooth: bool = False, weights: Array | None = None
) -> LinearLaw:
    """Linearise the servo tick of a scenario where its loop rests.

    Parameters
    ----------
    scenario
        In sampled mode; its camera's period and latency do not enter.
    scene
        Of that scenario, or of one that differs from it in times, faults or gains alone.
    pose
        Where it rests, see `rest_of`.
    smooth
        K_v acts with the slope ``k_v / controller.switching.width`` that ``tanh`` and ``saturation`` have at rest;
        otherwise K_v = 0.
    weights
        Of the fuzzy systems, (6, 7, 7) [N; N m]; None: those that the scenario starts with.

    Raises
    ------
    NoRestError
        Where the law cannot be evaluated there.
    NotFiniteError
        A `NoRestError`: where its output or its slope overflows.
    """
    tick = _Tick(scenario, scene, smooth=smooth, weights=weights)
    tick.at(pose)
    width = scenario.controller.switching.width
    with np.errstate(over="ignore", invalid="ignore"):  # overflow is refused below
        law = _law_at(tick, min(_TWIST_STEP, 1e-3 * width) if smooth else _TWIST_STEP)
    if not all(np.isfinite(slope).all() for slope in (law.frame, law.pose, law.twist)):
        raise NotFiniteError("controller: expected gains whose law has a finite slope, got one that is not finite")
    return law


def linear_plant(scenario: Scenario, pose: Poses) -> LinearPlant:
    """Linearise the actual plant about a pose at which the legs hold it, with its weight known (delta_G = 0)."""
    settings = core_parameters(scenario)
    scene = scene_of(scenario)
    hexapod, body = scene.hexapod, scene.body
    error = settings.dynamics_error
    error.gravity = np.zeros(6)
    resting = hexapod.leg_forces(pose.position, pose.quaternion, body.gravity_wrench)
    still = np.zeros(6)

    def wrench_map(displacement: Array) -> Array:
        place = pose.moved(displacement)
        return hexapod.wrench_map(place.position, place.quaternion)

    to_legs = np.linalg.inv(wrench_map(still))
    substeps = scenario.simulation.substeps
    step = scenario.simulation.step / substeps

    def pushed(start: Poses, twist: Array, forces: Array) -> tuple[Poses, Array]:
        place = (start.position, start.quaternion, twist)
        position, quaternion, rates = _core.drive_legs(hexapod, body, error, *place, forces, step, substeps)
        return Poses(position.reshape(-1, 3)[-1], quaternion.reshape(-1, 4)[-1]), rates.reshape(-1, 6)[-1]

    def columns(at: Callable[[Array], tuple[Poses, Array, Array]], sizes: Array) -> Array:
        both = [[pushed(*at(sign * move)) for sign in (1.0, -1.0)] for move in np.diag(sizes)]
        found = [np.concatenate([up[0].displacement_from(down[0]), up[1] - down[1]]) for up, down in both]
        return np.asarray(np.column_stack(found) / (2.0 * sizes))

    acceleration = acceleration_by_wrench(_core.Probe(settings), pose)
    # what changes a twist by its step within the tick: the same force is much for one platform, and little for another
    pushes = _TWIST_STEP / (np.abs(acceleration).max(axis=0) * scenario.simulation.step)
    held = [
        columns(lambda d: (pose.moved(d), still, resting), np.full(6, _POSE_STEP)),
        columns(lambda d: (pose, d, resting), np.full(6, _TWIST_STEP)),
    ]
    force = columns(lambda w: (pose, still, resting + to_legs @ w), pushes)
    stiffness = _differences(6, _POSE_STEP, lambda d: wrench_map(d) @ resting)
    return LinearPlant(acceleration, stiffness, np.hstack(held), force)


def acceleration_by_wrench(probe: _core.Probe, pose: Poses) -> Array:
    """Return the acceleration of the actual platform by a wrench at rest, (6, 6): the inverse of its inertia."""
    return np.asarray(caused_by(probe, pose.rows.position, pose.rows.quaternion, np.eye(6))[0])
