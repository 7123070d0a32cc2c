"""The C interface: programs in C99 and ctypes get the bits that Python gets; misuse is refused with a message."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.run.metrics import METRICS
from hexservo.run.variant import load_kernel
from hexservo.scenario.arrays import Array
from hexservo.scenario.flat import flat, flat_text
from hexservo.scenario.laws import ALL_LAWS, LAWS
from hexservo.scenario.parameters import core_parameters
from points import five_points, roundings, scattered, with_points

HEADER = Path(__file__).parents[2] / "cpp" / "include" / "hexservo.h"
QUANTITIES = (
    "time", "feature_error", "depth", "position", "quaternion", "twist", "wrench", "fuzzy_output", "leg_lengths",
    "leg_forces",
)  # fmt: skip
TICKS = 100_000
OK, REFUSED = 0, 1


@pytest.fixture(scope="module")
def path() -> Path:
    try:
        return hs.c_library()
    except FileNotFoundError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def library(path: Path) -> ctypes.CDLL:
    """The library with the types that are not int."""
    library = ctypes.CDLL(str(path))
    for function in functions():
        getattr(library, function).argtypes = None
    for name in ("scenario_create", "scenario_copy"):
        getattr(library, f"hexservo_{name}").restype = ctypes.c_void_p
    for name in ("version", "scenario_message", "metric_name", "run_detail", "outcome_name"):
        getattr(library, f"hexservo_{name}").restype = ctypes.c_char_p
    library.hexservo_run_advance.restype = ctypes.c_int64
    for name in ("scenario_points", "scenario_key_count", "metric_count", "run_rows", "gains_size", "state_size"):
        getattr(library, f"hexservo_{name}").restype = ctypes.c_size_t
    return library


class Key(ctypes.Structure):
    """`hexservo_key`."""

    _fields_ = (
        ("name", ctypes.c_char_p), ("unit", ctypes.c_char_p), ("type", ctypes.c_int), ("rows", ctypes.c_int),
        ("columns", ctypes.c_int), ("optional", ctypes.c_int), ("sampled", ctypes.c_int),
        ("minimum", ctypes.c_double), ("maximum", ctypes.c_double), ("above", ctypes.c_int), ("below", ctypes.c_int),
        ("choice_count", ctypes.c_size_t), ("choices", ctypes.POINTER(ctypes.c_char_p)),
    )  # fmt: skip


class Handle:
    """A scenario in C."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self.library = library
        self.handle = ctypes.c_void_p(library.hexservo_scenario_create())

    def set(self, key: str, text: str) -> int:
        return int(self.library.hexservo_scenario_set_text(self.handle, key.encode(), text.encode()))

    def get(self, key: str) -> str | None:
        text = ctypes.c_char_p()
        status = self.library.hexservo_scenario_get_text(self.handle, key.encode(), ctypes.byref(text))
        assert (status == OK) == (text.value is not None)
        return None if text.value is None else text.value.decode()

    def message(self) -> str:
        return str(self.library.hexservo_scenario_message(self.handle).decode())

    def validate(self) -> int:
        return int(self.library.hexservo_scenario_validate(self.handle))


@pytest.fixture
def scenario(library: ctypes.CDLL) -> Iterator[Handle]:
    handle = Handle(library)
    yield handle
    library.hexservo_scenario_destroy(handle.handle)


def functions() -> list[str]:
    """Functions that the header declares."""
    return re.findall(r"^HEXSERVO_API [^(]*?\b(hexservo_\w+)\(", HEADER.read_text(encoding="utf-8"), re.MULTILINE)


def test_the_library_has_the_functions_of_the_header_and_those_of_fmi_alone(path: Path) -> None:
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("nm is not installed")
    listed = subprocess.run([nm, "-D", "--defined-only", str(path)], capture_output=True, text=True, check=True).stdout
    names = [line.split()[-1] for line in listed.splitlines()]
    assert sorted(name for name in names if not name.startswith(("fmi2", "fmi3"))) == sorted(functions())


def test_keys_are_those_of_the_table(library: ctypes.CDLL, scenario: Handle) -> None:
    types = ("number", "array", "whole", "flag", "choice", "samples", "seed")
    for law in _core.LAW_TRAITS:
        assert scenario.set("controller.law", law) == OK
        expected = list(_core.scenario_keys(law))
        assert library.hexservo_scenario_key_count(scenario.handle) == len(expected)
        settings = _core.Settings(law)
        for index, key in enumerate(expected):
            found = Key()
            assert library.hexservo_scenario_key(scenario.handle, ctypes.c_size_t(index), ctypes.byref(found))
            assert (found.name.decode(), found.unit.decode()) == (key.name, key.unit)
            assert types[found.type] == key.type
            assert (bool(found.optional), bool(found.sampled)) == (key.optional, key.sampled)
            assert tuple(found.choices[i].decode() for i in range(found.choice_count)) == key.choices
            assert found.minimum == (-np.inf if key.least is None else key.least)
            assert found.maximum == (np.inf if key.most is None else key.most)
            if key.type == "array":
                assert found.rows * found.columns == np.size(np.zeros(key.shape))
            if key.type == "choice":
                assert scenario.get(key.name) == settings[key.name]
        assert not library.hexservo_scenario_key(scenario.handle, ctypes.c_size_t(len(expected)), ctypes.byref(Key()))


@pytest.mark.parametrize("name", hs.scenario_names())
def test_a_packaged_scenario_goes_in_line_by_line_and_reads_back(scenario: Handle, name: str) -> None:
    lines = flat(hs.load_scenario(name))
    for key, value in lines.items():
        assert scenario.set(key, value) == OK, scenario.message()
    assert scenario.validate() == OK, scenario.message()
    for key, value in lines.items():
        text = scenario.get(key)
        assert text is not None
        try:
            assert [float(word) for word in text.split()] == [float(word) for word in value.split()]
        except ValueError:
            assert text == value


def test_misuse_is_refused_with_a_message_and_changes_nothing(library: ctypes.CDLL, scenario: Handle) -> None:
    for key, text, words in (
        ("controller.law", "none such", "controller.law: expected one of hybrid"),
        ("camera.nois", "1", "camera.nois: expected one of the core's keys for the law hybrid"),
        ("camera.noise", "a lot", 'camera.noise: expected a number, got "a"'),
        ("camera.noise", "1 2 3", "camera.noise: expected 1 number, got 3"),
        ("robot.gravity", "9.8", "robot.gravity: expected 3 numbers, got 1"),
        ("robot.inertia", "1e-4", "robot.inertia: expected 3 or 9 numbers, got 1"),
        ("simulation.mode", "slow", "simulation.mode: expected one of continuous, sampled"),
        ("seed", "-1", "seed: expected a whole number from 0 to 2^64 - 1"),
        ("simulation.substeps", "1.5", "simulation.substeps: expected a whole number"),
        ("actuators.saturation", "nan", "actuators.saturation: expected 1 or 0, got nan"),
        ("actuators.saturation", "7", "actuators.saturation: expected 1 or 0, got 7"),
        ("actuators.saturation", "true", 'actuators.saturation: expected 1 or 0, got "true"'),
        ("robot.mass", "+-1", 'robot.mass: expected a number, got "+-1"'),
        ("robot.gravity", "down", 'robot.gravity: expected numbers with spaces between, got "down"'),
        ("camera.timeout", "long", 'camera.timeout: expected a number, or none, got "long"'),
        # what the core has in place of none is no number of a user
        ("camera.period", "0", "camera.period: expected a number > 0, or none, got 0"),
        ("sensors.period", "0", "sensors.period: expected a number > 0, or none, got 0"),
        ("camera.timeout", "inf", "camera.timeout: expected a number > 0, or none, got inf"),
        ("camera.image_size", "inf inf", "camera.image_size: expected a number > 0, or none, got inf"),
    ):
        before = scenario.get(key)
        assert scenario.set(key, text) == REFUSED
        assert words in scenario.message()
        assert scenario.get(key) == before
    assert scenario.set("seed", "18446744073709551615") == OK
    assert scenario.message() == ""
    assert scenario.get("seed") == "18446744073709551615"
    assert scenario.validate() == REFUSED  # four features at the same place
    with pytest.raises(ValueError, match="expected") as error:
        _core.Settings("hybrid").validate()
    assert scenario.message() == str(error.value)
    run = ctypes.c_void_p(1)
    assert library.hexservo_run_create(scenario.handle, ctypes.byref(run)) == REFUSED
    assert run.value is None


def test_an_image_has_both_sides_or_none(scenario: Handle) -> None:
    for key, value in flat(hs.load_scenario("eye-to-hand")).items():
        assert scenario.set(key, value) == OK, scenario.message()
    for size in ("1280 inf", "inf 960"):
        assert scenario.set("camera.image_size", size) == OK
        assert scenario.validate() == REFUSED
        assert scenario.message().startswith("camera.image_size: expected two finite numbers, or none, got ")
    assert scenario.set("camera.image_size", "none") == OK
    assert scenario.validate() == OK


@pytest.mark.parametrize(
    ("start", "source"), [("target.initial_features", "paper"), ("target.points", "false-equilibrium")]
)
def test_a_new_scenario_needs_what_the_page_names(scenario: Handle, start: str, source: str) -> None:
    """A goal, and what the target looks like or is."""
    page = (HEADER.parents[2] / "docs" / "c-interface.md").read_text(encoding="utf-8")
    given = flat(hs.load_scenario(source))
    for key in ("target.desired_features", start):
        assert f"`{key}`" in page
        assert scenario.validate() == REFUSED
        assert scenario.set(key, given[key]) == OK
    assert scenario.validate() == OK, scenario.message()


def test_space_around_a_text_does_not_count(scenario: Handle) -> None:
    for key, text, found in (
        ("simulation.mode", " sampled\r\n", "sampled"),
        ("camera.timeout", "none ", "none"),
        ("seed", "\t7 ", "7"),
        ("camera.noise", " +0.25\n", "0.25"),
    ):
        assert scenario.set(key, text) == OK, scenario.message()
        assert scenario.get(key) == found


def test_names_that_are_no_keys_with_numbers_are_told_apart(library: ctypes.CDLL, scenario: Handle) -> None:
    number = ctypes.c_double(1.0)
    assert library.hexservo_scenario_set_number(scenario.handle, b"controller.law", number) == REFUSED
    assert scenario.message() == "controller.law: expected text, which is the name of a law, got numbers"
    count = ctypes.c_size_t(1)
    for key in (b"target.desired_pose", b"robot.mas"):  # a key of scenario files alone, and none
        asked = library.hexservo_scenario_get_numbers(
            scenario.handle, key, ctypes.c_void_p(), ctypes.c_size_t(0), ctypes.byref(count)
        )
        assert (asked, count.value) == (REFUSED, 0)
        assert scenario.message().startswith(f"{key.decode()}: expected one of the core's keys for the law hybrid, got")


def test_null_pointers_are_refused_with_a_message(library: ctypes.CDLL, scenario: Handle) -> None:
    handle, gravity, nothing = scenario.handle, b"robot.gravity", ctypes.c_void_p()
    assert library.hexservo_scenario_set_numbers(handle, gravity, nothing, ctypes.c_size_t(3)) == REFUSED
    assert scenario.message() == "robot.gravity: expected 3 numbers, got a null pointer"
    assert library.hexservo_scenario_get_numbers(handle, gravity, nothing, ctypes.c_size_t(0), nothing) == OK
    gains = ctypes.c_void_p(1)
    size = ctypes.c_size_t(1 << 20)
    placed = library.hexservo_gains_place(handle, ctypes.c_double(0.0), nothing, size, ctypes.byref(gains))
    assert placed == REFUSED
    assert gains.value is None
    assert scenario.message() == "memory: expected a place for the gains, got a null pointer"


def test_a_run_may_pause_anywhere(library: ctypes.CDLL, scenario: Handle) -> None:
    for key, value in flat(hs.load_scenario("paper")).items():
        assert scenario.set(key, value) == OK
    run = ctypes.c_void_p()
    assert library.hexservo_run_create(scenario.handle, ctypes.byref(run)) == OK
    assert library.hexservo_run_advance(run, ctypes.c_int64(10)) == 10
    assert library.hexservo_run_rows(run) == 11
    assert library.hexservo_run_outcome(run) == -1
    assert library.hexservo_run_detail(run) == b""
    assert library.hexservo_run_advance(run, ctypes.c_int64(0)) == 10
    assert library.hexservo_run_advance(run, ctypes.c_int64(-1)) == 5000
    assert library.hexservo_run_advance(run, ctypes.c_int64(1)) == 5000
    assert library.hexservo_run_rows(run) == 5001
    assert library.hexservo_run_detail(run) == b"ran to the end"
    assert [
        library.hexservo_metric_name(ctypes.c_size_t(i)).decode() for i in range(library.hexservo_metric_count())
    ] == list(METRICS)
    assert library.hexservo_metric_name(ctypes.c_size_t(99)) is None
    library.hexservo_run_destroy(run)


def test_a_plant_without_a_command_is_where_it_starts(library: ctypes.CDLL, scenario: Handle) -> None:
    start = hs.load_scenario("composite-30hz").updated({"simulation.start.twist": [0.01, 0.0, 0.0, 0.0, 0.1, 0.0]})
    for key, value in flat(start).items():
        assert scenario.set(key, value) == OK
    plant = ctypes.c_void_p()
    assert library.hexservo_plant_create(scenario.handle, ctypes.byref(plant)) == OK
    library.hexservo_plant_newest.restype = ctypes.POINTER(ctypes.c_double)
    run = hs.simulate(start.updated({"simulation.duration": 0.001}))
    for index, quantity in enumerate(QUANTITIES):
        expected = np.atleast_1d(getattr(run, quantity)[0])
        found = library.hexservo_plant_newest(plant, index)[: len(expected)]
        forces = quantity in ("wrench", "fuzzy_output", "leg_forces")  # nothing is commanded
        np.testing.assert_allclose(found, 0.0 if forces else expected, rtol=1e-12, err_msg=quantity)
    library.hexservo_plant_destroy(plant)


@pytest.fixture(scope="module")
def client(path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program in C99, without a warning."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler is installed")
    program = tmp_path_factory.mktemp("c") / "client"
    source = Path(__file__).parent / "c_client.c"
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-ffp-contract=off"]
    shared = path.resolve()
    places = ["-I", str(HEADER.parent), str(source), str(shared), f"-Wl,-rpath,{shared.parent}", "-o", str(program)]
    command = [compiler, *flags, *places]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


LAYOUTS = {
    3: {
        "hexservo_key": "name 0 unit 8 type 16 columns 24 optional 28 sampled 32 maximum 48 below 60 choice_count 64 "
        "choices 72 size 80",
        "hexservo_scene": "base_joints 0 platform_joints 144 home_position 288 home_quaternion 312 camera_position 344 "
        "camera_attitude 368 focal 440 camera_on_base 448 size 456",
        "hexservo_gains_memory": "place 0 size 12288",
        "hexservo_state_memory": "place 0 size 36864",
        "hexservo_input": "now 0 exposure 8 features 16 depth 24 position 32 quaternion 56 twist 88 leg_lengths 136 "
        "leg_rates 184 size 232",
        "hexservo_limit_event": "limit 0 leg 4 first_time 8 peak 16 largest 24 size 32",
        "hexservo_output": "wrench 0 leg_forces 48 fuzzy_output 96 status 144 saturated 148 leg_positions 152 "
        "latency 200 size 224",
    }
}  # of each interface, where a pointer has 8 bytes


def test_structs_are_those_of_the_number_of_the_interface(library: ctypes.CDLL, tmp_path: Path) -> None:
    """Only the number shows a program that it was compiled with another layout: change both, or neither."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler is installed")
    text = HEADER.read_text(encoding="utf-8")
    structs = re.findall(r"^typedef struct (\w+) \{\n(.*?)^\} \1;", text, re.DOTALL | re.MULTILINE)
    lines = []
    for name, body in structs:
        members = re.findall(r"(\w+)(?:\[\d+\])*;", re.sub(r"/\*.*?\*/", "", body, flags=re.DOTALL))
        lines += [f'printf("{name}");', *(f'printf(" {m} %zu", offsetof({name}, {m}));' for m in members)]
        lines.append(f'printf(" size %zu\\n", sizeof({name}));')
    source = tmp_path / "layout.c"
    source.write_text(
        "#include <hexservo.h>\n#include <stdio.h>\nint main(void) {\n" + "\n".join(lines) + "\nreturn 0; }\n",
        encoding="utf-8",
    )
    command = [compiler, "-std=c99", "-I", str(HEADER.parent), str(source), "-o", str(tmp_path / "layout")]
    subprocess.run(command, check=True)
    found = subprocess.run([str(tmp_path / "layout")], capture_output=True, text=True, check=True).stdout
    layout = dict(line.split(" ", 1) for line in found.splitlines())
    assert ctypes.sizeof(ctypes.c_void_p) == 8
    assert layout == LAYOUTS[library.hexservo_interface()]
    assert list(LAYOUTS) == [library.hexservo_interface()], "the one number that the header has"


def test_the_program_of_the_page_runs(path: Path, tmp_path: Path) -> None:
    """Built by the page's own line, in a home directory where the library is installed."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler is installed")
    page = (HEADER.parents[2] / "docs" / "c-interface.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    (line,) = re.findall(r"^cc .*$", page, re.MULTILINE)
    (tmp_path / "program.c").write_text(text, encoding="utf-8")
    installed = tmp_path / "hexservo"
    (installed / "lib").mkdir(parents=True)
    (installed / "lib" / "libhexservo.so").symlink_to(path.resolve())
    (installed / "include").symlink_to(HEADER.parent)
    warnings = "-pedantic -Wall -Wextra -Werror -o program"
    home = {**os.environ, "HOME": str(tmp_path)}
    home.pop("LD_LIBRARY_PATH", None)
    subprocess.run(f"{line} {warnings}", shell=True, cwd=tmp_path, env=home, check=True)
    scenario = hs.load_scenario("paper")
    done = subprocess.run(
        [str(tmp_path / "program")], input=flat_text(scenario), capture_output=True, text=True, env=home, check=True
    )
    run = _core.simulate(core_parameters(scenario), load_kernel("baseline"))
    assert done.stdout.endswith(f", final error {run.metrics.final_error:g} px\n"), done.stdout


def test_the_example_of_the_header_runs(path: Path, tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler is installed")
    (example,) = re.findall(r"\*\n((?: \*     .*\n)+) \*\n", HEADER.read_text(encoding="utf-8"))
    body = "\n".join(line.removeprefix(" *") for line in example.splitlines())
    (tmp_path / "program.c").write_text(
        f"#include <hexservo.h>\n#include <stdio.h>\nint main(void) {{\n{body}\nreturn 0; }}\n", encoding="utf-8"
    )
    compile_line = [
        "cc",
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-I{HEADER.parent}",
        "program.c",
        str(path),
    ]
    subprocess.run([*compile_line, "-o", "program"], cwd=tmp_path, check=True)
    done = subprocess.run(
        [str(tmp_path / "program")],
        check=False,
        env={**os.environ, "LD_LIBRARY_PATH": str(path.parent)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, "ran to the end\n")


def numbers(line: str) -> Array:
    return np.array([float.fromhex(word) for word in line.split()[1:]])


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("paper", {}),
        ("paper-gravity", {"controller.law": "composite", "simulation.duration": 0.5}),
        ("fails-gravity", {"simulation.duration": 0.5, "simulation.log_every": 100}),  # legs beyond stroke and force
        ("real-machine", {"simulation.duration": 0.5}),
        ("fails-leg-limits", {}),  # which a leg beyond its stroke ends
        ("pi-h824-positions", {"simulation.duration": 1.0}),
        (
            "reachy-mini-head",
            {
                "simulation.duration": 0.5,
                "actuators.kind": "position_torque",
                "actuators.motor": {"kp": 10.0, "kv": 0.1, "friction": 0.1},
            },
        ),  # N m, rad; cranks
    ],
)
def test_a_program_in_c_and_python_agree_bit_for_bit(client: Path, name: str, changes: dict[str, object]) -> None:
    """The run with all its samples and metrics, plant and controller joined in C, and ticks of the controller."""
    scenario = hs.load_scenario(name).updated(changes)
    ticks = TICKS if name == "paper" else 0
    done = subprocess.run(
        [str(client), str(ticks)], input=flat_text(scenario), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    head, *lines = done.stdout.splitlines()
    run = _core.simulate(core_parameters(scenario), load_kernel("baseline"))
    assert head == f"outcome {run.outcome.name}"
    for quantity, line in zip(QUANTITIES, lines, strict=False):
        expected: Array = getattr(run, quantity)
        assert np.array_equal(numbers(line), expected.ravel(), equal_nan=True), quantity
    metrics = [getattr(run.metrics, metric) for metric in METRICS]
    assert np.array_equal(numbers(lines[len(QUANTITIES)]), metrics, equal_nan=True)
    events = [line for line in lines if line.startswith("event ")]
    assert [numbers(line).tolist() for line in events] == [
        [e.kind.value, e.leg, e.first_time, e.peak, e.limit] for e in run.events
    ]
    assert bool(events) == name.startswith("fails-")
    lines = [line for line in lines if line not in events]
    rows = round(run.end_time / scenario.simulation.step) + 1
    sampled = scenario.simulation.mode == "sampled"
    assert lines[len(QUANTITIES) + 1] == (
        f"{rows} of {rows} ticks are equal"
        if sampled
        else "simulation.mode: expected sampled for a plant that is commanded, got continuous"
    )
    if ticks:
        sums = lines[len(QUANTITIES) + 2 :]
        assert len(sums) == ticks // 100
        assert np.array_equal([numbers(line) for line in sums], ticked(scenario, ticks))


def test_of_five_points_a_program_in_c_and_python_agree_to_rounding(client: Path) -> None:
    scenario = five_points()
    done = subprocess.run([str(client), "0"], input=flat_text(scenario), capture_output=True, text=True, check=True)
    head, *lines = done.stdout.splitlines()
    run = _core.simulate(core_parameters(scenario), load_kernel("baseline"))
    assert head == f"outcome {run.outcome.name}" == "outcome completed"
    for quantity, line in zip(QUANTITIES, lines, strict=False):
        expected: Array = getattr(run, quantity)
        limit = roundings(expected)
        np.testing.assert_allclose(numbers(line), expected.ravel(), rtol=0, atol=limit, err_msg=quantity)
    rows = len(run.time)
    assert lines[len(QUANTITIES) + 1] == f"{rows} of {rows} ticks are equal"  # plant and tick, with the run in C


def room(name: str) -> int:
    """Bytes of a struct of the header that is memory."""
    (count,) = re.findall(rf"double place\[(\d+)\];\n}} hexservo_{name}_memory;", HEADER.read_text(encoding="utf-8"))
    return 8 * int(count)


@pytest.mark.parametrize("points", [4, 16])
@pytest.mark.parametrize("law", ALL_LAWS)
def test_the_memory_structs_suffice(library: ctypes.CDLL, scenario: Handle, law: str, points: int) -> None:
    changes: dict[str, object] = {"controller.law": law, "camera.latency": 0.2, "camera.latency_jitter": 0.056}
    changes |= {"camera.period": 0.064, "uncertainty.depth": 0.0}
    if law not in LAWS:  # of machines that take positions
        changes |= {"actuators.kind": "position", "camera.prediction": "none", "camera.on_lost": "hold"}
        changes |= {"camera.latency_known": False, "camera.latency_jitter": 0.05}  # no longer one is accepted
    name = "real-machine" if law in LAWS else "composite-30hz"
    asked = with_points(hs.load_scenario(name), scattered(points), **changes)
    for key, text in flat(asked).items():
        assert scenario.set(key, text) == OK, scenario.message()
    gains = ctypes.c_void_p()
    status = library.hexservo_gains_create(scenario.handle, ctypes.c_double(0.0), ctypes.byref(gains))
    assert status == OK, scenario.message()
    needed = library.hexservo_gains_size(scenario.handle), library.hexservo_state_size(gains)
    library.hexservo_gains_destroy(gains)
    print(f"{law}, {points} points: {needed[0]} and {needed[1]} bytes")
    assert 0 < needed[0] <= room("gains")
    assert 0 < needed[1] <= room("state")


@pytest.mark.parametrize(
    ("key", "value"), [("camera.timeout", "0.1"), ("camera.on_lost", "stop"), ("sensors.pose", "encoders")]
)
def test_gains_of_a_continuous_scenario_have_no_key_that_does_not_act(
    library: ctypes.CDLL, scenario: Handle, key: str, value: str
) -> None:
    """A timeout that does nothing is no guard against a camera that is gone."""
    for name, text in flat(hs.load_scenario("paper")).items():
        assert scenario.set(name, text) == OK, scenario.message()
    gains = ctypes.c_void_p()
    create = [scenario.handle, ctypes.c_double(0.0), ctypes.byref(gains)]
    assert library.hexservo_gains_create(*create) == OK, scenario.message()
    library.hexservo_gains_destroy(gains)
    assert scenario.set(key, value) == OK
    assert library.hexservo_gains_create(*create) != OK
    assert gains.value is None
    assert scenario.message().startswith(f"{key}: expected its default in continuous mode, where it has no effect")
    assert scenario.set("simulation.mode", "sampled") == OK
    assert scenario.set("camera.noise", "0.1") == OK
    assert library.hexservo_gains_create(*create) == OK, scenario.message()
    library.hexservo_gains_destroy(gains)


def ticked(scenario: hs.Scenario, ticks: int) -> list[Array]:
    """What the C program prints of its ticks, from the Python module."""
    period = scenario.simulation.step
    controller = _core.Controller(core_parameters(scenario), period)
    features = np.array(scenario.target.initial_features, dtype=float)
    depth, position, twist = np.full(4, -0.5), np.array([0.0, 0.0, -0.15]), np.zeros(6)
    total, sums = np.zeros(18), []
    for k in range(ticks):
        sway = (k % 1000 - 500) / 1048576.0
        features[0] += sway
        position[1] = sway
        twist[0] = 2.0 * sway
        now = k * period
        wrench, leg_forces, fuzzy_output, status, *_ = controller.step(
            features, depth, position, [1.0, 0.0, 0.0, 0.0], twist, None, None, now, now
        )
        assert status == _core.InputStatus.valid
        total = 0.5 * total + np.concatenate([wrench, leg_forces, fuzzy_output])
        if k % 100 == 99:
            sums.append(total)
    return sums
