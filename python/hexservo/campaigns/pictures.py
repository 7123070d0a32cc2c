"""Curves of a campaign: the interval over the runs, distributions of metrics, and where the failures lie."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata, t

from hexservo.campaigns.drawing import with_unit
from hexservo.campaigns.result import CampaignResult
from hexservo.findings.evidence import Curves, Line, Section
from hexservo.run.metrics import metric_label, metric_name
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.wording import above, below, counted, number

if TYPE_CHECKING:
    import pyarrow as pa

_PAGE = "docs/campaigns.md"
_POINTS = 60  # of the interval over the runs
_QUANTILES = 400  # of a distribution
_DOTS = 600  # runs of each kind in a plane
_SAMPLE = 100_000  # runs at most of which distributions and ranks are: memory does not grow with more
_CHANCE = 0.05  # probability that some number without influence reaches the size that is stated


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
    kinds = [np.flatnonzero(kind)[:_DOTS] for kind in (~failed, failed)]
    sample, *dots = _rows(result, [_sampled(len(failed)), *kinds])
    distributions = _distributions(result, sample)
    if distributions:
        found.append(Section("distributions", "Metrics and their bounds", (), distributions))
    found.append(_failures(result, failed, sample, dots))
    return found


def _sampled(runs: int) -> NDArray[np.intp]:
    """Return the indices of all runs, or of a random sample of them, the same for the same number."""
    if runs <= _SAMPLE:
        return np.arange(runs)
    return np.sort(np.random.default_rng(0).choice(runs, _SAMPLE, replace=False))


def _rows(result: CampaignResult, groups: Sequence[NDArray[np.intp]]) -> list[pa.Table]:
    """Return the runs of these indices, ascending in each group, as a table for each group; chunks are read once."""
    import pyarrow as pa

    parts: list[list[pa.Table]] = [[] for _ in groups]
    first = 0
    for table in result.tables():
        last = first + len(table)
        for part, group in zip(parts, groups, strict=True):
            begin, end = np.searchsorted(group, (first, last))
            part.append(table.take(group[begin:end] - first))
        first = last
    return [pa.concat_tables(part).combine_chunks() for part in parts]


def correlations(table: pa.Table) -> list[tuple[str, float]]:
    """Return the numbers that vary in a table of runs and the size of the margin's rank correlation with each.

    The largest comes first. Of each number the correlation with its value and with its distance from the median is
    taken, and the larger one counts: an error may matter whatever its sign. Of entries that are one number the first
    is named; seeds are left out.
    """
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
    return sorted(sizes.items(), key=lambda item: -item[1])


def size_of_chance(runs: int, inputs: int) -> float:
    """Return the rank correlation that none of so many numbers without influence exceeds, with a probability of 95 %.

    By Bonferroni's inequality, for two correlations of each number, by Student's approximation; 1 below 4 runs.
    """
    if runs < 4:
        return 1.0
    quantile = t.isf(_CHANCE / (4 * inputs), runs - 2)  # both signs of two correlations
    return float(quantile / np.sqrt(runs - 2 + quantile**2))


def _correlation(ranks: Array, values: Array) -> float:
    """Return the size of Spearman's correlation; 0 where nothing varies."""
    other = rankdata(values)
    if np.ptp(other) == 0 or np.ptp(ranks) == 0:
        return 0.0
    return float(abs(np.corrcoef(ranks, other)[0, 1]))


def _interval_sentences(result: CampaignResult) -> Sequence[str]:
    low, high = result.interval
    runs = counted(len(result), "run")
    return [f"After {runs} it is {below(low)} to {above(high)}, with a confidence of {result.plan.confidence}."]


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


def _distributions(result: CampaignResult, table: pa.Table) -> list[Curves]:
    """Return for each bounded metric the share of the runs of a table up to a value, with the bound."""
    bounded = [requirement for requirement in result.plan.require if requirement.name != "outcome"]
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
                metric_name(requirement.name, result.plan.scenario.robot).capitalize(),
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
                note=" ".join(
                    filter(None, (_without(len(values) - len(finite), len(values)), _of_sample(result, table)))
                ),
                page=_PAGE,
            )
        )
    return items


def _without(missing: int, runs: int) -> str:
    return f"{missing} of {runs} runs ended early or have no value." if missing else ""


def _of_sample(result: CampaignResult, table: pa.Table) -> str:
    """Return that a table has a sample of the runs; "" where it has all."""
    return f"Of a random sample of {len(table)} of the {len(result)} runs." if len(table) < len(result) else ""


def _failures(result: CampaignResult, failed: Mask, sample: pa.Table, dots: Sequence[pa.Table]) -> Section:
    """Return passing and failing runs, `dots`, in the plane of the two numbers that matter most."""
    found = correlations(sample)
    title = "Where the failures lie" if failed.any() else "What the margin depends on"
    if not found:
        return Section("failures", title, ["Nothing but seeds varies."])
    names = found[:2]
    sentences = _influence_sentences(sample, found)
    if (of_sample := _of_sample(result, sample)) != "":
        sentences.append(of_sample)
    if len(names) < 2:
        return Section("failures", title, sentences)
    lines = []
    for look, (name, table) in enumerate(zip(("passes", "fails"), dots, strict=True)):
        if len(table):
            x, y = (np.asarray(table.column(key).to_numpy(), dtype=float) for key, _ in names)
            lines.append(Line(name, x, y, "points", look))
    note = f"The first {_DOTS} runs of each kind." if max(failed.sum(), (~failed).sum()) > _DOTS else ""
    x_label, y_label = (with_unit(result.plan.scenario, name) for name, _ in names)
    return Section(
        "failures",
        title,
        sentences,
        [Curves("Runs in the plane of both", x_label, y_label, lines, note=note, page=_PAGE)],
    )


def _influence_sentences(table: pa.Table, found: Sequence[tuple[str, float]]) -> list[str]:
    """Return which of the varied numbers show an influence on the margin, beyond what chance reaches."""
    margins: Array = table.column("margin").to_numpy()
    values, counts = np.unique(margins, return_counts=True)
    if len(margins) == 1:
        return ["One run shows no influence of a number: that takes several runs."]
    if len(values) == 1:
        return [f"All runs have the same margin, {number(values[0])}: no number shows an influence."]
    runs, inputs = len(margins), len(found)
    limit = size_of_chance(runs, inputs)
    of = "a number" if inputs == 1 else f"the largest of {inputs} numbers"
    chance = f"in {runs} runs {of} without influence reaches up to {limit:.2f} by chance, in 95 % of campaigns"
    shown = [f"{name} ({size:.2f})" for name, size in found[:2] if size > limit]
    what = "rank correlation of the margin, with a number or with its distance from the median"
    if shown:
        sentences = [f"Largest {what}: {' and '.join(shown)}; {chance}."]
        if len(shown) < min(2, inputs):
            sentences.append("No other number shows an influence.")
    else:
        sentences = [f"No number shows an influence: the largest {what}, is {found[0][1]:.2f}; {chance}."]
    most = int(np.argmax(counts))
    if 2 * counts[most] > runs:
        sentences.append(
            f"{counts[most]} of {runs} runs have the same margin, {number(values[most])}: no rank orders them."
        )
    if "seed" in table.column_names:
        sentences.append("Seeds are left out: how much noise matters is not among these.")
    return sentences
