"""The paper's figures 2 to 5, drawn from a run. pyplot and the user's style are not changed.

Each function returns a `matplotlib.figure.Figure` of a printed column's or page's width, with text of 7 to 8 points.
Given ``ax`` or ``axes`` of an existing figure, it draws into these, in the caller's style, and returns them.
Lines have every sample, or, if that is more than print resolves, the smallest and largest sample of each bin, so that
no peak is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress, product
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from hexservo import _core
from hexservo.draw.legs import leg_limits
from hexservo.draw.panels import (
    Panel,
    axes_at,
    describe,
    draw_band,
    draw_label,
    draw_legend,
    draw_lines,
    draw_over_time,
    fill_panels,
    label_ends,
    note_outcome,
    point_the_way,
    require_axes,
    set_limits,
    whole_run,
)
from hexservo.draw.style import (
    BLACK,
    BLUE,
    COLUMN,
    DASH_DOT,
    DASHED,
    GREEN,
    GREY,
    HALO,
    ORANGE,
    PAGE,
    PURPLE,
    VERMILION,
    Ink,
    image_bytes,
    styled,
)
from hexservo.draw.wrench import control_wrench
from hexservo.run.labels import farther_apart, roomiest_place
from hexservo.run.leg_limits import exceeded_limits, limits_of_motion
from hexservo.run.metrics import metrics, since_settling
from hexservo.run.result import Result, require_run
from hexservo.run.samples import ImageView, feature_names, fuzzy_acted, image_views, initial_direction, path_samples
from hexservo.run.samples import parts as _parts
from hexservo.run.time_panels import motion_panels
from hexservo.scenario.arrays import Array
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.pixels import desired_features
from hexservo.scenario.rules import TERMS, term_text
from hexservo.scenario.scenario import Scenario, require_scenario

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINT_COLOURS = (BLUE, VERMILION, GREEN, BLACK, PURPLE, ORANGE)
_POINT_DASHES = (("-", DASHED), ((0, (9, 1.2)), DASH_DOT), ((0, (1, 1)), (0, (9, 1.2, 1.2, 1.2))))  # of x, y; by six
_MOST_LABELS = 14  # of lines beside the feature errors: as many as stand apart
_WORST = 2  # lines that are labelled where there are more: those with the largest errors at the end

_LABEL_OFFSET = 7.0  # of a point's number from its mark, along each axis [points]
_LABEL_ROOM = 8.5  # between a number and what else is drawn: half of either and a gap [points]
_LABEL_EDGE = 5.5  # between the middle of a number and the axes: half its height, and its halo [points]
_BESIDE = np.array([*product((1.0, -1.0), repeat=2), (1.4, 0.0), (-1.4, 0.0), (0.0, 1.4), (0.0, -1.4)])  # offsets
_SAMPLES_OF_PATH = 400  # that numbers keep away from

_REACH = 0.03  # of half the axes: where a path has left the mark of its start, and an arrow has its direction
_ARROW_OFFSET = 6.5  # of an arrow head from the start: clear of that mark [points]

_START: dict[str, Any] = {"marker": "o", "markersize": 5, "markerfacecolor": "white", "markeredgewidth": 1.1}
_END: dict[str, Any] = {"marker": "o", "markersize": 3.2, "markeredgewidth": 0}
_GOAL: dict[str, Any] = {"marker": "s", "markersize": 7, "markerfacecolor": "none", "markeredgewidth": 0.9}
_DIVERGING = "PuOr_r"  # light in the middle, and distinguishable with every kind of colour vision


# ---- The figures ----------------------------------------------------------------------------------------------------


@overload
def rule_table(scenario: Scenario) -> Figure: ...


@overload
def rule_table(scenario: Scenario, *, ax: Axes) -> Axes: ...


@styled
def rule_table(scenario: Scenario, *, ax: Axes | None = None) -> Figure | Axes:
    """Draw the rule table of the fuzzy systems, figure 2(a) (docs/model.md section 5).

    Rows are the terms of the first input u (the scaled image wrench g of `hybrid`, pose error e of `composite`),
    columns those of its rate. A cell has the term of the output, or the number if it is not the centre of a term.

    Parameters
    ----------
    ax
        Axes to draw into; the colour bar takes space from them. None: a new figure.

    Returns
    -------
    Figure or Axes
        The new figure, or `ax`.

    Raises
    ------
    TypeError
        For anything but a `Scenario`, and for axes that are none.
    ValueError
        For a law without fuzzy systems.
    """
    require_scenario(scenario)
    require_axes(ax)
    law = scenario.controller.law
    if not _core.LAW_TRAITS[law].memory:
        raise ValueError(f"controller.law: expected one with fuzzy systems, got {law}")
    table = core_parameters(scenario)[f"controller.{law}.fuzzy.table"]
    terms = list(TERMS)
    limit = max(1.0, float(np.abs(table).max()))
    figure = Figure(figsize=(COLUMN, 2.75))
    axes = axes_at(figure, 0.52, 0.12, 2.2, 2.2) if ax is None else ax
    image = axes.imshow(table, cmap=_DIVERGING, vmin=-limit, vmax=limit)
    for (row, column), value in np.ndenumerate(table):
        ink = "white" if abs(value) > 0.6 * limit else "black"
        axes.text(column, row, term_text(value), ha="center", va="center", color=ink, fontsize=7)
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
    meaning = "pose error" if _core.LAW_TRAITS[law].prior else "image wrench"
    axes.set_ylabel(f"u, the scaled {meaning} [1]")
    place: dict[str, Any] = {"ax": axes} if ax is not None else {"cax": axes_at(figure, 2.82, 0.12, 0.1, 2.2)}
    bar = axes.figure.colorbar(image, ticks=MaxNLocator(4), **place)
    bar.outline.set_visible(False)
    bar.set_label("output [1]")
    return figure if ax is None else ax


@overload
def feature_errors(result: Result) -> Figure: ...


@overload
def feature_errors(result: Result, *, ax: Axes) -> Axes: ...


@styled
def feature_errors(result: Result, *, ax: Axes | None = None) -> Figure | Axes:
    """Draw the eight feature errors in px over the time in s, figure 2(b).

    A run that settles is drawn in two panels: until somewhat after settling, and the rest on a different scale.
    The settling band is shaded.

    Parameters
    ----------
    ax
        Axes to draw the whole run into. None: a new figure.

    Returns
    -------
    Figure or Axes
        The new figure, or `ax`.

    Raises
    ------
    TypeError
        For anything but a `Result`, and for axes that are none.
    ValueError
        Where the data are not those of a run (see `Result.save`).
    """
    require_run(result)
    require_axes(ax)
    band = result.scenario.metrics.band
    points = result.scenario.target.count
    names, inks = feature_names(points), _inks_of_points(points)
    if ax is not None:
        (panel,) = whole_run(ax, result, [result.feature_error])
        draw_band(ax, band)
        fill_panels([panel], result, result.feature_error, names, inks)
        describe([panel], "feature error [px]", f"Feature errors (shaded: ±{band:g} px)", time=True)
        note_outcome(ax, result)
        return ax
    families = _families(points)
    figure = Figure(figsize=(PAGE, 2.48 if len(families) == 2 else 2.68))
    parts = _parts(result)
    if len(parts) == 1:
        boxes = [(0.68, 6.11)]
        titles = [f"Feature errors (shaded: ±{band:g} px)"]
    else:
        boxes = [(0.68, 2.75), (4.2, 2.59)]
        settled = since_settling(metrics(result), result.scenario.metrics, 3)
        titles = [f"Within ±{band:g} px (shaded) {settled}", "The rest, magnified"]
    for part, (left, width), title in zip(parts, boxes, titles, strict=True):
        axes = axes_at(figure, left, 0.48, width, 1.72)
        draw_band(axes, band)
        errors = result.feature_error[part]
        draw_lines(axes, result.time[part], errors, names, inks)
        set_limits(axes, result.time[part], errors)
        describe([Panel(axes, part, fixed=True)], "feature error [px]", title, time=True)
    ends = np.abs(errors[-1])
    labelled = range(len(names)) if len(names) <= _MOST_LABELS else np.argsort(-ends, kind="stable")[:_WORST]
    label_ends(axes, {names[line]: float(errors[-1, line]) for line in labelled}, [inks[line] for line in labelled])
    draw_legend(figure, {name: Line2D([], [], color=GREY, linestyle=dashes) for name, dashes in families.items()})
    note_outcome(figure, result)
    return figure


@overload
def feature_paths(result: Result) -> Figure: ...


@overload
def feature_paths(result: Result, *, ax: Axes) -> Axes: ...


@styled
def feature_paths(result: Result, *, ax: Axes | None = None) -> Figure | Axes:
    """Draw the paths of the features in the image plane in px, axes equal, figure 3.

    The arrow head beside each start is the initial direction of the feature, by the first 3 % of half the axes; a
    feature that stays nearer to its start has none. y points up, as in (4), looking along the optical axis.
    If ``camera.image_size`` is given, the axes have the aspect ratio and the border of the image, as lens, principal
    point and focal lengths place it among features; if the paths take a small part of the image, a second panel
    magnifies them.

    Parameters
    ----------
    ax
        Axes to draw into, without the second panel. None: a new figure.

    Returns
    -------
    Figure or Axes
        The new figure, or `ax`.

    Raises
    ------
    TypeError
        For anything but a `Result`, and for axes that are none.
    ValueError
        Where the data are not those of a run (see `Result.save`).
    """
    require_run(result)
    require_axes(ax)
    views = image_views(result)
    if ax is not None:
        _draw_paths(ax, result, views[0])
        ax.set_xlabel("image x [px]")
        ax.set_ylabel("image y [px]")
        ax.legend(handles=_path_marks(), loc="best", fontsize="small")
        note_outcome(ax, result)
        return ax
    height = 2.7 * float(views[0].half[1] / views[0].half[0])
    figure = Figure(figsize=(COLUMN if len(views) == 1 else PAGE, height + 0.8))
    for number, view in enumerate(views):
        axes = axes_at(figure, 0.68 + 3.6 * number, 0.48, 2.7, height)
        _draw_paths(axes, result, view, named=number == len(views) - 1)
        draw_label(axes, "x", "image x [px]")
        draw_label(axes, "y", "image y [px]")
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
    note_outcome(figure, result)
    return figure


@overload
def platform_motion(result: Result) -> Figure: ...


@overload
def platform_motion(result: Result, *, axes: Sequence[Axes] | NDArray[Any]) -> tuple[Axes, ...]: ...


@styled
def platform_motion(result: Result, *, axes: Sequence[Axes] | NDArray[Any] | None = None) -> Figure | tuple[Axes, ...]:
    """Draw the platform's position relative to home in mm and its rotation vector in mrad, in B, figure 4.

    The rotation vector is the axis times the angle (at most pi) of the turn from home, where it is zero.

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
    TypeError
        For anything but a `Result`, and for axes that are none.
    ValueError
        For any other number of axes, and where the data are not those of a run (see `Result.save`).
    """
    require_run(result)
    boxes = [(0.68, bottom, 6.04, 1.3) for bottom in (2.01, 0.48)]
    return draw_over_time(Figure(figsize=(PAGE, 3.6)), result, motion_panels(result), boxes, axes)


def paper_images(result: Result) -> dict[str, bytes]:
    """Return the files of `hexservo.draw.paper_figures` by name."""
    figures = {
        **({"fig2a_rule_table": rule_table(result.scenario)} if fuzzy_acted(result) else {}),
        "fig2b_feature_errors": feature_errors(result),
        "fig3_feature_paths": feature_paths(result),
        "fig4_platform_motion": platform_motion(result),
        "fig5_wrench": control_wrench(result),
        **({"legs": leg_limits(result)} if _legs_matter(result) else {}),
    }
    return {
        f"{name}.{extension}": image_bytes(figure, extension)
        for name, figure in figures.items()
        for extension in ("svg", "png")
    }


def _legs_matter(result: Result) -> bool:
    """Return whether the robot limits more than its stroke, or the run exceeded that or ended there."""
    limits = limits_of_motion(result.scenario)
    exceeded = {limit.kind for limit in exceeded_limits(result.scenario, metrics(result))}
    return len(limits) > 1 or "stroke" in exceeded or result.outcome == "leg_limit"


# ---- The image ------------------------------------------------------------------------------------------------------


def _point_colour(number: int) -> str:
    """Return the colour of a point, counted from 0; where there are more points than colours, they repeat."""
    return _POINT_COLOURS[number % len(_POINT_COLOURS)]


def _inks_of_points(points: int) -> list[Ink]:
    """Return the inks of x and y of each point: points of the same colour have other dashes, up to 18 points."""
    count = len(_POINT_COLOURS)
    return [
        Ink(_point_colour(number), dashes)
        for number in range(points)
        for dashes in _POINT_DASHES[number // count % len(_POINT_DASHES)]
    ]


def _families(points: int) -> dict[str, Any]:
    """Return the dashes of the lines of feature errors by the names of those that have them, "x₁ to x₄"."""
    names, count = feature_names(points), len(_POINT_COLOURS)
    found = {}
    for first, pair in zip(range(0, points, count), _POINT_DASHES, strict=False):
        last = min(first + count, points) - 1
        for axis, dashes in enumerate(pair):
            one, other = names[2 * first + axis], names[2 * last + axis]
            found[one if one == other else f"{one} to {other}"] = dashes
    return found


def _path_marks() -> list[Line2D]:
    return [
        Line2D([], [], linestyle="", color=GREY, label=name, **{"markerfacecolor": GREY, **mark})
        for name, mark in (("start", _START), ("end of the run", _END), ("goal", _GOAL))
    ]


def _draw_paths(axes: Axes, result: Result, view: ImageView, *, named: bool = True) -> None:
    """Draw border, paths, starts, ends and goals of the features, and on request their arrows and names."""
    features = result.features.reshape(len(result.time), -1, 2)
    goals = desired_features(result.scenario).reshape(-1, 2)
    axes.set_xlim(*view.limits[0])
    axes.set_ylim(*view.limits[1])
    axes.set_aspect("equal", adjustable="box")
    if view.border is not None:
        axes.add_patch(Polygon(view.border, fill=False, edgecolor=GREY, linewidth=0.8, gid="border", zorder=1.5))
    half, arrows = float(view.half.min()), np.zeros((len(goals), 2))
    for number, (path, goal) in enumerate(zip(features.swapaxes(0, 1), goals, strict=True), start=1):
        colour = _point_colour(number - 1)
        kept = path_samples(*path.T)
        axes.plot(path[kept, 0], path[kept, 1], color=colour, linewidth=0.8, gid=f"path {number}")
        for name, place, mark in (("start", path[0], _START), ("end", path[-1], _END), ("goal", goal, _GOAL)):
            looks = {"markerfacecolor": colour, **mark}
            axes.plot(*place, color=colour, linestyle="", zorder=4, gid=f"{name} {number}", **looks)
        direction = initial_direction(path, _REACH * half) if named else None
        if direction is not None:
            arrows[number - 1] = _ARROW_OFFSET * direction
            point_the_way(axes, path[0], arrows[number - 1], colour, number)
    if named:
        _number_points(axes, features, goals, arrows, farther_apart(features[0], features[-1], 0.16 * half))


def _number_points(axes: Axes, features: Array, goals: Array, arrows: Array, corner_of: int) -> None:
    """Write the number of each point where neither marks and paths nor other numbers are, as far as there is room.

    They stay within the axes, clear of their lines, where a place near the start or the end does.

    Parameters
    ----------
    axes
        With its limits and its aspect.
    features, goals
        Of the samples (n, points, 2) and of the goal (points, 2).
    arrows
        Offsets of the arrow heads from the starts, (points, 2) [points]; 0 where there is none.
    corner_of
        0: beside the start if there is room; -1: beside the end.
    """
    axes.apply_aspect()

    def on_paper(places: Array) -> Array:  # [points]
        flat = axes.transData.transform(places.reshape(-1, 2)) * 72.0 / axes.figure.dpi
        return np.asarray(flat.reshape(places.shape))

    every = max(1, len(features) // _SAMPLES_OF_PATH)
    paths, ends = on_paper(features[::every]).reshape(-1, 2), on_paper(features[[0, -1]])
    taken = np.concatenate([paths, ends.reshape(-1, 2), on_paper(goals), ends[0] + arrows])
    low, high = axes.bbox.get_points() * 72.0 / axes.figure.dpi
    for number, goal in enumerate(goals):
        at = features[corner_of, number]
        usual = np.where(at < goal, -1.0, 1.0)
        offsets = np.concatenate([[usual], _BESIDE]) * _LABEL_OFFSET
        places = [(at, offset) for at in features[[corner_of, -1 - corner_of], number] for offset in offsets]
        candidates = np.array([on_paper(at) + offset for at, offset in places])
        inside = ((candidates >= low + _LABEL_EDGE) & (candidates <= high - _LABEL_EDGE)).all(axis=1)
        if inside.any():
            places, candidates = list(compress(places, inside)), candidates[inside]
        chosen = roomiest_place(candidates, taken, _LABEL_ROOM)
        taken = np.concatenate([taken, candidates[[chosen]]])
        at, away = places[chosen]
        axes.annotate(
            str(number + 1),
            at,
            tuple(away),
            textcoords="offset points",
            color=_point_colour(number),
            ha="center",
            va="center",
            bbox=HALO,
        )
