"""A moving body hides and is touched, in each frame, as a thing that stands where it is then (3 s)."""

import numpy as np
import pytest

from filters.geometry import rotations
from stereo_slam_env.world.scene import Box, Cylinder, MovingBody, Sphere, TriangleMesh

from .vehicles import GREY, drive, scene_of, vehicle

PARTS = {
    "box": Box((1.0, 0.8, 1.2), (1.5, 0.6, 2.0), 0.4, GREY),
    "cylinder": Cylinder((1.0, 0.5, 0.2), (0.4, 1.6, 2.4), 0.5, GREY),
    "sphere": Sphere((-0.6, 0.9, 1.5), 0.8, GREY),
    "mesh": TriangleMesh(
        np.array([[1.0, 1.0, 0.2], [-1.0, 0.5, 0.4], [0.5, -1.0, 0.3], [0.2, 0.6, 2.6]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        GREY,
    ),
}
EVERYTHING = {"max_landmarks": 2000, "refill_below": 2000, "revisit": True}


def placed(part, position, yaw):
    """The part of a body at a pose, as a thing in the scene."""
    R = rotations.exp([0.0, 0.0, yaw])

    def at(point):
        return tuple(np.asarray(position) + R @ np.asarray(point))

    if isinstance(part, Box):
        return Box(at(part.center), part.size, part.yaw + yaw, GREY)
    if isinstance(part, Cylinder):
        return Cylinder(at(part.start), at(part.end), part.radius, GREY)
    if isinstance(part, Sphere):
        return Sphere(at(part.center), part.radius, GREY)
    return TriangleMesh(np.array([at(vertex) for vertex in part.vertices]), part.triangles, GREY)


def body(*parts, start=(9.0, 3.0, 0.0), end=(9.0, -3.0, 0.0), yaws=(0.3, 2.3), seconds=1.0):
    return MovingBody("car", parts, np.array([0.0, seconds]), np.array([start, end]), np.array(yaws))


def background():
    """Landmarks behind all that moves here, close together."""
    right, down = np.meshgrid(np.linspace(-12.0, 12.0, 30), np.linspace(-3.0, 1.2, 12))
    return np.column_stack([right.ravel(), down.ravel(), np.full(right.size, 28.0)])


@pytest.mark.parametrize("names", [*((name,) for name in PARTS), tuple(PARTS)], ids=str)
def test_it_hides_what_would_be_hidden_if_it_stood_there(names):
    parts = [PARTS[name] for name in names]
    moving = body(*parts)
    points, hidden = background(), set()
    frames = drive(vehicle(scene_of(points_w=points, moving=[moving]), policy=EVERYTHING), [[0, 0]] * 12)
    for k in (0, 1, 5, 10, 12):
        standing = scene_of(*(placed(part, *moving.pose_at(0.1 * k)) for part in parts), points_w=points)
        expected = drive(vehicle(standing, policy=EVERYTHING), [[0, 0]] * k)[-1].observation.ids
        np.testing.assert_array_equal(frames[k].observation.ids, expected)
        without = drive(vehicle(scene_of(points_w=points), policy=EVERYTHING), [[0, 0]] * k)[-1].observation.ids
        hidden.add(len(without) - len(expected))
    assert len(hidden) > 2
    assert max(hidden) > 5


@pytest.mark.parametrize("name", PARTS)
def test_it_is_touched_where_it_would_be_touched_if_it_stood_there(name):
    rng, touched = np.random.default_rng(1), 0
    for _ in range(25):
        start, yaw = (*rng.uniform((-5.0, -3.0), (4.0, 3.0)), 0.0), rng.uniform(-3.0, 3.0)
        moving = body(PARTS[name], start=start, end=(start[0] + 2.0, start[1], 0.0), yaws=(yaw, yaw + 1.0))
        one = vehicle(scene_of(moving=[moving]), steered=True)
        other = vehicle(scene_of(placed(PARTS[name], *moving.pose_at(0.1))), steered=True)
        for simulator in (one, other):
            drive(simulator, [[0, 0]])
        assert one.sensed.collision[0] == other.sensed.collision[0]
        assert one.sensed.failed[0] == one.sensed.collision[0]
        touched += bool(one.sensed.collision[0])
    assert 4 < touched < 22


def test_several_bodies_each_go_their_way():
    """The first comes to rest early; what is not solid hides nothing."""
    ghost = Box((0.0, 0.0, 2.0), (0.2, 30.0, 4.0), 0.0, GREY, solid=False)
    bodies = [
        body(PARTS["sphere"], start=(8.0, 2.0, 0.0), end=(8.0, 0.0, 0.0), seconds=0.3),
        body(PARTS["box"], ghost, start=(12.0, -4.0, 0.1), end=(12.0, 4.0, 0.1), seconds=1.0),
    ]
    frames = drive(vehicle(scene_of(points_w=background(), moving=bodies), policy=EVERYTHING), [[0, 0]] * 9)
    for k in (0, 2, 3, 4, 9):
        solids = [placed(one.parts[0], *one.pose_at(0.1 * k)) for one in bodies]
        standing = vehicle(scene_of(*solids, points_w=background()), policy=EVERYTHING)
        expected = drive(standing, [[0, 0]] * k)[-1].observation.ids
        np.testing.assert_array_equal(frames[k].observation.ids, expected)
