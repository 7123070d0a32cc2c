"""docs/your-machine.md, drives that take speeds: a loop around each, described as a drive that takes positions."""

from __future__ import annotations

import math
import re
import threading
from collections import deque

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lti, step

import hexservo as hs
from position_machines.clock import SimulatedClock
from position_machines.servo import Limits, Reading, tracking
from position_machines.simulated import _STEP, Drives, SimulatedMachine
from test_docs import ROOT

DELAY = 0.02  # [s], of a drive
PERIOD = 0.02  # [s], between two commands
SPEED_LIMIT = 0.02  # [m/s]
BAND = 2.0  # [px]


class SpeedDrives(SimulatedMachine):
    """Drives that integrate a speed, each with the loop of the page around it."""

    def __init__(self, scenario: hs.Scenario, clock: SimulatedClock, gain: float) -> None:
        super().__init__(scenario, Drives(1.0, 1.0, DELAY, SPEED_LIMIT), clock)
        self._gain = gain  # [1/s]
        self._speed = np.zeros(6)
        self._speeds: deque[tuple[int, NDArray[np.float64]]] = deque()  # and the step at which they begin to act

    def command(self, legs: NDArray[np.float64], at: float | None = None) -> None:
        """Send a speed towards the legs' coordinates."""
        speed = np.clip(self._gain * (legs - self.legs()), -SPEED_LIMIT, SPEED_LIMIT)
        self._speeds.append((self._steps + round(DELAY / _STEP), speed))

    def _advance(self, at: float | None = None) -> None:
        end = int((self._clock.now() - self._start) / _STEP + 1e-6)
        camera = self.scenario.camera
        while self._steps < end:
            if self._steps // round(PERIOD / _STEP) > self._exposed:
                self._exposed = self._steps // round(PERIOD / _STEP)
                self._expose(self._steps + round(camera.latency / _STEP))
            while self._speeds and self._speeds[0][0] <= self._steps:
                self._speed = self._speeds.popleft()[1]
            self._state = np.stack([self._state[0] + _STEP * self._speed, self._speed])
            self._steps += 1
            while self._arriving and self._arriving[0][0] <= self._steps:
                self._newest = self._arriving.popleft()[1]


def described(gain: float) -> dict[str, float]:
    """Keys of the page's row, for the delay of the drive and half a period."""
    late = DELAY + PERIOD / 2
    return {
        "actuators.delay": 0.0,
        "actuators.position.bandwidth": math.sqrt(gain / late) / (2.0 * math.pi),
        "actuators.position.damping": 1.0 / (2.0 * math.sqrt(gain * late)),
        "actuators.position.speed_limit": SPEED_LIMIT,
    }


def machine(gain: float) -> tuple[SpeedDrives, SimulatedClock, hs.Scenario]:
    changes = {"camera.latency": 0.06, "controller.tracking.auto.bandwidth": 1.0, "simulation.step": PERIOD}
    scenario = hs.load_scenario("pi-h824-positions", {**changes, **described(gain)})
    clock = SimulatedClock()
    return SpeedDrives(scenario, clock, gain), clock, scenario


MOST = 1.0 / (4.0 * (DELAY + PERIOD / 2))  # [1/s], of the gain


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_the_keys_of_the_page_describe_the_loop(share: float) -> None:
    """A small step, below the speed limit: its lag is 1/k less half a period, and it goes on as the description."""
    drives, clock, _ = machine(share * MOST)
    home, size, followed = drives.legs(), 5e-4, []
    for tick in range(50):
        clock.wait_until(tick * PERIOD, threading.Event())
        drives.command(home + size)
        followed.append((drives.legs()[0] - home[0]) / size)
    keys = described(share * MOST)
    w, damping = 2.0 * math.pi * keys["actuators.position.bandwidth"], keys["actuators.position.damping"]
    _, expected = step(lti([w * w], [1.0, 2.0 * damping * w, w * w]), T=PERIOD * np.arange(50))
    np.testing.assert_allclose(followed, expected, atol=0.1)
    assert max(followed) < 1.03
    lag = PERIOD * (np.sum(1.0 - np.array(followed)) - 0.5)
    assert lag == pytest.approx(1.0 / (share * MOST) - PERIOD / 2, rel=0.02)


def test_the_law_settles_on_them_as_the_page_states() -> None:
    page = (ROOT / "docs" / "your-machine.md").read_text(encoding="utf-8")
    stated = re.search(
        r"k = ([\d.]+)/s has a bandwidth of ([\d.]+) Hz, .*? settles after ([\d.]+) s on such drives", page
    )
    assert stated
    gain, bandwidth, time = map(float, stated.groups())
    assert gain == pytest.approx(MOST, abs=0.05)
    assert bandwidth == pytest.approx(described(MOST)["actuators.position.bandwidth"], abs=0.05)
    drives, clock, scenario = machine(MOST)
    decide = tracking(hs.Controller(scenario), Limits(np.full(6, -1.0), np.full(6, 1.0), lag=1.0, frame_age=1.0))
    errors = []
    for tick in range(100):
        clock.wait_until(tick * PERIOD, threading.Event())
        newest = drives.frame()
        drives.command(decide(clock.now(), Reading(drives.legs(), None if newest is None else newest[0])))
        errors.append(drives.error())
    found = np.array(errors)
    settled = PERIOD * float(np.flatnonzero(found > BAND)[-1] + 1)
    print(f"settled after {settled:.3f} s, RMS afterwards {np.sqrt((found[-25:] ** 2).mean()):.3g} px")
    assert settled == pytest.approx(time, abs=PERIOD)
    assert found[-25:].max() < BAND / 4
