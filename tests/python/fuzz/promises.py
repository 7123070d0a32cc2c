"""What every run promises."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np

import hexservo as hs
from hexservo.run.quantities import Outcome
from widths import WIDTHS

__all__ = ["check"]


def check(result: hs.Result) -> None:
    """What every result promises, however the run ended."""
    assert result.outcome in get_args(Outcome)
    n = len(result.time)
    assert n >= 1
    assert result.time.shape == (n,)
    assert result.time[0] == 0.0
    assert np.all(np.diff(result.time) > 0)
    assert result.end_time == result.time[-1]
    points = result.scenario.target.count
    for name, width in (WIDTHS | {"feature_error": 2 * points, "depth": points}).items():
        array = getattr(result, name)
        assert array.shape == (n, width), name
        assert np.isfinite(array).all(), name
    assert result.fuzzy_weights.shape == (6, 7, 7)
    assert np.isfinite(result.fuzzy_weights).all()
    np.testing.assert_allclose(np.linalg.norm(result.quaternion, axis=1), 1.0, rtol=0, atol=4 * 2.0**-52)
    assert np.all(result.depth < 0)
    simulation = result.scenario.simulation
    if result.outcome == "completed":
        assert math.isclose(result.end_time, simulation.duration, rel_tol=1e-9)
    else:
        assert result.end_time < simulation.duration
    metrics = hs.metrics(result)
    may_be_nan = {"settling_time", "rms_error", *(("chatter",) if result.end_time == 0 else ())}  # a rate needs a time
    robot = result.scenario.robot
    may_be_nan |= {"peak_leg_speed"} if robot.speed_limit is None else set()
    may_be_nan |= {"peak_base_joint", "peak_platform_joint"} if robot.joint_limit is None else set()
    for name, value in metrics.items():
        assert math.isfinite(value) or (math.isnan(value) and name in may_be_nan), (name, value)
    assert metrics["final_error"] == np.abs(result.feature_error[-1]).max()
    for event in result.events:
        assert 0 <= event.time <= result.end_time
        assert event.peak > event.limit
