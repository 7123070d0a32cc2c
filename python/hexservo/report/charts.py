"""Charts for plotly.js, as plain data: colours are roles ("@blue") that the page turns into those of its scheme."""

from __future__ import annotations

import base64
import math
import textwrap
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo.findings.evidence import Curves, HeatMap, Line
from hexservo.report.documentation import anchor_of, is_page
from hexservo.report.html import Html, element, json_script, paragraphs
from hexservo.run.samples import extremes
from hexservo.scenario.arrays import Array

__all__ = [
    "LINE_COLOURS",
    "MOST",
    "TOLERANCE",
    "Spec",
    "axes",
    "chart",
    "curves",
    "encoded",
    "heat_map",
    "label",
    "needed",
    "thinned",
    "trace",
]

Spec: TypeAlias = dict[str, Any]
"""``data`` and ``layout`` of a chart, as plotly.js has them."""


MOST = 700
"""Samples of one line, about: half of them can be told apart where a chart is widest."""

_MOST_LOOKED_AT = 8000

TOLERANCE = 3e-4
"""Of the samples that are left out, in parts of what the axis shows: a tenth of a pixel."""

LINE_COLOURS = ("@blue", "@vermilion", "@green", "@black", "@purple", "@orange", "@grey")
_SYMBOLS = ("circle", "square", "diamond", "cross")
_DASHES = ("solid", "dash", "dashdot", "dot")
# Of maps, in both schemes: dark enough everywhere for white contours, lighter from end to end for every eye.
_SCALE = [[0, "#0a1a33"], [0.5, "#1d5a85"], [1, "#4f9c72"]]
_MAP_COLOURS = ("#ffb000", "#ff86c2", "#8be3ff")
_LEVEL, _UPRIGHT = 48, 34  # characters of an axis' title in a line, across a phone and up a chart
_MAX_CELLS = 160  # of a heat map along each side


def encoded(values: ArrayLike) -> Spec:
    """Give numbers as plotly.js reads them fastest: single precision in base64, NaN where there is nothing."""
    array = np.ascontiguousarray(np.where(np.isfinite(values), values, np.nan), dtype="<f4")
    spec = {"dtype": "f4", "bdata": base64.b64encode(array.data).decode("ascii")}
    return spec if array.ndim == 1 else {**spec, "shape": ", ".join(map(str, array.shape))}


def label(text: str) -> str:
    """Give text as plotly.js shows it: it reads a few HTML tags, which are none here."""
    return escape(text, quote=False)


def chart(
    spec: Spec, title: str, *, note: str = "", page: str = "", height: int = 300, wide: bool = True, alt: str = ""
) -> Html:
    """Give a chart with its title above and its note below.

    Parameters
    ----------
    page
        That explains it, such as "docs/model.md".
    height
        Of the chart [px].
    wide
        Over the whole width; else two stand side by side where there is room.
    alt
        What it shows, for those who do not see it.
    """
    return element(
        "figure",
        element("figcaption", title),
        element("div", class_="chart", role="img", aria_label=alt or title, style=f"height:{height}px"),
        json_script(spec),
        paragraphs(note),
        explained(page),
        class_="plot" if wide else "plot half",
    )


def explained(page: str) -> Html:
    """Say which page explains something, if there is one, with a link to it inside the report."""
    if not page:
        return Html()
    name = element("code", page)
    return element(
        "p", "Explained in ", element("a", name, href=f"#{anchor_of(page)}") if is_page(page) else name, class_="page"
    )


def curves(item: Curves) -> Html:
    """Draw lines over one axis."""
    data = [_line(line, number, y_log=item.y_log) for number, line in enumerate(item.lines)]
    layout = axes(item.x_label, item.y_label)
    for axis, is_log in (("xaxis", item.x_log), ("yaxis", item.y_log)):
        layout[axis] |= (
            _logarithmic([np.asarray(getattr(line, axis[0]), float) for line in item.lines]) if is_log else {}
        )
    names = ", ".join(line.name for line in item.lines if line.name)
    return chart(
        {"data": data, "layout": layout},
        item.title,
        note=item.note,
        page=item.page,
        alt=f"{item.title}: {item.y_label} over {item.x_label}" + (f"; lines: {names}" if names else ""),
    )


def _logarithmic(values: Sequence[Array]) -> Spec:
    """Make an axis logarithmic, with names at whole decades, or at 1, 2 and 5 where there are fewer than two."""
    positive = np.concatenate([part[np.isfinite(part) & (part > 0)] for part in values] or [np.empty(0)])
    decades = math.log10(positive.max() / positive.min()) if len(positive) else 0.0
    if decades < 2:
        return {"type": "log", "dtick": "D2"}
    return {"type": "log", "dtick": max(1, math.ceil(decades / 6))}


def heat_map(item: HeatMap) -> Html:
    """Draw a quantity over a rectangle, with contours and lines over it."""
    x, y, z = (np.asarray(values, dtype=float) for values in (item.x, item.y, item.z))
    rows, columns = (slice(None, None, -(-count // _MAX_CELLS)) for count in z.shape)
    x, y, z = x[columns], y[rows], z[rows, columns]
    cells = {"x": encoded(x), "y": encoded(y), "z": encoded(z)}
    hover = {"hovertemplate": f"%{{x:.4g}}, %{{y:.4g}}: %{{z:.4g}}<extra>{label(item.z_label)}</extra>"}
    bar = {"title": {"text": _folded(item.z_label, _UPRIGHT), "side": "right"}, "thickness": 12, "outlinewidth": 0}
    data: list[Spec] = [{"type": "heatmap", **cells, "colorscale": _SCALE, "colorbar": bar, **hover}]
    data += [
        {
            "type": "contour",  # of the cells above: the page's script puts them here too
            "contours": {
                "start": level,
                "end": level,
                "size": 1,
                "coloring": "none",
                "showlabels": True,
                "labelfont": {"color": "#ffffff", "size": 12},
            },
            "line": {"color": "#ffffff", "width": 1.5},
            "showscale": False,
            "showlegend": False,
            "hoverinfo": "skip",
        }
        for level in item.levels
    ]
    data += [_line(line, number, _MAP_COLOURS) for number, line in enumerate(item.lines)]
    layout = axes(item.x_label, item.y_label)
    return chart(
        {"data": data, "layout": layout},
        item.title,
        note=item.note,
        page=item.page,
        height=360,
        alt=f"{item.title}: map of {item.z_label} over {item.x_label} and {item.y_label}",
    )


def trace(x: ArrayLike, y: ArrayLike, name: str, line: Mapping[str, Any], **more: Any) -> Spec:
    """Give one line; plotly.js draws nothing where a number is not finite."""
    return {
        "type": "scatter",
        "mode": "lines",
        "x": encoded(x),
        "y": encoded(y),
        "name": label(name),
        "line": dict(line),
        "hovertemplate": "%{x:.5g}, %{y:.4g}",
        **more,
    }


def needed(x: Array, y: Array, tolerance: float) -> NDArray[np.intp]:
    """Give the indices of samples between which straight lines pass all others within a tolerance, the ends included.

    From each sample that is kept, the cone of slopes that pass all samples so far narrows until a sample is outside;
    the one before it is kept. All are, where one is not finite or x does not grow.

    Parameters
    ----------
    x, y
        Samples of one line, (n,).
    tolerance
        In the unit of y.
    """
    count = len(y)
    if (
        count < 3
        or not tolerance > 0
        or not np.isfinite(x).all()
        or not np.isfinite(y).all()
        or (np.diff(x) <= 0).any()
    ):
        return np.arange(count)
    xs, ys = x.tolist(), y.tolist()  # plain numbers: this loop is no work for arrays
    kept = [0]
    start_x, start_y, steepest, flattest = xs[0], ys[0], math.inf, -math.inf
    for index in range(1, count):
        run, rise = xs[index] - start_x, ys[index] - start_y
        if not flattest <= rise / run <= steepest:
            start_x, start_y = xs[index - 1], ys[index - 1]
            kept.append(index - 1)
            run, rise = xs[index] - start_x, ys[index] - start_y
            steepest, flattest = math.inf, -math.inf
        steepest, flattest = min(steepest, (rise + tolerance) / run), max(flattest, (rise - tolerance) / run)
    return np.array([*kept, count - 1])


def thinned(x: Array, y: Array, tolerance: float) -> NDArray[np.intp]:
    """Give the indices of the samples that show a line: those it needs, or the extremes where it needs too many."""
    kept = extremes(y, _MOST_LOOKED_AT)
    kept = kept[needed(x[kept], y[kept], tolerance)]
    return kept[extremes(y[kept], MOST)]


def _line(line: Line, number: int, colours: Sequence[str] = LINE_COLOURS, *, y_log: bool = False) -> Spec:
    x, y = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
    kept = np.arange(len(y)) if line.style == "points" else _kept(x, y, y_log)
    colour = colours[number % len(colours)]
    dash = "dash" if line.style == "dashed" else _DASHES[number // len(colours) % len(_DASHES)]
    more: Spec = {"showlegend": bool(line.name)}
    if line.style == "points" or len(kept) == 1:
        more |= {
            "mode": "markers",
            "marker": {"color": colour, "size": 6, "symbol": _SYMBOLS[number // len(colours) % len(_SYMBOLS)]},
        }
    return trace(x[kept], y[kept], line.name, {"color": colour, "dash": dash, "width": 1.6}, **more)


def _kept(x: Array, y: Array, y_log: bool) -> NDArray[np.intp]:
    """Thin out each part of a line between its gaps, which stay; on a logarithmic axis, as that shows it."""
    if y_log:
        y = np.log10(y, where=y > 0, out=np.full_like(y, np.nan))
    finite = np.isfinite(x) & np.isfinite(y)
    tolerance = TOLERANCE * float(np.ptp(y[finite])) if finite.any() else 0.0
    parts = np.split(np.arange(len(y)), np.flatnonzero(np.diff(finite)) + 1)
    return np.concatenate([part[_kept_of_part(x[part], y[part], tolerance)] for part in parts])


def _kept_of_part(x: Array, y: Array, tolerance: float) -> NDArray[np.intp]:
    if not (len(y) and np.isfinite(x[0]) and np.isfinite(y[0])):
        return np.arange(len(y))[:1]  # of a gap
    if (np.diff(x) <= 0).any():  # it turns back, as a circle does
        return np.union1d(extremes(x), extremes(y))
    return thinned(x, y, tolerance)


def axes(x: str, y: str, **more: Sequence[Any] | Mapping[str, Any]) -> Spec:
    """Give a layout with two titled axes; long titles are broken into lines."""
    titles = {"xaxis": _folded(x, _LEVEL), "yaxis": _folded(y, _UPRIGHT)}
    return {**{axis: {"title": {"text": title}} for axis, title in titles.items()}, **more}


def _folded(text: str, width: int) -> str:
    return "<br>".join(label(line) for line in textwrap.wrap(text, width, break_long_words=False)) or label(text)
