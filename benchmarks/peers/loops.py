"""Comparisons of the whole closed loop: one run, and batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Protocol

import numpy as np

import hexservo as hs
from problem import PACK, Array, ClosedLoopPeer, Problem, loop_scenario, problem_of
from rows import Row, WrongAnswerError, attempt, largest_difference, require, version_of
from timing import Block, alternate, core_count, python_block

STRIDE = 50  # steps between two samples
BATCH = 64  # scenarios, or as many as every thread gets a pack of
SMOOTH_TOLERANCE = 1e-9  # [px]
# Runs that differ in rounding only part where the velocity chatters about zero, by what runs of other steps differ.
SIGN_TOLERANCE = 0.02  # [px]
PIP = "make bench-peers installs it (pip install --group peers)"


class BatchPeer(ClosedLoopPeer, Protocol):
    """A peer that also runs batches."""

    def run_batch(self, depth_errors: Array, threads: int) -> Array:
        """Feature error at the end for each depth error (n, 8) [px]."""
        ...


def _numpy(problem: Problem) -> ClosedLoopPeer:
    from numpy_loop import NumpyLoop

    return NumpyLoop(problem)


def _numba(problem: Problem) -> BatchPeer:
    from numba_loop import NumbaLoop

    return NumbaLoop(problem)


def _jax(problem: Problem) -> BatchPeer:
    from jax_loop import JaxLoop

    return JaxLoop(problem)


def _difference(peer: ClosedLoopPeer, scenario: hs.Scenario) -> float:
    return largest_difference(peer.run().feature_error, hs.simulate(scenario).feature_error[1:])


def _check(row: Row, make: Callable[[Problem], ClosedLoopPeer]) -> None:
    """Compare a peer with the core on the smooth loop, where only roundings may differ."""
    smooth = loop_scenario("tanh", 1.0, STRIDE)
    require(row, _difference(make(problem_of(smooth)), smooth), SMOOTH_TOLERANCE, "px (tanh, 1 s)")


def single_run(make: Callable[[Problem], ClosedLoopPeer], row: Row, duration: float, rounds: int) -> None:
    """Fill in a row that compares one run of `paper`."""
    _check(row, make)
    scenario = loop_scenario("sign", duration, STRIDE)
    peer = make(problem_of(scenario))
    require(row, _difference(peer, scenario), SIGN_TOLERANCE, f"px (sign, {duration:g} s)")
    steps = problem_of(scenario).steps
    row.comparison = alternate(
        python_block(peer.run, steps, 0.05),
        python_block(lambda: hs.simulate(scenario), steps, 0.05),
        rounds,
    )


def numpy_row(duration: float, rounds: int) -> Row:
    """Compare with NumPy: all that the quick run does."""
    row = Row(
        "closed loop, one run", "step", "NumPy", "rank-one stages, six systems as arrays", "hs.simulate, one thread"
    )
    row.version = version_of("numpy")
    return attempt(row, partial(single_run, _numpy, duration=duration, rounds=rounds), PIP)


def _compiled_row(package: str, make: Callable[[Problem], ClosedLoopPeer], form: str, rounds: int) -> Row:
    def fill(row: Row) -> None:
        single_run(make, row, 5.0, rounds)
        row.version = version_of(package)

    return attempt(Row("closed loop, one run", "step", package, form, "hs.simulate, one thread"), fill, PIP)


def _scipy(row: Row, rounds: int) -> None:
    """Take the cheapest method and tolerance whose answer is as near to the exact one as the core's at 1 ms."""
    from numpy_loop import ScipyLoop

    scenario = loop_scenario("tanh", 1.0, STRIDE)
    problem = problem_of(scenario)
    fine = scenario.updated({"simulation.step": problem.step / 20, "simulation.log_every": 20 * STRIDE})
    exact = hs.simulate(fine).feature_error[1:]
    own = largest_difference(hs.simulate(scenario).feature_error[1:], exact)
    found: list[tuple[int, float, ScipyLoop]] = []
    for method in ("RK45", "DOP853", "LSODA"):
        for tolerance in 10.0 ** -np.arange(4.0, 10.0):
            peer = ScipyLoop(problem, method, tolerance)
            error = largest_difference(peer.run().feature_error, exact)
            if error <= own:
                found.append((peer.evaluations, error, peer))
                break
    if not found:
        raise RuntimeError(f"no method and tolerance came within {own:.2g} px of the exact answer")
    evaluations, error, peer = min(found, key=lambda candidate: candidate[0])
    row.version = version_of("scipy")
    row.form = f"solve_ivp {peer.method}, rtol {peer.tolerance:.0e}, {evaluations} evaluations for 1000 steps' time"
    require(row, error, own, "px from the exact answer (allowed: hexservo's own)")
    row.comparison = alternate(
        python_block(peer.run, problem.steps, 0.05),
        python_block(lambda: hs.simulate(scenario), problem.steps, 0.05),
        rounds,
    )


def single_rows(rounds: int) -> Iterator[Row]:
    """Compare one run with every peer."""
    yield numpy_row(5.0, rounds)
    yield attempt(
        Row("closed loop, one run, smooth (tanh)", "step", "SciPy", "solve_ivp", "hs.simulate, one thread"),
        partial(_scipy, rounds=rounds),
        PIP,
    )
    yield _compiled_row("numba", _numba, "njit, fastmath, rank-one stages", rounds)
    yield _compiled_row("jax", _jax, "lax.scan, float64, rank-one stages", rounds)


def _own_batch(
    scenario: hs.Scenario, depth_errors: Array, expected: Array, threads: int, units: int
) -> Callable[[], Block] | None:
    simulate_batch: Any = getattr(hs, "simulate_batch", None)
    if simulate_batch is None:
        return None

    def run() -> Any:
        return simulate_batch(scenario, {"uncertainty.depth": depth_errors}, log="metrics", threads=threads)

    final = np.asarray(run().metrics["final_error"])
    difference = largest_difference(final, np.abs(expected).max(axis=1))
    if not difference <= SIGN_TOLERANCE:
        raise WrongAnswerError(f"hs.simulate_batch differs by {difference:.2g} px from hs.simulate")
    return python_block(run, units, 0.1)


def _batch(package: str, make: Callable[[Problem], BatchPeer], row: Row, threads: int, count: int, rounds: int) -> None:
    _check(row, make)
    scenario = loop_scenario("sign", 5.0, STRIDE)
    problem = problem_of(scenario)
    peer = make(problem)
    row.version = version_of(package)
    depth_errors = np.linspace(-0.3, 0.3, count)
    expected = np.array(
        [hs.simulate(scenario.updated({"uncertainty.depth": float(d)})).feature_error[-1] for d in depth_errors]
    )
    answer = peer.run_batch(depth_errors, threads)
    require(row, largest_difference(answer, expected), SIGN_TOLERANCE, f"px (sign, end of all {count})")
    units = len(depth_errors) * problem.steps
    own = _own_batch(scenario, depth_errors, expected, threads, units)
    if own is None:
        row.hexservo = "not available: this version has no hs.simulate_batch"
    row.comparison = alternate(python_block(lambda: peer.run_batch(depth_errors, threads), units, 0.1), own, rounds)


def batch_rows(rounds: int) -> Iterator[Row]:
    """Compare batches of runs of `paper` that differ in the depth error: on one processor, and on all."""
    for threads in dict.fromkeys((1, core_count())):
        count = max(BATCH, PACK * threads) // (PACK * threads) * PACK * threads
        named = f"{threads} thread{'s'[: threads - 1]}"
        for package, make, form in (
            ("numba", _numba, f"prange over the single run, {named}"),
            ("jax", _jax, f"vmap in packs of {PACK}, {named}"),
        ):
            yield attempt(
                Row(
                    f"closed loop, batch of {count}, {named}",
                    "scenario-step",
                    package,
                    form,
                    f'hs.simulate_batch(log="metrics", threads={threads})',
                ),
                partial(_batch, package, make, threads=threads, count=count, rounds=rounds),
                PIP,
            )
