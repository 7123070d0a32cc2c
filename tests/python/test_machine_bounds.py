"""What no machine is: joints in another order than its legs, and masses and lengths far beyond all machines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo import _core
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.schema import schema
from rescaled import rescaled

Array = NDArray[np.float64]
PLATFORM, BASE = np.deg2rad([-50, 50, 70, 170, 190, 290]), np.deg2rad([-10, 10, 110, 130, 230, 250])
MACHINE_UNITS = ("kg", "m", "kg m^2")
KEYS: dict[str, dict[str, Any]] = {
    entry["key"]: entry
    for entry in schema()
    if entry["key"].startswith(("robot.", "camera.mount.")) and entry["unit"] in MACHINE_UNITS
}


def circle(radius: float, angles: Array) -> Array:
    return radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])


def typed(points: Array, digits: int) -> list[list[float]]:
    return [[float(f"{number:.{digits}g}") for number in row] for row in points]


def ratio(robot: _core.RobotParameters) -> float:
    """Smallest over largest singular value of H at home."""
    hexapod = _core.Hexapod(robot)
    values = hexapod.singular_values(hexapod.home_position, hexapod.home_quaternion)
    return float(values[-1] / values[0])


# ---- Joints in another order ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("digits", [4, 5, 6, 16])
@pytest.mark.parametrize("error", ["reversed", "mirrored", "similar", "none"])
def test_joints_in_another_order_are_refused_as_such(paper: hs.Scenario, error: str, digits: int) -> None:
    """Rounded to a few digits such a geometry is only nearly singular."""
    angles = {"reversed": PLATFORM[::-1], "mirrored": -PLATFORM, "similar": BASE, "none": PLATFORM}[error]
    joints = {
        "robot.platform_joints": typed(circle(0.1, angles), digits),
        "robot.base_joints": typed(circle(0.2, BASE), digits),
        **{f"robot.{side}_{key}": None for side in ("platform", "base") for key in ("radius", "angles")},
    }
    if error == "none":
        assert ratio(core_parameters(paper.updated(joints)).robot) > 0.1
        return
    with pytest.raises(hs.ScenarioError) as caught:
        paper.updated(joints)
    (problem,) = caught.value.problems
    assert problem.startswith("robot.platform_joints" if error == "similar" else "robot.home_position")
    assert "the joints of platform and base in the order of the legs, both counted the same way round" in problem
    assert "a wrench map that is singular at home" in problem


def test_no_machine_comes_near_the_least_ratio() -> None:
    """The core refuses ratios below 1e-4."""
    assert min(ratio(core_parameters(hs.load_scenario(name)).robot) for name in hs.scenario_names()) > 0.09


def test_random_machines_hold_their_platform(paper: hs.Scenario) -> None:
    """Joints in pairs, at most 25 degrees from the middle of a pair: at 30 both sides are regular hexagons."""
    random = np.random.default_rng(20261128)
    ratios = []
    for _ in range(1000):
        robot = core_parameters(paper).robot
        gaps = random.uniform(0.0, 25.0, 2)
        signs = np.tile([-1.0, 1.0], 3)
        robot.base_angles = np.deg2rad(np.repeat([0.0, 120.0, 240.0], 2) + gaps[0] * signs)
        robot.platform_angles = np.deg2rad(np.array([-60.0, 60.0, 60.0, 180.0, 180.0, 300.0]) - gaps[1] * signs)
        robot.platform_radius = 1.0
        robot.base_radius = random.uniform(0.6, 3.0)
        robot.home_position = np.array([0.0, 0.0, -random.uniform(0.3, 5.0)])
        ratios.append(ratio(robot))
    assert min(ratios) > 1e-3


# ---- Masses and lengths ---------------------------------------------------------------------------------------------


def test_the_keys_of_the_machine_are_found() -> None:
    some = {"robot.mass", "robot.payload.inertia", "robot.stroke", "robot.cranks.rod", "camera.mount.position"}
    assert some <= set(KEYS)


@pytest.mark.parametrize("key", KEYS)
def test_masses_and_lengths_of_a_machine_have_bounds(key: str) -> None:
    most = {"kg": 1e9, "m": 1e6, "kg m^2": 1e12}[KEYS[key]["unit"]]
    assert KEYS[key]["maximum"] == most
    assert "maximum" in KEYS[key]["exclusive"]
    assert KEYS[key]["minimum"] in (0.0, -most)


@pytest.mark.parametrize("value", [1e20, 1e60, 1e300])
@pytest.mark.parametrize("key", ["robot.mass", "robot.payload.mass", "robot.stroke", "robot.base_radius"])
def test_absurd_numbers_are_refused_with_the_bound(paper: hs.Scenario, key: str, value: float) -> None:
    most = KEYS[key]["maximum"]
    words = f"{key}: expected a number >=? 0 and < {most:g}( or null)?, got {value!r}".replace("+", r"\+")
    with pytest.raises(hs.ScenarioError, match=f"^{words}"):
        paper.updated({key: value})
    with pytest.raises(ValueError, match=words):
        hs.simulate_batch(paper, {key: [value]})


def test_the_core_refuses_them_too(paper: hs.Scenario) -> None:
    settings = core_parameters(paper)
    settings["robot.payload.mass"] = 1e60
    with pytest.raises(ValueError, match=r"robot\.payload\.mass: expected a number >= 0 and < 1000000000, got 1e\+60"):
        settings.validate()


@pytest.mark.parametrize(("length", "mass"), [(1e-5, 1e-9), (100.0, 2e6)])
def test_machines_of_a_micrometre_and_of_a_hundred_tonnes_fit(length: float, mass: float) -> None:
    """Platforms of 1 um radius and 60 pg, and of 10 m and 120 t, move as the paper's does."""
    paper = hs.load_scenario("paper", {"simulation.duration": 0.2, "controller.law": "pbvs"})
    own, other = (hs.simulate(scenario) for scenario in (paper, rescaled(paper, length, mass)))
    assert own.outcome == other.outcome == "completed"
    np.testing.assert_allclose(other.feature_error, own.feature_error, atol=1e-6)
