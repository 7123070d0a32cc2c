"""Scenarios as Functional Mock-up Units for co-simulation, FMI 2.0 and 3.0 (docs/fmu.md)."""

from __future__ import annotations

import hashlib
import io
import platform
import uuid
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from hexservo import _core
from hexservo.bridges.model_description import UnitVariable, model_description
from hexservo.run.c_library import c_library
from hexservo.run.controller import OF_FORCES, tick_keys, unused_by_law
from hexservo.run.metrics import METRICS, metric_unit
from hexservo.run.quantities import quantities
from hexservo.scenario.block import SAMPLED_MODE
from hexservo.scenario.flat import flat
from hexservo.scenario.leg_units import leg_units, unit_of, unit_of_entry
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.version import VERSION

UnitKind = Literal["loop", "plant", "controller"]
"""What a unit computes."""

_IDENTIFIER = "hexservo"
# Folders of a unit's library by the version of the standard and the processor; 2.0 has no name for ARM.
_FOLDERS = {2: {"x86_64": "linux64"}, 3: {"x86_64": "x86_64-linux", "aarch64": "aarch64-linux"}}
_TITLE = "hexservo model 1"
"""First line of `resources/model.txt`, which distinguishes our units from others."""

_DATE = (1980, 1, 1, 0, 0, 0)  # of every file in a unit: equal scenarios give equal units
# A unit logs nothing; its mode decides what it is, its legs which units it has.
_LEFT_OUT = ("simulation.log_every", "simulation.mode", "robot.legs")
# Of a controller: which outputs it has.
_NOT_OF_A_CONTROLLER = ("actuators.kind", "camera.latency_known")
# A plant has no law, is not judged, and goes on until it fails. What it takes is its input.
_NOT_OF_A_PLANT = ("controller.", "actuators.kind", "metrics.", "simulation.duration", "camera.latency_known")
# Keys of other drives. Legs that follow positions have no limited force, and where they are sent no brake acts.
_NOT_OF_DRIVES = {
    "force": ("actuators.position.", "actuators.motor."),
    "position": (*OF_FORCES, "actuators.motor.", "robot.force_limit", "camera.timeout"),
    "position_torque": (*OF_FORCES, "actuators.position.", "camera.timeout"),
}
_TYPES = {"number": "real", "array": "real", "whole": "whole", "flag": "flag", "choice": "text", "seed": "text"}


def fmu(scenario: Scenario, *, fmi: Literal[2, 3] = 2, what: UnitKind = "loop") -> bytes:
    """Return a scenario as a Functional Mock-up Unit for co-simulation on Linux, for the processor that this runs on.

    Parameters
    ----------
    scenario
        What the unit starts with. Every key of the core that holds numbers or a name and acts in the unit is a
        parameter, array entries one by one: ``robot.mass`` [kg], ``uncertainty.gravity[3]``. Keys that are null in the
        scenario are none, nor are in continuous mode those that act in sampled mode alone.
    fmi
        Version of the standard: 2 (2.0) or 3 (3.0).
    what
        "loop": plant and controller, without inputs. "plant": takes a wrench ``wrench[1]`` ... ``[6]`` about the
        platform's origin in B [N; N m], or ``leg_positions`` [m], [rad] where the drives take positions, of scenarios
        in sampled mode. "controller": the servo tick, from sensors to either.

    Returns
    -------
    bytes
        A ZIP archive that contains the compiled core and needs no other program. A communication step is a whole number
        of servo periods (``simulation.step``); the arithmetic is that of the variant ``baseline``. Variables with
        their units and frames: docs/fmu.md.

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        For another version or kind, a plant in continuous mode, a processor that the version has no units for (FMI 3
        has those of x86-64 and 64-bit ARM, FMI 2 of x86-64), and what the core refuses.
    FileNotFoundError
        Where the package was built without `c_library`, which the unit contains.
    """
    require_scenario(scenario)
    # 2.0 and True equal a version, but are not written as one
    if repr(fmi) not in map(repr, _FOLDERS):
        raise ValueError(f"fmi: expected 2 or 3, got {fmi!r}")
    processor = platform.machine()
    if processor not in _FOLDERS[fmi]:
        raise ValueError(
            f"fmi: expected a version that has units for processors of the kind {processor}, got {fmi}"
            + ("; 3 has" if processor in _FOLDERS[3] else "")
        )
    if what not in get_args(UnitKind):
        raise ValueError(f"what: expected {', '.join(get_args(UnitKind))}, got {what!r}")
    if what == "plant" and not scenario.sampled:
        raise ValueError(
            f"simulation.mode: expected {SAMPLED_MODE} for a plant that is commanded, got {scenario.simulation.mode}"
        )
    settings = core_parameters(scenario)
    signals = {"loop": _of_loop, "plant": _of_plant, "controller": _of_controller}[what](scenario, settings)
    variables = [UnitVariable("time", "real", "time", unit="s"), *_parameters(scenario, settings, what), *signals]
    lines = [
        f"what {what}",
        *(variable.line for variable in variables),
        "scenario",
        *(f"{key} {value}" for key, value in flat(scenario).items()),
    ]
    text = "\n".join([VERSION, str(fmi), *lines])
    token = "{" + str(uuid.UUID(bytes=hashlib.sha256(text.encode()).digest()[:16])) + "}"
    return _packed(
        {
            "modelDescription.xml": model_description(scenario, fmi, what, _IDENTIFIER, token, variables),
            f"binaries/{_FOLDERS[fmi][processor]}/{_IDENTIFIER}.so": c_library().read_bytes(),
            "resources/model.txt": "\n".join([_TITLE, f"token {token}", *lines, ""]).encode(),
            "resources/scenario.yaml": scenario.to_yaml().encode(),
        }
    )


def _packed(files: dict[str, bytes]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.external_attr = (0o755 if name.endswith(".so") else 0o644) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    return packed.getvalue()


def is_unit(path: Path) -> bool:
    """Recognise a unit that `fmu` made, by its first line of `resources/model.txt`."""
    try:
        with zipfile.ZipFile(path) as archive:
            entry = archive.getinfo("resources/model.txt")
            if entry.compress_type != zipfile.ZIP_DEFLATED:  # ours are packed so, and other methods have other errors
                return False
            return archive.read(entry).startswith(f"{_TITLE}\n".encode())
    except (OSError, KeyError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError):
        return False  # no archive of ours, or one that is damaged or encrypted


def _keys(settings: _core.Settings, what: UnitKind) -> Iterator[_core.ScenarioKey]:
    """Yield the keys that act in a unit."""
    if what == "controller":
        yield from (key for key in tick_keys(settings) if key.name not in _NOT_OF_A_CONTROLLER)
        return
    unused = _unused_by_plant(settings) if what == "plant" else unused_by_law(settings.law)
    if not (_has_gate(settings) or _has_border(settings)):  # no point is ever lost
        unused += ("camera.on_lost",)
    for key in _core.scenario_keys(settings.law):
        # without an image
        brakes = what == "plant" and settings["actuators.kind"] == "force" and key.name.startswith("controller.safe.")
        acts = brakes or not key.name.startswith(unused)
        if acts and (not key.sampled or settings["simulation.mode"] == SAMPLED_MODE):
            yield key


def _unused_by_plant(settings: _core.Settings) -> tuple[str, ...]:
    """Return the beginnings of keys without effect in a plant, which uses images only to decide whether it brakes.

    So of the camera that the controller assumes there acts only what decides whether a point is seen: a gate, or which
    rays a distorting lens shows.
    """
    unused: tuple[str, ...] = (*_NOT_OF_A_PLANT, *_NOT_OF_DRIVES[settings["actuators.kind"]])
    if not _has_gate(settings):
        unused += ("camera.prediction", "uncertainty.mount.")
        if settings["camera.prediction"] == "encoder":  # which as_printed excludes
            unused += ("camera.convention",)
        if not _distorts(settings):
            unused += ("uncertainty.focal_length", "uncertainty.principal_point")
        if not _has_border(settings):
            unused += ("target.weights",)
    return unused


def _has_gate(settings: _core.Settings) -> bool:
    return bool(np.isfinite(settings["camera.gate"]))


def _distorts(settings: _core.Settings) -> bool:
    return any(settings[f"camera.distortion.{model}"] is not None for model in ("brown_conrady", "kannala_brandt"))


def _has_border(settings: _core.Settings) -> bool:
    """Return whether the camera does not see all that is before it."""
    return _distorts(settings) or bool(np.isfinite(settings["camera.image_size"]).all())


def _parameters(scenario: Scenario, settings: _core.Settings, what: UnitKind) -> Iterator[UnitVariable]:
    """Yield every key of the core's table that has a finite value and acts in the unit: arrays entry by entry.

    Where a scenario has null beside another key (a radius beside joints, a focal length in metres beside one in pixels)
    the core has its default there, which does not act: such keys are none.
    """
    texts = flat(scenario)
    for key in _keys(settings, what):
        text = texts[key.name]
        if key.type not in _TYPES or key.name in _LEFT_OUT or (text == "none" and key.type != "choice"):
            continue
        if attrgetter(key.name)(scenario) is None:
            continue
        kind = _TYPES[key.type]
        if kind == "text":
            yield UnitVariable("parameter", kind, key.name, key.name, start=text)
            continue
        starts = text.split()
        if not all(np.isfinite(float(start)) for start in starts):
            continue
        shape = np.shape(settings[key.name]) if key.type == "array" else ()
        for index, start in enumerate(starts):
            yield UnitVariable(
                "parameter", kind, key.name + _place(shape, index), key.name, index,
                _unit(unit_of(scenario.robot, key.name, key.unit), index, len(starts)), start, key.least, key.most,
            )  # fmt: skip


def _place(shape: tuple[int, ...], index: int) -> str:
    """Return the place of an entry as FMI counts, from 1: "[2]" or "[2,3]"; nothing for a single number."""
    return "[" + ",".join(str(int(i) + 1) for i in np.unravel_index(index, shape)) + "]" if shape else ""


def _unit(unit: str, index: int, count: int) -> str:
    """Return the unit of an entry; none where two units are not those of six numbers."""
    return unit_of_entry(unit, index) if count == 6 or "; " not in unit else ""


def _arrays(scenario: Scenario) -> dict[str, tuple[str, int]]:
    """Return unit and length of every array that a unit may take or give, by name."""
    robot = scenario.robot
    logged = {
        name: (unit_of(robot, name, unit), len(labels))
        for name, (_, labels, unit, _) in quantities(scenario.target.count).items()
    }
    of_sensors = {"features": logged["feature_error"], "leg_rates": (leg_units(robot).rate, 6)}
    return {**logged, **of_sensors, "leg_positions": logged["leg_lengths"], "latency": ("s", 3)}


def _signals(
    scenario: Scenario, role: Literal["input", "output"], names: Iterable[str], starts: Mapping[str, Any] | None = None
) -> Iterator[UnitVariable]:
    """Yield arrays by their names, entry by entry, which start with `starts` or else with zeros."""
    known = _arrays(scenario)
    for name in names:
        unit, count = known[name]
        for index, start in enumerate(np.ravel((starts or {}).get(name, np.zeros(count)))):
            entry = f"{name}[{index + 1}]"
            yield UnitVariable(role, "real", entry, name, index, unit_of_entry(unit, index), repr(float(start)))


def _of_loop(scenario: Scenario, settings: _core.Settings) -> Iterator[UnitVariable]:
    yield from _signals(scenario, "output", quantities(scenario.target.count))
    for index, name in enumerate(METRICS):
        unit = metric_unit(name, scenario.robot)
        yield UnitVariable("output", "real", f"metric_{name}", "metrics", index, unit)
    yield UnitVariable("output", "whole", "outcome", "outcome")
    yield UnitVariable("output", "real", "end_time", "end_time", unit="s")


def _of_plant(scenario: Scenario, settings: _core.Settings) -> Iterator[UnitVariable]:
    if scenario.actuators.takes_positions:
        at_start = {"leg_positions": _core.SampledRun(settings).observe().leg_positions}
        yield from _signals(scenario, "input", ("leg_positions",), at_start)
    else:
        yield from _signals(scenario, "input", ("wrench",))
    yield from _signals(scenario, "output", ("features", "depth"))
    yield UnitVariable("output", "real", "exposure", "exposure", unit="s")
    measured = ("position", "quaternion", "twist", "leg_lengths", "leg_rates")
    yield from _signals(scenario, "output", (*measured, "feature_error", "leg_forces"))
    yield UnitVariable("output", "whole", "outcome", "outcome")


def _of_controller(scenario: Scenario, settings: _core.Settings) -> Iterator[UnitVariable]:
    hexapod = _core.Hexapod(settings.robot)
    starts = {
        "features": settings["target.desired_features"],
        "depth": -np.ones(scenario.target.count),
        "position": hexapod.home_position,
        "quaternion": hexapod.home_quaternion,
        "leg_lengths": hexapod.home_lengths,
    }
    yield from _signals(scenario, "input", ("features", "depth"), starts)
    yield UnitVariable("input", "real", "exposure", "exposure", unit="s", start="-1.0")
    yield from _signals(scenario, "input", ("position", "quaternion", "twist", "leg_lengths", "leg_rates"), starts)
    yield from _signals(scenario, "output", ("wrench", "leg_forces", "fuzzy_output"))
    yield UnitVariable("output", "whole", "status", "status")
    yield UnitVariable("output", "whole", "saturated", "saturated")
    if scenario.actuators.takes_positions:
        yield from _signals(scenario, "output", ("leg_positions",))
    if not scenario.camera.latency_known:
        yield from _signals(scenario, "output", ("latency",))
