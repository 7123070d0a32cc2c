"""Poses, displacements and derivatives by them, and the search for the goal pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo.findings.analysis.goal import SHOWN, find_goals
from hexservo.findings.analysis.poses import Poses, by_displacement, without_sign
from hexservo.findings.analysis.scene import WIDER, Scene, scene_of
from hexservo.scenario.arrays import Array

SEED = 20


def drawn(count: int) -> Poses:
    """Draw poses with attitudes all over."""
    random = np.random.default_rng(SEED)
    quaternion = random.normal(size=(count, 4))
    return Poses(random.normal(size=(count, 3)), quaternion / np.linalg.norm(quaternion, axis=1)[:, None])


def rotation(poses: Poses) -> Rotation:
    """Give the attitudes to another library."""
    return Rotation.from_quat(np.roll(poses.quaternion, -1, axis=-1))


@given(size=st.floats(0.0, 3.1))
def test_a_displacement_takes_one_pose_to_the_other_and_is_found_again(size: float) -> None:
    random = np.random.default_rng(SEED)
    turns = random.normal(size=(40, 3))
    turns *= size / np.linalg.norm(turns, axis=1)[:, None]
    moves = np.hstack([random.normal(size=(40, 3)), turns])
    start = drawn(40)
    end = start.moved(moves)
    expected = Rotation.from_rotvec(turns) * rotation(start)
    np.testing.assert_allclose(rotation(end).as_matrix(), expected.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(end.quaternion, axis=1), 1.0, rtol=1e-15)
    # beyond a right angle rounding of the quaternion grows up to 1/cos(1.55) in the angle
    np.testing.assert_allclose(end.displacement_from(start), moves, atol=1e-12)
    same = Poses(end.position, -end.quaternion)  # the same attitudes
    np.testing.assert_allclose(same.displacement_from(start), moves, atol=1e-12)


def test_one_pose_and_many_are_moved_alike() -> None:
    poses, moves = drawn(12), np.random.default_rng(SEED).normal(size=(12, 6))
    grid = Poses(poses.position.reshape(3, 4, 3), poses.quaternion.reshape(3, 4, 4)).moved(moves.reshape(3, 4, 6))
    assert grid.shape == (3, 4)
    for row in range(12):
        one = poses[row].moved(moves[row])
        assert one.shape == ()
        np.testing.assert_array_equal(one.position, grid.rows.position[row])
        np.testing.assert_allclose(one.quaternion, grid.rows.quaternion[row], rtol=1e-15, atol=1e-16)
    fan = poses[0].moved(moves)  # one pose, many displacements
    np.testing.assert_array_equal(fan.position[5], poses[0].moved(moves[5]).position)


def test_derivatives_by_a_displacement_are_those_of_the_image() -> None:
    scene = scene_of(hs.load_scenario("task-general"))
    poses = scene.home.moved(0.05 * np.random.default_rng(SEED).uniform(-1, 1, (2, 3, 6)) * scene.unit)
    features, depth = scene.image(poses)
    found = by_displacement(lambda there: scene.image(there)[0], poses, 1e-5 * scene.unit)
    exact = scene.jacobian(features, depth, poses)
    assert found.shape == exact.shape == (2, 3, 8, 6)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7 * np.abs(exact).max())


def test_a_direction_and_its_opposite_are_written_alike() -> None:
    ways = np.random.default_rng(SEED).normal(size=(50, 6))
    np.testing.assert_array_equal(without_sign(ways), without_sign(-ways))
    np.testing.assert_array_equal(np.abs(without_sign(ways)), np.abs(ways))
    # of two that differ by rounding alone the first decides
    tie = np.array([0.0, -1.0, 0.0, 1.0 + 1e-15, 0.0, 0.0])
    np.testing.assert_array_equal(without_sign(tie), -tie)


@pytest.mark.parametrize("seed", range(6))
def test_a_goal_that_was_seen_from_a_pose_is_found_there(seed: int) -> None:
    """Four points in general position, poses all over the region that is searched."""
    scenario = hs.load_scenario("textbook-general")
    random = np.random.default_rng(seed)
    start = Scene(scenario)
    points = start.points + random.uniform(-0.2, 0.2, (4, 3)) * start.depth
    scene = Scene(scenario.updated({"target.initial_features": None, "target.depth": None, "target.points": points}))
    move: Array = 0.9 * random.uniform(-1, 1, 6) * WIDER * scene.unit
    while not np.isfinite(scene.image(scene.home.moved(move))[0]).all():
        move = 0.9 * random.uniform(-1, 1, 6) * WIDER * scene.unit
    features, _ = scene.image(scene.home.moved(move))
    goals = find_goals(Scene(scene.scenario.updated({"target.desired_features": features})))
    assert goals is not None
    assert goals.reachable
    assert goals.shown_at is not None
    assert goals.best.largest_residual < SHOWN
    assert np.linalg.norm(goals.best.displacement / scene.unit) <= np.linalg.norm(move / scene.unit) + 1e-6
