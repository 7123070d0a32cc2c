"""The paper's figures 2 to 5, drawn from a run. Nothing here simulates, and nothing touches pyplot or the user's style.

Each function returns a `matplotlib.figure.Figure` of a printed column's or page's width, with text of 7 to 8 points.
Given ``ax`` or ``axes`` of an existing figure, it draws into these, in the caller's style, and returns them.
`paper_figures` writes all of them. Lines keep every sample until that is more than print resolves; from there on they
keep each bin's smallest and largest sample, so that no peak is lost.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, ParamSpec, TypeAlias, TypeVar, overload

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from hexservo import _core
from hexservo.run.metrics import metrics
from hexservo.run.samples import ImageView, image_views
from hexservo.run.samples import extremes as _extremes
from hexservo.run.samples import mean_samples as _mean_samples
from hexservo.run.samples import moving_mean as _moving_mean
from hexservo.run.samples import parts as _parts
from hexservo.run.samples import rotation_vectors as _rotation_vector
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.scenario import _TERMS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hexservo.run.result import Result
    from hexservo.scenario.scenario import Scenario

__all__ = ["control_wrench", "feature_errors", "feature_paths", "paper_figures", "platform_motion", "rule_table"]

Array: TypeAlias = NDArray[np.float64]
_P = ParamSpec("_P")
_T = TypeVar("_T")


# ---- Style ----------------------------------------------------------------------------------------------------------

_COLUMN, _PAGE = 3.5, 7.16  # widths of a figure in a two-column paper [in]
_THIN = 0.6  # width of samples under their mean [pt]
_FAINT = 0.45  # opacity of samples under their mean


class _Ink(NamedTuple):
    """How one line looks."""

    colour: str
    dashes: Any = "-"


# Okabe and Ito's colours, the light ones darkened for text: apart for every kind of colour vision. In grey, dashes and
# labels tell the lines apart.
_BLACK, _BLUE, _VERMILION, _GREEN, _PURPLE, _ORANGE = "#000000", "#0072B2", "#D55E00", "#009E73", "#B85F93", "#CC8400"
_GREY = "0.45"
_DASHED, _DASH_DOT = (0, (4, 1.2)), (0, (5, 1, 1.2, 1))
_AXES_INKS = (_Ink(_BLUE), _Ink(_VERMILION, _DASHED), _Ink(_GREEN, _DASH_DOT))
_POINT_COLOURS = (_BLUE, _VERMILION, _GREEN, _BLACK)
_FEATURE_INKS = tuple(_Ink(colour, dashes) for colour in _POINT_COLOURS for dashes in ("-", _DASHED))
_LEG_INKS = (
    _Ink(_BLACK),
    _Ink(_ORANGE),
    _Ink(_BLUE, _DASHED),
    _Ink(_VERMILION, _DASHED),
    _Ink(_GREEN, _DASH_DOT),
    _Ink(_PURPLE, _DASH_DOT),
)

_FEATURE_NAMES = ("x₁", "y₁", "x₂", "y₂", "x₃", "y₃", "x₄", "y₄")
_START: dict[str, Any] = {"marker": "o", "markersize": 5, "markerfacecolor": "white", "markeredgewidth": 1.1}
_END: dict[str, Any] = {"marker": "o", "markersize": 3.2, "markeredgewidth": 0}
_GOAL: dict[str, Any] = {"marker": "s", "markersize": 7, "markerfacecolor": "none", "markeredgewidth": 0.9}

_HALO = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.4}
_DIVERGING = "PuOr_r"  # light in the middle, and told apart by every kind of colour vision

_STYLE = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-9, 9),
    "axes.titley": 1.0,  # fixed places for titles and labels: finding them takes a third of the drawing time
    "axes.titlepad": 5,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.major.pad": 2.5,
    "ytick.major.pad": 2.5,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "lines.solid_joinstyle": "round",
    "lines.dash_joinstyle": "round",
    "figure.dpi": 200,
    "savefig.dpi": 200,
    "svg.fonttype": "path",  # needs no font where it is shown
    "svg.hashsalt": "hexservo",  # the same run gives the same bytes
}
# What decides how a figure looks; the rest of the user's settings (backend, keys, ...) is none of our business.
_LOOK = (
    "agg.", "axes.", "figure.", "font.", "grid.", "hatch.", "image.", "legend.", "lines.", "markers.", "mathtext.",
    "patch.", "path.", "savefig.", "svg.", "text.", "xaxis.", "xtick.", "yaxis.", "ytick.",
)  # fmt: skip


@contextlib.contextmanager
def _our_style() -> Iterator[None]:
    """Draw in our style, from matplotlib's defaults whatever the user's are, and put the user's back."""
    defaults = {name: value for name, value in matplotlib.rcParamsDefault.items() if name.startswith(_LOOK)}
    settings: Any = {**defaults, **_STYLE}
    with matplotlib.rc_context(settings):
        yield


def _styled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Draw in our style, except into axes of the caller's, which have a style already."""

    @wraps(function)
    def styled(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        if kwargs.get("ax") is not None or kwargs.get("axes") is not None:
            return function(*args, **kwargs)
        with _our_style():
            return function(*args, **kwargs)

    return styled


# ---- The figures ----------------------------------------------------------------------------------------------------


@overload
def rule_table(scenario: Scenario) -> Figure: ...


@overload
def rule_table(scenario: Scenario, *, ax: Axes) -> Axes: ...


@_styled
def rule_table(scenario: Scenario, *, ax: Axes | None = None) -> Figure | Axes:
    """Draw the rule table of the fuzzy systems, figure 2(a) (docs/model.md section 5).

    Rows are the terms of the first input u (the scaled image wrench g of `hybrid`, pose error e of `composite`),
    columns those of its rate. A cell shows the output's term, or the number where it is no term's centre.

    Parameters
    ----------
    ax
        Axes to draw into; the colour bar takes its room from them. None: a new figure.

    Returns
    -------
    Figure or Axes
        The new figure, or `ax`.

    Raises
    ------
    ValueError
        For a law without fuzzy systems.
    """
    gains = core_parameters(scenario).gains
    if not isinstance(gains, _core.HybridGains | _core.CompositeGains):
        raise ValueError(f"controller.law: expected one with fuzzy systems, got {scenario.controller.law}")
    table = np.asarray(gains.fuzzy.table)
    terms = list(_TERMS)
    limit = max(1.0, float(np.abs(table).max()))
    figure = Figure(figsize=(_COLUMN, 2.75))
    axes = _axes(figure, 0.52, 0.12, 2.2, 2.2) if ax is None else ax
    image = axes.imshow(table, cmap=_DIVERGING, vmin=-limit, vmax=limit)
    for (row, column), value in np.ndenumerate(table):
        ink = "white" if abs(value) > 0.6 * limit else "black"
        axes.text(column, row, _cell_text(value), ha="center", va="center", color=ink, fontsize=7)
    axes.set_xticks(range(7), terms)
    axes.set_yticks(range(7), terms)
    axes.set_xticks(np.arange(0.5, 6), minor=True)
    axes.set_yticks(np.arange(0.5, 6), minor=True)
    axes.grid(visible=False)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    axes.spines[:].set_visible(False)
    axes.set_xlabel("rate of u [1]")
    meaning = "image wrench" if scenario.controller.law == "hybrid" else "pose error"
    axes.set_ylabel(f"u, the scaled {meaning} [1]")
    place: dict[str, Any] = {"ax": axes} if ax is not None else {"cax": _axes(figure, 2.82, 0.12, 0.1, 2.2)}
    bar = axes.figure.colorbar(image, ticks=MaxNLocator(4), **place)
    bar.outline.set_visible(False)
    bar.set_label("output [1]")
    return figure if ax is None else ax


@overload
def feature_errors(result: Result) -> Figure: ...


@overload
def feature_errors(result: Result, *, ax: Axes) -> Axes: ...


@_styled
def feature_errors(result: Result, *, ax: Axes | None = None) -> Figure | Axes:
    """Draw the eight feature errors in px over the time in s, figure 2(b).

    A run that settles is shown in two panels: until somewhat after it has settled, then the rest on a scale of its
    own. The settling band is shaded.

    Parameters
    ----------
    ax
        Axes to draw the whole run into. None: a new figure.

    Returns
    -------
    Figure or Axes
        The new figure, or `ax`.
    """
    band = result.scenario.metrics.band
    if ax is not None:
        (panel,) = _whole_run(ax, result, [result.feature_error])
        _draw_band(ax, band)
        _fill([panel], result, result.feature_error, _FEATURE_NAMES, _FEATURE_INKS)
        _describe([panel], "feature error [px]", f"Feature errors (shaded: ±{band:g} px)", time=True)
        _note_outcome(ax, result)
        return ax
    figure = Figure(figsize=(_PAGE, 2.48))
    parts = _parts(result)
    if len(parts) == 1:
        boxes = [(0.68, 6.11)]
        titles = [f"Feature errors (shaded: ±{band:g} px)"]
    else:
        boxes = [(0.68, 2.75), (4.2, 2.59)]
        settled = metrics(result)["settling_time"]
        titles = [f"Within ±{band:g} px (shaded) from {settled:.3g} s on", "The rest, magnified"]
    for part, (left, width), title in zip(parts, boxes, titles, strict=True):
        axes = _axes(figure, left, 0.48, width, 1.72)
        _draw_band(axes, band)
        errors = result.feature_error[part]
        _draw(axes, result.time[part], errors, _FEATURE_NAMES, _FEATURE_INKS)
        _set_limits(axes, result.time[part], errors)
        _describe([_Panel(axes, part, fixed=True)], "feature error [px]", title, time=True)
    _label_ends(axes, dict(zip(_FEATURE_NAMES, errors[-1], strict=True)), _FEATURE_INKS)
    solid, dashed = (Line2D([], [], color=_GREY, linestyle=ink.dashes) for ink in _FEATURE_INKS[:2])
    _explain(figure, {"x₁ to x₄": solid, "y₁ to y₄": dashed})
    _note_outcome(figure, result)
    return figure


@overload
def feature_paths(result: Result) -> Figure: ...


@overload
def feature_paths(result: Result, *, ax: Axes) -> Axes: ...


@_styled
def feature_paths(result: Result, *, ax: Axes | None = None) -> Figure | Axes:
    """Draw the paths of the four features in the image plane in px, axes equal, figure 3.

    The arrow shows the direction in which each feature starts. y points up, as in (4) seen along the optical axis.
    Where ``camera.image_size`` is given, the axes have the image's shape and show its border; where the paths take a
    small part of the image, a second panel magnifies them.

    Parameters
    ----------
    ax
        Axes to draw into, without the second panel. None: a new figure.

    Returns
    -------
    Figure or Axes
        The new figure, or `ax`.
    """
    views = image_views(result)
    if ax is not None:
        _draw_paths(ax, result, views[0])
        ax.set_xlabel("image x [px]")
        ax.set_ylabel("image y [px]")
        ax.legend(handles=_path_marks(), loc="best", fontsize="small")
        _note_outcome(ax, result)
        return ax
    height = 2.7 * float(views[0].half[1] / views[0].half[0])
    figure = Figure(figsize=(_COLUMN if len(views) == 1 else _PAGE, height + 0.8))
    for number, view in enumerate(views):
        axes = _axes(figure, 0.68 + 3.6 * number, 0.48, 2.7, height)
        _draw_paths(axes, result, view, named=number == len(views) - 1)
        _label(axes, "x", "image x [px]")
        _label(axes, "y", "image y [px]")
        if number == 0:
            axes.legend(
                handles=_path_marks(),
                loc="lower left",
                bbox_to_anchor=(-0.02, 0.985),
                ncols=3,
                handletextpad=0.1,
                columnspacing=1.2,
                borderpad=0.2,
            )
        else:
            axes.set_title("Magnified", loc="left")
    _note_outcome(figure, result)
    return figure


@overload
def platform_motion(result: Result) -> Figure: ...


@overload
def platform_motion(result: Result, *, axes: Sequence[Axes] | NDArray[Any]) -> tuple[Axes, ...]: ...


@_styled
def platform_motion(result: Result, *, axes: Sequence[Axes] | NDArray[Any] | None = None) -> Figure | tuple[Axes, ...]:
    """Draw the platform's position relative to home in mm and its rotation vector in mrad, in B, figure 4.

    The rotation vector is the axis times the angle (at most pi) of R_BE; at home it is zero.

    Parameters
    ----------
    axes
        Two axes to draw the whole run into: position, rotation vector. None: a new figure.

    Returns
    -------
    Figure or tuple of Axes
        The new figure, or `axes`.

    Raises
    ------
    ValueError
        For any other number of axes.
    """
    displacement = 1e3 * (result.position - np.asarray(result.scenario.robot.home_position))
    rotation = 1e3 * _rotation_vector(result.quaternion)
    figure = Figure(figsize=(_PAGE, 3.6))
    given = None if axes is None else _given(axes, 2)
    if given is None:
        upper = _panels(figure, result, (0.68, 2.01, 6.04, 1.3), [displacement])
        lower = _panels(figure, result, (0.68, 0.48, 6.04, 1.3), [rotation])
    else:
        upper = _whole_run(given[0], result, [displacement])
        lower = _whole_run(given[1], result, [rotation])
    _fill(upper, result, displacement, ["x", "y", "z"], _AXES_INKS)
    _fill(lower, result, rotation, ["θx", "θy", "θz"], _AXES_INKS)
    _describe(upper, "displacement [mm]", "Position relative to home, in B (z points down)")
    _describe(lower, "rotation vector [mrad]", "Orientation: axis times angle, in B", time=True)
    _note_outcome(figure if given is None else given[1], result)
    return figure if given is None else given


@overload
def control_wrench(result: Result) -> Figure: ...


@overload
def control_wrench(result: Result, *, axes: Sequence[Axes] | NDArray[Any]) -> tuple[Axes, ...]: ...


@_styled
def control_wrench(result: Result, *, axes: Sequence[Axes] | NDArray[Any] | None = None) -> Figure | tuple[Axes, ...]:
    """Draw the wrench in N and mN m, in B, and the six leg forces in N, figure 5.

    Thin lines are the samples; where there are enough of them, thick lines are their moving means: the switching term
    makes the samples chatter. The dotted line is the weight in Ḡ that the law feeds forward (1), (15).

    Parameters
    ----------
    axes
        Four axes to draw the whole run into: horizontal force, vertical force, moment, leg forces. None: a new figure.

    Returns
    -------
    Figure or tuple of Axes
        The new figure, or `axes`.

    Raises
    ------
    ValueError
        For any other number of axes.
    """
    body = _core.RigidBody()
    body.mass = result.scenario.robot.mass
    weight = float(body.gravity_wrench[2])
    horizontal, vertical, moment = result.wrench[:, :2], result.wrench[:, 2:3], 1e3 * result.wrench[:, 3:]
    mean = _mean_samples(result.time)
    shown = [[horizontal], [vertical, np.array([weight])], [moment], [result.leg_forces]]
    figure = Figure(figsize=(_PAGE, 4.68))
    given = None if axes is None else _given(axes, 4)
    if given is None:
        boxes = [*((0.68, bottom, 2.4, 1.1) for bottom in (3.16, 1.82, 0.48)), (4.16, 0.48, 2.54, 3.78)]
        *rows, legs = (_panels(figure, result, box, values) for box, values in zip(boxes, shown, strict=True))
    else:
        *rows, legs = (_whole_run(place, result, values) for place, values in zip(given, shown, strict=True))
    for panel in rows[1]:
        panel.axes.axhline(weight, color=_BLACK, linewidth=1, linestyle=":", gid="weight")
    _fill(rows[0], result, horizontal, ["fx", "fy"], _AXES_INKS[:2], mean)
    _fill(rows[1], result, vertical, ["fz"], [_Ink(_GREEN)], mean, {"−mg": weight})
    _fill(rows[2], result, moment, ["mx", "my", "mz"], _AXES_INKS, mean)
    _fill(legs, result, result.leg_forces, [f"leg {leg}" for leg in range(1, 7)], _LEG_INKS, mean)
    _describe(rows[0], "force [N]", "Horizontal force, in B")
    _describe(rows[1], "force [N]", "Vertical force, in B (z points down)")
    _describe(rows[2], "moment [mN m]", "Moment, in B", time=True)
    _describe(legs, "leg force [N]", "Leg forces (positive: pushing)", time=True)
    if mean > 1 and given is None:
        period = 1e3 * mean * float(np.median(np.diff(result.time)))
        samples = Line2D([], [], color=_GREY, linewidth=_THIN, alpha=_FAINT)
        _explain(figure, {"samples": samples, f"mean over {period:.3g} ms": Line2D([], [], color=_GREY)})
    _note_outcome(figure if given is None else given[-1], result)
    return figure if given is None else given


def paper_figures(result: Result, folder: str | os.PathLike[str]) -> list[Path]:
    """Write figures 2(a), 2(b), 3, 4 and 5 as SVG and PNG (200 dpi) into a folder, which is made if need be.

    Files of the same name are replaced. The same run gives the same bytes. Each file appears whole or not at all, and
    none before all are drawn.

    Returns
    -------
    list of Path
        The files: for each figure the SVG, then the PNG. A law without fuzzy systems has no figure 2(a).

    Raises
    ------
    ValueError
        The folder cannot be made or written to.
    """
    target = Path(folder)
    controller = result.scenario.controller
    has_table = "fuzzy" in type(getattr(controller, controller.law)).model_fields
    figures = {
        **({"fig2a_rule_table": rule_table(result.scenario)} if has_table else {}),
        "fig2b_feature_errors": feature_errors(result),
        "fig3_feature_paths": feature_paths(result),
        "fig4_platform_motion": platform_motion(result),
        "fig5_wrench": control_wrench(result),
    }
    images = {
        f"{name}.{extension}": _image(figure, extension)
        for name, figure in figures.items()
        for extension in ("svg", "png")
    }
    try:
        return _write(target, images)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ValueError(
            f'folder: expected a folder that exists or can be made, and can be written to, got "{target}" ({reason})'
        ) from error


# ---- Panels ---------------------------------------------------------------------------------------------------------


class _Panel(NamedTuple):
    """Axes over the time with the samples that they show."""

    axes: Axes
    part: slice
    fixed: bool  # of a figure of ours, where everything has its place; else of the caller's


def _given(axes: Sequence[Axes] | NDArray[Any], count: int) -> tuple[Axes, ...]:
    """Check the number of the caller's axes, which may be an array as `matplotlib.pyplot.subplots` returns."""
    found = tuple(np.ravel(np.asarray(axes, dtype=object)))
    if len(found) != count:
        raise ValueError(f"axes: expected {count} axes, got {len(found)}")
    return found


def _whole_run(axes: Axes, result: Result, values: Sequence[Array]) -> list[_Panel]:
    """Take the caller's axes for the whole run."""
    _set_limits(axes, result.time, *values)
    return [_Panel(axes, slice(0, len(result.time)), fixed=False)]


def _draw_band(axes: Axes, band: float) -> None:
    axes.axhspan(-band, band, color="0.92", linewidth=0, zorder=0)
    axes.axhline(0, color=_GREY, linewidth=0.5, zorder=1)


# ---- The image ------------------------------------------------------------------------------------------------------


def _path_marks() -> list[Line2D]:
    return [
        Line2D([], [], linestyle="", color=_GREY, label=name, **{"markerfacecolor": _GREY, **mark})
        for name, mark in (("start", _START), ("end of the run", _END), ("goal", _GOAL))
    ]


def _draw_paths(axes: Axes, result: Result, view: ImageView, *, named: bool = True) -> None:
    """Draw border, paths, starts, ends and goals of the four features, and their arrows and names where asked for."""
    features = result.features.reshape(-1, 4, 2)
    goals = np.asarray(result.scenario.target.desired_features).reshape(4, 2)
    axes.set_xlim(*view.limits[0])
    axes.set_ylim(*view.limits[1])
    axes.set_aspect("equal", adjustable="box")
    if view.border is not None:
        width, height = view.border
        axes.add_patch(
            Rectangle(
                (-width / 2, -height / 2),
                width,
                height,
                fill=False,
                edgecolor=_GREY,
                linewidth=0.8,
                gid="border",
                zorder=1.5,
            )
        )
    half = float(view.half.min())
    corner_of = _farther_apart(features[0], features[-1], 0.16 * half)
    for number, path, goal, colour in zip(range(1, 5), features.swapaxes(0, 1), goals, _POINT_COLOURS, strict=True):
        kept = np.union1d(_extremes(path[:, 0]), _extremes(path[:, 1]))
        axes.plot(path[kept, 0], path[kept, 1], color=colour, linewidth=0.8, gid=f"path {number}")
        for name, place, mark in (("start", path[0], _START), ("end", path[-1], _END), ("goal", goal, _GOAL)):
            looks = {"markerfacecolor": colour, **mark}
            axes.plot(*place, color=colour, linestyle="", zorder=4, gid=f"{name} {number}", **looks)
        if not named:
            continue
        _point_the_way(axes, path, max(0.55 * float(np.hypot(*(goal - path[0]))), 0.1 * half), colour, number)
        at = path[corner_of]
        away = tuple(7 * np.where(at < goal, -1, 1))
        axes.annotate(
            str(number), at, away, textcoords="offset points", color=colour, ha="center", va="center", bbox=_HALO
        )


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place in inches: what a layout engine would find, without its time."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def _panels(
    figure: Figure, result: Result, box: tuple[float, float, float, float], values: Sequence[Array]
) -> list[_Panel]:
    """Add axes over the time, broken where a short transient would be lost in a long run.

    Parameters
    ----------
    box
        Left, bottom, width, height [in].
    values
        What the y axis shall hold.
    """
    left, bottom, width, height = box
    parts = _parts(result)
    if len(parts) == 2 and result.time[parts[0]][-1] > result.time[-1] / 2:
        parts = [slice(0, len(result.time))]
    gap = 0.1
    widths = [width] if len(parts) == 1 else [0.62 * (width - gap), 0.38 * (width - gap)]
    panels: list[_Panel] = []
    for part, own_width in zip(parts, widths, strict=True):
        axes = _axes(figure, left, bottom, own_width, height)
        _set_limits(axes, result.time[part], *values)
        panels.append(_Panel(axes, part, fixed=True))
        left += own_width + gap
    if len(panels) == 2:
        _break(panels[0].axes, panels[1].axes)
    return panels


def _break(first: Axes, second: Axes) -> None:
    """Mark that the time axis goes on in the second panel, on another scale."""
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


def _set_limits(axes: Axes, time: Array, *values: Array) -> None:
    """Let the x axis hold the time exactly, and the y axis the values with a margin, rounding noise not magnified."""
    begin, end = float(time[0]), float(time[-1])
    axes.set_xlim(begin, end if end > begin else begin + 1e-3)
    low, high = min(float(part.min()) for part in values), max(float(part.max()) for part in values)
    largest = max(abs(low), abs(high))
    middle, half = low / 2 + high / 2, max(0.56 * (high - low), 4e-3 * largest, 1e-4)
    axes.set_ylim(middle - half, middle + half)
    axes.xaxis.set_major_locator(MaxNLocator(min(10, max(2, int(_size(axes)[0] / 0.34))), steps=[1, 2, 5, 10]))
    for axis, size in ((axes.xaxis, abs(end)), (axes.yaxis, largest)):
        if not 1e-3 < size < 1e5:
            axis.set_major_formatter(FuncFormatter(_short))  # a common power of ten would lie below the title


def _size(axes: Axes) -> tuple[float, float]:
    """Give the width and height of axes [in]."""
    box, dots = axes.bbox, axes.figure.dpi
    return float(box.width / dots), float(box.height / dots)


def _label(axes: Axes, which: Literal["x", "y"], text: str, along: float = 0.5) -> None:
    """Label an axis at a fixed distance, clear of the longest tick labels, and at a fraction along it."""
    width, height = _size(axes)
    if which == "x":
        axes.set_xlabel(text)
        axes.xaxis.set_label_coords(along, -0.21 / height)
    else:
        axes.set_ylabel(text)
        axes.yaxis.set_label_coords(-0.54 / width, along)


def _describe(panels: Sequence[_Panel], label: str, title: str, *, time: bool = False) -> None:
    """Set the title and the label of the y axis, and say the time below, if it is not said by panels further down."""
    axes = panels[0].axes
    if not panels[0].fixed:
        axes.set_ylabel(label)
        axes.set_title(title)
        axes.set_xlabel("time [s]")
        return
    widths = [_size(panel.axes)[0] for panel in panels]
    _label(axes, "y", label)
    axes.set_title(title, loc="left")
    if time:
        _label(axes, "x", "time [s]", sum(widths) / 2 / widths[0])
    else:
        for panel in panels:
            panel.axes.tick_params(axis="x", labelbottom=False)


def _fill(
    panels: Sequence[_Panel],
    result: Result,
    values: Array,
    names: Sequence[str],
    inks: Sequence[_Ink],
    mean: int = 1,
    levels: Mapping[str, float] | None = None,
) -> None:
    """Draw the columns of values over the time, and name each beside its end.

    Parameters
    ----------
    mean
        Number of samples of a moving mean; above 1 it is drawn over the samples, which then are thin.
    levels
        Constants that are named likewise, in black.
    """
    means = _moving_mean(values, mean)
    for axes, part, _ in panels:
        if mean > 1:
            thin = [_Ink(ink.colour) for ink in inks]
            _draw(axes, result.time[part], values[part], names, thin, linewidth=_THIN, alpha=_FAINT)
            _draw(axes, result.time[part], means[part], [f"mean {name}" for name in names], inks)
        else:
            _draw(axes, result.time[part], values[part], names, inks)
    if not panels[-1].fixed:
        handles = [
            Line2D([], [], color=ink.colour, linestyle=ink.dashes, label=name)
            for name, ink in zip(names, inks, strict=False)  # there may be more inks than lines
        ]
        handles += [Line2D([], [], color=_BLACK, linestyle=":", label=name) for name in levels or {}]
        panels[-1].axes.legend(handles=handles, ncols=-(-len(handles) // 4), fontsize="small")
        return
    ends = {**dict(zip(names, means[-1], strict=True)), **(levels or {})}
    _label_ends(panels[-1].axes, ends, [*inks, *[_Ink(_BLACK) for _ in levels or ()]])


def _draw(axes: Axes, time: Array, values: Array, names: Sequence[str], inks: Sequence[_Ink], **looks: Any) -> None:
    """Draw each column as a line, as dots where there are too few samples for one."""
    dots: dict[str, Any] = {"marker": "o", "markersize": 2.5} if len(time) < 3 else {}
    for column, name, ink in zip(values.T, names, inks, strict=True):
        kept = _extremes(column)
        axes.plot(time[kept], column[kept], color=ink.colour, linestyle=ink.dashes, gid=name, **dots, **looks)


def _label_ends(axes: Axes, ends: Mapping[str, float], inks: Sequence[_Ink]) -> None:
    """Name lines to the right of the axes, each as near to its last value as the others allow."""
    low, high = axes.get_ylim()
    places = np.clip((np.array(list(ends.values())) - low) / (high - low), 0, 1)
    width, height = _size(axes)
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


def _farther_apart(starts: Array, ends: Array, enough: float) -> Literal[0, -1]:
    """Tell where names of paths have more room: at the starts (0), if that is enough, or at the ends (-1)."""

    def nearest(places: Array) -> float:
        return min(float(np.hypot(*(a - b))) for a, b in combinations(places, 2))

    return 0 if nearest(starts) >= min(enough, nearest(ends)) else -1


def _point_the_way(axes: Axes, path: Array, distance: float, colour: str, number: int) -> None:
    """Put an arrow head on a path at a distance along it."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    if not 0 < distance < travelled[-1]:
        return
    tail, head = (
        np.array([np.interp(at, travelled, path[:, axis]) for axis in (0, 1)]) for at in (0.99 * distance, distance)
    )
    direction = np.degrees(np.arctan2(*(head - tail)[::-1]))
    triangle = MarkerStyle(">").rotated(deg=float(direction))
    axes.plot(*head, marker=triangle, markersize=5, markeredgewidth=0, color=colour, gid=f"direction {number}")


def _explain(figure: Figure, handles: Mapping[str, Line2D]) -> None:
    """Put a legend into the upper right corner, above all panels."""
    figure.legend(list(handles.values()), list(handles), loc="upper right", ncols=len(handles), borderaxespad=0.2)


def _note_outcome(place: Figure | Axes, result: Result) -> None:
    """Say in the corner of a figure, or of the caller's axes, how a run ended that did not complete."""
    if result.outcome != "completed":
        text = f"{result.outcome.replace('_', ' ')} after {result.end_time:.4g} s"
        looks: dict[str, Any] = {"ha": "right", "va": "bottom", "fontweight": "bold", "color": _VERMILION}
        if isinstance(place, Figure):
            place.text(0.995, 0.012, text, fontsize=7, **looks)
        else:
            place.text(0.99, 0.02, text, transform=place.transAxes, **looks)


def _short(value: float, _place: int | None = None) -> str:
    """Write a very large or very small number in few characters, as 2.25e6."""
    digits, _, power = f"{value:.4g}".partition("e")
    return (f"{digits}e{int(power)}" if power else digits).replace("-", "−")


def _cell_text(value: float) -> str:
    for term, centre in _TERMS.items():
        if abs(value - centre) < 1e-9:
            return term
    return f"{value:.2g}"


# ---- Files ----------------------------------------------------------------------------------------------------------


@_styled
def _image(figure: Figure, extension: str) -> bytes:
    """Give a figure as the bytes of a file, without a date."""
    buffer = io.BytesIO()
    if extension == "svg":
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    else:
        figure.savefig(buffer, format="png", pil_kwargs={"compress_level": 1})  # hardly larger, much faster
    return buffer.getvalue()


def _write(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write files under temporary names, then give all of them their own.

    Raises
    ------
    OSError
        Something could not be written; no temporary file is left.
    """
    folder.mkdir(parents=True, exist_ok=True)
    temporary = {folder / f".{name}.{os.getpid()}.part": folder / name for name in files}
    try:
        for path, content in zip(temporary, files.values(), strict=True):
            path.write_bytes(content)
        for path, final in temporary.items():
            path.replace(final)
    finally:
        for path in temporary:
            path.unlink(missing_ok=True)
    return list(temporary.values())
