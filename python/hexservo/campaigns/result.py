"""What a campaign gave: read from its folder, lazily."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexservo.campaigns.chunks import Tally
from hexservo.campaigns.intervals import clopper_pearson, joint_confidence
from hexservo.campaigns.plan import MOST_LOG_EVERY, CampaignPlan
from hexservo.campaigns.refused import refused_draw, valid_rows
from hexservo.campaigns.requirements import Requirement
from hexservo.campaigns.store import Store, UnreadableError, read_plan
from hexservo.campaigns.words import summary_section
from hexservo.findings.display import Findings
from hexservo.run.metrics import metric_unit
from hexservo.run.publish import named
from hexservo.run.sealed import ResultError
from hexservo.scenario.arrays import Array
from hexservo.scenario.fields import described
from hexservo.scenario.rules import did_you_mean
from hexservo.scenario.scenario import Scenario, load_scenario, scenario_names
from hexservo.scenario.wording import quoted, several_names, whole_number
from hexservo.scenario.yaml import ScenarioError

if TYPE_CHECKING:
    import pandas
    import pyarrow as pa

    from hexservo.findings.evidence import Section


@described
@dataclass(frozen=True)
class WorstRun:
    """A run with a small margin, to be repeated."""

    index: int  # in the campaign
    margin: float  # smallest one of its requirements; negative: it fails
    scenario: Scenario  # of the run: `hs.simulate` repeats it, to rounding


@described
@dataclass(frozen=True, repr=False, eq=False)
class CampaignResult(Findings):
    """A campaign's folder. Its runs are those of the chunks from the first one on without a gap."""

    folder: Path  # of its files
    plan: CampaignPlan  # as the folder has it
    summary: dict[str, Any]  # as summary.json: docs/campaigns.md, section 4
    interrupted: bool = False  # Ctrl-C came before it was complete
    worst_file: Path | None = None  # scenario of the run with the smallest margin; None: loaded, or without runs

    def __len__(self) -> int:
        """Return the number of runs."""
        return int(self.summary["runs"])

    @property
    def complete(self) -> bool:
        """Whether it has all its runs, or its interval has decided."""
        return bool(self.summary["complete"])

    @property
    def failures(self) -> int:
        """Number of runs that fail at least one requirement."""
        return int(self.summary["failures"])

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the failure probability, which holds at any number of runs (docs/campaigns.md, section 5)."""
        low, high = self.summary["interval"]
        return low, high

    def section(self) -> Section:
        """Return the verdict in sentences, with tables of requirements, outcomes and the worst runs."""
        return summary_section(self.summary)

    def headline(self) -> str:
        """Return a line that names the folder."""
        return f"Campaign in {named(self.folder)}"

    def tables(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the runs chunk by chunk, each verified by its SHA-256 first.

        Parameters
        ----------
        columns
            Names of columns; None: all (docs/campaigns.md, section 4).

        Raises
        ------
        ResultError
            A chunk is damaged, or the folder holds another campaign by now.
        TypeError
            For anything but names of columns, or None.
        ValueError
            For a name that no column has.
        """
        names = None if columns is None else several_names("columns", columns, "names of columns, or None")
        plan, record = read_plan(self.folder)
        if record["campaign"] != self.summary["campaign"]:
            raise ResultError(
                f"{named(self.folder)}: expected the campaign of this result, got a different one; load it again"
            )
        store = Store(self.folder, plan, record)
        left, index = len(self), 0
        while left > 0:
            table = store.read(index)[:left]  # a folder may have more runs by now
            left, index = left - len(table), index + 1
            if len(table):  # else no draw of the chunk is a valid scenario
                yield table if names is None else _selected(table, names)

    def to_arrow(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the runs as one table in memory, ordered by index; arguments and errors as for `tables`.

        Raises
        ------
        ValueError
            There are no runs.
        """
        import pyarrow as pa

        tables = list(self.tables(columns))
        if not tables:
            raise ValueError(f"{named(self.folder)}: expected a campaign with runs, got none; run it first")
        return pa.concat_tables(tables).combine_chunks()

    def to_dataframe(self, columns: Sequence[str] | None = None) -> pandas.DataFrame:
        """Return the runs as a table of pandas; arguments and errors as for `to_arrow`."""
        frame: pandas.DataFrame = self.to_arrow(columns).to_pandas()
        return frame

    def margin(self) -> Array:
        """Return the margin of every run, (n,): the smallest one of its requirements, negative where it fails."""
        margin: Array = self.to_arrow(["margin"]).column("margin").to_numpy()
        return margin

    def scenario(self, index: int) -> Scenario:
        """Return the scenario of a run: `hs.simulate` of it repeats the run, to rounding.

        Raises
        ------
        IndexError
            There is no such run.
        ScenarioError
            What was drawn for it is no valid scenario, and was left out of the campaign.
        TypeError
            For anything but an integer.
        """
        return scenario_of_run(self.plan, self._checked(index))

    def worst(self, count: int = 5) -> tuple[WorstRun, ...]:
        """Return the runs of the smallest margins, the worst first.

        Parameters
        ----------
        count
            How many, at least 0; there are 10 at most.

        Raises
        ------
        TypeError
            For anything but an integer.
        ValueError
            For a negative one.
        """
        count = whole_number("count", count, 0)
        found = self.summary["worst"][:count]
        return tuple(WorstRun(one["index"], one["margin"], self.scenario(one["index"])) for one in found)

    def command(self, index: int, file: str = "run.yaml") -> str:
        """Return a command that repeats a run.

        It changes the packaged scenario where the campaign varies one and no goal is read in with the changes (as
        the goal pose of a camera that varies); else it names a file to which `scenario(index)` is to be written first.
        """
        scenario, changes = scenario_and_changes(self.plan.scenario, self.plan.drawing().changes(self._checked(index)))
        return command_with_changes(changes, scenario) or f"hexservo run {file}"

    def _checked(self, index: int) -> int:
        index = whole_number("index", index, -sys.maxsize)
        drawn = len(self) + self.summary.get("refused", 0)
        if not 0 <= index < drawn:
            raise IndexError(f"index: expected one from 0 to {drawn - 1}, got {index}")
        return index


def load_campaign(folder: str | os.PathLike[str]) -> CampaignResult:
    """Load a campaign from its folder, also while it runs; runs are read when they are asked for.

    Raises
    ------
    ResultError
        The folder holds no campaign, a damaged one, or a chunk that cannot be read.
    """
    plan, record = read_plan(folder)
    store = Store(folder, plan, record)
    summary = store.read_summary()  # not there, or changed: the chunks have it all
    if summary is not None and summary["complete"]:
        until = plan.to_mapping()["until"]
        if (summary["planned_runs"], summary["until"]) == (plan.runs, until):
            of_plan = {"scenario": plan.scenario.name, "common_noise": plan.common_noise}
            return CampaignResult(store.folder, plan, summary | of_plan)
    tally = Tally([0] * len(plan.require))
    present = set(store.indices())
    index = 0
    while index in present and not is_complete(plan, tally):
        try:
            table = store.read(index)
        except UnreadableError:
            raise
        except ResultError:
            break
        tally.add(store.tally(index, table))
        index += 1
    return CampaignResult(store.folder, plan, summary_of(plan, record, tally))


def _selected(table: pa.Table, names: list[str]) -> pa.Table:
    for name in names:
        if name not in table.column_names:
            hint = did_you_mean(name, table.column_names)
            raise ValueError(f"columns: expected names of {', '.join(table.column_names)}, got {quoted(name)}{hint}")
    return table.select(names)


# ---- Runs -----------------------------------------------------------------------------------------------------------


def scenario_of_run(plan: CampaignPlan, index: int) -> Scenario:
    """Return the scenario of a run."""
    return scenario_and_changes(plan.scenario, plan.drawing().changes(index))[0]


def scenario_and_changes(base: Scenario, changes: Mapping[str, Any]) -> tuple[Scenario, dict[str, Any]]:
    """Return the scenario of a run by itself, and what it changes in that of the campaign.

    A campaign keeps no samples. Where those of the run would exceed a log, as with a long ``simulation.duration``, both
    have a larger ``simulation.log_every``, on which no metric depends.
    """
    try:
        return base.updated(changes), dict(changes)
    except ScenarioError as error:
        every = 2 * changes.get("simulation.log_every", base.simulation.log_every)
        of_log = all(problem.startswith("simulation.log_every:") for problem in error.problems)
        if not of_log or every > MOST_LOG_EVERY:
            raise
    return scenario_and_changes(base, {**changes, "simulation.log_every": every})


def command_with_changes(changes: Mapping[str, Any], scenario: Scenario) -> str:
    """Return a command that runs a scenario as a packaged one with changes; "" where it is not that."""
    name = scenario.name
    try:
        is_the_same = name in scenario_names() and load_scenario(name, changes) == scenario
    except ScenarioError:  # of a packaged goal pose, beside features that vary
        is_the_same = False
    settings = [f"--set '{key}={_written(value)}'" for key, value in changes.items()]
    return " ".join([f"hexservo run {name}", *settings]) if is_the_same else ""


def _written(value: Any) -> str:
    if value is None:
        return "null"
    return "[" + ", ".join(map(_written, value)) + "]" if isinstance(value, list) else repr(value)


# ---- The summary ----------------------------------------------------------------------------------------------------


def summary_of(plan: CampaignPlan, record: dict[str, Any], tally: Tally) -> dict[str, Any]:
    """Return what summary.json holds: counts, intervals and the worst runs (docs/campaigns.md, section 4)."""
    interval = plan.interval(tally.failures, tally.runs)
    fixed = record["fixed_runs"] is not None and tally.drawn == record["fixed_runs"]
    return {
        "campaign": record["campaign"],
        "hexservo": record["hexservo"],
        "variant": record["variant"],
        "scenario": plan.scenario.name,
        "common_noise": plan.common_noise,
        "runs": tally.runs,
        "refused": tally.refused,
        "refusal": why_refused(plan, tally),
        "planned_runs": plan.runs,
        "until": None if plan.until is None else plan.until.to_plain(),
        "complete": is_complete(plan, tally),
        "failures": tally.failures,
        "confidence": plan.confidence,
        "interval": list(interval),
        "mixture": [plan.mixture.a, plan.mixture.b],
        "clopper_pearson": list(clopper_pearson(tally.failures, tally.runs, plan.confidence)) if fixed else None,
        "joint_confidence": joint_confidence(plan.confidence, len(plan.require)),
        "requirements": [
            {
                "holds": str(requirement),
                "failures": failed,
                "interval": list(plan.interval(failed, tally.runs)),
                **_values(plan, requirement, span),
            }
            for requirement, failed, span in zip(plan.require, tally.failed, tally.spans, strict=True)
        ],
        "settled_at_start": tally.unmoved if plan.needs_motion else None,
        "without_value": {name: count for name, count in sorted(tally.valueless.items()) if count},
        "outcomes": dict(sorted(tally.outcomes.items())),
        "worst": [{"index": index, "margin": margin} for margin, _, index in tally.worst],
    }


def _values(plan: CampaignPlan, requirement: Requirement, span: tuple[float, float]) -> dict[str, Any]:
    """Return the bound of a metric, and the ends of its values in the runs that completed, null where none has any."""
    if requirement.name == "outcome":
        return {}
    smallest, largest = span if span[0] <= span[1] else (None, None)
    unit = metric_unit(requirement.name, plan.scenario.robot)
    return {"bound": requirement.bound, "unit": unit, "smallest": smallest, "largest": largest}


def why_refused(plan: CampaignPlan, tally: Tally) -> str:
    """Return why the first draw that is no valid scenario is none, with its index; "" where all are."""
    if tally.first_refused is None:
        return ""
    drawing, index = plan.drawing(), tally.first_refused
    numbers, base = drawing.numbers(index, index + 1), plan.scenario.updated(drawing.base)
    try:
        valid_rows(base, drawing.variations(numbers), 1, required=True)
    except ValueError as error:
        return "; ".join(refused_draw(error, base, numbers, lambda place: f"run {index}").problems)
    raise AssertionError  # it is valid


def is_complete(plan: CampaignPlan, tally: Tally) -> bool:
    """Return whether there are all runs, or as many as the interval needs to decide."""
    if tally.drawn == plan.runs:
        return True
    if plan.until is None or tally.runs == 0:
        return False
    return plan.until.decided(*plan.interval(tally.failures, tally.runs))
