"""The run of a scenario that ``hexservo check`` looks at."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

import hexservo as hs

HEADS = re.compile("simulation: the run (does not settle|ends early)")


@pytest.mark.parametrize("name", hs.scenario_names())
def test_it_is_doubtful_or_settled(name: str) -> None:
    """What is stated is what the metrics of `hexservo run` are."""
    scenario = hs.load_scenario(name)
    found = hs.check(scenario)
    assert found.run is not None
    settling_time = hs.metrics(hs.simulate(scenario))["settling_time"]
    settles = found.run.outcome == "completed" and settling_time == settling_time
    assert (found.settled != "") == settles
    assert any(HEADS.match(words) for words in found.warnings) == (not settles)
    if settles and settling_time > 0.0:
        (after,) = re.findall(r"after ([\d.]+) s", found.settled)
        assert settling_time * (1 - 1e-12) <= float(after) <= settling_time * 1.001


def test_limits_of_a_run_that_settles() -> None:
    """One sentence for each kind, with the first leg beyond it."""
    scenario = hs.load_scenario("paper")
    peak = hs.metrics(hs.simulate(scenario))
    strict: dict[str, Any] = {
        "robot.stroke": 0.9 * peak["peak_leg_excursion"],
        "robot.force_limit": 0.9 * peak["peak_leg_force"],
    }
    found = hs.check(scenario.updated(strict))
    run = found.run
    assert run is not None
    doubts = [words for words in found.warnings if words.startswith("simulation: in the run")]
    assert found.settled == "within 2 px after 0.353 s"
    assert len(doubts) == 2
    for word, kind in (("force limit", "force"), ("stroke", "stroke")):
        (doubt,) = (each for each in doubts if f"its {word} of" in each)
        legs = {event.leg for event in run.events if event.kind == kind}
        assert doubt.startswith("simulation: in the run leg ")
        assert (f"and {len(legs) - 1} other" in doubt) == (len(legs) > 1)
    assert hs.check(scenario).warnings == ()


def test_long_runs_are_left_out() -> None:
    found = hs.check(hs.load_scenario("paper-nominal", {"simulation.duration": 200.1}))
    assert (found.run, found.settled) == (None, "")
    assert found.to_dict()["run"] is None
    assert repr(found).endswith("It was not run, since it has more than 200 000 steps.")


def test_it_is_data_for_programs() -> None:
    """Strict JSON: warnings as sentences, and the metrics of the run, with null in place of NaN."""
    found = hs.check(hs.load_scenario("paper-gravity"))
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert data["scenario"] == "paper-gravity"
    assert data["warnings"] == list(found.warnings) != []
    assert data["run"]["outcome"] == "completed"
    assert data["run"]["metrics"]["settling_time"] is None
    assert data["run"]["metrics"]["final_error"] == pytest.approx(37.58, abs=0.01)
    assert repr(found).startswith('Check of "paper-gravity"\n  Warning: controller.law: runs of hybrid')
    assert repr(hs.check(hs.load_scenario("paper"))).endswith("The run is within 2 px after 0.353 s.")


def test_only_scenarios_are_checked() -> None:
    with pytest.raises(TypeError, match="expected a Scenario"):
        hs.check("paper")  # type: ignore[arg-type]


@pytest.mark.parametrize("command", ["analyse", "certify"])
def test_sections_have_verdict_and_sentences_in_json(command: str) -> None:
    scenario = hs.load_scenario("paper", {"simulation.duration": 0.5})
    found = hs.analyse(scenario, ["drift"]) if command == "analyse" else hs.certify(hs.simulate(scenario))
    data = found.to_dict()
    for section in found.sections():
        assert data[section.name]["verdict"] == section.verdict
        assert data[section.name]["sentences"] == list(section.sentences)


def test_a_diagnosis_has_verdict_and_sentences_in_json() -> None:
    found = hs.diagnose(hs.simulate(hs.load_scenario("fails-wrong-sign")))
    data = found.to_dict()
    assert data["verdict"] == "bad"
    assert data["sentences"] == list(found.section().sentences)
    assert data["failed"] is True
