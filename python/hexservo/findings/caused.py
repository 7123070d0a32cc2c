"""What wrenches do to the plant at rest: accelerations beyond the fall, by which its inertia is known."""

from __future__ import annotations

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array


def caused_by(probe: _core.Probe, position: Array, quaternion: Array, wrenches: Array) -> Array:
    """Return the accelerations under wrenches beyond those under none: the inverse inertia times them.

    Parameters
    ----------
    probe
        Of the plant.
    position, quaternion
        Poses at which it is at rest, (n, 3) [m] and (n, 4).
    wrenches
        One in each column, in B, (6, k) [N; N m].

    Returns
    -------
    Array
        (n, 6, k), a column for each wrench [m/s^2; rad/s^2].
    """
    at_rest = (position, quaternion, np.zeros((len(position), 6)))
    fall = probe.acceleration(*at_rest, np.zeros((len(position), 6)))
    columns = [probe.acceleration(*at_rest, np.tile(wrench, (len(position), 1))) - fall for wrench in wrenches.T]
    return np.stack(columns, axis=2)
