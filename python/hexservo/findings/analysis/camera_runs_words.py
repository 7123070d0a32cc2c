"""Runs for the verdict on the camera as sentences (docs/analysis/camera_rate.md)."""

from __future__ import annotations

import numpy as np

from hexservo.findings.analysis.camera_margins import Margins
from hexservo.findings.analysis.camera_rate import LEAST_CHANGE, OF_GROWTH, CameraRate
from hexservo.findings.analysis.camera_runs import LimitBorder
from hexservo.findings.analysis.loop_of_scenario import OFFSET as START
from hexservo.findings.analysis.words import in_ms, number
from hexservo.run.leg_limits import LimitUse, limits_of_motion
from hexservo.scenario.leg_units import leg_units
from hexservo.scenario.pixels import feature_noise
from hexservo.scenario.wording import quantity

_ENDINGS = {
    "settles": "comes to rest",
    "held": "is held where it starts",
    "no nearer": "comes to rest no nearer to its goal than it started",
    "hunts": "hunts",
    "goes on": "does not come to rest",
    "limit": "takes a leg beyond a limit",
    "ended": "ends early",
    "open": "is undecided",
}


def starts_in_words(result: CameraRate, acting: Margins) -> list[str]:
    """Describe how the runs from small starts end, and whether the verdict follows them."""
    if not result.starts:
        return ["No run from a small start checks this: the law refuses the image of rest as a goal."]
    ends = " and ".join(
        f"the one from {run.offset:g} px {_ENDINGS[run.ending]} (at most {number(run.peak)} px, at the "
        f"end {number(run.end)} px, legs {number(1e3 * run.travel)} {_leg_unit(result)})"
        for run in result.starts
    )
    longest = max(run.duration for run in result.starts)
    text = f"Of runs of {longest:g} s from near the goal, with the scenario's K_v, {ends}"
    if result.settles is None:
        why = "they are inconclusive" if acting.stable and acting.drifts else "that is inconclusive"
        return [f"{text}: {why}, and the verdict is that of the linear loop.", *_hunting_in_words(result)]
    if result.settles == acting.stable:
        return [f"{text}, as the linear loop predicts.", *_hunting_in_words(result), *_causes_in_words(result)]
    return [
        f"{text}. The verdict follows these runs: the linear loop, taken {_taken(result)}, is "
        f"{'stable' if acting.stable else 'unstable'} and does not describe them.",
        *_hunting_in_words(result),
        *_causes_in_words(result),
    ]


def _taken(result: CameraRate) -> str:
    """Return where the linear loop is taken that does not describe the runs: without what acts in them."""
    without_kv = next((repeat for repeat in result.repeats if repeat.without == "switching"), None)
    if without_kv is not None and without_kv.rests != result.settles:
        return "with K_v = 0" if result.acting is not result.smooth else "with the slope of K_v at rest"
    without_fuzzy = next((repeat for repeat in result.repeats if repeat.without == "fuzzy"), None)
    learns = result.at_rest is not None and bool(result.at_rest.free.axes)
    if without_fuzzy is not None:
        learns = without_fuzzy.rests != result.settles
    return "at the initial weights of the fuzzy systems" if learns else "at rest"


def _hunting_in_words(result: CameraRate) -> list[str]:
    """Compare what hunts with the settling band and the noise."""
    late = max((run.late for run in result.starts if run.ending == "hunts"), default=None)
    if late is None:
        return []
    band, noise = result.scenario.metrics.band, feature_noise(result.scenario.camera)
    of_noise = f" and {number(100.0 * late / noise, 2)} % of the image noise" if noise > late else ""
    return [
        f"That hunting, of at most {number(late)} px, is {number(100.0 * late / band, 2)} % of metrics.band{of_noise}, "
        "and does not grow: it is no failure."
    ]


_WITHOUT = {
    "switching": ("with K_v = 0", "K_v"),
    "fuzzy": ("without the fuzzy systems", "what the fuzzy systems learn"),
    "camera": ("with a frame at every tick and no latency", "the camera"),
}


def _causes_in_words(result: CameraRate) -> list[str]:
    """State what acts in the runs, by those repeated without it."""
    if not result.repeats:
        return []
    rest = all(run.rests for run in result.starts)
    ends, within = [], " within the limits of the legs"
    for repeat in result.repeats:
        ends.append(f"{_WITHOUT[repeat.without][0]} they {'' if repeat.rests else 'do not '}come to rest{within}")
        within = ""
    named = " and ".join(_WITHOUT[repeat.without][1] for repeat in result.repeats if repeat.rests != rest)
    if not named:
        cause = "none of these is the cause"
    elif rest:
        cause = f"{named} brings them to rest"
    else:
        camera = any(repeat.without == "camera" and not repeat.rests for repeat in result.repeats)
        cause = f"the cause is {named}{', not the camera' * camera}"
    return [f"The same runs repeated: {', and '.join(ends)}. So {cause}."]


def legs_in_words(result: CameraRate, tick: float) -> list[str]:
    """Describe how stroke, speed and joints of the legs, which are not in the linear loop, limit period and latency."""
    found = []
    duration = quantity(result.scenario.simulation.duration, "s")
    perfect = next((border.perfect for border in result.limits.values() if border.perfect is not None), None)
    if perfect is not None:  # the scenario's own period and latency are one run
        own = next(iter(result.limits.values())).own
        with_it = "with a frame at every tick and no latency"
        if perfect.share > 1.0:
            also = f"{with_it} it {perfect.excess}: the camera is not the cause"
        else:
            also = f"{with_it} the legs stay within {_limits(result)} for {duration} (at most {_use(perfect)})"
        return [f"With the scenario's own camera the task {own.excess}; {also}."]
    for key, border in result.limits.items():
        if border.within is None:
            found.append(f"With the scenario's own {key} the task {border.use.excess}.")
        elif border.beyond is None:
            found.append(
                f"In runs of the task of {duration} at each {key} tried, up to {in_ms(border.largest * tick)}, the "
                f"legs stay within {_limits(result)} (at most {_use(border.use)}).{_at_end(result, border, tick)}"
            )
        else:
            kind = border.use.limit.kind
            what = {"stroke": "The stroke limits", "speed": "The speed of the legs limits"}.get(
                kind, f"The {kind.replace('_', ' ')}s limit"
            )
            found.append(
                f"{what} the {key}: runs of the task of {duration} keep the legs within {_limits(result)} up to "
                f"{in_ms(border.within * tick)}; at {in_ms(border.beyond * tick)} the task {border.use.excess}."
                f"{_at_end(result, border, tick)}"
            )
    return found


def _at_end(result: CameraRate, border: LimitBorder, tick: float) -> str:
    """Return that the run at the largest time within the limits is not over: a longer one may exceed them."""
    end = border.at_end
    if end is None:
        return ""
    unit = _leg_unit(result)
    return (
        f" At {in_ms(end.ticks * tick)} they still move at the end of the run, in the last "
        f"{quantity(end.lasts, 's', 2)} by up to {number(1e3 * end.moved)} {unit} at up to "
        f"{number(1e3 * end.speed)} {unit}/s: a longer run may take them farther."
    )


def _limits(result: CameraRate) -> str:
    """Return what the runs of the task are compared with."""
    limits = limits_of_motion(result.scenario)
    stroke = number(1e3 * result.scenario.robot.stroke)
    return f"their stroke of {stroke} {_leg_unit(result)}" if len(limits) == 1 else "their limits"


def _use(use: LimitUse) -> str:
    """Return the largest value of a run, with what it is of if that is not the travel."""
    unit, scale = use.limit.shown_unit
    value = f"{number(scale * use.peak)} {unit}"
    return value if use.limit.kind == "stroke" else f"{use.limit.of_leg} {value}, of {use.limit.text}"


def border_runs_in_words(result: CameraRate) -> list[str]:
    """Compare runs near the stability limit with the linear loop."""
    if not result.runs:
        return ["There was no stability limit to check by simulation."]
    inside, outside = result.runs
    name = {"gain": "gain", "latency": "latency", "period": "camera period"}[inside.key]
    offsets = " and ".join(dict.fromkeys(f"{run.offset:g} px" for run in result.runs))
    text = (
        f"A numerical check by two runs with K_v = 0 near the stability limit in {name}, from {offsets}: inside "
        f"predicted {inside.predicted:+.3g} 1/s, measured {inside.measured:+.3g} 1/s; outside "
        f"{outside.predicted:+.3g} 1/s, measured {outside.measured:+.3g} 1/s."
    )
    if not (inside.agrees and outside.agrees):
        if not any(run.conclusive and not run.agrees for run in result.runs):
            run = max((run for run in result.runs if not run.agrees), key=lambda run: run.change)
            return [
                f"{text} That is inconclusive: in {run.duration:.3g} s the predicted growth changes the motion by a "
                f"factor of {np.exp(run.change):.3g}, and what remains of other modes hides one below "
                f"{np.exp(LEAST_CHANGE):.2g}."
            ]
        return [text + " They disagree: the linear loop does not describe these runs."]
    grow = all(run.grows_as_predicted for run in result.runs if run.conclusive)
    if grow and any(run.offset < START for run in result.runs):
        text += f" From {START:g} px a run behaves differently: this far from its goal the loop is not linear."
    side = f", {100 * inside.apart:g} % on either side of the predicted one" if inside.key == "gain" else ""
    text += f" The stability limit lies between these two runs{side}."
    if not grow:
        share = f"{100 * OF_GROWTH:g} %"
        text += f" Their growth is not within {share} of the predicted: it has the predicted sign, and another size."
    return [text]


def _leg_unit(result: CameraRate) -> str:
    return leg_units(result.scenario.robot).small
