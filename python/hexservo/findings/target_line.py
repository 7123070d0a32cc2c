"""The filter of the law `tracking` after many frames, and the straight lines by which it follows a steady target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexservo import _core
from hexservo.scenario.arrays import Array

_INSTANTS = 50  # between two frames, at which the reference is looked at
_COUNTED = 0.9  # share of the velocity with which what is followed is nearly the target, and comes nearer to it
_NEVER = 1e-12  # probability below which a line that is left is not looked at any further
_CYCLES = 3  # pieces after which the reference moves as in the ones before


@dataclass(frozen=True, eq=False)
class SteadyFilter:
    """The law's filter after many frames, along its modes: those of R, of a frame, over the acceleration's variance.

    Along each it is an alpha-beta filter of unit acceleration, with the variance alpha of a place and (beta/T^2)
    (alpha - beta/2)/(1 - alpha) of a velocity, over that of a reading (docs/model.md, section 5; Kalata 1984).
    """

    along: Array  # (n, n), a displacement in B [m; rad] along the modes
    reading: Array  # (n,) deviations along the modes, of the place in one frame
    place: Array  # (n,) likewise, of the filter's place
    velocity: Array  # (n,) likewise, per s

    @property
    def axes(self) -> int:
        """Return the numbers of what is followed: 6 of a pose, 3 of a place."""
        return len(self.place)

    @property
    def off_line(self) -> float:
        """Return the standard deviations of the place of a pose at which the filter leaves the line (`all_within`)."""
        return math.sqrt(_core.all_within(_core.OFF_THE_LINE, self.axes))

    @property
    def frames(self) -> float:
        """Return the frames that the filter's place is worth, with which a line begins again (docs/model.md)."""
        return self.axes / float(np.sum((self.place / self.reading) ** 2))

    def in_deviations(self, vectors: Array, deviations: Array) -> Array:
        """Return the lengths of translations (k, 3) in standard deviations (n,) along the modes, (k,)."""
        return np.asarray(np.linalg.norm(vectors @ self.along[:, :3].T / deviations, axis=1))


@dataclass(frozen=True)
class Piece:
    """What is followed of a target at unit speed from the use of one frame to that of the next [s]."""

    behind: float  # the target of the frame
    share: float  # of the target's velocity, with which it is carried on [1]


@dataclass(frozen=True)
class SteadyLine:
    """The line of a target of constant velocity, from one beginning to the next."""

    pieces: tuple[Piece, ...]  # until the filter leaves it without noise; empty where it does not
    stays: float  # probability that noise keeps the filter on it until the velocity counts [1]

    def goes_on(self, duration: float, period: float) -> bool:
        """Return whether the target is rather followed in pieces for that long than caught by then."""
        return bool(self.pieces) and (1.0 - self.stays) ** (duration / (len(self.pieces) * period)) > 0.5


def steady_line(filtered: SteadyFilter, velocity: Array, certainty: float, period: float, most: int) -> SteadyLine:
    """Return the line of a target of constant velocity.

    The filter is at the target, without a lag, and all readings are. So a line that began with a place worth n frames
    has the mean time t = T k (k + 1)/(2 (n + k)) after k more frames, the mean place that the target then had, and the
    sum of squares T^2 (k (k + 1)(2 k + 1)/6) - (n + k) t^2; it is behind by the part of the velocity that does not
    count, over the time since (docs/model.md, section 5). With the noise that the filter assumes, the square of d
    deviations has about the mean d^2 + 6 and the deviation 2 d, each frame by itself.

    Parameters
    ----------
    filtered
        After many frames.
    velocity
        Of the target, (3,) in B [m/s].
    certainty
        From which on a velocity counts, `controller.tracking.certainty`.
    period
        Between frames [s].
    most
        Frames that are looked at.
    """
    first, doubt = filtered.frames, certainty**2 * filtered.axes
    in_place, in_reading = (
        float(filtered.in_deviations(velocity[None], deviations)[0])
        for deviations in (filtered.place, filtered.reading)
    )
    pieces: list[Piece] = []
    leaves, stays = False, 1.0
    for k in range(most):
        mean = period * k * (k + 1) / (2.0 * (first + k))
        spread = period**2 * k * (k + 1) * (2 * k + 1) / 6.0 - (first + k) * mean**2
        square = in_reading**2 * spread
        share = 1.0 - (doubt / square) ** 2 if square > doubt else 0.0
        if share > _COUNTED or stays < _NEVER:
            break
        if not leaves:
            pieces.append(Piece((1.0 - share) * (k * period - mean), share))
        off = in_place * (1.0 - share) * ((k + 1) * period - mean)
        leaves = leaves or off > filtered.off_line
        room = filtered.off_line**2 - filtered.axes - off**2
        stays *= 0.5 * math.erfc(-room / (2.0 * math.sqrt(2.0) * max(off, 1e-300)))
    return SteadyLine(tuple(pieces) if leaves else (), stays)


def longest_behind(pieces: Sequence[Piece], period: float, late: float, bandwidth: float) -> float:
    """Return by how long a platform is behind a steady target that is followed in pieces, at most [s]; 0 without any.

    What is followed is behind by the target's way since the frame too. The reference goes to it with a double pole at
    2 pi bandwidth, of which the jumps and bends from frame to frame leave an error.

    Parameters
    ----------
    pieces
        From one beginning of a line to the next.
    period
        Between frames [s].
    late
        From an exposure until the legs are where that frame takes them [s].
    bandwidth
        Of the reference [Hz].
    """
    if not pieces:
        return 0.0
    pole, since = 2.0 * math.pi * bandwidth, np.linspace(0.0, period, _INSTANTS + 1)
    longest = error = rate = 0.0  # by which the reference is behind what is followed
    for before, piece in list(zip([pieces[-1], *pieces], pieces, strict=False)) * _CYCLES:
        error += before.behind + (1.0 - before.share) * (period + late) - piece.behind - (1.0 - piece.share) * late
        rate += piece.share - before.share
        decay = np.exp(-pole * since)
        errors = (error + (rate + pole * error) * since) * decay
        rates = (rate + pole * error) * decay - pole * errors
        behind = piece.behind + (1.0 - piece.share) * (late + since) + errors
        longest = max(longest, float(behind.max()))
        error, rate = float(errors[-1]), float(rates[-1])
    return longest
