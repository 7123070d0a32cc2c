"""Overall uncertainty of a run, Delta-tau of (19), and its best approximation by the fuzzy systems."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hexservo.findings.certificate.replay import Plant, Replay, product
from hexservo.findings.certificate.weights import BestWeights, best_weights
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.parameters import gains_of

AXES = ("force x", "force y", "force z", "moment x", "moment y", "moment z")
UNITS = ("N", "N", "N", "N m", "N m", "N m")
_FEWEST = 2  # samples for each weight that acts (the rank of phi-bar), below which a fit is no evidence
_ROUNDING = 1e-12  # of the largest force or moment: gamma is a difference of such numbers


@dataclass(frozen=True, eq=False)
class DeltaTau:
    """Delta-tau at every sample, with its parts and the fuzzy basis there."""

    parts: Mapping[str, Array]  # inertia, Coriolis, gravity, depth error -> (n, 6) [N; N m]; they sum to `total`
    total: Array  # (n, 6), Delta-tau [N; N m]
    basis: Array | None  # (n, 6, 49), phi-bar; None without fuzzy systems
    adaptation: Array | None  # (n, 6), omega_j-dot = adaptation_j phi-bar_j, but for leakage and limit [N/s; N m/s]


def uncertainty_of(run: Replay, plant: Plant) -> DeltaTau:
    """Compute Delta-tau of a run of the law `hybrid` (docs/certificate/assumption.md)."""
    probe, settings = run.probe, run.settings
    gains = gains_of(settings)
    inertia = plant.inertia(run.quaternion)
    acceleration = probe.acceleration(run.position, run.quaternion, run.twist, run.wrench)
    inertial, coriolis, gravity = probe.estimated_wrenches(run.quaternion, run.twist, acceleration)
    believed = probe.measured_depth(run.depth)
    at = run.position
    jacobian_error = probe.image_jacobian(run.features, believed, run.quaternion, True, at) - probe.image_jacobian(
        run.features, run.depth, run.quaternion, False, at
    )
    parts = {
        "inertia": inertial - product(inertia, acceleration),
        "Coriolis": coriolis - plant.coriolis(run.quaternion, run.twist, inertia),
        "gravity": np.broadcast_to(gravity - plant.weight, run.twist.shape),
        "image Jacobian": np.einsum("nij,ni->nj", jacobian_error, gains.kp * run.feature_error),
    }
    # delta-tau by (3): what the estimated dynamics need for this motion and tau does not give. No delta enters.
    total = inertial + coriolis + gravity - run.wrench + parts["image Jacobian"]
    if run.weights is None:
        return DeltaTau(parts, total, None, None)
    law = probe.law(run.features, believed, run.position, run.quaternion, run.twist, run.weights)
    assert law.error_memberships is not None
    assert law.rate_memberships is not None
    basis = law.error_memberships[:, :, :, None] * law.rate_memberships[:, :, None, :]
    return DeltaTau(parts, total, basis.reshape(len(total), 6, -1), law.adaptation)


@dataclass(frozen=True, eq=False, repr=False)
class Assumption(Part):
    """Whether k_v,j >= eta_Delta,j held along a run, axis by axis."""

    kv: Array  # (6,) [N; N m]
    eta: Array  # (6,), eta_Delta: largest |gamma_j| with the best weights that were found [N; N m]
    lower_bound: Array  # (6,), no weights within the limit have a smaller one [N; N m]
    largest: Array  # (6,), largest |Delta-tau_j| [N; N m]
    instants: Array  # (6,), when |gamma_j| is largest [s]
    weights: tuple[BestWeights, ...] | None  # by axis; None without fuzzy systems
    gamma: Array = field(repr=False)  # (n, 6), Delta-tau - tau_f* [N; N m]
    time: Array = field(repr=False)  # (n,) [s]
    rounding: Array = field(repr=False)  # (6,), what rounding leaves of a gamma_j that is zero [N; N m]
    rank: NDArray[np.intp]  # (6,), of phi-bar over the samples: how many weights act independently; 0 without

    @property
    def margin(self) -> Array:
        """(6,), k_v - eta_Delta [N; N m]."""
        return self.kv - self.eta

    @property
    def held(self) -> Mask:
        """(6,), whether the axis kept the assumption, but for rounding; false also where that is not decided."""
        return self._fits & ~self.few_samples

    @property
    def _fits(self) -> Mask:
        return np.asarray(self.margin >= -self.rounding)

    @property
    def few_samples(self) -> Mask:
        """(6,), whether gamma_j is within k_v,j because few samples are fitted, which is no evidence.

        Of n samples, with fewer than two for each weight that acts, weights exist for most patterns of signs, whatever
        Delta-tau is (T. M. Cover, "Geometrical and statistical properties of systems of linear inequalities", 1965).
        Where Delta-tau itself is within k_v, no weights are needed.
        """
        fitted = self.largest > self.kv + self.rounding
        return np.asarray(self._fits & fitted & (len(self.time) < _FEWEST * self.rank))

    @property
    def decided(self) -> Mask:
        """(6,), whether it is known.

        False where the program was not solved and k_v is between bound and error, and where samples are too few.
        """
        if self.weights is None:
            return np.ones(6, dtype=bool)
        solved = np.array([best.solved for best in self.weights])
        known = solved | self._fits | (self.kv < self.lower_bound - self.rounding)
        return np.asarray(known & ~self.few_samples)

    @property
    def ideal(self) -> Array:
        """tau_f* = Delta-tau - gamma follows from it; the best weights, (6, 49) [N; N m]."""
        if self.weights is None:
            return np.zeros((6, 0))
        return np.stack([best.weights for best in self.weights])


def assumption_of(run: Replay, uncertainty: DeltaTau, *, smallest: bool = True) -> Assumption:
    """Find the best weights of every axis, and compare their approximation error with K_v.

    Parameters
    ----------
    smallest
        Whether ties between weights matter: without, the error is the same, to the part that counts as a tie.
    """
    gains = gains_of(run.settings)
    kv = gains.kv
    total = uncertainty.total
    largest = np.abs(total).max(axis=0)
    if uncertainty.basis is None:
        weights, gamma, lower, rank = None, total, largest, np.zeros(6, dtype=np.intp)
    else:
        limits = gains.fuzzy.weight_limit
        weights = tuple(
            best_weights(uncertainty.basis[:, j], total[:, j], float(limits[j]), smallest=smallest) for j in range(6)
        )
        output = np.stack([uncertainty.basis[:, j] @ weights[j].weights for j in range(6)], axis=1)
        gamma, lower = total - output, np.array([best.lower_bound for best in weights])
        rank = np.linalg.matrix_rank(uncertainty.basis.swapaxes(0, 1))
    return Assumption(
        kv=kv,
        eta=np.abs(gamma).max(axis=0),
        lower_bound=lower,
        largest=largest,
        instants=run.time[np.abs(gamma).argmax(axis=0)],
        weights=weights,
        gamma=gamma,
        rounding=_ROUNDING * np.repeat(np.abs(run.wrench).reshape(-1, 2, 3).max(axis=(0, 2)), 3),
        time=run.time,
        rank=rank,
    )
