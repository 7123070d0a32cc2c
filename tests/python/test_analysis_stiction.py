"""The stiction set: cases by hand, vertices enumerated, poses checked by the law, and runs that come to rest in it."""

from __future__ import annotations

import itertools
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import HalfspaceIntersection
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo.findings.analysis import stiction
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.rest import RestLaw
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.analysis.stiction_runs import Runs
from hexservo.findings.analysis.stiction_set import RestSet, confirmed, extremes
from hexservo.findings.analysis.words import number
from hexservo.scenario.arrays import Array

KV = np.array([2e-3, 2e-3, 2e-3, 1e-4, 1e-4, 1e-4])
NO_FUZZY = {"controller.hybrid.fuzzy.enabled": False}


def square(size: float, depth: float) -> dict[str, Any]:
    """Corners at (+-size, +-size) px, seen from home and wanted there: home is the goal."""
    features = [size, size, -size, size, -size, -size, size, -size]
    return {"target": {"initial_features": features, "desired_features": features, "depth": depth}}


def rest_set(scenario: hs.Scenario, kv: Array, exact_depth: bool = False) -> RestSet:
    scene = scene_of(scenario)
    goals = find_goals(scene)
    assert goals is not None
    return RestSet.at(scene, RestLaw(scene, exact_depth=exact_depth), goals.nearest.view, -kv, kv)


# ---- the law at rest ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth_error", [0.0, 0.3, [0.3, -0.2, 0.1, 0.0]])
def test_stiffness_at_the_goal_is_that_of_the_equations(paper: hs.Scenario, depth_error: float | list[float]) -> None:
    """hybrid: J-hat^T K_p J; composite adds K_t (J-hat^T J-hat + M)^-1 (J-hat^T J + M), by hand at the goal."""
    base = paper.updated({**square(120.0, 0.4), "uncertainty.depth": depth_error, "controller.hybrid.kp": 3e-7})
    scene = scene_of(base)
    view = scene.view(scene.home)
    true = view.jacobian
    believed = scene.jacobian(view.features, view.depth * (1 + np.asarray(depth_error)), scene.home)
    expected = 3e-7 * believed.T @ true
    found = RestLaw(scene).stiffness(scene.home)
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())
    np.testing.assert_allclose(
        RestLaw(scene, exact_depth=True).stiffness(scene.home), 3e-7 * true.T @ true, atol=1e-7 * np.abs(expected).max()
    )

    changed = {"controller.law": "composite", "controller.composite.fuzzy.enabled": False}
    gains = base.controller.composite
    prior = np.diag(np.asarray(gains.prior, dtype=float))
    e_rate = np.linalg.solve(believed.T @ believed + prior, believed.T @ true + prior)
    expected = np.asarray(gains.kp) * believed.T @ true + np.diag(np.asarray(gains.kt, dtype=float)) @ e_rate
    found = RestLaw(scene_of(base.updated(changed))).stiffness(scene.home)
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_the_wrench_at_rest_is_the_image_wrench_and_the_gravity_error(paper: hs.Scenario) -> None:
    scenario = paper.updated({"uncertainty.gravity": [0, 0, 0.01, 0, 0, 0]})
    scene = scene_of(scenario)
    view = scene.view(scene.home)
    believed = scene.jacobian(view.features, 1.3 * view.depth, scene.home)
    expected = 1e-6 * believed.T @ (scene.desired - view.features) + [0, 0, -0.01 * 0.06 * 9.8, 0, 0, 0]
    np.testing.assert_allclose(RestLaw(scene).wrench(scene.home), expected, rtol=1e-12, atol=1e-16)


# ---- cases by hand --------------------------------------------------------------------------------------------------


def test_one_axis_by_hand() -> None:
    """Springs that do not know of one another: |d_j| <= k_v,j/a_j, and the image error is J d."""
    springs = np.array([50.0, 40.0, 30.0, 0.2, 0.1, 0.3])
    scene = scene_of(hs.load_scenario("paper").updated(square(100.0, 0.5)))
    view = scene.view(scene.home)
    rest = RestSet(
        view,
        np.zeros(8),
        np.zeros(6),
        np.diag(springs),
        -KV,
        KV,
        np.eye(6),
        np.zeros(6),
        10.0,
        0.1,
        np.ones(6),
        np.eye(3)[2],
    )
    ends = extremes(rest)
    assert ends is not None
    limits = KV / springs
    np.testing.assert_allclose(ends.pose, limits, rtol=1e-7)
    np.testing.assert_allclose(ends.largest, (np.abs(view.jacobian) @ limits).max(), rtol=1e-7)
    assert ends.turn == pytest.approx(np.hypot(*limits[3:5]), rel=1e-7)
    # A gravity error shifts the set: w - a d within k.
    shifted = replace(rest, wrench=np.array([0, 0, 5e-3, 0, 0, 0]))
    moved_ends = extremes(shifted)
    assert moved_ends is not None
    assert moved_ends.pose[2] == pytest.approx((5e-3 + 2e-3) / 30.0, rel=1e-7)


def test_friction_along_one_axis_holds_a_square_where_it_is_worked_out_by_hand(paper: hs.Scenario) -> None:
    """K_v along x alone: A d = (s, 0, ..., 0), so dx = k (A^-1)_xx, with the square's closed form."""
    size, depth, k, kp = 200.0, 0.5, 1e-4, 1e-6
    scenario = paper.updated({**square(size, depth), "uncertainty.depth": 0.0})
    rest = rest_set(scenario, np.array([k, 0, 0, 0, 0, 0]))
    ends = extremes(rest)
    assert ends is not None
    f = scene_of(scenario).camera.focal_pixels
    variance = depth**2 * ((f**2 + size**2) ** 2 + size**4) / (4 * f**2 * size**4)  # of x, per px^2
    assert ends.pose[0] == pytest.approx(k * variance / kp, rel=1e-4)
    # The rotation about y that accompanies it, from the second row of the same two by two block:
    # 4 c (f + a^2/f) dx -+ 4 ((f^2+a^2)^2 + a^4)/f^2 turn = 0 with c = f/d.
    turn = ends.pose[0] * (f / depth) * (f + size**2 / f) * f**2 / ((f**2 + size**2) ** 2 + size**4)
    assert ends.pose[4] == pytest.approx(turn, rel=1e-4)
    assert ends.pose[1:3].max() < 1e-6 * ends.pose[0]


def test_without_the_strokes_the_set_is_a_parallelepiped_in_closed_form(paper: hs.Scenario) -> None:
    """max |xi_i| = |row i of J A^-1| k_v."""
    rest = replace(rest_set(paper.updated(square(200.0, 0.3)), 1e-3 * KV), stroke=1e3, span=np.full(6, 1e3))
    ends = extremes(rest)
    assert ends is not None
    rows = rest.view.jacobian @ np.linalg.inv(rest.stiffness)
    assert ends.largest == pytest.approx((np.abs(rows) @ rest.high).max(), rel=1e-5)


@pytest.mark.parametrize("gravity", [0.0, 0.002])
def test_linear_programs_reach_what_the_enumerated_vertices_have(paper: hs.Scenario, gravity: float) -> None:
    """Qhull lists all vertices of the polytope; what is convex has its largest value at one of them."""
    scenario = paper.updated({"uncertainty.gravity": gravity})
    rest = rest_set(scenario, KV)
    ends = extremes(rest)
    assert ends is not None
    units = rest.stroke / np.repeat([1.0, rest.radius], 3)
    rows = np.vstack([rest.stiffness, -rest.stiffness, rest.leg_rates, -rest.leg_rates]) * units
    limits = np.concatenate(
        [rest.wrench - rest.low, rest.high - rest.wrench, rest.stroke - rest.travel, rest.stroke + rest.travel]
    )
    scale = np.repeat([*KV, *KV, *np.full(12, rest.stroke)], 1)
    # Any point of the inside: the mean of the vertices that the linear programs found.
    inside = ends.displacements.mean(axis=0) / units
    assert (rows @ inside < limits).all()
    vertices = HalfspaceIntersection(np.column_stack([rows, -limits]) / scale[:, None], inside).intersections * units
    assert len(vertices) > 64
    errors = rest.error - vertices @ rest.view.jacobian.T
    assert ends.largest == pytest.approx(np.abs(errors).max(), rel=1e-6)
    assert ends.rms == pytest.approx(np.sqrt(np.square(errors).mean(axis=1)).max(), rel=1e-6)
    w, x, y, z = rest.view.pose.quaternion
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)])
    assert ends.turn == pytest.approx(np.linalg.norm(np.cross(vertices[:, 3:], axis), axis=1).max(), rel=1e-6)
    np.testing.assert_allclose(ends.pose, np.abs(vertices).max(axis=0), rtol=1e-6)


@pytest.mark.parametrize("on", ["platform", "base"])
def test_the_optical_axis_is_that_of_the_camera(paper: hs.Scenario, on: str) -> None:
    """A camera tilted by 60 degrees about x; on the base its axis stays where it is. Turns about it do not count."""
    tilt, turned = Rotation.from_rotvec([np.pi / 3, 0.0, 0.0]), np.array([0.1, -0.2, 0.05])
    mount = {"on": on, "rotation": tilt.as_rotvec().tolist(), "position": [0.0, 0.0, 0.4 if on == "base" else 0.0]}
    scene = scene_of(paper.updated({"camera.mount": mount}))
    axis = tilt.apply([0.0, 0.0, 1.0])
    pose = scene.home.moved(np.array([0.001, 0.002, -0.001, *turned]))
    there = Rotation.from_rotvec(turned).apply(axis) if on == "platform" else axis
    np.testing.assert_allclose(scene.optical_axis(pose), there, rtol=0, atol=1e-14)

    springs = np.array([1.0, 1.0, 1.0, 0.01, 0.02, 0.04])  # so stiff that K_v alone limits the set
    rest = RestSet.at(scene, RestLaw(scene), scene.view(scene.home), -KV, KV)
    ends = extremes(replace(rest, error=np.zeros(8), wrench=np.zeros(6), stiffness=np.diag(springs)))
    assert ends is not None
    corners = (KV / springs)[3:] * np.array(list(itertools.product((-1, 1), repeat=3)))
    assert ends.turn == pytest.approx(np.linalg.norm(np.cross(corners, axis), axis=1).max(), rel=1e-6)


# ---- gravity --------------------------------------------------------------------------------------------------------


def test_k_v_holds_a_third_of_a_percent_of_the_weight_at_the_goal(paper: hs.Scenario) -> None:
    """delta_G m g <= k_v: 0.34 % with the gains of the scenario (docs/errata.md, 8)."""
    for gravity, holds in ((0.0033, True), (0.0035, False)):
        scenario = paper.updated({**square(100.0, 0.5), "uncertainty.gravity": gravity})
        wrench = RestLaw(scene_of(scenario)).wrench(scene_of(scenario).home)
        assert bool((np.abs(wrench) <= KV).all()) is holds


def test_a_gravity_error_that_nothing_holds_is_bad() -> None:
    scenario = hs.load_scenario("paper-gravity")
    section = stiction.analyse(scenario).section()
    assert section.verdict == "bad"
    assert "gravity error of 0.0441 N is beyond K_v (0.002 N)" in section.sentences[0]
    # And so it is: the run leaves the stroke (docs/errata.md, 8).
    result = hs.simulate(scenario)
    assert any(event.kind == "stroke" for event in result.events)


# ---- the law itself, and runs ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{}, {"robot.preset": "cubic"}, {"uncertainty.depth": [0.3, -0.3, 0.3, 0.3]}])
def test_a_confirmed_pose_is_held_by_the_law_within_the_strokes(paper: hs.Scenario, changes: dict[str, Any]) -> None:
    scenario = paper.updated(changes)
    scene = scene_of(scenario)
    rest = rest_set(scenario, KV)
    ends = extremes(rest)
    assert ends is not None
    found = confirmed(scene, RestLaw(scene), rest, ends.displacements[0])
    assert found is not None
    pose, error = found
    features = scene.view(pose).features
    assert np.abs(scene.desired - features).max() == error
    # The law by its servo tick, with everything as the scenario has it, but for friction and weights.
    settings = scenario.updated({"controller.hybrid.kv": 0.0, **NO_FUZZY})
    tick = hs.Controller(settings, 1e-3)
    depth = scene.view(pose).depth * (1 + np.asarray(scenario.uncertainty.depth))
    output = tick.step(features, depth, pose.position, pose.quaternion, np.zeros(6))
    assert not output.invalid_input
    weight = np.array([0, 0, -0.06 * 9.8, 0, 0, 0])
    assert (np.abs(output.wrench - weight) <= KV * (1 + 1e-9)).all()
    assert np.abs(scene.leg_travel(pose)).max() <= scenario.robot.stroke
    assert error > 0.9 * ends.largest


@pytest.fixture(scope="module")
def found(paper: hs.Scenario) -> stiction.Stiction:
    return stiction.analyse(paper)


def check_runs(runs: Runs, near: float) -> None:
    assert runs.counted.sum() >= 30
    assert (runs.final_share[runs.slow] <= 1.0).all()
    largest = runs.final_error[runs.counted].max()
    assert near * runs.bound <= largest <= runs.bound


def test_runs_come_to_rest_within_the_set_and_near_its_border(found: stiction.Stiction) -> None:
    assert [runs.fuzzy for runs in found.runs] == [False, True]
    off, on = found.runs
    check_runs(off, near=0.85)
    check_runs(on, near=0.5)  # its bound takes all that the fuzzy systems of any run took up
    assert found.around_home is not None
    assert found.around_home.ends is not None
    assert off.bound == pytest.approx(found.around_home.ends.largest, rel=1e-9)
    # The scenario's own run, at 2 s: far inside of what is permitted.
    assert on.final_error[0] == pytest.approx(0.08, abs=0.02)
    assert off.final_error[0] > found.runs[0].bound  # without fuzzy systems it takes 5 s (docs/model.md, 8)


def test_a_platform_in_the_set_stays_exactly_and_one_outside_leaves(paper: hs.Scenario) -> None:
    """Sampled mode, implicit switching: dry friction without chatter."""
    scenario = paper.updated({"simulation.mode": "sampled", "controller.switching.kind": "implicit"})
    off, on = stiction.analyse(scenario).runs
    for runs in (off, on):
        inside = runs.start_share <= 1.0
        assert inside[1:].sum() > 15
        np.testing.assert_array_equal(runs.final_error[inside], runs.start_error[inside])
        left = runs.completed & ~inside
        left[0] = False
        assert left.sum() > 10  # held wrenches shake the farther ones without fuzzy systems (docs/model.md, 8)
        assert (runs.final_error[left] != runs.start_error[left]).all()
    check_runs(off, near=0.85)
    check_runs(on, near=0.5)


def test_the_border_of_an_image_off_the_optical_axis_loses_no_point_of_the_runs(paper: hs.Scenario) -> None:
    """All points are in the image, and one is farther from the principal point than half the image."""
    principal_point = np.array([50.0, 80.0])
    goals = {
        f"target.{key}": (np.array(getattr(paper.target, key)) + np.tile(principal_point, 4)).tolist()
        for key in ("initial_features", "desired_features")
    }
    free = paper.updated(
        {
            **NO_FUZZY,
            **goals,
            "camera.principal_point": principal_point.tolist(),
            "simulation.mode": "sampled",
            "simulation.duration": 0.05,
            "controller.switching.kind": "implicit",
        }
    )
    (without,) = hs.analyse(free, ["stiction"]).stiction.runs
    (within,) = hs.analyse(free.updated({"camera.image_size": [120, 140]}), ["stiction"]).stiction.runs
    np.testing.assert_array_equal(within.final_error, without.final_error)


@pytest.mark.parametrize(("duration", "short"), [(0.001, True), (0.099, True), (0.1, False), (0.5, False)])
def test_what_accelerates_is_not_at_rest(paper: hs.Scenario, duration: float, short: bool) -> None:
    """All platforms are slow after a few steps, whatever acts on them; with fuzzy systems some turn at the end."""
    found = stiction.analyse(paper.updated({"simulation.duration": duration}))
    for runs, sentence in zip(found.runs, found.section().sentences[-2:], strict=True):
        assert runs.too_short == short
        assert runs.counted.any() != short
        assert (runs.final_share[runs.counted] <= 1.01).all()
        beyond = int((runs.slow & ~runs.counted).sum())
        if short:
            assert "too short to find which platforms rest" in sentence
            assert runs.final_share[runs.slow].max() > 1.3 or duration > 0.01
        else:
            assert f"{int(runs.counted.sum())} came to rest within K_v" in sentence
            assert (f"{beyond} more are as slow at the end" in sentence) == (beyond > 0)
    assert duration != 0.5 or (found.runs[1].final_share[found.runs[1].slow] > 4.0).any()


def test_what_fuzzy_systems_take_up_is_bounded_by_their_limit(paper: hs.Scenario) -> None:
    limited = stiction.analyse(paper.updated({"controller.hybrid.fuzzy.weight_limit": 1e-5}))
    assert limited.straight_way is not None
    assert np.abs(limited.straight_way).max() == 1e-5
    assert np.abs(limited.runs[1].fuzzy_output).max() <= 1e-5 * (1 + 1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"controller.law": "composite", "controller.composite.drive": 0.0},
        {"controller.law": "composite", "controller.composite.drive": 0.0, "controller.switching.kind": "tanh"},
        {"controller.switching.kind": "tanh", "controller.hybrid.fuzzy.adaptation": 0.03},
    ],
)
def test_fuzzy_systems_that_the_twist_alone_drives_hold_a_run_off_its_goal(
    paper: hs.Scenario, changes: dict[str, Any]
) -> None:
    """A spring towards the start: a run ends beyond the set of K_v alone, and within a reported case."""
    scenario = paper.updated(changes)
    found = stiction.analyse(scenario)
    final = np.abs(hs.simulate(scenario).feature_error[-1]).max()
    section = found.section()
    if found.kind == "open":
        assert final > 10.0  # of the 20 px at the start: nothing that creep would leave
        assert "a spring towards the start" in section.sentences[0]
        assert section.verdict == "open"
        return
    assert found.straight_way is not None
    alone, with_fuzzy = found.cases[0].ends, found.cases[-1].ends
    assert alone is not None
    assert with_fuzzy is not None
    assert alone.largest < final < with_fuzzy.largest
    assert section.verdict == "warning"


def test_the_verdict_counts_what_the_fuzzy_systems_hold(paper: hs.Scenario) -> None:
    """A hundredth of K_v holds less than 2 px, the fuzzy systems hold more."""
    found = stiction.analyse(
        paper.updated({"controller.hybrid.kv": (0.01 * KV).tolist(), "controller.hybrid.fuzzy.adaptation": 0.1})
    )
    alone, with_fuzzy = found.cases[0].ends, found.cases[-1].ends
    assert alone is not None
    assert with_fuzzy is not None
    assert alone.largest < 2.0 < with_fuzzy.largest
    assert found.section().verdict == "warning"


def test_the_verdict_counts_the_checked_poses(found: stiction.Stiction) -> None:
    """A band between the linear bound and a pose that the law itself holds."""
    largest = max(case.ends.largest for case in found.cases if case.ends is not None)
    checked = max(case.confirmed for case in found.cases if case.confirmed is not None)
    assert checked > largest
    between = copy(found.scene)
    between.band = 0.5 * (largest + checked)
    section = replace(found, scene=between).section()
    assert section.verdict == "warning"
    assert any(f"{number(checked)} px at a checked pose" in text for text in section.sentences)


def test_what_one_rule_takes_up_on_the_straight_way(found: stiction.Stiction, paper: hs.Scenario) -> None:
    goals = find_goals(scene_of(paper))
    assert goals is not None
    assert found.straight_way is not None
    np.testing.assert_allclose(found.straight_way, goals.nearest.displacement / 10.0)
    by_name = {case.name: case.ends for case in found.cases}
    plain, taken = by_name["J-hat, with the depth error"], by_name["J-hat, with the output of the fuzzy systems"]
    assert plain is not None
    assert taken is not None
    assert taken.largest > plain.largest


# ---- where there is no set ------------------------------------------------------------------------------------------


def test_without_friction_the_set_is_the_goal(paper: hs.Scenario) -> None:
    found = stiction.analyse(paper.updated({"controller.hybrid.kv": 0.0, **NO_FUZZY}))
    ends = found.cases[0].ends
    assert ends is not None
    assert ends.largest < 1e-9
    assert found.runs == ()
    assert "is a point, with an image error below 1e-6 px" in found.section().sentences[0]


def test_without_kv_the_image_along_z_balances_the_gravity_error(paper: hs.Scenario) -> None:
    """Square, K_v = 0: only the image along z carries the weight, z = delta_G m g/(8 K_p a^2/d^2) at exact depths."""
    size, depth, gravity = 200.0, 0.3, 0.01
    scenario = paper.updated(
        {
            **square(size, depth),
            "uncertainty.depth": 0.0,
            "uncertainty.gravity": gravity,
            "controller.hybrid.kv": 0.0,
            **NO_FUZZY,
        }
    )
    ends = stiction.analyse(scenario).cases[0].ends
    assert ends is not None
    z = gravity * 0.06 * 9.8 / (1e-6 * 8 * size**2 / depth**2)
    assert ends.pose[2] == pytest.approx(z, rel=1e-6)
    assert ends.largest == pytest.approx(z * size / depth, rel=1e-6)
    # The same by the law itself, not linearised: less than 1 % of the depth away.
    scene = scene_of(scenario)
    held = [RestLaw(scene).wrench(scene.home.moved(np.array([0, 0, sign * z, 0, 0, 0])))[2] for sign in (-1, 1)]
    assert min(np.abs(held)) < 0.05 * gravity * 0.06 * 9.8


@pytest.mark.parametrize("name", ["paper-composite", "task-rotation", "textbook-general"])
def test_an_integrating_law_goes_to_where_its_pose_error_vanishes(name: str) -> None:
    scenario = hs.load_scenario(name)
    found = stiction.analyse(scenario)
    assert found.kind == "integrated"
    assert found.prior_error is not None
    result = hs.simulate(scenario.updated({"simulation.duration": 60.0, "simulation.log_every": 60000}))
    final = np.abs(result.feature_error[-1]).max()
    assert final == pytest.approx(found.prior_error, rel=0.005)
    assert f"{number(found.prior_error)} px off" in found.section().sentences[1]


def test_laws_without_a_switching_term_and_what_is_open(paper: hs.Scenario) -> None:
    for law in ("kelly", "resolved_rate", "pbvs", "computed_torque"):
        section = stiction.analyse(paper.updated({"controller.law": law})).section()
        assert section.verdict == "good"
        assert f"The law {law} has no switching term" in section.sentences[0]
    open_ones: list[dict[str, Any]] = [
        {"camera.convention": "as_printed"},
        {"controller.law": "composite", "controller.composite.drive": [0, 4, 4, 4, 4, 4]},
        {"controller.law": "composite", "controller.composite.fuzzy.leakage": 0.1},
        {"controller.switching.kind": "tanh", "controller.hybrid.kv": [0, 1, 1, 1, 1, 1]},
        {"target.desired_features": [10, 10, 45, -73, -64, 49, -30, -23]},  # no pose shows it: 4.8 px are left
    ]
    for changes in open_ones:
        section = stiction.analyse(paper.updated(changes)).section()
        assert section.verdict == "open"
        assert section.sentences[0].startswith("Open")
        assert not section.items


@pytest.mark.parametrize(
    ("changes", "beyond"),
    [
        ({}, 0.04),
        ({"simulation.mode": "sampled", "controller.switching.kind": "implicit"}, 0.095),
    ],
)
def test_composite_without_fuzzy_systems_has_a_set(paper: hs.Scenario, changes: dict[str, Any], beyond: float) -> None:
    """Goals up to 20 mm away are not linear any more: the first sentence states by how much."""
    off = {"controller.law": "composite", "controller.composite.fuzzy.enabled": False}
    found = stiction.analyse(paper.updated({**off, **changes}))
    assert found.kind == "set"
    (runs,) = found.runs
    assert runs.counted.sum() > 30
    # Viscous damping stops a platform at the border from outside, at a share of K_v a little above one.
    assert (runs.final_share[runs.slow] <= 1.01).all()
    largest = runs.final_error[runs.counted].max() / runs.bound
    assert largest == pytest.approx(1.0 + beyond, abs=0.005)
    assert f"rests at {largest:.0%} of the linear value" in found.section().sentences[0]


def test_the_data_are_the_numbers_of_the_findings(paper: hs.Scenario, found: stiction.Stiction) -> None:
    data = hs.analyse(paper, ["stiction"]).to_dict()["stiction"]
    ends = found.cases[0].ends
    assert ends is not None
    f = scene_of(paper).camera.focal_pixels
    assert data["cases"][0]["largest_error"] == ends.largest
    assert data["cases"][0]["angle_at_focal_length"] == pytest.approx(ends.largest / f)
    assert f"up to {number(ends.largest)} px in a coordinate" in found.section().sentences[0]
    assert "linear value" not in found.section().sentences[0]  # no run is beyond it
    assert f"{number(1e3 * ends.largest / f)} mrad" in found.section().sentences[0]


def test_a_limit_that_a_checked_pose_exceeds_is_approximate() -> None:
    """The set is linear; a pose farther than its limit at which the law is within K_v refutes "up to"."""
    found = stiction.analyse(hs.load_scenario("fails-stiction"))
    words = found.section().sentences
    beyond = [case.confirmed > case.ends.largest for case in found.cases if case.ends and case.confirmed is not None]
    assert beyond
    assert all(beyond)
    assert "image errors of about 16.7 px in a coordinate" in words[0]
    assert (
        "At a pose with 17.7 px the law itself is within K_v, and every leg within its stroke: the set is" in words[0]
    )
    assert any(text.endswith(": about 18.1 px, 19.1 px at a checked pose.") for text in words)
    assert not any(f"up to {number} px" in text for number in (16.7, 18.1) for text in words)
    inside = tuple(replace(case, confirmed=case.ends.largest - 0.1) for case in found.cases if case.ends)
    words = replace(found, cases=inside).section().sentences
    assert "image errors of up to 16.7 px in a coordinate" in words[0]
    assert "approximate" not in words[0]
