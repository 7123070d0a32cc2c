"""Panels over time: their positions, limits, lines and labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from hexservo.draw.style import AXES_INKS, BLACK, FAINT, GREY, LEG_INKS, THIN, VERMILION, Ink, short_number
from hexservo.run.leg_limits import exceeded_limits
from hexservo.run.metrics import metrics
from hexservo.run.samples import axis_range, broken_parts, extreme_samples, moving_mean, time_range
from hexservo.run.time_panels import TimePanel
from hexservo.scenario.arrays import Array
from hexservo.scenario.wording import wrong_type

if TYPE_CHECKING:
    from hexservo.run.result import Result

__all__ = []


class Panel(NamedTuple):
    """Axes over time with the drawn samples."""

    axes: Axes
    part: slice
    fixed: bool  # of our own figure, with fixed positions; otherwise of the caller's


def given_axes(axes: Sequence[Axes] | NDArray[Any], count: int) -> tuple[Axes, ...]:
    """Check the caller's axes and their number; they may be an array as `matplotlib.pyplot.subplots` returns."""
    found = tuple(np.ravel(np.asarray(axes, dtype=object)))
    for one in found:
        if not isinstance(one, Axes):
            raise wrong_type("axes", "axes of matplotlib", one)
    if len(found) != count:
        raise ValueError(f"axes: expected {count} axes, got {len(found)}")
    return found


def require_axes(ax: object) -> None:
    """Refuse what is neither axes to draw into nor None.

    Raises
    ------
    TypeError
        "ax: expected axes of matplotlib or None, got list".
    """
    if ax is not None and not isinstance(ax, Axes):
        raise wrong_type("ax", "axes of matplotlib or None", ax)


def whole_run(axes: Axes, result: Result, values: Sequence[Array]) -> list[Panel]:
    """Return the caller's axes for the whole run."""
    set_limits(axes, result.time, *values)
    return [Panel(axes, slice(0, len(result.time)), fixed=False)]


def draw_band(axes: Axes, band: float) -> None:
    axes.axhspan(-band, band, color="0.92", linewidth=0, zorder=0)
    axes.axhline(0, color=GREY, linewidth=0.5, zorder=1)


def axes_at(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a position in inches: as a layout engine would, but faster."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def place_panels(
    figure: Figure, result: Result, box: tuple[float, float, float, float], values: Sequence[Array]
) -> list[Panel]:
    """Add axes over time, broken if a short transient would not be visible in a long run.

    Parameters
    ----------
    box
        Left, bottom, width, height [in].
    values
        The values that the y axis covers.
    """
    left, bottom, width, height = box
    parts = broken_parts(result)
    gap = 0.1
    widths = [width] if len(parts) == 1 else [0.62 * (width - gap), 0.38 * (width - gap)]
    panels: list[Panel] = []
    for part, own_width in zip(parts, widths, strict=True):
        axes = axes_at(figure, left, bottom, own_width, height)
        set_limits(axes, result.time[part], *values)
        panels.append(Panel(axes, part, fixed=True))
        left += own_width + gap
    if len(panels) == 2:
        draw_break(panels[0].axes, panels[1].axes)
    return panels


def draw_break(first: Axes, second: Axes) -> None:
    """Mark that the time axis continues in the second panel, on a different scale."""
    second.spines["left"].set_visible(False)
    second.tick_params(axis="y", length=0, labelleft=False)
    for axes, corner in ((first, 1), (second, 0)):
        axes.plot(
            corner,
            0,
            transform=axes.transAxes,
            marker=[(-0.5, -1), (0.5, 1)],
            ms=6,
            color="black",
            mew=0.6,
            clip_on=False,
        )
    begin, end = second.get_xlim()
    ticks = np.array(MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(begin, end))
    clear = (ticks > begin + 0.12 * (end - begin)) & (ticks <= end)  # of the label that ends the first panel
    second.xaxis.set_major_locator(FixedLocator(ticks[clear].tolist()))


def set_limits(axes: Axes, time: Array, *values: Array) -> None:
    """Limit the x axis to the time, and the y axis to the values with a margin; rounding noise is not magnified."""
    axes.set_xlim(time_range(time))
    axes.set_ylim(axis_range(*values))
    largest = max(float(np.abs(part).max()) for part in values)
    axes.xaxis.set_major_locator(MaxNLocator(min(10, max(2, int(size_of(axes)[0] / 0.34))), steps=[1, 2, 5, 10]))
    for axis, size in ((axes.xaxis, abs(float(time[-1]))), (axes.yaxis, largest)):
        if not 1e-3 < size < 1e5:
            axis.set_major_formatter(FuncFormatter(short_number))  # a common power of ten would lie below the title


def size_of(axes: Axes) -> tuple[float, float]:
    """Return the width and height of axes [in]."""
    box, dots = axes.bbox, axes.figure.dpi
    return float(box.width / dots), float(box.height / dots)


def draw_label(axes: Axes, which: Literal["x", "y"], text: str, along: float = 0.5) -> None:
    """Label an axis at a fixed distance, clear of the longest tick labels, and at a fraction along it."""
    width, height = size_of(axes)
    if which == "x":
        axes.set_xlabel(text)
        axes.xaxis.set_label_coords(along, -0.21 / height)
    else:
        axes.set_ylabel(text)
        axes.yaxis.set_label_coords(-0.54 / width, along)


def describe(panels: Sequence[Panel], label: str, title: str, *, time: bool = False) -> None:
    """Set the title and the label of the y axis, and label the time axis if no panel below has it."""
    axes = panels[0].axes
    if not panels[0].fixed:
        axes.set_ylabel(label)
        axes.set_title(title)
        axes.set_xlabel("time [s]")
        return
    widths = [size_of(panel.axes)[0] for panel in panels]
    draw_label(axes, "y", label)
    axes.set_title(title, loc="left")
    if time:
        draw_label(axes, "x", "time [s]", sum(widths) / 2 / widths[0])
    else:
        for panel in panels:
            panel.axes.tick_params(axis="x", labelbottom=False)


def draw_over_time(
    figure: Figure,
    result: Result,
    shown: Sequence[TimePanel],
    boxes: Sequence[tuple[float, float, float, float]],
    axes: Sequence[Axes] | NDArray[Any] | None,
    mean: int = 1,
) -> Figure | tuple[Axes, ...]:
    """Draw panels and how the run ended, and return the figure, or the caller's axes.

    Parameters
    ----------
    boxes
        Of each panel in the figure, as for `place_panels`.
    axes
        To draw the whole run into, as many as there are panels; None: the figure.
    mean
        As for `fill_panels`.
    """
    given = None if axes is None else given_axes(axes, len(shown))
    lowest = min(bottom for _, bottom, _, _ in boxes)
    for number, (drawn, box) in enumerate(zip(shown, boxes, strict=True)):
        if given is None:
            panels = place_panels(figure, result, box, drawn.covered)
        else:
            panels = whole_run(given[number], result, drawn.covered)
        for panel in panels:
            for level in drawn.levels:
                panel.axes.axhline(level, color=BLACK, linewidth=1, linestyle=":", gid=drawn.kind)
        inks = (LEG_INKS if drawn.of == "legs" else AXES_INKS)[drawn.first : drawn.first + len(drawn.names)]
        fill_panels(panels, result, drawn.values, drawn.names, inks, mean, drawn.named)
        describe(panels, drawn.label, drawn.title, time=box[1] == lowest)
    note_outcome(figure if given is None else given[-1], result)
    return figure if given is None else given


def fill_panels(
    panels: Sequence[Panel],
    result: Result,
    values: Array,
    names: Sequence[str],
    inks: Sequence[Ink],
    mean: int = 1,
    levels: Mapping[str, float] | None = None,
) -> None:
    """Draw the columns of values over time, and label each next to its end.

    Parameters
    ----------
    mean
        Number of samples of a moving mean; above 1 it is drawn over thin lines of the samples.
    levels
        Constants, drawn and labelled in black.
    """
    means = moving_mean(values, mean)
    for axes, part, _ in panels:
        if mean > 1:
            thin = [Ink(ink.colour) for ink in inks]
            draw_lines(axes, result.time[part], values[part], names, thin, linewidth=THIN, alpha=FAINT)
            draw_lines(axes, result.time[part], means[part], [f"mean {name}" for name in names], inks)
        else:
            draw_lines(axes, result.time[part], values[part], names, inks)
    if not panels[-1].fixed:
        handles = [
            Line2D([], [], color=ink.colour, linestyle=ink.dashes, label=name)
            for name, ink in zip(names, inks, strict=True)
        ]
        handles += [Line2D([], [], color=BLACK, linestyle=":", label=name) for name in levels or {}]
        panels[-1].axes.legend(handles=handles, ncols=-(-len(handles) // 4), fontsize="small")
        return
    ends = {**dict(zip(names, means[-1], strict=True)), **(levels or {})}
    label_ends(panels[-1].axes, ends, [*inks, *[Ink(BLACK) for _ in levels or ()]])


def draw_lines(axes: Axes, time: Array, values: Array, names: Sequence[str], inks: Sequence[Ink], **looks: Any) -> None:
    """Draw each column as a line, or as dots if there are too few samples."""
    dots: dict[str, Any] = {"marker": "o", "markersize": 2.5} if len(time) < 3 else {}
    for column, name, ink in zip(values.T, names, inks, strict=True):
        kept = extreme_samples(column)
        axes.plot(time[kept], column[kept], color=ink.colour, linestyle=ink.dashes, gid=name, **dots, **looks)


def label_ends(axes: Axes, ends: Mapping[str, float], inks: Sequence[Ink]) -> None:
    """Label lines to the right of the axes, each as near to its last value as possible without overlap."""
    low, high = axes.get_ylim()
    places = np.clip((np.array(list(ends.values())) - low) / (high - low), 0, 1)
    width, height = size_of(axes)
    spread = _spread(places, 0.114 / height)
    near, far, text = (1 + inches / width for inches in (0.02, 0.14, 0.17))
    for name, place, label, ink in zip(ends, places, spread, inks, strict=True):
        axes.plot([near, far], [place, label], color=ink.colour, linewidth=0.4, clip_on=False, transform=axes.transAxes)
        axes.text(text, label, name, transform=axes.transAxes, va="center", color=ink.colour, fontsize=7)


def _spread(places: Array, gap: float) -> Array:
    """Move places within [0, 1] apart by at least a gap, all together as little as possible in the least squares.

    With the gaps subtracted this is isotonic regression, solved by pooling neighbours.
    """
    order = np.argsort(places, kind="stable")
    steps = gap * np.arange(len(places))
    pools: list[list[float]] = []
    for place in places[order] - steps:
        pools.append([float(place)])
        while len(pools) > 1 and np.mean(pools[-2]) >= np.mean(pools[-1]):
            last = pools.pop()
            pools[-1] += last
    level = np.concatenate([np.full(len(pool), np.mean(pool)) for pool in pools])
    spread = np.empty_like(places)
    spread[order] = np.clip(level, 0, max(1 - steps[-1], 0)) + steps
    return spread


def farther_apart(starts: Array, ends: Array, enough: float) -> Literal[0, -1]:
    """Find where labels of paths have more room: at the starts (0), if that is enough, or at the ends (-1)."""

    def nearest(places: Array) -> float:
        return min(float(np.hypot(*(a - b))) for a, b in combinations(places, 2))

    return 0 if nearest(starts) >= min(enough, nearest(ends)) else -1


def free_place(candidates: Array, taken: Array, enough: float) -> int:
    """Return the first of some places (k, 2) that is far enough from all that are taken (n, 2), or else the farthest.

    All in one unit, as points of the figure.
    """
    room = np.array([np.nanmin(np.hypot(*(taken - place).T)) for place in candidates])
    free = np.flatnonzero(room >= enough)
    return int(free[0] if len(free) else room.argmax())


def point_the_way(axes: Axes, start: Array, away: Array, colour: str, number: int) -> None:
    """Put an arrow head beside the start of a path, at an offset from it (2,) [points], which is its direction."""
    triangle = MarkerStyle(">").rotated(deg=float(np.degrees(np.arctan2(away[1], away[0]))))
    beside = axes.transData + ScaledTranslation(away[0] / 72.0, away[1] / 72.0, axes.figure.dpi_scale_trans)
    looks: dict[str, Any] = {"markersize": 5, "markeredgewidth": 0, "color": colour, "zorder": 3.5}
    axes.plot(*start, marker=triangle, transform=beside, gid=f"direction {number}", **looks)


def draw_legend(figure: Figure, handles: Mapping[str, Line2D]) -> None:
    """Put a legend into the upper right corner, above all panels."""
    figure.legend(list(handles.values()), list(handles), loc="upper right", ncols=len(handles), borderaxespad=0.2)


def note_outcome(place: Figure | Axes, result: Result) -> None:
    """Write into the corner of a figure or of the caller's axes how a run ended early, or what limit it exceeded."""
    if result.outcome != "completed":
        text = f"{result.outcome.replace('_', ' ')} after {result.stop_time:.4g} s"
        if (event := result.stop_event) is not None:
            text += f" (leg {event.leg}, {event.kind.replace('_', ' ')})"
    elif exceeded := exceeded_limits(result.scenario, metrics(result)):
        text = exceeded[0].exceeded if len(exceeded) == 1 else f"{len(exceeded)} limits of the legs were exceeded"
    else:
        return
    looks: dict[str, Any] = {"ha": "right", "va": "bottom", "fontweight": "bold", "color": VERMILION}
    if isinstance(place, Figure):
        place.text(0.995, 0.012, text, fontsize=7, **looks)
    else:
        place.text(0.99, 0.02, text, transform=place.transAxes, **looks)
