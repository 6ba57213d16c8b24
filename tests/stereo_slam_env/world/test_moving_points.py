"""Which points are on bodies that move."""

import numpy as np

from stereo_slam_env.world.scene import Box, Material, MovingBody
from stereo_slam_env.world.traffic import MovingPoints

PAINT = Material((0.5, 0.5, 0.5))
CAR = MovingBody(
    "car",
    (Box((0.0, 0.0, 0.8), (4.0, 1.8, 1.4), 0.0, PAINT),),
    np.array([0.0, 10.0]),
    np.array([[10.0, 0.0, 0.0], [10.0, 50.0, 0.0]]),
    np.array([0.5 * np.pi, 0.5 * np.pi]),
)


def on_body(*points, time=0.0, bodies=(CAR,)):
    return MovingPoints(bodies).on_body(np.array(points), time).tolist()


def test_points_on_the_surface_go_with_the_body():
    assert on_body([10.9, 0.0, 1.0], [10.0, 2.0, 1.0], [10.0, 0.0, 1.5]) == [True, True, True]
    assert on_body([10.9, 0.0, 1.0], [10.9, 10.0, 1.0], time=2.0) == [False, True]


def test_the_body_is_turned():
    assert on_body([12.0, 0.0, 1.0], [10.0, 2.1, 1.0], [8.0, 0.0, 1.0]) == [False, True, False]


def test_the_road_below_and_what_is_unknown_are_not_on_it():
    assert on_body([10.0, 0.0, 0.0], [np.nan, np.nan, np.nan]) == [False, False]


def test_nothing_moves_in_a_scene_without_bodies():
    assert on_body([0.0, 0.0, 0.0], bodies=()) == [False]
