"""Runs scenarios with changes, many at once: those that differ in numbers alone share a batch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.diagnosis.criterion import Record, make_record
from hexservo.findings.target_path import base_moves_target, path_at
from hexservo.run.batch import BatchResult, metrics_of, simulate_batch, whole
from hexservo.run.leg_limits import KIND_OF_CAUSE
from hexservo.run.result import Result
from hexservo.run.shared import numbers_of, shared_by, widest
from hexservo.scenario.arrays import Array
from hexservo.scenario.fitted import acts_on_gains, auto_of
from hexservo.scenario.keys import acting_keys
from hexservo.scenario.motion import displacements_of
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.yaml import ScenarioError

_SAMPLES = 500  # about so many of a run are kept
_MOVING = ("target.motion", "target.frame", "base_motion")  # keys by which a target moves in B
_MAX_BATCH = 64  # runs: bounds the memory of their samples
_KEPT = ("feature_error", "position", "quaternion", "twist", "wrench", "fuzzy_output", "leg_lengths", "leg_forces")


@dataclass(frozen=True, eq=False)
class Run:
    """A scenario to run, with changes of some keys."""

    scenario: Scenario
    changes: Mapping[str, Any] = field(default_factory=dict)  # by dotted key, as Scenario.updated takes them


def record_of(result: Result) -> Record:
    """Make a record of a result, thinned out to what a run of our own keeps."""
    every = max(1, len(result.time) // _SAMPLES)
    kept = np.unique(np.append(np.arange(0, len(result.time), every), len(result.time) - 1))
    samples = {name: np.asarray(getattr(result, name))[kept] for name in _KEPT}
    return make_record(
        result.outcome,
        result.detail,
        result.end_time,
        result.stop_time,
        result.stopped_by,
        dict(result.streamed_metrics),
        result.time[kept],
        samples,
        displacements_in_base(result.scenario, result.time[kept]),
        keep=True,
    )


def run_all(runs: Sequence[Run], threads: int = 1) -> list[Record | None]:
    """Run all and return their records in order; None where the scenario is refused with its changes.

    A lane of a batch agrees with `simulate` to rounding.
    """
    cache: dict[int, tuple[str, dict[str, Any]]] = {}
    groups: dict[Any, list[list[tuple[int, dict[str, Array]]]]] = {}
    for index, run in enumerate(runs):
        scenario = run.scenario
        if id(scenario) not in cache:
            cache[id(scenario)] = (repr(shared_by(scenario)), numbers_of(scenario))
        shared, own = cache[id(scenario)]
        others: dict[str, Any] = {}
        keys = acting_keys(
            run.changes.get("controller.law", scenario.controller.law),
            run.changes.get("simulation.mode", scenario.simulation.mode),
            scenario.target.count,
        )
        numbers = {name: values for name, values in own.items() if name in keys}
        # what a block takes depends on its kind: its numbers change with it, not after it
        kinds = tuple(name.removesuffix("kind") for name in run.changes if name.endswith(".kind"))
        for name, value in run.changes.items():
            if name in numbers and value is not None and not isinstance(value, str) and not name.startswith(kinds):
                numbers[name] = widest(keys[name], value)
            else:
                others[name] = value
                numbers.pop(name, None)
        if auto_of(scenario).bandwidth is not None and any(map(acts_on_gains, run.changes)):
            numbers |= _fitted_again(run, numbers)
        alike = groups.setdefault((shared, repr(sorted(others.items()))), [[]])
        if len(alike[-1]) == _MAX_BATCH:
            alike.append([])
        alike[-1].append((index, numbers))
    records: list[Record | None] = [None] * len(runs)
    for alike in groups.values():
        for group in alike:
            for index, record in _run(group, runs, threads):
                records[index] = record
    return records


def _fitted_again(run: Run, numbers: Mapping[str, Array]) -> dict[str, Array]:
    """Return the gains, of these numbers, that fit the machine of a run with its changes, as the caller would get."""
    try:
        changed = run.scenario.updated(run.changes)
    except ScenarioError:
        return {}  # refused when it is run
    head = f"controller.{run.scenario.controller.law}."
    return {name: values for name, values in numbers_of(changed).items() if name.startswith(head) and name in numbers}


def _thinned(run: Run) -> Scenario:
    """Return the scenario of a run with all its changes, which logs `_SAMPLES` samples."""
    simulation = run.scenario.simulation
    step = float(run.changes.get("simulation.step", simulation.step))
    duration = float(run.changes.get("simulation.duration", simulation.duration))
    return run.scenario.updated({**run.changes, "simulation.log_every": max(1, round(duration / step) // _SAMPLES)})


def _run(
    group: Sequence[tuple[int, Mapping[str, Array]]], runs: Sequence[Run], threads: int
) -> Iterable[tuple[int, Record]]:
    """Run what shares a batch, as variations of the first one; one by one where one of them is refused.

    The first one has all of its changes: some are refused without the others, as a finer step with the old delay.
    """
    variations = {name: np.stack([numbers[name] for _, numbers in group]) for name in group[0][1]}
    try:
        batch = whole(simulate_batch(_thinned(runs[group[0][0]]), variations, "trajectory", threads))
    except ValueError:
        if len(group) == 1:
            return
        for one in group:
            yield from _run([one], runs, threads)
        return
    for row, (index, _) in enumerate(group):
        run = runs[index]
        changed = any(key.startswith(_MOVING) for key in run.changes)
        yield index, _batch_record(batch, row, run.scenario.updated(run.changes) if changed else run.scenario)


def displacements_in_base(scenario: Scenario, time: Array) -> Array:
    """Return how far the middle of a target has moved in B at times (n,) [s], (n, 3) [m].

    By its own motion, and by that of the base where it is in the world (`TargetPath`).
    """
    if not base_moves_target(scenario):
        return displacements_of(scenario.target.motion, time)
    scene = scene_of(scenario)
    middle = scene.points.mean(axis=0)
    return np.asarray(path_at(scene, time).places(middle) - middle)


def _batch_record(batch: BatchResult, row: int, ran: Scenario) -> Record:
    assert batch.time is not None  # of trajectories
    there = np.isfinite(batch.samples["feature_error"][row]).all(axis=1)
    return make_record(
        str(batch.outcome[row]),
        batch.detail(row),
        float(batch.end_time[row]),
        float(batch.stop_time[row]),
        KIND_OF_CAUSE.get(str(batch.cause[row]), ""),
        metrics_of(batch, row),
        batch.time[there],
        {name: batch.samples[name][row][there] for name in ("feature_error", "leg_lengths")},
        displacements_in_base(ran, batch.time[there]),
        keep=False,
    )
