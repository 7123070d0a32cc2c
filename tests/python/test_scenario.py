"""Scenarios: what is accepted, what is refused and in which words, updates, and the way to YAML and back."""

from __future__ import annotations

import copy
import math
import os
import pickle
import shutil
import time
from array import array
from collections import deque
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

import hexservo as hs
from hexservo import _core
from hexservo.scenario import scenario as scenario_module
from hexservo.scenario.yaml import load_yaml
from packaged import ONE_OF_EACH_KIND, kinds

INITIAL = [30, 18, 65, -65, -44, 37, -10, -15]
DESIRED = [10, 10, 45, -73, -64, 29, -30, -23]
# Where the default target is in B: features and depth seen from home, (4) solved for the point.
POINTS = [[x * 0.5 / 581.816, y * 0.5 / 581.816, -0.65] for x, y in zip(INITIAL[::2], INITIAL[1::2], strict=True)]
SHORT: dict[str, Any] = {"name": "short", "target": {"initial_features": INITIAL, "desired_features": DESIRED}}
TERMS = ["NB", "NM", "NS", "ZE", "PS", "PM", "PB"]
LINEAR = [[TERMS[max(0, min(6, row + column - 3))] for column in range(7)] for row in range(7)]
ROBOT_KEYS = [
    "platform_radius",
    "base_radius",
    "platform_angles",
    "base_angles",
    "home_position",
    "mass",
    "inertia",
    "stroke",
    "force_limit",
]


@pytest.fixture(scope="module")
def paper() -> hs.Scenario:
    return hs.load_scenario("paper")


def refusal(changes: dict[str, Any]) -> list[str]:
    """The lines of the refusal of the paper's scenario with these changes."""
    with pytest.raises(hs.ScenarioError) as caught:
        hs.load_scenario("paper").updated(changes)
    lines = str(caught.value).splitlines()
    assert list(caught.value.problems) == lines
    assert not any("pydantic" in line or "http" in line for line in lines)
    return lines


# ---- Defaults and packaged scenarios --------------------------------------------------------------------------------


def test_defaults_come_from_the_core() -> None:
    """The robot's and the two laws' whose blocks hold one of the other; all other keys: test_schema.py."""
    scenario = hs.Scenario.from_mapping(SHORT)
    robot = _core.robot_preset("micro")
    for key in ROBOT_KEYS:
        written = np.array(getattr(scenario.robot, key))
        np.testing.assert_array_equal(np.diag(written) if key == "inertia" else written, getattr(robot, key))
    hybrid, composite = scenario.controller.hybrid.fuzzy, scenario.controller.composite.fuzzy
    assert hybrid.table == composite.table == "linear"
    assert hybrid.bell_width == composite.bell_width == 1 / 6
    for key in ("adaptation", "error_scale", "rate_scale", "initial_scale"):
        own = np.broadcast_to(getattr(composite, key), 6)
        np.testing.assert_array_equal(own, _core.Settings("composite")[f"controller.composite.fuzzy.{key}"])
        assert np.array_equal(own, np.broadcast_to(getattr(hybrid, key), 6)) == (key == "initial_scale")


def test_the_paper_spells_out_the_defaults(paper: hs.Scenario) -> None:
    bare = hs.Scenario.from_mapping(SHORT)
    expected = {
        "name": "paper",
        "description": paper.description,
        "uncertainty": {"inertia": 0.075, "coriolis": 0.125, "gravity": 0.0, "depth": 0.3},
    }
    assert paper == bare.updated(expected)
    assert paper.description


def test_the_paper_names_every_key(paper: hs.Scenario) -> None:
    text = (resources.files("hexservo") / "scenarios" / "paper.yaml").read_text("utf-8")
    written = load_yaml(text)

    def keys(block: Any, head: str = "") -> set[str]:
        inner = {
            name for key, value in block.items() if isinstance(value, dict) for name in keys(value, f"{head}{key}.")
        }
        return inner | {head + key for key in block}

    assert isinstance(written, dict)
    resolved = keys(paper.to_mapping())
    assert resolved - keys(written) == {f"robot.{key}" for key in ROBOT_KEYS}
    for key in ROBOT_KEYS:  # the preset's values, named in a comment
        assert f"{key} (" in text or f"{key} [" in text


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("paper-nominal", {"uncertainty": {"inertia": 0, "coriolis": 0, "gravity": 0, "depth": 0}}),
        ("paper-minus", {"uncertainty": {"inertia": -0.075, "coriolis": -0.125, "gravity": 0, "depth": -0.3}}),
        ("paper-gravity", {"uncertainty.gravity": 0.075}),
        ("paper-no-fuzzy", {"controller.hybrid.fuzzy.enabled": False, "simulation.duration": 10}),
        ("paper-composite", {"controller.law": "composite"}),
    ],
)
def test_variants_differ_from_the_paper_as_named(name: str, changes: dict[str, Any], paper: hs.Scenario) -> None:
    variant = hs.load_scenario(name)
    assert variant == paper.updated({**changes, "name": name, "description": variant.description})
    assert variant != paper
    assert variant.description not in ("", paper.description)


def test_a_scenario_is_sampled_in_that_mode_alone(paper: hs.Scenario) -> None:
    assert not paper.updated({"simulation.mode": "continuous"}).sampled
    assert paper.updated({"simulation.mode": "sampled"}).sampled


def test_names_are_those_of_the_files() -> None:
    names = hs.scenario_names()
    assert names == tuple(sorted(names))
    assert set(names) >= {"paper", "paper-nominal", "paper-minus", "paper-gravity", "paper-no-fuzzy", "paper-composite"}
    for name in names:
        assert hs.load_scenario(name).name == name


def test_one_scenario_of_each_kind_is_in_every_run_of_the_tests() -> None:
    reached = set().union(*(kinds(hs.load_scenario(name)) for name in ONE_OF_EACH_KIND))
    missing = {name: kinds(hs.load_scenario(name)) - reached for name in hs.scenario_names()}
    assert {name: left for name, left in missing.items() if left} == {}


# ---- Refusals -------------------------------------------------------------------------------------------------------

INF, NAN = math.inf, math.nan
REFUSED: list[tuple[str, Any, str]] = [
    ("name", "", 'got ""'),
    (
        "name",
        "a/b",
        'expected a name of 1 to 60 letters, digits, "-", "_" and "." that starts with a letter or digit, got',
    ),
    ("name", "..", 'got ".."'),
    ("name", ".hidden", "starts with a letter"),
    ("name", "-rf", "starts with a letter"),
    ("name", "dot.", "expected a name"),
    ("name", "a b", "expected a name"),
    ("name", "a\0", 'got "a\\x00"'),
    ("name", "\ud800", 'got "\\ud800"'),
    ("name", "x" * 61, "1 to 60"),
    ("name", 5, "got 5"),
    ("name", None, "got null"),
    ("description", "two\nlines", 'expected one line of at most 200 printable characters, got "two\\nlines"'),
    ("description", "x" * 201, "at most 200"),
    ("description", "\ud800", 'expected text of whole Unicode characters, got "\\ud800"'),
    ("description", ["x"], 'got ["x"]'),
    ("seed", -1, "expected an integer from 0 to 18446744073709551615, got -1"),
    ("seed", 2**64, "got 18446744073709551616"),
    ("seed", 1.0, "got 1.0"),
    ("seed", True, "got true"),
    ("seed", "1", 'got "1"'),
    ("robot", "micro", "expected a block with the keys preset, platform_radius, "),
    (
        "robot.preset",
        "kubic",
        'expected one of "micro", "cubic", "moog_6dof2000e", "pi_h824", "reachy_mini", "rubin_camera_hexapod", null, '
        'got "kubic"; did you mean "cubic"?',
    ),
    (
        "robot.preset",
        3,
        'expected one of "micro", "cubic", "moog_6dof2000e", "pi_h824", "reachy_mini", "rubin_camera_hexapod", null, '
        "got 3",
    ),
    ("robot.mass", 0, "expected a number > 0 and < 1e+09, got 0"),
    ("robot.mass", -0.06, "expected a number > 0 and < 1e+09, got -0.06"),
    ("robot.mass", NAN, "expected a finite number, got nan"),
    ("robot.mass", INF, "expected a finite number, got inf"),
    ("robot.mass", 10**400, "expected a finite number, got an integer of 1329 bits"),
    ("robot.mass", "heavy", 'expected a number > 0 and < 1e+09, got "heavy"'),
    ("robot.platform_radius", -1, "expected a number > 0"),
    ("robot.base_radius", 0.0, "expected a number > 0"),
    ("robot.stroke", 0, "expected a number > 0"),
    ("robot.force_limit", True, "expected a number > 0, got true"),
    ("robot.platform_angles", 0.5, "expected 6 numbers within +-2 pi (radians), got 0.5"),
    ("robot.platform_angles", [0.0] * 5, "expected 6 numbers within +-2 pi (radians), got a list of 5"),
    ("robot.base_angles[0]", [-10, 1, 2, 3, 4, 5], "(radians), got -10 (degrees? multiply by pi/180)"),
    ("robot.base_angles[5]", [0, 1, 2, 3, 4, 250.0], "(radians), got 250.0 (degrees? multiply by pi/180)"),
    (
        "robot.joint_limit[1]",
        [0.5, 30],
        "expected a number > 0 and <= pi (radians), got 30 (degrees? multiply by pi/180)",
    ),
    ("robot.joint_limit[0]", [0, 0.5], "expected a number > 0 and <= pi (radians), got 0"),
    ("robot.home_position", [0, 0], "expected 3 numbers > -1e+06 and < 1e+06, got a list of 2"),
    ("robot.home_position[2]", [0, 0, NAN], "expected a finite number, got nan"),
    ("robot.inertia", 1e-4, "expected 3 numbers (the diagonal) or 3x3 finite numbers (symmetric), got 0.0001"),
    ("robot.inertia", [1e-4] * 4, "got a list of 4"),
    ("robot.inertia[1]", [[1, 0, 0], [0, 1], [0, 0, 1]], "expected a row of 3, got a list of 2"),
    ("robot.inertia[1]", [[1, 0, 0], 5, [0, 0, 1]], "expected a row of 3, got 5"),
    ("robot.inertia[0][1]", [[1, 0.1, 0], [0.2, 1, 0], [0, 0, 1]], "symmetric matrix, got 0.1 here and 0.2 at [1][0]"),
    ("robot.inertia[2]", [1e-4, 1e-4, INF], "expected a finite number, got inf"),
    ("camera", None, "expected a block with the keys focal_length, pixel_scale, focal_pixels, "),
    ("camera", [1], "got [1]"),
    ("camera.focal_length", 0, "expected a number > 0"),
    ("camera.pixel_scale", [72727], "expected a number > 0 or null, got [72727]"),
    (
        "camera.convention",
        "Eye_in_hand",
        'one of "eye_in_hand", "as_printed", got "Eye_in_hand"; did you mean "eye_in_hand"?',
    ),
    ("target.initial_features", [1] * 7, "expected 2 finite numbers for each of 3 to 16 points, got a list of 7"),
    (
        "target.initial_features",
        [[30, 18], [65, -65], [-44, 37], [-10, -15]],
        "expected a flat list x1, y1, x2, y2, ... of 3 to 16 points, got 4 lists of 2; write their numbers in one list",
    ),
    ("target.desired_features", np.ones((4, 2)), "expected a flat list x1, y1, x2, y2, ... of 3 to 16 points"),
    (
        "target.depth",
        [[0.5], [0.5], [0.5]],
        "expected a number > 0, or a flat list of a number for each of 3 to 16 points, got 3 lists of 1; write",
    ),
    (
        "controller.hybrid.kp",
        np.ones((8, 8)),
        "expected a number > 0, or a flat list x1, y1, x2, y2, ... of 3 to 16 points, got 8 lists of 8; write",
    ),
    ("target.initial_features", [[1, 2], [3]], "3 to 16 points, got 2 lists of several lengths; write their numbers"),
    ("target.initial_features", [[1] * 8], "3 to 16 points, got 1 list of 8; write their numbers in one list"),
    ("target.initial_features", [[]], "expected 2 finite numbers for each of 3 to 16 points, got a list of 1"),
    ("target.initial_features", {"x": 1}, "expected 2 finite numbers for each of 3 to 16 points, got a block with"),
    ("target.desired_features[3]", [1, 2, 3, None, 5, 6, 7, 8], "expected a finite number, got null"),
    ("target.depth", 0, "expected a number > 0, got 0"),
    ("target.depth", [0.5] * 3, "expected 4 numbers for the 4 points of initial_features, got a list of 3"),
    ("target.depth[2]", [0.5, 0.5, -0.5, 0.5], "expected a number > 0, got -0.5"),
    ("target.depth", "0.5", 'expected a number > 0, or one for each of 3 to 16 points, got "0.5"'),
    ("uncertainty.inertia", 1, "expected a number > -1 and < 1, got 1"),
    ("uncertainty.inertia[5][0]", [[0] * 6] * 5 + [[NAN] + [0] * 5], "expected a finite number, got nan"),
    ("uncertainty.inertia", [0] * 6, "expected a number > -1 and < 1 or 6x6 of them, got [0, 0, 0, 0, 0, 0]"),
    ("uncertainty.inertia[5]", [[0] * 6] * 5 + [0], "expected a row of 6, got 0"),
    ("uncertainty.coriolis", [], "6x6 of them, got []"),
    ("uncertainty.coriolis", -1, "expected a number > -1 and < 1, got -1"),
    ("uncertainty.coriolis", [[0] * 6] * 5, "expected a number > -1 and < 1 or 6x6 of them, got a list of 5"),
    ("uncertainty.gravity", [0] * 5, "expected a number > -1 and < 1 or 6 of them, got a list of 5"),
    ("uncertainty.gravity", NAN, "expected a finite number, got nan"),
    ("uncertainty.depth", [0.1] * 8, "expected a number or 4 for the 4 points of target.initial_features, got"),
    ("uncertainty.depth", None, "got null"),
    (
        "controller.law",
        "pid",
        'expected one of "hybrid", "composite", "kelly", "resolved_rate", "pbvs", "computed_torque", '
        '"tracking", got "pid"',
    ),
    ("controller.resolved_rate.jacobian_at", "goal", 'expected one of "current", "desired", "mean", got "goal"'),
    ("controller.resolved_rate.adaptive", 1, "expected true or false, got 1"),
    ("controller.resolved_rate.gain", [1, 1], "expected a number >= 0, got [1, 1]"),
    ("controller.kelly.kp", -1e-6, "expected a number >= 0, got"),
    ("controller.pbvs.kd", [1] * 8, "expected a number >= 0 or 6 of them, got a list of 8"),
    ("controller.computed_torque.prior", "none", "expected a number >= 0 or 6 of them, got"),
    ("controller.jacobian", "print", 'one of "consistent", "printed", got "print"; did you mean "printed"?'),
    (
        "controller.switching.kind",
        "sgn",
        'expected one of "sign", "tanh", "saturation", "implicit", "implicit_coupled", got "sgn"; did you mean "sign"?',
    ),
    ("controller.switching.width", 0, "expected a number > 0, got 0"),
    ("controller.hybrid.kp", 0, "expected a number > 0, got 0"),
    ("controller.hybrid.kp", [1e-6] * 6, "expected a number or 8 for the 4 points of target.initial_features, got"),
    ("controller.hybrid.kp", "1e-6", "expected a number > 0, or 2 numbers > 0 for each of 3 to 16 points"),
    ("controller.hybrid.kv[0]", [-1, 0, 0, 0, 0, 0], "expected a number >= 0, got -1"),
    ("controller.hybrid.kv", [1e-3] * 8, "expected a number >= 0 or 6 of them, got a list of 8"),
    ("controller.hybrid.fuzzy.enabled", 1, "expected true or false, got 1"),
    ("controller.hybrid.fuzzy.enabled", "true", 'expected true or false, got "true"'),
    ("controller.hybrid.fuzzy.adaptation", 0, "expected a number > 0"),
    ("controller.hybrid.fuzzy.error_scale", -1, "expected a number >= 0"),
    ("controller.hybrid.fuzzy.rate_scale[1]", [0, "1", 0, 0, 0, 0], "a number stands without quotes"),
    ("controller.hybrid.fuzzy.initial_scale", INF, "expected a finite number, got inf"),
    (
        "controller.hybrid.fuzzy.table",
        "Linear",
        'expected "linear" or 7x7 numbers or terms (NB NM NS ZE PS PM PB), got',
    ),
    ("controller.hybrid.fuzzy.table", [[0] * 7] * 6, "got a list of 6"),
    ("controller.hybrid.fuzzy.table[6]", [[0] * 7] * 6 + [[0] * 6], "expected a row of 7, got a list of 6"),
    (
        "controller.hybrid.fuzzy.table[0][1]",
        [["NB", "XX"] + ["NB"] * 5] + [[0] * 7] * 6,
        'NB NM NS ZE PS PM PB, got "XX"',
    ),
    ("controller.hybrid.fuzzy.table[6][6]", [[0] * 7] * 6 + [[0] * 6 + [True]], "expected a finite number, got true"),
    ("controller.hybrid.fuzzy.bell_width", 0, "expected a number > 0"),
    ("controller.hybrid.fuzzy.bell_slope", 16.5, "expected a number > 0 and <= 16, got 16.5"),
    ("controller.hybrid.fuzzy.bell_slope", None, "got null"),
    ("simulation.mode", "discrete", 'expected one of "continuous", "sampled", got "discrete"'),
    ("simulation.step", -1, "expected a number > 0, got -1"),
    ("simulation.step", "1e-3", 'expected a number > 0, got "1e-3" (text: a number stands without quotes)'),
    ("simulation.duration", 0, "expected a number > 0"),
    ("simulation.duration", NAN, "expected a finite number"),
    ("simulation.log_every", 0, "expected an integer from 1 to 1000000000, got 0"),
    ("simulation.log_every", 1.0, "got 1.0"),
]


@pytest.mark.parametrize(
    ("path", "value", "words"), REFUSED, ids=[f"{path}-{i}" for i, (path, _, _) in enumerate(REFUSED)]
)
def test_refused(path: str, value: Any, words: str) -> None:
    key = path.partition("[")[0]
    (line,) = refusal({key: value})
    assert line.startswith(f"{path}: ")
    assert words in line


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("uncertainty.depht", 'unknown key; did you mean "depth"? known keys: inertia, coriolis, gravity, depth'),
        ("controler", 'unknown key; did you mean "controller"? known keys: name, description, seed, robot, '),
        ("depth", 'unknown key; did you mean "target.depth" or "uncertainty.depth"? known keys: '),
        (
            "bell_slop",
            'did you mean "controller.hybrid.fuzzy.bell_slope" or "controller.composite.fuzzy.bell_slope"?',
        ),
        ("camera.Focal_Length", 'did you mean "focal_length"?'),
        ("controller.hybrid.zzz", "unknown key; known keys: auto, kp, kv, fuzzy"),
        (
            "controller.pid",
            "unknown key; known keys: law, jacobian, switching, safe, virtual_platform, hybrid, composite, kelly, "
            "resolved_rate, pbvs, computed_torque",
        ),
        ("controller.composite.kz", "unknown key; known keys: auto, kp, kv, kt, kd, drive, prior, fuzzy"),
        ("uncertainty.depth.first", "unknown key; uncertainty.depth is a value and holds no keys"),
        ("target.points.x", "unknown key; target.points is a value and holds no keys"),
        ("", "unknown key; known keys: name"),
    ],
)
def test_unknown_keys(path: str, words: str) -> None:
    (line,) = refusal({path: 1})
    assert line.startswith(f"{path}: " if path else '"": ')
    assert words in line


def test_an_unknown_block_is_named() -> None:
    assert refusal({"uncertanty.depth": 0.1})[0].startswith('uncertanty: unknown key; did you mean "uncertainty"?')


def test_what_was_got_is_shortened() -> None:
    for value in ("x" * 1000, [1.2345678] * 1000, {f"key{i}": i for i in range(1000)}, [["x" * 1000] * 1000]):
        (line,) = refusal({"robot.mass": value})
        assert len(line.partition("got ")[2]) <= 60


def test_of_very_many_problems_the_first_are_said_and_their_number() -> None:
    """Reporting them takes less time than parsing them: a wrong file is not slower than a right one."""
    text = hs.load_scenario("paper").to_yaml() + "".join(f"key{number}: 1\n" for number in range(20_000))
    started = time.process_time()
    mapping = load_yaml(text)
    parsed = time.process_time()
    assert isinstance(mapping, dict)
    with pytest.raises(hs.ScenarioError) as caught:
        hs.Scenario.from_mapping(mapping)
    assert time.process_time() - parsed < parsed - started
    *lines, last = caught.value.problems
    assert len(lines) == 20
    assert all(line.startswith(f"key{number}: unknown key") for number, line in enumerate(lines))
    assert last == "and 19980 more problems"


def test_all_problems_are_reported_at_once() -> None:
    lines = refusal(
        {
            "seed": -1,
            "robot.mass": 0,
            "target.desired_features": [NAN, 1, 2, 3, "a", 5, 6, 7],
            "uncertainty.depht": 1,
            "controller.hybrid.fuzzy.bell_slope": 0,
            "simulation.step": 0.3,
        }
    )
    assert [line.partition(": ")[0] for line in lines] == [
        "seed",
        "robot.mass",
        "target.desired_features[0]",
        "target.desired_features[4]",
        "uncertainty.depht",
        "controller.hybrid.fuzzy.bell_slope",
        "simulation.step",
    ]


def test_missing_keys_are_named() -> None:
    with pytest.raises(hs.ScenarioError) as caught:
        hs.Scenario.from_mapping({"target": {}, "robot": {"mass": 0.1, "preste": "micro"}})
    lines = str(caught.value).splitlines()
    assert lines[0].startswith('robot.preste: unknown key; did you mean "preset"?')
    assert lines[1].startswith("target: expected either initial_features (2 numbers per point, px) with depth (m)")
    assert lines[2].startswith("target: expected either desired_features (2 numbers per point, px) or desired_pose")
    assert lines[3].startswith("missing key: name (a name of")
    assert lines[4].startswith("robot: missing keys: platform_radius (a number > 0 and < 1e+06 or null), base_radius")
    assert "mass" not in lines[4].partition("home_position")[2].partition("inertia")[0]
    assert lines[4].endswith("a preset would fill them in")
    assert len(lines) == 5


def test_points_in_one_list_are_refused_at_their_own_place() -> None:
    (line,) = refusal({"target.points": [1, 2, 3] * 4, "target.initial_features": None, "target.depth": None})
    assert line.startswith("target.points: expected 3 to 16 points of 3 finite numbers, got [1, 2, 3, ")


TAG = {"size": 0.08, "pose": [0, 0, -0.65, 0, 0, 0]}


@pytest.mark.parametrize(
    ("target", "places"),
    [
        ({"tag": TAG}, ["target: expected either desired_features"]),
        ({"depth": 0.5}, ["target: expected either initial_features", "target: expected either desired_features"]),
        ({"tag": TAG, "weights": -1}, ["target.weights: expected", "target: expected either desired_features"]),
        ({"tag": TAG, "tga": 1}, ["target.tga: unknown key", "target: expected either desired_features"]),
    ],
)
def test_what_a_target_lacks_is_named_with_everything_else(target: dict[str, Any], places: list[str]) -> None:
    with pytest.raises(hs.ScenarioError) as caught:
        hs.Scenario.from_mapping({"name": "a", "target": target})
    assert len(caught.value.problems) == len(places)
    for line, place in zip(caught.value.problems, places, strict=True):
        assert line.startswith(place)
    assert "or desired_pose (6 numbers, displacement from home, m and rad), got neither" in caught.value.problems[-1]


@pytest.mark.parametrize("document", [None, [], "text", 3, [SHORT]])
def test_a_scenario_is_a_mapping(document: Any) -> None:
    with pytest.raises(hs.ScenarioError, match="expected a scenario: a mapping with the keys name, description"):
        hs.Scenario.from_mapping(document)


def test_keys_are_text() -> None:
    with pytest.raises(hs.ScenarioError, match="target: expected keys that are text, got 3"):
        hs.Scenario.from_mapping({"name": "x", "target": {3: 4}})


def test_keys_with_half_characters_are_refused() -> None:
    with pytest.raises(hs.ScenarioError, match="target: expected keys that are text, got"):
        hs.Scenario.from_mapping({"name": "x", "target": {"\ud800": 4}})
    with pytest.raises(hs.ScenarioError, match=r"expected keys that are text|invalid Unicode character escape"):
        hs.Scenario.from_yaml('"\\ud800": 1')


def test_endless_data_is_refused() -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(hs.ScenarioError, match="levels of nesting"):
        hs.Scenario.from_mapping({"name": "x", "target": endless})


@pytest.mark.parametrize("value", [object(), {1, 2}, b"1", 1j, lambda: 1])
def test_foreign_objects_are_refused(value: Any) -> None:
    (line,) = refusal({"controller.hybrid.kp": value})
    expected = "a number > 0, or 2 numbers > 0 for each of 3 to 16 points"
    assert line == f"controller.hybrid.kp: expected {expected}, got a Python {type(value).__name__}"


def test_changes_are_a_mapping() -> None:
    scenario = hs.load_scenario("paper")
    for wrong in (3, [("uncertainty.depth", 0.1)], "uncertainty.depth"):
        with pytest.raises(TypeError, match=r"^changes: expected a mapping of dotted keys to values, got "):
            scenario.updated(wrong)  # type: ignore[arg-type]
        with pytest.raises(TypeError, match=r"^changes: expected a mapping"):
            hs.load_scenario("paper", wrong)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^name_or_path: expected the name of a packaged scenario or a path, got int"):
        hs.load_scenario(3)  # type: ignore[arg-type]
    for other in (3, b"name: x"):
        with pytest.raises(TypeError, match=r"^text: expected YAML as text .*, got (int|bytes)$"):
            hs.Scenario.from_yaml(other)  # type: ignore[arg-type]


def test_the_maths_has_its_say() -> None:
    lines = refusal({"robot.inertia": [1e-4, 1e-4, 3e-4]})  # a body's largest moment is at most the sum of the others
    assert len(lines) == 1
    assert lines[0].startswith("robot.inertia: ")


# ---- The rules between keys -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "duration"),
    [(3e-3, 5.0), (1.0, 0.4), (0.1, 0.25), (0.2857, 0.4), (7e-4, 1.0), (0.3, 1), (1e-3, 1.0005), (0.7, 1e-3)],
)
def test_a_step_that_does_not_divide_the_duration_comes_with_ones_that_do(step: float, duration: float) -> None:
    paper = hs.load_scenario("paper")
    (line,) = refusal({"simulation": {"step": step, "duration": duration}})
    assert line.startswith("simulation.step: expected a step that divides the duration")
    nearest_step, nearest_durations = line.partition("nearest: step ")[2].split(", or duration ")
    changed = paper.updated({"simulation": {"step": float(nearest_step), "duration": duration}})
    others = [duration / count for count in range(1, math.ceil(duration / step) + 2)]
    assert abs(changed.simulation.step - step) <= min(abs(other - step) for other in others) + 1e-11 * step
    for nearest in nearest_durations.split(" or "):
        changed = paper.updated({"simulation": {"step": step, "duration": float(nearest)}})
        assert abs(changed.simulation.duration - duration) <= step


@pytest.mark.parametrize(
    ("step", "duration"), [(0.1, 0.3), (1e-3, 4.999), (0.001 / 3, 1), (2, 2), (0.1, 0.1 * (3 + 1e-9))]
)
def test_a_step_divides_to_rounding(step: float, duration: float, paper: hs.Scenario) -> None:
    assert paper.updated({"simulation": {"step": step, "duration": duration}}).simulation.duration == duration


def test_a_step_beyond_all_durations_is_refused_in_words() -> None:
    (line,) = refusal({"simulation": {"step": 1e300, "duration": 1e-300}})  # the ratio is zero in double precision
    assert line.endswith("nearest: step 1e-300, or duration 1e+300")


def test_a_run_of_too_many_steps_is_refused() -> None:
    (line,) = refusal({"simulation.step": 1e-300})
    assert line == "simulation.duration: expected at most 1000000000 steps, got 5e+300 steps"


def test_a_target_has_one_form(paper: hs.Scenario) -> None:
    (both,) = refusal({"target.points": POINTS})
    assert both.startswith("target: expected either initial_features (2 numbers per point, px) with depth (m), points")
    assert "got initial_features and points; leave one out or set it to null" in both
    (neither,) = refusal({"target.initial_features": None})
    assert neither.endswith("got none of them")
    switch = {"target.points": POINTS, "target.initial_features": None}
    by_points = paper.updated(switch)
    assert by_points == paper.updated({**switch, "target.depth": None})
    assert by_points.target.points == tuple(map(tuple, POINTS))
    assert by_points.target.depth is None
    (line,) = refusal({**switch, "target.depth": 0.4})
    assert line == "target.depth: expected no depth beside points, got 0.4"
    back = by_points.updated({"target": {"points": None, "initial_features": INITIAL}})
    assert back == paper


def test_points_need_a_real_projection() -> None:
    (line,) = refusal({"target": {"points": POINTS, "initial_features": None}, "camera.convention": "as_printed"})
    assert line.startswith("target.points: expected initial_features and depth, since ")


def test_a_robot_without_a_preset_has_every_key(paper: hs.Scenario) -> None:
    (line,) = refusal({"robot.preset": None})
    assert all(f" {key} (" in line for key in ROBOT_KEYS)
    keys = {key: getattr(paper.robot, key) for key in ROBOT_KEYS}
    own = hs.Scenario.from_mapping({**SHORT, "robot": keys})
    assert own.robot.preset is None
    assert hs.Scenario.from_yaml(own.to_yaml()) == own
    assert own.updated({"robot.mass": 0.07}).robot.mass == 0.07


# ---- Forms ----------------------------------------------------------------------------------------------------------


def test_one_meaning_has_one_form(paper: hs.Scenario) -> None:
    long = {
        "target.depth": [0.5] * 4,
        "uncertainty.inertia": [[0.075] * 6] * 6,
        "uncertainty.gravity": np.zeros(6),
        "uncertainty.depth": (0.3, 0.3, 0.3, 0.3),
        "controller.hybrid.kp": np.full(8, 1e-6),
        "controller.hybrid.fuzzy.adaptation": [10] * 6,
        "controller.hybrid.fuzzy.table": LINEAR,
        "controller.hybrid.fuzzy.bell_width": 1 / 6,
        "robot.inertia": np.diag([1.5e-4, 1.5e-4, 3e-4]),
        "simulation.log_every": np.int64(1),
        "simulation.duration": np.float32(5),
        "seed": np.uint8(0),
    }
    assert paper.updated(long) == paper
    assert hash(paper.updated(long)) == hash(paper)
    assert paper.updated(long).to_yaml() == paper.to_yaml()


def test_integers_are_numbers(paper: hs.Scenario) -> None:
    duration = paper.updated({"simulation.duration": 4}).simulation.duration
    assert type(duration) is float
    assert duration == 4.0


def test_arrays_are_tuples(paper: hs.Scenario) -> None:
    delta = np.zeros((6, 6))
    delta[2, 3] = delta[3, 2] = 0.1
    changed = paper.updated({"uncertainty.inertia": delta, "uncertainty.depth": [0.3, -0.3, 0.3, 0.3]})
    assert changed.uncertainty.inertia == tuple(map(tuple, delta.tolist()))
    assert changed.uncertainty.depth == (0.3, -0.3, 0.3, 0.3)
    delta[2, 3] = 0.2
    assert changed.uncertainty.inertia[2][3] == 0.1


def test_a_table_takes_terms_and_numbers(paper: hs.Scenario) -> None:
    table: list[list[Any]] = [["PB", "PM", "PS", "ZE", "NS", "NM", "NB"]] * 6 + [[0.25] * 7]
    rows = paper.updated({"controller.hybrid.fuzzy.table": table}).controller.hybrid.fuzzy.table
    np.testing.assert_allclose(np.array(rows)[0], np.array([3, 2, 1, 0, -1, -2, -3]) / 3, rtol=1e-15)
    np.testing.assert_array_equal(np.array(rows)[6], np.full(7, 0.25))


def test_a_nearly_symmetric_inertia_becomes_symmetric(paper: hs.Scenario) -> None:
    angle = 0.3
    turn = np.array([[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]])
    inertia = turn @ np.diag([1.5e-4, 1.6e-4, 2e-4]) @ turn.T
    inertia[1, 2] *= 1 + 1e-12
    read = np.array(paper.updated({"robot.inertia": inertia}).robot.inertia)
    np.testing.assert_array_equal(read, read.T)
    np.testing.assert_allclose(read, inertia, rtol=1e-12)


# ---- Updates --------------------------------------------------------------------------------------------------------


def test_a_packaged_file_is_parsed_once_and_is_not_changed(monkeypatch: pytest.MonkeyPatch, paper: hs.Scenario) -> None:
    written = copy.deepcopy(scenario_module.read_document("paper").keys)
    monkeypatch.setattr(scenario_module, "load_yaml", lambda *_: pytest.fail("parsed again"))
    changed = hs.load_scenario("paper", {"uncertainty.gravity": 0.2, "controller.composite.kd": 3.0})
    assert changed != paper
    assert hs.load_scenario("paper") == paper
    assert scenario_module.read_document("paper").keys == written


def test_validation_does_not_list_the_keys_of_the_core_again(
    monkeypatch: pytest.MonkeyPatch, paper: hs.Scenario
) -> None:
    """They are the same in every scenario, and listing them for each took a quarter of the time of `updated`."""
    paper.updated({"uncertainty.gravity": 0.1})
    monkeypatch.setattr(_core, "scenario_keys", lambda _: pytest.fail("listed again"))
    assert paper.updated({"uncertainty.gravity": 0.2}).uncertainty.gravity == 0.2


def test_an_update_leaves_the_original_alone(paper: hs.Scenario) -> None:
    before = paper.to_yaml()
    changed = paper.updated({"uncertainty.depth": -0.3})
    assert changed.uncertainty.depth == -0.3
    assert paper.to_yaml() == before
    assert changed.updated({"uncertainty.depth": 0.3}) == paper
    assert paper.updated({}) == paper


def test_a_mapping_changes_the_keys_it_names(paper: hs.Scenario) -> None:
    nested = paper.updated({"uncertainty": {"depth": 0.1}, "controller": {"hybrid": {"fuzzy": {"bell_slope": 3}}}})
    assert nested == paper.updated({"uncertainty.depth": 0.1, "controller.hybrid.fuzzy.bell_slope": 3})
    assert nested.uncertainty.inertia == 0.075
    (line,) = refusal({"uncertainty": {"a.b": 1}})
    assert line.startswith("uncertainty.a.b: unknown key")


def test_a_block_of_another_scenario_will_do(paper: hs.Scenario) -> None:
    minus = hs.load_scenario("paper-minus")
    assert paper.updated({"uncertainty": minus.uncertainty}).uncertainty == minus.uncertainty


@pytest.mark.parametrize("reloaded", [False, True])
def test_a_preset_brings_its_values(paper: hs.Scenario, reloaded: bool) -> None:
    heavy = paper.updated({"robot.mass": 0.08})
    if reloaded:
        heavy = hs.Scenario.from_yaml(heavy.to_yaml())
    cubic = heavy.updated({"robot.preset": "cubic"})
    preset = _core.robot_preset("cubic")
    assert cubic.robot.base_radius == preset.base_radius != heavy.robot.base_radius
    np.testing.assert_array_equal(cubic.robot.base_angles, preset.base_angles)
    assert cubic.robot.mass == 0.08  # what differs from the preset stays
    assert cubic.updated({"robot.mass": None}).robot.mass == preset.mass
    assert cubic.updated({"robot.preset": "micro", "robot.mass": None}) == paper


def test_scenarios_are_immutable(paper: hs.Scenario) -> None:
    for block, key in [(paper, "seed"), (paper.robot, "mass"), (paper.controller.hybrid.fuzzy, "enabled")]:
        with pytest.raises(ValidationError):
            setattr(block, key, 1)


def test_copies_are_equal(paper: hs.Scenario) -> None:
    assert copy.deepcopy(paper) == paper
    assert pickle.loads(pickle.dumps(paper)) == paper


# ---- Files ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    shutil.copy(str(resources.files("hexservo") / "scenarios" / "paper.yaml"), path)
    return path


def test_a_file_is_loaded_by_its_path(file: Path, paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    assert hs.load_scenario(file) == paper
    assert hs.load_scenario(str(file)) == paper
    monkeypatch.chdir(file.parent)
    assert hs.load_scenario("mine.yaml") == paper


def test_a_packaged_name_wins_over_a_file(file: Path, paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(file.parent)
    Path("paper").write_text(paper.updated({"camera.focal_length": 0.007}).to_yaml(), encoding="utf-8")
    assert hs.load_scenario("paper") == paper
    assert hs.load_scenario("./paper").camera.focal_length == 0.007
    assert hs.load_scenario(Path("paper")).camera.focal_length == 0.007


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("papr", "paper"), ("paper-gravty", "paper-gravity"), ("Paper", "paper"), ("x/paper-minus.yaml", "paper-minus")],
)
def test_a_missing_name_comes_with_the_nearest(
    name: str, nearest: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(hs.ScenarioError) as caught:
        hs.load_scenario(name)
    message = str(caught.value)
    what = "no such file" if "/" in name else "no packaged scenario has that name, and there is no such file"
    assert message == f'"{name}": {what}; did you mean "{nearest}"?'


@pytest.mark.parametrize("name", ["", "zzz", "a\0b", "\ud800"])
def test_a_name_like_no_other_gets_no_guess(name: str) -> None:
    with pytest.raises(hs.ScenarioError) as caught:
        hs.load_scenario(name)
    assert "did you mean" not in str(caught.value)
    assert str(caught.value).endswith("no such file; `hexservo scenarios` lists what is packaged")
    str(caught.value).encode()


def test_every_line_names_the_file(file: Path) -> None:
    text = file.read_text("utf-8")
    file.write_text(
        text.replace("duration: 5.0", "duration: -5.0").replace("kind: sign", "kin: sign"), encoding="utf-8"
    )
    with pytest.raises(hs.ScenarioError) as caught:
        hs.load_scenario(file)
    assert str(caught.value).splitlines() == [
        f'{file}: controller.switching.kin: unknown key; did you mean "kind"? known keys: kind, width',
        f"{file}: simulation.duration: expected a number > 0, got -5.0",
    ]
    assert caught.value.source == os.fspath(file)


def test_a_file_that_holds_no_scenario(file: Path) -> None:
    for text, words in [
        ("", "expected a scenario: a mapping with the keys name, .*; got null"),
        ("- 1", "expected a scenario: .*; got \\[1\\]"),
        ("name: a\nname: b", 'line 2: duplicate key "name"'),
        ("name: {", "not valid YAML"),
    ]:
        file.write_text(text, encoding="utf-8")
        with pytest.raises(hs.ScenarioError, match=words):
            hs.load_scenario(file)
    with pytest.raises(hs.ScenarioError, match="cannot be read"):
        hs.load_scenario(file.parent)
    with pytest.raises(hs.ScenarioError, match="No such file"):
        hs.load_scenario(file.parent / "absent.yaml")


# ---- To YAML and back -----------------------------------------------------------------------------------------------


def plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(type(key) is str and plain(item) for key, item in value.items())
    if isinstance(value, list):
        return all(plain(item) for item in value)
    return value is None or type(value) in (bool, int, float, str)


@pytest.mark.parametrize("name", hs.scenario_names())
def test_the_resolved_scenario_loads_again(name: str) -> None:
    scenario = hs.load_scenario(name)
    assert plain(scenario.to_mapping())
    assert hs.Scenario.from_mapping(scenario.to_mapping()) == scenario
    again = hs.Scenario.from_yaml(scenario.to_yaml())
    assert again == scenario
    assert again.to_yaml() == scenario.to_yaml()
    assert load_yaml(scenario.to_yaml()) == scenario.to_mapping()


def test_to_mapping_gives_away_nothing_shared(paper: hs.Scenario) -> None:
    paper.to_mapping()["robot"]["base_angles"][0] = 99
    assert paper.to_mapping()["robot"]["base_angles"][0] != 99


def number_or(count: int, element: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    return element | st.lists(element, min_size=count, max_size=count)


GOAL = (10, 10, 45, -73, -64, 29, -30, -23)
DELTA = st.floats(-0.99, 0.99)
GAIN = st.floats(1e-12, 1e3)
CHANGES = st.fixed_dictionaries(
    {},
    optional={
        "name": st.from_regex(r"[a-zA-Z0-9][-_.a-z0-9]{0,20}[a-z0-9]", fullmatch=True)
        | st.sampled_from(["on", "no", "null", "0x1F", "1e-6", "1.5", "010", "2001-12-14", "größe"]),
        "description": st.text(st.characters(categories=["L", "N", "P", "S"]), max_size=60)
        | st.sampled_from(["a: b", "# c", "- d", "{", "true", "~", "1e-6", "'", '"', " x "]),
        "camera.convention": st.sampled_from(["eye_in_hand", "as_printed"]),
        "target.desired_features": st.lists(st.floats(-5, 5), min_size=8, max_size=8).map(
            lambda shifts: [goal + shift for goal, shift in zip(GOAL, shifts, strict=True)]  # four points apart
        ),
        "target.depth": number_or(4, st.floats(0.1, 2)),
        "uncertainty.inertia": DELTA,
        "uncertainty.coriolis": st.lists(st.lists(DELTA, min_size=6, max_size=6), min_size=6, max_size=6) | DELTA,
        "uncertainty.gravity": number_or(6, DELTA),
        "uncertainty.depth": number_or(4, DELTA),
        "controller.jacobian": st.sampled_from(["consistent", "printed"]),
        "controller.switching": st.fixed_dictionaries(
            {"kind": st.sampled_from(["sign", "tanh", "saturation"]), "width": st.floats(1e-9, 1)}
        ),
        "controller.law": st.sampled_from(["hybrid", "composite", "kelly", "resolved_rate", "computed_torque"]),
        "controller.composite.kp": number_or(8, st.just(0.0) | GAIN),
        "controller.composite.kt": number_or(6, st.just(0.0) | GAIN),
        "controller.composite.drive": number_or(6, st.just(0.0) | GAIN),
        "controller.composite.prior": number_or(6, GAIN),
        "controller.composite.fuzzy.adaptation": number_or(6, GAIN),
        "controller.composite.fuzzy.leakage": number_or(6, st.just(0.0) | st.floats(1e-9, 1)),
        "controller.composite.fuzzy.weight_limit": st.none() | number_or(6, GAIN),
        "controller.hybrid.fuzzy.dead_zone": number_or(6, st.just(0.0) | GAIN),
        "controller.composite.fuzzy.bell_width": st.none() | st.floats(0.01, 1),
        "controller.kelly.kp": number_or(8, st.just(0.0) | GAIN),
        "controller.resolved_rate": st.fixed_dictionaries(
            {"gain": st.floats(2, 20), "adaptive": st.booleans(), "gain_far": st.floats(0, 2)}
        ),
        "controller.resolved_rate.damping": number_or(6, st.just(0.0) | GAIN),
        "controller.pbvs.kd": number_or(6, st.just(0.0) | GAIN),
        "controller.pbvs.prior": number_or(6, GAIN),
        "controller.computed_torque.prior": number_or(6, GAIN),
        "controller.hybrid.kp": number_or(8, GAIN),
        "controller.hybrid.kv": number_or(6, st.just(0.0) | GAIN),
        "controller.hybrid.fuzzy.enabled": st.booleans(),
        "controller.hybrid.fuzzy.adaptation": number_or(6, GAIN),
        "controller.hybrid.fuzzy.initial_scale": number_or(6, st.floats(-10, 10)),
        "controller.hybrid.fuzzy.table": st.lists(
            st.lists(st.sampled_from(TERMS) | st.floats(-1, 1), min_size=7, max_size=7), min_size=7, max_size=7
        ),
        "controller.hybrid.fuzzy.bell_width": st.none() | st.floats(0.01, 1),
        "controller.hybrid.fuzzy.bell_slope": st.integers(1, 4) | st.floats(0.5, 4),
        "simulation": st.builds(
            lambda step, count: {"step": step, "duration": step * count}, st.floats(1e-6, 1), st.integers(1, 10_000)
        ),
        "simulation.log_every": st.integers(1, 1000),
    },
)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(CHANGES)
def test_any_valid_scenario_survives_yaml(changes: dict[str, Any]) -> None:
    scenario = hs.load_scenario("paper").updated(changes)
    again = hs.Scenario.from_yaml(scenario.to_yaml())
    assert again == scenario
    assert repr(again.to_mapping()) == repr(scenario.to_mapping())


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.integers(0, 2**63 - 1), st.floats(0, 1), st.sampled_from([None, 2e-3, 33e-3]), st.floats(0, 10))
def test_any_valid_sampled_scenario_survives_yaml(
    seed: int, dropout: float, period: float | None, noise: float
) -> None:
    changes = {"seed": seed, "camera": {"dropout": dropout, "period": period, "noise": noise}}
    scenario = hs.load_scenario("paper").updated({**changes, "simulation.mode": "sampled"})
    again = hs.Scenario.from_yaml(scenario.to_yaml())
    assert again == scenario
    assert again.seed == seed
    assert again.camera.period == period


def test_depths_whose_image_jacobian_overflows_are_refused() -> None:
    """Every time: the decomposition of such a matrix returns what the memory held."""
    expected = r"target.initial_features: expected features and depths with a finite image Jacobian"
    for _ in range(10):
        with pytest.raises(hs.ScenarioError, match=expected):
            hs.load_scenario("paper").updated({"target.depth": [5e5, 1e-150, 3e-8, 1e300]})


@pytest.mark.parametrize(
    "numbers",
    [
        array("d", [0.0, 0.0, 9.81]),
        memoryview(array("d", [0.0, 0.0, 9.81])),
        deque([0.0, 0.0, 9.81]),
        range(3),
        pd.Series([0.0, 0.0, 9.81]),
        xarray.DataArray([0.0, 0.0, 9.81], attrs={"units": "m/s^2"}),
        np.array([0.0, 0.0, 9.81], dtype=np.longdouble),
        np.ma.array([0.0, 0.0, 9.81]),
    ],
    ids=lambda numbers: type(numbers).__name__,
)
def test_whatever_holds_numbers_is_taken(paper: hs.Scenario, numbers: Any) -> None:
    assert paper.updated({"robot.gravity": numbers}).robot.gravity == tuple(map(float, np.asarray(numbers)))


def test_a_long_double_is_a_number_and_bytes_are_none(paper: hs.Scenario) -> None:
    assert paper.updated({"robot.mass": np.longdouble(0.25)}).robot.mass == 0.25
    with pytest.raises(hs.ScenarioError, match=r"robot\.gravity: expected .*, got a Python bytes"):
        paper.updated({"robot.gravity": b"abc"})


@pytest.mark.parametrize("numbers", [np.ma.masked, np.ma.array([0.0, 0.0, 9.81], mask=[True, False, False])])
def test_masked_values_are_refused(paper: hs.Scenario, numbers: Any) -> None:
    with pytest.raises(hs.ScenarioError, match=r"^robot\.gravity: expected a value without a mask, got a masked one"):
        paper.updated({"robot.gravity": numbers})


def test_an_empty_key_is_shown_in_quotes(paper: hs.Scenario) -> None:
    with pytest.raises(hs.ScenarioError, match=r'^"": unknown key'):
        paper.updated({"": 1})
    with pytest.raises(hs.ScenarioError, match=r'robot\.mass: expected .*, got a block with the keys ""$'):
        paper.updated({"robot.mass.": 1})
