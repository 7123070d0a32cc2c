"""Where joints are between the ticks of a log: by their drives, and by a spline of what these leave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hexservo.findings.identification.drives import Drives, fit_drives
from hexservo.findings.identification.joint_motion import JointMotion
from hexservo.findings.identification.log import Log
from hexservo.scenario.leg_units import LegUnits
from recorded_machines import Drive, record, wandering

Array = NDArray[np.float64]

METRES = LegUnits("m", "N")
PERIOD = 0.02


@pytest.fixture(scope="module")
def moved() -> tuple[Log, Drives, Array, Array]:
    """A log at 50 ticks a second of drives of 10 Hz, one leg at rest; their fit; times and places between ticks."""
    random, finer = np.random.default_rng(7), 10
    commands = 0.2 + np.repeat(wandering(random, 200, PERIOD, 2e-3, 0.3), finer, axis=0)
    commands[:, 5] = 0.2
    fine = record(commands, PERIOD / finer, [Drive(10.0, 0.8, finer)] * 6, 0.0, random)
    log = Log(fine.time[::finer], PERIOD, fine.commands[::finer], fine.joints[::finer], None)
    between = slice(0, -2 * finer)
    return log, fit_drives(log, METRES, delays=(1,)), fine.time[between], fine.joints[between]


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_joints_move_between_ticks_as_their_drives_do(moved: tuple[Log, Drives, Array, Array]) -> None:
    log, drives, times, joints = moved
    by_spline = rms(CubicSpline(log.time, log.joints)(times) - joints)
    found = JointMotion.of(log, drives)
    assert by_spline > 1e-5
    assert rms(found(times) - joints) < 0.05 * by_spline
    np.testing.assert_allclose(found(log.time), log.joints, atol=1e-12)


def test_every_second_tick_shows_what_a_spline_lacks(moved: tuple[Log, Drives, Array, Array]) -> None:
    log, drives, times, joints = moved
    by_spline = JointMotion.of(log)
    off = rms(by_spline(times) - joints)
    for alone, by_drives in zip(by_spline.halved(), JointMotion.of(log, drives).halved(), strict=True):
        assert len(alone.time) == 100
        assert rms(alone(times) - by_spline(times)) > off
        assert rms(by_drives(times) - joints) < 0.05 * off


def test_drives_that_predict_no_reading_that_is_left_out_do_not_count(
    moved: tuple[Log, Drives, Array, Array],
) -> None:
    log, drives, times, _ = moved
    found = JointMotion.of(log, replace(drives, finely=-drives.finely))
    np.testing.assert_array_equal(found(times), JointMotion.of(log)(times))


def test_joints_stay_at_their_last_reading() -> None:
    """After which a driver may have repeated it; a cubic of the readings before would go on."""
    time: Array = PERIOD * np.arange(20.0)
    readings = np.tile(time**2, (6, 1)).T
    motion = JointMotion(time, readings, None, CubicSpline(time, readings))
    np.testing.assert_allclose(motion(time[-1] + np.array([0.0, PERIOD, 3.0 * PERIOD])), np.tile(readings[-1], (3, 1)))


def test_joints_pass_through_readings_at_uneven_ticks(moved: tuple[Log, Drives, Array, Array]) -> None:
    """Off their places by up to 4.5 % of the period, as a log may have them."""
    log, drives, times, joints = moved
    count = len(log.time) - 3
    off = PERIOD * np.random.default_rng(8).uniform(-0.045, 0.045, count)
    off[0] = 0.0
    at = log.time[:count] + off
    read = CubicSpline(times, joints)(at)
    uneven = Log(at, PERIOD, log.commands[:count], read, None)
    found = JointMotion.of(uneven, replace(drives, finely=drives.finely[: count * len(drives.finely) // len(log.time)]))
    np.testing.assert_allclose(found(at), read, atol=1e-12)
    inside = slice(0, 10 * (count - 1))
    by_spline = rms(CubicSpline(at, read)(times[inside]) - joints[inside])
    assert rms(found(times[inside]) - joints[inside]) < 0.05 * by_spline
