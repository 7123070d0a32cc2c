"""Motors found from logs: of MuJoCo on the exported machine, and of the core's own runs under noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.cli.commands import app
from hexservo.findings.identification.changes import changes_of, ticks_of
from hexservo.findings.identification.drives import MOST_DELAY, fit_drives
from hexservo.findings.identification.interval import Interval
from hexservo.findings.identification.log import Log
from hexservo.findings.identification.motors import (
    MotorFit,
    _finished,
    _fitted,
    _intervals,
    _Plant,
    _values,
    fit_motors,
)
from hexservo.scenario.drives import Motors
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.parameters import core_parameters
from test_identification import commands_of, try_delays, within
from test_motors import in_mujoco, on_motors, rotary

TICK, DELAY, SEED = 0.01, 2, 31
# At the limit kv does not act, and damping does: what is found as one number is one here.
MOTOR = {"kp": 150.0, "kv": 0.0, "damping": 2.0, "friction": 0.02, "armature": 0.02}
SAMPLED = {"simulation__step": TICK, "simulation__substeps": 4, "actuators__delay": DELAY * TICK}


def machine_of(paper: hs.Scenario, kind: str) -> hs.Scenario:
    return on_motors(paper, MOTOR, **SAMPLED) if kind == "prismatic" else rotary(MOTOR, **SAMPLED)


def given(machine: hs.Scenario) -> hs.Scenario:
    """The machine as its owner has it: without anything of the motors."""
    usual = {f"actuators.motor.{key}": value for key, value in Motors().model_dump().items()}
    return machine.updated({"actuators.kind": "position", "actuators.delay": 0.0, "simulation.substeps": 1, **usual})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["prismatic", "rotary"])
def test_motors_are_found_from_a_log_of_mujoco(paper: hs.Scenario, kind: str) -> None:
    """To 3 % and the delay; they predict the rest of the record ten times as well as six responses by themselves."""
    machine = machine_of(paper, kind)
    commands = commands_of(machine, np.random.default_rng(SEED), 600, TICK, 0.004)
    joints = in_mujoco(machine, commands, len(commands), DELAY, "home")
    found = hs.identify(Log(TICK * np.arange(600.0), TICK, commands, joints, None), given(machine), motors=True)
    motors, true = found.motors, machine.actuators.motor
    assert motors is not None
    print(f"{kind}: {found.changes}; error {motors.error:.3g}, of the drives {motors.error_of_drives:.3g}")
    assert motors.kp.value == pytest.approx(true.kp, rel=0.03)
    assert motors.damping.value == pytest.approx(true.kv + true.damping, rel=0.03)
    assert motors.armature.value == pytest.approx(true.armature, rel=0.03)
    assert motors.friction.value == pytest.approx(true.friction, rel=0.1)
    assert motors.delay == DELAY
    assert motors.error < 0.1 * motors.error_of_drives
    assert found.scenario.actuators.kind == "position_torque"
    assert found.scenario.actuators.delay == pytest.approx(DELAY * TICK)
    assert hs.simulate(found.scenario).outcome == "completed"


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1e-4, 1e-5])
def test_intervals_of_motors_contain_the_true_values(paper: hs.Scenario, noise: float) -> None:
    """Of 4 logs with white noise: of 16 intervals of 95 % at least 13 (99.9 %, binomial)."""
    machine, random = machine_of(paper, "prismatic"), np.random.default_rng(SEED)
    settings = core_parameters(machine)
    settings["simulation.substeps"] = 32
    hexapod = _core.Hexapod(settings.robot)
    kept = 0
    for _ in range(4):
        commands = commands_of(machine, random, 400, TICK, 0.004)
        joints = _core.motor_response(settings, commands, hexapod.home_position, hexapod.home_quaternion)
        noisy = joints + noise * random.standard_normal(joints.shape)
        motors = hs.identify(
            Log(TICK * np.arange(400.0), TICK, commands, noisy, None), given(machine), motors=True
        ).motors
        assert motors is not None
        true = machine.actuators.motor
        pairs = (
            (motors.kp, true.kp),
            (motors.damping, true.kv + true.damping),
            (motors.armature, true.armature),
            (motors.friction, true.friction),
        )
        kept += sum(within(interval, value) for interval, value in pairs)
        assert motors.delay == DELAY
    print(f"seed {SEED}: {kept} of 16 intervals contain the true value")
    assert kept >= 13


def test_motors_are_fitted_with_the_step_of_the_scenario_that_is_identified(paper: hs.Scenario) -> None:
    """1/60 s is no number of nine digits: with these the motors would be those of another step."""
    step = 1.0 / 60.0
    machine = given(machine_of(paper, "prismatic")).updated({"simulation.step": step, "simulation.duration": 1.0})
    hexapod = _core.Hexapod(core_parameters(machine).robot)
    legs = hexapod.leg_lengths(hexapod.home_position, hexapod.home_quaternion)
    home = np.tile(legs, (60, 1))
    log = Log(step * np.arange(60.0), step, home, home, None)
    plant = _Plant(log, machine)
    assert plant._settings["simulation.step"] == ticks_of(log, machine)["simulation.step"] == step
    assert log.step != step


def test_the_steps_of_the_fit_leave_no_bias(paper: hs.Scenario) -> None:
    """Of a log without noise, of 64 steps in a tick: less than 0.05 %, where the steps of the search leave 0.3 %."""
    machine = machine_of(paper, "prismatic")
    settings = core_parameters(machine)
    settings["simulation.substeps"] = 64
    home = _core.Hexapod(settings.robot)
    commands = commands_of(machine, np.random.default_rng(SEED), 60, TICK, 0.004)
    joints = _core.motor_response(settings, commands, home.home_position, home.home_quaternion)
    plant = _Plant(Log(TICK * np.arange(60.0), TICK, commands, joints, None), given(machine))
    truth = np.log([MOTOR["kp"], MOTOR["damping"], MOTOR["armature"], MOTOR["friction"]])

    def left(logs: NDArray[np.float64]) -> NDArray[np.float64]:
        return ((plant.response(DELAY, _values(logs)) - joints) / np.std(joints)).ravel()

    coarse = _fitted(left, DELAY, truth)
    fine = _finished(plant, left, coarse)
    errors = [np.abs(fit.logs - truth).max() for fit in (coarse, fine)]
    print(f"relative errors: {errors[0]:.2g} with the steps of the search, {errors[1]:.2g} at the end")
    assert errors[0] > 2e-3
    assert errors[1] < 5e-4


@pytest.mark.slow
def test_a_delay_of_motors_beyond_what_is_tried_is_no_key(paper: hs.Scenario) -> None:
    machine = on_motors(paper, MOTOR, **(SAMPLED | {"actuators__delay": MOST_DELAY * TICK}))
    settings = core_parameters(machine)
    hexapod = _core.Hexapod(settings.robot)
    commands = commands_of(machine, np.random.default_rng(SEED), 300, TICK, 0.004)
    joints = _core.motor_response(settings, commands, hexapod.home_position, hexapod.home_quaternion)
    found = hs.identify(Log(TICK * np.arange(300.0), TICK, commands, joints, None), given(machine), motors=True)
    assert found.motors is not None
    assert found.motors.delay == MOST_DELAY
    assert found.motors.explains
    section = found.motors.section()
    assert section.verdict == "warning"
    assert any("at least 8 ticks" in sentence for sentence in section.sentences)
    assert found.changes["actuators.motor.kp"] == pytest.approx(MOTOR["kp"], rel=0.03)
    assert "actuators.delay" not in found.changes
    other = replace(found.motors, explained=-0.2)
    assert other.section().verdict == "bad"
    changes = changes_of(
        Log(TICK * np.arange(300.0), TICK, commands, joints, None), given(machine), found.drives, None, other
    )
    assert not any(key.startswith("actuators.motor") for key in changes)


@pytest.mark.slow
def test_delays_are_tried_on_to_the_best_one(paper: hs.Scenario) -> None:
    """From drives whose delay is 2 ticks too long, so that the best one is below all that are tried at first."""
    machine = machine_of(paper, "prismatic")
    settings = core_parameters(machine)
    hexapod = _core.Hexapod(settings.robot)
    commands = commands_of(machine, np.random.default_rng(SEED), 200, TICK, 0.004)
    joints = _core.motor_response(settings, commands, hexapod.home_position, hexapod.home_quaternion)
    log = Log(TICK * np.arange(200.0), TICK, commands, joints, None)
    drives = fit_drives(log, leg_units(machine.robot), delays=(DELAY + 2,))
    found = fit_motors(log, given(machine), drives)
    assert found is not None
    assert found.delay == DELAY


def test_a_response_is_that_of_a_run(paper: hs.Scenario) -> None:
    """The core's plant under the recorded commands of a run: the legs of that run."""
    machine = machine_of(paper, "prismatic").updated({"uncertainty": {"inertia": 0.0, "gravity": 0.0, "coriolis": 0.0}})
    machine = machine.updated({"controller.law": "resolved_rate", "simulation.duration": 1.0})
    settings = core_parameters(machine)
    commands = np.asarray(_core.recorded_ticks(settings)["leg_positions"])
    run = hs.simulate(machine)
    start = run.position[0], run.quaternion[0]
    legs = _core.motor_response(settings, commands, *start)
    ticks = np.searchsorted(run.time, TICK * np.arange(len(legs)) - 1e-9)
    # a run begins with commands that are where the legs are, and the platform sags at first
    held = np.abs(legs - run.leg_lengths[ticks])
    print(f"legs differ by {held.max():.2g} m, at the end by {held[-1].max():.2g} m, and move {np.ptp(legs):.2g} m")
    assert held[-1].max() < 1e-2 * np.ptp(run.leg_lengths, axis=0).max()


def test_the_command_writes_motors(paper: hs.Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    try_delays(monkeypatch, DELAY)
    monkeypatch.setattr("hexservo.findings.identification.motors._HALVINGS", 0)  # how it ends has a separate test
    machine = machine_of(paper, "prismatic")
    settings = core_parameters(machine)
    hexapod = _core.Hexapod(settings.robot)
    commands = commands_of(machine, np.random.default_rng(SEED), 150, TICK, 0.004)
    joints = _core.motor_response(settings, commands, hexapod.home_position, hexapod.home_quaternion)
    table = np.column_stack([TICK * np.arange(150.0), commands, joints])
    names = ["time", *(f"{kind}_{leg}" for kind in ("command", "joint") for leg in range(1, 7))]
    log, own, out = tmp_path / "log.csv", tmp_path / "machine.yaml", tmp_path / "out.yaml"
    np.savetxt(log, table, delimiter=",", header=",".join(names), comments="")
    own.write_text(given(machine).to_yaml(), encoding="utf-8")
    done = CliRunner().invoke(app, ["identify", str(log), "--machine", str(own), "--motors", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "Motors of the legs" in done.output
    assert hs.load_scenario(out).actuators.motor.kp == pytest.approx(machine.actuators.motor.kp, rel=0.02)


def test_what_the_log_does_not_determine_is_open() -> None:
    """Ends that are more than 100 times apart, and friction from 0 to far beyond what is looked for."""
    values = {"kp": 40.0, "damping": 1.0, "armature": 2e-4, "friction": 1e-5}
    found = _intervals(values, np.array([0.02, 0.01, 1.7, 20.0]), 1e-4)
    assert [key for key, one in found.items() if not one.is_bounded] == ["armature"]
    friction = found["friction"]
    assert (friction.value, friction.low) == (0.0, 0.0)
    assert friction.high == pytest.approx(1e-5 * (1 + 1.959964 * 20.0), rel=1e-6)
    assert not _intervals(values, np.array([0.02, 0.01, 0.1, 2e3]), 1e-4)["friction"].is_bounded
    friction = _intervals(values | {"friction": 5e-4}, np.array([0.02, 0.01, 0.1, 1.4]), 1e-4)["friction"]
    assert not friction.is_bounded


def motors_of(armature: Interval, **others: object) -> MotorFit:
    """Motors of which all but the armature is known."""
    one = {key: Interval(value, 0.9 * value, 1.1 * value) for key, value in (("kp", 40.0), ("damping", 1.0))}
    curves = np.zeros((3, 6))
    fields: dict[str, Any] = {
        "delay": 1,
        "limit": 0.5,
        "noise": 1e-4,
        "correlated": 1.0,
        "error": 1e-4,
        "error_of_drives": 2e-4,
    }
    fields |= {"explained": 0.99, "still": (), "units": leg_units(hs.load_scenario("reachy-mini").robot), "substeps": 2}
    curve = {"time": np.arange(3.0), "measured": curves, "predicted": curves}
    friction = Interval(0.01, 0.009, 0.011)
    return MotorFit(**(one | {"armature": armature, "friction": friction} | fields | curve | others))


def test_what_the_log_does_not_determine_is_no_key_and_not_good() -> None:
    known = motors_of(Interval(2e-4, 1e-4, 4e-4))
    assert known.section().verdict == "good"
    assert "actuators.motor.armature" in known.changes
    unknown = Interval(2e-4, -np.inf, np.inf)
    left = motors_of(unknown, kept=("armature",))
    assert "actuators.motor.armature" not in left.changes
    assert "actuators.motor.kp" in left.changes
    assert left.section().verdict == "warning"
    assert any("`actuators.motor.armature` is left as it is" in words for words in left.section().sentences)
    taken = motors_of(unknown)  # where the machine's own would move the legs otherwise
    assert taken.changes["actuators.motor.armature"] == 2e-4
    assert taken.section().verdict == "warning"
    assert any("of which many move the legs alike" in words for words in taken.section().sentences)


def test_motors_that_predict_a_part_of_the_motion_are_not_good() -> None:
    known = Interval(2e-4, 1e-4, 4e-4)
    section = motors_of(known, explained=0.7, correlated=9.0).section()
    assert section.verdict == "warning"
    assert any("70 % of the motion of a leg, and what is left is no noise" in words for words in section.sentences)
    assert (
        motors_of(known, explained=0.9, correlated=1.5).section().verdict == "good"
    )  # noise, of legs that move little
