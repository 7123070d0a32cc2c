"""Sentences on a drift: each number with the pose and the modes that it belongs to."""

from __future__ import annotations

import functools
import re
from dataclasses import replace

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import camera_rate, drift
from hexservo.findings.analysis.drift import Drift
from hexservo.findings.analysis.drift_patterns import Pattern

SLOW = {
    "camera": {"latency": 0.06, "period": 0.033, "noise": 0.05},
    "uncertainty.depth": [0.25, -0.27, -0.28, -0.29],
    "controller.composite.auto.bandwidth": 0.5,
}


@functools.cache
def slow() -> hs.Scenario:
    """Give a loop of 0.5 Hz whose own depth errors drift away at the goal faster than at the start."""
    return hs.load_scenario("noisy-camera").updated(SLOW)


def own_words(found: Drift) -> tuple[Pattern, str]:
    assert found.own is not None
    (words,) = (text for text in found.section().sentences if "own depth errors" in text)
    return found.own, words


def test_a_drift_that_grows_at_both_poses_has_the_faster_one_first() -> None:
    own, words = own_words(drift.analyse(slow()))
    assert own.goal_rate < own.rate < 0.0
    assert f"the smallest eigenvalue is {own.start:.3g} at the start and {own.goal:.3g} at the goal" in words
    assert words.endswith(
        f"the pose error grows e-fold in {-1 / own.goal_rate:.3g} s at the goal, and in {-1 / own.rate:.3g} s at the "
        "start."
    )
    # The linear loop at the goal, with inertia and adaptation, which are not far from as slow: 101 s.
    rate = camera_rate.analyse(slow(), borders=False)
    assert rate.free is not None
    assert rate.free.drift_rate == pytest.approx(-own.goal_rate, rel=0.2)


def test_the_eigenvalues_of_two_poses_have_their_own_time_constants() -> None:
    found = drift.analyse(hs.load_scenario("unequal-depth-60s"))
    own, words = own_words(found)
    number = r"([0-9.e-]+)"
    pattern = (
        f"eigenvalue is {number} at the start and {number} at the goal, and the time constant is {number} s at the "
        f"start and {number} s at the goal, and {number} s at its end"
    )
    found_numbers = re.search(pattern, words)
    assert found_numbers is not None
    start, goal, of_start, of_goal, of_end = map(float, found_numbers.groups())
    expected = [own.start, own.goal, 1 / own.rate, 1 / own.goal_rate, own.end_time_constant]
    np.testing.assert_allclose([start, goal, of_start, of_goal, of_end], expected, rtol=5e-3)
    # a creep without inertia: the rate is the eigenvalue times what drives it, at both poses
    assert start * of_start == pytest.approx(goal * of_goal, rel=0.01)
    assert start * of_goal != pytest.approx(goal * of_start, rel=0.1)


@pytest.mark.parametrize(
    ("rates", "words"),
    [
        ((-0.02, -0.01), "grows e-fold in 50 s at the start, and in 100 s at the goal"),
        ((-0.01, -0.02), "grows e-fold in 50 s at the goal, and in 100 s at the start"),
        ((-0.01, 0.02), "grows e-fold in 100 s at the start, while at the goal it decays with a time constant of 50 s"),
        ((0.02, -0.01), "grows e-fold in 100 s at the goal, while at the start it decays with a time constant of 50 s"),
        ((-0.02, np.nan), "grows e-fold in 50 s at the start."),
    ],
)
def test_growth_and_decay_at_start_and_goal(rates: tuple[float, float], words: str) -> None:
    found = drift.analyse(slow())
    assert found.own is not None
    own = replace(found.own, rate=rates[0], goal_rate=rates[1])
    assert words in own_words(replace(found, own=own))[1]


def test_a_drift_is_not_called_the_slowest_mode_of_a_stable_loop() -> None:
    """The loop is stable except for the drift: the others decay, at the rate of its second eigenvalue."""
    found = camera_rate.analyse(slow())
    assert found.acting is not None
    assert found.learned is not None
    assert found.at_rest is not None
    assert found.clock is not None
    for margins in (found.acting, found.learned):
        assert margins.stable
        assert margins.drifts == 1
        assert margins.others_rate < 0.0 < margins.rate
    multipliers = found.at_rest.free.multipliers(found.clock)
    seconds = found.at_rest.free.seconds(found.clock)
    assert found.acting.others_rate == pytest.approx(np.log(np.abs(multipliers[1])) / seconds, rel=1e-6)
    sentences = found.section().sentences
    assert not any("slowest mode grows" in text for text in sentences)
    first = f"the drift grows at {found.acting.rate:.3g} 1/s, and the slowest of the other modes decays at "
    assert any(first + f"{-found.acting.others_rate:.3g} 1/s" in text for text in sentences)
    assert any("own run the loop is stable except for drift: the drift grows" in text for text in sentences)
    assert found.section().data["without_kv"]["growth_without_drifts"] == found.acting.others_rate


def test_without_a_drift_there_is_one_slowest_mode() -> None:
    found = camera_rate.analyse(hs.load_scenario("composite-30hz"))
    assert found.acting is not None
    assert (found.acting.others_rate, found.acting.others_frequency) == (found.acting.rate, found.acting.frequency)
    assert not any("drift" in text for text in found.section().sentences)
