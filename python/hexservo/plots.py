"""The paper's figures 2 to 5, drawn from a run. Nothing here simulates, and nothing touches pyplot or the user's style.

Each function gives a `matplotlib.figure.Figure` of a printed column's or page's width, with text of 7 to 8 points.
`paper_figures` writes all of them. Lines keep every sample until that is more than print resolves; from there on they
keep each bin's smallest and largest sample, so that no peak is lost.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, ParamSpec, TypeAlias, TypeVar

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from hexservo import _core
from hexservo._metrics import metrics
from hexservo._parameters import core_parameters
from hexservo._scenario import _TERMS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hexservo._result import Result
    from hexservo._scenario import Scenario

__all__ = ["control_wrench", "feature_errors", "feature_paths", "paper_figures", "platform_motion", "rule_table"]

Array: TypeAlias = NDArray[np.float64]
P = ParamSpec("P")
T = TypeVar("T")


# ---- Style ----------------------------------------------------------------------------------------------------------

_COLUMN, _PAGE = 3.5, 7.16  # widths of a figure in a two-column paper [in]
_SETTLED = 2.0  # the settling band of the metrics [px]
_MAX_POINTS = 1200  # of one line in one panel: four per point of paper

# Okabe and Ito's colours: apart for every kind of colour vision. The dashes tell them apart in grey.
_BLACK, _BLUE, _VERMILION, _GREEN, _PURPLE, _ORANGE = "#000000", "#0072B2", "#D55E00", "#009E73", "#AA4499", "#E69F00"
_GREY = "0.45"
_SOLID: Any = "-"
_DASHED: Any = (0, (4, 1.2))
_DOTTED: Any = (0, (1.2, 1))
_DASH_DOT: Any = (0, (5, 1, 1.2, 1))
_AXIS_STYLES = ((_BLUE, _SOLID), (_VERMILION, _DASHED), (_GREEN, _DASH_DOT))
_POINT_COLOURS = (_BLUE, _VERMILION, _GREEN, _BLACK)
_LEG_STYLES = (
    (_BLACK, _SOLID),
    (_ORANGE, _SOLID),
    (_BLUE, _DASHED),
    (_VERMILION, _DASHED),
    (_GREEN, _DASH_DOT),
    (_PURPLE, _DASH_DOT),
)

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
    "axes.formatter.limits": (-4, 5),
    "axes.titlepad": 5,
    "axes.labelpad": 2.5,
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
    with matplotlib.rc_context({**defaults, **_STYLE}):  # type: ignore[arg-type]  # its keys are literals
        yield


def _styled(function: Callable[P, T]) -> Callable[P, T]:
    @wraps(function)
    def styled(*args: P.args, **kwargs: P.kwargs) -> T:
        with _our_style():
            return function(*args, **kwargs)

    return styled


# ---- The figures ----------------------------------------------------------------------------------------------------


@_styled
def rule_table(scenario: Scenario) -> Figure:
    """Draw the rule table of the fuzzy systems, figure 2(a) (docs/model.md section 5).

    Rows are the terms of the first input u (the scaled image wrench g), columns those of its rate. A cell shows the
    output's term, or the number where it is no term's centre.
    """
    table = np.asarray(core_parameters(scenario).gains.fuzzy.table)
    terms = list(_TERMS)
    limit = max(1.0, float(np.abs(table).max()))
    figure = Figure(figsize=(_COLUMN, 2.95))
    axes = _axes(figure, 0.56, 0.12, 2.2, 2.2)
    image = axes.imshow(table, cmap="PuOr_r", vmin=-limit, vmax=limit)
    for row in range(7):
        for column in range(7):
            value = float(table[row, column])
            axes.text(
                column,
                row,
                _cell_text(value),
                ha="center",
                va="center",
                color="white" if abs(value) > 0.6 * limit else "black",
                fontsize=7,
            )
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
    axes.set_xlabel("term of the rate of u [1]", labelpad=4)
    axes.set_ylabel("term of u, the scaled image wrench [1]", labelpad=2)
    bar = figure.colorbar(image, cax=_axes(figure, 2.86, 0.12, 0.1, 2.2))
    bar.outline.set_visible(False)  # type: ignore[operator]  # a Spine, whatever its stub says
    bar.set_label("output [1]")
    return figure


@_styled
def feature_errors(result: Result) -> Figure:
    """Draw the eight feature errors in px over the time in s, figure 2(b).

    A run that settles is shown in two panels: until somewhat after it has settled, then the rest on a scale of its
    own. The band of ±2 px is shaded.
    """
    split = _split(result)
    figure = Figure(figsize=(_PAGE, 2.4))
    styles = [(_POINT_COLOURS[i // 2], (_SOLID, _DASHED)[i % 2]) for i in range(8)]
    names = ["x₁", "y₁", "x₂", "y₂", "x₃", "y₃", "x₄", "y₄"]
    errors = result.feature_error
    if split is None:
        panels = [(_axes(figure, 0.58, 0.4, _PAGE - 1.0, 1.7), _whole(result))]
    else:
        panels = [
            (_axes(figure, 0.58, 0.4, 2.95, 1.7), _Window(result.time[0], split)),
            (_axes(figure, 4.12, 0.4, 2.62, 1.7), _Window(split, result.time[-1])),
        ]
    for axes, window in panels:
        axes.axhspan(-_SETTLED, _SETTLED, color="0.91", linewidth=0, zorder=0)
        axes.axhline(0, color=_GREY, linewidth=0.5, zorder=1)
        lines = _draw(axes, result.time, errors, window, styles)
        _limit(axes, window, [errors[window.indices(result.time)]])
        axes.set_xlabel("time [s]")
        axes.set_ylabel("feature error [px]")
    _label_ends(axes, names, lines)
    first = panels[0][0]
    if split is None:
        first.set_title(f"Feature errors (shaded: ±{_SETTLED:g} px)", loc="left")
    else:
        settled = metrics(result)["settling_time"]
        first.set_title(f"Within ±{_SETTLED:g} px (shaded) from {settled:.3g} s on", loc="left")
        axes.set_title("The rest, on a scale of its own", loc="left")
    _note_outcome(figure, result)
    return figure


@_styled
def feature_paths(result: Result) -> Figure:
    """Draw the paths of the four features in the image plane in px, axes equal, figure 3.

    The arrow shows the way each feature starts. y points up, as in (4) seen along the optical axis.
    """
    features = result.features.reshape(-1, 4, 2)
    goals = np.asarray(result.scenario.target.desired_features).reshape(4, 2)
    figure = Figure(figsize=(_COLUMN, 3.55))
    axes = _axes(figure, 0.52, 0.42, 2.85, 2.85)
    everything = np.concatenate([features.reshape(-1, 2), goals])
    low, high = everything.min(axis=0), everything.max(axis=0)
    middle, half = low / 2 + high / 2, max(0.58 * float((high - low).max()), 1.0)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal", adjustable="box")
    for index, (goal, colour) in enumerate(zip(goals, _POINT_COLOURS, strict=True)):
        path = features[:, index]
        kept = np.union1d(_extremes(path[:, 0], _MAX_POINTS), _extremes(path[:, 1], _MAX_POINTS))
        axes.plot(path[kept, 0], path[kept, 1], color=colour, linewidth=0.8, gid=f"path {index + 1}")
        axes.plot(*path[0], "o", color=colour, mfc="white", ms=5, mew=1.1, zorder=4, gid=f"start {index + 1}")
        axes.plot(*path[-1], "o", color=colour, ms=3.2, mew=0, zorder=4, gid=f"end {index + 1}")
        axes.plot(*goal, "x", color=colour, ms=6.5, mew=1.1, zorder=5, gid=f"goal {index + 1}")
        _start_arrow(axes, path, goal, colour)
        _name_start(axes, str(index + 1), path[0], goal, colour)
    axes.set_xlabel("image x [px]")
    axes.set_ylabel("image y [px]")
    marks = (("start", "o", 5.0, "white"), ("end of the run", "o", 3.2, _GREY), ("goal", "x", 6.0, _GREY))
    axes.legend(
        handles=[
            Line2D([], [], linestyle="", marker=mark, markersize=size, color=_GREY, markerfacecolor=fill, label=name)
            for name, mark, size, fill in marks
        ],
        loc="lower left",
        bbox_to_anchor=(-0.02, 0.985),
        ncols=3,
        handletextpad=0.1,
        columnspacing=1.2,
        borderpad=0.2,
    )
    _note_outcome(figure, result)
    return figure


@_styled
def platform_motion(result: Result) -> Figure:
    """Draw the platform's position relative to home in mm and its rotation vector in mrad, in B, figure 4.

    The rotation vector is the axis times the angle (at most pi) of R_BE; at home it is zero.
    """
    displacement = 1e3 * (result.position - np.asarray(result.scenario.robot.home_position))
    rotation = 1e3 * _rotation_vector(result.quaternion)
    figure = Figure(figsize=(_PAGE, 3.5))
    for bottom, values, names, label, title in (
        (1.98, displacement, ["x", "y", "z"], "displacement [mm]", "Position relative to home, in B (z points down)"),
        (0.4, rotation, ["θx", "θy", "θz"], "rotation vector [mrad]", "Orientation: axis times angle, in B"),
    ):
        panels = _panels(figure, result, 0.62, bottom, _PAGE - 1.06, 1.2)
        for axes, window in panels:
            lines = _draw(axes, result.time, values, window, _AXIS_STYLES)
            _limit(axes, window, [values])
        panels[0][0].set_ylabel(label)
        panels[0][0].set_title(title, loc="left")
        _label_ends(panels[-1][0], names, lines)
        if bottom < 1:
            _label_time(figure, panels)
    _note_outcome(figure, result)
    return figure


@_styled
def control_wrench(result: Result) -> Figure:
    """Draw the wrench in N and mN m, in B, and the six leg forces in N, figure 5.

    Thin lines are the samples; where the switching term chatters, thick lines are their moving means. The dotted line
    is the estimated weight Ḡ that the law feeds forward (1), (15).
    """
    weight = -result.scenario.robot.mass * _core.RigidBody().gravity
    force, moment = result.wrench[:, :3], 1e3 * result.wrench[:, 3:]
    half = _mean_half_width(result)
    figure = Figure(figsize=(_PAGE, 4.55))
    left, top, width, height, gap = 0.6, 2.98, 2.52, 1.12, 0.28
    cells: list[tuple[float, float, float, float, Array, list[str], Any, str, str]] = [
        (left, top, width, height, force[:, :2], ["fx", "fy"], _AXIS_STYLES[:2], "force [N]", "Force in B, horizontal"),
        (left, top - height - gap, width, height, force[:, 2:], ["fz"], _AXIS_STYLES[2:], "force [N]", "Vertical"),
        (left, 0.4, width, height - 0.1, moment, ["mx", "my", "mz"], _AXIS_STYLES, "moment [mN m]", "Moment in B"),
        (
            left + width + 0.98,
            0.4,
            width + 0.18,
            top + height - 0.4,
            result.leg_forces,
            [f"leg {leg}" for leg in range(1, 7)],
            _LEG_STYLES,
            "leg force [N]",
            "Leg forces (positive: pushing)",
        ),
    ]
    for x, y, cell_width, cell_height, values, names, styles, label, title in cells:
        panels = _panels(figure, result, x, y, cell_width, cell_height)
        shown = [values]
        for axes, window in panels:
            lines = _draw_chatter(axes, result.time, values, window, styles, half)
            if names == ["fz"]:
                shown = [values, np.asarray([[weight]])]
                lines += axes.plot(axes.get_xlim(), [weight] * 2, color=_BLACK, linestyle=_DOTTED, gid="weight")
            _limit(axes, window, shown)
        if names == ["fz"]:
            lines[-1].set_xdata([panels[-1][1].begin, panels[-1][1].end])
        panels[0][0].set_ylabel(label)
        panels[0][0].set_title(title, loc="left")
        _label_ends(panels[-1][0], [*names, "Ḡ"][: len(lines)], lines)
        if y < 1:
            _label_time(figure, panels)
    _note_outcome(figure, result)
    return figure


def paper_figures(result: Result, folder: str | os.PathLike[str]) -> list[Path]:
    """Write figures 2(a), 2(b), 3, 4 and 5 as SVG and PNG (200 dpi) into a folder, which is made if need be.

    Files of the same name are replaced. The same run gives the same bytes. Each file appears whole or not at all, and
    none appears before all are drawn.

    Returns
    -------
    list of Path
        The ten files: for each figure the SVG, then the PNG.

    Raises
    ------
    ValueError
        The folder cannot be made or written to.
    """
    drawings = {
        "fig2a_rule_table": rule_table(result.scenario),
        "fig2b_feature_errors": feature_errors(result),
        "fig3_feature_paths": feature_paths(result),
        "fig4_platform_motion": platform_motion(result),
        "fig5_wrench": control_wrench(result),
    }
    contents = {
        f"{name}.{kind}": _rendered(figure, kind) for name, figure in drawings.items() for kind in ("svg", "png")
    }
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
        return _write_all(target, contents)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f'folder: expected a folder that exists or can be made, and can be written to, got "{target}" ({reason})'
        ) from error
