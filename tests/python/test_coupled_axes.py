"""What `hexservo check` warns of with fitted gains where the inertia couples the axes."""

from __future__ import annotations

import numpy as np
import pytest

import hexservo as hs
from fitted_machines import BAND, rotation
from hexservo.findings.check import unlikely
from hexservo.findings.coupling import settling_ratio
from hexservo.scenario.fitted import machine_of
from test_fitted_gains import with_auto

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
    assert settling_ratio(machine_of(coupled), law, 1.0) == pytest.approx(found, rel=0.03)


@pytest.mark.parametrize("law", ["hybrid", "composite", "kelly", "resolved_rate", "pbvs", "computed_torque"])
def test_coupled_axes_are_warned_of_where_the_law_leaves_them_coupled(paper: hs.Scenario, law: str) -> None:
    words = f"controller.{law}.auto.bandwidth: 2 Hz is fitted axis by axis, but the inertia couples the axes"
    for centre in ([0.0, 0.0, 0.0], OFF_CENTRE):
        scenario = carrying(paper, law, centre)
        found = [sentence for sentence in unlikely(scenario) if sentence.startswith(words)]
        ratio = settling_ratio(machine_of(scenario), law, 1.0)
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
    assert settling_ratio(machine_of(scenario), "pbvs", 1.0) == pytest.approx(1.0, abs=0.01)
    assert abs(settling_ratio(machine_of(turned), "pbvs", 1.0) - 1.0) > 0.02
