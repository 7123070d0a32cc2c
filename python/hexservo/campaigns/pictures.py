"""Curves of a campaign: the interval over the runs, distributions of metrics, and where the failures lie."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

import numpy as np
from scipy.stats import rankdata

from hexservo.campaigns.drawing import with_unit
from hexservo.campaigns.result import CampaignResult
from hexservo.findings.evidence import Curves, Line, Section
from hexservo.run.metrics import metric_label
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.wording import above, below

_PAGE = "docs/campaigns.md"
_POINTS = 60  # of the interval over the runs
_QUANTILES = 400  # of a distribution
_DOTS = 600  # runs of each kind in a plane


def campaign_sections(result: CampaignResult) -> list[Section]:
    """Return the verdict of a campaign and its pictures, for a report.

    Raises
    ------
    ResultError
        A chunk is damaged.
    """
    found = [result.section()]
    if len(result) == 0:
        return found
    failed: Mask = np.asarray(result.margin() < 0)
    found.append(Section("interval", "Interval", _interval_sentences(result), [_interval(result, failed)]))
    distributions = _distributions(result)
    if distributions:
        found.append(Section("distributions", "Metrics and their bounds", (), distributions))
    found.append(_failures(result, failed))
    return found


def influential(result: CampaignResult) -> list[tuple[str, float]]:
    """Return the two varied numbers that the margin depends on most, with the size of their rank correlation.

    Of each number the correlation with its value and with its distance from the median is taken, and the larger one
    counts: an error may matter whatever its sign. Of entries that are one number the first is named; seeds are left
    out.
    """
    table = result.to_arrow()
    ranks = rankdata(table.column("margin").to_numpy())
    inputs = [name for name in table.column_names[1 : table.column_names.index("outcome")] if name != "seed"]
    sizes: dict[str, float] = {}
    seen: set[bytes] = set()
    for name in inputs:
        values: Array = table.column(name).to_numpy()
        digest = sha256(values.tobytes()).digest()
        if digest in seen:
            continue  # one number for all entries, or the other half of a symmetric matrix
        seen.add(digest)
        sizes[name] = max(_correlation(ranks, part) for part in (values, np.abs(values - np.median(values))))
    return sorted(sizes.items(), key=lambda item: -item[1])[:2]


def _correlation(ranks: Array, values: Array) -> float:
    """Return the size of Spearman's correlation; 0 where nothing varies."""
    other = rankdata(values)
    if np.ptp(other) == 0 or np.ptp(ranks) == 0:
        return 0.0
    return float(abs(np.corrcoef(ranks, other)[0, 1]))


def _interval_sentences(result: CampaignResult) -> Sequence[str]:
    low, high = result.interval
    return [
        f"After {len(result)} runs it is {below(low)} to {above(high)}, with a confidence of {result.plan.confidence}."
    ]


def _interval(result: CampaignResult, failed: Mask) -> Curves:
    counts = np.cumsum(failed)
    places = np.unique(np.geomspace(min(10, len(failed)), len(failed), _POINTS).astype(int))
    plan = result.plan
    ends = np.array([plan.interval(int(counts[n - 1]), int(n)) for n in places])
    runs = places.astype(float)
    lines = [Line("upper end", runs, ends[:, 1]), Line("lower end", runs, np.where(ends[:, 0] > 0, ends[:, 0], np.nan))]
    shares = counts[places - 1] / runs
    if shares.max() > 0:
        lines.append(Line("share of failures", runs, np.where(shares > 0, shares, np.nan), "dashed"))
    if plan.until is not None and plan.until.kind == "probability_below":
        lines.append(Line("goal", runs[[0, -1]], np.full(2, plan.until.value), "dashed"))
    return Curves(
        "Failure probability",
        "runs",
        "probability",
        [line for line in lines if np.isfinite(line.y).any()],
        x_log=True,
        y_log=True,
        note="The interval holds at all numbers of runs at once. A lower end of 0 is not drawn.",
        page=_PAGE,
    )


def _distributions(result: CampaignResult) -> list[Curves]:
    """Return for each bounded metric the share of runs up to a value, with the bound."""
    bounded = [requirement for requirement in result.plan.require if requirement.name != "outcome"]
    table = result.to_arrow(list(dict.fromkeys(["outcome", *(requirement.name for requirement in bounded)])))
    ended = np.array(table.column("outcome").to_pylist()) != "completed"  # fails, whatever was reached until then
    items = []
    for requirement in bounded:
        values: Array = np.where(ended, np.nan, table.column(requirement.name).to_numpy())
        finite = values[np.isfinite(values)]
        if not len(finite):
            continue
        shares = np.linspace(0, 1, _QUANTILES)
        label = metric_label(requirement.name, result.plan.scenario.robot)
        items.append(
            Curves(
                requirement.name.replace("_", " ").capitalize(),
                label,
                "share of runs",
                [
                    Line("runs up to this value", np.quantile(finite, shares), shares * len(finite) / len(values)),
                    Line(
                        f"bound, {requirement.comparison}",
                        np.full(2, requirement.bound),
                        np.array([0.0, 1.0]),
                        "dashed",
                    ),
                ],
                x_log=bool(min(finite.min(), requirement.bound) > 0 and finite.max() > 100 * finite.min()),
                note=_without(len(values) - len(finite), len(values)),
                page=_PAGE,
            )
        )
    return items


def _without(missing: int, runs: int) -> str:
    return f"{missing} of {runs} runs ended early or have no value." if missing else ""


def _failures(result: CampaignResult, failed: Mask) -> Section:
    """Return passing and failing runs in the plane of the two numbers that matter most."""
    names = influential(result)
    if not names:
        return Section("failures", "Where the failures lie", ["Nothing but seeds varies."])
    listed = " and ".join(f"{name} ({size:.2f})" for name, size in names)
    sentences = [
        f"Largest rank correlation of the margin, with a number or with its distance from the median: {listed}."
    ]
    if len(names) < 2:
        return Section("failures", "Where the failures lie", sentences)
    table = result.to_arrow([name for name, _ in names])
    x, y = (np.asarray(table.column(place).to_numpy(), dtype=float) for place in range(2))
    lines = []
    for name, kind in (("passes", ~failed), ("fails", failed)):
        places = np.flatnonzero(kind)[:_DOTS]
        if len(places):
            lines.append(Line(name, x[places], y[places], "points"))
    note = f"The first {_DOTS} runs of each kind." if max(failed.sum(), (~failed).sum()) > _DOTS else ""
    x_label, y_label = (with_unit(result.plan.scenario, name) for name, _ in names)
    return Section(
        "failures",
        "Where the failures lie",
        sentences,
        [Curves("Runs in the plane of both", x_label, y_label, lines, note=note, page=_PAGE)],
    )
