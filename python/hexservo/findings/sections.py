"""Where findings come from: the certificate of a run, the analysis of its scenario and its diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import hexservo as hs

if TYPE_CHECKING:
    from hexservo.findings.evidence import Section

__all__ = ["SOURCES", "Group", "Source", "findings", "groups"]


@dataclass(frozen=True)
class Source:
    """A function of hexservo that has findings."""

    name: str  # of the function
    title: str  # of what it gives
    of_scenario: bool  # it takes the scenario; else the result
    introduction: str  # one sentence: what it answers


SOURCES = {
    source.name: source
    for source in (
        Source("certify", "Certificate", False, "Whether this run met the theorem's assumptions: a numerical check."),
        Source("analyse", "Analysis", True, "What geometry, gains and timing permit, whatever this run did."),
        Source("diagnose", "Diagnosis", False, "What limits or spoils this run, the likeliest cause first."),
    )
}


@dataclass(frozen=True, eq=False)
class Group:
    """The findings of one source."""

    source: Source
    sections: Sequence[Section]
    refusal: str = ""  # why there are none


def findings(source: Source, run: hs.Result | hs.Scenario) -> Any:
    """Give what a source has to say: something with ``sections()`` and ``to_dict()``.

    Raises
    ------
    ValueError
        Of the source: it does not apply to this run or scenario.
    """
    return getattr(hs, source.name)(run)


def groups(result: hs.Result) -> list[Group]:
    """Give the findings of all sources; one that refuses the run says why, and keeps no other away."""
    found = []
    for source in SOURCES.values():
        if not hasattr(hs, source.name):
            continue
        try:
            sections = findings(source, result.scenario if source.of_scenario else result).sections()
        except ValueError as error:
            found.append(Group(source, (), " ".join(str(error).split())))
        else:
            found.append(Group(source, sections))
    return found
