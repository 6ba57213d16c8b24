"""Kernels of `engine.kalman`: the Kalman update."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, types

from filters.engine.kalman import DROWNED
from filters.engine.kernels.blas import ADDRESSES, ROUTINES, at, call
from filters.engine.kernels.signatures import COVARIANCE, FIXED, FLOATS, MEASURED
from filters.validation import BoolArray, FloatArray, IntArray


@njit(**FLOATS)
def _take_block(P: FloatArray, first: int, block: FloatArray) -> None:
    """Rows first to first + 2 of the symmetric P, in `block` (3, n or more)."""
    for j in range(first):
        block[0, j], block[1, j], block[2, j] = P[first, j], P[first + 1, j], P[first + 2, j]
    for i in range(3):
        for j in range(first, first + i):
            block[i, j] = P[first + i, j]
        for j in range(first + i, len(P)):
            block[i, j] = P[j, first + i]


@njit(**FLOATS)
def _add_product(target: FloatArray, H: FloatArray, block: FloatArray, columns: int, add: bool) -> None:
    """target = H block, or target += H block, on the first columns; (k, n or more), (k, 3), (3, n or more)."""
    for row in range(len(H)):
        a, b, c = H[row, 0], H[row, 1], H[row, 2]
        if add:
            for j in range(columns):
                target[row, j] += a * block[0, j] + b * block[1, j] + c * block[2, j]
        else:
            for j in range(columns):
                target[row, j] = a * block[0, j] + b * block[1, j] + c * block[2, j]


@njit(**FLOATS)
def _take(
    routines: tuple[int, ...],
    letters: IntArray,
    sizes: IntArray,
    signs: FloatArray,
    P: FloatArray,
    delta: FloatArray,
    HP: FloatArray,
    S: FloatArray,
    innovation: FloatArray,
    by_camera: FloatArray,
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
    n, camera = len(P), by_camera.shape[2]
    size, width = by_map.shape[1:]
    rows = (last - first) * size
    block = np.empty((3, n))
    for offset in range(0, camera, 3):
        _take_block(P, offset, block)
        for m in range(first, last):
            top = (m - first) * size
            _add_product(HP[top : top + size], by_camera[m, :, offset : offset + 3], block, n, offset > 0)
    for offset in range(0, width, 3):
        held = -1
        for m in range(first, last):
            if map_rows[m, offset] != held:  # neighbours often share an anchor
                held = map_rows[m, offset]
                _take_block(P, held, block)
            top = (m - first) * size
            _add_product(HP[top : top + size], by_map[m, :, offset : offset + 3], block, n, True)

    shared, own = np.empty((camera, rows)), np.empty((width, rows))
    for row in range(rows):
        for c in range(camera):
            shared[c, row] = HP[row, c]
    for m in range(first, last):
        top = (m - first) * size
        for row in range(top, rows):
            for c in range(width):
                own[c, row] = HP[row, map_rows[m, c]]
        target = S[top : top + size, top:rows]
        for offset in range(0, camera, 3):
            block_of_shared = shared[offset : offset + 3, top:]
            _add_product(target, by_camera[m, :, offset : offset + 3], block_of_shared, rows - top, offset > 0)
        for offset in range(0, width, 3):
            _add_product(target, by_map[m, :, offset : offset + 3], own[offset : offset + 3, top:], rows - top, True)
        for a in range(size):
            for b in range(size):
                S[top + a, top + b] += R[m, b, a]
            if width > 0 and S[top + a, top + a] > DROWNED * R[m, a, a]:
                return -1.0
            explained = 0.0
            for c in range(camera):
                explained += by_camera[m, a, c] * delta[c]
            for c in range(width):
                explained += by_map[m, a, c] * delta[map_rows[m, c]]
            HP[top + a, n] = innovation[m, a] - explained

    sizes[0], sizes[1], sizes[2], sizes[3], sizes[4] = rows, n, n + 1, S.shape[1], 1
    lower = at(letters)
    right, plain, turned = lower + 1, lower + 2, lower + 3
    k = at(sizes)
    states, stride, room, one, info = k + 4, k + 8, k + 12, k + 16, k + 20
    plus = at(signs)
    minus, covariance, solved, factor = plus + 8, at(P), at(HP), at(S)
    call(routines[0], (lower, k, factor, room, info))
    if sizes[5] != 0 or not math.isfinite(S[rows - 1, rows - 1]):
        return -1.0
    # HP <- L^-1 HP, delta += HP^T nu, P -= HP^T HP
    call(routines[1], (right, lower, turned, plain, stride, k, plus, factor, room, solved, stride))
    call(routines[2], (plain, states, k, plus, solved, stride, solved + 8 * n, stride, plus, at(delta), one))
    call(routines[3], (lower, plain, states, k, minus, solved, stride, plus, covariance, states))
    nis = 0.0
    for row in range(rows):
        nis += HP[row, n] ** 2
    return nis


@njit(
    types.Tuple((types.float64[::1], types.float64, types.boolean[::1]))(ADDRESSES, COVARIANCE, *MEASURED, types.int64),
    **FIXED,
)
def correct_by(
    routines: tuple[int, ...],
    P: FloatArray,
    innovation: FloatArray,
    by_camera: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    chunk: int,
) -> tuple[FloatArray, float, BoolArray]:
    """`kalman.update`, P in place: delta (n,), the NIS, and which measurements were used (M,)."""
    count, size = innovation.shape
    delta, nis, used = np.zeros(len(P)), 0.0, np.zeros(count, np.bool_)
    chunks = -(-count // chunk)
    most = min(count, chunk) * size
    HP, S = np.empty((most, len(P) + 1)), np.empty((most, most))
    letters, sizes = np.array((76, 82, 78, 84), np.uint8), np.zeros(6, np.int32)  # L, R, N, T
    signs = np.array((1.0, -1.0))
    for i in range(chunks):
        first, last = count * i // chunks, count * (i + 1) // chunks
        gained = _take(
            routines, letters, sizes, signs, P, delta, HP, S, innovation, by_camera, by_map, map_rows, R, first, last
        )
        if gained >= 0.0:
            used[first:last] = True
            nis += gained
        elif last - first > 1:
            for m in range(first, last):
                gained = _take(
                    routines,
                    letters,
                    sizes,
                    signs,
                    P,
                    delta,
                    HP,
                    S,
                    innovation,
                    by_camera,
                    by_map,
                    map_rows,
                    R,
                    m,
                    m + 1,
                )
                if gained >= 0.0:
                    used[m] = True
                    nis += gained
    return delta, nis, used


def correct(P: FloatArray, *measured: Any) -> tuple[FloatArray, float, BoolArray]:
    """`kalman.update`: delta (n,), the NIS, and which measurements were used (M,)."""
    corrected: tuple[FloatArray, float, BoolArray] = correct_by(ROUTINES, P, *measured)
    return corrected
