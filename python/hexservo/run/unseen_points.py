"""Points that a run's camera does not see: outside of its image, and a plane of points that it passes edge-on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hexservo import _core
from hexservo.run.metrics import metrics
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import core_parameters, frame_period
from hexservo.scenario.pixels import desired_features, image_border, points_outside
from hexservo.scenario.plane import side_of_plane, triangle_of_plane
from hexservo.scenario.wording import number, quantity

if TYPE_CHECKING:
    from hexservo.run.result import Result

_MOST = 4  # groups of points with equal times that a sentence has
_ROUNDING = 1e-9  # relative
_BEYOND = 1.0  # [px], by which a point between samples is farther out than in them
_ACTED_ON = {
    "hold": " Meanwhile the last image of a point stands for it (camera.on_lost: hold).",
    "predict": " Meanwhile the last image of a point, carried along, stands for it (camera.on_lost: predict).",
}  # "stop": nothing does


@dataclass(frozen=True)
class UnseenPoint:
    """A point of the target that is outside of the camera's image at samples of a run, by its true place."""

    point: int  # 1 to p
    first: float  # time of the first such sample [s]
    total: float  # how long in all, each sample until the next one [s]


def unseen_points(result: Result) -> tuple[UnseenPoint, ...]:
    """Return the points that are outside of the image at some samples, in the target's order.

    An image has a border in sampled mode alone. By true places: noise may take a point across the border and back, and
    what the gate rejects or a lost frame leaves out is in no sample.
    """
    if not result.scenario.sampled:
        return ()
    outside = points_outside(result.scenario, result.features)
    lasts = np.append(np.diff(result.time), 0.0)
    return tuple(
        UnseenPoint(point + 1, float(result.time[outside[:, point].argmax()]), float(lasts[outside[:, point]].sum()))
        for point in np.flatnonzero(outside.any(axis=0)).tolist()
    )


def unseen_sentence(result: Result) -> str | None:
    """Return `unseen_points` as a sentence, those first that are outside for longest; None where there are none."""
    alike: dict[tuple[float, float], list[int]] = {}
    for one in sorted(unseen_points(result), key=lambda one: -one.total):
        alike.setdefault((one.first, one.total), []).append(one.point)
    if not alike:
        return _between_samples(result)
    each = [
        f"point{'s' if len(points) > 1 else ''} {', '.join(map(str, points))} "
        f"(first at {quantity(first, 's')}, {quantity(total, 's')} in all)"
        for (first, total), points in list(alike.items())[:_MOST]
    ]
    if rest := sum(len(points) for points in list(alike.values())[_MOST:]):
        each.append(f"{rest} more, for less time")
    words = f"Outside of the image in the run of {quantity(result.end_time, 's')}: {'; '.join(each)}."
    return words + _ACTED_ON.get(result.scenario.camera.on_lost, "") + _thin(result)


def _thin(result: Result) -> str:
    """Return that the log has not every frame, as a separate sentence; "" where it has."""
    grid = result.scenario.simulation
    logged, period = grid.log_every * grid.step, frame_period(result.scenario)
    if logged <= period * (1.0 + _ROUNDING):
        return ""
    return (
        f" The log has a sample every {quantity(logged, 's')}, and the camera a frame every {quantity(period, 's')}: "
        "what is shorter may be missing."
    )


def _between_samples(result: Result) -> str | None:
    """Return that a point may have left the image between samples; None where metrics and log exclude it.

    A metric has the largest distance of every step: a point that is as near as the border's nearest part is inside.
    """
    scenario = result.scenario
    border = image_border(scenario) if scenario.sampled else None
    thin = _thin(result)
    if border is None or not thin:
        return None
    nearest = _distance_from_origin(border, np.roll(border, -1, axis=0))
    farthest = metrics(result)["peak_feature_distance"]
    logged = float(np.hypot(*result.features.reshape(-1, 2).T).max())
    if not farthest > max(nearest, logged + _BEYOND):
        return None
    return (
        f"A point may have been outside of the image between samples: it was up to {number(farthest)} px from the "
        f"principal point, in samples {number(logged)} px, and the image ends from {number(nearest)} px on.{thin}"
    )


def _distance_from_origin(starts: Array, ends: Array) -> float:
    """Return the distance of the nearest of segments, (n, 2) each, from the origin."""
    along = ends - starts
    shares = np.clip(-(starts * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return float(np.hypot(*(starts + shares[:, None] * along).T).min())


def edge_on_time(result: Result) -> float | None:
    """Return the time of the first sample by which the camera has passed through the plane of the points [s].

    None: it passes through none, or the points are not in one plane, have none (a camera as printed), or no image.
    """
    scenario = result.scenario
    if scenario.camera.convention != "eye_in_hand":
        return None
    camera = core_parameters(scenario).camera
    # in any frame: as a platform sees them at the origin
    points = _core.lift(camera, np.zeros(3), [1.0, 0.0, 0.0, 0.0], result.features[0], result.depth[0])
    triangle = triangle_of_plane(points) if np.isfinite(points).all() else None
    if triangle is None:
        return None
    sides = side_of_plane(result.features, triangle)
    passed = sides != side_of_plane(desired_features(scenario), triangle)
    changes = np.flatnonzero(passed[1:] != passed[:-1])
    return float(result.time[changes[0] + 1]) if len(changes) else None


def edge_on_sentence(result: Result) -> str | None:
    """Return `edge_on_time` as a sentence; None: the camera passes through no plane of points."""
    time = edge_on_time(result)
    if time is None:
        return None
    return (
        f"By t = {time:.4g} s the camera has passed through the plane of the target's points, which it sees edge-on "
        "there: from behind, no detector finds a tag or a printed grid."
    )
