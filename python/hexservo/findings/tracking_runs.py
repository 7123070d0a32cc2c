"""How far behind a moving target the law `tracking` is: by runs, from a platform at rest before that target."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.gate_width import moved_between_frames
from hexservo.findings.target_path import follows_direction
from hexservo.run.batch import BatchResult, simulate_batch, whole
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import value_at
from hexservo.scenario.motion import displacements_of
from hexservo.scenario.parameters import frame_period
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.yaml import ScenarioError

CERTAINTY, BANDWIDTH, NOISE = (f"controller.tracking.{key}" for key in ("certainty", "bandwidth", "noise"))
LIMITS = ("actuators.position.speed_limit", "actuators.position.acceleration_limit")

RUNS = 4
"""Runs with different noise."""

MOVED = 1.2
"""Times the error before a target at rest, above which that of a run is of the target's motion."""

_LONGEST = 20.0  # [s] of a motion that are looked at
_PERIODS = 3.0  # of a sinusoid, after the beginning
_BEGINNING = 3.0  # [s], until the filter is as after many frames
_OF_RUN = 0.25  # of a run, that this takes at most
_SETTLES = (4.0, 3.0)  # [s] and periods of the reference's bandwidth, in which the platform comes to rest


@dataclass(frozen=True, eq=False)
class Following:
    """A target in motion, before which the platform is at rest when a run begins, and how far behind runs are.

    An error is the largest of a coordinate of the features, of a direction that of their weighted mean [px].
    """

    scene: Scene
    scenario: Scenario  # that runs, from the platform's rest
    rest: Poses  # of the platform, before the target where its motion begins
    resting: float  # largest error there, of a target at rest [px]

    @property
    def directs(self) -> bool:
        """Return whether the law follows a direction, not a pose."""
        return follows_direction(self.scenario)

    @property
    def since(self) -> float:
        """Return the time from which on errors are looked at [s]."""
        return min(_BEGINNING, _OF_RUN * self.scenario.simulation.duration)

    @cached_property
    def still(self) -> float:
        """Return the largest error of a platform that stands still before the middle of the motion [px], or inf."""
        shift = displacements_of(self.scenario.target.motion, _ticks(self.scenario))
        shift -= (shift.max(axis=0) + shift.min(axis=0)) / 2.0
        seen = Poses(self.rest.position - shift, np.tile(self.rest.quaternion, (len(shift), 1)))
        errors = _errors(self.scene, self.scene.desired - self.scene.image(seen)[0])
        return float(np.nan_to_num(errors, nan=np.inf).max())

    @cached_property
    def within_reach(self) -> bool:
        """Return whether the legs reach the poses of a target that is followed as a pose without a lag."""
        if self.directs:
            return True
        shift = displacements_of(self.scenario.target.motion, _ticks(self.scenario))
        quaternion = np.tile(self.rest.quaternion, (len(shift), 1))
        return bool(self.scene.reachable(Poses(self.rest.position + shift - shift[0], quaternion)).all())

    @cached_property
    def leg_rates(self) -> tuple[float, float]:
        """Return rate and acceleration of the legs of a platform that moves as the target, the largest of a leg.

        In m/s and m/s^2, of cranks in rad/s and rad/s^2. Linear about the rest, and as frames show the motion. The
        platform shifts with the target, or turns by the least rotation that keeps the middle of the features where it
        is. Part of a shift that the image constrains weakly the law leaves out, so that its legs may move less.
        """
        motion, period = self.scenario.target.motion, frame_period(self.scenario)
        moved = moved_between_frames(motion, period) / period
        if motion.kind == "sinusoid":
            changes = 2.0 * math.pi * motion.frequency * moved
        else:
            changes = np.diff(displacements_of(motion, np.arange(0.0, self._duration, period)), n=2, axis=0) / period**2
        return self._of_legs(moved), self._of_legs(changes)

    @cached_property
    def now(self) -> float:
        """Return the largest error of a run with the settings of the scenario [px], the median of runs."""
        return float(np.median(self._runs({}, ({},))))

    def left(self, settings: Sequence[Mapping[str, Any]]) -> list[float]:
        """Return the largest error of some runs with each of some settings [px]; inf where one ends early.

        So what is less than a share of `now` hardly is by chance.

        Parameters
        ----------
        settings
            Values of keys, of the gains of the law those above.
        """
        found = [math.inf] * len(settings)
        groups: dict[str, list[int]] = {}
        for index, changes in enumerate(settings):
            groups.setdefault(repr(_beside_gains(changes)), []).append(index)
        for indices in groups.values():
            alike = [settings[index] for index in indices]
            for index, errors in zip(indices, self._runs(_beside_gains(alike[0]), alike), strict=True):
                found[index] = float(errors.max())
        return found

    def _runs(self, others: Mapping[str, Any], settings: Sequence[Mapping[str, Any]]) -> Array:
        """Return the errors (n, runs) [px] of settings of the law, with changes of other keys; inf where refused."""
        try:
            scenario = self.scenario.updated(dict(others))
        except ScenarioError:
            return np.full((len(settings), RUNS), np.inf)
        variations = {
            key: np.repeat([float(changes.get(key, value_at(scenario, key))) for changes in settings], RUNS)
            for key in (CERTAINTY, BANDWIDTH, NOISE)
        }
        batch = _run(scenario, {**variations, "seed": np.tile(seeds_of_runs(scenario), len(settings))})
        return _largest(self.scene, batch, self.since).reshape(-1, RUNS)

    @property
    def _duration(self) -> float:
        return self.scenario.simulation.duration

    def _of_legs(self, vectors: Array) -> float:
        """Return the largest rate of a leg for velocities (n, 3) of the target, or likewise of accelerations."""
        if not len(vectors):
            return 0.0
        twists = np.hstack([vectors, np.zeros_like(vectors)])
        if self.directs:
            jacobian = self.scene.view(self.rest).jacobian.reshape(-1, 2, 6)
            middle = np.einsum("p,pkj->kj", self.scene.shares, jacobian)
            twists = np.hstack([np.zeros_like(vectors), vectors @ (np.linalg.pinv(middle[:, 3:]) @ middle[:, :3]).T])
        return float(np.abs(self.scene.leg_rates(self.rest, twists.T)).max())


def _beside_gains(changes: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in changes.items() if key not in (CERTAINTY, BANDWIDTH, NOISE)}


def following_of(scene: Scene) -> Following | None:
    """Return how a target in motion is followed; None where the platform does not come to rest before the target.

    At most 20 s of the motion are looked at, of a recording those about its fastest frame.
    """
    scenario = scene.scenario
    moving = long_enough(scenario)
    first = displacements_of(moving.target.motion, np.zeros(1))[0].tolist()
    settles = max(_SETTLES[0], _SETTLES[1] / float(scenario.controller.gains.bandwidth))
    at_first = {"kind": "recorded", "samples": [first, first], "sample_period": settles}
    waits = {
        "target.motion": at_first,
        "simulation.duration": _whole(scenario, settles),
        "simulation.log_every": 1,
        **dict.fromkeys(LIMITS),  # a slow way to the goal is not what is looked at
    }
    before = _run(scenario.updated(waits), {"seed": seeds_of_runs(scenario)})
    resting = _largest(scene, before, settles - min(_BEGINNING, settles / 2.0))
    if not np.isfinite(resting).all():
        return None
    rest = Poses(*(before.samples[name][0, -1] for name in ("position", "quaternion")))
    start = {"simulation.start.pose": rest.displacement_from(scene.home).tolist(), "simulation.start.twist": [0.0] * 6}
    return Following(scene, moving.updated({**start, "simulation.log_every": 1}), rest, float(np.median(resting)))


def long_enough(scenario: Scenario) -> Scenario:
    """Return a scenario that lasts as long as is looked at; of a recording with the part about its fastest frame."""
    motion, duration = scenario.target.motion, scenario.simulation.duration
    if motion.kind == "sinusoid":
        duration = max(duration, _BEGINNING / _OF_RUN, _BEGINNING + _PERIODS / motion.frequency)
    longest = min(duration, _LONGEST)
    changes: dict[str, Any] = {"simulation.duration": _whole(scenario, longest)}
    if motion.kind == "recorded" and duration > longest:
        assert motion.samples is not None
        assert motion.sample_period is not None
        moved = np.linalg.norm(moved_between_frames(motion, frame_period(scenario)), axis=1)
        count = math.ceil(longest / motion.sample_period) + 1
        begin = max(0, min(int(moved.argmax()) % len(motion.samples) - count // 2, len(motion.samples) - count))
        changes["target.motion.samples"] = np.asarray(motion.samples)[begin : begin + count].tolist()
    return scenario.updated(changes)


def _whole(scenario: Scenario, duration: float) -> float:
    """Return a duration in whole servo periods [s]."""
    return math.ceil(duration / scenario.simulation.step - 1e-9) * scenario.simulation.step


def _ticks(scenario: Scenario) -> Array:
    return np.arange(0.0, scenario.simulation.duration, scenario.simulation.step)


def seeds_of_runs(scenario: Scenario, count: int = RUNS) -> NDArray[np.uint64]:
    """Return seeds of runs with different noise, (n,): that of a scenario and the next ones; 0 follows 2^64 - 1."""
    return np.asarray(np.uint64(scenario.seed) + np.arange(count, dtype=np.uint64))


def _run(scenario: Scenario, variations: Mapping[str, NDArray[Any]]) -> BatchResult:
    return whole(simulate_batch(scenario, variations, log="trajectory", metrics=()))


def _largest(scene: Scene, batch: BatchResult, since: float) -> Array:
    """Return the largest error of each run of a batch from a time [s] on, (n,) [px]; inf where it ends early."""
    assert batch.time is not None  # of trajectories
    error = _errors(scene, batch.samples["feature_error"][:, batch.time >= since])
    ended = np.asarray([outcome != "completed" for outcome in batch.outcome])
    return np.where(ended, np.inf, np.nan_to_num(error, nan=np.inf).max(axis=1))


def _errors(scene: Scene, features: Array) -> Array:
    """Return the error [px] of differences of features (..., 2p) [px] from the goal, (...)."""
    if follows_direction(scene.scenario):
        points = features.reshape(*features.shape[:-1], -1, 2)
        features = np.einsum("p,...pk->...k", scene.shares, points)
    return np.asarray(np.abs(features).max(axis=-1))
