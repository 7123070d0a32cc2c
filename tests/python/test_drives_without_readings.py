"""docs/position-machines.md, drives without readings: the last command in place of a reading, and what it costs."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np
import pytest

import hexservo as hs
from position_machines.clock import SimulatedClock
from position_machines.servo import Limits, Reading, tracking
from position_machines.simulated import Drives, SimulatedMachine

ASSUMED = 4.0  # [Hz], bandwidth of the drives
DELAY = 0.02  # [s]


def errors(true_bandwidth: float, *, earlier: bool) -> tuple[float, float]:
    """Largest error after the image first was within 2 px of the goal, and that at the end [px].

    The drives report nothing: the law reads its last command, with exposures earlier by the drives' lag or as they are.
    """
    changes = {"actuators.position.bandwidth": ASSUMED, "actuators.delay": DELAY, "camera.latency": 0.06}
    scenario = hs.load_scenario("pi-h824-positions", {**changes, "controller.tracking.auto.bandwidth": 1.0})
    step, clock = scenario.simulation.step, SimulatedClock()
    machine = SimulatedMachine(scenario, Drives(true_bandwidth, 1.0, DELAY, 0.02), clock)
    lag = DELAY + 1.0 / (math.pi * ASSUMED) if earlier else 0.0
    kept = scenario.updated({"camera.latency": 0.06 + step * math.ceil(lag / step)})
    decide = tracking(hs.Controller(kept), Limits(np.full(6, -1.0), np.full(6, 1.0), lag=1.0, frame_age=1.0))
    command, found = machine.legs(), []
    for tick in range(round(2.5 / step)):
        clock.wait_until(tick * step, threading.Event())
        newest = machine.frame()
        frame = None if newest is None else newest[0]
        if frame is not None:
            frame = replace(frame, exposure=frame.exposure - lag)
        command = decide(clock.now(), Reading(command, frame))
        machine.command(command)
        found.append(machine.error())
    reached = int(np.flatnonzero(np.array(found) < 2.0)[0])
    return max(found[reached:]), max(found[-10:])


@pytest.mark.parametrize("bandwidth", [3.0, 6.0])
def test_exposures_earlier_by_the_lag_leave_no_overshoot(bandwidth: float) -> None:
    beyond, left = errors(bandwidth, earlier=True)
    assert beyond < 2.5
    assert left < 1.0
    assert errors(bandwidth, earlier=False)[0] > 1.5 * beyond
