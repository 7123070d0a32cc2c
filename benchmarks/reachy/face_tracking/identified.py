"""What the motors do, from a record of them: the log and the identification that an owner would make."""

from __future__ import annotations

from typing import Any

import numpy as np

import hexservo as hs
from face_tracking.machine import TICK, Head, kinematics
from face_tracking.scene import Array, turns

__all__ = ["prediction", "recorded", "response"]

_DURATION, _HOLD, _SEED = 24.0, 0.6, 7  # [s], [s]
_FARTHEST = np.deg2rad([20.0, 12.0])  # yaw, pitch


def recorded(head: Head) -> hs.Log:
    """Return a log of a head that jumps to a random yaw and pitch every 0.6 s, at 50 Hz and one tick late."""
    random = np.random.default_rng(_SEED)
    ticks, hold = round(_DURATION / TICK), round(_HOLD / TICK)
    aims = np.repeat(random.uniform(-1.0, 1.0, (-(-ticks // hold), 2)) * _FARTHEST, hold, axis=0)[:ticks]
    commands, joints = np.empty((ticks, 6)), np.empty((ticks, 6))
    pending: Array | None = None
    for tick, attitude in enumerate(turns(aims)):
        joints[tick] = head.reading
        quaternion = np.roll(attitude.as_quat(), 1) * [1.0, 1.0, -1.0, -1.0]
        commands[tick] = kinematics().leg_lengths(kinematics().home_position, quaternion)
        if pending is not None:
            head.command(pending)
        pending = commands[tick]
        for _ in range(head.steps):
            head.step()
    return hs.Log(TICK * np.arange(ticks, dtype=np.float64), TICK, commands, joints, None)


def response(head: Head) -> dict[str, Any]:
    """Return the keys of `actuators` that follow from a log of a head; the others are the scenario's own."""
    found = hs.identify(recorded(head), hs.load_scenario("reachy-mini")).changes
    return {key: value for key, value in found.items() if key.startswith("actuators.")}


def prediction(head: Head) -> tuple[hs.Scenario, float, float]:
    """Return what a log gives with motors, and by how much two models miss the part of the log that is kept apart.

    The errors are RMS [deg]: of a response for each leg, and of six motors with the head that they move.
    """
    machine = hs.load_scenario("reachy-mini").updated({"robot.force_limit": head.limit})
    found = hs.identify(recorded(head), machine, motors=True)
    if found.motors is None:
        raise RuntimeError("expected six legs that move, in a log of jumps")
    return found.scenario, float(np.rad2deg(found.motors.error_of_drives)), float(np.rad2deg(found.motors.error))
