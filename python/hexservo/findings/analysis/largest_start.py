"""Largest starting error, camera period and latency that still settle, found by runs.

Empirical throughout (docs/analysis/largest_start.md).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from hexservo.findings.analysis.goal import find_goals
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.reach import nearest_limit
from hexservo.findings.analysis.scene import AT_HOME, WIDER, Scene, scene_of
from hexservo.findings.analysis.tried import ROUNDS, bordering, outwards, quarters
from hexservo.findings.part import Part
from hexservo.run.batch import metrics_of, simulate_batch, whole
from hexservo.run.goal_distance import inexact
from hexservo.run.leg_limits import LimitUse, most_used, overload
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.keys import value_at
from hexservo.scenario.laws import LAWS, laws_with
from hexservo.scenario.noise import is_random
from hexservo.scenario.parameters import frame_period, timeout_room
from hexservo.scenario.scenario import Scenario

_SHORT, _LONG = 2.0, 10.0  # [s], of a run, and of one where the task itself needs longer
_GRID = 8  # sizes in the first round, up to the largest that is possible
_SEEDS = 4  # with which the first time that fails is repeated where runs are random
_TICKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 200, 300, 500)  # periods and latencies of the first round


Tried: TypeAlias = dict[float, bool]
"""Size or time -> whether it settled."""


@dataclass(frozen=True, eq=False)
class Direction:
    """Goals along one direction from home."""

    name: str
    unit: Array  # (6,) displacement from home at size 1 [m; rad], in B
    largest: float  # size up to which goals were possible
    # stroke | base_joint | platform_joint | singularity | view | the region searched | the core, which refuses a larger
    limited_by: str
    tried: Tried  # by size
    settling: dict[float, float]  # [s], of those that settled
    settles_later: bool | None  # whether the smallest that fails settles in a longer run; None where there was none
    # By size, of those that fail for a limit of the legs alone: the image error settles, or the run was stopped there
    beyond: dict[float, LimitUse]
    error: float  # [px], largest |xi_d - xi| at the start for the size `settles_to`, NaN for none
    overloads: dict[float, LimitUse]  # by size, of those that settle with forces beyond the legs' limit

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


@dataclass(frozen=True, eq=False)
class Timing:
    """Period or latency of the camera, with the other one constant."""

    what: str  # period | latency
    prediction: str  # none | encoder
    other: float  # [s], the one that is held
    own: float  # [s], of the scenario
    tried: Tried  # by time [s]
    settles_later: bool | None  # whether `fails_at` settles in a longer run; None where there was none
    beyond: dict[float, LimitUse]  # by time [s], of those that fail for a leg beyond a limit alone
    overloads: dict[float, LimitUse]  # by time [s], of those that settle with forces beyond the legs' limit
    timeout: float | None  # longest time that `camera.timeout` has room for [s]; None: it ends no search
    reseeded: tuple[bool, ...]  # whether `fails_at` settles with each of some other seeds; empty: nothing is random

    @property
    def settles_to(self) -> float | None:
        """Largest time [s] up to which everything that was tried settles, from `own` on, or from 0 where that fails.

        None where `own` and the smallest fail.
        """
        return bordering(outwards(self.tried, self.own))[0]

    @property
    def fails_at(self) -> float | None:
        """Smallest time [s] that was seen to fail, above `own` where that settles; None where none was."""
        return bordering(outwards(self.tried, self.own))[1]

    @property
    def fails_below(self) -> float | None:
        """Largest time [s] that was seen to fail below one that settles, `own`; None where none was."""
        if not self.tried.get(self.own, False):
            return None
        return max((time for time, good in self.tried.items() if time < self.own and not good), default=None)

    @property
    def settles_again(self) -> float | None:
        """Largest time [s] above `fails_at` that was seen to settle; None where none was."""
        failed = self.fails_at
        larger = (time for time, good in self.tried.items() if good and failed is not None and time > failed)
        return max(larger, default=None)

    @property
    def overloaded_from(self) -> float | None:
        """Smallest time [s] that settles with forces beyond the legs' limit, up to `settles_to`; None for none."""
        return None if self.settles_to is None else first_overload(self.overloads, self.settles_to)

    @property
    def limited_by(self) -> str | None:
        """What fails first, `error` or the kind of the legs' limit; None where nothing was seen to fail."""
        if self.fails_at is None:
            return None
        return self.beyond[self.fails_at].limit.kind if self.fails_at in self.beyond else "error"


@dataclass(frozen=True, eq=False, repr=False)
class LargestStart(Part):
    """Sizes and times that were run, and the largest ones that settle."""

    law: str
    open_because: str  # empty where the analysis applies
    directions: tuple[Direction, ...] = ()  # the task's own first; those along which a goal is possible
    timings: tuple[Timing, ...] = ()
    duration: float = 0.0  # [s], of every run
    longer: float = 0.0  # [s], of those of the smallest sizes and times that fail; 0: there were none
    runs: int = 0
    starts_at_goal: bool = False  # home has the goal image, within `inexact`
    home_error: float = 0.0  # [px], largest |xi_d - xi| at home
    goal_error: float = 0.0  # [px], the same at the pose of least image error
    own_limit: str = ""  # as `limited_by`, where the goal image has a pose but no goal on the way to it is possible
    band: float = 0.0  # [px], of settling
    dwell: float = 0.0  # [s], how long a run must have been within the band at its end
    assumed: str = ""  # what the runs with camera times assume beside the scenario
    from_home: bool = False  # the scenario's own start is not home at rest, from which all runs start

    @property
    def own(self) -> Direction | None:
        """The direction of the task's own goal."""
        return self.directions[0] if self.directions and self.directions[0].name == "own" else None


def border(tried: Mapping[float, bool]) -> tuple[float, float | None]:
    """Return the largest size below the smallest that fails, and that one: (0, ...) for none, (..., None) for none."""
    good, failed = bordering(tried)
    return good or 0.0, failed


def first_overload(overloads: Mapping[float, LimitUse], settles_to: float) -> float | None:
    """Return the smallest size or time with forces beyond the legs' limit, up to the border; None where there is none.

    The runs do not limit forces unless `actuators.saturation` or motors (`position_torque`) do, so that such a run
    settles all the same.
    """
    return min((size for size in overloads if size <= settles_to), default=None)


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
    trial = _Trial(scenario)
    goals = find_goals(scene)
    assert goals is not None  # as the camera has points
    at_goal = bool(scene.residual(scene.home) <= inexact(scene.band))
    directions, own_limit = _directions(
        scene, trial, goals.best.displacement if goals.reachable and not at_goal else None
    )
    timings, assumed = _timings(scenario, trial) if trial.task_settles else ((), "")
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
        trial.runs,
        at_goal,
        float(scene.residual(scene.home)),
        goals.best.largest_residual,
        own_limit,
        measured.band,
        measured.dwell,
        assumed,
        any(np.any(np.asarray(value_at(scenario, key))) for key in AT_HOME),
    )


@dataclass(frozen=True, eq=False)
class _Ends:
    """Results of variations of a scenario, one row each."""

    settled: Mask  # in the image, with all legs within their limits all the way
    times: Array  # [s], settling time of the image error; NaN: none
    beyond: list[LimitUse | None]  # the limit that is exceeded most, where a run fails for the legs' limits alone
    overloads: list[LimitUse | None]  # the limit of the efforts, where a run settles with more
    ran: Mask  # False: refused by the core


class _Trial:
    """Runs variations of a scenario for one duration, and counts them."""

    def __init__(self, scenario: Scenario) -> None:
        self.runs = 0
        own, step = scenario.simulation.duration, scenario.simulation.step
        # the short duration, unless the task itself needs the longer one
        self.longer = min(own, _whole(_LONG, step))
        self.duration = min(own, _whole(_SHORT, step))
        self.scenario = scenario.updated({**AT_HOME, "simulation.duration": self.duration})
        self.task_settles = self._settles(self.scenario)
        if not self.task_settles and self.duration < self.longer and self._settles(self.longest()):
            self.task_settles, self.duration, self.scenario = True, self.longer, self.longest()

    def longest(self) -> Scenario:
        """Return the scenario with the longer duration."""
        return self.scenario.updated({"simulation.duration": self.longer})

    def _settles(self, task: Scenario) -> bool:
        goal = np.array([task.target.desired_features])
        return bool(self.ends({"target.desired_features": goal}, task).settled[0])

    def ends(self, variations: Mapping[str, Array], scenario: Scenario | None = None) -> _Ends:
        """Run each variation and return how it ends.

        What the core refuses, such as a goal that the search of `pbvs` does not find, is not run.
        """
        base = self.scenario if scenario is None else scenario
        count = max(len(values) for values in variations.values())
        settled, ran = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
        times = np.full(count, np.nan)
        beyond: list[LimitUse | None] = [None] * count
        overloads: list[LimitUse | None] = [None] * count
        while ran.any():
            rows = np.flatnonzero(ran)
            try:
                varied = {key: values[rows] for key, values in variations.items()}
                batch = whole(simulate_batch(base, varied, log="metrics"))
            except ValueError as error:
                refused = re.match(r"scenario (\d+): ", str(error))
                if refused is None:
                    raise
                ran[rows[int(refused[1])]] = False
                continue
            self.runs += len(rows)
            times[rows] = batch.metrics["settling_time"]
            in_image = (batch.outcome == "completed") & np.isfinite(times[rows])
            for k, row in enumerate(rows):
                found = metrics_of(batch, k)
                use = most_used(base, found)
                if batch.outcome[k] == "leg_limit" or (in_image[k] and use.share > 1.0):
                    beyond[row] = use
                else:
                    settled[row] = in_image[k]
                    overloads[row] = overload(base, found) if in_image[k] else None
            break
        return _Ends(settled, times, beyond, overloads, ran)


def _whole(duration: float, step: float) -> float:
    """Round a duration to a whole number of steps."""
    return max(round(duration / step), 1) * step


# ---- Starting errors ------------------------------------------------------------------------------------------------


def _directions(scene: Scene, trial: _Trial, own: Array | None) -> tuple[tuple[Direction, ...], str]:
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
    later = _settles_later(scene, trial, ways)
    found = [
        replace(way, settles_later=settles, error=_error(scene, way)) for way, settles in zip(ways, later, strict=True)
    ]
    return tuple(found), own_limit


def _settles_later(scene: Scene, trial: _Trial, ways: list[Direction]) -> list[bool | None]:
    """Run the smallest sizes that fail for longer, since they may only be slow."""
    failed = [border(way.tried)[1] for way in ways]
    rows = [i for i, size in enumerate(failed) if size is not None]
    found: list[bool | None] = [None] * len(ways)
    if rows and trial.duration < trial.longer:
        moves = np.array([(failed[i] or 0.0) * ways[i].unit for i in rows])
        goals = scene.pixels(scene.home.moved(moves))
        good = trial.ends({"target.desired_features": goals}, trial.longest()).settled
        for i, settled in zip(rows, good, strict=True):
            found[i] = bool(settled)
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
    """Return the largest size along a direction that is reachable, in view and in the region, and what limits it.

    Every pose on the way to it is reachable and seen as well, on a grid.
    """
    farthest = WIDER * scene.unit
    farthest[3:] = np.pi  # one turn at a time may be larger
    most = float(1.0 / (np.abs(unit) / farthest).max())
    low, limit = 0.0, "region"
    for _ in range(2):  # the grid, then refined inside the cell that has the border
        sizes = np.linspace(low, most, 201)[1:]
        there = scene.home.moved(sizes[:, None] * unit)
        seen = np.asarray(np.isfinite(scene.pixels(there)).all(axis=1))
        good = seen & scene.reachable(there)
        if good.all():
            return float(sizes[-1]), limit
        first = int(np.argmin(good))
        limit = _leg_limit(scene, there[first]) if seen[first] else "view"
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


# ---- Camera times ---------------------------------------------------------------------------------------------------


def _timings(scenario: Scenario, trial: _Trial) -> tuple[tuple[Timing, ...], str]:
    """Try periods and latencies for the task itself, in the sampled loop."""
    assumed, changes = "", {}
    if scenario.simulation.mode != "sampled":
        assumed = f"sampled every {1e3 * scenario.simulation.step:.3g} ms"
        changes["simulation.mode"] = "sampled"
        if scenario.controller.law in laws_with("switching") and scenario.controller.switching.kind == "sign":
            assumed += " with implicit switching"
            changes["controller.switching.kind"] = "implicit"
        assumed += ", "
    sampled = trial.scenario.updated(changes) if changes else trial.scenario
    predictions = [sampled.camera.prediction]
    if predictions == ["none"] and scenario.controller.law in LAWS:  # the others predict the target
        predictions.append("encoder")
    found = []
    for prediction in predictions:
        base = sampled.updated({"camera.prediction": prediction})
        for what in ("period", "latency"):
            other = base.camera.latency if what == "period" else frame_period(base)
            found.append(_timing(base, what, other, trial))
    return tuple(found), assumed


def _timing(base: Scenario, what: str, other: float, trial: _Trial) -> Timing:
    """Try one time of the camera: a grid, then between the last that settles and the first that fails, in ticks."""
    step = base.simulation.step
    own = round((frame_period(base) if what == "period" else base.camera.latency) / step)
    tried: dict[int, bool] = {}
    beyond: dict[float, LimitUse] = {}
    overloads: dict[float, LimitUse] = {}

    def run(ticks: list[int]) -> None:
        new = sorted(set(ticks) - set(tried))
        if new:
            ends = trial.ends({f"camera.{what}": np.array([tick * step for tick in new])}, base)
            for k, tick in enumerate(new):
                if ends.ran[k]:
                    tried[tick] = bool(ends.settled[k])
                if (use := ends.beyond[k]) is not None:
                    beyond[tick * step] = use
                if (more := ends.overloads[k]) is not None:
                    overloads[tick * step] = more

    # A run of less than two periods shows nothing of them, and one shorter than the latency has no image.
    longest = base.simulation.duration / (2.0 if what == "period" else 1.0)
    shown = [tick for tick in _TICKS if tick * step < longest] or [1]
    timeout = None
    if (room := timeout_room(base)) is not None and own + room < shown[-1]:
        shown = [*(tick for tick in shown if tick < own + room), own + room]
        timeout = (own + room) * step
    run([own, *shown] if what == "period" else [0, own, *shown])
    for _ in range(ROUNDS):
        run(quarters(outwards(tried, own)))
    times = {tick * step: good for tick, good in tried.items()}
    found = Timing(what, base.camera.prediction, other, own * step, times, None, beyond, overloads, timeout, ())
    if found.fails_at is None:
        return found
    if is_random(base):
        seeds = [seed for seed in range(_SEEDS + 1) if seed != base.seed][:_SEEDS]
        again = {f"camera.{what}": np.full(_SEEDS, found.fails_at), "seed": np.array(seeds)}
        found = replace(found, reseeded=tuple(bool(good) for good in trial.ends(again, base).settled))
    if found.fails_at in beyond or trial.duration == trial.longer:
        return found
    longer = base.updated({"simulation.duration": trial.longer})
    settled = trial.ends({f"camera.{what}": np.array([found.fails_at])}, longer).settled
    return replace(found, settles_later=bool(settled[0]))
