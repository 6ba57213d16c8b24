"""The linear algebra of one Kalman update, block by block, on the lower triangle of P.

All measurements of a stage are linearised at one state. Taking them a chunk at a time, the innovation of each chunk
corrected by H times the correction so far, gives exactly the estimate of one batch, and no factorisation larger than
a chunk. K, H and I - K H are never formed: with S = L L^T and X = L^-1 H P, P loses X^T X and the state gains
X^T L^-1 nu.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, lapack

from filters.engine import symmetric
from filters.validation import BoolArray, FloatArray, IntArray

CHUNK = 20  # landmarks: where the cost of the small factorisations meets that of passing over P again


@dataclass(frozen=True, eq=False)
class LinearisedMeasurements:
    """M measurements of k rows each, linear in the error state.

    Attributes
    ----------
    innovation : (M, k)
        Measured minus predicted, px.
    by_pose : (M, k, 6)
        H with respect to position and rotation (the first rows of the state).
    by_map : (M, k, w)
        H with respect to the landmark's own rows.
    map_rows : (M, w) int64
        Those rows.
    R : (M, k, k)
        Noise covariance.
    """

    innovation: FloatArray
    by_pose: FloatArray
    by_map: FloatArray
    map_rows: IntArray
    R: FloatArray

    def __len__(self) -> int:
        return len(self.innovation)

    def __getitem__(self, index: slice | IntArray | BoolArray) -> LinearisedMeasurements:
        return LinearisedMeasurements(
            self.innovation[index], self.by_pose[index], self.by_map[index], self.map_rows[index], self.R[index]
        )

    def times(self, delta: FloatArray) -> FloatArray:
        """H delta; (n,) -> (M, k)."""
        pose_part: FloatArray = self.by_pose @ delta[: self.by_pose.shape[2]]
        return pose_part + np.einsum("mkw,mw->mk", self.by_map, delta[self.map_rows])

    def innovation_covariances(self, P: FloatArray) -> FloatArray:
        """S = H P H^T + R of each measurement on its own (Eq. 15); (M, k, k)."""
        pose_rows = np.broadcast_to(np.arange(self.by_pose.shape[2]), (len(self), self.by_pose.shape[2]))
        rows = np.concatenate([pose_rows, self.map_rows], axis=1)
        H = np.concatenate([self.by_pose, self.by_map], axis=2)
        S: FloatArray = H @ symmetric.blocks(P, rows) @ H.transpose(0, 2, 1) + self.R
        return S


@dataclass(frozen=True, eq=False)
class Correction:
    """Result of an update: delta (n,) to retract, NIS, its degrees of freedom, and how many chunks had no Cholesky factor."""

    delta: FloatArray
    nis: float
    dof: int
    failed: int


def update(P: FloatArray, measurements: LinearisedMeasurements, chunk: int = CHUNK) -> Correction:
    """Correct with all measurements (Eq. 13-18); P (lower triangle, column-major) is updated in place.

    A chunk whose S has no Cholesky factor is left out and counted.
    """
    delta = np.zeros(len(P))
    nis, dof, failed = 0.0, 0, 0
    for start in range(0, len(measurements), chunk):
        part = measurements[start : start + chunk]
        count, size = part.innovation.shape
        HP = _times_covariance(part, P)
        factor, info = lapack.dpotrf(_innovation_covariance(part, HP), lower=1, clean=1, overwrite_a=1)
        if info != 0 or not np.isfinite(factor[-1, -1]):
            failed += 1
            continue
        nu = (part.innovation - part.times(delta)).ravel()
        Xt = blas.dtrsm(1.0, factor, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        whitened = blas.dtrsv(factor, nu, lower=1)
        delta += Xt @ whitened
        blas.dsyrk(-1.0, Xt, beta=1.0, c=P, lower=1, overwrite_c=1)
        nis += float(whitened @ whitened)
        dof += count * size
    return Correction(delta, nis, dof, failed)


def _times_covariance(part: LinearisedMeasurements, P: FloatArray) -> FloatArray:
    """H P, (M k, n), row-major."""
    count, size, width = part.by_map.shape
    pose = part.by_pose.shape[2]
    HP = part.by_pose.reshape(count * size, pose) @ symmetric.rows(P, np.arange(pose))
    if width:
        own = symmetric.rows(P, part.map_rows.ravel()).reshape(count, width, -1)
        HP += (part.by_map @ own).reshape(count * size, -1)
    return HP


def _innovation_covariance(part: LinearisedMeasurements, HP: FloatArray) -> FloatArray:
    """S = (H P) H^T + R of the whole chunk, (M k, M k)."""
    count, size, width = part.by_map.shape
    pose = part.by_pose.shape[2]
    S = HP[:, :pose] @ part.by_pose.reshape(count * size, pose).T
    if width:
        own = HP[:, part.map_rows.ravel()].reshape(-1, count, width).transpose(1, 0, 2)
        S += (own @ part.by_map.transpose(0, 2, 1)).transpose(1, 0, 2).reshape(S.shape)
    diagonal = np.arange(count)
    S.reshape(count, size, count, size)[diagonal, :, diagonal, :] += part.R
    return np.asfortranarray(S)
