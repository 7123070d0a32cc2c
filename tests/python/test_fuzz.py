"""The random campaigns of `fuzz` with few trials each; `make fuzz` runs them for as long as asked (docs/testing.md)."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import traceback
from pathlib import Path

import numpy as np
import pytest

import hexservo as hs
from fuzz.batches import differ, endings, in_a_batch, nudged, single
from fuzz.campaign import generator, run
from fuzz.campaigns import CAMPAIGNS
from fuzz.places import SUBJECTS, Subject, interrupted_at, lines_of, without_exchange
from fuzz.scenarios import draw, inclusive_bounds, rules

SEED = 20261122
TRIALS = {
    "runs": 60,
    "certify": 15,
    "analyse": 12,
    "diagnose": 10,
    "batch": 16,
    "ticks": 40,
    "results": 250,
    "special": 60,
}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_finds_nothing(name: str, tmp_path: Path) -> None:
    findings = run(name, CAMPAIGNS[name], tmp_path, seed=SEED, trials=TRIALS[name])
    for trial, error in findings.failures:
        print(f"{name}, trial {trial}: python -m fuzz --campaign {name} --seed {SEED} --trial {trial}")
        traceback.print_exception(error, file=sys.stdout)
    assert not findings.failures
    assert findings.seen["refused"] < TRIALS[name] / 2, findings  # what is refused tries nothing
    assert len(findings.seen) > 1, findings


def test_writing_is_killed_at_any_moment(tmp_path: Path) -> None:
    """In a separate process, which may fork: whatever the moment, old or new stands there, whole."""
    done = subprocess.run(
        [sys.executable, "-m", "fuzz.places", str(tmp_path), str(SEED), "100", "60"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["trials"] >= 10
    assert any(end.startswith("killed") and "left-overs" in end for end in found["seen"]), found


# A file that was being read is closed when it is collected, which Python warns of.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("has_exchange", [True, False])
@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_writing_is_interrupted_at_lines_all_over(
    subject: Subject, has_exchange: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = lines_of(subject, tmp_path / "out")
    assert lines > 50
    seen = set()
    for line in range(1, lines, 5):
        if has_exchange:
            seen.add(interrupted_at(subject, tmp_path / "out", line))
        else:
            with without_exchange():
                seen.add(interrupted_at(subject, tmp_path / "out", line))
    assert {"old", "new"} <= {end.split()[0] for end in seen}, seen


# ---- What the generator covers --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_scenarios_with_every_key_and_at_every_bound_are_drawn_and_accepted() -> None:
    """A key that is added to the schema is drawn too, or this fails."""
    # the largest seed as it is: its float is one more
    bounds = {(key, float(bound)): bound for key, rule in rules().items() for bound in inclusive_bounds(rule)}
    changed: set[str] = set()
    accepted = 0
    for trial in range(1500):
        drawn = draw(generator("coverage", SEED, trial))
        if drawn.scenario is not None:
            accepted += 1
            changed |= set(drawn.changes)
            for key, bound in drawn.at_bounds:
                bounds.pop((key, float(bound)), None)
    assert accepted > 300
    assert set(rules()) - changed <= {"base_motion.file", "target.motion.file"}  # which the campaign "special" draws
    for (key, _), bound in sorted(bounds.items()):  # what chance left out, asked for by name
        tries = (draw(generator(f"{key} {bound}", SEED, trial), at=(key, bound)) for trial in range(60))
        assert any(drawn.scenario is not None for drawn in tries), (key, bound)


# ---- What the campaign of batches rests on --------------------------------------------------------------------------


@pytest.mark.slow
def test_a_difference_that_rounding_does_not_explain_is_noticed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A lane whose depth error is wrong by 1e-6 is a defect, and found within few trials."""

    def wrong(scenario: hs.Scenario) -> object:
        errors = np.broadcast_to(scenario.uncertainty.depth, 4) * (1 + 1e-6) + 1e-7
        return in_a_batch(scenario.updated({"uncertainty.depth": errors.tolist()}))

    monkeypatch.setattr("fuzz.batches.in_a_batch", wrong)
    findings = run("batch", CAMPAIGNS["batch"], tmp_path, seed=SEED, trials=12)
    assert any(isinstance(error, AssertionError) for _, error in findings.failures), findings


def test_a_moment_that_is_zero_but_for_rounding_gets_its_sign_from_it() -> None:
    """The pair of docs/batch.md: with `sign`, single run and lane leave rest about z in opposite senses."""
    scenario = hs.load_scenario("badly-spread-features").updated(
        {"controller.law": "composite", "simulation.duration": 1e-3}
    )
    alone, lane = single(scenario), in_a_batch(scenario)
    others = [single(nudged(scenario, seed)) for seed in range(12)]
    states = [alone, lane, *others]
    start = hs.simulate(scenario).wrench[0]
    assert abs(start[5]) < 1e-15 < abs(start[3])  # exactly zero, were there no rounding
    spin = np.array([state.state[-1] for state in states])
    assert np.allclose(np.abs(spin), abs(spin[0]), rtol=1e-3)
    assert {math.copysign(1, value) for value in spin} == {-1.0, 1.0}
    smooth = scenario.updated({"controller.switching": {"kind": "tanh", "width": 1e-3}})
    assert not any(differ(single(smooth), ending) for name, ending in endings(smooth).items() if "moved" not in name)
