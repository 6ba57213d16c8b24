"""Stereo images as an MCAP file of ROS 2 messages, which Foxglove, ROS 2 and the reader `ros_bag` open."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from filters import Pose, StereoCamera
from filters.contract.extras import require_module
from stereo_slam_env.recording.recording import ImageSequence

TOPICS = ("/stereo/left", "/stereo/right")
TRUTH = "/truth"
WORLD, LEFT, RIGHT = "world", "left_camera", "right_camera"
"""Frames: W, and both cameras with x right, y down, z forward."""


def write_mcap(sequence: ImageSequence, out: str | Path, *, on_pair: Callable[[int, int], None] | None = None) -> Path:
    """Write rectified pairs, their CameraInfo, the rig (/tf) and, where known, true poses (PoseStamped and /tf).

    Parameters
    ----------
    sequence : ImageSequence
        What to write; it is read once.
    out : str or Path
        The file, NAME.mcap; it appears when it is complete.
    on_pair : callable, optional
        Called after every pair with the number written and the number expected.

    Raises
    ------
    ValueError
        There is such a file already, or there are no pairs.
    ImportError
        `rosbags` is missing.
    """
    require_module("rosbags", "bags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    out = Path(out)
    if out.exists():
        raise ValueError(f"{out} is there already: choose another name, or remove it")
    out.parent.mkdir(parents=True, exist_ok=True)
    messages = _Messages(get_typestore(Stores.ROS2_HUMBLE), sequence.camera)
    epoch = round(1e9 * float(sequence.source.get("epoch_s", 0.0)))
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".convert-") as folder:
        written = 0
        with Writer(Path(folder) / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections: dict[str, Any] = {}

            def put(topic: str, kind: str, stamp: int, message: Any) -> None:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=messages.types)
                writer.write(connections[topic], stamp, messages.types.serialize_cdr(message, kind))

            for pair in sequence.pairs():
                stamp = epoch + round(1e9 * pair.timestamp)
                for topic, frame, image, shift in zip(
                    TOPICS, (LEFT, RIGHT), (pair.left, pair.right), (0.0, sequence.camera.baseline), strict=True
                ):
                    put(f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", stamp, messages.info(stamp, frame, shift))
                    put(f"{topic}/image_rect", "sensor_msgs/msg/Image", stamp, messages.image(stamp, frame, image))
                if pair.truth is not None:
                    put(TRUTH, "geometry_msgs/msg/PoseStamped", stamp, messages.pose(stamp, pair.truth))
                put("/tf", "tf2_msgs/msg/TFMessage", stamp, messages.transforms(stamp, pair.truth))
                written += 1
                if on_pair is not None:
                    on_pair(written, len(sequence))
        if not written:
            raise ValueError(f"sequence {sequence.name!r} has no pairs: nothing was written")
        (made,) = (Path(folder) / "bag").glob("*.mcap")
        shutil.move(made, out)
    return out


class _Messages:
    """ROS 2 messages of a rig."""

    def __init__(self, types: Any, camera: StereoCamera) -> None:
        self.types, self._camera = types, camera

    def _header(self, stamp: int, frame: str) -> Any:
        time = self.types.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        return self.types.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def image(self, stamp: int, frame: str, image: Any) -> Any:
        height, width = image.shape
        return self.types.types["sensor_msgs/msg/Image"](
            header=self._header(stamp, frame),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(image).reshape(-1),
        )

    def info(self, stamp: int, frame: str, shift: float) -> Any:
        camera = self._camera
        K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        P = np.column_stack([K, [-camera.fx * shift, 0.0, 0.0]])
        roi = self.types.types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.types.types["sensor_msgs/msg/CameraInfo"](
            header=self._header(stamp, frame),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=K.reshape(-1),
            r=np.eye(3).reshape(-1),
            p=P.reshape(-1),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )

    def pose(self, stamp: int, pose: Pose) -> Any:
        kinds = self.types.types
        position = kinds["geometry_msgs/msg/Point"](*map(float, pose.position))
        turn = kinds["geometry_msgs/msg/Quaternion"](*map(float, pose.orientation))
        of = kinds["geometry_msgs/msg/Pose"](position=position, orientation=turn)
        return kinds["geometry_msgs/msg/PoseStamped"](header=self._header(stamp, WORLD), pose=of)

    def transforms(self, stamp: int, truth: Pose | None) -> Any:
        beside = Pose(np.array([self._camera.baseline, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
        found = [self._transform(stamp, LEFT, RIGHT, beside)]
        if truth is not None:
            found.append(self._transform(stamp, WORLD, LEFT, truth))
        return self.types.types["tf2_msgs/msg/TFMessage"](transforms=found)

    def _transform(self, stamp: int, parent: str, child: str, pose: Pose) -> Any:
        kinds = self.types.types
        shift = kinds["geometry_msgs/msg/Vector3"](*map(float, pose.position))
        turn = kinds["geometry_msgs/msg/Quaternion"](*map(float, pose.orientation))
        of = kinds["geometry_msgs/msg/Transform"](translation=shift, rotation=turn)
        header = self._header(stamp, parent)
        return kinds["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id=child, transform=of)
