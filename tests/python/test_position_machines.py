"""Programs for machines that take positions: they reach the goal, and stop safely whatever the other side does."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import gcs.__main__
import hexservo as hs
import reachy.__main__
from gcs.client import AXES, GcsHexapod, GcsLink, from_pose, to_pose
from gcs.controller import Controller
from position_machines.clock import SimulatedClock, interrupts
from position_machines.frames import Camera, camera_server, frame_of, numbers, object_of, report_of
from position_machines.kinematics import Kinematics
from position_machines.lines import LONGEST, Line, LinkError, Server, answering
from position_machines.program import _report, main
from position_machines.servo import Ending, Frame, Limits, LogFile, Reading, Stop, excitation, is_new, run, tracking
from position_machines.simulated import Drives, SimulatedMachine
from reachy.head import DRIVES, WATCHDOG, Head, head_handler, head_server, simulated_scenario
from recorded_machines import Drive, wandering
from test_docs import ROOT

Array = NDArray[np.float64]
Handler = Callable[[bytes], bytes | None]
SEED = 20270301
PERIOD = 0.02


def positioned(scenario: hs.Scenario, step: float, **changes: Any) -> hs.Scenario:
    camera = {key: getattr(simulated_scenario().camera, key) for key in ("period", "latency")}
    values = {
        "simulation.mode": "sampled",
        "simulation.step": step,
        "actuators.kind": "position",
        "actuators.delay": 0.0,
        **{f"camera.{key}": value for key, value in camera.items()},
        **changes,
    }
    return scenario.updated(values)


def head_scenario() -> hs.Scenario:
    drives = {"bandwidth": DRIVES.bandwidth, "damping": DRIVES.damping, "speed_limit": DRIVES.speed}
    response = {f"actuators.position.{key}": value for key, value in drives.items()}
    return positioned(hs.load_scenario("reachy-mini-head"), PERIOD, **response, **{"actuators.delay": DRIVES.delay})


def hexapod_scenario() -> hs.Scenario:
    changes = {"camera.period": 0.05, "camera.latency": 0.1, "actuators.position.bandwidth": 5.0}
    return positioned(hs.load_scenario("pi-h824"), 0.05, **changes)


@pytest.fixture
def connect() -> Iterator[Callable[..., Line]]:
    """Connects to a port, with a time limit [s]; lines are closed at the end."""
    lines: list[Line] = []

    def connected(port: int, timeout: float = 5.0) -> Line:
        lines.append(Line("127.0.0.1", port, timeout))
        return lines[-1]

    yield connected
    for line in lines:
        line.close()


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def head(clock: SimulatedClock) -> SimulatedMachine:
    return SimulatedMachine(simulated_scenario(), DRIVES, clock, WATCHDOG)


def at_rest(machine: SimulatedMachine, clock: SimulatedClock) -> bool:
    """Whether the legs stay where they are for a second."""
    before = machine.legs()
    clock.wait_until(clock.now() + 1.0, threading.Event())
    return bool(np.array_equal(machine.legs(), before))


def track(
    port: int,
    clock: SimulatedClock,
    seconds: float = 1.0,
    timeout: float = 5.0,
    event: threading.Event | None = None,
    scenario: hs.Scenario | None = None,
) -> Ending:
    """Track with the head's law through a link of this timeout."""
    scenario = scenario or head_scenario()
    limits = Limits.of(Kinematics(scenario))
    machine = Head(Line("127.0.0.1", port, timeout), 4, clock)
    decide = tracking(hs.Controller(scenario), limits)
    return run(machine, decide, limits, PERIOD, seconds, clock, event or threading.Event())


def test_ends_of_an_uneven_stroke_are_those_of_the_legs() -> None:
    scenario = simulated_scenario()
    size = scenario.robot.stroke
    kinematics = Kinematics(scenario.updated({"robot.stroke": [-0.4 * size, 1.2 * size]}))
    np.testing.assert_allclose(kinematics.lowest, kinematics.home_legs - 0.4 * size, rtol=1e-12)
    np.testing.assert_allclose(kinematics.highest, kinematics.home_legs + 1.2 * size, rtol=1e-12)


def test_an_image_that_is_read_twice_is_one(tmp_path: Path, clock: SimulatedClock) -> None:
    """A real clock gives a frame a somewhat different exposure at each reading."""
    period = 0.04
    legs = Kinematics(head_scenario()).home_legs
    features = np.array([-20.0, 20.0, 20.0, 20.0, 20.0, -20.0, -20.0, -20.0])
    log = LogFile(str(tmp_path / "log.csv"), 4, period)
    for tick in range(20):  # two for each frame
        now, frame = 0.02 * tick, tick // 2
        exposed = period * frame - 0.03 + 1e-4 * (tick % 3)
        log.write(now, legs, Reading(legs, Frame(features + 1e-3 * frame, np.full(4, -1.0), exposed)))
    log.close()
    rows = (tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert [row.endswith(",") for row in rows] == [False, True] * 10
    still = Frame(features, np.full(4, -1.0), 1.0)
    assert not is_new(Frame(features, np.full(4, -1.0), 1.001), still, period)
    assert is_new(Frame(features, np.full(4, -1.0), 1.04), still, period)  # nothing moves, and the camera goes on
    assert not is_new(Frame(features + 1.0, np.full(4, -1.0), 0.96), still, period)  # one that was overtaken


# ---- The simulated machine ------------------------------------------------------------------------------------------


def test_simulated_drives_follow_as_those_of_scipy(clock: SimulatedClock) -> None:
    random = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    scenario = simulated_scenario().updated({"sensors.resolution": 0.0})
    home = Kinematics(scenario).home_legs
    for drives, tolerance in (
        (Drives(4.0, 0.9, 0.04, np.inf), 1e-12),  # exact from step to step
        (Drives(4.0, 0.9, 0.04, 1.0), 3e-3),  # a step of 1 ms at this speed where the limit begins and ends
    ):
        machine = SimulatedMachine(scenario, drives, clock)
        commands = home + wandering(random, 200, PERIOD, 0.1, 0.3)
        commands[:3] = home
        start, followed = clock.now(), []
        for tick, command in enumerate(commands):
            clock.wait_until(start + tick * PERIOD, threading.Event())
            followed.append(machine.legs())
            machine.command(command)
        reference = Drive(drives.bandwidth, drives.damping, 2, drives.speed).follow(commands[:, 1], PERIOD)
        np.testing.assert_allclose(np.array(followed)[:, 1], reference, rtol=0, atol=tolerance)


def test_images_are_as_late_as_the_camera(clock: SimulatedClock, head: SimulatedMachine) -> None:
    ages = set()
    for tick in range(1, 40):
        clock.wait_until(tick * PERIOD, threading.Event())
        found = head.frame()
        assert (found is None) == (tick * PERIOD < 0.2 - 1e-9)
        ages |= set() if found is None else {round(found[1], 9)}
    assert ages == {0.2, 0.22}
    (features, depth), error = (lambda frame: (frame.features, frame.depth))(head.frame()[0]), head.error()  # type: ignore[index]
    true = hs.project(simulated_scenario(), np.zeros(6))
    assert np.abs(features - true).max() < 5 * head.scenario.camera.noise
    np.testing.assert_allclose(depth, -0.6, rtol=1e-6)
    assert error == pytest.approx(np.abs(true - np.array(head.scenario.target.desired_features)).max())


def test_a_head_without_commands_stops(clock: SimulatedClock, head: SimulatedMachine) -> None:
    head.command(head.legs() + 0.5 * np.array([1, -1, 1, -1, 1, -1]))  # up
    clock.wait_until(WATCHDOG + 0.01, threading.Event())
    head.legs()
    assert head.holds
    assert np.abs(head.legs() - Kinematics(head.scenario).home_legs).max() > 0.1
    assert at_rest(head, clock)


# ---- The head -------------------------------------------------------------------------------------------------------


def test_the_head_reaches_its_goal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "head.yaml"
    path.write_text(head_scenario().to_yaml(), encoding="utf-8")
    log = tmp_path / "log.csv"
    given = ["track", "--simulated", "--scenario", str(path), "--seconds", "3", "--out", str(log)]
    assert main(reachy.__main__.PROGRAM, given) == 0
    assert "150 ticks of 20 ms; the machine holds its place" in capsys.readouterr().out
    found = hs.read_log(log)
    assert found.frames is not None
    assert found.period == pytest.approx(PERIOD)
    error = np.abs(found.frames.features[-1] - np.array(head_scenario().target.desired_features)).max()
    assert error < 5.0
    assert len(found.frames.arrival) == 70  # 25 a second, the first one after 0.2 s
    assert main(reachy.__main__.PROGRAM, given) == 2  # the log is there already
    assert "File exists" in capsys.readouterr().err


def test_a_scenario_of_motors_runs_and_one_of_another_target_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Drives of the kind `position_torque` take positions, too; the simulated head has the target of its scenario."""
    path = tmp_path / "motors.yaml"
    motors = {"kind": "position_torque", "motor": hs.load_scenario("reachy-mini-motors").actuators.motor.model_dump()}
    changes = {f"actuators.{key}": value for key, value in motors.items()} | {"simulation.substeps": 10}
    path.write_text(head_scenario().updated(changes).to_yaml(), encoding="utf-8")
    given = ["track", "--simulated", "--seconds", "3", "--scenario"]
    assert main(reachy.__main__.PROGRAM, [*given, str(path)]) == 0
    assert "150 ticks of 20 ms; the machine holds its place" in capsys.readouterr().out
    assert main(reachy.__main__.PROGRAM, [*given, "reachy-mini-motors"]) == 1
    words = "target: expected 4 points, those in the simulated head's images, got 5"
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("known", [True, False], ids=["stamped", "unknown latency"])
def test_the_head_tracks(clock: SimulatedClock, head: SimulatedMachine, known: bool) -> None:
    """The law `tracking`, also where it has to find the latency itself; with the noise that `check` names for it."""
    law = {
        "controller.law": "tracking",
        "controller.tracking.noise": 1.2,
        "camera.prediction": "none",
        "camera.latency_known": known,
    }
    with head_server(head) as server:
        ending = track(server.port, clock, seconds=3.0, scenario=head_scenario().updated(law))
        assert not ending.reason
        assert head.error() < 5.0


def test_scenarios_that_do_not_fit_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "slow.yaml"
    path.write_text(head_scenario().updated({"simulation.step": 0.04, "actuators.delay": 0.0}).to_yaml())
    for scenario, words in (
        ("reachy-mini-head", "actuators.kind: expected one that takes positions, got force"),
        (str(path), "simulation.step: expected 0.02 s"),
        ("none", "none"),
    ):
        assert main(reachy.__main__.PROGRAM, ["track", "--simulated", "--scenario", scenario]) == 2
        assert words in capsys.readouterr().err
    for size, words in (
        ("2", "would be sent by a jump at"),
        ("0.3", "--jump: expected at most 0.2566, got 0.3: a jump is up to twice as long, and legs may be 0.5131 away"),
        ("0", "--jump: expected more than 0, got 0"),
        ("nan", "--jump: expected more than 0, got nan"),
    ):
        jump = ["record", "--simulated", "--jump", size, "--out", str(tmp_path / "log.csv")]
        assert main(reachy.__main__.PROGRAM, jump) == 2
        assert words in capsys.readouterr().err
    for wrong in (["track"], ["track", "--simulated", "--port", "1"], ["track", "--simulated", "--seconds", "nan"]):
        with pytest.raises(SystemExit, match="2"):
            main(reachy.__main__.PROGRAM, wrong)
    for _ in range(2):  # the first leaves no log that would be in the way of the second
        assert main(reachy.__main__.PROGRAM, ["record", "--port", "1", "--out", str(tmp_path / "log.csv")]) == 1
        assert "no connection" in capsys.readouterr().err
    nowhere = ["record", "--port", "1", "--out", str(tmp_path / "folder" / "log.csv")]
    assert main(reachy.__main__.PROGRAM, nowhere) == 2  # before anything is asked of the machine
    assert "No such file" in capsys.readouterr().err


def with_fault(machine: SimulatedMachine, request: int, reply: bytes | None) -> Server:
    """A head that gives this reply to one request; a connection made afterwards works again."""
    count = 0

    def handler() -> Handler:
        handle = head_handler(machine)

        def faulty(data: bytes) -> bytes | None:
            nonlocal count
            count += 1
            return reply if count == request + 1 else handle(data)

        return faulty

    return Server(handler)


def reading(**changes: Any) -> bytes:
    """A reply to a read, with changes."""
    home = Kinematics(simulated_scenario()).home_legs.tolist()
    frame = {"features": [1000.0] * 8, "depth": [-0.6] * 4, "age": 0.1}
    content = {"legs": home, "frame": frame | changes.pop("frame", {}), **changes}
    return json.dumps(content).encode() + b"\n"


FAULTS: dict[str, tuple[bytes | None, str]] = {
    "closed": (None, "closed by the other side"),
    "garbage": (b"\xff\xfe\x00garbage\n", "expected a line with a JSON object"),
    "text": (b'"text"\n', "expected a line with a JSON object"),
    "deep": (b"[" * 8000 + b"\n", "expected a line with a JSON object"),
    "oversized": (b"x" * (LONGEST + 5000), f"at most {LONGEST} bytes"),
    "oversized-line": (b"x" * (LONGEST + 100) + b"\n", f"at most {LONGEST} bytes"),
    "two": (reading() + reading(), "sent what was not asked for"),
    "refusal": (b'{"error": "motors are off"}\n', "the head refuses: motors are off"),
    "empty": (b"{}\n", "legs: expected 6 finite numbers"),
    "five": (reading(legs=[0.0] * 5), "legs: expected 6 finite numbers"),
    "words": (reading(legs=["0"] * 6), "legs: expected 6 finite numbers"),
    "nan": (reading(legs=[float("nan")] * 6), "legs: expected 6 finite numbers"),
    "huge": (reading(legs=[1e300] * 6), "legs: expected 6 finite numbers"),
    "outside": (reading(legs=[2.0] * 6), "leg 1 is at 2, expected"),
    "age": (reading(frame={"age": -1.0}), "age: expected 0 to"),
    "points": (reading(frame={"features": [1.0] * 6}), "features: expected 8 finite numbers"),
    "depth": (reading(frame={"depth": None}), "depth: expected 4 finite numbers"),
    "stale": (reading(frame={"age": 0.5}), "the newest image is 0.500 s old"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_head_is_stopped_whatever_comes(clock: SimulatedClock, head: SimulatedMachine, fault: str) -> None:
    reply, words = FAULTS[fault]
    with with_fault(head, 20, reply) as server:
        ending = track(server.port, clock)
        assert words in ending.reason
        assert ending.ticks == 10
        assert ending.stopped
        assert not ending.details
        assert head.holds
        assert at_rest(head, clock)


@pytest.mark.parametrize("reply", [b'{"ok": false}\n', b'{"ok": 1}\n', b"{}\n"])
def test_the_head_is_stopped_where_a_command_is_not_confirmed(
    clock: SimulatedClock, head: SimulatedMachine, reply: bytes
) -> None:
    with with_fault(head, 21, reply) as server:  # a read and a command in each tick
        ending = track(server.port, clock)
        assert ending.reason == "the head did not confirm a request"
        assert ending.ticks == 10
        assert ending.stopped
        assert at_rest(head, clock)


def test_a_stop_that_is_not_confirmed_is_reported(clock: SimulatedClock, connect: Callable[..., Line]) -> None:
    with Server(lambda: answering(lambda _: b'{"ok": false}\n')) as server:
        machine = Head(connect(server.port), 4, clock)
        limits = Limits.of(Kinematics(head_scenario()))
        ending = run(machine, lambda *_: limits.lowest, limits, PERIOD, 0.0, clock, threading.Event())
    assert not ending.stopped
    assert ending.details == ["the machine did not confirm that it stops: the head did not confirm a request"]


@pytest.mark.parametrize("reply", [b"", b'{"legs": [0.1'], ids=["silent", "partial"])
def test_a_head_that_does_not_answer_is_left_in_time(
    clock: SimulatedClock, head: SimulatedMachine, reply: bytes
) -> None:
    with with_fault(head, 0, reply) as server:
        ending = track(server.port, clock, timeout=0.3)
    assert "no reply within 0.3 s" in ending.reason
    assert ending.stopped


def test_a_head_that_is_gone_stops_by_itself(
    clock: SimulatedClock, head: SimulatedMachine, connect: Callable[..., Line]
) -> None:
    server = head_server(head)
    event = threading.Event()
    with server:
        machine = Head(connect(server.port), 4, clock)
        scenario = head_scenario()
        limits = Limits.of(Kinematics(scenario))
        decide = tracking(hs.Controller(scenario), limits)

        def cut(now: float, reading: Reading) -> Array:
            if now > 0.5:
                server.__exit__(None, None, None)
            return decide(now, reading)

        ending = run(machine, cut, limits, PERIOD, 2.0, clock, event)
    assert ending.reason
    assert not ending.stopped
    assert "did not confirm that it stops" in ending.details[0]
    clock.wait_until(clock.now() + WATCHDOG + 0.01, event)
    head.legs()
    assert head.holds


def test_stale_images_blocked_legs_and_late_ticks_end_the_loop(
    clock: SimulatedClock, connect: Callable[..., Line]
) -> None:
    def ending_of(change: Callable[[SimulatedMachine, float], None]) -> Ending:
        machine = SimulatedMachine(simulated_scenario(), DRIVES, clock, None)
        with head_server(machine) as server:
            scenario = head_scenario()
            limits = replace(Limits.of(Kinematics(scenario)), lag=0.1)
            decide = tracking(hs.Controller(scenario), limits)
            link = Head(connect(server.port), 4, clock)
            start = clock.now()

            def changing(now: float, reading: Reading) -> Array:
                change(machine, clock.now() - start)
                return decide(now, reading)

            ending = run(link, changing, limits, PERIOD, 3.0, clock, threading.Event())
            assert ending.stopped
            assert at_rest(machine, clock)
            return ending

    def camera_fails(machine: SimulatedMachine, now: float) -> None:
        machine.camera_works = now < 0.5

    def cranks_block(machine: SimulatedMachine, now: float) -> None:
        machine._state[1] = 0.0
        machine._state[0] = Kinematics(machine.scenario).home_legs

    def computer_sleeps(_: SimulatedMachine, now: float) -> None:
        if 0.5 < now < 0.6:
            clock.wait_until(clock.now() + 0.4, threading.Event())

    assert "the newest image is 0.4" in ending_of(camera_fails).reason
    assert "away from its command, expected at most 0.1" in ending_of(cranks_block).reason
    assert "s late, expected at most 0.25 s" in ending_of(computer_sleeps).reason


class Followed:
    """Legs that are at once where they are sent, and the times of the commands [s]."""

    def __init__(self, clock: SimulatedClock, legs: Array) -> None:
        self._clock, self.legs = clock, legs
        self.times: list[float] = []
        self.commands: list[Array] = []
        self.stopped = False

    def read(self) -> Reading:
        return Reading(self.legs, None)

    def command(self, legs: Array) -> None:
        self.times.append(self._clock.now())
        self.commands.append(legs)
        self.legs = legs

    def stop(self) -> None:
        self.stopped = True


def test_periods_that_pass_during_a_tick_are_not_made_up_for(clock: SimulatedClock) -> None:
    """A decision moves by a step of a period, and so do the legs, however long the computer was busy with a tick."""
    limits = Limits.of(Kinematics(head_scenario()))
    home, speed, hang = Kinematics(head_scenario()).home_legs, 0.5, 0.2
    machine = Followed(clock, home)

    def decide(now: float, _: Reading) -> Array:
        if now == 10 * PERIOD:
            clock.wait_until(clock.now() + hang, threading.Event())
        return home + speed * PERIOD * len(machine.commands)

    ending = run(machine, decide, limits, PERIOD, 1.0, clock, threading.Event())
    gaps = np.diff(machine.times)
    assert not ending.reason
    assert (gaps > 0.0).all()
    assert (np.abs(np.diff(machine.commands, axis=0)).max(axis=1) <= speed * gaps * (1 + 1e-9)).all()
    assert machine.times[-1] < 1.0
    assert ending.ticks == 50 - round(hang / PERIOD)
    assert ending.details == ["the computer was late: 0.200 s passed without commands, ticks are uneven"]


def test_the_law_goes_on_after_dropped_periods(clock: SimulatedClock, head: SimulatedMachine) -> None:
    """Times of images and readings are those of the clock: a missing tick leaves latency and lag as they are."""
    scenario = head_scenario()
    limits = Limits.of(Kinematics(scenario))
    with head_server(head) as server:
        machine = Head(Line("127.0.0.1", server.port, 5.0), 4, clock)
        decide = tracking(hs.Controller(scenario), limits)
        hung: list[float] = []

        def hanging(now: float, reading: Reading) -> Array:
            if now > 0.3 + 0.4 * len(hung) and len(hung) < 3:
                hung.append(now)
                clock.wait_until(clock.now() + 0.2, threading.Event())
            return decide(now, reading)

        ending = run(machine, hanging, limits, PERIOD, 3.0, clock, threading.Event())
        assert not ending.reason
        assert len(hung) == 3
        assert head.error() < 5.0


def test_a_command_far_from_the_legs_is_not_sent(clock: SimulatedClock) -> None:
    kinematics = Kinematics(head_scenario())
    limits = Limits.of(kinematics)
    machine = Followed(clock, kinematics.home_legs + 0.6)
    ending = run(machine, lambda *_: kinematics.home_legs, limits, PERIOD, 1.0, clock, threading.Event())
    assert "is 0.6 away from its command, expected at most 0.5131" in ending.reason
    assert machine.stopped
    assert not machine.commands


@pytest.mark.parametrize("end", ["lowest", "highest"])
def test_a_command_beyond_the_stroke_is_not_sent(clock: SimulatedClock, end: str) -> None:
    """By the loop itself, which does not leave that to the machine; legs may be as far away as they like."""
    kinematics = Kinematics(head_scenario())
    limits = replace(Limits.of(kinematics), lag=np.inf)
    beyond = kinematics.home_legs.copy()
    beyond[2] = getattr(limits, end)[2] + (1e-3 if end == "highest" else -1e-3)
    machine = Followed(clock, kinematics.home_legs)
    ending = run(machine, lambda *_: beyond, limits, PERIOD, 1.0, clock, threading.Event())
    assert ending.reason.startswith(f"leg 3 was to be sent at {beyond[2]:.4g}, expected ")
    assert machine.stopped
    assert not machine.commands


def test_a_log_begins_where_the_head_is(clock: SimulatedClock) -> None:
    kinematics = Kinematics(head_scenario())
    jump, speed = 0.15, 0.2
    machine = Followed(clock, kinematics.home_legs + 0.6)
    decide = excitation(kinematics.home_legs, jump, 0.4, speed)
    ending = run(machine, decide, Limits.of(kinematics), PERIOD, 6.0, clock, threading.Event())
    assert not ending.reason
    commands = np.array(machine.commands)
    way = np.array(machine.times) < 0.6 / speed
    np.testing.assert_allclose(commands[0], kinematics.home_legs + 0.6, rtol=0, atol=1e-12)
    assert np.abs(np.diff(commands[way], axis=0)).max() <= speed * PERIOD * (1 + 1e-9)
    assert np.abs(commands[~way] - kinematics.home_legs).max() <= jump
    assert np.abs(commands[~way] - kinematics.home_legs).max() > 0.9 * jump


def test_record_moves_a_head_that_is_not_at_home_slowly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    home, away = Kinematics(simulated_scenario()).home_legs, 0.6 * np.array([1, -1, 1, -1, 1, -1])  # up
    sent: list[Array] = []

    class Elsewhere(SimulatedMachine):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            for share in np.linspace(0.0, 1.0, 10):  # a pose is found from one that is near
                self._kinematics.pose(home + share * away)
            self._state[0] += away
            self._command = self._state[0].copy()

        def command(self, legs: Array, at: float | None = None) -> None:
            sent.append(np.array(legs))
            super().command(legs, at)

    monkeypatch.setattr(reachy.__main__, "SimulatedMachine", Elsewhere)
    given = ["record", "--simulated", "--seconds", "5", "--out", str(tmp_path / "log.csv")]
    assert main(reachy.__main__.PROGRAM, given) == 0, capsys.readouterr().err
    limits = Limits.of(Kinematics(simulated_scenario()))
    legs = np.array([[float(row.split(",")[7])] for row in (tmp_path / "log.csv").read_text().splitlines()[1:]])
    assert np.abs(np.array(sent)[:, :1] - legs).max() < limits.lag
    assert np.abs(sent[0] - home - away).max() < simulated_scenario().sensors.resolution
    assert np.abs(sent[-1] - home).max() <= 0.15


def test_an_interrupt_stops_the_head(clock: SimulatedClock, head: SimulatedMachine) -> None:
    event = threading.Event()
    event.set()
    with head_server(head) as server:
        ending = track(server.port, clock, event=event)
        assert ending.interrupted
        assert ending.stopped
        assert head.holds


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_program_after_the_stop(tmp_path: Path, number: signal.Signals) -> None:
    if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
        pytest.skip("a hangup that is ignored here is ignored in the program too")
    path = tmp_path / "head.yaml"
    path.write_text(head_scenario().to_yaml(), encoding="utf-8")
    command = [sys.executable, "-m", "reachy", "track", "--simulated", "--scenario", str(path), "--seconds", "3600"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(ROOT / "examples")])}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "reachy: running, Ctrl-C stops\n"
        program.send_signal(number)
        if number != signal.SIGINT:  # a terminal that closes sends two of them
            program.send_signal(number)
        _, errors = program.communicate(timeout=30)
    assert program.returncode == 130
    assert "interrupted" in errors
    assert "did not confirm" not in errors


def test_a_hangup_that_is_ignored_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with interrupts() as event:
            signal.raise_signal(signal.SIGHUP)
            assert not event.is_set()
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with interrupts() as event:
            signal.raise_signal(signal.SIGHUP)
            assert event.is_set()
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


# ---- Lines ----------------------------------------------------------------------------------------------------------


def test_lines_arrive_in_pieces_and_several_at_once() -> None:
    handle = answering(lambda line: line.upper() + b"\n")
    assert handle(b"a") == b""
    assert handle(b"b\nc\nd") == b"AB\nC\n"
    assert handle(b"x" * LONGEST) is None
    assert answering(lambda _: None)(b"a\n") is None


def test_a_server_is_reached_from_this_computer_alone(connect: Callable[..., Line]) -> None:
    with Server(lambda: lambda data: data) as server:
        assert server._listening.getsockname()[0] == "127.0.0.1"
        lines = [connect(server.port) for _ in range(4)]
        for line in lines:
            line.send(b"a\r\n")
            assert line.receive() == b"a"
        extra = connect(server.port)  # a fifth one is closed
        with pytest.raises(LinkError):
            extra.receive()
        server.drop()
        with pytest.raises(LinkError, match="closed by the other side"):
            lines[0].receive()
        with pytest.raises(LinkError, match="was closed before"):
            lines[0].send(b"a\n")


def test_values_of_json_are_checked() -> None:
    for value in (None, [1.0], [1, 2, True], [1, 2, float("inf")], {"a": 1}, [10**400, 1, 2]):
        with pytest.raises(LinkError):
            numbers(value, 3, "x")
    np.testing.assert_array_equal(numbers([1, 2.5, -3], 3, "x"), [1, 2.5, -3])
    assert frame_of(None, 4, 0.0) is None
    with pytest.raises(LinkError, match="frame"):
        frame_of([1], 4, 0.0)
    with pytest.raises(LinkError):
        object_of(b"[" * 100_000)


def test_a_lost_point_is_null_on_the_link_and_blank_in_the_log(tmp_path: Path) -> None:
    content = {"features": [1, 2, 3, 4, 5, 6, None, None], "depth": [-0.5] * 4, "age": 0.05}
    frame = frame_of(content, 4, 1.0)
    assert frame is not None
    np.testing.assert_array_equal(frame.features, [1, 2, 3, 4, 5, 6, np.nan, np.nan])
    assert report_of((frame, 0.05)) == content
    for wrong in ([1, 2, 3, 4, 5, 6, 7, None], [1, 2, 3, 4, 5, None], "12345678", [None] * 7):
        with pytest.raises(LinkError, match=r"^features: expected"):
            frame_of({**content, "features": wrong}, 4, 1.0)
    legs = Kinematics(head_scenario()).home_legs
    log = LogFile(str(tmp_path / "log.csv"), 4, 0.04)
    for tick in range(60):
        log.write(0.02 * tick, legs, Reading(legs, frame if tick < 2 else Frame(np.arange(8.0), frame.depth, 1.0)))
    log.close()
    rows = (tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()
    assert rows[1].endswith(",1,2,3,4,5,6,,,0")
    assert rows[2].endswith(",,,,,,,,,")  # the same image again
    frames = hs.read_log(tmp_path / "log.csv").frames
    assert frames is not None
    np.testing.assert_array_equal(frames.features, [[1, 2, 3, 4, 5, 6, np.nan, np.nan], np.arange(8.0)])


@pytest.mark.parametrize(("lost", "ends"), [(slice(6, 8), False), (slice(0, 8), True)])
def test_an_image_counts_where_it_shows_a_point(lost: slice, ends: bool) -> None:
    """Points are lost from 0.5 s on; an image without any is none, and the loop ends 0.4 s after the last one."""
    scenario = head_scenario()
    legs = Kinematics(scenario).home_legs
    seen = hs.project(scenario, np.zeros(6))
    less = seen.copy()
    less[lost] = np.nan
    decide = tracking(hs.Controller(scenario), Limits.of(Kinematics(scenario), invalid=10.0))
    for tick in range(50):
        now = PERIOD * tick
        reading = Reading(legs, Frame(seen if tick <= 25 else less, np.full(4, -1.0), now))
        if ends and tick > 45:
            with pytest.raises(Stop, match=r"^the newest image is 0.42\d? s old"):
                decide(now, reading)
            break
        assert np.isfinite(decide(now, reading)).all()


@pytest.mark.parametrize("every", [1, 2])
def test_a_law_that_cannot_act_ends_the_loop(clock: SimulatedClock, every: int) -> None:
    """Depths of the wrong sign from 0.5 s on, in an image at each tick, or with ticks between that have no new one.

    The last good tick is at 0.48 s, or at 0.50 s before the first such image at 0.52 s; the next one beyond 0.3 s ends.
    """
    scenario = head_scenario().updated({"camera.period": every * PERIOD})
    kinematics = Kinematics(scenario)
    assert Limits.of(kinematics).invalid == 0.3
    limits = Limits.of(kinematics, invalid=0.31)  # between two ticks
    machine, seen = Followed(clock, kinematics.home_legs), hs.project(scenario, np.zeros(6))
    decide = tracking(hs.Controller(scenario), limits)

    def wrong(now: float, reading: Reading) -> Array:
        exposure = every * PERIOD * (round(now / PERIOD) // every)
        depth = np.full(4, -0.6 if exposure < 0.5 - 1e-9 else 0.6)
        return decide(now, replace(reading, frame=Frame(seen, depth, exposure)))

    ending = run(machine, wrong, limits, PERIOD, 2.0, clock, threading.Event())
    last = PERIOD * (24 if every == 1 else 25)
    assert ending.reason == "the law cannot act since 0.320 s: unusable"
    assert ending.ticks * PERIOD == pytest.approx(last + 0.32)
    assert machine.stopped


def test_an_exposure_after_the_tick_is_one_at_the_tick() -> None:
    """The age of an image is measured after the tick began; a law that refused such an image would brake."""
    scenario = head_scenario()
    legs, seen = Kinematics(scenario).home_legs, hs.project(scenario, np.zeros(6))
    commands = []
    for later in (0.0, 0.005):
        decide = tracking(hs.Controller(scenario), Limits.of(Kinematics(scenario)))
        ticks = PERIOD * np.arange(25)
        commands.append([decide(now, Reading(legs, Frame(seen, np.full(4, -0.6), now + later))) for now in ticks])
    np.testing.assert_array_equal(commands[0], commands[1])
    assert np.abs(commands[0][-1] - legs).max() > 1e-3


def test_a_last_image_that_lacks_a_point_is_not_the_goal(capsys: pytest.CaptureFixture[str]) -> None:
    last = SimpleNamespace(features=np.r_[np.zeros(6), np.nan, np.nan])
    options = SimpleNamespace(command="track")
    code = _report(reachy.__main__.PROGRAM, options, head_scenario(), last, Ending("", True, 1))  # type: ignore[arg-type]
    assert code == 1
    assert "the last image lacks a point" in capsys.readouterr().out


# ---- Hexapods with a text protocol ----------------------------------------------------------------------------------


@pytest.fixture
def controller(clock: SimulatedClock) -> Controller:
    return Controller(clock)


@pytest.fixture
def link(controller: Controller, connect: Callable[..., Line]) -> Iterator[GcsLink]:
    with controller.server() as server:
        yield GcsLink(connect(server.port))


def test_poses_are_rotations_about_moving_axes_in_a_frame_with_z_up() -> None:
    home = Kinematics(hs.load_scenario("pi-h824")).home
    np.testing.assert_allclose(to_pose(np.array([1.0, 2, 3, 0, 0, 0]), home)[0] - home[0], [1e-3, -2e-3, -3e-3])
    u, v, w = np.radians([5.0, 7.0, 11.0])
    flip = np.diag([1.0, -1.0, -1.0])  # z up, z down
    about = [
        Rotation.from_rotvec(angle * flip @ axis).as_matrix() for angle, axis in zip((u, v, w), np.eye(3), strict=True)
    ]
    attitude = Rotation.from_quat(np.roll(to_pose(np.array([0, 0, 0, 5.0, 7, 11]), home)[1], -1)).as_matrix()
    np.testing.assert_allclose(attitude, about[0] @ about[1] @ about[2], atol=1e-15)
    random = np.random.default_rng(SEED)
    for _ in range(20):
        values = random.uniform(-1, 1, 6) * [20, 20, 10, 7, 7, 12]
        np.testing.assert_allclose(from_pose(to_pose(values, home), home), values, atol=1e-12)


def test_commands_of_the_controller(clock: SimulatedClock, controller: Controller, link: GcsLink) -> None:
    assert link.query("*IDN?", 1) == ["simulated hexapod controller"]
    with pytest.raises(LinkError, match="MOV: the controller has error 5"):
        link.move(np.zeros(6))  # the servo is off
    link.command("SVO X 1 Y 1 Z 1 U 1 V 1 W 1")
    np.testing.assert_array_equal(link.values("TMN?"), -link.values("TMX?"))
    link.command("VLS 2")
    assert link.query("VLS?", 1) == ["2"]
    target = np.array([1.0, -0.5, 0.3, 0.2, -0.1, 0.4])
    link.move(target)
    assert not link.values("ONT?").any()
    assert controller.moving()
    clock.wait_until(clock.now() + 0.25, threading.Event())
    halfway = link.values("POS?")  # 0.5 mm at 2 mm/s, less the delay of 50 ms and the lag 2 zeta/w of 42 ms
    assert halfway[0] == pytest.approx(2.0 * (0.25 - 0.05 - 0.042), abs=0.02)
    clock.wait_until(clock.now() + 2.0, threading.Event())
    assert link.values("ONT?").all()
    np.testing.assert_allclose(link.values("POS?"), target, atol=2e-3)
    np.testing.assert_allclose(link.values("MOV?"), target, atol=1e-6)
    link.move(-target)
    clock.wait_until(clock.now() + 0.2, threading.Event())
    link.stop()
    stopped = link.values("POS?")
    clock.wait_until(clock.now() + 1.0, threading.Event())
    np.testing.assert_array_equal(link.values("POS?"), stopped)
    for command, error in (
        ("MOV X 30", 7),
        ("MOV X 21 Y 21 Z 12", 7),  # each within its range, but not together
        ("MOV Q 1", 15),
        ("MOV X", 1),
        ("MOV X nan", 1),
        ("MOV X 1 X 2", 1),
        ("VLS 0", 17),
        ("VLS 1 2", 1),
        ("SVO X 2", 17),
        ("STP", 10),
        ("XYZ", 2),
    ):
        with pytest.raises(LinkError, match=f"the controller has error {error}$"):
            link.command(command)
    assert link.error() == 0


def gcs_program(clock: SimulatedClock, controller: Controller, port: int, connect: Callable[..., Line]) -> Ending:
    """Track with the hexapod's law, images from the controller's machine."""
    scenario = hexapod_scenario()
    kinematics = Kinematics(scenario)
    limits = Limits.of(kinematics)
    with camera_server(controller.frame) as images:
        camera = Camera(connect(images.port), 4, clock)
        machine = GcsHexapod(GcsLink(connect(port)), camera, kinematics)
        machine.start(20.0, clock, threading.Event())
        return run(machine, tracking(hs.Controller(scenario), limits), limits, 0.05, 3.0, clock, threading.Event())


def test_the_hexapod_reaches_its_goal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "hexapod.yaml"
    path.write_text(hexapod_scenario().to_yaml(), encoding="utf-8")
    given = ["track", "--simulated", "--scenario", str(path), "--seconds", "3"]
    assert main(gcs.__main__.PROGRAM, given) == 0
    assert "60 ticks of 50 ms; the machine holds its place" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main(gcs.__main__.PROGRAM, ["track", "--port", "50000"])
    assert "--port and --camera-port" in capsys.readouterr().err


def gcs_with_fault(controller: Controller, query: bytes, reply: bytes | None, place: int = 12) -> Server:
    """A controller that gives this reply to the query of a kind at a place."""
    count = 0

    def handler() -> Handler:
        handle = controller._handler()

        def faulty(data: bytes) -> bytes | None:
            nonlocal count
            replies = b""
            for line in data.splitlines(keepends=True):  # one segment may carry a command and the query after it
                count += line.startswith(query)
                answer = reply if count == place and line.startswith(query) else handle(line)
                if answer is None:
                    return None
                replies += answer
            return replies

        return faulty

    return Server(handler)


def positions(**values: float) -> bytes:
    numbers = dict.fromkeys(AXES, 0.0) | values
    return " \n".join(f"{axis}={number}" for axis, number in numbers.items()).encode() + b"\n"


GCS_FAULTS: dict[str, tuple[bytes, bytes | None, str]] = {
    "closed": (b"POS?", None, "closed by the other side"),
    "garbage": (b"POS?", b"\xff\x00\n", "expected text"),
    "one": (b"POS?", b"X=1\n", "POS?: expected 6 lines, got 1"),
    "endless": (b"POS?", b"X=1 \n" * 50, "POS?: expected 6 lines, got 33"),
    "twice": (b"POS?", b" \n".join([b"X=1"] * 6) + b"\n", "expected a line like X=1.5"),
    "axis": (b"POS?", positions().replace(b"Y=", b"XY="), "expected a line like X=1.5"),
    "no axis": (b"POS?", positions().replace(b"Y=", b"="), "expected a line like X=1.5"),
    "nan": (b"POS?", positions(W=float("nan")), "expected a line like X=1.5"),
    "overflow": (b"POS?", positions().replace(b"Y=0.0", b"Y=1e999"), "expected finite numbers"),
    "oversized": (b"POS?", b"X=" + b"1" * (LONGEST + 5000), f"at most {LONGEST} bytes"),
    "outside": (b"POS?", positions(X=30.0), "X is at 30, expected -22.5 to 22.5"),
    "leg": (b"POS?", positions(X=20.0, Y=20.0, Z=12.0), "leg 1 is at"),
    "error": (b"ERR?", b"5\n", "the controller has error 5"),
    "no error": (b"ERR?", b"none\n", "ERR?: expected a number"),
    "late": (b"POS?", positions() + b"0\n", "sent what was not asked for"),
}


def test_the_pages_count_the_faults() -> None:
    docs = ROOT / "docs"
    stated = re.search(
        r": (\d+) faults of the other side.*?The same for (\d+) of",
        (docs / "position-machines.md").read_text("utf-8"),
        re.DOTALL,
    )
    assert stated
    assert [int(count) for count in stated.groups()] == [len(FAULTS), len(GCS_FAULTS)]
    every = len(FAULTS) + len(GCS_FAULTS)
    assert f"| {every} of {every} faults |" in (docs / "claims.md").read_text("utf-8")


@pytest.mark.parametrize("fault", GCS_FAULTS)
def test_the_hexapod_is_stopped_whatever_comes(
    clock: SimulatedClock, controller: Controller, connect: Callable[..., Line], fault: str
) -> None:
    query, reply, words = GCS_FAULTS[fault]
    with gcs_with_fault(controller, query, reply) as server:
        ending = gcs_program(clock, controller, server.port, connect)
        assert words in ending.reason
        assert ending.stopped
        assert not controller.moving()
    assert at_rest(controller.machine, clock)


def away_from_home(clock: SimulatedClock, line: Line) -> None:
    """Move the platform of a controller by 10 mm, and end the connection."""
    link = GcsLink(line)
    link.command("SVO X 1 Y 1 Z 1 U 1 V 1 W 1")
    link.command("VLS 20")
    link.move(np.array([10.0, 0, 0, 0, 0, 0]))
    clock.wait_until(clock.now() + 2.0, threading.Event())
    assert link.values("ONT?").all()
    link.close()


def test_a_hexapod_on_its_way_home_is_stopped_whatever_comes(
    clock: SimulatedClock, controller: Controller, connect: Callable[..., Line], monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(port: int) -> None:
        GcsHexapod(GcsLink(connect(port)), None, Kinematics(hexapod_scenario())).start(  # type: ignore[arg-type]
            20.0, clock, threading.Event()
        )

    def fails(*_: object) -> None:
        raise RuntimeError("the clock fails")

    damaged = positions().replace(b"Y=", b"XY=")
    with controller.server() as server, gcs_with_fault(controller, b"ONT?", damaged, place=3) as faulty:
        away_from_home(clock, connect(server.port))
        with pytest.raises(LinkError, match=r"expected a line like X=1\.5"):
            started(faulty.port)
        assert not controller.moving()
        assert 1.0 < controller.position()[0] < 10.0  # on its way
        with monkeypatch.context() as patch:
            patch.setattr(clock, "wait_until", fails)
            with pytest.raises(RuntimeError, match="the clock fails"):
                started(server.port)
        assert not controller.moving()
    assert at_rest(controller.machine, clock)


def test_a_small_velocity_has_the_time_that_it_takes(
    clock: SimulatedClock, controller: Controller, connect: Callable[..., Line]
) -> None:
    with controller.server() as server:
        away_from_home(clock, connect(server.port))
        hexapod = GcsHexapod(GcsLink(connect(server.port)), None, Kinematics(hexapod_scenario()))  # type: ignore[arg-type]
        begin = clock.now()
        hexapod.start(0.5, clock, threading.Event())
        assert "VLS 0.500000" in controller.commands
        assert clock.now() - begin == pytest.approx(10.0 / 0.5, abs=1.0)
        assert not controller.moving()


def test_the_velocity_is_checked(capsys: pytest.CaptureFixture[str]) -> None:
    for wrong in ("0", "-1", "20.1", "nan"):
        with pytest.raises(SystemExit, match="2"):
            main(gcs.__main__.PROGRAM, ["track", "--simulated", "--velocity", wrong])
        assert f"--velocity: expected more than 0 and at most 20, got {wrong}" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(reachy.__main__.PROGRAM, ["track", "--simulated", "--velocity", "1"])


def test_a_reply_of_several_lines_has_one_time_limit() -> None:
    """Of a controller that sends a line whenever the limit for a single one is nearly over."""
    ends = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def trickle() -> None:
            connection, _ = listening.accept()
            with connection:
                for axis in AXES:
                    if ends.wait(0.4):
                        return
                    connection.sendall(f"{axis}=0 \n".encode())

        thread = threading.Thread(target=trickle)
        thread.start()
        line = Line("127.0.0.1", listening.getsockname()[1], 0.5)
        begin = time.monotonic()
        try:
            with pytest.raises(LinkError, match=r"no reply within 0\.5 s"):
                GcsLink(line).values("POS?")
            assert time.monotonic() - begin < 1.0
        finally:
            ends.set()
            line.close()
            thread.join()


def test_a_hexapod_that_is_not_ready_does_not_move(clock: SimulatedClock, connect: Callable[..., Line]) -> None:
    controller = Controller(clock, referenced=False)
    with controller.server() as server, pytest.raises(Stop, match="not referenced"):
        gcs_program(clock, controller, server.port, connect)
    assert not any(line.startswith("MOV") for line in controller.commands)


def test_a_camera_that_is_lost_stops_the_hexapod(
    clock: SimulatedClock, controller: Controller, connect: Callable[..., Line]
) -> None:
    kinematics = Kinematics(hexapod_scenario())
    limits = Limits.of(kinematics)
    with controller.server() as server, camera_server(controller.frame) as images:
        camera = Camera(connect(images.port), 4, clock)
        machine = GcsHexapod(GcsLink(connect(server.port)), camera, kinematics)
        machine.start(20.0, clock, threading.Event())
        decide = tracking(hs.Controller(hexapod_scenario()), limits)

        def cut(now: float, reading: Reading) -> Array:
            if now > 0.5:
                images.drop()
            return decide(now, reading)

        ending = run(machine, cut, limits, 0.05, 3.0, clock, threading.Event())
        assert ending.reason
        assert ending.stopped
        assert not controller.moving()


def test_commands_beyond_the_limits_are_not_sent(
    clock: SimulatedClock, controller: Controller, connect: Callable[..., Line]
) -> None:
    kinematics = Kinematics(hexapod_scenario())
    wide = Limits(kinematics.lowest - 1.0, kinematics.highest + 1.0, 10.0)
    beyond = kinematics.legs(to_pose(np.array([0, 0, 13.0, 0, 0, 0]), kinematics.home))
    with controller.server() as server:
        camera = type("NoCamera", (), {"read": lambda _: Frame(np.zeros(8), -np.ones(4), clock.now())})()
        machine = GcsHexapod(GcsLink(connect(server.port)), camera, kinematics)
        machine.start(20.0, clock, threading.Event())
        ending = run(machine, lambda *_: beyond, wide, 0.05, 1.0, clock, threading.Event())
        assert "Z was to be sent at 13, expected -12.5 to 12.5" in ending.reason
        assert ending.stopped
        assert len([line for line in controller.commands if line.startswith("MOV")]) == 1
