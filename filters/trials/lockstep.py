"""The linear algebra of one Kalman update in B trials at once.

As in `filters.engine.kalman`: with S = L L^T and X = L^-1 H P, P loses X^T X and the state gains X^T L^-1 nu. Trials
measure different numbers of landmarks; the missing measurements have H = 0, nu = 0 and R = 1, which changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.engine import gating, kalman, symmetric
from filters.engine.kalman import LinearisedMeasurements
from filters.validation import BoolArray, FloatArray, IntArray

WIDTH = 12  # rows of a triangular solve taken at once


@dataclass(frozen=True, eq=False)
class Corrections:
    """Result of an update of B trials with N measurements.

    Attributes
    ----------
    delta : (B, n)
        Corrections of the error states, to be retracted.
    nis, dof : (B,)
        Normalised innovation squared and its degrees of freedom.
    passed, used : (N,) bool
        Measurements that passed the gate, and those of them that took part; the rest had an innovation covariance
        without a Cholesky factor.
    """

    delta: FloatArray
    nis: FloatArray
    dof: IntArray
    passed: BoolArray
    used: BoolArray


def update(P: FloatArray, trial: IntArray, measurements: LinearisedMeasurements, limit: float | None) -> Corrections:
    """Gate, then correct every trial with its measurements (Eq. 13-18); P (B, n, n) is updated in place.

    Parameters
    ----------
    P : (B, n, n)
        Covariances, both triangles.
    trial : (N,) int64
        Trial of each measurement, ascending.
    measurements : LinearisedMeasurements
        N measurements of k rows.
    limit : float, optional
        Squared Mahalanobis distance up to which a measurement is believed (Eq. 15); None: all are.
    """
    trials, n = P.shape[:2]
    count, size = measurements.innovation.shape
    padded = _Padding(trial, trials)
    Y = np.zeros((trials, padded.most * size, n + 1))
    HP = _times_covariance(P, padded, measurements)
    S = _innovation_covariance(HP, padded, measurements)
    Y[:, :, :n] = HP
    Y.reshape(-1, size, n + 1)[padded.index, :, n] = measurements.innovation

    passed = np.ones(count, dtype=bool)
    if limit is not None:
        number = np.arange(padded.most)
        own = S.reshape(trials, padded.most, size, padded.most, size)[:, number, :, number, :]
        passed = gating.passes(measurements.innovation, own[padded.number, trial], limit)
        _leave_out(S, Y, trial[~passed], padded.number[~passed, None] * size + np.arange(size))
    L, failed = _cholesky(S)
    # Whoever failed has its turn below.
    Y[failed], L[failed] = 0.0, np.eye(L.shape[1])

    _solve_lower(L, Y)
    # Its last column is the whitened innovation: the product holds X^T X, X^T L^-1 nu and the NIS.
    product = Y.swapaxes(1, 2) @ Y
    P -= product[:, :n, :n]
    delta, nis = product[:, :n, n].copy(), product[:, n, n].copy()
    used = passed & ~failed[trial]
    for alone in np.flatnonzero(failed):
        mine = np.flatnonzero(passed & (trial == alone))
        lower = np.array(P[alone], order="F")
        correction = kalman.update(lower, measurements[mine])
        P[alone], delta[alone], nis[alone] = symmetric.full(lower), correction.delta, correction.nis
        used[mine] = correction.used
    return Corrections(delta, nis, size * np.bincount(trial[used], minlength=trials), passed, used)


class _Padding:
    """Where N measurements of B trials go in arrays of equally many measurements a trial.

    Attributes
    ----------
    trial, number : (N,) int64
        Trial of each measurement, and which of that trial's it is.
    most : int
        Measurements a trial, M.
    index : (N,) int64
        Place in the flattened array of B M measurements.
    """

    def __init__(self, trial: IntArray, trials: int) -> None:
        counts = np.bincount(trial, minlength=trials)
        self.trials, self.most = trials, int(counts.max(initial=0))
        self.number: IntArray = np.arange(len(trial)) - (np.cumsum(counts) - counts)[trial]
        self.index: IntArray = trial * self.most + self.number
        self.full = len(trial) == trials * self.most

    def __call__(self, values: FloatArray) -> FloatArray:
        """(N, ...) -> (B M, ...), zero where there is no measurement."""
        if self.full:
            return values
        spread = np.zeros((self.trials * self.most, *values.shape[1:]), dtype=values.dtype)
        spread[self.index] = values
        return spread


def _times_covariance(P: FloatArray, padded: _Padding, measurements: LinearisedMeasurements) -> FloatArray:
    """H P, (B, M k, n)."""
    trials, n = P.shape[:2]
    by_camera = padded(measurements.by_camera)
    rows, camera = by_camera.shape[1] * padded.most, by_camera.shape[2]
    HP: FloatArray = by_camera.reshape(trials, rows, camera) @ P[:, :camera]
    if measurements.map_rows.shape[1]:
        own = P.reshape(-1, n).take(_flat_rows(padded, measurements, n), axis=0)
        HP += (padded(measurements.by_map) @ own).reshape(HP.shape)
    return HP


def _innovation_covariance(HP: FloatArray, padded: _Padding, measurements: LinearisedMeasurements) -> FloatArray:
    """S = H P H^T + R, (B, M k, M k); R = 1 where there is no measurement."""
    trials, rows, n = HP.shape
    size, most = measurements.innovation.shape[1], padded.most
    PHt = np.ascontiguousarray(HP.swapaxes(1, 2))
    by_camera = padded(measurements.by_camera)
    S: FloatArray = by_camera.reshape(trials, rows, -1) @ PHt[:, : by_camera.shape[2]]
    if measurements.map_rows.shape[1]:
        own = PHt.reshape(-1, rows).take(_flat_rows(padded, measurements, n), axis=0)
        S += (padded(measurements.by_map) @ own).reshape(S.shape)
    noise = np.empty((trials * most, size, size))
    noise[...] = np.eye(size)
    noise[padded.index] = measurements.R
    number = np.arange(most)
    S.reshape(trials, most, size, most, size)[:, number, :, number, :] += noise.reshape(
        trials, most, size, size
    ).swapaxes(0, 1)
    return S


def _flat_rows(padded: _Padding, measurements: LinearisedMeasurements, n: int) -> IntArray:
    """The landmarks' own rows among the B n rows of all trials, (B M, w)."""
    first = n * np.repeat(np.arange(padded.trials), padded.most)
    rows: IntArray = padded(measurements.map_rows) + first[:, None]
    return rows


def _leave_out(S: FloatArray, Y: FloatArray, trial: IntArray, rows: IntArray) -> None:
    """Make measurements with these trials (K,) and rows (K, k) change nothing."""
    trial = trial[:, None]
    Y[trial, rows] = 0.0
    S[trial, rows] = 0.0
    S[trial, :, rows] = 0.0
    S[trial, rows, rows] = 1.0


def _cholesky(S: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Lower factors, and the trials that have none; (B, m, m) -> (B, m, m), (B,)."""
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        definite = np.array([_is_definite(s) for s in S])
        L = np.linalg.cholesky(np.where(definite[:, None, None], S, np.eye(S.shape[1])))
        return L, ~definite
    return L, ~np.isfinite(L[:, -1:, -1:]).all(axis=(1, 2))


def _is_definite(S: FloatArray) -> bool:
    try:
        return bool(np.isfinite(np.linalg.cholesky(S)[-1:, -1:]).all())
    except np.linalg.LinAlgError:
        return False


def _solve_lower(L: FloatArray, Y: FloatArray) -> None:
    """Y <- L^-1 Y, block by block; (B, m, m), (B, m, c). NumPy has no triangular solve of many matrices."""
    for start in range(0, L.shape[1], WIDTH):
        now = slice(start, start + WIDTH)
        if start:
            Y[:, now] -= L[:, now, :start] @ Y[:, :start]
        Y[:, now] = np.linalg.inv(L[:, now, now]) @ Y[:, now]
