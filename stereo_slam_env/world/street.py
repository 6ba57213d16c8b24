"""A procedural street along any route: the same seed builds the same street."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.world import props
from stereo_slam_env.world.props import Placed
from stereo_slam_env.world.road import ASPHALT_HEIGHT, HALF_WIDTH, PAVEMENT, Road, RoadNetwork
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.scene import Ground, Material, Primitive, Scene
from stereo_slam_env.world.surface_points import sample_surface, sampling_weight

_NEAR_PER_METRE = 4.0
_BACKGROUND_PER_METRE = 1.0
_ROAD_SHARE = 0.12
"""Share of the near landmarks that lie on the road."""
_LEAD_IN, _LEAD_OUT, _SPUR = 31.0, 130.0, 120.0
_KERB = HALF_WIDTH + PAVEMENT
_GRASS = Material((1.0, 1.0, 1.0), "grass", (7.3, 7.3))
Make = Callable[[Placed], list[Primitive]]
"""Builds a thing at a place."""


def build_street(route: Route, rng: np.random.Generator) -> Scene:
    """Lay out houses, trees, lamps, signs and parked cars along `route`, and landmarks on them.

    Parameters
    ----------
    route : Route
        Path of the camera; it drives in the right-hand lane. Where it turns by more than 45 degrees, the old
        direction goes on as a side street.
    rng : numpy.random.Generator
        Source of the layout.

    Returns
    -------
    Scene
        In S, with its landmarks.
    """
    lane = route.positions[:, [2, 0]] * [1.0, -1.0]
    roads = [Road(lane, _LEAD_IN, _LEAD_OUT), *_side_streets(route, lane)]
    network = RoadNetwork(roads)
    layout = _Layout(network, rng)
    for road in roads:
        for side in (1.0, -1.0):
            layout.line_with_houses(road, side)
    houses = len(layout.primitives)
    for road in roads:
        for side in (1.0, -1.0):
            layout.line_with_towers(road, side)
    background = layout.primitives[houses:]
    for road in roads:
        for side in (1.0, -1.0):
            layout.furnish(road, side)
    near = layout.primitives[:houses] + layout.primitives[houses + len(background) :]

    points = _landmarks(near, background, roads, network, rng)
    reach = 320.0
    low, high = network.points.min(axis=0) - reach, network.points.max(axis=0) + reach
    ground = Ground((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), _GRASS)
    ribbons = [ribbon for i, road in enumerate(roads) for ribbon in road.ribbons(-0.004 * i)]
    return Scene(ground, tuple(layout.primitives), tuple(ribbons), np.arange(len(points), dtype=np.int64), points)


def _side_streets(route: Route, lane: FloatArray) -> list[Road]:
    """The old direction at every turn of more than 45 degrees, as a road of its own."""
    turning = np.abs(route.yaw_rates) > 1e-3
    edges = np.flatnonzero(np.diff(np.concatenate([[False], turning, [False]]).astype(int)))
    streets = []
    for first, last in edges.reshape(-1, 2):
        if abs(route.headings[last] - route.headings[first]) > np.pi / 4:
            heading = route.headings[first]
            direction = np.array([np.cos(heading), -np.sin(heading)])
            start = lane[first] + 14.0 * direction
            streets.append(Road(start + np.array([[0.0], [1.0], [2.0]]) * direction, 0.0, _SPUR))
    return streets


class _Layout:
    """Puts things where there is room: off the roads and clear of each other."""

    def __init__(self, network: RoadNetwork, rng: np.random.Generator) -> None:
        self._network, self._rng = network, rng
        self.primitives: list[Primitive] = []
        self._footprints: list[_Footprint] = []

    def line_with_houses(self, road: Road, side: float) -> None:
        station = float(self._rng.uniform(0.0, 4.0))
        while station < road.length:
            length = 3.2 * float(self._rng.integers(3, 7))
            depth, setback = float(self._rng.uniform(8.0, 12.0)), float(self._rng.choice([0.4, 0.4, 1.2, 3.5]))
            floors = int(self._rng.integers(1, 4))
            house = partial(props.building, length=length, depth=depth, floors=floors, rng=self._rng)
            built = self._build(road, station, side * (_KERB + setback), (length, depth), 0.3, house)
            gap = float(self._rng.choice([0.05, 0.05, 0.6, 4.0, 7.0]))
            station += length + gap if built else 2.0

    def line_with_towers(self, road: Road, side: float) -> None:
        station = float(self._rng.uniform(0.0, 20.0))
        while station < road.length:
            length, depth = self._rng.uniform(12.0, 20.0, 2).tolist()
            setback, floors = float(self._rng.uniform(26.0, 48.0)), int(self._rng.integers(3, 8))
            tower = partial(props.tower, length=length, depth=depth, floors=floors, rng=self._rng)
            built = self._build(road, station, side * setback, (length, depth), 2.0, tower)
            station += length + float(self._rng.uniform(2.0, 12.0)) if built else 6.0

    def furnish(self, road: Road, side: float) -> None:
        """Parked cars in the parking strip; lamps, trees, signs and bins on the pavement."""
        parking, pavement = side * (HALF_WIDTH - 1.05), side * (HALF_WIDTH + 0.7)
        with_traffic, inwards = (0.0 if side < 0 else np.pi), -side * np.pi / 2
        station = float(self._rng.uniform(2.0, 8.0))
        while station < road.length:
            if self._rng.random() < 0.6:
                xy, yaw = road.place(station, parking)
                parked = partial(props.car, rng=self._rng)
                self._claim(xy, yaw + with_traffic, (4.9, 1.9), 0.1, HALF_WIDTH - 2.1, parked)
            station += float(self._rng.uniform(6.0, 9.0))
        kinds: tuple[tuple[Make, float, float], ...] = (  # what, its turn to the road, its share
            (props.street_lamp, inwards, 0.34),
            (partial(props.tree, rng=self._rng), 0.0, 0.32),
            (props.traffic_sign, with_traffic + np.pi, 0.14),
            (props.litter_bin, 0.0, 0.20),
        )
        station = float(self._rng.uniform(3.0, 9.0))
        while station < road.length:
            make, turn, _ = kinds[self._rng.choice(len(kinds), p=[share for _, _, share in kinds])]
            xy, yaw = road.place(station, pavement)
            self._claim(xy, yaw + turn, (0.6, 0.6), 0.1, HALF_WIDTH + 0.2, make)
            station += float(self._rng.uniform(5.0, 8.0))

    def _build(
        self, road: Road, station: float, front: float, size: tuple[float, float], room: float, make: Make
    ) -> bool:
        """Try a house that starts at `station`, with its front `front` m to the left of the centreline."""
        xy, yaw = road.place(station + 0.5 * size[0], front + np.copysign(0.5 * size[1], front))
        return self._claim(xy, yaw, size, room, _KERB - 0.1, make)

    def _claim(
        self,
        xy: FloatArray,
        yaw: float,
        size: tuple[float, float],
        room: float,
        clearance: float,
        make: Make,
    ) -> bool:
        """Build if the footprint is `clearance` m off every centreline and free; return whether it was."""
        wanted = _Footprint(xy, yaw, size)
        cover = wanted.grid()
        if self._network.distance(cover).min() < clearance:
            return False
        for other in self._nearby(wanted, room):
            if other.contains(cover, room) or wanted.contains(other.xy[None], room):
                return False
        self._footprints.append(wanted)
        self.primitives += make(Placed(xy, yaw))
        return True

    def _nearby(self, wanted: _Footprint, room: float) -> list[_Footprint]:
        """The footprints whose circles come within `room` of the circle of the wanted one."""
        circles = np.array([(*f.xy, f.radius) for f in self._footprints]).reshape(-1, 3)
        away = np.hypot(circles[:, 0] - wanted.xy[0], circles[:, 1] - wanted.xy[1])
        return [self._footprints[i] for i in np.flatnonzero(away < circles[:, 2] + wanted.radius + 2 * room)]


@dataclass(frozen=True, eq=False)
class _Footprint:
    """A rectangle on the ground: centre (2,), yaw, size (length, width)."""

    xy: FloatArray
    yaw: float
    size: tuple[float, float]

    @cached_property
    def radius(self) -> float:
        """Of the circle around it, m."""
        return 0.5 * float(np.hypot(*self.size))

    @cached_property
    def _axes(self) -> FloatArray:
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[cos, sin], [-sin, cos]])

    def grid(self) -> FloatArray:
        """Points that cover the rectangle, about 1.5 m apart; (N, 2)."""
        steps = [s * np.linspace(-0.5, 0.5, max(3, int(s / 1.5))) for s in self.size]
        local = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
        covering: FloatArray = local @ self._axes + self.xy
        return covering

    def contains(self, points: FloatArray, room: float) -> bool:
        """Whether any point lies in the rectangle grown by `room` m."""
        local = (points - self.xy) @ self._axes.T
        return bool((np.abs(local) < 0.5 * np.array(self.size) + room).all(axis=1).any())


def _landmarks(
    near: list[Primitive],
    background: list[Primitive],
    roads: list[Road],
    network: RoadNetwork,
    rng: np.random.Generator,
) -> FloatArray:
    """Points on surfaces that face a road, the wanted number per metre; (N, 3)."""
    length = sum(road.length for road in roads)
    count_near, count_far = int(_NEAR_PER_METRE * length), int(_BACKGROUND_PER_METRE * length)
    count_road = int(_ROAD_SHARE * count_near)
    parts = [
        _facing_points([p for p in near if p.solid], count_near - count_road, 9.0, network, rng),
        _facing_points([p for p in background if p.solid], count_far, 25.0, network, rng),
    ]
    on_road = network.points[rng.integers(len(network.points), size=count_road)]
    on_road = on_road + rng.uniform(-3.0, 3.0, (count_road, 2))
    parts.append(np.column_stack([on_road, np.full(count_road, ASPHALT_HEIGHT)]))
    points = np.concatenate(parts)
    order: FloatArray = points[rng.permutation(len(points))]
    return order


def _facing_points(
    shapes: list[Primitive], count: int, highest: float, network: RoadNetwork, rng: np.random.Generator
) -> FloatArray:
    """`count` points on `shapes`, below `highest` m, that face the nearest road."""
    if not shapes:
        return np.zeros((0, 3))
    weights = np.array([sampling_weight(shape) for shape in shapes])
    counts = np.ceil(6 * count * weights / weights.sum()).astype(int)
    samples = [sample_surface(shape, n, rng) for shape, n in zip(shapes, counts, strict=True)]
    points, normals = (np.concatenate(column) for column in zip(*samples, strict=True))
    toward = network.nearest(points[:, :2]) - points[:, :2]
    facing = (normals[:, :2] * toward).sum(axis=1) > 0.2 * np.linalg.norm(toward, axis=1)
    facing &= (points[:, 2] > 0.15) & (points[:, 2] < highest)
    candidates = points[facing]
    chosen: FloatArray = candidates[rng.permutation(len(candidates))[:count]]
    return chosen
