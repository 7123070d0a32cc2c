"""The parts of a loop at given states: against the run itself, the servo tick, closed forms and finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo import _core
from hexservo.run.probe import probe
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]

LAWS = ["hybrid", "composite", "kelly", "resolved_rate", "pbvs", "computed_torque"]
FUZZY_LAWS = ["hybrid", "composite"]
STEP = 1e-3


def states(scenario: hs.Scenario, n: int = 40, seed: int = 7) -> dict[str, Array]:
    """Poses near home with their true images, quaternions of any length, and twists."""
    random = np.random.default_rng(seed)
    position = np.asarray(scenario.robot.home_position) + random.uniform(-0.01, 0.01, (n, 3))
    quaternion = np.array([1.0, 0, 0, 0]) + random.uniform(-0.05, 0.05, (n, 4))
    quaternion *= random.uniform(0.5, 2.0, (n, 1))
    twist = random.uniform(-1, 1, (n, 6)) * [0.02, 0.02, 0.02, 0.2, 0.2, 0.2]
    features, depth = probe(scenario).image(position, quaternion)
    return {"features": features, "depth": depth, "position": position, "quaternion": quaternion, "twist": twist}


def believed(scenario: hs.Scenario, at: dict[str, Array]) -> dict[str, Array]:
    """The same as the controller sees it."""
    return at | {"depth": probe(scenario).measured_depth(at["depth"])}


def logged(result: hs.Result) -> dict[str, Array]:
    """The samples of a run as states, true depths."""
    return {name: getattr(result, name) for name in ("features", "depth", "position", "quaternion", "twist")}


# ---- Camera ---------------------------------------------------------------------------------------------------------


def test_the_image_is_that_of_the_run(paper: hs.Scenario) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.5}))
    features, depth = probe(paper).image(result.position, result.quaternion)
    np.testing.assert_allclose(features, result.features, rtol=0, atol=1e-12)
    np.testing.assert_allclose(depth, result.depth, rtol=0, atol=2e-15)  # a kernel may fuse products and sums


def test_a_point_that_is_not_in_front_has_no_features(paper: hs.Scenario) -> None:
    home = np.asarray(paper.robot.home_position)
    beyond = home - np.array([0, 0, 0.6])  # the target is 0.5 m above the platform; z points down
    features, depth = probe(paper).image([home, beyond], [[1, 0, 0, 0]] * 2)
    assert np.isfinite(features[0]).all()
    assert (depth[0] < 0).all()
    assert np.isnan(features[1]).all()
    np.testing.assert_allclose(depth[1], 0.1, atol=1e-12)


def test_some_points_in_front_and_some_behind(paper: hs.Scenario) -> None:
    """A quarter turn about x, by hand: X' = X, Y' = Z, Z' = -Y = y Z/f, and so x' = f x/y, y' = -f^2/y."""
    home = np.asarray(paper.robot.home_position)
    features, depth = probe(paper).image([home, home], [[1, 0, 0, 0], [1, 1, 0, 0]])
    x, y = features[0].reshape(4, 2).T
    focal = paper.camera.focal_length * paper.camera.pixel_scale
    np.testing.assert_allclose(depth[1], y * depth[0] / focal, rtol=1e-12)
    front = y > 0
    assert front.tolist() == [True, False, True, False]
    turned = features[1].reshape(4, 2)
    assert np.isnan(turned[~front]).all()
    np.testing.assert_allclose(turned[front], np.stack([focal * x / y, -(focal**2) / y], axis=1)[front], rtol=1e-11)


@pytest.mark.parametrize(
    ("convention", "jacobian", "plant", "controller"),
    [
        ("eye_in_hand", "consistent", 1, 1),
        ("eye_in_hand", "printed", 1, -1),
        ("as_printed", "consistent", -1, -1),
        ("as_printed", "printed", -1, -1),
    ],
)
def test_the_jacobian_is_the_derivative_of_the_image(
    paper: hs.Scenario, convention: str, jacobian: str, plant: int, controller: int
) -> None:
    """Central differences of the real image; a camera as printed has minus its sign, and so has (8) as printed."""
    at = states(paper)
    quaternion = at["quaternion"] / np.linalg.norm(at["quaternion"], axis=1, keepdims=True)
    small = 1e-6
    ahead, behind = (
        probe(paper).image(*_displaced(at["position"], quaternion, side * small * at["twist"]))[0] for side in (1, -1)
    )
    rate = (ahead - behind) / (2 * small)
    of = probe(
        paper.updated({"camera.convention": convention, "controller.jacobian": jacobian, "simulation.duration": 0.01})
    )
    for sign, is_controller in ((plant, False), (controller, True)):
        matrices = of.image_jacobian(at["features"], at["depth"], at["quaternion"], is_controller)
        assert matrices.shape == (40, 8, 6)
        pushed = np.einsum("nij,nj->ni", matrices, at["twist"])
        np.testing.assert_allclose(sign * pushed, rate, rtol=0, atol=1e-6 * np.abs(rate).max())


def _displaced(position: Array, quaternion: Array, by: Array) -> tuple[Array, Array]:
    """Poses after a displacement: a rotation vector in B is put before the attitude."""
    angle = np.linalg.norm(by[:, 3:], axis=1, keepdims=True)
    w, v = np.cos(angle / 2), np.sin(angle / 2) * by[:, 3:] / angle
    q0, q = quaternion[:, :1], quaternion[:, 1:]
    turned = np.hstack([w * q0 - (v * q).sum(axis=1, keepdims=True), w * q + q0 * v + np.cross(v, q)])
    return position + by[:, :3], turned


def test_the_measured_depth_is_wrong_by_the_scenario(paper: hs.Scenario) -> None:
    scenario = paper.updated({"uncertainty.depth": [0.3, -0.2, 0.0, 0.1]})
    depth = -np.random.default_rng(1).uniform(0.3, 0.8, (20, 4))
    np.testing.assert_allclose(
        probe(scenario).measured_depth(depth), depth * (1 + np.array([0.3, -0.2, 0.0, 0.1])), rtol=1e-15
    )


# ---- Law ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ["tanh", "implicit", "implicit_coupled"])
def test_the_law_is_that_of_a_servo_tick(paper: hs.Scenario, law: str, kind: str) -> None:
    """With the period of the tick, which the implicit switching functions use."""
    period = 2e-3
    scenario = paper.updated(
        {
            "controller.law": law,
            "controller.switching.kind": kind,
            "camera.period": 0.02,
            "simulation": {"mode": "sampled", "step": period},
        }
        | ({f"controller.{law}.fuzzy.initial_scale": 0.01} if law in FUZZY_LAWS else {})
    )
    at = believed(scenario, states(scenario))
    given = probe(scenario).law(**at)
    controller = _core.Controller(core_parameters(scenario), period)
    for i in range(40):
        controller.reset()
        wrench, _, fuzzy_output, status, *_ = controller.step(**{name: values[i] for name, values in at.items()})
        assert status is _core.InputStatus.valid
        np.testing.assert_array_equal(given.wrench[i], wrench)
        np.testing.assert_array_equal(given.fuzzy_output[i], fuzzy_output)
    assert np.isfinite(given.wrench).all()
    assert (given.error_memberships is None) == (law not in FUZZY_LAWS)


def test_pbvs_uses_the_target_points_of_the_run(paper: hs.Scenario) -> None:
    """The wrench of a run with errors of depth, from its samples."""
    scenario = paper.updated({"controller.law": "pbvs", "simulation.duration": 0.3})
    result = hs.simulate(scenario)
    given = probe(scenario).law(**believed(scenario, logged(result)))
    np.testing.assert_allclose(given.wrench, result.wrench, rtol=0, atol=1e-9)


@pytest.mark.parametrize("law", FUZZY_LAWS)
def test_memberships_weights_and_output_belong_together(paper: hs.Scenario, law: str) -> None:
    scenario = paper.updated({"controller.law": law})
    at = states(scenario)
    weights = np.random.default_rng(3).uniform(-1, 1, (40, 6, 7, 7))
    of = probe(scenario)
    given = of.law(**at, weights=weights)
    assert given.error_memberships is not None
    assert given.rate_memberships is not None
    assert given.error_memberships.shape == given.rate_memberships.shape == (40, 6, 7)
    for memberships in (given.error_memberships, given.rate_memberships):
        assert (memberships > 0).all()
        np.testing.assert_allclose(memberships.sum(axis=2), 1, rtol=1e-14)
    output = np.einsum("njr,njrc,njc->nj", given.error_memberships, weights, given.rate_memberships)
    np.testing.assert_allclose(given.fuzzy_output, output, rtol=0, atol=1e-14)
    # tau = ... - tau_f: the wrench without it does not depend on the weights (no implicit switching here)
    without = of.law(**at, weights=np.zeros_like(weights))
    np.testing.assert_array_equal(without.fuzzy_output, np.zeros((40, 6)))
    np.testing.assert_allclose(given.wrench + given.fuzzy_output, without.wrench, rtol=0, atol=1e-14)
    # what is not given is what the scenario starts with
    start = of.initial_weights
    assert start is not None
    default = of.law(**at)
    np.testing.assert_array_equal(default.wrench, of.law(**at, weights=np.tile(start, (40, 1, 1, 1))).wrench)


def test_the_adaptation_of_the_hybrid_law(paper: hs.Scenario) -> None:
    """(22): the twist over Psi, and with a dead zone what is beyond it."""
    at = states(paper)
    psi = np.array([10.0, 11, 12, 13, 14, 15])
    plain = probe(paper.updated({"controller.hybrid.fuzzy.adaptation": psi.tolist()})).law(**at)
    assert plain.adaptation is not None
    np.testing.assert_allclose(plain.adaptation, at["twist"] / psi, rtol=1e-15)
    zone = np.array([0.01, 0.01, 0.01, 0.1, 0.1, 0.1])
    limited = probe(
        paper.updated(
            {
                "controller.hybrid.fuzzy.adaptation": psi.tolist(),
                "controller.hybrid.fuzzy.dead_zone": zone.tolist(),
                "controller.hybrid.fuzzy.leakage": 2.0,
            }
        )
    ).law(**at)
    beyond = np.sign(at["twist"]) * np.maximum(np.abs(at["twist"]) - zone, 0)
    assert limited.adaptation is not None
    np.testing.assert_allclose(limited.adaptation, beyond / psi, rtol=0, atol=1e-17)
    assert (limited.adaptation == 0).any()
    assert (limited.adaptation != 0).any()


def test_fuzzy_systems_that_are_switched_off(paper: hs.Scenario) -> None:
    scenario = paper.updated({"controller.hybrid.fuzzy.enabled": False})
    of = probe(scenario)
    at = states(scenario)
    given = of.law(**at)
    assert not of.has_fuzzy_systems
    assert of.initial_weights is None
    assert given.error_memberships is given.rate_memberships is given.adaptation is None
    np.testing.assert_array_equal(given.fuzzy_output, np.zeros((40, 6)))
    with pytest.raises(ValueError, match=r"^weights: expected none, since no fuzzy systems act, got "):
        of.law(**at, weights=np.zeros((40, 6, 7, 7)))


def test_a_term_of_the_law_by_a_gain_of_zero(paper: hs.Scenario) -> None:
    """K_v sw(chi-dot) as the difference of two laws, with tanh: its closed form."""
    scenario = paper.updated({"controller.switching": {"kind": "tanh", "width": 2e-3}})
    at = believed(scenario, states(scenario))
    without = probe(scenario.updated({"controller.hybrid.kv": 0.0})).law(**at)
    term = without.wrench - probe(scenario).law(**at).wrench
    kv = np.array([2e-3] * 3 + [1e-4] * 3)
    np.testing.assert_allclose(term, kv * np.tanh(at["twist"] / 2e-3), rtol=0, atol=1e-15)


# By law: gains whose parts are taken out one after another, in an order in which none changes what is left.
BY_ZERO: dict[str, list[tuple[str, dict[str, Any]]]] = {
    "hybrid": [("switching", {"kv": 0.0}), ("fuzzy", {"fuzzy.enabled": False})],
    "composite": [
        ("switching", {"kv": 0.0}),
        ("damping", {"kd": 0.0}),
        ("pose_spring", {"kt": 0.0}),
        ("fuzzy", {"fuzzy.enabled": False}),
    ],
    "kelly": [("damping", {"kd": 0.0})],
    "resolved_rate": [("reference", {"gain": 0.0})],
    "pbvs": [("damping", {"kd": 0.0})],
    "computed_torque": [("damping", {"kd": 0.0}), ("pose_spring", {"kp": 0.0})],
}


@pytest.mark.parametrize("kind", ["tanh", "implicit_coupled"])
@pytest.mark.parametrize("law", LAWS)
def test_parts_are_what_gains_of_zero_take_away(paper: hs.Scenario, law: str, kind: str) -> None:
    """Each part but the last as the difference of two laws; the last is what is left beside the weight."""
    mode = {"simulation.mode": "sampled"} if kind.startswith("implicit") else {}
    scenario = paper.updated({"controller.law": law, "controller.switching.kind": kind, **mode})
    if law in FUZZY_LAWS:
        scenario = scenario.updated({f"controller.{law}.fuzzy.initial_scale": 0.01})
    at = believed(scenario, states(scenario))
    given = probe(scenario).law(**at)
    gravity = probe(scenario).estimated_wrenches(at["quaternion"][:1], np.zeros((1, 6)), np.zeros((1, 6)))[2]
    assert tuple(given.parts) == _core.LAW_TRAITS[law].parts
    scale = sum(np.abs(part) for part in given.parts.values()) + np.abs(gravity)  # of the roundings
    np.testing.assert_allclose((sum(given.parts.values()) + gravity - given.wrench) / scale, 0.0, atol=2e-15)
    left, wrench = dict(given.parts), given.wrench
    for part, gains in BY_ZERO[law]:
        scenario = scenario.updated({f"controller.{law}.{name}": value for name, value in gains.items()})
        without = probe(scenario).law(**at).wrench
        np.testing.assert_allclose((left.pop(part) - (wrench - without)) / scale, 0.0, atol=4e-15, err_msg=part)
        wrench = without
    assert len(left) == 1
    np.testing.assert_allclose((next(iter(left.values())) - (wrench - gravity)) / scale, 0.0, atol=4e-15)


@pytest.mark.parametrize("law", LAWS)
def test_the_pose_error_is_what_its_gain_multiplies(paper: hs.Scenario, law: str) -> None:
    scenario = paper.updated({"controller.law": law})
    at = believed(scenario, states(scenario))
    given = probe(scenario).law(**at)
    if not _core.LAW_TRAITS[law].pose_error:
        assert given.pose_error is None
        return
    assert given.pose_error is not None
    gains = getattr(scenario.controller, law)
    if law == "resolved_rate":
        stiff = gains.gain * np.asarray(gains.ki)
        spring = given.parts["reference"]
    else:
        stiff = np.asarray(gains.kt if law == "composite" else gains.kp)
        spring = given.parts["pose_spring"]
    expected = stiff * given.pose_error
    if law == "computed_torque":
        expected = np.einsum("nij,nj->ni", probe(scenario).inertia(at["quaternion"]), expected)
    np.testing.assert_allclose(spring, expected, rtol=0, atol=1e-14 * np.abs(spring).max())


# ---- Goal and base --------------------------------------------------------------------------------------------------


def test_goal_minima_show_the_goal(paper: hs.Scenario) -> None:
    of = probe(paper)
    features, _ = of.image(*of.goal_minima())
    assert len(features) > 0
    error = np.abs(features - np.asarray(paper.target.desired_features)).max(axis=1)
    assert error.min() < 1e-9  # roundings of features of 1e2 px


def test_minima_of_a_goal_that_no_pose_shows_are_stationary(paper: hs.Scenario) -> None:
    desired = np.asarray(paper.target.desired_features) + np.array([3.0, 0, 0, 0, 0, 0, 0, 2.0])
    of = probe(paper.updated({"target.desired_features": desired.tolist()}))
    position, quaternion = of.goal_minima()
    features, depth = of.image(position, quaternion)
    assert len(features) > 0
    slopes = np.einsum("nij,ni->nj", of.image_jacobian(features, depth, quaternion), desired - features)
    scale = np.linalg.norm(of.image_jacobian(features, depth, quaternion), axis=1) * 5.0  # px/(m, rad) times px
    assert np.abs(slopes / scale).max() < 1e-3  # minima to 2e-3 px of the 5 px


def test_the_base_accelerates_by_the_scenario(paper: hs.Scenario) -> None:
    """A sinusoid and a recording by their formulas; without motion, and in continuous mode, nothing."""
    time = np.linspace(0.0, 0.5, 101)
    base = {"kind": "sinusoid", "amplitude": [0.1, -0.2, 0.3], "frequency": 7.0, "phase": 0.4}
    sampled = paper.updated({"simulation.mode": "sampled"})
    moving = probe(sampled.updated({"base_motion": base})).base_acceleration(time)
    expected = np.sin(2 * np.pi * 7.0 * time + 0.4)[:, None] * [0.1, -0.2, 0.3]
    np.testing.assert_allclose(moving, expected, rtol=0, atol=1e-13)  # roundings of 22 rad, and of the core's sine
    samples = np.random.default_rng(4).uniform(-1, 1, (6, 3))
    recorded = {"kind": "recorded", "samples": samples.tolist(), "sample_period": 0.05}
    found = probe(sampled.updated({"base_motion": recorded})).base_acceleration(time)
    within = time <= 0.25 * (1 + 1e-12)
    for axis in range(3):
        line = np.interp(time, 0.05 * np.arange(6), samples[:, axis]) * within
        np.testing.assert_allclose(found[:, axis], line, rtol=0, atol=1e-13)
    for still in (sampled, paper):
        np.testing.assert_array_equal(probe(still).base_acceleration(time), np.zeros((101, 3)))
    for bad, sentence in (
        ([-1e-3], r"time\[0\]: expected a time >= 0, got -0.001"),
        ([0.0, np.nan], r"time\[1\]: expected a finite number, got -?nan"),
        ([[0.0]], r"time: expected numbers of shape \(n,\), got shape \(1, 1\)"),
    ):
        with pytest.raises(ValueError, match=f"^{sentence}"):
            probe(paper).base_acceleration(bad)


# ---- Plant ----------------------------------------------------------------------------------------------------------


def test_acceleration_and_estimates_balance_the_wrench(paper: hs.Scenario) -> None:
    """(3): (1 - delta_D) D chi-ddot + (1 - delta_C) C chi-dot + (1 - delta_G) G = tau, all entries alike."""
    scenario = paper.updated({"uncertainty": {"inertia": 0.075, "coriolis": 0.125, "gravity": 0.05}})
    of, at = probe(scenario), states(scenario)
    wrench = np.random.default_rng(5).uniform(-1, 1, (40, 6)) * [1, 1, 1, 0.01, 0.01, 0.01]
    acceleration = of.acceleration(at["position"], at["quaternion"], at["twist"], wrench)
    inertial, coriolis, gravity = of.estimated_wrenches(at["quaternion"], at["twist"], acceleration)
    assert gravity.shape == (6,)
    assert np.abs(coriolis[:, 3:]).max() > 1e-6
    np.testing.assert_allclose(
        0.925 * inertial + 0.875 * coriolis + 0.95 * gravity, wrench, rtol=0, atol=1e-15 * np.abs(wrench).max() * 10
    )
    np.testing.assert_allclose(
        inertial, np.einsum("nij,nj->ni", of.inertia(at["quaternion"]), acceleration), rtol=1e-13
    )
    elsewhere = of.acceleration(at["position"] + 0.1, at["quaternion"], at["twist"], wrench)
    np.testing.assert_array_equal(elsewhere, acceleration)


def test_the_gyroscopic_wrench_of_a_turning_platform(paper: hs.Scenario) -> None:
    """By hand: at home, omega x I omega with I = diag(1.5, 1.5, 3) 1e-4 kg m^2."""
    twist = np.array([[0.1, 0.2, 0.3, 1.0, 2.0, 4.0]])
    inertial, coriolis, gravity = probe(paper).estimated_wrenches([[1, 0, 0, 0]], twist, [[1, 1, 1, 1, 1, 1]])
    np.testing.assert_allclose(coriolis, [[0, 0, 0, 2 * 4 * 1.5e-4, -1 * 4 * 1.5e-4, 0]], rtol=0, atol=1e-18)
    np.testing.assert_allclose(inertial, [[0.06, 0.06, 0.06, 1.5e-4, 1.5e-4, 3e-4]], rtol=1e-14)
    np.testing.assert_allclose(gravity, [0, 0, -0.06 * 9.8, 0, 0, 0], rtol=1e-14)


def test_the_inertia_turns_with_the_platform(paper: hs.Scenario) -> None:
    matrices = probe(paper).inertia(states(paper)["quaternion"])
    np.testing.assert_array_equal(matrices, matrices.transpose(0, 2, 1))
    np.testing.assert_array_equal(matrices[:, :3, :3], np.tile(0.06 * np.eye(3), (40, 1, 1)))
    np.testing.assert_array_equal(matrices[:, :3, 3:], 0)
    principal = np.linalg.eigvalsh(matrices[:, 3:, 3:])
    np.testing.assert_allclose(principal, np.tile([1.5e-4, 1.5e-4, 3e-4], (40, 1)), rtol=1e-12)


# ---- Steps ----------------------------------------------------------------------------------------------------------

SMOOTH = {"controller.switching.kind": "tanh", "simulation.duration": 1.0}
RUNS: dict[str, dict[str, Any]] = {
    "hybrid": SMOOTH,
    "hybrid, restrained": SMOOTH
    | {
        "controller.hybrid.fuzzy.leakage": 2.0,
        "controller.hybrid.fuzzy.weight_limit": 1e-5,
        "controller.hybrid.fuzzy.dead_zone": 1e-3,
    },
    "as printed": SMOOTH | {"camera.convention": "as_printed"},
    **{law: SMOOTH | {"controller.law": law} for law in LAWS if law != "hybrid"},
}


@pytest.mark.parametrize("changes", RUNS.values(), ids=RUNS)
def test_steps_from_logged_samples_are_the_run(paper: hs.Scenario, changes: dict[str, Any]) -> None:
    scenario = paper.updated(changes)
    result = hs.simulate(scenario, log_weights=True)
    of = probe(scenario)
    at = {name: values[:-1] for name, values in logged(result).items()}
    bound = 1e-12
    if scenario.controller.law in ("resolved_rate", "pbvs"):  # they divide by J^T J alone, and samples are rounded
        matrices = of.image_jacobian(at["features"], at["depth"], at["quaternion"], True)
        bound = float(np.finfo(float).eps * np.linalg.cond(matrices).max() ** 2)
    history = result.weight_history
    assert (history is None) == (not of.has_fuzzy_systems)
    steps = of.stages(**at, weights=None if history is None else history[:-1])
    for name in ("wrench", "fuzzy_output"):
        assert_close(getattr(steps, name)[:, 0], getattr(result, name)[:-1], bound)
    for name in ("features", "depth", "position", "quaternion", "twist"):
        np.testing.assert_array_equal(getattr(steps, name)[:, 0], at[name])
        assert_close(getattr(steps, f"next_{name}"), getattr(result, name)[1:], bound)
    if history is None:
        assert steps.next_weights is None
    else:
        assert steps.next_weights is not None
        assert_close(steps.next_weights, history[1:])


def assert_close(a: Array, b: Array, bound: float = 1e-12) -> None:
    """Within a part of the largest number of the whole array: samples are rounded, and so is what follows from them."""
    np.testing.assert_allclose(a, b, rtol=0, atol=bound * np.abs(b).max())


def test_a_step_by_hand_is_the_run(paper: hs.Scenario) -> None:
    """Law, plant and Runge-Kutta method one by one, with full weights in every stage."""
    scenario = paper.updated(SMOOTH)
    result = hs.simulate(scenario, log_weights=True)
    assert result.weight_history is not None
    of = probe(scenario)
    weights = result.weight_history[:-1]
    start = (result.position[:-1], result.quaternion[:-1], result.twist[:-1])
    body = start
    stages: list[tuple[Array, Array, Array]] = []
    weight_rates: list[Array] = []
    stage_weights = weights
    for scale in (STEP / 2, STEP / 2, STEP, None):
        position, quaternion, twist = body
        features, depth = of.image(position, quaternion)
        law = of.law(features, of.measured_depth(depth), position, quaternion, twist, stage_weights)
        acceleration = of.acceleration(position, quaternion, twist, law.wrench)
        stages.append((quaternion, twist, acceleration))
        weight_rates.append(weight_rate(law))
        if scale is not None:
            body = of.moved(*start, *stages[-1], scale)
            stage_weights = weights + scale * weight_rates[-1]
    quaternions, twists, accelerations = (np.stack(four, axis=1) for four in zip(*stages, strict=True))
    position, quaternion, twist = of.after(*start, quaternions, twists, accelerations, STEP)
    assert_close(position, result.position[1:])
    assert_close(quaternion, result.quaternion[1:])
    assert_close(twist, result.twist[1:])
    share = STEP * np.array([1, 2, 2, 1]) / 6
    next_weights = weights + sum(s * rate for s, rate in zip(share, weight_rates, strict=True))
    assert_close(next_weights, result.weight_history[1:])


def weight_rate(law: _core.LawProbe) -> Array:
    """omega-dot without leakage and limit, (n, 6, 7, 7)."""
    assert law.adaptation is not None
    assert law.error_memberships is not None
    assert law.rate_memberships is not None
    rate: Array = np.einsum("nj,njr,njc->njrc", law.adaptation, law.error_memberships, law.rate_memberships)
    return rate


def test_the_stages_are_a_quadrature_of_the_weights(paper: hs.Scenario) -> None:
    """Memberships and adaptation of a stage do not need its weights."""
    scenario = paper.updated(SMOOTH)
    result = hs.simulate(scenario, log_weights=True)
    assert result.weight_history is not None
    of = probe(scenario)
    at = {name: values[:-1] for name, values in logged(result).items()}
    steps = of.stages(**at, weights=result.weight_history[:-1])
    change = np.zeros_like(result.weight_history[:-1])
    for k, share in enumerate(STEP * np.array([1, 2, 2, 1]) / 6):
        law = of.law(
            steps.features[:, k],
            of.measured_depth(steps.depth[:, k]),
            steps.position[:, k],
            steps.quaternion[:, k],
            steps.twist[:, k],
        )
        change += share * weight_rate(law)
        acceleration = of.acceleration(
            steps.position[:, k], steps.quaternion[:, k], steps.twist[:, k], steps.wrench[:, k]
        )
        np.testing.assert_array_equal(acceleration, steps.acceleration[:, k])
    np.testing.assert_allclose(
        np.diff(result.weight_history, axis=0), change, rtol=0, atol=1e-12 * np.abs(result.weight_history).max()
    )


# ---- What is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"features": np.zeros((3, 7))}, r"features: expected numbers of shape \(n, 8\), got shape \(3, 7\)"),
        ({"features": "x"}, r"features: expected numbers of shape \(n, 8\), got something else \(str\)"),
        ({"twist": np.zeros((2, 6))}, r"twist: expected numbers of shape \(3, 6\), got shape \(2, 6\)"),
        ({"position": np.zeros(3)}, r"position: expected numbers of shape \(3, 3\), got shape \(3,\)"),
        (
            {"weights": np.zeros((3, 6, 49))},
            r"weights: expected numbers of shape \(3, 6, 7, 7\), got shape \(3, 6, 49\)",
        ),
        ({"twist": np.full((3, 6), np.nan)}, r"twist\[0\]: expected a finite number, got -?nan"),
        ({"weights": np.full((3, 6, 7, 7), np.inf)}, r"weights\[0\]: expected a finite number, got inf"),
        ({"depth": np.full((3, 4), 0.5)}, r"depth\[0\]: expected numbers < 0, in front of the camera, got 0.5"),
        ({"quaternion": np.zeros((3, 4))}, r"quaternion\[0\]: expected a quaternion that is not zero, got zero"),
    ],
)
def test_rows_that_do_not_fit(paper: hs.Scenario, changes: dict[str, Any], sentence: str) -> None:
    at: dict[str, Any] = states(paper, 3)
    of = probe(paper)
    of.law(**at)
    for function in (of.law, of.stages):
        with pytest.raises(ValueError, match=f"^{sentence}"):
            function(**(at | changes))


def test_no_rows_are_no_rows(paper: hs.Scenario) -> None:
    of = probe(paper)
    features, depth = of.image(np.zeros((0, 3)), np.zeros((0, 4)))
    assert features.shape == (0, 8)
    given = of.law(features, depth, np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 6)), np.zeros((0, 6, 7, 7)))
    assert given.wrench.shape == (0, 6)


def test_what_a_scenario_does_not_have(paper: hs.Scenario) -> None:
    at = states(paper, 3)
    sampled = probe(paper.updated({"simulation.mode": "sampled"}))
    with pytest.raises(ValueError, match=r"^simulation.mode: expected continuous"):
        sampled.stages(**at)
    printed = probe(paper.updated({"camera.convention": "as_printed"}))
    with pytest.raises(ValueError, match=r"^camera.convention: expected eye_in_hand"):
        printed.image(at["position"], at["quaternion"])
    with pytest.raises(ValueError, match=r"^camera.convention: expected eye_in_hand"):
        printed.goal_minima()


ROWS: dict[str, Any] = {
    "features": np.full((3, 8), 10.0),
    "depth": np.full((3, 4), -0.5),
    "position": np.zeros((3, 3)),
    "quaternion": np.tile([1.0, 0, 0, 0], (3, 1)),
    "twist": np.zeros((3, 6)),
    "wrench": np.zeros((3, 6)),
    "acceleration": np.zeros((3, 6)),
    "stage_quaternion": np.tile([1.0, 0, 0, 0], (3, 1)),
    "stage_twist": np.zeros((3, 6)),
    "stage_acceleration": np.zeros((3, 6)),
    "scale": STEP,
    "step": STEP,
}
FUNCTIONS: dict[str, tuple[str, ...]] = {
    "image": ("position", "quaternion"),
    "image_jacobian": ("features", "depth", "quaternion"),
    "measured_depth": ("depth",),
    "law": ("features", "depth", "position", "quaternion", "twist"),
    "stages": ("features", "depth", "position", "quaternion", "twist"),
    "acceleration": ("position", "quaternion", "twist", "wrench"),
    "estimated_wrenches": ("quaternion", "twist", "acceleration"),
    "inertia": ("quaternion",),
    "moved": ("position", "quaternion", "twist", "stage_quaternion", "stage_twist", "stage_acceleration", "scale"),
    "after": ("position", "quaternion", "twist", "stage_quaternion", "stage_twist", "stage_acceleration", "step"),
}


def given(function: str) -> dict[str, Any]:
    """Numbers that the function takes."""
    rows = {name: ROWS[name] for name in FUNCTIONS[function]}
    if function == "after":
        rows |= {name: np.stack([ROWS[name]] * 4, axis=1) for name in rows if name.startswith("stage_")}
    return rows


def bad_numbers(name: str, values: Any) -> list[tuple[Any, str]]:
    """What each of its arguments refuses, with the words for it."""
    if name in ("scale", "step"):
        bad = [(np.nan, f"{name}: expected a finite number"), (np.inf, f"{name}: expected a finite number")]
        return (
            bad if name == "scale" else [*bad, (0.0, "step: expected a finite number > 0"), (-STEP, "step: expected")]
        )
    row = 2 if values.ndim == 2 else 8
    bad = []
    for number, words in ((np.nan, "a finite number"), (-np.inf, "a finite number")):
        changed = values.copy()
        changed.reshape(-1, changed.shape[-1])[row, -1] = number
        bad.append((changed, rf"{name}\[{row}\]: expected {words}, got "))
    bad.append((values[:, ..., :-1], rf"{name}: expected numbers of shape \("))
    bad.append((values.astype(complex), rf"{name}: expected numbers of shape \(.*\), got an array of complex128"))
    bad.append((values > 0.0, rf"{name}: expected numbers of shape \(.*\), got an array of bool"))
    bad.append((values.astype(str).tolist(), rf"{name}: expected numbers of shape \(.*\), got something else \(list\)"))
    if name == "depth":
        bad.extend((-values * share, r"depth\[0\]: expected numbers < 0, in front") for share in (1.0, 0.0))
    if name.endswith("quaternion"):
        bad.append((values * 0.0, rf"{name}\[0\]: expected a quaternion that is not zero, got zero"))
        for scale in (1e-170, 1e-160, 1e160):
            bad.append((values * scale, rf"{name}\[0\]: expected a quaternion whose largest number is between"))
    return bad


@pytest.mark.parametrize(("function", "name"), [(f, name) for f, names in FUNCTIONS.items() for name in names])
def test_every_argument_of_every_function(paper: hs.Scenario, function: str, name: str) -> None:
    of = getattr(probe(paper), function)
    of(**given(function))
    values = given(function)[name]
    for bad, sentence in bad_numbers(name, values):
        with pytest.raises(ValueError, match=f"^{sentence}"):
            of(**(given(function) | {name: bad}))


@pytest.mark.parametrize("speed", [-600.0, -1200.0])
def test_a_step_through_the_target(paper: hs.Scenario, speed: float) -> None:
    """Towards the target, 0.5 m away, in 1 ms: where `image` has no features, a stage has no wrench either."""
    home = np.asarray(paper.robot.home_position)[None]
    quaternion = np.array([[1.0, 0, 0, 0]])
    of = probe(paper)
    features, depth = of.image(home, quaternion)
    steps = of.stages(features, depth, home, quaternion, [[0, 0, speed, 0, 0, 0]])
    assert steps.next_weights is not None
    for values in (steps.next_features, steps.next_depth, steps.next_position, steps.next_twist, steps.next_weights):
        assert np.isnan(values).all()
    reached = np.isfinite(steps.position[0]).all(axis=1)
    assert reached.tolist() == ([True] * 4 if speed == -600.0 else [True, True, False, False])
    again, depth_again = of.image(steps.position[0, reached], steps.quaternion[0, reached])
    np.testing.assert_allclose(steps.depth[0, reached], depth_again, rtol=0, atol=1e-15)
    np.testing.assert_allclose(steps.features[0, reached], again, rtol=0, atol=1e-11)
    seen = np.isfinite(steps.features[0]).all(axis=1)
    assert seen.tolist() == ([True] * 3 + [False] if speed == -600.0 else [True, False, False, False])
    for values in (steps.wrench, steps.fuzzy_output, steps.acceleration):
        np.testing.assert_array_equal(np.isfinite(values[0]).all(axis=1), seen)
        assert np.isnan(values[0, ~seen]).all()
