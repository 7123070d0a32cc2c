"""The plant against MuJoCo, an independent dynamics engine, with the model that `hexservo export --mjcf` writes.

It is a free body on six spatial tendons, each with a motor of gear 1, whose positive force acts towards a longer
tendon, so it pushes. Gravity acts along +z, which points down in B; on the robot "uneven" it is tilted, no joint lies
on a circle, and home is turned.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import hexservo as hs
from hexservo import _core
from hexservo.bridges.mujoco_model import LEFT_OUT, keyframe_notes, mjcf, not_in_model
from hexservo.cli.commands import app
from hexservo.scenario.keys import keys_below
from hexservo.scenario.parameters import core_parameters
from hexservo.scenario.schema import schema

Array = NDArray[np.float64]

DURATION = 0.3  # [s]
UNEQUAL = 1e-3 * np.array([20.0, 9.0, 19.0, 12.0, 20.0, 4.0])  # [N], beyond the share of the weight
NO_CIRCLE = {f"robot.{side}_{key}": None for side in ("platform", "base") for key in ("radius", "angles")}


def uneven() -> hs.Scenario:
    nominal = hs.load_scenario("paper-nominal")
    hexapod, random = _core.Hexapod(core_parameters(nominal).robot), np.random.default_rng(5)
    return nominal.updated(
        {
            **NO_CIRCLE,
            "robot.platform_joints": (hexapod.platform_joints + random.uniform(-0.02, 0.02, (6, 3))).tolist(),
            "robot.base_joints": (hexapod.base_joints + random.uniform(-0.04, 0.04, (6, 3))).tolist(),
            "robot.home_attitude": [0.1, -0.15, 0.2],
            "robot.gravity": [1.5, -2.0, 9.0],
        }
    )


def off_centre() -> hs.Scenario:
    c = np.array([0.012, -0.02, 0.03])
    robot = core_parameters(uneven()).robot
    inertia = robot.inertia + robot.mass * (c @ c * np.eye(3) - np.outer(c, c))
    return uneven().updated({"robot.centre_of_mass": c.tolist(), "robot.inertia": inertia.tolist()})


def loaded() -> hs.Scenario:
    load = {"mass": 0.02, "position": [0.02, 0.01, -0.015], "inertia": [1e-5, 2e-5, 1.5e-5], "known": False}
    return uneven().updated({"robot.payload": load})


ROBOTS = {
    "micro": lambda: hs.load_scenario("paper-nominal"),
    "cubic": lambda: hs.load_scenario("paper-nominal").updated({"robot": {"preset": "cubic"}}),
    "uneven": uneven,
    "off centre": off_centre,
    "loaded": loaded,
}


@pytest.fixture(params=list(ROBOTS))
def scenario(request: pytest.FixtureRequest) -> hs.Scenario:
    return ROBOTS[request.param]()


def hexapod_of(scenario: hs.Scenario) -> _core.Hexapod:
    return _core.Hexapod(core_parameters(scenario).robot)


def mujoco_model(scenario: hs.Scenario, step: float) -> Any:
    return mujoco.MjModel.from_xml_string(mjcf(scenario.updated({"simulation.step": step})))


def constant_forces(scenario: hs.Scenario) -> Array:
    """Leg forces that hold the platform at home, and unequal ones on top."""
    hexapod, body = hexapod_of(scenario), core_parameters(scenario).plant_body
    force = -body.mass * np.array(body.gravity)
    R_BE = np.empty(9)  # noqa: N806
    mujoco.mju_quat2Mat(R_BE, hexapod.home_quaternion)
    weight = np.concatenate([force, np.cross(R_BE.reshape(3, 3) @ body.centre_of_mass, force)])
    return hexapod.leg_forces(hexapod.home_position, hexapod.home_quaternion, weight) + UNEQUAL


def mujoco_pose(scenario: hs.Scenario, step: float) -> Array:
    """Position and quaternion (the sign with a positive w) after DURATION."""
    model = mujoco_model(scenario, step)
    data = mujoco.MjData(model)
    data.ctrl[:] = constant_forces(scenario)
    mujoco.mj_step(model, data, round(DURATION / step))
    assert data.time == pytest.approx(DURATION, rel=1e-9)
    pose = np.array(data.qpos)
    return np.concatenate([pose[:3], pose[3:] * np.sign(pose[3])])


def core_pose(scenario: hs.Scenario, step: float) -> Array:
    hexapod = hexapod_of(scenario)
    position, quaternion, _ = _core.drive_legs(
        hexapod,
        core_parameters(scenario).plant_body,
        _core.DynamicsError(),
        hexapod.home_position,
        hexapod.home_quaternion,
        np.zeros(6),
        constant_forces(scenario),
        step,
        round(DURATION / step),
    )
    return np.concatenate([position, quaternion * np.sign(quaternion[0])])


@pytest.mark.parametrize("scenario", ["micro"], indirect=True)
def test_home_share_of_the_weight(scenario: hs.Scenario) -> None:
    np.testing.assert_allclose(constant_forces(scenario) - UNEQUAL, 0.1337, rtol=0, atol=0.5e-4)  # printed digits


def test_pose_after_constant_leg_forces(scenario: hs.Scenario) -> None:
    core, reference = core_pose(scenario, 1e-4), mujoco_pose(scenario, 1e-4)
    # The motion is large enough to mean something.
    home = hexapod_of(scenario).home_quaternion
    assert np.linalg.norm(core[:3] - hexapod_of(scenario).home_position) > 0.030
    assert 2 * np.arccos(abs(core[3:] @ home)) > 0.15
    # Both have converged far below the tolerance: at twice the step they are where they were.
    assert np.abs(core - core_pose(scenario, 2e-4)).max() < 1e-10
    assert np.abs(reference - mujoco_pose(scenario, 2e-4)).max() < 1e-10
    np.testing.assert_allclose(core, reference, rtol=0, atol=1e-8)  # [m] and quaternion


def test_the_difference_is_that_of_the_time_steps(scenario: hs.Scenario) -> None:
    """Both integrate with fourth order towards the same motion: the difference falls by 16 per halving."""
    exact = mujoco_pose(scenario, 5e-5)
    steps = [4e-3, 2e-3, 1e-3]
    differences = [np.abs(core_pose(scenario, step) - exact).max() for step in steps]
    ratios = np.divide(differences[:-1], differences[1:])
    assert np.all((ratios > 12) & (ratios < 20)), (differences, ratios)


@pytest.mark.parametrize("seed", range(5))
def test_lengths_and_wrench_map_at_random_poses(scenario: hs.Scenario, seed: int) -> None:
    hexapod = hexapod_of(scenario)
    random = np.random.default_rng(seed)
    model = mujoco_model(scenario, 1e-3)
    data = mujoco.MjData(model)
    position = hexapod_of(scenario).home_position + random.uniform(-0.03, 0.03, 3)
    quaternion = hexapod.home_quaternion + random.uniform(-0.2, 0.2, 4)
    quaternion /= np.linalg.norm(quaternion)
    data.qpos[:] = np.concatenate([position, quaternion])
    mujoco.mj_forward(model, data)
    rounding = 32 * 2.0**-53  # a dozen operations on numbers below 1
    np.testing.assert_allclose(hexapod.leg_lengths(position, quaternion), data.ten_length, rtol=0, atol=rounding)

    # Tendon velocities for unit twists: MuJoCo's angular velocity is in the body's frame, ours in B.
    R_BE = np.empty(9)  # noqa: N806
    mujoco.mju_quat2Mat(R_BE, quaternion)
    rates = np.empty((6, 6))
    for axis, twist in enumerate(np.eye(6)):
        data.qvel[:] = np.concatenate([twist[:3], R_BE.reshape(3, 3).T @ twist[3:]])
        mujoco.mj_forward(model, data)
        rates[:, axis] = data.ten_velocity
    np.testing.assert_allclose(hexapod.wrench_map(position, quaternion), rates.T, rtol=0, atol=rounding)


def test_a_positive_leg_force_acts_as_its_column_of_h(scenario: hs.Scenario) -> None:
    """The sign that all of the above relies on: one unit of actuator force accelerates as one column of H."""
    hexapod = hexapod_of(scenario)
    model = mujoco_model(scenario, 1e-3)
    data = mujoco.MjData(model)
    R_BE = np.empty(9)  # noqa: N806
    mujoco.mju_quat2Mat(R_BE, hexapod.home_quaternion)
    for leg, column in enumerate(hexapod.wrench_map(hexapod.home_position, hexapod.home_quaternion).T):
        data.ctrl[:] = np.eye(6)[leg]
        mujoco.mj_forward(model, data)
        moment = R_BE.reshape(3, 3).T @ column[3:]  # MuJoCo's is in the body's frame
        np.testing.assert_allclose(data.qfrc_actuator, [*column[:3], *moment], rtol=0, atol=32 * 2.0**-53)


def test_one_second_under_the_leg_forces_of_a_run(scenario: hs.Scenario) -> None:
    """Leg forces of a controlled run, held over each tick, move MuJoCo's machine as ours: within 1e-6 m.

    Both integrate with fourth order, the attitude in different ways. Nothing corrects the difference of a step: under
    given forces the platform falls away from its path within some tens of ms.
    """
    settings = {
        "simulation.mode": "sampled",
        "simulation.step": 5e-4,
        "simulation.substeps": 1,
        "simulation.duration": 1.0,
        "simulation.log_every": 1,
        "actuators.hold": "leg_forces",
        "robot.payload.known": True,
        "simulation.start.pose": [0.006, -0.004, 0.003, 0.03, -0.04, 0.08],
        "simulation.start.twist": [0.02, 0.03, -0.01, 0.1, -0.2, 0.3],
    }
    run = hs.simulate(scenario.updated(settings))
    assert run.outcome == "completed", run.detail
    model = mujoco.MjModel.from_xml_string(mjcf(run.scenario))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "start"))
    poses = np.empty((len(run.time), 7))
    for row, forces in enumerate(run.leg_forces):
        poses[row] = data.qpos
        data.ctrl[:] = forces
        mujoco.mj_step(model, data)
    assert np.linalg.norm(run.position - run.position[0], axis=1).max() > 3e-3
    print(f"largest difference {np.abs(poses[:, :3] - run.position).max():.2g} m")
    np.testing.assert_allclose(poses[:, :3], run.position, rtol=0, atol=1e-6)  # [m]
    sign = np.sign(np.sum(poses[:, 3:] * run.quaternion, axis=1))[:, None]
    np.testing.assert_allclose(sign * poses[:, 3:], run.quaternion, rtol=0, atol=5e-6)


def test_the_keys_hold_the_platform_and_start_the_run(scenario: hs.Scenario) -> None:
    start = {"simulation.start.pose": [0.004, -0.002, 0.003, 0.02, -0.03, 0.05]}
    moving = scenario.updated({**start, "simulation.start.twist": [0.01, 0.02, -0.01, 0.1, -0.2, 0.3]})
    model = mujoco_model(moving, 1e-3)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qacc, 0.0, rtol=0, atol=1e-10)  # rounding of 10 m/s^2 and 5000 rad/s^2/N
    mujoco.mj_resetDataKeyframe(model, data, 1)
    run = hs.simulate(moving)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.ten_length, run.leg_lengths[0], rtol=0, atol=1e-15)
    lengths = hexapod_of(moving).wrench_map(run.position[0], run.quaternion[0]).T @ run.twist[0]
    np.testing.assert_allclose(data.ten_velocity, lengths, rtol=0, atol=1e-15)


CAMERAS: dict[str, dict[str, Any]] = {
    "plain": {},
    "mounted": {"camera.mount": {"position": [0.02, -0.01, 0.03], "rotation": [0.05, -0.08, 0.4]}},
    "opencv": {"camera.mount.rotation": [3.1, 0.1, 0.0], "camera.axes": "opencv"},
    "base": {"camera.mount": {"on": "base", "position": [0.02, 0.0, -0.05], "rotation": [0.05, -0.08, 0.4]}},
}


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("size", [None, [1280, 960]])
def test_the_image_of_the_target(camera: str, size: list[int] | None) -> None:
    """MuJoCo's sensor counts pixels from the top left corner; both look at the same points from the same camera."""
    mode = {"simulation.mode": "sampled"} if size else {}
    scenario = uneven().updated({**mode, "camera.image_size": size, **CAMERAS[camera]})
    move = np.array([0.004, -0.002, 0.003, 0.02, -0.03, 0.05])
    model = mujoco_model(scenario.updated({"simulation.start.pose": move.tolist()}), 1e-3)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 1)
    mujoco.mj_forward(model, data)
    up = 1.0 if camera == "opencv" else -1.0
    pixels = hs.project(scenario, move).reshape(4, 2) * [1.0, up] + np.array(size or [640, 480]) / 2.0
    np.testing.assert_allclose(data.sensordata.reshape(4, 2), pixels, rtol=0, atol=1e-9)


def test_sensors_are_half_a_pixel_beyond_the_pixels_of_a_principal_point() -> None:
    """docs/bridges.md: MuJoCo counts from the image's corner, OpenCV from the centre of the first pixel."""
    changes = {"camera.image_size": [1280, 960], "camera.principal_point": [639.5, 479.5], "camera.axes": "opencv"}
    scenario = uneven().updated({"simulation.mode": "sampled", "camera.mount.rotation": [3.1, 0.1, 0.0], **changes})
    model = mujoco_model(scenario, 1e-3)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.sensordata - 0.5, hs.project(scenario, [0.0] * 6), rtol=0, atol=1e-9)


def test_a_principal_point_off_the_centre_moves_the_frustum() -> None:
    """The border of the picture is where the calibration has it; MuJoCo keeps intrinsics in single precision."""
    size, focal, centre = np.array([1280, 960]), np.array([905.5, 903.0]), np.array([650.25, 470.75])
    changes = {"camera.focal_length": None, "camera.pixel_scale": None, "camera.focal_pixels": focal.tolist()}
    scenario = uneven().updated(
        {"simulation.mode": "sampled", "camera.image_size": size.tolist(), "camera.principal_point": centre.tolist()}
        | changes
    )
    model = mujoco_model(scenario, 1e-3)
    data, scene, camera = mujoco.MjData(model), mujoco.MjvScene(model, 100), mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    every = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, every, scene)
    found = scene.camera[0]
    half = found.frustum_width
    left, right = found.frustum_center - half, found.frustum_center + half
    sides = np.array([left, right, found.frustum_bottom, found.frustum_top]) / found.frustum_near
    first, last = (-0.5 - centre) / focal, (size - 0.5 - centre) / focal  # of the image's corners, y down
    np.testing.assert_allclose(sides, [first[0], last[0], -last[1], -first[1]], rtol=0, atol=1e-6)


@pytest.mark.parametrize("moments", [(1.5e-4, 1.5e-4), (1e-4, 2e-4), (2e-5, 2e-4)])
def test_a_flat_platform_in_any_attitude_is_a_model(moments: tuple[float, float]) -> None:
    """The largest moment is the sum of the others, to rounding, which MuJoCo does not allow for."""
    nominal = hs.load_scenario("paper-nominal")
    for turn in Rotation.random(20, random_state=0).as_matrix():
        inertia = turn @ np.diag([*moments, sum(moments)]) @ turn.T
        scenario = nominal.updated({"robot.inertia": ((inertia + inertia.T) / 2.0).tolist()})
        model = mujoco_model(scenario, 1e-3)
        np.testing.assert_allclose(np.sort(model.body("platform").inertia), [*moments, sum(moments)], rtol=1e-12)


def test_an_inertia_that_is_not_flat_is_written_as_it_is() -> None:
    scenario = hs.load_scenario("paper-nominal").updated({"robot.inertia": np.diag([1e-4, 2e-4, 2.5e-4]).tolist()})
    assert 'fullinertia="0.0001 0.0002 0.00025 0.0 0.0 0.0"' in mjcf(scenario)


def test_refusals() -> None:
    printed = hs.load_scenario("paper-nominal").updated({"camera.convention": "as_printed"})
    with pytest.raises(ValueError, match="expected eye_in_hand for MJCF, got as_printed"):
        mjcf(printed)
    positions = hs.load_scenario("pi-h824-positions")
    with pytest.raises(ValueError, match=r"got position; position_torque keeps the law, .* as actuators\.motor\.kp"):
        mjcf(positions)
    assert 'name="leg6"' in mjcf(positions.updated({"actuators.kind": "position_torque"}))


def test_the_command_names_what_the_model_leaves_out(tmp_path: Path) -> None:
    left_out = {
        "actuators.bandwidth": 30.0,
        "actuators.delay": 0.002,
        "actuators.quantisation": 1e-4,
        "target.motion.kind": "velocity",
        "target.motion.velocity": [0.01, 0.0, 0.0],
        "uncertainty.gravity": 0.1,
        "base_motion.kind": "noise",
        "camera.noise": 0.1,
        "sensors.pose": "encoders",
    }
    plain = hs.load_scenario("paper-nominal").updated({"simulation.mode": "sampled", "actuators.hold": "leg_forces"})
    scenario = plain.updated(left_out)
    assert mjcf(scenario) == mjcf(plain)
    assert set(not_in_model(scenario)) == set(left_out)
    assert not_in_model(plain) == []
    lens = {"camera.distortion.kannala_brandt": [0.1, 0.0, 0.0, 0.0]}  # moves the points that features give
    assert not_in_model(plain.updated(lens)) == list(lens)
    file = tmp_path / "mine.yaml"
    file.write_text(plain.updated({"actuators.delay": 0.002, "camera.noise": 0.1}).to_yaml(), encoding="utf-8")
    result = CliRunner().invoke(app, ["export", str(file), "--mjcf", str(tmp_path / "mine.xml")])
    assert result.stdout.splitlines()[1:] == ["Note: not in the model: camera.noise, actuators.delay."]


@pytest.mark.parametrize(
    ("name", "changes", "unit"),
    [
        ("paper-nominal", {}, "N"),
        ("paper-nominal", {"simulation.mode": "sampled", "actuators.saturation": True}, "N"),
        ("reachy-mini-head", {"actuators.saturation": True}, "N m"),
        ("reachy-mini-motors", {}, "N m"),
    ],
)
def test_keyframes_beyond_the_range_of_the_actuators_are_noted(
    name: str, changes: dict[str, Any], unit: str, tmp_path: Path
) -> None:
    """In the file and in what the command prints, where MuJoCo's own forces at the keyframe are beyond the range."""
    scenario = hs.load_scenario(name).updated(changes)
    free = mujoco.MjModel.from_xml_string(mjcf(scenario))
    data = mujoco.MjData(free)
    mujoco.mj_resetDataKeyframe(free, data, 0)
    mujoco.mj_forward(free, data)
    takes = np.abs(data.actuator_force)
    assert not keyframe_notes(scenario)
    assert "Keyframe" not in mjcf(scenario)
    tight = scenario.updated(
        {"robot.force_limit": 0.5 * (takes.min() + takes.max()) if np.ptp(takes) > 1e-6 else 0.9 * takes.max()}
    )
    limit = tight.robot.force_limit
    model = mujoco.MjModel.from_xml_string(mjcf(tight))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    acts = np.abs(data.actuator_force).max() <= limit * (1 + 1e-12)  # MuJoCo itself limits what it needs
    note = keyframe_notes(tight)[0]
    beyond = np.flatnonzero(takes > limit) + 1
    which = {1: f"leg {beyond[0]} takes", 6: "the legs take up to"}.get(
        len(beyond), f"legs {', '.join(map(str, beyond))} take up to"
    )
    assert note.startswith(f"keyframe home: {which} {takes.max():.4g} {unit} to hold the platform, beyond ")
    assert f"range of {limit:.4g} {unit} (robot.force_limit)" in note
    assert ("does not stay there" in note) == acts
    assert f"<!-- K{note[1:]}. -->" in mjcf(tight)
    file = tmp_path / "mine.yaml"
    file.write_text(tight.to_yaml(), encoding="utf-8")
    result = CliRunner().invoke(app, ["export", str(file), "--mjcf", str(tmp_path / "mine.xml")])
    assert f"Note: {note}." in result.stdout.splitlines()


def test_every_key_of_the_plant_is_in_the_model_or_left_out() -> None:
    of_plant = {entry["key"] for entry in schema() if entry["concern"] == "plant"}
    written = {f"actuators.motor.{key}" for key in ("kp", "kv", "damping", "friction", "armature")}
    of_control_program = {"actuators.hold"}
    left_out = {key for name in LEFT_OUT for key in keys_below(name)}
    assert of_plant - left_out == {*written, *of_control_program, "camera.image_size"}


def test_the_command_writes_the_model(tmp_path: Path) -> None:
    file = tmp_path / "paper.xml"
    call = ["export", "paper-nominal", "--mjcf", str(file)]
    assert CliRunner().invoke(app, call).exit_code == 0
    assert file.read_text(encoding="utf-8") == mjcf(hs.load_scenario("paper-nominal"))
    assert CliRunner().invoke(app, call).exit_code == 2
    assert CliRunner().invoke(app, [*call, "--force"]).exit_code == 0
    for wrong in (["--header", str(tmp_path / "g.hpp")], ["--period", "0.001"]):
        assert CliRunner().invoke(app, [*call, "--force", *wrong]).exit_code == 2
    assert CliRunner().invoke(app, ["export", "paper-nominal"]).exit_code == 2


@pytest.mark.parametrize(("name", "noted"), [("pi-h824", True), ("paper", False), ("pi-h824-positions", False)])
def test_a_run_that_holds_the_wrench_is_noted(tmp_path: Path, name: str, noted: bool) -> None:
    """The motors of the model hold forces: so does `actuators.hold: leg_forces`, and the other differs by mm."""
    file = tmp_path / "mine.yaml"
    changes = {"actuators.kind": "position_torque"} if name == "pi-h824-positions" else {}
    scenario = hs.load_scenario(name, changes)
    for hold in ("wrench", "leg_forces") if noted else ("",):
        held = scenario.updated({"actuators.hold": hold}) if hold else scenario
        file.write_text(held.to_yaml(), encoding="utf-8")
        result = CliRunner().invoke(app, ["export", str(file), "--mjcf", str(tmp_path / "m.xml"), "--force"])
        assert result.exit_code == 0
        assert ("Note: actuators.hold: the motors of the model hold leg forces" in result.stdout) == (hold == "wrench")
