"""``hexservo identify``: from the log of a machine to its scenario."""

from __future__ import annotations

from typing import Annotated

import typer

from hexservo.cli.evidence import STANDARD_OUTPUT, ForceOption, JsonOption, check_json, identified, write_json
from hexservo.cli.terminal import (
    CameraOption,
    SettingsOption,
    errors_as_messages,
    no_dash,
    path_option,
    show_parts,
    write,
)

_TITLE = "# A scenario by `hexservo identify`"


def identify(
    log: Annotated[
        str,
        typer.Argument(
            metavar="LOG", callback=no_dash, help="CSV or MCAP: time, commanded and measured joints, features."
        ),
    ],
    machine: Annotated[
        str, typer.Option("--machine", "-m", metavar="SCENARIO", help="The machine: name or path of a scenario.")
    ],
    out: Annotated[str | None, path_option("Write the scenario there.", "FILE")] = None,
    motors: Annotated[
        bool, typer.Option("--motors", help="Also fit stiffness, damping, friction and armature of the motors.")
    ] = False,
    settings: SettingsOption = None,
    camera: CameraOption = None,
    json: JsonOption = None,
    force: ForceOption = False,
) -> None:
    """Find a machine's drives and camera from a log.

    The machine takes positions. Bandwidth, damping, delay and limits of each leg and the latency of the camera have
    95 % intervals. With --motors the six legs couple through the platform, whose mass the machine gives. `hexservo
    diagnose LOG --machine SCENARIO` goes on with the model that is found.
    """
    with errors_as_messages():
        from hexservo.cli.print_sections import printed
        from hexservo.run.files import check_file, write_file

        if out is not None:
            check_file(out, _TITLE, "`hexservo identify`", force=force)
        if json is not None:
            check_json("identify", json, force)
        found = identified(log, machine, settings, camera, motors=motors)
        if out is not None:
            write_file(f"{_TITLE}\n{found.scenario.to_yaml()}", out, _TITLE, "`hexservo identify`", force=force)
        if json is not None:
            write_json("identify", found.to_dict(), json, force)
        if json == STANDARD_OUTPUT:
            return
        show_parts(*printed(found.sections()))
        if out is not None:
            write(f"\n{out} is written.\n")
