"""Intervals for a failure probability: their definition, and what they hold against an adversary who stops at will."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import bdtr, bdtrc, betaln, xlog1py, xlogy

from hexservo.campaigns.chunks import Tally
from hexservo.campaigns.intervals import (
    JEFFREYS,
    RARE,
    Mixture,
    anytime_interval,
    clopper_pearson,
    joint_confidence,
    runs_for_bound,
)
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.result import summary_of
from hexservo.campaigns.store import new_record
from hexservo.campaigns.words import summary_section
from hexservo.findings.evidence import Section
from hexservo.scenario.wording import above

MIXTURES = [JEFFREYS, Mixture(2.0, 5.0)]


def log_martingale(probability: Any, failures: Any, runs: Any, mixture: Mixture = JEFFREYS) -> Any:
    """log M_n(p), of numbers or arrays that broadcast."""
    k, n, p = np.asarray(failures), np.asarray(runs), np.asarray(probability)
    likelihood = xlogy(k, p) + xlog1py(n - k, -p)
    return betaln(mixture.a + k, mixture.b + n - k) - betaln(mixture.a, mixture.b) - likelihood


@pytest.mark.parametrize("mixture", MIXTURES)
@pytest.mark.parametrize(("k", "n"), [(0, 1), (0, 30), (3, 30), (30, 30)])
def test_the_martingale_is_a_likelihood_ratio_averaged_over_its_mixture(k: int, n: int, mixture: Mixture) -> None:
    prior = stats.beta(mixture.a, mixture.b)
    average = prior.expect(lambda q: q**k * (1 - q) ** (n - k), epsabs=0, epsrel=1e-9)
    for p in (0.01, 0.3, 0.9):
        ratio = average / (p**k * (1 - p) ** (n - k))
        assert log_martingale(p, k, n, mixture) == pytest.approx(math.log(ratio), abs=1e-6)  # of the quadrature


@pytest.mark.parametrize("mixture", [*MIXTURES, RARE])
def test_its_mean_after_one_more_run_is_its_value(mixture: Mixture) -> None:
    for k, n, p in [(0, 0, 0.3), (0, 10, 1e-3), (4, 1000, 1e-2), (17, 2_000_000, 1e-5)]:
        now, fails, passes = (
            float(np.exp(log_martingale(p, k + more, n + runs, mixture) - log_martingale(p, k, n, mixture)))
            for more, runs in ((0, 0), (1, 1), (0, 1))
        )
        # a logarithm of B is a difference of logarithms of Gamma, of the size m log m, each rounded by some 2^-53
        rounding = 8 * 2.0**-53 * (n + mixture.b + 10) * math.log(n + mixture.b + 10)
        assert p * fails + (1 - p) * passes == pytest.approx(now, rel=rounding)


@pytest.mark.parametrize(
    ("mixture", "k", "n", "low", "high"),
    [
        (JEFFREYS, 0, 10**12, 0.0, 1.73836077742919944e-11),
        (JEFFREYS, 10**6, 10**12, 9.94174055632624714e-7, 1.00584866035897714e-6),
        (JEFFREYS, 10**9, 10**12, 0.000999815512028089325, 0.00100018451064252415),
        (JEFFREYS, 5 * 10**11, 10**12, 0.499997081350125154, 0.500002918649874846),
        (JEFFREYS, 10**4, 10**10, 9.46692575120790314e-7, 1.05527195039218524e-6),
        (JEFFREYS, 10**7, 10**10, 0.000998285187976991398, 0.00100171677268696915),
        (RARE, 0, 10**12, 0.0, 4.8378048489974789e-12),
        (RARE, 10**6, 10**12, 9.95168841194983738e-7, 1.00484676914661048e-6),
        (RARE, 10**9, 10**12, 0.000999778923885117921, 0.00100022110867015881),
        (RARE, 5 * 10**11, 10**12, 0.49994105904707981, 0.50005894095292019),
        (RARE, 10**4, 10**10, 9.57253810189280857e-7, 1.04400018694165342e-6),
        (RARE, 10**7, 10**10, 0.000997897162754515709, 0.00100210578637504074),
    ],
)
def test_rounding_at_the_largest_numbers_of_runs(mixture: Mixture, k: int, n: int, low: float, high: float) -> None:
    """The ends at 95 %, from mpmath with 60 digits. A difference of logarithms of Gamma of size n log n is off by some
    2^-53 n log n; in parts of the interval's width, over which log M falls and rises by 3, that is below 1e-3 at 10^12
    runs, the most of a campaign, and below 1e-5 at 10^10. Found are 6e-5 and 1.3e-6."""
    found = anytime_interval(k, n, 0.95, mixture)
    tolerance = (1e-3 if n == 10**12 else 1e-5) * (high - low)
    print(f"{n} runs: {np.abs(np.subtract(found, (low, high))).max() / (high - low):.1e} of the width")
    np.testing.assert_allclose(found, (low, high), rtol=0, atol=tolerance)


@pytest.mark.parametrize("mixture", [*MIXTURES, RARE])
@pytest.mark.parametrize(
    ("k", "n"), [(0, 1), (0, 100), (1, 1), (7, 100), (100, 100), (3, 10**7), (10**6, 10**8), (0, 10**12)]
)
def test_the_ends_are_where_the_martingale_reaches_its_bound(k: int, n: int, mixture: Mixture) -> None:
    confidence = 0.99
    low, high = anytime_interval(k, n, confidence, mixture)
    assert 0 <= low <= k / n <= high <= 1
    assert (low == 0) == (k == 0)
    assert (high == 1) == (k == n)
    for end in (low, high):
        if 0 < end < 1:
            rounding = 8 * 2.0**-53 * (n + mixture.b + 10) * math.log(n + mixture.b + 10)  # as above
            tolerance = rounding + 1e-10 * abs(n * end - k) / (1 - end)  # and the end, to 1e-10 of itself
            assert log_martingale(end, k, n, mixture) == pytest.approx(math.log(100), abs=tolerance)


def test_the_pages_have_the_intervals_of_their_counts() -> None:
    pages = Path(__file__).parents[2] / "docs"
    table = (pages / "robustness.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(campaign-\S+)` \| ([\d ]+) \| ([\d ]+) \| (\S+) \.\.\. (\S+) \|", table, re.MULTILINE)
    assert len(rows) == 4
    ends = {}
    for name, *counts, low, high in rows:
        runs, failures = (int(count.replace(" ", "")) for count in counts)
        exact = load_plan(name).interval(failures, runs)
        ends[name] = (float(low), float(high))
        assert ends[name] == pytest.approx(exact, rel=5e-3)  # 3 digits
    claims = (pages / "claims.md").read_text(encoding="utf-8")
    low, high = ends["campaign-paper-gravity"]
    assert (
        f"{ends['campaign-paper'][1]:.3g}; {low:.3f} to {high:.3f} (95 %, at any stop)".replace("e-0", "e-") in claims
    )


@pytest.mark.parametrize(
    ("confidence", "intervals", "together"),
    [
        (0.95, 1, "0.95"),
        (0.95, 3, "0.85"),
        (0.95, 21, "0.0"),
        (0.99999, 2, "0.99998"),
        (0.9999999999999999, 3, "0.9999999999999997"),
    ],
)
def test_a_confidence_is_never_written_larger_than_it_is(confidence: float, intervals: int, together: str) -> None:
    assert str(joint_confidence(confidence, intervals)) == together
    plan = load_plan("campaign-paper").changed(
        confidence=confidence, require=[f"final_error <= {1 + bound}" for bound in range(intervals)], runs=1
    )
    section = summary_section(summary_of(plan, new_record(plan), Tally([0] * intervals)))
    assert f"with a confidence of {confidence} that holds" in section.sentences[0]
    note = f"Each interval has the confidence of {confidence}; all of them together have {together}."
    assert section.items[0].note.startswith(note)


def test_intervals_narrow_with_runs_and_widen_with_confidence() -> None:
    highs = [anytime_interval(0, n)[1] for n in (1, 10, 100, 1000, 10_000)]
    assert highs == sorted(highs, reverse=True)
    assert anytime_interval(5, 100, 0.9)[1] < anytime_interval(5, 100, 0.99)[1]
    assert anytime_interval(0, 0) == clopper_pearson(0, 0) == (0.0, 1.0)
    for k, n in [(0, 50), (3, 50), (50, 50)]:  # holding at every n costs width
        ours, fixed = anytime_interval(k, n), clopper_pearson(k, n)
        assert ours[0] <= fixed[0] <= fixed[1] <= ours[1]


@pytest.mark.parametrize("interval", [anytime_interval, clopper_pearson])
def test_counts_that_no_campaign_has_are_refused(interval: Callable[..., tuple[float, float]]) -> None:
    for failures, runs, name in ((6, 5, "failures"), (-1, 5, "failures"), (0, -1, "runs")):
        with pytest.raises(ValueError, match=rf"^{name}: expected an integer "):
            interval(failures, runs)
    for wrong in ((1.5, 5), (1, 5.0), (True, 5)):
        with pytest.raises(TypeError, match=r"^(failures|runs): expected an integer, got (float|bool)$"):
            interval(*wrong)


def test_figures_for_no_failure_in_2_900_000_runs() -> None:
    assert f"{anytime_interval(0, 2_900_000, 0.95, RARE)[1]:.3g}" == "1.23e-06"
    # Clopper and Pearson's upper bound alone at 95 %, which is the upper end of the two-sided interval at 90 %
    assert f"{clopper_pearson(0, 2_900_000, 0.90)[1]:.3g}" == "1.03e-06"
    assert clopper_pearson(0, 2_900_000, 0.90)[1] == pytest.approx(1 - 0.05 ** (1 / 2_900_000), rel=1e-9)


def test_clopper_pearson_is_that_of_scipy() -> None:
    for k, n in [(0, 10), (3, 10), (10, 10), (12, 5000)]:
        other = stats.binomtest(k, n).proportion_ci(0.95, "exact")
        assert clopper_pearson(k, n) == pytest.approx((other.low, other.high), rel=1e-9)


@pytest.mark.parametrize("mixture", [JEFFREYS, RARE])
@pytest.mark.parametrize("failures", [0, 2])
def test_runs_for_a_bound_are_the_least_ones(failures: int, mixture: Mixture) -> None:
    runs = runs_for_bound(1e-3, failures, 0.95, mixture)
    assert anytime_interval(failures, runs, 0.95, mixture)[1] <= 1e-3
    assert anytime_interval(failures, runs - 1, 0.95, mixture)[1] > 1e-3


@pytest.mark.parametrize(
    ("p", "mixture"), [pytest.param(0.05, JEFFREYS, marks=pytest.mark.slow), (0.005, JEFFREYS), (0.001, RARE)]
)
def test_coverage_where_an_adversary_stops_at_the_best_moment(p: float, mixture: Mixture) -> None:
    """The adversary may stop after any of 10 000 runs, and picks one where the interval misses the probability if there
    is any. One who stops where the upper end is lowest, and one who stops where the lower end is highest, miss at most
    as often as this one. Between two failures both tests are extreme at an end: a binomial tail falls with every run
    that passes, and log M_n is convex in n."""
    seed, repetitions, horizon, confidence = 20261122, 1000, 10_000, 0.95
    random = np.random.default_rng(seed)
    ours, fixed = 0, 0
    for _ in range(repetitions):
        fails = random.random(horizon) < p
        n = 1 + np.flatnonzero(fails | np.append(fails[1:], True) | (np.arange(horizon) == 0))
        k = np.cumsum(fails)[n - 1]
        ours += bool((log_martingale(p, k, n, mixture) < -math.log1p(-confidence)).all())
        tail = (1 - confidence) / 2
        at_least = np.where(k > 0, bdtrc(np.maximum(k, 1) - 1, n, p), 1.0)  # probability of k failures or more
        fixed += bool(((bdtr(k, n, p) > tail) & (at_least > tail)).all())
    print(
        f"p = {p}, seed {seed}: the anytime interval holds in {ours / repetitions:.1%} of {repetitions} repetitions, "
        f"that of Clopper and Pearson in {fixed / repetitions:.1%}"
    )
    assert ours >= confidence * repetitions
    assert fixed < 0.9 * repetitions


def test_the_adversary_of_the_test_above_uses_the_intervals() -> None:
    """Membership by martingale and by binomial tails is membership in the intervals as they are computed."""
    random = np.random.default_rng(7)
    for n, q in [(1, 0.5), (20, 0.1), (400, 0.02), (3000, 0.3)]:
        k = int(random.binomial(n, q))
        for p in random.uniform(0, min(1, 3 * q), 20):
            low, high = anytime_interval(k, n)
            assert (low < p < high) == (log_martingale(p, k, n) < math.log(20))
            low, high = clopper_pearson(k, n)
            assert (low < p < high) == (bdtr(k, n, p) > 0.025 and 1 - (bdtr(k - 1, n, p) if k else 0.0) > 0.025)


def test_the_mean_of_the_martingale_is_one() -> None:
    """The sum over all counts after n runs is 1: what Ville's inequality starts from."""
    for n, p in [(50, 0.1), (2000, 0.001)]:
        k = np.arange(n + 1)
        total = np.exp(log_martingale(p, k, n) + stats.binom.logpmf(k, n, p)).sum()
        assert total == pytest.approx(1.0, abs=1e-9)


# ---- What they decide -----------------------------------------------------------------------------------------------


def judged(
    failures: int, runs: int, until: dict[str, float] | None = None, scenario: str = "paper", **more: str
) -> Section:
    """The section of a campaign in which so many runs fail."""
    vary = {"uncertainty.gravity": {"uniform": [-0.1, 0.1]}, **more}
    file = {"scenario": scenario, "vary": vary, "require": ["outcome == completed"], "runs": max(runs, 1)}
    plan = load_plan(file | {"until": until})
    return summary_section(summary_of(plan, new_record(plan), Tally([failures], runs, failures)))


LIKELY, NARROW = {"probability_below": 0.2}, {"width_below": 0.1}


@pytest.mark.parametrize(
    ("failures", "runs", "until", "verdict"),
    [
        (0, 0, None, "open"),
        (0, 1, None, "warning"),  # 0 to 0.975
        (1, 1, None, "warning"),
        (0, 52, None, "warning"),
        (0, 53, None, "good"),  # the interval lies below a tenth
        (1, 10_000, None, "warning"),
        (6, 6, None, "warning"),  # from 0.47
        (7, 7, None, "bad"),  # from 0.52
        (100, 100, None, "bad"),
        (0, 30, LIKELY, "good"),
        (1, 1000, LIKELY, "good"),
        (0, 10, LIKELY, "warning"),
        (100, 300, LIKELY, "bad"),
        (0, 100, NARROW, "good"),
        (0, 53, {"width_below": 1e-3}, "warning"),
        (1, 1000, NARROW, "warning"),
        (20, 20, NARROW, "bad"),
    ],
)
def test_verdicts(failures: int, runs: int, until: dict[str, float] | None, verdict: str) -> None:
    assert judged(failures, runs, until).verdict == verdict


@pytest.mark.parametrize(
    ("failures", "until", "verdict"), [(0, None, "warning"), (0, LIKELY, "warning"), (90, None, "bad")]
)
def test_runs_with_one_noise_are_never_good(failures: int, until: dict[str, float] | None, verdict: str) -> None:
    found = judged(failures, 100, until, "composite-30hz")
    assert found.verdict == verdict
    assert found.sentences[1] == (
        "All runs have the same noise (seed 0): the interval holds for that noise alone; "
        "vary seed: each for other noise."
    )
    assert found.data["common_noise"] == 0
    own = judged(0, 100, None, "composite-30hz", seed="each")
    assert (own.verdict, own.data["common_noise"]) == ("good", None)
    assert not any("noise" in sentence for sentence in own.sentences)


@pytest.mark.parametrize(
    ("failures", "runs", "until", "sentence"),
    [
        (300, 1000, {"width_below": 0.5}, "The interval is {width} wide, not more than 0.5, as the campaign was to"),
        (0, 30, {"probability_below": 0.2}, "It is below 0.2, as the campaign was to decide."),
        (0, 10, {"probability_below": 0.2}, "Whether it is below 0.2 is not decided yet."),
        (100, 300, {"probability_below": 0.2}, "It is above 0.2: the goal cannot be reached."),
    ],
)
def test_what_the_interval_decides(failures: int, runs: int, until: dict[str, float], sentence: str) -> None:
    low, high = anytime_interval(failures, runs)
    assert judged(failures, runs, until).sentences[1].startswith(sentence.format(width=above(high - low)))


@pytest.mark.parametrize(("settled", "verdict"), [(50, "good"), (51, "warning")])
def test_no_good_verdict_where_most_runs_are_settled_at_the_start(settled: int, verdict: str) -> None:
    assert summary_section({**judged(0, 100).data, "settled_at_start": settled}).verdict == verdict


def test_a_width_that_is_not_reached_is_said() -> None:
    assert anytime_interval(0, 200)[1] == pytest.approx(0.030611, abs=1e-6)  # rounded up in the sentence
    assert judged(0, 200, {"width_below": 1e-3}).sentences[1] == (
        "The interval is 0.0307 wide: the width of 0.001 that the campaign was to reach is not reached yet."
    )
    assert judged(0, 200, NARROW).sentences[1] == (
        "The interval is 0.0307 wide, not more than 0.1, as the campaign was to reach."
    )
