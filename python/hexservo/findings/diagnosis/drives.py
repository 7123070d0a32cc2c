"""Causes in drives that take positions: how their legs follow, and the motors that hold them."""

from __future__ import annotations

from typing import Any

from hexservo.findings.diagnosis.criterion import Record
from hexservo.findings.diagnosis.environment import ORDINARY_BANDWIDTH, ideal, less
from hexservo.findings.diagnosis.model import Alone, Case, Cause, Removal, always, fault, removal_by
from hexservo.findings.diagnosis.remedies import leg_rates_remedies, motor_remedies, slower_remedies
from hexservo.scenario.keys import keys_below

_FRICTION = "actuators.motor.friction"
_MOTORS = frozenset({"actuators.kind", *keys_below("actuators.motor")})


def _position_lag(case: Case) -> list[Removal]:
    if case.scenario.actuators.kind != "position":
        return []
    response = case.scenario.actuators.position
    changes = {
        "actuators.position.bandwidth": max(response.bandwidth, ORDINARY_BANDWIDTH),
        "actuators.position.damping": 1.0,
    }
    if (response.bandwidth, response.damping) == tuple(changes.values()):
        return []
    return [Removal("legs that follow at once", changes)]


def _leg_rates(case: Case) -> list[Removal]:
    response = case.scenario.actuators.position
    limited = [name for name in ("speed_limit", "acceleration_limit") if getattr(response, name) is not None]
    return removal_by("legs without these limits", {f"actuators.position.{name}": None for name in limited})


def _motors(case: Case) -> list[Removal]:
    if case.scenario.actuators.kind != "position_torque":
        return []
    changes = {key: value for key, value in ideal(case.scenario).items() if key in _MOTORS}
    return [Removal("legs that follow as the controller assumes, whatever it takes", changes)]


def _motors_kept(case: Case) -> dict[str, Any]:
    """Return the changes to devices without faults but for the motors, which stay as they are."""
    return less(ideal(case.scenario), _MOTORS)


def _motors_alone(case: Case) -> list[Alone]:
    return [Alone(ideal(case.scenario), {**_motors_kept(case), _FRICTION: 0.0})]


def _motors_remedies(case: Case, removal: Removal, record: Record) -> list[Removal]:
    slower = slower_remedies(case, removal, record)[:-1]  # without the removal itself
    return [*slower, *motor_remedies(case, removal, record)]


def _friction_alone(case: Case) -> list[Alone]:
    kept = _motors_kept(case)
    return [Alone({**kept, _FRICTION: 0.0}, kept)]


DRIVES: tuple[Cause, ...] = (
    Cause(
        "position_lag",
        "lag of legs that follow positions",
        frozenset({"actuators.position.bandwidth", "actuators.position.damping"}),
        _position_lag,
        slower_remedies,
    ),
    Cause(
        "leg_rates",
        "speed and acceleration of legs that follow positions",
        frozenset({"actuators.position.speed_limit", "actuators.position.acceleration_limit"}),
        _leg_rates,
        leg_rates_remedies,
    ),
    Cause(
        "motors",
        "motors that hold the legs softly, or reach their limit",
        _MOTORS - {"actuators.kind", _FRICTION},
        _motors,
        _motors_remedies,
        alone=_motors_alone,
    ),
    Cause(
        "stick_slip",
        "dry friction of the legs, which stick and slip",
        *fault(_FRICTION, 0.0, "legs without dry friction", of=always),
        motor_remedies,
        alone=_friction_alone,
    ),
)
