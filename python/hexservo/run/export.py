"""Writes the gains of a scenario as a C++ header, for a robot's control program."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.run.controller import controller_arguments
from hexservo.run.files import write_file
from hexservo.scenario.parameters import Settings
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.version import VERSION

__all__ = ["gains_header", "write_header"]

_TITLE = "// hexservo gains, format 1"
"""First line of every exported header, which distinguishes it from other files."""

# Member of hexservo::Settings and its unit; one block each. What is left out here belongs to the plant or to a run.
_ROBOT = {
    "robot.platform_radius": "m",
    "robot.base_radius": "m",
    "robot.platform_angles": "rad",
    "robot.base_angles": "rad",
    "robot.home_position": "m",
    "robot.mass": "kg",
    "robot.inertia": "kg m^2",
    "robot.stroke": "m",
    "robot.force_limit": "N",
}
_CAMERA = {"camera.focal_length": "m", "camera.pixel_scale": "px/m", "convention": "", "jacobian": ""}
_SEEN_FROM_HOME = {"target.initial_features": "px", "target.depth": "m"}
_GOAL = {"target.desired_features": "px", "uncertainty.depth": "1"}  # the controller's own depths
_SWITCHING = {"switching.kind": "", "switching.width": "m/s; rad/s"}
_SENSORS = {
    "simulation.mode": "",
    "simulation.step": "s",
    "sampling.period": "s",
    "sampling.latency": "s",
    "sampling.latency_jitter": "s",
    "sampling.timeout": "s",
    "sampling.faults.prediction": "",
    "sampling.faults.on_lost": "",
    "sensors.pose": "",
    "sensors.period": "s",
    "sensors.encoders.rates": "",
}
# Of the actuators what the controller has to know: a limit at which it waits, and how late they are.
_ACTUATORS = {"actuators.actuators.saturation": "", "actuators.actuators.bandwidth": "Hz", "actuators.delay": "s"}
_SAFE = {"safe.damping": "N s/m; N m s/rad", "safe.hold": "N/m; N m/rad"}
_FUZZY = {
    "gains.fuzzy.enabled": "",
    "gains.fuzzy.adaptation": "m/N; rad/(N m)",
    "gains.fuzzy.error_scale": "1/N; 1/(N m)",
    "gains.fuzzy.rate_scale": "s/N; s/(N m)",
    "gains.fuzzy.initial_scale": "N; N m",
    "gains.fuzzy.table": "1",
    "gains.fuzzy.bell_width": "1",
    "gains.fuzzy.bell_slope": "1",
    "gains.fuzzy.leakage": "1/s",
    "gains.fuzzy.weight_limit": "N; N m",
    "gains.fuzzy.dead_zone": "m/s; rad/s",
}
_HYBRID = {"gains.kp": "N m/px^2", "gains.kv": "N; N m", **_FUZZY}
_COMPOSITE = {
    "gains.kp": "N m/px^2",
    "gains.kv": "N; N m",
    "gains.kt": "N/m; N m/rad",
    "gains.kd": "N s/m; N m s/rad",
    "gains.drive": "1/s",
    "gains.prior": "px^2/m^2; px^2/rad^2",
    **_FUZZY,
    "gains.fuzzy.error_scale": "1/m; 1/rad",
    "gains.fuzzy.rate_scale": "s/m; s/rad",
}
_GAINS = {
    "hybrid": _HYBRID,
    "composite": _COMPOSITE,
    "kelly": {"gains.kp": "N m/px^2", "gains.kd": "N s/m; N m s/rad"},
    "resolved_rate": {
        "gains.gain": "1/s",
        "gains.adaptive": "",
        "gains.gain_far": "1/s",
        "gains.gain_slope": "1/(s px)",
        "gains.jacobian_at": "",
        "gains.ki": "N s/m; N m s/rad",
        "gains.damping": "px^2/m^2; px^2/rad^2",
    },
    "pbvs": {"gains.kp": "N/m; N m/rad", "gains.kd": "N s/m; N m s/rad", "gains.prior": "px^2/m^2; px^2/rad^2"},
    "computed_torque": {"gains.kp": "1/s^2", "gains.kd": "1/s", "gains.prior": "px^2/m^2; px^2/rad^2"},
}


def gains_header(scenario: Scenario, period: float | None = None) -> str:
    """Return a C++ header with all parameters of the controller of a scenario, as constants.

    The header defines ``Law``, ``period``, ``settings()`` and ``controller_gains()`` in the namespace
    ``hexservo_NAME``, where NAME is the scenario's, with "_" for what is neither letter nor digit, and the macro
    ``HEXSERVO_GAINS`` as that namespace where no header before it has. Numbers read back bit for bit. What belongs to
    the plant is no part of it: its errors (``uncertainty``), the faults of camera, encoders and actuators that a
    simulation adds, and the motion of the base (docs/model.md, section 7).

    Parameters
    ----------
    scenario
        What the robot shall do.
    period
        Time between two ticks [s], at most 1 s; the camera's times have to be whole numbers of it.
        None: the scenario's ``simulation.step``.

    Raises
    ------
    ValueError
        For a period that is out of range, or does not fit the camera's times.
    """
    settings, period = controller_arguments(scenario, period)
    period = _core.Controller(settings, period).period  # the core's own check
    settings.simulation.step = period
    gains = _GAINS[scenario.controller.law]
    law = f"hexservo::{type(settings).__name__.removesuffix('Settings')}"
    blocks = [_ROBOT, _CAMERA, _SEEN_FROM_HOME, _GOAL]
    if settings.simulation.mode == _core.LoopMode.sampled:
        blocks += [_SENSORS, _ACTUATORS]
    blocks += [_SAFE, _SWITCHING, gains]
    if settings.target.points is not None:
        blocks.remove(_SEEN_FROM_HOME)
    namespace = _namespace(scenario.name)
    lines = [
        _TITLE,
        f'// The controller of the scenario "{scenario.name}", written by `hexservo export` of hexservo {VERSION}.',
        "// Not to be edited: change the scenario and run `hexservo export --force` again.",
        "// clang-format off",
        "#pragma once",
        "",
        "#include <hexservo/controller.hpp>",
        "",
        "#include <limits>",
        "",
        "#ifndef HEXSERVO_GAINS  // for a program that takes whatever header it is given",
        f"#define HEXSERVO_GAINS {namespace}",
        "#endif",
        "",
        f"namespace {namespace} {{",
        "",
        f"using Law = {law};",
        "",
        "/// T_c, time between two ticks [s].",
        f"inline constexpr double period = {period!r};",
        "",
        "/// Robot, camera, sensors, goal and gains; vectors of six: forces x y z, then moments x y z.",
        "inline hexservo::Settings<Law> settings() {",
        "  hexservo::Settings<Law> s;",
    ]
    for block in blocks:
        for member, unit in block.items():
            lines += _assignment(member, _value(settings, member), unit)
        if block is _CAMERA and settings.target.points is not None:
            columns = np.asarray(settings.target.points).T
            lines.append("  s.target.points_B.emplace();  // one column per point")
            lines += _matrix("(*s.target.points_B)", columns, "m")
    lines += [
        "  return s;",
        "}",
        "",
        "/// What `hexservo::step` needs.",
        "inline hexservo::ControllerGains<Law> controller_gains() {",
        "  return hexservo::controller_gains(settings(), period);",
        "}",
        "",
        f"}}  // namespace {namespace}",
    ]
    return "\n".join(lines) + "\n"


def _value(settings: Settings, member: str) -> Any:
    value: Any = settings
    for name in member.split("."):
        value = getattr(value, name)
    return value


def _assignment(member: str, value: Any, unit: str) -> Iterator[str]:
    if value is None:  # derived by the core
        return
    if isinstance(value, np.ndarray):
        name = f"s.{member}.emplace()" if member in _SAFE else f"s.{member}"
        yield from _matrix(name, np.atleast_2d(value), unit)
        return
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, float):
        text = _number(value)
    else:  # an enumeration of the core, which has the same names on both sides
        text = f"hexservo::{type(value).__name__}::{value.name}"
    yield f"  s.{member} = {text};" + (f"  // [{unit}]" if unit else "")


def _matrix(name: str, rows: Any, unit: str) -> Iterator[str]:
    """Fill a fixed-size matrix or vector row by row."""
    texts = [", ".join(_number(float(number)) for number in row) for row in rows]
    if len(texts) == 1:
        yield f"  {name} << {texts[0]};  // [{unit}]"
        return
    yield f"  {name} <<  // [{unit}]"
    for index, text in enumerate(texts):
        yield f"      {text}{',' if index < len(texts) - 1 else ';'}"


def _number(value: float) -> str:
    return repr(value) if np.isfinite(value) else "std::numeric_limits<double>::infinity()"


def _namespace(name: str) -> str:
    """Turn a scenario's name into a C++ name; what comes first keeps it apart from keywords and digits."""
    return "_".join(["hexservo", *re.findall("[A-Za-z0-9]+", name)])


def write_header(text: str, file: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write a header whole, or not at all.

    Parameters
    ----------
    text
        What `gains_header` gives.
    file
        A name in a folder that exists. A file of that name is kept.
    force
        Replace an earlier exported header, recognised by its first line; other files are never replaced.

    Raises
    ------
    OutputError
        The file exists, is not ours, or cannot be written.
    """
    write_file(text, file, _TITLE, "hexservo export", force=force)
