"""The change between W (right, down, forward) and the scene frame S (forward, left, up)."""

import numpy as np

from stereo_slam_env.world.frames import R_SW, WorldFrame


def test_axes_of_w_in_the_scene():
    right, down, forward = R_SW.T
    np.testing.assert_array_equal(right, [0, -1, 0])
    np.testing.assert_array_equal(down, [0, 0, -1])
    np.testing.assert_array_equal(forward, [1, 0, 0])
    assert np.linalg.det(R_SW) == 1.0


def test_the_first_camera_is_above_the_origin_of_the_scene():
    np.testing.assert_array_equal(WorldFrame(1.65).to_scene([0.0, 0.0, 0.0]), [0.0, 0.0, 1.65])
