"""Disparities: no bias, honest variance, and refusals where a match cannot be trusted. About 2 s."""

import numpy as np
import pytest

from stereo_slam_env.frontend.matching import match_rows

from .textures import Waves, spread_points

SIZE = (500, 300)


def pair(disparity, noise=0.0, seed=0, row=0.0):
    rng, waves = np.random.default_rng(seed), Waves(seed)
    return waves.image(*SIZE, noise=noise, rng=rng), waves.image(*SIZE, (-disparity, row), noise, rng)


def matched(left, right, uv, low=0.5, high=60.0, **options):
    return match_rows(left, right, uv, np.full(len(uv), low), np.full(len(uv), high), **options)


def points(count=300, seed=0):
    uv = spread_points(np.random.default_rng(seed), count, *SIZE)
    uv[:, 0] = 90 + uv[:, 0] * 0.78
    return uv


@pytest.mark.parametrize("disparity", [3.25, 20.5, 41.7])
def test_disparities_have_no_bias(disparity):
    uv = points()
    match = matched(*pair(disparity), uv)
    assert match.accepted.mean() > 0.97
    error = match.disparity[match.accepted] - disparity
    assert abs(error.mean()) < 0.005
    assert error.std() < 0.03
    assert np.abs(match.v_right - uv[:, 1])[match.accepted].max() < 0.15


@pytest.mark.parametrize("noise", [4.0, 7.0, 12.0])
def test_the_variance_is_that_of_the_errors(noise):
    squares, errors = [], []
    for seed, disparity in enumerate((3.25, 20.5, 33.8, 41.7)):
        match = matched(*pair(disparity, noise, seed), points(seed=seed), min_score=0.7)
        error = (match.disparity - disparity)[match.accepted]
        errors.append(error)
        squares.append(error**2 / match.variance[match.accepted])
    assert abs(np.concatenate(errors).mean()) < 0.02
    assert 0.7 < np.concatenate(squares).mean() < 1.4


def test_a_narrow_range_around_the_forecast_is_enough():
    uv = points(100)
    near = match_rows(*pair(20.5), uv, np.full(100, 19.0), np.full(100, 23.0))
    assert near.accepted.mean() > 0.97
    assert np.abs(near.disparity - 20.5)[near.accepted].max() < 0.1
    beside = match_rows(*pair(20.5), uv, np.full(100, 4.0), np.full(100, 12.0))
    assert not beside.accepted.any()


def test_rows_may_be_off_by_a_little():
    uv = points(200)
    match = matched(*pair(20.5, noise=2.0, row=0.4), uv)
    assert match.accepted.mean() > 0.95
    assert np.median(match.v_right - uv[:, 1]) == pytest.approx(0.4, abs=0.05)
    assert abs((match.disparity - 20.5)[match.accepted].mean()) < 0.01
    strict = matched(*pair(20.5, noise=2.0), uv, rows=0)
    np.testing.assert_allclose(strict.v_right, uv[:, 1], atol=1e-3)


def test_on_a_slanted_edge_the_row_decides():
    v, u = np.indices((200, 300))
    rng = np.random.default_rng(0)
    left, right = (np.clip(128 + 60 * np.tanh((u - 150 + d - 0.7 * v) / 2.0) + rng.normal(0, 3, u.shape), 0, 255)
                   .astype(np.uint8) for d in (0.0, 12.3))  # fmt: skip
    rows = np.linspace(50, 150, 40)
    uv = np.stack([150 + 0.7 * rows, rows], axis=1)
    match = match_rows(left, right, uv, np.full(40, 5.0), np.full(40, 20.0), ratio=1.01, left_right_check=False)
    error = match.disparity - 12.3
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert 0.3 < np.mean(error**2 / match.variance) < 3.0


def test_a_repeated_pattern_is_refused():
    tile = Waves(1).image(25, 300)
    image = np.tile(tile, (1, 20))
    uv = points(100)
    assert not matched(image, np.roll(image, -10, axis=1), uv).accepted.any()
    assert matched(image, np.roll(image, -10, axis=1), uv, low=4.0, high=16.0).accepted.mean() > 0.9


def test_what_the_right_eye_does_not_see_is_refused():
    left, right = (Waves(seed, longest=15.0).image(*SIZE) for seed in (8, 9))
    assert matched(left, right, points()).accepted.mean() < 0.02


def test_a_match_must_lead_back():
    left, right = pair(20.0)
    uv = np.array([[300.0, 150.0]])
    # The same surroundings once more in the left image, further right and sharper: the right one belongs to that.
    left = left.copy()
    left[130:171, 320:361] = left[130:171, 280:321]
    left[140:161, 290:311] = np.clip(left[140:161, 290:311].astype(int) + np.random.default_rng(0).normal(
        0, 12, (21, 21)), 0, 255)  # fmt: skip
    assert matched(left, right, uv, left_right_check=False).accepted.all()
    assert not matched(left, right, uv).accepted.any()


def test_outside_the_right_image_there_is_no_match():
    match = matched(*pair(20.0), np.array([[12.0, 100.0], [250.0, 100.0], [250.0, -40.0]]), low=30.0, high=60.0)
    assert np.isnan(match.disparity[[0, 2]]).all()
    assert match.score[0] == match.score[2] == -1.0
    assert not match.accepted.any()


def test_no_points_and_bad_input():
    left, right = pair(5.0)
    assert matched(left, right, np.zeros((0, 2))).disparity.shape == (0,)
    with pytest.raises(ValueError, match="size of left"):
        match_rows(left, right[:50], np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    with pytest.raises(ValueError, match="disparity_low"):
        match_rows(left, right, np.full((2, 2), 50.0), np.zeros(3), np.ones(2))
