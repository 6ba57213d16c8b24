"""Every published layout gives back the drive that it was written from; true poses may be beside the images (4 s)."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import Pose
from stereo_slam_env import run
from stereo_slam_env.datasets import open_image_sequence
from stereo_slam_env.datasets.restated import pose_at
from stereo_slam_env.datasets.single_data_sets import P_I, R_CI
from stereo_slam_env.frontend.track_recorder import record_tracks
from stereo_slam_env.recording.archive import load_recording, save_recording
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import save_trajectory

from ..real_data import real_data
from .small_image_folders import (
    CAMERA,
    DT,
    FRAMES,
    R_RECT,
    T_CAM_VELO,
    T_VELO_IMU,
    TURN_RATE,
    drive,
    karlsruhe,
    kitti06,
    kitti_odometry,
    kitti_raw,
    true_poses,
    unit_poses,
)

LAYOUTS = {
    "kitti_odometry": kitti_odometry,
    "kitti_raw": kitti_raw,
    "karlsruhe": karlsruhe,
    "kitti06_stereo51": kitti06,
}


def assert_same_poses(found, expected, atol):
    np.testing.assert_allclose([p.position for p in found], [p.position for p in expected], atol=atol)
    apart = Rotation.from_quat([p.orientation for p in found]).inv() * Rotation.from_quat(
        [p.orientation for p in expected]
    )
    np.testing.assert_allclose(apart.magnitude(), 0.0, atol=max(atol, 1e-7))


def relative_to(origin, poses):
    """The poses seen from one of them."""
    R = Rotation.from_quat(origin.orientation)
    positions = R.inv().apply([pose.position - origin.position for pose in poses])
    orientations = (R.inv() * Rotation.from_quat([pose.orientation for pose in poses])).as_quat()
    return [Pose(r, q) for r, q in zip(positions, orientations, strict=True)]


def moved_left(poses, metres):
    """The same poses of a camera that sits to the left."""
    return [
        Pose(pose.position + Rotation.from_quat(pose.orientation).apply([-metres, 0.0, 0.0]), pose.orientation)
        for pose in poses
    ]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_images_camera_times_and_truth_come_back(tmp_path, layout):
    first = 60 if layout == "karlsruhe" else None
    sequence = open_image_sequence(LAYOUTS[layout](tmp_path), first=first)
    pairs = list(sequence.pairs())
    assert sequence.source["reader"] == layout
    assert len(sequence) == len(pairs) == FRAMES
    for name in ("fx", "fy", "cx", "cy", "baseline", "width", "height"):
        assert getattr(sequence.camera, name) == pytest.approx(getattr(CAMERA, name), rel=1e-9)
    for pair, original in zip(pairs, drive().pairs(), strict=True):
        np.testing.assert_array_equal(pair.left, original.left)
        np.testing.assert_array_equal(pair.right, original.right)
    np.testing.assert_allclose(np.diff([pair.timestamp for pair in pairs]), DT, atol=1e-6)
    assert_same_poses([pair.truth for pair in pairs], true_poses(), atol=1e-6)
    assert not sequence.skipped


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_part_can_be_chosen_and_starts_its_own_world(tmp_path, layout):
    shift = 60 if layout == "karlsruhe" else 0
    sequence = open_image_sequence(LAYOUTS[layout](tmp_path), first=shift + 2, last=shift + 4)
    pairs = list(sequence.pairs())
    assert sequence.frame_numbers == (shift + 2, shift + 3, shift + 4)
    np.testing.assert_array_equal(pairs[0].left, drive()._pairs[2].left)
    assert_same_poses([p.truth for p in pairs], relative_to(true_poses()[2], true_poses()[2:5]), atol=1e-6)
    assert pairs[0].odometry is None


def test_sequences_are_lazy_and_can_be_read_again(tmp_path):
    folder = kitti_odometry(tmp_path)
    sequence = open_image_sequence(folder)
    pairs = sequence.pairs()
    next(pairs)
    for image in (folder / "image_0").iterdir():
        image.unlink()
    with pytest.raises(ValueError, match=r"000001\.png is missing"):
        next(pairs)


def test_colour_cameras_are_found_and_their_truth_is_their_own(tmp_path):
    folder = kitti_odometry(tmp_path, cameras=(2, 3))
    sequence = open_image_sequence(folder)
    assert sequence.source["cameras"] == "colour"
    assert sequence.camera.baseline == pytest.approx(CAMERA.baseline)
    # poses are those of the grey left camera, 6 cm to the right of the colour one
    moved = moved_left(true_poses(), 0.06)
    expected = relative_to(moved[0], moved)
    assert_same_poses([pair.truth for pair in sequence.pairs()], expected, atol=1e-9)
    kitti_odometry(tmp_path)
    assert open_image_sequence(folder).source["cameras"] == "grey"
    assert open_image_sequence(folder, cameras="colour").source["cameras"] == "colour"
    with pytest.raises(ValueError, match="cameras must be one of grey, colour, got 'thermal'"):
        open_image_sequence(folder, cameras="thermal")
    with pytest.raises(ValueError, match="no option 'frist', did you mean 'first'"):
        open_image_sequence(folder, frist=3)


def test_kitti_without_poses_has_no_truth(tmp_path):
    sequence = open_image_sequence(kitti_odometry(tmp_path, truth=False))
    assert all(pair.truth is None for pair in sequence.pairs())
    assert record_tracks(sequence, frames=2).reference.kind == "none"


@pytest.mark.parametrize(("cameras", "metres_left"), [(("00", "01"), 0.0), (("02", "03"), 0.06)])
def test_raw_odometry_takes_the_camera_along_the_true_path(tmp_path, cameras, metres_left):
    """Lever arm, tilt, frame and row convention at once; hardly any noise is added."""
    sequence = open_image_sequence(kitti_raw(tmp_path, cameras=cameras), sigma_linear=1e-6, sigma_angular=1e-6)
    r, R, positions = np.zeros(3), Rotation.identity(), []
    for pair in sequence.pairs():
        if pair.odometry is not None:
            half = Rotation.from_rotvec(0.5 * DT * pair.odometry.angular)
            r = r + (R * half).apply(np.array(pair.odometry.linear)) * DT
            R = R * Rotation.from_rotvec(DT * pair.odometry.angular)
        positions.append(r)
    moved = moved_left(true_poses(), metres_left)
    expected = [pose.position for pose in relative_to(moved[0], moved)]
    np.testing.assert_allclose(positions, expected, atol=2e-3)
    assert np.linalg.norm(positions[-1]) > 1.9


def test_raw_packets_are_inertial_samples_of_the_unit_that_is_calibrated(tmp_path):
    """A half of a step is of the packet at each end of it: what weighs 9.81 m/s^2 points upwards all the way."""
    none, *pairs = open_image_sequence(kitti_raw(tmp_path)).pairs()
    assert none.inertial is None
    T_ci = T_CAM_VELO @ T_VELO_IMU
    up = R_RECT @ T_ci[:3, :3] @ unit_poses()[1][0].inv().apply([0.0, 0.0, 9.81])
    for before, pair in pairwise([none, *pairs]):
        samples, R_wc = pair.inertial, Rotation.from_quat(pair.truth.orientation)
        R_ci = Rotation.from_quat(np.array(samples.unit.orientation))
        dt = pair.timestamp - before.timestamp
        assert samples.times.tolist() == pytest.approx([0.5 * dt, dt])
        np.testing.assert_allclose(samples.unit.position, R_RECT @ T_ci[:3, 3], atol=1e-9)
        force, rate = samples.specific_forces.mean(axis=0), samples.angular_rates.mean(axis=0)
        np.testing.assert_allclose((R_wc * R_ci).apply(force), up, atol=0.2)
        turn = (Rotation.from_quat(before.truth.orientation).inv() * R_wc).as_rotvec() / DT
        np.testing.assert_allclose(R_ci.apply(rate), turn, atol=0.2)


def test_a_raw_drive_with_samples_is_saved_loaded_and_replayed_to_the_same_bits(tmp_path):
    tracked = record_tracks(open_image_sequence(kitti_raw(tmp_path)))
    save_recording(tmp_path / "drive.npz", tracked)
    ends = []
    for one in (tracked, load_recording(tmp_path / "drive.npz")):
        assert [frame.inertial is None for frame in one.frames] == [True] + [False] * (len(one) - 1)
        *_, last = run("inertial", one)
        ends.append(np.concatenate([last.slam.pose.position, last.slam.pose.covariance.ravel()]))
    np.testing.assert_array_equal(*ends)


def test_raw_without_gps_has_neither_truth_nor_odometry(tmp_path):
    for sequence in (
        open_image_sequence(kitti_raw(tmp_path / "a", oxts=False)),
        open_image_sequence(kitti_raw(tmp_path / "b"), use_oxts=False),
    ):
        pair = list(sequence.pairs())[-1]
        assert pair.truth is None
        assert pair.odometry is None


def test_added_noise_is_of_the_stated_size_and_seeded(tmp_path):
    folder = kitti06(tmp_path)

    def linear(**options):
        return np.array([p.odometry.linear for p in open_image_sequence(folder, **options).pairs() if p.odometry])

    clean = linear(sigma_linear=1e-9, sigma_angular=1e-9)
    k = np.arange(1, FRAMES)
    expected = np.column_stack([k, np.zeros(FRAMES - 1), np.zeros(FRAMES - 1)]) + np.cross([0, 0, -TURN_RATE], P_I)
    np.testing.assert_allclose(clean, expected @ R_CI.T, atol=1e-6)
    np.testing.assert_array_equal(linear(), linear())
    assert not np.array_equal(linear(), linear(odometry_seed=1))
    many = np.concatenate([linear(odometry_seed=seed) - clean for seed in range(60)])
    assert many.std(axis=0) == pytest.approx([0.5] * 3, rel=0.15)


@pytest.mark.parametrize("yaw", ["east", "north"])
def test_the_reading_of_yaw_is_told_from_the_course(tmp_path, yaw):
    sequence = open_image_sequence(karlsruhe(tmp_path, yaw=yaw), first=60)
    assert f"yaw counted from {yaw}" in sequence.truth_from.description
    assert_same_poses([pair.truth for pair in sequence.pairs()], true_poses(), atol=1e-6)


def test_a_yaw_that_fits_no_course_gives_no_truth(tmp_path, caplog):
    sequence = open_image_sequence(karlsruhe(tmp_path, yaw="neither"), first=60)
    assert all(pair.truth is None for pair in sequence.pairs())
    assert "yaw fits no direction of motion" in caplog.text


def test_karlsruhe_calibration_is_the_one_of_the_cut_images(tmp_path):
    folder = karlsruhe(tmp_path)
    sequence = open_image_sequence(folder, first=60)
    assert sequence.camera.cy == pytest.approx(CAMERA.cy)
    (tmp_path / "2009_09_08_calib.txt").rename(folder / "calib.txt")
    assert open_image_sequence(folder, first=60).source["calibration"] == str(folder / "calib.txt")


def test_karlsruhe_without_gps_runs_at_ten_hertz(tmp_path):
    folder = karlsruhe(tmp_path, first=0)
    (folder / "insdata.txt").unlink()
    pairs = list(open_image_sequence(folder).pairs())
    np.testing.assert_allclose([pair.timestamp for pair in pairs], 0.1 * np.arange(FRAMES))
    assert pairs[0].truth is None


def test_karlsruhe_times_in_another_unit_are_refused_and_can_be_replaced(tmp_path):
    folder = karlsruhe(tmp_path)
    rows = np.loadtxt(folder / "insdata.txt")
    rows[:, 0] *= 1e6
    np.savetxt(folder / "insdata.txt", rows)
    with pytest.raises(
        ValueError, match=r"insdata\.txt: times are 100000 apart, which are no seconds: give rate_hz=10"
    ):
        open_image_sequence(folder, first=60)
    sequence = open_image_sequence(folder, first=60, rate_hz=5)
    np.testing.assert_allclose(np.diff([pair.timestamp for pair in sequence.pairs()]), 0.2)
    assert sequence.source["times"] == "assumed 5 Hz"
    assert "yaw counted from east" in sequence.truth_from.description


def test_the_one_recording_inside_a_folder_stands_for_it(tmp_path):
    kitti_odometry(tmp_path)
    assert open_image_sequence(tmp_path).name == "kitti_odometry_07"
    other = tmp_path / "sequences" / "08"
    (tmp_path / "sequences" / "07").rename(other)
    kitti_odometry(tmp_path)
    with pytest.raises(ValueError, match=r"holds 2 recordings, give one of them: sequences/07, sequences/08"):
        open_image_sequence(tmp_path)


def test_the_real_pairs_of_kitti_06():
    settled = open_image_sequence(real_data("kitti06_stereo51"))
    assert settled.frame_numbers == tuple(range(12, 51))
    first = next(settled.pairs())
    assert first.timestamp == settled.truth_from.settled_at
    np.testing.assert_array_equal(first.truth.position, 0.0)
    sequence = open_image_sequence(real_data("kitti06_stereo51"), first=0)
    pairs = list(sequence.pairs())
    assert len(pairs) == 51
    assert not sequence.skipped
    assert sequence.camera.baseline == pytest.approx(0.53715065)
    assert pairs[0].left.shape == (370, 1226)
    path = np.array([pair.truth.position for pair in pairs])
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(59.9, abs=0.1)
    # The odometry, without its noise, is the truth's: 1.2 m a frame, straight on.
    clean = list(
        open_image_sequence(real_data("kitti06_stereo51"), first=0, sigma_linear=1e-6, sigma_angular=1e-6).pairs()
    )
    steps = np.array([p.odometry.linear * (p.timestamp - q.timestamp) for q, p in pairwise(clean)])
    rotations = Rotation.from_quat([pair.truth.orientation for pair in pairs])
    true_steps = rotations[:-1].inv().apply(np.diff(path, axis=0))
    np.testing.assert_allclose(np.abs(steps - true_steps).max(axis=0), 0.0, atol=0.05)


def test_pairs_before_the_first_true_pose_are_left_out_and_counted(tmp_path):
    """W is the camera at the first pair that has a pose; how it came there is not told."""
    late = true_poses()[2:]
    positions, turns = np.array([pose.position for pose in late]), np.array([pose.orientation for pose in late])
    save_trajectory(tmp_path / "late.tum", Trajectory(positions, turns, DT * np.arange(2, FRAMES)))
    sequence = open_image_sequence(kitti_odometry(tmp_path, truth=False), truth=str(tmp_path / "late.tum"))
    assert sequence.skipped == {}  # not known before they are read
    pairs = list(sequence.pairs())
    assert len(sequence) == FRAMES == len(pairs) + 2
    assert sequence.skipped == {"before the first true pose": 2}
    origin = late[0].inverse()
    assert_same_poses([pair.truth for pair in pairs], [origin @ pose for pose in late], atol=1e-6)
    assert pairs[0].odometry is None


def test_true_poses_are_interpolated_over_a_tenth_of_a_second_at_most():
    """Half-way in place and turn; at a row that pose; none outside of the rows or in a gap."""
    turns = Rotation.from_euler("y", [[0.0], [10.0], [30.0]], degrees=True)
    rows = Trajectory(np.diag([0.0, 2.0, 4.0]), turns.as_quat(), np.array([5.0, 5.1, 5.201]))
    for time, expected in (
        *((5.0, ([0, 0, 0], 0.0)), (5.05, ([0, 1, 0], 5.0)), (5.1, ([0, 2, 0], 10.0)), (5.15, None)),
        *((5.201, ([0, 0, 4], 30.0)), (4.99, None), (5.21, None)),
    ):
        pose = pose_at(rows, time)
        assert (pose is None) == (expected is None), time
        if pose is not None:
            np.testing.assert_allclose(pose.position, expected[0], atol=1e-12)
            turn = Rotation.from_quat(pose.orientation).as_rotvec(degrees=True)
            np.testing.assert_allclose(turn, [0.0, expected[1], 0.0], atol=1e-9)
    camera = Pose(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose(pose_at(rows, 5.0, camera).position, [0.0, 0.0, 1.0], atol=1e-12)
