"""The closed loop as plain numbers, which every peer integrates, and what its answer must be.

Nothing here comes from the core but the scenario's numbers: the peers are written from docs/model.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

import hexservo as hs

Array = NDArray[np.float64]

CENTRES: Array = (np.arange(7) - 3) / 3.0
PACK = 8  # scenarios that JAX maps at once
SWITCHING_KINDS = ("sign", "tanh")


@dataclass(frozen=True)
class Problem:
    """A scenario of the law hybrid with a camera in the hand, for `steps` Runge-Kutta steps from home, at rest."""

    step: float  # h [s]
    samples: int  # the state is kept every `stride` steps
    stride: int
    home: Array  # (3,) p_BE [m]
    points: Array  # (4, 3) in B [m]
    focal: float  # f [px]
    depth_error: float  # delta_Z
    desired: Array  # (8,) xi_d [px]
    mass: float  # [kg]
    inertia: Array  # (3,) principal moments, in E [kg m^2]
    gravity: float  # [m/s^2]
    inertia_error: float  # delta_D
    coriolis_error: float  # delta_C
    gravity_error: float  # delta_G
    kp: Array  # (8,)
    kv: Array  # (6,)
    adaptation: Array  # (6,) Psi
    error_scale: Array  # (6,) a
    rate_scale: Array  # (6,) b
    bell_width: float
    switching: str  # one of SWITCHING_KINDS
    switching_width: float

    @property
    def steps(self) -> int:
        """Steps of the whole run."""
        return self.samples * self.stride

    @property
    def gravity_wrench_z(self) -> float:
        """G of (1), its only entry that is not zero [N]."""
        return -self.mass * self.gravity


@dataclass(frozen=True)
class Answer:
    """What a run gives: samples every `stride` steps (not at the start), and the weights at the end."""

    feature_error: Array  # (samples, 8) xi_d - xi [px]
    position: Array  # (samples, 3) [m]
    weights: Array  # (6, 7, 7) [N; N m]


class ClosedLoopPeer(Protocol):
    """One implementation of the loop; made once per problem, so that compilation is not timed."""

    def run(self) -> Answer:
        """Integrate the problem once."""
        ...


def loop_scenario(switching: str, duration: float, stride: int) -> hs.Scenario:
    """Give `paper` with that switching term, logged every `stride` steps."""
    return hs.load_scenario("paper").updated(
        {"controller.switching.kind": switching, "simulation.duration": duration, "simulation.log_every": stride}
    )


def problem_of(scenario: hs.Scenario) -> Problem:
    """Take a scenario's numbers.

    Raises
    ------
    ValueError
        "key: expected ..., got ..." for what the peers leave out (arrays of errors, other bells, other switching).
    """

    def one(key: str, value: object) -> float:
        if not isinstance(value, int | float):
            raise ValueError(f"{key}: expected one number, got {value!r}")
        return float(value)

    def same(key: str, value: object, expected: object) -> None:
        if value != expected:
            raise ValueError(f"{key}: expected {expected!r}, got {value!r}")

    robot, fuzzy = scenario.robot, scenario.controller.hybrid.fuzzy
    same("camera.convention", scenario.camera.convention, "eye_in_hand")
    same("controller.jacobian", scenario.controller.jacobian, "consistent")
    same("controller.hybrid.fuzzy.enabled", fuzzy.enabled, True)
    same("controller.hybrid.fuzzy.initial_scale", fuzzy.initial_scale, 0.0)
    same("controller.hybrid.fuzzy.bell_slope", fuzzy.bell_slope, 2.0)
    same("target.points", scenario.target.points, None)
    switching = scenario.controller.switching
    if switching.kind not in SWITCHING_KINDS:
        raise ValueError(f"controller.switching.kind: expected one of {SWITCHING_KINDS}, got {switching.kind!r}")
    inertia = np.asarray(robot.inertia, dtype=float)
    if inertia.shape != (3,):
        raise ValueError(f"robot.inertia: expected 3 numbers, got an array of shape {inertia.shape}")

    focal = scenario.camera.focal_length * scenario.camera.pixel_scale
    home = np.asarray(robot.home_position, dtype=float)
    # (4) the other way round, from home with R = I: X = -x Z/f with Z = -depth
    seen = np.reshape(np.asarray(scenario.target.initial_features, dtype=float), (4, 2))
    depth = np.broadcast_to(np.asarray(scenario.target.depth, dtype=float), (4,))
    points = home + np.column_stack([seen * (depth / focal)[:, None], -depth])
    steps = round(scenario.simulation.duration / scenario.simulation.step)
    stride = scenario.simulation.log_every
    if steps % stride:
        raise ValueError(f"simulation.log_every: expected a divisor of {steps} steps, got {stride}")
    return Problem(
        step=scenario.simulation.step,
        samples=steps // stride,
        stride=stride,
        home=home,
        points=points,
        focal=focal,
        depth_error=one("uncertainty.depth", scenario.uncertainty.depth),
        desired=np.asarray(scenario.target.desired_features, dtype=float),
        mass=robot.mass,
        inertia=inertia,
        gravity=9.8,
        inertia_error=one("uncertainty.inertia", scenario.uncertainty.inertia),
        coriolis_error=one("uncertainty.coriolis", scenario.uncertainty.coriolis),
        gravity_error=one("uncertainty.gravity", scenario.uncertainty.gravity),
        kp=np.broadcast_to(np.asarray(scenario.controller.hybrid.kp, dtype=float), (8,)).copy(),
        kv=np.broadcast_to(np.asarray(scenario.controller.hybrid.kv, dtype=float), (6,)).copy(),
        adaptation=np.broadcast_to(np.asarray(fuzzy.adaptation, dtype=float), (6,)).copy(),
        error_scale=np.broadcast_to(np.asarray(fuzzy.error_scale, dtype=float), (6,)).copy(),
        rate_scale=np.broadcast_to(np.asarray(fuzzy.rate_scale, dtype=float), (6,)).copy(),
        bell_width=fuzzy.bell_width,
        switching=switching.kind,
        switching_width=switching.width,
    )
