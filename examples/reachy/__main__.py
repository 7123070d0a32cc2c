"""``python -m reachy record | track``: 50 commands a second for a head on six cranks."""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading

import hexservo as hs
from position_machines.clock import Clock
from position_machines.lines import Line
from position_machines.program import Program, main
from position_machines.servo import Machine, Stop
from position_machines.simulated import SimulatedMachine
from reachy.head import DRIVES, WATCHDOG, Head, head_server, simulated_scenario


def connect(
    stack: contextlib.ExitStack, options: argparse.Namespace, scenario: hs.Scenario, clock: Clock, _: threading.Event
) -> Machine:
    """Connect to the head, a simulated one if asked for."""
    port, points = options.port, scenario.target.count
    if options.simulated:
        simulated = SimulatedMachine(simulated_scenario(), DRIVES, clock, WATCHDOG)
        taken = simulated.scenario.target.count
        if points != taken:
            raise Stop(f"target: expected {taken} points, those in the simulated head's images, got {points}")
        port = stack.enter_context(head_server(simulated)).port
    line = Line(options.host, port)
    stack.callback(line.close)
    return Head(line, points, clock)


PROGRAM = Program("reachy", "reachy-mini-head", 0.02, 0.15, 0.4, connect, __doc__ or "")

if __name__ == "__main__":
    sys.exit(main(PROGRAM))
