"""Runs several laws on several scenarios (docs/compare.md)."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hexservo.run.batch import metrics_of, simulate_batch, thread_count
from hexservo.run.comparison import Comparison, ComparisonRow
from hexservo.run.custom_controller import OwnController, require_runnable
from hexservo.run.metrics import metrics
from hexservo.run.progress import ProgressCallback, reporting
from hexservo.run.result import Result
from hexservo.run.shared import shared_by, variations_of
from hexservo.run.simulation import simulate
from hexservo.scenario.default_gains import taken_over
from hexservo.scenario.laws import ALL_LAWS, LAWS
from hexservo.scenario.scenario import Document, Scenario, read_document
from hexservo.scenario.wording import wrong_type
from hexservo.scenario.yaml import ScenarioError

_MAX_SAMPLES = 5000  # of the error that a row keeps
_MAX_BATCH = 32  # runs in one batch: bounds the memory of their logs


# ---- The runs -------------------------------------------------------------------------------------------------------


def compare(
    scenarios: Sequence[str | os.PathLike[str] | Scenario],
    laws: Iterable[str] | None = None,
    changes: Mapping[str, Any] | None = None,
    threads: int | None = None,
    progress: bool | ProgressCallback | None = None,
    *,
    controllers: Mapping[str, OwnController] | None = None,
) -> Comparison:
    """Run every law on every scenario and tabulate the results (docs/compare.md).

    Only ``controller.law`` of a scenario is replaced; each law has its own block of gains. A law of which no gain is
    written takes over ``auto.bandwidth`` and ``auto.damping`` of the scenario's law (`Comparison.remarks`). Runs that
    differ in numbers only share a batch (`simulate_batch`); all others are single runs (`simulate`).

    Parameters
    ----------
    scenarios
        Scenarios, names of packaged ones or paths of YAML files; of different names.
    laws
        Names of laws, each once, or none with ``controllers``; None: all of any machine, and `tracking` where a
        scenario has it.
    changes
        Applied to every scenario before its law is replaced, as `load_scenario` does to a name or path, and
        `Scenario.updated` to a `Scenario`.
    threads
        As for `simulate_batch`.
    progress
        True draws a bar on standard error; a function is called with (runs done, runs in all), in this thread; what it
        raises ends the comparison.
    controllers
        Custom controllers by the names of their rows, compared with the laws; functions as for `simulate`.
        They run one by one in this thread, in sampled mode and with drives that take forces alone: other scenarios are
        "refused". An observation with ``tick`` 0 begins a new run.

    Returns
    -------
    Comparison
        A run that diverges is a row with its outcome, and so is a scenario that a law refuses ("refused") and a run
        whose custom controller raises or gives no finite command ("failed", with the message). Ctrl-C ends the
        comparison; what is finished is kept, the other rows are "interrupted".

    Raises
    ------
    TypeError
        For anything but a sequence, as text or one scenario; for controllers that cannot be called, or whose names are
        no text.
    ValueError
        For no or repeated laws and scenarios, or an unknown law; for a number of threads that `simulate_batch` refuses.
    ScenarioError
        For a scenario that does not exist or is not valid with its own law and the changes.
    VariantError
        Where the environment variable HEXSERVO_VARIANT asks for a variant that is not there.
    """
    thread_count(threads)
    functions = _checked_controllers(controllers)
    loaded = _checked_scenarios(scenarios, changes)
    chosen_laws = (*_checked_laws(laws, loaded, none_will_do=bool(functions)), *functions)
    rows = [_prepared(scenario, law, custom=law in functions) for scenario in loaded for law in chosen_laws]
    groups = _groups(rows, functions)
    with reporting(progress, "runs", transient=True) as report, contextlib.suppress(KeyboardInterrupt):
        done = sum(row.outcome == "refused" for row in rows)
        report(done, len(rows))
        for group in groups:

            def told(finished: int, before: int = done) -> None:
                report(before + finished, len(rows))

            for index, row in _run([(index, rows[index]) for index in group], threads, told, functions):
                rows[index] = row
            done += len(group)
            report(done, len(rows))
            if any(rows[index].outcome == "interrupted" for index in group):
                break
    return Comparison(chosen_laws, loaded, tuple(rows))


def _checked_laws(laws: Iterable[str] | None, scenarios: Sequence[Scenario], *, none_will_do: bool) -> tuple[str, ...]:
    if laws is None:
        own = {scenario.controller.law for scenario in scenarios}
        return tuple(law for law in ALL_LAWS if law in LAWS or law in own)
    if isinstance(laws, str):
        raise TypeError("laws: expected a sequence of names, got text")
    if not isinstance(laws, Iterable):
        raise wrong_type("laws", "a sequence of names or None", laws)
    chosen = tuple(laws)  # an iterator has its names once
    for law in chosen:
        if law not in ALL_LAWS:
            raise ValueError(f"laws: expected some of {', '.join(ALL_LAWS)}, got {law!r}")
    if len(set(chosen)) < len(chosen) or not (chosen or none_will_do):
        raise ValueError(f"laws: expected at least one, each once, got {', '.join(chosen) or 'none'}")
    return chosen


def _checked_controllers(controllers: Mapping[str, OwnController] | None) -> dict[str, OwnController]:
    if controllers is None:
        return {}
    if not isinstance(controllers, Mapping):
        raise wrong_type("controllers", "a mapping of names to functions", controllers)
    for name, function in controllers.items():
        if not isinstance(name, str):
            raise wrong_type("controllers", "names that are text", name)
        if not name.strip() or not name.isprintable() or name in ALL_LAWS:
            raise ValueError(f"controllers: expected names that are text and not names of laws, got {name!r}")
        if not callable(function):
            raise wrong_type(f"controllers: {name}", "a function", function)
    return dict(controllers)


def _checked_scenarios(
    scenarios: Sequence[str | os.PathLike[str] | Scenario], changes: Mapping[str, Any] | None
) -> tuple[Scenario, ...]:
    if isinstance(scenarios, str | os.PathLike | Scenario):
        raise TypeError("scenarios: expected a sequence of scenarios, names or paths, got one of them")
    if not isinstance(scenarios, Iterable):
        raise wrong_type("scenarios", "a sequence of scenarios, names or paths", scenarios)
    loaded = []
    for given in scenarios:
        document: Scenario | Document = given if isinstance(given, Scenario) else read_document(given)
        try:
            if isinstance(document, Scenario):
                loaded.append(document.updated(changes) if changes else document)
            else:
                loaded.append(document.scenario(changes))
        except ScenarioError as error:
            name = document.name if isinstance(document, Scenario) else document.source
            raise ScenarioError(error.problems, name) from None
    names = [scenario.name for scenario in loaded]
    twice = sorted({name for name in names if names.count(name) > 1})
    if not names or twice:
        got = f"{', '.join(twice)} more than once" if twice else "none"
        raise ValueError(f"scenarios: expected at least one, of different names, got {got}")
    return tuple(loaded)


def _prepared(scenario: Scenario, law: str, *, custom: bool) -> ComparisonRow:
    """Return a row not yet run, its scenario with the law and no more samples than a row keeps; or a refusal.

    A custom controller has no law to put into the scenario.
    """
    steps = round(scenario.simulation.duration / scenario.simulation.step)
    log_every = max(scenario.simulation.log_every, -(-steps // _MAX_SAMPLES))
    of_law = {} if custom else {"controller.law": law, **taken_over(scenario, law)}
    try:
        changed = scenario.updated({**of_law, "simulation.log_every": log_every})
        if custom:
            require_runnable(changed)
    except ScenarioError as error:
        return _refused(law, scenario, error)
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
        shared = str(index) if row.law in functions else repr(shared_by(row.scenario))
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
        try:
            result = simulate(row.scenario, controller=functions[row.law])
        except Exception as error:  # a function may raise anything; the other rows do not depend on it
            yield index, ComparisonRow(row.law, row.scenario, "failed", _failure(error))
        else:
            yield index, _row_of(row, result)
        return
    scenarios = [row.scenario for _, row in group]
    raised: list[Exception] = []  # by the function that reports the progress, which may raise a ValueError too

    def watched(done: int, count: int) -> None:
        try:
            report(done)
        except Exception as error:
            raised.append(error)
            raise

    try:
        batch = simulate_batch(scenarios[0], variations_of(scenarios), "trajectory", threads, watched)
    except ValueError:  # these scenarios fit no batch
        if raised:
            raise
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
                metrics_of(batch, number),
                batch.time[kept],
                errors[number][kept],
            ),
        )


def _failure(error: Exception) -> str:
    """Return an exception as one line, with its notes: `run_with` adds the tick at which a controller raised it."""
    lines = [f"{type(error).__name__}: {error}", *getattr(error, "__notes__", [])]
    return " ".join("; ".join(lines).split())


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
