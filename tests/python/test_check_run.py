"""The run of a scenario that ``hexservo check`` looks at."""

from __future__ import annotations

import re
from typing import Any

import hexservo as hs
import pytest
from hexservo.findings.check_run import doubts_of_run, run_to_check, settled_words


@pytest.mark.parametrize("name", hs.scenario_names())
def test_it_is_doubtful_or_settled(name: str) -> None:
    """What is stated is what the metrics of `hexservo run` are."""
    scenario = hs.load_scenario(name)
    run = run_to_check(scenario)
    assert run is not None
    settling_time = hs.metrics(hs.simulate(scenario))["settling_time"]
    settles = run.outcome == "completed" and settling_time == settling_time
    doubts = doubts_of_run(run)
    assert (settled_words(run) != "") == settles
    assert any("does not settle" in doubt or "ends early" in doubt for doubt in doubts) == (not settles)
    if settles and settling_time > 0.0:
        (after,) = re.findall(r"after ([\d.]+) s", settled_words(run))
        assert settling_time * (1 - 1e-12) <= float(after) <= settling_time * 1.001


def test_limits_of_a_run_that_settles() -> None:
    """One sentence for each kind, with the first leg beyond it."""
    scenario = hs.load_scenario("paper")
    peak = hs.metrics(hs.simulate(scenario))
    strict: dict[str, Any] = {
        "robot.stroke": 0.9 * peak["peak_leg_excursion"],
        "robot.force_limit": 0.9 * peak["peak_leg_force"],
    }
    run = run_to_check(scenario.updated(strict))
    assert run is not None
    doubts = doubts_of_run(run)
    assert settled_words(run) == "within 2 px after 0.353 s"
    assert len(doubts) == 2
    for word, kind in (("force limit", "force"), ("stroke", "stroke")):
        (doubt,) = (each for each in doubts if f"its {word} of" in each)
        legs = {event.leg for event in run.events if event.kind == kind}
        assert doubt.startswith("simulation: in the run leg ")
        assert (f"and {len(legs) - 1} other" in doubt) == (len(legs) > 1)
    assert doubts_of_run(hs.simulate(scenario)) == []


def test_long_runs_are_left_out() -> None:
    scenario = hs.load_scenario("paper-nominal")
    assert run_to_check(scenario.updated({"simulation.duration": 1000.1})) is None
