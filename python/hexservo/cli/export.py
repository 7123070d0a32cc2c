"""The command ``hexservo export``: scenarios for other programs."""

from __future__ import annotations

from typing import Annotated

import typer

import hexservo as hs
from hexservo.cli.terminal import (
    CameraOption,
    ScenarioArgument,
    SettingsOption,
    errors_as_messages,
    load,
    path_option,
    refusals,
    write,
)

_AUTHOR = "hexservo export"


def export(
    scenario: ScenarioArgument,
    header: Annotated[
        str | None, path_option("C++ header with the gains to write, a new file.", "FILE", ("--header",))
    ] = None,
    mjcf: Annotated[
        str | None, path_option("MuJoCo model of the machine to write, a new file.", "FILE", ("--mjcf",))
    ] = None,
    fmu: Annotated[
        str | None, path_option("Unit for co-simulation (FMI) to write, a new file.", "FILE", ("--fmu",))
    ] = None,
    fmi: Annotated[
        int | None, typer.Option("--fmi", min=2, max=3, help="With --fmu: version of the standard.  [default: 2]")
    ] = None,
    what: Annotated[
        str | None, typer.Option("--what", help="With --fmu: loop, plant or controller.  [default: loop]")
    ] = None,
    period: Annotated[
        float | None,
        typer.Option(
            "--period",
            help="With --header: time between two ticks of the controller [s].  "
            "[default: simulation.step of the scenario]",
        ),
    ] = None,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    force: Annotated[bool, typer.Option("--force", "-f", help="Replace the file of an earlier export.")] = False,
) -> None:
    """Write gains as a C++ header, or the machine for MuJoCo or FMI.

    A robot's control program includes the header, calls its controller_gains() once and hexservo::step every period.
    """
    with errors_as_messages():
        files = {"--header": header, "--mjcf": mjcf, "--fmu": fmu}
        given = [name for name, value in files.items() if value is not None]
        if len(given) != 1:
            listed = " and ".join(given) or "none of them"
            raise hs.ScenarioError([f"expected one of {', '.join(files)}, got {listed}"], _AUTHOR)
        for option, value, owner in (
            ("--period", period, "--header"),
            ("--fmi", fmi, "--fmu"),
            ("--what", what, "--fmu"),
        ):
            if value is not None and owner not in given:
                raise hs.ScenarioError([f"expected it with {owner} alone, got {given[0]}"], option)
        chosen = load(scenario, settings or [], camera)
        if header is not None:
            write(_header(chosen, header, period, force))
        elif mjcf is not None:
            write(_mjcf(chosen, mjcf, force))
        else:
            write(_fmu(chosen, str(fmu), fmi or 2, what or "loop", force))


def _header(scenario: hs.Scenario, file: str, period: float | None, force: bool) -> str:
    from hexservo.run.export import TITLE, gains_header
    from hexservo.run.files import write_file

    with refusals():
        text = gains_header(scenario, period)
    write_file(text, file, TITLE, _AUTHOR, force=force)
    ticks = scenario.simulation.step if period is None else period
    first = f'{file}: gains of the scenario "{scenario.name}" for a period of {ticks * 1e3:.6g} ms\n'
    return first + _notes(scenario, ticks)


def _notes(scenario: hs.Scenario, period: float) -> str:
    """Return the lines of what is to be known before a robot moves by the controller, with ticks of a period [s]."""
    from hexservo.findings.check_export import robot_notes

    return "".join(f"Note: {note}.\n" for note in robot_notes(scenario, period))


def _mjcf(scenario: hs.Scenario, file: str, force: bool) -> str:
    from hexservo.bridges.mujoco_model import TITLE, hold_notes, keyframe_notes, mjcf, not_in_model
    from hexservo.run.files import write_file

    with refusals():
        text = mjcf(scenario)
    write_file(text, file, TITLE, _AUTHOR, force=force)
    missing = not_in_model(scenario)
    first = f'{file}: machine, camera and target of the scenario "{scenario.name}" for MuJoCo\n'
    notes = [f"not in the model: {', '.join(missing)}"] if missing else []
    notes += [*hold_notes(scenario), *keyframe_notes(scenario)]
    return first + "".join(f"Note: {note}.\n" for note in notes)


def _fmu(scenario: hs.Scenario, file: str, fmi: int, what: str, force: bool) -> str:
    from hexservo.bridges.fmi import fmu, is_unit
    from hexservo.run.files import write_file

    with refusals(of=(ValueError, FileNotFoundError)):
        content = fmu(scenario, fmi=fmi, what=what)  # type: ignore[arg-type]
    write_file(content, file, is_unit, _AUTHOR, force=force)
    first = f'{file}: {what} of the scenario "{scenario.name}" as a unit of FMI {fmi}.0\n'
    return first + (_notes(scenario, scenario.simulation.step) if what == "controller" else "")
