"""Compiled occlusion hides what PyBullet's rays hide, but for rays that graze something (3 s)."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

from stereo_slam_env.simulator.rays import _sort, obstacles, visible
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.routes import named_route
from stereo_slam_env.world.scene import Box, Cylinder, Ground, Material, Scene, Sphere
from stereo_slam_env.world.surroundings import build_scene
from stereo_slam_env.world.vehicle import Car

ROOT = Path(__file__).resolve().parents[3]
GRAZING = 0.002
"""m; Bullet finds a hit by iteration, of what passes within about a millimetre."""
MOST_DIFFERENT = 1e-3
GREY = Material((0.5, 0.5, 0.5))


def grown(solid, by):
    """The solid with its surface moved outwards."""
    if isinstance(solid, Box):
        return replace(solid, size=tuple(max(side + 2 * by, 1e-4) for side in solid.size))
    if isinstance(solid, Cylinder):
        start, end = np.array(solid.start), np.array(solid.end)
        along = by * (end - start) / np.linalg.norm(end - start)
        ends = {"start": tuple(start - along), "end": tuple(end + along)}
        return replace(solid, radius=max(solid.radius + by, 1e-4), **ends)
    return replace(solid, radius=max(solid.radius + by, 1e-4))


def is_grazing(solids, cameras, points):
    """Whether what hides each point changes when all solids grow or shrink a little, or the point moves a little."""
    larger, smaller = (obstacles([grown(solid, by) for solid in solids]) for by in (GRAZING, -GRAZING))
    grazing = visible(larger, cameras, points) != visible(smaller, cameras, points)
    usual = obstacles(solids)
    seen = visible(usual, cameras, points)
    for step in GRAZING * np.concatenate([np.eye(3), -np.eye(3)]):
        grazing |= visible(usual, cameras, points + step) != seen
    return grazing


def test_random_solids_and_rays():
    """Solids at any slant; cameras and points anywhere, also within solids.

    But no camera within a ball, where Bullet hits the ball if the ray begins towards its centre: nothing hides what is
    around itself, as Bullet has it for boxes and cylinders.
    """
    rng = np.random.default_rng(0)
    world, number, different = PhysicsWorld(), 0, 0
    for _ in range(40):
        solids = []
        for _ in range(12):
            at = rng.uniform((-10, -10, 0.3), (10, 10, 5))
            solids.append(Box(tuple(at), tuple(rng.uniform(0.2, 3.0, 3)), rng.uniform(-3, 3), GREY))
            at = rng.uniform((-10, -10, 0.3), (10, 10, 5))
            end = at + rng.uniform(-3, 3, 3)
            solids.append(Cylinder(tuple(at), tuple(end), rng.uniform(0.05, 1.0), GREY))
            solids.append(Sphere(tuple(rng.uniform((-10, -10, 0.3), (10, 10, 5))), rng.uniform(0.1, 1.5), GREY))
        world.build(Scene(Ground((-50, -50), (50, 50), GREY), tuple(solids), (), np.zeros((0, 3))), Car().size)
        shapes = obstacles(solids)
        points = rng.uniform((-15, -15, 0.2), (15, 15, 6), (200, 3))
        for cameras in rng.uniform((-15, -15, 0.5), (15, 15, 4), (5, 1, 3)):
            if any(np.linalg.norm(cameras - ball.center) <= ball.radius for ball in solids[2::3]):
                continue
            expected, found = world.visible(cameras, points), visible(shapes, cameras, points)
            wrong = expected != found
            assert is_grazing(solids, cameras, points[wrong]).all()
            number, different = number + len(points), different + wrong.sum()
    world.close()
    assert different <= MOST_DIFFERENT * number


def test_without_solids_only_the_ground_hides():
    cameras, points = np.array([[0.0, 0.0, 1.5]]), np.array([[5.0, 0.0, 1.0], [5.0, 0.0, -1.0], [0.0, 3.0, 9.0]])
    assert visible(obstacles([]), cameras, points).tolist() == [True, False, True]


def test_many_solids_in_one_place():
    """A tree of equal boxes is as good as any."""
    walls = [Box((5.0, 0.0, 1.0), (0.2, 2.0, 2.0), 0.0, GREY)] * 100
    points = np.array([[10.0, 0.0, 1.0], [10.0, 5.0, 1.0], [4.9, 0.5, 1.0], [-10.0, 0.0, 1.0]])
    assert visible(obstacles(walls), np.array([[0.0, 0.0, 1.0]]), points).tolist() == [False, True, True, True]


@numba.njit
def sort_boxes(boxes, order, axis):
    """A kernel can be called by compiled code only."""
    _sort(boxes, order, axis)


@pytest.mark.parametrize("middles", [3, 1 << 30], ids=["ties", "distinct"])
def test_boxes_are_sorted_by_their_middles(middles):
    """A permutation of the same numbers, ascending; a wrong order would only make the tree slower."""
    rng = np.random.default_rng(0)
    for length in (0, 1, 2, 3, 4, *rng.integers(0, 301, 60)):
        boxes = rng.integers(0, middles, (400, 6)).astype(np.float64)
        numbers = rng.permutation(400)[:length]
        for axis in range(3):
            order = numbers.copy()
            sort_boxes(boxes, order, axis)
            assert sorted(order) == sorted(numbers)
            assert (np.diff(boxes[order, axis] + boxes[order, 3 + axis]) >= 0.0).all()


PLAINLY = """
import numpy as np
from tests.stereo_slam_env.simulator.test_rays import some_seen
from stereo_slam_env.simulator.rays import is_seen
assert not hasattr(is_seen, "py_func")
print(*some_seen().tolist())
"""


def some_seen():
    """Which of 500 points are seen from both cameras among 300 solids of a street."""
    scene = build_scene("street", named_route("right-turn"), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    points = rng.uniform((-10, -15, -0.5), (40, 15, 6), (500, 3))
    return visible(obstacles([*scene.solids][:300]), np.array([[0.0, 0.0, 1.65], [0.0, -0.54, 1.65]]), points)


def test_plain_python_sees_what_machine_code_does():
    """Boxes of the tree are entered by vector instructions, or by NumPy; the points of scenes are the same as well."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PLAINLY]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    seen = some_seen()
    assert done.stdout.split() == [str(each) for each in seen.tolist()]
    assert 50 < seen.sum() < 450
