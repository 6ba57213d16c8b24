"""The kernel that reads maps as their cameras see them: positions and covariances relative to the camera."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from filters.engine.compiled.blas import ENTRY
from filters.engine.compiled.disk_cache import KEPT
from filters.engine.compiled.prediction import orientation, times, transposed
from filters.engine.compiled.storage import LANDMARKS
from filters.validation import BoolArray, FloatArray, IntArray


@njit(**KEPT, **ENTRY)
def relative_landmarks(
    P: FloatArray,
    x: FloatArray,
    blocks: FloatArray,
    own: IntArray,
    anchor: IntArray,
    counts: IntArray,
    leading: int,
    anchored: bool,
    offsets: IntArray,
    points_c: FloatArray,
    covariances: FloatArray,
    located: BoolArray,
) -> None:
    """p_c = R_wc^T (p_w - r) of the landmarks of all filters, and its covariance; the last three are written.

    `located`: in front of the anchor, at a finite distance, with a finite covariance.
    """
    J, own_P, JP = np.empty((3, 12)), np.empty((12, 12)), np.empty((3, 12))
    rows = np.empty(12, dtype=np.int64)
    rows[:6] = np.arange(6)
    for b in range(len(x)):
        R = orientation(x[b])
        R_cw = transposed(R)
        P_b, size = P[b], 12 if anchored else 9
        for i in range(counts[b, LANDMARKS]):
            m, place, block = offsets[b] + i, own[b, i], blocks[b, own[b, i]]
            rows[6:9] = leading + 3 * place + np.arange(3)
            w0, w1, w2 = block[0] - x[b, 0], block[1] - x[b, 1], block[2] - x[b, 2]
            ahead = True
            if anchored:
                theta, phi, rho = block[0], block[1], block[2]
                first = blocks[b, anchor[b, i]]
                rows[9:12] = leading + 3 * anchor[b, i] + np.arange(3)
                sin_theta, cos_theta, sin_phi, cos_phi = (
                    math.sin(theta),
                    math.cos(theta),
                    math.sin(phi),
                    math.cos(phi),
                )
                z, ahead = 1.0 / rho, rho > 0.0
                d0, d1, d2 = z * cos_phi * sin_theta, -z * sin_phi, z * cos_phi * cos_theta
                w0, w1, w2 = first[0] + d0 - x[b, 0], first[1] + d1 - x[b, 1], first[2] + d2 - x[b, 2]
                # columns: theta, phi, rho
                J[0, 6], J[1, 6], J[2, 6] = times(R_cw, d2, 0.0, -d0)
                J[0, 7], J[1, 7], J[2, 7] = times(
                    R_cw, -z * sin_phi * sin_theta, -z * cos_phi, -z * sin_phi * cos_theta
                )
                J[0, 8], J[1, 8], J[2, 8] = times(R_cw, -z * d0, -z * d1, -z * d2)
            c0, c1, c2 = times(R_cw, w0, w1, w2)
            points_c[m, 0], points_c[m, 1], points_c[m, 2] = c0, c1, c2
            for a in range(3):
                for k in range(3):
                    J[a, k] = -R_cw[3 * a + k]
                    J[a, size - 3 + k] = R_cw[3 * a + k]
            J[0, 3], J[0, 4], J[0, 5] = 0.0, -c2, c1
            J[1, 3], J[1, 4], J[1, 5] = c2, 0.0, -c0
            J[2, 3], J[2, 4], J[2, 5] = -c1, c0, 0.0
            for k in range(size):
                for q in range(k, size):
                    p = P_b[min(rows[k], rows[q]), max(rows[k], rows[q])]
                    own_P[k, q], own_P[q, k] = p, p
            for a in range(3):
                for q in range(size):
                    total = 0.0
                    for k in range(size):
                        total += J[a, k] * own_P[k, q]
                    JP[a, q] = total
            finite = math.isfinite(c0) and math.isfinite(c1) and math.isfinite(c2)
            for a in range(3):
                for q in range(3):
                    total = 0.0
                    for k in range(size):
                        total += JP[a, k] * J[q, k]
                    covariances[m, a, q] = total
                    finite = finite and math.isfinite(total)
            located[m] = ahead and finite
