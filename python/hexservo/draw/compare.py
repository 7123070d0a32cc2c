"""Figures of a comparison: errors over time, settling times, residuals and efforts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from hexservo.draw.panels import axes_at, draw_label, size_of
from hexservo.draw.style import (
    BLACK,
    BLUE,
    DASH_DOT,
    DASHED,
    GREEN,
    GREY,
    ORANGE,
    PAGE,
    PURPLE,
    VERMILION,
    Ink,
    as_written,
    short_number,
    styled,
    text_width,
    wrapped,
)
from hexservo.run.comparison import Comparison, ComparisonRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Distinguishable with every kind of colour vision; in grey, dashes and markers distinguish the laws.
_INKS = (
    Ink(BLUE),
    Ink(VERMILION, DASHED),
    Ink(GREEN, DASH_DOT),
    Ink(ORANGE, (0, (1, 1))),
    Ink(PURPLE, (0, (6, 1.5))),
    Ink(BLACK, (0, (3, 1, 1, 1, 1, 1))),
    Ink(GREY, (0, (2, 1))),
)
# One more than inks: pairs repeat after 56 laws and controllers. None is like the cross of a run that ended early.
_MARKERS = ("o", "s", "^", "D", "v", "<", ">", "p")
_ENDED, _END_NAME = "x", "ended early"
_ACROSS = 4  # panels side by side
_POINTS = 300  # of one line: more than such a panel resolves
_FLOOR = 1e-3  # smallest error shown [px]
_SMALL = 7.0  # size of the names of laws and of the footnote [pt]
_CELL = 6.5  # largest size of the text in a cell of the table [pt]
_CELL_PART = 0.9  # of a cell's width that its text takes at most
_ROW = 0.15  # height of a line of that size [in]
_SLANT = 20.0  # of the laws' names below the table [deg]
_MOST_BELOW, _MOST_IN_LEGEND = 18, 60  # characters of a law's name, below the table and in the legend
_BETWEEN = 1.2  # columns of the legend, in its font size
_PALETTE = "cividis_r"  # light is fast; distinguishable with every kind of colour vision
_WORDS = {
    "not settled": "never",
    "behind camera": "behind",
    "feature lost": "lost",
    "leg limit": "leg limit",
    "solver failed": "solver",
    "interrupted": "stopped",
}


@styled
def comparison_figure(comparison: Comparison) -> Figure:
    """Draw a page: a panel per scenario with a line per law; below, a row per scenario with all laws."""
    names = [scenario.name for scenario in comparison.scenarios]
    bands = -(-len(names) // _ACROSS)
    across = min(len(names), _ACROSS)
    panel, pitch, line = 1.0, 1.4, 0.2  # heights of a panel, of a panel with its margins, of a row below [in]
    table = line * len(names)
    left, gap = 0.55, 0.2
    in_legend = [as_written(_shortened(law, _MOST_IN_LEGEND)) for law in comparison.laws]
    if any(_ended_early(row) for row in comparison.rows):
        in_legend.append(_END_NAME)
    columns = _legend_columns(in_legend, PAGE - left)
    top = 0.62 + _ROW * (-(-len(in_legend) // columns) - 1)  # of the legend and the title of a panel
    footnote = wrapped(_footnote(comparison), _SMALL, PAGE - 0.2)
    below = [as_written(_shortened(law, _MOST_BELOW)) for law in comparison.laws]  # the table, slanted
    reach = [text_width(name, _SMALL) for name in below]
    drop = max(0.42, 0.18 + math.sin(math.radians(_SLANT)) * max(reach))
    bottom = 0.1 + _ROW * len(footnote.splitlines()) + drop
    height = top + bands * pitch + 0.3 + table + bottom + 0.05
    figure = Figure(figsize=(PAGE, height))
    looks = {law: (_INKS[i % len(_INKS)], _MARKERS[i % len(_MARKERS)]) for i, law in enumerate(comparison.laws)}

    width = min(2.3, (PAGE - left - 0.1 - (across - 1) * gap) / across)
    low, high = _error_range(comparison)
    for number, name in enumerate(names):
        band, place = divmod(number, _ACROSS)
        base = height - top - panel - band * pitch
        axes = axes_at(figure, left + place * (width + gap), base, width, panel)
        rows = [comparison.row(law, name) for law in comparison.laws]
        _draw_errors(axes, rows, looks)
        axes.set_ylim(low, high)
        axes.set_title(_shortened(name, 27), loc="left", fontsize=7.5)
        if place == 0:
            axes.set_ylabel("error [px]")
            axes.yaxis.set_label_coords(-0.42 / width, 0.5)
        else:
            axes.tick_params(axis="y", labelleft=False)
        if number + across >= len(names):
            draw_label(axes, "x", "time [s]")
    marks = [
        Line2D([], [], color=ink.colour, linestyle=ink.dashes, marker=marker, markersize=3.5, label=name)
        for name, (ink, marker) in zip(in_legend, looks.values(), strict=False)  # the last name may be of the cross
    ]
    if len(in_legend) > len(looks):
        marks.append(_end_mark(GREY, label=_END_NAME))
    figure.legend(
        handles=marks,
        loc="upper left",
        bbox_to_anchor=((left - 0.08) / PAGE, 1 - 0.03 / height),
        ncols=columns,
        borderpad=0,
        borderaxespad=0,
        columnspacing=_BETWEEN,
        title="Largest feature error over time",
        title_fontproperties={"size": 8},
        alignment="left",
    )

    count = len(comparison.laws)
    cells = min(max(1.2, 0.62 * count), max(2.9, 0.48 * count), 3.8)
    half, lean = cells / count / 2, math.cos(math.radians(_SLANT))
    labels = max(
        min(1.55, 0.15 + 0.062 * max(map(len, names))),
        *(0.1 + lean * width - (2 * number + 1) * half for number, width in enumerate(reach)),
    )
    room = (PAGE - labels - cells - 0.1 - 2 * 0.2) / 2
    heat = axes_at(figure, labels, bottom, cells, table)
    _draw_settling(heat, comparison)
    heat.set_xticks(range(len(below)), below, rotation=_SLANT, ha="right", rotation_mode="anchor")
    heat.set_yticks(range(len(names)), [_shortened(name, 24) for name in names])
    heat.tick_params(axis="both", length=0)
    for number, (metric, title, unit) in enumerate((("final_error", "Residual", "px"), ("effort", "Effort", "N² s"))):
        axes = axes_at(figure, labels + cells + 0.2 + number * (room + 0.2), bottom, room, table)
        _draw_dots(axes, comparison, metric, looks)
        axes.set_title(title, loc="left")
        draw_label(axes, "x", f"{title.lower()} [{unit}]")
    figure.text(0.1 / PAGE, 0.05 / height, footnote, fontsize=_SMALL, color=GREY, va="bottom")
    return figure


def _legend_columns(names: Sequence[str], room: float) -> int:
    """Return the most columns with which a legend of names is no wider than a room [in]."""
    em = _SMALL / 72
    beside = em * (matplotlib.rcParams["legend.handlelength"] + matplotlib.rcParams["legend.handletextpad"])
    widths = [beside + text_width(name, _SMALL) for name in names]
    for columns in range(len(names), 1, -1):
        filled = [max(column) for column in np.array_split(widths, columns)]  # as matplotlib fills them
        if sum(filled) + em * _BETWEEN * (columns - 1) <= room:
            return columns
    return 1


def _footnote(comparison: Comparison) -> str:
    """Explain the marks of the page."""
    dotted = " and ".join(f"{band:g}" for band in _bands(comparison))
    exceeded = " !: a leg exceeded a limit, see the table." if any(row.passed_limits for row in comparison.rows) else ""
    return f"Dotted: {dotted} px. Hollow: not settled.{exceeded}{_floor_words(comparison)}"


def _floor_words(comparison: Comparison) -> str:
    """Explain the mark of residuals below the drawn range; empty if there are none."""
    residuals = [row.metrics.get("final_error", math.nan) for row in comparison.rows]
    lines = [float(row.error.min()) for row in comparison.rows if len(row.error)]
    below = any(value < _FLOOR for value in [*residuals, *lines])
    return f" Errors below {_FLOOR:g} px are drawn at that value, residuals with a <." if below else ""


def _bands(comparison: Comparison) -> list[float]:
    """Return the settling bands of the scenarios [px], each once."""
    return sorted({scenario.metrics.band for scenario in comparison.scenarios})


def _draw_errors(axes: Axes, rows: list[ComparisonRow], looks: dict[str, tuple[Ink, str]]) -> None:
    """Draw the largest feature error of each law, with the largest value of each bin of logarithmic time."""
    ends = [float(row.time[-1]) for row in rows if len(row.time) > 1]
    end = max(ends, default=1.0)
    begin = min(1e-2, end / 100)
    axes.axhline(rows[0].scenario.metrics.band, color=GREY, linewidth=0.8, linestyle=":", zorder=1)
    for number, row in enumerate(rows):
        ink, marker = looks[row.law]
        if len(row.time) == 0:
            continue
        time, error = _thinned(row.time, np.maximum(row.error, _FLOOR), begin, end)
        every = max(1, len(time) // 6)
        first = (number * every) // max(1, len(rows)) if len(time) > 6 else 0
        axes.plot(
            time,
            error,
            color=ink.colour,
            linestyle=ink.dashes,
            marker=marker,
            markersize=2.6,
            markevery=(first, every),
            gid=f"error {row.law}",
            zorder=3,
        )
        if _ended_early(row):
            axes.add_line(_end_mark(ink.colour, float(time[-1]), float(error[-1]), gid=f"end {row.law}"))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(begin, end)
    for axis, count in ((axes.xaxis, 4), (axes.yaxis, 6)):
        axis.set_major_locator(LogLocator(numticks=count))
        axis.set_major_formatter(FuncFormatter(short_number))
        axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())


def _ended_early(row: ComparisonRow) -> bool:
    """Return whether a run began and did not complete."""
    return row.outcome != "completed" and len(row.time) > 0


def _end_mark(colour: str, *place: float, **more: Any) -> Line2D:
    """Return the mark of a run that ended early, at a place of axes, or for a legend."""
    x, y = ([value] for value in place) if place else ([], [])
    look: dict[str, Any] = {"color": colour, "linestyle": "", "marker": _ENDED, "zorder": 4}
    # at the border of the axes it is whole: many runs end where the range of errors or of time does
    return Line2D(x, y, markersize=5.5, markeredgewidth=1.3, clip_on=False, **look, **more)


def _thinned(
    time: NDArray[np.float64], values: NDArray[np.float64], begin: float, end: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the largest value of each bin of logarithmic time, with its time, and the last value."""
    later = time >= begin
    if not later.any():
        return time[-1:], values[-1:]
    time, values = time[later], values[later]
    bins = np.floor(_POINTS * np.log(time / begin) / math.log(end / begin)).astype(int)
    starts = np.flatnonzero(np.diff(bins, prepend=-1))
    largest = [part.argmax() + start for part, start in zip(np.split(values, starts[1:]), starts, strict=True)]
    kept = np.unique([*largest, len(time) - 1])
    return time[kept], values[kept]


def _draw_settling(axes: Axes, comparison: Comparison) -> None:
    """Draw the settling times as a table with a coloured background, and the verdict where there is none."""
    names = [scenario.name for scenario in comparison.scenarios]
    times = [row.metrics["settling_time"] for row in comparison.rows if row.settled]
    positive = [time for time in times if time > 0]
    low, high = (math.log(min(positive)), math.log(max(positive))) if positive else (0.0, 0.0)
    palette = colormaps[_PALETTE]
    room = _CELL_PART * size_of(axes)[0] / len(comparison.laws)
    axes.set_xlim(-0.5, len(comparison.laws) - 0.5)
    axes.set_ylim(len(names) - 0.5, -0.5)
    for y, name in enumerate(names):
        for x, law in enumerate(comparison.laws):
            row = comparison.row(law, name)
            ground: Any = "0.93"
            ink, weight = VERMILION, "normal"
            text = _WORDS.get(row.verdict, row.verdict)
            if row.settled:
                time = row.metrics["settling_time"]
                share = (math.log(time) - low) / (high - low) if time > 0 and high > low else 0.0
                ground = palette(0.8 * share)
                red, green, blue, _ = ground
                ink = BLACK if 0.3 * red + 0.59 * green + 0.11 * blue > 0.5 else "white"
                text, weight = f"{time:.3g}", "bold"
            elif row.outcome in ("refused", "interrupted"):
                ink = GREY
            if row.passed_limits:
                text += "!"
            size = min(_CELL, _CELL * room / text_width(text, _CELL))
            axes.add_patch(Rectangle((x - 0.48, y - 0.45), 0.96, 0.9, facecolor=ground, linewidth=0))
            axes.text(x, y, text, ha="center", va="center", color=ink, fontsize=size, fontweight=weight)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.xaxis.tick_bottom()
    axes.set_title("Settling time [s]", loc="left")


def _draw_dots(axes: Axes, comparison: Comparison, metric: str, looks: dict[str, tuple[Ink, str]]) -> None:
    """Draw a metric on a logarithmic axis: a row per scenario, a marker per law; hollow if the run did not settle."""
    names = [scenario.name for scenario in comparison.scenarios]
    floor = _FLOOR if metric == "final_error" else 0.0
    values: list[float] = []
    for y, name in enumerate(names):
        own = []
        for number, law in enumerate(comparison.laws):
            row = comparison.row(law, name)
            value = max(row.metrics.get(metric, math.nan), floor)
            if not value > 0:  # none, or NaN
                continue
            below = row.metrics[metric] < floor
            own.append(value)
            ink, marker = looks[law]
            offset = 0.5 * ((number + 0.5) / len(comparison.laws) - 0.5)
            axes.plot(
                value,
                y + offset,
                marker=marker,
                markersize=4,
                color=ink.colour,
                markerfacecolor=ink.colour if row.settled else "white",
                markeredgewidth=0.9,
                linestyle="",
                zorder=3,
                gid=f"{metric} {law} {name}",
            )
            if below:
                beside: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "center", "fontsize": 7}
                axes.annotate("<", (value, y + offset), (-3, 0), color=ink.colour, **beside)
        if own:
            axes.plot([min(own), max(own)], [y, y], color="0.8", linewidth=0.8, zorder=1)
        values += own
    axes.set_xscale("log")
    low, high = (min(values), max(values)) if values else (0.1, 1.0)
    low, high = low / 1.6, high * 1.6
    if high / low < 30:  # room for two decades
        middle = math.sqrt(low * high)
        low, high = middle / 6, middle * 6
    axes.set_xlim(low, high)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.yaxis.set_major_locator(FixedLocator(list(range(len(names)))))
    axes.tick_params(axis="y", labelleft=False, length=0)
    room = size_of(axes)[0]
    axes.xaxis.set_major_locator(LogLocator(numticks=max(2, int(room / 0.34))))
    axes.xaxis.set_major_formatter(FuncFormatter(_power if low < 2e-3 or high > 2e4 else short_number))
    axes.xaxis.set_minor_locator(NullLocator())
    if metric == "final_error":
        for band in _bands(comparison):
            axes.axvline(band, color=GREY, linewidth=0.8, linestyle=":", zorder=1)


def _error_range(comparison: Comparison) -> tuple[float, float]:
    """Return the limits of the error axis: whole decades around the drawn errors."""
    largest = max((float(row.error.max()) for row in comparison.rows if len(row.error)), default=10.0)
    smallest = min((float(row.error[row.time > 1e-2].min(initial=1.0)) for row in comparison.rows), default=1.0)
    low = 10 ** math.floor(math.log10(max(smallest, _FLOOR)))
    return low, 10 ** math.ceil(math.log10(max(largest, 10 * low)) + 1e-9)


def _power(value: float, _place: int | None = None) -> str:
    return f"$10^{{{round(math.log10(value))}}}$"


def _shortened(name: str, count: int) -> str:
    return name if len(name) <= count else f"{name[: count - 1]}…"
