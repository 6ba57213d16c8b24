"""The reader of KITTI 07 tracks, on a small folder with known motion and on the real one (3 s)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.datasets import layout_of, load
from stereo_slam_env.datasets.kitti07_tracks import read
from stereo_slam_env.datasets.tracks import camera_velocities
from stereo_slam_env.evaluation.trajectory_metrics import ate_rigid, path_length

from ..real_data import real_data
from .small_folders import FRAMES, P_I, R_CI, kitti07


def dead_reckoned(recording):
    """R += R exp(w dt / 2) v dt: what the odometry alone says."""
    r, R, positions = np.zeros(3), Rotation.identity(), [np.zeros(3)]
    for before, frame in zip(recording.frames[:-1], recording.frames[1:], strict=True):
        dt, step = frame.timestamp - before.timestamp, frame.odometry
        r = r + (R * Rotation.from_rotvec(0.5 * dt * step.angular)).as_matrix() @ step.linear * dt
        R = R * Rotation.from_rotvec(dt * step.angular)
        positions.append(r)
    return np.array(positions)


@pytest.fixture(scope="module")
def real():
    return load(real_data("kitti07_tracks"))


def test_the_layout_is_recognised_by_its_files(tmp_path):
    assert layout_of(tmp_path) is None
    recording = load(kitti07(tmp_path / "drive"))
    assert recording.source["reader"] == "kitti07_tracks"
    assert len(recording) == FRAMES


def test_odometry_takes_the_camera_along_the_true_path(tmp_path):
    """Lever arm, frame and column convention at once: any of them wrong is off by far more than a centimetre."""
    recording = load(kitti07(tmp_path))
    truth = np.array([frame.truth.position for frame in recording.frames[:-2]])
    np.testing.assert_allclose(dead_reckoned(recording)[:-2], truth, atol=2e-3)
    assert recording.frames[0].odometry is None


def test_the_covariance_of_the_odometry_is_that_of_noisy_imu_velocities(tmp_path):
    """Camera velocities are linear in the IMU's: six unit changes give J, and J diag(sigma^2) J^T is the covariance."""
    changed = np.vstack([np.zeros((2, 6)), np.eye(6)])  # row 0 is of no step, row 1 is the base
    made = camera_velocities(changed[:, :3], changed[:, 3:], R_CI, P_I, sigma_linear=0.5, sigma_angular=0.05)
    steps = made[1:]
    J = np.array([[*step.linear, *step.angular] for step in steps[1:]]).T
    expected = J @ np.diag([0.25] * 3 + [0.0025] * 3) @ J.T
    np.testing.assert_allclose(steps[0].covariance, expected, atol=1e-12)
    assert np.abs(expected[:3, 3:]).max() > 1e-3  # the lever arm couples them


def test_measurements_are_left_pixel_and_disparity_with_the_right_row(tmp_path):
    recording = load(kitti07(tmp_path))
    seen = recording.frames[3].observation
    np.testing.assert_array_equal(seen.ids, [0, 1])
    np.testing.assert_allclose(seen.uvd, [[503.0, 153.0, 20.0], [700.0, 200.0, 10.0]])
    np.testing.assert_allclose(seen.v_right, [153.5, 199.0])


def test_disparities_that_are_not_positive_are_left_out_and_counted(tmp_path):
    recording = load(kitti07(tmp_path))
    np.testing.assert_array_equal(recording.frames[5].observation.ids, [0])
    assert recording.source["dropped_non_positive_disparity"] == 1


def test_frames_after_the_ground_truth_have_none(tmp_path):
    recording = load(kitti07(tmp_path))
    assert [frame.truth is None for frame in recording.frames] == [False] * (FRAMES - 2) + [True] * 2


def test_assumptions_are_stored_with_the_recording(tmp_path):
    recording = load(kitti07(tmp_path), sigma_px=2.0, sigma_linear=0.1, sigma_angular=0.01)
    assert recording.source["sigma_linear_m_s"] == 0.1
    assert recording.source["sigma_angular_rad_s"] == 0.01
    assert recording.noise.R[0, 0] == 4.0
    np.testing.assert_allclose(np.diag(recording.frames[1].odometry.covariance)[3:], 1e-4)


def test_nan_features_and_wrong_shapes_are_named(tmp_path):
    features = np.full((4, 2, FRAMES), -1.0)
    features[0, 1, 3] = np.nan
    with pytest.raises(ValueError, match=r"tracks\.npz: array features has NaN"):
        load(kitti07(tmp_path, features=features))
    with pytest.raises(ValueError, match=r"array linear_velocity has shape \(3, 5\), expected \(3, 8\)"):
        load(kitti07(tmp_path, linear_velocity=np.zeros((3, 5))))


def test_unsorted_times_are_refused(tmp_path):
    times = 0.1 * np.arange(FRAMES)[None]
    times[0, 4] = 0.05
    with pytest.raises(ValueError, match="timestamps must increase: frame 4"):
        load(kitti07(tmp_path, time_stamps=times))


def test_real_drive_has_the_published_size(real):
    assert len(real) == 1106
    with_truth = [frame for frame in real.frames if frame.truth is not None]
    assert len(with_truth) == 1101
    assert path_length(np.array([frame.truth.position for frame in with_truth])) == pytest.approx(694.7, abs=0.1)
    assert all((frame.observation.uvd[:, 2] > 0).all() for frame in real.frames)
    assert (
        sum(len(frame.observation) for frame in real.frames)
        + real.source["dropped_non_positive_disparity"]
        + real.source["dropped_repeats"]
        == 75_647
    )


def test_dead_reckoning_on_the_real_drive_is_as_far_off_as_published(real):
    truth = np.array([frame.truth.position for frame in real.frames if frame.truth is not None])
    as_stored = read(real_data("kitti07_tracks"))
    assert ate_rigid(dead_reckoned(as_stored)[: len(truth)], truth) == pytest.approx(15.7, abs=0.1)
    assert ate_rigid(dead_reckoned(real)[: len(truth)], truth) < 7.0  # less the bias that its tracks show
