"""A road along a centreline: where things are across it, and how near they are to it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from filters.validation import FloatArray
from stereo_slam_env.world.scene import Material, Ribbon

HALF_WIDTH = 5.75
"""Two lanes of 3.5 m between two parking strips of 2.25 m."""
PAVEMENT = 3.0
LANE_OFFSET = 1.75
"""A car in its (right-hand) lane is this far right of the centreline, m."""
_SPACING = 0.5
_ASPHALT = Material((0.92, 0.92, 0.95), "asphalt", (2 * HALF_WIDTH, 7.9))
_PAVING = Material((1.0, 0.97, 0.92), "paving", (2 * (HALF_WIDTH + PAVEMENT), 3.1))


class Road:
    """A road on the plane z = 0 of S.

    Parameters
    ----------
    lane : (K, 2) array_like
        Path of a car in the right-hand lane, m; consecutive points differ.
    before, after : float
        Straight extensions at both ends, m.
    """

    def __init__(self, lane: ArrayLike, before: float, after: float) -> None:
        path = np.asarray(lane, dtype=np.float64)
        tangents = np.gradient(path, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        path = np.concatenate([path[:1] - before * tangents[:1], path, path[-1:] + after * tangents[-1:]])
        tangents = np.concatenate([tangents[:1], tangents, tangents[-1:]])
        middle = path + LANE_OFFSET * _left(tangents)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
        self.stations = np.arange(0.0, arc[-1], _SPACING)
        self.points = np.stack([np.interp(self.stations, arc, middle[:, i]) for i in range(2)], axis=1)

    @property
    def length(self) -> float:
        """From end to end, m."""
        return float(self.stations[-1])

    @cached_property
    def tangents(self) -> FloatArray:
        """Unit directions of travel at the points; (K, 2)."""
        gradient = np.gradient(self.points, axis=0)
        unit: FloatArray = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        return unit

    def place(self, station: float, left: float) -> tuple[FloatArray, float]:
        """The point `station` m along the road and `left` m to its left, and the yaw of the road there."""
        index = int(np.clip(round(station / _SPACING), 0, len(self.points) - 1))
        tangent = self.tangents[index]
        point = self.points[index] + left * _left(tangent)
        return point, float(np.arctan2(tangent[1], tangent[0]))

    def ribbons(self, lift: float) -> list[Ribbon]:
        """Asphalt over a wider pavement, `lift` m above the usual heights so that crossing roads do not coincide."""
        # Off the lattice: TinyRenderer drops a triangle with a vertex exactly in the camera plane.
        every = np.append(np.arange(0, len(self.points) - 1, 3), len(self.points) - 1)
        middle, side = self.points[every] + 0.0137, _left(self.tangents[every])

        def ribbon(half_width: float, height: float, material: Material) -> Ribbon:
            left, right = (
                np.column_stack([middle + sign * half_width * side, np.full(len(middle), height)]) for sign in (1, -1)
            )
            return Ribbon(left, right, material)

        return [
            ribbon(HALF_WIDTH, ASPHALT_HEIGHT + lift, _ASPHALT),
            ribbon(HALF_WIDTH + PAVEMENT, 0.4 * ASPHALT_HEIGHT + lift, _PAVING),
        ]


ASPHALT_HEIGHT = 0.03
"""Drawn height of the road above the plane z = 0, m."""


class RoadNetwork:
    """Distance to the nearest of several roads.

    Parameters
    ----------
    roads : sequence of Road
        At least one.
    """

    def __init__(self, roads: list[Road]) -> None:
        self.points = np.concatenate([road.points for road in roads])
        self._tree = cKDTree(self.points)

    def distance(self, xy: FloatArray) -> FloatArray:
        """From each point to the nearest centreline, m; (..., 2) -> (...)."""
        return np.asarray(self._tree.query(xy)[0])

    def nearest(self, xy: FloatArray) -> FloatArray:
        """The nearest point on a centreline; (..., 2) -> (..., 2)."""
        found: FloatArray = self.points[self._tree.query(xy)[1]]
        return found


def _left(tangents: FloatArray) -> FloatArray:
    return np.stack([-tangents[..., 1], tangents[..., 0]], axis=-1)
