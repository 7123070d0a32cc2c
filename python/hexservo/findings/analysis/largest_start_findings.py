"""Findings of the trial runs as sentences, tables and curves (docs/analysis/largest_start.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from hexservo.findings.analysis.words import number, open_section
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Cell, Column, Curves, Item, Line, Section, Table
from hexservo.scenario.arrays import Array

__all__ = ["Direction", "LargestStart", "Timing", "Tried", "border"]

PAGE = "docs/analysis/largest_start.md"

Tried: TypeAlias = dict[float, bool]
"""Size or time -> whether it settled."""


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
    # Largest leg travel [m] by size, of those that fail for that alone: the image error settles, or the run was stopped
    beyond: dict[float, float]
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
    def beyond_stroke(self) -> float | None:
        """Smallest size whose image error settles with a leg beyond its stroke on the way; None where none was seen."""
        return min(self.beyond, default=None)

    @property
    def settles_again(self) -> bool:
        """Whether a larger size than the smallest that fails settles: the border is not the only one."""
        failed = self.fails_at
        return failed is not None and any(good for size, good in self.tried.items() if size > failed)

    def amount(self, size: float, digits: int = 3) -> str:
        """Say a size in mm and degrees."""
        shift = 1e3 * float(np.linalg.norm(size * self.unit[:3]))
        turn = math.degrees(float(np.linalg.norm(size * self.unit[3:])))
        parts = ([f"{number(shift, digits)} mm"] if shift > 1e-3 * turn else []) + (
            [f"{number(turn, digits)} deg"] if turn > 1e-3 * shift else []
        )
        return " and ".join(parts) or "0 mm"

    def border_words(self) -> tuple[str, str]:
        """Say the largest size that settles and the smallest that fails, so that they read as two."""
        assert self.fails_at is not None
        both = [(self.amount(self.settles_to, digits), self.amount(self.fails_at, digits)) for digits in (3, 4, 5)]
        return next((pair for pair in both if pair[0] != pair[1]), both[-1])


@dataclass(frozen=True, eq=False)
class Timing:
    """One time of the camera, the other one held."""

    what: str  # period | latency
    prediction: str  # none | encoder
    other: float  # [s], the one that is held
    tried: Tried  # by time [s]
    beyond: dict[
        float, float
    ]  # largest leg travel [m] by time [s], of those that fail for a leg beyond its stroke alone

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

    @property
    def limited_by(self) -> str | None:
        """What fails first, `error` or `stroke`; None where nothing was seen to fail."""
        if self.fails_at is None:
            return None
        return "stroke" if self.fails_at in self.beyond else "error"


@dataclass(frozen=True, eq=False, repr=False)
class LargestStart(Findings):
    """What was tried, and where it stopped settling."""

    law: str
    open_because: str  # empty where the analysis applies
    directions: tuple[Direction, ...] = ()  # the task's own first, where its goal has a pose
    timings: tuple[Timing, ...] = ()
    duration: float = 0.0  # [s], of every run
    longer: float = 0.0  # [s], of those of the smallest sizes that fail; 0: there were none
    runs: int = 0
    starts_at_goal: bool = False  # home shows the goal image
    band: float = 0.0  # [px], of settling
    dwell: float = 0.0  # [s], how long a run must have been within the band at its end
    assumed: str = ""  # what the runs with camera times assume beside the scenario

    @property
    def own(self) -> Direction | None:
        """The way to the task's own goal."""
        return self.directions[0] if self.directions and self.directions[0].name == "own" else None

    def section(self) -> Section:
        """Words, the directions, the camera's times, and settling times over the size."""
        title = "Largest starting error and slowest camera that still settle (empirical)"
        if self.open_because:
            return open_section("largest_start", title, self.open_because)
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
        if own is None and self.starts_at_goal:
            words.append("The goal image is that from home: the task has no direction (others are tried, empirical).")
        elif own is None:
            words.append(
                "No pose within the region searched has the goal image: the direction of the task was not tried."
            )
        elif own.fails_at is None:
            words.append(
                f"In all runs in the direction of the task the error settles within {self.duration:g} s and the "
                f"stroke, up to {own.largest:.3g} times the task "
                f"({own.amount(own.largest)}), the largest that {_LIMITS[own.limited_by]} (empirical)."
            )
        elif own.settles_to == 0.0:
            words.append(
                f"In the direction of the task no error was found that settles within {self.duration:g} s: the "
                f"smallest that was tried, {own.fails_at:.3g} times the task ({own.amount(own.fails_at)}), already "
                "fails (empirical)."
            )
        else:
            words.append(
                f"In the direction of the task errors settle within {self.duration:g} s and the stroke up to "
                f"{own.settles_to:.3g} times "
                f"the task ({own.amount(own.settles_to)}, {own.error:.3g} px); {own.fails_at:.3g} times "
                f"{self._failure(own)} (empirical)."
            )
        words.append(self._others())
        words += self._timing_words() or [
            "The task itself does not settle within the stroke: camera times were not tried."
        ]
        again = [d.name for d in self.directions if d.settles_again]
        words.append(
            f"All of this is from {self.runs} runs of {self.duration:g} s, not derived: sizes between those "
            "that were run are not covered, and a limit need not be the only one"
            + (f" (along {', '.join(again)} a larger error settles again)." if again else ".")
        )
        return words

    def _others(self) -> str:
        others = [d for d in self.directions if d.name != "own"]
        failing = [d for d in others if d.fails_at is not None]
        if not failing:
            return (
                f"Along all {len(others)} axes and rotations every goal tried settles within {self.duration:g} s and "
                "the stroke, up to "
                "the limit of the stroke, of the camera or of the region searched."
            )
        worst = min(failing, key=lambda d: d.settles_to / d.largest)
        settles, fails = worst.border_words()
        return (
            f"Of {len(others)} axes and rotations {len(failing)} have goals that do not settle within "
            f"{self.duration:g} s; the worst is {worst.name}: "
            + (f"up to {settles} settle" if worst.settles_to else "none that was tried settles")
            + f", {fails} {self._failure(worst)}, of "
            f"{worst.amount(worst.largest)} that were possible."
        )

    def _failure(self, direction: Direction) -> str:
        """Say what happened to the smallest size that fails, in a longer run too."""
        if direction.fails_at in direction.beyond:
            travel = 1e3 * direction.beyond[direction.fails_at]
            return f"takes a leg {number(travel)} mm from its length at home, beyond its stroke"
        if direction.settles_later is None:
            return "does not"
        later = f"within {self.longer:g} s"
        return f"is slower, but settles {later}" if direction.settles_later else f"does not settle {later}"

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
                        f"a {t.what} of {1e3 * t.settles_to:.4g} ms settles {held} and {1e3 * t.fails_at:.4g} ms "
                        + self._timing_failure(t)
                    )
            how = "without prediction" if prediction == "none" else "with prediction by the encoders"
            words.append(f"The task itself, {self.assumed}{how}: {'; '.join(parts)}.")
        return words

    @staticmethod
    def _timing_failure(timing: Timing) -> str:
        """Say what the smallest time that fails fails by."""
        if timing.fails_at not in timing.beyond:
            return "does not settle"
        return f"takes a leg {number(1e3 * timing.beyond[timing.fails_at])} mm from home, beyond its stroke"

    def _items(self) -> list[Item]:
        rows: list[list[Cell]] = [
            [
                _NAMES[d.name],
                "none" if not d.settles_to else d.amount(d.settles_to) if d.fails_at is None else d.border_words()[0],
                None if np.isnan(d.error) else d.error,
                None if d.fails_at is None else d.border_words()[1],
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
            Column("fails by the stroke alone from"),
            Column("runs", "", "d"),
        ]
        note = (
            f"Settles: the run of {self.duration:g} s completes, stays within {self.band:g} px for its last "
            f"{self.dwell:g} s and keeps all legs within their stroke; one that is only slow fails, and one that "
            f"starts within {self.band:g} px needs no motion. The border lies between two sizes that were run."
        )
        items: list[Item] = [Table("Starting errors that settle (empirical)", columns, rows, note, PAGE)]
        if self.timings:
            timing_rows: list[list[Cell]] = [
                [
                    t.what,
                    t.prediction,
                    1e3 * t.other,
                    None if t.settles_to is None else 1e3 * t.settles_to,
                    None if t.fails_at is None else 1e3 * t.fails_at,
                    None if t.limited_by is None else _LIMITING[t.limited_by],
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
                        Column("limited by"),
                        Column("runs", "", "d"),
                    ],
                    timing_rows,
                    "One seed where there is noise.",
                    PAGE,
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
                    page=PAGE,
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
                    "limited_by": t.limited_by,
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
_LIMITING = {"error": "image error", "stroke": "stroke of the legs"}
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
