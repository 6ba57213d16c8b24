"""Entries for Python between frames: clones, landmarks that leave, corrections, steps of variables, and maps."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.vectors import cross_matrix, put, times, transposed
from filters.kernels.blas import PLAIN, entry
from filters.kernels.calls import (
    FLAGS,
    INDEX,
    MATRICES,
    MATRIX,
    call,
    read_calls,
    read_plan,
    read_scratch,
    read_storage,
)
from filters.kernels.correction import correct_rows
from filters.kernels.covariance import keep_considered, keep_definite, orientation, pose_variances, restore_considered
from filters.kernels.landmarks import clone_pose, close_gaps, marginalise
from filters.kernels.linearisation import expect
from filters.kernels.records import BLOCKS, LANDMARKS
from filters.kernels.retraction import SETTLED, correct_state
from filters.motions.motion_model import POSE_SIZE

CLONE, FORGET, CLOSE_GAPS = range(3)
"""Changes of the map."""


@entry(_nrt=False)
def change(plan_at: int, storage_at: int, scratch_at: int, b: int, what: int) -> None:
    """Clone the pose of filter b, or take the landmarks marked in `gone` or blocks without users out of its map."""
    plan, S, s = read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at)
    if what == CLONE:
        clone_pose(plan, S, b, s)
        return
    if what == FORGET:
        marginalise(S.ids[b], S.own[b], S.anchor[b], S.users[b], S.counts[b], s.gone, s.entered)
    close_gaps(plan, S, b)


@entry(_nrt=False)
def correct_by(
    calls_at: int,
    plan_at: int,
    storage_at: int,
    scratch_at: int,
    b: int,
    rows: IntArray,
    H: FloatArray,
    nu: FloatArray,
    R: FloatArray,
    limit: float,
) -> None:
    """Correct filter b with a measurement that is linear in the errors at these rows; `result` is NIS, and if used."""
    calls, plan, S, s = read_calls(calls_at), read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at)
    P, n = S.P[b], plan.leading + plan.size * S.counts[b, BLOCKS]
    before = pose_variances(P)
    keep_considered(P, plan.considered, s.kept)
    nis = correct_rows(calls, P, n, rows, H, nu, R, limit, s)
    used = 0.0 <= nis <= limit
    if used:
        restore_considered(P, plan.considered, s.kept, s.delta)
        correct_state(calls, plan, S, b, s, SETTLED)
        keep_definite(P, before, s.half)
    s.result[0], s.result[1] = nis, 1.0 if used else 0.0


@entry(_nrt=False)
def carry_along(
    storage_at: int,
    b: int,
    rows: IntArray,
    sources: IntArray,
    places: IntArray,
    factors: FloatArray,
    before: FloatArray,
    after: FloatArray,
    among: FloatArray,
) -> None:
    """P = T P T^T of filter b, T the identity but for C rows, each of which has at most k numbers.

    Row `rows[i]` of T has `factors[i, j]` in the column `sources[places[i, j]]`; a place of -1 ends it. The last three
    arrays are room: for the rows of P at the sources (U, n), for the changed ones (C, n), and where these cross (C, C).
    """
    P, n, width = read_storage(storage_at).P[b], before.shape[1], places.shape[1]
    for i in range(len(sources)):
        row = sources[i]
        for j in range(row):
            before[i, j] = P[j, row]
        for j in range(row, n):
            before[i, j] = P[row, j]
    for i in range(len(rows)):
        target = after[i]
        for j in range(n):
            target[j] = 0.0
        for k in range(width):
            if places[i, k] < 0:
                break
            factor, source = factors[i, k], before[places[i, k]]
            if factor != 0.0:
                for j in range(n):
                    target[j] += factor * source[j]
    for i in range(len(rows)):
        for j in range(i, len(rows)):
            total = 0.0
            for k in range(width):
                if places[j, k] < 0:
                    break
                total += after[i, sources[places[j, k]]] * factors[j, k]
            among[i, j] = total
    for i in range(len(rows)):
        row = rows[i]
        for j in range(row):
            P[j, row] = after[i, j]
        for j in range(row, n):
            P[row, j] = after[i, j]
    for i in range(len(rows)):
        for j in range(i, len(rows)):
            P[min(rows[i], rows[j]), max(rows[i], rows[j])] = among[i, j]


@entry
def points_at(calls_at: int, settings: FloatArray, values: FloatArray, points: FloatArray, J: FloatArray) -> None:
    """Homogeneous points of landmarks by the kernel of their parametrisation."""
    call(read_calls(calls_at).point, (settings, values, points, J))


@entry
def step_at(
    calls_at: int,
    settings: FloatArray,
    x: FloatArray,
    dt: float,
    odometry: FloatArray,
    moved: FloatArray,
    F: FloatArray,
    Q: FloatArray,
) -> None:
    """Step of a motion by its compiled function."""
    call(read_calls(calls_at).step, (settings, x, dt, odometry, moved, F, Q))


@entry
def relative_landmarks(
    P: FloatArray,
    x: FloatArray,
    blocks: FloatArray,
    own: IntArray,
    anchor: IntArray,
    counts: IntArray,
    leading: int,
    anchored: bool,
    in_world: bool,
    points: FloatArray,
    by_own: FloatArray,
    offsets: IntArray,
    places: FloatArray,
    covariances: FloatArray,
    located: BoolArray,
) -> None:
    """p_c = R_wc^T (p_w - r) of the landmarks of all filters, and its covariance; the last three are written.

    With `in_world` the same of p_w: the pose then is that of W, and exact.

    `points` (M, seen) and `by_own` (M, seen, size) are those of `points_at`. `located`: in front of the anchor, at a
    finite distance, with a finite covariance.
    """
    size = by_own.shape[2]
    most = POSE_SIZE + 3 + size
    J, own_P, JP = np.empty((3, most)), np.empty((most, most)), np.empty((3, most))
    rows, width = np.empty(most, dtype=np.int64), POSE_SIZE + size + (3 if anchored else 0)
    rows[:POSE_SIZE] = np.arange(POSE_SIZE)
    origin_of_w = np.zeros(7)
    origin_of_w[6] = 1.0
    for b in range(len(x)):
        camera, P_b = origin_of_w if in_world else x[b], P[b]
        R_cw = transposed(orientation(camera))
        for i in range(counts[b, LANDMARKS]):
            m, first = offsets[b] + i, POSE_SIZE
            w0, w1, w2, origin = -camera[0], -camera[1], -camera[2], anchor[b, i]
            if anchored and origin < 0:  # a point of W
                origin = own[b, i]
                for a in range(4):
                    points[m, a] = blocks[b, origin, a] if a < 3 else 1.0
                    for k in range(size):
                        by_own[m, a, k] = 1.0 if a == k else 0.0
                rows[first : first + 3] = leading + size * origin + np.arange(3)
                first += 3
            elif anchored:
                w0, w1, w2 = w0 + blocks[b, origin, 0], w1 + blocks[b, origin, 1], w2 + blocks[b, origin, 2]
                rows[first : first + 3] = leading + size * origin + np.arange(3)
                first += 3
            rows[first : first + size] = leading + size * own[b, i] + np.arange(size)
            z = 1.0 / points[m, 3]
            d0, d1, d2 = z * points[m, 0], z * points[m, 1], z * points[m, 2]
            for k in range(size):
                by_scale = by_own[m, 3, k]
                J[0, first + k], J[1, first + k], J[2, first + k] = times(
                    R_cw,
                    z * (by_own[m, 0, k] - d0 * by_scale),
                    z * (by_own[m, 1, k] - d1 * by_scale),
                    z * (by_own[m, 2, k] - d2 * by_scale),
                )
            ahead = z > 0.0
            c0, c1, c2 = times(R_cw, w0 + d0, w1 + d1, w2 + d2)
            places[m, 0], places[m, 1], places[m, 2] = c0, c1, c2
            for a in range(3):
                for k in range(3):
                    J[a, k] = 0.0 if in_world else -R_cw[3 * a + k]
                    if anchored:
                        J[a, POSE_SIZE + k] = R_cw[3 * a + k] if anchor[b, i] >= 0 else 0.0
            put(J, 0, 3, cross_matrix(c0, c1, c2), 0.0 if in_world else 1.0)
            for k in range(width):
                for q in range(k, width):
                    p = P_b[min(rows[k], rows[q]), max(rows[k], rows[q])]
                    own_P[k, q], own_P[q, k] = p, p
            for a in range(3):
                for q in range(width):
                    total = 0.0
                    for k in range(width):
                        total += J[a, k] * own_P[k, q]
                    JP[a, q] = total
            finite = math.isfinite(c0) and math.isfinite(c1) and math.isfinite(c2)
            for a in range(3):
                for q in range(a, 3):
                    total = 0.0
                    for k in range(width):
                        total += JP[a, k] * J[q, k]
                    covariances[m, a, q], covariances[m, q, a] = total, total
                    finite = finite and math.isfinite(total)
            located[m] = ahead and finite


@entry(_nrt=False)
def forecasts(
    calls_at: int,
    plan_at: int,
    storage_at: int,
    scratch_at: int,
    first: int,
    offsets: IntArray,
    noise: FloatArray,
    uvd: FloatArray,
    S: FloatArray,
    in_front: BoolArray,
) -> None:
    """Predicted (u, v, d) of all landmarks of some filters, from the first on, and H P H^T + R of each.

    Landmarks of filter first + f are at offsets[f] to offsets[f + 1] - 1 of the last three, which are written; its
    noise is noise[f]. A landmark whose S is not definite, by rounding in a point almost at infinity, has NaN there, and
    is not in front.
    """
    calls, plan, storage = read_calls(calls_at), read_plan(plan_at), read_storage(storage_at)
    s = read_scratch(scratch_at)
    measured, width = plan.measured, plan.measured + 3 * plan.anchors + plan.size
    for f in range(len(offsets) - 1):
        b, begin, count = first + f, offsets[f], offsets[f + 1] - offsets[f]
        expect(calls, plan, storage, b, s, count)
        P = storage.P[b]
        for i in range(count):
            m, H = begin + i, s.H[i]
            in_front[m] = s.in_front[i]
            for k in range(3):
                uvd[m, k] = s.numbers[i, k]
            for a in range(width):
                s.gate_rows[a] = a
            for a in range(3 * plan.anchors):
                s.gate_rows[measured + a] = s.base[i, 0] + a
            for a in range(plan.size):
                s.gate_rows[width - plan.size + a] = s.base[i, 1] + a
            for k in range(3):
                for a in range(width):
                    s.gate_HP[k, a] = 0.0
            for a in range(width):
                for c in range(width):
                    p, q = s.gate_rows[a], s.gate_rows[c]
                    covariance = P[min(p, q), max(p, q)]
                    for k in range(3):
                        s.gate_HP[k, c] += H[k, a] * covariance
            for k in range(3):
                for j in range(k, 3):  # and its mirror: where S is large, rounding is not symmetric
                    total = 0.0
                    for c in range(width):
                        total += s.gate_HP[k, c] * H[j, c]
                    S[m, k, j], S[m, j, k] = total + noise[f, k, j], total + noise[f, j, k]
            minor = S[m, 0, 0] * S[m, 1, 1] - S[m, 0, 1] ** 2
            first_cofactor = S[m, 0, 1] * S[m, 1, 2] - S[m, 0, 2] * S[m, 1, 1]
            second_cofactor = S[m, 0, 1] * S[m, 0, 2] - S[m, 0, 0] * S[m, 1, 2]
            determinant = S[m, 0, 2] * first_cofactor + S[m, 1, 2] * second_cofactor + S[m, 2, 2] * minor
            if not (S[m, 0, 0] > 0.0 and minor > 0.0 and determinant > 0.0):
                in_front[m] = False
                for k in range(3):
                    for j in range(3):
                        S[m, k, j] = np.nan


def compile_forecasts() -> None:
    """Compile `forecasts`, or load it from the disk, before it is called."""
    if not PLAIN and not forecasts.signatures:
        arrays = INDEX, MATRICES, MATRIX, MATRICES, FLAGS
        forecasts.compile(types.void(*[types.intp] * 4, types.int64, *arrays))
