"""Ctrl-C while a run is judged: no statement on runs that did not come to their own end, and nothing is written."""

from __future__ import annotations

import dataclasses
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import hexservo as hs
from hexservo.campaigns.engines import engine_of
from hexservo.cli import commands as cli
from hexservo.run.batch import BatchResult

simulate = hs.simulate  # as it is
simulate_batch = hs.simulate_batch


def stopped(*arguments: Any, **named: Any) -> hs.Result:
    """Simulate as if Ctrl-C came before the end."""
    return dataclasses.replace(simulate(*arguments, **named), outcome="interrupted")


def stopped_batch(*arguments: Any, **named: Any) -> BatchResult:
    """Run a batch as if Ctrl-C came before its last run ended."""
    batch = simulate_batch(*arguments, **named)
    outcome = batch.outcome.copy()
    outcome[-1] = "interrupted"
    return dataclasses.replace(batch, outcome=outcome)


@pytest.mark.parametrize("command", ["report", "certify", "diagnose"])
def test_a_run_that_the_user_stops_is_not_judged(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hs, "simulate", stopped)
    option = "--out" if command == "report" else "--json"
    arguments = [command, "paper", "--set", "simulation.duration=0.02", option, str(tmp_path / "written")]
    done = CliRunner().invoke(cli.app, arguments, prog_name="hexservo")
    assert (done.exit_code, done.stdout, done.stderr) == (130, "", "Interrupted: no further files were written\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("part", "module"), [("stiction", "analysis.stiction_runs"), ("largest_start", "analysis.settling_runs")]
)
def test_an_analysis_does_not_rest_on_runs_that_were_stopped(
    part: str, module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"hexservo.findings.{module}.simulate_batch", stopped_batch)
    with pytest.raises(KeyboardInterrupt):
        hs.analyse(hs.load_scenario("paper"), [part])


def test_a_border_is_not_judged_by_a_run_that_was_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexservo.findings.analysis.loop_of_scenario.simulate", stopped)
    with pytest.raises(KeyboardInterrupt):
        hs.analyse(hs.load_scenario("paper-composite"), ["camera_rate"])


def test_a_diagnosis_does_not_rest_on_runs_that_were_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    failing = hs.simulate(hs.load_scenario("fails-stiction"))
    monkeypatch.setattr("hexservo.findings.diagnosis.runs.simulate_batch", stopped_batch)
    with pytest.raises(KeyboardInterrupt):
        hs.diagnose(failing)


def test_ctrl_c_while_a_campaign_ends_waits_for_its_thread() -> None:
    """An interpreter that ends while the thread still computes ends with an abort."""
    begun, ended = threading.Event(), threading.Event()

    def compute() -> None:
        begun.set()
        for _ in range(2):
            time.sleep(0.05)
            os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
        ended.set()

    def campaign(store: Any) -> None:
        with engine_of("local", store, 1) as engine:
            engine.executor.submit(compute)
            begun.wait()

    with pytest.raises(KeyboardInterrupt):
        campaign(None)  # no chunk is computed
    assert ended.is_set()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
