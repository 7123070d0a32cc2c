"""The closed loop compiled by numba; written from docs/model.md.

The form that is fastest in numba of those tried: scalar code, compiled for this very processor with `fastmath`, over
arrays that are allocated once a run. The seven terms of a system are padded to eight, innermost, and summed in loops
that store nothing, or written out store by store: LLVM then uses vector registers, which possible overlaps of arrays
otherwise keep it from. Rank-one stages; bells of slope 2 by squaring. The six systems innermost, with one division in
place of seven, took twice as long. A batch runs scenario by scenario under `prange`.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from problem import Answer, Array, Problem

_PAD = 8  # seven terms and one that is always zero
_CENTRES = np.append((np.arange(7) - 3) / 3.0, 1e60)  # finite, as `fastmath` requires
_FLAGS = {"error_model": "numpy", "fastmath": True, "boundscheck": False}
_compiled = numba.njit(**_FLAGS)
_inlined = numba.njit(inline="always", **_FLAGS)


@_inlined
def _bells(x, inverse_width, mu):
    """Write the normalised memberships of x into `mu` (8); the eighth term is far away and stays zero."""
    total = 0.0
    for k in range(_PAD):
        q = (x - _CENTRES[k]) * inverse_width
        q = q * q
        bell = 1.0 / (1.0 + q * q)
        mu[k] = bell
        total += bell
    total = 1.0 / total
    for k in range(_PAD):
        mu[k] *= total


@_inlined
def _stage(numbers, points, desired, kp, kv, inertia, psi, a, b, smooth, body, W, scale, before, now, m, n, r, rate, s):
    """Rates of stage `now` at `body`; the weights are W plus `scale` times the adaptation of stage `before`."""
    focal, depth_error, mass_push, gravity_z, weight_z, delta_d, delta_c, width, switching_width = numbers
    qw, qx, qy, qz = body[3], body[4], body[5], body[6]
    vx, vy, vz, wx, wy, wz = body[7], body[8], body[9], body[10], body[11], body[12]
    two = 2.0 / (qw * qw + qx * qx + qy * qy + qz * qz)
    r00, r01, r02 = 1.0 - two * (qy * qy + qz * qz), two * (qx * qy - qw * qz), two * (qx * qz + qw * qy)
    r10, r11, r12 = two * (qx * qy + qw * qz), 1.0 - two * (qx * qx + qz * qz), two * (qy * qz - qw * qx)
    r20, r21, r22 = two * (qx * qz - qw * qy), two * (qy * qz + qw * qx), 1.0 - two * (qx * qx + qy * qy)

    # twist in E; g and g-dot point by point, with the Jacobian of points fixed in B: minus (8)
    ux, uy, uz = r00 * vx + r10 * vy + r20 * vz, r01 * vx + r11 * vy + r21 * vz, r02 * vx + r12 * vy + r22 * vz
    ex, ey, ez = r00 * wx + r10 * wy + r20 * wz, r01 * wx + r11 * wy + r21 * wz, r02 * wx + r12 * wy + r22 * wz
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    h0 = h1 = h2 = h3 = h4 = h5 = 0.0
    for i in range(4):
        dx, dy, dz = points[i, 0] - body[0], points[i, 1] - body[1], points[i, 2] - body[2]
        z = r02 * dx + r12 * dy + r22 * dz
        inverse = 1.0 / z
        x = -focal * (r00 * dx + r10 * dy + r20 * dz) * inverse
        y = -focal * (r01 * dx + r11 * dy + r21 * dz) * inverse
        inverse = inverse / (1.0 + depth_error)
        fi, xi, yi = focal * inverse, x * inverse, y * inverse
        xy, xx, yy = x * y / focal, focal + x * x / focal, focal + y * y / focal
        px = kp[2 * i] * (desired[2 * i] - x)
        py = kp[2 * i + 1] * (desired[2 * i + 1] - y)
        g0 += fi * px
        g1 += fi * py
        g2 += xi * px + yi * py
        g3 -= xy * px + yy * py
        g4 += xx * px + xy * py
        g5 += y * px - x * py
        px = -kp[2 * i] * (fi * ux + xi * uz - xy * ex + xx * ey + y * ez)
        py = -kp[2 * i + 1] * (fi * uy + yi * uz - yy * ex + xy * ey - x * ez)
        h0 += fi * px
        h1 += fi * py
        h2 += xi * px + yi * py
        h3 -= xy * px + yy * py
        h4 += xx * px + xy * py
        h5 += y * px - x * py
    g, v, out = s[0], s[1], s[2]
    g[0], g[1], g[2] = r00 * g0 + r01 * g1 + r02 * g2, r10 * g0 + r11 * g1 + r12 * g2, r20 * g0 + r21 * g1 + r22 * g2
    g[3], g[4], g[5] = r00 * g3 + r01 * g4 + r02 * g5, r10 * g3 + r11 * g4 + r12 * g5, r20 * g3 + r21 * g4 + r22 * g5
    v[0], v[1], v[2] = r00 * h0 + r01 * h1 + r02 * h2, r10 * h0 + r11 * h1 + r12 * h2, r20 * h0 + r21 * h1 + r22 * h2
    v[3], v[4], v[5] = r00 * h3 + r01 * h4 + r02 * h5, r10 * h3 + r11 * h4 + r12 * h5, r20 * h3 + r21 * h4 + r22 * h5

    for j in range(6):
        _bells(min(max(a[j] * g[j], -1.0), 1.0), width, m[now, j])
        _bells(min(max(b[j] * v[j], -1.0), 1.0), width, n[now, j])
        m0, m1, m2, m3 = m[now, j, 0], m[now, j, 1], m[now, j, 2], m[now, j, 3]
        m4, m5, m6 = m[now, j, 4], m[now, j, 5], m[now, j, 6]
        total = 0.0
        for c in range(_PAD):
            column = m0 * W[j, 0, c] + m1 * W[j, 1, c] + m2 * W[j, 2, c] + m3 * W[j, 3, c]
            column += m4 * W[j, 4, c] + m5 * W[j, 5, c] + m6 * W[j, 6, c]
            total += column * n[now, j, c]
        if before >= 0:
            p = q = 0.0
            for c in range(_PAD):
                p += m[now, j, c] * m[before, j, c]
                q += n[now, j, c] * n[before, j, c]
            total += scale * r[before, j] * p * q
        out[j] = total

    for j in range(6):
        t = body[7 + j]
        r[now, j] = t / psi[j]
        if smooth:
            t = math.tanh(t / switching_width)
        elif t != 0.0:
            t = math.copysign(1.0, t)
        g[j] = g[j] - kv[j] * t - out[j]
    g[2] += gravity_z

    # (3): the angular part in E, where the inertia is diagonal
    ia, ib, ic = inertia[0], inertia[1], inertia[2]
    keep = 1.0 - delta_c
    tx = (r00 * g[3] + r10 * g[4] + r20 * g[5] - keep * (ic - ib) * ey * ez) / (ia * (1.0 - delta_d))
    ty = (r01 * g[3] + r11 * g[4] + r21 * g[5] - keep * (ia - ic) * ez * ex) / (ib * (1.0 - delta_d))
    tz = (r02 * g[3] + r12 * g[4] + r22 * g[5] - keep * (ib - ia) * ex * ey) / (ic * (1.0 - delta_d))
    k = rate[now]
    k[0], k[1], k[2] = vx, vy, vz
    k[3] = -0.5 * (wx * qx + wy * qy + wz * qz)
    k[4] = 0.5 * (qw * wx + wy * qz - wz * qy)
    k[5] = 0.5 * (qw * wy + wz * qx - wx * qz)
    k[6] = 0.5 * (qw * wz + wx * qy - wy * qx)
    k[7], k[8], k[9] = g[0] * mass_push, g[1] * mass_push, (g[2] - weight_z) * mass_push
    k[10] = r00 * tx + r01 * ty + r02 * tz
    k[11] = r10 * tx + r11 * ty + r12 * tz
    k[12] = r20 * tx + r21 * ty + r22 * tz


@_compiled
def _features(body, points, focal, out):
    qw, qx, qy, qz = body[3], body[4], body[5], body[6]
    for i in range(4):
        dx, dy, dz = points[i, 0] - body[0], points[i, 1] - body[1], points[i, 2] - body[2]
        x = (1.0 - 2.0 * (qy * qy + qz * qz)) * dx + 2.0 * (qx * qy + qw * qz) * dy + 2.0 * (qx * qz - qw * qy) * dz
        y = 2.0 * (qx * qy - qw * qz) * dx + (1.0 - 2.0 * (qx * qx + qz * qz)) * dy + 2.0 * (qy * qz + qw * qx) * dz
        z = 2.0 * (qx * qz + qw * qy) * dx + 2.0 * (qy * qz - qw * qx) * dy + (1.0 - 2.0 * (qx * qx + qy * qy)) * dz
        out[2 * i] = -focal * x / z
        out[2 * i + 1] = -focal * y / z


@_compiled
def _integrate(numbers, h, stride, home, points, desired, kp, kv, inertia, psi, a, b, smooth, errors, positions):
    """Run one scenario; the samples go to `errors` and `positions`, the weights (7, 7, 8) are returned."""
    W = np.zeros((6, 7, _PAD))
    m, n, r = np.zeros((4, 6, _PAD)), np.zeros((4, 6, _PAD)), np.zeros((4, 6))
    rate, s = np.zeros((4, 13)), np.zeros((3, 6))
    body, stage_body, seen = np.zeros(13), np.zeros(13), np.zeros(8)
    body[:3] = home
    body[3] = 1.0
    for sample in range(errors.shape[0]):
        for _ in range(stride):
            for now in range(4):
                scale = 0.0 if now == 0 else (h if now == 3 else 0.5 * h)
                for i in range(13):
                    stage_body[i] = body[i] + (scale * rate[now - 1, i] if now > 0 else 0.0)
                _stage(numbers, points, desired, kp, kv, inertia, psi, a, b, smooth, stage_body, W, scale, now - 1, now,
                       m, n, r, rate, s)  # fmt: skip
            for i in range(13):
                body[i] += h / 6.0 * (rate[0, i] + 2.0 * rate[1, i] + 2.0 * rate[2, i] + rate[3, i])
            norm = math.sqrt(body[3] * body[3] + body[4] * body[4] + body[5] * body[5] + body[6] * body[6])
            for i in range(3, 7):
                body[i] /= norm
            for j in range(6):
                for k in range(7):
                    l0, l1 = h / 6.0 * r[0, j] * m[0, j, k], h / 3.0 * r[1, j] * m[1, j, k]
                    l2, l3 = h / 3.0 * r[2, j] * m[2, j, k], h / 6.0 * r[3, j] * m[3, j, k]
                    w0 = l0 * n[0, j, 0] + l1 * n[1, j, 0] + l2 * n[2, j, 0] + l3 * n[3, j, 0]
                    w1 = l0 * n[0, j, 1] + l1 * n[1, j, 1] + l2 * n[2, j, 1] + l3 * n[3, j, 1]
                    w2 = l0 * n[0, j, 2] + l1 * n[1, j, 2] + l2 * n[2, j, 2] + l3 * n[3, j, 2]
                    w3 = l0 * n[0, j, 3] + l1 * n[1, j, 3] + l2 * n[2, j, 3] + l3 * n[3, j, 3]
                    w4 = l0 * n[0, j, 4] + l1 * n[1, j, 4] + l2 * n[2, j, 4] + l3 * n[3, j, 4]
                    w5 = l0 * n[0, j, 5] + l1 * n[1, j, 5] + l2 * n[2, j, 5] + l3 * n[3, j, 5]
                    w6 = l0 * n[0, j, 6] + l1 * n[1, j, 6] + l2 * n[2, j, 6] + l3 * n[3, j, 6]
                    w7 = l0 * n[0, j, 7] + l1 * n[1, j, 7] + l2 * n[2, j, 7] + l3 * n[3, j, 7]
                    row = W[j, k]
                    w0, w1, w2, w3 = w0 + row[0], w1 + row[1], w2 + row[2], w3 + row[3]
                    w4, w5, w6, w7 = w4 + row[4], w5 + row[5], w6 + row[6], w7 + row[7]
                    row[0], row[1], row[2], row[3] = w0, w1, w2, w3
                    row[4], row[5], row[6], row[7] = w4, w5, w6, w7
        _features(body, points, numbers[0], seen)
        for i in range(8):
            errors[sample, i] = desired[i] - seen[i]
        for i in range(3):
            positions[sample, i] = body[i]
    return W


@numba.njit(parallel=True, **_FLAGS)
def _integrate_batch(
    numbers, depth_errors, h, stride, home, points, desired, kp, kv, inertia, psi, a, b, smooth, errors, positions
):
    for i in numba.prange(depth_errors.shape[0]):
        focal, _, push, gravity_z, weight_z, delta_d, delta_c, width, switching_width = numbers
        own = (focal, depth_errors[i], push, gravity_z, weight_z, delta_d, delta_c, width, switching_width)
        _integrate(own, h, stride, home, points, desired, kp, kv, inertia, psi, a, b, smooth, errors[i], positions[i])


class NumbaLoop:
    """The loop of one problem; compiled when it first runs."""

    def __init__(self, problem: Problem) -> None:
        p = self._p = problem
        push = 1.0 / (p.mass * (1.0 - p.inertia_error))
        weight_z = (1.0 - p.gravity_error) * p.gravity_wrench_z
        self._numbers = (
            p.focal, p.depth_error, push, p.gravity_wrench_z, weight_z, p.inertia_error, p.coriolis_error,
            1.0 / p.bell_width, p.switching_width,
        )  # fmt: skip
        self._rest = (
            p.step, p.stride, p.home, p.points, p.desired, p.kp, p.kv, p.inertia, p.adaptation,
            p.error_scale, p.rate_scale, p.switching == "tanh",
        )  # fmt: skip

    def run(self) -> Answer:
        """Integrate the problem once."""
        errors, positions = np.empty((self._p.samples, 8)), np.empty((self._p.samples, 3))
        weights = _integrate(self._numbers, *self._rest, errors, positions)
        return Answer(errors, positions, weights[:, :, :7].copy())

    def run_batch(self, depth_errors: Array, threads: int) -> Array:
        """Integrate once per depth error; feature error at the end of each (n, 8) [px]."""
        numba.set_num_threads(threads)
        count = len(depth_errors)
        errors, positions = np.empty((count, self._p.samples, 8)), np.empty((count, self._p.samples, 3))
        _integrate_batch(self._numbers, depth_errors, *self._rest, errors, positions)
        return errors[:, -1].copy()
