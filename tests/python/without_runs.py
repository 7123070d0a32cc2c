"""`unlikely` without the runs near the goal, which take most of its time, for tests of its other sentences."""

from __future__ import annotations

import pytest

import hexservo as hs
from hexservo.findings.check import unlikely


def unlikely_without_runs(scenario: hs.Scenario) -> list[str]:
    """Return the sentences of `unlikely` but for those of `of_hold`, which `test_check_hold.py` tests.

    For tests that look for a sentence, or its absence, by words that none of `of_hold` has. Those that compare whole
    lists of sentences call `unlikely` itself.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hexservo.findings.check.of_hold", lambda scene: iter(()))
        return unlikely(scenario)
