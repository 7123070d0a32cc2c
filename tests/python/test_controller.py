"""The servo tick from Python: the same numbers as the loop in the core, safe output, shapes, a loop that settles."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters

GRAVITY = np.array([0.0, 0.0, -0.06 * 9.8, 0.0, 0.0, 0.0])
INERTIA = np.array([1.5e-4, 1.5e-4, 3e-4])  # about E's axes
BRAKE = 100.0  # [rad/s], of the brake's critically damped response
ARGUMENTS = ("features", "depth", "position", "quaternion", "twist")


def damping(given: dict[str, Any]) -> NDArray[np.float64]:
    """2 w D chi-dot of a platform whose mass is centred in E, with its inertia turned into B."""
    velocity, omega = np.split(np.asarray(given["twist"]), 2)
    attitude = Rotation.from_quat(np.roll(given["quaternion"], -1)).as_matrix()
    return 2.0 * BRAKE * np.concatenate([0.06 * velocity, attitude * INERTIA @ attitude.T @ omega])


@pytest.fixture
def controller(paper: hs.Scenario) -> hs.Controller:
    return hs.Controller(paper)


def good_input(paper: hs.Scenario) -> dict[str, Any]:
    """Sensor readings of a robot that moves near home."""
    return {
        "features": np.asarray(paper.target.initial_features, dtype=float) + 1.0,
        "depth": np.full(4, -0.65),
        "position": np.array([0.001, -0.002, -0.151]),
        "quaternion": np.array([1.0, 0.01, -0.02, 0.03]),
        "twist": np.array([0.01, -0.02, 0.005, 0.1, -0.05, 0.02]),
    }


@pytest.mark.parametrize("kind", ["sign", "tanh", "saturation"])
@pytest.mark.parametrize("fuzzy", [True, False])
@pytest.mark.parametrize("law", ["hybrid", "composite"])
def test_the_first_ticks_are_the_first_samples_of_a_run(paper: hs.Scenario, law: str, kind: str, fuzzy: bool) -> None:
    """A run's logged wrench is the law at its logged state; fed with that state, a fresh tick gives the same."""
    scenario = paper.updated(
        {
            "controller.law": law,
            "controller.switching.kind": kind,
            f"controller.{law}.fuzzy.enabled": fuzzy,
            f"controller.{law}.fuzzy.initial_scale": 0.02,
            f"controller.{law}.fuzzy.adaptation": 1e12,  # the weights stay as they start
            "simulation.duration": 0.05,
        }
    )
    run = hs.simulate(scenario)
    controller = hs.Controller(scenario)
    desired = np.asarray(scenario.target.desired_features)
    for k in range(len(run.time)):
        out = controller.step(
            desired - run.feature_error[k], 1.3 * run.depth[k], run.position[k], run.quaternion[k], run.twist[k]
        )
        assert not out.invalid_input
        # the weights move by less than 1e-13, features carry the rounding of desired - (desired - xi)
        np.testing.assert_allclose(out.wrench, run.wrench[k], rtol=0, atol=1e-12)
        np.testing.assert_allclose(out.leg_forces, run.leg_forces[k], rtol=0, atol=1e-11)
        np.testing.assert_allclose(out.fuzzy_output, run.fuzzy_output[k], rtol=0, atol=1e-12)
    assert bool(np.any(run.fuzzy_output)) == fuzzy


@pytest.mark.parametrize("jacobian_at", ["current", "desired", "mean"])
@pytest.mark.parametrize("law", ["kelly", "resolved_rate", "pbvs", "computed_torque"])
def test_the_first_ticks_of_laws_without_a_state_are_the_first_samples_of_a_run(
    paper: hs.Scenario, law: str, jacobian_at: str
) -> None:
    """The controller's model of the target has the depth error of the simulated controller."""
    scenario = paper.updated(
        {
            "controller.law": law,
            "controller.resolved_rate": {"jacobian_at": jacobian_at, "adaptive": jacobian_at == "mean"},
            "simulation.duration": 0.05,
        }
    )
    run = hs.simulate(scenario)
    controller = hs.Controller(scenario)
    desired = np.asarray(scenario.target.desired_features)
    for k in range(len(run.time)):
        out = controller.step(
            desired - run.feature_error[k], 1.3 * run.depth[k], run.position[k], run.quaternion[k], run.twist[k]
        )
        assert not out.invalid_input
        # Features carry the rounding of desired - (desired - xi), 1e-14 px: up to 2e-15 m of pose, times 1e2 N/m. The
        # plain pseudo-inverse solves with J^T J, whose condition is 1e7: that many roundings of half a newton.
        atol = 1e-9 if law == "resolved_rate" else 1e-11
        np.testing.assert_allclose(out.wrench, run.wrench[k], rtol=0, atol=atol)
        np.testing.assert_allclose(out.leg_forces, run.leg_forces[k], rtol=0, atol=10 * atol)
        assert not out.fuzzy_output.any()
    assert not run.fuzzy_output.any()
    assert not run.fuzzy_weights.any()
    assert not controller.fuzzy_weights.any()
    assert controller.fuzzy_weights.shape == (6, 7, 7)


def test_weights_adapt_by_one_euler_step(paper: hs.Scenario) -> None:
    """(22) over a period: each system's weights change by period chi-dot_j/Psi_j times strengths that sum to one."""
    scenario = paper.updated({"controller.hybrid.fuzzy.initial_scale": 0.01})
    controller = hs.Controller(scenario, period=2e-3)
    before = controller.fuzzy_weights
    assert before.shape == (6, 7, 7)
    np.testing.assert_array_equal(before, np.broadcast_to(0.01 * np.array(_core.LINEAR_RULE_TABLE), (6, 7, 7)))
    given = good_input(paper)
    controller.step(**given)
    change = controller.fuzzy_weights - before
    rounding = 49 * 0.01 * np.finfo(float).eps  # of 49 weights no larger than 0.01
    np.testing.assert_allclose(change.sum(axis=(1, 2)), 2e-3 * given["twist"] / 10.0, rtol=0, atol=rounding)
    assert np.all(change * given["twist"][:, None, None] > 0)


def test_reset_brings_the_first_state_back(paper: hs.Scenario, controller: hs.Controller) -> None:
    given = good_input(paper)
    first = controller.step(**given)
    second = controller.step(**given)
    assert np.any(first.wrench != second.wrench)
    controller.reset()
    assert not np.any(controller.fuzzy_weights)
    for again, expected in zip(controller.step(**given), first, strict=True):
        np.testing.assert_array_equal(again, expected)


@pytest.mark.parametrize("name", ARGUMENTS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308])
def test_invalid_measurements_give_the_safe_output(
    paper: hs.Scenario, controller: hs.Controller, name: str, value: float
) -> None:
    robot = _core.Hexapod(core_parameters(paper).robot)
    given = good_input(paper)
    brakes = name in ("features", "depth")  # pose and twist are known
    expected = GRAVITY - damping(given) if brakes else GRAVITY
    known: tuple[ArrayLike, ArrayLike] = (given["position"], given["quaternion"])
    home: tuple[ArrayLike, ArrayLike] = ((0.0, 0.0, -0.15), (1.0, 0.0, 0.0, 0.0))
    poses = [known if brakes else home, known]  # where pose or twist is not known: the last pose that was
    if name == "features" and np.isnan(value):
        poses = poses[:1]  # later the image of before stands for a point that is not seen
    for pose in poses:
        weights = controller.fuzzy_weights
        for entry in range(given[name].size):
            bad = {**given, name: given[name].copy()}
            bad[name][entry] = value
            if len(poses) == 1:
                controller.reset()  # or the images of the entries before stand in
            out = controller.step(**bad)
            assert out.invalid_input is True
            np.testing.assert_allclose(out.wrench, expected, rtol=0, atol=1e-15)
            np.testing.assert_array_equal(out.fuzzy_output, np.zeros(6))
            np.testing.assert_allclose(robot.wrench_map(*pose) @ out.leg_forces, expected, atol=1e-14)
            np.testing.assert_array_equal(controller.fuzzy_weights, weights)
        assert controller.step(**given).invalid_input is False


@pytest.mark.parametrize("reading", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("entry", range(3))
def test_a_pose_that_is_no_number_leaves_no_offset_behind(entry: int, reading: float) -> None:
    """The law `tracking` integrates what legs lack where they rest: never a reading that is no number."""
    scenario = hs.load_scenario("rubin-camera-positions").updated({"sensors": {"pose": "true"}})
    assert scenario.controller.law == "tracking"
    start = hs.simulate(scenario.updated({"simulation.duration": scenario.simulation.step}))
    controller = hs.Controller(scenario)
    poses = np.repeat(start.position[:1], 7, axis=0)
    poses[3, entry] = reading
    outputs = [
        controller.step(
            start.features[0],
            start.depth[0],
            position,
            start.quaternion[0],
            np.zeros(6),
            exposure=tick * controller.period,
            now=tick * controller.period,
        )
        for tick, position in enumerate(poses)
    ]
    assert [output.invalid_input for output in outputs] == [False, False, False, True, False, False, False]
    for output in outputs:
        assert np.isfinite(output.leg_positions).all()


def test_an_adaptation_of_extreme_gain_keeps_its_weights_finite(paper: hs.Scenario) -> None:
    """Where a period's change would overflow, the weights wait, and the law goes on with those it has."""
    controller = hs.Controller(paper.updated({"controller.law": "composite", "controller.composite.drive": 1.7e308}))
    for _ in range(3):
        output = controller.step(**good_input(paper))
        assert np.isfinite(controller.fuzzy_weights).all()
        assert np.isfinite(output.wrench).all()


@pytest.mark.parametrize("law", LAWS)
def test_the_status_says_why_the_law_does_not_act(paper: hs.Scenario, law: str) -> None:
    sampled = paper.updated(
        {"simulation.mode": "sampled", "controller.law": law, "camera": {"timeout": 0.05, "on_lost": "stop"}}
    )
    given = good_input(paper)
    joints = {name: given[name] for name in ("position", "quaternion", "twist")}
    missing = {**given, "features": np.full(8, np.nan), "depth": np.full(4, np.nan)}
    part = {**given, "features": np.where(np.arange(8) < 2, np.nan, given["features"])}
    controller = hs.Controller(sampled)
    weights = controller.fuzzy_weights
    assert controller.step(**joints).status == "missing_image"
    assert controller.step(**missing).status == "missing_image"
    assert controller.step(**part).status == "missing_image"
    assert controller.step(**given, now=1.0, exposure=1.001).status == "unusable"  # from the future
    np.testing.assert_array_equal(controller.fuzzy_weights, weights)
    assert controller.step(**given, now=1.0, exposure=0.95).status == "valid"
    weights = controller.fuzzy_weights
    for tick, (bad, status) in enumerate(
        [
            (joints, "stale_image"),
            (missing, "stale_image"),  # frames without points renew nothing
            ({**given, "exposure": 0.94}, "stale_image"),
        ]
    ):
        out = controller.step(**bad, now=1.001 + 1e-3 * tick)
        assert (out.invalid_input, out.status) == (True, status)
        np.testing.assert_allclose(out.wrench[3:], (GRAVITY - damping(given))[3:], rtol=0, atol=1e-15)
        assert np.isfinite(out.leg_forces).all()
    assert controller.step(**part, now=1.01).status == "stale_image"  # one point is older than the timeout
    assert controller.step(**given, now=1.011).status == "valid"
    assert controller.step(**part, now=1.012).status == "lost_feature"
    assert controller.step(**joints, now=1.013).status == "lost_feature"
    assert controller.step(**given, now=1.014).status == "valid"
    assert controller.step(**{**given, "twist": None}, now=1.015).status == "unusable"
    assert controller.step(**given, now=1.0).status == "unusable"  # the clock went back
    assert controller.step(**given, now=np.nan).status == "unusable"
    for _ in range(2):  # a loop that passes the same frame again changes nothing
        assert controller.step(**given, now=1.03, exposure=1.02).status == "valid"
    forgiving = hs.Controller(sampled.updated({"camera.timeout": None}))
    assert forgiving.step(**given, now=1e9, exposure=0.0).status == "valid"  # no timeout: any image


def test_ticks_without_a_time_are_whole_periods_after_the_last_one_that_was_given(paper: hs.Scenario) -> None:
    """Added up, they would be 1e-6 of a tick late after 100 at this time of the clock, after 3e5 from 0."""
    start, given = 3e5, good_input(paper)
    controller = hs.Controller(paper)
    assert controller.step(**given, now=start).status == "valid"
    for tick in range(1, 400):
        if tick == 200:
            controller = copy.deepcopy(controller)
        exposure = start + tick * controller.period
        assert controller.step(**given, exposure=exposure).status == "valid", tick
    assert controller.step(**given, now=np.nan).status == "unusable"  # at no time: no period passes
    assert controller.step(**given, exposure=start + 400 * controller.period).status == "valid"
    assert controller.step(**given, exposure=start + 401.5 * controller.period).status == "unusable"
    controller.reset()
    assert controller.step(**given, exposure=0.0).status == "valid"
    assert controller.step(**given, exposure=1.5 * controller.period).status == "unusable"


def test_a_frame_without_a_time_is_exposed_at_its_tick() -> None:
    """Of a platform that moves: an image from another time would be carried on from where the platform was then."""
    scenario = hs.load_scenario("slow-camera")
    given, moving = good_input(scenario), np.array([1e-4, 0.0, 0.0])
    one, other = hs.Controller(scenario), hs.Controller(scenario)
    wrenches = []
    for tick in range(5):
        seen = {**given, "position": given["position"] + tick * moving}
        now = tick * other.period
        wrenches.append(one.step(**seen).wrench)
        np.testing.assert_array_equal(wrenches[-1], other.step(**seen, now=now, exposure=now).wrench)
    assert len(np.unique(wrenches, axis=0)) > 1


@pytest.mark.parametrize("prediction", ["none", "encoder"])
def test_a_frame_that_is_older_than_the_kept_poses_is_not_used(paper: hs.Scenario, prediction: str) -> None:
    """Where points are predicted; such a frame, as one that is older than the newest, changes nothing."""
    camera = {"period": 0.033, "latency": 0.033, "prediction": prediction}
    scenario = paper.updated({"simulation.mode": "sampled", "camera": camera})
    given = good_input(paper)
    joints = {name: given[name] for name in ("position", "quaternion", "twist")}
    other, same = hs.Controller(scenario), hs.Controller(scenario)
    for tick in range(200):
        for controller in (other, same):
            assert controller.step(**joints, now=1e-3 * tick).status == "missing_image"
    late = other.step(**given, now=0.2, exposure=0.1)
    none = same.step(**joints, now=0.2)
    if prediction == "none":
        assert late.status == "valid"
        return
    assert late.status == none.status == "missing_image"
    for tick in range(201, 260):
        frame = {"exposure": 1e-3 * tick - 0.033} if tick == 205 else {}
        frame |= {name: given[name] for name in ("features", "depth")} if frame else {}
        late, none = (controller.step(**joints, **frame, now=1e-3 * tick) for controller in (other, same))
        if tick == 230:
            late = other.step(**given, now=1e-3 * tick + 5e-4, exposure=0.1)
            none = same.step(**joints, now=1e-3 * tick + 5e-4)
        assert late.status == none.status == ("valid" if tick >= 205 else "missing_image")
        np.testing.assert_array_equal(late.wrench, none.wrench)


def test_features_without_depth_are_a_frame_and_depth_without_features_is_none(paper: hs.Scenario) -> None:
    given = good_input(paper)
    joints = {name: given[name] for name in ("position", "quaternion", "twist")}
    features, depth = given["features"], given["depth"]
    controller, other = hs.Controller(paper), hs.Controller(paper)
    assert controller.step(**joints, features=features).status == "unusable"
    assert controller.step(**joints, features=np.full(8, np.nan)).status == "missing_image"  # it shows no point
    assert controller.step(**joints, depth=depth).status == "missing_image"
    for each in (controller, other):
        assert each.step(**given, now=1.0).status == "valid"
    again, same = controller.step(**joints, depth=2.0 * depth), other.step(**joints)
    assert again.status == same.status == "valid"
    np.testing.assert_array_equal(again.wrench, same.wrench)
    assert controller.step(**joints, features=features).status == "unusable"


def test_leg_lengths_stand_for_pose_and_twist(paper: hs.Scenario) -> None:
    scenario = paper.updated({"simulation.mode": "sampled", "sensors": {"pose": "encoders", "period": 2e-3}})
    robot = _core.Hexapod(core_parameters(scenario).robot)
    controller = hs.Controller(scenario)
    given = good_input(paper)
    image = {name: given[name] for name in ("features", "depth")}
    rest = {"position": given["position"], "quaternion": given["quaternion"]}
    lengths = robot.leg_lengths(**rest)
    assert controller.step(**image).status == "unusable"  # no reading yet
    assert controller.step(**image, leg_lengths=lengths).status == "valid"
    assert controller.step(**image).status == "valid"  # the last one holds,
    known = hs.Controller(scenario.updated({"sensors": {"pose": True, "period": None}}))
    out = controller.step(**image, leg_lengths=lengths)
    expected = known.step(**image, **rest, twist=np.zeros(6))
    np.testing.assert_allclose(out.wrench, expected.wrench, rtol=0, atol=1e-12)
    for _ in range(4):
        assert controller.step(**image).status == "valid"
    assert controller.step(**image).status == "unusable"  # for two periods
    assert controller.step(**image, leg_lengths=np.where(np.arange(6) == 2, np.nan, lengths)).status == "unusable"
    assert controller.step(**image, leg_lengths=lengths + 1.0).status == "unusable"  # of no pose
    assert controller.step(**image, leg_lengths=lengths).status == "valid"


def test_a_loop_in_python_settles(paper: hs.Scenario) -> None:
    """The tick drives the platform of the core through its legs, and the features reach their goal."""
    scenario = paper.updated({"controller.switching.kind": "tanh", "controller.switching.width": 0.02})
    settings = core_parameters(scenario)
    robot = _core.Hexapod(settings.robot)
    body = _core.RigidBody()
    f = settings.camera.focal_pixels
    features, depth = np.asarray(scenario.target.initial_features).reshape(4, 2), 0.5
    points = np.column_stack([features * depth / f, np.full(4, -0.15 - depth)])  # (4), from home
    goal = np.asarray(scenario.target.desired_features)
    controller = hs.Controller(scenario)
    position, quaternion, twist = np.array([0.0, 0.0, -0.15]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(6)
    errors = []
    for _ in range(1000):
        seen, z = _core.take_image(settings.camera, position, quaternion, points)
        errors.append(np.abs(goal - seen.ravel()).max())
        out = controller.step(seen.ravel(), 1.3 * z, position, quaternion, twist)
        assert not out.invalid_input
        position, quaternion, twist = _core.drive_legs(
            robot, body, settings.dynamics_error, position, quaternion, twist, out.leg_forces, 1e-3, 1
        )
    assert errors[0] == pytest.approx(20.0)
    assert max(errors[800:]) < 2.0


@pytest.mark.parametrize("name", ARGUMENTS)
def test_shapes_are_checked(paper: hs.Scenario, controller: hs.Controller, name: str) -> None:
    given: dict[str, Any] = dict(good_input(paper))
    size = given[name].size
    weights = controller.fuzzy_weights
    for wrong, got in [
        (given[name][:-1], rf"\({size - 1},\)"),
        (given[name][None, :], rf"\(1, {size}\)"),
        (0.5, r"\(\)"),
        ("abc", "str"),
        (given[name].astype(str), "an array of <U"),
        (given[name].astype(complex), "an array of complex128"),
        (given[name] > 0.0, "an array of bool"),
        (given[name].astype(str).tolist(), "list"),
        ([[1.0], [1.0, 2.0]], "list"),
    ]:
        with pytest.raises(ValueError, match=rf"^{name}: expected {size} numbers, got .*{got}"):
            controller.step(**{**given, name: wrong})
    for boolean in (True, np.array(True)):
        with pytest.raises(ValueError, match=rf"^{name}: expected numbers, got .*True"):
            controller.step(**{**given, name: [boolean, *given[name][1:].tolist()]})
    np.testing.assert_array_equal(controller.fuzzy_weights, weights)


def test_lists_integers_and_strided_arrays_will_do(paper: hs.Scenario) -> None:
    given = good_input(paper)
    expected = hs.Controller(paper).step(**given)
    forms: list[dict[str, Any]] = [
        {name: np.repeat(value, 2)[::2] for name, value in given.items()},
        {name: value.tolist() for name, value in given.items()},
        {**given, "features": [31, 19, 66, -64, -43, 38, -9, -14]},
    ]
    for form in forms:
        np.testing.assert_array_equal(hs.Controller(paper).step(**form).wrench, expected.wrench)


def test_construction_is_checked(paper: hs.Scenario) -> None:
    for period in (0.0, -1e-3, np.nan, np.inf, 33.0):
        with pytest.raises(ValueError, match=r"^period: expected a time above 0 and up to 1 s, got"):
            hs.Controller(paper, period)
    slow = hs.load_scenario("slow-camera")
    assert hs.Controller(slow).period == slow.simulation.step
    with pytest.raises(ValueError, match=r"^camera\.period: expected a whole number of servo periods"):
        hs.Controller(slow, 0.02)
    with pytest.raises(TypeError, match="expected a Scenario"):
        hs.Controller("paper")  # type: ignore[arg-type]
    for wrong in ("a", 1j, [0.001], True, np.True_):
        with pytest.raises(TypeError, match=r"^period: expected a number of seconds, got "):
            hs.Controller(paper, wrong)  # type: ignore[arg-type]
    for times in ({"now": "a"}, {"exposure": 1j}, {"now": True}, {"exposure": np.array(True)}):
        with pytest.raises(TypeError, match=r"^(now|exposure): expected a number of seconds, got "):
            hs.Controller(paper).step(np.zeros(8), -np.ones(4), **times)
    controller = hs.Controller(paper, period=5e-4)
    assert controller.period == 5e-4
    assert controller.scenario is paper
    assert repr(controller) == "Controller('paper', period=0.0005)"


@pytest.mark.parametrize("name", ARGUMENTS)
def test_a_masked_entry_is_a_number_that_is_not_known(paper: hs.Scenario, name: str) -> None:
    given = good_input(paper)
    plain = hs.Controller(paper).step(**given)
    nothing_masked = hs.Controller(paper).step(**{**given, name: np.ma.masked_array(given[name], mask=False)})
    assert nothing_masked.status == plain.status == "valid"
    np.testing.assert_array_equal(nothing_masked.wrench, plain.wrench)
    entry_masked = np.ma.masked_array(given[name], mask=np.arange(len(given[name])) == 1)
    masked = hs.Controller(paper).step(**{**given, name: entry_masked})
    unknown = hs.Controller(paper).step(**{**given, name: np.where(entry_masked.mask, np.nan, given[name])})
    assert masked.status == unknown.status == ("missing_image" if name == "features" else "unusable")
    np.testing.assert_array_equal(masked.leg_forces, unknown.leg_forces)


def test_masked_features_are_a_missing_image_and_integers_may_be_masked(paper: hs.Scenario) -> None:
    given = good_input(paper)
    nothing_seen = np.ma.masked_array(np.zeros(8), mask=True)
    assert hs.Controller(paper).step(**{**given, "features": nothing_seen}).status == "missing_image"
    whole = np.ma.masked_array([1, 0, 0, 0], mask=[False, True, False, False])
    assert hs.Controller(paper).step(**{**given, "quaternion": whole}).status == "unusable"


@pytest.fixture(scope="module")
def read_out() -> hs.Scenario:
    """Encoders whose differences give the twist."""
    changes = {"controller.law": "kelly", "sensors.pose": "encoders", "camera.prediction": "none"}
    return hs.load_scenario("composite-30hz").updated(changes)


@pytest.mark.parametrize("wrong", [0.5, np.inf, np.nan])
def test_lengths_at_a_wrong_clock_give_no_rate(read_out: hs.Scenario, wrong: float) -> None:
    """Legs of constant speed: differences over one tick and over two are the same, whatever the clock was between."""
    home = np.array(_core.Hexapod(core_parameters(read_out).robot).home_lengths)
    features = np.array(read_out.target.initial_features)
    image: dict[str, Any] = {"features": features, "depth": np.full(4, -0.5), "exposure": 1.0}

    def last(clock: float) -> hs.ControllerOutput:
        controller = hs.Controller(read_out)
        for tick in range(6):
            now = clock if tick == 4 else 1.0 + 1e-3 * tick
            legs = home + 1e-5 * tick * np.arange(1, 7)
            out = controller.step(**(image if tick == 0 else {}), leg_lengths=legs, now=now)
            assert out.status == ("valid" if tick != 4 or clock == 1.004 else "unusable")
        return out

    np.testing.assert_allclose(last(wrong).wrench, last(1.004).wrench, rtol=1e-9, atol=1e-12)


def test_lengths_at_the_same_time_again_keep_the_rate(read_out: hs.Scenario) -> None:
    home = np.array(_core.Hexapod(core_parameters(read_out).robot).home_lengths)
    image: dict[str, Any] = {"features": np.array(read_out.target.initial_features), "depth": np.full(4, -0.5)}
    controller, once = hs.Controller(read_out), hs.Controller(read_out)
    for tick in range(4):
        legs = home + 1e-5 * tick * np.arange(1, 7)
        given = {**(image if tick == 0 else {}), "leg_lengths": legs, "now": 1.0 + 1e-3 * tick}
        out, expected = controller.step(**given), once.step(**given)
    again = controller.step(leg_lengths=legs, now=1.003)
    assert again.status == "valid"
    np.testing.assert_array_equal(out.wrench, expected.wrench)
    np.testing.assert_allclose(again.wrench, expected.wrench, rtol=1e-9, atol=1e-12)


def test_a_gap_in_the_readings_is_bridged(read_out: hs.Scenario) -> None:
    """The platform is 0.3 r_p and 0.3 rad aside at the first reading after 0.2 s without any."""
    legs = _core.Hexapod(core_parameters(read_out.updated({"robot.stroke": 0.1})).robot)
    radius = read_out.robot.platform_radius
    assert radius is not None
    random = np.random.default_rng(6)
    for _ in range(20):
        aside = random.normal(size=(2, 3))
        aside *= 0.3 / np.linalg.norm(aside, axis=1)[:, None]
        turn = np.concatenate([[np.cos(0.15)], np.sin(0.15) * aside[1] / 0.3])
        position = np.asarray(legs.home_position) + radius * aside[0]
        controller = hs.Controller(read_out)
        rest = np.array(legs.home_lengths)
        image: dict[str, Any] = {"features": np.array(read_out.target.initial_features), "depth": np.full(4, -0.5)}
        assert controller.step(**image, leg_lengths=rest, now=1.0).status == "valid"
        assert controller.step(leg_lengths=np.full(6, np.nan), now=1.1).status == "unusable"
        given = {"leg_lengths": legs.leg_lengths(position, turn), **image}
        assert controller.step(**given, now=1.2).status == "valid"


@pytest.mark.parametrize("prediction", ["none", "encoder"])
def test_before_the_first_frame_the_image_is_missing(prediction: str) -> None:
    scenario = hs.load_scenario("composite-30hz").updated({"camera.prediction": prediction, "sensors.pose": "true"})
    joints: dict[str, Any] = {"position": [0.0, 0.0, -0.15], "quaternion": [1.0, 0.0, 0.0, 0.0], "twist": np.zeros(6)}
    assert hs.Controller(scenario).step(**joints, now=1.0).status == "missing_image"


@pytest.mark.parametrize("timeout", [None, 1e3])
def test_a_clock_that_is_not_in_seconds_is_unusable(timeout: float | None) -> None:
    """More than 100 periods from tick to tick, and not for once: a pause is no other unit. Where a time counts."""
    changes = {"camera.prediction": "none", "camera.timeout": timeout, "sensors.pose": "true"}
    scenario = hs.load_scenario("composite-30hz").updated(changes)
    controller, period = hs.Controller(scenario), scenario.simulation.step
    sensed: dict[str, Any] = {
        "features": scenario.target.desired_features,
        "depth": np.full(4, -0.5),
        "position": [0.0, 0.0, -0.15],
        "quaternion": [1.0, 0.0, 0.0, 0.0],
        "twist": np.zeros(6),
    }
    now, statuses = 0.0, []
    for passed in (*[1.0, 1000.0] * 15, *[1000.0] * 15, 1.0):
        now += passed * period
        statuses.append(controller.step(**sensed, now=now).status)
    assert statuses == [*["valid"] * 39, *["valid" if timeout is None else "unusable"] * 6, "valid"]


@pytest.mark.parametrize(("unit", "works"), [(60.0, False), (1000.0, False), (10.0, True)])
def test_a_clock_that_crawls_counts_as_one_that_stands_still(unit: float, works: bool) -> None:
    """In minutes it goes on by a sixtieth of a period; the rates and ages that come of it mean nothing."""
    changes = {"camera.prediction": "none", "camera.timeout": 0.1, "sensors.pose": "true"}
    scenario = hs.load_scenario("composite-30hz").updated(changes)
    controller, period = hs.Controller(scenario), scenario.simulation.step
    given = {**good_input(scenario), "features": scenario.target.desired_features}
    statuses = [controller.step(**given, now=5.0 + tick * period / unit).status for tick in range(30)]
    assert statuses == (["valid"] * 30 if works else [*["valid"] * 11, *["unusable"] * 19])
    assert controller.step(**given, now=6.0).status == "valid"


def at(position: ArrayLike, paper: hs.Scenario) -> dict[str, Any]:
    return {**good_input(paper), "position": position}


def test_a_pose_that_the_platform_cannot_have_come_to_is_unusable(paper: hs.Scenario) -> None:
    """In millimetres, or one wrong reading: the safe output is computed from neither."""
    controller, place = hs.Controller(paper), np.array([0.001, -0.002, -0.151])
    assert controller.step(**at(1e3 * place, paper)).status == "unusable"
    legs = _core.Hexapod(core_parameters(paper).robot)
    longest = max(legs.home_lengths)  # of a machine whose legs have no cranks: between their joints
    for wrong in (1.01 * longest, 1.0, 1e7):
        assert controller.step(**at(place, paper)).status == "valid"
        out = controller.step(**at(np.add(place, [wrong, 0.0, 0.0]), paper))
        assert out.status == "unusable"
        np.testing.assert_allclose(out.wrench, GRAVITY, atol=1e-12)
    assert controller.step(**at(place, paper)).status == "valid"
    assert controller.step(**at(np.add(place, [0.99 * longest, 0.0, 0.0]), paper)).status == "valid"


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
def test_an_attitude_that_the_platform_cannot_have_come_to_is_unusable(paper: hs.Scenario, axis: list[float]) -> None:
    """More than 90 deg from the one before, or, of the first one, than 150 deg from home; a length has no meaning."""

    def turned(degrees: float) -> dict[str, Any]:
        half = np.radians(degrees) / 2.0
        given = at(paper.robot.home_position, paper)
        return {**given, "quaternion": -3.0 * np.array([np.cos(half), *(np.sin(half) * np.array(axis))])}

    for first, status in ((149.0, "valid"), (151.0, "unusable"), (-149.0, "valid"), (-151.0, "unusable")):
        assert hs.Controller(paper).step(**turned(first)).status == status
    controller = hs.Controller(paper)
    for degrees, status in ((0.0, "valid"), (89.0, "valid"), (178.0, "valid"), (87.0, "unusable"), (89.0, "valid")):
        assert controller.step(**turned(degrees)).status == status


def test_a_quaternion_in_another_order_is_unusable() -> None:
    """(x, y, z, w), near home: half a turn from it."""
    scenario = hs.load_scenario("composite-30hz")
    run = hs.simulate(scenario)
    controller = hs.Controller(scenario)
    given = at(run.position[0], scenario)
    given["quaternion"] = np.roll(run.quaternion[0], -1)
    assert controller.step(**given).status == "unusable"
    given["quaternion"] = run.quaternion[0]
    assert controller.step(**given).status == "valid"


def test_a_state_that_was_stored_refuses_the_same_poses(paper: hs.Scenario) -> None:
    controller, place = hs.Controller(paper), np.array([0.001, -0.002, -0.151])
    controller.step(**at(place, paper))
    later = copy.deepcopy(controller)
    for one in (controller, later):
        assert one.step(**at(np.add(place, [1.0, 0.0, 0.0]), paper)).status == "unusable"


def test_readings_may_be_half_a_tick_late(read_out: hs.Scenario) -> None:
    """No loop ticks exactly on time."""
    home = np.array(_core.Hexapod(core_parameters(read_out).robot).home_lengths)
    image: dict[str, Any] = {"features": np.array(read_out.target.initial_features), "depth": np.full(4, -0.5)}
    period = read_out.simulation.step
    for late, status in ((0.4, "valid"), (0.6, "unusable")):
        controller = hs.Controller(read_out)
        controller.step(**image, leg_lengths=home, now=1.0)
        controller.step(now=1.0 + period)
        assert controller.step(now=1.0 + (2.0 + late) * period).status == status


@pytest.mark.parametrize(
    ("key", "wrong", "acts"),
    [
        ("focal_length", 0.1, True),
        ("principal_point", [5.0, 5.0], True),
        ("mount.position", [0.01, 0.0, 0.0], True),
        ("mount.rotation", [0.0, 0.0, 0.1], True),
        ("depth", 0.3, True),  # of the points of the goal, in a law that has a model of them
        ("latency", 0.02, False),
        ("inertia", 0.1, False),
        ("coriolis", 0.1, False),
        ("gravity", 0.1, False),
    ],
)
def test_only_what_the_controller_assumes_wrongly_is_in_its_tick(key: str, wrong: Any, acts: bool) -> None:
    """As the docstring of the class has it; a wrong latency only keeps the poses of more ticks."""
    right = hs.load_scenario("real-machine").updated(
        {"controller.law": "pbvs", f"uncertainty.{key}": np.zeros_like(wrong).tolist(), "sensors.pose": "true"}
    )
    controllers = hs.Controller(right), hs.Controller(right.updated({f"uncertainty.{key}": wrong}))
    one, two = (controller.step(**good_input(right)) for controller in controllers)
    assert one.status == two.status == "valid"
    assert np.array_equal(one.wrench, two.wrench) != acts
    kept = [len(controller.__getstate__()["state"]) for controller in controllers]
    assert (kept[0] < kept[1]) == (key == "latency")
