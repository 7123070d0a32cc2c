"""Where a leg rests: how far from its command, and on which side, as friction leaves it.

A response without friction comes to rest on its command. With Coulomb friction, where q'' = w^2 (q* - q) - 2 zeta w q'
- f sign(q'), a leg stays where |q* - q| <= f/w^2. One that does not overshoot (zeta >= 1) stops at that edge, on the
side that it comes from; one that overshoots stops somewhere within.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import t

from hexservo.findings.identification.interval import LEVEL, Interval
from hexservo.scenario.arrays import Array

_TICKS = 12  # fewest between two commands
_STILL = 2e-3  # of the way: most that a leg may move in the last quarter of that time
_MOVED = 0.05  # of a jump: least motion into a rest
_CLEAR = 5.0  # likewise, in standard deviations of what is measured at rest
_FEWEST = 4  # rests after motion in each direction


@dataclass(frozen=True)
class Rests:
    """Rests of one leg after jumps of its command."""

    count: int
    short: Interval  # of the command, on the side that the leg came from; negative: beyond it [m], or [rad]
    same: float  # of the command in both directions, by weight or the zero of the encoder [m], or [rad]
    farthest: float  # largest distance from the command, but for what is the same in both directions [m], or [rad]


def find_rests(commands: Array, joints: Array) -> Rests | None:
    """Find where a leg rests.

    A leg that moved after a jump of its command rests if it has the same place in the last two quarters of the time
    until the next command. The offsets of its rests are fitted by a part that is the same in both directions (weight,
    zero of the encoder), and one with the sign of the motion into the rest.

    Parameters
    ----------
    commands, joints
        (n,) of a leg [m; rad].

    Returns
    -------
    Rests | None
        None where the log has fewer than 4 rests after motion in each direction.
    """
    changes = [*(np.flatnonzero(np.diff(commands) != 0.0) + 1), len(commands)]  # first ticks of new commands
    offsets, signs, unfinished = [], [], []
    for first, end in pairwise(changes):
        if end - first < _TICKS:
            continue
        quarter = (end - first) // 4
        last, before = joints[end - quarter : end], joints[end - 2 * quarter : end - quarter]
        place, noise = float(last.mean()), float(last.std())
        way, change = place - float(joints[first]), abs(place - float(before.mean()))
        if abs(way) < max(_MOVED * abs(float(commands[first] - commands[first - 1])), _CLEAR * noise):
            continue  # friction held it where it was, which can be anywhere
        if change > max(_STILL * abs(way), 3.0 * noise * float(np.sqrt(2.0 / quarter))):
            continue
        offsets.append(float(commands[first]) - place)
        signs.append(np.sign(way))
        unfinished.append(change)
    sign, offset = np.array(signs), np.array(offsets)
    if min((sign > 0).sum(), (sign < 0).sum()) < _FEWEST:
        return None
    columns = np.stack([np.ones_like(sign), sign], axis=1)
    (same, short), *_ = np.linalg.lstsq(columns, offset, rcond=None)
    left = offset - columns @ [same, short]
    freedom = len(sign) - 2
    covariance = np.linalg.inv(columns.T @ columns) * float(left @ left) / freedom
    half = float(t.ppf(0.5 + LEVEL / 2, freedom)) * float(np.sqrt(covariance[1, 1])) + float(np.mean(unfinished))
    return Rests(
        len(sign),
        Interval(float(short), float(short) - half, float(short) + half),
        float(same),
        float(np.abs(offset - same).max()),
    )


def with_friction(commands: Array, joints: Array, rests: Rests | None) -> Array:
    """Return the commands (n,) whose response without friction is that of a leg with it.

    While a leg moves in one direction, friction f shifts the place that it is drawn to by e = f/w^2 against the motion,
    and a command within e of where it rests does not move it. That is play of half width e in the command::

        p_k = clip(p_(k-1), q*_k - e, q*_k + e)

    It is exact for jumps that a leg without overshoot follows to its rest.

    Parameters
    ----------
    commands, joints
        (n,) of a leg [m; rad].
    rests
        Of that leg. The commands are returned unchanged where they show no friction.
    """
    if rests is None or not rests.short.low > 0.0:
        return commands
    edge, aim = rests.short.value, commands - rests.same
    drawn = np.empty_like(aim)
    place = float(joints[0])
    for tick, (low, high) in enumerate(zip(aim - edge, aim + edge, strict=True)):
        place = min(max(place, low), high)
        drawn[tick] = place
    return drawn
