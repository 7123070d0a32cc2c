"""Settling needs a dwell time: one definition for metrics, comparisons, reports and figures."""

from __future__ import annotations

import re

import numpy as np
import pytest

import hexservo as hs
from hexservo.run.metrics import since_settling
from hexservo.run.summary import summary_sentences

BAND = 2.0  # default, docs/model.md section 8


def settling_time(time: np.ndarray, error: np.ndarray, band: float, dwell: float) -> float:
    """Settling time by its definition, over a whole record: an independent count, sample by sample."""
    outside = np.flatnonzero(error > band)
    first = outside[-1] + 1 if len(outside) else 0  # of the last stay
    if first == len(time) or time[-1] - time[first] < (dwell if first else 0.0) - 1e-9:
        return float("nan")
    return float(time[first - 1]) if first else 0.0


@pytest.fixture(scope="module")
def swinging(paper: hs.Scenario) -> hs.Scenario:
    """A platform that swings along z through its goal for ever: a transpose law without any damping."""
    square = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]], dtype=float)
    return paper.updated(
        {
            "name": "swinging",
            "target.initial_features": (40.0 * square).ravel().tolist(),
            "target.desired_features": (50.0 * square).ravel().tolist(),
            "uncertainty": {"inertia": 0.0, "coriolis": 0.0, "gravity": 0.0, "depth": 0.0},
            "controller.law": "kelly",
            "controller.kelly.kd": 0.0,
        }
    )


def test_a_run_that_crosses_the_band_at_its_end_is_not_settled(swinging: hs.Scenario) -> None:
    long = hs.simulate(swinging)
    error = np.abs(long.feature_error).max(axis=1)
    inside = error <= BAND
    # the last sample of the run that is the first one of a stay, late in the run
    entries = np.flatnonzero(inside[1:] & ~inside[:-1]) + 1
    end = float(long.time[entries[-1]])
    assert end > 3.0
    scenario = swinging.updated({"simulation.duration": end})
    (row,) = hs.compare([scenario], ["kelly"]).rows
    assert row.outcome == "completed"
    assert row.metrics["final_error"] <= BAND
    assert row.metrics["rms_error"] > 5.0  # it wanders, by far more than the band
    assert not row.settled
    assert row.verdict == "not settled"
    assert row.why.startswith("within 2 px at the end, but for less than 0.2 s")
    result = hs.simulate(scenario)
    assert np.isnan(hs.metrics(result)["settling_time"])
    assert "did not settle: within 2 px at the end, but for less than 0.2 s" in " ".join(summary_sentences(result))


@pytest.mark.parametrize("band", [0.5, 2.0, 5.0, 9.0, 11.0])
@pytest.mark.parametrize("dwell", [1e-9, 1e-3, 0.02, 0.2, 3.0])
def test_the_streamed_settling_time_is_that_of_the_record(swinging: hs.Scenario, band: float, dwell: float) -> None:
    for duration in (0.1, 1.0):
        keys = {"simulation.duration": duration, "metrics.band": band, "metrics.dwell": dwell}
        for law in ("kelly", "composite"):
            result = hs.simulate(swinging.updated({**keys, "controller.law": law}))
            error = np.abs(result.feature_error).max(axis=1)
            expected = settling_time(result.time, error, band, dwell)
            assert hs.metrics(result)["settling_time"] == pytest.approx(expected, nan_ok=True, abs=1e-12)


def test_a_run_within_the_band_from_its_start_on_is_settled_however_short(paper: hs.Scenario) -> None:
    scenario = paper.updated({"target.desired_features": paper.target.initial_features, "simulation.duration": 0.01})
    assert hs.metrics(hs.simulate(scenario))["settling_time"] == 0.0
    (row,) = hs.compare([scenario], ["hybrid"]).rows
    assert row.settled
    assert row.why == "within 2 px from the start on"


def test_report_and_comparison_say_the_band_and_the_start_of_the_scenario(paper: hs.Scenario) -> None:
    scenario = paper.updated({"metrics": {"band": 5.0, "rms_start": 2.5}})
    result = hs.simulate(scenario)
    text = " ".join(summary_sentences(result))
    assert "within 5 px of their goals after" in text
    assert "from 2.5 s on their RMS is" in text
    error = np.abs(result.feature_error)
    expected = np.sqrt(np.mean(error[result.time >= 2.5 - 1e-9] ** 2))
    assert hs.metrics(result)["rms_error"] == pytest.approx(expected, rel=1e-9)
    (row,) = hs.compare([scenario], ["hybrid"]).rows
    assert row.why.startswith("within 5 px after ")
    assert hs.metrics(result)["settling_time"] < hs.metrics(hs.simulate(paper))["settling_time"]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"metrics.band": 0.0}, r"^metrics.band: expected a number > 0, got 0"),
        ({"metrics.dwell": 0.0}, r"^metrics.dwell: expected a number > 0, got 0"),
        ({"metrics.rms_start": -1.0}, r"^metrics.rms_start: expected a number >= 0, got -1"),
        ({"metrics.settling_threshold": 2.0}, r"^metrics.settling_threshold: unknown key"),
    ],
)
def test_refusals(paper: hs.Scenario, keys: dict[str, float], message: str) -> None:
    with pytest.raises(hs.ScenarioError, match=message):
        paper.updated(keys)


def test_a_run_that_is_not_longer_than_the_start_of_the_rms_has_none(paper: hs.Scenario) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.5}))
    assert result.outcome == "completed"
    assert np.isnan(hs.metrics(result)["rms_error"])
    assert "RMS" not in " ".join(summary_sentences(result))


# ---- The sentences hold ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["paper", "pi-h824-positions", "moog-6dof2000e"])
def test_the_time_in_sentences_is_the_last_one_outside(name: str) -> None:
    """All samples after it are within the band, and it is not a time within."""
    result = hs.simulate(hs.load_scenario(name).updated({"simulation.log_every": 1}))
    outside = result.time[np.abs(result.feature_error).max(axis=1) > result.scenario.metrics.band]
    (row,) = hs.compare([result.scenario], [result.scenario.controller.law]).rows
    title = hs.plots.feature_errors(result).axes[0].get_title(loc="left")
    for text in (" ".join(summary_sentences(result)), row.why, title):
        (time,) = re.findall(r"ithin ±?[\d.]+ px(?: of their goals| \(shaded\))? after ([\d.]+) s", text)
        assert float(time) == pytest.approx(outside[-1], abs=0.01)  # the title has three digits
        assert float(time) >= outside[-1] - 1e-9


@pytest.mark.parametrize(
    ("time", "text"), [(0.55, "0.55"), (0.353, "0.353"), (0.1 + 0.2, "0.3"), (12.341, "12.35"), (100.02, "100.1")]
)
def test_a_time_with_fewer_digits_is_rounded_up(paper: hs.Scenario, time: float, text: str) -> None:
    """No sample after the time that is written is outside."""
    assert since_settling({"settling_time": time, "peak_error": 9.0}, paper.metrics) == f"after {text} s"
    assert float(text) >= time - 1e-12


def test_a_first_sample_outside_is_no_stay_from_the_start_on(paper: hs.Scenario) -> None:
    """All runs have a settling time of 0: all start at 20 px, one outside of its band."""
    edge = float(np.abs(hs.simulate(paper).feature_error[0]).max())  # 20 px but for rounding
    for band, words, summary in (
        (19.95, "after the first sample", "are within 19.95 px of their goals after the first sample."),
        (edge, "from the start on", "stayed within 20 px from the start."),
        (20.05, "from the start on", "stayed within 20.05 px from the start."),
    ):
        result = hs.simulate(paper.updated({"metrics.band": band}))
        error = np.abs(result.feature_error).max(axis=1)
        assert hs.metrics(result)["settling_time"] == 0.0
        assert (error > band).sum() == (band < 20.0)
        assert f"All features {summary}" in summary_sentences(result)
        (row,) = hs.compare([result.scenario], ["hybrid"]).rows
        assert (row.verdict, row.why) == ("settled", f"within {band:g} px {words}")


def test_a_run_that_ends_early_states_after_when_it_was_within() -> None:
    """The law settles; then a single push takes the platform away within a step."""
    scenario = hs.load_scenario("slow-camera").updated({"simulation.log_every": 1})
    tick = hs.Controller(scenario)

    def settles_then_pushes(seen: hs.Observation) -> list[float] | np.ndarray:
        wrench = tick.step(seen.pixels, seen.depth, seen.position, seen.quaternion, seen.twist).wrench
        return wrench if seen.time < 1.5 else [0.0, 0.0, 1e9, 0.0, 0.0, 0.0]

    result = hs.simulate(scenario, controller=settles_then_pushes)
    outside = result.time[np.abs(result.feature_error).max(axis=1) > BAND]
    assert result.outcome != "completed"
    words = f"Until then the features had been within 2 px after {outside[-1]:.4g} s."
    assert words in summary_sentences(result)
