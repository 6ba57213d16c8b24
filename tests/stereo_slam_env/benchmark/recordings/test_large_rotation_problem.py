"""The tumbling camera of Zhang et al.: its noise is what it says, and who stays consistent (15 s)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.benchmark.recordings.reference_problem import relative_noise_loop
from stereo_slam_env.evaluation.filter_run import run_filter

OPTIONS = {"motion": "velocity-driven", "gate": None, "drop_unseen": False}


@pytest.fixture(scope="module")
def recording():
    return relative_noise_loop(0, 0.05)


def test_measurements_have_the_covariance_they_claim(recording):
    whitened = []
    for frame in recording.frames:
        seen, pose = frame.observation, frame.truth
        points_w = recording.landmarks.positions[seen.ids]
        exact = recording.camera.project(Rotation.from_quat(pose.orientation).inv().apply(points_w - pose.position))
        whitened.append(np.linalg.solve(np.linalg.cholesky(seen.R), (seen.uvd - exact)[:, :, None])[:, :, 0])
    errors = np.concatenate(whitened)
    assert len(errors) > 2000
    np.testing.assert_allclose(errors.T @ errors / len(errors), np.eye(3), rtol=0, atol=5 / np.sqrt(len(errors)))


def test_odometry_has_the_covariance_it_claims_and_leads_from_pose_to_pose(recording):
    whitened, gaps = [], []
    for before, after in zip(recording.frames, recording.frames[1:], strict=False):
        start, end = (Rotation.from_quat(frame.truth.orientation) for frame in (before, after))
        turn = (start.inv() * end).as_rotvec()
        half_way = start * Rotation.from_rotvec(0.5 * turn)
        linear = half_way.inv().apply(after.truth.position - before.truth.position)
        measured = np.concatenate([after.odometry.linear, after.odometry.angular])
        sigmas = np.sqrt(np.diag(after.odometry.covariance))
        whitened.append((measured - np.concatenate([linear, turn])) / sigmas)
        gaps.append(after.truth_velocity.linear - (after.truth.position - before.truth.position))
    np.testing.assert_allclose(gaps, 0.0, atol=1e-12)
    assert np.mean(np.square(whitened)) == pytest.approx(1.0, abs=0.1)


def test_as_many_landmarks_are_in_view_as_published():
    """The published sensor, 120 degrees off its axis and 25 m, sees 6.5 of 300 at a time on this path."""
    in_view = [len(frame.observation) for seed in range(2) for frame in relative_noise_loop(seed).frames]
    assert np.mean(in_view) == pytest.approx(6.5, abs=0.5)


def test_the_level_scales_the_noise_and_nothing_else():
    small, large = relative_noise_loop(1, 0.01, 10), relative_noise_loop(1, 0.05, 10)
    for one, other in zip(small.frames, large.frames, strict=True):
        np.testing.assert_array_equal(one.observation.ids, other.observation.ids)
        np.testing.assert_allclose(25 * one.observation.R, other.observation.R, rtol=1e-12)
        np.testing.assert_array_equal(one.truth.position, other.truth.position)


def test_points_can_be_worse_than_the_odometry():
    same, worse = relative_noise_loop(1, 0.05, 10), relative_noise_loop(1, 0.05, 10, point_level=0.15)
    for one, other in zip(same.frames[1:], worse.frames[1:], strict=True):
        np.testing.assert_allclose(9 * one.observation.R, other.observation.R, rtol=1e-12)
        np.testing.assert_array_equal(one.odometry.covariance, other.odometry.covariance)


@pytest.mark.parametrize(
    ("option", "value"), [("level", 0.0), ("point_level", -0.1), ("sight", -1.0), ("frames", 1), ("landmarks", 0)]
)
def test_impossible_options_are_named(option, value):
    with pytest.raises(ValueError, match=option):
        relative_noise_loop(0, **{option: value})


def test_only_the_standard_errors_are_overconfident():
    """Three short runs of large noise; the published figures are measured by benchmarks/large_rotation.py."""
    nees = {"right-invariant": [], "first-estimates": [], "so3": []}
    for seed in range(3):
        recording = relative_noise_loop(seed, 0.1, 120, sight=30.0)
        for error, found in nees.items():
            run = run_filter(recording, "euclidean", {**OPTIONS, "error": error})
            assert run.failure is None
            found.append(run.pose_nees[1:].mean() / 6)
    invariant, first, standard = (np.mean(found) for found in nees.values())
    assert invariant <= first < standard
    assert invariant < 1.15
    assert standard > 1.5
    assert (np.array(nees["so3"]) > nees["right-invariant"]).all()
