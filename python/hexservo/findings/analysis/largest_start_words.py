"""Runs from larger and larger starting errors as sentences, tables and curves (docs/analysis/largest_start.md)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hexservo.findings.analysis.goal import SHOWN
from hexservo.findings.analysis.largest_start import Direction, LargestStart
from hexservo.findings.analysis.largest_times import Timing
from hexservo.findings.analysis.words import finite, in_ms, number, open_section
from hexservo.findings.evidence import Column, Curves, Item, Line, Section, Table, Verdict, picked
from hexservo.scenario.laws import LAWS
from hexservo.scenario.wording import above, apart

PAGE = "docs/analysis/largest_start.md"

_MARGIN = 1.25  # times the task, that settles with forces that the legs have, for a good verdict
_WITHIN = "the stroke, speed and joint limits of the legs"

_LIMITING = {
    "error": "image error",
    "stroke": "stroke of the legs",
    "speed": "speed limit of the legs",
    "base_joint": "joints at the base",
    "platform_joint": "joints at the platform",
}
_LIMITS = {
    "stroke": "the stroke allows",
    "base_joint": "the joints at the base allow",
    "platform_joint": "the joints at the platform allow",
    "singularity": "has no singular pose on the way",
    "view": "leaves all points in front of the camera",
    "image": "leaves all points in the image",
    "region": "the region searched has",
    "core": "the core accepts",
}


def section(found: LargestStart) -> Section:
    """Return sentences, the directions, the camera's times, and settling times over the size."""
    title = "Largest starting error and slowest camera that still settle (empirical)"
    if found.open_because:
        return open_section("largest_start", title, found.open_because)
    return Section("largest_start", title, _sentences(found), _items(found), _verdict(found), _data(found))


def _verdict(found: LargestStart) -> Verdict:
    own = found.own
    if own is None or found.is_cut:
        return "open"
    if not own.tried.get(1.0, False) or (_leaves_again(found) and not np.isfinite(found.whole_settling)):
        return "bad"
    fails_at = None if own.settles_later else own.fails_at  # one that is merely slower fails at no size
    ends = [size for size in (fails_at, own.overloaded_from) if size is not None]
    return "warning" if ends and min(ends) < _MARGIN else "good"


def _sentences(found: LargestStart) -> list[str]:
    words = []
    own = found.own
    if own is None and found.starts_at_goal:
        off = "" if found.home_error < SHOWN else f" to {number(found.home_error)} px"
        words.append(f"The goal image is that from home{off}: the task has no direction (others are tried, empirical).")
    elif own is None and found.own_limit:
        words.append(
            f"No goal in the direction of the task was found that {_LIMITS[found.own_limit]}: this direction was not "
            "tried."
        )
    elif own is None:
        words.append(
            "No pose within the region searched has the goal image "
            f"(the best one found leaves {number(found.goal_error)} px): the direction of the task was not tried."
        )
    elif own.fails_at is None:
        words.append(
            f"In all runs in the direction of the task the error settles {_within_limits(found)}, "
            f"up to {own.largest:.3g} times the task ({_amount(own, own.largest)}), "
            f"the largest that {_LIMITS[own.limited_by]} (empirical)."
        )
    elif own.settles_to == 0.0:
        words.append(
            f"In the direction of the task no error was found that settles {_within(found, found.duration)}: the "
            f"smallest that was tried, {own.fails_at:.3g} times the task ({_amount(own, own.fails_at)}), already "
            f"fails{_in_brackets(_by_seeds(found, own))} (empirical)."
        )
    else:
        factors = apart(own.settles_to, own.fails_at, 3)
        words.append(
            f"In the direction of the task errors settle {_within_limits(found)} up to "
            f"{factors[0]} times the task ({_amount(own, own.settles_to)}, {own.error:.3g} px); "
            f"{factors[1]} times {_failure(found, own)}{_in_brackets(_by_seeds(found, own))} (empirical)."
        )
    words += _of_whole_run(found)
    words.append(_others(found))
    words += _timing_words(found) or [_not_settled(found)]
    words += _force_words(found)
    again = [d.name for d in found.directions if d.settles_again]
    words.append(
        f"All of this is from {found.runs} runs{_of_durations(found)}, not derived: sizes between those "
        "that were run are not covered, and a limit need not be the only one"
        + (f" (along {', '.join(again)} a larger error settles again)." if again else ".")
    )
    if found.is_random:
        words.append(
            f"What settles is within {found.band:g} px in the last {found.dwell:g} s of its run: by noise, outliers or "
            "lost frames a longer one may leave the band again."
        )
    return words


def _within(found: LargestStart, duration: float) -> str:
    """Return in which time something settles: where runs are random, a longer one may leave the band again."""
    return f"{'in runs of' if found.is_random else 'within'} {duration:g} s"


def _within_limits(found: LargestStart) -> str:
    return f"{_within(found, found.duration)}{', within' if found.is_random else ' and'} {_WITHIN}"


def _leaves_again(found: LargestStart) -> bool:
    """Return whether the task itself settles in the runs of all others, and leaves the band or the limits later."""
    settles = bool(found.timings)  # else these were not tried
    return settles and found.whole_duration > found.duration and not found.whole_settling <= found.duration


def _of_whole_run(found: LargestStart) -> list[str]:
    """Return what the scenario's own duration has of the task that the shorter runs do not."""
    if not _leaves_again(found):
        return []
    whole = f"in a run of {found.whole_duration:g} s"
    if np.isfinite(found.whole_settling):
        later = f" and leaves the band again: {whole} it is settled after {above(found.whole_settling)} s"
    elif found.whole_beyond is not None:
        later = f", but {whole} {found.whole_beyond.excess}"
    else:
        later = f", but not {whole}"
    return [f"{_task(found)} settles within {found.duration:g} s{later}."]


def _of_durations(found: LargestStart) -> str:
    """Return how long the runs are, and how many there are of each duration where they differ."""
    if len(found.durations) < 2:
        return f" of {found.duration:g} s"
    *others, last = (f"{count} of {duration:g} s" for duration, count in found.durations.items())
    return f" ({', '.join(others)} and {last})"


def _not_settled(found: LargestStart) -> str:
    """Return why there are no camera times: a task that is only slow may settle after the longest run."""
    words = (
        f"{_task(found)} does not settle within {found.task_duration:g} s and {_WITHIN}: camera times were not tried"
    )
    return (
        f"{words}. Longer runs take too many steps here: whether it settles is not known."
        if found.is_cut
        else f"{words}."
    )


def _others(found: LargestStart) -> str:
    others = [d for d in found.directions if d.name != "own"]
    if not others:
        return "Along no axis and about none was a possible goal found: none was tried."
    failing = [d for d in others if d.fails_at is not None]
    if not failing:
        along = (
            f"Along all {len(others)} axes and rotations"
            if len(others) > 1
            else f"The other direction, {others[0].name}:"
        )
        return (
            f"{along} every goal tried settles {_within_limits(found)}, up to those limits, or those of the camera or "
            "of the region searched."
        )
    worst = min(failing, key=lambda d: d.settles_to / d.largest)
    settles, fails = border_words(worst)
    if len(others) == 1:
        of = f"The other direction, {worst.name}, has"
    else:
        of = f"Of {len(others)} axes and rotations {len(failing)} {'has' if len(failing) == 1 else 'have'}"
    the_worst = "" if len(others) == 1 else f"; the worst is {worst.name}"
    return (
        f"{of} goals that do not settle {_within(found, found.duration)}{the_worst}: "
        + (f"up to {settles} settle" if worst.settles_to else "none that was tried settles")
        + f", {fails} {_failure(found, worst)}{_in_brackets(_by_seeds(found, worst))}, of "
        f"{_amount(worst, worst.largest)} that were possible."
    )


def _force_words(found: LargestStart) -> list[str]:
    """Return what settles with forces that the legs do not have, which saturation or motors alone limit in the runs.

    Larger sizes than the smallest that fails are left out.
    """
    places, own = [], found.own
    if own is not None and (size := own.overloaded_from) is not None:
        uses = [use for each, use in own.overloads.items() if each <= own.settles_to]
        most = max(uses, key=lambda use: use.peak)
        every = all(each in own.overloads for each in own.tried if each <= own.settles_to)
        sizes = "at all sizes tried" if every else f"from {size:.3g} times the task on ({_amount(own, size)})"
        places.append(f"in the direction of the task {sizes}, the worst of which {most.excess}")
    others = [d for d in found.directions if d.name != "own"]
    if count := sum(d.overloaded_from is not None for d in others):
        places.append(f"along {count} of {len(others)} axes and rotations")
    places += [
        f"with a camera {t.what} from {in_ms(time)} on, {_prediction(found, t.prediction)}"
        for t in found.timings
        if (time := t.overloaded_from) is not None
    ]
    if not places:
        return []
    head = (
        "Forces or torques of the legs are not limited in these runs, and some that settle need more than the legs have"
    )
    return [f"{head}: {'; '.join(places)}."]


def _prediction(found: LargestStart, prediction: str) -> str:
    if found.law not in LAWS:
        return "with the target predicted by the law"
    return "without prediction" if prediction == "none" else "with prediction by the encoders"


def _timing_words(found: LargestStart) -> list[str]:
    words = []
    for prediction in dict.fromkeys(t.prediction for t in found.timings):
        parts = []
        for t in (t for t in found.timings if t.prediction == prediction):
            other = "latency" if t.what == "period" else "period"
            held = f"at a {other} of {1e3 * t.other:.3g} ms"
            within = f"settles {_within(found, found.duration)} {held}"
            if t.settles_to is None and not any(t.tried.values()):
                later = "" if t.settles_later is None else f" ({in_ms(t.fails_at or 0.0)} {_failure(found, t)})"
                parts.append(f"no {t.what} that was tried {within}{later}")
            elif t.settles_to is None:
                parts.append(f"a {t.what} of {in_ms(t.fails_at or 0.0)} {_failure(found, t)} {held}, some larger do")
            elif t.fails_at is None:
                since = "" if t.fails_below is None else f"from {in_ms(t.own)} on, "
                ends = "" if t.timeout is None else ", the longest that camera.timeout has room for"
                parts.append(f"every {t.what} tried {since}{within}, up to {in_ms(t.settles_to or 0.0)}{ends}")
            else:
                parts.append(
                    f"a {t.what} of {in_ms(t.settles_to or 0.0)} {within} and {in_ms(t.fails_at or 0.0)} "
                    + _failure(found, t)
                    + _doubt(found, t)
                )
            if t.fails_below is not None:
                parts[-1] += (
                    f" (one of {in_ms(t.fails_below)}, below the scenario's own, does not "
                    f"{_within(found, found.duration)})"
                )
        task = _task(found).removesuffix(",")
        words.append(f"{task}, {found.assumed}{_prediction(found, prediction)}: {'; '.join(parts)}.")
    return words


def _doubt(found: LargestStart, timing: Timing) -> str:
    """Return what speaks against a limit of a camera time: other seeds, and larger times that settle."""
    again = timing.settles_again
    larger = "" if again is None else f"some larger ones settle, up to {in_ms(again)}"
    return _in_brackets(_by_seeds(found, timing), larger)


def _in_brackets(*doubts: str) -> str:
    some = "; ".join(filter(None, doubts))
    return f" ({some})" if some else ""


def _by_seeds(found: LargestStart, tried: Direction | Timing) -> str:
    """Return in how many runs with other seeds the smallest size or time that fails settles; empty without noise."""
    count, settles = len(tried.reseeded), sum(tried.reseeded)
    if not count:
        return ""
    runs = {0: "none", count: "all"}.get(settles, str(settles))
    of = f"of {count} runs of {found.duration:g} s with other seeds"
    return f"{of} {runs} settle{'s' if settles == 1 else ''}"


def _task(found: LargestStart) -> str:
    """Return what the runs with the task's own goal are: all start at home."""
    if found.from_home:
        return "The task's goal, from home at rest instead of the task's own start (simulation.start),"
    return "The task itself"


def _failure(found: LargestStart, tried: Direction | Timing) -> str:
    """Return what happens at the smallest size or time that fails, in a longer run too."""
    if tried.fails_at in tried.beyond:
        return tried.beyond[tried.fails_at].excess
    if tried.settles_later is None:
        return "does not"
    later = _within(found, found.longer)
    return f"is slower, but settles {later}" if tried.settles_later else f"does not settle {later}"


def _items(found: LargestStart) -> list[Item]:
    longer = f"settles in {found.longer:g} s" if found.longer else "settles in a longer run"
    table = Table.of(
        "Starting errors that settle (empirical)",
        found.directions,
        [
            (Column("way from home to the goal"), _name),
            (Column("settles up to"), _settles_to),
            (Column("its image error", "px", ".3g"), lambda d: finite(d.error)),
            (Column("smallest that fails"), lambda d: None if d.fails_at is None else border_words(d)[1]),
            (Column(longer), lambda d: d.settles_later),
            (Column(f"other seeds that settle in {found.duration:g} s"), _of_seeds),
            (Column("largest possible"), lambda d: _amount(d, d.largest)),
            (Column("limited by"), lambda d: d.limited_by.replace("_", " ")),
            (Column("settles again beyond"), lambda d: d.settles_again),
            (
                Column("fails by the legs' limits alone from"),
                lambda d: None if d.beyond_limits is None else _amount(d, d.beyond_limits),
            ),
            (
                Column("settles with forces beyond the limit from"),
                lambda d: None if d.overloaded_from is None else _amount(d, d.overloaded_from),
            ),
            (Column("runs", "", "d"), lambda d: len(d.tried)),
        ],
        note=f"Settles: the run of {found.duration:g} s completes, stays within {found.band:g} px for its last "
        f"{found.dwell:g} s and keeps all legs within their stroke, speed and joint limits; "
        f"one that is only slow fails, and one that "
        f"starts within {found.band:g} px needs no motion. The border lies between two sizes that were run; where "
        "there is noise, with one seed, and others for the smallest size that fails.",
        page=PAGE,
    )
    items: list[Item] = [table]
    if found.timings:
        items.append(
            Table.of(
                "Camera times with which the task settles (empirical)",
                found.timings,
                [
                    (Column("time"), lambda t: t.what),
                    (Column("prediction"), lambda t: t.prediction),
                    (Column("the other one", "ms", ".4g"), lambda t: 1e3 * t.other),
                    (Column("settles up to", "ms", ".4g"), lambda t: _milli(t.settles_to)),
                    (Column("smallest that fails", "ms", ".4g"), lambda t: _milli(t.fails_at)),
                    (Column(longer), lambda t: t.settles_later),
                    (Column(f"other seeds that settle in {found.duration:g} s"), _of_seeds),
                    (Column("settles again up to", "ms", ".4g"), lambda t: _milli(t.settles_again)),
                    (Column("fails below its own", "ms", ".4g"), lambda t: _milli(t.fails_below)),
                    (Column("limited by"), lambda t: None if t.limited_by is None else _LIMITING[t.limited_by]),
                    (
                        Column("settles with forces beyond the limit from", "ms", ".4g"),
                        lambda t: _milli(t.overloaded_from),
                    ),
                    (Column("runs", "", "d"), lambda t: len(t.tried)),
                ],
                note="Where there is noise: one seed, and others for the smallest time that fails.",
                page=PAGE,
            )
        )
    lines = []
    for d in found.directions:
        if d.settling:
            sizes = np.array(sorted(d.settling))
            lines.append(Line(_name(d), sizes / d.largest, np.array([d.settling[size] for size in sizes]), "points"))
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


def _data(found: LargestStart) -> dict[str, Any]:
    return {
        "applies": True,
        "empirical": True,
        **picked(found, "law duration"),
        "longer_duration": found.longer or None,
        "task_duration": found.whole_duration,
        "task_settling_time": found.whole_settling,
        "runs": found.runs,
        "directions": [
            {
                **picked(d, "name unit settles_to fails_at settles_later reseeded settles_again largest limited_by"),
                "image_error": d.error,
                "beyond_limits": d.beyond_limits,
                "overloaded_from": d.overloaded_from,
                "sizes": sorted(d.tried),
                "settled": [d.tried[size] for size in sorted(d.tried)],
            }
            for d in found.directions
        ],
        "timings": [
            {
                **picked(
                    t,
                    "what prediction other own settles_to fails_at settles_later fails_below limited_by "
                    "overloaded_from timeout settles_again reseeded",
                ),
                "times": sorted(t.tried),
                "settled": [t.tried[time] for time in sorted(t.tried)],
            }
            for t in found.timings
        ],
    }


def _of_seeds(tried: Direction | Timing) -> str | None:
    return f"{sum(tried.reseeded)} of {len(tried.reseeded)}" if tried.reseeded else None


def _name(direction: Direction) -> str:
    return "the task's own" if direction.name == "own" else direction.name


def _settles_to(direction: Direction) -> str:
    if not direction.settles_to:
        return "none"
    return _amount(direction, direction.settles_to) if direction.fails_at is None else border_words(direction)[0]


def _milli(time: float | None) -> float | None:
    return None if time is None else 1e3 * time


def _amount(direction: Direction, size: float, digits: int = 3) -> str:
    """Return a size in mm and degrees as text."""
    shift = 1e3 * float(np.linalg.norm(size * direction.unit[:3]))
    turn = math.degrees(float(np.linalg.norm(size * direction.unit[3:])))
    parts = ([f"{number(shift, digits)} mm"] if shift > 1e-3 * turn else []) + (
        [f"{number(turn, digits)} deg"] if turn > 1e-3 * shift else []
    )
    return " and ".join(parts) or "0 mm"


def border_words(direction: Direction) -> tuple[str, str]:
    """Return the largest size that settles and the smallest that fails as two texts that differ."""
    assert direction.fails_at is not None
    both = [
        (_amount(direction, direction.settles_to, digits), _amount(direction, direction.fails_at, digits))
        for digits in (3, 4, 5)
    ]
    return next((pair for pair in both if pair[0] != pair[1]), both[-1])
