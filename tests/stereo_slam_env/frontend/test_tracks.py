"""What is remembered of each landmark."""

from dataclasses import fields

import numpy as np
import pytest

from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import MEMORY, constant_velocity_covariance, new_tracks


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
