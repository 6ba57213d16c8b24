import gc
import weakref

import numpy as np
import pytest
from scipy.spatial import cKDTree

from stereo_slam_env.world import compiled
from stereo_slam_env.world.props import Layout, facing_points
from stereo_slam_env.world.road import RoadNetwork, network_along, road_along
from stereo_slam_env.world.routes import ROUTES
from stereo_slam_env.world.scene import Box, Material, table_of


@pytest.fixture(params=["loop", "right-turn"])
def route(request):
    return ROUTES[request.param]()


def test_nearest_points_of_a_network_are_those_of_a_search_tree(route):
    network = RoadNetwork([road_along(route), road_along(ROUTES["town"]())])
    xy = np.random.default_rng(0).uniform(network.points.min() - 80.0, network.points.max() + 80.0, (500, 2))
    away, nearest = cKDTree(network.points).query(xy)
    np.testing.assert_array_equal(network.nearest(xy), network.points[nearest])
    np.testing.assert_allclose(network.distance(xy), away)
    assert network.nearest(xy.reshape(50, 10, 2)).shape == (50, 10, 2)


def test_landmarks_are_on_what_is_turned_to_the_nearest_point_of_a_search_tree(route):
    network = RoadNetwork([road_along(route), road_along(ROUTES["town"]())])
    places, rng = cKDTree(network.points), np.random.default_rng(0)
    low, high = network.points.min() - 120.0, network.points.max() + 120.0
    boxes = [
        Box((*rng.uniform(low, high, 2), 2.0), tuple(rng.uniform(0.3, 9.0, 3)), 0.1 * k, Material((1.0, 1.0, 1.0)))
        for k in range(300)
    ]
    found = facing_points(boxes, 100, 3.0, network, np.random.default_rng(1))
    rng, table = np.random.default_rng(1), table_of(boxes)
    weights = compiled.sampling_weights(table)
    points, normals = compiled.sample(table, np.ceil(600 * weights / weights.sum()).astype(np.int64), rng)
    ahead = network.points[places.query(points[:, :2])[1]] - points[:, :2]
    turned = np.sum(normals[:, :2] * ahead, axis=1) > 0.2 * np.linalg.norm(ahead, axis=1)
    wanted = points[turned & (points[:, 2] > 0.15) & (points[:, 2] < 3.0)]
    np.testing.assert_array_equal(found, wanted[rng.permutation(len(wanted))[:100]])


@pytest.mark.parametrize(("left", "free"), [(7.4, False), (7.6, True)])
def test_a_thing_keeps_its_clearance_from_the_road(route, left, free):
    road = road_along(route)
    xy, yaw = road.place(20.0, left)
    assert Layout(RoadNetwork([road])).claim(xy, yaw, (3.0, 3.0), 0.1, 6.0, lambda at: []) == free


@pytest.mark.parametrize(("further", "free"), [(3.2, False), (3.9, True)])
def test_a_thing_keeps_its_room_from_another(route, further, free):
    road = road_along(route)
    layout = Layout(RoadNetwork([road]))
    (xy, yaw), ahead = road.place(10.0, 20.0), road.tangents[20]
    assert layout.claim(xy, yaw, (3.0, 3.0), 0.5, 6.0, lambda at: [])
    assert layout.claim(xy + further * ahead, yaw, (3.0, 3.0), 0.5, 6.0, lambda at: []) == free


def test_what_belongs_to_a_route_is_kept_for_as_long_as_the_route():
    route = ROUTES["straight"]()
    network = network_along(route)
    assert network_along(route) is network
    assert network_along(ROUTES["straight"]()) is not network
    kept = weakref.ref(network)
    del route, network
    gc.collect()
    assert kept() is None
