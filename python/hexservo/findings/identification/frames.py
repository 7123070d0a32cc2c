"""What the camera of a machine does: period, latency, its jitter and noise, from a log of joints and images.

The joints give the place of the platform when a frame was taken, and so the image. A latency is found where that
agrees best with the image; where the target is, is found with it. Frames of a machine at rest do not determine it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.identification.drives import Drives
from hexservo.findings.identification.frames_noise import (
    Scatter,
    Weights,
    agree,
    is_motion,
    moved_by,
    overstated,
    rounding_deviations,
    scatter_of,
    spline_shares,
)
from hexservo.findings.identification.frames_outliers import NoOutliers, Outliers, outliers_of
from hexservo.findings.identification.frames_overwritten import clock_of_overwritten
from hexservo.findings.identification.frames_repeated import repeats
from hexservo.findings.identification.interval import Interval, correlated, half_width, robust_deviations
from hexservo.findings.identification.joint_motion import JointMotion
from hexservo.findings.identification.log import FITTED, LEAST_EXPLAINED, Frames, Log, joint_deviations, leg_moves
from hexservo.findings.identification.predicted_images import MOST_LATENCY, PredictedImages
from hexservo.findings.identification.rounding import grid_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array

SEEN = 0.01
"""Share of the scatter of pixels that their rounding has, to be a key."""

_FEWEST = 20  # frames
_TRIED = 11  # latencies of a coarse grid
_ROUNDS = 60  # evaluations of a fit
_TARGET = 6  # numbers of its displacement
_RARE = 0.01  # share of the frames at either end of the latencies from which jitter is not taken
_SAME = 1e-9  # times that differ by less are the same [s]
_WHITE = 2.0  # frames over which what a fit with the true calibration leaves is correlated, at most
_MOST_OF_JOINTS = 0.5  # share of what a fit leaves that the joints' noise may explain, for the rest to be of a camera
_MOST_OF_MOTION = 0.1  # the same of their motion between ticks, whose part is not known as that of noise is
_MOST_OF_ROUNDING = 0.5  # share of what a fit leaves that rounding has, for the rest to be noise where it is correlated
_WEIGHED = 4  # rounds in which the fit is repeated with the weights of the scatter that it left
_SETTLED = 0.02  # share that the noise falls by in the last of them
_SPEEDS = 4  # rounds in which the speed of the image is that over the jitter found
_APPARENT = 3.0  # [px]: what a displaced target moves the image by from which on the scenario does not see alike
_CLEANED = 4  # fits at most, each without the wrong detections that the one before shows
_EDGE = 5e-4  # latencies that are so near to an end of what is searched, or to 0, are no different from it [s]


@dataclass(frozen=True, eq=False, repr=False)
class CameraFit(Part):
    """Clock and noise of the camera, and where its target is."""

    frames: int  # that arrived
    period: Interval | None = None  # between exposures [s]; None where their times have no common one
    dropout: Interval | None = None  # share of the frames of that period that did not arrive; None without a period
    # from the true exposure to arrival [s]; 0 to `MOST_LATENCY` where the log leaves it open, and without an end where
    # it may be beyond what is searched
    latency: Interval | None = None
    # most that a frame is later than the earliest, usually [s]; None where there are no exposure times and the image is
    # not off by more where it moves faster
    jitter: float | None = None
    stamps: Interval | None = None  # what exposure times are late by [s]; None without them
    # standard deviation of a coordinate, of an image at rest [px]; None where the joints explain most of it
    noise: Interval | None = None
    explained: float | None = None  # share of the image motion kept apart that is predicted, 1: all; None: none there
    target: Array = field(default_factory=lambda: np.zeros(6))  # displacement of the scenario's target [m; rad]
    target_deviations: Array = field(default_factory=lambda: np.full(6, np.inf))  # standard, of these [m; rad]
    stragglers: int = 0  # frames whose latency is far from that of the others: they do not count in latency and jitter
    repeated: int = 0  # frames that repeat the one before: they do not count
    overwritten: int = 0  # frames that no line has, since another one arrived before it: they are none of `dropout`
    incomplete: int = 0  # of the others, those that lack points
    lost_points: float = 0.0  # share of the points of the others that they lack
    correlated: float = 1.0  # frames over which what the fit leaves is, in half of the coordinates; 1 of white noise
    target_pixels: float = 0.0  # what the target's displacement moves the image by, RMS of a coordinate [px]
    of_joints: float = 0.0  # share of what the fit leaves across the motion that the noise of the joints explains
    ticks_are_coarse: bool = False  # that noise is motion of the joints between ticks
    jitter_of_ticks: bool = False  # the jitter may be motion of the joints between ticks
    rounding: float = 0.0  # step that pixels are rounded to, whose part is not in `noise` [px]; 0: none
    of_rounding: float = 0.0  # share of what the fit leaves across the motion that the rounding explains
    outliers: Outliers | NoOutliers | None = None  # wrong detections: their frames do not count; None: not known
    open: str = ""  # why nothing was found; empty if something was

    @property
    def stamps_are_wrong(self) -> bool:
        """Whether exposure times do not agree with the joints, by more than the resolution of the fit."""
        return self.stamps is not None and (self.stamps.low > _EDGE or self.stamps.high < -_EDGE)

    @property
    def noise_is_white(self) -> bool:
        """Whether what the fit leaves is noise, and not what the model lacks."""
        return self.correlated <= _WHITE

    @property
    def noise_is_of_camera(self) -> bool:
        """Whether what the fit leaves is more than the noise of the joints that the image is predicted from."""
        return self.of_joints <= (_MOST_OF_MOTION if self.ticks_are_coarse else _MOST_OF_JOINTS)

    @property
    def rounding_is_most(self) -> bool:
        """Whether what the fit leaves may be rounding, which is correlated where an image moves by less than a step."""
        return self.of_rounding > _MOST_OF_ROUNDING

    @property
    def jitter_is_known(self) -> bool:
        """Whether exposure times tell the scatter of the latency, or else images that are off by noise alone."""
        by_noise_alone = self.noise_is_white and self.noise_is_of_camera and not self.jitter_of_ticks
        return self.stamps is not None or by_noise_alone

    @property
    def target_is_apparent(self) -> bool:
        """Whether the target is seen where the scenario does not have it."""
        known = (np.abs(self.target) > half_width(1.0) * self.target_deviations).any()
        return bool(known and self.target_pixels > _APPARENT)

    @property
    def latency_is_known(self) -> bool:
        """Whether the log determines the latency."""
        return self.latency is not None and self.latency.high - self.latency.low < MOST_LATENCY / 2

    @property
    def at_edge(self) -> bool:
        """Whether the latency, or what exposure times are late by, is at the edge of what is searched."""
        return self.latency is not None and not self.latency.is_bounded

    @property
    def explains(self) -> bool:
        """Whether the model is of these images at all, as far as the part kept apart shows it."""
        return not self.open and (self.explained is None or self.explained >= LEAST_EXPLAINED)


def fit_camera(log: Log, scene: Scene, drives: Drives | None = None) -> CameraFit:
    """Fit clock and noise of the camera to a log.

    Parameters
    ----------
    log
        With images, of a platform that moved.
    scene
        Of the machine: legs, camera and target.
    drives
        Of the same log, which tell how the joints move between ticks; None: as a spline.
    """
    frames = log.frames
    count = 0 if frames is None else len(frames.arrival)
    if frames is None or count < _FEWEST:
        return CameraFit(count, open=f"expected at least {_FEWEST} frames in the log, got {count}")
    if drives is not None and drives.if_exchanged is not None:
        return CameraFit(
            count, open="commands and joints of the log are exchanged, and the image is that of the joints"
        )
    if reason := _not_fitted(scene, frames):
        return CameraFit(count, open=reason)
    repeated_ones = repeats(log, frames)
    repeated = int(repeated_ones.sum())
    if repeated:
        frames = frames.only(~repeated_ones)
        if len(frames.arrival) < _FEWEST:
            return CameraFit(count, open=f"expected at least {_FEWEST} frames, got {repeated} of {count} repeated")
    stamped = frames.exposure is not None
    clock = clock_of_overwritten(frames, log.time)
    period, dropout = (None, None) if clock is None else (clock.period, clock.dropout)
    seen = frames.seen
    lost: dict[str, Any] = {"overwritten": 0 if clock is None else clock.overwritten}
    lost |= {"incomplete": int((~seen).any(axis=1).sum()), "lost_points": float((~seen).mean())}
    if (shown := int(seen.any(axis=1).sum())) < _FEWEST:
        reason = f"expected at least {_FEWEST} frames with a point of the target, got {shown} of {count}"
        return CameraFit(count, period, dropout, repeated=repeated, open=reason, **lost)
    rounding = grid_of(frames.features[:, ::2], frames.features[:, 1::2])
    joints = JointMotion.of(log, drives)
    sight = PredictedImages.of(log, frames, scene, joints)
    joint_noise = joint_deviations(joints.left)
    fit, outliers = _cleaned(sight, log, joint_noise, stamped=stamped)
    if isinstance(fit, str):
        return CameraFit(count, period, dropout, repeated=repeated, open=fit, **lost)
    shift, of_motion = fit
    coarse = drives is not None and is_motion(joint_noise, drives)
    found = CameraFit(
        count,
        period,
        dropout,
        shift,
        repeated=repeated,
        ticks_are_coarse=coarse,
        outliers=outliers,
        **lost,
        **of_motion,
    )
    if not found.noise_is_of_camera or found.noise is None:
        found = replace(found, noise=None, rounding=rounding)
    else:
        found = replace(found, rounding=rounding, **_beside_rounding(found.noise, rounding))
    if frames.exposure is None:
        return found
    late = frames.arrival - frames.exposure
    low, high = np.quantile(late, [_RARE, 1 - _RARE])
    jitter = float(high - low) / (1 - 2 * _RARE)  # of a uniform one
    usual = late[np.abs(late - (low + high) / 2) <= jitter + _SAME]
    mean, sigma = float(usual.mean()), float(usual.std() / np.sqrt(len(usual)))
    wide = np.hypot(half_width(sigma), min(shift.high - shift.value, shift.value - shift.low))
    late_by = mean + shift.value
    ends = (end if np.isinf(end) else late_by + side * wide for end, side in ((shift.low, -1), (shift.high, 1)))
    latency = Interval(late_by, *map(float, ends))
    return replace(found, latency=latency, jitter=jitter, stamps=shift, stragglers=len(late) - len(usual))


def _beside_rounding(scatter: Interval, step: float) -> dict[str, Any]:
    """Return the noise beside what rounding to a step [px] adds, and its share: fields of `CameraFit`."""
    part = step**2 / 12.0
    noise = Interval(*(float(np.sqrt(max(one**2 - part, 0.0))) for one in (scatter.value, scatter.low, scatter.high)))
    return {"noise": noise, "of_rounding": min(part / scatter.value**2, 1.0) if scatter.value > 0.0 else 0.0}


def _not_fitted(scene: Scene, frames: Frames) -> str:
    points = frames.features.shape[1] // 2
    if scene.scenario.camera.mount.on == "base":
        return "the camera is fixed to the base, and this fit is of cameras on the platform (camera.mount.on)"
    if not scene.has_points:
        return "a camera as_printed has no points in space"
    if reason := scene.moving_target:
        return reason[0].lower() + reason[1:].rstrip(".")
    if points != len(scene.points):
        return f"expected {len(scene.points)} points in an image, as the scenario's target has, got {points}"
    return ""


_Fit = tuple[Interval, dict[str, Any]]  # the shift of the frames' times [s], and fields of `CameraFit`


def _cleaned(
    sight: PredictedImages, log: Log, joint_noise: Array, *, stamped: bool
) -> tuple[_Fit | str, Outliers | NoOutliers | None]:
    """Return what `_fit` does without the frames that have wrong detections, and these."""
    fit = _fit(sight, log, joint_noise, stamped=stamped)
    seen: Outliers | NoOutliers | None = None
    left_out = np.zeros(len(sight.times), dtype=bool)
    for _ in range(_CLEANED):
        if isinstance(fit, str):
            break
        late, target, jitter = fit[0].value, fit[1]["target"], fit[1]["jitter"]
        left = sight.left(late, target)
        points = sight.seen[:, ::2]
        found = None if left is None else outliers_of(left, sight.speed(late, target, jitter or log.period), points)
        frames, now = found if isinstance(found, tuple) else (np.zeros_like(left_out), found)
        if (frames == left_out).all():
            seen = now
            break
        again = _fit(sight.only(~frames), log, joint_noise, stamped=stamped)
        if isinstance(again, str):
            break
        fit, left_out, seen = again, frames, now
    return fit, seen


def _fit(sight: PredictedImages, log: Log, joint_noise: Array, *, stamped: bool) -> _Fit | str:
    """Return the shift of the frames' times [s] and the fields of `CameraFit` that the motion gives, or why none."""
    count = len(sight.times)
    if count < _FEWEST:
        return f"expected at least {_FEWEST} frames {1e3 * sight.latest:.0f} ms after the start of the log, got {count}"
    fitted = int(FITTED * count)
    part = sight.only(slice(fitted))
    unit = sight.scene.unit
    lowest = -sight.latest if stamped else 0.0

    best = None
    for late in np.linspace(lowest, sight.latest, _TRIED):
        poses = part.poses(float(late))
        if poses is None:
            continue

        def displaced(x: Array, late: float = float(late), poses: Poses = poses) -> Array:
            return _numbers(part.left(late, x * unit, poses), part)

        start = least_squares(displaced, np.zeros(6), method="lm", max_nfev=_ROUNDS)
        if best is None or start.cost < best[0]:
            best = (start.cost, float(late), start.x)
    if best is None or best[0] > 1e11:
        return "the logged joints are no pose of the scenario's legs, or the target is behind the camera"
    of_joints = (part.by_noise(joint_noise, best[1]) ** 2).sum(axis=(1, 2))

    def residuals(x: Array) -> Array:
        late = float(x[0] * sight.latest)
        # The spline has most of the joints' noise at ticks: without the last number, whose square is what this lacks
        # of a constant, least squares would move the frames' times to between two.
        evened = np.sqrt(float(of_joints @ (2.0 - spline_shares(log, part.times - late))))
        return np.append(_numbers(part.left(late, x[1:] * unit), part), evened)

    first = np.concatenate([[best[1] / sight.latest], best[2]])
    bounds = [np.r_[lowest / sight.latest, np.full(6, -np.inf)], np.r_[1.0, np.full(6, np.inf)]]
    fit = least_squares(residuals, first, bounds=bounds, x_scale="jac", max_nfev=_ROUNDS)
    jacobian, left = fit.jac[:-1], fit.fun[:-1].reshape(part.features.shape)
    lasting = [correlated(column[one]) for column, one in zip(left.T, part.seen.T, strict=True) if one.any()]
    together = max(lasting)
    sigma = robust_deviations(jacobian, left.ravel(), fitted, together)
    by_noise = float(of_joints @ spline_shares(log, part.times - fit.x[0] * sight.latest, derivative=1))
    sigma[0] *= overstated(jacobian, by_noise * sight.latest**2)
    by_ticks = part.between_ticks(fit.x[0] * sight.latest, fit.x[1:] * unit)
    sigma[0] = np.hypot(sigma[0], max(abs(moved_by(jacobian, image.ravel())) for image in by_ticks))
    shift = _bounded(Interval.around(fit.x[0], float(sigma[0])).times(sight.latest), lowest, sight.latest)
    shares = np.sqrt(spline_shares(log, part.times - shift.value))
    by_joints = np.concatenate(
        [
            shares[:, None, None] * part.by_noise(joint_noise, shift.value),
            part.by_noise(rounding_deviations(log.joints, joint_noise), shift.value),
        ],
        axis=2,
    )
    at_once = jacobian[:, 0].reshape(left.shape) / sight.latest

    def scattered(target: Array, left: Array) -> Scatter:
        return _of_one_speed(
            lambda speed: scatter_of(left, speed, by_joints, together, by_ticks, part.seen),
            at_once,
            lambda width: part.speed(shift.value, target, width),
        )

    placed = _Placed(fit.x[1:] * unit, sigma[1:] * unit, left, scattered(fit.x[1:] * unit, left))
    placed = _placed_by_weights(part, placed, shift.value, at_once, together, scattered)
    undisplaced = part.left(shift.value, np.zeros(_TARGET))
    return shift, {
        "jitter": placed.scatter.jitter,
        "noise": placed.scatter.noise,
        "of_joints": placed.scatter.of_joints,
        "jitter_of_ticks": placed.scatter.of_ticks,
        "explained": _predicted(sight, log, shift.value, placed.target, fitted),
        "target": placed.target,
        "target_deviations": placed.deviations,
        "correlated": float(np.median(lasting)),
        "target_pixels": np.inf
        if undisplaced is None
        else float(np.sqrt(np.mean((placed.left - undisplaced)[part.seen] ** 2))),
    }


@dataclass(frozen=True, eq=False)
class _Placed:
    """A place of the target, and what the image scatters about it."""

    target: Array  # (6,) its displacement [m; rad]
    deviations: Array  # (6,) standard, of it [m; rad]
    left: Array  # (m, 2p) residuals [px]
    scatter: Scatter


def _placed_by_weights(
    part: PredictedImages,
    placed: _Placed,
    late: float,
    at_once: Array,
    together: float,
    scattered: Callable[[Array, Array], Scatter],
) -> _Placed:
    """Return the place of the target where images count as the jitter lets them: along their motion they are off by it.

    Without weights the target is off by a part of that, in all images alike, which would pass for noise. Each round has
    the weights of the scatter of the one before, and counts if it leaves less noise; without a jitter there is none.

    Parameters
    ----------
    part
        Frames that are fitted.
    placed
        By images that count alike.
    late
        Shift of the frames' times, as it is [s].
    at_once
        (m, 2p) speed of the image when a frame is taken [px/s].
    together
        Over how many frames residuals are correlated.
    scattered
        Scatter by the displacement of the target and the residuals.
    """
    unit = part.scene.unit
    poses = part.poses(late)
    for _ in range(_WEIGHED):
        jitter = placed.scatter.jitter
        if jitter is None:
            break
        weights = Weights.of(placed.scatter, part.speed(late, placed.target, jitter))

        def counted(x: Array, weights: Weights = weights) -> Array:
            left = part.left(late, x * unit, poses)
            return _numbers(None if left is None else weights.weighed(left), part)

        fit = least_squares(counted, placed.target / unit, x_scale="jac", max_nfev=_ROUNDS)
        target = fit.x * unit
        left = part.left(late, target, poses)
        if left is None:
            break
        slopes = np.column_stack([weights.weighed(at_once).ravel(), fit.jac])
        sigma = robust_deviations(slopes, fit.fun, len(left), together)[1:] * unit
        before, again = placed.scatter.noise.value, _Placed(target, sigma, left, scattered(target, left))
        if again.scatter.noise.value >= before:
            break
        placed = again
        if placed.scatter.noise.value > (1.0 - _SETTLED) * before:
            break
    return placed


def _numbers(left: Array | None, part: PredictedImages) -> Array:
    """Return residuals (m, 2p) as a search takes them, (2 m p,): large ones where the image gives none."""
    return np.full(part.features.size, 1e6) if left is None else left.ravel()


def _of_one_speed(scatter_by: Callable[[Array], Scatter], at_once: Array, over: Callable[[float], Array]) -> Scatter:
    """Return the scatter of an image with its mean speed over the jitter, since a jump begins at any time within it.

    Where none agrees with its own mean speed, the jitter is no other than that of motion between ticks.

    Parameters
    ----------
    scatter_by
        Scatter by the speed of the image, (m, 2p) [px/s].
    at_once
        That speed when a frame is taken, (m, 2p) [px/s].
    over
        The mean of that speed over a width [s].
    """
    found = scatter_by(at_once)
    for _ in range(_SPEEDS):
        if found.jitter is None or found.of_ticks:
            return found
        before, found = found, scatter_by(over(found.jitter))
        if found.jitter is None:
            return replace(before, of_ticks=True)
        if agree(before.jitter, found.jitter):
            return found
    return replace(found, of_ticks=True)


def _predicted(sight: PredictedImages, log: Log, late: float, displacement: Array, fitted: int) -> float | None:
    """Return the share of the image motion that is predicted after the frames that are fitted; None of one at rest."""
    apart = slice(int(np.searchsorted(log.time, sight.times[fitted] - late)), None)
    if not any(leg_moves(log.commands[:, leg], log.joints[:, leg], apart) for leg in range(6)):
        return None
    rest = sight.left(late, displacement)
    power = float((sight.only(slice(fitted, None)).motion ** 2).sum())
    return 0.0 if rest is None or power == 0.0 else 1.0 - float((rest[fitted:] ** 2).sum()) / power


def _bounded(found: Interval, lowest: float, highest: float) -> Interval:
    """Return an interval within what was searched; a latency has no end there where it is known and may be beyond.

    No frame arrives before it is taken: 0 is an end of a latency. Exposure times may be early.
    """
    within = Interval(*(float(np.clip(value, lowest, highest)) for value in (found.value, found.low, found.high)))
    if found.high - found.low >= MOST_LATENCY / 2:
        return within
    return within.opened(-np.inf if lowest == 0.0 else lowest + _EDGE, highest - _EDGE)
