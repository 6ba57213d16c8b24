"""The readers of single data sets of tracks, on small folders with known motion and on the real ones (5 s)."""

import re
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import StereoObservation
from filters.contract.extras import install_command
from stereo_slam_env import evaluate
from stereo_slam_env.datasets import layouts, load
from stereo_slam_env.datasets.layouts import KnownRecording, digest
from stereo_slam_env.datasets.single_data_sets import GYRO_DELAY, KITTI07_TRACKS
from stereo_slam_env.datasets.track_files import step_velocities
from stereo_slam_env.evaluation.trajectory_metrics import ate_rigid, path_length
from stereo_slam_env.recording.recording import Reference

from ..real_data import real_data
from .small_folders import DT, FRAMES, kitti00, kitti07, starry_night


def dead_reckoned(recording):
    """Positions that the odometry alone leads to, from the first frame on: R += R exp(w dt / 2) v dt."""
    r, R, positions = np.zeros(3), Rotation.identity(), [np.zeros(3)]
    for before, frame in zip(recording.frames[:-1], recording.frames[1:], strict=True):
        dt, step = frame.timestamp - before.timestamp, frame.odometry
        r = r + dt * (R * Rotation.from_rotvec(0.5 * dt * step.angular)).as_matrix() @ step.linear
        R = R * Rotation.from_rotvec(dt * step.angular)
        positions.append(r)
    return np.array(positions)


@pytest.fixture(scope="module")
def real_07():
    return load(real_data("kitti07_tracks"))


@pytest.fixture(scope="module")
def real_00():
    return load(real_data("kitti00_stereo_tracks"))


@pytest.fixture(scope="module")
def real_night():
    return load(real_data("starry_night_a"))


# --- KITTI 07 tracks --------------------------------------------------------------------------------------------------


def test_odometry_takes_the_camera_along_the_true_path(tmp_path):
    """Lever arm, frame and column convention at once: any of them wrong is off by far more than a centimetre."""
    recording = load(kitti07(tmp_path))
    truth = np.array([frame.truth.position for frame in recording.frames[:-2]])
    np.testing.assert_allclose(dead_reckoned(recording)[:-2], truth, atol=2e-3)
    assert recording.frames[0].odometry is None


def test_measurements_are_left_pixel_and_disparity_with_the_right_row(tmp_path):
    recording = load(kitti07(tmp_path))
    seen = recording.frames[3].observation
    np.testing.assert_array_equal(seen.ids, [0, 1])
    np.testing.assert_allclose(seen.uvd, [[503.0, 153.0, 20.0], [700.0, 200.0, 10.0]])
    np.testing.assert_allclose(seen.v_right, [153.5, 199.0])
    np.testing.assert_array_equal(recording.frames[5].observation.ids, [0])  # one of d <= 0 is left out, and counted
    assert recording.source["dropped_non_positive_disparity"] == 1
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


def test_real_drive_has_the_published_size(real_07):
    assert len(real_07) == 1106
    with_truth = [frame for frame in real_07.frames if frame.truth is not None]
    assert len(with_truth) == 1101
    assert path_length(np.array([frame.truth.position for frame in with_truth])) == pytest.approx(694.7, abs=0.1)
    assert all((frame.observation.uvd[:, 2] > 0).all() for frame in real_07.frames)
    dropped = real_07.source["dropped_non_positive_disparity"] + real_07.source["dropped_repeats"]
    assert sum(len(frame.observation) for frame in real_07.frames) + dropped == 75_647


def test_dead_reckoning_on_the_real_drive_is_as_far_off_as_published(real_07):
    truth = np.array([frame.truth.position for frame in real_07.frames if frame.truth is not None])
    as_stored = KITTI07_TRACKS.read(real_data("kitti07_tracks"))
    assert ate_rigid(dead_reckoned(as_stored)[: len(truth)], truth) == pytest.approx(15.7, abs=0.1)
    assert ate_rigid(dead_reckoned(real_07)[: len(truth)], truth) < 7.0  # less the bias that its tracks show


# --- KITTI 00 tracks, and their copy in the gtsam wheel ---------------------------------------------------------------


def test_truth_starts_on_the_odometry_and_keeps_its_shape(tmp_path):
    truth = [frame.truth for frame in load(kitti00(tmp_path)).frames]
    np.testing.assert_allclose(truth[0].position, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(truth[0].orientation), [0.0, 0.0, 0.0, 1.0], atol=1e-9)
    # The truth bends to the right: 0.01 k^2 m.
    np.testing.assert_allclose(truth[-1].position, [0.01 * 20**2, 0.0, 14.0], atol=1e-9)


def test_frames_whose_ground_truth_is_known_to_be_wrong_have_none(tmp_path, monkeypatch):
    folder = kitti00(tmp_path)
    made = KnownRecording(Reference("ins", "By the makers."), 16)
    positions = np.loadtxt(folder / "poses.txt")[:, 3::4]
    monkeypatch.setattr(layouts, "KNOWN", {digest(positions): made})
    recording = load(folder)
    assert [frame.truth is None for frame in recording.frames] == [True] * 16 + [False] * 4
    first, *_, last = [frame.truth for frame in recording.frames[16:]]
    np.testing.assert_allclose(first.position, [0.0, 0.0, 0.7 * 16], atol=1e-9)
    np.testing.assert_allclose(last.position, [0.01 * (20**2 - 16**2), 0.0, 14.0], atol=1e-9)
    assert "onto the stereo odometry of frame 16" in recording.truth_from.description


def test_an_absent_frame_is_a_longer_step(tmp_path):
    times = [frame.timestamp for frame in load(kitti00(tmp_path)).frames]
    np.testing.assert_allclose(np.diff(times)[-3:], [0.1, 0.2, 0.1], atol=1e-9)


def test_one_common_row_is_no_measurement_of_the_right_eye(tmp_path):
    frame = load(kitti00(tmp_path)).frames[0]
    assert frame.observation.v_right is None
    assert frame.odometry is None
    np.testing.assert_allclose(frame.observation.uvd[0], [650.0, 190.0, 700.0 * 0.5 / 30.0], atol=1e-6)


def test_a_frame_without_a_pose_is_named(tmp_path):
    folder = kitti00(tmp_path)
    rows = np.loadtxt(folder / "stereo_factors.txt")
    rows[0, 0] = 18
    np.savetxt(folder / "stereo_factors.txt", rows)
    with pytest.raises(ValueError, match=r"stereo_factors\.txt has observations of frame 18, which has no pose"):
        load(folder)


@pytest.mark.parametrize("file", ["times.txt", "poses.txt"])
def test_a_table_that_ends_before_the_last_frame_is_named(tmp_path, file):
    folder = kitti00(tmp_path)
    np.savetxt(folder / file, np.loadtxt(folder / file)[:-1])
    with pytest.raises(ValueError, match=r"vo_poses\.txt has frame 20, times\.txt and poses\.txt end at 19"):
        load(folder)


def test_tracks_without_times_have_a_rate(tmp_path):
    folder = kitti00(tmp_path)
    with pytest.raises(ValueError, match=r"times\.txt says when the frames were taken: leave rate out, got 10"):
        load(folder, rate=10.0)
    with_times = [frame.timestamp for frame in load(folder).frames]
    (folder / "times.txt").unlink()
    with pytest.raises(ValueError, match=r"has no times\.txt: give the frames a second, rate=10 \(--rate 10\)"):
        load(folder)
    for rate in (0.0, -10.0, float("nan")):
        with pytest.raises(ValueError, match="rate must be"):
            load(folder, rate=rate)
    np.testing.assert_allclose([frame.timestamp for frame in load(folder, rate=10.0).frames], with_times)


def test_nan_rows_and_unsorted_ids_are_named(tmp_path):
    folder = kitti00(tmp_path)
    poses = np.loadtxt(folder / "vo_poses.txt")
    np.savetxt(folder / "vo_poses.txt", poses[::-1])
    with pytest.raises(ValueError, match=r"vo_poses\.txt: frame ids must increase"):
        load(folder)
    poses[3, 5] = np.nan
    np.savetxt(folder / "vo_poses.txt", poses)
    with pytest.raises(ValueError, match=r"vo_poses\.txt has NaN or infinity in 1 rows, the first is row 3"):
        load(folder)


def test_real_drive_is_thinned_to_long_tracks(real_00):
    counts = [len(frame.observation) for frame in real_00.frames]
    assert len(real_00) == 135
    assert max(counts) == 100
    everything = load(real_data("kitti00_stereo_tracks"), max_per_frame=None)
    assert sum(len(frame.observation) for frame in everything.frames) == 88_781

    def mean_track(recording):
        ids = np.concatenate([frame.observation.ids for frame in recording.frames])
        return len(ids) / len(np.unique(ids))

    assert mean_track(everything) == pytest.approx(3.4, abs=0.05)
    assert mean_track(real_00) > 2 * mean_track(everything)


def test_real_drive_is_scored_from_frame_16_on(real_00):
    truth = [frame.truth for frame in real_00.frames]
    assert all(pose is None for pose in truth[:16])
    assert all(pose is not None for pose in truth[16:])


def write_samples(folder, first=0.45):
    """The table of the unit, from that time on: at rest but for its own motion, gravity upwards."""
    times = np.arange(first, 2.2, 0.01)
    rows = [[t, 0.1, 0.2, 9.81, 0.01, 0.02, 0.03] for t in times]
    np.savetxt(folder / "imu_100hz.csv", rows, delimiter=",", header="t_s,ax,ay,az,wx,wy,wz", comments="")
    return folder


def test_samples_lie_beside_the_tracks(tmp_path):
    folder = write_samples(kitti00(tmp_path))
    assert all(frame.inertial is None for frame in load(folder).frames)
    recording = load(folder, inertial=True)
    assert [frame.inertial is None for frame in recording.frames] == [True] + [False] * (len(recording) - 1)
    assert recording.frames[0].timestamp == pytest.approx(0.5)
    np.testing.assert_allclose(recording.start.position, [0.0, 0.0, 0.7 * 5])  # its truth is in the same W
    samples = recording.frames[1].inertial
    R_ci = Rotation.from_quat(np.array(samples.unit.orientation))
    np.testing.assert_allclose(R_ci.as_matrix() @ samples.specific_forces[0], [-0.2, -9.81, 0.1], atol=1e-9)
    np.testing.assert_allclose(R_ci.as_matrix() @ samples.angular_rates[0], [-0.02, -0.03, 0.01], atol=1e-9)


def test_samples_of_another_recording_are_refused(tmp_path):
    folder = write_samples(kitti00(tmp_path), first=2.05)
    with pytest.raises(ValueError, match=r"imu_100hz.csv does not reach to the last frame: it is of another rec"):
        load(folder, inertial=True)


def test_three_seconds_without_images_of_the_real_drive():
    """.25 m of ATE and a true covariance, where vision alone loses 5 m. At other places .22 to .37 m."""
    recording = load(real_data("kitti00_stereo_tracks"), inertial=True)
    nothing = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    begin = recording.frames[70].timestamp
    dark = recording.with_observations(
        nothing if begin <= frame.timestamp < begin + 3.0 else frame.observation for frame in recording.frames
    )
    motion = {"name": "strapdown", "sigma_mounting": 0.02}
    with_unit, without = (evaluate(name, dark).figures for name in ("inertial", "right-invariant"))
    open_mounting = evaluate("inertial", dark, motion=motion)
    assert open_mounting.figures.ate_rigid_m < 0.25
    assert with_unit.ate_rigid_m < 0.27
    assert 0.5 < with_unit.pose_anees / 6.0 < 2.0
    assert without.ate_rigid_m > 3.0


def test_the_wheel_holds_the_same_measurements_as_the_folder(real_00):
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    wheel, folder = load("gtsam"), real_00
    assert len(wheel) == len(folder)
    for a, b in zip(wheel.frames, folder.frames, strict=True):
        np.testing.assert_array_equal(a.observation.ids, b.observation.ids)
        np.testing.assert_array_equal(a.observation.uvd, b.observation.uvd)
        assert a.timestamp - wheel.frames[0].timestamp == pytest.approx(b.timestamp, abs=0.05)


def test_the_reference_of_the_wheel_says_that_it_is_no_ground_truth():
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    assert load("gtsam").reference.kind == "odometry"


def test_without_gtsam_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(ImportError, match=re.escape(install_command("gtsam")) + "$"):
        load("gtsam")


# --- Starry Night -----------------------------------------------------------------------------------------------------


def reprojection_errors(recording):
    """Measured minus projected by truth, (n, 3) px."""
    landmarks = dict(zip(recording.landmarks.ids.tolist(), recording.landmarks.positions, strict=True))
    errors = []
    for frame in recording.frames:
        points_w = np.array([landmarks[i] for i in frame.observation.ids.tolist()]).reshape(-1, 3)
        errors.append(frame.observation.uvd - recording.camera.project(frame.truth.to_camera(points_w)))
    return np.vstack(errors)


def test_world_is_the_left_camera_at_the_first_step_used(tmp_path):
    recording = load(starry_night(tmp_path), first=2)
    np.testing.assert_allclose(recording.frames[0].truth.position, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(recording.frames[0].truth.orientation), [0.0, 0.0, 0.0, 1.0], atol=1e-12)
    assert recording.frames[0].odometry is None
    assert recording.frames[0].timestamp == pytest.approx(20.0 + 2 * DT)
    assert len(recording) == 10


def test_true_poses_project_true_landmarks_onto_the_measurements(tmp_path):
    np.testing.assert_allclose(reprojection_errors(load(starry_night(tmp_path), first=0)), 0.0, atol=1e-9)


def test_odometry_of_the_night_takes_the_camera_along_the_true_path(tmp_path):
    """Sign, step and lever arm at once: any of them wrong is off by centimetres."""
    recording = load(starry_night(tmp_path), first=2)
    truth = np.array([frame.truth.position for frame in recording.frames])
    np.testing.assert_allclose(dead_reckoned(recording), truth, atol=1e-4)


def test_late_readings_of_the_gyro_are_put_back_to_where_they_belong():
    times = 0.05 * np.arange(40)
    readings = -np.column_stack([times - GYRO_DELAY, 2.0 * (times - GYRO_DELAY), 0.0 * times])
    angular = step_velocities(times, np.zeros((40, 3)), readings, GYRO_DELAY)[1]
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


def test_real_residuals_are_the_noise_to_assume(real_night):
    everything = load(real_data("starry_night_a"), first=0, max_row_difference=None)
    assert len(reprojection_errors(everything)) == 6612
    np.testing.assert_allclose(reprojection_errors(everything).var(axis=0), [40.03, 162.2, 7.430], rtol=1e-3)
    rms = np.sqrt((reprojection_errors(real_night) ** 2).mean(axis=0))
    np.testing.assert_allclose(np.sqrt(np.diag(real_night.noise.R)), rms, rtol=0.02)


def test_real_odometry_drifts_slowly(real_night):
    truth = np.array([frame.truth.position for frame in real_night.frames])
    steps = np.linalg.norm(np.diff(truth, axis=0), axis=1)
    assert len(real_night) == 1100
    assert steps.sum() == pytest.approx(23.3, abs=0.1)
    assert np.linalg.norm(dead_reckoned(real_night)[-1] - truth[-1]) < 1.0
