"""Plant and loop as systems of python-control: eigenvalues of the analysis, responses of the core."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.findings.analysis.linear_law import rest_of
from hexservo.findings.analysis.loop_of_scenario import NotApplicableError, clock_of, loop_at_rest, quiet, with_features
from hexservo.findings.analysis.scene import scene_of

control = pytest.importorskip("control", reason="python-control is not installed (extra `control`)")

SAMPLED = ("composite-30hz", "slow-camera")
SETTLED = {"simulation.mode": "sampled", "base_motion.kind": "none"}


def law(name: str) -> hs.Scenario:
    return hs.load_scenario("paper-nominal").updated({"controller.law": name})


@pytest.mark.parametrize("name", SAMPLED)
def test_the_loop_has_the_eigenvalues_of_the_analysis(name: str) -> None:
    scenario = hs.load_scenario(name)
    at_rest, loop = loop_at_rest(scenario), hs.bridges.control(scenario)
    smooth = at_rest.scenario.controller.switching.kind in ("tanh", "saturation")
    expected = at_rest.smooth if smooth and at_rest.smooth is not None else at_rest.free
    multipliers = expected.multipliers(clock_of(at_rest.scenario))
    found = loop.poles()
    resting = expected.resting.shape[1]
    assert loop.dt == expected.seconds(clock_of(at_rest.scenario))
    # a law that predicts has the target's displacement beside each frame: it begins again with every one
    frames = 1 + clock_of(at_rest.scenario).latency // clock_of(at_rest.scenario).period
    assert len(found) == len(multipliers) + resting + 6 * frames
    assert np.sum(np.abs(found) < 1e-3) >= 6 * frames
    # those that stay belong to 1; all others are the analysis', but for the order and rounding
    kept = np.delete(found, np.argsort(np.abs(found - 1.0))[:resting])
    for value in multipliers[np.abs(multipliers) > 0.2]:
        assert np.abs(kept - value).min() < 1e-9
    assert max(abs(kept)) == pytest.approx(abs(multipliers[0]), abs=1e-12)


@pytest.mark.parametrize("name", ["kelly", "computed_torque", "pbvs", "composite"])
def test_the_continuous_loop_is_the_limit_of_short_ticks(name: str) -> None:
    """The logarithm of the sampled loop's multipliers over the tick differs in proportion to the tick.

    A double pole, which laws of critical damping have, splits by its root.
    """
    differences = []
    for tick in (1e-4, 5e-5):
        scenario = law(name).updated({"simulation.step": tick})
        continuous = np.sort_complex(hs.bridges.control(scenario).poles())
        sampled = hs.bridges.control(scenario, sampled=True).poles()
        slow = continuous[np.abs(continuous) < 300.0]
        rates = np.log(sampled[np.abs(sampled) > 1e-3]) / tick
        differences.append(max(np.abs(rates - pole).min() / max(1.0, abs(pole)) for pole in slow))
    assert differences[0] < 2 * 300.0 * 1e-4  # poles up to 300/s, ticks of 0.1 ms
    assert 1.3 < differences[0] / differences[1] < 2.3 or differences[1] < 1e-6, differences


def test_small_disturbances_move_a_loop_with_an_implicit_switching_term_less() -> None:
    """docs/bridges.md: the linear response, with K_v = 0, is that to disturbances well above K_v."""
    frequency, amplitude, periods = 1.0, 0.02, 4  # [Hz], [m/s^2] along z
    quiet = {**SETTLED, "camera.noise": 0.0, "sensors.noise": 0.0, "uncertainty.gravity": 0.0}
    still = hs.load_scenario("composite-30hz").updated({**quiet, "simulation.duration": 2.0 * periods / frequency})
    shaken = still.updated(
        {
            "base_motion.kind": "sinusoid",
            "base_motion.amplitude": [0.0, 0.0, amplitude],
            "base_motion.frequency": frequency,
        }
    )
    runs = [hs.simulate(each) for each in (still, shaken)]
    late = (runs[0].time >= periods / frequency) & (runs[0].time < 2.0 * periods / frequency)
    turning = np.exp(-2j * np.pi * frequency * runs[0].time[late])
    moved = (runs[1].position[late, 2] - runs[0].position[late, 2]) * turning
    loop = hs.bridges.control(still)
    gain = loop(np.exp(2j * np.pi * frequency * loop.dt))[loop.output_labels.index("pose_z"), 8]
    assert abs(2.0 * moved.mean()) / (amplitude * abs(gain)) == pytest.approx(0.16, abs=0.02)


@pytest.mark.parametrize("name", SAMPLED)
def test_the_plant_under_constant_inputs_is_exact(name: str) -> None:
    scenario = hs.load_scenario(name)
    continuous, sampled = (hs.bridges.control(scenario, "plant", sampled=kind) for kind in (False, True))
    assert (continuous.dt, sampled.dt) == (0, scenario.simulation.step)
    expected = control.c2d(continuous, scenario.simulation.step, "zoh")
    np.testing.assert_allclose(sampled.A, expected.A, rtol=0, atol=1e-15)
    np.testing.assert_allclose(sampled.B, expected.B, rtol=1e-9, atol=1e-14 * np.abs(expected.B).max())


def test_signals_have_names() -> None:
    plant = hs.bridges.control(hs.load_scenario("paper-nominal"), "plant")
    assert plant.input_labels[:2] == ["wrench_fx", "wrench_fy"]
    assert plant.input_labels[6:9] == [f"base_acceleration_{axis}" for axis in "xyz"]
    assert plant.input_labels[9:] == [f"target_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")]
    assert plant.output_labels == [f"feature_{i}{a}" for i in range(1, 5) for a in "xy"] + [
        f"pose_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")
    ]
    assert plant.state_labels[0] == "x_x"


def test_an_accelerating_base_moves_the_platform_backwards() -> None:
    plant = hs.bridges.control(hs.load_scenario("paper"), "plant")
    acceleration = plant.B[6:9, 6:9]
    np.testing.assert_allclose(acceleration, -np.eye(3), rtol=0, atol=1e-12)
    np.testing.assert_allclose(plant.B[9:, 6:9], 0.0, rtol=0, atol=1e-12)


def test_the_loop_responds_to_the_base_as_a_run_does() -> None:
    """A slow acceleration of the base, small enough for the linear loop: the gain of the core's run."""
    amplitude, frequency, tick = 1e-3, 2.0, 1e-3
    quiet = law("computed_torque").updated(
        {
            **SETTLED,
            "simulation.step": tick,
            "simulation.duration": 6.0,
            "camera.period": tick,
        }
    )
    image = hs.simulate(quiet).feature_error[-1]
    scenario = quiet.updated(
        {
            "base_motion.kind": "sinusoid",
            "base_motion.amplitude": [amplitude, 0.0, 0.0],
            "base_motion.frequency": frequency,
        }
    )
    run = hs.simulate(scenario)
    late = run.time >= 4.0
    turning = np.exp(-2j * np.pi * frequency * run.time[late])
    found = 2.0 * ((run.feature_error[late] - image) * turning[:, None])[:-1].mean(axis=0)
    loop = hs.bridges.control(quiet)
    response = loop(np.exp(2j * np.pi * frequency * tick))[:8, 6] * amplitude
    # error is goal minus image, and a sinusoid begins as a sine: its phasor is -j
    np.testing.assert_allclose(found, 1j * response, rtol=0, atol=0.03 * np.abs(response).max())


@pytest.mark.parametrize("prediction", ["none", "encoder"])
@pytest.mark.parametrize(
    ("law", "sensors"),
    [("computed_torque", {}), ("pbvs", {"sensors.pose": "encoders", "sensors.period": 0.003})],
)
def test_the_loop_responds_to_the_target_as_a_run_does(law: str, sensors: dict[str, Any], prediction: str) -> None:
    """A sinusoid in all three directions, with latency; a pattern begins with the exposure."""
    amplitude, frequency = np.array([2e-4, -1e-4, 1.5e-4]), 1.0
    quiet = {**SETTLED, **sensors, "camera.noise": 0.0, "uncertainty.gravity": 0.0, "camera.prediction": prediction}
    still = hs.load_scenario("composite-30hz").updated(
        {**quiet, "controller.law": law, "simulation.duration": 8.0, "simulation.log_every": 1}
    )
    motion = {"kind": "sinusoid", "amplitude": amplitude.tolist(), "frequency": frequency}
    runs = [hs.simulate(each) for each in (still, still.updated({"target.motion": motion}))]
    loop = hs.bridges.control(still)
    every = round(loop.dt / still.simulation.step)
    late = np.arange(len(runs[0].time))[::every]
    late = late[(runs[0].time[late] >= 4.0) & (runs[0].time[late] < 8.0 - 1e-9)]
    turning = np.exp(-2j * np.pi * frequency * runs[0].time[late])[:, None]
    features = runs[0].feature_error[late] - runs[1].feature_error[late]
    moved = np.hstack([features, (runs[1].position - runs[0].position)[late]])
    found = 2j * (moved * turning).mean(axis=0)  # a sinusoid begins as a sine: its phasor is -j
    expected = (loop(np.exp(2j * np.pi * frequency * loop.dt))[:, 9:12] @ amplitude)[: len(found)]
    # the mean over samples that do not divide the period leaves a percent
    for part in (slice(0, 8), slice(8, 11)):
        np.testing.assert_allclose(found[part], expected[part], rtol=0, atol=0.01 * np.abs(expected[part]).max())


@pytest.mark.parametrize("name", ["slow-camera", "eye-to-hand"])
def test_a_displaced_target_displaces_the_features(name: str) -> None:
    """As a rigid body about the platform's origin at rest, by the image of the displaced points."""
    scenario = with_features(hs.load_scenario(name))
    plant, scene = hs.bridges.control(scenario, "plant"), scene_of(scenario)
    rest = rest_of(quiet(scenario), scene).view.pose
    on_platform = scenario.camera.mount.on == "base"
    points = rest.carried(scene.points) if on_platform else scene.points
    move = 1e-6 * np.array([1.0, -2.0, 0.5, 3.0, -1.0, 2.0])
    turn = Rotation.from_rotvec(move[3:])
    displaced = turn.apply(points - rest.position) + rest.position + move[:3]
    if on_platform:
        frame = Rotation.from_quat(np.roll(rest.quaternion, -1))
        displaced = frame.inv().apply(displaced - rest.position)
    one, other = (
        _core.take_image(scene.camera, rest.position, rest.quaternion, at)[0] for at in (scene.points, displaced)
    )
    expected = plant.D[:-6, 9:] @ move
    np.testing.assert_allclose(other - one, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["computed_torque", "composite"])  # the latter with fuzzy systems that learn
def test_a_continuous_loop_follows_its_target_as_short_ticks_do(name: str) -> None:
    for prediction in ("none", "encoder"):
        scenario = law(name).updated({"simulation.step": 1e-4})
        if prediction == "encoder":
            scenario = scenario.updated({"simulation.mode": "sampled", "camera.prediction": prediction})
        s = 2j * np.pi * 1.0
        continuous = hs.bridges.control(scenario, sampled=False)(s)[:, 9:]
        sampled = hs.bridges.control(scenario, sampled=True)(np.exp(s * 1e-4))[:, 9:]
        np.testing.assert_allclose(continuous, sampled, rtol=0, atol=1e-3 * np.abs(sampled).max())


@pytest.mark.parametrize("of", ["plant", "loop"])
@pytest.mark.parametrize("law", ["tracking", "pbvs"])
def test_a_machine_that_takes_positions_has_no_plant_that_a_wrench_drives(of: str, law: str) -> None:
    scenario = hs.load_scenario("pi-h824-positions").updated({"controller.law": law})
    with pytest.raises(NotApplicableError, match=r"the legs of this one follow positions \(actuators.kind\)"):
        hs.bridges.control(scenario, of)  # type: ignore[arg-type]


def test_refusals(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="of: expected loop or plant"):
        hs.bridges.control(law("kelly"), "machine")  # type: ignore[arg-type]
    for sampled in ("no", "False", 0.01, 0):
        with pytest.raises(TypeError, match=r"^sampled: expected True, False or None, got (str|float|int)$"):
            hs.bridges.control(law("kelly"), "plant", sampled=sampled)  # type: ignore[arg-type]
    assert hs.bridges.control(law("kelly"), "plant", sampled=np.bool_(False)).dt == 0  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="sampled: expected True"):
        hs.bridges.control(hs.load_scenario("composite-30hz"), sampled=False)
    with pytest.raises(ValueError, match="Coulomb damping only"):
        hs.bridges.control(hs.load_scenario("paper"))
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ImportError, match=r"pip install 'hexservo\[control\]'"):
        hs.bridges.control(law("kelly"))
