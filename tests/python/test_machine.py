"""Machines other than the presets: joints anywhere, home turned, gravity tilted, a start and a goal given as poses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]

SEED = 20261122
# A law without preferred directions: the loop is the same in any frame.
ISOTROPIC = {
    "controller.law": "kelly",
    "controller.kelly.kd": [1.2] * 3 + [0.02] * 3,
    "simulation.duration": 1.0,
}
POINTS = [[0.03, 0.02, -0.7], [0.06, -0.06, -0.62], [-0.04, 0.03, -0.66], [-0.01, -0.02, -0.64]]
NO_IMAGE = {"initial_features": None, "depth": None}  # for points in their place
GOAL = [0.004, -0.003, 0.005, 0.02, -0.03, 0.04]  # [m; rad]


@pytest.fixture(scope="module")
def paper() -> hs.Scenario:
    return hs.load_scenario("paper")


def matrix(quaternion: Array) -> Array:
    return np.asarray(Rotation.from_quat(quaternion[..., [1, 2, 3, 0]]).as_matrix())


def joints(scenario: hs.Scenario) -> tuple[Array, Array]:
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    return np.array(hexapod.platform_joints), np.array(hexapod.base_joints)


def test_joints_on_circles_may_be_given_one_by_one(paper: hs.Scenario) -> None:
    platform, base = joints(paper)
    same = paper.updated({"robot.platform_joints": platform, "robot.base_joints": base})
    assert (same.robot.platform_radius, same.robot.base_angles) == (None, None)
    one, other = hs.simulate(paper), hs.simulate(same)
    for name in ("feature_error", "position", "wrench", "leg_forces"):
        # r_p is the joints' RMS distance from their mean, the radius up to rounding.
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=1e-9)


def test_a_turned_world_has_the_same_run() -> None:
    """Everything in B turned alike: joints, home, gravity, points. The image cannot tell, and the pose turns along."""
    print("seed", SEED)
    random = np.random.default_rng(SEED)
    turn = Rotation.from_rotvec(random.uniform(-1.0, 1.0, 3))
    level = hs.load_scenario("paper").updated(
        {
            **ISOTROPIC,
            "target": {**NO_IMAGE, "points": POINTS},
            "uncertainty.inertia": 0.0,  # entry by entry in B, so not the same in every frame
            "uncertainty.coriolis": 0.0,
            "robot.home_attitude": [0.05, -0.1, 0.2],
            "robot.inertia": [[1.5e-4, 1e-5, 0], [1e-5, 1.2e-4, -2e-5], [0, -2e-5, 2e-4]],
        }
    )
    platform, base = joints(level)
    turned = level.updated(
        {
            "robot.platform_joints": platform,
            "robot.base_joints": turn.apply(base),
            "robot.home_position": turn.apply(level.robot.home_position),
            "robot.home_attitude": (turn * Rotation.from_rotvec(level.robot.home_attitude)).as_rotvec(),
            "robot.gravity": turn.apply(level.robot.gravity),
            "target.points": turn.apply(POINTS),
        }
    )
    one, other = hs.simulate(level), hs.simulate(turned)
    assert one.outcome == other.outcome == "completed"
    moved = np.abs(one.position - one.position[0]).max()
    assert moved > 1e-3
    # some thousand steps of rounding errors of 1e-16, on a loop that forgets them
    np.testing.assert_allclose(other.feature_error, one.feature_error, rtol=0, atol=1e-8)
    np.testing.assert_allclose(other.position, turn.apply(one.position), rtol=0, atol=1e-11)
    np.testing.assert_allclose(matrix(other.quaternion), turn.as_matrix() @ matrix(one.quaternion), rtol=0, atol=1e-10)
    np.testing.assert_allclose(other.leg_forces, one.leg_forces, rtol=0, atol=1e-10)
    np.testing.assert_allclose(other.wrench[:, :3], turn.apply(one.wrench[:, :3]), rtol=0, atol=1e-10)


def test_legs_of_joints_anywhere() -> None:
    """Lengths by their definition, and H by finite differences of them."""
    random = np.random.default_rng(SEED)
    robot = _core.robot_preset("micro")
    robot.platform_joints = np.array(_core.Hexapod(robot).platform_joints) + random.uniform(-0.03, 0.03, (6, 3))
    robot.base_joints = np.array(_core.Hexapod(robot).base_joints) + random.uniform(-0.05, 0.05, (6, 3))
    hexapod = _core.Hexapod(robot)
    platform = np.array(robot.platform_joints)
    spread = platform - platform.mean(axis=0)
    assert hexapod.platform_radius == pytest.approx(np.sqrt((spread**2).sum() / 6), rel=1e-15)
    for _ in range(20):
        position, turn = robot.home_position + random.uniform(-0.03, 0.03, 3), random.uniform(-0.3, 0.3, 3)

        def lengths(displacement: Array, position: Array = position, turn: Array = turn) -> Array:
            attitude = Rotation.from_rotvec(displacement[3:]) * Rotation.from_rotvec(turn)
            ends = position + displacement[:3] + attitude.apply(platform)
            return np.asarray(np.linalg.norm(ends - robot.base_joints, axis=1))

        quaternion = Rotation.from_rotvec(turn).as_quat()[[3, 0, 1, 2]]
        np.testing.assert_allclose(hexapod.leg_lengths(position, quaternion), lengths(np.zeros(6)), rtol=1e-15, atol=0)
        h = 1e-4  # differences of the fourth order: error h^4, rounding 1e-16/h
        rates = np.stack(
            [
                (8 * (lengths(h * e) - lengths(-h * e)) - (lengths(2 * h * e) - lengths(-2 * h * e))) / (12 * h)
                for e in np.eye(6)
            ]
        )
        np.testing.assert_allclose(hexapod.wrench_map(position, quaternion), rates, rtol=0, atol=1e-10)


@pytest.mark.parametrize("law", ["hybrid", "kelly", "resolved_rate"])
def test_a_start_is_a_home_elsewhere(paper: hs.Scenario, law: str) -> None:
    """These laws do not ask where home is: a run from a displaced start is one of a machine at home there."""
    changes = {
        "controller.law": law,
        "simulation.duration": 0.2,
        "target": {**NO_IMAGE, "points": POINTS},
        "uncertainty.depth": 0.0,
        "robot.stroke": 0.1,
    }
    start = np.array([0.002, -0.003, 0.004, 0.03, -0.02, 0.05])
    displaced = paper.updated({**changes, "simulation.start.pose": start})
    elsewhere = paper.updated(
        {
            **changes,
            "robot.home_position": np.array(paper.robot.home_position) + start[:3],
            "robot.home_attitude": start[3:],
        }
    )
    one, other = hs.simulate(displaced), hs.simulate(elsewhere)
    np.testing.assert_array_equal(one.feature_error, other.feature_error)
    np.testing.assert_array_equal(one.position, other.position)
    travel = np.abs(one.leg_lengths - _core.Hexapod(core_parameters(paper).robot).home_lengths).max()
    assert hs.metrics(one)["peak_leg_excursion"] == pytest.approx(travel)  # counted from home


@pytest.mark.parametrize("mode", ["continuous", "sampled"])
def test_a_start_in_motion(paper: hs.Scenario, mode: str) -> None:
    twist = np.array([0.02, -0.01, 0.03, 0.2, -0.1, 0.3])
    run = hs.simulate(paper.updated({"simulation.mode": mode, "simulation.start.twist": twist}))
    np.testing.assert_array_equal(run.twist[0], twist)
    h = paper.simulation.step
    acceleration = np.abs(np.diff(run.twist[:2], axis=0)).max() / h
    np.testing.assert_allclose(run.position[1] - run.position[0], h * twist[:3], rtol=0, atol=acceleration * h * h)


def test_starts_of_a_batch_are_those_of_single_runs(paper: hs.Scenario) -> None:
    scenario = paper.updated({"controller.law": "kelly", "simulation.duration": 0.2, "simulation.log_every": 50})
    starts = np.random.default_rng(SEED).uniform(-3e-3, 3e-3, (5, 6))
    batch = hs.simulate_batch(scenario, {"simulation.start.pose": starts}, log="trajectory")
    for k, start in enumerate(starts):
        one = hs.simulate(scenario.updated({"simulation.start.pose": start}))
        np.testing.assert_allclose(batch.samples["feature_error"][k], one.feature_error, rtol=0, atol=1e-9)


def test_a_goal_pose_is_reached(paper: hs.Scenario) -> None:
    """Its image is the goal, and without model errors the law takes the platform there."""
    scenario = paper.updated(
        {
            "controller.law": "pbvs",
            "target": {
                "initial_features": None,
                "depth": None,
                "points": POINTS,
                "desired_features": None,
                "desired_pose": GOAL,
            },
            "uncertainty": {"depth": 0.0, "inertia": 0.0, "coriolis": 0.0},
            "robot.home_attitude": [0.1, 0.05, -0.2],
        }
    )
    assert scenario.target.desired_pose is None  # read into the features
    np.testing.assert_allclose(hs.project(scenario, GOAL), scenario.target.desired_features, rtol=0, atol=1e-11)
    end = hs.simulate(scenario)
    home = Rotation.from_rotvec(scenario.robot.home_attitude)
    np.testing.assert_allclose(end.position[-1] - scenario.robot.home_position, GOAL[:3], rtol=0, atol=1e-7)
    turn = Rotation.from_matrix(matrix(end.quaternion[-1])) * home.inv()
    np.testing.assert_allclose(turn.as_rotvec(), GOAL[3:], rtol=0, atol=1e-6)
    assert hs.Scenario.from_yaml(scenario.to_yaml()) == scenario


def test_projection_by_its_definition(paper: hs.Scenario) -> None:
    scenario = paper.updated(
        {
            "target": {**NO_IMAGE, "points": POINTS},
            "robot.home_attitude": [0.1, 0.05, -0.2],
        }
    )
    poses = np.random.default_rng(SEED).uniform(-0.05, 0.05, (7, 6))
    features = hs.project(scenario, poses)
    assert features.shape == (7, 8)
    for pose, seen in zip(poses, features, strict=True):
        attitude = Rotation.from_rotvec(pose[3:]) * Rotation.from_rotvec(scenario.robot.home_attitude)
        x, y, z = attitude.inv().apply(np.array(POINTS) - scenario.robot.home_position - pose[:3]).T
        f = scenario.camera.focal_length * scenario.camera.pixel_scale
        np.testing.assert_allclose(seen, np.column_stack([-f * x / z, -f * y / z]).ravel(), rtol=0, atol=1e-10)
    assert np.isnan(hs.project(scenario, [0, 0, -1.0, 0, 0, 0])).all()  # beyond the target


def test_a_point_behind_the_camera_alone_has_no_image(paper: hs.Scenario) -> None:
    """Turned by about a right angle, the camera has three of the points before it, then two, one and none."""
    scenario = paper.updated({"target": {**NO_IMAGE, "points": POINTS}})
    for angle in (1.4, 1.5, 1.55, 1.62, 1.7):
        turn = Rotation.from_rotvec([angle, 0.0, 0.0])
        x, y, z = turn.inv().apply(np.array(POINTS) - scenario.robot.home_position).T
        f = scenario.camera.focal_length * scenario.camera.pixel_scale
        expected = np.where(z < 0, [-f * x / z, -f * y / z], np.nan).T
        np.testing.assert_allclose(hs.project(scenario, [0, 0, 0, angle, 0, 0]), expected.ravel(), rtol=1e-9)


def test_a_tag_is_its_corners(paper: hs.Scenario) -> None:
    tag: dict[str, Any] = {"size": 0.08, "pose": [0.01, 0.02, -0.65, 0.1, 0.2, 0.3]}
    scenario = paper.updated({"target": {**NO_IMAGE, "tag": tag}})
    square = 0.04 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    expected = np.array(tag["pose"][:3]) + Rotation.from_rotvec(tag["pose"][3:]).apply(square)
    np.testing.assert_allclose(np.array(scenario.target.points), expected, rtol=0, atol=1e-16)
    assert scenario.target.tag is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot.platform_joints": np.zeros((6, 3))}, "robot.platform_joints: expected joints at different places"),
        (
            {"robot.platform_joints": np.ones((5, 3))},
            "robot.platform_joints: expected 6x3 numbers > -1e+06 and < 1e+06",
        ),
        ({"robot.base_joints": np.ones((6, 3)), "robot.base_radius": 0.2}, "robot.base_radius: expected null beside"),
        ({"robot.home_attitude": [0, 0, 90]}, "robot.home_attitude[2]: expected a number within +-2 pi"),
        (
            {"simulation.start.pose": [0, 0, 0, 0, 0, 6.3]},
            "simulation.start.pose: expected a rotation vector at most pi long (radians), got one of 6.3 (degrees?",
        ),
        ({"simulation.start.pose": [0, 0, 0, 4.0, -4.0, 4.0]}, "simulation.start.pose: expected a rotation vector"),
        (
            {"target.desired_features": None, "target.desired_pose": [0.004, 0, 0, 0, 0, 90]},
            "target.desired_pose: expected a rotation vector at most pi long (radians), got one of 90 (degrees?",
        ),
        (
            {"target": {**NO_IMAGE, "tag": {"size": 0.1, "pose": [0, 0, -0.65, 0, 0, 90]}}},
            "target.tag.pose: expected a rotation vector at most pi long (radians), got one of 90 (degrees?",
        ),
        (
            {"target": {**NO_IMAGE, "tag": {"size": 0.1, "pose": [0, 0, -0.65, 0, 0, "a"]}}},
            'target.tag.pose[5]: expected a finite number, got "a"',
        ),
        (
            {"target": {**NO_IMAGE, "grid": {"rows": 2, "columns": 2, "spacing": 0.05, "pose": [0, 0, 0, 0, 0, -45]}}},
            "target.grid.pose: expected a rotation vector at most pi long (radians), got one of 45 (degrees?",
        ),
        ({"robot.gravity": -9.8}, "robot.gravity: expected a number >= 0"),
        ({"simulation.start.pose": [0, 0, -0.6, 0, 0, 0]}, "simulation.start.pose: expected a pose from which every"),
        ({"simulation.start.pose": [0.3, 0, 0, 0, 0, 0]}, ""),
        ({"simulation.start.twist": [0, 0, 0, 0, 0, 1e4]}, "simulation.start.twist: expected numbers within 1000"),
        (
            {"camera.convention": "as_printed", "simulation.start.pose": [1e-3] * 6},
            "simulation.start.pose: expected zeros",
        ),
        ({"target.desired_pose": GOAL}, "target.desired_pose: expected null beside desired_features"),
        ({"target.desired_features": None}, "target: expected either desired_features"),
        (
            {"target": {"desired_features": None, "desired_pose": [0, 0, -1, 0, 0, 0]}},
            "target.desired_pose: expected a pose from which every point is in front",
        ),
        (
            {
                "target": {
                    "initial_features": None,
                    "depth": None,
                    "tag": {"size": 0.1, "pose": [0, 0, -0.6, 3.1, 0, 0]},
                }
            },
            "target.tag.pose: expected a tag whose front",
        ),
        (
            {"target": {**NO_IMAGE, "tag": {"size": 0.1}}},
            "target.tag: expected size (a number > 0, m) and pose",
        ),
    ],
)
def test_refusals(paper: hs.Scenario, changes: dict[str, Any], message: str) -> None:
    if not message:  # a start far off is allowed: the legs' limits are reported, not enforced
        paper.updated(changes)
        return
    with pytest.raises(hs.ScenarioError) as caught:
        paper.updated(changes)
    assert str(caught.value).startswith(message), caught.value


def test_a_radius_beside_joints_does_not_vary(paper: hs.Scenario) -> None:
    placed = paper.updated({"robot.platform_joints": joints(paper)[0]})
    with pytest.raises(ValueError, match=r"robot.platform_radius"):
        hs.simulate_batch(placed, {"robot.platform_radius": [0.1, 0.11]})


def test_the_nearest_reachable_pose_by_brute_force(paper: hs.Scenario) -> None:
    """No pose within reach among many around the nearest one is nearer; and it is within reach, at the stroke's end."""
    print("seed", SEED)
    random = np.random.default_rng(SEED)
    radius, stroke = paper.robot.platform_radius, paper.robot.stroke
    assert radius is not None
    metric = np.repeat([1.0, radius], 3)
    hexapod = _core.Hexapod(core_parameters(paper).robot)

    def travel(pose: Array) -> float:
        position = np.array(paper.robot.home_position) + pose[:3]
        quaternion = Rotation.from_rotvec(pose[3:]).as_quat()[[3, 0, 1, 2]]
        return float(np.abs(hexapod.leg_lengths(position, quaternion) - hexapod.home_lengths).max())

    def distance(one: Array, other: Array) -> float:
        turn = Rotation.from_rotvec(one[3:]) * Rotation.from_rotvec(other[3:]).inv()
        return float(np.linalg.norm(metric * np.concatenate([one[:3] - other[:3], turn.as_rotvec()])))

    for _ in range(6):
        wanted = random.normal(size=6) * np.repeat([0.03, 0.3], 3)
        found = hs.reachable(paper, wanted)
        assert found.margin == pytest.approx(stroke - travel(wanted), abs=1e-15)
        if found.within:
            assert travel(wanted) <= stroke
            continue
        assert "out of reach" in str(found)
        assert travel(found.nearest) <= stroke * (1 + 1e-9)  # which counts as at its end
        assert travel(found.nearest) >= stroke * (1 - 1e-4)
        assert found.distance == pytest.approx(distance(wanted, found.nearest), rel=1e-9)
        # Poses nearer than that by 0.1 %: towards what was asked for, and in all directions about it.
        for size in (0.02, 0.2, 1.0):
            for _ in range(300):
                ball = random.normal(size=6)
                ball *= 0.999 * found.distance * random.uniform() ** (1 / 6) / np.linalg.norm(ball)
                near = found.nearest + size * (wanted + ball / metric - found.nearest)
                if distance(wanted, near) < 0.999 * found.distance:
                    assert travel(near) > stroke


def test_a_tag_is_before_the_camera_and_not_before_the_platform(paper: hs.Scenario) -> None:
    """A camera beside the platform that looks along x: which side of a tag it has before it."""
    mount = {"position": [0.0, 0.0, 0.0], "rotation": [0.0, -np.pi / 2, 0.0]}
    looks = -Rotation.from_rotvec(mount["rotation"]).as_matrix()[:, 2]
    centre = np.array(paper.robot.home_position) + 0.5 * looks

    def with_tag(turn: float) -> hs.Scenario:
        tag = {"size": 0.08, "pose": [*centre, 0.0, turn, 0.0]}
        target = {**NO_IMAGE, "tag": tag, "desired_features": None, "desired_pose": GOAL}
        return paper.updated({"camera.mount": mount, "target": target})

    facing, turned = (np.pi / 2, -np.pi / 2) if looks[0] < 0 else (-np.pi / 2, np.pi / 2)
    assert with_tag(facing).target.points is not None
    with pytest.raises(hs.ScenarioError, match=r"target.tag.pose: expected a tag whose front"):
        with_tag(turned)


def test_a_stroke_that_ends_at_home_reaches_home(paper: hs.Scenario) -> None:
    retracted = paper.updated({"robot.stroke": [0.0, 0.02]})
    assert hs.reachable(retracted, np.zeros(6)).within
    assert not hs.reachable(retracted, [0.0, 0.0, 1e-4, 0.0, 0.0, 0.0]).within  # down: shorter legs


def test_poses_of_the_wrong_shape_are_refused(paper: hs.Scenario) -> None:
    for function in (hs.project, hs.reachable):
        with pytest.raises(ValueError, match=r"^pose: expected .*6"):
            function(paper, [1.0, 2.0])
        with pytest.raises(ValueError, match="not finite"):
            function(paper, [np.nan] * 6)
        for wrong in ("abcdef", ["0."] * 6, np.full(6, 1e-3j), [[1], [2, 3]], None):
            with pytest.raises(ValueError, match=r"^pose: expected .*6.* finite numbers within 1e\+06 .*, got "):
                function(paper, wrong)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match=r"^pose: expected .*, got 1e\+308$"):
            function(paper, [1e308] * 6)
        with pytest.raises(ValueError, match=r"^pose: expected a rotation vector at most pi long .* one of 90 \(deg"):
            function(paper, [0.0] * 5 + [90.0])


def test_half_a_turn_is_a_pose_and_more_is_none(paper: hs.Scenario) -> None:
    """As people round it; of 3.6 degrees written as 3.6 rad the rotation would be -2.68 rad about the same axis."""
    axis = np.array([0.0, 0.0, 1.0])  # the optical one
    for length, within in ((np.pi, True), (3.1416, True), (3.142, True), (3.16, False), (3.6, False), (6.16, False)):
        change = {"simulation.start.pose": [0.0] * 3 + (length * axis).tolist()}
        if within:
            paper.updated(change)
        else:
            with pytest.raises(hs.ScenarioError, match="at most pi long"):
                paper.updated(change)


def test_no_poses_have_no_images(paper: hs.Scenario) -> None:
    assert hs.project(paper, np.zeros((0, 6))).shape == (0, 8)
    assert hs.project(paper, np.zeros((2, 0, 6))).shape == (2, 0, 8)
    assert hs.project(paper, np.zeros((2, 3, 6))).shape == (2, 3, 8)


def test_an_answer_stays_when_the_array_that_was_asked_changes(paper: hs.Scenario) -> None:
    for size in (1e-4, 1.0):  # within reach, and not
        asked = np.full(6, size)
        found = hs.reachable(paper, asked)
        before = (found.pose.copy(), found.nearest.copy())
        asked[:] = 7.0
        np.testing.assert_array_equal([found.pose, found.nearest], before)
        assert not np.shares_memory(found.pose, found.nearest)


def test_travel_that_is_not_even_about_home(paper: hs.Scenario) -> None:
    uneven = paper.updated({"robot.stroke": [-0.004, 0.012]})
    assert uneven.robot.stroke == pytest.approx(0.008)
    assert uneven.robot.stroke_centre == pytest.approx(0.004)
    down, up = (hs.reachable(uneven, [0, 0, z, 0, 0, 0]) for z in (0.006, -0.006))
    # z points down: lower legs are shorter, by about 0.15/0.2046 of the way
    assert not down.within
    assert up.within
    hexapod = _core.Hexapod(core_parameters(uneven).robot)
    lower = np.add(paper.robot.home_position, [0, 0, 0.006])
    travel = hexapod.leg_lengths(lower, hexapod.home_quaternion) - hexapod.home_lengths
    assert down.margin == pytest.approx(0.004 - np.abs(travel).max(), abs=1e-12)
    even = hs.simulate(paper)
    one, other = hs.metrics(even), hs.metrics(hs.simulate(uneven))
    assert one["settling_time"] == other["settling_time"]  # limits are reported
    far = np.abs(even.leg_lengths - hexapod.home_lengths - 0.004).max()
    assert other["peak_leg_excursion"] == pytest.approx(far, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot.stroke": [0.01, 0.02]}, "robot.stroke: expected [shortest, longest] travel with home between them"),
        ({"robot.stroke": [-0.01, 0.02], "robot.stroke_centre": 0.01}, "robot.stroke_centre: expected null beside"),
        ({"robot.stroke_centre": 0.03}, "robot.stroke_centre: expected a middle of the travel within the stroke"),
    ],
)
def test_refusals_of_travel(paper: hs.Scenario, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(hs.ScenarioError) as caught:
        paper.updated(changes)
    assert str(caught.value).startswith(message), caught.value
