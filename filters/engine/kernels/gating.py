"""Kernels of `engine.gating`: squared Mahalanobis distances of innovations."""

from __future__ import annotations

import numpy as np
from numba import njit, types

from filters.engine.kernels.signatures import COVARIANCE, FIXED, MEASURED
from filters.validation import FloatArray, IntArray


@njit(types.float64[::1](COVARIANCE, *MEASURED), **FIXED)
def squared_distances(
    P: FloatArray, innovation: FloatArray, by_camera: FloatArray, by_map: FloatArray, map_rows: IntArray, R: FloatArray
) -> FloatArray:
    """`kalman.squared_distances`: nu^T S^-1 nu of each measurement on its own, by S = L D L^T; (M,)."""
    count, size, width = by_map.shape
    camera = by_camera.shape[2]
    total = camera + width
    rows, covariance = np.arange(total), np.empty((total, total))
    H, HP, S, solved = np.empty((size, total)), np.empty(total), np.empty((size, size)), np.empty(size)
    distances = np.zeros(count)
    for i in range(camera):
        for j in range(i + 1):
            covariance[i, j] = covariance[j, i] = P[i, j]
    for m in range(count):
        for c in range(width):
            rows[camera + c] = map_rows[m, c]
        for i in range(camera, total):
            for j in range(i + 1):
                covariance[i, j] = covariance[j, i] = P[max(rows[i], rows[j]), min(rows[i], rows[j])]
        for a in range(size):
            for c in range(camera):
                H[a, c] = by_camera[m, a, c]
            for c in range(width):
                H[a, camera + c] = by_map[m, a, c]
            for j in range(total):
                HP[j] = H[a, 0] * covariance[0, j]
            for i in range(1, total):
                for j in range(total):
                    HP[j] += H[a, i] * covariance[i, j]
            for b in range(a + 1):
                S[a, b] = R[m, a, b]
                for c in range(total):
                    S[a, b] += HP[c] * H[b, c]
        for a in range(size):
            solved[a] = innovation[m, a]
            for b in range(a):
                solved[a] -= S[a, b] / S[b, b] * solved[b]
                for c in range(a, size):
                    S[c, a] -= S[c, b] * S[a, b] / S[b, b]
            distances[m] += solved[a] ** 2 / S[a, a]
    return distances
