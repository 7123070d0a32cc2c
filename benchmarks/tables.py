"""Writes what `make bench` measured into BENCHMARKS.md and README.md, between their markers.

Reads out/bench/bench.json and, where it is there, out/bench-kernels/kernels.json.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import Any

from hexservo.cli.bench import spell

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "figures" / "bench.svg"


def replace_block(page: Path, name: str, text: str) -> None:
    """Replace what stands between two markers of a page, `<!-- name:begin -->` and `<!-- name:end -->`.

    Raises
    ------
    ValueError
        Where the page has not exactly one pair of them.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    old = page.read_text(encoding="utf-8")
    if old.count(begin) != 1 or old.count(end) != 1 or old.index(begin) > old.index(end):
        raise ValueError(f"{page}: expected one {begin} and after it one {end}")
    head, tail = old.split(begin)[0], old.split(end)[1]
    page.write_text(f"{head}{begin}{text}{end}{tail}", encoding="utf-8")


def table(head: str, rows: list[list[str]]) -> list[str]:
    """Give a Markdown table; a column whose name ends in a colon is aligned to the right."""
    names = head.split(" | ")
    rule = " | ".join("---:" if name.endswith(":") else "---" for name in names)
    lines = [f"| {' | '.join(name.rstrip(':') for name in names)} |", f"| {rule} |"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]


def where(bench: dict[str, Any]) -> str:
    """Return the machine and the date of the measurement."""
    machine = bench["machine"]
    return (
        f"{machine['date'][:10]}; {machine['cpu']}, {machine['processors']} processors, {machine['system']}; "
        f"{machine['core']['compiler']}; load average at the start {machine['load_average']:.1f}"
    )


def tick_rows(bench: dict[str, Any]) -> list[list[str]]:
    """Two lines for a rate of the paper's law: latency and jitter."""
    rows = []
    for tick in bench["ticks"]:
        if tick["law"] != bench["ticks"][0]["law"]:
            continue
        rate = "one after another" if tick["rate"] is None else f"{tick['rate'] / 1e3:g} kHz"
        for name in ("latency", "lateness"):
            if (times := tick[name]) is None:
                continue
            numbers = quantiles(times)
            missed = f"{tick['missed']} of {tick['periods']}" if tick["rate"] and name == "latency" else ""
            what = "latency" if name == "latency" else "jitter"
            rows.append([rate, str(tick["ticks"]), what, *numbers, missed, f"{tick['load_average']:.1f}"])
    return rows


def law_rows(bench: dict[str, Any]) -> list[list[str]]:
    """One line for each law, one tick after another."""
    return [
        [f"`{tick['law']}`", str(tick["ticks"]), *quantiles(tick["latency"]), f"{tick['load_average']:.1f}"]
        for tick in bench["ticks"]
        if tick["rate"] is None
    ]


def quantiles(times: dict[str, Any]) -> list[str]:
    """Spell what the tables show of a distribution."""
    return [spell(times[key]) for key in ("median", "percentile_99", "percentile_99_9", "maximum")]


def speed_rows(bench: dict[str, Any]) -> list[list[str]]:
    """One line for each kind of run."""
    return [
        [
            "one run" if speed["work"] == "single" else f"batch of {speed['scenarios']}",
            speed["variant"],
            str(speed["threads"]),
            spell(speed["wall"]),
            spell(speed["processor"]),
            f"{speed['real_time']:.0f}",
            f"{speed['peak']:.1f}",
            f"{speed['share']:.0%}",
        ]
        for speed in bench["speeds"]
    ]


def part_lines(kernels: dict[str, Any] | None) -> list[str]:
    """Return the parts of the core, or that they are missing."""
    if kernels is None:
        return ["Parts: not measured, since Google Benchmark was not there."]
    medians: dict[str, dict[str, float]] = {}
    for entry in sorted(kernels["benchmarks"], key=lambda entry: int(entry["family_index"])):
        if entry.get("error_occurred"):
            raise ValueError(f"{entry['name']}: expected a time, got: {entry['error_message']}")
        if entry.get("aggregate_name") == "median":
            part, _, scalar = entry["run_name"].partition("<")
            medians.setdefault(part, {})[scalar.rstrip("> ") or "double"] = entry["cpu_time"] * 1e-9
    rows = []
    for part, of in medians.items():
        packed = next((time for scalar, time in of.items() if scalar.startswith("Lanes")), None)
        rows.append([part.replace("_", " "), spell(of["double"]), "–" if packed is None else spell(packed / 2)])
    return table("part | `double`: | `Lanes<2>`, per scenario:", rows)


def benchmarks_block(bench: dict[str, Any], kernels: dict[str, Any] | None) -> str:
    """Give the block of BENCHMARKS.md."""
    first = bench["ticks"][0]
    lines = ["", f"{where(bench)}; scheduling: {first['scheduling']}; memory: {first['memory']}.", ""]
    head = f"ticks of `{first['law']}` | count: | time | median: | 99 %: | 99.9 %: | max: | missed: | load:"
    lines += table(head, tick_rows(bench))
    lines += ["", f"Each latency has one reading of the clock in it, {spell(first['clock_cost'])}.", ""]
    lines += ["![How often a tick took how long, and how late its clock was](docs/figures/bench.svg)", ""]
    head = "law, one tick after another | count: | median: | 99 %: | 99.9 %: | max: | load:"
    lines += [*table(head, law_rows(bench)), ""]
    head = "closed loop | variant | threads: | wall: | processor: | × real time: | peak of a core [GFLOP/s]: | share:"
    lines += [*table(head, speed_rows(bench)), ""]
    ratios = [
        [
            r["name"],
            r["clock"],
            f"{r['value']:.2f}",
            "{:.2f} to {:.2f}".format(*r["quartiles"]),
            f"{r['load_average']:.1f}",
        ]
        for r in bench["ratios"]
    ]
    lines += [*table("ratio of | time | median: | quartiles: | load:", ratios), ""]
    lines += part_lines(kernels)
    lines += ["", "Flags:", ""]
    lines += [f"- {name}: `{variant['flags']}`" for name, variant in bench["variants"].items()]
    return "\n".join([*lines, ""])


def readme_sentence(bench: dict[str, Any]) -> str:
    """Give the numbers of README.md: the fastest of each kind."""
    tick = bench["ticks"][0]["latency"]
    single = min((s for s in bench["speeds"] if s["work"] == "single"), key=lambda s: float(s["processor"]))
    batch = min(
        (s for s in bench["speeds"] if s["work"] == "batch" and s["threads"] == 1), key=lambda s: float(s["processor"])
    )
    machine = bench["machine"]
    return (
        f"tick {spell(tick['median'])} (median; 99.9 %: {spell(tick['percentile_99_9'])}); a step of one run "
        f"{spell(single['processor'])}; of one scenario in a batch {spell(batch['processor'])} on one core "
        f"({machine['cpu']}, {batch['variant']}, {machine['core']['compiler']})"
    )


def main() -> int:
    """Read, and rewrite the pages."""
    parser = argparse.ArgumentParser(description="writes measured numbers into BENCHMARKS.md and README.md")
    parser.add_argument("--bench", type=Path, default=ROOT / "out" / "bench" / "bench.json")
    parser.add_argument("--kernels", type=Path, default=ROOT / "out" / "bench-kernels" / "kernels.json")
    arguments = parser.parse_args()
    bench = json.loads(arguments.bench.read_text(encoding="utf-8"))
    kernels = json.loads(arguments.kernels.read_text(encoding="utf-8")) if arguments.kernels.exists() else None
    replace_block(ROOT / "BENCHMARKS.md", "bench", benchmarks_block(bench, kernels))
    replace_block(ROOT / "README.md", "speed", readme_sentence(bench))
    shutil.copyfile(arguments.bench.with_name("bench.svg"), PICTURE)
    print("written: the tables of BENCHMARKS.md, the speed row of README.md, docs/figures/bench.svg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
