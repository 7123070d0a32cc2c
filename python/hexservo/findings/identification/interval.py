"""Numbers with confidence intervals, from least squares whose residuals may be correlated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from hexservo.scenario.arrays import Array

LEVEL = 0.95
"""Confidence of all intervals."""
NORMAL = 1.4826
"""Standard deviation over the median of the magnitudes, of Gaussian noise about zero."""

_WIDEST = 100.0  # ratio of the ends of an interval, beyond which the log does not determine a positive number
_ZERO = 1e-13  # of eigenvalues of a matrix whose diagonal is 1
_LAGS = 200  # samples over which residuals may be correlated


@dataclass(frozen=True)
class Interval:
    """A number, and the interval that contains it with 95 % confidence if the model holds.

    An end is infinite where nothing bounds it: where the value lies at the edge of what was tried, the true one may be
    beyond; where the log does not determine it, both ends are.
    """

    value: float
    low: float
    high: float

    @property
    def is_bounded(self) -> bool:
        """Whether both ends are known."""
        return bool(np.isfinite(self.low) and np.isfinite(self.high))

    @classmethod
    def around(cls, value: float, sigma: float) -> Interval:
        """Return the interval of a normal estimate with this standard deviation."""
        return cls(float(value), float(value - half_width(sigma)), float(value + half_width(sigma)))

    @classmethod
    def of_logarithm(cls, value: float, sigma: float) -> Interval:
        """Return the interval of a positive number whose logarithm has this standard deviation."""
        factor = float(np.exp(min(half_width(sigma), _WIDEST)))
        return cls(value, value / factor, value * factor).determined()

    def determined(self) -> Interval:
        """Return the same of a positive number, open at both ends where the log does not determine it."""
        low = self.low if np.isfinite(self.low) else self.value
        high = self.high if np.isfinite(self.high) else self.value
        return self if high <= _WIDEST * low else Interval(self.value, -np.inf, np.inf)

    def opened(self, lowest: float, highest: float) -> Interval:
        """Return the interval of a value that was searched from `lowest` to `highest`: open where it reaches an end."""
        return Interval(
            self.value,
            -np.inf if self.value <= lowest else self.low,
            np.inf if self.value >= highest else self.high,
        )

    def times(self, factor: float) -> Interval:
        """Return the same in other units."""
        return Interval(factor * self.value, factor * self.low, factor * self.high)


def half_width(sigma: float) -> float:
    """Return half the width of the interval of a normal estimate."""
    return float(norm.ppf(0.5 + LEVEL / 2) * sigma)


def correlated(left: Array) -> float:
    """Return over how many samples residuals are correlated: 1 plus twice the sum of the first positive correlations.

    A correlation that white noise would have in one sample of 20 ends the sum.
    """
    centred = left - left.mean()
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, min(_LAGS, len(left) // 4)):
        share = float(centred[lag:] @ centred[:-lag]) / power
        if share < 2.0 / np.sqrt(len(left)):
            break
        total += 2.0 * share
    return total


def deviations(jacobian: Array, left: Array, independent: float) -> Array:
    """Return the standard deviations of least-squares estimates, (f,); infinite where the residuals do not tell.

    Parameters
    ----------
    jacobian
        (n, f) of the residuals.
    left
        (n,) residuals.
    independent
        How many of them are independent.
    """
    variance = float(left @ left) / max(independent * (1.0 - jacobian.shape[1] / len(left)), 1.0)
    scale, values, vectors = _normal(jacobian)
    shares = np.where(vectors**2 > _ZERO, vectors**2, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.where(shares > 0.0, shares / np.where(values > _ZERO, values, 0.0), 0.0)
    return np.asarray(np.sqrt(variance * parts.sum(axis=1)) / scale)


def robust_deviations(jacobian: Array, left: Array, samples: int, correlated: float) -> Array:
    """Return the same for residuals of any variance, (f,): those of a sample may depend on each other.

    The sandwich A^-1 (sum_i J_i^T e_i e_i^T J_i) A^-1 with A = J^T J, where e_i are the residuals that sample i has if
    it is not fitted, (I - J_i A^-1 J_i^T)^-1 times its own: the jackknife, which does not promise too much where few
    samples determine a number.

    Parameters
    ----------
    jacobian
        (n, f) of the residuals, sample by sample.
    left
        (n,) residuals.
    samples
        How many samples they are of, each with n/samples residuals.
    correlated
        Over how many samples residuals are correlated, 1 or more.
    """
    scale, values, vectors = _normal(jacobian)
    known = values > _ZERO
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    parts, rest = (jacobian / scale).reshape(samples, -1, jacobian.shape[1]), left.reshape(samples, -1)
    kept, turns = np.linalg.eigh(np.eye(rest.shape[1]) - parts @ inverse @ parts.transpose(0, 2, 1))
    along = np.einsum("ijk,ij->ik", turns, rest)
    alone = np.einsum("ijk,ik->ij", turns, np.where(kept > _ZERO, along / np.maximum(kept, _ZERO), 0.0))
    scores = np.einsum("ijf,ij->if", parts, alone) @ inverse
    open_to_any = (vectors[:, ~known] ** 2 > _ZERO).any(axis=1)
    return np.where(open_to_any, np.inf, np.sqrt(correlated * (scores * scores).sum(axis=0)) / scale)


def _normal(jacobian: Array) -> tuple[Array, Array, Array]:
    """Return the lengths of the columns, and eigenvalues and eigenvectors of J^T J with columns of length 1."""
    scale = np.sqrt((jacobian * jacobian).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh((jacobian / scale).T @ (jacobian / scale))
    return scale, values, vectors
