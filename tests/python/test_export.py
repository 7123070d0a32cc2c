"""Gains as a C++ header: what is in it, bit for bit, and that a file is written whole, or not at all, over nothing."""

from __future__ import annotations

import os
import re
import resource
import shutil
import stat
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli import commands as cli
from hexservo.findings.check_export import robot_notes
from hexservo.run import publish
from hexservo.run.export import C_NAMES, TITLE, gains_header
from hexservo.run.files import write_file
from hexservo.run.publish import OutputError
from hexservo.scenario.laws import ALL_LAWS, LAWS
from hexservo.scenario.parameters import core_parameters

ROOT = Path(__file__).resolve().parents[2]
EIGEN = next((path for path in map(Path, ("/usr/include/eigen3", "/usr/local/include/eigen3")) if path.exists()), None)

# What the header has to bring to C++: everything but the plant's errors and the run's grid.
SHARED = [
    *(f"robot.{name}" for name in ("platform_radius", "base_radius", "platform_angles", "base_angles")),
    *(f"robot.{name}" for name in ("home_position", "home_attitude", "legs", "gravity")),
    *(f"robot.{name}" for name in ("mass", "inertia", "stroke", "stroke_centre", "force_limit", "centre_of_mass")),
    *(f"robot.payload.{name}" for name in ("mass", "position", "inertia", "known")),
    *("camera.focal_length", "camera.pixel_scale", "camera.mount.position", "camera.mount.rotation"),
    "camera.mount.on",
    *("camera.axes", "camera.convention", "target.desired_features"),
    *("controller.jacobian", "controller.switching.kind", "controller.switching.width", "uncertainty.depth"),
    *("uncertainty.mount.position", "uncertainty.mount.rotation"),
    *("simulation.mode", "simulation.step", "metrics.band", "metrics.dwell"),
]
FUZZY = [
    *("gains.kp", "gains.kv"),
    *(f"gains.fuzzy.{name}" for name in ("enabled", "adaptation", "error_scale", "rate_scale", "initial_scale")),
    *(f"gains.fuzzy.{name}" for name in ("table", "bell_width", "bell_slope")),
    *(f"gains.fuzzy.{name}" for name in ("leakage", "weight_limit", "dead_zone")),
]
OWN = {
    "hybrid": FUZZY,
    "composite": [*FUZZY, "gains.kt", "gains.kd", "gains.drive", "gains.prior"],
    "kelly": ["gains.kp", "gains.kd"],
    "resolved_rate": [
        *("gains.gain", "gains.adaptive", "gains.gain_far", "gains.gain_slope"),
        *("gains.jacobian_at", "gains.ki", "gains.damping"),
    ],
    "pbvs": ["gains.kp", "gains.kd", "gains.prior"],
    "computed_torque": ["gains.kp", "gains.kd", "gains.prior"],
}
MEMBERS = {law: [*SHARED, *own] for law, own in OWN.items()}


def run(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(cli.app, ["export", *arguments], prog_name="hexservo")
    return result.exit_code, result.stdout, result.stderr


def uncommon(paper: hs.Scenario, law: str) -> hs.Scenario:
    """No number of it is a default or has few digits."""
    random = np.random.default_rng(20)

    def about(*values: float) -> list[float]:
        return [float(value * random.uniform(0.9, 1.1)) for value in values]

    initial = about(30, 18, 65, -65, -44, 37, -10, -15)
    goal = about(10, 10, 45, -73, -64, 29, -30, -23)
    if law == "pbvs":  # which needs the image of a pose as its goal: next to a rotation, whatever the depths
        goal = [value + shift for value, shift in zip(initial, about(-20, -8) * 4, strict=True)]
    (radius, mass, stroke, limit, focal, scale, width, bell, slope) = about(0.1, 0.06, 0.02, 2, 0.01, 7e4, 0.02, 0.2, 3)
    return paper.updated(
        {
            "name": "2nd-one..ü",
            "robot.platform_radius": radius,
            "robot.base_radius": 2.1 * radius,
            "robot.platform_angles": about(-0.8, 0.9, 1.2, 3.0, 3.3, 5.0),
            "robot.base_angles": about(-0.2, 0.2, 1.9, 2.3, 4.0, 4.4),
            "robot.home_position": [0.001, -1 / 3e3, -0.16],
            "robot.home_attitude": [0.01, -1 / 70, 0.03],
            "robot.gravity": [0.1, -1 / 3, 9.7],
            "robot.mass": mass,
            "robot.inertia": [[1.5e-4, 1e-6, 2e-6 / 3], [1e-6, 1.6e-4, -1e-6], [2e-6 / 3, -1e-6, 2.9e-4]],
            "robot.stroke": stroke,
            "robot.stroke_centre": 0.1 * stroke,
            "robot.centre_of_mass": [1e-3 / 3, -2e-3 / 7, 1e-3 / 9],
            "robot.payload": {
                "mass": 0.1 * mass,
                "position": [0.01 / 3, 0.02 / 7, -0.01 / 9],
                "inertia": [1e-6 / 3] * 3,
            },
            "robot.force_limit": limit,
            "camera.focal_length": focal,
            "camera.pixel_scale": scale,
            "camera.convention": "eye_in_hand" if law == "pbvs" else "as_printed",
            **(
                {
                    "camera.mount": {"position": about(0.01, 0.02, -0.03), "rotation": about(0.1, -0.2, 0.3)},
                    "uncertainty.mount": {"position": about(1e-3, 2e-3, 3e-3), "rotation": about(0.01, 0.02, 0.03)},
                }
                if law == "pbvs"
                else {}
            ),
            "target.initial_features": initial,
            "target.desired_features": goal,
            "target.depth": about(0.5, 0.6, 0.5, 0.4),
            "controller.law": law,
            "metrics.band": 2 / 3,
            "metrics.dwell": 1 / 7,
            "controller.jacobian": "printed",
            "controller.switching": {"kind": "saturation", "width": width},
            **{
                f"controller.{fuzzy}.{key}": value
                for fuzzy in ("hybrid", "composite")
                for key, value in {
                    "kp": about(*[1e-6] * 8),
                    "kv": about(*[2e-3] * 3, *[1e-4] * 3),
                    "fuzzy": {
                        "enabled": False,
                        "adaptation": about(*[10] * 6),
                        "error_scale": about(*[5] * 6),
                        "rate_scale": about(*[0.5] * 6),
                        "initial_scale": about(*[-0.1] * 6),
                        "table": [about(*[1] * 7) for _ in range(7)],
                        "bell_width": bell,
                        "bell_slope": slope,
                        "leakage": about(*[0.1] * 6),
                        "weight_limit": about(*[0.5] * 6),
                        "dead_zone": about(*[1e-3] * 6),
                    },
                }.items()
            },
            "controller.composite.kt": about(*[6] * 3, *[0.02] * 3),
            "controller.composite.kd": about(*[1] * 3, *[3e-3] * 3),
            "controller.composite.drive": about(*[4] * 6),
            "controller.composite.prior": about(*[1e4] * 3, *[1600] * 3),
            "controller.kelly": {"kp": about(*[1e-6] * 8), "kd": about(*[1] * 3, *[3e-3] * 3)},
            "controller.resolved_rate": {
                **dict(zip(("gain", "gain_far", "gain_slope"), about(7, 3, 2), strict=True)),
                "adaptive": True,
                "jacobian_at": "current",
                "ki": about(*[6] * 3, *[0.02] * 3),
                "damping": about(*[10] * 6),
            },
            "controller.pbvs": {
                "kp": about(*[20] * 3, *[0.1] * 3),
                "kd": about(*[2] * 3, *[0.01] * 3),
                "prior": about(*[400] * 3, *[60] * 3),
            },
            "controller.computed_torque": {
                "kp": about(*[400] * 6),
                "kd": about(*[40] * 6),
                "prior": about(*[1e4] * 3, *[1600] * 3),
            },
        }
    )


# ---- What is in it --------------------------------------------------------------------------------------------------


def test_the_example_has_what_the_command_writes_today(paper: hs.Scenario) -> None:
    checked_in = (ROOT / "examples" / "gains.hpp").read_text(encoding="utf-8")
    assert checked_in == gains_header(paper), "run: hexservo export paper --header examples/gains.hpp --force"


def test_the_head_says_what_it_is_and_no_date(paper: hs.Scenario) -> None:
    first, second, *_ = gains_header(paper, 5e-4).splitlines()
    assert first == "// hexservo gains, format 1"
    assert f'"{paper.name}"' in second
    assert hs.__version__ in second
    assert '\ninline constexpr const char* scenario_name = "paper";\n' in gains_header(paper)
    assert gains_header(paper) == gains_header(hs.load_scenario("paper"))
    assert "inline constexpr double period = 0.0005;" in gains_header(paper, 5e-4)


@pytest.mark.skipif(shutil.which("g++") is None or EIGEN is None, reason="needs g++ and Eigen, as building does")
def test_the_example_takes_the_header_of_the_folder_that_is_named(paper: hs.Scenario, tmp_path: Path) -> None:
    """And not the one that is beside its source."""
    header = tmp_path / "gains.hpp"
    header.write_text(gains_header(paper), encoding="utf-8")
    folders = ["-I", str(tmp_path), "-I", str(ROOT / "cpp" / "include"), "-isystem", str(EIGEN)]
    command = ["g++", "-std=c++20", "-MM", *folders, str(ROOT / "examples" / "servo.cpp")]
    found = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    assert [word for word in found if word.endswith("gains.hpp")] == [str(header)]


@pytest.mark.parametrize("name", ["reachy-mini-head", "real-machine", "pi-h824-positions"])
def test_a_header_has_what_settling_is_judged_by(name: str) -> None:
    """Numbers that differ from the defaults of the core, which stand in for a missing line."""
    scenario = hs.load_scenario(name).updated({"metrics.band": 0.7, "metrics.dwell": 0.3})
    judged = [line for line in gains_header(scenario).splitlines() if line.startswith("  s.metrics.")]
    assert judged == ["  s.metrics.band = 0.7;  // [px]", "  s.metrics.dwell = 0.3;  // [s]"]


@pytest.mark.parametrize("law", MEMBERS)
def test_every_assignment_says_its_unit(paper: hs.Scenario, law: str) -> None:
    header = gains_header(paper.updated({"controller.law": law}))
    assigned = [line for line in header.splitlines() if line.startswith(("  s.", "  gains."))]
    assert len(assigned) == len(MEMBERS[law]) + 2  # and what is seen from home
    for line in assigned:
        plain = "hexservo::" in line or line.endswith((" = true;", " = false;"))
        assert plain or re.search(r"// \[[^\]]+\]$", line), line


@pytest.mark.parametrize(
    ("name", "identifier"),
    [
        ("paper", "hexservo_paper"),
        ("paper-no-fuzzy", "hexservo_paper_no_fuzzy"),
        ("a--b__c.-d", "hexservo_a_b_c_d"),
        ("2nd", "hexservo_2nd"),
        ("double", "hexservo_double"),
        ("ü", "hexservo"),
        ("gains", "hexservo_gains_scenario"),  # a struct of hexservo.h
        ("run-rows", "hexservo_run_rows_scenario"),  # a function
        ("scenario", "hexservo_scenario_scenario"),
        ("gains-2", "hexservo_gains_2"),
    ],
)
def test_the_namespace_is_the_scenario_as_cpp_allows_it(paper: hs.Scenario, name: str, identifier: str) -> None:
    text = gains_header(paper.updated({"name": name}))
    assert f"\nnamespace {identifier} {{\n" in text


def test_no_namespace_is_a_name_of_the_c_interface() -> None:
    header = (ROOT / "cpp" / "include" / "hexservo.h").read_text(encoding="utf-8")
    assert set(re.findall(r"\bhexservo_(\w+)", header)) == C_NAMES


CASES = [("hybrid", False), *((law, law in ("hybrid", "pbvs")) for law in MEMBERS)]
QUICK = [("hybrid", False), ("pbvs", True)]
SLOW = [case for case in CASES if case not in QUICK]
PROGRAM = """#include <cstdio>
#include <cstdlib>
template <class T>
void show(const char* name, const T& value) {
  std::printf("%s", name);
  if constexpr (requires { value.rows(); }) {
    for (Eigen::Index i = 0; i < value.rows(); ++i)
      for (Eigen::Index k = 0; k < value.cols(); ++k) std::printf(" %a", double(value(i, k)));
  } else {
    std::printf(" %a", double(value));
  }
  std::printf("\\n");
}
"""


def exported(paper: hs.Scenario, law: str, points: bool) -> tuple[hs.Scenario, list[str]]:
    """An uncommon scenario, and the keys of what it sees."""
    scenario = uncommon(paper, law).updated({"name": f"2nd-one..ü-{law}{'-points' if points else ''}"})
    if not points:
        return scenario, ["target.initial_features", "target.depth"]
    where = [[0.03, 0.02, -0.61], [0.05, -1 / 17, -0.65], [-0.04, 0.03, -0.7], [-0.01, -0.02, -0.6]]
    changes: dict[str, Any] = {"target.initial_features": None, "target.depth": None, "target.points": where}
    turn = Rotation.from_rotvec(scenario.robot.home_attitude)
    rays = turn.inv().apply(np.asarray(where) - scenario.robot.home_position)
    f = scenario.camera.focal_length * scenario.camera.pixel_scale
    changes["target.desired_features"] = (-f * rays[:, :2] / rays[:, 2:] + [-20 / 3, -8 / 7]).ravel().tolist()
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    for side, placed in (("platform", hexapod.platform_joints), ("base", hexapod.base_joints)):
        changes |= {f"robot.{side}_joints": placed, f"robot.{side}_radius": None, f"robot.{side}_angles": None}
    scenario = scenario.updated({**changes, "camera.convention": "eye_in_hand"})
    return scenario, ["target.points", "robot.platform_joints", "robot.base_joints"]


@pytest.fixture(scope="module", params=[QUICK, pytest.param(SLOW, marks=pytest.mark.slow)], ids=["quick", "slow"])
def reader(
    request: pytest.FixtureRequest, paper: hs.Scenario, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[tuple[str, bool]]]:
    """A program that includes the headers of some cases and prints the numbers of the one that it is asked for."""
    folder = tmp_path_factory.mktemp("reader")
    includes, calls = "", ""
    for index, (law, points) in enumerate(request.param):
        scenario, seen = exported(paper, law, points)
        header = gains_header(scenario, 1 / 1700)
        write_file(header, folder / f"gains{index}.hpp", TITLE, "hexservo export")
        includes += f'#include "gains{index}.hpp"\n'
        namespace = header.split("#define HEXSERVO_GAINS ")[1].split("\n")[0]
        place = {name: f"*s.{name}" for name in seen if "joints" in name or "points" in name} | {
            name: name for name in OWN[law]
        }
        shows = "".join(f'    show("{name}", {place.get(name, f"s.{name}")});\n' for name in MEMBERS[law] + seen)
        calls += f"""  if (std::atoi(arguments[1]) == {index}) {{
    const auto s = {namespace}::settings();
    [[maybe_unused]] const auto& gains = s.gains<{namespace}::Law>();
    show("period", {namespace}::period);
{shows}  }}
"""
    program = f"{includes}{OTHER_FLAGS}\n{PROGRAM}int main(int, char** arguments) {{\n{calls}}}\n"
    (folder / "main.cpp").write_text(program, encoding="utf-8")
    return compiled(folder, "main.cpp"), request.param


# of the library, which is not linked here
OTHER_FLAGS = (
    "template <int, int, int, std::size_t, std::size_t, bool> "
    "bool hexservo::library_was_built_with_other_flags() noexcept { return false; }"
)


def compiled(folder: Path, *sources: str) -> Path:
    core = ROOT / "cpp"
    headers = ["-I", str(core / "include"), "-isystem", str(EIGEN)]
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-psabi"]
    command = ["g++", "-std=c++20", *warnings, *headers, *sources, str(core / "src" / "fuzzy.cpp"), "-o", "main"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "main"


@pytest.mark.skipif(shutil.which("g++") is None or EIGEN is None, reason="needs g++ and Eigen, as building does")
def test_cpp_reads_every_number_back_bit_for_bit(
    paper: hs.Scenario, reader: tuple[Path, list[tuple[str, bool]]]
) -> None:
    program, cases = reader
    for index, (law, points) in enumerate(cases):
        scenario, seen = exported(paper, law, points)
        output = subprocess.run([program, str(index)], check=True, capture_output=True, text=True).stdout
        read = {name: [float.fromhex(text) for text in texts] for name, *texts in map(str.split, output.splitlines())}
        settings = core_parameters(scenario)
        assert read.pop("period") == [1 / 1700]
        assert set(read) == {*MEMBERS[law], *seen}
        settings["simulation.step"] = 1 / 1700
        choices = {key.name: key.choices for key in _core.scenario_keys(law)}
        for member, numbers in read.items():
            key = member.replace("gains.", f"controller.{law}.", 1)
            value = settings[key]
            value = choices[key].index(value) if isinstance(value, str) else value
            assert numbers == np.ravel(value).tolist(), (law, points, member)


def of_one_namespace(paper: hs.Scenario) -> list[str]:
    """Headers of two scenarios whose names are one namespace, with other gains and another period."""
    one = paper.updated({"name": "a-b", "controller.hybrid.kp": 1e-6})
    return [gains_header(one), gains_header(one.updated({"name": "a_b", "controller.hybrid.kp": 2e-6}), 5e-4)]


def test_headers_of_one_namespace_have_different_symbols(paper: hs.Scenario) -> None:
    first, second = of_one_namespace(paper)
    inner = [re.findall(r"^inline namespace (\w+) \{", text, re.MULTILINE) for text in (first, second)]
    assert [len(names) for names in inner] == [1, 1]
    assert inner[0] != inner[1]
    assert all("\nnamespace hexservo_a_b {\n" in text for text in (first, second))
    assert (first, second) == tuple(of_one_namespace(paper))  # nothing of the time or the place of an export


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_two_headers_of_one_namespace_in_one_file_are_refused(paper: hs.Scenario, tmp_path: Path) -> None:
    (tmp_path / "hexservo").mkdir()
    (tmp_path / "hexservo" / "controller.hpp").touch()  # the preprocessor decides
    for name, text in zip(("a.hpp", "b.hpp"), of_one_namespace(paper), strict=True):
        (tmp_path / name).write_text(text, encoding="utf-8")

    def errors(*names: str) -> list[str]:
        file = "".join(f'#include "{name}"\n' for name in names)
        command = ["g++", "-E", "-x", "c++", "-I", str(tmp_path), "-o", "/dev/null", "-"]
        done = subprocess.run(command, cwd=tmp_path, input=file, capture_output=True, text=True, check=False)
        return re.findall("#error (.*)", done.stderr)[:1]

    assert errors("a.hpp", "a.hpp") == []
    words = '"two headers of hexservo export with the namespace hexservo_a_b: rename one of the scenarios"'
    assert errors("a.hpp", "b.hpp") == [words]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None or EIGEN is None, reason="needs g++ and Eigen, as building does")
def test_two_headers_of_one_namespace_in_one_program_keep_their_gains(paper: hs.Scenario, tmp_path: Path) -> None:
    for name, text in zip("ab", of_one_namespace(paper), strict=True):
        (tmp_path / f"{name}.hpp").write_text(text, encoding="utf-8")
        function = f"""double {name}() {{
  return hexservo_a_b::settings().gains<hexservo_a_b::Law>().kp[0] / hexservo_a_b::period;
}}
"""
        (tmp_path / f"{name}.cpp").write_text(f'#include "{name}.hpp"\n{OTHER_FLAGS}\n{function}', encoding="utf-8")
    program = '#include <cstdio>\ndouble a();\ndouble b();\nint main() { std::printf("%a %a", a(), b()); }\n'
    (tmp_path / "main.cpp").write_text(program, encoding="utf-8")
    run = compiled(tmp_path, "main.cpp", "a.cpp", "b.cpp")
    printed = subprocess.run([run], check=True, capture_output=True, text=True).stdout
    assert [float.fromhex(text) for text in printed.split()] == [1e-6 / paper.simulation.step, 2e-6 / 5e-4]


# ---- The command ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "gains"),
    [
        *((law, {}) for law in ALL_LAWS),
        *(("resolved_rate", {"jacobian_at": at}) for at in ("desired", "mean")),
        ("tracking", {"follow": "direction"}),
    ],
)
def test_an_error_of_depth_is_noted_where_it_changes_what_the_controller_commands(
    paper: hs.Scenario, law: str, gains: dict[str, str]
) -> None:
    """At one tick, away from the goal, bit for bit; the image has the true depths, as on a robot."""
    changes: dict[str, Any] = {"controller.law": law}
    changes |= {f"controller.{law}.{key}": value for key, value in gains.items()}
    if law not in LAWS:
        changes |= {"simulation.mode": "sampled", "actuators.kind": "position", "camera.noise": 0.1}
    scenario = paper.updated(changes)
    features = hs.project(scenario, np.zeros(6)) + 3.0
    legs = hs.simulate(scenario.updated({"simulation.duration": 0.01})).leg_lengths[0]
    commands = []
    for depth in (0.0, 0.3):
        controller = hs.Controller(scenario.updated({"uncertainty.depth": depth}))
        home = (scenario.robot.home_position, [1.0, 0.0, 0.0, 0.0], np.zeros(6))
        for _ in range(20):  # a motion towards the target begins at rest
            out = controller.step(features, np.full(4, -0.5), *home, leg_lengths=legs)
        commands.append(np.array([*out.wrench, *out.leg_forces, *([] if law in LAWS else out.leg_positions)]))
    noted = any("uncertainty.depth" in note for note in robot_notes(scenario.updated({"uncertainty.depth": 0.3})))
    assert noted == (not np.array_equal(commands[0], commands[1], equal_nan=True))


@pytest.mark.parametrize(("what", "notes"), [("controller", 1), ("loop", 0)])
def test_a_unit_of_the_controller_has_the_notes_of_the_header(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, notes: int
) -> None:
    monkeypatch.setattr("hexservo.bridges.fmi.fmu", lambda scenario, fmi, what: b"")  # the compiled core is not needed
    code, out, error = run("real-machine", "--fmu", str(tmp_path / "unit.fmu"), "--what", what)
    assert (code, error) == (0, "")
    first, *rest = out.splitlines()
    assert first.endswith(f'unit.fmu: {what} of the scenario "real-machine" as a unit of FMI 2.0')
    assert rest == [f"Note: {note}." for note in robot_notes(hs.load_scenario("real-machine"))[:notes]]


def test_export_writes_refuses_and_replaces(paper: hs.Scenario, tmp_path: Path) -> None:
    header = tmp_path / "gains.hpp"
    code, out, error = run("paper", "--header", str(header))
    assert (code, error) == (0, "")
    first, *notes = out.splitlines()
    assert first == f'{header}: gains of the scenario "paper" for a period of 1 ms'
    assert notes == [f"Note: {note}." for note in robot_notes(paper)]
    assert header.read_text(encoding="utf-8") == gains_header(paper)

    changed = ("paper", "--header", str(header), "--set", "controller.hybrid.kp=2e-6", "--period", "5e-4")
    code, out, error = run(*changed)
    assert (code, out) == (2, "")
    assert error.startswith("Error: ")
    assert "--force" in error
    assert header.read_text(encoding="utf-8") == gains_header(paper)

    header.chmod(0o640)
    code, out, error = run(*changed, "--force")
    assert (code, error) == (0, "")
    assert header.read_text(encoding="utf-8") == gains_header(paper.updated({"controller.hybrid.kp": 2e-6}), 5e-4)
    assert stat.S_IMODE(header.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [header]


@pytest.mark.parametrize("content", [b"", b"int main() {}\n", b"// hexservo gains, format 12\n", b"\xff" * 5000])
def test_force_keeps_what_export_did_not_write(tmp_path: Path, content: bytes) -> None:
    header = tmp_path / "gains.hpp"
    header.write_bytes(content)
    for force in ([], ["--force"]):
        code, _, error = run("paper", "--header", str(header), *force)
        assert code == 2
        assert "not written by hexservo export, so it is kept" in error
        assert header.read_bytes() == content
    assert list(tmp_path.iterdir()) == [header]


def test_places_where_no_header_can_be(paper: hs.Scenario, tmp_path: Path) -> None:
    text = gains_header(paper)
    (tmp_path / "folder").mkdir()
    write_file(text, tmp_path / "other.hpp", TITLE, "hexservo export")
    (tmp_path / "link.hpp").symlink_to("other.hpp")
    (tmp_path / "dangling.hpp").symlink_to("nowhere")
    os.mkfifo(tmp_path / "pipe")
    for name, words in [
        ("folder", "got a folder"),
        ("link.hpp", "got a symbolic link"),
        ("dangling.hpp", "got a symbolic link"),
        ("pipe", "got something else"),
        ("missing/gains.hpp", "expected a folder that exists"),
        ("other.hpp/gains.hpp", "cannot|Not a directory"),
        ("..", "expected the name of a file"),
        ("x" * 300, "File name too long"),
        ("a\0b", "null"),
    ]:
        with pytest.raises(OutputError, match=words) as caught:
            write_file(text, tmp_path / name, TITLE, "hexservo export", force=True)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(OutputError, match="expected a path, got an empty one"):
        write_file(text, "", TITLE, "hexservo export")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "dangling.hpp",
        "folder",
        "link.hpp",
        "other.hpp",
        "pipe",
    ]


@pytest.mark.parametrize("force", [False, True])
def test_nothing_is_left_of_a_full_disk(paper: hs.Scenario, tmp_path: Path, force: bool) -> None:
    header = tmp_path / "gains.hpp"
    if force:
        write_file(gains_header(paper, 0.5), header, TITLE, "hexservo export")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OutputError, match="File too large; nothing was written"):
            write_file(gains_header(paper), header, TITLE, "hexservo export", force=force)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.read_text(encoding="utf-8") for path in tmp_path.iterdir()] == [gains_header(paper, 0.5)] * force


def test_nothing_is_left_of_ctrl_c(paper: hs.Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*arguments: object) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(publish, "_renamed", interrupt)
    code, out, error = run("paper", "--header", str(tmp_path / "gains.hpp"))
    assert (code, out) == (130, "")
    assert "Interrupted" in error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["paper"], "--header"),
        (["papre", "--header", "g.hpp"], "paper"),
        (["paper", "--header", "g.hpp", "--set", "controller.hybrid.kp=-1"], "controller.hybrid.kp"),
        (["paper", "--header", "g.hpp", "--period", "0"], "period: expected a time above 0 and up to 1 s, got 0"),
        (["paper", "--header", "g.hpp", "--period", "nan"], "period: expected a time above 0 and up to 1 s, got nan"),
        (["paper", "--header", "g.hpp", "--period", "33"], "period: expected a time above 0 and up to 1 s, got 33"),
        (["slow-camera", "--header", "g.hpp", "--period", "0.02"], "camera.period: expected a whole number of servo"),
        (["paper", "--header", "g.hpp", "--period", "fast"], "--period"),
    ],
)
def test_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, error = run(*arguments)
    assert (code, out) == (2, "")
    assert words in error
    assert list(tmp_path.iterdir()) == []
