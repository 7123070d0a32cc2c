"""Largest starting error, camera period and latency that still settle, found by runs.

Empirical throughout (docs/analysis/largest_start.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.largest_times import Timing, camera_times
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.reach import nearest_limit
from hexservo.findings.analysis.scene import AT_HOME, WIDER, Scene, scene_of
from hexservo.findings.analysis.settling_runs import SettlingRuns, Tried, border, first_overload
from hexservo.findings.analysis.tried import ROUNDS
from hexservo.findings.part import Part
from hexservo.run.goal_distance import inexact
from hexservo.run.leg_limits import LimitUse
from hexservo.scenario.arrays import Array
from hexservo.scenario.keys import value_at
from hexservo.scenario.noise import is_random
from hexservo.scenario.pixels import points_outside, to_pixels
from hexservo.scenario.scenario import Scenario

_GRID = 8  # sizes in the first round, up to the largest that is possible


@dataclass(frozen=True, eq=False)
class Direction:
    """Goals along one direction from home."""

    name: str
    unit: Array  # (6,) displacement from home at size 1 [m; rad], in B
    largest: float  # size up to which goals were possible
    # stroke | base_joint | platform_joint | singularity | view | image | region: that searched | core, which refuses
    # a larger one
    limited_by: str
    tried: Tried  # by size
    settling: dict[float, float]  # [s], of those that settled
    settles_later: bool | None  # whether the smallest that fails settles in a longer run; None where there was none
    # By size, of those that fail for a limit of the legs alone: the image error settles, or the run was stopped there
    beyond: dict[float, LimitUse]
    error: float  # [px], largest |xi_d - xi| at the start for the size `settles_to`, NaN for none
    overloads: dict[float, LimitUse]  # by size, of those that settle with forces beyond the legs' limit
    reseeded: tuple[bool, ...]  # whether `fails_at` settles with each of some other seeds; empty: nothing is random

    @property
    def settles_to(self) -> float:
        """Largest size below which everything that was tried settles; 0 where nothing does."""
        return border(self.tried)[0]

    @property
    def fails_at(self) -> float | None:
        """Smallest size that was seen to fail; None where none was."""
        return border(self.tried)[1]

    @property
    def beyond_limits(self) -> float | None:
        """Smallest size whose image error settles with a leg beyond a limit on the way; None where none was seen."""
        return min(self.beyond, default=None)

    @property
    def overloaded_from(self) -> float | None:
        """Smallest size that settles with forces beyond the legs' limit, up to `settles_to`; None where none does."""
        return first_overload(self.overloads, self.settles_to)

    @property
    def settles_again(self) -> bool:
        """Whether a larger size than the smallest that fails settles: the border is not the only one."""
        failed = self.fails_at
        return failed is not None and any(good for size, good in self.tried.items() if size > failed)


@dataclass(frozen=True, eq=False, repr=False)
class LargestStart(Part):
    """Sizes and times that were run, and the largest ones that settle."""

    law: str
    open_because: str  # empty where the analysis applies
    directions: tuple[Direction, ...] = ()  # the task's own first; those along which a goal is possible
    timings: tuple[Timing, ...] = ()
    duration: float = 0.0  # [s], of most runs
    longer: float = 0.0  # [s], of those of the smallest sizes and times that fail; 0: there were none
    task_duration: float = 0.0  # [s], of the longest run of the task itself, where it does not settle
    is_cut: bool = False  # whether this is less than the scenario's own, so that a slow task may settle yet
    runs: int = 0
    starts_at_goal: bool = False  # home has the goal image, within `inexact`
    home_error: float = 0.0  # [px], largest |xi_d - xi| at home
    goal_error: float = 0.0  # [px], the same at the pose of least image error
    own_limit: str = ""  # as `limited_by`, where the goal image has a pose but no goal on the way to it is possible
    band: float = 0.0  # [px], of settling
    dwell: float = 0.0  # [s], how long a run must have been within the band at its end
    assumed: str = ""  # what the runs with camera times assume beside the scenario
    from_home: bool = False  # the scenario's own start is not home at rest, from which all runs start
    durations: Mapping[float, int] = field(default_factory=dict)  # number of runs of each duration [s]
    is_random: bool = False  # a longer run may leave the band again by noise, outliers or lost frames
    whole_duration: float = 0.0  # [s], of the longest run of the task itself, from home: as a rule the scenario's own
    whole_settling: float = np.nan  # [s], its settling time; NaN: it does not settle
    whole_beyond: LimitUse | None = None  # the limit of the legs for which alone it does not

    @property
    def own(self) -> Direction | None:
        """The direction of the task's own goal."""
        return self.directions[0] if self.directions and self.directions[0].name == "own" else None


def analyse(scenario: Scenario) -> LargestStart:
    """Find by runs the largest starting error and the slowest camera that settle (docs/analysis/largest_start.md).

    Runs batches of the scenario: start at home, goals along ways from home.

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    law = scenario.controller.law
    if scenario.camera.convention == "as_printed":
        return LargestStart(law, "A camera as_printed has no points in space, so goals have no pose: not tried.")
    scene = scene_of(scenario)
    trial = SettlingRuns(scenario)
    goals = find_goals(scene)
    assert goals is not None  # as the camera has points
    at_goal = bool(scene.residual(scene.home) <= inexact(scene.band))
    directions, own_limit = _directions(
        scene, trial, goals.best.displacement if goals.reachable and not at_goal else None
    )
    timings, assumed = camera_times(scenario, trial) if trial.task_settles else ((), "")
    later = [*(way.settles_later for way in directions), *(timing.settles_later for timing in timings)]
    longer = trial.longer if any(settles is not None for settles in later) else 0.0
    measured = scenario.metrics
    return LargestStart(
        law,
        "",
        directions,
        timings,
        trial.duration,
        longer,
        trial.task_duration,
        trial.is_cut,
        trial.runs,
        at_goal,
        float(scene.residual(scene.home)),
        goals.best.largest_residual,
        own_limit,
        measured.band,
        measured.dwell,
        assumed,
        any(np.any(np.asarray(value_at(scenario, key))) for key in AT_HOME),
        dict(sorted(trial.durations.items())),
        is_random(scenario),
        trial.whole_duration,
        trial.whole_settling,
        trial.whole_beyond,
    )


# ---- Starting errors ------------------------------------------------------------------------------------------------


def _directions(scene: Scene, trial: SettlingRuns, own: Array | None) -> tuple[tuple[Direction, ...], str]:
    """Try goals along the task's own way, if it has one, the axes and the rotations, all in one batch per round.

    Ways along which no goal is possible are left out; also return what limits the task's own if it is among them.
    """
    ways = [
        Direction(
            name,
            unit,
            *_largest(scene, unit),
            tried={},
            settling={},
            settles_later=None,
            beyond={},
            error=np.nan,
            overloads={},
            reseeded=(),
        )
        for name, unit in _units(scene, own)
    ]
    own_limit = "".join(way.limited_by for way in ways if way.name == "own" and way.largest == 0.0)
    ways = [way for way in ways if way.largest > 0.0]

    def run(sizes: Callable[[Direction], list[float]]) -> None:
        rows = [(i, size) for i, way in enumerate(ways) for size in sizes(way) if size not in way.tried]
        if not rows:
            return
        moves = np.array([size * ways[i].unit for i, size in rows])
        ends = trial.ends({"target.desired_features": scene.pixels(scene.home.moved(moves))})
        for k, (i, size) in enumerate(rows):
            way = ways[i]
            if not ends.ran[k]:
                ways[i] = replace(way, largest=min(way.largest, size), limited_by="core")
                continue
            way.tried[size] = bool(ends.settled[k])
            if (use := ends.beyond[k]) is not None:
                way.beyond[size] = use
            if (more := ends.overloads[k]) is not None:
                way.overloads[size] = more
            if ends.settled[k]:
                way.settling[size] = float(ends.times[k])

    def grid(way: Direction) -> list[float]:
        sizes = [way.largest * k / _GRID for k in range(1, _GRID + 1)]
        return [*sizes, 1.0] if way.name == "own" and way.largest >= 1.0 else sizes

    def halfway(way: Direction) -> list[float]:
        low, high = border(way.tried)
        return [] if high is None else [low + part * (high - low) for part in (0.25, 0.5, 0.75)]

    def between(way: Direction) -> list[float]:
        """Return sizes halfway between those of the grid, below the border: a smaller one may fail."""
        high = border(way.tried)[1] or way.largest
        return [size for k in range(_GRID) if (size := way.largest * (k + 0.5) / _GRID) < high]

    run(grid)
    run(between)
    for _ in range(ROUNDS):
        run(halfway)
    found = [replace(way, error=_error(scene, way)) for way in _repeated(scene, trial, ways)]
    return tuple(found), own_limit


def _repeated(scene: Scene, trial: SettlingRuns, ways: list[Direction]) -> list[Direction]:
    """Run the smallest sizes that fail for longer, since they may only be slow, and with other seeds."""
    failed = [border(way.tried)[1] for way in ways]
    rows = [i for i, size in enumerate(failed) if size is not None]
    if not rows:
        return ways
    moves = np.array([(failed[i] or 0.0) * ways[i].unit for i in rows])
    goals = {"target.desired_features": scene.pixels(scene.home.moved(moves))}
    later: list[bool | None] = [None] * len(rows)
    if trial.duration < trial.longer:
        later = trial.ends(goals, trial.longest()).settled.tolist()
    found = list(ways)
    for i, settles, reseeded in zip(rows, later, trial.reseeded(goals), strict=True):
        found[i] = replace(ways[i], settles_later=settles, reseeded=reseeded)
    return found


def _units(scene: Scene, own: Array | None) -> list[tuple[str, Array]]:
    units = [] if own is None else [("own", own)]
    for j in range(6):
        for sign, value in (("+", 1.0), ("-", -1.0)):
            unit = np.zeros(6)
            unit[j] = value
            units.append((f"{'shift' if j < 3 else 'turn'} {sign}{'xyz'[j % 3]}", unit))
    return [(name, unit) for name, unit in units if np.abs(unit / scene.unit).max() > 1e-9]


def _largest(scene: Scene, unit: Array) -> tuple[float, str]:
    """Return the largest size along a direction that is reachable, in view, image and region, and what limits it.

    Every pose on the way to it is reachable and seen as well, on a grid.
    """
    farthest = WIDER * scene.unit
    farthest[3:] = np.pi  # one turn at a time may be larger
    most = float(1.0 / (np.abs(unit) / farthest).max())
    low, limit = 0.0, "region"
    for _ in range(2):  # the grid, then refined inside the cell that has the border
        sizes = np.linspace(low, most, 201)[1:]
        there = scene.home.moved(sizes[:, None] * unit)
        features = scene.image(there)[0]
        seen = np.asarray(np.isfinite(to_pixels(scene.scenario, features)).all(axis=1))
        inside = np.asarray(~points_outside(scene.scenario, features).any(axis=1))
        good = seen & inside & scene.reachable(there)
        if good.all():
            return float(sizes[-1]), limit
        first = int(np.argmin(good))
        limit = "view" if not seen[first] else _leg_limit(scene, there[first]) if inside[first] else "image"
        low, most = float(sizes[first - 1]) if first else low, float(sizes[first])
    return low, limit


def _leg_limit(scene: Scene, pose: Poses) -> str:
    """Return why the legs do not reach a pose."""
    nearest = nearest_limit(scene, pose)
    return "singularity" if nearest.within else nearest.limit


def _error(scene: Scene, way: Direction) -> float:
    """Return the largest |xi_d - xi| [px] at the start for the size `settles_to`, NaN for none."""
    if way.settles_to == 0.0:
        return float("nan")
    goal = scene.home.moved(way.settles_to * way.unit)
    return float(np.abs(scene.image(goal)[0] - scene.image(scene.home)[0]).max())
