"""What counts as real numbers."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.scenario.arrays import real_numbers


@pytest.mark.parametrize("given", [2, 0.5, np.int8(3), [1, 2.5], np.arange(3), [[1.0], [2.0]], Fraction(1, 2)])
def test_numbers_become_floats(given: Any) -> None:
    found = real_numbers(given)
    assert found is not None
    assert found.dtype == float
    np.testing.assert_array_equal(found, np.asarray(given, dtype=float))


@pytest.mark.parametrize(
    "given",
    [
        True, np.bool_(False), [True, False], [True, 0.5], [[0.0], (np.bool_(True),)],
        np.ones(6, dtype=bool), np.array([1.5, True], dtype=object),
        [np.array(True), 0.5], [np.ones(2, dtype=bool), [0.0, 1.0]], [np.ma.masked, 0.5],
        "1", ["1"], 1j, None, [[1.0], [1.0, 2.0]], np.ma.array([1.0], mask=[True]), 10**400,
    ],
)  # fmt: skip
def test_booleans_text_and_the_like_are_no_numbers(given: Any) -> None:
    assert real_numbers(given) is None


def test_booleans_are_refused_as_poses_and_as_commands() -> None:
    paper = hs.load_scenario("paper")
    with pytest.raises(ValueError, match=r"^pose: expected "):
        hs.reachable(paper, np.ones(6, dtype=bool))
    sampled = paper.updated({"simulation.mode": "sampled", "simulation.duration": 0.01})
    for command in (np.ones(6, dtype=bool), [np.array(True), 0, 0, 0, 0, 0]):

        def gives(seen: hs.Observation, command: Any = command) -> Any:
            return command

        with pytest.raises(ValueError, match=r"^controller: expected a wrench of 6 finite numbers at tick 0"):
            hs.simulate(sampled, controller=gives)
