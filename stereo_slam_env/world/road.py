"""Roads along a centreline: places beside them, paving, distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.world.routes import Route, once_per_route
from stereo_slam_env.world.scene import Ground, Material, Ribbon

LANE_OFFSET = 1.75
"""A car in its (right-hand) lane is this far right of the centreline, m."""
LEAD_IN, LEAD_OUT = 31.0, 130.0
"""How far the road along a route goes on before its start and after its end, m."""
ASPHALT_HEIGHT = 0.03
"""Drawn height of the road above the plane z = 0, m."""
SPACING = 0.5
"""Of the points of a road, m."""
_LEAST_STEP = 0.25
_FOLD = 0.2
"""m: how far the inner edge of a bend may lie beyond its centre."""
_SAME_PLACE, _OTHER_PASS = 0.9, 30.0
"""A stretch this near to another of its road, but that far from it along the road, is the same street again, m."""
_SAME_DIRECTION = 0.3
_LIFTS = 0.011
"""m between the lowest and the highest piece of paving."""


class Road:
    """A road on the plane z = 0 of S, by the path (K, 2) of a car in its right lane, m, with straight extensions."""

    def __init__(self, lane: ArrayLike, before: float, after: float) -> None:
        path = np.asarray(lane, dtype=np.float64)
        tangents = np.gradient(path, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        path = np.concatenate([path[:1] - before * tangents[:1], path, path[-1:] + after * tangents[-1:]])
        tangents = np.concatenate([tangents[:1], tangents, tangents[-1:]])
        middle = path + LANE_OFFSET * left_of(tangents)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
        self.stations = np.arange(0.0, arc[-1], SPACING)
        self.points = np.stack([np.interp(self.stations, arc, middle[:, i]) for i in range(2)], axis=1)
        self.lane_stations: FloatArray = arc[1:-1]
        """Station of each point of the lane; (K,)."""

    @property
    def length(self) -> float:
        """Length from end to end, m."""
        return float(self.stations[-1])

    @cached_property
    def tangents(self) -> FloatArray:
        """Unit directions of travel at the points; (K, 2)."""
        gradient = np.gradient(self.points, axis=0)
        unit: FloatArray = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        return unit

    @cached_property
    def _lefts(self) -> FloatArray:
        return left_of(self.tangents)

    @cached_property
    def yaws(self) -> FloatArray:
        """Directions of travel at the points, rad, without jumps; (K,)."""
        return np.unwrap(np.arctan2(self.tangents[:, 1], self.tangents[:, 0]))

    @cached_property
    def bends(self) -> FloatArray:
        """Curvature at the points over a few metres, 1/m, positive to the left; (K,)."""
        return np.asarray(gaussian_filter1d(np.gradient(self.yaws, SPACING), 3.0, mode="nearest"))

    def place(self, station: float, left: float) -> tuple[FloatArray, float]:
        """The point `station` m along the road and `left` m to its left, and the yaw of the road there."""
        x, y, left_x, left_y, yaw = self.places[min(max(round(station / SPACING), 0), len(self.points) - 1)].tolist()
        return np.array([x + left * left_x, y + left * left_y]), yaw

    @cached_property
    def places(self) -> FloatArray:
        """Row of each point: x, y, the unit vector to the left, and the yaw; (K, 5)."""
        yaws = np.arctan2(self.tangents[:, 1], self.tangents[:, 0])
        return np.column_stack([self.points, self._lefts, yaws])

    def along(self, stations: FloatArray, left: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Points (N, 2) `left` m to the left of the centreline and yaws (N,) at `stations` (N,), in between too."""
        yaws = np.interp(stations, self.stations, self.yaws)
        middle = np.stack([np.interp(stations, self.stations, self.points[:, i]) for i in range(2)], axis=1)
        side = np.stack([-np.sin(yaws), np.cos(yaws)], axis=1)
        return middle + np.broadcast_to(left, len(middle))[:, None] * side, yaws

    def edge(self, index: IntArray, left: float) -> FloatArray:
        """The points `left` m to the left of the points `index`, but not beyond the centre of a bend; (N, 2)."""
        bend = self.bends[index]
        most = np.where(bend * left > 0.0, 1.0 / np.maximum(np.abs(bend), 1e-6) + _FOLD, np.inf)
        offset = np.copysign(np.minimum(abs(left), most), left)
        edge: FloatArray = self.points[index] + offset[:, None] * self._lefts[index]
        return edge

    def stretches(self, others: Sequence[Road] = ()) -> list[slice]:
        """The road without what lies on `others` or where it has been before: slices of the points."""
        fresh = np.ones(len(self.points), dtype=bool)
        for other in others:
            fresh &= ~self._repeats(other, -np.inf)
        fresh &= ~self._repeated
        edges = np.flatnonzero(np.diff(np.concatenate([[False], fresh, [False]]).astype(int))).reshape(-1, 2)
        return [slice(max(a - 1, 0), min(b + 1, len(fresh))) for a, b in edges if b - a > 1]

    @cached_property
    def _repeated(self) -> BoolArray:
        return self._repeats(self, _OTHER_PASS)

    @cached_property
    def fresh_stretches(self) -> list[slice]:
        """The road without what lies where it has been before: slices of the points."""
        return self.stretches()

    def _repeats(self, other: Road, gap: float) -> BoolArray:
        """Mask of points along `other`, on what is more than `gap` m before them."""
        repeated = np.zeros(len(self.points), dtype=bool)
        near = self.tree.sparse_distance_matrix(other.tree, _SAME_PLACE, output_type="ndarray")
        rows, rows_of_other = near["i"], near["j"]
        across = (
            self.tangents[rows, 0] * other.tangents[rows_of_other, 1]
            - self.tangents[rows, 1] * other.tangents[rows_of_other, 0]
        )
        again = (self.stations[rows] - other.stations[rows_of_other] > gap) & (np.abs(across) < _SAME_DIRECTION)
        repeated[rows[again]] = True
        return repeated

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the points."""
        return cKDTree(self.points)


@once_per_route
def road_along(route: Route) -> Road:
    """The road whose right-hand lane is driven by `route`."""
    lane = route.positions[:, [2, 0]] * [1.0, -1.0]
    return Road(lane[_moved(route)], LEAD_IN, LEAD_OUT)


def stations_of(route: Route, road: Road) -> FloatArray:
    """Nominal station of the camera on the road along its route at each frame, m; (K,)."""
    return np.interp(route.arc_length, route.arc_length[_moved(route)], road.lane_stations)


def _moved(route: Route) -> IntArray:
    """Frames that are not in the place of the one before."""
    return np.asarray(np.unique(np.floor(route.arc_length / _LEAST_STEP), return_index=True)[1])


@once_per_route
def network_along(route: Route) -> RoadNetwork:
    """The network of that road alone."""
    return RoadNetwork([road_along(route)])


@dataclass(frozen=True)
class Strip:
    """Paving of a road, from the middle outwards: half width and height, m."""

    half_width: float
    height: float
    material: Material


def paved(roads: Sequence[Road], strips: Sequence[Strip]) -> tuple[Ribbon, ...]:
    """Ribbons along roads; where they would coincide, the first one stays, and crossing ones differ in height."""
    pieces = [(road, piece) for i, road in enumerate(roads) for piece in road.stretches(roads[:i])]
    step = min(0.004, _LIFTS / max(len(pieces) - 1, 1))
    ribbons = []
    for i, (road, piece) in enumerate(pieces):
        every = np.append(np.arange(piece.start, piece.stop - 1, 3), piece.stop - 1)
        for strip in strips:
            height = np.full((len(every), 1), strip.height - step * i)
            # Off the lattice: TinyRenderer drops a triangle with a vertex exactly in the camera plane.
            left, right = (np.hstack([road.edge(every, sign * strip.half_width) + 0.0137, height]) for sign in (1, -1))
            ribbons.append(Ribbon(left, right, strip.material))
    return tuple(ribbons)


class RoadNetwork:
    """Distance to the nearest of several roads."""

    def __init__(self, roads: list[Road]) -> None:
        self.roads = roads
        self.points = np.concatenate([road.points for road in roads])

    @cached_property
    def circles(self) -> FloatArray:
        """Circles around runs of the points, see `compiled.circles_around`."""
        from stereo_slam_env.world import compiled

        return np.asarray(compiled.circles_around(self.points))

    def distance(self, xy: FloatArray) -> FloatArray:
        """Distance of each point to the nearest centreline, m; (..., 2) -> (...)."""
        return np.asarray(np.linalg.norm(self.nearest(xy) - xy, axis=-1))

    def nearest(self, xy: FloatArray) -> FloatArray:
        """The nearest point on a centreline; (..., 2) -> (..., 2)."""
        from stereo_slam_env.world import compiled

        queries = np.ascontiguousarray(xy, dtype=np.float64).reshape(-1, 2)
        nearest_points: FloatArray = self.points[compiled.nearest(self.points, self.circles, queries)]
        return nearest_points.reshape(np.shape(xy))

    def ground(self, reach: float, material: Material) -> Ground:
        """Ground that goes on for `reach` m around all roads."""
        low, high = self.points.min(axis=0) - reach, self.points.max(axis=0) + reach
        return Ground((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), material)


def left_of(tangents: FloatArray) -> FloatArray:
    """Unit vectors 90 degrees to the left; (..., 2) -> (..., 2)."""
    return np.stack([-tangents[..., 1], tangents[..., 0]], axis=-1)
