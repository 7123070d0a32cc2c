"""The picture of the servo tick's times: how often a tick, or a wake-up, took how long."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from hexservo.plots import _BLACK, _BLUE, _DASH_DOT, _DASHED, _GREEN, _ORANGE, _PAGE, _VERMILION, _Ink, _styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hexservo._bench import Distribution, TickTiming

__all__ = ["tick_figure"]

_INKS = (_Ink(_BLACK), _Ink(_BLUE), _Ink(_VERMILION, _DASHED), _Ink(_GREEN, _DASH_DOT), _Ink(_ORANGE, (0, (1, 1))))


@_styled
def tick_figure(ticks: Sequence[TickTiming]) -> Figure:
    """Draw latencies of the tick, and how late the paced ones woke up, both axes logarithmic."""
    figure = Figure(figsize=(_PAGE, 3.2), layout="constrained")
    latency, lateness = figure.subplots(1, 2, sharey=True)
    for timing, ink in zip(ticks, _INKS, strict=False):
        name = "one after another" if timing.rate is None else f"at {timing.rate / 1e3:g} kHz"
        count = f"{timing.ticks:,}".replace(",", "\N{THIN SPACE}")
        _draw(latency, timing.latency, ink, f"{name}, {count} ticks")
        if timing.lateness is not None:
            _draw(lateness, timing.lateness, ink, name)
    smallest = min(1.0 / timing.ticks for timing in ticks)
    for axes, title, label in (
        (latency, "Latency of a tick", "input to leg forces [µs]"),
        (lateness, "Jitter of the clock", "wake-up behind its time [µs]"),
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
    # above both, where no curve is
    figure.legend(*latency.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def _draw(axes: Axes, times: Distribution, ink: _Ink, name: str) -> None:
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
