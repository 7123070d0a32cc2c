"""Extreme legal values: every part of an analysis has numbers, or a sentence with the reason why it has none."""

from __future__ import annotations

import json
import re
from collections import Counter

import numpy as np
import pytest

import hexservo as hs
from extreme_scenarios import extreme_scenario
from hexservo.findings.analysis import NotComputed, _computed
from packaged import one_of_each_kind

SEED = 5
COUNTS = {
    "conditioning": 12,
    "workspace": 4,
    "stiction": 20,
    "equilibria": 20,
    "drift": 30,
    "camera_rate": 8,
    "largest_start": 6,
}


MORE = {"workspace": 10, "largest_start": 12}  # of the parts that take longest


@pytest.mark.parametrize(
    ("part", "count"),
    [*COUNTS.items(), *(pytest.param(*each, marks=pytest.mark.slow) for each in MORE.items())],
)
def test_a_part_never_raises_and_never_shows_nan(part: str, count: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Random extreme scenarios: sentences without NaN, strict JSON, and a reason where there is no number."""
    kinds: Counter[str] = Counter()
    for number in range(count):
        scenario, changed = extreme_scenario(SEED, number)
        where = f"seed {SEED}, scenario {number}: {scenario.name}, {scenario.controller.law}, {changed}"
        found = hs.analyse(scenario, [part])
        (section,) = found.sections()
        text = " ".join(section.sentences)
        json.dumps(found.to_dict(), allow_nan=False)
        if isinstance(found.parts[part], NotComputed):
            assert section.verdict == "open", where
            assert len(text) > len("Cannot be computed: ."), where
            kinds["not computed"] += 1
        else:
            assert not re.search(r"\bnan\b", text), where
            kinds[section.verdict] += 1
    assert kinds["not computed"] < 0.5 * count  # most of them have numbers
    with capsys.disabled():
        print(f"\n{part}, seed {SEED}: {dict(kinds)}")


@pytest.mark.parametrize(
    ("law", "changes", "parts"),
    [
        ("hybrid", {"target.depth": 1e290}, ["conditioning", "workspace", "stiction"]),
        ("hybrid", {"robot.stroke": 1e-152}, ["stiction"]),
    ],
)
def test_what_cannot_be_computed_names_the_extreme_value(
    paper: hs.Scenario, law: str, changes: dict[str, float], parts: list[str]
) -> None:
    scenario = paper.updated({"controller.law": law, **changes})
    for section in hs.analyse(scenario, parts).sections():
        assert section.verdict == "open", section
        assert "Cannot be computed" in section.sentences[0]
        assert next(iter(changes)) in section.sentences[0]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (np.linalg.LinAlgError("Singular matrix"), "a matrix is singular to rounding"),
        (np.linalg.LinAlgError("SVD did not converge"), "a matrix cannot be decomposed (SVD did not converge)"),
        (OverflowError("math range error"), "a number leaves the range of double precision (math range error)"),
        (
            ValueError("pose: expected finite, got nan"),
            "a number on the way is not finite (pose: expected finite, got nan)",
        ),
        (ValueError("a: expected one\nb: expected two"), "a: expected one (and 1 more of the kind)"),
    ],
)
def test_numerical_errors_have_a_message(paper: hs.Scenario, error: Exception, words: str) -> None:
    def fails() -> int:
        raise error

    found = _computed(paper, "drift", fails)
    assert isinstance(found, NotComputed)
    assert found.reason == words  # the values of `paper` are ordinary: no key is named
    assert found.section().sentences == [f"Cannot be computed: {words}."]


def test_an_overflow_is_a_reason_and_an_error_of_the_program_is_not_hidden(paper: hs.Scenario) -> None:
    found = _computed(paper, "drift", lambda: np.array([1e200]) * 1e200)
    assert isinstance(found, NotComputed)
    assert "double precision" in found.reason
    with pytest.raises(TypeError):
        _computed(paper, "drift", lambda: len(3))  # type: ignore[arg-type]


def test_arguments_are_names_and_a_function(paper: hs.Scenario) -> None:
    for parts in (3, [3]):
        with pytest.raises(TypeError, match=r"^parts: expected a list of names, or None, got int$"):
            hs.analyse(paper, parts)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^progress: expected a function or None, got int$"):
        hs.analyse(paper, ["drift"], progress=3)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", one_of_each_kind())
def test_packaged_scenarios_have_numbers(name: str) -> None:
    found = hs.analyse(hs.load_scenario(name), ["drift"])
    assert not any(isinstance(part, NotComputed) for part in found.parts.values())


def test_a_continuous_scenario_of_any_step_is_analysed(paper: hs.Scenario) -> None:
    """A step that the default camera period is no multiple of."""
    found = hs.analyse(paper.updated({"simulation.step": 2e-3}))
    assert not any(isinstance(part, NotComputed) for part in found.parts.values())
    assert found.largest_start.timings
    kelly = paper.updated({"simulation.step": 2e-3, "controller.law": "kelly"})
    assert hs.analyse(kelly, ["camera_rate"]).camera_rate.open is None
