"""Drives as ROS bags, written pair by pair: ROS 1, ROS 2 with a database, MCAP.

Topics and frames: images and CameraInfo of `left_camera` and `right_camera` (x right, y down, z forward), samples of
`imu_link`, an odometry of `base_link` (at the left camera, x forward, y left, z up) in `odom`, the true pose and
velocity of the body in `world`, which has z up, and static transforms between all that is mounted. Covariances are
ROS's: of a pose in the parent's frame, with the rotation about its axes, of a twist in the child's frame. True biases
are an acceleration: gyros angular, accelerometers linear.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from filters import Pose
from filters.contract.extras import require_module
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.bag_motion import BIAS, NOISE, REFERENCE, TRUTH
from stereo_slam_env.datasets.image_files import png_of
from stereo_slam_env.datasets.written_frame import WrittenFrame, step_of
from stereo_slam_env.recording.recording import GreyImage
from stereo_slam_env.sensing.sensor_suite import T_BASE_CAMERA, SensorSuite

LEFT_IMAGES, RIGHT_IMAGES = "/stereo/left", "/stereo/right"
IMU, ODOMETRY, STATIC = "/imu/data", "/wheel/odometry", "/tf_static"
WORLD, LEFT, RIGHT, UNIT, BASE, ODOM = "world", "left_camera", "right_camera", "imu_link", "base_link", "odom"

_TRANSFORMS = "tf2_msgs/msg/TFMessage"


class BagWriter:
    """Writer of one bag, a file or a folder."""

    def __init__(
        self, path: Path, suite: SensorSuite, kind: str, *, truth_from: Mapping[str, Any], compressed: bool = False
    ) -> None:
        require_module("rosbags", "bags")
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._path, self._suite, self._kind, self._compressed = path, suite, kind, compressed
        self._truth_from = json.dumps(truth_from)
        self._of_ros1, self._connections = kind == "bag", dict[str, Any]()
        self._folder = path.with_name("unfinished") if kind == "mcap" else path
        _remove(path, self._folder)  # of a writing that was stopped
        self._doubt = np.zeros((6, 6))  # of the pose by odometry, right perturbation of the left camera
        if self._of_ros1:
            self._writer: Any = Writer1(path)
            self._types = get_typestore(Stores.ROS1_NOETIC)
            self._types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TRANSFORMS))
        else:
            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            self._writer = Writer(self._folder, version=9, storage_plugin=plugin)
            self._types = get_typestore(Stores.ROS2_HUMBLE)
        self._writer.open()

    def has_images(self, number: int, stamp: int) -> bool:
        """Whether a pair need not be drawn: a bag begins anew."""
        return False

    def write(self, frame: WrittenFrame) -> None:
        """Write what came with a pair."""
        suite, stamp, pair = self._suite, frame.stamp, frame.pair
        if frame.number == 0:
            self._write_rig(stamp)
        for time, values in frame.rows:
            self._put(IMU, "sensor_msgs/msg/Imu", time, self._imu(time, values))
        for topic, name, image, shift in (
            (LEFT_IMAGES, LEFT, pair.left, 0.0),
            (RIGHT_IMAGES, RIGHT, pair.right, suite.camera.baseline),
        ):
            self._put(f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", stamp, self._info(stamp, name, shift))
            if self._compressed:
                kind, message = "sensor_msgs/msg/CompressedImage", self._png(stamp, name, image)
                self._put(f"{topic}/image_rect/compressed", kind, stamp, message)
            else:
                self._put(f"{topic}/image_rect", "sensor_msgs/msg/Image", stamp, self._image(stamp, name, image))
        if pair.odometry is not None or (frame.number == 0 and suite.odometry is not None):
            self._put(ODOMETRY, "nav_msgs/msg/Odometry", stamp, self._driven(frame))
        self._write_truth(frame)

    def close(self) -> None:
        """Write the index, which makes it complete."""
        self._writer.close()
        if self._kind == "mcap":
            (file,) = self._folder.glob("*.mcap")
            file.replace(self._path)
            _remove(self._folder)

    def _put(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._connected(topic, kind)
        serialize = self._types.serialize_ros1 if self._of_ros1 else self._types.serialize_cdr
        self._writer.write(self._connections[topic], stamp, serialize(message, kind))

    def _connected(self, topic: str, kind: str) -> Any:
        latched = topic in (STATIC, _beside(IMU), REFERENCE)
        if self._of_ros1:
            return self._writer.add_connection(topic, kind, typestore=self._types, latching=int(latched))
        return self._writer.add_connection(topic, kind, typestore=self._types, offered_qos_profiles=_kept(latched))

    # --- what is written ----------------------------------------------------------------------------------------------

    def _write_rig(self, stamp: int) -> None:
        """Write static transforms and the noise of the unit."""
        unit, links = self._suite.unit, [(BASE, LEFT, T_BASE_CAMERA), (LEFT, RIGHT, self._suite.T_lr)]
        if unit is not None:
            links.append((BASE, UNIT, T_BASE_CAMERA @ Pose(unit.position, unit.orientation)))
            densities = unit.gyro_density, unit.accelerometer_density, unit.gyro_walk, unit.accelerometer_walk
            numbers = np.array([*densities, self._suite.time_offset])
            layout = self._new("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
            noise = self._new("std_msgs/msg/Float64MultiArray", layout=layout, data=numbers)
            self._put(_beside(IMU), "std_msgs/msg/Float64MultiArray", stamp, noise)
        transforms = [self._transform(stamp, *link) for link in links]
        self._put(STATIC, _TRANSFORMS, stamp, self._new(_TRANSFORMS, transforms=transforms))

    def _write_truth(self, frame: WrittenFrame) -> None:
        """Write the true pose of the body, its velocity and the biases, where they are known."""
        pair, stamp, zeros = frame.pair, frame.stamp, np.zeros(36)
        if (pose := frame.T_ub) is None:
            return
        if frame.number == 0:
            text = self._new("std_msgs/msg/String", data=self._truth_from)
            self._put(REFERENCE, "std_msgs/msg/String", stamp, text)
        linear = angular = np.zeros(3)
        if frame.velocity_u is not None and pair.velocity is not None:
            linear, angular = pose.R_wc.T @ frame.velocity_u, self._suite.T_bc.R_wc @ pair.velocity.angular
        body = BASE if self._suite.unit is None else UNIT
        message = self._odometry(stamp, WORLD, body, pose, zeros, (linear, angular), zeros)
        self._put(TRUTH, "nav_msgs/msg/Odometry", stamp, message)
        if pair.biases is not None:
            bias = self._new(
                "geometry_msgs/msg/Accel", linear=self._vector(pair.biases[3:]), angular=self._vector(pair.biases[:3])
            )
            header = self._header(stamp, body)
            self._put(
                BIAS,
                "geometry_msgs/msg/AccelStamped",
                stamp,
                self._new("geometry_msgs/msg/AccelStamped", header=header, accel=bias),
            )

    def _driven(self, frame: WrittenFrame) -> Any:
        """The odometry so far, of the base, with a covariance that grows by the steps, to first order."""
        R_bc, odometry = T_BASE_CAMERA.R_wc, frame.pair.odometry
        turn = np.kron(np.eye(2), R_bc)
        velocity, covariance = (np.zeros(3), np.zeros(3)), np.zeros((6, 6))
        if self._suite.odometry is not None:
            covariance = self._suite.odometry
        if odometry is not None:
            step, covariance, turn_c = step_of(odometry, frame.dt), odometry.covariance, frame.dt * odometry.angular
            back, half = step.inverse(), rotations.exp(-0.5 * turn_c)
            J, G = np.kron(np.eye(2), back.R_wc), np.zeros((6, 6))
            J[:3, 3:] = -back.R_wc @ rotations.skew(step.position)
            of_turn = -0.5 * half @ rotations.skew(frame.dt * odometry.linear) @ rotations.right_jacobian(0.5 * turn_c)
            G[:3, :3], G[:3, 3:], G[3:, 3:] = half, of_turn, rotations.right_jacobian(turn_c)
            G *= frame.dt
            self._doubt = J @ self._doubt @ J.T + G @ covariance @ G.T
            velocity = R_bc @ odometry.linear, R_bc @ odometry.angular
        pose = T_BASE_CAMERA @ frame.driven @ T_BASE_CAMERA.inverse()
        axes = np.kron(np.eye(2), R_bc @ frame.driven.R_wc)
        doubts = axes @ self._doubt @ axes.T, turn @ covariance @ turn.T
        return self._odometry(frame.stamp, ODOM, BASE, pose, doubts[0], velocity, doubts[1])

    # --- messages -----------------------------------------------------------------------------------------------------

    def _new(self, kind: str, **fields: Any) -> Any:
        return self._types.types[kind](**fields)

    def _header(self, stamp: int, frame: str) -> Any:
        time = self._new("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        of_ros1 = {"seq": 0} if self._of_ros1 else {}
        return self._new("std_msgs/msg/Header", stamp=time, frame_id=frame, **of_ros1)

    def _image(self, stamp: int, frame: str, image: GreyImage) -> Any:
        height, width = image.shape
        return self._new(
            "sensor_msgs/msg/Image",
            header=self._header(stamp, frame),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(image).reshape(-1),
        )

    def _png(self, stamp: int, frame: str, image: GreyImage) -> Any:
        data = np.frombuffer(png_of(image), dtype=np.uint8)
        header = self._header(stamp, frame)
        return self._new("sensor_msgs/msg/CompressedImage", header=header, format="mono8; png compressed ", data=data)

    def _info(self, stamp: int, frame: str, shift: float) -> Any:
        camera = self._suite.camera
        K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        P = np.column_stack([K, [-camera.fx * shift, 0.0, 0.0]])
        roi = self._new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        matrices = {"d": np.zeros(5), "k": K.reshape(-1), "r": np.eye(3).reshape(-1), "p": P.reshape(-1)}
        if self._of_ros1:
            matrices = {name.upper(): matrix for name, matrix in matrices.items()}
        return self._new(
            "sensor_msgs/msg/CameraInfo",
            header=self._header(stamp, frame),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=roi,
            **matrices,
        )

    def _imu(self, stamp: int, values: FloatArray) -> Any:
        unit, rate = self._suite.unit, self._suite.imu_rate
        densities = (0.0, 0.0) if unit is None else (unit.gyro_density, unit.accelerometer_density)
        unknown = np.zeros(9)
        unknown[0] = -1.0  # as sensor_msgs/Imu has it: there is no orientation
        return self._new(
            "sensor_msgs/msg/Imu",
            header=self._header(stamp, UNIT),
            orientation=self._quaternion(Pose().orientation),
            orientation_covariance=unknown,
            angular_velocity=self._vector(values[:3]),
            angular_velocity_covariance=densities[0] ** 2 * rate * np.eye(3).reshape(-1),
            linear_acceleration=self._vector(values[3:]),
            linear_acceleration_covariance=densities[1] ** 2 * rate * np.eye(3).reshape(-1),
        )

    def _odometry(
        self,
        stamp: int,
        parent: str,
        child: str,
        pose: Pose,
        doubt: FloatArray,
        velocity: tuple[FloatArray, FloatArray],
        doubt_of_velocity: FloatArray,
    ) -> Any:
        point = self._new("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, pose.position), strict=True)))
        at = self._new("geometry_msgs/msg/Pose", position=point, orientation=self._quaternion(pose.orientation))
        moving = self._new(
            "geometry_msgs/msg/Twist", linear=self._vector(velocity[0]), angular=self._vector(velocity[1])
        )
        return self._new(
            "nav_msgs/msg/Odometry",
            header=self._header(stamp, parent),
            child_frame_id=child,
            pose=self._new("geometry_msgs/msg/PoseWithCovariance", pose=at, covariance=doubt.reshape(-1)),
            twist=self._new(
                "geometry_msgs/msg/TwistWithCovariance", twist=moving, covariance=doubt_of_velocity.reshape(-1)
            ),
        )

    def _transform(self, stamp: int, parent: str, child: str, pose: Pose) -> Any:
        at = self._new(
            "geometry_msgs/msg/Transform",
            translation=self._vector(pose.position),
            rotation=self._quaternion(pose.orientation),
        )
        header = self._header(stamp, parent)
        return self._new("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=at)

    def _vector(self, numbers: ArrayLike) -> Any:
        x, y, z = np.asarray(numbers, dtype=np.float64).tolist()
        return self._new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _quaternion(self, numbers: ArrayLike) -> Any:
        x, y, z, w = np.asarray(numbers, dtype=np.float64).tolist()
        return self._new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _beside(topic: str) -> str:
    """Topic of the noise of a unit with this topic."""
    return f"{topic.rpartition('/')[0]}/{NOISE}"


def _kept(latched: bool) -> list[Any]:
    """Quality of service of a topic for ROS 2: who comes late still gets what is latched."""
    if not latched:
        return []
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(2147483647, 4294967295)
    return [
        Qos(
            QosHistory.KEEP_LAST,
            1,
            QosReliability.RELIABLE,
            QosDurability.TRANSIENT_LOCAL,
            never,
            never,
            QosLiveliness.AUTOMATIC,
            never,
            False,
        )
    ]


def _remove(*paths: Path) -> None:
    for path in paths:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
