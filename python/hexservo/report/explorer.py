"""The explorer: one page that runs scenarios in a browser, with the core compiled to WebAssembly."""

from __future__ import annotations

import hashlib
import json
import re
from importlib import resources
from typing import Any

from hexservo import _core
from hexservo.run.metrics import METRICS, OF_CRANKS
from hexservo.scenario.flat import core_values
from hexservo.scenario.scenario import Scenario, scenario_names
from hexservo.scenario.schema import schema
from hexservo.scenario.version import VERSION
from hexservo.scenario.yaml import ScenarioError

LAWS = tuple(_core.LAW_TRAITS)
TITLE = "<!doctype html><!-- hexservo explorer, format 1 -->"
_BUILT_FOR = re.compile(r'<meta name="hexservo" content="([^"]*)">')
_PLACE = '<script type="application/json" id="own">null</script>'


class ExplorerError(RuntimeError):
    """The package has no page, or that of another version: it has to be built."""


def built_for() -> str:
    """Return what a page is built for: the version, and a digest of the core's keys, the metrics and the scenarios.

    Defaults are left out, since their last digits depend on the processor's library.
    """
    keys = [{name: value for name, value in entry.items() if name != "default"} for entry in schema()]
    digest = hashlib.sha256(json.dumps([keys, METRICS, OF_CRANKS]).encode())
    for name in scenario_names():
        digest.update((resources.files("hexservo") / "scenarios" / f"{name}.yaml").read_bytes())
    return f"{VERSION} {digest.hexdigest()[:16]}"


def checked_page(page: str) -> str:
    """Return a page, or refuse it.

    Raises
    ------
    ExplorerError
        Where it was built for another version, or for other keys, metrics or scenarios.
    """
    found, wanted = _BUILT_FOR.search(page), built_for()
    if found is None or found[1] != wanted:
        raise ExplorerError(
            f"explorer: expected the page of hexservo {wanted}, got that of {found[1] if found else 'an earlier one'}: "
            "`make explorer` in the source tree builds it again"
        )
    return page


def preset_values(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario's values by key as the page takes them: those of its law, and the gains of every other law.

    Other laws have the gains that Python gives them for this scenario's target. Those of a law that the scenario cannot
    have are left out, which the page reads as the defaults.

    Raises
    ------
    ValueError
        As `hexservo.scenario.parameters.core_parameters`, for the scenario's own law.
    """
    values = core_values(scenario)
    for law in LAWS:
        if law == scenario.controller.law:
            continue
        try:
            others = core_values(scenario.updated({"controller.law": law}))
        except ScenarioError:
            continue
        values |= {key: value for key, value in others.items() if key.startswith(f"controller.{law}.")}
    return values


def explorer_page(scenario: Scenario | str = "paper") -> str:
    """Return the page, which starts with a scenario.

    Parameters
    ----------
    scenario
        A scenario, which becomes one more in the page's list, or the name of a packaged one.

    Raises
    ------
    ExplorerError
        Where the package was installed without the page, or with one that `checked_page` refuses.
    """
    file = resources.files("hexservo") / "explorer.html"
    if not file.is_file():
        raise ExplorerError(
            "the explorer is not part of this installation: `make explorer` in the source tree builds it "
            "(one HTML file; CONTRIBUTING.md)"
        )
    page = checked_page(file.read_text(encoding="utf-8"))
    own: dict[str, object] = {"start": scenario}
    if isinstance(scenario, Scenario):
        name = scenario.name + ("-file" if scenario.name in scenario_names() else "")  # a name that a file may have
        preset = {"name": name, "description": scenario.description, "values": preset_values(scenario)}
        own = {"start": name, "preset": preset}
    text = json.dumps(own, allow_nan=False).replace("<", "\\u003c")
    return page.replace(_PLACE, _PLACE.replace("null", text), 1)
