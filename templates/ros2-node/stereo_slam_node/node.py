"""The node: stereo images in, `nav_msgs/Odometry` and a transform out."""

import message_filters
import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from tf2_ros import TransformBroadcaster

from stereo_slam_env.datasets import grey_of
from stereo_slam_env.sensing import calibration_of_infos
from stereo_slam_node.odometry import StereoOdometry

_UNKNOWN_TWIST = (1e6 * np.eye(6)).ravel().tolist()
"""Zeros would say that the camera stands still, for certain."""


class StereoSlamNode(Node):
    """Waits for both CameraInfo, then estimates at every pair."""

    def __init__(self) -> None:
        super().__init__("stereo_slam")
        self._filter = self.declare_parameter("filter", "right-invariant").value
        self._world = self.declare_parameter("odom_frame", "odom").value
        self._odometry, self._infos, self._last = None, {}, None
        self._publisher = self.create_publisher(Odometry, "odometry", 10)
        self._transforms = TransformBroadcaster(self)
        for side in ("left", "right"):
            self.create_subscription(
                CameraInfo,
                f"{side}/camera_info",
                lambda info, side=side: self._infos.setdefault(side, info),
                qos_profile_sensor_data,
            )
        images = [
            message_filters.Subscriber(self, Image, f"{side}/image_rect", qos_profile=qos_profile_sensor_data)
            for side in ("left", "right")
        ]
        self._pairs = message_filters.ApproximateTimeSynchronizer(images, queue_size=2, slop=0.005)
        self._pairs.registerCallback(self._on_pair)

    def _on_pair(self, left: Image, right: Image) -> None:
        if len(self._infos) < 2:
            return
        if self._odometry is None:
            both = self._infos["left"], self._infos["right"]
            self._camera = calibration_of_infos(both, "camera_info", rectified=True)
            self._odometry = StereoOdometry(self._camera, self._filter)
        stamp = left.header.stamp.sec + 1e-9 * left.header.stamp.nanosec
        if self._last is not None and stamp <= self._last:
            self.get_logger().warn("a pair does not follow the one before in time: left out")
            return
        size = self._camera.width, self._camera.height
        try:
            images = [grey_of(image, size, "an image") for image in (left, right)]
        except ValueError as error:
            self.get_logger().error(str(error))
            return
        estimate = self._odometry.step(*images, stamp)
        self._last = stamp
        self._publish(left.header, estimate)

    def _publish(self, header, estimate) -> None:
        message = Odometry()
        message.header.stamp, message.header.frame_id = header.stamp, self._world
        message.child_frame_id = header.frame_id
        pose = message.pose.pose
        pose.position.x, pose.position.y, pose.position.z = map(float, estimate.position)
        turn = pose.orientation
        turn.x, turn.y, turn.z, turn.w = map(float, estimate.orientation)
        message.pose.covariance = estimate.covariance.ravel().tolist()
        message.twist.covariance = _UNKNOWN_TWIST
        self._publisher.publish(message)
        transform = TransformStamped()
        transform.header, transform.child_frame_id = message.header, header.frame_id
        shift = transform.transform.translation
        shift.x, shift.y, shift.z = map(float, estimate.position)
        transform.transform.rotation = turn
        self._transforms.sendTransform(transform)


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = StereoSlamNode()
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
