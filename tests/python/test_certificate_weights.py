"""Best weights: cases solved by hand, Chebyshev approximation, optimality by duality and by the KKT conditions."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linprog, lsq_linear

import hexservo as hs
from hexservo.findings.certificate import weights as module
from hexservo.findings.certificate.replay import Plant, replay
from hexservo.findings.certificate.uncertainty import uncertainty_of
from hexservo.findings.certificate.weights import LIMIT, TIE, best_weights

Array = NDArray[np.float64]


def by_primal(basis: Array, target: Array, limit: float) -> float:
    """The smallest error by another form of the program, with all samples at once."""
    count = basis.shape[1]
    one = np.ones((len(target), 1))
    solution: Any = linprog(
        np.r_[np.zeros(count), 1.0],
        A_ub=np.vstack([np.hstack([basis, -one]), np.hstack([-basis, -one])]),
        b_ub=np.r_[target, -target],
        bounds=[(-limit, limit)] * count + [(0, None)],
        method="highs",
    )
    assert solution.status == 0
    return float(solution.fun)


def fuzzy_like(random: np.random.Generator, samples: int, terms: int = 3) -> Array:
    """Normalised products of two partitions of unity along smooth paths, as fuzzy bases are."""

    def shares() -> Array:
        way = np.cumsum(random.normal(size=samples)) / np.sqrt(samples)
        bells = 1.0 / (1.0 + ((way[:, None] - np.linspace(-1, 1, terms)) * terms / 2) ** 4)
        return np.asarray(bells / bells.sum(axis=1, keepdims=True))

    return (shares()[:, :, None] * shares()[:, None, :]).reshape(samples, -1)


# ---- By hand --------------------------------------------------------------------------------------------------------


def test_a_single_active_membership_takes_the_middle_of_the_targets() -> None:
    basis = np.zeros((50, 4))
    basis[:, 2] = 1.0
    target = np.linspace(-1.0, 3.0, 50)
    best = best_weights(basis, target)
    np.testing.assert_allclose(best.weights, [0, 0, 1.0, 0], atol=3 * TIE)
    assert best.error == pytest.approx(2.0, rel=2 * TIE)
    assert best.lower_bound == pytest.approx(2.0, rel=1e-9)
    assert not best.limited


def test_a_constant_target_is_matched_by_equal_weights() -> None:
    """The memberships sum to one; of all weights that give the constant on one row, the smallest are spread by it."""
    best = best_weights(np.full((20, 5), 0.2), np.full(20, -0.7))
    np.testing.assert_allclose(best.weights, np.full(5, -0.7), rtol=1e-8)
    assert best.error <= 1e-8
    uneven = best_weights(np.tile([0.5, 0.3, 0.2], (4, 1)), np.ones(4))
    np.testing.assert_allclose(uneven.weights, np.array([0.5, 0.3, 0.2]) / 0.38, rtol=1e-8)  # least norm: row/|row|^2


@pytest.mark.parametrize(
    ("degree", "power", "coefficients", "error"),
    [
        (1, 2, [0.5, 0.0], 0.5),  # x^2 - 1/2 = T_2/2
        (2, 3, [0.0, 0.75, 0.0], 0.25),  # x^3 - 3/4 x = T_3/4
        (3, 4, [-0.125, 0.0, 1.0, 0.0], 0.125),  # x^4 - x^2 + 1/8 = T_4/8
    ],
)
def test_chebyshev_approximation_of_a_power(degree: int, power: int, coefficients: list[float], error: float) -> None:
    """What is left of x^n is the Chebyshev polynomial T_n / 2^(n-1); its extrema are among the samples."""
    x = np.sort(np.r_[np.linspace(-1, 1, 301), np.cos(np.pi * np.arange(power + 1) / power)])
    best = best_weights(np.vander(x, degree + 1, increasing=True), x**power)
    np.testing.assert_allclose(best.weights, coefficients, atol=2e-3)  # flat: an error of 1e-6 moves them by its root
    assert best.error == pytest.approx(error, rel=3 * TIE)
    assert best.lower_bound == pytest.approx(error, rel=1e-6)


def test_ties_go_to_the_smallest_norm() -> None:
    x = np.linspace(0, 1, 30)
    twice = np.column_stack([x, x, 2 * x])  # w_1 + w_2 + 2 w_3 = 6: least norm (1, 1, 2)
    best = best_weights(twice, 6 * x)
    np.testing.assert_allclose(best.weights, [1.0, 1.0, 2.0], rtol=1e-7)


@pytest.mark.parametrize("scale", [1.0, 1e-300, 5e-324, 1e300])
def test_a_limit_far_beyond_the_target_is_none(scale: float) -> None:
    """The program is stated in units of the target, in which such a limit would not be finite."""
    random = np.random.default_rng(0)
    basis, target = random.uniform(size=(9, 3)), scale * random.choice([-1.0, 1.0], size=9)
    bounded, free = best_weights(basis, target, limit=1.7e308), best_weights(basis, target)
    assert (bounded.limit, bounded.limited) == (free.limit, free.limited)
    np.testing.assert_array_equal(bounded.weights, free.weights)


def test_the_limit_of_the_weights_is_kept_and_priced() -> None:
    best = best_weights(np.full((3, 1), 0.1), np.ones(3), limit=5.0)
    np.testing.assert_allclose(best.weights, [5.0], rtol=1e-5)
    assert np.abs(best.weights).max() <= 5.0 * (1 + 1e-8)
    assert best.error == pytest.approx(0.5, rel=3 * TIE)
    assert best.lower_bound == pytest.approx(0.5, rel=1e-9)
    assert best.limited
    small = best_weights(np.full((3, 1), 0.1), np.ones(3), limit=0.5)  # 0.95 of the error is left
    assert small.limited
    assert not best_weights(np.full((3, 1), 0.1), np.ones(3)).limited
    assert best_weights(np.eye(3), np.array([1.0, -2.0, 0.5])).limit == 2.0 * LIMIT


def test_nothing_to_approximate_needs_no_weights() -> None:
    best = best_weights(np.ones((5, 2)), np.zeros(5))
    assert best.error == best.lower_bound == 0.0
    np.testing.assert_array_equal(best.weights, [0.0, 0.0])


def test_a_basis_that_cannot_help_gets_no_weights() -> None:
    """A target that is as often up as down where the basis is the same: zero is as good as anything."""
    best = best_weights(np.ones((40, 3)) / 3, np.tile([1.0, -1.0], 20))
    np.testing.assert_allclose(best.weights, 0.0, atol=1e-12)
    assert best.error == pytest.approx(1.0)
    assert best.lower_bound == pytest.approx(1.0)


# ---- Optimality -----------------------------------------------------------------------------------------------------


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(2, 400))
def test_no_weights_do_better(seed: int, samples: int) -> None:
    """Against another form of the program, and by duality: the bound is below every error, and equal to the best."""
    random = np.random.default_rng(seed)
    basis, target = fuzzy_like(random, samples), random.normal(size=samples)
    best = best_weights(basis, target)
    scale = float(np.abs(target).max())
    error = by_primal(basis, target, LIMIT * scale)
    assert best.error == pytest.approx(float(np.abs(target - basis @ best.weights).max()), rel=1e-12)
    assert best.error <= error * (1 + 3 * TIE) + 1e-7 * scale
    assert best.lower_bound <= best.error * (1 + 1e-12)
    assert best.error - best.lower_bound <= 3 * TIE * best.error + 1e-7 * scale
    assert np.abs(best.weights).max() <= best.limit * (1 + 1e-8)


@settings(max_examples=40)
@given(st.integers(0, 10**6))
def test_the_norm_is_the_smallest(seed: int) -> None:
    """KKT of the least-distance program: the weights are a combination, with multipliers >= 0, of active rows."""
    random = np.random.default_rng(seed)
    samples = 200
    basis = fuzzy_like(random, samples)
    basis = np.hstack([basis, basis[:, :4] * random.uniform(0.2, 2.0, 4)])  # dependent columns: many ties
    target = np.sin(np.linspace(0, 5, samples)) * random.uniform(0.5, 2.0)
    best = best_weights(basis, target)
    rest = target - basis @ best.weights
    allowed = best.error  # what the second program was given is at most a rounding above
    active = np.abs(rest) >= allowed * (1 - 1e-6)
    normals = basis[active] * np.sign(rest[active])[:, None]  # target - basis w <= e: w can grow along +row
    boxed = np.abs(best.weights) >= best.limit * (1 - 1e-9)
    normals = np.vstack([normals, np.eye(basis.shape[1])[boxed] * -np.sign(best.weights[boxed])[:, None]])
    multipliers: Any = lsq_linear(normals.T, best.weights, bounds=(0, np.inf), method="bvls", tol=1e-14)
    assert np.linalg.norm(multipliers.fun) <= 1e-5 * np.linalg.norm(best.weights)


def test_a_subset_of_the_samples_gives_the_answer_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(5)
    basis = fuzzy_like(random, 3000, terms=5)
    target = np.cos(4 * basis[:, 0]) + 0.3 * np.sin(np.linspace(0, 40, 3000))
    some = best_weights(basis, target)
    monkeypatch.setattr(module, "_FIRST", 3000)
    whole = best_weights(basis, target)
    assert some.error == pytest.approx(whole.error, rel=2 * TIE)
    assert np.linalg.norm(some.weights) == pytest.approx(np.linalg.norm(whole.weights), rel=1e-4)


def test_the_answer_scales_with_the_target() -> None:
    random = np.random.default_rng(2)
    basis, target = fuzzy_like(random, 300), random.normal(size=300)
    one, small = best_weights(basis, target), best_weights(basis, 1e-6 * target)
    assert small.error == pytest.approx(1e-6 * one.error, rel=1e-9)
    np.testing.assert_allclose(small.weights, 1e-6 * one.weights, rtol=1e-6, atol=1e-12)


def test_without_the_second_program_the_error_is_the_same() -> None:
    random = np.random.default_rng(3)
    basis, target = fuzzy_like(random, 300), random.normal(size=300)
    smallest, any_best = best_weights(basis, target), best_weights(basis, target, smallest=False)
    assert any_best.error == pytest.approx(smallest.error, rel=3 * TIE)
    assert np.linalg.norm(smallest.weights) <= np.linalg.norm(any_best.weights) * (1 + 1e-9)


# ---- Refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("basis", "target", "limit", "words"),
    [
        (np.ones((3, 2)), np.ones(4), None, r"basis: expected \(n, p\)"),
        (np.ones(3), np.ones(3), None, r"basis: expected \(n, p\)"),
        (np.ones((0, 2)), np.ones(0), None, "n > 0"),
        (np.full((3, 2), np.nan), np.ones(3), None, "finite"),
        (np.ones((3, 2)), np.full(3, np.inf), None, "finite"),
        (np.ones((3, 2)), np.ones(3), 0.0, "limit: expected a number > 0, got 0.0"),
    ],
)
def test_bad_input_is_refused(basis: Array, target: Array, limit: float | None, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        best_weights(basis, target, limit)


# ---- Hard programs, and a solver that gives up -----------------------------------------------------------------------


def heavy_tag() -> Any:
    """A tag before a machine of 20 kg with 3 % of gravity error: all samples of a flat optimum bind in turn."""
    corners = {"size": 0.08, "pose": [0.0, 0.0, -0.559, 0.0, 0.0, 0.0]}
    return hs.Scenario.from_mapping(
        {
            "name": "heavy-tag",
            "robot": {"preset": "pi_h824"},
            "camera": {"focal_length": None, "pixel_scale": None, "focal_pixels": 1667.0},
            "target": {"tag": corners, "desired_pose": [0.004, -0.003, 0.002, -0.01, -0.015, 0.02]},
            "uncertainty": {"inertia": 0.075, "coriolis": 0.125, "gravity": 0.03, "depth": 0.2},
            "controller": {"law": "hybrid", "hybrid": {"auto": {"bandwidth": 2.0}}},
            "simulation": {"duration": 3.0},
        }
    )


def test_a_flat_optimum_is_found() -> None:
    """Along z few samples joined in a round, and the program was given up after 60 of them."""
    run = replay(hs.simulate(heavy_tag()))
    uncertainty = uncertainty_of(run, Plant.of(run))
    assert uncertainty.basis is not None
    basis, target = uncertainty.basis[:, 2], uncertainty.total[:, 2]
    best = best_weights(basis, target, smallest=False)
    assert best.solved
    assert best.error == pytest.approx(by_primal(basis, target, best.limit), rel=3 * TIE)


def giving_up(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """Let the solver fail after so many programs."""
    calls = itertools.count()
    failed = SimpleNamespace(status=4, message="numbers too hard")

    def solver(*args: Any, **options: Any) -> Any:
        return linprog(*args, **options) if next(calls) < after else failed

    monkeypatch.setattr("scipy.optimize.linprog", solver)


@pytest.mark.parametrize("smallest", [True, False])
def test_a_solver_that_gives_up_leaves_bounds_of_the_smallest_error(
    monkeypatch: pytest.MonkeyPatch, smallest: bool
) -> None:
    random = np.random.default_rng(5)
    basis = fuzzy_like(random, 3000, terms=5)
    target = np.cos(4 * basis[:, 0]) + 0.3 * np.sin(np.linspace(0, 40, 3000))
    exact = by_primal(basis, target, LIMIT * float(np.abs(target).max()))
    widths = []
    for after in range(8):  # 5 and 6 leave 5e-4 of the error open, 7 rounding
        giving_up(monkeypatch, after)
        best = best_weights(basis, target, smallest=smallest)
        monkeypatch.undo()
        assert best.error == pytest.approx(float(np.abs(target - basis @ best.weights).max()), rel=1e-12)
        assert best.lower_bound <= exact * (1 + 1e-9)
        assert best.error >= exact * (1 - 1e-9)
        widths.append(best.error - best.lower_bound)
        assert best.solved == (widths[-1] <= 1e-5 * best.error + 1e-7 * float(np.abs(target).max()))
    assert widths == sorted(widths, reverse=True)
    assert widths[0] == pytest.approx(float(np.abs(target).max()), rel=1e-5)  # nothing is known: no weights, no bound
    assert 0 < widths[1] < 0.9 * widths[0]
    assert best.solved
