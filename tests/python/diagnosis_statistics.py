"""How often the diagnosis is right: random failures of known cause, and the same with that cause withheld.

    python tests/python/diagnosis_statistics.py --failures 60

prints the table of docs/diagnosis/ranking.md, and with `--scale 16` that of machines 16 times as large (rescaled.py).
Faults, ranges and seeds: diagnosis_faults.py.

A fault is the cause of a failure if the run fails with it and passes without it, whatever the seed of the noise: three
seeds each. Where they differ, chance has a share in the cause; those failures are diagnosed and counted apart.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from scipy.stats import beta

from diagnosis_faults import CAUSES, KEPT_APART, Variation, variation
from hexservo.findings.diagnosis.criterion import Judgement
from hexservo.findings.diagnosis.ranking import Study, judged, make_cases, pairs, rank, study
from hexservo.findings.diagnosis.runs import Run, run_all
from rescaled import is_rescalable, rescaled

BATCH = 32  # variations that are drawn at once
MOST_DRAWN = 20  # times the failures that are asked for: causes that hardly ever make a run fail give fewer
PAIRS_EVERY = 5  # of so many failures one is also tried for pairs
OTHER_SEEDS = (101, 102)  # added to a variation's own: not those that a diagnosis tries itself


@dataclass(frozen=True)
class Failure:
    """A run that fails with its fault, and passes without it."""

    variation: Variation
    judgement: Judgement
    certain: bool  # with the other seeds as well


@dataclass
class Tally:
    """What was found for some failures."""

    failures: int = 0
    first: int = 0  # the right cause is the first one
    named: int = 0  # and is named
    wrong: int = 0  # another one is named, with the cause on the list
    withheld_wrong: int = 0  # a cause is named with the right one withheld

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(getattr(self, name) + getattr(other, name) for name in vars(self)))


@dataclass
class Count:
    """What was found for one cause."""

    cause: str
    drawn: int = 0
    certain: Tally = field(default_factory=Tally)
    by_chance: Tally = field(default_factory=Tally)  # with other seeds it passes, or fails without the fault
    paired: int = 0  # failures that were tried for pairs, with the cause withheld
    paired_wrong: int = 0  # where a pair was named
    misses: dict[int, str] = field(default_factory=dict)  # seed -> the first cause, where it is another one
    blamed: Counter[str] = field(default_factory=Counter)  # cause that was named with the right one withheld


def of_size(drawn: Sequence[Variation], scale: float) -> list[Variation]:
    """Give variations of machines with so many times the lengths, and masses as their cubes, without what has none."""
    return [
        replace(
            one,
            baseline=rescaled(one.baseline, scale, scale**3),
            scenario=rescaled(one.scenario, scale, scale**3),
        )
        for one in drawn
        if is_rescalable(one.baseline) and is_rescalable(one.scenario)
    ]


def failing(cause: str, seeds: range, threads: int = 2, scale: float = 1.0) -> list[Failure]:
    """Draw variations, and keep those that fail while their baseline passes."""
    drawn = [variation(cause, seed) for seed in seeds]
    if scale != 1.0:
        drawn = of_size(drawn, scale)
    before = run_all([Run(one.baseline) for one in drawn], threads)
    after = run_all([Run(one.scenario) for one in drawn], threads)
    kept = []
    for one, sound, faulty in zip(drawn, before, after, strict=True):
        assert sound is not None, f"{cause}, seed {one.seed}: the baseline was refused"
        assert faulty is not None, f"{cause}, seed {one.seed}: refused with its fault"
        judgement = judged(one.scenario, faulty)
        if judgement.failed and not judged(one.baseline, sound).failed:
            kept.append((one, judgement))
    runs = [
        Run(scenario, {"seed": one.seed + more} if scenario.simulation.mode == "sampled" else {})
        for one, _ in kept
        for scenario in (one.baseline, one.scenario)
        for more in OTHER_SEEDS
    ]
    failed = [
        record is None or judged(run.scenario, record).failed
        for run, record in zip(runs, run_all(runs, threads), strict=True)
    ]
    seeds_each, expected = 2 * len(OTHER_SEEDS), [False] * len(OTHER_SEEDS) + [True] * len(OTHER_SEEDS)
    return [
        Failure(one, judgement, failed[seeds_each * number : seeds_each * (number + 1)] == expected)
        for number, (one, judgement) in enumerate(kept)
    ]


def studied(
    cause: str, failures: int, first_seed: int, threads: int, scale: float
) -> tuple[list[tuple[Failure, Study]], int]:
    """Draw until so many failures are certain, and make the runs of a diagnosis; also give how many were drawn."""
    found: list[tuple[Failure, Study]] = []
    drawn = 0
    while sum(one.certain for one, _ in found) < failures and drawn < MOST_DRAWN * failures:
        kept = failing(cause, range(first_seed + drawn, first_seed + drawn + BATCH), threads, scale)
        drawn += BATCH
        left = failures - sum(one.certain for one, _ in found)
        for end, one in enumerate(kept):
            left -= one.certain
            if left == 0:
                kept = kept[: end + 1]
                break
        cases = make_cases([one.variation.scenario for one in kept])
        found += zip(kept, study(cases, [one.judgement for one in kept], threads), strict=True)
    return found, drawn


def count(cause: str, failures: int, first_seed: int = KEPT_APART, threads: int = 2, scale: float = 1.0) -> Count:
    """Diagnose so many failures of one cause, with it on the list and without."""
    items, drawn = studied(cause, failures, first_seed, threads, scale)
    found = Count(cause, drawn)
    for number, (one, given) in enumerate(items):
        tally = found.certain if one.certain else found.by_chance
        trials = rank(given)
        right = trials[0].cause.key == cause
        others = rank(given, cause)
        blamed = [trial.cause.key for trial in others if trial.named]
        tally.failures += 1
        tally.first += right
        tally.named += right and trials[0].named
        tally.wrong += not right and trials[0].named
        tally.withheld_wrong += bool(blamed)
        if one.certain:
            found.blamed.update(blamed[:1])
            if not right:
                found.misses[one.variation.seed] = trials[0].cause.key
        if number % PAIRS_EVERY == 0:
            found.paired += 1
            found.paired_wrong += bool(pairs(given, others, threads))
    return found


def row(found: Count) -> str:
    """Give a row of the table."""
    blamed = ", ".join(f"{name} {times}" for name, times in found.blamed.most_common(3))
    one, other = found.certain, found.by_chance
    cells = [found.cause, found.drawn, one.failures, one.first, one.named, one.withheld_wrong, blamed]
    cells += [other.failures, other.first, other.withheld_wrong] if other.failures else ["", "", ""]
    return f"| {' | '.join(map(str, cells))} |"


def interval(part: int, whole: int) -> str:
    """Give a share with its interval of 95 % by Clopper and Pearson."""
    low = beta.ppf(0.025, part, whole - part + 1) if part else 0.0
    high = beta.ppf(0.975, part + 1, whole - part) if part < whole else 1.0
    return f"{part} of {whole}: {part / whole:.1%}, 95 % interval {low:.1%} to {high:.1%}"


def totals(counts: Sequence[Count]) -> tuple[Tally, Tally]:
    """Add up the causes: certain failures, and those by chance."""
    certain, by_chance = Tally(), Tally()
    for one in counts:
        certain, by_chance = certain + one.certain, by_chance + one.by_chance
    return certain, by_chance


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--failures", type=int, default=200, help="of each cause")
    parser.add_argument("--seed", type=int, default=KEPT_APART, help="the first one")
    parser.add_argument("--cause", action="append", choices=CAUSES, help="all, if not given")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--scale", type=float, default=1.0, help="lengths over those of micro; masses as its cube")
    given = parser.parse_args()
    print(f"Seeds from {given.seed} on.\n")
    print(
        "| cause | drawn | that fail | right cause first | and named | withheld: a wrong cause named | which "
        "| by chance | right cause first | withheld: wrong |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    counts = []
    for cause in given.cause or CAUSES:
        counts.append(count(cause, given.failures, given.seed, given.threads, given.scale))
        print(row(counts[-1]), f"wrong, by seed: {counts[-1].misses}", flush=True)
    for what, total in zip(("certain", "by chance"), totals(counts), strict=True):
        for name in ("first", "named", "wrong", "withheld_wrong"):
            if total.failures:
                print(f"{what}, {name}: {interval(getattr(total, name), total.failures)}")
    print(f"pairs, with the cause withheld: {sum(c.paired_wrong for c in counts)} of {sum(c.paired for c in counts)}")


if __name__ == "__main__":
    main()
