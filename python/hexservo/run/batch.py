"""Runs many variations of a scenario at once, one per lane of the processor's vector registers."""

from __future__ import annotations

import contextlib
import math
import operator
import os
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo import _core
from hexservo.run.custom_controller import OwnController, function_name, require_runnable, run_with
from hexservo.run.display import batch_text
from hexservo.run.drawn import html_of
from hexservo.run.metrics import METRICS, asked_metrics, metric_meaning, metric_unit
from hexservo.run.progress import ProgressCallback, Report, reported
from hexservo.run.quantities import quantities
from hexservo.run.result import labelling
from hexservo.run.variant import chosen_kernel
from hexservo.run.variations import (
    changes_of_run,
    checked_variations,
    columns_of,
    fitted_variations,
    unit_of_varied,
)
from hexservo.scenario.arrays import Array
from hexservo.scenario.fields import described
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario, require_scenario
from hexservo.scenario.version import VERSION
from hexservo.scenario.wording import whole_number, wrong_type

if TYPE_CHECKING:
    import pandas
    import xarray

__all__ = ["BatchResult", "simulate_batch", "whole"]

Log: TypeAlias = Literal["final", "metrics", "trajectory"]
_Report: TypeAlias = Callable[[int, int, int, int], object]  # of scenarios done, in all, steps done, in all

_LOGS = {
    "final": _core.BatchLog.last_sample,
    "metrics": _core.BatchLog.metrics,
    "trajectory": _core.BatchLog.trajectory,
}
_OUTCOMES = np.array([outcome.name for outcome in sorted(_core.Outcome, key=lambda outcome: outcome.value)])
_LEG_CAUSES = tuple(
    getattr(_core.StopCause, name) for name in ("leg_limit", "leg_speed", "base_joint", "platform_joint")
)
_CAUSES = np.array([cause.name for cause in sorted(_core.StopCause, key=lambda cause: cause.value)])
_MAX_THREADS = 1024


@described
@dataclass(frozen=True, eq=False, repr=False)
class BatchResult:
    """Results of n scenarios, in the order of their variations. Axis 0 of every array is the scenario.

    Frames and orders: docs/model.md section 1. Arrays share the batch's memory: take a copy of what is to be
    changed.
    """

    scenario: Scenario  # what the variations vary
    # as given, each (n or 1, ...) in the key's own shape; floats, but for seeds, which are uint64
    variations: Mapping[str, NDArray[Any]] = field(repr=False)
    outcome: NDArray[np.str_] = field(repr=False)  # (n,) as Result.outcome
    cause: NDArray[np.str_] = field(repr=False)  # (n,) why a run stopped early: none, not_finite, feature_error, ...
    limit_leg: NDArray[np.int8] = field(repr=False)  # (n,) leg, 1 to 6, that ended a run as leg_limit; 0: none did
    end_time: Array = field(repr=False)  # (n,) [s], time of the last good sample; NaN where interrupted
    stop_time: Array = field(repr=False)  # (n,) [s], time of the step that failed, else of the end; NaN likewise
    metrics: Mapping[str, Array] = field(repr=False)  # asked for: name of hs.METRICS -> (n,); NaN where interrupted
    # log "final": the last good sample, each (n, k); log "trajectory": (n, m, k), NaN from where a run stopped; names,
    # units and orders as in Result; fuzzy_weights (n, 6, 7, 7) likewise. log "metrics": empty. NaN where interrupted.
    samples: Mapping[str, Array] = field(repr=False)
    time: Array | None = field(repr=False)  # (m,) [s], of trajectories
    controller: str | None = None  # name of the custom controller that acted; None: the scenario's law did

    def __repr__(self) -> str:
        """Return the batch in a few lines."""
        return batch_text(self)

    def _repr_html_(self) -> str:
        """Return outcomes, metrics and a figure for a notebook."""
        return html_of(self)

    def __len__(self) -> int:
        """Return the number of scenarios."""
        return len(self.outcome)

    def detail(self, index: int) -> str:
        """Return in one sentence how the run of one scenario ended.

        Raises
        ------
        TypeError
            For an index that is no integer.
        IndexError
            For an index that no scenario has.
        """
        try:
            run = operator.index(index)
        except TypeError:
            raise wrong_type("index", "an integer", index) from None
        if self.outcome[run] == "interrupted":
            return "interrupted before its end"
        cause = _core.StopCause[str(self.cause[run])]
        return _core.describe(cause, float(self.stop_time[run]), int(self.limit_leg[run]) - 1)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the batch as a flat table: a row for each run, with what varies, how it ended, and its metrics.

        Columns: varied keys by their dotted names, entries of arrays as ``controller.hybrid.kv[0]``; ``outcome``,
        ``cause``, ``limit_leg``, ``end_time``, ``stop_time``; metrics by their names in `hs.METRICS`. The index is the
        scenario. ``attrs["units"]`` maps what varies, times and metrics to their units.
        """
        import pandas as pd

        columns: dict[str, Any] = {}
        for key, values in self.variations.items():
            columns |= columns_of(key, np.broadcast_to(values, (len(self), *values.shape[1:])))
        columns |= {name: getattr(self, name) for name in ("outcome", "cause", "limit_leg", "end_time", "stop_time")}
        table = pd.DataFrame({**columns, **self.metrics}, index=pd.RangeIndex(len(self), name="scenario"))
        units = {name: unit for name in columns if (unit := unit_of_varied(self.scenario, name))}
        units |= {name: metric_unit(name, self.scenario.robot) for name in self.metrics}
        table.attrs = {
            "scenario": self.scenario.name,
            "controller": self._acting,
            "units": {"end_time": "s", "stop_time": "s", **units},
        }
        return table

    def to_xarray(self) -> xarray.Dataset:
        """Return the batch as a dataset with the dimension ``scenario``, labelled, with units.

        Outcome, cause, leg and times are variables under their own names, variations under their dotted keys, metrics
        ``metric_...``. Attributes hold text and numbers only, the base scenario as one YAML string (``scenario``). The
        dataset shares no memory with the batch.
        """
        import xarray

        robot = self.scenario.robot
        data: dict[str, Any] = {
            "outcome": ("scenario", self.outcome, {"long_name": "how the run ended"}),
            "cause": ("scenario", self.cause, {"long_name": "why the run stopped early"}),
            "limit_leg": ("scenario", self.limit_leg, {"long_name": "leg, 1 to 6, that ended the run; 0: none did"}),
            "end_time": ("scenario", self.end_time, {"units": "s", "long_name": "time of the last good sample"}),
            "stop_time": (
                "scenario",
                self.stop_time,
                {"units": "s", "long_name": "time of the step that failed, else of the end"},
            ),
        }
        for name, values in self.metrics.items():
            unit, meaning = metric_unit(name, robot), metric_meaning(name, robot)
            data[f"metric_{name}"] = ("scenario", values, {"units": unit, "long_name": meaning})
        for key, values in self.variations.items():
            whole = np.broadcast_to(values, (len(self), *values.shape[1:]))
            axes = [f"{key}_{axis}" for axis in range(1, values.ndim)]
            unit = unit_of_varied(self.scenario, key)
            data[key] = (
                ["scenario", *axes],
                whole,
                {"long_name": f"varied {key}"} | ({"units": unit} if unit else {}),
            )
        coords: dict[str, Any] = {"scenario": np.arange(len(self))}
        middle = [] if self.time is None else ["time"]
        if self.time is not None:
            coords["time"] = ("time", self.time, {"units": "s", "long_name": "time"})
        for name, values in self.samples.items():
            labels, attributes = labelling(self.scenario, name)
            data[name] = (["scenario", *([] if name == "fuzzy_weights" else middle), *labels], values, attributes)
            coords |= labels
        dataset = xarray.Dataset(
            data,
            coords=coords,
            attrs={
                "title": f"hexservo batch of {self.scenario.name}",
                "controller": self._acting,
                "hexservo_version": VERSION,
                "scenario": self.scenario.to_yaml(),
            },
        )
        return dataset.copy(deep=True)  # xarray keeps the arrays it is given, and a dataset may be changed in place

    @property
    def _acting(self) -> str:
        return self.controller or self.scenario.controller.law


def whole(batch: BatchResult) -> BatchResult:
    """Return a batch for findings: no run of it was interrupted.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C ended it, which `simulate_batch` only notes: what it has is incomplete.
    """
    if (batch.outcome == "interrupted").any():
        raise KeyboardInterrupt
    return batch


def metrics_of(batch: BatchResult, row: int) -> dict[str, float]:
    """Return the metrics of one run of a batch, by name."""
    return {name: float(values[row]) for name, values in batch.metrics.items()}


def simulate_batch(
    scenario: Scenario,
    variations: Mapping[str, ArrayLike],
    log: Log = "final",
    threads: int | None = None,
    progress: bool | ProgressCallback | None = None,
    *,
    controller: OwnController | None = None,
    metrics: Literal["all"] | Iterable[str] = "all",
) -> BatchResult:
    """Run many variations of a scenario (docs/batch.md).

    Each run is the scenario with one row of every variation, as ``simulate(scenario.updated({key: row}))`` is, one per
    lane of the processor's vector registers, on all cores. A run depends on its own scenario only: not on the other
    ones, their number or order, nor on the number of threads, bit for bit within one variant. It agrees with `simulate`
    to rounding.

    Parameters
    ----------
    scenario
        What the variations vary.
    variations
        Values by dotted key, ``{"uncertainty.depth": array}``; every key that holds numbers may vary, of the gains
        those of the scenario's law, in SI units and pixels. Axis 0 is the scenario, the others are the key's own shape:
        (8,) on ``controller.hybrid.kp`` are eight scenarios, (n, 8) are n scenarios of eight gains of four points. A
        length of 1 holds for all: (1, 8). Seeds are whole numbers of 64 bits; as floats, up to 2^53.
    log
        What is kept beside outcome, times and metrics: "final", the last good sample and the fuzzy weights; "metrics",
        nothing; "trajectory", every ``simulation.log_every``-th sample, on one time grid, and the final weights.
    threads
        Threads to use, at least 1; None: as many as the process has cores.
    progress
        True draws a bar on standard error; a function is called with (scenarios done, scenarios in all) every 50 ms
        and at the end, in this thread.
    controller
        Custom controller in place of the scenario's law, as for `simulate`. It is a Python function: the runs follow
        one another in this thread, each bit for bit that of `simulate`, and `progress` is called after each. An
        observation with ``tick`` 0 begins a new run.
    metrics
        "all", or names of `hs.METRICS`: what is not asked for takes no time. In continuous mode legs are looked at
        where a metric of theirs or a trajectory is asked for; without, a run passes through singular poses, and only
        its last sample may be ``singular``.

    Returns
    -------
    BatchResult
        A run that diverges is a result, with its outcome and time, and disturbs no other. Ctrl-C ends the batch within
        0.2 s and keeps what is finished; the others are ``interrupted``, with NaN for numbers.

    Raises
    ------
    TypeError
        For anything but a `Scenario`, a mapping and the types above.
    ValueError
        Text "key: expected ..., got ..." for unknown keys, shapes, lengths and metrics, "scenario 17: key: ..." for
        the first bad scenario, before any runs; for a result of more than 2 GiB; for trajectories that differ in their
        times; for a custom controller with more than one thread.
    ScenarioError
        For a custom controller in continuous mode.
    VariantError
        Where the environment variable HEXSERVO_VARIANT asks for a variant that is not there.
    """
    require_scenario(scenario)
    if log not in tuple(_LOGS):  # a tuple: what was given may have no hash
        raise ValueError(f"log: expected one of {', '.join(_LOGS)}, got {log!r}")
    asked = asked_metrics(metrics)
    kernel = chosen_kernel()
    arrays = checked_variations(scenario, variations)
    count = max(len(values) for values in arrays.values())
    if controller is not None:
        return _run_custom(scenario, arrays, count, log, threads, progress, controller, asked)
    varied = fitted_variations(scenario, arrays, bar=progress is True)
    rows = [(key, np.ascontiguousarray(values.reshape(len(values), -1))) for key, values in varied.items()]
    with _reporting(progress) as report:
        run = _core.simulate_batch(
            core_parameters(scenario), rows, count, _LOGS[log], thread_count(threads), kernel, report, asked
        )
    samples = dict(run.samples)
    if run.fuzzy_weights is not None:
        samples["fuzzy_weights"] = run.fuzzy_weights
    return BatchResult(
        scenario=scenario,
        variations=arrays,
        outcome=_OUTCOMES[run.outcome],
        cause=_CAUSES[run.cause],
        limit_leg=run.limit_leg + np.int8(1),
        end_time=run.end_time,
        stop_time=run.stop_time,
        metrics={name: values for name, values in zip(METRICS, run.metrics, strict=True) if name in asked},
        samples=samples,
        time=run.time,
    )


# ---- A custom controller --------------------------------------------------------------------------------------------


_MAX_BYTES = 2 * 2**30  # of a result


def _run_custom(
    scenario: Scenario,
    arrays: Mapping[str, Array],
    count: int,
    log: Log,
    threads: int | None,
    progress: bool | ProgressCallback | None,
    controller: OwnController,
    metrics: tuple[str, ...],
) -> BatchResult:
    """Run one scenario after the other with a Python function as their controller."""
    if not callable(controller):
        raise wrong_type("controller", "a function of an Observation", controller)
    if threads is not None and thread_count(threads) != 1:
        raise ValueError(
            f"threads: expected 1 or None with a custom controller, which runs in one thread, got {threads}"
        )
    require_runnable(scenario)
    law = scenario.controller.law
    scenarios = [scenario.updated(changes_of_run(arrays, law, index)) for index in range(count)]
    time = _common_times(scenarios) if log == "trajectory" else None
    middle = () if time is None else (len(time),)
    shapes: dict[str, tuple[int, ...]] = {}
    if log != "metrics":
        shapes = {name: (*middle, len(labels)) for name, (_, labels, _, _) in quantities(scenario.target.count).items()}
        shapes["fuzzy_weights"] = (6, 7, 7)
    size = 8 * count * (sum(math.prod(shape) for shape in shapes.values()) + len(metrics))
    if size > _MAX_BYTES:
        raise ValueError(f"log: expected a result of at most 2 GiB, got {size / 2**30:.3g} GiB")
    found = BatchResult(
        scenario=scenario,
        variations=arrays,
        outcome=np.full(count, "interrupted", dtype=_OUTCOMES.dtype),
        cause=np.full(count, "none", dtype=_CAUSES.dtype),
        limit_leg=np.zeros(count, dtype=np.int8),
        end_time=np.full(count, np.nan),
        stop_time=np.full(count, np.nan),
        metrics={name: np.full(count, np.nan) for name in metrics},
        samples={name: np.full((count, *shape), np.nan) for name, shape in shapes.items()},
        time=time,
        controller=function_name(controller),
    )
    planned = [round(one.simulation.duration / one.simulation.step) for one in scenarios]
    steps = 0
    with _reporting(progress) as report, contextlib.suppress(KeyboardInterrupt):
        for index, one in enumerate(scenarios):
            try:
                run = run_with(one, controller)
            except Exception as error:
                if hasattr(error, "add_note"):
                    error.add_note(f"in scenario {index} of the batch")
                raise
            if run.outcome == _core.Outcome.interrupted:
                break
            _enter(found, index, run, one)
            steps += planned[index]
            if report is not None:
                report(index + 1, count, steps, sum(planned))
    return found


def _common_times(scenarios: list[Scenario]) -> Array:
    """Return the times of the logged samples [s], which the runs have in common."""
    grids = {(one.simulation.step, one.simulation.duration, one.simulation.log_every) for one in scenarios}
    if len(grids) > 1:
        raise ValueError("log: expected trajectories on one time grid, got scenarios that differ in their times")
    ((step, duration, log_every),) = grids
    steps = round(duration / step)
    return np.union1d(np.arange(0, steps + 1, log_every), steps) * step


def _enter(found: BatchResult, index: int, run: _core.Trajectory, scenario: Scenario) -> None:
    """Enter a run into the arrays of a batch."""
    step = scenario.simulation.step
    stop = run.steps * step
    found.outcome[index] = run.outcome.name
    cause, leg = next(
        (cause, leg)
        for cause in _core.StopCause
        for leg in (range(6) if cause in _LEG_CAUSES else [-1])
        if _core.describe(cause, stop, leg) == run.detail
    )
    found.cause[index], found.limit_leg[index] = cause.name, leg + 1
    found.end_time[index], found.stop_time[index] = run.end_time, stop
    for name, values in found.metrics.items():
        values[index] = getattr(run.metrics, name)
    places = None
    if found.time is not None:  # a run that stopped also has its last good sample, which may be beside the grid
        grid, own = (np.rint(times / step).astype(np.int64) for times in (found.time, run.time))
        _, places, kept = np.intersect1d(grid, own, assume_unique=True, return_indices=True)
    for name, values in found.samples.items():
        samples = getattr(run, name)
        if name == "fuzzy_weights":
            values[index] = samples
        elif places is None:
            values[index] = samples[-1]
        else:
            values[index, places] = samples[kept]


# ---- Threads and progress -------------------------------------------------------------------------------------------


def thread_count(threads: int | None) -> int:
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return whole_number("threads", threads, 1, _MAX_THREADS, "an integer or None")


def _reporting(progress: bool | ProgressCallback | None) -> AbstractContextManager[_Report | None]:
    started = time.monotonic()

    def to_bar(draw: Report) -> _Report:
        def report(done: int, count: int, steps: int, total_steps: int) -> None:
            elapsed = time.monotonic() - started
            rate = f"{steps / elapsed / 1e6:.3g} million steps/s" if elapsed and steps else "checking"
            draw(done, count, steps / total_steps if total_steps else None, rate)

        return report

    def to_function(function: ProgressCallback) -> _Report:
        return lambda done, count, steps, total_steps: function(done, count)

    return reported(progress, "scenarios", to_function, to_bar)
