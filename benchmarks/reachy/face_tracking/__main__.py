"""Entry of `make bench-reachy`: face tracking on the model of Reachy Mini's head, a table of medians (worst)."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from face_tracking import ours, table
from face_tracking.identified import prediction
from face_tracking.machine import MOTORS, PACKAGE, package_model
from face_tracking.picture import draw
from face_tracking.scene import CASES, Camera
from face_tracking.trial import run
from hexservo.run.machine import describe_machine

ROOT = Path(__file__).resolve().parents[3]
RATES, LIMITS = (10.0, 15.0, 30.0), (0.6, None)
LATENCIES = ("50", "100", "200", "scattered", "drawn", "unknown")
HELD_BACK = tuple(range(100, 120))  # seeds that no setting was chosen with
FOCAL_ERROR = 0.17


def _some(known: tuple[Any, ...], convert: Callable[[str], Any] = str) -> Callable[[str], list[Any]]:
    def read(text: str) -> list[Any]:
        found = [convert(word) for word in text.split(",")]
        for value in found:
            if value not in known:
                raise argparse.ArgumentTypeError(f"expected some of {', '.join(map(str, known))}, got {value}")
        return found

    return read


def _seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def _arguments() -> argparse.Namespace:
    laws = ("shipped", "fix", *ours.LAWS)
    parser = argparse.ArgumentParser(prog="make bench-reachy", description=__doc__)
    parser.add_argument("--laws", type=_some(laws), default=list(laws), help=",".join(laws))
    parser.add_argument("--cases", type=_some(tuple(CASES)), default=list(CASES), help=",".join(CASES))
    parser.add_argument("--motors", type=_some(tuple(MOTORS)), default=list(MOTORS), help=",".join(MOTORS))
    parser.add_argument("--rates", type=_some(RATES, float), default=list(RATES), help="10,15,30 [Hz]")
    parser.add_argument("--latencies", type=_some(LATENCIES), default=list(LATENCIES), help=",".join(LATENCIES))
    limit = _some(LIMITS, lambda word: None if word == "none" else float(word))
    parser.add_argument("--limits", type=limit, default=list(LIMITS), help="0.6,none [N m], of the cranks' motors")
    parser.add_argument("--seeds", type=_seeds, default=_seeds("0-4"), help="FIRST-LAST (0-4)")
    parser.add_argument("--focal-error", type=float, default=0.0, help="relative, of the assumed focal length (0)")
    parser.add_argument(
        "--trim", type=float, default=0.0, help="deg, pitch added to the published laws' aim (0; package: 15)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="15 Hz, unknown latency, 0.6 N m, motors shipped and freed"
    )
    parser.add_argument(
        "--wanted",
        action="store_true",
        help=f"all motors, {len(HELD_BACK)} held-back seeds, the same latencies with time of exposure, against limits",
    )
    parser.add_argument(
        "--own", action="store_true", help="hexservo's model of the head, also where the package is there"
    )
    parser.add_argument(
        "--no-identification", action="store_true", help="motors as the scenario reachy-mini has them, no log"
    )
    parser.add_argument(
        "--models", action="store_true", help="only print how well models of the motors predict a log of each"
    )
    parser.add_argument("--header", action="store_true", help="drive a trial with the compiled header of each law, too")
    parser.add_argument("--core", type=Path, help="libhexservo_core.a for --header; built if not given")
    parser.add_argument(
        "--package", type=Path, default=ROOT / "build" / "reachy", help="folder that the package is kept in"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "reachy")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--no-picture", action="store_true")
    given = parser.parse_args()
    if given.quick or given.wanted:
        given.rates, given.latencies, given.limits = [15.0], ["unknown"], [0.6]
    if given.wanted:
        given.latencies = ["unknown", "drawn"]
    if given.quick:
        given.motors = [name for name in ("shipped", "freed") if name in given.motors]
    if given.wanted:
        given.seeds = list(HELD_BACK)
    return given


def _plan(given: argparse.Namespace, folder: Path | None, found: table.Responses) -> list[table.Trial]:
    """Return all trials; the seeds of a row one after the other."""
    whole = not (given.quick or given.wanted) and given.focal_error == 0.0
    conditions = list(product(given.limits, given.rates, given.latencies, [given.focal_error]))
    if whole and {15.0} <= set(given.rates) and "unknown" in given.latencies and 0.6 in given.limits:
        conditions.append((0.6, 15.0, "unknown", FOCAL_ERROR))
    return [
        table.Trial(
            law, motors, case, rate, latency, limit, seed, focal, given.trim, folder, found.get((motors, limit), ())
        )
        for motors, (limit, rate, latency, focal) in product(given.motors, conditions)
        for case, law, seed in product(given.cases, given.laws, given.seeds)
        if latency != "drawn" or law in ours.LAWS  # to the published laws it is "unknown"
    ]


def _with_headers(given: argparse.Namespace, folder: Path | None) -> bool:
    """Close the loop with the exported program, and compare with `hs.Controller`; return whether it could be compiled.

    Without a compiler there is nothing to compare, which is no failure.
    """
    for law in ours.LAWS:
        if law not in given.laws:
            continue
        try:
            like = table.Trial(law, given.motors[0], "yaw", 15.0, "unknown", 0.6, given.seeds[0], folder=folder)
            scenario = table.scenario_of(like, Camera())
            program = ours.compiled(scenario, given.package / f"header-{law}", given.core)
        except OSError as error:
            print(f"The exported header was not compiled: {error}.")
            return True
        except subprocess.CalledProcessError as error:
            print(f"The exported header was not compiled: {error.cmd[0]} gave code {error.returncode}; see above.")
            return False
        exported = ours.ExportedController(program, scenario)
        found = run(table.head_of(like), exported, CASES["yaw"], Camera(), like.rate, like.latency, like.seed)
        exported.close()
        apart = np.abs(found.commands - table.record_of(like).commands).max()
        print(f"exported header, {law}: commands of a trial differ by at most {apart:.1e} rad from hs.Controller's")
    return True


def _print_models(given: argparse.Namespace, folder: Path | None) -> int:
    print("RMS of the predicted angles in the last 7 s of a log, which nothing was fitted to [deg]")
    print("motors   limit  response of each leg  six motors and the head  their kp, damping, armature, friction")
    for motors, limit in product(given.motors, given.limits):
        head = table.head_of(table.Trial("tracking", motors, "yaw", 15.0, "unknown", limit, 0, folder=folder))
        scenario, alone, together = prediction(head)
        motor = scenario.actuators.motor
        values = ", ".join(f"{value:.3g}" for value in (motor.kp, motor.damping, motor.armature, motor.friction))
        print(f"{motors:8}{limit or 'none':>6}{alone:22.2f}{together:25.2f}  {values}", flush=True)
    return 0


def main() -> int:
    """Run, print and write."""
    given = _arguments()
    folder: Path | None = None
    if not given.own:
        try:
            given.package.mkdir(parents=True, exist_ok=True)
            package_model(given.package)
            folder = given.package.resolve()
        except OSError as error:
            print(f"{PACKAGE} cannot be had ({error}): hexservo's own model of the head stands in for it.")
    if folder is None:
        given.motors = [name for name in given.motors if MOTORS[name].freed]
        print("hexservo's model of the head has no friction in its ball joints: without the motors `shipped`.")
    if given.models:
        return _print_models(given, folder)
    found: table.Responses = {}
    if not given.no_identification and set(given.laws) & set(ours.LAWS):
        found = table.responses(list(product(given.motors, given.limits)), folder, given.jobs)
        for (name, limit), keys in found.items():
            words = ", ".join(f"{key.removeprefix('actuators.')} {value}" for key, value in keys if value is not None)
            print(f"identified, motors {name}, limit {limit}: {words}")
    todo = _plan(given, folder, found)
    if not todo:
        print("There is nothing to run.", file=sys.stderr)
        return 2
    print(f"{len(todo)} trials; seeds {given.seeds[0]} to {given.seeds[-1]}; medians (worst)\n{table.heading()}")
    rows, began = [], time.monotonic()
    for row in table.medians(table.trials(todo, given.jobs)):
        rows.append(row)
        print(table.line(row), flush=True)
        if given.wanted and row.trial.law in ours.LAWS:
            print(
                *(f"    misses: {words}" for words in table.missed(row)),
                sep="\n",
                end="\n" if table.missed(row) else "",
            )
    given.out.mkdir(parents=True, exist_ok=True)
    about = {
        "machine": describe_machine(),
        "package": PACKAGE if folder else "hexservo's own model",
        "trials": len(todo),
    }
    table.write_csv(given.out / "reachy.csv", rows)
    table.write_json(given.out / "reachy.json", rows, about)
    if not given.no_picture:
        like = replace(todo[0], rate=15.0, latency="unknown", limit=0.6, focal_error=0.0)
        motors = [name for name in ("shipped", "freed") if name in given.motors] or given.motors
        draw(given.out / "reachy.png", given.laws, motors, given.cases, given.seeds[:5], like, found)
    print(f"{len(todo)} trials in {time.monotonic() - began:.0f} s; written: {given.out}")
    return 0 if not given.header or _with_headers(given, folder) else 1


if __name__ == "__main__":
    sys.exit(main())
