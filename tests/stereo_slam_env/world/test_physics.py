"""Rays, collisions and life cycle of the physics engine."""

import numpy as np
import pytest

from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Box, Cylinder, Ground, Material, Scene, Sphere

GREY = Material((0.5, 0.5, 0.5))
EGO = (4.0, 1.8, 1.0)


def scene_of(*solids):
    ground = Ground((-50.3, -50.3), (50.3, 50.3), GREY)
    return Scene(ground, solids, (), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


WALL = Box((10.0, 0.0, 2.0), (0.2, 4.0, 4.0), 0.0, GREY)
SLANTED_POLE = Cylinder((10.0, 6.0, 0.0), (12.0, 8.0, 5.0), 0.3, GREY)
BALL = Sphere((10.0, -6.0, 2.0), 1.0, GREY)


@pytest.fixture
def world():
    world = PhysicsWorld()
    yield world
    world.close()


def test_a_wall_hides_what_is_behind_it_and_not_itself(world):
    world.build(scene_of(WALL), EGO)
    eye = np.array([[0.0, 0.0, 1.6]])
    points = np.array([[20.0, 0.0, 1.6], [20.0, 12.0, 1.6], [9.9, 0.0, 1.6], [5.0, 0.0, 1.0], [20.0, 0.0, 9.0]])
    assert world.visible(eye, points).tolist() == [False, True, True, True, True]


@pytest.mark.parametrize(
    ("surface", "behind"),
    [
        ([10.6667, 6.6667 - 0.25, 2.0], [22.0, 14.0, 2.6]),
        ([9.0, -6.0, 2.0], [20.0, -12.0, 2.4]),
    ],
    ids=["pole", "ball"],
)
def test_round_solids_are_where_they_should_be(world, surface, behind):
    world.build(scene_of(SLANTED_POLE, BALL), EGO)
    eye = np.array([[0.0, 0.0, 1.6]])
    assert world.visible(eye, np.array([surface, behind])).tolist() == [True, False]


def test_a_point_must_be_seen_by_both_eyes(world):
    world.build(scene_of(Box((5.0, 0.0, 2.0), (0.1, 0.4, 4.0), 0.0, GREY)), EGO)
    point = np.array([[10.0, 0.0, 2.0]])
    straight, aside = np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 1.0, 2.0]])
    assert not world.visible(straight, point)[0]
    assert world.visible(aside, point)[0]
    assert not world.visible(np.concatenate([straight, aside]), point)[0]


def test_the_driving_car_hides_nothing(world):
    world.build(scene_of(WALL), EGO)
    world.ego_collides(np.array([5.0, 0.0, 1.6]), np.eye(3))
    assert world.visible(np.array([[0.0, 0.0, 1.6]]), np.array([[9.9, 0.0, 1.6]]))[0]


def test_the_car_collides_with_solids_but_not_with_the_road(world):
    world.build(scene_of(WALL), EGO)
    level = np.eye(3)
    assert not world.ego_collides(np.array([0.0, 0.0, 0.6]), level)
    assert not world.ego_collides(np.array([7.8, 0.0, 0.6]), level)
    assert world.ego_collides(np.array([8.1, 0.0, 0.6]), level)
    assert not world.ego_collides(np.array([8.1, 3.2, 0.6]), level)
    assert not world.ego_collides(np.array([0.0, 0.0, 0.6]), level)


def test_no_points_is_no_question(world):
    world.build(scene_of(WALL), EGO)
    assert world.visible(np.zeros((2, 3)), np.zeros((0, 3))).shape == (0,)


def test_close_unused_and_twice_and_build_again():
    world = PhysicsWorld()
    world.close()
    world.build(scene_of(WALL), EGO)
    world.close()
    world.close()
    with pytest.raises(RuntimeError, match="not built"):
        world.visible(np.zeros((1, 3)), np.ones((1, 3)))
    world.build(scene_of(), EGO)
    assert world.visible(np.zeros((1, 3)) + 1.0, np.array([[20.0, 0.0, 1.6]]))[0]
    world.close()


def test_pictures_need_a_drawn_world(world):
    world.build(scene_of(WALL), EGO)
    with pytest.raises(RuntimeError, match="call dress"):
        world.camera_image(np.eye(4), np.eye(4), 8, 8, (0, 0, 1))
