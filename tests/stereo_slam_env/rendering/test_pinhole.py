"""View and projection matrices against the camera model they stand for."""

import numpy as np
import pytest

from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.rendering import pinhole

CAMERA = StereoCamera(300.0, 310.0, 170.0, 111.0, 0.5, 320, 240)
NEAR, FAR = 0.5, 300.0


def clip_coordinates(points, offset, position, R_sc):
    view = pinhole.view_matrix(position, R_sc)
    projection = pinhole.projection_matrix(CAMERA, NEAR, FAR, offset)
    homogeneous = np.column_stack([points, np.ones(len(points))])
    clip = homogeneous @ (projection @ view).T
    return clip[:, :3] / clip[:, 3:]


@pytest.fixture
def seen():
    rng = np.random.default_rng(0)
    position, R_sc = rng.normal(size=3), rotations.exp(rng.normal(size=3))
    p_c = rng.uniform([-3, -3, 5], [3, 3, 40], size=(50, 3))
    return p_c, p_c @ R_sc.T + position, position, R_sc


def test_opengl_samples_pixel_centres(seen):
    p_c, p_s, position, R_sc = seen
    ndc = clip_coordinates(p_s, pinhole.OPENGL_OFFSET, position, R_sc)
    u = (ndc[:, 0] + 1) / 2 * CAMERA.width - 0.5
    v = (1 - ndc[:, 1]) / 2 * CAMERA.height - 0.5
    np.testing.assert_allclose(np.column_stack([u, v]), CAMERA.project(p_c)[:, :2], atol=1e-9)


def test_depth_buffer_gives_metric_depth(seen):
    p_c, p_s, position, R_sc = seen
    ndc = clip_coordinates(p_s, pinhole.OPENGL_OFFSET, position, R_sc)
    np.testing.assert_allclose(pinhole.metric_depth(0.5 * (ndc[:, 2] + 1), NEAR, FAR), p_c[:, 2], rtol=1e-9)


def test_nothing_is_infinitely_far():
    buffer = np.array([1.0, np.nextafter(np.float32(1), np.float32(0)), 0.0])
    np.testing.assert_array_equal(pinhole.metric_depth(buffer, NEAR, FAR), [np.inf, np.inf, NEAR])


def test_supersampled_pixels_average_to_the_pixel_they_cover():
    fine = pinhole.supersampled(CAMERA, 3)
    p_c = np.array([[0.3, -0.2, 7.0]])
    coarse, dense = CAMERA.project(p_c)[0, :2], fine.project(p_c)[0, :2]
    np.testing.assert_allclose((dense + 0.5) / 3 - 0.5, coarse)
    assert (fine.width, fine.height) == (960, 720)
