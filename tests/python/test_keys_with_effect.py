"""Every key of a scenario changes the run, or is refused: a setting without effect is a wrong result unnoticed."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.cli.terminal import load
from hexservo.scenario.keys import all_paths, numeric_keys, sampled_keys, value_at
from hexservo.scenario.laws import ALL_LAWS, LAWS
from hexservo.scenario.parameters import core_parameters, frame_period
from hexservo.scenario.scenario import Scenario

# A legal value of every key that acts in sampled mode alone, other than its default; a servo period is 1 ms.
SAMPLED: dict[str, Any] = {
    "seed": 1,
    "robot.on_limit": "stop",
    "camera.period": 0.002,
    "camera.latency": 0.003,
    "camera.latency_jitter": 0.002,
    "camera.latency_known": False,
    "camera.timeout": 0.05,
    "camera.noise": 0.5,
    "camera.quantisation": 0.25,
    "camera.dropout": 0.3,
    "camera.outlier_probability": 0.1,
    "camera.outlier_size": 5.0,
    "camera.smoothing": 0.02,
    "camera.image_size": [200.0, 200.0],
    "camera.on_lost": "stop",
    "camera.prediction": "encoder",
    "camera.gate": 50.0,
    "sensors.pose": "encoders",
    "sensors.rate": True,
    "sensors.resolution": 1e-6,
    "sensors.noise": 1e-6,
    "sensors.period": 0.002,
    "actuators.hold": "leg_forces",
    "actuators.saturation": True,
    "actuators.bandwidth": 100.0,
    "actuators.quantisation": 1e-4,
    "actuators.delay": 0.001,
    "actuators.kind": "position",
    "actuators.position.bandwidth": 30.0,
    "actuators.position.damping": 0.7,
    "actuators.position.speed_limit": 0.01,
    "actuators.position.acceleration_limit": 0.1,
    "actuators.motor.kp": 2000.0,
    "actuators.motor.kv": 5.0,
    "actuators.motor.damping": 1.0,
    "actuators.motor.friction": 0.01,
    "actuators.motor.armature": 0.01,
    "actuators.motor.quantisation": 1e-5,
    "base_motion.kind": "sinusoid",
    "base_motion.amplitude": [0.1, 0.0, 0.0],
    "base_motion.frequency": 3.0,
    "base_motion.phase": 0.5,
    "base_motion.level": 1e-3,
    "base_motion.low_frequency": 2.0,
    "base_motion.high_frequency": 20.0,
    "base_motion.samples": [[0.0, 0.0, 0.1], [0.1, 0.0, 0.0]],
    "base_motion.attitudes": [[1.0, 0.0, 0.0, 0.0], [0.99, 0.1, 0.0, 0.0]],
    "base_motion.sample_period": 0.01,
    "base_motion.rotation.kind": "sinusoid",
    "base_motion.rotation.amplitude": [0.01, 0.0, 0.0],
    "base_motion.rotation.frequency": 3.0,
    "base_motion.rotation.phase": 0.5,
    "base_motion.rotation.level": 1e-5,
    "base_motion.rotation.low_frequency": 2.0,
    "base_motion.rotation.high_frequency": 20.0,
    "base_motion.road.roughness": "C",
    "base_motion.road.speed": 20.0,
    "base_motion.road.wheelbase": 3.0,
    "base_motion.road.track": 1.7,
    "base_motion.road.suspension": 3.0,
    "base_motion.road.damping": 0.5,
    "base_motion.road.longest": 50.0,
    "base_motion.road.shortest": 0.3,
    "base_motion.road.position": [1.0, 0.0, -0.5],
    "target.frame": "world",
    "target.motion.kind": "velocity",
    "target.motion.velocity": [0.01, 0.0, 0.0],
    "target.motion.amplitude": [0.01, 0.0, 0.0],
    "target.motion.frequency": 3.0,
    "target.motion.phase": 0.5,
    "target.motion.samples": [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]],
    "target.motion.sample_period": 0.01,
    "simulation.substeps": 2,
    "controller.safe.damping": 1.0,
    "controller.safe.hold": 10.0,
    "controller.virtual_platform.damping": 1e-3,
    "uncertainty.focal_length": 0.02,
    "uncertainty.principal_point": [3.0, -2.0],
    "uncertainty.latency": 0.004,
}
# In continuous mode: what is for people, or is about another key, or is a gain that `others` sees.
FOR_PEOPLE = {"name", "description", "simulation.log_every"}
RECORDING, WAY = (
    tuple(f"{block}.{key}" for key in ("samples", "sample_period")) for block in ("base_motion", "target.motion")
)
TOGETHER = {key: keys for keys in (RECORDING, WAY) for key in keys} | {
    "base_motion.attitudes": (*RECORDING, "base_motion.attitudes")
}
TOGETHER |= {
    key: ("actuators.kind", key)
    for key in SAMPLED
    if key.startswith(("actuators.position.", "actuators.motor.")) or key == "controller.virtual_platform.damping"
}
READ = {"base_motion.file", "base_motion.frame_of_acceleration", "target.motion.file"}  # into samples
SENTENCE = "no effect in continuous mode; set simulation.mode: sampled, or drop"


@pytest.fixture(scope="module")
def short(paper: hs.Scenario) -> hs.Scenario:
    return paper.updated({"simulation.duration": 0.05})


def leaves() -> list[str]:
    """Every key that holds no keys."""
    paths = list(all_paths(Scenario))
    return [path for path in paths if not any(other.startswith(f"{path}.") for other in paths)]


def fingerprint(scenario: hs.Scenario) -> bytes:
    """Return all of a run's content, as bytes."""
    result = hs.simulate(scenario)
    arrays = [result.time, result.feature_error, result.position, result.quaternion, result.wrench, result.leg_forces]
    numbers = np.array([*hs.metrics(result).values(), result.end_time])
    words = repr((result.outcome, result.events)).encode()
    return b"".join([*(np.ascontiguousarray(a).tobytes() for a in [*arrays, numbers]), words])


def _joints(scenario: hs.Scenario) -> tuple[Any, Any]:
    hexapod = _core.Hexapod(core_parameters(scenario).robot)
    return hexapod.platform_joints, hexapod.base_joints


def turned(vectors: NDArray[np.float64], about: NDArray[np.float64]) -> Any:
    return Rotation.from_rotvec(0.1 * about).apply(vectors).tolist()


def another(scenario: hs.Scenario, key: str) -> dict[str, Any]:
    """Another value of a key that acts in continuous mode, as changes."""
    value = value_at(scenario, key)
    law = "uncertainty" if key.startswith("uncertainty.") else ""
    special: dict[str, dict[str, Any]] = {
        "robot.preset": {"robot": {**scenario.to_mapping()["robot"], "preset": None, "mass": 0.2}},
        "robot.stroke": {key: 1e-9},
        "robot.force_limit": {key: 1e-6},
        "robot.legs": {"robot": rotary_machine.robot()},
        "robot.cranks.branch": {key: (rotary_machine.BRANCH * [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]).tolist()},
        "robot.cranks.axes": {key: turned(rotary_machine.AXES, rotary_machine.ZERO)},
        "robot.cranks.zero": {key: turned(rotary_machine.ZERO, rotary_machine.AXES)},
        "robot.cranks.length": {key: 1.01 * rotary_machine.CRANK},
        "robot.speed_limit": {key: 1e-6},
        "robot.joint_limit": {key: [1e-6, 1e-6]},
        "robot.limits_every": {key: 7},
        "camera.convention": {key: "as_printed"},
        "camera.focal_pixels": {"camera": {"focal_length": None, "pixel_scale": None, "focal_pixels": 700.0}},
        "camera.principal_point": {key: [5.0, -3.0]},
        "camera.axes": {key: "opencv"},
        "camera.mount.on": {key: "base"},
        "camera.distortion.brown_conrady": {key: [-0.3, 0.1, 1e-3, 1e-3, 0.0]},
        "camera.distortion.kannala_brandt": {key: [0.1, 0.0, 0.0, 0.0]},
        "robot.platform_joints": {key: (np.array(_joints(scenario)[0]) + np.eye(6, 3) * 1e-3).tolist()},
        "robot.base_joints": {key: (np.array(_joints(scenario)[1]) + np.eye(6, 3) * 1e-3).tolist()},
        "robot.centre_of_mass": {key: [0.01, -0.01, 0.005], "robot.inertia": [5e-4] * 3},
        "robot.payload.position": {"robot.payload": {"mass": 0.01, "position": [0.01, 0.02, 0.0]}},
        "robot.payload.inertia": {"robot.payload": {"mass": 0.01, "inertia": [1e-5] * 3}},
        "robot.payload.known": {"robot.payload": {"mass": 0.01, "known": False}},
        "target.desired_pose": {"target": {"desired_features": None, "desired_pose": [1e-3] * 3 + [1e-2] * 3}},
        "target.weights": {key: 2.0},
        "target.grid": {
            "target": {
                "initial_features": None,
                "depth": None,
                "grid": {"rows": 2, "columns": 2, "spacing": 0.1, "pose": [0.0, 0.0, -0.65, 0.0, 0.0, 0.0]},
            }
        },
        "target.tag": {
            "target": {"initial_features": None, "depth": None, "tag": {"size": 0.1, "pose": [0, 0, -0.65, 0, 0, 0]}}
        },
        "target.points": {
            "target": {
                "initial_features": None,
                "depth": None,
                "points": [[0.02, 0.03, -0.65], [0.05, -0.05, -0.66], [-0.04, 0.03, -0.64], [-0.01, -0.02, -0.65]],
            }
        },
        "controller.law": {key: "kelly"},
        "controller.jacobian": {key: "printed"},
        "controller.switching.kind": {key: "tanh"},
        "controller.switching.width": {key: 0.01},
        "controller.hybrid.fuzzy.table": {key: (0.5 * np.ones((7, 7))).tolist()},
        "controller.composite.fuzzy.table": {key: (0.5 * np.ones((7, 7))).tolist()},
        "controller.resolved_rate.jacobian_at": {key: "mean"},
        **{f"controller.{law}.auto.bandwidth": {key: 5.0} for law in ALL_LAWS},
        "controller.tracking.follow": {key: "direction"},
        "controller.tracking.jump": {key: 1e-3},
        "simulation.step": {key: 5e-4},
        "simulation.duration": {key: 0.06},
        "metrics.band": {key: 30.0},
        "metrics.dwell": {key: 0.05},
        "metrics.rms_start": {key: 0.02},
    }
    if key in special:
        return special[key]
    if key.endswith((".weight_limit", ".initial_scale")):
        return {key: 1e-6}
    if isinstance(value, bool):
        return {key: not value}
    array = np.asarray(value, dtype=float)
    shift = 0.01 * (law == "uncertainty") + 1e-3 * np.arange(1, array.size + 1).reshape(array.shape) * (array == 0)
    return {key: (array * (1.01 if "angles" in key else 1.25) + shift).tolist()}


def base_for(short: hs.Scenario, key: str) -> hs.Scenario:
    """The scenario in which a key acts: with its law, and what it works on."""
    laws = [law for law in ALL_LAWS if key.startswith(f"controller.{law}.")]
    changes: dict[str, Any] = {"controller.law": laws[0]} if laws else {}
    if laws and laws[0] not in LAWS:
        changes |= {"simulation.mode": "sampled", "actuators.kind": "position"}
        changes |= {"camera.noise": 0.01, "controller.tracking.noise": 0.01}
        changes["target.motion"] = {"kind": "velocity", "velocity": [0.3, 0.0, 0.0]}
    if key.endswith(".jump"):  # 5.5 times the speed that is expected of a target just seen
        changes["target.motion"] = {"kind": "velocity", "velocity": [1.1, 0.0, 0.0]}
    if key == "controller.switching.width":
        changes["controller.switching.kind"] = "tanh"
    if key.endswith((".fuzzy.table", ".leakage")):
        changes[f"controller.{laws[0]}.fuzzy.initial_scale"] = 1e-4
    if key.startswith("controller.resolved_rate.gain_"):
        changes["controller.resolved_rate.adaptive"] = True
    if key.endswith(".auto.damping"):
        changes[f"controller.{laws[0]}.auto.bandwidth"] = 5.0
    if key == "metrics.dwell":
        changes["simulation.duration"] = 0.45  # it comes within the band at 0.35 s
    if key == "uncertainty.coriolis":
        changes["uncertainty.depth"] = [0.3, 0.2, 0.1, 0.25]
    if key.startswith("robot.cranks."):
        changes["robot"] = rotary_machine.robot()
    return short.updated(changes)


# What acts where legs come to rest, which test_tracking.py shows; and a damping that this law's motion does not take.
ELSEWHERE = {f"controller.tracking.{key}" for key in ("integral", "band", "auto.damping")}
NEEDED = {"camera.latency_known": {"controller.law": "tracking", "actuators.kind": "position"}}


def test_the_list_above_has_every_key_of_sampled_mode() -> None:
    assert set(SAMPLED) == set(sampled_keys()) - READ
    for block in ("sensors", "actuators", "base_motion"):
        assert {key for key in leaves() if key.startswith(f"{block}.")} <= set(sampled_keys())


@pytest.mark.parametrize("key", leaves())
def test_a_key_changes_the_continuous_run_or_is_refused(short: hs.Scenario, key: str) -> None:
    if key in FOR_PEOPLE or key in {"simulation.mode", *READ, *ELSEWHERE}:
        return
    if key not in SAMPLED:
        base = base_for(short, key)
        assert fingerprint(base.updated(another(base, key))) != fingerprint(base), key
        return
    change = {key: SAMPLED[key]}
    if key in TOGETHER:  # neither goes without the other
        change = {name: SAMPLED[name] for name in TOGETHER[key]}
    if key.startswith("actuators.motor."):
        change["actuators.kind"] = "position_torque"
    with pytest.raises(hs.ScenarioError) as caught:
        short.updated(change)
    (problem,) = caught.value.problems
    assert set(problem.partition(":")[0].split(", ")) == set(change)
    assert SENTENCE in problem
    sampled = short.updated({**change, "simulation.mode": "sampled", **NEEDED.get(key, {})})
    assert value_at(sampled, key) != sampled_keys()[key]
    assert short.updated({key: sampled_keys()[key]}) == short  # the default may be written


def test_going_back_to_continuous_mode_names_everything_to_drop() -> None:
    real = hs.load_scenario("real-machine")
    with pytest.raises(hs.ScenarioError) as caught:
        real.updated({"simulation.mode": "continuous", "controller.switching.kind": "sign"})
    (problem,) = caught.value.problems
    keys = problem.partition(":")[0].split(", ")
    assert SENTENCE in problem
    assert {"camera.period", "camera.noise", "sensors.pose", "actuators.bandwidth", "base_motion.kind"} <= set(keys)
    dropped = real.updated(
        {"simulation.mode": "continuous", "controller.switching.kind": "sign", **{k: sampled_keys()[k] for k in keys}}
    )
    assert dropped.simulation.mode == "continuous"


def test_a_batch_on_a_continuous_scenario_refuses_them_too(short: hs.Scenario) -> None:
    numeric = [key for key in SAMPLED if key in numeric_keys("hybrid")]
    assert len(numeric) > 15
    for key in numeric:
        default = value_at(short.updated({"simulation.mode": "sampled"}), key)
        for first in (SAMPLED[key], SAMPLED[key] if default is None else default):  # also where a sweep starts there
            with pytest.raises(ValueError, match=f"^{key}: has {SENTENCE} the key$"):
                hs.simulate_batch(short, {key: np.stack([np.asarray(first), np.asarray(SAMPLED[key])])})


def test_frames_come_at_the_servo_period_unless_told_otherwise(short: hs.Scenario) -> None:
    sampled = short.updated({"simulation.mode": "sampled"})
    slower = sampled.updated({"simulation.step": 2e-3})
    for scenario, period in ((short, 1e-3), (sampled, 1e-3), (slower, 2e-3)):
        assert scenario.camera.period is None
        assert frame_period(scenario) == period
    assert slower == short.updated({"simulation.step": 2e-3, "simulation.mode": "sampled"})
    assert slower.updated({"simulation.mode": "continuous"}) == short.updated({"simulation.step": 2e-3})
    kept = sampled.updated({"camera.period": 4e-3}).updated({"simulation.step": 2e-3})
    assert kept.camera.period == 4e-3
    assert kept.updated({"camera.period": None}) == slower


def test_a_written_frame_period_stays_where_it_equals_the_servo_period(short: hs.Scenario, tmp_path: Path) -> None:
    """By `updated`, from a file, as a setting and in a batch, before and after it was saved."""
    sampled = short.updated({"simulation.mode": "sampled", "simulation.step": 2e-3})
    written = sampled.updated({"camera.period": 2e-3})
    assert written != sampled
    file = tmp_path / "written.yaml"
    file.write_text(written.to_yaml(), encoding="utf-8")
    finer = {"simulation.step": 1e-3}
    for same in (written, hs.Scenario.from_yaml(written.to_yaml()), pickle.loads(pickle.dumps(written))):
        assert same == written
        assert same.updated(finer).camera.period == 2e-3
    assert hs.load_scenario(file, finer) == load(str(file), ["simulation.step=1e-3"]) == written.updated(finer)
    coarser = {"simulation.step": 5e-3}
    misfit = r"camera\.period: expected a whole number of servo periods \(simulation\.step"
    for attempt in (
        lambda: written.updated(coarser),
        lambda: hs.load_scenario(file, coarser),
        lambda: hs.simulate_batch(written, {"simulation.step": [5e-3]}),
        lambda: hs.simulate_batch(written, {"simulation.step": [2e-3, 5e-3]}),
    ):
        with pytest.raises(ValueError, match=misfit):
            attempt()
    metrics = hs.metrics(hs.simulate(written.updated(finer)))
    batch = hs.simulate_batch(written, {"simulation.step": [1e-3]}, log="metrics").metrics
    assert batch["final_error"][0] == pytest.approx(metrics["final_error"], rel=1e-9)
    assert metrics != hs.metrics(hs.simulate(sampled.updated(finer)))
    with pytest.raises(hs.ScenarioError, match=r"camera\.period: has no effect in continuous mode"):
        written.updated({"simulation.mode": "continuous"})


def test_an_unwritten_frame_period_follows_after_it_was_saved(short: hs.Scenario, tmp_path: Path) -> None:
    sampled = short.updated({"simulation.mode": "sampled"})
    file = tmp_path / "shown.yaml"
    file.write_text(sampled.to_yaml(), encoding="utf-8")
    assert "period: null" in sampled.to_yaml()
    for again in (hs.Scenario.from_yaml(sampled.to_yaml()), pickle.loads(pickle.dumps(sampled))):
        assert again == sampled
        assert frame_period(again.updated({"simulation.step": 2e-3})) == 2e-3
    assert hs.load_scenario(file, {"simulation.step": 2e-3}) == sampled.updated({"simulation.step": 2e-3})


def test_a_batch_of_servo_periods_takes_its_frames_along(short: hs.Scenario) -> None:
    sampled = short.updated({"simulation.mode": "sampled", "controller.switching.kind": "tanh"})
    steps = np.array([1e-3, 5e-4, 2.5e-4])
    batch = hs.simulate_batch(sampled, {"simulation.step": steps}, log="metrics")
    assert set(batch.variations) == {"simulation.step"}
    for index, step in enumerate(steps):
        alone = hs.metrics(hs.simulate(sampled.updated({"simulation.step": float(step)})))
        assert batch.metrics["final_error"][index] == pytest.approx(alone["final_error"], rel=1e-9)
    late = sampled.updated({"camera.period": 2e-3})  # this one stays
    batch = hs.simulate_batch(late, {"simulation.step": steps}, log="metrics")
    for index, step in enumerate(steps):
        alone = hs.metrics(hs.simulate(late.updated({"simulation.step": float(step)})))
        assert batch.metrics["final_error"][index] == pytest.approx(alone["final_error"], rel=1e-9)


# ---- No way around the checks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["model_copy", "copy"])
def test_a_copy_takes_no_unchecked_values(paper: hs.Scenario, method: str) -> None:
    for block, change in [
        (paper, {"seed": -1}),
        (paper, {"name": "fine"}),
        (paper.camera, {"noise": -1.0}),
        (paper.controller.hybrid.fuzzy, {"bell_width": "wide"}),
    ]:
        with pytest.raises(TypeError, match=r"scenario\.updated"):
            getattr(block, method)(update=change)
        assert getattr(block, method)() == block
        assert getattr(block, method)(deep=True) == block


@pytest.mark.parametrize("method", ["model_construct", "construct"])
def test_nothing_is_made_of_unchecked_values(paper: hs.Scenario, method: str) -> None:
    for kind in (hs.Scenario, type(paper.camera)):
        with pytest.raises(TypeError, match="expected checked values"):
            getattr(kind, method)(seed=-1)
    assert copy.copy(paper) == paper
