"""Curves, maps and bars of findings as matplotlib figures, for notebooks; the report has them as interactive charts."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.figure import Figure

from hexservo.draw.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, styled
from hexservo.findings.evidence import Bars, Curves, HeatMap, Line
from hexservo.run.samples import path_samples
from hexservo.scenario.arrays import Array

_INKS = (BLUE, VERMILION, GREEN, BLACK, PURPLE, ORANGE, GREY)
_MARKERS = ("o", "s", "D", "P")
_STYLES = {"line": "-", "dashed": "--", "points": ""}


@styled
def item_figure(item: Curves | HeatMap | Bars) -> Figure:
    """Draw lines over one axis, a quantity over a rectangle with its contours, or bars with their intervals."""
    if isinstance(item, Bars):
        return _bars(item)
    figure = Figure(figsize=(5.6, 3.0), layout="constrained")
    axes = figure.subplots()
    if isinstance(item, HeatMap):
        mesh = axes.pcolormesh(item.x, item.y, item.z, cmap="cividis", shading="nearest")
        figure.colorbar(mesh, label=_folded(item.z_label, 40))
        if item.levels and min(np.shape(item.z)) > 1:
            contours = axes.contour(item.x, item.y, item.z, sorted(item.levels), colors="white", linewidths=0.8)
            axes.clabel(contours, fontsize=6)
        axes.grid(visible=False)
    else:
        axes.set_xscale("log" if item.x_log else "linear")
        axes.set_yscale("log" if item.y_log else "linear")
    inks = ("#ffb000", "#ff86c2", "#8be3ff") if isinstance(item, HeatMap) else _INKS
    for number, line in enumerate(item.lines):
        x, y = _thinned(line)
        axes.plot(
            x,
            y,
            color=inks[(number if line.look is None else line.look) % len(inks)],
            linestyle=_STYLES[line.style],
            marker=_MARKERS[(line.look or 0) % len(_MARKERS)] if line.style == "points" or len(x) == 1 else "",
            markersize=3.5,
            label=line.name or None,
        )
    axes.set_xlabel(_folded(item.x_label, 70))
    axes.set_ylabel(_folded(item.y_label, 40))
    if any(line.name for line in item.lines):
        figure.legend(loc="outside upper left", ncols=3)
    return figure


def _bars(item: Bars) -> Figure:
    figure = Figure(figsize=(5.6, 0.9 + 0.3 * len(item.names)), layout="constrained")
    axes = figure.subplots()
    height = 0.8 / len(item.shares)
    for number, share in enumerate(item.shares):
        axes.barh(
            np.arange(len(item.names)) + (number - (len(item.shares) - 1) / 2) * height,
            share.values,
            height,
            color=_INKS[number % len(_INKS)],
            xerr=np.abs(share.intervals.T - share.values),
            error_kw={"elinewidth": 0.8, "capsize": 1.5},
            label=share.name,
        )
    axes.set_yticks(np.arange(len(item.names)), item.names)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(_folded(item.x_label, 70))
    figure.legend(loc="outside upper left", ncols=3)
    return figure


def _folded(text: str, width: int) -> str:
    return "\n".join(textwrap.wrap(text, width, break_long_words=False))


def _thinned(line: Line) -> tuple[Array, Array]:
    """Drop samples of a line without gaps that print does not resolve."""
    x, y = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
    if line.style == "points" or not np.isfinite(y).all():
        return x, y
    kept = path_samples(x, y)
    return x[kept], y[kept]
