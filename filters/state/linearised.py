"""Measurements linear in the error state: what the Kalman update works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class LinearisedMeasurements:
    """M measurements of k rows each, linear in the error state."""

    innovation: FloatArray
    """(M, k): measured minus predicted, px."""
    by_leading: FloatArray
    """(M, k, c): H with respect to the first c rows of the state: pose and what else measurements depend on."""
    by_map: FloatArray
    """(M, k, w): H with respect to the landmark's own rows."""
    map_rows: IntArray
    """(M, w): those rows."""
    R: FloatArray
    """(M, k, k): noise covariance."""

    def __len__(self) -> int:
        return len(self.innovation)

    def __getitem__(self, index: slice | IntArray | BoolArray) -> LinearisedMeasurements:
        return LinearisedMeasurements(
            self.innovation[index],
            self.by_leading[index],
            self.by_map[index],
            self.map_rows[index],
            self.R[index],
        )

    def times(self, delta: FloatArray) -> FloatArray:
        """H delta; (n,) -> (M, k)."""
        product: FloatArray = self.by_leading @ delta[: self.by_leading.shape[2]]
        product += np.einsum("mkw,mw->mk", self.by_map, delta[self.map_rows])
        return product

    def innovation_covariances(self, P: FloatArray) -> FloatArray:
        """S = H P H^T + R of each measurement on its own (Eq. 15); (M, k, k)."""
        leading_rows = np.broadcast_to(np.arange(self.by_leading.shape[2]), (len(self), self.by_leading.shape[2]))
        rows = np.concatenate([leading_rows, self.map_rows], axis=1)
        H = np.concatenate([self.by_leading, self.by_map], axis=2)
        S: FloatArray = H @ symmetric.blocks(P, rows) @ H.transpose(0, 2, 1) + self.R
        return S
