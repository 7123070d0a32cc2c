"""The explorer: one page that runs scenarios in a browser, with the core compiled to WebAssembly."""

from __future__ import annotations

import json
import os
from importlib import resources

from hexservo.run.files import write_file
from hexservo.scenario.flat import core_values
from hexservo.scenario.scenario import Scenario, scenario_names

__all__ = ["ExplorerError", "explorer_page", "write_explorer"]

_TITLE = "<!doctype html><!-- hexservo explorer, format 1 -->"
_PLACE = '<script type="application/json" id="own">null</script>'


class ExplorerError(RuntimeError):
    """The package has no page: it was not built."""


def explorer_page(scenario: Scenario | str = "paper") -> str:
    """Return the page, which starts with a scenario.

    Parameters
    ----------
    scenario
        A scenario, which becomes one more in the page's list, or the name of a packaged one.

    Raises
    ------
    ExplorerError
        Where the package was installed without the page.
    """
    file = resources.files("hexservo") / "explorer.html"
    if not file.is_file():
        raise ExplorerError(
            "the explorer is not part of this installation: `make explorer` in the source tree builds it "
            "(one HTML file; CONTRIBUTING.md)"
        )
    page = file.read_text(encoding="utf-8")
    own: dict[str, object] = {"start": scenario}
    if isinstance(scenario, Scenario):
        name = scenario.name + (" (file)" if scenario.name in scenario_names() else "")
        preset = {"name": name, "description": scenario.description, "values": core_values(scenario)}
        own = {"start": name, "preset": preset}
    text = json.dumps(own, allow_nan=False).replace("</", "<\\/")
    return page.replace(_PLACE, _PLACE.replace("null", text), 1)


def write_explorer(scenario: Scenario | str, file: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write the page whole, or not at all.

    Parameters
    ----------
    scenario
        As for `explorer_page`; so are the exceptions.
    file
        A name in a folder that exists. A file of that name is kept.
    force
        Replace an earlier explorer, recognised by its first line; other files are never replaced.

    Raises
    ------
    OutputError
        The file exists, is not ours, or cannot be written.
    """
    write_file(explorer_page(scenario), file, _TITLE, "hexservo explore", force=force)
