"""`hexservo new --machine`: answers become a scenario that loads and settles; bad answers leave no file."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import hexservo as hs
from hexservo.cli import commands as cli

QUESTIONS = 22  # with joints on circles


def answered(file: Path, answers: list[str], *options: str) -> Result:
    text = "".join(f"{answer}\n" for answer in answers)
    return CliRunner().invoke(cli.app, ["new", "--machine", str(file), *options], input=text, prog_name="hexservo")


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


@pytest.mark.parametrize("rate", ["10", "24", "29.97", "30", "59.94", "100", "144", "333"])
@pytest.mark.parametrize("bandwidth", ["0.3", "1.7", "2", "2.7", "5.3"])
def test_every_rate_and_bandwidth_make_a_grid_of_times(tmp_path: Path, rate: str, bandwidth: str) -> None:
    """Servo period, frame period, latency and duration are whole numbers of each other, to rounding."""
    done = answered(tmp_path / "mine.yaml", answers(p14=rate, p19=bandwidth))
    assert done.exit_code == 0, done.output


def test_the_inertia_in_brackets_is_one_of_a_body(tmp_path: Path) -> None:
    """0.25 m r^2 has digits here that rounding alone would make more than a body has."""
    done = answered(tmp_path / "mine.yaml", answers(p1="87", p7="1.07"))
    assert done.exit_code == 0, done.output


def test_numbers_of_a_sheet_become_si_units(tmp_path: Path) -> None:
    """The machine pi-h824 by its answers: pairs of the base about 0, 120, 240 deg and of the platform halfway."""
    file = tmp_path / "pi.yaml"
    done = answered(file, answers(p1="100", p2="30", p3="131", p4="10", p5="0, 0, -159", p6="-11.2 11.2"))
    assert done.exit_code == 0, done.output
    made, packaged = hs.load_scenario(file).robot, hs.load_scenario("pi-h824").robot
    for key in ("platform_radius", "base_radius", "home_position", "stroke"):
        np.testing.assert_allclose(getattr(made, key), getattr(packaged, key), rtol=1e-12)
    for key in ("platform_angles", "base_angles"):
        turn = np.asarray(getattr(made, key)) - np.asarray(getattr(packaged, key))
        np.testing.assert_allclose(np.remainder(turn + 1, 2 * np.pi), 1, atol=1e-6)


def test_a_load_and_a_camera_beside_the_middle(tmp_path: Path) -> None:
    file = tmp_path / "loaded.yaml"
    given = answers(p6="-10 20", p9="12", p10="0 0 -80")
    done = answered(file, [*given[:11], "300", "30 0 -20", *[""] * 10])
    assert done.exit_code == 0, done.output
    scenario = hs.load_scenario(file)
    robot = scenario.robot
    assert (robot.payload.mass, robot.payload.position[2], robot.force_limit) == (12.0, -0.08, 300.0)
    np.testing.assert_allclose([robot.stroke, robot.stroke_centre], [0.015, 0.005])
    assert scenario.camera.mount.position == (0.03, 0.0, -0.02)
    points = np.array(scenario.target.points)
    np.testing.assert_allclose(points.mean(axis=0), [0.03, 0.0, -0.16 - 0.02 - 0.5])


def test_joints_one_by_one(tmp_path: Path) -> None:
    file = tmp_path / "joints.yaml"
    done = answered(file, ["joints", *[""] * 40])
    assert done.exit_code == 0, done.output
    robot = hs.load_scenario(file).robot
    for given in (robot.platform_joints, robot.base_joints):
        assert np.array(given).shape == (6, 3)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (answers(p0="cranks"), 'expected circles or joints, got "cranks"'),
        (answers(p1="-3"), 'expected a number above 0, got "-3"'),
        (answers(p1="nan"), 'expected a number, got "nan"'),
        (answers(p5="1 2"), 'expected 3 numbers with blanks between, got "1 2"'),
        (answers(p6="1 15"), 'expected a number <= 0, then one >= 0, got "1 15"'),
        (answers(p8="1 1 3"), 'expected none larger than the sum of the other two, got "1 1 3"'),
        (answers(p17="900"), ': 80 % of the image, got "900"'),
        (answers()[:7], "expected an answer to every question, got the end of standard input"),
        (answers(p1="150", p2="60", p4="60"), "robot"),  # hexagons joined in cyclic order are singular everywhere
    ],
)
def test_a_bad_answer_leaves_no_file(tmp_path: Path, given: list[str], words: str) -> None:
    done = answered(tmp_path / "bad.yaml", given)
    assert done.exit_code == 2, done.output
    assert words in done.output
    assert list(tmp_path.iterdir()) == []


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

        until(b"[circles]")
        os.write(keyboard, b"cranks\n")
        until(b"Again: expected circles or joints")
        running.send_signal(signal.SIGINT)
        until(b"Interrupted: ")
        assert running.wait(60) == 130
    os.close(keyboard)
    assert list(tmp_path.iterdir()) == []
