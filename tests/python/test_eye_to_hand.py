"""A camera on the base that watches a target on the platform, against chains of frames that the core has no part in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.findings.check import unlikely
from hexservo.report.scene import scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters

TAG = 0.5 * np.array([[-0.06, 0.06, 0.0], [0.06, 0.06, 0.0], [0.06, -0.06, 0.0], [-0.06, -0.06, 0.0]])  # [m]
TAG_POSE = [0.03, 0.02, -0.01, 3.14159265, 0.0, 0.0]  # of the scenario `eye-to-hand`
CAMERA = np.array([0.12, 0.0, -0.65])  # [m], of the scenario `eye-to-hand`
AHEAD = Rotation.from_rotvec([np.pi, 0.0, 0.0])  # from a camera of OpenCV to one of the paper
EXACT = {
    **dict.fromkeys((f"uncertainty.{key}" for key in ("inertia", "coriolis", "gravity", "depth")), 0.0),
    **dict.fromkeys(("uncertainty.mount.position", "uncertainty.mount.rotation"), [0.0] * 3),
    "camera.noise": 0.0,
}
FOCAL = 900.0  # [px]


@pytest.fixture(scope="module")
def watched() -> hs.Scenario:
    return hs.load_scenario("eye-to-hand")


def pose_of(displacement: Any, scenario: hs.Scenario) -> tuple[Array, Rotation]:
    """Pose of the platform, position and attitude, from its displacement."""
    home = Rotation.from_rotvec(scenario.robot.home_attitude)
    return (
        np.array(scenario.robot.home_position) + np.asarray(displacement)[:3],
        Rotation.from_rotvec(np.asarray(displacement)[3:]) * home,
    )


def wxyz(attitude: Rotation) -> Array:
    return np.asarray(attitude.as_quat()[..., [3, 0, 1, 2]])


def combination(on: str, axes: str, random: np.random.Generator) -> tuple[hs.Scenario, Array]:
    """A scenario with any mount, and its points in the frame that they are fixed in."""
    tilt = Rotation.from_rotvec(random.uniform(-0.3, 0.3, 3))
    turn = tilt * AHEAD if (axes == "opencv") == (on == "platform") else tilt
    position = random.uniform(-0.05, 0.05, 3)
    looks = turn.apply([0.0, 0.0, 1.0 if axes == "opencv" else -1.0])
    home = np.array([0.0, 0.0, -0.15])
    # of a camera on the base the points are on the platform, 0.5 m before it
    if on == "base":
        position = home - 0.5 * looks + random.uniform(-0.02, 0.02, 3)
        points = TAG + random.uniform(-0.02, 0.02, (4, 3))
    else:
        points = home + position + 0.5 * looks + TAG + random.uniform(-0.02, 0.02, (4, 3))
    changes = {
        "camera.axes": axes,
        "camera.mount": {"on": on, "position": position.tolist(), "rotation": turn.as_rotvec().tolist()},
        "uncertainty.mount": {"position": [0.004, -0.003, 0.002], "rotation": [0.01, 0.02, -0.015]},
        "target": {"initial_features": None, "depth": None, "points": points.tolist()},
    }
    return hs.load_scenario("paper").updated(changes), points


def image_of(scenario: hs.Scenario, points: Array, position: Array, attitude: Rotation, wrong: bool = False) -> Array:
    """Features of the points by a chain of frames; `wrong`: of the controller's mount."""
    camera, error = scenario.camera, scenario.uncertainty.mount
    place, turn = np.array(camera.mount.position), Rotation.from_rotvec(camera.mount.rotation)
    if wrong:
        place, turn = place + np.array(error.position), turn * Rotation.from_rotvec(error.rotation)
    if camera.mount.on == "base":
        seen = turn.inv().apply(position + attitude.apply(points) - place)
    else:
        seen = turn.inv().apply(attitude.inv().apply(points - position) - place)
    x, y, z = seen.T
    up = -1.0 if camera.axes == "opencv" else 1.0
    focal = core_parameters(scenario).camera.focal_pixels
    return np.asarray(np.stack([focal * x / np.abs(z), up * focal * y / np.abs(z)], axis=1).ravel())


def derivative(image: Callable[[Array], Array]) -> Array:
    """Central differences along the six displacements: third derivatives of 1e5 px times h^2, rounding 1e-12/h."""
    h = 1e-5
    return np.column_stack([(image(h * e) - image(-h * e)) / (2.0 * h) for e in np.eye(6)])


@pytest.mark.parametrize("axes", ["paper", "opencv"])
@pytest.mark.parametrize("on", ["platform", "base"])
def test_image_and_jacobian_are_those_of_the_chain_of_frames(on: str, axes: str) -> None:
    random = np.random.default_rng(4201)
    for _ in range(5):
        scenario, points = combination(on, axes, random)
        probe = _core.Probe(core_parameters(scenario))
        move = random.uniform(-1.0, 1.0, 6) * np.repeat([0.01, 0.1], 3)
        position, attitude = pose_of(move, scenario)
        at = (position[None], wxyz(attitude)[None])

        features, depth = probe.image(*at)
        np.testing.assert_allclose(features[0], image_of(scenario, points, position, attitude), rtol=0, atol=1e-10)
        assert (depth < 0).all()

        def moved(d: Array, wrong: bool) -> Array:
            there = (position + d[:3], Rotation.from_rotvec(d[3:]) * attitude)  # noqa: B023 (called at once)
            return image_of(scenario, points, *there, wrong=wrong)  # noqa: B023

        for wrong in (False, True):
            slope = derivative(lambda d, wrong=wrong: moved(d, wrong))  # type: ignore[misc]
            seen, z = features, depth
            if wrong:  # the controller's camera has another image of the points, whose depths are along its axis
                settings = core_parameters(scenario)
                seen, z = _core.take_image(settings.assumed_camera, at[0][0], at[1][0], points)
                np.testing.assert_allclose(seen, moved(np.zeros(6), True), rtol=0, atol=1e-10)
            jacobian = probe.image_jacobian(np.atleast_2d(seen), np.atleast_2d(z), at[1], wrong, at[0])[0]
            np.testing.assert_allclose(jacobian, slope, rtol=0, atol=1e-8 * np.abs(slope).max())
            camera = core_parameters(scenario).assumed_camera if wrong else core_parameters(scenario).camera
            alone = _core.image_jacobian(camera, seen.ravel(), z.ravel(), at[1][0], position=position)
            np.testing.assert_allclose(alone, jacobian, rtol=0, atol=1e-14 * np.abs(slope).max())
        lifted = _core.lift(core_parameters(scenario).camera, at[0][0], at[1][0], features[0], depth[0])
        np.testing.assert_allclose(lifted, points, rtol=0, atol=1e-14)


def test_the_pixels_of_a_pose_are_those_of_opencv(watched: hs.Scenario) -> None:
    random = np.random.default_rng(4202)
    tag = np.array(TAG_POSE[:3]) + Rotation.from_rotvec(TAG_POSE[3:]).apply(TAG)
    distorted = watched.updated({"camera.distortion.brown_conrady": [-0.2, 0.05, 8e-4, -5e-4, -0.01]})
    intrinsics = np.array([[FOCAL, 0.0, 639.5], [0.0, FOCAL, 479.5], [0.0, 0.0, 1.0]])
    turn = Rotation.from_rotvec(watched.camera.mount.rotation)
    for _ in range(20):
        move = random.uniform(-1.0, 1.0, 6) * np.repeat([0.01, 0.1], 3)
        position, attitude = pose_of(move, watched)
        in_camera = turn.inv() * attitude
        shift = turn.inv().apply(position - CAMERA)
        for scenario, lens in ((watched, np.zeros(5)), (distorted, np.array([-0.2, 0.05, 8e-4, -5e-4, -0.01]))):
            pixels, _ = cv2.projectPoints(tag, in_camera.as_rotvec(), shift, intrinsics, lens)
            np.testing.assert_allclose(hs.project(scenario, move), pixels.ravel(), rtol=0, atol=1e-9)


def test_a_goal_as_a_pose_is_its_pixels(watched: hs.Scenario) -> None:
    goal = [0.006, -0.004, -0.003, 0.03, -0.02, 0.05]
    np.testing.assert_array_equal(watched.target.desired_features, hs.project(watched, goal))


def test_the_pose_estimate_is_that_of_solve_pnp(watched: hs.Scenario) -> None:
    """With unit stiffness the wrench of `pbvs` is the displacement from the estimate to the goal, and the weight."""
    unit = {"kp": 1.0, "kd": 0.0, "prior": 0.0}
    scenario = watched.updated({**EXACT, "controller": {"law": "pbvs", "pbvs": unit}, "simulation.mode": "sampled"})
    probe = _core.Probe(core_parameters(scenario))
    goal, facing = pose_of([0.006, -0.004, -0.003, 0.03, -0.02, 0.05], scenario)
    turn = Rotation.from_rotvec(scenario.camera.mount.rotation)
    tag = np.array(TAG_POSE[:3]) + Rotation.from_rotvec(TAG_POSE[3:]).apply(TAG)
    intrinsics = np.diag([FOCAL, FOCAL, 1.0])
    random = np.random.default_rng(4203)
    for _ in range(10):
        position, attitude = pose_of(random.uniform(-1.0, 1.0, 6) * np.repeat([0.01, 0.1], 3), scenario)
        joints = pose_of(random.uniform(-1.0, 1.0, 6) * np.repeat([0.002, 0.02], 3), scenario)
        features, depth = probe.image(position[None], wxyz(attitude)[None])
        pixels = features.reshape(4, 2) * [1.0, -1.0]  # from the principal point
        solved, rvec, tvec = cv2.solvePnP(tag, pixels, intrinsics, np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
        rvec, tvec = cv2.solvePnPRefineLM(
            tag,
            pixels,
            intrinsics,
            np.zeros(5),
            rvec,
            tvec,
            (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-16),
        )
        assert solved
        found = CAMERA + turn.apply(tvec.ravel()), turn * Rotation.from_rotvec(rvec.ravel())
        at = (joints[0][None], wxyz(joints[1])[None])
        error = probe.law(features, depth, *at, np.zeros((1, 6))).pose_error
        assert error is not None
        expected = np.concatenate([goal - found[0], (facing * found[1].inv()).as_rotvec()])
        # OpenCV's solution is exact to its differences; the image constrains tilts by 50 px/rad
        np.testing.assert_allclose(error[0], expected, rtol=0, atol=1e-6)
        exact = np.concatenate([goal - position, (facing * attitude.inv()).as_rotvec()])
        np.testing.assert_allclose(error[0], exact, rtol=0, atol=1e-9)


class Chain:
    """The closed loop of `kelly` in NumPy: frames, pinhole, rigid body and law, integrated by Runge-Kutta."""

    def __init__(self, scenario: hs.Scenario, points: Array, camera: tuple[Array, Rotation], seen: list[Any]) -> None:
        robot, errors = scenario.robot, scenario.uncertainty
        self.mass, self.inertia = robot.mass, np.diag(np.array(robot.inertia))
        self.weight = robot.mass * np.array(robot.gravity)
        self.points, self.camera = points, camera
        mount = errors.mount
        self.assumed = camera[0] + np.array(mount.position), camera[1] * Rotation.from_rotvec(mount.rotation)
        self.desired = seen
        self.of_inertia, self.of_coriolis, self.of_gravity, self.of_depth = (
            np.asarray(value) for value in (errors.inertia, errors.coriolis, errors.gravity, errors.depth)
        )
        self.kp = 1e-6
        self.kd = np.array([1.2, 1.2, 1.2, 0.024, 0.024, 0.048])

    def features(self, position: Array, attitude: Rotation) -> tuple[Array, Array]:
        """Normalised image (p, 2) with y down, and depths (p,)."""
        seen = self.camera[1].inv().apply(position + attitude.apply(self.points) - self.camera[0])
        return seen[:, :2] / seen[:, 2:], seen[:, 2]

    def wrench(self, position: Array, attitude: Rotation, twist: Array) -> Array:
        image, z = self.features(position, attitude)
        assumed = z * (1.0 + self.of_depth)
        place, turn = self.assumed
        lifted = place + turn.apply(np.column_stack([image * assumed[:, None], assumed]))  # in B
        spring = np.zeros(6)
        for point, error, depth, (x, y) in zip(lifted, self.desired - FOCAL * image, assumed, image, strict=True):
            pull = FOCAL / depth * np.array([[1.0, 0.0, -x], [0.0, 1.0, -y]])  # pixels per motion of the point in C
            force = turn.apply(pull.T @ (self.kp * error))
            spring += [*force, *np.cross(point - position, force)]
        return np.asarray(spring - self.kd * twist - [*self.weight, 0.0, 0.0, 0.0])

    def rate(self, state: Array) -> Array:
        position, q, twist = state[:3], state[3:7], state[7:]
        attitude = Rotation.from_quat(q[[1, 2, 3, 0]])
        wrench = self.wrench(position, attitude, twist)
        turned = attitude.as_matrix()
        inertia, w = turned @ self.inertia @ turned.T, twist[3:]
        v = (wrench[:3] + (1 - self.of_gravity) * self.weight) / ((1 - self.of_inertia) * self.mass)
        gyroscopic = (1 - self.of_coriolis) * np.cross(w, inertia @ w)
        turn = np.linalg.solve((1 - self.of_inertia) * inertia, wrench[3:] - gyroscopic)
        spin = 0.5 * np.array([-(w @ q[1:]), *(q[0] * w + np.cross(w, q[1:]))])
        return np.concatenate([twist[:3], spin, v, turn])

    def run(self, position: Array, steps: int, step: float) -> Array:
        state = np.concatenate([position, [1.0, 0.0, 0.0, 0.0], np.zeros(6)])
        states = [state]
        for _ in range(steps):
            k1 = self.rate(state)
            k2 = self.rate(state + step / 2 * k1)
            k3 = self.rate(state + step / 2 * k2)
            k4 = self.rate(state + step * k3)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            state[3:7] /= np.linalg.norm(state[3:7])
            states.append(state)
        return np.array(states)


def test_a_run_is_that_of_a_loop_written_in_numpy(watched: hs.Scenario) -> None:
    """Errors of inertia, weight, depth and mount included; rounding of 1e-13 px over 400 steps of a damped loop."""
    devices = {"camera.period": None, "camera.latency": 0.0, "camera.noise": 0.0, "camera.prediction": "none"}
    scenario = watched.updated(
        {
            "controller": {"law": "kelly", "switching": {"kind": "sign"}},
            **devices,
            "camera.image_size": None,
            "simulation": {"mode": "continuous", "step": 1e-3, "duration": 0.4},
        }
    )
    turn = Rotation.from_rotvec(scenario.camera.mount.rotation)
    tag = np.array(TAG_POSE[:3]) + Rotation.from_rotvec(TAG_POSE[3:]).apply(TAG)
    desired = np.array(scenario.target.desired_features).reshape(4, 2) - [639.5, 479.5]
    chain = Chain(scenario, tag, (CAMERA, turn), desired)  # type: ignore[arg-type]
    states = chain.run(np.array(scenario.robot.home_position), 400, 1e-3)
    run = hs.simulate(scenario)
    np.testing.assert_allclose(run.position, states[:, :3], rtol=0, atol=1e-11)
    np.testing.assert_allclose(run.quaternion, states[:, 3:7], rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.twist, states[:, 7:], rtol=0, atol=1e-8)
    assert np.ptp(run.position, axis=0).max() > 1e-3  # it does move


def test_a_prediction_with_exact_sensors_is_the_image_itself(watched: hs.Scenario) -> None:
    """Points are fixed to the platform: carried along by exact poses, late and rare frames are no fault."""
    exact = watched.updated({**EXACT, "simulation.duration": 0.3, "controller.switching.kind": "tanh"})
    late = hs.simulate(exact)
    prompt = hs.simulate(exact.updated({"camera.period": None, "camera.latency": 0.0, "camera.prediction": "none"}))
    # until the first frame arrives the safe output holds the platform
    first = 33
    np.testing.assert_allclose(late.position[first:], prompt.position[:-first], rtol=0, atol=1e-9)


@pytest.mark.parametrize("law", list(LAWS))
def test_every_law_reaches_the_goal(watched: hs.Scenario, law: str) -> None:
    """Without model errors, with encoders; a controller built of the scenario gives the wrench of the run."""
    scenario = watched.updated(
        {
            **EXACT,
            "controller": {"law": law, "switching": {"kind": "tanh"}},
            "sensors": {"pose": "encoders", "rate": True},
            "simulation": {"mode": "sampled", "duration": 1.5},
        }
    )
    run = hs.simulate(scenario)
    assert run.outcome == "completed"
    left = np.linalg.norm(run.feature_error[-1]) / np.linalg.norm(run.feature_error[0])
    assert left < 0.5, left
    probe = _core.Probe(core_parameters(scenario))
    assert probe.points == 4


def test_a_batch_is_the_runs(watched: hs.Scenario) -> None:
    base = watched.updated({"simulation.duration": 0.2})
    positions = CAMERA + np.array([[0.0, 0.0, 0.0], [0.01, -0.02, 0.005], [0.0, 0.03, 0.0]])
    for law in LAWS:
        scenario = base.updated({"controller.law": law, "controller.switching.kind": "tanh"})
        batch = hs.simulate_batch(scenario, {"camera.mount.position": positions}, log="trajectory")
        for i, position in enumerate(positions):
            run = hs.simulate(scenario.updated({"camera.mount.position": position.tolist()}))
            np.testing.assert_allclose(batch.samples["position"][i], run.position, rtol=0, atol=1e-9)


def test_a_controller_ticks_as_the_run_did(watched: hs.Scenario) -> None:
    scenario = watched.updated({**EXACT, "controller": {"law": "kelly"}, "simulation.duration": 0.1})
    prompt = scenario.updated({"camera.period": None, "camera.latency": 0.0, "camera.prediction": "none"})
    run = hs.simulate(prompt)
    controller = hs.Controller(prompt)
    for k in range(0, len(run.time), 10):
        out = controller.step(
            run.pixels[k], run.depth[k], run.position[k], run.quaternion[k], run.twist[k], now=float(run.time[k])
        )
        np.testing.assert_allclose(out.wrench, run.wrench[k], rtol=0, atol=1e-12)


def test_the_report_draws_the_target_on_the_platform(watched: hs.Scenario) -> None:
    run = hs.simulate(watched.updated({"simulation.duration": 0.5}))
    view = scene(run)
    assert view.on_base
    low, high = view.box()
    assert ((low <= CAMERA + 1e-15) & (high >= CAMERA - 1e-15)).all()
    np.testing.assert_allclose(view.placed(0, np.zeros(3)), CAMERA, rtol=0, atol=1e-15)
    tag = np.array(TAG_POSE[:3]) + Rotation.from_rotvec(TAG_POSE[3:]).apply(TAG)
    for frame in (0, len(view.time) - 1):
        expected = view.position[frame] + tag @ view.rotation[frame].T
        target = view.target(frame)
        assert target is not None
        np.testing.assert_allclose(target, expected, rtol=0, atol=1e-12)
        # the drawn feature lies on the line of sight from the camera to its point
        seen = view.placed(frame, view.image[frame]) - CAMERA
        line = expected - CAMERA
        assert np.abs(np.cross(seen, line)).max() <= 1e-12


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target.frame": "world"}, "target.frame: expected base where camera.mount.on is base"),
        ({"target.motion.kind": "velocity"}, "target.motion.kind: expected none where camera.mount.on is base"),
        ({"target.tag": {"size": 0.06, "pose": [0.0] * 6}}, "target.tag.pose: expected a tag whose front"),
        ({"camera.mount.on": "ceiling"}, r"camera.mount.on: expected one of .?platform.*base"),
    ],
)
def test_what_makes_no_sense_is_refused(watched: hs.Scenario, changes: dict[str, Any], message: str) -> None:
    if "target.tag" in changes:
        changes = {
            "target": {
                "points": None,
                "desired_features": None,
                "desired_pose": [0.0] * 6,
                "tag": changes["target.tag"],
            }
        }
    with pytest.raises(ValueError, match=message):
        core_parameters(watched.updated(changes))


def test_a_camera_as_printed_has_no_place_on_the_base(paper: hs.Scenario) -> None:
    with pytest.raises(ValueError, match=r"camera.mount: expected no mount for a camera as_printed"):
        core_parameters(paper.updated({"camera.convention": "as_printed", "camera.mount.on": "base"}))


def test_a_jacobian_without_the_platforms_position_is_refused(watched: hs.Scenario) -> None:
    settings = core_parameters(watched)
    probe = _core.Probe(settings)
    home = (np.array(watched.robot.home_position)[None], np.array([[1.0, 0.0, 0.0, 0.0]]))
    features, depth = probe.image(*home)
    with pytest.raises(ValueError, match="position: expected that of the platform"):
        probe.image_jacobian(features, depth, home[1])
    with pytest.raises(ValueError, match="position: expected that of the platform"):
        _core.image_jacobian(settings.camera, features[0], depth[0], home[1][0])


def test_the_scenario_is_what_it_seems(watched: hs.Scenario) -> None:
    assert unlikely(watched) == []
