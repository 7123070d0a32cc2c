"""HTML of results and findings for notebooks: sentences, tables and figures."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from hexservo.draw.batch import batch_figure, drawn_metrics
from hexservo.draw.compare import comparison_figure
from hexservo.draw.evidence import item_figure
from hexservo.draw.plots import feature_errors, feature_paths
from hexservo.draw.style import image_bytes
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Cell, Column, Item, Section, Table
from hexservo.findings.wording import verdict_text
from hexservo.report.evidence_html import table_html
from hexservo.report.html import Html, element, paragraphs, sentence
from hexservo.run.batch import BatchResult
from hexservo.run.comparison import COLUMNS, Comparison, column_texts
from hexservo.run.display import batch_text, comparison_text
from hexservo.run.metrics import metric_meaning, metric_name, readable, shown_metrics
from hexservo.run.result import Result
from hexservo.run.summary import summary_sentences

if TYPE_CHECKING:
    from matplotlib.figure import Figure

figure_of = comparison_figure
image_of = image_bytes

_SHOWN_DOTS = 2.0  # pixels of a figure per pixel of the page: sharp on high-resolution screens
_STYLE = (
    ".hexservo figure{margin:0.6em 0}.hexservo figcaption{font-weight:600}.hexservo ul{margin:0.3em 0}"
    ".hexservo th,.hexservo td{padding:0.15em 0.8em 0.15em 0;text-align:left;vertical-align:top;white-space:normal}"
    ".hexservo th{vertical-align:bottom}.hexservo td.text{min-width:9em}.hexservo .unit{font-weight:400}"
    ".hexservo th.number,.hexservo td.number{text-align:right}.hexservo td.number{white-space:nowrap}"
    ".hexservo .scroll{overflow-x:auto}.hexservo img{max-width:100%;background:#fff}"
    ".hexservo .verdict{border:1px solid;border-radius:1em;padding:0 0.5em;font-size:0.85em}"
)


def html_of(shown: object) -> str:
    """Return a result, batch, comparison or findings as HTML for a notebook.

    Raises
    ------
    TypeError
        For anything else.
    """
    match shown:
        case Result():
            return _result_html(shown)
        case BatchResult():
            return _batch_html(shown)
        case Comparison():
            return _comparison_html(shown)
        case Findings():
            return _findings_html(shown)
    raise TypeError(f"expected a result, batch, comparison or findings, got {type(shown).__name__}")


def _result_html(result: Result) -> str:
    """Return a run's summary, metrics and figures 2(b) and 3."""
    robot = result.scenario.robot
    rows = [
        (name, " ".join(readable(name, value, robot)).strip(), metric_meaning(name, robot))
        for name, value in shown_metrics(result).items()
    ]
    return _page(
        element("strong", f'Result of "{result.scenario.name}"'),
        _list(summary_sentences(result)),
        _picture(feature_errors(result), "Feature errors over time"),
        _picture(feature_paths(result), "Paths of the features in the image"),
        table_html(Table("Metrics", (Column("metric"), Column("value"), Column("meaning")), rows)),
    )


def _batch_html(batch: BatchResult) -> str:
    """Return a batch's outcomes, the spread of its metrics, and two of them of every run."""
    rows: list[list[Cell]] = []
    for name, values in batch.metrics.items():
        known = values[np.isfinite(values)]
        spread = [float(known.min()), float(np.median(known)), float(known.max())] if len(known) else [math.nan] * 3
        shown = [
            " ".join(readable(name, value, batch.scenario.robot, spread[-1])).strip() if value == value else "–"
            for value in spread
        ]
        rows.append([name, *shown, len(known)])
    columns = (Column("metric"), Column("smallest"), Column("median"), Column("largest"), Column("runs"))
    head, *lines = batch_text(batch).split("\n")
    drawn = drawn_metrics(batch) if len(batch) else ()
    named = " and ".join(metric_name(name, batch.scenario.robot) for name in drawn)
    return _page(
        element("strong", head),
        _list(line.strip() for line in lines),
        _picture(batch_figure(batch), f"{named.capitalize()} of every run") if drawn else Html(),
        table_html(Table("Metrics", columns, rows)) if rows else Html(),
    )


def _comparison_html(comparison: Comparison) -> str:
    """Return a comparison's table and its figures."""
    units, columns = zip(*(column_texts(comparison.rows, column) for column in COLUMNS), strict=True)
    heads = (
        Column("scenario"),
        Column("law"),
        Column("verdict"),
        *(Column(column.head(comparison.rows), unit) for column, unit in zip(COLUMNS, units, strict=True)),
    )
    rows = [
        (row.scenario.name, row.law, row.verdict, *texts) for row, *texts in zip(comparison.rows, *columns, strict=True)
    ]
    return _page(
        element("strong", comparison_text(comparison).split("\n")[0]),
        table_html(Table("Laws by scenarios", heads, rows, "!: a leg exceeded this limit.")),
        _picture(comparison.figure(), "Errors over time, settling times, residuals and efforts"),
    )


def _findings_html(findings: Findings) -> str:
    parts = [
        part
        for section in findings.all_sections()
        for part in (
            element("h4", section.title, " ", *_verdict(section)),
            _list(section.sentences),
            *map(_item, section.items),
        )
    ]
    return _page(element("strong", findings.headline()), *parts)


# ---- Parts ----------------------------------------------------------------------------------------------------------


def _page(*parts: Html) -> str:
    return element("div", element("style", Html(_STYLE)), *parts, class_="hexservo")


def _verdict(section: Section) -> list[Html]:
    text = verdict_text(section)
    return [element("span", text, class_="verdict"), Html(" ")] if text else []


def _list(sentences: Iterable[str]) -> Html:
    return element("ul", *[element("li", sentence(words)) for words in sentences])


def _item(item: Item) -> Html:
    if isinstance(item, Table):
        return table_html(replace(item, page=""))
    return element(
        "figure", element("figcaption", item.title), _picture(item_figure(item), item.title), paragraphs(item.note)
    )


def _picture(figure: Figure, alt: str) -> Html:
    content = base64.b64encode(image_bytes(figure, "png")).decode("ascii")
    width = figure.get_size_inches()[0] * 200 / _SHOWN_DOTS
    return Html(f'<img src="data:image/png;base64,{content}" width="{width:.0f}" alt="{escape(alt)}">')
