"""Wrong detections and rounded pixels of a log: they are no noise of the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.changes import changes_of, in_whole_ticks, of_law
from hexservo.findings.identification.frames import fit_camera
from hexservo.findings.identification.frames_outliers import NoOutliers, Outliers, outliers_of
from hexservo.findings.identification.log import Log
from hexservo.findings.identification.rounding import grid_of
from test_identification import SEED, seen_log, within
from test_identified_camera import drives_of_seen_log, least_of

Array = NDArray[np.float64]


def changed(log: Log, features: Array) -> Log:
    """The log with other images."""
    assert log.frames is not None
    return replace(log, frames=replace(log.frames, features=features))


def with_outliers(log: Log, probability: float, size: float, random: np.random.Generator) -> Log:
    """The log with points of which some are wrong detections, each by itself."""
    assert log.frames is not None
    points = log.frames.features.reshape(len(log.frames.features), -1, 2)
    wrong = random.random(points.shape[:2]) < probability
    points = points + wrong[..., None] * random.normal(0.0, size, points.shape)
    return changed(log, points.reshape(len(points), -1))


@pytest.mark.parametrize(("jitter", "probability", "size"), [(0.0, 0.01, 20.0), (0.01, 0.05, 40.0)])
def test_wrong_detections_are_no_noise(paper: hs.Scenario, jitter: float, probability: float, size: float) -> None:
    log = seen_log(paper, 0.05, stamps=None, jitter=jitter)
    camera = fit_camera(with_outliers(log, probability, size, np.random.default_rng(SEED)), Scene(paper))
    assert isinstance(camera.outliers, Outliers)
    assert camera.outliers.searched == 135
    assert camera.noise is not None
    assert camera.noise.value == pytest.approx(0.2, rel=4 / np.sqrt(2 * 0.7 * 100 * 7))  # four standard deviations
    assert within(camera.outliers.probability, probability)
    assert within(camera.outliers.size, size)
    changes = changes_of(log, paper, drives_of_seen_log(), camera)
    assert changes["camera.outlier_probability"] == pytest.approx(camera.outliers.probability.value, rel=1e-5)
    assert changes["camera.outlier_size"] == pytest.approx(camera.outliers.size.value, rel=1e-5)
    section = camera.section()
    assert section.verdict == "good"
    assert section.sentences[0].startswith(f"{camera.outliers.frames} of 135 frames have a point")
    assert "camera.gate" in section.sentences[0]


def test_wrong_detections_of_one_frame_or_that_stay_are_no_keys(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    assert log.frames is not None
    for frames, reason in (([40], "one does not determine"), (list(range(40, 48)), "stay for several frames")):
        features = log.frames.features.copy()
        features[frames, 2:4] += [15.0, -9.0]
        camera = fit_camera(changed(log, features), Scene(paper))
        assert camera.noise is not None
        assert camera.noise.value == pytest.approx(0.2, rel=4 / np.sqrt(2 * 0.7 * 127 * 7))
        assert isinstance(camera.outliers, Outliers)
        assert camera.outliers.frames == len(frames)
        changes = changes_of(log, paper, drives_of_seen_log(), camera)
        assert not any(key.startswith("camera.outlier") for key in changes)
        section = camera.section()
        assert section.verdict == "warning"
        assert any(reason in sentence for sentence in section.sentences)


@pytest.mark.parametrize("points", [3, 4, 9])
def test_gaussian_noise_of_late_frames_has_no_wrong_detections(points: int) -> None:
    """Of 100 logs, half of whose frames move; 6 would come once in 1e3 where 2 % of the logs have one."""
    random, found = np.random.default_rng(SEED), 0
    for _ in range(100):
        moves = random.random((346, 1)) < 0.5
        speed = random.normal(size=(346, 2 * points)) * np.where(moves, 100.0, 1e-3)
        left = 0.1 * random.normal(size=speed.shape) + speed * random.uniform(-0.02, 0.02, (346, 1))
        found += isinstance(outliers_of(left, speed), tuple)
    assert found <= 6


def test_a_log_without_wrong_detections_excludes_those_that_would_be_seen(paper: hs.Scenario) -> None:
    """Of 540 points: 5 % that are 20 px off, and neither 0.1 %, of which one in two such logs has none, nor 0.3 px."""
    log = seen_log(paper, 0.05, stamps=None)
    camera = fit_camera(log, Scene(paper))
    assert isinstance(camera.outliers, NoOutliers)
    assert camera.outliers.points == 540
    for probability, size, excluded in (
        (0.05, 20.0, True),
        (0.001, 20.0, False),
        (0.05, 0.3, False),
        (0.0, 0.0, False),
    ):
        keys = {"camera.outlier_probability": probability, "camera.outlier_size": size}
        machine = paper.updated({"simulation.mode": "sampled", **keys})
        changes = changes_of(log, machine, drives_of_seen_log(), camera)
        assert changes.get("camera.outlier_probability") == (0.0 if excluded else None)
        identified = machine.updated(changes | in_whole_ticks(machine, changes)).camera
        assert identified.outlier_probability == (0.0 if excluded else probability)


def test_the_chance_to_see_no_wrong_detection_is_that_of_drawn_ones() -> None:
    """Errors of 1 px under a noise of 0.2 px, of 300 points: the given share is that which 5 % of the logs lack."""
    random, none, count = np.random.default_rng(SEED), 0, 400
    clean = outliers_of(0.2 * random.normal(size=(75, 8)), np.zeros((75, 8)))
    assert isinstance(clean, NoOutliers)
    shares = np.geomspace(1e-4, 0.5, 2000)
    share = float(shares[[clean.exclude(float(one), 1.0) for one in shares].index(True)])
    for _ in range(count):
        left = 0.2 * random.normal(size=(75, 4, 2))
        left += (random.random((75, 4)) < share)[..., None] * random.normal(0.0, 1.0, left.shape)
        none += isinstance(outliers_of(left.reshape(75, 8), np.zeros((75, 8))), NoOutliers)
    print(f"seed {SEED}, share {share:.4f}: {none} of {count} logs show none")
    assert 5 <= none <= 38  # 5 % of 400, and four standard deviations


def test_how_often_and_how_far_counts_those_that_noise_hides() -> None:
    """Errors of 0.5 px under a noise of 0.2 px, of which a half are nearer than noise may be."""
    random, hits = np.random.default_rng(SEED), np.zeros(2)
    for _ in range(50):
        left = 0.2 * random.normal(size=(1500, 9, 2))
        left += (random.random((1500, 9)) < 0.02)[..., None] * random.normal(0.0, 1.0, left.shape)
        found = outliers_of(left.reshape(1500, 18), np.zeros((1500, 18)))
        assert isinstance(found, tuple)
        hits += [within(found[1].probability, 0.02), within(found[1].size, 1.0)]
    assert (hits >= 40).all(), hits


def test_wrong_detections_that_are_mostly_hidden_are_known_less_well() -> None:
    """Errors of 2.5 px under a noise of 1 px, of which one in 20 is found: how many there are follows from their size.

    With both, found ones are 2.69 px; by their count alone 22 of 40 intervals contain how often they come.
    """
    random, hits, sizes = np.random.default_rng(SEED), 0, []
    for _ in range(40):
        left = random.normal(size=(1500, 9, 2))
        left += (random.random((1500, 9)) < 0.04)[..., None] * random.normal(0.0, 2.5, left.shape)
        found = outliers_of(left.reshape(1500, 18), np.zeros((1500, 18)))
        assert isinstance(found, tuple)
        hits += within(found[1].probability, 0.04)
        sizes.append(found[1].size.value)
    assert hits >= least_of(40)
    assert np.mean(sizes) == pytest.approx(2.5, abs=3 * 2.69 / np.sqrt(4 * 40 * 34))  # of 34 in a log


def test_the_grid_of_rounded_numbers_is_found_and_no_other() -> None:
    random = np.random.default_rng(SEED)
    x, y = random.normal(300.0, 20.0, (2, 500))
    assert grid_of(x, y) == 0.0
    for step in (1.0, 0.25, 0.1):
        rounded = np.round(x / step) * step - 12.34, np.round(y / step) * step + 5.6
        assert grid_of(*rounded) == pytest.approx(step, rel=1e-9)
        assert grid_of(rounded[0], y) == 0.0
    assert grid_of(np.array([1.0, 2.0, 5.0])) == 0.0


def test_rounding_is_no_noise_and_is_counted_once(paper: hs.Scenario) -> None:
    machine = hs.load_scenario("pi-h824-positions", {"camera.quantisation": 0.5})
    for seed in (1, 2, 3):
        log = seen_log(paper, 0.05, stamps=None, seed=seed)
        assert log.frames is not None
        camera = fit_camera(changed(log, np.round(log.frames.features)), Scene(paper))
        assert camera.rounding == 1.0
        assert camera.noise is not None
        assert within(camera.noise, 0.2)
        assert any("rounded to 1 px" in sentence for sentence in camera.section().sentences)
        changes = changes_of(log, machine, drives_of_seen_log(), camera)
        assert changes["camera.quantisation"] == 1.0
        assert of_law(machine, changes)["controller.tracking.noise"] == pytest.approx(
            np.hypot(camera.noise.value, 1 / np.sqrt(12.0)), rel=1e-5
        )
    exact = fit_camera(seen_log(paper, 0.05, stamps=None), Scene(paper))
    assert changes_of(log, machine, drives_of_seen_log(), exact)["camera.quantisation"] == 0.0
    assert "camera.quantisation" not in changes_of(log, paper, drives_of_seen_log(), exact)


def test_rounding_that_lasts_is_named_as_rounding(paper: hs.Scenario) -> None:
    """An image at rest is off by the same in all frames: correlated, as what a wrong calibration leaves."""
    log = seen_log(paper, 0.05, stamps=None, noise=0.02, rest=500)
    assert log.frames is not None
    camera = fit_camera(changed(log, np.round(log.frames.features)), Scene(paper))
    assert not camera.noise_is_white
    words = " ".join(camera.section().sentences)
    assert "rounding of the pixels to 1 px explains" in words
    assert "focal length" not in words
    changes = changes_of(log, paper, drives_of_seen_log(), camera)
    assert changes["camera.quantisation"] == 1.0
    assert "camera.noise" not in changes
