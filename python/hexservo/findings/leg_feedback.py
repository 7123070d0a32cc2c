"""How much feedback of their readings legs that take positions bear: for the law `tracking`."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.signal import cont2discrete

from hexservo import _core
from hexservo.scenario.scenario import Scenario, require_scenario

__all__ = ["feedback_margin"]

_GRID = 4096  # angles up to that of half the servo rate, between which a crossing of the real axis is looked for


def feedback_margin(scenario: Scenario) -> float:
    """Return the least `controller.tracking.feedback` with which a leg oscillates: the gain margin of that feedback.

    The loop is one leg with the response of `actuators.position`, commanded by minus the gain times its reading, with
    the law's lag for legs of one slow pole (docs/model.md, section 5), held for a servo period and late by
    `actuators.delay`, but by one period at least: what reads and commands once per period acts in the next one, and an
    identification may have taken that for a part of the leg's lag. Half of the
    margin (6 dB) leaves room for what the response lacks; limits of speed and acceleration are not in it.

    Parameters
    ----------
    scenario
        With `actuators.kind` `position` or `position_torque`, in sampled mode.

    Returns
    -------
    float
        Gain k [1], the smallest positive one with ``1 + k F(z) z^-n G(z) = 0`` for a z on the unit circle; F is
        the law's lag, G the leg with a zero-order hold (Franklin, Powell, Workman: Digital Control of Dynamic
        Systems, 3rd ed., section 4.3).

    Raises
    ------
    TypeError
        For anything but a `Scenario`.
    ValueError
        If the legs do not take positions.

    Examples
    --------
    >>> round(hs.feedback_margin(hs.load_scenario("reachy-mini")), 1)
    1.8
    """
    require_scenario(scenario)
    actuators, period = scenario.actuators, scenario.simulation.step
    if not actuators.takes_positions:
        raise ValueError(
            f"actuators.kind: expected position or position_torque for the margin of a feedback, got {actuators.kind}"
        )
    w, damping = 2.0 * math.pi * actuators.position.bandwidth, actuators.position.damping
    held = cont2discrete((np.array([w * w]), np.array([1.0, 2.0 * damping * w, w * w])), period)
    numerator, denominator = np.ravel(held[0]), np.ravel(held[1])
    delay = max(round(actuators.delay / period), 1)
    slower = 2.0 * math.sqrt(max(damping**2 - 1.0, 0.0)) / w  # of the leg's two time constants, by how much
    ease = -math.expm1(-period / (_core.FEEDBACK_EASE * slower)) if slower > 0.0 else 1.0

    def loop(angle: float) -> complex:
        z = np.exp(1j * angle)
        lag = ease / (1.0 - (1.0 - ease) / z)
        return complex(lag * np.polyval(numerator, z) / np.polyval(denominator, z) * z**-delay)

    angles = np.linspace(0.0, np.pi, _GRID + 1)[1:]
    across = np.array([loop(angle).imag for angle in angles])
    across[-1] = 0.0  # real at half the rate, but for rounding
    crossings = [
        angles[i] if across[i] == 0.0 else brentq(lambda angle: loop(angle).imag, angles[i - 1], angles[i])
        for i in range(1, _GRID)
        if across[i] == 0.0 or across[i - 1] * across[i] < 0.0
    ]
    gains = [-1.0 / value for value in (loop(angle).real for angle in crossings) if value < 0.0]
    return min(gains)
