"""The report of a run as one self-contained HTML file."""

from __future__ import annotations

import os
from pathlib import PurePath
from typing import TYPE_CHECKING

from hexservo.report.html import TITLE
from hexservo.run.files import check_file, write_file
from hexservo.run.publish import OutputError
from hexservo.run.sealed import shown_path

if TYPE_CHECKING:
    from hexservo.run.result import Result

__all__ = ["check_report", "write_report"]

_AUTHOR = "`hexservo report`"
_ENDINGS = ("", ".html", ".htm")


def write_report(result: Result, path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write the report of a run as one self-contained HTML file (docs/report.md).

    Includes certificate, analysis and diagnosis. The same result gives the same bytes.

    Parameters
    ----------
    result
        The run; its outcome does not matter.
    path
        A name in an existing folder. The file is written completely or not at all.
    force
        Replace an earlier report; other files are never replaced.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, also during a simulation.
    TypeError
        For anything but a `Result`.
    ValueError
        Where the data are not those of a run (see `Result.save`).
    OutputError
        The file exists, is not a report, or cannot be written; its name has an ending other than .html and .htm.
    """
    from hexservo.report.page import page
    from hexservo.run.result import require_run

    require_run(result)
    check_report(path, force=force)  # before the work
    write_file(page(result), path, TITLE, _AUTHOR, force=force)


def check_report(path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Refuse a place that `write_report` would refuse, before a long run rather than after it.

    Raises
    ------
    OutputError
        As `write_report`, as far as it can be checked without writing.
    """
    check_file(path, TITLE, _AUTHOR, force=force)
    ending = PurePath(os.fsdecode(path)).suffix
    if ending.lower() not in _ENDINGS:
        raise OutputError(f"{shown_path(path)}: expected a name ending in .html, since a report is HTML, got {ending}")
