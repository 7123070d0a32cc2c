"""The trials of a comparison, their medians and worst values, and the files of them."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import hexservo as hs
from face_tracking.identified import recorded, response
from face_tracking.machine import MOTORS, Head, exported_model, package_model
from face_tracking.ours import OurController, settings
from face_tracking.published import PublishedLaw
from face_tracking.scene import CASES, Camera
from face_tracking.trial import Figures, Law, Record, figures, run

__all__ = [
    "FIGURES",
    "WANTED",
    "Responses",
    "Row",
    "Trial",
    "head_of",
    "heading",
    "line",
    "medians",
    "missed",
    "of_trial",
    "record_of",
    "recorded",
    "responses",
    "scenario_of",
    "trials",
    "write_csv",
    "write_json",
]

FIGURES = tuple(field.name for field in fields(Figures))
_SHOWN = ("overshoot", "settled", "final", "lag", "variation", "rest", "at_limit", "lost")


@dataclass(frozen=True)
class Trial:
    """What a trial depends on."""

    law: str
    motors: str
    case: str
    rate: float  # [Hz]
    latency: str
    limit: float | None  # [N m]
    seed: int
    focal_error: float = 0.0
    """Relative, of the focal length that all laws assume."""
    trim: float = 0.0
    """Added to the pitch of the published laws' aim [deg]."""
    folder: Path | None = None
    """Of the package; None: hexservo's own model."""
    identified: tuple[tuple[str, Any], ...] = ()
    """Keys of `actuators` for hexservo's laws; none: those of the scenario `reachy-mini`."""


@dataclass(frozen=True)
class Row:
    """Trials that differ by their seed."""

    trial: Trial  # the first of them
    values: dict[str, tuple[float, float]]
    """Median and worst of each of `FIGURES`."""
    seeds: tuple[int, ...]


@cache
def _model(folder: Path | None) -> Any:
    return exported_model() if folder is None else package_model(folder)


Responses: TypeAlias = dict[tuple[str, float | None], tuple[tuple[str, Any], ...]]


def _response(asked: tuple[str, float | None, Path | None]) -> tuple[tuple[str, Any], ...]:
    motors, limit, folder = asked
    return tuple(response(Head(_model(folder), MOTORS[motors], limit)).items())


def responses(motors: Sequence[tuple[str, float | None]], folder: Path | None, jobs: int) -> Responses:
    """Identify motors, each with a torque limit, from a log of them."""
    asked = [(*of, folder) for of in motors]
    if jobs == 1:
        return dict(zip(motors, map(_response, asked), strict=True))
    with ProcessPoolExecutor(jobs) as pool:
        return dict(zip(motors, pool.map(_response, asked), strict=True))


@cache
def _scenario(law: str, rate: float, camera: Camera, known: bool, motors: tuple[tuple[str, Any], ...]) -> hs.Scenario:
    return settings(law, rate, camera, known, dict(motors))


def scenario_of(trial: Trial, camera: Camera) -> hs.Scenario:
    """Return the scenario of a trial's controller, which assumes a camera."""
    return _scenario(trial.law, trial.rate, camera, trial.latency != "unknown", trial.identified)


def head_of(trial: Trial) -> Head:
    """Return a trial's head, at rest."""
    return Head(_model(trial.folder), MOTORS[trial.motors], trial.limit)


def record_of(trial: Trial) -> Record:
    """Run a trial."""
    true = Camera()
    scale = 1.0 + trial.focal_error
    assumed = replace(true, focal=(true.focal[0] * scale, true.focal[1] * scale))
    law: Law
    if trial.law in ("shipped", "fix"):
        law = PublishedLaw(assumed, trial.law == "fix", math.radians(trial.trim))
    else:
        law = OurController(scenario_of(trial, assumed))
    return run(head_of(trial), law, CASES[trial.case], true, trial.rate, trial.latency, trial.seed)


def of_trial(trial: Trial) -> Figures:
    """Run a trial, and measure it."""
    return figures(record_of(trial), CASES[trial.case])


def trials(todo: Sequence[Trial], jobs: int) -> Iterator[tuple[Trial, Figures]]:
    """Run trials in some processes; results come in their order."""
    if jobs == 1:
        yield from ((trial, of_trial(trial)) for trial in todo)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from zip(todo, pool.map(of_trial, todo, chunksize=5), strict=True)


def medians(done: Iterable[tuple[Trial, Figures]]) -> Iterator[Row]:
    """Yield a row for the seeds of each setting, which come one after the other."""
    group: list[tuple[Trial, Figures]] = []
    for trial, found in done:
        if group and replace(trial, seed=0) != replace(group[0][0], seed=0):
            yield _row(group)
            group = []
        group.append((trial, found))
    if group:
        yield _row(group)


def _row(group: list[tuple[Trial, Figures]]) -> Row:
    values = {}
    for name in FIGURES:
        numbers = np.array([getattr(found, name) for _, found in group])
        # The middle of a number and "never" is "never"; NaN is in all of them or in none.
        values[name] = float(np.median(numbers)), float(numbers.max())
    return Row(group[0][0], values, tuple(trial.seed for trial, _ in group))


_HEADS = {
    "overshoot": "overshoot deg",
    "settled": "within 1 deg s",
    "final": "final deg",
    "lag": "lag deg",
    "variation": "moving rad/s",
    "rest": "at rest rad/s",
    "at_limit": "at limit s",
    "lost": "lost",
}


def heading() -> str:
    """Return the heading of `table`."""
    return f"{'motors':8}{'limit':>6}{'Hz':>4} {'latency':10}{'f error':>8} {'case':7} {'law':14}" + "".join(
        f"{_HEADS[name]:>16}" for name in _SHOWN
    )


def line(row: Row) -> str:
    """Return a row of the table: medians, and the worst in brackets."""
    trial = row.trial
    limit = "none" if trial.limit is None else f"{trial.limit:g}"
    start = f"{trial.motors:8}{limit:>6}{trial.rate:4.0f} {trial.latency:10}{trial.focal_error:8.0%} "
    return f"{start}{trial.case:7} {trial.law:14}" + "".join(f"{_pair(*row.values[name]):>16}" for name in _SHOWN)


def _pair(middle: float, worst: float) -> str:
    return "-" if math.isnan(middle) else f"{_number(middle)} ({_number(worst)})"


def _number(value: float) -> str:
    return "never" if math.isinf(value) else f"{value:.3f}" if value < 0.1 else f"{value:.2f}"


def _plain(row: Row) -> dict[str, Any]:
    trial = {key: value for key, value in asdict(row.trial).items() if key not in ("seed", "folder", "identified")}
    trial["model"] = "hexservo" if row.trial.folder is None else "package"
    numbers = {
        f"{name}_{what}": value
        for name in FIGURES
        for what, value in zip(("median", "worst"), row.values[name], strict=True)
    }
    return {**trial, "seeds": " ".join(map(str, row.seeds)), **numbers}


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write a line for each row."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(_plain(rows[0])))
        writer.writeheader()
        writer.writerows(map(_plain, rows))


def write_json(path: Path, rows: Sequence[Row], about: dict[str, Any]) -> None:
    """Write the rows; what is never or does not apply is null."""

    def finite(value: Any) -> Any:
        return None if isinstance(value, float) and not math.isfinite(value) else value

    plain = [{key: finite(value) for key, value in _plain(row).items()} for row in rows]
    path.write_text(json.dumps({**about, "rows": plain}, indent=1) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Wanted:
    """What a tracker of this head shall reach: median and worst."""

    motors: str
    cases: tuple[str, ...]
    values: dict[str, tuple[float, float]]


_ALWAYS = {
    "final": (0.15, 0.15),
    "variation": (0.17, 0.17),
    "rest": (0.06, 0.06),
    "at_limit": (0.3, 0.3),
    "lost": (0.0, 0.0),
}
WANTED = (
    Wanted("freed", ("yaw", "pitch", "both"), {"overshoot": (0.5, 0.8), "settled": (0.55, 0.65), **_ALWAYS}),
    Wanted("shipped", ("yaw", "pitch"), {"overshoot": (0.4, 0.5), "settled": (0.65, 0.80), **_ALWAYS}),
    Wanted("shipped", ("both",), {"overshoot": (0.4, 0.5), "settled": (1.1, 1.3), **_ALWAYS}),
    Wanted("freed", ("moving",), {"lag": (1.0, 1.0), "overshoot": (1.8, 2.3), **_ALWAYS}),
    Wanted("shipped", ("moving",), {"lag": (1.5, 1.5), "overshoot": (1.8, 2.3), **_ALWAYS}),
    Wanted("xc330", ("yaw", "pitch", "both"), {"settled": (2.0, 2.0)}),
    Wanted("xl330", ("yaw", "pitch", "both"), {"settled": (2.0, 2.0)}),
)
"""At 15 Hz, with a latency that is drawn, unknown or stamped, and 0.6 N m, one set of settings for all motors."""


def missed(row: Row) -> list[str]:
    """Return a sentence for each limit of `WANTED` that a row misses."""
    found = []
    for wanted in WANTED:
        if row.trial.motors == wanted.motors and row.trial.case in wanted.cases:
            for name, limits in wanted.values.items():
                for what, value, limit in zip(("median", "worst"), row.values[name], limits, strict=True):
                    if not value <= limit:
                        found.append(f"{name} {_number(value)} > {limit:g} ({what})")
    return found
