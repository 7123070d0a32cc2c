"""Warnings about laws without viscous damping that leave the goal, by runs; no linear loop describes them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.check import unlikely

EXACT = {"controller.law": "hybrid", "uncertainty.gravity": 0.0, "uncertainty.depth": 0.0}
MOVING = {"target.motion": {"kind": "sinusoid", "amplitude": [0.015, 0.0, 0.0], "frequency": 0.5}}


def changed(name: str, changes: dict[str, Any]) -> hs.Scenario:
    return hs.load_scenario(name).updated({"controller.law": "hybrid", **changes})


def said(scenario: hs.Scenario) -> list[str]:
    return [line for line in unlikely(scenario) if "runs that begin at the goal" in line]


def error_late(scenario: hs.Scenario) -> float:
    """Return the largest feature error in the second half of a run from the scenario's own start [px]."""
    run = hs.simulate(scenario)
    assert run.outcome == "completed"
    return float(np.abs(run.feature_error[run.time >= 0.5 * run.time[-1]]).max())


@pytest.mark.parametrize("name", ["composite-30hz", "slow-camera"])
def test_a_wrong_weight_is_not_held(name: str) -> None:
    scenario = changed(name, {})
    (line,) = said(scenario)
    assert float(re.findall(r"are up to ([\d.]+) px from it", line)[0]) == pytest.approx(error_late(scenario), rel=0.2)
    assert hs.diagnose(hs.simulate(scenario)).causes[0].cause == "gravity"  # what the sentence promises
    assert [line for line in unlikely(scenario, by_law=False) if "begin at the goal" in line] == []


def test_runs_that_end_early_name_the_outcome() -> None:
    (line,) = said(changed("real-machine", {}))
    assert "before a target at rest end early (solver_failed); hybrid has Coulomb damping only" in line


def test_a_target_in_motion_is_followed_as_far_behind_as_in_a_run() -> None:
    assert said(changed("composite-30hz", EXACT)) == []
    moving = changed("composite-30hz", {**EXACT, **MOVING})
    (line,) = said(moving)
    left = error_late(moving)
    assert line.startswith("target.motion: hybrid leaves up to about ")
    assert float(re.findall(r"about ([\d.]+) px of such", line)[0]) == pytest.approx(left, rel=0.2)
    assert said(moving.updated({"metrics.band": 1.25 * left})) == []


def test_laws_with_viscous_damping_and_continuous_runs_have_none() -> None:
    assert said(changed("composite-30hz", {"controller.law": "composite"})) == []
    assert said(hs.load_scenario("paper")) == []
