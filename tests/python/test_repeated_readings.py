"""Joints that are read more seldom than the ticks: repeated readings do not count, and those of a rest do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import hexservo as hs
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.drives import Drives, fit_drives
from hexservo.findings.identification.frames import fit_camera
from hexservo.findings.identification.joint_motion import JointMotion
from hexservo.findings.identification.joints_repeated import fresh_readings
from hexservo.findings.identification.log import Log
from hexservo.scenario.leg_units import LegUnits
from recorded_machines import Drive, record, wandering
from test_identification import seen_log, within

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

METRES = LegUnits("m", "N")
SEED = 7000
TICK = 0.01  # [s]


def repeated_ticks(kind: str, random: np.random.Generator, ticks: int) -> Mask:
    """Ticks that repeat the one before: none, one in a hundred by chance, or every second one."""
    chance = {"none": np.zeros(ticks, bool), "some": random.random(ticks) < 0.01, "half": np.arange(ticks) % 2 == 1}
    return np.asarray(chance[kind] & (np.arange(ticks) > 0))


def with_repeats(log: Log, repeated: Mask, step: float = 0.0) -> Log:
    """Round the joints to steps [m], 0: not at all, and repeat the tick before at some."""
    latest = np.maximum.accumulate(np.where(repeated, 0, np.arange(len(repeated))))
    rounded = np.round(log.joints / step) * step if step else log.joints
    return replace(log, joints=rounded[latest])


def logged(random: np.random.Generator, *, noise: float, hold: float = 0.4, moving: int = 6) -> tuple[list[Drive], Log]:
    drives = [Drive(float(random.uniform(3, 9)), float(random.uniform(0.5, 1.2)), 1) for _ in range(6)]
    moves = np.arange(6) < moving
    return drives, record(0.2 + moves * wandering(random, 500, TICK, 0.004, hold), TICK, drives, noise, random)


@pytest.mark.parametrize("kind", ["none", "some", "half"])
def test_repeated_readings_are_found_by_the_noise_that_they_lack(kind: str) -> None:
    random = np.random.default_rng(SEED)
    _, log = logged(random, noise=2e-5)
    repeated = repeated_ticks(kind, random, 500)
    for step in (0.0, 1e-6):  # no rounding, and that of six decimals
        np.testing.assert_array_equal(fresh_readings(with_repeats(log, repeated, step).joints), ~repeated)


@pytest.mark.parametrize(("noise", "step"), [(0.0, 1e-4), (0.0, 1e-5), (1e-6, 1e-5), (3e-5, 1e-4)])
@pytest.mark.parametrize("hold", [0.4, 2.0])
def test_rounded_readings_that_are_equal_at_rest_count(noise: float, step: float, hold: float) -> None:
    """Of those that are repeated, the ones that are off by more than four steps do not: legs moved since."""
    for seed in range(SEED, SEED + 4):
        random = np.random.default_rng(seed)
        _, log = logged(random, noise=noise, hold=hold)
        rounded = with_repeats(log, repeated_ticks("none", random, 500), step)
        assert (np.diff(rounded.joints, axis=0) == 0.0).all(axis=1).any()
        assert fresh_readings(rounded.joints).all()
        repeated = repeated_ticks("half", random, 500)
        halved = with_repeats(log, repeated, step)
        fresh = fresh_readings(halved.joints)
        assert (fresh | repeated).all()
        assert (np.abs(halved.joints - log.joints)[fresh] < 4 * step).all()


def test_joints_that_never_move_repeat_nothing() -> None:
    assert fresh_readings(np.full((60, 6), 0.2)).all()


def hits_of(found: Drives, drives: list[Drive]) -> dict[str, list[bool]]:
    """Whether the intervals of the legs contain the true values."""

    pairs = list(zip(found.fits, drives, strict=True))
    return {
        "bandwidth": [within(fit.bandwidth, drive.bandwidth) for fit, drive in pairs],
        "damping": [within(fit.damping, drive.damping) for fit, drive in pairs],
        "delay": [within(fit.delay, drive.delay) for fit, drive in pairs],
    }


def test_every_second_reading_gives_the_drive_of_all() -> None:
    """The squares of 4 normal numbers have a mean below 3.7 in 995 of 1000 cases; a stale tick is 12 deviations."""
    random = np.random.default_rng(SEED)
    drives, log = logged(random, noise=2e-5, moving=2)
    halved = with_repeats(log, repeated_ticks("half", random, 500))
    found = fit_drives(halved, METRES, delays=(1,))
    assert found.repeated == 250
    errors = []
    for fit, drive in zip(found.fits[:2], drives, strict=False):
        for one, true in ((fit.bandwidth, drive.bandwidth), (fit.damping, drive.damping)):
            assert one is not None
            errors.append(np.log(one.value / true) / (np.log(one.high / one.low) / (2 * 1.96)))
        assert fit.noise == pytest.approx(2e-5, rel=4 / np.sqrt(2 * 175))  # four of its standard deviations
    assert float(np.mean(np.square(errors))) < 3.7
    (sentence,) = (words for words in found.section().sentences if "repeat" in words)
    assert sentence.startswith("250 readings of the joints repeat those of the tick before")
    assert found.section().data["repeated"] == 250
    assert not any("repeat" in words for words in fit_drives(log, METRES, delays=(1,)).section().sentences)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "some", "half"])
def test_intervals_hold_whatever_is_repeated(kind: str) -> None:
    hits: dict[str, list[bool]] = {"bandwidth": [], "damping": [], "delay": []}
    print(f"seeds {SEED} to {SEED + 59}")
    for seed in range(SEED, SEED + 60):
        random = np.random.default_rng(seed)
        drives, log = logged(random, noise=2e-5)
        found = fit_drives(with_repeats(log, repeated_ticks(kind, random, 500)), METRES, delays=(0, 1, 2))
        for name, those in hits_of(found, drives).items():
            hits[name] += those
    shares = {name: float(np.mean(those)) for name, those in hits.items()}
    print(kind, shares)
    assert all(0.9 <= share <= 0.98 for share in shares.values()), shares


def test_joints_between_ticks_are_those_of_the_readings_that_count() -> None:
    """By a spline alone: a repeated reading is off by what the leg moves in a tick, some 0.5 mm."""
    random = np.random.default_rng(SEED)
    drives = [Drive(2.0, 0.9)] * 6
    log = record(0.2 + wandering(random, 400, TICK, 0.004, 0.4), TICK, drives, 1e-6, random)
    repeated = repeated_ticks("half", random, 400)
    times = log.time[100:300] + TICK / 2
    true = CubicSpline(log.time, log.joints)(times)
    stale = CubicSpline(log.time, with_repeats(log, repeated).joints)(times)
    found = JointMotion.of(with_repeats(log, repeated))(times)
    assert np.std(found - true) < 0.1 * np.std(stale - true)


def test_repeated_readings_do_not_delay_the_joints_that_images_are_compared_with(paper: hs.Scenario) -> None:
    """Joints that are late by a tick of 10 ms at every second one would make the latency shorter by 5 ms."""
    log = seen_log(paper, 0.05, stamps=None)
    halved = with_repeats(log, repeated_ticks("half", np.random.default_rng(SEED), len(log.time)))
    camera = fit_camera(halved, Scene(paper))
    assert within(camera.latency, 0.05)
    assert camera.latency is not None
    assert camera.latency.value == pytest.approx(0.05, abs=1e-3)


def test_a_log_of_few_readings_is_refused(paper: hs.Scenario) -> None:
    random = np.random.default_rng(SEED)
    _, log = logged(random, noise=2e-5)
    with pytest.raises(hs.ScenarioError, match="joints: expected at least 50 readings, got 42: the other 458 ticks"):
        hs.identify(with_repeats(log, np.arange(500) % 12 > 0), paper)
