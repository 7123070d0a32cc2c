"""Where the joints of a log are between its ticks: as the fitted drives move, and by a spline of what these leave.

After a command that jumps, a spline of the readings alone is off by most in the one or two ticks that follow it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from hexservo.findings.identification.drives import Drives
from hexservo.findings.identification.joints_repeated import fresh_readings
from hexservo.findings.identification.log import Log
from hexservo.scenario.arrays import Array


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Coordinates of the six legs at any time of a log."""

    time: Array  # (n,) of the readings that are used [s]
    left: Array  # (n, 6) of these, what the drives leave [m; rad]
    drives: CubicSpline | None  # [m; rad] by [s]; None: `left` is the readings
    spline: CubicSpline  # of `left`

    @classmethod
    def of(cls, log: Log, drives: Drives | None = None) -> JointMotion:
        """Return the motion in a log, of each leg with its drive if that predicts readings that are left out better."""
        fresh = fresh_readings(log.joints)
        time, joints = log.time[fresh], log.joints[fresh]
        if drives is None:
            return cls(time, joints, None, CubicSpline(time, joints))
        finer = len(drives.finely) // len(log.time)
        times = log.period / finer * np.arange(len(drives.finely))
        by_drives = drives.finely - drives.finely[0]
        left = joints - CubicSpline(times, by_drives)(time)  # at its own times: ticks need not be even
        better = _left_out(time, left) < _left_out(time, joints)
        fine = CubicSpline(times, np.where(better, by_drives, 0.0))
        left = np.where(better, left, joints)
        return cls(time, left, fine, CubicSpline(time, left))

    def __call__(self, times: Array) -> Array:
        """Return the coordinates at times (m,) [s], (m, 6) [m; rad]."""
        left: Array = self.spline(np.minimum(times, self.time[-1]))  # the last readings may be repeated
        return left if self.drives is None else left + self.drives(times)

    def halved(self) -> tuple[JointMotion, JointMotion]:
        """Return the same by every second reading: the even ones, and the odd ones."""
        even, odd = (
            JointMotion(self.time[first::2], self.left[first::2], self.drives, _through(self.time, self.left, first))
            for first in (0, 1)
        )
        return even, odd


def _through(time: Array, values: Array, first: int) -> CubicSpline:
    return CubicSpline(time[first::2], values[first::2])


def _left_out(time: Array, values: Array) -> Array:
    """Return the sum of squares of what every second value is off from the spline of the others, (6,)."""
    inside = slice(1, len(time) - 1, 2)
    return np.asarray(((_through(time, values, 0)(time[inside]) - values[inside]) ** 2).sum(axis=0))
