"""Kernels of the update: linearisation, gate, joint test, Kalman correction.

H is kept as its nonzero parts: by the leading rows (M, k, c) and by the landmark's own blocks (M, k, w), with the first
rows of those blocks (M, w / 3).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from filters.compiled.blas import at, call
from filters.compiled.covariance import take_rows
from filters.compiled.geometry import (
    CALIBRATION,
    CALIBRATIONS,
    OPTIONS,
    ORIENTATION,
    exponential,
    misaligned,
    project,
    project_jacobian,
    right_jacobian,
    rotation,
    seen_from,
    turned,
)
from filters.engine.kalman import DROWNED
from filters.validation import BoolArray, FloatArray, IntArray

CHUNK_ROWS = 36
"""See `kalman.CHUNK_ROWS`; here a pass costs less."""


@njit(**OPTIONS)
def predict_points(
    numbers: FloatArray,
    values: FloatArray,
    blocks: FloatArray,
    landmarks: IntArray,
    index: IntArray,
    uvd: FloatArray,
    ahead: BoolArray,
) -> None:
    """(u, v, d) (M, 3) of the landmarks at `index`, and whether they are ahead (M,)."""
    calibration = values[CALIBRATION : CALIBRATION + CALIBRATIONS]
    R, X = np.empty((3, 3)), np.empty((3, 3))
    seen, rays, h, h_c = np.empty(7), np.empty(9), np.empty(3), np.empty(3)
    rotation(values[ORIENTATION:], R)
    tilted = misaligned(calibration)
    if tilted:
        exponential(calibration[3:6], X)
    for m in range(len(index)):
        seen_from(values, blocks, landmarks[index[m], 2], landmarks[index[m], 1], rays, seen)
        for i in range(3):
            h[i] = seen[0] * R[0, i] + seen[1] * R[1, i] + seen[2] * R[2, i]
        ahead[m] = h[2] > 0.0
        if tilted:
            turned(X, h, h_c)
            project(numbers, calibration, h_c, seen[3], uvd[m])
        else:
            project(numbers, calibration, h, seen[3], uvd[m])


@njit(**OPTIONS)
def linearise(
    numbers: FloatArray,
    columns: IntArray,
    lead: int,
    values: FloatArray,
    blocks: FloatArray,
    landmarks: IntArray,
    index: IntArray,
    T: FloatArray,
    predicted: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
) -> None:
    """`Extended.linearise`: predicted z (M, k), H by leading rows and by map, first rows of the map blocks.

    columns (6,) are the leading rows of the numbers of the calibration, -1 of those that are no variables.
    """
    calibration = values[CALIBRATION : CALIBRATION + CALIBRATIONS]
    size, width = by_map.shape[1:]
    R, X, J_left = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    seen, rays, h, h_c, uvd = np.empty(7), np.empty(9), np.empty(3), np.empty(3), np.empty(3)
    J, g_c, g_body, g = np.empty((3, 10)), np.empty(10), np.empty(3), np.empty(3)
    rotation(values[ORIENTATION:], R)
    tilted = misaligned(calibration)
    if tilted:
        exponential(calibration[3:6], X)
        right_jacobian(calibration[3:6], -1.0, J_left)
    by_leading[:] = 0.0
    for m in range(len(index)):
        anchor, own = landmarks[index[m], 2], landmarks[index[m], 1]
        seen_from(values, blocks, anchor, own, rays, seen)
        for i in range(3):
            h[i] = seen[0] * R[0, i] + seen[1] * R[1, i] + seen[2] * R[2, i]
        rho = seen[3]
        if tilted:
            turned(X, h, h_c)
        else:
            h_c[:] = h
        project(numbers, calibration, h_c, rho, uvd)
        project_jacobian(numbers, calibration, h_c, rho, uvd, J)
        map_rows[m, width // 3 - 1] = lead + 3 * own
        if anchor >= 0:
            map_rows[m, 0] = lead + 3 * anchor
        for a in range(size):
            predicted[m, a] = T[a, 0] * uvd[0] + T[a, 1] * uvd[1] + T[a, 2] * uvd[2]
            for c in range(10):
                g_c[c] = T[a, 0] * J[0, c] + T[a, 1] * J[1, c] + T[a, 2] * J[2, c]
            for i in range(3):
                g_body[i] = g_c[i]
            if tilted:
                for i in range(3):
                    g_body[i] = g_c[0] * X[0, i] + g_c[1] * X[1, i] + g_c[2] * X[2, i]
            for i in range(3):
                g[i] = R[i, 0] * g_body[0] + R[i, 1] * g_body[1] + R[i, 2] * g_body[2]
                by_leading[m, a, i] = -g[i] if anchor < 0 else -rho * g[i]
                by_map[m, a, i] = -by_leading[m, a, i]
            # g^T [h]x = (g x h)^T
            by_leading[m, a, 3] = g_body[1] * h[2] - g_body[2] * h[1]
            by_leading[m, a, 4] = g_body[2] * h[0] - g_body[0] * h[2]
            by_leading[m, a, 5] = g_body[0] * h[1] - g_body[1] * h[0]
            if anchor >= 0:
                by_map[m, a, 3] = g[0] * rays[3] + g[1] * rays[4] + g[2] * rays[5]
                by_map[m, a, 4] = g[0] * rays[6] + g[1] * rays[7] + g[2] * rays[8]
                by_map[m, a, 5] = g[0] * seen[4] + g[1] * seen[5] + g[2] * seen[6] + g_c[3]
            for c in range(CALIBRATIONS):
                column = columns[c]
                if column >= 0:
                    by_leading[m, a, column] = g_c[4 + c]
                    if tilted and c >= 3:
                        by_leading[m, a, column] = (
                            g_c[7] * J_left[0, c - 3] + g_c[8] * J_left[1, c - 3] + g_c[9] * J_left[2, c - 3]
                        )


@njit(**OPTIONS)
def squared_distances(
    P: FloatArray,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    distances: FloatArray,
) -> None:
    """`kalman.squared_distances`: nu^T S^-1 nu of each measurement on its own, by S = L D L^T; distances (M,)."""
    count, size, width = by_map.shape
    leading = by_leading.shape[2]
    total = leading + width
    covariance = np.empty((total, total))
    HP, S, solved = np.empty(total), np.empty((size, size)), np.empty(size)
    H = np.empty((size, total))
    for i in range(leading):
        for j in range(i, leading):
            covariance[i, j] = covariance[j, i] = P[i, j]
    for m in range(count):
        for block in range(width // 3):
            row, place = map_rows[m, block], leading + 3 * block
            for j in range(leading):
                for i in range(3):
                    covariance[j, place + i] = covariance[place + i, j] = P[j, row + i]
            for i in range(3):
                for j in range(i, 3):
                    covariance[place + i, place + j] = covariance[place + j, place + i] = P[row + i, row + j]
            if block == 1:
                first = map_rows[m, 0]
                for i in range(3):
                    for j in range(3):
                        value = P[first + i, row + j] if first < row else P[row + j, first + i]
                        covariance[leading + i, place + j] = covariance[place + j, leading + i] = value
        for a in range(size):
            for c in range(leading):
                H[a, c] = by_leading[m, a, c]
            for c in range(width):
                H[a, leading + c] = by_map[m, a, c]
        distances[m] = 0.0
        for a in range(size):
            factor = H[a, 0]
            for j in range(total):
                HP[j] = factor * covariance[0, j]
            for i in range(1, total):
                factor = H[a, i]
                for j in range(total):
                    HP[j] += factor * covariance[i, j]
            for b in range(a + 1):
                value = R[m, a, b]
                for c in range(total):
                    value += HP[c] * H[b, c]
                S[a, b] = value
        for a in range(size):
            solved[a] = innovation[m, a]
            for b in range(a):
                solved[a] -= S[a, b] / S[b, b] * solved[b]
                for c in range(a, size):
                    S[c, a] -= S[c, b] * S[a, b] / S[b, b]
            distances[m] += solved[a] ** 2 / S[a, a]


@njit(**OPTIONS)
def _project_rows(
    P: FloatArray,
    n: int,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    first: int,
    last: int,
    HP: FloatArray,
) -> None:
    """H P of the measurements first to last - 1, in HP (rows, n or more)."""
    size, width = by_map.shape[1:]
    leading = by_leading.shape[2]
    rows = np.empty((3, n))
    for offset in range(0, leading, 3):
        take_rows(P, offset, n, rows)
        for m in range(first, last):
            for a in range(size):
                x, y, z = by_leading[m, a, offset], by_leading[m, a, offset + 1], by_leading[m, a, offset + 2]
                target = HP[(m - first) * size + a]
                if offset == 0:
                    for j in range(n):
                        target[j] = x * rows[0, j] + y * rows[1, j] + z * rows[2, j]
                else:
                    for j in range(n):
                        target[j] += x * rows[0, j] + y * rows[1, j] + z * rows[2, j]
    for block in range(width // 3):
        held = -1
        for m in range(first, last):
            if map_rows[m, block] != held:  # neighbours often share an anchor
                held = map_rows[m, block]
                take_rows(P, held, n, rows)
            for a in range(size):
                x, y, z = by_map[m, a, 3 * block], by_map[m, a, 3 * block + 1], by_map[m, a, 3 * block + 2]
                target = HP[(m - first) * size + a]
                for j in range(n):
                    target[j] += x * rows[0, j] + y * rows[1, j] + z * rows[2, j]


@njit(**OPTIONS)
def _innovation_covariance(
    HP: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    first: int,
    last: int,
    S: FloatArray,
) -> None:
    """S = (H P) H^T + R, its upper triangle in C order, of the measurements first to last - 1."""
    size, width = by_map.shape[1:]
    leading = by_leading.shape[2]
    rows = (last - first) * size
    shared, own = np.empty((leading, rows)), np.empty((width, rows))
    for row in range(rows):
        for c in range(leading):
            shared[c, row] = HP[row, c]
    for m in range(first, last):
        top = (m - first) * size
        for block in range(width // 3):
            place = map_rows[m, block]
            for row in range(top, rows):
                for i in range(3):
                    own[3 * block + i, row] = HP[row, place + i]
        for a in range(size):
            target = S[top + a]
            for c in range(0, leading, 3):
                x, y, z = by_leading[m, a, c], by_leading[m, a, c + 1], by_leading[m, a, c + 2]
                if c == 0:
                    for row in range(top, rows):
                        target[row] = x * shared[0, row] + y * shared[1, row] + z * shared[2, row]
                else:
                    for row in range(top, rows):
                        target[row] += x * shared[c, row] + y * shared[c + 1, row] + z * shared[c + 2, row]
            for c in range(0, width, 3):
                x, y, z = by_map[m, a, c], by_map[m, a, c + 1], by_map[m, a, c + 2]
                for row in range(top, rows):
                    target[row] += x * own[c, row] + y * own[c + 1, row] + z * own[c + 2, row]
            for b in range(size):
                target[top + b] += R[m, a, b]


@njit(**OPTIONS)
def _take(
    routines: tuple[int, ...],
    letters: IntArray,
    sizes: IntArray,
    signs: FloatArray,
    P: FloatArray,
    n: int,
    delta: FloatArray,
    HP: FloatArray,
    S: FloatArray,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    first: int,
    last: int,
) -> float:
    """Correct P and delta with the measurements first to last - 1; the NIS, or -1 where S has no Cholesky factor.

    HP has a last column for the innovation, so that one triangular solve does for both. BLAS, which is column-major,
    sees HP transposed and the lower triangle of S. The small arrays are arguments because BLAS wants addresses.
    """
    size, width = by_map.shape[1:]
    leading = by_leading.shape[2]
    rows = (last - first) * size
    _project_rows(P, n, by_leading, by_map, map_rows, first, last, HP)
    _innovation_covariance(HP, by_leading, by_map, map_rows, R, first, last, S)
    for m in range(first, last):
        for a in range(size):
            row = (m - first) * size + a
            if width > 0 and S[row, row] > DROWNED * R[m, a, a]:
                return -1.0
            explained = 0.0
            for c in range(leading):
                explained += by_leading[m, a, c] * delta[c]
            for block in range(width // 3):
                place = map_rows[m, block]
                for i in range(3):
                    explained += by_map[m, a, 3 * block + i] * delta[place + i]
            HP[row, n] = innovation[m, a] - explained

    sizes[0], sizes[1], sizes[2], sizes[3], sizes[4] = rows, n, n + 1, S.shape[1], 1
    sizes[5], sizes[6], sizes[7] = 0, HP.shape[1], P.shape[1]
    lower = at(letters)
    right, plain, turned_letter = lower + 1, lower + 2, lower + 3
    k = at(sizes)
    states, solved_columns, room, one, info = k + 4, k + 8, k + 12, k + 16, k + 20
    stride, capacity = k + 24, k + 28
    plus = at(signs)
    minus, covariance, solved, factor = plus + 8, at(P), at(HP), at(S)
    call(routines[0], (lower, k, factor, room, info))
    if sizes[5] != 0 or not math.isfinite(S[rows - 1, rows - 1]):
        return -1.0
    # HP <- L^-1 HP, delta += HP^T nu, P -= HP^T HP
    call(routines[1], (right, lower, turned_letter, plain, solved_columns, k, plus, factor, room, solved, stride))
    call(routines[2], (plain, states, k, plus, solved, stride, solved + 8 * n, stride, plus, at(delta), one))
    call(routines[3], (lower, plain, states, k, minus, solved, stride, plus, covariance, capacity))
    nis = 0.0
    for row in range(rows):
        nis += HP[row, n] ** 2
    return nis


@njit(**OPTIONS)
def correct(
    routines: tuple[int, ...],
    P: FloatArray,
    n: int,
    considered: IntArray,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    delta: FloatArray,
    used: BoolArray,
) -> float:
    """`kalman.update`, P in place: delta (n,), which measurements were used (M,); returns the NIS."""
    count, size = innovation.shape
    delta[:] = 0.0
    used[:] = False
    nis = 0.0
    if count == 0:
        return nis
    kept = np.empty((len(considered), len(considered)))
    for i in range(len(considered)):
        for j in range(i, len(considered)):
            kept[i, j] = P[considered[i], considered[j]]
    chunk = max(1, CHUNK_ROWS // size)
    chunks = -(-count // chunk)
    most = min(count, chunk) * size
    HP, S = np.empty((most, n + 1)), np.empty((most, most))
    letters, sizes = np.array((76, 82, 78, 84), np.uint8), np.zeros(8, np.int32)  # L, R, N, T
    signs = np.array((1.0, -1.0))
    for i in range(chunks):
        first, last = count * i // chunks, count * (i + 1) // chunks
        at_once = True
        while first < last:
            end = last if at_once else first + 1
            gained = _take(
                routines,
                letters,
                sizes,
                signs,
                P,
                n,
                delta,
                HP,
                S,
                innovation,
                by_leading,
                by_map,
                map_rows,
                R,
                first,
                end,
            )
            if gained >= 0.0:
                used[first:end] = True
                nis += gained
                first = end
            elif end - first > 1:
                at_once = False
            else:
                first = end
    for i in range(len(considered)):
        delta[considered[i]] = 0.0
        for j in range(i, len(considered)):
            P[considered[i], considered[j]] = kept[i, j]
    return nis


@njit(**OPTIONS)
def largest_agreement(
    P: FloatArray,
    n: int,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    limit: float,
    agree: BoolArray,
) -> None:
    """`consensus.largest_agreement`: which measurements agree with the best one-landmark hypothesis; agree (M,)."""
    count, size = innovation.shape
    if count < 2:
        agree[:] = True
        return
    rows = count * size
    HP, S = np.empty((rows, n)), np.empty((rows, rows))
    _project_rows(P, n, by_leading, by_map, map_rows, 0, count, HP)
    _innovation_covariance(HP, by_leading, by_map, map_rows, R, 0, count, S)
    # L D L^T of each R, unit lower triangle and diagonal in one
    factors = np.empty((count, size, size))
    for m in range(count):
        for a in range(size):
            for b in range(a + 1):
                factors[m, a, b] = R[m, a, b]
            for b in range(a):
                for c in range(b):
                    factors[m, a, b] -= factors[m, a, c] * factors[m, b, c] * factors[m, c, c]
                factors[m, a, b] /= factors[m, b, b]
            for b in range(a):
                factors[m, a, a] -= factors[m, a, b] ** 2 * factors[m, b, b]
    own, proposal, solved = np.empty((size, size)), np.empty(size), np.empty(size)
    best_support, best_tightness = -1, 0.0
    mine = np.empty(count, np.bool_)
    for i in range(count):
        top = i * size
        for a in range(size):
            proposal[a] = innovation[i, a]
            for b in range(a + 1):
                own[a, b] = S[top + b, top + a]
        # own = L L^T, proposal = own^-1 nu_i
        for a in range(size):
            for b in range(a + 1):
                value = own[a, b]
                for c in range(b):
                    value -= own[a, c] * own[b, c]
                own[a, b] = math.sqrt(value) if a == b else value / own[b, b]
        for a in range(size):
            for c in range(a):
                proposal[a] -= own[a, c] * proposal[c]
            proposal[a] /= own[a, a]
        for a in range(size - 1, -1, -1):
            for c in range(a + 1, size):
                proposal[a] -= own[c, a] * proposal[c]
            proposal[a] /= own[a, a]
        support, tightness = 0, 0.0
        for j in range(count):
            distance = 0.0
            for a in range(size):
                residual = innovation[j, a]
                for b in range(size):
                    p, q = j * size + a, top + b
                    residual -= (S[p, q] if p <= q else S[q, p]) * proposal[b]
                solved[a] = residual
                for b in range(a):
                    solved[a] -= factors[j, a, b] * solved[b]
                distance += solved[a] ** 2 / factors[j, a, a]
            mine[j] = distance <= limit or i == j
            if mine[j]:
                support += 1
                tightness += distance
        if support > best_support or (support == best_support and tightness < best_tightness):
            best_support, best_tightness = support, tightness
            agree[:] = mine
