"""Kernels of the covariance: rows, transformations, blocks that come and go.

P is passed as its transpose in C order: P[j, i] with j <= i is valid, which is the lower triangle of a column-major
matrix, as BLAS and `filters.state` have it. `n` rows are in use.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from filters.compiled.geometry import OPTIONS
from filters.validation import FloatArray


@njit(**OPTIONS)
def take_rows(P: FloatArray, first: int, n: int, rows: FloatArray) -> None:
    """The rows first, first + 1, first + 2 of the symmetric P, in rows (3, n or more)."""
    for j in range(first):
        rows[0, j], rows[1, j], rows[2, j] = P[j, first], P[j, first + 1], P[j, first + 2]
    for i in range(3):
        for j in range(i):
            rows[i, first + j] = P[first + j, first + i]
        for j in range(first + i, n):
            rows[i, j] = P[first + i, j]


@njit(**OPTIONS)
def put_rows(P: FloatArray, first: int, n: int, rows: FloatArray) -> None:
    """The inverse of `take_rows`."""
    for j in range(first):
        P[j, first], P[j, first + 1], P[j, first + 2] = rows[0, j], rows[1, j], rows[2, j]
    for i in range(3):
        for j in range(first + i, n):
            P[first + i, j] = rows[i, j]


@njit(**OPTIONS)
def transform_leading(P: FloatArray, F: FloatArray, added: FloatArray, n: int) -> None:
    """`symmetric.transform_leading`."""
    size = len(F)
    old, half = np.empty((size, size)), np.zeros((size, size))
    for i in range(size):
        for j in range(i + 1):
            old[i, j] = old[j, i] = P[j, i]
    for i in range(size):
        for k in range(size):
            if F[i, k] != 0.0:
                for j in range(size):
                    half[i, j] += F[i, k] * old[k, j]
    for i in range(size):
        for j in range(i + 1):
            P[j, i] = 0.5 * (added[i, j] + added[j, i])
            for k in range(size):
                P[j, i] += half[i, k] * F[j, k]
    if n == size:
        return
    cross = np.empty((size, n - size))
    for k in range(size):
        for j in range(n - size):
            cross[k, j] = P[k, size + j]
    for i in range(size):
        changed = False
        for k in range(size):
            changed = changed or F[i, k] != (1.0 if i == k else 0.0)
        if changed:
            row = P[i, size:n]
            row[:] = 0.0
            for k in range(size):
                if F[i, k] != 0.0:
                    factor = F[i, k]
                    for j in range(n - size):
                        row[j] += factor * cross[k, j]


@njit(**OPTIONS)
def transform_blocks(P: FloatArray, own: FloatArray, lead: int, n: int) -> None:
    """Rows and columns of every map block multiplied by its own matrix (B, 3, 3)."""
    for b in range(len(own)):
        D = own[b]
        c = lead + 3 * b
        # columns of the block in all rows before it
        for j in range(c):
            x, y, z = P[j, c], P[j, c + 1], P[j, c + 2]
            for i in range(3):
                P[j, c + i] = D[i, 0] * x + D[i, 1] * y + D[i, 2] * z
        # the block itself, symmetric
        block = np.empty((3, 3))
        for i in range(3):
            for j in range(3):
                x, y = P[c + min(0, j), c + max(0, j)], P[c + min(1, j), c + max(1, j)]
                block[i, j] = D[i, 0] * x + D[i, 1] * y + D[i, 2] * P[c + min(2, j), c + max(2, j)]
        for i in range(3):
            for j in range(i, 3):
                P[c + i, c + j] = block[i, 0] * D[j, 0] + block[i, 1] * D[j, 1] + block[i, 2] * D[j, 2]
        # its rows, to the right
        for j in range(c + 3, n):
            x, y, z = P[c, j], P[c + 1, j], P[c + 2, j]
            P[c, j] = D[0, 0] * x + D[0, 1] * y + D[0, 2] * z
            P[c + 1, j] = D[1, 0] * x + D[1, 1] * y + D[1, 2] * z
            P[c + 2, j] = D[2, 0] * x + D[2, 1] * y + D[2, 2] * z


@njit(**OPTIONS)
def shear(P: FloatArray, W: FloatArray, first: int, n: int) -> None:
    """P <- (I + W E^T) P (I + W E^T)^T, E selecting the three rows from `first`; W (3, n), transposed."""
    rows, half = np.empty((3, n)), np.empty((3, n))
    take_rows(P, first, n, rows)
    for a in range(3):
        for j in range(n):
            half[a, j] = rows[a, j]
        for k in range(3):
            corner = 0.5 * rows[a, first + k]
            for j in range(n):
                half[a, j] += corner * W[k, j]
    for j in range(n):
        w0, w1, w2 = W[0, j], W[1, j], W[2, j]
        h0, h1, h2 = half[0, j], half[1, j], half[2, j]
        row = P[j]
        for i in range(j, n):
            row[i] += (w0 * half[0, i] + w1 * half[1, i] + w2 * half[2, i]) + (
                h0 * W[0, i] + h1 * W[1, i] + h2 * W[2, i]
            )


@njit(**OPTIONS)
def add_block(P: FloatArray, first: int, n: int, J: FloatArray, noise: FloatArray, size: int, rows: FloatArray) -> None:
    """A new block at `first` whose error is J (3, size) times the leading rows, plus noise (3, 3).

    `n` counts it already; what P has there is overwritten.
    """
    for i in range(3):
        for j in range(n):
            rows[i, j] = 0.0
        for k in range(size):
            factor = J[i, k]
            if factor == 0.0:
                continue
            for j in range(k):
                rows[i, j] += factor * P[j, k]
            for j in range(k, n):
                rows[i, j] += factor * P[k, j]
    for i in range(3):
        for j in range(3):
            rows[i, first + j] = noise[i, j]
            for k in range(size):
                rows[i, first + j] += rows[i, k] * J[j, k]
    put_rows(P, first, n, rows)


@njit(**OPTIONS)
def move_block(P: FloatArray, source: int, target: int, n: int, rows: FloatArray) -> None:
    """The block at `source`, the last one in use, moved to `target`, which is empty; `n` counts both."""
    take_rows(P, source, n, rows)
    for i in range(3):
        for j in range(3):
            rows[i, target + j] = rows[i, source + j]
    put_rows(P, target, n - 3, rows)
