"""Runs for the verdict on the camera: from small starting errors, and of the task within the limits of the legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from hexservo.findings.analysis.linear_loop import Clock
from hexservo.findings.analysis.poses import Poses
from hexservo.findings.analysis.scene import ALL_AXES, scene_of
from hexservo.findings.analysis.tried import ROUNDS, bordering, quarters
from hexservo.run.batch import metrics_of, simulate_batch, whole
from hexservo.run.leg_limits import KIND_OF_CAUSE, LimitUse, most_used
from hexservo.run.metrics import run_settles
from hexservo.run.result import Result
from hexservo.run.simulation import simulate, uninterrupted
from hexservo.scenario.arrays import Array
from hexservo.scenario.scenario import Scenario

STARTS = (0.01, 1.0)
"""Largest feature offsets of the small starts [px]."""

# Of a run from a small start: at least [s], and in time constants of the loop's slowest mode; the second one if the
# first is inconclusive.
_DURATIONS, _CONSTANTS = (10.0, 40.0), (20.0, 80.0)
_TICKS = 50_000  # of a run, at most
_LEAST = 3.0  # time constants of the slowest mode, before which a motion that goes on or hunts may only be slow
_PARTS = 10  # of a run, whose motions are compared
_QUIET, _MOVING = 0.05, 0.5  # of the largest motion: the last part has less at rest, and more where it goes on
_HELD = 0.95  # of the starting error, at least, is left at the end of a run that K_v holds there
_SMALL = 0.05  # of `metrics.band`, within which a motion that goes on is no failure
_LATE, _GROWN = 8, 1.25  # parts of a run, after which its error is at most so many times that before, or it grows
_STILL = 0.01  # of the stroke: legs that move by less in the last part of a run are at rest
_SAMPLES = 2000  # of a run, of which the last part is looked at
_GRID = 12  # clocks in the first round of a search for the stroke's border

Ending: TypeAlias = Literal["settles", "held", "no nearer", "hunts", "goes on", "limit", "ended", "open"]


@dataclass(frozen=True)
class StartRun:
    """A run with the scenario's K_v from a small starting error, with the goal at home."""

    offset: float  # largest feature offset at the start [px]
    duration: float  # [s]
    # settles; held: at rest where it started; no nearer: at rest elsewhere, as far from the goal; hunts: goes on moving
    # far within the settling band, without growing; goes on moving; exceeds a limit of the legs; ended early; open: it
    # is too slow to be judged
    ending: Ending
    peak: float  # largest |xi_d - xi| of the run [px]
    end: float  # the same at its end [px]
    late: float  # the largest of its last half [px]
    travel: float  # largest leg travel [m]

    @property
    def rests(self) -> bool:
        """Whether it does not go on moving; False where that is undecided too."""
        return self.ending in ("settles", "held")


@dataclass(frozen=True)
class LegsAtEnd:
    """Legs that still move at the end of a run of the task, which a longer run may take beyond their limits."""

    ticks: int  # period or latency of the run
    lasts: float  # [s], the last part of the run
    moved: float  # largest change of a leg's travel in it [m], of rotary legs [rad]
    speed: float  # largest speed of a leg in it [m/s; rad/s]


@dataclass(frozen=True)
class LimitBorder:
    """Largest period or latency with all legs within their limits in runs of the task, with the scenario's K_v.

    The limits are those of the motion: stroke, speed and joints.
    """

    within: int | None  # last of those tried that does, below `beyond` [ticks]; None: the scenario's own does not
    beyond: int | None  # first that was seen to exceed a limit [ticks]; None: none up to `largest`
    largest: int  # [ticks], tried
    use: LimitUse  # of the limit that is used most at `beyond`, else at `largest`; infinite where the run ends early
    own: LimitUse  # at the scenario's own clocks
    perfect: LimitUse | None  # with a frame at every tick and no latency, where `own` is beyond; None: it is not
    # in the run at `within`; None: they are at rest, or there is none
    at_end: LegsAtEnd | None = None


def start_runs(home: Scenario, slowest: float) -> tuple[StartRun, ...]:
    """Run a loop from small starting errors, and return how each run ends.

    Parameters
    ----------
    home
        With the image of rest as its goal, seen from home: see `seen_from_home`.
    slowest
        Time constant of the slowest mode of the linear loop, fuzzy systems included, which decays or grows [s].

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    """
    scene = scene_of(home)
    view = scene.view(scene.home)
    return tuple(_start_run(home, slowest, offset, view.after(ALL_AXES * scene.unit, offset)) for offset in STARTS)


def _start_run(home: Scenario, slowest: float, offset: float, goal: Array) -> StartRun:
    tick = home.simulation.step
    found: StartRun | None = None
    for seconds in (max(each, count * slowest) for each, count in zip(_DURATIONS, _CONSTANTS, strict=True)):
        ticks = _PARTS * max(1, round(min(seconds / tick, _TICKS) / _PARTS))
        changes: dict[str, Any] = {
            "target.desired_features": goal.tolist(),
            "simulation.duration": ticks * tick,
            "simulation.log_every": 1,
        }
        result = uninterrupted(simulate(home.updated(changes)))
        travel = float(result.streamed_metrics["peak_leg_excursion"])
        ending = _ending(result, most_used(home, result.streamed_metrics, result.stopped_by))
        errors = np.abs(result.feature_error).max(axis=1)
        if ending == "goes on" and _hunts(errors, home.metrics.band):
            ending = "hunts"
        if ending in ("goes on", "hunts") and ticks * tick < _LEAST * slowest:
            ending = "open"
        late = float(errors[len(errors) // 2 :].max())
        found = StartRun(offset, ticks * tick, ending, float(errors.max()), float(errors[-1]), late, travel)
        if ending not in ("no nearer", "hunts", "goes on", "open"):
            break  # what learns, or decays slowly, may only need longer
    assert found is not None
    return found


def _ending(result: Result, use: LimitUse) -> Ending:
    """Classify a run by how much its features still move in its last part."""
    if use.share > 1.0 or result.outcome == "leg_limit":
        return "limit"
    if result.outcome != "completed":
        return "ended"
    parts = np.array_split(result.feature_error, _PARTS)
    moved = np.array([np.ptp(part, axis=0).max() for part in parts])
    share = moved[-1] / max(float(moved.max()), 1e-300)
    if share < _QUIET:
        errors = np.abs(result.feature_error).max(axis=1)
        start, end = errors[[0, -1]]
        if end <= _HELD * start:
            return "settles"
        return "held" if _HELD * errors.max() <= start else "no nearer"
    return "goes on" if share > _MOVING and moved[-1] > 0.8 * moved[_PARTS // 2] else "open"


def _hunts(errors: Array, band: float) -> bool:
    """Return whether the errors (n,) [px] of a run stay far within the settling band, and do not grow."""
    parts = [float(part.max()) for part in np.array_split(errors, _PARTS)]
    return max(parts[_PARTS // 2 :]) <= _SMALL * band and max(parts[_LATE:]) <= _GROWN * max(parts[:_LATE])


def learned_weights(task: Scenario) -> Array | None:
    """Return the weights (6, 7, 7) [N; N m] at the end of a task that settles; None where it does not.

    Settled: docs/model.md, section 8.
    """
    result = uninterrupted(simulate(task))
    if not run_settles(result):
        return None
    return np.asarray(result.fuzzy_weights)


def limit_border(task: Scenario, key: Literal["period", "latency"], clock: Clock, largest: int) -> LimitBorder:
    """Run the task with longer and longer periods or latencies of the camera, and compare the legs with their limits.

    Parameters
    ----------
    task
        In sampled mode.
    key
        What varies, from the clock's own value on.
    clock
        Of the task.
    largest
        Up to which it varies [ticks].
    """
    own = int(getattr(clock, key))
    tick = task.simulation.step
    uses: dict[int, LimitUse] = {}

    def used(base: Scenario, ticks: Sequence[int]) -> list[LimitUse]:
        values = np.array([value * tick for value in ticks])
        batch = whole(simulate_batch(base, {f"camera.{key}": values}, log="metrics"))
        stopped = [KIND_OF_CAUSE.get(cause, "") for cause in batch.cause]
        rows = [most_used(base, metrics_of(batch, row), by) for row, by in enumerate(stopped)]
        # A run that ends early has no number of the legs, but the task was not done: the camera is too slow.
        done = [outcome in ("completed", "leg_limit") for outcome in batch.outcome]
        return [use if good else replace(use, peak=np.inf) for use, good in zip(rows, done, strict=True)]

    def run(ticks: Sequence[int]) -> None:
        new = sorted(set(ticks) - set(uses))
        if not new:
            return
        uses.update(zip(new, used(task, new), strict=True))

    def within() -> dict[int, bool]:
        return {value: use.share <= 1.0 for value, use in uses.items()}

    run([own, *(round(value) for value in np.geomspace(max(own, 1), max(largest, own, 1), _GRID))])
    for _ in range(ROUNDS):
        run(quarters(within()))
    last, beyond = bordering(within())
    top = max(uses)
    perfect = None
    if uses[own].share > 1.0:
        least = 1 if key == "period" else 0
        (perfect,) = used(with_perfect_camera(task), [least])
    at_end = None if last is None else _legs_at_end(task.updated({f"camera.{key}": last * tick}), last)
    return LimitBorder(last, beyond, top, uses[top if beyond is None else beyond], uses[own], perfect, at_end)


def _legs_at_end(task: Scenario, ticks: int) -> LegsAtEnd | None:
    """Return how the legs move in the last part of a run, in which one moves by more than `_STILL` of the stroke."""
    step = task.simulation.step
    every = max(1, int(task.simulation.duration / step) // _SAMPLES)
    result = uninterrupted(simulate(task.updated({"simulation.log_every": every})))
    scene = scene_of(task)
    first = int(np.searchsorted(result.time, (1.0 - 1.0 / _PARTS) * result.time[-1]))
    travel = scene.leg_travel(Poses(result.position[first:], result.quaternion[first:]))
    if len(travel) < 2 or not np.isfinite(travel).all():
        return None
    moved = float(np.ptp(travel, axis=0).max())
    if moved <= _STILL * scene.stroke:
        return None
    rates = np.abs(np.diff(travel, axis=0)) / np.diff(result.time[first:])[:, None]
    return LegsAtEnd(ticks, float(result.time[-1] - result.time[first]), moved, float(rates.max()))


def with_perfect_camera(scenario: Scenario) -> Scenario:
    """Return a sampled scenario with a frame at every tick and no latency."""
    return scenario.updated({"camera.period": scenario.simulation.step, "camera.latency": 0.0})
