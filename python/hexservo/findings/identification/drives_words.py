"""Responses of the drives as sentences, a table and curves (docs/identification.md)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict

import numpy as np

from hexservo.findings.evidence import Cell, Column, Curves, Line, Section, Table, Verdict
from hexservo.findings.identification.drives import GOOD, MOST_DELAY, DriveFit, Drives
from hexservo.findings.identification.interval import Interval
from hexservo.findings.identification.log import JUDGED
from hexservo.findings.identification.motors import MotorFit
from hexservo.findings.identification.one_drive import AGREEMENT, LIMITS, LimitName, Response, limit_of, response_of
from hexservo.scenario.wording import below, number

_PAGE = "docs/identification.md"
_LASTING = 5.0  # ticks over which residuals may be correlated without a word
_ALIKE = 1.1  # ratio of two legs' bandwidths that is not worth a word


def section(found: Drives) -> Section:
    """Return the findings as sentences, a table and curves."""
    unit = found.units.small
    rows: list[list[Cell]] = [
        [
            fit.leg,
            with_interval(fit.bandwidth),
            with_interval(fit.damping),
            with_interval(fit.delay),
            _limit(fit.speed_limit, fit, fit.fastest),
            _limit(fit.acceleration_limit, fit, fit.hardest),
            _rests(fit),
            1e3 * fit.noise,
            None if fit.explained is None else 100.0 * fit.explained,
        ]
        for fit in found.fits
    ]
    table = Table(
        "Response of each leg's drive, with 95 % intervals",
        (
            Column("leg"),
            Column("bandwidth", "Hz"),
            Column("damping"),
            Column("delay", "ticks"),
            Column("speed limit", found.units.rate),
            Column("acceleration limit", f"{found.units.rate}^2"),
            Column("rests short by", unit),
            Column("left by the fit", unit, ".3g"),
            Column("predicted", "%", ".4g"),
        ),
        rows,
        note="Predicted: the share of the motion that the model foretells where the record was not fitted.",
        page=_PAGE,
    )
    return Section(
        name="drives",
        title="Drives of the legs",
        sentences=_sentences(found),
        items=(table, *_curves(found)),
        verdict=_verdict(found),
        data={"fits": [asdict(fit) for fit in found.fits], "period": found.period, "repeated": found.repeated},
    )


def with_interval(found: Interval | None) -> str | None:
    """Write an interval: "5.04 (5.03 to 5.05)", "at least 8", "4.21 (not determined)"; None without one."""
    if found is None:
        return None
    digits = _digits(found)
    if not found.is_bounded:
        end, more = (found.high, "less") if np.isfinite(found.high) else (found.low, "more")
        if not np.isfinite(end):
            return f"{number(found.value)} (not determined)"
        if end == found.value:
            return f"at {'least' if more == 'more' else 'most'} {end:.{digits}g}"
        return f"{found.value:.{digits}g} ({end:.{digits}g} or {more})"
    if found.low == found.high:
        return f"{found.value:.{digits}g}"
    return f"{found.value:.{digits}g} ({found.low:.{digits}g} to {found.high:.{digits}g})"


def _digits(found: Interval) -> int:
    width = found.high - found.low
    if not 0.0 < width < np.inf or found.value == 0.0:
        return 4
    return int(np.clip(2 + np.floor(np.log10(abs(found.value) / width)) + 1, 3, 9))


def _limit(found: Interval | None, fit: DriveFit, reached: float) -> Cell:
    if fit.bandwidth is None:
        return None
    return with_interval(found) or f"not seen up to {number(reached)}"


def _rests(fit: DriveFit) -> Cell:
    if fit.bandwidth is None:
        return None
    return with_interval(fit.rests.short.times(1e3)) if fit.rests is not None else "too few rests"


def _verdict(found: Drives) -> Verdict:
    if not found.moved:
        return "open"
    if not found.explains:
        return "bad"
    known = all(one is not None and one.is_bounded for fit in found.fits for one in _values(fit))
    alike = not any(_of_a_limit(found, name) for name in LIMITS)
    alike = alike and not any(fit.rounding_matters for fit in found.taken)
    return "good" if known and alike and all((fit.explained or 0.0) >= GOOD for fit in found.fits) else "warning"


def _values(fit: DriveFit) -> tuple[Interval | None, ...]:
    """Return what is found of a leg in any case."""
    return fit.bandwidth, fit.damping, fit.delay


def _sentences(found: Drives) -> list[str]:
    moved = found.moved
    if not moved:
        return ["No leg was commanded to move by more than its noise: nothing of the drives can be found."]
    words = [
        f"Fitted to {number(found.fitted)} s of the log, in ticks of {number(1e3 * found.period)} ms. "
        + _of_the_prediction(found)
    ]
    if found.repeated:
        words.append(
            f"{found.repeated} readings of the joints repeat those of the tick before, of all legs: they do not count. "
            "Read the encoders at every tick to know the values better."
        )
    if len(moved) < 6:
        still = _legs(fit for fit in found.fits if fit.bandwidth is None)
        words.append(f"Not commanded to move by more than their noise, or at rest, and not identified: {still}.")
    words += of_still_legs([fit.leg for fit in moved if fit.explained is None])
    if not found.explains:
        return words
    if poor := [fit for fit in moved if fit not in found.taken]:
        words.append(
            f"Less than half of the motion of {_legs(poor)} is predicted: no key is taken from "
            f"{'it' if len(poor) == 1 else 'them'}. Legs that the platform couples, such as soft ones, answer each "
            "other's commands; `--motors` fits motors and platform together."
        )
    words += [*_of_the_edges(found), *_of_whole_ticks(found), *_of_offsets(found)]
    bandwidths = [fit.bandwidth.value for fit in found.taken if fit.bandwidth is not None and fit.response_is_known]
    if max(bandwidths, default=0.0) > _ALIKE * min(bandwidths, default=0.0):
        words.append(
            f"The legs differ: bandwidths from {number(min(bandwidths))} to {number(max(bandwidths))} Hz. A "
            "scenario has one for all, the mean weighted by how well each is known."
        )
    words += [word for name in LIMITS for word in _of_a_limit(found, name)]
    lasting = max(moved, key=lambda fit: fit.correlated)
    held = [(fit.leg, fit.rests) for fit in moved if fit.rests is not None and fit.rests.short.low > 0.0]
    lacking = "the model lacks, such as friction, backlash or the steps of an encoder"
    words += of_correlation(f" of leg {lasting.leg}", lasting.correlated, lacking)
    if held:
        leg, rests = max(held, key=lambda one: one[1].short.value)
        short, unit = with_interval(rests.short.times(1e3)), found.units.small
        words.append(
            f"Leg {leg} rests {short} {unit} short of its command, by {rests.count} rests, on the side that it comes "
            f"from, as friction leaves it; at most {number(1e3 * rests.farthest)} {unit}. The model goes on to the "
            "command."
        )
    return words


def _of_the_prediction(found: Drives) -> str:
    worst = found.worst
    if worst is None or worst.explained is None:
        return (
            f"No leg moves in the {number(found.apart)} s that were kept apart: what the model predicts is not known."
        )
    if found.if_exchanged is not None:
        return (
            f"The model predicts {at_most(worst.explained)} of the motion of leg {worst.leg} in the "
            f"{number(found.apart)} s that were kept apart, and with commands and joints exchanged "
            f"{below(100 * found.if_exchanged, 4)} %: they are exchanged in the log, and no key of the drives is taken "
            "over."
        )
    if not found.explains:
        return (
            f"The model predicts {at_most(worst.explained)} of the motion of leg {worst.leg} in the "
            f"{number(found.apart)} s that were kept apart: the joints do not follow these commands, and no key of the "
            "drives is taken over. Likely reasons: commands and joints exchanged, or of opposite sign; another order "
            "of the legs, or another unit, in one of them; a leg that does not do what it is commanded."
        )
    judged = [fit for fit in found.fits if fit.explained is not None]
    whose = "each leg" if len(judged) == 6 else f"{'each of ' if len(judged) > 1 else ''}{_legs(judged)}"
    return (
        f"The model predicts at least {below(100 * worst.explained, 4)} % of the motion of {whose} in the "
        f"{number(found.apart)} s that were kept apart."
    )


def _of_the_edges(found: Drives) -> list[str]:
    """Return what to know of values at the edge of what is searched."""
    words = []
    late = [fit for fit in found.moved if fit.delay is not None and not fit.delay.is_bounded]
    if late:
        least = min(fit.delay.low for fit in late if fit.delay is not None)
        more = f" and may be more than {MOST_DELAY}" if least < MOST_DELAY else ""
        words.append(
            f"The delay of {_legs(late)} is at least {least:.0f} ticks{more}, the most "
            "that is tried and that a scenario has. Where that is the best value the key `actuators.delay` is left as "
            "it is; bandwidth and damping then take what is missing of it. A log with longer ticks shows longer delays."
        )
    doubtful = [fit for fit in found.taken if not fit.response_is_known]
    slow = [fit for fit in doubtful if fit.lag is not None and fit.lag.is_bounded]
    unknown = [fit for fit in doubtful if fit not in slow]
    if slow:
        lags = sorted(fit.lag.value for fit in slow if fit.lag is not None)
        extremes = list(dict.fromkeys(number(lag) for lag in (lags[0], lags[-1])))
        words.append(
            f"Only 2 zeta/omega, the lag of a slow leg, is determined of {_legs(slow)}: {' to '.join(extremes)} s."
        )
    if unknown:
        words.append(
            f"Bandwidth and damping of {_legs(unknown)} are at the edge of what is searched, or the log does not "
            "determine them, and not 2 zeta/omega either."
        )
    return [*words, _of_the_keys(response_of(found))] if doubtful else words


def _of_whole_ticks(found: Drives) -> list[str]:
    """Return what to know of a delay that is no whole number of ticks, as the key is."""
    moved = [fit for fit in found.taken if fit.rounded > fit.noise]
    if not moved or found.whole_delay >= MOST_DELAY:
        return []
    worst = max(moved, key=lambda fit: fit.rounded)
    delays = sorted(fit.delay.value for fit in found.taken if fit.delay is not None)
    extremes = list(dict.fromkeys(number(delay) for delay in (delays[0], delays[-1])))
    return [
        f"The delay is {' to '.join(extremes)} ticks, and the key `actuators.delay` is in whole ones: with "
        f"{found.whole_delay}, the response to these commands is off by up to {number(1e3 * worst.rounded)} "
        f"{found.units.small} (RMS, leg {worst.leg}), {number(100 * worst.rounded / worst.motion)} % of the motion. "
        "A log with shorter ticks gives a scenario with a finer delay."
    ]


def _of_offsets(found: Drives) -> list[str]:
    """Return what to know of readings that are not where the commands are, at rest."""
    off = [(fit.leg, fit.offset) for fit in found.taken if fit.offset is not None and fit.is_offset]
    if not off:
        return []
    legs = ", ".join(f"leg {leg} by {number(1e3 * offset.value)}" for leg, offset in off)
    return [
        f"At rest the joints are beyond their commands: {legs} {found.units.small}, whichever side they come from, as "
        "by the zero of an encoder, or by weight. The fit takes it out, and no key has it: calibrate the zeros, or the "
        "machine is off by that where the scenario is not."
    ]


def _of_a_limit(found: Drives, name: LimitName) -> list[str]:
    """Return what to know of a limit that some legs show and others do not, or of which no value is known."""
    limit, key = limit_of(found, name), f"`actuators.position.{name}`"
    shown = f"A limit of the {name.removesuffix('_limit')} is seen in {_legs(limit.seen)}" if limit.seen else ""
    if shown and limit.value is None:
        return [f"{shown}: too few of which it is known for the key {key}, which is not taken from them."]
    beyond = [] if limit.value is None else limit.exceeded(limit.value)
    if shown and beyond:
        others = [fit for fit in found.taken if fit.leg in beyond]
        return [f"{shown}, and the key {key} is theirs; {_legs(others)} went beyond it."]
    return []


def _of_the_keys(response: Response | None) -> str:
    """Return what becomes of bandwidth and damping where they are not determined of some legs."""
    keys = "The keys `actuators.position.bandwidth` and `actuators.position.damping`"
    if response is None:
        return f"{keys} are left as they are."
    if response.lag is None:
        return f"{keys} are of the other legs."
    if response.by_agreement:
        return (
            f"{keys}, {number(response.bandwidth)} Hz and {number(response.damping)}, are of the mean lag of the legs' "
            f"best fits, {number(response.lag)} s, which agree within a factor of {AGREEMENT}; one leg alone "
            "determines none."
        )
    return (
        f"{keys}, {number(response.bandwidth)} Hz and {number(response.damping)}, only stand for the mean lag of "
        f"{number(response.lag)} s: the log does not tell them from other pairs with that lag."
    )


def _legs(fits: Iterable[DriveFit]) -> str:
    numbers = [str(fit.leg) for fit in fits]
    return f"leg {numbers[0]}" if len(numbers) == 1 else f"legs {', '.join(numbers)}"


def _curves(found: Drives) -> tuple[Curves, ...]:
    if not found.moved:
        return ()
    leg = (found.worst or found.moved[0]).leg
    return (curves_of(found, leg, f"Leg {leg}"),)


def curves_of(found: Drives | MotorFit, leg: int, what: str) -> Curves:
    """Return the measured and predicted coordinate of the worst leg, 1 to 6, in the part kept apart."""
    return Curves(
        f"{what} in the part kept apart, the worst one",
        "time [s]",
        f"{found.units.name} [{found.units.small}]",
        [
            Line("measured", found.time, 1e3 * found.measured[:, leg - 1]),
            Line("predicted", found.time, 1e3 * found.predicted[:, leg - 1], "dashed"),
        ],
        page=_PAGE,
    )


def at_most(explained: float) -> str:
    """Return the share of a motion that a model predicts which is not of the machine: "no more than 12 %"."""
    return f"no more than {number(100 * explained)} %" if explained > 0.0 else "nothing"


def of_still_legs(legs: Sequence[int]) -> list[str]:
    """Return that no prediction is judged of some legs; [] of none, and of all, of which another sentence states it."""
    if not 0 < len(legs) < 6:
        return []
    return [
        f"No prediction is judged of leg{'s' if len(legs) > 1 else ''} {', '.join(map(str, legs))}, whose motion in "
        f"the part kept apart is less than {JUDGED:.0f} times the noise of the readings. Larger jumps determine more."
    ]


def of_correlation(of: str, ticks: float, lacking: str) -> list[str]:
    """Return what it means where residuals are correlated over many ticks; [] where they are not."""
    if ticks <= _LASTING:
        return []
    return [
        f"What the fit leaves{of} is correlated over {number(ticks)} ticks: something acts that {lacking}; the "
        "intervals are widened for it."
    ]
