"""The largest starting error, camera period and latency that still settle: tried out, not derived.

Empirical throughout (docs/analysis/largest_start.md).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexservo._analysis._rest import WIDER, Array, Rest
from hexservo._batch import simulate_batch
from hexservo._evidence import Cell, Column, Curves, Item, Line, Section, Table
from hexservo._scenario import Scenario

__all__ = ["Direction", "LargestStart", "Timing", "analyse", "border"]

_PAGE = "docs/analysis/largest_start.md"
_SHORT, _LONG = 2.0, 10.0  # [s], of a run, and of one where the task itself needs longer
_DWELL = 0.1  # of a run: how long a run has to stay settled at its end
_GRID = 8  # sizes in the first round, up to the largest that is possible
_ROUNDS = 2  # of bisection in quarters
_TICKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 200)  # periods and latencies of the first round

Tried = dict[float, bool]  # size or time -> whether it settled


@dataclass(frozen=True, eq=False)
class Direction:
    """Goals along one way from home."""

    name: str
    unit: Array  # (6,) displacement from home at size 1 [m; rad], in B
    largest: float  # size up to which goals were possible
    limited_by: str  # stroke | view | the region searched | the core, which refuses a larger one
    tried: Tried  # by size
    settling: dict[float, float]  # [s], of those that settled
    settles_later: bool | None  # whether the smallest that fails settles in a longer run; None where there was none
    beyond_stroke: float | None  # smallest size that settles with a leg beyond its stroke on the way
    error: float  # [px], largest |xi_d - xi| at the start for the size `settles_to`, NaN for none

    @property
    def settles_to(self) -> float:
        """Largest size below which everything that was tried settles; 0 where nothing does."""
        return border(self.tried)[0]

    @property
    def fails_at(self) -> float | None:
        """Smallest size that was seen to fail; None where none was."""
        return border(self.tried)[1]

    @property
    def settles_again(self) -> bool:
        """Whether a larger size than the smallest that fails settles: the border is not the only one."""
        failed = self.fails_at
        return failed is not None and any(good for size, good in self.tried.items() if size > failed)

    def amount(self, size: float) -> str:
        """Say a size in mm and degrees."""
        shift, turn = 1e3 * np.linalg.norm(size * self.unit[:3]), np.degrees(np.linalg.norm(size * self.unit[3:]))
        parts = ([f"{shift:.3g} mm"] if shift > 1e-6 else []) + ([f"{turn:.3g} deg"] if turn > 1e-6 else [])
        return " and ".join(parts) or "0 mm"


@dataclass(frozen=True, eq=False)
class Timing:
    """One time of the camera, the other one held."""

    what: str  # period | latency
    prediction: str  # none | encoder
    other: float  # [s], the one that is held
    tried: Tried  # by time [s]

    @property
    def settles_to(self) -> float | None:
        """Largest time [s] below which everything that was tried settles; None where the smallest already fails."""
        good = [time for time, settled in self.tried.items() if settled]
        failed = self.fails_at
        low = [time for time in good if failed is None or time < failed]
        return max(low) if low else None

    @property
    def fails_at(self) -> float | None:
        """Smallest time [s] that was seen to fail; None where none was."""
        return border(self.tried)[1]


@dataclass(frozen=True, eq=False)
class LargestStart:
    """What was tried, and where it stopped settling."""

    law: str
    open_because: str  # empty where the analysis applies
    directions: tuple[Direction, ...] = ()  # the task's own first, where its goal has a pose
    timings: tuple[Timing, ...] = ()
    duration: float = 0.0  # [s], of every run
    longer: float = 0.0  # [s], of those of the smallest sizes that fail; 0: there were none
    runs: int = 0
    assumed: str = ""  # what the runs with camera times assume beside the scenario

    @property
    def own(self) -> Direction | None:
        """The way to the task's own goal."""
        return self.directions[0] if self.directions and self.directions[0].name == "own" else None

    def section(self) -> Section:
        """Words, the directions, the camera's times, and settling times over the size."""
        title = "Largest starting error and slowest camera that still settle (empirical)"
        if self.open_because:
            return Section(
                "largest_start", title, [self.open_because], data={"applies": False, "reason": self.open_because}
            )
        return Section("largest_start", title, self._sentences(), self._items(), self._verdict(), self._data())

    def _verdict(self) -> Any:
        own = self.own
        if own is None:
            return "open"
        if not own.tried.get(1.0, False):
            return "bad"
        return "warning" if own.fails_at is not None and own.fails_at < 1.25 else "good"

    def _sentences(self) -> list[str]:
        words = []
        own = self.own
        if own is None:
            words.append("No pose within the region searched shows the goal image: the task's own way was not tried.")
        elif own.fails_at is None:
            words.append(
                f"In all runs along the task's own way the error settles within {self.duration:g} s, up to "
                f"{own.largest:.3g} times the task "
                f"({own.amount(own.largest)}), the largest that {_LIMITS[own.limited_by]} (empirical)."
            )
        elif own.settles_to == 0.0:
            words.append(
                f"Along the task's own way no error was found that settles within {self.duration:g} s: the smallest "
                f"that was tried, {own.fails_at:.3g} times the task ({own.amount(own.fails_at)}), already fails "
                "(empirical)."
            )
        else:
            words.append(
                f"Along the task's own way errors settle within {self.duration:g} s up to {own.settles_to:.3g} times "
                f"the task ({own.amount(own.settles_to)}, {own.error:.3g} px); {own.fails_at:.3g} times "
                f"{self._failure(own)} (empirical)."
            )
        words.append(self._others())
        words += self._timing_words() or ["The task itself does not settle: camera times were not tried."]
        again = [d.name for d in self.directions if d.settles_again]
        words.append(
            f"All of this is tried out with {self.runs} runs of {self.duration:g} s, not derived: sizes between those "
            "that were run are not known, and a border need not be the only one"
            + (f" (along {', '.join(again)} a larger error settles again)." if again else ".")
        )
        return words

    def _others(self) -> str:
        others = [d for d in self.directions if d.name != "own"]
        failing = [d for d in others if d.fails_at is not None]
        if not failing:
            return (
                f"Along all {len(others)} axes and turns every goal tried settles within {self.duration:g} s, up to "
                "the end of the stroke, of what the camera sees or of the region searched."
            )
        worst = min(failing, key=lambda d: d.settles_to / d.largest)
        assert worst.fails_at is not None
        return (
            f"Of {len(others)} axes and turns {len(failing)} have goals that do not settle within "
            f"{self.duration:g} s; the worst is {worst.name}: "
            + (f"up to {worst.amount(worst.settles_to)} settle" if worst.settles_to else "none that was tried settles")
            + f", {worst.amount(worst.fails_at)} {self._failure(worst)}, of "
            f"{worst.amount(worst.largest)} that were possible."
        )

    def _failure(self, direction: Direction) -> str:
        """Say what happened to the smallest size that fails, in a longer run too."""
        if direction.settles_later is None:
            return "does not"
        later = f"within {self.longer:g} s"
        return f"is slower, but does {later}" if direction.settles_later else f"does not, not even {later}"

    def _timing_words(self) -> list[str]:
        words = []
        for prediction in dict.fromkeys(t.prediction for t in self.timings):
            parts = []
            for t in (t for t in self.timings if t.prediction == prediction):
                other = "latency" if t.what == "period" else "period"
                held = f"at a {other} of {1e3 * t.other:.3g} ms"
                if t.settles_to is None:
                    parts.append(f"no {t.what} settles {held}")
                elif t.fails_at is None:
                    parts.append(f"every {t.what} tried settles {held}, up to {1e3 * t.settles_to:.4g} ms")
                else:
                    parts.append(
                        f"a {t.what} of {1e3 * t.settles_to:.4g} ms settles {held} and {1e3 * t.fails_at:.4g} ms fails"
                    )
            how = "without prediction" if prediction == "none" else "with prediction by the encoders"
            words.append(f"The task itself, {self.assumed}{how}: {'; '.join(parts)}.")
        return words

    def _items(self) -> list[Item]:
        rows: list[list[Cell]] = [
            [
                _NAMES[d.name],
                d.amount(d.settles_to) if d.settles_to else "none",
                None if np.isnan(d.error) else d.error,
                None if d.fails_at is None else d.amount(d.fails_at),
                None if d.settles_later is None else "yes" if d.settles_later else "no",
                d.amount(d.largest),
                d.limited_by,
                "yes" if d.settles_again else "no",
                None if d.beyond_stroke is None else d.amount(d.beyond_stroke),
                len(d.tried),
            ]
            for d in self.directions
        ]
        columns = [
            Column("way from home to the goal"),
            Column("settles up to"),
            Column("its image error", "px", ".3g"),
            Column("smallest that fails"),
            Column(f"settles in {self.longer:g} s" if self.longer else "settles in a longer run"),
            Column("largest possible"),
            Column("limited by"),
            Column("settles again beyond"),
            Column("leaves the stroke on the way from"),
            Column("runs", "", "d"),
        ]
        note = (
            f"Settles: the run of {self.duration:g} s completes and stays within 2 px for its last "
            f"{100 * _DWELL:.0f} %; one that is only slow fails, and one that starts within 2 px needs no motion. "
            "The border lies between two sizes that were run."
        )
        items: list[Item] = [Table("Starting errors that settle (empirical)", columns, rows, note, _PAGE)]
        if self.timings:
            timing_rows: list[list[Cell]] = [
                [
                    t.what,
                    t.prediction,
                    1e3 * t.other,
                    None if t.settles_to is None else 1e3 * t.settles_to,
                    None if t.fails_at is None else 1e3 * t.fails_at,
                    len(t.tried),
                ]
                for t in self.timings
            ]
            items.append(
                Table(
                    "Camera times with which the task settles (empirical)",
                    [
                        Column("time"),
                        Column("prediction"),
                        Column("the other one", "ms", ".4g"),
                        Column("settles up to", "ms", ".4g"),
                        Column("smallest that fails", "ms", ".4g"),
                        Column("runs", "", "d"),
                    ],
                    timing_rows,
                    "One seed where there is noise.",
                    _PAGE,
                )
            )
        lines = []
        for d in self.directions:
            if d.settling:
                sizes = np.array(sorted(d.settling))
                lines.append(
                    Line(_NAMES[d.name], sizes / d.largest, np.array([d.settling[size] for size in sizes]), "points")
                )
        if lines:
            items.append(
                Curves(
                    "Settling time over the starting error",
                    "starting error, of the largest possible [1]",
                    "settling time [s]",
                    lines,
                    note="Runs that do not settle have no mark.",
                    page=_PAGE,
                )
            )
        return items

    def _data(self) -> dict[str, Any]:
        return {
            "applies": True,
            "empirical": True,
            "law": self.law,
            "duration": self.duration,
            "longer_duration": self.longer or None,
            "runs": self.runs,
            "directions": [
                {
                    "name": d.name,
                    "unit": d.unit,
                    "settles_to": d.settles_to,
                    "fails_at": d.fails_at,
                    "settles_later": d.settles_later,
                    "settles_again": d.settles_again,
                    "largest": d.largest,
                    "limited_by": d.limited_by,
                    "image_error": d.error,
                    "beyond_stroke": d.beyond_stroke,
                    "sizes": sorted(d.tried),
                    "settled": [d.tried[size] for size in sorted(d.tried)],
                }
                for d in self.directions
            ],
            "timings": [
                {
                    "what": t.what,
                    "prediction": t.prediction,
                    "other": t.other,
                    "settles_to": t.settles_to,
                    "fails_at": t.fails_at,
                    "times": sorted(t.tried),
                    "settled": [t.tried[time] for time in sorted(t.tried)],
                }
                for t in self.timings
            ],
        }


_NAMES = {
    "own": "the task's own",
    **{f"{kind} {sign}{axis}": f"{kind} {sign}{axis}" for kind in ("shift", "turn") for sign in "+-" for axis in "xyz"},
}
_LIMITS = {
    "stroke": "the stroke allows",
    "view": "leaves all points in front of the camera",
    "region": "the region searched has",
    "core": "the core accepts",
}


def border(tried: Mapping[float, bool]) -> tuple[float, float | None]:
    """Give the largest size below the smallest that fails, and that one: (0, ...) for none, (..., None) for none."""
    failed = min((size for size, good in tried.items() if not good), default=None)
    good = [size for size, settled in tried.items() if settled and (failed is None or size < failed)]
    return max(good, default=0.0), failed


def analyse(scenario: Scenario) -> LargestStart:
    """Try out how large a starting error, and how slow a camera, the scenario stands (docs/analysis/largest_start.md).

    Runs batches of the scenario: start at home, goals along ways from home.

    Raises
    ------
    ValueError
        For a scenario that the core refuses.
    """
    law = scenario.controller.law
    if scenario.camera.convention == "as_printed":
        return LargestStart(law, "A camera as_printed has no points in space, so goals have no pose: not tried.")
    rest = Rest(scenario)
    trial = _Trial(scenario)
    directions = _directions(rest, trial)
    timings, assumed = _timings(scenario, trial) if trial.task_settles else ((), "")
    longer = trial.longer if any(d.settles_later is not None for d in directions) else 0.0
    return LargestStart(law, "", directions, timings, trial.duration, longer, trial.runs, assumed)


class _Trial:
    """Runs variations of a scenario for one duration, and counts them."""

    def __init__(self, scenario: Scenario) -> None:
        self.runs = 0
        own, step = scenario.simulation.duration, scenario.simulation.step
        # the short duration, unless the task itself needs the longer one
        self.longer = min(own, _whole(_LONG, step))
        self.duration = min(own, _whole(_SHORT, step))
        self.scenario = scenario.updated({"simulation.duration": self.duration})
        self.task_settles = self._task_settles()
        if not self.task_settles and self.duration < self.longer:
            short, self.scenario = self.scenario, self.longest()
            self.task_settles = self._task_settles()
            if self.task_settles:
                self.duration = self.longer
            else:
                self.scenario = short

    def longest(self) -> Scenario:
        """Give the scenario with the longer duration."""
        return self.scenario.updated({"simulation.duration": self.longer})

    def _task_settles(self) -> bool:
        goal = np.array([self.scenario.target.desired_features])
        return bool(self.settled({"target.desired_features": goal})[0][0])

    def settled(
        self, variations: Mapping[str, Array], scenario: Scenario | None = None
    ) -> tuple[NDArray[np.bool_], Array, Array, NDArray[np.bool_]]:
        """Tell of each variation whether it settles, when [s], its largest leg travel [m], and whether it was run.

        What the core refuses, such as a goal that the search of `pbvs` does not find, is not run.
        """
        base = self.scenario if scenario is None else scenario
        count = max(len(values) for values in variations.values())
        good, ran = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
        times, travel = np.full(count, np.nan), np.full(count, np.nan)
        while ran.any():
            rows = np.flatnonzero(ran)
            try:
                batch = simulate_batch(base, {key: values[rows] for key, values in variations.items()}, log="metrics")
            except ValueError as error:
                refused = re.match(r"scenario (\d+): ", str(error))
                if refused is None:
                    raise
                ran[rows[int(refused[1])]] = False
                continue
            self.runs += len(rows)
            times[rows], travel[rows] = batch.metrics["settling_time"], batch.metrics["peak_leg_excursion"]
            # NaN, where a run ends outside, compares as false
            good[rows] = (batch.outcome == "completed") & (times[rows] <= (1.0 - _DWELL) * base.simulation.duration)
            break
        return good, times, travel, ran


def _whole(duration: float, step: float) -> float:
    """Round a duration to a whole number of steps."""
    return max(round(duration / step), 1) * step


# ---- Starting errors ------------------------------------------------------------------------------------------------


@dataclass
class _Way:
    """A direction while it is tried."""

    name: str
    unit: Array
    largest: float
    limited_by: str
    tried: Tried
    settling: dict[float, float]
    travel: dict[float, float]


def _directions(rest: Rest, trial: _Trial) -> tuple[Direction, ...]:
    """Try goals along the task's own way, the axes and the turns, all ways in one batch per round."""
    ways = [_Way(name, unit, *_largest(rest, unit), {}, {}, {}) for name, unit in _units(rest)]
    ways = [way for way in ways if way.largest > 0.0]

    def run(sizes: Callable[[_Way], list[float]]) -> None:
        rows = [(way, size) for way in ways for size in sizes(way) if size not in way.tried]
        if not rows:
            return
        moves = np.array([size * way.unit for way, size in rows])
        features, _ = rest.image(rest.home.repeated(len(rows)).moved(moves))
        good, times, travel, ran = trial.settled({"target.desired_features": features})
        for (way, size), settled, time, legs, there in zip(rows, good, times, travel, ran, strict=True):
            if not there:
                way.largest, way.limited_by = min(way.largest, size), "core"
                continue
            way.tried[size], way.travel[size] = bool(settled), float(legs)
            if settled:
                way.settling[size] = float(time)

    def grid(way: _Way) -> list[float]:
        sizes = [way.largest * k / _GRID for k in range(1, _GRID + 1)]
        return [*sizes, 1.0] if way.name == "own" and way.largest >= 1.0 else sizes

    def quarters(way: _Way) -> list[float]:
        low, high = border(way.tried)
        return [] if high is None else [low + part * (high - low) for part in (0.25, 0.5, 0.75)]

    def between(way: _Way) -> list[float]:
        """Give sizes halfway between those of the grid, below the border: does a smaller one fail."""
        high = border(way.tried)[1] or way.largest
        return [size for k in range(_GRID) if (size := way.largest * (k + 0.5) / _GRID) < high]

    run(grid)
    run(between)
    for _ in range(_ROUNDS):
        run(quarters)
    later = _settles_later(rest, trial, ways)
    return tuple(_described(rest, way, settles) for way, settles in zip(ways, later, strict=True))


def _settles_later(rest: Rest, trial: _Trial, ways: list[_Way]) -> list[bool | None]:
    """Run the smallest sizes that fail for longer: are they only slow."""
    failed = [border(way.tried)[1] for way in ways]
    rows = [i for i, size in enumerate(failed) if size is not None]
    found: list[bool | None] = [None] * len(ways)
    if rows and trial.duration < trial.longer:
        moves = np.array([(failed[i] or 0.0) * ways[i].unit for i in rows])
        features, _ = rest.image(rest.home.repeated(len(rows)).moved(moves))
        good = trial.settled({"target.desired_features": features}, trial.longest())[0]
        for i, settled in zip(rows, good, strict=True):
            found[i] = bool(settled)
    return found


def _units(rest: Rest) -> list[tuple[str, Array]]:
    goal = rest.goal()
    units = [] if goal is None else [("own", goal.displacement_from(rest.home)[0])]
    for j in range(6):
        for sign, value in (("+", 1.0), ("-", -1.0)):
            unit = np.zeros(6)
            unit[j] = value
            units.append((f"{'shift' if j < 3 else 'turn'} {sign}{'xyz'[j % 3]}", unit))
    return [(name, unit) for name, unit in units if np.abs(unit / rest.unit).max() > 1e-9]


def _largest(rest: Rest, unit: Array) -> tuple[float, str]:
    """Give the largest size along a way that is reachable, seen and in the region, and what limits it.

    Every pose on the way to it is reachable and seen as well, on a grid.
    """
    farthest = WIDER * rest.unit
    farthest[3:] = np.pi  # one turn at a time may be larger
    most = float(1.0 / (np.abs(unit) / farthest).max())
    low, limit = 0.0, "region"
    for _ in range(2):  # the grid, and once more inside the cell that has the border
        sizes = np.linspace(low, most, 201)[1:]
        there = rest.home.repeated(200).moved(sizes[:, None] * unit)
        seen = np.asarray(np.isfinite(rest.image(there)[0]).all(axis=1))
        good = seen & rest.reachable(there)
        if good.all():
            return float(sizes[-1]), limit
        first = int(np.argmin(good))
        limit = "stroke" if seen[first] else "view"
        low, most = float(sizes[first - 1]) if first else low, float(sizes[first])
    return low, limit


def _described(rest: Rest, way: _Way, settles_later: bool | None) -> Direction:
    settles_to = border(way.tried)[0]
    error = np.nan
    if settles_to > 0.0:
        goal = rest.home.moved((settles_to * way.unit)[None])
        error = float(np.abs(rest.image(goal)[0] - rest.image(rest.home)[0]).max())
    beyond = [size for size, good in way.tried.items() if good and way.travel[size] > rest.settings.robot.stroke]
    return Direction(
        way.name,
        way.unit,
        way.largest,
        way.limited_by,
        way.tried,
        way.settling,
        settles_later,
        min(beyond, default=None),
        error,
    )


# ---- Camera times ---------------------------------------------------------------------------------------------------


def _timings(scenario: Scenario, trial: _Trial) -> tuple[tuple[Timing, ...], str]:
    """Try periods and latencies for the task itself, in the sampled loop."""
    assumed, changes = "", {}
    if scenario.simulation.mode != "sampled":
        assumed = f"sampled every {1e3 * scenario.simulation.step:.3g} ms, "
        changes["simulation.mode"] = "sampled"
        if scenario.controller.law in ("hybrid", "composite") and scenario.controller.switching.kind == "sign":
            assumed = f"sampled every {1e3 * scenario.simulation.step:.3g} ms with implicit switching, "
            changes["controller.switching.kind"] = "implicit"
    sampled = trial.scenario.updated(changes) if changes else trial.scenario
    predictions = [sampled.camera.prediction]
    if predictions == ["none"]:
        predictions.append("encoder")
    found = []
    for prediction in predictions:
        base = sampled.updated({"camera.prediction": prediction})
        for what in ("period", "latency"):
            other = base.camera.latency if what == "period" else base.camera.period
            found.append(Timing(what, prediction, other, _times(base, what, trial)))
    return tuple(found), assumed


def _times(base: Scenario, what: str, trial: _Trial) -> Tried:
    """Try one time of the camera: a grid, then between the last that settles and the first that fails, in ticks."""
    step = base.simulation.step
    tried: dict[int, bool] = {}

    def run(ticks: list[int]) -> None:
        new = sorted(set(ticks) - set(tried))
        if new:
            good, _, _, ran = trial.settled({f"camera.{what}": np.array([tick * step for tick in new])}, base)
            tried.update({tick: bool(g) for tick, g, there in zip(new, good, ran, strict=True) if there})

    run([*_TICKS] if what == "period" else [0, *_TICKS])
    for _ in range(_ROUNDS):
        failed = min((tick for tick, good in tried.items() if not good), default=None)
        if failed is None:
            break
        low = max((tick for tick, good in tried.items() if good and tick < failed), default=failed)
        run([low + round(part * (failed - low)) for part in (0.25, 0.5, 0.75)])
    return {tick * step: good for tick, good in tried.items()}
