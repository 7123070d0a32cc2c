"""How much feedback and integral of their readings legs that take positions bear: for the law `tracking`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.motor_modes import motor_modes
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import reading_ticks
from hexservo.scenario.scenario import Scenario, require_scenario

OF_MARGIN = 0.5
"""Share of its gain margin that a feedback or an integral may have: 6 dB are left."""

# Angles up to that of half the rate of readings, between which a crossing of the real axis is looked for: as many
# evenly, and evenly in the logarithm from a share of the slowest rate in the loop on, below which there is none.
_GRID = 4096
_SLOW = 0.01


def feedback_margin(scenario: Scenario) -> float:
    """Return the gain margin of `controller.tracking.feedback`: the least with which a leg alone oscillates.

    The loop is one leg with the response of `actuators.position`; of motors (`position_torque`) it is each motion
    of six legs that motors and platform have together (`motor_modes`), and the least margin counts. It is commanded
    by minus the gain times its reading, with the law's lag for legs of one slow pole (docs/model.md, section 5),
    held for a servo period and late by `actuators.delay`, but by one period at least: what reads and commands once
    per period acts in the next one, and an identification may have taken that for a part of the leg's lag. Where
    joints are read every m periods only (`sensors.period`), the feedback moves on with each reading, and its
    command is held for m periods.

    The reference and the estimate of the target are not in that loop, nor are limits of speed, acceleration and torque:
    the whole law oscillates from about 0.75 of the margin on. Half of it (6 dB) leaves room for that, and for what the
    response lacks.

    Parameters
    ----------
    scenario
        With `actuators.kind` `position` or `position_torque`, in sampled mode.

    Returns
    -------
    float
        Gain k [1], the smallest positive one with ``1 + k F(z) z^-n G(z) = 0`` for a z on the unit circle; F is
        the law's lag, G the leg with a zero-order hold (Franklin, Powell, Workman: Digital Control of Dynamic
        Systems, 3rd ed., section 4.3). With m > 1 z counts readings, and ``z^-n G`` is the mean of its m aliases with
        the hold over m periods (Vaidyanathan: Multirate Systems and Filter Banks, section 4.1).

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        If the legs do not take positions.

    Examples
    --------
    >>> round(hs.feedback_margin(hs.load_scenario("reachy-mini")), 1)
    2.0
    """
    return min(_least_gain(leg.feedback, leg.slowest) for leg in _legs(scenario))


def integral_margin(scenario: Scenario) -> float:
    """Return the least `controller.tracking.integral` with which a leg oscillates: the gain margin of the offset.

    The loop is that of `feedback_margin`, with the scenario's feedback closed, and the offset added to the command: it
    moves on by the integral times the servo period times how far the leg is behind, in the same tick. Half of the
    margin (6 dB) leaves room for what the response lacks.

    Parameters
    ----------
    scenario
        With the law `tracking`, and `actuators.kind` `position` or `position_torque`.

    Returns
    -------
    float
        Rate r [1/s], the smallest positive one with
        ``1 + r T z/(z - 1) z^-n G(z)/(1 + k F(z) z^-n G(z)) = 0`` for a z on the unit circle; T is the servo period,
        k the feedback. 0 where k is not below `feedback_margin`: the loop oscillates without an offset.

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        If the legs do not take positions, or the law is another one.

    Examples
    --------
    >>> round(hs.integral_margin(hs.load_scenario("reachy-mini-motors")), 1)
    36.4
    """
    legs = _legs(scenario)
    controller, period = scenario.controller, scenario.simulation.step
    if controller.traits.output != "pose":
        raise ValueError(f"controller.law: expected tracking for the margin of its integral, got {controller.law}")
    feedback = controller.gains.feedback
    if feedback > 0.0 and any(feedback >= _least_gain(leg.feedback, leg.slowest) for leg in legs):
        return 0.0
    return min(_least_integral(leg, feedback, period) for leg in legs)


def _least_integral(leg: _Leg, feedback: float, period: float) -> float:
    """Return the least integral [1/s] with which a leg with this feedback oscillates, in servo periods [s]."""

    def offset(angles: Array) -> Array:
        return np.asarray(period * np.exp(1j * angles) / np.expm1(1j * angles) * leg.response(angles))

    def loop(angles: Array) -> Array:
        return np.asarray(leg.read(offset, angles) / (1.0 + feedback * leg.feedback(angles)))

    return _least_gain(loop, leg.slowest)


@dataclass(frozen=True)
class _Leg:
    """One leg as the law sees it, sampled once per servo period, and read once per `reading` of them."""

    held: Array  # (2, 3) of position and its rate over w: after a period, and from the command that is held for it
    delay: int  # [periods]
    reading: int  # from one reading to the next [periods]
    ease: float  # share of its way that the feedback moves with a reading
    slowest: float  # of the rates in the loop [1/reading]

    def response(self, angles: Array) -> Array:
        """Return z^-n G(z), (n,) at ``z = exp(i angle)``, in angles per period [rad]."""
        # Z is z - 1, and the diagonal of the matrix has 1 taken off: both are exact for legs far slower than the servo.
        ahead, z = np.expm1(1j * angles), np.exp(1j * angles)
        (own, coupling, pushed), (back, rate, sped) = self.held
        determinant = (ahead - own) * (ahead - rate) - coupling * back
        return np.asarray(((ahead - rate) * pushed + coupling * sped) / determinant * z**-self.delay)

    def read(self, response: Callable[[Array], Array], angles: Array) -> Array:
        """Return what a response per period is from reading to reading, (n,), in angles per reading [rad].

        A reading is held for its periods, and of those of the response one is read: the mean of the aliases.
        """
        total = np.zeros(len(angles), dtype=complex)
        for alias in range(self.reading):
            each = (angles + 2.0 * np.pi * alias) / self.reading
            total += response(each) * np.expm1(-1j * angles) / np.expm1(-1j * each)
        return total / self.reading

    def feedback(self, angles: Array) -> Array:
        """Return the loop of the feedback for a gain of 1, (n,), in angles per reading [rad]."""
        ahead = np.expm1(1j * angles)
        return np.asarray(self.ease * (1.0 + ahead) / (ahead + self.ease) * self.read(self.response, angles))


def _legs(scenario: Scenario) -> list[_Leg]:
    """Return the legs as the law sees them: one of `actuators.position`, or one for each motion of motors.

    Raises
    ------
    ValueError
        If the legs do not take positions.
    """
    require_scenario(scenario)
    actuators = scenario.actuators
    if not actuators.takes_positions:
        raise ValueError(
            "actuators.kind: expected position or position_torque for the margin of a feedback, got " + actuators.kind
        )
    if actuators.kind == "position":
        return [_leg(scenario, actuators.position.bandwidth, actuators.position.damping)]
    return [_leg(scenario, *response) for response in motor_modes(scene_of(scenario)).tolist()]


def _leg(scenario: Scenario, bandwidth: float, damping: float) -> _Leg:
    """Return a leg of a response [Hz; 1], with the law's lag for legs of `actuators.position`."""
    from scipy.linalg import expm  # here, since a check of most scenarios does without the import

    actuators, period = scenario.actuators, scenario.simulation.step
    w = 2.0 * math.pi * bandwidth
    system = w * period * np.array([[0.0, 1.0, 0.0], [-1.0, -2.0 * damping, 1.0], [0.0, 0.0, 0.0]])
    held = np.asarray(expm(system))[:2] - np.eye(3)[:2]
    assumed = actuators.position
    apart = 2.0 * math.sqrt(max(assumed.damping**2 - 1.0, 0.0)) / (2.0 * math.pi * assumed.bandwidth)
    lag = _core.FEEDBACK_EASE * apart  # a share of what the slow time constant of the leg is longer
    delay, reading = max(round(actuators.delay / period), 1), reading_ticks(scenario)
    slow = w / (damping + math.sqrt(max(damping**2 - 1.0, 0.0)))
    rates = [slow, 1.0 / ((delay + reading) * period), *([1.0 / lag] if lag > 0.0 else [])]
    ease = -math.expm1(-period / lag) if lag > 0.0 else 1.0
    return _Leg(held, delay, reading, ease, min(rates) * reading * period)


def _least_gain(loop: Callable[[Array], Array], slowest: float) -> float:
    """Return the smallest gain with which a loop has a pole on the unit circle; infinite if there is none.

    Parameters
    ----------
    loop
        Loop for a gain of 1: angles (n,) to its values (n,) at ``z = exp(i angle)``.
    slowest
        Of the rates in it [1/reading].
    """
    from scipy.optimize import brentq

    def value(angle: float) -> complex:
        return complex(loop(np.array([angle]))[0])

    angles = np.union1d(np.geomspace(_SLOW * slowest, np.pi, _GRID), np.linspace(0.0, np.pi, _GRID + 1)[1:])
    across = loop(angles).imag
    across[-1] = 0.0  # real at half the rate, but for rounding
    crossings = [
        angles[i] if across[i] == 0.0 else brentq(lambda at: value(at).imag, angles[i - 1], angles[i], xtol=1e-300)
        for i in range(1, len(angles))
        if across[i] == 0.0 or across[i - 1] * across[i] < 0.0
    ]
    return min((-1.0 / real for real in (value(angle).real for angle in crossings) if real < 0.0), default=math.inf)
