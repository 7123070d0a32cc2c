"""Gains that `check` calls too slow for the run, and steps that it calls too long, against closed forms and runs."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import fastest_rate
from hexservo.findings.home_loop import image_errors
from without_runs import unlikely_without_runs

ALONE: dict[str, Any] = {f"uncertainty.{name}": 0.0 for name in ("inertia", "coriolis", "gravity", "depth")}


def with_gains(scenario: hs.Scenario, law: str, gains: dict[str, Any]) -> hs.Scenario:
    keys = {f"controller.{law}.{name}": value for name, value in gains.items()}
    return scenario.updated({**ALONE, "robot.force_limit": 1e9, "controller.law": law, **keys})


def slow(scenario: hs.Scenario) -> list[str]:
    return [
        words
        for words in unlikely_without_runs(scenario)
        if "too slow for the run" in words or "nothing pulls" in words
    ]


def too_long(scenario: hs.Scenario) -> list[str]:
    return [words for words in unlikely_without_runs(scenario) if words.startswith("simulation.step: a step of")]


# ---- Too slow -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kp", "kd"), [(1e-4, 4e-2), (0.04, 40.0), (1.0, 40.0), (0.09, 0.6), (10.0, 40.0)])
def test_what_is_left_is_that_of_the_second_order_in_closed_form(paper: hs.Scenario, kp: float, kd: float) -> None:
    """computed_torque: s^2 + kd s + kp for each axis, whose fastest pole is that of the damping whatever kp is."""
    scenario = with_gains(paper, "computed_torque", {"kp": kp, "kd": kd, "prior": 1e-9})
    roots = np.roots([1.0, kd, kp]) + np.array([1e-7, -1e-7])  # the double pole is the limit of two
    shares = np.array([-roots[1], roots[0]]) / (roots[0] - roots[1])
    left = float((shares * np.exp(roots * scenario.simulation.duration)).sum().real)
    assert min(image_errors(scene_of(scenario))) == pytest.approx(left, rel=1e-3, abs=1e-6)
    assert bool(slow(scenario)) == (left > 0.5)


def test_the_warning_begins_at_half_of_the_image_error(paper: hs.Scenario) -> None:
    """resolved_rate: exp(-gain T), as in runs."""
    half = math.log(2.0) / paper.simulation.duration
    for gain, warned in ((0.95 * half, True), (1.05 * half, False)):
        scenario = with_gains(paper, "resolved_rate", {"gain": gain, "damping": 0.0})
        assert bool(slow(scenario)) == warned
        errors = np.abs(np.asarray(hs.simulate(scenario).feature_error)).max(axis=1)
        assert bool(errors.min() > 0.5 * errors[0]) == warned


@pytest.mark.parametrize(
    ("law", "gains"),
    [
        ("computed_torque", {"kp": 0.04}),
        ("computed_torque", {"kp": 1.0}),
        ("pbvs", {"kp": 1e-4}),
        ("pbvs", {"kp": 0.01}),
        ("resolved_rate", {"gain": 0.1}),
    ],
)
def test_runs_leave_what_is_named(paper: hs.Scenario, law: str, gains: dict[str, float]) -> None:
    scenario = with_gains(paper, law, gains)
    (words,) = slow(scenario)
    found = re.search(r"linear loop ([0-9.]+) % of the image error", words)
    assert found
    errors = np.abs(np.asarray(hs.simulate(scenario).feature_error)).max(axis=1)
    assert 0.01 * float(found[1]) == pytest.approx(float(errors.min() / errors[0]), abs=0.03)


@pytest.mark.parametrize(("law", "gain"), [("pbvs", "kp"), ("kelly", "kp"), ("computed_torque", "kp")])
def test_without_stiffness_nothing_pulls(paper: hs.Scenario, law: str, gain: str) -> None:
    (words,) = slow(with_gains(paper, law, {gain: 0.0}))
    assert words.startswith(f"controller.{law}: nothing pulls to the goal")
    assert words.endswith(f"controller.{law}.auto.bandwidth fits gains to the machine")
    fitted = with_gains(paper, law, {"auto.bandwidth": 2.0})
    assert slow(fitted) == []
    (words,) = slow(with_gains(fitted, law, {gain: 0.0}))
    assert words.endswith(f"null for controller.{law}.{gain} leaves them to controller.{law}.auto")


def test_without_a_gain_of_the_image_nothing_pulls(paper: hs.Scenario) -> None:
    (words,) = slow(with_gains(paper, "resolved_rate", {"gain": 0.0}))
    assert "nothing pulls to the goal" in words


def test_adaptation_that_pulls_without_a_stiffness_is_none_of_them() -> None:
    """composite: the weights integrate the pose error, and the run settles."""
    scenario = hs.load_scenario("paper-composite").updated({"controller.composite.kt": 0.0})
    assert slow(scenario) == []
    assert np.isfinite(hs.metrics(hs.simulate(scenario))["settling_time"])


@pytest.mark.parametrize("name", hs.scenario_names())
def test_gains_of_packaged_scenarios_are_fast_enough_and_their_steps_short_enough(name: str) -> None:
    scenario = hs.load_scenario(name)
    assert slow(scenario) + too_long(scenario) == []


# ---- The step of the integration ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "gains"),
    [
        ("pbvs", {"kp": 1.0, "kd": [240.0] * 3 + [0.6, 0.6, 1.2]}),
        ("kelly", {"kd": [240.0] * 3 + [0.6, 0.6, 1.2]}),
        ("computed_torque", {"kd": 3000.0, "kp": 250000.0}),
        ("resolved_rate", {"ki": [300.0] * 3 + [0.75, 0.75, 1.5]}),
        ("pbvs", {"kp": [6e6] * 3 + [1e4] * 3, "kd": [100.0] * 3 + [0.1] * 3}),
    ],
)
def test_a_run_diverges_beyond_the_step_that_is_named(paper: hs.Scenario, law: str, gains: dict[str, Any]) -> None:
    scenario = with_gains(paper, law, gains)
    (words,) = too_long(scenario)
    found = re.search(r"take at most ([0-9.]+) (\w+), or lower gains", words)
    assert found
    step = float(found[1]) * {"us": 1e-6, "ms": 1e-3}[found[2]]
    for factor, diverges in ((0.98, False), (1.06, True)):
        own = factor * step
        other = scenario.updated({"simulation": {"step": own, "duration": 400 * own}})
        assert bool(too_long(other)) == diverges
        assert (hs.simulate(other).outcome != "completed") == diverges


def test_the_longest_step_of_a_damper_is_2_785_time_constants(paper: hs.Scenario) -> None:
    """R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24 is 1 at z = -2.7853; sampled ticks have their own sentence."""
    border = min(root.real for root in np.roots([1 / 24, 1 / 6, 1 / 2, 1.0, 0.0]) if abs(root.imag) < 1e-9)
    assert border == pytest.approx(-2.7853, abs=1e-4)
    scenario = with_gains(paper, "kelly", {"kd": 0.1})
    longest = -border / fastest_rate(scene_of(scenario))
    for factor, named in ((0.999, False), (1.001, True)):
        step = {"simulation.step": factor * longest, "simulation.duration": 100 * factor * longest}
        assert bool(too_long(scenario.updated(step))) == named
        assert too_long(scenario.updated({**step, "simulation.mode": "sampled"})) == []


def test_an_undamped_loop_is_judged_by_the_imaginary_axis(paper: hs.Scenario) -> None:
    """hybrid has Coulomb damping alone: the method takes frequencies up to 2.828/h."""
    scenario = with_gains(paper, "hybrid", {"kv": 0.0, "fuzzy.enabled": False})
    longest = math.sqrt(8.0) / fastest_rate(scene_of(scenario))
    for factor, named in ((0.99, False), (1.01, True)):
        step = {"simulation.step": factor * longest, "simulation.duration": 1000 * factor * longest}
        assert bool(too_long(scenario.updated(step))) == named
        assert (hs.simulate(scenario.updated(step)).outcome != "completed") == named


# ---- Adaptation that is too slow ------------------------------------------------------------------------------------

DRIVE = "controller.composite.drive"


def adapting(share: float, changes: dict[str, Any] | None = None) -> hs.Scenario:
    """Return a machine with fitted gains but a share of the drive, without model errors, for 5 s."""
    scenario = hs.Scenario(
        name="adapting",
        robot={"preset": "pi_h824"},
        camera={"focal_pixels": 1667.0},
        target={
            "tag": {"size": 0.08, "pose": [0.0, 0.0, -0.559, 0.0, 0.0, 0.0]},
            "desired_pose": [0.002, -0.001, 0.001, -0.005, -0.008, 0.01],
        },
        controller={"law": "composite", "composite": {"auto": {"bandwidth": 1.5}}},
        simulation={"step": 1e-3, "duration": 5.0},
    )
    drive = share * np.asarray(scenario.controller.gains.drive)
    return scenario.updated({DRIVE: np.broadcast_to(drive, 6).tolist(), **(changes or {})})


def adaptation(scenario: hs.Scenario) -> list[str]:
    return [words for words in unlikely_without_runs(scenario) if "adapt too slowly" in words]


@pytest.mark.parametrize("share", [0.1, 0.05])
def test_a_drive_that_adapts_too_slowly_leaves_what_is_named(share: float) -> None:
    scenario = adapting(share)
    (words,) = adaptation(scenario)
    assert words.startswith(f"{DRIVE}: the fuzzy systems adapt too slowly for the run of 5 s: ")
    assert words.endswith(f"null for {DRIVE} leaves them to controller.composite.auto")
    found = re.search(r"about ([\d.]+) px of the image error", words)
    assert found is not None
    left = float(np.abs(np.asarray(hs.simulate(scenario).feature_error[-1])).max())
    assert left == pytest.approx(float(found[1]), rel=0.1)
    assert math.isnan(hs.metrics(hs.simulate(scenario))["settling_time"])


def test_a_drive_that_has_time_enough_or_no_adaptation_is_not_named() -> None:
    for scenario in (
        adapting(0.6),
        adapting(0.1, {"simulation.duration": 20.0}),
        adapting(0.1, {"controller.composite.fuzzy.enabled": False, "uncertainty.gravity": 0.0}),
    ):
        assert adaptation(scenario) == []
        assert math.isfinite(hs.metrics(hs.simulate(scenario))["settling_time"])


def test_an_adaptation_whose_inputs_saturate_is_not_judged_by_the_linear_loop() -> None:
    """composite-30hz has a wide rate_scale: with 0.03 times its drive it settles as before, and 3.9 px were named."""
    scenario = hs.load_scenario("composite-30hz")
    slow_drive = scenario.updated({DRIVE: (0.03 * np.asarray(scenario.controller.gains.drive)).tolist()})
    assert adaptation(slow_drive) == []
    assert hs.metrics(hs.simulate(slow_drive))["settling_time"] < 0.1


def test_a_slow_part_of_the_image_error_matters_beside_the_band() -> None:
    """4.5 of 46 px are slow with `kelly`: a band that has room for them is reached as fast as the bandwidth has it."""
    bandwidth = 2.0
    kelly = {"controller.law": "kelly", "controller.kelly": {"auto": {"bandwidth": bandwidth}}}
    scenario = hs.load_scenario("pi-h824", {**kelly, "simulation.duration": 20.0})
    for band, slow in ((2.0, True), (12.0, False)):
        wide = scenario.updated({"metrics.band": band})
        found = [words for words in unlikely_without_runs(wide) if "of the features' common motion" in words]
        periods = bandwidth * hs.metrics(hs.simulate(wide))["settling_time"]
        assert (len(found) == 1) == slow
        assert periods > 10.0 if slow else periods < 1.0
