"""The pydantic blocks of a scenario against the core's table of parameters: same keys, bounds, shapes and defaults."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from pydantic.fields import FieldInfo
from typer.testing import CliRunner

from hexservo import _core
from hexservo.cli.commands import app
from hexservo.scenario.blocks import Blocks
from hexservo.scenario.keys import leaves
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.rules import ArrayRule, Choice, Flag, Inertia, Integer, Number, Rule, TableRule, TrueOr
from hexservo.scenario.schema import schema

# What the core has no use for: names, and what is read into other keys.
OF_PYTHON = {
    "name",
    "description",
    "robot.preset",
    "base_motion.file",
    "base_motion.frame_of_acceleration",
    "target.motion.file",
    "controller.law",
    "target.desired_pose",
    "target.tag",
    "target.grid",
    *(f"controller.{law}.auto.{key}" for law in ALL_LAWS for key in ("bandwidth", "damping")),
}
FIELDS: dict[str, tuple[FieldInfo, bool]] = {path: (field, sampled) for path, field, sampled in leaves(Blocks)}
ENTRIES: dict[str, dict[str, Any]] = {entry["key"]: entry for entry in schema()}


def rule_of(key: str) -> Rule:
    return next(rule for rule in FIELDS[key][0].metadata if isinstance(rule, Rule))


def test_the_blocks_have_the_keys_of_the_core() -> None:
    assert set(FIELDS) - OF_PYTHON == set(ENTRIES)
    assert set(ALL_LAWS) == set(_core.LAW_TRAITS)


@pytest.mark.parametrize("key", ENTRIES)
def test_a_key_acts_in_the_same_mode(key: str) -> None:
    assert FIELDS[key][1] == (ENTRIES[key]["mode"] == "sampled")


@pytest.mark.parametrize("key", ENTRIES)
def test_a_key_takes_the_same_values(key: str) -> None:
    entry, rule = ENTRIES[key], rule_of(key)
    if isinstance(rule, Flag):
        assert entry["type"] == "flag"
    elif isinstance(rule, TrueOr):
        assert rule.name in entry["choices"]
        assert len(entry["choices"]) == 2
    elif isinstance(rule, Choice):
        names = rule.choices or FIELDS[key][0].annotation.__args__  # type: ignore[union-attr]
        assert list(names) == entry["choices"]
    elif isinstance(rule, Integer):
        if entry["type"] == "whole":
            assert (rule.at_least, rule.at_most) == (entry["minimum"], entry["maximum"])
        else:
            assert entry["type"] == "seed"
            assert (rule.at_least, rule.at_most) == (0, 2**64 - 1)
    else:
        element = rule.element if isinstance(rule, ArrayRule) else rule if isinstance(rule, Number) else Number()
        least = element.at_least if element.above is None else element.above
        most = element.at_most if element.below is None else element.below
        if not key.endswith(".sample_period"):  # a separate rule, without bounds to read
            assert (least, most) == (entry["minimum"], entry["maximum"])
            exclusive = [
                name for name, out in (("minimum", element.above), ("maximum", element.below)) if out is not None
            ]
            assert exclusive == entry["exclusive"]
    if isinstance(rule, ArrayRule):
        assert list(rule.shape) == entry["shape"]
        assert rule.or_number == (entry["form"] == "one_or_all")
    elif isinstance(rule, Inertia | TableRule):
        assert entry["shape"] == ([3, 3] if isinstance(rule, Inertia) else [7, 7])
        assert entry["form"] == ("symmetric" if isinstance(rule, Inertia) else "all")


@pytest.mark.parametrize("key", ENTRIES)
def test_a_key_has_the_same_default(key: str) -> None:
    field, default = FIELDS[key][0], ENTRIES[key]["default"]
    if key.startswith(("target.", "robot.")) and key not in ("robot.on_limit", "robot.limits_every"):
        return  # a target has no default, a robot those of its preset
    law = next((law for law in ALL_LAWS if key.startswith(f"controller.{law}.")), None)
    value: Any = Blocks.model_fields["controller"].get_default(call_default_factory=True)
    if key.startswith("controller."):  # the block around it may change its defaults
        for name in key.split(".")[1:]:
            value = getattr(value, name)
    else:
        value = field.get_default(call_default_factory=True)
    if value is True and ENTRIES[key]["type"] == "choice":
        assert default.startswith("tru")
    elif isinstance(value, str) and ENTRIES[key]["type"] == "array":
        assert value == "linear"
        np.testing.assert_array_equal(default, _core.LINEAR_RULE_TABLE)
    elif value is None or isinstance(value, str | bool):
        assert value == default
    else:
        expected = np.asarray(default)
        np.testing.assert_array_equal(np.broadcast_to(np.asarray(value), expected.shape), expected, err_msg=str(law))


def test_the_command_prints_it_as_json() -> None:
    result = CliRunner().invoke(app, ["schema", "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == json.loads(json.dumps(schema()))
