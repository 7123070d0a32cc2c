"""The report of a run: one HTML file that needs nothing else."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from hexservo.report.html import TITLE
from hexservo.run.files import check_file, write_file

if TYPE_CHECKING:
    from hexservo.run.result import Result

__all__ = ["check_report", "write_report"]

_AUTHOR = "`hexservo report`"


def write_report(result: Result, path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write the report of a run as one HTML file that loads nothing from elsewhere (docs/report.md).

    Certificate, analysis and diagnosis are worked out on the way. The same result gives the same bytes.

    Parameters
    ----------
    result
        The run; its outcome does not matter.
    path
        A name in a folder that exists. The file appears whole or not at all.
    force
        Replace an earlier report; no other file is ever replaced.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, also while something runs.
    TypeError
        For anything but a `Result`.
    OutputError
        The file exists, is no report, or cannot be written.
    """
    from hexservo.report.page import page
    from hexservo.run.result import Result

    if not isinstance(result, Result):
        raise TypeError(f"result: expected a Result (see hs.simulate), got {type(result).__name__}")
    check_report(path, force=force)  # before the work
    write_file(page(result), path, TITLE, _AUTHOR, force=force)


def check_report(path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Refuse a place that `write_report` would refuse, before a long run rather than after it.

    Raises
    ------
    OutputError
        As `write_report`, as far as it can be told without writing anything.
    """
    check_file(path, TITLE, _AUTHOR, force=force)
