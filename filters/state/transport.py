"""Transport of the covariance: the Jacobian that takes errors at a state to errors at the corrected one.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.model import ROTATION
from filters.state.linearised import LinearisedMeasurements


@dataclass(frozen=True, eq=False)
class Transport:
    """Block lower triangular Jacobian of the error state."""

    leading: FloatArray
    """(c, c), of the named variables."""
    by_rotation: FloatArray | None = None
    """(n - c, 3), of the map rows by the rotation error of the camera. None: zero."""
    rows: IntArray | None = None
    """(m, s): rows of the blocks that have a Jacobian of their own. None: there are none."""
    own: FloatArray | None = None
    """(m, s, s), of those blocks by themselves; that of all other rows is the identity."""

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
            block, count = self.rows.shape[1], by_map.shape[2]
            place = np.full((len(delta) - size) // block, -1)
            place[(self.rows[:, 0] - size) // block] = np.arange(len(self.rows))
            parts = []
            for start in (*range(0, count - block, 3), count - block):  # of anchors, and its own
                columns = slice(start, start + 3 if start < count - block else count)
                width = columns.stop - start
                which = place[(measurements.map_rows[:, start] - size) // block]
                J = np.where((which < 0)[:, None, None], np.eye(block), self.own[which])[:, :width, :width]
                parts.append(by_map[:, :, columns] @ J)
            by_map = np.concatenate(parts, axis=2)
        earlier = replace(measurements, by_leading=by_leading, by_map=by_map)
        return replace(earlier, innovation=measurements.innovation + earlier.times(delta))
