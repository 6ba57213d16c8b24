"""Procedural street along any route: the same seed builds the same street."""

from __future__ import annotations

from functools import partial

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.world import props
from stereo_slam_env.world.props import facing_points
from stereo_slam_env.world.road import ASPHALT_HEIGHT, Road, RoadNetwork, Strip, paved, road_along
from stereo_slam_env.world.routes import Route, once_per_route
from stereo_slam_env.world.scene import Material, Ribbon, Ribbons, Scene, ShapeTable

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
    from stereo_slam_env.world import street_plan

    network = _network(route)
    places, firsts = _places(route)
    things = street_plan.plan(network.points, network.circles, places, firsts, HALF_WIDTH, _KERB, rng)
    rows = street_plan.parts(things)
    built = ShapeTable(rows[:, :-1].copy(), rows[:, -1] > 0.0, partial(props.street_materials, things))
    points = _landmarks(built, street_plan.of_kind(things, props.TOWER), network, rng)
    ground = network.ground(320.0, _GRASS)
    return Scene(ground, built, Ribbons(partial(_paving, route)), points)


@once_per_route
def _places(route: Route) -> tuple[FloatArray, IntArray]:
    """Places along all roads and the first one of each, as `street_plan.plan` takes them."""
    each = [road.places for road in _network(route).roads]
    return np.concatenate(each), np.cumsum([0, *map(len, each)])


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


def _landmarks(built: ShapeTable, background: BoolArray, network: RoadNetwork, rng: np.random.Generator) -> FloatArray:
    """Points on surfaces that face a road, the wanted number per metre; (N, 3). `background` says what is far away."""
    length = sum(road.length for road in network.roads)
    count_near, count_far = int(_NEAR_PER_METRE * length), int(_BACKGROUND_PER_METRE * length)
    count_road = int(_ROAD_SHARE * count_near)
    parts = [
        facing_points(built.where(built.solid & ~background), count_near - count_road, 9.0, network, rng),
        facing_points(built.where(built.solid & background), count_far, 25.0, network, rng),
    ]
    on_road = network.points[rng.integers(len(network.points), size=count_road)]
    on_road = on_road + rng.uniform(-3.0, 3.0, (count_road, 2))
    parts.append(np.column_stack([on_road, np.full(count_road, ASPHALT_HEIGHT)]))
    points = np.concatenate(parts)
    order: FloatArray = points[rng.permutation(len(points))]
    return order
