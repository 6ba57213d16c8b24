"""A grid of streets: where choices lead, and that what is driven comes back to where it was."""

import numpy as np
import pytest

from stereo_slam_env.world.routes import random_grid, through_streets
from stereo_slam_env.world.street_grid import LEFT, RIGHT, STRAIGHT, Place, StreetGrid, random_streets

SEEDS = range(8)


def streets_of(seed):
    return random_streets(np.random.default_rng(seed))


@pytest.mark.parametrize("turn", [LEFT, RIGHT])
def test_four_turns_lead_round_a_block_to_the_start_pose(turn):
    for seed in SEEDS:
        route = through_streets(streets_of(seed), [turn] * 4)
        np.testing.assert_allclose(route.positions[-2], 0.0, atol=1e-9)  # the last step is one beyond
        assert abs(route.headings[-1]) == pytest.approx(2 * np.pi)


def test_who_comes_back_on_the_same_road_drives_in_the_other_lane():
    streets = StreetGrid(np.array([-1.75, 48.25]), np.array([-20.0, 20.0]), Place(0, 1, 0))
    way = through_streets(streets, [RIGHT, RIGHT, RIGHT, RIGHT]).positions
    back = Place(0, 0, 2)
    assert streets.road(back) == streets.road(streets.start)
    assert way[:, 0].min() == pytest.approx(0.0, abs=1e-9)  # 1.75 m to the right of the middle of the street
    assert way[:, 2].max() == pytest.approx(20.0 - 1.75)


def test_what_has_been_driven_stays_when_the_next_road_is_chosen():
    choices = [STRAIGHT, RIGHT, LEFT, LEFT, STRAIGHT, RIGHT]
    for seed in SEEDS:
        streets = streets_of(seed)
        whole = through_streets(streets, choices)
        for count in range(1, len(choices)):
            part = through_streets(streets, choices[:count])
            np.testing.assert_array_equal(part.positions[:-1], whole.positions[: part.frames - 1])


def test_the_tour_drives_every_road_and_no_road_has_two_numbers():
    for seed in SEEDS:
        streets, place = random_grid(np.random.default_rng(seed)).streets, None
        place, driven = streets.start, {streets.road(streets.start)}
        for choice in streets.tour:
            place = streets.beyond(place, choice)
            driven.add(streets.road(place))
        assert driven == set(range(streets.count)) == set(range(24))


def test_a_road_that_does_not_exist_is_replaced_by_one_that_does():
    streets = streets_of(0)
    corner = Place(0, 3, 0)  # the last junction of the first street
    assert [streets.beyond(corner, choice) is None for choice in (LEFT, STRAIGHT, RIGHT)] == [True, True, False]
    assert [streets.taken(corner, choice)[0] for choice in (LEFT, STRAIGHT, RIGHT)] == [RIGHT] * 3


def test_the_way_to_a_road_is_counted_in_roads():
    streets = streets_of(0)
    wanted = np.zeros(24, dtype=bool)
    wanted[streets.road(streets.start)] = True
    assert streets.roads_to(streets.start, wanted) == 0
    right = streets.beyond(streets.start, RIGHT)
    assert streets.roads_to(right, wanted) == 3  # round the block
