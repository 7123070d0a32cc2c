"""Commands about evidence: ``hexservo report | certify | analyse | diagnose | check``."""

from __future__ import annotations

import contextlib
import shlex
import time
from pathlib import Path
from typing import Annotated, Any

import typer

import hexservo as hs
from hexservo.cli.terminal import (
    BAD_INPUT,
    CameraOption,
    ScenarioArgument,
    SettingsOption,
    complain,
    errors_as_messages,
    exit_as,
    interrupted,
    load,
    path_option,
    refusals,
    show_parts,
    spell_time,
    watched,
    write,
)

STANDARD_OUTPUT = "-"  # in place of a file
_LOGS = (".csv", ".mcap")  # ends of their names
_RUN = "Name of a packaged scenario, path of a YAML file, path of a result.nc that `run --out` wrote"
_RunArgument = Annotated[
    str, typer.Argument(metavar="SCENARIO_OR_RESULT", help=f'{_RUN}, or "-" for a scenario on standard input.')
]
_RunOrLogArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO_OR_RESULT",
        help=f'{_RUN}, a log (CSV or MCAP, with --machine), or "-" for a scenario on standard input.',
    ),
]
JsonOption = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help='Write all numbers there as JSON; "-" writes them to standard output, in place of the text.',
    ),
]
ForceOption = Annotated[bool, typer.Option("--force", "-f", help="Replace a file that this command wrote earlier.")]


def report(
    run: _RunArgument,
    out: Annotated[str, path_option("HTML file to write, a new one.", "FILE")],
    settings: SettingsOption = None,
    camera: CameraOption = None,
    force: ForceOption = False,
) -> None:
    """Write a report of a run as one HTML file.

    It has a summary, the paper's figures, a view in space, certificate, analysis, diagnosis, metrics and
    the scenario, and opens in a browser without a network.
    """
    with errors_as_messages():
        from hexservo.report import check_report, write_report

        check_report(out, force=force)
        started = time.perf_counter()
        result = _result(run, settings or [], camera)
        write_report(result, out, force=force)
        write(f"{out}: report of {result.scenario.name}, made in {spell_time(time.perf_counter() - started)}\n")
        exit_as(result)


def certify(
    run: _RunArgument,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    json: JsonOption = None,
    force: ForceOption = False,
) -> None:
    """Check the theorem's assumptions along a run.

    This is a numerical check, not a proof.
    """
    _judge("certify", run, settings, camera, json, force)


def analyse(
    run: _RunArgument,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    json: JsonOption = None,
    force: ForceOption = False,
) -> None:
    """Analyse geometry, gains and timing of a scenario.

    Only short runs are simulated, to check results.
    """
    _judge("analyse", run, settings, camera, json, force)


def diagnose(
    run: _RunOrLogArgument,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    json: JsonOption = None,
    force: ForceOption = False,
    machine: Annotated[
        str | None,
        typer.Option("--machine", "-m", metavar="SCENARIO", help="The file is a log: diagnose its machine's model."),
    ] = None,
) -> None:
    """Find the cause of a failed run.

    The most likely cause comes first, with its evidence and a remedy.
    """
    _judge("diagnose", run, settings, camera, json, force, machine)


def check(
    scenario: ScenarioArgument,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    json: JsonOption = None,
    force: ForceOption = False,
    strict: Annotated[bool, typer.Option("--strict", help="Warnings are errors: exit code 2.")] = False,
) -> None:
    """Check a scenario.

    Every error is a line on standard error, and the exit code is 2; without errors it is 0. Warnings are about legal
    but probably unintended settings, such as a weight beyond the force limit; notes list keys without effect, state
    what one image and the prior of a law leave of the pose, and name a brake that is unstable or needs more than the
    legs have.
    The scenario is run as well, unless it has more than 200 000 steps: a run that ends early, does not settle, or
    exceeds limits of the legs is a warning. One with noise is run with up to 58 other seeds too.
    """
    with errors_as_messages():
        if json is not None:
            check_json("check", json, force)
        chosen = load(scenario, settings or [], camera)
        with refusals(chosen.name):
            found = hs.check(chosen)
        if json is not None:
            write_json("check", found.to_dict(), json, force)
        if json != STANDARD_OUTPUT:
            complain(*found.warnings, head="Warning")
            complain(*found.notes, head="Note")
            simulation = chosen.simulation
            name = "standard input" if scenario == "-" else scenario
            settled = found.settled and f"; its run is {found.settled}"
            unrun = found.unrun and f"; {found.unrun}"
            write(
                f'{name}: valid (scenario "{chosen.name}", {simulation.duration:.6g} s in steps of '
                f"{simulation.step * 1e3:.6g} ms){settled}{unrun}\n"
            )
        if strict and found.warnings:
            raise typer.Exit(BAD_INPUT)


def _judge(
    name: str,
    run: str,
    settings: list[str] | None,
    camera: str | None,
    json: str | None,
    force: bool,
    machine: str | None = None,
) -> None:
    with errors_as_messages():
        from hexservo.cli.print_sections import printed
        from hexservo.findings.sections import SOURCES

        source = SOURCES[name]
        if json is not None:
            check_json(name, json, force)
        if machine is not None:
            model = identified(run, machine, settings, camera)
            for section in model.doubtful:
                complain(*section.sentences, head=section.title)
            of: Any = _run(model.as_logged)
        else:
            read = _scenario if source.of_scenario else _result
            of = read(run, settings or [], camera)
        with refusals():  # for a run or scenario to which it does not apply
            found = source.find(of)
        if machine is not None:
            from hexservo.findings.identification.log_diagnosis import LogDiagnosis

            found = LogDiagnosis(model, found)
        if json is not None:
            write_json(name, found.to_dict(), json, force)
        if json != STANDARD_OUTPUT:
            show_parts(*printed(found.sections()))
        if isinstance(of, hs.Result):
            exit_as(of)


# ---- Input ----------------------------------------------------------------------------------------------------------


def _result(run: str, settings: list[str], camera: str | None) -> hs.Result:
    """Read a saved result, or run a scenario; a run interrupted with Ctrl-C is not evaluated."""
    if _is_saved(run, settings, camera):
        return hs.load_result(run)
    return _run(_loaded(run, settings, camera))


def _run(scenario: hs.Scenario) -> hs.Result:
    from hexservo.run.simulation import uninterrupted

    with refusals(scenario.name):
        return uninterrupted(_simulated(scenario))


def _simulated(scenario: hs.Scenario) -> hs.Result:
    with contextlib.suppress(ValueError):  # the log would not fit, or else the next line raises it again
        return hs.simulate(scenario, log_weights=True)
    return hs.simulate(scenario)


def _scenario(run: str, settings: list[str], camera: str | None) -> hs.Scenario:
    return hs.load_result(run).scenario if _is_saved(run, settings, camera) else _loaded(run, settings, camera)


def _loaded(run: str, settings: list[str], camera: str | None) -> hs.Scenario:
    """Load a scenario; a log needs its machine, and a folder may have a saved result too."""
    if run.endswith(_LOGS) and Path(run).is_file():
        command = f"hexservo diagnose {shlex.quote(run)} --machine SCENARIO"
        raise hs.ScenarioError([f"this is a log; name its machine: {command}"], run)
    if not settings and camera is None and run not in hs.scenario_names() and Path(run).is_dir():
        from hexservo.scenario.reading import RESULT_OF_RUN, SCENARIO_OF_RUN, of_folder

        raise hs.ScenarioError([f"cannot be read: {of_folder(run, [SCENARIO_OF_RUN, RESULT_OF_RUN])}"], run)
    return load(run, settings, camera)


def _is_saved(run: str, settings: list[str], camera: str | None) -> bool:
    saved = run.endswith(".nc") and run not in hs.scenario_names()
    if saved and (settings or camera is not None):
        option = "--set" if settings else "--camera"
        raise hs.ScenarioError(["expected a scenario, got a saved result, which cannot be changed"], option)
    return saved


def identified(
    log: str, machine: str, settings: list[str] | None, camera: str | None, *, motors: bool = False
) -> hs.Identification:
    """Identify a log with a bar on a terminal; Ctrl-C ends the command."""
    try:
        return hs.identify(log, load(machine, settings or [], camera), motors=motors, progress=watched())
    except KeyboardInterrupt:
        interrupted("nothing was written")


# ---- JSON -----------------------------------------------------------------------------------------------------------


def _title(name: str) -> str:
    """Return the first line of a file of numbers, which identifies the file and is valid JSON."""
    return f'{{"hexservo {name}": 1,'


def check_json(name: str, file: str, force: bool) -> None:
    """Refuse a file that `write_json` would not replace."""
    from hexservo.run.files import check_file

    if file == STANDARD_OUTPUT:
        return
    check_file(file, _title(name), f"`hexservo {name}`", force=force)


def write_json(name: str, numbers: dict[str, Any], file: str, force: bool) -> None:
    """Write the numbers of a command as JSON, a file whole or not at all."""
    from json import dumps

    from hexservo.run.files import write_file

    content = {"version": hs.__version__, **numbers}
    rest = dumps(content, indent=2, ensure_ascii=False, allow_nan=False).removeprefix("{\n")
    text = f"{_title(name)}\n{rest}\n"
    if file == STANDARD_OUTPUT:
        write(text, encoding="utf-8")
    else:
        write_file(text, file, _title(name), f"`hexservo {name}`", force=force)
