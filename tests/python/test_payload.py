"""Centre of mass off the platform's origin, payloads known and unknown: one body, however it is described."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]

EXACT = {"uncertainty.inertia": 0.0, "uncertainty.coriolis": 0.0, "uncertainty.depth": 0.0}
PAYLOAD: dict[str, Any] = {"mass": 0.012, "position": [0.02, -0.015, 0.03], "inertia": [2e-6, 3e-6, 4e-6]}
RUN = ("feature_error", "position", "twist", "wrench", "leg_forces")


@pytest.fixture(scope="module")
def paper() -> hs.Scenario:
    return hs.load_scenario("paper").updated({**EXACT, "simulation.duration": 0.5})


def about_origin(mass: float, centre: Any) -> Array:
    c = np.asarray(centre)
    return np.asarray(mass * (c @ c * np.eye(3) - np.outer(c, c)))


def assert_same(one: hs.Result, other: hs.Result, within: float) -> None:
    assert one.outcome == other.outcome == "completed"
    for name in RUN:
        expected = getattr(other, name)
        np.testing.assert_allclose(getattr(one, name), expected, rtol=0, atol=within * np.abs(expected).max())


@pytest.mark.parametrize("law", ["hybrid", "composite", "kelly", "resolved_rate", "pbvs", "computed_torque"])
def test_a_known_payload_is_a_platform_of_both(paper: hs.Scenario, law: str) -> None:
    """The joined body by hand: masses, first moments and inertias about E's origin add up."""
    robot = paper.robot
    mass = robot.mass + PAYLOAD["mass"]
    loaded = paper.updated({"controller.law": law, "robot.payload": PAYLOAD})
    inertia = np.diag(robot.inertia) + np.diag(PAYLOAD["inertia"]) + about_origin(PAYLOAD["mass"], PAYLOAD["position"])
    joined = paper.updated(
        {
            "controller.law": law,
            "robot.mass": mass,
            "robot.centre_of_mass": PAYLOAD["mass"] * np.array(PAYLOAD["position"]) / mass,
            "robot.inertia": inertia,
        }
    )
    # 500 steps of rounding errors of 1e-16, on loops that forget them
    assert_same(hs.simulate(loaded), hs.simulate(joined), 1e-10)


def test_computed_torque_moves_every_known_body_alike(paper: hs.Scenario) -> None:
    """D (K_p e - K_d chi-dot) + C chi-dot + G cancels the dynamics, wherever the mass is."""
    law = {"controller.law": "computed_torque", "robot.force_limit": 10.0}
    light = hs.simulate(paper.updated(law))
    loaded = hs.simulate(paper.updated({**law, "robot.payload": {**PAYLOAD, "mass": 0.05}}))
    np.testing.assert_allclose(loaded.position, light.position, rtol=0, atol=1e-10)
    np.testing.assert_allclose(loaded.feature_error, light.feature_error, rtol=0, atol=1e-7)
    assert np.abs(loaded.wrench - light.wrench).max() > 0.4  # [N]: at least the weight differs


def test_a_central_payload_that_is_unknown_is_an_error_of_the_mass(paper: hs.Scenario) -> None:
    share = -0.2
    errors = np.zeros((6, 6))
    errors[:3, :3] = share
    unknown = {"mass": -share * paper.robot.mass, "position": [0, 0, 0], "known": False}
    one = hs.simulate(paper.updated({"robot.payload": unknown}))
    other = hs.simulate(paper.updated({"uncertainty.inertia": errors, "uncertainty.gravity": share}))
    assert_same(one, other, 1e-9)
    assert not np.allclose(one.position[-1], hs.simulate(paper).position[-1], atol=1e-4)


def test_the_weight_of_a_body_off_centre_acts_in_its_centre(paper: hs.Scenario) -> None:
    """At rest and without control forces, only the legs' forces hold it: the safe output of a tick without an image."""
    scenario = paper.updated({"robot.payload": PAYLOAD, "robot.home_attitude": [0.2, -0.1, 0.3]})
    settings = core_parameters(scenario)
    home = settings.robot
    quaternion = np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    turn = np.array([[1, 0, 0], [0, np.cos(0.2), -np.sin(0.2)], [0, np.sin(0.2), np.cos(0.2)]])
    force = -(home.mass + PAYLOAD["mass"]) * np.array([0.0, 0.0, 9.8])
    arm = turn @ (PAYLOAD["mass"] * np.array(PAYLOAD["position"])) / (home.mass + PAYLOAD["mass"])
    np.testing.assert_allclose(settings.body.weight(quaternion), [*force, *np.cross(arm, force)], rtol=1e-14)


def test_scenarios_of_a_batch_do_not_depend_on_their_company(paper: hs.Scenario) -> None:
    """Zero among others, and zero among zeros: the same bits."""
    centres = np.array([[0.0, 0.0, 0.0], [0.01, -0.02, 0.0], [0.0, 0.0, 0.02]])
    base = paper.updated({"robot.inertia": [1e-3] * 3, "simulation.log_every": 50})
    batch = hs.simulate_batch(base, {"robot.centre_of_mass": centres}, log="trajectory")
    alone = hs.simulate_batch(base, {"robot.centre_of_mass": np.zeros((2, 3))}, log="trajectory")
    np.testing.assert_array_equal(batch.samples["position"][0], alone.samples["position"][0])
    for k, centre in enumerate(centres):
        one = hs.simulate(base.updated({"robot.centre_of_mass": centre}))
        np.testing.assert_allclose(batch.samples["position"][k], one.position, rtol=0, atol=1e-11)


def test_a_controller_knows_what_it_is_told(paper: hs.Scenario) -> None:
    """The tick of a robot's program: the wrench of the simulated run, payload known or not."""
    for known in (True, False):
        scenario = paper.updated({"simulation.mode": "sampled", "robot.payload": {**PAYLOAD, "known": known}})
        run = hs.simulate(scenario)
        controller = hs.Controller(scenario)
        for k in range(5):
            out = controller.step(run.features[k], run.depth[k], run.position[k], run.quaternion[k], run.twist[k])
            np.testing.assert_allclose(out.wrench, run.wrench[k], rtol=1e-12)  # kernels may fuse


def test_the_diagnosis_names_an_unknown_payload() -> None:
    result = hs.simulate(hs.load_scenario("unknown-payload"))
    diagnosis = hs.diagnose(result)
    assert diagnosis.causes[0].cause == "gravity"
    assert diagnosis.causes[0].named
    remedy = diagnosis.causes[0].remedy
    assert remedy is not None
    assert remedy.changes == {"robot.payload.known": True}
    assert not np.isnan(hs.metrics(hs.simulate(result.scenario.updated(remedy.changes)))["settling_time"])


def test_what_is_not_certified_says_so(paper: hs.Scenario) -> None:
    scenario = paper.updated({"robot.payload": PAYLOAD})
    certificate = hs.certify(hs.simulate(scenario))
    assert certificate.energy is None
    assert "centre of mass" in certificate.open_questions["energy"]
    with pytest.raises(ValueError, match="centre of mass"):
        hs.certify_batch(scenario, {"uncertainty.depth": [0.0]})
    sentences = str(hs.analyse(scenario))
    assert "centre of mass" in sentences


def test_errors_leave_a_positive_inertia_with_the_payload_too(paper: hs.Scenario) -> None:
    """An entry that is small against the platform's moments, and not against those of a payload at its origin."""
    n = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    errors = np.zeros((6, 6))
    errors[3, 5] = errors[5, 3] = -0.4
    payload = {"mass": 0.01, "inertia": (0.02 * (np.eye(3) - np.outer(n, n))).tolist()}
    assert paper.updated({"uncertainty.inertia": errors}).uncertainty.inertia
    with pytest.raises(hs.ScenarioError, match=r"uncertainty.inertia: expected errors that surely leave a positive"):
        paper.updated({"uncertainty.inertia": errors, "robot.payload": payload})


def test_a_batch_of_central_payloads_takes_errors_that_a_run_takes(paper: hs.Scenario) -> None:
    scenario = paper.updated({"uncertainty.inertia": 0.1 * np.eye(6), "simulation.duration": 0.05})
    assert (hs.simulate_batch(scenario, {"robot.payload.mass": [0.0, 0.01]}).outcome == "completed").all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot.payload.mass": -1.0}, "robot.payload.mass: expected a number >= 0"),
        ({"robot.payload.position": [0.1, 0, 0]}, "robot.payload.mass: expected a mass > 0"),
        ({"robot.payload": {"mass": 0.1, "inertia": [1e-3, 1e-5, 1e-5]}}, "robot.payload.inertia: expected principal"),
        ({"robot.payload": {"mass": 0.1, "inertia": [-1e-3, 1e-3, 1e-3]}}, "robot.payload.inertia: expected principal"),
        ({"robot.centre_of_mass": [0.1, 0.0, 0.0]}, "robot.inertia: expected an inertia about the platform's origin"),
        (
            {"robot.centre_of_mass": [0.001, 0.0, 0.0], "uncertainty.inertia": (1.4 * np.eye(6) - 0.9).tolist()},
            "uncertainty.inertia: expected errors with 1 - error positive semidefinite",
        ),
    ],
)
def test_refusals(paper: hs.Scenario, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(hs.ScenarioError) as caught:
        paper.updated(changes)
    assert str(caught.value).startswith(message), caught.value
