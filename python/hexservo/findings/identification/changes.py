"""Keys of a scenario that a log gives: those of the six legs as one, and times in whole ticks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexservo.findings.evidence import Verdict
from hexservo.findings.identification.drives import MOST_DELAY, Drives
from hexservo.findings.identification.frames import SEEN, CameraFit
from hexservo.findings.identification.frames_outliers import NoOutliers
from hexservo.findings.identification.log import Log
from hexservo.findings.identification.motors import MotorFit
from hexservo.findings.identification.one_drive import LIMITS, limit_of, response_of
from hexservo.findings.part import Part
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import POSE_LAW
from hexservo.scenario.parameters import oldest_image
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.scenario import Scenario

_FEWEST_TICKS = {  # of the times that a scenario has in whole ticks
    "simulation.duration": 1,
    "camera.period": 1,
    "camera.latency": 0,
    "camera.latency_jitter": 0,
    "camera.timeout": 1,
    "uncertainty.latency": 0,
    "sensors.period": 1,
    "actuators.delay": 0,
}
_OF_DRIVES = ("actuators.delay", "actuators.position.bandwidth", "actuators.position.damping")
_SCATTER = ("camera.noise", "camera.quantisation")
_SLOWER = (200.0, 5000.0)  # times that drives are slower than those given, as by times in ms that are read as seconds
_LONG = 1000.0  # [s]: a log in ms of a second or more, read so; half a minute is plenty
_WHOLE = 1e-9  # of a tick, or of the time: what is not seen of a difference


@dataclass(frozen=True, eq=False, repr=False)
class Changes(Part):
    """Keys of the scenario by dotted name."""

    identified: Mapping[str, Any]
    rounded: Mapping[str, Any]  # times that the log does not give, in whole ticks of it
    given: Mapping[str, Any]  # what the scenario of the machine had
    verdicts: Mapping[str, Verdict]  # of the parts that the log was searched for, by title
    faults: Mapping[str, Any]  # keys that only a diagnosis of the log has
    times: Mapping[str, float]  # of `identified`, those of drives and camera before they were rounded [s]
    milliseconds: tuple[float, float, float] | None = None  # of `in_milliseconds`
    open: Sequence[str] = ()  # keys of the drives that the log was searched for, and does not determine


def ticks_of(log: Log, machine: Scenario) -> dict[str, Any]:
    """Return the keys of the loop that any log gives, whatever its fits do."""
    return {"simulation.mode": "sampled", "simulation.step": log.step_near(machine.simulation.step)}


def changes_of(
    log: Log, machine: Scenario, drives: Drives, camera: CameraFit | None, motors: MotorFit | None = None
) -> dict[str, Any]:
    """Return the keys that the log gives, by dotted name: none of a part whose model is not of the machine."""
    changes = ticks_of(log, machine)
    step = changes["simulation.step"]
    if drives.moved and drives.explains:
        changes |= {"actuators.kind": "position"} | _of_drives(drives, machine, step)
    if camera is not None and camera.explains:
        changes |= _of_camera(camera, machine, step)
    if motors is not None and motors.explains:
        changes |= motors.changes
        if motors.delay < MOST_DELAY:
            changes["actuators.delay"] = _whole(motors.delay * step, step)
    return changes


def in_milliseconds(machine: Scenario, drives: Drives) -> tuple[float, float, float] | None:
    """Return why the times of a log seem to be in ms: bandwidth found and given [Hz], and its length [s]; else None.

    A loop of 2 kHz or more has ticks in ms that are possible seconds, and a log of seconds is then one of an hour or
    so. Its drives are a thousand times slower than they are, as no machine's are beside its data sheet: between 200
    and 5000 times, since the given ones may be wrong as well.
    """
    response = response_of(drives) if drives.moved and drives.explains else None
    length, given = drives.fitted + drives.apart, machine.actuators.position.bandwidth
    if response is None or machine.actuators.kind != "position" or length < _LONG:
        return None
    least, most = _SLOWER
    return (response.bandwidth, given, length) if least <= given / response.bandwidth <= most else None


def of_law(machine: Scenario, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the noise that the law of a machine assumes, with rounding, where it assumes one and the log gives it.

    With less than the camera has, its filter takes noise for a target that is somewhere else.
    """
    if machine.controller.law != POSE_LAW or "camera.noise" not in changes:
        return {}
    camera = machine.updated({key: changes[key] for key in _SCATTER if key in changes}).camera
    noise = feature_noise(camera)
    return {"controller.tracking.noise": _digits(noise)} if noise > 0.0 else {}


def faults_of(scenario: Scenario, drives: Drives, camera: CameraFit | None) -> dict[str, Any]:
    """Return the key of exposure times that are wrong by more than half a tick, as the logged machine has them.

    It is no key of the identified scenario, whose exported controller would assume that error. None of a machine whose
    latency is not known (`camera.latency_known: false`): its controller uses no exposure times. None of a log whose
    joints do not follow the commands either: the images may be of other joints.
    """
    if not scenario.camera.latency_known or not drives.explains:
        return {}
    if camera is None or not camera.explains or camera.stamps is None or not camera.stamps_are_wrong:
        return {}
    # no frame is stamped after its arrival
    error = max(_whole(-camera.stamps.value, scenario.simulation.step), -scenario.camera.latency)
    return {} if error == 0.0 else {"uncertainty.latency": error}


def in_whole_ticks(machine: Scenario, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the times of a machine that the log does not give and that are no whole ticks of it, as such.

    Parameters
    ----------
    machine
        That was given.
    changes
        Keys that the log gives, with `simulation.step`.
    """
    step, rounded = changes["simulation.step"], {}
    for key, fewest in _FEWEST_TICKS.items():
        given = value_at(machine, key)
        if key in changes or given is None:
            continue
        ticks = np.copysign(max(round(abs(given) / step), fewest), given)
        if key == "actuators.delay":
            ticks = min(ticks, MOST_DELAY)
        if abs(given - ticks * step) > _WHOLE * max(step, abs(given)):
            rounded[key] = _whole(float(ticks) * step, step)
    return rounded


def raised_timeout(
    machine: Scenario, changes: Mapping[str, Any], faults: Callable[[Scenario], Mapping[str, Any]]
) -> dict[str, Any]:
    """Return the `camera.timeout` that lets the frames of a log arrive, where that of the machine is shorter.

    Parameters
    ----------
    machine
        That was given.
    changes
        Keys that the log gives.
    faults
        Of the scenario with these: as the log has the machine, with wrong times of exposure.
    """
    if machine.camera.timeout is None:
        return {}
    known = {**changes, **in_whole_ticks(machine, changes)}
    ticks = round(machine.camera.timeout / known["simulation.step"])
    scenario = machine.updated(known | {"camera.timeout": None})
    oldest = oldest_image(scenario.updated(faults(scenario)))
    step = scenario.simulation.step
    return {"camera.timeout": _whole(oldest * step, step)} if oldest > ticks else {}


def _of_drives(drives: Drives, machine: Scenario, step: float) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    delay = drives.whole_delay
    if delay < MOST_DELAY:  # at which the true one may be longer
        changes["actuators.delay"] = _whole(delay * step, step)
    if (response := response_of(drives)) is not None:
        changes |= {"actuators.position.bandwidth": _digits(response.bandwidth)}
        changes |= {"actuators.position.damping": _digits(response.damping)}
    for name in LIMITS:
        key, limit = f"actuators.position.{name}", limit_of(drives, name)
        if limit.value is not None:
            changes[key] = _digits(limit.value)
        elif limit.is_none(value_at(machine, key)):
            changes[key] = None
    return changes


def _of_camera(camera: CameraFit, machine: Scenario, step: float) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    # at an edge, and where it is correlated, motion that the model lacks is a part of the noise
    if camera.noise is not None and not camera.at_edge and camera.noise_is_white and camera.noise_is_of_camera:
        changes |= {"camera.noise": _digits(camera.noise.value)}
    if camera.of_rounding > SEEN or machine.camera.quantisation > 0.0:
        changes |= {"camera.quantisation": _digits(camera.rounding)}
    for key, value in times_of_camera(camera, machine).items():
        changes[key] = max(_FEWEST_TICKS[key] * step, _whole(value, step))
    if camera.dropout is not None:
        changes |= {"camera.dropout": _digits(camera.dropout.value)}
    if isinstance(camera.outliers, NoOutliers):
        if camera.outliers.exclude(machine.camera.outlier_probability, machine.camera.outlier_size):
            changes |= {"camera.outlier_probability": 0.0}
    elif camera.outliers is not None and camera.outliers.are_known:
        changes |= {"camera.outlier_probability": _digits(camera.outliers.probability.value)}
        changes |= {"camera.outlier_size": _digits(camera.outliers.size.value)}
    return changes


def open_keys(drives: Drives, changes: Mapping[str, Any]) -> list[str]:
    """Return the keys of drives that moved which are not among those that the log gives."""
    return [key for key in _OF_DRIVES if key not in changes] if drives.moved and drives.explains else []


def times_of_drives(drives: Drives, changes: Mapping[str, Any]) -> dict[str, float]:
    """Return the delay [s] before it was rounded to whole ticks, by dotted key; nothing where the log gives no key."""
    return {"actuators.delay": drives.delay * drives.period} if "actuators.delay" in changes and drives.taken else {}


def times_of_camera(camera: CameraFit, machine: Scenario) -> dict[str, float]:
    """Return the times [s] that a log gives of its camera, by dotted key, before they are rounded to whole ticks."""
    times = {} if camera.period is None else {"camera.period": camera.period.value}
    if camera.latency is not None and camera.latency_is_known:
        jitter = camera.jitter or 0.0 if camera.jitter_is_known else machine.camera.latency_jitter
        jitter = min(jitter, 2 * max(camera.latency.value, 0.0))  # of which no frame comes too early
        times["camera.latency"] = camera.latency.value - jitter / 2
        if camera.jitter_is_known:
            times["camera.latency_jitter"] = jitter
    return times


def _whole(value: float, step: float) -> float:
    """Return the nearest whole number of servo periods, as scenarios have all times of a camera.

    It has more digits than a step has, since the core refuses a time that is off by 1e-9 of itself.
    """
    return float(f"{round(value / step) * step:.12g}")


def _digits(value: float) -> float:
    return float(f"{value:.6g}")
