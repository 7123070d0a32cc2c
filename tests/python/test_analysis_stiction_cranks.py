"""The stiction set of a machine with cranks: beyond where they close there is no pose."""

from __future__ import annotations

import numpy as np

from data_sheet_machines import data_sheet_machine
from hexservo.findings.analysis import stiction
from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.rest import RestLaw
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.analysis.stiction_set import RestSet, confirmed, extremes


def test_a_set_that_reaches_beyond_where_the_cranks_close_is_confirmed_within_it() -> None:
    """The linear program's end has no place for a crank; the pose that is found is held, with every crank closed."""
    changes = {"controller.law": "hybrid", "controller.hybrid.auto.bandwidth": 1.0}
    scenario = data_sheet_machine(cranks=True).updated({**changes, "controller.composite.auto.bandwidth": None})
    scene = scene_of(scenario)
    goals = find_goals(scene)
    assert goals is not None
    kv = np.asarray(scene.settings["controller.hybrid.kv"])
    law = RestLaw(scene, exact_depth=False)
    rest = RestSet.at(scene, law, goals.nearest.view, -kv, kv)
    ends = extremes(rest)
    assert ends is not None
    beyond = 4.0 * ends.displacements[0]
    assert not np.isfinite(scene.leg_travel(rest.view.pose.moved(beyond))).all()
    for displacement in (ends.displacements[0], beyond):
        found = confirmed(scene, law, rest, displacement)
        assert found is not None
        pose, error = found
        assert (np.abs(law.wrench(pose)) <= kv * (1 + 1e-9)).all()
        assert np.abs(scene.leg_travel(pose)).max() <= scene.stroke
        assert error > 0.9 * ends.largest
    cases = stiction.analyse(scenario).cases
    assert all(case.confirmed is not None for case in cases if case.ends is not None and case.name != "around home")
