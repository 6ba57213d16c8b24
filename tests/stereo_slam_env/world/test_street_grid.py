"""A grid of streets: where choices lead, and that what is driven comes back to where it was."""

import numpy as np
import pytest

from stereo_slam_env.world.routes import random_grid, through_streets
from stereo_slam_env.world.street_grid import BACK, LEFT, RIGHT, STRAIGHT, Place, StreetGrid, random_streets

SEEDS = range(8)
LINES = np.array([0.0, 40.0, 85.0, 130.0])
START = Place(1, 2, 0)


def streets_of(seed):
    return random_streets(np.random.default_rng(seed))


def grid(missing=frozenset(), start=START):
    """Four by four junctions, the start in the middle."""
    middle = 0.5 * (LINES[start.row - 1] + LINES[start.row])
    return StreetGrid(LINES - LINES[start.column] - 1.75, LINES - middle, start, missing)


def without(*places):
    """The grid without some roads."""
    return grid(frozenset(grid().slot(place) for place in places))


@pytest.mark.parametrize("turn", [LEFT, RIGHT])
def test_four_turns_lead_round_a_block_to_the_start_pose(turn):
    route = through_streets(grid(), [turn] * 4)
    np.testing.assert_allclose(route.positions[-2], 0.0, atol=1e-9)  # the last step is one beyond
    assert abs(route.headings[-1]) == pytest.approx(2 * np.pi)


def test_who_comes_back_on_the_same_road_drives_in_the_other_lane():
    streets = StreetGrid(np.array([-1.75, 48.25]), np.array([-20.0, 20.0]), Place(0, 1, 0))
    way = through_streets(streets, [RIGHT, RIGHT, RIGHT, RIGHT]).positions
    back = Place(0, 0, 2)
    assert streets.road(back) == streets.road(streets.start)
    assert way[:, 0].min() == pytest.approx(0.0, abs=1e-9)  # 1.75 m to the right of the middle of the street
    assert way[:, 2].max() == pytest.approx(20.0 - 1.75)


def test_at_a_dead_end_the_car_turns_round_and_comes_back_in_the_other_lane():
    ahead = [Place(1, 3, 0), Place(2, 2, 1), Place(0, 2, 3)]
    streets = without(*ahead)
    assert list(streets.ways(START)) == [BACK]
    choice, place = streets.taken(START, STRAIGHT)
    assert (choice, streets.road(place)) == (BACK, streets.road(START))
    route = through_streets(streets, [LEFT])
    np.testing.assert_allclose(route.positions[-2], [-3.5, 0.0, 0.0], atol=1e-9)
    assert route.headings[-1] == pytest.approx(-np.pi)
    assert np.abs(route.speeds * route.yaw_rates).max() < 3.0


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
        streets = random_grid(np.random.default_rng(seed)).streets
        place, driven = streets.start, {streets.road(streets.start)}
        for choice in streets.tour:
            place = streets.ways(place)[choice]
            driven.add(streets.road(place))
        assert driven == set(range(streets.count))


def test_grids_are_drawn_with_other_sizes_missing_roads_dead_ends_and_starts():
    drawn = [streets_of(seed) for seed in range(100)]
    sizes = {(len(streets.columns), len(streets.rows)) for streets in drawn}
    assert {3, 4, 5, 6} == {size for pair in sizes for size in pair}
    shares = [len(streets.missing) / streets.slots for streets in drawn]
    assert min(shares) < 0.05 < 0.2 < max(shares) <= 0.3
    dead_ends = [BACK in streets.tour for streets in drawn]
    assert 0.2 < np.mean(dead_ends) < 0.9
    assert len({streets.start for streets in drawn}) > 15
    for streets in drawn:
        assert streets.slot(streets.start) not in streets.missing


def test_a_road_that_does_not_exist_is_replaced_by_one_that_does():
    corner = Place(0, 3, 0)  # the last junction of the first street
    assert list(grid().ways(corner)) == [RIGHT]
    assert [grid().taken(corner, choice)[0] for choice in (LEFT, STRAIGHT, RIGHT)] == [RIGHT] * 3
    streets = without(Place(1, 3, 0))
    assert list(streets.ways(START)) == [RIGHT, LEFT]
    assert streets.taken(START, STRAIGHT)[0] == RIGHT


def test_the_way_to_a_road_is_counted_in_roads():
    streets = grid()
    wanted = np.zeros(streets.count, dtype=bool)
    wanted[streets.road(START)] = True
    assert streets.roads_to(START, wanted) == 0
    assert streets.roads_to(streets.ways(START)[RIGHT], wanted) == 3  # round the block
