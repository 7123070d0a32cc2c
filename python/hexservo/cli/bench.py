"""Output of `hexservo bench`: tables and files (BENCHMARKS.md)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from hexservo.cli.terminal import plain_table
from hexservo.run.bench import FLOPS_PER_STEP, Benchmark, Distribution, Ratio, Speed, TickTiming
from hexservo.scenario.wording import quantity

if TYPE_CHECKING:
    from rich.console import RenderableType


def write_benchmark(result: Benchmark, folder: Path) -> None:
    """Write bench.json and the picture, bench.png and bench.svg, into an existing folder."""
    from hexservo.draw.bench import tick_figure
    from hexservo.draw.style import image_bytes

    (folder / "bench.json").write_text(result.to_json(), encoding="utf-8")
    figure = tick_figure(result.ticks)
    for extension in ("png", "svg"):
        (folder / f"bench.{extension}").write_bytes(image_bytes(figure, extension))


def report(result: Benchmark) -> Iterable[RenderableType]:
    """Return the tables for a terminal."""
    from rich.text import Text

    machine = result.machine
    yield Text(
        f"{machine['cpu']}, {machine['processors']} processors, {machine['system']}, load average "
        f"{machine['load_average']:.1f}; hexservo {machine['core']['hexservo']}, {machine['core']['compiler']}"
    )
    first = result.ticks[0]
    paced = [timing for timing in result.ticks if timing.rate is not None]
    free = [timing for timing in result.ticks if timing.rate is None]
    yield Text(f"\nservo tick of {first.law}: {first.scheduling}, memory {first.memory}", style="bold")
    yield _table(("rate", "ticks", "", "median", "99 %", "99.9 %", "max", "missed"), _tick_rows(first, paced))
    yield Text(f"each time includes a reading of the clock, {spell(first.clock_cost)}", style="dim")
    yield Text("\nservo tick of each law, free-running", style="bold")
    rows = ((timing.law, str(timing.ticks), *_spelled(timing.latency)) for timing in free)
    yield _table(("law", "ticks", "median", "99 %", "99.9 %", "max"), rows)
    yield Text("\nclosed loop, per step of one scenario", style="bold")
    head = ("run", "variant", "threads", "wall", "processor", "x real time", "peak/core", "share")
    yield _table(head, map(_speed_row, result.speeds))
    yield Text(f"share of the peak by a count of {FLOPS_PER_STEP:.0f} operations a step", style="dim")
    yield Text("\nratios, medians with quartiles", style="bold")
    yield _table(("of", "time", "", "", "load"), map(_ratio_row, result.ratios))


def _ratio_row(ratio: Ratio) -> tuple[str, ...]:
    first, third = ratio.quartiles
    return ratio.name, ratio.clock, f"{ratio.value:.2f}", f"{first:.2f} to {third:.2f}", f"{ratio.load_average:.1f}"


def _tick_rows(first: TickTiming, paced: list[TickTiming]) -> Iterable[tuple[str, ...]]:
    yield "free", str(first.ticks), "latency", *_spelled(first.latency), ""
    for timing in paced:
        assert timing.rate is not None
        assert timing.lateness is not None
        missed = f"{timing.missed} of {timing.periods}"
        yield f"{timing.rate / 1e3:g} kHz", str(timing.ticks), "latency", *_spelled(timing.latency), missed
        yield "", "", "wake-up", *_spelled(timing.lateness), ""


def _spelled(times: Distribution) -> tuple[str, ...]:
    return tuple(map(spell, (times.median, times.percentile_99, times.percentile_99_9, times.maximum)))


def _speed_row(speed: Speed) -> tuple[str, ...]:
    return (
        "one" if speed.work == "single" else f"batch of {speed.scenarios}",
        speed.variant,
        str(speed.threads),
        spell(speed.wall),
        spell(speed.processor),
        f"{speed.real_time:.0f}",
        f"{speed.peak:.1f} GFLOP/s",
        f"{speed.share:.0%}",
    )


def spell(seconds: float) -> str:
    """Return a time with three digits and its unit."""
    for factor, unit in ((1e9, "ns"), (1e6, "µs"), (1e3, "ms")):
        if seconds * factor < 999.5:
            value = seconds * factor
            return f"{value:.{0 if value > 99.5 else 1 if value > 9.95 else 2}f} {unit}"
    return quantity(seconds, "s")


def _table(head: Iterable[str], rows: Iterable[tuple[str, ...]]) -> RenderableType:
    table = plain_table(header_style="dim")
    for column, name in enumerate(head):
        table.add_column(name, justify="left" if column == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table
