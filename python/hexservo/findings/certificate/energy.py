"""Energy balance of a run: the work of every term on the platform (docs/certificate/energy.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hexservo.findings.certificate.memory import forgotten, remembers
from hexservo.findings.certificate.replay import Plant, Replay, product
from hexservo.findings.certificate.stages import STAGE_WEIGHTS, Stages, doubled_stages_of, stages_of
from hexservo.findings.part import Part
from hexservo.scenario.arrays import Array
from hexservo.scenario.laws import laws_with
from hexservo.scenario.leg_units import stroke_length
from hexservo.scenario.wording import number

COARSE = 0.01  # share of the turnover: with a larger tolerance of the quadrature the step is too coarse
NEGLIGIBLE = 1e-3  # of the work of lifting the weight by the stroke
_ROUNDING = 1e-12  # of the turnover
_SAME = 1e-9  # of the largest twist, position or feature: what rebuilt samples may differ from those of the log by
_ZERO = 1e-12  # likewise: a component that is zero but for rounding
_LARGEST = 1e290  # of a turnover [J]: beyond it sums in smaller units overflow


@dataclass(frozen=True, eq=False, repr=False)
class EnergyLedger(Part):
    """Works of all terms over a run, and whether they explain its kinetic energy."""

    time: Array = field(repr=False)  # (n,) [s]
    energy: Array = field(repr=False)  # (n,) kinetic energy of the actual platform [J]
    works: Mapping[str, Array] = field(repr=False)  # term -> (n - 1,), work from each sample to the next [J]
    by_axis: Mapping[str, Array] = field(repr=False)  # term -> (6,), work of the whole run by twist component [J]
    residual: float  # change of the energy minus the sum of the works [J]
    tolerance: float  # largest residual that the quadrature may leave [J]
    turnover: float  # sum of the works' absolute values over terms and samples [J]
    # largest difference of a rebuilt twist from its sample beyond what a memory of the law explains, by the largest [1]
    mismatch: float
    # likewise of a rebuilt position, by the largest position or the stroke, and of a rebuilt quaternion [1]
    pose_mismatch: float
    # likewise of the image and the depths at a sample's pose, by the largest; 0 for a camera as_printed [1]
    image_mismatch: float
    negligible: float  # a tolerance below it is small, however little was turned over [J]
    tossed: int  # steps in which rounding decided a sign, differently in the run and in its repetition
    crossings: int  # steps in which a component of the twist changes its sign
    remarks: tuple[str, ...]

    @property
    def closes(self) -> bool:
        """Whether the works add up to the change of energy within the tolerance, and the tolerance is small."""
        return not self.faults

    @property
    def faults(self) -> tuple[str, ...]:
        """Return why the energy balance does not close; empty if it does."""
        found = []
        if not self.mismatch <= _SAME:
            found.append(
                f"the steps rebuilt from the samples miss the next sample by {self.mismatch:.2g} of the largest twist: "
                "the acting wrench was not that of the log and the law"
            )
        if not self.pose_mismatch <= _SAME:
            found.append(
                f"the steps rebuilt from the samples miss the next pose by {self.pose_mismatch:.2g} (of the largest "
                "position, or of a quaternion): the platform did not move with the twist of the log"
            )
        if not self.image_mismatch <= _SAME:
            found.append(
                f"the images at the poses of the log differ from its features or depths by {self.image_mismatch:.2g} "
                "of the largest: they are not of the same run"
            )
        if not abs(self.residual) <= self.tolerance:
            found.append(f"a residual of {abs(self.residual):.3g} J is beyond the tolerance of {self.tolerance:.3g} J")
        whole = max(self.turnover, float(self.energy.max()))  # a platform that coasts turns nothing over
        if not self.tolerance <= max(COARSE * whole, self.negligible):
            found.append(
                f"the tolerance itself is {number(100 * self.tolerance / whole, 2)} % of the energy turned over: the "
                "step is too coarse for a ledger"
            )
        return tuple(found)

    def work(self, term: str) -> float:
        """Return the work of a term over the whole run [J]."""
        return float(self.works[term].sum())


def energy_ledger(run: Replay, plant: Plant) -> EnergyLedger:
    """Compute the energy balance of a run.

    Raises
    ------
    ArithmeticError
        Where the motion of the base could not be measured, or works are too large for numbers.
    """
    terms = _Terms.of(run)
    errors = run.scenario.uncertainty
    plain = np.ndim(errors.inertia) == 0 and np.ndim(errors.coriolis) == 0  # then gyroscopic terms do no work
    count = len(run.time)
    inertia = plant.inertia(run.quaternion)
    energy = 0.5 * np.einsum("ni,nij,nj->n", run.twist, inertia, run.twist)
    works: dict[str, Array] = {}  # term -> (n - 1, 6)
    tolerance = mismatch = pose_mismatch = 0.0
    tossed = 0
    slack = forgotten(run)
    by_parts = np.ones(count - 1, dtype=bool)  # steps whose error the sum of its absolute parts bounds
    if run.continuous and _smooth(run):
        tolerance, paired = _doubled(run, plant, plain)
        by_parts[np.concatenate([paired, paired + 1])] = False
    for stages in stages_of(run):
        wrenches = terms.wrenches(stages, plant)
        rows = len(stages.tick)
        inertia_there = plant.inertia(stages.rows("quaternion"))
        turning = _turning(stages, plant, plain)
        if not plain:
            gyroscopic = -plant.coriolis(stages.rows("quaternion"), stages.rows("twist"), inertia_there)
            wrenches["coriolis"] = gyroscopic.reshape(rows, 4, 6)
        for term, wrench in wrenches.items():
            work = stages.step * np.einsum("s,nsj->nj", STAGE_WEIGHTS, wrench * stages.twist)
            if term == "coriolis":  # turning is of the rotation; shared evenly, since it belongs to no one component
                work[:, 3:] += stages.step * (turning @ STAGE_WEIGHTS)[:, None] / 3
            np.add.at(works.setdefault(term, np.zeros((count - 1, 6))), stages.tick, work)
        if by_parts[stages.tick].any():
            bound = _quadrature(stages, plant, inertia_there, turning)[1]
            tolerance += float(bound[by_parts[stages.tick]].sum())
        compared = _compare(run, stages, inertia, slack)
        mismatch, pose_mismatch = max(mismatch, compared.twist), max(pose_mismatch, compared.pose)
        tossed, tolerance = tossed + compared.tossed, tolerance + compared.doubt
    total = {term: work.sum(axis=1) for term, work in works.items()}
    turnover = float(sum(np.abs(work).sum() for work in total.values()))
    if not turnover + float(energy.max()) <= _LARGEST:
        raise ArithmeticError(f"the terms turn over more than {_LARGEST:.0e} J, too much to add up")
    change = float(energy[-1] - energy[0])
    return EnergyLedger(
        time=run.time,
        energy=energy,
        works=total,
        by_axis={term: work.sum(axis=0) for term, work in works.items()},
        residual=change - float(sum(work.sum() for work in total.values())),
        tolerance=tolerance + _ROUNDING * (turnover + float(energy.max())),
        turnover=turnover,
        mismatch=mismatch,
        pose_mismatch=pose_mismatch,
        image_mismatch=_image_mismatch(run),
        negligible=NEGLIGIBLE * float(np.linalg.norm(terms.gravity[:3])) * stroke_length(run.scenario.robot),
        tossed=tossed,
        crossings=int(np.count_nonzero((run.twist[1:] * run.twist[:-1] < 0).any(axis=1))),
        remarks=(*terms.remarks, run.remark),
    )


@dataclass(frozen=True, eq=False)
class _Terms:
    """Splits the acting wrench into the law's parts, as the core returns them, and the rest."""

    run: Replay
    gravity: Array  # (6,) G-bar [N; N m]
    law_is_known: bool
    remarks: tuple[str, ...]

    @classmethod
    def of(cls, run: Replay) -> _Terms:
        """Decide whether the law's parts are known."""
        scenario = run.scenario
        remarks: list[str] = []
        known = not run.own and (run.continuous or scenario.camera.convention == "eye_in_hand")
        if run.own:
            remarks.append("The controller is a custom function: its terms are not known, only the acting wrench.")
        elif not known:
            remarks.append(
                "A sampled camera as printed has no image between two ticks: the law is not split into terms."
            )
        rest = np.zeros((1, 6))
        gravity = run.probe.estimated_wrenches(np.array([[1.0, 0.0, 0.0, 0.0]]), rest, rest)[2]
        return cls(run, gravity, known, tuple(remarks))

    def wrenches(self, stages: Stages, plant: Plant) -> dict[str, Array]:
        """Return the wrench of every term in every stage, (m, 4, 6) [N; N m]; they sum to what acts."""
        found: dict[str, Array] = {}
        if not self.law_is_known:
            found["own" if self.run.own else "acting"] = stages.wrench - self.gravity
        else:
            found |= self._of_law(stages)
        found["gravity"] = np.broadcast_to(self.gravity - plant.weight, stages.wrench.shape)
        if stages.base is not None:
            found["base"] = stages.base
        return found

    def _of_law(self, stages: Stages) -> dict[str, Array]:
        run = self.run
        shape = stages.wrench.shape
        depth = run.probe.measured_depth(stages.rows("depth"))
        state = (stages.rows(name) for name in ("features", "position", "quaternion", "twist"))
        features, position, quaternion, twist = state
        # Inside a stage of the continuous loop, weights are the core's business: the fuzzy part there is the stage's.
        weights = None
        if run.weights is not None and not run.continuous:
            weights = np.repeat(run.weights[stages.tick], 4, axis=0)
        law = run.probe.law(features, depth, position, quaternion, twist, weights)
        found = {part: wrench.reshape(shape) for part, wrench in law.parts.items()}
        if "fuzzy" in found and run.weights is None:
            del found["fuzzy"]
        elif stages.fuzzy_output is not None and "fuzzy" in found:
            found["fuzzy"] = -stages.fuzzy_output
        if remembers(run):  # likewise the pose that was estimated there
            found["pose_spring"] = found["pose_spring"] + stages.wrench - law.wrench.reshape(shape)
        if not run.continuous:
            found["held"] = stages.wrench - law.wrench.reshape(shape)
        return found


def _quadrature(stages: Stages, plant: Plant, inertia: Array, turning: Array) -> tuple[Array, Array]:
    """Return the quadrature error of the energy in each step [J], and its bound (docs/certificate/energy.md).

    In one step from 0 to 1 with stages i, weights b_i, accelerations a_i and their mean a, and with D the actual
    inertia, M its mean over both ends and u the mean twist, the residual is exactly

        h sum b_i (M u - D_i chi-dot_i).(a_i - a)  +  a.h sum b_i (M u - D_i chi-dot_i)
        +  1/4 (chi-dot_0.dD chi-dot_0 + chi-dot_1.dD chi-dot_1) - h sum b_i (turning power)_i

    and the bound sums the absolute values of its parts.

    Parameters
    ----------
    inertia
        (4 m, 6, 6), actual, of the stages.
    turning
        (m, 4), power of the inertia's turning in the stages [W].
    """
    rows = len(stages.tick)
    first = plant.inertia(np.ascontiguousarray(stages.start_quaternion))
    last = plant.inertia(np.ascontiguousarray(stages.next_quaternion))
    mean_twist = (stages.start_twist + stages.next_twist) / 2
    gap = product((first + last) / 2, mean_twist)[:, None] - product(inertia, stages.rows("twist")).reshape(rows, 4, 6)
    mean = np.einsum("s,nsj->nj", STAGE_WEIGHTS, stages.acceleration)
    changing = gap * (stages.acceleration - mean[:, None])
    steady = (mean * np.einsum("s,nsj->nj", STAGE_WEIGHTS, gap)).sum(axis=1)
    turned = 0.25 * sum(
        np.einsum("ni,nij,nj->n", twist, last - first, twist) for twist in (stages.start_twist, stages.next_twist)
    ) - stages.step * (turning @ STAGE_WEIGHTS)
    missed = stages.step * (changing.sum(axis=2) @ STAGE_WEIGHTS + steady) + turned
    bound = stages.step * (np.abs(changing).sum(axis=2) @ STAGE_WEIGHTS + np.abs(steady)) + np.abs(turned)
    return np.asarray(missed), np.asarray(bound)


def _doubled(run: Replay, plant: Plant, plain: bool) -> tuple[float, NDArray[np.intp]]:
    """Bound the quadrature error of a smooth run by that in steps twice as long [J].

    That is sixteen times as much where the step is short enough for the method's order to show. In every pair of steps
    the bound of `_quadrature` holds as well.

    Returns
    -------
    tuple
        The bound, and the first samples of the pairs that it is of. Without a bound are a last step that has no
        partner, and steps of a run that diverges which leave the finite numbers when they are twice as long.
    """
    tolerance = 0.0
    paired = [np.zeros(0, dtype=np.intp)]
    for whole in doubled_stages_of(run):
        stages = whole.finite()
        with np.errstate(over="ignore", invalid="ignore"):  # which the numbers of the parts may do too
            inertia = plant.inertia(stages.rows("quaternion"))
            missed, bound = _quadrature(stages, plant, inertia, _turning(stages, plant, plain))
            error = np.minimum(np.abs(missed), bound)
        tolerance += float(error[np.isfinite(error)].sum())
        paired.append(stages.tick[np.isfinite(error)])
    return tolerance, np.concatenate(paired)


def _turning(stages: Stages, plant: Plant, plain: bool) -> Array:
    """Power due to the rotation of the inertia in the stages, (m, 4) [W]; zero if the errors are single numbers."""
    if plain:
        return np.zeros(stages.twist.shape[:2])
    power = plant.turning_power(*(stages.rows(name) for name in ("position", "quaternion", "twist")))
    return power.reshape(stages.twist.shape[:2])


@dataclass(frozen=True)
class _Compared:
    """Steps rebuilt to their ends, beside the samples there."""

    twist: float = 0.0  # largest difference that neither a tossed sign nor a memory explains, by the largest twist [1]
    pose: float = 0.0  # likewise of position and quaternion, see `EnergyLedger.pose_mismatch`
    tossed: int = 0  # steps in which rounding decided a sign
    doubt: float = 0.0  # energy of those, and of what a memory explains [J]


def _compare(run: Replay, stages: Stages, inertia: Array, slack: Array) -> _Compared:
    """Compare steps rebuilt to their ends with the samples there.

    With `sign`, rounding decides the sign of a component that is zero but for rounding, and the core's variants may
    decide otherwise. Such steps are counted, with what they make of the energy.

    Parameters
    ----------
    inertia
        (n, 6, 6), of the samples.
    slack
        (n - 1, 6), by which the wrench of each step may differ, `forgotten` [N; N m].
    """
    if not stages.to_sample:
        return _Compared()
    largest = max(float(np.abs(run.twist).max()), np.finfo(float).tiny)
    ends = stages.tick + 1
    change = stages.step * product(np.abs(np.linalg.inv(inertia[stages.tick])), slack[stages.tick])  # of a twist
    difference = _beyond(np.abs(stages.next_twist - run.twist[ends]), change).max(axis=1) / largest
    wrong = difference > _SAME
    if run.continuous and run.scenario.controller.switching.kind == "sign":
        tossed = wrong & (np.abs(stages.twist) <= _ZERO * largest).any(axis=(1, 2))
    else:
        tossed = np.zeros_like(wrong)
    doubted = tossed | (~wrong & slack[stages.tick].any(axis=1))
    energies = (
        0.5 * np.einsum("ni,nij,nj->n", twist[doubted], inertia[ends[doubted]], twist[doubted])
        for twist in (stages.next_twist, run.twist[ends])
    )
    doubt = float(np.abs(next(energies) - next(energies)).sum())
    length = max(float(np.abs(run.position).max()), stroke_length(run.scenario.robot))  # [m]
    moved = stages.step * change
    shift = _beyond(np.abs(stages.next_position - run.position[ends]), moved[:, :3]).max(axis=1) / length
    turned = moved[:, 3:].max(axis=1, keepdims=True)
    turn = _beyond(np.abs(stages.next_quaternion - run.quaternion[ends]), turned).max(axis=1)
    return _Compared(
        twist=float(difference[~tossed].max(initial=0.0)),
        pose=float(np.maximum(shift, turn)[~tossed].max(initial=0.0)),
        tossed=int(np.count_nonzero(tossed)),
        doubt=doubt,
    )


def _beyond(difference: Array, explained: Array) -> Array:
    """Return what of a difference is beyond what explains it."""
    return np.asarray(np.maximum(difference - explained, 0.0))


def _image_mismatch(run: Replay) -> float:
    """Return by how much features and depths of the samples differ from those at their poses, by the largest [1]."""
    if run.scenario.camera.convention != "eye_in_hand":
        return 0.0
    found = run.probe.image(run.position, run.quaternion)
    pairs = zip(found, (run.features, run.depth), strict=True)
    return max(float(np.abs(seen - logged).max() / np.abs(logged).max()) for seen, logged in pairs)


def _smooth(run: Replay) -> bool:
    """Whether the law has no switching term, or a smooth one."""
    controller = run.scenario.controller
    return controller.law not in laws_with("switching") or controller.switching.kind == "tanh"
