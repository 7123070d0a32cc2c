"""The filter of a pose that the law `tracking` follows (docs/model.md, section 5), against textbook forms of it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_tracking import steady_filter
from hexservo.scenario.laws import Tracking
from hexservo.scenario.parameters import core_parameters
from without_runs import unlikely_without_runs

Array = NDArray[np.float64]
TICK = 0.02
IN_SPACE = [[-0.15, 0.12, -0.45], [0.15, 0.12, -0.65], [0.12, -0.15, -0.45], [-0.15, -0.12, -0.65]]  # points [m]


def hexapod(changes: dict[str, Any] | None = None) -> hs.Scenario:
    """Return a hexapod before a tag that it sees 50 times a second, which determines some displacements badly."""
    return hs.load_scenario("pi-h824-positions").updated(changes or {})


def moving(velocity: list[float]) -> dict[str, Any]:
    return {"target.motion": {"kind": "velocity", "velocity": velocity}}


def at_once(noise: float, points: list[list[float]] | None = None, **gains: Any) -> hs.Scenario:
    """Return it with a reference and legs that go all the way in a tick, and images without delay."""
    return hexapod(
        {
            "target.desired_features": None,
            "target.desired_pose": [0.0] * 6,
            "controller.tracking": {"noise": noise, "bandwidth": 1e4, **gains},
            "actuators": {"delay": 0.0, "position": {"bandwidth": 400.0 / TICK / (2.0 * np.pi), "damping": 100.0}},
            "actuators.position.speed_limit": None,
            "camera": {"latency": 0.0, "noise": 0.0},
            "sensors.resolution": 0.0,
            **({} if points is None else {"target.points": points}),
        }
    )


def commanded(machine: _core.Hexapod, out: hs.ControllerOutput) -> Array:
    """Return the displacement and the rotation vector from home that the legs are sent to, (6,) [m; rad]."""
    pose = machine.forward_kinematics(out.leg_positions, machine.home_position, machine.home_quaternion)
    turn = Rotation.from_quat(pose.quaternion[[1, 2, 3, 0]]).as_rotvec()
    return np.array([*(pose.position - machine.home_position), *turn])


def of_a_frame(acceleration: Array, period: float) -> tuple[Array, Array]:
    """Return the transition matrix of places and velocities over a period, and the variance that it adds."""
    carry = np.kron([[1.0, period], [0.0, 1.0]], np.eye(len(acceleration)))
    in_time = [[period**4 / 4.0, period**3 / 2.0], [period**3 / 2.0, period**2]]
    return np.asarray(carry, dtype=float), np.asarray(np.kron(in_time, np.diag(acceleration**2)), dtype=float)


def view_jacobian(scenario: hs.Scenario) -> Array:
    """Return the features by the platform's motion from home, (8, 6) [px/m; px/rad]; what is followed moves against."""
    step = 1e-6
    ends = ((hs.project(scenario, step * unit), hs.project(scenario, -step * unit)) for unit in np.eye(6))
    return np.stack([np.subtract(*pair) / (2.0 * step) for pair in ends], axis=1)


def test_the_filter_is_the_textbook_one_of_all_features() -> None:
    """With a reference that goes all the way in a tick, the command is the prediction of a filter with 12 numbers.

    Its measurements are the 8 features themselves, not poses, with their noise; small displacements, so that they are
    linear. Compared along the five displacements that are observable best: of the sixth the law follows the mean. Of
    the fifth that takes a part too, (0.02/0.14)^4; what is left of the others is of second order.
    """
    sigma, frames = 0.001, 200
    scenario = at_once(sigma, IN_SPACE, certainty=0.0, jump=1e6)
    gains = scenario.controller.gains
    acceleration, speed = np.asarray(gains.acceleration), np.asarray(gains.speed)
    machine = _core.Hexapod(core_parameters(scenario).robot)
    home = np.array(machine.home_lengths)
    jacobian = view_jacobian(scenario)
    shows = np.hstack([-jacobian, np.zeros((8, 6))])
    still = np.asarray(hs.project(scenario, [0.0] * 6))
    carry, push = of_a_frame(acceleration, TICK)
    rng = np.random.default_rng(3)
    print("seed 3")
    velocity = np.array([2e-6, -1e-6, 1e-6, 3e-6, -4e-6, 5e-6])
    controller, off = hs.Controller(scenario), np.empty((0, 6))
    x, known = np.zeros(12), np.zeros((12, 12))
    for k in range(frames):
        followed = velocity * TICK * k
        seen = np.asarray(hs.project(scenario, -followed)) + sigma * rng.standard_normal(8)
        out = controller.step(seen, np.full(4, -0.4), leg_lengths=home)
        assert out.status == "valid"
        if k == 0:
            information = jacobian.T @ jacobian / sigma**2
            x[:6] = -np.linalg.solve(information, jacobian.T @ (seen - still)) / sigma**2
            known[:6, :6], known[6:, 6:] = np.linalg.inv(information), np.diag(speed**2)
        else:
            x, known = carry @ x, carry @ known @ carry.T + push
            gain = np.linalg.solve(shows @ known @ shows.T + sigma**2 * np.eye(8), shows @ known).T
            x = x + gain @ (seen - still - shows @ x)
            left = np.eye(12) - gain @ shows
            known = left @ known @ left.T + sigma**2 * gain @ gain.T  # Joseph's form: the short one is unstable here
        if k > 2:
            off = np.vstack([off, commanded(machine, out) - (x[:6] + TICK * x[6:])])
    scale = np.repeat([np.linalg.norm(jacobian[:, :3]), np.linalg.norm(jacobian[:, 3:])], 3)  # of shifts and rotations
    best = np.linalg.svd(jacobian / scale)[2][:5] * scale
    largest, size = np.abs(off @ best.T).max(axis=0), np.sqrt(np.diag(best @ known[:6, :6] @ best.T))
    print(f"largest differences {largest}, standard deviations {size} [px]")
    assert (largest < [0.005, 0.005, 0.005, 0.005, 0.02] * size).all()


@pytest.mark.parametrize("known", [True, False], ids=["stamped", "unknown latency"])
def test_a_followed_pose_does_not_depend_on_the_axes_of_the_base(known: bool) -> None:
    """The whole scene turned about the vertical: the same image at every instant.

    By 90 degrees, and by an angle that mixes the axes.
    """
    changes = {"simulation.duration": 2.0, "camera.latency_known": known}
    plain = hexapod({**moving([0.002, 0.001, 0.0]), **changes})
    errors = [hs.simulate(plain).feature_error]
    for angle in (np.pi / 2.0, 0.7):
        turn = Rotation.from_rotvec([0.0, 0.0, angle])
        target, robot = plain.target, plain.robot
        turned = plain.updated(
            {
                "robot.base_angles": [float(a + angle) for a in robot.base_angles or ()],
                "robot.home_attitude": [0.0, 0.0, angle],
                "target.points": turn.apply(np.asarray(target.points)).tolist(),
                **moving(turn.apply(target.motion.velocity).tolist()),
            }
        )
        errors.append(hs.simulate(turned).feature_error)
    apart = [float(np.abs(error - errors[0]).max()) for error in errors[1:]]
    print(f"apart by {apart} px, error up to {np.abs(errors[0]).max():.1f} px")
    assert max(apart) < 1e-6


@pytest.mark.parametrize("speed", [0.0002, 0.001, 0.002])
def test_a_slow_target_is_followed(speed: float) -> None:
    """No coordinate of the pose is known well, and the filter's velocity of no target below 19 mm/s; the line's is.

    The weakly observable part of the way is followed as the mean of 2 s.
    """
    run = hs.simulate(hexapod(moving([speed, 0.0, 0.0])))
    last = np.abs(run.feature_error[run.time > 5.0].mean(axis=0)).max()
    print(f"{1e3 * speed:g} mm/s: {last:.3f} px behind in the mean")
    assert run.outcome == "completed"
    assert last < 0.02 + 60.0 * speed


def test_the_weakly_observable_part_of_a_steady_way_stays_behind() -> None:
    """By a share of the speed that grows to its end within 15 s: no velocity is assumed there (docs/model.md)."""
    run = hs.simulate(hexapod({**moving([0.0005, 0.0, 0.0]), "simulation.duration": 26.0, "camera.noise": 0.0}))
    behind = [
        np.abs(run.feature_error[(run.time > start) & (run.time <= start + 1.0)].mean(axis=0)).max() / 0.5  # px s/mm
        for start in (4.0, 15.0, 25.0)
    ]
    print("behind by {:.3f}, {:.3f} and {:.3f} px for each mm/s".format(*behind))
    assert behind == pytest.approx([0.05, 0.09, 0.09], abs=5e-3)  # as they are written


def test_a_target_at_rest_is_not_taken_for_a_moving_one() -> None:
    """Of 20 runs with the noise that is assumed: the command is far quieter than where every velocity counts."""
    scenario = hexapod({"camera.noise": 0.5})
    rates: dict[float, list[float]] = {2.5: [], 0.0: []}
    for certainty, found in rates.items():
        for seed in range(20):
            run = hs.simulate(scenario.updated({"seed": seed, "controller.tracking.certainty": certainty}))
            late = run.time > 4.0
            found.append(float(np.abs(np.diff(run.leg_lengths[late], axis=0)).mean() / TICK))
    quiet, busy = (float(np.median(found)) for found in rates.values())
    print(
        f"seeds 0 to 19: legs at {1e3 * quiet:.4f} mm/s in the mean, where every velocity counts {1e3 * busy:.4f} mm/s"
    )
    assert quiet < busy / 10.0


@pytest.mark.parametrize("noise", [0.25, 1.0])
def test_noise_that_is_half_or_twice_the_assumed_leaves_a_target_at_rest(noise: float) -> None:
    """Assumed is 0.5 px. The error of the image stays below a deviation of the features themselves, per coordinate."""
    run = hs.simulate(hexapod({"camera.noise": noise, "simulation.duration": 8.0}))
    late = np.sqrt((run.feature_error[run.time > 3.0] ** 2).mean())
    print(f"seed {run.scenario.seed}: {late:.2f} px of {noise:g} px")
    assert late < noise


def test_the_command_does_not_jump_before_a_target_at_rest() -> None:
    """Noise as assumed: residuals that no displacement explains do not make the filter begin again."""
    scenario = at_once(0.5, acceleration=[5.0, 5.0, 5.0, 0.5, 0.5, 0.5])
    machine = _core.Hexapod(core_parameters(scenario).robot)
    home, controller = np.array(machine.home_lengths), hs.Controller(scenario)
    still, rng, legs = np.asarray(hs.project(scenario, [0.0] * 6)), np.random.default_rng(0), []
    for _ in range(900):
        seen = still + 0.5 * rng.standard_normal(8)
        legs.append(controller.step(seen, np.full(4, -0.5), leg_lengths=home).leg_positions)
    steps = np.abs(np.diff(legs[300:], axis=0)).max(axis=1)
    print(f"seed 0: steps of {1e3 * np.median(steps):.3f} mm, at most {1e3 * steps.max():.3f} mm")
    assert steps.max() < 8.0 * np.median(steps)


def test_after_a_gap_the_filter_begins_again() -> None:
    """A target that was elsewhere 3 s before has no velocity from that."""
    scenario, sigma = at_once(0.3), 0.3
    machine = _core.Hexapod(core_parameters(scenario).robot)
    home, controller = np.array(machine.home_lengths), hs.Controller(scenario)
    rng = np.random.default_rng(4)
    print("seed 4")

    def frame(followed: list[float]) -> hs.ControllerOutput:
        seen = np.asarray(hs.project(scenario, -np.asarray(followed))) + sigma * rng.standard_normal(8)
        return controller.step(seen, np.full(4, -0.56), leg_lengths=home)

    def blind(seconds: float) -> hs.ControllerOutput:
        for _ in range(round(seconds / TICK)):
            out = controller.step(leg_lengths=home)
        return out

    for _ in range(100):
        frame([0.0] * 6)
    blind(3.0)
    frame([0.005, 0.0, 0.0, 0.0, 0.0, 0.0])
    then = commanded(machine, blind(0.1))
    later = commanded(machine, blind(0.8))
    print(f"moved by {np.abs(later - then).max():.2e}")
    np.testing.assert_allclose(later, then, atol=1e-9)


@pytest.mark.parametrize("jump", [1.5, 6.0])
def test_a_pose_beyond_the_jump_begins_the_filter_again(jump: float) -> None:
    """One frame is displaced by 0.97 and 1.03 of the square root of b(jump), n = 6, in deviations by the recursion.

    The filter goes a part of the way, and on with a velocity: three times the way by the next tick. One that begins
    again is at what the frame shows.
    """
    sigma, frames = 0.001, 40
    scenario = at_once(sigma, IN_SPACE, certainty=0.0, jump=jump)
    gains, machine = scenario.controller.gains, _core.Hexapod(core_parameters(scenario).robot)
    home, jacobian = np.array(machine.home_lengths), view_jacobian(scenario)
    carry, push = of_a_frame(np.asarray(gains.acceleration), TICK)
    reading = sigma**2 * np.linalg.inv(jacobian.T @ jacobian)
    known = np.zeros((12, 12))
    known[:6, :6], known[6:, 6:] = reading, np.diag(np.square(gains.speed))
    for _ in range(frames):
        filtered, known = known, carry @ known @ carry.T + push
        all_of_it = known[:6, :6] + reading
        known = known - known[:, :6] @ np.linalg.solve(all_of_it, known[:6])
    predicted = carry @ filtered @ carry.T + push
    way = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0))[2][0] / np.linalg.norm(jacobian, axis=0)
    way *= jump * np.sqrt((1.0 + 15.0 / (jump**2 + 2.0)) / (way @ np.linalg.solve(all_of_it, way)))
    went = (predicted[:6, :6] + TICK * predicted[6:, :6]) @ np.linalg.solve(all_of_it, way)
    for times, expected in ((0.97, went), (1.03, way)):
        controller, along = hs.Controller(scenario), way / (way @ way)
        for frame in range(frames + 1):
            shown = times * way if frame == frames else np.zeros(6)
            seen = np.asarray(hs.project(scenario, -shown))
            out = controller.step(seen, np.full(4, -0.4), leg_lengths=home)
        share, due = commanded(machine, out) @ along, times * expected @ along
        print(f"jump {jump:g}: {times:g} of it, the command goes {share:.3f} of that way, expected {due:.3f}")
        assert share == pytest.approx(due, rel=0.02)
    assert went @ along > 2.0  # clear of the other case


def test_a_planar_target_is_not_followed_at_its_other_pose() -> None:
    """The other pose, turned the other way, is a local minimum of the residual: steps from there stay there."""
    scenario = at_once(0.1, jump=1e6).updated({"robot.stroke": 0.1})
    machine = _core.Hexapod(core_parameters(scenario).robot)
    home = np.array(machine.home_lengths)
    middle = np.asarray(scenario.target.points).mean(axis=0) - machine.home_position

    def around(angle: float) -> Array:
        return np.array([*(middle - Rotation.from_rotvec([angle, 0.0, 0.0]).apply(middle)), angle, 0.0, 0.0])

    def image(displacement: Array) -> Array:
        return np.asarray(hs.project(scenario, displacement))

    true = image(around(0.4))
    fit = least_squares(lambda d: image(d) - true, around(-0.4), x_scale=[0.1] * 3 + [1.0] * 3, xtol=1e-14, gtol=1e-14)
    other = image(fit.x)
    residual = float(np.sqrt(((other - true) ** 2).mean()))
    assert fit.x[3] < -0.2
    assert residual > 3.0 * 0.1
    rng = np.random.default_rng(0)
    mistaken, right = hs.Controller(scenario), hs.Controller(scenario)
    for _ in range(100):
        out = mistaken.step(other + 0.1 * rng.standard_normal(8), np.full(4, -0.55), leg_lengths=home)
    before = commanded(machine, out)
    for _ in range(6):
        seen = true + 0.1 * rng.standard_normal(8)
        after, expected = (
            commanded(machine, one.step(seen, np.full(4, -0.55), leg_lengths=home)) for one in (mistaken, right)
        )
    print(f"seed 0: residual {residual:.1f} px; {before.round(3)}, then {after.round(3)}, new {expected.round(3)}")
    assert before[3] * expected[3] < 0.0
    np.testing.assert_allclose(after, expected, atol=2e-3)


def covariance(reading: Array, acceleration: Array, period: float) -> Array:
    """Return P (2n, 2n) of the filter after many frames, by its recursion."""
    n = len(reading)
    carry, push = of_a_frame(acceleration, period)
    known = np.eye(2 * n)
    for _ in range(3000):
        known = carry @ known @ carry.T + push
        known = known - known[:, :n] @ np.linalg.solve(known[:n, :n] + reading, known[:n])
    return known


def test_the_steady_filter_is_that_of_the_recursion() -> None:
    scenario = hexapod({"controller.tracking.noise": 4.0})
    scene, gains = scene_of(scenario), scenario.controller.gains
    assert isinstance(gains, Tracking)
    goal = scene.view(scene.home.moved(np.array([0.004, -0.003, 0.002, -0.01, -0.015, 0.02])))
    reading = np.asarray(4.0**2 * np.linalg.inv(goal.jacobian.T @ goal.jacobian), dtype=float)
    known = covariance(reading, np.asarray(gains.acceleration), TICK)
    steady = steady_filter(scene, gains)
    for deviations, variance in ((steady.place, known[:6, :6]), (steady.velocity, known[6:, 6:])):
        found = steady.in_deviations(np.eye(3), deviations)
        expected = np.sqrt(np.diag(np.linalg.inv(variance))[:3])
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_check_names_a_target_that_is_slow_but_not_steady() -> None:
    """It sways below the speed that the filter's velocity counts from; runs have the errors that are stated."""
    noisy = hexapod({"controller.tracking.noise": 4.0, "simulation.duration": 8.0, "metrics.rms_start": 4.0})
    sway = {"target.motion": {"kind": "sinusoid", "amplitude": [0.004, 0.0, 0.0], "frequency": 0.3}}
    slow = noisy.updated(sway)
    (stated,) = [text for text in unlikely_without_runs(slow) if text.startswith("controller.tracking.certainty")]
    print(stated)
    now, left = (float(re.findall(rf"{words} about ([\d.]+) px", stated)[0]) for words in ("up to", "counts:"))
    error = {}
    for certainty in (2.5, 0.0):
        changed = slow.updated({"controller.tracking.certainty": certainty})
        run = hs.simulate(changed)
        error[certainty] = float(np.abs(run.feature_error[run.time > 4.0]).max())
        assert bool([text for text in unlikely_without_runs(changed) if "tracking.certainty" in text]) == (
            certainty > 0.0
        )
    print(f"behind by up to {error[2.5]:.2f} px, with every velocity {error[0.0]:.2f} px")
    assert [error[2.5], error[0.0]] == pytest.approx([now, left], rel=0.2)
    assert now > slow.metrics.band > left
    for fine in (moving([0.001, 0.0, 0.0]), {"metrics.band": 2.0 * error[2.5], **sway}):
        assert not [text for text in unlikely_without_runs(noisy.updated(fine)) if "tracking.certainty" in text]


def test_points_that_are_not_as_assumed_do_not_carry_the_platform_away() -> None:
    """Along weakly observable displacements the target would seem to move with the platform."""
    shift = np.clip(np.arange(0.0, 8.1, 0.1) - 2.0, 0.0, 1.0)[:, None] * [0.004, -0.003, 0.002]
    errors = []
    for motion in (
        {"kind": "recorded", "samples": shift, "sample_period": 0.1},
        moving([0.001, 0.0, 0.0])["target.motion"],
    ):
        run = hs.simulate(
            hexapod(
                {
                    "controller.tracking.noise": 0.3,
                    "uncertainty.depth": [0.05, -0.05, 0.05, 0.05],
                    "target.motion": motion,
                    "simulation.duration": 8.0,
                }
            )
        )
        errors.append(float(np.abs(run.feature_error[run.time > 5.0]).max()))
    print(f"up to {errors} px")
    assert max(errors) < 1.0


def test_check_names_noise_of_the_joints_that_is_not_assumed() -> None:
    """Readings in steps of 1.5 mrad leave more in the image than the camera; the noise that is named keeps it quiet."""
    head = hs.load_scenario("reachy-mini-head")
    scenario = head.updated({"controller.law": "tracking", "camera.prediction": "none", "actuators.kind": "position"})
    (stated,) = [text for text in unlikely_without_runs(scenario) if text.startswith("controller.tracking.noise")]
    print(stated)
    named = float(stated.split("set it to ")[1])
    late = []
    for noise in (0.5, named):
        quiet = scenario.updated({"controller.tracking.noise": noise})
        run = hs.simulate(quiet)
        late.append(float(np.sqrt((run.feature_error[run.time > 3.0] ** 2).mean())))
        assert bool(
            [text for text in unlikely_without_runs(quiet) if text.startswith("controller.tracking.noise")]
        ) == (noise < 1.0)
    print(f"{late[0]:.2f} px with the camera's noise alone, {late[1]:.2f} px with {named} px")
    assert late[1] < late[0] / 2.0


def joint_readings(changes: dict[str, Any], noise: float | None = None) -> tuple[list[str], float]:
    """Return what `check` states of the joints of a hexapod, and the RMS error at rest of three runs [px]."""
    read = hexapod({"controller.tracking.noise": 0.1, "sensors": {"resolution": 0.0, "noise": 0.0} | changes})
    stated = [
        text for text in unlikely_without_runs(read) if text.startswith(("controller.tracking.noise", "sensors."))
    ]
    runs = [
        hs.simulate(read.updated({"controller.tracking.noise": noise or 0.1, "seed": seed})) for seed in range(1, 4)
    ]
    return stated, float(np.sqrt(np.mean([run.feature_error[run.time > 3.0] ** 2 for run in runs])))


def test_white_noise_of_the_joints_is_not_to_be_assumed() -> None:
    """To assume what it leaves in the image does not make the platform quieter."""
    noisy = {"noise": 1e-4}
    stated, quiet = joint_readings(noisy)
    true = scene_of(hexapod({"sensors": {"resolution": 0.0, **noisy}})).image_noise
    assert true > 5.0 * 0.1
    _, assumed = joint_readings(noisy, true)
    print(f"{quiet:.3f} px, with {true:.2f} px assumed {assumed:.3f} px")
    assert not stated
    assert quiet < 0.2 * true
    assert assumed > 0.9 * quiet


def test_steps_of_the_joints_are_named_where_they_matter_against_the_band() -> None:
    """Finer encoders are the remedy that is named, and leave less."""
    coarse, left = joint_readings({"resolution": 2.5e-4})
    fine, less = joint_readings({"resolution": 2.5e-5})
    print(f"{left:.3f} px, {less:.3f} px", coarse)
    assert [text.endswith("take finer encoders") for text in coarse] == [True]
    assert not fine
    assert less < left / 3.0
