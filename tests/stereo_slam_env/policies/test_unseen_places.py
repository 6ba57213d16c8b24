"""Places that nobody has looked at yet (1 s)."""

import numpy as np
import pytest

from filters import StereoNoise
from filters.geometry import rotations
from stereo_slam_env.policies.foresight import CameraPoses, SensorModel, UnseenPlaces
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.world.routes import named_route


@pytest.fixture
def places():
    sensor = SensorModel(RIGS["qvga"], StereoNoise.independent_pixels(1.0), nearest=4.0, farthest=30.0, most=1)
    return UnseenPlaces(named_route("straight"), sensor)


def looking(*pans):
    return CameraPoses(np.zeros((len(pans), 3)), rotations.exp(np.array([[0.0, pan, 0.0] for pan in pans])))


def test_what_has_been_in_view_is_not_discovered_again(places):
    ahead, aside = looking(0.0), looking(1.5)
    first = [places.discovered(CameraPoses(c.positions[None], c.R_wc[None]))[0] for c in (ahead, aside)]
    assert min(first) > 5
    places.look(ahead)
    again = [places.discovered(CameraPoses(c.positions[None], c.R_wc[None]))[0] for c in (ahead, aside)]
    assert again[0] == 0
    assert 0 < again[1] <= first[1]


def test_a_place_that_is_in_view_in_several_looks_is_discovered_once(places):
    both = looking(0.0, 0.0)
    twice = places.discovered(CameraPoses(both.positions[None], both.R_wc[None]))
    once = places.discovered(CameraPoses(both.positions[None, :1], both.R_wc[None, :1]))
    np.testing.assert_array_equal(twice, once)


def test_driving_on_shows_new_places_up_to_the_end_of_the_route_and_beyond(places):
    count = len(places)
    for z in np.arange(0.0, 98.0, 0.5):
        places.look(CameraPoses(np.array([0.0, 0.0, z]), np.eye(3)))
    assert 0 < len(places) < 0.5 * count
    places.look(CameraPoses(np.array([0.0, 0.0, 98.0]), np.eye(3)))
    beyond = CameraPoses(np.array([[[0.0, 0.0, 98.0]]]), np.eye(3)[None, None])
    assert places.discovered(beyond)[0] == 0


@pytest.mark.parametrize("route", ["town", "loop", "right-turn"])
def test_they_are_along_any_route(route):
    sensor = SensorModel(RIGS["qvga"], StereoNoise.independent_pixels(1.0), nearest=4.0, farthest=20.0)
    route = named_route(route)
    places = UnseenPlaces(route, sensor)
    everywhere = sum(
        int(places.discovered(CameraPoses(position[None, None], rotations.exp([0.0, heading, 0.0])[None, None]))[0])
        for position, heading in zip(route.positions[::10], route.headings[::10], strict=True)
    )
    assert everywhere > len(places) // 3
