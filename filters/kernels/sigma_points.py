"""Kernel of H by sigma points: the line through what the sensor would say at points drawn from P (`Unscented`).

The factor of the pose leads that of pose and landmark, so that all landmarks see the same few poses of the camera.
"""

from __future__ import annotations

import math

from filters.geometry.arrays import FloatArray
from filters.geometry.rotations import matrix_of, quaternion_of
from filters.geometry.vectors import multiply, put, transposed
from filters.kernels.blas import kernel
from filters.kernels.calls import Calls, call, unit
from filters.kernels.covariance import clear, orientation
from filters.kernels.linearisation import chain, clear_all, compare, see, sense, take_homogeneous
from filters.kernels.recipe import Plan
from filters.kernels.records import POINT, Scratch, Storage
from filters.motions.motion_model import POSE_SIZE

NEGLIGIBLE = 1e-13
"""Share of a variance below which what is left of it, given the numbers before, is rounding."""


@kernel
def root(C: FloatArray, L: FloatArray, first: int, last: int) -> None:
    """Rows first to last - 1 of the Cholesky factor of C; what is known from the numbers before has a zero column."""
    for i in range(first, last):
        for j in range(i + 1):
            total = C[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = math.sqrt(total) if total > NEGLIGIBLE * C[i, i] else 0.0
            else:
                L[i, j] = total / L[j, j] if L[j, j] > 0.0 else 0.0


@kernel
def _draw_poses(plan: Plan, x: FloatArray, s: Scratch) -> None:
    """The pose, and those a column of its factor away: positions, and R_cw below each other."""
    L, spread, R = s.root, plan.sigma_points[0], orientation(x)
    for i in range(2 * POSE_SIZE + 1):
        way = 0.0 if i == 0 else (spread if i % 2 else -spread)
        k = max(0, (i - 1) // 2)
        for a in range(3):
            s.sigma_positions[i, a] = x[a] + way * L[a, k]
        q = quaternion_of(way * L[3, k], way * L[4, k], way * L[5, k])
        put(s.sigma_rotations, 3 * i, 0, transposed(multiply(R, matrix_of(q[0], q[1], q[2], q[3]))), 1.0)


@kernel
def _draw(
    calls: Calls, plan: Plan, x: FloatArray, blocks: FloatArray, anchor: int, own: int, moves: bool, s: Scratch
) -> None:
    """The landmark at the sigma points, as the camera there sees it, and the numbers of the sensor."""
    width, values, spread = len(s.root), s.values_taken.shape[1], plan.sigma_points[0]
    count, first = 2 * width + 1, len(s.root) - plan.size
    for i in range(count):
        way, k = (0.0, 0) if i == 0 else (spread if i % 2 else -spread, (i - 1) // 2)
        for a in range(values):
            s.values_taken[i, a] = s.values_moved[i, a] = blocks[own, a]
        for a in range(plan.size):
            s.correction[i, a] = way * s.root[first + a, k]
            if not moves:
                s.values_moved[i, a] += s.correction[i, a]
    if moves:
        s.theta[0] = s.theta[1] = s.theta[2] = 0.0
        clear_all(s.by_correction, count)
        clear_all(s.by_theta, count)
        clear(s.values_moved[:count])
        arguments = plan.landmark, s.values_taken[:count], s.theta, s.correction[:count], s.values_moved[:count]
        call(calls.turn, (*arguments, s.by_correction[:count], s.by_theta[:count]))
    take_homogeneous(calls, plan, s, s.values_moved, count)
    for i in range(count):
        pose = i if i <= 2 * POSE_SIZE else 0
        way, k = (0.0, 0) if i == 0 else (spread if i % 2 else -spread, (i - 1) // 2)
        p, position = s.points[i], s.sigma_positions[pose]
        if plan.changes and anchor < 0:  # it has become a point of W
            p[0], p[1], p[2], p[3] = s.values_moved[i, 0], s.values_moved[i, 1], s.values_moved[i, 2], 1.0
        for a in range(3):
            place = 0.0 if anchor < 0 else blocks[anchor, a] + way * s.root[POSE_SIZE + a, k]
            p[a] += p[3] * (place - position[a])
        h0, h1, h2 = p[0], p[1], p[2]
        for a in range(3):
            r = s.sigma_rotations[3 * pose + a]
            p[a] = r[0] * h0 + r[1] * h1 + r[2] * h2
    sense(calls, plan, s, s.points, count)


@kernel
def _fit(plan: Plan, T: FloatArray, s: Scratch, m: int, size: int) -> None:
    """Innovation, H and what is added to R: the regression of the numbers on the sigma points."""
    spread, weight, width, L = plan.sigma_points[0], plan.sigma_points[3], len(s.root), s.root
    mean_0, covariance_0 = plan.sigma_points[1], plan.sigma_points[2]
    z, along, H = s.sigma_z, s.sigma_along, s.H[m]
    for k in range(size):
        mean = 0.0
        for i in range(2 * width + 1):
            z[i, k] = 0.0
            for q in range(s.numbers.shape[1]):
                z[i, k] += T[k, q] * s.numbers[i, q]
            mean += z[i, k] * (weight if i > 0 else mean_0)
        s.nu[m, k] = s.z[m, k] - mean
        for i in range(2 * width + 1):
            z[i, k] -= mean
        for j in range(width):
            along[k, j] = spread * weight * (z[2 * j + 1, k] - z[2 * j + 2, k])
        for j in range(width - 1, -1, -1):
            value = along[k, j]
            for i in range(j + 1, width):
                value -= H[k, i] * L[i, j]
            H[k, j] = value / L[j, j] if L[j, j] > 0.0 else 0.0
        for c in range(k + 1):
            residual = covariance_0 * z[0, k] * z[0, c]
            for i in range(1, 2 * width + 1):
                residual += weight * z[i, k] * z[i, c]
            for j in range(width):
                residual -= along[k, j] * along[c, j]
            s.R[m, k, c] += residual - s.added[m, k, c]
            s.R[m, c, k], s.added[m, k, c] = s.R[m, k, c], residual


@unit("linearise")
def fit(
    calls: Calls,
    plan: Plan,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    x: FloatArray,
    blocks: FloatArray,
    s: Scratch,
    count: int,
) -> None:
    """Innovation, H and R of a stage by sigma points; of the last one, (u, v, d), by Jacobians as `linearise`.

    `points_c` and `numbers` are afterwards those of the last landmark drawn, not of the selection.
    """
    T, size, P, width = plan.T[variant, stage], plan.rows[variant, stage, 0], S.P[b], len(s.root)
    if stage == plan.T.shape[1] - 1:
        see(calls, plan, x, blocks, S, b, s, count)
        compare(T, s, count, size)
        chain(plan, T, x, blocks, S, b, s, count, size)
        return
    rows, C = s.gate_rows, s.gate_P
    for i in range(POSE_SIZE):
        rows[i] = i
        for j in range(i + 1):
            C[i, j] = P[j, i]
    root(C, s.root, 0, POSE_SIZE)
    _draw_poses(plan, x, s)
    for i in range(count):
        m = s.select[i]
        anchor, own = S.anchor[b, s.land[m]], S.own[b, s.land[m]]
        s.base[m, 0] = plan.leading + plan.size * (anchor if anchor >= 0 else own)
        s.base[m, 1] = plan.leading + plan.size * own
        for a in range(3 * plan.anchors):
            rows[POSE_SIZE + a] = s.base[m, 0] + a
        for a in range(plan.size):
            rows[width - plan.size + a] = s.base[m, 1] + a
        for p in range(POSE_SIZE, width):
            for q in range(p + 1):
                C[p, q] = P[min(rows[p], rows[q]), max(rows[p], rows[q])]
        root(C, s.root, POSE_SIZE, width)
        _draw(calls, plan, x, blocks, anchor, own, not plan.additive and S.kind[b, own] != POINT, s)
        s.ahead[m] = s.in_front[0]
        _fit(plan, T, s, m, size)
