"""The command line: what it prints, where, and with which exit code."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import resource
import signal
import struct
import subprocess
import sys
import termios
import textwrap
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli import commands as cli
from hexservo.cli.terminal import load
from hexservo.scenario.yaml import load_yaml
from packaged import one_of_each_kind
from test_leg_limits import METRICS as OF_LIMITS

SHORT = ["--set", "simulation.duration=0.02"]
SINGULAR = ["--set", "uncertainty.gravity=0.5", "--set", "simulation.log_every=50"]  # ends paper-gravity early
FIGURES = ["fig2a_rule_table", "fig2b_feature_errors", "fig3_feature_paths", "fig4_platform_motion", "fig5_wrench"]
CODES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@pytest.fixture
def quick_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write one small file in place of the figures."""

    def paper_images(result: hs.Result) -> dict[str, bytes]:
        return {"fig3_feature_paths.svg": result.scenario.name.encode()}

    monkeypatch.setattr("hexservo.draw.plots.paper_images", paper_images)


class Run:
    """What one command line did."""

    def __init__(self, *arguments: str) -> None:
        self.result = CliRunner().invoke(cli.app, list(arguments), prog_name="hexservo")
        self.code = self.result.exit_code
        self.out = self.result.stdout
        self.lines = self.out.splitlines()
        self.error = self.result.stderr
        self.errors = self.error.splitlines()


def environment(**changes: str) -> dict[str, str]:
    """The environment without what changes colours, widths and buffers."""
    silent = {"NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "COLUMNS", "LINES", "TERM", "PYTHONUNBUFFERED"}
    return {**{key: value for key, value in os.environ.items() if key not in silent}, "TERM": "xterm", **changes}


def process(*arguments: str, cwd: Path, **changes: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hexservo", *arguments],
        cwd=cwd,
        env=environment(**changes),
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )


def in_terminal(*arguments: str, columns: int, cwd: Path, **changes: str) -> tuple[int, str]:
    """Exit code and output of a command in a terminal of that width."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    with subprocess.Popen(
        [sys.executable, "-m", "hexservo", *arguments],
        cwd=cwd,
        env=environment(**changes),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
    ) as running:
        os.close(theirs)
        blocks = []
        while True:
            try:
                block = os.read(ours, 1 << 16)
            except OSError:  # the other side is closed
                break
            if not block:
                break
            blocks.append(block)
        code = running.wait(60)
    os.close(ours)
    return code, b"".join(blocks).decode().replace("\r\n", "\n")


# ---- run ------------------------------------------------------------------------------------------------------------


SHOWN = {name: metric for name, metric in hs.METRICS.items() if name not in OF_LIMITS}  # `micro` has none


def test_run_prints_every_metric_in_units_people_read() -> None:
    run = Run("run", "paper")
    assert run.code == 0
    assert run.error == ""
    assert re.fullmatch(r"paper: completed, 5 s simulated in [0-9.e+]+ m?s", run.lines[0])
    rows: dict[str, str] = {}
    for line in run.lines[1 : 1 + len(SHOWN)]:
        name, _, rest = line.partition("  ")
        rows[name] = rest.strip()
    assert [name.replace(" ", "_") for name in rows] == list(SHOWN)
    metrics = hs.metrics(hs.simulate(hs.load_scenario("paper")))
    for name, (unit, meaning) in SHOWN.items():
        value, shown, said = re.split(r"  +", rows[name.replace("_", " ")])
        assert said == meaning
        if unit == "1":
            scale = 100.0
            assert shown == "%"
        else:
            scale = {"": 1.0, "m": 1e3, "u": 1e6}[shown.removesuffix(unit)]
            assert scale == 1.0 or 1.0 <= float(value) < 1000.0
        assert float(value) == pytest.approx(metrics[name] * scale, rel=5e-4)
    distance, files = run.lines[1 + len(SHOWN) :]
    assert distance.startswith("At the end the platform is 18.2 mm and 36.3 mrad from the pose with the goal image")
    assert files == "no files written; --out FOLDER writes figures and data"


def test_run_without_out_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert Run("run", "paper", *SHORT).code == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("quick_figures")
def test_run_writes_refuses_and_replaces(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "out"
    run = Run("run", "paper", *SHORT, "--out", str(folder))
    assert run.code == 0
    assert run.lines[-1] == f"figures, result.nc, metrics.json and scenario.yaml are in {folder}"
    again = Run("run", "paper", *SHORT, "--set", "name=other", "--out", str(folder))
    assert (again.code, again.out) == (2, "")
    assert len(again.errors) == 1
    assert "--force" in again.error
    assert hs.load_scenario(folder / "scenario.yaml").name == "paper"
    forced = Run("run", "paper", *SHORT, "--set", "name=other", "-o", str(folder), "--force")
    assert forced.code == 0
    assert "Error" not in forced.error
    assert hs.load_scenario(folder / "scenario.yaml").name == "other"


def test_a_refused_folder_is_reported_before_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(scenario: hs.Scenario) -> hs.Result:
        raise AssertionError("simulated in vain")

    monkeypatch.setattr(hs, "simulate", simulate)
    (tmp_path / "notes.txt").touch()
    run = Run("run", "paper", "--out", str(tmp_path), "--force")
    assert run.code == 2
    assert "not results of hexservo" in run.error


def test_settings_change_the_scenario_in_order() -> None:
    settings = [
        "name=changed",
        "uncertainty.depth=[0.1, -0.1, 0.2, -0.2]",
        "controller.switching.width=2",
        "controller={switching: {kind: tanh, width: 1}}",
        "controller.switching.width=1e-2",
        "description=a = b",
        "simulation.duration=1",
        "simulation.duration=2",
    ]
    run = Run("show", "paper", *(part for setting in settings for part in ("--set", setting)))
    assert run.code == 0
    assert hs.Scenario.from_yaml(run.out) == hs.load_scenario("paper").updated(
        {
            "name": "changed",
            "uncertainty.depth": [0.1, -0.1, 0.2, -0.2],
            "controller.switching": {"kind": "tanh", "width": 0.01},
            "description": "a = b",
            "simulation.duration": 2.0,
        }
    )


WITH_A_TAG = """\
name: tag
robot: {preset: pi_h824, gravity: 9.81}
camera: {focal_pixels: 1500, image_size: [1280, 1024], mount: {position: [0.0, 0.0, -0.02]}}
base_motion: {kind: recorded, file: imu.csv, frame_of_acceleration: specific_force}
target:
  tag: {size: 0.04, pose: [0.0, 0.0, -0.7, 0.0, 0.0, 0.0]}
  desired_pose: [0.003, -0.002, 0.002, 0.0, 0.0, 0.02]
simulation: {mode: sampled, duration: 0.1}
"""


def write_with_a_tag(folder: Path, *changes: tuple[str, str]) -> str:
    text = WITH_A_TAG
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "imu.csv").write_text("t,ax,ay,az\n0,0.1,0,-9.81\n0.05,0,0.2,-9.5\n0.1,0,0,-9.81\n")
    (folder / "mine.yaml").write_text(text)
    return str(folder / "mine.yaml")


@pytest.mark.parametrize(
    ("setting", "old", "new"),
    [
        ("camera.focal_pixels=900", "focal_pixels: 1500", "focal_pixels: 900"),
        ("camera.mount.rotation=[0.0, 0.05, 0.0]", "mount: {", "mount: {rotation: [0.0, 0.05, 0.0], "),
        ("robot.home_position=[0.0, 0.0, -0.2]", "gravity: 9.81", "gravity: 9.81, home_position: [0.0, 0.0, -0.2]"),
        ("robot.gravity=9.7", "gravity: 9.81", "gravity: 9.7"),
        ("target.tag.size=0.05", "size: 0.04", "size: 0.05"),
        ("target.desired_pose=[0, 0, 0.001, 0, 0, 0]", "[0.003, -0.002, 0.002, 0.0, 0.0, 0.02]", "[0,0,0.001,0,0,0]"),
    ],
)
def test_a_setting_equals_the_key_in_the_file(setting: str, old: str, new: str, tmp_path: Path) -> None:
    """Also of what tag, goal pose and readings of an accelerometer are read with."""
    before = write_with_a_tag(tmp_path)
    plain, changed = load(before, []), load(before, [setting])
    key, _, value = setting.partition("=")
    in_python = hs.load_scenario(before, {key: load_yaml(value)})
    written = hs.load_scenario(write_with_a_tag(tmp_path, (old, new)))
    assert changed == written == in_python
    assert (changed.target, changed.base_motion) != (plain.target, plain.base_motion)


def test_a_calibration_equals_its_keys_in_the_file(tmp_path: Path) -> None:
    calibration = tmp_path / "cal.yaml"
    calibration.write_text("K: [[900, 0, 640], [0, 905, 512], [0, 0, 1]]\nimage_width: 1300\nimage_height: 1000\n")
    keys = "focal_pixels: [900, 905], principal_point: [640, 512], image_size: [1300, 1000]"
    old = "focal_pixels: 1500, image_size: [1280, 1024]"
    before = write_with_a_tag(tmp_path)
    found = load(before, [], str(calibration))
    beside = load(before, ["camera={noise: 0.5}", "simulation={duration: 0.05}"], str(calibration))
    assert found.target.desired_features != load(before, []).target.desired_features
    assert found == load(write_with_a_tag(tmp_path, (old, keys)), [])
    assert beside == found.updated({"camera.noise": 0.5, "simulation.duration": 0.05})
    # the border acts in sampled mode, however that mode is given
    write_with_a_tag(tmp_path, ("simulation: {mode: sampled, duration: 0.1}", "simulation: {duration: 0.1}"),
                     (", image_size: [1280, 1024]", ""), ("kind: recorded", "kind: none"),
                     ("file: imu.csv, frame_of_acceleration: specific_force", "frequency: 1.0"))  # fmt: skip
    assert load(before, [], str(calibration)).camera.image_size is None
    assert load(before, ["simulation={mode: sampled}"], str(calibration)).camera.image_size == (1300.0, 1000.0)


def test_errors_name_the_option_that_they_are_of(tmp_path: Path) -> None:
    calibration = tmp_path / "cal.yaml"
    calibration.write_text("K: [[1e-300, 0, 640], [0, 1e-300, 512], [0, 0, 1]]\n")
    mine = write_with_a_tag(tmp_path)
    alone, both = Run("show", mine, "--set", "robot.mas=1"), Run("run", mine, "--camera", str(calibration))
    assert [line[:18] for line in alone.errors] == ["Error: --set: robo"]
    assert both.code == 2
    assert all(line.startswith("Error: --camera: ") for line in both.errors)
    both = Run("run", mine, "--camera", str(calibration), "--set", "robot.mas=1")
    assert all(line.startswith("Error: --camera and --set: ") for line in both.errors)
    (tmp_path / "mine.yaml").write_text(WITH_A_TAG.replace("gravity", "gravty"))
    found = Run("run", mine, "--set", "seed=1")
    assert [line.split("?")[0] for line in found.errors] == [
        f'Error: {mine}: robot.gravty: unknown key; did you mean "gravity"'
    ]


def test_what_a_shown_file_repeats_follows_the_settings(tmp_path: Path) -> None:
    """The whole of a scenario as a file: a preset's values, gains of `auto`."""
    for name, setting in (
        ("paper", "robot.preset=pi_h824"),
        ("composite-30hz", "target.depth=0.6"),
        ("paper-composite", "controller.composite.auto.bandwidth=2"),
        ("reachy-mini", "robot.payload.mass=0.05"),
    ):
        key, _, value = setting.partition("=")
        file = tmp_path / f"{name}.yaml"
        file.write_text(hs.load_scenario(name).to_yaml(), encoding="utf-8")
        assert load(str(file), [setting]) == hs.load_scenario(name).updated({key: load_yaml(value)})
        assert load(str(file), ["description=same"]) == hs.load_scenario(name).updated({"description": "same"})


def test_a_setting_may_give_what_a_file_lacks(tmp_path: Path) -> None:
    mine = write_with_a_tag(tmp_path, ("name: tag\n", ""))
    assert load(mine, ["name=given"]).name == "given"
    (tmp_path / "short.yaml").write_text("name: short\ntarget: {points: [[0.1, 0, -0.5], [0, 0.1, -0.5], [-0.1, 0, "
                                         "-0.5]], desired_pose: [0, 0, 0, 0, 0, 0]}\n")  # fmt: skip
    assert load(str(tmp_path / "short.yaml"), ["robot.mass=0.1"]).robot.mass == 0.1


@pytest.mark.parametrize("command", ["run", "show"])
def test_all_bad_settings_are_reported_together(command: str) -> None:
    settings = ["name", "=1", "uncertainty.dept=0.1", "robot.mass=-1", "controller.law=[", "simulation.step=on"]
    run = Run(command, "paper", *(part for setting in settings for part in ("--set", setting)))
    assert (run.code, run.out) == (2, "")
    assert all(line.startswith("Error: --set: ") for line in run.errors)
    for said in (
        'expected KEY=VALUE, as uncertainty.gravity=0.075, got "name"',
        'got "=1"',
        'uncertainty.dept: unknown key; did you mean "depth"?',
        "robot.mass: expected a number > 0 and < 1e+09, got -1",
        "not valid YAML",
        'simulation.step: expected a number > 0, got "on"',
    ):
        assert sum(said in line for line in run.errors) == 1, said
    assert len(run.errors) == 6


@pytest.mark.usefixtures("quick_figures")
def test_an_early_end_is_reported_and_its_results_are_kept(tmp_path: Path) -> None:
    run = Run("run", "paper-gravity", *SINGULAR, "--out", str(tmp_path / "out"))
    assert run.code == 3
    ending = re.fullmatch(r"Ended early: (paper-gravity: singular: [a-z ]+ at t = ([0-9.]+) s)", run.errors[-1])
    assert ending is not None
    assert run.lines[0].startswith(ending[1])
    assert "settling time" in run.out
    assert "never" in run.out
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["outcome"] == "singular"
    step = hs.load_scenario("paper-gravity").simulation.step
    assert float(ending[2]) == pytest.approx(metrics["end_time"]["value"] + step, rel=1e-5)
    limits = [line for line in run.lines if line.startswith("limit exceeded: leg ")]
    assert len(limits) == len(metrics["events"]) == 12


def test_a_run_whose_law_never_acted_has_the_reason() -> None:
    run = Run("run", "slow-camera", "--set", "camera.dropout=1.0", "--set", "simulation.duration=0.1")
    assert run.code == 0
    assert run.lines[-2].startswith("The law did not act: every frame was lost (camera.dropout: 1). ")


def test_a_run_ends_with_the_warnings_of_check() -> None:
    doubtful = ["paper", "--set", "metrics.band=30", "--set", "robot.mass=600"]
    run = Run("run", *doubtful, "--require-settled")
    assert run.code == 0  # for the band has the start in it, which the warning states
    found = Run("check", *doubtful).errors
    assert run.errors == [line for line in found if not line.startswith("Warning: simulation: in the run leg")]
    assert len(found) == len(run.errors) + 1  # what the result of `run` has in its table
    assert [line.split(": ")[1] for line in run.errors] == ["robot.force_limit", "metrics.band"]
    assert Run("run", *doubtful, "--quiet").error == ""
    early = Run("run", "paper-gravity", *SINGULAR, "--set", "metrics.dwell=9")
    assert [line.split(":")[0] for line in early.errors] == ["Warning", "Warning", "Ended early"]


def test_the_check_of_a_run_does_not_wait_for_scipy() -> None:
    """Nor with a camera of other pixels and axes, on the platform or on the base, and with drives of positions.

    Nor with fitted gains and a noisy camera, where the inertia has no products.
    """
    script = (
        "import sys, hexservo as hs; from hexservo.findings.check import unlikely; "
        "list(unlikely(hs.load_scenario(name)) for name in sys.argv[1:]); "
        "even = {'robot.centre_of_mass': [0, 0, 0], 'robot.inertia': [0.03, 0.03, 0.03]}; "
        "unlikely(hs.load_scenario('pi-h824', even)); sys.exit('scipy' in sys.modules)"
    )
    names = ["paper", "eye-to-hand", "reachy-mini"]
    subprocess.run([sys.executable, "-c", script, *names], check=True)


def test_quiet_prints_errors_only() -> None:
    run = Run("run", "paper", *SHORT, "--quiet")
    assert (run.code, run.out, run.error) == (0, "", "")
    run = Run("run", "paper-gravity", *SINGULAR, "-q")
    assert (run.code, run.out) == (3, "")
    assert len(run.errors) == 1
    assert "singular" in run.error


@pytest.mark.usefixtures("quick_figures")
def test_ctrl_c_during_the_run_keeps_what_was_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulate = hs.simulate

    def interrupted(scenario: hs.Scenario) -> hs.Result:
        threading.Timer(0.2, os.kill, [os.getpid(), signal.SIGINT]).start()
        return simulate(scenario)

    monkeypatch.setattr(hs, "simulate", interrupted)
    long = ["--set", "simulation.duration=1e6", "--set", "simulation.log_every=100000"]
    run = Run("run", "paper", *long, "--out", str(tmp_path / "out"))
    assert run.code == 130
    assert "paper: interrupted: stopped on request at t = " in run.errors[-1]
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["outcome"] == "interrupted"
    assert "kept" not in run.error
    assert 0 < metrics["end_time"]["value"] < 1e6


@pytest.mark.usefixtures("quick_figures")
def test_an_interrupted_run_leaves_earlier_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = str(tmp_path / "out")
    assert Run("run", "paper", *SHORT, "-q", "--out", out).code == 0
    before = {path.name: path.read_bytes() for path in Path(out).iterdir()}
    simulate = hs.simulate
    monkeypatch.setattr(hs, "simulate", lambda scenario: replace(simulate(scenario), outcome="interrupted"))
    run = Run("run", "paper", *SHORT, "--force", "--out", out)
    assert run.code == 130
    assert run.errors[-1].endswith(f"; the earlier results in {out} are kept")
    assert "are in" not in run.out
    assert {path.name: path.read_bytes() for path in Path(out).iterdir()} == before


def test_ctrl_c_while_writing_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def paper_images(result: hs.Result) -> dict[str, bytes]:
        raise KeyboardInterrupt

    monkeypatch.setattr("hexservo.draw.plots.paper_images", paper_images)
    run = Run("run", "paper", *SHORT, "--out", str(tmp_path / "a" / "out"))
    assert run.code == 130
    assert run.errors == ["Interrupted: no further files were written"]
    assert list(tmp_path.iterdir()) == []


def test_results_that_cannot_be_written_are_still_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit on the size of files stops the writing in the figures: here one, larger than all other files."""
    monkeypatch.setattr("hexservo.draw.plots.paper_images", lambda _: {"fig3_feature_paths.png": bytes(1_000_000)})
    sizes = {path.name: path.stat().st_size for path in folder_of_a_run(tmp_path / "whole").iterdir()}
    largest = max(sizes, key=lambda name: sizes[name])
    assert largest.endswith(".png")
    before = sorted(tmp_path.iterdir())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (sizes[largest] - 1, limits[1]))
    try:
        run = Run("run", "paper", *SHORT, "--out", str(tmp_path / "out"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert run.code == 2
    assert "final error" in run.out
    assert "are in" not in run.out
    assert len(run.errors) == 1
    assert run.error.startswith("Error: ")
    assert "File too large" in run.error
    assert sorted(tmp_path.iterdir()) == before


def folder_of_a_run(folder: Path) -> Path:
    assert Run("run", "paper", *SHORT, "--quiet", "--out", str(folder)).code == 0
    return folder


def test_an_internal_error_is_not_reported_as_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mistake = ValueError("shapes do not match")

    def paper_images(result: hs.Result) -> dict[str, bytes]:
        raise mistake

    monkeypatch.setattr("hexservo.draw.plots.paper_images", paper_images)
    run = Run("run", "paper", *SHORT, "--out", str(tmp_path / "out"))
    assert run.result.exception is mistake
    assert run.code == 1


def test_a_refusal_by_the_core_is_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(scenario: hs.Scenario) -> hs.Result:
        raise ValueError("step: expected a divisor, got 3")

    monkeypatch.setattr(hs, "simulate", simulate)
    run = Run("run", "paper")
    assert (run.code, run.errors) == (2, ["Error: paper: step: expected a divisor, got 3"])


# ---- The other commands ---------------------------------------------------------------------------------------------


def test_scenarios_lists_each_with_its_description() -> None:
    run = Run("scenarios")
    assert run.code == 0
    expected = {name: hs.load_scenario(name).description for name in hs.scenario_names()}
    assert dict(re.split(r"  +", line, maxsplit=1) for line in run.lines) == expected


@pytest.mark.parametrize("name", one_of_each_kind())
def test_show_prints_what_run_reads(name: str, tmp_path: Path) -> None:
    run = Run("show", name)
    assert run.code == 0
    shown = hs.load_scenario(name).to_yaml()
    assert without_comments(run.out) == shown
    file = tmp_path / "my.yaml"
    file.write_bytes(run.result.stdout_bytes)
    assert hs.load_scenario(file) == hs.load_scenario(name)
    assert Run("run", str(file), *SHORT).code == 0
    assert Run("show", str(file)).out == shown


def without_comments(text: str) -> str:
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#"))


def test_comments_of_show_bring_back_what_follows_the_camera(tmp_path: Path) -> None:
    """With the tag and the goal pose of the comments in place of points and features, another mount has their image."""
    changes = {"camera.mount.position": [0.6, 0.0, -1.5]}
    lines = Run("show", "moog-6dof2000e").out.splitlines()
    assert lines[0].startswith("# Read into the points and features below")
    written = yaml.safe_load("\n".join(line[2:] for line in lines[1:] if line.startswith("# ")))
    assert sorted(written) == ["target.desired_pose", "target.tag"]
    keys = yaml.safe_load("\n".join(lines))
    for name in ("points", "desired_features"):
        del keys["target"][name]
    keys["target"] |= {name.removeprefix("target."): value for name, value in written.items()}
    file = tmp_path / "my.yaml"
    file.write_text(yaml.safe_dump(keys), encoding="utf-8")
    fitted = hs.load_scenario("moog-6dof2000e", changes).target
    assert hs.load_scenario(file, changes).target == fitted
    assert hs.load_scenario("moog-6dof2000e").updated(changes).target != fitted


def test_show_leaves_text_as_it_is() -> None:
    description = "[bold]ξ̃[/bold] :smile: https://example.org " + "x" * 100
    run = Run("show", "paper", "--set", f"description='{description}'")
    assert hs.Scenario.from_yaml(run.out).description == description


def test_check_says_valid(tmp_path: Path) -> None:
    file = tmp_path / "my.yaml"
    file.write_text(Run("show", "paper").out, encoding="utf-8")
    run = Run("check", str(file))
    assert (run.code, run.error) == (0, "")
    assert run.out == f'{file}: valid (scenario "paper", 5 s in steps of 1 ms); its run is within 2 px after 0.353 s\n'


def test_check_states_how_the_run_ends() -> None:
    run = Run("check", "fails-wrong-sign")
    assert run.code == 0
    assert run.out == 'fails-wrong-sign: valid (scenario "fails-wrong-sign", 2 s in steps of 1 ms)\n'
    ends = "Warning: simulation: the run ends early (diverged): a feature error exceeded 10000 px at t = 0.041 s; "
    assert ends in run.error


def test_check_writes_json_and_is_strict(tmp_path: Path) -> None:
    file = tmp_path / "check.json"
    run = Run("check", "paper-gravity", "--json", str(file), "--strict")
    assert run.code == 2
    data = json.loads(file.read_text(encoding="utf-8"))
    assert [f"Warning: {words}" for words in data["warnings"]] == run.errors
    assert Run("check", "paper", "--strict").code == 0
    assert json.loads(Run("check", "paper", "--json", "-").out)["warnings"] == []
    again = Run("check", "paper", "--json", str(tmp_path))
    assert again.code == 2
    (tmp_path / "mine.json").write_text("{}", encoding="utf-8")
    assert Run("check", "paper", "--json", str(tmp_path / "mine.json"), "--force").code == 2  # not a file of `check`


def test_check_lists_every_problem(tmp_path: Path) -> None:
    file = tmp_path / "my.yaml"
    text = Run("show", "paper").out.replace("mass: 0.06", "mass: -1").replace("law: hybrid", "law: hybird")
    file.write_text(text, encoding="utf-8")
    run = Run("check", str(file))
    assert (run.code, run.out) == (2, "")
    assert len(run.errors) == 2
    assert run.errors[0].startswith(f"Error: {file}: robot.mass: expected a number > 0 and < 1e+09, got -1")
    assert run.errors[1].startswith(
        f'Error: {file}: controller.law: expected one of "hybrid", "composite", "kelly", "resolved_rate", "pbvs", '
        '"computed_torque", "tracking", got "hybird"'
    )


@pytest.mark.parametrize("command", ["run", "show", "check"])
def test_no_such_scenario(command: str) -> None:
    run = Run(command, "papre")
    assert (run.code, run.out) == (2, "")
    what = "no packaged scenario has that name, and there is no such file"
    assert run.errors == [f'Error: "papre": {what}; did you mean "paper"?']


def test_version() -> None:
    facts = dict(re.split(r": +", line, maxsplit=1) for line in Run("version").lines)
    build = _core.build_info()
    assert {facts["hexservo"], facts["compiler"], facts["flags"], facts["Eigen"]} == set(build.values())
    assert facts["Python"].startswith(f"{sys.version_info.major}.{sys.version_info.minor}.{sys.version_info.micro}")
    assert set(facts) >= {"numpy", "platform"}
    assert Run("--version").out == f"hexservo {hs.__version__}\n"


@pytest.mark.parametrize(
    "arguments", [["run"], ["frobnicate"], ["run", "paper", "--fast"], ["run", "paper", "--out"], ["check", "a", "b"]]
)
def test_wrong_usage(arguments: list[str]) -> None:
    run = Run(*arguments)
    assert (run.code, run.out) == (2, "")
    assert re.search(r"^Error: \S", run.error, re.MULTILINE)
    assert "Traceback" not in run.error


def test_help_names_every_command_and_is_not_cut() -> None:
    for arguments in (["--help"], ["-h"]):
        run = Run(*arguments)
        assert run.code == 0
        assert "..." not in run.out.replace("[ARGS]...", "")
        for command in ("run", "scenarios", "show", "check", "version"):
            assert re.search(rf"^  {command}  ", run.out, re.MULTILINE)
    for option in ("--out", "--set", "--force", "--quiet"):
        assert option in Run("run", "--help").out


def test_main_is_the_console_script(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["hexservo", "check", "paper"])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith("paper: valid")


# ---- Processes, pipes and terminals ---------------------------------------------------------------------------------


def test_the_paper_from_end_to_end(tmp_path: Path) -> None:
    done = process("run", "paper", "--out", "out/paper", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("are in out/paper\n")
    files = {path.name: path.stat().st_size for path in (tmp_path / "out" / "paper").iterdir()}
    figures = {f"{figure}.{suffix}" for figure in FIGURES for suffix in ("svg", "png")}
    assert files.keys() == {"scenario.yaml", "metrics.json", "result.nc", ".hexservo-output"} | figures
    assert min(files.values()) > 0
    assert Run("check", str(tmp_path / "out" / "paper" / "scenario.yaml")).code == 0


def test_output_into_a_pipe_is_plain_and_complete(tmp_path: Path) -> None:
    done = process("run", "paper-gravity", cwd=tmp_path)
    assert done.returncode == 0
    assert "\x1b" not in done.stdout
    assert not re.search(r"[^\x20-\x7e\n]", done.stdout)
    assert all(meaning in done.stdout for _, meaning in SHOWN.values())
    assert max(map(len, done.stdout.splitlines())) > 80
    assert not any(line != line.rstrip() for line in done.stdout.splitlines())


@pytest.mark.parametrize("columns", [30, pytest.param(50, marks=pytest.mark.slow), 100])
def test_output_fits_a_terminal(tmp_path: Path, columns: int) -> None:
    code, out = in_terminal("run", "paper-gravity", columns=columns, cwd=tmp_path)
    assert code == 0
    assert "\x1b[" in out
    lines = [line for line in CODES.sub("", out).splitlines() if not line.startswith("Warning: ")]  # a line each
    assert max(map(len, lines)) <= columns
    words = set(" ".join(lines).split())
    for name, (_, meaning) in SHOWN.items():
        assert set(name.split("_")) <= words
        assert columns < 100 or set(meaning.split()) <= words
    assert {"never", "37.58", "mrad/s", "limit"} <= words
    assert "…" not in out


def test_a_dumb_terminal_has_its_width_too(tmp_path: Path) -> None:
    """Of 80 columns the numbers at the right were cut off."""
    arguments = ["compare", "--scenarios", "paper", "--laws", "hybrid", *SHORT]
    tables = []
    for term in ("dumb", "xterm"):
        code, out = in_terminal(*arguments, columns=170, cwd=tmp_path, TERM=term)
        assert code == 0
        out = CODES.sub("", out)
        tables.append(out[out.index("settles") : out.index("1 run in ")])  # without bar and elapsed time
    assert tables[0] == tables[1]
    assert max(map(len, tables[0].splitlines())) > 100


@pytest.mark.parametrize("changes", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_a_terminal_without_colours(tmp_path: Path, changes: dict[str, str]) -> None:
    code, out = in_terminal("run", "paper-gravity", *SINGULAR, columns=100, cwd=tmp_path, **changes)
    assert code == 3
    assert "\x1b" not in out
    assert "Ended early: paper-gravity: singular" in out


# More than a pipe holds, and so little that it is written at the end; the others lie between.
@pytest.mark.parametrize(
    "command", ["show", "version", *(pytest.param(name, marks=pytest.mark.slow) for name in ("run", "scenarios"))]
)
def test_a_closed_pipe_ends_the_output_without_a_traceback(tmp_path: Path, command: str) -> None:
    arguments = [command] if command in ("scenarios", "version") else [command, "paper"]
    with subprocess.Popen(
        [sys.executable, "-m", "hexservo", *arguments],
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdout.close()
        error = running.stderr.read()
        code = running.wait(60)
    assert (code, error) == (141, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize(
    "arguments", [["show", "paper"], ["--help"], ["run", "-h"], pytest.param(["scenarios"], marks=pytest.mark.slow)]
)
def test_standard_output_on_a_full_disk(tmp_path: Path, arguments: list[str]) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "hexservo", *arguments],
            cwd=tmp_path,
            env=environment(),
            stdout=full,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            timeout=60,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "Error: standard output: cannot be written: No space left on device\n"


def test_ctrl_c_while_the_core_is_imported_is_no_broken_installation(tmp_path: Path) -> None:
    """The core's own imports raise it, and the import of the core fails for that."""
    (tmp_path / "start.py").write_text(
        textwrap.dedent("""
            import sys

            class Interrupted:
                def find_spec(self, name, path=None, target=None):
                    if name == "hexservo._core":
                        raise ImportError("initialization failed") from KeyboardInterrupt()

            sys.meta_path.insert(0, Interrupted())
            try:
                import hexservo
            except KeyboardInterrupt:
                print("Ctrl-C")
            """),
        encoding="utf-8",
    )
    done = subprocess.run(
        [sys.executable, "start.py"],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        encoding="utf-8",
        timeout=60,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("Ctrl-C\n", "")


def test_standard_output_that_is_closed(tmp_path: Path) -> None:
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" >&-', "sh", sys.executable, "-m", "hexservo", "show", "paper"],
        cwd=tmp_path,
        env=environment(),
        stderr=subprocess.PIPE,
        encoding="utf-8",
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stderr) == (2, "Error: standard output: cannot be written: it is closed\n")


def test_text_that_the_terminal_has_no_characters_for(tmp_path: Path) -> None:
    shown = process("show", "paper", "--set", "description=ξ", cwd=tmp_path, PYTHONIOENCODING="ascii")
    assert shown.returncode == 0
    assert hs.Scenario.from_yaml(shown.stdout).description == "ξ"  # a file that is read as UTF-8
    (tmp_path / "ξ.yaml").write_text(shown.stdout, encoding="utf-8")
    checked = process("check", "ξ.yaml", cwd=tmp_path, PYTHONIOENCODING="ascii")
    assert (checked.returncode, checked.stderr) == (0, "")
    assert checked.stdout.startswith(r"\u03be.yaml: valid")
