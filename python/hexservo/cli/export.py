"""The command ``hexservo export``: scenarios for other programs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

import hexservo as hs
from hexservo.cli.terminal import ScenarioArgument, SettingsOption, errors_as_messages, load, write

__all__ = ["export"]


def export(
    scenario: ScenarioArgument,
    header: Annotated[
        str | None, typer.Option("--header", metavar="FILE", help="C++ header with the gains to write, a new file.")
    ] = None,
    mjcf: Annotated[
        str | None, typer.Option("--mjcf", metavar="FILE", help="MuJoCo model of the machine to write, a new file.")
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
    force: Annotated[bool, typer.Option("--force", "-f", help="Replace the file of an earlier export.")] = False,
) -> None:
    """Write gains as a C++ header, or the machine for MuJoCo.

    A robot's control program includes the header, calls its controller_gains() once and hexservo::step every period.
    """
    with errors_as_messages():
        given = [name for name, value in (("--header", header), ("--mjcf", mjcf)) if value is not None]
        if len(given) != 1:
            raise hs.ScenarioError(
                [f"expected one of --header and --mjcf, got {' and '.join(given) or 'neither'}"], "hexservo export"
            )
        if period is not None and header is None:
            raise hs.ScenarioError(["expected it with --header alone, which has a tick"], "--period")
        chosen = load(scenario, settings or [])
        done = _header(chosen, header, period, force) if header is not None else _mjcf(chosen, str(mjcf), force)
        write(done)


@contextmanager
def _refusals() -> Iterator[None]:
    """Turn what an export refuses into a message."""
    try:
        yield
    except ValueError as error:
        raise hs.ScenarioError(str(error).splitlines()) from error


def _header(scenario: hs.Scenario, file: str, period: float | None, force: bool) -> str:
    from hexservo.run.export import gains_header, write_header

    with _refusals():
        text = gains_header(scenario, period)
    write_header(text, file, force=force)
    ticks = scenario.simulation.step if period is None else period
    return f'{file}: gains of the scenario "{scenario.name}" for a period of {ticks * 1e3:.6g} ms\n'


def _mjcf(scenario: hs.Scenario, file: str, force: bool) -> str:
    from hexservo.bridges.mujoco_model import mjcf, write_mjcf

    with _refusals():
        text = mjcf(scenario)
    write_mjcf(text, file, force=force)
    return f'{file}: machine, camera and target of the scenario "{scenario.name}" for MuJoCo\n'
