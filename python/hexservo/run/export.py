"""Writes the gains of a scenario as a C++ header, for a robot's control program."""

from __future__ import annotations

import re
from collections.abc import Iterator
from hashlib import sha256
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.run.controller import controller_arguments, controller_keys
from hexservo.scenario.leg_units import unit_of
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.version import VERSION

_FOUR = 4  # points: what controllers and arrays of the core are for by default
_DIGEST = 16  # hexadecimal digits that name what a header has

TITLE = "// hexservo gains, format 1"
"""First line of every exported header, which distinguishes it from other files."""


C_NAMES = frozenset(
    """
    gains gains_create gains_destroy gains_memory gains_period gains_place gains_points gains_size input
    input_clear input_status interface key limit limit_event metric_count metric_name outcome outcome_name
    output plant plant_command plant_create plant_destroy plant_newest plant_outcome plant_sense quantity
    run run_advance run_create run_destroy run_detail run_event run_event_count run_goal run_metrics
    run_newest run_outcome run_rows run_samples run_scene run_target run_time run_width scenario
    scenario_copy scenario_create scenario_destroy scenario_get_numbers scenario_get_text scenario_key
    scenario_key_count scenario_message scenario_points scenario_set_number scenario_set_numbers
    scenario_set_text scenario_validate scene state state_create state_destroy state_memory state_place
    state_size status tick type version
    """.split()  # noqa: SIM905
)
"""Names of hexservo.h without ``hexservo_``: a namespace of such a name would not compile beside that header."""

_OF_A_VERDICT = ("metrics.band", "metrics.dwell")
"""Keys by which a program can state whether the features have settled at their goal, as a run does."""


def gains_header(scenario: Scenario, period: float | None = None) -> str:
    """Return a C++ header with all parameters of the controller of a scenario, as constants.

    The header defines ``Law``, ``scenario_name``, ``period``, ``settings()`` and ``controller_gains()`` in the
    namespace ``hexservo_NAME``, where NAME is the scenario's, with "_" for what is neither letter nor digit, and
    followed by ``_scenario`` where hexservo.h has that name, as ``hexservo_gains``; and the macro ``HEXSERVO_GAINS`` as
    that namespace where no header before it has. An inline namespace named after the contents gives each header symbols
    that no other one has, so that files of a program may include different headers of one namespace; one file that
    includes two of these does not compile. Numbers read back bit for bit. What belongs to the plant is no part
    of it: errors of inertia, Coriolis terms and weight, the faults of camera, encoders and actuators that a simulation
    adds, and the motion of the base. What ``uncertainty`` has the controller itself assume wrongly is part of it:
    focal length, principal point, mount, depth where the law uses a model of the target's points, and in ``sampled``
    mode latency (docs/model.md, section 7). The settings have ``metrics.band`` and ``metrics.dwell`` too, which the
    tick does not use.

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
    settings["simulation.step"] = period
    contents = _contents(scenario, settings, period)
    digest = sha256("\n".join(contents).encode()).hexdigest()[:_DIGEST]
    namespace, included = _namespace(scenario.name), f"HEXSERVO_GAINS_OF_{_namespace(scenario.name)}"
    lines = [
        TITLE,
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
        f"#ifdef {included}",
        f'#error "two headers of hexservo export with the namespace {namespace}: rename one of the scenarios"',
        "#endif",
        f"#define {included}",
        "",
        f"namespace {namespace} {{",
        f"inline namespace contents_{digest} {{  // no other header has these symbols",
        "",
        *contents,
        "",
        f"}}  // namespace contents_{digest}",
        f"}}  // namespace {namespace}",
    ]
    return "\n".join(lines) + "\n"


def _contents(scenario: Scenario, settings: _core.Settings, period: float) -> list[str]:
    """Return the lines that define what the header has, of a scenario, its settings and a period [s]."""
    law = _core.LAW_TRAITS[settings.law]
    places = "" if settings.places == _FOUR else f", {settings.places}"
    lines = [
        f"using Law = hexservo::{law.type};",
        "",
        f'inline constexpr const char* scenario_name = "{scenario.name}";',  # letters, digits, "-", "_" and "."
        "",
        "/// T_c, time between two ticks [s].",
        f"inline constexpr double period = {period!r};",
        "",
        "/// Robot, camera, sensors, goal, gains, settling; vectors of six: forces x y z, then moments x y z.",
        "inline hexservo::Settings settings() {",
        "  hexservo::Settings s = hexservo::Settings::of<Law>();",
        "  hexservo::GainsOf<Law>& gains = s.gains<Law>();",
    ]
    judging = (key for key in _core.scenario_keys(settings.law) if key.name in _OF_A_VERDICT)
    for key in (*controller_keys(settings), *judging):
        if key.name == "target.weights" and np.all(settings[key.name] == 1.0):  # the default
            continue
        member = key.name.replace(f"controller.{law.name}.", "gains.", 1)
        member = member if member.startswith("gains.") else f"s.{member}"
        unit = unit_of(scenario.robot, key.name, key.unit)
        lines += _assignment(member, key, unit, settings[key.name])
    lines += [
        "  return s;",
        "}",
        "",
        *_places_in_words(settings),
        f"inline hexservo::ControllerGains<Law{places}> controller_gains() {{",
        f"  return hexservo::controller_gains<Law{places}>(settings(), period);",
        "}",
    ]
    return lines


def _places_in_words(settings: _core.Settings) -> list[str]:
    if settings.places == _FOUR:
        return ["/// What `hexservo::step` needs."]
    return [
        "/// What `hexservo::step` needs.",
        f"/// Of the {settings.places} places of a frame the first {settings.points} are the points, the others idle.",
    ]


def _assignment(member: str, key: _core.ScenarioKey, unit: str, value: Any) -> Iterator[str]:
    """Set a member from the value of its key."""
    if value is None:  # the core's default, or derived by it
        return
    if isinstance(value, np.ndarray):
        name = f"{member}.emplace()" if key.wrapped else member
        if key.per_point and key.wrapped:
            name = f"{member}.emplace({', '.join(map(str, value.shape))})"
        elif key.name == "target.weights" or (key.per_point and len(value) != _FOUR * key.per_point):
            yield f"  {member}.resize({len(value)});"
        yield from _matrix(name, np.atleast_2d(value), unit)
        return
    if key.type == "choice":
        text = f"{key.choice_type}::{value}"
    elif isinstance(value, bool):
        text = "true" if value else "false"
    else:
        text = _number(value)
    yield f"  {member} = {text};" + (f"  // [{unit}]" if unit else "")


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
    words = re.findall("[A-Za-z0-9]+", name)
    if "_".join(words) in C_NAMES:
        words.append("scenario")
    return "_".join(["hexservo", *words])
