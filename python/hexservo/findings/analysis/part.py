"""Base of the parts of an analysis: a part is computed in `x.py`, its sentences and tables are made in `x_words.py`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from hexservo.findings.display import Findings
from hexservo.findings.evidence import Section
from hexservo.scenario.scenario import Scenario

__all__ = ["Part", "not_analysed"]


class Part(Findings):
    """Base of a part's numbers. The module of the class imports nothing that makes sentences."""

    def section(self) -> Section:
        """Return the part as sentences, tables and figures: `section` of the module beside its own, ``x_words``."""
        found: Section = import_module(f"{type(self).__module__}_words").section(self)
        return found


def not_analysed(scenario: Scenario, reasons: Mapping[str, str]) -> str:
    """Return why an analysis of poses and laws does not apply; empty if it does.

    Parameters
    ----------
    scenario
        Its law and its camera decide.
    reasons
        By law, of those that are not analysed.
    """
    law = scenario.controller.law
    if law in reasons:
        return f"The law {law} is not analysed here: {reasons[law]}."
    if scenario.camera.convention == "as_printed":
        return "A camera as_printed has no points in space, so no pose belongs to an image: not analysed."
    return ""
