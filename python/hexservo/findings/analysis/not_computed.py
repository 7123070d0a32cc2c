"""Reasons why a part of an analysis could not be computed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hexservo.findings.analysis.words import number, open_section
from hexservo.findings.evidence import Section
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import numeric_keys, value_at
from hexservo.scenario.scenario import Scenario, load_scenario

_EXTREME = 1e4  # factor between a number of a scenario and those of `paper` from which it is named
_NAMED = 3  # keys at most


@dataclass(frozen=True)
class NotComputed:
    """A part of an analysis that has no numbers."""

    name: str  # of the part
    title: str
    reason: str  # as a clause

    def section(self) -> Section:
        """Return the reason as a section."""
        return open_section(self.name, self.title, f"Cannot be computed: {self.reason}.")


def not_computed(scenario: Scenario, name: str, about: str, error: Exception) -> NotComputed:
    """Describe a numerical error.

    Parameters
    ----------
    scenario
        Whose part it is.
    name, about
        Of the part.
    error
        What the computation raised.
    """
    extreme = [f"{key} of {number(value)}" for key, value in _extreme(scenario)]
    cause = f"; the scenario has extreme values: {', '.join(extreme)}" if extreme else ""
    return NotComputed(name, about[0].upper() + about[1:], _reason(error) + cause)


def _reason(error: Exception) -> str:
    first, *others = str(error).strip().splitlines() or [type(error).__name__]
    text = first.rstrip(".") + (f" (and {len(others)} more of the kind)" if others else "")
    if isinstance(error, np.linalg.LinAlgError):
        singular = "singular" in text.lower()
        return "a matrix is singular to rounding" if singular else f"a matrix cannot be decomposed ({text})"
    if isinstance(error, (FloatingPointError, OverflowError, ZeroDivisionError)):
        return f"a number leaves the range of double precision ({text})"
    if re.search(r"got (nan|-?inf)\b|not finite", text):  # of what was computed: the scenario's own are finite
        return f"a number on the way is not finite ({text})"
    return text


def _extreme(scenario: Scenario) -> list[tuple[str, float]]:
    """Return the keys whose numbers are farthest from those of `paper`, by factors, the farthest first."""
    law = scenario.controller.law
    usual = dict(_decades(load_scenario("paper"), law))
    farthest: dict[str, tuple[float, float]] = {}
    for key, decades in _decades(scenario, law):
        common = usual.get(key, np.zeros(1))
        away = np.abs(decades - decades.clip(common.min(), common.max()))
        worst = int(away.argmax())
        if away[worst] > np.log10(_EXTREME):
            farthest[key] = (float(away[worst]), float(10.0 ** decades[worst]))
    order = sorted(farthest, key=lambda key: -farthest[key][0])
    return [(key, farthest[key][1]) for key in order[:_NAMED]]


def _decades(scenario: Scenario, law: str) -> Iterator[tuple[str, Array]]:
    """Yield log10 of the sizes of the numbers that are not zero, by key."""
    for key in numeric_keys(law):
        value = value_at(scenario, key)
        if value is None or isinstance(value, str):  # no number: a default, or a table by its name
            continue
        sizes = np.abs(np.asarray(value, dtype=float).ravel())
        if sizes.any():
            yield key, np.log10(sizes[sizes > 0.0])
