"""Procedural street along any route: the same seed builds the same street."""

from __future__ import annotations

from functools import partial

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.world import props
from stereo_slam_env.world.layout import Layout, Make, facing_points
from stereo_slam_env.world.road import ASPHALT_HEIGHT, Road, RoadNetwork, Strip, paved, road_along
from stereo_slam_env.world.routes import Route, once_per_route
from stereo_slam_env.world.scene import Material, Primitive, Ribbon, Scene

HALF_WIDTH = 5.75
"""Two lanes of 3.5 m between two parking strips of 2.25 m."""
PAVEMENT = 3.0
WALKWAY = 8.2
"""Where pedestrians walk: between the trees and lamps at the kerb and the houses, m from the centreline."""
_KERB = HALF_WIDTH + PAVEMENT
_STRIPS = (
    Strip(HALF_WIDTH, ASPHALT_HEIGHT, Material((0.92, 0.92, 0.95), "asphalt", (2 * HALF_WIDTH, 7.9))),
    Strip(_KERB, 0.4 * ASPHALT_HEIGHT, Material((1.0, 0.97, 0.92), "paving", (2 * _KERB, 3.1))),
)
_NEAR_PER_METRE = 4.0
_BACKGROUND_PER_METRE = 1.0
_ROAD_SHARE = 0.12
"""Share of the near landmarks that lie on the road."""
_SPUR = 120.0
_GRASS = Material((1.0, 1.0, 1.0), "grass", (7.3, 7.3))


def build_street(route: Route, rng: np.random.Generator) -> Scene:
    """Houses, trees, lamps, signs and parked cars along `route`, with landmarks on them.

    Where the route turns by more than 45 degrees, the old direction goes on as a side street.
    """
    network = _network(route)
    roads = network.roads
    street = _Street(network, rng)
    sides = [(road, side) for road in roads for side in (1.0, -1.0)]
    for road, side in sides:
        street.line_with_houses(road, side)
    houses = len(street.primitives)
    for road, side in sides:
        street.line_with_towers(road, side)
    towers = len(street.primitives)
    for road, side in sides:
        street.furnish(road, side)
    built = street.primitives
    points = _landmarks(built[:houses] + built[towers:], built[houses:towers], roads, network, rng)
    ground = network.ground(320.0, _GRASS)
    return Scene(ground, tuple(built), _paving(route), points)


@once_per_route
def _network(route: Route) -> RoadNetwork:
    return RoadNetwork([road_along(route), *_side_streets(route)])


@once_per_route
def _paving(route: Route) -> tuple[Ribbon, ...]:
    return paved(_network(route).roads, _STRIPS)


def _side_streets(route: Route) -> list[Road]:
    """The old direction at every turn of more than 45 degrees, as a road of its own."""
    lane = route.positions[:, [2, 0]] * [1.0, -1.0]
    streets = []
    for first, _ in route.turns(np.pi / 4):
        heading = route.headings[first]
        direction = np.array([np.cos(heading), -np.sin(heading)])
        start = lane[first] + 14.0 * direction
        streets.append(Road(start + np.array([[0.0], [1.0], [2.0]]) * direction, 0.0, _SPUR))
    return streets


class _Street:
    """Lines roads with what stands in a street."""

    def __init__(self, network: RoadNetwork, rng: np.random.Generator) -> None:
        self._layout, self._rng = Layout(network), rng

    @property
    def primitives(self) -> list[Primitive]:
        return self._layout.primitives

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
                self._layout.claim(xy, yaw + with_traffic, (4.9, 1.9), 0.1, HALF_WIDTH - 2.1, parked)
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
            self._layout.claim(xy, yaw + turn, (0.6, 0.6), 0.1, HALF_WIDTH + 0.2, make)
            station += float(self._rng.uniform(5.0, 8.0))

    def _build(
        self, road: Road, station: float, front: float, size: tuple[float, float], room: float, make: Make
    ) -> bool:
        """Try a house that starts at `station`, with its front `front` m to the left of the centreline."""
        xy, yaw = road.place(station + 0.5 * size[0], front + np.copysign(0.5 * size[1], front))
        return self._layout.claim(xy, yaw, size, room, _KERB - 0.1, make)


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
        facing_points([p for p in near if p.solid], count_near - count_road, 9.0, network.nearest, rng),
        facing_points([p for p in background if p.solid], count_far, 25.0, network.nearest, rng),
    ]
    on_road = network.points[rng.integers(len(network.points), size=count_road)]
    on_road = on_road + rng.uniform(-3.0, 3.0, (count_road, 2))
    parts.append(np.column_stack([on_road, np.full(count_road, ASPHALT_HEIGHT)]))
    points = np.concatenate(parts)
    order: FloatArray = points[rng.permutation(len(points))]
    return order
