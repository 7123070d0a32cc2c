"""The drift of a law with a pose error as sentences, tables and curves (docs/analysis/drift.md)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo.findings.analysis.drift import GRID, LARGEST, SIZES, Drift
from hexservo.findings.analysis.drift_loop import LEAST
from hexservo.findings.analysis.drift_patterns import Pattern, Size, signs_of
from hexservo.findings.analysis.words import direction_words, finite, open_section
from hexservo.findings.evidence import Column, Curves, Item, Line, Section, Table, Verdict, picked

PAGE = "docs/analysis/drift.md"


def section(found: Drift) -> Section:
    """Return sentences, the sixteen patterns, the sizes, and the smallest rate over the size."""
    title = "Slow drift under unequal depth errors"
    if found.open_because:
        return open_section("drift", title, found.open_because)
    return Section("drift", title, _sentences(found), _items(found), _verdict(found), _data(found))


def _verdict(found: Drift) -> Verdict:
    assert found.own is not None
    loop, chosen = found.loop, _chosen(found)
    if found.own.slowest <= 0.0 or (loop is not None and not loop.own.stable):
        return "bad"
    doubtful = chosen.worst.slowest <= 0.0 or (loop is not None and loop.grows_at(chosen.size))
    return "warning" if doubtful or _beyond(found, found.own) else "good"


def _sentences(found: Drift) -> list[str]:
    assert found.own is not None
    chosen, worst = _chosen(found), _chosen(found).worst
    places = "start and goal" if found.has_goal else "the start (the goal image belongs to no pose)"
    words = [
        f"Of all sixteen signs of depth errors of {100 * chosen.size:.3g} % the worst is {worst.signs}: the "
        f"smallest eigenvalue of the loop matrix is {_at_poses(worst.start, worst.goal)}"
        f", along {direction_words(worst.direction, found.depth, found.small_shift)}."
    ]
    if worst.slowest > 0.0:
        words.append(
            f"There {found.law} creeps with a time constant of {_times(worst)} ({found.driven_by})"
            f"{_end_words(found, worst)}."
        )
    else:
        words.append(
            f"There {found.law} {'does not settle' if worst.frequency > 0.0 else 'drifts away'}: {_growth(worst)} "
            f"({found.driven_by}) until another effect stops it."
        )
    own = found.own
    if np.ptp(own.errors) > 0.0:
        text = "With the scenario's own depth errors"
        slow = f"the time constant is {_times(own)}{_end_words(found, own)}"
    else:
        text = f"The scenario's own depth errors are equal ({own.errors[0]:+.3g}):"
        slow = f"the slowest mode has a time constant of {_times(own)}"
    text += f" the smallest eigenvalue is {_at_poses(own.start, own.goal)}, and "
    words.append(text + (slow if own.slowest > 0.0 else _growth(own)) + ".")
    if own.slowest > 0.0 and found.loop is not None and not found.loop.own.stable:
        margins = found.loop.own
        turning = f" and oscillates at {margins.frequency:.3g} Hz" if margins.frequency > 0.0 else ""
        words.append(
            "This holds if the rest of the loop is fast, which it is not: the linear loop with inertia, sensors and "
            f"actuators grows at {margins.rate:.3g} 1/s{turning}; see the part camera_rate."
        )
    without = "; ".join(
        f"{s.negative_image_only[0]} of 14 at the start"
        + (f" and {s.negative_image_only[1]} at the goal" if found.has_goal else "")
        + f" at {100 * s.size:.3g} %"
        for s in found.sizes
    )
    if found.has_prior:
        words.append(f"Without the prior some of the 14 unequal patterns drift away: {without}.")
    if found.leaks:
        words.append("The leakage of the weights is neglected: it limits the drift and leaves an error instead.")
    if found.springs:
        words.append(
            f"In {found.springs} of the axes no pose error drives the platform: nothing drifts there, and they are "
            "excluded. No end of the drift is given."
        )
    if own.late_alone or worst.late_alone:
        words.append("Depth errors make eigenvalues of the loop matrix large: with a late image these modes oscillate.")
    slow_only = not found.finds_oscillations or (found.loop is not None and found.loop.limit is not None)
    moves = "drifts away" if slow_only else "drifts away or oscillates"
    limits = [limit for limit in (found.limit_start, found.limit_goal) if limit is not None]
    if limits:
        words.append(
            f"No pattern {moves} at {places} up to depth errors of {100 * min(limits):.3g} % (searched on "
            f"a grid of {GRID} sizes up to {100 * LARGEST:.3g} % and by bisection)."
        )
    else:
        words.append(f"No pattern {moves} at {places} up to {100 * LARGEST:.3g} %, the largest searched.")
    words.extend(_of_loop(found))
    return words


def _of_loop(found: Drift) -> list[str]:
    """Return from which size on the loop grows though the rates do not, or that this is not known."""
    if found.late > 0.0 and not found.finds_oscillations:
        return ["Oscillations are not analysed here: the linear loop of the part camera_rate does not apply."]
    if found.loop is None or found.loop.limit is None:
        return []
    if not found.loop.stable_if_exact:
        return ["The linear loop grows with exact depths too: see the part camera_rate."]
    limit = found.loop.limit
    size = f"from {100 * limit:.3g} %" if limit > 0.0 else f"from less than {100 * LEAST:g} %"
    return [
        f"The linear loop with inertia, sensors and actuators grows earlier: with the signs "
        f"{signs_of(found.loop.signs)} {size} on; see the part camera_rate."
    ]


def _at_poses(start: float, goal: float, unit: str = "") -> str:
    """Return a number at the start and at the goal, which is NaN without a goal pose."""
    first, second = f"{start:.3g}{unit}", f"{goal:.3g}{unit}"
    if np.isnan(goal):
        return f"{first} at the start"
    return f"{first} at start and goal" if first == second else f"{first} at the start and {second} at the goal"


def _times(pattern: Pattern) -> str:
    """Return the time constants of a creep at the start and at the goal."""
    return _at_poses(pattern.time_constant, pattern.goal_time_constant, " s")


def _growth(pattern: Pattern) -> str:
    """Return how fast the pose error grows: where it does so faster first, and how it changes at the other pose."""
    places = [("start", pattern.rate, pattern.time_constant)]
    if not np.isnan(pattern.goal_rate):
        places.append(("goal", pattern.goal_rate, pattern.goal_time_constant))
    (place, _, time), *others = sorted(places, key=lambda each: each[1])
    grows = "grows" if pattern.frequency == 0.0 else f"oscillates at {pattern.frequency:.3g} Hz and grows"
    text = f"the pose error {grows} e-fold in {-time:.3g} s at the {place}"
    for other, rate, time in others:
        how = f"in {-time:.3g} s" if rate <= 0.0 else f"it decays with a time constant of {time:.3g} s"
        text += f", and {how} at the {other}" if rate <= 0.0 else f", while at the {other} {how}"
    return text


def _end_words(found: Drift, pattern: Pattern) -> str:
    if pattern.end is None:
        return ""
    text = (
        f", and {pattern.end_time_constant:.3g} s at its end, {_end_from_home(pattern):.3g} mm from home, with "
        f"{pattern.end_error:.3g} px and {1e3 * pattern.end_travel:.3g} {found.leg_unit} of leg travel"
    )
    if not _beyond(found, pattern):
        return text
    if pattern.end_travel > found.stroke:
        return f"{text}, beyond the stroke of {1e3 * found.stroke:.3g} {found.leg_unit}"
    return f"{text}, beyond a joint limit"


def _end_from_home(pattern: Pattern) -> float | None:
    """Return how far the end of a drift is from home [mm]; None without one."""
    return None if pattern.end is None else 1e3 * float(np.linalg.norm(pattern.end[:3]))


def _items(found: Drift) -> list[Item]:
    chosen = _chosen(found)

    def at_goal(count: tuple[int, int]) -> int | None:
        return count[1] if found.has_goal else None

    items: list[Item] = [
        Table.of(
            f"Sign patterns of depth errors of {100 * chosen.size:.3g} %",
            sorted(chosen.patterns, key=lambda pattern: pattern.rank),
            [
                (Column("signs"), lambda p: p.signs),
                (Column("smallest eigenvalue, start", "1", ".3g"), lambda p: p.start),
                (Column("smallest eigenvalue, goal", "1", ".3g"), lambda p: finite(p.goal)),
                (Column("time constant, start", "s", ".3g"), lambda p: finite(p.time_constant)),
                (Column("time constant, goal", "s", ".3g"), lambda p: finite(p.goal_time_constant)),
                (Column("time constant, end", "s", ".3g"), lambda p: finite(p.end_time_constant)),
                (Column("end of the drift, from home", "mm", ".3g"), _end_from_home),
                (Column("image error there", "px", ".2g"), lambda p: finite(p.end_error)),
                (Column("leg travel there", found.leg_unit, ".3g"), lambda p: finite(1e3 * p.end_travel)),
                (Column("direction"), lambda p: direction_words(p.direction, found.depth, found.small_shift)),
            ],
            note="A negative time constant is that of growth. The end is where the pose error is zero, or, with an "
            "image spring and without fuzzy systems, the sum of the springs, by Newton's method on the core's law, "
            "without a gravity error.",
            page=PAGE,
        ),
        Table.of(
            "Sizes of depth errors",
            found.sizes,
            [
                (Column("depth errors", "%", ".3g"), lambda s: 100 * s.size),
                (Column("worst signs"), lambda s: s.worst.signs),
                (Column("its smallest rate", "1/s", ".3g"), lambda s: s.worst.slowest),
                (Column("negative, start", "of 14", "d"), lambda s: s.negative[0]),
                (Column("negative, goal", "of 14", "d"), lambda s: at_goal(s.negative)),
                (Column("prior in the inverse only, start", "of 14", "d"), lambda s: s.negative_inverse_only[0]),
                (Column("prior in the inverse only, goal", "of 14", "d"), lambda s: at_goal(s.negative_inverse_only)),
                (Column("no prior, start", "of 14", "d"), lambda s: s.negative_image_only[0]),
                (Column("no prior, goal", "of 14", "d"), lambda s: at_goal(s.negative_image_only)),
            ],
            note="Negative: a rate of the drift is, so that the pose error grows. Unequal signs only: 14 of the 16 "
            "patterns.",
            page=PAGE,
        ),
    ]
    if found.grid is not None and found.curves:
        lines = [
            Line(name, 100 * found.grid, values, "dashed" if "no prior" in name else "line")
            for name, values in found.curves.items()
        ]
        items.append(
            Curves(
                "Smallest rate of the drift over all sign patterns",
                "depth error [%]",
                "smallest real part [1/s]",
                lines,
                note="Below zero the pose error grows in some direction.",
                page=PAGE,
            )
        )
    return items


def _data(found: Drift) -> dict[str, Any]:
    assert found.own is not None

    def numbers(p: Pattern) -> dict[str, Any]:
        return {
            "signs": p.signs,
            "depth_errors": p.errors,
            "smallest_eigenvalue_start": p.start,
            "smallest_eigenvalue_goal": p.goal,
            **picked(p, "direction rate time_constant goal_rate frequency"),
            "end_displacement": p.end,
            **picked(p, "end_rate end_error"),
            "end_leg_travel": p.end_travel,
        }

    return {
        "applies": True,
        "law": found.law,
        "own": numbers(found.own),
        "sizes": [
            {
                "size": s.size,
                "worst": s.worst.signs,
                "negative": s.negative,
                "negative_prior_in_inverse_only": s.negative_inverse_only,
                "negative_without_prior": s.negative_image_only,
                "patterns": [numbers(p) for p in s.patterns],
            }
            for s in found.sizes
        ],
        **picked(found, "limit_start limit_goal"),
        "loop": None
        if found.loop is None
        else {
            "stable": found.loop.own.stable,
            **picked(found.loop.own, "rate frequency"),
            **picked(found.loop, "stable_if_exact limit"),
            "signs": signs_of(found.loop.signs),
        },
        "largest_searched": LARGEST,
    }


def _chosen(found: Drift) -> Size:
    """Return the scenario's size of depth errors, or 30 % where it has none."""
    assert found.own is not None
    size = float(np.abs(found.own.errors).max()) or SIZES[-1]
    return next(s for s in found.sizes if s.size == size)


def _beyond(found: Drift, pattern: Pattern) -> bool:
    """Return whether a drift leaves the legs' limits. Where none is searched it has no end (`ends`)."""
    return found.has_prior and not found.springs if pattern.end is None else pattern.end_left < 0.0
