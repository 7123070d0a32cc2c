"""Motors that hold positions by a limited torque, with the platform that hangs on them: against MuJoCo, laws of
conservation, and orders of convergence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.bridges.mujoco_model import mjcf
from hexservo.findings.analysis.scene import scene_of
from hexservo.run import variant
from hexservo.run.export import gains_header
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters

Array = NDArray[np.float64]
CRANK = 0.05  # [m], about the cranks of the rotary machine: what makes their angles comparable with lengths

EXACT = {"inertia": 0.0, "gravity": 0.0, "coriolis": 0.0, "depth": 0.0}
AT_REST = {"controller__law": "resolved_rate", "controller__resolved_rate__gain": 1e-9}  # commands do not change
SLOW, FAST = ({"controller__resolved_rate__gain": gain} for gain in (8.0, 30.0))
LIMIT = 0.3  # [N], three times what the weight takes of a prismatic leg; on cranks three times as much, as the weight
# Of the platform of 60 g: legs that follow within 10 ms, and rest after 20 ms.
STIFF = {"kp": 2000.0, "kv": 12.0}


def on_motors(base: hs.Scenario, motor: dict[str, float], **changes: Any) -> hs.Scenario:
    """A scenario on motors; the changes' "__" stands for "."."""
    return base.updated(
        {
            "simulation.mode": "sampled",
            "controller.switching.kind": "implicit",
            "actuators.kind": "position_torque",
            "actuators.motor": motor,
            "actuators.position.bandwidth": 60.0,
            "metrics.rms_start": 0.0,
            **{key.replace("__", "."): value for key, value in changes.items()},
        }
    )


def rotary(motor: dict[str, float], **changes: Any) -> hs.Scenario:
    """The same motors on cranks: torques and angles in place of forces and lengths."""
    scale = CRANK**2
    of_cranks = {name: value * (CRANK if name == "friction" else scale) for name, value in motor.items()}
    if "quantisation" in motor:
        of_cranks["quantisation"] = motor["quantisation"] / CRANK
    return on_motors(rotary_machine.machine(), of_cranks, **changes)


def commands(scenario: hs.Scenario) -> Array:
    return np.asarray(_core.recorded_ticks(core_parameters(scenario))["leg_positions"])


def in_mujoco(
    scenario: hs.Scenario, commands: Array, rows: int, delay: int, key: str, first: Array | None = None
) -> Array:
    """Legs (rows, 6) of the exported model at the ticks, each before its command, `delay` ticks late; from a keyframe.

    `first` acts before the first command arrives; None: what the keyframe holds the platform with.
    """
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(scenario))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, key))
    tick = scenario.simulation.step
    steps = round(tick / model.opt.timestep)
    assert model.opt.timestep * steps == pytest.approx(tick, rel=1e-12)
    mujoco.mj_forward(model, data)
    legs = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, f"leg{leg}") for leg in range(1, 7)]
    held = data.ctrl[legs].copy() if first is None else first
    found = np.empty((rows, 6))
    for row in range(rows):
        found[row] = data.actuator_length[legs]
        data.ctrl[legs] = commands[row - delay] if row >= delay else held
        mujoco.mj_step(model, data, steps)
        mujoco.mj_forward(model, data)
    return found


@pytest.fixture
def baseline(monkeypatch: pytest.MonkeyPatch) -> None:
    """The variant that the recorded ticks are of."""
    monkeypatch.setattr(variant, "_CHOSEN", variant.load_kernel("baseline"))


CASES: dict[str, tuple[dict[str, float], dict[str, Any]]] = {
    "stiff": (STIFF, {}),
    "heavy rotors": ({**STIFF, "armature": 0.02, "damping": 4.0}, {}),
    "soft": ({"kp": 150.0, "kv": 0.5, "damping": 0.3}, {}),
    "at the limit": ({**STIFF, "armature": 0.01}, {"robot__force_limit": LIMIT, **SLOW}),
    "friction": ({**STIFF, "friction": 0.5, "armature": 0.01}, FAST),
    "friction and limit": (
        {**STIFF, "armature": 0.01, "friction": 0.3, "damping": 1.0},
        {"robot__force_limit": LIMIT, "simulation__duration": 1.0, **SLOW},
    ),
}


SLOW_IN_MUJOCO = {("rotary", case) for case in CASES if case != "friction"}  # which is stiff and has heavy rotors


@pytest.mark.usefixtures("baseline")
@pytest.mark.parametrize(
    ("machine", "case"),
    [
        pytest.param(machine, case, marks=[pytest.mark.slow] if (machine, case) in SLOW_IN_MUJOCO else [])
        for machine in ("prismatic", "rotary")
        for case in CASES
    ],
)
def test_motors_and_platform_move_as_mujoco_s(paper: hs.Scenario, case: str, machine: str) -> None:
    """Half a second or one of a controlled run's commands on the exported model: within 1e-4 rad of cranks, and as much
    of prismatic legs; where a limit is to act it does, and where friction is to hold legs it does.

    MuJoCo yields to friction and limits of a crank by 1e-4 of its mobility without its rod, so that cranks have an
    armature where these act.
    """
    motor, changes = CASES[case]
    changes = {
        "controller__law": "resolved_rate",
        "simulation__duration": 0.5,
        "simulation__substeps": 2,
        "actuators__delay": 0.002,
        "uncertainty": EXACT,  # which is not in the exported model
        **changes,
    }
    if machine == "rotary" and "robot__force_limit" in changes:
        changes["robot__force_limit"] *= 3.0 * CRANK
    scenario = on_motors(paper, motor, **changes) if machine == "prismatic" else rotary(motor, **changes)
    run = hs.simulate(scenario)
    assert run.outcome == "completed", run.detail
    wanted, tick, delay = commands(scenario), scenario.simulation.step, 2
    found = in_mujoco(scenario, wanted, len(run.time), delay, "start", run.leg_lengths[0])
    scale = 1.0 if machine == "rotary" else 1.0 / CRANK
    difference = scale * np.abs(found - run.leg_lengths).max()
    moved = scale * np.abs(run.leg_lengths - run.leg_lengths[0]).max()
    rates = np.abs(np.diff(run.leg_lengths, axis=0)) / tick * scale
    held = (rates < 1e-5).mean()
    print(f"{machine}, {case}: legs move {moved:.3g} rad, difference {difference:.2g} rad, at rest {held:.2f}")
    assert difference < 1e-4
    assert moved > 0.02
    limit = scenario.robot.force_limit
    if "limit" in case:
        assert (np.abs(run.leg_forces) >= limit * (1 - 1e-12)).mean() > 2e-3
    if "friction" in case:
        assert held > 0.1


@pytest.mark.parametrize("machine", ["prismatic", "rotary"])
def test_the_wrench_of_a_tick_moves_the_platform_as_the_run_does(paper: hs.Scenario, machine: str) -> None:
    """To rounding: it is that of the mean acceleration, and so is the effort; just after a command there is more."""
    changes = {
        **FAST,
        "controller__law": "resolved_rate",
        "simulation__duration": 0.3,
        "simulation__substeps": 4,
        "uncertainty": {"inertia": 0.05, "coriolis": -0.1, "gravity": 0.03},
        "base_motion": {"kind": "sinusoid", "amplitude": [0.3, -0.2, 0.4], "frequency": 4.0},
    }
    motor = {"kp": 2e4, "kv": 60.0, "armature": 0.01, "friction": 0.02}
    scenario = on_motors(paper, motor, **changes) if machine == "prismatic" else rotary(motor, **changes)
    run = hs.simulate(scenario)
    settings, tick = core_parameters(scenario), scenario.simulation.step
    probe = _core.Probe(settings)
    place = (run.position, run.quaternion, run.twist)
    acting = probe.acceleration(*place, run.wrench + probe.base_wrench(run.time, *place))
    moved = np.diff(run.twist, axis=0) / tick
    np.testing.assert_allclose(acting[:-1], moved, rtol=0, atol=1e-9 * np.abs(moved).max())

    legs, radius = _core.Hexapod(settings.robot), scene_of(scenario).platform_radius
    weight = np.array([settings.body.weight(quaternion) for quaternion in run.quaternion])
    given = np.array(
        [legs.wrench_map(*pose) @ forces for *pose, forces in zip(*place[:2], run.leg_forces, strict=True)]
    )
    beyond, crest = ((wrench - weight) / np.repeat([1.0, radius], 3) for wrench in (run.wrench, given))
    assert hs.metrics(run)["effort"] == pytest.approx(tick * (beyond[:-1] ** 2).sum(), rel=1e-9)
    assert tick * (crest[:-1] ** 2).sum() > 1.2 * hs.metrics(run)["effort"]


@pytest.mark.usefixtures("baseline")
def test_motors_as_stiff_as_a_substep_allows_move_as_mujoco_s() -> None:
    """The exported model's step is the core's: with one step of a substep these motors would be unstable."""
    motor = {"actuators.kind": "position_torque", "actuators.motor.kp": 2e4, "actuators.motor.kv": 400.0}
    run_of = {"simulation.substeps": 1, "simulation.duration": 2.0, "simulation.log_every": 1}
    scenario = hs.load_scenario("pi-h824-positions").updated({**motor, **run_of})
    settings = core_parameters(scenario)
    settings["actuators.motor.kv"] *= 1.2
    assert _core.motor_substeps(settings) == 2  # a fifth more is beyond the limit
    run = hs.simulate(scenario)
    delay = round(scenario.actuators.delay / scenario.simulation.step)
    found = in_mujoco(scenario, commands(scenario), len(run.time), delay, "start", run.leg_lengths[0])
    difference, moved = (np.abs(run.leg_lengths - other).max() for other in (found, run.leg_lengths[0]))
    print(f"legs move {moved:.3g} m, difference {difference:.2g} m")
    assert moved > 4e-3
    assert difference < 2e-5  # [m]; 2.4e-3 with the step of a substep


@pytest.mark.parametrize("machine", ["prismatic", "rotary"])
def test_the_keys_of_the_exported_model_hold_the_platform(paper: hs.Scenario, machine: str) -> None:
    """Their commands are as far from the legs as motors need to carry the weight, at rest and in motion."""
    mujoco = pytest.importorskip("mujoco")
    changes = {
        "uncertainty": EXACT,
        "simulation__substeps": 10,
        "simulation__start__twist": [0.01, 0.02, -0.01, 0.1, -0.2, 0.3],
    }
    scenario = on_motors(paper, STIFF, **changes) if machine == "prismatic" else rotary(STIFF, **changes)
    model = mujoco.MjModel.from_xml_string(mjcf(scenario))
    data, settings = mujoco.MjData(model), core_parameters(scenario)
    hexapod = _core.Hexapod(settings.robot)
    for key in ("home", "start"):  # of which only the latter moves
        mujoco.mj_resetDataKeyframe(model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, key))
        mujoco.mj_forward(model, data)
        position, quaternion = data.qpos[:3], data.qpos[3:7]
        held = hexapod.leg_forces(position, quaternion, settings.plant_body.weight(quaternion))
        assert np.abs(held).max() > 1e-3
        np.testing.assert_allclose(data.actuator_force, held, rtol=1e-9, atol=0)
        assert (np.abs(data.actuator_velocity).max() > 1e-2) == (key == "start")
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, round(0.01 / model.opt.timestep))
    np.testing.assert_allclose(data.qpos[:3], hexapod.home_position, rtol=0, atol=1e-7)  # rods yield by 1e-8


def test_energy_is_conserved_to_second_order(paper: hs.Scenario) -> None:
    """Springs without damping and motors without limits: kinetic energy, with that of the rotors, and that of the
    springs; gravity is zero. The error falls by four with half the step."""
    armature, kp = 0.005, 300.0

    def drift(substeps: int) -> float:
        scenario = on_motors(
            paper,
            {"kp": kp, "kv": 0.0, "armature": armature},
            simulation__duration=0.1,
            simulation__substeps=substeps,
            robot__gravity=[0.0, 0.0, 0.0],
            simulation__start__twist=[0.02, -0.01, 0.03, 0.4, -0.3, 0.5],
            uncertainty=EXACT,
            **AT_REST,
        )
        run = hs.simulate(scenario)
        settings = core_parameters(scenario)
        hexapod, body = _core.Hexapod(settings.robot), settings.plant_body
        wanted = run.leg_lengths[0]
        energies = []
        for position, quaternion, twist, lengths in zip(
            run.position, run.quaternion, run.twist, run.leg_lengths, strict=True
        ):
            rates = hexapod.wrench_map(position, quaternion).T @ twist
            spin = Rotation.from_quat(quaternion[[1, 2, 3, 0]]).inv().apply(twist[3:])
            energies.append(
                0.5 * body.mass * twist[:3] @ twist[:3]
                + 0.5 * spin @ body.inertia @ spin
                + 0.5 * armature * rates @ rates
                + 0.5 * kp * (lengths - wanted) @ (lengths - wanted)
            )
        energy = np.array(energies)
        assert np.ptp(0.5 * kp * ((run.leg_lengths - wanted) ** 2).sum(axis=1)) > 0.3 * energy[0]
        return float(np.abs(energy / energy[0] - 1.0).max())

    coarse, fine = drift(2), drift(4)
    print(f"energy drifts by {coarse:.2g}, and {fine:.2g} with half the step")
    assert coarse < 1e-3
    assert coarse / fine > 3.5


@pytest.mark.parametrize("friction", [0.02, 0.1])
def test_friction_takes_energy_and_holds_what_it_can(paper: hs.Scenario, friction: float) -> None:
    """A leg under dry friction rests where its motor gives less than it and the weight's share together, and a
    platform that moves without any command comes to rest."""
    scenario = on_motors(
        paper,
        {"kp": 500.0, "kv": 0.0, "friction": friction},
        simulation__duration=0.3,
        simulation__substeps=8,
        simulation__start__twist=[0.02, 0.0, 0.0, 0.0, 0.0, 0.0],
        **AT_REST,
    )
    run = hs.simulate(scenario)
    last = run.leg_lengths[-50:]
    assert np.abs(np.diff(last, axis=0)).max() < 1e-12  # [m] in a tick: rests, and does not creep
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    weight = core_parameters(scenario).plant_body.weight(run.quaternion[-1])
    needed = hexapod.leg_forces(run.position[-1], run.quaternion[-1], weight)
    assert np.abs(needed - run.leg_forces[-1]).max() <= friction * (1 + 1e-9)


def test_quantised_commands_leave_the_legs_on_the_grid(paper: hs.Scenario) -> None:
    grid = 1e-4
    scenario = on_motors(
        paper,
        {**STIFF, "quantisation": grid},
        simulation__duration=0.3,
        simulation__substeps=4,
        robot__gravity=[0.0, 0.0, 0.0],
        **AT_REST,
    )
    run = hs.simulate(scenario)
    away = run.leg_lengths[-1] / grid - np.round(run.leg_lengths[-1] / grid)
    np.testing.assert_allclose(away, 0.0, atol=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_every_law_settles_on_motors(paper: hs.Scenario, law: str) -> None:
    """Legs that are stiff and fast compared with the law: within 10 % of legs that follow whatever it takes."""
    motors = on_motors(paper, {"kp": 2e4, "kv": 60.0}, controller__law=law, simulation__substeps=4)
    ideal = motors.updated({"actuators": {"kind": "position", "motor": {"kp": 1000.0, "kv": 10.0}}})
    run, other = hs.simulate(motors), hs.simulate(ideal)
    assert run.outcome == "completed"
    assert np.isfinite(hs.metrics(run)["settling_time"]) == np.isfinite(hs.metrics(other)["settling_time"])
    if np.isfinite(hs.metrics(other)["settling_time"]):
        assert hs.metrics(run)["settling_time"] == pytest.approx(hs.metrics(other)["settling_time"], rel=0.1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actuators.kind": "position"}, "actuators.motor.kp: expected its default where actuators.kind is not"),
        ({"actuators.motor.kp": 1e9}, "simulation.substeps: expected at least"),
        ({"actuators.motor.kv": 1e5}, "simulation.substeps: expected at least"),
        ({"actuators.motor.friction": -1.0}, "actuators.motor.friction: expected a number >= 0"),
        ({"simulation.mode": "continuous"}, "actuators.kind"),
    ],
)
def test_refusals(paper: hs.Scenario, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        on_motors(paper, STIFF).updated(changes)


def test_a_controller_does_not_know_the_motors(paper: hs.Scenario) -> None:
    """It has the response of `actuators.position`; the exported header has no key of the motors."""
    stiff, soft = on_motors(paper, STIFF), on_motors(paper, {"kp": 500.0, "kv": 5.0})
    assert gains_header(stiff) == gains_header(soft)


@pytest.mark.parametrize(
    ("cause", "motor"),
    [
        ("motors", {"kp": 20.0, "kv": 0.02}),
        pytest.param("motors", {"kp": 20.0, "kv": 1.0, "friction": 0.001}, marks=pytest.mark.slow),
        pytest.param("stick_slip", {**STIFF, "friction": 15.0}, marks=pytest.mark.slow),  # as `fails-stick-slip`
    ],
)
def test_motors_that_fail_are_diagnosed(cause: str, motor: dict[str, float]) -> None:
    scenario = on_motors(hs.load_scenario("composite-30hz"), motor, simulation__substeps=2, simulation__duration=1.5)
    found = hs.diagnose(hs.simulate(scenario))
    assert found.failed
    assert [finding.cause for finding in found.causes][:1] == [cause]


def test_motors_weaker_than_their_friction_need_a_larger_limit() -> None:
    head = hs.load_scenario("reachy-mini-motors").updated({"simulation.duration": 1.2, "simulation.substeps": 2})
    weak = head.updated({"robot.force_limit": 0.03})  # [N m], against 0.1 of friction
    result = hs.simulate(weak)
    assert np.abs(result.leg_lengths - result.leg_lengths[0]).max() < 1e-9  # none moves
    diagnosis = hs.diagnose(result)
    (finding,) = diagnosis.named
    assert finding.cause == "motors"
    assert finding.remedy is not None
    assert finding.remedy.works
    assert finding.remedy.changes["robot.force_limit"] > 0.12
    assert "A leg is at its torque limit of 0.03 N m in" in " ".join(diagnosis.section().sentences)
