"""Places that nobody has looked at yet (1 s)."""

import numpy as np
import pytest

from filters import StereoNoise
from filters.geometry import rotations
from stereo_slam_env.policies.foresight import CameraPoses, SensorModel, discovered, places_beside
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.world.routes import named_route

SENSOR = SensorModel(RIGS["qvga"], StereoNoise.independent_pixels(1.0), nearest=4.0, farthest=30.0, most=1)


@pytest.fixture
def places():
    return places_beside(named_route("straight"), SENSOR.farthest)


def looking(*pans):
    return CameraPoses(np.zeros((len(pans), 3)), rotations.exp(np.array([[0.0, pan, 0.0] for pan in pans])))


def test_what_has_been_in_view_is_not_discovered_again(places):
    cameras = looking(0.0, 1.5)[:, None]
    first = discovered(places, SENSOR, cameras)
    assert first.min() > 5
    again = discovered(places[~SENSOR.in_view(places, looking(0.0)[0])], SENSOR, cameras)
    assert again[0] == 0
    assert 0 < again[1] <= first[1]


def test_a_place_that_is_in_view_in_several_looks_is_discovered_once(places):
    both = looking(0.0, 0.0)[None]
    np.testing.assert_array_equal(discovered(places, SENSOR, both), discovered(places, SENSOR, both[:, :1]))


def test_driving_on_shows_new_places_up_to_the_end_of_the_route_and_beyond(places):
    z = np.append(np.arange(0.0, 98.0, 0.5), 98.0)
    along = CameraPoses(z[:, None] * [0.0, 0.0, 1.0], np.tile(np.eye(3), (len(z), 1, 1)))
    left = places[~SENSOR.in_view(places, along).any(axis=0)]
    assert 0 < len(left) < 0.5 * len(places)
    assert discovered(left, SENSOR, along[None, -1:])[0] == 0
    assert discovered(places, SENSOR, along[None, -1:])[0] > 0


@pytest.mark.parametrize("route", ["town", "loop", "right-turn"])
def test_they_are_along_any_route(route):
    sensor = SensorModel(RIGS["qvga"], StereoNoise.independent_pixels(1.0), nearest=4.0, farthest=20.0)
    route = named_route(route)
    places = places_beside(route, sensor.farthest)
    everywhere = discovered(places, sensor, CameraPoses(route.positions[::10, None], route.attitudes[::10, None])).sum()
    assert everywhere > len(places) // 3
