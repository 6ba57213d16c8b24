import gc
import weakref

import numpy as np
import pytest
from scipy.spatial import cKDTree

from stereo_slam_env.world.layout import Layout
from stereo_slam_env.world.road import RoadNetwork, network_along, road_along
from stereo_slam_env.world.routes import ROUTES


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
