"""Frames that jitter and frames that are lost: the clock of a camera, its latency and its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

import hexservo as hs
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.evidence import Table
from hexservo.findings.identification.changes import changes_of, faults_of, of_law
from hexservo.findings.identification.drives import fit_drives
from hexservo.findings.identification.frame_clock import clock
from hexservo.findings.identification.frames import CameraFit, _repeats, fit_camera
from hexservo.findings.identification.interval import deviations, robust_deviations
from hexservo.findings.identification.log import Frames, Log
from test_identification import METRES, SEED, seen_log, within

Array = NDArray[np.float64]

PERIOD = 0.033


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


def test_a_camera_without_a_period_keeps_its_keys(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    found = CameraFit(100, latency=None, explained=1.0)
    section = found.section()
    assert section.verdict == "warning"
    assert any("do not tell their period" in sentence for sentence in section.sentences)
    assert not {"camera.period", "camera.dropout"} & set(
        changes_of(log, paper, fit_drives(log, METRES, delays=(1,)), found)
    )


def test_the_noise_is_what_the_law_tracking_assumes(paper: hs.Scenario) -> None:
    tracking = paper.updated({"controller.law": "tracking", "actuators.kind": "position", "simulation.mode": "sampled"})
    assert of_law(tracking, {"camera.noise": 1.1}) == {"controller.tracking.noise": 1.1}
    assert of_law(tracking, {"camera.noise": 0.0}) == of_law(tracking, {}) == {}
    assert of_law(paper, {"camera.noise": 1.1}) == {}


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
    changes = changes_of(log, paper, fit_drives(log, METRES, delays=(1,)), camera)
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


def test_exposure_times_that_are_wrong_are_a_fault_and_no_key(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=0.008)
    camera = fit_camera(log, Scene(paper))
    scenario = paper.updated({"simulation.mode": "sampled", "simulation.step": 0.01, "camera.latency": 0.05})
    assert faults_of(scenario, camera) == {"uncertainty.latency": -0.01}
    assert not any(
        key.startswith("uncertainty") for key in changes_of(log, paper, fit_drives(log, METRES, delays=(1,)), camera)
    )
    section = camera.section()
    assert section.verdict == "warning"
    assert any("before what they state" in words for words in section.sentences)
    right = fit_camera(seen_log(paper, 0.05, stamps=0.0), Scene(paper))
    assert faults_of(scenario, right) == faults_of(scenario, None) == {}
    assert right.section().verdict == "good"


def test_a_machine_of_unknown_latency_uses_no_exposure_times_that_may_be_wrong(paper: hs.Scenario) -> None:
    """Its scenario refuses `uncertainty.latency`."""
    machine = hs.load_scenario("pi-h824-positions", {"camera.latency_known": False})
    log = seen_log(paper, 0.05, stamps=0.02)
    camera = fit_camera(log, Scene(paper))
    assert faults_of(machine, camera) == {}
    assert faults_of(machine.updated({"camera.latency_known": True}), camera)


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
    assert "camera.noise" not in changes_of(log, paper, fit_drives(log, METRES, delays=(1,)), camera)
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


@pytest.mark.parametrize(("noise", "step"), [(0.0, 1e-6), (0.0, 0.1)])
def test_images_that_are_equal_at_a_long_rest_count(paper: hs.Scenario, noise: float, step: float) -> None:
    """They are rounded to `step` [px], 1e-6 as of a camera without noise, and the joints are noisy."""
    log = seen_log(paper, 0.05, stamps=None, noise=noise, rest=7500)
    assert log.frames is not None
    log = replace(log, frames=replace(log.frames, features=np.round(log.frames.features / step) * step))
    assert log.frames is not None
    assert (np.diff(log.frames.features, axis=0) == 0.0).all(axis=1).sum() > 100
    assert not _repeats(log, log.frames).any()


def test_frames_that_are_repeated_at_rest_too_do_not_count(paper: hs.Scenario) -> None:
    log = repeating(seen_log(paper, 0.05, stamps=None, rest=1500))
    assert log.frames is not None
    assert _repeats(log, log.frames).sum() == len(log.frames.arrival) // 2


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
@pytest.mark.parametrize("jitter", [0.004, 0.01])
def test_intervals_contain_latency_and_noise_of_frames_that_jitter(paper: hs.Scenario, jitter: float) -> None:
    scene, count = Scene(paper), 60
    fits = [fit_camera(seen_log(paper, 0.05, stamps=None, jitter=jitter, seed=seed), scene) for seed in range(count)]
    targets = np.array([np.abs(fit.target) < 1.96 * fit.target_deviations for fit in fits])
    hits = {
        "latency": sum(within(fit.latency, 0.05 + jitter / 2) for fit in fits),
        "noise": sum(within(fit.noise, 0.2) for fit in fits),
        **{f"target {number}": int(column.sum()) for number, column in enumerate(targets.T)},
    }
    print(f"jitter {jitter} s, {count} logs: {hits}")
    assert min(hits.values()) >= 0.85 * count, hits
