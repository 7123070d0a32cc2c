"""`hexservo new --machine`: answers become a scenario that loads and settles; bad answers leave no file."""

from __future__ import annotations

import os
import pty
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.cli import commands as cli
from hexservo.cli import machine
from hexservo.cli.dialogue import Dialogue
from hexservo.findings.check import unlikely
from hexservo.findings.scenario_check import Check
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.yaml import load_yaml, read_yaml
from test_docs import ROOT

QUESTIONS = 30  # with joints on circles, a camera matrix in numbers, a tag, and drives that take forces


def answered(file: Path, answers: list[str], *options: str) -> Result:
    text = "".join(f"{answer}\n" for answer in answers)
    return CliRunner().invoke(cli.app, ["new", "--machine", str(file), *options], input=text, prog_name="hexservo")


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write the file without warnings and notes, for tests of what is in it: `hs.check` takes most of the time."""
    monkeypatch.setattr(hs, "check", lambda scenario: Check(scenario, (), (), None, None))


def answers(**changed: str) -> list[str]:
    """One answer per question, in order: defaults, but for those at the places p0, p1, ..."""
    return [changed.get(f"p{place}", "") for place in range(QUESTIONS)]


def test_defaults_make_a_machine_that_settles(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    done = answered(file, answers())
    assert done.exit_code == 0, done.output
    assert "travel from home" in done.output
    assert "Warning" not in done.output
    scenario = hs.load_scenario(file)
    result = hs.simulate(scenario)
    assert result.outcome == "completed"
    assert hs.metrics(result)["settling_time"] < 3.0
    assert scenario.robot.platform_radius == 0.1
    half = 0.041  # [m], 0.3 of 0.8 of the image's height at 0.5 m, rounded to two digits, on both sides
    corners = [[-half, half, -0.66], [half, half, -0.66], [half, -half, -0.66], [-half, -half, -0.66]]
    np.testing.assert_allclose(np.array(scenario.target.points), np.array(corners))


def test_metres_for_millimetres_are_warned_of(tmp_path: Path) -> None:
    lengths = {"p2": "0.1", "p4": "0.15", "p6": "0 0 -0.16", "p8": "-0.015 0.015"}
    done = answered(tmp_path / "mine.yaml", answers(**lengths))
    assert done.exit_code == 0, done.output
    assert "robot: a platform of 100 um radius" in done.stderr
    assert "mm in `hexservo new`" in done.stderr


@pytest.mark.parametrize("commands", ["forces", "positions"])
def test_a_far_tag_is_proposed_as_large_as_the_image_needs(tmp_path: Path, commands: str) -> None:
    """100 mm at 3 m leave the pose open by 720 mm: legs that take positions went to the ends of their stroke."""
    file = tmp_path / "far.yaml"
    done = answered(file, [*answers(p23="3000", p27=commands), *[""] * 5])
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    assert scenario.actuators.kind == commands.removesuffix("s")
    points = np.array(scenario.target.points)
    assert np.ptp(points[:, 0]) == pytest.approx(6.0 * 0.082, rel=0.01)  # six times as far as by default
    assert hs.metrics(hs.simulate(scenario))["settling_time"] < 1.5


def test_a_tag_too_small_for_a_law_is_warned_of(tmp_path: Path) -> None:
    """By `hexservo check`: such a file is legal."""
    file = tmp_path / "mine.yaml"
    assert answered(file, answers()).exit_code == 0
    tag = "target.tag={size: 2.0e-7, pose: [0, 0, -0.160001, 0, 0, 0]}"
    checked = CliRunner().invoke(cli.app, ["check", str(file), "--set", tag])
    assert checked.exit_code == 0, checked.output
    assert (
        "the gains' bandwidth cannot be evaluated, since numbers overflow (target: expected an image" in checked.stderr
    )


def test_the_travel_along_each_axis_ends_where_the_legs_do(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    done = answered(file, answers())
    scenario = hs.load_scenario(file)
    said = re.findall(r"^  (?:about )?[xyz] +(\S+) to (\S+) (mm|deg)$", done.output, re.MULTILINE)
    assert len(said) == 6
    for axis, (below, above, unit) in enumerate(said):
        scale = 1e-3 if unit == "mm" else np.pi / 180
        for end in (scale * float(below), scale * float(above)):
            reached = [hs.reachable(scenario, share * end * np.eye(6)[axis]).within for share in (0.999, 1.001)]
            assert reached == [True, False]  # printed with four digits


RATES, BANDWIDTHS = ("10", "24", "29.97", "30", "59.94", "100", "144", "333"), ("0.3", "1.7", "2", "2.7", "5.3")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("rate", "bandwidth"),
    [  # every rate and every bandwidth, in turn; the other pairs are slow
        pytest.param(rate, bandwidth, marks=[] if one % len(BANDWIDTHS) == other else [pytest.mark.slow])
        for one, rate in enumerate(RATES)
        for other, bandwidth in enumerate(BANDWIDTHS)
    ],
)
def test_every_rate_and_bandwidth_make_a_grid_of_times(tmp_path: Path, rate: str, bandwidth: str) -> None:
    """Servo period, frame period, latency and duration are whole numbers of each other, to rounding."""
    done = answered(tmp_path / "mine.yaml", answers(p20=rate, p28=bandwidth))
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize(
    ("rate", "bandwidth"), [("30", "100"), ("30", "5"), ("30", "0.5"), ("0.4", "2"), ("0.4", "30")]
)
def test_a_run_is_longer_than_the_times_that_it_is_measured_by(tmp_path: Path, rate: str, bandwidth: str) -> None:
    file = tmp_path / "mine.yaml"
    done = answered(file, answers(p20=rate, p28=bandwidth))
    assert done.exit_code == 0, done.output
    assert "simulation.duration" not in done.output  # of a warning
    scenario = hs.load_scenario(file)
    times = (scenario.metrics.dwell, scenario.metrics.rms_start, 1 / float(rate), 5 / float(bandwidth))
    np.testing.assert_allclose(scenario.simulation.duration, 2 * max(times), rtol=1e-12)


def test_the_servo_period_is_one_that_check_does_not_warn_of(tmp_path: Path) -> None:
    """A load beside the middle couples the axes, so that a pole is faster than those of the bandwidth."""
    fast = answers(p20="200", p28="2")
    done = answered(tmp_path / "mine.yaml", [*fast[:12], "80", "40 0 -40", "0.2 0.2 0.15", "yes", "900", *fast[14:]])
    assert done.exit_code == 0, done.output
    assert "simulation.step" not in done.stderr


@pytest.mark.parametrize("bandwidth", ["1", "0.05"])
def test_the_servo_period_is_no_shorter_than_that_of_commands(tmp_path: Path, bandwidth: str) -> None:
    """A body that is all but thin has a pole of 10 us; the run fits into a log, and the warning stays."""
    file = tmp_path / "mine.yaml"
    done = answered(file, answers(p10="100 0 0", p11="1e-5 0.05001 0.05001", p28=bandwidth))
    assert done.exit_code == 0, done.output
    assert "simulation.step: a servo period of 100 us is coarser" in done.stderr
    assert 1e-4 <= hs.load_scenario(file).simulation.step < 1.01e-4


def test_the_latency_is_the_answer_in_servo_periods(tmp_path: Path) -> None:
    """No less than the answer: a loop whose images are earlier than the machine's looks better than it is."""
    file = tmp_path / "mine.yaml"
    assert answered(file, answers(p26="61")).exit_code == 0
    scenario = hs.load_scenario(file)
    assert 0.061 <= scenario.camera.latency < 0.061 + scenario.simulation.step


def test_a_latency_in_seconds_is_noted(tmp_path: Path) -> None:
    for answer, noted in (("0.05", True), ("1", False), ("0", False)):
        done = answered(tmp_path / f"{answer}.yaml", answers(p26=answer))
        assert done.exit_code == 0, done.output
        assert ("If these are seconds, the answer is 50." in " ".join(done.output.split())) is noted


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("travel", "given", "resolution"),
    [("-0.02 0.02", "", 4e-9), ("-15 15", "", 1e-6), ("-15 15", "0.02", 2e-5), ("-15 15", "0", 0.0)],
)
def test_the_resolution_of_the_encoders_is_asked_for(
    tmp_path: Path, travel: str, given: str, resolution: float
) -> None:
    """In brackets is 1 um, or 1/10000 of a travel below 10 mm."""
    file = tmp_path / "mine.yaml"
    done = answered(file, answers(p8=travel, p25="0.002 -0.001 0.001 0 0 0", p29=given))
    assert done.exit_code == 0, done.output
    assert hs.load_scenario(file).sensors.resolution == resolution


def positions(*given: str, legs: str = "prismatic", **changed: str) -> list[str]:
    """Answers for drives that take positions: commands a second, delay, bandwidth and speed limit as they are given."""
    others = answers(p0=legs, p27="positions", **changed)
    rotary = ["", "", ""] if legs == "rotary" else []  # length, axes, rod
    return [*others[:8], *rotary, *others[8:28], *given, *[""] * (4 - len(given)), *others[28:]]


@pytest.mark.parametrize("legs", ["prismatic", "rotary"])
def test_a_machine_that_takes_positions_settles_by_its_defaults(tmp_path: Path, legs: str) -> None:
    file = tmp_path / "mine.yaml"
    done = answered(file, positions(legs=legs))
    assert done.exit_code == 0, done.output
    assert "Warning" not in done.output
    scenario = hs.load_scenario(file)
    assert (scenario.controller.law, scenario.actuators.kind) == ("tracking", "position")
    assert scenario.actuators.position.speed_limit == pytest.approx(0.02 if legs == "prismatic" else np.deg2rad(300))
    result = hs.simulate(scenario)
    assert result.outcome == "completed"
    assert hs.metrics(result)["settling_time"] < 3.0


def test_a_file_for_forces_becomes_one_for_positions_as_the_page_has_it(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    assert answered(file, answers()).exit_code == 0
    page = (ROOT / "docs" / "position-machines.md").read_text(encoding="utf-8")
    written = re.search(r"```yaml\n# mine.yaml\n(.*?)```", page, re.DOTALL)
    assert written
    document: Any = {**cast("dict[str, Any]", read_yaml(file)), **cast("dict[str, Any]", load_yaml(written[1]))}
    document["camera"] |= {"prediction": "none", "period": 0.04, "latency": 0.04}
    document["simulation"] |= {"step": 0.02, "duration": 10.0}
    scenario = hs.Scenario.from_mapping(document)
    assert unlikely(scenario) == []
    assert hs.metrics(hs.simulate(scenario))["settling_time"] < 3.0


def test_times_of_a_machine_that_takes_positions_are_whole_commands(tmp_path: Path) -> None:
    """The commands have the rate that was answered; the other times are rounded to them, which the output states."""
    file = tmp_path / "mine.yaml"
    done = answered(file, positions("50", "45", "4", "0", p20="30", p21="0.6", p26="60", p28="1.5"))
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    assert scenario.simulation.step == 0.02
    assert scenario.camera.period == pytest.approx(0.04)
    assert scenario.camera.latency == pytest.approx(0.06)
    assert scenario.actuators.delay == pytest.approx(0.06)
    assert "a frame every 40 ms (33.33 ms before rounding), used 60 ms after its exposure" in done.output
    assert "a delay of 60 ms (45 ms before rounding)" in done.output
    response = scenario.actuators.position
    assert (response.bandwidth, response.damping, response.speed_limit) == (4.0, 1.0, None)
    gains = scenario.controller.tracking
    assert (gains.bandwidth, gains.noise, scenario.camera.prediction) == (1.5, 0.6, "none")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("commands", "frames", "taken"),
    [
        ("50", "36", 0.04),
        ("30", "21", 2 / 30),
        ("60", "59.94", 1 / 60),
        ("30", "29.97", 1 / 30),
        ("50", "120", 0.02),
        ("2", "300", 0.5),
    ],
)
def test_frames_are_not_taken_for_more_frequent_than_they_are(
    tmp_path: Path, commands: str, frames: str, taken: float
) -> None:
    """But for a hundredth of a period between two commands, and for those faster than the commands."""
    file = tmp_path / "mine.yaml"
    done = answered(file, positions(commands, "45", "4", "0", p20=frames, p28="0.1"))
    assert done.exit_code == 0, done.output
    assert hs.load_scenario(file).camera.period == pytest.approx(taken)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("frames", "commands"), [("90", 90), ("30", 60), ("25", 50), ("29.97", 59.94), ("120", 120)])
def test_the_commands_in_brackets_keep_the_frame_rate(tmp_path: Path, frames: str, commands: float) -> None:
    """The least multiple of it that is at least 50 a second; other commands make the frames slower, which is stated."""
    file = tmp_path / "mine.yaml"
    done = answered(file, positions(p20=frames))
    assert done.exit_code == 0, done.output
    assert f"Commands a second [1/s] [{commands:g}]" in done.output
    assert "before rounding) after" not in done.output
    assert "would keep it" not in done.output
    scenario = hs.load_scenario(file)
    assert scenario.simulation.step == pytest.approx(1 / commands, rel=1e-12)
    assert scenario.camera.period == pytest.approx(1 / float(frames), rel=1e-12)
    slower = answered(file, positions(f"{0.8 * commands:g}", p20=frames), "--force")
    assert f"A multiple of the frame rate, such as {commands:g} commands a second, would keep it." in slower.output


def test_drives_that_take_speeds_are_sent_to_the_page(tmp_path: Path) -> None:
    done = answered(tmp_path / "mine.yaml", answers(p27="speed"))
    assert done.exit_code == 2
    assert "expected forces or positions (drives that take speeds follow positions by a loop around them" in done.stderr
    assert 'docs/your-machine.md, section 2), got "speed"' in done.stderr
    page = (ROOT / "docs" / "your-machine.md").read_text(encoding="utf-8")
    section = page[page.index("## 2. ") : page.index("## 3. ", page.index("## 2. "))]
    assert "| drives that take speeds |" in section


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("answer", "taken"), [("0", 0.0), ("10", 0.02), ("50", 0.06), ("60.1", 0.06)])
def test_no_time_that_makes_a_loop_worse_is_rounded_down(tmp_path: Path, answer: str, taken: float) -> None:
    """At 50 commands a second; 20 frames a second are one in 2.5 commands, and count as one in 3.

    A hundredth of a period more than whole ones is what an answer in three digits may be.
    """
    file = tmp_path / "mine.yaml"
    done = answered(file, positions("50", answer, p20="20", p26=answer))
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    assert scenario.camera.period == pytest.approx(0.06)
    np.testing.assert_allclose((scenario.camera.latency, scenario.actuators.delay), taken)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("rate", [24.0, 29.97, 30.0, 60.0, 120.0, 180.0, 333.0])
def test_the_camera_has_the_rate_that_was_answered(tmp_path: Path, rate: float) -> None:
    file = tmp_path / "mine.yaml"
    assert answered(file, answers(p20=str(rate))).exit_code == 0
    camera = hs.load_scenario(file).camera
    assert (camera.period, camera.latency) == (1 / rate, 1 / rate)


def test_the_inertia_in_brackets_is_one_of_a_body(tmp_path: Path) -> None:
    """0.25 m r^2 has digits here that rounding alone would make more than a body has."""
    done = answered(tmp_path / "mine.yaml", answers(p2="87", p9="1.07"))
    assert done.exit_code == 0, done.output


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("place", ["60 60 0", "30 30 0", "0 0 -10", "500 -300 200"])
def test_the_inertia_in_brackets_is_a_disc_at_the_centre_of_mass(tmp_path: Path, place: str) -> None:
    file = tmp_path / "mine.yaml"
    done = answered(file, answers(p10=place))
    assert done.exit_code == 0, done.output
    robot = hs.load_scenario(file).robot
    centre = np.array(robot.centre_of_mass)
    np.testing.assert_allclose(centre, 1e-3 * np.array(place.split(), dtype=float))
    about_origin = np.array(robot.inertia) if np.ndim(robot.inertia) == 2 else np.diag(robot.inertia)
    own = about_origin - robot.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    # m r^2/4 of 5 kg and 0.1 m; sums of up to 2 kg m^2 have rounding errors of 1e-15
    np.testing.assert_allclose(own, np.diag([0.0125, 0.0125, 0.025]), rtol=0, atol=1e-14)


def test_products_of_inertia_may_be_given(tmp_path: Path) -> None:
    done = answered(tmp_path / "mine.yaml", answers(p11="0.03 0.04 0.05 0.001 -0.002 0.003"))
    assert done.exit_code == 0, done.output
    expected = ((0.03, 0.001, -0.002), (0.001, 0.04, 0.003), (-0.002, 0.003, 0.05))
    assert hs.load_scenario(tmp_path / "mine.yaml").robot.inertia == expected


@pytest.mark.parametrize("name", ["my machine.yaml", "-mine.yaml", ".yaml", "mine!.yaml"])
def test_a_name_that_no_scenario_has_is_refused_before_the_first_question(tmp_path: Path, name: str) -> None:
    done = answered(tmp_path / name, answers())
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr.startswith('Error: --machine: expected a file with a name of 1 to 60 letters, digits, "-"')
    assert list(tmp_path.iterdir()) == []


def test_the_next_commands_can_be_pasted(tmp_path: Path) -> None:
    folder = tmp_path / "my machines"
    folder.mkdir()
    done = answered(folder / "mine.yaml", answers())
    first, second = done.stdout.splitlines()[-2:]
    assert shlex.split(first) == ["hexservo", "check", str(folder / "mine.yaml")]
    assert shlex.split(second) == ["hexservo", "report", str(folder / "mine.yaml"), "--out", "mine.html"]


def test_numbers_of_a_sheet_become_si_units(tmp_path: Path) -> None:
    """The machine pi-h824 by its answers: pairs of the base about 0, 120, 240 deg and of the platform halfway."""
    file = tmp_path / "pi.yaml"
    done = answered(file, answers(p2="100", p3="30", p4="131", p5="10", p6="0, 0, -159", p8="-11.2 11.2"))
    assert done.exit_code == 0, done.output
    made, packaged = hs.load_scenario(file).robot, hs.load_scenario("pi-h824").robot
    for key in ("platform_radius", "base_radius", "home_position", "stroke"):
        np.testing.assert_allclose(getattr(made, key), getattr(packaged, key), rtol=1e-12)
    for key in ("platform_angles", "base_angles"):
        turn = np.asarray(getattr(made, key)) - np.asarray(getattr(packaged, key))
        np.testing.assert_allclose(np.remainder(turn + 1, 2 * np.pi), 1, atol=1e-6)


def test_a_load_and_a_camera_beside_the_middle(tmp_path: Path) -> None:
    file = tmp_path / "loaded.yaml"
    given = answers(p8="-10 20", p10="0 0 -10", p12="12")
    done = answered(file, [*given[:13], "0 0 -80", "0.1 0.1 0.05", "no", "300", "30 0 -20", *[""] * 15])
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    robot = scenario.robot
    assert (robot.payload.mass, robot.payload.position[2], robot.force_limit) == (12.0, -0.08, 300.0)
    assert (robot.payload.inertia, robot.payload.known) == ((0.1, 0.1, 0.05), False)
    assert robot.centre_of_mass == (0.0, 0.0, -0.01)
    np.testing.assert_allclose([robot.stroke, robot.stroke_centre], [0.015, 0.005])
    assert scenario.camera.mount.position == (0.03, 0.0, -0.02)
    points = np.array(scenario.target.points)
    np.testing.assert_allclose(points.mean(axis=0), [0.03, 0.0, -0.16 - 0.02 - 0.5])


def test_joints_one_by_one(tmp_path: Path) -> None:
    file = tmp_path / "joints.yaml"
    done = answered(file, ["", "joints", *[""] * 45])
    assert done.exit_code == 0, done.output
    robot = hs.load_scenario(file).robot
    for given in (robot.platform_joints, robot.base_joints):
        assert np.array(given).shape == (6, 3)


@pytest.mark.parametrize(
    ("order", "holds"),
    [([0, 1, 2, 3, 4, 5], True), ([5, 4, 3, 2, 1, 0], False), ([1, 2, 3, 4, 5, 0], False)],
    ids=["right", "reversed", "shifted"],
)
def test_joints_in_another_order_are_named_as_such(tmp_path: Path, order: list[int], holds: bool) -> None:
    """Typed with six digits they are singular but for 1e-8, which the core takes for legs that hold."""

    def on_circle(radius: float, degrees: list[float]) -> list[str]:
        return [f"{radius * np.cos(a):.6g} {radius * np.sin(a):.6g} 0" for a in np.deg2rad(degrees)]

    platform = on_circle(100.0, [-50, 50, 70, 170, 190, 290])
    base = on_circle(150.0, [-10, 10, 110, 130, 230, 250])
    given = ["", "joints", *(platform[k] for k in order), *base, *[""] * 33]
    done = answered(tmp_path / "joints.yaml", given)
    assert done.exit_code == (0 if holds else 2), done.output
    assert ("in the order of the legs, both counted the same way round" in done.stderr) != holds
    assert ("Mass" in done.stdout) == holds


def corners_seen(scenario: hs.Scenario) -> NDArray[np.float64]:
    """Pixels of the target from home, (n, 2), from the image centre."""
    size = np.asarray(scenario.camera.image_size)
    pixels = np.asarray(hs.project(scenario, np.zeros(6))).reshape(-1, 2)
    given = scenario.camera.principal_point
    return pixels if given is None else pixels - (size - 1) / 2


def test_a_home_that_is_turned_and_a_camera_that_looks_aside(tmp_path: Path) -> None:
    """The tag stays in the middle of the image, with sides along the image's."""
    file = tmp_path / "aside.yaml"
    given = answers(p7="3 -5 20", p14="60 0 -40", p15="-90 0 0", p17="1000", p24="100", p25="0 0 0 1 1 1")
    done = answered(file, given)
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    np.testing.assert_allclose(scenario.robot.home_attitude, np.deg2rad([3, -5, 20]), rtol=1e-8)
    np.testing.assert_allclose(scenario.camera.mount.rotation, [-np.pi / 2, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(corners_seen(scenario), [[-100, 100], [100, 100], [100, -100], [-100, -100]], atol=1e-5)


@pytest.mark.parametrize("look", ["0 0 0", "-90 0 0"])
def test_a_calibration_file(tmp_path: Path, look: str) -> None:
    """Its pixels count from the top left corner, and y points down; the camera looks where it did."""
    calibration = tmp_path / "calibration.yaml"
    calibration.write_text(
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
        "camera_matrix: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
        "  data: [600, 0, 330, 0, 610, 235, 0, 0, 1]\n"
        "distortion_coefficients: !!opencv-matrix\n  rows: 1\n  cols: 5\n  dt: d\n  data: [0, 0, 0, 0, 0]\n",
        encoding="utf-8",
    )
    file = tmp_path / "mine.yaml"
    given = answers(p15=look, p16="file")
    done = answered(file, [*given[:17], str(calibration), "", "", "", "", "120", *[""] * 6])
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    assert scenario.camera.image_size == (640.0, 480.0)
    seen = np.asarray(hs.project(scenario, np.zeros(6))).reshape(4, 2)
    half = 0.06 / 0.5
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half * [600, 610] + [330, 235]
    np.testing.assert_allclose(seen, corners, atol=1e-5)


def test_distortion_in_numbers(tmp_path: Path) -> None:
    file = tmp_path / "bent.yaml"
    assert answered(file, answers(p19="-0.2 0.05 0.001 -0.001 0")).exit_code == 0
    assert hs.load_scenario(file).camera.distortion.brown_conrady == (-0.2, 0.05, 0.001, -0.001, 0.0)


def test_a_grid_as_the_target(tmp_path: Path) -> None:
    file = tmp_path / "grid.yaml"
    given = answers(p22="grid")
    done = answered(file, [*given[:24], "3 5", "20", *[""] * 5])
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    seen = corners_seen(scenario).reshape(3, 5, 2)
    step = 1500 * 0.02 / 0.5
    np.testing.assert_allclose(np.diff(seen[..., 0], axis=1), step, rtol=1e-9)
    np.testing.assert_allclose(np.diff(seen[..., 1], axis=0), -step, rtol=1e-9)
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), 0.0, atol=1e-9)


def test_points_one_by_one(tmp_path: Path) -> None:
    file = tmp_path / "points.yaml"
    given = answers(p22="points")
    done = answered(file, [*given[:24], "5", "10 20 -700", *[""] * 9])
    assert done.exit_code == 0, done.output
    points = np.array(hs.load_scenario(file).target.points)
    assert points.shape == (5, 3)
    np.testing.assert_allclose(points[0], [0.01, 0.02, -0.7])
    np.testing.assert_allclose(points[1:, 2], -0.66)


def test_rotary_legs_settle_by_their_defaults(tmp_path: Path) -> None:
    """Cranks with radial axes: level at home, outwards, the rods closed."""
    file = tmp_path / "cranks.yaml"
    done = answered(file, ["rotary", *[""] * 40])
    assert done.exit_code == 0, done.output
    assert "Warning" not in done.output
    scenario = hs.load_scenario(file)
    robot = scenario.robot
    assert (robot.legs, robot.cranks.length) == ("rotary", 0.05)
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    np.testing.assert_allclose(hexapod.home_lengths, 0.0, atol=2e-3)
    np.testing.assert_allclose(np.asarray(robot.cranks.axes) @ [0, 0, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(robot.stroke, np.deg2rad(40), rtol=1e-8)
    result = hs.simulate(scenario)
    assert result.outcome == "completed"
    assert hs.metrics(result)["settling_time"] < 3.0


def test_cranks_one_by_one(tmp_path: Path) -> None:
    """The head of the tests, from its numbers: legs, axes, directions, and branches that are found."""
    file = tmp_path / "head.yaml"
    millimetres = [" ".join(f"{1e3 * x:.6f}" for x in row) for row in (*rotary_machine.JOINTS, *rotary_machine.CENTRES)]
    ways = [
        " ".join(f"{x:.9f}" for x in row)
        for pair in zip(rotary_machine.AXES, rotary_machine.ZERO, strict=True)
        for row in pair
    ]
    home = " ".join(f"{1e3 * x:.6f}" for x in rotary_machine.HOME)
    lines = ["rotary", "joints", *millimetres, home, "", "40", "given", *ways, "85", "-44 44", "0.28", *[""] * 4]
    done = answered(file, [*lines, "0 0 -51", *[""] * 15])
    assert done.exit_code == 0, done.output
    robot = hs.load_scenario(file).robot
    np.testing.assert_array_equal(robot.cranks.branch, rotary_machine.BRANCH)
    np.testing.assert_allclose(np.array(robot.cranks.axes), rotary_machine.AXES, atol=1e-8)
    hexapod = _core.Hexapod(core_parameters(hs.load_scenario(file)).robot)
    np.testing.assert_allclose(hexapod.home_lengths, rotary_machine.UPRIGHT, atol=2e-4)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (answers(p0="cranks"), 'expected prismatic or rotary, got "cranks"'),
        (answers(p1="cranks"), 'expected circles or joints, got "cranks"'),
        (answers(p2="-3"), 'expected a number from 0.1 to 100000, got "-3"'),
        (answers(p3="400"), 'joints of a pair [deg]: expected a number from 0.001 to 119.999, got "400"'),
        (answers(p6="1e9 0 0"), 'expected numbers within +-100000, got "1e9 0 0"'),
        (answers(p6="0 0 0"), "joints and home: expected a home pose that is not singular"),
        (answers(p7="180 0 0"), "joints and home: expected a home pose that is not singular"),
        (answers(p7="0 0 400"), 'axis times angle [deg]: expected numbers within +-360, got "0 0 400"'),
        (answers(p9="0"), 'expected a number from 0.0001 to 100000, got "0"'),
        (answers(p12="-1"), 'expected 0, or a number from 0.0001 to 100000, got "-1"'),
        (answers(p18="0.5 20"), 'expected numbers of at least 1, got "0.5 20"'),
        (answers(p19="5 5 5 5 5"), "k1 k2 p1 p2 k3: camera.distortion: expected a lens that shows all of an"),
        (answers(p19="-0.9 0 0 0 0"), "p1 p2 k3: camera.distortion: expected a lens that shows all of an"),
        (answers(p20="1e6"), 'Frames per second [1/s]: expected a number from 0.1 to 10000, got "1e6"'),
        (answers(p23="1e9"), 'at home [mm]: expected a number from 1 to 100000, got "1e9"'),
        (answers(p25="0 0 0 0 0 400"), 'turn about x y z [deg]: expected turns within +-360, got "0 0 0 0 0 400"'),
        (answers(p27="torques"), 'section 2), got "torques"'),
        (positions("50", "200"), 'acts on it [ms]: expected a number from 0 to 160, got "200"'),
        (answers(p28="1e-6"), 'Bandwidth of the loop [Hz]: expected a number from 0.05 to 500, got "1e-6"'),
        (answers(p2="nan"), 'expected a number, got "nan"'),
        (answers(p6="1 2"), 'expected 3 numbers with blanks between, got "1 2"'),
        (answers(p8="1 15"), 'expected a number <= 0, then one >= 0, not both 0, got "1 15"'),
        (answers(p11="1 1 3"), 'expected none larger than the sum of the other two, got "1 1 3"'),
        (answers(p10="60 60 0", p11="0.01 0.01 0.02"), 'expected numbers above 0, got "0.01 0.01 0.02"'),
        (answers(p11="0.01 0.01 0.02 0.1 0 0"), 'expected numbers above 0, got "0.01 0.01 0.02 0.1 0 0"'),
        (answers(p11="1 2"), 'expected 3 or 6 numbers with blanks between, got "1 2"'),
        (answers(p24="900"), ': 80 % of the image, got "900"'),
        (["", *answers(p22="grid")[1:24], "5 4"], 'whose product is at most 16, got "5 4"'),
        ([*answers(p22="points")[:24], "17"], 'expected a whole number of 3 to 16, got "17"'),
        ([*answers(p16="file")[:17], "nowhere.yaml"], "nowhere.yaml"),
        (answers()[:7], "expected an answer to every question, got the end of standard input"),
        (
            answers(p2="150", p3="60", p5="60"),
            "home: expected legs that hold",
        ),  # hexagons joined in cyclic order are singular everywhere
    ],
)
def test_a_bad_answer_leaves_no_file(tmp_path: Path, given: list[str], words: str) -> None:
    done = answered(tmp_path / "bad.yaml", given)
    assert done.exit_code == 2, done.output
    assert words in done.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rod", ["0.16", "40", "400"])
def test_rods_that_do_not_close_are_refused_with_those_that_do(tmp_path: Path, rod: str) -> None:
    """A rod may be as short or long as the platform's joint is near to or far from the circle of the crank's end.

    That circle is upright, of 50 mm about a joint of the base, across its radius.
    """
    platform, base = 100 * np.exp(np.deg2rad(50) * 1j), 150 * np.exp(np.deg2rad(10) * 1j)
    outwards, across = (platform - base) * np.exp(-np.deg2rad(10) * 1j) * np.array([1, -1j])
    far = np.hypot(across.real, 160)
    shortest, longest = (np.hypot(outwards.real, far + length) for length in (-50, 50))
    done = answered(tmp_path / "bad.yaml", ["rotary", *[""] * 7, "", "", rod])
    assert done.exit_code == 2, done.output
    (low, high) = re.findall(r"expected a length from (\S+) to (\S+) mm, with which cranks and rods", done.stderr)[0]
    np.testing.assert_allclose([float(low), float(high)], [shortest, longest], rtol=1e-3)  # four digits, inwards
    assert f'got "{rod}"' in done.stderr
    assert "At home the cranks" not in done.stdout
    for fits in (low, high):
        assert answered(tmp_path / f"{fits}.yaml", ["rotary", *[""] * 9, fits, *[""] * 30]).exit_code == 0


def test_cranks_that_no_rods_of_one_length_close_are_refused(tmp_path: Path) -> None:
    """The first joint of the base is 1 m off the others."""
    joints = [*machine._default_joints("platform"), "1000 0 0", *machine._default_joints("base")[1:]]
    done = answered(tmp_path / "bad.yaml", ["rotary", "joints", *joints, *[""] * 5])
    assert done.exit_code == 2, done.output
    assert "joints, home and cranks: expected ones that rods of one length close at home, got legs" in done.stderr


def test_the_travel_of_a_crank_is_at_most_half_a_turn(tmp_path: Path) -> None:
    for travel, code in (("-180 180", 0), ("-200 200", 2)):
        done = answered(tmp_path / f"{code}.yaml", ["rotary", *[""] * 10, travel, *[""] * 30])
        assert done.exit_code == code, done.output
    assert 'least largest [deg]: expected numbers within +-180, got "-200 200"' in done.stderr


@pytest.mark.parametrize(
    ("size", "k1", "words"),
    [
        ("640 480", 0.0, "camera.principal_point[0]: expected a pixel of the image, from -0.5 to 639.5"),
        ("1280 960", -0.9, "camera.distortion: expected a lens that shows all of an image of 1280 x 960 px"),
    ],
)
@pytest.mark.parametrize("in_file", [True, False])
def test_a_calibration_without_an_image_is_refused_at_once(
    tmp_path: Path, size: str, k1: float, words: str, in_file: bool
) -> None:
    width, height = size.split()
    calibration = tmp_path / "calibration.yaml"
    calibration.write_text(
        (f"image_width: {width}\nimage_height: {height}\n" if in_file else "")
        + f"camera_matrix: [905, 0, 650, 0, 903, 470, 0, 0, 1]\ndistortion_coefficients: [{k1}, 0, 0, 0, 0]\n",
        encoding="utf-8",
    )
    done = answered(tmp_path / "bad.yaml", [*answers(p16="file")[:17], str(calibration), size, *[""] * 20])
    assert done.exit_code == 2, done.output
    question = "Calibration file (YAML)" if in_file else "Image size: width height [px]"
    assert f"{question}: {words}, got " in done.stderr


def test_legs_that_do_not_hold_are_refused_before_the_mass_is_asked_for(tmp_path: Path) -> None:
    flat, upside_down = answers(p6="0 0 -1e-9"), answers(p0="rotary", p7="180 0 0")
    for given, words in ((flat, "joints and home: "), (upside_down, "joints, home and cranks: ")):
        done = answered(tmp_path / "bad.yaml", given)
        assert done.exit_code == 2, done.output
        assert words in done.stderr
        assert "Mass" not in done.stdout


@pytest.mark.parametrize("rate", ["0.1", "10000"])
@pytest.mark.parametrize("bandwidth", ["0.05", "500"])
def test_the_bounds_of_rate_and_bandwidth_fit_each_other(tmp_path: Path, rate: str, bandwidth: str) -> None:
    done = answered(tmp_path / "mine.yaml", answers(p20=rate, p28=bandwidth))
    assert done.exit_code == 0, done.output


@pytest.fixture
def asks_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command ask as at a terminal, with answers from standard input."""
    monkeypatch.setattr(machine, "Dialogue", lambda interactive: Dialogue(interactive=True))


@pytest.mark.usefixtures("asks_again")
def test_a_wrong_answer_is_asked_again_alone(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    given = answers(p3="400")
    done = answered(file, [*given[:4], "30", *given[4:]])
    assert done.exit_code == 0, done.output
    assert done.output.count("[prismatic]") == 1
    assert 'Again: expected a number from 0.001 to 119.999, got "400"' in done.stderr


@pytest.mark.usefixtures("asks_again")
def test_answers_that_do_not_fit_one_another_are_offered_once_more(tmp_path: Path) -> None:
    """Three points on a line show only after the last question."""
    file = tmp_path / "mine.yaml"
    line = ["-50 0 -660", "0 0 -660", "50 0 -660"]
    given = [*answers(p4="160", p9="6", p22="points")[:24], "3", *line, *[""] * 3, "2", ""]
    second = [*[""] * 26, "0 40 -660", *[""] * 6]
    done = answered(file, [*given, *second])
    assert done.exit_code == 0, done.output
    assert "Again: target.points: expected features that determine the pose" in done.stderr
    assert done.stdout.count("Mass of the platform with the camera [kg] [6]") == 1
    scenario = hs.load_scenario(file)
    np.testing.assert_allclose(
        np.array(scenario.target.points), [[-0.05, 0, -0.66], [0, 0.04, -0.66], [0.05, 0, -0.66]]
    )
    robot = scenario.robot
    assert (robot.base_radius, robot.mass, scenario.controller.gains.auto.bandwidth) == (0.16, 6.0, 2.0)


@pytest.mark.usefixtures("asks_again")
def test_an_earlier_answer_that_no_longer_fits_gives_way_to_the_default(tmp_path: Path) -> None:
    """The tag of the first round is too large for the distance of the second."""
    file = tmp_path / "mine.yaml"
    given = answers(p23="2000", p24="1000", p25="90000 0 0 0 0 0")
    second = answers(p23="500", p25="0 0 0 0 0 1")
    done = answered(file, [*given, *second[:25], "", *second[25:]])
    assert done.exit_code == 0, done.output
    assert "Side of the tag [mm] [1000]" in done.stdout
    assert hs.load_scenario(file).robot.platform_radius == 0.1


def test_files_are_kept_unless_they_are_ours_and_forced(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("name: other\n", encoding="utf-8")
    for options in ((), ("--force",)):
        done = answered(file, answers(), *options)
        assert done.exit_code == 2
        assert done.output.count("[") == 0  # before the first question
        assert file.read_text(encoding="utf-8") == "name: other\n"
    file.unlink()
    assert answered(file, answers()).exit_code == 0
    assert answered(file, answers()).exit_code == 2
    assert answered(file, answers(p9="6"), "--force").exit_code == 0
    assert hs.load_scenario(file).robot.mass == 6.0


def test_on_a_terminal_it_asks_again_and_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    keyboard, screen = pty.openpty()
    command = [sys.executable, "-m", "hexservo", "new", "--machine", str(file)]
    with subprocess.Popen(command, stdin=screen, stdout=screen, stderr=screen, start_new_session=True) as running:
        os.close(screen)
        shown = b""

        def until(words: bytes) -> None:
            nonlocal shown
            give_up = time.monotonic() + 60
            while words not in shown:
                assert time.monotonic() < give_up, shown
                shown += os.read(keyboard, 4096)

        until(b"[prismatic]")
        os.write(keyboard, b"cranks\n")
        until(b"Again: expected prismatic or rotary")
        running.send_signal(signal.SIGINT)
        until(b"Interrupted: ")
        assert running.wait(60) == 130
    os.close(keyboard)
    assert list(tmp_path.iterdir()) == []
