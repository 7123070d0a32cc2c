"""Scenarios without faults, from the schema: good devices, and ordinary settings of the law.

They do not come from the list of causes: whatever a block of devices holds is at its default there, or within what is
ordinary, whether a cause of the list is about it or not.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hexservo import _core
from hexservo.findings.diagnosis.gains import default_gains, slower
from hexservo.findings.diagnosis.model import Alone, Case, Cause, Changes, Removal, in_scenario
from hexservo.findings.diagnosis.size import device_size
from hexservo.scenario.keys import default_of, keys_below, value_at
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.scenario import Scenario

BASE_MOTIONS = ("base_motion.kind", "base_motion.rotation.kind")
DEVICE_BLOCKS = ("camera", "sensors", "actuators", "base_motion", "uncertainty")
FINE_STEP = 1.0e-3  # [s], of an ordinary servo period or integration
OPTICS = frozenset(
    {
        "camera.focal_length",
        "camera.pixel_scale",
        "camera.focal_pixels",
        "camera.principal_point",
        "camera.axes",
        "camera.distortion.brown_conrady",
        "camera.distortion.kannala_brandt",
        "camera.mount.on",
        "camera.mount.position",
        "camera.mount.rotation",
    }
)
"""Keys of what the camera is and where it stands."""
_OF_THE_TASK = OPTICS | {"camera.convention"}

ORDINARY: dict[str, float] = {
    "camera.noise": 0.5,  # [px]
    "camera.quantisation": 0.5,  # [px]
    "camera.dropout": 0.1,
    "sensors.noise": 5e-7,  # [m], of `micro`
    "sensors.resolution": 5e-7,  # [m], of `micro`
    "actuators.delay": 1e-3,  # [s]
    "actuators.quantisation": 1e-3,  # [N], of `micro`
    "uncertainty.gravity": 1e-3,
    "uncertainty.inertia": 0.1,
    "uncertainty.coriolis": 0.15,
}
"""What ordinary devices have, and a scenario without faults too: no more than that is a cause (`ordinary_devices`)."""
_ORDINARY_BASE = 0.05  # [m/s^2], of `micro`: amplitude of a sinusoidal motion of the base
ORDINARY_DEPTH = 0.3  # mean error of the depths: a loop that bears no 30 % of its gains has another cause
ORDINARY_WEIGHT = 0.02  # error of the weight, before a law that holds more than 0.001 of it
"""Motions and errors of at most these are no causes, though a scenario without faults has none of them."""
# laws without pose or rate loop: they hold a weight by image errors alone
IMAGE_ALONE = tuple(law for law, has in _core.LAW_TRAITS.items() if has.output == "wrench" and not has.prior)
ORDINARY_BANDWIDTH = 100.0  # [Hz], of the actuators, at least
_ROUNDING = 1e-9  # relative difference of equal numbers
_NEAR = 1.5  # factor between a gain and its default within which it is ordinary
_SAME_RATE = 2.0  # factor between the rates of two loops within which time does not part them
# how a machine is built, and no fault
_KEPT = frozenset({"sensors.pose", "sensors.rate", "actuators.hold", "actuators.kind"})


def ordinary_devices(scenario: Scenario) -> dict[str, float]:
    """Return what ordinary devices of the machine have at most, by dotted key: `ORDINARY`, for its size.

    Of rotary legs noise and resolution are what moves the cranks' ends as far [rad], and a torque for a force [N m].
    """
    size, arm = device_size(scenario), scenario.robot.cranks.length or 1.0
    scales = dict.fromkeys(("sensors.noise", "sensors.resolution"), size.scale("m").item() / arm)
    scales["actuators.quantisation"] = size.scale("N").item() * arm
    return {key: most * scales.get(key, 1.0) for key, most in ORDINARY.items()}


def ordinary_base(scenario: Scenario) -> float:
    """Return the amplitude up to which a sinusoidal motion of the base is ordinary for the machine [m/s^2]."""
    return _ORDINARY_BASE * device_size(scenario).scale("m/s^2").item()


def ideal(scenario: Scenario) -> dict[str, Any]:
    """Return the changes to devices without faults: a frame at every tick, and the rest no worse than ordinary."""
    changes: dict[str, Any] = {}
    usual_devices = ordinary_devices(scenario)
    for block in DEVICE_BLOCKS:
        for key in keys_below(block):
            value, wanted = value_at(scenario, key), default_of(key)
            if key in _OF_THE_TASK | _KEPT or (block == "base_motion" and key not in BASE_MOTIONS):  # its own act
                continue
            if key == "camera.period" and scenario.sampled:
                value, wanted = frame_period(scenario), scenario.simulation.step
            elif key in usual_devices:
                wanted = value if np.abs(value).max() <= usual_devices[key] else 0.0
            elif key == "actuators.bandwidth":
                wanted = value if value is None or value >= ORDINARY_BANDWIDTH else None
            elif key == "actuators.position.bandwidth" and scenario.actuators.takes_positions:
                wanted = max(value, ORDINARY_BANDWIDTH)
            if value != wanted:
                changes[key] = wanted
    if scenario.actuators.kind == "position_torque":  # which has no motor that is free of faults
        changes["actuators.kind"] = "position"
    if scenario.target.motion.kind != "none":
        changes["target.motion.kind"] = "none"
    if scenario.has_unknown_payload:
        changes["robot.payload.known"] = True
    usual = type(scenario.metrics)()
    if scenario.metrics.dwell > usual.dwell:
        changes["metrics.dwell"] = usual.dwell
    if scenario.metrics.band < usual.band:
        changes["metrics.band"] = usual.band
    changes |= default_brake(scenario)
    if scenario.controller.jacobian == "printed" and scenario.camera.convention == "eye_in_hand":
        changes["controller.jacobian"] = "consistent"
    return changes


def default_brake(scenario: Scenario) -> dict[str, None]:
    """Return the changes that give the brake, which acts without an image, its default gains."""
    return {key: None for key in keys_below("controller.safe") if value_at(scenario, key) is not None}


def ordinary(scenario: Scenario) -> dict[str, Any]:
    """Return the changes to ordinary settings of the same law: its defaults, and a fine step."""
    usual = default_gains(scenario)
    changes = {key: wanted for key, wanted in usual.items() if differs(value_at(scenario, key), wanted)}
    kind = "implicit" if scenario.sampled else "sign"
    switching = scenario.controller.switching
    if switching.kind not in (kind, "implicit_coupled"):
        changes["controller.switching.kind"] = kind
    width = type(switching)().width
    if switching.width != width:
        changes["controller.switching.width"] = width
    step = scenario.simulation.step
    if step > FINE_STEP:
        step /= math.ceil(step / FINE_STEP - 1e-9)
        changes["simulation.step"] = step
        if scenario.sampled:
            changes["camera.period"] = step
    return changes


def differs(own: Any, wanted: Any) -> bool:
    """Return whether two values differ, numbers by more than rounding."""
    if _numeric(own) and _numeric(wanted):
        return not np.allclose(own, wanted, rtol=_ROUNDING, atol=0.0)
    return bool(own != wanted)


def unusual(scenario: Scenario) -> frozenset[str]:
    """Return the keys whose values are neither those of good devices nor near the ordinary settings of the law."""
    found = set(ideal(scenario))
    for key, wanted in ordinary(scenario).items():
        own = value_at(scenario, key)
        if _numeric(own) and _numeric(wanted):
            one, other = np.asarray(own, dtype=float), np.asarray(wanted, dtype=float)
            low, high = np.minimum(one, other), np.maximum(one, other)
            if (high <= _NEAR * low).all():
                continue
        found.add(key)
    return frozenset(found)


def _numeric(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "fi"


def alone_pairs(cause: Cause, case: Case, removal: Removal) -> list[Alone]:
    """Return the pairs of scenarios that show whether a cause alone makes a run fail."""
    if cause.alone is not None:
        return cause.alone(case)
    scenario = case.scenario
    without = ideal(scenario)
    if cause.kind == "task":
        usual, own = (less(changes, cause.keys) for changes in ({**without, **ordinary(scenario)}, without))
        return [
            Alone({**usual, **removal.changes}, usual, removal.stroke_counts),
            # default gains that fail without the cause too prove nothing about it, as it is no setting of the law
            Alone({**own, **removal.changes}, own, removal.stroke_counts, otherwise=True),
        ]
    if cause.kind == "law":
        without |= ordinary(scenario)
    without = less(without, in_scenario(cause.context, scenario))
    return [Alone(without, less(without, in_scenario(cause.keys, scenario)))]


def alone_at_its_gains(case: Case, name: str, power: float) -> list[Alone]:
    """Return one setting of a law alone, relative to the law's stiffness: with other gains it has another effect.

    A loop that is faster as a whole has K_v by the square, and Psi by the inverse square, of what is ordinary for the
    machine's size. Where a loop with ordinary gains fails, it is tried at the rate of the scenario's own stiffness:
    default gains know no time, and are too slow for a run of some milliseconds.
    """
    scenario = case.scenario
    without = {**ideal(scenario), **ordinary(scenario)}
    law = scenario.controller.law
    stiffness = f"controller.{law}." + ("kt" if hasattr(scenario.controller.gains, "kt") else "kp")
    count = 6 if stiffness.endswith("kt") else 2 * scenario.target.count
    own = np.broadcast_to(np.asarray(value_at(scenario, stiffness), dtype=float), count)
    usual = np.broadcast_to(np.asarray(default_gains(scenario)[stiffness], dtype=float), count)
    ratio = float(np.exp(np.mean(np.log(np.maximum(own, 1e-12 * usual) / usual))))
    key = f"controller.{law}.{name}"
    value = np.asarray(value_at(scenario, key), dtype=float)
    pairs = [Alone(without, {**without, key: (value * ratio**power).tolist()})]
    rate = math.sqrt(ratio)
    if max(rate, 1.0 / rate) > _SAME_RATE:
        with contextlib.suppress(ValueError):  # of gains that the scenario refuses
            at_its_rate = {**without, **slower(scenario.updated(without), 1.0 / rate)}
            pairs.append(Alone(at_its_rate, {**at_its_rate, key: value.tolist()}, otherwise=True))
    return pairs


def faultless(scenario: Scenario) -> dict[str, Any]:
    """Return the changes to devices without faults and ordinary settings of the law, with the scenario's own task."""
    return less({**ideal(scenario), **ordinary(scenario)}, ("metrics.band", "metrics.dwell"))


def both_alone(first: Cause, second: Cause, case: Case, changed: Iterable[str] = ()) -> list[Changes]:
    """Return the changes to a scenario without faults, and then those to scenarios with two causes and no other fault.

    The first has ordinary settings of the law if a cause is one of them, and so has the second. A third has the other
    settings of the law as they are: what fails with ordinary ones alone does not fail in the scenario.

    Parameters
    ----------
    changed
        Keys that the removals change: a slower loop has less K_v too, and is another loop with the ordinary one.
    """
    scenario = case.scenario
    devices = ideal(scenario)
    own = in_scenario(first.keys | first.context | second.keys | second.context, scenario)
    own += [key for key in changed if key.startswith(f"controller.{scenario.controller.law}.")]
    if "law" not in (first.kind, second.kind):
        return [devices, less(devices, own)]
    usual = {**devices, **ordinary(scenario)}
    return [usual, less(usual, own), less(devices, own)]


def less(changes: Changes, keys: Iterable[str]) -> dict[str, Any]:
    """Return the changes without those of some keys, which keep the scenario's values."""
    kept = set(keys)
    return {key: value for key, value in changes.items() if key not in kept}


def known(changes: Mapping[str, Any]) -> str:
    """Return a hashable key, the same for equal changes."""
    return repr(sorted(changes.items()))
