"""Machines found from logs: drives by SciPy, images at the true exposures, intervals that hold their promise."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.stats import binom
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli.commands import app
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.evidence import Table
from hexservo.findings.identification.changes import in_whole_ticks, ticks_of
from hexservo.findings.identification.drives import DriveFit, fit_drives
from hexservo.findings.identification.frames import fit_camera
from hexservo.findings.identification.interval import Interval, correlated, deviations, half_width
from hexservo.findings.identification.log import Log
from hexservo.findings.identification.predicted_images import MOST_LATENCY
from hexservo.scenario.leg_units import LegUnits
from hexservo.scenario.parameters import core_parameters
from recorded_machines import Drive, record, see, wandering

Array = NDArray[np.float64]

METRES = LegUnits("m", "N")
SEED = 20260


def commands_of(scenario: hs.Scenario, random: np.random.Generator, ticks: int, period: float, size: float) -> Array:
    """Lengths (n, 6) of legs whose platform jumps about home by normal steps of `size` [m] in all directions."""
    scene = Scene(scenario)
    unit = np.repeat([1.0, 1.0 / scene.platform_radius], 3)
    poses = scene.home.moved(wandering(random, ticks, period, size, 0.3) * unit)
    rows = zip(poses.position, poses.quaternion, strict=True)
    return np.array([scene.hexapod.leg_lengths(position, quaternion) for position, quaternion in rows])


def within(found: Interval | None, value: float) -> bool:
    return found is not None and found.low <= value <= found.high


def try_delays(monkeypatch: pytest.MonkeyPatch, *delays: int) -> None:
    """Have `identify` try these delays of the drives alone, of 0 to 8 ticks: in a part of the time."""
    monkeypatch.setattr("hexservo.findings.identification.fit_drives", partial(fit_drives, delays=delays))


# ---- Drives ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("period", [1e-3, 0.02])
def test_the_core_s_drive_is_scipy_s(damping: float, period: float) -> None:
    random = np.random.default_rng(SEED)
    commands = wandering(random, 400, period, 0.01, 10 * period)[:, 0]
    drive = Drive(0.08 / period, damping)
    found = _core.drive_response(commands, commands[0], 0.0, period, drive.bandwidth, damping, np.inf, np.inf)
    np.testing.assert_allclose(found, drive.follow(commands, period), atol=1e-13)


def test_the_core_s_drive_keeps_its_limits_to_second_order() -> None:
    random = np.random.default_rng(SEED)
    commands = wandering(random, 300, 0.01, 0.01, 0.2)[:, 0]
    drive = Drive(6.0, 0.7, speed=0.05, acceleration=1.0)
    found = _core.drive_response(commands, commands[0], 0.0, 0.01, 6.0, 0.7, 0.05, 1.0)
    np.testing.assert_allclose(found, drive.follow(commands, 0.01), atol=1e-5)  # 0.1 % of a step's motion
    assert np.abs(np.diff(found)).max() <= 0.05 * 0.01 * (1 + 1e-9)
    for rate in (0.075, 5.0):  # faster than the drive: it starts at its limit
        started, limit = (_core.drive_response(commands, 0.0, each, 0.02, 6.0, 0.7, 0.05, 1.0) for each in (rate, 0.05))
        np.testing.assert_array_equal(started, limit)


def random_logs(
    count: int, *, limited: bool, delays: Sequence[int] = range(9)
) -> list[tuple[list[Drive], float, list[DriveFit]]]:
    """Fit `count` random machines of six drives each, whose delays are the first five that are tried, or fewer."""
    random = np.random.default_rng(SEED + limited)
    print(f"seed {SEED + limited}")
    found = []
    for _ in range(count):
        period = float(random.choice([1e-3, 5e-3, 0.02]))
        ticks = int(random.integers(400, 800))
        size = 10 ** random.uniform(-3.5, -2)
        drives = [
            Drive(
                bandwidth=float(10 ** random.uniform(-1.7, -0.9) / period),
                damping=float(10 ** random.uniform(-0.4, 0.2)),
                delay=int(random.choice(delays[:5])),
            )
            for _ in range(6)
        ]
        if limited:
            drives = [replace(drive, speed=0.4 * 2 * np.pi * drive.bandwidth * size) for drive in drives]
        commands = 0.2 + wandering(random, ticks, period, size, 40 * period)
        log = record(commands, period, drives, size * 10 ** random.uniform(-3, -1), random)
        found.append((drives, period, list(fit_drives(log, METRES, delays=delays).fits)))
    return found


def coverage(logs: list[tuple[list[Drive], float, list[DriveFit]]]) -> dict[str, float]:
    """Share of the true values that the stated intervals contain."""
    pairs = [(drive, fit) for drives, _, fits in logs for drive, fit in zip(drives, fits, strict=True)]
    shares = {
        "bandwidth": np.mean([within(fit.bandwidth, drive.bandwidth) for drive, fit in pairs]),
        "damping": np.mean([within(fit.damping, drive.damping) for drive, fit in pairs]),
        "delay": np.mean([within(fit.delay, drive.delay) for drive, fit in pairs]),
        "no acceleration limit": np.mean([fit.acceleration_limit is None for _, fit in pairs]),
    }
    if np.isinf(pairs[0][0].speed):
        shares["no speed limit"] = np.mean([fit.speed_limit is None for _, fit in pairs])
    else:
        shares["speed limit"] = np.mean([within(fit.speed_limit, drive.speed) for drive, fit in pairs])
    print(len(pairs), "drives:", {name: round(float(share), 3) for name, share in shares.items()})
    return {name: float(share) for name, share in shares.items()}


def errors_in_deviations(logs: list[tuple[list[Drive], float, list[DriveFit]]]) -> Array:
    """Return the errors of bandwidths and dampings in the standard deviations that their intervals state, (2, n)."""

    def error(found: Interval | None, true: float) -> float:
        assert found is not None
        width = np.log(found.high / found.low) if found.is_bounded else np.inf
        return float(np.log(found.value / true) / (width / (2 * 1.96)))

    pairs = [(drive, fit) for drives, _, fits in logs for drive, fit in zip(drives, fits, strict=True)]
    found = [(error(fit.bandwidth, true.bandwidth), error(fit.damping, true.damping)) for true, fit in pairs]
    return np.array(found).T


def test_errors_of_six_random_drives_are_of_the_size_that_their_intervals_state() -> None:
    """The mean of 12 squares of normal numbers is between 0.25 and 2.6 in 99 of 100 cases."""
    logs = random_logs(1, limited=False, delays=(1,))
    coverage(logs)
    mean = float((errors_in_deviations(logs) ** 2).mean())
    print(f"mean square {mean:.2f}")
    assert 0.25 <= mean <= 2.6


@pytest.mark.slow
@pytest.mark.parametrize("limited", [False, True])
def test_intervals_contain_the_true_values_of_500_random_drives(limited: bool) -> None:
    logs = random_logs(84, limited=limited)
    shares = coverage(logs)
    assert all(share >= 0.9 for share in shares.values()), shares
    spread = 1.4826 * np.median(np.abs(errors_in_deviations(logs)), axis=1)  # of normal numbers 1 +- 5 %
    print(f"spread of the errors in stated deviations {spread}")
    assert (np.abs(spread - 1.0) <= 0.3).all()


def test_both_limits_are_found_where_they_act() -> None:
    random = np.random.default_rng(SEED)
    drives = [Drive(5.0, 0.9, 1, speed=0.03, acceleration=0.6)] * 6
    log = record(0.2 + wandering(random, 500, 0.01, 0.004, 0.4), 0.01, drives, 2e-6, random)
    for fit in fit_drives(log, METRES, delays=(1,)).fits:
        assert fit.speed_limit is not None
        assert fit.speed_limit.value == pytest.approx(0.03, rel=2e-3)
        assert fit.acceleration_limit is not None
        assert fit.acceleration_limit.value == pytest.approx(0.6, rel=1e-2)
        assert fit.explained is not None
        assert fit.explained > 0.999


def test_an_acceleration_limit_leaves_bandwidth_and_damping_without_bias() -> None:
    """Ticks of 20 ms, legs of some 10 Hz: the core's own steps are off by 4 to 11 um, and the noise is 5 um.

    The mean of 6 squares of normal numbers is below 3.1 in 995 of 1000 cases.
    """
    random = np.random.default_rng(SEED)
    responses = [(11.2, 0.886), (9.0, 0.62), (10.0, 1.1)]
    drives = [Drive(*response, 1, acceleration=0.672) for response in responses] * 2
    moves = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # three legs rest
    log = record(0.2 + moves * wandering(random, 300, 0.02, 0.004, 0.4), 0.02, drives, 5e-6, random)
    fits = list(fit_drives(log, METRES, delays=(1,)).fits)[:3]
    mean = float((errors_in_deviations([(drives[:3], 0.02, fits)]) ** 2).mean())
    print(f"seed {SEED}, mean square {mean:.2f}")
    assert mean <= 3.1
    for fit in fits:
        assert fit.acceleration_limit is not None
        assert fit.acceleration_limit.value == pytest.approx(0.672, rel=3e-3)


def test_a_leg_that_rests_is_not_identified() -> None:
    random = np.random.default_rng(SEED)
    commands = 0.2 + wandering(random, 400, 0.01, 0.004, 0.4)
    commands[:, 2] = 0.2
    found = fit_drives(record(commands, 0.01, [Drive(5.0, 0.9)] * 6, 1e-5, random), METRES, delays=(0,))
    assert found.fits[2].bandwidth is None
    assert [fit.leg for fit in found.moved] == [1, 2, 4, 5, 6]
    section = found.section()
    assert section.verdict == "warning"
    assert any("leg 3" in sentence for sentence in section.sentences)


def test_a_leg_that_does_not_follow_is_not_identified() -> None:
    """A dead motor: commands jump, and the coordinate stays at zero."""
    random = np.random.default_rng(SEED)
    commands = wandering(random, 200, 0.01, 0.004, 0.4)
    log = record(commands, 0.01, [Drive(5.0, 0.9)] * 6, 1e-6, random)
    joints = log.joints.copy()
    joints[:, 4] = 0.0
    found = fit_drives(replace(log, joints=joints), METRES, delays=(0,))
    assert found.fits[4].bandwidth is None
    assert found.section().verdict == "warning"
    assert within(found.fits[0].bandwidth, 5.0)


@pytest.mark.slow
def test_friction_widens_the_intervals_and_is_named() -> None:
    """A dead zone of the drive, which the model lacks: what it leaves is correlated, and the prediction is worse."""
    random = np.random.default_rng(SEED)
    commands = 0.2 + wandering(random, 500, 0.01, 0.001, 0.4)
    log = record(commands, 0.01, [Drive(5.0, 0.9)] * 6, 1e-6, random)
    stuck = np.array(log.joints)
    for tick in range(1, len(stuck)):  # moves only when it is 0.2 mm behind
        stuck[tick] = np.where(np.abs(stuck[tick] - stuck[tick - 1]) > 2e-4, stuck[tick], stuck[tick - 1])
    free, held = fit_drives(log, METRES), fit_drives(replace(log, joints=stuck), METRES)
    for one, other in zip(free.fits, held.fits, strict=True):
        assert one.correlated < 2.0
        assert other.correlated > 3.0
        assert other.bandwidth is not None
        assert one.bandwidth is not None
        assert other.bandwidth.high - other.bandwidth.low > 10 * (one.bandwidth.high - one.bandwidth.low)
        assert one.explained is not None
        assert other.explained is not None
        assert other.explained < one.explained
    assert any("friction" in sentence for sentence in held.section().sentences)


def test_deviations_are_those_of_repeated_fits() -> None:
    """Of a line through correlated noise, by 2000 draws; a column that changes nothing is not known at all."""
    random = np.random.default_rng(SEED)
    x = np.linspace(-1.0, 1.0, 400)
    jacobian = np.stack([np.ones_like(x), x, np.zeros_like(x)], axis=1)
    found, stated = [], []
    for _ in range(2000):
        white = random.normal(size=len(x) + 4)
        noise = np.convolve(white, np.ones(5), mode="valid")  # correlated over 5 samples
        line = np.polynomial.polynomial.polyfit(x, noise, 1)
        left = noise - jacobian[:, :2] @ line
        found.append(line)
        stated.append(deviations(jacobian, left, len(x) / correlated(left)))
    scatter = np.std(found, axis=0)
    np.testing.assert_allclose(np.median(stated, axis=0)[:2], scatter, rtol=0.15)
    assert np.isinf(stated[0][2])


def test_an_interval_has_1_96_deviations_to_each_side() -> None:
    assert half_width(1.0) == pytest.approx(1.959964, abs=1e-6)
    assert Interval.around(2.0, 0.5) == Interval(2.0, 2.0 - half_width(0.5), 2.0 + half_width(0.5))
    of_logarithm = Interval.of_logarithm(2.0, 0.1)
    assert (of_logarithm.low, of_logarithm.high) == pytest.approx((2.0 * np.exp(-0.1959964), 2.0 * np.exp(0.1959964)))


# ---- Camera ---------------------------------------------------------------------------------------------------------


def seen_log(
    scenario: hs.Scenario,
    latency: float,
    *,
    stamps: float | None,
    jitter: float = 0.0,
    moving: bool = True,
    noise: float = 0.2,
    seed: int = SEED,
    rest: int = 0,
) -> Log:
    """A log of a machine whose camera takes 30 frames a second; stamps are late by `stamps` [s].

    It rests for the last `rest` ticks, of 10 ms, after 5 s of motion.
    """
    random = np.random.default_rng(seed)
    period, ticks = 0.01, 500
    commands = commands_of(scenario, random, ticks, period, 1e-3 if moving else 0.0)
    commands = np.concatenate([commands, np.repeat(commands[-1:], rest, axis=0)])
    drives = [Drive(6.0, 0.8, 1)] * 6
    log = record(commands, period, drives, 1e-7, random)
    true = np.stack([drive.follow(commands[:, leg], period) for leg, drive in enumerate(drives)], axis=1)
    exposure = 0.3 + np.arange(135 + int(rest * period * 30.0)) / 30.0
    arrival = np.maximum.accumulate(exposure + latency + jitter * random.random(len(exposure)))
    frames = see(scenario, CubicSpline(log.time, true)(exposure), exposure, arrival, noise, random)
    return replace(log, frames=replace(frames, exposure=None if stamps is None else exposure + stamps))


@pytest.mark.parametrize("latency", [0.0, 0.04, 0.123, 0.24])
def test_an_unknown_latency_is_found_from_motion(paper: hs.Scenario, latency: float) -> None:
    camera = fit_camera(seen_log(paper, latency, stamps=None), Scene(paper))
    assert camera.latency is not None
    assert camera.latency.value == pytest.approx(latency, abs=1e-3)
    assert camera.latency_is_known
    assert camera.noise is not None
    dof = 0.7 * 135 * 8 - 7
    assert camera.noise.value == pytest.approx(0.2, rel=4 / np.sqrt(2 * dof))  # four of its standard deviations
    assert within(camera.period, 1 / 30) or camera.period.value == pytest.approx(1 / 30, rel=1e-9)  # type: ignore[union-attr]
    assert camera.explained is not None
    assert camera.explained > 0.99


def test_seconds_since_1970_are_the_same_log(paper: hs.Scenario) -> None:
    """Steps of 2.4e-7 s of such times are all that is lost: the step of a difference quotient is far below them."""
    log, since = seen_log(paper, 0.04, stamps=2e-3), 1.79e9
    assert log.frames is not None
    assert log.frames.exposure is not None
    frames = replace(log.frames, arrival=log.frames.arrival + since, exposure=log.frames.exposure + since)
    time = log.time + since
    other = replace(log, time=time, period=float(time[-1] - time[0]) / (len(time) - 1), frames=frames)
    assert other.period == log.period == 0.01
    assert other.frames is not None
    assert other.frames.exposure is not None
    np.testing.assert_allclose(other.time, log.time, rtol=0, atol=5e-7)
    np.testing.assert_allclose(other.frames.arrival, log.frames.arrival, rtol=0, atol=5e-7)
    np.testing.assert_allclose(other.frames.exposure, log.frames.exposure, rtol=0, atol=5e-7)


@pytest.mark.slow
def test_intervals_of_the_latency_contain_the_true_one(paper: hs.Scenario) -> None:
    random = np.random.default_rng(SEED + 7)
    print(f"seed {SEED + 7}")
    hits = []
    for trial in range(200):
        latency = float(random.uniform(0.01, 0.24))
        camera = fit_camera(seen_log(paper, latency, stamps=None, seed=trial), Scene(paper))
        hits.append(within(camera.latency, latency))
    print(f"{sum(hits)} of {len(hits)} intervals contain the true latency")
    assert np.mean(hits) >= 0.9


def test_exposure_times_give_jitter_and_their_own_error(paper: hs.Scenario) -> None:
    camera = fit_camera(seen_log(paper, 0.05, stamps=0.006, jitter=0.02), Scene(paper))
    assert camera.stamps is not None
    assert camera.stamps.value == pytest.approx(0.006, abs=5e-4)
    assert camera.jitter == pytest.approx(0.02, rel=0.1)
    assert camera.latency is not None
    assert camera.latency.value == pytest.approx(0.06, abs=2e-3)
    # The mean of uniform jitter, and the mean error of the stamps, which is independent of it.
    wide = np.hypot(1.96 * 0.02 / np.sqrt(12 * 135), (camera.stamps.high - camera.stamps.low) / 2)
    assert (camera.latency.high - camera.latency.low) / 2 == pytest.approx(wide, rel=4 / np.sqrt(5 * 135))


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_intervals_of_stamped_logs_contain_latency_and_stamps(paper: hs.Scenario, jitter: float) -> None:
    """And are about as wide as the estimates scatter, which 60 of them give to 9 %.

    That of the stamps is 1.4 times as wide: residuals count as correlated over the longest time of eight coordinates.
    """
    scene, count = Scene(paper), 60
    logs = (seen_log(paper, 0.05, stamps=0.006, jitter=jitter, seed=1000 + number) for number in range(count))
    fits = [fit_camera(log, scene) for log in logs]
    for name, true in (("latency", 0.05 + jitter / 2), ("stamps", 0.006)):
        found = [getattr(fit, name) for fit in fits]
        hits = sum(within(one, true) for one in found)
        stated = np.median([one.high - one.low for one in found]) / (2 * 1.96)
        ratio = stated / np.std([one.value for one in found])
        print(f"jitter {jitter} s, {name}: {hits} of {count}, {1e3 * stated:.3f} ms stated, {ratio:.2f} of the scatter")
        assert hits >= binom.ppf(1e-4, count, 0.95)
        assert 0.65 <= ratio <= 1.8


def test_a_frame_that_is_very_late_is_left_out(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=0.0, jitter=0.01)
    assert log.frames is not None
    usual = fit_camera(log, Scene(paper))
    arrival = log.frames.arrival.copy()
    arrival[-1] += 0.2
    camera = fit_camera(replace(log, frames=replace(log.frames, arrival=arrival)), Scene(paper))
    assert usual.stragglers == 0
    assert camera.stragglers == 1
    assert usual.jitter is not None
    assert camera.jitter == pytest.approx(usual.jitter, rel=0.05)
    assert camera.latency is not None
    assert usual.latency is not None
    assert camera.latency.value == pytest.approx(usual.latency.value, abs=1e-4)
    assert camera.period is not None
    assert usual.period is not None
    assert camera.period.value == pytest.approx(usual.period.value, rel=1e-9)
    (sentence,) = (words for words in camera.section().sentences if "left out" in words)
    assert sentence.startswith("1 of ")


def test_a_platform_at_rest_does_not_tell_the_latency(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.1, stamps=None, moving=False)
    camera = fit_camera(log, Scene(paper))
    assert camera.latency is not None
    assert (camera.latency.low, camera.latency.high) == (0.0, MOST_LATENCY)
    assert not camera.latency_is_known
    assert "does not tell the latency" in camera.section().sentences[0]
    assert camera.explained is None
    assert camera.section().verdict == "warning"


def test_the_target_is_found_where_it_is(paper: hs.Scenario) -> None:
    """The log was made with another target pose than the machine's scenario has."""
    points = Scene(paper).points + np.array([0.004, -0.003, 0.01])
    there = paper.updated({"target.initial_features": None, "target.depth": None, "target.points": points.tolist()})
    camera = fit_camera(seen_log(there, 0.06, stamps=None), Scene(paper))
    np.testing.assert_allclose(camera.target[:3], [0.004, -0.003, 0.01], atol=1e-3)
    assert camera.latency is not None
    assert camera.latency.value == pytest.approx(0.06, abs=1e-3)


def test_another_number_of_points_is_an_open_question(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    assert log.frames is not None
    few = replace(log, frames=replace(log.frames, features=log.frames.features[:, :6]))
    camera = fit_camera(few, Scene(paper))
    assert "expected 4 points" in camera.open
    assert camera.section().verdict == "open"


def test_a_camera_on_the_base_is_an_open_question(paper: hs.Scenario) -> None:
    found = fit_camera(seen_log(paper, 0.05, stamps=None), Scene(hs.load_scenario("eye-to-hand")))
    assert "camera.mount.on" in found.open


# ---- From a log to a scenario ----------------------------------------------------------------------------------------


def test_the_identified_scenario_moves_as_the_core_s_own_run(
    paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of the core with positions, logged, gives back its own keys."""
    try_delays(monkeypatch, 1, 2, 3)
    scenario = paper.updated(
        {
            "simulation.mode": "sampled",
            "simulation.step": 0.01,
            "simulation.duration": 3.0,
            "controller.law": "resolved_rate",
            "actuators.kind": "position",
            "actuators.delay": 0.02,
            "actuators.position.bandwidth": 7.0,
            "actuators.position.damping": 0.7,
            "camera.period": 0.03,
            "camera.latency": 0.0,
            "sensors.pose": "encoders",
        }
    )
    ticks = _core.recorded_ticks(core_parameters(scenario))
    log = Log(ticks["now"][:, 0], 0.01, ticks["leg_positions"], ticks["leg_lengths"], None)
    found = hs.identify(log, paper)
    assert found.scenario.actuators.delay == 0.02
    assert found.scenario.actuators.position.bandwidth == pytest.approx(7.0, rel=1e-4)
    assert found.scenario.actuators.position.damping == pytest.approx(0.7, rel=1e-4)


def test_a_log_without_images_keeps_the_camera_in_whole_ticks(
    paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its ticks are longer than those of the scenario; so are delays and the end of the run in whole ones."""
    try_delays(monkeypatch, 0)
    times = {"camera.period": 0.033, "camera.latency": 0.042, "actuators.delay": 0.004, "simulation.duration": 3.01}
    machine = paper.updated({"simulation.mode": "sampled", "simulation.step": 0.001, **times})
    random = np.random.default_rng(SEED)
    commands = 0.205 + wandering(random, 120, 0.02, 0.004, 0.4)
    log = record(commands, 0.02, [Drive(4.0, 0.9)] * 6, 1e-6, random)
    found = hs.identify(log, machine)
    assert found.rounded == {"simulation.duration": 3.0, "camera.period": 0.04, "camera.latency": 0.04}
    assert found.scenario.camera.period == 0.04
    assert "camera.period" not in found.changes
    (table,) = found.sections()[-1].items
    assert isinstance(table, Table)
    assert ["camera.period", "0.04 (whole ticks)", "0.033"] in table.rows
    rests = hs.identify(replace(log, commands=np.full_like(commands, 0.205)), machine)
    assert rests.rounded["actuators.delay"] == 0.0


@pytest.mark.parametrize("rate", [30, 45, 60, 75, 90, 300])
@pytest.mark.parametrize("decimals", [6, 9, None])
def test_a_rate_that_is_no_decimal_period_keeps_the_scenario_s_step(
    paper: hs.Scenario, rate: int, decimals: int | None
) -> None:
    """The log's times are rounded, and the scenario's times remain whole numbers of its step."""
    step = 1.0 / rate
    times = {"simulation.duration": 10.0, "camera.period": 2 * step, "camera.latency": 4 * step}
    machine = paper.updated({"simulation.mode": "sampled", "simulation.step": step, **times})
    time = step * np.arange(600.0)
    time = time if decimals is None else np.round(time, decimals)
    legs = np.full((600, 6), 0.205)
    changes = ticks_of(Log(time, float(time[-1]) / 599.0, legs, legs, None), machine)
    assert changes["simulation.step"] == step
    assert in_whole_ticks(machine, changes) == {}


@pytest.mark.parametrize("step", [0.0166666667, 0.0200004, 1.0 / 60.0])
def test_times_are_whole_ticks_of_a_log_of_another_rate(paper: hs.Scenario, step: float) -> None:
    machine = paper.updated({"simulation.mode": "sampled", "simulation.step": 0.01, "simulation.duration": 10.0})
    legs = np.full((600, 6), 0.205)
    changes = ticks_of(Log(step * np.arange(600.0), step, legs, legs, None), machine)
    assert changes["simulation.step"] == float(f"{step:.9g}")
    rounded = in_whole_ticks(machine, changes)
    assert rounded["simulation.duration"] == pytest.approx(10.0, abs=step / 2)
    assert machine.updated(changes | rounded).simulation.step == changes["simulation.step"]


def test_a_scenario_without_a_run_at_the_log_s_ticks_is_refused_before_the_fit(
    paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unexpected(*_: object) -> None:
        pytest.fail("expected no fit before the scenario is known to run")

    monkeypatch.setattr("hexservo.findings.identification.fit_drives", unexpected)
    legs = np.full((100, 6), 0.205)
    log = Log(1e-5 * np.arange(100.0), 1e-5, legs, legs, None)
    long = paper.updated({"simulation.duration": 1e5, "simulation.step": 0.01, "simulation.log_every": 1000})
    with pytest.raises(hs.ScenarioError, match=r"simulation\.duration: expected at most"):
        hs.identify(log, long)


def written(log: Log, path: Path) -> Path:
    """Write a log as CSV; a frame is in the line of the first tick at or after its arrival."""
    names = ["time", *(f"command_{i}" for i in range(1, 7)), *(f"joint_{i}" for i in range(1, 7))]
    lines = [",".join([*names, *(f"{axis}_{p}" for p in range(1, 5) for axis in "xy"), "arrival"])]
    assert log.frames is not None
    frames = {}
    for number, arrival in enumerate(log.frames.arrival):
        frames[int(np.searchsorted(log.time, arrival - 1e-9))] = number
    for tick in range(len(log.time)):
        numbers = [log.time[tick], *log.commands[tick], *log.joints[tick]]
        cells = [f"{value:.9g}" for value in numbers]
        index = frames.get(tick)
        cells += [""] * 9 if index is None else [f"{v:.6g}" for v in log.frames.features[index]]
        cells += [] if index is None else [f"{log.frames.arrival[index]:.9g}"]
        lines.append(",".join(cells))
    path.write_text("# a machine\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_the_command_writes_a_scenario_that_runs_and_diagnose_goes_on(
    paper: hs.Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    try_delays(monkeypatch, 0, 1, 2)
    log = written(seen_log(paper, 0.1, stamps=None), tmp_path / "log.csv")
    found, identify = [], hs.identify

    def identified(*given: Any, **options: Any) -> hs.Identification:
        found.append(identify(*given, **options))
        return found[-1]

    monkeypatch.setattr(hs, "identify", identified)
    yaml, numbers = tmp_path / "machine.yaml", tmp_path / "machine.json"
    arguments = ["identify", str(log), "-m", "paper", "--out", str(yaml), "--json", str(numbers)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "A frame arrives 100 ms after it was taken" in " ".join(done.output.split())
    scenario = hs.load_scenario(yaml)
    assert scenario.actuators.kind == "position"
    assert scenario.camera.latency == pytest.approx(0.1)
    assert hs.simulate(scenario).outcome in {"completed", "diverged", "leg_limit", "behind_camera"}
    assert json.loads(numbers.read_text())["changes"]["actuators.delay"] == 0.01
    again = CliRunner().invoke(app, arguments)
    assert again.exit_code == 2
    assert "--force" in again.output
    monkeypatch.setattr(hs, "identify", lambda *_, **__: found[0])  # of the same log
    piped = CliRunner().invoke(app, ["identify", str(log), "-m", "paper", "--json", "-"])
    assert piped.stdout == numbers.read_text(encoding="utf-8")
    diagnosed = CliRunner().invoke(app, ["diagnose", str(log), "--machine", "paper"])
    assert diagnosed.exit_code in {0, 3}, diagnosed.output
    assert "iagnos" in diagnosed.output or "cause" in diagnosed.output
    assert "The log ends in motion" in " ".join(diagnosed.stdout.split())
