"""V and its rate as sentences, a table and curves (docs/certificate/lyapunov.md)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexservo.findings.certificate.lyapunov import Lyapunov
from hexservo.findings.certificate.uncertainty import AXES
from hexservo.findings.evidence import Column, Curves, Line, Section, Table, Verdict, picked
from hexservo.run.samples import extreme_samples
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import SMOOTH_KINDS
from hexservo.scenario.wording import counted, joules, number, shown_unit

PAGE = "docs/certificate/lyapunov.md"
_ROWS = 12  # of the table of rises, at most
_SHOWN = 1500  # points of a line of markers, at most


def section(found: Lyapunov) -> Section:
    """Return sentences, the table of rises, and curves of V, of its change and of its rate."""
    title = "Lyapunov function along the run"
    return Section("lyapunov", title, _sentences(found), _items(found), _verdict(found), _data(found))


def _gap(found: Lyapunov) -> tuple[float, float]:
    """Return the largest and the RMS difference of the two rates [W]; NaN where none were compared."""
    gap = np.abs(found.disagreement[np.isfinite(found.differentiated)])
    return (float(gap.max()), float(np.sqrt(np.mean(gap**2)))) if len(gap) else (np.nan, np.nan)


def _rising(found: Lyapunov) -> int:
    return sum(rise.samples for rise in found.rises)


def _sentences(found: Lyapunov) -> list[str]:
    change, top, rising = float(found.change[-1]), float(found.change.max()), _rising(found)
    sentences = []
    if not found.compared:
        sentences.append("No sample has enough neighbours without a switch: V-dot could not be compared.")
    elif not found.agrees:
        sentences.append(
            "The two rates of V do not agree: their RMS difference is more than half of the rate itself. The step "
            f"is too coarse to locate the growth of V; from start to end it changed by {joules(change)}."
        )
    elif rising == 0:
        sentences.append(
            f"V-dot was not positive beyond the integrator's error at any of the {found.compared} samples compared "
            f"(of {len(found.time)}); V changed by {joules(change)} in all."
        )
        if found.above_start:
            highest = float(found.time[int(found.change.argmax())])
            sentences.append(
                f"However, V was {joules(top, 3)} above its start at t = {highest:.4g} s: it grew where that "
                "error is large, or at samples that are left out."
            )
    else:
        worst = max(found.rises, key=lambda rise: rise.rate)
        sentences.append(
            f"V grew at {rising} of {found.compared} samples compared (of {len(found.time)}), by up to "
            f"{joules(worst.rate, 3, 'W')} at t = {worst.first:.4g} to {worst.last:.4g} s, mostly due to "
            f"{AXES[worst.axis]} ({worst.term}; gamma = {worst.gamma:.3g} there); "
            f"over the whole run V changed by {joules(change)}."
        )
    if found.compared:
        largest, rms = (joules(each, 2, "W") for each in _gap(found))
        scale = joules(float(np.abs(found.predicted).max()), 4, "W")
        sentences.append(
            f"V-dot by differences and by (20) differ by {largest} at most and {rms} RMS, of up to {scale}; where all "
            "is smooth the difference falls with the fourth power of the step."
        )
    start = float(found.value[0])
    sentences.append(
        f"V starts at {number(start)} J, of which {number(float(found.weight[0]))} J are the distance of the "
        f"weights from the best ones, and was at most {joules(max(top, 0.0), 3)} above its start."
    )
    if found.switched:
        sentences.append(
            f"{found.switched} of {len(found.time)} samples lie next to a step in which sgn changes and are left "
            f"out: V-dot jumps there. In those steps V changed by {joules(found.change_in_switches, 3)} in all, "
            f"and grew by at most {joules(found.rise_in_a_switch, 2)} in one."
        )
    if found.limited:
        sentences.append(
            f"{found.limited} samples lie next to a step that the weights' limit cut and are left out; the cut "
            "itself never raises V, since w* keeps the limit."
        )
    if rising and found.switching in SMOOTH_KINDS:
        sentences.append(
            f"With {found.switching} K_v acts in full only outside of its layer: V may grow inside it although the "
            "assumption holds."
        )
    return [
        *sentences,
        "This is a numerical check at the samples of one trajectory and proves no stability. V contains w*, which "
        "is known only afterwards. Even a V that falls from every start means stability, not convergence: the "
        "switching term may hold an error by dry friction.",
    ]


def _data(found: Lyapunov) -> dict[str, Any]:
    largest, rms = _gap(found)
    return {
        **{
            name: {
                "total": float(found.value[at]),
                "kinetic": float(found.kinetic[at]),
                "image": float(found.image[at]),
                "weights": float(found.weight[at]),
            }
            for name, at in (("start", 0), ("end", -1))
        },
        "change": float(found.change[-1]),
        "largest_above_start": float(found.change.max()),
        "disagreement_max": largest,
        "disagreement_rms": rms,
        "rates_agree": found.agrees,
        "largest_rate": float(np.abs(found.predicted).max()),
        "samples": len(found.time),
        "samples_compared": found.compared,
        "samples_left_out_switching": found.switched,
        "samples_left_out_limit": found.limited,
        **picked(found, "change_in_switches rise_in_a_switch"),
        "samples_rising": _rising(found),
        "rises": [vars(rise) for rise in found.rises],
    }


def _verdict(found: Lyapunov) -> Verdict:
    if not found.agrees:
        return "warning" if found.above_start else "open"
    return "warning" if found.rises or found.above_start else "good"


def _items(found: Lyapunov) -> tuple[Table | Curves, ...]:
    time = found.time
    floor = np.finfo(float).tiny
    rises = sorted(found.rises, key=lambda rise: -rise.rate)
    grows, per_watt = shown_unit(
        max((abs(each) for rise in rises for each in (rise.rate, rise.power)), default=0.0), "W"
    )
    changes = (
        found.change,
        found.kinetic - found.kinetic[0],
        found.image - found.image[0],
        found.change - (found.kinetic - found.kinetic[0]) - (found.image - found.image[0]),
    )
    change, per_joule = shown_unit(max(float(np.abs(part).max()) for part in changes), "J")
    rates = (found.predicted, found.differentiated)
    compared = np.isfinite(rates[1]).any()  # not in a run of a few steps
    power, per_axis_watt = shown_unit(max(float(np.nanmax(np.abs(rate))) for rate in rates) if compared else 0.0, "W")
    table = Table.of(
        "Where V grows, worst first",
        rises[:_ROWS],
        [
            (Column("from", "s"), lambda rise: rise.first),
            (Column("to", "s"), lambda rise: rise.last),
            (Column("samples"), lambda rise: rise.samples),
            (Column("largest V-dot", grows), lambda rise: rise.rate * per_watt),
            (Column("axis"), lambda rise: AXES[rise.axis]),
            (Column("largest term"), lambda rise: rise.term),
            (Column("its power", grows), lambda rise: rise.power * per_watt),
            (Column("gamma of the axis"), lambda rise: rise.gamma),
        ],
        note=f"{counted(len(rises), 'interval')} in all. gamma in N or N m.",
        page=PAGE,
    )
    rate_chart = Curves(
        "V-dot, two ways",
        "time [s]",
        f"V-dot [{power}]",
        [
            Line("by (20)", time, rates[0] * per_axis_watt),
            markers("by differences of V", time, rates[1] * per_axis_watt),
        ],
        page=PAGE,
    )
    terms = (("kinetic energy", found.kinetic), ("image error", found.image), ("weight error", found.weight))
    return (
        *((table,) if rises else ()),
        Curves(
            "V and its terms",
            "time [s]",
            "energy [J]",
            [Line("V", time, np.maximum(found.value, floor))]
            + [Line(name, time[part > 0], part[part > 0]) for name, part in terms],
            y_log=True,
            page=PAGE,
        ),
        Curves(
            "Change of V and of its terms since the start",
            "time [s]",
            f"change [{change}]",
            [
                Line(name, time, part * per_joule)
                for name, part in zip(("V", *(name for name, _ in terms)), changes, strict=True)
            ],
            page=PAGE,
        ),
        *((rate_chart,) if compared else ()),
    )


def markers(name: str, time: Array, values: Array) -> Line:
    """Return samples (n,) as markers, at most 1500, which keep the extremes; NaN has none.

    Lines need no such choice: a chart draws what its width resolves, with all peaks.
    """
    known = np.flatnonzero(np.isfinite(values))
    kept = known[extreme_samples(values[known], _SHOWN)]
    return Line(name, time[kept], values[kept], "points")
