"""How results show themselves: a few lines as text, tables and figures in a notebook."""

from __future__ import annotations

import base64
import math
import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from hexservo.scenario.wording import VERDICTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hexservo.findings.evidence import Cell, Item, Section
    from hexservo.report.html import Html
    from hexservo.run.batch import BatchResult
    from hexservo.run.compare import Comparison
    from hexservo.run.result import Result

__all__ = [
    "Findings",
    "batch_html",
    "batch_text",
    "comparison_html",
    "comparison_text",
    "result_html",
    "result_text",
]

_WIDTH = 110  # characters of a line of text
_SHOWN_DOTS = 2.0  # dots of a picture for one of the page: sharp on fine screens
_STYLE = (
    ".hexservo figure{margin:0.6em 0}.hexservo figcaption{font-weight:600}.hexservo ul{margin:0.3em 0}"
    ".hexservo th,.hexservo td{padding:0.15em 0.8em 0.15em 0;text-align:left;vertical-align:top;white-space:normal}"
    ".hexservo th{vertical-align:bottom}.hexservo td.text{min-width:9em}.hexservo .unit{font-weight:400}"
    ".hexservo th.number,.hexservo td.number{text-align:right}.hexservo td.number{white-space:nowrap}"
    ".hexservo .scroll{overflow-x:auto}.hexservo img{max-width:100%;background:#fff}"
    ".hexservo .verdict{border:1px solid;border-radius:1em;padding:0 0.5em;font-size:0.85em}"
)


class Findings:
    """Base of what has a ``section()`` or ``sections()``: text and HTML come from these."""

    def _found(self) -> Sequence[Section]:
        if hasattr(self, "sections"):
            return self.sections()  # type: ignore[no-any-return]
        return [self.section()]  # type: ignore[attr-defined]

    def _head(self) -> str:
        """Say what was judged."""
        result = getattr(self, "result", None)
        scenario = getattr(self, "scenario", None) or getattr(result, "scenario", None)
        return type(self).__name__ + (f' of "{scenario.name}"' if scenario is not None else "")

    def __repr__(self) -> str:
        """Give a line for each section: its title, its verdict and the most important finding."""
        found = self._found()
        lines = [
            f"{section.title} ({VERDICTS[section.verdict]}): {''.join(section.sentences[:1])}" for section in found
        ]
        return _lines(self._head(), lines, 2 if len(found) > 1 else 5)

    def _repr_html_(self) -> str:
        """Give words, tables and figures for a notebook."""
        from hexservo.report.html import Html, element

        parts = [
            part
            for section in self._found()
            for part in (
                element(
                    "h4", section.title, " ", element("span", VERDICTS[section.verdict], class_="verdict"), Html(" ")
                ),
                _list(section.sentences),
                *map(_item, section.items),
            )
        ]
        return _page(element("strong", self._head()), *parts)


def result_text(result: Result) -> str:
    """Give a run in a few lines."""
    from hexservo.report.words import summary_sentences

    samples = f"{len(result.time)} samples: .to_dataframe(), .to_xarray(), .save(path); hs.metrics(result)"
    return _lines(f'Result of "{result.scenario.name}"', [*summary_sentences(result), samples])


def result_html(result: Result) -> str:
    """Give a run's summary, metrics and figures 2(b) and 3."""
    from hexservo.draw import plots
    from hexservo.findings.evidence import Column, Table
    from hexservo.report.evidence_html import table_html
    from hexservo.report.html import element
    from hexservo.report.words import summary_sentences
    from hexservo.run.metrics import METRICS, metrics, readable

    rows = [
        (name, " ".join(readable(name, value)).strip(), METRICS[name][1]) for name, value in metrics(result).items()
    ]
    return _page(
        element("strong", f'Result of "{result.scenario.name}"'),
        _list(summary_sentences(result)),
        _picture(plots.feature_errors(result), "Feature errors over the time"),
        _picture(plots.feature_paths(result), "Paths of the features in the image"),
        table_html(Table("Metrics", (Column("metric"), Column("value"), Column("meaning")), rows)),
    )


def batch_text(batch: BatchResult) -> str:
    """Give a batch in a few lines."""
    shape = (
        f"law {batch.scenario.controller.law}" if batch.controller is None else f"custom controller {batch.controller}"
    )
    counts = Counter(map(str, batch.outcome)).most_common()
    lines = [
        f"varied: {', '.join(batch.variations)}",
        f"outcomes: {', '.join(f'{count} {outcome}' for outcome, count in counts)}",
        ".to_dataframe(), .to_xarray(), .metrics[name]",
    ]
    return _lines(f'{len(batch)} runs of "{batch.scenario.name}", {shape}', lines)


def batch_html(batch: BatchResult) -> str:
    """Give a batch's outcomes, the spread of its metrics, and settling time and last error of every run."""
    import numpy as np

    from hexservo.draw.batch import batch_figure
    from hexservo.findings.evidence import Column, Table
    from hexservo.report.evidence_html import table_html
    from hexservo.report.html import Html, element
    from hexservo.run.metrics import readable

    rows: list[list[Cell]] = []
    for name, values in batch.metrics.items():
        known = values[np.isfinite(values)]
        spread = [float(known.min()), float(np.median(known)), float(known.max())] if len(known) else [math.nan] * 3
        shown = [" ".join(readable(name, value)).strip() if value == value else "–" for value in spread]
        rows.append([name, *shown, len(known)])
    columns = (Column("metric"), Column("smallest"), Column("median"), Column("largest"), Column("runs"))
    head, *lines = batch_text(batch).split("\n")
    return _page(
        element("strong", head),
        _list(line.strip() for line in lines),
        _picture(batch_figure(batch), "Settling time and last error of every run") if len(batch) else Html(),
        table_html(Table("Metrics", columns, rows)),
    )


def comparison_text(comparison: Comparison) -> str:
    """Give a comparison in one line for each law."""
    lines = []
    for law in comparison.laws:
        verdicts = Counter(row.verdict for row in comparison.rows if row.law == law).most_common()
        lines.append(f"{law}: {', '.join(f'{count} {verdict}' for verdict, count in verdicts)}")
    names = ", ".join(scenario.name for scenario in comparison.scenarios)
    return _lines(f"Comparison of {len(comparison.laws)} laws on {len(comparison.scenarios)} scenarios: {names}", lines)


def comparison_html(comparison: Comparison) -> str:
    """Give a comparison's table and its page of pictures."""
    from hexservo.findings.evidence import Column, Table
    from hexservo.report.evidence_html import table_html
    from hexservo.report.html import element
    from hexservo.run.compare import COLUMNS, shown

    heads = (
        Column("scenario"),
        Column("law"),
        Column("verdict"),
        *(Column(column.head, column.unit) for column in COLUMNS),
    )
    rows = [
        (row.scenario.name, row.law, row.verdict, *(shown(row, column) for column in COLUMNS))
        for row in comparison.rows
    ]
    return _page(
        element("strong", comparison_text(comparison).split("\n")[0]),
        table_html(Table("Laws by scenarios", heads, rows, "!: a leg passed its stroke or force limit.")),
        _picture(comparison.figure(), "Errors over the time, settling times, residuals and efforts"),
    )


# ---- Parts ----------------------------------------------------------------------------------------------------------


def _lines(head: str, lines: Iterable[str], most: int = 2) -> str:
    """Put lines below a head, each wrapped into `most` lines at most."""
    filled = [
        textwrap.fill(line, _WIDTH, initial_indent="  ", subsequent_indent="    ", max_lines=most, placeholder=" ...")
        for line in lines
    ]
    return "\n".join([textwrap.shorten(head, _WIDTH, placeholder=" ..."), *filled])


def _page(*parts: Html) -> str:
    from hexservo.report.html import Html, element

    return element("div", element("style", Html(_STYLE)), *parts, class_="hexservo")


def _list(sentences: Iterable[str]) -> Html:
    from hexservo.report.html import element

    return element("ul", *[element("li", sentence) for sentence in sentences])


def _item(item: Item) -> Html:
    from hexservo.draw.evidence import item_figure
    from hexservo.findings.evidence import Table
    from hexservo.report.evidence_html import table_html
    from hexservo.report.html import element, paragraphs

    if isinstance(item, Table):
        return table_html(replace(item, page=""))
    return element(
        "figure", element("figcaption", item.title), _picture(item_figure(item), item.title), paragraphs(item.note)
    )


def _picture(figure: Figure, alt: str) -> Html:
    from html import escape

    from hexservo.draw.plots import _image
    from hexservo.report.html import Html

    content = base64.b64encode(_image(figure, "png")).decode("ascii")
    width = figure.get_size_inches()[0] * 200 / _SHOWN_DOTS
    return Html(f'<img src="data:image/png;base64,{content}" width="{width:.0f}" alt="{escape(alt)}">')
