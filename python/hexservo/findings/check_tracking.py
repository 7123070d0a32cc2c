"""What the law `tracking` takes for motion of its target that is none, and which motion it follows behind."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.image_estimate import estimate_of_image
from hexservo.findings.analysis.scene import Scene, View
from hexservo.findings.analysis.words import AXES
from hexservo.findings.check_gains import SELDOM, share_of_restarts
from hexservo.findings.check_tracking_runs import less_noise, noise_helps, of_limits, of_runs
from hexservo.findings.gate_width import moved_between_frames
from hexservo.findings.target_line import Piece, SteadyFilter, longest_behind, steady_line
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import Tracking
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.wording import number, quantity

_TIMES = 1.5  # the noise that the filter assumes, above which what it sees looks like motion
_ASSUMED = 2.75  # times that noise, up to which assuming more made runs quieter; from 3 times on it made them worse
_OF_DEPTH = 0.3  # assumed deviation of a place, beyond which runs settle late
_FINE = 0.1  # of the depth, with which they do not
_STEPPED = 5.0  # times the rounding in the image that runs had at most, where the filter follows it
_FEW_FRAMES = 0.5  # periods of a sinusoid from frame to frame, from which on they show it as another motion
_REMEMBERED = 200.0  # frames, by the line
ABOVE = 3.0  # deviations that a band should hold
_WHOLE = 2.0  # times the speed from which a velocity counts: 1 - 1/2^4 of it does


def of_tracking(scene: Scene) -> Iterator[str]:
    """Yield a sentence for noise beyond what the filter assumes, and for a target that is followed behind."""
    gains = scene.scenario.controller.gains
    if isinstance(gains, Tracking):
        yield from _of_noise(scene, gains)
        yield from _of_assumed(scene, gains)
        yield from _of_motion(scene, gains)
        yield from _of_band(scene, gains)


def _of_noise(scene: Scene, gains: Tracking) -> Iterator[str]:
    """Find rounded readings that look like motion; of the camera's noise it is `check_gains` that names it.

    Noise of the joints is another one at every reading, and hardly moves the command: to assume it makes runs worse.
    Rounding stays as long as the legs do, and moves with them, which the filter follows.
    """
    scenario, rounding = scene.scenario, scene.joint_rounding
    camera = feature_noise(scenario.camera)
    true = math.hypot(camera, rounding)
    share = share_of_restarts(scenario, f"controller.{scenario.controller.law}")
    of_joints = true > 2.0 * camera or share * SELDOM < 1.0
    if true <= _TIMES * gains.noise or not of_joints or not scene.band < _STEPPED * rounding:
        return
    step = quantity(scenario.sensors.resolution, scene.units.coordinate)
    steps = f"readings of the joints in steps of {step} (sensors.resolution)"
    takes = "the filter takes these for motion of the target, and the error may exceed metrics.band"
    if true <= _ASSUMED * gains.noise:
        yield (
            f"controller.tracking.noise: {number(gains.noise)} px is less than the {number(true, 2)} px that {steps} "
            f"and the camera leave in the image, so that {takes}; set it to {number(true, 2)}"
        )
    elif rounding <= scene.band:  # more: `check_joints` names it
        yield (
            f"sensors.resolution: {steps} and the camera leave {number(true, 2)} px in the image, and "
            f"controller.tracking.noise is {number(gains.noise)} px, so that {takes}; take finer encoders"
        )


def _of_assumed(scene: Scene, gains: Tracking) -> Iterator[str]:
    """Find an assumed noise far above that of the camera, with which the filter takes a place for unknown.

    It then takes off what the image is not linear in over a part of the depth (`read_pose`), which is no small motion.
    In runs of six cases on three machines (`rubin-camera-positions`, `moog-6dof2000e`, `pi-h824`) a filter that
    assumed 0.2 of the depth settled in up to 1.4 times its usual time (with three of the targets up to 3 times), with
    0.5 of it 2 times as late or not at all, and with all of it hardly any did.
    """
    view = scene.view(scene.start)
    if gains.follow != "pose" or not np.isfinite(view.features).all():
        return
    rows, counts = scene.of_pixels(view.features, view.jacobian), np.square(scene.root_weights[:, 0])
    shifts = gains.noise * np.sqrt(np.diag(np.linalg.inv((rows.T * counts) @ rows)))[:3]
    true = feature_noise(scene.scenario.camera)
    estimate = estimate_of_image(rows, counts)
    axis = int(shifts.argmax())
    scatter = true * float(np.linalg.norm(estimate[axis]))
    if shifts[axis] <= max(_OF_DEPTH * view.mean_depth, _ASSUMED * scatter):
        return
    counted = counts[counts > 0.0]
    mean = float(counted.mean())
    takes = (
        f"the law's filter assumes that an image leaves the target uncertain by {quantity(float(shifts[axis]), 'm')} "
        f"along {'xyz'[axis]} (standard deviation), at a distance of {quantity(view.mean_depth, 'm')}, so that runs "
        "settle late or not at all"
    )
    if shifts[axis] * math.sqrt(mean) <= _OF_DEPTH * view.mean_depth:
        yield (
            f"target.weights: with controller.tracking.noise, {number(gains.noise)} px, over the root of the weights, "
            f"{number(mean)} on average, {takes}; take weights about 1"
        )
    else:
        enough = max(true, gains.noise * _FINE * view.mean_depth / float(shifts[axis]))
        yield (
            f"controller.tracking.noise: with {number(gains.noise)} px {takes}; camera.noise and camera.quantisation "
            f"are {number(true)} px: set it to {number(enough)} or less"
        )


def _of_motion(scene: Scene, gains: Tracking) -> Iterator[str]:
    """Find a target whose velocity does not count, or not whole, so that the law follows behind it."""
    scenario = scene.scenario
    motion = scenario.target.motion
    if motion.kind == "none":
        return
    period = frame_period(scenario)
    velocities = moved_between_frames(motion, period) / period
    fastest = velocities[int(np.argmax(np.linalg.norm(velocities, axis=1)))]
    if not fastest.any():
        return
    if period > _core.LONGEST_PREDICTION:
        yield from _of_rare_frames(scene, gains, fastest)
    elif motion.kind == "velocity":
        limits = list(of_limits(scene))
        yield from limits or _of_steady(scene, gains, fastest)
    elif motion.kind != "sinusoid" or motion.frequency * period < _FEW_FRAMES:  # `check_target` names what more show
        yield from of_runs(scene, gains)


def _of_steady(scene: Scene, gains: Tracking, velocity: Array) -> Iterator[str]:
    """Find a constant velocity (3,) [m/s] that does not count, or of a direction not whole."""
    of_pose, period, speed = gains.follow == "pose", frame_period(scene.scenario), float(np.linalg.norm(velocity))
    filtered = steady_filter(scene, gains)
    deviations = float(filtered.in_deviations(velocity[None], filtered.velocity)[0])
    times = deviations / (gains.certainty * math.sqrt(filtered.axes) or 1e-300)
    if times >= (1.0 if of_pose else _WHOLE):
        return
    if of_pose:
        pixels = _behind_steady(scene, gains, filtered, velocity)
        if pixels <= scene.band:
            return
        until = (
            f"with frames of {quantity(period, 's')} a line may end before its velocity counts, and the target is "
            f"followed in pieces of straight lines, up to about {number(pixels, 2)} px behind"
        )
    else:
        until = (
            "the mean of earlier frames is followed, behind the target, and up to twice that speed a part of its "
            "velocity is missing"
        )
    noise = less_noise(scene, gains)
    helps = noise is not None and noise_helps(scene, noise)
    remedy = f"controller.tracking.noise to {number(noise or 0.0)} px, that of the features, or " if helps else ""
    yield (
        f"controller.tracking.certainty: target.motion moves the target at up to {quantity(speed, 'm/s')}, "
        f"and the velocity of the law's filter counts from about {quantity(speed / times, 'm/s')} on, where it is "
        f"certainty ({number(gains.certainty)}) times what noise of {number(gains.noise)} px leaves in it, and while "
        f"the platform follows from up to three times that on: until then {until}; set "
        f"{remedy or 'controller.tracking.'}certainty to 0, with which every velocity counts"
    )


def _of_band(scene: Scene, gains: Tracking) -> Iterator[str]:
    """Find a band that noise leaves again and again, so that no target counts as reached, and no integral begins."""
    scenario = scene.scenario
    if gains.integral == 0.0 or gains.follow != "pose" or scenario.target.motion.kind != "none":
        return
    off, band = off_reference(scene, gains), scene.settings["controller.tracking.band"]
    axis = int((off / band).argmax())
    if off[axis] > band[axis]:
        unit = "m" if axis < 3 else "rad"
        shift, turn = (ABOVE * float(part.max()) for part in (off[:3], off[3:]))
        yield (
            f"controller.tracking.band: {quantity(band[axis], unit)} {AXES[axis]} is less than the "
            f"{quantity(off[axis], unit, 2)} by which noise of the camera keeps the target as it is estimated from the "
            "reference (standard deviation), so that controller.tracking.integral may never begin: the target has to "
            f"stay within the band until the legs are at rest; a band of {quantity(shift, 'm', 2)} and "
            f"{quantity(turn, 'rad', 2)} has room for it"
        )


def off_reference(scene: Scene, gains: Tracking) -> Array:
    """Return how far noise keeps the estimate of a target at rest from the reference, (6,) [m; rad], about.

    The line moves by a share of each reading, one over the frames that it remembers, and the reference is late by
    1/(pi bandwidth): the sum over the frames since is a random walk with half of their variance.
    """
    scenario, view = scene.scenario, _goal_view(scene)
    rows = scene.of_noise(view.features, view.jacobian)
    reading = feature_noise(scenario.camera) * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    frames = 1.0 / (math.pi * gains.bandwidth * frame_period(scenario))
    return np.asarray(reading / _REMEMBERED * math.sqrt(max(frames, 1.0) / 2.0))


def _of_rare_frames(scene: Scene, gains: Tracking, velocity: Array) -> Iterator[str]:
    """Find a target that is followed by the place of its last frame alone, as the filter begins again with each."""
    period, speed = frame_period(scene.scenario), float(np.linalg.norm(velocity))
    held = (Piece(behind=0.0, share=0.0),)
    pixels = longest_behind(held, period, _late(scene), gains.bandwidth) * _pixels_of(scene, velocity)
    if pixels <= scene.band:
        return
    longest = quantity(_core.LONGEST_PREDICTION, "s")
    yield (
        f"camera.period: frames are {quantity(period, 's')} apart, and the law's filter begins again with a frame that "
        f"comes more than {longest} after the one before, so that it has no velocity of the target, whatever "
        f"controller.tracking.certainty is: target.motion moves the target at up to {quantity(speed, 'm/s')}, and the "
        f"place of the last frame is followed, up to about {number(pixels, 2)} px "
        f"behind; take frames at most {longest} apart, or another law"
    )


def _behind_steady(scene: Scene, gains: Tracking, filtered: SteadyFilter, velocity: Array) -> float:
    """Return how far behind a target of constant velocity is followed at most [px]; 0: the line's velocity counts."""
    scenario = scene.scenario
    period, duration = frame_period(scenario), scenario.simulation.duration
    line = steady_line(filtered, velocity, gains.certainty, period, math.ceil(duration / period))
    if not line.goes_on(duration, period):
        return 0.0
    return longest_behind(line.pieces, period, _late(scene), gains.bandwidth) * _pixels_of(scene, velocity)


def _late(scene: Scene) -> float:
    """Return the time from an exposure until the legs are where that frame takes them [s]."""
    return scene.scenario.camera.latency + scene.scenario.actuators.delay


def _pixels_of(scene: Scene, shift: Array) -> float:
    """Return how far a shift (3,) in B moves the features at the start, in the largest coordinate."""
    return float(np.abs(scene.view(scene.start).jacobian[:, :3] @ shift).max())


def steady_filter(scene: Scene, gains: Tracking) -> SteadyFilter:
    """Return the law's filter before the goal, or of a direction at the start, after many frames.

    Parameters
    ----------
    scene
        Of the scenario.
    gains
        Of the law.
    """
    period = frame_period(scene.scenario)
    variance = gains.noise**2 * _variance_per_pixel(scene, gains)
    acceleration = scene.settings["controller.tracking.acceleration"][: len(variance)]
    of_modes, modes = np.linalg.eigh(variance / np.outer(acceleration, acceleration))
    reading = np.sqrt(of_modes)
    index = period**2 / reading
    left = (4.0 + index - np.sqrt(8.0 * index + index**2)) / 4.0
    alpha = 1.0 - left**2
    beta = 2.0 * (2.0 - alpha) - 4.0 * left
    return SteadyFilter(
        modes.T / acceleration,
        reading,
        np.sqrt(alpha) * reading,
        np.sqrt(beta * (alpha - beta / 2.0)) / left * reading / period,
    )


def _goal_view(scene: Scene) -> View:
    """Return the view from the goal, or from the start where there is no goal pose."""
    goals = find_goals(scene)
    return scene.view(scene.start) if goals is None else goals.best.view


def _variance_per_pixel(scene: Scene, gains: Tracking) -> Array:
    """Return the variance that the filter assumes of what is followed, with a `noise` of 1 px.

    Of a pose (6, 6) or a place (3, 3) in B; a point of weight w is taken for one with 1/w of the variance.
    """
    if gains.follow == "pose":
        view = _goal_view(scene)
        jacobian = scene.root_weights * scene.of_pixels(view.features, view.jacobian)
        return np.asarray(np.linalg.inv(jacobian.T @ jacobian))
    view = scene.view(scene.start)
    share = float(np.linalg.norm(scene.shares))
    return np.asarray((share * view.mean_depth / scene.settings.camera.focal_pixels) ** 2 * np.eye(3))
