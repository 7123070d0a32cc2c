"""Repetition of a run with all data that a certificate needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hexservo import _core
from hexservo.run.result import Result, require_result
from hexservo.run.simulation import simulate, uninterrupted
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.parameters import Settings, core_parameters
from hexservo.scenario.scenario import Scenario

# what two runs are compared by -> unit
_COMPARED = {
    "feature_error": "px",
    "depth": "m",
    "position": "m",
    "quaternion": "1",
    "twist": "m/s or rad/s",
    "wrench": "N or N m",
    "fuzzy_output": "N or N m",
}


@dataclass(frozen=True, eq=False)
class Replay:
    """Samples of every step of a run, n of them, up to the last one of the result that they certify."""

    scenario: Scenario  # of the result
    own: bool  # a controller that is a function of its user's, which cannot be run again
    time: Array  # (n,) [s]
    features: Array  # (n, 2p) [px]
    feature_error: Array  # (n, 2p) [px]
    depth: Array  # (n, p) [m]
    position: Array  # (n, 3) [m]
    quaternion: Array  # (n, 4)
    twist: Array  # (n, 6) [m/s; rad/s]
    wrench: Array  # (n, 6) [N; N m]
    fuzzy_output: Array  # (n, 6) [N; N m]
    leg_forces: Array  # (n, 6) [N]
    weights: Array | None  # (n, 6, 7, 7) [N; N m]; None where no fuzzy systems act
    differences: Mapping[str, float]  # quantities of the result that this run did not reproduce: largest difference
    settings: Settings = field(repr=False)
    probe: _core.Probe = field(repr=False)

    @property
    def step(self) -> float:
        """Time between two samples [s]."""
        return self.scenario.simulation.step

    @property
    def continuous(self) -> bool:
        """Whether the law acted inside the stages of the integration."""
        return self.scenario.simulation.mode == "continuous"

    @property
    def remark(self) -> str:
        """Return a sentence on whether these numbers are the result's own."""
        if self.own:
            return "These are the result's own samples: a custom controller cannot be run again."
        if not self.differences:
            return "The run was repeated with every step logged, and gave the result's samples bit for bit."
        worst = ", ".join(
            f"{name} by up to {difference:.3g} {_COMPARED[name]}" for name, difference in self.differences.items()
        )
        return (
            f"The run was repeated and differs from the result in {worst}: "
            "another version or compiled variant made the result, and this certifies the repeated run."
        )


def replay(result: Result) -> Replay:
    """Run a result's scenario again with every step logged, and compare.

    Raises
    ------
    KeyboardInterrupt
        Where the user stops the run on Ctrl-C.
    TypeError
        For anything but a `Result`.
    ValueError
        For a result of a custom controller whose steps are not all logged; for a log that does not fit into the
        core's limit of 2 GiB.
    """
    require_result(result)
    scenario = result.scenario
    own = not result.by_law
    if own and scenario.simulation.log_every != 1:
        raise ValueError(
            f"result: expected simulation.log_every = 1 of a run with a custom controller ({result.controller}), "
            f"since it cannot be run again, got {scenario.simulation.log_every}"
        )
    run = result if own else every_step(scenario)
    return replay_of(run, scenario, result.end_time, own=own, differences={} if own else _differences(result, run))


def every_step(scenario: Scenario) -> Result:
    """Run a scenario with every step and its weights logged.

    Raises
    ------
    KeyboardInterrupt
        Where the user stops the run: what is there of it is of no use here.
    """
    return uninterrupted(simulate(scenario.updated({"simulation.log_every": 1}), log_weights=True))


def replay_of(
    run: Result,
    scenario: Scenario,
    end_time: float,
    *,
    own: bool = False,
    differences: Mapping[str, float] | None = None,
) -> Replay:
    """Select the samples of a run that has every step, up to a time [s]."""
    count = min(len(run.time), round(end_time / scenario.simulation.step) + 1)
    settings = core_parameters(scenario)
    return Replay(
        scenario=scenario,
        own=own,
        **{name: getattr(run, name)[:count] for name in ("time", "features", *_COMPARED, "leg_forces")},
        weights=None if run.weight_history is None else run.weight_history[:count],
        differences=differences or {},
        settings=settings,
        probe=_core.Probe(settings),
    )


def _differences(result: Result, run: Result) -> dict[str, float]:
    """Return the largest difference of every quantity that is not the same, bit for bit; infinite where one ended."""
    places = np.rint(result.time / result.scenario.simulation.step).astype(np.intp)
    if places[-1] >= len(run.time):
        return dict.fromkeys(_COMPARED, np.inf)
    found = {}
    for name in _COMPARED:
        mine, theirs = getattr(run, name)[places], getattr(result, name)
        other = (mine != theirs) & ~(np.isnan(mine) & np.isnan(theirs))
        if other.any():
            with np.errstate(over="ignore", invalid="ignore"):
                largest = float(np.abs(mine[other] - theirs[other]).max())
            found[name] = np.inf if np.isnan(largest) else largest
    return found


def sgn_breaks(twist: Array) -> Mask:
    """Return which of the n - 1 steps between n samples contain a sign change of any component."""
    signs = np.sign(twist)
    return np.asarray((signs[1:] != signs[:-1]).any(axis=1))


_LOST = 1e-9  # share of the inertia: what rounding may take from it


@dataclass(frozen=True, eq=False)
class Plant:
    """Matrices and wrenches of the actual platform (3), from its accelerations under given wrenches."""

    probe: _core.Probe
    wrench: Array  # (6,) under which the nominal body accelerates far more than under its weight [N; N m]
    weight: Array  # (6,) (1 - delta_G) G-bar [N; N m]; it does not depend on the pose

    @classmethod
    def of(cls, run: Replay) -> Plant:
        """Find the weight at the attitude of home.

        Raises
        ------
        ArithmeticError
            Where rounding of the acceleration under the weight hides what a wrench of the body's own size adds, or
            numbers end.
        """
        home, rest = np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6))
        fall = run.probe.acceleration(np.zeros((1, 3)), home, rest, rest)[0]
        with np.errstate(all="ignore"):
            body = np.r_[[run.settings["robot.mass"]] * 3, np.diag(run.settings["robot.inertia"])]
            wrench = 64 * max(1.0, np.abs(fall).max()) * body
            if not np.isfinite(wrench).all():
                raise ArithmeticError("the weight is too large for numbers")
            response = _response(run.probe, wrench, home)[0]
            lost = np.finfo(np.float64).eps * np.abs(fall).max() / np.abs(response).max(axis=0)
        if not (lost <= _LOST).all():
            raise ArithmeticError("the inertia is too small beside the weight to follow from accelerations")
        return cls(run.probe, wrench, -wrench * np.linalg.solve(response, fall))

    def inertia(self, quaternion: Array) -> Array:
        """(1 - delta_D) D-bar, (n, 6, 6): acceleration in B (m/s^2; rad/s^2) to wrench (N; N m)."""
        response = _response(self.probe, self.wrench, quaternion)
        return np.asarray(self.wrench[:, None] * np.linalg.inv(response), dtype=np.float64)

    def coriolis(self, quaternion: Array, twist: Array, inertia: Array) -> Array:
        """(1 - delta_C) C-bar chi-dot, (n, 6) [N; N m]; `inertia` is that of the same attitudes."""
        position, none = np.zeros((len(twist), 3)), np.zeros_like(twist)
        alone = self.probe.acceleration(position, quaternion, twist, none)
        return -(product(inertia, alone) + self.weight)

    def turning_power(self, position: Array, quaternion: Array, twist: Array) -> Array:
        """1/2 chi-dot^T d/dt[(1 - delta_D) D-bar] chi-dot, (n,) [W], by central differences along the motion."""
        moment = 1e-5  # [s]: at any speed of interest both truncation and rounding are below 1e-9 of the power
        still = np.zeros_like(twist)
        ahead, behind = (
            self.inertia(
                np.asarray(self.probe.moved(position, quaternion, twist, quaternion, twist, still, way * moment)[1])
            )
            for way in (1.0, -1.0)
        )
        return np.asarray(0.5 * np.einsum("ni,nij,nj->n", twist, (ahead - behind) / (2 * moment), twist))


def product(matrices: Array, vectors: Array) -> Array:
    """Multiply n matrices (n, 6, 6) with n vectors (n, 6)."""
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))


def _response(probe: _core.Probe, wrenches: Array, quaternion: Array) -> Array:
    """Accelerations under six wrenches, one an axis, beyond those under none, (n, 6, 6): D^-1 diag(wrenches)."""
    count = len(quaternion)
    position, rest = np.zeros((count, 3)), np.zeros((count, 6))
    fall = probe.acceleration(position, quaternion, rest, rest)
    columns = []
    for axis in range(6):
        wrench = np.zeros((count, 6))
        wrench[:, axis] = wrenches[axis]
        columns.append(probe.acceleration(position, quaternion, rest, wrench) - fall)
    return np.stack(columns, axis=2)
