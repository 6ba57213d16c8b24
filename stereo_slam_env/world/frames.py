"""Coordinate frames of the simulated world, S and W, and the only place that changes between them.

S, the scene frame: x forward at the start, y left, z up, origin on the ground below the first camera.
W, the world frame of filters and truth: the left camera at reset (x right, y down, z forward).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from filters.geometry.arrays import FloatArray

R_SW: FloatArray = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Takes vectors of W into S: right is -y, down is -z, forward is +x."""
R_SW.flags.writeable = False


@dataclass(frozen=True)
class WorldFrame:
    """Pose of W in S, by the height of the first camera above the ground, m."""

    camera_height: float

    def to_scene(self, points_w: ArrayLike) -> FloatArray:
        """Points of W in S; (..., 3) m -> (..., 3) m."""
        points: FloatArray = np.asarray(points_w, dtype=np.float64) @ R_SW.T + [0.0, 0.0, self.camera_height]
        return points

    def to_world(self, points_s: ArrayLike) -> FloatArray:
        """Points of S in W; (..., 3) m -> (..., 3) m."""
        points: FloatArray = (np.asarray(points_s, dtype=np.float64) - [0.0, 0.0, self.camera_height]) @ R_SW
        return points

    def rotation_to_scene(self, R_wc: ArrayLike) -> FloatArray:
        """R_sc of a camera whose rotation in W is `R_wc`; (3, 3) -> (3, 3)."""
        return R_SW @ np.asarray(R_wc, dtype=np.float64)
