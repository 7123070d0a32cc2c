"""Frames that jitter and frames that are lost: the clock of a camera, its latency and its noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.stats import binom

import hexservo as hs
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.evidence import Table
from hexservo.findings.identification.changes import changes_of, faults_of, of_law
from hexservo.findings.identification.drives import Drives, fit_drives
from hexservo.findings.identification.frame_clock import clock
from hexservo.findings.identification.frames import CameraFit, _of_one_speed, fit_camera
from hexservo.findings.identification.frames_noise import (
    Scatter,
    moved_by,
    overstated,
    rounding_deviations,
    scatter_of,
    spline_shares,
)
from hexservo.findings.identification.frames_repeated import repeats
from hexservo.findings.identification.interval import Interval, correlated, deviations, robust_deviations
from hexservo.findings.identification.log import Frames, Log, joint_deviations
from recorded_machines import Drive, record, see
from test_identification import METRES, SEED, commands_of, seen_log, within

Array = NDArray[np.float64]

PERIOD = 0.033


@cache
def drives_of_seen_log() -> Drives:
    """Drives of `seen_log` in motion, whose commands and joints do not depend on its camera."""
    return fit_drives(seen_log(hs.load_scenario("paper"), 0.05, stamps=None), METRES, delays=(1,))


def arrivals(random: np.random.Generator, *, jitter: float, lost: float, seconds: float = 10.0) -> Array:
    """Times [s] of frames that are late by up to `jitter`, a share of which is lost."""
    frames = np.arange(0.0, seconds, PERIOD)
    frames = frames[random.random(len(frames)) >= lost]
    return np.maximum.accumulate(frames + jitter * random.random(len(frames)))


def least_of(count: int) -> int:
    """Hits that intervals of 95 % hardly ever fall below in `count` trials: once in 1e4."""
    return int(binom.ppf(1e-4, count, 0.95))


@pytest.mark.parametrize(
    ("jitter", "lost"), [(0.002, 0.0), (0.002, 0.55), (0.002, 0.6), (0.002, 0.8), (0.01, 0.6), (0.025, 0.05)]
)
def test_the_period_is_found_whatever_is_lost(jitter: float, lost: float) -> None:
    random = np.random.default_rng(SEED)
    found = [clock(arrivals(random, jitter=jitter, lost=lost)) for _ in range(10)]
    known = [one for one in found if one is not None]
    assert len(known) >= 8  # a multiple of the period passes for one by chance in 1 % of the logs each
    assert sum(within(period, PERIOD) for period, _ in known) >= least_of(len(known))
    assert sum(within(dropout, lost) for _, dropout in known) >= least_of(len(known))


def test_jitter_as_long_as_the_period_gives_none() -> None:
    random = np.random.default_rng(SEED)
    found = [clock(arrivals(random, jitter=1.2 * PERIOD, lost=0.05, seconds=4.0)) for _ in range(3)]
    assert found == [None] * 3
    assert clock(np.cumsum(random.uniform(0.01, 0.1, 100))) is None
    assert clock(np.full(30, 2.0)) is None


def test_frames_that_arrive_at_ticks_have_the_period_of_the_camera() -> None:
    random = np.random.default_rng(SEED)
    found = clock(np.ceil(arrivals(random, jitter=0.0, lost=0.05) / 0.01) * 0.01)
    assert found is not None
    assert within(found[0], PERIOD)


@pytest.mark.parametrize("jitter", [0.0, 0.002])
def test_a_slow_beat_of_ticks_and_frames_is_within_the_interval(jitter: float) -> None:
    """Frames at 30 Hz, to 1e-4, that arrive at ticks of 20 ms: the rounding has the order of three frames."""
    random, hits, count = np.random.default_rng(SEED), 0, 60
    for _ in range(count):
        period = (1.0 + 1e-4 * random.uniform(-1.0, 1.0)) / 30.0
        times = random.uniform() + period * np.arange(900) + jitter * random.random(900)
        found = clock(np.ceil(times / 0.02) * 0.02)
        assert found is not None
        assert found[0].high - found[0].low < 2e-3 * period
        hits += within(found[0], period)
    assert hits >= least_of(count)


def test_the_period_of_frames_whose_lateness_wanders_is_within_the_interval() -> None:
    """Lateness that is alike over some ten frames, as of a loaded bus: so many frames are worth one of white jitter."""
    random, hits, count = np.random.default_rng(SEED), 0, 60
    for _ in range(count):
        late = lfilter([1.0], [1.0, -0.8], random.normal(0.0, 3e-4, 600))
        found = clock(PERIOD * np.arange(600) + late)
        assert found is not None
        hits += within(found[0], PERIOD)
    assert hits >= least_of(count)  # 25 if residuals counted as white


@pytest.mark.parametrize("whole", [1, 2, 3])
def test_a_period_of_whole_ticks_is_known_to_a_tick_in_the_time_of_all_frames(whole: int) -> None:
    """Frames at every tick, or every second or third: their times have no scatter, and no step below their period."""
    tick, random = 0.02, np.random.default_rng(SEED)
    ticks = tick * np.arange(1000.0)
    for off in (0.0, 1e-5, -1e-5):
        period = whole * tick * (1.0 + off)
        times = tick * np.ceil((random.uniform(0.0, 1.0) + period * np.arange(300)) / tick - 1e-9)
        found = clock(times, ticks)
        assert found is not None
        assert within(found[0], period)
        assert 0.9 * tick <= 299 * (found[0].high - found[0].low) <= 2.01 * tick


def test_frames_at_ticks_are_known_by_the_ticks_of_their_log(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None, moving=False)
    assert log.frames is not None
    arrival = log.time[35::3][: len(log.frames.arrival)]
    camera = fit_camera(replace(log, frames=replace(log.frames, arrival=arrival)), Scene(paper))
    assert camera.period is not None
    assert camera.period.value == pytest.approx(0.03)
    assert camera.period.high - camera.period.low == pytest.approx(2 * 0.01 / (len(arrival) - 1), rel=1e-3)


def test_a_camera_without_a_period_keeps_its_keys(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    found = CameraFit(100, latency=None, explained=1.0)
    section = found.section()
    assert section.verdict == "warning"
    assert any("do not tell their period" in sentence for sentence in section.sentences)
    assert not {"camera.period", "camera.dropout"} & set(changes_of(log, paper, drives_of_seen_log(), found))


def test_the_noise_is_what_the_law_tracking_assumes(paper: hs.Scenario) -> None:
    tracking = paper.updated({"controller.law": "tracking", "actuators.kind": "position", "simulation.mode": "sampled"})
    assert of_law(tracking, {"camera.noise": 1.1}) == {"controller.tracking.noise": 1.1}
    assert of_law(tracking, {"camera.noise": 0.0}) == of_law(tracking, {}) == {}
    assert of_law(paper, {"camera.noise": 1.1}) == {}


def test_residuals_are_correlated_over_the_time_of_their_process() -> None:
    """(1 + r)/(1 - r) samples where one has r of the one before; white ones over one, in 95 of 100 records."""
    random = np.random.default_rng(SEED)
    assert sum(correlated(random.normal(size=1000)) == 1.0 for _ in range(100)) >= 85
    for r in (0.5, 0.8):
        found = [correlated(lfilter([1.0], [1.0, -r], random.normal(size=4000))) for _ in range(20)]
        assert np.mean(found) == pytest.approx((1.0 + r) / (1.0 - r), rel=0.15)


def test_robust_deviations_are_those_of_repeated_fits() -> None:
    """Of a line whose noise grows with the distance from its middle, two residuals a sample, by 1000 draws."""
    random = np.random.default_rng(SEED)
    x = np.repeat(random.normal(size=60), 2)
    jacobian = np.stack([np.ones_like(x), x, np.zeros_like(x)], axis=1)
    found, robust, usual = [], [], []
    for _ in range(1000):
        noise = 0.1 * random.normal(size=len(x)) + x * np.repeat(random.normal(size=60), 2)
        line = np.polynomial.polynomial.polyfit(x, noise, 1)
        left = noise - jacobian[:, :2] @ line
        found.append(line)
        robust.append(robust_deviations(jacobian, left, 60, 1.0))
        usual.append(deviations(jacobian, left, len(x)))
    scatter = np.std(found, axis=0)
    stated = np.sqrt(np.mean(np.square(robust), axis=0)[:2])
    assert ((stated > 0.95 * scatter) & (stated < 1.3 * scatter)).all()  # the jackknife is above rather than below
    assert np.sqrt(np.mean(np.square(usual), axis=0))[1] < 0.6 * scatter[1]
    assert np.isinf(robust[0][2])


def test_jitter_is_found_from_motion_and_is_no_noise(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None, jitter=0.01)
    camera = fit_camera(log, Scene(paper))
    assert camera.jitter == pytest.approx(0.01, rel=0.4)
    assert camera.noise is not None
    assert camera.noise.value == pytest.approx(0.2, rel=4 / np.sqrt(2 * 0.7 * 135 * 7))
    changes = changes_of(log, paper, drives_of_seen_log(), camera)
    assert changes["camera.latency_jitter"] == 0.01
    assert changes["camera.latency"] == 0.05
    section = camera.section()
    assert any("later than the earliest" in sentence for sentence in section.sentences)
    (table,) = section.items
    assert isinstance(table, Table)
    assert {row[0] for row in table.rows} >= {"target displaced along x", "target turned about z"}
    still = fit_camera(seen_log(paper, 0.05, stamps=None), Scene(paper))
    assert still.jitter is None
    assert still.noise is not None
    assert still.noise.value == pytest.approx(camera.noise.value, rel=0.15)


def test_jitter_does_not_displace_the_target_by_what_passes_for_noise(paper: hs.Scenario) -> None:
    """Late frames are off by pixels along their motion; one target for all of them is off by more than the noise."""
    noise = 0.02
    camera = fit_camera(seen_log(paper, 0.05, stamps=None, jitter=0.02, noise=noise, seed=2), Scene(paper))
    assert camera.noise is not None
    assert camera.noise.value == pytest.approx(noise, rel=4 / np.sqrt(2 * 0.7 * 135 * 7))
    assert camera.noise.low < noise < camera.noise.high


def test_the_noise_of_joints_is_found_from_their_readings() -> None:
    random = np.random.default_rng(SEED)
    motion = 0.2 + 0.01 * np.sin(2 * np.pi * 2.0 * 0.01 * np.arange(2000.0)[:, None] + np.arange(6.0))
    deviations = 1e-5 * np.arange(1.0, 7.0)
    joints = motion + deviations * random.normal(size=motion.shape)
    log = Log(0.01 * np.arange(2000.0), 0.01, motion, joints, None)
    np.testing.assert_allclose(joint_deviations(log.joints), deviations, rtol=0.15)
    assert (joint_deviations(motion) < 1e-7).all()


def test_motion_that_is_fast_for_the_ticks_is_no_noise_of_joints(paper: hs.Scenario) -> None:
    """Of drives of 10 Hz at 30 ticks a second: their fit leaves 1e-9 m, and the differences of the readings 1e-4 m."""
    log = seen_log(paper, 0.05, stamps=None)
    drives = drives_of_seen_log()
    coarse = replace(drives, fits=tuple(replace(fit, noise=1e-9) for fit in drives.fits))
    noisy = replace(drives, fits=tuple(replace(fit, noise=1e-4) for fit in drives.fits))
    joints = replace(log, joints=log.joints + 1e-4 * np.random.default_rng(SEED).normal(size=log.joints.shape))
    of_motion, of_noise = (fit_camera(joints, Scene(paper), one) for one in (coarse, noisy))
    for camera, reason in (
        (of_motion, "Motion of the joints between ticks that are long for it may explain"),
        (of_noise, "The noise of the joints explains"),
    ):
        assert camera.noise is None
        words = " ".join(camera.section().sentences)
        assert reason in words
        assert camera.section().verdict == "warning"


def log_with_few_ticks(
    scenario: hs.Scenario, rate: float, bandwidth: float, *, seed: int, jitter: float = 0.0, size: float = 2e-3
) -> Log:
    """12 s of drives without noise, seen as they move between ticks: 0.2 px, a latency of 50 ms, no exposure times."""
    random, finer = np.random.default_rng(seed), 10
    commands = np.repeat(commands_of(scenario, random, round(12 * rate), 1 / rate, size), finer, axis=0)
    fine = record(commands, 1 / rate / finer, [Drive(bandwidth, 0.8, finer)] * 6, 0.0, random)
    exposure: Array = 0.313 + np.arange(345) / 30.0
    arrival = np.maximum.accumulate(exposure + 0.05 + jitter * random.random(len(exposure)))
    frames = see(scenario, CubicSpline(fine.time, fine.joints)(exposure), exposure, arrival, 0.2, random)
    ticks = slice(None, None, finer)
    return Log(fine.time[ticks], 1 / rate, commands[ticks], fine.joints[ticks], Frames(frames.features, arrival, None))


@pytest.mark.parametrize(("rate", "bandwidth"), [(30.0, 6.0), (50.0, 10.0)])
def test_motion_between_few_ticks_is_no_jitter(paper: hs.Scenario, rate: float, bandwidth: float) -> None:
    """The fitted drives tell how the joints move there; without these, the log does not tell."""
    log = log_with_few_ticks(paper, rate, bandwidth, seed=3)
    by_drives = fit_camera(log, Scene(paper), fit_drives(log, METRES, delays=(1,)))
    assert by_drives.jitter is None
    assert within(by_drives.latency, 0.05)
    assert within(by_drives.noise, 0.2)
    assert by_drives.section().verdict == "good"
    alone = fit_camera(log, Scene(paper))
    assert alone.jitter is not None
    assert not alone.jitter_is_known
    section = alone.section()
    assert section.verdict == "warning"
    words = " ".join(section.sentences)
    assert "as of motion of the joints between ticks that are long for it, or of frames that arrive later" in words
    assert "Record exposure times, or more ticks a second. The key `camera.latency_jitter` is left" in words


def test_motion_between_few_ticks_widens_the_latency(paper: hs.Scenario) -> None:
    """A spline of readings at 50 ticks a second is 0.4 ms late of drives of 10 Hz."""
    camera = fit_camera(log_with_few_ticks(paper, 50.0, 10.0, seed=3), Scene(paper))
    assert camera.latency is not None
    assert abs(camera.latency.value - 0.05) > 2e-4
    assert within(camera.latency, 0.05)


def test_jitter_as_long_as_a_motion_is_that_of_its_mean_speed(paper: hs.Scenario) -> None:
    """A frame that is taken before a jump, or after, has no speed when the usual one is taken."""
    log = log_with_few_ticks(paper, 50.0, 7.88, seed=3, jitter=0.02, size=1e-3)
    camera = fit_camera(log, Scene(paper), fit_drives(log, METRES, delays=(1,)))
    assert camera.jitter_is_known
    assert camera.jitter == pytest.approx(0.02, rel=0.4)


def test_a_scatter_that_agrees_with_no_speed_is_not_known() -> None:
    noise = Interval(0.2, 0.19, 0.21)

    def of(*jitters: float | None) -> Scatter:
        ahead = iter(jitters)
        return _of_one_speed(lambda _: Scatter(noise, next(ahead), 0.0), np.zeros((1, 8)), lambda _: np.zeros((1, 8)))

    assert of(None) == Scatter(noise, None, 0.0)
    assert of(0.05, 0.021, 0.02) == Scatter(noise, 0.02, 0.0)
    assert of(0.05, None) == Scatter(noise, 0.05, 0.0, of_ticks=True)
    assert of(0.05, 0.01, 0.05, 0.01, 0.05).of_ticks


@pytest.mark.slow
def test_a_log_with_few_ticks_gives_the_keys_of_the_camera(paper: hs.Scenario) -> None:
    log = log_with_few_ticks(paper, 50.0, 10.0, seed=3)
    found = hs.identify(log, paper.updated({"simulation.mode": "sampled", "simulation.step": 0.01}))
    assert found.camera is not None
    assert found.camera.section().verdict == "good"
    assert found.changes["camera.noise"] == pytest.approx(0.2, rel=0.1)
    assert found.changes["camera.latency_jitter"] == 0.0
    assert found.changes["camera.latency"] in (0.04, 0.06)  # whole ticks
    assert found.camera.latency is not None
    (table,) = found.sections()[-1].items
    assert isinstance(table, Table)
    (row,) = (row for row in table.rows if row[0] == "camera.latency")
    rounded, exact = found.changes["camera.latency"], found.camera.latency.value
    assert row[1] == f"{rounded:g} ({exact:.4g} before rounding)"


def test_a_spline_has_less_noise_between_two_ticks() -> None:
    time = 0.01 * np.arange(100.0)
    readings = np.random.default_rng(SEED).normal(size=(100, 4000))
    log = Log(time, 0.01, np.zeros((100, 6)), np.zeros((100, 6)), None)
    at = np.array([0.4, 0.4025, 0.505, 0.5975])
    shares = spline_shares(log, at)
    np.testing.assert_allclose(shares, CubicSpline(time, readings)(at).var(axis=1), rtol=0.1)
    assert shares[0] == pytest.approx(1.0)
    assert shares[1] == pytest.approx(shares[3])
    slopes = CubicSpline(time, readings)(at, 1).var(axis=1)
    np.testing.assert_allclose(spline_shares(log, at, derivative=1), slopes, rtol=0.1)


@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_the_noise_of_joints_is_neither_noise_nor_jitter_of_the_camera(jitter: float) -> None:
    """Of images that joints move along their motion, as they do: 0.3 px by the camera, about 0.2 px by joints."""
    random = np.random.default_rng(SEED)
    by_joints = random.normal(0.0, 0.08, (600, 8, 6))
    moving = np.einsum("ijk,ik->ij", by_joints, random.normal(size=(600, 6)))
    speed = 100.0 * moving / np.linalg.norm(moving, axis=1)[:, None] * random.uniform(0.0, 2.0, (600, 1))
    left = random.normal(0.0, 0.3, (600, 8)) + np.einsum("ijk,ik->ij", by_joints, random.normal(size=(600, 6)))
    left += speed * random.uniform(-jitter / 2, jitter / 2, (600, 1))
    found = scatter_of(left, speed, by_joints, 1.0)
    assert within(found.noise, 0.3)
    assert 0.2 < found.of_joints < 0.5
    assert found.jitter == (None if jitter == 0.0 else pytest.approx(jitter, rel=0.2))
    blamed = scatter_of(left, speed, np.zeros_like(by_joints), 1.0)
    assert blamed.noise.low > 0.3
    assert blamed.jitter is not None


def test_a_fitted_target_takes_six_of_the_residuals() -> None:
    """Of five frames that scatter by 0.3 px about a target whose displacement is fitted to them."""
    random, found = np.random.default_rng(SEED), []
    for _ in range(400):
        by_target = np.linalg.qr(random.normal(size=(40, 6)))[0]
        left = random.normal(0.0, 0.3, 40)
        left = (left - by_target @ (by_target.T @ left)).reshape(5, 8)
        speed = random.normal(0.0, 100.0, (5, 8))
        found.append(scatter_of(left, speed, np.zeros((5, 8, 6)), 1.0).noise.value)
    variance, across = float(np.mean(np.square(found))), 40 - 5 - 6
    overlap = 6 * 5 / 40  # of the target's numbers, along the motion
    assert variance == pytest.approx(0.3**2 * (1 + overlap / across), rel=4 * np.sqrt(2 / (400 * across)))


def test_jitter_is_the_whole_width_of_uniform_latencies(paper: hs.Scenario) -> None:
    """Also of the share at either end that is left out of it: of latencies spread evenly over 20 ms, 20 ms."""
    log = seen_log(paper, 0.05, stamps=0.0)
    assert log.frames is not None
    assert log.frames.exposure is not None
    late = np.random.default_rng(SEED).permutation(np.linspace(0.0, 0.02, len(log.frames.arrival)))
    frames = replace(log.frames, arrival=log.frames.exposure + 0.05 + late)
    camera = fit_camera(replace(log, frames=frames), Scene(paper))
    assert camera.jitter == pytest.approx(0.02, rel=1e-6)


def test_the_noise_of_joints_does_not_move_the_latency(paper: hs.Scenario) -> None:
    """Of frames that are all taken at a quarter of a tick, where the spline has more noise than between two."""
    log = seen_log(paper, 0.05, stamps=None)
    exposure: Array = 0.3025 + 0.03 * np.arange(150.0)
    lengths = CubicSpline(log.time, log.joints)(exposure)
    for seed in (0, 1):
        random = np.random.default_rng(seed)
        frames = replace(see(paper, lengths, exposure, np.asarray(exposure + 0.05), 0.05, random), exposure=None)
        noisy = log.joints + random.normal(0.0, 5e-5, log.joints.shape)
        camera = fit_camera(replace(log, joints=noisy, frames=frames), Scene(paper))
        assert within(camera.latency, 0.05)
        assert camera.jitter is None
        assert not camera.noise_is_of_camera
        assert camera.section().verdict == "warning"


def test_a_shift_of_noisy_readings_is_known_less_well() -> None:
    """By the share of their slopes that is noise; what other numbers explain does not determine it."""
    slopes = np.array([[3.0, 0.0], [4.0, 0.0], [7.0, 1.0]])
    assert overstated(slopes, 0.0) == pytest.approx(1.0)
    assert overstated(slopes, 5.0) == pytest.approx(25.0 / 20.0)
    assert overstated(slopes, 21.0) == np.inf  # as noise of 25 may be
    assert overstated(slopes, 25.0) == np.inf


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_of_joints_at_rest_does_not_tell_the_latency(paper: hs.Scenario, seed: int) -> None:
    """Their spline moves, by noise alone: least squares took it for a motion, and stated 53.4 +- 1.2 ms or 155 ms."""
    log = seen_log(paper, 0.05, stamps=None, moving=False, seed=seed)
    noisy = log.joints + np.random.default_rng(seed).normal(0.0, 5e-5, log.joints.shape)
    assert not fit_camera(replace(log, joints=noisy), Scene(paper)).latency_is_known


def test_an_image_moves_a_shift_as_least_squares_does() -> None:
    random = np.random.default_rng(SEED)
    slopes, image = random.normal(size=(40, 3)), random.normal(size=40)
    assert moved_by(slopes, image) == pytest.approx(np.linalg.lstsq(slopes, image)[0][0])
    assert moved_by(np.zeros((40, 3)), image) == np.inf


def test_what_is_no_noise_of_the_camera_is_no_key(paper: hs.Scenario) -> None:
    """Nor is it jitter; the latency is that found less half of the jitter that was given."""
    log = seen_log(paper, 0.05, stamps=None)
    drives = drives_of_seen_log()
    known = CameraFit(
        300, latency=Interval(0.07, 0.069, 0.071), jitter=0.04, noise=Interval(0.5, 0.4, 0.6), explained=1.0
    )
    given = paper.updated({"camera.latency": 0.1, "camera.latency_jitter": 0.02, "simulation.mode": "sampled"})
    changes = changes_of(log, given, drives, known)
    assert (changes["camera.latency"], changes["camera.latency_jitter"]) == (0.05, 0.04)
    assert "camera.noise" in changes
    for doubtful, reasons in (
        (replace(known, of_joints=0.7), ("joints explains 70 %", "as of the noise of the joints, or of frames")),
        (
            replace(known, of_joints=0.2, ticks_are_coarse=True),
            ("Motion of the joints between ticks that are long for it may explain 20 %", "as of motion of the joints"),
        ),
        (replace(known, correlated=7.0), ("correlated", "as of a wrong calibration, or of frames")),
    ):
        changes = changes_of(log, given, drives, doubtful)
        assert changes["camera.latency"] == 0.06
        assert not {"camera.noise", "camera.latency_jitter"} & set(changes)
        section = doubtful.section()
        (table,) = section.items
        assert isinstance(table, Table)
        rows = {row[0]: row[1] for row in table.rows}
        assert rows["a frame is later by at most"] == "not determined"
        assert (rows["noise of a coordinate"] == "not determined") == (not doubtful.noise_is_of_camera)
        words = " ".join(section.sentences)
        assert all(reason in words for reason in reasons)
        assert "the log does not tell which" in words
        assert "`camera.noise` and `camera.latency_jitter` are left" in words
        stamped = replace(doubtful, stamps=Interval(0.0, -1e-4, 1e-4))
        assert changes_of(log, given, drives, stamped)["camera.latency_jitter"] == 0.04


def test_exposure_times_that_are_wrong_are_a_fault_and_no_key(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=0.008)
    camera = fit_camera(log, Scene(paper))
    scenario = paper.updated({"simulation.mode": "sampled", "simulation.step": 0.01, "camera.latency": 0.05})
    assert faults_of(scenario, drives_of_seen_log(), camera) == {"uncertainty.latency": -0.01}
    assert not any(key.startswith("uncertainty") for key in changes_of(log, paper, drives_of_seen_log(), camera))
    section = camera.section()
    assert section.verdict == "warning"
    assert any("before what they state" in words for words in section.sentences)
    right = fit_camera(seen_log(paper, 0.05, stamps=0.0), Scene(paper))
    assert faults_of(scenario, drives_of_seen_log(), right) == faults_of(scenario, drives_of_seen_log(), None) == {}
    assert right.section().verdict == "good"


def test_a_machine_of_unknown_latency_uses_no_exposure_times_that_may_be_wrong(paper: hs.Scenario) -> None:
    """Its scenario refuses `uncertainty.latency`."""
    machine = hs.load_scenario("pi-h824-positions", {"camera.latency_known": False})
    log = seen_log(paper, 0.05, stamps=0.02)
    camera = fit_camera(log, Scene(paper))
    assert faults_of(machine, drives_of_seen_log(), camera) == {}
    assert faults_of(machine.updated({"camera.latency_known": True}), drives_of_seen_log(), camera)


def test_a_target_of_another_size_gives_no_noise_and_no_good_camera(paper: hs.Scenario) -> None:
    """Its fit displaces the target, and leaves what is no noise: the true one is 0.02 px."""
    points = Scene(paper).points
    larger = points.mean(axis=0) + 1.15 * (points - points.mean(axis=0))
    there = paper.updated({"target.initial_features": None, "target.depth": None, "target.points": larger.tolist()})
    log = seen_log(there, 0.06, stamps=None, noise=0.02)
    camera = fit_camera(log, Scene(paper))
    assert camera.target_is_apparent
    assert not camera.noise_is_white
    section = camera.section()
    assert section.verdict == "warning"
    assert any("focal length" in words and "target.points" in words for words in section.sentences)
    assert any("it is more than noise" in words for words in section.sentences)
    assert "camera.noise" not in changes_of(log, paper, drives_of_seen_log(), camera)
    right = fit_camera(seen_log(paper, 0.06, stamps=None), Scene(paper))
    assert right.noise_is_white
    assert not right.target_is_apparent


def repeating(log: Log) -> Log:
    """The log of a driver that hands over each frame twice, half a period apart."""
    assert log.frames is not None
    arrival = np.repeat(log.frames.arrival, 2) + np.tile([0.0, 1 / 60], len(log.frames.arrival))
    return replace(log, frames=Frames(np.repeat(log.frames.features, 2, axis=0), arrival, None))


def test_a_driver_that_is_asked_at_every_tick_repeats_its_frames(paper: hs.Scenario) -> None:
    """Of which there are three or four for each frame of the camera."""
    log = seen_log(paper, 0.05, stamps=None)
    assert log.frames is not None
    asked = log.time[(log.time >= log.frames.arrival[0]) & (log.time <= log.frames.arrival[-1])]
    newest = np.searchsorted(log.frames.arrival, asked + 1e-9, side="right") - 1
    found = fit_camera(replace(log, frames=Frames(log.frames.features[newest], asked, None)), Scene(paper))
    assert found.repeated == len(asked) - len(np.unique(newest))
    assert found.period is not None
    assert found.period.low < 1 / 30 < found.period.high


def test_frames_that_are_repeated_do_not_count(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    assert log.frames is not None  # as written with six digits: a few coordinates are equal by chance
    log = replace(log, frames=replace(log.frames, features=np.round(log.frames.features, 3)))
    once, twice = fit_camera(log, Scene(paper)), fit_camera(repeating(log), Scene(paper))
    assert (once.repeated, twice.repeated) == (0, 135)
    assert (twice.period, twice.latency, twice.noise) == (once.period, once.latency, once.noise)
    assert any(words.startswith("135 of 270 frames repeat the one before") for words in twice.section().sentences)


def test_equal_frames_of_a_rounded_image_or_of_joints_at_rest_count(paper: hs.Scenario) -> None:
    log = repeating(seen_log(paper, 0.05, stamps=None))
    assert log.frames is not None
    rounded = replace(log, frames=replace(log.frames, features=np.round(log.frames.features)))
    assert fit_camera(rounded, Scene(paper)).repeated == 0
    rests = replace(log, joints=np.repeat(log.joints[:1], len(log.joints), axis=0))
    assert fit_camera(rests, Scene(paper)).repeated == 0


def test_an_exact_image_at_rest_does_not_repeat_while_the_joints_have_noise(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None, noise=0.0)
    assert log.frames is not None
    half = log.time[-1] / 2.0
    still, after = log.time > half, log.frames.arrival > half
    joints, features = log.joints.copy(), log.frames.features.copy()
    noise = 1e-6 * np.random.default_rng(3).normal(size=joints[still].shape)
    joints[still] = joints[still][0] + noise
    features[after] = features[after][0]
    rests = replace(log, joints=joints, frames=replace(log.frames, features=features))
    assert (np.diff(features, axis=0) == 0.0).all(axis=1).sum() > 50
    assert fit_camera(rests, Scene(paper)).repeated == 0


def test_an_exact_image_that_rests_for_a_while_does_not_repeat_either(paper: hs.Scenario) -> None:
    """It moves before and after: without noise of the joints, which is no motion, it would be seen to rest."""
    log = seen_log(paper, 0.05, stamps=None, noise=0.0)
    assert log.frames is not None
    begin, end = log.time[-1] / 3.0, 2.0 * log.time[-1] / 3.0
    rest, equal = ((one > begin) & (one < end) for one in (log.time, log.frames.arrival))
    joints, features = log.joints.copy(), log.frames.features.copy()
    joints[rest] = joints[rest][0] + 1e-6 * np.random.default_rng(3).normal(size=joints[rest].shape)
    features[equal] = features[equal][0]
    rests = replace(log, joints=joints, frames=replace(log.frames, features=features))
    assert rests.frames is not None
    assert not repeats(rests, rests.frames).any()


@pytest.mark.parametrize(("noise", "step"), [(0.0, 1e-6), (0.0, 0.1)])
def test_images_that_are_equal_at_a_long_rest_count(paper: hs.Scenario, noise: float, step: float) -> None:
    """They are rounded to `step` [px], 1e-6 as of a camera without noise, and the joints are noisy."""
    log = seen_log(paper, 0.05, stamps=None, noise=noise, rest=7500)
    assert log.frames is not None
    log = replace(log, frames=replace(log.frames, features=np.round(log.frames.features / step) * step))
    assert log.frames is not None
    assert (np.diff(log.frames.features, axis=0) == 0.0).all(axis=1).sum() > 100
    assert not repeats(log, log.frames).any()


def test_frames_that_are_repeated_at_rest_too_do_not_count(paper: hs.Scenario) -> None:
    log = repeating(seen_log(paper, 0.05, stamps=None, rest=1500))
    assert log.frames is not None
    assert repeats(log, log.frames).sum() == len(log.frames.arrival) // 2


def test_repeated_frames_are_no_stragglers(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=0.0)
    twice = repeating(log)
    assert log.frames is not None
    assert log.frames.exposure is not None
    assert twice.frames is not None
    exposure = np.repeat(log.frames.exposure, 2)
    camera = fit_camera(replace(twice, frames=replace(twice.frames, exposure=exposure)), Scene(paper))
    assert (camera.repeated, camera.stragglers) == (135, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("jitter", "noise"), [(0.004, 0.2), (0.01, 0.2), (0.02, 0.02)])
def test_intervals_contain_latency_and_noise_of_frames_that_jitter(
    paper: hs.Scenario, jitter: float, noise: float
) -> None:
    scene, count = Scene(paper), 60
    logs = (seen_log(paper, 0.05, stamps=None, jitter=jitter, noise=noise, seed=seed) for seed in range(count))
    fits = [fit_camera(log, scene) for log in logs]
    targets = np.array([np.abs(fit.target) < 1.96 * fit.target_deviations for fit in fits])
    hits = {
        "latency": sum(within(fit.latency, 0.05 + jitter / 2) for fit in fits),
        "noise": sum(within(fit.noise, noise) for fit in fits),
        **{f"target {number}": int(column.sum()) for number, column in enumerate(targets.T)},
    }
    print(f"jitter {jitter} s, noise {noise} px, {count} logs: {hits}")
    assert min(hits.values()) >= 0.85 * count, hits


def test_the_rounding_of_resting_joints_is_no_noise_of_the_camera(paper: hs.Scenario) -> None:
    """Their readings do not differ, and the image that is predicted from them is off by the same at a whole rest."""
    random, finer, step = np.random.default_rng(SEED), 10, 1.2e-4
    jumps = np.repeat(commands_of(paper, random, 50, 0.5, 2e-3), 25, axis=0)  # of which legs rest for most of 0.5 s
    fine = record(np.repeat(jumps, finer, axis=0), 0.02 / finer, [Drive(10.0, 0.8, finer)] * 6, 0.0, random)
    exposure: Array = 0.313 + np.arange(700) / 30.0
    frames = see(paper, CubicSpline(fine.time, fine.joints)(exposure), exposure, exposure + 0.05, 0.2, random)
    log = Log(fine.time[::finer], 0.02, jumps, np.round(fine.joints[::finer] / step) * step, frames)
    white = joint_deviations(log.joints)
    added = rounding_deviations(log.joints, white)
    np.testing.assert_allclose(np.hypot(white, added), step / np.sqrt(12.0), rtol=1e-6)
    half = np.full(6, step / np.sqrt(24.0))  # of the variance, which differences of readings in motion have
    np.testing.assert_allclose(rounding_deviations(log.joints, half), half, rtol=1e-6)
    assert (rounding_deviations(fine.joints, white) < 1e-9).all()
    camera = fit_camera(log, Scene(paper))
    assert 0.05 < camera.of_joints < 0.5
    assert within(camera.noise, 0.2)
