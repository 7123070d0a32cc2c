"""The command ``hexservo explore``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import hexservo as hs
from hexservo.cli.terminal import (
    BAD_INPUT,
    CameraOption,
    ScenarioArgument,
    SettingsOption,
    complain,
    errors_as_messages,
    load,
    path_option,
    write,
)


def explore(
    scenario: ScenarioArgument = "paper",
    settings: SettingsOption = None,
    camera: CameraOption = None,
    out: Annotated[str | None, path_option("Write the page there.  [default: a new temporary file]", "FILE")] = None,
    force: Annotated[bool, typer.Option("--force", "-f", help="Replace the page of an earlier explore.")] = False,
    no_open: Annotated[bool, typer.Option("--no-open", help="Write the page and open no browser.")] = False,
) -> None:
    """Explore a scenario with sliders in a browser.

    The page is one HTML file that runs the core itself; it needs no network and no server.
    """
    with errors_as_messages():
        from hexservo.report.explorer import TITLE, ExplorerError, explorer_page
        from hexservo.run.files import write_file

        packaged = scenario in hs.scenario_names() and not settings and camera is None
        chosen = scenario if packaged else load(scenario, settings or [], camera)
        if out is None:
            import tempfile

            out = str(Path(tempfile.mkdtemp(prefix="hexservo-")) / "explorer.html")
        try:
            write_file(explorer_page(chosen), out, TITLE, "hexservo explore", force=force)
        except ExplorerError as error:
            complain(str(error))
            raise typer.Exit(BAD_INPUT) from None
        write(f"{out}: explorer of {scenario}\n")
        if not no_open:
            import webbrowser

            if not webbrowser.open(Path(out).resolve().as_uri()):
                complain("no browser was found: open the file in one", head="Note")
