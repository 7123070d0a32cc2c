"""How the core's speed compares with a bare loop, and its modes and laws with each other: ratios, all in one run.

`make bench-ratios` runs it. A round times each work once, in an order that changes from round to round; a ratio is the
median of the rounds' own ratios of processor times, so that the machine and its neighbours disturb both sides alike.
The bare loop is benchmarks/kernels/bare_loop: the arithmetic of the paper's closed loop and nothing else, compiled with
the flags of the variant that it is compared with, and timed after its answer is checked.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tables import ROOT, replace_block, table

import hexservo as hs
from hexservo import _core
from hexservo.cli.bench import spell
from hexservo.run.batch import thread_count
from hexservo.run.bench import BenchmarkError
from hexservo.run.machine import describe_machine
from hexservo.run.variant import available_variants, load_kernel
from hexservo.scenario.parameters import core_parameters

sys.path.insert(0, str(ROOT / "benchmarks" / "peers"))
from problem import Array, Problem, problem_of

BARE_LOOP = ROOT / "benchmarks" / "kernels" / "bare_loop" / "bare_loop.cpp"
DEPTH = "uncertainty.depth"  # what varies in a batch
SMOOTH_TOLERANCE = 1e-9  # between bare loop and core where only roundings differ [px]
SIGN_TOLERANCE = 0.02  # the same where the force jumps with the sign of a velocity [px]

SAMPLED: dict[str, Any] = {"simulation.mode": "sampled"}
PREDICTION: dict[str, Any] = {
    **SAMPLED,
    "camera.period": 0.01,
    "camera.latency": 0.01,
    "camera.prediction": "encoder",
}
ENCODERS: dict[str, Any] = {**SAMPLED, "sensors.pose": "encoders"}
COMPOSITE: dict[str, Any] = {"controller.law": "composite"}
PBVS: dict[str, Any] = {"controller.law": "pbvs"}

# name -> what `paper` is changed by; all metrics are measured but in `FINAL`
BATCHES: dict[str, dict[str, Any]] = {
    "batch": {},
    "sampled": SAMPLED,
    "prediction": PREDICTION,
    "encoders": ENCODERS,
    "composite": COMPOSITE,
    "pbvs": PBVS,
    "composite, sampled": {**COMPOSITE, **SAMPLED},
    "pbvs, sampled": {**PBVS, **SAMPLED},
}
SINGLES = ("composite", "pbvs", "composite, sampled", "pbvs, sampled")  # also timed as one run
BARE, FINAL, THREADS, ONE_RUN = "bare loop", 'batch, log="final"', "batch, all threads", "one run: "


@dataclass(frozen=True)
class Wanted:
    """A ratio of two works, and the largest that is aimed at."""

    name: str
    work: str
    to: str
    limit: float


WANTED = (
    Wanted('batch, log="final" without metrics, to the bare loop', FINAL, BARE, 1.25),
    Wanted('batch, log="metrics" with all of them, to the bare loop', "batch", BARE, 1.4),
    Wanted("sampled mode to continuous mode", "sampled", "batch", 0.6),
    Wanted("the same with prediction between frames of 100 Hz", "prediction", "batch", 0.7),
    Wanted("the same with encoders", "encoders", "batch", 0.9),
    Wanted("pbvs to composite, batch", "pbvs", "composite", 2.0),
    Wanted("pbvs to composite, one run", f"{ONE_RUN}pbvs", f"{ONE_RUN}composite", 2.0),
    Wanted("pbvs to composite, batch in sampled mode", "pbvs, sampled", "composite, sampled", 2.0),
    Wanted(
        "pbvs to composite, one run in sampled mode", f"{ONE_RUN}pbvs, sampled", f"{ONE_RUN}composite, sampled", 2.0
    ),
)
THREAD_GAIN = 1.9  # of two threads over one, in wall-clock time, at least


@dataclass(frozen=True)
class Plan:
    """How much is measured."""

    rounds: int = 9
    duration: float = 5.0  # of every run [s]; what begins a run takes some 50 steps' time
    scenarios: int = 32  # in a batch; a multiple of every variant's lanes


QUICK = Plan(rounds=3, scenarios=16)


@dataclass(frozen=True)
class Ratio:
    """Median of the rounds' own ratios of a variant, with quartiles."""

    name: str
    variant: str
    clock: str  # processor or wall
    value: float
    quartiles: tuple[float, float]
    wanted: float
    at_least: bool  # otherwise at most
    work: float  # medians of the two times, for a step of one scenario [s]
    to: float

    @property
    def reached(self) -> bool:
        """Whether it is as wanted."""
        return self.value >= self.wanted if self.at_least else self.value <= self.wanted


# ---- The bare loop --------------------------------------------------------------------------------------------------


def compiler() -> list[str]:
    """Return the command of the C++ compiler, CXX of the environment or c++."""
    return shlex.split(os.environ.get("CXX", "")) or ["c++"]


class BareLoop:
    """The bare loop compiled for one variant of the core."""

    def __init__(self, kernel: _core.Kernel, folder: Path) -> None:
        library = folder / f"bare_loop_{kernel.name}.so"
        options = [*shlex.split(kernel.flags), f"-DLANES={kernel.lanes}", "-fPIC", "-fvisibility=hidden", "-shared"]
        done = subprocess.run(
            [*compiler(), *options, str(BARE_LOOP), "-o", str(library)], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise BenchmarkError(f"the bare loop was not compiled: {done.stderr.strip()}")
        self._run = ctypes.CDLL(str(library)).bare_loop
        pointer = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
        self._run.argtypes = [pointer, pointer, ctypes.c_long, ctypes.c_long, pointer]
        self._run.restype = None

    def features(self, problem: Problem, depth_errors: Array) -> Array:
        """Run a scenario with each depth error, and return the image at the end (n, 8) [px]."""
        features = np.empty((len(depth_errors), 8))
        self._run(_numbers(problem), depth_errors, len(depth_errors), problem.steps, features)
        return features


def _numbers(p: Problem) -> Array:
    """Return the members of `Numbers` of the bare loop, in their order."""
    actual = 1.0 - p.inertia_error
    return np.concatenate(
        [
            [p.step, p.focal, p.switching_width if p.switching == "tanh" else 0.0, 1.0 / p.bell_width],
            *(1.0 / p.adaptation, p.error_scale, p.rate_scale, p.kp, p.kv, p.desired, p.points.ravel(), p.home),
            *(p.inertia, [1.0 - p.coriolis_error, p.gravity_error * p.gravity_wrench_z]),
            *([1.0 / (actual * p.mass)], 1.0 / (actual * p.inertia)),
        ]
    )


# ---- The core -------------------------------------------------------------------------------------------------------


def batch_of(
    scenario: hs.Scenario, depth_errors: Array, kernel: _core.Kernel, log: str = "metrics", threads: int = 1
) -> Callable[[], _core.BatchResult]:
    """Prepare a batch; "final" is without metrics. Raises BenchmarkError where a run does not end as it should."""
    parameters, rows = core_parameters(scenario), [(DEPTH, depth_errors.reshape(-1, 1))]
    kept = _core.BatchLog.last_sample if log == "final" else _core.BatchLog.metrics
    metrics: list[str] | None = [] if log == "final" else None

    def run() -> _core.BatchResult:
        batch = _core.simulate_batch(parameters, rows, len(depth_errors), kept, threads, kernel, None, metrics)
        _require_completed(batch.outcome.tolist())
        return batch

    return run


def single(scenario: hs.Scenario, kernel: _core.Kernel) -> Callable[[], object]:
    """Prepare one run."""
    parameters = core_parameters(scenario)

    def run() -> object:
        found = _core.simulate(parameters, kernel)
        _require_completed([found.outcome.value])
        return found

    return run


def _require_completed(outcomes: list[int]) -> None:
    if _core.Outcome.interrupted.value in outcomes:
        raise KeyboardInterrupt
    if set(outcomes) != {_core.Outcome.completed.value}:
        raise BenchmarkError(f"expected completed runs, got outcomes {sorted(set(outcomes))}")


def scenario_of(changes: dict[str, Any], duration: float) -> hs.Scenario:
    """Give `paper`, changed."""
    return hs.load_scenario("paper").updated(
        {**changes, "simulation.duration": duration, "simulation.log_every": 50, "metrics.rms_start": 0.0}
    )


def check_answer(bare: BareLoop, kernel: _core.Kernel, duration: float = 0.5) -> None:
    """Compare the images at the end with the core's: of the smooth loop, and of the one that is timed.

    Raises
    ------
    BenchmarkError
        Where they differ by more than roundings explain.
    """
    depth_errors = np.linspace(-0.3, 0.3, 2 * kernel.lanes)
    for kind, allowed in (("tanh", SMOOTH_TOLERANCE), ("sign", SIGN_TOLERANCE)):
        scenario = scenario_of({"controller.switching.kind": kind}, duration)
        problem = problem_of(scenario)
        error = batch_of(scenario, depth_errors, kernel, "final")().samples["feature_error"]
        difference = np.abs(problem.desired - bare.features(problem, depth_errors) - error).max()
        if not difference <= allowed:
            raise BenchmarkError(
                f"bare loop ({kernel.name}, {kind}): expected the core's image to {allowed:g} px, "
                f"got a difference of {difference:.2g} px"
            )


# ---- Rounds ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Work:
    """Something to time, and how many steps of a scenario it takes."""

    run: Callable[[], object]
    steps: int


def works(kernel: _core.Kernel, bare: BareLoop, plan: Plan) -> dict[str, Work]:
    """Give everything that is timed in a variant."""
    depth_errors = np.linspace(-0.3, 0.3, plan.scenarios)
    scenarios = {name: scenario_of(changes, plan.duration) for name, changes in BATCHES.items()}
    problem = problem_of(scenarios["batch"])
    together = plan.scenarios * problem.steps
    found = {
        BARE: Work(lambda: bare.features(problem, depth_errors), together),
        FINAL: Work(batch_of(scenarios["batch"], depth_errors, kernel, "final"), together),
    }
    for name, scenario in scenarios.items():
        found[name] = Work(batch_of(scenario, depth_errors, kernel), together)
    if thread_count(None) > 1:
        found[THREADS] = Work(batch_of(scenarios["batch"], depth_errors, kernel, threads=2), together)
    for name in SINGLES:
        found[ONE_RUN + name] = Work(single(scenarios[name], kernel), problem.steps)
    return found


Times = dict[str, list[tuple[float, float]]]  # of each work, round by round: processor and wall, for a step [s]


def time_rounds(todo: dict[str, Work], rounds: int) -> Times:
    """Time each work once in every round; the first round only warms up."""
    times: Times = {name: [] for name in todo}
    for turn in range(rounds + 1):
        for name, work in list(todo.items())[:: 1 if turn % 2 else -1]:
            processor, wall = time.process_time(), time.perf_counter()
            work.run()
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            if turn > 0:
                times[name].append((processor / work.steps, wall / work.steps))
    return times


def ratios_of(variant: str, times: Times) -> Iterator[Ratio]:
    """Form what is wanted of the times of a variant."""

    def ratio(wanted: Wanted, clock: str, at_least: bool) -> Ratio:
        index = ("processor", "wall").index(clock)
        work, to = ([each[index] for each in times[name]] for name in (wanted.work, wanted.to))
        values = [a / b for a, b in zip(work, to, strict=True)]
        middle = statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else values * 3
        return Ratio(
            *(wanted.name, variant, clock, statistics.median(values), (middle[0], middle[2])),
            *(wanted.limit, at_least, statistics.median(work), statistics.median(to)),
        )

    for wanted in WANTED:
        yield ratio(wanted, "processor", at_least=False)
    if THREADS in times:
        yield ratio(Wanted("one thread to two", "batch", THREADS, THREAD_GAIN), "wall", at_least=True)


def measure(plan: Plan, variants: tuple[str, ...], say: Callable[[str], object] = lambda text: None) -> list[Ratio]:
    """Check the answers of the bare loop, then measure all ratios.

    Raises
    ------
    BenchmarkError
        Where an answer is wrong, or the bare loop cannot be compiled.
    """
    found: list[Ratio] = []
    with tempfile.TemporaryDirectory() as folder:
        for variant in variants:
            kernel = load_kernel(variant)
            bare = BareLoop(kernel, Path(folder))
            check_answer(bare, kernel)
            todo = works(kernel, bare, plan)
            say(f"{variant}: {plan.rounds} rounds")
            found += ratios_of(variant, time_rounds(todo, plan.rounds))
    return found


def measured_variants() -> tuple[str, ...]:
    """Return the variants whose packs are meant to be fast: those of AVX, or the only one."""
    return tuple(name for name in available_variants() if name != "baseline") or ("baseline",)


# ---- Report ---------------------------------------------------------------------------------------------------------


def where(machine: dict[str, Any]) -> str:
    """Return machine, date and compilers."""
    version = subprocess.run([*compiler(), "--version"], capture_output=True, text=True, check=True).stdout
    return (
        f"{machine['date'][:10]}; {machine['cpu']}, {machine['processors']} processors, {machine['system']}; core: "
        f"{machine['core']['compiler']}; bare loop: {version.splitlines()[0]}; "
        f"load average at the start {machine['load_average']:.1f}"
    )


def lines_of(ratios: list[Ratio]) -> list[str]:
    """Give the table."""
    rows = [
        [
            ratio.name,
            ratio.variant,
            ratio.clock,
            f"{spell(ratio.work)} / {spell(ratio.to)}",
            f"**{ratio.value:.2f}**",
            "{:.2f} to {:.2f}".format(*ratio.quartiles),
            f"{'≥' if ratio.at_least else '≤'} {ratio.wanted:g}",
            "yes" if ratio.reached else "no",
        ]
        for ratio in ratios
    ]
    return table("ratio of | variant | time | per step: | median: | quartiles: | aimed at: | reached", rows)


def main() -> int:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few rounds, and nothing is written to BENCHMARKS.md")
    parser.add_argument("--json", type=Path, help="file for all numbers")
    arguments = parser.parse_args()
    machine = describe_machine()
    plan = QUICK if arguments.quick else Plan()
    try:
        ratios = measure(plan, measured_variants(), lambda text: print(text, file=sys.stderr, flush=True))
    except BenchmarkError as error:
        print(f"ratios: {error}", file=sys.stderr)
        return 1
    lines = ["", where(machine), "", *lines_of(ratios), ""]
    print("\n".join(lines))
    if arguments.json:
        content = {"machine": machine, "plan": asdict(plan), "ratios": [asdict(ratio) for ratio in ratios]}
        arguments.json.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if not arguments.quick:
        replace_block(ROOT / "BENCHMARKS.md", "ratios", "\n".join([*lines, ""]))
        print("written: the table of ratios in BENCHMARKS.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
