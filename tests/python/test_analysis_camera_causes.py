"""How fast must the camera be: hunting that is no failure, and what acts where a linear loop does not describe runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import camera_rate
from hexservo.findings.analysis.camera_rate import CameraRate
from hexservo.findings.analysis.camera_runs import _hunts
from hexservo.findings.analysis.loop_of_scenario import at_rest_at_home, loop_at_rest

STRONG = {"controller.composite.kv": [2e-2] * 3 + [1e-3] * 3}  # ten times the default


def analysed(name: str, changes: dict[str, Any]) -> tuple[CameraRate, str]:
    found = camera_rate.analyse(hs.load_scenario(name).updated(changes))
    return found, " ".join(found.section().sentences)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("real-machine", STRONG),
        ("real-machine", {"actuators.delay": 0.005}),
        ("composite-30hz", {"actuators.delay": 0.005}),
        ("composite-30hz", {"actuators.delay": 0.005, "controller.switching.kind": "sign"}),
    ],
)
def test_hunting_by_kv_far_within_the_band_is_no_failure(name: str, changes: dict[str, Any]) -> None:
    """K_v hunts through the actuators by 0.4 to 1 % of the band, with any camera, and without K_v it does not."""
    found, words = analysed(name, changes)
    assert found.acting is not None
    assert found.acting.stable
    assert found.starts[0].ending == "hunts"
    assert found.starts[0].late < 0.05
    assert found.settles is True
    assert found.section().verdict != "bad"
    assert "and does not grow: it is no failure" in words
    assert "So the cause is K_v, not the camera." in words
    assert "initial weights of the fuzzy systems, is" not in words
    scenario = found.scenario
    if name == "real-machine":  # a delay of 5 ms is too much for the large error of the other task, with any camera
        assert np.isfinite(hs.metrics(hs.simulate(scenario))["settling_time"])
    home = at_rest_at_home(loop_at_rest(scenario)).updated({"simulation.duration": 40.0})
    goal = np.asarray(home.target.desired_features) + 0.01
    for changed, rests in (({}, False), ({"controller.composite.kv": 0.0}, True)):
        run = hs.simulate(home.updated({"target.desired_features": goal.tolist(), **changed}))
        moved = np.ptp(run.feature_error[run.time > 36.0], axis=0).max()
        assert (moved < 5e-4) == rests, changed


def test_a_motion_that_grows_slowly_is_no_hunting() -> None:
    time = np.linspace(0.0, 40.0, 4001)
    wave = 0.01 * np.abs(np.cos(6.0 * time))
    assert _hunts(wave, 2.0)
    assert not _hunts(wave * np.exp(0.03 * time), 2.0)
    assert not _hunts(11.0 * wave, 2.0)  # 0.11 px of a band of 2 px
    assert _hunts(11.0 * wave, 4.0)


def test_what_the_fuzzy_systems_learn_is_named_where_it_acts() -> None:
    """Without K_v the linear loop grows at 5 1/s at empty weights; runs settle with what is learned, not without."""
    changes = {"camera.prediction": "none", "camera.latency": 0.01, "controller.composite.kv": 0.0}
    found, words = analysed("composite-30hz", changes)
    assert [repeat.without for repeat in found.repeats] == ["fuzzy"]
    assert "So what the fuzzy systems learn brings them to rest." in words
    assert "taken at the initial weights of the fuzzy systems, is unstable" in words


def test_the_camera_is_not_named_where_a_perfect_one_does_not_end_the_motion() -> None:
    """A machine is beyond its speed limit with any camera."""
    slow, words = analysed("pi-h824", {"robot.speed_limit": 1e-4})
    assert slow.settles is False
    assert "So none of these is the cause." in words
    assert "taken at rest, is stable" in words


def test_a_limit_of_the_legs_that_a_perfect_camera_exceeds_too_is_not_the_cameras() -> None:
    """A stroke of 3 mm: single runs of the task take a leg beyond it with the scenario's camera and a perfect one."""
    found, words = analysed("composite-30hz", {"robot.stroke": 0.003})
    uses = {key: (border.own, border.perfect) for key, border in found.limits.items()}
    perfect = {"camera.period": 0.001, "camera.latency": 0.0}
    task = loop_at_rest(found.scenario).task
    for own, best in uses.values():
        assert best is not None
        for changes, use in (({}, own), (perfect, best)):
            assert hs.metrics(hs.simulate(task.updated(changes)))["peak_leg_excursion"] == pytest.approx(use.peak)
            assert use.share > 1.0
    assert "With the scenario's own camera the task takes a leg 3.98 mm" in words
    assert "with a frame at every tick and no latency it takes a leg 4.05 mm" in words
    assert "beyond its stroke of 3 mm: the camera is not the cause" in words
    assert words.count("With the scenario's own") == 1
