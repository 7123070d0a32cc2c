"""The end of a run that ends early: one time in numbers, sentences and pictures, and the leg that ended it.

Expected values of legs are those of runs with ``on_limit: report``, whose samples go on, by `test_leg_limits.peaks`.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli.commands import app
from hexservo.cli.output import write_results
from hexservo.draw.plots import feature_errors
from hexservo.findings.diagnosis.runs import Run, record_of, run_all
from hexservo.run.leg_limits import most_used
from hexservo.run.summary import summary_sentences
from hexservo.run.variant import chosen_kernel
from hexservo.scenario.parameters import core_parameters
from rotary_machine import machine as cranks
from test_leg_limits import KINDS, peaks

STOP = {"robot.on_limit": "stop"}
ENDS: dict[str, tuple[str, dict[str, Any]]] = {
    "completed": ("paper", {"simulation.duration": 0.2}),
    "diverged": ("paper", {"controller.jacobian": "printed"}),
    "singular": ("paper-gravity", {"uncertainty.gravity": 0.5, "simulation.log_every": 50}),
    "feature_lost": ("fails-lost-features", {"camera.on_lost": "stop"}),
    "leg_limit": ("fails-leg-limits", {}),
}


def ends_as(name: str) -> hs.Scenario:
    scenario, changes = ENDS[name]
    return hs.load_scenario(scenario).updated(changes)


# ---- When -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ENDS)
def test_the_end_has_one_time(name: str) -> None:
    """In the result, in a batch, in the core, in the sentence and in the figures."""
    scenario = ends_as(name)
    result = hs.simulate(scenario)
    assert result.outcome == name
    batch = hs.simulate_batch(scenario, {"robot.mass": [scenario.robot.mass]}, log="metrics")
    assert batch.stop_time[0] == result.stop_time
    assert _core.simulate(core_parameters(scenario), chosen_kernel()).stop_time == result.stop_time
    assert result.end_time == result.time[-1]
    written = [text.get_text() for text in feature_errors(result).texts]
    if name == "completed":
        assert result.stop_time == result.end_time
        assert not written
        return
    assert result.stop_time == pytest.approx(result.end_time + scenario.simulation.step, rel=1e-12)
    (stated,) = re.findall(r"at t = ([\d.]+) s", result.detail)
    assert float(stated) == pytest.approx(result.stop_time, rel=1e-11)
    assert any(f"after {result.stop_time:.4g} s" in text for text in written)
    assert any(f"at t = {result.stop_time:.4g} s" in sentence for sentence in summary_sentences(result))
    assert record_of(result).stop_time == result.stop_time


def test_no_run_ends_after_its_duration() -> None:
    """A metric that overflows at the last sample makes it one that diverged, without a step beyond."""
    completed = hs.simulate(ends_as("completed"))
    assert replace(completed, outcome="diverged").stop_time == completed.end_time


def test_a_run_that_is_not_at_its_end_has_the_time_of_its_last_sample() -> None:
    """Ctrl-C ends a run between two steps, none of which failed."""
    scenario = hs.load_scenario("paper").updated({"simulation.mode": "sampled", "simulation.duration": 0.1})

    def controller(seen: hs.Observation) -> Any:
        if seen.tick == 50:
            raise KeyboardInterrupt
        return [0.0, 0.0, -9.81 * scenario.robot.mass, 0.0, 0.0, 0.0]

    stopped = hs.simulate(scenario, controller=controller)
    assert stopped.outcome == "interrupted"
    assert stopped.stop_time == stopped.end_time


def test_files_have_both_times(tmp_path: Path) -> None:
    result = hs.simulate(ends_as("leg_limit"))
    content = json.loads((write_results(result, tmp_path / "out") / "metrics.json").read_text(encoding="utf-8"))
    assert content["end_time"]["value"] == result.end_time
    assert content["stop_time"] == {"value": result.stop_time, "unit": "s"}
    again = hs.load_result(tmp_path / "out" / "result.nc")
    assert again.stop_time == result.stop_time
    assert again.events == result.events
    assert again.stop_event == result.stop_event is not None


# ---- Which leg ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["stroke", *KINDS])
def test_the_leg_that_ends_a_run_is_its_last_event(kind: str) -> None:
    machine = hs.load_scenario("real-machine").updated({"simulation.duration": 0.4})
    free = hs.simulate(machine)
    middle = _core.Hexapod(core_parameters(machine).robot).mid_lengths
    values = np.abs(free.leg_lengths - middle) if kind == "stroke" else peaks(free)[kind]
    limit = 0.6 * float(values.max())
    keys: dict[str, dict[str, Any]] = {
        "stroke": {"robot.stroke": limit},
        "speed": {"robot.speed_limit": limit},
        "base_joint": {"robot.joint_limit": [limit, np.pi]},
        "platform_joint": {"robot.joint_limit": [np.pi, limit]},
    }
    result = hs.simulate(machine.updated({**keys[kind], **STOP}))
    first = int(np.argmax((values > limit).any(axis=1)))
    event = result.stop_event
    assert result.outcome == "leg_limit"
    assert event is not None
    assert event == result.events[-1]
    assert (event.kind, event.leg) == (kind, 1 + int(values[first].argmax()))
    assert event.time == result.stop_time == free.time[first]
    assert event.limit == pytest.approx(limit, rel=1e-9)
    assert event.peak == pytest.approx(float(values[first].max()), rel=1e-6)
    assert event.peak > event.limit
    np.testing.assert_array_equal(result.leg_lengths, free.leg_lengths[:first])  # what ran is the same
    (of_batch,) = run_all([Run(result.scenario)])
    assert of_batch is not None
    assert record_of(result).stopped_by == of_batch.stopped_by == kind
    assert hs.metrics(result)["peak_leg_excursion"] == np.abs(result.leg_lengths - middle).max()


def test_the_limit_that_ends_a_run_counts_whatever_of_the_others_is_used() -> None:
    """A leg may pass its speed limit from one tick to the next, while most of its stroke is used since long."""
    scenario = hs.load_scenario("paper").updated({"robot.speed_limit": 0.1, "robot.joint_limit": [0.5, 0.5]})
    used = {"peak_leg_excursion": 0.99 * scenario.robot.stroke, "peak_leg_speed": 0.02}
    used |= {"peak_base_joint": 0.1, "peak_platform_joint": 0.2}
    assert most_used(scenario, used).limit.kind == "stroke"
    for kind in ("stroke", *KINDS):
        assert most_used(scenario, used, kind).limit.kind == kind
    assert most_used(scenario, used, "speed").excess == "ends where a leg reaches its speed limit of 100 mm/s"


def test_runs_that_no_limit_ends_have_no_such_event() -> None:
    reported = hs.simulate(ends_as("leg_limit").updated({"robot.on_limit": "report"}))
    assert {event.kind for event in reported.events} >= {"stroke"}
    assert reported.stop_event is None
    diverged = hs.simulate(ends_as("diverged"))
    assert diverged.events
    assert diverged.stop_event is None


@pytest.mark.parametrize("log_every", [1, 7])
def test_a_custom_controller_is_stopped_by_the_same_leg(log_every: int) -> None:
    """One that does nothing but hold less than the weight: the platform sinks until a leg is beyond its stroke."""
    paper = hs.load_scenario("paper")
    base = {"simulation.mode": "sampled", "simulation.duration": 1.0, "simulation.log_every": log_every}
    scenario = paper.updated({**base, "robot.stroke": 2e-3, **STOP})
    half = [0.0, 0.0, -0.5 * 9.81 * paper.robot.mass, 0.0, 0.0, 0.0]
    results = {
        policy: hs.simulate(scenario.updated({"robot.on_limit": policy}), controller=lambda _: half)
        for policy in ("stop", "report")
    }
    event = results["stop"].stop_event
    assert event is not None
    first = min(each.time for each in results["report"].events)
    assert event.time == results["stop"].stop_time == first
    assert event.leg in {each.leg for each in results["report"].events if each.time == first}
    batch = hs.simulate_batch(scenario, {"robot.mass": [paper.robot.mass]}, controller=lambda _: half)
    assert (batch.stop_time[0], batch.limit_leg[0]) == (event.time, event.leg)


# ---- What people read ------------------------------------------------------------------------------------------------


def test_the_command_states_leg_limit_value_and_bound() -> None:
    result = hs.simulate(ends_as("leg_limit"))
    event = result.stop_event
    assert event is not None
    words = f"leg {event.leg} passed its stroke at t = {event.time:.12g} s ({1e3 * event.peak:.4g} mm of 17 mm)"
    run = CliRunner().invoke(app, ["run", "fails-leg-limits"])
    assert f"fails-leg-limits: leg limit: {words}" in run.stdout
    assert f"Ended early: fails-leg-limits: leg limit: {words}" in run.stderr
    assert "limit exceeded" not in run.stdout
    sentences = summary_sentences(result)
    assert words in sentences[0]
    assert not any("of it is left" in each and "travel" in each for each in sentences)
    (text,) = (each.get_text() for each in feature_errors(result).texts)
    assert text == f"leg limit after {event.time:.4g} s (leg {event.leg}, stroke)"


def test_a_crank_that_ends_a_run_has_an_angle() -> None:
    up = {"simulation.start.twist": [0.0, 0.0, -3.0, 0.0, 0.0, 0.0], "robot.stroke": 0.6}
    result = hs.simulate(cranks().updated({**up, "simulation.mode": "sampled", **STOP}))
    assert result.stop_event is not None
    assert re.search(r"\(6\d\d(\.\d+)? mrad of 600 mrad\)", summary_sentences(result)[0])
