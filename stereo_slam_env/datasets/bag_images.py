"""Images of a bag: grey values of its messages, the pair of cameras that took them, and pairs written as MCAP."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters import Pose, StereoCamera
from filters.contract.extras import require_module
from filters.contract.validation import plain
from stereo_slam_env.datasets.image_files import MAX_PIXELS, BrokenPair, as_grey, decoded_pixels, shift_of
from stereo_slam_env.recording.recording import GreyImage, ImageSequence
from stereo_slam_env.sensing.calibration_entries import Size
from stereo_slam_env.sensing.camera_info import CameraInfo, agreed, calibration_of_images
from stereo_slam_env.sensing.rig_files import Calibration

_CHANNELS = {
    **dict.fromkeys(("mono8", "8UC1", "mono16", "16UC1"), 1),
    **dict.fromkeys(("bgr8", "rgb8", "8UC3", "bgr16", "rgb16", "16UC3"), 3),
    **dict.fromkeys(("bgra8", "rgba8", "8UC4", "bgra16", "rgba16", "16UC4"), 4),
    **dict.fromkeys(("yuv422", "uyvy", "yuv422_yuy2", "yuyv"), 2),
    **{f"bayer_{pattern}{bits}": 1 for pattern in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)},
}
"""Numbers of a pixel by encoding."""
_BAYER = {"rggb": "BayerBG2GRAY", "bggr": "BayerRG2GRAY", "gbrg": "BayerGR2GRAY", "grbg": "BayerGB2GRAY"}
"""OpenCV's names, by the pixels of the second row and column."""
Pixels = NDArray[Any]
"""Of 8 or 16 bits."""


def grey_of(message: Any, size: tuple[int, int], what: str, shift: int = 8) -> GreyImage:
    """Grey values (H, W) of a `sensor_msgs/Image`; a `BrokenPair` that begins with `what` says why it is none.

    Values of 16 bits are shifted right by `shift` bits: one number for a whole recording, see `shift_of_messages`.
    """
    message_size = int(message.width), int(message.height)
    pixels = _pixels(message, what)
    if message_size != size:
        width, height = message_size
        said = f"{what} is {width}x{height} where CameraInfo says {size[0]}x{size[1]}: calibrate for these images"
        raise BrokenPair("image of another size", said)
    return _grey(pixels, str(message.encoding), shift)


def grey_of_compressed(message: Any, size: tuple[int, int], path: Path, shift: int = 8) -> GreyImage:
    """The same of a `sensor_msgs/CompressedImage`, with `path` for messages; its `format` says what its pixels are."""
    encoding = _encoding_of(message)
    pixels = decoded_pixels(path, bytes(message.data), size, colour=encoding.startswith("bayer_"))
    return _grey(pixels, encoding, shift)


def size_of_message(message: Any, path: Path) -> tuple[int, int]:
    """Width and height of either, px."""
    if hasattr(message, "format"):
        height, width = decoded_pixels(path, bytes(message.data)).shape[:2]
        return width, height
    return int(message.width), int(message.height)


def shift_of_messages(messages: Iterable[Any], what: str) -> int:
    """Bits by which values of 16 bits are shifted right, so that those of all these messages fit into 8."""
    most = 0
    for message in messages:
        try:
            if hasattr(message, "format"):
                pixels = decoded_pixels(Path(what), bytes(message.data))
            else:
                pixels = _pixels(message, what)
        except BrokenPair:  # met when it is read
            continue
        if pixels.dtype == np.uint8:
            return 8
        most = max(most, int(pixels.max(initial=0)))
    return shift_of(most)


def _encoding_of(message: Any) -> str:
    """Encoding of decoded pixels by the format: `bayer_rggb8; png compressed`, `rgb8; jpeg compressed bgr8`, `jpeg`."""
    of_source, _, rest = str(message.format).partition(";")
    target = rest.partition("compressed")[2].strip()
    return target or of_source.strip()


def _pixels(message: Any, what: str) -> Pixels:
    """(H, W) or (H, W, channels) of an uncompressed image, 8 or 16 bits."""
    encoding, width, height = str(message.encoding), int(message.width), int(message.height)
    channels = _CHANNELS.get(encoding)
    if channels is None:
        encodings = ", ".join(_CHANNELS)
        raise BrokenPair("image unreadable", f"{what} has the encoding {plain(encoding)!r}: known are {encodings}")
    wide = re.search(r"16", encoding) is not None
    of_row = width * channels * (2 if wide else 1)
    step, data = int(message.step), np.asarray(message.data, dtype=np.uint8)
    if width * height > MAX_PIXELS or step < of_row or data.size < step * height:
        raise BrokenPair("image damaged", f"{what} has {data.size} bytes, too few for its size: record it again")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :of_row])
    if wide:
        rows = rows.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    return rows if channels == 1 else rows.reshape(height, width, channels)


def _grey(pixels: Pixels, encoding: str, shift: int) -> GreyImage:
    import cv2

    if encoding in ("yuv422", "uyvy"):
        return np.ascontiguousarray(pixels[..., 1], dtype=np.uint8)
    if encoding in ("yuv422_yuy2", "yuyv"):
        return np.ascontiguousarray(pixels[..., 0], dtype=np.uint8)
    if encoding.startswith("bayer_") and pixels.ndim == 2:
        code = getattr(cv2, f"COLOR_{_BAYER.get(encoding[6:10], 'BayerBG2GRAY')}")
        pixels = cv2.cvtColor(np.ascontiguousarray(pixels), code)
    return as_grey(pixels, shift, rgb=encoding.startswith("rgb"))


IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO = "sensor_msgs/msg/CameraInfo"
Infos = Mapping[str, tuple[str, CameraInfo]]
"""Topics of CameraInfo and their first messages, by name space."""


def first_infos(reader: Any) -> Infos:
    """First messages CameraInfo that are filled in."""
    infos: dict[str, tuple[str, CameraInfo]] = {}
    for connection in (c for c in reader.connections if c.msgtype == INFO):
        name = connection.topic.rpartition("/")[0]
        for _, _, raw in reader.messages([connection]):
            info = CameraInfo.of_message(reader.deserialize(raw, INFO))
            if name not in infos or any(info.P):
                infos[name] = connection.topic, info
            if any(info.P):  # drivers begin with empty ones
                break
    return infos


def calibration_of_topics(
    reader: Any, path: Path, eyes: tuple[str, str], infos: Infos, sizes: tuple[Size, Size]
) -> tuple[Calibration, tuple[str, ...]]:
    """Calibration of images with these sizes by all CameraInfo of both cameras, and notes on it."""
    topics = [known[0] for topic in eyes if (known := _info_of(infos, topic)) is not None]
    if len(topics) < len(eyes):
        raise ValueError(f"{path} has no CameraInfo of {' and '.join(map(plain, eyes))}: give the calibration as rig")
    both, notes = [], list[str]()
    for topic in topics:
        connections = [c for c in reader.connections if c.topic == topic]
        every = (CameraInfo.of_message(reader.deserialize(raw, INFO)) for _, _, raw in reader.messages(connections))
        info, note = agreed(every, f"{path}, {plain(topic)}")
        both.append(info)
        notes += note
    left, right = ("rect" not in topic.rpartition("/")[2] and "/image_rect" not in topic for topic in eyes)
    calibration, more = calibration_of_images(
        (both[0], both[1]), sizes, f"{path}, {plain(topics[1])}", mapped=(left, right)
    )
    return calibration, (*notes, *more)


def _info_of(infos: Infos, topic: str) -> tuple[str, CameraInfo] | None:
    parts = topic.split("/")
    return next((infos[name] for n in range(len(parts) - 1, 0, -1) if (name := "/".join(parts[:n])) in infos), None)


def cameras_of(
    path: Path,
    topics: Mapping[str, str],
    infos: Infos,
    left: str | None,
    right: str | None,
    *,
    by_name: bool,
) -> tuple[str, str]:
    """Topics of the left and of the right images: by CameraInfo, or else, if that will do, by their names."""
    images = sorted(topic for topic, kind in topics.items() if kind in IMAGES)
    if not images:
        raise ValueError(
            f"{path} holds no images, on none of its {len(topics)} topics: give one with a stereo pair (poses alone "
            "are judged by `stereo-slam evaluate`)"
        )
    listed = ", ".join(map(plain, images))
    for eye in (left, right):
        if eye is not None and eye not in images:
            raise ValueError(f"{path} has no images on {eye!r}; topics with images: {listed}")
    if left is not None and right is not None:
        return left, right
    of_eye: tuple[list[str], list[str]] = ([], [])
    for topic in images:
        info = _info_of(infos, topic)
        if info is not None and not any(word in topic for word in ("depth", "disparity", "mask")):
            of_eye[info[1].shift < 0].append(topic)
    lefts = [left] if left is not None else of_eye[0]
    rights = [right] if right is not None else of_eye[1]
    best = [(a, b) for b in rights for a in lefts if _alike(a, b)]
    best = best or [(a, b) for b in rights for a in lefts if _alike(_unsaid(a), _unsaid(b))]
    if not best and by_name:
        called = [(a, b) for a in images for b in images if _called_left_and_right(a, b)]
        best = [(a, b) for a, b in called if left in (None, a) and right in (None, b)]
    best = [pair for pair in best if "rect" in pair[0]] or best
    best = [pair for pair in best if topics[pair[0]].endswith("/Image")] or best
    if len(best) != 1:
        why = f"{len(best)} pairs of cameras: name the topics (--image-topics LEFT,RIGHT)"
        if not best:
            why = "no pair of cameras whose CameraInfo makes them one rig (P[3] of the right one is -f b): give a rig"
        shifts = {topic: _info_of(infos, topic) for topic in images}
        listed = ", ".join(
            f"{plain(topic)} with {'no CameraInfo' if info is None else f'P[3] = {info[1].shift:g}'}"
            for topic, info in shifts.items()
        )
        raise ValueError(f"{path} holds {why}; images: {listed}")
    return best[0]


def _alike(left: str, right: str) -> bool:
    """Whether two topics differ as left and right do: in one part of their names, or by a digit or word in it."""
    a, b = left.split("/"), right.split("/")
    return len(a) == len(b) and sum(one != other for one, other in zip(a, b, strict=True)) == 1


def _unsaid(topic: str) -> str:
    """The topic without words on what its images are: one camera's may say raw, the other's rectified."""
    return re.sub(r"_(rect|raw|colou?r|mono|gr[ae]y)(?=[_/]|$)", "", topic)


def _called_left_and_right(a: str, b: str) -> bool:
    """Whether two topics are `left` and `right`, or one digit apart as `cam0` and `cam1`, or `infra1` and `infra2`."""
    if a.replace("left", "right") == b != a:
        return True
    other = [(x, y) for x, y in zip(a, b, strict=False) if x != y]
    return len(a) == len(b) and other in ([("0", "1")], [("1", "2")])


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
        (bag_file,) = (Path(folder) / "bag").glob("*.mcap")
        shutil.move(bag_file, out)
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
        pose = [self._transform(stamp, LEFT, RIGHT, beside)]
        if truth is not None:
            pose.append(self._transform(stamp, WORLD, LEFT, truth))
        return self.types.types["tf2_msgs/msg/TFMessage"](transforms=pose)

    def _transform(self, stamp: int, parent: str, child: str, pose: Pose) -> Any:
        kinds = self.types.types
        shift = kinds["geometry_msgs/msg/Vector3"](*map(float, pose.position))
        turn = kinds["geometry_msgs/msg/Quaternion"](*map(float, pose.orientation))
        of = kinds["geometry_msgs/msg/Transform"](translation=shift, rotation=turn)
        header = self._header(stamp, parent)
        return kinds["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id=child, transform=of)
