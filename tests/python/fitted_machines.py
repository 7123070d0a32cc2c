"""How alike random machines settle with fitted gains, in units of 1/bandwidth.

    python tests/python/fitted_machines.py --machines 1000
    python tests/python/fitted_machines.py --machines 1000 --off-centre 0.2 --laws pbvs,composite

print the tables of docs/gains.md, of bodies whose centre of mass is E's origin and is off it. Machines, targets and
starts are drawn with a fixed seed; the images of start and goal are projected here, by the pinhole equation alone.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hexservo as hs
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.check_gains import of_gains
from hexservo.scenario.laws import LAWS, laws_with

Array = NDArray[np.float64]

SEED = 20261122
STARTS = ("pointing", "pose")
MODES = ("continuous", "sampled")
BAND = 0.05  # of the largest feature error at the start: the platform has settled within it
AWAY = 0.03  # start from the goal: in rad, and of the distance to the target
STEPS = 100  # per 1/bandwidth: steps, and in sampled mode servo periods
TOLERANCE = 0.25
# Periods of the bandwidth that a run has. The last two have slow motions, or none but friction to damp them.
PERIODS = {"hybrid": 20, "kelly": 20}
NO_LIMIT = 1e12  # [N]
NO_STROKE = 10.0  # [m], that no leg leaves: settling is measured, not reach


@dataclass(frozen=True, eq=False)
class Machines:
    """Random machines, one per row; lengths in m, masses in kg, features in px."""

    mass: Array  # (n,)
    inertia: Array  # (n, 3, 3) about E's origin
    centre: Array  # (n, 3) of mass, in E
    radius: Array  # (n,) of the platform's joints
    home: Array  # (n, 3)
    focal: Array  # (n,) [px]
    depth: Array  # (n, 4)
    initial: Array  # (n, 8)
    desired: Array  # (n, 8)
    bandwidth: Array  # (n,) [Hz]


def rotation(vector: Array) -> Array:
    """Return the matrix of a rotation vector, by Rodrigues."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / max(angle, 1e-300)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def image(focal: float, points: Array, position: Array, attitude: Array) -> Array:
    """Return the features (8,) of points (4, 3) in B: a camera that looks along -z of E."""
    seen = (points - position) @ attitude
    return np.asarray((-focal * seen[:, :2] / seen[:, 2:]).ravel())


def draw(count: int, start: str, seed: int = SEED, off_centre: float = 0.0) -> Machines:
    """Draw machines from 60 g to 5 t, cameras 0.1 to 5 m from the target, bandwidths of 0.2 to 20 Hz.

    The centre of mass is `off_centre` platform radii from E's origin, any way; the rest does not depend on it.
    """
    random, ways = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    rows = [_one(random, start) for _ in range(count)]
    for row in rows:
        way = ways.normal(size=3)
        centre = off_centre * row["radius"] * way / np.linalg.norm(way)
        row["centre"] = centre
        row["inertia"] = row["inertia"] + row["mass"] * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return Machines(*(np.array([row[name] for row in rows]) for name in Machines.__dataclass_fields__))


def _one(random: np.random.Generator, start: str) -> dict[str, Any]:
    def log(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    mass, distance, focal = log(0.06, 5000.0), log(0.1, 5.0), log(400.0, 2000.0)
    radius = (mass / 60.0) ** (1 / 3) * random.uniform(0.7, 1.4)  # 0.1 m at 60 g, as the preset micro
    # Principal moments: of x, of y relative to it, of z within the triangle's inequality; axes off by 0.15 rad (sigma).
    x = mass * (radius * random.uniform(0.35, 0.7)) ** 2
    y = x * random.uniform(0.6, 1.6)
    z = abs(x - y) + 2.0 * min(x, y) * random.uniform(0.4, 1.0)
    axes = rotation(random.normal(size=3) * 0.15)
    # A quadrangle of 0.05 to 0.3 focal lengths around a centre within 0.1 of the axis, nearly square to it.
    angles = random.uniform(0.0, 2.0 * np.pi) + np.arange(4) * np.pi / 2 + random.uniform(-0.3, 0.3, 4)
    sizes = random.uniform(0.05, 0.3) * random.uniform(0.8, 1.2, 4)
    places = np.column_stack([np.cos(angles), np.sin(angles)]) * sizes[:, None] + random.uniform(-0.1, 0.1, 2)
    depth = distance * random.uniform(0.95, 1.05, 4)
    home = np.array([0.0, 0.0, -1.5 * radius])
    points = home + np.column_stack([places * depth[:, None], -depth])
    if start == "pointing":
        way = random.uniform(0.0, 2.0 * np.pi)
        shift, turn = np.zeros(3), AWAY * np.array([np.cos(way), np.sin(way), 0.0])
    else:
        direction = random.normal(size=6)
        shift, turn = np.split(AWAY * direction / np.linalg.norm(direction), 2)
    return {
        "mass": mass,
        "inertia": axes @ np.diag([x, y, z]) @ axes.T,
        "radius": radius,
        "home": home,
        "focal": focal,
        "depth": depth,
        "initial": image(focal, points, home, np.eye(3)),
        "desired": image(focal, points, home + shift * distance, rotation(turn)),
        "bandwidth": log(0.2, 20.0),
    }


def scenario_of(law: str, machines: Machines, mode: str) -> hs.Scenario:
    """Return what the machines have in common."""
    switching = "implicit_coupled" if mode == "sampled" else "sign"
    return hs.Scenario.from_mapping(
        {
            "name": "drawn",
            "robot": {"preset": "micro", "force_limit": NO_LIMIT, "stroke": NO_STROKE},
            "target": {
                "initial_features": machines.initial[0],
                "desired_features": machines.desired[0],
                "depth": machines.depth[0],
            },
            "controller": {
                "law": law,
                law: {"auto": {"bandwidth": 1.0}},
                "switching": {"kind": switching if law in laws_with("switching") else "sign"},
            },
            "simulation": {"mode": mode},
        }
    )


def variations(law: str, machines: Machines) -> dict[str, Array]:
    """Return in what they differ, by dotted key."""
    periods = 1.0 / machines.bandwidth
    return {
        "robot.mass": machines.mass,
        "robot.inertia": machines.inertia,
        "robot.centre_of_mass": machines.centre,
        "robot.platform_radius": machines.radius,
        "robot.base_radius": 2.0 * machines.radius,
        "robot.home_position": machines.home,
        "camera.pixel_scale": machines.focal / 0.008,
        "target.initial_features": machines.initial,
        "target.desired_features": machines.desired,
        "target.depth": machines.depth,
        f"controller.{law}.auto.bandwidth": machines.bandwidth,
        "simulation.step": periods / STEPS,
        "simulation.duration": PERIODS.get(law, 3) * periods,
        "metrics.band": BAND * np.abs(machines.desired - machines.initial).max(axis=1),
        "metrics.dwell": 0.2 * periods,
    }


def settled(law: str, machines: Machines, mode: str) -> Array:
    """Return when each machine has settled, in units of 1/bandwidth, (n,); NaN where it has not."""
    batch = hs.simulate_batch(scenario_of(law, machines, mode), variations(law, machines), log="metrics")
    return np.asarray(batch.metrics["settling_time"] * machines.bandwidth)


def warned(law: str, machines: Machines) -> NDArray[np.bool_]:
    """Return of which machines `hexservo check` warns, before any run, (n,)."""
    base, varied = scenario_of(law, machines, "continuous"), variations(law, machines)
    scenarios = (
        base.updated({key: values[index].tolist() for key, values in varied.items()})
        for index in range(len(machines.mass))
    )
    return np.array([any(of_gains(scene_of(scenario))) for scenario in scenarios])


@dataclass(frozen=True)
class Row:
    """What was found for one law, start and mode."""

    law: str
    start: str
    mode: str
    times: Array  # in units of 1/bandwidth
    warned: NDArray[np.bool_]

    @property
    def median(self) -> float:
        """Of those without a warning that settle; NaN where there are none."""
        times = self.times[~self.warned & np.isfinite(self.times)]
        return float(np.median(times)) if len(times) else np.nan

    def alike(self, which: NDArray[np.bool_] | None = None) -> float:
        """Return the share of machines that settle within `TOLERANCE` of the median of those without a warning.

        NaN where there is no machine or no median.
        """
        times = self.times if which is None else self.times[which]
        if not len(times) or np.isnan(self.median):
            return np.nan
        return float(np.mean(np.abs(times / self.median - 1.0) <= TOLERANCE))

    def line(self) -> str:
        """Return its line of the table; "none" stands for what no machine has."""
        settled = self.times[np.isfinite(self.times)]
        span = f"{settled.min():.2f} … {settled.max():.2f}" if len(settled) else "none"
        shares = (float(np.isnan(self.times).mean()), self.alike(), float(self.warned.mean()), self.alike(~self.warned))
        cells = [f"`{self.law}`", self.start, self.mode, _or_none(self.median, "{:.2f}"), span]
        return f"| {' | '.join([*cells, *(_or_none(100 * share, '{:.1f} %') for share in shares)])} |"


def _or_none(value: float, shape: str) -> str:
    return "none" if np.isnan(value) else shape.format(value)


def row(law: str, start: str, mode: str, machines: Machines, warnings: NDArray[np.bool_]) -> Row:
    """Run machines that were drawn."""
    return Row(law, start, mode, settled(law, machines, mode), warnings)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=1000)
    parser.add_argument("--off-centre", type=float, default=0.0, help="of the centre of mass, in platform radii")
    parser.add_argument("--laws", default=",".join(LAWS))
    asked = parser.parse_args()
    print(f"{asked.machines} machines, seed {SEED}")
    print("| law | start | mode | median | all | not settled | within 25 % | warned of | others within 25 % |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for law in asked.laws.split(","):
        for start in STARTS:
            machines = draw(asked.machines, start, off_centre=asked.off_centre)
            warnings = warned(law, machines)
            for mode in MODES:
                print(row(law, start, mode, machines, warnings).line(), flush=True)


if __name__ == "__main__":
    main()
