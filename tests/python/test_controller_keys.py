"""Keys of a controller: a change of each that the tick depends on changes an output, of the others none."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.run.controller import controller_keys, tick_keys
from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.keys import value_at
from hexservo.scenario.parameters import Settings, core_parameters

TICKS = 160
_AGES = {110: 80, 114: 60, 118: 40, 122: 20, 126: 6}  # of late frames, after a gap [ticks]
DECIDING = {"robot.legs", "simulation.mode", "simulation.step", "camera.latency_known", "actuators.kind"}

# Values that have to fit other keys, and a gain that acts where legs rest for longer than the inputs here last.
FITTING = {"camera.axes", "robot.cranks.axes", "robot.cranks.zero", "controller.tracking.integral"}

# What else has to be so for a key to act.
WITH: tuple[dict[str, Any], ...] = (
    {},
    {"robot.payload.mass": 0.02, "robot.payload.position": [0.0, 0.01, 0.0]},
    {"camera.prediction": "none", "camera.on_lost": "hold"},
    {"camera.prediction": "encoder", "sensors.pose": "encoders"},
    {"controller.resolved_rate.gain_far": 2.0},
    {"controller.resolved_rate.adaptive": True, "controller.resolved_rate.gain_far": 2.0},
    {"controller.resolved_rate.jacobian_at": "desired"},
    {"controller.tracking.integral": 1.0, "controller.tracking.follow": "direction"},
    {"controller.tracking.follow": "pose"},
    {"controller.tracking.feedback": 0.3, "controller.tracking.integral": 1.0, "controller.tracking.band": [1e-3] * 6},
    {"controller.hybrid.fuzzy.initial_scale": [0.01] * 6},
    {"controller.composite.fuzzy.initial_scale": [0.01] * 6},
    {"actuators.saturation": True, "robot.force_limit": 1e-3},
    {"sensors.pose": "encoders"},
    {"sensors.pose": "encoders", "camera.prediction": "encoder", "camera.on_lost": "predict"},
    {"controller.switching.kind": "saturation", "controller.switching.width": 0.1},
    {"robot.stroke": 1e-3},
)


def inputs(scenario: hs.Scenario) -> list[tuple[Any, ...]]:
    """Frames late, missing and with lost points, a moving platform, joints that pause, for `_core.Controller.step`."""
    rng = np.random.default_rng(20261127)
    hexapod, period = _core.Hexapod(core_parameters(scenario).robot), scenario.simulation.step
    goal = np.ravel(np.asarray(core_parameters(scenario)["target.desired_features"], float))
    points = len(goal) // 2
    given = []
    for tick in range(TICKS):
        swing = np.sin(0.15 * tick + np.arange(6))
        twist = 0.02 * swing
        moving = 1.0 if tick < 40 else 0.0  # then all rests, but for the joints
        features = goal + 1.0 + moving * (8.0 * np.sin(0.11 * tick + np.arange(2 * points)) + rng.normal(0.0, 0.1))
        if tick > 140:
            features[:2] = np.nan
        age = _AGES.get(tick, 2)
        frame = tick in _AGES or (tick >= 4 and tick % 4 == 0 and not 30 <= tick < 130)
        lengths = hexapod.home_lengths * (1.0 + (0.002 + 0.008 * moving) * swing)
        joints = None if tick < 3 or 30 <= tick < 36 else lengths
        given.append(
            (
                features if frame else None,
                np.full(points, -0.5) - 0.05 * np.cos(np.arange(points)) if frame else None,
                None if tick < 3 else hexapod.home_position + 1e-3 * swing[:3],
                None if tick < 3 else hexapod.home_quaternion,
                twist,
                joints,
                0.01 * swing,
                (tick - age) * period if frame else np.nan,
                tick * period,
            )
        )
    return given


def outputs(settings: Settings, given: list[tuple[Any, ...]]) -> Any:
    """All outputs of all ticks; None where the core refuses the settings."""
    try:
        controller = _core.Controller(settings, settings["simulation.step"])
    except ValueError:
        return None
    rows = []
    for each in given:
        wrench, forces, fuzzy, status, saturated, positions, latency = controller.step(*each)
        rows.append(np.hstack([wrench, forces, fuzzy, status.value, saturated, positions, latency]))
    return np.array(rows)


def others(key: _core.ScenarioKey, value: Any, period: float) -> Iterator[Any]:
    """Other values of a key."""
    if key.type == "choice":
        yield from (choice for choice in key.choices if choice != value)
    elif isinstance(value, bool):
        yield not value
    elif key.name.endswith(("cranks.axes", "cranks.zero")):  # unit vectors
        nearby = value + 1e-3
        yield nearby / np.linalg.norm(nearby, axis=-1, keepdims=True)
        yield nearby / np.linalg.norm(nearby, axis=0)
    elif isinstance(value, np.ndarray):
        if value.shape == (3, 3):
            yield value + 1e-6 * np.eye(3)
        yield -value
        yield from (1.01 * value + 1e-4, 1.0001 * value + 1e-6, value + 1.0, 0.2 * value, 1.3 * value, value + np.pi)
    elif np.isfinite(value):
        yield from (1.01 * value, value + 1e-4, 0.2 * value, value + 0.3, 1e-3 * value)
        yield from (value + n * period for n in (-2, -1, 1, 4, 20))
    else:
        yield from (0.1, 1.0, *(n * period for n in (10, 20, 40)))


def changed(scenario: hs.Scenario, *changes: dict[str, Any]) -> Settings | None:
    """Settings with changes; None for keys that the law has not, and for what the core refuses at once."""
    settings = core_parameters(scenario)
    try:
        for key, value in (item for change in changes for item in change.items()):
            settings[key] = np.asarray(value, float) if isinstance(value, list) else value
    except (ValueError, KeyError):
        return None
    return settings


def acting(scenario: hs.Scenario, keys: list[_core.ScenarioKey]) -> set[str]:
    """Those of the keys of which some change changes some output."""
    given, period, found = inputs(scenario), scenario.simulation.step, set()
    for change in WITH:
        start = changed(scenario, change)
        expected = None if start is None else outputs(start, given)
        if start is None or expected is None:
            continue
        for key in keys:
            value = start[key.name]
            if key.name in found or value is None:
                continue
            for other in others(key, value, period):
                settings = changed(scenario, change, {key.name: other})
                answer = None if settings is None else outputs(settings, given)
                if answer is not None and not np.array_equal(answer, expected, equal_nan=True):
                    found.add(key.name)
                    break
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["paper", "composite-30hz", "real-machine", "pi-h824-positions", "reachy-mini", "reachy-mini-motors"]
)
def test_the_keys_of_a_tick_are_those_that_change_it(name: str) -> None:
    scenario = hs.load_scenario(name)
    settings = core_parameters(scenario)
    sampled = settings["simulation.mode"] == SAMPLED_MODE
    keys = [key for key in _core.scenario_keys(settings.law) if key.concern == "controller"]
    found = acting(scenario, [key for key in keys if key.name not in DECIDING and (sampled or not key.sampled)])
    listed = {key.name for key in tick_keys(settings)} - DECIDING
    without_number = {key for key in listed if value_at(scenario, key) is None or not is_finite(settings[key])}
    print("without effect:", sorted(listed - found - without_number), "not listed:", sorted(found - listed))
    assert found <= listed
    assert listed - found - without_number <= FITTING


def is_finite(value: Any) -> bool:
    return bool(np.all(np.isfinite(value))) if isinstance(value, float | np.ndarray) else value is not None


@pytest.mark.parametrize(
    ("name", "tick", "made"),
    [
        ("paper", set(), {"robot.stroke", "robot.stroke_centre", "robot.force_limit"}),
        ("real-machine", {"robot.force_limit", "actuators.saturation"}, {"robot.stroke", "robot.stroke_centre"}),
        (
            "pi-h824-positions",
            {"robot.stroke", "actuators.delay", "actuators.position.bandwidth", "actuators.position.speed_limit"},
            {"robot.force_limit", "camera.prediction", "camera.convention"},
        ),
        ("reachy-mini", {"robot.stroke", "actuators.position.speed_limit"}, {"robot.force_limit", "actuators.delay"}),
        ("reachy-mini-motors", {"robot.stroke", "actuators.position.damping"}, {"robot.force_limit"}),
    ],
)
def test_keys_of_a_controller_follow_from_the_kind_of_its_drives(name: str, tick: set[str], made: set[str]) -> None:
    """Those of the tick, and those that a header has besides, for a whole description of the machine."""
    settings = core_parameters(hs.load_scenario(name))
    of_header, of_tick = ({key.name for key in keys(settings)} for keys in (controller_keys, tick_keys))
    assert tick <= of_tick < of_header
    assert made <= of_header - of_tick
    forces = {"actuators.saturation", "actuators.bandwidth"}
    positions = {"controller.virtual_platform.damping", "actuators.position.bandwidth"}
    assert not of_header & (forces if "robot.stroke" in tick else positions)


@pytest.mark.parametrize("law", _core.LAW_TRAITS)
def test_laws_whose_gains_use_target_points_need_a_goal(law: str) -> None:
    """By default those whose law does; `resolved_rate` and `tracking` by a choice among their gains."""
    choices = {"resolved_rate": ("jacobian_at", {"current": False, "desired": True, "mean": True}),
               "tracking": ("follow", {"pose": True, "direction": False})}  # fmt: skip
    settings = Settings(law)
    if law not in choices:
        assert settings.needs_goal == _core.LAW_TRAITS[law].points == (law == "pbvs")
        return
    key, needs = choices[law]
    for choice, needed in needs.items():
        settings[f"controller.{law}.{key}"] = choice
        assert settings.needs_goal == needed
