"""The pydantic blocks of a scenario against the core's table of parameters: same keys, bounds, shapes and defaults."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from pydantic.fields import FieldInfo
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli.commands import app
from hexservo.scenario import schema as schema_module
from hexservo.scenario.blocks import Blocks
from hexservo.scenario.keys import leaves
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.rules import ArrayRule, Choice, Flag, Inertia, Integer, Number, Rule, TableRule, TrueOr
from hexservo.scenario.schema import all_keys, bounds_of, schema

# What the core has no use for: names, and what is read into other keys; with their types.
OF_PYTHON = {
    "name": "text",
    "description": "text",
    "robot.preset": "choice",
    "base_motion.file": "text",
    "base_motion.frame_of_acceleration": "choice",
    "target.motion.file": "text",
    "controller.law": "choice",
    "target.desired_pose": "array",
    "target.tag": "mapping",
    "target.grid": "mapping",
    **{f"controller.{law}.auto.{key}": "number" for law in ALL_LAWS for key in ("bandwidth", "damping")},
}
FIELDS: dict[str, tuple[FieldInfo, bool]] = {path: (field, sampled) for path, field, sampled in leaves(Blocks)}
ENTRIES: dict[str, dict[str, Any]] = {entry["key"]: entry for entry in schema()}


def rule_of(key: str) -> Rule:
    return next(rule for rule in FIELDS[key][0].metadata if isinstance(rule, Rule))


def test_the_blocks_have_the_keys_of_the_core() -> None:
    assert set(FIELDS) - set(OF_PYTHON) == set(ENTRIES)
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
        whole = rule if isinstance(rule, Number) else Number()
        element = rule.element if isinstance(rule, ArrayRule | Inertia) else whole
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


ALL = {entry["key"]: entry for entry in all_keys()}


def test_every_key_of_a_scenario_is_listed() -> None:
    def paths(values: dict[str, Any], head: str = "") -> set[str]:
        inner = [
            paths(value, f"{head}{key}.") if isinstance(value, dict) else {head + key} for key, value in values.items()
        ]
        return set().union(*inner)

    assert set(ALL) == paths(hs.load_scenario("paper").to_mapping())
    assert {key: entry["type"] for key, entry in ALL.items() if key not in ENTRIES} == OF_PYTHON
    of_file = {"choices", "default"}  # of choices these are as a file has them, the rest is the core's
    for key, entry in ENTRIES.items():
        kept = set(entry) - of_file if entry["type"] == "choice" else set(entry)
        assert set(ALL[key]) == {*entry, "meaning"}
        assert {name: ALL[key][name] for name in kept} == {name: entry[name] for name in kept}


@pytest.mark.parametrize("key", [key for key, entry in ALL.items() if entry["type"] == "choice"])
def test_a_file_takes_the_choices_and_the_default_that_are_listed(key: str) -> None:
    field, entry = FIELDS[key][0], ALL[key]
    taken: TypeAdapter[Any] = TypeAdapter(Annotated[(field.annotation, *field.metadata)])  # type: ignore[arg-type]
    listed = entry["choices"] if entry["default"] is None else [*entry["choices"], entry["default"]]
    assert [taken.validate_python(choice) for choice in listed] == listed


@pytest.mark.parametrize("key", ALL)
def test_a_key_has_a_meaning(key: str) -> None:
    """Not its unit and shape alone."""
    assert re.search(r"[a-z]{2}|k1", re.sub(r"\[.*?\]|\(.*?\)", "", ALL[key]["meaning"]))


def test_keys_of_python_have_what_their_rules_take() -> None:
    law, damping = ALL["controller.law"], ALL["controller.pbvs.auto.damping"]
    assert (law["choices"], law["optional"], law["default"]) == (list(ALL_LAWS), False, "hybrid")
    assert (bounds_of(damping), damping["default"], damping["unit"]) == (">= 0.01 and <= 100", 1.0, "1")
    assert ALL["controller.pbvs.auto.bandwidth"]["unit"] == "Hz"
    assert ALL["target.desired_pose"] | {"meaning": ""} == {
        "key": "target.desired_pose",
        "type": "array",
        "unit": "m; rad",
        "optional": True,
        "shape": [6],
        "form": "all",
        "default": None,
        "mode": "any",
        "meaning": "",
    }
    assert (ALL["base_motion.file"]["mode"], ALL["base_motion.file"]["optional"]) == ("sampled", True)


def test_the_keys_are_listed_without_their_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schema_module, "meanings_of", lambda _: (_ for _ in ()).throw(OSError()))
    assert {entry["meaning"] for entry in all_keys()} == {""}


def test_the_command_prints_the_bounds() -> None:
    result = CliRunner().invoke(app, ["schema"])
    assert result.exit_code == 0
    assert re.search(r"^camera\.dropout +number >= 0 and <= 1 +1 +0\.0 *$", result.stdout, re.MULTILINE)
    assert re.search(r"^sensors\.pose +choice +true \| encoders +true *$", result.stdout, re.MULTILINE)
    assert re.search(r"^controller\.law +choice +hybrid \| ", result.stdout, re.MULTILINE)


def test_the_command_prints_it_as_json() -> None:
    result = CliRunner().invoke(app, ["schema", "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == json.loads(json.dumps(all_keys()))


def test_every_key_stands_on_the_page_of_scenarios() -> None:
    """A cell has `block.key`, others of the block without it, or `block.*`; `auto` of one law stands for all."""
    page = (Path(__file__).parents[2] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    keys = {re.sub(r"^controller\.\w+\.auto\.", "controller.hybrid.auto.", key) for key in FIELDS}
    missing = set(keys)
    for cell in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE):
        block: list[str] = []
        for name in re.findall(r"`([^`]+)`", cell):
            for depth in range(len(block), -1, -1):
                whole = ".".join([*block[:depth], name.removesuffix(".*")])
                if found := {key for key in keys if key == whole or key.startswith(whole + ".")}:
                    missing -= found
                    block = whole.split(".")[:-1]
                    break
    assert missing == set()
