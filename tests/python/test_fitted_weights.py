"""Gains that fit where points count more or less than others: `target.weights`."""

from __future__ import annotations

import numpy as np
import pytest

import hexservo as hs
from fitted_machines import Array
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_gains import slow_share
from hexservo.findings.prior import share_of_prior
from hexservo.scenario.fitted import machine_of
from hexservo.scenario.laws import ALL_LAWS, LAWS
from test_fitted_gains import gains_of, with_auto

PRIOR = ("composite", "computed_torque")


def loop_of(scenario: hs.Scenario, law: str) -> hs.Scenario:
    """What the law takes part in: `tracking` commands positions."""
    positions = {"simulation.mode": "sampled", "actuators.kind": "position"}
    return scenario.updated({"controller.law": law, **(positions if law == "tracking" else {})})


def with_points(scenario: hs.Scenario, law: str, beside: list[list[float]], weights: list[float]) -> hs.Scenario:
    """The points of `paper` and others beside them, which shift as those do, under fitted gains."""
    assert scenario.target.initial_features is not None
    points = np.array([*np.reshape(scenario.target.initial_features, (-1, 2)), *beside])
    target = {"initial_features": points.ravel(), "desired_features": (points - [20.0, 8.0]).ravel()}
    changes = {f"target.{key}": value.tolist() for key, value in target.items()}
    return with_auto(scenario, law, 2.0, **changes, **{"target.weights": weights})


def of_first_points(gain: Array, like: Array) -> Array:
    """The gain of the points that the other has too; gains of other things have as many numbers in both."""
    return gain[: like.size] if gain.ndim else gain


@pytest.mark.parametrize("law", ALL_LAWS)
def test_points_of_no_weight_change_no_gain(paper: hs.Scenario, law: str) -> None:
    paper = loop_of(paper, law)
    four = gains_of(with_points(paper, law, [], [1.0] * 4))
    eight = gains_of(with_points(paper, law, [[40, 0], [0, 40], [-40, 5], [9, 9]], [1.0] * 4 + [0.0] * 4))
    for key, value in four.items():
        np.testing.assert_allclose(of_first_points(eight[key], value), value, rtol=1e-12)


@pytest.mark.parametrize("law", ALL_LAWS)
def test_a_point_of_weight_two_is_as_two_of_weight_one(paper: hs.Scenario, law: str) -> None:
    paper = loop_of(paper, law)
    assert paper.target.initial_features is not None
    first = np.array(paper.target.initial_features[:2])
    twice = gains_of(with_points(paper, law, [], [2.0, 1.0, 1.0, 1.0]))
    two = gains_of(with_points(paper, law, [(first + 1e-5).tolist()], [1.0] * 5))
    for key, value in twice.items():
        np.testing.assert_allclose(of_first_points(two[key], value), value, rtol=1e-6)


@pytest.mark.parametrize("law", [law for law in LAWS if law not in ("resolved_rate", "pbvs")])
def test_the_warnings_are_of_the_points_that_count(paper: hs.Scenario, law: str) -> None:
    """An idle point whose image error no motion explains: it is no part of what a law leaves or does slowly."""
    four = with_points(paper, law, [], [1.0, 1.0, 1.0, 1.0])
    idle = with_points(paper, law, [[300, 200]], [1.0, 1.0, 1.0, 1.0, 0.0])
    idle = idle.updated({"target.desired_features": [*four.target.desired_features, 0.0, 0.0]})
    found = []
    for scenario in (four, idle):
        scene, machine = scene_of(scenario), machine_of(scenario)
        found.append((slow_share(scene, machine), share_of_prior(scene, machine) if law in PRIOR else 0.0))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
