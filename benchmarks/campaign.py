"""Measures what a campaign costs beside its runs: its throughput against `simulate_batch` on the same scenarios.

Run it as ``python benchmarks/campaign.py [campaign] [runs] [repetitions]``. Both ways are timed in turn in one process,
so that whatever else the machine does burdens both; the medians of the paired ratios are printed.
"""

from __future__ import annotations

import resource
import statistics
import sys
import tempfile
import time
from pathlib import Path

import hexservo as hs
from hexservo.campaigns.plan import load_plan
from hexservo.run.machine import describe_machine


def main(name: str = "campaign-composite-30hz", runs: str = "20000", repetitions: str = "5") -> None:
    """Time campaign and batch in turn, and print both rates and their ratio."""
    plan = load_plan(name, runs=int(runs))
    kept = plan.kept_metrics()
    drawing = plan.drawing()
    drawn = drawing.variations(drawing.numbers(0, int(runs)))
    base = plan.scenario.updated(drawing.base)
    ratios, rates = [], []
    for _ in range(int(repetitions)):
        started = time.perf_counter()
        batch = hs.simulate_batch(base, drawn, "metrics", metrics=kept)
        between = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            result = hs.campaign(plan, Path(folder) / "out")
            ended = time.perf_counter()
            table = result.to_arrow(["end_time", *kept])
        for column, expected in {"end_time": batch.end_time, **batch.metrics}.items():
            if table.column(column).to_numpy().tobytes() != expected.tobytes():
                raise SystemExit(f"{column}: expected that of simulate_batch, bit for bit, got another one")
        ratios.append((between - started) / (ended - between))
        rates.append(int(runs) / (ended - between))
    machine = describe_machine()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{machine['date']}, {machine['cpu']}, {machine['processors']} processors, {machine['core']['variant']}")
    print(f"{name}: {statistics.median(rates):.0f} runs/s, {statistics.median(ratios):.1%} of simulate_batch")
    shown = ", ".join(f"{ratio:.1%}" for ratio in ratios)
    print(f"ratios of {repetitions} pairs of {runs} runs: {shown}; {peak:.0f} MB at most")


if __name__ == "__main__":
    main(*sys.argv[1:])
