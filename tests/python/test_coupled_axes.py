"""What `hexservo check` warns of with fitted gains where the inertia couples the axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hexservo as hs
from fitted_machines import BAND, rotation
from hexservo.findings.analysis.scene import Scene
from hexservo.findings.coupling import causes_of_products, has_products, settling
from test_fitted_gains import with_auto
from without_runs import unlikely_without_runs

OFF_CENTRE = [0.0, 0.0, 0.05]  # half a platform radius


def carrying(paper: hs.Scenario, law: str, centre: list[float]) -> hs.Scenario:
    """The paper's platform with its centre of mass elsewhere, over a tag that it is to see rotated; without errors."""
    place = np.array(centre)
    inertia = np.diag([1.5e-4, 1.5e-4, 3e-4]) + 0.06 * (place @ place * np.eye(3) - np.outer(place, place))
    return with_auto(
        paper.updated(
            {
                "robot.centre_of_mass": centre,
                "robot.inertia": inertia.tolist(),
                "target": {
                    **dict.fromkeys(("initial_features", "desired_features", "depth")),
                    "tag": {"size": 0.15, "pose": [0.0, 0.0, -0.65, 0.0, 0.0, 0.0]},
                    "desired_pose": [0.01, -0.008, 0.01, 0.02, -0.02, 0.03],
                },
                "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "depth": 0.0},
                "simulation": {"step": 1e-3, "duration": 1.5},
            }
        ),
        law,
        2.0,
    )


def settled_at(scenario: hs.Scenario) -> float:
    run = hs.simulate(scenario)
    error = np.abs(run.feature_error).max(axis=1)
    return float(run.time[np.flatnonzero(error > BAND * error[0])[-1]])


@pytest.mark.parametrize("law", ["pbvs", "resolved_rate"])
def test_the_time_to_settle_is_that_of_a_run(paper: hs.Scenario, law: str) -> None:
    centred, coupled = (carrying(paper, law, place) for place in ([0.0, 0.0, 0.0], OFF_CENTRE))
    found = settled_at(coupled) / settled_at(centred)
    assert settling(Scene(coupled)).ratio == pytest.approx(found, rel=0.03)


def test_a_narrow_band_of_the_scenario_shows_what_5_percent_hide(paper: hs.Scenario) -> None:
    """Of the start's 27 px, 5 % are 1.4 px: the swing that is left ends within, and is outside 0.5 px."""
    narrow = {"metrics.band": 0.5}
    centred, coupled = (
        carrying(paper, "composite", place).updated(narrow) for place in ([0.0, 0.0, 0.0], [0.028, 0.0, 0.0])
    )
    found = [hs.metrics(hs.simulate(scenario))["settling_time"] for scenario in (coupled, centred)]
    assert settling(Scene(coupled)).ratio == pytest.approx(found[0] / found[1], rel=0.05)
    (warned,) = (sentence for sentence in unlikely_without_runs(coupled) if "couples the axes" in sentence)
    assert "settles to 0.5 px, metrics.band, in 1.9 times the time of uncoupled axes" in warned
    wide = coupled.updated({"metrics.band": 0.05 * 27.2})
    assert not any("couples the axes" in sentence for sentence in unlikely_without_runs(wide))


def test_a_band_that_the_law_rests_outside_of_is_left_out(paper: hs.Scenario) -> None:
    """The prior leaves 0.18 px: no run settles to less, and 5 % of the start is the only band to compare."""
    coupled = carrying(paper, "composite", OFF_CENTRE)
    run = hs.simulate(coupled.updated({"simulation.duration": 10.0, "controller.composite.kv": 0.0}))
    left = float(np.abs(run.feature_error[-1]).max())
    assert left == pytest.approx(0.177, abs=1e-3)
    below, above = (settling(Scene(coupled.updated({"metrics.band": factor * left}))) for factor in (0.999, 1.001))
    assert below.is_share
    assert below.band == pytest.approx(0.05 * np.abs(run.feature_error[0]).max(), rel=0.02)
    assert not above.is_share
    assert above.band == pytest.approx(1.001 * left)


@pytest.mark.parametrize(
    ("gravity", "words"),
    [
        (0.0, "settles to 0.001 px, metrics.band, beyond the time"),  # not within three periods
        (0.02, "settles to 1.3 px, 5 % of that at the start, in 1.6 times the time"),  # rests at 0.25 px
        (0.2, ""),  # at 2.5 px
    ],
)
def test_an_unknown_weight_leaves_out_the_bands_that_are_not_reached(
    gravity: float, words: str, paper: hs.Scenario
) -> None:
    changes = {"metrics.band": 1e-3, "uncertainty.gravity": gravity}
    found = [
        text
        for text in unlikely_without_runs(carrying(paper, "pbvs", OFF_CENTRE).updated(changes))
        if "couples the axes" in text
    ]
    assert len(found) == bool(words)
    assert all(words in text for text in found)


@pytest.mark.parametrize("law", ["hybrid", "composite", "kelly", "resolved_rate", "pbvs", "computed_torque"])
def test_coupled_axes_are_warned_of_where_the_law_leaves_them_coupled(paper: hs.Scenario, law: str) -> None:
    words = f"controller.{law}.auto.bandwidth: 2 Hz is fitted axis by axis, but the inertia couples the axes"
    for centre in ([0.0, 0.0, 0.0], OFF_CENTRE):
        scenario = carrying(paper, law, centre)
        found = [sentence for sentence in unlikely_without_runs(scenario) if sentence.startswith(words)]
        ratio = settling(Scene(scenario)).ratio
        assert bool(found) == (ratio < 0.85 or ratio > 1.2)
        if law in ("hybrid", "computed_torque"):
            assert ratio == 1.0
        elif centre != OFF_CENTRE:  # the goal's attitude leaves small products; kelly is slow whatever the inertia
            assert np.isnan(ratio) if law == "kelly" else ratio == pytest.approx(1.0, abs=0.01)
    if law in ("pbvs", "resolved_rate"):
        assert found


def test_other_products_of_inertia_couple_axes_too(paper: hs.Scenario) -> None:
    axes = rotation(np.array([0.3, 0.2, 0.0]))
    scenario = carrying(paper, "pbvs", [0.0, 0.0, 0.0])
    turned = scenario.updated({"robot.inertia": (axes @ np.diag([1.5e-4, 1.5e-4, 3e-4]) @ axes.T).tolist()})
    assert settling(Scene(scenario)).ratio == pytest.approx(1.0, abs=0.01)
    assert abs(settling(Scene(turned)).ratio - 1.0) > 0.02


DISPLACED = [-0.01, 0.008, -0.01, -0.02, 0.02, -0.03]  # [m; rad]


@pytest.mark.parametrize(
    ("changes", "warned"),
    [
        ({"target.desired_pose": [0.0] * 6, "target.desired_features": None, "simulation.start.pose": DISPLACED}, True),
        ({"simulation.start.pose": [0.01, -0.008, -0.01, 0.02, -0.02, -0.03]}, False),  # z alone is not coupled
        ({"simulation.start.pose": [0.01, -0.008, 0.01, 0.02, -0.02, 0.03]}, False),  # the goal itself
    ],
)
def test_the_time_to_settle_is_from_the_start_of_the_scenario(
    paper: hs.Scenario, changes: dict[str, Any], warned: bool
) -> None:
    centred, coupled = (carrying(paper, "pbvs", place).updated(changes) for place in ([0.0, 0.0, 0.0], OFF_CENTRE))
    assert any("couples the axes" in sentence for sentence in unlikely_without_runs(coupled)) == warned
    if warned:
        assert settling(Scene(coupled)).ratio == pytest.approx(settled_at(coupled) / settled_at(centred), rel=0.03)


@pytest.mark.parametrize("gain", ["kp", "kd"])
def test_gains_that_are_given_are_not_judged_as_fitted(paper: hs.Scenario, gain: str) -> None:
    scenario = carrying(paper, "pbvs", OFF_CENTRE)
    given = 4.0 * np.array(getattr(scenario.controller.pbvs, gain))
    changed = scenario.updated({f"controller.pbvs.{gain}": given.tolist()})
    found = [
        [text for text in unlikely_without_runs(each) if "couples the axes" in text] for each in (scenario, changed)
    ]
    assert [len(texts) for texts in found] == [1, 0]


def test_without_fuzzy_systems_nothing_adapts(paper: hs.Scenario) -> None:
    off = {"controller.composite.fuzzy.enabled": False}
    centred, coupled = (
        carrying(paper, "composite", place).updated({**off, "simulation.duration": 3.0})
        for place in ([0.0, 0.0, 0.0], [0.0, 0.0, 0.03])
    )
    ratio = settling(Scene(coupled)).ratio
    assert ratio == pytest.approx(settled_at(coupled) / settled_at(centred), rel=0.07)
    assert ratio != pytest.approx(settling(Scene(carrying(paper, "composite", [0.0, 0.0, 0.03]))).ratio, rel=0.005)


@pytest.mark.parametrize(
    ("changes", "of_coupling", "of_centre"),
    [
        ({"robot.centre_of_mass": [0.0, 0.0, 0.01]}, "robot.centre_of_mass", "robot.centre_of_mass"),
        ({"robot.payload": {"mass": 0.01, "position": [0.0, 0.0, 0.01]}}, *2 * ["robot.payload.position"]),
        (
            {
                "robot.centre_of_mass": [0.0, 0.0, 0.01],
                "robot.payload": {"mass": 0.01, "position": [0.0, 0.0, 0.01]},
            },
            *2 * ["robot.centre_of_mass and robot.payload.position"],
        ),
        # none of what the controller does not know couples the axes of its model
        ({"robot.payload": {"mass": 0.01, "position": [0.0, 0.0, 0.01], "known": False}}, "", "robot.payload.position"),
        (
            {"robot.inertia": [[1.5e-4, 2e-5, 0.0], [2e-5, 1.5e-4, 0.0], [0.0, 0.0, 2e-4]]},
            "products in robot.inertia",
            "",
        ),
        ({"target.desired_pose": [0.0, 0.0, 0.0, 0.3, 0.0, 0.0]}, "unequal moments in robot.inertia, rotated", ""),
        ({"robot.payload": {"mass": 0.01}}, "", ""),
    ],
)
def test_the_keys_are_named_that_place_the_centre_of_mass_and_couple_the_axes(
    paper: hs.Scenario, changes: dict[str, Any], of_coupling: str, of_centre: str
) -> None:
    goal = {"target.desired_features": None, "target.desired_pose": [0.0] * 6, "robot.inertia": [2e-4, 2e-4, 3e-4]}
    scene = Scene(carrying(paper, "pbvs", [0.0, 0.0, 0.0]).updated({**goal, **changes}))
    assert has_products(scene.machine) == bool(of_coupling)
    if of_coupling:
        assert causes_of_products(scene.scenario) == of_coupling
    assert f"({of_centre})" in scene.unusual_body if of_centre else "centre of mass" not in scene.unusual_body


def test_a_load_of_a_simulator_is_named_by_check_and_analyse() -> None:
    """`robot.centre_of_mass` of `moog-6dof2000e` is the origin."""
    scenario = hs.load_scenario("moog-6dof2000e")
    (coupled,) = (sentence for sentence in unlikely_without_runs(scenario) if "couples the axes" in sentence)
    assert "the inertia couples the axes (robot.payload.position): " in coupled
    words = " ".join(str(hs.analyse(scenario, ["stiction", "camera_rate"])).split())
    assert words.count("not in the platform's origin (robot.payload.position), and") == 2
    assert "robot.centre_of_mass" not in coupled + words
