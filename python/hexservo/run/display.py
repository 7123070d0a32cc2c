"""Display of results: a few lines of text, and HTML in a notebook if a renderer is there."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexservo.run.batch import BatchResult
    from hexservo.run.comparison import Comparison
    from hexservo.run.result import Result

_WIDTH = 110  # characters of a line of text


def result_text(result: Result) -> str:
    """Return a run in a few lines."""
    from hexservo.run.summary import summary_sentences

    samples = f"{len(result.time)} samples: .to_dataframe(), .to_xarray(), .save(path); hs.metrics(result)"
    return lines_below(f'Result of "{result.scenario.name}"', [*summary_sentences(result), samples])


def batch_text(batch: BatchResult) -> str:
    """Return a batch in a few lines."""
    shape = (
        f"law {batch.scenario.controller.law}" if batch.controller is None else f"custom controller {batch.controller}"
    )
    counts = Counter(map(str, batch.outcome)).most_common()
    lines = [
        f"varied: {', '.join(batch.variations)}",
        f"outcomes: {', '.join(f'{count} {outcome}' for outcome, count in counts)}",
        ".to_dataframe(), .to_xarray(), .metrics[name]",
    ]
    return lines_below(f'{len(batch)} runs of "{batch.scenario.name}", {shape}', lines)


def comparison_text(comparison: Comparison) -> str:
    """Return a comparison in one line for each law."""
    lines = []
    for law in comparison.laws:
        verdicts = Counter(row.verdict for row in comparison.rows if row.law == law).most_common()
        lines.append(f"{law}: {', '.join(f'{count} {verdict}' for verdict, count in verdicts)}")
    names = ", ".join(scenario.name for scenario in comparison.scenarios)
    return lines_below(
        f"Comparison of {len(comparison.laws)} laws on {len(comparison.scenarios)} scenarios: {names}", lines
    )


def lines_below(head: str, lines: Iterable[str], most: int = 2) -> str:
    """Return lines below a head, each wrapped into `most` lines at most."""
    filled = [
        textwrap.fill(line, _WIDTH, initial_indent="  ", subsequent_indent="    ", max_lines=most, placeholder=" ...")
        for line in lines
    ]
    return "\n".join([textwrap.shorten(head, _WIDTH, placeholder=" ..."), *filled])
