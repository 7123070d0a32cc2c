"""Estimates: subset simulation against planted probabilities, Sobol indices against closed forms."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.special import ndtri

import hexservo as hs
from hexservo.campaigns.distributions import uniform_of
from hexservo.campaigns.judging import Judge
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.rare import RareFailures, repeated, subset_simulation
from hexservo.campaigns.sensitivity import Indices, sobol_indices
from hexservo.findings.evidence import as_data
from hexservo.scenario.arrays import Array

Margin = Callable[[Array, NDArray[np.uint64]], Array]


def half_space(probability: float) -> Margin:
    """Standard normal numbers beyond a plane."""
    distance = stats.norm.isf(probability)
    return lambda places, seeds: np.asarray(distance - places.sum(axis=1) / math.sqrt(places.shape[1]))


def shell(probability: float, dimension: int) -> Margin:
    """Standard normal numbers outside of a sphere: failures in all directions."""
    square = stats.chi2.isf(probability, dimension)
    return lambda places, seeds: np.asarray(1 - (places**2).sum(axis=1) / square)


@pytest.mark.parametrize(
    ("shape", "dimension"), [("plane", 2), pytest.param("plane", 10, marks=pytest.mark.slow), ("shell", 10)]
)
def test_subset_simulation_of_a_planted_probability(shape: str, dimension: int) -> None:
    planted = 1e-8
    margin = half_space(planted) if shape == "plane" else shell(planted, dimension)
    found = [subset_simulation(margin, dimension, 20_000, seed) for seed in range(20)]
    shares = np.array([each.probability for each in found]) / planted
    spread = float(shares.std() / shares.mean())
    print(
        f"{shape} in {dimension} dimensions, seeds 0 to 19: median {np.median(shares):.3f} of the planted probability, "
        f"from {shares.min():.3f} to {shares.max():.3f}; coefficient of variation {spread:.3f}, estimated "
        f"{np.median([each.variation for each in found]):.3f}"
    )
    assert max(each.evaluations for each in found) <= 200_000
    assert 1 / 1.5 <= np.median(shares) <= 1.5
    assert ((shares > 1 / 1.5) & (shares < 1.5)).all()
    assert spread < np.median([each.variation for each in found])


def beside_a_slope(probability: float) -> Margin:
    """Failures without a slope towards them, beside a margin that falls towards another side."""
    begins = stats.norm.isf(probability)
    return lambda places, seeds: np.minimum(1 - 0.18 * places[:, 0], np.where(places[:, 1] > begins, -1.2, 1.0))


@pytest.mark.parametrize(("planted", "margin"), [(3e-4, beside_a_slope(3e-4)), (1e-4, half_space(1e-4))])
def test_the_spread_of_repetitions_is_that_of_their_mean(planted: float, margin: Margin) -> None:
    """Also where chains miss a region, in which a single repetition has a variation that is far too small."""
    plan = load_plan(FILE)
    found = [RareFailures(plan, repeated(margin, 2, 1000, 5, seed), seed) for seed in range(40)]
    shares = np.array([each.probability for each in found]) / planted
    spread, stated = shares.std(), math.sqrt(np.mean([each.variation**2 for each in found]))
    differ = [
        "The repetitions differ by more than a factor of 10" in " ".join(each.section().sentences) for each in found
    ]
    print(f"seeds 0 to 39: mean {shares.mean():.2f}, spread {spread:.2f}, stated {stated:.2f}, {sum(differ)} differ")
    assert abs(shares.mean() - 1) < 4 * spread / math.sqrt(40)
    assert spread < 1.5 * stated
    assert stated < 1.5 * spread
    assert all(differ) if planted == 3e-4 else not any(differ)
    first = found[0].section().sentences[0]
    assert "the mean of 5 independent repetitions from " in first
    assert "at most" not in first


def test_repetitions_that_add_nothing_are_left_out() -> None:
    assert len(repeated(half_space(0.3), 3, 1000, 5, 1)) == 1
    assert len(repeated(noisy(1e-9, 1.0), 1, 1000, 5, 1)) == 1
    several = repeated(half_space(1e-3), 2, 100, 4, 7)
    assert len({each.probability for each in several}) == 4
    (alone,) = repeated(half_space(1e-3), 2, 100, 1, 7)
    assert alone.probability == several[0].probability
    one = RareFailures(load_plan(FILE), (alone,), 7)
    assert math.isnan(one.variation)
    assert "by one repetition, which has no spread" in one.section().sentences[0]
    with pytest.raises(ValueError, match="repetitions: expected an integer of at least 1, got 0"):
        repeated(half_space(0.3), 3, 1000, 0, 1)


def noisy(probability: float, noise: float) -> Margin:
    """A margin of the first number and of the seed, whose share of the variance is `noise`."""

    def margin(places: Array, seeds: NDArray[np.uint64]) -> Array:
        known = math.sqrt(1 - noise) * places[:, 0] if places.shape[1] else 0.0
        return np.asarray(stats.norm.isf(probability) - known - math.sqrt(noise) * ndtri(uniform_of(seeds)))

    return margin


@pytest.mark.parametrize(("planted", "noise", "samples"), [(1e-4, 0.5, 5000), (1e-6, 0.2, 1000), (1e-6, 0.2, 5000)])
def test_subset_simulation_where_noise_takes_part(planted: float, noise: float, samples: int) -> None:
    """An estimate that is given is right to its coefficient of variation; where few kinds of noise are left is none."""
    found = [subset_simulation(noisy(planted, noise), 1, samples, seed) for seed in range(20)]
    given = [each for each in found if not each.noise_decides]
    shares = np.array([each.probability for each in given]) / planted
    spread, stated = shares.std() / shares.mean(), np.median([each.variation for each in given])
    print(f"{len(given)} of 20 seeds: {np.round(sorted(shares), 2).tolist()}; spread {spread:.2f}, stated {stated:.2f}")
    assert len(given) >= 5
    assert 1 / 1.5 <= np.median(shares) <= 1.5
    assert spread < stated


@pytest.mark.parametrize(
    ("planted", "noise", "dimension"), [(1e-6, 0.5, 1), (1e-3, 1.0, 0), (1e-4, 1.0, 0), (1e-9, 1.0, 1)]
)
def test_no_estimate_where_noise_decides(planted: float, noise: float, dimension: int) -> None:
    for seed in range(10):
        found = subset_simulation(noisy(planted, noise), dimension, 1000, seed)
        assert found.noise_decides
        assert math.isnan(found.probability)
        assert found.kinds < 10


@pytest.mark.parametrize(("planted", "dimension", "samples"), [(1e-4, 2, 1000), (1e-6, 10, 200), (1e-6, 10, 1000)])
def test_the_variation_that_is_stated_is_not_below_that_of_many_seeds(
    planted: float, dimension: int, samples: int
) -> None:
    found = [subset_simulation(half_space(planted), dimension, samples, seed) for seed in range(60)]
    shares = np.array([each.probability for each in found]) / planted
    stated = np.median([each.variation for each in found])
    print(f"spread {shares.std() / shares.mean():.2f}, stated {stated:.2f}, seeds 0 to 59")
    assert not any(each.noise_decides for each in found)
    assert shares.std() / shares.mean() <= stated


@pytest.mark.parametrize(
    ("planted", "some"),
    [(0.05, None), (0.03, None), (0.01, None), (0.002, None), (1e-3, 0.03), (1e-5, 0.03), (1e-4, 0.15)],
)
def test_subset_simulation_where_many_margins_are_equal(planted: float, some: float | None) -> None:
    """Passed or failed alone; or a metric that is zero in most runs, as an overshoot is."""
    failed = stats.norm.ppf(planted)

    def margin(places: Array, seeds: NDArray[np.uint64]) -> Array:
        if some is None:
            return np.where(places[:, 0] < failed, -1.5, 1.0)
        begins = stats.norm.ppf(some)
        falling = 0.9 * (places[:, 0] - failed) / (begins - failed)
        return np.where(places[:, 0] < begins, falling, 1.0)

    found = [subset_simulation(margin, 3, 1000, seed) for seed in range(40)]
    shares = np.array([each.probability for each in found]) / planted
    stated = np.median([each.variation for each in found if each.probability > 0])
    print(f"{planted:g}: mean {shares.mean():.3f}, spread {shares.std():.2f}, stated {stated:.2f}, seeds 0 to 39")
    assert abs(shares.mean() - 1) < 4 * stated / math.sqrt(40)
    assert shares.std() < 2 * stated
    assert (shares == 0).mean() <= 4 * math.exp(-1000 * planted)  # no failure among 1000 runs


def test_subset_simulation_of_what_is_not_rare_or_never_fails() -> None:
    often = subset_simulation(half_space(0.3), 3, 1000, 1)
    assert often.evaluations == 1000
    assert stats.binomtest(round(often.probability * 1000), 1000, 0.3).pvalue > 1e-3
    assert often.variation == pytest.approx(math.sqrt((1 - often.probability) / (1000 * often.probability)))
    always = subset_simulation(lambda places, seeds: np.full(len(places), -1.0), 3, 1000, 1)
    assert (often.not_rare, always.not_rare, always.probability) == (True, True, 1.0)
    assert math.isnan(always.variation)
    for levels in (often, always):
        words = " ".join(RareFailures(load_plan(FILE), (levels,), 1).section().sentences)
        assert f"{round(1000 * levels.probability)} of 1000 runs fail: that is not rare. Use a campaign" in words
        assert "variation" not in words
    assert not subset_simulation(half_space(0.02), 3, 1000, 1).not_rare
    never = subset_simulation(lambda places, seeds: np.ones(len(places)), 3, 1000, 1)
    assert (never.probability, never.variation) == (0.0, math.inf)
    with pytest.raises(ValueError, match="samples: expected an integer of at least 100, got 99"):
        subset_simulation(half_space(0.3), 3, 99, 1)


def test_sobol_indices_of_the_ishigami_function() -> None:
    """Ishigami and Homma 1990: sin x1 + a sin^2 x2 + b x3^4 sin x1, uniform within +-pi."""
    a, b = 7.0, 0.1

    def outputs(inputs: Array) -> Array:
        x = (2 * inputs - 1) * math.pi
        value = np.sin(x[0]) + a * np.sin(x[1]) ** 2 + b * x[2] ** 4 * np.sin(x[0])
        return np.stack([value, np.ones_like(value), np.where(inputs[0] < 0.5, np.nan, value), 2 * value])

    one = (1 + b * math.pi**4 / 5) ** 2 / 2
    two, three = a**2 / 8, b**2 * math.pi**8 * (1 / 18 - 1 / 50)
    variance = one + two + three
    found, constant, undefined, doubled = sobol_indices(outputs, 3, 1024, 5)
    assert constant == "it is the same in all runs"
    assert isinstance(undefined, str)
    assert undefined.startswith("it has no value in ")
    assert isinstance(found, Indices)
    assert isinstance(doubled, Indices)
    print(f"seed 5, 1024 samples: first order {np.round(found.first, 3)}, total {np.round(found.total, 3)}")
    for values, interval, expected in (
        (found.first, found.first_interval, [one, two, 0.0]),
        (found.total, found.total_interval, [one + three, two, three]),
    ):
        assert (interval[:, 0] <= np.array(expected) / variance).all()
        assert (interval[:, 1] >= np.array(expected) / variance).all()
        np.testing.assert_allclose(values, np.array(expected) / variance, rtol=0, atol=0.05)
    np.testing.assert_allclose(doubled.total, found.total, rtol=1e-9, atol=1e-12)
    np.random.seed(1)  # noqa: NPY002  the global generator, which has no part in it
    again = sobol_indices(outputs, 3, 1024, 5)[0]
    assert isinstance(again, Indices)
    np.testing.assert_array_equal(again.first_interval, found.first_interval)
    np.testing.assert_array_equal(again.total_interval, found.total_interval)
    with pytest.raises(ValueError, match="samples: expected a power of 2, at least 4, got 100"):
        sobol_indices(outputs, 3, 100, 5)


FILE: dict[str, Any] = {
    "scenario": hs.load_scenario("composite-30hz").updated({"simulation.duration": 0.2, "metrics.rms_start": 0.1}),
    "vary": {
        "target.rotation": {"normal": [0.0, 0.01], "each": True},
        "uncertainty.gravity": {"normal": [0.0, 0.001]},
        "seed": "each",
    },
    "require": ["peak_leg_excursion <= 0.0036"],
    "runs": 2000,
}


@pytest.mark.parametrize("estimate", [hs.sensitivity, hs.estimate_rare_failures])
@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"samples": 4.0}, TypeError, "samples: expected an integer, got float"),
        ({"samples": True}, TypeError, "samples: expected an integer, got bool"),
        ({"samples": -1}, ValueError, r"samples: expected an integer of at least \d+, got -1"),
        ({"seed": None}, TypeError, "seed: expected an integer, got NoneType"),
        ({"seed": -1}, ValueError, "seed: expected an integer of at least 0, got -1"),
    ],
)
def test_numbers_that_are_not_whole_are_refused(
    estimate: Callable[..., object], arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=f"^{message}$"):
        estimate(FILE, **arguments)


def test_whole_numbers_of_numpy_are_taken() -> None:
    def function(inputs: Array) -> Array:
        return inputs[:1]

    (found,) = sobol_indices(function, 2, np.int64(32), np.uint8(3))  # type: ignore[arg-type]
    (same,) = sobol_indices(function, 2, 32, 3)
    assert isinstance(found, Indices)
    assert isinstance(same, Indices)
    np.testing.assert_array_equal(found.total, same.total)


@pytest.mark.parametrize("outputs", [2, 3])
def test_sobol_indices_of_a_single_input_are_one(outputs: int) -> None:
    """All variance is that of the only input: for a linear function 256 points give 1 within 2 %."""
    slopes = np.arange(1.0, outputs + 1.0)[:, None]
    for found in sobol_indices(lambda inputs: slopes * inputs, 1, 256, 5):
        assert isinstance(found, Indices)
        np.testing.assert_allclose([found.first, found.total], 1.0, rtol=0, atol=0.02)


def test_what_has_no_effect_has_indices_of_zero_with_their_interval() -> None:
    (found,) = sobol_indices(lambda inputs: inputs[:1] + inputs[1:2] ** 2, 3, 16, 3)
    assert isinstance(found, Indices)
    assert (found.first[2], found.total[2]) == (0.0, 0.0)
    np.testing.assert_array_equal([found.first_interval[2], found.total_interval[2]], 0.0)
    assert np.isfinite([found.first_interval, found.total_interval]).all()


def test_an_output_that_varies_only_between_both_halves_has_no_indices() -> None:
    """Constant in the first two sets of inputs, of which the variance is, and not in the mixed ones."""
    calls = []

    def function(inputs: Array) -> Array:
        calls.append(inputs)
        return np.full((1, inputs.shape[1]), 1.0) if len(calls) <= 2 else inputs[:1]

    assert sobol_indices(function, 2, 16, 3) == ["it varies in too few of the samples"]


def cliff(share: float) -> Callable[[Array], Array]:
    """A step of the first input, of which a small slope of the second makes a continuous margin."""
    return lambda inputs: np.where(inputs[0] > 1.0 - share, -1.0, 0.5) + 0.01 * inputs[1]


def corner(share: float) -> Callable[[Array], Array]:
    """One where both inputs are large, else zero."""
    return lambda inputs: np.where((inputs > 1.0 - math.sqrt(share)).all(axis=0), 1.0, 0.0)


def log_normal(variance: float) -> Callable[[Array], Array]:
    """Of two inputs, of which the first has four fifths of the variance of the logarithm."""
    return lambda inputs: np.exp(
        math.sqrt(variance) * (math.sqrt(0.8) * ndtri(inputs[0]) + 0.2**0.5 * ndtri(inputs[1]))
    )


def in_cube(inputs: Array) -> Array:
    """Return inputs without the ends, of which a normal distribution makes infinite numbers."""
    return np.clip(inputs, 2.0**-53, 1.0 - 2.0**-53)


@pytest.mark.parametrize(
    ("function", "samples"),
    [
        (cliff(0.02), 256),  # an index of 100 % has the interval 101 % to 103 %
        (corner(0.01), 256),  # 9 % has the interval -4 % to 2 %, or none
        (log_normal(10.0), 256),
        (lambda inputs: 1.0 / (1e-9 + np.abs(inputs[0] - 0.5)) + inputs[1], 1024),  # no variance: an infinite one
        (lambda inputs: 1e200 / (1e-9 + np.abs(inputs[0] - 0.5)) + inputs[1], 256),  # whose squares overflow
    ],
)
def test_a_variance_that_few_runs_carry_has_no_indices(function: Callable[[Array], Array], samples: int) -> None:
    for seed in range(5):
        (found,) = sobol_indices(lambda inputs: function(in_cube(inputs))[None], 2, samples, seed)
        assert isinstance(found, str), seed
        assert re.match(rf"\d+ of {2 * samples} runs carry 90% of its variance, too few", found), found


def test_intervals_that_stay_have_the_closed_forms() -> None:
    """At 95 %; the additive one also with 16 samples, and what happens in a tenth of the runs with 256."""
    slopes = np.array([1.0, 0.5, 0.25, 0.1])
    additive = slopes**2 / (slopes**2).sum()
    all_of = math.exp(1.0) - 1.0
    lone = np.expm1([0.8, 0.2]) / all_of
    step, slope = 1.5**2 * 0.1 * 0.9, 0.01**2 / 12
    stepped = np.array([step, slope]) / (step + slope)
    cases: list[tuple[str, Callable[[Array], Array], Array, Array, int]] = [
        ("additive", lambda inputs: slopes @ ndtri(inputs), additive, additive, 256),
        ("few samples", lambda inputs: slopes @ ndtri(inputs), additive, additive, 16),
        ("product", lambda inputs: np.prod(inputs - 0.5, axis=0), np.zeros(2), np.ones(2), 256),
        ("log-normal", log_normal(1.0), lone, 1.0 - lone[::-1], 256),
        ("cliff", cliff(0.1), stepped, stepped, 256),
    ]
    for name, function, first, total, samples in cases:
        covered = []
        for seed in range(20):
            (found,) = sobol_indices(lambda inputs, of=function: of(in_cube(inputs))[None], len(first), samples, seed)  # type: ignore[misc]
            assert isinstance(found, Indices), (name, seed, found)
            for ends, exact in ((found.first_interval, first), (found.total_interval, total)):
                covered.append((ends[:, 0] <= exact + 1e-9) & (exact - 1e-9 <= ends[:, 1]))
        share = float(np.mean(covered))
        print(f"{name}, {samples} samples, seeds 0 to 19: intervals have the index in {share:.1%}")
        assert share >= 0.9, name


def test_intervals_that_no_index_has_are_none() -> None:
    """With four samples of a sum: an interval beyond 0 to 100 %, none at all, and total indices of less than all."""
    slopes = np.array([1.0, 0.5, 0.25, 0.1])
    reasons = []
    for seed in range(40):
        (found,) = sobol_indices(lambda inputs: (slopes @ ndtri(in_cube(inputs)))[None], 4, 4, seed)
        if isinstance(found, str):
            reasons.append(found)
            continue
        for ends in (found.first_interval, found.total_interval):
            assert np.isfinite(ends).all()
            assert ((ends[:, 0] <= 1.05) & (ends[:, 1] >= -0.05)).all()
        assert found.first_interval[:, 0].sum() <= 1.05
        assert found.total_interval[:, 1].sum() >= 0.95
    print(reasons)
    for text in ("a bootstrap interval is ", "the indices do not add up to the variance"):
        assert any(reason.startswith(text) for reason in reasons), text
    (found,) = sobol_indices(lambda inputs: np.where(inputs[:1] > 0.6, 1.0, 0.0), 2, 4, 0)
    assert found == "some bootstrap interval is not finite; take more samples"


def test_a_quantity_without_indices_has_its_reason() -> None:
    short = hs.load_scenario("paper").updated({"simulation.duration": 0.05, "metrics.dwell": 0.01})
    require = ["outcome == completed", "settling_time <= 0.03", "peak_error <= 1e6"]
    file = {"scenario": short, "vary": {"uncertainty.gravity": {"normal": [0.0, 0.1]}}, "require": require, "runs": 1}
    found = hs.sensitivity(file, samples=4)
    sentences = found.section().sentences
    print(sentences)
    assert sentences[0] == "margin: no indices, since it is the same in all runs."
    assert sentences[1] == "settling_time: no indices, since it has no value in 12 of 12 runs."


def test_metrics_of_runs_that_ended_early_have_no_indices() -> None:
    """Runs with the short stroke end at once, with what they have reached by then; the margin orders these too."""
    short = hs.load_scenario("composite-30hz").updated(
        {"simulation.duration": 0.1, "metrics.dwell": 0.02, "robot.on_limit": "stop"}
    )
    vary = {"robot.stroke": {"choice": [1e-5, 0.5]}, "uncertainty.gravity": {"normal": [0.0, 0.1]}}
    require = ["outcome == completed", "overshoot <= 10"]
    found = hs.sensitivity({"scenario": short, "vary": vary, "require": require, "runs": 1}, samples=8)
    assert 0 < found.early < found.runs == 32
    assert list(found.indices) == ["margin"]
    ended = f"{found.early} of 32 runs ended early"
    assert found.without["peak_leg_force"] == ended
    assert found.without["peak_leg_speed"] == f"{ended} and it has no value in {32 - found.early} others"
    sentences = found.section().sentences
    assert f"overshoot: no indices, since {ended}." in sentences
    assert f"{ended}: the margin alone compares them with the others, and no metric has indices." in sentences


def test_no_estimate_of_a_campaign_where_noise_decides() -> None:
    """Nothing but the noise of the camera varies; about one run in 1e5 fails."""
    scenario = FILE["scenario"].updated({"camera.noise": 1.0})
    file = FILE | {"scenario": scenario, "vary": {"seed": "each"}, "require": ["peak_leg_excursion <= 0.0062"]}
    estimate = hs.estimate_rare_failures(file, samples=100, seed=1)
    sentences = estimate.section().sentences
    print(sentences)
    assert estimate.repetitions[-1].noise_decides
    assert math.isnan(estimate.probability)
    assert sentences[0].startswith("There is no estimate: noise decides which runs have a margin below ")
    assert "a campaign needs none of this" in sentences[1]
    assert as_data(estimate.section().data)["probability"] is None


def test_without_noise_none_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """No mass error that is drawn fails, so that all chains end where the margin is smallest."""
    monkeypatch.setattr(Judge, "smallest_margins", lambda judge, numbers: 1.0 - 5.0 * numbers["uncertainty.gravity"])
    file = {"scenario": "paper", "vary": {"uncertainty.gravity": {"uniform": [0.0, 0.1]}}, "runs": 1}
    for seed in range(10):
        estimate = hs.estimate_rare_failures(file | {"require": ["outcome == completed"]}, samples=100, seed=seed)
        assert not any(each.noise_decides for each in estimate.repetitions)
        assert estimate.probability == 0.0
        assert estimate.section().sentences[0] == "No level reached a failure: the smallest margin is 0.5."


def test_estimates_with_one_noise_say_so() -> None:
    file = FILE | {"vary": {"uncertainty.gravity": {"normal": [0.0, 0.03]}}}
    rare = hs.estimate_rare_failures(file, samples=100).section().sentences[-1]
    indices = hs.sensitivity(file, samples=4).section().sentences[-1]
    for said, holds in ((rare, "this holds"), (indices, "the indices hold")):
        assert said.startswith(f"All runs have the same noise (seed 0): {holds} for that noise alone; ")


def test_estimates_of_a_campaign() -> None:
    """The estimate of a probability that plain runs measure too, and the inputs that decide it."""
    plan = load_plan(FILE)
    drawing = plan.drawing()
    batch = hs.simulate_batch(
        plan.scenario.updated(drawing.base), drawing.variations(drawing.numbers(0, 2000)), "metrics"
    )
    failures = int((batch.metrics["peak_leg_excursion"] > 0.0036).sum())
    estimate = hs.estimate_rare_failures(FILE, samples=500, seed=2)
    low, high = stats.binomtest(failures, 2000).proportion_ci(0.999)
    print(f"{failures} of 2000 runs fail; subset simulation, seed 2: {estimate.probability}")
    spread = 1 + 4 * estimate.variation
    assert low / spread < estimate.probability < high * spread
    assert "no bound" in estimate.section().sentences[1]
    found = hs.sensitivity(FILE, samples=32, seed=1)
    assert found.inputs == (
        "target.rotation[0]",
        "target.rotation[1]",
        "target.rotation[2]",
        "uncertainty.gravity",
        "seed",
    )
    assert found.runs == 32 * (5 + 2)
    assert found.ranking()[0][0].startswith("target.rotation")
    assert found.ranking("peak_leg_excursion")[0][0] == found.ranking()[0][0]
    (name, share), *_ = found.ranking()
    low, high = found.indices["margin"].total_interval[found.inputs.index(name)]
    interval = f"{share:.0%}, bootstrap interval at 95 %: {low:.0%} to {high:.0%}"
    assert found.section().sentences[0].startswith(f"margin: {name} has the largest total index ({interval})")
    for scale in (0.1, 10.0):  # of the estimates: above 1 or not
        scaled = {key: dataclasses.replace(each, total=scale * each.total) for key, each in found.indices.items()}
        last = dataclasses.replace(found, indices=scaled).section().sentences[-1]
        assert last.startswith("Estimates of indices may exceed 100 %") == (scale > 1)
    margin = found.indices["margin"]
    other = {**found.indices, "effort": dataclasses.replace(margin, total=10 * margin.total)}  # is not required
    assert dataclasses.replace(found, indices=other).section().sentences == found.section().sentences
    with pytest.raises(ValueError, match=r"quantity: expected one of margin, .*, got 'settling_time'"):
        found.ranking("settling_time")
