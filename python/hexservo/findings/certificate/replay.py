"""Repetition of a run with all data that a certificate needs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hexservo import _core
from hexservo.findings.caused import caused_by
from hexservo.run.result import Result, require_result
from hexservo.run.simulation import simulate, uninterrupted
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.parameters import Settings, core_parameters
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.version import VERSION
from hexservo.scenario.wording import number
from hexservo.scenario.yaml import ScenarioError

# what the samples of two runs are compared by -> unit
_SAMPLES = {
    "feature_error": "px",
    "depth": "m",
    "position": "m",
    "quaternion": "1",
    "twist": "m/s or rad/s",
    "wrench": "N or N m",
    "fuzzy_output": "N or N m",
    "leg_lengths": "m or rad",
    "leg_forces": "N or N m",
    "weight_history": "N or N m",
}
_OF_END = {"fuzzy_weights": "N or N m", "end_time": "s", "streamed_metrics": "", "events": "", "outcome": ""}
_COMPARED = {"time": "s", **_SAMPLES, **_OF_END}  # all but `detail`, the sentence about the outcome
_REPLAYED = (
    *("time", "features", "feature_error", "depth", "position", "quaternion", "twist"),
    *("wrench", "fuzzy_output", "leg_forces"),
)
_ROUNDING = 1e-9  # of a quantity's largest value

_TOO_LONG = re.compile(r"^simulation\.log_every: expected a log of at most (?P<size>.*) \(log_every of", re.MULTILINE)


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
    only_rounding: bool  # whether all differences are within rounding
    version: str  # of hexservo that made the result
    settings: Settings = field(repr=False)
    probe: _core.Probe = field(repr=False)

    @property
    def step(self) -> float:
        """Time between two samples [s]."""
        return self.scenario.simulation.step

    @property
    def continuous(self) -> bool:
        """Whether the law acted inside the stages of the integration."""
        return not self.scenario.sampled

    @property
    def remark(self) -> str:
        """Return a sentence on whether these numbers are the result's own."""
        if self.own:
            return "These are the result's own samples: a custom controller cannot be run again."
        if not self.differences:
            return "The run was repeated with every step logged, and gave the result's samples bit for bit."
        worst = ", ".join(
            f"{name} by up to {difference:.3g} {_COMPARED[name]}" if np.isfinite(difference) else name
            for name, difference in self.differences.items()
        )
        if self.version != VERSION:
            why = f"version {self.version} made the result, and this is {VERSION}"
        elif self.only_rounding:
            why = "another compiled variant made the result, which rounds otherwise"
        else:
            why = (
                "the versions are the same, so the result is not a run of its scenario, unless another compiled "
                "variant made it and the motion magnifies rounding"
            )
        return f"The run was repeated and differs from the result in {worst}: {why}. This certifies the repeated run."


def replay(result: Result) -> Replay:
    """Run a result's scenario again with every step logged, and compare.

    Raises
    ------
    KeyboardInterrupt
        Where the user stops the run on Ctrl-C.
    TypeError
        For anything but a `Result`.
    ValueError
        For a result without samples; for a result of a custom controller whose steps are not all logged; for a log
        that does not fit into the core's limit of 2 GiB.
    """
    require_result(result)
    scenario = result.scenario
    if len(result.time) == 0:
        raise ValueError("result: expected at least one sample, got none; run its scenario again with hs.simulate")
    own = not result.by_law
    if own and scenario.simulation.log_every != 1:
        raise ValueError(
            f"result: expected simulation.log_every = 1 of a run with a custom controller ({result.controller}), "
            f"since it cannot be run again, got {scenario.simulation.log_every}"
        )
    if own:
        _require_every_step(result)
        return replay_of(result, scenario, result.end_time, own=True)
    run = every_step(scenario)
    found = replay_of(run, scenario, result.end_time)
    differences = _differences(result, run)
    return replace(
        found,
        differences={name: largest for name, (largest, _) in differences.items()},
        only_rounding=all(rounding for _, rounding in differences.values()),
        version=result.version,
    )


def every_step(scenario: Scenario) -> Result:
    """Run a scenario with every step and its weights logged.

    Raises
    ------
    ScenarioError
        For a run so long that such a log would not fit.
    KeyboardInterrupt
        Where the user stops the run: what is there of it is of no use here.
    """
    try:
        return uninterrupted(simulate(scenario.updated({"simulation.log_every": 1}), log_weights=True))
    except ValueError as error:
        fits = _TOO_LONG.search(str(error))
        if fits is None:
            raise
        duration = number(scenario.simulation.duration)
        message = (
            f"simulation.duration: expected a run whose log of every step fits into {fits['size']}, as a certificate "
            f"needs it, got {duration} s; shorten it"
        )
        raise ScenarioError([message]) from None


def replay_of(run: Result, scenario: Scenario, end_time: float, *, own: bool = False) -> Replay:
    """Select the samples of a run that has every step, up to a time [s]."""
    count = min(len(run.time), round(end_time / scenario.simulation.step) + 1)
    settings = core_parameters(scenario)
    return Replay(
        scenario=scenario,
        own=own,
        **{name: getattr(run, name)[:count] for name in _REPLAYED},
        weights=None if run.weight_history is None else run.weight_history[:count],
        differences={},
        only_rounding=True,
        version=run.version,
        settings=settings,
        probe=_core.Probe(settings),
    )


def _require_every_step(result: Result) -> None:
    """Refuse the log of a custom controller that is not one sample a step, up to the end of the run."""
    step, count = result.scenario.simulation.step, len(result.time)
    steps = np.append(result.time, result.end_time) / step
    if not np.allclose(steps, np.append(np.arange(count), count - 1), rtol=0.0, atol=1e-6):
        raise ValueError(
            f"result: expected a sample at every step of {step:g} s up to its end_time {result.end_time:g} s, since a "
            f"run with a custom controller ({result.controller}) cannot be repeated, got {count} samples at other times"
        )


def _differences(result: Result, run: Result) -> dict[str, tuple[float, bool]]:
    """Compare a result with its repeated run, which has every step.

    Returns
    -------
    dict
        What is not the same, bit for bit -> largest difference, infinite where it is no number, and whether it is
        within rounding. Where the result has not the samples that its scenario asks for, no other samples are compared.
    """
    stopped = result.outcome == "interrupted"  # by its user: there is no end to compare
    last = len(run.time)
    if stopped:
        last = min(last, round(result.end_time / result.scenario.simulation.step) + 1)
    places = np.append(np.arange(0, last - 1, result.scenario.simulation.log_every), last - 1)
    found = {"time": _difference(run.time[places], result.time)}
    if found["time"] is None:
        for name in _SAMPLES:
            mine, theirs = getattr(run, name), getattr(result, name)
            if theirs is not None:  # weights, where they are not logged
                found[name] = _difference(mine[places], theirs)
    if not stopped:
        found["fuzzy_weights"] = _difference(run.fuzzy_weights, result.fuzzy_weights)
        found["end_time"] = _difference(np.array(run.end_time), np.array(result.end_time))
        of_run, of_result = ({**each.streamed_metrics} for each in (run, result))
        same = of_run.keys() == of_result.keys() and np.array_equal(
            list(of_run.values()), [of_result[name] for name in of_run], equal_nan=True
        )
        found["streamed_metrics"] = None if same else (np.inf, False)
        found["events"] = None if run.events == result.events else (np.inf, False)
        found["outcome"] = None if run.outcome == result.outcome else (np.inf, False)
    return {name: difference for name, difference in found.items() if difference is not None}


def _difference(mine: Array, theirs: Array) -> tuple[float, bool] | None:
    """Return the largest difference of two arrays, and whether it is within rounding; None where they are the same."""
    if mine.shape != theirs.shape:
        return np.inf, False
    other = (mine != theirs) & ~(np.isnan(mine) & np.isnan(theirs))
    if not other.any():
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        largest = float(np.abs(mine[other] - theirs[other]).max())
    if np.isnan(largest):
        return np.inf, False
    return largest, largest <= _ROUNDING * float(np.nanmax(np.abs(mine)))


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
            response = caused_by(run.probe, np.zeros((1, 3)), home, np.diag(wrench))[0]
            lost = np.finfo(np.float64).eps * np.abs(fall).max() / np.abs(response).max(axis=0)
        if not (lost <= _LOST).all():
            raise ArithmeticError("the inertia is too small beside the weight to follow from accelerations")
        return cls(run.probe, wrench, -wrench * np.linalg.solve(response, fall))

    def inertia(self, quaternion: Array) -> Array:
        """(1 - delta_D) D-bar, (n, 6, 6): acceleration in B (m/s^2; rad/s^2) to wrench (N; N m)."""
        response = caused_by(self.probe, np.zeros((len(quaternion), 3)), quaternion, np.diag(self.wrench))
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
