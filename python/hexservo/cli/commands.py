"""The command line: ``hexservo run | compare | report | scenarios | show | check | export | bench | version`` and more.

Exit codes: 0 done; 1 a tuning without feasible gains; 2 bad input, or results that cannot be written; 3 a run that
ended early, by divergence or another numerical outcome; 4 a run that did not settle, with --require-settled;
130 interrupted; 141 broken pipe.
"""

from __future__ import annotations

import io
import math
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

import hexservo as hs
from hexservo.cli import assurance, evidence, explore, export, help_option, identify, keys, machine, terminal
from hexservo.cli.print_sections import installed_place
from hexservo.cli.terminal import (
    GAP,
    NOT_SETTLED,
    CameraOption,
    ForceOption,
    RequireSettledOption,
    ScenarioArgument,
    SettingsOption,
    complain,
    ending,
    errors_as_messages,
    exit_as,
    expanded,
    interrupted,
    load,
    load_as_written,
    path_option,
    plain_table,
    refusals,
    show_parts,
    spell_time,
    split,
    watched,
    whisper,
    write,
    write_then_show,
)
from hexservo.scenario.laws import LAWS

if TYPE_CHECKING:
    from rich.console import RenderableType

_ALL = "all"  # laws that the core has for any machine, and those that a scenario has
_WIDTH_FOR_MEANINGS = 72  # in a narrower terminal the table has no meanings of the metrics

app = typer.Typer(
    help="Image-based visual servoing of parallel robots: run scenarios, inspect results.",
    epilog="Exit codes: 0 done, 1 no feasible gains (tune), 2 bad input, 3 a run that ended early (such as "
    "divergence), 4 a run that did not settle (with --require-settled), 130 interrupted.",
    cls=help_option.HelpGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # help and usage errors as plain text: no boxes, and no line breaks in logs
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line with the arguments of the process, and exit."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal may lack a character of a description or path
    app(prog_name="hexservo")


def _print_version(asked: bool) -> None:
    if asked:
        write(f"hexservo {hs.__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
def run(
    scenario: ScenarioArgument,
    out: Annotated[str | None, path_option("Write figures and data there, into a new or empty folder.")] = None,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    force: ForceOption = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print no table and no warnings.")] = False,
    require_settled: RequireSettledOption = False,
) -> None:
    """Simulate a scenario and report on it.

    The results are printed as a table; --out writes figures and data too. The warnings of `hexservo check` follow on
    standard error.
    """
    with errors_as_messages():
        from hexservo.cli.output import write_results
        from hexservo.run.files import check_folder, has_results
        from hexservo.run.metrics import unsettled

        chosen = load(scenario, settings or [], camera)
        if out is not None:
            check_folder(out, force=force)
        started = time.perf_counter()
        with refusals(chosen.name):
            result = hs.simulate(chosen)
        elapsed = time.perf_counter() - started
        kept = out is not None and result.outcome == "interrupted" and has_results(out)

        def show(written: str | None) -> None:
            if not quiet:
                show_parts(*_report(result, elapsed, written, hint=out is None))

        write_then_show(None if kept else out, lambda folder: write_results(result, folder, force=force), show)
        if not quiet and result.outcome != "interrupted":
            from hexservo.findings.check import unlikely

            complain(*unlikely(chosen), head="Warning")
        exit_as(result, _kept(out) if kept else "")
        if require_settled and math.isnan(hs.metrics(result)["settling_time"]):
            complain(f"{chosen.name}: {unsettled(hs.metrics(result), chosen.metrics)}", head="Not settled")
            raise typer.Exit(NOT_SETTLED)


@app.command()
def compare(
    scenarios: Annotated[
        str,
        typer.Option(
            "--scenarios",
            metavar="NAMES",
            help='Packaged scenarios or paths of YAML files, with commas between; "task-*" matches all such names.',
        ),
    ],
    laws: Annotated[
        str,
        typer.Option(
            "--laws",
            metavar="NAMES",
            help='Laws, with commas between; "all": those of any machine, and tracking where a scenario has it.',
        ),
    ] = _ALL,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    out: Annotated[str | None, path_option("Write tables and a page of plots there.")] = None,
    force: ForceOption = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print no table.")] = False,
    require_settled: RequireSettledOption = False,
) -> None:
    """Run several laws on several scenarios and compare them.

    Only the law of a scenario is replaced; a law of which no gain is written takes over its auto.bandwidth. The table
    lists verdict, settling time, residual and cost of each run; --out writes it as Markdown and CSV too, with a page
    of plots.
    """
    with errors_as_messages():
        from hexservo.run.files import check_folder, has_results

        names, chosen_laws = expanded(scenarios), None if laws == _ALL else split(laws)
        try:
            chosen = [load(name, settings or [], camera, one_of_several=len(names) > 1) for name in names]
            if out is not None:
                check_folder(out, force=force)
            started = time.perf_counter()
            with refusals():  # of the choice, as an unknown law
                comparison = hs.compare(chosen, chosen_laws, progress=watched())
        except KeyboardInterrupt:  # before the first run
            interrupted(f"0 of {len(names) * len(chosen_laws or LAWS)} runs were finished")
        elapsed = time.perf_counter() - started
        kept = out is not None and comparison.interrupted and has_results(out)

        def show(written: str | None) -> None:
            if not quiet:
                show_parts(*_comparison_report(comparison, elapsed, written, hint=out is None))

        write_then_show(None if kept else out, lambda folder: comparison.write(folder, force=force), show)
        if comparison.interrupted:
            finished = f"{comparison.finished} of {len(comparison.rows)} runs were finished"
            interrupted(f"{finished}{_kept(out) if kept else ''}")
        unsettled = sum(not row.settled for row in comparison.rows)
        if require_settled and unsettled:
            complain(f"{unsettled} of {len(comparison.rows)} runs", head="Not settled")
            raise typer.Exit(NOT_SETTLED)


for command in (
    evidence.report,
    evidence.certify,
    evidence.analyse,
    evidence.diagnose,
    identify.identify,
    assurance.campaign,
    assurance.tune,
    explore.explore,
    keys.schema,
    machine.new,
    export.export,
):
    app.command()(command)


@app.command()
def scenarios() -> None:
    """List the packaged scenarios."""
    with errors_as_messages():
        from rich.table import Table

        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True, style="bold")
        table.add_column(overflow="fold")
        for name in hs.scenario_names():
            table.add_row(name, hs.load_scenario(name).description)
        show_parts(table)


@app.command()
def show(
    scenario: ScenarioArgument,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    flat: Annotated[
        bool, typer.Option("--flat", help="Print a line `key value` for each key of the core, for the C interface.")
    ] = False,
) -> None:
    """Print a scenario as YAML.

    All defaults are included, so that the output is a good start for a custom scenario. A tag, a grid and a goal pose
    are comments at its head: by then they are points and an image, which do not follow other keys.
    """
    with errors_as_messages():
        from hexservo.scenario.flat import flat_text
        from hexservo.scenario.yaml import dump_yaml

        chosen, replaced = load_as_written(scenario, settings or [], camera)
        text = chosen.to_yaml()
        if replaced:
            lines = dump_yaml(replaced).splitlines()
            head = "Read into the points and features below, which do not follow camera, home and pose any more; was:"
            text = "".join(f"# {line}\n" for line in (head, *lines)) + text
        write(flat_text(chosen) if flat else text, encoding="utf-8")  # what a scenario is read with


@app.command()
def check(
    scenario: ScenarioArgument,
    settings: SettingsOption = None,
    camera: CameraOption = None,
) -> None:
    """Check a scenario.

    Every error is a line on standard error, and the exit code is 2; without errors it is 0. Warnings are about legal
    but probably unintended settings, such as a weight beyond the force limit; notes list keys without effect, state
    what one image and the prior of a law leave of the pose, and name a brake that is unstable or needs more than the
    legs have.
    """
    with errors_as_messages():
        from hexservo.findings.check import notes, unlikely

        chosen = load(scenario, settings or [], camera)
        complain(*unlikely(chosen), head="Warning")
        complain(*notes(chosen), head="Note")
        simulation = chosen.simulation
        name = "standard input" if scenario == "-" else scenario
        write(
            f'{name}: valid (scenario "{chosen.name}", {simulation.duration:.6g} s in steps of '
            f"{simulation.step * 1e3:.6g} ms)\n"
        )


@app.command()
def bench(
    out: Annotated[str | None, path_option("Write bench.json and a picture there.")] = None,
    force: ForceOption = False,
    quick: Annotated[bool, typer.Option("--quick", help="A rougher measurement, in less than 15 s.")] = False,
    ticks: Annotated[
        int | None,
        typer.Option("--ticks", min=1000, max=100_000_000, help="Free-running ticks.  [default: 1000000]"),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.01, max=86400.0, help="Of ticks at every rate.  [default: 3]")
    ] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Request SCHED_FIFO and locked memory; the table lists what was granted.")
    ] = False,
) -> None:
    """Measure the speed of this machine.

    Measures the latency of the servo tick, free-running and paced by a clock, the rates of single runs and batches for
    each variant and number of threads, and the peak rate of the vector units. Results are checked.
    """
    with errors_as_messages():
        from dataclasses import replace

        from hexservo.cli.bench import report, write_benchmark
        from hexservo.run.bench import QUICK, Plan, benchmark
        from hexservo.run.files import check_folder, write_folder

        plan = replace(QUICK if quick else Plan(), realtime=realtime)
        plan = replace(plan, ticks=ticks or plan.ticks, seconds=seconds or plan.seconds)
        if out is not None:
            check_folder(out, force=force)
        result = benchmark(plan, whisper)
        write_then_show(
            out,
            lambda named: write_folder(
                named, lambda folder: write_benchmark(result, folder), "a benchmark", force=force
            ),
            lambda _: show_parts(*report(result)),
        )
        if out is not None:
            write(f"bench.json, bench.png and bench.svg are in {out}\n")


@app.command()
def version() -> None:
    """Print version, compiler and compiled variants."""
    with errors_as_messages():
        from hexservo.run.machine import versions

        write("".join(f"{name + ':':<11}{value}\n" for name, value in versions().items()))


def _kept(folder: str | None) -> str:
    return f"; the earlier results in {folder} are kept"


# ---- Output ---------------------------------------------------------------------------------------------------------


def _report(result: hs.Result, elapsed: float, folder: str | None, *, hint: bool) -> Iterator[RenderableType]:
    """Print the outcome of a run, its metrics, what they do not show, exceeded limits, and the place of its files."""
    from rich.text import Text

    from hexservo.run.summary import (
        goal_distance_sentence,
        image_sentences,
        singular_passage_sentence,
        without_image,
    )

    name = result.scenario.name
    if result.outcome == "completed":
        yield Text.assemble((name, "bold"), f": completed, {result.end_time:.6g} s simulated in {spell_time(elapsed)}")
    else:
        yield Text(f"{name}: {ending(result)} (simulated in {spell_time(elapsed)})", style="bold red")
    yield _metrics_table(result)
    if (unseen := without_image(result)) is not None:
        yield Text(unseen, style="yellow")
    for sentence in image_sentences(result):
        yield Text(sentence, style="yellow")
    if (far := goal_distance_sentence(result, if_hidden=True)) is not None:
        yield Text(far, style="yellow")
    if before := [event for event in result.events if event is not result.stop_event]:  # which the first line has
        yield Text("\n".join(f"limit exceeded: {event}" for event in before), style="yellow")
    if (passage := singular_passage_sentence(result)) is not None:
        yield Text(passage, style="yellow")
    if folder is not None:
        yield Text(f"figures, result.nc, metrics.json and scenario.yaml are in {folder}")
    elif hint:
        yield Text("no files written; --out FOLDER writes figures and data", style="dim")


def _metrics_table(result: hs.Result) -> RenderableType:
    from hexservo.run.metrics import metric_meaning, metric_name, readable, shown_metrics

    robot = result.scenario.robot
    with_meanings = terminal.width() >= _WIDTH_FOR_MEANINGS
    table = plain_table(show_header=False)
    table.add_column(overflow="fold")
    table.add_column(justify="right", overflow="fold", style="bold")
    table.add_column(overflow="fold")
    if with_meanings:
        table.add_column(overflow="fold", style="dim")
    for name, value in shown_metrics(result).items():
        meaning = [metric_meaning(name, robot)] if with_meanings else []
        table.add_row(metric_name(name, robot), *readable(name, value, robot), *meaning)
    return table


def _comparison_report(
    comparison: hs.Comparison, elapsed: float, folder: str | None, *, hint: bool
) -> Iterator[RenderableType]:
    """Return the table, in parts if the terminal is too narrow, the reasons, and the place of the files."""
    from rich.text import Text

    for table in _comparison_tables(comparison):
        yield table
        yield Text("")
    for row in comparison.rows:
        if not row.settled or row.passed_limits:
            yield Text(f"{row.scenario.name}, {row.law}: {row.verdict}: {row.why}", style="yellow")
    for sentence in comparison.remarks:
        yield Text(sentence)
    runs = f"{len(comparison.rows)} runs" if len(comparison.rows) > 1 else "1 run"
    if comparison.interrupted:
        runs = f"{comparison.finished} of {runs}"
    explained = f"columns are explained in {installed_place('docs/compare.md')}"
    yield Text(f"{runs} in {spell_time(elapsed)}; {explained}", style="dim")
    if folder is not None:
        yield Text(f"comparison.md, .csv, .svg, .png and the scenarios are in {folder}")
    elif hint:
        yield Text("no files written; --out FOLDER writes tables and plots", style="dim")


def _comparison_tables(comparison: hs.Comparison) -> Iterator[RenderableType]:
    """Return as many tables as the columns need, or a list if not even one column fits."""
    from hexservo.run.comparison import COLUMNS, column_texts

    labels = [("scenario", "law", "verdict"), *((row.scenario.name, row.law, row.verdict) for row in comparison.rows)]
    left = [max(map(len, texts)) + GAP for texts in zip(*labels, strict=True)]
    columns = []
    for column in COLUMNS:
        unit, texts = column_texts(comparison.rows, column)
        columns.append([column.head(comparison.rows), f"[{unit}]" if unit else "", *texts])
    parts: list[list[list[str]]] = []
    room = -1
    for cells in columns:
        needs = max(map(len, cells)) + GAP
        if needs > room:
            parts.append([])
            room = terminal.width() + GAP - sum(left if len(parts) == 1 else left[:2])  # the verdict only once
        if needs > room:
            yield _comparison_list(comparison)
            return
        parts[-1].append(cells)
        room -= needs
    for place, chosen in enumerate(parts):
        yield _comparison_table(comparison, chosen, verdict=place == 0)


def _comparison_table(comparison: hs.Comparison, columns: list[list[str]], *, verdict: bool) -> RenderableType:
    """Return a table of columns, each of its head, its unit and a text for each row."""
    from rich.text import Text

    table = plain_table(header_style="bold")
    for head in ("scenario", "law", *(["verdict"] if verdict else [])):
        table.add_column(head, no_wrap=True)
    for head, unit, *_ in columns:
        table.add_column(f"{head}\n{unit}", justify="right", no_wrap=True)
    before = None
    for place, row in enumerate(comparison.rows, start=2):
        name = "" if row.scenario.name == before else row.scenario.name
        before = row.scenario.name
        style = "green" if row.settled else "bold red"
        judged = [Text(row.verdict, style=style)] if verdict else []
        table.add_row(name, row.law, *judged, *(cells[place] for cells in columns))
    return table


def _comparison_list(comparison: hs.Comparison) -> RenderableType:
    from rich.text import Text

    from hexservo.run.comparison import COLUMNS, column_texts

    lines = []
    columns = [column_texts(comparison.rows, column, with_units=True)[1] for column in COLUMNS]
    for row, *texts in zip(comparison.rows, *columns, strict=True):
        lines.append(f"{row.scenario.name}, {row.law}: {row.verdict}")
        lines += [f"  {column.head([row])}: {text}" for column, text in zip(COLUMNS, texts, strict=True)]
    return Text("\n".join(lines))


for _registered in app.registered_commands:  # all that are above
    _registered.cls = help_option.HelpCommand
