"""Moving targets that the law `tracking` follows behind: what `check` states, and what it advises, against runs."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_tracking import of_tracking

CERTAINTY, BANDWIDTH, NOISE = (f"controller.tracking.{key}" for key in ("certainty", "bandwidth", "noise"))
SPEED = "actuators.position.speed_limit"
OTHER = 1000  # what is added to the seed of runs that follow an advice

HEXAPOD: tuple[str, dict[str, Any]] = ("pi-h824-positions", {})
HEAD: tuple[str, dict[str, Any]] = (
    "reachy-mini",
    {"controller.law": "tracking", "controller.tracking.follow": "direction", "camera.prediction": "none"},
)


def moving(
    base: tuple[str, dict[str, Any]], motion: dict[str, Any], changes: dict[str, Any] | None = None
) -> hs.Scenario:
    name, own = base
    return hs.load_scenario(name).updated(
        {**own, "simulation.duration": 14.0, "target.motion": motion, **(changes or {})}
    )


def along(amplitude: float, frequency: float, axis: int = 0) -> dict[str, Any]:
    """Return a sinusoid along an axis of B [m; Hz]."""
    return {"kind": "sinusoid", "amplitude": (amplitude * np.eye(3)[axis]).tolist(), "frequency": frequency}


def as_recorded(motion: dict[str, Any], duration: float = 14.0) -> dict[str, Any]:
    """Return a sinusoid as a recording with 100 samples a second."""
    time = 0.01 * np.arange(round(duration / 0.01) + 1)
    samples = np.outer(np.sin(2.0 * np.pi * motion["frequency"] * time), motion["amplitude"])
    return {"kind": "recorded", "samples": samples.tolist(), "sample_period": 0.01}


def error_of(scenario: hs.Scenario) -> float:
    """Return the largest error of the second half of a run [px], of a direction of the middle: the median of three."""
    found = []
    for seed in range(OTHER, OTHER + 3):
        run = hs.simulate(scenario.updated({"seed": seed}))
        assert run.outcome == "completed"
        error = run.feature_error[run.time > scenario.simulation.duration / 2.0]
        if scenario.controller.gains.follow == "direction":
            error = error.reshape(len(error), -1, 2).mean(axis=1)
        found.append(float(np.abs(error).max()))
    return float(np.median(found))


def sentences(scenario: hs.Scenario) -> list[str]:
    return list(of_tracking(scene_of(scenario)))


def stated(sentence: str) -> float:
    """Return the error that a sentence states for the scenario as it is [px]."""
    found = re.search(r"have errors of up to about ([\d.]+) px", sentence)
    assert found, sentence
    return float(found[1])


def advised(scenario: hs.Scenario, sentence: str) -> list[tuple[hs.Scenario, float]]:
    """Return the scenarios that follow each advice of a sentence, and what it states that they leave [px]."""
    found: list[tuple[dict[str, Any], str]] = []
    for settings, left in re.findall(r"set (controller[^;]*?): about ([\d.]+) px are left", sentence):
        found.append(({key: float(to) for key, to in re.findall(r"(controller\.[\w.]+) to ([\d.]+)", settings)}, left))
    for frequency, left in re.findall(r"a motion at ([\d.]+) Hz leaves about ([\d.]+) px", sentence):
        found.append(({"target.motion.frequency": float(frequency)}, left))
    for share, left in re.findall(r"([\d.]+) times that velocity leaves about ([\d.]+) px", sentence):
        velocity = [float(share) * component for component in scenario.target.motion.velocity]
        found.append(({"target.motion.velocity": velocity}, left))
    for what, changes in (
        ("limits of the legs", {SPEED: None}),
        (r"camera.latency \([^)]*\)", {"camera.latency": 0.0}),
    ):
        found += [(changes, left) for left in re.findall(rf"without {what} about ([\d.]+) px are left", sentence)]
    return [(scenario.updated(changes), float(left)) for changes, left in found]


def follow_all(scenario: hs.Scenario, sentence: str) -> int:
    """Follow each advice of a sentence, and return how many: runs leave less than now, and hardly more than it states.

    What is stated is the largest of some runs, of which others may leave half.
    """
    now = error_of(scenario)
    print(f"{sentence}\n  runs {now:.2f} px")
    assert stated(sentence) == pytest.approx(now, rel=0.35)
    followed = advised(scenario, sentence)
    for changed, left in followed:
        run = error_of(changed)
        print(f"  advice followed: {run:.2f} px, stated {left:g} px")
        assert 0.5 * left - 0.15 < run < 1.2 * left + 0.15
        assert run < 0.9 * now
    return len(followed)


@pytest.mark.parametrize(("base", "largest"), [(HEXAPOD, 0.012), (HEAD, 0.06)], ids=["pose", "direction"])
def test_every_advice_leaves_what_is_stated(base: tuple[str, dict[str, Any]], largest: float) -> None:
    """Twelve drawn sinusoids, half of them recorded; where no sentence is given runs are within the band or nearly."""
    rng = np.random.default_rng(7)
    print("seed 7")
    named = followed = 0
    for index in range(12):
        amplitude, frequency = largest * 10.0 ** rng.uniform(-1.0, 0.0), 10.0 ** rng.uniform(-0.7, 0.5)
        motion = along(float(amplitude), float(frequency), axis=int(rng.integers(2)))
        scenario = moving(base, as_recorded(motion) if index % 2 else motion)
        found = sentences(scenario)
        assert len(found) <= 1
        if not found:
            run = error_of(scenario)
            print(f"{amplitude:.4f} m, {frequency:.2f} Hz: not named, {run:.2f} px")
            assert run < 1.2 * scenario.metrics.band
            continue
        named += 1
        followed += follow_all(scenario, found[0])
    print(f"{named} of 12 named, {followed} pieces of advice")
    assert named >= 6
    assert followed >= 6


def test_a_direction_is_named_as_a_pose_is() -> None:
    """It follows the mean of earlier frames, or leaves more than a platform that stands still."""
    for frequency in (0.3, 1.0, 2.0):
        scenario = moving(HEAD, along(0.05, frequency, axis=1))
        (sentence,) = sentences(scenario)
        still = re.search(r"a platform that stands still ([\d.]+) px", sentence)
        assert still
        assert float(still[1]) == pytest.approx(7.7, rel=0.05)  # 0.05 m seen from where the head stands still
        assert (stated(sentence) > float(still[1])) == (frequency >= 1.0)
        follow_all(scenario, sentence)


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.01, 1.0), (0.003, 2.0), (0.005, 0.5)])
def test_a_recording_is_named_as_the_same_sinusoid(amplitude: float, frequency: float) -> None:
    motion = along(amplitude, frequency)
    (one,), (other,) = (sentences(moving(HEXAPOD, either)) for either in (motion, as_recorded(motion)))
    print(one, other, sep="\n")
    assert one.split(":")[0] == other.split(":")[0]
    assert stated(other) == pytest.approx(stated(one), rel=0.05)
    settings = [re.findall(r"controller\.[\w.]+ to [\d.]+", sentence) for sentence in (one, other)]
    assert settings[0] == settings[1]


@pytest.mark.parametrize(("assumed", "helps"), [(0.5, False), (5.0, True)])
def test_noise_is_advised_where_it_helps(assumed: float, helps: bool) -> None:
    """Of the camera it is 0.1 px: the filter assumes more, and runs with 0.1 px leave less, or do not."""
    for amplitude, frequency in ((0.005, 0.5), (0.01, 0.3)):
        scenario = moving(HEXAPOD, along(amplitude, frequency), {NOISE: assumed})
        (sentence,) = sentences(scenario)
        assert (NOISE in sentence) == helps
        run, less = error_of(scenario), error_of(scenario.updated({NOISE: 0.1}))
        print(f"{amplitude:g} m, {frequency:g} Hz: {run:.2f} px, with 0.1 px {less:.2f} px")
        assert (less < 0.8 * run) == helps
        follow_all(scenario, sentence)


def test_a_faster_reference_is_advised_with_the_certainty_that_it_takes() -> None:
    """At the scenario's own certainty it leaves more, and a slower one less; with 0 it is the other way around."""
    scenario = moving(HEXAPOD, along(0.003, 2.0))
    (sentence,) = sentences(scenario)
    assert stated(sentence) < error_of(scenario.updated({BANDWIDTH: 8.0}))
    ((slower, _), _) = advised(scenario, sentence)
    assert slower.controller.gains.bandwidth < scenario.controller.gains.bandwidth
    assert follow_all(scenario, sentence) == 2
    certain = scenario.updated({CERTAINTY: 0.0})
    (sentence,) = sentences(certain)
    ((faster, _), _) = advised(certain, sentence)
    assert faster.controller.gains.bandwidth > certain.controller.gains.bandwidth
    assert follow_all(certain, sentence) == 2


@pytest.mark.parametrize(
    ("amplitude", "frequency", "limit"),
    [(0.01, 2.0, 0.02), (0.015, 0.3, 0.005), (0.02, 0.5, 0.005), (0.003, 2.0, 0.005)],
)
def test_a_limit_of_the_legs_is_named_first(amplitude: float, frequency: float, limit: float) -> None:
    """The speed that is stated is that of the legs' lengths by their geometry, where they pass the goal."""
    changes = {CERTAINTY: 0.0, SPEED: limit}
    scenario = moving(HEXAPOD, along(amplitude, frequency), changes)
    (sentence,) = sentences(scenario)
    found = re.match(rf"{SPEED}: .* a leg moves at up to ([\d.]+) mm/s, more than the limit of ([\d.]+) mm/s", sentence)
    assert found
    assert 1e-3 * float(found[2]) == limit
    scene = scene_of(scenario)
    goals = find_goals(scene)
    assert goals is not None
    ends = goals.best.view.pose.rows.repeated(2).moved(np.outer([1e-4, -1e-4], np.eye(6)[0]))
    slope = np.abs(np.subtract(*scene.leg_travel(ends))).max() / 2e-4
    assert 1e-3 * float(found[1]) == pytest.approx(2.0 * np.pi * frequency * amplitude * slope, rel=0.02)
    assert follow_all(scenario, sentence) >= 1


def test_a_steady_target_faster_than_the_legs_is_named() -> None:
    """From the goal on, to which the legs would take the whole run at their limit."""
    at_goal = {"simulation.start.pose": [0.004, -0.003, 0.002, -0.01, -0.015, 0.02], "simulation.duration": 8.0}
    for speed, limit, named in ((0.0025, 0.0008, True), (0.002, 0.02, False)):
        motion = {"kind": "velocity", "velocity": [speed, 0.0, 0.0]}
        scenario = moving(HEXAPOD, motion, {SPEED: limit, **at_goal})
        found = sentences(scenario)
        assert bool(found) == named
        if named:
            assert found[0].startswith(SPEED)
            assert follow_all(scenario, found[0]) == 2
        else:
            assert error_of(scenario) < scenario.metrics.band


def test_a_swing_faster_than_the_law_is_named_whatever_counts() -> None:
    """The platform is farther from the goal than one that stands still, and a certainty of 0 alone is no remedy."""
    for certainty in (2.5, 0.0):
        changes = {"camera.latency": 0.2, CERTAINTY: certainty, BANDWIDTH: 1.0, "controller.tracking.auto": None}
        scenario = moving(HEXAPOD, along(0.002, 2.0), changes)
        (sentence,) = sentences(scenario)
        still = re.search(r"a platform that stands still ([\d.]+) px", sentence)
        assert still
        assert float(still[1]) < stated(sentence)
        follow_all(scenario, sentence)


def test_a_target_that_is_followed_within_the_band_is_not_named() -> None:
    for motion in (along(0.0002, 0.5), along(0.005, 0.02)):
        scenario = moving(HEXAPOD, motion, {CERTAINTY: 0.0})
        assert not sentences(scenario)
        assert error_of(scenario) < scenario.metrics.band
