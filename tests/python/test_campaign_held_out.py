"""Held-out runs of a search for gains: those that end early are counted apart, and the table is read once."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.campaigns.candidates import Candidates
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.search_steps import SearchSteps
from hexservo.campaigns.tune_result import FrontPoint, HeldOut
from hexservo.campaigns.tuning import _front_csv

SCENARIO = hs.load_scenario("composite-30hz").updated(
    {"robot.on_limit": "stop", "robot.stroke": 0.0044, "simulation.duration": 0.3, "metrics.rms_start": 0.1}
)
FILE: dict[str, Any] = {  # runs from far away leave the stroke, with the largest image error that any has
    "scenario": SCENARIO,
    "vary": {"target.translation": {"uniform": [-0.008, 0.008], "each": True}},
    "require": ["peak_leg_force <= 1000"],
    "runs": 40,
    "tune": {
        "variables": {"controller.composite.drive": {"log": [3.9, 4.1]}},
        "minimise": ["peak_error", "peak_leg_force"],
        "over": 2,
    },
}
METRICS = ("peak_error", "peak_leg_force")


@pytest.fixture(scope="module")
def candidates(tmp_path_factory: pytest.TempPathFactory) -> Candidates:
    plan = load_plan(FILE)
    steps = SearchSteps(tmp_path_factory.mktemp("steps") / "out", plan, 0, 1, pytest.fail)
    assert plan.tune is not None
    with steps.opened():
        return Candidates(plan, plan.tune, steps, 0, 1)


def test_largest_metrics_of_a_front_are_those_of_runs_that_complete(candidates: Candidates) -> None:
    plan = candidates.plan.changed(stream=1)
    place = candidates.place_of(SCENARIO)
    for _ in range(2):  # simulated, then of the steps that are kept
        candidates.steps.count = 0
        ((failures, early, largest),) = candidates.on_runs(place[None], plan, 40)
        drawing = plan.drawing()
        base = SCENARIO.updated({**drawing.base, **candidates.gains(place)})
        batch = hs.simulate_batch(base, drawing.variations(drawing.numbers(0, 40)), "metrics")
        whole = batch.outcome == "completed"
        assert 0 < whole.sum() < 40
        assert (failures, early) == (40 - whole.sum(), 40 - whole.sum())
        np.testing.assert_allclose(largest, [batch.metrics[name][whole].max() for name in METRICS], rtol=1e-9)
        assert largest[0] < 0.99 * batch.metrics["peak_error"].max()


def test_a_front_states_how_many_runs_end_early(candidates: Candidates) -> None:
    gains = candidates.gains(candidates.place_of(SCENARIO))
    front = tuple(
        FrontPoint(gains, (1.0, 2.0), (3.0, 4.0), failures, early, 40) for failures, early in ((9, 7), (2, 0))
    )
    rows = list(csv.DictReader(_front_csv(front, candidates).splitlines()))
    assert [(row["failures"], row["ended_early"], row["runs"]) for row in rows] == [("9", "7", "40"), ("2", "0", "40")]
    assert [row["peak_error_held_out"] for row in rows] == ["3.0", "3.0"]


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> hs.TuneResult:
    """Gains that were searched over near starts, and held-out runs from far ones too, some of which end early."""
    folder = tmp_path_factory.mktemp("tuned")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hexservo.campaigns.candidates._WORST_RUNS", 10)
        tune = FILE["tune"] | {"minimise": "peak_error", "over": 1}
        near = {"target.translation": {"uniform": [-1e-5, 1e-5], "each": True}}
        found = hs.tune(FILE | {"tune": tune, "vary": near}, folder / "out", generations=1, rounds=1, threads=1)
    assert found.held_out is not None
    return dataclasses.replace(found, held_out=hs.campaign(FILE, folder / "far", threads=1))


def test_held_out_runs_that_end_early_are_no_worse_cases_of_a_metric(tuned: hs.TuneResult) -> None:
    assert tuned.held_out is not None
    table = tuned.held_out.to_dataframe()
    whole = table[table.outcome == "completed"].peak_error
    assert 0 < len(whole) < 40
    least = float(whole.max())
    assert least < 0.99 * table.peak_error.max()
    good = dataclasses.replace(tuned, settled=True, worst=(least,), margin=-3.0, worst_margin=-3.0)
    assert good._larger_held_out() == ""
    worse = dataclasses.replace(good, worst=(0.9 * least,))
    assert worse._larger_held_out().startswith("a peak error of ")


def test_the_table_of_held_out_runs_is_read_once(tuned: hs.TuneResult, monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[Any] = []
    tables = hs.CampaignResult.tables

    def watched(result: hs.CampaignResult, columns: Any = None) -> Iterator[Any]:
        reads.append(columns)
        return tables(result, columns)

    monkeypatch.setattr(hs.CampaignResult, "tables", watched)
    result = dataclasses.replace(tuned, settled=True)
    sentences = result.section().sentences
    assert result.sections()[0].sentences == sentences
    assert len(reads) == 1
    assert any("runs that complete" in sentence for sentence in sentences)


@pytest.mark.parametrize("chunk_size", [1, 7, 40])
def test_held_out_runs_are_the_same_at_any_division_into_chunks(tmp_path: Path, chunk_size: int) -> None:
    held_out = hs.campaign({**FILE, "metrics": list(METRICS)}, tmp_path / "out", chunk_size=chunk_size, threads=1)
    table = held_out.to_dataframe()
    whole = table[table.outcome == "completed"]
    expected = HeldOut(40, len(whole), tuple(whole[name].max() for name in METRICS), table.margin.min())
    assert HeldOut.of(held_out, METRICS) == expected
