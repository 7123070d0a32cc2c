"""Measures what a campaign costs beside its runs: time against `simulate_batch` and between engines, and memory.

Run it as ``python benchmarks/campaign.py``; ``--help`` has the options. Whatever is compared is timed in turn, with the
same scenarios, so that other work of the machine burdens both; the medians of the paired ratios are printed, and the
tables are compared bit for bit.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import hexservo as hs
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.run.machine import describe_machine

MEGABYTE = 1024  # of the kilobytes that Linux counts
CHUNKS = 8  # of a campaign that engines are compared with, so that two workers end at about the same time


def compared(first: Callable[[], float], second: Callable[[], float], pairs: int) -> tuple[float, str]:
    """Return the median of the times of the first one in parts of the second's, and every ratio."""
    ratios = []
    for pair in range(pairs):  # who begins alternates
        times = {each: each() for each in ((first, second) if pair % 2 else (second, first))}
        ratios.append(times[first] / times[second])
    return statistics.median(ratios), ", ".join(f"{ratio:.1%}" for ratio in ratios)


def against_a_batch(name: str, runs: int, pairs: int) -> None:
    """Print the throughput of a campaign in parts of that of `simulate_batch`."""
    plan = load_plan(name, runs=runs)
    drawing = plan.drawing()
    drawn = drawing.variations(drawing.numbers(0, runs))
    base = plan.scenario.updated(drawing.base)
    tables: dict[str, dict[str, bytes]] = {}

    def batch() -> float:
        started = time.perf_counter()
        result = hs.simulate_batch(base, drawn, "metrics", metrics=plan.kept_metrics())
        ended = time.perf_counter()
        columns = {"end_time": result.end_time, **result.metrics}
        tables["simulate_batch"] = {column: values.tobytes() for column, values in columns.items()}
        return ended - started

    def campaign() -> float:
        seconds, result = timed(plan)
        tables["campaign"] = result
        rates.append(runs / seconds)
        return seconds

    rates: list[float] = []
    ratio, ratios = compared(batch, campaign, pairs)
    for column, values in tables["simulate_batch"].items():
        if tables["campaign"][column] != values:
            raise SystemExit(f"{column}: expected that of simulate_batch, bit for bit, got another one")
    print(f"{name}: {statistics.median(rates):.0f} runs/s, {ratio:.1%} of simulate_batch ({ratios})")


def against_a_cluster(name: str, runs: int, pairs: int) -> None:
    """Print the throughput of two Dask workers of one thread in parts of that of two threads in this process."""
    from distributed import LocalCluster

    tables: dict[str, dict[str, bytes]] = {}
    plan = load_plan(name, runs=runs, chunk_size=-(-runs // CHUNKS))
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:

        def on(engine: str, threads: int | None) -> Callable[[], float]:
            def once() -> float:
                seconds, tables[engine] = timed(plan, engine, threads)
                return seconds

            return once

        dask = on(cluster.scheduler_address, None)
        dask()  # the workers import the package
        ratio, ratios = compared(on("local", 2), dask, pairs)
    first, second = tables.values()
    if first != second:
        raise SystemExit("expected the same table from both engines, bit for bit, got two")
    print(f"{name}: two Dask workers of one thread have {ratio:.1%} of the throughput of two threads ({ratios})")


def timed(plan: CampaignPlan, engine: str = "local", threads: int | None = None) -> tuple[float, dict[str, bytes]]:
    """Run a campaign, and return its time [s] and the bytes of its table."""
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        result = hs.campaign(plan, Path(folder) / "out", engine=engine, threads=threads)
        seconds = time.perf_counter() - started
        names = ["end_time", *plan.kept_metrics()]
        return seconds, {name: result.to_arrow([name]).column(0).to_numpy().tobytes() for name in names}


def memory_of(name: str, runs: int) -> None:
    """Print the peak of the memory during a campaign of so many runs, each of which ends after ten steps."""
    plan = load_plan(name, runs=runs)
    steps = {"simulation.duration": 10 * plan.scenario.simulation.step, "metrics.rms_start": 0.0}
    short = plan.changed(scenario=plan.scenario.updated(steps), require=["outcome == completed"], metrics=["rms_error"])
    peaks: list[str] = []

    def look(done: int, count: int) -> None:
        if done * 10 >= count * (len(peaks) + 1):
            peaks.append(f"{peak():.0f} MB")

    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        result = hs.campaign(short, Path(folder) / "out", progress=look)
        seconds = time.perf_counter() - started
        held = sum(file.stat().st_size for file in Path(folder).rglob("*.parquet")) / 1e9
        low, high = result.interval
        print(
            f"{name}, ten steps each: {len(result)} runs in {seconds:.0f} s, {held:.2f} GB of chunks, interval "
            f"{low:.2g} ... {high:.2g}; at most {peak():.0f} MB; after each tenth of the runs: {', '.join(peaks)}"
        )


def peak() -> float:
    """Return the largest resident memory of this process until now [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE


def main() -> None:
    """Measure what the options ask for."""
    parser = argparse.ArgumentParser(description="What a campaign costs beside its runs")
    parser.add_argument("campaign", nargs="?", default="campaign-composite-30hz", help="(%(default)s)")
    parser.add_argument("--runs", type=int, default=20000, help="(%(default)s)")
    parser.add_argument("--pairs", type=int, default=5, help="repetitions of each comparison (%(default)s)")
    parser.add_argument("--dask", action="store_true", help="compare two Dask workers with two threads")
    parser.add_argument("--memory", action="store_true", help="measure the memory that so many runs take")
    given = parser.parse_args()
    machine = describe_machine()
    print(f"{machine['date']}, {machine['cpu']}, {machine['processors']} processors, {machine['core']['variant']}")
    if given.memory:
        memory_of(given.campaign, given.runs)
    elif given.dask:
        against_a_cluster(given.campaign, given.runs, given.pairs)
    else:
        against_a_batch(given.campaign, given.runs, given.pairs)


if __name__ == "__main__":
    main()
