"""The weights of the fuzzy systems at every logged sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import hexservo as hs
from widths import WIDTHS

SHORT = {"simulation.duration": 0.5}


@pytest.mark.parametrize("law", ["hybrid", "composite"])
@pytest.mark.parametrize("mode", ["continuous", "sampled"])
def test_first_and_last_row(paper: hs.Scenario, law: str, mode: str) -> None:
    scenario = paper.updated(
        SHORT | {"controller.law": law, "simulation.mode": mode, f"controller.{law}.fuzzy.initial_scale": 0.01}
    )
    result = hs.simulate(scenario, log_weights=True)
    history = result.weight_history
    assert history is not None
    assert history.shape == (501, 6, 7, 7)
    assert history.flags.c_contiguous
    np.testing.assert_array_equal(history[-1], result.fuzzy_weights)
    table = np.clip(np.add.outer(np.arange(-3, 4), np.arange(-3, 4)), -3, 3) / 3
    np.testing.assert_allclose(history[0], np.tile(0.01 * table, (6, 1, 1)), rtol=0, atol=1e-17)
    assert (np.diff(history, axis=0) != 0).any(axis=(0, 2, 3)).all()


@pytest.mark.parametrize("mode", ["continuous", "sampled"])
def test_nothing_else_changes(paper: hs.Scenario, mode: str) -> None:
    scenario = paper.updated(SHORT | {"simulation.mode": mode})
    plain, logged = hs.simulate(scenario), hs.simulate(scenario, log_weights=True)
    assert plain.weight_history is None
    for name in ("time", "fuzzy_weights", *WIDTHS):
        np.testing.assert_array_equal(getattr(plain, name), getattr(logged, name))
    np.testing.assert_equal(plain.streamed_metrics, logged.streamed_metrics)
    assert (plain.outcome, plain.detail, plain.events) == (logged.outcome, logged.detail, logged.events)


@pytest.mark.parametrize("every", [2, 7, 500, 10**6])
def test_thinned_with_the_log(paper: hs.Scenario, every: int) -> None:
    full = hs.simulate(paper.updated(SHORT), log_weights=True)
    thin = hs.simulate(paper.updated(SHORT | {"simulation.log_every": every}), log_weights=True)
    assert full.weight_history is not None
    assert thin.weight_history is not None
    rows = np.round(thin.time * 1e3).astype(int)
    np.testing.assert_array_equal(thin.weight_history, full.weight_history[rows])


def test_a_run_that_ends_early_logs_the_weights_of_its_last_good_sample(paper: hs.Scenario) -> None:
    """A leg limit is met after the weights have advanced: the row is still that of the sample."""
    changes: dict[str, Any] = {
        "simulation": {"mode": "sampled", "duration": 0.5},
        "robot": {"stroke": 3e-3, "on_limit": "stop"},
    }
    full = hs.simulate(paper.updated(changes), log_weights=True)
    assert full.outcome == "leg_limit"
    assert full.weight_history is not None
    assert len(full.time) > 10
    for every in (3, 7, 10**6):
        thin = hs.simulate(paper.updated(changes | {"simulation.log_every": every}), log_weights=True)
        assert thin.weight_history is not None
        assert thin.time[-1] == full.time[-1]
        np.testing.assert_array_equal(thin.weight_history[-1], full.weight_history[-1])
        np.testing.assert_array_equal(thin.weight_history[:-1], full.weight_history[:-1:every][: len(thin.time) - 1])


def test_the_weights_at_the_end_of_a_run_that_its_legs_stop(paper: hs.Scenario) -> None:
    """One step beyond the last good sample: those of the run that only reports the limit, a row later."""
    changes: dict[str, Any] = {"simulation": {"mode": "sampled", "duration": 0.5}, "robot": {"stroke": 3e-3}}
    on = hs.simulate(paper.updated(changes), log_weights=True)
    stopped = hs.simulate(paper.updated(changes).updated({"robot.on_limit": "stop"}), log_weights=True)
    assert stopped.outcome == "leg_limit"
    assert stopped.weight_history is not None
    assert on.weight_history is not None
    rows = len(stopped.time)
    np.testing.assert_array_equal(stopped.weight_history, on.weight_history[:rows])
    np.testing.assert_array_equal(stopped.fuzzy_weights, on.weight_history[rows])
    assert (stopped.fuzzy_weights != stopped.weight_history[-1]).any()


@pytest.mark.parametrize("law", ["kelly", "resolved_rate", "pbvs", "computed_torque"])
def test_laws_without_fuzzy_systems(paper: hs.Scenario, law: str) -> None:
    result = hs.simulate(paper.updated(SHORT | {"controller.law": law}), log_weights=True)
    assert result.weight_history is None


def test_no_history_where_the_systems_do_not_act(paper: hs.Scenario) -> None:
    off = hs.simulate(paper.updated(SHORT | {"controller.hybrid.fuzzy.enabled": False}), log_weights=True)
    assert off.weight_history is None
    hold = np.array([0, 0, -0.588, 0, 0, 0])
    sampled = paper.updated(SHORT | {"simulation.mode": "sampled"})
    assert hs.simulate(sampled, controller=lambda _: hold, log_weights=True).weight_history is None


def test_the_dataset_holds_it(paper: hs.Scenario, tmp_path: Path) -> None:
    result = hs.simulate(paper.updated({"simulation.duration": 0.05}), log_weights=True)
    dataset = result.to_xarray()
    history = dataset["weight_history"]
    assert history.dims == ("time", "wrench_component", "error_term", "rate_term")
    assert history.attrs["units"] == "N; N m"
    dataset.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as read:
        np.testing.assert_array_equal(read["weight_history"], result.weight_history)
    assert "weight_history" not in hs.simulate(paper.updated({"simulation.duration": 0.05})).to_xarray()


def test_the_limit_of_a_log_counts_the_weights(paper: hs.Scenario) -> None:
    """Two million samples are 0.75 GiB without the weights and 5.1 GiB with them: refused before it is allocated."""
    scenario = paper.updated({"simulation": {"duration": 2000.0, "step": 1e-3}})
    with pytest.raises(ValueError, match=r"^simulation.log_every: expected a log of at most 2 GiB \(log_every of 3 or"):
        hs.simulate(scenario, log_weights=True)
