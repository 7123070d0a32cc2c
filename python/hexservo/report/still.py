"""The machine in space as a still picture: lines and text, without WebGL and scripts."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hexservo.report.html import Html, element
from hexservo.report.scene import SpaceView
from hexservo.scenario.arrays import Array, Mask

VIEW = (1.42, -1.75, 1.15)
"""Direction of the view in the upright frame, (x, -y, -z) of B where z points down; the page begins with it too."""

_HEIGHT = 560.0  # of the picture
_MARGIN = 26.0
_POINTS = ("blue", "vermilion", "green", "black", "purple", "orange")  # repeated for more points


def still(scene: SpaceView) -> Html:
    """Draw the end of the run, with the paths of the features on the image plane up to there."""
    last = len(scene.time) - 1
    joints, camera = scene.joints[last], scene.placed(last, np.zeros(3))
    corners, border = scene.placed(last, scene.corners), scene.placed(last, scene.border)
    low, high = scene.box()
    bounds = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    flat = _seen(bounds, scene.z_down)
    scale = (_HEIGHT - 2 * _MARGIN) / float(np.ptp(flat[:, 1]))
    offset = np.array([_MARGIN, _MARGIN]) - flat.min(axis=0) * scale
    width = float(np.ptp(flat[:, 0])) * scale + 2 * _MARGIN + 70

    def at(points: Array) -> Array:
        return np.asarray(_seen(points, scene.z_down) * scale + offset)

    shapes = [_polygon(at(scene.base), "base")]
    rod = "leg" if scene.feet is None else "leg rod"
    for leg in range(6):
        beyond = " beyond" if scene.used[last, leg] > 1.0 else ""
        foot = scene.base[leg] if scene.feet is None else scene.feet[last, leg]
        if scene.feet is not None:
            shapes.append(_line(at(np.stack([scene.base[leg], foot])), f"leg crank{beyond}"))
        shapes.append(_line(at(np.stack([foot, joints[leg]])), f"{rod}{beyond}"))
    shapes += [_line(at(np.stack([camera, corner])), "frustum") for corner in corners]
    shapes += [_polygon(at(joints), "platform"), _polygon(at(border), "image")]
    image = np.array([scene.placed(last, frame) for frame in scene.image])  # (k, p, 3)
    goals, targets = scene.placed(last, scene.goals), scene.target(last)
    for number in range(len(goals)):
        colour = _POINTS[number % len(_POINTS)]
        shown = np.isfinite(image[:, number]).all(axis=1)
        # parts between instants at which the feature is not shown
        paths = [image[part, number] for part in _runs(shown)]
        if targets is not None and paths and np.isfinite(targets[number]).all():
            shapes.append(_line(at(np.stack([camera, targets[number]])), f"ray {colour}"))
            shapes.append(_dot(at(targets[number])[None][0], 4, f"dot {colour}"))
        shapes += [_line(at(path), f"path {colour}") for path in paths]
        if shown[last]:
            shapes.append(_dot(at(image[last, number]), 3, f"dot {colour}"))
        shapes.append(_square(at(goals[number]), 5, f"goal {colour}"))
    names: list[tuple[str, Array]] = [("base", scene.base[int(at(scene.base)[:, 0].argmax())])]
    names.append(("platform", joints[int(at(joints)[:, 0].argmax())]))
    names.append(("image", corners[int(at(corners)[:, 0].argmax())]))
    if targets is not None:
        names.append(("targets", targets[int(np.nanargmax(at(targets)[:, 0]))]))
    shapes += [_text(at(place), name) for name, place in names]
    return element(
        "svg",
        *shapes,
        class_="still",
        viewBox=f"0 0 {width:.0f} {_HEIGHT:.0f}",
        role="img",
        aria_label=f"The machine at t = {scene.time[last]:.4g} s: base, six legs, platform, image and targets",
    )


def _runs(shown: Mask) -> list[NDArray[np.intp]]:
    """Return the indices of each run of consecutive true values."""
    at = np.flatnonzero(shown)
    return [part for part in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(part)]


def _seen(points: Array, z_down: bool) -> Array:
    """Project points of B, (..., 3), without perspective: to the right, and down."""
    upright = points * np.array([1.0, -1.0, -1.0]) if z_down else points
    toward = np.array(VIEW) / np.linalg.norm(VIEW)
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    return np.stack([upright @ right, -(upright @ np.cross(toward, right))], axis=-1)


def _polygon(points: Array, kind: str) -> Html:
    return element("polygon", points=_pairs(points), class_=kind)


def _line(points: Array, kind: str) -> Html:
    return element("polyline", points=_pairs(points), class_=kind)


def _dot(place: Array, radius: float, kind: str) -> Html:
    return element("circle", cx=f"{place[0]:.1f}", cy=f"{place[1]:.1f}", r=f"{radius:g}", class_=kind)


def _square(place: Array, half: float, kind: str) -> Html:
    x, y, side = f"{place[0] - half:.1f}", f"{place[1] - half:.1f}", f"{2 * half:g}"
    return element("rect", x=x, y=y, width=side, height=side, class_=kind)


def _text(place: Array, text: str) -> Html:
    return element("text", text, x=f"{place[0] + 9:.1f}", y=f"{place[1] + 4:.1f}")


def _pairs(points: Iterable[Array]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
