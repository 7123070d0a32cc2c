"""The theorem's assumption over a batch, against settling."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.certificate import batch as module
from hexservo.findings.certificate.batch import BatchCertificate
from hexservo.findings.evidence import Table

SHORT: dict[str, Any] = {"simulation.duration": 0.3}


def made(settling: list[float], margins: list[float], undecided: tuple[int, ...] = ()) -> BatchCertificate:
    """Runs of which all is known, or nothing where the margin is NaN, or one axis is not decided."""
    margin = np.tile(np.array(margins)[:, None], (1, 6))
    decided = np.isfinite(margin)
    decided[list(undecided), 2] = False
    margin[list(undecided), 2] = -1e-3
    outcome = np.where(np.isnan(margins), "interrupted", "completed")
    return BatchCertificate(
        hs.load_scenario("paper"),
        {},
        outcome,
        np.array(settling),
        np.where(np.isnan(margin), np.nan, 1.0),
        margin,
        margin >= 0.0,
        decided,
    )


def test_runs_are_counted_by_assumption_and_settling() -> None:
    nan = float("nan")
    certificate = made([0.3, nan, 0.2, nan, nan, 0.4, nan], [1e-3, 1e-3, -1e-3, -1e-3, -1e-3, 0.0, nan])
    np.testing.assert_array_equal(certificate.counts, [[2, 1], [1, 2], [0, 0]])
    section = certificate.section()
    assert section.sentences[0] == (
        "The assumption held in 3 of 6 runs (50.0%), and 3 settled (50.0%): 2 of those where it held, "
        "and 1 of the 3 where it did not."
    )
    assert section.sentences[1] == "1 of 7 variations were not run and are not counted."
    json.dumps(certificate.to_dict(), allow_nan=False)


def test_undecided_runs_give_a_range() -> None:
    """What one axis leaves open is decided by another on which the assumption did not hold."""
    nan = float("nan")
    certificate = made([0.3, 0.2, nan, nan, nan, nan], [1e-3, 1e-3, 1e-3, -1e-3, -1e-3, nan], undecided=(1, 2, 3))
    np.testing.assert_array_equal(certificate.counts, [[1, 0], [0, 2], [1, 1]])
    section = certificate.section()
    assert section.sentences[0] == (
        "The assumption held in 1 to 3 of 5 runs (20.0% to 60.0%), and 2 settled (40.0%): 1 of those where it held, "
        "0 of the 2 where it did not, and 1 of the 2 where it is undecided."
    )
    assert section.sentences[1].startswith("2 of 5 runs are undecided")
    assert section.sentences[2] == "1 of 6 variations were not run and are not counted."
    both, axes = section.items
    assert isinstance(both, Table)
    assert isinstance(axes, Table)
    assert [list(row[:3]) for row in both.rows] == [["held", 1, 0], ["did not hold", 0, 2], ["undecided", 1, 1]]
    assert [row[2] for row in axes.rows] == [0, 0, 3, 0, 0, 0]
    json.dumps(certificate.to_dict(), allow_nan=False)


def test_bounds_of_an_unsolved_program_decide_where_k_v_is_outside(
    paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without any solution eta_Delta is between 0 and the largest Delta-tau: a k_v above it holds all the same."""
    failed = SimpleNamespace(status=4, message="numbers too hard")
    monkeypatch.setattr("scipy.optimize.linprog", lambda *args, **options: failed)
    scenario = paper.updated({"simulation.duration": 0.05})
    kv = np.array([[1e-3] * 6, [10.0] * 6, [10.0] * 5 + [1e-9]])
    batch = hs.certify_batch(scenario, {"controller.hybrid.kv": kv})
    assert batch.held.tolist() == [False, True, False]
    assert batch.decided.tolist() == [False, True, False]
    np.testing.assert_array_equal(batch.counts.sum(axis=1), [1, 0, 2])
    single = hs.certify(hs.simulate(scenario.updated({"controller.hybrid.kv": kv[2].tolist()})))
    assert single.assumption is not None
    assert single.assumption.decided.tolist() == [True] * 5 + [False]
    lyapunov, assumption, _ = single.sections()
    assert "open" not in (lyapunov.verdict, assumption.verdict)
    assert assumption.sentences[0].endswith(
        "held on 5 of 6 axes at the samples of this run, and is undecided on moment z."
    )
    assert sum("was not solved to its end" in sentence for sentence in assumption.sentences) == 6
    assert sum("is inside, which leaves it open" in sentence for sentence in assumption.sentences) == 1


def test_a_batch_is_its_single_runs(paper: hs.Scenario) -> None:
    scenario = paper.updated(SHORT)
    kv = np.array([2e-3] * 3 + [1e-4] * 3) * np.array([[1.0], [4.0]])
    depth = np.array([[0.3, 0.3, 0.3, 0.3], [0.1, -0.2, 0.1, 0.0]])
    batch = hs.certify_batch(scenario, {"controller.hybrid.kv": kv, "uncertainty.depth": depth})
    assert len(batch) == 2
    for index in range(2):
        varied = scenario.updated(
            {"controller.hybrid.kv": kv[index].tolist(), "uncertainty.depth": depth[index].tolist()}
        )
        result = hs.simulate(varied)
        single = hs.certify(result).assumption
        assert single is not None
        np.testing.assert_allclose(batch.eta[index], single.eta, rtol=3e-6, atol=1e-12)
        np.testing.assert_allclose(batch.margin[index], kv[index] - batch.eta[index])
        assert bool(batch.held[index]) == bool(single.held.all())
        np.testing.assert_equal(batch.settling_time[index], hs.metrics(result)["settling_time"])
        assert batch.outcome[index] == result.outcome
    assert batch.held.tolist() == [False, True]  # four times k_v is enough about y


def test_rounding_breaks_no_assumption(paper: hs.Scenario) -> None:
    """K_v = 0 about z, where nothing is uncertain: what is left of Delta-tau there is rounding, as for one run."""
    exact = dict.fromkeys(("inertia", "coriolis", "gravity", "depth"), 0.0)
    kv = [2e-3, 2e-3, 2e-3, 1e-4, 1e-4, 0.0]
    scenario = paper.updated(
        {
            "simulation.duration": 0.05,
            "uncertainty": exact,
            "controller.hybrid": {"kv": kv, "fuzzy": {"enabled": False}},
        }
    )
    single = hs.certify(hs.simulate(scenario)).assumption
    assert single is not None
    assert single.margin[5] < 0.0
    assert single.held.all()
    batch = hs.certify_batch(scenario, {"uncertainty.gravity": [0.0]})
    np.testing.assert_array_equal(batch.held_by_axis, [single.held])
    assert batch.held.tolist() == [True]
    axes = batch.section().items[1]
    assert isinstance(axes, Table)
    assert [row[1] for row in axes.rows] == [1] * 6


def test_progress_is_reported_after_every_run(paper: hs.Scenario, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[tuple[int, int]] = []
    variations = {"uncertainty.gravity": np.array([0.0, 0.01])}
    hs.certify_batch(paper.updated({"simulation.duration": 0.05}), variations, lambda *done: seen.append(done))
    assert seen == [(1, 2), (2, 2)]
    hs.certify_batch(paper.updated({"simulation.duration": 0.05}), variations, progress=True)
    assert "runs certified" in capsys.readouterr().err


def test_ctrl_c_keeps_what_is_finished(paper: hs.Scenario) -> None:
    def stop(done: int, count: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    batch = hs.certify_batch(
        paper.updated({"simulation.duration": 0.05}), {"uncertainty.gravity": np.zeros(4)}, progress=stop
    )
    assert batch.outcome.tolist() == ["completed", "completed", "interrupted", "interrupted"]
    np.testing.assert_array_equal(batch.finished, [True, True, False, False])
    assert batch.counts.sum() == 2


def test_a_run_whose_uncertainty_cannot_be_computed_is_undecided(
    paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*args: Any, **options: Any) -> None:
        raise ArithmeticError("too large")

    monkeypatch.setattr(module, "uncertainty_of", fails)
    batch = hs.certify_batch(paper.updated({"simulation.duration": 0.05}), {"uncertainty.gravity": np.zeros(2)})
    assert batch.finished.all()
    np.testing.assert_array_equal(batch.counts.sum(axis=1), [0, 0, 2])
    section = batch.section()
    assert section.sentences[0].startswith("The assumption held in 0 to 2 of 2 runs (0.0% to 100.0%)")
    json.dumps(batch.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("changes", "variations", "words"),
    [
        (
            {"controller.law": "composite"},
            {"uncertainty.gravity": [0.0]},
            "controller.law: expected hybrid, .*composite",
        ),
        (
            {"simulation.mode": "sampled", "controller.switching.kind": "implicit"},
            {"uncertainty.gravity": [0.0]},
            "simulation.mode: expected continuous",
        ),
        ({}, {"uncertainty.gravit": [0.0]}, "uncertainty.gravit: unknown key"),
        ({}, {}, "variations: expected at least one key"),
    ],
)
def test_bad_batches_are_refused(
    paper: hs.Scenario, changes: dict[str, Any], variations: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        hs.certify_batch(paper.updated(changes), variations)


@pytest.mark.parametrize(
    ("payload", "variations", "words"),
    [
        ({"known": False}, {"robot.payload.mass": [0.0, 0.01]}, "scenario 1: .* a payload that the controller"),
        (
            {},
            {"robot.centre_of_mass": [[0.0, 0.0, 0.0], [0.0, 0.0, 1e-3]], "robot.inertia": [np.diag([2e-4] * 3)] * 2},
            "scenario 1: .* centre of mass",
        ),
    ],
)
def test_a_varied_body_that_has_no_certificate_is_refused(
    paper: hs.Scenario, payload: dict[str, Any], variations: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        hs.certify_batch(paper.updated({**SHORT, "robot.payload": payload}), variations)


def test_other_types_are_refused(paper: hs.Scenario) -> None:
    with pytest.raises(TypeError, match="scenario: expected a Scenario"):
        hs.certify_batch("paper", {})  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="progress: expected True"):
        hs.certify_batch(paper, {"uncertainty.gravity": [0.0]}, progress=3)  # type: ignore[arg-type]
