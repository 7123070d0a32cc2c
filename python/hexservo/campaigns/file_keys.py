"""The keys of a campaign file: what each accepts, and how a message gives it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from pydantic import ValidationError

from hexservo.campaigns.distributions import SEED, Variation, variation_of
from hexservo.campaigns.requirements import Requirement, requirement_of
from hexservo.run.metrics import METRICS, asked_metrics
from hexservo.scenario.rules import Integer, Number, Problem, Rule, did_you_mean, refusal, shown_value
from hexservo.scenario.scenario import Scenario, load_scenario
from hexservo.scenario.yaml import ScenarioError

__all__ = ["Until"]

PROBABILITY = Number(above=0.0, below=1.0)
T = TypeVar("T")


@dataclass(frozen=True)
class Until:
    """When a campaign has runs enough."""

    kind: str  # probability_below, width_below
    value: float  # of the failure probability, or of its interval's width

    def decided(self, low: float, high: float) -> bool:
        """Return whether the interval decides: it lies on one side of the probability, or is narrow enough."""
        if self.kind == "probability_below":
            return high <= self.value or low > self.value
        return high - low <= self.value

    def to_plain(self) -> dict[str, float]:
        """Return what a campaign file writes for it."""
        return {self.kind: self.value}


def tried(read: Callable[[Any], T], value: Any, place: str | int, problems: list[Problem]) -> T | None:
    """Return what is read from a value, or None after its problems were added at its place."""
    try:
        return read(value)
    except ValidationError as error:
        problems += [((place, *each["loc"]), each["msg"]) for each in error.errors(include_url=False)]
        return None


# ---- The keys of a file ---------------------------------------------------------------------------------------------


class ScenarioRule(Rule):
    """A scenario by name, path or value."""

    expected = "a packaged scenario, the path of a file, or the scenario itself"

    def accept(self, value: Any) -> Scenario:
        if isinstance(value, Scenario):
            return value
        if not isinstance(value, str | dict):
            self.refuse(value)
        try:
            return load_scenario(value) if isinstance(value, str) else Scenario.from_mapping(value)
        except ScenarioError as error:
            raise refusal(*(((), line) for line in str(error).splitlines())) from None


class VaryRule(Rule):
    """Distributions by dotted key."""

    expected = "a block of dotted keys with their variations"

    def accept(self, value: Any) -> dict[str, Variation]:
        if not isinstance(value, dict) or not value:
            self.refuse(value)
        problems: list[Problem] = []
        found = {
            key: tried(_seeds_of if key == "seed" else variation_of, given, key, problems)
            for key, given in value.items()
        }
        if problems:
            raise refusal(*problems)
        return cast("dict[str, Variation]", found)


def _seeds_of(value: Any) -> Variation:
    if value != SEED:  # a few seeds would be a few kinds of noise, in runs that count as independent ones
        remedy = f"expected {SEED}, other noise in each run; for the noise of one seed set seed in the scenario"
        raise refusal(((), f"{remedy}; got {shown_value(value)}"))
    return Variation(SEED)


class RequireRule(Rule):
    """Requirements."""

    expected = "a list of at least one requirement"

    def accept(self, value: Any) -> tuple[Requirement, ...]:
        if not isinstance(value, list) or not value:
            self.refuse(value)
        problems: list[Problem] = []
        found = [tried(requirement_of, given, index, problems) for index, given in enumerate(value)]
        texts = [str(requirement) for requirement in found if requirement]
        problems += [
            ((), f'"{text}": duplicate requirement') for text in sorted({t for t in texts if texts.count(t) > 1})
        ]
        if problems:
            raise refusal(*problems)
        return cast("tuple[Requirement, ...]", tuple(found))


class UntilRule(Rule):
    """When the interval ends a campaign, or null."""

    expected = "{probability_below: p} or {width_below: w}, a number > 0 and < 1"

    def accept(self, value: Any) -> Until | None:
        if value is None:
            return None
        if (
            not isinstance(value, dict)
            or len(value) != 1
            or next(iter(value)) not in ("probability_below", "width_below")
        ):
            self.refuse(value)
        ((kind, number),) = value.items()
        try:
            return Until(kind, PROBABILITY.accept(number))
        except ValidationError as error:
            raise refusal(*(((kind,), each["msg"]) for each in error.errors(include_url=False))) from None


class OptionalInteger(Integer):
    """An integer, or null."""

    @property
    def expected(self) -> str:
        return f"{super().expected} or null"

    def accept(self, value: Any) -> int | None:  # type: ignore[override]
        return None if value is None else super().accept(value)


class VariantRule(Rule):
    """A compiled variant, or null."""

    expected = "avx512, avx2, baseline or null"

    def accept(self, value: Any) -> str | None:
        if value not in ("avx512", "avx2", "baseline", None):
            self.refuse(value)
        return cast("str | None", value)


class MetricsRule(Rule):
    """Metrics that a campaign keeps of its runs."""

    expected = "all, or a list of metrics, which hs.METRICS describes"

    def accept(self, value: Any) -> str | tuple[str, ...]:
        if value == "all":
            return "all"
        if not isinstance(value, list | tuple):
            self.refuse(value)
        try:
            return asked_metrics(value)
        except (TypeError, ValueError):
            unknown = next((name for name in value if isinstance(name, str) and name not in METRICS), None)
            self.refuse(value, hint=did_you_mean(unknown, METRICS))


class RecordRule(Rule):
    """What a campaign's folder adds to its file: of use there, and of none elsewhere."""

    expected = "the block that hexservo wrote"

    def accept(self, value: Any) -> None:
        if value is not None and not isinstance(value, dict):
            self.refuse(value)
