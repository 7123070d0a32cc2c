"""The energy ledger: works by hand, conservation, and the order to which it closes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hexservo as hs
from hexservo.findings.certificate.energy import COARSE, EnergyLedger, energy_ledger
from hexservo.findings.certificate.energy_words import section
from hexservo.findings.certificate.memory import forgotten
from hexservo.findings.certificate.replay import Plant, every_step, replay, replay_of
from hexservo.findings.certificate.stages import doubled_stages_of
from hexservo.findings.evidence import Curves, Table
from hexservo.scenario.wording import joules

Array = NDArray[np.float64]

MASS, GRAVITY = 0.06, 9.8
FREE: dict[str, Any] = {"controller.law": "kelly", "controller.kelly.kp": 0.0, "controller.kelly.kd": 0.0}
SAMPLED: dict[str, Any] = {"simulation.mode": "sampled", "camera.period": 1e-3}


def ledger_of(scenario: hs.Scenario) -> EnergyLedger:
    """The ledger as `certify` has it, without the rest of a certificate."""
    run = replay(hs.simulate(scenario))
    return energy_ledger(run, Plant.of(run))


def varied(paper: hs.Scenario, *changes: dict[str, Any]) -> hs.Scenario:
    whole: dict[str, Any] = {}
    for some in changes:
        whole |= some
    return paper.updated(whole)


def trapezoid(values: Array, step: float) -> float:
    return float(step * (values.sum() - (values[0] + values[-1]) / 2))


# ---- By hand --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mass", [1e-150, 1e-12, 1e6, 9.9e8])
def test_a_constant_force_does_its_work_on_any_mass(paper: hs.Scenario, mass: float) -> None:
    """The inertia is found from accelerations beside 9.8 m/s^2, to which 1 N adds little on a mass of 1e9 kg."""
    time = 0.05
    scenario = varied(
        paper, FREE, {"robot.mass": mass, "uncertainty.gravity": 1e-3, "simulation.duration": time, "robot.stroke": 1.0}
    )
    ledger = ledger_of(scenario)
    force = 1e-3 * -mass * GRAVITY
    assert ledger.work("gravity") == pytest.approx(force * force / ((1 - 0.075) * mass) * time**2 / 2, rel=1e-9)
    assert ledger.closes


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"robot.gravity": 1.7e308}, "weight is too large"),
        ({"robot.mass": 1e-9, "robot.payload.mass": 9e8}, "inertia is too small beside the weight"),
    ],
)
def test_an_inertia_that_cannot_be_measured_is_an_open_question(
    paper: hs.Scenario, changes: dict[str, Any], reason: str
) -> None:
    scenario = varied(paper, changes, {"controller.law": "pbvs", "simulation.duration": 0.05})
    certificate = hs.certify(hs.simulate(scenario))
    assert certificate.energy is None
    assert reason in certificate.open_questions["energy"]
    certificate.sections()


@pytest.mark.parametrize("mode", [{}, SAMPLED])
def test_a_constant_force_does_force_times_way(paper: hs.Scenario, mode: dict[str, Any]) -> None:
    """Nothing acts but the error of the weight: delta_G G, along z, on a mass of (1 - delta_D) m."""
    time = 0.2
    scenario = varied(paper, FREE, mode, {"uncertainty.gravity": 0.01, "simulation.duration": time})
    ledger = ledger_of(scenario)
    force = 0.01 * -MASS * GRAVITY
    acceleration = force / ((1 - 0.075) * MASS)
    way = acceleration * time**2 / 2
    assert ledger.work("gravity") == pytest.approx(force * way, rel=1e-12)
    assert ledger.energy[-1] == pytest.approx(0.5 * (1 - 0.075) * MASS * (acceleration * time) ** 2, rel=1e-12)
    np.testing.assert_allclose(np.delete(ledger.by_axis["gravity"], 2), 0.0, atol=1e-25)
    assert abs(ledger.residual) <= 2 * 200 * np.finfo(float).eps * ledger.energy[-1]  # rounding of 200 steps
    assert ledger.closes


def test_what_viscous_damping_takes_is_its_closed_form(paper: hs.Scenario) -> None:
    """m v' = F - c v from rest: the work is -(F^2/c) (t - 2 T (1 - e) + T/2 (1 - e^2)) with T = m/c, e = exp(-t/T)."""
    damping, time, mass = 0.6, 0.3, (1 - 0.075) * MASS
    changes = {"controller.kelly.kd": damping, "uncertainty.gravity": 0.01, "simulation.duration": time}
    ledger = ledger_of(varied(paper, FREE, changes))
    force, lag = 0.01 * -MASS * GRAVITY, mass / damping
    left = np.exp(-time / lag)
    taken = -(force**2) / damping * (time - 2 * lag * (1 - left) + lag / 2 * (1 - left**2))
    assert ledger.work("damping") == pytest.approx(taken, rel=1e-9)
    speed = force / damping * (1 - left)
    assert ledger.energy[-1] == pytest.approx(0.5 * mass * speed**2, rel=1e-9)
    assert ledger.closes


def test_what_a_hold_injects_is_its_sum_over_the_ticks(paper: hs.Scenario) -> None:
    """A damping that holds from tick to tick lags behind the velocity: it gives back what it takes too little."""
    step, damping, mass, force = 1e-2, 1.5, (1 - 0.075) * MASS, 0.01 * -MASS * GRAVITY
    scenario = varied(
        paper,
        FREE,
        SAMPLED,
        {
            "controller.kelly.kd": damping,
            "uncertainty.gravity": 0.01,
            "simulation.step": step,
            "simulation.duration": 0.2,
            "camera.period": step,
        },
    )
    speed = injected = 0.0
    for _ in range(20):
        acceleration = (force - damping * speed) / mass
        # -c (v_k - v(s)) v(s) over the tick, with v(s) = v_k + a s
        injected += damping * (acceleration * speed * step**2 / 2 + acceleration**2 * step**3 / 3)
        speed += acceleration * step
    ledger = ledger_of(scenario)
    assert ledger.energy[-1] == pytest.approx(0.5 * mass * speed**2, rel=1e-12)
    assert ledger.work("held") == pytest.approx(injected, rel=1e-12)
    assert injected > 0
    assert ledger.closes
    section = ledger.section()
    assert f"put {joules(injected)} into the platform" in " ".join(section.sentences)


def test_a_base_that_shakes_does_its_work(paper: hs.Scenario) -> None:
    """A free platform answers a = A sin(2 pi f t) with v = A (cos(2 pi f t) - 1)/(2 pi f), whatever its mass."""
    amplitude, frequency, time = 0.5, 5.0, 0.43
    scenario = varied(
        paper,
        FREE,
        SAMPLED,
        {
            "base_motion.kind": "sinusoid",
            "base_motion.amplitude": [amplitude, 0.0, 0.0],
            "base_motion.frequency": frequency,
            "simulation.duration": time,
        },
    )
    ledger = ledger_of(scenario)
    turn = 2 * np.pi * frequency
    speed = amplitude * (np.cos(turn * time) - 1) / turn
    energy = 0.5 * (1 - 0.075) * MASS * speed**2
    assert ledger.energy[-1] == pytest.approx(energy, rel=1e-6)
    assert ledger.work("base") == pytest.approx(energy, rel=1e-6)
    assert ledger.mismatch < 1e-12
    assert ledger.closes


def test_steps_on_a_base_that_moves_at_random_are_rebuilt_to_rounding(paper: hs.Scenario) -> None:
    """The acceleration of the base is the loop's own, also between its waves and at the kinks of a recording."""
    kinks = [[0.0, 0.0, 0.0], [0.3, -0.2, 0.5], [-0.4, 0.1, -0.3], [0.2, 0.2, 0.1]]
    motions: list[dict[str, Any]] = [
        {"kind": "noise", "level": 0.01, "low_frequency": 1.0, "high_frequency": 30.0},
        {"kind": "recorded", "samples": kinks, "sample_period": 0.0134},
        {"rotation": {"kind": "noise", "level": 1e-4}},
        {"kind": "road", "road": {"roughness": "D", "position": [0.5, 0.2, -0.6]}},
    ]
    for motion in motions:
        scenario = varied(
            paper,
            SAMPLED,
            {"base_motion": motion, "simulation.substeps": 3, "simulation.duration": 0.2},
        )
        ledger = ledger_of(scenario)
        assert ledger.mismatch < 1e-12, motion
        assert ledger.closes, motion


def test_the_image_spring_gives_what_the_image_loses(paper: hs.Scenario) -> None:
    """Without depth errors J-hat = J, and the spring's work is the loss of 1/2 xi~^T K_p xi~."""
    smooth = {"controller.switching.kind": "tanh", "controller.switching.width": 1.0, "simulation.step": 5e-4}
    result = hs.simulate(varied(paper, smooth, {"uncertainty.depth": 0.0, "simulation.duration": 0.4}))
    ledger = hs.certify(result).energy
    assert ledger is not None
    stored = 0.5 * 1e-6 * (result.feature_error**2).sum(axis=1)
    assert ledger.work("image_spring") == pytest.approx(stored[0] - stored[-1], rel=1e-7)
    assert ledger.turnover > 0


def exact(paper: hs.Scenario, law: str, duration: float) -> hs.Scenario:
    """No model errors, and a goal that is a pure translation of (17.188, 6.875, 0) mm."""
    names = ("inertia", "coriolis", "gravity", "depth")
    changes: dict[str, Any] = {f"uncertainty.{name}": 0.0 for name in names}
    return paper.updated({**changes, "controller.law": law, "simulation.duration": duration})


def test_the_pose_spring_gives_what_it_loses(paper: hs.Scenario) -> None:
    """pbvs has the pose error d - x exactly: the spring's work along an axis is the loss of 1/2 k (d - x)^2."""
    result = hs.simulate(exact(paper, "pbvs", 0.2))
    ledger = hs.certify(result).energy
    assert ledger is not None
    goal = 0.5 / 581.816 * np.array([20.0, 8.0, 0.0])  # [m], depth over focal length times the shift of the image
    stiffness = 24.0
    stored = [
        0.5 * stiffness * (goal - (x - result.position[0])) ** 2 for x in (result.position[0], result.position[-1])
    ]
    np.testing.assert_allclose(ledger.by_axis["pose_spring"][:3], stored[0] - stored[1], rtol=1e-6, atol=1e-12)
    assert ledger.by_axis["pose_spring"][0] > 1e-4


def test_what_a_velocity_loop_asks_for_is_what_moves_and_what_is_damped(paper: hs.Scenario) -> None:
    """m v' = K_i (v* - v): along an axis the work of K_i v* is 1/2 m v^2 and the integral of K_i v^2."""
    scenario = exact(paper, "resolved_rate", 0.2).updated({"simulation.step": 2e-4})
    result = hs.simulate(scenario)
    ledger = hs.certify(result).energy
    assert ledger is not None
    for axis in (0, 1):
        speed = result.twist[:, axis]
        asked = 0.5 * MASS * speed[-1] ** 2 + 3.0 * trapezoid(speed**2, 2e-4)
        assert ledger.by_axis["reference"][axis] == pytest.approx(asked, rel=1e-4)
        assert asked > 1e-6


def test_the_coriolis_feed_forward_does_no_work(paper: hs.Scenario) -> None:
    """omega . (omega x I' omega) = 0, while a component of it alone works."""
    scenario = exact(paper, "computed_torque", 0.2).updated(
        {"robot.inertia": [1.5e-4, 2.5e-4, 3e-4], "target.desired_features": [25, 30, 75, -50, -55, 20, -15, -25]}
    )
    ledger = hs.certify(hs.simulate(scenario)).energy
    assert ledger is not None
    turned = ledger.by_axis["coriolis_feedforward"]
    assert np.abs(turned).max() > 1e-12
    assert abs(ledger.work("coriolis_feedforward")) < 1e-9 * np.abs(turned).max()


def test_switching_and_fuzzy_work_are_integrals_over_the_samples(paper: hs.Scenario) -> None:
    """Against the trapezoidal rule over the log, where everything is smooth."""
    switching = {"controller.switching.kind": "tanh", "controller.switching.width": 1.0}
    result = hs.simulate(varied(paper, switching, {"simulation.duration": 0.3}))
    ledger = hs.certify(result).energy
    assert ledger is not None
    kv = np.array([2e-3] * 3 + [1e-4] * 3)
    power = (-kv * np.tanh(result.twist) * result.twist).sum(axis=1)
    assert ledger.work("switching") == pytest.approx(trapezoid(power, 1e-3), rel=1e-4)
    power = -(result.fuzzy_output * result.twist).sum(axis=1)
    assert ledger.work("fuzzy") == pytest.approx(trapezoid(power, 1e-3), rel=1e-3)


# ---- Conservation ---------------------------------------------------------------------------------------------------


def tumbling(paper: hs.Scenario, **errors: Any) -> tuple[hs.Result, EnergyLedger]:
    """A platform that is pushed for 20 ms about a skew axis, then left alone but for its weight."""

    def push(seen: hs.Observation) -> Array:
        hold = np.array([0, 0, -MASS * GRAVITY, 0, 0, 0])
        return np.asarray(hold + (seen.tick < 20) * np.array([1e-3, 0, 0, 2e-2, 1e-2, 3e-2]))

    changes = {"uncertainty.gravity": 0.0, "simulation.duration": 0.1} | {
        f"uncertainty.{name}": value for name, value in errors.items()
    }
    body = {"robot.inertia": [1.5e-4, 2.0e-4, 3.0e-4]}
    result = hs.simulate(varied(paper, SAMPLED, changes, body), controller=push)
    run = replay(result)
    return result, energy_ledger(run, Plant.of(run))


def test_free_motion_conserves_energy(paper: hs.Scenario) -> None:
    result, ledger = tumbling(paper)
    assert result.outcome == "completed"
    assert np.abs(result.twist[-1, 3:]).min() > 0.1  # it does turn, about no axis of symmetry
    assert np.ptp(ledger.energy[20:]) < 1e-8 * ledger.energy[-1]
    assert set(ledger.works) == {"own", "gravity"}
    assert np.abs(ledger.works["own"][20:]).sum() < 1e-12 * ledger.energy[-1]
    assert ledger.work("own") == pytest.approx(ledger.energy[-1], rel=1e-8)
    assert ledger.closes, ledger.faults


def test_gyroscopic_terms_do_work_where_errors_are_uneven(paper: hs.Scenario) -> None:
    """Entry by entry, (1 - delta) o C has no skew symmetry left: the free platform gains or loses energy."""
    inertia = np.zeros((6, 6))
    inertia[3:, 3:] = np.diag([0.1, -0.1, 0.05])
    coriolis = np.zeros((6, 6))
    coriolis[3, 4] = coriolis[4, 5] = 0.3
    _, ledger = tumbling(paper, inertia=inertia.tolist(), coriolis=coriolis.tolist())
    gained = float(ledger.energy[-1] - ledger.energy[20])
    assert abs(gained) > 1e-3 * ledger.energy[-1]
    assert ledger.works["coriolis"][20:].sum() == pytest.approx(gained, rel=1e-4)
    assert ledger.closes, ledger.faults


# ---- How well it closes ---------------------------------------------------------------------------------------------


def test_with_smooth_switching_it_closes_to_the_order_of_the_method(paper: hs.Scenario) -> None:
    smooth = {
        "controller.switching.kind": "tanh",
        "controller.switching.width": 1.0,
        "controller.hybrid.fuzzy.error_scale": 0.5,
        "controller.hybrid.fuzzy.rate_scale": 0.02,  # no input of a fuzzy system at its limit
        "simulation.duration": 0.2,
    }
    ledgers = [ledger_of(varied(paper, smooth, {"simulation.step": step})) for step in (1e-3, 5e-4, 2.5e-4)]
    for coarse, fine in pairwise(ledgers):
        assert abs(coarse.residual) / abs(fine.residual) > 14  # 2^4, less what is not yet asymptotic
        assert 12 < coarse.tolerance / fine.tolerance < 40
    for ledger in ledgers:
        assert abs(ledger.residual) <= ledger.tolerance < 1e-3 * ledger.turnover
        assert ledger.closes


@pytest.mark.parametrize("law", ["kelly", "hybrid"])
@pytest.mark.parametrize("steps", [1, 2, 3, 4, 5])
def test_smooth_runs_of_a_few_steps_close(paper: hs.Scenario, law: str, steps: int) -> None:
    """Steps of twice the length cover an even number of steps; the last one of an odd number has a bound as well."""
    changes = {"controller.law": law, "controller.switching.kind": "tanh", "simulation.duration": steps * 1e-3}
    ledger = ledger_of(paper.updated(changes))
    assert len(ledger.time) == steps + 1
    assert ledger.faults == ()


def test_with_sign_it_closes_to_first_order(paper: hs.Scenario) -> None:
    """A platform that sticks chatters: every step has a sign change, and misses about h k_v times its change of v."""
    sticking = {"controller.hybrid.kv": [0.02, 0.02, 0.02, 2e-3, 2e-3, 2e-3], "simulation.duration": 0.5}
    ledgers = [ledger_of(varied(paper, sticking, {"simulation.step": step})) for step in (1e-3, 5e-4, 2.5e-4)]
    for ledger in ledgers:
        assert ledger.crossings > 100
        assert abs(ledger.residual) <= ledger.tolerance < 3 * abs(ledger.residual)
    ratios = [coarse.residual / fine.residual for coarse, fine in pairwise(ledgers)]
    assert all(1.7 < ratio < 2.4 for ratio in ratios), ratios


@pytest.mark.parametrize(
    "name",
    [
        "paper",
        "paper-gravity",
        "paper-composite",
        "task-tilt",
        "textbook-half-turn",
        "composite-30hz",
        "real-machine",
        "rough-road",
        "saturation",
    ],
)
def test_shipped_scenarios_close(name: str) -> None:
    scenario = hs.load_scenario(name)
    ledger = ledger_of(scenario.updated({"simulation.duration": 0.6}))
    assert ledger.closes, ledger.faults
    total = sum(ledger.work(term) for term in ledger.works)
    assert total + ledger.residual == pytest.approx(float(ledger.energy[-1] - ledger.energy[0]), abs=1e-15)
    for term, axes in ledger.by_axis.items():
        assert axes.sum() == pytest.approx(ledger.work(term), rel=1e-9, abs=1e-18)


@pytest.mark.parametrize("law", ["kelly", "resolved_rate", "pbvs", "computed_torque"])
@pytest.mark.parametrize("mode", [{}, SAMPLED])
def test_every_law_closes(paper: hs.Scenario, law: str, mode: dict[str, Any]) -> None:
    ledger = ledger_of(varied(paper, mode, {"controller.law": law, "simulation.duration": 0.4}))
    assert ledger.closes, ledger.faults
    assert ledger.work("damping") < 0
    assert ("held" in ledger.works) == bool(mode)


def of_poses(name: str, bandwidth: float, depth: float) -> hs.Scenario:
    """The law `pbvs` with fitted gains in continuous mode, which measures a share of its prior from a depth error."""
    ideal: dict[str, Any] = {
        "simulation": {"mode": "continuous", "duration": 2.0},
        "camera.period": None,
        "camera.latency": 0.0,
        "camera.noise": 0.0,
        "camera.image_size": None,
        "camera.prediction": "none",
        "controller.switching.kind": "tanh",
    }
    law = {"controller.law": "pbvs", "controller.pbvs.auto.bandwidth": bandwidth, "uncertainty.depth": depth}
    return hs.load_scenario(name).updated({**ideal, **law})


@pytest.mark.parametrize(
    ("name", "bandwidth", "depth"),
    [("eye-to-hand", 1.0, 0.1), ("eye-to-hand", 5.0, 0.1), ("eye-to-hand", 1.0, 0.2), ("task-general", 1.0, 0.3)],
)
def test_a_pose_law_with_a_prior_closes_though_its_steps_are_rebuilt_without_memory(
    name: str, bandwidth: float, depth: float
) -> None:
    ledger = ledger_of(of_poses(name, bandwidth, depth))
    assert ledger.faults == ()
    assert ledger.tolerance < 1e-5 * ledger.turnover


def test_a_memory_explains_poses_that_are_apart_by_1e_4_of_the_depth_or_rad() -> None:
    """And so at most twice K_p times that: of a law with twice the K_p it explains no more."""
    scenario = of_poses("eye-to-hand", 1.0, 0.1)
    result = hs.simulate(scenario)
    twice = 2.0 * np.broadcast_to(scenario.controller.gains.kp, 6)
    run = replay_of(result, scenario.updated({"controller.pbvs.kp": twice.tolist()}), result.end_time)
    depth = np.abs(run.depth[1:]).mean(axis=1)
    most = 2e-4 * twice * np.column_stack([*[depth] * 3, *[np.ones_like(depth)] * 3])
    found = forgotten(run) / most
    assert (found <= 1.0 + 1e-12).all()
    assert found[:, :3].max() == found[:, 3:].max() == pytest.approx(1.0)


def test_a_wrench_beyond_what_a_memory_explains_is_flagged() -> None:
    """One that poses 1e-4 of the depth apart do not explain, as of a law with another K_p."""
    scenario = of_poses("eye-to-hand", 1.0, 0.1)
    result = hs.simulate(scenario)
    stiffness = np.asarray(scenario.controller.gains.kp)
    other = scenario.updated({"controller.pbvs.kp": (1.01 * stiffness).tolist()})
    run = replay_of(result, other, result.end_time)
    assert any("miss the next sample" in fault for fault in energy_ledger(run, Plant.of(run)).faults)


def test_substeps_and_leg_forces_that_hold_close(paper: hs.Scenario) -> None:
    legs = {"actuators.hold": "leg_forces", "controller.law": "composite", "controller.switching.kind": "implicit"}
    scenario = varied(paper, SAMPLED, legs, {"simulation.substeps": 3, "simulation.duration": 0.3})
    ledger = ledger_of(scenario)
    assert ledger.mismatch < 1e-12
    assert ledger.closes, ledger.faults


def test_a_camera_as_printed_is_accounted_for(paper: hs.Scenario) -> None:
    printed = {"camera.convention": "as_printed", "simulation.duration": 0.3}
    assert ledger_of(varied(paper, printed)).closes
    sampled = ledger_of(varied(paper, printed, SAMPLED, {"controller.switching.kind": "implicit"}))
    assert sampled.closes
    assert set(sampled.works) == {"acting", "gravity"}
    assert any("not split into terms" in sentence for sentence in sampled.section().sentences)


# ---- When it does not -----------------------------------------------------------------------------------------------


def test_a_log_that_is_not_what_acted_is_flagged(paper: hs.Scenario) -> None:
    scenario = varied(paper, FREE, SAMPLED, {"uncertainty.gravity": 0.01, "simulation.duration": 0.2})
    result = hs.simulate(scenario)
    wrench = result.wrench.copy()
    wrench[50:60, 2] *= 0.99
    run = replay_of(replace(result, wrench=wrench), scenario, result.end_time)
    ledger = energy_ledger(run, Plant.of(run))
    assert not ledger.closes
    section = ledger.section()
    assert section.verdict == "bad"
    assert section.sentences[0].startswith("The energy ledger does not close: ")
    assert "miss the next sample" in section.sentences[0]
    assert "a residual of" in section.sentences[0]


@pytest.mark.parametrize(
    ("name", "jump", "words"),
    [
        ("position", 1e-6, "miss the next pose by"),
        ("quaternion", 1e-6, "miss the next pose by"),
        ("feature_error", 1e-3, "the images at the poses of the log differ"),
        ("depth", 1e-6, "the images at the poses of the log differ"),
    ],
)
def test_a_log_whose_poses_or_images_are_of_another_run_is_flagged(name: str, jump: float, words: str) -> None:
    """A custom controller's run cannot be repeated: only the log itself shows a jump in it."""
    scenario = hs.load_scenario("composite-30hz").updated({"simulation.duration": 0.2})
    result = hs.simulate(scenario, controller=lambda _: np.array([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]))
    untouched = hs.certify(result).energy
    assert untouched is not None
    assert untouched.faults == ()
    jumping = getattr(result, name).copy()
    jumping[100:] += jump
    ledger = hs.certify(replace(result, **{name: jumping})).energy
    assert ledger is not None
    assert any(words in fault for fault in ledger.faults)
    assert ledger.section().verdict == "bad"


def test_a_platform_that_rests_at_its_goal_closes(paper: hs.Scenario) -> None:
    """Its switching term chatters about nothing: hardly any energy is turned over, and the tolerance is as small."""
    start = list(paper.target.initial_features or ())
    scenario = paper.updated({"target.desired_features": start, "simulation.duration": 0.5})
    ledger = hs.certify(hs.simulate(scenario)).energy
    assert ledger is not None
    assert ledger.tolerance > COARSE * ledger.turnover
    assert ledger.tolerance < ledger.negligible == pytest.approx(1e-3 * 0.06 * 9.8 * 0.017)
    assert ledger.closes


def test_a_platform_that_coasts_closes_though_nothing_is_turned_over(paper: hs.Scenario) -> None:
    """A rotation about a principal axis, without gravity and gains: every work is zero, the energy is not."""
    coasting = paper.updated(
        {
            "controller.law": "kelly",
            "controller.kelly": {"kp": 0.0, "kd": 0.0},
            "robot.gravity": [0.0, 0.0, 0.0],
            "simulation.start.twist": [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            "simulation.duration": 0.1,
        }
    )
    ledger = hs.certify(hs.simulate(coasting)).energy
    assert ledger is not None
    assert ledger.turnover < 1e-9 * ledger.energy.max()
    assert ledger.closes
    assert "closes" in " ".join(hs.certify(hs.simulate(coasting)).sections()[-1].sentences)


def test_a_step_that_is_too_coarse_is_flagged(paper: hs.Scenario) -> None:
    """Switching of 2 N at 20 ms steps is nothing but chatter."""
    scenario = varied(
        paper,
        {
            "controller.law": "composite",
            "controller.composite.kv": [0.5, 0.5, 0.5, 0.01, 0.01, 0.01],
            "simulation.step": 5e-3,
            "simulation.duration": 0.5,
        },
    )
    ledger = ledger_of(scenario)
    assert not ledger.closes
    assert any("too coarse" in fault for fault in ledger.faults), ledger.faults


def test_a_run_that_diverges_is_certified_though_longer_steps_leave_the_finite_numbers(paper: hs.Scenario) -> None:
    """Its tolerance is at least the error of its steps: the residual is within the sum of their absolute parts."""
    scenario = varied(
        paper,
        {
            "controller.switching.kind": "tanh",
            "controller.hybrid.kp": 5e-6,
            "controller.hybrid.kv": [2e-4, 2e-4, 2e-4, 1e-5, 1e-5, 1e-5],
            "controller.hybrid.fuzzy.adaptation": 0.01,
            "simulation.step": 0.002,
        },
    )
    result = hs.simulate(scenario)
    assert result.outcome == "diverged"
    run = replay(result)
    doubled = list(doubled_stages_of(run))
    assert sum(len(stages.finite().tick) for stages in doubled) < sum(len(stages.tick) for stages in doubled)
    certificate = hs.certify(result)
    assert certificate.lyapunov is not None
    assert certificate.energy is not None
    assert abs(certificate.energy.residual) <= certificate.energy.tolerance < np.inf
    empty = replace(doubled[0], quaternion=np.full_like(doubled[0].quaternion, np.nan)).finite()
    assert Plant.of(run).inertia(empty.rows("quaternion")).shape == (0, 6, 6)


def test_the_section_reports_the_energy_balance(paper: hs.Scenario) -> None:
    ledger = ledger_of(varied(paper, {"simulation.duration": 0.3}))
    section = ledger.section()
    assert section.name == "energy"
    assert section.verdict == "good"
    table, curves = section.items
    assert isinstance(table, Table)
    assert isinstance(curves, Curves)
    works = [row[1] for row in table.rows[: len(ledger.works)]]
    unit = {"uJ": 1e-6, "mJ": 1e-3}[table.columns[1].unit]
    assert works == pytest.approx([ledger.work(term) / unit for term in ledger.works])
    assert curves.lines[0].y[0] == 0.0
    assert section.data["residual"] == ledger.residual


# ---- Words ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mass", [1e-3, 0.06, 1e6])
def test_columns_and_axes_have_the_unit_of_their_largest_value(paper: hs.Scenario, mass: float) -> None:
    certificate = hs.certify(hs.simulate(paper.updated({"robot.mass": mass, "simulation.duration": 0.05})))
    assert certificate.energy is not None
    table, curves = section(certificate.energy).items
    assert isinstance(table, Table)
    assert isinstance(curves, Curves)
    unit = table.columns[1].unit
    largest = max(abs(float(row[4])) for row in table.rows if row[4] is not None)
    assert 1.0 <= largest < 1000.0
    assert joules(certificate.energy.turnover).endswith(f" {unit}")
    assert unit in curves.y_label


def test_a_run_too_long_for_a_log_of_every_step_is_refused_by_its_duration(paper: hs.Scenario) -> None:
    """Whatever `simulation.log_every` is: a certificate does not look at it."""
    long = paper.updated({"simulation": {"duration": 1e5, "log_every": 1000}})
    with pytest.raises(ValueError, match=r"^simulation.duration: expected a run whose log .* 2 GiB, .* got 100000 s"):
        every_step(long)
