"""Corners: on the corners, spread, away from what is there. About 1 s."""

import cv2
import numpy as np
import pytest

from stereo_slam_env.frontend.finding import detect_corners

from .textures import Waves

NONE = np.zeros((0, 2))


def board(width=400, height=240, square=40, low=60, high=190):
    """A chess board, drawn with an edge of one pixel; its corners lie between pixels."""
    v, u = np.indices((height, width))
    return np.where((u // square + v // square) % 2, high, low).astype(np.uint8)


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def test_corners_of_a_board_are_found_between_the_pixels():
    corners = detect_corners(board(), 200, NONE)
    true = np.array([(u, v) for u in range(40, 400, 40) for v in range(40, 240, 40)]) - 0.5
    nearest = distances(true, corners).min(axis=1)
    assert len(corners) == len(true)
    assert nearest.max() < 0.05


def test_every_cell_gets_one_before_any_gets_two():
    image = Waves(1).image(480, 288)
    image[:, 240:] = 128 + (image[:, 240:].astype(int) - 128) // 3  # weak, yet it gets its share
    corners = detect_corners(image, 60, NONE, margin=6)
    cells = {tuple(cell) for cell in (corners // 48).astype(int)}
    assert len(corners) == 60
    assert len(cells) >= 55
    again = detect_corners(image, 60, corners, margin=6)
    counts = np.bincount((again[:, 1] // 48 * 10 + again[:, 0] // 48).astype(int), minlength=60)
    first = np.bincount((corners[:, 1] // 48 * 10 + corners[:, 0] // 48).astype(int), minlength=60)
    assert counts[first == 0].sum() == (first == 0).sum() or (counts + first).max() <= 2


def test_they_keep_their_distance():
    image = Waves(2).image(480, 288)
    occupied = np.random.default_rng(0).uniform((0, 0), (480, 288), (40, 2))
    corners = detect_corners(image, 300, occupied, min_distance=14.0, margin=20)
    assert len(corners) > 80
    assert distances(corners, occupied).min() >= 14.0
    between = distances(corners, corners) + 1e3 * np.eye(len(corners))
    assert between.min() >= 14.0
    assert (corners >= 20 - 3).all()
    assert (corners <= np.array([480, 288]) - 1 - 20 + 3).all()


def test_nothing_on_flat_noise():
    noise = np.clip(np.random.default_rng(0).normal(128, 2.0, (240, 320)), 0, 255).astype(np.uint8)
    assert len(detect_corners(noise, 50, NONE)) == 0


def test_an_edge_is_no_corner():
    image = np.full((200, 300), 60, dtype=np.uint8)
    image[:, 150:] = 190
    assert len(detect_corners(image, 50, NONE)) == 0


def test_the_same_again_and_none_where_none_are_wanted():
    image = Waves(3).image(320, 240)
    np.testing.assert_array_equal(detect_corners(image, 50, NONE), detect_corners(image, 50, NONE))
    assert detect_corners(image, 0, NONE).shape == (0, 2)
    assert detect_corners(image[:20, :20], 5, NONE).shape == (0, 2)


@pytest.mark.parametrize("bad", [np.zeros(3), np.full((2, 2), np.nan)])
def test_bad_positions_are_named(bad):
    with pytest.raises(ValueError, match="occupied"):
        detect_corners(board(), 5, bad)


def test_a_distance_larger_than_the_image_leaves_one_corner():
    image = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
    assert len(detect_corners(image, 10, np.zeros((0, 2)), min_distance=1e9)) == 1


def ripples(gradient, period=48.0, width=320, height=240):
    """Bumps whose gradient along the weakest direction is nowhere larger, grey levels / px, over 10 px each way."""
    v, u = np.indices((height, width))
    k = 2.0 * np.pi / period
    along = k * np.cos(k * u) * np.sin(k * v), k * np.sin(k * u) * np.cos(k * v)
    a, b, c = (cv2.blur(x * y, (10, 10)) for x, y in ((along[0], along[0]), (along[0], along[1]), (along[1], along[1])))
    weakest = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
    amplitude = gradient / np.sqrt(weakest.max())
    return np.rint(128.0 + amplitude * np.sin(k * u) * np.sin(k * v)).astype(np.uint8)


@pytest.mark.parametrize(("gradient", "found"), [(1.4, False), (1.62, True), (3.0, True)])
def test_a_corner_has_a_gradient_of_one_and_a_half_grey_levels_a_pixel(gradient, found):
    assert (len(detect_corners(ripples(gradient), 50, NONE)) > 0) == found


@pytest.mark.parametrize("margin", [12, 30])
def test_the_margin_is_kept_at_all_sides_and_used_up_to_it(margin):
    corners = detect_corners(board(400, 240, square=10), 2000, NONE, margin=margin, min_distance=3.0)
    for axis, size in enumerate((400, 240)):
        assert margin - 3.5 <= corners[:, axis].min() <= margin + 12
        assert size - 1 - margin - 12 <= corners[:, axis].max() <= size - 1 - margin + 3.5
