"""Pixels of a scenario's camera, and features of its pinhole (docs/camera.md)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.keys import value_at
from hexservo.scenario.parameters import Settings, core_parameters
from hexservo.scenario.rotations import quaternion_of, quaternion_product, unit_rotation_vectors

if TYPE_CHECKING:
    from hexservo.scenario.blocks import Blocks, Camera
    from hexservo.scenario.scenario import Scenario

_SLOPE_STEP = 0.01  # [px] of features
_BENT_SIDE = 24  # points of a side of the image's border that a lens may bend
IMAGE_CORNERS = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
"""Of an image about its centre, in halves of its size, (4, 2), in cyclic order."""
WRONG_CAMERA = ("uncertainty.focal_length", "uncertainty.principal_point")
"""Keys of what the controller has wrong about the camera."""


def has_pixels(camera: Camera) -> bool:
    """Return whether pixels of a camera may differ from features of its pinhole."""
    lens = camera.distortion
    return camera.axes != "paper" or any(
        value is not None
        for value in (camera.focal_pixels, camera.principal_point, lens.brown_conrady, lens.kannala_brandt)
    )


def feature_noise(camera: Camera) -> float:
    """Return the standard deviation of a camera's image coordinates, of noise and rounding together [px]."""
    return math.hypot(camera.noise, camera.quantisation / math.sqrt(12.0))


def has_camera_wrong(scenario: Blocks) -> bool:
    """Return whether the controller has a wrong focal length or principal point, which `on_pinhole` takes away."""
    return any(np.any(np.asarray(value_at(scenario, key)) != 0.0) for key in WRONG_CAMERA)


@lru_cache(maxsize=16)  # searches ask for the same one hundreds of times
def _camera(scenario: Blocks) -> _core.Camera:
    return core_parameters(scenario).camera


def to_features(scenario: Blocks, pixels: Any) -> Array:
    """Return the features of the pinhole [px] for pixels of the scenario's camera; NaN where the lens shows none.

    Parameters
    ----------
    scenario
        Whose true camera; the controller's may differ (`uncertainty`).
    pixels
        (..., 2n), u and v of each point [px], as ``camera.principal_point`` and ``camera.axes`` count them.
    """
    numbers = np.asarray(pixels, dtype=float)
    if not has_pixels(scenario.camera):
        return numbers
    found = _camera(scenario).features(numbers.reshape(-1, 2))
    return np.asarray(found).reshape(numbers.shape)


def to_pixels(scenario: Blocks, features: Any) -> Array:
    """Return the pixels of the scenario's camera for features of its pinhole, the inverse of `to_features`."""
    numbers = np.asarray(features, dtype=float)
    if not has_pixels(scenario.camera):
        return numbers
    found = _camera(scenario).pixels(numbers.reshape(-1, 2))
    return np.asarray(found).reshape(numbers.shape)


def assumed_pixels(scenario: Blocks, settings: Settings) -> Callable[[Array], Array]:
    """Return a function from features (2p,) of the pinhole that the controller assumes to pixels of its camera [px].

    The tick brings these pixels back to the features, within 1e-9 px. `settings` are those of the scenario.
    """
    if not has_pixels(scenario.camera) and not has_camera_wrong(scenario):
        return np.copy
    camera = settings.assumed_camera
    return lambda features: np.asarray(camera.pixels(features.reshape(-1, 2))).ravel()


def pixel_slopes(scenario: Blocks, features: Any) -> Array:
    """Return how the camera's pixels of a point change with its features, (..., n, 2, 2), row: of u, of v [px/px].

    Parameters
    ----------
    scenario
        Whose true camera.
    features
        (..., 2n) of its pinhole [px]. NaN where the lens shows no such point.
    """
    numbers = np.asarray(features, dtype=float)
    places = numbers.reshape(*numbers.shape[:-1], -1, 1, 2)
    steps = _SLOPE_STEP * np.eye(2)  # central differences
    after, before = (to_pixels(scenario, places + sign * steps) for sign in (1.0, -1.0))
    return np.asarray(np.swapaxes(after - before, -1, -2) / (2.0 * _SLOPE_STEP))


def desired_features(scenario: Blocks) -> Array:
    """Return the desired features of the pinhole, (2p,) [px]: what samples and metrics are measured against."""
    return to_features(scenario, scenario.target.desired_features)


def points_outside(scenario: Blocks, features: Any) -> Mask:
    """Return which points (..., n) are outside ``camera.image_size``, for features (..., 2n) of the pinhole [px]."""
    numbers = to_pixels(scenario, features)
    places = numbers.reshape(*numbers.shape[:-1], -1, 2)
    size = scenario.camera.image_size
    if size is None:
        return np.asarray(np.isnan(places).any(axis=-1))
    return np.asarray(~(np.abs(places - _image_centre(scenario.camera)) <= np.asarray(size) / 2.0).all(axis=-1))


def _image_centre(camera: Camera) -> Array:
    """Return the centre of an image that has a size, in pixels as ``camera.principal_point`` counts them, (2,)."""
    return np.zeros(2) if camera.principal_point is None else (np.asarray(camera.image_size) - 1.0) / 2.0


def image_border(scenario: Blocks) -> Array | None:
    """Return the border of the camera's image as features of its pinhole.

    Returns
    -------
    (n, 2) array or None
        [px], a closed line: the corners, n / 4 rows apart, and between them the points of what a lens bends. None
        without ``camera.image_size``.
    """
    camera = scenario.camera
    if camera.image_size is None:
        return None
    lens = camera.distortion
    count = 1 if lens.brown_conrady is None and lens.kannala_brandt is None else _BENT_SIDE
    shares = np.arange(count)[:, None] / count
    sides = [a + shares * (b - a) for a, b in zip(IMAGE_CORNERS, np.roll(IMAGE_CORNERS, -1, axis=0), strict=True)]
    pixels = _image_centre(camera) + np.concatenate(sides) * np.asarray(camera.image_size) / 2.0
    return to_features(scenario, pixels)


def on_pinhole(scenario: Scenario) -> Scenario:
    """Return the scenario whose pixels are the features of its pinhole, with the axes of the paper.

    Points, poses and laws stay; lens, principal point and what the controller has wrong about them do not act. Noise,
    rounding and border keep their numbers of pixels.
    """
    if not has_pixels(scenario.camera) and not has_camera_wrong(scenario):
        return scenario
    changes: dict[str, Any] = dict(zip(WRONG_CAMERA, (0.0, [0.0, 0.0]), strict=True))
    if has_pixels(scenario.camera):
        changes |= {
            "camera.focal_length": None,
            "camera.pixel_scale": None,
            "camera.focal_pixels": core_parameters(scenario).camera.focal_pixels,
            "camera.principal_point": None,
            "camera.axes": "paper",
            "camera.distortion.brown_conrady": None,
            "camera.distortion.kannala_brandt": None,
            "target.desired_features": desired_features(scenario).tolist(),
        }
        if scenario.camera.axes == "opencv":  # rotated about x by pi from those of the paper
            mount = quaternion_of(np.asarray(scenario.camera.mount.rotation))
            turned = quaternion_product(mount, np.array([0.0, 1.0, 0.0, 0.0]))
            changes["camera.mount.rotation"] = unit_rotation_vectors(turned).tolist()
            error = np.asarray(scenario.uncertainty.mount.rotation)
            changes["uncertainty.mount.rotation"] = (error * [1.0, -1.0, -1.0]).tolist()
        if scenario.target.initial_features is not None:
            changes["target.initial_features"] = to_features(scenario, scenario.target.initial_features).tolist()
    return scenario.updated(changes)
