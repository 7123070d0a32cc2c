"""What is asked of the law `composite` at 30 Hz, and whether a scenario does it: all corners of the model errors.

    python examples/corners.py composite-30hz               # a packaged scenario or a file: a table of all corners
    python examples/corners.py composite-30hz --prior 0.15  # its prior, scaled to this smallest eigenvalue

What is asked (`REQUIREMENTS`) is asked of all 64 corners: both signs of the inertia's and Coriolis' error, both of the
gravity's, all sixteen sign patterns of the depth errors of the four points, each at its bound. Gains are searched by
`hexservo tune examples/tune-composite-30hz.yaml`; the table is computed without anything of the search.

Drift, in closed form: of a pose error e the law estimates (J^T J + M)^-1 (J^T J_true + M) e, with the J that it has
(docs/model.md, section 5). Where that matrix has an eigenvalue that is not positive, a loop with equal gains drifts,
which bounds the prior M from below; with unequal gains the rates of docs/analysis/drift.md decide.

Exit codes: 0 everything is met, 1 something is not met (with the amount), 2 bad input, 130 Ctrl-C.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import hexservo as hs
from hexservo import _core  # for the image Jacobian, of which there is one copy

Array: TypeAlias = NDArray[np.float64]

# ---- What is asked --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Requirement:
    """A limit for the worst corner."""

    what: str
    limit: float  # in the unit
    unit: str
    scale: float = 1.0  # unit per SI unit
    at_least: bool = False

    def share(self, value: float) -> float:
        """Return a value relative to its limit: up to 1 it is met; infinite where the value is not a number."""
        shown = value * self.scale
        if self.at_least:
            return self.limit / shown if shown > 0 else math.inf
        return math.inf if math.isnan(shown) else shown / self.limit


REQUIREMENTS = {
    "settling": Requirement("settling time without noise", 0.20, "s"),
    "noisy_settling": Requirement("settling time, median of 20 seeds", 0.20, "s"),
    "rms": Requirement("RMS error from 1 s on, median of 20 seeds", 0.12, "px"),
    "force": Requirement("leg force", 0.6, "N"),
    "stroke": Requirement("leg stroke", 17.0, "mm", 1e3),
    "long_stroke": Requirement("leg stroke in 300 s", 17.0, "mm", 1e3),
    "eigenvalue": Requirement("smallest eigenvalue at 35 % of depth error", 0.05, "1", at_least=True),
}

# Signs of: inertia and Coriolis, gravity, the depth errors of the four points. The eight combinations with a common
# depth error are among them.
CORNERS: Array = np.array(list(itertools.product((1.0, -1.0), repeat=6)))
PATTERNS: Array = np.array(list(itertools.product((1.0, -1.0), repeat=4)))
INERTIA, CORIOLIS, GRAVITY, DEPTH = 0.075, 0.125, 0.075, 0.3  # bounds of the paper, and of gravity
DRIFT_DEPTH = 0.35
SEEDS = tuple(range(20))
DURATION, LONG_DURATION = 5.0, 300.0  # s

# ---- Runs of many corners and seeds ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Runs:
    """Metrics by name, each (corners, seeds); NaN and infinity as the core gives them."""

    metrics: Mapping[str, Array]
    completed: NDArray[np.bool_]
    batch: hs.BatchResult

    def median(self, name: str, otherwise: float = math.nan) -> Array:
        """Give the median over the seeds, (corners,); `otherwise` for runs without a value, or not completed."""
        values = self.metrics[name]
        return np.asarray(np.median(np.where(self.completed & ~np.isnan(values), values, otherwise), axis=1))


def run(
    scenario: hs.Scenario,
    corners: Array,
    seeds: Sequence[int],
    threads: int | None,
    trajectories: bool = False,
    bar: bool = False,
) -> Runs:
    """Run a scenario at every corner with every seed, in one batch.

    Parameters
    ----------
    scenario
        What is varied; its duration and noise are used as they are.
    corners
        (n, 6), rows of `CORNERS`.
    seeds
        Of the noise.

    Raises
    ------
    KeyboardInterrupt
        Where Ctrl-C ended the batch.
    """
    corner, seed = (index.ravel() for index in np.meshgrid(range(len(corners)), range(len(seeds)), indexing="ij"))
    signs = corners[corner]
    variations = {
        "seed": np.array(seeds, dtype=float)[seed],
        "uncertainty.inertia": INERTIA * signs[:, 0],
        "uncertainty.coriolis": CORIOLIS * signs[:, 0],
        "uncertainty.gravity": GRAVITY * signs[:, 1],
        "uncertainty.depth": DEPTH * signs[:, 2:],
    }
    batch = hs.simulate_batch(
        scenario, variations, log="trajectory" if trajectories else "metrics", threads=threads, progress=bar
    )
    if (batch.outcome == "interrupted").any():
        raise KeyboardInterrupt
    shape = (len(corners), len(seeds))
    metrics = {name: values.reshape(shape) for name, values in batch.metrics.items()}
    return Runs(metrics, (batch.outcome == "completed").reshape(shape), batch)


# ---- Drift, in closed form ------------------------------------------------------------------------------------------


class Drift:
    """Smallest real part of the eigenvalues of (J^T J + M)^-1 (J^T J_true + M) over poses and depth patterns."""

    def __init__(self, scenario: hs.Scenario, poses: Sequence[tuple[Array, Array]], depth_error: float) -> None:
        """Take all sixteen patterns of that error at poses (position in B [m], quaternion)."""
        camera, points = _camera(scenario), _points(scenario)
        believed, mixed = [], []
        for position, quaternion in poses:
            features, depth = _core.take_image(camera, position, quaternion, points)
            true = _core.image_jacobian(camera, features, depth, quaternion)
            for pattern in PATTERNS:
                J = _core.image_jacobian(camera, features, depth * (1 + depth_error * pattern), quaternion)
                believed.append(J.T @ J)
                mixed.append(J.T @ true)
        self._believed, self._mixed = np.array(believed), np.array(mixed)
        self._critical = np.zeros(0, dtype=int)  # pairs that were the worst for some prior

    def smallest(self, prior: Array) -> float:
        """Give the smallest real part for diag(prior)."""
        return float(self._real_parts(prior, np.arange(len(self._believed))).min())

    def sized(self, prior: Array, eigenvalue: float) -> Array:
        """Scale a prior until its smallest real part is the given one, to 0.1 % of the scale.

        Raises
        ------
        ValueError
            Where no scale up to 1e9 reaches it.
        """
        while True:
            scale = self._scale(prior, eigenvalue)
            parts = self._real_parts(scale * prior, np.arange(len(self._believed)))
            worst = int(parts.argmin())
            if worst in self._critical or parts[worst] >= eigenvalue:
                return scale * prior
            self._critical = np.append(self._critical, worst)

    def _scale(self, prior: Array, eigenvalue: float) -> float:
        """Bisect on the critical pairs."""
        low, high = 1e-9, 1e9
        if len(self._critical) == 0:
            return low
        if self._real_parts(high * prior, self._critical).min() < eigenvalue:
            raise ValueError(f"eigenvalue: expected one that some prior reaches, got {eigenvalue:g}")
        while high / low > 1.001:
            middle = math.sqrt(low * high)
            if self._real_parts(middle * prior, self._critical).min() < eigenvalue:
                low = middle
            else:
                high = middle
        return high

    def _real_parts(self, prior: Array, pairs: NDArray[np.int_]) -> Array:
        M = np.diag(prior)
        parts = np.linalg.eigvals(np.linalg.solve(self._believed[pairs] + M, self._mixed[pairs] + M)).real
        return np.asarray(parts.min(axis=1))


def _camera(scenario: hs.Scenario) -> _core.Camera:
    camera = _core.Camera()
    camera.focal_length, camera.pixel_scale = scenario.camera.focal_length, scenario.camera.pixel_scale
    return camera


def _points(scenario: hs.Scenario) -> Array:
    """Give the four points in B [m], back-projected from home."""
    if scenario.target.points is not None:
        return np.array(scenario.target.points, dtype=float)
    z = -np.broadcast_to(np.asarray(scenario.target.depth, dtype=float), (4,))
    features = np.reshape(scenario.target.initial_features or (), (4, 2))
    in_camera = np.column_stack([-features * z[:, None] / _camera(scenario).focal_pixels, z])
    return np.asarray(in_camera + np.array(scenario.robot.home_position))


def _quaternion(rotation: Array) -> Array:
    """Give the unit quaternion of a rotation vector [rad]."""
    angle = float(np.linalg.norm(rotation))
    return np.array([math.cos(angle / 2), *(np.sinc(angle / (2 * np.pi)) / 2 * rotation)])


def _turned(rotation: Array, quaternion: Array) -> Array:
    """Turn an attitude by a rotation vector in B [rad]."""
    turn = _quaternion(rotation)
    a, u, b, v = turn[0], turn[1:], quaternion[0], quaternion[1:]
    return np.array([a * b - u @ v, *(a * v + b * u + np.cross(u, v))])


def _way(scenario: hs.Scenario, columns: slice) -> tuple[Array, Array]:
    """Give translation [m] and rotation vector [rad] from home to the goal, with some components of the twist only."""
    camera, points = _camera(scenario), _points(scenario)
    home = np.array(scenario.robot.home_position)
    way = np.zeros(6)
    for _ in range(10):  # Gauss-Newton; the attitude is small, so that rotation vectors add up
        quaternion = _quaternion(way[3:])
        features, depth = _core.take_image(camera, home + way[:3], quaternion, points)
        J = _core.image_jacobian(camera, features, depth, quaternion)[:, columns]
        way[columns] += np.linalg.lstsq(J, np.array(scenario.target.desired_features) - features, rcond=None)[0]
    return way[:3], way[3:]


def poses_of_the_motion(scenario: hs.Scenario) -> list[tuple[Array, Array]]:
    """Give poses from home to the goal and 40 % beyond, the goal being reached by rotation, translation or between."""
    home = np.array(scenario.robot.home_position)
    (translation, _), (_, rotation) = _way(scenario, slice(0, 3)), _way(scenario, slice(3, 6))
    return [
        (home + way * part * translation, _quaternion(way * (1 - part) * rotation))
        for way in np.linspace(0.0, 1.4, 8)
        for part in np.linspace(0.0, 1.0, 5)
    ]


# ---- Check of one scenario ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Report:
    """What a scenario does in all corners, SI units and pixels. NaN: some run did not settle or did not complete."""

    worst: Mapping[str, float]  # by the names of `REQUIREMENTS`
    corners: Mapping[str, Array]  # by the same names, each (64,), in the order of `CORNERS`

    @property
    def unmet(self) -> list[str]:
        """Names of the requirements that are not met."""
        return [name for name, rule in REQUIREMENTS.items() if not rule.share(self.worst[name]) <= 1]


def check(scenario: hs.Scenario, threads: int | None = None, bar: bool = False) -> Report:
    """Measure what is asked on all corners, with nothing taken over from the search but the list of what is asked.

    Raises
    ------
    ValueError
        For another law, another mode or another duration than those of the task.
    KeyboardInterrupt
        On Ctrl-C.
    """
    for key, expected, got in (
        ("controller.law", "composite", scenario.controller.law),
        ("simulation.mode", "sampled", scenario.simulation.mode),
        ("simulation.duration", DURATION, scenario.simulation.duration),
    ):
        if got != expected:
            raise ValueError(f"{key}: expected {expected}, got {got}")
    quiet = run(
        scenario.updated({"camera.noise": 0.0, "simulation.log_every": 10}),
        CORNERS,
        SEEDS[:1],
        threads,
        trajectories=True,
    )
    noisy = run(scenario, CORNERS, SEEDS, threads, bar=bar)
    long = run(scenario.updated({"simulation.duration": LONG_DURATION}), CORNERS, SEEDS[:1], threads, bar=bar)
    corners = {
        "settling": quiet.median("settling_time"),
        "noisy_settling": noisy.median("settling_time", math.inf),
        "rms": noisy.median("rms_error"),
        "force": _worst_seed("peak_leg_force", quiet, noisy, long),
        "stroke": _worst_seed("peak_leg_excursion", quiet, noisy),
        "long_stroke": _worst_seed("peak_leg_excursion", long),
    }
    worst = {name: float(values.max()) for name, values in corners.items()}
    drift = Drift(scenario, poses_of_the_motion(scenario) + _visited(quiet), DRIFT_DEPTH)
    prior = np.broadcast_to(np.asarray(scenario.controller.composite.prior, dtype=float), (6,))
    worst["eigenvalue"] = drift.smallest(prior)
    return Report(worst, corners)


def _worst_seed(name: str, *runs: Runs) -> Array:
    """Give the largest value of each corner over seeds and runs; NaN where one of them did not complete."""
    largest = [np.where(r.completed, r.metrics[name], math.nan).max(axis=1) for r in runs]
    return np.asarray(np.max(largest, axis=0))


def _visited(runs: Runs) -> list[tuple[Array, Array]]:
    """Give poses of all corners: of the motion, of the rest, and around where they end by 5 mm and 10 mrad."""
    positions, quaternions = runs.batch.samples["position"], runs.batch.samples["quaternion"]
    poses = []
    for run_positions, run_quaternions in zip(positions, quaternions, strict=True):
        good = np.isfinite(run_positions).all(axis=1)  # of a run that stopped early, what it reached
        way = list(zip(run_positions[good], run_quaternions[good], strict=True))
        poses += way[:30:2] + way[30::90]  # every 20 ms of the first 0.3 s, then every 0.9 s
        position, quaternion = way[-1]
        for step in (1.0, -1.0):
            poses += [(position + 5e-3 * step * axis, quaternion) for axis in np.eye(3)]
            poses += [(position, _turned(1e-2 * step * axis, quaternion)) for axis in np.eye(3)]
    return poses


def table(report: Report) -> str:
    """Write a report as text: a row for each corner, then the worst values beside their limits."""
    sign = {1.0: "+", -1.0: "-"}
    names = list(report.corners)
    lines = ["inertia  gravity  depth  " + "  ".join(f"{name:>14}" for name in names)]
    for row, signs in enumerate(CORNERS):
        depth = "".join(sign[s] for s in signs[2:])
        values = (report.corners[name][row] * REQUIREMENTS[name].scale for name in names)
        cells = "  ".join(f"{value:14.4f}" for value in values)
        lines.append(f"{sign[signs[0]]:>7}  {sign[signs[1]]:>7}  {depth:>5}  {cells}")
    lines += ["", f"{'worst of all corners':45}  {'value':>8}  {'limit':>8}  unit  used"]
    for name, rule in REQUIREMENTS.items():
        share = rule.share(report.worst[name])
        verdict = f"{100 * share:.0f} %" + ("" if share <= 1 else "  NOT MET")
        value = report.worst[name] * rule.scale
        lines.append(f"{rule.what:45}  {value:8.4f}  {rule.limit:8g}  {rule.unit:4}  {verdict}")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Check a scenario, or size its prior."""
    parser = argparse.ArgumentParser(description="What the law composite does at all corners of the model errors")
    parser.add_argument("scenario", help="a packaged scenario, or a file")
    parser.add_argument("--prior", type=float, metavar="EIGENVALUE", help="size the prior, and check nothing")
    parser.add_argument("--threads", type=int, help="of the batches (as many as there are cores)")
    given = parser.parse_args(arguments)
    if given.prior is not None and not 0 < given.prior < 1:
        parser.error(f"--prior: expected a number above 0 and below 1, got {given.prior:g}")
    if given.threads is not None and given.threads < 1:
        parser.error(f"--threads: expected a whole number of at least 1, got {given.threads}")
    try:
        scenario = hs.load_scenario(given.scenario)
        if given.prior is not None:
            drift = Drift(scenario, poses_of_the_motion(scenario), DRIFT_DEPTH)
            prior = np.broadcast_to(np.asarray(scenario.controller.composite.prior, dtype=float), (6,))
            print("prior: [" + ", ".join(f"{value:.4g}" for value in drift.sized(prior, given.prior)) + "]")
            return 0
        report = check(scenario, given.threads, sys.stderr.isatty())
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    print(table(report))
    return 1 if report.unmet else 0


if __name__ == "__main__":
    sys.exit(main())
