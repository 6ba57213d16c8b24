"""Images of a bag: grey values of its messages, and the pair of cameras that took them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters.contract.validation import plain
from stereo_slam_env.datasets.image_files import MAX_PIXELS, BrokenPair, as_grey, decoded_pixels, shift_of
from stereo_slam_env.recording.recording import GreyImage
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
