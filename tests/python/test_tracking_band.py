"""Bands of the law `tracking` in which its integral never begins, as noise moves the estimate of the target."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_tracking import _REMEMBERED, of_tracking, off_reference
from hexservo.scenario.laws import Tracking

BAND = "controller.tracking.band"


def soft(band: float, turn: float, integral: float, noise: float = 0.5) -> hs.Scenario:
    """Return a hexapod whose legs rest short of where they are sent, with a band [m; rad]."""
    return hs.load_scenario("pi-h824-positions").updated(
        {
            "actuators.kind": "position_torque",
            "actuators.motor": {"kp": 2e4, "kv": 2e3, "damping": 100.0, "friction": 3.0, "armature": 0.5},
            "simulation": {"substeps": 40, "duration": 12.0},
            "camera.noise": noise,
            "controller.tracking": {"noise": 0.5, "integral": integral, "band": [band] * 3 + [turn] * 3},
        }
    )


def acts(band: float, turn: float, noise: float = 0.5) -> bool:
    """Return whether the integral changes a run."""
    runs = [hs.simulate(soft(band, turn, integral, noise)) for integral in (0.0, 2.0)]
    return not np.array_equal(runs[0].leg_lengths, runs[1].leg_lengths)


def stated(scenario: hs.Scenario) -> list[str]:
    return [text for text in of_tracking(scene_of(scenario)) if text.startswith(BAND)]


def test_a_band_within_the_noise_of_the_estimate_is_named_with_one_that_acts() -> None:
    scenario = soft(1e-6, 2e-3, 2.0)
    gains = scenario.controller.gains
    assert isinstance(gains, Tracking)
    off = off_reference(scene_of(scenario), gains)
    narrow = 0.3 * float(off[:3].max()), 0.3 * float(off[3:].max())
    (sentence,) = stated(soft(*narrow, 2.0))
    print(off, sentence)
    assert not acts(*narrow)
    wide = 3.0 * float(off[:3].max()), 3.0 * float(off[3:].max())
    assert not stated(soft(*wide, 2.0))
    assert acts(*wide)
    assert not stated(soft(*narrow, 0.0))
    assert not stated(soft(*narrow, 2.0, noise=0.0))
    assert acts(*narrow, noise=0.0)


def test_the_line_remembers_as_many_frames_as_that_of_the_core() -> None:
    header = (Path(__file__).parents[2] / "cpp" / "include" / "hexservo" / "target_filter.hpp").read_text()
    assert f"kLineFrames = {_REMEMBERED:.1f};" in header
