"""Sensors, actuators, leg limits and base motion of the sampled loop, from the scenario to the result."""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs

TICK = 1e-3  # [s]
CSV = "t, ax, ay, az\n0, 0, 0.1, -0.2\n0.05, 0.3, 0.1, 0.2\n0.1, -0.3, 0, 0\n"


@pytest.fixture(scope="module")
def nominal(paper: hs.Scenario) -> hs.Scenario:
    """A tenth of a second of the sampled loop, without errors."""
    return paper.updated(
        {
            "name": "devices",
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "gravity": 0.0, "depth": 0.0},
            "controller.switching.kind": "implicit",
            "simulation": {"mode": "sampled", "duration": 0.1},
        }
    )


def refusal(scenario: hs.Scenario, changes: dict[str, Any]) -> str:
    with pytest.raises(hs.ScenarioError) as caught:
        scenario.updated(changes)
    return str(caught.value)


# ---- Scenario -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("sensors.pose", "camera", 'sensors.pose: expected true or "encoders", got "camera"'),
        ("sensors.pose", False, 'sensors.pose: expected true or "encoders", got false'),
        ("sensors.rate", "difference", '"differences"'),
        ("sensors.period", 0.0, "sensors.period: expected a number > 0 or null, got 0"),
        ("sensors.period", 2.5e-3, "nearest: 0.002 or 0.003"),
        ("sensors.resolution", -1e-6, "sensors.resolution: expected a number >= 0"),
        ("actuators.hold", "force", 'expected one of "wrench", "leg_forces", got "force"'),
        ("actuators.bandwidth", -5, "actuators.bandwidth: expected a number > 0 or null, got -5"),
        ("actuators.delay", 9e-3, "actuators.delay: expected at most 8 servo periods"),
        ("actuators.delay", 1.4e-3, "nearest: 0.001 or 0.002"),
        ("robot.on_limit", "halt", 'robot.on_limit: expected one of "report", "stop", got "halt"'),
        ("base_motion.kind", "recorded", "base_motion.file: expected the path of a CSV file"),
        ("base_motion.samples", [[0, 0, 0], [1, 0, 0]], "base_motion.sample_period: expected it beside samples"),
        ("base_motion.file", 3, "base_motion.file: expected the path of a file, or null, got 3"),
        ("base_motion.phase", 90.0, "within +-2 pi (radians)"),
        ("base_motion", {"kind": "sinusoid", "frequency": 501.0}, "base_motion.frequency: expected a number from 0 to"),
        ("base_motion", {"kind": "noise", "low_frequency": 10.0}, "base_motion.low_frequency: expected"),
    ],
)
def test_what_is_refused(nominal: hs.Scenario, key: str, value: Any, sentence: str) -> None:
    assert sentence in refusal(nominal, {key: value})


def test_yaml_keeps_everything(nominal: hs.Scenario) -> None:
    changed = nominal.updated(
        {
            "robot.on_limit": "stop",
            "sensors": {"pose": "encoders", "rate": True, "resolution": 1e-6, "noise": 2e-6, "period": 2e-3},
            "actuators": {
                "hold": "leg_forces",
                "saturation": True,
                "bandwidth": 50,
                "quantisation": 1e-3,
                "delay": 1e-3,
            },
            "base_motion": {"kind": "noise", "level": [1e-3, 2e-3, 0], "low_frequency": 2, "high_frequency": 20},
        }
    )
    for scenario in (nominal, changed):
        assert hs.Scenario.from_yaml(scenario.to_yaml()) == scenario
        assert pickle.loads(pickle.dumps(scenario)) == scenario
    assert nominal.sensors.pose is True
    assert changed.sensors.rate is True
    assert nominal.updated({"sensors.pose": "true"}) == nominal


# ---- Recordings -----------------------------------------------------------------------------------------------------


def test_a_recording_becomes_part_of_the_scenario(nominal: hs.Scenario, tmp_path: Path) -> None:
    (tmp_path / "road.csv").write_text(CSV)
    file = tmp_path / "scenario.yaml"
    recorded = nominal.updated({"base_motion": {"kind": "recorded", "file": str(tmp_path / "road.csv")}})
    text = nominal.updated({"base_motion.kind": "none"}).to_yaml()
    head, block, rest = text.partition("base_motion:\n")
    # relative to the scenario's own file, wherever it is loaded from
    file.write_text(
        head + block + rest.replace("kind: none", "kind: recorded", 1).replace("file: null", "file: road.csv", 1)
    )
    loaded = hs.load_scenario(file)
    assert loaded == recorded
    assert loaded.base_motion.file is None
    assert loaded.base_motion.samples == ((0.0, 0.1, -0.2), (0.3, 0.1, 0.2), (-0.3, 0.0, 0.0))
    assert loaded.base_motion.sample_period == pytest.approx(0.05)
    (tmp_path / "road.csv").unlink()
    assert hs.Scenario.from_yaml(loaded.to_yaml()) == loaded
    result = hs.simulate(loaded.updated({"base_motion.sample_period": 0.04}))
    assert result.outcome == "completed"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("t,ax,ay\n0,0,0\n", "line 1: expected the names of the columns t, ax, ay, az, got 3 fields without az"),
        ("0,0,0,0\n1,0,0,0\n", "line 1: expected the names of the columns"),
        ("t,ax,ay,az\n0,0,0,0\n1,0,0\n", "line 3: expected 4 numbers, got 3"),
        ("t,ax,ay,az\n0,0,0,0\n\n1,0,zero,0\n", "line 4: ay: expected a finite number, got other text (4 characters)"),
        ("t,ax,ay,az\n0,0,0,0\n1,0,0_1,0\n", "line 3: ay: expected a finite number, got other text (3 characters)"),
        ("t,ax,ay,az\n0,0,0,0\n1,0,nan,0\n", "line 3: ay: expected a finite number, got other text (3 characters)"),
        ("t,ax,ay,az\n1,0,0,0\n2,0,0,0\n", "line 2: expected t = 0 for the first sample, got 1.0"),
        ("t,ax,ay,az\n0,0,0,0\n1,0,0,0\n1,0,0,0\n", "line 4: expected times that increase"),
        ("t,ax,ay,az\n0,0,0,0\n1.2,0,0,0\n2,0,0,0\n", "line 3: expected t = 1 (samples every 1 s"),
        ("t,ax,ay,az\n0,0,0,0\n", "line 3: expected at least 2 samples, got 1"),
        ("", "line 1: expected at least 2 samples, got 0"),
        ("t,ax,ay,az\n0,0,0," + "0" * 200_000, "line 2: expected numbers with commas between, got something else"),
        ("t,ax,ay,az\n" + "".join(f"{k},0,0,0\n" for k in range(10_001)), "expected at most 10000 samples, got more"),
    ],
)
def test_a_recording_that_is_wrong_is_refused_with_its_line(
    nominal: hs.Scenario, tmp_path: Path, text: str, sentence: str
) -> None:
    file = tmp_path / "road.csv"
    file.write_text(text)
    message = refusal(nominal, {"base_motion": {"kind": "recorded", "file": str(file)}})
    assert message.startswith(f"base_motion.file: {file}: ")
    assert sentence in message


def test_the_content_of_other_files_is_not_printed(nominal: hs.Scenario, tmp_path: Path) -> None:
    """A path in a scenario of another author must not print the content of the user's files."""
    file = tmp_path / "key"
    secrets = ("password,hunter2", "root:x:0:0", "a,b,c,d\n1,2,3,4", "t,ax,ay,az\n0,0,0,hunter2", "\xfftoken")
    for text in secrets:
        file.write_bytes(text.encode("latin-1"))
        message = refusal(nominal, {"base_motion": {"kind": "recorded", "file": str(file)}})
        for word in ("hunter2", "password", "x:0:0", "a, b", "0xff", "token"):
            assert word not in message


def test_a_recording_that_is_missing_is_refused(nominal: hs.Scenario, tmp_path: Path) -> None:
    message = refusal(nominal, {"base_motion.file": str(tmp_path / "none.csv")})
    assert "base_motion.file: " in message
    assert "cannot be read" in message


def test_columns_may_stand_in_any_order_with_comments(nominal: hs.Scenario, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(CSV)
    rows = [line.split(",") for line in CSV.splitlines()]
    turned = "\n".join(",".join(row[::-1]) for row in rows)
    (tmp_path / "b.csv").write_text("# measured\n" + turned + "\n\n")
    a, b = (nominal.updated({"base_motion.file": str(tmp_path / name)}) for name in ("a.csv", "b.csv"))
    assert a == b


# ---- Base motion ----------------------------------------------------------------------------------------------------


def test_a_soft_law_lets_the_platform_answer_the_base_alone(nominal: hs.Scenario) -> None:
    # With next to no gains the law only carries the weight: x-ddot = -A sin(2 pi f t), from rest.
    amplitude, frequency = np.array([0.4, -0.3, 0.2]), 4.0
    free = nominal.updated(
        {
            "controller.hybrid": {"kp": 1e-30, "kv": 0.0, "fuzzy": {"enabled": False}},
            "controller.switching.kind": "sign",
            "base_motion": {"kind": "sinusoid", "amplitude": amplitude.tolist(), "frequency": frequency},
        }
    )
    result = hs.simulate(free)
    omega = 2 * math.pi * frequency
    expected = np.outer(np.sin(omega * result.time) / omega**2 - result.time / omega, amplitude)
    # Simpson's rule: t^2/5760 A omega^4 h^4 = 1e-13
    np.testing.assert_allclose(result.position - result.position[0], expected, rtol=0, atol=1e-12)


def test_noise_of_the_base_is_a_matter_of_the_seed(nominal: hs.Scenario) -> None:
    shaken = nominal.updated({"base_motion": {"kind": "noise", "level": 0.01}})
    once, again = hs.simulate(shaken), hs.simulate(shaken)
    other = hs.simulate(shaken.updated({"seed": 1}))
    np.testing.assert_array_equal(once.position, again.position)
    assert np.abs(once.position - other.position).max() > 1e-7
    still = hs.simulate(nominal)
    assert np.abs(once.position - still.position).max() > 1e-7


# ---- Actuators ------------------------------------------------------------------------------------------------------


def test_saturation_is_never_exceeded(nominal: hs.Scenario) -> None:
    limited = nominal.updated({"robot.force_limit": 0.138, "actuators.saturation": True})
    forces = np.abs(hs.simulate(limited).leg_forces)
    assert forces.max() == 0.138
    unlimited = hs.simulate(limited.updated({"actuators.saturation": False}))
    assert np.abs(unlimited.leg_forces).max() > 0.14


def test_quantised_forces_are_multiples(nominal: hs.Scenario) -> None:
    result = hs.simulate(nominal.updated({"actuators.quantisation": 1e-3}))
    steps = result.leg_forces / 1e-3
    np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=1e-9)


def test_a_delay_of_one_tick_shifts_the_first_wrench_by_one(nominal: hs.Scenario) -> None:
    # Up to its first answer a platform at rest does not know of the delay.
    soon = hs.simulate(nominal)
    late = hs.simulate(nominal.updated({"actuators.delay": TICK}))
    np.testing.assert_allclose(late.leg_forces[1], soon.leg_forces[0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(late.wrench[0], [0, 0, -0.06 * 9.8, 0, 0, 0], rtol=0, atol=1e-15)
    assert np.abs(soon.wrench[0] - late.wrench[0]).max() > 1e-3


def test_bandwidth_is_a_first_order_lag(nominal: hs.Scenario) -> None:
    # A law of next to no gain asks for the weight; what it starts from is the weight: a constant. With a large step of
    # the image part the first forces follow 1 - exp.
    bandwidth = 20.0
    fast = hs.simulate(nominal)
    slow = hs.simulate(nominal.updated({"actuators.bandwidth": bandwidth}))
    rest = np.linalg.norm(slow.leg_forces[0] - fast.leg_forces[0])
    step = fast.leg_forces[0] - np.full(6, fast.leg_forces[0].mean())
    assert np.linalg.norm(step) > 0
    ticks = 2 * math.pi * bandwidth * TICK
    gone = 1 - (1 - math.exp(-ticks)) / ticks  # mean over the first tick of 1 - exp(-t/T)
    weight = hs.simulate(nominal.updated({"actuators.delay": TICK})).leg_forces[0]
    np.testing.assert_allclose(slow.leg_forces[0], weight + gone * (fast.leg_forces[0] - weight), rtol=0, atol=1e-14)
    assert rest > 0


def test_leg_limit_ends_a_run_with_its_leg_and_time(paper: hs.Scenario) -> None:
    sinking = paper.updated({"simulation.mode": "sampled", "uncertainty.gravity": -0.5, "robot.on_limit": "report"})
    reported = hs.simulate(sinking.updated({"simulation.duration": 1.0}))
    first = next(event for event in reported.events if event.kind == "stroke")
    stopped = hs.simulate(sinking.updated({"robot.on_limit": "stop"}))
    assert stopped.outcome == "leg_limit"
    assert stopped.detail == f"leg {first.leg} passed its stroke at t = {first.time:.12g} s"
    assert stopped.end_time == pytest.approx(first.time - TICK)
    travel = np.abs(stopped.leg_lengths - stopped.leg_lengths[0])
    assert 0.9 * 0.017 < travel.max() <= 0.017


def test_a_batch_names_leg_and_time(paper: hs.Scenario) -> None:
    sinking = paper.updated(
        {"simulation": {"mode": "sampled", "duration": 1.0}, "robot.on_limit": "stop", "uncertainty.gravity": -0.5}
    )
    single = hs.simulate(sinking)
    batch = hs.simulate_batch(sinking, {"uncertainty.gravity": np.array([-0.5, 0.0, -0.5])})
    assert batch.outcome.tolist() == ["leg_limit", "completed", "leg_limit"]
    assert batch.detail(0) == single.detail == batch.detail(2)
    assert batch.limit_leg[1] == 0
    assert f"leg {batch.limit_leg[0]} " in single.detail


# ---- Encoders and sources of noise ----------------------------------------------------------------------------------


def test_ideal_encoders_with_true_rates_change_nothing(nominal: hs.Scenario) -> None:
    truth = hs.simulate(nominal)
    seen = hs.simulate(nominal.updated({"sensors": {"pose": "encoders", "rate": True}}))
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=1e-11)


def test_encoders_with_differences_still_settle(paper: hs.Scenario) -> None:
    scenario = paper.updated(
        {
            "controller.law": "composite",
            "controller.switching.kind": "implicit",
            "simulation": {"mode": "sampled", "duration": 2.0},
            "sensors": {"pose": "encoders", "resolution": 1e-7},
        }
    )
    result = hs.simulate(scenario)
    assert result.outcome == "completed"
    assert hs.metrics(result)["settling_time"] < 1.0


def test_forward_kinematics_follows_a_platform_that_runs_away_between_readings() -> None:
    """Readings 50 ms apart make this loop unstable: it moves by 0.2 m and 45 degrees from one to the next.

    The pose of each reading is that of the plant to rounding, until the target is behind the camera.
    """
    scenario = hs.load_scenario("textbook-general").updated(
        {"simulation.mode": "sampled", "sensors": {"pose": "encoders", "period": 0.05, "rate": True}}
    )
    result = hs.simulate(scenario)
    assert result.outcome == "behind_camera"
    assert result.end_time > 4 * 0.05

    seen: list[hs.Observation] = []
    replay = iter(result.wrench)

    def repeated(observation: hs.Observation) -> Any:
        seen.append(observation)
        return next(replay)

    again = hs.simulate(scenario, controller=repeated)
    assert again.outcome == result.outcome
    every = round(0.05 / scenario.simulation.step)
    readings = range(0, len(seen), every)
    moved = [np.linalg.norm(seen[k].position - seen[k - every].position) for k in readings[1:]]
    assert max(moved) > 0.1, "the test is only as hard as the motion between two readings"
    for k in readings:
        np.testing.assert_allclose(seen[k].position, again.position[k], rtol=0, atol=1e-9)
        turn = abs(seen[k].quaternion @ again.quaternion[k])
        assert turn == pytest.approx(1.0, abs=1e-12)


def test_encoder_noise_leaves_the_pixel_noise_alone(nominal: hs.Scenario) -> None:
    # The first frame: no state differs yet, so what the law does on it shows its noise alone.
    noisy = nominal.updated({"camera.noise": 0.5, "controller.switching.kind": "tanh"})
    both = noisy.updated({"sensors": {"pose": "encoders", "noise": 1e-12}})
    a, b = hs.simulate(noisy), hs.simulate(both)
    np.testing.assert_allclose(a.wrench[0], b.wrench[0], rtol=1e-6)
    assert np.abs(a.wrench[0] - hs.simulate(noisy.updated({"seed": 5})).wrench[0]).max() > 1e-6


def test_keys_of_devices_vary_in_batches(nominal: hs.Scenario) -> None:
    base = nominal.updated(
        {
            "controller.switching": {"kind": "tanh", "width": 1e-2},
            "sensors.pose": "encoders",
            "actuators.hold": "leg_forces",
            "base_motion.kind": "sinusoid",
            "simulation.duration": 0.05,
        }
    )
    variations = {
        "actuators.bandwidth": np.array([20.0, 50.0, 1e4]),
        "actuators.delay": np.array([0.0, 1e-3, 1e-3]),
        "sensors.noise": np.array([0.0, 1e-7, 1e-6]),
        "base_motion.amplitude": np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.2, 0.1]]),
        "seed": np.array([1.0, 2.0, 3.0]),
    }
    batch = hs.simulate_batch(base, variations)
    for i in range(3):
        single = hs.simulate(
            base.updated(
                {key: (int(values[i]) if key == "seed" else values[i].tolist()) for key, values in variations.items()}
            )
        )
        np.testing.assert_allclose(batch.samples["position"][i], single.position[-1], rtol=0, atol=1e-11)


def test_a_feature_that_leaves_the_image_is_held_or_predicted_or_ends_the_run(paper: hs.Scenario) -> None:
    """The goal lies outside of this image: point 2 starts at y = -65 px and shall go to -73, beyond half of 135."""
    narrow = paper.updated(
        {"simulation.mode": "sampled", "controller.switching.kind": "implicit", "camera.image_size": [135, 135]}
    )
    stopped = hs.simulate(narrow.updated({"camera.on_lost": "stop"}))
    assert stopped.outcome == "feature_lost"
    assert stopped.detail.startswith("a frame did not show every target point at t = 0.0")
    assert np.abs(stopped.features).max() <= 67.5  # the last good sample is one with all points
    batch = hs.simulate_batch(narrow.updated({"camera.on_lost": "stop"}), {"uncertainty.depth": [0.3, 0.3]})
    assert list(batch.outcome) == ["feature_lost"] * 2
    assert batch.detail(0) == stopped.detail
    held = hs.simulate(narrow.updated({"camera.on_lost": "hold"}))
    assert held.outcome == "completed"
    assert np.isnan(hs.metrics(held)["settling_time"])  # a feature that stays where it was last pulls for ever
    predicted, whole = (
        hs.metrics(hs.simulate(scenario))
        for scenario in (narrow.updated({"camera.on_lost": "predict"}), narrow.updated({"camera.image_size": None}))
    )
    assert predicted["settling_time"] == pytest.approx(whole["settling_time"], rel=0.03)
    assert predicted["final_error"] == pytest.approx(whole["final_error"], abs=0.02)


@pytest.mark.parametrize(
    "name",
    [
        name
        for name in hs.scenario_names()
        if hs.load_scenario(name).simulation.mode == "sampled"
        and hs.load_scenario(name).actuators.kind == "force"
        and name != "fails-saturation"  # whose legs cannot carry the platform
    ],
)
def test_without_an_image_every_packaged_machine_that_takes_forces_stays_where_it_starts(name: str) -> None:
    """The brake holds it against errors of its weight and the steps of its encoders, on a road too."""
    short = {"simulation.duration": 0.5, "simulation.log_every": 1, "metrics.rms_start": 0.0, "metrics.dwell": 0.1}
    scenario = hs.load_scenario(name).updated({"camera.dropout": 1.0, **short})
    run = hs.simulate(scenario)
    assert run.outcome == "completed", run.detail
    turns = Rotation.from_quat(np.roll(run.quaternion, -1, axis=1))
    assert np.abs(run.position - run.position[0]).max() < 1e-3
    assert (turns * turns[0].inv()).magnitude().max() < 5e-3


def test_a_timeout_has_room_for_stamps_that_are_early() -> None:
    """Age counts from the stamp: with less the brake would act in each period before the next frame."""
    early = {"uncertainty.latency": 0.010, "simulation.duration": 0.5}
    scenario = hs.load_scenario("composite-30hz").updated(early)
    with pytest.raises(ValueError, match=r"latency_jitter together, and uncertainty\.latency, 0\.076 s, got 0\.066"):
        hs.simulate(scenario.updated({"camera.timeout": 0.066}))
    late = {"uncertainty.latency": -0.010, "camera.timeout": 0.066}
    for changes in ({"camera.timeout": 0.076}, late):
        run = hs.simulate(scenario.updated(changes))
        acts = run.time >= 0.034  # from the first frame on
        assert np.all(np.any(run.fuzzy_output[acts] != 0.0, axis=1))
