"""The closed loop in NumPy and, with its integrator, in SciPy; written from docs/model.md.

The form that is fastest in NumPy for a single run: what concerns few numbers (attitude, cross products) in Python's own
floats, where a NumPy call costs more than the arithmetic; image, bells and the six fuzzy systems as arrays, both inputs
of all systems in one call; rank-one stages, so that 294 weights are touched twice a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from problem import CENTRES, Answer, Array, Problem


@dataclass(frozen=True)
class _Stage:
    """Everything that follows from a state."""

    body_rate: Array  # (13,)
    memberships: Array  # (2, 6, 7): normalised bells of u and of u-dot
    strength: Array  # (6,) chi-dot/Psi


def _rotation_rows(w: float, x: float, y: float, z: float) -> list[list[float]]:
    """R_BE of q/|q|, docs/model.md section 1."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return [
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ]


class NumpyLoop:
    """The loop of one problem."""

    def __init__(self, problem: Problem) -> None:
        p = self._p = problem
        self._desired = p.desired.reshape(4, 2)
        self._kp = p.kp.reshape(4, 2)
        # Bells of both inputs in one array: (x - c)/w = x/w - c/w, with 1/w and the fuzzy scales multiplied together.
        self._scales = np.stack([p.error_scale, p.rate_scale])
        self._centres = CENTRES / p.bell_width
        self._inverse_adaptation = 1.0 / p.adaptation
        self._gravity = np.zeros(6)
        self._gravity[2] = p.gravity_wrench_z
        self._jacobian = np.zeros((4, 2, 6))

    def features(self, body: Array) -> Array:
        """Return the image features (8,) [px]."""
        R = np.array(_rotation_rows(*body[3:7].tolist()))  # noqa: N806
        in_E = (self._p.points - body[:3]) @ R  # noqa: N806
        seen: Array = -self._p.focal * in_E[:, :2] / in_E[:, 2:]
        return seen.ravel()

    def stage(self, body: Array, weights: Array, before: _Stage | None = None, scale: float = 0.0) -> _Stage:
        """Rates at a state; its weights are `weights` plus `scale` times the adaptation of the stage before."""
        p = self._p
        _, _, _, qw, qx, qy, qz, vx, vy, vz, wx, wy, wz = body.tolist()
        rows = _rotation_rows(qw, qx, qy, qz)
        R = np.array(rows)  # noqa: N806
        f = p.focal

        # (4), and the Jacobian of points fixed in B with the controller's depth estimates, minus (8), in E
        in_E = (p.points - body[:3]) @ R  # noqa: N806
        depth = in_E[:, 2:]
        seen = in_E[:, :2] * (-f / depth)
        inverse = 1.0 / (depth[:, 0] * (1.0 + p.depth_error))
        x, y = seen[:, 0], seen[:, 1]
        fi, xf, yf = f * inverse, x / f, y / f
        xy = x * yf
        J = self._jacobian  # noqa: N806
        J[:, 0, 0] = J[:, 1, 1] = fi
        J[:, 0, 2] = x * inverse
        J[:, 1, 2] = y * inverse
        J[:, 0, 3] = -xy
        J[:, 1, 4] = xy
        J[:, 0, 4] = f + x * xf
        J[:, 1, 3] = -f - y * yf
        J[:, 0, 5] = y
        J[:, 1, 5] = -x
        flat = J.reshape(8, 6)

        # g and g-dot together
        twist = body[7:]
        twist_E = (twist.reshape(2, 3) @ R).ravel()  # noqa: N806
        forces = np.empty((2, 8))
        forces[0] = ((self._desired - seen) * self._kp).ravel()
        forces[1] = (flat @ twist_E) * -p.kp
        wrenches = ((forces @ flat).reshape(4, 3) @ R.T).reshape(2, 6)

        # Bells of slope 2, both inputs of the six systems
        inputs = np.minimum(np.maximum(wrenches * self._scales, -1.0), 1.0)
        inputs /= p.bell_width
        bells = inputs[:, :, None] - self._centres
        bells *= bells
        bells *= bells
        bells += 1.0
        np.reciprocal(bells, out=bells)
        bells /= bells.sum(axis=2, keepdims=True)
        m, n = bells

        output = (np.matmul(weights, n[:, :, None])[:, :, 0] * m).sum(axis=1)
        if before is not None:
            overlap = (bells * before.memberships).sum(axis=2)
            output += scale * before.strength * overlap[0] * overlap[1]
        switched = np.sign(twist) if p.switching == "sign" else np.tanh(twist / p.switching_width)
        fx, fy, fz, mx, my, mz = (wrenches[0] - p.kv * switched + self._gravity - output).tolist()

        # (3): the angular part in E, where the inertia is diagonal
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rows
        a, b, c = twist_E[3:].tolist()
        i1, i2, i3 = p.inertia.tolist()
        keep = 1.0 - p.coriolis_error
        ax = (r00 * mx + r10 * my + r20 * mz - keep * (b * i3 * c - c * i2 * b)) / (i1 * (1.0 - p.inertia_error))
        ay = (r01 * mx + r11 * my + r21 * mz - keep * (c * i1 * a - a * i3 * c)) / (i2 * (1.0 - p.inertia_error))
        az = (r02 * mx + r12 * my + r22 * mz - keep * (a * i2 * b - b * i1 * a)) / (i3 * (1.0 - p.inertia_error))
        push = 1.0 / (p.mass * (1.0 - p.inertia_error))
        weight = (1.0 - p.gravity_error) * p.gravity_wrench_z
        rate = np.array(
            [
                vx,
                vy,
                vz,
                -0.5 * (wx * qx + wy * qy + wz * qz),
                0.5 * (qw * wx + wy * qz - wz * qy),
                0.5 * (qw * wy + wz * qx - wx * qz),
                0.5 * (qw * wz + wx * qy - wy * qx),
                fx * push,
                fy * push,
                (fz - weight) * push,
                r00 * ax + r01 * ay + r02 * az,
                r10 * ax + r11 * ay + r12 * az,
                r20 * ax + r21 * ay + r22 * az,
            ]
        )
        return _Stage(rate, bells, twist * self._inverse_adaptation)

    def run(self) -> Answer:
        """Integrate with RK4 and rank-one stages."""
        p = self._p
        h = p.step
        body = np.concatenate([p.home, [1.0], np.zeros(9)])
        weights = np.zeros((6, 7, 7))
        thirds = np.array([h / 6, h / 3, h / 3, h / 6])[:, None]
        errors, positions = np.empty((p.samples, 8)), np.empty((p.samples, 3))
        for sample in range(p.samples):
            for _ in range(p.stride):
                k1 = self.stage(body, weights)
                k2 = self.stage(body + (0.5 * h) * k1.body_rate, weights, k1, 0.5 * h)
                k3 = self.stage(body + (0.5 * h) * k2.body_rate, weights, k2, 0.5 * h)
                k4 = self.stage(body + h * k3.body_rate, weights, k3, h)
                body = body + (h / 6) * (k1.body_rate + k4.body_rate) + (h / 3) * (k2.body_rate + k3.body_rate)
                qw, qx, qy, qz = body[3:7].tolist()
                body[3:7] /= math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
                m, n = np.array([k1.memberships, k2.memberships, k3.memberships, k4.memberships]).transpose(1, 2, 3, 0)
                strength = np.array([k1.strength, k2.strength, k3.strength, k4.strength]) * thirds
                weights += np.matmul(m * strength.T[:, None, :], n.transpose(0, 2, 1))
            errors[sample] = p.desired - self.features(body)
            positions[sample] = body[:3]
        return Answer(errors, positions, weights)


class ScipyLoop:
    """The same right-hand side under `scipy.integrate.solve_ivp`.

    A general integrator has no rank-one stages: it carries all 13 + 294 numbers. Its steps follow from a tolerance, so
    it needs a smooth right-hand side (`tanh`).
    """

    def __init__(self, problem: Problem, method: str, tolerance: float) -> None:
        if problem.switching != "tanh":
            raise ValueError(f"controller.switching.kind: expected 'tanh', got {problem.switching!r}")
        self._p = problem
        self._loop = NumpyLoop(problem)
        self.method = method
        self.tolerance = tolerance
        self.evaluations = 0  # of the right-hand side in the last run

    def _rate(self, _time: float, state: Array) -> Array:
        stage = self._loop.stage(state[:13], state[13:].reshape(6, 7, 7))
        m, n = stage.memberships
        rate = np.empty(307)
        rate[:13] = stage.body_rate
        rate[13:] = ((m * stage.strength[:, None])[:, :, None] * n[:, None, :]).ravel()
        return rate

    def run(self) -> Answer:
        """Integrate once, to the tolerance."""
        from scipy.integrate import solve_ivp

        p = self._p
        start = np.zeros(307)
        start[:3] = p.home
        start[3] = 1.0
        times = np.arange(1, p.samples + 1) * (p.stride * p.step)
        solution = solve_ivp(
            self._rate,
            (0.0, times[-1]),
            start,
            method=self.method,
            t_eval=times,
            rtol=self.tolerance,
            atol=self.tolerance * 1e-2,
        )
        if not solution.success:
            raise RuntimeError(f"solve_ivp ({self.method}): {solution.message}")
        self.evaluations = int(solution.nfev)
        states = solution.y.T
        errors = np.array([p.desired - self._loop.features(state[:13]) for state in states])
        return Answer(errors, states[:, :3].copy(), states[-1, 13:].reshape(6, 7, 7).copy())
