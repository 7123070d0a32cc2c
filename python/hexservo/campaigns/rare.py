"""Rare failures: subset simulation, an estimate where a campaign would need too many runs (docs/campaigns.md)."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from hexservo.campaigns.distributions import between_ends
from hexservo.campaigns.judging import Judge
from hexservo.campaigns.plan import CampaignPlan, load_plan
from hexservo.campaigns.words import of_common_noise
from hexservo.findings.display import Findings
from hexservo.findings.evidence import Column, Section, Table, picked
from hexservo.scenario.arrays import Array
from hexservo.scenario.fields import described
from hexservo.scenario.wording import number, whole_number

_SHARE = 0.1  # of the samples of a level that begin the chains of the next one
_MOST_LEVELS = 30
_FAR = 10.0  # ratio of repetitions above which some missed a region that others entered
_FEWEST_CHAINS = 10
_STEP = 0.6  # s of the first proposals, x' = sqrt(1 - s^2) x + s z; then by the share that is accepted
_ACCEPTED = 0.44  # share of proposals to accept (Papaioannou et al. 2015)
_NEW_NOISE = 0.5  # share of the proposals that have other noise
# of its noise that a chain makes, on average; with fewer, most runs have the noise of their start
_FEWEST_CHANGES = 1.0
# of noise: with so many the share of a tenth has a relative standard deviation of sqrt(0.9/0.1/10), about 1
_FEWEST_KINDS = 10.0


@dataclass(frozen=True, eq=False)
class Levels:
    """What subset simulation found."""

    probability: float  # estimate that the margin is negative; 0 if no level reached it; NaN if noise decides
    # coefficient of variation of the estimate if its levels are fully correlated, and its chains enter all regions of
    # failure; NaN where all runs of the first level fail, which has none
    variation: float
    thresholds: tuple[float, ...]  # margins of the levels, falling
    evaluations: int
    kinds: float = math.inf  # of noise in the last level, in effect, where few chains change theirs; inf: they do

    @property
    def noise_decides(self) -> bool:
        """Whether the chains ended since few kinds of noise were left in them: there is no estimate."""
        return self.kinds < _FEWEST_KINDS

    @property
    def not_rare(self) -> bool:
        """Whether a tenth or more of the first level fails, whose runs are drawn as those of a campaign."""
        return len(self.thresholds) == 1 and self.probability >= _SHARE


@described
@dataclass(frozen=True, repr=False, eq=False)
class RareFailures(Findings):
    """An estimate of a small failure probability. It is no bound, and replaces none."""

    plan: CampaignPlan  # whose failures are estimated
    repetitions: tuple[Levels, ...]  # independent ones; the first alone where failures are not rare
    seed: int  # of the draws

    @property
    def probability(self) -> float:
        """The estimate: the mean of the repetitions; 0 if none reached a failure, NaN if noise decides."""
        return float(np.mean([each.probability for each in self.repetitions]))

    @property
    def variation(self) -> float:
        """Coefficient of variation of the estimate, by the spread of the repetitions; NaN where there is none."""
        found = np.array([each.probability for each in self.repetitions])
        if len(found) == 1 or not found.any():
            return math.nan
        return float(found.std(ddof=1) / math.sqrt(len(found)) / found.mean())

    @property
    def evaluations(self) -> int:
        """Number of runs of all repetitions."""
        return sum(each.evaluations for each in self.repetitions)

    def headline(self) -> str:
        """Return a line that names the scenario."""
        return f'Rare failures of "{self.plan.scenario.name}"'

    def section(self) -> Section:
        """Return the estimate in sentences, with the margins of the levels."""
        levels, count = self.repetitions[-1], len(self.repetitions)
        how = f"subset simulation ({self.evaluations} runs, seed {self.seed})"
        if levels.noise_decides:
            sentences = [
                f"There is no estimate: noise decides which runs have a margin below {number(levels.thresholds[-1])}. "
                f"The chains seldom find other noise that reaches it: in effect {number(levels.kinds, 2)} different "
                f"kinds of noise are left in them, and an estimate needs {_FEWEST_KINDS:g}.",
                f"The chains of {how} ended there. More samples may help; a campaign needs none of this, and its "
                "interval is a bound.",
            ]
        elif self.repetitions[0].not_rare:
            failed = round(levels.probability * levels.evaluations)
            sentences = [
                f"{failed} of {levels.evaluations} runs fail: that is not rare. Use a campaign, whose interval is a "
                "bound.",
                f"They are the first level of {how}, which needs no other one.",
            ]
        else:
            found = sorted(each.probability for each in self.repetitions)
            if found[-1] == 0:
                smallest = min(each.thresholds[-1] for each in self.repetitions)
                first = f"No level reached a failure: the smallest margin is {number(smallest)}."
            elif count == 1:
                first = (
                    f"The failure probability is estimated as {found[0]:.2g}, by one repetition, which has no spread."
                )
            else:
                first = (
                    f"The failure probability is estimated as {self.probability:.2g}, the mean of {count} independent "
                    f"repetitions from {found[0]:.2g} to {found[-1]:.2g}; the coefficient of variation of this mean is "
                    f"about {number(self.variation, 2)}, by their spread."
                )
            sentences = [
                first,
                f"It is an estimate by {how} and no bound: it lacks failures in a region that no chain entered.",
            ]
            if found[0] * _FAR < found[-1]:
                sentences.append(
                    f"The repetitions differ by more than a factor of {_FAR:g}: some missed a region of failures that "
                    "others entered, and all may have missed one. More samples help, or a campaign, whose interval is "
                    "a bound."
                )
        if (common := self.plan.common_noise) is not None:
            sentences.append(of_common_noise("this holds", common))
        columns = (Column("repetition"), Column("level"), Column("margin"))
        rows = [[place, *level] for place, each in enumerate(self.repetitions) for level in enumerate(each.thresholds)]
        table = Table("Levels", columns, rows, "", "docs/campaigns.md")
        data = picked(self, "probability variation evaluations") | picked(levels, "noise_decides")
        data["not_rare"] = self.repetitions[0].not_rare
        data["probabilities"] = [each.probability for each in self.repetitions]
        return Section("rare_failures", "Rare failures", sentences, [table], "open", data)


def estimate_rare_failures(
    source: str | os.PathLike[str] | Mapping[str, Any] | CampaignPlan,
    *,
    samples: int = 1000,
    repetitions: int = 5,
    seed: int = 0,
    threads: int | None = None,
) -> RareFailures:
    """Estimate the failure probability of a campaign by subset simulation (docs/campaigns.md, section 8).

    Parameters
    ----------
    source
        As for `campaign`; its runs, chunks and confidence do not matter.
    samples
        Runs of a level, at least 100: a probability of 1e-k takes about k levels.
    repetitions
        Independent estimates, at least 1, each with the runs of all its levels; their spread states how far they can
        be trusted. One in which noise decides is the last, and one alone is made where failures are not rare.
    seed
        Of the chains: the same one gives the same estimate.
    threads
        As for `simulate_batch`.

    Raises
    ------
    TypeError
        For samples, repetitions or a seed that is no integer.
    ValueError
        For fewer samples, or repetitions, or a negative seed.
    ScenarioError
        As `campaign`, and for a draw that is no valid scenario, with its numbers.
    KeyboardInterrupt
        Ctrl-C.
    """
    plan = load_plan(source)
    judge = Judge(plan, threads)

    def margin(normal: Array, seeds: NDArray[np.uint64]) -> Array:
        return judge.smallest_margins(judge.drawing.numbers_of(between_ends(ndtr(normal)), seeds))

    drawing = judge.drawing
    found = repeated(margin, drawing.dimension, samples, repetitions, seed, has_noise=drawing.has_seed)
    return RareFailures(plan, found, seed)


def repeated(
    margin: Callable[[Array, NDArray[np.uint64]], Array],
    dimension: int,
    samples: int,
    repetitions: int,
    seed: int,
    *,
    has_noise: bool = True,
) -> tuple[Levels, ...]:
    """Return independent subset simulations: up to one in which noise decides, or the first alone if it is not rare.

    Arguments and errors as for `subset_simulation`; the first repetition is that with `seed`.
    """
    count, seed = whole_number("repetitions", repetitions, 1), whole_number("seed", seed, 0)
    found: list[Levels] = []
    for repetition in range(count):
        own = [seed, repetition] if repetition else seed
        found.append(subset_simulation(margin, dimension, samples, own, has_noise=has_noise))
        if found[-1].noise_decides or found[0].not_rare:
            break
    return tuple(found)


def subset_simulation(
    margin: Callable[[Array, NDArray[np.uint64]], Array],
    dimension: int,
    samples: int,
    seed: int | Sequence[int],
    *,
    has_noise: bool = True,
) -> Levels:
    """Estimate the probability that a margin is negative for standard normal numbers (Au and Beck 2001).

    The probability is a product of conditional ones of about a tenth: each level begins with the tenth of smallest
    margins of the one before, and continues them as Markov chains whose proposals keep the normal distribution
    (Papaioannou, Betz, Zwirglmaier and Straub 2015); one that leaves the level is not accepted. Where many margins
    are equal, a level has what is less than them, and where nothing is less, the failures of one level are counted.
    The coefficient of variation is that of Au and Beck's section 5 for fully correlated levels: the sum of those of the
    levels, each by equations (28) to (29). It is small for chains that missed a region of failures.

    A proposal with other noise is seldom accepted where noise decides. The chains are then copies of few runs, and the
    shares of the levels those of few kinds of noise. Where chains change their noise less than once, and fewer than 10
    kinds (in effect: 1/sum of the squares of their shares) are left in a level, there is no estimate.

    Parameters
    ----------
    margin
        Takes standard normal numbers (n, dimension) and seeds (n,), and returns margins (n,).
    dimension
        Of the numbers; may be 0 where only seeds vary.
    samples
        Of a level, at least 100; rounded down to a multiple of 10.
    seed
        Of the chains: one for `np.random.default_rng`.
    has_noise
        Whether the margin depends on the seeds; else chains that do not move have too few runs, and not too few kinds
        of noise.

    Raises
    ------
    TypeError
        For samples that are no integer.
    ValueError
        For fewer samples.
    """
    samples = whole_number("samples", samples, 100)
    random = np.random.default_rng(seed)
    length = round(1 / _SHARE)
    most_chains = chains = samples // length
    count = chains * length
    places = random.standard_normal((count, dimension))
    seeds = random.integers(0, 2**64, count, dtype=np.uint64)
    values = margin(places, seeds)
    evaluations, probability, variation = count, 1.0, 0.0
    changes = math.inf  # of its noise that a chain of this level made, on average; none are chains in the first one
    thresholds: list[float] = []
    step = _STEP
    for level in range(_MOST_LEVELS):
        order = np.argsort(values, kind="stable")
        threshold = float((values[order[most_chains - 1]] + values[order[most_chains]]) / 2)
        below = values[values < threshold]
        if (values <= threshold).mean() > 2 * _SHARE and len(below) >= _FEWEST_CHAINS:
            threshold = float(below.max())  # many runs have one margin: the level is what is less
        failed = values < 0
        stays = bool(thresholds) and threshold >= thresholds[-1]
        final = threshold <= 0 or int(failed.sum()) >= most_chains or (stays and bool(failed.any()))
        inside = failed if final else values <= threshold
        share = float(inside.mean())
        thresholds.append(0.0 if final else threshold)
        if share == 0:
            break
        if has_noise and changes < _FEWEST_CHANGES and (kinds := _kinds(seeds[inside])) < _FEWEST_KINDS:
            return Levels(math.nan, math.inf, tuple(thresholds), evaluations, kinds)
        correlated = 0.0 if level == 0 else _correlation(inside.reshape(length, chains))
        variation += math.sqrt((1 - share) / (share * len(values)) * (1 + correlated))
        probability *= share
        if final:
            stated = variation if probability < 1.0 else math.nan
            return Levels(probability, stated, tuple(thresholds), evaluations)
        if stays:
            break  # a margin that does not fall any more
        begin = order[: int(inside.sum())]
        if len(begin) > most_chains:
            begin = random.choice(begin, most_chains, replace=False)
        chains = len(begin)
        length = count // chains
        parts = [(places[begin], seeds[begin], values[begin])]
        changes = 0.0
        for _ in range(length - 1):
            here, own, before = parts[-1]
            there = math.sqrt(1 - step**2) * here + step * random.standard_normal(here.shape)
            fresh = random.integers(0, 2**64, chains, dtype=np.uint64)
            proposed = np.where(random.random(chains) < _NEW_NOISE, fresh, own)
            found = margin(there, proposed)
            evaluations += chains
            taken = found <= threshold
            changes += float((taken & (proposed != own)).mean())
            step = min(step * math.exp(float(taken.mean()) - _ACCEPTED), 1.0)
            parts.append(
                (
                    np.where(taken[:, None], there, here),
                    np.where(taken, proposed, own),
                    np.where(taken, found, before),
                )
            )
        places, seeds, values = (np.concatenate([part[kind] for part in parts]) for kind in range(3))
    return Levels(0.0, math.inf, (*thresholds, float(values.min())), evaluations)


def _kinds(seeds: NDArray[np.uint64]) -> float:
    """Return how many seeds there are in effect: as many equally frequent ones have the same sum of squared shares."""
    counts = np.unique(seeds, return_counts=True)[1]
    return float(counts.sum() ** 2 / (counts**2).sum())


def _correlation(inside: NDArray[np.bool_]) -> float:
    """Return the factor gamma of Au and Beck's (29): what correlation within chains, (length, chains), adds."""
    length, chains = inside.shape
    marks = inside.astype(float)
    share = marks.mean()
    whole_variance = share * (1 - share)
    if whole_variance == 0:
        return 0.0
    gamma = 0.0
    for lag in range(1, length):
        covariance = (marks[:-lag] * marks[lag:]).sum() / ((length - lag) * chains) - share**2
        gamma += 2 * (1 - lag / length) * covariance / whole_variance
    return max(gamma, 0.0)
