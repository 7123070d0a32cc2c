"""Goal images whose points stand in another order, or whose pixels count otherwise, and what `check` asks of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.check import unlikely
from hexservo.scenario.goal_readings import best_readings
from hexservo.scenario.scenario import Document

GOAL = [0.004, -0.003, 0.002, -0.01, -0.015, 0.03]
KEY = "target.desired_features"


@pytest.fixture(scope="module")
def machine() -> hs.Scenario:
    """A machine that takes positions, with the goal image of a pose within its stroke; pixels from the centre."""
    found = hs.load_scenario("pi-h824-positions")
    return found.updated({KEY: hs.project(found, GOAL).tolist()})


def given(machine: hs.Scenario, pixels: Any) -> hs.Scenario:
    return machine.updated({KEY: np.asarray(pixels).ravel().tolist()})


def points(machine: hs.Scenario) -> np.ndarray:
    return np.asarray(machine.target.desired_features).reshape(-1, 2)


def sentences(scenario: hs.Scenario) -> str:
    return "\n".join(unlikely(scenario))


@pytest.mark.parametrize("order", [(1, 0, 3, 2), (3, 2, 1, 0), (1, 2, 3, 0), (2, 3, 0, 1)])
def test_the_order_that_is_meant_is_found_by_its_image(machine: hs.Scenario, order: tuple[int, ...]) -> None:
    """The order that undoes a permutation is its inverse, and gives the image of the goal again."""
    wrong = given(machine, points(machine)[list(order)])
    readings = best_readings(wrong)
    named = "with its points in the order " + " ".join(str(1 + k) for k in np.argsort(order))
    (reading,) = (each for each in readings if each.words == named)
    assert reading.pixels == pytest.approx(np.ravel(points(machine)), abs=1e-9)
    assert reading.shift == pytest.approx(np.linalg.norm(GOAL[:3]), abs=1e-6)
    assert reading.turn == pytest.approx(np.linalg.norm(GOAL[3:]), abs=1e-6)
    said = sentences(wrong)
    assert named in said
    for misleading in ("simulation.duration", "start on the goal's side", "hexservo diagnose names the cause"):
        assert misleading not in said


def test_pixels_of_opencv_are_named(machine: hs.Scenario) -> None:
    """Image coordinates with v down, about the centre and from the first pixel."""
    flipped = points(machine) * [1.0, -1.0]
    assert "with v pointing down (camera.axes: opencv)" in sentences(given(machine, flipped))
    assert machine.camera.image_size is not None
    corner = flipped + (np.asarray(machine.camera.image_size) - 1.0) / 2.0
    (reading,) = best_readings(given(machine, corner))
    assert reading.words == "counted from the first pixel of the image with v pointing down (camera.axes: opencv)"
    assert reading.pixels == pytest.approx(np.ravel(points(machine)), abs=1e-9)


def test_a_crossed_order_that_no_pose_shows_is_named_in_the_refusal(machine: hs.Scenario) -> None:
    keys = machine.to_mapping()
    keys["target"]["desired_features"] = points(machine)[[0, 2, 1, 3]].ravel().tolist()
    with pytest.raises(hs.ScenarioError, match=r"some pose gives .* with its points in the order 1 3 2 4, the goal"):
        Document(keys).scenario()


def test_a_goal_that_is_read_rightly_is_not_asked_about(machine: hs.Scenario) -> None:
    """Within the stroke, and just beyond it: that goal is far away as it stands, and is nothing else."""
    assert "with its points in the order" not in sentences(machine)
    far = given(machine, hs.project(machine, [0.0, 0.0, -0.04, 0.0, 0.0, 0.0]))
    assert "the goal is out of reach" in sentences(far)
    assert "the goal would be within reach" not in sentences(far)
    assert "simulation.duration" not in sentences(far)
