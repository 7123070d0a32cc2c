"""Charts for plotly.js, as plain data: colours are roles ("@blue") that the page replaces by those of its scheme."""

from __future__ import annotations

import base64
import math
import textwrap
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexservo.findings.evidence import Bars, Curves, HeatMap, Line
from hexservo.report.documentation import anchor_of, is_page
from hexservo.report.html import Html, element, json_script, paragraphs
from hexservo.run.samples import extreme_samples, path_samples
from hexservo.scenario.arrays import Array

Spec: TypeAlias = dict[str, Any]
"""``data`` and ``layout`` of a chart, as plotly.js has them."""


MOST = 700
"""Approximate number of samples of one line: twice the resolution of the widest chart."""

_MOST_LOOKED_AT = 8000

TOLERANCE = 3e-4
"""Tolerance for dropped samples, as a fraction of the axis: a tenth of a pixel."""

LINE_COLOURS = ("@blue", "@vermilion", "@green", "@black", "@purple", "@orange", "@grey")
_SYMBOLS = ("circle", "square", "diamond", "cross")
_DASHES = ("solid", "dash", "dashdot", "dot")
# Colours of maps in both schemes: dark enough for white contours, with monotone lightness.
_SCALE = [[0, "#0a1a33"], [0.5, "#1d5a85"], [1, "#4f9c72"]]
_MAP_COLOURS = ("#ffb000", "#ff86c2", "#8be3ff")
_LEVEL, _UPRIGHT = 48, 34  # characters of an axis' title in a line, across a phone and up a chart
_NAME = 16  # characters of a bar's name in a line
_MAX_CELLS = 160  # of a heat map along each side


def encoded(values: ArrayLike) -> Spec:
    """Return numbers in the fastest format of plotly.js: single precision in base64, NaN for missing ones."""
    array = np.ascontiguousarray(np.where(np.isfinite(values), values, np.nan), dtype="<f4")
    spec = {"dtype": "f4", "bdata": base64.b64encode(array.data).decode("ascii")}
    return spec if array.ndim == 1 else {**spec, "shape": ", ".join(map(str, array.shape))}


def label(text: str) -> str:
    """Escape text for plotly.js, which interprets a few HTML tags."""
    return escape(text, quote=False)


def chart(
    spec: Spec, title: str, *, note: str = "", page: str = "", height: int = 300, wide: bool = True, alt: str = ""
) -> Html:
    """Return a chart with its title above and its note below.

    Parameters
    ----------
    page
        Page that explains it, such as "docs/model.md".
    height
        Height of the chart [px].
    wide
        Use the whole width; otherwise two charts are placed side by side if there is room.
    alt
        Alternative text for screen readers.
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
    """Return a line with the page that explains an item, if there is one, linked inside the report."""
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
    alt = f"{item.y_label} over {item.x_label}" + (f"; lines: {names}" if names else "")
    return _drawn(item, data, layout, alt)


def _drawn(item: Curves | HeatMap | Bars, data: list[Spec], layout: Spec, alt: str, height: int = 300) -> Html:
    """Return an item as a chart; `alt` follows its title in the alternative text for screen readers."""
    spec, alt = {"data": data, "layout": layout}, f"{item.title}: {alt}"
    return chart(spec, item.title, note=item.note, page=item.page, height=height, alt=alt)


def _logarithmic(values: Sequence[Array]) -> Spec:
    """Make an axis logarithmic, with labels at whole decades, or at 1, 2 and 5 of each if there are fewer than two.

    Within one decade the axis stays linear: a logarithmic one may have a single label there.
    """
    positive = np.concatenate([part[np.isfinite(part) & (part > 0)] for part in values] or [np.empty(0)])
    decades = math.log10(positive.max() / positive.min()) if len(positive) else 0.0
    if decades < 1:
        return {}
    if decades < 2:
        return {"type": "log", "dtick": "D2", "tickformat": "~g"}  # without a format 20 is "2" beside "10", 200 too
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
    alt = f"map of {item.z_label} over {item.x_label} and {item.y_label}"
    return _drawn(item, data, axes(item.x_label, item.y_label), alt, height=360)


def bars(item: Bars) -> Html:
    """Draw horizontal bars with their intervals."""
    places = np.arange(len(item.names), dtype=float)
    data = [
        {
            "type": "bar",
            "orientation": "h",
            "x": encoded(share.values),
            "y": encoded(places),
            "name": label(share.name),
            "marker": {"color": LINE_COLOURS[number % len(LINE_COLOURS)]},
            "error_x": {
                "type": "data",
                "symmetric": False,
                "array": encoded(share.intervals[:, 1] - share.values),
                "arrayminus": encoded(share.values - share.intervals[:, 0]),
                "thickness": 1,
                "width": 2,
                "color": "@ink",
            },
            "hovertemplate": "%{x:.3g}",
        }
        for number, share in enumerate(item.shares)
    ]
    layout = axes(item.x_label, "")
    names = [label(name).replace(".", ".<br>", 1) if len(name) > _NAME else label(name) for name in item.names]
    layout["yaxis"] = {"tickmode": "array", "tickvals": places.tolist(), "ticktext": names, "autorange": "reversed"}
    height = 90 + (12 * len(item.shares) + 20) * len(item.names)
    return _drawn(item, data, layout, f"{item.x_label} of {', '.join(item.names)}", height)


def trace(x: ArrayLike, y: ArrayLike, name: str, line: Mapping[str, Any], **more: Any) -> Spec:
    """Return one line; plotly.js leaves gaps at numbers that are not finite."""
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
    """Return the samples, by index, between which straight lines approximate all others within a tolerance.

    From each kept sample, the cone of slopes through the tolerances of all following samples narrows until a sample
    is outside; the one before it is kept. The ends are kept; all samples are if one is not finite or x does not grow.

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
    xs, ys = x.tolist(), y.tolist()  # plain numbers: this loop cannot be vectorised
    kept = [0]
    start_x, start_y, steepest, flattest = xs[0], ys[0], math.inf, -math.inf
    for index in range(1, count):
        run, rise = xs[index] - start_x, ys[index] - start_y
        if not flattest <= rise / run <= steepest:
            start_x, start_y = xs[index - 1], ys[index - 1]
            kept.append(index - 1)
            run, rise = xs[index] - start_x, ys[index] - start_y
            steepest, flattest = math.inf, -math.inf
        upper, lower = (rise + tolerance) / run, (rise - tolerance) / run
        if upper < steepest:  # as min and max, whose calls took half of the time
            steepest = upper
        if lower > flattest:
            flattest = lower
    return np.array([*kept, count - 1])


def thinned(x: Array, y: Array, tolerance: float) -> NDArray[np.intp]:
    """Return the indices of the samples to draw: those needed for a line, or the extremes if these are too many."""
    kept = extreme_samples(y, _MOST_LOOKED_AT)
    kept = kept[needed(x[kept], y[kept], tolerance)]
    return kept[extreme_samples(y[kept], MOST)]


def _line(line: Line, number: int, colours: Sequence[str] = LINE_COLOURS, *, y_log: bool = False) -> Spec:
    x, y = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
    kept = np.arange(len(y)) if line.style == "points" else _kept(x, y, y_log)
    colour = colours[(number if line.look is None else line.look) % len(colours)]
    symbol = number // len(colours) if line.look is None else line.look
    dash = "dash" if line.style == "dashed" else _DASHES[number // len(colours) % len(_DASHES)]
    more: Spec = {"showlegend": bool(line.name)}
    if line.style == "points" or len(kept) == 1:
        more |= {
            "mode": "markers",
            "marker": {"color": colour, "size": 6, "symbol": _SYMBOLS[symbol % len(_SYMBOLS)]},
        }
    return trace(x[kept], y[kept], line.name, {"color": colour, "dash": dash, "width": 1.6}, **more)


def _kept(x: Array, y: Array, y_log: bool) -> NDArray[np.intp]:
    """Thin out each part of a line between its gaps, which are kept; on a logarithmic axis, in logarithms."""
    if y_log:
        y = np.log10(y, where=y > 0, out=np.full_like(y, np.nan))
    finite = np.isfinite(x) & np.isfinite(y)
    tolerance = TOLERANCE * float(np.ptp(y[finite])) if finite.any() else 0.0
    parts = np.split(np.arange(len(y)), np.flatnonzero(np.diff(finite)) + 1)
    return np.concatenate([part[_kept_of_part(x[part], y[part], tolerance)] for part in parts])


def _kept_of_part(x: Array, y: Array, tolerance: float) -> NDArray[np.intp]:
    if not (len(y) and np.isfinite(x[0]) and np.isfinite(y[0])):
        return np.arange(len(y))[:1]  # of a gap
    if (np.diff(x) <= 0).any():  # x decreases, as on a circle
        return path_samples(x, y)
    return thinned(x, y, tolerance)


def axes(x: str, y: str, **more: Sequence[Any] | Mapping[str, Any]) -> Spec:
    """Return a layout with two titled axes; long titles are broken into lines."""
    titles = {"xaxis": _folded(x, _LEVEL), "yaxis": _folded(y, _UPRIGHT)}
    return {**{axis: {"title": {"text": title}} for axis, title in titles.items()}, **more}


def _folded(text: str, width: int) -> str:
    return "<br>".join(label(line) for line in textwrap.wrap(text, width, break_long_words=False)) or label(text)
