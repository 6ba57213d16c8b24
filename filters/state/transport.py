"""Transport of the covariance: the Jacobian that takes errors at a state to errors at the corrected one.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import blas

from filters.motions.model import ROTATION
from filters.state import symmetric
from filters.state.linearised import LinearisedMeasurements
from filters.validation import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Transport:
    """Block lower triangular Jacobian of the error state.

    Attributes
    ----------
    leading : (c, c)
        Of the named variables.
    by_rotation : (n - c, 3), optional
        Of the map rows by the rotation error of the camera. None: zero.
    rows, own : (m, 3) int64, (m, 3, 3), optional
        Of some blocks of rows by themselves. None: the identity, as of all other rows.
    """

    leading: FloatArray
    by_rotation: FloatArray | None = None
    rows: IntArray | None = None
    own: FloatArray | None = None

    def apply(self, P: FloatArray) -> None:
        """P <- J P J^T, lower triangle, in place."""
        size = len(self.leading)
        if self.own is not None and self.rows is not None:
            rows = self.rows.ravel()
            moved = (self.own @ symmetric.rows(P, rows).reshape(*self.rows.shape, len(P))).reshape(len(rows), len(P))
            crossed = self.own @ moved[:, self.rows].transpose(1, 2, 0)
            moved[:, rows] = crossed.reshape(-1, len(rows)).T
            symmetric.put_rows(P, rows, moved)
        symmetric.transform_leading(P, self.leading, np.zeros_like(self.leading))
        if self.by_rotation is not None:
            # The rotation error is that at the corrected state by now.
            W = np.zeros((len(P), 3), order="F")
            W[size:] = np.linalg.solve(self.leading[ROTATION, ROTATION].T, self.by_rotation.T).T
            rotation = symmetric.rows(P, np.arange(ROTATION.start, ROTATION.stop))
            half = rotation.T + 0.5 * W @ rotation[:, ROTATION].T
            blas.dsyr2k(1.0, W, np.asfortranarray(half), beta=1.0, c=P, lower=1, overwrite_c=1)

    def pulled_back(self, measurements: LinearisedMeasurements, delta: FloatArray) -> LinearisedMeasurements:
        """The same measurements, linear in the errors of an earlier state that `delta` has moved here.

        The innovation gets back what the correction has already explained: a Gauss-Newton step with the prior held.
        """
        size, width = len(self.leading), measurements.by_leading.shape[2]
        by_leading = measurements.by_leading @ self.leading[:width, :width]
        by_map = measurements.by_map
        if self.by_rotation is not None:
            by_leading[:, :, ROTATION] += by_map @ self.by_rotation[measurements.map_rows - size]
        if self.own is not None and self.rows is not None:
            place = np.full((len(delta) - size) // 3, -1)
            place[(self.rows[:, 0] - size) // 3] = np.arange(len(self.rows))
            blocks = place[(measurements.map_rows[:, ::3] - size) // 3]
            J = np.where((blocks < 0)[:, :, None, None], np.eye(3), self.own[blocks])
            shape = by_map.shape
            by_map = np.einsum("mkbi,mbij->mkbj", by_map.reshape(*shape[:2], shape[2] // 3, 3), J).reshape(shape)
        earlier = replace(measurements, by_leading=by_leading, by_map=by_map)
        return replace(earlier, innovation=measurements.innovation + earlier.times(delta))
