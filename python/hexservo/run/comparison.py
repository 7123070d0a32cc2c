"""Results of several laws on several scenarios (docs/compare.md)."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hexservo.run.display import comparison_text
from hexservo.run.drawn import figure_of, html_of, image_of
from hexservo.run.files import write_folder
from hexservo.run.leg_limits import leg_limits
from hexservo.run.metrics import METRICS
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Comparison", "ComparisonRow"]


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonRow:
    """Result of one law in one scenario."""

    law: str
    scenario: Scenario  # with that law; as given where the law refuses it
    # as Result.outcome ("interrupted" also where a run was never begun), or "refused": the law cannot run the scenario
    outcome: str
    detail: str  # one sentence: how the run ended, or why it was refused
    end_time: float = math.nan  # time of the last good sample [s]; NaN without a run
    metrics: Mapping[str, float] = field(default_factory=dict, repr=False)  # of hs.METRICS; NaN without a run
    time: Array = field(default_factory=lambda: np.empty(0), repr=False)  # (n,) [s], n at most about 5000
    error: Array = field(default_factory=lambda: np.empty(0), repr=False)  # (n,) [px], largest |feature error|

    def __repr__(self) -> str:
        """Return law, scenario and verdict."""
        return f"<{self.law} on {self.scenario.name}: {self.verdict}; {self.why}>"

    @property
    def settled(self) -> bool:
        """Whether the run completed and has a settling time: docs/model.md, section 8."""
        return self.outcome == "completed" and not math.isnan(self.metrics["settling_time"])

    @property
    def verdict(self) -> str:
        """The outcome in a word or two: settled, not settled, or how the run ended early."""
        if self.outcome == "completed":
            return "settled" if self.settled else "not settled"
        return self.outcome.replace("_", " ")

    @property
    def passed_limits(self) -> tuple[str, ...]:
        """The limits of the legs that were exceeded: "stroke", "force", "speed", "base_joint", "platform_joint"."""
        return tuple(
            limit.kind for limit in leg_limits(self.scenario) if self.metrics.get(limit.metric, math.nan) > limit.value
        )

    @property
    def why(self) -> str:
        """One sentence: the reason of the verdict, and the exceeded limits."""
        measured = self.scenario.metrics
        if self.outcome != "completed":
            sentence = self.detail
        elif self.settled:
            sentence = f"within {measured.band:g} px from {self.metrics['settling_time']:.4g} s on"
        elif self.metrics["final_error"] <= measured.band:
            sentence = f"within {measured.band:g} px at the end, but for less than {measured.dwell:g} s"
        else:
            sentence = f"{self.metrics['final_error']:.4g} px from the goal at the end, above {measured.band:g} px"
        excess = {limit.kind: f"{limit.exceeded} of {limit.text}" for limit in leg_limits(self.scenario)}
        return "; ".join([sentence, *(excess[what] for what in self.passed_limits)])


@dataclass(frozen=True)
class MetricColumn:
    """A column of numbers of the table."""

    metric: str
    head: str
    unit: str
    scale: float = 1.0  # of these units in one of the metric's
    limit: str = ""  # of `ComparisonRow.passed_limits`, which it shows


COLUMNS = (
    MetricColumn("settling_time", "settles", "s"),
    MetricColumn("final_error", "residual", "px"),
    MetricColumn("rms_error", "RMS", "px"),
    MetricColumn("overshoot", "overshoot", "px"),
    MetricColumn("relative_overshoot", "overshoot", "%", 100.0),
    MetricColumn("peak_feature_distance", "farthest", "px"),
    MetricColumn("peak_line_deviation", "off line", "px"),
    MetricColumn("peak_displacement", "camera", "mm", 1e3),
    MetricColumn("peak_rotation", "camera", "mrad", 1e3),
    MetricColumn("effort", "effort", "N^2 s"),
    MetricColumn("chatter", "chatter", "N/s"),
    MetricColumn("peak_leg_force", "leg force", "N", limit="force"),
    MetricColumn("peak_leg_excursion", "stroke", "mm", 1e3, limit="stroke"),
)
"""What the table for people shows, in this order; `to_csv` has all metrics."""


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Several laws on several scenarios, one row for each pair: scenario by scenario, law by law, in the given order.

    A row depends on its law and scenario only, not on the other rows, bit for bit within one variant.
    """

    laws: tuple[str, ...]
    scenarios: tuple[Scenario, ...]  # with the changes, and the law that they came with
    rows: tuple[ComparisonRow, ...]

    def __repr__(self) -> str:
        """Return the verdicts in a line for each law."""
        return comparison_text(self)

    def _repr_html_(self) -> str:
        """Return table and figure for a notebook."""
        return html_of(self)

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C came before all runs were finished."""
        return any(row.outcome == "interrupted" for row in self.rows)

    @property
    def finished(self) -> int:
        """Number of runs that were not interrupted."""
        return sum(row.outcome != "interrupted" for row in self.rows)

    def row(self, law: str, scenario: str) -> ComparisonRow:
        """Return the row of a law and the name of a scenario.

        Raises
        ------
        KeyError
            For a pair that was not compared.
        """
        for row in self.rows:
            if row.law == law and row.scenario.name == scenario:
                return row
        raise KeyError(f'law, scenario: expected a pair that was compared, got "{law}", "{scenario}"')

    def to_markdown(self) -> str:
        """Return the table for people as Markdown; an exclamation mark follows values beyond a limit of the legs."""
        head = ["scenario", "law", "verdict", *(f"{column.head} [{column.unit}]" for column in COLUMNS), "why"]
        lines = [head, ["---", "---", "---", *("---:" for _ in COLUMNS), "---"]]
        lines += [
            [row.scenario.name, row.law, row.verdict, *(metric_text(row, column) for column in COLUMNS), row.why]
            for row in self.rows
        ]
        return "".join(f"| {' | '.join(_escaped(cell) for cell in line)} |\n" for line in lines)

    def to_csv(self) -> str:
        """Return every metric of every run as CSV in SI units and pixels; empty where a number has no meaning."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        names = {name: f"{name} [{unit}]" for name, (unit, _) in METRICS.items()}
        writer.writerow(["scenario", "law", "outcome", "settled", "end_time [s]", *names.values(), "limits", "why"])
        for row in self.rows:
            numbers = [row.end_time, *(row.metrics.get(name, math.nan) for name in names)]
            settled = "" if row.outcome in ("refused", "interrupted") else "yes" if row.settled else "no"
            writer.writerow(
                [
                    row.scenario.name,
                    row.law,
                    row.outcome,
                    settled,
                    *("" if math.isnan(number) else repr(float(number)) for number in numbers),
                    " ".join(row.passed_limits),
                    row.why,
                ]
            )
        return text.getvalue()

    def figure(self) -> Figure:
        """Draw errors over time, settling times, residuals and efforts."""
        return figure_of(self)

    def write(self, folder: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write comparison.md, .csv, .svg and .png into a folder, and the scenarios as YAML, each under its name.

        Parameters
        ----------
        folder, force
            As for ``hexservo run --out``: a new or empty folder; with `force` one that holds our results, unchanged.

        Raises
        ------
        OutputError
            The folder cannot take the files (a `ValueError`); then nothing is written.
        """
        return write_folder(folder, self._fill, "a comparison", force=force)

    def _fill(self, folder: Path) -> None:
        (folder / "comparison.md").write_text(self.to_markdown(), encoding="utf-8")
        (folder / "comparison.csv").write_text(self.to_csv(), encoding="utf-8", newline="")
        figure = self.figure()
        for extension in ("svg", "png"):
            (folder / f"comparison.{extension}").write_bytes(image_of(figure, extension))
        for scenario in self.scenarios:
            (folder / f"{scenario.name}.yaml").write_text(scenario.to_yaml(), encoding="utf-8")


def metric_text(row: ComparisonRow, column: MetricColumn) -> str:
    """Write one number of the table; "-" where there is none, "!" if it exceeds a limit."""
    value = row.metrics.get(column.metric, math.nan) * column.scale
    if math.isnan(value):
        return "never" if column.metric == "settling_time" and row.outcome == "completed" else "-"
    return number(value)


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")
