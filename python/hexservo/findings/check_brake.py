"""The brake of the safe output, compared with the forces that the legs have."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.scene import Scene
from hexservo.run.result import Result
from hexservo.run.simulation import simulate
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import core_parameters, reading_ticks
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import below, number, quantity

_MOST_STEPS = 100_000  # of a run that is judged
_OF_FORCE = 0.8  # of what the legs have beside the weight: what the proposed gains need


def of_brake(scene: Scene, period: float | None = None) -> Iterator[str]:
    """Yield a sentence for a brake that needs more of a leg than `robot.force_limit`.

    At the largest speed of the run, which is simulated, and at rest for one step of `sensors.resolution` in one
    reading, which rates by differences take for a speed. The forces are those of the core's tick without an image, at
    home. Gains that fit are slower ones of the form of the derived ones.

    Parameters
    ----------
    scene
        Of a scenario. Drives that take positions stop within their own limits, and a run that ends early has no speed
        to compare.
    period
        Time between two ticks [s]; None: the scenario's ``simulation.step``.
    """
    scenario = scene.scenario
    if scenario.actuators.takes_positions:
        return
    period = scenario.simulation.step if period is None else period
    brake = _Brake(scene, period)
    limit, units = scenario.robot.force_limit, scene.units
    if np.abs(brake.weight).max() > limit:  # has its own sentence
        return
    moving, reading = _fastest_twists(scene, brake), _twists_of_a_step(scene, period)
    problems = []
    for twists, words in (
        (moving, "at the largest speed of a run, {}"),
        (reading, f"at rest for a sensors.resolution of {quantity(scenario.sensors.resolution, units.coordinate)}"),
    ):
        needed = np.abs(brake.forces(twists)).max(axis=0)
        leg = int(needed.argmax())
        if needed[leg] > limit:
            speed = quantity(float(np.abs(brake.rates(twists)).max()), units.rate)
            problems.append(f"{quantity(float(needed[leg]), units.effort)} of leg {leg + 1} {words.format(speed)}")
    if problems:
        yield (
            f"controller.safe: the brake needs {' and '.join(problems)}; a leg has {quantity(limit, units.effort)} "
            f"(robot.force_limit). {_remedy(scene, brake, moving, reading)}"
        )


def judged_run(scenario: Scenario) -> Result:
    """Return the run of a scenario, or its first 100 000 steps."""
    longest = _MOST_STEPS * scenario.simulation.step
    shorter = {"simulation.duration": longest} if scenario.simulation.duration > longest else {}
    return simulate(scenario.updated(shorter))


class _Brake:
    """Leg forces of the core's tick without an image, at home; they are affine in the twist of the platform."""

    def __init__(self, scene: Scene, period: float, gains: dict[str, list[float]] | None = None) -> None:
        settings = core_parameters(scene.scenario)
        settings["sensors.rate"] = "true_rates"  # of the tick; those by differences take two
        for key, value in (gains or {}).items():
            settings[key] = np.array(value)
        self.period = period
        self._core = _core.Controller(settings, period)
        self._home = scene.home
        self._lengths = np.asarray(scene.hexapod.home_lengths)
        self._to_rates = np.asarray(scene.wrench_maps(scene.home)).T
        self._points = len(scene.desired) // 2
        self.weight = self._tick(np.zeros(6))
        self.slope = np.column_stack([self._tick(axis) - self.weight for axis in np.eye(6)])
        self.wrenches = self._to_rates.T @ self.slope  # of a twist

    def _tick(self, twist: Array) -> Array:
        self._core.reset()
        image = (np.full(2 * self._points, np.nan), np.full(self._points, np.nan))
        place = (self._home.position, self._home.quaternion, twist)
        return np.asarray(self._core.step(*image, *place, self._lengths, self._to_rates @ twist)[1])

    def forces(self, twists: Array) -> Array:
        """Return the leg forces (n, 6) [N] at twists (n, 6) [m/s; rad/s]."""
        return np.asarray(self.weight + twists @ self.slope.T)

    def rates(self, twists: Array) -> Array:
        """Return the rates of the legs (n, 6) [m/s] at twists (n, 6)."""
        return np.asarray(twists @ self._to_rates.T)

    def share(self, twists: Array, limit: float) -> float:
        """Return by which factor of the gains no leg needs more than a limit [N], which the weight is within."""
        moved = twists @ self.slope.T
        room = limit - np.sign(moved) * self.weight
        return float((room / np.maximum(np.abs(moved), 1e-300)).min())


def _remedy(scene: Scene, brake: _Brake, moving: Array, reading: Array) -> str:
    """Return gains of the brake that the legs have the forces for, as a sentence without its full stop."""
    inertia, units = scene.machine.mass, scene.units
    axes = np.diag(inertia)
    # A diagonal that is nowhere below the inertia: no motion of coupled axes is less than critically damped.
    axes = axes * float(np.linalg.eigvals(inertia / axes[:, None]).real.max())

    def gains(rate: float) -> dict[str, list[float]]:
        damping, hold = ([float(f"{each:.3g}") for each in values] for values in (2.0 * rate * axes, rate**2 * axes))
        return {"controller.safe.damping": damping, "controller.safe.hold": hold}

    def fastest_pole(of: _Brake) -> float:
        return float(np.abs(np.linalg.eigvals(np.linalg.solve(inertia, of.wrenches))).max())

    slow = _Brake(scene, brake.period, gains(1.0))  # of 1 rad/s, to which damping and forces are in proportion
    both = (moving[:, None] + reading).reshape(-1, 6)
    share = _OF_FORCE * slow.share(both, scene.scenario.robot.force_limit)
    rate = float(below(min(share, fastest_pole(brake) / fastest_pole(slow)), 2))
    way = float(np.abs(brake.rates(moving)).max()) / (math.e * rate)  # at most: of critically damped axes
    if way > scene.stroke:
        return (
            f"Gains that need less stop the legs within {quantity(way, units.coordinate)}, and the stroke has "
            f"{quantity(scene.stroke, units.coordinate)} either way: take a slower law"
        )
    fitting = gains(rate)
    needed = float(np.abs(_Brake(scene, brake.period, fitting).forces(both)).max())
    pasted = " and ".join(f"{key}=[{','.join(map(number, values))}]" for key, values in fitting.items())
    stops = f", and the legs stop within {quantity(way, units.coordinate, 2)}" if way > 0.0 else ""
    return f"With {pasted} it needs {quantity(needed, units.effort)}{stops}"


def _fastest_twists(scene: Scene, brake: _Brake) -> Array:
    """Return those twists of the run at which a leg needs most, each way, (n, 6); rest where the run ends early."""
    result = judged_run(scene.scenario)
    if result.outcome != "completed":
        return np.zeros((1, 6))
    twists = np.asarray(result.twist)
    forces = brake.forces(twists)
    return np.asarray(twists[np.unique([forces.argmax(axis=0), forces.argmin(axis=0)])])


def _twists_of_a_step(scene: Scene, period: float) -> Array:
    """Return the twists (n, 6) that rates by differences have for one step of one leg's reading; rest without."""
    sensors = scene.scenario.sensors
    if sensors.pose != "encoders" or sensors.rate is True:
        return np.zeros((1, 6))
    between = period * reading_ticks(scene.scenario, period)
    twists = np.linalg.inv(scene.wrench_maps(scene.home)) * sensors.resolution / between
    return np.vstack([twists, -twists])
