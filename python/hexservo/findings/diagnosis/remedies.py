"""Remedies against a cause: changes of the machine or of its controller; each is simulated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_sag import both, fitted_integral, sag_of
from hexservo.findings.diagnosis.criterion import Record
from hexservo.findings.diagnosis.gains import slower
from hexservo.findings.diagnosis.goal import resized_image
from hexservo.findings.diagnosis.model import Case, Removal
from hexservo.findings.gate_width import least_gate
from hexservo.scenario.laws import laws_with
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.wording import quantity

_LONGER = 3.0  # a run is tried so many times as long
_ENOUGH = 2000  # steps that are tried in place of a few


def slower_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Slow down the loop or its adaptation, instead of a better device."""
    law = case.scenario.controller.law
    offered = [Removal(f"the loop {factor:g} times as slow", slower(case.scenario, factor)) for factor in (2.0, 4.0)]
    if law in laws_with("memory") and case.scenario.controller.gains.fuzzy.enabled:
        slowness = np.asarray(case.scenario.controller.gains.fuzzy.adaptation, dtype=float)
        key = f"controller.{law}.fuzzy.adaptation"
        offered.append(Removal("adaptation 10 times as slow", {key: (10.0 * slowness).tolist()}))
    return [*offered, removal]


def late_camera_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Predict features, or slow down the loop."""
    camera = case.scenario.camera
    if camera.convention == "eye_in_hand" and camera.prediction == "none":
        words = "prediction of the features from the joint sensors between frames"
        return [Removal(words, {"camera.prediction": "encoder"}), *slower_remedies(case, removal, record)]
    return slower_remedies(case, removal, record)


def longer_run(case: Case) -> Removal:
    """Run three times as long, and a few steps at least."""
    simulation = case.scenario.simulation
    longer = max(_LONGER * simulation.duration, _ENOUGH * simulation.step)
    longer = simulation.step * round(longer / simulation.step)
    return Removal(f"a run of {longer:g} s", {"simulation.duration": longer})


def leg_rates_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Slow down the loop, or give legs the time that they need, before their limits are removed."""
    *slower, last = slower_remedies(case, removal, record)
    return [*slower, longer_run(case), last]


def gravity_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Correct the mass, or use a law that integrates."""
    robot, model = case.scenario.robot, case.scenario.uncertainty
    remedies = []
    if case.scenario.has_unknown_payload:
        remedies.append(Removal("the payload in the model of the controller", {"robot.payload.known": True}))
    if (
        model.gravity
        and robot.payload.mass == 0.0  # the errors act on platform and payload together, of which this is one
        and isinstance(model.gravity, float)
        and isinstance(model.inertia, float)
        and isinstance(model.coriolis, float)
    ):
        # The same plant, given to the controller: its terms are (1 - delta) times the estimated ones.
        share = 1.0 - model.gravity
        changes = {
            "robot.mass": share * robot.mass,
            "robot.inertia": (share * np.asarray(robot.inertia)).tolist(),
            "uncertainty.gravity": 0.0,
            "uncertainty.inertia": 1.0 - (1.0 - model.inertia) / share,
            "uncertainty.coriolis": 1.0 - (1.0 - model.coriolis) / share,
        }
        if all(-1.0 < changes[f"uncertainty.{name}"] < 1.0 for name in ("inertia", "coriolis")):
            remedies.append(Removal(f"the measured mass of {share * robot.mass:.4g} kg in the law", changes))
    return [*remedies, *_integrating_law(case, "which integrates a wrong weight"), removal]


def unequal_depth_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Use equal depth errors, or a law with a prior."""
    return [removal, *_integrating_law(case, "whose prior bounds the drift")]


def _integrating_law(case: Case, virtue: str) -> list[Removal]:
    """Use a law whose fuzzy systems integrate a pose error with a prior, unless it is one."""
    laws = laws_with("memory", "pose_error", "prior")
    if case.scenario.controller.law in laws:
        return []
    return [Removal(f"the law {law}, {virtue}", {"controller.law": law}) for law in laws]


def saturation_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Use stronger legs."""
    return [_stronger_legs(case, record.metrics["peak_leg_force"])]


def motor_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Correct the offset that the weight leaves, or use stronger motors.

    Stronger ones where they are too weak for the efforts of the run without the cause, and for friction.
    """
    stronger = _stronger_legs(case, record.metrics["peak_leg_force"] + case.scenario.actuators.motor.friction)
    weak = stronger.changes["robot.force_limit"] > case.scenario.robot.force_limit
    return [*integral_remedies(case), *([stronger] if weak else []), removal]


def integral_remedies(case: Case) -> list[Removal]:
    """Integrate away the offset of motors that rest outside the settling band by the weight that they carry."""
    scene = scene_of(case.scenario)
    sag = sag_of(scene)
    fitted = fitted_integral(scene, sag) if sag is not None and sag.certain > scene.band else None
    if fitted is None:
        return []
    integral, band = fitted
    head = f"controller.{case.scenario.controller.law}"
    words = f"an integral of {integral:g} 1/s whose band is {both(band)}"
    return [Removal(words, {f"{head}.integral": integral, f"{head}.band": band.tolist()})]


def _stronger_legs(case: Case, effort: float) -> Removal:
    """Return legs that give 1.1 times an effort [N], of cranks [N m]."""
    units = leg_units(case.scenario.robot)
    needed = rounded_up(1.1 * effort)
    return Removal(f"legs with a {units.effort_name} limit of {needed:g} {units.effort}", {"robot.force_limit": needed})


def lost_features_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Enlarge the image, or predict lost features."""
    remedies = []
    camera = case.scenario.camera
    if camera.image_size is not None:
        width = rounded_up(2.2 * record.metrics["peak_feature_distance"])
        size = np.maximum(camera.image_size, width)
        larger, moved = resized_image(case.scenario, size)
        if moved.any():  # the target stays where it is, at other pixels
            target = case.scenario.target
            pixels = {"desired_features": target.desired_features, "initial_features": target.initial_features}
            larger |= {
                f"target.{key}": (np.asarray(place) + moved).tolist()
                for key, place in pixels.items()
                if place is not None
            }
        if (size > camera.image_size).any():
            remedies.append(Removal(f"an image of {size[0]:.0f} x {size[1]:.0f} px", larger))
    if camera.convention == "eye_in_hand" and camera.prediction == "none":
        remedies.append(Removal("prediction of lost features from the joint sensors", {"camera.prediction": "encoder"}))
    return [*remedies, removal]


_GATE = 10.0  # of the noise, or the rounding, of a coordinate: far beyond what a right image differs by
_TIMEOUT = 10  # frame periods, beyond latency and jitter, after which what is expected of a point no longer counts
_LEAST_GATE = 2.0  # [px], for what depths and joint sensors carry along wrongly


def outliers_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Leave out points that are far from where the joint sensors expect them."""
    camera = case.scenario.camera
    if camera.gate is not None or (camera.prediction == "none" and camera.convention != "eye_in_hand"):
        return [removal]
    gate = rounded_up(max(_GATE * camera.noise, _GATE * camera.quantisation, _LEAST_GATE))
    changes: dict[str, Any] = {"camera.gate": gate}
    words = f"a gate of {gate:g} px around the expected place of each point"
    if camera.prediction == "none":
        changes["camera.prediction"] = "encoder"
        words += ", and prediction from the joint sensors"
    if camera.timeout is None:  # a point that has gone elsewhere is never found again without one
        step = case.scenario.simulation.step
        late = _TIMEOUT * frame_period(case.scenario) + camera.latency + camera.latency_jitter
        changes["camera.timeout"] = float(f"{math.ceil(late / step - 1e-9) * step:.9g}")
        words += f", and a timeout of {quantity(changes['camera.timeout'], 's')}"
    return [Removal(words, changes), removal]


def gate_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Widen the gate, before it is removed."""
    return [*wider_gate(case), removal]


def wider_gate(case: Case) -> list[Removal]:
    """Widen the gate until it rejects hardly any right point; [] where noise and motion are within it."""
    wide, gate = least_gate(scene_of(case.scenario)), case.scenario.camera.gate
    if gate is None or wide <= gate:  # something else takes points beyond it
        return []
    wide = rounded_up(max(wide, _LEAST_GATE))
    return [Removal(f"a gate of {wide:g} px", {"camera.gate": wide})]


def leg_limits_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Use legs with larger limits, of those that end or fail the run; commands that keep to their speed come first."""
    robot, peaks = case.scenario.robot, record.metrics
    unit = leg_units(robot).small
    changes: dict[str, Any] = {}
    words = []
    if peaks["peak_leg_excursion"] > robot.stroke:
        stroke = changes["robot.stroke"] = rounded_up(1.05 * peaks["peak_leg_excursion"])
        words.append(f"a stroke of {stroke * 1e3:.3g} {unit}")
    if robot.joint_limit is not None:
        tilts = [peaks["peak_base_joint"], peaks["peak_platform_joint"]]
        wider = [
            min(max(own, rounded_up(1.05 * tilt)), math.pi) for own, tilt in zip(robot.joint_limit, tilts, strict=True)
        ]
        if any(tilt > own for own, tilt in zip(robot.joint_limit, tilts, strict=True)):
            changes["robot.joint_limit"] = wider
            words.append(f"joint limits of {' and '.join(f'{tilt * 1e3:.3g}' for tilt in wider)} mrad")
    if robot.speed_limit is None or peaks["peak_leg_speed"] <= robot.speed_limit:
        return [Removal(f"legs with {' and '.join(words)}", changes)] if words else []
    speed = rounded_up(1.05 * peaks["peak_leg_speed"])
    faster = [*words, f"a speed limit of {speed * 1e3:.3g} {unit}/s"]
    remedies = [Removal(f"legs with {' and '.join(faster)}", {**changes, "robot.speed_limit": speed})]
    if case.sampled and case.scenario.actuators.kind != "force":
        slow = f"commands of at most {quantity(robot.speed_limit, leg_units(robot).rate)}"
        of_legs = f"legs with {' and '.join(words)}, and {slow}" if words else slow
        remedies.insert(0, Removal(of_legs, {**changes, "actuators.position.speed_limit": robot.speed_limit}))
    return remedies


def rounded_up(number: float) -> float:
    """Round up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(number)) - 1)
    return float(f"{math.ceil(number / unit) * unit:.6g}")
