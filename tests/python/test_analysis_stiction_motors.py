"""Image errors that dry friction of motors holds, against runs that come to rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import stiction
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import scene_of

LONG = {"camera.noise": 0.0, "simulation.duration": 8.0}


def goal(yaw: float) -> dict[str, Any]:
    return {"target.desired_features": None, "target.desired_pose": [0, 0, 0, 0, 0, yaw]}


def end_of(scenario: hs.Scenario) -> float:
    """Return the largest image error at the end of a run whose legs have come to rest [px]."""
    run = hs.simulate(scenario)
    assert run.outcome == "completed"
    assert np.ptp(run.leg_lengths[-10:], axis=0).max() < 1e-5
    return float(np.abs(run.feature_error[-1]).max())


def test_runs_on_motors_rest_within_the_bound_and_near_it() -> None:
    base = hs.load_scenario("fails-stick-slip").updated(LONG)
    changes = [{"actuators.motor.friction": friction} for friction in (0.02, 0.05, 0.1, 0.2)]
    changes += [goal(yaw) for yaw in (-0.4, -0.2, 0.2)]
    changes += [{"uncertainty.depth": error} for error in (0.5, -0.3)]
    shares = []
    for change in changes:
        scenario = base.updated(change)
        legs = stiction.analyse(scenario).legs
        assert legs is not None
        shares.append(end_of(scenario) / legs.largest)
    print(f"shares of the bound: {np.round(shares, 3)}")
    assert max(shares) <= 1.0
    assert max(shares) > 0.85


FED_BACK = {**LONG, "controller.tracking.integral": 0.0, "sensors.resolution": 0.0}


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5])
def test_feedback_of_the_legs_divides_what_weight_and_friction_leave(share: float) -> None:
    """Legs rest where |q - q_goal + sag| is at most F/(kp (1 + feedback)), and some of them at nearly that."""
    base = hs.load_scenario("reachy-mini-motors").updated(FED_BACK)
    scenario = base.updated({"controller.tracking.feedback": share * hs.feedback_margin(base)})
    legs = stiction.analyse(scenario).legs
    assert legs is not None
    scene = scene_of(scenario)
    goals = find_goals(scene)
    assert goals is not None
    starts = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 6)) * np.repeat([4e-3, 0.1], 3)
    runs = hs.simulate_batch(scenario, {"simulation.start.pose": starts})
    assert (runs.outcome == "completed").all()
    ends = Poses(runs.samples["position"], runs.samples["quaternion"])
    off = scene.leg_travel(ends) - scene.leg_travel(goals.best.view.pose) + legs.sag
    print(
        f"feedback {scenario.controller.gains.feedback:.3g}: up to {np.abs(off).max() / legs.held:.3f} of the friction"
    )
    assert 0.85 < np.abs(off).max() / legs.held < 1.05
    assert np.abs(runs.samples["feature_error"]).max() < legs.largest
    # Hardly any friction leaves the sag.
    sagging = scenario.updated({"actuators.motor.friction": 1e-5})
    sagged = stiction.analyse(sagging)
    assert sagged.legs is not None
    assert end_of(sagging) == pytest.approx(sagged.legs.largest, rel=0.15)


def test_friction_of_motors_is_a_warning_by_a_law_that_does_not_integrate() -> None:
    scenario = hs.load_scenario("fails-stick-slip")
    section = stiction.analyse(scenario).section()
    text = " ".join(section.sentences)
    assert section.verdict == "warning"
    assert "nothing holds" not in text
    assert "friction/kp = 10 mrad" in text
    assert "no integral" in text
    without = stiction.analyse(scenario.updated({"actuators.motor.friction": 0.0})).section()
    assert without.verdict == "good"


def test_more_friction_holds_more_in_proportion_beside_the_sag() -> None:
    """Far above the sag, where one coordinate has the largest error throughout."""
    base = hs.load_scenario("fails-stick-slip")
    found = [
        stiction.analyse(base.updated({"actuators.motor.friction": friction})).legs for friction in (0.4, 0.5, 0.6)
    ]
    less, more, most = (legs for legs in found if legs is not None)
    assert [legs.held for legs in (less, more, most)] == pytest.approx([0.04, 0.05, 0.06], rel=1e-12)
    assert most.largest - more.largest == pytest.approx(more.largest - less.largest, rel=1e-9)


@pytest.mark.parametrize("yaw", [-0.4, 0.2, 0.4])
def test_an_integral_leaves_what_its_band_allows(yaw: float) -> None:
    base = hs.load_scenario("reachy-mini-motors").updated({**LONG, **goal(yaw)})
    found = stiction.analyse(base)
    assert found.legs is not None
    assert found.legs.integrated is not None
    assert found.section().verdict == "good"
    assert end_of(base) < found.legs.integrated < found.legs.largest
    off = base.updated({"controller.tracking.integral": 0.0})
    held = stiction.analyse(off)
    assert held.legs is not None
    assert held.section().verdict == "warning"
    assert found.legs.integrated < end_of(off) < held.legs.largest


def test_a_law_with_switching_on_motors_is_open_and_names_their_friction() -> None:
    scenario = hs.load_scenario("fails-stick-slip").updated({"controller": {"law": "hybrid"}})
    section = stiction.analyse(scenario).section()
    assert section.verdict == "open"
    assert "actuators.motor.friction" in section.sentences[0]
