"""Functional Mock-up Units in FMPy: valid, and bit for bit what hexservo computes itself."""

from __future__ import annotations

import ctypes
import importlib
import io
import re
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.bridges.model_description import si_exponents
from hexservo.cli.commands import app
from hexservo.run.controller import tick_keys
from hexservo.run.export import gains_header
from hexservo.run.variant import load_kernel
from hexservo.scenario.flat import flat_text
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters
from points import five_points, roundings

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")

from fmpy.fmi2 import FMU2Slave  # noqa: E402
from fmpy.fmi3 import FMU3Slave  # noqa: E402

VERSIONS = (2, 3)
HEADERS = Path(fmpy.__file__).parent / "c-code"
SHORT = {"simulation.duration": 0.2}
MOTORS = {"actuators": {"kind": "position_torque", "motor": {"kp": 10.0, "kv": 0.1, "friction": 0.1}}}  # N m, rad


@pytest.fixture(autouse=True)
def baseline(monkeypatch: pytest.MonkeyPatch) -> None:
    """The units' arithmetic: a process chooses its variant once, before a test can ask for one."""
    monkeypatch.setattr("hexservo.run.variant._CHOSEN", load_kernel("baseline"))


@pytest.fixture(scope="module", autouse=True)
def library() -> None:
    try:
        hs.c_library()
    except FileNotFoundError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module", autouse=True)
def names_are_parsed_once() -> Iterator[None]:
    """FMPy parses every name with a general grammar, which is most of a validation; units share nearly all names."""
    grammar: Any = importlib.import_module("lark").Lark

    @cache
    def remembering(text: str, start: str) -> SimpleNamespace:
        return SimpleNamespace(parse=cache(grammar(text, start=start).parse))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lark.Lark", remembering)
        yield


@pytest.fixture(scope="module", autouse=True)
def units_are_packed_fast() -> Iterator[None]:
    """The library is compressed for every unit, which takes as long as the rest of a test: without, here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("zlib.Z_DEFAULT_COMPRESSION", 0)
        yield


class Unit:
    """An instance of a unit, by names of its variables."""

    def __init__(self, folder: str, description: Any, **instantiation: Any) -> None:
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.types = {v.name: v.type for v in description.modelVariables}
        self.two = description.fmiVersion == "2.0"
        kind = FMU2Slave if self.two else FMU3Slave
        token = description.guid if self.two else description.instantiationToken
        identifier = description.coSimulation.modelIdentifier
        self.fmu = kind(guid=token, unzipDirectory=folder, modelIdentifier=identifier, instanceName="one")
        self.fmu.instantiate(**instantiation)
        self.time = 0.0

    def start(self, **parameters: Any) -> None:
        for name, value in parameters.items():
            self.set(name, value)
        if self.two:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()
        self.time = 0.0

    def set(self, name: str, value: Any) -> None:
        kind = self.types[name]
        setter = {
            "Real": "setReal", "Float64": "setFloat64", "Integer": "setInteger", "Int32": "setInt32",
            "Boolean": "setBoolean", "String": "setString",
        }[kind]  # fmt: skip
        getattr(self.fmu, setter)([self.references[name]], [value])

    def get(self, name: str, count: int = 0) -> Any:
        names = [f"{name}[{i}]" for i in range(1, count + 1)] if count else [name]
        kind = self.types[names[0]]
        getter = {
            "Real": "getReal", "Float64": "getFloat64", "Integer": "getInteger", "Int32": "getInt32",
            "Boolean": "getBoolean", "String": "getString",
        }[kind]  # fmt: skip
        found = getattr(self.fmu, getter)([self.references[each] for each in names])
        return np.array(found) if count else found[0]

    def put(self, name: str, values: Any) -> None:
        names = [self.references[f"{name}[{i}]"] for i in range(1, len(values) + 1)]
        (self.fmu.setReal if self.two else self.fmu.setFloat64)(names, [float(value) for value in values])

    def step(self, duration: float) -> bool:
        """Return whether the unit goes on."""
        try:
            answer = self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=duration)
        except fmpy.fmi1.FMICallException as error:
            if not self.two or error.status != fmpy.fmi2.fmi2Discard:
                raise
            return not self.fmu.getBooleanStatus(fmpy.fmi2.fmi2Terminated)
        self.time += duration
        return self.two or not answer[1]


class Made:
    """A unit on the disk."""

    def __init__(self, path: Path, scenario: hs.Scenario, fmi: Any, what: Any) -> None:
        self.path = path / f"{what}{fmi}.fmu"
        self.path.write_bytes(hs.bridges.fmu(scenario, fmi=fmi, what=what))
        self.folder = fmpy.extract(str(self.path))
        self.description = fmpy.read_model_description(str(self.path))

    def instance(self) -> Unit:
        return Unit(self.folder, self.description)


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Any]:
    made: list[Made] = []

    def one(scenario: hs.Scenario, fmi: int, what: str = "loop") -> Made:
        made.append(Made(tmp_path, scenario, fmi, what))
        return made[-1]

    yield one
    for each in made:
        shutil.rmtree(each.folder, ignore_errors=True)


@pytest.mark.parametrize(
    ("fmi", "what", "name"),
    [
        (2, "loop", "real-machine"), (2, "plant", "real-machine"), (2, "controller", "composite-30hz"),
        (3, "loop", "rough-road"), (3, "plant", "composite-30hz"), (3, "controller", "real-machine"),
    ],
)  # fmt: skip
def test_fmpy_finds_no_problem(make: Any, fmi: int, what: str, name: str) -> None:
    made = make(hs.load_scenario(name), fmi, what)
    assert fmpy.validation.validate_fmu(str(made.path)) == []


@pytest.mark.parametrize("law", LAWS)
def test_every_law_is_a_valid_unit_that_starts(make: Any, law: str) -> None:
    made = make(hs.load_scenario("paper").updated({"controller.law": law}), 3)
    assert fmpy.validation.validate_fmu(str(made.path)) == []
    unit = made.instance()
    unit.start()
    assert unit.step(0.01)


def test_the_library_has_every_function_of_the_standard_and_no_other() -> None:
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("nm is not installed")
    expected: set[str] = set()
    for version, pattern in ((2, r"FMI2_Export\s+fmi2(\w+)TYPE\s"), (3, r"FMI3_Export\s+fmi3(\w+)TYPE\s")):
        text = (HEADERS / f"fmi{version}Functions.h").read_text(encoding="utf-8")
        expected |= {f"fmi{version}{name}" for name in re.findall(pattern, text)}
    model_exchange = set(re.findall(r"\bfmi2(?:EnterEventMode|NewDiscreteStates|EnterContinuousTimeMode|"
                                    r"CompletedIntegratorStep|SetTime|SetContinuousStates|GetDerivatives|"
                                    r"GetEventIndicators|GetContinuousStates|GetNominalsOfContinuousStates)\b",
                                    " ".join(expected)))  # fmt: skip
    listed = subprocess.run(
        [nm, "-D", "--defined-only", str(hs.c_library())], capture_output=True, text=True, check=True
    )
    found = {line.split()[-1] for line in listed.stdout.splitlines()}
    assert {name for name in found if name.startswith("fmi")} == expected - model_exchange


def elf_of(made: Made, option: str) -> str:
    """Return what readelf prints of a unit's library."""
    readelf = shutil.which("readelf")
    if readelf is None:
        pytest.skip("readelf is not installed")
    library = Path(made.folder) / "binaries" / "linux64" / "hexservo.so"
    return subprocess.run([readelf, option, str(library)], capture_output=True, text=True, check=True).stdout


def test_a_unit_needs_only_what_every_linux_has(make: Any) -> None:
    listed = elf_of(make(hs.load_scenario("paper"), 2), "-d")
    needed = set(re.findall(r"\(NEEDED\).*\[(.*)\]", listed))
    assert needed <= {"libstdc++.so.6", "libgcc_s.so.1", "libm.so.6", "libc.so.6", "ld-linux-x86-64.so.2"}


def test_a_unit_calls_its_own_core_whatever_a_program_has_loaded(make: Any) -> None:
    """A host may have another release of the library of the C interface, with the same names."""
    listed = elf_of(make(hs.load_scenario("paper"), 2), "-rW")
    assert re.findall(r"\b(?:hexservo|fmi[23])\w+", listed) == []


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", ["paper", "composite-30hz"])
def test_the_loop_is_the_run_bit_for_bit(make: Any, fmi: int, name: str) -> None:
    scenario = hs.load_scenario(name).updated(SHORT)
    run = hs.simulate(scenario.updated({"simulation.log_every": 1}))
    unit = make(scenario, fmi).instance()
    unit.start()
    tick = scenario.simulation.step
    row = 0
    for steps in (0, 1, 1, 7, 20, 1):
        row += steps
        if steps:
            unit.step(steps * tick)
        for quantity, width in (("feature_error", 8), ("position", 3), ("quaternion", 4), ("twist", 6),
                                ("wrench", 6), ("fuzzy_output", 6), ("leg_lengths", 6), ("leg_forces", 6)):  # fmt: skip
            np.testing.assert_array_equal(unit.get(quantity, width), getattr(run, quantity)[row], err_msg=quantity)
        assert unit.get("outcome") == -1
        assert unit.get("end_time") == run.time[row]
    rest = round(scenario.simulation.duration / tick) - row
    unit.step(rest * tick)
    assert unit.get("outcome") == 0
    for metric, value in hs.metrics(run).items():
        np.testing.assert_array_equal(unit.get(f"metric_{metric}"), value, err_msg=metric)


def test_the_loop_of_five_points_is_the_run_to_rounding(make: Any) -> None:
    scenario = five_points()
    run = hs.simulate(scenario)
    unit = make(scenario, 3).instance()
    unit.start()
    widths = {"feature_error": 10, "position": 3, "twist": 6, "wrench": 6, "leg_forces": 6}
    found: dict[str, list[Any]] = {quantity: [] for quantity in widths}
    for row in range(len(run.time)):
        if row:
            unit.step(scenario.simulation.step)
        for quantity, width in widths.items():
            found[quantity].append(unit.get(quantity, width))
    for quantity, values in found.items():
        expected = getattr(run, quantity)
        np.testing.assert_allclose(values, expected, rtol=0, atol=roundings(expected), err_msg=quantity)


def test_what_has_no_effect_is_no_parameter(make: Any) -> None:
    loop = make(hs.load_scenario("paper").updated(SHORT), 2).instance()
    loop.start()
    assert not {"camera.noise", "camera.latency", "actuators.kind", "sensors.noise"} & set(loop.references)
    sampled = make(hs.load_scenario("paper").updated({**SHORT, "simulation.mode": "sampled"}), 2).instance()
    sampled.start()
    assert {"camera.noise", "camera.latency", "actuators.kind", "sensors.noise"} <= set(sampled.references)
    joints = make(hs.load_scenario("rubin-camera-hexapod"), 2).instance()
    joints.start()
    assert {"robot.platform_joints[1,1]", "camera.focal_pixels[1]", "target.points[1,1]"} <= set(joints.references)
    stood_in_for = {f"robot.{side}_{key}" for side in ("platform", "base") for key in ("radius", "angles")}
    stood_in_for |= {"camera.focal_length", "camera.pixel_scale", "target.initial_features", "target.depth"}
    assert not stood_in_for & {name.split("[")[0] for name in joints.references}


@pytest.mark.parametrize("fmi", VERSIONS)
def test_parameters_reset_and_several_instances(make: Any, fmi: int) -> None:
    scenario = hs.load_scenario("paper").updated(SHORT)
    made = make(scenario, fmi)
    changed = {"robot.mass": 0.07, "uncertainty.gravity[3]": 0.05, "controller.switching.kind": "tanh"}
    gravity = np.zeros(6)
    gravity[2] = 0.05
    keys = {"robot.mass": 0.07, "uncertainty.gravity": gravity.tolist(), "controller.switching.kind": "tanh"}
    ends = [hs.simulate(each).position[-1] for each in (scenario, scenario.updated(keys))]
    one, other = made.instance(), made.instance()
    assert one.get("robot.mass") == 0.06
    one.start(**changed)
    other.start()
    for _ in range(2):  # in turns
        for unit in (one, other):
            unit.step(0.1)
    np.testing.assert_array_equal(one.get("position", 3), ends[1])
    np.testing.assert_array_equal(other.get("position", 3), ends[0])
    assert (one.get("robot.mass"), other.get("robot.mass")) == (0.07, 0.06)
    with pytest.raises(Exception, match="fmi"):  # fixed by now
        one.set("robot.mass", 0.08)
    one.fmu.reset()
    assert one.get("robot.mass") == 0.06
    one.start()
    one.step(0.2)
    np.testing.assert_array_equal(one.get("position", 3), ends[0])
    one.fmu.reset()
    with pytest.raises(Exception, match="fmi"):  # a mass that no body has
        one.start(**{"robot.mass": -1.0})


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_plant_is_that_of_custom_controllers_bit_for_bit(make: Any, fmi: int) -> None:
    """Commanded from outside, without a feedback: what the plant does is all that can differ."""
    scenario = hs.load_scenario("composite-30hz").updated({**SHORT, "simulation.log_every": 1})
    rng = np.random.default_rng(20261122)
    ticks = round(scenario.simulation.duration / scenario.simulation.step)
    weight = np.array([0.0, 0.0, -9.81 * scenario.robot.mass, 0.0, 0.0, 0.0])
    wrenches = weight + rng.normal(size=(ticks + 1, 6)) * 1e-3
    run = hs.simulate(scenario, controller=lambda seen: wrenches[seen.tick])
    unit = make(scenario, fmi, "plant").instance()
    unit.start()
    np.testing.assert_array_equal(unit.get("position", 3), run.position[0])
    assert unit.get("outcome") == -1
    for row in range(ticks):
        unit.put("wrench", wrenches[row])
        assert unit.step(scenario.simulation.step)
        np.testing.assert_array_equal(unit.get("feature_error", 8), run.feature_error[row], err_msg=str(row))
        np.testing.assert_array_equal(unit.get("leg_forces", 6), run.leg_forces[row], err_msg=str(row))
        for quantity, width in (("position", 3), ("quaternion", 4), ("twist", 6)):
            np.testing.assert_array_equal(unit.get(quantity, width), getattr(run, quantity)[row + 1], err_msg=quantity)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize(
    ("name", "changes", "command"),
    [
        ("composite-30hz", {}, "wrench"),
        ("real-machine", {}, "wrench"),
        ("pi-h824-positions", {"simulation.duration": 1.0}, "leg_positions"),
        ("reachy-mini-head", MOTORS, "leg_positions"),  # of cranks
    ],
)
def test_plant_and_controller_together_are_the_loop(
    make: Any, fmi: int, name: str, changes: dict[str, Any], command: str
) -> None:
    """The controller ticks first: with what the plant's sensors give it commands what the loop's controller does."""
    scenario = hs.load_scenario(name).updated({**SHORT, **changes})
    points = scenario.target.count
    run = hs.simulate(scenario.updated({"simulation.log_every": 1}))
    plant = make(scenario, fmi, "plant").instance()
    controller = make(scenario, fmi, "controller").instance()
    plant.start()
    controller.start()
    tick = scenario.simulation.step
    for row in range(round(scenario.simulation.duration / tick)):
        for signal, width in (("features", 2 * points), ("depth", points), ("position", 3), ("quaternion", 4),
                              ("twist", 6), ("leg_lengths", 6), ("leg_rates", 6)):  # fmt: skip
            controller.put(signal, plant.get(signal, width))
        controller.set("exposure", plant.get("exposure"))
        controller.step(tick)
        plant.put(command, controller.get(command, 6))
        plant.step(tick)
        np.testing.assert_array_equal(plant.get("feature_error", 2 * points), run.feature_error[row], err_msg=str(row))
        np.testing.assert_array_equal(plant.get("leg_forces", 6), run.leg_forces[row], err_msg=str(row))


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_run_that_fails_terminates_the_unit(make: Any, fmi: int) -> None:
    """Divergence is a result: the unit asks for the end, and its outputs are the last good sample."""
    failing = {"controller.hybrid.kp": 1.0, "simulation.duration": 5.0}
    scenario = hs.load_scenario("paper").updated(failing)
    run = hs.simulate(scenario)
    assert run.outcome == "diverged"
    unit = make(scenario, fmi).instance()
    unit.start()
    assert not unit.step(5.0)
    assert unit.get("outcome") == 1
    assert unit.get("end_time") == run.end_time
    assert unit.get("time") == pytest.approx(run.end_time, rel=1e-12)
    if unit.two:
        successful = unit.fmu.getRealStatus(fmpy.fmi2.fmi2LastSuccessfulTime)
        assert successful == pytest.approx(run.end_time, rel=1e-12)
    np.testing.assert_array_equal(unit.get("position", 3), run.position[-1])
    with pytest.raises(Exception, match="fmi"):
        unit.step(scenario.simulation.step)


@pytest.mark.parametrize(
    ("base", "unit_of_leg", "changes"),
    [
        ("fails-leg-limits", "m", {}),
        ("real-machine", "m/s", {"robot.speed_limit": 0.02, "robot.on_limit": "stop"}),
        ("reachy-mini-head", "rad", {"robot.stroke": 0.05, "robot.on_limit": "stop"}),
    ],
)
def test_the_log_has_the_leg_that_ends_a_run(make: Any, base: str, unit_of_leg: str, changes: dict[str, Any]) -> None:
    """With its limit, its value and the time, as the last event of the core's run has them."""
    scenario = hs.load_scenario(base).updated(changes)
    run = _core.simulate(core_parameters(scenario), load_kernel("baseline"))
    event = run.events[-1]
    assert run.outcome.name == "leg_limit"
    made = make(scenario, 3)
    messages: list[bytes] = []
    unit = Unit(made.folder, made.description, logMessage=lambda *told: messages.append(told[-1]))
    unit.start()
    assert not unit.step(scenario.simulation.duration)
    value = f"{event.peak:.6g} of {event.limit:.6g} {unit_of_leg}"
    assert [text.decode() for text in messages] == [f"the run has ended: leg_limit: {run.detail} ({value})"]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_start_time_is_set_once_and_is_not_negative(make: Any, fmi: int) -> None:
    made = make(hs.load_scenario("paper").updated(SHORT), fmi)

    def begin(unit: Unit, time: float) -> None:
        if unit.two:
            unit.fmu.setupExperiment(startTime=time)
        else:
            unit.fmu.enterInitializationMode(startTime=time)

    unit = made.instance()
    with pytest.raises(Exception, match="fmi"):
        begin(unit, -5.0)
    unit = made.instance()
    unit.start()
    with pytest.raises(Exception, match="fmi"):
        begin(unit, 1.0)  # without a reset
    assert unit.step(0.01)
    with pytest.raises(Exception, match="fmi"):
        unit.step(1000.0005)  # no whole number of ticks


def test_outputs_at_the_start_depend_on_the_parameters(make: Any) -> None:
    for fmi, path in ((2, "ModelStructure/InitialUnknowns/Unknown"), (3, "ModelStructure/InitialUnknown")):
        folder = Path(make(hs.load_scenario("paper"), fmi).folder)
        found = ElementTree.parse(folder / "modelDescription.xml").getroot().findall(path)
        assert found
        assert all("dependencies" not in each.attrib for each in found)


def test_motors_of_cranks_have_the_units_of_cranks(make: Any) -> None:
    made = make(hs.load_scenario("reachy-mini-motors"), 2)
    units = {variable.name.rpartition(".")[2]: variable.unit for variable in made.description.modelVariables
             if variable.name.startswith("actuators.motor.")}  # fmt: skip
    assert units == {
        "kp": "N m/rad", "kv": "N m s/rad", "damping": "N m s/rad", "friction": "N m", "armature": "kg m^2",
        "quantisation": "rad",
    }  # fmt: skip


def parameters(made: Made) -> set[str]:
    """Keys of a unit's parameters."""
    names = {v.name.partition("[")[0] for v in made.description.modelVariables if v.causality == "parameter"}
    assert "robot.mass" in names
    return names


@pytest.mark.parametrize("name", ["paper", "composite-30hz", "pi-h824-positions", "reachy-mini-motors"])
def test_the_parameters_of_a_controller_are_those_of_its_header(make: Any, name: str) -> None:
    scenario = hs.load_scenario(name)
    members = re.findall(r"^  (s|gains)\.([a-z_.]+?)(?:\.(?:emplace|resize)\(.*| <<.*| = .*)$",
                         gains_header(scenario), re.MULTILINE)  # fmt: skip
    header = {member if place == "s" else f"controller.{scenario.controller.law}.{member}" for place, member in members}
    header -= {"metrics.band", "metrics.dwell"}  # which the tick does not use
    found = parameters(make(scenario, 2, "controller"))
    assert found - header == {"target.weights"}  # of 1 each, the header's default
    deciding = {"simulation.mode", "robot.legs", "actuators.kind", "camera.latency_known"}  # which variables there are
    assert not found & deciding
    missing = header - found - deciding
    acting = {key.name for key in tick_keys(core_parameters(scenario))}
    assert found <= acting
    assert all(value_at(scenario, key) is None or key not in acting for key in missing), missing
    assert not found & {"camera.noise", "uncertainty.gravity", "base_motion.kind", "simulation.duration", "seed"}


def test_the_parameters_of_a_plant_act(make: Any) -> None:
    """No law, no drives that take positions, no metrics; the brake acts until the first frame."""
    scenario = hs.load_scenario("composite-30hz").updated({"controller.safe": {"damping": 1.0, "hold": 10.0}})
    found = parameters(make(scenario, 2, "plant"))
    of_controller = {key for key in found if key.startswith("controller.")}
    assert of_controller == {"controller.safe.damping", "controller.safe.hold"}
    assert {"camera.noise", "uncertainty.gravity", "seed", "simulation.substeps"} <= found
    without: dict[str, Any] = {"controller.composite.kp": 2.0, "metrics.band": 3.0, "simulation.duration": 0.5}
    assert not found & {*without, "actuators.kind", "actuators.position.bandwidth", "actuators.motor.kp"}

    def positions(changes: dict[str, Any]) -> Any:
        unit = make(scenario.updated(changes), 2, "plant").instance()
        unit.start()
        unit.put("wrench", [0.01, 0.0, -0.6, 0.0, 0.0, 0.0])
        return [unit.get("position", 3) for _ in range(50) if unit.step(scenario.simulation.step)]

    expected = positions({})
    np.testing.assert_array_equal(positions(without), expected)
    for acting in ({"controller.safe.damping": 3.0}, {"controller.safe.hold": 30.0}):
        assert not np.array_equal(positions(acting), expected), acting


@pytest.mark.parametrize(("name", "own", "others"), [
    ("pi-h824-positions", "actuators.position.bandwidth", "actuators.motor.kp"),
    ("reachy-mini-motors", "actuators.motor.kp", "actuators.position.bandwidth"),
])  # fmt: skip
def test_a_plant_of_legs_that_take_positions_rests_until_it_is_commanded(
    make: Any, name: str, own: str, others: str
) -> None:
    """Its input starts where the legs are. Then it moves as they respond, also before the first image."""
    scenario = hs.load_scenario(name)
    unit = make(scenario, 2, "plant")
    found = parameters(unit)
    assert {own, "uncertainty.gravity", "seed"} <= found
    assert not found & {others, "actuators.hold", "camera.timeout", "controller.safe.damping"}

    def moved(values: dict[str, float]) -> float:
        instance = unit.instance()
        instance.start(**values)
        legs = instance.get("leg_lengths", 6)
        for _ in range(5):
            assert instance.step(scenario.simulation.step)
        sunk = np.abs(instance.get("leg_lengths", 6) - legs).max()
        instance.put("leg_positions", legs + 0.1 * scenario.robot.stroke)
        for _ in range(5):
            assert instance.step(scenario.simulation.step)
        way = float(np.abs(instance.get("leg_lengths", 6) - legs).max())
        assert way > 2.0 * sunk
        return way

    start = value_at(scenario, own)
    assert moved({own: 0.7 * start}) < 0.98 * moved({})


@pytest.mark.parametrize("name", ["composite-30hz", "pi-h824-positions", "reachy-mini-motors"])
@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_plant_that_is_commanded_no_number_diverges(make: Any, fmi: int, name: str) -> None:
    scenario = hs.load_scenario(name).updated(SHORT)
    unit = make(scenario, fmi, "plant").instance()
    unit.start()
    unit.put("wrench" if name == "composite-30hz" else "leg_positions", [np.nan] * 6)
    assert not unit.step(scenario.simulation.step)
    assert unit.get("outcome") == 1


@pytest.mark.parametrize(
    ("name", "changes", "more"),
    [
        ("composite-30hz", {}, {}),
        ("pi-h824-positions", {"camera.latency_known": False}, {"leg_positions": 6, "latency": 3}),
    ],
)
@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_controller_is_the_tick_bit_for_bit(
    make: Any, fmi: int, name: str, changes: dict[str, Any], more: dict[str, int]
) -> None:
    scenario = hs.load_scenario(name).updated({**SHORT, **changes})
    recorded = _core.recorded_ticks(core_parameters(scenario))
    unit = make(scenario, fmi, "controller").instance()
    unit.start()
    for row in range(len(recorded["now"])):
        exposure = recorded["exposure"][row, 0]
        if not np.isnan(exposure):
            unit.set("exposure", exposure)
            unit.put("features", recorded["features"][row])
            unit.put("depth", recorded["depth"][row])
        for given in ("position", "quaternion", "twist", "leg_lengths", "leg_rates"):
            unit.put(given, recorded[given][row])
        unit.step(scenario.simulation.step)
        for output, width in {"wrench": 6, "leg_forces": 6, "fuzzy_output": 6, **more}.items():
            np.testing.assert_array_equal(unit.get(output, width), recorded[output][row], err_msg=f"{output} at {row}")
        assert unit.get("status") == recorded["status"][row, 0]


FAULTS: tuple[Any, ...] = (
    lambda frame: frame["features"].fill(np.nan),
    lambda frame: frame["features"].put(0, np.inf),
    lambda frame: frame["features"].put([2, 3], np.nan),
    lambda frame: np.multiply(frame["features"], 1e6, out=frame["features"]),
    lambda frame: frame["depth"].put(0, np.nan),
    lambda frame: np.negative(frame["depth"], out=frame["depth"]),
    lambda frame: frame.update(exposure=frame["exposure"] + 1.0),  # from the future
    lambda frame: frame.update(exposure=np.nan),
    lambda frame: frame.update(exposure=0.0),
    lambda frame: frame["leg_lengths"].put(0, np.nan),
    lambda frame: np.multiply(frame["leg_lengths"], 3.0, out=frame["leg_lengths"]),
    lambda frame: frame["position"].fill(np.nan),
    lambda frame: frame["quaternion"].fill(0.0),
    lambda frame: frame["twist"].fill(np.inf),
    lambda frame: frame["leg_rates"].fill(np.nan),
)
"""What may be wrong with what a controller is given at a tick."""


@pytest.mark.parametrize("name", ["real-machine", "composite-30hz", "pi-h824-positions", "reachy-mini-motors"])
def test_faulty_inputs_leave_a_controller_the_tick_and_its_outputs_finite(make: Any, name: str) -> None:
    """Frames and readings that are no numbers or wrong, and frames that stop for longer than the timeout."""
    scenario = hs.load_scenario(name).updated({"camera.timeout": 0.5, "camera.latency_jitter": 0.0})
    unit, period = make(scenario, 2, "controller").instance(), scenario.simulation.step
    unit.start()
    controller = hs.Controller(scenario)
    goal = hs.project(scenario, np.zeros(6))
    home = {name: unit.get(name, count) for name, count in (("leg_lengths", 6), ("position", 3), ("quaternion", 4))}
    widths = {"wrench": 6, "leg_forces": 6, "fuzzy_output": 6}
    widths |= {"leg_positions": 6} if scenario.actuators.takes_positions else {}
    rng = np.random.default_rng(20261127)
    frame: dict[str, Any] = {}
    seen, statuses = np.nan, set()
    for tick in range(120):
        given: dict[str, Any] = {key: value.copy() for key, value in home.items()}
        given |= {"twist": 0.01 * rng.normal(size=6), "leg_rates": 0.01 * rng.normal(size=6)}
        if tick % 3 == 0 and not 40 <= tick < 80:
            frame = {"features": goal + rng.normal(size=goal.size), "depth": np.full(goal.size // 2, -0.5)}
            frame["exposure"] = tick * period
        given |= {key: np.copy(value) for key, value in frame.items()}
        if tick and rng.random() < 0.5:  # the joints are known once
            FAULTS[rng.integers(len(FAULTS))](given)
        exposure = float(given.pop("exposure"))
        unit.set("exposure", exposure)
        for key, values in given.items():
            unit.put(key, values)
        assert unit.step(period)
        if np.isnan(exposure) or exposure == seen:  # no new frame
            given |= {"features": None, "depth": None}
        else:
            seen = exposure
        expected = controller.step(**given, exposure=exposure, now=tick * period)
        for key, width in widths.items():
            values = unit.get(key, width)
            assert np.all(np.isfinite(values)), f"{key} at {tick}"
            np.testing.assert_array_equal(values, getattr(expected, key), err_msg=f"{key} at {tick}")
        assert (unit.get("status") == 0) == (expected.status == "valid")
        statuses.add(expected.status)
    assert {"valid", "unusable"} <= statuses


@pytest.mark.parametrize("fmi", VERSIONS)
def test_fmpy_simulates_the_loop(make: Any, fmi: int) -> None:
    scenario = hs.load_scenario("paper").updated(SHORT)
    made = make(scenario, fmi)
    found = fmpy.simulate_fmu(str(made.path), stop_time=0.2, output_interval=0.01, output=["position[1]"])
    run = hs.simulate(scenario)
    np.testing.assert_array_equal(found["position[1]"], run.position[::10, 0])


@pytest.mark.parametrize("fmi", VERSIONS)
def test_outputs_before_the_end_of_the_initialisation_follow_the_parameters(make: Any, fmi: int) -> None:
    scenario = hs.load_scenario("paper")
    unit = make(scenario, fmi).instance()
    before = unit.get("wrench", 6)
    unit.set("robot.mass", 0.07)
    heavier = hs.simulate(scenario.updated({"robot.mass": 0.07, "simulation.duration": 0.001}))
    np.testing.assert_array_equal(before, hs.simulate(scenario.updated({"simulation.duration": 0.001})).wrench[0])
    np.testing.assert_array_equal(unit.get("wrench", 6), heavier.wrench[0])


def test_a_step_costs_little_more_than_the_step_of_a_run(make: Any, tmp_path: Path) -> None:
    """A program in C with the headers of the standard; a ratio of processor times, since the machine may be busy."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler is installed")
    scenario = hs.load_scenario("paper")
    made = make(scenario, 2)
    library = Path(made.folder) / "binaries" / "linux64" / "hexservo.so"
    program = tmp_path / "client"
    places = ["-I", str(HEADERS), "-I", str(Path(__file__).parents[2] / "cpp" / "include")]
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1"]
    shared = hs.c_library().resolve()
    source = [str(Path(__file__).parent / "fmu_client.c"), str(shared), f"-Wl,-rpath,{shared.parent}", "-ldl"]
    built = subprocess.run([compiler, *flags, *places, *source, "-o", str(program)], capture_output=True, text=True,
                           check=False)  # fmt: skip
    assert built.returncode == 0, built.stderr
    names = {v.name: v.valueReference for v in made.description.modelVariables}
    first, count = names["feature_error[1]"], names["leg_forces[6]"] - names["feature_error[1]"] + 1
    steps = 2000
    call = [program, library, made.description.guid, Path(made.folder).as_uri() + "/resources",
            scenario.simulation.step, steps, first, count]  # fmt: skip
    done = subprocess.run([str(word) for word in call], input=flat_text(scenario), capture_output=True, text=True,
                          check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    numbers, times = done.stdout.splitlines()
    run = hs.simulate(scenario.updated({"simulation.duration": steps * scenario.simulation.step}))
    last = [run.feature_error, run.depth, run.position, run.quaternion, run.twist, run.wrench, run.fuzzy_output,
            run.leg_lengths, run.leg_forces]  # fmt: skip
    np.testing.assert_array_equal(
        [float.fromhex(word) for word in numbers.split()], np.concatenate([q[-1] for q in last])
    )
    unit, native = (float(word) for word in times.split())
    print(f"a step of the unit with {count} outputs: {unit:.0f} ns, of a run {native:.0f} ns")
    assert unit < 3.0 * native


def test_rotary_legs_have_angles_and_torques(make: Any) -> None:
    scenario = rotary_machine.machine(SHORT)
    made = make(scenario, 2)
    units = {v.name: v.unit for v in made.description.modelVariables}
    names = ("leg_lengths[1]", "leg_forces[6]", "robot.stroke", "metric_peak_leg_force")
    assert [units[name] for name in names] == ["rad", "N m", "rad", "N m"]
    unit = made.instance()
    unit.start()
    unit.step(scenario.simulation.step * 5)
    run = hs.simulate(scenario.updated({"simulation.log_every": 1}))
    np.testing.assert_array_equal(unit.get("leg_lengths", 6), run.leg_lengths[5])
    np.testing.assert_array_equal(unit.get("leg_forces", 6), run.leg_forces[5])


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("1", {}),
        ("N", {"kg": 1, "m": 1, "s": -2}),
        ("N s/m", {"kg": 1, "s": -1}),
        ("1/(N m)", {"kg": -1, "m": -2, "s": 2}),
        ("(m/s^2)^2/Hz", {"m": 2, "s": -3}),
        ("rad^2/Hz", {"rad": 2, "s": 1}),
        ("px/m", None),
    ],
)
def test_units_are_products_of_the_standards_base_units(unit: str, expected: dict[str, int] | None) -> None:
    assert si_exponents(unit) == expected


def test_units_and_bounds_of_variables_are_those_of_the_table(make: Any) -> None:
    """Of six numbers with two units, the first three have the one and the last three the other."""
    made = make(hs.load_scenario("composite-30hz"), 2, "controller")
    variables = {v.name: v for v in made.description.modelVariables}
    units = {name: v.unit for name, v in variables.items()}
    for key in _core.scenario_keys("composite"):
        if key.type not in ("number", "array"):
            continue
        places = [name for name in units if name.partition("[")[0] == key.name]
        parts = key.unit.split("; ")
        assert len(parts) == 1 or len(places) in (0, 1, 6)
        for index, name in enumerate(places):
            expected = (
                parts[index // 3] if len(places) == 6 and len(parts) == 2 else "" if len(parts) == 2 else key.unit
            )
            assert units[name] == (expected or None), name
            bounds = [bound if bound is None else float(bound) for bound in (variables[name].min, variables[name].max)]
            assert bounds == [key.least, key.most], name
    assert (units["robot.mass"], units["features[1]"], units["wrench[4]"]) == ("kg", "px", "N m")
    of_damping = [units[f"controller.composite.kd[{place}]"] for place in (1, 3, 4, 6)]
    assert of_damping == ["N s/m", "N s/m", "N m s/rad", "N m s/rad"]
    slope = variables["controller.composite.fuzzy.bell_slope"]
    assert (float(slope.min), float(slope.max)) == (0.0, 16.0)
    bases = {unit.name: unit.baseUnit for unit in made.description.unitDefinitions}
    assert (bases["N m"].kg, bases["N m"].m, bases["N m"].s, bases["N m"].rad) == (1, 2, -2, 0)


def test_steps_that_are_no_whole_number_of_ticks_are_refused(make: Any) -> None:
    unit = make(hs.load_scenario("paper"), 2).instance()
    unit.start()
    with pytest.raises(Exception, match="fmi2"):
        unit.step(0.0015)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_calls_out_of_turn_and_at_another_time_are_refused(make: Any, fmi: int) -> None:
    made = make(hs.load_scenario("paper").updated(SHORT), fmi)

    def refused(unit: Unit, call: Any) -> None:
        with pytest.raises(Exception, match="fmi"):
            call(unit)

    unit = made.instance()
    refused(unit, lambda unit: unit.fmu.exitInitializationMode())  # which has not begun
    unit = made.instance()
    unit.start()
    assert unit.step(0.01)
    unit.time = 0.0
    refused(unit, lambda unit: unit.step(0.01))  # the unit is at 0.01 s
    unit.time = 0.01
    refused(unit, lambda unit: unit.step(1e16))  # more ticks than there are numbers for
    assert unit.get("time") == 0.01
    assert unit.step(0.01)
    unit.fmu.terminate()
    refused(unit, lambda unit: unit.step(0.01))
    unit.fmu.reset()
    unit.start()
    assert unit.step(0.01)


def test_a_step_within_which_the_run_ends_returns_early(make: Any) -> None:
    """FMI 3.0: at the last good sample, where the importing tool allows it."""
    scenario = hs.load_scenario("paper").updated({"controller.hybrid.kp": 1.0})
    made, run = make(scenario, 3), hs.simulate(scenario)
    for allowed in (False, True):
        unit = Unit(made.folder, made.description, earlyReturnAllowed=allowed)
        unit.start()
        _, terminates, early, last = unit.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.5)
        assert terminates
        assert early == allowed
        assert last == pytest.approx(run.end_time, rel=1e-12)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_before_its_first_tick_a_controller_holds_the_machine(make: Any, fmi: int) -> None:
    """As at a tick without a frame: of zeros a drive would go to no length, and no force would hold the weight."""
    scenario = hs.load_scenario("pi-h824-positions").updated({"camera.latency_known": False})
    unit = make(scenario, fmi, "controller").instance()
    unit.start()
    names = {"wrench": 6, "leg_forces": 6, "leg_positions": 6, "latency": 3}
    first = {name: unit.get(name, count) for name, count in names.items()}
    assert unit.get("status") == 2  # no image
    assert abs(first["wrench"]).max() > 1.0
    np.testing.assert_array_equal(first["leg_positions"], unit.get("leg_lengths", 6))
    assert first["latency"][2] == 0.25
    assert unit.step(scenario.simulation.step)
    for name, count in names.items():
        np.testing.assert_array_equal(unit.get(name, count), first[name])


@pytest.mark.parametrize("fmi", VERSIONS)
def test_outputs_before_the_first_tick_follow_the_inputs(make: Any, fmi: int) -> None:
    """A master asks for outputs while it finds the inputs of the start: the legs stay where they are."""
    unit = make(hs.load_scenario("pi-h824-positions"), fmi, "controller").instance()
    home = unit.get("leg_positions", 6)
    unit.put("leg_lengths", home + 1e-3)
    np.testing.assert_allclose(unit.get("leg_positions", 6), home + 1e-3, rtol=0.0, atol=1e-12)
    unit.start()
    np.testing.assert_allclose(unit.get("leg_positions", 6), home + 1e-3, rtol=0.0, atol=1e-12)


def test_a_folder_that_is_no_uri_is_named(make: Any) -> None:
    """What is no escape of a URI stands for itself; what cannot be read is logged."""
    made = make(hs.load_scenario("paper"), 2)
    library = ctypes.CDLL(str(next(Path(made.folder).rglob("*.so"))))
    logger = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 2, ctypes.c_int, *[ctypes.c_char_p] * 3)
    messages: list[bytes] = []
    log = logger(lambda *arguments: messages.append(arguments[5]))
    pointers = (ctypes.c_void_p * 5)(ctypes.cast(log, ctypes.c_void_p), None, None, None, None)
    library.fmi2Instantiate.restype = ctypes.c_void_p
    for uri in (b"file:///nope/%zz", b"file:///nope/%2", b"nope", b"file://host"):
        assert library.fmi2Instantiate(b"one", 1, b"", uri, pointers, 0, 0) is None
    print(messages)
    assert len(messages) == 4


def test_instances_of_other_kinds_are_refused_with_a_message(make: Any) -> None:
    made = make(hs.load_scenario("paper"), 3)
    library = ctypes.CDLL(str(next(Path(made.folder).rglob("*.so"))))
    messages: list[bytes] = []
    logger = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
    log = logger(lambda *arguments: messages.append(arguments[3]))
    token, resources = made.description.instantiationToken.encode(), f"{made.folder}/resources/".encode()
    start = (b"one", token, resources, False, False)
    for make_one, more in (
        (library.fmi3InstantiateModelExchange, (None, log)),
        (library.fmi3InstantiateScheduledExecution, (None, log, None, None, None)),
        (library.fmi3InstantiateCoSimulation, (True, False, None, ctypes.c_size_t(0), None, log, None)),
    ):
        make_one.restype = ctypes.c_void_p
        assert make_one(*start, *more) is None
    only = b"expected co-simulation, which is all that this unit has"
    assert messages == [only, only, b"expected eventModeUsed = false: this unit has no event mode"]
    library.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
    one = library.fmi3InstantiateCoSimulation(*start, False, False, None, ctypes.c_size_t(0), None, log, None)
    assert one is not None
    library.fmi3FreeInstance(ctypes.c_void_p(one))


def test_a_refused_duration_is_named(make: Any) -> None:
    unit = make(hs.load_scenario("paper").updated(SHORT), 2).instance()
    unit.set("simulation.duration", 1.0)
    with pytest.raises(Exception, match="fmi2"):
        unit.start(**{"simulation.duration": float("nan")})


def test_units_of_equal_scenarios_are_equal() -> None:
    paper = hs.load_scenario("paper")
    assert hs.bridges.fmu(paper) == hs.bridges.fmu(paper)
    assert hs.bridges.fmu(paper) != hs.bridges.fmu(paper.updated({"robot.mass": 0.07}))


def test_refusals() -> None:
    paper = hs.load_scenario("paper")
    for options, text in (
        ({"fmi": 1}, "fmi: expected 2 or 3"),
        ({"what": "robot"}, "what: expected loop, plant, controller"),
        ({"what": "plant"}, "simulation.mode: expected sampled for a plant"),
    ):
        with pytest.raises(ValueError, match=text):
            hs.bridges.fmu(paper, **options)


def test_a_unit_is_for_the_processor_that_it_is_exported_on(monkeypatch: pytest.MonkeyPatch) -> None:
    paper = hs.load_scenario("paper")
    cases: list[tuple[str, Literal[2, 3], str]] = [
        ("x86_64", 2, "linux64"),
        ("x86_64", 3, "x86_64-linux"),
        ("aarch64", 3, "aarch64-linux"),
    ]
    for machine, fmi, folder in cases:
        monkeypatch.setattr("platform.machine", lambda machine=machine: machine)
        with zipfile.ZipFile(io.BytesIO(hs.bridges.fmu(paper, fmi=fmi))) as archive:
            assert f"binaries/{folder}/hexservo.so" in archive.namelist()
    with pytest.raises(ValueError, match=r"processors of the kind aarch64, got 2; 3 has$"):
        hs.bridges.fmu(paper, fmi=2)
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    with pytest.raises(ValueError, match=r"processors of the kind riscv64, got 3$"):
        hs.bridges.fmu(paper, fmi=3)


def test_the_command_writes_units(tmp_path: Path) -> None:
    file = tmp_path / "paper.fmu"
    call = ["export", "paper", "--fmu", str(file), "--fmi", "3"]
    assert CliRunner().invoke(app, call).exit_code == 0
    assert file.read_bytes() == hs.bridges.fmu(hs.load_scenario("paper"), fmi=3)
    assert CliRunner().invoke(app, call).exit_code == 2
    assert CliRunner().invoke(app, [*call, "--force"]).exit_code == 0
    assert CliRunner().invoke(app, ["export", "paper", "--mjcf", str(tmp_path / "m.xml"), *call[4:]]).exit_code == 2
    file.write_text("notes")
    assert CliRunner().invoke(app, [*call, "--force"]).exit_code == 2
    assert CliRunner().invoke(app, [*call[:3], str(tmp_path / "b.fmu"), "--what", "machine"]).exit_code == 2
