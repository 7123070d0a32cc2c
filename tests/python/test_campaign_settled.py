"""Runs that are settled at their start: counted, and no ground for a good verdict where most are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import hexservo as hs
from hexservo.campaigns.chunks import tally_of
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.requirements import requirement_of
from hexservo.findings.analysis.scene import scene_of

SHORT = hs.load_scenario("paper").updated({"simulation.duration": 0.02, "metrics.dwell": 0.01})
REQUIRE = ["outcome == completed", "settling_time <= 0.005"]
STIFFNESS = {"controller.hybrid.kp": {"uniform": [1e-4, 2e-4]}}


def file_of(band: float, **keys: Any) -> dict[str, Any]:
    scenario = SHORT.updated({"metrics.band": band})
    return {"scenario": scenario, "vary": STIFFNESS, "require": REQUIRE, "runs": 60, **keys}


def test_runs_that_start_within_the_band_are_no_ground_for_a_good_verdict(tmp_path: Path) -> None:
    result = hs.campaign(file_of(1000.0), tmp_path / "out", threads=1)
    section = result.section()
    assert (result.failures, result.summary["settled_at_start"]) == (0, 60)
    assert section.verdict == "warning"
    sentence = "60 of 60 runs are within metrics.band of the goal from the start on, so that they count as settled"
    assert any(each.startswith(sentence) for each in section.sentences)
    again = hs.load_campaign(tmp_path / "out").section()
    assert (again.sentences, again.verdict) == (section.sentences, "warning")
    (tmp_path / "out" / "summary.json").unlink()  # counted again, of the chunks
    assert hs.load_campaign(tmp_path / "out").section().sentences == section.sentences


def test_of_starts_that_vary_those_within_the_band_are_counted(tmp_path: Path) -> None:
    """The image of a start in the scene of each run is within the band; nothing gets there in 0.02 s."""
    vary = {"target.translation": {"uniform": [-0.02, 0.02], "each": True}}
    result = hs.campaign(file_of(10.0, vary=vary), tmp_path / "out", threads=1)
    errors = [scene_of(result.scenario(index)) for index in range(60)]
    inside = sum(float(np.abs(each.view(each.start).features - each.desired).max()) <= 10.0 for each in errors)
    assert 0 < inside < 60
    assert result.summary["settled_at_start"] == inside
    assert any(each.startswith(f"{inside} of 60 runs ") for each in result.section().sentences)


def test_a_run_whose_first_sample_alone_is_outside_is_not_settled_at_its_start(tmp_path: Path) -> None:
    """All start at 20 px and have a settling time of 0; the narrower half of the bands does not have the start."""
    bands = {"metrics.band": {"uniform": [19.95, 20.05]}}
    file = file_of(20.0, vary=bands, metrics=["settling_time"])
    result = hs.campaign(file, tmp_path / "out", threads=1)
    table = result.to_dataframe()
    assert (table["settling_time"] == 0.0).all()
    inside = int((table["metrics.band"] >= 20.0 + 1e-9).sum())
    assert 0 < inside < 60
    assert result.summary["settled_at_start"] == inside

    outside = hs.campaign(file_of(19.95, metrics=["settling_time"]), tmp_path / "outside", threads=1)
    assert (outside.to_dataframe()["settling_time"] == 0.0).all()
    assert outside.summary["settled_at_start"] == 0
    assert outside.section().verdict == "good"
    assert not any("metrics.band" in each for each in outside.section().sentences)


def test_a_run_that_ends_early_is_not_settled_at_its_start() -> None:
    numbers = {"settling_time": [0.0, 0.0], "peak_error": [1.0, 1.0], "end_time": [0.1, 1.0], "margin": [-1.0, 1.0]}
    table = pa.table({"index": [0, 1], "outcome": ["leg_limit", "completed"], **numbers})
    tally = tally_of(table, range(2), [requirement_of("outcome == completed")], hs.load_scenario("paper"))
    assert (tally.runs, tally.failures, tally.unmoved) == (2, 1, 1)


@pytest.mark.parametrize(
    ("keys", "needs"),
    [
        ({}, True),
        ({"require": ["outcome == completed"]}, False),
        (
            {
                "require": ["outcome == completed"],
                "tune": {"variables": {"controller.hybrid.kv": {"log": [1e-6, 1]}}, "minimise": "settling_time"},
            },
            True,
        ),
        ({"vary": {"uncertainty.gravity": {"uniform": [-0.1, 0.1]}}}, False),
        ({"vary": {"simulation.start.twist": {"uniform": [0.0, 0.1], "each": True}}}, False),
        ({"vary": {"target.translation": {"uniform": [0.0, 0.1], "each": True}}}, True),
    ],
)
def test_staying_is_a_result_where_something_moves_the_platform(keys: dict[str, Any], needs: bool) -> None:
    assert load_plan(file_of(1000.0, **keys)).needs_motion == needs


def test_tuning_for_loops_that_are_settled_at_the_start_is_not_good(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexservo.campaigns.candidates._WORST_RUNS", 20)
    tune = {"variables": {"controller.hybrid.kv": {"log": [1e-6, 1e-3]}}, "minimise": "settling_time", "over": 2}
    result = hs.tune(file_of(1000.0, tune=tune), tmp_path / "out", generations=1, rounds=1, threads=1)
    section = result.section()
    assert result.worst == (0.0,)
    assert section.verdict == "warning"
    assert any(each.startswith("60 of 60 runs are within metrics.band of the goal") for each in section.sentences)
