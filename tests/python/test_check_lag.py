"""Drives of forces that are too late for the gains: what `check` states of them, by runs from near the goal."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.loop_of_scenario import loop_at_rest, quiet
from hexservo.findings.analysis.scene import ALL_AXES, scene_of
from hexservo.findings.check import unlikely
from hexservo.findings.check_lag import of_lag

BANDWIDTH, DELAY = "actuators.bandwidth", "actuators.delay"
KELLY = {"controller.law": "kelly"}
READ_SELDOM = {"sensors": {"pose": "encoders", "period": 0.005}}


def sentences(scenario: hs.Scenario) -> list[str]:
    return list(of_lag(scene_of(scenario)))


def changed(changes: dict[str, Any]) -> hs.Scenario:
    return hs.load_scenario("composite-30hz").updated(changes)


def growth(scenario: hs.Scenario, duration: float) -> float:
    """Return the motion in the last third of a run to that in the one before, from home with a goal 1e-5 px away."""
    if hasattr(scenario.controller.gains, "kv"):
        scenario = scenario.updated({f"controller.{scenario.controller.law}.kv": 0.0})
    calm = quiet(scenario)
    scene = scene_of(calm)
    goal = scene.view(scene.home).after(ALL_AXES * scene.unit, 1e-5)
    return growing(calm.updated({"target.desired_features": goal.tolist()}), duration)


def growing(scenario: hs.Scenario, duration: float) -> float:
    result = hs.simulate(scenario.updated({"simulation.duration": duration, "simulation.log_every": 1}))
    size = np.linalg.norm(result.twist * np.repeat([1.0, scene_of(scenario).platform_radius], 3), axis=1)
    thirds = np.array_split(size, 3)
    return float(thirds[2].max() / thirds[1].max())


@pytest.mark.parametrize(
    "changes", [{}, KELLY, READ_SELDOM, {DELAY: 0.003}], ids=["composite", "kelly", "encoders", "with delay"]
)
def test_small_runs_decay_from_the_stated_bandwidth_on_and_grow_below_it(changes: dict[str, Any]) -> None:
    (sentence,) = sentences(changed({**changes, BANDWIDTH: 2.0}))
    assert sentence.startswith(f"{BANDWIDTH}: with a bandwidth of 2 Hz")
    found = re.search(r"stable from ([\d.]+) Hz on", sentence)
    assert found is not None, sentence
    least = float(found[1])
    below, beyond = (growth(changed({**changes, BANDWIDTH: share * least}), 3.0) for share in (0.85, 1.15))
    print(sentence, below, beyond)
    assert beyond < 0.9
    assert below > 1.1
    assert not sentences(changed({**changes, BANDWIDTH: least}))


def test_a_loop_that_the_lag_makes_oscillate_at_the_goal_alone_is_named() -> None:
    """At home the mode decays with 2 Hz, at the goal, where the weight is on other cranks, it grows."""
    exact = {"robot.centre_of_mass": [0, 0, 0], "robot.inertia": [9e-4, 9e-4, 7e-4], "uncertainty.gravity": 0.0}
    head = hs.load_scenario("reachy-mini-head").updated({**exact, "sensors": {"pose": "true"}, BANDWIDTH: 2.0})
    (sentence,) = sentences(head)
    found = re.search(r"stable from ([\d.]+) Hz on", sentence)
    assert found is not None, sentence
    rest = loop_at_rest(head).rest.view.pose.displacement_from(scene_of(head).home)
    start = rest + 1e-7 * np.array([1.0, -1.0, 1.0, 20.0, -20.0, 20.0])
    calm = quiet(head).updated({"simulation.start.pose": start.tolist()})
    below, beyond = (growing(calm.updated({BANDWIDTH: share * float(found[1])}), 6.0) for share in (0.85, 1.15))
    print(sentence, below, beyond)
    assert beyond < 0.9
    assert below > 1.1


def test_small_runs_decay_up_to_the_stated_delay_and_grow_beyond_it() -> None:
    (sentence,) = sentences(changed({DELAY: 0.008}))
    found = re.search(r"with a delay of 8 ms .* stable with up to ([\d.]+) ms", sentence)
    assert found is not None, sentence
    most = 1e-3 * float(found[1])
    assert growth(changed({DELAY: most}), 3.0) < 0.9
    assert growth(changed({DELAY: round(most + 1e-3, 6)}), 3.0) > 1.1


def test_drives_that_are_late_are_named_in_place_of_the_fuzzy_systems() -> None:
    """Of a delay of 8 ms an adaptation 2.95 times as slow was the remedy, with which the run does not settle."""
    warnings = unlikely(changed({DELAY: 0.008}))
    assert [words.split(":")[0] for words in warnings if "linear loop" in words] == [DELAY]
    both = unlikely(changed({DELAY: 0.008, BANDWIDTH: 10.0}))
    (sentence,) = [words for words in both if "linear loop" in words]
    assert sentence.startswith(f"{BANDWIDTH}, {DELAY}: with a bandwidth of 10 Hz and a delay of 8 ms the linear loop")


@pytest.mark.parametrize("name", ["real-machine", "composite-30hz", "pi-h824-positions", "reachy-mini-motors", "paper"])
def test_drives_that_are_fast_enough_have_no_sentence(name: str) -> None:
    assert not sentences(hs.load_scenario(name))
