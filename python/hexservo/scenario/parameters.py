"""From a scenario to the core's numbers: the only place where the two vocabularies meet."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexservo import _core

if TYPE_CHECKING:
    from hexservo.scenario.blocks import Blocks
    from hexservo.scenario.laws import Fuzzy

__all__ = ["Settings", "core_parameters", "frame_period"]

Settings: TypeAlias = (
    _core.HybridSettings
    | _core.CompositeSettings
    | _core.KellySettings
    | _core.ResolvedRateSettings
    | _core.PbvsSettings
    | _core.ComputedTorqueSettings
)
"""A scenario in the core: one type for each law."""

_SETTINGS: dict[str, type[Settings]] = {
    "hybrid": _core.HybridSettings,
    "composite": _core.CompositeSettings,
    "kelly": _core.KellySettings,
    "resolved_rate": _core.ResolvedRateSettings,
    "pbvs": _core.PbvsSettings,
    "computed_torque": _core.ComputedTorqueSettings,
}


def core_parameters(scenario: Blocks) -> Settings:
    """Return the core's settings of a scenario, checked by the core.

    Raises
    ------
    ValueError
        Text "key: expected ..., got ..." for what only the maths can tell: an inertia that no body has, legs that
        cannot hold a platform, a target behind the camera, features that coincide, a log that does not fit.
    """
    settings = _of_law(scenario)
    settings.robot = _robot(scenario)
    settings.camera.focal_length = scenario.camera.focal_length
    settings.camera.pixel_scale = scenario.camera.pixel_scale
    settings.convention = _core.CameraConvention[scenario.camera.convention]
    settings.sampling = _sampling(scenario)
    settings.sensors = _sensors(scenario)
    settings.actuators = _actuators(scenario)
    settings.base_motion = _base_motion(scenario)
    settings.on_limit = _core.LimitPolicy[scenario.robot.on_limit]
    settings.jacobian = _core.JacobianConvention[scenario.controller.jacobian]
    settings.target = _target(scenario)
    settings.uncertainty = _uncertainty(scenario)
    settings.switching.kind = _core.SwitchingKind[scenario.controller.switching.kind]
    settings.switching.width = scenario.controller.switching.width
    for key in type(scenario.controller.safe).model_fields:
        gains = getattr(scenario.controller.safe, key)
        setattr(settings.safe, key, None if gains is None else _filled(gains, 6))
    settings.simulation.mode = _core.LoopMode[scenario.simulation.mode]
    settings.simulation.step = scenario.simulation.step
    settings.simulation.substeps = scenario.simulation.substeps
    settings.simulation.duration = scenario.simulation.duration
    settings.simulation.log_every = scenario.simulation.log_every
    settings.metrics.band = scenario.metrics.band
    settings.metrics.dwell = scenario.metrics.dwell
    settings.metrics.rms_start = scenario.metrics.rms_start
    settings.seed = scenario.seed
    settings.validate()
    return settings


def _of_law(scenario: Blocks) -> Settings:
    """Return settings for the scenario's law, with its gains: each key of the law's block has the core's name."""
    law = scenario.controller.law
    settings = _SETTINGS[law]()
    block = getattr(scenario.controller, law)
    for key in type(block).model_fields:
        setattr(settings.gains, key, _gain(getattr(block, key), getattr(settings.gains, key)))
    return settings


def _gain(value: Any, default: Any) -> Any:
    """Return a value of a law's block in the core's form, that of the core's default."""
    if isinstance(default, _core.FuzzyGains):
        return _fuzzy(value)
    if isinstance(default, np.ndarray):
        return _filled(value, *default.shape)
    return type(default)[value] if isinstance(default, Enum) else value


def _filled(value: Any, *shape: int) -> NDArray[np.float64]:
    """Return an array of that shape; a number stands for all entries."""
    return np.broadcast_to(np.asarray(value, dtype=float), shape)


def _robot(scenario: Blocks) -> _core.RobotParameters:
    robot = _core.RobotParameters()
    for key in (
        "platform_radius",
        "base_radius",
        "platform_angles",
        "base_angles",
        "home_position",
        "mass",
        "stroke",
        "force_limit",
    ):
        setattr(robot, key, getattr(scenario.robot, key))
    inertia = np.asarray(scenario.robot.inertia, dtype=float)
    robot.inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
    return robot


def _sampling(scenario: Blocks) -> _core.CameraSampling:
    camera = scenario.camera
    sampling = _core.CameraSampling()
    sampling.period = frame_period(scenario)
    sampling.latency, sampling.latency_jitter = camera.latency, camera.latency_jitter
    if camera.timeout is not None:  # none is the core's default
        sampling.timeout = camera.timeout
    faults = sampling.faults
    for key in ("noise", "quantisation", "dropout", "outlier_probability", "outlier_size"):
        setattr(faults, key, getattr(camera, key))
    if camera.image_size is not None:  # no border is the core's default
        faults.image_size = np.asarray(camera.image_size)
    faults.on_lost = _core.LostFeature[camera.on_lost]
    faults.prediction = _core.Prediction[camera.prediction]
    return sampling


def frame_period(scenario: Blocks) -> float:
    """Return the time between two exposures [s]: the servo period where the scenario, in continuous mode, has none."""
    return scenario.simulation.step if scenario.camera.period is None else scenario.camera.period


def _sensors(scenario: Blocks) -> _core.SensorSettings:
    settings = _core.SensorSettings()
    settings.pose = _core.PoseSource.truth if scenario.sensors.pose is True else _core.PoseSource.encoders
    settings.encoders.resolution = scenario.sensors.resolution
    settings.encoders.noise = scenario.sensors.noise
    if scenario.sensors.rate is True:  # differences are the core's default
        settings.encoders.rates = _core.RateSource.true_rates
    if scenario.sensors.period is not None:  # every tick is the core's default
        settings.period = scenario.sensors.period
    return settings


def _actuators(scenario: Blocks) -> _core.ActuatorSettings:
    settings = _core.ActuatorSettings()
    settings.delay = scenario.actuators.delay
    settings.actuators.hold = _core.ActuatorHold[scenario.actuators.hold]
    settings.actuators.saturation = scenario.actuators.saturation
    settings.actuators.quantisation = scenario.actuators.quantisation
    if scenario.actuators.bandwidth is not None:  # no lag is the core's default
        settings.actuators.bandwidth = scenario.actuators.bandwidth
    return settings


def _base_motion(scenario: Blocks) -> _core.BaseMotionSettings:
    settings = _core.BaseMotionSettings()
    base = scenario.base_motion
    settings.motion.kind = _core.BaseMotionKind[base.kind]
    for key in ("frequency", "phase", "low_frequency", "high_frequency"):
        setattr(settings.motion, key, getattr(base, key))
    settings.motion.amplitude = _filled(base.amplitude, 3)
    settings.motion.level = _filled(base.level, 3)
    if base.samples is not None and base.sample_period is not None:
        settings.samples = np.asarray(base.samples)
        settings.sample_period = base.sample_period
    return settings


def _target(scenario: Blocks) -> _core.Target:
    target = _core.Target()
    target.desired_features = np.asarray(scenario.target.desired_features)
    if scenario.target.points is not None:
        target.points = np.asarray(scenario.target.points)
    else:
        target.initial_features = np.asarray(scenario.target.initial_features)
        target.depth = _filled(scenario.target.depth, 4)
    return target


def _uncertainty(scenario: Blocks) -> _core.Uncertainty:
    uncertainty = _core.Uncertainty()
    uncertainty.dynamics.inertia = _filled(scenario.uncertainty.inertia, 6, 6)
    uncertainty.dynamics.coriolis = _filled(scenario.uncertainty.coriolis, 6, 6)
    uncertainty.dynamics.gravity = _filled(scenario.uncertainty.gravity, 6)
    uncertainty.depth = _filled(scenario.uncertainty.depth, 4)
    return uncertainty


def _fuzzy(fuzzy: Fuzzy) -> _core.FuzzyGains:
    gains = _core.FuzzyGains()
    gains.enabled = fuzzy.enabled
    gains.adaptation = _filled(fuzzy.adaptation, 6)
    gains.error_scale = _filled(fuzzy.error_scale, 6)
    gains.rate_scale = _filled(fuzzy.rate_scale, 6)
    gains.initial_scale = _filled(fuzzy.initial_scale, 6)
    if not isinstance(fuzzy.table, str):  # "linear" is the core's default
        gains.table = np.asarray(fuzzy.table)
    gains.bell_width = fuzzy.bell_width
    gains.bell_slope = fuzzy.bell_slope
    gains.leakage = _filled(fuzzy.leakage, 6)
    if fuzzy.weight_limit is not None:  # none is the core's default
        gains.weight_limit = _filled(fuzzy.weight_limit, 6)
    gains.dead_zone = _filled(fuzzy.dead_zone, 6)
    return gains
