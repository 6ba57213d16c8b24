"""What is remembered of landmarks, and where they are expected (< 1 s)."""

from dataclasses import fields

import numpy as np
import pytest

from filters.contract.outputs import Forecast
from filters.geometry import rotations
from stereo_slam_env.frontend.ego_motion import continued
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import (
    MEMORY,
    by_forecast,
    by_motion,
    constant_velocity_covariance,
    new_tracks,
    searchable,
    step_of_forecast,
    sure_rows,
)

from .synthetic_steps import CAMERA, STEP, Cloud, tracks_of

SETTINGS = TrackerSettings()


@pytest.fixture
def pairs():
    return Cloud(sigma=0.05).pairs()


@pytest.fixture
def tracks(pairs):
    return tracks_of(pairs.first, pairs.R_first)


def forecast_of(tracks, uvd, variance=1.0):
    n = len(uvd)
    return Forecast(tracks.ids[:n], uvd, np.tile(variance * np.eye(3), (n, 1, 1)), np.ones(n, dtype=bool))


def test_standing_landmarks_come_to_where_the_motion_takes_them(tracks, pairs):
    expected = by_motion(CAMERA, tracks, STEP, np.zeros((6, 6)), None, 8)
    seen = CAMERA.in_view(pairs.second, 20)
    assert np.abs(expected.uvd - pairs.second)[seen].max() < 1.0
    assert expected.in_view[seen].all()


def test_the_ellipse_holds_the_noise_of_both_measurements_and_of_the_motion(tracks):
    sure = by_motion(CAMERA, tracks, STEP, np.zeros((6, 6)), None, 8)
    unsure = by_motion(CAMERA, tracks, STEP, constant_velocity_covariance(SETTINGS, 0.1), None, 8)
    assert (np.linalg.eigvalsh(sure.S - tracks.R) > 0).all()
    assert (np.linalg.eigvalsh(unsure.S - sure.S) > -1e-9).all()
    assert (unsure.S[:, 0, 0] > sure.S[:, 0, 0]).all()


def test_a_moving_landmark_goes_on_as_before():
    """It moved 5 px beside the scene in the last pair: 5 more are expected in this one."""
    pairs = Cloud(sigma=0.0001, count=30).pairs()
    tracks = tracks_of(pairs.second, pairs.R_second)
    tracks.measured[:, 2], tracks.measured_R[:, 2] = pairs.first, pairs.R_first
    tracks.measured[:, 1] = pairs.second
    tracks.measured[:5, 1, 0] += 5.0
    tracks.moving[:5] = True
    stays = by_motion(CAMERA, tracks_of(pairs.second, pairs.R_second), STEP, np.zeros((6, 6)), STEP, 8)
    goes = by_motion(CAMERA, tracks, STEP, np.zeros((6, 6)), STEP, 8)
    assert (goes.uvd - stays.uvd)[:5] == pytest.approx(np.tile([5.0, 0.0, 0.0], (5, 1)), abs=0.01)
    assert goes.uvd[5:] == pytest.approx(stays.uvd[5:])


def test_the_filters_word_goes_first_where_it_is_sure(tracks, pairs):
    own = by_motion(CAMERA, tracks, STEP, np.zeros((6, 6)), None, 8)
    told = forecast_of(tracks, own.uvd[:20] + 0.7)
    told.S[:5] *= 1e6
    expected = by_forecast(CAMERA, tracks, own, told, sure_rows(tracks, told, SETTINGS), SETTINGS)
    assert np.array_equal(expected.uvd[:5], own.uvd[:5])
    assert np.array_equal(expected.uvd[5:20], told.uvd[5:])
    assert np.array_equal(expected.S[5:20], told.S[5:])
    assert np.array_equal(expected.uvd[20:], own.uvd[20:])


def test_a_forecast_of_landmarks_nobody_follows_is_left_aside(tracks):
    own = by_motion(CAMERA, tracks, STEP, np.zeros((6, 6)), None, 8)
    strangers = Forecast(np.array([1, 2]), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.ones(2, dtype=bool))
    rows = sure_rows(tracks, strangers, SETTINGS)
    assert np.array_equal(by_forecast(CAMERA, tracks, own, strangers, rows, SETTINGS).uvd, own.uvd)
    assert step_of_forecast(CAMERA, tracks, strangers, rows) is None


def test_the_motion_that_a_forecast_means(tracks, pairs):
    sure = forecast_of(tracks, pairs.second, variance=0.01)
    step = step_of_forecast(CAMERA, tracks, sure, sure_rows(tracks, sure, SETTINGS))
    assert step.t == pytest.approx(STEP.t, abs=0.02)
    assert rotations.log(step.R) == pytest.approx(rotations.log(STEP.R), abs=1e-3)
    unsure = forecast_of(tracks, pairs.second, variance=1e6)
    assert step_of_forecast(CAMERA, tracks, unsure, sure_rows(tracks, unsure, SETTINGS)) is None


def test_an_ellipse_is_searchable_up_to_the_largest_half_axis():
    limit = SETTINGS.max_radius / np.sqrt(-2.0 * np.log(1.0 - SETTINGS.search_gate))  # chi-square with 2
    S = np.stack([np.diag([sigma**2, 1.0, 1e6]) for sigma in (0.99 * limit, 1.01 * limit)])
    assert searchable(S, SETTINGS).tolist() == [True, False]


def test_twice_the_time_is_twice_the_step():
    twice = continued(STEP, 2.0)
    assert twice.t == pytest.approx(2.0 * STEP.t)
    assert rotations.log(twice.R) == pytest.approx(2.0 * rotations.log(STEP.R))


def made(count=4, first_id=0):
    rng = np.random.default_rng(first_id)
    uvd, R = rng.uniform(10, 100, (count, 3)), np.tile(np.eye(3), (count, 1, 1))
    patches = rng.uniform(0, 255, (count, 23, 23)).astype(np.float32)
    return new_tracks(np.arange(first_id, first_id + count), patches, uvd, R, np.eye(3), np.ones(3))


def test_a_new_landmark_has_been_measured_once():
    tracks = made()
    assert np.array_equal(tracks.measured[:, 0], tracks.first_uvd)
    assert np.isnan(tracks.measured[:, 1:]).all()
    for count in (tracks.age, tracks.misses, tracks.strikes, tracks.moving, tracks.released):
        assert not count.any()


def test_the_next_pair_moves_the_memory_on_and_leaves_the_old_tracks_alone():
    tracks = made()
    later = tracks
    for _ in range(MEMORY - 1):
        later = later.next_pair()
    assert np.array_equal(later.measured[:, -1], tracks.first_uvd)
    assert np.isnan(later.measured[:, :-1]).all()
    assert np.array_equal(tracks.measured[:, 0], tracks.first_uvd)
    assert np.isnan(later.next_pair().measured).all()


def test_selecting_and_joining_keep_the_rows_together():
    tracks = made(6)
    again = tracks.select(slice(0, 2)).joined(tracks.select(np.arange(6) >= 2))
    for field in fields(tracks):
        assert np.array_equal(getattr(again, field.name), getattr(tracks, field.name), equal_nan=True)
    assert len(tracks.select(np.array([5, 1]))) == 2


@pytest.mark.parametrize("dt", [0.1, 0.5])
def test_a_step_changes_by_the_acceleration_times_the_square_of_the_time(dt):
    settings = TrackerSettings(sigma_acceleration=2.0, sigma_angular_acceleration=0.5)
    expected = np.diag(np.repeat([2.0 * dt**2, 0.5 * dt**2], 3) ** 2)
    np.testing.assert_allclose(constant_velocity_covariance(settings, dt), expected)
