"""Gains that fit: formulas by other means, one loop for scaled machines, and how alike random machines settle."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hexservo as hs
from fitted_machines import (
    BAND,
    MODES,
    SEED,
    STARTS,
    Array,
    Row,
    draw,
    image,
    rotation,
    row,
    scenario_of,
    settled,
    variations,
    warned,
)
from hexservo.cli.commands import app
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_forces import start_forces
from hexservo.findings.check_gains import image_delay, of_gains, smoothing_lag
from hexservo.findings.check_keys import keys_without_effect
from hexservo.run.export import gains_header
from hexservo.scenario.fitted import chosen_keys, fitted_keys, gains_written, machine_of
from hexservo.scenario.keys import default_of, value_at
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import actuators_lag, core_parameters
from without_runs import unlikely_without_runs

SECOND_ORDER = ("composite", "resolved_rate", "pbvs", "computed_torque")


def with_auto(scenario: hs.Scenario, law: str, bandwidth: float, **changes: Any) -> hs.Scenario:
    return scenario.updated({"controller.law": law, f"controller.{law}.auto.bandwidth": bandwidth, **changes})


def gains_of(scenario: hs.Scenario) -> dict[str, Array]:
    law = scenario.controller.law
    return {key: np.asarray(value_at(scenario, f"controller.{law}.{key}"), dtype=float) for key in fitted_keys(law)}


# ---- Formulas -------------------------------------------------------------------------------------------------------


def test_the_machine_is_that_of_differences_of_the_image(paper: hs.Scenario) -> None:
    """s_v, s_omega and rho from central differences of the pinhole equation, at a goal beside home."""
    focal, home = 581.816, np.array([0.0, 0.0, -0.15])
    points = np.array([[0.05, 0.04, -0.6], [0.06, -0.07, -0.63], [-0.05, -0.05, -0.66], [-0.04, 0.06, -0.64]])
    position, turn = home + np.array([0.004, -0.006, 0.008]), np.array([0.02, -0.03, 0.1])
    desired = image(focal, points, position, rotation(turn))
    inertia = np.array([[1.5e-4, 1e-5, 0.0], [1e-5, 1.2e-4, 0.0], [0.0, 0.0, 2.2e-4]])
    scenario = paper.updated(
        {
            "target": {"initial_features": None, "depth": None, "points": points, "desired_features": desired},
            "robot.inertia": inertia,
        }
    )
    step = 1e-5
    columns = []
    for way in np.eye(6):
        there = [
            image(focal, points, position + sign * step * way[:3], rotation(sign * step * way[3:]) @ rotation(turn))
            for sign in (1, -1)
        ]
        columns.append((there[0] - there[1]) / (2 * step))
    jacobian = np.column_stack(columns)
    mass = np.zeros((6, 6))
    mass[:3, :3], mass[3:, 3:] = 0.06 * np.eye(3), rotation(turn) @ inertia @ rotation(turn).T
    machine = machine_of(scenario)
    np.testing.assert_allclose(machine.inertia, np.diag(mass), rtol=1e-9)  # the goal to 1e-10 rad
    sight = [np.sqrt((block**2).sum() / 8) for block in (jacobian[:, :3], jacobian[:, 3:])]
    np.testing.assert_allclose(machine.sight, np.repeat(sight, 3), rtol=1e-8)  # step^2 = 1e-10, rounding 1e-10/step/s
    moved = jacobian @ np.linalg.inv(mass) @ jacobian.T
    shift = np.tile([1.0, 0.0], 4) / 2.0, np.tile([0.0, 1.0], 4) / 2.0
    np.testing.assert_allclose(machine.pointing, [u @ moved @ u for u in shift], rtol=1e-7)


def test_the_paper_s_machine_has_the_default_gains_at_its_bandwidth(paper: hs.Scenario) -> None:
    """omega^2 = k_p rho with the default k_p; docs/gains.md takes the constants of `hybrid` from there."""
    bandwidth = math.sqrt(1e-6 * math.sqrt(np.prod(machine_of(paper).pointing))) / (2 * math.pi)
    assert bandwidth == pytest.approx(15.28, abs=0.01)
    for key, value in gains_of(with_auto(paper, "hybrid", bandwidth)).items():
        np.testing.assert_allclose(value, default_of(f"controller.hybrid.{key}") * np.ones_like(value), rtol=1e-2)


@pytest.mark.parametrize("law", [*SECOND_ORDER, "kelly"])
@pytest.mark.parametrize(
    ("damping", "weights"),
    [(0.6, 1.0), (1.0, 1.0), (2.0, 1.0), (1.0, [9.0, 1.0, 1.0, 1.0])],
)
def test_the_error_follows_the_second_order_equation(
    paper: hs.Scenario, law: str, damping: float, weights: float | list[float]
) -> None:
    """e'' + 2 zeta omega e' + omega^2 e = 0 from rest; for composite too, whose integrating pole is cancelled.

    For kelly from a common shift of the features. Without friction; what is allowed is the prior's share. Whatever the
    points count.
    """
    bandwidth = 3.0
    turned = image(
        581.816, scene_of(paper).points, np.array(paper.robot.home_position), rotation(np.r_[2e-3, -1e-3, 0])
    )
    scenario = with_auto(paper, law, bandwidth, **{f"controller.{law}.auto.damping": damping})
    scenario = scenario.updated(
        {
            "target.desired_features": turned,
            "target.weights": weights,
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "depth": 0.0},
            "simulation": {"duration": 0.5, "step": 1e-3},
            "controller.composite.kv": 0.0,
        }
    )
    run = hs.simulate(scenario)
    omega = 2 * math.pi * bandwidth
    poles = np.roots([1.0, 2 * damping * omega, omega**2]).astype(complex)
    if abs(poles[0] - poles[1]) < 1e-3 * omega:
        expected = (1 + omega * run.time) * np.exp(-omega * run.time)
    else:
        first, second = poles
        expected = ((first * np.exp(second * run.time) - second * np.exp(first * run.time)) / (first - second)).real
    start = run.feature_error[0]
    error = run.feature_error @ start / (start @ start)
    allowed = {"composite": 0.05, "kelly": 0.01, "resolved_rate": 0.005, "pbvs": 0.005, "computed_torque": 0.01}[law]
    assert np.abs(error - expected).max() < allowed


# ---- In a scenario --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
def test_what_is_given_wins_key_by_key(paper: hs.Scenario, law: str) -> None:
    fitted = with_auto(paper, law, 4.0)
    assert chosen_keys(fitted) == ()
    for key in fitted_keys(law):
        dotted = f"controller.{law}.{key}"
        mine = (1.5 * gains_of(fitted)[key]).tolist()
        own = fitted.updated({dotted: mine})
        assert chosen_keys(own) == (key,)
        np.testing.assert_array_equal(gains_of(own)[key], mine)
        for other in set(fitted_keys(law)) - {key}:
            np.testing.assert_array_equal(gains_of(own)[other], gains_of(fitted)[other])
        assert own.updated({dotted: None}) == fitted  # null leaves it to auto
        faster = own.updated({f"controller.{law}.auto.bandwidth": 8.0})
        np.testing.assert_array_equal(gains_of(faster)[key], mine)
    defaults = paper.updated({"controller.law": law})
    assert fitted.updated({f"controller.{law}.auto": None}) == defaults
    assert (
        fitted.updated({"controller.law": "kelly" if law == "hybrid" else "hybrid"}).updated({"controller.law": law})
        == fitted
    )


@pytest.mark.parametrize("law", LAWS)
def test_gains_follow_the_machine_and_stay_in_a_file(paper: hs.Scenario, law: str) -> None:
    fitted = with_auto(paper, law, 4.0)
    again = hs.Scenario.from_yaml(fitted.to_yaml())
    assert again == fitted
    assert value_at(again, f"controller.{law}.auto.bandwidth") == 4.0
    heavier = again.updated({"robot.mass": 0.12, "target.depth": 0.7})
    assert heavier == with_auto(paper.updated({"robot.mass": 0.12, "target.depth": 0.7}), law, 4.0)
    assert heavier != fitted
    other = again.updated({"uncertainty.depth": -0.2, "uncertainty.inertia": 0.01, "simulation.duration": 1.0})
    assert gains_of(other).keys() == gains_of(fitted).keys()
    for key, value in gains_of(other).items():  # the numbers are those of the machine without its errors
        np.testing.assert_array_equal(value, gains_of(fitted)[key])
    settings = core_parameters(fitted)  # from where controllers, exports, batches and analyses take them
    for key, value in gains_of(fitted).items():
        given = np.asarray(settings[f"controller.{law}.{key}"])
        np.testing.assert_array_equal(np.broadcast_to(value, given.shape), given)


def test_show_prints_the_numbers(paper: hs.Scenario) -> None:
    shown = CliRunner().invoke(app, ["show", "paper-composite", "--set", "controller.composite.auto.bandwidth=2"])
    assert shown.exit_code == 0
    kt = hs.Scenario.from_yaml(shown.stdout).controller.composite.kt
    np.testing.assert_allclose(kt, (4 * math.pi) ** 2 * machine_of(paper).inertia, rtol=1e-12)


def test_controllers_and_exported_headers_have_the_numbers(paper: hs.Scenario) -> None:
    """At home, at rest, `pbvs` gives K_p times the displacement to the goal: four times as much for twice the f."""
    scene = scene_of(paper)
    view = scene.view(scene.home)
    spring = {}
    for bandwidth in (2.0, 4.0):
        controller = hs.Controller(with_auto(paper, "pbvs", bandwidth))
        out = controller.step(view.features, view.depth, scene.home.position, scene.home.quaternion, np.zeros(6))
        spring[bandwidth] = np.asarray(out.wrench) - scene.body.gravity_wrench
    np.testing.assert_allclose(spring[4.0], 4.0 * spring[2.0], rtol=1e-9, atol=1e-12)
    fitted = with_auto(paper, "pbvs", 2.0)
    numbers = {f"controller.pbvs.{key}": value.tolist() for key, value in gains_of(fitted).items()}
    written = fitted.updated({**numbers, "controller.pbvs.auto": None})
    assert written.controller.pbvs.auto.bandwidth is None
    assert gains_header(fitted) == gains_header(written)


@pytest.mark.parametrize("law", LAWS)
def test_a_batch_fits_each_run(paper: hs.Scenario, law: str) -> None:
    short = paper.updated({"controller.law": law, "simulation.duration": 0.1})
    auto = f"controller.{law}.auto"
    variations: list[dict[str, Array]] = [
        {f"{auto}.bandwidth": np.array([1.0, 3.0]), f"{auto}.damping": np.array([0.7, 2.0])},
        {f"{auto}.bandwidth": np.array([2.0]), "robot.mass": np.array([0.05, 0.2])},
        {f"{auto}.bandwidth": np.array([2.0]), "target.depth": np.array([[0.5, 0.6, 0.5, 0.4], [1.0, 1.1, 1.2, 1.0]])},
        {f"{auto}.bandwidth": np.array([1.0, 3.0]), f"controller.{law}.{fitted_keys(law)[0]}": np.array([1e-6, 2e-6])},
    ]
    for base in (short, with_auto(short, law, 5.0)):
        for varied in variations:
            batch = hs.simulate_batch(base, varied)
            for index in range(2):
                row = {key: values[index % len(values)].tolist() for key, values in varied.items()}
                run = hs.simulate(base.updated(row))
                np.testing.assert_allclose(
                    batch.samples["feature_error"][index], run.feature_error[-1], rtol=1e-7, atol=1e-7
                )
    with pytest.raises(ValueError, match=rf"^{auto}\.damping: expected {auto}\.bandwidth beside it, got null$"):
        hs.simulate_batch(short, {f"{auto}.damping": [1.0, 2.0]})
    with pytest.raises(ValueError, match=rf"^{auto}\.damping: expected {auto}\.bandwidth beside it, got null$"):
        hs.simulate_batch(short, {f"{auto}.damping": [1.0, 2.0], "robot.mass": [0.06]})


def test_gains_without_a_pose_of_the_goal_are_those_of_home(paper: hs.Scenario) -> None:
    crossed = paper.updated({"target.desired_features": [10, 10, -64, 29, 45, -73, -30, -23]})
    printed = paper.updated({"camera.convention": "as_printed"})
    for scenario in (crossed, printed):
        machine = machine_of(scenario)
        np.testing.assert_allclose(machine.inertia, [0.06, 0.06, 0.06, 1.5e-4, 1.5e-4, 3e-4], rtol=1e-12)
        assert 0.9 < machine.distance[0] / 0.5 < 1.1
        assert np.isfinite(gains_of(with_auto(scenario, "hybrid", 4.0))["kp"]).all()


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"controller.hybrid.auto.bandwidth": 0.0}, "controller.hybrid.auto.bandwidth: expected a number >= 1e-06 and"),
        ({"controller.hybrid.auto.damping": 0.0}, "controller.hybrid.auto.damping: expected a number >= 0.01 and"),
        ({"controller.hybrid.auto": {"frequency": 1.0}}, "controller.hybrid.auto.frequency: unknown key"),
        ({"controller.hybrid.auto": 2.0}, "controller.hybrid.auto: expected a block with the keys bandwidth, damping"),
        (
            {"controller.hybrid.auto.bandwidth": 2.0, "robot.mass": -1.0},
            "robot.mass: expected a number > 0 and < 1e+09, got -1.0",
        ),
    ],
)
def test_refusals(paper: hs.Scenario, changes: dict[str, Any], line: str) -> None:
    with pytest.raises(hs.ScenarioError) as caught:
        paper.updated(changes)
    assert caught.value.problems[0].startswith(line)


# ---- Similar machines -----------------------------------------------------------------------------------------------


def scaled(scenario: hs.Scenario, mass: float, length: float, time: float, **others: Any) -> hs.Scenario:
    """The machine of other mass, size and speed; an image has neither."""
    robot, law = scenario.robot, scenario.controller.law
    changes: dict[str, Any] = {
        "robot.mass": mass * robot.mass,
        "robot.inertia": (mass * length**2 * np.array(robot.inertia)).tolist(),
        "target.depth": (length * np.array(scenario.target.depth)).tolist(),
        f"controller.{law}.auto.bandwidth": value_at(scenario, f"controller.{law}.auto.bandwidth") / time,
        "robot.force_limit": mass * length / time**2 * robot.force_limit,
        "robot.gravity": (length / time**2 * np.array(robot.gravity)).tolist(),
    }
    for key in ("platform_radius", "base_radius", "home_position", "stroke"):
        changes[f"robot.{key}"] = (length * np.array(getattr(robot, key))).tolist()
    for key in ("simulation.step", "simulation.duration", "metrics.dwell", "metrics.rms_start"):
        changes[key] = time * value_at(scenario, key)
    return scenario.updated({**changes, **others})


@pytest.mark.parametrize("mode", ["continuous", "sampled"])
@pytest.mark.parametrize("law", LAWS)
def test_a_scaled_machine_runs_the_same_dimensionless_loop(paper: hs.Scenario, law: str, mode: str) -> None:
    """Powers of two scale without rounding, so that not a bit differs."""
    implicit = mode == "sampled" and law in ("hybrid", "composite")
    base = with_auto(paper, law, 4.0).updated(
        {
            "simulation": {"mode": mode, "duration": 0.5},
            "controller.switching.kind": "implicit_coupled" if implicit else "sign",
            "uncertainty": {"inertia": 0.05, "coriolis": 0.1, "gravity": 0.02, "depth": [0.05, -0.05, 0.03, 0.02]},
        }
    )
    one = hs.simulate(base)
    for mass, length, time in ((2.0**14, 4.0, 2.0), (2.0**-3, 16.0, 0.125), (1.0, 0.25, 4.0)):
        other = hs.simulate(scaled(base, mass, length, time))
        np.testing.assert_array_equal(other.features, one.features)
        np.testing.assert_array_equal(other.position / length, one.position)
        np.testing.assert_array_equal(other.leg_forces, one.leg_forces * (mass * length / time**2))
    # Other factors round: some 1e-14 px a tick, over 500 ticks, while neighbouring trajectories part.
    other = hs.simulate(scaled(base, 8333.3, 3.7, 0.31))
    np.testing.assert_allclose(other.features, one.features, atol=1e-9)


@pytest.mark.parametrize("law", ["composite", "pbvs"])
def test_the_safe_output_before_the_first_image_has_its_own_time(paper: hs.Scenario, law: str) -> None:
    """With a latency and an unknown weight: masses and lengths may change, times with gains that are written."""
    changes: dict[str, Any] = {
        "simulation": {"mode": "sampled", "duration": 0.5},
        "controller.switching.kind": "implicit",
        "uncertainty.gravity": 0.075,
    }
    turned = np.repeat([0.0, 1.0], 3)

    def run(mass: float, length: float, time: float, **safe: float) -> Array:
        camera = {"camera.period": 0.02 * time, "camera.latency": 0.06 * time}
        base = with_auto(paper, law, 2.0, **changes)
        other = scaled(base, mass, length, time, **camera)
        powers = {"damping": 1, "hold": 2}
        written = {
            f"controller.safe.{key}": (value * mass * length ** (2 * turned) / time ** powers[key]).tolist()
            for key, value in safe.items()
        }
        return np.asarray(hs.simulate(other.updated(written)).features)

    one = run(1.0, 1.0, 1.0)
    np.testing.assert_array_equal(run(2.0**14, 4.0, 1.0), one)
    for time in (0.5, 2.0):
        assert 1e-3 < np.abs(run(1.0, 1.0, time) - one).max() < 0.1  # px
    safe = {"damping": 0.5, "hold": 5.0}
    np.testing.assert_array_equal(run(8.0, 4.0, 2.0, **safe), run(1.0, 1.0, 1.0, **safe))


@pytest.mark.parametrize("follow", ["pose", "direction"])
def test_the_target_of_tracking_keeps_its_agility_where_the_machine_is_faster(paper: hs.Scenario, follow: str) -> None:
    """sigma_a and sigma_v scale with lengths, and not with times: written for the other time, the loop is the same."""
    keys = ("acceleration", "speed")
    changes: dict[str, Any] = {
        "simulation": {"mode": "sampled", "duration": 0.5},
        "actuators.kind": "position",
        "camera.noise": 0.02,
        "controller.tracking.follow": follow,
        "controller.tracking.noise": 0.02,
        "target.motion.kind": "sinusoid",
    }

    def of_world(length: float, time: float) -> dict[str, Any]:
        """Drives, camera and the target's motion."""
        return {
            "actuators.position.bandwidth": 20.0 / time,
            "camera.period": 0.01 * time,
            "camera.latency": 0.01 * time,
            "target.motion.amplitude": [0.05 * length, 0.0, 0.0],
            "target.motion.frequency": 0.5 / time,
        }

    base = with_auto(paper, "tracking", 4.0, **changes, **of_world(1.0, 1.0))

    def other(length: float, time: float) -> hs.Scenario:
        return scaled(base, 1.0, length, time, **of_world(length, time))

    one = hs.simulate(base)
    same = hs.simulate(other(4.0, 1.0)).features  # an estimate in m and rad rounds otherwise: 1e-12 px
    np.testing.assert_allclose(same, one.features, rtol=0, atol=1e-9)
    slower = other(1.0, 4.0)
    gains, slow = base.controller.tracking, slower.controller.tracking
    assert all(getattr(gains, key) == getattr(slow, key) for key in keys)
    assert np.abs(hs.simulate(slower).features - one.features).max() > 1.0  # px
    along = {"acceleration": 16.0, "speed": 4.0}
    written = {
        f"controller.tracking.{key}": (np.array(getattr(gains, key)) / scale).tolist() for key, scale in along.items()
    }
    same = hs.simulate(slower.updated(written)).features
    np.testing.assert_allclose(same, one.features, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["tanh", "saturation"])
@pytest.mark.parametrize("law", ["hybrid", "composite"])
def test_one_width_of_the_switching_term_is_for_machines_of_one_size(paper: hs.Scenario, law: str, kind: str) -> None:
    """It is in m/s and in rad/s: masses may change, and times with a width that is written; lengths with none."""
    key = "controller.switching.width"
    base = with_auto(paper, law, 4.0).updated({"simulation.duration": 0.2, "controller.switching.kind": kind})
    width = base.controller.switching.width
    one = hs.simulate(base).features

    def features(mass: float, length: float, time: float, width: float = width) -> Any:
        return hs.simulate(scaled(base, mass, length, time).updated({key: width})).features

    np.testing.assert_array_equal(features(2.0**14, 1.0, 1.0), one)
    np.testing.assert_array_equal(features(1.0, 1.0, 4.0, width / 4.0), one)
    for length, time, other in ((1.0, 4.0, width), (4.0, 1.0, width), (4.0, 1.0, 4.0 * width), (4.0, 4.0, width)):
        assert np.abs(features(1.0, length, time, other) - one).max() > 1e-6


# ---- Random machines ------------------------------------------------------------------------------------------------

# Median settling time in units of 1/f, and the share within 25 % of it of machines that `hexservo check` does not warn
# of; docs/gains.md has both for 1000 machines.
EXPECTED = {
    "hybrid": (6.6, 1.0),
    "composite": (0.82, 1.0),
    "kelly": (0.78, 1.0),
    "resolved_rate": (0.75, 1.0),
    "pbvs": (0.75, 1.0),
    "computed_torque": (0.77, 1.0),
}
# Share of machines that it may warn of; those laws pull with J^T K_p J.
MOST_WARNED = {"pointing": 0.05, "pose": 0.15}


def laws_starts_and_counts() -> list[Any]:
    """Every law from `pointing`, and from `pose` one that is warned of nearly always and one that is not.

    Of 20 machines, and behind `slow` of 60, as of `hybrid`: of its machines most are warned of.
    """
    every = [(law, start) for law in LAWS for start in STARTS]
    kept = [case for case in every if case[1] == "pointing" or case[0] in ("kelly", "composite")]
    usual = [(*case, 60 if case[0] == "hybrid" else 20) for case in kept]
    more = [(*case, 60) for case in every if (*case, 60) not in usual]
    return [*usual, *(pytest.param(*case, marks=pytest.mark.slow) for case in more)]


@pytest.mark.parametrize(("law", "start", "count"), laws_starts_and_counts())
def test_random_machines_settle_alike_or_are_warned_of(law: str, start: str, count: int) -> None:
    print(f"seed {SEED}")
    machines = draw(count, start)
    warnings = warned(law, machines)
    if law not in ("hybrid", "kelly"):
        assert warnings.mean() <= MOST_WARNED[start]
    median, least = EXPECTED[law]
    for mode in MODES:
        found = row(law, start, mode, machines, warnings)
        if start == "pointing" or law not in ("hybrid", "kelly"):
            assert (~warnings).mean() >= 0.25
            assert found.alike(~warnings) >= least
            assert found.median == pytest.approx(median, rel=0.25 if law == "hybrid" else 0.05)
        else:  # all but a few are warned of, and most of those do not settle
            assert warnings.mean() > 0.9
            assert np.isnan(found.times[warnings]).mean() > 0.5


def test_a_table_of_machines_has_none_where_there_is_no_number() -> None:
    """No warning of NumPy, which is an error in tests, and no NaN."""
    times, none = np.array([0.5, 1.0, np.nan]), np.array([np.nan] * 3)
    every, some = np.array([True] * 3), np.array([False, False, True])
    lines = [Row("kelly", "pose", "sampled", each, which).line() for each in (times, none) for which in (every, some)]
    assert lines == [
        "| `kelly` | pose | sampled | none | 0.50 … 1.00 | 33.3 % | none | 100.0 % | none |",
        "| `kelly` | pose | sampled | 0.75 | 0.50 … 1.00 | 33.3 % | 0.0 % | 33.3 % | 0.0 % |",
        "| `kelly` | pose | sampled | none | none | 100.0 % | none | 100.0 % | none |",
        "| `kelly` | pose | sampled | none | none | 100.0 % | none | 33.3 % | none |",
    ]


def test_the_settling_time_is_that_of_the_second_order_equation() -> None:
    """(1 + x) exp(-x) = 0.05 at x = omega t = 4.744; frames and steps of 0.01/f round up."""
    x = 4.744
    assert (1 + x) * math.exp(-x) == pytest.approx(BAND, rel=1e-3)
    found = np.median(settled("pbvs", draw(20, "pointing"), "continuous"))
    assert found == pytest.approx(x / (2 * math.pi), abs=0.015)


# ---- Checks ---------------------------------------------------------------------------------------------------------


def warnings_of(scenario: hs.Scenario, start: str = "controller.") -> list[str]:
    """Return those of keys; what runs near the goal come to is in `test_check_hold.py`."""
    found = [sentence for sentence in unlikely_without_runs(scenario) if sentence.startswith(start)]
    return [sentence for sentence in found if not sentence.startswith("controller.law: runs of")]


def test_a_bandwidth_is_within_a_quarter_of_the_servo_rate_and_a_tenth_of_the_run(paper: hs.Scenario) -> None:
    weak = paper.updated({"robot.force_limit": 1e9, "simulation": {"step": 1e-3, "duration": 5.0}})
    for bandwidth, words in ((0.0199, "is below 0.02 Hz"), (0.0201, ""), (249.0, ""), (251.0, "is above 250 Hz")):
        found = warnings_of(with_auto(weak, "computed_torque", bandwidth))
        assert len(found) == bool(words)
        assert all(words in sentence for sentence in found)


def test_the_force_at_the_start_is_that_of_a_run(paper: hs.Scenario) -> None:
    for law in LAWS:
        fast = with_auto(paper, law, 40.0).updated({"simulation.duration": 0.01})
        weight, rest, noise = start_forces(scene_of(fast))
        assert not noise.any()  # in continuous mode
        np.testing.assert_allclose(weight + rest, hs.simulate(fast).leg_forces[0], rtol=1e-9)
        (sentence,) = warnings_of(fast, f"controller.{law}.auto.bandwidth: 40 Hz needs")
        most = float(sentence.rpartition("enough for ")[2].removesuffix(" Hz"))
        assert 4.0 < most < 40.0
        for factor, expected in ((0.99, False), (1.01, True)):
            assert bool(warnings_of(with_auto(paper, law, factor * most), f"controller.{law}.auto")) == expected
    heavy = with_auto(paper, "kelly", 4.0).updated({"robot.force_limit": 0.1})
    assert "do not carry the weight" in warnings_of(heavy)[0]


def test_the_twist_at_the_start_counts_in_the_force(paper: hs.Scenario) -> None:
    twist = {"simulation.start.twist": [0.02, 0.0, 0.0, 0.0, 0.1, 0.0], "simulation.duration": 0.01}
    moving, resting = (with_auto(paper, "kelly", 40.0).updated(changes) for changes in (twist, {}))
    forces = [start.weight + start.law for start in map(start_forces, map(scene_of, (moving, resting)))]
    np.testing.assert_allclose(forces[0], hs.simulate(moving).leg_forces[0], rtol=1e-9)
    assert np.abs(forces[0] - forces[1]).max() > 0.3  # [N]


def test_a_law_that_pushes_against_the_weight_has_the_weight_besides(paper: hs.Scenario) -> None:
    """Down, along the weight: legs that carry less than nothing of it have what the limit leaves, and the weight."""
    goal = {"target.desired_features": hs.project(paper, [0.0, 0.0, 0.004, 0.0, 0.0, 0.0]).tolist()}
    fast = with_auto(paper, "pbvs", 40.0).updated({**goal, "simulation.duration": 0.01})
    weight, law, _ = start_forces(scene_of(fast))
    leg = int(np.abs(law).argmax())
    assert weight[leg] * law[leg] < 0.0
    (sentence,) = warnings_of(fast, "controller.pbvs.auto.bandwidth: 40 Hz needs")
    most = float(sentence.rpartition("enough for ")[2].removesuffix(" Hz"))
    limit = fast.robot.force_limit
    for bandwidth, within in ((most, True), (most + 0.2, False)):  # rounded down by less than 0.1 Hz
        run = hs.simulate(fast.updated({"controller.pbvs.auto.bandwidth": bandwidth}))
        assert bool(np.abs(run.leg_forces[0]).max() <= limit) == within


@pytest.mark.parametrize("written", [{}, {"stiffer": 2.0}, {"auto.bandwidth": 4.0, "stiffer": 2.0}], ids=str)
@pytest.mark.parametrize("law", LAWS)
def test_gains_that_the_legs_do_not_allow_are_warned_of(
    paper: hs.Scenario, law: str, written: dict[str, float]
) -> None:
    """Defaults, written gains, and some of both: the force of the law at the start, as in a run."""
    changes: dict[str, Any] = {f"controller.{law}.{key}": value for key, value in written.items() if key != "stiffer"}
    if "stiffer" in written:
        key = f"controller.{law}.{'gain' if law == 'resolved_rate' else 'kp'}"
        changes[key] = (written["stiffer"] * np.array(default_of(key))).tolist()
    base = paper.updated({"controller.law": law, "simulation.duration": 0.01, **changes})
    most = float(np.abs(hs.simulate(base).leg_forces[0]).max())

    def found(**others: Any) -> list[str]:
        scenario = base.updated({key.replace("__", "."): value for key, value in others.items()})
        return [sentence for sentence in of_gains(scene_of(scenario)) if ": the law needs" in sentence]

    (sentence,) = found(robot__force_limit=0.999 * most)
    start = rf"controller\.{law}: the law needs ([\d.]+) (m?)N of leg \d at the start, which has ([\d.]+) m?N;"
    found_in = re.match(start, sentence)
    assert found_in is not None, sentence
    scale = 1e3 if found_in[2] else 1.0
    needed, there = float(found_in[1]), float(found_in[3])
    assert needed > there  # as many digits as tell them apart, at least three
    assert [needed, there] == pytest.approx([scale * most, 0.999 * scale * most], rel=5e-3)
    assert sentence.endswith(f"; controller.{law}.auto.bandwidth fits its gains to the machine")
    assert not found(robot__force_limit=1.001 * most)
    assert not found(robot__force_limit=0.1)  # less than the weight
    limited = {"simulation__mode": "sampled", "actuators__saturation": True, "controller__switching__kind": "sign"}
    assert not found(robot__force_limit=0.999 * most, **limited)


def test_a_bound_that_is_named_holds(paper: hs.Scenario) -> None:
    """The bandwidth and its bound are both 1.57 Hz in three digits."""
    changes = {"simulation.mode": "sampled", "camera.period": 0.02, "camera.latency": 0.09}
    delay = image_delay(with_auto(paper, "pbvs", 1.0, **changes))
    changes["controller.pbvs.auto.damping"] = 1.5655 * 2.0 * math.pi * delay
    for bandwidth in (1.57, 1.5656):
        (sentence,) = warnings_of(with_auto(paper, "pbvs", bandwidth, **changes))
        assert sentence.startswith("controller.pbvs.auto.bandwidth: 1.57 Hz is above 1.56 Hz, where")
    assert not warnings_of(with_auto(paper, "pbvs", 1.56, **changes))
    brief = with_auto(paper, "pbvs", 1.9996, **{"simulation.duration": 0.05})
    (sentence,) = warnings_of(brief)
    assert sentence.startswith("controller.pbvs.auto.bandwidth: 1.9996 Hz is below 2 Hz, a tenth")


@pytest.mark.parametrize("damping", [0.5, 2.0])
def test_a_late_image_takes_what_friction_and_adaptation_damp(damping: float) -> None:
    """Other machines than those of which the bound is: all settle with a delay of 0.0094/f, none with 0.028/f."""
    machines = draw(30, "pointing", seed=21)
    fits = ~warned("hybrid", machines)
    machines = replace(machines, **{name: getattr(machines, name)[fits] for name in vars(machines)})
    assert len(machines.mass) >= 5
    periods = 1.0 / machines.bandwidth
    base = scenario_of("hybrid", machines, "sampled").updated({"controller.hybrid.auto.damping": damping})
    for ticks, settles in ((1.5, True), (4.5, False)):  # of 1/(160 f)
        late = {"simulation.step": periods / 160, "camera.latency": (ticks - 0.5) * periods / 160}
        varied = {**variations("hybrid", machines), **late}
        batch = hs.simulate_batch(base, varied, log="metrics")
        assert (np.isfinite(batch.metrics["settling_time"]) == settles).all()
        for index in range(len(periods)):
            one = base.updated({key: values[index].tolist() for key, values in varied.items()})
            assert image_delay(one) == pytest.approx(ticks * periods[index] / 160)
            assert bool(warnings_of(one, "controller.hybrid.auto.bandwidth")) != settles


def test_an_image_that_is_too_late_for_friction_and_adaptation(paper: hs.Scenario) -> None:
    """A bandwidth that the sentence names settles, and the one that it warns of diverges."""
    changes = {"simulation.mode": "sampled", "controller.switching.kind": "implicit", "camera.latency": 0.02}
    late = with_auto(paper, "hybrid", 5.0, **changes)
    (sentence,) = warnings_of(late)
    assert "takes half of what friction and adaptation damp away" in sentence
    assert hs.simulate(late).outcome == "diverged"
    most = float(re.search(r"is above ([\d.]+) Hz", sentence)[1])  # type: ignore[index]
    slow = with_auto(paper, "hybrid", most, **changes, **{"simulation.duration": 40.0})
    assert not warnings_of(slow)
    assert math.isfinite(hs.metrics(hs.simulate(slow))["settling_time"])
    assert not warnings_of(with_auto(paper, "pbvs", 5.0, **{**changes, "controller.switching.kind": "sign"}))


def test_a_late_image_takes_damping_away(paper: hs.Scenario) -> None:
    """e'' + 2 zeta omega e' + omega^2 e(t - tau) has no damping at omega tau = 2 zeta; the limit is half of that."""
    late = with_auto(paper, "computed_torque", 1.0).updated(
        {
            "simulation": {"mode": "sampled", "duration": 5.0},
            "camera": {"period": 0.02, "latency": 0.04},
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "depth": 0.0},
            "robot.force_limit": 1e9,
        }
    )
    delay = 0.0005 + 0.04 + 0.0095
    assert image_delay(late) == pytest.approx(delay)
    most = 1.0 / (2 * math.pi * delay)
    at = {share: with_auto(late, "computed_torque", share * most) for share in (0.9, 1.1, 3.0)}
    assert [bool(warnings_of(scenario)) for scenario in at.values()] == [False, True, True]
    ends = {share: hs.metrics(hs.simulate(scenario))["final_error"] for share, scenario in at.items()}
    assert ends[0.9] < 1.0
    assert ends[3.0] > 20.0
    predicted = late.updated({"camera.prediction": "encoder"})
    assert image_delay(predicted) == pytest.approx(0.0005)


def overshoot(positions: hs.Scenario, bandwidth: float) -> float:
    """Return how far a platform goes beyond its end, over the way to it."""
    result = hs.simulate(positions.updated({"controller.pbvs.auto.bandwidth": bandwidth}))
    assert result.outcome == "completed"
    pose = np.c_[result.position / 2e-3, 2.0 * result.quaternion[:, 1:] / 0.02]  # a length to which both matter alike
    left = (pose - pose[-1]) @ (pose[0] - pose[-1])
    return float(-left.min() / left[0])


@pytest.mark.parametrize(
    ("prediction", "latency", "stamped", "legs", "depth", "is_delay"),
    [
        ("none", 0.1, 0.0, 20.0, 0.0, True),
        ("none", 0.04, 0.0, 20.0, 0.3, True),
        ("none", 0.1, 0.0, 1.0, 0.0, False),
        ("none", 0.2, 0.0, 2.0, 0.3, True),
        ("encoder", 0.2, 0.0, 20.0, 0.3, True),
        ("encoder", 0.1, 0.0, 1.0, 0.3, False),
        ("encoder", 0.2, 0.0, 2.0, [0.3, -0.3, 0.3, 0.3], False),
        ("encoder", 0.2, -0.06, 20.0, 0.0, True),
        ("encoder", 0.2, 0.06, 20.0, 0.0, False),
    ],
)
def test_legs_that_lag_take_damping_away_by_wrong_depths_alone(
    prediction: str, latency: float, stamped: float, legs: float, depth: float | list[float], is_delay: bool
) -> None:
    """Beyond the bound a delay shows as overshoot; a lag of the second order is milder than a delay.

    `stamped` is how long before their exposure frames are stamped.
    """
    positions = hs.load_scenario("pi-h824-positions").updated(
        {
            "controller.law": "pbvs",
            "controller.pbvs.auto": {"bandwidth": 1.0, "damping": 1.0},
            "camera": {"noise": 0.0, "prediction": prediction, "latency": latency},
            "actuators.position": {"bandwidth": legs, "speed_limit": None},
            "uncertainty": {"depth": depth, "latency": stamped},
            "simulation.duration": 8.0,
        }
    )
    most = 1.0 / (2 * math.pi * image_delay(positions))
    beyond = {share: overshoot(positions, share * most) for share in (0.5, 0.9, 1.5)}
    assert beyond[0.5] < 0.02
    assert beyond[0.9] < 0.12
    if is_delay:
        assert beyond[1.5] > 0.15
    right = positions.updated({"uncertainty": {"depth": 0.0, "latency": 0.0}, "camera.prediction": "encoder"})
    assert image_delay(right) == pytest.approx(0.01)  # half a tick
    assert overshoot(right, 2.0) < 2e-3


@pytest.mark.parametrize("law", ["pbvs", "resolved_rate"])
@pytest.mark.parametrize("damping", [0.7, 1.0, 2.0])
def test_a_platform_without_mass_has_one_pole(law: str, damping: float) -> None:
    """On drives that take positions both laws move it at omega/(2 zeta) times the error."""
    frequency = 1.0
    positions = hs.load_scenario("pi-h824-positions").updated(
        {
            "controller": {"law": law, law: {"auto": {"bandwidth": frequency, "damping": damping}}},
            "camera": {"noise": 0.0, "prediction": "encoder"},
            "actuators": {"delay": 0.0, "position": {"bandwidth": 2000.0, "speed_limit": None}},
            "simulation.step": 0.005,
            "camera.period": 0.005,
            "camera.latency": 0.0,
            "simulation.duration": 1.0,
        }
    )
    if law == "pbvs":
        positions = positions.updated({"controller.pbvs.prior": 0.0})
    else:
        positions = positions.updated({"controller.resolved_rate.damping": 0.0})
    run = hs.simulate(positions)
    left = np.linalg.norm(run.feature_error, axis=1)
    late = (run.time > 0.2) & (left > 1e-3 * left[0])
    rate = -np.polyfit(run.time[late], np.log(left[late]), 1)[0]
    expected = -math.log1p(-0.005 * math.pi * frequency / damping) / 0.005  # the twist of a tick is held
    print(f"{rate:.4f} 1/s, expected {expected:.4f}")
    assert rate == pytest.approx(expected, rel=0.004)


def test_lag_of_motors_is_that_of_their_servo() -> None:
    motors = hs.load_scenario("reachy-mini-motors")
    motor = motors.actuators.motor
    expected = motors.actuators.delay + (motor.kv + motor.damping) / motor.kp
    assert actuators_lag(motors) == pytest.approx(expected)
    other = motors.updated({"actuators.position": {"bandwidth": 2.0, "damping": 0.3}})
    assert actuators_lag(other) == actuators_lag(motors)


@pytest.mark.parametrize(("period", "constant"), [(0.001, 0.033), (0.033, 0.033), (0.04, 0.02)])
def test_smoothed_features_are_late_by_the_lag_of_their_filter(
    paper: hs.Scenario, period: float, constant: float
) -> None:
    """A target of constant velocity before a platform at rest: smoothed features beside those that are not."""
    moving = paper.updated(
        {
            "simulation": {"mode": "sampled", "duration": 40 * period + 6 * constant},
            "camera.period": period,
            "target.motion": {"kind": "velocity", "velocity": [0.02, 0.0, 0.0]},
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "depth": 0.0},
        }
    )
    weight = np.array([0.0, 0.0, -0.06 * 9.8, 0.0, 0.0, 0.0])

    def seen(scenario: hs.Scenario) -> float:
        features: list[float] = []

        def controller(observation: hs.Observation) -> Array:
            features.append(float(observation.features[0]))
            return weight

        hs.simulate(scenario, controller=controller)
        return features[-1]

    smoothed = moving.updated({"camera.smoothing": constant})
    rate = 0.02 * 0.008 * 72727.0 / 0.5  # [px/s]
    lag = abs(seen(moving) - seen(smoothed)) / rate
    assert lag == pytest.approx(smoothing_lag(smoothed), rel=5e-3)
    assert image_delay(smoothed) - image_delay(moving) == pytest.approx(smoothing_lag(smoothed))
    assert smoothing_lag(moving) == 0.0


def test_what_a_law_cannot_do_is_in_words(paper: hs.Scenario) -> None:
    """Near and far targets, and starts that the image constrains weakly; the runs above are the proof of the bounds."""
    near = paper.updated({"target.depth": 0.03, "robot.force_limit": 1e9})
    assert "so near that rotations have" in warnings_of(with_auto(near, "hybrid", 5.0))[-1]
    assert warnings_of(with_auto(near, "pbvs", 5.0)) == []
    home, points = np.array(paper.robot.home_position), scene_of(paper).points
    nearer = {"target.desired_features": image(581.816, points, home - [0.0, 0.0, 0.02], np.eye(3))}
    for law in ("hybrid", "kelly"):
        sentence = warnings_of(with_auto(paper, law, 5.0, **nearer))[-1]
        assert sentence.endswith("more than twice as slow with this law")
    assert warnings_of(with_auto(paper, "resolved_rate", 5.0, **nearer)) == []
    firm = with_auto(paper, "composite", 5.0, **nearer, **{"controller.composite.prior": 1e6})
    (sentence,) = warnings_of(firm, "controller.composite.prior")
    share = float(re.findall(r"with ([\d.]+) % of", sentence)[0]) / 100
    assert "the image and the pull towards home balance" in sentence  # wherever the run starts
    found = hs.metrics(hs.simulate(firm.updated({"uncertainty.depth": 0.0, "simulation.duration": 20.0})))
    start = np.abs(scene_of(firm).desired - scene_of(firm).view(scene_of(firm).home).features).max()
    assert found["final_error"] / start == pytest.approx(share, rel=0.1)


def test_a_campaign_varies_the_bandwidth(paper: hs.Scenario, tmp_path: Path) -> None:
    fitted = with_auto(paper, "pbvs", 4.0).updated({"simulation.duration": 0.05})
    key = "controller.pbvs.auto.bandwidth"
    file = {
        "scenario": fitted,
        "vary": {key: {"log": [2.0, 8.0]}, "robot.mass": {"uniform": [0.05, 0.08]}},
        "require": ["outcome == completed"],
        "runs": 4,
        "chunk_size": 2,
    }
    found = hs.campaign(file, tmp_path / "campaign")
    table = found.to_dataframe()
    for index in range(4):
        run = table.iloc[index]
        single = hs.metrics(hs.simulate(fitted.updated({key: run[key], "robot.mass": run["robot.mass"]})))
        assert run["final_error"] == pytest.approx(single["final_error"], rel=1e-7)


def test_auto_that_fits_nothing_has_no_effect(paper: hs.Scenario) -> None:
    given = paper.updated({"controller.law": "kelly", "controller.kelly": {"kp": 2e-6, "kd": 2.0}})
    (sentence,) = keys_without_effect(with_auto(given, "kelly", 5.0))
    assert sentence.startswith("controller.kelly.auto.bandwidth: has no effect here; it acts only where one of kp, kd")
    (sentence,) = keys_without_effect(paper.updated({"controller.hybrid.auto.damping": 2.0}))
    assert sentence.endswith("it acts only with controller.hybrid.auto.bandwidth")
    assert keys_without_effect(with_auto(paper, "kelly", 5.0)) == []


def test_a_bandwidth_of_legs_that_follow_twists_acts_on_what_they_follow() -> None:
    """Of `reachy-mini` the gain is given, and neither the integral nor what adapts the gain has an effect."""
    scenario, block = hs.load_scenario("reachy-mini"), "controller.resolved_rate"
    fitted = scenario.updated({f"{block}.auto.bandwidth": 2.0})
    notes = [note for note in keys_without_effect(fitted) if note.startswith(f"{block}.auto")]
    assert notes == [
        f"{block}.auto.bandwidth: has no effect here; it acts only where one of gain, gain_far, gain_slope, ki acts "
        "and is not given"
    ]
    with pytest.raises(hs.ScenarioError, match=r"\.ki: has no effect where actuators\.kind is not force"):
        fitted.updated({f"{block}.ki": 7.0})
    free = fitted.updated({f"{block}.gain": None})
    assert not [note for note in keys_without_effect(free) if note.startswith(f"{block}.auto")]


def test_gains_that_are_written_do_not_follow_the_goal(paper: hs.Scenario) -> None:
    fitted = with_auto(paper, "composite", 2.0)
    kept = fitted.updated(gains_written(fitted))
    goal = {"target.desired_features": paper.target.initial_features}
    assert gains_written(paper) == {}
    for key, value in gains_of(fitted).items():
        np.testing.assert_array_equal(gains_of(kept.updated(goal))[key], value)
    assert any((gains_of(fitted.updated(goal))[key] != value).any() for key, value in gains_of(fitted).items())


@pytest.mark.parametrize(
    ("law", "bandwidth", "changes", "part"),
    [
        ("composite", 4.0, {"controller.composite.fuzzy.enabled": False}, "stiction"),
        pytest.param("composite", 4.0, {}, "camera_rate", marks=pytest.mark.slow),
        ("kelly", 0.7, {"simulation.duration": 1.0}, "largest_start"),
    ],
)
def test_analyses_have_one_law_for_all_their_goals(
    paper: hs.Scenario, law: str, bandwidth: float, changes: dict[str, Any], part: str
) -> None:
    """Bit for bit those of the numbers that `auto` gave, whatever goals their runs have."""
    fitted = with_auto(paper, law, bandwidth, **changes)
    written = {f"controller.{law}.{key}": value.tolist() for key, value in gains_of(fitted).items()}
    numbers = paper.updated({"controller.law": law, **changes, **written})
    expected, found = (hs.analyse(scenario, [part]).to_dict() for scenario in (numbers, fitted))
    assert json.dumps(found) == json.dumps(expected)


def test_a_machine_that_follows_twists_is_analysed_with_fitted_gains() -> None:
    """`ki` of resolved_rate has no effect there, and is refused where it is written."""
    scenario = hs.load_scenario("reachy-mini").updated(
        {"controller.law": "resolved_rate", "controller.resolved_rate.auto.bandwidth": 1.0}
    )
    (section,) = hs.analyse(scenario, ["conditioning"]).sections()
    assert section.verdict != "open"


def test_a_machine_is_computed_once_for_scenarios_that_share_it() -> None:
    """Its arrays cannot be changed, since others have them too."""
    scenario = hs.load_scenario("pi-h824-positions")
    machine = machine_of(scenario)
    assert machine_of(scenario.updated({"simulation.duration": 2.0, "name": "other"})) is machine
    assert not any(array.flags.writeable for array in vars(machine).values())
    heavier = machine_of(scenario.updated({"robot.mass": 2.0 * scenario.robot.mass}))
    assert heavier.mass[0, 0] == pytest.approx(2.0 * machine.mass[0, 0], rel=1e-12)
