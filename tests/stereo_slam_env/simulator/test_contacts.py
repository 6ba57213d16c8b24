"""Compiled collisions: a box touches what it touches in PyBullet (4 s)."""

import numpy as np
import pytest
from numba import njit

from filters.geometry import rotations
from stereo_slam_env.simulator.contacts import touches
from stereo_slam_env.simulator.rays import obstacles
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Box, Cylinder, Ground, Material, Scene, Sphere
from stereo_slam_env.world.vehicle import Car

GREY = Material((0.5, 0.5, 0.5))
HALF = tuple(0.5 * side for side in Car().size)
CLOSE = 1e-3
"""m; nearer than this to touching the two may differ."""


@njit
def touches_one(solid, R, at, half):
    return touches(solid, R, at, half)


def scene_of(*solids):
    return Scene(Ground((-50, -50), (50, 50), GREY), solids, (), np.zeros((0, 3)))


def random_solid(kind, rng):
    at = tuple(rng.uniform((-4.0, -4.0, 0.5), (4.0, 4.0, 3.0)))
    if kind == "box":
        return Box(at, tuple(rng.uniform(0.2, 4.0, 3)), rng.uniform(-3, 3), GREY)
    if kind == "cylinder":
        return Cylinder(at, tuple(at + rng.uniform(-2, 2, 3)), rng.uniform(0.05, 1.0), GREY)
    return Sphere(at, rng.uniform(0.1, 2.0), GREY)


def random_pose(rng):
    return rng.uniform((-4, -4, 0.6), (4, 4, 2)), rotations.exp(rng.normal(size=3) * (0.1, 0.1, 3.0))


@pytest.fixture(scope="module")
def world():
    world = PhysicsWorld()
    yield world
    world.close()


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere"])
def test_a_box_touches_what_it_touches_in_pybullet(kind, world):
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(500):
        solid = random_solid(kind, rng)
        world.build(scene_of(solid), Car().size)
        row = obstacles([solid]).solids[0]
        for _ in range(4):
            at, R = random_pose(rng)
            expected = world.ego_collides(at, R)
            pose = tuple(R.ravel()), tuple(at)
            hits += expected
            if touches_one(row, *pose, HALF) != expected:
                by = -CLOSE if expected else CLOSE
                assert touches_one(row, *pose, tuple(side - by for side in HALF)) == expected
    assert 300 < hits < 1700


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("gap", [-1e-6, 1e-6])
def test_faces_that_nearly_touch(axis, gap):
    box = Box((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), 0.0, GREY)
    at = np.array(box.center)
    at[axis] += 0.5 * box.size[axis] + HALF[axis] + gap
    assert touches_one(obstacles([box]).solids[0], tuple(np.eye(3).ravel()), tuple(at), HALF) == (gap < 0)


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere"])
def test_a_solid_inside_a_box_touches_it(kind):
    solid = random_solid(kind, np.random.default_rng(2))
    row = obstacles([solid]).solids[0]
    assert touches_one(row, tuple(np.eye(3).ravel()), tuple(row[:3]), (20.0, 20.0, 20.0))
    assert touches_one(row, tuple(np.eye(3).ravel()), tuple(row[:3] + 5.0), (20.0, 20.0, 20.0))


def separation(one, other):
    """Largest gap between two boxes along any axis that could separate them, m; below 0 where they touch."""
    (A, a, at), (B, b, to) = one, other
    axes = [*A.T, *B.T, *(np.cross(x, y) for x in A.T for y in B.T)]
    axes = [axis / np.linalg.norm(axis) for axis in axes if np.linalg.norm(axis) > 1e-9]
    return max(abs(n @ (to - at)) - a @ np.abs(A.T @ n) - b @ np.abs(B.T @ n) for n in axes)


def test_boxes_touch_where_no_axis_separates_them():
    """By the separating axis theorem, 8,000 pairs that nearly touch or nearly do not."""
    rng, wrong, touching_ones = np.random.default_rng(5), 0, 0
    for _ in range(8_000):
        size = rng.uniform(0.1, 5.0, 3)
        box = Box(tuple(rng.uniform(-100, 100, 3)), tuple(size), rng.uniform(-3, 3), GREY)
        R = rotations.exp(rng.normal(size=3) * (0.05, 0.05, 3.0))
        A = rotations.exp([0.0, 0.0, box.yaw])
        at = np.array(box.center) + A @ rng.uniform(-1, 1, 3) * (0.5 * size + 1.5)
        gap = separation((A, 0.5 * size, np.array(box.center)), (R, np.array(HALF), at))
        found = touches_one(obstacles([box]).solids[0], tuple(R.ravel()), tuple(at), HALF)
        touching_ones += found
        wrong += found != (gap < 0) and abs(gap) > 1e-9
    assert 800 < touching_ones < 7_200
    assert wrong == 0


def test_a_gap_between_boxes_is_no_contact():
    """6 mm between an edge of the car and the roof of another; a search that goes in a circle takes it for contact."""
    box = Box((120.5, 6.45, 0.56), (4.622178013502352, 1.76, 0.62), np.pi, GREY)
    R = [
        [0.7898050683216187, 0.6133518038861736, -0.002742029004238585],
        [-0.6133275450143663, 0.789802546640238, 0.006423382850592535],
        [0.006105454948971474, -0.003391458413640312, 0.9999756104174214],
    ]
    at = np.array([116.5490355120795, 8.344332611822733, 1.4150266141117827])
    A, half = rotations.exp([0.0, 0.0, box.yaw]), 0.5 * np.array(box.size)
    assert separation((A, half, np.array(box.center)), (np.array(R), np.array(HALF), at)) > 5e-3
    assert not touches_one(obstacles([box]).solids[0], tuple(np.ravel(R)), tuple(at), HALF)
