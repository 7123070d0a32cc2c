"""Equilibria of the transpose laws: against cases solved by hand, runs of the core, and the servo tick."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hexservo as hs
from hexservo import _core
from hexservo.findings.analysis import equilibria
from hexservo.findings.analysis.equilibria import Equilibrium
from hexservo.findings.analysis.goal import SHOWN, find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.rest import Rest
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.analysis.words import direction_words, number
from hexservo.findings.evidence import Table
from hexservo.scenario.parameters import core_parameters


@pytest.fixture(scope="module")
def trap() -> tuple[hs.Scenario, equilibria.Equilibria]:
    scenario = hs.load_scenario("false-equilibrium")
    return scenario, equilibria.analyse(scenario)


def attracting(found: equilibria.Equilibria) -> Equilibrium:
    (only,) = found.traps
    return only


# ---- A false equilibrium, and the run that ends there ---------------------------------------------------------------


def test_a_run_of_kelly_ends_at_the_false_equilibrium(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    scenario, found = trap
    predicted, result = attracting(found), hs.simulate(scenario)
    assert result.outcome == "completed"
    assert not result.events  # within stroke and force all the way
    # what is left of the slowest mode, whose time constant is 1 s, after 20 s: exp(-20) of some 20 mm and 0.2 rad
    np.testing.assert_allclose(result.position[-1], predicted.position, rtol=0, atol=2e-8)
    np.testing.assert_allclose(result.quaternion[-1], predicted.quaternion, rtol=0, atol=2e-7)
    assert np.abs(result.feature_error[-1]).max() == pytest.approx(predicted.residual, abs=1e-6)
    assert predicted.residual > 9.0
    assert np.abs(result.twist[-1]).max() < 1e-6
    assert found.section().verdict == "bad"


def test_the_run_falls_into_it_as_its_slowest_mode_says(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    scenario, found = trap
    predicted, result = attracting(found), hs.simulate(scenario)
    away = np.linalg.norm(result.position - predicted.position, axis=1)
    early, late = (int(np.argmin(np.abs(result.time - t))) for t in (13.0, 16.0))
    assert predicted.growth is not None
    rate = math.log(away[late] / away[early]) / (result.time[late] - result.time[early])
    # 0.1 mm away the next term of the force is less than 1 % of the linear one
    assert rate == pytest.approx(predicted.growth, rel=0.01)


def test_the_goal_is_found_too_and_a_saddle_between_them(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    _, found = trap
    (goal,) = found.goals
    assert goal.kind == "goal"
    assert goal.stability == "attracting"
    assert goal.reachable
    # the scenario's own words: home, carried about (0, 0, -0.3) m by 0.65 rad about y; features rounded to 1e-6 px
    np.testing.assert_allclose(goal.displacement[3:], [0.0, 0.65, 0.0], rtol=0, atol=1e-6)
    by_hand = [0.1 * math.sin(0.65), 0.0, 0.1 * math.cos(0.65) - 0.1]
    np.testing.assert_allclose(goal.displacement[:3], by_hand, rtol=0, atol=1e-7)
    assert goal.residual < 1e-6
    (saddle,) = (e for e in found.found if e.stability == "saddle")
    turns = sorted(e.displacement[4] for e in (attracting(found), saddle, goal))
    assert turns[1] == saddle.displacement[4]
    assert saddle.growth is not None
    assert saddle.growth > 0
    # the way over the hill: it starts at the false one's error, rises, and ends at zero
    assert found.barrier is not None
    error = found.barrier[1]
    assert error.max() > error[0] > 1.0 > 1e-3 > error[-1]


def test_the_servo_tick_gives_nothing_but_the_weight_there(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    """The other way through the core: the tick on the image that the camera takes at the pose."""
    scenario, found = trap
    rest = Rest(scenario)
    for e in found.found:
        features, depth = rest.image(Poses(e.position[None], e.quaternion[None]))
        tick = hs.Controller(scenario, 1e-3)
        output = tick.step(features[0], depth[0], e.position, e.quaternion, np.zeros(6))
        weight = np.array([0.0, 0.0, -9.8 * scenario.robot.mass, 0.0, 0.0, 0.0])
        if e.kind == "goal":  # the image is rounded to 1e-6 px, which asks up to 1e-6 px * 1e-5 * 8 * 6000 px/m
            np.testing.assert_allclose(output.wrench, weight, rtol=0, atol=5e-7)
        else:
            np.testing.assert_allclose(output.wrench, weight, rtol=0, atol=1e-9)


def test_hybrid_has_the_same_ones(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    """With one gain for all features the zeros of J^T K_p xi~ do not depend on it."""
    scenario, found = trap
    other = equilibria.analyse(scenario.updated({"controller.law": "hybrid"}))
    np.testing.assert_allclose(attracting(other).position, attracting(found).position, rtol=0, atol=1e-9)
    assert attracting(other).growth is None  # without K_v nothing damps
    assert "K_v" in " ".join(other.section().sentences)


def test_the_search_is_reproducible(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    scenario, found = trap
    again = equilibria.analyse(scenario)
    assert len(again.found) == len(found.found)
    for one, two in zip(found.found, again.found, strict=True):
        assert one.position.tobytes() == two.position.tobytes()
        assert one.eigenvalues.tobytes() == two.eigenvalues.tobytes()


# ---- Solved by hand -------------------------------------------------------------------------------------------------


def test_the_papers_goal_is_the_only_one(paper: hs.Scenario) -> None:
    found = equilibria.analyse(paper)
    (goal,) = found.found
    by_hand = np.array([20.0, 8.0, 0.0]) * 0.5 / (72727 * 0.008)
    np.testing.assert_allclose(goal.displacement, [*by_hand, 0, 0, 0], rtol=0, atol=1e-9)
    assert goal.stability == "attracting"
    assert goal.reachable
    assert found.section().verdict == "good"
    assert (found.starts_within, found.starts_wider) == (64, 64)
    words = found.section().sentences[0]
    assert "within the stroke of 17 mm and 64 in a wider region (350 mm either way" in words  # 0.7 of 0.5 m
    table = found.section().items[0]
    assert isinstance(table, Table)
    legs = _core.Hexapod(core_parameters(paper).robot)
    lengths = legs.leg_lengths(np.add(legs.home_position, by_hand), legs.home_quaternion)
    travel = table.rows[0][[column.title for column in table.columns].index("largest leg travel")]
    assert travel == pytest.approx(1e3 * np.abs(np.subtract(lengths, legs.home_lengths)).max(), rel=1e-7)


@pytest.mark.parametrize(("depth", "stability"), [(0.3, "attracting"), ([0.3, -0.3, -0.3, 0.3], "saddle")])
def test_eigenvalues_at_the_goal_are_those_of_the_closed_form(
    depth: float | list[float], stability: str, paper: hs.Scenario
) -> None:
    """Where xi~ is zero the stiffness is J-hat^T K_p J: no finite difference in it."""
    scenario = paper.updated({"controller.law": "kelly", "uncertainty.depth": depth})
    (goal,) = equilibria.analyse(scenario).goals
    assert goal.stability == stability
    rest = Rest(scenario)
    pose = Poses(goal.position[None], goal.quaternion[None])
    features, true = rest.image(pose)
    known = rest.jacobian(features, (1 + np.asarray(depth)) * true, pose)[0]
    stiffness = 1e-6 * known.T @ rest.jacobian(features, true, pose)[0]
    inertia = 0.925 * np.diag([0.06, 0.06, 0.06, 1.5e-4, 1.5e-4, 3e-4])  # (1 - delta_D) D at R = I
    expected = np.sort(np.linalg.eigvals(np.linalg.solve(inertia, stiffness)).real)
    # differences leave 1e-12 of the largest, 1e4 1/s^2
    np.testing.assert_allclose(goal.eigenvalues.real, expected, rtol=1e-6, atol=3e-8)


def on_the_axis(gravity: float, kp: float = 1e-4) -> hs.Scenario:
    """Give a square of 240 px on the optical axis, 0.15 m away, seen from its goal."""
    square = [120, 120, -120, 120, -120, -120, 120, -120]
    return hs.Scenario.from_mapping(
        {
            "name": "square",
            "target": {"initial_features": square, "desired_features": square, "depth": 0.15},
            "uncertainty": {"gravity": gravity},
            "controller": {"law": "kelly", "kelly": {"kp": kp}},
        }
    )


def test_too_little_damping_lets_an_oscillation_grow_at_the_goal() -> None:
    """Unequal depth errors make the stiffness unsymmetric; runs from a nanometre beside the goal tell what it does."""
    stiff = hs.load_scenario("false-equilibrium").updated({"uncertainty.depth": [-0.249, -0.158, 0.181, 0.049]})
    for damping, name in ((0.01, "oscillating"), (0.3, "attracting")):
        kd = (damping * np.array([1.0, 1.0, 1.0, 0.02, 0.02, 0.04])).tolist()
        scenario = stiff.updated({"controller.kelly.kd": kd})
        found = equilibria.analyse(scenario)
        (goal,) = found.goals
        assert goal.growth is not None
        assert goal.stability == name
        assert goal.eigenvalues.real.min() > 0
        assert (found.section().verdict == "bad") == (name == "oscillating")
        assert ("does not attract" in found.section().sentences[0]) == (name == "oscillating")
        # A run starts at home: the points are put where home sees what the goal's pose does, but for a nanometre.
        w, (x, y, z) = goal.quaternion[0], goal.quaternion[1:]
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        attitude = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        points = (np.array(scenario.target.points) - goal.position + [1e-9, 0, 0]) @ attitude
        home = np.array(scenario.robot.home_position)
        changes = {"target.points": (points + home).tolist(), "simulation.duration": 4.0}
        error = np.abs(hs.simulate(scenario.updated(changes)).feature_error).max(axis=1)
        second, fourth = error[1000:2000].max(), error[3000:].max()
        if name == "oscillating":
            assert np.log(fourth / second) / 2.0 == pytest.approx(goal.growth, rel=0.03)
        else:
            assert fourth < second


@pytest.mark.parametrize("gravity", [0.075, -0.075])
def test_a_gravity_error_moves_the_goal_where_the_forces_balance(gravity: float) -> None:
    """On the axis every coordinate is h Z_0/Z, so 8 K_p h^2 Z_0 (Z - Z_0)/Z^3 = -delta_G m g: a cubic in Z."""
    found = equilibria.analyse(on_the_axis(gravity))
    pull = gravity * 0.06 * 9.8  # upward, towards the target, where positive
    stiffness = 8 * 1e-4 * 120.0**2 * 0.15
    roots = np.roots([pull, 0.0, stiffness, -stiffness * 0.15])
    distance = min((float(root.real) for root in roots if abs(root.imag) < 1e-12), key=lambda z: abs(z - 0.15))
    (goal,) = found.goals
    assert goal.kind == "displaced goal"
    # the camera looks along -z: closer to the target is up
    np.testing.assert_allclose(goal.displacement, [0, 0, distance - 0.15, 0, 0, 0], rtol=0, atol=1e-9)
    assert goal.residual == pytest.approx(120 * abs(0.15 / distance - 1), rel=1e-9)
    assert found.gravity_force == pytest.approx(-pull, rel=1e-12)
    assert found.gravity_stiffness == pytest.approx(8 * 1e-4 * (120 / 0.15) ** 2, rel=1e-6)


def test_a_displaced_goal_that_does_not_attract_is_said_not_to(paper: hs.Scenario) -> None:
    found = equilibria.analyse(
        paper.updated({"controller.law": "kelly", "controller.jacobian": "printed", "uncertainty.gravity": 1e-5})
    )
    assert found.goals[0].kind == "displaced goal"
    section = found.section()
    assert section.verdict == "bad"
    assert any("does not attract" in sentence for sentence in section.sentences)
    assert any("gravity error" in sentence for sentence in section.sentences)


@pytest.mark.parametrize(
    ("down", "words"),
    [
        ([1.0, 0.0, 0.0], "along x (down is positive)"),
        ([0.0, -1.0, 0.0], "along -y (down is positive)"),
        ([0.0, 0.0, 1.0], "along z (down is positive)"),
        ([0.0, 0.6, 0.8], "along (0.00, 0.60, 0.80) (down is positive)"),
    ],
)
def test_a_turned_gravity_error_is_judged_along_its_own_direction(down: list[float], words: str) -> None:
    """Stiffness of the square by hand: 4 K_p (f/Z)^2 across, 8 K_p (h/Z)^2 along the axis, and nothing between them."""
    gravity = 0.01
    scenario = on_the_axis(gravity).updated({"robot.gravity": (9.8 * np.array(down)).tolist()})
    found = equilibria.analyse(scenario)
    focal = core_parameters(scenario).camera.focal_pixels
    across, ahead = 4 * 1e-4 * (focal / 0.15) ** 2, 8 * 1e-4 * (120 / 0.15) ** 2
    assert found.gravity_direction is not None
    np.testing.assert_allclose(found.gravity_direction, down, rtol=0, atol=1e-12)
    assert found.gravity_force == pytest.approx(-gravity * 0.06 * 9.8, rel=1e-12)
    expected = float(np.array([across, across, ahead]) @ np.square(down))
    assert found.gravity_stiffness == pytest.approx(expected, rel=1e-6)
    section = found.section()
    assert f"The gravity error leaves {found.gravity_force:+.3g} N {words} against a stiffness" in section.sentences[0]
    assert section.data["gravity_direction"] is found.gravity_direction


def test_the_goal_repels_where_the_printed_sign_is_used(paper: hs.Scenario) -> None:
    found = equilibria.analyse(paper.updated({"controller.law": "kelly", "controller.jacobian": "printed"}))
    (goal,) = found.goals
    assert goal.stability == "repelling"
    assert found.section().verdict == "bad"
    assert "does not attract" in found.section().sentences[0]


def test_half_a_turn_has_no_false_equilibrium_near_but_a_goal_that_no_leg_reaches() -> None:
    """The force on the way is that of retreat, at every distance: by symmetry nothing turns, and nothing stops it."""
    found = equilibria.analyse(hs.load_scenario("textbook-half-turn").updated({"controller.law": "kelly"}))
    (goal,) = found.goals
    assert abs(goal.displacement[5]) == pytest.approx(math.pi, abs=1e-6)
    assert not goal.reachable  # beyond the singular poses
    assert not found.traps
    assert found.section().verdict == "warning"


def test_directions_as_text() -> None:
    assert direction_words(np.array([-2.0, 0, 0, 0, 0, 0]), 0.5, 0.01) == "a translation along -x"
    assert direction_words(np.array([0, 0, 0, 0, 0, 3.0]), 0.5, 0.01) == "a rotation about z"
    mixed = np.array([0, 0.5, 0, 1.0, 0, 0])
    assert direction_words(mixed, 0.5, 0.01) == "10 mm along y with 20 mrad about x"
    assert direction_words(mixed, 0.5, 1e-5) == "0.01 mm along y with 0.02 mrad about x"
    assert "(0.60, 0.80, 0.00)" in direction_words(np.array([3.0, 4.0, 0, 0, 0, 0]), 0.5, 0.01)


# ---- Where it does not apply ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["composite", "computed_torque", "resolved_rate", "pbvs"])
def test_other_laws_get_no_numbers(law: str, paper: hs.Scenario) -> None:
    section = equilibria.analyse(paper.updated({"controller.law": law})).section()
    assert section.verdict == "open"
    assert law in section.sentences[0]
    assert not section.items
    assert section.data["applies"] is False


def test_without_gains_there_is_no_image_part(paper: hs.Scenario) -> None:
    section = equilibria.analyse(paper.updated({"controller.law": "kelly", "controller.kelly.kp": 0.0})).section()
    assert section.verdict == "open"
    assert "K_p" in section.sentences[0]


def test_a_camera_as_printed_has_no_poses(paper: hs.Scenario) -> None:
    section = equilibria.analyse(paper.updated({"camera.convention": "as_printed"})).section()
    assert section.verdict == "open"
    assert "as_printed" in section.sentences[0]


def test_what_the_section_holds(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    scenario, _ = trap
    analysis = hs.analyse(scenario, ["equilibria"])
    (section,) = analysis.sections()
    assert section.name == "equilibria"
    assert "9.09 px" in section.sentences[0]
    assert any("not a proof" in sentence for sentence in section.sentences)
    numbers = analysis.to_dict()["equilibria"]
    assert numbers["false_attracting_reachable"] == 1
    assert [e["kind"] for e in numbers["equilibria"]] == ["goal", "false", "false"]


INEXACT = [1e-5, 0.05, 0.3]  # [px], of one coordinate


@pytest.mark.parametrize("by", INEXACT)
def test_an_inexact_goal_image_has_a_goal_not_a_false_equilibrium(by: float, paper: hs.Scenario) -> None:
    features = np.array(paper.target.desired_features)
    features[0] += by
    found = equilibria.analyse(paper.updated({"target.desired_features": features}))
    assert [(each.kind, each.stability) for each in found.found] == [("goal", "attracting")]
    # Least squares, as K_p is the same for all coordinates: no pose is better than the one of the exact image,
    # which leaves `by`.
    assert SHOWN < found.found[0].residual <= by
    section = found.section()
    assert section.verdict == ("good" if by < 0.1 else "warning")  # that of 0.3 px is beyond the stroke
    assert f"an error of {number(found.found[0].residual)} px is left" in " ".join(section.sentences)


def test_a_false_equilibrium_stays_one_beside_an_inexact_goal(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    scenario, exact = trap
    features = np.round(scenario.target.desired_features or (), 2)
    found = equilibria.analyse(scenario.updated({"target.desired_features": features}))
    assert [each.kind for each in found.found] == [each.kind for each in exact.found]
    assert found.section().verdict == "bad"


def test_a_false_equilibrium_of_nearly_the_goal_image_is_named(trap: tuple[hs.Scenario, equilibria.Equilibria]) -> None:
    """The square of `false-equilibrium` at a fifth of its size: the other pose has the image to 0.4 px."""
    scenario, exact = trap
    scene = scene_of(scenario)
    middle = scene.points.mean(axis=0)
    small = scenario.updated(
        {
            "target.initial_features": None,
            "target.depth": None,
            "target.points": middle + 0.2 * (scene.points - middle),
        }
    )
    goal, other = exact.goals[0], exact.traps[0]
    image = hs.project(small, goal.displacement)
    found = equilibria.analyse(small.updated({"target.desired_features": np.round(image, 4)}))
    assert len(found.goals) == 1
    assert found.goals[0].residual < 1e-4  # [px], as least squares are no farther off than rounding
    # two points of the small square move the image by 1/5 as much, so that the poses differ from those by little
    near = min(found.traps, key=lambda each: float(np.linalg.norm(each.displacement - other.displacement)))
    assert near.residual < 0.5
    assert found.section().verdict == "bad"


@pytest.mark.parametrize("band", [2.0, 0.01])
def test_a_goal_image_of_no_pose_has_no_goal(band: float, paper: hs.Scenario) -> None:
    """Farther off than ordinary noise, or than a narrower settling band."""
    features = np.array(paper.target.desired_features)
    features[0] += 4.0 if band > 0.5 else 0.05
    scenario = paper.updated({"target.desired_features": features, "metrics.band": band})
    goals = find_goals(scene_of(scenario))
    assert goals is not None
    assert min(band, 0.5) < goals.best.largest_residual <= max(band, 0.5)
    assert goals.shown_at is None
    found = equilibria.analyse(scenario)
    assert {each.kind for each in found.found} == {"false"}
    assert found.section().verdict == "bad"


def test_legs_that_take_positions_rest_where_the_virtual_platform_does(
    trap: tuple[hs.Scenario, equilibria.Equilibria],
) -> None:
    """Errors of the dynamics change nothing, and its damping adds to the law's. The slowest mode is of -0.092 1/s."""
    scenario = trap[0].updated({"controller.kelly.kp": 1e-6})  # as fast as legs and servo period can follow
    found = equilibria.analyse(scenario)
    positions = scenario.updated(
        {
            "simulation": {"mode": "sampled", "step": 0.002},
            "actuators": {"kind": "position", "position": {"bandwidth": 20.0}},
            "sensors.pose": "encoders",
            "camera.prediction": "encoder",
            "uncertainty": {"gravity": 0.3, "inertia": 0.2},
        }
    )
    analysis = hs.analyse(positions, ["equilibria"])
    predicted = attracting(analysis.equilibria)
    np.testing.assert_allclose(predicted.position, attracting(found).position, rtol=0.0, atol=1e-9)
    assert analysis.sections()[0].verdict == "bad"
    beside = (predicted.displacement + 1e-5 * np.array([1.0, 0.0, 1.0, 0.0, 1.0, 0.0])).tolist()
    run = hs.simulate(positions.updated({"simulation.start.pose": beside, "simulation.duration": 20.0}))
    away = np.linalg.norm(run.position - predicted.position, axis=1)
    assert away[-1] < 0.3 * away[0]
    damping = np.broadcast_to(scenario.controller.kelly.kd, 6)
    slower = equilibria.analyse(positions.updated({"controller.virtual_platform.damping": damping.tolist()}))
    expected = equilibria.analyse(scenario.updated({"controller.kelly.kd": (2.0 * damping).tolist()}))
    assert attracting(slower).growth == pytest.approx(attracting(expected).growth, rel=1e-5)
    assert attracting(slower).growth != pytest.approx(attracting(found).growth, rel=1e-2)


@pytest.mark.parametrize("mass", [1e3, 1e5, 1e8])
def test_the_goal_is_found_whatever_the_mass(paper: hs.Scenario, mass: float) -> None:
    """Without an error of gravity the goal image is an equilibrium; a heavy platform of small inertia is undecided."""
    light, heavy = equilibria.analyse(paper), equilibria.analyse(paper.updated({"robot.mass": mass}))
    assert [goal.kind for goal in heavy.goals] == ["goal"]
    np.testing.assert_allclose(heavy.goals[0].displacement, light.goals[0].displacement, rtol=0, atol=1e-9)
    assert heavy.goals[0].residual < 1e-9
    assert heavy.section().verdict == "open"
    assert "is not decided" in heavy.section().sentences[0]


def test_eigenvalues_are_inverse_to_mass_and_inertia(paper: hs.Scenario) -> None:
    """Of a weight that the law balances nothing is left in them, not even its rounding."""
    inertia = np.array(paper.robot.inertia)
    light = equilibria.analyse(paper)
    heavy = equilibria.analyse(
        paper.updated({"robot.mass": 1e8 * paper.robot.mass, "robot.inertia": (1e8 * inertia).tolist()})
    )
    assert heavy.section().verdict == light.section().verdict == "good"
    np.testing.assert_allclose(1e8 * heavy.goals[0].eigenvalues.real, light.goals[0].eigenvalues.real, rtol=1e-3)
