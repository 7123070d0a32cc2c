"""A campaign's summary in sentences and tables."""

from __future__ import annotations

from typing import Any

from hexservo.findings.evidence import Cell, Column, Section, Table, Verdict
from hexservo.run.metrics import OF_LIMITS, is_rounding, shown_number
from hexservo.scenario.wording import above, below, number

_PAGE = "docs/campaigns.md"
_OF_EACH = ("failures", "from", "to", "worst value", "worst/bound")
_FAR = 100.0  # factor between a bound and all values: a unit with a prefix is one of 1000, degrees for rad are 57
_OFTEN = 0.5  # failure probability above which a campaign without a goal for it is bad,
_SELDOM = 0.1  # and below which it may be good
_MOST = 0.5  # share of runs that settle without a motion, above which a campaign is not good
_REASONS = {  # why a completed run has no value of a metric (docs/model.md, section 8)
    "settling_time": "they are not within metrics.band for metrics.dwell at their end",
    "rms_error": "they end before metrics.rms_start",
    "chatter": "they end where they start",
    **{name: f"{key} is null" for name, key in OF_LIMITS.items()},
}


def summary_section(summary: dict[str, Any]) -> Section:
    """Return a summary with its tables: requirements, outcomes and the worst runs."""
    requirements: list[list[Cell]] = [
        [one["holds"], one["failures"], *_ends(one["interval"]), *_worst_value(one)] for one in summary["requirements"]
    ]
    tables = [
        Table(
            "Requirements",
            (Column("holds"), *map(Column, _OF_EACH)),
            requirements,
            f"Each interval has the confidence of {summary['confidence']}; all of them together have "
            f"{summary['joint_confidence']}. Worst values are those of runs that complete.",
            _PAGE,
        )
    ]
    if summary["runs"]:
        outcomes: list[list[Cell]] = [[name.replace("_", " "), count] for name, count in summary["outcomes"].items()]
        worst: list[list[Cell]] = [[one["index"], one["margin"]] for one in summary["worst"][:5]]
        tables += [
            Table("Outcomes", (Column("outcome"), Column("runs")), outcomes),
            Table(
                "Smallest margins",
                (Column("run"), Column("margin")),
                worst,
                "Distance to the nearest bound in parts of its scale. Negative: the run fails, at -1 or below since a "
                "metric has no value or the run ended early.",
            ),
        ]
    return Section(
        "campaign",
        f"Campaign on {summary['scenario']}",
        verdict_sentences(summary),
        tables,
        _verdict(summary),
        summary,
    )


def _ends(interval: tuple[float, float]) -> tuple[str, str]:
    return below(interval[0]), above(interval[1])


def _worst_value(requirement: dict[str, Any]) -> tuple[Cell, Cell]:
    """Return the value of a metric that is the worst for its requirement, and what part of the bound it is."""
    value = requirement.get("largest" if "<" in requirement["holds"] else "smallest")  # no key: of an earlier version
    if value is None:
        return "-", "-"
    unit, bound = requirement["unit"], requirement["bound"]
    return f"{shown_number(value, unit)}{_with_space(unit)}", number(value / bound) if bound else "-"


def _with_space(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def _far_bound(requirement: dict[str, Any]) -> str | None:
    """Return that all values of a metric are far from its bound, as where that has another unit; None for others.

    A value of 0, or what rounding leaves of it, is so in any unit.
    """
    if not requirement.get("bound") or requirement["largest"] is None:
        return None
    bound, unit = requirement["bound"], requirement["unit"]
    for end, is_far in (
        ("largest", requirement["largest"] * _FAR < bound),
        ("smallest", requirement["smallest"] > _FAR * bound),
    ):
        value = requirement[end]
        if is_far and value and not is_rounding(value, unit):
            has = "no unit" if unit == "1" else f"the unit {unit}"
            return (
                f"No run is near {requirement['holds']}: the {end} value is {shown_number(value, unit)}"
                f"{_with_space(unit)}, {number(value / bound)} times the bound. Check the bound, which has {has}."
            )
    return None


def verdict_sentences(summary: dict[str, Any]) -> list[str]:
    """Return the verdict: how many runs fail, and the intervals of the failure probability."""
    low, high = summary["interval"]
    runs, failures = summary["runs"], summary["failures"]
    counted = f"{failures} of {runs} runs {'fails' if failures == 1 else 'fail'}"
    sentences = [
        f"{counted}: the failure probability is between {below(low)} and {above(high)}, with a confidence of "
        f"{summary['confidence']} that holds at whatever number of runs one stops."
    ]
    if summary.get("refused"):
        sentences.append(_refused(summary))
    if summary["common_noise"] is not None:
        sentences.append(of_common_noise("the interval holds", summary["common_noise"]))
    if summary.get("settled_at_start"):
        sentences.append(of_settled_starts(summary))
    if (until := _decided(summary)) is not None:
        sentences.append(until)
    if summary["clopper_pearson"] is not None:
        low, high = summary["clopper_pearson"]
        drawn = "draws" if summary.get("refused") else "runs"
        sentences.append(
            f"The number of {drawn} was fixed before the first one. For that case alone, the interval of Clopper and "
            f"Pearson is {below(low)} to {above(high)}."
        )
    sentences += [_valueless(name, count, runs) for name, count in summary["without_value"].items()]
    sentences += filter(None, map(_far_bound, summary["requirements"]))
    if not summary["complete"]:
        planned = summary["planned_runs"]
        of = "" if planned is None else f" of {planned} runs"
        kept = runs + summary.get("refused", 0)
        sentences.append(f"The campaign is not complete: {kept}{of} are kept.")
    return sentences


def _refused(summary: dict[str, Any]) -> str:
    """Return how many draws are no valid scenario, and the first of these."""
    count, drawn = summary["refused"], summary["runs"] + summary["refused"]
    are, were = ("is", "was") if count == 1 else ("are", "were")
    return (
        f"{count} of {drawn} draws {are} no valid scenario and {were} left out: interval and failure probability are "
        f"those of the draws that are valid scenarios, not of all that vary draws. The first: {summary['refusal']}."
    )


def of_common_noise(holds: str, seed: int) -> str:
    """Return that all runs have the noise of one seed, and that what `holds` does so for that noise alone."""
    return f"All runs have the same noise (seed {seed}): {holds} for that noise alone; vary seed: each for other noise."


def of_settled_starts(summary: dict[str, Any]) -> str:
    """Return how many runs are settled without a motion."""
    count, runs = summary["settled_at_start"], summary["runs"]
    are, they, count_as = ("is", "it", "counts") if count == 1 else ("are", "they", "count")
    return (
        f"{count} of {runs} runs {are} within metrics.band of the goal from the start on, so that {they} {count_as} as "
        "settled without a motion; a narrower band shows whether the law gets to the goal."
    )


def _valueless(metric: str, count: int, runs: int) -> str:
    """Return how many completed runs have no value of a metric that is required, and why."""
    reason = f", since {_REASONS[metric]}" if metric in _REASONS else ""
    return f"{count} of {runs} runs complete without a value of {metric}{reason}; that counts as a failure."


def _decided(summary: dict[str, Any]) -> str | None:
    """Return what the interval decides of the goal, if there is one."""
    low, high = summary["interval"]
    until = summary["until"] or {}
    if (width := until.get("width_below")) is not None:
        is_so = f"The interval is {above(high - low)} wide"
        if _is_wide(summary):
            return f"{is_so}: the width of {width:g} that the campaign was to reach is not reached yet."
        return f"{is_so}, not more than {width:g}, as the campaign was to reach."
    if (bound := until.get("probability_below")) is None:
        return None
    if high <= bound:
        return f"It is below {number(bound)}, as the campaign was to decide."
    if low > bound:
        return f"It is above {number(bound)}: the goal cannot be reached."
    return f"Whether it is below {number(bound)} is not decided yet."


def _is_wide(summary: dict[str, Any]) -> bool:
    """Return whether the interval is wider than the campaign was to reach."""
    low, high = summary["interval"]
    width = (summary["until"] or {}).get("width_below")
    return width is not None and high - low > width


def _rests(summary: dict[str, Any]) -> bool:
    """Return whether most runs are settled without a motion."""
    return bool((summary.get("settled_at_start") or 0) > _MOST * summary["runs"])


def _verdict(summary: dict[str, Any]) -> Verdict:
    """Return the verdict (docs/campaigns.md, section 5); a goal for the probability takes the place of both limits."""
    if not summary["runs"]:
        return "open"
    low, high = summary["interval"]
    bound = (summary["until"] or {}).get("probability_below")
    if low > (_OFTEN if bound is None else bound):
        return "bad"
    # of other noise, of the law, or of a part of the draws the runs show nothing
    if summary["common_noise"] is not None or _rests(summary) or summary.get("refused"):
        return "warning"
    if bound is not None:
        return "good" if high <= bound else "warning"
    return "good" if not summary["failures"] and high <= _SELDOM and not _is_wide(summary) else "warning"
