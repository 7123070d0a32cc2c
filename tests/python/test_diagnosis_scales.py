"""Causes of the same failure in other pixels and in another time."""

from __future__ import annotations

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.diagnosis.environment import alone_pairs, differs
from hexservo.findings.diagnosis.gains import default_gains, slower
from hexservo.findings.diagnosis.laws import LAWS
from hexservo.findings.diagnosis.model import Removal
from hexservo.findings.diagnosis.ranking import make_cases
from hexservo.findings.diagnosis.size import size_of
from hexservo.scenario.keys import value_at


def in_pixels(scenario: hs.Scenario, factor: float) -> hs.Scenario:
    """Return the scenario of a camera with so many times as many pixels per metre, and gains for them."""
    features = ("target.initial_features", "target.desired_features")
    return scenario.updated(
        {
            **{key: (factor * np.asarray(value_at(scenario, key))).tolist() for key in features},
            "camera.pixel_scale": factor * scenario.camera.pixel_scale,
            "controller.hybrid.kp": (np.asarray(scenario.controller.hybrid.kp) / factor**2).tolist(),
            "metrics.band": factor * scenario.metrics.band,
        }
    )


def in_time(scenario: hs.Scenario, factor: float) -> hs.Scenario:
    """Return the scenario in which everything takes so many times as long, with forces divided by the square."""
    gravity = np.asarray(scenario.robot.gravity) / factor**2
    return scenario.updated(
        {
            **slower(scenario, factor),
            **slower(scenario.updated({"controller.law": "pbvs"}), factor),  # which is tried in place of another law
            "robot.gravity": gravity.tolist(),
            "robot.force_limit": scenario.robot.force_limit / factor**2,
            "simulation.step": factor * scenario.simulation.step,
            "simulation.duration": factor * scenario.simulation.duration,
            "metrics.dwell": factor * scenario.metrics.dwell,
            "metrics.rms_start": factor * scenario.metrics.rms_start,
        }
    )


def named(scenario: hs.Scenario) -> list[str]:
    return [finding.cause for finding in hs.diagnose(hs.simulate(scenario)).named]


@pytest.mark.parametrize("factor", [2.0, 8.0])
def test_a_failure_has_the_same_cause_in_other_pixels(factor: float) -> None:
    """The path of the platform is the same, as all wrenches are."""
    scenario = hs.load_scenario("fails-stiction")
    other = in_pixels(scenario, factor)
    runs = [hs.simulate(each) for each in (scenario, other)]
    np.testing.assert_allclose(runs[1].feature_error, factor * runs[0].feature_error, rtol=0, atol=1e-6)
    assert named(other) == ["stiction"]


@pytest.mark.parametrize("name", ["fails-stiction", "fails-spring"])
def test_a_failure_has_the_same_cause_in_another_time(name: str) -> None:
    """Default gains do not settle within an eighth of the run: another law that does is not what failed."""
    scenario = hs.load_scenario(name)
    fast = in_time(scenario, 1 / 8)
    runs = [hs.simulate(each) for each in (scenario, fast)]
    np.testing.assert_allclose(runs[1].feature_error, runs[0].feature_error, rtol=0, atol=1e-6)
    assert named(fast) == [name.removeprefix("fails-")]


def test_default_gains_fit_the_focal_length() -> None:
    """Those of the size of `pi-h824` are within a factor of 4 of the ones that are fitted to it, at 1667 px."""
    scenario = hs.load_scenario("pi-h824")
    assert scenario.controller.composite.auto.bandwidth is not None
    assert size_of(scenario).pixels == pytest.approx(1667.0 / 581.816)
    usual = default_gains(scenario)
    for key in ("controller.composite.kp", "controller.composite.prior"):
        ratio = np.asarray(value_at(scenario, key)) / np.asarray(usual[key])
        assert (ratio > 1 / 4).all()
        assert (ratio < 4).all()


def test_the_focal_length_is_the_one_that_the_controller_assumes() -> None:
    scenario = hs.load_scenario("fails-stiction")
    assert size_of(scenario).pixels == pytest.approx(1.0)
    assert size_of(scenario.updated({"uncertainty.focal_length": 0.1})).pixels == pytest.approx(1.1)


def test_a_setting_is_tested_at_another_rate_only_where_the_loop_has_one() -> None:
    """A stiffness 64 times the default is a loop 8 times as fast."""
    (stiction,) = (cause for cause in LAWS if cause.key == "stiction")
    scenario = hs.load_scenario("fails-stiction")
    for factor, count in ((1.0, 1), (1 / 8, 2)):
        changed = scenario.updated(slower(scenario, factor))
        pairs = alone_pairs(stiction, make_cases([changed])[0], Removal("", {}))
        assert len(pairs) == count
    kp = pairs[-1].without["controller.hybrid.kp"]
    assert not differs(kp, 64.0 * np.asarray(default_gains(scenario)["controller.hybrid.kp"]))
    assert not differs(pairs[-1].alone["controller.hybrid.kv"], value_at(changed, "controller.hybrid.kv"))
