"""Command line of the programs: ``record`` writes a log for `hexservo identify`, ``track`` runs a scenario's law."""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import hexservo as hs
from hexservo.scenario.parameters import frame_period
from position_machines.clock import Clock, RealClock, SimulatedClock, interrupts
from position_machines.kinematics import Kinematics
from position_machines.lines import LinkError
from position_machines.servo import Array, Ending, Limits, LogFile, Machine, Reading, Stop, excitation, run, tracking

__all__ = ["Connect", "Program", "arguments", "main"]

Connect = Callable[[contextlib.ExitStack, argparse.Namespace, hs.Scenario, Clock, threading.Event], Machine]
"""Connects to the machine: makes what `run` needs, closed with the stack; may raise `LinkError` and `Stop`."""

_APPROACH = 10.0  # [s] that a leg would take from one end of its travel to the other on the way to the first jump


@dataclass(frozen=True)
class Program:
    """What differs between the programs."""

    name: str
    machine: str  # scenario of its legs
    period: float  # of a tick [s]
    jump: float  # of a leg, for a log [m; rad]
    hold: float  # mean time between jumps [s]
    connect: Connect
    text: str
    camera: bool = False  # the camera has its own port
    velocity: float | None = None  # of the platform that the program sets unless a smaller one is given [mm/s]


def arguments(program: Program) -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(prog=f"python -m {program.name}", description=program.text)
    commands = parser.add_subparsers(dest="command", required=True)
    record = commands.add_parser("record", help="move the legs in jumps and write a log")
    record.add_argument("--out", required=True, metavar="FILE", help="log to write, a new CSV file")
    jump = "largest distance of a leg from home [m; rad]; a jump is up to twice as long"
    record.add_argument("--jump", type=float, default=program.jump, help=jump)
    record.add_argument("--seed", type=int, default=0, help="of the jumps")
    track = commands.add_parser("track", help="move until the image is the scenario's goal")
    track.add_argument("--out", metavar="FILE", help="log to write, a new CSV file")
    for each, seconds in ((record, 20.0), (track, 4.0)):
        each.add_argument("--scenario", default=program.machine, help="name or path; its law runs, its range holds")
        each.add_argument("--seconds", type=float, default=seconds, help="how long [s]")
        each.add_argument("--host", default="127.0.0.1", help="of the machine")
        each.add_argument("--port", type=int, help="of the machine")
        if program.camera:
            each.add_argument("--camera-port", type=int, help="of the program with the images, on this computer")
        if program.velocity is not None:
            velocity = f"of the platform [mm/s], at most {program.velocity:g}, which is the default"
            each.add_argument("--velocity", type=float, default=program.velocity, help=velocity)
        each.add_argument(
            "--simulated", action="store_true", help="start a simulated machine on the loopback interface"
        )
        each.add_argument("--real-time", action="store_true", help="simulated machine: pace it by the computer's clock")
    return parser


def main(program: Program, given: Sequence[str] | None = None) -> int:
    """Run a program: exit codes 0 done, 1 stopped for a reason or goal not reached, 2 bad input, 130 Ctrl-C."""
    parser = arguments(program)
    options = parser.parse_args(given)
    ports = [options.port, *([options.camera_port] if program.camera else [])]
    if ports != [None] * len(ports) if options.simulated else None in ports:
        parser.error(f"expected --port{' and --camera-port' if program.camera else ''}, or --simulated")
    if not 0.0 < options.seconds <= 3600.0:
        parser.error(f"--seconds: expected more than 0 and at most 3600, got {options.seconds:g}")
    if program.velocity is not None and not 0.0 < options.velocity <= program.velocity:
        parser.error(f"--velocity: expected more than 0 and at most {program.velocity:g}, got {options.velocity:g}")
    clock = RealClock() if options.real_time or not options.simulated else SimulatedClock()
    log = None
    with contextlib.ExitStack() as stack:
        try:
            scenario = _scenario(options, program)
            kinematics = Kinematics(scenario)
            limits = Limits.of(kinematics)
            if options.command == "record":
                _check_jump(options.jump, kinematics.home_legs, limits)
                speed = float((limits.highest - limits.lowest).max()) / _APPROACH
                decide = excitation(kinematics.home_legs, options.jump, program.hold, speed, options.seed)
            else:
                decide = tracking(hs.Controller(scenario, program.period), limits)
            if options.out is not None:  # before anything moves, and at last: what fails before it leaves no file
                points = len(scenario.target.desired_features or ()) // 2
                log = LogFile(options.out, points, frame_period(scenario))
                stack.callback(log.close)
        except (hs.ScenarioError, ValueError, OSError, Stop) as error:
            print(f"{program.name}: {error}", file=sys.stderr)
            return 2
        interrupted = stack.enter_context(interrupts())
        try:
            machine = program.connect(stack, options, scenario, clock, interrupted)
        except (LinkError, Stop) as error:
            print(f"{program.name}: {error}", file=sys.stderr)
            return 130 if interrupted.is_set() else 1
        print(f"{program.name}: running, Ctrl-C stops", flush=True)
        last = _Last(machine)
        ending = run(last, decide, limits, program.period, options.seconds, clock, interrupted, log)
    return _report(program, options, scenario, last, ending)


def _check_jump(size: float, home: Array, limits: Limits) -> None:
    """Refuse a size of which some jump would end the loop."""
    if not size > 0.0:
        raise ValueError(f"--jump: expected more than 0, got {size:g}")
    limits.check(home + size, "would be sent by a jump")
    limits.check(home - size, "would be sent by a jump")
    if 2.0 * size > limits.lag:
        raise ValueError(
            f"--jump: expected at most {limits.lag / 2:.4g}, got {size:g}: a jump is up to twice as long, and legs may "
            f"be {limits.lag:.4g} away from their commands"
        )


def _scenario(options: argparse.Namespace, program: Program) -> hs.Scenario:
    """Return the scenario, which has to be one of positions at the program's period where its law runs."""
    scenario = hs.load_scenario(options.scenario)
    if options.command == "record":
        return scenario
    kind = scenario.actuators.kind
    if not scenario.actuators.takes_positions:
        raise hs.ScenarioError(
            f"actuators.kind: expected one that takes positions, got {kind}; `hexservo identify LOG --machine SCENARIO "
            "--out FILE` writes such a scenario from a log",
            options.scenario,
        )
    if scenario.simulation.step != program.period:
        raise hs.ScenarioError(
            f"simulation.step: expected {program.period} s, the period of this program, got "
            f"{scenario.simulation.step} s",
            options.scenario,
        )
    return scenario


class _Last:
    """A machine, and the newest image that it gave."""

    def __init__(self, machine: Machine) -> None:
        self._machine, self.command, self.stop = machine, machine.command, machine.stop
        self.features: Array | None = None

    def read(self) -> Reading:
        reading = self._machine.read()
        if reading.frame is not None:
            self.features = reading.frame.features
        return reading


def _report(program: Program, options: argparse.Namespace, scenario: hs.Scenario, last: _Last, ending: Ending) -> int:
    for line in ending.details:
        print(f"{program.name}: {line}", file=sys.stderr)
    if ending.reason:
        print(f"{program.name}: stopped after {ending.ticks} ticks: {ending.reason}", file=sys.stderr)
        return 130 if ending.interrupted else 1
    if not ending.stopped:
        return 1
    print(f"{program.name}: {ending.ticks} ticks of {program.period * 1e3:g} ms; the machine holds its place")
    if options.command == "record":
        return 0
    desired = np.array(scenario.target.desired_features)
    error = np.inf if last.features is None else float(np.abs(last.features - desired).max())
    if np.isnan(error):
        print(f"{program.name}: the last image lacks a point, so that it is not known whether the goal is reached")
        return 1
    print(f"{program.name}: the last image is {error:.2f} px from the goal, wanted: {scenario.metrics.band:g} px")
    return 0 if error <= scenario.metrics.band else 1
