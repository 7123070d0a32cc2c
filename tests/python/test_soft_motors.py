"""Motors that yield to the weight: the integral and the band with which the law `tracking` corrects that."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_positions import of_positions
from hexservo.findings.check_sag import fitted_integral, of_sag, sag_of

BAND, INTEGRAL = "controller.tracking.band", "controller.tracking.integral"
OF_BAND = "controller.tracking.band: the integral begins beyond twice the band"


def soft(noise: float = 0.0, **gains: Any) -> hs.Scenario:
    """Return a hexapod that rests outside the settling band by its weight, with settings of its law."""
    return hs.load_scenario("pi-h824-positions").updated(
        {
            "actuators.kind": "position_torque",
            "actuators.motor": {"kp": 4e3, "kv": 400.0, "damping": 100.0, "friction": 0.0, "armature": 0.5},
            "simulation": {"substeps": 20, "duration": 8.0},
            "camera.noise": noise,
            "sensors.resolution": 0.0,
            "controller.tracking": {"noise": max(noise, 0.5), **gains},
            "metrics.band": 1.0,
        }
    )


def ended(scenario: hs.Scenario) -> dict[str, float]:
    return hs.metrics(hs.simulate(scenario))


def of_band(scenario: hs.Scenario) -> list[str]:
    return [words for words in of_positions(scene_of(scenario)) if words.startswith(OF_BAND)]


def bands(shift: float, turn: float) -> list[float]:
    return [shift] * 3 + [turn] * 3


def test_a_band_beyond_the_offset_under_the_weight_is_named_with_one_that_settles() -> None:
    """Up to twice the band the integral does not begin: a run with it is that without."""
    sag = sag_of(scene_of(soft()))
    assert sag is not None
    shift, turn = (float(np.abs(part).max()) for part in np.split(sag.shift, 2))
    wide = soft(integral=2.0, band=bands(0.6 * shift, 0.6 * turn))
    without = ended(soft())
    assert ended(wide)["final_error"] == without["final_error"] == pytest.approx(sag.pixels, rel=0.15)
    (sentence,) = of_band(wide)
    fitted = fitted_integral(scene_of(wide), sag)
    assert fitted is not None
    print(sentence, without, fitted)
    for scenario in (soft(integral=2.0, band=bands(0.4 * shift, 0.4 * turn)), wide.updated({INTEGRAL: 0.0}), soft()):
        assert not of_band(scenario)
    settled = wide.updated({BAND: fitted[1].tolist()})
    assert not of_band(settled)
    assert math.isfinite(ended(settled)["settling_time"])


def test_feedback_of_the_legs_divides_the_offset() -> None:
    """The command is that of the goal and `feedback` times what a leg is behind it: 1 + feedback times as stiff."""
    fast = {"actuators.position.speed_limit": 0.3}  # else the command may not lead the legs by what the weight needs
    feedback = 0.5 * hs.feedback_margin(soft().updated(fast))
    assert feedback > 0.3
    scenario = soft(feedback=feedback).updated(fast)
    without, sag = sag_of(scene_of(soft())), sag_of(scene_of(scenario))
    assert without is not None
    assert sag is not None
    ends = ended(scenario)["final_error"]
    print(f"feedback {feedback:.3g}: {sag.pixels:.4g} px of {without.pixels:.4g} px, run {ends:.4g} px")
    assert ends == pytest.approx(sag.pixels, rel=0.05)
    np.testing.assert_allclose(sag.legs * (1.0 + feedback), without.legs, rtol=1e-12)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_integral_that_is_fitted_settles_soft_motors_whatever_the_noise(noise: float) -> None:
    scenario = soft(noise)
    assert math.isnan(ended(scenario)["settling_time"])
    diagnosis = hs.diagnose(hs.simulate(scenario))
    remedy = diagnosis.named[0].remedy
    assert diagnosis.named[0].cause == "motors"
    assert remedy is not None
    assert remedy.works
    assert set(remedy.changes) == {INTEGRAL, BAND}
    assert remedy.changes[INTEGRAL] <= 0.5 * hs.integral_margin(scenario)
    (sentence,) = (words for words in of_positions(scene_of(scenario)) if words.startswith("actuators.motor.kp"))
    assert f"controller.tracking.integral: {remedy.changes[INTEGRAL]:g} with" in sentence
    for seed in range(3):
        assert math.isfinite(ended(scenario.updated({**remedy.changes, "seed": seed}))["settling_time"])


def test_no_integral_is_offered_where_noise_needs_a_band_that_misses_the_settling_band() -> None:
    scenario = soft(0.3)
    scene = scene_of(scenario)
    sag = sag_of(scene)
    assert sag is not None
    assert fitted_integral(scene, sag) is None
    (sentence,) = (words for words in of_positions(scene) if words.startswith("actuators.motor.kp"))
    assert "well below that offset" in sentence
    wide = scene_of(soft(0.3, integral=2.0, band=bands(0.01, 0.01)))
    (sentence,) = of_band(wide.scenario)
    assert sentence.endswith("take a larger actuators.motor.kp")


def test_an_own_integral_within_its_margin_stays() -> None:
    for integral, kept in ((1.0, True), (100.0, False)):
        scenario = soft(integral=integral)
        sag = sag_of(scene_of(scenario))
        assert sag is not None
        fitted = fitted_integral(scene_of(scenario), sag)
        assert fitted is not None
        assert (fitted[0] == integral) == kept


@pytest.mark.parametrize("feedback", [0.3, 1.0])
def test_a_feedback_whose_commands_do_not_hold_the_weight_is_named(feedback: float) -> None:
    """The command is limited to a distance from the measured legs that grows with the speed limit: runs sink below."""

    def limited(speed: float) -> tuple[list[str], float]:
        scenario = soft(feedback=feedback).updated({"actuators.position.speed_limit": speed})
        found = [words for words in of_sag(scene_of(scenario)) if "sinks" in words]
        return found, ended(scenario)["final_error"]

    (words,), sunk = limited(0.02)
    least = float(re.findall(r"a speed limit of ([\d.]+) mm/s or more", words)[0]) * 1e-3
    assert sunk > 40.0
    (_,), sinks = limited(0.95 * least)
    assert limited(least)[0] == []
    free, rests = limited(1.05 * least)
    assert free == []
    sag = sag_of(scene_of(soft(feedback=feedback)))
    assert sag is not None
    assert rests == pytest.approx(sag.pixels, rel=0.1)
    assert sinks > 2.0 * rests
