"""Truth from the render: to the resolution of the depth buffer on planes, and nothing where there is an edge."""

import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.rendering.pinhole import depth_at, points_at

from .planes import AHEAD, CAMERA, Wall, both_back_ends, drawing, scene_of

RESOLUTION = 2.7e-7
"""1/m, of 1/z from either depth buffer with the near plane at 0.5 m: 0.06 mm at 15 m, 1.3 mm at 70 m."""
SHAPE = (40, 60)


def affine_depth(a, b, c):
    rows, columns = np.indices(SHAPE)
    return 1.0 / (a * columns + b * rows + c)


def random_pixels(count, margin=2.0):
    rng = np.random.default_rng(3)
    return rng.uniform(margin, np.array([CAMERA.width, CAMERA.height]) - 1.0 - margin, (count, 2))


def test_between_the_pixels_of_a_plane_the_depth_is_exact():
    depth = affine_depth(2e-4, -3e-4, 0.05)
    uv = np.random.default_rng(0).uniform(1.0, [SHAPE[1] - 2.001, SHAPE[0] - 2.001], (200, 2))
    np.testing.assert_allclose(depth_at(depth, uv), 1.0 / (uv @ [2e-4, -3e-4] + 0.05), rtol=1e-12)


@both_back_ends
@pytest.mark.parametrize("distance", [15.0, 30.0, 70.0, 150.0])
def test_a_rendered_plane_gives_the_depth_to_the_resolution_of_the_buffer(name, distance):
    wall = Wall(distance, 0.4)
    pose = Pose(np.array([0.2, -0.3, 0.1]), rotations.exp_quaternion([0.05, -0.1, 0.2]))
    with drawing(name, scene_of(wall.box)) as renderer:
        depth = renderer.render_pair(pose).depth
    uv = random_pixels(2000)
    inverse = uv @ wall.inverse_depth(CAMERA, pose)[:2] + wall.inverse_depth(CAMERA, pose)[2]
    z = depth_at(depth, uv)
    on_wall = np.abs(z * inverse - 1.0) < 0.01
    assert on_wall.mean() > 0.4
    assert np.abs(1.0 / z[on_wall] - inverse[on_wall]).max() < RESOLUTION


@both_back_ends
def test_landmarks_are_where_they_are_seen_from_elsewhere(name):
    wall = Wall(18.0, 0.3)
    later = Pose(np.array([0.5, -0.1, 4.0]), rotations.exp_quaternion([0.02, 0.12, -0.05]))
    with drawing(name, scene_of(wall.box)) as renderer:
        now, then = renderer.render_pair(AHEAD).depth, renderer.render_pair(later).depth
    uv = random_pixels(500)
    points = points_at(CAMERA, AHEAD, now, uv)
    known = np.isfinite(points).all(axis=1)
    assert known.mean() > 0.8
    np.testing.assert_allclose(CAMERA.project(AHEAD.to_camera(points[known]))[:, :2], uv[known], atol=1e-9)
    uvd = CAMERA.project(later.to_camera(points))
    seen = known & CAMERA.in_view(uvd, margin=3.0)
    disparity = CAMERA.disparity_constant / depth_at(then, uvd[seen, :2])
    smooth = np.isfinite(disparity)
    assert smooth.sum() > 100
    np.testing.assert_allclose(disparity[smooth], uvd[seen][smooth, 2], atol=1e-3)


def test_at_an_edge_at_the_border_and_outside_there_is_no_truth():
    depth = affine_depth(1e-4, 0.0, 0.05)
    depth[:, 30:] = 5.0
    columns = np.array([26.0, 28.2, 29.5, 30.9, 33.0])
    z = depth_at(depth, np.column_stack([columns, np.full(5, 20.3)]))
    np.testing.assert_array_equal(np.isnan(z), [False, True, True, True, False])
    outside = [[0.5, 20.0], [58.5, 20.0], [30.0, 0.9], [30.0, 38.2], [-5.0, 20.0], [30.0, 400.0]]
    assert np.isnan(depth_at(affine_depth(0.0, 0.0, 0.02), outside)).all()
    assert depth_at(depth, np.zeros((0, 2))).shape == (0,)
    for wrong in ([[np.nan, 3.0]], [[1.0, 2.0, 3.0]]):
        with pytest.raises(ValueError, match="uv"):
            depth_at(depth, wrong)


def test_the_sky_is_infinitely_far_but_not_at_its_border():
    depth = affine_depth(0.0, 0.0, 0.02)
    depth[:20] = np.inf
    z = depth_at(depth, [[10.5, 10.5], [10.5, 18.5], [10.5, 30.5]])
    assert np.isinf(z[0])
    assert np.isnan(z[1])
    assert z[2] == pytest.approx(50.0)
    assert np.isnan(points_at(CAMERA, AHEAD, depth, [[10.5, 10.5]])).all()
