"""True poses from a file beside the images (1 s)."""

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Pose
from stereo_slam_env.datasets import open_image_sequence
from stereo_slam_env.datasets.restated import pose_at
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import save_trajectory

from .small_image_folders import DT, FRAMES, kitti_odometry, true_poses
from .test_image_layouts import assert_same_poses


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
