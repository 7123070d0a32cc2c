"""The block ``tune`` of a campaign file: which gains a search varies, over what, and what it makes small."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from hexservo.campaigns.distributions import Variation, variation_of
from hexservo.campaigns.file_keys import tried
from hexservo.campaigns.loop_numbers import LOOP_NUMBERS
from hexservo.campaigns.requirements import Requirement, requirement_of
from hexservo.run.metrics import METRICS
from hexservo.scenario.rules import Integer, Problem, Rule, did_you_mean, refusal, shown_value

__all__ = ["CORNERS", "TunePlan", "Variable"]

CORNERS = "corners"
"""In `over`: every number that varies at both ends of its range."""

_OVER = 32  # variations of a search for gains
_KEYS = ("variables", "minimise", "subject_to", "over")
_MOST_OVER = 10_000


@dataclass(frozen=True)
class Variable:
    """A gain that a search chooses."""

    variation: Variation  # its range: `uniform` or `log`
    groups: tuple[int, ...]  # how many entries share a number, group by group; (0,): the key takes one number

    def to_plain(self) -> dict[str, Any]:
        """Return what a campaign file writes for it."""
        groups = {} if self.groups == (0,) else {"groups": list(self.groups)}
        return {**self.variation.to_plain(), **groups}


@dataclass(frozen=True)
class TunePlan:
    """What a search for gains varies, and what it makes small."""

    variables: Mapping[str, Variable]
    minimise: tuple[str, ...]  # of hs.METRICS, of each the largest value over the variations; none: the margin
    subject_to: tuple[Requirement, ...]  # of LOOP_NUMBERS, of the scenario with the gains
    over: int  # variations that are drawn, as the first runs of the campaign are
    corners: bool  # whether the corners of what varies are among the variations

    def to_plain(self) -> dict[str, Any]:
        """Return what a campaign file writes for it."""
        variables = {key: variable.to_plain() for key, variable in self.variables.items()}
        minimise: Any = list(self.minimise) if len(self.minimise) > 1 else self.minimise[0] if self.minimise else None
        over: Any = [CORNERS, self.over] if self.corners and self.over else CORNERS if self.corners else self.over
        subject_to = [requirement.to_plain() for requirement in self.subject_to]
        return {"variables": variables, "minimise": minimise, "subject_to": subject_to, "over": over}


class TuneRule(Rule):
    """What a search for gains varies, or null."""

    expected = "a block with variables and, optionally, minimise, subject_to and over"

    def accept(self, value: Any) -> TunePlan | None:
        if value is None:
            return None
        if not isinstance(value, dict) or not {"variables"} <= set(value) <= {*_KEYS}:
            self.refuse(value)
        problems: list[Problem] = []
        variables = value["variables"]
        if not isinstance(variables, dict) or not variables:
            raise refusal((("variables",), f"expected a block of gains with ranges, got {shown_value(variables)}"))
        read = {key: tried(_variable_of, given, key, problems) for key, given in variables.items()}
        problems = [(("variables", *place), text) for place, text in problems]
        minimise = tried(_minimised, value.get("minimise"), "minimise", problems)
        given = value.get("subject_to", [])
        if not isinstance(given, list):
            problems.append((("subject_to",), f"expected a list of requirements, got {shown_value(given)}"))
            given = []
        found: list[Problem] = []
        required = [tried(_of_loop, each, index, found) for index, each in enumerate(given)]
        problems += [(("subject_to", *place), text) for place, text in found]
        over = tried(_variations, value.get("over", _OVER), "over", problems)
        if problems:
            raise refusal(*problems)
        count, corners = cast("tuple[int, bool]", over)
        return TunePlan(
            cast("dict[str, Variable]", read),
            cast("tuple[str, ...]", minimise),
            cast("tuple[Requirement, ...]", tuple(required)),
            count,
            corners,
        )


def _minimised(value: Any) -> tuple[str, ...]:
    names = [] if value is None else value if isinstance(value, list) else [value]
    for name in names:
        if name not in METRICS:
            nearest = did_you_mean(name, METRICS) or ";"
            raise refusal(((), f"unknown metric {shown_value(name)}{nearest} known: {', '.join(METRICS)}"))
    if len(names) != len(set(names)) or len(names) > 2 or value == []:
        raise refusal(((), f"expected a metric, a list of two different ones, or null, got {shown_value(value)}"))
    return tuple(names)


def _of_loop(value: Any) -> Requirement:
    return requirement_of(value, {name: unit for name, (unit, _) in LOOP_NUMBERS.items()})


def _variations(value: Any) -> tuple[int, bool]:
    """Return how many variations are drawn, and whether the corners are among them."""
    parts = value if isinstance(value, list) else [value]
    counts = [part for part in parts if part != CORNERS]
    if not parts or len(counts) > 1 or len(parts) - len(counts) > 1:
        raise refusal(((), f"expected a number of variations, corners, or [corners, number], got {shown_value(value)}"))
    return (Integer(1, _MOST_OVER).accept(counts[0]) if counts else 0), CORNERS in parts


def _variable_of(value: Any) -> Variable:
    groups = value.get("groups") if isinstance(value, dict) else None
    variation = variation_of({key: item for key, item in value.items() if key != "groups"} if groups else value)
    if variation.kind not in ("uniform", "log") or variation.to_plain().keys() != {variation.kind}:
        raise refusal(((), f"expected {{uniform: [low, high]}} or {{log: [low, high]}}, got {shown_value(value)}"))
    if groups is None:
        return Variable(variation, (0,))
    if not isinstance(groups, list) or not all(isinstance(size, int) and size > 0 for size in groups):
        raise refusal((("groups",), f"expected a list of sizes >= 1, got {shown_value(groups)}"))
    return Variable(variation, tuple(groups))
