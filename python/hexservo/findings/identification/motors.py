"""What the motors of a machine do, six with the platform that they move: stiffness, damping, friction and armature.

Output error as in drives.py, by the core's own plant of docs/model.md ("Motors that hold positions"): the legs couple
through the platform, whose weight and inertia, known of the machine, make the stiffness visible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from hexservo import _core
from hexservo.findings.identification.drives import MOST_DELAY, Drives
from hexservo.findings.identification.interval import Interval, correlated, deviations, half_width
from hexservo.findings.identification.joints_repeated import fresh_readings
from hexservo.findings.identification.log import FITTED, LEAST_EXPLAINED, Log, predicted_share
from hexservo.findings.part import Part
from hexservo.run.progress import ProgressCallback
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.keys import value_at
from hexservo.scenario.leg_units import LegUnits, leg_units
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario

_KEYS = ("kp", "damping", "armature", "friction")  # of `actuators.motor`, the last one may be zero
_LEG_STEP = 1.25e-3  # [s], most of a step of the legs in the search
_HALVINGS = 4  # of it at most, to finish the fit
_TRIES, _FEW_TRIES = 40, 5  # of least squares at most: in the search, and from a fit with other steps
_MOVED = 0.1  # standard deviations by which halved steps move a value at most where they are short enough
_STIFFNESSES = np.geomspace(1e-3, 1e1, 13)  # tried first, times the limit over how far the legs were sent
_DELAYS = (-1, 0, 1, 2)  # beside that of the drives, which takes a part of it for lag [ticks]
_SMALLEST = 1e-4  # friction and armature that are looked for at least, as shares of what acts
_ALIKE = 1.02  # times the error of the fit that motors may have which move the legs alike
_CURVE = 2000  # samples of a figure at most


@dataclass(frozen=True, eq=False, repr=False)
class MotorFit(Part):
    """Motors of one kind, which all six legs have."""

    kp: Interval  # [N/m], of cranks [N m/rad]
    damping: Interval  # [N s/m], or [N m s/rad]: `kv` and `damping`, which act alike below the limit
    armature: Interval  # [kg], or [kg m^2]
    friction: Interval  # [N], or [N m]
    delay: int  # [ticks]
    limit: float  # `robot.force_limit` [N], or [N m], as the machine has it
    noise: float  # standard deviation of what the fit leaves [m], or [rad]
    correlated: float  # ticks over which that is correlated
    error: float  # root mean square of the prediction's error in the part kept apart [m], or [rad]
    error_of_drives: float  # the same of six responses without coupling (`Drives`)
    explained: float | None  # share of the variance kept apart that is predicted, of the worst leg; None: none moves
    still: tuple[int, ...]  # legs, 1 to 6, that move too little there for a prediction to be judged
    units: LegUnits = field(repr=False)
    time: Array = field(repr=False)  # (k,) of the part kept apart, thinned [s]
    measured: Array = field(repr=False)  # (k, 6)
    predicted: Array = field(repr=False)  # (k, 6)

    substeps: int  # of the loop in a tick, with which its legs follow such motors
    kept: tuple[str, ...] = ()  # what the log does not determine, and moves the legs alike as the machine has it

    @property
    def explains(self) -> bool:
        """Whether the model is of these legs at all, as far as the part kept apart shows it."""
        return self.explained is None or self.explained >= LEAST_EXPLAINED

    @property
    def open(self) -> tuple[str, ...]:
        """What the log does not determine."""
        return tuple(key for key in _KEYS if not getattr(self, key).is_bounded)

    @property
    def changes(self) -> dict[str, Any]:
        """The keys of a scenario with these motors, by dotted name."""
        found = {key: getattr(self, key).value for key in _KEYS if key not in self.kept}
        return {
            "simulation.substeps": self.substeps,
            "actuators.kind": "position_torque",
            "actuators.motor.kv": 0.0,
            **{f"actuators.motor.{key}": float(f"{value:.6g}") for key, value in found.items()},
        }


@dataclass(frozen=True, eq=False)
class _Fit:
    delay: int
    logs: Array  # (4,) of the values of `_KEYS`
    jacobian: Array  # (6 n, 4)
    left: Array  # (6 n,) residuals, in shares of the motion
    cost: float

    @cached_property
    def correlated(self) -> float:
        """Ticks over which the residuals are correlated, of the worst leg."""
        legs = self.left.reshape(-1, 6)
        return max(correlated(legs[:, leg]) for leg in range(6))

    def deviations(self) -> Array:
        """Return the standard deviations of `logs`, (4,)."""
        return deviations(self.jacobian, self.left, len(self.left) / self.correlated)


class _Plant:
    """The machine on motors, driven by the commands of a log."""

    def __init__(self, log: Log, machine: Scenario) -> None:
        self._commands = np.ascontiguousarray(log.commands)
        self._step = log.step_near(machine.simulation.step)
        self._settings = core_parameters(machine)
        self._settings["simulation.step"] = self._step
        self._fewest = max(1, math.ceil(self._step / (_core.MOTOR_STEPS * _LEG_STEP)))
        self._settings["simulation.substeps"] = self._fewest
        self._settings["actuators.motor.kv"] = 0.0
        hexapod = _core.Hexapod(self._settings.robot)
        self._start = hexapod.forward_kinematics(log.joints[0], hexapod.home_position, hexapod.home_quaternion)

    def response(self, delay: int, values: Mapping[str, float], ticks: int | None = None) -> Array:
        """Return the legs' coordinates at each tick, (n, 6), or at the first ones alone."""
        self._settings["actuators.delay"] = delay * self._step
        for key, value in values.items():
            self._settings[f"actuators.motor.{key}"] = value
        commands = self._commands[:ticks]
        return _core.motor_response(self._settings, commands, self._start.position, self._start.quaternion)

    def halve_steps(self) -> None:
        """Take twice as many steps in a tick."""
        self._settings["simulation.substeps"] = 2 * int(self._settings["simulation.substeps"])

    def substeps(self) -> int:
        """Return how many steps of the loop a tick needs with the last values, and a quarter more."""
        return max(math.ceil(1.25 * _core.motor_substeps(self._settings)), self._fewest)


def fit_motors(log: Log, machine: Scenario, drives: Drives, report: ProgressCallback | None = None) -> MotorFit | None:
    """Fit motors that hold positions to a log: one kind for all six legs.

    Parameters
    ----------
    log
        In which the legs were commanded to move, from a platform at rest on.
    machine
        Legs, mass, centre of mass and inertia of the platform, and `robot.force_limit`, which are taken as they are.
    drives
        Of the same log: where the search begins.
    report
        Is called with the delays done, and how many there are.

    Returns
    -------
    MotorFit or None
        None where not all six legs moved.
    """
    if len(drives.moved) < 6:
        return None
    plant, fitted = _Plant(log, machine), int(FITTED * len(log.time))
    fresh = fresh_readings(log.joints)
    read = fresh[:fitted]
    measured = log.joints[:fitted][read]
    scale = float(np.std(measured - measured.mean(axis=0)))

    def residuals(delay: int, logs: Array) -> Array:
        left = (plant.response(delay, _values(logs), fitted)[read] - measured) / scale
        return np.asarray(np.where(np.isfinite(left), np.clip(left, -1e3, 1e3), 1e3).ravel())

    around = round(float(np.median([fit.delay.value for fit in drives.moved if fit.delay is not None])))
    delays = [delay for delay in (around + more for more in _DELAYS) if 0 <= delay <= MOST_DELAY]
    fits: list[_Fit] = []
    for delay in delays:
        left = partial(residuals, delay)
        fits.append(_fitted(left, delay, _start(log, machine, drives, left)))
        if report is not None:
            report(len(fits), len(delays))
        if delay == delays[-1]:  # none of the neighbours of the best one is left out
            best = min(fits, key=lambda fit: fit.cost).delay
            delays += [more for more in (best - 1, best + 1) if more not in delays and 0 <= more <= MOST_DELAY]
    coarse = min(fits, key=lambda fit: fit.cost)
    return _result(
        log, machine, drives, plant, _finished(plant, partial(residuals, coarse.delay), coarse), fitted, scale, fresh
    )


def _fitted(left: Callable[[Array], Array], delay: int, start: Array, tries: int = _TRIES) -> _Fit:
    edge = np.log(1e6)
    found = least_squares(
        left,
        start,
        bounds=(start - edge, start + edge),
        x_scale=0.3,  # of logarithms: a third of a value
        diff_step=1e-4,
        max_nfev=tries,
    )
    return _Fit(delay, found.x, found.jac, found.fun, float(found.cost))


def _finished(plant: _Plant, left: Callable[[Array], Array], fit: _Fit) -> _Fit:
    """Fit again with halved steps of the plant, until they move no value by more than a part of its deviation.

    Friction makes the error of the steps one of first order: halved steps leave as much of it as they move.
    """
    for _ in range(_HALVINGS):
        plant.halve_steps()
        before, fit = fit, _fitted(left, fit.delay, fit.logs, _FEW_TRIES)
        if (np.abs(fit.logs - before.logs) <= _MOVED * fit.deviations()).all():
            break
    return fit


def _values(logs: Array) -> dict[str, float]:
    return {key: float(value) for key, value in zip(_KEYS, np.exp(logs), strict=True)}


def _start(log: Log, machine: Scenario, drives: Drives, residuals: Callable[[Array], Array]) -> Array:
    """Return the best of some stiffnesses; inertia and damping of a leg follow from each by the drives' response.

    kp = I w^2 and d = 2 zeta w I of a leg that moves I alone; half of I is the motor's at first.
    """
    w = 2.0 * np.pi * np.median([fit.bandwidth.value for fit in drives.moved if fit.bandwidth is not None])
    zeta = np.median([fit.damping.value for fit in drives.moved if fit.damping is not None])
    way = _farthest(log)
    limit = machine.robot.force_limit if math.isfinite(machine.robot.force_limit) else 1.0
    tried = []
    for kp in _STIFFNESSES * limit / way:
        logs = np.log([kp, 2.0 * zeta * kp / w, 0.5 * kp / w**2, 10.0 * _SMALLEST * kp * way])
        tried.append((float((residuals(logs) ** 2).sum()), logs))
    return min(tried, key=lambda one: one[0])[1]


def _result(
    log: Log,
    machine: Scenario,
    drives: Drives,
    plant: _Plant,
    best: _Fit,
    fitted: int,
    scale: float,
    fresh: Mask,
) -> MotorFit:
    values = _values(best.logs)
    intervals = _intervals(values, best.deviations(), _SMALLEST * values["kp"] * _farthest(log))
    apart = np.flatnonzero(fresh)
    apart = apart[apart >= fitted]
    predicted, measured = plant.response(best.delay, values)[apart], log.joints[apart]
    every = max(1, -(-len(measured) // _CURVE))
    error = _rms(predicted - measured)
    kept = tuple(key for key, one in intervals.items() if not one.is_bounded)
    given = values | {key: float(value_at(machine, f"actuators.motor.{key}")) for key in kept}
    if kept and not _rms(plant.response(best.delay, given)[apart] - measured) <= _ALIKE * error:  # or not a number
        kept, given = (), values
        plant.response(best.delay, given, 1)
    commands, joints, rest = log.commands[fresh].T, log.joints[fresh].T, slice(len(best.left) // 6, None)
    shares = [predicted_share(*of_leg, rest) for of_leg in zip(commands, joints, predicted.T, strict=True)]
    return MotorFit(
        **intervals,
        delay=best.delay,
        limit=machine.robot.force_limit,
        noise=scale * float(np.sqrt(2.0 * best.cost / (len(best.left) - len(_KEYS)))),
        correlated=best.correlated,
        error=error,
        error_of_drives=_rms(drives.predicted - drives.measured),
        explained=min((share for share in shares if share is not None), default=None),
        still=tuple(leg + 1 for leg, share in enumerate(shares) if share is None),
        units=leg_units(machine.robot),
        time=log.time[apart][::every],
        measured=measured[::every],
        predicted=predicted[::every],
        substeps=plant.substeps(),
        kept=kept,
    )


def _intervals(values: Mapping[str, float], deviations: Array, smallest: float) -> dict[str, Interval]:
    """Return the values of `_KEYS` with intervals, open where the log does not determine them.

    Friction that is no different from none may be zero, which no logarithm contains: its upper end is that of the
    friction itself, and it is determined if this is at most as many times `smallest` as ends may be apart.

    Parameters
    ----------
    values
        By key.
    deviations
        (4,) standard, of their logarithms.
    smallest
        Friction that is looked for, at least [N; N m].
    """
    found = {key: Interval.of_logarithm(values[key], float(one)) for key, one in zip(_KEYS, deviations, strict=True)}
    if values["friction"] < smallest:
        high = values["friction"] * (1.0 + half_width(float(deviations[_KEYS.index("friction")])))
        known = Interval(smallest, smallest, max(high, smallest)).determined().is_bounded
        found["friction"] = Interval(0.0, 0.0, high) if known else Interval(0.0, -np.inf, np.inf)
    return found


def _farthest(log: Log) -> float:
    """Return the longest jump of a leg's command."""
    return float(np.abs(np.diff(log.commands, axis=0)).max())


def _rms(errors: Array) -> float:
    return float(np.sqrt((errors**2).mean()))
