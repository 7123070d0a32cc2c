"""Cameras that are faster than the lines of a log, each of which has the newest frame: the others are not lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.changes import changes_of
from hexservo.findings.identification.frames import fit_camera
from hexservo.findings.identification.frames_overwritten import clock_of_overwritten
from hexservo.findings.identification.log import Frames
from test_identification import SEED, seen_log, within
from test_identified_camera import drives_of_seen_log, least_of

Array = NDArray[np.float64]

TICK = 0.02


def in_lines(
    random: np.random.Generator,
    rate: float,
    *,
    jitter: float = 0.0,
    lost: float = 0.0,
    stamped: bool = False,
    tick: float = TICK,
    seconds: float = 30.0,
) -> tuple[Frames, Array, int]:
    """Frames at a rate [Hz] of which each line of a log has the newest, times of the lines, and how many none has."""
    exposure = np.arange(random.uniform(0.1, 0.2), seconds, 1.0 / rate)
    exposure = exposure[random.random(len(exposure)) >= lost]
    arrival = np.maximum.accumulate(exposure + 0.045 + jitter * random.random(len(exposure)))
    ticks = tick * np.arange(round((seconds + 1.0) / tick), dtype=float)
    lines = np.searchsorted(ticks, arrival)
    newest = np.append(lines[1:] != lines[:-1], True)
    images = random.normal(0.0, 1.0, (len(exposure), 8))
    rounded = [np.asarray(np.round(times, 6), dtype=float) for times in (arrival, exposure)]
    frames = Frames(images, rounded[0], rounded[1] if stamped else None).only(newest)
    return frames, ticks, int((~newest).sum())


@pytest.mark.parametrize("rate", [52.0, 55.0, 60.0, 75.0, 90.0, 120.0])
@pytest.mark.parametrize(("jitter", "stamped"), [(0.0, False), (0.002, False), (0.002, True)])
def test_frames_that_others_replace_are_no_dropout(rate: float, jitter: float, stamped: bool) -> None:
    """Of 60 Hz at 50 lines a second every sixth one: the others passed for frames each 20 ms."""
    frames, ticks, replaced = in_lines(np.random.default_rng(SEED), rate, jitter=jitter, stamped=stamped)
    found = clock_of_overwritten(frames, ticks)
    assert found is not None
    assert found.period.value == pytest.approx(1.0 / rate, rel=1e-4)
    assert found.dropout.value == 0.0
    assert found.overwritten == pytest.approx(replaced, abs=1)  # the first and the last of all may be one


@pytest.mark.parametrize("rate", [55.0, 60.0, 75.0])
def test_dropout_is_that_of_frames_that_no_other_replaces(rate: float) -> None:
    random, hits, count = np.random.default_rng(SEED), 0, 20
    for _ in range(count):
        frames, ticks, replaced = in_lines(random, rate, jitter=0.002, lost=0.1)
        found = clock_of_overwritten(frames, ticks)
        assert found is not None
        hits += within(found.dropout, 0.1)
        assert found.overwritten == pytest.approx(replaced, rel=0.2)
    assert hits >= least_of(count)


@pytest.mark.parametrize("jitter", [0.0, 0.004, 0.008])
def test_frames_of_slower_cameras_or_asked_for_at_ticks_have_no_shorter_period(jitter: float) -> None:
    random = np.random.default_rng(SEED)
    for rate in (10.0, 24.0, 30.0, 50.0):
        frames, ticks, _ = in_lines(random, rate, jitter=jitter)
        found = clock_of_overwritten(frames, ticks)
        assert found is not None
        assert found.period.value == pytest.approx(1.0 / rate, rel=1e-3)
        assert found.overwritten == 0
    frames, ticks, _ = in_lines(random, 60.0)
    asked = ticks[np.searchsorted(ticks, frames.arrival)] + random.uniform(0.0, 1e-3, len(frames.arrival))
    found = clock_of_overwritten(
        replace(frames, arrival=asked), ticks
    )  # of times that the program took, a little after the tick
    assert found is not None
    assert found.period.value == pytest.approx(TICK, rel=1e-4)
    assert found.overwritten == 0


def test_a_log_that_has_all_frames_has_none_that_others_replace() -> None:
    """As of MCAP, in which frames are no cells of a line: those that are missing are lost."""
    random = np.random.default_rng(SEED)
    arrival = 0.1 + np.arange(1500) / 60.0
    arrival = arrival[random.random(1500) >= 0.1]
    found = clock_of_overwritten(Frames(np.zeros((len(arrival), 2)), arrival, None), TICK * np.arange(1300.0))
    assert found is not None
    assert within(found.dropout, 0.1)
    assert found.overwritten == 0


def test_the_findings_have_the_true_period_and_the_scenario_one_frame_a_tick(paper: hs.Scenario) -> None:
    log = seen_log(paper, 0.05, stamps=None, moving=False)
    frames, _, replaced = in_lines(np.random.default_rng(SEED), 120.0, tick=log.period, seconds=4.0)
    camera = fit_camera(replace(log, frames=frames), Scene(paper))
    assert camera.overwritten == pytest.approx(replaced, abs=1)
    assert camera.period is not None
    assert camera.period.value == pytest.approx(1.0 / 120.0, rel=1e-4)
    start = f"The camera takes a frame every 8.33 ms, more often than the log has lines: {camera.overwritten} frames"
    assert any(sentence.startswith(start) for sentence in camera.section().sentences)
    changes = changes_of(log, paper, drives_of_seen_log(), replace(camera, explained=1.0))
    assert (changes["camera.period"], changes["camera.dropout"]) == (log.step, 0.0)
