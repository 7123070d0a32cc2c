"""Scenarios: what a run simulates, as immutable and completely validated data.

A `Scenario` is read from YAML (`load_scenario`) or built from a mapping. Everything wrong with it is reported at once,
in a `ScenarioError` with one line per problem. SI units and radians throughout; image quantities in pixels. Frames, the
symbols and the reasons for the defaults: docs/model.md. The defaults of the maths have one source, the C++ structs.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError, model_validator

from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.blocks import DEFAULT_DEPTH, DEFAULT_PRESET, Blocks, preset_values
from hexservo.scenario.fitted import chosen_keys, idle_gains, with_fitted_gains, without_fitted_gains
from hexservo.scenario.goal_readings import best_readings, question
from hexservo.scenario.keys import sampled_keys, value_at, without_effect
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.placing import problem_of_recording, read_motion, read_target
from hexservo.scenario.plain import plain, put
from hexservo.scenario.problems import in_words, listing
from hexservo.scenario.reading import SCENARIO_OF_RUN
from hexservo.scenario.rules import did_you_mean, shown_value
from hexservo.scenario.tag import require_counts_elsewhere
from hexservo.scenario.unit_slips import with_slip
from hexservo.scenario.wording import wrong_type
from hexservo.scenario.yaml import ScenarioError, dump_yaml, load_yaml, read_yaml

_OF_CAMPAIGN = {"scenario", "vary", "require"}  # keys that a campaign file must have
_NO_POSE = "target.desired_features: expected features that some pose gives"


class Scenario(Blocks):
    """All that a run depends on. Immutable; a scenario that exists is one that can run.

    Two scenarios are equal when they mean the same: six equal gains are that gain, a table that equals the linear one
    is "linear", values that a preset fills in are as good as written ones. A ``camera.period`` of null, which follows
    the servo period, differs from a number, even one that equals it.
    """

    def __init__(self, /, **keys: Any) -> None:
        """Validate the keys of a scenario.

        Raises
        ------
        ScenarioError
            With one line for each problem.
        """
        try:
            super().__init__(**plain(keys))
        except ValidationError as error:
            raise ScenarioError(list(in_words(error))) from None

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        """Fill in the gains that fit."""
        if not isinstance(data, dict):
            return data
        require_counts_elsewhere(data)
        return with_fitted_gains(data)

    @model_validator(mode="after")
    def _can_run(self) -> Scenario:
        self._refuse_keys_without_effect()
        read_motion(self)
        try:
            read_target(self)
            core_parameters(self)
        except ValidationError:
            raise
        except ValueError as error:
            raise ValueError(with_slip(str(error), self)) from None
        return self

    @property
    def sampled(self) -> bool:
        """Whether time is sampled: camera, sensors and actuators act as devices, with their times."""
        return self.simulation.mode == SAMPLED_MODE

    def _refuse_keys_without_effect(self) -> None:
        if self.sampled:
            idle = idle_gains(self)  # most have none, and need not fit their gains here
            if given := idle and sorted(idle.intersection(chosen_keys(self))):
                raise ValueError(
                    f"controller.{self.controller.law}.{given[0]}: has no effect where actuators.kind is not force, "
                    "since the legs follow the commanded twist by themselves; drop it"
                )
            return
        given = [key for key, default in sampled_keys().items() if value_at(self, key) != default]
        if given:
            raise ValueError(without_effect(given))

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> Scenario:
        """Make a scenario from nested mappings and lists; numpy arrays and scalars will do.

        Raises
        ------
        ScenarioError
            With one line for each problem.
        """
        return cls(**_as_block(plain(mapping)))

    @classmethod
    def from_yaml(cls, text: str, source: str | None = None) -> Scenario:
        """Make a scenario from YAML text, as `to_yaml` writes it; `source` heads the errors.

        Raises
        ------
        TypeError
            For anything but text.
        ScenarioError
            With one line for each problem.
        """
        if not isinstance(text, str):
            raise wrong_type("text", "YAML as text (see hs.load_scenario for files)", text)
        return Document(load_yaml(text, source), source).scenario()

    def updated(self, changes: Mapping[str, Any]) -> Scenario:
        """Return a copy with some keys changed, validated again.

        Parameters
        ----------
        changes
            Values by dotted key, as ``{"uncertainty.depth": -0.3}``. A mapping as the value of a block changes the keys
            it names and leaves the others alone. A ``camera.period`` that is a number stays where ``simulation.step``
            changes, whatever it equals, and is refused where it does not fit; null, a frame at every servo period,
            follows. Changing ``robot.preset`` brings that preset's values, except where this scenario differs from its
            own preset, and gains are computed again, except where they differ from what ``auto``, or the defaults
            without it, gave: a value that is written as it would follow counts as one that follows. To give the
            target's points in the other form, set the keys of the first form to None. What was read into other keys is
            unchanged: a tag, a grid and a desired pose are points and features by now, which another camera, mount or
            home leaves alone, and specific forces are kinematic accelerations: another recording needs
            ``base_motion.frame_of_acceleration`` beside it, and ``specific_force`` another recording. Their weight was
            taken out with the ``robot.gravity`` that they were read with: another one leaves the difference of the two
            in them, a constant acceleration of the base that it did not have. `load_scenario` with changes, and
            ``--set``, read them afterwards.

        Raises
        ------
        TypeError
            For anything but a mapping.
        ScenarioError
            With one line for each problem; an unknown key comes with the nearest known one.
        """
        _require_mapping(changes)
        return Scenario(**_changed(self._written(), changes))

    def to_mapping(self) -> dict[str, Any]:
        """Return the whole scenario, every default filled in, as dicts, lists, text and numbers."""
        return cast("dict[str, Any]", plain(self))

    def to_yaml(self) -> str:
        """Return the whole scenario as YAML that loads to an equal one, floats bit for bit."""
        return dump_yaml(self.to_mapping())

    def _written(self) -> dict[str, Any]:
        """Return what a user has to write for this scenario: without the values that follow from others."""
        keys = self.to_mapping()
        if self.robot.preset is not None:
            preset = preset_values(self.robot.preset)
            keys["robot"] = {key: value for key, value in keys["robot"].items() if preset.get(key) != value}
        if self.target.depth == DEFAULT_DEPTH:
            del keys["target"]["depth"]
        without_fitted_gains(self, keys)
        return keys


# ---- Scenarios by name or path --------------------------------------------------------------------------------------


def scenario_names() -> tuple[str, ...]:
    """Return the names of the packaged scenarios, in alphabetical order."""
    folder = resources.files("hexservo") / "scenarios"
    return tuple(sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".yaml")))


def require_scenario(scenario: object) -> None:
    """Refuse an argument that is no scenario, such as its name.

    Raises
    ------
    TypeError
        "scenario: expected a Scenario (see hs.load_scenario), got str".
    """
    if not isinstance(scenario, Scenario):
        raise wrong_type("scenario", "a Scenario (see hs.load_scenario)", scenario)


@dataclass(frozen=True)
class Document:
    """A scenario as it is written: tags, grids, goal poses and recordings are not read into other keys yet."""

    keys: Any  # plain data
    source: str | None = None  # file or name, for errors

    def scenario(self, changes: Mapping[str, Any] | None = None) -> Scenario:
        """Make the scenario, of the keys as they are or with changes by dotted key, as for `Scenario.updated`.

        With changes it is the scenario of a file that has them, except that keys which only repeat what follows from
        others, as in the output of ``hexservo show``, follow the changes too.

        Raises
        ------
        TypeError
            For changes that are no mapping.
        ScenarioError
            With one line for each problem, headed by the source where the keys are not valid without the changes.
        """
        if changes is not None:
            _require_mapping(changes)
        keys, source = self._with(changes) if changes and isinstance(self.keys, dict) else (self.keys, self.source)
        try:
            return Scenario(**_as_block(keys))
        except ScenarioError as error:
            raise ScenarioError([_with_reading(problem, keys) for problem in error.problems], source) from None

    def _with(self, changes: Mapping[str, Any]) -> tuple[dict[str, Any], str | None]:
        """Return the keys with changes, and what heads errors: the source if it is not valid without them."""
        keys: dict[str, Any] = plain(self.keys)
        source: str | None = None
        try:
            whole = self.scenario()
        except ScenarioError:  # the changes may have what is missing
            source = self.source
        else:
            keys = _chosen(keys, whole.to_mapping(), whole._written())
        return _changed({"robot": {"preset": DEFAULT_PRESET}, **keys}, changes), source


def load_scenario(name_or_path: str | os.PathLike[str], changes: Mapping[str, Any] | None = None) -> Scenario:
    """Load a packaged scenario by its name, or one from a YAML file.

    Parameters
    ----------
    name_or_path
        One of `scenario_names`, or the path of a file. A packaged name wins over a file of the same name in the
        current folder, which is reached by ``./name`` or as a `pathlib.Path`.
    changes
        Values by dotted key, as for `Scenario.updated`, but put into the file before anything in it is read into other
        keys: with ``{"camera.focal_pixels": 900}`` a tag and a goal pose have their image in that camera.

    Raises
    ------
    TypeError
        For anything but a name or a path, and for changes that are no mapping.
    ScenarioError
        No such scenario (with the nearest name), a file that cannot be read, or a scenario that is not valid: then
        with one line for each problem, headed by the file's name unless the changes are the cause.
    """
    return read_document(name_or_path).scenario(changes)


def read_document(name_or_path: str | os.PathLike[str]) -> Document:
    """Return what a packaged scenario or a file has written, with the arguments and errors of `load_scenario`."""
    if not isinstance(name_or_path, str | bytes | os.PathLike):
        raise wrong_type("name_or_path", "the name of a packaged scenario or a path", name_or_path)
    if isinstance(name_or_path, bytes):
        name_or_path = os.fsdecode(name_or_path)
    names = scenario_names()
    if isinstance(name_or_path, str):
        if name_or_path in names:
            return _packaged(name_or_path)
        if not os.path.lexists(name_or_path):
            stem = name_or_path.removesuffix(".yaml")
            what = "no such file"
            if stem == name_or_path and "/" not in stem:
                what = f"no packaged scenario has that name, and there is {what}"
            nearest = did_you_mean(stem.rpartition("/")[2], names)
            raise ScenarioError(f'"{name_or_path}": {what}{nearest or "; `hexservo scenarios` lists what is packaged"}')
    path = os.fsdecode(name_or_path)
    document = read_yaml(name_or_path, [SCENARIO_OF_RUN])
    folder = Path(path).parent  # to which paths of recordings are relative
    return Document(_in_folder(_in_folder(document, folder, "base_motion"), folder, "target", "motion"), path)


@cache
def _packaged(name: str) -> Document:
    """Return a packaged scenario as it is written; its keys are shared and never changed."""
    text = (resources.files("hexservo") / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8")
    return Document(load_yaml(text, name), name)


def _with_reading(problem: str, keys: Any) -> str:
    """Return a problem of a written scenario, with what a goal image may mean that no pose shows as it stands."""
    if not problem.startswith(_NO_POSE):
        return problem
    try:
        blocks = Blocks(**with_fitted_gains(keys))
        read_target(blocks)
        readings = best_readings(blocks)
    except ValueError:  # of other keys, which have their own problems
        return problem
    return f"{problem}; {question(readings)}" if readings else problem


def _chosen(keys: dict[str, Any], whole: dict[str, Any], written: dict[str, Any]) -> dict[str, Any]:
    """Return a block without the keys that repeat what follows from others: in the whole of it, but not `written`."""
    return {
        key: _chosen(value, whole[key], written[key]) if _are_blocks(value, whole[key], written.get(key)) else value
        for key, value in keys.items()
        if key in written or value != whole[key]
    }


def _are_blocks(*values: Any) -> bool:
    return all(isinstance(value, dict) for value in values)


def _require_mapping(changes: object) -> None:
    if not isinstance(changes, Mapping):
        raise wrong_type("changes", "a mapping of dotted keys to values", changes)


def _changed(keys: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Put changes by dotted key into a scenario's keys (changed in place)."""
    of_recording = problem_of_recording(keys.get("base_motion"), changes)
    problems = [problem for path, value in plain(changes).items() if (problem := put(keys, path, value))]
    if of_recording is not None:
        problems.append(of_recording)
    if problems:
        raise ScenarioError(problems)
    return keys


def _in_folder(document: Any, folder: Path, *blocks: str) -> Any:
    """Make the path of a recording, the key "file" of a block in a block, one from a folder."""
    if not isinstance(document, dict):
        return document
    if blocks:
        return document | {key: _in_folder(document[key], folder, *blocks[1:]) for key in blocks[:1] if key in document}
    return document | {"file": str(folder / document["file"])} if isinstance(document.get("file"), str) else document


def _as_block(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ScenarioError(f"expected a scenario: a mapping with the keys {listing(Blocks)}; got {shown_value(value)}")
    if value.keys() >= _OF_CAMPAIGN:
        raise ScenarioError(
            "expected a scenario, got a campaign, with the keys scenario, vary and require: `hexservo campaign` runs "
            "it, and its scenario stands under the first"
        )
    return value
