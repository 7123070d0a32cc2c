"""Drift under unequal depth errors: against closed forms, the known numbers of docs/model.md, and runs of a minute."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import drift
from hexservo.findings.analysis.camera_margins import exponents
from hexservo.findings.analysis.drift import Drift, loop_matrix
from hexservo.findings.analysis.drift_patterns import Pattern, Size
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.linear_loop import Clock
from hexservo.findings.analysis.loop_of_scenario import clock_of, loop_at_rest
from hexservo.findings.analysis.poses import Poses, by_displacement
from hexservo.findings.analysis.rest import Rest
from hexservo.findings.analysis.scene import scene_of
from test_positions import positioned

WORST = "(+,-,-,+)"
PRIOR = np.array([1e4, 1e4, 1e4, 1600, 1600, 1600])


@pytest.fixture(scope="module")
def composite() -> hs.Scenario:
    return hs.load_scenario("paper-composite")


@pytest.fixture(scope="module")
def found(composite: hs.Scenario) -> Drift:
    return drift.analyse(composite)


def size_of(result: Drift, size: float) -> Size:
    (only,) = (s for s in result.sizes if s.size == size)
    return only


def pattern_of(result: Drift, signs: str, size: float = 0.3) -> Pattern:
    (only,) = (p for p in size_of(result, size).patterns if p.signs == signs)
    return only


# ---- Closed forms ---------------------------------------------------------------------------------------------------


def jacobians(scenario: hs.Scenario, factor: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Give J with depths times a factor, and J, at an attitude and a place off home."""
    rest = Rest(scenario)
    move = np.random.default_rng(seed).uniform(-1, 1, (1, 6)) * [0.02, 0.02, 0.02, 0.2, 0.2, 0.2]
    pose = rest.home.moved(move)
    features, depth = rest.image(pose)
    return tuple(rest.jacobian(features, z, pose)[0] for z in (factor * depth, depth))


@pytest.mark.parametrize("error", [-0.5, -0.3, 0.05, 0.3, 0.8])
@pytest.mark.parametrize("seed", [0, 1])
def test_equal_errors_without_a_prior_scale_the_three_translations(error: float, seed: int) -> None:
    """J-hat = J blkdiag(1/(1 + delta), 1): by hand E = blkdiag(1 + delta, 1), whatever the image."""
    scenario = hs.load_scenario("task-general")
    known, true = jacobians(scenario, 1 + error, seed)
    matrix = loop_matrix(known, true, np.zeros(6), np.zeros(6))
    # condition of J^T J, in metres and radians: about 1e5
    np.testing.assert_allclose(matrix, np.diag([1 + error] * 3 + [1.0] * 3), rtol=0, atol=1e-9)


@pytest.mark.parametrize("prior", [np.zeros(6), PRIOR])
def test_exact_depths_leave_all_eigenvalues_at_one(prior: np.ndarray) -> None:
    known, true = jacobians(hs.load_scenario("task-general"), 1.0, 2)
    np.testing.assert_allclose(loop_matrix(known, true, prior, prior), np.eye(6), rtol=0, atol=1e-9)


def test_a_prior_that_outweighs_the_image_leaves_all_eigenvalues_at_one(composite: hs.Scenario) -> None:
    known, true = jacobians(composite, 0.5, 3)
    prior = np.full(6, 1e18)
    np.testing.assert_allclose(loop_matrix(known, true, prior, prior), np.eye(6), rtol=0, atol=1e-9)
    stiff = drift.analyse(composite.updated({"controller.composite.prior": 1e14}))
    assert pattern_of(stiff, WORST).start == pytest.approx(1.0, abs=1e-4)


def test_damping_in_the_inverse_alone() -> None:
    """Orthogonal columns of length s: by hand s^2/(s^2 + M) on the diagonal, and (s^2 + M_e)/(s^2 + M) with M_e."""
    columns = np.linalg.qr(np.random.default_rng(4).normal(size=(8, 6)))[0]
    length = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    jacobian, damping = columns * length, np.array([1.0, 0.5, 2.0, 4.0, 0.0, 9.0])
    expected = np.diag(length**2 / (length**2 + damping))
    np.testing.assert_allclose(loop_matrix(jacobian, jacobian, damping, np.zeros(6)), expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(loop_matrix(jacobian, jacobian, damping, damping), np.eye(6), rtol=0, atol=1e-14)
    # one column that the controller sees with the wrong sign turns its eigenvalue around
    wrong = jacobian * [-1, 1, 1, 1, 1, 1]
    values = np.linalg.eigvals(loop_matrix(wrong, jacobian, np.zeros(6), np.zeros(6)))
    np.testing.assert_allclose(np.sort(values.real), [-1, 1, 1, 1, 1, 1], rtol=0, atol=1e-12)


# ---- The known numbers of the paper's task --------------------------------------------------------------------------


def test_the_smallest_eigenvalue_and_its_signs(found: Drift) -> None:
    worst = size_of(found, 0.3).worst
    assert worst.signs == WORST
    assert worst.start == pytest.approx(0.0055, rel=0.01)
    assert worst.time_constant == pytest.approx(45.0, rel=0.01)
    assert WORST in found.section().sentences[0]


@pytest.mark.parametrize("size", [0.05, 0.3])
def test_without_the_prior_most_unequal_signs_are_unstable(size: float, found: Drift) -> None:
    of_size = size_of(found, size)
    assert of_size.negative == (0, 0)
    assert of_size.negative_image_only == (11, 13)
    assert of_size.negative_inverse_only == (11, 13)


def test_equal_signs_are_solved_by_hand(found: Drift) -> None:
    """Translations have (1 + delta) without a prior and 1 with an overwhelming one, rotations 1: M lies between."""
    assert pattern_of(found, "(+,+,+,+)").start == pytest.approx(1.0, abs=1e-6)
    assert 0.7 < pattern_of(found, "(-,-,-,-)").start < 1.0


def test_the_creep_ends_where_documented(found: Drift) -> None:
    """docs/model.md, section 8: 20.1 mm, 0.285 px and 15.7 mm of stroke, and a time constant of the rest of 50 s."""
    worst = pattern_of(found, WORST)
    assert worst.end is not None
    assert np.linalg.norm(worst.end[:3]) == pytest.approx(0.0201, abs=0.5e-4)
    assert worst.end_error == pytest.approx(0.285, abs=0.5e-3)
    assert worst.end_travel == pytest.approx(0.0157, abs=0.5e-4)
    assert worst.end_time_constant == pytest.approx(50.0, rel=0.02)


def test_the_limit_is_where_the_first_pattern_turns(found: Drift, composite: hs.Scenario) -> None:
    assert found.limit_start is not None
    assert found.limit_goal is not None
    for limit, place in ((found.limit_start, "start"), (found.limit_goal, "goal")):
        below, above = (
            drift.analyse(composite.updated({"uncertainty.depth": factor * limit})) for factor in (0.999, 1.001)
        )
        smallest = [min(getattr(p, place) for p in size_of(d, d.sizes[-1].size).patterns) for d in (below, above)]
        assert smallest[0] > 0 > smallest[1]


# ---- Against the law's own pose error -------------------------------------------------------------------------------


def slopes_of_the_law(scenario: hs.Scenario, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minus the derivatives of the core's pose error and of its springs by a displacement from home, (6, 6) each.

    Errors are those of the depths, (p,).
    """
    rest = Rest(scenario)

    def law(poses: Poses) -> Any:
        features, depth = rest.image(poses)
        return rest.probe.law(features, (1 + errors) * depth, poses.position, poses.quaternion, np.zeros((12, 6)))

    def springs(poses: Poses) -> np.ndarray:
        parts = law(poses).parts
        return np.asarray(parts["pose_spring"] + parts["image_spring"])

    steps = np.full(6, 1e-6)
    slope = by_displacement(lambda poses: np.asarray(law(poses).pose_error), rest.home, steps)
    return -slope, -by_displacement(springs, rest.home, steps)


def learning_at_rest(scenario: hs.Scenario) -> np.ndarray:
    """Give kappa = |phi-bar|^2/Psi (6,) by the memberships of the core's law at home, which is the goal."""
    rest = Rest(scenario)
    home = rest.home.rows
    law = rest.probe.law(*rest.image(home), home.position, home.quaternion, np.zeros((1, 6)))
    assert law.error_memberships is not None
    assert law.rate_memberships is not None
    length = np.sum(law.error_memberships[0] ** 2, axis=1) * np.sum(law.rate_memberships[0] ** 2, axis=1)
    return np.asarray(length / np.broadcast_to(scenario.controller.composite.fuzzy.adaptation, 6))


@pytest.mark.parametrize(
    "changes",
    [
        {"target.weights": [1, 1, 0.25, 1]},
        {"uncertainty.mount.rotation": [0.05, 0.03, 0.4]},
        {
            "uncertainty.mount": {"position": [0.01, -0.02, 0.005], "rotation": [0.1, 0, -0.2]},
            "camera.mount.on": "base",
        },
    ],
)
def test_rates_are_those_of_the_pose_error_by_finite_differences(
    changes: dict[str, Any], composite: hs.Scenario
) -> None:
    """The goal is home: there e and the remaining image error are zero, so E is exact, at the start and at the end."""
    scenario = composite.updated({"target.desired_features": composite.target.initial_features, **changes})
    drives = np.array([4.0, 3.0, 2.0, 5.0, 1.0, 6.0])
    scenario = scenario.updated({"controller.composite.drive": drives.tolist()})
    result = drift.analyse(scenario)
    gains = scenario.controller.composite
    damping = np.broadcast_to(gains.kd, 6)[:, None]
    learning = np.diag(learning_at_rest(scenario))
    for pattern in size_of(result, 0.3).patterns:
        slope, spring = slopes_of_the_law(scenario, pattern.errors)
        # chi'' = -K_d^-1 ((kappa + spring) chi' + kappa Lambda slope chi), as a system of first order
        pull = learning * drives @ slope
        system = np.block([[np.zeros((6, 6)), np.eye(6)], [-pull / damping, -(learning + spring) / damping]])
        rate = -np.linalg.eigvals(system).real.max()
        # differences of 1e-6 leave about 1e-10 of slope, times the condition of the eigenvectors and the drive
        assert pattern.rate == pytest.approx(rate, abs=1e-6)
        assert pattern.start == pytest.approx(np.linalg.eigvals(slope).real.min(), abs=1e-6)
        if pattern.end is None:
            assert rate < 0
            continue
        np.testing.assert_allclose(pattern.end, 0.0, rtol=0, atol=1e-9)
        assert pattern.end_rate == pytest.approx(rate, abs=1e-6)


def test_points_of_unequal_weight_have_all_their_ends(composite: hs.Scenario) -> None:
    result = drift.analyse(composite.updated({"target.weights": [1, 1, 0.25, 1]}))
    patterns = size_of(result, 0.3).patterns
    assert all(p.start > 0 for p in patterns)
    assert all(p.end is not None for p in patterns)


# ---- Runs -----------------------------------------------------------------------------------------------------------


def test_runs_of_a_minute_end_where_predicted(found: Drift, composite: hs.Scenario) -> None:
    patterns = size_of(found, 0.3).patterns
    minute = composite.updated({"simulation": {"duration": 60.0, "log_every": 60000}})
    batch = hs.simulate_batch(minute, {"uncertainty.depth": np.array([p.errors for p in patterns])}, threads=1)
    assert (batch.outcome == "completed").all()
    for pattern, position in zip(patterns, batch.samples["position"], strict=True):
        assert pattern.end is not None
        gap = np.linalg.norm(position - np.array(composite.robot.home_position) - pattern.end[:3])
        # what the slowest mode leaves after a minute of a way no longer than from home, and 0.05 mm for the chatter
        slowest = max(pattern.time_constant, pattern.end_time_constant)
        assert gap < np.linalg.norm(pattern.end[:3]) * math.exp(-60 / slowest) + 5e-5, pattern.signs


@pytest.mark.parametrize(
    ("law", "body"),
    [
        ("composite", {}),
        ("computed_torque", {}),
        ("composite", {"robot.payload": {"mass": 0.01, "position": [0.005, -0.003, -0.01], "known": True}}),
        ("computed_torque", {"robot.payload": {"mass": 0.01, "position": [0.005, -0.003, -0.01], "known": True}}),
        ("composite", {"robot.payload": {"mass": 0.01, "position": [0.005, 0.0, -0.01], "known": False}}),
    ],
)
def test_a_run_creeps_with_the_time_constant(law: str, body: dict[str, Any], composite: hs.Scenario) -> None:
    scenario = composite.updated(
        {
            **body,
            "controller.law": law,
            "uncertainty.depth": [0.3, -0.3, -0.3, 0.3],
            "simulation": {"duration": 60.0, "log_every": 1000},
        }
    )
    own = drift.analyse(scenario).own
    assert own is not None
    assert own.end is not None
    result = hs.simulate(scenario)
    gap = np.linalg.norm(result.position - result.position[0] - own.end[:3], axis=1)
    early, late = gap[20], gap[50]
    measured = 30.0 / math.log(early / late)
    # the loop matrix leaves out how the Jacobians turn under the 0.28 px that remain
    assert measured == pytest.approx(own.end_time_constant, rel=0.03)
    assert measured == pytest.approx(own.time_constant, rel=0.15)  # the start's is that of another pose


@pytest.mark.parametrize(
    ("signs", "positions"), [([1, -1, -1, 1], False), ([-1, 1, 1, -1], False), ([1, -1, -1, 1], True)]
)
def test_a_run_with_prediction_creeps_with_the_longer_time_constant(
    signs: list[int], positions: bool, composite: hs.Scenario
) -> None:
    """Frames of 100 ms that arrive after 100 ms: 0.7 times the rate of a perfect camera."""
    changes = {**camera_with_prediction(0.1), "uncertainty.depth": [0.3 * sign for sign in signs]}
    scenario = (positioned(composite) if positions else composite).updated(
        {**changes, "simulation.duration": 60.0, "simulation.log_every": 500}
    )
    own = drift.analyse(scenario).own
    assert own is not None
    assert own.end is not None
    result = hs.simulate(scenario)
    gap = np.linalg.norm(result.position - result.position[0] - own.end[:3], axis=1)
    measured = math.log(gap[30] / gap[50]) / 20.0
    assert measured == pytest.approx(own.end_rate, rel=0.03)  # as without prediction
    perfect = drift.analyse(scenario.updated({"camera.prediction": "none"})).own
    assert perfect is not None
    assert own.end_rate < 0.7 * perfect.end_rate


def test_resolved_rate_drifts_away_as_fast_as_its_eigenvalue_says(paper: hs.Scenario) -> None:
    """A hundredth of the task, so that the drift stays small: (+,-,+,+), exact dynamics."""
    start = np.array(paper.target.initial_features)
    near = start + 0.01 * (np.array(paper.target.desired_features) - start)
    scenario = paper.updated(
        {
            "controller.law": "resolved_rate",
            "target.desired_features": near.tolist(),
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "gravity": 0.0, "depth": [0.3, -0.3, 0.3, 0.3]},
            "simulation": {"duration": 8.0, "log_every": 100},
        }
    )
    result = drift.analyse(scenario)
    assert result.own is not None
    assert result.own.rate < 0
    assert result.own.end is None
    assert result.section().verdict == "bad"
    run = hs.simulate(scenario)
    goals = find_goals(scene_of(scenario))
    assert goals is not None
    goal = goals.shown_at
    assert goal is not None
    gap = np.linalg.norm(run.position - goal.position, axis=1)
    growth = math.log(gap[80] / gap[60]) / 2.0
    # beside the fastest mode slower ones are left after 6 s
    assert growth == pytest.approx(-result.own.rate, rel=0.05)


def test_a_rounded_goal_image_has_a_goal_pose() -> None:
    """Of `fails-leg-limits` the best pose leaves 3e-5 px: a rotation about the optical axis, which changes no rate."""
    found = drift.analyse(hs.load_scenario("fails-leg-limits"))
    assert found.has_goal
    assert found.sizes[0].worst.goal == pytest.approx(found.sizes[0].worst.start, rel=1e-4)


# ---- Against the linear loop of camera_rate -------------------------------------------------------------------------


def slowest_of_loop(scenario: hs.Scenario) -> float:
    """Growth of the slowest mode of the linear loop at its goal [1/s], in continuous mode with a perfect camera."""
    at_rest = loop_at_rest(scenario)
    clock = Clock(1, 0) if at_rest.as_if_sampled else clock_of(at_rest.scenario)
    return float(exponents(at_rest.free, clock)[0].real)


def weak_prior(factor: float, **changes: Any) -> hs.Scenario:
    """Give a scenario of unequal depths in which no eigenvalue of E is negative, with drives of unequal axes."""
    scenario = hs.load_scenario("moog-6dof2000e")
    plain = {
        "controller.composite.prior": (0.0212 * np.array(scenario.controller.composite.prior)).tolist(),
        "controller.composite.drive": [4.0 * factor] * 3 + [1.4 * factor] * 3,
        "controller.composite.kv": 0.0,
        "uncertainty.depth": [-0.555, -0.555, 0.555, 0.555],
        "robot.centre_of_mass": [0.0, 0.0, 0.0],
        "robot.payload": {"mass": 0.0, "position": [0.0] * 3, "inertia": [0.0] * 3},
    }
    return scenario.updated({**plain, **changes})


def test_gains_that_differ_between_axes_may_drift_away_though_no_eigenvalue_is_negative() -> None:
    scenario = weak_prior(10.0, **{"camera.period": None, "camera.latency": 0.0})
    result = drift.analyse(scenario)
    assert result.own is not None
    assert min(result.own.start, result.own.goal) > 0.0
    assert result.own.slowest < 0.0
    # the loop's own growth is that at its rest, of the goal; inertia is left out of the rate
    assert result.own.goal_rate == pytest.approx(-slowest_of_loop(scenario), rel=0.1)
    section = result.section()
    assert section.verdict == "bad"
    assert any("own depth errors" in text and "grows e-fold in" in text for text in section.sentences)
    assert max(limit for limit in (result.limit_start, result.limit_goal) if limit is not None) < 0.555
    own = size_of(result, 0.555)
    assert own.worst.slowest == pytest.approx(min(p.slowest for p in own.patterns), abs=1e-9)
    assert own.negative[0] >= 1
    # with the machine's own camera, of 34 ms and 34 ms, prediction holds that mode
    late = drift.analyse(weak_prior(10.0))
    assert late.own is not None
    assert late.own.slowest > 0.0
    assert slowest_of_loop(weak_prior(10.0)) < 0.0


@pytest.mark.parametrize(
    ("law", "gains", "time"),
    [
        ("composite", {}, 0.034),
        ("composite", {}, 0.1),
        ("composite", {"fuzzy.adaptation": [0.5] * 3 + [150.0] * 3}, 0.1),  # springs much stiffer than what is learned
        ("composite", {"fuzzy.enabled": False}, 0.1),
        ("composite", {"fuzzy.enabled": False, "kp": 1e-6}, 0.1),
        ("computed_torque", {}, 0.1),
        ("resolved_rate", {}, 0.1),
    ],
)
def test_prediction_slows_the_drift_by_the_age_of_the_image(
    law: str, gains: dict[str, Any], time: float, composite: hs.Scenario
) -> None:
    """Against the linear loop at the scenario's clocks. The goal is home, where e is zero and E exact."""
    scenario = composite.updated(
        {
            **camera_with_prediction(time),
            "controller.law": law,
            **{f"controller.{law}.{key}": value for key, value in gains.items()},
            "target.desired_features": composite.target.initial_features,
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "gravity": 0.0},
        }
    )
    predicted, held = (drift.analyse(scenario.updated({"camera.prediction": way})) for way in ("encoder", "none"))
    for signs in (WORST, "(-,+,+,-)", "(+,-,+,+)", "(+,+,-,-)"):
        pattern = pattern_of(predicted, signs)
        loop = slowest_of_loop(scenario.updated({"uncertainty.depth": pattern.errors.tolist()}))
        # inertia is left out, and of the age all but its mean
        assert pattern.rate == pytest.approx(-loop, rel=0.03)
        assert abs(pattern.rate) < 0.95 * abs(pattern_of(held, signs).rate)
    age = f"carried on over {1e3 * (1.5 * time - 0.001):.3g} ms, its mean age"
    assert age in predicted.section().sentences[1]
    assert "age" not in held.section().sentences[1]


def camera_with_prediction(time: float) -> dict[str, Any]:
    """Give a sampled loop with frames of a period and a latency of so many seconds, predicted, without K_v."""
    return {
        "simulation": {"mode": "sampled", "step": 0.002},
        "camera": {"period": time, "latency": time, "prediction": "encoder", "noise": 0.0},
        "controller.switching.kind": "implicit",
        "controller.composite.kv": 0.0,
    }


@pytest.mark.parametrize(("adaptation", "drive"), [(50.0, 4.0), (50.0, 0.5), (1.0, 4.0)])
def test_springs_stiffer_than_what_is_learned_slow_the_drift(
    adaptation: float, drive: float, composite: hs.Scenario
) -> None:
    scenario = composite.updated(
        {
            "uncertainty": {"depth": 0.0, "inertia": 0.0, "coriolis": 0.0, "gravity": 0.0},
            "controller.composite.drive": drive,
            "controller.composite.fuzzy.adaptation": [0.01 * adaptation] * 3 + [3.0 * adaptation] * 3,
        }
    )
    result = drift.analyse(scenario)
    assert result.own is not None
    # inertia, which the drift leaves out, and the tick are the rest
    assert result.own.goal_rate == pytest.approx(-slowest_of_loop(scenario), rel=0.03)


def test_a_spring_that_pushes_away_is_not_taken_for_a_drift_that_decays(composite: hs.Scenario) -> None:
    """Where K_t E outweighs kappa both turn their signs, and chi-dot = (kappa + K_t E)^-1 kappa Lambda e decays."""
    scenario = composite.updated(
        {
            "uncertainty.depth": [0.5, -0.5, -0.5, 0.5],
            "controller.composite.prior": 1.0,
            "controller.composite.kt": [600.0] * 3 + [1.5] * 3,
            "controller.composite.fuzzy.adaptation": [1.0] * 3 + [300.0] * 3,
        }
    )
    result = drift.analyse(scenario)
    assert result.own is not None
    assert result.own.rate < 0.0
    assert slowest_of_loop(scenario) > 0.0
    assert result.section().verdict == "bad"


def test_an_image_spring_that_pushes_away_counts_without_fuzzy_systems(composite: hs.Scenario) -> None:
    """The rates are those of both springs over the damping, by finite differences where the image error is zero."""
    home = {"target.desired_features": composite.target.initial_features, "controller.composite.fuzzy.enabled": False}
    scenario = composite.updated({**home, "controller.composite.kp": 3e-6})
    result = drift.analyse(scenario)
    for pattern in size_of(result, 0.3).patterns:
        spring = slopes_of_the_law(scenario, pattern.errors)[1] / np.broadcast_to(composite.controller.gains.kd, 6)
        assert pattern.rate == pytest.approx(np.linalg.eigvals(spring).real.min(), abs=1e-5)
    worst = pattern_of(result, WORST)
    assert worst.start > 0.0
    assert worst.rate < 0.0
    own = {"uncertainty.depth": [0.3, -0.3, -0.3, 0.3]}
    assert drift.analyse(scenario.updated(own)).section().verdict == "bad"


def test_without_fuzzy_systems_a_drift_ends_where_the_springs_balance(composite: hs.Scenario) -> None:
    scenario = composite.updated(
        {
            "uncertainty.depth": [0.3, -0.3, -0.3, 0.3],
            "controller.composite.fuzzy.enabled": False,
            "controller.composite.kp": 1e-6,
        }
    )
    own = drift.analyse(scenario).own
    assert own is not None
    assert own.end is not None
    rest = Rest(scenario)
    end = rest.home.moved(own.end[None])
    np.testing.assert_allclose(rest.spring(end) / scenario.controller.gains.kt, 0.0, atol=1e-9)
    assert np.abs(rest.pose_error(end)).max() > 1e-5


@pytest.mark.parametrize(
    ("law", "changes", "keys"),
    [
        ("resolved_rate", {"gain": 0.0}, "controller.resolved_rate.gain"),
        ("computed_torque", {"kp": 0.0}, "controller.computed_torque.kp"),
        ("composite", {"kt": 0.0, "kp": 0.0, "fuzzy.enabled": False}, "kt and controller.composite.kp"),
        ("composite", {"drive": 0.0}, "controller.composite.drive"),
    ],
)
def test_gains_of_zero_leave_nothing_to_drift(law: str, changes: dict[str, Any], keys: str, paper: hs.Scenario) -> None:
    gains = {f"controller.{law}.{key}": value for key, value in changes.items()}
    section = drift.analyse(paper.updated({"controller.law": law, **gains})).section()
    assert section.verdict == "open"
    assert f"{keys}: expected a gain above 0 in some axis, got 0 in all" in section.sentences[0]


def test_axes_without_a_drive_are_excluded(composite: hs.Scenario) -> None:
    result = drift.analyse(composite.updated({"controller.composite.drive": [4.0, 4.0, 4.0, 4.0, 4.0, 0.0]}))
    assert result.springs == 1
    assert result.own is not None
    assert result.own.rate > 0.1
    assert result.own.end is None  # where that axis stays depends on the start
    assert result.section().verdict == "good"
    assert any("In 1 of the axes no pose error drives" in text for text in result.section().sentences)


# ---- Where it does not apply, and its text --------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["hybrid", "kelly", "pbvs"])
def test_other_laws_get_no_numbers(law: str, paper: hs.Scenario) -> None:
    section = drift.analyse(paper.updated({"controller.law": law})).section()
    assert section.verdict == "open"
    assert not section.items
    assert section.data["applies"] is False


@pytest.mark.parametrize(
    "changes",
    [
        {"camera.convention": "as_printed"},
        {"controller.jacobian": "printed"},
        {"controller.law": "resolved_rate", "controller.resolved_rate.jacobian_at": "desired"},
    ],
)
def test_where_the_matrix_has_no_meaning_it_is_open(changes: dict[str, str], composite: hs.Scenario) -> None:
    assert drift.analyse(composite.updated(changes)).section().verdict == "open"


def test_the_scenarios_own_errors_decide_the_verdict(composite: hs.Scenario) -> None:
    good = drift.analyse(composite.updated({"uncertainty.depth": [0.3, -0.3, -0.3, 0.3]}))
    assert good.section().verdict == "good"
    short = drift.analyse(
        composite.updated({"uncertainty.depth": [0.3, -0.3, -0.3, 0.3], "robot.stroke": 0.015})
    ).section()
    assert short.verdict == "warning"
    assert any("beyond the stroke of 15 mm" in sentence for sentence in short.sentences)
    bad = drift.analyse(composite.updated({"uncertainty.depth": [0.4, -0.4, -0.4, 0.4]})).section()
    assert bad.verdict == "bad"
    assert "drifts away" in bad.sentences[1]


def test_without_an_expected_prior_no_end_is_missed(paper: hs.Scenario) -> None:
    """Damping in the inverse alone bounds no drift: a law that creeps everywhere has a goal, and no end to search."""
    result = drift.analyse(paper.updated({"controller.law": "resolved_rate", "uncertainty.depth": 1e-4}))
    assert not result.has_prior
    assert result.own is not None
    assert result.own.end is None
    assert all(min(p.start, p.goal) > 0 for p in size_of(result, 1e-4).patterns)
    assert result.section().verdict == "good"


def test_the_start_is_that_of_the_run(composite: hs.Scenario) -> None:
    away = [0.004, -0.003, 0.002, 0.02, 0.03, -0.05]
    scenario = composite.updated({"simulation.start.pose": away})
    rest = Rest(scenario)
    features, depth = rest.image(rest.start)
    result = drift.analyse(scenario)
    for pattern in size_of(result, 0.3).patterns:
        known = rest.jacobian(features, (1 + pattern.errors) * depth, rest.start)
        matrix = loop_matrix(known, rest.jacobian(features, depth, rest.start), PRIOR, PRIOR)
        assert pattern.start == pytest.approx(np.linalg.eigvals(matrix).real.min(), abs=1e-9)
    at_home = pattern_of(drift.analyse(composite), WORST)
    there = pattern_of(result, WORST)
    assert there.start != pytest.approx(at_home.start, rel=0.01)
    assert there.end is not None
    assert at_home.end is not None
    np.testing.assert_allclose(there.end, at_home.end, rtol=0, atol=1e-7)  # the same pose, and counted from home


def test_a_sampled_scenario_without_prediction_has_the_same_numbers(found: Drift, composite: hs.Scenario) -> None:
    """Whatever its servo period and its camera's times are: nothing of them is in the rates."""
    sampled = composite.updated(
        {
            "simulation": {"mode": "sampled", "step": 0.002},
            "camera.period": 0.034,
            "controller.switching.kind": "implicit",
        }
    )
    for one, two in zip(drift.analyse(sampled).sizes, found.sizes, strict=True):
        assert [p.start for p in one.patterns] == [p.start for p in two.patterns]
        assert [p.rate for p in one.patterns] == [p.rate for p in two.patterns]
        assert [p.end_error for p in one.patterns] == [p.end_error for p in two.patterns]


def test_an_image_that_no_pose_shows_leaves_the_goal_out(composite: hs.Scenario) -> None:
    bent = [10, 10, 45, -73, -64, 29, -30, -3]  # the last point 20 px off the shift of the others
    result = drift.analyse(composite.updated({"target.desired_features": bent}))
    assert not result.has_goal
    assert result.limit_goal is None
    assert all(math.isnan(p.goal) for p in size_of(result, 0.3).patterns)
    data = hs.analyse(composite.updated({"target.desired_features": bent}), ["drift"]).to_dict()["drift"]
    assert data["sizes"][0]["patterns"][0]["smallest_eigenvalue_goal"] is None


def test_a_virtual_platform_with_damping_creeps_slower(paper: hs.Scenario) -> None:
    """As much damping as the law has halves the rate of `composite` without fuzzy systems (docs/analysis/drift.md)."""
    changes = {"controller__law": "composite", "controller__composite__fuzzy__enabled": False}
    scenario = positioned(paper, **changes)
    kd = scenario.controller.gains.kd
    without, damped = (
        drift.analyse(scenario.updated({"controller.virtual_platform.damping": damping})).own for damping in (0.0, kd)
    )
    assert without is not None
    assert damped is not None
    assert damped.rate == pytest.approx(0.5 * without.rate, rel=1e-9)
    torque = positioned(paper, controller__law="computed_torque")
    scene = Rest(torque)
    (inertia,) = scene.probe.inertia(scene.home.rows.quaternion)
    own = np.diag(inertia) * np.broadcast_to(torque.controller.gains.kd, 6)
    slow = drift.analyse(torque.updated({"controller.virtual_platform.damping": (0.1 * own).tolist()})).own
    fast = drift.analyse(torque).own
    assert slow is not None
    assert fast is not None
    np.testing.assert_allclose(inertia, np.diag(np.diag(inertia)), atol=1e-15)  # so that it is the same in every axis
    assert slow.rate == pytest.approx(fast.rate / 1.1, rel=1e-9)


def test_an_end_beyond_a_joint_limit_is_a_warning(composite: hs.Scenario) -> None:
    own = drift.analyse(composite).own
    assert own is not None
    assert own.end is not None
    rest = Rest(composite)
    tilt = float(rest.leg_tilts(rest.home.moved(own.end))[0].max())
    wide, narrow = (
        drift.analyse(composite.updated({"robot.joint_limit": [share * tilt, 3.0]})) for share in (1.05, 0.95)
    )
    assert wide.section().verdict == "good"
    assert narrow.section().verdict == "warning"
    assert any("beyond a joint limit" in sentence for sentence in narrow.section().sentences)


def test_directions_are_those_of_the_eigenvectors(found: Drift, composite: hs.Scenario) -> None:
    rest = Rest(composite)
    worst = pattern_of(found, WORST)
    features, depth = rest.image(rest.home)
    known = rest.jacobian(features, (1 + worst.errors) * depth, rest.home)
    matrix = loop_matrix(known, rest.jacobian(features, depth, rest.home), PRIOR, PRIOR)
    np.testing.assert_allclose(matrix @ worst.direction, worst.start * worst.direction, rtol=0, atol=1e-9)
