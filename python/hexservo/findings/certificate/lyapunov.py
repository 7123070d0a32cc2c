"""The Lyapunov function (16) along a run of the law `hybrid`, and its rate two ways (docs/certificate/lyapunov.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hexservo.findings.certificate.replay import Replay, sgn_breaks
from hexservo.findings.certificate.uncertainty import Assumption, DeltaTau
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array, Mask
from hexservo.scenario.parameters import gains_of

# Central differences of a function at distances 1, 2, 3, by half width; errors of order 4 and 6.
_STENCILS = {2: (8 / 12, -1 / 12), 3: (45 / 60, -9 / 60, 1 / 60)}
_WIDEST = max(_STENCILS)
_AGREE = 0.5  # RMS of the difference of the two rates, by that of the rate: beyond it neither is known
_ABOVE = 0.01  # of the range of V: what it may be above its start by error alone


@dataclass(frozen=True, eq=False)
class Rise:
    """Consecutive samples at which V grows, and the term that contributes most."""

    first: float  # [s]
    last: float  # [s]
    samples: int
    rate: float  # largest V-dot [W]
    axis: int  # that adds most to it there, 0 to 5
    term: str  # of that axis, with the largest power: a part of Delta-tau, -tau_f*, or what the weights' options do
    power: float  # of that part [W]
    gamma: float  # approximation error of that axis there [N; N m]


@dataclass(frozen=True, eq=False, repr=False)
class Lyapunov(Part):
    """V and its terms at n samples, and V-dot from the samples and by (20)."""

    time: Array = field(repr=False)  # (n,) [s]
    kinetic: Array = field(repr=False)  # (n,) 1/2 chi-dot^T D-bar chi-dot [J]
    image: Array = field(repr=False)  # (n,) 1/2 xi~^T K_p xi~ [J]
    weight: Array = field(repr=False)  # (n,) 1/2 sum w~^T Psi w~ [J]
    change: Array = field(repr=False)  # (n,) V - V(0), to more digits than the sum of the three has [J]
    differentiated: Array = field(repr=False)  # (n,) V-dot by differences; NaN where there is none [W]
    predicted: Array = field(repr=False)  # (n,) V-dot by (20) [W]
    bound: Array = field(repr=False)  # (n,) of the error of V-dot; NaN where there is none [W]
    rises: tuple[Rise, ...]
    switched: int  # samples left out next to a step with a sign change of chi-dot_j, with `sign`
    limited: int  # samples left out next to a step at whose end the weights' limit acted
    change_in_switches: float  # of V, over all steps with a sign change [J]
    rise_in_a_switch: float  # largest of one such step; 0 where V falls in all of them [J]
    switching: str  # kind of the switching function

    @property
    def value(self) -> Array:
        """V, (n,) [J]."""
        return self.kinetic + self.image + self.weight

    @property
    def compared(self) -> int:
        """Samples at which the two rates were compared."""
        return int(np.count_nonzero(np.isfinite(self.differentiated)))

    @property
    def disagreement(self) -> Array:
        """(n,), difference of the two rates; NaN where there is none [W]."""
        return self.differentiated - self.predicted

    @property
    def agrees(self) -> bool:
        """Whether the two rates agree in RMS; otherwise the step is too coarse to locate the growth of V."""
        known = np.isfinite(self.differentiated)
        if not known.any():
            return False
        gap, rate = (float(np.sqrt(np.mean(values[known] ** 2))) for values in (self.disagreement, self.predicted))
        return gap <= _AGREE * rate + _rounding(self.change, float(self.time[1] - self.time[0]))

    @property
    def above_start(self) -> bool:
        """Whether V was above its start anywhere, steps that are left out included, by more than its error."""
        return float(self.change.max()) > _ABOVE * float(np.ptp(self.change))


def lyapunov_of(run: Replay, uncertainty: DeltaTau, assumption: Assumption) -> Lyapunov:
    """Follow V along a run of the law `hybrid` in continuous mode, with the best weights of `assumption`."""
    settings = run.settings
    gains = gains_of(settings)
    kinetic = 0.5 * np.einsum("ni,nij,nj->n", run.twist, run.probe.inertia(run.quaternion), run.twist)
    image = 0.5 * (run.feature_error**2) @ gains.kp
    sign = settings["controller.switching.kind"] == "sign"
    believed = run.probe.measured_depth(run.depth)
    state = (run.features, believed, run.position, run.quaternion, run.twist)
    switching = run.probe.law(*state).parts["switching"]
    # chi-dot^T gamma by axis: what neither K_v nor fuzzy systems answer.
    own = run.twist * (assumption.gamma + switching)
    options = np.zeros_like(own)
    weight = learned = np.zeros(len(run.time))
    breaks = sgn_breaks(run.twist) if sign else np.zeros(len(run.time) - 1, dtype=bool)
    cut = np.zeros_like(breaks)
    if run.weights is not None:
        assert uncertainty.basis is not None
        assert uncertainty.adaptation is not None
        fuzzy = gains.fuzzy
        weights = run.weights.reshape(len(run.time), 6, -1)
        ideal = assumption.ideal
        missing = ideal - weights  # w~
        weight = 0.5 * np.einsum("j,njk,njk->n", fuzzy.adaptation, missing, missing)
        # Without the constant part, which may be many orders of magnitude larger than what changes.
        learnt = weights - weights[0]
        learned = np.einsum("j,njk,njk->n", fuzzy.adaptation, 0.5 * learnt - missing[0], learnt)
        # w~.(chi-dot_j phi-bar - Psi w-dot): zero by (22), but for dead zone and leakage.
        taught = np.einsum("njk,njk->nj", missing, uncertainty.basis)
        forgotten = np.einsum("njk,njk->nj", missing, weights) * fuzzy.leakage
        options = taught * (run.twist - fuzzy.adaptation * uncertainty.adaptation) + fuzzy.adaptation * forgotten
        finite = np.isfinite(fuzzy.weight_limit)
        reached = np.abs(weights[:, finite]).max(axis=2, initial=0.0) >= fuzzy.weight_limit[finite] * (1 - 1e-12)
        cut = np.asarray(reached[1:].any(axis=1))
    change = (kinetic - kinetic[0]) + (image - image[0]) + learned
    predicted = (own + options).sum(axis=1)
    differentiated = differentiate(change, run.step, breaks | cut)
    bound = _error_bound(differentiated - predicted, change, run.step)
    parts = {f"{name} error": power for name, power in uncertainty.parts.items()}
    return Lyapunov(
        time=run.time,
        kinetic=kinetic,
        image=image,
        weight=weight,
        change=change,
        differentiated=differentiated,
        predicted=predicted,
        bound=bound,
        rises=_rises(
            run, predicted, bound, own, options, parts, assumption.gamma, uncertainty.total - assumption.gamma
        ),
        switched=_beside(breaks),
        limited=_beside(cut),
        change_in_switches=float(np.diff(change)[breaks].sum()),
        rise_in_a_switch=float(np.diff(change)[breaks].max(initial=0.0)),
        switching=settings["controller.switching.kind"],
    )


def differentiate(values: Array, step: float, breaks: Mask) -> Array:
    """Differentiate samples by central differences over up to seven of them, (n,).

    Parameters
    ----------
    values
        (n,), evenly spaced.
    step
        Between two samples.
    breaks
        (n - 1,), steps that no difference may reach over. Where fewer than two steps on either side are free of them,
        there is no derivative: NaN. With two the error is of fourth order in the step, with three of sixth.
    """
    count = len(values)
    found = np.full(count, np.nan)
    blocked = np.r_[True, np.asarray(breaks, dtype=bool), True]  # nothing before the first sample and after the last
    for half, weights in _STENCILS.items():  # the wider one overwrites the narrower one
        if count < 2 * half + 1:
            continue
        middle = np.arange(half, count - half)
        free = ~np.any([blocked[middle + offset] for offset in range(1 - half, half + 1)], axis=0)
        slope = np.zeros(len(middle))
        for distance, weight in enumerate(weights, start=1):
            slope += weight * (values[middle + distance] - values[middle - distance])
        found[middle[free]] = (slope / step)[free]
    return found


def _error_bound(disagreement: Array, change: Array, step: float) -> Array:
    """Return the largest disagreement within reach of the differences, and their rounding; NaN where there is none."""
    count = len(disagreement)
    known = np.abs(np.nan_to_num(disagreement, nan=0.0))
    padded = np.pad(known, _WIDEST)
    nearby = np.max([padded[offset : offset + count] for offset in range(2 * _WIDEST + 1)], axis=0)
    return np.where(np.isfinite(disagreement), nearby + _rounding(change, step), np.nan)


def _rounding(change: Array, step: float) -> float:
    """Return the rounding error of a difference of V [W]."""
    return 4 * np.finfo(float).eps * float(np.abs(change).max(initial=0.0)) / step


def _beside(breaks: Mask) -> int:
    """Count the samples at either end of a step that is left out."""
    return int(np.count_nonzero(np.r_[False, breaks] | np.r_[breaks, False]))


def _rises(
    run: Replay,
    predicted: Array,
    bound: Array,
    own: Array,
    options: Array,
    parts: Mapping[str, Array],
    gamma: Array,
    ideal: Array,
) -> tuple[Rise, ...]:
    """Find the intervals in which V grows by more than the error of its rate, each with the largest term."""
    with np.errstate(invalid="ignore"):
        growing = predicted > bound  # false where there is no bound
    edges = np.flatnonzero(np.diff(np.r_[False, growing, False].astype(np.int8)))
    rises = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        worst = int(first + np.argmax(predicted[first:end]))
        axis = int(np.argmax((own + options)[worst]))
        powers = {name: float(run.twist[worst, axis] * part[worst, axis]) for name, part in parts.items()}
        powers["best weights' output, -tau_f*"] = float(run.twist[worst, axis] * -ideal[worst, axis])
        powers["dead zone and leakage of the weights"] = float(options[worst, axis])
        term = max(powers, key=lambda name: powers[name])
        rises.append(
            Rise(
                first=float(run.time[first]),
                last=float(run.time[end - 1]),
                samples=int(end - first),
                rate=float(predicted[worst]),
                axis=axis,
                term=term,
                power=powers[term],
                gamma=float(gamma[worst, axis]),
            )
        )
    return tuple(rises)
