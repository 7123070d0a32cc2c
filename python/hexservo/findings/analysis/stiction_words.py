"""The stiction set and the runs that check it as sentences, tables and curves (docs/analysis/stiction.md)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hexservo.findings.analysis.scene import Scene
from hexservo.findings.analysis.stiction import Stiction, StictionCase
from hexservo.findings.analysis.stiction_motors import HeldLegs
from hexservo.findings.analysis.stiction_runs import Runs
from hexservo.findings.analysis.stiction_set import SPAN, Extremes
from hexservo.findings.analysis.words import AXES, number
from hexservo.findings.evidence import Cell, Column, Curves, Item, Line, Section, Table, Verdict, picked
from hexservo.scenario.wording import quantity

PAGE = "docs/analysis/stiction.md"


def section(found: Stiction) -> Section:
    """Return the findings as sentences, tables and curves."""
    return Section(
        name="stiction",
        title="Stiction: residual errors held by the switching term",
        sentences=_sentences(found),
        items=_items(found),
        verdict=_verdict(found),
        data=_data(found),
    )


def _verdict(found: Stiction) -> Verdict:
    if found.kind == "none":
        return "good"
    error = found.prior_error
    if found.legs is not None:
        error = _left_by(found.legs)
    if found.cases:
        ends = found.cases[0].ends
        if ends is None:
            return "bad"
        error = _largest(found) if found.creep is None else found.creep.left
    if error is None:
        return "open"
    return "warning" if error > found.scene.band else "good"


def _largest(found: Stiction) -> float:
    """Return the largest image error of all cases that have poses [px]: linear, or of a pose that was checked."""
    return max(max(case.ends.largest, case.confirmed or 0.0) for case in found.cases if case.ends is not None)


def _left_by(legs: HeldLegs) -> float:
    """Return the largest image error that dry friction of motors leaves under the law [px]."""
    return legs.largest if legs.integrated is None else min(legs.largest, legs.integrated)


def _of_motors(reason: str, legs: HeldLegs, scene: Scene) -> list[str]:
    unit = scene.units.coordinate
    feeds_back = getattr(scene.scenario.controller.gains, "feedback", 0.0) > 0.0
    kp = "(kp (1 + feedback))" if feeds_back else "kp"
    words = [
        f"{reason}, up to friction/{kp} = {quantity(legs.held, unit)} from those of the goal: there this and the "
        f"weight (up to {quantity(float(np.abs(legs.sag).max()), unit)}) leave image errors of up to "
        f"{number(legs.largest)} px in a coordinate, where {number(scene.band)} px count as settled."
    ]
    if legs.integrated is not None:
        words.append(
            "The integral of the law moves the legs on until at most twice its band is left, "
            f"{number(legs.integrated)} px."
        )
    elif legs.largest > scene.band:
        words.append(
            "The law has no integral, so this error remains: it takes motors with a larger kp or less friction, or the "
            "law tracking with an integral above 0."
        )
    return words


def _sentences(found: Stiction) -> list[str]:
    if found.legs is not None:
        return _of_motors(found.reason, found.legs, found.scene)
    if found.kind in ("none", "open", "integrated"):
        words = [found.reason]
        if found.prior_error is not None:
            words.append(
                f"There the image is {number(found.prior_error)} px off: the prior, which expects home, "
                "dominates the poorly observable directions."
            )
        return words
    words = [_of_the_set(found, found.cases[0])]
    if found.reason:
        words.append(found.reason)
    if found.creep is not None:
        words.append(_of_creep(found))
    for case in found.cases[1:]:
        if case.ends is not None:
            checked = "" if case.confirmed is None else f", {number(case.confirmed)} px at a checked pose"
            words.append(f"{case.name}: {_reach(case)} {number(case.ends.largest)} px{checked}.")
        else:
            words.append(f"{case.name}: no pose within the stroke.")
    words += [_of_runs(runs) for runs in found.runs]
    return words


def _of_the_set(found: Stiction, case: StictionCase) -> str:
    ends = case.ends
    if ends is None:
        worst = int(np.argmax(np.abs(found.gravity_error) - found.kv))
        excess = (
            f": the gravity error of {number(abs(found.gravity_error[worst]))} N is beyond K_v "
            f"({number(found.kv[worst])} N)"
            if abs(found.gravity_error[worst]) > found.kv[worst]
            else ""
        )
        return f"No pose within the stroke near the goal is an equilibrium{excess}."
    if (case.rest.high == case.rest.low).all():
        exact = ends.largest < 1e-6
        error = "below 1e-6 px" if exact else f"of {number(ends.largest)} px"
        return f"The equilibrium near the goal is a point, with an image error {error}."
    axes, legs, span = case.rest.limits_at(ends.displacements[0])
    limits = [f"K_v ({', '.join(AXES[axis] for axis in np.flatnonzero(axes))})"] if axes.any() else []
    limits += (
        [f"the stroke of the legs {', '.join(str(leg + 1) for leg in np.flatnonzero(legs))}"] if legs.any() else []
    )
    limits += [f"the span of the linearisation ({SPAN:.0%} of the depth, {SPAN} rad)"] if span.any() else []
    holds = "K_v holds" if found.creep is None else "K_v would hold"
    text = (
        f"{holds} the platform with image errors of {_reach(case)} {number(ends.largest)} px in a coordinate "
        f"({number(ends.rms)} px RMS), {number(1e3 * ends.largest / found.focal_pixels)} mrad at the focal length; "
        f"the set is limited by {' and '.join(limits)}. Its optical axis is up to {number(1e3 * ends.turn)} mrad "
        "from that at the goal."
    )
    if case.confirmed is not None:
        text += (
            f" At a pose with {number(case.confirmed)} px the law itself is within K_v, and every leg within its "
            f"stroke{': the set is linear, and its limit approximate' * (_reach(case) == 'about')}."
        )
    for runs in found.runs:
        if not runs.fuzzy and runs.counted.any() and (share := _share_of_bound(runs)) > 1.0:
            text += (
                f" These are linear: of the runs to other goals, below, one rests at {share:.0%} of the linear value "
                "there."
            )
    return text


def _reach(case: StictionCase) -> str:
    """Return "up to", or "about" for a set whose linear limit a pose exceeds at which the law is within K_v."""
    beyond = case.ends is not None and case.confirmed is not None and case.confirmed > case.ends.largest
    return "about" if beyond else "up to"


def _share_of_bound(runs: Runs) -> float:
    """Return the largest error of the runs at rest over that of the linear set around home."""
    return float(runs.final_error[runs.counted].max()) / runs.bound


def _of_creep(found: Stiction) -> str:
    creep = found.creep
    assert creep is not None
    duration = found.scene.scenario.simulation.duration
    swings, slowest = creep.frequency > 0.0, creep.times[0]
    if swings and np.isinf(creep.decay):
        text = f"It does not come to rest: an oscillation at {number(creep.frequency)} Hz grows"
    elif np.isinf(slowest):
        text = "In some direction it is not restoring"
    else:
        text = f"Its slowest mode has a time constant of {number(slowest)} s"
        if swings:
            text += f", and one that oscillates at {number(creep.frequency)} Hz has {number(creep.decay)} s"
    if creep.left is not None:
        text += f"; from the end of a run of {number(duration)} s on, up to {number(creep.left)} px are left"
    return text + "."


def _of_runs(runs: Runs) -> str:
    counted = runs.counted
    with_fuzzy = "with" if runs.fuzzy else "without"
    bound = runs.bound
    if runs.too_short:
        return (
            f"Runs of {quantity(runs.duration, 's')} {with_fuzzy} fuzzy systems are too short to find which platforms "
            "rest: a longer simulation.duration has longer ones, up to 2 s."
        )
    if not counted.any():
        return f"Of {len(counted) - 1} runs of {number(runs.duration)} s {with_fuzzy} fuzzy systems none came to rest."
    beyond = int((runs.slow & ~counted).sum())
    turning = (
        f"; {beyond} more {'is' if beyond == 1 else 'are'} as slow at the end, but beyond K_v, and will move on"
        if beyond
        else ""
    )
    largest = float(runs.final_error[counted].max())
    own = (
        f"; the scenario's own goal is {number(runs.final_error[0])} px away after this time"
        if runs.completed[0]
        else ""
    )
    return (
        f"Of {len(counted) - 1} runs of {number(runs.duration)} s {with_fuzzy} fuzzy systems to goals near the start "
        f"{int(counted.sum())} came to rest within K_v, with up to {number(largest)} px: "
        f"{_share_of_bound(runs):.0%} of the {number(bound)} px that the set has there"
        + (", including the output of the fuzzy systems" if runs.fuzzy else "")
        + f"{turning}{own}."
    )


def _items(found: Stiction) -> list[Item]:
    items: list[Item] = []
    if found.cases:
        items += [_case_table(found), _axis_table(found)]
    if found.runs:
        items += [_run_table(found), _run_curves(found)]
    return items


def _case_table(found: Stiction) -> Table:

    def of(value: Callable[[Extremes], float]) -> Callable[[StictionCase], float | None]:
        return lambda case: None if case.ends is None else value(case.ends)

    return Table.of(
        "Set held by K_v around the goal",
        found.cases,
        [
            (Column("case"), lambda case: case.name),
            (Column("largest coordinate", "px", ".3g"), of(lambda ends: ends.largest)),
            (Column("RMS", "px", ".3g"), of(lambda ends: ends.rms)),
            (Column("at the focal length", "mrad", ".3g"), of(lambda ends: 1e3 * ends.largest / found.focal_pixels)),
            (Column("optical axis", "mrad", ".3g"), of(lambda ends: 1e3 * ends.turn)),
            (Column("checked pose", "px", ".3g"), lambda case: case.confirmed),
            (Column("across", "mm", ".3g"), of(lambda ends: 1e3 * float(ends.pose[:2].max()))),
            (Column("along z", "mm", ".3g"), of(lambda ends: 1e3 * float(ends.pose[2]))),
            (Column("turned", "mrad", ".3g"), of(lambda ends: 1e3 * float(ends.pose[3:].max()))),
        ],
        note="Linear programs over the box of K_v and the stroke of the legs, linearised at the pose nearest to home "
        "with the goal image within 0.1 px; tau_f = 0 unless stated. Checked pose: the law itself and "
        "the legs were evaluated there.",
        page=PAGE,
    )


def _axis_table(found: Stiction) -> Table:
    way = np.zeros(6) if found.straight_way is None else found.straight_way

    def largest(axis: int) -> float | None:
        outputs = (runs.fuzzy_output[runs.counted, axis] for runs in found.runs)
        return max((float(np.abs(output).max(initial=0.0)) for output in outputs), default=None)

    return Table.of(
        "Wrenches on a platform at rest, by axis",
        range(6),
        [
            (Column("axis"), lambda axis: f"{'force' if axis < 3 else 'moment'} {AXES[axis]}"),
            (Column("unit"), lambda axis: "N" if axis < 3 else "N m"),
            (Column("K_v", format=".3g"), lambda axis: float(found.kv[axis])),
            (Column("gravity error", format=".3g"), lambda axis: float(found.gravity_error[axis])),
            (Column("fuzzy systems, straight path", format=".3g"), lambda axis: float(way[axis])),
            (Column("fuzzy systems, largest in the runs", format=".3g"), largest),
        ],
        note="Straight path: output of one rule between home and the goal, displacement/Psi.",
        page=PAGE,
    )


def _run_table(found: Stiction) -> Table:
    rows: list[Sequence[Cell]] = []
    for runs in found.runs:
        counted = runs.counted
        inside = runs.start_share <= 1.0
        values = (runs.start_error, runs.final_error, runs.final_share)
        for name, which in (("inside", counted & inside), ("outside", counted & ~inside)):
            rows.append(
                [
                    "on" if runs.fuzzy else "off",
                    name,
                    int(which.sum()),
                    *(float(of[which].max()) if which.any() else None for of in values),
                ]
            )
    return Table(
        title="Runs to goals near the start",
        columns=(
            Column("fuzzy systems"),
            Column("started"),
            Column("at rest"),
            Column("largest error at the start", "px", ".3g"),
            Column("largest error at the end", "px", ".3g"),
            Column("largest share of K_v at the end", format=".3g"),
        ),
        rows=rows,
        note="Inside: the law's wrench at the start is within K_v. Share: largest |w_j - tau_f,j|/k_v,j.",
        page=PAGE,
    )


def _run_curves(found: Stiction) -> Curves:
    lines = [
        Line(
            f"fuzzy systems {'on' if runs.fuzzy else 'off'}",
            runs.start_error[runs.counted],
            runs.final_error[runs.counted],
            "points",
        )
        for runs in found.runs
    ]
    widest = max(float(line.x.max(initial=0.0)) for line in lines)
    for runs in found.runs:
        name = "largest of the set" + (", with the output of the fuzzy systems" if runs.fuzzy else "")
        lines.append(Line(name, np.array([0.0, widest]), np.full(2, runs.bound), "dashed"))
    return Curves(
        title="Where runs come to rest",
        x_label="largest error at the start [px]",
        y_label="largest error at the end [px]",
        lines=lines,
        page=PAGE,
    )


def _data(found: Stiction) -> dict[str, object]:
    return {
        **picked(found, "kind reason kv gravity_error"),
        "creep_times": None if found.creep is None else found.creep.times,
        "creep_frequency": None if found.creep is None else found.creep.frequency,
        "creep_decay": None if found.creep is None else found.creep.decay,
        "creep_left": None if found.creep is None else found.creep.left,
        "fuzzy_straight_way": found.straight_way,
        "prior_error": found.prior_error,
        "motors": None
        if found.legs is None
        else {
            **picked(found.legs, "held sag"),
            "largest_error": found.legs.largest,
            "integrated_error": found.legs.integrated,
        },
        "cases": [
            {
                "name": case.name,
                "equilibrium": case.ends is not None,
                "largest_error": None if case.ends is None else case.ends.largest,
                "rms_error": None if case.ends is None else case.ends.rms,
                "angle_at_focal_length": None if case.ends is None else case.ends.largest / found.focal_pixels,
                "optical_axis_turn": None if case.ends is None else case.ends.turn,
                "confirmed_error": case.confirmed,
                "pose": None if case.ends is None else case.ends.pose,
            }
            for case in found.cases
        ],
        "around_home": None
        if found.around_home is None or found.around_home.ends is None
        else found.around_home.ends.largest,
        "runs": [
            picked(runs, "fuzzy duration too_short bound slow counted start_error final_error start_share final_share")
            for runs in found.runs
        ],
    }
