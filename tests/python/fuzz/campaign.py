"""A campaign: one trial after another, each with its own seed."""

from __future__ import annotations

import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.random import Generator

Trial = Callable[[Generator, Path], str]
"""Tries something in an empty folder and names what came out; raises where a promise was broken."""


@dataclass
class Findings:
    """What a campaign saw."""

    name: str
    seed: int
    seen: Counter[str] = field(default_factory=Counter)
    failures: list[tuple[int, BaseException]] = field(default_factory=list)  # number of the trial, and what it raised

    @property
    def trials(self) -> int:
        """Number of trials."""
        return self.seen.total() + len(self.failures)

    def __str__(self) -> str:
        """Give a line of counts."""
        counts = ", ".join(f"{count} {what}" for what, count in self.seen.most_common())
        return f"{self.name}: seed {self.seed}, {self.trials} trials, {len(self.failures)} failed: {counts}"


def generator(name: str, seed: int, trial: int) -> Generator:
    """Give the random numbers of one trial, whichever trials came before."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed, trial])


def run(
    name: str, trial: Trial, folder: Path, *, seed: int, first: int = 0, trials: int = 2**62, seconds: float = 1e9
) -> Findings:
    """Run trials until their number or the time is reached; a warning fails a trial, as an error does."""
    findings = Findings(name, seed)
    until = time.monotonic() + seconds
    number = first
    while number < first + trials and (number == first or time.monotonic() < until):
        place = folder / f"{name}-{number}"
        place.mkdir()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                findings.seen[trial(generator(name, seed, number), place)] += 1
        except Exception as error:
            findings.failures.append((number, error))
        number += 1
    return findings
