"""What scatters an image that is predicted from joints: noise of the camera, noise of the joints, times that jitter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.drives import Drives
from hexservo.findings.identification.interval import LEVEL, Interval
from hexservo.findings.identification.log import Log, least_step
from hexservo.scenario.arrays import Array, Mask

_NOISE = 0.5  # share of the differences' power that a fit of the drives leaves of noise, at least
_REACH = 15  # ticks from which on a reading does not act in a spline, to 1e-8
_KNOWN_TO = 0.1  # share of the joints' power in the image, or of its slopes, that is not known
_MOST_DEVIATION = 0.25  # of frames' times that is searched [s]
_ALIKE = 0.25  # share of a jitter that two of its estimates may differ by
_TIMES_TO = 5e-5  # to which the deviation of frames' times is searched [s]


def rounding_deviations(readings: Array, deviations: Array) -> Array:
    """Return what the rounding of readings adds to their white noise, as standard deviations (6,) [m; rad].

    A leg at rest is off by the same part of a step in all its readings, of which their differences have nothing. The
    step is the smallest one between different readings of any leg: encoders of a machine are alike, and readings that
    are not rounded differ by next to nothing. Rounding to steps of d has the variance d^2/12.

    Parameters
    ----------
    readings
        (n, 6) of the joints at the ticks, as logged [m; rad].
    deviations
        (6,) of their white noise, as by `joint_deviations`, which has the rounding of readings in motion [m; rad].
    """
    step = least_step(readings.T)
    return np.asarray(np.sqrt(np.maximum(step**2 / 12.0 - deviations**2, 0.0)))


def is_motion(deviations: Array, drives: Drives) -> bool:
    """Whether what the readings' differences take for noise (6,) [m; rad] is motion: the fit of the drives has it."""
    left = np.array([fit.noise for fit in drives.fits])
    return bool((left**2).sum() < _NOISE * (deviations**2).sum())


def spline_shares(log: Log, times: Array, derivative: int = 0) -> Array:
    """Return which share of white noise's variance the cubic spline through its ticks has, (m,) [1].

    It is 1 at a tick and less between two. Of a derivative it is that of [1/s^derivative].
    """
    around = np.arange(-_REACH, _REACH + 1)
    alone = CubicSpline(around, around == 0)
    phase = (times / log.period) % 1.0
    weights = alone(phase[:, None] + around[None, 1:-1], derivative) / log.period**derivative
    return np.asarray((weights**2).sum(axis=1))


def overstated(slopes: Array, power: float) -> float:
    """Return how many times too well least squares takes a shift of times to be known; infinite where it is not.

    The joints' noise changes from tick to tick, and the slope of its spline passes for a motion. Of joints at rest
    all of it does, but for a part that the noise is not known to: up to two standard deviations are no motion.

    Parameters
    ----------
    slopes
        (n, f) of residuals, the first by the shift [px/s].
    power
        Sum of the squares of what that noise adds to these [px^2/s^2].
    """
    alone = _shift_alone(slopes)
    seen = float(alone @ alone)
    return seen / (seen - power) if seen > (1 + 2 * _KNOWN_TO) * power else np.inf


def moved_by(slopes: Array, image: Array) -> float:
    """Return what an image moves a shift of times by that least squares finds [s].

    Parameters
    ----------
    slopes
        (n, f) of residuals, the first by the shift [px/s].
    image
        (n,) that is added to the residuals [px].
    """
    alone = _shift_alone(slopes)
    seen = float(alone @ alone)
    return float(alone @ image) / seen if seen > 0.0 else np.inf


def _shift_alone(slopes: Array) -> Array:
    """Return what of the first column, by the shift, the others do not have, (n,)."""
    by_shift, others = slopes[:, 0], slopes[:, 1:]
    return np.asarray(by_shift - others @ np.linalg.lstsq(others, by_shift)[0])


def image_of_noise(scene: Scene, poses: Poses, deviations: Array) -> Array:
    """Return what one standard deviation of each joint moves the image by, (m, 2p, 6) [px].

    Parameters
    ----------
    scene
        Of the machine.
    poses
        (m,) of the platform.
    deviations
        (6,) of the joints [m; rad].
    """
    features, depth = scene.probe.image(poses.position, poses.quaternion)
    rates = scene.wrench_maps(poses).swapaxes(1, 2)  # of legs, by twist
    return np.asarray(scene.jacobian(features, depth, poses) @ np.linalg.inv(rates) * deviations)


@dataclass(frozen=True)
class Scatter:
    """What scatters the image of a fit."""

    noise: Interval  # standard deviation of a coordinate, by the camera [px]
    jitter: float | None  # how much later some frames are than others [s]; None where none is seen
    of_joints: float  # share of what is left across the motion that the noise of the joints explains
    of_ticks: bool = False  # the jitter is another, or none, if the image is off by what motion between ticks may be


@dataclass(frozen=True, eq=False)
class Weights:
    """What images count by where the times of frames jitter: less along the motion."""

    direction: Array  # (m, 2p) of the motion, unit vectors; 0 at rest
    share: Array  # (m,) what counts along it, of what does across it

    @classmethod
    def of(cls, scatter: Scatter, speed: Array) -> Weights:
        """Return the ratio of the standard deviations across and along the motion.

        Parameters
        ----------
        scatter
            Noise and jitter; where there is none of either, all counts.
        speed
            (m, 2p) of the image, the mean over the jitter [px/s].
        """
        size, direction = _split(speed)
        noise, late = scatter.noise.value, size * (scatter.jitter or 0.0) / np.sqrt(12.0)
        return cls(direction, noise / np.hypot(noise, late) if noise > 0.0 else np.ones(len(speed)))

    def weighed(self, image: Array) -> Array:
        """Return images, (..., m, 2p), as they count."""
        along = np.einsum("...ij,ij->...i", image, self.direction)
        return np.asarray(image - ((1.0 - self.share) * along)[..., None] * self.direction)


def _split(speed: Array) -> tuple[Array, Array]:
    """Return the magnitudes (m,) of velocities (m, 2p), and their directions (m, 2p)."""
    size = np.linalg.norm(speed, axis=1)
    return size, speed / np.where(size > 0.0, size, 1.0)[:, None]


def scatter_of(
    left: Array,
    speed: Array,
    by_joints: Array,
    together: float,
    by_ticks: Array | None = None,
    seen: Mask | None = None,
) -> Scatter:
    """Return the noise of the camera, and how much later some frames are than others.

    A frame that is late by d differs by d times the speed of the image, and so along it only: what is at right angles
    is noise, of the camera and of the joints, whose part is known. Along it the variance is that of both and speed^2
    times that of d, the most likely of which counts if its likelihood ratio to 0 is significant. The width of a uniform
    distribution is sqrt(12) standard deviations.

    Parameters
    ----------
    left
        (m, 2p) residuals [px].
    speed
        (m, 2p) of the image [px/s].
    by_joints
        (m, 2p, k) what one standard deviation of each joint's noise, or of its rounding, moves the image by [px].
    together
        Over how many frames residuals are correlated.
    by_ticks
        (k, m, 2p) what the image may be off by since the motion between ticks is not known, k times [px].
    seen
        (m, 2p) coordinates that the frames have, the others of which are 0 in all of these; None: all.
    """
    seen = np.ones(left.shape, dtype=bool) if seen is None else seen
    size, direction = _split(speed)
    along = np.einsum("ij,ij->i", left, direction)
    joints_along = np.einsum("ijk,ij->ik", by_joints, direction)
    joints_across = by_joints - direction[:, :, None] * joints_along[:, None, :]
    power, of_joints = float((left**2).sum() - along @ along), float((joints_across**2).sum())
    freedom = int(seen.sum()) - len(left) - 6  # of the target's displacement
    variance = max(power - of_joints, 0.0) / freedom
    # As many residuals of one variance scatter their sum alike: those of the joints are few, and not of one variance.
    covariance = variance * np.eye(left.shape[1]) * seen[:, :, None] + joints_across @ joints_across.swapaxes(1, 2)
    covariance -= variance * direction[:, :, None] * direction[:, None, :]
    squared = float((covariance**2).sum())
    alike = freedom if squared == 0.0 else float(np.trace(covariance, axis1=1, axis2=2).sum()) ** 2 / squared
    alike = min(alike, freedom) / together
    ends = [power * alike / number for number in chi2.ppf([0.5 + LEVEL / 2, 0.5 - LEVEL / 2], alike)]
    low, high = (
        max(end - way * of_joints, 0.0) / freedom for end, way in zip(ends, (1 + _KNOWN_TO, 1 - _KNOWN_TO), strict=True)
    )
    noise = Interval(*(float(np.sqrt(value)) for value in (variance, low, high)))
    share = min(of_joints / power, 1.0) if power > 0.0 else 0.0
    if variance <= 0.0:
        return Scatter(noise, None, share)
    at_rest = variance + (joints_along**2).sum(axis=1)
    jitter = _jitter(along, size, at_rest, together)
    if jitter is None or by_ticks is None:
        return Scatter(noise, jitter, share)
    ticks_along = np.einsum("kij,ij->ki", by_ticks, direction)
    surer = _jitter(along, size, at_rest + (ticks_along**2).mean(axis=0), together)
    return Scatter(noise, surer, share) if agree(jitter, surer) else Scatter(noise, jitter, share, of_ticks=True)


def agree(one: float | None, other: float | None) -> bool:
    """Whether two estimates of a jitter [s] are of the same."""
    return one is not None and other is not None and abs(one - other) <= _ALIKE * other


def _jitter(along: Array, speed: Array, at_rest: Array, together: float) -> float | None:
    """Return the width of the uniform distribution of times [s] that is most likely; None where 0 is as likely.

    Parameters
    ----------
    along
        (m,) residuals along the motion of the image [px].
    speed
        (m,) of the image [px/s].
    at_rest
        (m,) their variances without jitter [px^2].
    together
        Over how many frames they are correlated.
    """

    def cost(deviation: float) -> float:  # -2 log of the likelihood, of frames whose times have this deviation [s]
        spread = at_rest + (speed * deviation) ** 2
        return float((np.log(spread) + along**2 / spread).sum())

    best = minimize_scalar(cost, bounds=(0.0, _MOST_DEVIATION), method="bounded", options={"xatol": _TIMES_TO})
    seen = cost(0.0) - cost(best.x) > together * chi2.ppf(LEVEL, 1)
    return float(np.sqrt(12.0) * best.x) if seen else None
