"""Sentences of evidence beside the signals that they are about: a wrong sign, legs at their limit, numbers of runs."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.analysis import settling_runs
from hexservo.findings.diagnosis.evidence import Signature, signature_of
from hexservo.findings.diagnosis.model import Case
from hexservo.findings.diagnosis.ranking import judged
from hexservo.findings.diagnosis.runs import record_of


def signature(result: hs.Result, cause: str) -> Signature:
    """Return the signature of a cause in a run."""
    record = record_of(result)
    return signature_of(cause, Case(result.scenario, None), record, judged(result.scenario, record))


def sign_at(bandwidth: float, sign: str = "flip") -> hs.Result:
    """Run `composite` slowly, with the wrong sign of the image Jacobian or the right one."""
    changes = {"controller.law": "composite", "controller.composite.auto.bandwidth": bandwidth}
    base = hs.load_scenario("fails-wrong-sign" if sign == "flip" else "paper")
    return hs.simulate(base.updated({**changes, "simulation.duration": 2.0}))


def test_a_slow_rise_by_a_wrong_sign_is_weak_evidence_for_it() -> None:
    """At 0.05 Hz the error rises from the first sample to the last, by less than half in 2 s."""
    result = sign_at(0.05)
    error = np.abs(result.feature_error).max(axis=1)
    assert (np.diff(error) > -1e-9).all()
    rise = float(error.max() / error[0] - 1.0)
    found = signature(result, "wrong_sign")
    assert found.strength == pytest.approx(rise / 0.5, rel=0.02)
    assert found.sentence == f"The error never decreases, but rises by only {rise:.0%}: it is 20 px at the start."
    faster = signature(sign_at(0.2), "wrong_sign")
    assert faster.strength == 1.0
    assert faster.sentence.startswith("The error never decreases: 20 px at the start")


def test_an_error_that_decreases_is_stated_with_its_least_value() -> None:
    result = sign_at(1.0, "right")
    error = np.abs(result.feature_error).max(axis=1)
    found = signature(result, "wrong_sign")
    assert found.strength == 0.0
    start, least, at = (
        float(number)
        for number in re.findall(r"from (\S+) px at the start to (\S+) px at t = (\S+) s", found.sentence)[0]
    )
    assert start == pytest.approx(error[0], rel=1e-2)
    assert least == pytest.approx(error.min(), rel=1e-2)
    assert at == pytest.approx(result.time[error.argmin()], rel=1e-2)


def test_a_limit_that_is_reached_between_the_samples_is_reached() -> None:
    """The legs are at 95 % of their peak for four of 5001 steps, and the samples are 501 of these."""
    free = hs.load_scenario("composite-30hz")
    peak = hs.metrics(hs.simulate(free))["peak_leg_force"]

    def limited(share: float) -> tuple[float, str, hs.Result]:
        """Return the share of samples with a leg at its limit, the sentence, and the run with a log of every step."""
        changes = {"actuators.saturation": True, "robot.force_limit": share * peak, "simulation.log_every": 1}
        run = hs.simulate(free.updated(changes))
        forces = np.abs(record_of(run).samples["leg_forces"]).max(axis=1)
        return float((forces >= 0.999 * share * peak).mean()), signature(run, "saturation").sentence, run

    at_limit, sentence, run = limited(0.95)
    assert at_limit == 0.0
    assert 0 < (np.abs(run.leg_forces).max(axis=1) >= 0.999 * 0.95 * peak).sum() < 10
    assert sentence.startswith("A leg reaches its force limit of ")
    assert sentence.endswith(f", but in none of the {len(record_of(run).time)} samples.")
    at_limit, sentence, _ = limited(0.7)
    assert 0.0 < at_limit < 0.2
    assert sentence.startswith("A leg is at its force limit of ")
    assert sentence.endswith(f" in {100.0 * at_limit:.2g}% of the samples.")
    at_limit, sentence, _ = limited(2.0)
    assert at_limit == 0.0
    assert sentence.startswith("No leg reaches its force limit of ")


def test_runs_are_counted_by_their_duration(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted where they are started: sizes that fail are repeated for longer."""
    started: Counter[float] = Counter()

    def counted(base: hs.Scenario, *arguments: Any, **options: Any) -> Any:
        batch = hs.simulate_batch(base, *arguments, **options)
        started[base.simulation.duration] += len(batch)
        return batch

    monkeypatch.setattr(settling_runs, "simulate_batch", counted)
    found = hs.analyse(hs.load_scenario("paper"), ["largest_start"]).largest_start
    assert found is not None
    assert len(started) == 2
    assert found.durations == started
    stated = re.search(
        r"All of this is from (\d+) runs \((\d+) of (\S+) s and (\d+) of (\S+) s\)", found.section().sentences[-1]
    )
    assert stated is not None
    total, *each = (float(number) for number in stated.groups())
    assert total == started.total()
    assert {each[1]: each[0], each[3]: each[2]} == dict(started)
