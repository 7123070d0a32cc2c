"""Causes in devices and in the controller's model, and how each is removed from a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.diagnosis.drives import DRIVES
from hexservo.findings.diagnosis.environment import BASE_MOTIONS, default_brake, ideal, less, ordinary
from hexservo.findings.diagnosis.model import (
    Alone,
    Case,
    Cause,
    Removal,
    always,
    fault,
    removal_by,
    removed_by,
)
from hexservo.findings.diagnosis.remedies import (
    gate_remedies,
    gravity_remedies,
    late_camera_remedies,
    lost_features_remedies,
    outliers_remedies,
    saturation_remedies,
    slower_remedies,
    unequal_depth_remedies,
    wider_gate,
)
from hexservo.findings.diagnosis.tracking import well_set
from hexservo.findings.gate_width import predicts
from hexservo.scenario.blocks import Payload
from hexservo.scenario.keys import keys_below, value_at
from hexservo.scenario.laws import laws_with
from hexservo.scenario.parameters import core_parameters, frame_period

_IMAGE = frozenset({"camera.period", "camera.latency", "camera.latency_jitter", "camera.prediction"})
_AT_GATE = frozenset(  # what a gate compares, and when that counts
    {
        *("camera.noise", "camera.quantisation", "camera.smoothing", "camera.timeout", "camera.on_lost"),
        *("target.motion.kind", "camera.dropout"),
    }
)
_DEPTH_DIGITS = 6  # of a mean depth error
_ENCODERS = frozenset({"sensors.pose", "sensors.rate", "sensors.period"})


def _base_at_rest(case: Case) -> list[Removal]:
    moving = [key for key in BASE_MOTIONS if case.sampled and value_at(case.scenario, key) != "none"]
    return removal_by("a base at rest", dict.fromkeys(moving, "none"))


def _motion_alone(*kinds: str) -> Callable[[Case], list[Alone]]:
    """Try a law that follows targets well set too: a motion that only these settings do not follow is not the cause."""

    def alone(case: Case) -> list[Alone]:
        without = ideal(case.scenario)
        moving = less(without, kinds)
        usual = well_set(case)
        pairs = [Alone(without, moving)]
        return [*pairs, Alone({**without, **usual}, {**moving, **usual})] if usual else pairs

    return alone


# ---- Camera ---------------------------------------------------------------------------------------------------------


def _sign(case: Case) -> list[Removal]:
    scenario = case.scenario
    if scenario.controller.jacobian != "printed" or scenario.camera.convention != "eye_in_hand":
        return []
    if scenario.controller.law not in laws_with("depth"):  # no image Jacobian, and so no sign of it
        return []
    return [Removal("the sign of the image Jacobian that the camera has", {"controller.jacobian": "consistent"})]


def _late_camera(case: Case) -> list[Removal]:
    camera, step, period = case.scenario.camera, case.scenario.simulation.step, frame_period(case.scenario)
    if not case.sampled or (period <= step and camera.latency == 0.0 and camera.latency_jitter == 0.0):
        return []
    changes: dict[str, Any] = {"camera.period": step, "camera.latency": 0.0, "camera.latency_jitter": 0.0}
    if case.scenario.uncertainty.latency < 0.0:  # none below 0 can be assumed
        changes["uncertainty.latency"] = 0.0
    words = "a frame at every servo tick, without latency"
    if camera.dropout and period > step:  # many frames would make up for lost ones: the same wait for lost ones
        wait = camera.dropout / (1.0 - camera.dropout) * period / step if camera.dropout < 1.0 else math.inf
        changes["camera.dropout"] = wait / (1.0 + wait) if math.isfinite(wait) else 1.0
        words += ", with as long a mean wait for lost frames"
    return [Removal(words, changes)]


def _lost_features(case: Case) -> list[Removal]:
    none_lost = {"camera.image_size": None, "camera.dropout": 0.0}
    changes = {key: none for key, none in none_lost.items() if case.sampled and value_at(case.scenario, key) != none}
    return removal_by("an image without border, and no lost frames", changes)


def _gate(case: Case) -> list[Removal]:
    if not case.sampled or case.scenario.camera.gate is None or not predicts(case.scenario):
        return []
    none = Removal("no gate around the expected place of each point", {"camera.gate": None})
    return [none, *wider_gate(case)]  # which still keeps out outliers


def _brake(case: Case) -> list[Removal]:
    return removal_by("the default gains of the brake", default_brake(case.scenario) if case.sampled else {})


def _adds_outliers(case: Case) -> bool:
    return case.sampled and case.scenario.camera.outlier_size != 0.0


# ---- Encoders -------------------------------------------------------------------------------------------------------


def _with_encoders(case: Case) -> bool:
    return case.sampled and case.scenario.sensors.pose == "encoders"


def _encoder_period(case: Case) -> list[Removal]:
    period, step = case.scenario.sensors.period, case.scenario.simulation.step
    if not _with_encoders(case) or period is None or period <= step * (1.0 + 1e-9):
        return []
    return [Removal("encoders that are read at every servo tick", {"sensors.period": None})]


def _encoders(case: Case) -> list[Removal]:
    if not _with_encoders(case):
        return []
    exact = [Removal("pose and twist known exactly", {"sensors.pose": True})]
    if case.scenario.sensors.rate is True:
        return exact
    return [Removal("rates of the legs from a separate sensor", {"sensors.rate": True}), *exact]


# ---- What the controller assumes -----------------------------------------------------------------------------------


def _gravity(case: Case) -> list[Removal]:
    weight = np.array(core_parameters(case.scenario).body.weight(scene_of(case.scenario).home.quaternion))
    changes: dict[str, Any] = {}
    if np.any(np.broadcast_to(case.scenario.uncertainty.gravity, 6) * weight):
        changes["uncertainty.gravity"] = 0.0
    if case.scenario.has_unknown_payload:
        changes["robot.payload.known"] = True
    words = "an exact estimate of the weight"
    return removal_by(words if len(changes) == 1 else f"{words}, with the payload", changes)


def _gravity_alone(case: Case) -> list[Alone]:
    """Try an ordinary law too: a weight that only these settings do not hold is not the cause."""
    without = {**ideal(case.scenario), "uncertainty.gravity": 0.0}
    error = value_at(case.scenario, "uncertainty.gravity")
    wrong = {**without, "uncertainty.gravity": list(error) if isinstance(error, tuple) else error}
    if case.scenario.has_unknown_payload:
        wrong["robot.payload.known"] = False
    usual = ordinary(case.scenario)
    return [Alone(without, wrong), Alone({**without, **usual}, {**wrong, **usual})]


_CALIBRATION: dict[str, Any] = {
    "uncertainty.mount.position": [0.0] * 3,
    "uncertainty.mount.rotation": [0.0] * 3,
    "uncertainty.focal_length": 0.0,
    "uncertainty.principal_point": [0.0] * 2,
}


def _calibration(case: Case) -> list[Removal]:
    changes = {key: exact for key, exact in _CALIBRATION.items() if np.any(value_at(case.scenario, key))}
    return removal_by("an exact calibration of the camera", changes)


def _mean_depth_error(case: Case) -> float:
    """Return the mean of the depth errors, without what is only rounding of their sum."""
    return round(float(np.mean(case.scenario.uncertainty.depth)), _DEPTH_DIGITS) + 0.0  # not -0


def _unequal_depth(case: Case) -> list[Removal]:
    errors = np.asarray(case.scenario.uncertainty.depth, dtype=float)
    if errors.ndim == 0 or not np.ptp(errors):
        return []
    mean = _mean_depth_error(case)
    return [Removal(f"the same depth error of {mean:.3g} for all points", {"uncertainty.depth": mean})]


def _unequal_depth_alone(case: Case) -> list[Alone]:
    without = ideal(case.scenario)
    errors = np.asarray(case.scenario.uncertainty.depth, dtype=float)
    mean = {**without, "uncertainty.depth": _mean_depth_error(case)}
    return [Alone(mean, {**without, "uncertainty.depth": errors.tolist()})]


def _common_depth(case: Case) -> list[Removal]:
    errors = np.asarray(case.scenario.uncertainty.depth, dtype=float)
    mean = _mean_depth_error(case)
    if mean == 0.0:
        return []
    rest = 0.0 if errors.ndim == 0 else (np.round(errors - mean, _DEPTH_DIGITS) + 0.0).tolist()
    return [Removal("depths whose errors have the mean zero", {"uncertainty.depth": rest})]


def _common_depth_alone(case: Case) -> list[Alone]:
    without = ideal(case.scenario)
    return [Alone({**without, "uncertainty.depth": 0.0}, {**without, "uncertainty.depth": _mean_depth_error(case)})]


# ---- The list -------------------------------------------------------------------------------------------------------

DEVICES: tuple[Cause, ...] = (
    Cause("wrong_sign", "the sign of the image Jacobian", frozenset({"controller.jacobian"}), _sign),
    Cause(
        "saturation",
        "saturation of the actuators",
        frozenset({"actuators.saturation", "robot.force_limit"}),
        removed_by("actuators.saturation", False, "legs without a force limit"),
        saturation_remedies,
    ),
    Cause(
        "image_timeout",
        "images that time out",
        *fault("camera.timeout", None, "images without an age limit"),
        context=_IMAGE | {"camera.dropout", "camera.image_size", "camera.on_lost"},
    ),
    Cause(
        "brake",
        "gains of the brake that acts without an image",
        frozenset({"controller.safe.damping", "controller.safe.hold"}),
        _brake,
        context=_IMAGE | {"camera.timeout", "camera.dropout", "camera.image_size", "camera.on_lost"},
    ),
    Cause(
        "lost_features",
        "lost features",
        frozenset({"camera.dropout", "camera.image_size", "camera.on_lost"}),
        _lost_features,
        lost_features_remedies,
        context=_IMAGE,
    ),
    Cause(
        "gate",
        "a gate of the camera that is too narrow",
        frozenset({"camera.gate"}),
        _gate,
        gate_remedies,
        context=_IMAGE | _AT_GATE,
    ),
    Cause(
        "outliers",
        "outliers among the features",
        frozenset({"camera.outlier_probability", "camera.outlier_size"}),
        removed_by("camera.outlier_probability", 0.0, "features without outliers", of=_adds_outliers),
        outliers_remedies,
        context=_IMAGE,
    ),
    Cause(
        "pixel_noise", "noise of the features", *fault("camera.noise", 0.0, "features without noise"), context=_IMAGE
    ),
    Cause(
        "pixel_quantisation",
        "features that are rounded",
        *fault("camera.quantisation", 0.0, "features that are not rounded"),
        context=_IMAGE,
    ),
    Cause(
        "image_smoothing",
        "image coordinates that are smoothed while the camera moves",
        *fault("camera.smoothing", 0.0, "image coordinates that are not smoothed"),
        slower_remedies,
        context=_IMAGE,
    ),
    Cause(
        "latency_error",
        "a latency that is assumed wrong",
        *fault("uncertainty.latency", 0.0, "the latency that the camera has"),
        context=_IMAGE,
    ),
    Cause(
        "encoder_noise",
        "noise of the encoders",
        *fault("sensors.noise", 0.0, "encoders without noise", of=_with_encoders),
        slower_remedies,
        context=_ENCODERS,
    ),
    Cause(
        "encoder_resolution",
        "resolution of the encoders",
        *fault("sensors.resolution", 0.0, "encoders with exact resolution", of=_with_encoders),
        slower_remedies,
        context=_ENCODERS,
    ),
    Cause(
        "encoder_period",
        "encoders that are read too seldom",
        frozenset({"sensors.period"}),
        _encoder_period,
        slower_remedies,
        context=_ENCODERS - {"sensors.period"},
    ),
    Cause("encoders", "pose and twist from leg lengths", frozenset({"sensors.pose", "sensors.rate"}), _encoders),
    Cause(
        "actuator_delay",
        "delay of the actuators",
        *fault("actuators.delay", 0.0, "actuators without delay"),
        slower_remedies,
    ),
    Cause(
        "actuator_lag",
        "lag of the actuators",
        *fault("actuators.bandwidth", None, "actuators without lag"),
        slower_remedies,
    ),
    *DRIVES,
    Cause(
        "actuator_quantisation",
        "leg forces that are rounded",
        *fault("actuators.quantisation", 0.0, "leg forces that are not rounded"),
    ),
    Cause(
        "actuator_hold",
        "leg forces that are held while the legs rotate",
        *fault("actuators.hold", "wrench", "a wrench that is held while the legs rotate"),
    ),
    Cause(
        "base_motion",
        "motion of the base",
        frozenset({*keys_below("base_motion"), "target.frame"}),
        _base_at_rest,
        alone=_motion_alone(*BASE_MOTIONS),
    ),
    Cause(
        "target_motion",
        "motion of the target",
        frozenset({*keys_below("target.motion")}),
        removed_by("target.motion.kind", "none", "a target at rest"),
        alone=_motion_alone("target.motion.kind"),
    ),
    Cause(
        "gravity",
        "a wrong weight",
        frozenset({"uncertainty.gravity", *(f"robot.payload.{name}" for name in Payload.model_fields)}),
        _gravity,
        gravity_remedies,
        alone=_gravity_alone,
    ),
    Cause(
        "inertia", "a wrong inertia", *fault("uncertainty.inertia", 0.0, "an exact estimate of the inertia", of=always)
    ),
    Cause(
        "coriolis",
        "wrong Coriolis terms",
        *fault("uncertainty.coriolis", 0.0, "an exact estimate of the Coriolis terms", of=always),
    ),
    Cause(
        "calibration",
        "a wrong calibration of the camera",
        frozenset({*_CALIBRATION}),
        _calibration,
    ),
    Cause(
        "unequal_depth",
        "unequal depth errors",
        frozenset({"uncertainty.depth"}),
        _unequal_depth,
        unequal_depth_remedies,
        alone=_unequal_depth_alone,
    ),
    Cause(
        "common_depth",
        "depths that are all too large or too small",
        frozenset({"uncertainty.depth"}),
        _common_depth,
        slower_remedies,
        alone=_common_depth_alone,
    ),
    Cause(
        "late_camera",
        "latency or rate of the camera",
        frozenset({"camera.period", "camera.latency", "camera.latency_jitter"}),
        _late_camera,
        late_camera_remedies,
        context=frozenset({"camera.prediction"}),
    ),
)
