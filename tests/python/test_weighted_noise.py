"""What the weights of the points make of noise: of one image's pose, of the legs, and of the filter of `tracking`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import conditioning
from hexservo.findings.analysis.image_estimate import estimate_of_image, rows_of_estimate
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.check_tracking import off_reference, steady_filter
from hexservo.findings.prior import legs_of_noise
from without_runs import unlikely_without_runs

SEED = 31
WEIGHTS = [[1.0] * 4, [0.01] * 4, [100.0] * 4, [1.0, 1.0, 1.0, 0.01], [1.0, 1.0, 1.0, 100.0], [3.0, 0.0, 1.0, 2.0]]


def by_differences(scenario: hs.Scenario) -> np.ndarray:
    """Return the Jacobian of `hs.project` at home, (2p, 6), by central differences."""
    steps = 1e-6 * np.eye(6)
    return np.stack([(hs.project(scenario, s) - hs.project(scenario, -s)).ravel() / 2e-6 for s in steps], axis=1)


def about(scenario: hs.Scenario, *heads: str) -> list[str]:
    return [line for line in unlikely_without_runs(scenario) if line.startswith(heads)]


# ---- one image ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weights", WEIGHTS)
def test_a_pose_is_as_uncertain_as_weighted_least_squares_leave_it(weights: list[float]) -> None:
    """All coordinates have the same noise, whatever their points count."""
    scenario = hs.load_scenario("moog-6dof2000e").updated({"target.weights": weights})
    jacobian, counts = by_differences(scenario), np.repeat(weights, 2)
    estimate = np.linalg.solve((jacobian.T * counts) @ jacobian, jacobian.T * counts)
    found = conditioning.analyse(scenario)
    np.testing.assert_allclose(found.start.pose_sigma, np.linalg.norm(estimate, axis=1), rtol=1e-5)
    scaled = estimate * np.repeat([1.0, found.start.length], 3)[:, None]
    assert found.start.worst == pytest.approx(np.linalg.norm(scaled, 2), rel=1e-5)
    assert found.placements[0].worst == pytest.approx(found.start.worst, rel=1e-9)  # the run starts at home


def test_rows_of_an_estimate_have_its_covariance() -> None:
    random = np.random.default_rng(SEED)
    for _ in range(20):
        jacobian = random.normal(size=(3, 12, 6)) * 10.0 ** random.uniform(-3, 3, 6)
        weights = np.repeat(10.0 ** random.uniform(-3, 3, 6), 2)
        rows = rows_of_estimate(jacobian, weights)
        for one, square in zip(jacobian, np.swapaxes(rows, -1, -2) @ rows, strict=True):
            estimate = estimate_of_image(one, weights)
            unit = np.sqrt(np.diag(estimate @ estimate.T))
            found = np.linalg.inv(square * unit * unit[:, None])
            np.testing.assert_allclose(found, estimate @ estimate.T / (unit * unit[:, None]), atol=1e-8)


def test_rows_of_an_estimate_of_equal_weights_are_those_that_count() -> None:
    jacobian = np.random.default_rng(SEED).normal(size=(10, 6))
    weights = np.repeat([0.3, 0.3, 0.0, 0.3, 0.3], 2)
    np.testing.assert_array_equal(rows_of_estimate(jacobian, weights), jacobian[weights > 0.0])


def test_a_point_that_counts_hardly_leaves_the_pose_of_the_others() -> None:
    jacobian = np.random.default_rng(SEED).normal(size=(8, 6))
    for least in (1e-12, 1e-300):
        rows = rows_of_estimate(jacobian, np.repeat([1.0, 1.0, 1.0, least], 2))
        np.testing.assert_allclose(rows.T @ rows, jacobian[:6].T @ jacobian[:6], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("weights", [1.0, 1e-4, 100.0])
def test_the_size_of_all_weights_makes_no_warning_of_a_target(weights: float) -> None:
    """`resolved_rate`, whose damping is far below J^T W J: runs are alike, and so is what is stated."""
    noisy: dict[str, Any] = {"camera.noise": 5.0, "controller.resolved_rate.damping": 1e-9}
    law: dict[str, Any] = {"controller.law": "resolved_rate", "target.weights": weights}
    moog = hs.load_scenario("moog-6dof2000e").updated({**law, **noisy})
    (line,) = about(moog, "target: at the start")
    assert "uncertain by 397 mm along y" in line
    assert "sends leg 5 by 287 mm" in line
    assert hs.metrics(hs.simulate(moog))["peak_leg_excursion"] > moog.robot.stroke
    quiet = hs.load_scenario("pi-h824").updated(law)
    usual = hs.metrics(hs.simulate(quiet.updated({"target.weights": 1.0})))["peak_leg_excursion"]
    assert not about(quiet, "target: at the start")
    assert hs.metrics(hs.simulate(quiet))["peak_leg_excursion"] == pytest.approx(usual, rel=1e-6)


def test_legs_of_noise_are_those_of_the_laws_inverse_with_unequal_weights() -> None:
    weights, damping = [1.0, 2.0, 0.5, 30.0], [1e3] * 3 + [10.0] * 3
    scenario = hs.load_scenario("moog-6dof2000e").updated(
        {"controller.law": "resolved_rate", "controller.resolved_rate.damping": damping, "target.weights": weights}
    )
    scene, jacobian, counts = Scene(scenario), by_differences(scenario), np.repeat(weights, 2)
    estimate = np.linalg.solve((jacobian.T * counts) @ jacobian + np.diag(damping), jacobian.T * counts)
    legs = np.array(
        [(scene.leg_travel(scene.home.moved(1e-6 * way)) - scene.leg_travel(scene.home)) / 1e-6 for way in np.eye(6)]
    )
    np.testing.assert_allclose(legs_of_noise(scene), np.linalg.norm(legs.T @ estimate, axis=1), rtol=1e-3)


# ---- the filter of `tracking` ---------------------------------------------------------------------------------------


def tracking(**changes: Any) -> hs.Scenario:
    return hs.load_scenario("pi-h824-positions").updated(changes)


@pytest.mark.parametrize("weight", [1e-3, 0.04, 100.0])
def test_weights_divide_the_noise_of_the_filter_by_their_root(weight: float) -> None:
    by_weight = tracking(**{"target.weights": weight})
    by_noise = tracking(**{"controller.tracking.noise": 0.5 / np.sqrt(weight)})
    one, other = (hs.simulate(scenario) for scenario in (by_weight, by_noise))
    np.testing.assert_allclose(one.position, other.position, atol=1e-7)
    first, second = (steady_filter(Scene(each), each.controller.gains).reading for each in (by_weight, by_noise))
    np.testing.assert_allclose(first, second, rtol=1e-6)
    heads = ("target.weights", "controller.tracking.noise")
    assert len(about(by_weight, *heads)) == len(about(by_noise, *heads)) == (weight != 0.04)


def test_weights_with_which_noise_restarts_the_filter_are_named_with_a_remedy() -> None:
    heavy = tracking(**{"target.weights": 100.0})
    (line,) = about(heavy, "controller.tracking.noise")
    assert "0.05 px, over the root of the largest of target.weights, is less than the 0.1 px of camera.noise" in line
    assert line.endswith("set it to 1, or the largest weight to 25")
    assert not about(heavy.updated({"controller.tracking.noise": 1.0}), "controller.tracking.noise")
    assert not about(heavy.updated({"target.weights": 25.0}), "controller.tracking.noise")


def test_noise_that_is_assumed_far_too_large_is_named_where_runs_do_not_settle() -> None:
    """A deviation of the place of 0.2, 0.5 and 1.5 times the distance to the target."""
    per_pixel = conditioning.analyse(tracking()).start.pose_sigma[:3].max() / 0.4
    times = []
    for share, warned in ((0.2, False), (0.5, True), (1.5, True)):
        scenario = tracking(**{"controller.tracking.noise": share / per_pixel})
        assert bool(about(scenario, "controller.tracking.noise")) == warned
        light = tracking(**{"target.weights": (0.5 * per_pixel / share) ** 2})
        assert bool(about(light, "target.weights")) == warned
        times.append(hs.metrics(hs.simulate(scenario))["settling_time"])
    usual = hs.metrics(hs.simulate(tracking()))["settling_time"]
    assert times[0] < 1.2 * usual
    assert times[1] > 2.0 * usual
    assert np.isnan(times[2])


def test_a_noise_that_is_named_has_a_remedy() -> None:
    for noise in (0.1, 0.0):
        far = tracking(**{"controller.tracking.noise": 50.0, "camera.noise": noise})
        (line,) = about(far, "controller.tracking.noise")
        assert f"are {noise:g} px: set it to 3.3 or less" in line
        assert "606 mm along x (standard deviation), at a distance of 400 mm" in line
        remedied = far.updated({"controller.tracking.noise": 3.3})
        assert not about(remedied, "controller.tracking.noise")
        assert hs.metrics(hs.simulate(remedied))["settling_time"] < 0.5


def test_noise_about_the_reference_is_that_of_the_camera_whatever_the_weights() -> None:
    found = []
    for weight in (1.0, 0.01, 100.0):
        scenario = tracking(**{"target.weights": weight})
        found.append(off_reference(Scene(scenario), scenario.controller.gains))
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-9)
