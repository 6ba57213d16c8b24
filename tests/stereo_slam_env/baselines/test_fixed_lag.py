"""Fixed-lag smoothing: its window, its covariance by Monte Carlo, and its copies (15 s)."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from stereo_slam_env.benchmark.recordings.reference_problem import long_drive, short_turn

pytest.importorskip("gtsam", reason="needs the extra gtsam")

from stereo_slam_env.baselines.smoothers import BatchSmoother, FixedLagSmoother
from stereo_slam_env.evaluation.filter_run import run_filter

from .test_batch import driven, with_outliers


def smoother(recording, **options):
    return driven(FixedLagSmoother(recording.camera, recording.noise, **options), recording)


def test_a_window_that_holds_the_whole_drive_is_full_smoothing():
    recording = short_turn(0)
    full = driven(BatchSmoother(recording.camera, recording.noise, gate=None), recording).smooth()
    windowed = smoother(recording, gate=None, lag=100)
    np.testing.assert_allclose(windowed.pose.position, full.positions[-1], atol=2e-4)


def test_the_window_has_the_poses_of_its_lag_and_the_landmarks_they_saw():
    recording = long_drive(0, frames=25, landmarks=30)
    graph = smoother(recording, gate=None, lag=5)._graph
    poses = [k for k in range(25) if graph._values.exists(graph._pose_key(k))]
    assert poses == list(range(24 - 5, 25))
    assert graph._values.size() == len(poses) + len(graph._keys)
    recent = {i for frame in recording.frames[-6:] for i in frame.observation.ids.tolist()}
    assert 0 < len(graph._keys) <= len(recent)


def test_the_covariance_is_that_of_the_errors():
    """Pose NEES / 6 at the end of 16 turns, mean of a chi-square with 96 degrees of freedom: 99.9 % band."""
    nees = []
    for seed in range(16):
        recording = short_turn(seed)
        truth = recording.frames[-1].truth
        error, covariance = smoother(recording, gate=None, lag=4).pose_error(truth.position, truth.orientation)
        nees.append(error @ np.linalg.solve(covariance, error) / 6.0)
    assert 0.59 < np.mean(nees) < 1.53


@pytest.mark.parametrize("seed", range(4))
def test_long_tracks_of_far_points_neither_break_it_nor_lead_it_astray(seed):
    """In 20 s points come from 140 m to 80 m away; the EKF has errors of .12 m, a landmark held fixed led to 11 m."""
    recording = long_drive(seed, frames=200, landmarks=30)
    run = run_filter(recording, "fixed-lag", score_map=False)
    assert run.failure is None
    assert np.linalg.norm(run.positions - run.true_positions, axis=1).max() < 0.5
    assert 0.2 < np.nanmean(run.pose_nees[1:]) / 6.0 < 3.0


def test_steps_of_10_s_and_of_1_ms_leave_it_a_covariance():
    """Information of 1 / mm^2 beside that of 1 / (300 m)^2; told the same by QR where GTSAM's Cholesky is enough."""
    recording = short_turn(0)
    slam = smoother(recording, gate=None)
    graph = slam._graph
    keys = [graph._pose_key(graph.last - 1), graph._pose_key(graph.last)]
    J = graph.last_move_jacobian()
    expected = graph.covariance()
    assert_close(J @ graph._covariance_by_qr(keys) @ J.T, expected)
    for step in (10.0, 0.001, 0.1, 10.0, 0.001):
        slam.predict(step)
        slam.update(recording.frames[-1].observation)
        P = slam.pose.covariance
        assert np.isfinite(P).all()
        assert np.linalg.eigvalsh(P).min() > 0.0


def assert_close(actual, expected):
    """Covariances by their correlations."""
    sigmas = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(actual / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=1e-6)


def test_velocity_and_its_covariance_are_those_of_the_last_move():
    recording = short_turn(1)
    slam = smoother(recording, gate=None)
    truth, before = recording.frames[-1].truth, recording.frames[-2].truth
    dt = recording.frames[-1].timestamp - recording.frames[-2].timestamp
    error = (truth.position - before.position) / dt - slam.velocity.linear
    assert error @ np.linalg.solve(slam.velocity.covariance[:3, :3], error) < 16.3  # chi-square of 3, 99.9 %


def test_a_deep_copy_goes_its_own_way_to_the_same_bits():
    recording = short_turn(3)
    slam = smoother(recording)
    twin = copy.deepcopy(slam)
    for one in (slam, twin):
        one.predict(0.1)
        one.update(recording.frames[-1].observation)
    np.testing.assert_array_equal(slam.pose.position, twin.pose.position)
    np.testing.assert_array_equal(slam.pose.covariance, twin.pose.covariance)


def test_the_guide_keeps_outliers_out():
    recording = with_outliers(short_turn(4), 0.25)
    end = recording.frames[-1].truth.position
    defended, bare = (
        np.linalg.norm(smoother(recording, **options).pose.position - end)
        for options in ({"consensus": True}, {"gate": None})
    )
    assert defended < 0.2
    assert bare > 3 * defended


@pytest.mark.parametrize("lag", [1, 2.5, True])
def test_an_impossible_lag_is_refused(lag):
    recording = short_turn(0, frames=2)
    with pytest.raises(ValueError, match="lag must be"):
        FixedLagSmoother(recording.camera, recording.noise, lag=lag)
