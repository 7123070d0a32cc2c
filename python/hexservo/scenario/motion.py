"""Blocks of what moves: the base, and the target. docs/model.md section 7."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from hexservo.scenario.arrays import Array
from hexservo.scenario.block import NOT_NEGATIVE, Block, NumberNotNegative, PositiveNumber
from hexservo.scenario.core_defaults import from_core
from hexservo.scenario.recording import Recording, read_base_motion, read_target_motion
from hexservo.scenario.rules import (
    Angle,
    ArrayRule,
    Choice,
    File,
    Matrix,
    OptionalNumber,
    SamplePeriod,
    Samples,
    Vector,
    refusal,
)
from hexservo.scenario.yaml import ScenarioError

_ZERO = (0.0, 0.0, 0.0)


class BaseRotation(Block):
    """Rotation vector of B in W, axis by axis, where neither a recording nor a road has an attitude."""

    kind: Annotated[Literal["none", "sinusoid", "noise"], Choice()] = "none"  # what the rotation is
    amplitude: Annotated[Vector, ArrayRule((3,))] = _ZERO  # (3,) [rad], of the sinusoids
    # [Hz], of the sinusoids: one number for all axes or (3,)
    frequency: Annotated[float | Vector, ArrayRule((3,), NOT_NEGATIVE, or_number=True)] = 1.0
    phase: Annotated[float | Vector, ArrayRule((3,), Angle(), or_number=True)] = 0.0  # [rad], likewise, at t = 0
    # [rad^2/Hz], one-sided spectral density of the noise, one for all axes or (3,)
    level: Annotated[float | Vector, ArrayRule((3,), NOT_NEGATIVE, or_number=True)] = 0.0
    low_frequency: NumberNotNegative = from_core("base_motion.rotation.low_frequency")  # [Hz], where the noise begins
    high_frequency: PositiveNumber = from_core("base_motion.rotation.high_frequency")  # [Hz], where it ends


class Road(Block):
    """A vehicle on a rough road: heave, pitch and roll of its body. B's x axis points ahead, y to the right, z down."""

    roughness: Annotated[Literal["A", "B", "C", "D", "E", "F", "G", "H"], Choice()] = "A"  # class of ISO 8608
    speed: PositiveNumber = from_core("base_motion.road.speed")  # [m/s], of the vehicle
    wheelbase: PositiveNumber = from_core("base_motion.road.wheelbase")  # [m], between the axles
    track: PositiveNumber = from_core("base_motion.road.track")  # [m], between the wheels of an axle
    # [Hz], natural frequency of the body on its springs; null: rigid
    suspension: Annotated[float | None, OptionalNumber(above=0)] = from_core("base_motion.road.suspension")
    damping: PositiveNumber = from_core("base_motion.road.damping")  # [1], of the same, as a share of the critical one
    longest: PositiveNumber = from_core("base_motion.road.longest")  # [m], longest wavelength of the road
    shortest: PositiveNumber = from_core("base_motion.road.shortest")  # [m], shortest one
    position: Annotated[Vector, ArrayRule((3,))] = _ZERO  # (3,) [m], of B's origin from the middle of the wheels, in B


class BaseMotion(Block):
    """Motion of the base frame B in the inertial frame W, in `sampled` mode, which the controller does not measure.

    Only what the kinds need acts; docs/model.md section 7. A recording is given as a CSV file with the columns t, ax,
    ay, az [s, m/s^2] and, of a base that turns, an attitude or an angular rate (`read_base_motion`). It is read at
    once: a scenario holds the samples, kinematic accelerations along the axes of W, and its own ``file`` is null.
    """

    # of the acceleration of B's origin; a road, and a recording that has them, bring rotations too
    kind: Annotated[Literal["none", "sinusoid", "recorded", "noise", "road"], Choice()] = "none"
    amplitude: Annotated[Vector, ArrayRule((3,))] = _ZERO  # (3,) [m/s^2], of the sinusoid, in W
    frequency: NumberNotNegative = from_core("base_motion.frequency")  # [Hz], of the sinusoid
    phase: Annotated[float, Angle()] = 0.0  # [rad], of the sinusoid at t = 0
    # [(m/s^2)^2/Hz], one-sided spectral density of the noise, one for all axes or (3,)
    level: Annotated[float | Vector, ArrayRule((3,), NOT_NEGATIVE, or_number=True)] = 0.0
    low_frequency: NumberNotNegative = from_core("base_motion.low_frequency")  # [Hz], where the noise begins
    high_frequency: PositiveNumber = from_core("base_motion.high_frequency")  # [Hz], where it ends
    rotation: BaseRotation = Field(default_factory=BaseRotation)
    road: Road = Field(default_factory=Road)
    # what samples are: accelerations of B's origin in W, or readings of an accelerometer there, along B's axes and with
    # gravity in them, which become those; at r from that origin it would read Omega' x r + Omega x (Omega x r) more
    frame_of_acceleration: Annotated[Literal["kinematic", "specific_force"], Choice()] = "kinematic"
    file: Annotated[str | None, File()] = None  # CSV to read, relative to the scenario's file
    samples: Annotated[Matrix | None, Samples()] = None  # (n, 3) [m/s^2], recorded, in W
    attitudes: Annotated[Matrix | None, Samples(4)] = None  # (n, 4) recorded quaternions (w, x, y, z) of B in W
    sample_period: Annotated[float | None, SamplePeriod()] = None  # [s], of the samples, from t = 0

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any) -> Any:
        return _with_file(data, read_base_motion)

    @model_validator(mode="after")
    def _is_whole(self) -> BaseMotion:
        _require_recording(self.kind, self.samples, self.sample_period)
        if self.samples is None and self.attitudes is not None:
            raise refusal((("samples",), "expected accelerations beside attitudes, got null"))
        if self.samples is None and self.frame_of_acceleration != "kinematic":
            raise refusal((("frame_of_acceleration",), 'expected "kinematic" without a recording, got another frame'))
        return self


def moves(base: BaseMotion) -> bool:
    """Return whether a base does anything but rest."""
    return base.kind != "none" or base.rotation.kind != "none"


class TargetMotion(Block):
    """How the points move in the target's frame, in `sampled` mode, which the controller does not know.

    A recording is a CSV file with the columns t, x, y, z [s, m], displacements from ``target.points``.
    """

    kind: Annotated[Literal["none", "velocity", "sinusoid", "recorded"], Choice()] = "none"  # what the motion is
    velocity: Annotated[Vector, ArrayRule((3,))] = _ZERO  # (3,) [m/s], of kind velocity
    amplitude: Annotated[Vector, ArrayRule((3,))] = _ZERO  # (3,) [m], of the sinusoid
    frequency: NumberNotNegative = 1.0  # [Hz], of the sinusoid
    phase: Annotated[float, Angle()] = 0.0  # [rad], of the sinusoid at t = 0
    file: Annotated[str | None, File()] = None  # CSV to read, relative to the scenario's file
    samples: Annotated[Matrix | None, Samples()] = None  # (n, 3) [m], recorded
    sample_period: Annotated[float | None, SamplePeriod()] = None  # [s], of the samples, from t = 0

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any) -> Any:
        return _with_file(data, read_target_motion)

    @model_validator(mode="after")
    def _is_whole(self) -> TargetMotion:
        _require_recording(self.kind, self.samples, self.sample_period)
        return self


def _with_file(data: Any, read: Callable[[str], Recording]) -> Any:
    """Replace the file of a block by what it holds."""
    if not isinstance(data, dict) or not isinstance(data.get("file"), str):
        return data
    try:
        recording = read(data["file"])
    except ScenarioError as error:
        raise refusal((("file",), str(error))) from None
    data = {**data, "file": None, "samples": recording.samples, "sample_period": recording.period}
    return data if read is read_target_motion else {**data, "attitudes": recording.attitudes}


def _require_recording(kind: str, samples: Matrix | None, period: float | None) -> None:
    if (samples is None) != (period is None):
        missing, given = ("sample_period", "samples") if samples is not None else ("samples", "sample_period")
        raise refusal(((missing,), f"expected it beside {given}, got null"))
    if kind == "recorded" and samples is None:
        raise refusal((("file",), 'expected the path of a CSV file for the kind "recorded", got null'))


def displacements_of(motion: TargetMotion, time: Array) -> Array:
    """Return d(t) of a target at times (n,) [s], (n, 3) [m]; recorded samples are joined by straight lines."""
    if motion.kind == "velocity":
        return np.outer(time, motion.velocity)
    if motion.kind == "sinusoid":
        return np.outer(np.sin(2.0 * math.pi * motion.frequency * time + motion.phase), motion.amplitude)
    if motion.kind == "recorded" and motion.samples is not None and motion.sample_period is not None:
        samples = np.asarray(motion.samples, dtype=float)
        at = motion.sample_period * np.arange(len(samples))
        return np.column_stack([np.interp(time, at, column) for column in samples.T])
    return np.zeros((len(time), 3))
