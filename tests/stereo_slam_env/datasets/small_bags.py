"""Bags of a drawn street: every field of the messages can be another one."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from ..frontend.drawn_street import CAMERA, DT, DrawnStreet

COUNT = 24
EPOCH_NS = 1_700_000_000_250_000_000
WIDTH, HEIGHT = CAMERA.width, CAMERA.height
K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1.0]])
RECT = ("/cam/left/image_rect", "/cam/right/image_rect")
RAW = ("/cam/left/image_raw", "/cam/right/image_raw")
D = (-0.25, 0.08, 0.001, -0.001, 0.0)
TURNS = tuple(Rotation.from_rotvec(v).as_matrix() for v in ([0.004, 0.008, -0.002], [0.004, -0.006, 0.001]))
"""From raw cameras to rectified ones."""


@cache
def street():
    pairs = list(DrawnStreet(COUNT).pairs())
    return [pair.left for pair in pairs], [pair.right for pair in pairs]


def P(eye, k=K, baseline=CAMERA.baseline):
    return np.column_stack([k, [-eye * k[0, 0] * baseline, 0, 0]])


def taken_by(images, turn, distortion=D):
    """Images of the raw camera that rectification by `turn` makes these of."""
    grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).reshape(-1, 1, 2).astype(np.float64)
    at = cv2.undistortPoints(grid, K, np.array(distortion), R=turn, P=K).reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    return [cv2.remap(a, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for a in images]


@cache
def raw_street():
    return tuple(taken_by(images, turn) for images, turn in zip(street(), TURNS, strict=True))


def raw_info(eye):
    return {"D": D, "R": TURNS[eye], "P": P(eye)}


def mono8(image, k, eye):
    return "mono8", image


def write_bag(
    path, topics=RECT, images=None, info=lambda eye, k: {}, encoded=mono8, stamp=None, logged=None, ros1=False
):
    """`info` gives other fields of CameraInfo, None leaves it out; `encoded` (encoding, array or bytes of a file)."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    kinds, serialize = store.types, store.serialize_ros1 if ros1 else store.serialize_cdr
    images = street() if images is None else images
    with Writer1(path) if ros1 else Writer(path, version=9) as writer:
        made = {}

        def put(topic, kind, time, message):
            if topic not in made:
                made[topic] = writer.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=store)
            writer.write(made[topic], time, serialize(message, f"sensor_msgs/msg/{kind}"))

        for k in range(len(images[0])):
            for eye, topic in enumerate(topics):
                due = EPOCH_NS + round(1e9 * DT) * k
                at, log_time = due if stamp is None else stamp(eye, k), due if logged is None else logged(eye, k)
                time = kinds["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9)
                header = kinds["std_msgs/msg/Header"](*([k] if ros1 else []), time, f"camera{eye}")
                how, array = encoded(images[eye][k], k, eye)
                if isinstance(array, bytes):
                    message = kinds["sensor_msgs/msg/CompressedImage"](header, how, np.frombuffer(array, np.uint8))
                    put(topic, "CompressedImage", log_time, message)
                else:
                    array = np.ascontiguousarray(array)
                    data = np.frombuffer(array.tobytes(), np.uint8)
                    shape = (*array.shape[:2], how, int(array.dtype.byteorder == ">"), data.size // array.shape[0])
                    put(topic, "Image", log_time, kinds["sensor_msgs/msg/Image"](header, *shape, data))
                if info is None:
                    continue
                fields = {"K": K, "D": (), "R": np.eye(3), "P": P(eye), "model": "plumb_bob", "binning": 0}
                fields |= {"size": (WIDTH, HEIGHT), "roi": (0, 0, 0, 0, False), **info(eye, k)}
                width, height = fields["size"]
                matrices = (np.ravel(np.asarray(fields[name], np.float64)) for name in "DKRP")
                message = kinds["sensor_msgs/msg/CameraInfo"](
                    *(header, height, width, fields["model"], *matrices, fields["binning"], fields["binning"]),
                    kinds["sensor_msgs/msg/RegionOfInterest"](*fields["roi"]),
                )
                put(topic.rpartition("/")[0] + "/camera_info", "CameraInfo", log_time, message)
    return path
