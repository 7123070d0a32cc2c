"""Whether the machine of a log reached its goal: the error of the last images, without the camera's noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.interval import NORMAL
from hexservo.findings.identification.log import Log
from hexservo.scenario.arrays import Array
from hexservo.scenario.pixels import to_features
from hexservo.scenario.wording import quantity

_REST = 0.25  # share of the log, at its end, over which the image of a machine at rest stays: jumps are shorter
_STAYS = 0.5  # of the settling band: largest spread of a coordinate that stays
_FEWEST = 3  # frames that show that an image stays
_ALLOWED = 3.0  # standard errors that noise may make of a median or a spread
# Standard errors of white Gaussian noise of deviation 1, times the root of the number of values
_OF_MEDIAN = 1.2533
_OF_SPREAD = 1.1664
_TAIL = 1 / 3  # share of the dwell time, at its end, whose median counts too: outliers come one by one, a machine goes
_FEWEST_OF_TAIL = 5  # frames
_LATE = 5  # frame periods, after the dwell time, by which the last complete image may be before the end of the log


@dataclass(frozen=True)
class LogEnd:
    """How far from the goal a log ends, and what the scenario's metrics allow."""

    error: float  # largest of a coordinate's median over the dwell time before the last frame, or its end [px]
    noise_error: float  # what noise may make of `error` [px]
    swings: bool  # whether a coordinate spreads by more than the band in that time, its noise apart
    band: float  # within which it is settled [px]
    dwell: float  # [s]
    rests: bool  # whether the image stays where it is over the last quarter of the log

    @property
    def settled(self) -> bool:
        """Whether the last images are within the band, but for noise."""
        return self.error <= self.band + self.noise_error and not self.swings


def end_of(log: Log, scene: Scene, noise: float = 0.0) -> LogEnd | str:
    """Return how far from the scenario's goal the images of a log end, or why it does not tell.

    Medians, and spreads by the median distance from them, leave out outliers of less than half of the frames.

    Parameters
    ----------
    log
        Of a machine.
    scene
        Of its scenario.
    noise
        Standard deviation of a coordinate, of an image at rest [px].
    """
    metrics, frames = scene.scenario.metrics, log.frames
    if frames is None or frames.features.shape[1] != len(scene.desired):
        return "The log has no image of the goal's points"
    features = to_features(scene.scenario, frames.features)
    shown = np.isfinite(features).all(axis=1)  # a lens shows no point at some pixels
    if not shown.any():
        return "The log has no image of the goal's points"
    features, arrival = features[shown], frames.arrival[shown]
    before_end = float(log.time[-1] - arrival[-1])
    between = float(np.median(np.diff(arrival))) if len(arrival) > 1 else 0.0
    if before_end > metrics.dwell + _LATE * between:
        return f"The log's last image of all of the goal's points is {quantity(before_end, 's')} before its end"
    last = features[arrival >= arrival[-1] - metrics.dwell]
    tail = features[-max(_FEWEST_OF_TAIL, math.ceil(_TAIL * len(last))) :]
    farther = max((last, tail), key=lambda images: _error(images, scene.desired) - _noise_error(noise, len(images)))
    late = features[arrival >= arrival[-1] - max(metrics.dwell, _REST * float(np.ptp(log.time)))]
    swings = not _stays_within(last, metrics.band, noise)
    stays = _error(tail, np.median(late, axis=0)) <= _STAYS * metrics.band + _noise_error(noise, len(tail))
    return LogEnd(
        _error(farther, scene.desired),
        _noise_error(noise, len(farther)),
        swings,
        metrics.band,
        metrics.dwell,
        bool(len(late) >= _FEWEST and stays and not swings and _stays_within(late, _STAYS * metrics.band, noise)),
    )


def _error(images: Array, place: Array) -> float:
    """Return the largest of a coordinate's distance from a place, (2p,), in the median of images, (m, 2p) [px]."""
    return float(np.abs(np.median(images, axis=0) - place).max())


def _noise_error(noise: float, count: int) -> float:
    """Return what noise may make of the median of so many images [px]."""
    return _ALLOWED * _OF_MEDIAN * noise / math.sqrt(count)


def _stays_within(features: Array, most: float, noise: float) -> bool:
    """Return whether each coordinate, (m, 2p) [px], spreads by no more than `most` beside noise."""
    spread = NORMAL * np.median(np.abs(features - np.median(features, axis=0)), axis=0)
    of_noise = noise * (1.0 + _ALLOWED * _OF_SPREAD / np.sqrt(len(features)))
    return bool((spread <= np.hypot(most, of_noise)).all())
