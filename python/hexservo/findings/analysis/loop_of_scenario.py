"""From a scenario to its linear sampled loop, and to the run that checks it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hexservo.findings.analysis.linear_law import (
    LinearLaw,
    LinearPlant,
    NoRestError,
    RestPose,
    linear_law,
    linear_plant,
    rest_of,
)
from hexservo.findings.analysis.linear_loop import Actuation, Clock, SampledLoop
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import ALL_AXES, AT_HOME, AT_REST, scene_of
from hexservo.run.simulation import simulate, uninterrupted
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import gains_written
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import SMOOTH_KINDS
from hexservo.scenario.parameters import frame_period, reading_ticks
from hexservo.scenario.pixels import on_pinhole
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.yaml import ScenarioError

_PROPORTIONAL = ("kp", "kt", "drive", "gain", "gain_far")

OFFSET = 0.01
"""Largest feature offset from which a check by simulation starts [px]."""


_KNOWN = {
    "camera.smoothing": "features are not filtered",
    "uncertainty.latency": "latency is known",
    "uncertainty.focal_length": "focal length is known",
    "uncertainty.principal_point": "principal point is known",
}


class NotApplicableError(ValueError):
    """The linear analysis does not apply to a scenario; the text gives the reason."""


@dataclass(frozen=True, eq=False)
class LoopAtRest:
    """The linear loop of a scenario."""

    scenario: Scenario  # in sampled mode, without what does not act at rest
    as_if_sampled: bool  # the scenario itself is in continuous mode
    rest: RestPose
    free: SampledLoop  # with K_v = 0
    smooth: SampledLoop | None  # with the slope k_v/width; None for laws without K_v, and where it is 0
    slope: Array  # (6,) of it [N s/m; N m s/rad]
    task: Scenario  # sampled and without noise and faults as `scenario`, with its gravity error and its own start


def quiet(scenario: Scenario) -> Scenario:
    """Remove what a linear loop does not have: noise, faults, limits, motion of the base, errors of the weight.

    A scenario in continuous mode becomes one in sampled mode, with its camera's keys.

    Raises
    ------
    NotApplicableError
        Where the camera's times are no whole numbers of ticks.
    """
    changes: dict[str, Any] = {
        **AT_HOME,
        "simulation.mode": "sampled",
        "camera.latency_jitter": 0.0,
        "camera.timeout": None,
        "camera.noise": 0.0,
        "camera.quantisation": 0.0,
        "camera.dropout": 0.0,
        "camera.outlier_probability": 0.0,
        "camera.outlier_size": 0.0,
        "camera.smoothing": 0.0,
        "camera.image_size": None,
        "camera.on_lost": "hold",
        "camera.gate": None,
        "sensors.resolution": 0.0,
        "sensors.noise": 0.0,
        "actuators.saturation": False,
        "actuators.quantisation": 0.0,
        **AT_REST,
        "uncertainty.gravity": 0.0,
        "uncertainty.latency": 0.0,
        "robot.on_limit": "report",
    }
    try:
        return scenario.updated(changes)
    except ScenarioError as error:
        raise NotApplicableError(f"the sampled loop refuses the scenario's times: {error}") from error


def with_gains(scenario: Scenario) -> Scenario:
    """Return the scenario with the gains that `auto` gave it written: of another goal or camera it has the same."""
    written = gains_written(scenario)
    return scenario.updated(written) if written else scenario


def with_features(scenario: Scenario) -> Scenario:
    """Return the scenario with its pixels as features of a pinhole, of which the linear law is, and the same gains."""
    return on_pinhole(with_gains(scenario))


def clock_of(scenario: Scenario) -> Clock:
    """Return the camera's period and latency in ticks."""
    tick = scenario.simulation.step
    return Clock(max(1, round(frame_period(scenario) / tick)), round(scenario.camera.latency / tick))


def require_forces(scenario: Scenario) -> None:
    """Refuse a machine that takes positions: no wrench moves its platform, and so none is linearised.

    Raises
    ------
    NotApplicableError
        For such a machine.
    """
    if scenario.actuators.takes_positions:
        raise NotApplicableError(
            "the linear plant and loop are of a machine that takes forces, and the legs of this one follow positions "
            "(actuators.kind)"
        )


def _require_known(scenario: Scenario, keys: Iterable[str]) -> None:
    for key in keys:
        if np.any(np.asarray(value_at(scenario, key)) != 0.0):
            raise NotApplicableError(f"the linear loop is of a camera whose {_KNOWN[key]}, and {key} is not 0")


@lru_cache(maxsize=64)  # several parts of an analysis ask, one of them for sixteen signs of depth errors too
def loop_at_rest(scenario: Scenario) -> LoopAtRest:
    """Linearise a scenario's loop where it rests.

    Raises
    ------
    NotApplicableError
        For a machine that takes positions, a law without viscous damping, a camera without points, and where the loop
        rests nowhere near its goal.
    """
    controller = scenario.controller
    _require_linear(scenario)
    _require_known(scenario, _KNOWN)
    scenario = with_features(scenario)
    calm = quiet(scenario)
    slope = np.zeros(6)
    if controller.traits.switching:
        slope = np.broadcast_to(np.asarray(controller.gains.kv, dtype=float), (6,)) / controller.switching.width
    try:
        scene = scene_of(scenario)
        rest = rest_of(calm, scene)
        pose = rest.view.pose
        if not np.isfinite(rest.view.features).all():
            raise NoRestError("at the pose where the law rests a point is not in front of the camera")
        plant = linear_plant(calm, pose)
        free = _loop(calm, linear_law(calm, scene, pose), plant)
        smooth = _loop(calm, linear_law(calm, scene, pose, smooth=True), plant) if slope.any() else None
    except NoRestError as error:
        raise NotApplicableError(str(error)) from error
    as_if_sampled = not scenario.sampled
    own = {key: value_at(scenario, key) for key in ("uncertainty.gravity", *AT_HOME)}
    return LoopAtRest(calm, as_if_sampled, rest, free, smooth, slope, calm.updated(own))


def _require_linear(scenario: Scenario) -> None:
    """Refuse what has no linear loop; raise `NotApplicableError`."""
    require_forces(scenario)
    controller = scenario.controller
    if not controller.traits.viscous:
        raise NotApplicableError(
            f"the law {controller.law} has Coulomb damping only, which a linear loop does not describe"
        )
    if scenario.camera.convention == "as_printed":
        raise NotApplicableError(
            "a camera as_printed has no points, and so no pose at which the goal is seen; set "
            "camera.convention to eye_in_hand"
        )


def loop_at_home(scenario: Scenario) -> SampledLoop:
    """Linearise a scenario's loop with K_v = 0 at home, as if the image there were the goal.

    It need not find where the loop rests, and so describes any platform; errors of the camera that `loop_at_rest`
    refuses are left out.

    Raises
    ------
    NotApplicableError
        For a machine that takes positions, a law without viscous damping, and a camera without points.
    """
    _require_linear(scenario)
    known = {key: np.zeros_like(np.asarray(value_at(scenario, key), dtype=float)).tolist() for key in _KNOWN}
    calm = quiet(with_features(with_gains(scenario).updated(known)))
    scene = scene_of(calm)
    try:
        calm = calm.updated({"target.desired_features": scene.view(scene.home).features.tolist()})
        return _loop(calm, linear_law(calm, scene_of(calm), scene.home), linear_plant(calm, scene.home))
    except (NoRestError, ScenarioError) as error:
        raise NotApplicableError(str(error)) from error


def loop_with_weights(at_rest: LoopAtRest, weights: Array, *, smooth: bool) -> SampledLoop:
    """Return the linear loop of a scenario with other fuzzy weights.

    Parameters
    ----------
    at_rest
        Of the scenario.
    weights
        (6, 7, 7) [N; N m].
    smooth
        Whether K_v acts with its slope; otherwise it is zero.
    """
    calm, pose = at_rest.scenario, at_rest.rest.view.pose
    law = linear_law(calm, scene_of(calm), pose, smooth=smooth, weights=weights)
    return _loop(calm, law, linear_plant(calm, pose))


def loop_before_moving_target(at_rest: LoopAtRest, wrenches: Array) -> SampledLoop:
    """Return the linear loop of a scenario with disturbances: wrenches, and after them displacements of the target.

    K_v acts with its slope where the switching term has one at rest, else it is zero. A law that predicts takes the
    sensors' pose at an exposure for the one that shows that image, so that a target's displacement is an error of it.

    Parameters
    ----------
    at_rest
        Of the scenario.
    wrenches
        Of the first k disturbances, (6, k). The last six displace the target as a rigid body, in B, about the
        platform's origin at rest [m; rad].
    """
    calm, pose = at_rest.scenario, at_rest.rest.view.pose
    smooth = at_rest.smooth is not None and calm.controller.switching.kind in SMOOTH_KINDS
    loop = _loop(calm, linear_law(calm, scene_of(calm), pose, smooth=smooth), linear_plant(calm, pose), whole=True)
    target = np.hstack([np.zeros_like(wrenches), side_of_target(calm) * np.eye(6)])
    return replace(loop, disturbance=np.hstack([wrenches, np.zeros((6, 6))]), target=target)


def smooth_loop_at(scenario: Scenario, pose: Poses) -> tuple[SampledLoop, Clock]:
    """Return the linear loop of a scenario in sampled mode about a pose, where K_v acts with the slope k_v/width.

    A law without viscous damping has that of K_v. Errors of focal length and principal point are neglected.

    Raises
    ------
    NotApplicableError
        For a machine that takes positions, a camera that filters or whose latency is not known, and where the law
        cannot be evaluated.
    """
    require_forces(scenario)
    calm = quiet(
        with_features(scenario).updated({"uncertainty.focal_length": 0.0, "uncertainty.principal_point": [0.0, 0.0]})
    )
    _require_known(scenario, ("camera.smoothing", "uncertainty.latency"))
    try:
        law = linear_law(calm, scene_of(calm), pose, smooth=True)
    except NoRestError as error:
        raise NotApplicableError(str(error)) from error
    return _loop(calm, law, linear_plant(calm, pose)), clock_of(calm)


def rates_without_mass(scenario: Scenario, pose: Poses) -> Array:
    """Return the twist (6,) at which a law moves a platform without mass, by its displacement from a pose, (6, 6).

    Raises
    ------
    NoRestError
        Where the law cannot be evaluated there.
    NotApplicableError
        Where the camera's times are no whole numbers of ticks.
    """
    calm = on_pinhole(quiet(scenario)).updated({"robot.gravity": [0.0, 0.0, 0.0]})  # the twist carries no weight
    law = linear_law(calm, scene_of(calm), pose)
    return np.asarray(np.linalg.solve(-law.twist, law.frame[:, :6] + law.pose))


def side_of_target(scenario: Scenario) -> float:
    """Return 1 where a displaced target is seen as from a pose displaced against it, -1 for a camera on the base."""
    return 1.0 if scenario.camera.mount.on == "platform" else -1.0


def _loop(scenario: Scenario, law: LinearLaw, plant: LinearPlant, *, whole: bool = False) -> SampledLoop:
    tick, sensors = scenario.simulation.step, scenario.sensors
    encoders, reading = sensors.pose == "encoders", reading_ticks(scenario)
    # with a reading at every tick the sensors do not err, before a target that stays
    columns = slice(None) if whole or reading > 1 else slice(6)
    return SampledLoop(
        tick=tick,
        acceleration=plant.acceleration,
        frame=law.frame[:, columns],
        pose=law.pose,
        twist=law.twist,
        axes=law.axes,
        decay=law.decay,
        drive_frame=law.drive_frame[:, columns],
        drive_pose=law.drive_pose,
        drive_twist=law.drive_twist,
        reading=reading,
        differences=encoders and sensors.rate == "differences",
        actuation=actuation_of(scenario, plant),
    )


def actuation_of(scenario: Scenario, plant: LinearPlant) -> Actuation:
    """Return what the actuators of a sampled scenario do with a command, about the pose of a plant."""
    actuators, tick = scenario.actuators, scenario.simulation.step
    held = actuators.hold == "leg_forces"
    if not (held or actuators.delay > 0.0 or actuators.bandwidth is not None):
        return Actuation()
    left, average = lag(actuators.bandwidth, tick)
    return Actuation(
        through_legs=True,
        delay=round(actuators.delay / tick),
        left=left,
        left_on_average=average,
        stiffness=plant.stiffness,
        held=(plant.held_state, plant.held_force) if held else None,
    )


def lag(bandwidth: float | None, tick: float) -> tuple[float, float]:
    """Return the shares of a difference that a first-order lag leaves after a tick [s], and on its average.

    Of a bandwidth in Hz; None: no lag.
    """
    if bandwidth is None:
        return 0.0, 0.0
    ticks = 2.0 * np.pi * bandwidth * tick  # the tick over the time constant
    return float(np.exp(-ticks)), float(-np.expm1(-ticks) / ticks)


def proportional_gains(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the proportional gains of a scenario's law: all its gains but damping, prior and friction."""
    return tuple(name for name in _PROPORTIONAL if hasattr(scenario.controller.gains, name))


def scaled(scenario: Scenario, factor: float) -> Scenario:
    """Scale the proportional gains of a law: `proportional_gains`, and what has to go with them.

    These are the scale of the error of fuzzy systems, and the slope of an adaptive gain, which falls with the error in
    proportion.
    """
    controller = scenario.controller
    keys = list(proportional_gains(scenario))
    if controller.traits.memory:
        keys.append("fuzzy.error_scale")
    if hasattr(controller.gains, "gain_slope"):
        keys.append("gain_slope")
    paths = [f"controller.{controller.law}.{key}" for key in keys]
    return scenario.updated(
        {path: (np.asarray(value_at(scenario, path), dtype=float) * factor).tolist() for path in paths}
    )


def at_rest_at_home(at_rest: LoopAtRest) -> Scenario:
    """Return the loop with its pose of rest at home, where every run starts: the image there is the goal.

    What differs from the scenario is the attitude at rest, and the pose of the legs.
    """
    return at_rest.scenario.updated(
        {
            "target.points": None,
            "target.initial_features": at_rest.rest.view.features.tolist(),
            "target.depth": np.abs(at_rest.rest.view.depth).tolist(),
            "target.desired_features": at_rest.rest.view.features.tolist(),
        }
    )


def growth(
    scenario: Scenario,
    duration: float,
    *,
    every: int = 1,
    angle: float = 0.0,
    way: Array | None = None,
    without: Sequence[float] = (),
    offset: float = OFFSET,
    with_kv: bool = False,
) -> float:
    """Run a scenario with the goal at home from a small starting error, and measure the growth of a mode [1/s].

    The twist at every so many ticks, angular parts times the platform's radius, is multiplied by the
    turning of the mode, so that others average out (slow ones already in second differences, where the mode turns);
    the rate is that from the third quarter of the run to the last one, each under a Hann window. Infinite where the
    run ends early, NaN where it does without having gone anywhere.

    Parameters
    ----------
    scenario
        As `at_rest_at_home` gives it.
    duration
        Of the run [s]; at least 64 samples are taken.
    every
        Ticks of the loop's pattern.
    angle
        By which the mode turns over the pattern [rad].
    way
        Direction of the start, (6,) in B [m; rad]; None: along all axes.
    without
        Multipliers of real modes to be filtered out.
    offset
        Largest distance of a feature from its goal at the start [px].
    with_kv
        Whether K_v stays as it is; otherwise it is zero.
    """
    scene = scene_of(scenario)
    home = scene.view(scene.home)
    tick = scenario.simulation.step
    quarter = max(16, -(-round(duration / tick) // (4 * every)))  # in samples
    changes: dict[str, Any] = {
        "target.desired_features": home.after(ALL_AXES * scene.unit if way is None else way, offset).tolist(),
        "simulation.duration": 4 * quarter * every * tick,
        "simulation.log_every": 1,
    }
    if scenario.controller.traits.switching and not with_kv:
        changes[f"controller.{scenario.controller.law}.kv"] = 0.0
    result = uninterrupted(simulate(scenario.updated(changes)))
    if result.outcome != "completed":
        # Forward kinematics of legs of some metres may miss its tolerance: no statement on stability.
        lost = result.outcome == "solver_failed" and np.max(np.abs(result.feature_error[-1])) < 1.0
        return np.nan if lost else np.inf
    twist = result.twist[::every] * scene.levers
    for multiplier in [*without, *([1.0, 1.0] if angle > 1e-3 else [])]:
        twist = twist[1:] - multiplier * twist[:-1]
    turned = twist * np.exp(-1j * angle * np.arange(len(twist)))[:, None]
    window = np.hanning(quarter + 2)[1:-1, None]
    ends = (len(turned) - quarter, len(turned))
    third, last = (float(np.linalg.norm(np.sum(window * turned[end - quarter : end], axis=0))) for end in ends)
    return float(np.log(max(last, 1e-300) / max(third, 1e-300)) / (quarter * every * tick))
