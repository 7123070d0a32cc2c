"""Logs that are refused: bad files, numbers that are none, legs that are out of the machine's reach."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli.commands import app
from hexservo.findings.identification.drives import MOST_DELAY
from hexservo.findings.identification.log import Frames, Log
from hexservo.findings.identification.mcap_log import period_of
from hexservo.findings.identification.reach import require_reach
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]

SEED = 20260
HEAD = "time," + ",".join(f"command_{i}" for i in range(1, 7)) + "," + ",".join(f"joint_{i}" for i in range(1, 7))


def lines_of(count: int, width: int = 12) -> list[str]:
    return [",".join([f"{0.01 * tick:.9g}", *(["0.2"] * width)]) for tick in range(count)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "column names"),
        ("t,x\n1,2\n", "expected the columns time, command_1"),
        ("t,x\n1,2\n", "joint_6, got a line of 2 other names"),
        (f"{HEAD.removesuffix('joint_6')}x\n", "joint_6, got all but joint_6"),
        (f"{HEAD},torque_1\n", "1 other columns"),
        (f"{HEAD},x_1\n", "other columns"),
        ("\n".join([HEAD, *lines_of(3), "1,2"]), "line 5: expected 13 fields, got 2"),
        ("\n".join(["# a", "#", HEAD, *lines_of(3), " # b", "1,2"]), "line 8: expected 13 fields, got 2"),
        ("\n".join([HEAD, *lines_of(60, 11)]), "line 2: expected 13 fields, got 12"),
        ("\n".join([HEAD, *lines_of(60)]).replace("0.2", "inf", 1), "line 2, command_1: expected a finite number"),
        ("\n".join([HEAD, *lines_of(60)]).replace("0.2", "secret", 1), "other text (6 characters)"),
        (
            "\n".join([HEAD, *lines_of(60)]).replace("0.2", "", 1),
            "line 2, command_1: expected a finite number, got none",
        ),
        ("\n".join([HEAD, *lines_of(60)]).replace("0.3,0.2", "0.3,nan", 1), "line 32, command_1: expected a finite"),
        ("\n".join([HEAD, *(f"{20 * tick}{',0.2' * 12}" for tick in range(60))]), "one every 20: are they in ms?"),
        ("\n".join([HEAD, *lines_of(10)]), "at least 50 ticks"),
        ("\n".join([HEAD, *lines_of(60)]).replace("\n0.3,", "\n0.309,"), "resample the log"),
        ("\n".join([HEAD, *lines_of(60)]).replace("\n0.3,", "\n0.37,"), "line 33, time: expected times that increase"),
        (HEAD.replace(",", ";") + "\n", "got them with semicolons between; write commas between fields"),
        (HEAD.replace(",", "\t") + "\n", "got them with tabs between; write commas between fields"),
        (HEAD.upper() + "\n", "got TIME, COMMAND_1, COMMAND_2, "),
        (HEAD.replace("time", "Time") + "\n", "joint_6, got Time; write the names in lower case"),
        ("\0".join(f"{HEAD}\n"), "got UTF-16; save the file as UTF-8"),
        (
            "\n".join([HEAD, *(line.replace(".", ",") for line in lines_of(60))]),
            "line 2: expected 13 fields, got 25; a comma separates fields: decimals need a point",
        ),
        (
            "\n".join([HEAD, *lines_of(60)]).replace("0.2", '"0,2"', 1),
            "line 2, command_1: expected a finite number, got one with a decimal comma",
        ),
        ("\n".join([HEAD, *lines_of(60)]).replace("0.2", "0_2", 1), "line 2, command_1: expected a finite number"),
        ("\n".join([HEAD, *lines_of(60)]).replace("0.2", "\u0662", 1), "line 2, command_1: expected a finite number"),
        (
            "\n".join([HEAD, *reversed(lines_of(60))]),
            "line 3, time: expected times that increase, got 0.58 after 0.59; sort the lines by their times",
        ),
        (
            "\n".join([f"{HEAD},x_1,y_1", *(f"{line},1,2" for line in reversed(lines_of(60)))]),
            "line 3, time: expected times that increase",
        ),
        (HEAD + "\n" + '"' + "9" * 200_000 + '"\n', "field larger than field limit"),
    ],
)
def test_a_bad_log_is_refused_in_words(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "log.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(hs.ScenarioError) as caught:
        hs.read_log(file)
    assert words in str(caught.value)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("arrival", "exposure", "words"),
    [
        (lambda t: t + 1.79e9, None, "line 3, arrival: expected a time of the log, 0 to 0.59 s, got 1790000000.01"),
        (lambda t: 1e3 * t, None, "line 3, arrival: expected a time of the log, 0 to 0.59 s, got 10"),
        (lambda t: 0.3 - t / 10, None, "line 5, arrival: expected times that do not decrease, got 0.297 after 0.299"),
        (lambda t: t, lambda t: 0 * t, "line 61, exposure: expected times that advance from frame to frame as arriv"),
        (lambda t: t, lambda t: t - 99.0, "line 61, exposure: expected a time of the log, 0 to 0.59 s, got -98.41"),
        (lambda t: t, lambda t: t + 0.5, "line 3, exposure: expected a time before the arrival of the frame at 0.01, "),
    ],
)
def test_frames_on_another_clock_are_refused_by_line_and_column(
    tmp_path: Path, arrival: Callable[[float], float], exposure: Callable[[float], float] | None, words: str
) -> None:
    """A frame in every second line, from the third of the file on."""
    rows = [HEAD + ",x_1,y_1,arrival" + (",exposure" if exposure else "")]
    for tick, row in enumerate(lines_of(60)):
        time = 0.01 * tick
        cells = [1.0, 2.0, arrival(time), *([exposure(time)] if exposure else [])]
        rows.append(",".join([row, *(f"{cell:.12g}" if tick % 2 else "" for cell in cells)]))
    file = tmp_path / "log.csv"
    file.write_text("\n".join(rows), encoding="utf-8")
    with pytest.raises(hs.ScenarioError) as caught:
        hs.read_log(file)
    assert f"log.csv: {words}" in str(caught.value)


def test_a_log_in_memory_names_the_frame_on_another_clock() -> None:
    legs = np.full((60, 6), 0.2)
    frames = Frames(np.ones((2, 2)), np.array([0.1, 1e3]), None)
    with pytest.raises(ValueError, match=r"frame 2, arrival: expected a time of the log, 0 to 0.59 s, got 1000; give"):
        Log(0.01 * np.arange(60.0), 0.01, legs, legs, frames)


def test_a_log_in_memory_names_the_tick_out_of_order() -> None:
    legs = np.full((60, 6), 0.2)
    time = 0.01 * np.arange(60.0)
    with pytest.raises(ValueError, match=r"tick 30, time: expected times that increase, got 0.28 after 0.29; sort"):
        Log(np.where(time == time[30], time[28], time), 0.01, legs, legs, None)


@pytest.mark.parametrize(
    ("time", "words"),
    [
        (
            lambda t: t + 2.0 * (t > 2.995),
            "a tick every 0.01 s, got none for 2.01 s from 2.99 s after the first on; cut",
        ),
        (
            lambda t: t + 5.0 * (t > 4.995),
            "a tick every 0.01 s, got none for 5.01 s from 4.99 s after the first on; cut",
        ),
        (
            lambda t: t + 5.0 * (t > 9.985),
            "a tick every 0.01 s, got none for 5.01 s from 9.98 s after the first on; cut",
        ),
        (lambda t: 100.0 * t, r"got one every 1: are they in ms\? .* A count of ticks is none of seconds: multiply"),
        (lambda t: t - 0.01 * (t == t[500]), "tick 500, time: .* got 4.99 after 4.99; keep one of the two ticks"),
    ],
)
def test_pauses_counts_and_repeated_times_are_named(time: Callable[[Array], Array], words: str) -> None:
    legs = np.full((1000, 6), 0.2)
    times = np.round(time(0.01 * np.arange(1000.0)), 9)
    with pytest.raises(ValueError, match=words):
        Log(times, period_of(times), legs, legs, None)


def test_special_files_are_refused_at_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, tmp_path, Path("/dev/zero"), tmp_path / "none.csv"):
        with pytest.raises(hs.ScenarioError, match="cannot be read"):
            hs.read_log(path)
    (tmp_path / "wide.csv").write_bytes(HEAD.encode("utf-16"))
    with pytest.raises(hs.ScenarioError, match="expected UTF-8 text, got UTF-16; save the file as UTF-8"):
        hs.read_log(tmp_path / "wide.csv")
    (tmp_path / "latin.csv").write_bytes(b"\xb5\n")
    with pytest.raises(hs.ScenarioError, match="UTF-8"):
        hs.read_log(tmp_path / "latin.csv")


def test_a_log_without_motion_gives_no_drive(paper: hs.Scenario, tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("\n".join([HEAD, *lines_of(60)]), encoding="utf-8")
    found = hs.identify(file, paper)
    assert found.drives.moved == []
    assert found.drives.section().verdict == "open"
    assert "actuators.kind" not in found.changes


def near_home(machine: hs.Scenario, ticks: int = 60) -> Log:
    """A log of legs that are within a tenth of the stroke of the middle of their travel."""
    middle = _core.Hexapod(core_parameters(machine).robot).mid_lengths
    legs = middle + 0.1 * machine.robot.stroke * np.random.default_rng(SEED).uniform(-1.0, 1.0, (ticks, 6))
    return Log(0.01 * np.arange(float(ticks)), 0.01, legs, legs, None)


@pytest.mark.parametrize(
    ("machine", "change", "words"),
    [
        ("pi-h824", lambda q: 1e3 * q, "near 0.18 m (travel +-0.0112 m), got 180 (median): are they in mm?"),
        ("pi-h824", lambda q: q - 0.18, "are they counted from home?"),
        ("pi-h824", lambda q: 1e3 * (q - 0.175), "are they in mm, and counted from home?"),
        ("pi-h824", lambda q: -q, "are their signs reversed?"),
        ("pi-h824", lambda q: q + 0.1, "is this a log of the machine in the scenario, in m?"),
        ("pi-h824", lambda q: 0.627 * np.array([1, -1] * 3) + 0 * q, "are they angles of cranks?"),
        (
            "pi-h824",
            lambda q: np.where(np.arange(60)[:, None] == 7, q + 1.0, q),
            "0.07 s after the first tick: is",
        ),
        ("reachy-mini-head", np.degrees, "near 0.627 rad (travel +-0.77 rad), got"),
        ("reachy-mini-head", np.degrees, "are they in degrees?"),
        ("reachy-mini-head", lambda q: -q, "are their signs reversed?"),
        ("reachy-mini-head", lambda q: q[:, [0, 2, 4, 1, 3, 5]], "are the legs in another order?"),
        ("reachy-mini-head", lambda q: 0.18 + 0 * q, "are they lengths in m?"),
    ],
)
def test_legs_that_are_out_of_reach_are_refused(machine: str, change: Callable[[Array], Array], words: str) -> None:
    scenario = hs.load_scenario(machine)
    log = near_home(scenario)
    for name in ("commands", "joints"):
        if name == "commands":
            wrong = replace(log, commands=change(log.commands))
        else:
            wrong = replace(log, joints=change(log.joints))
        with pytest.raises(hs.ScenarioError) as caught:
            require_reach(wrong, scenario)
        assert str(caught.value).startswith(f"{name}: expected ")
        assert words in str(caught.value)


@pytest.mark.parametrize("machine", ["pi-h824", "reachy-mini-head"])
def test_legs_a_little_beyond_their_stroke_are_not_refused(machine: str) -> None:
    scenario = hs.load_scenario(machine)
    log = near_home(scenario)
    require_reach(replace(log, commands=log.commands + 0.8 * scenario.robot.stroke), scenario)
    jump = np.where(np.arange(60)[:, None] < 20, 1.5 * scenario.robot.stroke, 0.0)
    require_reach(replace(log, joints=log.joints - jump), scenario)
    joints = log.joints.copy()
    joints[17, 2] += 4.0 * scenario.robot.stroke
    with pytest.raises(hs.ScenarioError, match=r"of leg 3 near .* is the reading wrong\?"):
        require_reach(replace(log, joints=joints), scenario)


def test_the_command_names_the_file_of_legs_out_of_reach(tmp_path: Path) -> None:
    """Angles of cranks for a machine with prismatic legs: a message, and no traceback."""
    table = np.column_stack([0.01 * np.arange(60.0), *[np.full(60, 0.6 * (-1) ** leg) for leg in range(12)]])
    log = tmp_path / "cranks.csv"
    np.savetxt(log, table, delimiter=",", header=HEAD, comments="")
    done = CliRunner().invoke(app, ["identify", str(log), "--machine", "pi-h824"])
    assert done.exit_code == 2
    assert "cranks.csv: commands: expected lengths of leg" in done.output


def test_a_log_in_memory_names_what_is_no_number() -> None:
    joints = np.full((60, 6), 0.2)
    joints[7, 2] = np.nan
    with pytest.raises(ValueError, match="joints: expected finite numbers, got nan of leg 3 at tick 7"):
        Log(0.01 * np.arange(60.0), 0.01, np.full((60, 6), 0.2), joints, None)


def test_other_types_are_refused() -> None:
    with pytest.raises(TypeError, match="machine"):
        hs.identify("log.csv", "paper")  # type: ignore[arg-type]
    lists: dict[str, Any] = {
        "time": (0.01 * np.arange(60.0)).tolist(),
        "period": 0.01,
        "commands": [[0.0] * 6] * 60,
        "joints": np.zeros((60, 6), dtype=int),
        "frames": None,
    }
    assert Log(**lists).commands.shape == (60, 6)
    for key, value, words in (
        ("commands", [[1.0, 2.0]], r"^commands: expected \(60, 6\) finite numbers, got shape \(1, 2\)$"),
        ("commands", [["0"] * 6] * 60, r"^commands: expected real numbers, got "),
        ("joints", np.full((60, 6), 1j), r"^joints: expected real numbers, got "),
        ("time", 3.0, r"^time: expected \(n,\) finite numbers, got shape \(\)$"),
        ("period", "1", r"^period: expected a number of seconds, got str$"),
        ("frames", [], r"^frames: expected Frames or None, got list$"),
    ):
        with pytest.raises((TypeError, ValueError), match=words):
            Log(**{**lists, key: value})
    assert MOST_DELAY == 8


def test_single_late_ticks_are_no_uneven_log() -> None:
    """As of a program on a computer's clock: the first, the last or one in 50, by up to half a period."""
    even = 0.02 * np.arange(1000.0)

    def log_of(late: Array) -> Log:
        time = even + late
        return Log(time, period_of(time), np.zeros((1000, 6)), np.zeros((1000, 6)), None)

    single = np.zeros(1000)
    for places in ([0], [999], [400], list(range(0, 1000, 50))):
        late = single.copy()
        late[places] = 0.0099
        assert log_of(late).step_near(0.02) == 0.02
        assert log_of(late).period == pytest.approx(0.02, rel=1e-9)
    for late in (
        np.where(even == even[400], 0.0101, 0.0),  # more than half a period
        np.where(np.arange(1000) % 40 == 7, 0.002, 0.0),  # one in 40
        *(np.where(even > even[row], 0.02, 0.0) for row in (1, 300, 499, 998)),  # a row is missing
    ):
        with pytest.raises(ValueError, match="expected a tick every"):
            log_of(late)
