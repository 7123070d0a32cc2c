"""The brake of the safe output at home: its forces, and its loop with the plant from servo period to servo period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hexservo import _core
from hexservo.findings.analysis.linear_law import linear_plant
from hexservo.findings.analysis.linear_loop import Clock, SampledLoop
from hexservo.findings.analysis.loop_of_scenario import actuation_of, quiet
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.bisection import last_that_holds
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import core_parameters, reading_ticks

_STEP = 1e-5  # of a displacement [m; rad]: the brake is affine in it, but for second orders of rotations
_STABLE = 1.0 + 1e-6  # growth in a servo period up to which a motion stays: what drifts without a hold is at 1
_DAMPED = 1.0 + 1e-9  # the same in a search, which would find gains that are so small that nothing grows as fast
_LEAST = 2.0**-40  # of the gains, where a search ends
_HALVES = 20  # of an interval of shares


class Brake:
    """Leg forces of the core's tick without an image, at home; they are affine in the twist of the platform.

    Parameters
    ----------
    scene
        Of a scenario whose drives take forces.
    period
        Servo period [s].
    gains
        By key of the scenario, in place of the scenario's.
    """

    def __init__(self, scene: Scene, period: float, gains: dict[str, list[float]] | None = None) -> None:
        settings = core_parameters(scene.scenario)
        settings["sensors.rate"] = "true_rates"  # of the tick; those by differences take two
        for key, value in (gains or {}).items():
            settings[key] = np.array(value)
        self.period = period
        self._core = _core.Controller(settings, period)
        self._scene, self._home = scene, scene.home
        self._to_rates = np.asarray(scene.wrench_maps(scene.home)).T
        self._points = len(scene.desired) // 2
        self.weight = self._tick(np.zeros(6))
        self.slope = np.column_stack([self._tick(axis) - self.weight for axis in np.eye(6)])
        self.wrenches = self._to_rates.T @ self.slope  # of a twist

    def _step(self, displacement: Array, twist: Array) -> tuple[Array, Array]:
        """Return wrench and leg forces of a tick at a displacement from home, (6,) each."""
        pose = self._home.moved(displacement)
        place = (pose.position, pose.quaternion)
        lengths = self._scene.hexapod.leg_lengths(*place)
        image = (np.full(2 * self._points, np.nan), np.full(self._points, np.nan))
        found = self._core.step(*image, *place, twist, lengths, self._to_rates @ twist)
        return np.asarray(found[0]), np.asarray(found[1])

    def _tick(self, twist: Array) -> Array:
        self._core.reset()
        return self._step(np.zeros(6), twist)[1]

    def pull(self) -> Array:
        """Return the wrench beside the weight by a displacement from where the platform stopped, (6, 6): -K_h."""
        columns = []
        for axis in np.eye(6):
            wrenches = []
            for displacement in (_STEP * axis, -_STEP * axis):
                self._tick(np.zeros(6))  # the platform stops at home
                wrench = self._step(displacement, np.zeros(6))[0]
                wrenches.append(wrench - self._scene.body.weight(self._home.moved(displacement).quaternion))
            columns.append((wrenches[0] - wrenches[1]) / (2.0 * _STEP))
        return np.column_stack(columns)

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


class BrakeLoop:
    """Brake, sensors, drives and plant without an image, linear about home.

    Parameters
    ----------
    scene
        Of a scenario whose drives take forces.
    brake
        Of that scenario, with its servo period.
    """

    def __init__(self, scene: Scene, brake: Brake) -> None:
        scenario, period = scene.scenario, brake.period
        reading = reading_ticks(scenario, period)
        changes = {
            "simulation.mode": "sampled",
            "simulation.step": period,
            "simulation.duration": 100.0 * period,
            "metrics.rms_start": 0.0,
            # No image arrives, and times that another period does not divide would be refused.
            "camera.period": None,
            "camera.latency": 0.0,
            "camera.timeout": None,
            "camera.latency_jitter": 0.0,
            "uncertainty.latency": 0.0,
            "sensors.period": None if scenario.sensors.period is None else reading * period,
            "actuators.delay": round(scenario.actuators.delay / period) * period,
        }
        calm = quiet(scenario.updated(changes))
        plant = linear_plant(calm, scene.home)
        self._reading = reading
        self._loop = SampledLoop(
            tick=period,
            acceleration=plant.acceleration,
            frame=np.zeros((6, 6)),
            pose=brake.pull(),
            twist=brake.wrenches,
            reading=reading,
            differences=calm.sensors.pose == "encoders" and calm.sensors.rate == "differences",
            actuation=actuation_of(calm, plant),
        )

    def growth(self, damping: float = 1.0, hold: float = 1.0) -> float:
        """Return to how many times itself a motion grows in a servo period: the spectral radius of the tick.

        Parameters
        ----------
        damping, hold
            Factors on K_s and K_h.
        """
        loop = replace(self._loop, twist=damping * self._loop.twist, pose=hold * self._loop.pose)
        multipliers = loop.multipliers(Clock(period=1, latency=0))
        return float(np.abs(multipliers).max(initial=0.0) ** (1.0 / self._reading))

    @property
    def stable(self) -> bool:
        """Whether no motion grows."""
        return self.growth() <= _STABLE

    def largest_share(self, damping: int, hold: int) -> float | None:
        """Return the largest share s below 1 of the gains with which no motion grows; None where there is none.

        Parameters
        ----------
        damping, hold
            Powers of s by which K_s and K_h are multiplied.
        """

        def stable(share: float) -> bool:
            return self.growth(share**damping, share**hold) <= _DAMPED

        above, share = 1.0, 0.5
        while not stable(share):
            above, share = share, 0.5 * share
            if share < _LEAST:
                return None
        return last_that_holds(stable, share, above, _HALVES)
