"""Uncertainty ellipses and ellipsoids of covariances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from filters.geometry.arrays import BoolArray, FloatArray

SIGMAS = 3.0
"""Size of the ellipses and ellipsoids."""
LARGEST = 25.0
"""Half axis, m: what is less certain is drawn as a point alone, for its ellipse would hide everything else."""


class Ellipsoids(NamedTuple):
    """Ellipsoids of N covariances at `SIGMAS` standard deviations: half axes (N, n), m, and their directions (N, n, n).

    The directions are columns, a right-handed rotation. `drawn` (N,) says whether to draw it: the covariance is finite
    and positive semi-definite, no half axis above `LARGEST`.
    """

    half_sizes: FloatArray
    axes: FloatArray
    drawn: BoolArray

    @property
    def quaternions(self) -> FloatArray:
        """The directions in three dimensions, xyzw; (N, 4)."""
        if len(self.axes) == 0:
            return np.zeros((0, 4))
        return np.asarray(Rotation.from_matrix(self.axes).as_quat(), dtype=np.float64)


def ellipsoids(covariances: FloatArray) -> Ellipsoids:
    """Principal axes of covariances; (N, n, n) m^2, n of 2 or 3."""
    count, size = covariances.shape[:2]
    known = np.asarray(np.isfinite(covariances).all(axis=(1, 2)), dtype=np.bool_)
    values, axes = np.zeros((count, size)), np.tile(np.eye(size), (count, 1, 1))
    values[known], axes[known] = np.linalg.eigh(covariances[known])
    axes[..., 0] *= np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None]
    half_sizes = SIGMAS * np.sqrt(np.maximum(values, 0.0))
    definite = values[:, 0] >= -1e-9 * np.abs(values[:, -1])  # but for rounding
    return Ellipsoids(half_sizes, axes, known & definite & (half_sizes[:, -1] <= LARGEST))
