"""Whether the machine of a log reached its goal: the error of the last images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.log import Log
from hexservo.scenario.pixels import to_features

_REST = (
    0.25  # share of the log over whose end the image of a machine at rest stays: jumps for identification are shorter
)
_STAYS = 0.5  # of the settling band: largest standard deviation of a coordinate that stays
_FEWEST = 3  # frames that show that an image stays


@dataclass(frozen=True)
class LogEnd:
    """How far from the goal a log ends, and what the scenario's metrics allow."""

    error: float  # largest of a coordinate in the dwell time before the last frame [px]
    band: float  # within which it is settled [px]
    dwell: float  # [s]
    rests: bool  # whether the image stays where it is over the last quarter of the log

    @property
    def settled(self) -> bool:
        """Whether the last images are within the band."""
        return self.error <= self.band


def end_of(log: Log, scene: Scene) -> LogEnd | None:
    """Return how far from the scenario's goal the images of a log end; None where it has none of the goal's points."""
    metrics, frames = scene.scenario.metrics, log.frames
    if frames is None or frames.features.shape[1] != len(scene.desired):
        return None
    features = to_features(scene.scenario, frames.features)
    shown = np.isfinite(features).all(axis=1)  # a lens shows no point at some pixels
    if not shown.any():
        return None
    features, arrival = features[shown], frames.arrival[shown]
    last = features[arrival >= arrival[-1] - metrics.dwell]
    error = float(np.abs(last - scene.desired).max())
    late = features[arrival >= arrival[-1] - max(metrics.dwell, _REST * float(np.ptp(log.time)))]
    rests = len(late) >= _FEWEST and float(late.std(axis=0).max()) <= _STAYS * metrics.band
    return LogEnd(error, metrics.band, metrics.dwell, rests)
