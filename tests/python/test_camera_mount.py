"""A camera on a mount, in whole runs: symmetries that hold whatever the core does, and an image by OpenCV."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike

import hexservo as hs
from hexservo import _core
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters

IMAGE_AXES = np.diag([1.0, -1.0, -1.0])  # from OpenCV's camera frame (x right, y down, z ahead) to C


def rotated(features: ArrayLike | None, angle: float) -> list[float]:
    """Image of the same points by a camera that is rotated by an angle about its z axis."""
    c, s = np.cos(angle), np.sin(angle)
    image = np.asarray(features, dtype=float).reshape(4, 2) @ np.array([[c, -s], [s, c]])
    return [float(number) for number in image.ravel()]


@pytest.mark.parametrize("law", list(LAWS))
@pytest.mark.parametrize("mode", ["continuous", "sampled"])
def test_a_mount_rotated_about_the_optical_axis_changes_no_motion(paper: hs.Scenario, law: str, mode: str) -> None:
    """All gains are the same for all features, so that each law gives the same wrench for the rotated image."""
    angle = 0.7
    base = paper.updated(
        {
            "controller.law": law,
            "simulation.mode": mode,
            "simulation.duration": 0.2,
            "controller.switching": {"kind": "tanh", "width": 1e-3},
            **({"camera.prediction": "encoder", "camera.period": 4e-3} if mode == "sampled" else {}),
        }
    )
    if law == "pbvs":  # a goal that some pose gives
        base = base.updated({"uncertainty.depth": 0.0})
    other = base.updated(
        {
            "camera.mount.rotation": [0.0, 0.0, angle],
            "target.initial_features": rotated(base.target.initial_features, angle),
            "target.desired_features": rotated(base.target.desired_features, angle),
        }
    )
    one, two = hs.simulate(base), hs.simulate(other)
    # rounding of the features, 1e-13 px, grows with the loop over 200 steps
    np.testing.assert_allclose(two.position, one.position, rtol=0, atol=1e-11)
    np.testing.assert_allclose(two.twist, one.twist, rtol=0, atol=1e-8)
    np.testing.assert_allclose(two.features[-1], rotated(one.features[-1], angle), rtol=0, atol=1e-6)


def test_the_image_is_that_of_opencv(paper: hs.Scenario) -> None:
    random = np.random.default_rng(4104)
    for _ in range(20):
        position, turn = random.uniform(-0.05, 0.05, 3), random.uniform(-0.2, 0.2, 3)
        points = random.uniform(-0.1, 0.1, (4, 3)) + np.array([0.0, 0.0, -0.7])
        scenario = paper.updated({"camera.mount.position": position.tolist(), "camera.mount.rotation": turn.tolist()})
        camera = core_parameters(scenario).camera
        platform, quaternion = random.uniform(-0.02, 0.02, 3), random.normal(size=4) * 0.05 + [1.0, 0.0, 0.0, 0.0]
        quaternion /= np.linalg.norm(quaternion)
        features, depth = _core.take_image(camera, platform, quaternion, points)
        w, xyz = quaternion[0], quaternion[1:]
        attitude = cv2.Rodrigues(2 * np.arctan2(np.linalg.norm(xyz), w) * xyz / np.linalg.norm(xyz))[0]
        axes = attitude @ cv2.Rodrigues(turn)[0] @ IMAGE_AXES
        centre = platform + attitude @ position
        f = camera.focal_pixels
        pixels, _ = cv2.projectPoints(
            points, cv2.Rodrigues(axes.T)[0], -axes.T @ centre, np.diag([f, f, 1.0]), np.zeros(5)
        )
        # OpenCV counts y downwards
        np.testing.assert_allclose(features.reshape(4, 2), pixels[:, 0] * [1.0, -1.0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(-depth, ((points - centre) @ axes)[:, 2], rtol=0, atol=1e-14)
        np.testing.assert_allclose(_core.lift(camera, platform, quaternion, features, depth), points, atol=1e-14)


@pytest.mark.parametrize("law", list(LAWS))
def test_a_batch_with_mounts_is_the_runs(paper: hs.Scenario, law: str) -> None:
    """Lanes with and without a mount beside each other."""
    base = paper.updated({"controller.law": law, "simulation.duration": 0.05, "uncertainty.depth": 0.0})
    base = base.updated({"controller.switching.kind": "tanh"})
    positions = np.array([[0.0, 0.0, 0.0], [0.01, -0.02, 0.005], [0.0, 0.03, 0.0]])
    errors = np.array([[0.0, 0.0, 0.0], [0.0, 0.01, -0.02], [0.017, 0.0, 0.0]])
    batch = hs.simulate_batch(
        base, {"camera.mount.position": positions, "uncertainty.mount.rotation": errors}, log="trajectory"
    )
    for i, (position, error) in enumerate(zip(positions, errors, strict=True)):
        changes: dict[str, Any] = {
            "camera.mount.position": position.tolist(),
            "uncertainty.mount.rotation": error.tolist(),
        }
        run = hs.simulate(base.updated(changes))
        np.testing.assert_allclose(batch.samples["position"][i], run.position, rtol=0, atol=1e-9)


def test_errors_of_the_mount_are_the_controllers(paper: hs.Scenario) -> None:
    """The assumed camera is that of a scenario with the sum of both mounts; the image is that of the true one."""
    scenario = paper.updated(
        {
            "camera.mount": {"position": [0.01, 0.0, -0.02], "rotation": [0.0, 0.0, np.pi / 2]},
            "uncertainty.mount": {"position": [0.005, 0.0, 0.0], "rotation": [0.0, 0.0, np.pi / 180]},
        }
    )
    settings = core_parameters(scenario)
    np.testing.assert_allclose(settings.assumed_camera.mount.position, [0.015, 0.0, -0.02], rtol=1e-15)
    np.testing.assert_allclose(settings.assumed_camera.mount.rotation, [0, 0, np.pi / 2 + np.pi / 180], atol=1e-15)
    np.testing.assert_array_equal(settings.camera.mount.position, [0.01, 0.0, -0.02])
    result = hs.simulate(scenario.updated({"simulation.duration": 0.01}))
    np.testing.assert_allclose(result.features[0], np.array(scenario.target.initial_features), rtol=0, atol=1e-10)
    # The wrench of the first instant is J^T K_p xi-tilde + G of the assumed mount.
    kelly = scenario.updated({"controller.law": "kelly", "simulation.duration": 0.01, "uncertainty.depth": 0.0})
    run = hs.simulate(kelly)
    jacobian = _core.image_jacobian(settings.assumed_camera, run.features[0], run.depth[0], run.quaternion[0])
    kp = np.asarray(core_parameters(kelly)["controller.kelly.kp"])
    pulled = jacobian.T @ (kp * run.feature_error[0])
    gravity = [0.0, 0.0, -9.8 * scenario.robot.mass, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(run.wrench[0], pulled + gravity, rtol=0, atol=1e-14)


def test_pbvs_ends_off_its_goal_by_the_weight_not_by_the_mount() -> None:
    """The numbers of docs/camera.md: both poses, of the goal and of the camera, are those of the wrong camera."""
    still = {"camera.noise": 0.0, "controller.law": "pbvs", "simulation.duration": 1.0}
    scenario = hs.load_scenario("hand-eye").updated(still)
    right = {"uncertainty.mount.position": [0.0] * 3, "uncertainty.mount.rotation": [0.0] * 3}

    def end(changes: dict[str, Any]) -> float:
        return hs.metrics(hs.simulate(scenario.updated(changes)))["final_error"]

    assert end({}) == pytest.approx(0.449, abs=5e-4)
    assert end(right) == pytest.approx(0.465, abs=5e-4)
    assert end({"uncertainty.gravity": 0.0}) < 1e-3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera.mount.rotation": [0.0, 0.0, 90.0]}, "camera.mount.rotation: expected a rotation vector at most"),
        ({"camera.mount.rotation": [0.0, 0.1]}, "camera.mount.rotation: expected 3 finite numbers"),
        ({"uncertainty.mount.rotation": [0.0, 0.0, 4.0]}, "uncertainty.mount.rotation: expected a rotation vector"),
        ({"camera.mount.position": None}, "camera.mount.position: expected 3 numbers >"),
        ({"camera.convention": "as_printed", "camera.mount.position": [0.1, 0, 0]}, "camera.mount: expected no mount"),
    ],
)
def test_a_mount_is_refused_with_its_key(paper: hs.Scenario, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        core_parameters(paper.updated(changes))
