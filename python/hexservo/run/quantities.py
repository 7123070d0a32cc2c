"""What a run records: names, shapes and units of its arrays, its outcomes, and what no run has."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from hexservo.scenario.arrays import Array
from hexservo.scenario.wording import quoted

Outcome: TypeAlias = Literal[
    "completed",
    "diverged",
    "behind_camera",
    "feature_lost",
    "leg_limit",
    "singular",
    "solver_failed",
    "interrupted",
]
HISTORY = "weight_history"
"""The only array that a run may lack."""

_AXES = ["x", "y", "z"]
_LEGS = [1, 2, 3, 4, 5, 6]
_TWIST = ["vx", "vy", "vz", "wx", "wy", "wz"]
WRENCH = ["fx", "fy", "fz", "mx", "my", "mz"]

Quantity: TypeAlias = tuple[str, list[str] | list[int], str, str]
"""Second dimension, its labels, unit, what it is; the first dimension is time."""

_OF_PLATFORM: dict[str, Quantity] = {
    "position": ("axis", _AXES, "m", "platform position in the base frame B"),
    "quaternion": ("quaternion_component", ["w", "x", "y", "z"], "1", "platform attitude in the base frame B"),
    "twist": ("twist_component", _TWIST, "m/s; rad/s", "platform velocity and angular velocity in B"),
    "wrench": ("wrench_component", WRENCH, "N; N m", "force and moment about the platform's centre, in B"),
    "fuzzy_output": ("wrench_component", WRENCH, "N; N m", "output of the fuzzy systems, subtracted from the wrench"),
    "leg_lengths": ("leg", _LEGS, "m", "leg lengths"),
    "leg_forces": ("leg", _LEGS, "N", "leg forces, positive where they push the platform away from the base"),
}


@cache
def quantities(points: int) -> dict[str, Quantity]:
    """Return what a sample of a run with so many points holds, by name (not to be changed)."""
    numbers = range(1, points + 1)
    features = [f"{axis}{number}" for number in numbers for axis in "xy"]
    return {
        "feature_error": ("feature", features, "px", "desired minus true feature coordinates"),
        "depth": ("point", list(numbers), "m", "true Z of the points in the camera's frame C, negative in front"),
        **_OF_PLATFORM,
    }


def array_shapes(points: int, with_history: bool) -> dict[str, tuple[int, ...]]:
    """Return the arrays of a run with their shapes; -1 stands for the number of samples."""
    widths = {name: (-1, len(labels)) for name, (_, labels, _, _) in quantities(points).items()}
    history: dict[str, tuple[int, ...]] = {HISTORY: (-1, 6, 7, 7)} if with_history else {}
    return {"time": (-1,), **widths, "fuzzy_weights": (6, 7, 7), **history}


def problem_of_run(arrays: Mapping[str, Any], points: int, end_time: float, outcome: str) -> str | None:
    """Describe what no run has in its arrays, its end time [s] and its outcome, with so many points; None of a run."""
    shapes = array_shapes(points, HISTORY in arrays)
    for name in shapes:
        if not isinstance(arrays[name], np.ndarray) or arrays[name].dtype != np.float64:
            return f"{name}, which is not an array of float64"
    count = arrays["time"].size
    if count == 0:
        return "time, which has no sample"
    for name, shape in shapes.items():
        expected = (count, *shape[1:]) if shape[0] < 0 else shape
        if arrays[name].shape != expected:
            return f"{name}, of shape {arrays[name].shape} where {expected} is expected"
    if problem := _problem_of_values(arrays):
        return problem
    if end_time != arrays["time"][-1]:
        return "end_time, which is not the last time"
    return None if outcome in get_args(Outcome) else f"outcome {quoted(str(outcome))}, which is not known"


def _problem_of_values(arrays: Mapping[str, Array]) -> str | None:
    """Describe what no run has in its arrays: numbers that are not finite, decreasing times and the like."""
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            return f"{name}, which has numbers that are not finite"
    time = arrays["time"]
    if time[0] != 0 or not (np.diff(time) > 0).all():
        return "time, which does not increase from 0"
    if not np.allclose(np.linalg.norm(arrays["quaternion"], axis=1), 1.0, rtol=0, atol=1e-9):
        return "quaternion, which is not of length 1"
    if not (arrays["depth"] < 0).all():
        return "depth, which is not negative"
    return None
