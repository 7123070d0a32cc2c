"""Sources of findings: the certificate of a run, the analysis of its scenario and its diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hexservo.findings.analysis import analyse
from hexservo.findings.certificate import certify
from hexservo.findings.diagnosis import diagnose

if TYPE_CHECKING:
    from hexservo.findings.evidence import Section
    from hexservo.run.result import Result


@dataclass(frozen=True)
class Source:
    """A function of hexservo that returns findings."""

    name: str  # name of the function
    title: str  # title of its findings
    of_scenario: bool  # it takes the scenario; else the result
    introduction: str  # one sentence: its subject
    find: Callable[[Any], Any]  # the function: it returns an object with ``sections()`` and ``to_dict()``


SOURCES = {
    source.name: source
    for source in (
        Source(
            "certify",
            "Certificate",
            False,
            "Whether this run met the theorem's assumptions: a numerical check.",
            certify,
        ),
        Source(
            "analyse",
            "Analysis",
            True,
            "Limits that follow from geometry, gains and timing, independent of this run.",
            analyse,
        ),
        Source("diagnose", "Diagnosis", False, "Causes of a failed run, the most likely first.", diagnose),
    )
}


@dataclass(frozen=True, eq=False)
class Group:
    """The findings of one source."""

    source: Source
    sections: Sequence[Section]
    refusal: str = ""  # the reason if there are none


def groups(result: Result) -> list[Group]:
    """Return the findings of all sources; for one that does not apply to the run, the reason."""
    return [_group(source, result) for source in SOURCES.values()]


def _group(source: Source, result: Result) -> Group:
    try:
        return Group(source, source.find(result.scenario if source.of_scenario else result).sections())
    except ValueError as error:
        return Group(source, (), " ".join(str(error).split()))
