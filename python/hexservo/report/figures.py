"""The paper's figures 2 to 5 and the legs' limits as charts, from the same samples as `hexservo.draw.plots`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from hexservo import _core
from hexservo.report.charts import TOLERANCE, Spec, axes, chart, encoded, thinned, trace
from hexservo.report.html import Html
from hexservo.run.labels import farther_apart, roomiest_place
from hexservo.run.leg_motion import leg_motions
from hexservo.run.samples import (
    ImageView,
    axis_range,
    broken_parts,
    feature_names,
    fuzzy_acted,
    image_views,
    mean_period,
    mean_samples,
    moving_mean,
    parts,
    path_samples,
    time_range,
)
from hexservo.run.time_panels import TimePanel, leg_panel, motion_panels, wrench_panels
from hexservo.scenario.arrays import Array
from hexservo.scenario.motion import moves
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.pixels import desired_features
from hexservo.scenario.rules import TERMS, term_text
from hexservo.scenario.scenario import load_scenario

if TYPE_CHECKING:
    from hexservo.run.result import Result


class _Ink(NamedTuple):
    colour: str
    dash: str = "solid"


_POINT_COLOURS = ("@blue", "@vermilion", "@green", "@black", "@purple", "@orange")  # repeated for more points
# Of x, y; by colours' turns. Long dashes are shorter than those of plotly.js, of which its legend has one: 30 px.
_POINT_DASHES = (("solid", "dash"), ("12px,3px", "dashdot"), ("dot", "12px,3px,2px,3px"))
_AXES: tuple[_Ink, ...] = (_Ink("@blue"), _Ink("@vermilion", "dash"), _Ink("@green", "dashdot"))
_LEGS = (
    _Ink("@black"),
    _Ink("@orange"),
    _Ink("@blue", "dash"),
    _Ink("@vermilion", "dash"),
    _Ink("@green", "dashdot"),
    _Ink("@purple", "dashdot"),
)
_DIVERGING = [[0, "#2d004b"], [0.25, "#998ec3"], [0.5, "#f7f7f7"], [0.75, "#f1a340"], [1, "#7f3b08"]]
_PATHS = "Paths of the features"
_LABEL_OFFSET = 13.0  # of a point's number from its mark, along each axis [px]
_LABEL_ROOM = 14.0  # between a number and what else is drawn [px]
_LABEL_SIDES = np.array([*product((1.0, -1.0), repeat=2), (1.4, 0.0), (-1.4, 0.0), (0.0, 1.4), (0.0, -1.4)])
_SAMPLES_OF_PATH = 200  # that numbers stay clear of
_WIDE, _NARROW = 550.0, 390.0  # widths of the axes of one chart, and of one of two [px]
_FIRST_SHARE, _GAP = 0.62, 0.025  # of the width: the panel of the transient, and between the two


def figures(result: Result) -> list[tuple[str, list[Html]]]:
    """Return each figure as heading and charts; a run in which no fuzzy systems act has no rule table."""
    drawn = [
        *([("Rule table of the fuzzy systems", "2a", [_rule_table(result)])] if fuzzy_acted(result) else []),
        ("Feature errors", "2b", _feature_errors(result)),
        ("Feature paths in the image", "3", _feature_paths(result)),
        ("Motion of the platform", "4", [_over_time(result, panel) for panel in motion_panels(result)]),
        (_wrench_title(result), "5", _wrench(result)),
        ("Legs and their limits", "", [_over_time(result, leg_panel(motion)) for motion in leg_motions(result)]),
    ]
    if moves(result.scenario.base_motion):
        drawn.append(("Motion of the base", "", _base_motion(result)))
    of_paper = _is_of_the_paper(result)
    return [(f"{title} (figure {number})" if of_paper and number else title, charts) for title, number, charts in drawn]


def _is_of_the_paper(result: Result) -> bool:
    """Return whether a run is that of the packaged scenario `paper`, whose figures have the paper's numbers."""
    if result.scenario.name != "paper" or not result.by_law:
        return False
    own, paper = result.scenario.to_mapping(), load_scenario("paper").to_mapping()
    for mapping in (own, paper):
        del mapping["description"], mapping["simulation"]["log_every"]
    return own == paper


def _rule_table(result: Result) -> Html:
    law = result.scenario.controller.traits
    values = core_parameters(result.scenario)[f"controller.{law.name}.fuzzy.table"]
    limit = max(1.0, float(np.abs(values).max()))
    terms = list(TERMS)
    spec = {
        "data": [
            {
                "type": "heatmap",
                "x": terms,
                "y": terms,
                "z": encoded(values),
                "text": [[term_text(value) for value in row] for row in values],
                "texttemplate": "%{text}",
                "zmin": -limit,
                "zmax": limit,
                "colorscale": _DIVERGING,
                "xgap": 1,
                "ygap": 1,
                "colorbar": {"title": {"text": "output [1]", "side": "right"}, "thickness": 12, "outlinewidth": 0},
                "hovertemplate": "u %{y}, its rate %{x}: %{z:.3g}<extra></extra>",
            }
        ],
        "layout": axes("rate of u [1]", "u [1]"),
    }
    spec["layout"]["yaxis"]["autorange"] = "reversed"  # type: ignore[index]
    for axis in ("xaxis", "yaxis"):
        spec["layout"][axis]["dtick"] = 1  # type: ignore[index]
    spec["layout"] |= {"maxWidth": 430, "aspect": 1}  # type: ignore[operator]
    meaning = "pose error" if law.prior else "image wrench"
    note = f"Rows: terms of u, the scaled {meaning}. Columns: terms of its rate. The table is that of all six systems."
    return chart(spec, "Output term of each rule", note=note, height=360)


def _feature_errors(result: Result) -> list[Html]:
    shown = parts(result)
    titles = ["Feature errors"] if len(shown) == 1 else ["Until the run has settled", "The rest, magnified"]
    charts, band, points = [], result.scenario.metrics.band, result.scenario.target.count
    for part, title in zip(shown, titles, strict=True):
        time, errors = result.time[part], result.feature_error[part]
        low, high = axis_range(errors)
        inks = [
            _Ink(colour, dash)
            for number, colour in enumerate(_point_colours(points))
            for dash in _POINT_DASHES[number // len(_POINT_COLOURS) % len(_POINT_DASHES)]
        ]
        data = _lines(time, errors, feature_names(points), inks, tolerance=TOLERANCE * (high - low))
        within = low >= -band and high <= band
        note = f"All values are within ±{band:g} px." if within else f"Shaded: ±{band:g} px."
        layout = axes("time [s]", "feature error [px]", shapes=[] if within else [_band(band)])
        layout["yaxis"]["range"] = [low, high]
        layout["xaxis"]["range"] = list(time_range(time))
        charts.append(chart({"data": data, "layout": layout}, title, note=note, wide=len(shown) == 1, height=340))
    return charts


def _point_colours(points: int) -> list[str]:
    return [_POINT_COLOURS[number % len(_POINT_COLOURS)] for number in range(points)]


def _feature_paths(result: Result) -> list[Html]:
    views = image_views(result)
    titles = (_PATHS, "The same paths, magnified")
    last, wide = views[-1], len(views) == 1
    return [
        _paths_in(result, view, title, wide=wide, named=view is last)
        for view, title in zip(views, titles, strict=False)
    ]


def _paths_in(result: Result, view: ImageView, title: str, *, wide: bool, named: bool) -> Html:
    features = result.features.reshape(len(result.time), -1, 2)
    goals = desired_features(result.scenario).reshape(-1, 2)
    colours = _point_colours(len(goals))
    data = []
    for number, colour in enumerate(colours):
        path = features[:, number]
        kept = path_samples(*path.T)
        data.append(
            trace(
                path[kept, 0],
                path[kept, 1],
                f"point {number + 1}",
                {"color": colour, "width": 1.6},
                customdata=encoded(result.time[kept]),
                hovertemplate="x %{x:.4g} px, y %{y:.4g} px at %{customdata:.4g} s",
            )
        )
    marks = (
        ("start", features[0], "circle-open", 10),
        ("end of the run", features[-1], "circle", 7),
        ("goal", goals, "square-open", 13),
    )
    for name, places, symbol, size in marks:
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": encoded(places[:, 0]),
                "y": encoded(places[:, 1]),
                "name": name,
                "marker": {"color": colours, "symbol": symbol, "size": size, "line": {"width": 1.5}},
                "hovertemplate": "x %{x:.4g} px, y %{y:.4g} px",
            }
        )
    layout = axes("image x [px]", "image y [px]")
    for axis, limits in zip(("xaxis", "yaxis"), view.limits, strict=True):
        layout[axis]["range"] = limits
    note = ""
    image_size = result.scenario.camera.image_size
    if view.border is not None and image_size is not None:
        line = "L".join(f"{x:.6g} {y:.6g}" for x, y in view.border)
        layout["shapes"] = [{"type": "path", "path": f"M{line}Z", "line": {"color": "@grey", "width": 1.2}}]
        note = f"Grey: border of the image, {image_size[0]:g} x {image_size[1]:g} px." if title == _PATHS else ""
    layout["yaxis"] |= {"scaleanchor": "x", "constrain": "domain"}
    layout["xaxis"] |= {"constrain": "domain"}
    if named:
        layout["annotations"] = _numbers_of_points(features, goals, view, _WIDE if wide else _NARROW)
    layout |= {"maxWidth": 620, "aspect": float(view.half[1] / view.half[0])}
    return chart({"data": data, "layout": layout}, title, note=note, height=680, wide=wide)


def _numbers_of_points(features: Array, goals: Array, view: ImageView, width: float) -> list[Spec]:
    """Write the number of each point beside its start or its end, where neither marks, paths nor other numbers are.

    Parameters
    ----------
    features, goals
        Of the samples (n, points, 2) and of the goal (points, 2) [px].
    view
        What the axes show.
    width
        Of the axes [px of the page].
    """
    scale = width / (2.0 * float(view.half[0]))
    at_end = farther_apart(features[0], features[-1], 0.16 * float(view.half.min()))
    paths = features[:: max(1, len(features) // _SAMPLES_OF_PATH)].reshape(-1, 2)
    taken = scale * np.concatenate([paths, features[0], features[-1], goals])
    numbers: list[Spec] = []
    for number, (goal, colour) in enumerate(zip(goals, _point_colours(len(goals)), strict=True)):
        place = features[at_end, number]
        if not np.isfinite(place).all():
            place = goal
        usual = np.where(place < goal, -1.0, 1.0)
        offsets = np.concatenate([[usual], _LABEL_SIDES]) * _LABEL_OFFSET
        chosen = roomiest_place(scale * place + offsets, taken, _LABEL_ROOM)
        taken = np.concatenate([taken, (scale * place + offsets)[[chosen]]])
        shift = {"xshift": float(offsets[chosen, 0]), "yshift": float(offsets[chosen, 1])}
        at = {"x": float(place[0]), "y": float(place[1]), **shift, "showarrow": False}
        numbers.append({**at, "text": str(number + 1), "font": {"color": colour, "size": 12}})
    return numbers


def _wrench_title(result: Result) -> str:
    """Return what the log's wrench is: for legs that follow positions, what their motion takes."""
    takes = " that the motion takes" if result.scenario.actuators.kind == "position" else ""
    return f"Wrench and leg forces{takes}"


def _wrench(result: Result) -> list[Html]:
    count = mean_samples(result.time)
    note = (
        f"Thin lines are samples, thick lines their mean over {mean_period(result.time, count)}." if count > 1 else ""
    )
    if result.scenario.actuators.takes_positions:
        note = f"The wrench is the mean of each tick; leg forces are those just after its command. {note}".rstrip()
    return [_over_time(result, panel, count, note) for panel in wrench_panels(result)]


def _base_motion(result: Result) -> list[Html]:
    """Draw what moves the base, or its acceleration alone where it does not turn."""
    probe = _core.Probe(core_parameters(result.scenario))
    acceleration = probe.base_acceleration(result.time)
    panels = [TimePanel("Acceleration of the base, in the world", "acceleration [m/s²]", acceleration, "xyz")]
    turns = 1e3 * Rotation.from_matrix(probe.base_motion(result.time)[1]).as_rotvec()
    if turns.any():
        title = "Attitude of the base in the world: axis times angle"
        panels.append(TimePanel(title, "rotation vector [mrad]", turns, ("rx", "ry", "rz")))
    return [_over_time(result, panel) for panel in panels]


# ---- Over the time --------------------------------------------------------------------------------------------------


def _over_time(result: Result, panel: TimePanel, count: int = 1, note: str = "") -> Html:
    """Draw a panel, the time axis broken if a short transient would not be visible in a long run.

    Parameters
    ----------
    count
        Samples of a moving mean; above 1 it is drawn over thin lines of the samples.
    note
        Put after that of the panel.
    """
    shown = broken_parts(result)
    inks = (_LEGS if panel.of == "legs" else _AXES)[panel.first :]
    means = moving_mean(panel.values, count)
    data: list[Spec] = []
    layout = axes("time [s]", panel.label, shapes=[_level(level) for level in panel.levels])
    low, high = layout["yaxis"]["range"] = list(axis_range(*panel.covered))
    tolerance = TOLERANCE * (high - low)
    for place, part in enumerate(shown):
        time, axis = result.time[part], "x" if place == 0 else "x2"
        if count > 1:
            thin = [_Ink(ink.colour) for ink in inks]
            looks: Spec = {"width": 0.7, "legend": False, "opacity": 0.45, "hoverinfo": "skip", "hovertemplate": None}
            data += _lines(time, panel.values[part], panel.names, thin, axis=axis, tolerance=tolerance, **looks)
        data += _lines(time, means[part], panel.names, inks, axis=axis, legend=place == 0, tolerance=tolerance)
        layout[f"xaxis{axis[1:]}"] = {**layout["xaxis"], "range": list(time_range(time))}
    if len(shown) == 2:
        layout["xaxis"]["domain"] = [0, _FIRST_SHARE - _GAP]
        layout["xaxis2"] |= {"domain": [_FIRST_SHARE + _GAP, 1], "anchor": "y"}
    note = f"{panel.note} {note}".strip()
    return chart({"data": data, "layout": layout}, panel.title, note=note, wide=False, height=300)


def _lines(
    time: Array,
    values: Array,
    names: Sequence[str],
    inks: Sequence[_Ink],
    *,
    axis: str = "x",
    width: float = 1.6,
    legend: bool = True,
    tolerance: float,
    **more: Any,
) -> list[Spec]:
    data = []
    for column, name, ink in zip(values.T, names, inks, strict=False):  # there are more inks than lines
        kept = thinned(time, column, tolerance)
        line = {"color": ink.colour, "dash": ink.dash, "width": width}
        drawn = trace(time[kept], column[kept], name, line, xaxis=axis, legendgroup=name, showlegend=legend, **more)
        if len(time) < 3:
            drawn["mode"] = "lines+markers"
        data.append({key: value for key, value in drawn.items() if value is not None})
    return data


def _band(half: float) -> Spec:
    place = {"xref": "paper", "x0": 0, "x1": 1, "yref": "y", "y0": -half, "y1": half}
    return {"type": "rect", "layer": "below", **place, "fillcolor": "@band", "line": {"width": 0}}


def _level(value: float) -> Spec:
    place = {"xref": "paper", "x0": 0, "x1": 1, "yref": "y", "y0": value, "y1": value}
    return {"type": "line", **place, "line": {"color": "@black", "width": 1.2, "dash": "dot"}}
