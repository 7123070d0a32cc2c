"""Base of findings whose numbers are computed in `x.py`, and whose sentences and tables are made in `x_words.py`."""

from __future__ import annotations

from importlib import import_module

from hexservo.findings.display import Findings
from hexservo.findings.evidence import Section


class Part(Findings):
    """Base of findings as numbers. The module of the class imports nothing that makes sentences."""

    def section(self) -> Section:
        """Return the findings as sentences, tables and figures: `section` of the module beside its own, ``x_words``."""
        found: Section = import_module(f"{type(self).__module__}_words").section(self)
        return found
