"""Targets of other numbers of points than four."""

from __future__ import annotations

from typing import Any

import numpy as np

import hexservo as hs

GOAL = [0.004, -0.003, 0.002, 0.02, -0.03, 0.05]  # [m; rad], from home


def scattered(count: int, seed: int = 17) -> np.ndarray[Any, Any]:
    """Points around the optical axis of home, 0.5 m before the camera and not in one plane, (count, 3) [m]."""
    angle = 2 * np.pi * np.arange(count) / count
    radius = np.where(np.arange(count) % 2, 0.05, 0.08)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, -0.65)])
    return points + np.random.default_rng(seed).uniform(-0.015, 0.015, points.shape)


def with_points(scenario: hs.Scenario, points: Any, **changes: Any) -> hs.Scenario:
    """Return a scenario with other points and the goal image that they show from one pose."""
    return scenario.updated(
        {
            "target.initial_features": None,
            "target.depth": None,
            "target.points": np.asarray(points).tolist(),
            "target.desired_features": None,
            "target.desired_pose": GOAL,
            **changes,
        }
    )


def five_points() -> hs.Scenario:
    """A short run whose single steps go through lanes, as those of every target but four points of equal weight."""
    changes = {"simulation.mode": "sampled", "simulation.duration": 0.2, "uncertainty.depth": 0.0}
    return with_points(hs.load_scenario("paper"), scattered(5), **changes, **{"simulation.log_every": 1})


def roundings(values: np.ndarray[Any, Any]) -> float:
    """Return one rounding of the largest value in each row: a loop that settles does not amplify those of before."""
    return len(values) * float(np.finfo(float).eps * np.abs(values).max())
