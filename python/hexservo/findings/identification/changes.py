"""Keys of a scenario that a log gives: those of the six legs as one, and times in whole ticks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.identification.drives import Drives
from hexservo.findings.identification.frames import CameraFit
from hexservo.findings.identification.log import Log
from hexservo.findings.part import Part

__all__ = ["Changes", "changes_of"]

_MAJORITY = 4  # legs in which a limit is seen, for the scenario to have it


@dataclass(frozen=True, eq=False, repr=False)
class Changes(Part):
    """Keys of the scenario by dotted name."""

    identified: Mapping[str, Any]
    given: Mapping[str, Any]  # what the scenario of the machine had


def changes_of(log: Log, drives: Drives, camera: CameraFit | None) -> dict[str, Any]:
    """Return the keys that the log gives, by dotted name."""
    step = float(f"{log.period:.9g}")
    changes: dict[str, Any] = {"simulation.mode": "sampled", "simulation.step": step}
    if drives.moved:
        delay = round(float(np.median([fit.delay.value for fit in drives.moved if fit.delay is not None])))
        changes |= {
            "actuators.kind": "position",
            "actuators.delay": _whole(delay * step, step),
            "actuators.position.bandwidth": _together(drives, "bandwidth"),
            "actuators.position.damping": _together(drives, "damping"),
            "actuators.position.speed_limit": _together(drives, "speed_limit"),
            "actuators.position.acceleration_limit": _together(drives, "acceleration_limit"),
        }
    if camera is not None and not camera.open:
        changes |= {"camera.noise": _digits(camera.noise.value if camera.noise else 0.0)}
        if camera.period is not None:
            changes |= {"camera.period": max(step, _whole(camera.period.value, step))}
        if camera.latency is not None and camera.latency_is_known:
            jitter = min(camera.jitter or 0.0, 2 * max(camera.latency.value, 0.0))  # of which no frame comes too early
            changes |= {"camera.latency": max(0.0, _whole(camera.latency.value - jitter / 2, step))}
            changes |= {"camera.latency_jitter": _whole(jitter, step)}
        changes |= {"camera.dropout": _digits(max(camera.dropout, 0.0))}
    return changes


def _together(drives: Drives, name: str) -> float | None:
    """Return one value for all legs: the mean of the logarithms, each counted by how well it is known."""
    found = [getattr(fit, name) for fit in drives.moved]
    known = [one for one in found if one is not None]
    if not known or (len(known) < len(found) and len(known) < _MAJORITY):
        return None
    values = np.log([one.value for one in known])
    sigma = np.maximum(np.log([one.high for one in known]) - values, 1e-9)
    return _digits(float(np.exp((values / sigma**2).sum() / (1.0 / sigma**2).sum())))


def _whole(value: float, step: float) -> float:
    """Return the nearest whole number of servo periods, as scenarios have all times of a camera."""
    return float(f"{round(value / step) * step:.9g}")


def _digits(value: float) -> float:
    return float(f"{value:.6g}")
