"""How far behind a target that swings the law `tracking` is, by the gains of its filter and reference there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexservo.findings.target_line import SteadyFilter
from hexservo.scenario.arrays import Array

_INSTANTS = 20  # from the use of one frame to that of the next, over which what is followed is averaged
_PHASES = 16  # by which the velocity of a line may be late, that are looked at


@dataclass(frozen=True)
class FollowingLoop:
    """From a frame to the legs: times, and the reference's double pole."""

    period: float  # between frames [s]
    late: float  # from an exposure until the legs are where that frame takes them [s]
    bandwidth: float  # of the reference [Hz]
    lag: float  # 2 zeta/w of the legs [s]
    lag_squared: float  # 1/w^2, likewise [s^2]
    lead: float  # share of both that the command leads by [1]
    feedback: float  # gain on how far the legs are behind [1]


@dataclass(frozen=True, eq=False)
class Swing:
    """A target that swings along a line, followed by the filter of a pose after many periods.

    Fundamental alone: what is followed from frame to frame has harmonics of the frame rate, which are left out.
    """

    filtered: SteadyFilter
    loop: FollowingLoop
    amplitude: Array  # (3,) in B [m]
    frequency: float  # [Hz]
    jacobian: Array  # (2p, 6) of the image at the goal [px/m; px/rad]

    @property
    def of_target(self) -> float:
        """Return how far the target moves the features about a platform that stands still, at most [px]."""
        return float(np.abs(self.jacobian[:, :3] @ self.amplitude).max())

    @property
    def counts(self) -> float:
        """Return the largest velocity in its standard deviations, over the root of their number [1]."""
        peak = 2.0 * math.pi * self.frequency * self.amplitude
        return float(self.filtered.in_deviations(peak[None], self.filtered.velocity)[0]) / math.sqrt(self.filtered.axes)

    def speed(self, share: complex) -> float:
        """Return the largest speed of the platform [m/s], for a share of the velocity that counts."""
        motion = self._in_axes(self._gains(share))
        return 2.0 * math.pi * self.frequency * float(np.linalg.norm(motion[:3]))

    def behind(self, share: complex = 1.0) -> float:
        """Return how far the features are from the goal, at most [px], for a share of the velocity that counts.

        A complex share of magnitude 1 is a velocity that is late.
        """
        return float(np.abs(self.jacobian @ self._in_axes(1.0 - self._gains(share))).max())

    def in_pieces(self) -> float:
        """Return roughly how far the features are from the goal where straight lines are followed, at most [px].

        The filter leaves a line when that is `off_line` away. On a target that turns the line's velocity is late by
        the time of that, or missing. Runs without more noise than is assumed have 0.7 to 2 times as much.
        """
        ahead = self.amplitude / np.linalg.norm(self.amplitude)
        off = self.filtered.off_line / float(self.filtered.in_deviations(ahead[None], self.filtered.place)[0])
        off *= float(np.abs(self.jacobian[:, :3] @ ahead).max())
        late = min(math.sqrt(2.0 * off / self.of_target), math.pi)
        moved = 1.0 / (1.0 + (self.frequency / self.loop.bandwidth) ** 2)
        lines = [self.behind(np.exp(-1j * phase)) for phase in np.linspace(0.0, late, _PHASES)]
        return max(lines) + min(off, self.of_target) * moved

    def _in_axes(self, gains: Array) -> Array:
        """Return the complex motion (6,) in B [m; rad] that gains (6,) along the modes make of the target's."""
        along = self.filtered.along
        return np.asarray(np.linalg.solve(along, gains * (along[:, :3] @ self.amplitude)))

    def _gains(self, share: complex) -> Array:
        """Return the platform's motion over the target's along each mode of the filter, (6,)."""
        loop, w = self.loop, 2.0 * math.pi * self.frequency
        place, velocity = alpha_beta_gains(self.filtered, w * loop.period, loop.period)
        age = loop.late + np.linspace(0.0, loop.period, _INSTANTS + 1)
        turned = np.exp(-1j * w * age)
        rate = share * velocity
        goal = place * turned.mean() + rate * (age * turned).mean()
        pole = 2.0 * math.pi * loop.bandwidth
        reference = (pole**2 * goal + 2.0 * pole * rate * turned.mean()) / (1j * w + pole) ** 2
        lag = 1j * w * loop.lag - w**2 * loop.lag_squared
        return np.asarray(reference * (1.0 + loop.feedback + loop.lead * lag) / (1.0 + loop.feedback + lag))


def alpha_beta_gains(filtered: SteadyFilter, angle: float, period: float) -> tuple[Array, Array]:
    """Return place [1] and velocity [1/s] of the filter over a target's place that turns by an angle per frame, (n,).

    Of the recursion x = x' + alpha (z - x'), v = v' + beta/T (z - x'), x' = x + T v of the last frame (Kalata 1984).
    """
    alpha = (filtered.place / filtered.reading) ** 2
    beta = 2.0 * (2.0 - alpha) - 4.0 * np.sqrt(1.0 - alpha)
    z = np.exp(1j * angle)
    poles = (z - 1.0) ** 2 + alpha * (z - 1.0) + beta * z
    return z * (alpha * (z - 1.0) + beta) / poles, beta / period * z * (z - 1.0) / poles
