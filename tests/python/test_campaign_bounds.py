"""Values of required metrics beside their bounds: the ends over all runs, and bounds that no run is near."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import hexservo as hs
from hexservo.campaigns.chunks import Tally, tally_of
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.requirements import requirement_of
from hexservo.campaigns.result import summary_of
from hexservo.campaigns.store import new_record
from hexservo.campaigns.words import summary_section
from hexservo.findings.evidence import Table

SHORT = hs.load_scenario("paper-composite").updated(
    {"simulation.duration": 0.05, "metrics.dwell": 0.01, "metrics.rms_start": 0.0}
)
VARY = {"uncertainty.gravity": {"uniform": [-0.3, 0.3]}}
REQUIRE = ["outcome == completed", "peak_leg_force <= 5", "peak_leg_excursion <= 0.1"]


def file_of(*require: str, **keys: Any) -> dict[str, Any]:
    return {"scenario": SHORT, "vary": VARY, "require": list(require), "runs": 30, **keys}


def test_ends_are_those_of_all_runs_at_any_division_into_chunks(tmp_path: Path) -> None:
    found = []
    for size in (1, 7, 30):
        result = hs.campaign(file_of(*REQUIRE), tmp_path / str(size), chunk_size=size, threads=1)
        table = result.to_dataframe()
        outcome, *of_metrics = result.summary["requirements"]
        assert "largest" not in outcome
        for one, name in zip(of_metrics, ("peak_leg_force", "peak_leg_excursion"), strict=True):
            assert (one["smallest"], one["largest"]) == (table[name].min(), table[name].max())
            assert one["smallest"] < one["largest"]
        found.append(result.summary["requirements"])
    assert found[0] == found[1] == found[2]


def test_ends_go_on_where_a_campaign_gets_more_runs(tmp_path: Path) -> None:
    hs.campaign(file_of(*REQUIRE), tmp_path / "out", runs=10, chunk_size=5, threads=1)
    more = hs.campaign(file_of(*REQUIRE), tmp_path / "out", runs=30, chunk_size=5, threads=1)
    at_once = hs.campaign(file_of(*REQUIRE), tmp_path / "other", threads=1)
    assert more.summary["requirements"] == at_once.summary["requirements"]
    (tmp_path / "out" / "summary.json").unlink()  # counted again, of the chunks
    assert hs.load_campaign(tmp_path / "out").summary["requirements"] == more.summary["requirements"]


def test_runs_that_end_early_or_lack_a_value_have_no_part_in_the_ends() -> None:
    """Of 200 runs with planted outcomes and values, counted in parts of any size."""
    random = np.random.default_rng(20261128)
    values = np.where(random.random(200) < 0.2, np.nan, random.lognormal(size=200))
    outcome = random.choice(["completed", "diverged"], 200, p=[0.6, 0.4])
    values[outcome == "diverged"] *= 1e3
    columns = {"index": np.arange(200), "outcome": outcome, "end_time": np.ones(200), "final_error": values}
    requirements = [requirement_of("outcome == completed"), requirement_of("final_error <= 1")]
    kept = values[(outcome == "completed") & np.isfinite(values)]
    for size in (1, 4, 50, 200):
        tally = Tally([0, 0])
        for first in range(0, 200, size):
            tally.add(tally_of(pa.table(columns).slice(first, size), range(first, first + size), requirements, SHORT))
        assert tally.spans == [(math.inf, -math.inf), (kept.min(), kept.max())]


def section_of(bound: str, smallest: float, largest: float) -> Any:
    """The section of a campaign of 100 runs that complete, with these ends of the metric of one requirement."""
    plan = load_plan(file_of("outcome == completed", bound, runs=100))
    tally = Tally([0, 0], 100, spans=[(math.inf, -math.inf), (smallest, largest)])
    summary = json.loads(json.dumps(summary_of(plan, new_record(plan), tally), allow_nan=False))
    return summary_section(summary)


@pytest.mark.parametrize(
    ("bound", "ends", "sentence"),
    [
        (
            "peak_leg_force <= 500",
            (0.1, 4.9),
            "the largest value is 4.9 N, 0.0098 times the bound. Check the bound, which has the unit N.",
        ),
        ("peak_leg_force <= 500", (0.1, 5.1), ""),
        ("peak_leg_force <= 500", (0.1, 499.0), ""),
        (
            "peak_leg_excursion <= 5",
            (0.002, 0.004),
            "the largest value is 0.004 m, 0.0008 times the bound. Check the bound, which has the unit m.",
        ),
        (
            "peak_rotation >= 0.001",
            (0.2, 0.3),
            "the smallest value is 0.2 rad, 200 times the bound. Check the bound, which has the unit rad.",
        ),
        ("peak_rotation >= 0.001", (0.09, 0.3), ""),
        (
            "peak_leg_force <= 0.01",  # kN, and all runs fail
            (2.0, 6.0),
            "the smallest value is 2 N, 200 times the bound. Check the bound, which has the unit N.",
        ),
        (
            "relative_overshoot <= 5",
            (0.0, 0.02),
            "the largest value is 0.02, 0.004 times the bound. Check the bound, which has no unit.",
        ),
        ("overshoot <= 5", (0.0, 0.0), ""),  # 0 in any unit
        ("overshoot <= 5", (0.0, 1e-9), ""),  # rounding
        ("settling_time <= 0.04", (math.inf, -math.inf), ""),  # no value
    ],
)
def test_a_bound_that_no_run_is_near_is_named(bound: str, ends: tuple[float, float], sentence: str) -> None:
    found = [one for one in section_of(bound, *ends).sentences if one.startswith("No run is near")]
    written = str(requirement_of(bound))
    assert found == ([f"No run is near {written}: {sentence}"] if sentence else [])


@pytest.mark.parametrize(
    ("bound", "cells"),
    [
        ("peak_leg_force <= 500", ["4.9 N", "0.0098"]),
        ("peak_leg_force >= 0.05", ["0.1 N", "2"]),
        ("relative_overshoot < 0.2", ["4.9", "24.5"]),
    ],
)
def test_the_table_of_requirements_has_the_worst_value(bound: str, cells: list[str]) -> None:
    table = section_of(bound, 0.1, 4.9).items[0]
    assert isinstance(table, Table)
    assert [row[-2:] for row in table.rows] == [["-", "-"], cells]


def test_a_bound_out_by_a_unit_is_named_by_a_campaign(tmp_path: Path) -> None:
    """Forces reach 0.16 N: of 0.2 N that is most, and of 200, which is the bound in mN, next to nothing."""
    for bound, expected in (("0.2", 0), ("200", 1)):
        section = hs.campaign(file_of(f"peak_leg_force <= {bound}", runs=60), tmp_path / bound, threads=1).section()
        assert section.verdict == "good"
        assert sum(one.startswith("No run is near peak_leg_force") for one in section.sentences) == expected


def test_a_summary_without_ends_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    summary = hs.campaign(file_of(*REQUIRE), tmp_path / "out", threads=1).summary
    for one in summary["requirements"]:
        for key in ("bound", "unit", "smallest", "largest"):
            one.pop(key, None)
    rows = summary_section(summary).items[0]
    assert isinstance(rows, Table)
    assert all(row[-2:] == ["-", "-"] for row in rows.rows)
