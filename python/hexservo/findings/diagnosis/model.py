"""Parts of a diagnosis: cases, causes, and the changes that remove a cause from a scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from hexservo.findings.diagnosis.criterion import Record
from hexservo.findings.diagnosis.goal import Goal, Obstacle
from hexservo.scenario.keys import value_at
from hexservo.scenario.scenario import Scenario

Changes: TypeAlias = Mapping[str, Any]  # by dotted key, as Scenario.updated takes them
Kind: TypeAlias = Literal["device", "law", "task"]


@dataclass(frozen=True, eq=False)
class Case:
    """A scenario to diagnose, with its goal."""

    scenario: Scenario
    goal: Goal | None  # None: no pose with the goal image was found
    obstacle: Obstacle | None = None  # why no law can reach it; None: no reason was found

    @property
    def sampled(self) -> bool:
        """Whether the devices act."""
        return self.scenario.sampled


@dataclass(frozen=True, eq=False)
class Removal:
    """Changes that remove a cause from a scenario, or are a remedy against it."""

    words: str  # what is changed, as it follows "with"
    changes: Changes
    stroke_counts: bool = True  # whether a leg beyond a limit still is a failure


@dataclass(frozen=True, eq=False)
class Alone:
    """Two scenarios free of other faults, which differ by one cause: the first has to pass, the other one not."""

    without: Changes
    alone: Changes
    stroke_counts: bool = True  # of the first one
    first_decides: bool = False  # whether a first one that fails speaks against the cause; else it proves nothing
    otherwise: bool = False  # whether it counts only where no pair before it proves anything


Removals: TypeAlias = Callable[[Case], list[Removal]]
Remedies: TypeAlias = Callable[[Case, Removal, Record], list[Removal]]


def removal_by(words: str, changes: Changes) -> list[Removal]:
    """Return the removal by some changes; none where nothing is to be changed."""
    return [Removal(words, changes)] if changes else []


def always(case: Case) -> bool:
    """Whether a case has what every scenario has."""
    return True


def _samples(case: Case) -> bool:
    return case.sampled


def removed_by(key: str, none: object, words: str, *, of: Callable[[Case], bool] = _samples) -> Removals:
    """Return what removes a device's fault: its key set to the value that stands for no fault.

    Parameters
    ----------
    of
        Whether a case has that device.
    """

    def removals(case: Case) -> list[Removal]:
        present = of(case) and not np.all(np.asarray(value_at(case.scenario, key)) == none)  # of arrays, every entry
        return removal_by(words, {key: none} if present else {})

    return removals


def fault(key: str, none: object, words: str, of: Callable[[Case], bool] = _samples) -> tuple[frozenset[str], Removals]:
    """Return the key of a fault in one setting, and what removes it (`removed_by`): two fields of its `Cause`."""
    return frozenset({key}), removed_by(key, none, words, of=of)


def same(case: Case, removal: Removal, record: Record) -> list[Removal]:
    """Return the removal itself as the remedy."""
    return [removal]


@dataclass(frozen=True)
class Cause:
    """A cause of failure.

    A device's cause is put alone into the scenario with ideal devices, a law's into the one with ideal devices and
    ordinary settings of the law; a task's is what is left there.
    """

    key: str
    title: str
    keys: frozenset[str]  # keys of a scenario that belong to this cause; "LAW" stands for the law's own block
    removals: Removals  # empty: not present in the scenario
    remedies: Remedies = same  # after the removal that helped most, with its run
    context: frozenset[str] = field(default_factory=frozenset)  # keys on which the effect of these keys depends
    alone: Callable[[Case], list[Alone]] | None = None  # replaces the pairs that follow from kind, keys and context
    kind: Kind = "device"


def in_scenario(keys: Iterable[str], scenario: Scenario) -> list[str]:
    """Return keys of a cause by their dotted names in a scenario, where "LAW" is its law's own block."""
    return [key.replace("LAW", f"controller.{scenario.controller.law}") for key in keys]
