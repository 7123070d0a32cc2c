"""Logs whose frames lack single points: they arrived, and the points that were seen count."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.changes import changes_of
from hexservo.findings.identification.frames import fit_camera
from hexservo.findings.identification.frames_outliers import Outliers, outliers_of
from hexservo.findings.identification.frames_repeated import repeats
from hexservo.findings.identification.log import Frames, Log
from test_bad_logs import HEAD
from test_identification import SEED, seen_log, within
from test_identified_camera import drives_of_seen_log, least_of, repeating

Array = NDArray[np.float64]


def without_points(log: Log, share: float, seed: int = SEED) -> Log:
    """The log without a share of its points, each lost by itself."""
    assert log.frames is not None
    features = log.frames.features.copy()
    lost = np.random.default_rng(seed).random((len(features), features.shape[1] // 2)) < share
    features[np.repeat(lost, 2, axis=1)] = np.nan
    return replace(log, frames=replace(log.frames, features=features))


@pytest.mark.parametrize(("share", "stamps"), [(0.2, None), (0.6, 0.0)])
def test_lost_points_are_no_lost_frames(paper: hs.Scenario, share: float, stamps: float | None) -> None:
    """Of 135 frames with four points, in 2.6 % of which all points are seen if 60 % are lost."""
    log = without_points(seen_log(paper, 0.05, stamps=stamps), share)
    assert log.frames is not None
    camera = fit_camera(log, Scene(paper))
    lost = ~np.isfinite(log.frames.features)
    assert camera.frames == 135
    assert camera.incomplete == lost.any(axis=1).sum() > 0.5 * 135
    assert camera.lost_points == pytest.approx(lost.mean())
    assert camera.dropout is not None
    assert camera.dropout.value == 0.0
    assert within(camera.period, 1 / 30) or camera.period.value == pytest.approx(1 / 30, rel=1e-9)  # type: ignore[union-attr]
    assert within(camera.latency, 0.05)
    assert within(camera.noise, 0.2)
    assert camera.noise is not None
    assert camera.noise.high - camera.noise.low < 0.1
    changes = changes_of(log, paper, drives_of_seen_log(), camera)
    assert changes["camera.dropout"] == 0.0
    assert {"camera.noise", "camera.latency"} <= set(changes)
    section = camera.section()
    assert section.verdict == "warning"
    words = f"{camera.incomplete} of 135 frames that arrived lack points, together {100 * lost.mean():.3g} % of all"
    assert any(sentence.startswith(words) for sentence in section.sentences)


def test_a_point_that_is_never_seen_does_not_count(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    assert log.frames is not None
    features = log.frames.features.copy()
    features[:, 2] = np.nan  # of the second point, of which no coordinate counts then
    camera = fit_camera(replace(log, frames=replace(log.frames, features=features)), Scene(paper))
    assert camera.lost_points == 0.25
    assert within(camera.latency, 0.05)
    assert within(camera.noise, 0.2)


def test_frames_without_any_point_arrive_and_give_no_camera(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None)
    assert log.frames is not None
    features = log.frames.features.copy()
    features[10:] = np.nan
    camera = fit_camera(replace(log, frames=replace(log.frames, features=features)), Scene(paper))
    assert camera.open == "expected at least 20 frames with a point of the target, got 10 of 135"
    assert camera.dropout is not None
    assert camera.dropout.value == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_intervals_contain_latency_and_noise_whatever_is_lost(paper: hs.Scenario, share: float) -> None:
    scene, count = Scene(paper), 60
    logs = [without_points(seen_log(paper, 0.05, stamps=None, seed=seed), share, seed) for seed in range(count)]
    fits = [fit_camera(log, scene) for log in logs]
    targets = np.array([np.abs(fit.target) < 1.96 * fit.target_deviations for fit in fits])
    hits = {
        "latency": sum(within(fit.latency, 0.05) for fit in fits),
        "noise": sum(within(fit.noise, 0.2) for fit in fits),
    }
    print(f"{share:.0%} of the points lost, {count} logs: {hits}, of the target's six numbers {targets.sum(axis=0)}")
    assert min(hits.values()) >= 0.85 * count, hits


def test_wrong_detections_are_found_among_three_points_or_more() -> None:
    """Frames of which no three points are seen do not count where there are wrong detections in others."""
    random = np.random.default_rng(SEED)
    left, seen = 0.2 * random.normal(size=(400, 5, 2)), random.random((400, 5)) > 0.3
    wrong = (random.random((400, 5)) < 0.02) & seen
    speed = np.where(seen[:, :, None], np.repeat(random.normal(0.0, 30.0, (400, 1, 2)), 5, axis=1), 0.0)
    late = random.uniform(-0.02, 0.02, 400)[:, None, None] * speed
    clean = np.where(seen[:, :, None], left + late, 0.0).reshape(400, 10)
    assert not isinstance(outliers_of(clean, speed.reshape(400, 10), seen), tuple)
    far = clean.reshape(400, 5, 2) + wrong[:, :, None] * random.normal(0.0, 20.0, (400, 5, 2))
    found = outliers_of(far.reshape(400, 10), speed.reshape(400, 10), seen)
    assert isinstance(found, tuple)
    frames, outliers = found
    few = seen.sum(axis=1) < 3
    assert isinstance(outliers, Outliers)
    assert outliers.searched == 400 - few.sum()
    assert frames[few].all()
    assert within(outliers.probability, 0.02)
    assert within(outliers.size, 20.0)
    assert not frames[~few & ~wrong.any(axis=1)].any()
    assert frames[~few & wrong.any(axis=1)].mean() > 0.9


def test_repeated_frames_lack_the_same_points(paper: hs.Scenario) -> None:
    log = repeating(without_points(seen_log(paper, 0.05, stamps=None), 0.3))
    assert log.frames is not None
    shown = np.asarray(np.isfinite(log.frames.features).any(axis=1))
    expected = np.arange(shown.size) % 2 == 1
    np.testing.assert_array_equal(repeats(log, log.frames), expected & shown)
    other = log.frames.features.copy()
    other[1::2, :2] = np.where(np.isnan(other[1::2, :2]), 0.0, np.nan)  # the first point is lost in one of the two
    assert not repeats(log, replace(log.frames, features=other)).any()


def csv_of(tmp_path: Path, cells: list[str]) -> Frames | None:
    """The frames of a log whose lines end with these cells."""
    lines = [f"{0.01 * tick:.9g}{',0.2' * 12},{cell}" for tick, cell in enumerate(cells)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([f"{HEAD},x_1,y_1,x_2,y_2,arrival", *lines]))
    return hs.read_log(path).frames


def test_empty_cells_of_a_frame_are_lost_points(tmp_path: Path) -> None:
    cells = [",,,,"] * 60
    cells[10], cells[20], cells[30] = "1,2,3,4,0.095", "1,2,,,0.195", "1,2,3,,0.295"  # the last without one coordinate
    cells[40] = ",,,,0.395"  # a frame of which no point was found
    cells[41] = ",,,,0.395"  # not a new one
    cells[50] = ",,,,0.5"  # as of a program that takes frames at its ticks
    frames = csv_of(tmp_path, cells)
    assert frames is not None
    np.testing.assert_allclose(frames.arrival, [0.095, 0.195, 0.295, 0.395, 0.5])
    seen = [[True, True], [True, False], [True, False], [False, False], [False, False]]
    np.testing.assert_array_equal(frames.seen, seen)
    np.testing.assert_array_equal(frames.features[2], [1.0, 2.0, np.nan, np.nan])
    assert csv_of(tmp_path, [",,,,0.005"] * 60) is None
    cells = [f",,,,{0.01 * tick:.9g}" for tick in range(60)]  # of a program that writes its time in each line
    cells[10], cells[20] = f"1,2,3,4{cells[10][3:]}", f"1,2,,{cells[20][3:]}"
    frames = csv_of(tmp_path, cells)
    assert frames is not None
    np.testing.assert_allclose(frames.arrival, [0.1, 0.2])


def test_infinite_pixels_are_refused(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None, moving=False)
    assert log.frames is not None
    with pytest.raises(ValueError, match="finite numbers, NaN of lost points"):
        replace(log, frames=replace(log.frames, features=log.frames.features * np.inf))


def test_dropout_beside_lost_points_is_that_of_frames(paper: hs.Scenario) -> None:
    """A fifth of the frames, and a fifth of the points of the others, of 20 logs."""
    scene, hits, count = Scene(paper), 0, 20
    for seed in range(count):
        log = without_points(seen_log(paper, 0.05, stamps=None, moving=False), 0.2, seed)
        assert log.frames is not None
        kept = np.random.default_rng(100 + seed).random(len(log.frames.arrival)) > 0.2
        camera = fit_camera(replace(log, frames=log.frames.only(kept)), scene)
        hits += within(camera.dropout, 0.2)
    assert hits >= least_of(count)
