"""How often the diagnosis is right: random failures of known cause, and the same with that cause withheld.

    python tests/python/diagnosis_statistics.py --failures 60

prints the table of docs/diagnosis/ranking.md. Faults, ranges and seeds: diagnosis_faults.py.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field

from diagnosis_faults import CAUSES, KEPT_APART, Variation, variation
from hexservo.findings.diagnosis.criterion import Judgement
from hexservo.findings.diagnosis.ranking import judged, make_cases, pairs, rank, study
from hexservo.findings.diagnosis.runs import Run, run_all

BATCH = 32  # variations that are drawn at once
MOST_DRAWN = 20  # times the failures that are asked for: causes that hardly ever make a run fail give fewer
PAIRS_EVERY = 5  # of so many failures one is also tried for pairs


@dataclass
class Count:
    """What was found for one cause."""

    cause: str
    drawn: int = 0
    failures: int = 0
    first: int = 0  # the right cause is the first one
    named: int = 0  # and is named
    wrong: int = 0  # another one is named, with the cause on the list
    withheld_wrong: int = 0  # a cause is named with the right one withheld
    paired: int = 0  # failures that were tried for pairs, with the cause withheld
    paired_wrong: int = 0  # where a pair was named
    misses: dict[int, str] = field(default_factory=dict)  # seed -> the first cause, where it is another one
    blamed: Counter[str] = field(default_factory=Counter)  # cause that was named with the right one withheld


def failing(cause: str, seeds: range, threads: int = 2) -> list[tuple[Variation, Judgement]]:
    """Draw variations, and keep those that fail while their baseline passes."""
    drawn = [variation(cause, seed) for seed in seeds]
    before = run_all([Run(one.baseline) for one in drawn], threads)
    after = run_all([Run(one.scenario) for one in drawn], threads)
    kept = []
    for one, sound, faulty in zip(drawn, before, after, strict=True):
        assert sound is not None, f"{cause}, seed {one.seed}: the baseline was refused"
        assert faulty is not None, f"{cause}, seed {one.seed}: refused with its fault"
        judgement = judged(one.scenario, faulty)
        if judgement.failed and not judged(one.baseline, sound).failed:
            kept.append((one, judgement))
    return kept


def count(cause: str, failures: int, first_seed: int = KEPT_APART, threads: int = 2) -> Count:
    """Diagnose so many failures of one cause, with it on the list and without."""
    found = Count(cause)
    while found.failures < failures and found.drawn < MOST_DRAWN * failures:
        begin = first_seed + found.drawn
        kept = failing(cause, range(begin, begin + BATCH), threads)[: failures - found.failures]
        found.drawn += BATCH
        cases = make_cases([one.scenario for one, _ in kept], threads)
        for (one, _), studied in zip(kept, study(cases, [judgement for _, judgement in kept], threads), strict=True):
            found.failures += 1
            trials = rank(studied)
            right = trials[0].cause.key == cause
            found.first += right
            found.named += right and trials[0].named
            found.wrong += not right and trials[0].named
            if not right:
                found.misses[one.seed] = trials[0].cause.key
            others = rank(studied, cause)
            blamed = [trial.cause.key for trial in others if trial.named]
            found.withheld_wrong += bool(blamed)
            found.blamed.update(blamed[:1])
            if found.failures % PAIRS_EVERY == 0:
                found.paired += 1
                found.paired_wrong += bool(pairs(studied, others, threads))
    return found


def row(found: Count) -> str:
    """Give a row of the table."""
    shares = [
        f"{100.0 * part / whole:.0f} %" if whole else ""
        for part, whole in (
            (found.first, found.failures),
            (found.named, found.failures),
            (found.withheld_wrong, found.failures),
        )
    ]
    blamed = ", ".join(f"{name} {times}" for name, times in found.blamed.most_common(3))
    return f"| {found.cause} | {found.drawn} | {found.failures} | {' | '.join(shares)} | {blamed} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--failures", type=int, default=200, help="of each cause")
    parser.add_argument("--seed", type=int, default=KEPT_APART, help="the first one")
    parser.add_argument("--cause", action="append", choices=CAUSES, help="all, if not given")
    given = parser.parse_args()
    print(f"Seeds from {given.seed} on.\n")
    print("| cause | drawn | that fail | right cause first | and named | withheld: a wrong cause named | which |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    counts = []
    for cause in given.cause or CAUSES:
        counts.append(count(cause, given.failures, given.seed))
        print(row(counts[-1]), f"wrong, by seed: {counts[-1].misses}", flush=True)
    total = sum(one.failures for one in counts)
    for what in ("first", "named", "wrong", "withheld_wrong"):
        print(f"{what}: {sum(getattr(one, what) for one in counts)} of {total}")
    print(f"pairs, with the cause withheld: {sum(c.paired_wrong for c in counts)} of {sum(c.paired for c in counts)}")


if __name__ == "__main__":
    main()
