"""Progress of long work: a bar on standard error, or below the cell of a notebook."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from html import escape
from typing import Protocol, TypeAlias, TypeVar

from hexservo.scenario.wording import wrong_type

T = TypeVar("T")
ProgressCallback: TypeAlias = Callable[[int, int], object]
"""Called with how many are done, and how many there are."""

_REDRAWN = 0.1  # shortest time between two updates of a notebook's cell [s]


class Report(Protocol):
    """Called with what is done and, in parts of 1, how much of the work that is."""

    def __call__(self, done: int, count: int, share: float | None, note: str = "") -> object:
        """Draw it."""


def in_notebook() -> bool:
    """Return whether the code runs in a Jupyter kernel, whose output is a page and no terminal."""
    module = sys.modules.get("IPython")
    shell = None if module is None else module.get_ipython()
    return hasattr(shell, "kernel")


@contextlib.contextmanager
def progress_bar(what: str, *, transient: bool = False) -> Iterator[Report]:
    """Draw a bar while the work runs.

    In a notebook it is HTML that IPython replaces in place: rich's own bar asks for ipywidgets there, with a warning.

    Parameters
    ----------
    what
        Plural of what is counted, such as "runs".
    transient
        Remove the bar at the end.
    """
    with _notebook_bar(what, transient) if in_notebook() else _terminal_bar(what, transient) as report:
        yield report


@contextlib.contextmanager
def reported(
    progress: bool | ProgressCallback | None,
    what: str,
    to_function: Callable[[ProgressCallback], T],
    to_bar: Callable[[Report], T],
    *,
    transient: bool = False,
) -> Iterator[T | None]:
    """Report progress as a user asks for it: True is a bar, a function is called, None is nothing.

    Parameters
    ----------
    what, transient
        As for `progress_bar`.
    to_function, to_bar
        Return what reports to the user's function, and to a bar; None is yielded where nothing is reported.

    Raises
    ------
    TypeError
        For anything else.
    """
    if progress is None or progress is False:
        yield None
    elif callable(progress):
        yield to_function(progress)
    elif progress is True:
        with progress_bar(what, transient=transient) as draw:
            yield to_bar(draw)
    else:
        raise wrong_type("progress", "True, a function or None", progress)


@contextlib.contextmanager
def reporting(
    progress: bool | ProgressCallback | None, what: str, *, transient: bool = False
) -> Iterator[ProgressCallback]:
    """Report how many are done of how many; arguments and errors as for `reported`."""

    def to_bar(draw: Report) -> ProgressCallback:
        return lambda done, count: draw(done, count, done / count)

    with reported(progress, what, lambda function: function, to_bar, transient=transient) as report:
        yield (lambda done, count: None) if report is None else report


@contextlib.contextmanager
def _terminal_bar(what: str, transient: bool) -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    class PlainConsole(Console):
        """Draws the bar in ASCII: its usual characters are missing from many terminals' encodings and fonts."""

        encoding = "ascii"

    columns = (
        TextColumn(f"{{task.fields[done]}} of {{task.fields[count]}} {what}"),
        BarColumn(),
        TextColumn("{task.fields[note]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=PlainConsole(stderr=True, force_jupyter=False), transient=transient) as bar:
        task = bar.add_task(what, total=None, done=0, count="?", note="")

        def report(done: int, count: int, share: float | None, note: str = "") -> None:
            total = None if share is None else 1.0
            bar.update(task, completed=share or 0.0, total=total, done=done, count=count, note=note)

        yield report


@contextlib.contextmanager
def _notebook_bar(what: str, transient: bool) -> Iterator[Report]:
    from IPython.display import HTML, display

    shown = display(HTML(""), display_id=True)
    text, drawn = "", -1.0

    def report(done: int, count: int, share: float | None, note: str = "") -> None:
        nonlocal text, drawn
        value = "" if share is None else f' value="{share:.4f}"'
        text = f"<progress{value}></progress> {escape(f'{done} of {count} {what}')} {escape(note)}"
        if time.monotonic() - drawn >= _REDRAWN:
            drawn = time.monotonic()
            shown.update(HTML(text))

    try:
        yield report
    finally:
        shown.update(HTML("" if transient else text))
