"""Runs several laws on several scenarios and puts what came out side by side (docs/compare.md)."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexservo.findings.display import comparison_html, comparison_text
from hexservo.run.batch import ProgressCallback, simulate_batch
from hexservo.run.custom_controller import OwnController
from hexservo.run.metrics import METRICS, metrics
from hexservo.run.progress import progress_bar
from hexservo.run.result import Result
from hexservo.run.simulation import simulate
from hexservo.scenario.scenario import LAWS, Scenario, ScenarioError, acting_keys, load_scenario
from hexservo.scenario.wording import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Comparison", "ComparisonRow", "compare"]

Array: TypeAlias = NDArray[np.float64]

_MAX_SAMPLES = 5000  # of the error that a row keeps
_MAX_BATCH = 32  # runs in one batch: bounds the memory of their logs
_ALWAYS = "uncertainty.gravity"  # varies in every batch, be it by nothing


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonRow:
    """What one law did in one scenario."""

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
        """Give law, scenario and verdict."""
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
        """Which limits of the legs were passed on the way: "stroke", "force"."""
        robot = self.scenario.robot
        peaks = {"stroke": ("peak_leg_excursion", robot.stroke), "force": ("peak_leg_force", robot.force_limit)}
        return tuple(what for what, (name, limit) in peaks.items() if self.metrics.get(name, math.nan) > limit)

    @property
    def why(self) -> str:
        """One sentence: what the verdict rests on, and the limits that were passed."""
        measured = self.scenario.metrics
        if self.outcome != "completed":
            sentence = self.detail
        elif self.settled:
            sentence = f"within {measured.band:g} px from {self.metrics['settling_time']:.4g} s on"
        elif self.metrics["final_error"] <= measured.band:
            sentence = f"within {measured.band:g} px at the end, but for less than {measured.dwell:g} s"
        else:
            sentence = f"{self.metrics['final_error']:.4g} px off at the end, above {measured.band:g} px"
        robot = self.scenario.robot
        excess = {
            "stroke": f"a leg passed its stroke of {robot.stroke * 1e3:.4g} mm",
            "force": f"a leg passed its force limit of {robot.force_limit:.4g} N",
        }
        return "; ".join([sentence, *(excess[what] for what in self.passed_limits)])


@dataclass(frozen=True)
class Column:
    """A column of numbers of the table."""

    metric: str
    head: str
    unit: str
    scale: float = 1.0  # of these units in one of the metric's
    limit: str = ""  # of `ComparisonRow.passed_limits`, which it shows


COLUMNS = (
    Column("settling_time", "settles", "s"),
    Column("final_error", "residual", "px"),
    Column("rms_error", "RMS", "px"),
    Column("overshoot", "overshoot", "px"),
    Column("relative_overshoot", "overshoot", "%", 100.0),
    Column("peak_feature_distance", "farthest", "px"),
    Column("peak_line_deviation", "off line", "px"),
    Column("peak_displacement", "camera", "mm", 1e3),
    Column("peak_rotation", "camera", "mrad", 1e3),
    Column("effort", "effort", "N^2 s"),
    Column("chatter", "chatter", "N/s"),
    Column("peak_leg_force", "leg force", "N", limit="force"),
    Column("peak_leg_excursion", "stroke", "mm", 1e3, limit="stroke"),
)
"""What the table for people shows, in this order; `to_csv` has all metrics."""


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Several laws on several scenarios, one row for each pair: scenario by scenario, law by law, as they were given.

    A row depends on its law and scenario only, not on the other rows, bit for bit within one variant.
    """

    laws: tuple[str, ...]
    scenarios: tuple[Scenario, ...]  # with the changes, and the law that they came with
    rows: tuple[ComparisonRow, ...]

    def __repr__(self) -> str:
        """Give the verdicts in a line for each law."""
        return comparison_text(self)

    def _repr_html_(self) -> str:
        """Give table and figure for a notebook."""
        return comparison_html(self)

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C came before all runs were finished."""
        return any(row.outcome == "interrupted" for row in self.rows)

    @property
    def finished(self) -> int:
        """Number of runs that were not interrupted."""
        return sum(row.outcome != "interrupted" for row in self.rows)

    def row(self, law: str, scenario: str) -> ComparisonRow:
        """Give the row of a law and the name of a scenario.

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
        """Give the table for people as Markdown; an exclamation mark follows what passed a limit of the legs."""
        head = ["scenario", "law", "verdict", *(f"{column.head} [{column.unit}]" for column in COLUMNS), "why"]
        lines = [head, ["---", "---", "---", *("---:" for _ in COLUMNS), "---"]]
        lines += [
            [row.scenario.name, row.law, row.verdict, *(shown(row, column) for column in COLUMNS), row.why]
            for row in self.rows
        ]
        return "".join(f"| {' | '.join(_escaped(cell) for cell in line)} |\n" for line in lines)

    def to_csv(self) -> str:
        """Give every metric of every run as CSV in SI units and pixels; empty where a number has no meaning."""
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
        """Draw the page of pictures: errors over the time, settling times, residuals and efforts."""
        from hexservo.draw.compare import comparison_figure

        return comparison_figure(self)

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
        from hexservo.run.files import write_folder

        return write_folder(folder, self._fill, "a comparison", force=force)

    def _fill(self, folder: Path) -> None:
        from hexservo.draw.plots import _image

        (folder / "comparison.md").write_text(self.to_markdown(), encoding="utf-8")
        (folder / "comparison.csv").write_text(self.to_csv(), encoding="utf-8", newline="")
        figure = self.figure()
        for extension in ("svg", "png"):
            (folder / f"comparison.{extension}").write_bytes(_image(figure, extension))
        for scenario in self.scenarios:
            (folder / f"{scenario.name}.yaml").write_text(scenario.to_yaml(), encoding="utf-8")


def shown(row: ComparisonRow, column: Column) -> str:
    """Write one number of the table; "-" where there is none, "!" where it passed a limit."""
    value = row.metrics.get(column.metric, math.nan) * column.scale
    if math.isnan(value):
        return "never" if column.metric == "settling_time" and row.outcome == "completed" else "-"
    return number(value)


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")


# ---- The runs -------------------------------------------------------------------------------------------------------


def compare(
    scenarios: Sequence[str | os.PathLike[str] | Scenario],
    laws: Sequence[str] | None = None,
    changes: Mapping[str, Any] | None = None,
    threads: int | None = None,
    progress: bool | ProgressCallback | None = None,
    *,
    controllers: Mapping[str, OwnController] | None = None,
) -> Comparison:
    """Run every law on every scenario and put the results side by side (docs/compare.md).

    A scenario runs with ``controller.law`` replaced and everything else as it stands; each law has a block of gains of
    its own there. Runs that differ in numbers alone share a batch (`simulate_batch`); what a batch does not take is run
    by itself (`simulate`).

    Parameters
    ----------
    scenarios
        Scenarios, names of packaged ones or paths of YAML files; of different names.
    laws
        Names of laws, each once; None: all that there are.
    changes
        Applied to every scenario before its law is replaced, as `Scenario.updated` does.
    threads
        As for `simulate_batch`.
    progress
        True draws a bar on standard error; a function is called with (runs done, runs in all), in this thread.
    controllers
        Custom controllers by the names of their rows, compared beside the laws; functions as `simulate` takes them.
        They run one by one in this thread, in sampled mode alone: a scenario in continuous mode is "refused". An
        observation with ``tick`` 0 begins a new run.

    Returns
    -------
    Comparison
        A run that diverges is a row with its outcome, and so is a scenario that a law refuses ("refused"). Ctrl-C ends
        the comparison; what is finished is kept, the other rows are "interrupted".

    Raises
    ------
    TypeError
        For text in place of a sequence.
    ValueError
        For no or repeated laws and scenarios, or an unknown law.
    ScenarioError
        For a scenario that does not exist or is not valid with its own law and the changes.
    VariantError
        Where the environment variable HEXSERVO_VARIANT asks for a variant that is not there.
    """
    functions = _checked_controllers(controllers)
    chosen_laws = (*(() if laws is not None and not laws and functions else _checked_laws(laws)), *functions)
    loaded = _checked_scenarios(scenarios, changes)
    rows = [_prepared(scenario, law, custom=law in functions) for scenario in loaded for law in chosen_laws]
    groups = _groups(rows, functions)
    with _reporting(progress, len(rows)) as report, contextlib.suppress(KeyboardInterrupt):
        done = sum(row.outcome == "refused" for row in rows)
        report(done)
        for group in groups:

            def told(finished: int, before: int = done) -> None:
                report(before + finished)

            for index, row in _run([(index, rows[index]) for index in group], threads, told, functions):
                rows[index] = row
            done += len(group)
            report(done)
            if any(rows[index].outcome == "interrupted" for index in group):
                break
    return Comparison(chosen_laws, loaded, tuple(rows))


def _checked_laws(laws: Sequence[str] | None) -> tuple[str, ...]:
    if laws is None:
        return LAWS
    if isinstance(laws, str):
        raise TypeError("laws: expected a sequence of names, got text")
    for law in laws:
        if law not in LAWS:
            raise ValueError(f"laws: expected some of {', '.join(LAWS)}, got {law!r}")
    if not laws or len(set(laws)) < len(laws):
        raise ValueError(f"laws: expected at least one, each once, got {', '.join(laws) or 'none'}")
    return tuple(laws)


def _checked_controllers(controllers: Mapping[str, OwnController] | None) -> dict[str, OwnController]:
    if controllers is None:
        return {}
    if not isinstance(controllers, Mapping):
        raise TypeError(f"controllers: expected a mapping of names to functions, got {type(controllers).__name__}")
    for name, function in controllers.items():
        if not str(name).strip() or not str(name).isprintable() or name in LAWS:
            raise ValueError(f"controllers: expected names in words other than those of laws, got {name!r}")
        if not callable(function):
            raise TypeError(f"controllers: {name}: expected a function, got {type(function).__name__}")
    return dict(controllers)


def _checked_scenarios(
    scenarios: Sequence[str | os.PathLike[str] | Scenario], changes: Mapping[str, Any] | None
) -> tuple[Scenario, ...]:
    if isinstance(scenarios, str | os.PathLike | Scenario):
        raise TypeError("scenarios: expected a sequence of scenarios, names or paths, got one of them")
    loaded = []
    for given in scenarios:
        scenario = given if isinstance(given, Scenario) else load_scenario(given)
        try:
            loaded.append(scenario.updated(changes) if changes else scenario)
        except ScenarioError as error:
            raise ScenarioError(error.problems, scenario.name) from None
    names = [scenario.name for scenario in loaded]
    twice = sorted({name for name in names if names.count(name) > 1})
    if not names or twice:
        got = f"{', '.join(twice)} more than once" if twice else "none"
        raise ValueError(f"scenarios: expected at least one, of different names, got {got}")
    return tuple(loaded)


def _prepared(scenario: Scenario, law: str, *, custom: bool) -> ComparisonRow:
    """Give a row that is not begun, its scenario with the law and no more samples than a row keeps; or a refusal.

    A custom controller has no law to put into the scenario.
    """
    steps = round(scenario.simulation.duration / scenario.simulation.step)
    log_every = max(scenario.simulation.log_every, -(-steps // _MAX_SAMPLES))
    try:
        changed = scenario.updated({**({} if custom else {"controller.law": law}), "simulation.log_every": log_every})
    except ScenarioError as error:
        return _refused(law, scenario, error)
    if custom and scenario.simulation.mode != "sampled":
        sentence = "simulation.mode: expected sampled for a custom controller, got continuous"
        return _refused(law, scenario, ValueError(sentence))
    return ComparisonRow(law, changed, "interrupted", "not begun")


def _refused(law: str, scenario: Scenario, error: ValueError) -> ComparisonRow:
    return ComparisonRow(law, scenario, "refused", " ".join(str(error).split()))


def _groups(rows: Sequence[ComparisonRow], functions: Mapping[str, OwnController]) -> list[list[int]]:
    """Group the rows that are to run, by index, by what a batch shares: law, grid, and everything that is no number.

    A run of a custom controller is a group by itself.
    """
    groups: dict[str, list[list[int]]] = {}
    for index, row in enumerate(rows):
        if row.outcome == "refused":
            continue
        shared = str(index) if row.law in functions else repr(_shared(row.scenario))
        alike = groups.setdefault(shared, [[]])
        if len(alike[-1]) == _MAX_BATCH:
            alike.append([])
        alike[-1].append(index)
    return [group for alike in groups.values() for group in alike]


def _run(
    group: Sequence[tuple[int, ComparisonRow]],
    threads: int | None,
    report: Callable[[int], object],
    functions: Mapping[str, OwnController],
) -> Iterator[tuple[int, ComparisonRow]]:
    """Run scenarios that may share a batch; one by one what no batch takes."""
    if group[0][1].law in functions:
        ((index, row),) = group
        yield index, _row_of(row, simulate(row.scenario, controller=functions[row.law]))
        return
    scenarios = [row.scenario for _, row in group]
    try:
        batch = simulate_batch(
            scenarios[0], _variations(scenarios), "trajectory", threads, lambda done, count: report(done)
        )
    except ValueError:
        for number, (index, row) in enumerate(group):
            yield index, _single(row)
            report(number + 1)
        return
    assert batch.time is not None  # of trajectories
    errors = np.abs(batch.samples["feature_error"]).max(axis=2)
    for number, (index, row) in enumerate(group):
        kept = np.isfinite(errors[number])
        yield (
            index,
            ComparisonRow(
                row.law,
                row.scenario,
                str(batch.outcome[number]),
                batch.detail(number),
                float(batch.end_time[number]),
                {name: float(values[number]) for name, values in batch.metrics.items()},
                batch.time[kept],
                errors[number][kept],
            ),
        )


def _single(row: ComparisonRow) -> ComparisonRow:
    try:
        result = simulate(row.scenario)
    except ValueError as error:
        return _refused(row.law, row.scenario, error)
    return _row_of(row, result)


def _row_of(row: ComparisonRow, result: Result) -> ComparisonRow:
    largest = np.abs(result.feature_error).max(axis=1)
    return ComparisonRow(
        row.law, row.scenario, result.outcome, result.detail, result.end_time, metrics(result), result.time, largest
    )


def _numbers(scenario: Scenario) -> dict[str, Any]:
    """Return the values that a batch may vary, by dotted key, in the widest shape of each; grids are shared."""
    keys = acting_keys(scenario.controller.law, scenario.simulation.mode)
    mapping = scenario.to_mapping()
    numbers = {}
    for key, rule in keys.items():
        value: Any = mapping
        for name in key.split("."):
            value = value[name]
        if key.startswith("simulation.") or value is None or isinstance(value, str):
            continue
        array = np.asarray(value, dtype=rule.dtype)
        shape = max(rule.shapes, key=len)
        if array.shape != shape:  # a number for all entries, or a diagonal
            array = np.diag(array) if array.ndim else np.full(shape, array)
        numbers[key] = array
    return numbers


def _shared(scenario: Scenario) -> dict[str, Any]:
    """Return what the scenarios of a batch have in common: everything but names, numbers, and gains of other laws."""
    mapping = scenario.to_mapping()
    shared = {key: value for key, value in mapping.items() if key not in ("name", "description")}
    controller = shared["controller"] = dict(shared["controller"])
    for law in LAWS:
        if law != scenario.controller.law:
            controller.pop(law, None)
    for key in _numbers(scenario):
        *blocks, last = key.split(".")
        inner = shared
        for block in blocks:
            inner[block] = dict(inner[block])
            inner = inner[block]
        inner[last] = "varies"
    return shared


def _variations(scenarios: Sequence[Scenario]) -> dict[str, Array]:
    """Give the numbers in which scenarios differ, for `simulate_batch`, which asks for one at least."""
    numbers = [_numbers(scenario) for scenario in scenarios]
    variations = {key: np.stack([own[key] for own in numbers]) for key in numbers[0]}
    return {key: values for key, values in variations.items() if key == _ALWAYS or (values != values[0]).any()}


@contextlib.contextmanager
def _reporting(progress: bool | ProgressCallback | None, count: int) -> Iterator[Callable[[int], object]]:
    if progress is None or progress is False:
        yield lambda done: None
    elif callable(progress):
        yield lambda done: progress(done, count)
    elif progress is True:
        with progress_bar("runs", transient=True) as draw:
            yield lambda done: draw(done, count, done / count)
    else:
        raise TypeError(f"progress: expected True, a function or None, got {type(progress).__name__}")
