"""`camera.gate`: points that are far from where the joint sensors expect them count as lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import notes, unlikely
from hexservo.findings.gate_width import moved_between_frames, noise_at_gate, rejected_share
from hexservo.scenario.motion import TargetMotion, displacements_of
from without_runs import unlikely_without_runs

OUTLIERS = {"camera.outlier_probability": 0.05, "camera.outlier_size": 40.0}
SEEDS = list(range(40))


@pytest.fixture(scope="module")
def machine() -> hs.Scenario:
    """Noise of 0.2 px, a depth that is wrong, encoders, latency and lost frames."""
    return hs.load_scenario("real-machine")


def metric(scenario: hs.Scenario, name: str) -> np.ndarray:
    found = hs.simulate_batch(scenario, {"seed": SEEDS}, log="metrics").metrics[name]
    return np.asarray(found)


def test_outliers_beyond_the_gate_do_no_harm(machine: hs.Scenario) -> None:
    """Without a gate most runs end unsettled. With one the RMS is that without outliers, but for the lost images:
    of four points 19 % of the frames lose one or more, for 33 ms each, as others lose them for the same time."""
    clean = metric(machine, "rms_error")
    harmed = metric(machine.updated(OUTLIERS), "settling_time")
    guarded = machine.updated({**OUTLIERS, "camera.gate": 2.0})
    rms, settling = metric(guarded, "rms_error"), metric(guarded, "settling_time")
    print(f"RMS {np.median(clean):.4f} px, guarded {np.median(rms):.4f} px; unsettled {np.isnan(harmed).sum()} of 40")
    assert np.isnan(harmed).sum() > 0.5 * len(SEEDS)
    assert not np.isnan(settling).any()
    assert np.median(rms) < 1.25 * np.median(clean)


def test_a_gate_that_no_image_reaches_costs_one_frame_at_the_start(machine: hs.Scenario) -> None:
    """The first image of a point is confirmed by the second one."""
    run, gated = (hs.simulate(machine.updated({"camera.gate": gate})) for gate in (None, 1e3))
    start, later = (
        int(np.flatnonzero(abs(each.feature_error - each.feature_error[0]).max(axis=1) > 1.0)[0])
        for each in (run, gated)
    )
    assert (later - start) * machine.simulation.step == pytest.approx(machine.camera.period, abs=0.01)


@pytest.mark.parametrize("policy", ["hold", "predict"])
def test_exchanged_points_do_not_reach_the_law(machine: hs.Scenario, policy: str) -> None:
    """One frame, then ten, that name two points wrongly: the tick is as it would be without them, to the noise."""
    scenario = machine.updated({"camera.gate": 5.0, "camera.timeout": 0.5, "camera.on_lost": policy})
    legs = hs.simulate(scenario.updated({"simulation.duration": 0.001})).leg_lengths[0]
    right = np.array(scenario.target.desired_features, dtype=float).ravel()
    wrong = right.copy()
    wrong[:4] = right[[2, 3, 0, 1]]
    depth = np.full(4, -0.5)

    def wrenches(gate: float | None, exchanged: range) -> np.ndarray:
        controller = hs.Controller(scenario.updated({"camera.gate": gate}))
        found = []
        for tick in range(1200):
            frame, is_new = divmod(tick, 33)
            features = None if is_new else wrong if frame in exchanged else right
            exposure = None if is_new else 1e-3 * tick
            out = controller.step(features=features, depth=depth, exposure=exposure, leg_lengths=legs, now=1e-3 * tick)
            found.append(out.wrench)
        assert out.status == "valid"
        return np.array(found[20 * 33 :])

    undisturbed = wrenches(5.0, range(0))
    for exchanged in (range(20, 21), range(20, 30), range(1)):
        np.testing.assert_allclose(wrenches(5.0, exchanged), undisturbed, rtol=0.0, atol=1e-3)
    assert abs(wrenches(None, range(20, 30)) - undisturbed).max() > 0.01


def test_diagnose_offers_a_gate_against_outliers(machine: hs.Scenario) -> None:
    found = hs.diagnose(hs.simulate(machine.updated({**OUTLIERS, "simulation.duration": 3.0})))
    first = found.causes[0]
    assert first.cause == "outliers"
    assert first.remedy is not None
    camera = machine.camera
    assert camera.period is not None
    timeout = pytest.approx(10 * camera.period + camera.latency + camera.latency_jitter)
    assert first.remedy.changes == {"camera.gate": 2.0, "camera.timeout": timeout}
    assert first.remedy.works


def test_a_gate_that_the_target_exceeds_is_warned_of_and_one_without_timeout_noted(machine: hs.Scenario) -> None:
    def of_gate(find: Callable[[hs.Scenario], list[str]], changes: dict[str, Any]) -> list[str]:
        found = find(machine.updated({"camera.gate": 2.0, "camera.timeout": 0.5, **changes}))
        return [sentence for sentence in found if sentence.startswith("camera.gate")]

    assert of_gate(unlikely_without_runs, {}) == of_gate(notes, {}) == []
    (note,) = of_gate(notes, {"camera.timeout": None})
    assert "never found again without camera.timeout" in note
    assert of_gate(unlikely_without_runs, {"camera.timeout": None}) == []  # its run settles
    motion = {"target.motion.kind": "velocity", "target.motion.velocity": [0.5, 0.0, 0.0]}
    (warning,) = of_gate(unlikely_without_runs, motion)
    assert "2 px is less than the" in warning
    assert of_gate(unlikely_without_runs, {**motion, "camera.gate": 100.0}) == []


def test_the_gate_acts_on_what_a_custom_controller_sees(machine: hs.Scenario) -> None:
    """So that its warning stands without the law."""
    motion = {"target.motion.kind": "velocity", "target.motion.velocity": [0.5, 0.0, 0.0]}
    lost = {}
    for gate in (2.0, 100.0):
        scenario = machine.updated({**motion, "camera.gate": gate, "camera.timeout": 0.5, "simulation.duration": 0.2})
        seen: list[Any] = []

        def hold(observed: hs.Observation, seen: list[Any] = seen) -> np.ndarray:
            seen.append(observed.features)
            return np.zeros(6)

        hs.simulate(scenario, controller=hold)
        warned = any(line.startswith("camera.gate: 2 px is less than") for line in unlikely(scenario, by_law=False))
        lost[gate] = np.isnan(seen[-1]).any(), warned
    assert lost == {2.0: (True, True), 100.0: (False, False)}


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ({"kind": "velocity", "velocity": [0.03, 0.0, 0.0]}, "1 px is less than the"),
        ({"kind": "velocity", "velocity": [0.0, 0.0, 0.03]}, ""),  # along the optical axis
        ({"kind": "sinusoid", "amplitude": [2e-4, 0.0, 0.0], "frequency": 120.0}, ""),  # twice the amplitude at most
        ({"kind": "sinusoid", "amplitude": [2e-3, 0.0, 0.0], "frequency": 120.0}, "1 px is less than the"),
    ],
)
def test_check_notes_a_target_that_moves_farther_than_the_gate(
    machine: hs.Scenario, motion: dict[str, object], words: str
) -> None:
    gated = machine.updated({"camera.gate": 1.0, "camera.timeout": 0.5, "target.motion": motion})
    notes = " ".join(note for note in unlikely_without_runs(gated) if "moves the image" in note)
    assert words in notes
    assert bool(words) == bool(notes)


@pytest.mark.parametrize(("gate", "noise"), [(0.5, 0.5), (1.0, 0.5)])
def test_a_gate_rejects_the_share_of_right_points_that_is_stated(
    machine: hs.Scenario, gate: float, noise: float
) -> None:
    """Of a platform that stands still: a point whose image stays the same from frame to frame was rejected."""
    camera = {"gate": gate, "noise": noise, "timeout": 6.0, "quantisation": 0.0, "dropout": 0.0, "latency_jitter": 0.0}
    scenario = machine.updated(
        {
            **{f"camera.{key}": value for key, value in camera.items()},
            "sensors.pose": True,
            "base_motion.kind": "none",
            "actuators.quantisation": 0.0,
            "actuators.hold": "wrench",
            "simulation.duration": 40.0,
        }
    )
    robot, weight = scenario.robot, np.array(scene_of(scenario).body.weight([1.0, 0.0, 0.0, 0.0]))
    inertia = np.array([robot.mass] * 3 + list(robot.inertia))
    seen: list[Any] = []

    def hold(observed: hs.Observation) -> np.ndarray:
        seen.append(observed.features)
        away = np.concatenate([observed.position - robot.home_position, 2.0 * observed.quaternion[1:]])
        return np.asarray(weight - inertia * (100.0 * away + 20.0 * observed.twist))

    assert hs.simulate(scenario, controller=hold).outcome == "completed"
    moved = np.abs(np.diff(np.array(seen)[8000::33], axis=0))[:, ::2]  # of each point along x, from frame to frame
    assert noise_at_gate(scenario) == noise
    parts = np.array([part.mean() for part in np.array_split(moved < 1e-5, 20)])
    error = parts.std(ddof=1) / np.sqrt(len(parts))
    print(f"rejected {parts.mean():.4f} +- {error:.4f}, stated {rejected_share(gate, noise):.4f}")
    assert error < 0.02
    assert parts.mean() == pytest.approx(rejected_share(gate, noise), abs=4.0 * error)


def test_check_notes_a_gate_narrower_than_the_noise(machine: hs.Scenario) -> None:
    """By the share of right points that it rejects; a gate as wide as it asks for rejects at most 1 in 1000."""

    def notes(**camera: float) -> list[str]:
        found = unlikely_without_runs(
            machine.updated({f"camera.{key}": value for key, value in {"timeout": 0.3, **camera}.items()})
        )
        return [sentence for sentence in found if sentence.startswith("camera.gate")]

    (note,) = notes(gate=0.5, noise=0.5, quantisation=0.0)
    assert "0.5 px rejects 78% of the right points" in note
    assert "take a gate of at least 2.7 px" in note
    assert notes(gate=2.7, noise=0.5, quantisation=0.0) == []
    assert rejected_share(2.7, 0.5) < 0.001
    (note,) = notes(gate=0.6, noise=0.0, quantisation=1.0)  # rounded alone: 1/sqrt(12)
    assert "rejects 34% of the right points, whose coordinates have 0.289 px of noise and rounding" in note
    (note,) = notes(gate=0.5, noise=0.5, quantisation=0.0, smoothing=0.01)
    assert "rejects 76%" in note
    assert notes(gate=0.5, noise=0.5, quantisation=0.0, smoothing=3.0) == []  # which leaves 0.037 px of it


def test_diagnose_names_a_gate_narrower_than_the_noise(machine: hs.Scenario) -> None:
    """With a wider one as the remedy, which still keeps out outliers."""
    narrow = machine.updated({"camera.gate": 1.0, "camera.timeout": 0.3, "camera.noise": 2.0})
    first = hs.diagnose(hs.simulate(narrow)).causes[0]
    assert (first.cause, first.named) == ("gate", True)
    assert any("rejects 94% of the right points" in sentence for sentence in first.evidence)
    assert first.remedy is not None
    assert first.remedy.changes == {"camera.gate": 11.0}
    assert first.remedy.works
    outliers = {"camera.outlier_probability": 0.05, "camera.outlier_size": 60.0}
    disturbed = machine.updated({"camera.gate": 0.5, "camera.timeout": 0.3, "camera.noise": 1.5, **outliers})
    first = hs.diagnose(hs.simulate(disturbed)).causes[0]
    assert (first.cause, first.named) == ("gate", True)
    assert first.remedy is not None
    assert first.remedy.changes == {"camera.gate": 7.9}
    assert first.remedy.works


@pytest.mark.parametrize("period", [0.02, 0.05, 0.1, 0.15, 0.19, 0.27])
def test_the_largest_motion_between_frames_is_that_of_the_recording_at_any_time(period: float) -> None:
    """Samples every 0.1 s are joined by straight lines: one frame or the other is at a sample. Frames on a grid."""
    samples = [[0, 0, 0], [0, 0, 0], [1e-3, 2e-4, 0], [7e-4, 0, 3e-4], [4e-4, -1e-4, 0], [0, 0, 0]]
    motion = TargetMotion.model_validate({"kind": "recorded", "samples": samples, "sample_period": 0.1})
    time = np.linspace(0.0, 0.7, 70001)
    every = np.linalg.norm(displacements_of(motion, time + period) - displacements_of(motion, time), axis=1)
    found = np.linalg.norm(moved_between_frames(motion, period), axis=1)
    assert found.max() == pytest.approx(every.max(), rel=1e-9)
