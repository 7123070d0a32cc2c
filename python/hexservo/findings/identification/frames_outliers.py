"""Wrong detections of single points: which frames have one, how often they come, and how far they are off.

Frames that jitter, wrong poses of the joints and a wrong calibration move the points of a frame together. A wrong
detection moves one alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, chi2

from hexservo.findings.identification.frame_clock import share_of
from hexservo.findings.identification.interval import LEVEL, Interval
from hexservo.scenario.arrays import Array, Mask

_MEDIAN = 2.0 * np.log(2.0)  # of d^2 in the plane, in variances of a coordinate
_CHANCE = 1e-3  # that Gaussian noise alone gives an outlier, of all points of a log
_BY_CHANCE = 0.01  # that single outliers follow one another as often
_MOST = 0.5  # share of the frames: with more, these are no exceptions
_FEWEST = 3  # points of a frame, for one to be unlike the others


@dataclass(frozen=True)
class Outliers:
    """Points of a log that are wrong detections, as the model has them: each by itself, with a normal error."""

    frames: int  # that have one
    searched: int  # frames, of at least three points
    farther: float  # than this they are off, at least [px]
    probability: Interval  # of a point; not determined by one outlier alone
    size: Interval  # standard deviation of what is added to a coordinate [px]
    last: bool  # whether a point is one in frames one after the other more often than by chance

    @property
    def are_known(self) -> bool:
        """Whether they are those of the model, and the log determines how often they come."""
        return self.probability.is_bounded and not self.last


@dataclass(frozen=True)
class NoOutliers:
    """Points of a log of which none is a wrong detection, as far as noise lets one be seen."""

    points: int  # of all frames
    farther: float  # than this an outlier is seen [px]
    noise: float  # standard deviation of a coordinate [px]

    def exclude(self, probability: float, size: float) -> bool:
        """Return whether there would be one, with 95 % confidence.

        Parameters
        ----------
        probability
            Of a point.
        size
            Standard deviation of what is added to a coordinate [px].
        """
        both = size**2 + self.noise**2
        seen = probability * float(np.exp(-(self.farther**2) / (2.0 * both))) if both > 0.0 else 0.0
        return bool((1.0 - seen) ** self.points < 1.0 - LEVEL)


def outliers_of(left: Array, speed: Array, seen: Mask | None = None) -> tuple[Mask, Outliers] | NoOutliers | None:
    """Return which frames (m,) have or may have a wrong detection, by the residuals of images; None if most have.

    Those that may have are frames of fewer than three points, in a log with such detections: none is seen there.

    A point is an outlier if its distance d has d^2 > c = 2 S ln(points/0.001), as Gaussian noise has once in a thousand
    logs, after what its frame is late by, and the median of all images, are taken out. S is the variance of a
    coordinate: by the median of all d^2, or by the nearer half of the points of the frame, whichever is larger. Beyond
    c, d^2 of normal errors is c plus an exponential distribution of the same mean, which gives their size, and how many
    are nearer.

    Parameters
    ----------
    left
        (m, 2p) residuals of the image [px].
    speed
        (m, 2p) of the image, the mean over its jitter [px/s].
    seen
        (m, p) points that the frames have, the others of which are 0 in both; None: all.
    """
    count, points = len(left), left.shape[1] // 2
    seen = np.ones((count, points), dtype=bool) if seen is None else seen
    searched = seen.sum(axis=1) >= _FEWEST
    if not searched.any():
        return None
    found_of, of_searched = _found(left[searched], speed[searched], seen[searched])
    if not isinstance(of_searched, Outliers):
        return of_searched
    frames = np.ones(count, dtype=bool)
    frames[searched] = found_of
    return frames, of_searched


def _found(left: Array, speed: Array, seen: Mask) -> tuple[Mask, Outliers | NoOutliers | None]:
    """Return the same of frames that all have enough points."""
    count, points = seen.shape
    # Outliers displace the target that is fitted, and so all images alike.
    shared = [np.median(left[one, place]) if one.any() else 0.0 for place, one in enumerate(np.repeat(seen, 2, 1).T)]
    residuals = np.where(seen[:, :, None], (left - shared).reshape(count, points, 2), 0.0)
    speeds = speed.reshape(count, points, 2)
    first = _distances(residuals - _lateness(residuals, speeds, seen)[:, None, None] * speeds)
    squared, straight = _distances_by_others(residuals, speeds, _far(first, seen)[0])
    found, beyond = _far(squared, seen)
    number, total, frames = int(found.sum()), int(seen.sum()), np.asarray(found.any(axis=1))
    variance = float(np.median(squared[seen])) / _MEDIAN
    if not number:
        return frames, NoOutliers(total, float(np.sqrt(beyond[seen].mean())), float(np.sqrt(variance)))
    if frames.mean() > _MOST:
        return frames, None
    edge = float(beyond[found].mean())
    both = float((straight[found] - beyond[found]).mean()) / 2.0  # variance of the error and the noise together
    ends = [2 * number * both / end for end in chi2.ppf([0.5 + LEVEL / 2, 0.5 - LEVEL / 2], 2 * number)]
    size = Interval(*(float(np.sqrt(max(one - variance, 0.0))) for one in (both, *ends)))
    hidden = edge / (2.0 * both)
    nearby = min(float(np.exp(hidden)), total / number)
    share = share_of(number, total)
    # `both` has the relative deviation of the count, 1/sqrt(number), and so exp(hidden) `hidden` times that
    spread = np.hypot(1.0, hidden)
    ways = (share.value * (end / share.value) ** spread for end in (share.value, share.low, share.high))
    probability = Interval(*(min(nearby * float(one), 1.0) for one in ways)).determined()
    again = int((found[1:] & found[:-1]).sum())
    lasts = bool(again > 1 and binom.sf(again - 1, number, number / total) < _BY_CHANCE)
    return frames, Outliers(int(frames.sum()), count, float(np.sqrt(edge)), probability, size, lasts)


def _far(squared: Array, seen: Mask) -> tuple[Mask, Array]:
    """Return which points are outliers by their d^2, and the c that it is compared with, both (m, p)."""
    points = seen.sum(axis=1)
    nearer, total = points - points // 2, int(seen.sum())
    shares = np.array([_mean_of_nearer(int(one)) for one in range(seen.shape[1] + 1)])[points]
    of_frame = _sum_of_nearer(squared, seen) / (2.0 * nearer * shares)
    variance = np.maximum(of_frame, np.median(squared[seen]) / _MEDIAN)
    beyond = np.repeat(2.0 * np.log(total / _CHANCE) * variance[:, None], seen.shape[1], axis=1)
    return (squared > beyond) & seen, beyond


def _mean_of_nearer(points: int) -> float:
    """Return the mean of the smaller half of exponential numbers of mean 1, ordered."""
    ordered = np.cumsum(1.0 / np.arange(points, 0, -1.0))[: points - points // 2]
    return float(ordered.mean()) if points else 1.0


def _sum_of_nearer(squared: Array, seen: Mask) -> Array:
    """Return the sum of the smaller half of the numbers (..., p) of points that are seen (m, p), the middle one too."""
    points = seen.sum(axis=-1)
    ordered = np.sort(np.where(seen, squared, np.inf), axis=-1)
    nearer = np.arange(seen.shape[-1]) < (points - points // 2)[..., None]
    return np.asarray(np.where(nearer, ordered, 0.0).sum(axis=-1))


def _distances(residuals: Array) -> Array:
    """Return d^2 of residuals (m, p, 2)."""
    return np.asarray((residuals**2).sum(axis=2))


def _distances_by_others(residuals: Array, speeds: Array, suspects: Mask) -> tuple[Array, Array]:
    """Return d^2 (m, p) where frames are late by the least squares of the points that are no suspects (m, p).

    Of a suspect that time has an error of the variance S/sum |v|^2, which counts along its speed v. The second d^2 are
    without it.
    """
    size = _distances(speeds)
    power = np.where(suspects, 0.0, size).sum(axis=1)
    late = np.where(suspects, 0.0, (speeds * residuals).sum(axis=2)).sum(axis=1) / np.where(power > 0.0, power, 1.0)
    left = residuals - late[:, None, None] * speeds
    both = power[:, None] + size
    along = (left * speeds).sum(axis=2) ** 2 / np.where(both > 0.0, both, 1.0)
    straight = _distances(left)
    return straight - np.where(suspects, along, 0.0), straight


def _lateness(residuals: Array, speeds: Array, seen: Mask) -> Array:
    """Return the times (m,) [s] by which the nearer half of `residuals - time*speeds`, (m, p, 2), is least.

    Least trimmed squares, of the times at which one of the coordinates is met: the others may be wrong detections.
    """
    count = len(residuals)
    tried = np.divide(residuals, speeds, out=np.zeros_like(residuals), where=speeds != 0.0).reshape(count, -1)
    left = residuals[:, None] - tried[:, :, None, None] * speeds[:, None]
    squared = _sum_of_nearer((left**2).sum(axis=3), seen[:, None])
    return np.asarray(tried[np.arange(count), np.argmin(squared, axis=1)])
