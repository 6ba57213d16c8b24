"""The linear algebra of one Kalman update in B trials at once.

As in `filters.engine.kalman`: with S = L L^T and X = L^-1 H P, P loses X^T X and the state gains X^T L^-1 nu. Trials
measure different numbers of landmarks; the missing measurements have H = 0, nu = 0 and R = 1, which changes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import blas

from filters.engine import gating, kalman, symmetric
from filters.engine.kalman import LinearisedMeasurements
from filters.motion import CAMERA_SIZE
from filters.validation import BoolArray, FloatArray, IntArray

GROUP = 8  # trials whose matrices are worked on together
LITTLE = 0.7  # share of the places of a map below which only the measured ones are worked on


class Workspace:
    """Large arrays that serve frame after frame: memory fresh from the system would cost as much as the algebra."""

    def __init__(self) -> None:
        self._buffers: dict[str, FloatArray] = {}

    def array(self, name: str, *shape: int) -> FloatArray:
        """The array of that name, of this shape and with any content."""
        size = math.prod(shape)
        if name not in self._buffers or self._buffers[name].size < size:
            self._buffers[name] = np.empty(size + size // 4)
        return self._buffers[name][:size].reshape(shape)


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


def update(
    P: FloatArray,
    head: int,
    trial: IntArray,
    measurements: LinearisedMeasurements,
    limit: float | None,
    work: Workspace,
) -> Corrections:
    """Gate, then correct every trial with its measurements (Eq. 13-18); P (B, n, n) is updated in place.

    Parameters
    ----------
    P : (B, n, n)
        Covariances, both triangles.
    head : int
        Rows of camera and shared anchors; behind them are the landmarks' own, equally many each.
    trial : (N,) int64
        Trial of each measurement, ascending.
    measurements : LinearisedMeasurements
        N measurements of k rows, of the camera alone or of a landmark each.
    limit : float, optional
        Squared Mahalanobis distance up to which a measurement is believed (Eq. 15); None: all are.
    work : Workspace
        Keeps the large arrays for the next frame.
    """
    groups = []
    for first in range(0, len(P), GROUP):
        mine = slice(*np.searchsorted(trial, [first, first + GROUP]))
        covariances = P[first : first + GROUP]
        groups.append(_update_group(covariances, head, trial[mine] - first, measurements[mine], limit, work))
    parts = (np.concatenate(part) for part in zip(*(vars(group).values() for group in groups), strict=True))
    return Corrections(*parts)


def _update_group(
    P: FloatArray,
    head: int,
    trial: IntArray,
    measurements: LinearisedMeasurements,
    limit: float | None,
    work: Workspace,
) -> Corrections:
    """`update` of so few trials that their matrices stay in the processor's cache."""
    trials, n = P.shape[:2]
    count, size = measurements.innovation.shape
    passed = np.ones(count, dtype=bool)
    if count == 0:
        return Corrections(np.zeros((trials, n)), np.zeros(trials), np.zeros(trials, dtype=np.int64), passed, passed)
    seats = _Seats(trial, measurements.map_rows, P.shape, head)
    by_head, by_own = seats.jacobians(measurements)
    HP = work.array("HP", trials, seats.most * size, n)
    _fill_with_HP(HP, P, by_head, by_own, seats)
    nu = seats.filled(measurements.innovation).reshape(trials, -1, 1)
    S = work.array("S", trials, seats.most * size, seats.most * size)
    _fill_with_HPHt(S, HP, by_head, by_own, seats)
    every = np.arange(seats.most)
    blocks = S.reshape(trials, seats.most, size, seats.most, size)
    blocks[:, every, :, every, :] += seats.filled(measurements.R, np.eye(size)).swapaxes(0, 1)
    if limit is not None:
        own = blocks[trial, seats.number, :, seats.number, :]
        passed = gating.passes(measurements.innovation, own, limit)
        _leave_out(S, HP, nu, trial[~passed], seats.number[~passed, None] * size + np.arange(size))
    L, failed = _cholesky(S)
    # Whoever failed has its turn below.
    HP[failed], nu[failed], L[failed] = 0.0, 0.0, np.eye(L.shape[1])

    X, whitened = _solved(L, HP, nu)
    P -= np.matmul(X.swapaxes(1, 2), X, out=work.array("lost by P", trials, n, n))
    delta, nis = (X.swapaxes(1, 2) @ whitened)[:, :, 0], np.sum(whitened * whitened, axis=(1, 2))
    used = passed & ~failed[trial]
    for alone in np.flatnonzero(failed):
        mine = np.flatnonzero(passed & (trial == alone))
        lower = np.array(P[alone], order="F")
        correction = kalman.update(lower, measurements[mine])
        P[alone], delta[alone], nis[alone] = symmetric.full(lower), correction.delta, correction.nis
        used[mine] = correction.used
    return Corrections(delta, nis, size * np.bincount(trial[used], minlength=trials), passed, used)


class _Seats:
    """Where N measurements of B trials sit in arrays of equally many measurements a trial.

    Where most of the map is measured, a measurement sits where its landmark is, and the landmarks' rows of P are used
    where they are; where little of it is, measurements sit in a row, and their landmarks' rows are gathered.

    Attributes
    ----------
    trial, number : (N,) int64
        Trial of each measurement, and its seat.
    most : int
        Seats a trial, M.
    head : int
        Rows of camera and shared anchors, as of `update`.
    """

    def __init__(self, trial: IntArray, map_rows: IntArray, shape: tuple[int, ...], head: int) -> None:
        self.trials, n = shape[:2]
        self.trial, self.head, self._map_rows = trial, head, map_rows
        # Shared anchors come first in map_rows, and are in the head.
        self._shared = 3 if map_rows.shape[1] and head > CAMERA_SIZE else 0
        width = map_rows.shape[1] - self._shared
        counts = np.bincount(trial, minlength=self.trials)
        self.most = int(counts.max())
        self.number: IntArray = np.arange(len(trial)) - (np.cumsum(counts) - counts)[trial]
        self._gathered: IntArray | None = None
        if width == 0:
            return
        place, places = (map_rows[:, self._shared] - head) // width, (n - head) // width
        if self.most >= LITTLE * places:
            self.most, self.number = places, place
        else:
            self._gathered = self.filled(place)

    def filled(self, values: Any, empty: Any = 0) -> Any:
        """(N, ...) -> (B, M, ...), `empty` on seats without a measurement."""
        seated = np.empty((self.trials, self.most, *values.shape[1:]), dtype=values.dtype)
        if len(values) < self.trials * self.most:
            seated[...] = empty
        seated[self.trial, self.number] = values
        return seated

    def jacobians(self, measurements: LinearisedMeasurements) -> tuple[FloatArray, FloatArray]:
        """H by camera and shared anchors, dense, (B, M k, c), and by the landmark's own numbers, (B, M, k, w)."""
        by_camera, by_map = measurements.by_camera, measurements.by_map
        size, camera = by_camera.shape[1:]
        by_own = self.filled(by_map[:, :, self._shared :])
        if not self._shared:
            return self.filled(by_camera).reshape(self.trials, -1, camera), by_own
        by_head = np.zeros((self.trials, self.most, size, self.head))
        by_head[self.trial, self.number, :, :camera] = by_camera
        seat, anchor_rows = (self.trial[:, None], self.number[:, None]), self._map_rows[:, : self._shared]
        by_head[(*seat, slice(None), anchor_rows)] = by_map[:, :, : self._shared].swapaxes(1, 2)
        return by_head.reshape(self.trials, -1, self.head), by_own

    def of_landmarks(self, values: FloatArray) -> FloatArray:
        """What belongs to the landmark on each seat; (B, L, ...) -> (B, M, ...)."""
        return values if self._gathered is None else values[np.arange(self.trials)[:, None], self._gathered]


def _fill_with_HP(HP: FloatArray, P: FloatArray, by_head: FloatArray, by_own: FloatArray, seats: _Seats) -> None:
    """HP <- H P, (B, M k, n)."""
    trials, _, n = HP.shape
    head = by_head.shape[2]
    if by_own.shape[3] == 0:
        np.matmul(by_head, P[:, :head], out=HP)
        return
    own = seats.of_landmarks(P[:, seats.head :].reshape(trials, -1, by_own.shape[3], n))
    np.matmul(by_own, own, out=HP.reshape(trials, seats.most, -1, n))
    HP += by_head @ P[:, :head]


def _fill_with_HPHt(S: FloatArray, HP: FloatArray, by_head: FloatArray, by_own: FloatArray, seats: _Seats) -> None:
    """S <- H P H^T, (B, M k, M k)."""
    trials, rows, _ = HP.shape
    head = by_head.shape[2]
    if by_own.shape[3] == 0:
        np.matmul(HP[:, :, :head], by_head.swapaxes(1, 2), out=S)
        return
    own = seats.of_landmarks(HP[:, :, seats.head :].reshape(trials, rows, -1, by_own.shape[3]).swapaxes(1, 2))
    np.matmul(own, by_own.swapaxes(2, 3), out=S.reshape(trials, rows, seats.most, -1).swapaxes(1, 2))
    S += HP[:, :, :head] @ by_head.swapaxes(1, 2)


def _leave_out(S: FloatArray, HP: FloatArray, nu: FloatArray, trial: IntArray, rows: IntArray) -> None:
    """Make measurements with these trials (K,) and rows (K, k) change nothing."""
    trial = trial[:, None]
    HP[trial, rows] = 0.0
    nu[trial, rows] = 0.0
    S[trial, rows] = 0.0
    S[trial, :, rows] = 0.0
    S[trial, rows, rows] = 1.0


def _cholesky(S: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Lower factors, and the trials that have none; (B, m, m) -> (B, m, m), (B,)."""
    try:
        L = np.asarray(np.linalg.cholesky(S), dtype=np.float64)
    except np.linalg.LinAlgError:
        definite = np.array([_is_definite(s) for s in S])
        return np.linalg.cholesky(np.where(definite[:, None, None], S, np.eye(S.shape[1]))), ~definite
    has_none: BoolArray = ~np.isfinite(L[:, -1, -1])
    return L, has_none


def _is_definite(S: FloatArray) -> bool:
    try:
        return bool(np.isfinite(np.linalg.cholesky(S)[-1:, -1:]).all())
    except np.linalg.LinAlgError:
        return False


def _solved(L: FloatArray, HP: FloatArray, nu: FloatArray) -> tuple[FloatArray, FloatArray]:
    """L^-1 HP, in place, and L^-1 nu; (B, m, m), (B, m, n), (B, m, 1).

    NumPy has no triangular solve of many matrices: the one step with a call of BLAS for each trial. Transposed, our
    row-major matrices are what BLAS wants: X^T L^T = (H P)^T.
    """
    for factor, rows, column in zip(L, HP, nu, strict=True):
        blas.dtrsm(1.0, factor.T, rows.T, side=1, overwrite_b=1)
        blas.dtrsm(1.0, factor.T, column.T, side=1, overwrite_b=1)
    return HP, nu
