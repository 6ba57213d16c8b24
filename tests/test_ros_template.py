"""The part of the ROS 2 template that knows no ROS: the drive comes back, in axes and covariances of ROS (10 s)."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from .stereo_slam_env.datasets.small_image_folders import CAMERA, drive, true_poses

TEMPLATE = Path(__file__).resolve().parent.parent / "templates" / "ros2-node"


@pytest.fixture
def odometry(monkeypatch):
    monkeypatch.syspath_prepend(str(TEMPLATE))
    yield pytest.importorskip("stereo_slam_node.odometry")
    for name in [name for name in sys.modules if name.startswith("stereo_slam_node")]:
        sys.modules.pop(name)


def test_the_camera_of_the_drive_is_found_in_the_world_of_ros(odometry):
    slam = odometry.StereoOdometry(CAMERA)
    estimates = [slam.step(pair.left, pair.right, pair.timestamp) for pair in drive().pairs()]
    last, truth = estimates[-1], true_poses()[-1]
    forward, left, up = truth.position[[2, 0, 1]] * [1.0, -1.0, -1.0]
    # 2 m from a start at full speed, which the filter is not told, in small pictures drawn without antialiasing.
    assert np.linalg.norm(last.position - [forward, left, up]) < 0.3
    axes = Rotation.from_quat(last.orientation).as_matrix()
    R = Rotation.from_quat(truth.orientation).as_matrix()
    looks = [R[2, 2], -R[0, 2], -R[1, 2]]  # along z of the camera
    assert axes[:, 2] @ looks > np.cos(0.03)
    assert 5 <= last.landmarks <= 15  # of ten that the first pair shows


def test_the_covariance_is_of_a_rotation_about_axes_of_the_world(odometry):
    """A small error of the camera's own rotation, drawn from the filter's covariance, seen in the world of ROS."""
    slam = odometry.StereoOdometry(CAMERA)
    for pair in drive().pairs():
        estimate = slam.step(pair.left, pair.right, pair.timestamp)
    belief = slam._slam.pose
    rng = np.random.default_rng(0)
    errors = rng.multivariate_normal(np.zeros(6), belief.covariance, 20_000)
    R_wc, turn = Rotation.from_quat(belief.orientation), Rotation.from_matrix(odometry.R_OW)
    true = turn * R_wc * Rotation.from_rotvec(errors[:, 3:])
    seen = np.hstack([turn.apply(errors[:, :3]), (true * Rotation.from_quat(estimate.orientation).inv()).as_rotvec()])
    scale = np.sqrt(np.diag(estimate.covariance))
    np.testing.assert_allclose(
        np.cov(seen.T) / np.outer(scale, scale), estimate.covariance / np.outer(scale, scale), atol=0.05
    )
