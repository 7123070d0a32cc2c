"""Figure of the servo tick's times: histograms of the latency and of the wake-up delay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from hexservo.draw.style import (
    BLACK,
    BLUE,
    DASH_DOT,
    DASHED,
    GREEN,
    ORANGE,
    PAGE,
    PURPLE,
    VERMILION,
    Ink,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hexservo.run.bench import Distribution, TickTiming

_RATE_INKS = (Ink(BLACK), Ink(BLUE), Ink(VERMILION, DASHED), Ink(GREEN, DASH_DOT), Ink(ORANGE, (0, (1, 1))))
_LAW_INKS = (*_RATE_INKS, Ink(PURPLE, DASHED))


@styled
def tick_figure(ticks: Sequence[TickTiming]) -> Figure:
    """Draw latencies of the tick by rate and by law, and the wake-up delay of paced ticks, all axes logarithmic.

    Parameters
    ----------
    ticks
        The law of the first one is drawn for each rate.
    """
    figure = Figure(figsize=(PAGE, 3.4), layout="constrained")
    latency, lateness, laws = figure.subplots(1, 3, sharey=True)
    for timing, ink in zip((timing for timing in ticks if timing.law == ticks[0].law), _RATE_INKS, strict=False):
        name = "free-running" if timing.rate is None else f"{timing.rate / 1e3:g} kHz"
        _draw(latency, timing.latency, ink, name)
        if timing.lateness is not None:
            _draw(lateness, timing.lateness, ink, name)
    for timing, ink in zip((timing for timing in ticks if timing.rate is None), _LAW_INKS, strict=False):
        _draw(laws, timing.latency, ink, timing.law)
    smallest = min(1.0 / timing.ticks for timing in ticks)
    for axes, title, label in (
        (latency, f"Latency of {ticks[0].law}", "input to leg forces [µs]"),
        (lateness, "Jitter of the clock", "wake-up delay [µs]"),
        (laws, "Latency, free-running", "input to leg forces [µs]"),
    ):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(smallest / 2, 2.0)
        axes.set_title(title)
        axes.set_xlabel(label)
        axes.xaxis.set_major_locator(LogLocator(numticks=12))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(lambda value, _place: f"{value:g}")
        axes.grid(visible=True, which="major", linewidth=0.4, color="0.88")
        axes.set_axisbelow(True)
    latency.set_ylabel(f"share of ticks per bin of 1/{_bins_per_decade(ticks[0].latency)} decade")
    # above the panels, clear of the curves
    figure.legend(*latency.get_legend_handles_labels(), loc="outside upper left", ncols=3, frameon=False)
    figure.legend(*laws.get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False)
    return figure


def _draw(axes: Axes, times: Distribution, ink: Ink, name: str) -> None:
    """Draw a histogram as steps; a bin without ticks is a gap."""
    counts = np.array(times.counts, dtype=float)
    axes.stairs(
        np.where(counts > 0, counts / counts.sum(), np.nan),
        np.array(times.edges) * 1e6,
        baseline=None,
        color=ink.colour,
        linestyle=ink.dashes,
        linewidth=1.1,
        label=name,
    )


def _bins_per_decade(times: Distribution) -> int:
    return int(1.0 / np.log10(times.edges[-1] / times.edges[-2]) + 0.5)
