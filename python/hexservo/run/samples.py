"""Selection and processing of samples for figures and charts, without a plotting library."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hexservo.run.metrics import metrics
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import desired_features, image_border
from hexservo.scenario.rotations import quaternion_of, quaternion_product, unit_rotation_vectors
from hexservo.scenario.wording import shown_unit

if TYPE_CHECKING:
    from hexservo.run.result import Result

_MAX_POINTS = 1200  # of one line in one panel: more than print resolves
_SMALL = 0.4  # of the image: paths within this part of it are shown magnified as well
OFF_AXIS = 1e-9  # of gravity: a part along an axis that is smaller is rounding
_MEAN_TIME = 0.007  # of the moving mean [s]: removes what switches, keeps what swings


def parts(result: Result) -> list[slice]:
    """Split the samples where the run has settled for as long again as it took; the parts share a sample.

    One part where the run does not settle, starts settled, or has too few samples.
    """
    settled, time = metrics(result)["settling_time"], result.time
    whole = [slice(0, len(time))]
    if not settled > 0:
        return whole
    split = min(2 * settled, (settled + time[-1]) / 2)
    rounded = float(f"{split:.1g}")
    cut = int(np.searchsorted(time, rounded if settled < rounded < time[-1] else split))
    return [slice(0, cut + 1), slice(cut, len(time))] if 2 <= cut <= len(time) - 3 else whole


def broken_parts(result: Result) -> list[slice]:
    """Return `parts`, or all samples together where a transient is long enough to be seen beside the rest."""
    shown = parts(result)
    if len(shown) == 2 and result.time[shown[0]][-1] > result.time[-1] / 2:
        return [slice(0, len(result.time))]
    return shown


def fuzzy_acted(result: Result) -> bool:
    """Return whether fuzzy systems acted in a run: those of the law that controlled it, switched on."""
    controller = result.scenario.controller
    return result.by_law and controller.traits.memory and bool(controller.gains.fuzzy.enabled)


def time_range(time: Array) -> tuple[float, float]:
    """Return the limits of a time axis for samples (n,); a single sample has a range too."""
    begin, end = float(time[0]), float(time[-1])
    return begin, end if end > begin else begin + 1e-3


def axis_range(*values: Array) -> tuple[float, float]:
    """Return limits with a margin around all values; rounding noise is not magnified."""
    low, high = min(float(part.min()) for part in values), max(float(part.max()) for part in values)
    middle, half = low / 2 + high / 2, max(0.56 * (high - low), 4e-3 * max(abs(low), abs(high)), 1e-4)
    return middle - half, middle + half


def turns_from_home(result: Result, quaternion: Array) -> Array:
    """Return the rotation vectors in B from home to attitudes (n, 4), w x y z, as (n, 3) [rad]; at most pi long."""
    home = np.asarray(result.scenario.robot.home_attitude)
    if home.any():
        quaternion = quaternion_product(quaternion, quaternion_of(-home))
    return rotation_vectors(quaternion)


def rotation_vectors(quaternion: Array) -> Array:
    """Return axis times angle of unit quaternions (n, 4), w x y z, as (n, 3) [rad]; the angle is at most pi.

    Accurate to rounding from 0 to pi: the angle comes from both parts of the quaternion.
    """
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return unit_rotation_vectors(unit)


def vertical(result: Result) -> str:
    """Return where z of B points, in brackets for titles: down, as in docs/model.md, or up.

    Empty where gravity is not along z: then z is not vertical.
    """
    gravity = np.array(result.scenario.robot.gravity)
    if not along_z(gravity):
        return ""
    return f" (z points {'down' if gravity[2] > 0 else 'up'})"


def along_z(gravity: Array) -> bool:
    """Return whether gravity, or a weight, (3,), is along z."""
    return bool(gravity[2] != 0 and (np.abs(gravity[:2]) <= OFF_AXIS * abs(gravity[2])).all())


def moment_unit(result: Result) -> tuple[str, float]:
    """Return the unit of an axis of the moments, mN m or from 1 N m on N m, and how many of it make one N m."""
    return shown_unit(max(float(np.abs(result.wrench[:, 3:]).max()), 1e-3), "N m")  # smaller ones are no axis in uN m


def extreme_samples(values: Array, most: int = _MAX_POINTS) -> NDArray[np.intp]:
    """Return the indices of samples to draw: all, or first, last and the extremes of as many bins as print resolves.

    Parameters
    ----------
    values
        Samples of one line, (n,).
    most
        Of the samples that are drawn, about.
    """
    count = len(values)
    if count <= most:
        return np.arange(count)
    size = -(-count // (most // 2))
    bins = -(-count // size)
    padded = np.pad(values, (0, bins * size - count), mode="edge").reshape(bins, size)
    starts = size * np.arange(bins)
    chosen = np.concatenate([starts + padded.argmin(axis=1), starts + padded.argmax(axis=1), [0, count - 1]])
    return np.unique(np.minimum(chosen, count - 1))


def path_samples(x: Array, y: Array) -> NDArray[np.intp]:
    """Return the indices of samples to draw of a path with coordinates (n,) each, as `extreme_samples` of both."""
    return np.union1d(extreme_samples(x), extreme_samples(y))


def initial_direction(path: Array, reach: float) -> Array | None:
    """Return the unit vector (2,) from the start of a path to its first sample that is at least `reach` away from it.

    None for a path that stays nearer to its start. What the path does later, such as a reversal, changes nothing.

    Parameters
    ----------
    path
        Samples, (n, 2).
    reach
        A distance above 0, in the unit of the path.
    """
    away = path - path[0]
    distance = np.hypot(*away.T)
    first = int((distance >= reach).argmax())
    return away[first] / distance[first] if distance[first] >= reach else None


def mean_samples(time: Array) -> int:
    """Return the odd number of samples of the moving mean, about 7 ms; 1 for short or coarse runs."""
    if len(time) < 3:
        return 1
    half = round(_MEAN_TIME / 2 / float(np.median(np.diff(time))))
    return 2 * half + 1 if 2 <= half <= len(time) / 100 else 1


def mean_period(time: Array, count: int) -> str:
    """Return how long `count` samples of a moving mean last, as text."""
    return f"{1e3 * count * float(np.median(np.diff(time))):.3g} ms"


def moving_mean(values: Array, count: int) -> Array:
    """Return the mean of the `count` (odd) samples about each of (n, k) samples; near the ends, of fewer."""
    if count == 1:
        return values
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    index = np.arange(len(values))
    first, last = np.maximum(index - count // 2, 0), np.minimum(index + count // 2 + 1, len(values))
    return np.asarray((sums[last] - sums[first]) / (last - first)[:, None])


def feature_names(points: int) -> tuple[str, ...]:
    """Return the names of the image coordinates of so many points, x₁, y₁, x₂, ..."""
    digits = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
    return tuple(axis + str(number).translate(digits) for number in range(1, points + 1) for axis in "xy")


@dataclass(frozen=True, eq=False)
class ImageView:
    """The part of the image plane that axes show."""

    middle: Array  # (2,) [px]
    half: Array  # (2,), half the width and half the height [px]
    border: Array | None  # (n, 2) [px], of the camera's image, a closed line; None: it has none

    @property
    def limits(self) -> list[list[float]]:
        """Limits of x and y [px]."""
        return np.column_stack([self.middle - self.half, self.middle + self.half]).tolist()  # type: ignore[no-any-return]


def image_views(result: Result) -> list[ImageView]:
    """Return the limits of image axes: the paths and goals; with ``camera.image_size`` the image, in its shape.

    Paths that leave the image widen that view in both directions alike. Where they take a small part of it, a second
    view of the same shape magnifies them.
    """
    goals = desired_features(result.scenario).reshape(-1, 2)
    places = np.concatenate([result.features.reshape(-1, 2), goals])
    low, high = places.min(axis=0), places.max(axis=0)
    middle, extent = (low + high) / 2, (high - low) / 2
    border = image_border(result.scenario)
    if border is None:
        return [ImageView(middle, np.full(2, max(1.14 * float(extent.max()), 1.0)), None)]
    centre, shape = (border.min(axis=0) + border.max(axis=0)) / 2, np.ptp(border, axis=0) / 2
    factor = max(1.0, float((np.abs(places - centre) / shape).max()))
    views = [ImageView(centre, 1.04 * factor * shape, border)]
    share = max(float((1.14 * extent / shape).max()), 1.0 / float(shape.min()))
    if share < _SMALL:
        views.append(ImageView(middle, share * shape, border))
    return views
