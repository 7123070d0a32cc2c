"""What a diagnosis is made of: cases, causes, and the changes that take a cause out of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from hexservo.findings.diagnosis.criterion import Record
from hexservo.findings.diagnosis.goal import Goal, Obstacle
from hexservo.scenario.scenario import Scenario

__all__ = ["Alone", "Case", "Cause", "Removal", "same"]

Changes: TypeAlias = Mapping[str, Any]  # by dotted key, as Scenario.updated takes them
Kind: TypeAlias = Literal["device", "law", "task"]


@dataclass(frozen=True, eq=False)
class Case:
    """What is diagnosed: a scenario, and what is known of its goal."""

    scenario: Scenario
    goal: Goal | None  # None: no pose was found that shows the goal
    obstacle: Obstacle | None = None  # why no law can reach it; None: nothing speaks against it

    @property
    def sampled(self) -> bool:
        """Whether the devices act."""
        return self.scenario.simulation.mode == "sampled"


@dataclass(frozen=True, eq=False)
class Removal:
    """Changes that take one cause out of a scenario, or help against it."""

    words: str  # what is changed, as it follows "with"
    changes: Changes
    stroke_counts: bool = True  # whether a leg beyond its stroke still is a failure


@dataclass(frozen=True, eq=False)
class Alone:
    """Two scenarios free of other faults, which differ by one cause: the first has to pass, the other one not."""

    without: Changes
    alone: Changes
    stroke_counts: bool = True  # of the first one


def same(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Offer as a remedy what the removal did."""
    return [removal]


@dataclass(frozen=True)
class Cause:
    """One entry of the list.

    A device's cause is put alone into the scenario with ideal devices, a law's into the one with ideal devices and
    ordinary settings of the law; a task's is what is left there.
    """

    key: str
    title: str
    kind: Kind
    keys: frozenset[str]  # of a scenario, that make up this cause; "LAW" stands for the law's own block
    removals: Callable[[Case], list[Removal]]  # empty: not present in the scenario
    remedies: Callable[[Case, Removal, Record], list[Removal]] = (
        same  # after the removal that helped most, with its run
    )
    context: frozenset[str] = field(default_factory=frozenset)  # keys without which its own would mean something else
    alone: Callable[[Case], list[Alone]] | None = None  # in place of what follows from kind, keys and context
