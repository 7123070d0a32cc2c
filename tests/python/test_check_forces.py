"""Forces of the legs at the start: those of a run, of its noise, and the bandwidth for which the legs are enough."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_forces import start_forces
from without_runs import unlikely_without_runs

RUNS = 400
TWIST = [0.2, 0.1, 0.0, 0.0, 0.0, 0.5]  # [m/s; rad/s]


def machine(law: str, bandwidth: float, **changes: Any) -> hs.Scenario:
    """A machine of 5 kg over a tag, whose camera has noise and whose legs have encoders."""
    angles = np.radians([-50.0, 50.0, 70.0, 170.0, 190.0, 290.0]), np.radians([-10, 10, 110, 130, 230, 250])
    scenario = hs.Scenario.from_mapping(
        {
            "name": "five-kg",
            "robot": {
                "platform_radius": 0.1,
                "platform_angles": angles[0].tolist(),
                "base_radius": 0.15,
                "base_angles": angles[1].tolist(),
                "home_position": [0.0, 0.0, -0.16],
                "stroke": 0.015,
                "mass": 5.0,
                "inertia": [0.0125, 0.0125, 0.025],
                "force_limit": 49.0,
            },
            "camera": {"focal_pixels": 1500.0, "noise": 0.2, "period": 1 / 30, "prediction": "encoder"},
            "target": {
                "tag": {"size": 0.082, "pose": [0.0, 0.0, -0.66, 0.0, 0.0, 0.0]},
                "desired_pose": [0.003, -0.002, 0.002, -0.0087, -0.0087, 0.0175],
            },
            "sensors": {"pose": "encoders", "resolution": 1e-6},
            "controller": {"law": law, "switching": {"kind": "implicit_coupled" if law == "composite" else "sign"}},
            "simulation": {"mode": "sampled", "step": 1 / 600, "duration": 1.0},
        }
    )
    return scenario.updated({f"controller.{law}.auto.bandwidth": bandwidth, **changes})


def needs(scenario: hs.Scenario) -> list[str]:
    return [
        sentence
        for sentence in unlikely_without_runs(scenario)
        if " at the start" in sentence and " needs " in sentence
    ]


def enough(sentence: str) -> float:
    found = re.search(r"enough for ([\d.e+-]+) Hz", sentence)
    assert found is not None, sentence
    return float(found[1])


@pytest.mark.parametrize("law", ["composite", "resolved_rate", "pbvs", "computed_torque", "kelly"])
def test_the_noise_of_the_forces_is_that_of_runs(law: str) -> None:
    """Of 400 seeds: the first tick has a frame, the second one the rates of noisy readings too."""
    base = machine(law, 2.0, **{"sensors.resolution": 0.0, "simulation.duration": 1 / 300})
    for changes, tick in (({}, 0), ({"camera.noise": 0.0, "sensors.noise": 2e-6}, 1)):
        scenario = base.updated(changes)
        batch = hs.simulate_batch(scenario, {"seed": np.arange(float(RUNS))}, log="trajectory")
        measured = batch.samples["leg_forces"][:, tick].std(axis=0, ddof=1)
        expected = start_forces(scene_of(scenario)).noise
        np.testing.assert_allclose(measured, expected, rtol=4.0 / np.sqrt(2.0 * RUNS))  # four deviations of a deviation


def test_noise_that_the_legs_are_too_weak_for() -> None:
    """Without noise the run stays below half of the limit, with it and without a sentence near it; else far beyond."""
    silent, quiet = (hs.metrics(hs.simulate(machine("resolved_rate", 3.0, **{"camera.noise": n}))) for n in (0.2, 0.0))
    assert quiet["peak_leg_force"] < 0.5 * 49.0
    assert not needs(machine("resolved_rate", 3.0))
    assert silent["peak_leg_force"] < 1.1 * 49.0
    (sentence,) = needs(machine("resolved_rate", 8.0))
    parts = re.search(
        r"needs (\d+) N of .* \(([\d.]+) N, and (\d+) N for three standard deviations of the noise\)", sentence
    )
    assert parts is not None, sentence
    whole, alone, noise = map(float, parts.groups())
    assert whole == pytest.approx(alone + noise, abs=1.0)
    assert alone < 49.0 < noise
    assert not needs(machine("resolved_rate", 8.0, **{"camera.noise": 0.0}))
    loud = hs.metrics(hs.simulate(machine("resolved_rate", 8.0)))["peak_leg_force"]
    assert loud == pytest.approx(whole, rel=0.4)


@pytest.mark.parametrize("law", ["composite", "resolved_rate", "pbvs", "computed_torque"])
def test_legs_are_enough_for_the_bandwidth_that_is_named(law: str) -> None:
    """Forces of a run: with 600 ticks of noise, up to four of its deviations or five."""
    most = enough(needs(machine(law, 30.0))[0])
    assert not needs(machine(law, most))
    assert needs(machine(law, 1.02 * most))
    peak = hs.metrics(hs.simulate(machine(law, most)))["peak_leg_force"]
    forces = start_forces(scene_of(machine(law, most)))
    assert peak < 49.0 + 2.0 * float(forces.noise.max())


@pytest.mark.parametrize("law", ["composite", "resolved_rate", "pbvs", "computed_torque"])
def test_a_twist_at_the_start_needs_a_force_that_grows_with_the_bandwidth_and_not_with_its_square(law: str) -> None:
    exact = {"camera.noise": 0.0, "sensors.pose": "true", "sensors.resolution": 0.0, "simulation.duration": 1 / 300}
    moving = {"simulation.start.twist": TWIST, **exact}
    most = enough(needs(machine(law, 30.0, **moving))[0])
    for factor, beyond in ((1.0, False), (1.01, True)):
        scenario = machine(law, factor * most, **moving)
        assert bool(needs(scenario)) == beyond
        assert (np.abs(hs.simulate(scenario).leg_forces[0]).max() > 49.0) == beyond
    between = 0.5 * (most + enough(needs(machine(law, 30.0, **exact))[0]))
    assert needs(machine(law, between, **moving))[0].endswith("Hz with simulation.start.twist: 0")
    assert not needs(machine(law, between, **exact))


def test_initial_weights_need_a_force_that_no_bandwidth_changes(paper: hs.Scenario) -> None:
    key = "controller.hybrid.fuzzy.initial_scale"
    for changes in ({}, {"controller.hybrid.auto.bandwidth": 5.0}, {"controller.hybrid.auto.bandwidth": 0.5}):
        scenario = paper.updated({key: -1.0, **changes, "simulation.duration": 0.01})
        (sentence,) = needs(scenario)
        assert sentence.endswith(f"; with {key}: 0 it is enough")
        assert ("too little for any bandwidth" in sentence) == bool(changes)
        assert np.abs(hs.simulate(scenario).leg_forces[0]).max() > scenario.robot.force_limit
        assert not needs(scenario.updated({key: 0.0}))


def test_a_weight_that_the_law_assumes_and_the_legs_do_not_have() -> None:
    """Also where they carry the true one: no force limit below what a run takes is without a sentence."""
    scenario = hs.load_scenario("hand-eye").updated({"uncertainty.gravity": 0.1, "simulation.duration": 1.0})
    peak = hs.metrics(hs.simulate(scenario))["peak_leg_force"]
    for limit in np.linspace(0.1, 0.99, 12) * peak:
        weak = scenario.updated({"robot.force_limit": limit})
        assert [text for text in unlikely_without_runs(weak) if " needs " in text and "leg " in text], limit
    scene = scene_of(scenario)
    assumed = float(np.abs(start_forces(scene).weight).max())
    true = float(np.abs(scene.resting_forces(scene.home)).max())
    assert true == pytest.approx(0.9 * assumed)
    stated = (f"takes {1e3 * assumed:.0f} mN", f"the true one {1e3 * true:.0f} mN (uncertainty.gravity)")
    for changes in ({}, {"controller.composite.auto.bandwidth": 1.0}):
        between = scenario.updated({"robot.force_limit": 0.5 * (assumed + true), **changes})
        (sentence,) = (text for text in unlikely_without_runs(between) if "the law assumes" in text)
        assert all(text in sentence for text in stated), sentence
    assert not needs(scenario.updated({"robot.force_limit": 1.1 * peak}))


def test_a_weight_that_the_legs_have_at_home_and_not_at_the_start() -> None:
    """The leg forces of a platform that is tilted are those of the sentence."""
    tilted = {"simulation.start.pose": [0.0, 0.0, 0.0, 0.06, 0.0, 0.0], "uncertainty.gravity": 0.0}
    scenario = hs.load_scenario("hand-eye").updated(tilted)
    scene = scene_of(scenario)
    home, start = (float(np.abs(scene.resting_forces(pose)).max()) for pose in (scene.home, scene.start))
    assert home < 0.99 * start
    (sentence,) = needs(scenario.updated({"robot.force_limit": 0.5 * (home + start)}))
    assert sentence.endswith("stronger legs, or another start")
    assert f"takes {1e3 * start:.0f} mN" in sentence
