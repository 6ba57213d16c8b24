"""The ROS 2 template: the drive comes back, in axes and covariances of ROS, and the node, among stand-ins (10 s)."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

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


# --- the node, where names of ROS are stand-ins ----------------------------------------------------------------------


class Message:
    """A message of ROS: its fields are there when they are asked for."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        self.__dict__[name] = Message()
        return self.__dict__[name]


class StandInNode:
    """As much of `rclpy.node.Node` as the template calls; publishers keep their messages."""

    def __init__(self, name):
        self.callbacks, self.said, self.published = {}, [], []

    def declare_parameter(self, name, default):
        return SimpleNamespace(value=default)

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind, topic, callback, qos):
        self.callbacks[topic] = callback

    def get_logger(self):
        return SimpleNamespace(warn=self.said.append, error=self.said.append)


@pytest.fixture
def node(odometry, monkeypatch):
    sent = []
    synchroniser = SimpleNamespace(registerCallback=lambda callback: None)
    stand_ins = {
        "message_filters": {
            "Subscriber": lambda node, kind, topic, qos_profile: topic,
            "ApproximateTimeSynchronizer": lambda topics, queue_size, slop: synchroniser,
        },
        "rclpy": {},
        "rclpy.node": {"Node": StandInNode},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "geometry_msgs.msg": {"TransformStamped": Message},
        "nav_msgs.msg": {"Odometry": Message},
        "sensor_msgs.msg": {"CameraInfo": Message, "Image": Message},
        "tf2_ros": {"TransformBroadcaster": lambda node: SimpleNamespace(sendTransform=sent.append)},
    }
    for name, content in stand_ins.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    from stereo_slam_node.node import StereoSlamNode

    made = StereoSlamNode()
    made.sent = sent
    return made


def image(pixels, time, encoding="mono8"):
    height, width = pixels.shape
    stamp = SimpleNamespace(sec=int(time), nanosec=round(1e9 * (time - int(time))))
    header = SimpleNamespace(stamp=stamp, frame_id="left_optical")
    return SimpleNamespace(
        header=header, encoding=encoding, width=width, height=height, step=width, is_bigendian=0, data=pixels.ravel()
    )


def camera_info(shift):
    K = [CAMERA.fx, 0.0, CAMERA.cx, 0.0, CAMERA.fy, CAMERA.cy, 0.0, 0.0, 1.0]
    P = [*K[:3], -CAMERA.fx * shift, *K[3:6], 0.0, *K[6:], 0.0]
    size = {"width": CAMERA.width, "height": CAMERA.height}
    size |= {"binning_x": 0, "binning_y": 0}
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    return SimpleNamespace(
        **size, roi=roi, k=K, d=[0.0] * 5, r=list(np.eye(3).ravel()), p=P, distortion_model="plumb_bob"
    )


def test_the_node_publishes_what_the_odometry_estimates(odometry, node):
    alone = odometry.StereoOdometry(CAMERA)
    pairs = list(drive().pairs())
    node._on_pair(image(pairs[0].left, 0.0), image(pairs[0].right, 0.0))
    assert node.published == []  # no camera is known yet
    node.callbacks["left/camera_info"](camera_info(0.0))
    node.callbacks["right/camera_info"](camera_info(CAMERA.baseline))
    for pair in pairs:
        node._on_pair(image(pair.left, pair.timestamp), image(pair.right, pair.timestamp))
        expected = alone.step(pair.left, pair.right, pair.timestamp)
    assert len(node.published) == len(node.sent) == len(pairs)
    message, transform = node.published[-1], node.sent[-1]
    position = message.pose.pose.position
    np.testing.assert_allclose([position.x, position.y, position.z], expected.position, atol=1e-6)
    np.testing.assert_allclose(np.reshape(message.pose.covariance, (6, 6)), expected.covariance, rtol=1e-4, atol=1e-12)
    assert np.diag(np.reshape(message.twist.covariance, (6, 6))).min() >= 1e6  # no twist, and nobody takes it for one
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "left_optical")
    assert transform.transform.translation.x == position.x
    assert transform.child_frame_id == "left_optical"


def test_the_node_leaves_out_what_it_cannot_use_and_says_so(node):
    for side, shift in (("left", 0.0), ("right", CAMERA.baseline)):
        node.callbacks[f"{side}/camera_info"](camera_info(shift))
    first = next(iter(drive().pairs()))
    node._on_pair(image(first.left, 5.0), image(first.right, 5.0))
    node._on_pair(image(first.left, 4.0), image(first.right, 4.0))
    node._on_pair(image(first.left, 6.0, encoding="yuv"), image(first.right, 6.0))
    assert len(node.published) == 1
    assert "does not follow" in node.said[0]
    assert "encoding 'yuv'" in node.said[1]
