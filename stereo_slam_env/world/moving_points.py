"""Which points of the scene are on bodies that move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filters.validation import BoolArray, FloatArray
from stereo_slam_env.world.meshes import body_meshes
from stereo_slam_env.world.scene import MovingBody

_SKIN = 0.15
"""Points this far outside of the box around a body still count as on it, m."""


class MovingPoints:
    """Tells points on moving bodies, by the boxes around them.

    Parameters
    ----------
    bodies : sequence of MovingBody
        Of a scene.
    """

    def __init__(self, bodies: Sequence[MovingBody]) -> None:
        self._bodies = tuple(bodies)
        corners = [np.concatenate([mesh.vertices for mesh in body_meshes(body).values()]) for body in self._bodies]
        self._boxes = [(vertices.min(axis=0) - _SKIN, vertices.max(axis=0) + _SKIN) for vertices in corners]

    def on_body(self, points_s: FloatArray, time: float) -> BoolArray:
        """Which points (N, 3) of S, m, are on a body at `time` s; False for NaN."""
        inside = np.zeros(len(points_s), dtype=bool)
        for body, (low, high) in zip(self._bodies, self._boxes, strict=True):
            position, yaw = body.pose_at(time)
            cos, sin = np.cos(yaw), np.sin(yaw)
            local = (points_s - position) @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            # Not the road below it: what the wheels stand on is no part of the body.
            inside |= ((local >= low) & (local <= high)).all(axis=1) & (local[:, 2] > 0.5 * _SKIN)
        return inside
