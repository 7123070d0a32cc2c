"""What the poles of a loop allow: the servo period, the time between readings of the joints, the integration's step."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hexservo.findings.bisection import last_that_holds
from hexservo.scenario.arrays import Complex
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import reading_ticks
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import below, quantity

# Servo periods per shortest time constant of the loop for which the hold has little effect. With five, settling times
# are within a fifth of those with a short period where the law damps; they are three times as long from 0.3 time
# constants on (`composite` on the machine of `paper`). Friction and adaptation alone damp less: with seven periods
# `hybrid` takes a fifth longer. Readings of the joints are late by their own period too.
_TICKS, _TICKS_OF_DAMPED = 10, 5
_SHARES = {_TICKS: "a tenth", _TICKS_OF_DAMPED: "a fifth"}
_ROUNDING = 1.0 + 1e-9
_ROUNDED = 1e-6  # of a pole: what its real part is off by the differences that linearise the loop
_HALVES = 40  # of the interval of steps


def coarsest_period(rate: float) -> float:
    """Return the longest servo period [s] that is fine with every law, for a fastest pole of `rate` [1/s]."""
    return _shortest_time(rate) / _TICKS


def of_period(scenario: Scenario, rate: float | None, exported: float | None = None) -> Iterator[str]:
    """Yield a sentence for a servo period, or one of readings, that is coarser than the loop's poles allow.

    Drives that take positions move legs without readings of the joints, which damp those of forces.

    Parameters
    ----------
    scenario
        Of a law whose loop is through the image; the reference of the others is exact at any period.
    rate
        Largest magnitude of the poles [1/s]; None where no law can be evaluated at home.
    exported
        Servo period [s] of a controller that is exported, whatever the mode; None: that of runs in sampled mode.
    """
    if rate is None or scenario.controller.law not in LAWS:
        return
    if exported is None and not scenario.sampled:
        return
    period = scenario.simulation.step if exported is None else exported
    readings = reading_ticks(scenario, period)
    head = "simulation.step: a servo period" if exported is None else "the servo period"
    ticks = _TICKS_OF_DAMPED if scenario.controller.traits.viscous else _TICKS
    periods = [(f"{head} of {quantity(period, 's')}", period, ticks)]
    if readings > 1 and scenario.actuators.kind == "force":
        apart = readings * period
        periods.append((f"sensors.period: one reading of the joints every {quantity(apart, 's')}", apart, _TICKS))
    for words, time, ticks in periods:
        if time > _shortest_time(rate) / ticks * _ROUNDING:
            yield (
                f"{words} is coarser than {_SHARES[ticks]} of the gains' shortest time constant, "
                f"{quantity(_shortest_time(rate), 's')}"
            )


def of_step(scenario: Scenario, poles: Complex) -> Iterator[str]:
    """Yield a sentence for a step, in continuous mode, with which the integration makes a loop that decays diverge.

    Runge-Kutta's method of fourth order multiplies a motion of the pole p by R(p h) in a step h, and |R| <= 1 for real
    poles up to 2.785/h.

    Parameters
    ----------
    scenario
        Of the loop.
    poles
        Of law and plant [1/s], as by `poles_at_home`.
    """
    decaying = poles[poles.real <= _ROUNDED * np.abs(poles)]
    if scenario.sampled or not _diverges(decaying, scenario.simulation.step):
        return
    step = scenario.simulation.step
    longest = last_that_holds(lambda shorter: not _diverges(decaying, shorter), 0.0, step, _HALVES)
    constant = _shortest_time(float(np.abs(decaying).max()))
    yield (
        f"simulation.step: a step of {quantity(step, 's')} is so long for the gains' shortest time constant, "
        f"{quantity(constant, 's')}, that the integration of the run diverges; take at most "
        f"{quantity(float(below(longest, 2)), 's')}, or lower gains"
    )


def _diverges(poles: Complex, step: float) -> bool:
    """Return whether a motion of one of the poles [1/s] grows in a step of Runge-Kutta's method of fourth order."""
    z = poles * step
    with np.errstate(over="ignore", invalid="ignore"):
        factors = 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))
        return not bool((np.abs(factors) <= _ROUNDING).all())


def _shortest_time(rate: float) -> float:
    """Return 1/rate [s] in the digits of the sentence; infinite for a loop without motion."""
    return float(f"{1.0 / rate:.2g}") if rate > 0.0 else float("inf")
