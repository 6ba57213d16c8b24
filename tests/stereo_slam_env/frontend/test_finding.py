"""Finding landmarks in one pair (about 1 s)."""

import dataclasses

import numpy as np
import pytest

from stereo_slam_env.frontend.ego_motion import Step
from stereo_slam_env.frontend.finding import PairFinder
from stereo_slam_env.frontend.patches import cut_patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import Expectation, Outcome, new_tracks

from .drawn_street import CAMERA, DrawnStreet

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
