"""Scripted routes: how far, how fast, which way."""

import numpy as np
import pytest

from stereo_slam_env.world.routes import RANDOM_ROUTES, loop, right_turn, straight, town


def test_scripted_routes_are_the_reference_drives():
    route = town()
    assert route.frames == 800
    assert route.length == pytest.approx(350, rel=0.03)
    assert (route.speeds.max(), route.speeds.min()) == pytest.approx((4.9, 3.0))
    assert np.abs(route.yaw_rates).max() == pytest.approx(0.29)
    headings = np.degrees(route.headings)
    assert headings[400] == pytest.approx(-80, abs=3)
    assert headings[-1] == pytest.approx(0, abs=1e-6)
    turn = right_turn()
    assert np.degrees(turn.headings[-1]) == pytest.approx(90, abs=0.1)
    assert turn.positions[-1, 0] > 10
    assert (turn.headings[:5] == 0).all()
    positions = straight().positions
    np.testing.assert_array_equal(positions[:, :2], 0)
    assert (np.diff(positions[:, 2]) > 0).all()


def test_the_loop_closes_and_goes_on_along_its_first_metres():
    route = loop()
    closed = 740
    assert np.degrees(route.headings[closed]) == pytest.approx(360.0, abs=0.1)
    np.testing.assert_allclose(route.positions[closed], 0.0, atol=0.01)
    again = route.positions[closed:]
    np.testing.assert_allclose(again, route.positions[: len(again)], atol=0.01)
    assert np.linalg.norm(again[-1]) > 15
    turns = route.turns(np.pi / 4)
    assert len(turns) == 4
    for first, last in turns:
        assert np.degrees(route.headings[last] - route.headings[first]) == pytest.approx(90.0, abs=0.1)


def test_where_a_route_repeats_itself_the_nearest_frame_is_that_of_the_same_pass():
    route = loop()
    there = route.positions[10]
    assert route.nearest(there, around=5) == 10
    assert route.nearest(there, around=735) == pytest.approx(750, abs=1)


@pytest.mark.parametrize("name", sorted(RANDOM_ROUTES))
def test_a_random_route_is_that_of_its_generator_and_one_a_car_can_drive(name):
    lengths, turns = [], []
    for seed in range(40):
        route, again = (RANDOM_ROUTES[name](np.random.default_rng(seed)) for _ in range(2))
        np.testing.assert_array_equal(route.positions, again.positions)
        assert np.abs(route.speeds * route.yaw_rates).max() < 3.0  # m/s^2: it asks for no more grip than a driver
        assert np.abs(np.diff(route.speeds)).max() < 0.3
        assert route.duration < (800.0 if name == "random-grid" else 120.0)
        lengths.append(route.length)
        turns.append(len(route.turns(0.3)))
    assert max(lengths) > (1.2 if name == "random-grid" else 1.4) * min(lengths)
    assert set(turns) <= {"random-loop": {4}, "random-town": {1, 2, 3, 4}, "random-grid": set(range(4, 80))}[name]
    assert len(set(turns)) > 1 or name == "random-loop"
    if name == "random-loop":
        ends = [np.linalg.norm(RANDOM_ROUTES[name](np.random.default_rng(s)).positions, axis=1) for s in range(40)]
        assert all(away[len(away) // 2 :].min() < 3.0 for away in ends)
