"""Commands of assurance: ``hexservo campaign | tune``."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import hexservo as hs
from hexservo.campaigns.names import campaign_names
from hexservo.cli.print_sections import printed
from hexservo.cli.terminal import (
    SettingsOption,
    changes_of,
    complain,
    errors_as_messages,
    interrupted,
    no_dash,
    path_option,
    refusals,
    show_parts,
    spell_time,
    watched,
)

if TYPE_CHECKING:
    from rich.console import RenderableType

    from hexservo.campaigns.plan import CampaignPlan
    from hexservo.findings.evidence import Section

_LONGEST_COMMAND = 400  # characters that are printed; a longer one has arrays, and the file holds them too
NOT_FEASIBLE = 1
_ThreadsOption = Annotated[
    int | None, typer.Option("--threads", metavar="N", help="Threads to use.  [default: one for each core]")
]
_QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing.")]
_PicturesOption = Annotated[
    bool, typer.Option("--pictures", help="The same, and every picture as SVG and PNG in a folder beside it.")
]
_WORDS_OF_A_FILE = 3  # of a command that names one


def campaign(
    file: Annotated[
        str,
        typer.Argument(
            metavar="CAMPAIGN",
            callback=no_dash,
            help=f"Name of a packaged campaign ({', '.join(campaign_names())}), or path of a YAML file.",
        ),
    ],
    out: Annotated[str, path_option("Keep the runs there: a new folder, or that of the same campaign.")],
    runs: Annotated[
        int | None, typer.Option("--runs", metavar="N", help="Number of runs.  [default: that of the file]")
    ] = None,
    chunk_size: Annotated[
        int | None,
        typer.Option("--chunk-size", metavar="N", help="Runs in a file of the folder.  [default: that of the file]"),
    ] = None,
    threads: _ThreadsOption = None,
    engine: Annotated[
        str, typer.Option("--engine", help="local, dask (a local cluster), or tcp://host:port of a Dask scheduler.")
    ] = "local",
    store_on_workers: Annotated[
        bool,
        typer.Option("--store-on-workers", help="Dask workers write the runs, into the same folder on all machines."),
    ] = False,
    worst: Annotated[
        bool,
        typer.Option("--worst", help="Search the worst case too, when the runs are complete; it is kept as a file."),
    ] = False,
    sensitivity: Annotated[
        bool,
        typer.Option("--sensitivity", help="Compute Sobol indices too: what share of the variance each number causes."),
    ] = False,
    report: Annotated[
        bool, typer.Option("--report", help="Write report.html into the folder too: the verdict with its pictures.")
    ] = False,
    pictures: _PicturesOption = False,
    settings: SettingsOption = None,
    quiet: _QuietOption = False,
) -> None:
    """Bound the probability that a scenario fails.

    Runs many drawn variations of it. The same command goes on after an interruption, and adds runs with a larger
    --runs. It prints the interval of the failure probability, which holds at whatever number of runs one stops, and
    the worst runs.
    """
    with errors_as_messages():
        options = {"runs": "--runs", "chunk_size": "--chunk-size"}
        plan = _plan(file, settings or [], options, runs=runs, chunk_size=chunk_size)
        if worst and not plan.drawing().dimension:  # before the runs, which would take the time
            raise hs.ScenarioError(
                ["expected more that varies than seed, whose noise has no box to search; got seed alone; leave it out"],
                "--worst",
            )
        _require_own_files(Path(out), worst=worst, report=report or pictures, pictures=pictures)
        started = time.perf_counter()
        with refusals():  # of an option, as the number of threads
            result = hs.campaign(
                plan,
                out,
                threads=threads,
                engine=engine,
                store_on_workers=store_on_workers,
                progress=watched() and not quiet,
                warn=_warn,
            )
        if not quiet:
            show_parts(*_report(result, out, time.perf_counter() - started))
        more = []
        if result.interrupted:
            planned = result.plan.runs
            of = "" if planned is None else f" of {planned}"
            kept = len(result) + result.summary["refused"]
            interrupted(f"{kept}{of} runs are kept; the same command goes on")
        if worst:
            with refusals():
                case = hs.worst_case(result, threads=threads)
            more.append(case.section())
            if not quiet:
                command = f"hexservo run {shlex.quote(str(case.path))}"
                if case.command:
                    command += f"\nthe same without the file: {case.command}"
                show_parts("", *printed([case.section()]), f"\nthe worst case found: {command}")
        if sensitivity:
            indices = hs.sensitivity(result.plan, threads=threads).section()
            more.append(indices)
            if not quiet:
                show_parts("", *printed([indices]))
                if indices.items and not (report or pictures):
                    show_parts(f"The same command with --report draws the indices in {out}/report.html.")
        _write_report(result, more, report=report, pictures=pictures, quiet=quiet)


def tune(
    file: Annotated[
        str, typer.Argument(metavar="CAMPAIGN", callback=no_dash, help="Path of a campaign file with the block tune.")
    ],
    out: Annotated[str, path_option("Keep the search there: a new folder, or that of the same search.")],
    generations: Annotated[int, typer.Option("--generations", min=1, metavar="N", help="Of each round.")] = 40,
    rounds: Annotated[
        int, typer.Option("--rounds", min=1, metavar="N", help="At most; worst cases join the variations between them.")
    ] = 6,
    seed: Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Of the search.")] = 0,
    threads: _ThreadsOption = None,
    report: Annotated[
        bool,
        typer.Option("--report", help="Write held-out/report.html too: the held-out campaign, and the search."),
    ] = False,
    pictures: _PicturesOption = False,
    settings: SettingsOption = None,
    quiet: _QuietOption = False,
) -> None:
    """Search gains by their worst run.

    The gains are judged by a campaign on variations that the search never used. The same command goes on after an
    interruption. Exit code 1: no gains were found
    with which the requirements hold; the message names the one that cannot hold with the others.
    """
    with errors_as_messages():
        plan = _plan(file, settings or [], {f"tune.{name}": f"--{name}" for name in ("generations", "rounds", "seed")})
        try:
            with refusals(file):
                found = hs.tune(
                    plan,
                    out,
                    generations=generations,
                    rounds=rounds,
                    seed=seed,
                    threads=threads,
                    progress=watched() and not quiet,
                    warn=_warn,
                )
        except KeyboardInterrupt:
            interrupted("what was simulated is kept; the same command goes on")
        if not quiet:
            show_parts(*printed([found.section()]), "", f"the gains: hexservo run {shlex.quote(str(found.path))}")
        if found.held_out is not None:
            _write_report(found.held_out, found.sections(), report=report, pictures=pictures, quiet=quiet)
        elif (report or pictures) and not quiet:
            complain("no report, which is one of the held-out campaign; tuning.json has the course", head="Warning")
        if not found.feasible:
            raise typer.Exit(NOT_FEASIBLE)


def _require_own_files(folder: Path, *, worst: bool, report: bool, pictures: bool) -> None:
    """Refuse, before the runs, a folder in which what follows them would keep a file that is there."""
    if worst:
        from hexservo.campaigns.worst_case import require_own_case

        require_own_case(folder)
    if report:
        from hexservo.report.campaign_page import require_own_report

        require_own_report(folder, pictures=pictures)


def _plan(file: str, settings: list[str], options: Mapping[str, str], **keys: int | None) -> CampaignPlan:
    """Load a campaign file, its scenario changed by --set; `options` are those that stand for keys of the file."""
    from hexservo.campaigns.plan import CampaignPlan, load_plan
    from hexservo.scenario.blocks import Blocks

    changes = changes_of(settings)
    of_file = CampaignPlan.model_fields.keys() - Blocks.model_fields.keys()
    problems = []
    for key in changes:
        if key.partition(".")[0] in of_file:
            instead = f"use {options[key]}, or edit" if key in options else "edit"
            problems.append(f"{key}: expected a key of the scenario, got one of the campaign; {instead} the file")
    if problems:
        raise hs.ScenarioError(problems, "--set")
    try:
        return load_plan(file, changes, **keys)
    except hs.ScenarioError as error:
        raise hs.ScenarioError(error.problems, error.source or "--set") from None


_warn = partial(complain, head="Warning")


def _write_report(
    result: hs.CampaignResult, more: Sequence[Section], *, report: bool, pictures: bool, quiet: bool
) -> None:
    if report or pictures:
        path = hs.write_campaign_report(result, tuple(more), pictures=pictures)
        if not quiet:
            show_parts(f"report: {path}")


def _report(result: hs.CampaignResult, out: str, elapsed: float) -> Iterator[RenderableType]:
    from rich.text import Text

    from hexservo.campaigns.store import contents

    yield from printed([result.section()])
    if len(result):
        command = result.command(result.worst(1)[0].index)
        short = len(command) <= _LONGEST_COMMAND and len(command.split()) > _WORDS_OF_A_FILE
        yield Text("")
        if not short and result.worst_file is not None:
            command = f"hexservo run {shlex.quote(f'{out}/{result.worst_file.name}')}"
        yield Text(f"the run with the smallest margin: {command}")
    *names, last = contents(result.folder)
    yield Text(f"{', '.join(names)} and {last} are in {out} ({spell_time(elapsed)})", style="dim")
