"""Kernel of a whole stage of the update: linearisation, gate, correction of P."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types

from filters.engine.gating import BEHIND, FAILED, GATED, USED
from filters.engine.kernels.blas import ADDRESSES, ROUTINES
from filters.engine.kernels.gating import squared_distances
from filters.engine.kernels.kalman import correct_by
from filters.engine.kernels.linearisation import linearise
from filters.engine.kernels.signatures import ANY_MATRICES, ANY_MATRIX, COVARIANCE, FIXED, FLOATS, SEEN
from filters.validation import BoolArray, FloatArray, IntArray


@njit(**FLOATS)
def _keep(
    chosen: BoolArray,
    place: IntArray,
    innovation: FloatArray,
    by_camera: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
) -> int:
    """Move the chosen measurements to the front, in place; their number."""
    kept = 0
    if chosen.all():
        return len(chosen)
    for m in range(len(chosen)):
        if chosen[m]:
            place[kept] = place[m]
            for c in range(map_rows.shape[1]):
                map_rows[kept, c] = map_rows[m, c]
            for a in range(innovation.shape[1]):
                innovation[kept, a] = innovation[m, a]
                for b in range(R.shape[2]):
                    R[kept, a, b] = R[m, a, b]
                for c in range(by_camera.shape[2]):
                    by_camera[kept, a, c] = by_camera[m, a, c]
                for c in range(by_map.shape[2]):
                    by_map[kept, a, c] = by_map[m, a, c]
            kept += 1
    return kept


@njit(
    types.Tuple((types.float64[::1], types.float64, types.int64))(
        ADDRESSES,
        COVARIANCE,
        *SEEN,
        ANY_MATRIX,
        ANY_MATRIX,
        ANY_MATRICES,
        types.float64,
        types.int64,
        types.uint8[::1],
    ),
    **FIXED,
)
def _stage(
    routines: tuple[int, ...],
    P: FloatArray,
    camera: tuple[float, float, float, float, float],
    position: FloatArray,
    orientation: FloatArray,
    blocks: FloatArray,
    anchors: IntArray,
    parameters: IntArray,
    width: int,
    index: IntArray,
    T: FloatArray,
    z: FloatArray,
    noise: FloatArray,
    limit: float,
    chunk: int,
    fates: IntArray,
) -> tuple[FloatArray, float, int]:
    """`StereoEKF._correct_stage` without its options: linearise, gate, update; delta, the NIS and its dof."""
    place, seen = np.empty(len(index), np.int64), np.empty(len(index), np.int64)
    count = 0
    for i in range(len(index)):
        if fates[i] == USED:
            place[count], seen[count] = i, index[i]
            count += 1
    innovation, by_camera, by_map, map_rows, chosen = linearise(
        camera, position, orientation, blocks, anchors, parameters, width, seen[:count], T
    )
    R = np.empty((count, len(T), len(T)))
    for i in range(count):
        for a in range(len(T)):
            innovation[i, a] = z[place[i], a] - innovation[i, a]
            for b in range(len(T)):
                R[i, a, b] = noise[place[i], a, b]
        if not chosen[i]:
            fates[place[i]] = BEHIND
    count = _keep(chosen, place, innovation, by_camera, by_map, map_rows, R)
    if limit < np.inf:
        distances = squared_distances(
            P, innovation[:count], by_camera[:count], by_map[:count], map_rows[:count], R[:count]
        )
        for i in range(count):
            chosen[i] = distances[i] <= limit
            if not chosen[i]:
                fates[place[i]] = GATED
        count = _keep(chosen[:count], place, innovation, by_camera, by_map, map_rows, R)
    delta, nis, used = correct_by(
        routines, P, innovation[:count], by_camera[:count], by_map[:count], map_rows[:count], R[:count], chunk
    )
    dof = 0
    for i in range(count):
        if used[i]:
            dof += len(T)
        else:
            fates[place[i]] = FAILED
    return delta, nis, dof


def correct_stage(P: FloatArray, *stage: Any) -> tuple[FloatArray, float, int]:
    """`StereoEKF._correct_stage` without its options; delta (n,), the NIS and its degrees of freedom."""
    corrected: tuple[FloatArray, float, int] = _stage(ROUTINES, P, *stage)
    return corrected
