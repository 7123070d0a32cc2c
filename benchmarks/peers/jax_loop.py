"""The closed loop in JAX: `lax.scan` for one run, `vmap` over it for batches; written from docs/model.md.

Double precision on the processor. Array expressions that XLA fuses (products and sums rather than small matrix
products), both inputs of the six fuzzy systems together, rank-one stages. Compilation is not part of any timing.

A batch is `vmap` over eight scenarios, `lax.map` over such packs, and one thread per processor: of the packs tried (8
to 512) the smallest is the fastest, since larger ones leave the cache and XLA then spends its time on sharing out work
that is too small. A layout with the scenario as last axis, written out in place of `vmap`, was within 20 % of it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from problem import CENTRES, PACK, Answer, Array, Problem

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")


def _times(matrix: Any, vectors: Any) -> Any:
    """Matrix (3, 3) times each of the vectors (n, 3)."""
    return (matrix * vectors[:, None, :]).sum(axis=2)


def _attitude(q: Any) -> Any:
    """R_BE of q/|q|, docs/model.md section 1."""
    w, x, y, z = q / jnp.sqrt((q * q).sum())
    return jnp.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _cross(a: Any, b: Any) -> Any:
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _see(p: Problem, position: Any, R: Any) -> tuple[Any, Any]:  # noqa: N803
    """Features (4, 2) [px] and depth (4,) [m]."""
    in_E = _times(R.T, p.points - position)  # noqa: N806
    return -p.focal * in_E[:, :2] / in_E[:, 2:], in_E[:, 2]


def _stage(p: Problem, depth_error: Any, body: tuple[Any, Any, Any], weights: Any, before: Any, scale: float) -> Any:
    """Rates at a state: of the body, memberships (2, 6, 7) of both inputs, strength (6,)."""
    position, q, twist = body
    R = _attitude(q)  # noqa: N806
    f = p.focal
    seen, depth = _see(p, position, R)
    inverse = 1.0 / (depth * (1.0 + depth_error))
    x, y = seen[:, 0], seen[:, 1]
    zero = jnp.zeros(4)
    # Minus (8), in E: (2, 4, 6)
    jacobian = jnp.stack(
        [
            jnp.stack([f * inverse, zero, x * inverse, -x * y / f, f + x * x / f, y], axis=1),
            jnp.stack([zero, f * inverse, y * inverse, -f - y * y / f, x * y / f, -x], axis=1),
        ]
    )
    twist_E = _times(R.T, twist.reshape(2, 3)).reshape(6)  # noqa: N806
    kp = p.kp.reshape(4, 2).T
    forces = jnp.stack([kp * (p.desired.reshape(4, 2) - seen).T, -kp * (jacobian * twist_E).sum(axis=2)])
    wrenches_E = (forces[:, :, :, None] * jacobian).sum(axis=(1, 2))  # noqa: N806
    wrenches = _times(R, wrenches_E.reshape(4, 3)).reshape(2, 6)

    inputs = jnp.clip(wrenches * np.stack([p.error_scale, p.rate_scale]), -1.0, 1.0)
    distance = (inputs[:, :, None] - CENTRES) / p.bell_width
    squared = distance * distance
    bells = 1.0 / (1.0 + squared * squared)
    bells = bells / bells.sum(axis=2, keepdims=True)
    output = (weights * bells[0][:, :, None] * bells[1][:, None, :]).sum(axis=(1, 2))
    if before is not None:
        overlap = (bells * before[1]).sum(axis=2)
        output = output + scale * before[2] * overlap[0] * overlap[1]
    switched = jnp.sign(twist) if p.switching == "sign" else jnp.tanh(twist / p.switching_width)
    gravity = np.array([0.0, 0.0, p.gravity_wrench_z, 0.0, 0.0, 0.0])
    wrench = wrenches[0] - p.kv * switched + gravity - output

    # (3): the angular part in E, where the inertia is diagonal
    omega, omega_E = twist[3:], twist_E[3:]  # noqa: N806
    moment_E = _times(R.T, wrench[None, 3:])[0]  # noqa: N806
    gyroscopic = _cross(omega_E, p.inertia * omega_E)
    turn_E = (moment_E - (1.0 - p.coriolis_error) * gyroscopic) / (p.inertia * (1.0 - p.inertia_error))  # noqa: N806
    linear = (wrench[:3] - (1.0 - p.gravity_error) * gravity[:3]) / (p.mass * (1.0 - p.inertia_error))
    q_rate = 0.5 * jnp.concatenate([-(omega * q[1:]).sum()[None], q[0] * omega + _cross(omega, q[1:])])
    acceleration = jnp.concatenate([linear, _times(R, turn_E[None])[0]])
    return (twist[:3], q_rate, acceleration), bells, twist / p.adaptation


def _step(p: Problem, depth_error: Any, state: Any) -> Any:
    body, weights = state
    h = p.step

    def moved(scale: float, rate: Any) -> Any:
        return jax.tree.map(lambda value, slope: value + scale * slope, body, rate)

    k1 = _stage(p, depth_error, body, weights, None, 0.0)
    k2 = _stage(p, depth_error, moved(0.5 * h, k1[0]), weights, k1, 0.5 * h)
    k3 = _stage(p, depth_error, moved(0.5 * h, k2[0]), weights, k2, 0.5 * h)
    k4 = _stage(p, depth_error, moved(h, k3[0]), weights, k3, h)
    position, q, twist = jax.tree.map(
        lambda value, a, b, c, d: value + (h / 6) * (a + 2 * b + 2 * c + d), body, k1[0], k2[0], k3[0], k4[0]
    )
    for part, (_, bells, strength) in zip((h / 6, h / 3, h / 3, h / 6), (k1, k2, k3, k4), strict=True):
        weights = weights + (part * strength[:, None] * bells[0])[:, :, None] * bells[1][:, None, :]
    return (position, q / jnp.sqrt((q * q).sum()), twist), weights


def _simulation(p: Problem) -> Callable[[Any], Any]:
    """Give the function of the depth error that runs the problem: samples of features and position, last weights."""

    def simulate(depth_error: Any) -> Any:
        def steps(state: Any, _: None) -> Any:
            state = lax.fori_loop(0, p.stride, lambda _, s: _step(p, depth_error, s), state)
            position, q, _twist = state[0]
            return state, (p.desired - _see(p, position, _attitude(q))[0].reshape(8), position)

        start = ((jnp.array(p.home), jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.zeros(6)), jnp.zeros((6, 7, 7)))
        (_, weights), (errors, positions) = lax.scan(steps, start, None, length=p.samples)
        return errors, positions, weights

    return simulate


class JaxLoop:
    """The loop of one problem; compiled when it first runs."""

    def __init__(self, problem: Problem) -> None:
        self._p = problem
        self._simulate = jax.jit(_simulation(problem))

        def last_error(depth_error: Any) -> Any:
            return _simulation(problem)(depth_error)[0][-1]

        self._simulate_batch = jax.jit(lambda depth_errors: lax.map(last_error, depth_errors, batch_size=PACK))

    def run(self) -> Answer:
        """Integrate the problem once."""
        errors, positions, weights = jax.block_until_ready(self._simulate(self._p.depth_error))
        return Answer(np.asarray(errors), np.asarray(positions), np.asarray(weights))

    def run_batch(self, depth_errors: Array, threads: int) -> Array:
        """Integrate once per depth error; feature error at the end of each (n, 8) [px].

        Every thread takes the same number of scenarios, so that one compilation serves all.
        """
        if len(depth_errors) % (threads * PACK):
            raise ValueError(f"depth_errors: expected a multiple of {threads * PACK}, got {len(depth_errors)}")
        with ThreadPoolExecutor(threads) as pool:
            parts = pool.map(lambda part: np.asarray(self._simulate_batch(part)), np.split(depth_errors, threads))
            return np.concatenate(list(parts))
