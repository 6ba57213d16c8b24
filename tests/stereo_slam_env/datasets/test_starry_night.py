"""The reader of "Starry Night", on a small folder with known motion and on the real one (1 s)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.datasets import load
from stereo_slam_env.datasets.starry_night import GYRO_DELAY, step_velocities

from ..real_data import real_data
from .small_folders import DT, starry_night


def reprojection_errors(recording):
    """Measured minus projected by truth, (n, 3) px."""
    landmarks = dict(zip(recording.landmarks.ids.tolist(), recording.landmarks.positions, strict=True))
    errors = []
    for frame in recording.frames:
        points_w = np.array([landmarks[i] for i in frame.observation.ids.tolist()]).reshape(-1, 3)
        errors.append(frame.observation.uvd - recording.camera.project(frame.truth.to_camera(points_w)))
    return np.vstack(errors)


def dead_reckoned(recording):
    """Positions that the odometry alone leads to, from the first frame on."""
    r, R, positions = np.zeros(3), Rotation.identity(), [np.zeros(3)]
    for before, frame in zip(recording.frames[:-1], recording.frames[1:], strict=True):
        dt, step = frame.timestamp - before.timestamp, frame.odometry
        r = r + dt * (R * Rotation.from_rotvec(0.5 * dt * step.angular)).as_matrix() @ step.linear
        R = R * Rotation.from_rotvec(dt * step.angular)
        positions.append(r)
    return np.array(positions)


@pytest.fixture(scope="module")
def real():
    return load(real_data("starry_night_a"))


def test_world_is_the_left_camera_at_the_first_step_used(tmp_path):
    recording = load(starry_night(tmp_path), first=2)
    np.testing.assert_allclose(recording.frames[0].truth.position, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(recording.frames[0].truth.orientation), [0.0, 0.0, 0.0, 1.0], atol=1e-12)
    assert recording.frames[0].odometry is None
    assert recording.frames[0].timestamp == pytest.approx(20.0 + 2 * DT)
    assert len(recording) == 10


def test_true_poses_project_true_landmarks_onto_the_measurements(tmp_path):
    np.testing.assert_allclose(reprojection_errors(load(starry_night(tmp_path), first=0)), 0.0, atol=1e-9)


def test_odometry_takes_the_camera_along_the_true_path(tmp_path):
    """Sign, step and lever arm at once: any of them wrong is off by centimetres."""
    recording = load(starry_night(tmp_path), first=2)
    truth = np.array([frame.truth.position for frame in recording.frames])
    np.testing.assert_allclose(dead_reckoned(recording), truth, atol=1e-4)


def test_late_readings_of_the_gyro_are_put_back_to_where_they_belong():
    times = 0.05 * np.arange(40)
    readings = -np.column_stack([times - GYRO_DELAY, 2.0 * (times - GYRO_DELAY), 0.0 * times])
    angular = step_velocities(times, np.zeros((40, 3)), readings)[1]
    middle = 0.5 * (times[:-1] + times[1:])
    ours = slice(1, 36)  # the last readings are not there yet
    np.testing.assert_allclose(angular[ours, 0], middle[:35], atol=1e-12)
    np.testing.assert_allclose(angular[ours, 1], 2.0 * middle[:35], atol=1e-12)


def test_a_landmark_that_is_seen_again_keeps_its_id(tmp_path):
    recording = load(starry_night(tmp_path), first=0)
    seen = [k for k, frame in enumerate(recording.frames) if 1 in frame.observation.ids]
    assert seen == [2, 3, 4, 5, 9, 10, 11]


def test_eyes_that_disagree_on_the_row_are_left_out_and_counted(tmp_path):
    recording = load(starry_night(tmp_path), first=0)
    assert recording.frames[4].observation.ids.tolist() == [0, 1]
    assert recording.source["dropped_row_difference"] == 1
    everything = load(tmp_path, first=0, max_row_difference=None)
    assert everything.frames[4].observation.ids.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"first": 11}, "first must be a whole number from 0 to 10, got 11"),
        ({"first": 2.0}, "first must be a whole number"),
        ({"first": 0, "sigma_d": 0.0}, "sigma_d must be a finite number > 0"),
        ({"first": 0, "sigma_angular": -1.0}, "sigma_angular must be a finite number > 0"),
        ({"first": 0, "max_row_difference": 0.0}, "max_row_difference must be a finite number > 0"),
    ],
)
def test_impossible_options_are_named(tmp_path, options, complaint):
    with pytest.raises(ValueError, match=complaint):
        load(starry_night(tmp_path), **options)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"y_k_j": np.zeros((4, 5, 3))}, r"array y_k_j has shape \(4, 5, 3\), expected \(4, 12, 3\)"),
        ({"theta_vk_i": np.zeros(3)}, "array theta_vk_i has shape"),
        ({"b": np.zeros(2)}, "array b has 2 numbers, expected 1"),
        ({"C_c_v": np.full((3, 3), np.nan)}, "array C_c_v has NaN or infinity"),
        ({"rho_v_c_v": None}, "lacks the array rho_v_c_v"),
        ({"t": np.zeros((1, 12))}, "timestamps must increase"),
    ],
)
def test_a_damaged_archive_is_named(tmp_path, changes, complaint):
    with pytest.raises(ValueError, match=complaint) as caught:
        load(starry_night(tmp_path, **changes), first=0)
    assert "\n" not in str(caught.value)


def test_real_residuals_are_the_noise_to_assume(real):
    everything = load(real_data("starry_night_a"), first=0, max_row_difference=None)
    assert len(reprojection_errors(everything)) == 6612
    np.testing.assert_allclose(reprojection_errors(everything).var(axis=0), [40.03, 162.2, 7.430], rtol=1e-3)
    rms = np.sqrt((reprojection_errors(real) ** 2).mean(axis=0))
    np.testing.assert_allclose(np.sqrt(np.diag(real.noise.R)), rms, rtol=0.02)


def test_real_odometry_drifts_slowly(real):
    truth = np.array([frame.truth.position for frame in real.frames])
    steps = np.linalg.norm(np.diff(truth, axis=0), axis=1)
    assert len(real) == 1100
    assert steps.sum() == pytest.approx(23.3, abs=0.1)
    assert np.linalg.norm(dead_reckoned(real)[-1] - truth[-1]) < 1.0
