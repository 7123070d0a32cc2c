"""The pose that weighted least squares take from one image, and what noise of the image makes of it."""

from __future__ import annotations

import numpy as np

from hexservo.scenario.arrays import Array

_LEAST_ROOT = 1e-9  # of the largest root weight: the estimate hardly differs from the limit of smaller ones


def estimate_of_image(jacobian: Array, weights: Array, prior: Array | None = None) -> Array:
    """Return (J^T W J + M)^-1 J^T W, (6, 2p) [m/px; rad/px]: what a law takes a change of the image for.

    Parameters
    ----------
    jacobian
        J, (2p, 6).
    weights
        Diagonal of W, (2p,).
    prior
        Diagonal of M, (6,); None: zero.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where the matrix has no inverse.
    """
    weighted = jacobian.T * weights
    information = weighted @ jacobian
    if prior is not None:
        information = information + np.diag(prior)
    return np.asarray(np.linalg.solve(information, weighted), dtype=float)


def rows_of_estimate(jacobian: Array, weights: Array) -> Array:
    """Return rows G (..., k, 6) of which plain least squares has the noise of the weighted one of J (..., 2p, 6).

    (G^T G)^-1 is the covariance (J^T W J)^-1 J^T W^2 J (J^T W J)^-1 of `estimate_of_image` for independent noise of
    1 px in each coordinate; a common factor of all weights does not matter. Where all weights that are not zero are
    equal, G is their part of J. No inverse is formed, so that G may be as close to singular as J.

    Parameters
    ----------
    jacobian
        J, or more of them.
    weights
        Diagonal of W, (2p,), with six or more that are not zero.
    """
    counted = weights > 0.0
    rows, root = jacobian[..., counted, :], np.sqrt(weights[counted])
    if np.ptp(root) == 0.0:
        return np.asarray(rows)
    root = np.maximum(root / root.max(), _LEAST_ROOT)[:, None]
    # W^1/2 J = U S V^T: the estimate is V S^-1 U^T W^1/2, its covariance V S^-1 (U^T W U) S^-1 V^T
    left, values, right = np.linalg.svd(root * rows, full_matrices=False)
    scatter = np.linalg.qr(root * left, mode="r")  # its square is U^T W U
    return np.asarray(np.linalg.solve(np.swapaxes(scatter, -1, -2), values[..., None] * right))
