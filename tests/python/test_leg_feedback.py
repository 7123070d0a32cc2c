"""How much feedback and integral of their readings legs bear (docs/model.md, section 5): closed forms and runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.diagnosis.causes import CAUSES
from hexservo.findings.diagnosis.environment import alone_pairs
from hexservo.findings.diagnosis.model import Case
from hexservo.findings.motor_modes import motor_modes
from hexservo.scenario.keys import value_at
from test_tracking import TICK, head
from without_runs import unlikely_without_runs


@pytest.mark.parametrize(("bandwidth", "damping"), [(1e-3, 1.88), (1e-4, 1.0001), (1e-4, 10.0)])
def test_the_margin_of_legs_far_slower_than_the_servo_is_that_of_their_lags(bandwidth: float, damping: float) -> None:
    """By Routh, with the dead time of delay and hold as one more lag: a1 (a2 a3 - a1 a4) = a3^2 (1 + k)."""
    w, dead = 2.0 * np.pi * bandwidth, 1.5 * TICK
    lag = np.sqrt(max(damping**2 - 1.0, 0.0)) / w
    polynomial = np.polymul(np.polymul([1.0 / w**2, 2.0 * damping / w, 1.0], [lag, 1.0]), [dead, 1.0])
    a4, a3, a2, a1, _ = polynomial
    expected = a1 * (a2 * a3 - a1 * a4) / a3**2 - 1.0
    legs = {"actuators.delay": TICK, "actuators.position": {"bandwidth": bandwidth, "damping": damping}}
    margin = hs.feedback_margin(head(0.0).updated(legs))
    print(f"{margin:.6g}, expected {expected:.6g}")
    assert margin == pytest.approx(expected, rel=2e-3)


def test_legs_that_hardly_move_are_checked() -> None:
    slow = head(0.0, gains={"feedback": 0.1}).updated({"actuators.position": {"bandwidth": 1e-3, "damping": 2.0}})
    assert not [words for words in unlikely_without_runs(slow) if words.startswith("controller.tracking.feedback")]


def decay(scenario: hs.Scenario, *, feedback: float, integral: float, reading: int = 1) -> float:
    """Return the largest eigenvalue from reading to reading of one leg, its delayed commands, b and o: by magnitude."""
    drive, delay = scenario.actuators.position, round(scenario.actuators.delay / TICK)
    w = 2.0 * np.pi * drive.bandwidth
    move, push, *_ = cont2discrete(
        (np.array([[0.0, 1.0], [-w * w, -2.0 * drive.damping * w]]), np.array([[0.0], [w * w]]), np.eye(2), 0.0), TICK
    )
    slower = 2.0 * np.sqrt(max(drive.damping**2 - 1.0, 0.0)) / w
    ease = 1.0 - np.exp(-TICK / (0.5 * slower)) if slower else 1.0

    def after_reading(state: NDArray[np.float64]) -> NDArray[np.float64]:
        leg, late, behind, offset = state[:2], state[2:-2], state[-2], state[-1]
        read = leg[0]
        behind = behind + ease * (-feedback * read - behind)
        for _ in range(reading):
            offset = offset - integral * TICK * read
            leg, late = move @ leg + push[:, 0] * late[-1], np.concatenate(([behind + offset], late[:-1]))
        return np.concatenate((leg, late, [behind, offset]))

    states = delay + (4 if integral else 3)  # an offset that does not move is no part of the loop
    unit = np.eye(delay + 4)[:states]
    return float(np.abs(np.linalg.eigvals(np.array([after_reading(each)[:states] for each in unit]).T)).max())


LEGS = pytest.mark.parametrize(("bandwidth", "damping", "delay"), [(9.7, 1.1, 1), (23.0, 1.88, 3), (3.0, 0.4, 2)])
READINGS = pytest.mark.parametrize("reading", [1, 2, 5, 12])


def read_legs(bandwidth: float, damping: float, delay: int, reading: int) -> hs.Scenario:
    return head(0.0).updated(
        {
            "actuators.delay": delay * TICK,
            "actuators.position": {"bandwidth": bandwidth, "damping": damping},
            "sensors": {"pose": "encoders", "period": reading * TICK},
        }
    )


@READINGS
@LEGS
def test_the_margin_of_the_feedback_is_where_a_pole_leaves_the_unit_circle(
    bandwidth: float, damping: float, delay: int, reading: int
) -> None:
    margin = hs.feedback_margin(read_legs(bandwidth, damping, delay, reading))
    for share, stable in ((0.1, True), (0.5, True), (0.999, True), (1.001, False)):
        found = decay(
            read_legs(bandwidth, damping, delay, reading), feedback=share * margin, integral=0.0, reading=reading
        )
        assert (found < 1.0) == stable, (margin, share)


@READINGS
@pytest.mark.parametrize("feedback", [0.0, 0.5])
@LEGS
def test_the_margin_of_the_integral_is_where_a_pole_leaves_the_unit_circle(
    bandwidth: float, damping: float, delay: int, feedback: float, reading: int
) -> None:
    scenario = read_legs(bandwidth, damping, delay, reading).updated({"controller.tracking.feedback": feedback})
    margin = hs.integral_margin(scenario)
    for share, stable in ((0.1, True), (0.5, True), (0.999, True), (1.001, False)):
        found = decay(scenario, feedback=feedback, integral=share * margin, reading=reading)
        assert (found < 1.0) == stable, (margin, share)
    most = hs.feedback_margin(scenario)
    assert hs.integral_margin(scenario.updated({"controller.tracking.feedback": 1.01 * most})) == 0.0


def test_an_integral_at_its_margin_makes_motors_with_friction_oscillate() -> None:
    """And half of it lets them settle, with their friction."""
    motors = hs.load_scenario("reachy-mini-motors").updated({"actuators.delay": 0.06})
    margin = hs.integral_margin(motors)
    half, whole = (
        hs.metrics(hs.simulate(motors.updated({"controller.tracking.integral": share * margin})))
        for share in (0.5, 1.0)
    )
    print(f"margin {margin:.2f} 1/s, settled after {half['settling_time']} s and {whole['settling_time']} s")
    assert half["settling_time"] < 2.0
    assert np.isnan(whole["settling_time"])


OF_THE_LOOP = ("actuators.delay", "actuators.position.bandwidth", "actuators.position.damping")
WITHOUT_FRICTION = {
    "actuators.motor.friction": 0.0,
    "camera.noise": 0.0,
    "sensors.resolution": 0.0,
    "controller.tracking.band": [1e-5] * 3 + [1e-4] * 3,
    "simulation.duration": 8.0,
}


@pytest.mark.parametrize(
    "changes", [{}, {"actuators.delay": 0.06}, {"actuators.motor.kp": 4.0}], ids=["stiff", "late", "soft"]
)
def test_motors_oscillate_from_the_margin_of_their_own_motions_on(changes: dict[str, Any]) -> None:
    """Not from that of the response that the law assumes: the platform couples motors, and they yield to it."""
    motors = hs.load_scenario("reachy-mini-motors").updated({**WITHOUT_FRICTION, **changes})
    margin = hs.integral_margin(motors)
    assumed = hs.integral_margin(head(0.0).updated({key: value_at(motors, key) for key in OF_THE_LOOP}))
    moves = []
    for share in (0.9, 1.1):
        run = hs.simulate(motors.updated({"controller.tracking.integral": share * margin}))
        moves.append(float(np.ptp(run.leg_lengths[run.time > run.end_time - 2.0], axis=0).max()))
    print(f"{margin:.3g} 1/s, by the assumed response {assumed:.3g}: cranks move by {moves} rad in their last 2 s")
    assert margin < 0.95 * assumed
    assert moves[0] < 1e-3
    assert moves[1] > 0.05


def test_the_motions_of_motors_are_those_of_the_mass_matrix_at_the_legs() -> None:
    """By H^-1 D H^-T, not by the accelerations that forces of the legs cause."""
    scenario = hs.load_scenario("reachy-mini-motors").updated({"robot.gravity": 0.0, "actuators.motor.armature": 0.002})
    scene = scene_of(scenario)
    w, damping = (motor_modes(scene)[:6] * [2.0 * np.pi, 1.0]).T
    motor = scenario.actuators.motor
    maps = scene.wrench_maps(scene.start)
    inertia = np.asarray(scene.probe.inertia(scene.start.rows.quaternion)[0])  # no error of it is assumed
    at_legs = np.linalg.solve(maps, np.linalg.solve(maps, inertia).T) + motor.armature * np.eye(6)
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(at_legs, motor.kp * np.eye(6))).real)
    np.testing.assert_allclose(np.sort(w**2), squares, rtol=1e-9)
    np.testing.assert_allclose(2.0 * damping * w, (motor.kv + motor.damping) / motor.kp * w**2, rtol=1e-12)


def test_an_integral_of_more_than_half_its_margin_is_noted() -> None:
    scenario = head(0.0, gains={"feedback": 0.5})
    margin = hs.integral_margin(scenario)
    for share, noted in ((0.49, False), (0.51, True)):
        sentences = unlikely_without_runs(scenario.updated({"controller.tracking.integral": share * margin}))
        assert any(words.startswith("controller.tracking.integral: ") for words in sentences) == noted
    with pytest.raises(ValueError, match="expected tracking for the margin of its integral, got composite"):
        hs.integral_margin(hs.load_scenario("pi-h824-positions").updated({"controller.law": "composite"}))
    with pytest.raises(ValueError, match=r"expected position or position_torque .* got force"):
        hs.integral_margin(hs.load_scenario("paper"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot.stroke": 1.75e-4}, "at 4 mrad about x, which moves the platform's joints by 229% of the stroke"),
        ({"controller.tracking.band": [1e-6] * 3 + [0.05] * 3}, "at 100 mrad about x"),
        ({"robot.stroke": 1.75e-4, "controller.tracking.band": [2e-6] * 3 + [2e-5] * 3}, ""),
        ({"robot.stroke": 1.75e-4, "controller.tracking.integral": 0.0}, ""),
        ({}, ""),
    ],
)
def test_a_band_that_is_wide_beside_the_stroke_is_noted(changes: dict[str, Any], words: str) -> None:
    scenario = hs.load_scenario("pi-h824-positions").updated({"controller.tracking.integral": 2.0, **changes})
    found = [
        sentence
        for sentence in unlikely_without_runs(scenario)
        if sentence.startswith("controller.tracking.band: the integral begins")
    ]
    assert len(found) == bool(words)
    assert words in "".join(found)


@pytest.mark.parametrize(
    "changes",
    [
        {"actuators.delay": 0.04},
        {"actuators.delay": 0.04, "sensors.period": 0.04},
        {"actuators.position.bandwidth": 5.0, "actuators.position.damping": 1.2},
    ],
    ids=["late", "seldom", "slow"],
)
def test_the_whole_law_oscillates_below_the_margin_of_one_leg(changes: dict[str, float]) -> None:
    """Exact drives and readings, and a target at rest: 0.7 of the margin settles, and 0.8 of it does not."""
    motors = hs.load_scenario("reachy-mini-motors")
    scenario = motors.updated(
        {
            "actuators.kind": "position",
            "actuators.motor": {"kp": 1000.0, "kv": 10.0, "damping": 0.0, "friction": 0.0, "armature": 0.0},
            **changes,
            "camera.noise": 0.0,
            "camera.latency_jitter": 0.0,
            "sensors.resolution": 0.0,
            "target.motion.kind": "none",
            "controller.tracking.integral": 0.0,
            "simulation.duration": 12.0,
        }
    )
    margin = hs.feedback_margin(scenario)
    left = []  # of the twist [m/s; rad/s], in the last quarter
    for share in (0.7, 0.8):
        run = hs.simulate(scenario.updated({"controller.tracking.feedback": share * margin}))
        left.append(float(np.abs(run.twist[3 * len(run.time) // 4 :]).max()))
    assert left[0] < 1e-5
    assert left[1] > 0.1


def test_a_feedback_of_one_is_too_much_for_fast_legs_with_a_held_command() -> None:
    """Though the gain of such legs is at most 1 at any frequency without the hold: zeta is 0.71."""
    changes = {
        "camera.noise": 0.5,
        "metrics.band": 20.0,
        "simulation.duration": 5.0,
        "actuators.delay": 2 * TICK,
        "actuators.position": {"bandwidth": 36.11, "damping": 0.71},
    }
    scenario = head(25.0, gains={"bandwidth": 3.0}).updated(changes)
    assert hs.feedback_margin(scenario) == pytest.approx(0.919, abs=1e-3)
    half, one = (hs.simulate(scenario.updated({"controller.tracking.feedback": share})) for share in (0.5, 1.0))
    assert hs.metrics(half)["settling_time"] < 1.0
    assert one.outcome != "completed"


# ---- Diagnosis ------------------------------------------------------------------------------------------------------

FEEDBACK, INTEGRAL = "controller.tracking.feedback", "controller.tracking.integral"
TURNING = {"metrics.band": 20.0, "actuators.delay": 3 * TICK, "simulation.duration": 1.5}
CAUSE = {cause.key: cause for cause in CAUSES}


@pytest.mark.parametrize("share", [1.2, *(pytest.param(each, marks=pytest.mark.slow) for each in (1.5, 2.0))])
def test_a_feedback_or_integral_beyond_its_margin_is_diagnosed(share: float) -> None:
    scenario = head(25.0, gains={"bandwidth": 3.0}).updated(TURNING)
    fault = {FEEDBACK: share * hs.feedback_margin(scenario)}
    diagnosis = hs.diagnose(hs.simulate(scenario.updated(fault)))
    assert [finding.cause for finding in diagnosis.named] == ["leg_feedback"]
    motors = hs.load_scenario("reachy-mini-motors")
    most = hs.integral_margin(motors)
    (removal,) = CAUSE["leg_feedback"].removals(Case(motors.updated({INTEGRAL: share * most}), None))
    assert removal.changes == {INTEGRAL: pytest.approx(0.5 * most)}


def test_a_feedback_within_half_its_margin_is_no_cause() -> None:
    scenario = head(25.0, gains={"bandwidth": 3.0}).updated(TURNING)
    fine = scenario.updated({FEEDBACK: 0.49 * hs.feedback_margin(scenario)})
    assert CAUSE["leg_feedback"].removals(Case(scenario, None)) == []
    for law in ("tracking", "resolved_rate"):
        assert CAUSE["leg_feedback"].removals(Case(fine.updated({"controller.law": law}), None)) == []
    assert hs.diagnose(hs.simulate(fine)).failed is False


def test_a_coarse_step_is_not_named_for_a_feedback_beyond_its_margin() -> None:
    """It has to fail with the feedback within its margin too, in a run that has the legs and the step as they are."""
    scenario = hs.load_scenario("reachy-mini-motors")
    margin = hs.feedback_margin(scenario)
    for share, pairs in ((0.4, 1), (1.2, 2)):
        case = Case(scenario.updated({FEEDBACK: share * margin}), None)
        (removal, *_) = CAUSE["coarse_step"].removals(case)
        found = alone_pairs(CAUSE["coarse_step"], case, removal)
        assert len(found) == pairs
    within = case.scenario.updated(found[-1].alone)
    assert within.controller.tracking.feedback == pytest.approx(0.5 * margin)
    assert within.actuators == scenario.actuators
    assert within.simulation.step == scenario.simulation.step
