"""What stands in the way of somebody who walks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.world.scene import Box, Cylinder, Primitive

_TALL = 1.8
"""Height of a person: what is above is in nobody's way, m."""


class Obstacles:
    """The outlines on the ground of solids lower than a person: rectangles, and circles around the rest.

    Parameters
    ----------
    solids : iterable of Box, Cylinder or Sphere
        What stands.
    """

    def __init__(self, solids: Iterable[Primitive]) -> None:
        rectangles = []
        for solid in solids:
            if isinstance(solid, Box):
                if solid.center[2] - 0.5 * solid.size[2] < _TALL:
                    rectangles.append((*solid.center[:2], solid.yaw, *solid.size[:2]))
            elif isinstance(solid, Cylinder):
                start, end = np.array(solid.start), np.array(solid.end)
                if min(start[2], end[2]) < _TALL:
                    reach = float(np.linalg.norm(end[:2] - start[:2]))
                    yaw = float(np.arctan2(end[1] - start[1], end[0] - start[0]))
                    middle = 0.5 * (start + end)
                    rectangles.append((*middle[:2], yaw, reach + 2 * solid.radius, 2 * solid.radius))
            else:
                above = max(solid.center[2] - _TALL, 0.0)
                if above < solid.radius:
                    side = 2 * float(np.sqrt(solid.radius**2 - above**2))
                    rectangles.append((*solid.center[:2], 0.0, side, side))
        self._rectangles = np.array(rectangles, dtype=np.float64).reshape(-1, 5)
        self._reach = 0.5 * np.linalg.norm(self._rectangles[:, 3:], axis=1)

    def block(self, points: FloatArray, room: float) -> bool:
        """Whether any of `points` (N, 2) is inside an outline or less than `room` m from one."""
        middle = points.mean(axis=0)
        reach = np.linalg.norm(points - middle, axis=1).max() + room
        near = self._rectangles[np.linalg.norm(self._rectangles[:, :2] - middle, axis=1) < self._reach + reach]
        cos, sin = np.cos(near[:, 2]), np.sin(near[:, 2])
        x, y = np.moveaxis(points[:, None] - near[:, :2], -1, 0)
        local = np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)
        return bool((np.abs(local) < 0.5 * near[:, 3:] + room).all(axis=-1).any())
