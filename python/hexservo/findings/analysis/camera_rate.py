"""Required camera rate: stability limits of the linear sampled loop in period, latency and gain.

docs/analysis/camera_rate.md has formulas and limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from hexservo.findings.analysis.camera_causes import Repeat, repeated_starts
from hexservo.findings.analysis.camera_margins import (
    Margins,
    crossing,
    gain_border,
    loop_margins,
    most_frames,
    motion_of,
    radius_map,
)
from hexservo.findings.analysis.camera_runs import LimitBorder, StartRun, learned_weights, limit_border, start_runs
from hexservo.findings.analysis.linear_loop import Clock, SampledLoop
from hexservo.findings.analysis.loop_of_scenario import (
    OFFSET,
    LoopAtRest,
    NotApplicableError,
    at_rest_at_home,
    clock_of,
    growth,
    loop_at_rest,
    loop_with_weights,
    scaled,
)
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import SMOOTH_KINDS
from hexservo.scenario.parameters import timeout_room
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.yaml import ScenarioError

NEARLY = 0.05
"""A run on each side of the border is this far from it, relative to it; of whole ticks the nearest, at least one."""
OF_GROWTH = 0.2
"""Share of a predicted growth that a measured one may differ from it."""
LEAST_CHANGE = 2.0
"""Growth times duration of a run, from which a measured sign counts: less is hidden by what remains of other modes."""
_LONGEST = (10.0, 10_000)
"""Of a run near a stability limit: one of the slower mode takes up to so many seconds or ticks, the larger of both."""
_TURNING = 0.01
"""Angle [rad], by which a mode turns at least within that time; one that turns less is taken as real."""
_RESOLVED = 0.75 * np.pi
"""Angle [rad] by which a mode turns at most between two samples of its run; from half a turn on it has an alias."""
_PATTERNS = 64.0
"""Least duration of a run near a stability limit, in patterns of the clocks."""
E_FOLDINGS = 10.0
"""Of a mode of the linear loop in a run that hunts, from which it would have left the settling band if it grew."""
_KEYS: tuple[Literal["period", "latency"], ...] = ("period", "latency")
SMALL_OFFSET = 1e-6
"""Taken where 0.01 px is already too much for a loop to be linear [px]."""


@dataclass(frozen=True)
class BorderRun:
    """A run by the core near a stability limit, compared with the linear loop."""

    key: Literal["gain", "latency", "period"]
    value: float  # factor, or [s]
    predicted: float  # growth [1/s]
    measured: float  # [1/s]; infinite where the run ended early
    offset: float  # largest feature offset at its start [px]
    apart: float  # from the border, relative to it; of latency and period at least one tick
    duration: float  # [s]

    @property
    def agrees(self) -> bool:
        """Whether it grows where that is predicted, and decays where that is."""
        return (self.predicted > 0.0) == (self.measured > 0.0)

    @property
    def change(self) -> float:
        """Logarithm of the factor by which the predicted growth changes the motion within the run."""
        return abs(self.predicted) * self.duration

    @property
    def conclusive(self) -> bool:
        """Whether that is enough for the sign of the growth to be measured."""
        return self.change >= LEAST_CHANGE

    @property
    def grows_as_predicted(self) -> bool:
        """Whether its growth is within `OF_GROWTH` of the predicted one."""
        return abs(self.measured - self.predicted) <= OF_GROWTH * abs(self.predicted)


@dataclass(frozen=True, eq=False, repr=False)
class CameraRate(Part):
    """Largest stable period and latency of the camera for a scenario's loop, and the runs that check them."""

    scenario: Scenario
    open: str | None  # why the analysis does not apply; then everything below is None or empty
    at_rest: LoopAtRest | None = None
    clock: Clock | None = None
    free: Margins | None = None  # K_v = 0
    smooth: Margins | None = None  # with the slope k_v/width, where the law has K_v
    # At the fuzzy weights at the end of the task's own run, K_v as in `acting`; None: it has none, or does not settle.
    learned: Margins | None = None
    periods: Array | None = None  # (m,) of the map [s]
    latencies: Array | None = None  # (k,) [s]
    radii: Array | None = None  # (k, m) spectral radius over one camera period, without drifts
    runs: tuple[BorderRun, ...] = ()
    starts: tuple[StartRun, ...] = ()  # from small starts; empty where the core refuses them
    # The same without what may be the cause, where one goes on moving or the linear loop is no description of them.
    repeats: tuple[Repeat, ...] = ()
    limits: dict[Literal["period", "latency"], LimitBorder] = field(default_factory=dict)  # of the task

    @property
    def settles(self) -> bool | None:
        """Whether the runs from small starting errors all settle; None if they are inconclusive.

        Runs that K_v holds where they start count for nothing. One that hunts settles, unless it may be a drift or a
        mode of the linear loop that is too slow to be seen. With a drift, which grows with any camera, runs are
        inconclusive where the linear loop is stable.
        """
        endings = {run.ending for run in self.starts} - {"held"}
        drifting = self.acting is not None and self.acting.stable and self.acting.drifts > 0
        if endings & {"goes on", "limit", "ended"}:
            return None if drifting else False
        if not endings or endings - {"settles", "hunts"}:
            return None
        hunting = [run.duration for run in self.starts if run.ending == "hunts"]
        if hunting and self.acting is not None:
            slow = not self.acting.stable and self.acting.rate * min(hunting) < E_FOLDINGS
            return None if drifting or slow else True
        return True

    @property
    def stable(self) -> bool | None:
        """The verdict: that of the runs, or of the linear loop if they are inconclusive; None if this is open."""
        if self.acting is None:
            return None
        return self.acting.stable if self.settles is None else self.settles

    @property
    def acting(self) -> Margins | None:
        """Margins of the loop that small motions meet: with the slope of K_v only where the scenario has one."""
        smoothing = self.scenario.controller.switching.kind in SMOOTH_KINDS
        return self.smooth if smoothing and self.smooth is not None else self.free


# --- the check by simulation ------------------------------------------------------------------------------------------
def _check(at_rest: LoopAtRest, found: Margins) -> tuple[BorderRun, ...]:
    """Run the loop just inside and outside its stability limit: in gain if it has one, else in latency or period."""
    home = at_rest_at_home(at_rest)
    loop = replace(loop_at_rest(home).free, by_eigenvalues=not found.perfect)
    clock, tick = clock_of(home), home.simulation.step
    drifts = found.drifts
    perfect = Clock(1, 0)
    if loop.growing(perfect) != at_rest.free.growing(perfect):  # another attitude, another verdict: not to be compared
        return ()
    border = found.gain[1] if found.gain[1] is not None else found.gain[0]
    if border is not None:
        # At home the attitude is another: the limit is searched again, from just below the one at the goal.
        start = border / 1.05
        nearby = gain_border(lambda g: replace(loop, gain=g * start).growing(clock) <= drifts, up=True)
        if nearby is None:
            return ()
        beside = ((1.0 - NEARLY) * nearby * start, (1.0 + NEARLY) * nearby * start)
        places = [_Place("gain", g, replace(loop, gain=g), clock, scaled(home, g)) for g in beside]
        places.sort(key=lambda place: place.loop.growing(clock))
    else:
        key: Literal["latency", "period"] = "latency" if found.latency.unstable is not None else "period"
        edge = found.latency if key == "latency" else found.period
        if edge.unstable is None or edge.stable is None or edge.unstable > loop.few * clock.period:
            return ()
        places = []
        for ticks in (edge.stable - edge.stable // 20, edge.unstable + edge.unstable // 20):
            at = Clock(clock.period, ticks) if key == "latency" else Clock(ticks, clock.latency)
            places.append(_Place(key, ticks * tick, loop, at, home.updated({f"camera.{key}": ticks * tick})))
    inside, outside = places
    if inside.loop.growing(inside.clock) > drifts or outside.loop.growing(outside.clock) <= drifts:
        return ()  # a second border within so little: runs of some seconds cannot distinguish them
    modes = crossing((inside.loop, inside.clock), (outside.loop, outside.clock))
    runs = [_run(place, mode, drifts) for place, mode in zip(places, modes, strict=True)]
    if any(run is not None and run.offset < OFFSET for run in runs):  # both sides from where the loop is linear
        runs = [_run(place, mode, drifts, (SMALL_OFFSET,)) for place, mode in zip(places, modes, strict=True)]
    return tuple(run for run in runs if run is not None) if None not in runs else ()


@dataclass(frozen=True, eq=False)
class _Place:
    """A loop near a stability limit, and its scenario with the goal at home."""

    key: Literal["gain", "latency", "period"]
    value: float
    loop: SampledLoop
    clock: Clock
    scenario: Scenario


def _run(
    place: _Place, exponent: complex, drifts: int, offsets: tuple[float, ...] = (OFFSET, SMALL_OFFSET)
) -> BorderRun | None:
    """Measure the growth of a mode from the first offset [px] with that of the linear loop, else the last one.

    None where nothing can be measured. Of an inconclusive run the sign alone is compared.
    """
    seconds = place.loop.seconds(place.clock)
    predicted = exponent.real
    turning, ticks = abs(exponent.imag), round(seconds / place.loop.tick)
    # Seen once a pattern, a mode that oscillates as fast as half its rate is hard to distinguish from its alias.
    parts = next((n for n in range(1, ticks) if ticks % n == 0 and turning * seconds <= _RESOLVED * n), ticks)
    # Long enough for many turns and for a change that shows, short enough for a mode that grows to stay small.
    most = max(_LONGEST[0], _LONGEST[1] * place.loop.tick)
    turns = 32.0 * np.pi / turning if turning * most > _TURNING else 0.0
    longest = float(np.clip(3.0 / max(abs(predicted), 1e-300), min(turns, most), most))
    multipliers = place.loop.multipliers(place.clock)
    real = np.sort(multipliers.real[(np.abs(multipliers.imag) < 1e-9) & (multipliers.real > 1.0)])[:drifts]
    drift = float(np.log(real.max(initial=1.0)) / seconds)
    way = motion_of(place.loop, place.clock, exponent)
    way = way * np.exp(-1j * np.angle(way[int(np.argmax(np.abs(way)))]))  # its largest part is real
    if drift * _PATTERNS * seconds > np.log(0.1 / SMALL_OFFSET):
        return None  # a run takes at least so long, and by then the drift would be all that is seen
    run: BorderRun | None = None
    for offset in offsets:
        # A drift must not have left the linear range by then, a tenth of a pixel.
        duration = longest if drift * longest < np.log(0.1 / offset) else float(np.log(0.1 / offset)) / drift
        duration = max(duration, _PATTERNS * seconds)
        measured = growth(
            place.scenario,
            duration,
            every=ticks // parts,
            angle=turning * seconds / parts,
            way=way.real,
            without=(real ** (1.0 / parts)).tolist(),
            offset=offset,
        )
        run = BorderRun(place.key, place.value, predicted, measured, offset, NEARLY, duration)
        if run.grows_as_predicted or (run.agrees and not run.conclusive):
            break
    return None if run is None or np.isnan(run.measured) else run


def analyse(scenario: Scenario, *, borders: bool = True) -> CameraRate:
    """Linearise the sampled loop at its goal, find its stability limits, and run it from small starting errors.

    Parameters
    ----------
    scenario
        With any law but `hybrid`; one in continuous mode is taken as sampled with the keys of its camera. Short runs
        check the border and the verdict.
    borders
        False leaves out what is not needed for `CameraRate.stable`: borders in period, latency and gain, those of the
        stroke, their runs, the map, and the loop at learned weights. The stability limits in `section` then have no
        meaning.

    Returns
    -------
    CameraRate
        With the reason in `open` where the analysis does not apply.
    """
    try:
        at_rest = loop_at_rest(scenario)
        clock = clock_of_loop(at_rest)
    except NotApplicableError as error:
        return CameraRate(scenario, str(error))
    radius = scene_of(scenario).platform_radius

    def margins_of(loop: SampledLoop) -> Margins:
        return loop_margins(loop, clock, radius, borders=borders, room=timeout_room(scenario))

    free = margins_of(at_rest.free)
    smooth = margins_of(at_rest.smooth) if at_rest.smooth is not None else None
    result = CameraRate(scenario, None, at_rest, clock, free, smooth)
    acting = result.acting or free
    result = replace(result, starts=_start_runs(at_rest, acting))
    if not borders:
        return result
    result = replace(result, repeats=_repeats(result, at_rest, clock))
    result = replace(result, learned=_learned(at_rest, margins_of, acting is smooth))
    if not free.has_camera:  # no border to map
        return result
    periods, latencies, radii = radius_map(at_rest.free, clock, free)
    result = replace(result, periods=periods, latencies=latencies, radii=radii, runs=_check(at_rest, free))
    if not acting.stable:
        return result
    # up to the stability limit of the linear loop
    largest = {key: getattr(acting, key).stable or getattr(clock, key) for key in _KEYS}
    return replace(result, limits={key: limit_border(at_rest.task, key, clock, largest[key]) for key in _KEYS})


def clock_of_loop(at_rest: LoopAtRest) -> Clock:
    """Return the camera's period and latency of a loop, in ticks.

    Raises
    ------
    NotApplicableError
        More frames are under way at once than the analysis allows.
    """
    clock, most = clock_of(at_rest.scenario), most_frames(at_rest.free)
    if clock.latency > most * clock.period:
        raise NotApplicableError(f"more than {most} frames are under way at once; take a longer camera.period")
    return clock


def _start_runs(at_rest: LoopAtRest, acting: Margins) -> tuple[StartRun, ...]:
    try:
        return start_runs(at_rest_at_home(at_rest), acting.slowest)
    except ScenarioError:  # the core refuses an image of rest as a goal
        return ()


def _repeats(result: CameraRate, at_rest: LoopAtRest, clock: Clock) -> tuple[Repeat, ...]:
    hunting = any(run.ending == "hunts" for run in result.starts)
    acting = result.acting
    if acting is None or result.settles is None or not (hunting or result.settles != acting.stable):
        return ()
    rest = all(run.rests for run in result.starts)
    home = at_rest_at_home(at_rest)
    return repeated_starts(home, acting.slowest, clock, learns=bool(at_rest.free.axes), rest=rest)


def _learned(at_rest: LoopAtRest, margins_of: Callable[[SampledLoop], Margins], smooth: bool) -> Margins | None:
    """Return the margins at the final weights of the task's own run."""
    if not at_rest.free.axes:  # nothing that learns
        return None
    weights = learned_weights(at_rest.task)
    return None if weights is None else margins_of(loop_with_weights(at_rest, weights, smooth=smooth))
