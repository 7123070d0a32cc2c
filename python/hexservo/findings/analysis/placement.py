"""Placements of the features with better pose observability (docs/analysis/conditioning.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import has_pixels, points_outside
from hexservo.scenario.scenario import Scenario

VIEW = 240.0 / 581.816  # tangent of half the angle of view without a size: 480 px with the paper's focal length
BORDER = 0.95  # share of half the picture that is used, where the scenario names its size
DEPTH_SHARE = 0.1  # of the depth: how far a point may be off the plane, either way
_SHARPNESS = 16  # exponent of the smooth maximum that the search minimises
_NUDGE = 1e-7  # of the search's variables, for its slope
_SQUARE = np.pi * np.array([1, 3, -1, -3]) / 4  # angles of its corners


@dataclass(frozen=True, eq=False)
class Placement:
    """Features from home, and the pose observability from one image of them."""

    name: str
    features: Array  # (2p,) of p points [px]
    depth: Array  # (p,) [m], negative
    # (6,) [m; rad] per px: standard deviations of the pose from one image whose coordinates have a noise of 1 px
    pose_sigma: Array
    worst: float  # [m/px], of the least observable direction, rotations scaled by the target's mean depth


def image_radius(scene: Scene) -> float:
    """Return the radius about the principal point within which features may be placed [px].

    95 % of half the smaller side of ``camera.image_size``, or where pixels are not features of the largest circle
    of features that is in the image; without an image size 22 degrees off the axis (240 px for the paper's camera), or
    as far out as the scenario's own features are.
    """
    size = scene.scenario.camera.image_size
    if size is not None and has_pixels(scene.scenario.camera):
        return BORDER * _widest(scene.scenario, math.hypot(*size))
    if size is not None:
        return BORDER * 0.5 * float(min(size))
    return max(VIEW * scene.camera.focal_pixels, farthest(scene.view(scene.home).features))


def _widest(scenario: Scenario, most: float) -> float:
    """Return the radius of the largest circle of features about the principal point that is in the image [px]."""
    least, angles = 0.0, np.linspace(0.0, 2.0 * np.pi, 65)[:-1]
    while most - least > 1e-3:
        middle = 0.5 * (least + most)
        if points_outside(scenario, in_circle(middle, angles)).any():
            most = middle
        else:
            least = middle
    return least


def farthest(features: Array) -> float:
    """Return the largest distance of features (2p,) from the principal point [px]."""
    return float(np.hypot(*features.reshape(-1, 2).T).max())


def in_circle(radius: Array | float, angles: Array) -> Array:
    """Return features (2p,) [px] at these distances from the principal point [px] and angles (p,) [rad]."""
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles)]).ravel()


def place(scene: Scene, name: str, features: Array, depth: Array, length: float) -> Placement:
    """Return the pose observability from features at home: least squares on the core's image Jacobian there.

    Parameters
    ----------
    scene
        Whose camera and home pose.
    name
        As text.
    features
        (2p,) [px].
    depth
        (p,) [m], negative.
    length
        Of what turns are multiplied by in `Placement.worst` [m].
    """
    values, _, sigma = observability(_scaled(scene, features, depth, length), length)
    with np.errstate(divide="ignore"):
        return Placement(name, features, depth, sigma, float(1.0 / values[-1]))


def observability(scaled: Array, length: float) -> tuple[Array, Array, Array]:
    """Decompose a Jacobian (2p, 6) whose rotations are scaled by a length [m].

    Returns
    -------
        Its singular values (6,), their directions (6, 6), one a row, and the standard deviations (6,) [m; rad] of the
        pose by least squares, per unit of noise in each row.
    """
    _, values, directions = np.linalg.svd(scaled, full_matrices=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(((directions / values[:, None]) ** 2).sum(axis=0)) / np.repeat([1.0, length], 3)
    return values, directions, sigma


def placements(scene: Scene) -> tuple[Placement, ...]:
    """Compare the scenario's features with standard ones and with the best that a search finds, the last one.

    All are judged at home, with the mean depth of the scenario's points. The search is local, from several starts
    (SLSQP over distance from the principal point, angle and depth of each point), minimises `Placement.worst` within
    `image_radius` and `DEPTH_SHARE`, and proves no optimum.
    """
    own = scene.view(scene.home)
    length = own.mean_depth
    radius = image_radius(scene)
    size = farthest(own.features)
    count = len(own.depth)
    plane, angles, shape = np.full(count, -length), corner_angles(count), shape_name(count)
    near = plane * _but(0, count, 1 - DEPTH_SHARE)
    off = f"{DEPTH_SHARE:.0%} of the depth"

    def judged(name: str, features: Array, depth: Array) -> Placement:
        return place(scene, name, features, depth, length)

    raised = [
        judged(f"original, point {point + 1} {off} {word}", own.features, own.depth * _but(point, count, 1 + sign))
        for point in range(count)
        for sign, word in ((-DEPTH_SHARE, "nearer"), (DEPTH_SHARE, "farther"))
    ]
    tested = [
        judged("as they are", own.features, own.depth),
        min(raised, key=lambda found: found.worst),
        judged(f"{shape} of the same size ({size:.0f} px), in a plane", in_circle(size, angles), plane),
        judged(f"{shape} in the circle of {radius:.0f} px, in a plane", in_circle(radius, angles), plane),
        judged(f"the same, one point {off} nearer", in_circle(radius, angles), near),
    ]
    best = _search(scene, radius, length, tested)
    return (*tested, judged(f"best found in the circle, within {off} of the plane", *best))


def corner_angles(count: int) -> Array:
    """Return the angles (count,) [rad] of the corners of a regular polygon."""
    return _SQUARE if count == len(_SQUARE) else 2 * np.pi * np.arange(count) / count


def shape_name(count: int) -> str:
    """Return what that polygon is called, with its article."""
    return {3: "a triangle", 4: "a square"}.get(count, f"a regular polygon of {count} points")


def _but(point: int, count: int, factor: float) -> Array:
    factors = np.ones(count)
    factors[point] = factor
    return factors


def _scaled(scene: Scene, features: Array, depth: Array, length: float) -> Array:
    """Return `Scene.of_noise` at home with rotations scaled by a length, (k, 6) [px/m]."""
    jacobian = scene.of_noise(features, scene.jacobian(features, depth, scene.home))
    return np.asarray(jacobian / np.repeat([1.0, length], 3))


def _search(scene: Scene, radius: float, length: float, tested: list[Placement]) -> tuple[Array, Array]:
    """Minimise the worst direction; the result is never worse than the placements tested within the bounds."""
    from scipy.optimize import minimize

    count = len(tested[0].depth)
    scale = np.repeat([radius, 1.0, length], count)

    def features_and_depth(x: Array) -> tuple[Array, Array]:
        out, angles, depth = (x * scale).reshape(3, count)
        return in_circle(out, angles), -depth

    def costs(points: Array) -> Array:  # (k,) of (k, 3p): log of a smooth maximum of what 1 px is in each direction
        stack = np.stack([_scaled(scene, *features_and_depth(x), length) for x in points])
        values = np.linalg.svd(stack, compute_uv=False)
        values = np.maximum(values, 1e-12 * values[:, :1])
        least = values[:, -1]
        smooth = np.log(((least[:, None] / values) ** _SHARPNESS).sum(axis=1)) / _SHARPNESS
        return np.asarray(smooth - np.log(least))

    def cost_and_slope(x: Array) -> tuple[float, Array]:  # forward differences, all in one stack
        found = costs(x + np.vstack([np.zeros(3 * count), _NUDGE * np.eye(3 * count)]))
        return float(found[0]), (found[1:] - found[0]) / _NUDGE

    low, high = 1 - DEPTH_SHARE, 1 + DEPTH_SHARE
    bounds = [(0.0, 1.0)] * count + [(None, None)] * count + [(low, high)] * count
    around = 2 * np.pi / (count - 1) * np.arange(count - 1)
    starts = (  # corners off the plane in turn; a polygon around a nearer point, a little uneven
        np.concatenate([np.ones(count), corner_angles(count), np.resize([low, high], count)]),
        np.concatenate([[*np.ones(count - 1), 0.1], [0.1, *around[1:], 0.2], [*np.full(count - 1, high), low]]),
    )
    found = [
        minimize(
            cost_and_slope, start, jac=True, method="SLSQP", bounds=bounds, options={"maxiter": 60, "ftol": 1e-9}
        ).x
        for start in starts
    ]
    candidates = [features_and_depth(x) for x in found] + [(x.features, x.depth) for x in tested[-2:]]
    return min(candidates, key=lambda candidate: place(scene, "", candidate[0], candidate[1], length).worst)
