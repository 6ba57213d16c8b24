"""Corners: on the corners, spread, away from what is there; landmarks found in one pair. About 2 s."""

import dataclasses

import cv2
import numpy as np
import pytest

from stereo_slam_env.frontend.ego_motion import Step
from stereo_slam_env.frontend.finding import PairFinder, detect_corners
from stereo_slam_env.frontend.patches import cut_patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import Expectation, Outcome, new_tracks

from .drawn_street import CAMERA, DrawnStreet
from .textures import Waves

SETTINGS = TrackerSettings()
STREET = DrawnStreet()
REST = Step(np.eye(3), np.zeros(3))


@pytest.fixture(scope="module")
def finder():
    pair = STREET.pair(0)
    return PairFinder(CAMERA, SETTINGS, pair.left, pair.right)


@pytest.fixture(scope="module")
def tracks(finder):
    """Landmarks of pair 0 whose surroundings lie on one board."""
    uvd, R = finder.corners(60, np.zeros((0, 2)))
    whole = STREET.on_one_board(0, uvd[:, :2])
    uvd, R = uvd[whole], R[whole]
    ids = np.arange(len(uvd), dtype=np.int64)
    return new_tracks(ids, cut_patches(finder.left, uvd[:, :2]), uvd, R, np.eye(3), np.zeros(3))


def expected_at(tracks, off=(0.0, 0.0, 0.0), sigma=1.0):
    uvd = tracks.first_uvd + np.array(off)
    S = np.tile(sigma**2 * np.eye(3), (len(uvd), 1, 1))
    return Expectation(uvd, S, CAMERA.in_view(uvd, SETTINGS.margin), REST)


def found(finder, tracks, expected, which=None):
    which = np.ones(len(tracks), dtype=bool) if which is None else which
    return finder.find(tracks, expected, np.eye(3), np.zeros(3), which)


def test_new_corners_have_their_true_disparity(finder):
    uvd, R = finder.corners(60, np.zeros((0, 2)))
    points, _ = STREET.points_at(0, uvd[:, :2])
    whole = STREET.on_one_board(0, uvd[:, :2])
    error = uvd[whole, 2] - STREET.seen(0, points)[whole, 2]
    assert whole.sum() > 30
    assert np.abs(error).max() < 0.3
    assert (np.linalg.eigvalsh(R) >= 0.99 * SETTINGS.sigma_floor**2).all()


def test_what_was_seen_is_found_where_it_is(finder, tracks):
    result = found(finder, tracks, expected_at(tracks, off=(1.5, -1.0, 1.0)))
    assert result.matched.mean() > 0.9
    off = result.uvd[result.matched] - tracks.first_uvd[result.matched]
    assert np.abs(off).max() < 0.2


@pytest.mark.parametrize("axis", [0, 1])
def test_the_ellipse_ends_where_the_gate_says(finder, tracks, axis):
    """At 99 % a landmark 2.5 sigma off is inside; one 5 sigma off is not."""
    inside, outside = np.zeros(3), np.zeros(3)
    inside[axis], outside[axis] = 5.0, 10.0
    assert found(finder, tracks, expected_at(tracks, inside, sigma=2.0)).matched.mean() > 0.9
    assert found(finder, tracks, expected_at(tracks, outside, sigma=2.0)).matched.mean() < 0.1


def test_only_what_is_wanted_and_in_view_is_looked_for(finder, tracks):
    which = np.arange(len(tracks)) % 2 == 0
    expected = expected_at(tracks)
    expected.in_view[0] = False
    result = found(finder, tracks, expected, which)
    assert (result.outcome[~which] == Outcome.OUT_OF_VIEW).all()
    assert result.outcome[0] == Outcome.OUT_OF_VIEW
    assert np.isnan(result.uvd[~result.matched]).all()
    assert np.isnan(result.R[~result.matched]).all()


def test_a_landmark_in_the_left_image_only_has_no_disparity(finder, tracks):
    blind = dataclasses.replace(finder, right=np.full_like(finder.right, 90))
    result = found(blind, tracks, expected_at(tracks))
    assert (result.outcome == Outcome.NO_DISPARITY).mean() > 0.9


def test_what_parallax_has_moved_is_believed_less(finder, tracks):
    """First seen from half a metre further left: relief then moves a match along u and, less so, along the row."""
    elsewhere = dataclasses.replace(tracks, first_position=tracks.first_position - np.array([0.5, 0.0, 0.0]))
    same, moved = found(finder, tracks, expected_at(tracks)), found(finder, elsewhere, expected_at(tracks))
    both = same.matched & moved.matched
    assert both.sum() > 20
    more = (moved.R - same.R)[both]
    assert (more[:, 0, 0] > 0).all()
    assert np.abs(more[:, 1, 1]).max() < 1e-3
    assert (np.abs(more[:, 0, 2]) > 0).all()


def test_near_disparities_are_believed_less(finder):
    uvd, R = finder.corners(60, np.zeros((0, 2)))
    relief = SETTINGS.sigma_relief * uvd[:, 2] ** 2 / CAMERA.disparity_constant
    assert (R[:, 2, 2] >= SETTINGS.sigma_floor**2 + relief**2).all()


def test_the_offset_of_the_rig_is_added_to_every_disparity(finder, tracks):
    shifted = dataclasses.replace(finder, settings=dataclasses.replace(SETTINGS, disparity_offset=0.4))
    plain, corrected = found(finder, tracks, expected_at(tracks)), found(shifted, tracks, expected_at(tracks))
    both = plain.matched & corrected.matched
    assert both.mean() > 0.9
    assert corrected.uvd[both, 2] - plain.uvd[both, 2] == pytest.approx(0.4, abs=0.02)
    assert corrected.uvd[both, :2] == pytest.approx(plain.uvd[both, :2])


def test_nothing_to_find_is_nothing_found(finder, tracks):
    none = tracks.select(slice(0))
    result = found(finder, none, expected_at(none))
    assert len(result.outcome) == 0
    uvd, variance, accepted = finder.disparities(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert len(uvd) == len(variance) == len(accepted) == 0


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
