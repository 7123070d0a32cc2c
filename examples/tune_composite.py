"""Find the gains of the law `composite` for a 30 Hz camera, and check a scenario against what was asked of them.

    python examples/tune_composite.py                        # searches, some minutes; out/composite-30hz.yaml
    python examples/tune_composite.py --check composite-30hz # a packaged scenario or a file: a table of all corners

The loop: frames every 33 ms that are 33 ms late, 0.2 px of noise, prediction by the encoders, a servo tick of 1 ms.
What is asked (`REQUIREMENTS` of corners.py) is asked of all 64 corners: both signs of the inertia's and Coriolis'
error, both of the gravity's, all sixteen sign patterns of the depth errors of the four points, each at its bound.

The search goes from the cheap to the dear:

1. Drift, in closed form. Of a pose error e the law estimates (J^T J + M)^-1 (J^T J_true + M) e, with the J that it
   has (docs/model.md, section 5). Where that matrix has an eigenvalue that is not positive, the loop drifts, which
   bounds the prior M from below. The search chooses M's proportions only; its size is the smallest that keeps all
   eigenvalues above `--eigenvalue` at 35 % of depth error.
2. Runs of 1 s without noise: settling, leg forces, stroke.
3. Runs with noise for the better half: RMS and settling, medians over seeds.

Stages 2 and 3 use the corners that were worst so far; the best gains are tried on all 64 every ten
generations, and new worst corners join. Candidates come from a CMA evolution strategy (Hansen, "The CMA evolution
strategy: a tutorial", 2016) on the logarithms of the gains. It makes the largest share of a limit that is used as small
as it can, so what it finds has a reserve everywhere. The same seed gives the same file on the same build of the core.

Exit codes: 0 done and everything met, 1 something is not met (with the amount), 2 bad input, 130 Ctrl-C. The file is
written whole or not at all, and only if everything is met.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

import hexservo as hs
from corners import (
    CORIOLIS,
    CORNERS,
    DRIFT_DEPTH,
    DURATION,
    GRAVITY,
    INERTIA,
    REQUIREMENTS,
    SEEDS,
    Array,
    Drift,
    Runs,
    check,
    poses_of_the_motion,
    run,
    table,
)
from evolution import evolve

HEADER = """\
# The predicting loop at 30 Hz: frames every 33 ms that are 33 ms late, 0.2 px of noise, features carried on by the
# encoders from frame to frame. The gains were found by examples/tune_composite.py, which also checks them on all
# corners of the model errors (docs/model.md, section 8). Keys that are not written here have their defaults, explained
# in paper.yaml.
"""

SCENARIO: dict[str, object] = {
    "name": "composite-30hz",
    "description": "A camera of 30 Hz, late and noisy, with the law composite tuned for all signs of the model errors",
    "camera": {"period": 0.033, "latency": 0.033, "noise": 0.2, "prediction": "encoder"},
    "target": {
        "initial_features": [30, 18, 65, -65, -44, 37, -10, -15],
        "desired_features": [10, 10, 45, -73, -64, 29, -30, -23],
    },
    "uncertainty": {"inertia": INERTIA, "coriolis": CORIOLIS, "gravity": GRAVITY, "depth": [0.3, -0.3, 0.3, 0.3]},
    "controller": {"law": "composite", "switching": {"kind": "implicit"}},
    "simulation": {"mode": "sampled", "step": 1.0e-3, "duration": DURATION},
}

# ---- The search -----------------------------------------------------------------------------------------------------

_BY_AXIS = np.array([0, 0, 1, 2, 2, 3])  # x and y share a gain, z has its own
_BY_KIND = np.array([0, 0, 0, 1, 1, 1])  # one gain for forces, one for moments


@dataclass(frozen=True)
class Searched:
    """A quantity of the search, with its start and its bounds; its logarithm is what varies."""

    start: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


# For x and y, z, about x and y, about z; or for forces, moments; or one.
SPACE = {
    "frequency": Searched((30, 30, 30, 30), (5, 5, 5, 5), (60, 60, 60, 60)),  # of K_t and the body [rad/s]
    "damping": Searched((1, 1, 1, 1), (0.3, 0.3, 0.3, 0.3), (3, 3, 3, 3)),  # of K_d, K_t and the body [1]
    "drive": Searched((10, 12), (2, 2), (40, 40)),  # Lambda [1/s]
    "learning": Searched((1, 3), (0.02, 0.02), (5, 5)),  # 1/(Psi K_t): the weights' stiffness over K_t [1]
    "error_scale": Searched((20, 10), (3, 1), (500, 200)),  # a [1/m; 1/rad]
    "rate_scale": Searched((1, 1), (0.01, 0.01), (30, 30)),  # b [s/m; s/rad]
    "friction": Searched((2e-3, 2e-3, 3e-5, 3e-5), (1e-5, 1e-5, 1e-6, 1e-6), (5e-3, 5e-3, 3e-4, 3e-4)),  # K_v
    "prior": Searched((1, 1, 1e-3, 1e-1), (0.1, 0.1, 1e-5, 1e-3), (10, 10, 1, 10)),  # M's proportions
    "kp": Searched((1e-10,), (1e-11,), (1e-8,)),
}
# Keys of the law's block that are found.
FOUND = ("kt", "kd", "drive", "prior", "kp", "kv", "fuzzy.adaptation", "fuzzy.error_scale", "fuzzy.rate_scale")
LOW: Array = np.log(np.concatenate([block.low for block in SPACE.values()]))
HIGH: Array = np.log(np.concatenate([block.high for block in SPACE.values()]))
START: Array = (np.log(np.concatenate([block.start for block in SPACE.values()])) - LOW) / (HIGH - LOW)


def gains_of(points: Array, body: Array, drift: Drift, eigenvalue: float) -> dict[str, Array]:
    """Turn points of the unit cube, (k, n), into gains by key, each (k, 6) or (k,).

    `body` is mass [kg] x3 and the principal inertia [kg m^2]; M has the size that drift asks for.
    """
    values = np.exp(LOW + (HIGH - LOW) * np.clip(points, 0, 1))
    ends = np.cumsum([len(block.start) for block in SPACE.values()])
    block = dict(zip(SPACE, np.split(values, ends[:-1], axis=1), strict=True))
    frequency = block["frequency"][:, _BY_AXIS]
    kt = body * frequency**2
    return {
        "kt": kt,
        "kd": 2 * block["damping"][:, _BY_AXIS] * body * frequency,
        "drive": block["drive"][:, _BY_KIND],
        "prior": np.array([drift.sized(prior, eigenvalue) for prior in block["prior"][:, _BY_AXIS]]),
        "kp": block["kp"][:, 0],
        "kv": block["friction"][:, _BY_AXIS],
        "fuzzy.adaptation": 1 / (block["learning"][:, _BY_KIND] * kt),
        "fuzzy.error_scale": block["error_scale"][:, _BY_KIND],
        "fuzzy.rate_scale": block["rate_scale"][:, _BY_KIND],
    }


@dataclass
class Search:
    """Cost of gains, on the corners that were worst so far."""

    scenario: hs.Scenario
    body: Array  # as `gains_of` has it
    drift: Drift
    eigenvalue: float
    threads: int | None
    seeds: Sequence[int]
    noisy_duration: float  # s
    corners: NDArray[np.int_]  # of all runs, rows of `CORNERS`
    noisy_corners: NDArray[np.int_]  # of those with noise

    def __call__(self, points: Array) -> Array:
        """Give the cost of points of the unit cube: stage 2 for all of them, stage 3 for the better half."""
        gains = gains_of(points, self.body, self.drift, self.eigenvalue)
        shares = self._shares(self._quiet(gains, CORNERS[self.corners]), noisy=False)
        costs = 10 + _cost(shares)  # those that see no noise come last
        better = np.argsort(costs, kind="stable")[: (len(points) + 1) // 2]
        runs = self._noisy({key: values[better] for key, values in gains.items()}, CORNERS[self.noisy_corners])
        costs[better] = _cost(np.column_stack([shares[better], self._shares(runs, noisy=True)]))
        return costs

    def admit(self, point: Array) -> bool:
        """Try gains on all corners; the worst of each quantity join. True where some are new."""
        before = len(self.corners) + len(self.noisy_corners)
        gains = gains_of(point[None], self.body, self.drift, self.eigenvalue)
        quiet, noisy = self._quiet(gains, CORNERS), self._noisy(gains, CORNERS)
        worst = [int(_settling(quiet)[0, :, 0].argmax())]
        worst += [int(quiet.metrics[name][0, :, 0].argmax()) for name in ("peak_leg_force", "peak_leg_excursion")]
        noisiest = int(noisy.median("rms_error", 99.0)[0].argmax())
        self.corners = np.union1d(self.corners, [*worst, noisiest])
        self.noisy_corners = np.union1d(self.noisy_corners, [worst[0], noisiest])
        return len(self.corners) + len(self.noisy_corners) > before

    def _quiet(self, gains: Mapping[str, Array], corners: Array) -> Runs:
        scenario = self.scenario.updated({"simulation.duration": 1.0, "camera.noise": 0.0})
        return run(scenario, corners, self.seeds[:1], self.threads, gains)

    def _noisy(self, gains: Mapping[str, Array], corners: Array) -> Runs:
        scenario = self.scenario.updated({"simulation.duration": self.noisy_duration})
        return run(scenario, corners, self.seeds, self.threads, gains)

    def _shares(self, runs: Runs, noisy: bool) -> Array:
        """Give the shares of the limits that the worst corner uses, a row for each candidate."""
        shares = [np.median(_settling(runs), axis=2).max(axis=1) / REQUIREMENTS["settling"].limit]
        if noisy:
            shares.append(runs.worst_median("rms_error", 99.0) / REQUIREMENTS["rms"].limit)
        shares.append(runs.worst("peak_leg_force", 99.0) / REQUIREMENTS["force"].limit)
        shares.append(1e3 * runs.worst("peak_leg_excursion", 9.0) / REQUIREMENTS["stroke"].limit)
        return np.column_stack(shares)


def _cost(shares: Array) -> Array:
    """Give nearly the largest share of a limit; the others count a little, so that they fall where they are free to."""
    return np.asarray((shares**8).sum(axis=1) ** (1 / 8))


def _settling(runs: Runs) -> Array:
    """Give settling times; beyond the run, and the later the larger the error, where a run has not settled."""
    left = 1 + np.minimum(np.nan_to_num(runs.metrics["final_error"], nan=100.0), 100.0) / 2
    times = runs.metrics["settling_time"]
    return np.where(runs.completed, np.where(np.isnan(times), left, times), 99.0)


def search(
    scenario: hs.Scenario, eigenvalue: float, seed: int, generations: int, threads: int | None
) -> dict[str, Array]:
    """Find gains: a wide search, then a narrow one with more noise; each (6,) or (), rounded to three digits.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    """
    random = np.random.default_rng(seed)
    drift = Drift(scenario, poses_of_the_motion(scenario), DRIFT_DEPTH)
    body = np.array([scenario.robot.mass] * 3 + list(scenario.robot.inertia))
    proportions = np.array(SPACE["prior"].start)[_BY_AXIS]
    for bound in (REQUIREMENTS["eigenvalue"].limit, eigenvalue):
        sized = drift.sized(proportions, bound)
        print(f"smallest eigenvalue {bound:g} asks for a prior of {sized[0]:.3g} px^2/m^2 (0.2 px against", end=" ")
        print(f"{1e3 * 0.2 / math.sqrt(sized[0]):.2f} mm), at the proportions of the start")

    # The eight of common depth errors to begin with; the first joins those with noise.
    common = np.array([row for row, signs in enumerate(CORNERS) if len(set(signs[2:])) == 1])
    seeds = range(SEEDS[-1] + 1, SEEDS[-1] + 6)  # none that the check uses
    worst = Search(scenario, body, drift, eigenvalue, threads, seeds[:3], 2.0, common, common[:1])
    worst.admit(START)
    begun = time.monotonic()

    def progress(name: str) -> Callable[[int, float, Array], bool]:
        def after(generation: int, lowest: float, best: Array) -> bool:
            if generation % 10 != 9:
                return False
            changed = worst.admit(best)
            used = f"{100 * lowest:.1f} %" if lowest < 10 else "more than all"
            print(
                f"{name} generation {generation + 1:4d}: {used} of the limits used, {len(worst.corners)} corners,"
                f" {len(worst.noisy_corners)} of them with noise, {time.monotonic() - begun:.0f} s",
                flush=True,
            )
            return changed

        return after

    best = evolve(worst, START, 0.1, generations, random, progress("wide"))
    worst.seeds, worst.noisy_duration = seeds, 3.0
    best = evolve(worst, best, 0.01, max(1, generations // 4), random, progress("narrow"))
    gains = gains_of(best[None], body, drift, eigenvalue)
    return {key: _rounded(np.asarray(values[0])) for key, values in gains.items()}


def _rounded(values: Array) -> Array:
    """Round to three significant digits."""
    return np.array([float(f"{value:.3g}") for value in values.flat]).reshape(values.shape)


# ---- Files and the command line -------------------------------------------------------------------------------------


def scenario_text(gains: Mapping[str, Array]) -> str:
    """Write the scenario with these gains as YAML."""
    composite: dict[str, object] = {}
    for key, values in gains.items():
        plain = values.tolist()
        if key.startswith("fuzzy."):
            fuzzy = composite.setdefault("fuzzy", {})
            assert isinstance(fuzzy, dict)
            fuzzy[key.removeprefix("fuzzy.")] = plain
        else:
            composite[key] = plain
    controller = SCENARIO["controller"]
    assert isinstance(controller, dict)
    whole = {**SCENARIO, "controller": {**controller, "composite": composite}}
    return HEADER + yaml.safe_dump(whole, sort_keys=False, default_flow_style=None, width=110)


def loaded(text: str) -> hs.Scenario:
    """Load a scenario from its text."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scenario.yaml")
        file.write_text(text, encoding="utf-8")
        return hs.load_scenario(file)


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Search and write, or check."""
    parser = argparse.ArgumentParser(description="Gains of the law composite for a camera of 30 Hz")
    parser.add_argument("--check", metavar="SCENARIO", help="check a packaged scenario or a file, and search nothing")
    parser.add_argument("--output", type=Path, default=Path("out/composite-30hz.yaml"), help="%(default)s")
    parser.add_argument("--force", action="store_true", help="replace an output that is there")
    parser.add_argument("--seed", type=int, default=1, help="of the search (%(default)s)")
    parser.add_argument("--generations", type=int, default=120, help="of the wide search (%(default)s)")
    parser.add_argument(
        "--eigenvalue", type=float, default=0.15, help="that the prior is sized for (%(default)s, at least 0.05)"
    )
    parser.add_argument("--threads", type=int, help="of the batches (as many as there are cores)")
    given = parser.parse_args(arguments)
    if given.seed < 0:
        parser.error(f"--seed: expected a whole number of at least 0, got {given.seed}")
    if given.generations < 1:
        parser.error(f"--generations: expected a whole number of at least 1, got {given.generations}")
    if not REQUIREMENTS["eigenvalue"].limit <= given.eigenvalue < 1:
        parser.error(f"--eigenvalue: expected a number from 0.05 to 1, got {given.eigenvalue:g}")
    if given.threads is not None and given.threads < 1:
        parser.error(f"--threads: expected a whole number of at least 1, got {given.threads}")
    if given.check is None and given.output.exists() and not given.force:
        parser.error(f"--output: {given.output} is there; --force replaces it")
    bar = sys.stderr.isatty()
    try:
        if given.check is not None:
            report = check(hs.load_scenario(given.check), given.threads, bar)
            print(table(report))
            return 1 if report.unmet else 0
        print(f"seed {given.seed}")
        base = loaded(scenario_text({}))
        text = scenario_text(search(base, given.eigenvalue, given.seed, given.generations, given.threads))
        report = check(loaded(text), given.threads, bar)
        print(f"\n{text}\n{table(report)}")
        if report.unmet:
            print(f"not written: {', '.join(report.unmet)} not met", file=sys.stderr)
            return 1
        write_whole(given.output, text)
        print(f"written: {given.output}")
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
