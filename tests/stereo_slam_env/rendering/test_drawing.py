"""What pictures of stereo views are made of (0.1 s)."""

import numpy as np

from stereo_slam_env.rendering.overlay import both_views, caption_bar, disparity_colors, fixed_point


def test_near_is_red_far_is_blue_and_none_is_none():
    far, near = disparity_colors(np.array([3.0, 80.0])).astype(int)
    assert far[2] > far[0]
    assert near[0] > near[2]
    assert disparity_colors(np.zeros(0)).shape == (0, 3)
    assert np.array_equal(disparity_colors(np.array([-5.0, 0.0, 1.0])), np.tile(far, (3, 1)))


def test_wide_views_are_stacked_and_others_side_by_side():
    wide, square = np.zeros((100, 300, 3), np.uint8), np.zeros((100, 120, 3), np.uint8)
    assert both_views(wide, wide).shape == (203, 300, 3)
    assert both_views(square, square).shape == (100, 243, 3)


def test_a_caption_fills_the_width_and_coordinates_keep_their_fractions():
    assert caption_bar(700, ["a", "b"]).shape[1] == 700
    np.testing.assert_array_equal(fixed_point(np.array([1.25, -0.5])), [20, -8])
