"""``python -m gcs record | track``: 20 poses a second for a hexapod with a text protocol."""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading

import hexservo as hs
from gcs.client import GcsHexapod, GcsLink
from gcs.controller import Controller
from position_machines.clock import Clock
from position_machines.frames import Camera, camera_server
from position_machines.kinematics import Kinematics
from position_machines.lines import Line
from position_machines.program import Program, main
from position_machines.servo import Machine

VELOCITY = 20.0  # [mm/s]


def connect(
    stack: contextlib.ExitStack,
    options: argparse.Namespace,
    scenario: hs.Scenario,
    clock: Clock,
    interrupted: threading.Event,
) -> Machine:
    """Connect to controller and camera, simulated ones if asked for, and move home."""
    port, camera_port = options.port, options.camera_port
    if options.simulated:
        controller = Controller(clock)
        port = stack.enter_context(controller.server()).port
        camera_port = stack.enter_context(camera_server(controller.frame)).port
    line = Line(options.host, port)
    stack.callback(line.close)
    images = Line("127.0.0.1", camera_port)
    stack.callback(images.close)
    camera = Camera(images, len(scenario.target.desired_features or ()) // 2, clock)
    hexapod = GcsHexapod(GcsLink(line), camera, Kinematics(scenario))
    hexapod.start(options.velocity, clock, interrupted)
    return hexapod


PROGRAM = Program("gcs", "pi-h824", 0.05, 1e-4, 0.5, connect, __doc__ or "", camera=True, velocity=VELOCITY)

if __name__ == "__main__":
    sys.exit(main(PROGRAM))
