"""Pixels of a real camera: projection and rectification against OpenCV, and runs through a lens."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

import hexservo as hs
from camera_frames import PICTURE, picture
from hexservo import _core
from hexservo.campaigns.loop_numbers import delay_margin
from hexservo.cli.terminal import load
from hexservo.run.export import gains_header
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.pixels import (
    desired_features,
    on_pinhole,
    pixel_slopes,
    points_outside,
    to_features,
    to_pixels,
)

SIZE = (1280, 960)
MATRIX = np.array([[905.5, 0.0, 650.25], [0.0, 903.0, 470.75], [0.0, 0.0, 1.0]])
LENSES: dict[str, Any] = {
    "pinhole": None,
    "brown_conrady": [-0.28, 0.09, 8e-4, -5e-4, -0.012],
    "kannala_brandt": [0.021, -0.009, 0.004, -0.001],
}


def camera_of(lens: str, **more: Any) -> dict[str, Any]:
    model = "kannala_brandt" if lens == "kannala_brandt" else "brown_conrady"
    return {**hs.camera_from_opencv(MATRIX, LENSES[lens], SIZE, model=model), **more}  # type: ignore[arg-type]


def opencv(lens: str, points: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of points (n, 3) in OpenCV's camera frame."""
    function = cv2.fisheye.projectPoints if lens == "kannala_brandt" else cv2.projectPoints
    coefficients = np.zeros(5) if LENSES[lens] is None else np.array(LENSES[lens])
    arguments = (np.zeros(3), np.zeros(3), MATRIX, coefficients)
    return np.asarray(function(points[:, None], *arguments)[0])[:, 0]


def in_pixels(scenario: hs.Scenario, lens: str, **more: Any) -> hs.Scenario:
    """The scenario seen by a camera with that lens: the same points in space, goals in its pixels."""
    base = scenario.updated({"simulation.mode": "sampled", "camera.focal_length": None, "camera.pixel_scale": None,
                             "camera.focal_pixels": MATRIX[0, 0]})  # fmt: skip
    with_lens = base.camera.model_dump() | camera_of(lens, **more)
    probe = base.updated({"camera": {key: value for key, value in with_lens.items() if key != "image_size"}})
    return probe.updated(
        {
            "camera.image_size": list(SIZE),
            "target.initial_features": to_pixels(probe, base.target.initial_features).tolist(),
            "target.desired_features": to_pixels(probe, base.target.desired_features).tolist(),
        }
    )


@pytest.fixture
def plain_camera(paper: hs.Scenario) -> hs.Scenario:
    """The paper's task in sampled mode with f of the calibration."""
    return paper.updated(
        {
            "simulation.mode": "sampled",
            "simulation.duration": 0.2,
            "camera.focal_length": None,
            "camera.pixel_scale": None,
            "camera.focal_pixels": MATRIX[0, 0],
            "controller.switching.kind": "tanh",
        }
    )


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_are_those_of_opencv(plain_camera: hs.Scenario, lens: str) -> None:
    random = np.random.default_rng(5201)
    camera = core_parameters(in_pixels(plain_camera, lens)).camera
    f = camera.focal_pixels
    assert f == MATRIX[0, 0]
    rays = np.column_stack([random.uniform(-0.65, 0.65, (500, 2)), np.ones(500)]) * random.uniform(0.1, 3, (500, 1))
    features = f * rays[:, :2] / rays[:, 2:] * [1.0, -1.0]  # y up
    pixels = camera.pixels(features)
    np.testing.assert_allclose(pixels, opencv(lens, rays), rtol=0, atol=1e-9)


def test_slopes_of_pixels_are_those_of_neighbouring_points(plain_camera: hs.Scenario) -> None:
    """Row by row those of u and of v, of a lens with two focal lengths and tangential terms, which mixes both."""
    scenario, place = in_pixels(plain_camera, "brown_conrady"), np.array([-300.0, 200.0])
    (slopes,) = pixel_slopes(scenario, place)
    for axis in range(2):
        near = place + np.eye(2)[axis]
        np.testing.assert_allclose(to_pixels(scenario, near) - to_pixels(scenario, place), slopes[:, axis], atol=2e-3)
    assert abs(slopes[0, 1] - slopes[1, 0]) > 0.01


def test_a_camera_is_made_once_for_a_scenario(plain_camera: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """And again for another one: searches over places ask for the pixels of one scenario hundreds of times."""
    made: list[hs.Scenario] = []

    def counted(scenario: hs.Scenario) -> Any:
        made.append(scenario)
        return core_parameters(scenario)

    monkeypatch.setattr("hexservo.scenario.pixels.core_parameters", counted)
    one = in_pixels(plain_camera, "pinhole").updated({"camera.principal_point": [612.0, 377.0]})
    other = one.updated({"camera.principal_point": [613.0, 377.0]})
    made.clear()
    at = [to_pixels(scenario, np.zeros(2)).tolist() for scenario in (one, one, other, one)]
    assert at == [[612.0, 377.0], [612.0, 377.0], [613.0, 377.0], [612.0, 377.0]]
    assert len(made) <= 2


def test_an_image_begins_half_a_pixel_before_the_centre_of_its_first_one(plain_camera: hs.Scenario) -> None:
    """As OpenCV counts: of 1280 columns from -0.5 to 1279.5."""
    scenario = in_pixels(plain_camera, "pinhole")
    for u, outside in ((-0.6, True), (-0.4, False), (SIZE[0] - 0.6, False), (SIZE[0] - 0.4, True)):
        assert points_outside(scenario, to_features(scenario, [u, 300.0])).tolist() == [outside]


@pytest.mark.parametrize("lens", LENSES)
def test_every_pixel_of_the_image_is_rectified(plain_camera: hs.Scenario, lens: str) -> None:
    """Residual below 1e-6 px everywhere in the image, borders included; it is below 1e-9 px."""
    camera = core_parameters(in_pixels(plain_camera, lens)).camera
    u, v = np.meshgrid(np.linspace(-0.5, SIZE[0] - 0.5, 81), np.linspace(-0.5, SIZE[1] - 0.5, 61))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    features = camera.features(pixels)
    assert np.isfinite(features).all()
    np.testing.assert_allclose(camera.pixels(features), pixels, rtol=0, atol=1e-9)
    # OpenCV's own rectification, by iteration until it changes by no more than 1e-12
    ideal = features / camera.focal_pixels * [1.0, -1.0]
    rays = np.column_stack([ideal, np.ones(len(ideal))])
    np.testing.assert_allclose(opencv(lens, rays), pixels, rtol=0, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("law", list(LAWS))
def test_a_lens_with_right_numbers_changes_no_motion(plain_camera: hs.Scenario, law: str, lens: str) -> None:
    """The points in space are the same: only the rounding of the rectification remains."""
    base = plain_camera.updated({"controller.law": law, "uncertainty.depth": 0.0})
    run, seen = hs.simulate(base), hs.simulate(in_pixels(base, lens))
    np.testing.assert_allclose(seen.position, run.position, rtol=0, atol=1e-11)
    np.testing.assert_allclose(seen.features, run.features, rtol=0, atol=1e-6)
    np.testing.assert_allclose(seen.pixels, to_pixels(seen.scenario, run.features), rtol=0, atol=1e-6)
    assert seen.outcome == run.outcome == "completed"


def test_without_a_lens_pixels_are_features(paper: hs.Scenario) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.01}))
    np.testing.assert_array_equal(result.pixels, result.features)


def test_noise_rounding_and_border_act_on_pixels(plain_camera: hs.Scenario) -> None:
    """With the right lens: what the controller makes of whole pixels, put back through OpenCV, are whole pixels."""
    scenario = in_pixels(plain_camera, "brown_conrady").updated({"camera.quantisation": 1.0, "camera.noise": 0.7})
    seen: list[np.ndarray] = []

    def controller(observation: hs.Observation) -> np.ndarray:
        seen.append(np.array(observation.features))
        return np.zeros(6)

    hs.simulate(scenario.updated({"simulation.duration": 0.01}), controller=controller)
    ideal = np.concatenate(seen).reshape(-1, 2) / MATRIX[0, 0] * [1.0, -1.0]
    pixels = opencv("brown_conrady", np.column_stack([ideal, np.ones(len(ideal))]))
    np.testing.assert_allclose(pixels, np.round(pixels), rtol=0, atol=1e-6)
    # the border: a point that passes the right edge of the image is lost
    corner = to_features(scenario, np.tile([SIZE[0] - 1.0, 200.0], 4))
    assert np.isfinite(corner).all()
    near = np.array([1200.0, 150.0, 1270.0, 180.0, 1230.0, 300.0, 1180.0, 260.0])
    gone = scenario.updated(
        {
            "target.initial_features": (near - 40.0).tolist(),
            "target.desired_features": near.tolist(),
            "simulation.duration": 2.0,
            "controller.law": "composite",
            "camera.image_size": [1250, 960],
            "camera.on_lost": "stop",
            "camera.quantisation": 0.0,
            "camera.noise": 0.0,
        }
    )
    run = hs.simulate(gone)
    assert run.outcome == "feature_lost"
    assert 1249.0 < run.pixels[-1].reshape(4, 2)[:, 0].max() <= 1249.5  # of the last sample before


def test_wrong_intrinsics_are_the_controllers(plain_camera: hs.Scenario) -> None:
    """What the controller sees is the true pixel, rectified with its own numbers; the goal in pixels is reached."""
    scenario = in_pixels(plain_camera, "brown_conrady").updated(
        {"uncertainty.focal_length": 0.02, "uncertainty.principal_point": [3.0, -2.0], "simulation.duration": 0.01}
    )
    settings = core_parameters(scenario)
    true, assumed = settings.camera, settings.assumed_camera
    assert assumed.focal_pixels == pytest.approx(1.02 * MATRIX[0, 0], rel=1e-15)
    seen: list[np.ndarray] = []

    def controller(observation: hs.Observation) -> np.ndarray:
        seen.append(np.array(observation.features))
        return np.zeros(6)

    result = hs.simulate(scenario, controller=controller)
    pixels = true.pixels(result.features[0].reshape(4, 2))
    np.testing.assert_allclose(pixels.ravel(), np.asarray(scenario.target.initial_features), rtol=0, atol=1e-9)
    matrix = MATRIX.copy()
    matrix[:2, :2] *= 1.02
    matrix[:2, 2] += [3.0, -2.0]
    rays = np.column_stack([seen[0].reshape(4, 2) / matrix[0, 0] * [1.0, -1.0], np.ones(4)])
    again = cv2.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), matrix, np.array(LENSES["brown_conrady"]))[0]
    np.testing.assert_allclose(again[:, 0], pixels, rtol=0, atol=1e-9)
    long = hs.simulate(scenario.updated({"simulation.duration": 5.0, "controller.law": "composite"}))
    np.testing.assert_allclose(long.pixels[-1], scenario.target.desired_features, rtol=0, atol=2.0)


@pytest.mark.parametrize("lens", LENSES)
def test_a_custom_controller_is_given_the_pixels_that_the_tick_takes(plain_camera: hs.Scenario, lens: str) -> None:
    """They are those of the image, whatever the controller assumes wrongly, and by them the tick is the law itself."""
    scenario = in_pixels(plain_camera, lens).updated(
        {"uncertainty.focal_length": 0.02, "uncertainty.principal_point": [3.0, -2.0], "simulation.duration": 0.05}
    )
    tick = hs.Controller(scenario, period=scenario.simulation.step)
    given: list[np.ndarray] = []

    def law(seen: hs.Observation) -> np.ndarray:
        given.append(seen.pixels)
        return tick.step(seen.pixels, seen.depth, seen.position, seen.quaternion, seen.twist).wrench

    own, core = hs.simulate(scenario, controller=law), hs.simulate(scenario)
    np.testing.assert_allclose(given, own.pixels, rtol=0, atol=1e-9)  # the residual of the rectification
    np.testing.assert_allclose(own.position, core.position, rtol=0, atol=1e-11)  # as with and without a lens
    np.testing.assert_allclose(own.pixels, core.pixels, rtol=0, atol=1e-6)


def test_the_controller_takes_pixels(plain_camera: hs.Scenario) -> None:
    """`hs.Controller` is the controller of the simulation: it rectifies what it is given."""
    scenario = in_pixels(plain_camera, "kannala_brandt").updated({"controller.law": "kelly"})
    pinhole = on_pinhole(scenario)
    depth = -np.full(4, 0.5)
    home = np.array(scenario.robot.home_position), np.array([1.0, 0.0, 0.0, 0.0])
    pixels = np.asarray(scenario.target.initial_features)
    one = hs.Controller(scenario).step(pixels, depth, *home, np.zeros(6))
    two = hs.Controller(pinhole).step(to_features(scenario, pixels), depth, *home, np.zeros(6))
    np.testing.assert_allclose(one.wrench, two.wrench, rtol=0, atol=1e-12)
    np.testing.assert_allclose(desired_features(scenario), pinhole.target.desired_features, rtol=0, atol=1e-12)


@pytest.mark.parametrize("axes", ["paper", "opencv"])
@pytest.mark.parametrize("rotation", [[0.0, 0.0, 0.0], [math.pi, 0.0, 0.0], [0.3, -2.0, 1.1], [-1.0, 2.5, 1.2]])
def test_the_pinhole_looks_where_the_camera_does(plain_camera: hs.Scenario, axes: str, rotation: list[float]) -> None:
    """The axes of the paper are x, -y and -z of OpenCV's."""
    scenario = plain_camera.updated(
        {
            "camera.axes": axes,
            "camera.principal_point": [320.0, 240.0],
            "camera.mount": {"position": [0.1, -0.2, 0.3], "rotation": rotation},
            "uncertainty.mount.rotation": [0.01, 0.02, 0.03],
        }
    )
    pinhole = on_pinhole(scenario)
    places = np.vstack([np.zeros(3), np.eye(3)])
    one, two = (core_parameters(each).camera.in_mount(places) for each in (scenario, pinhole))
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-14)
    wrong = [0.01, 0.02, 0.03] if axes == "paper" else [0.01, -0.02, -0.03]
    np.testing.assert_allclose(pinhole.uncertainty.mount.rotation, wrong, rtol=0, atol=1e-15)


def test_axes_of_opencv(plain_camera: hs.Scenario) -> None:
    """With C as OpenCV has it, 180 degrees about x from E, the camera is the paper's; pixels count downwards."""
    changes = {"camera.axes": "opencv", "camera.mount.rotation": [np.pi, 0.0, 0.0]}
    flipped = (np.array(plain_camera.target.initial_features).reshape(4, 2) * [1, -1]).ravel()
    goal = (np.array(plain_camera.target.desired_features).reshape(4, 2) * [1, -1]).ravel()
    other = plain_camera.updated(
        {**changes, "target.initial_features": flipped.tolist(), "target.desired_features": goal.tolist()}
    )
    one, two = hs.simulate(plain_camera), hs.simulate(other)
    np.testing.assert_allclose(two.position, one.position, rtol=0, atol=1e-11)
    np.testing.assert_allclose(two.features, one.features, rtol=0, atol=1e-8)
    np.testing.assert_allclose(two.pixels.reshape(-1, 2) * [1, -1], one.features.reshape(-1, 2), rtol=0, atol=1e-8)
    random = np.random.default_rng(5202)
    points = random.uniform(-0.1, 0.1, (4, 3)) + np.array([0.0, 0.0, 0.7])
    turn = random.uniform(-0.2, 0.2, 3)
    scenario = in_pixels(plain_camera, "brown_conrady").updated(
        {"camera.axes": "opencv", "camera.mount.rotation": turn.tolist()}
    )
    camera = core_parameters(scenario).camera
    features, _ = _core.take_image(camera, np.zeros(3), [1.0, 0.0, 0.0, 0.0], points)
    expected = cv2.projectPoints(points[:, None], -turn, np.zeros(3), MATRIX, np.array(LENSES["brown_conrady"]))[0]
    np.testing.assert_allclose(camera.pixels(features.reshape(4, 2)), expected[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera.focal_pixels": -900}, "camera.focal_pixels: expected a number > 0, got -900"),
        ({"camera.focal_pixels": [900, 0]}, r"camera.focal_pixels\[1\]: expected a number > 0"),
        ({"camera.focal_length": 0.008}, "camera.focal_pixels: expected null beside focal_length, got both"),
        ({"camera.principal_point": [1300.0, 480.0]}, r"camera.principal_point\[0\]: expected a pixel of the image"),
        ({"camera.distortion.kannala_brandt": [0, 0, 0, 0]}, "camera.distortion: expected one of brown_conrady and"),
        ({"camera.distortion.brown_conrady": [0.1, 0.0]}, "camera.distortion.brown_conrady: expected 5 finite numbers"),
        ({"camera.distortion.brown_conrady": [-0.9, 0, 0, 0, 0]}, "camera.distortion: expected a lens that shows all"),
        (
            {"target.desired_features": [9e3, 0, 9e3, 9, 9, 9, 9, 0]},
            r"target.desired_features\[0\]: expected a pixel that",
        ),
        ({"uncertainty.focal_length": -1.0}, "uncertainty.focal_length: expected a number > -1 and < 1"),
        ({"camera.axes": "ros"}, 'camera.axes: expected one of "paper", "opencv"'),
    ],
)
def test_refused_with_the_key(plain_camera: hs.Scenario, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(hs.ScenarioError, match=message):
        in_pixels(plain_camera, "brown_conrady").updated(changes)


def test_wrong_intrinsics_need_pixels(paper: hs.Scenario) -> None:
    with pytest.raises(hs.ScenarioError, match=r"uncertainty.focal_length: .* no effect in continuous mode"):
        paper.updated({"uncertainty.focal_length": 0.01})


@pytest.mark.parametrize(
    "lens", [pytest.param(lens, marks=[pytest.mark.slow] if number else []) for number, lens in enumerate(LENSES)]
)
def test_analyses_are_those_of_the_pinhole(plain_camera: hs.Scenario, lens: str) -> None:
    """Even where the noise is of the pixels: the pose of the goal is that of the features."""
    scenario = in_pixels(plain_camera, lens)
    one, two = (hs.analyse(of, ["conditioning", "workspace"]) for of in (scenario, on_pinhole(scenario)))
    assert one.to_dict()["workspace"] == two.to_dict()["workspace"]
    for name in ("best", "nearest"):
        mine, other = (getattr(found.conditioning.goals, name).view.features for found in (one, two))
        np.testing.assert_allclose(mine, other, rtol=0, atol=1e-6)
    seen = hs.project(scenario, np.zeros(6))
    np.testing.assert_allclose(seen, np.asarray(scenario.target.initial_features), rtol=0, atol=1e-9)


# ---- Calibrations ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lens", LENSES)
def test_a_calibration_file_of_opencv_is_read_as_it_is(tmp_path: Path, lens: str) -> None:
    """Written by OpenCV itself."""
    path = tmp_path / "calibration.yaml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Thu 01 Jan 1970 00:00:00 UTC")
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    storage.write("fisheye_model", int(lens == "kannala_brandt"))
    storage.write("camera_matrix", MATRIX)
    if LENSES[lens] is not None:
        storage.write("distortion_coefficients", np.array(LENSES[lens])[:, None])
    storage.write("avg_reprojection_error", 0.31)
    storage.release()
    written = path.read_text()
    assert "!!opencv-matrix" in written
    path.write_text("%YAML:1.0" + written[written.index("\n") :])  # as OpenCV before version 5 begins a file

    from hexservo.scenario.calibration import camera_from_file

    assert camera_from_file(path) == camera_of(lens)


def test_a_calibration_of_ros_is_read(tmp_path: Path) -> None:
    from hexservo.scenario.calibration import camera_from_file

    path = tmp_path / "camera_info.yaml"
    path.write_text(
        "image_width: 1280\nimage_height: 960\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [905.5, 0, 650.25, 0, 903.0, 470.75, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [-0.28, 0.09, 8.0e-4, -5.0e-4, -0.012]}\n"
    )
    assert camera_from_file(path) == camera_of("brown_conrady")


@pytest.mark.parametrize(
    "coefficients",
    [
        "distortion_model: ''\nd: []\n",  # CameraInfo of ROS, of images without distortion
        "distortion_model: plumb_bob\nD: []\n",
        "distortion_coefficients: !!opencv-matrix\n   rows: 0\n   cols: 0\n   dt: d\n   data: []\n",
        "distortion_coefficients: {rows: 0, cols: 1, data: []}\n",
    ],
)
def test_a_calibration_without_coefficients_has_no_distortion(tmp_path: Path, coefficients: str) -> None:
    """As OpenCV takes an empty matrix of them."""
    found = read_calibration(tmp_path, f"{SQUARE}image_width: 1280\nimage_height: 960\n{coefficients}")
    assert found == hs.camera_from_opencv(MATRIX, None, SIZE) == hs.camera_from_opencv(MATRIX, np.array([]), SIZE)
    assert hs.camera_from_opencv(MATRIX, np.zeros((0, 1)), SIZE)["distortion"]["brown_conrady"] is None
    points = np.array([[[0.1, -0.05, 1.0]]])
    seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.array(MATRIX), np.zeros((0, 1)))[0]
    np.testing.assert_allclose(seen.ravel(), (np.array(MATRIX) @ points.ravel())[:2])
    with pytest.raises(hs.ScenarioError, match=r"got none; give \[0, 0, 0, 0\] for an equidistant lens"):
        read_calibration(tmp_path, f"{SQUARE}distortion_model: fisheye\nD: []\n")


SQUARE = "camera_matrix: [[905.5, 0, 650.25], [0, 903.0, 470.75], [0, 0, 1]]\n"


def read_calibration(tmp_path: Path, text: str) -> dict[str, Any]:
    from hexservo.scenario.calibration import camera_from_file

    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    return camera_from_file(path)


@pytest.mark.parametrize(
    ("model", "lens"),
    [
        ("plumb_bob", "brown_conrady"),
        ("RadTan", "brown_conrady"),
        ("Brown-Conrady", "brown_conrady"),
        ('""', "brown_conrady"),
        ("Equidistant", "kannala_brandt"),
        ("FISHEYE", "kannala_brandt"),
        ("KANNALA_BRANDT", "kannala_brandt"),
    ],
)
def test_the_model_of_a_lens_is_read_by_its_names(tmp_path: Path, model: str, lens: str) -> None:
    text = f"{SQUARE}image_width: 1280\nimage_height: 960\ndistortion_model: {model}\nD: {LENSES[lens]}\n"
    assert read_calibration(tmp_path, text) == camera_of(lens)


def test_a_rational_polynomial_is_read_where_its_denominator_is_one(tmp_path: Path) -> None:
    text = SQUARE + "distortion_model: rational_polynomial\nD: [0.1, 0.02, 0.003, 0.004, 0.05, {}, 0, 0]\n"
    lens = read_calibration(tmp_path, text.format(0))["distortion"]
    assert lens == {"brown_conrady": [0.1, 0.02, 0.003, 0.004, 0.05], "kannala_brandt": None}
    with pytest.raises(hs.ScenarioError, match="distortion: expected k1, k2, p1, p2 and k3"):
        read_calibration(tmp_path, text.format(0.1))


@pytest.mark.parametrize("key", ["dist_coeff", "dist_coeffs", "distCoeffs", "distortion", "dist", "D", "d"])
def test_coefficients_are_read_by_their_usual_names(tmp_path: Path, key: str) -> None:
    text = f"{SQUARE}image_Width: 1280\nimage_Height: 960\n{key}: [{LENSES['brown_conrady']}]\n"
    assert read_calibration(tmp_path, text) == camera_of("brown_conrady")


@pytest.mark.parametrize("names", ["K D", "k d"])
def test_a_message_of_ros_is_read(tmp_path: Path, names: str) -> None:
    matrix, lens = names.split()
    text = (
        f"height: 960\nwidth: 1280\ndistortion_model: plumb_bob\n{lens}: {LENSES['brown_conrady']}\n"
        f"{matrix}: {MATRIX.ravel().tolist()}\n"
    )
    assert read_calibration(tmp_path, text) == camera_of("brown_conrady")


@pytest.mark.parametrize(
    "key", ["camera_model: fisheye", "model: Equidistant", "fisheye_model: '1'", "lens_type: kannala-brandt"]
)
def test_the_model_of_a_lens_is_read_by_its_keys(tmp_path: Path, key: str) -> None:
    size = "image_width: 1280\nimage_height: 960\n"
    text = f"{SQUARE}{size}{key}\nprojection_model: pinhole\nD: {LENSES['kannala_brandt']}\n"
    assert read_calibration(tmp_path, text) == camera_of("kannala_brandt")


@pytest.mark.parametrize("end", ["---", "---\n", "---\n\n"])
def test_the_line_that_ends_a_printed_message_of_ros_does_not_count(tmp_path: Path, end: str) -> None:
    text = f"height: 960\nwidth: 1280\nk: {MATRIX.ravel().tolist()}\nd: {LENSES['brown_conrady']}\n"
    assert read_calibration(tmp_path, text + end) == camera_of("brown_conrady")
    with pytest.raises(hs.ScenarioError):
        read_calibration(tmp_path, f"{text}---\n{text}{end}")


def test_a_border_that_a_calibration_takes_away_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(SQUARE)
    assert load("eye-to-hand", [], str(path)).camera.image_size is None
    assert "image of [1280, 960] px in the scenario has no border now" in " ".join(capsys.readouterr().err.split())
    load("eye-to-hand", ["camera.image_size=[1300, 960]"], str(path))
    load("paper", [], str(path))
    assert capsys.readouterr().err == ""


def test_keys_that_are_not_of_the_image_do_not_count(tmp_path: Path) -> None:
    """Of a message of ROS with the whole image, and of OpenCV's tools."""
    text = (
        f"{SQUARE}width: 1280\nheight: 960\nD: {LENSES['brown_conrady']}\ndistortion_model: plumb_bob\n"
        "header: {frame_id: optical}\ncamera_name: left\nR: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
        "P: [500, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0]\nbinning_x: 0\nbinning_y: 1\n"
        "roi: {x_offset: 0, y_offset: 0, height: 960, width: 0, do_rectify: false}\n"
        "resolution: [1280, 960]\n"
        "lens: a lens\nsquare_size: 0.025\nper_view_reprojection_errors: [0.1, 0.2]\nextrinsic_parameters: [[0, 0]]\n"
        "dist_coeffs_std_dev: [0.1, 0.1, 0.1, 0.1, 0.1]\nstdDeviationsIntrinsics: [0.1, 0.2]\nfisheye_model: 0\n"
        "camera_model: Basler acA1920-40gm\nsensor_model: IMX219\nmodel: D435\nboard_model: charuco_5x7\n"
        "camera_type: usb\nlens_serial: 12345\nintrinsic_flags: 0\n"
    )
    assert read_calibration(tmp_path, text) == camera_of("brown_conrady")


def test_a_calibration_without_a_size_has_no_border(tmp_path: Path) -> None:
    """Whatever border the scenario has had."""
    scenario = hs.load_scenario("eye-to-hand")
    assert scenario.camera.image_size is not None
    for camera in (hs.camera_from_opencv(MATRIX), read_calibration(tmp_path, SQUARE)):
        assert scenario.updated({"camera": camera}).camera.image_size is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SQUARE + "distortion_model: omni\n", 'distortion_model: expected one of plumb_bob, .*, got "omni"'),
        (SQUARE + "distortion_model: kb4\n", "distortion_model: expected one of"),
        (SQUARE + "fisheye_model: 1\ndistortion_model: radtan\n", "expected fisheye beside fisheye_model: 1"),
        (SQUARE + "fisheye_model: 0\ncamera_model: fisheye\n", "camera_model: expected plumb_bob beside fisheye_model"),
        (SQUARE + "fisheye_model: 2\n", "fisheye_model: expected 0 or 1, got 2"),
        (SQUARE + "model: omni\n", 'model: expected one of plumb_bob, .*, got "omni"; drop the key if it is not'),
        (SQUARE + "coeffs: [0.1, 0, 0, 0]\n", "coeffs: expected no such key, .* name them distortion_coefficients"),
        (SQUARE + "k1: 0.3\nk2: 0.1\n", "k1: expected no such key, .* name them distortion_coefficients, in one list"),
        (SQUARE + "intrinsics: [605, 604, 322, 241]\n", "intrinsics: expected no such key"),
        (SQUARE + "mtx: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", "mtx: expected the camera matrix once, got camera_matri"),
        (SQUARE + "Camera_Matrix: 3\n", "Camera_Matrix: expected the camera matrix once, got camera_matrix too"),
        (SQUARE + "binning_x: 1\nbinning_y: 2\n", "binning_y: expected 0 or 1, an image that is not binned, got 2"),
        (SQUARE + "roi: [3, 4, 600, 400]\n", "roi.x_offset: expected 0, the whole image, got 3"),
        (SQUARE + "newcameramtx: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", "camera matrix of images that were rectified"),
        (SQUARE + "roi: {x_offset: 0, y_offset: 50}\n", "roi.y_offset: expected 0, the whole image, got 50"),
        (
            SQUARE + "width: 1280\nheight: 960\nroi: {height: 200, width: 1280}\n",
            "roi.height: expected 0 or 960, the whole image, got 200; give the calibration",
        ),
        (SQUARE + "distort: [0.1, 0, 0, 0]\n", "distort: expected no such key, .* name them distortion_coefficients"),
        (SQUARE + "D: [0, 0, 0, 0]\ndist: [0, 0, 0, 0]\n", "D: expected the coefficients once, got dist too"),
        (SQUARE + "image_size: [1280, 960]\n", "image_size: expected no such key, .* name it image_width and image_h"),
        (SQUARE + "resolution: 1280x960\n", "resolution: expected no such key, .* name it image_width and image_h"),
        (SQUARE + "img_shape: [960, 1280]\n", "img_shape: expected no such key, .* name it image_width and image_h"),
        (SQUARE + "imgWidth: 1280\nimgHeight: 960\n", "imgWidth: expected no such key"),
        (SQUARE + "image_width: 1280\n", "size: expected real numbers"),
        ("<opencv_storage>\n</opencv_storage>\n", r"got XML; .* ends in .yml or .json"),
    ],
)
def test_a_calibration_that_would_be_misread_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(hs.ScenarioError, match=message):
        read_calibration(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image_width: 3\n", "expected the key camera_matrix, got the keys image_width"),
        ("- 1\n", "expected a calibration with the key camera_matrix"),
        ("camera_matrix: {rows: 3, cols: 3, data: [1, 2]}\n", "camera_matrix.data: expected 3 x 3 numbers, got 2"),
        ("camera_matrix: [[1, 2, 3], [0, 1, 0], [0, 0, 1]]\n", r"K: expected \[\[fx, 0, cx\]"),
        ("camera_matrix: !!python/object/apply:os.system [ls]\n", "tag"),
        ("camera_matrix: [[0, 0, 3], [0, 1, 0], [0, 0, 1]]\n", "K: expected focal lengths > 0"),
    ],
)
def test_a_bad_calibration_is_refused(tmp_path: Path, text: str, message: str) -> None:
    from hexservo.scenario.calibration import camera_from_file

    path = tmp_path / "bad.yaml"
    path.write_text("%YAML:1.0\n---\n" + text)
    with pytest.raises(hs.ScenarioError, match=message):
        camera_from_file(path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.eye(2),), "K: expected 3 x 3 numbers"),
        ((MATRIX, [0.1, 0.2]), "distortion: expected k1, k2, p1, p2 and k3"),
        ((MATRIX, [0.1, 0.2, 0, 0, 0, 0.3, 0, 0]), "distortion: expected k1, k2, p1, p2 and k3"),
        ((MATRIX, None, (0, 4)), "size: expected"),
        ((np.array(MATRIX) + 0j,), "K: expected real numbers"),
        ((np.array(MATRIX).astype(str).tolist(),), "K: expected real numbers"),
        ((np.full((3, 3), np.nan),), "K: expected finite numbers"),
    ],
)
def test_a_bad_matrix_is_refused(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hs.camera_from_opencv(*arguments)


def test_the_command_takes_a_calibration(tmp_path: Path, plain_camera: hs.Scenario) -> None:
    from typer.testing import CliRunner

    from hexservo.cli.commands import app

    calibration = tmp_path / "calibration.yaml"
    storage = cv2.FileStorage(str(calibration), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", np.array(LENSES["brown_conrady"]))  # as an array with one axis
    storage.release()
    scenario = in_pixels(plain_camera, "brown_conrady").updated({"simulation.duration": 0.01})
    file = tmp_path / "scenario.yaml"
    text = scenario.updated({"camera.distortion.brown_conrady": None, "camera.principal_point": [600.0, 400.0]})
    file.write_text(text.to_yaml(), encoding="utf-8")
    out = tmp_path / "out"
    found = CliRunner().invoke(app, ["run", str(file), "--camera", str(calibration), "--out", str(out)])
    assert found.exit_code == 0, found.output
    assert hs.load_result(next(out.glob("*.nc"))).scenario.camera == scenario.camera
    alone = ("run", "show", "check", "certify", "analyse", "diagnose", "explore")
    for command in (*alone, "report -o a.html", "export --header a.hpp", "compare --scenarios", "identify a.csv -m"):
        missing = CliRunner().invoke(app, [*command.split(), str(file), "--camera", str(tmp_path / "none.yaml")])
        assert missing.exit_code == 2
        assert "none.yaml: cannot be read" in missing.stderr
    shown = CliRunner().invoke(app, ["show", str(file), "--camera", str(calibration)])
    header = tmp_path / "gains.hpp"
    exported = CliRunner().invoke(app, ["export", str(file), "--camera", str(calibration), "--header", str(header)])
    assert exported.exit_code == 0, exported.output
    (tmp_path / "shown.yaml").write_text(shown.stdout, encoding="utf-8")
    with_calibration = hs.load_scenario(tmp_path / "shown.yaml")
    assert with_calibration.camera == scenario.camera
    assert header.read_text(encoding="utf-8") == gains_header(with_calibration)
    checked = CliRunner().invoke(app, ["check", str(file), "--camera", str(calibration), "--set", "camera.dropout=1"])
    assert checked.exit_code == 0
    assert "no image arrives" in checked.stderr
    saved = CliRunner().invoke(app, ["diagnose", "saved.nc", "--camera", str(calibration)])
    assert "--camera: expected a scenario, got a saved result" in saved.stderr


def test_the_picture_of_the_frames_is_up_to_date() -> None:
    """Its command writes the file that the page shows."""
    assert PICTURE.read_text(encoding="utf-8") == picture(), "type: python docs/tools/camera_frames.py"


def test_the_words_of_the_picture_of_the_frames_are_within_it() -> None:
    """With the widths of DejaVu Sans, which are those of a wide font."""
    svg = ElementTree.fromstring(PICTURE.read_text(encoding="utf-8"))
    texts = svg.findall(".//{*}text")
    assert texts
    for text in texts:
        font = FontProperties(family="DejaVu Sans", weight=text.get("font-weight", "normal"))
        wide = TextPath((0, 0), text.text or "", size=float(text.get("font-size", "14")), prop=font).get_extents().x1
        left = float(text.get("x", "nan")) - (wide / 2 if text.get("text-anchor") == "middle" else 0.0)
        left -= wide if text.get("text-anchor") == "end" else 0.0
        assert left >= 0.0, text.text
        assert left + wide <= float(svg.get("width", "nan")), text.text


@pytest.mark.parametrize("lens", LENSES)
def test_the_linear_loop_is_that_of_the_pinhole(plain_camera: hs.Scenario, lens: str) -> None:
    """Its law takes features; the pixels of the lens are what the controller makes features of."""
    seen = in_pixels(plain_camera.updated({"controller.law": "kelly"}), lens)
    expected = delay_margin(on_pinhole(seen))
    assert math.isfinite(expected)
    assert delay_margin(seen) == pytest.approx(expected, abs=1e-12)
    control = pytest.importorskip("control", reason="python-control is not installed (extra `control`)")
    assert control is not None
    for of in ("loop", "plant"):
        found, same = (np.sort_complex(hs.bridges.control(one, of=of).poles()) for one in (seen, on_pinhole(seen)))
        np.testing.assert_allclose(found, same, rtol=0, atol=1e-9)
