"""Signatures of causes in the recorded signals of a run, each with its strength and a sentence."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.conditioning import frames_noise
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.diagnosis.criterion import Judgement, Record
from hexservo.findings.diagnosis.goal import pixels_per_metre, seen_from_home
from hexservo.findings.diagnosis.model import Case
from hexservo.findings.gate_width import noise_at_gate, rejected_share, rejects
from hexservo.run.leg_limits import LimitUse, limits_of_motion, most_used
from hexservo.scenario.arrays import Array
from hexservo.scenario.leg_units import leg_units, stroke_length
from hexservo.scenario.parameters import frame_period, lost_frames_wait
from hexservo.scenario.pixels import desired_features, points_outside
from hexservo.scenario.wording import number, quantity

_TAIL = 0.25  # the last part of a run, in which it rests or does not
_DECREASES = 0.98  # of the error at the start: what lies below is no noise of it
_GROWS = 0.5  # of the error at the start, by which it rises where the sign is surely wrong
_AT_REST = 0.02  # of the stroke, that the legs may move in it
_AT_LIMIT = 0.999  # of the force limit
_LARGEST = sys.float_info.max / 8.0  # six of them have a finite length, and twice that
_NO_ERROR = 1e-12  # of the weight (N for 1 N, N m for 1 N): rounding
_ALONG = 0.5  # of an error of the weight, from which part along it on it is too large or too small
_WANDER = 0.1  # of the stroke, by which one standard deviation of noise moves the pose that follows from the image


@dataclass(frozen=True)
class Signature:
    """How well the recorded signals of a run fit a cause."""

    strength: float | None  # 0 (not at all) to 1; None: this cause has no signature
    sentence: str  # the evidence with its numbers; may be empty


def _wrong_sign(case: Case, record: Record, judgement: Judgement) -> Signature:
    start, at = record.error[0], int(np.argmin(record.error))
    if start <= 0.0:
        return Signature(0.0, "The error at the start is 0: what drives it away is not the sign.")
    if record.error[at] < _DECREASES * start:
        return Signature(
            0.0,
            f"The error decreases, from {number(start)} px at the start to {number(record.error[at])} px at "
            f"t = {number(record.time[at])} s; with the wrong sign it would not.",
        )
    rise = record.metrics["peak_error"] / start - 1.0
    if rise < _GROWS:
        by = f"rises by only {rise:.0%}" if rise >= 0.005 else "does not rise either"  # a law that does not move
        return Signature(
            max(rise, 0.0) / _GROWS, f"The error never decreases, but {by}: it is {number(start)} px at the start."
        )
    return Signature(
        1.0,
        f"The error never decreases: {number(start)} px at the start, {number(record.metrics['peak_error'])} px at "
        f"t = {number(record.end_time)} s.",
    )


def _at_effort_limit(case: Case, record: Record, judgement: Judgement) -> Signature:
    limit = case.scenario.robot.force_limit
    share = float((np.abs(record.samples["leg_forces"]).max(axis=1) >= _AT_LIMIT * limit).mean())
    units = leg_units(case.scenario.robot)
    limited = f"{units.effort_name} limit of {number(limit, 4)} {units.effort}"
    if share:
        sentence = f"A leg is at its {limited} in {number(1e2 * share, 2)}% of the samples."
    elif record.metrics["peak_leg_force"] >= _AT_LIMIT * limit:  # of all steps; the samples are some of them
        sentence = f"A leg reaches its {limited}, but in none of the {len(record.time)} samples."
    else:
        sentence = f"No leg reaches its {limited}."
    return Signature(min(1.0, share / 0.2), sentence)


def _lost_features(case: Case, record: Record, judgement: Judgement) -> Signature:
    camera = case.scenario.camera
    if record.outcome == "feature_lost":
        return Signature(1.0, f"A feature is lost at t = {number(record.stop_time)} s, which ends the run.")
    strength, sentences = 0.0, []
    if camera.image_size is not None:
        features = desired_features(case.scenario) - record.samples["feature_error"]
        outside = points_outside(case.scenario, features).any(axis=1)
        share = float(outside.mean())
        strength = min(1.0, share / 0.2)
        sentences.append(f"A feature is outside of the image for {share:.0%} of the time.")
    if camera.dropout:
        strength = max(strength, min(1.0, 2.0 * camera.dropout))
        period = frame_period(case.scenario)
        if camera.dropout < 1.0:
            gap = number(period / (1.0 - camera.dropout))
            sentences.append(f"Frames arrive every {gap} s on average, instead of every {number(period)} s.")
        else:
            sentences.append(f"No frame arrives, instead of one every {number(period)} s.")
    return Signature(strength, " ".join(sentences))


def _gate(case: Case, record: Record, judgement: Judgement) -> Signature:
    """By the noise alone: no sample has what the gate rejects."""
    gate, noise = case.scenario.camera.gate, noise_at_gate(case.scenario)
    if gate is None:
        return Signature(0.0, "")
    return Signature(rejected_share(gate, noise), f"The gate of {number(gate)} px {rejects(gate, noise)}.")


def _gravity(case: Case, record: Record, judgement: Judgement) -> Signature:
    scene = scene_of(case.scenario)
    fed = np.array(scene.body.weight(scene.start.quaternion))  # what holds the platform points up
    acting = scene.true_weight(scene.start)
    largest = float(np.abs(fed[:3]).max())
    if largest == 0.0:
        return Signature(0.0, "There is no gravity.")
    up = fed[:3] / largest  # first, so that the square of no weight overflows
    up /= np.linalg.norm(up)
    moved = record.samples["position"] - record.samples["position"][0]
    height = moved @ up
    rise = height[np.argmax(np.abs(height))]
    share = float(abs(rise)) / max(float(np.linalg.norm(moved, axis=1).max()), 1e-12)
    error = fed / largest - acting / largest
    force, moment = math.hypot(*error[:3]), math.hypot(*error[3:])
    along = float(error[:3] @ up)
    sizes = [quantity(size * largest, unit) for size, unit in ((force, "N"), (moment, "N m")) if size > _NO_ERROR]
    if not sizes:
        return Signature(0.2, "")
    sentence = f"The weight fed forward differs from the one that acts by {' and '.join(sizes)}"
    if rise * along <= 0.0:
        return Signature(0.2, f"{sentence}.")
    if abs(along) > _ALONG * force:
        sentence += (
            f"; it is too {'large' if along > 0.0 else 'small'}, and the platform "
            f"{'rises' if rise > 0.0 else 'sinks'} by up to {number(abs(rise) * 1e3)} mm"
        )
    return Signature(min(1.0, 1.5 * share), f"{sentence}.")


def _unequal_depth(case: Case, record: Record, judgement: Judgement) -> Signature:
    if judgement.early or judgement.error > 2.0 or judgement.legs <= 1.0:
        return Signature(0.3, "")
    return Signature(
        1.0,
        f"The image is within {number(2.0 * case.scenario.metrics.band)} px at the end while the platform moves by "
        f"{number(record.metrics['peak_displacement'] * 1e3)} mm; its fastest leg still moves at "
        f"{number(record.drift * 1e3, 2)} {leg_units(case.scenario.robot).small}/s.",
    )


def _newtons(wrench: Array, radius: float) -> float:
    """Return the length of a wrench with moments divided by the radius; finite, also where a number overflows."""
    with np.errstate(over="ignore"):
        parts = wrench / np.repeat([1.0, radius], 3)
    return math.hypot(*np.clip(parts, -_LARGEST, _LARGEST))


def _spring(case: Case, record: Record, judgement: Judgement) -> Signature:
    law = case.scenario.controller.law
    if not _core.LAW_TRAITS[law].memory:
        return Signature(0.0, "")
    radius = scene_of(case.scenario).platform_radius
    held = _newtons(record.samples["fuzzy_output"][-1], radius)
    friction = _newtons(np.broadcast_to(case.scenario.controller.gains.kv, 6), radius)
    sentence = (
        f"At the end the output of the fuzzy systems is {number(held)} N, and K_v is {friction:.3g} N (moments by the "
        "radius)."
    )
    return Signature(min(1.0, held / (2.0 * friction)) if friction else 1.0, sentence)


def _stiction(case: Case, record: Record, judgement: Judgement) -> Signature:
    last = record.time >= (1.0 - _TAIL) * record.end_time
    unit = leg_units(case.scenario.robot).coordinate
    travel = float(np.ptp(record.samples["leg_lengths"][last], axis=0).max())
    if judgement.early or judgement.error <= 1.0:
        return Signature(0.0, "")
    if travel > _AT_REST * case.scenario.robot.stroke:
        return Signature(
            0.0, f"The platform does not rest: its legs move {number(travel * 1e3, 2)} m{unit} in the last quarter."
        )
    return Signature(
        1.0,
        f"The platform rests with {number(judgement.error * case.scenario.metrics.band)} px left: its legs move "
        f"{travel * 1e6:.2g} u{unit} in the last quarter.",
    )


def _late_camera(case: Case, record: Record, judgement: Judgement) -> Signature:
    camera = case.scenario.camera
    error = record.samples["feature_error"]
    largest = error[:, int(np.argmax(np.abs(error).max(axis=0)))]
    swings = int((np.diff(np.sign(largest[np.abs(largest) > case.scenario.metrics.band])) != 0).sum())
    age = camera.latency + camera.latency_jitter + frame_period(case.scenario)
    wait = lost_frames_wait(case.scenario)
    lost = f", and by lost frames {quantity(wait, 's')} older on average" if wait > 0.0 else ""
    sentence = (
        f"The error crosses zero {swings} times; images in use are up to {number(age * 1e3)} ms old{lost}, with a "
        f"servo period of {number(case.scenario.simulation.step * 1e3)} ms."
    )
    return Signature(min(1.0, swings / 3.0), sentence)


def _poor_image(case: Case, record: Record, judgement: Judgement) -> Signature:
    worst = pixels_per_metre(*seen_from_home(case.scenario))
    noise = frames_noise(case.scenario)
    wander = noise / worst
    sentence = f"In the least observable direction 1 px is {number(1e3 / worst)} mm at the target's distance"
    if noise:
        what = (
            "the noise of {} px is" if case.scenario.camera.quantisation == 0.0 else "noise and rounding of {} px are"
        )
        sentence += f", and {what.format(number(noise))} {number(wander * 1e3)} mm."
    else:
        sentence += "; there is no noise."
    return Signature(min(1.0, wander / (_WANDER * stroke_length(case.scenario.robot))), sentence)


def _leg_limits(case: Case, record: Record, judgement: Judgement) -> Signature:
    if case.obstacle is not None and case.obstacle.kind == "start":
        return Signature(1.0, f"At the start {case.obstacle.beyond}.")
    uses = [LimitUse(limit, record.metrics[limit.metric]) for limit in limits_of_motion(case.scenario)]
    exceeded = [use for use in uses if use.share > 1.0]
    if record.outcome == "leg_limit":  # its last good sample is within
        exceeded = [most_used(case.scenario, record.metrics, record.stopped_by)]
    sentences = [f"The run {use.excess}." for use in exceeded]
    if case.goal is None:
        return Signature(None, " ".join(sentences))
    of_travel = not exceeded or any(use.limit.kind == "stroke" for use in exceeded)
    if of_travel or not case.goal.within:
        stroke, units = case.scenario.robot.stroke, leg_units(case.scenario.robot)
        sentences.append(
            f"At the goal a leg is {number(case.goal.leg_travel * 1e3)} {units.small} from the middle of its travel; "
            f"its stroke is {number(stroke * 1e3)} {units.small}."
        )
        if case.goal.leg_travel <= stroke and not case.goal.within:
            sentences.append("A joint is beyond its limit there.")
    return Signature(0.0 if case.goal.within else 1.0, " ".join(sentences))


SIGNATURES: dict[str, Callable[[Case, Record, Judgement], Signature]] = {
    "wrong_sign": _wrong_sign,
    "saturation": _at_effort_limit,
    "motors": _at_effort_limit,
    "lost_features": _lost_features,
    "gate": _gate,
    "gravity": _gravity,
    "unequal_depth": _unequal_depth,
    "spring": _spring,
    "stiction": _stiction,
    "late_camera": _late_camera,
    "poor_image": _poor_image,
    "leg_limits": _leg_limits,
}
"""By the causes' keys: of a run that failed, by which criteria."""


def signature_of(cause: str, case: Case, record: Record, judgement: Judgement) -> Signature:
    """Return the signature of a cause, by its key, in a run that failed."""
    return SIGNATURES[cause](case, record, judgement) if cause in SIGNATURES else Signature(None, "")


OF_THE_SCENARIO = frozenset({"gate", "poor_image", "leg_limits"})
"""Those that are the same whatever was recorded: they do not depend on what a controller did."""
