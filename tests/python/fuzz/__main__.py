"""``python -m fuzz``: every campaign for its share of the time, each with its seed and counts."""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

from fuzz.campaign import Findings, run
from fuzz.campaigns import CAMPAIGNS

_HUNG = 120.0  # [s], after which a trial is taken to hang: a trace of all threads, and the end


def main() -> int:
    """Run the campaigns and return the exit code: 1 where a trial failed."""
    parser = argparse.ArgumentParser(prog="fuzz", description="Random campaigns (docs/testing.md).")
    parser.add_argument("--seconds", type=float, default=60.0, help="for all campaigns together")
    parser.add_argument("--seed", type=int, default=None, help="default: drawn, and printed")
    parser.add_argument("--campaign", action="append", choices=[*CAMPAIGNS, "places"], help="default: all")
    parser.add_argument("--trial", type=int, default=None, help="this trial alone, as a failure named it")
    chosen = parser.parse_args()
    seed = int.from_bytes(os.urandom(4), "little") if chosen.seed is None else chosen.seed
    names = chosen.campaign or [*CAMPAIGNS, "places"]
    failed = 0
    print(f"seed {seed}, {chosen.seconds:g} s", flush=True)
    for name in names:
        seconds = chosen.seconds / len(names)
        with tempfile.TemporaryDirectory() as folder:
            if name == "places":
                failed += _places(Path(folder), seed, seconds)
                continue
            faulthandler.dump_traceback_later(seconds + _HUNG, exit=True)
            trials = {} if chosen.trial is None else {"first": chosen.trial, "trials": 1}
            findings = run(name, CAMPAIGNS[name], Path(folder), seed=seed, seconds=seconds, **trials)
            faulthandler.cancel_dump_traceback_later()
        print(findings, flush=True)
        failed += len(findings.failures)
        _print_failures(findings)
    return 1 if failed else 0


def _print_failures(findings: Findings) -> None:
    """Print a traceback for each place in the code where trials failed, and the numbers of all trials that did."""
    places: dict[tuple[str, int | None], list[int]] = {}
    errors = dict(findings.failures)
    for trial, error in findings.failures:
        last = traceback.extract_tb(error.__traceback__)[-1]
        places.setdefault((last.filename, last.lineno), []).append(trial)
    for trials in places.values():
        again = f"--campaign {findings.name} --seed {findings.seed} --trial {trials[0]}"
        print(f"\n{findings.name}, {len(trials)} failed: trials {', '.join(map(str, trials[:10]))} (again: {again})")
        traceback.print_exception(errors[trials[0]], file=sys.stdout)


def _places(folder: Path, seed: int, seconds: float) -> int:
    """Stop writing in a process without threads, which forks."""
    arguments = [sys.executable, "-m", "fuzz.places", str(folder), str(seed), str(10**9), str(seconds)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        print(f"places: seed {seed}: failed\n{done.stderr}")
        return 1
    found = json.loads(done.stdout)
    counts = ", ".join(f"{count} {what}" for what, count in found["seen"].items())
    print(f"places: seed {seed}, {found['trials']} trials, 0 failed: {counts}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
