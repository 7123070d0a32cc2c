"""From a scenario to the core's numbers, key by key."""

from __future__ import annotations

import math
from functools import cache
from operator import attrgetter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo import _core
from hexservo.scenario.block import SAMPLED_MODE

if TYPE_CHECKING:
    from hexservo.scenario.blocks import Blocks, Robot

_NEVER = 700.0  # an exponent that is still a number

Settings = _core.Settings
"""A scenario in the core, by dotted keys: ``settings["camera.noise"]``."""


def core_parameters(scenario: Blocks) -> Settings:
    """Return the core's settings of a scenario, checked by the core.

    Raises
    ------
    ValueError
        Text "key: expected ..., got ..." for what only the maths can tell: an inertia that no body has, legs that
        cannot hold a platform, a target behind the camera, features that coincide, a log that does not fit.
    """
    settings = core_settings(scenario)
    settings.validate()
    return settings


def core_settings(scenario: Blocks) -> Settings:
    """Return the core's settings of a scenario, as they are: `core_parameters` checks them."""
    law = scenario.controller.law
    settings = _core.Settings(law)
    keys, values_of = _walk(law)
    for key, value in zip(keys, values_of(scenario), strict=True):
        _put(settings, key, value)
    return settings


def robot_settings(robot: Robot) -> Settings:
    """Return the core's settings with the keys of a robot alone, as they are: the others have the core's defaults."""
    law, head = next(iter(_core.LAW_TRAITS)), "robot."
    settings = _core.Settings(law)
    for key in _keys(law):
        if key.name.startswith(head):
            _put(settings, key, attrgetter(key.name.removeprefix(head))(robot))
    return settings


def _put(settings: Settings, key: _core.ScenarioKey, value: Any) -> None:
    """Set a key to the value of a scenario."""
    in_core = value if type(value) is float else _in_core(key, value)
    if in_core is not None or key.none is not None:  # null is the core's default, or stands for a number
        settings[key.name] = in_core


@cache
def _keys(law: str) -> tuple[_core.ScenarioKey, ...]:
    return tuple(_core.scenario_keys(law))


@cache
def units_of_keys(law: str) -> dict[str, str]:
    """Return the units of the core's keys, of legs that are prismatic; "linear; angular" where an array mixes both."""
    return {key.name: key.unit for key in _keys(law)}


@cache
def _walk(law: str) -> tuple[tuple[_core.ScenarioKey, ...], attrgetter[tuple[Any, ...]]]:
    """Return the keys of a law's scenarios, and what gives the values of all of them: most runs take less time."""
    return _keys(law), attrgetter(*(key.name for key in _keys(law)))


def _in_core(key: _core.ScenarioKey, value: Any) -> Any:
    """Return a value as the core takes it."""
    if key.type == "choice" and value is True:
        return next(choice for choice in key.choices if choice_in_file(choice) is True)
    if key.type == "array" and isinstance(value, str):  # "linear" is the core's default table
        return None
    return value


def choice_in_file(choice: str) -> str | bool:
    """Return what a scenario file has for a choice of the core: true for the true value of something, else its name."""
    return True if choice.startswith("tru") else choice


def gains_of(settings: Settings) -> Any:
    """Return a copy of the gains of the settings' law: one attribute for each key, those of a block in its own.

    Gains of image coordinates are multiplied by the weights of their points, as they act.
    """
    gains = SimpleNamespace()
    head = f"controller.{settings.law}."
    for key in _keys(settings.law):
        if key.name.startswith(head):
            *blocks, name = key.name.removeprefix(head).split(".")
            place = gains
            for block in blocks:
                place = vars(place).setdefault(block, SimpleNamespace())
            value = settings[key.name]
            setattr(place, name, value * np.repeat(settings["target.weights"], 2) if key.per_point == 2 else value)
    return gains


def frame_period(scenario: Blocks) -> float:
    """Return the time between two exposures [s]: the servo period where ``camera.period`` is null."""
    return scenario.simulation.step if scenario.camera.period is None else scenario.camera.period


def reading_ticks(scenario: Blocks, step: float | None = None) -> int:
    """Return the servo periods from one reading of the joints to the next, ``simulation.step`` or a `step` [s]."""
    sensors = scenario.sensors
    if sensors.pose != "encoders" or sensors.period is None:
        return 1
    return max(1, round(sensors.period / (scenario.simulation.step if step is None else step)))


def oldest_image(scenario: Blocks) -> int:
    """Return the age of the oldest image that is used where none is lost [servo periods].

    The core refuses a `camera.timeout` below it (``cpp/src/settings.cpp``).
    """
    camera, step = scenario.camera, scenario.simulation.step
    late = max(scenario.uncertainty.latency, 0.0)
    oldest = sum(round(each / step) for each in (frame_period(scenario), camera.latency, camera.latency_jitter, late))
    return oldest + (reading_ticks(scenario) - 1 if scenario.controller.traits.output == "pose" else 0)


def timeout_room(scenario: Blocks) -> int | None:
    """Return by how many servo periods `camera.period` or `camera.latency` alone can grow; None: no timeout."""
    timeout = scenario.camera.timeout
    return None if timeout is None else round(timeout / scenario.simulation.step) - oldest_image(scenario)


def image_age(scenario: Blocks) -> float:
    """Return the mean time from an exposure to the ticks at which its image is used [s]: 0 in continuous mode."""
    if scenario.simulation.mode != SAMPLED_MODE:
        return 0.0
    camera = scenario.camera
    late = camera.latency + 0.5 * camera.latency_jitter + 0.5 * (frame_period(scenario) - scenario.simulation.step)
    return late + lost_frames_wait(scenario)


def lost_frames_wait(scenario: Blocks) -> float:
    """Return how much older images are on average by frames that never arrive, ``camera.dropout`` [s].

    In sampled mode. Each tick has j lost frames behind it with the share (1 - p) p^j, of frames that are lost with the
    probability p. Images older than ``camera.timeout`` are not used: a j beyond the number of frames that may be
    lost does not count. Where every frame is lost no image is used, and none is older.
    """
    camera, period = scenario.camera, frame_period(scenario)
    if camera.dropout in (0.0, 1.0):
        return 0.0
    decay = -math.log(camera.dropout)  # of the share, from frame to frame
    lost = 1.0 / math.expm1(decay)  # p/(1 - p)
    if camera.timeout is not None:
        step = scenario.simulation.step
        used = (camera.timeout + step - camera.latency - 0.5 * camera.latency_jitter) / period  # frames in that time
        lost -= used / math.expm1(min(used * decay, _NEVER))
    return lost * period


def actuators_lag(scenario: Blocks) -> float:
    """Return how late forces are, or legs that take positions: delay, and lag of an even motion [s]."""
    actuators = scenario.actuators
    if actuators.kind == "position":
        return actuators.delay + actuators.position.damping / (math.pi * actuators.position.bandwidth)
    if actuators.kind == "position_torque":  # kp (q* - q) = (kv + damping) q-dot
        return actuators.delay + (actuators.motor.kv + actuators.motor.damping) / actuators.motor.kp
    return actuators.delay + (1.0 / (2.0 * math.pi * actuators.bandwidth) if actuators.bandwidth is not None else 0.0)
