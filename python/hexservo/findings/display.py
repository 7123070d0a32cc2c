"""Display of findings: their sections as a few lines of text, and as HTML in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexservo.findings.wording import verdict_text
from hexservo.run.display import lines_below
from hexservo.run.drawn import html_of

if TYPE_CHECKING:
    from hexservo.findings.evidence import Section


class Findings:
    """Base of classes with ``section()`` or ``sections()``, from which text and HTML are made."""

    def all_sections(self) -> Sequence[Section]:
        """Return all sections."""
        if hasattr(self, "sections"):
            return self.sections()  # type: ignore[no-any-return]
        return [self.section()]  # type: ignore[attr-defined]

    def headline(self) -> str:
        """Return a line that names the evaluated scenario."""
        result = getattr(self, "result", None)
        scenario = getattr(self, "scenario", None) or getattr(result, "scenario", None)
        return type(self).__name__ + (f' of "{scenario.name}"' if scenario is not None else "")

    def __repr__(self) -> str:
        """Return a line for each section: its title, its verdict and the most important finding."""
        found = self.all_sections()
        lines = [f"{_titled(section)}: {''.join(section.sentences[:1])}" for section in found]
        return lines_below(self.headline(), lines, 2 if len(found) > 1 else 5)

    def _repr_html_(self) -> str:
        """Return sentences, tables and figures for a notebook."""
        return html_of(self)


def _titled(section: Section) -> str:
    verdict = verdict_text(section)
    return f"{section.title} ({verdict})" if verdict else section.title
