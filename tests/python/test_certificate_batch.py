"""The theorem's assumption over a batch, against settling."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.certificate import batch as module
from hexservo.findings.certificate.batch import BatchCertificate
from hexservo.findings.evidence import Table

SHORT: dict[str, Any] = {"simulation.duration": 0.3}


def made(settling: list[float], margins: list[float]) -> BatchCertificate:
    """Runs of which all is known, or nothing where the margin is NaN."""
    margin = np.tile(np.array(margins)[:, None], (1, 6))
    outcome = np.where(np.isnan(margins), "interrupted", "completed")
    return BatchCertificate(
        hs.load_scenario("paper"),
        {},
        outcome,
        np.array(settling),
        np.where(np.isnan(margin), np.nan, 1.0),
        margin,
        margin >= 0.0,
    )


def test_runs_are_counted_by_assumption_and_settling() -> None:
    nan = float("nan")
    certificate = made([0.3, nan, 0.2, nan, nan, 0.4, nan], [1e-3, 1e-3, -1e-3, -1e-3, -1e-3, 0.0, nan])
    np.testing.assert_array_equal(certificate.counts, [[2, 1], [1, 2]])
    section = certificate.section()
    assert section.sentences[0] == (
        "The assumption held in 3 of 6 runs (50.0%), and 3 settled (50.0%): 2 of those where it held, "
        "and 1 of the 3 where it did not."
    )
    assert section.sentences[1].startswith("1 of 7 runs have no verdict")
    json.dumps(certificate.to_dict(), allow_nan=False)


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


def test_a_run_without_best_weights_has_no_verdict(paper: hs.Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*args: Any, **options: Any) -> None:
        raise ArithmeticError("too hard")

    monkeypatch.setattr(module, "assumption_of", fails)
    batch = hs.certify_batch(paper.updated({"simulation.duration": 0.05}), {"uncertainty.gravity": np.zeros(2)})
    assert not batch.finished.any()
    assert batch.counts.sum() == 0
    assert batch.section().sentences[0].startswith("No run was finished")


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
