"""Targets of 3 to 16 points: each law in runs, batches and ticks, weights, pose estimate, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexservo as hs
from hexservo import _core
from hexservo.scenario.laws import LAWS
from hexservo.scenario.parameters import core_parameters
from points import GOAL, scattered, with_points

NUMBERS = (3, 4, 5, 8, 16)


def run_of(paper: hs.Scenario, law: str, count: int, *, sampled: bool, **changes: Any) -> hs.Scenario:
    mode = {"simulation.mode": "sampled", "camera.period": 0.002, "camera.latency": 0.001} if sampled else {}
    return with_points(
        paper,
        scattered(count),
        **{"controller.law": law, "simulation.duration": 0.06, "metrics.rms_start": 0.0, **mode, **changes},
    )


def laws_for(count: int) -> list[str]:
    return [law for law in LAWS if count > 3 or law != "pbvs"]


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("count", NUMBERS)
def test_each_law_agrees_in_runs_batches_and_ticks(paper: hs.Scenario, count: int, sampled: bool) -> None:
    for law in laws_for(count):
        scenario = run_of(paper, law, count, sampled=sampled)
        run = hs.simulate(scenario)
        assert run.outcome == "completed"
        assert run.feature_error.shape == (len(run.time), 2 * count)
        assert run.depth.shape == (len(run.time), count)
        batch = hs.simulate_batch(scenario, {"uncertainty.depth": [0.3, 0.3, -0.1]}, "trajectory", threads=1)
        for name in ("feature_error", "depth", "position", "twist", "wrench"):
            alone = getattr(run, name)
            np.testing.assert_allclose(batch.samples[name][0], alone, rtol=1e-7, atol=1e-9 * np.abs(alone).max())
        assert np.array_equal(batch.samples["wrench"][0], batch.samples["wrench"][1])
        assert not np.allclose(batch.samples["wrench"][0], batch.samples["wrench"][2], atol=1e-12) or law == "pbvs"
        controller = hs.Controller(scenario)
        if not sampled:
            k = 0  # the weights have not moved yet
            out = controller.step(run.features[k], 1.3 * run.depth[k], run.position[k], run.quaternion[k], run.twist[k])
            assert not out.invalid_input
            np.testing.assert_allclose(out.wrench, run.wrench[k], rtol=1e-9, atol=1e-11)
            continue
        ticks = _core.recorded_ticks(core_parameters(scenario))
        assert ticks["features"].shape[1] == 2 * count
        for k in range(len(ticks["now"])):
            frame = np.isfinite(ticks["exposure"][k, 0])
            out = controller.step(
                ticks["features"][k] if frame else None,
                ticks["depth"][k] if frame else None,
                ticks["position"][k],
                ticks["quaternion"][k],
                ticks["twist"][k],
                exposure=ticks["exposure"][k, 0] if frame else None,
                now=ticks["now"][k, 0],
            )
            assert np.array_equal(out.wrench, ticks["wrench"][k])


@pytest.mark.parametrize("count", [5, 8, 16])
@pytest.mark.parametrize("law", LAWS)
def test_each_law_settles(paper: hs.Scenario, law: str, count: int) -> None:
    auto = {f"controller.{law}.{key}": None for key in ("kp",) if law in ("hybrid", "kelly")}
    scenario = with_points(
        paper,
        scattered(count),
        **{
            "controller.law": law,
            f"controller.{law}.auto": {"bandwidth": 2.0},
            "uncertainty.inertia": 0.0,
            "uncertainty.coriolis": 0.0,
            "uncertainty.depth": 0.0,
            "simulation.duration": 8.0,
            "simulation.step": 0.001,
            **auto,
        },
    )
    run = hs.simulate(scenario)
    assert run.outcome == "completed"
    start, end = np.abs(run.feature_error[[0, -1]]).max(axis=1)
    assert end < (0.2 * start if law in ("hybrid", "kelly") else 2.0)  # image springs are slow in some directions
    errors = run.feature_error[run.time >= scenario.metrics.rms_start]
    assert hs.metrics(run)["rms_error"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_a_point_that_does_not_count_is_none_and_two_halves_are_one(paper: hs.Scenario, law: str) -> None:
    four = scattered(4)
    changes = {"controller.law": law, "simulation.duration": 0.2}
    alone = hs.simulate(with_points(paper, four, **changes))
    idle = with_points(paper, [*four, [0.03, -0.01, -0.6]], **changes, **{"target.weights": [1, 1, 1, 1, 0]})
    halves = with_points(paper, np.vstack([four + 3e-9, four - 3e-9]), **changes, **{"target.weights": 0.5})
    moved = np.abs(alone.position - alone.position[0]).max()
    for scenario, share in ((idle, 1e-6), (halves, 1e-4)):
        run = hs.simulate(scenario)
        np.testing.assert_allclose(run.position, alone.position, rtol=0, atol=share * moved)
        np.testing.assert_allclose(run.feature_error[:, :8], alone.feature_error, rtol=0, atol=1e-3)


@pytest.mark.parametrize("changes", [{}, {"camera.on_lost": "stop"}, {"camera.prediction": "encoder"}])
def test_a_controller_does_not_wait_for_a_point_that_does_not_count(
    paper: hs.Scenario, changes: dict[str, Any]
) -> None:
    mode = {"simulation.mode": "sampled", "simulation.duration": 0.06, "metrics.rms_start": 0.0}
    weights = {"target.weights": [1, 1, 1, 1, 0]}
    scenario = with_points(paper, [*scattered(4), [0.03, -0.01, -0.6]], **mode, **weights, **changes)
    run = hs.simulate(scenario)
    seen, wrenches = run.features[0], []
    for features in (seen, np.where(np.arange(10) < 8, seen, np.nan)):
        out = hs.Controller(scenario).step(features, run.depth[0], run.position[0], run.quaternion[0], run.twist[0])
        assert out.status == "valid"
        wrenches.append(out.wrench)
    np.testing.assert_array_equal(wrenches[0], wrenches[1])
    without = np.where(np.arange(10) // 2 == 1, np.nan, seen)
    assert (
        hs.Controller(scenario)
        .step(without, run.depth[0], run.position[0], run.quaternion[0], run.twist[0])
        .invalid_input
    )


@pytest.mark.parametrize("law", LAWS)
def test_weights_permuted_with_their_points_permute_the_result(paper: hs.Scenario, law: str) -> None:
    points, weights, order = scattered(6), np.array([0.2, 1.0, 3.0, 0.0, 0.7, 1.4]), np.array([3, 0, 5, 1, 4, 2])
    changes = {"controller.law": law, "simulation.duration": 0.1}
    run = hs.simulate(with_points(paper, points, **changes, **{"target.weights": weights.tolist()}))
    turned = hs.simulate(with_points(paper, points[order], **changes, **{"target.weights": weights[order].tolist()}))
    moved = np.abs(run.position - run.position[0]).max()
    np.testing.assert_allclose(turned.position, run.position, rtol=0, atol=1e-7 * moved)
    np.testing.assert_allclose(turned.depth, run.depth[:, order], rtol=1e-9)


@pytest.mark.parametrize("count", [5, 8, 16])
def test_the_pose_is_that_of_opencv(paper: hs.Scenario, count: int) -> None:
    """The spring of `pbvs` is the displacement from its pose to the goal; `solvePnP` finds the same camera."""
    cv2 = pytest.importorskip("cv2")
    points = scattered(count)
    exact = {"controller.pbvs.prior": 0.0, "uncertainty.depth": 0.0}
    scenario = with_points(paper, points, **{"controller.law": "pbvs"}, **exact)
    settings = core_parameters(scenario)
    probe = _core.Probe(settings)
    home, upright = np.array(settings.robot.home_position), np.array([1.0, 0.0, 0.0, 0.0])
    focal = settings.camera.focal_pixels
    matrix, flip = np.diag([focal, focal, 1.0]), np.diag([1.0, -1.0, -1.0])  # OpenCV's camera looks along +z, y down
    ends = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-15)
    random = np.random.default_rng(3)
    for _ in range(5):
        shift, half = random.uniform(-0.004, 0.004, 3), random.uniform(-0.02, 0.02, 3)
        quaternion = np.array([np.sqrt(1 - half @ half), *half])
        features, depth = probe.image((home + shift)[None], quaternion[None])
        noisy = features + random.normal(0.0, 0.3, features.shape)
        law = probe.law(noisy, depth, home[None], upright[None], np.zeros((1, 6)), None)
        image = noisy.reshape(-1, 2) * [1.0, -1.0]
        start = cv2.Rodrigues(flip)[0], -flip @ home[:, None]
        turn, place = cv2.solvePnPRefineLM(points, image, matrix, None, *start, ends)
        into_camera = cv2.Rodrigues(turn)[0]
        position = -into_camera.T @ place.ravel()
        rotation = Rotation.from_matrix(into_camera.T @ flip)
        own_position, own_rotation = taken_for(probe, law, scenario)
        assert np.abs(own_position - position).max() < 1e-5  # [m]: OpenCV ends its rounds early; noise moves it by 1e-3
        assert (own_rotation.inv() * rotation).magnitude() < 3e-5
        own, other = (
            float(((noisy - probe.image(place[None], np.roll(turn.as_quat(), 1)[None])[0]) ** 2).sum())
            for place, turn in ((own_position, own_rotation), (position, rotation))
        )
        assert own <= other * (1 + 1e-9)


def taken_for(probe: Any, law: Any, scenario: hs.Scenario) -> tuple[Any, Rotation]:
    """Undo K_p (goal - estimate): the pose that the law took the image for."""
    displacement = law.parts["pose_spring"][0] / np.asarray(scenario.controller.pbvs.kp, dtype=float)
    position, quaternion = probe.goal_minima()
    goal = Rotation.from_quat(np.roll(quaternion[0], -1))
    return position[0] - displacement[:3], Rotation.from_rotvec(displacement[3:]).inv() * goal


def test_a_grid_is_its_points_row_by_row(paper: hs.Scenario) -> None:
    pose = [0.01, -0.02, -0.6, 0.1, 0.05, 0.3]
    grid = {"rows": 2, "columns": 4, "spacing": 0.03, "pose": pose}
    scenario = paper.updated(
        {
            "target.initial_features": None,
            "target.depth": None,
            "target.grid": grid,
            "target.desired_features": None,
            "target.desired_pose": GOAL,
        }
    )
    points = np.array(scenario.target.points)
    assert points.shape == (8, 3)
    assert scenario.target.grid is None
    np.testing.assert_allclose(points.mean(axis=0), pose[:3], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(np.diff(points.reshape(2, 4, 3), axis=1), axis=2), 0.03, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(np.diff(points.reshape(2, 4, 3), axis=0), axis=2), 0.03, rtol=1e-12)
    across, down = points[1] - points[0], points[4] - points[0]
    normal = np.cross(down, across)  # toward the viewer, who sees x to the right and rows going down
    camera = np.array(paper.robot.home_position)
    assert normal @ (camera - points.mean(axis=0)) > 0
    assert hs.Scenario.from_yaml(scenario.to_yaml()) == scenario


REFUSED = {
    "two points": ({"target.points": scattered(5)[:2].tolist()}, "target.points"),
    "17 points": ({"target.points": scattered(17).tolist()}, "target.points"),
    "points on a line": ({"target.points": [[0.01 * i, 0.02 * i, -0.6] for i in range(5)]}, "target.points"),
    "two at one place": ({"target.points": scattered(5)[[0, 1, 2, 3, 0]].tolist()}, "target.points"),
    "features of other points": (
        {"target.desired_features": [1.0] * 8, "target.desired_pose": None},
        "desired_features",
    ),
    "odd features": ({"target.desired_features": [1.0] * 9, "target.desired_pose": None}, "desired_features"),
    "depth errors of four": ({"uncertainty.depth": [0.1, 0.2, 0.1, 0.1]}, "uncertainty.depth"),
    "equal depth errors of four": ({"uncertainty.depth": [0.1, 0.1, 0.1, 0.1]}, "uncertainty.depth"),
    "gains of four": ({"controller.hybrid.kp": [1e-6] * 8}, "controller.hybrid.kp"),
    "a weight below 0": ({"target.weights": [1, 1, 1, 1, -0.1]}, "target.weights"),
    "a weight that is no number": ({"target.weights": [1, 1, 1, 1, float("nan")]}, "target.weights"),
    "weights of four": ({"target.weights": [1, 2, 1, 1]}, "target.weights"),
    "weights of 0": ({"target.weights": 0.0}, "target.weights"),
    "two points that count": ({"target.weights": [1, 1, 0, 0, 0]}, "target.weights"),
    "three points for a pose": (
        {"controller.law": "pbvs", "target.weights": [1, 1, 1, 0, 0]},
        "target.weights",
    ),
}


@pytest.mark.parametrize(("change", "key"), REFUSED.values(), ids=REFUSED.keys())
def test_what_fits_no_target_is_refused_with_its_key(paper: hs.Scenario, change: dict[str, Any], key: str) -> None:
    with pytest.raises(hs.ScenarioError, match=key) as problem:
        with_points(paper, scattered(5), **change)
    assert "expected" in str(problem.value)
    assert "got" in str(problem.value)


def test_weights_vary_in_a_batch(paper: hs.Scenario) -> None:
    scenario = run_of(paper, "kelly", 4, sampled=False)
    rows = np.array([[1.0, 1.0, 1.0, 1.0], [2.0, 0.5, 1.0, 0.0]])
    batch = hs.simulate_batch(scenario, {"target.weights": rows}, threads=1)
    for index, weights in enumerate(rows):
        run = hs.simulate(scenario.updated({"target.weights": weights.tolist()}))
        np.testing.assert_allclose(batch.samples["position"][index], run.position[-1], rtol=1e-9)
    alone = hs.simulate_batch(scenario, {"target.weights": rows[:1]}, threads=1)
    for name in batch.metrics:
        np.testing.assert_array_equal(batch.metrics[name][0], alone.metrics[name][0], err_msg=name)
    weighted = scenario.updated({"target.weights": rows[1].tolist()})
    replaced = hs.simulate_batch(weighted, {"target.weights": rows[:1]}, threads=1)
    for name in batch.metrics:
        np.testing.assert_array_equal(replaced.metrics[name], alone.metrics[name], err_msg=name)
    with pytest.raises(ValueError, match=r"target.weights: expected shape \(n,\) or \(n, 4\)"):
        hs.simulate_batch(scenario, {"target.weights": np.ones((2, 5))})


def test_tables_and_files_have_a_column_for_each_point(paper: hs.Scenario, tmp_path: Any) -> None:
    run = hs.simulate(run_of(paper, "hybrid", 5, sampled=False))
    table = run.to_dataframe()
    assert [name for name in table.columns if name.startswith("depth")] == [f"depth_{i}" for i in range(1, 6)]
    run.save(tmp_path / "run.nc")
    loaded = hs.load_result(tmp_path / "run.nc")
    assert np.array_equal(loaded.feature_error, run.feature_error)
    assert run.to_xarray()["feature_error"].shape == (len(run.time), 10)
