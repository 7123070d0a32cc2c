"""Writes the paper's figures of a run into a folder."""

from __future__ import annotations

import os
from pathlib import Path

from hexservo.draw.plots import paper_images
from hexservo.run.files import check_folder, write_folder
from hexservo.run.result import Result, require_run


def paper_figures(result: Result, folder: str | os.PathLike[str], *, force: bool = False) -> list[Path]:
    """Write figures 2(a), 2(b), 3, 4 and 5 as SVG and PNG (200 dpi) into a folder, which is created if necessary.

    `leg_limits` is written too for a robot with speed or joint limits, and for a run that exceeded the stroke of a leg
    or ended there. The same run gives the same bytes. Either all
    files are written completely or none is.

    Parameters
    ----------
    result
        The run.
    folder, force
        As for ``hexservo run --out``: a new or empty folder; with `force` one that holds our results, unchanged.

    Returns
    -------
    list of Path
        The files: for each figure the SVG, then the PNG. A run in which no fuzzy systems
        act (another law, a custom controller, ``fuzzy.enabled: false``) has no figure 2(a).

    Raises
    ------
    TypeError
        For anything but a `Result`.
    ValueError
        Where the data are not those of a run (see `Result.save`).
    OutputError
        The folder cannot take the files (a `ValueError`); then nothing is written.
    """
    require_run(result)
    check_folder(folder, force=force)
    images = paper_images(result)

    def fill(draft: Path) -> None:
        for name, content in images.items():
            (draft / name).write_bytes(content)

    target = write_folder(folder, fill, f'the figures of one run of the scenario "{result.scenario.name}"', force=force)
    return [target / name for name in images]
