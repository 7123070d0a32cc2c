"""How far a run ends from the pose with the goal image."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import hexservo as hs
from hexservo.cli.commands import app
from hexservo.run.goal_distance import goal_distance
from hexservo.run.summary import goal_distance_sentence, summary_sentences
from test_coupled_noise import small_tag

ASKED = [0.02, 0.0, 0.0, 0.0, 0.1, 0.0]  # [m; rad]
SHORT = {"simulation.duration": 0.02}


def tag_at(asked: list[float], **changes: Any) -> hs.Result:
    still = {"camera.noise": 0.0, "robot.stroke": 0.03, "target.desired_pose": asked}
    return hs.simulate(small_tag({**still, **{key.replace("__", "."): value for key, value in changes.items()}}))


def test_the_distance_is_from_the_pose_that_was_asked_for() -> None:
    """The scenario keeps its image alone: its pose is found again, and the rest is SciPy's rotation."""
    result = tag_at(ASKED)
    found = goal_distance(result)
    assert found is not None
    shift = result.position[-1] - result.scenario.robot.home_position - np.array(ASKED[:3])
    turn = Rotation.from_quat(result.quaternion[-1], scalar_first=True) * Rotation.from_rotvec(ASKED[3:]).inv()
    assert found.shift == pytest.approx(np.linalg.norm(shift), rel=1e-6)
    assert found.angle == pytest.approx(turn.magnitude(), rel=1e-6)
    assert found.shift > 1e-3


def test_of_two_poses_with_the_goal_image_the_nearer_by_depths_and_radians_is_meant(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """0.1 m at a depth of 0.5 m is as far as 0.2 rad, and farther than 0.15 rad."""
    result = hs.simulate(hs.load_scenario("paper").updated(SHORT))
    depth = float(np.abs(result.depth[-1]).mean())
    assert depth == pytest.approx(0.5, rel=0.02)
    here = Rotation.from_quat(result.quaternion[-1], scalar_first=True)
    position = result.position[-1] + np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    attitude = [here, Rotation.from_rotvec([0.15, 0.0, 0.0]) * here]
    quaternion = np.stack([one.as_quat(scalar_first=True) for one in attitude])
    images = np.tile(result.scenario.target.desired_features, (2, 1))
    minima = SimpleNamespace(goal_minima=lambda: (position, quaternion), image=lambda *_: (images, None))
    monkeypatch.setattr("hexservo.run.goal_distance.probe", lambda _: minima)
    found = goal_distance(result)
    assert found is not None
    assert found.shift == 0.0
    assert found.angle == pytest.approx(0.15)


def test_a_law_without_prior_reaches_it() -> None:
    found = goal_distance(tag_at(ASKED, controller__composite__prior=[0.0] * 6, simulation__duration=20.0))
    assert found is not None
    assert found.shift < 1e-6
    assert found.angle < 1e-5


def test_the_summary_of_a_settled_run_states_the_distance() -> None:
    result = tag_at(ASKED)
    found = goal_distance(result)
    assert found is not None
    assert hs.metrics(result)["settling_time"] > 0.0
    sentence = goal_distance_sentence(result, if_hidden=True)
    assert sentence is not None
    assert sentence in summary_sentences(result)
    assert (
        f"is {1e3 * found.shift:.3g} mm and {1e3 * found.angle:.3g} mrad from the pose with the goal image" in sentence
    )
    assert sentence.endswith("; in the image the two nearly cancel.")


def test_where_the_image_shows_the_distance_the_summary_alone_has_it() -> None:
    result = hs.simulate(hs.load_scenario("task-translation"))
    assert goal_distance_sentence(result, if_hidden=True) is None
    assert goal_distance_sentence(result) in summary_sentences(result)


@pytest.mark.parametrize("name", ["paper", "textbook-translation", "eye-to-hand"])
def test_the_command_states_it_where_it_is_hidden(name: str) -> None:
    done = CliRunner().invoke(app, ["run", name])
    assert done.exit_code == 0
    assert ("from the pose with the goal image" in done.output) == (name == "paper")


def test_a_displacement_is_hidden_by_what_it_moves_in_the_image() -> None:
    """A rotation about the line of sight moves the points by their distance from it, and not by f times the angle."""
    goal = [0.0, 0.0, 0.0, 0.0, 0.0, 0.1]
    scenario = small_tag({"camera.noise": 0.0, "target.desired_pose": goal})
    found = goal_distance(result := hs.simulate(scenario.updated(SHORT)))
    assert found is not None
    assert found.angle == pytest.approx(0.1, rel=1e-2)
    assert found.motion == pytest.approx(np.abs(result.feature_error[-1]).max(), rel=0.1)
    assert found.motion < 0.1 * 2285.7 * found.angle
    assert "cancel" not in str(goal_distance_sentence(result))


def test_a_goal_image_that_no_pose_has_is_stated() -> None:
    goal = np.array(hs.load_scenario("paper").target.desired_features)
    goal[0] += 0.3  # [px]
    result = hs.simulate(hs.load_scenario("paper").updated({"target.desired_features": goal}))
    found = goal_distance(result)
    assert found is not None
    assert 0.05 < found.misfit < 0.3
    assert f"from the pose whose image is nearest to the goal's, {found.misfit:.2g} px off" in str(
        goal_distance_sentence(result)
    )


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("paper", {"camera.convention": "as_printed", "controller.law": "hybrid"}),
        ("fails-coarse-step", {}),
        ("reachy-mini-motors", SHORT),  # follows a direction
        ("pi-h824-positions", {"target.motion": {"kind": "velocity", "velocity": [1e-3, 0.0, 0.0]}, **SHORT}),
        ("rough-road", {"target.frame": "world", **SHORT}),
    ],
)
def test_nothing_is_stated_where_no_pose_is_meant(name: str, changes: dict[str, Any]) -> None:
    result = hs.simulate(hs.load_scenario(name).updated(changes))
    assert goal_distance(result) is None
    assert not any("goal image" in sentence for sentence in summary_sentences(result))


def test_three_points_have_up_to_four_poses_with_one_image() -> None:
    points = {"tag": None, "points": [[0.02, 0.0, -0.435], [-0.02, 0.01, -0.43], [0.0, -0.02, -0.44]]}
    scenario = small_tag({"target": {**points, "desired_pose": ASKED}, "robot.stroke": 0.03, **SHORT})
    assert goal_distance(hs.simulate(scenario)) is None
