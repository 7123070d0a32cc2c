"""Diagnosis of a log: what the log shows of its goal, and the run of the identified model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.diagnosis import Diagnosis
from hexservo.findings.identification import CameraFit, Identification
from hexservo.findings.identification.drives import fit_drives
from hexservo.findings.identification.interval import Interval
from hexservo.findings.identification.log import Frames, Log
from hexservo.findings.identification.log_diagnosis import LogDiagnosis
from hexservo.findings.identification.log_end import LogEnd, end_of
from test_identification import METRES, SEED

RESTS = LogEnd(48.4, 0.0, swings=False, band=2.0, dwell=0.2, rests=True)


def log_to(scenario: hs.Scenario, off: float, *, swing: float = 0.0) -> Log:
    """A log whose image comes to `off` [px] from the goal within a second, and swings about that by `swing` [px]."""
    time = np.linspace(0.0, 3.98, 200, dtype=np.float64)
    goal = Scene(scenario).desired
    way = off + 90.0 * np.exp(-5.0 * time) + swing * np.sin(9.0 * time)
    noise = np.random.default_rng(SEED).normal(0.0, 0.1, (200, len(goal)))
    legs = np.full((200, 6), 0.2)
    return Log(time, 0.02, legs, legs, Frames(goal + way[:, None] + noise, time, None))


def end_at(machine: hs.Scenario, off: float, *, swing: float = 0.0) -> LogEnd:
    found = end_of(log_to(machine, off, swing=swing), Scene(machine))
    assert isinstance(found, LogEnd)
    return found


def test_the_end_of_a_log_is_compared_to_the_goal(paper: hs.Scenario) -> None:
    machine = paper.updated({"metrics.band": 2.0})
    assert end_at(machine, 0.0).settled
    away, swings = end_at(machine, 48.0), end_at(machine, 0.0, swing=48.0)
    assert (away.settled, away.rests) == (False, True)
    assert away.error == pytest.approx(48.0, abs=0.6)
    assert (swings.settled, swings.rests) == (False, False)
    log = log_to(machine, 0.0)
    assert log.frames is not None
    few = replace(log, frames=replace(log.frames, features=log.frames.features[:, :4]))
    for without in (few, replace(log, frames=None)):
        assert end_of(without, Scene(machine)) == "The log has no image of the goal's points"


def noisy_end(machine: hs.Scenario, noise: float, rate: float, random: np.random.Generator, off: float = 0.0) -> LogEnd:
    """The end of a log of a machine at rest `off` [px] from its goal, with outliers of 40 px in 5 % of the points."""
    time = np.arange(4.0, step=1 / rate)
    goal = Scene(machine).desired
    images = goal + off + random.normal(0.0, noise, (len(time), len(goal)))
    images += np.repeat(random.random((len(time), len(goal) // 2)) < 0.05, 2, axis=1) * random.normal(
        0.0, 40.0, images.shape
    )
    legs = np.full((len(time), 6), 0.2)
    found = end_of(Log(time, 1 / rate, legs, legs, Frames(images, time, None)), Scene(machine), noise)
    assert isinstance(found, LogEnd)
    return found


@pytest.mark.parametrize(("noise", "rate"), [(0.2, 30), (0.8, 100), (0.7, 1000), (1.2, 100)])
def test_noise_and_outliers_are_no_error_of_the_machine(paper: hs.Scenario, noise: float, rate: float) -> None:
    """Of 200 images many a coordinate is beyond the band of 2 px, and of those with outliers most."""
    random = np.random.default_rng(SEED)
    ends = [noisy_end(paper, noise, rate, random) for _ in range(10)]
    assert all(end.settled and end.rests for end in ends)
    off = [noisy_end(paper, noise, rate, random, off=4.0) for _ in range(10)]
    assert all(end.rests and not end.settled for end in off)


def test_an_oscillation_about_the_goal_does_not_settle(paper: hs.Scenario, passing: Diagnosis) -> None:
    """Its median in the dwell time is on the goal."""
    log = log_to(paper, 0.0)
    assert log.frames is not None
    swing = 8.0 * np.sin(2.0 * np.pi * 10.0 * log.time)[:, None]
    end = end_of(replace(log, frames=replace(log.frames, features=log.frames.features + swing)), Scene(paper))
    assert isinstance(end, LogEnd)
    assert end.error < end.band
    assert not end.settled
    assert "and swings by more than the band of 2 px" in diagnosed(passing, end=end).sections()[0].sentences[0]


@pytest.mark.parametrize("last", [0.05, 0.09, 0.14])
def test_a_machine_that_leaves_the_goal_at_the_end_does_not_settle(paper: hs.Scenario, last: float) -> None:
    """Less than half of the dwell time does not change the median of all of it."""
    time = np.arange(4.0, step=0.01)
    goal = Scene(paper).desired
    images = goal + np.random.default_rng(SEED).normal(0.0, 0.1, (len(time), len(goal)))
    legs = np.full((len(time), 6), 0.2)
    for away in (100.0 * (time > time[-1] - last), 10.0 * np.exp(8.0 * (time - time[-1]))):
        log = Log(time, 0.01, legs, legs, Frames(images + away[:, None], time, None))
        end = end_of(log, Scene(paper), 0.1)
        assert isinstance(end, LogEnd)
        assert (end.settled, end.rests) == (False, False)


def test_a_camera_that_stops_before_the_log_tells_nothing_of_its_end(paper: hs.Scenario, passing: Diagnosis) -> None:
    log = log_to(paper, 0.0)
    assert log.frames is not None
    seen = log.time < 3.0
    frames = Frames(log.frames.features[seen], log.frames.arrival[seen], None)
    end = end_of(replace(log, frames=frames), Scene(paper))
    assert end == "The log's last image of all of the goal's points is 1 s before its end"
    found = diagnosed(passing, end=end).sections()[0]
    assert (found.verdict, found.data["log"]) == ("open", None)
    assert found.sentences[0] == f"{end}: it does not tell whether the machine reaches its goal."


@pytest.fixture(scope="module")
def passing() -> Diagnosis:
    found = hs.diagnose(hs.simulate(hs.load_scenario("pi-h824-positions")))
    assert found.failed is False
    return found


def diagnosed(model: Diagnosis, **of_log: Any) -> LogDiagnosis:
    machine = model.result.scenario
    drives = fit_drives(log_to(machine, 0.0), METRES)  # of legs at rest
    return LogDiagnosis(Identification(machine, machine, {}, drives, **{"camera": None, **of_log}), model)


def test_a_log_that_rests_off_the_goal_of_a_model_that_passes_is_not_good(passing: Diagnosis) -> None:
    found = diagnosed(passing, end=RESTS).sections()[0]
    assert found.verdict == "warning"
    assert (
        "The log does not settle: it rests 48.4 px from the goal, in the median of its last images"
        in found.sentences[0]
    )
    assert "the machine has a fault that the model lacks" in found.sentences[0]
    assert found.sentences[-1].startswith("The identified model passes: it is settled")
    of_log = {"error": 48.4, "noise_error": 0.0, "swings": False, "band": 2.0, "dwell": 0.2, "rests": True}
    assert found.data["log"] == of_log | {"settled": False}


def test_a_log_that_settles_or_moves_or_has_no_image_says_so(passing: Diagnosis) -> None:
    settles = diagnosed(passing, end=replace(RESTS, error=1.0)).sections()[0]
    assert (settles.verdict, settles.sentences[0][:16]) == ("good", "The log settles:")
    moves = diagnosed(passing, end=replace(RESTS, rests=False)).sections()[0]
    assert moves.verdict == "open"
    assert "for identification, is not expected to settle" in moves.sentences[0]
    blind = diagnosed(passing, end="The log has no image of the goal's points").sections()[0]
    assert (blind.verdict, blind.data["log"]) == ("open", None)


def test_a_model_that_is_not_of_the_machine_leaves_the_diagnosis_open(passing: Diagnosis) -> None:
    wrong = CameraFit(100, latency=Interval(0.02, 0.019, 0.021), explained=0.1)
    found = diagnosed(passing, camera=wrong, end=replace(RESTS, error=1.0)).sections()[0]
    assert found.verdict == "open"
    assert any('see "Camera"' in sentence for sentence in found.sentences)
    assert found.data["failed"] is None
    (doubt,) = found.data["doubtful"]
    assert doubt["name"] == "camera"


def test_wrong_exposure_times_are_in_the_run_and_are_stated(passing: Diagnosis) -> None:
    late = Interval(0.02, 0.0199, 0.0201)
    camera = CameraFit(100, latency=late, stamps=late, explained=1.0)
    found = diagnosed(passing, camera=camera, faults={"uncertainty.latency": -0.02}, end=RESTS)
    assert found.identification.as_logged.uncertainty.latency == -0.02
    assert found.identification.scenario.uncertainty.latency == 0.0
    sentences = found.sections()[0].sentences
    assert any("frames were taken 20 ms before what they state" in sentence for sentence in sentences)
    assert any("has that error: uncertainty.latency=-0.02" in sentence for sentence in sentences)
    assert "Correct the exposure times" in found.identification.sections()[-1].sentences[-1]
