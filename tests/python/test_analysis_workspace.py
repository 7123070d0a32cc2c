"""Reach, singularities and loads of the legs: closed forms of vertical motion and of rotation about z, and limits."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import workspace
from hexservo.findings.analysis.reach import reach_of_start_and_goal
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.analysis.words import number
from hexservo.findings.evidence import HeatMap, Table
from hexservo.findings.wording import cell_text
from hexservo.scenario.parameters import core_parameters

SEED = 21


@pytest.fixture(scope="module")
def found(paper: hs.Scenario) -> workspace.Workspace:
    return workspace.analyse(paper)


@pytest.mark.parametrize("preset", ["micro", "cubic"])
def test_vertical_reach_by_hand(paper: hs.Scenario, preset: str) -> None:
    """All legs are sqrt(rho^2 + z^2) long: z = sqrt((l_0 +- stroke)^2 - rho^2), rho between the joints of a leg."""
    scenario = paper.updated({"robot.preset": preset})
    robot = core_parameters(scenario).robot
    angle = robot.platform_angles[0] - robot.base_angles[0]
    across = robot.platform_radius**2 + robot.base_radius**2
    rho2 = across - 2 * robot.platform_radius * robot.base_radius * np.cos(angle)
    height = abs(robot.home_position[2])
    length = np.sqrt(rho2 + height**2)
    scene = scene_of(scenario)
    down = workspace.reach(scene, np.array([0, 0, 1.0, 0, 0, 0]))  # z points down
    up = workspace.reach(scene, np.array([0, 0, -1.0, 0, 0, 0]))
    assert down.distance == pytest.approx(height - np.sqrt((length - robot.stroke) ** 2 - rho2), rel=1e-7)
    assert up.distance == pytest.approx(np.sqrt((length + robot.stroke) ** 2 - rho2) - height, rel=1e-7)


@pytest.mark.parametrize(("stroke", "text"), [(2e-5, "0.0200"), (1.7e-2, "17.00")])
def test_leg_travels_have_three_digits_of_the_stroke(paper: hs.Scenario, stroke: float, text: str) -> None:
    at_home = {"simulation.start.pose": [0.0] * 6, "robot.stroke": stroke}
    table = workspace.analyse(paper.updated(at_home)).section().items[0]
    assert isinstance(table, Table)
    place = [column.title for column in table.columns].index("stroke left")
    assert cell_text(table.rows[0][place], table.columns[place]) == text


@pytest.mark.parametrize(("beyond", "within"), [(-1e-6, True), (0.0, True), (5e-10, True), (2e-9, False)])
def test_a_leg_beyond_its_stroke_by_rounding_is_at_its_end(paper: hs.Scenario, beyond: float, within: bool) -> None:
    shift = np.array([0.004, 0.0, 0.0, 0.0, 0.0, 0.0])
    scene = scene_of(paper)
    travel = np.abs(scene.leg_travel(scene.home.moved(shift))).max()
    start = {"robot.stroke": travel / (1.0 + beyond), "simulation.start.pose": shift.tolist()}
    margin = reach_of_start_and_goal(paper.updated(start)).start
    assert margin.within == within
    assert margin.margin == pytest.approx(0.0 if within and beyond > 0 else -beyond * travel, rel=1e-4, abs=1e-14)


@pytest.mark.parametrize("preset", ["micro", "cubic"])
def test_turn_about_z_by_hand(paper: hs.Scenario, preset: str) -> None:
    """l_i^2 = r_p^2 + r_b^2 - 2 r_p r_b cos(phi_i + turn - beta_i) + z^2; the first leg at l_0 +- stroke ends it."""
    scenario = paper.updated({"robot.preset": preset})
    robot = core_parameters(scenario).robot
    p, b, z = robot.platform_radius, robot.base_radius, robot.home_position[2]
    between = np.array(robot.platform_angles) - np.array(robot.base_angles)
    home = np.sqrt(p**2 + b**2 - 2 * p * b * np.cos(between) + z**2)
    ends = []
    for leg in range(6):
        for sign in (1, -1):
            cosine = (p**2 + b**2 + z**2 - (home[leg] + sign * robot.stroke) ** 2) / (2 * p * b)
            if abs(cosine) <= 1:
                for solution in (np.arccos(cosine), -np.arccos(cosine)):
                    turn = (solution - between[leg] + np.pi) % (2 * np.pi) - np.pi
                    ends.append(turn)
    scene = scene_of(scenario)
    ahead = workspace.reach(scene, np.array([0, 0, 0, 0, 0, 1.0]))
    back = workspace.reach(scene, np.array([0, 0, 0, 0, 0, -1.0]))
    assert ahead.distance == pytest.approx(min(turn for turn in ends if turn > 0), rel=1e-7)
    assert back.distance == pytest.approx(-max(turn for turn in ends if turn < 0), rel=1e-7)


def test_reach_ends_at_the_first_limit_in_every_direction(paper: hs.Scenario) -> None:
    """Random directions, in small steps: nothing beyond the stroke before the end, and a leg at it there."""
    scene = scene_of(paper)
    stroke = paper.robot.stroke
    random = np.random.default_rng(SEED)
    for _ in range(20):
        direction = random.normal(size=6) * np.repeat([1.0, 10.0], 3) * 10.0 ** random.uniform(-1, 1)
        end = workspace.reach(scene, direction)
        travel = [
            np.abs(scene.leg_travel(scene.home.moved(share * end.distance * direction))).max()
            for share in np.linspace(0, 1 - 1e-6, 300)
        ]
        assert max(travel) <= stroke
        at_end = np.abs(scene.leg_travel(scene.home.moved(end.distance * direction)))
        assert at_end.max() == pytest.approx(stroke, rel=1e-8)
        assert int(at_end.argmax()) + 1 == end.leg


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("preset", ["micro", "cubic"])
def test_legs_at_the_end_of_their_stroke_leave_it(paper: hs.Scenario, preset: str, sign: float) -> None:
    """Home is on the end stop: along z by hand, and along random directions what `hs.reachable` takes for within."""
    length = 0.25 * paper.robot.stroke
    scenario = paper.updated({"robot.preset": preset, "robot.stroke": sorted([0.0, sign * length])})
    scene = scene_of(scenario)
    height = abs(float(scene.home.position[2]))
    home = float(scene.hexapod.home_lengths[0])
    rho2 = home**2 - height**2
    away, back = (workspace.reach(scene, np.array([0.0, 0.0, s, 0, 0, 0])) for s in (-sign, sign))  # z points down
    assert away.distance == pytest.approx(abs(np.sqrt((home + sign * length) ** 2 - rho2) - height), rel=1e-7)
    assert (back.distance, back.limit) == (0.0, "stroke")

    random = np.random.default_rng(SEED)
    ways = random.normal(size=(100, 6)) * np.repeat([1.0, 3.0], 3)
    ways[:50, :3] += [0.0, 0.0, -4.0 * sign]  # most of these leave the end stop
    ends = workspace.reaches(scene, ways)
    assert 20 < sum(end.distance > 0.0 for end in ends) < 80
    for end in ends:
        beyond = end.distance * (1.0 + 1e-6) + 1e-7
        way = np.append(np.linspace(0.0, end.distance * (1.0 - 1e-6), 100), beyond)
        *within, after = scene.reachable(scene.home.moved(way[:, None] * end.direction))
        assert all(within)
        assert end.limit != "stroke" or not after


def test_the_reach_of_the_axes_follows_the_symmetry_of_the_legs(found: workspace.Workspace) -> None:
    """The joints of `micro` mirror about the x axis: +y is -y, and turns about x and z go as far both ways."""
    distance = [end.distance for end in found.axes]
    for ahead, back in ((2, 3), (6, 7), (10, 11)):
        assert distance[ahead] == pytest.approx(distance[back], rel=1e-7)
    assert found.least_shift.distance <= min(distance[:6]) * 1.05
    assert found.least_turn.distance <= min(distance[6:]) * 1.05


@pytest.mark.slow
def test_a_long_stroke_ends_at_singular_poses() -> None:
    """A turn by 90 deg about z makes the legs of two similar joint circles singular: Fichter's pose."""
    scenario = hs.load_scenario("textbook-general")
    found = workspace.analyse(scenario)
    scene = scene_of(scenario)
    assert [end.limit for end in found.axes[6:]] == ["singularity"] * 6
    assert found.axes[10].distance == pytest.approx(np.pi / 2, abs=1e-5)
    for end in (found.axes[4], *found.axes[6:]):
        assert end.leg == 0
        near, far = (scene.home.moved((end.distance + by) * end.direction).rows for by in (-1e-4, 1e-4))
        assert scene.reachable(near)[0]
        # det H changes its sign, or only touches zero, as where the platform meets the plane of the base
        turned = not scene.reachable(far)[0]
        at = scene.home.moved(end.distance * end.direction)
        assert turned or scene.hexapod.singular_values(at.position, at.quaternion)[-1] < 1e-5
    data = hs.analyse(scenario, ["workspace"]).to_dict()["workspace"]["reach"][-1]
    assert data == {
        "direction": [0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
        "distance": found.axes[11].distance,
        "leg": 0,
        "limit": "singularity",
    }


@pytest.mark.parametrize("name", ["paper", "rubin-camera-hexapod"])  # of the latter all joints are far from E's origin
def test_the_march_passes_no_limit_of_the_joints(name: str) -> None:
    """Random directions, in small steps of `hs.reachable`: within before the end, not just behind it."""
    scenario = hs.load_scenario(name)
    radius = float(scene_of(scenario).platform_radius)
    limit = 0.7 * scenario.robot.stroke / float(np.min(scene_of(scenario).hexapod.home_lengths))
    scenario = scenario.updated({"robot.joint_limit": [limit, 1.5 * limit]})
    scene, random, limits = scene_of(scenario), np.random.default_rng(SEED), set()
    for _ in range(20):
        direction = random.normal(size=6) * np.repeat([radius, 1.0], 3) * 10.0 ** random.uniform(-1, 1)
        end = workspace.reach(scene, direction)
        way = scene.home.moved(np.linspace(0.0, 1.0 - 1e-6, 300)[:, None] * end.distance * direction)
        assert scene.reachable(way).all()
        beyond = hs.reachable(scenario, end.distance * (1.0 + 1e-6) * direction)
        assert not beyond.within
        assert (beyond.limit, beyond.leg) == (end.limit, end.leg)
        limits.add(end.limit)
    assert limits - {"stroke"}


def test_joint_limits_count_in_verdict_sentences_and_map(paper: hs.Scenario) -> None:
    free = workspace.analyse(paper)
    assert free.goal is not None
    assert free.nearest is not None
    tilt = float(scene_of(paper).leg_tilts(free.nearest.pose)[0].max())  # at the base
    for share, verdict in ((20.0, "good"), (1.05, "warning"), (0.95, "bad")):
        scenario = paper.updated({"robot.joint_limit": [share * tilt, 3.0]})
        found = workspace.analyse(scenario)
        section = found.section()
        assert found.nearest is not None
        assert (
            found.nearest.reachable
            == hs.reachable(scenario, found.nearest.pose.displacement_from(scene_of(scenario).home)).within
        )
        assert section.verdict == verdict
        middle = len(found.map_x) // 2
        assert found.map_left[middle, middle] == pytest.approx(1.0, abs=1e-9)
        assert (found.map_left <= free.map_left + 1e-12).all()
    table = section.items[0]
    assert isinstance(table, Table)
    heads = [column.title for column in table.columns]
    for row, place in zip(table.rows, (found.start, found.goal), strict=False):
        assert place is not None
        assert place.tilts is not None
        for side, tilts in zip(("base", "platform"), place.tilts, strict=True):
            assert row[heads.index(f"largest tilt at the {side}")] == pytest.approx(1e3 * max(tilts))
    assert any("the base joint of leg" in sentence for sentence in section.sentences)
    assert any("the straight path to the goal leaves the legs' limits" in sentence for sentence in section.sentences)


def test_speeds_at_the_speed_limit_by_finite_differences(paper: hs.Scenario) -> None:
    assert workspace.analyse(paper).start.speeds is None
    limit = 0.02
    found = workspace.analyse(paper.updated({"robot.speed_limit": limit, "robot.home_attitude": [0.02, -0.03, 0.3]}))
    scene = found.scene
    speeds = found.start.speeds
    assert speeds is not None
    for speed, unit in zip(speeds, np.eye(6), strict=True):
        step = 1e-6
        ends = [scene.leg_travel(scene.home.moved(sign * step * unit)) for sign in (1.0, -1.0)]
        assert np.abs(ends[0] - ends[1]).max() / (2 * step) * speed == pytest.approx(limit, rel=1e-7)
    table = next(item for item in found.section().items if "speed limit of the legs" in item.title)
    assert isinstance(table, Table)
    assert "20 mm/s" in (table.note or "")
    np.testing.assert_allclose(np.array(table.rows[0][1:], dtype=float), 1e3 * speeds)


@pytest.mark.parametrize(("preset", "force", "singularity"), [("micro", 0.1337, 0.9576), ("cubic", 0.1697, 0.7962)])
def test_known_forces_and_singular_values_at_home(
    paper: hs.Scenario, preset: str, force: float, singularity: float
) -> None:
    changes = {"robot.preset": preset, "uncertainty.gravity": -0.05}
    start = workspace.analyse(paper.updated(changes)).start
    assert np.abs(start.forces).max() == pytest.approx(force, abs=5e-5)
    np.testing.assert_allclose(start.actual_forces, 1.05 * start.forces, rtol=1e-12)
    assert start.singularity == pytest.approx(singularity, abs=5e-5)


def test_forces_hold_the_weight_by_statics(found: workspace.Workspace, paper: hs.Scenario) -> None:
    """At the goal: forces along the legs sum to the weight, and their moments about the platform's centre to zero."""
    scene = scene_of(paper)
    assert found.goal is not None
    pose = found.goal.pose
    np.testing.assert_allclose(pose.quaternion, [1, 0, 0, 0], atol=1e-9)  # a translation: R = I
    p = np.array(scene.hexapod.platform_joints).reshape(6, 3)
    legs = pose.position + p - np.array(scene.hexapod.base_joints).reshape(6, 3)
    along = legs / np.linalg.norm(legs, axis=1)[:, None]
    np.testing.assert_allclose(found.goal.forces @ along, [0, 0, -0.06 * 9.8], atol=1e-8)
    np.testing.assert_allclose(found.goal.forces @ np.cross(p, along), np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(
        found.goal.travel, np.linalg.norm(legs, axis=1) - np.array(scene.hexapod.home_lengths), atol=1e-9
    )


def test_the_map_marks_the_start_of_the_run(paper: hs.Scenario) -> None:
    start = [0.004, -0.003, 0.002, 0.0, 0.02, 0.0]
    (section,) = hs.analyse(paper.updated({"simulation.start.pose": start}), ["workspace"]).sections()
    (heat,) = (item for item in section.items if isinstance(item, HeatMap))
    marks = {line.name: (line.x, line.y) for line in heat.lines}
    np.testing.assert_allclose(np.ravel(marks["start"]), [4.0, -3.0], rtol=0, atol=1e-9)  # [mm] from home
    assert set(marks) == {"start", "goal"}


def test_margins_of_the_way_and_of_the_map(found: workspace.Workspace, paper: hs.Scenario) -> None:
    stroke = paper.robot.stroke
    assert found.goal is not None
    at_goal = stroke - np.abs(found.goal.travel).max()
    assert found.way_left[0] == 1.0
    assert found.way_left[-1] * stroke == pytest.approx(at_goal, rel=1e-12)
    # The margin is nowhere steeper than the platform moves.
    way = np.linalg.norm(found.goal.pose.position - scene_of(paper).home.position)
    assert (np.abs(np.diff(found.way_left)) * stroke <= way / 50 * (1 + 1e-9)).all()
    # The goal of the paper is at the height and attitude of home: the map has the stroke at its middle, and is less
    # than a step away from the margin of the goal where the goal is.
    middle = len(found.map_x) // 2
    margin = stroke * found.map_left
    assert margin[middle, middle] == pytest.approx(stroke, abs=1e-9)
    step = found.map_x[1] - found.map_x[0]
    shift = found.goal.pose.position - scene_of(paper).home.position
    row, column = (
        int(np.abs(ticks - value).argmin()) for ticks, value in ((found.map_y, shift[1]), (found.map_x, shift[0]))
    )
    assert margin[row, column] == pytest.approx(at_goal, abs=step)
    np.testing.assert_allclose(margin, margin[::-1], atol=1e-9)  # y mirrors
    # Along +x the map changes its sign between the two ticks around the reach.
    reach = found.axes[0].distance
    outside = int(np.flatnonzero(found.map_x > reach)[0])
    assert margin[middle, outside - 1] > 0 > margin[middle, outside]


def test_what_is_beyond_a_limit_is_bad_and_what_is_near_a_warning(paper: hs.Scenario) -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({}, "good"),
        ({"robot.stroke": 0.0125}, "warning"),  # the goal takes 12.2 mm
        ({"robot.stroke": 0.002}, "bad"),  # the nearest pose takes 2.8 mm
        ({"robot.force_limit": 0.165}, "warning"),  # the goal takes 0.160 N
        ({"robot.force_limit": 0.15}, "warning"),
        ({"robot.force_limit": 0.15, "uncertainty.gravity": -0.2}, "bad"),
        ({"robot.force_limit": 0.12}, "bad"),
    ]
    for changes, verdict in cases:
        assert workspace.analyse(paper.updated(changes)).section().verdict == verdict, changes
    for force, first in ((1.0, "At the goal"), (0.165, "Holding the platform"), (0.12, "Holding the platform")):
        section = workspace.analyse(paper.updated({"robot.force_limit": force})).section()
        assert section.sentences[0].startswith(first)  # what the verdict is about
    short = workspace.analyse(paper.updated({"robot.stroke": 0.006})).section()
    # 12.2 mm are needed and nearly in proportion to the way, so that 6 mm are passed at about one half of it.
    words = next(sentence for sentence in short.sentences if "leaves the stroke after" in sentence)
    assert "mm beyond its stroke" in words
    share = float(words.split("leaves the stroke after ")[1].split(" %")[0])
    assert 46 <= share <= 54


def test_the_neighbourhood_is_no_better_than_the_goal(found: workspace.Workspace) -> None:
    assert found.goal is not None
    assert 0 < found.neighbourhood_singularity <= found.goal.singularity
    assert found.neighbourhood_force >= np.abs(found.goal.actual_forces).max()


def test_forces_around_the_goal_and_on_the_way_count_in_the_verdict(
    found: workspace.Workspace, paper: hs.Scenario
) -> None:
    """A limit that leaves enough at start and goals, and too little around the goal, or on the way."""
    assert found.goal is not None
    assert found.nearest is not None
    at_places = max(float(np.abs(place.actual_forces).max()) for place in (found.start, found.goal, found.nearest))
    assert found.neighbourhood_force > at_places
    limit = 0.5 * (at_places + found.neighbourhood_force) / 0.9  # of which 10 % are to be left
    section = workspace.analyse(paper.updated({"robot.force_limit": limit})).section()
    assert section.verdict == "warning"
    assert section.sentences[0].startswith("Holding the platform")
    # on the way the two ends, which are the start and the goal, are poses as well
    assert found.way_force >= max(float(np.abs(place.actual_forces).max()) for place in (found.start, found.goal))
    assert found.section().verdict == "good"
    loaded = replace(found, way_force=0.95 * found.force_limit).section()
    assert loaded.verdict == "warning"
    assert f"and {number(0.95 * found.force_limit)} N on the straight path" in loaded.sentences[0]


def test_a_singular_pose_on_the_way_has_no_force_and_comes_first() -> None:
    """A half-turn passes the singular quarter-turn, which is one of the poses: no legs hold the platform there."""
    found = workspace.analyse(hs.load_scenario("textbook-half-turn"))
    section = found.section()
    assert section.verdict == "bad"
    assert section.sentences[0].startswith("At the goal")
    assert "the straight path to the goal comes to a singular pose" in section.sentences[0]
    assert np.isfinite(found.way_force)
    assert found.way_force >= float(np.abs(found.start.actual_forces).max())
    assert not any(" inf " in sentence for sentence in section.sentences)
    # Forces near their limit come first only where start and goals are within reach.
    heavy = replace(found, way_force=found.force_limit).section()
    assert heavy.sentences[0].startswith("At the goal")


def test_a_camera_as_printed_leaves_the_legs_around_home(paper: hs.Scenario) -> None:
    found = workspace.analyse(paper.updated({"camera.convention": "as_printed"}))
    assert found.goal is None
    assert found.way_left.size == 0
    assert any("goal pose is open" in sentence for sentence in found.section().sentences)
    assert [end.distance for end in found.axes] == [end.distance for end in workspace.analyse(paper).axes]


def test_the_findings_name_the_leg_and_its_numbers(found: workspace.Workspace, paper: hs.Scenario) -> None:
    assert found.goal is not None
    leg = int(np.abs(found.goal.travel).argmax())
    first = found.section().sentences[0]
    assert f"leg {leg + 1} is {number(1e3 * abs(found.goal.travel[leg]))} mm" in first
    data = hs.analyse(paper, ["workspace"]).to_dict()["workspace"]
    assert data["goal"]["stroke_left"] == pytest.approx(paper.robot.stroke - np.abs(found.goal.travel).max())
    places, reach, ticks = found.section().items
    assert isinstance(places, Table)
    assert isinstance(reach, Table)
    assert [row[1:7] for row in places.rows[:2]] == [tuple(1e3 * p.travel) for p in (found.start, found.goal)]
    for row, direction in zip(reach.rows, np.eye(6), strict=True):
        ways = [1e3 * workspace.reach(found.scene, sign * direction).distance for sign in (1.0, -1.0)]
        assert row[2:4] == pytest.approx(ways)
    assert list(found.map_x) == sorted(found.map_x)
    assert all(one < two for one, two in pairwise(found.map_y))
    assert ticks.page == "docs/analysis/workspace.md"


def test_start_and_goal_against_the_stroke_by_hand(paper: hs.Scenario) -> None:
    """A goal that is a shift along the optical axis: legs of sqrt(rho^2 + z^2), against strokes on both sides of it."""
    robot = core_parameters(paper).robot
    angle = robot.platform_angles[0] - robot.base_angles[0]
    rho2 = (
        robot.platform_radius**2 + robot.base_radius**2 - 2 * robot.platform_radius * robot.base_radius * np.cos(angle)
    )
    height, depth, shift = abs(robot.home_position[2]), 0.5, 0.04
    # The camera looks along its z axis towards smaller depths: features grow by depth / (depth - shift).
    seen = np.array(paper.target.initial_features)
    goal = {"target.desired_features": (seen * depth / (depth - shift)).tolist()}
    travels = [np.sqrt(rho2 + (height + sign * shift) ** 2) - np.sqrt(rho2 + height**2) for sign in (1, -1)]
    found = reach_of_start_and_goal(paper.updated(goal))
    assert found.goal is not None
    assert found.nearest is not None
    assert (found.start.travel, found.start.margin) == (0.0, robot.stroke)
    assert min(abs(found.goal.travel - travel) for travel in travels) < 1e-9
    assert found.goal.margin == pytest.approx(robot.stroke - abs(found.goal.travel), abs=1e-15)
    assert found.residual < 1e-6
    assert not found.goal.within
    assert found.goal_within is False
    wide = paper.updated({**goal, "robot.stroke": abs(found.goal.travel) + 1e-6})
    assert reach_of_start_and_goal(wide).goal_within


def test_reach_of_start_and_goal_is_what_the_workspace_reports(paper: hs.Scenario) -> None:
    for stroke in (0.017, 0.006, 0.002):
        scenario = paper.updated({"robot.stroke": stroke})
        found, full = reach_of_start_and_goal(scenario), workspace.analyse(scenario)
        assert full.goal is not None
        assert full.nearest is not None
        assert found.goal is not None
        assert found.nearest is not None
        assert found.goal.margin == stroke - np.abs(full.goal.travel).max()
        assert found.goal.leg == 1 + np.abs(full.goal.travel).argmax()
        if not found.goal.within:
            assert found.nearest.margin == stroke - np.abs(full.nearest.travel).max()
        assert (full.section().verdict == "bad") == (found.goal_within is False)
    printed = reach_of_start_and_goal(paper.updated({"camera.convention": "as_printed"}))
    assert (printed.goal, printed.goal_within) == (None, None)
