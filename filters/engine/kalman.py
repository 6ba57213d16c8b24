"""The linear algebra of one Kalman update, block by block, on the lower triangle of P.

All measurements of a stage are linearised at one state. Taking them a chunk at a time, the innovation of each chunk
corrected by H times the correction so far, gives exactly the estimate of one batch, and no factorisation larger than
a chunk. K, H and I - K H are never formed: with S = L L^T and X = L^-1 H P, P loses X^T X and the state gains
X^T L^-1 nu.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import blas, lapack

from filters.engine import gating
from filters.state import symmetric
from filters.state.linearised import LinearisedMeasurements
from filters.validation import BoolArray, FloatArray, IntArray

CHUNK_ROWS = 75  # where the cost of the small factorisations meets that of passing over P again
DROWNED = 1e12
"""S over R from which on rounding (1e-16 of S) leaves too little of R: a landmark as good as in the image plane."""


def squared_distances(P: FloatArray, measurements: LinearisedMeasurements) -> FloatArray:
    """Squared Mahalanobis distance of each innovation on its own; (M,)."""
    return gating.squared_distances(measurements.innovation, measurements.innovation_covariances(P))


@dataclass(frozen=True, eq=False)
class Correction:
    """Result of an update.

    Attributes
    ----------
    delta : (n,)
        Correction of the error state, to be retracted.
    nis, dof : float, int
        Normalised innovation squared and its degrees of freedom.
    used : (M,) bool
        Measurements that took part; the others had an innovation covariance without a Cholesky factor, or R drowned.
    """

    delta: FloatArray
    nis: float
    dof: int
    used: BoolArray


def update(
    P: FloatArray,
    measurements: LinearisedMeasurements,
    considered: IntArray | None = None,
    chunk: int | None = None,
) -> Correction:
    """Correct with all measurements (Eq. 13-18), `chunk` at a time; P (lower triangle, column-major) changes in place.

    A chunk whose S has no Cholesky factor, or in which R is `DROWNED`, is taken apart, and the measurements of which
    that is true are left out. Rows that are `considered` keep their value and their covariance (Schmidt): the gain of
    all other rows is the same as without them, so it is enough to put back what they were.
    """
    if considered is not None and len(considered):
        square = np.ix_(considered, considered)
        before = P[square]
        correction = update(P, measurements, None, chunk)
        P[square] = before
        correction.delta[considered] = 0.0
        return correction
    delta = np.zeros(len(P))
    used = np.zeros(len(measurements), dtype=bool)
    nis, dof = 0.0, 0
    chunk = chunk or max(1, CHUNK_ROWS // measurements.innovation.shape[1])
    chunks = -(-len(measurements) // chunk)
    edges = [len(measurements) * i // chunks for i in range(chunks + 1)] if chunks else []
    pending = [slice(*ends) for ends in pairwise(edges)][::-1]
    while pending:
        where = pending.pop()
        part = measurements[where]
        HP = times_covariance(part, P)
        S = _innovation_covariance(part, HP)
        drowned = _drowns(part, S)
        factor, info = lapack.dpotrf(S, lower=1, clean=0, overwrite_a=1)
        if drowned or info != 0 or not math.isfinite(factor[-1, -1]):
            if where.stop - where.start > 1:
                pending += [slice(i, i + 1) for i in range(where.start, where.stop)][::-1]
            continue
        nu = (part.innovation - part.times(delta)).ravel()
        Xt = blas.dtrsm(1.0, factor, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        whitened = blas.dtrsv(factor, nu, lower=1, overwrite_x=1)
        delta += Xt @ whitened
        blas.dsyrk(-1.0, Xt, beta=1.0, c=P, lower=1, overwrite_c=1)
        nis += float(whitened @ whitened)
        dof += nu.size
        used[where] = True
    return Correction(delta, nis, dof, used)


def joint_innovation_covariance(P: FloatArray, measurements: LinearisedMeasurements) -> FloatArray:
    """S = H P H^T + R of all measurements together; (M, k, M, k)."""
    S = _innovation_covariance(measurements, times_covariance(measurements, P))
    return S.reshape(*measurements.innovation.shape, *measurements.innovation.shape)


def times_covariance(part: LinearisedMeasurements, P: FloatArray) -> FloatArray:
    """H P, (M k, n), row-major."""
    count, size, width = part.by_map.shape
    camera = part.by_leading.shape[2]
    HP = part.by_leading.reshape(count * size, camera) @ symmetric.leading_rows(P, camera)
    if width:
        own = symmetric.rows(P, part.map_rows.ravel()).reshape(count, width, len(P))
        HP += (part.by_map @ own).reshape(HP.shape)
    return HP


def _drowns(part: LinearisedMeasurements, S: FloatArray) -> bool:
    """Whether R is lost in some S of a landmark; odometry may be exact."""
    R = np.diagonal(part.R, axis1=1, axis2=2).ravel()
    return part.by_map.shape[2] > 0 and bool((np.diagonal(S) > DROWNED * R).any())


def _innovation_covariance(part: LinearisedMeasurements, HP: FloatArray) -> FloatArray:
    """S = (H P) H^T + R of the whole chunk, (M k, M k)."""
    count, size, width = part.by_map.shape
    camera = part.by_leading.shape[2]
    S = HP[:, :camera] @ part.by_leading.reshape(count * size, camera).T
    if width:
        own = HP[:, part.map_rows.ravel()].reshape(count * size, count, width).transpose(1, 0, 2)
        S += (own @ part.by_map.transpose(0, 2, 1)).transpose(1, 0, 2).reshape(S.shape)
    diagonal = np.arange(count)
    S.reshape(count, size, count, size)[diagonal, :, diagonal, :] += part.R
    return np.asfortranarray(S)
