"""Points that the camera does not see: outside of its image, or in a plane that it sees from behind."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli.commands import app
from hexservo.cli.output import write_results
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check import unlikely
from hexservo.run.summary import summary_sentences
from hexservo.run.unseen_points import edge_on_time, unseen_points, unseen_sentence
from hexservo.scenario.plane import side_of_plane, triangle_of_plane
from without_runs import unlikely_without_runs

SAMPLED = {"simulation.mode": "sampled", "camera.image_size": [640.0, 360.0], "controller.switching.kind": "implicit"}
CAMERA_AT_TAG = [0.0, 0.0, -0.5]  # from the camera of home to the tag [m]


@pytest.fixture(scope="module")
def half_turn() -> hs.Scenario:
    """A wide image turned by 180 degrees: the corners are 250 px from its centre, and its upper border 180 px."""
    corners = [-221.0, 116.0, 221.0, 116.0, 221.0, -116.0, -221.0, -116.0]
    target = {"target.initial_features": corners, "target.desired_features": [-each for each in corners]}
    changes = {**SAMPLED, **target, "controller.law": "pbvs"}
    return hs.load_scenario("textbook-half-turn").updated(changes)


def held(scenario: hs.Scenario) -> hs.Result:
    """Run with a controller that holds the platform where it is, in 0.06 kg of mass."""
    weight = np.array(scene_of(scenario).body.weight([1.0, 0.0, 0.0, 0.0]))
    robot = scenario.robot
    inertia = np.array([robot.mass] * 3 + list(robot.inertia))

    def hold(observed: hs.Observation) -> np.ndarray:
        away = np.concatenate([observed.position - robot.home_position, 2.0 * observed.quaternion[1:]])
        return np.asarray(weight - inertia * (100.0 * away + 20.0 * observed.twist))

    return hs.simulate(scenario, controller=hold)


def test_the_first_time_is_that_at_which_a_lost_feature_ends_the_run(half_turn: hs.Scenario) -> None:
    """The core ends a run with `on_lost: stop` at the frame that does not show a point, here of every tick."""
    goes_on, stopped = (hs.simulate(half_turn.updated({"camera.on_lost": lost})) for lost in ("hold", "stop"))
    assert stopped.outcome == "feature_lost"
    first = min(point.first for point in unseen_points(goes_on))
    assert first == pytest.approx(stopped.stop_time, abs=1.5 * half_turn.simulation.step)


@pytest.mark.parametrize("log_every", [1, 20])
def test_a_point_of_a_swinging_target_is_outside_for_the_share_of_a_sinusoid(log_every: int) -> None:
    """Before a platform that stands still x = A sin(wt) is beyond b for T arccos(b/A)/pi of a period, from T/4 less
    half of that on."""
    still = hs.load_scenario("real-machine").updated(
        {
            **{f"camera.{key}": 0.0 for key in ("noise", "quantisation", "dropout", "latency_jitter")},
            "uncertainty.gravity": 0.0,
            "base_motion.kind": "none",
            "actuators.quantisation": 0.0,
            "actuators.hold": "wrench",
            "sensors.pose": True,
            "simulation.duration": 4.0,
            "simulation.log_every": log_every,
        }
    )
    pixels = hs.project(still, np.zeros(6)).reshape(-1, 2)
    right, period = int(pixels[:, 0].argmax()), 2.0
    by_metre = float(scene_of(still).view(scene_of(still).home).jacobian[2 * right, 0])  # of the camera, not the target
    amplitude, border = 40.0, 20.0  # [px]
    size = [2.0 * float(pixels[right, 0] + border), 2.0 * float(np.abs(pixels[:, 1]).max() + border)]
    moving = still.updated(
        {
            "camera.image_size": size,
            "target.motion.kind": "sinusoid",
            "target.motion.amplitude": [-amplitude / by_metre, 0.0, 0.0],
            "target.motion.frequency": 1.0 / period,
        }
    )
    run = held(moving)
    (found,) = (one for one in unseen_points(run) if one.point == right + 1)
    lasts = period * np.arccos(border / amplitude) / np.pi
    swings = moving.simulation.duration / period
    assert found.first == pytest.approx(period / 4.0 - lasts / 2.0, abs=1e-3 * log_every + 1e-3)
    assert found.total == pytest.approx(swings * lasts, abs=2.0 * swings * 1e-3 * log_every)


def test_outputs_of_a_run_state_the_points_that_leave_the_image(half_turn: hs.Scenario, tmp_path: Path) -> None:
    run = hs.simulate(half_turn)
    assert np.isfinite(hs.metrics(run)["settling_time"])  # so that nothing else states it
    found = unseen_points(run)
    assert {one.point for one in found} == {1, 2, 3, 4}
    (sentence,) = (words for words in summary_sentences(run) if words.startswith("Outside of the image"))
    assert "(camera.on_lost: hold)" in sentence
    assert any(words.startswith("Outside of the image") for words in hs.diagnose(run).warnings)
    content = json.loads((write_results(run, tmp_path / "out") / "metrics.json").read_text(encoding="utf-8"))
    assert content["points_outside_image"] == [
        {"point": one.point, "first": {"value": one.first, "unit": "s"}, "total": {"value": one.total, "unit": "s"}}
        for one in found
    ]
    (tmp_path / "turn.yaml").write_text(half_turn.to_yaml(), encoding="utf-8")
    shown = CliRunner().invoke(app, ["run", str(tmp_path / "turn.yaml")]).output
    assert "Outside of the image" in shown
    wide = hs.simulate(half_turn.updated({"camera.image_size": [700.0, 700.0]}))
    assert unseen_points(wide) == ()
    assert not any("outside" in words.lower() for words in summary_sentences(wide))


def test_a_thin_log_states_what_it_may_not_have(half_turn: hs.Scenario) -> None:
    """All points are outside for some 60 ms: samples of 20 ms have them, of 0.5 s none; a metric has every step."""

    def sentence(log_every: int) -> str:
        run = hs.simulate(half_turn.updated({"simulation.log_every": log_every}))
        return " ".join(words for words in summary_sentences(run) if "outside of the image" in words.lower())

    assert "may" not in sentence(1)
    assert "what is shorter may be missing" in sentence(20)
    assert sentence(500).startswith("A point may have been outside of the image between samples: it was up to ")


def test_check_notes_points_that_leave_the_image_on_the_straight_way(half_turn: hs.Scenario) -> None:
    """The same ones as a run with a law that takes it; laws of the image keep their points inside it."""

    def notes(changes: dict[str, Any]) -> list[str]:
        return [note for note in unlikely_without_runs(half_turn.updated(changes)) if "on the straight way" in note]

    (note,) = notes({})
    assert "which pbvs takes, points 1, 2, 3, 4 leave the image of 640 x 360 px between 10% and 90% of it" in note
    assert not any("on the straight way" in words for words in unlikely(half_turn, by_law=False))  # a custom controller
    assert notes({"camera.image_size": [700.0, 700.0]}) == []
    assert notes({"controller.law": "kelly"}) == []
    assert unseen_points(hs.simulate(half_turn.updated({"controller.law": "kelly"}))) == ()


def test_check_notes_points_that_go_behind_the_camera_on_the_straight_way() -> None:
    """From the far side of points that are in no plane, looking back at them, the camera passes beside some."""
    scenario = hs.load_scenario("textbook-tilt")
    corners = np.array([[0.1, 0.1, 0.05], [-0.1, 0.1, -0.05], [-0.1, -0.1, 0.05], [0.1, -0.1, -0.05]])
    points = corners + np.array(scenario.robot.home_position) + CAMERA_AT_TAG
    aims = {**SAMPLED, "controller.law": "pbvs", "target.initial_features": None, "target.depth": None}
    goal = {"target.desired_features": None, "target.desired_pose": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]}
    laid = scenario.updated({**aims, **goal, "target.points": points.tolist()})
    beyond = laid.updated({"simulation.start.pose": [0.0, 0.0, -1.0, 3.1, 0.0, 0.0]})
    (note,) = (note for note in unlikely_without_runs(beyond) if "on the straight way" in note)
    assert "points 1, 2, 3, 4 leave the image of 640 x 360 px or go behind the camera" in note
    near = laid.updated({"simulation.start.pose": [0.02, 0.0, 0.0, 0.0, 0.0, 0.0]})
    assert not any("on the straight way" in note for note in unlikely_without_runs(near))


# ---- A plane of points ----------------------------------------------------------------------------------------------


def of_tag(start: list[float] | None = None) -> dict[str, Any]:
    """A tag 0.5 m before the camera of home, with the start of the run if there is one."""
    home = hs.load_scenario("textbook-tilt").robot.home_position
    changes: dict[str, Any] = {
        "target.points": None,
        "target.initial_features": None,
        "target.depth": None,
        "target.tag": {"size": 0.1, "pose": [*(np.array(home) + CAMERA_AT_TAG).tolist(), 0.0, 0.0, 0.0]},
        "target.desired_features": None,
        "target.desired_pose": [0.0, 0.0, 0.05, 0.0, 0.0, 0.0],
    }
    return changes if start is None else {**changes, "simulation.start.pose": start}


BEHIND = [0.6, 0.0, -0.6, 0.0, 1.7, 0.0]


def test_the_side_of_a_plane_is_that_of_its_normal() -> None:
    """Seen from random places around a plane of five points, by the sign of n (c - p)."""
    random = np.random.default_rng(3)
    plane = Rotation.from_rotvec(random.normal(size=3)).as_matrix()
    points = np.column_stack([random.uniform(-0.1, 0.1, (5, 2)), np.zeros(5)]) @ plane.T
    triangle = triangle_of_plane(points)
    assert triangle is not None
    first, second, third = points[list(triangle)]
    normal = np.cross(second - first, third - first)
    for _ in range(50):
        place = random.normal(size=3)
        looks, _ = Rotation.align_vectors([-place], [[0.0, 0.0, -1.0]])  # along -z of the camera, as in the paper
        seen = (points - place) @ looks.as_matrix()
        assert (seen[:, 2] < 0.0).all()
        features = (-seen[:, :2] / seen[:, 2:]).ravel()
        assert side_of_plane(features, triangle) == np.sign(normal @ (place - first))
    assert triangle_of_plane(points + random.normal(size=(5, 3))) is None
    assert triangle_of_plane(np.outer(np.arange(4.0), [1.0, 2.0, 3.0])) is None


@pytest.mark.parametrize("kind", ["tag", "grid"])
def test_a_start_behind_a_tag_or_a_grid_is_refused(kind: str) -> None:
    changes = of_tag(BEHIND)
    if kind == "grid":
        grid = {"rows": 2, "columns": 2, "spacing": 0.1, "pose": changes["target.tag"]["pose"]}
        changes = {**changes, "target.tag": None, "target.grid": grid}
    with pytest.raises(ValueError, match=rf"target\.{kind}\.pose: .* before the camera at simulation\.start\.pose"):
        hs.load_scenario("textbook-tilt").updated(changes)
    changes["simulation.start.pose"] = [0.1, 0.0, 0.1, 0.0, 0.2, 0.0]
    hs.load_scenario("textbook-tilt").updated(changes)


@pytest.mark.parametrize(("turn", "seen"), [(-0.9, True), (0.9, False)])
def test_a_tag_on_a_platform_that_turns_it_to_a_camera_on_the_base_is_seen(turn: float, seen: bool) -> None:
    """Tilted by 0.9 rad at home, and turned back or on, to 1.8 rad, with its back to the camera."""
    watched = hs.load_scenario("eye-to-hand")
    way = np.array(watched.camera.mount.position) - watched.robot.home_position
    across = np.cross(way, [0.0, 0.0, 1.0]) if np.hypot(*way[:2]) > 1e-9 else np.array([1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    facing = Rotation.align_vectors([way, across], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])[0]
    on_platform = Rotation.from_rotvec(watched.robot.home_attitude).inv() * Rotation.from_rotvec(0.9 * across) * facing
    tag = {"size": 0.05, "pose": [0.0, 0.0, 0.0, *on_platform.as_rotvec()]}
    others = dict.fromkeys(("initial_features", "depth", "points", "desired_features"))
    target = {**others, "tag": tag, "desired_pose": [0.0] * 6}
    changes = {"target": target, "simulation.start.pose": [0.0, 0.0, 0.0, *(turn * across)]}
    if seen:
        watched.updated(changes)
    else:
        with pytest.raises(ValueError, match=r"the camera at simulation\.start\.pose, got one with its back to it"):
            watched.updated(changes)


def test_a_point_is_outside_from_each_sample_until_the_next(half_turn: hs.Scenario) -> None:
    """At the first three of five samples, 0.1 s apart: for 0.3 s; from the last one on nothing is known."""
    run = hs.simulate(half_turn.updated({"simulation.duration": 0.4, "simulation.log_every": 100}))
    errors = np.zeros_like(run.feature_error)
    desired = np.array(half_turn.target.desired_features)
    for rows, total in ((slice(0, 3), 0.3), (slice(4, 5), 0.0)):
        errors[:] = 0.0
        errors[rows, 0] = desired[0] - 400.0
        (found,) = unseen_points(replace(run, feature_error=errors.copy()))
        assert found.point == 1
        assert found.first == pytest.approx(0.1 * rows.start)
        assert found.total == pytest.approx(total)


@pytest.mark.parametrize(("farthest", "may"), [(299.0, False), (301.0, True)])
def test_a_thin_log_is_complete_where_every_step_was_near(half_turn: hs.Scenario, farthest: float, may: bool) -> None:
    """Of samples at 250 px and an image that ends from 300 px on, by the metric that has every step."""
    run = hs.simulate(half_turn.updated({"simulation.log_every": 500, "camera.image_size": [600.0, 600.0]}))
    peaks = {**run.streamed_metrics, "peak_feature_distance": farthest}
    assert (unseen_sentence(replace(run, streamed_metrics=peaks)) is not None) == may


def test_a_plane_of_points_that_is_passed_is_noted() -> None:
    """A start that is given later, when the tag has become points: by check, and by the run when it passes."""
    front = hs.load_scenario("textbook-tilt").updated(of_tag())
    behind = front.updated({"simulation.start.pose": BEHIND})

    def noted(scenario: hs.Scenario) -> bool:
        return any("different sides of the plane" in note for note in unlikely_without_runs(scenario))

    assert noted(behind)
    assert not noted(front)
    run = hs.simulate(behind)
    time = edge_on_time(run)
    height = run.position[:, 2] - (front.robot.home_position[2] + CAMERA_AT_TAG[2])  # of the camera over the tag
    assert height[0] < 0.0 < height[-1]
    assert time == run.time[(height > 0.0).argmax()]
    assert any(words.startswith(f"By t = {time:.4g} s the camera has passed") for words in summary_sentences(run))
    assert edge_on_time(hs.simulate(front)) is None
