"""Measures this machine: the servo tick's latency, and the rates of single runs and batches (BENCHMARKS.md).

The loops that are timed are C++. Every result is checked before it is timed.
"""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexservo import _core
from hexservo.run.batch import thread_count
from hexservo.run.machine import describe_machine
from hexservo.run.variant import available_variants, load_kernel
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import LAWS, THEOREM_LAW
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import Scenario, load_scenario

Say: TypeAlias = Callable[[str], object]
Work: TypeAlias = Literal["single", "batch"]

FLOPS_PER_STEP = 10_000.0
"""Additions and multiplications of one Runge-Kutta step of the closed loop with its fuzzy systems, about."""

TICK_RATES = (1000.0, 2000.0, 4000.0, 10000.0)  # of the paced ticks [Hz]
_BINS_PER_DECADE = 8
_EDGES = np.round(10.0 ** (np.arange(_BINS_PER_DECADE, 10 * _BINS_PER_DECADE + 1) / _BINS_PER_DECADE), 3)  # [ns]
_KNOWN = {"settling_time": (0.353, 0.02 * 0.353), "final_error": (0.080, 0.02)}  # paper, docs/model.md section 8
_LANE_TOLERANCE = 1e-9  # between a lane and a single run on the smooth loop [px]
_SIGN_TOLERANCE = 0.02  # the same where the force jumps with the sign of a velocity [px]


class BenchmarkError(RuntimeError):
    """A timed computation gave a wrong result."""


@dataclass(frozen=True)
class Plan:
    """Durations and repetitions of the measurements."""

    ticks: int = 1_000_000  # of the paper's law, free-running
    seconds: float = 3.0  # of every rate
    realtime: bool = False  # ask for SCHED_FIFO and locked memory
    rounds: int = 9  # of the rates
    duration: float = 5.0  # of every run [s]
    scenarios: int = 64  # per thread, in a batch

    @property
    def law_ticks(self) -> int:
        """Free-running ticks of each other law: a fifth, and enough for a 99.9 % quantile."""
        return max(1000, self.ticks // 5)


QUICK = Plan(ticks=200_000, seconds=0.4, rounds=3, duration=1.0)


@dataclass(frozen=True)
class Distribution:
    """Times of many ticks, in seconds; `counts` are those between two neighbours of `edges`."""

    median: float
    percentile_99: float
    percentile_99_9: float
    maximum: float
    edges: tuple[float, ...]
    counts: tuple[int, ...]


@dataclass(frozen=True)
class TickTiming:
    """Ticks of one law at one rate."""

    law: str
    rate: float | None  # [Hz]; None: free-running
    ticks: int
    periods: int
    missed: int  # periods whose tick had not ended when the next one began
    latency: Distribution
    lateness: Distribution | None  # of the wake-ups: jitter
    clock_cost: float  # of one reading of the clock, in every latency [s]
    scheduling: str
    memory: str
    wrench_difference: float  # largest, to the run that is replayed [N; N m]
    load_average: float


@dataclass(frozen=True)
class Speed:
    """Medians over the rounds, for one step of one scenario."""

    work: Work
    variant: str
    threads: int
    scenarios: int
    wall: float  # [s]
    wall_quartiles: tuple[float, float]
    processor: float  # of all threads [s]
    processor_quartiles: tuple[float, float]
    real_time: float  # simulated seconds per second
    peak: float  # of one core in this variant's multiply-adds, measured in the same rounds [GFLOP/s]
    share: float  # of that peak that a core gives while it works, at FLOPS_PER_STEP


@dataclass(frozen=True)
class Ratio:
    """Median of the rounds' own ratios, with quartiles."""

    name: str
    clock: Literal["processor", "wall"]
    value: float
    quartiles: tuple[float, float]
    load_average: float  # after the last round: a busy machine has no second core to give


@dataclass(frozen=True)
class Benchmark:
    """Everything that was measured."""

    machine: dict[str, Any]
    variants: dict[str, dict[str, Any]]
    plan: Plan
    ticks: tuple[TickTiming, ...]
    speeds: tuple[Speed, ...]
    ratios: tuple[Ratio, ...]

    def to_json(self) -> str:
        """Return all numbers, in SI units, for strict JSON."""
        content = {"flops_per_step": FLOPS_PER_STEP, **asdict(self)}
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def benchmark(plan: Plan, say: Say = lambda text: None) -> Benchmark:
    """Measure ticks of all laws on the scenario ``paper``, and the rates of its runs.

    Parameters
    ----------
    plan
        How long.
    say
        Called with the name of each measurement.

    Raises
    ------
    BenchmarkError
        Where an answer is wrong.
    KeyboardInterrupt
        After Ctrl-C, at once.
    """
    machine = describe_machine()
    kernels = {name: load_kernel(name) for name in available_variants()}
    scenario = load_scenario("paper")
    ticks = []
    for rate in (None, *TICK_RATES):
        say("ticks, free-running" if rate is None else f"ticks at {rate / 1e3:g} kHz")
        ticks.append(_time_ticks(scenario, rate, plan))
    for law in LAWS:
        if law != scenario.controller.law:
            say(f"ticks of {law}")
            ticks.append(_time_ticks(_replayed(scenario, law), None, plan))
    say("answers of the variants")
    for kernel in kernels.values():
        _check_answers(scenario, kernel)
    speeds, ratios = _time_runs(scenario, kernels, plan, say)
    variants = {name: {"lanes": kernel.lanes, "flags": kernel.flags} for name, kernel in kernels.items()}
    return Benchmark(machine, variants, plan, tuple(ticks), speeds, ratios)


def _parameters(scenario: Scenario) -> _core.Settings:
    """Return the core's settings of a scenario of the law whose runs are measured."""
    parameters = core_parameters(scenario)
    if parameters.law != THEOREM_LAW:
        raise ValueError(f"controller.law: expected {THEOREM_LAW}, got {scenario.controller.law}")
    return parameters


def _replayed(scenario: Scenario, law: str) -> Scenario:
    """Return the run of another law that its ticks replay.

    A tick has no depth error and a run's law does (docs/model.md, section 5, ``pbvs``), so there is none.
    """
    return scenario.updated({"controller.law": law, "uncertainty.depth": 0.0})


def _time_ticks(scenario: Scenario, rate: float | None, plan: Plan) -> TickTiming:
    law = scenario.controller.law
    if rate is None:
        periods = plan.ticks if law == THEOREM_LAW else plan.law_ticks
    else:
        periods = max(1, round(plan.seconds * rate))
    times = _core.time_ticks(core_parameters(scenario), periods, rate or 0.0, plan.realtime)
    if times.interrupted:
        raise KeyboardInterrupt
    what = f"ticks of {law}, free-running" if rate is None else f"ticks of {law} at {rate:g} Hz"
    _require(times.invalid == 0, what, "no invalid input", f"{times.invalid} of them")
    _require(times.reproduced, what, "the same outputs in every replay", "others")
    difference, allowed = times.wrench_difference, _tick_tolerance(scenario.controller.traits)
    _require(difference <= allowed, what, f"the run's wrenches to {allowed:g}", f"{difference:.2g} off")
    return TickTiming(
        law=law,
        rate=rate,
        ticks=len(times.latency),
        periods=times.periods,
        missed=times.missed,
        latency=_distribution(times.latency),
        lateness=None if rate is None else _distribution(times.lateness),
        clock_cost=times.clock_cost * 1e-9,
        scheduling=times.scheduling,
        memory=times.memory,
        wrench_difference=difference,
        load_average=os.getloadavg()[0],
    )


def _tick_tolerance(law: _core.LawTraits) -> float:
    """Return the largest difference between a tick's wrench and the run's [N; N m].

    Laws with weights adapt by forward Euler in a tick and by Runge-Kutta in a run. At 1 ms that makes 1.2e-4, and
    9.4e-4 where a pose error drives them; without weights only roundings differ.
    """
    if not law.memory:
        return 1e-9
    return 2e-3 if law.pose_error else 5e-4


def _distribution(nanoseconds: NDArray[np.uint32]) -> Distribution:
    # Times that were measured, not means of two of them.
    median, p99, p999, largest = np.percentile(nanoseconds, [50, 99, 99.9, 100], method="higher") * 1e-9
    counts, _ = np.histogram(np.clip(nanoseconds, _EDGES[0], _EDGES[-1]), _EDGES)
    used = np.flatnonzero(counts)
    first, last = used[0], used[-1] + 1
    return Distribution(
        median=float(median),
        percentile_99=float(p99),
        percentile_99_9=float(p999),
        maximum=float(largest),
        edges=tuple(float(f"{edge:.6g}") for edge in _EDGES[first : last + 1] * 1e-9),
        counts=tuple(map(int, counts[first:last])),
    )


_DEPTH = "uncertainty.depth"  # what varies in a batch


def _single(parameters: _core.Settings, kernel: _core.Kernel) -> _core.Trajectory:
    run = _core.simulate(parameters, kernel)
    if run.outcome is _core.Outcome.interrupted:
        raise KeyboardInterrupt
    _require(run.outcome is _core.Outcome.completed, f"a run ({kernel.name})", "completed", run.detail)
    return run


def _batch(parameters: _core.Settings, depth_errors: Array, threads: int, kernel: _core.Kernel) -> _core.BatchResult:
    rows = [(_DEPTH, depth_errors.reshape(-1, 1))]
    batch = _core.simulate_batch(parameters, rows, len(depth_errors), _core.BatchLog.metrics, threads, kernel)
    if (batch.outcome == _core.Outcome.interrupted.value).any():
        raise KeyboardInterrupt
    completed = int((batch.outcome == _core.Outcome.completed.value).sum())
    _require(completed == len(depth_errors), f"a batch ({kernel.name})", f"{len(depth_errors)} completed", completed)
    return batch


def _depth_errors(count: int) -> Array:
    return np.linspace(-0.3, 0.3, count)


def _metrics(run: _core.Trajectory) -> Array:
    return np.array([getattr(run.metrics, name) for name in _METRIC_NAMES])


_METRIC_NAMES = ("final_error", "peak_error", "peak_leg_force")
_METRIC_ROWS = (1, 3, 10)  # of a batch's metrics


def _check_answers(scenario: Scenario, kernel: _core.Kernel) -> None:
    """Compare a variant's run of ``paper`` with the known results, and lanes with single runs."""
    run = _single(_parameters(scenario), kernel)
    for name, (expected, allowed) in _KNOWN.items():
        value = getattr(run.metrics, name)
        what = f"{name} of paper ({kernel.name})"
        _require(abs(value - expected) <= allowed, what, f"{expected} to {allowed:.2g}", value)
    for kind, tolerance in (("tanh", _LANE_TOLERANCE), ("sign", _SIGN_TOLERANCE)):
        changed = scenario.updated({"controller.switching.kind": kind, "simulation.duration": 0.5})
        depth_errors = _depth_errors(2 * kernel.lanes + 1)  # packs that are not full, too
        batch = _batch(_parameters(changed), depth_errors, 2, kernel)
        for lane, depth in enumerate(depth_errors):
            alone = _metrics(_single(_parameters(changed.updated({_DEPTH: float(depth)})), kernel))
            difference = np.abs(batch.metrics[list(_METRIC_ROWS), lane] - alone).max()
            what = f"scenario {lane} of a batch ({kernel.name}, {kind})"
            _require(difference <= tolerance, what, f"the single run to {tolerance:g}", f"{difference:.2g} off")


@dataclass
class _Rounds:
    """Times of one kind of run, round by round, per step of one scenario [s]."""

    wall: list[float]
    processor: list[float]


def _time_runs(
    scenario: Scenario, kernels: dict[str, _core.Kernel], plan: Plan, say: Say
) -> tuple[tuple[Speed, ...], tuple[Ratio, ...]]:
    """Alternate: in every round each variant runs alone, in a batch on one thread and on all, and at its peak."""
    scenario = scenario.updated({"simulation.duration": plan.duration, "simulation.log_every": 50})
    parameters = _parameters(scenario)
    steps = _core.step_count(parameters["simulation.step"], parameters["simulation.duration"])
    processors = thread_count(None)
    thread_counts = tuple(dict.fromkeys((1, processors)))
    count = plan.scenarios * processors  # the same batch for every number of threads
    depth_errors = _depth_errors(count)
    calls = max(1, 100_000 // steps)
    rounds: dict[tuple[str, Work, int], _Rounds] = {}
    peaks: dict[str, list[float]] = {name: [] for name in kernels}
    finals: dict[str, Array] = {}

    def timed(key: tuple[str, Work, int], run: Callable[[], object], units: int, keep: bool) -> None:
        processor, wall = time.process_time(), time.perf_counter()
        run()
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        if keep:
            taken = rounds.setdefault(key, _Rounds([], []))
            taken.wall.append(wall / units)
            taken.processor.append(processor / units)

    def batch_of(kernel: _core.Kernel, threads: int) -> None:
        final = _batch(parameters, depth_errors, threads, kernel).metrics[1]
        expected = finals.setdefault(kernel.name, final)
        same = bool((final == expected).all())
        _require(same, f"a batch on {threads} threads ({kernel.name})", "the results of one thread", "others")

    for turn in range(plan.rounds + 1):  # the first one warms up
        say(f"runs, round {turn} of {plan.rounds}")
        for name, kernel in list(kernels.items())[:: 1 if turn % 2 else -1]:
            keep = turn > 0
            if keep:
                peaks[name].append(kernel.fma_peak(0.02))
            alone = lambda kernel=kernel: [_single(parameters, kernel) for _ in range(calls)]  # noqa: E731
            timed((name, "single", 1), alone, calls * steps, keep)
            for threads in thread_counts:
                together = lambda kernel=kernel, threads=threads: batch_of(kernel, threads)  # noqa: E731
                timed((name, "batch", threads), together, count * steps, keep)

    speeds = []
    for (name, work, threads), taken in rounds.items():
        peak, processor = statistics.median(peaks[name]), statistics.median(taken.processor)
        wall = statistics.median(taken.wall)
        speeds.append(
            Speed(
                work=work,
                variant=name,
                threads=threads,
                scenarios=1 if work == "single" else count,
                wall=wall,
                wall_quartiles=_quartiles(taken.wall),
                processor=processor,
                processor_quartiles=_quartiles(taken.processor),
                real_time=scenario.simulation.step / wall,
                peak=peak,
                share=FLOPS_PER_STEP / processor / (peak * 1e9),
            )
        )
    order = list(kernels)
    speeds.sort(key=lambda speed: (speed.work != "single", speed.threads, order.index(speed.variant)))
    return tuple(speeds), tuple(_ratios(rounds, processors))


def _ratios(rounds: dict[tuple[str, Work, int], _Rounds], processors: int) -> Iterable[Ratio]:
    """Compare what the rounds have in common, round by round."""
    for name in dict.fromkeys(key[0] for key in rounds):
        batch = rounds[name, "batch", 1]
        for other in dict.fromkeys((name, "baseline")):
            single = rounds[other, "single", 1]
            text = f"one run ({other}) to a batch on one thread ({name})"
            yield _ratio(text, "processor", single.processor, batch.processor)
        if processors > 1:
            both = rounds[name, "batch", processors]
            yield _ratio(f"a batch on one thread to one on {processors} ({name})", "wall", batch.wall, both.wall)


def _ratio(name: str, clock: Literal["processor", "wall"], slow: list[float], fast: list[float]) -> Ratio:
    values = [a / b for a, b in zip(slow, fast, strict=True)]
    return Ratio(name, clock, statistics.median(values), _quartiles(values), os.getloadavg()[0])


def _quartiles(values: list[float]) -> tuple[float, float]:
    if len(values) < 2:
        return values[0], values[0]
    first, _, third = statistics.quantiles(values, n=4, method="inclusive")
    return first, third


def _require(right: bool, what: str, expected: object, got: object) -> None:
    if not right:
        raise BenchmarkError(f"{what}: expected {expected}, got {got}")
