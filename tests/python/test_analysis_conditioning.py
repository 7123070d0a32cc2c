"""Conditioning of the image: closed forms of a square, known numbers, the noise of real estimates, poses of a goal."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.findings.analysis import conditioning
from hexservo.findings.analysis.goal import TOLERANCE, Goals, _turn_rate, find_goals
from hexservo.findings.analysis.placement import DEPTH_SHARE, image_radius, in_circle, place, placements
from hexservo.findings.analysis.scene import Scene, View, scene_of
from hexservo.findings.analysis.words import along, displacement_words, motion_in_words, number, numbers
from hexservo.findings.evidence import Curves, Table
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import points_outside

CORNERS = np.pi * np.array([1, 3, 5, 7]) / 4
SEED = 20


def square(size: float, depth: float, **changes: Any) -> hs.Scenario:
    """Corners at (+-size, +-size) px, parallel to the image, seen from the start and wanted there."""
    features = (in_circle(np.sqrt(2) * size, CORNERS)).tolist()
    target = {"initial_features": features, "desired_features": features, "depth": depth}
    return hs.load_scenario("paper").updated({"target": target, **changes})


def goals_of(scenario: hs.Scenario) -> Goals:
    goals = find_goals(scene_of(scenario))
    assert goals is not None
    return goals


def test_a_point_that_does_not_count_makes_no_pose_more_certain() -> None:
    """Four points, and the same with a fifth of weight 0; the size of all weights changes no noise."""
    four = hs.load_scenario("paper")
    features = [*four.target.initial_features, 100.0, 20.0]  # type: ignore[misc]
    target = {"initial_features": features, "desired_features": [*four.target.desired_features, 105.0, 25.0]}

    def sigma(weights: list[float]) -> NDArray[np.float64]:
        return conditioning.analyse(four.updated({"target": {**target, "weights": weights}})).start.pose_sigma

    alone = conditioning.analyse(four).start.pose_sigma
    np.testing.assert_allclose(sigma([1.0, 1.0, 1.0, 1.0, 0.0]), alone, rtol=1e-9)
    np.testing.assert_allclose(sigma([4.0] * 5), sigma([1.0] * 5), rtol=1e-9)
    assert (sigma([1.0] * 5) < alone).all()


# ---- what a pixel is ------------------------------------------------------------------------------------------------


@given(size=st.floats(20.0, 300.0), depth=st.floats(0.1, 3.0))
def test_a_square_worked_out_by_hand(size: float, depth: float) -> None:
    """J^T J of a centred square is block-diagonal: (x, about y), (y, about x), z, about z; its inverse by hand."""
    scene = scene_of(hs.load_scenario("paper"))
    features, z = in_circle(np.sqrt(2) * size, CORNERS), np.full(4, -depth)
    view = View(scene.home, features, z, scene.jacobian(features, z, scene.home))
    found = conditioning.sight("start", view, depth, scene)
    f, a = scene.camera.focal_pixels, size
    across = depth * np.sqrt((f**2 + a**2) ** 2 + a**4) / (2 * f * a**2)
    tilt = f / (2 * a**2)
    ahead = depth / (2 * np.sqrt(2) * a)
    np.testing.assert_allclose(found.pose_sigma[[0, 1]], across, rtol=1e-9)
    np.testing.assert_allclose(found.pose_sigma[[3, 4]], tilt, rtol=1e-9)
    np.testing.assert_allclose(found.pose_sigma[2], ahead, rtol=1e-12)
    np.testing.assert_allclose(found.pose_sigma[5], 1 / (2 * np.sqrt(2) * a), rtol=1e-12)
    # With rotations scaled by the depth the product of a two by two block's singular values has a closed form, too:
    # det = (2 f/d)^2 (2 a^2/f)^2 / d^2 = (4 a^2/d^2)^2.
    assert found.scaled_values[0] * found.scaled_values[-1] == pytest.approx(4 * a**2 / depth**2, rel=1e-9)


def test_known_numbers_of_the_paper(paper: hs.Scenario) -> None:
    found = conditioning.analyse(paper)
    assert found.goal is not None
    assert found.start.condition == pytest.approx(1760, rel=1e-3)
    assert found.goal.condition == pytest.approx(3170, rel=2e-3)
    np.testing.assert_allclose(0.1e3 * found.start.pose_sigma[:2], [22.2, 21.2], atol=0.05)  # [mm] for 0.1 px
    np.testing.assert_allclose(0.1e3 * found.goal.pose_sigma[:2], [37.8, 39.6], atol=0.05)
    words = " ".join(found.section().sentences)
    assert "37.8, 39.6 and 2.12 mm" in words
    assert "barely distinguishable from a rotation about (-0.72, 0.69, 0.00)" in words


@pytest.mark.parametrize(("depth", "stroke", "shift"), [(0.5, 0.017, 1e-2), (0.031, 0.017, 1e-4), (0.5, 2e-5, 1e-5)])
def test_the_least_observable_motion_is_shown_in_the_size_of_the_machine(
    depth: float, stroke: float, shift: float
) -> None:
    scene = scene_of(hs.load_scenario("paper").updated({"robot.stroke": stroke, "target.depth": depth}))
    start = conditioning.sight("start", scene.view(scene.start), scene.depth, scene)
    assert np.linalg.norm(start.hidden[:3]) == pytest.approx(shift)


def test_displacements_of_machines_of_any_size_have_their_digits() -> None:
    """Zero is written for what is small beside the depth and the other entries."""
    large = np.array([17.2e-3, 6.9e-3, 4e-9, 1e-9, -3e-9, 0.0])
    assert displacement_words(large, 0.5) == "(17.2, 6.9, 0) mm and a rotation of (0, 0, 0) mrad"
    turned = np.array([-1.5e-4, -3.4e-4, 0.0, -7.2e-3, 0.0, -0.435])
    assert displacement_words(turned, 0.5) == "(-0.15, -0.34, 0) mm and a rotation of (-7.2, 0, -435) mrad"
    small = np.array([4e-6, -3e-6, 1e-9, 0.0, -8.7e-4, 1e-8])
    assert displacement_words(small, 0.02) == "(0.004, -0.003, 0) mm and a rotation of (0, -0.87, 0) mrad"
    assert displacement_words(1e-9 * np.ones(6), 0.02) == "(0, 0, 0) mm and a rotation of (0, 0, 0) mrad"


@pytest.mark.parametrize("name", ["paper", pytest.param("task-general", marks=pytest.mark.slow)])
def test_pose_sigma_is_the_spread_of_poses_estimated_from_noisy_images(name: str) -> None:
    """Gauss-Newton on the core's projection, 3000 noisy images: noise so small that the estimate is linear."""
    scene = scene_of(hs.load_scenario(name))
    found = conditioning.analyse(scene.scenario).start
    noise, random = 1e-5, np.random.default_rng(SEED)
    estimates = []
    for _ in range(3000):
        measured = found.view.features + noise * random.normal(size=8)
        pose, way = scene.home, np.zeros(6)
        for _ in range(2):
            view = scene.view(pose)
            step: Array = np.linalg.pinv(view.jacobian) @ (measured - view.features)
            pose, way = pose.moved(step), way + step
        estimates.append(way)
    # A standard deviation of 3000 samples is itself known to 1.3 %.
    np.testing.assert_allclose(np.std(estimates, axis=0) / noise, found.pose_sigma, rtol=0.05)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("pi-h824", {"camera.focal_pixels": [1500.0, 300.0]}),
        ("reachy-mini", {}),
        ("reachy-mini-head", {}),
        ("pi-h824", {"camera.distortion.brown_conrady": [-0.2, 0.05, 2e-3, -1e-3, 0.0]}),
    ],
)
def test_pose_sigma_is_of_noise_in_the_pixels_of_the_camera(name: str, changes: dict[str, Any]) -> None:
    """Against central differences of `hs.project`, which gives pixels of the camera with its lens."""
    scenario = hs.load_scenario(name).updated(changes)
    found = hs.analyse(scenario, ["conditioning"]).conditioning
    start = found.scene.start.displacement_from(found.scene.home)
    steps = 1e-5 * np.eye(6)
    # A small displacement in B after `start`: shifts add, and turns of B come last.
    moved = [found.scene.start.moved(sign * steps).displacement_from(found.scene.home) for sign in (1.0, -1.0)]
    after, before = (hs.project(scenario, displaced) for displaced in moved)
    jacobian = (after - before).T / 2e-5
    sigma = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    assert start.shape == (6,)
    np.testing.assert_allclose(found.start.pose_sigma, sigma, rtol=1e-4)
    assert found.start.condition == pytest.approx(np.linalg.cond(jacobian), rel=1e-4)
    widest = found.placements[3].features  # at the edge of the circle that the image has room for
    assert not points_outside(scenario, widest).any()


def test_singular_directions_do_to_the_image_what_they_are_said_to(paper: hs.Scenario) -> None:
    found = conditioning.analyse(paper).start
    units = np.repeat([1.0, found.length], 3)
    np.testing.assert_allclose((found.directions * units) @ (found.directions * units).T, np.eye(6), atol=1e-12)
    for value, direction in zip(found.scaled_values, found.directions, strict=True):
        assert np.linalg.norm(found.view.jacobian @ direction) == pytest.approx(value, rel=1e-9)
        # A millionth of it, by the projection itself.
        moved_view = scene_of(paper).view(found.view.pose.moved(1e-6 * direction))
        change = np.linalg.norm(moved_view.features - found.view.features) / 1e-6
        assert change == pytest.approx(value, rel=1e-3, abs=5e-3)
    assert np.linalg.norm(found.hidden[:3]) == pytest.approx(0.01)
    assert found.condition == pytest.approx(np.linalg.cond(found.view.jacobian))
    assert found.worst == pytest.approx(1 / found.scaled_values[-1])


def test_the_noise_of_a_sampled_camera_is_the_noise_of_the_sentences() -> None:
    """A coordinate that is rounded to multiples of q has the deviation q/sqrt(12)."""
    noisy = hs.load_scenario("noisy-camera")
    for noise, rounding, words in (
        (0.5, 0.0, "0.5 px of noise in"),
        (0.05, 2.0, "0.58 px of noise and rounding in"),
        (0.0, 20.0, "5.77 px of rounding in"),
        (0.0, 0.0, "0.1 px of noise in"),
    ):
        found = conditioning.analyse(noisy.updated({"camera.noise": noise, "camera.quantisation": rounding}))
        assert found.noise == pytest.approx(np.hypot(noise, rounding / np.sqrt(12.0)) or 0.1)
        (sentence, *_) = found.section().sentences
        assert words in sentence
        assert f"uncertain by {numbers(1e3 * found.noise * found.start.pose_sigma[:3])} mm" in sentence


def test_a_position_uncertain_by_half_of_the_depth_is_unobservable(paper: hs.Scenario) -> None:
    found = conditioning.analyse(paper).start
    limit = 0.5 * 0.5 / found.pose_sigma[:3].max()  # [px], of points that are 0.5 m away
    assert found.pose_sigma[:3].argmax() != 2  # along any axis
    assert not found.unobservable(0.99 * limit)
    assert found.unobservable(1.01 * limit)


# ---- the pose of the goal -------------------------------------------------------------------------------------------


def test_the_goal_of_the_paper_is_a_translation_and_nearly_a_rotation(paper: hs.Scenario) -> None:
    goals = goals_of(paper)
    f = scene_of(paper).camera.focal_pixels
    shift = np.array([20 * 0.5 / f, 8 * 0.5 / f, 0.0, 0.0, 0.0, 0.0])  # every feature (-20, -8) px at 0.5 m
    assert goals.reachable
    np.testing.assert_allclose(goals.best.displacement, shift, atol=1e-9)
    near = goals.nearest
    assert near.largest_residual == pytest.approx(TOLERANCE, rel=1e-5)
    assert np.linalg.norm(near.displacement[:3]) < 1e-3
    np.testing.assert_allclose(near.displacement[3:], [13.2e-3, -32.8e-3, 0.3e-3], atol=2e-4)


@pytest.mark.parametrize(
    ("name", "shift", "turn"),
    [
        ("textbook-general", (0.3, -0.2, -0.3), np.pi / 4 * np.array([1, 2, 3]) / np.sqrt(14)),
        ("textbook-half-turn", (0, 0, 0), (0, 0, np.pi)),
        ("textbook-tilt", (0, 0, 0), (0, np.pi / 6, 0)),
        ("task-translation", (0, 0, -0.012), (0, 0, 0)),
    ],
)
def test_goals_of_the_classic_tasks(name: str, shift: tuple[float, ...], turn: NDArray[np.float64]) -> None:
    goals = goals_of(hs.load_scenario(name))
    wanted = Rotation.from_rotvec(turn)
    np.testing.assert_allclose(goals.best.displacement[:3], shift, atol=1e-7)
    assert (Rotation.from_rotvec(goals.best.displacement[3:]) * wanted.inv()).magnitude() < 1e-7


def test_no_pose_near_the_nearest_one_is_nearer(paper: hs.Scenario) -> None:
    """Random poses around it: those that show the goal within the tolerance are farther from home."""
    scene, goals = scene_of(paper), goals_of(paper)
    metric = np.repeat([1.0, scene.platform_radius], 3)
    least = np.linalg.norm(metric * goals.nearest.displacement)
    random = np.random.default_rng(SEED)
    # Along the valley of the image and a little across, so that enough of them show the goal.
    _, _, rows = np.linalg.svd(goals.nearest.view.jacobian)
    tried = 0
    for _ in range(4000):
        d = goals.nearest.displacement + rows.T @ (random.normal(size=6) * [1e-6, 1e-6, 1e-5, 1e-5, 1e-4, 1e-3])
        if np.abs(scene.desired - scene.view(scene.home.moved(d)).features).max() <= TOLERANCE:
            tried += 1
            assert np.linalg.norm(metric * d) >= least * (1 - 1e-4)
    assert tried > 100


def test_a_goal_that_no_pose_shows_is_said_with_its_residual(paper: hs.Scenario) -> None:
    features = np.array(paper.target.desired_features)
    features[5] += 20.0
    scenario = paper.updated({"target.desired_features": features})
    goals = goals_of(scenario)
    assert not goals.reachable
    best = goals.best
    slope = best.view.jacobian.T @ best.residual  # zero where the sum of squares is least
    size = np.linalg.norm(best.view.jacobian, axis=0) * np.linalg.norm(best.residual)
    assert (np.abs(slope) < 1e-5 * size).all()
    section = conditioning.analyse(scenario).section()
    assert section.verdict == "bad"
    assert any(f"leaves {number(best.largest_residual)} px" in sentence for sentence in section.sentences)


def test_a_camera_as_printed_has_no_goal_pose(paper: hs.Scenario) -> None:
    found = conditioning.analyse(paper.updated({"camera.convention": "as_printed"}))
    assert found.goals is None
    assert found.goal is None
    section = found.section()
    assert any("goal pose is open" in sentence for sentence in section.sentences)
    np.testing.assert_allclose(found.start.values, conditioning.analyse(paper).start.values, rtol=1e-12)


def test_a_displacement_turns_and_shifts_in_the_base_frame() -> None:
    scene = scene_of(hs.load_scenario("paper"))
    random = np.random.default_rng(SEED)
    for size in (1e-9, 1e-3, 1.0, 3.0):
        first, second = random.normal(size=(2, 6)) * size
        pose = scene.home.moved(first).moved(second)
        turned = Rotation.from_rotvec(second[3:]) * Rotation.from_rotvec(first[3:])
        w, x, y, z = pose.quaternion
        np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), turned.as_matrix(), atol=1e-14)
        np.testing.assert_allclose(pose.position, scene.home.position + first[:3] + second[:3], atol=1e-15)
        step = 1e-6 * random.normal(size=3)
        vector = first[3:]
        there = Rotation.from_rotvec(vector + step) * Rotation.from_rotvec(vector - step).inv()
        np.testing.assert_allclose(_turn_rate(vector) @ (2 * step), there.as_rotvec(), atol=1e-10)


def test_points_look_from_home_as_they_are_said_to() -> None:
    scene = scene_of(hs.load_scenario("textbook-general"))
    random = np.random.default_rng(SEED)
    features, depth = random.uniform(-200, 200, 8), -random.uniform(0.5, 2.0, 4)
    seen, z = _core.take_image(
        scene.camera, scene.home.position, scene.home.quaternion, scene.points_seen_as(features, depth)
    )
    np.testing.assert_allclose(seen, features, rtol=1e-12)
    np.testing.assert_allclose(z, depth, rtol=1e-12)


# ---- better places --------------------------------------------------------------------------------------------------


def worst_of(scene: Scene, features: Array, depth: Array, length: float) -> float:
    jacobian = scene.jacobian(features, depth, scene.home) / np.repeat([1.0, length], 3)
    return float(1 / np.linalg.svd(jacobian, compute_uv=False)[-1])


@pytest.mark.parametrize("name", ["paper", "task-tilt"])
def test_no_random_placement_beats_the_one_found(name: str) -> None:
    scene = scene_of(hs.load_scenario(name))
    found = placements(scene)
    own, best = found[0], found[-1]
    length, radius = scene.view(scene.home).mean_depth, image_radius(scene)
    assert np.hypot(*best.features.reshape(4, 2).T).max() <= radius * (1 + 1e-9)
    assert (np.abs(-best.depth / length - 1) <= DEPTH_SHARE * (1 + 1e-9)).all()
    assert best.worst < min(other.worst for other in found[:-1])
    assert best.worst == pytest.approx(worst_of(scene, best.features, best.depth, length), rel=1e-12)
    random = np.random.default_rng(SEED)
    tried = [
        worst_of(
            scene,
            in_circle(radius * np.sqrt(random.uniform(0, 1, 4)), random.uniform(-np.pi, np.pi, 4)),
            -length * random.uniform(1 - DEPTH_SHARE, 1 + DEPTH_SHARE, 4),
            length,
        )
        for _ in range(3000)
    ]
    near = [
        worst_of(
            scene,
            np.clip(1.0, None, radius / np.maximum(np.hypot(*nudged.T), 1e-9)).repeat(2) * nudged.ravel(),
            np.clip(
                best.depth + 0.01 * length * random.normal(size=4),
                -length * (1 + DEPTH_SHARE),
                -length * (1 - DEPTH_SHARE),
            ),
            length,
        )
        for nudged in (best.features.reshape(4, 2) + 2.0 * random.normal(size=(4, 2)) for _ in range(1000))
    ]
    assert best.worst <= min(tried)
    assert best.worst <= min(near) * (1 + 2e-3)  # the search minimises a smooth maximum of the six directions
    assert own.worst / best.worst > 3


def test_a_square_of_the_table_is_the_square_by_hand(paper: hs.Scenario) -> None:
    scene = scene_of(paper)
    in_plane = placements(scene)[3]
    f, d, a = scene.camera.focal_pixels, 0.5, 240 / np.sqrt(2)
    assert in_plane.pose_sigma[0] == pytest.approx(d * np.sqrt((f**2 + a**2) ** 2 + a**4) / (2 * f * a**2), rel=1e-9)
    again = place(scene, "again", in_plane.features, in_plane.depth, d)
    assert again.worst == in_plane.worst


@pytest.mark.parametrize("name", ["paper", "pi-h824", "eye-to-hand", "reachy-mini", "off centre"])
def test_the_placement_that_is_printed_can_be_typed_into_the_scenario(name: str) -> None:
    """Its keys as they stand: pixels of the camera, in the image, with the observability of the table."""
    if name == "off centre":
        camera = hs.camera_from_opencv(np.array([[905.5, 0, 480.0], [0, 903.0, 400.0], [0, 0, 1]]), None, (1280, 1024))
        goal = {"desired_pose": [4e-3, -3e-3, 2e-3, -0.01, -0.015, 0.02], "desired_features": None}
        scenario = hs.load_scenario("pi-h824").updated({"camera": camera, "target": goal})
    else:
        scenario = hs.load_scenario(name)
    analysis = hs.analyse(scenario, ["conditioning"])
    (section,) = analysis.sections()
    (table,) = (each for each in section.items if each.title == "Other placements of the points, from home")
    assert isinstance(table, Table)
    typed = {key: json.loads(values) for key, values in re.findall(r"target\.(\w+): (\[[^]]*\])", table.note)}
    assert list(typed) == ["initial_features", "depth"]
    none = dict.fromkeys(("points", "tag", "grid", "desired_pose"))
    moved = scenario.updated({"target": {**none, **typed, "desired_features": typed["initial_features"]}})
    np.testing.assert_allclose(hs.project(moved, np.zeros(6)).ravel(), typed["initial_features"], atol=1e-6)
    assert not points_outside(moved, scene_of(moved).view(scene_of(moved).home).features).any()
    found, best = conditioning.analyse(moved).start.pose_sigma, analysis.conditioning.placements[-1].pose_sigma
    np.testing.assert_allclose(found, best, rtol=0.02)  # whole pixels; the runs start at home
    circle = image_radius(scene_of(scenario))
    assert any(f"Within {circle:.0f} px of the principal point and" in each for each in section.sentences)
    data = analysis.to_dict()["conditioning"]["placements"][-1]["pixels"]
    np.testing.assert_allclose(data, typed["initial_features"], atol=0.5)


def test_features_stay_in_the_picture(paper: hs.Scenario) -> None:
    assert image_radius(scene_of(paper)) == pytest.approx(240, rel=1e-12)
    twice = {key: 2 * np.array(getattr(paper.target, key)) for key in ("initial_features", "desired_features")}
    finer = {"camera.pixel_scale": 2 * paper.camera.pixel_scale, **{f"target.{key}": twice[key] for key in twice}}
    assert image_radius(scene_of(paper.updated(finer))) == pytest.approx(480, rel=1e-12)
    small = paper.updated({"simulation.mode": "sampled", "camera.image_size": [640, 400]})
    scene = scene_of(small)
    assert image_radius(scene) == pytest.approx(0.95 * 200)
    assert np.hypot(*placements(scene)[-1].features.reshape(4, 2).T).max() <= 0.95 * 200 * (1 + 1e-9)


# ---- words ----------------------------------------------------------------------------------------------------------


def test_motions_in_words() -> None:
    jacobian = scene_of(square(100.0, 0.5)).view(scene_of(square(100.0, 0.5)).home).jacobian
    f, d = scene_of(square(100.0, 0.5)).camera.focal_pixels, 0.5
    shift = np.array([1.0, 0, 0, 0, 0, 0])
    about_y = np.array([0, 0, 0, 0, 1.0, 0])
    undone = np.linalg.lstsq(jacobian @ about_y[:, None], -jacobian @ shift, rcond=None)[0][0]
    assert abs(undone) == pytest.approx(1 / d, rel=0.05)
    assert f > 500
    assert motion_in_words(jacobian, shift) == "a translation along x"
    assert motion_in_words(jacobian, about_y) == "a rotation about y"
    assert (
        motion_in_words(jacobian, shift + undone * about_y)
        == "a translation along x barely distinguishable from a rotation about y"
    )
    assert motion_in_words(jacobian, shift - undone * about_y) == "a translation along x with a rotation about y"
    assert along(np.array([0, 2.0, 0.1])) == "y"
    assert along(np.array([1.0, 1.0, 0])) == "(0.71, 0.71, 0.00)"
    assert numbers(np.array([0.01234, 28799.0])) == "0.0123 and 28800"


def test_the_data_are_the_numbers_of_the_findings(paper: hs.Scenario) -> None:
    analysis = hs.analyse(paper, ["conditioning"])
    data = analysis.to_dict()["conditioning"]
    assert data["start"]["condition"] == analysis.conditioning.start.condition
    assert data["goal_reachable"] is True
    assert len(data["placements"]) == 6
    assert data["placements"][-1]["worst_per_px"] == analysis.conditioning.placements[-1].worst
    own, best = (1e3 * analysis.conditioning.placements[place].worst for place in (0, -1))
    (section,) = analysis.sections()
    (sentence,) = (each for each in section.sentences if "other placements of the points" in each)
    assert f"{number(own / best)} times better ({number(own)} mm per px originally, {number(best)} mm with" in sentence
    (table,) = (each for each in section.items if each.title == "Other placements of the points, from home")
    assert isinstance(table, Table)
    assert table.rows[-1][-2:] == pytest.approx((best, own / best))


def test_curves_of_placements_are_of_home_whatever_the_start(paper: hs.Scenario) -> None:
    """Placements are judged from home: another start moves none of their curves."""
    away = paper.updated({"simulation.start.pose": [0.004, -0.003, 0.01, 0.05, 0.02, 0.3]})
    curves = []
    for scenario in (paper, away):
        (section,) = hs.analyse(scenario, ["conditioning"]).sections()
        (found,) = (item for item in section.items if isinstance(item, Curves) and "placements" in item.title)
        curves.append(found)
    for one, other in zip(curves[0].lines, curves[1].lines, strict=True):
        np.testing.assert_allclose(one.x, other.x, rtol=1e-9)
        np.testing.assert_allclose(one.y, other.y, rtol=1e-9)
