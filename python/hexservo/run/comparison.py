"""Results of several laws on several scenarios (docs/compare.md)."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hexservo.run.display import comparison_text
from hexservo.run.drawn import figure_of, html_of, image_of
from hexservo.run.files import write_folder
from hexservo.run.leg_limits import exceeded_limits
from hexservo.run.metrics import (
    METRICS,
    is_settled,
    metric_unit,
    readable_unit,
    shown_number,
    since_settling,
    unsettled,
)
from hexservo.scenario.arrays import Array
from hexservo.scenario.default_gains import is_far, platform_of_defaults, taken_over
from hexservo.scenario.fields import described
from hexservo.scenario.laws import ALL_LAWS
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import number

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


@described
@dataclass(frozen=True, eq=False, repr=False)
class ComparisonRow:
    """Result of one law in one scenario."""

    law: str  # name of a law or a custom controller
    scenario: Scenario  # with that law; as given where the law refuses it
    # as Result.outcome ("interrupted" also where a run was never begun), or "refused": the law cannot run the scenario,
    # or "failed": the custom controller raised an exception or gave no finite command
    outcome: str
    detail: str  # one sentence: how the run ended, or why it was refused or failed
    end_time: float = math.nan  # time of the last good sample [s]; NaN without the result of a run
    metrics: Mapping[str, float] = field(default_factory=dict, repr=False)  # of hs.METRICS; none without a result
    time: Array = field(default_factory=lambda: np.empty(0), repr=False)  # (n,) [s], n at most about 5000
    error: Array = field(default_factory=lambda: np.empty(0), repr=False)  # (n,) [px], largest |feature error|

    def __repr__(self) -> str:
        """Return law, scenario and verdict."""
        return f"<{self.law} on {self.scenario.name}: {self.verdict}; {self.why}>"

    @property
    def settled(self) -> bool:
        """Whether the run completed and has a settling time: docs/model.md, section 8."""
        return bool(is_settled(self.outcome, self.metrics.get("settling_time", math.nan)))

    @property
    def verdict(self) -> str:
        """The outcome in a word or two: settled, not settled, or how the run ended early."""
        if self.outcome == "completed":
            return "settled" if self.settled else "not settled"
        return self.outcome.replace("_", " ")

    @property
    def passed_limits(self) -> tuple[str, ...]:
        """The limits of the legs that were exceeded: "stroke", "force", "speed", "base_joint", "platform_joint"."""
        return tuple(limit.kind for limit in exceeded_limits(self.scenario, self.metrics))

    @property
    def why(self) -> str:
        """One sentence: the reason of the verdict, and the exceeded limits."""
        measured = self.scenario.metrics
        if self.outcome != "completed":
            sentence = self.detail
        elif self.settled:
            sentence = f"within {measured.band:g} px {since_settling(self.metrics, measured)}"
        else:
            sentence = unsettled(self.metrics, measured)
        exceeded = exceeded_limits(self.scenario, self.metrics)
        return "; ".join([sentence, *(f"{limit.exceeded} of {limit.text}" for limit in exceeded)])


@dataclass(frozen=True)
class MetricColumn:
    """A column of numbers of the table, in the unit that people read."""

    metric: str
    name: str
    limit: str = ""  # of `ComparisonRow.passed_limits`, which it shows
    of_cranks: str = ""  # name where all legs are cranks; "": the same

    def head(self, rows: Sequence[ComparisonRow]) -> str:
        """Return the head of the column in a table of these rows."""
        cranks = [row.scenario.robot.legs == "rotary" for row in rows]
        if not self.of_cranks or not any(cranks):
            return self.name
        return self.of_cranks if all(cranks) else f"{self.name}, {self.of_cranks}"


COLUMNS = (
    MetricColumn("settling_time", "settles"),
    MetricColumn("final_error", "residual"),
    MetricColumn("rms_error", "RMS"),
    MetricColumn("overshoot", "overshoot"),
    MetricColumn("relative_overshoot", "overshoot"),
    MetricColumn("peak_feature_distance", "farthest"),
    MetricColumn("peak_line_deviation", "off line"),
    MetricColumn("peak_displacement", "camera"),
    MetricColumn("peak_rotation", "camera"),
    MetricColumn("effort", "effort"),
    MetricColumn("chatter", "chatter"),
    MetricColumn("peak_leg_force", "leg force", limit="force", of_cranks="crank torque"),
    MetricColumn("peak_leg_excursion", "stroke", limit="stroke"),
)
"""What the table for people shows, in this order; `to_csv` has all metrics."""

_DIGITS = 3  # of its numbers


@described
@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Several laws on several scenarios, one row for each pair: scenario by scenario, law by law, in the given order.

    A row depends on its law and scenario only, not on the other rows, bit for bit within one variant.
    """

    laws: tuple[str, ...]  # names of laws and of custom controllers
    scenarios: tuple[Scenario, ...]  # with the changes, and the law that they came with
    rows: tuple[ComparisonRow, ...]  # in the order above

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

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence for each scenario whose bandwidth laws took over, or on whose machine they have default gains."""
        return tuple(sentence for scenario in self.scenarios for sentence in self._remarks_on(scenario))

    def _remarks_on(self, scenario: Scenario) -> Iterator[str]:
        own = scenario.controller.law
        rows = [row for row in self.rows if row.scenario.name == scenario.name and row.law in ALL_LAWS]
        rows = [row for row in rows if row.outcome != "refused"]
        if with_bandwidth := [row.law for row in rows if taken_over(scenario, row.law)]:
            auto = getattr(scenario.controller, own).auto
            yield (
                f"{scenario.name}: {_listed(with_bandwidth)} took over the bandwidth of controller.{own}.auto, "
                f"{number(auto.bandwidth)} Hz with a damping of {number(auto.damping)}, "
                "since their gains are not written"
            )
        if with_defaults := [row.law for row in rows if is_far(row.scenario)]:
            yield (
                f"{scenario.name}: {_listed(with_defaults)} had default gains, of {platform_of_defaults()}, which do "
                "not fit this machine; gains of auto.bandwidth in the law's block do"
            )

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
        """Return the table for people as Markdown; an exclamation mark follows values beyond a limit of the legs.

        Where the scenarios have both legs that change their length and cranks, each number of the legs has its unit.
        """
        units, columns = zip(*(column_texts(self.rows, column) for column in COLUMNS), strict=True)
        heads = (
            f"{column.head(self.rows)}{f' [{unit}]' if unit else ''}"
            for column, unit in zip(COLUMNS, units, strict=True)
        )
        lines = [
            ["scenario", "law", "verdict", *heads, "why"],
            ["---", "---", "---", *("---:" for _ in COLUMNS), "---"],
        ]
        for row, *numbers in zip(self.rows, *columns, strict=True):
            lines.append([row.scenario.name, row.law, row.verdict, *numbers, row.why])
        return "".join(f"| {' | '.join(_escaped(cell) for cell in line)} |\n" for line in lines)

    def to_csv(self) -> str:
        """Return every metric of every run as CSV in SI units and pixels; empty where a number has no meaning.

        Where the scenarios have both legs that change their length and cranks, a column of units follows each metric of
        the legs.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        units = self._units()
        heads = [
            head
            for name, known in units.items()
            for head in ([f"{name} [{known[0]}]"] if len(known) == 1 else [name, f"{name} unit"])
        ]
        writer.writerow(["scenario", "law", "outcome", "settled", "end_time [s]", *heads, "limits", "why"])
        for row in self.rows:
            cells = [_exact(row.end_time)]
            for name, known in units.items():
                cells.append(_exact(row.metrics.get(name, math.nan)))
                cells += [metric_unit(name, row.scenario.robot)] if len(known) > 1 else []
            settled = "" if row.outcome in ("refused", "interrupted") else "yes" if row.settled else "no"
            writer.writerow(
                [
                    row.scenario.name,
                    row.law,
                    row.outcome,
                    settled,
                    *cells,
                    " ".join(row.passed_limits),
                    row.why,
                ]
            )
        return text.getvalue()

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the comparison as a flat table: a row for each pair of scenario and law, in the order of `rows`.

        Columns: ``scenario`` and ``law`` by name; ``outcome``, ``settled`` (bool), ``end_time``; metrics by their names
        in `hs.METRICS`, NaN where a number has no meaning; ``limits``, those that legs exceeded, as in
        `ComparisonRow.passed_limits` with spaces between; ``why``. ``attrs["units"]`` maps times and metrics to their
        units. Where the scenarios have both legs that change their length and cranks, a column such as
        ``peak_leg_force unit`` has those of each metric of the legs instead.
        """
        import pandas as pd

        columns: dict[str, Any] = {
            "scenario": [row.scenario.name for row in self.rows],
            "law": [row.law for row in self.rows],
            "outcome": [row.outcome for row in self.rows],
            "settled": [row.settled for row in self.rows],
            "end_time": [row.end_time for row in self.rows],
        }
        units = {"end_time": "s"}
        for name, known in self._units().items():
            columns[name] = [row.metrics.get(name, math.nan) for row in self.rows]
            if len(known) == 1:
                units[name] = known[0]
            else:
                columns[f"{name} unit"] = [metric_unit(name, row.scenario.robot) for row in self.rows]
        columns["limits"] = [" ".join(row.passed_limits) for row in self.rows]
        columns["why"] = [row.why for row in self.rows]
        table = pd.DataFrame(columns)
        table.attrs = {"units": units}
        return table

    def _units(self) -> dict[str, list[str]]:
        """Return the units that each metric has, by name: two where legs of variable length and cranks are compared."""
        return {name: sorted({metric_unit(name, each.robot) for each in self.scenarios}) for name in METRICS}

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
        remarks = "".join(f"\n{sentence}.\n" for sentence in self.remarks)
        (folder / "comparison.md").write_text(self.to_markdown() + remarks, encoding="utf-8")
        (folder / "comparison.csv").write_text(self.to_csv(), encoding="utf-8", newline="")
        figure = self.figure()
        for extension in ("svg", "png"):
            (folder / f"comparison.{extension}").write_bytes(image_of(figure, extension))
        for scenario in self.scenarios:
            (folder / f"{scenario.name}.yaml").write_text(scenario.to_yaml(), encoding="utf-8")


def _listed(names: Sequence[str]) -> str:
    return " and ".join([*([", ".join(names[:-1])] if names[1:] else []), names[-1]])


def column_texts(
    rows: Sequence[ComparisonRow], column: MetricColumn, *, with_units: bool = False
) -> tuple[str, list[str]]:
    """Return the unit that people read in a column, and the text of each row.

    A text is "-" where there is no number, "<1e-6" or the like for rounding, and ends with "!" if it exceeds a limit.

    Parameters
    ----------
    rows, column
        Of the table; all rows have the unit of the largest number.
    with_units
        Whether each text has its unit, as where rows differ, of cranks and legs of variable length; the column has none
        there.
    """
    units = [metric_unit(column.metric, row.scenario.robot) for row in rows]
    values = [row.metrics.get(column.metric, math.nan) for row in rows]
    largest = dict.fromkeys(units, 0.0)
    for unit, value in zip(units, values, strict=True):
        largest[unit] = max(largest[unit], value)  # which NaN does not change
    shown = {unit: readable_unit(unit, size, _DIGITS) for unit, size in largest.items()}
    each = with_units or len(shown) > 1
    texts = []
    for row, value, unit in zip(rows, values, units, strict=True):
        if math.isnan(value):
            texts.append("never" if column.metric == "settling_time" and row.outcome == "completed" else "-")
            continue
        of_people, scale = shown[unit]
        exceeded = "!" if column.limit in row.passed_limits else ""
        texts.append(f"{shown_number(value, unit, scale, _DIGITS)}{f' {of_people}' if each else ''}{exceeded}")
    return "" if each else shown[units[0]][0], texts


def _exact(number: float) -> str:
    return "" if math.isnan(number) else repr(float(number))


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")
