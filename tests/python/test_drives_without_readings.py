"""docs/position-machines.md, drives without readings: the last command in place of a reading, and what it costs."""

from __future__ import annotations

import math
import re
import threading
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from position_machines.clock import SimulatedClock
from position_machines.servo import Limits, Reading, tracking
from position_machines.simulated import Drives, SimulatedMachine
from test_docs import ROOT

ASSUMED = 4.0  # [Hz], bandwidth of the drives
DELAY = 0.02  # [s]
BAND = 2.0  # [px]
TRUE = (3.0, 4.0, 5.0, 6.0)  # [Hz], bandwidths of the page's table
MEASURED, EARLIER, ALONE = ROWS = "measured", "last command, exposures earlier by the lag", "last command alone"
ASSUMED_NOISE = 2.0  # [px], what such readings leave in the image
BESIDE = 5e-4 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # [m], of legs beside their commands


def errors(
    true_bandwidth: float, readings: str, seconds: float = 2.5, beside: float | NDArray[np.float64] = 0.0
) -> tuple[NDArray[np.float64], float]:
    """Distance of the image from the goal at each tick [px], and the tick [s].

    The law reads the legs or, of drives that report nothing, its last command, with exposures earlier by the drives'
    lag or as they are, and more noise assumed: a row of the page's table. Legs stand `beside` what they are sent to
    [m].
    """
    changes = {"actuators.position.bandwidth": ASSUMED, "actuators.delay": DELAY, "camera.latency": 0.06}
    scenario = hs.load_scenario("pi-h824-positions", {**changes, "controller.tracking.auto.bandwidth": 1.0})
    step, clock = scenario.simulation.step, SimulatedClock()
    machine = SimulatedMachine(scenario, Drives(true_bandwidth, 1.0, DELAY, 0.02), clock)
    lag = DELAY + 1.0 / (math.pi * ASSUMED) if readings == EARLIER else 0.0
    kept = scenario.updated({"camera.latency": 0.06 + step * math.ceil(lag / step)})
    if readings != MEASURED:
        kept = kept.updated({"controller.tracking.noise": ASSUMED_NOISE})
    decide = tracking(hs.Controller(kept), Limits(np.full(6, -1.0), np.full(6, 1.0), lag=1.0, frame_age=1.0))
    command, found = machine.legs(), []
    for tick in range(round(seconds / step)):
        clock.wait_until(tick * step, threading.Event())
        newest = machine.frame()
        frame = None if newest is None else newest[0]
        if frame is not None:
            frame = replace(frame, exposure=frame.exposure - lag)
        command = decide(clock.now(), Reading(machine.legs() if readings == MEASURED else command, frame))
        machine.command(command + beside)
        found.append(machine.error())
    return np.array(found), step


def farthest(found: NDArray[np.float64]) -> float:
    """Largest error after the image first was within the band [px]."""
    return float(found[np.flatnonzero(found < BAND)[0] :].max())


def settled(found: NDArray[np.float64], step: float) -> float:
    """Time after which the image stays within the band [s]."""
    return step * float(np.flatnonzero(found > BAND)[-1] + 1)


@pytest.mark.parametrize("bandwidth", [3.0, 6.0])
def test_exposures_earlier_by_the_lag_leave_no_overshoot(bandwidth: float) -> None:
    found, _ = errors(bandwidth, EARLIER)
    assert farthest(found) < 2.5
    assert found[-10:].max() < 1.0
    assert farthest(errors(bandwidth, ALONE)[0]) > 1.5 * farthest(found)


def numbers(text: str) -> list[float]:
    """The ends of a range on the page, or one number."""
    return [float(word) for word in re.findall(r"\d+(?:\.\d+)?", text)]


@pytest.mark.slow
def test_the_page_states_what_drives_without_readings_cost() -> None:
    page = (ROOT / "docs" / "position-machines.md").read_text(encoding="utf-8")
    for row in ROWS:
        cells = re.search(rf"^\| {row} \|(.*)\|(.*)\|(.*)\|$", page, re.MULTILINE)
        assert cells
        runs = [errors(bandwidth, row, 6.0) for bandwidth in TRUE]
        times = [settled(*run) for run in runs]
        farther = [farthest(found) for found, _ in runs]
        left = [float(np.sqrt((found[-150:] ** 2).mean())) for found, _ in runs]
        for cell, values, rounding in zip(cells.groups(), (times, farther, left), (0.02, 0.1, 0.02), strict=True):
            stated = numbers(cell)
            print(f"{row}: {min(values):.3g} to {max(values):.3g}, page {stated}")
            np.testing.assert_allclose((min(values), max(values)), (stated[0], stated[-1]), atol=rounding)


@pytest.mark.slow
def test_the_page_states_what_legs_beside_their_commands_change() -> None:
    page = (ROOT / "docs" / "position-machines.md").read_text(encoding="utf-8")
    stated = re.search(r"stand 0\.5 mm beside what they are sent to .*?\((.*?) s\)", page)
    assert stated
    times = [settled(*errors(bandwidth, EARLIER, 6.0, BESIDE)) for bandwidth in TRUE]
    print(f"{min(times):.3g} to {max(times):.3g} s")
    np.testing.assert_allclose((min(times), max(times)), numbers(stated[1]), atol=0.02)
