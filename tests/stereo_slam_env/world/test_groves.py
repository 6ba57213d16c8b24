"""Groups beside a lane and nothing in between: how many, where, and that they are seen from the lane. About 5 s."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from stereo_slam_env.world import open_country
from stereo_slam_env.world.open_country import build_groves
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.road import road_along
from stereo_slam_env.world.routes import ROUTES

from .surfaces import sample_surface

SEEDS = range(4)


def build(route, seed):
    return build_groves(route, np.random.default_rng(seed))


def surface(scene):
    """Points all over what stands, above the ground; (N, 3)."""
    points = np.concatenate([sample_surface(p, 40, np.random.default_rng(0))[0] for p in scene.primitives])
    return points[points[:, 2] > 0.0]


@pytest.fixture(scope="module", params=sorted(ROUTES))
def route(request):
    return ROUTES[request.param]()


@pytest.fixture(scope="module")
def scenes(route):
    return [build(route, seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def straight_scenes():
    """The lane is y = 0 in S, driven towards +x."""
    return [build(ROUTES["straight"](), seed) for seed in SEEDS]


def test_there_are_about_twelve_landmarks_to_fifteen_metres(route, scenes):
    road = road_along(route)
    length = 0.5 * sum(piece.stop - piece.start for piece in road.stretches()) - 100.0  # the road goes on 130 m
    counts = [len(scene.landmark_points) for scene in scenes]
    slack = 0.12 if route.streets is None else 0.2  # where streets cross, there is less room
    assert np.mean(counts) == pytest.approx(12 * length / 15.0, rel=slack)
    assert all(0.8 < count / np.mean(counts) < 1.2 for count in counts)


def test_landmarks_are_off_the_lane_and_low(route, scenes):
    middle = cKDTree(road_along(route).points)
    for scene in scenes:
        away, height = middle.query(scene.landmark_points[:, :2])[0], scene.landmark_points[:, 2]
        assert away.min() > open_country.CLEARANCE
        assert away.max() < 24.0
        assert height.min() > 0.15
        assert height.max() < open_country.HIGHEST
        assert 0.8 < np.median(height) < 1.8


def test_nothing_stands_on_or_near_the_lane(route, scenes):
    middle = cKDTree(road_along(route).points)
    for scene in scenes:
        assert middle.query(surface(scene)[:, :2])[0].min() > open_country.CLEARANCE - 0.5  # a crown may reach over


def test_groups_are_ten_to_eighteen_metres_aside_and_six_metres_wide(straight_scenes):
    aside = np.concatenate([np.abs(scene.landmark_points[:, 1]) for scene in straight_scenes])
    assert aside.min() > 10.0 - open_country.SPREAD - 0.5
    assert aside.max() < 18.0 + open_country.SPREAD + 0.5
    assert np.mean(aside) == pytest.approx(14.0, abs=1.5)


def test_groups_stand_on_both_sides_with_gaps_and_beyond_both_ends(straight_scenes):
    left_shares = []
    for scene in straight_scenes:
        points = surface(scene)
        left_shares.append((scene.landmark_points[:, 1] > 0).mean())
        for side in (-1.0, 1.0):
            stations = np.arange(-25.0, 120.0, 0.5)
            there = cKDTree(points[points[:, 1] * side > 0, :1]).query(stations[:, None])[0] < 0.5
            assert 0.1 < there.mean() < 0.6  # nothing in between
        assert -38.0 < scene.landmark_points[:, 0].min() < -15.0
        assert 98.0 + 10.0 < scene.landmark_points[:, 0].max() < 98.0 + 40.0
    assert 0.3 < np.mean(left_shares) < 0.7


def test_most_landmarks_are_seen_from_the_lane(straight_scenes):
    scene = straight_scenes[0]
    world = PhysicsWorld()
    try:
        world.build(scene, (4.0, 1.8, 1.0))
        within = scene.landmark_points[(scene.landmark_points[:, 0] > 0.0) & (scene.landmark_points[:, 0] < 98.0)]
        seen = np.zeros(len(within), dtype=bool)
        for x in np.arange(0.0, 98.0, 4.0):
            seen |= world.visible(np.array([[x, 0.0, 1.65]]), within)
        assert seen.mean() > 0.75
    finally:
        world.close()
