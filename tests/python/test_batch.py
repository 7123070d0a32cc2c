"""Batches: each scenario against the single run, what may vary, what is refused, progress, Ctrl-C and memory."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hexservo as hs
import rotary_machine
from hexservo import _core
from hexservo.run.batch import Log
from hexservo.scenario.keys import numeric_keys
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters

CONSTANTS = {"simulation.duration": 0.1, "controller.switching": {"kind": "tanh", "width": 0.01}}


@pytest.fixture(scope="module")
def smooth(paper: hs.Scenario) -> hs.Scenario:
    """A tenth of a second without the sign function, which would make differences of rounding grow."""
    return paper.updated(CONSTANTS)


def assert_same(
    batch: hs.BatchResult, index: int, single: hs.Result, tolerance: float = 1e-11, floor: float = 0.0
) -> None:
    assert batch.outcome[index] == single.outcome
    assert batch.end_time[index] == single.end_time
    assert batch.detail(index) == single.detail
    for name, value in hs.metrics(single).items():
        assert batch.metrics[name][index] == pytest.approx(value, rel=tolerance, abs=floor, nan_ok=True), name
    for name, values in batch.samples.items():
        expected = getattr(single, name)
        size = np.abs(expected).max()
        last = expected if name == "fuzzy_weights" else expected[-1]
        np.testing.assert_allclose(values[index], last, rtol=0, atol=tolerance * size, err_msg=name)


SAMPLED_ROWS: dict[str, list[Any]] = {  # the first is what `sampled` has
    "seed": [0.0, 1.0, 2.0],
    "camera.period": [0.005, 0.004, 0.002],
    "camera.latency": [0.003, 0.002, 0.0],
    "camera.latency_jitter": [0.002, 0.001, 0.0],
    "camera.timeout": [0.015, 0.05, 0.02],
    "camera.noise": [0.1, 0.2, 0.0],
    "camera.quantisation": [0.01, 0.5, 0.0],
    "camera.dropout": [0.2, 0.5, 0.0],
    "camera.outlier_probability": [0.2, 0.5, 0.0],
    "camera.outlier_size": [1.0, 2.0, 0.0],
    "camera.smoothing": [0.0, 0.01, 0.1],
    "camera.image_size": [[132.0, 131.0], [160.0, 160.0], [131.0, 500.0]],
    "camera.gate": [50.0, 0.5, 5.0],
    "uncertainty.latency": [0.0, 0.004, -0.002],
    "sensors.resolution": [1e-6, 1e-5, 0.0],
    "sensors.noise": [1e-6, 2e-6, 0.0],
    "sensors.period": [0.002, 0.001, 0.005],
    "actuators.bandwidth": [50.0, 100.0, 20.0],
    "actuators.quantisation": [1e-4, 1e-3, 0.0],
    "actuators.delay": [0.001, 0.0, 0.002],
    "base_motion.amplitude": [[0.1, 0.0, 0.0], [0.0, 0.2, 0.1], [0.0, 0.0, 0.1]],
    "base_motion.frequency": [3.0, 10.0, 0.0],
    "base_motion.phase": [0.5, 1.0, -1.0],
    "base_motion.level": [1e-3, 2e-3, 1e-4],
    "base_motion.low_frequency": [1.0, 2.0, 0.0],
    "base_motion.high_frequency": [10.0, 20.0, 30.0],
    "base_motion.rotation.amplitude": [[0.01, 0.0, 0.0], [0.0, 0.02, 0.01], [0.0, 0.0, 0.02]],
    "base_motion.rotation.frequency": [1.0, 2.0, 3.0],
    "base_motion.rotation.phase": [0.5, 1.0, -1.0],
    "base_motion.rotation.level": [1e-6, 2e-6, 1e-5],
    "base_motion.rotation.low_frequency": [1.0, 2.0, 0.0],
    "base_motion.rotation.high_frequency": [10.0, 20.0, 30.0],
    "base_motion.road.speed": [10.0, 20.0, 5.0],
    "base_motion.road.wheelbase": [2.7, 3.0, 1.0],
    "base_motion.road.track": [1.5, 1.7, 0.5],
    "base_motion.road.suspension": [1.5, 2.0, 1.0],
    "base_motion.road.damping": [0.3, 0.5, 0.2],
    "base_motion.road.longest": [100.0, 50.0, 30.0],
    "base_motion.road.shortest": [0.1, 0.2, 0.5],
    "base_motion.road.position": [[0.0, 0.0, 0.0], [1.0, 0.0, -0.5], [0.0, 0.5, 0.0]],
    "target.motion.velocity": [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, -0.01]],
    "target.motion.amplitude": [[1e-3, 0.0, 0.0], [0.0, 2e-3, 0.0], [0.0, 0.0, 1e-3]],
    "target.motion.frequency": [1.0, 3.0, 0.5],
    "target.motion.phase": [0.0, 1.0, -0.5],
    "simulation.substeps": [1.0, 2.0, 3.0],
    "controller.safe.damping": [1e-3, 2e-3, 0.0],
    "controller.safe.hold": [1e-2, 2e-2, 0.0],
}
MOTION_OF: dict[str, dict[str, Any]] = {  # where keys of other motions act
    "base_motion.rotation.l": {"base_motion.rotation.kind": "noise"},
    "base_motion.rotation.h": {"base_motion.rotation.kind": "noise"},
    "base_motion.rotation.": {"base_motion.rotation.kind": "sinusoid"},
    "base_motion.road.": {"base_motion.kind": "road"},
    "target.motion.velocity": {"target.motion.kind": "velocity"},
    "target.motion.": {"target.motion.kind": "sinusoid"},
}
WHOLE = ("seed", "robot.limits_every", "simulation.log_every", "simulation.substeps")
NOISE_OF_THE_BASE = ("base_motion.level", "base_motion.low_frequency", "base_motion.high_frequency")


@pytest.fixture(scope="module")
def sampled(smooth: hs.Scenario) -> hs.Scenario:
    """A camera, encoders and actuators with every fault, on a base that moves."""
    first = {key: rows[0] for key, rows in SAMPLED_ROWS.items()}
    first |= {"sensors.pose": "encoders", "base_motion.kind": "sinusoid", "camera.on_lost": "predict"}
    return smooth.updated({**first, "seed": 0, "simulation.substeps": 1, "simulation.mode": "sampled"})


CALIBRATED: dict[str, list[Any]] = {  # the first is what `calibrated` has
    "camera.focal_pixels": [[582.0, 580.0], [583.0, 581.0], [580.0, 582.0]],
    "camera.principal_point": [[320.0, 240.0], [321.0, 239.0], [318.0, 243.0]],
    "camera.distortion.brown_conrady": [[0.1, 0.0, 0.0, 0.0, 0.0], [0.05, 0.01, 1e-3, 0.0, 0.0], [-0.1] + [0.0] * 4],
    "camera.distortion.kannala_brandt": [[0.1, 0.0, 0.0, 0.0], [0.05, 0.01, 0.0, 0.0], [-0.05, 0.0, 0.0, 0.0]],
    "uncertainty.focal_length": [[0.01], [0.02], [-0.01]],
    "uncertainty.principal_point": [[1.0, 0.0], [2.0, -1.0], [0.0, 1.0]],
}


POSITIONED: dict[str, list[Any]] = {  # of a machine that takes positions; the first is what its scenario has
    "actuators.position.bandwidth": [30.0, 10.0, 60.0],
    "actuators.position.damping": [1.0, 0.5, 2.0],
    "actuators.position.speed_limit": [0.05, 0.01, 0.005],
    "actuators.position.acceleration_limit": [1.0, 0.1, 0.05],
    "controller.virtual_platform.damping": [0.0, 1e-3, 2e-3],
}


ON_MOTORS: dict[str, list[Any]] = {  # likewise
    "actuators.motor.kp": [2000.0, 500.0, 1000.0],
    "actuators.motor.kv": [12.0, 5.0, 8.0],
    "actuators.motor.damping": [0.0, 1.0, 0.5],
    "actuators.motor.friction": [0.01, 0.03, 0.0],
    "actuators.motor.armature": [0.0, 0.01, 0.02],
    "actuators.motor.quantisation": [0.0, 1e-5, 1e-4],
}


def calibrated(sampled: hs.Scenario, key: str) -> hs.Scenario:
    """The same task, through a calibrated camera."""
    first = {name: rows[0] for name, rows in CALIBRATED.items() if "distortion" not in name or name == key}
    centre = np.array(first["camera.principal_point"])
    image = {
        f"target.{name}": (getattr(sampled.target, name) + np.tile(centre, 4)).tolist()
        for name in ("initial_features", "desired_features")
    }
    pixels = {"camera.focal_length": None, "camera.pixel_scale": None, "camera.image_size": [640.0, 480.0]}
    errors = {"uncertainty.focal_length": 0.01, "camera.noise": 0.0, "camera.outlier_probability": 0.0}
    return sampled.updated({**pixels, **first, **image, **errors})


# ---- Every key ------------------------------------------------------------------------------------------------------


def crank_rows(name: str) -> NDArray[np.float64]:
    """Three rows for a key of rotary legs."""
    if name in ("length", "rod"):
        return {"length": rotary_machine.CRANK, "rod": rotary_machine.ROD}[name] * np.array([1.0, 1.01, 0.98])
    if name == "branch":
        other = rotary_machine.BRANCH * [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
        return np.stack([rotary_machine.BRANCH, other, rotary_machine.BRANCH])
    own, about = rotary_machine.AXES, rotary_machine.ZERO
    own, about = (about, own) if name == "zero" else (own, about)
    turns = [Rotation.from_rotvec(angle * about) for angle in (0.0, 0.01, -0.02)]
    return np.stack([turn.apply(own) for turn in turns])


def rows_of(scenario: hs.Scenario, key: str) -> list[NDArray[np.float64]]:
    """Three rows for a key, in each form that it may have: what the scenario has, and two others."""
    value: Any = scenario
    for part in key.split("."):
        value = getattr(value, part)
    if key.endswith(".fuzzy.table"):
        value = _core.LINEAR_RULE_TABLE
    if key.endswith(".fuzzy.weight_limit"):
        value = 1e-5  # null would be no limit
    if key == "target.points":
        points = np.array([[0.02, 0.03, -0.65], [0.05, -0.05, -0.66], [-0.04, 0.03, -0.64], [-0.01, -0.02, -0.65]])
        return [np.stack([points, points + 0.001, points * 1.01])]
    if key.endswith("_joints"):
        joints = np.array(value)
        return [np.stack([joints, joints + 1e-3 * np.eye(6, 3), 1.01 * joints])]
    if key in ("robot.speed_limit", "robot.joint_limit"):
        rows = np.array([[0.05, 0.05], [0.01, 0.02], [0.003, 0.1]])
        return [rows[:, 0] if key == "robot.speed_limit" else rows]
    if key.startswith("robot.cranks."):
        return [crank_rows(key.rpartition(".")[2])]
    if key == "robot.centre_of_mass":
        return [np.array([[0.0, 0.0, 0.0], [0.01, -0.02, 0.005], [0.0, 0.01, 0.0]])]
    arrays = []
    for shape in numeric_keys(scenario.controller.law)[key].shapes:
        if key.endswith(".inertia") and key.startswith("robot.") and shape == (3, 3):
            base = np.diag([1.5e-4, 1.6e-4, 2.5e-4]) + 2e-6 * (np.ones((3, 3)) - np.eye(3))
            base *= 1.0 if key == "robot.inertia" else 0.01
        elif np.ndim(value) <= len(shape):
            base = np.broadcast_to(np.asarray(value, dtype=float), shape)
        else:
            base = np.full(shape, np.ravel(value).min())  # of newtons and newton metres what neither finds too stiff
        steps = {
            "simulation.step": [1.0, 0.5, 2.0],
            "simulation.duration": [1.0, 0.5, 2.0],
            "simulation.log_every": [1.0, 2.0, 3.0],
            "robot.limits_every": [1.0, 7.0, 10.0],
            "controller.hybrid.fuzzy.bell_slope": [1.0, 1.5, 0.75],
            "controller.composite.fuzzy.bell_slope": [1.0, 1.5, 0.75],
            "metrics.band": [1.0, 20.0, 10.0],
            "metrics.rms_start": [1.0, 0.01, 0.05],
        }.get(key, [1.0, 1.01, 0.98])
        rows = np.stack([base * step for step in steps])
        if key in SAMPLED_ROWS or key in CALIBRATED or key in POSITIONED or key in ON_MOTORS:
            rows = np.array(CALIBRATED.get(key) or POSITIONED.get(key) or ON_MOTORS.get(key) or SAMPLED_ROWS[key])
            if key == "camera.focal_pixels" and shape == ():
                rows = rows[:, :1]
            rows = np.broadcast_to(rows.reshape(3, *[-1] * len(shape)), (3, *shape)).copy()
        elif key.endswith((".leakage", ".dead_zone", ".damping")):
            rows[1], rows[2] = 0.01, 0.02
        elif not rows.any():  # relative errors and initial scales that are zero
            rows[1], rows[2] = 0.01, -0.015
        if key == "target.initial_features":
            rows[1] += np.tile([1.0, 2.0], 4)  # the image of a pose, which `pbvs` needs as a goal
        if key == "target.desired_features":
            rows[1] += np.arange(8)
        arrays.append(rows)
    return arrays


def laws_and_keys() -> list[Any]:
    """Every key of machine and run with one law in turn, every key of a controller with each; the rest is `slow`."""
    common = [key for key in numeric_keys(LAWS[0]) if not key.startswith("controller.")]
    turn = {key: LAWS[index % len(LAWS)] for index, key in enumerate(common)}
    return [
        pytest.param(law, key, marks=() if turn.get(key, law) == law else pytest.mark.slow)
        for law in LAWS
        for key in numeric_keys(law)
    ]


@pytest.mark.parametrize(("law", "key"), laws_and_keys())
def test_every_key_that_holds_numbers_may_vary(smooth: hs.Scenario, sampled: hs.Scenario, law: str, key: str) -> None:
    base = smooth = (sampled if key in SAMPLED_ROWS or key in CALIBRATED else smooth).updated({"controller.law": law})
    if key == "target.points":
        points = rows_of(smooth, key)[0][0]
        rays = points - smooth.robot.home_position
        goal = -smooth.camera.focal_length * smooth.camera.pixel_scale * rays[:, :2] / rays[:, 2:] + [-20.0, -8.0]
        base = smooth.updated(
            {"target": {"initial_features": None, "depth": None, "points": points, "desired_features": goal.ravel()}}
        )
    if key.endswith("_joints"):
        side = key.removeprefix("robot.").removesuffix("_joints")
        hexapod = _core.Hexapod(core_parameters(base).robot)
        circle = {f"robot.{side}_radius": None, f"robot.{side}_angles": None}
        base = base.updated({**circle, key: getattr(hexapod, f"{side}_joints")})
    if key.startswith("robot.cranks."):
        base = base.updated({"robot": rotary_machine.robot()})
    if key in POSITIONED:
        if key == "controller.virtual_platform.damping" and law in ("resolved_rate", "pbvs"):
            return  # whose platform has no mass: refused
        first = {name: rows[0] for name, rows in POSITIONED.items()}
        base = base.updated({**first, "actuators.kind": "position", "simulation.mode": "sampled"})
    if key in ON_MOTORS:
        first = {name: rows[0] for name, rows in ON_MOTORS.items()}
        base = base.updated({**first, "actuators.kind": "position_torque", "simulation.mode": "sampled"})
    if key in CALIBRATED:
        base = calibrated(base, key)
    if key == "robot.centre_of_mass":  # an inertia that a body with all of these has
        base = base.updated({"robot.inertia": [5e-4] * 3})
    if key.startswith("robot.payload."):
        base = base.updated({"robot.payload": {"mass": 6e-3, "position": [0.01, 0.02, -0.01], "inertia": [1e-6] * 3}})
    if key in NOISE_OF_THE_BASE:
        base = base.updated({"base_motion.kind": "noise"})
    base = base.updated(next((changes for head, changes in MOTION_OF.items() if key.startswith(head)), {}))
    if key.endswith((".fuzzy.table", ".fuzzy.initial_scale", ".fuzzy.leakage")):
        base = base.updated({f"controller.{law}.fuzzy.initial_scale": 1e-4})
    if key == "target.points":  # they hardly tell the pose: undamped, forces of 20 kN and their rounding
        base = base.updated({"controller.resolved_rate.damping": 100.0})
    if key.startswith("controller.resolved_rate.gain"):
        base = base.updated({"controller.resolved_rate.adaptive": True})
    if ".auto." in key:
        base = base.updated({f"controller.{law}.auto.bandwidth": 5.0})
    if key == "uncertainty.coriolis":
        base = base.updated({"uncertainty.depth": [0.3, 0.2, 0.1, 0.25]})  # with equal ones some laws do not turn
    # The plain pseudo-inverse solves with J^T J, whose condition is that of the image squared: 1e7 times the rounding.
    # So does the estimate of `pbvs`, whose prior an exact image releases. What is zero but for rounding (rotation, if
    # all depths err alike) has no digits to compare: motions are of 1e-2 to 1 in SI units.
    # Where limits begin to act rounding decides on which side of a step.
    tolerance = 1e-8 if law in ("resolved_rate", "pbvs") else 1e-9 if key in POSITIONED or key in ON_MOTORS else 1e-11
    floor = tolerance if law in ("resolved_rate", "pbvs") else 0.0
    for rows in rows_of(base, key):
        batch = hs.simulate_batch(base, {key: rows})
        assert len(batch) == 3
        for index, row in enumerate(rows):
            value = int(row) if key in WHOLE else row.tolist()
            single = hs.simulate(base.updated({key: value}))
            assert_same(batch, index, single, tolerance, floor)
        everything = np.column_stack(
            [*batch.metrics.values(), *(values.reshape(3, -1) for values in batch.samples.values())]
        )
        # a run that never comes within the band has no stay there
        without_effect = {"simulation.log_every", "metrics.dwell"}
        without_effect |= {f"robot.{name}" for name in ("stroke", "force_limit", "speed_limit", "joint_limit")}
        if "fuzzy" not in type(getattr(base.controller, law)).model_fields:
            without_effect.add("controller.switching.width")
        assert np.array_equal(everything[0], everything[1], equal_nan=True) == (key in without_effect), key


@pytest.mark.parametrize("law", LAWS)
def test_the_core_knows_the_keys_of_the_schema(law: str) -> None:
    known = numeric_keys(law)
    core = [key for key in _core.scenario_keys(law) if key.varies]
    fitted = [f"controller.{law}.auto.{key}" for key in ("bandwidth", "damping")]  # gains by the time the core has them
    assert [key for key in known if key not in fitted] == [key.name for key in core]
    for key in core:
        assert sorted(key.widths) == sorted(int(np.prod(shape)) for shape in known[key.name].shapes)


def test_one_row_holds_for_all_and_shapes_say_what_is_meant(smooth: hs.Scenario) -> None:
    gains = np.linspace(0.5e-6, 2e-6, 8)
    each = hs.simulate_batch(smooth, {"controller.hybrid.kp": gains})
    assert len(each) == 8
    one = hs.simulate_batch(smooth, {"controller.hybrid.kp": gains[None]})
    assert len(one) == 1
    assert_same(one, 0, hs.simulate(smooth.updated({"controller.hybrid.kp": gains.tolist()})))
    both = hs.simulate_batch(smooth, {"controller.hybrid.kp": gains[None], "uncertainty.depth": [0.1, -0.2, 0.3]})
    assert len(both) == 3
    assert_same(
        both, 2, hs.simulate(smooth.updated({"controller.hybrid.kp": gains.tolist(), "uncertainty.depth": 0.3}))
    )


def test_settling_band_and_dwell_time_vary_by_lane(paper: hs.Scenario) -> None:
    base = paper.updated({"simulation.duration": 0.5, "controller.switching.kind": "tanh"})
    band, dwell = [2.0, 2.0, 10.0, 10.0], [0.1, 0.3, 0.2, 0.45]
    batch = hs.simulate_batch(base, {"metrics.band": band, "metrics.dwell": dwell}, log="metrics")
    for index, (px, s) in enumerate(zip(band, dwell, strict=True)):
        single = hs.metrics(hs.simulate(base.updated({"metrics.band": px, "metrics.dwell": s})))
        assert batch.metrics["settling_time"][index] == pytest.approx(single["settling_time"], nan_ok=True)
        assert batch.metrics["overshoot"][index] == pytest.approx(single["overshoot"], rel=1e-9)
    assert np.isnan(batch.metrics["settling_time"]).tolist() == [False, True, False, True]


@pytest.mark.parametrize("law", ["hybrid", "composite"])
def test_neighbouring_seeds_beyond_2_to_the_53_give_different_runs(sampled: hs.Scenario, law: str) -> None:
    base = sampled.updated({"controller.law": law})
    seeds = [2**53, 2**53 + 1, 2**63, 2**63 + 1, 2**64 - 1, 0]
    for given in (seeds, np.array(seeds, dtype=np.uint64)):
        batch = hs.simulate_batch(base, {"seed": given})
        assert batch.variations["seed"].dtype == np.uint64
        assert batch.variations["seed"].tolist() == seeds
        assert len(set(batch.metrics["final_error"].tolist())) == len(seeds)
        for index, seed in enumerate(seeds):
            assert_same(batch, index, hs.simulate(base.updated({"seed": seed})), 1e-9)
    assert batch.to_xarray()["seed"].values.tolist() == seeds


def test_a_comparison_runs_every_scenario_with_its_own_seed(sampled: hs.Scenario) -> None:
    scenarios = [sampled.updated({"name": f"seed-{k}", "seed": 2**60 + k}) for k in range(3)]
    rows = hs.compare(scenarios, ["composite"]).rows
    for row, scenario in zip(rows, scenarios, strict=True):
        single = hs.metrics(hs.simulate(scenario.updated({"controller.law": "composite"})))
        assert row.metrics["final_error"] == pytest.approx(single["final_error"], rel=1e-9)
    assert len({row.metrics["final_error"] for row in rows}) == 3


def test_inertia_is_made_symmetric_as_a_scenario_does(smooth: hs.Scenario) -> None:
    matrix = np.diag([1.5e-4, 1.6e-4, 3e-4])
    matrix[0, 1] = 1e-6
    matrix[1, 0] = 1e-6 * (1 + 1e-10)
    batch = hs.simulate_batch(smooth, {"robot.inertia": matrix[None]})
    assert_same(batch, 0, hs.simulate(smooth.updated({"robot.inertia": matrix})))
    matrix[1, 0] = 2e-6
    with pytest.raises(
        ValueError, match=r"^scenario 0: robot.inertia: expected a symmetric matrix, got one that is not$"
    ):
        hs.simulate_batch(smooth, {"robot.inertia": matrix[None]})


# ---- Results --------------------------------------------------------------------------------------------------------


def test_results_do_not_depend_on_threads_number_or_order(paper: hs.Scenario) -> None:
    base = paper.updated({"simulation.duration": 0.1})
    depth = np.linspace(-0.5, 0.5, 21)
    kp = np.where(np.arange(21) % 5 == 2, 1.0, 1e-6)  # some diverge beside others
    reference = hs.simulate_batch(base, {"uncertainty.depth": depth, "controller.hybrid.kp": kp}, threads=1)
    assert set(reference.outcome) == {"completed", "diverged"}
    order = np.random.default_rng(1).permutation(21)
    for which in (np.arange(21), order, order[:5], order[:1]):
        for threads in (1, 2, 7):
            batch = hs.simulate_batch(
                base, {"uncertainty.depth": depth[which], "controller.hybrid.kp": kp[which]}, threads=threads
            )
            for name, values in (dict(batch.metrics) | dict(batch.samples)).items():
                expected = (dict(reference.metrics) | dict(reference.samples))[name][which]
                assert values.tobytes() == expected.tobytes(), name
            assert (batch.outcome == reference.outcome[which]).all()
            assert (batch.end_time == reference.end_time[which]).all()


def test_a_diverged_scenario_says_when_and_why(smooth: hs.Scenario) -> None:
    batch = hs.simulate_batch(smooth, {"controller.hybrid.kp": [1e-6, 1.0]})
    single = hs.simulate(smooth.updated({"controller.hybrid.kp": 1.0}))
    assert single.outcome == "diverged"
    assert batch.outcome.tolist() == ["completed", "diverged"]
    assert batch.detail(1) == single.detail
    assert batch.end_time[1] == single.end_time < batch.stop_time[1]
    assert batch.cause[0] == "none"
    assert batch.cause[1] in ("feature_error", "twist", "not_finite")
    with pytest.raises(IndexError):
        batch.detail(2)


def test_trajectories(smooth: hs.Scenario) -> None:
    base = smooth.updated({"simulation.log_every": 30})
    batch = hs.simulate_batch(base, {"controller.hybrid.kp": [1e-6, 1.0]}, log="trajectory")
    single = hs.simulate(base)
    assert batch.time is not None
    np.testing.assert_allclose(batch.time, single.time, rtol=1e-15)
    for name, values in batch.samples.items():
        expected = getattr(single, name)
        assert values[0].shape == expected.shape
        np.testing.assert_allclose(values[0], expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    ran = batch.time <= batch.end_time[1]
    assert 0 < ran.sum() < len(ran)
    assert (np.isfinite(batch.samples["position"][1]).all(axis=1) == ran).all()
    with pytest.raises(ValueError, match=r"^log: expected one time grid for all trajectories, got 100 steps"):
        hs.simulate_batch(base, {"simulation.step": [1e-3, 5e-4]}, log="trajectory")


def test_a_log_of_metrics_keeps_nothing_else(smooth: hs.Scenario) -> None:
    batch = hs.simulate_batch(smooth, {"uncertainty.depth": [0.1, 0.2]}, log="metrics")
    assert batch.samples == {}
    assert batch.time is None
    assert list(batch.metrics) == list(hs.METRICS)
    whole = hs.simulate_batch(smooth, {"uncertainty.depth": [0.1, 0.2]}, log="final")
    for name, values in batch.metrics.items():
        assert values.tobytes() == whole.metrics[name].tobytes()


@pytest.mark.parametrize("law", ["hybrid", "kelly"])
@pytest.mark.parametrize("mode", ["continuous", "sampled"])
def test_a_metric_is_the_same_whatever_else_is_asked_for(
    smooth: hs.Scenario, sampled: hs.Scenario, mode: str, law: str
) -> None:
    scenario = {"continuous": smooth, "sampled": sampled}[mode].updated({"controller.law": law})
    varied = {"robot.mass": scenario.robot.mass * np.array([1.0, 1.1, 1.2, 60.0])}  # the last one falls
    everything = hs.simulate_batch(scenario, varied)
    assert list(everything.metrics) == list(hs.METRICS)
    for asked in [*([name] for name in hs.METRICS), ["peak_leg_force", "final_error"], []]:
        some = hs.simulate_batch(scenario, varied, metrics=iter(asked))
        assert list(some.metrics) == [name for name in hs.METRICS if name in asked]
        for name, values in some.metrics.items():
            np.testing.assert_array_equal(values, everything.metrics[name], err_msg=name)
        np.testing.assert_array_equal(some.outcome, everything.outcome)
        np.testing.assert_array_equal(some.end_time, everything.end_time)
        for name, values in some.samples.items():  # legs are worked out elsewhere where no metric asks for them
            expected = everything.samples[name]
            atol = 1e-12 * np.abs(expected).max() if name.startswith("leg_") else 0.0
            np.testing.assert_allclose(values, expected, rtol=0, atol=atol, err_msg=name)
    assert "settling_time" not in hs.simulate_batch(scenario, varied, metrics=["effort"]).to_dataframe()


def test_without_a_metric_of_the_legs_a_run_passes_singular_poses() -> None:
    scenario = hs.load_scenario("paper-gravity")
    varied = {"uncertainty.gravity": [0.5]}
    looked = hs.simulate_batch(scenario, varied, "metrics", metrics=["peak_leg_force"])
    passed = hs.simulate_batch(scenario, varied, "metrics", metrics=["final_error"])
    assert looked.outcome.tolist() == ["singular"]
    assert passed.outcome.tolist() != ["singular"]
    assert passed.end_time[0] > looked.end_time[0]


def test_with_encoders_a_singular_pose_is_the_outcome_whatever_is_measured() -> None:
    """There the encoders give no pose either, and the pose is why."""
    changes = {"simulation.mode": "sampled", "sensors.pose": "encoders", "sensors.rate": "true"}
    scenario = hs.load_scenario("paper-gravity").updated(changes)
    varied = {"uncertainty.gravity": [0.5, 0.9]}
    for metrics in (["peak_leg_force"], ["final_error"]):
        batch = hs.simulate_batch(scenario, varied, "final", metrics=metrics)
        assert batch.outcome.tolist() == ["singular"] * 2, metrics


def test_leg_forces_do_not_depend_on_a_neighbours_actuators() -> None:
    """With noisy encoders, whose legs are not the platform's."""
    changes: dict[str, Any] = {
        "simulation": {"mode": "sampled", "duration": 0.1},
        "sensors": {"pose": "encoders", "noise": 1e-5},
    }
    scenario = hs.load_scenario("paper").updated(changes)
    alone = hs.simulate_batch(scenario, {"actuators.quantisation": [0.0, 0.0]}, "final")
    beside = hs.simulate_batch(scenario, {"actuators.quantisation": [0.0, 1e-3]}, "final")
    assert not np.array_equal(beside.samples["leg_forces"][0], beside.samples["leg_forces"][1])
    for name in alone.samples:
        np.testing.assert_array_equal(beside.samples[name][0], alone.samples[name][0], err_msg=name)
    for name in alone.metrics:
        np.testing.assert_array_equal(beside.metrics[name][0], alone.metrics[name][0], err_msg=name)


@pytest.mark.parametrize(
    ("key", "plain", "other", "camera"),
    [
        ("uncertainty.principal_point", [0.0, 0.0], [3.0, -2.0], {}),
        ("camera.focal_pixels", [580.0, 580.0], [582.0, 580.0], {"focal_length": None, "pixel_scale": None}),
    ],
)
def test_features_do_not_depend_on_a_neighbours_pixels(
    key: str, plain: list[float], other: list[float], camera: dict[str, Any]
) -> None:
    """A camera whose pixels are its features keeps them to the bit, beside one whose pixels are not."""
    changes = {"simulation": {"mode": "sampled", "duration": 0.1}, "camera": camera, key: plain}
    scenario = hs.load_scenario("paper").updated(changes)
    alone = hs.simulate_batch(scenario, {key: [plain, plain]}, "final")
    beside = hs.simulate_batch(scenario, {key: [plain, other]}, "final")
    assert not np.array_equal(beside.samples["feature_error"][0], beside.samples["feature_error"][1])
    for name in alone.samples:
        np.testing.assert_array_equal(beside.samples[name][0], alone.samples[name][0], err_msg=name)
    for name in alone.metrics:
        np.testing.assert_array_equal(beside.metrics[name][0], alone.metrics[name][0], err_msg=name)


@pytest.mark.parametrize("log", ["metrics", "final", "trajectory"])
def test_dataset(smooth: hs.Scenario, log: Log, tmp_path: Any) -> None:
    import xarray

    variations = {"uncertainty.depth": np.array([0.1, 0.2, 0.3]), "controller.hybrid.kp": np.full((1, 8), 1e-6)}
    batch = hs.simulate_batch(smooth, variations, log=log)
    batch.to_xarray().to_netcdf(tmp_path / "batch.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "batch.nc", engine="h5netcdf") as data:
        assert data.sizes["scenario"] == 3
        assert data["uncertainty.depth"].dims == ("scenario",)
        assert data["controller.hybrid.kp"].shape == (3, 8)
        assert data["outcome"].values.tolist() == ["completed"] * 3
        np.testing.assert_array_equal(data["metric_final_error"], batch.metrics["final_error"])
        assert data["metric_final_error"].attrs["units"] == "px"
        assert hs.Scenario.from_yaml(data.attrs["scenario"]) == smooth
        table = batch.to_dataframe()
        assert data.attrs["controller"] == table.attrs["controller"] == "hybrid"
        for name in ("cause", "limit_leg", "end_time", "stop_time"):
            np.testing.assert_array_equal(data[name], table[name])
            assert data[name].attrs.get("units") == table.attrs["units"].get(name)
        for name, values in batch.samples.items():
            np.testing.assert_array_equal(data[name], values)
            assert data[name].dims[0] == "scenario"
            assert (log == "trajectory" and name != "fuzzy_weights") == ("time" in data[name].dims)
            assert data[name].attrs["units"]


def test_what_varies_has_its_unit_in_tables_and_datasets() -> None:
    scenario = hs.load_scenario("composite-30hz").updated({"simulation.duration": 0.1})
    poses = np.tile(scenario.simulation.start.pose, (2, 1))
    variations = {"camera.noise": np.array([0.1, 0.2]), "simulation.start.pose": poses, "seed": np.array([1, 2])}
    batch = hs.simulate_batch(scenario, variations, log="metrics", metrics=[])
    units = batch.to_dataframe().attrs["units"]
    assert units.pop("camera.noise") == "px"
    assert [units.pop(f"simulation.start.pose[{entry}]") for entry in range(6)] == ["m"] * 3 + ["rad"] * 3
    assert units == {"end_time": "s", "stop_time": "s", "seed": "1"}
    data = batch.to_xarray()
    assert data["camera.noise"].attrs["units"] == "px"
    assert data["simulation.start.pose"].attrs["units"] == "m; rad"
    assert data["seed"].attrs["units"] == "1"


@pytest.mark.parametrize("log", ["final", "trajectory"])
def test_a_dataset_shares_no_memory_with_the_batch(smooth: hs.Scenario, log: Log) -> None:
    batch = hs.simulate_batch(smooth, {"uncertainty.depth": np.array([0.1, 0.2])}, log=log)
    dataset = batch.to_xarray()
    arrays = [*batch.variations.values(), *batch.metrics.values(), *batch.samples.values()]
    arrays += [batch.limit_leg, batch.end_time, batch.stop_time, *([] if batch.time is None else [batch.time])]
    for variable in dataset.variables.values():
        assert not any(np.shares_memory(variable.values, array) for array in arrays)


# ---- Refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variations", "message"),
    [
        ({}, r"^variations: expected at least one key, got none$"),
        ({"uncertainty.dept": [0.1]}, r'^uncertainty.dept: unknown key; did you mean "uncertainty.depth"\?$'),
        (
            {"camera": [0.1]},
            r"^camera: expected a numeric key, got a block; name a key below it, such as camera\.focal_length$",
        ),
        (
            {"controller.composite": [0.1]},
            r"expected a key of the scenario's law, hybrid, got a key of a different law$",
        ),
        ({"controller.hybrid.fuzzy": [0.1]}, r"such as controller\.hybrid\.fuzzy\.adaptation$"),
        (
            {"controller.law": ["hybrid", "composite"]},
            r"^controller.law: expected a numeric key.*; run one batch for each value, or hs.compare with the laws$",
        ),
        (
            {"camera.prediction": ["none"]},
            r"^camera.prediction: .*, got one that is not numeric .*; run one batch for each value$",
        ),
        (
            {"controller.hybrid.fuzzy.enabled": [True]},
            r"^controller.hybrid.fuzzy.enabled: expected a numeric key",
        ),
        ({3: [0.1]}, r"^3: unknown key; `hexservo schema` lists"),
        (
            {"controller.composite.kt": [6.0]},
            r"^controller.composite.kt: expected a key of the scenario's law, hybrid, got a key of a different law$",
        ),
        ({"controller.hybrid.fuzzy.leakage": [0.0, -1.0]}, r"^scenario 1: controller.hybrid.fuzzy.leakage: expected"),
        ({"controller.hybrid.fuzzy.weight_limit": [np.inf]}, r"^scenario 0: controller.hybrid.fuzzy.weight_limit: ex"),
        ({"uncertainty.depth": 0.1}, r"^uncertainty.depth: expected shape \(n,\) or \(n, 4\), n scenarios, got \(\)$"),
        ({"uncertainty.depth": []}, r"^uncertainty.depth: expected shape"),
        ({"uncertainty.depth": np.zeros((2, 5))}, r"^uncertainty.depth: expected shape .* got \(2, 5\)$"),
        (
            {"robot.inertia": np.ones(3)},
            r"^robot.inertia: expected shape \(n, 3\) or \(n, 3, 3\), n scen.* got \(3,\)$",
        ),
        (
            {"camera.focal_pixels": [905.5, [800.0, 903.0]]},
            r"^camera.focal_pixels: expected an array of numbers of shape \(n,\) or \(n, 2\), n scenarios, got entries "
            "that are no numbers, or of different lengths$",
        ),
        ({"uncertainty.depth": ["0.1"]}, r"^uncertainty.depth: expected an array of numbers of shape \(n,\).*, got"),
        ({"uncertainty.depth": [True]}, r"^uncertainty.depth: expected an array of numbers of shape \(n,\).*, got"),
        ({"uncertainty.depth": [np.array(True), 0.5]}, r"^uncertainty.depth: expected an array of numbers of shape"),
        ({"simulation.duration": [True, 0.5]}, r"^simulation.duration: expected an array of numbers of shape \(n,\)"),
        ({"seed": [True, 2]}, r"^seed: expected an array of numbers of shape \(n,\), n scenarios, got entries"),
        (
            {"controller.hybrid.kp": [[True] * 7 + [0.01]]},
            r"^controller.hybrid.kp: expected an array of numbers of shape",
        ),
        ({"uncertainty.depth": [np.ma.masked, 0.1]}, r"^uncertainty.depth: expected an array of numbers of shape"),
        (
            {"uncertainty.depth": [[0.1], [0.2, 0.3]]},
            r"^uncertainty.depth: expected an array of numbers of shape \(n,\).*, got",
        ),
        (
            {"uncertainty.depth": np.ma.masked_array([0.1, 0.9], mask=[False, True])},
            r"^scenario 1: uncertainty.depth: expected a number .*, got a masked value$",
        ),
        (
            {"controller.hybrid.kv": np.ma.masked_less(np.array([[2.0, 2.0, 2.0, 1.0, 2.0, 2.0]]), 2.0)},
            r"^scenario 0: controller.hybrid.kv\[3\]: expected a number .*, got a masked value$",
        ),
        ({"seed": np.ma.masked_array(3, mask=True)}, r"^seed: expected an integer .*, got a masked value$"),
        ({"uncertainty.depth": [0.1, np.nan]}, r"^scenario 1: uncertainty.depth: expected a number .*, got nan$"),
        ({"uncertainty.depth": [0.1, 0.2, -1.0]}, r"^scenario 2: uncertainty.depth: expected a number > -1 .* got -1$"),
        (
            {"uncertainty.gravity": np.full((2, 6), [0, 0, 0, 2, 0, 0])},
            r"^scenario 0: uncertainty.gravity\[3\]: expected",
        ),
        ({"simulation.log_every": [1, 2.5]}, r"^scenario 1: simulation.log_every: expected an integer .* got 2.5$"),
        (
            {"simulation.start.pose": [[0.0] * 6, [0.0] * 5 + [6.3]]},
            r"^scenario 1: simulation.start.pose: expected a rotation vector at most pi long .*, got one of 6.3 \(de",
        ),
        ({"seed": [0, -1]}, r"^scenario 1: seed: expected an integer from 0 to 18446744073709551615, got -1$"),
        ({"seed": [0, 2**64]}, r"^scenario 1: seed: expected an integer from 0 to .*615, got 18446744073709551616$"),
        ({"seed": [0, 0.5]}, r"^scenario 1: seed: expected an integer from 0 to .* got 0.5$"),
        (
            {"seed": [0.0, 2.0**53 + 2]},
            r"^scenario 1: seed: expected an integer .*, got the float 9007199254740994\.0, which may have been r",
        ),
        ({"simulation.step": [1e-3, 3e-4]}, r"^scenario 1: simulation.step: expected a step that divides"),
        ({"robot.mass": [0.1, 0.1, 0.1], "camera.focal_length": [0.008, 0.008]}, r"^camera.focal_length: .* got 2$"),
        ({"target.points": np.zeros((1, 4, 3))}, r"^scenario 0: target: expected either initial_features"),
        (
            {"robot.inertia": [[1e-4, 1e-4, 1e-4], [1e-4, 1e-4, 9e-4]]},
            r"^scenario 1: robot.inertia: expected principal",
        ),
        ({"robot.mass": np.full(3_000_000, 0.06)}, r"^log: expected a result of at most 2 GiB .*log \"metrics\""),
    ],
)
def test_bad_variations_are_refused_with_a_message(paper: hs.Scenario, variations: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hs.simulate_batch(paper, variations)


def test_the_limit_of_a_result_counts_all_that_it_has(paper: hs.Scenario) -> None:
    with pytest.raises(ValueError, match=r"^log: ") as error:
        hs.simulate_batch(paper, {"robot.mass": np.full(8_000_000, 0.06)}, log="metrics")
    counted = re.search(r"8000000 scenarios of (\d+) bytes", str(error.value))
    batch = hs.simulate_batch(paper.updated({"simulation.duration": 1.1}), {"robot.mass": [0.06] * 3}, log="metrics")
    held = [batch.outcome, batch.cause, batch.limit_leg, batch.end_time, batch.stop_time, *batch.metrics.values()]
    assert counted
    assert int(counted[1]) == sum(array.nbytes for array in held) / 3 + 2  # codes of outcome and cause, while it runs


def test_a_gain_without_effect_is_refused_in_every_row() -> None:
    scenario, key = hs.load_scenario("reachy-mini"), "controller.resolved_rate.ki"
    default = list(scenario.controller.gains.ki)
    hs.simulate_batch(scenario.updated({"simulation.duration": 1.1}), {key: [default, default]}, log="metrics")
    for rows, index in (([default, default, [7.0] * 6], 2), ([[7.0] * 6, default], 0)):
        with pytest.raises(hs.ScenarioError, match=rf"^scenario {index}: {key}: has no effect where"):
            hs.simulate_batch(scenario, {key: rows})


def test_bad_arguments_are_refused_with_a_message(paper: hs.Scenario) -> None:
    variations = {"uncertainty.depth": [0.1]}
    with pytest.raises(TypeError, match=r"^scenario: expected a Scenario .* got str$"):
        hs.simulate_batch("paper", variations)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^variations: expected a mapping"):
        hs.simulate_batch(paper, [("uncertainty.depth", [0.1])])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^log: expected one of final, metrics, trajectory, got 'all'$"):
        hs.simulate_batch(paper, variations, log="all")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^threads: expected an integer from 1 to 1024, got 0$"):
        hs.simulate_batch(paper, variations, threads=0)
    with pytest.raises(TypeError, match=r"^threads: expected an integer or None, got float$"):
        hs.simulate_batch(paper, variations, threads=2.0)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^progress: expected True, a function or None, got str$"):
        hs.simulate_batch(paper, variations, progress="yes")  # type: ignore[arg-type]
    message = r'^metrics: expected "all" or names of hs.METRICS, got "eforts"; did you mean "effort"\?$'
    with pytest.raises(ValueError, match=message):
        hs.simulate_batch(paper, variations, metrics=["eforts"])
    for wrong in ("effort", 3, [3]):
        with pytest.raises(TypeError, match=r'^metrics: expected "all" or names of hs.METRICS, got (str|int)$'):
            hs.simulate_batch(paper, variations, metrics=wrong)  # type: ignore[arg-type]


# ---- Progress, Ctrl-C, memory ---------------------------------------------------------------------------------------


def test_progress_is_reported_to_a_function(smooth: hs.Scenario) -> None:
    told: list[tuple[int, int]] = []
    hs.simulate_batch(smooth, {"uncertainty.depth": np.full(2000, 0.1)}, progress=lambda *at: told.append(at))
    assert told[-1] == (2000, 2000)
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    with pytest.raises(ZeroDivisionError):
        hs.simulate_batch(smooth, {"uncertainty.depth": [0.1]}, progress=lambda *_: 1 / 0)


def test_progress_may_be_a_bar_on_standard_error(smooth: hs.Scenario, capfd: pytest.CaptureFixture[str]) -> None:
    hs.simulate_batch(smooth, {"uncertainty.depth": np.full(500, 0.1)}, progress=True)
    out, err = capfd.readouterr()
    assert out == ""
    assert re.search(r"500 of 500 scenarios .* million steps/s", " ".join(err.split()))


def test_gains_that_are_fitted_run_by_run_have_a_bar(capfd: pytest.CaptureFixture[str]) -> None:
    scenario = hs.load_scenario("paper-composite").updated(
        {"controller.composite.auto.bandwidth": 2.0, "simulation.duration": 0.01}
    )
    mass = np.linspace(0.05, 0.07, 120)
    hs.simulate_batch(scenario, {"robot.mass": mass}, progress=True)
    err = " ".join(capfd.readouterr().err.split())
    assert re.search(r"120 of 120 scenarios have their gains .* 120 of 120 scenarios -", err)
    hs.simulate_batch(scenario, {"robot.mass": mass})
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("inside", [False, True], ids=["in the core", "in the progress callback"])
def test_ctrl_c_stops_at_once_and_keeps_what_is_finished(smooth: hs.Scenario, inside: bool) -> None:
    count = 4000
    pressed: list[float] = []
    timers: list[threading.Timer] = []

    def press() -> None:
        pressed.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    def report(done: int, total: int) -> None:
        if done >= 100 and inside and not pressed:
            press()
        elif done >= 100 and not inside and not timers:
            timers.append(threading.Timer(0.02, press))  # between two calls
            timers[0].start()

    scenario = smooth.updated({"simulation.duration": 5.0})
    batch = hs.simulate_batch(scenario, {"uncertainty.depth": np.full(count, 0.1)}, progress=report)
    elapsed = time.perf_counter() - pressed[0]
    assert elapsed < 0.2
    finished = batch.outcome == "completed"
    assert 100 <= finished.sum() < count
    assert set(batch.outcome[~finished]) == {"interrupted"}
    for values in (*batch.metrics.values(), batch.end_time):
        assert np.isnan(values[~finished]).all()
    assert np.isfinite(batch.metrics["final_error"][finished]).all()
    assert np.isnan(batch.samples["position"][~finished]).all()
    assert np.isfinite(batch.samples["fuzzy_weights"][finished]).all()
    assert batch.detail(int(np.argmin(finished))) == "interrupted before its end"


@pytest.mark.slow
def test_memory_of_a_million_scenarios() -> None:
    """200 000 scenarios of five steps with three varied keys; a million may take 1 GB with the interpreter."""
    program = """
import resource, numpy as np, hexservo as hs
paper = hs.load_scenario("paper").updated({"simulation.duration": 0.005})
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
def run(n):
    depth = np.linspace(-0.5, 0.5, n)
    batch = hs.simulate_batch(paper, {"uncertainty.depth": depth, "uncertainty.gravity": depth / 10,
                                      "controller.hybrid.kp": np.full(n, 1e-6)}, log="metrics")
    assert (batch.outcome == "completed").all()
run(1000)
before = peak()
run(200_000)
print(before, (peak() - before) / 200_000)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    before, each = map(float, run.stdout.split())
    assert before + 1e6 * each < 1e9, f"{before:.3g} bytes to begin with, {each:.0f} per scenario"


def test_the_detail_of_a_run_needs_its_index(paper: hs.Scenario) -> None:
    batch = hs.simulate_batch(paper.updated({"simulation.duration": 0.01}), {"uncertainty.gravity": [0.0]}, "metrics")
    assert batch.detail(0) == batch.detail(-1)
    with pytest.raises(IndexError):
        batch.detail(1)
    for index in (slice(0, 1), 1.0, "0"):
        with pytest.raises(TypeError, match=r"^index: expected an integer, got"):
            batch.detail(index)  # type: ignore[arg-type]
