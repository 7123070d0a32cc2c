"""Limits of camera period and latency as sentences, tables and a map (docs/analysis/camera_rate.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hexservo.findings.analysis.camera_margins import LARGEST_FACTOR, MOST_DRIFTS, Border, Margins
from hexservo.findings.analysis.camera_rate import CameraRate
from hexservo.findings.analysis.camera_runs_words import border_runs_in_words, legs_in_words, starts_in_words
from hexservo.findings.analysis.linear_loop import Clock
from hexservo.findings.analysis.loop_of_scenario import LoopAtRest, proportional_gains
from hexservo.findings.analysis.scene import scene_of
from hexservo.findings.analysis.words import AXES, finite, in_ms
from hexservo.findings.evidence import Cell, Column, HeatMap, Line, Section, Table, Verdict, picked
from hexservo.scenario.parameters import lost_frames_wait, timeout_room
from hexservo.scenario.scenario import Scenario
from hexservo.scenario.wording import quantity

PAGE = "docs/analysis/camera_rate.md"

ENOUGH_GAIN = 2.0
"""Factor on the gain below which the margin counts as small: 6 dB."""

_TITLE = "How fast must the camera be?"


def section(result: CameraRate) -> Section:
    """Return sentences, margins, the map and the runs that check it."""
    if result.open is not None or result.at_rest is None or result.clock is None or result.free is None:
        reason = result.open or "nothing was found"
        sentences = [f"The linear loop does not apply: {reason}."]
        if not result.scenario.controller.traits.viscous or scene_of(result.scenario).unusual_body:
            sentences.append(
                "The starting errors that settle with this camera are found by runs instead (empirical): see "
                "the part largest_start."
            )
        return Section("camera_rate", _TITLE, sentences, verdict="open", data={"open": reason})
    at_rest, clock, free = result.at_rest, result.clock, result.free
    acting = free if result.acting is None else result.acting
    return Section(
        "camera_rate",
        _TITLE,
        _sentences(result, at_rest, clock, free, acting),
        items=_items(result, at_rest, clock, free),
        verdict=_verdict(result, clock, acting),
        data=_data(result, at_rest, clock, free),
    )


def _verdict(result: CameraRate, clock: Clock, acting: Margins) -> Verdict:
    if not result.stable:
        damped = result.settles is None and result.smooth is not None and result.smooth.stable
        return "warning" if damped else "bad"
    if not acting.stable:  # the runs settle: what they learn, or K_v, holds what the linear loop does not
        return "warning"
    beyond = any(border.own.share > 1.0 for border in result.limits.values())
    small = acting.gain[1] is not None and acting.gain[1] < ENOUGH_GAIN
    waits = lost_frames_wait(result.scenario) / result.scenario.simulation.step
    late = acting.latency.unstable is not None and acting.latency.unstable - clock.latency - waits <= clock.period
    doubtful = any(run.conclusive and not run.agrees for run in result.runs)
    return "warning" if small or late or acting.drifts or doubtful or beyond or not acting.perfect else "good"


def _at_most(border: Border, tick: float, what: str) -> str:
    if border.stable is None:
        least, most = border.unstable or 0, border.looked_at
        extent = (
            f"from {in_ms(least * tick)} to {in_ms(most * tick)}" if most > least else f"down to {in_ms(least * tick)}"
        )
        return f"no {what} searched, {extent}, is stable"
    if border.least is not None:
        longest = in_ms((border.looked_at if border.unstable is None else border.stable) * tick)
        ends = "the largest searched" if border.unstable is None else "beyond which it is unstable again"
        return f"the {what} must be at least {in_ms(border.least * tick)}, and may be up to {longest}, {ends}"
    if border.unstable is None:
        return f"it is stable at every {what} searched, up to {in_ms(border.looked_at * tick)}"
    return f"the {what} may be at most {in_ms(border.stable * tick)}"


def _delay_margin(acting: Margins, clock: Clock, tick: float) -> str:
    if not acting.stable or acting.latency.stable is None or acting.latency.unstable is None:
        return ""
    return f": a delay margin of {in_ms((acting.latency.stable - clock.latency) * tick)}"


def _mode(frequency: float) -> str:
    return "without oscillation" if frequency < 1e-3 else f"at {frequency:.3g} Hz"


def _slowest(margins: Margins) -> str:
    """Return the growth of the slowest mode, beside that of a drift, which is no matter of the camera."""

    def growth(rate: float) -> str:
        return f"{'grows' if rate > 0.0 else 'decays'} at {abs(rate):.3g} 1/s"

    if margins.others_rate == margins.rate:
        return f"the slowest mode {growth(margins.rate)}"
    return f"the drift {growth(margins.rate)}, and the slowest of the other modes {growth(margins.others_rate)}"


def _sentences(result: CameraRate, at_rest: LoopAtRest, clock: Clock, free: Margins, acting: Margins) -> list[str]:
    tick = at_rest.scenario.simulation.step
    period, latency = in_ms(clock.period * tick), in_ms(clock.latency * tick)
    borders = (
        f"at its latency of {latency} {_at_most(acting.period, tick, 'period')} (it is {period}), and at its period "
        f"{_at_most(acting.latency, tick, 'latency')} (it is {latency}{_delay_margin(acting, clock, tick)})"
    )
    follows = result.stable is True and not acting.stable  # the verdict is that of runs
    if not acting.has_camera:
        if acting.drifts > MOST_DRIFTS:
            none = "The linear loop is stable with no camera" if follows else "No camera is fast enough"
            first = (
                f"{none}: even with a frame at every tick and no latency a mode of the loop grows. Several directions "
                "are driven the wrong way, as with a wrong sign of the image Jacobian (controller.jacobian, "
                "camera.convention)."
            )
        else:
            first = (
                f"No camera was found with which the {'linear ' if follows else ''}loop is stable: with a frame at "
                f"every tick and no latency a mode grows, and so it does {_NO_CAMERA}. The law's gains may not suit "
                "the servo period, the sensors or the actuators."
            )
    elif not acting.perfect:
        first = (
            "With a frame at every tick and no latency a mode of the loop grows: it is unstable with a perfect camera, "
            f"and {'stable' if acting.stable else 'unstable'} with this one: {borders}."
        )
    elif not acting.stable:
        damped = result.smooth is not None and result.smooth.stable
        which = "linear loop" if follows else "loop"
        first = f"{'Without K_v this' if damped else 'This'} camera is too slow for the {which}: {borders}."
    else:
        which = "linear loop, which does not decide" if result.stable is False else "loop"
        first = f"The camera is fast enough for the {which}: {borders}."
    found = [first]
    if acting.has_camera and acting.drifts:
        law = at_rest.scenario.controller.traits
        see = "; see the part equilibria" * (not law.pose_error) or "; see the part drift" * bool(law.inverse)
        drift = (
            f"{acting.drifts} of the modes drifts away with any camera, at {acting.drift_rate:.3g} 1/s with a perfect "
            "one: the assumed depths reverse a direction that is weakly observable in the image. The "
            f"limits are those of all other modes{see}."
        )
        found = [drift, first] if acting.stable else [first, drift]  # what decides the verdict comes first

    found.extend(legs_in_words(result, tick))
    found.append(
        f"Over one period of {period} the spectral radius is {acting.radius:.4g}: {_slowest(acting)} "
        f"{_mode(acting.others_frequency)}."
    )
    below, above = acting.gain
    *gains, last = proportional_gains(at_rest.scenario)
    what = f"The proportional gains ({' and '.join([', '.join(gains), last] if gains else [last])})"
    if acting.stable and above is not None:
        found.append(f"{what} may be multiplied by up to {above:.3g}; then a mode begins to grow{_which(acting)}.")
    if acting.stable and below is not None:
        found.append(f"{what} must not be multiplied by less than {below:.3g}.")
    if not acting.stable and below is not None:
        found.append(
            f"{what} times {below:.3g} or less would be stable with this camera; at that limit a mode oscillates"
            f"{_which(acting)}."
        )
    if acting.stable and above is None and below is None:
        found.append(f"{what} may be multiplied or divided by {LARGEST_FACTOR:g}: no limit was found.")
    if acting.resting:
        found.append(
            f"{acting.resting} modes are neutral with any camera, and are excluded: they have no stiffness, "
            "or fuzzy systems driven by the rate alone (drive 0) make them a spring towards the start."
        )
    starts = starts_in_words(result, acting)
    found = [*found, *starts] if result.stable == acting.stable else [*starts, *found]
    found.extend(_about_learned(result, tick))
    found.extend(_about_kv(result, free, tick))
    found.extend(border_runs_in_words(result))
    found.extend(_about_limits(result, at_rest, clock, acting))
    return found


def _which(margin: Margins) -> str:
    if margin.motion is None:
        return ""
    return f" {_mode(margin.border_frequency)}, mostly {AXES[int(np.argmax(margin.motion))]}"


def _about_kv(result: CameraRate, free: Margins, tick: float) -> list[str]:
    if result.smooth is None:
        return []
    width = result.scenario.controller.switching.width
    smooth = result.smooth
    kind = result.scenario.controller.switching.kind
    slope = f"the slope k_v/width of tanh or saturation (width {width:g} m/s and rad/s)"
    other, text = (free, "With K_v = 0") if result.acting is smooth else (smooth, f"With {slope}")
    taken = f"K_v acts with {slope}" if result.acting is smooth else f"K_v counts as zero, since {kind} has no slope"
    if other.has_camera:
        verdict = "would be stable" if other.stable else "would be unstable"
        rest = f"{verdict}; {_at_most(other.period, tick, 'period')}, and {_at_most(other.latency, tick, 'latency')}"
    else:
        rest = f"would be unstable {_without_camera(other)}"
    return [f"{taken}. {text} the loop {rest}."]


# What a search without a stable camera covers: two lines, not all pairs of period and latency.
_NO_CAMERA = "at this latency with every period searched, and at this period with every latency searched"


def _without_camera(margins: Margins) -> str:
    return "with any camera" if margins.drifts > MOST_DRIFTS else f"with this camera, and {_NO_CAMERA}"


def _about_learned(result: CameraRate, tick: float) -> list[str]:
    """Describe the linear loop at the weights of the task's own run."""
    if result.at_rest is None or not result.at_rest.free.axes:
        return []
    learned = result.learned
    if learned is None:
        return ["The task itself does not settle in the sampled loop: there are no learned weights to linearise at."]
    mode = _slowest(learned)
    if not learned.has_camera:
        none = _without_camera(learned)
        return [f"At the weights at the end of the task's own run the loop is unstable {none}: {mode}."]
    verdict = f"{'stable' if learned.stable else 'unstable'}{' except for drift' * (learned.drifts > 0)}"
    return [
        f"At the weights at the end of the task's own run the loop is {verdict}: "
        f"{mode}; {_at_most(learned.period, tick, 'period')}, and {_at_most(learned.latency, tick, 'latency')}."
    ]


def _lost_frames_in_words(scenario: Scenario, clock: Clock, acting: Margins, tick: float) -> str:
    """Return how much older lost frames make the image, and whether a latency that is longer by that is stable."""
    outside = "Lost frames are not part of the linear loop"
    wait = lost_frames_wait(scenario)
    if wait == 0.0:
        return f"{outside}; here no frame arrives."
    late = clock.latency * tick + wait
    stable = acting.latency.stable
    what = f"{outside}: on average they make the image {quantity(wait, 's')} older (camera.dropout)"
    if stable is None or acting.latency.unstable is None:
        return f"{what}."
    side = "beyond" if late > stable * tick else "inside"
    return f"{what}; a latency that is longer by that, {quantity(late, 's')}, is {side} the limit, if it were constant."


def _about_limits(result: CameraRate, at_rest: LoopAtRest, clock: Clock, acting: Margins) -> list[str]:
    scenario, tick = result.scenario, at_rest.scenario.simulation.step
    found = []
    if at_rest.as_if_sampled:
        found.append(
            "The scenario is in continuous mode, without camera timing: this is the loop in sampled "
            f"mode, with a servo period of {in_ms(tick)} and the period and latency of its camera block."
        )
    if scenario.camera.latency_jitter > 0.0:
        longest = clock.latency + round(scenario.camera.latency_jitter / tick)
        beyond = acting.latency.stable is not None and longest > acting.latency.stable
        found.append(
            f"The latency is taken as constant. The longest one with jitter, {in_ms(longest * tick)}, is "
            + ("beyond the limit." if beyond else "inside the limit, if it were constant.")
        )
    if scenario.camera.dropout > 0.0:
        found.append(_lost_frames_in_words(scenario, clock, acting, tick))
    if (room := timeout_room(scenario)) is not None:
        both = (("period", clock.period, acting.period), ("latency", clock.latency, acting.latency))
        ends = [
            f"a {key} of {in_ms((own + room) * tick)}"
            for key, own, border in both
            if border.unstable is None and border.looked_at == own + room
        ]
        if ends:
            found.append(
                f"The search ends at {' and at '.join(ends)}: the camera's timeout of "
                f"{in_ms(scenario.camera.timeout or 0.0)} (camera.timeout) has no room for longer ones."
            )
    if at_rest.rest.residual > 1.0:
        found.append(
            f"The loop rests where a feature is {at_rest.rest.residual:.3g} px from its goal: the prior draws it "
            "towards home, or the goal image belongs to no pose."
        )
    return found


def _number(border: Border, tick: float, less: int = 0) -> Cell:
    """Return a limit in ms, less some ticks; as text if none was found."""
    if border.stable is None:
        return None
    value = 1e3 * (border.stable - less) * tick
    return value if border.unstable is not None else f"at least {value:.4g}"


def _least(border: Border, tick: float) -> Cell:
    """Return the shortest stable time in ms, where a shorter one is not stable."""
    return None if border.least is None else 1e3 * border.least * tick


def _items(result: CameraRate, at_rest: LoopAtRest, clock: Clock, free: Margins) -> list[Table | HeatMap]:
    tick = at_rest.scenario.simulation.step
    all_three = {"K_v = 0": free, "slope k_v/width": result.smooth, "learned weights": result.learned}
    columns = {head: margins for head, margins in all_three.items() if margins is not None}

    def row(name: str, unit: str, of: Callable[[Margins], Cell]) -> list[Cell]:
        return [name, unit, *(of(margins) for margins in columns.values())]

    rows = [
        row("spectral radius over one period", "", lambda m: m.radius),
        row("growth of the slowest mode, drifts included", "1/s", lambda m: m.rate),
        row("growth of the slowest mode that does not drift", "1/s", lambda m: m.others_rate),
        row("smallest stable period at this latency", "ms", lambda m: _least(m.period, tick)),
        row("largest stable period at this latency", "ms", lambda m: _number(m.period, tick)),
        row("smallest stable latency at this period", "ms", lambda m: _least(m.latency, tick)),
        row("largest stable latency at this period", "ms", lambda m: _number(m.latency, tick)),
        row("delay margin", "ms", lambda m: _number(m.latency, tick, clock.latency) if m.stable else None),
        row("gain factor at the limit, upwards", "", lambda m: m.gain[1]),
        row("gain factor at the limit, downwards", "", lambda m: m.gain[0]),
        row("frequency of the mode at the limit", "Hz", lambda m: finite(m.border_frequency)),
        row("modes that drift with any camera", "", lambda m: m.drifts),
        row("neutral modes, excluded", "", lambda m: m.resting),
    ]
    longest = in_ms(max(free.period.looked_at, free.latency.looked_at) * tick)
    items: list[Table | HeatMap] = [
        Table(
            "Margins of the linear sampled loop at the goal",
            [Column("quantity"), Column("unit"), *(Column(head) for head in columns)],
            rows,
            note=f"Periods and latencies are whole ticks, searched up to {longest}; gain factors between "
            f"{1 / LARGEST_FACTOR:g} and {LARGEST_FACTOR:g}. An empty cell: there is none. All columns are at the "
            "initial weights of the fuzzy systems, except the one at the final weights of the task's own run.",
            page=PAGE,
        )
    ]
    if result.periods is not None and result.latencies is not None and result.radii is not None:
        here = Line(
            "this scenario", np.array([1e3 * clock.period * tick]), np.array([1e3 * clock.latency * tick]), "points"
        )
        items.append(
            HeatMap(
                "Spectral radius over one camera period",
                "camera period [ms]",
                "camera latency [ms]",
                "spectral radius",
                1e3 * result.periods,
                1e3 * result.latencies,
                result.radii,
                levels=(1.0,),
                lines=(here,),
                note="K_v = 0. Where the radius is above 1 the loop is unstable"
                + (", except for drifts." if free.drifts else ".")
                + f" Empty where more than {at_rest.free.few} frames are in transit at once.",
                page=PAGE,
            )
        )
    if result.runs:
        items.append(
            Table.of(
                "Runs near the stability limit",
                result.runs,
                [
                    (Column("varied"), lambda run: run.key),
                    (Column("value", "1 or s"), lambda run: run.value),
                    (Column("start", "px"), lambda run: run.offset),
                    (Column("predicted growth", "1/s", "+.3g"), lambda run: run.predicted),
                    (Column("measured growth", "1/s", "+.3g"), lambda run: finite(run.measured)),
                    (Column("agrees"), lambda run: run.agrees),
                ],
                note="The goal image is that from home; no noise, K_v = 0. An empty growth: the run ended early.",
                page=PAGE,
            )
        )
    return items


def _data(result: CameraRate, at_rest: LoopAtRest, clock: Clock, free: Margins) -> dict[str, Any]:
    tick = at_rest.scenario.simulation.step

    def times(border: Border) -> dict[str, float | None]:
        limit = None if border.stable is None else border.unstable  # else the least searched, which is no limit
        return {
            "smallest_stable": None if border.least is None else border.least * tick,
            "largest_stable": None if border.stable is None else border.stable * tick,
            "smallest_unstable": None if limit is None else limit * tick,
            "looked_at": border.looked_at * tick,
        }

    def numbers(one: Margins) -> dict[str, Any]:
        return {
            "stable": one.stable,
            "spectral_radius": one.radius,
            "growth": one.rate,
            "frequency": one.frequency,
            "growth_without_drifts": one.others_rate,
            "frequency_without_drifts": one.others_frequency,
            "drifts": one.drifts,
            "drift_growth": one.drift_rate,
            "stable_with_perfect_camera": one.perfect,
            "resting_modes": one.resting,
            "period": times(one.period),
            "latency": times(one.latency),
            "gain": {"below": one.gain[0], "above": one.gain[1]},
            "border_frequency": one.border_frequency,
            "border_motion": one.motion,
        }

    return {
        "period": clock.period * tick,
        "latency": clock.latency * tick,
        "as_if_sampled": at_rest.as_if_sampled,
        "residual": at_rest.rest.residual,
        **picked(at_rest.rest.view.pose, "position quaternion"),
        "without_kv": numbers(free),
        "with_slope": None if result.smooth is None else {"slope": at_rest.slope, **numbers(result.smooth)},
        "with_learned_weights": None if result.learned is None else numbers(result.learned),
        "settles": result.settles,
        "starts": [
            {
                **picked(run, "offset duration ending"),
                "peak_error": run.peak,
                "end_error": run.end,
                "late_error": run.late,
                "leg_travel": run.travel,
            }
            for run in result.starts
        ],
        "limits": {
            key: {
                "within": None if border.within is None else border.within * tick,
                "beyond": None if border.beyond is None else border.beyond * tick,
                "largest": border.largest * tick,
                "limit": border.use.limit.kind,
                "share": finite(border.use.share),
                "own_limit": border.own.limit.kind,
                "own_share": finite(border.own.share),
                "at_end": None if border.at_end is None else picked(border.at_end, "lasts moved speed"),
            }
            for key, border in result.limits.items()
        },
        "acting": "with_slope" if result.acting is result.smooth and result.smooth is not None else "without_kv",
        "map": {"periods": result.periods, "latencies": result.latencies, "spectral_radius": result.radii},
        "runs": [{"varied": run.key, **picked(run, "value offset predicted measured")} for run in result.runs],
    }
